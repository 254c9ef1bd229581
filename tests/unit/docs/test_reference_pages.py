"""The site: every public name, every command with its options, every key of a recipe has its place; links hold."""

from __future__ import annotations

import re
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest

import robustlab as rl
from robustlab.recipe.schema import json_schema

reference_pages = import_module("reference_pages")

DOCS = Path(reference_pages.__file__).parent
PAGES = reference_pages.pages()


def test_every_public_name_has_a_page_and_stands_in_the_contents():
    assert [name for names in reference_pages.groups().values() for name in names] == rl.__all__
    for name in rl.__all__:
        assert re.search(rf"^\.\. auto\w+:: {name}$", PAGES[f"api/{name}.rst"], re.M), name
        assert f":py:obj:`{name} <robustlab.{name}>`" in PAGES["api/index.rst"]


def test_what_public_functions_return_is_documented_too():
    assert {"Margin", "MuBounds", "Discovery", "WorstCase", "HinfSynthesis", "Comparison"} <= set(
        reference_pages.results()
    )


def test_every_command_and_every_option_of_its_help_is_on_the_page():
    """The help is the real command's; how wide its lines are does not matter."""
    from robustlab.cli.groups import GROUPS

    assert {words[0] for words in reference_pages.commands()} == set(GROUPS)
    for words in reference_pages.commands():
        page = PAGES[f"cli/{words[0]}.rst"]
        assert f".. program:: robustlab {' '.join(words)}\n" in page
    for words in (("mu",), ("uncertain", "build"), ("synth", "mixsyn"), ("data", "discover")):
        command = [sys.executable, "-m", "robustlab.cli.main", *words, "--help"]
        said = subprocess.run(command, capture_output=True, text=True, check=True).stdout
        section = (
            PAGES[f"cli/{words[0]}.rst"]
            .split(f".. program:: robustlab {' '.join(words)}\n")[1]
            .partition(".. program")[0]
        )
        told = re.findall(r"(?m)^ +(-\S+(?:, --\S+)*)", said)
        assert len(told) > 5
        assert [
            option for option in told if not re.search(rf"(?m)^\.\. option:: {re.escape(option)}( |$)", section)
        ] == []


def test_every_step_and_every_key_of_a_recipe_is_on_the_page():
    schema = json_schema()
    page = PAGES["recipe.rst"]
    steps = [part for part in schema["$defs"].values() if "do" in part["properties"]]
    assert len(steps) > 30
    for part in steps:
        name = part["properties"]["do"]["const"]
        section = page.split(f".. _step-{name}:\n")[1].partition("\n.. _step-")[0]
        assert [key for key in part["properties"] if key != "do" and f"\n``{key}`` : " not in section] == []


def test_text_of_the_program_is_no_markup():
    assert reference_pages.plain("|Delta| of *all* a_ <b>") == r"\|Delta\| of \*all\* a\_ \<b\>"
    assert reference_pages.plain("see `equals` and ``x``.") == "see \\ ``equals``\\  and \\ ``x``\\ ."


def test_old_pages_are_removed_and_unchanged_ones_keep_their_time(tmp_path):
    reference_pages.write(tmp_path)
    (tmp_path / "api" / "gone.rst").write_text("x")
    before = (tmp_path / "recipe.rst").stat().st_mtime_ns
    reference_pages.write(tmp_path)
    assert not (tmp_path / "api" / "gone.rst").exists()
    assert (tmp_path / "recipe.rst").stat().st_mtime_ns == before


def every_page() -> list[Path]:
    return [page for page in sorted(DOCS.rglob("*.md")) if "reference" not in page.relative_to(DOCS).parts]


@pytest.mark.parametrize("page", every_page(), ids=lambda page: page.relative_to(DOCS).as_posix())
def test_a_page_leads_somewhere_and_names_what_there_is(page):
    """What the site's build checks as well, here in a moment."""
    text = re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.S)
    for target in re.findall(r"\]\(([^)#\s]+)[^)]*\)", text):
        if "://" in target:
            continue
        _, below, name = target.partition("reference/")
        assert (name in PAGES) if below else (page.parent / target).exists(), target
    assert [name for name in re.findall(r"`rl\.([A-Za-z]\w*)", text) if name not in rl.__all__] == []


def test_every_page_is_in_the_contents():
    """A page in no table of contents is found by nobody; the build says so too."""
    from fnmatch import fnmatch

    held = []
    for page in every_page():
        for block in re.findall(r"```\{toctree\}\n(.*?)```", page.read_text(encoding="utf-8"), re.S):
            held += [
                (page.parent / line).relative_to(DOCS).as_posix()
                for line in block.splitlines()
                if line and not line.startswith(":")
            ]
    names = [page.relative_to(DOCS).with_suffix("").as_posix() for page in every_page()]
    lost = [n for n in names if n != "index" and not any(fnmatch(n, h) and n.count("/") == h.count("/") for h in held)]
    assert lost == []


def test_dead_links_of_a_site_are_found(tmp_path):
    check_site = import_module("check_site")
    (tmp_path / "a.html").write_text(
        '<h1 id="top">A</h1><a href="b.html#there">b</a><a href="b.html#gone">b</a><a href="c.html">c</a>'
    )
    (tmp_path / "b.html").write_text(
        '<p id="there"><a href="a.html">a</a><img src="none.png"><a href="https://example.org/x">x</a>'
    )
    assert check_site.dead_links(tmp_path) == ["a.html -> b.html#gone", "a.html -> c.html", "b.html -> none.png"]
