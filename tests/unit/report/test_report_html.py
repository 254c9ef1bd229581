"""The page: verdict first, marks and colours, no external resources, faults of a run folder."""

import copy
import re
import shutil
from urllib.parse import unquote

import numpy as np
import pytest
from check_report import Tags

from robustlab.errors import InputError
from robustlab.recipe import read_result
from robustlab.report import in_words, new_figure, render, save_figure, verdict

REQUIREMENT = {
    "text": "fast enough", "that": "a.x", "condition": "at least 1", "value": 2.0, "met": True, "why_not": "",
}  # fmt: skip
STEP = {
    "name": "a", "do": "plant", "title": "A step", "status": "certified", "trustworthy": True, "summary": "Did it.",
    "error": "", "numbers": {"x": 2.0}, "facts": [{"label": "speed", "value": "2 rad/s", "source": ""}],
    "notes": ["mind"], "text": "a\n  b", "figures": [{"stem": "a-y", "caption": "The response."}], "seconds": 0.1,
}  # fmt: skip
RECIPE = {
    "name": "r", "title": "", "description": "One.\n\nTwo.", "file": "r.toml", "sha256": "ab12",
    "overrides": {"seed": "7"}, "text": "name = 1",
}  # fmt: skip
RESULT = {
    "schema": "robustlab.result/1", "command": "run", "exit_code": 0, "requirements": [REQUIREMENT], "steps": [STEP],
    "recipe": RECIPE, "seed": 7, "seconds": 1.25, "files": [],
    "provenance": {"created": "2026-01-01", "inputs": {"m.h5": "cd34"}, "versions": {"numpy": "2.0"}},
}  # fmt: skip


@pytest.fixture
def folder(tmp_path):
    figure, (axes,) = new_figure()
    axes.plot([0, 1], [0, 1])
    save_figure(figure, tmp_path / "figures", "a-y")
    return tmp_path


def changed(**parts):
    data = copy.deepcopy(RESULT)
    for key, value in parts.items():
        data[key][0].update(value)
    return data


@pytest.mark.parametrize(
    ("data", "tone", "headline"),
    [
        (RESULT, "good", "The requirement is met"),
        (changed(requirements={"met": False}), "bad", "1 requirement is not met"),
        (changed(steps={"trustworthy": False, "status": "inaccurate"}), "bad", "No trustworthy number"),
        (changed(requirements={"met": False}, steps={"trustworthy": False}), "bad", "No trustworthy number"),
        ({**RESULT, "requirements": []}, "warn", "Done; no requirement was stated"),
        ({**RESULT, "requirements": [REQUIREMENT] * 3}, "good", "All 3 requirements are met"),
    ],
)
def test_verdicts(data, tone, headline):
    found = verdict(data)
    assert (found.tone, found.headline) == (tone, headline)


def test_the_page_has_everything_and_loads_nothing(folder):
    page = render(RESULT, folder)
    texts = ("The requirement is met", "fast enough", "A step", "certified", "Did it.", "2 rad/s", "mind")
    for part in (*texts, "The response.", "One.", "Two.", "ab12", "cd34", "numpy 2.0", "seed = 7", "name = 1", "m.h5"):
        assert part in page
    assert page.index("The requirement is met") < page.index("A step")
    pictures = re.findall(r"src='data:image/svg\+xml,([^']*)'", page)
    assert [unquote(p) for p in pictures] == [(folder / "figures/a-y.svg").read_text(encoding="utf-8")]
    rest = re.sub(r"src='data:image/svg\+xml,[^']*'", "", page)
    addresses = re.findall(r'(?:src|href|url)\s*[=(]\s*["\']?([^"\'>)]+)', rest)
    assert addresses
    assert all(address.startswith(("#step-", "#figure-")) for address in addresses)
    assert "<script" not in page
    assert "default-src 'none'" in page


def test_a_long_report_keeps_its_size(tmp_path):
    figure, (axes,) = new_figure()
    t, noise = np.linspace(0, 1, 3000), np.random.default_rng(1).normal(size=(6, 3000))
    for k in range(6):
        axes.plot(t, noise[k])
    svg, _ = save_figure(figure, tmp_path / "figures", "a-0")
    for k in range(1, 40):
        shutil.copy(svg, tmp_path / f"figures/a-{k}.svg")
    figures = [{"stem": f"a-{k}", "caption": "Long curves."} for k in range(40)]
    for kept in (40, 15):
        page = render(changed(steps={"figures": figures[:kept]}), tmp_path)
        assert len(page.encode()) < 7e6
        pictures = page.count("<img")
        assert pictures + page.count("No room in this page") == kept
        assert pictures >= 15


@pytest.mark.parametrize(
    ("value", "limits", "words"),
    [
        (779.0832, [779.05, 779.15], "779.083"),  # close to a limit: enough digits to show the side
        (0.58882791, [None, 1.0], "0.5888"),
        (123456.789, [1.0, None], "123457"),
        (0.58882791, None, "0.588828"),
        (True, None, "yes"),
    ],
)
def test_numbers_have_the_digits_that_their_limit_needs(value, limits, words):
    assert in_words(value, limits) == words


def test_the_tags_are_closed_in_turn_and_names_come_once(folder):
    assert Tags(render(RESULT, folder)).faults == []


def test_a_missing_figure_is_bad_input(tmp_path):
    with pytest.raises(InputError, match="no such figure"):
        render(RESULT, tmp_path)


def test_a_figure_outside_the_run_folder_is_refused(folder):
    (folder / "secret.svg").write_text("x")
    with pytest.raises(InputError, match="no such figure"):
        render(changed(steps={"figures": [{"stem": "../secret", "caption": "x"}]}), folder)


@pytest.mark.parametrize("part", ["requirements", "steps", "recipe", "provenance"])
def test_a_result_without_a_part_is_bad_input(folder, part):
    data = {key: value for key, value in RESULT.items() if key != part}
    with pytest.raises(InputError, match="a part is missing"):
        render(data, folder)


@pytest.mark.parametrize(
    "text", ["", "{", "[]", '{"schema": "other"}', '{"schema": "robustlab.result/1", "command": "mu"}']
)
def test_another_file_is_no_result(tmp_path, text):
    (tmp_path / "result.json").write_text(text)
    with pytest.raises(InputError):
        read_result(tmp_path)
