"""The site: every public name, every command with its options, every key of a recipe has its place; links hold."""

import re
from importlib import import_module
from pathlib import Path

import pytest

import robustlab as rl
from robustlab.recipe import json_schema

reference_pages = import_module("reference_pages")

DOCS = Path(reference_pages.__file__).parent
PAGES = reference_pages.pages()


def test_every_public_name_has_a_page_and_stands_in_the_contents():
    assert [name for names in reference_pages.groups().values() for name in names] == rl.__all__
    for name in rl.__all__:
        assert re.search(rf"^\.\. auto\w+:: {name}$", PAGES[f"api/{name}.rst"], re.M), name
        assert f":py:obj:`{name} <robustlab.{name}>`" in PAGES["api/index.rst"]


def test_every_step_and_every_key_of_a_recipe_is_on_the_page():
    schema = json_schema()
    page = PAGES["recipe.rst"]
    steps = [part for part in schema["$defs"].values() if "do" in part["properties"]]
    assert len(steps) > 30
    for part in steps:
        name = part["properties"]["do"]["const"]
        section = page.split(f".. _step-{name}:\n")[1].partition("\n.. _step-")[0]
        assert [key for key in part["properties"] if key != "do" and f"\n``{key}`` : " not in section] == []


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
