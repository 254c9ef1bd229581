"""The page: verdict first, marks beside colours, nothing loaded from anywhere, faults of a run folder."""

from __future__ import annotations

import copy
import json
import re

import pytest

from robustlab.errors import InputError
from robustlab.recipe.run import read_result
from robustlab.report.figures import new_figure, save_figure
from robustlab.report.html import render, verdict

REQUIREMENT = {
    "text": "fast enough",
    "that": "a.x",
    "condition": "at least 1",
    "value": 2.0,
    "met": True,
    "why_not": "",
}
STEP = {
    "name": "a",
    "do": "plant",
    "title": "A step",
    "status": "certified",
    "trustworthy": True,
    "summary": "Did it.",
    "error": "",
    "numbers": {"x": 2.0},
    "facts": [{"label": "speed", "value": "2 rad/s", "source": ""}],
    "notes": ["mind"],
    "text": "a\n  b",
    "figures": [{"stem": "a-y", "caption": "The response."}],
    "seconds": 0.1,
}
RESULT = {
    "schema": "robustlab.result/1",
    "command": "run",
    "exit_code": 0,
    "requirements": [REQUIREMENT],
    "steps": [STEP],
    "recipe": {
        "name": "r",
        "title": "",
        "description": "One.\n\nTwo.",
        "file": "r.toml",
        "sha256": "ab12",
        "overrides": {"seed": "7"},
        "text": "name = 1",
    },
    "seed": 7,
    "seconds": 1.25,
    "provenance": {"created": "2026-01-01", "inputs": {"m.h5": "cd34"}, "versions": {"numpy": "2.0"}},
    "files": [],
}


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
    for part in (
        "The requirement is met",
        "fast enough",
        "A step",
        "certified",
        "Did it.",
        "2 rad/s",
        "mind",
        "The response.",
        "One.",
        "Two.",
    ):
        assert part in page
    for part in ("ab12", "cd34", "numpy 2.0", "seed = 7", "name = 1", "m.h5"):
        assert part in page
    assert page.index("The requirement is met") < page.index("A step")
    addresses = re.findall(r'(?:src|href|url)\s*[=(]\s*["\']?([^"\'>)]+)', page)
    assert all(address.startswith(("data:image/svg+xml;base64,", "#step-")) for address in addresses)
    assert "http://" not in re.sub(r"base64,[A-Za-z0-9+/=]+", "", page)
    assert "<script" not in page
    assert "default-src 'none'" in page


def test_colour_is_never_the_only_mark(folder):
    page = render(changed(requirements={"met": False}), folder)
    assert "✗ not met" in page
    assert "✓ met" not in page


def test_every_figure_has_a_text_for_who_cannot_see_it(folder):
    assert 'alt="The response."' in render(RESULT, folder)


def test_the_page_is_the_same_each_time(folder):
    assert render(RESULT, folder) == render(RESULT, folder)


def test_a_figure_that_is_gone_is_bad_input(tmp_path):
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


def test_a_folder_without_a_result(tmp_path):
    with pytest.raises(InputError, match="no such file"):
        read_result(tmp_path)


def test_a_result_is_read_back(tmp_path):
    (tmp_path / "result.json").write_text(json.dumps(RESULT))
    assert read_result(tmp_path) == RESULT
