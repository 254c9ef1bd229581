"""``robustlab campaign``: the commands on its page run and print the output shown there."""

import json
import re
from pathlib import Path

import pytest
from shell import robustlab

import robustlab as rl

PAGE = (Path(__file__).parents[2] / "docs" / "campaigns.md").read_text(encoding="utf-8")
COMMANDS = re.search(r"```sh\n(.*?)```", PAGE, re.S).group(1).splitlines()
SHOWN = re.search(r"`show` prints\n\n```\n(.*?)```", PAGE, re.S).group(1)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("page")


def test_the_page_in_order(folder, monkeypatch):
    monkeypatch.chdir(folder)
    printed = {}
    for command in COMMANDS:
        words = command.split()
        code, printed[words[2], words[-1]], err = robustlab(*words[1:])
        assert (code, err) == (0, ""), command
    assert printed["show", "34"].startswith(SHOWN)
    assert printed["resume", "motor.sqlite"].startswith("\n".join(SHOWN.splitlines()[:6]))
    assert "4 of 4 vertices" in printed["run", "vertices.sqlite"]
    assert "2 of 2 searches" in printed["run", "searches.sqlite"]
    # The page's code does what the commands did.
    names = {}
    exec("\n".join(re.findall(r"```python\n(.*?)```", PAGE, re.S)), names)
    assert f"{names['result'].worst:.9g} rad/s in sample 675" in SHOWN
    assert f"{names['result'].violation.upper:.4g}" in SHOWN


def test_json(folder, monkeypatch):
    monkeypatch.chdir(folder)
    code, text, _ = robustlab("campaign", "show", "motor.sqlite", "--json", "--limit", "34")
    data = json.loads(text)
    assert code == 0
    assert (data["schema"], data["command"]) == ("robustlab.result/1", "campaign show")
    assert (data["done"], data["worst_index"], data["violation"]["count"]) == (2000, 675, 11)
    assert data["delta"] == rl.sample(rl.load("motor.h5"), 676, seed=1).deltas[675]


@pytest.mark.parametrize(
    ("words", "code", "text"),
    [
        (("run", "motor.h5", "--store", "x.sqlite", "--kind", "sample"), 2, "did you mean samples?"),
        (("run", "motor.h5"), 2, "--store"),
        (("run", "motor.h5", "--store", "motor.h5", "--restart"), 3, "not a campaign store"),
        (("run", "motor.h5", "--store", "motor.sqlite", "--seed", "2"), 3, "changed since sample 0"),
        (("show", "nothing.sqlite"), 3, "no such file"),
    ],
)
def test_refusals(folder, words, code, text, monkeypatch):
    monkeypatch.chdir(folder)
    found, out, err = robustlab("campaign", *words)
    assert (found, out) == (code, "")
    assert text in err
