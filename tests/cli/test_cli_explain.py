"""``robustlab explain`` and ``robustlab`` alone: what a newcomer types."""

from __future__ import annotations

import json
from typing import get_args

import pytest

from robustlab.cli.ending import main_guard
from robustlab.cli.explain import explained
from robustlab.cli.main import run
from robustlab.dynamics.effects.catalogue import catalogue
from robustlab.dynamics.effects.kinds import KIND_OF, KINDS, upwards
from robustlab.errors import EnvironmentFault, InputError, NoTrustworthyNumber, UsageError
from robustlab.identification.naming.discovery_result import Verdict
from robustlab.result import Status

CODES = {0, 1, 70, 130, 141, *(e.exit_code for e in (UsageError, InputError, NoTrustworthyNumber, EnvironmentFault))}


def told(capsys, *words):
    code = main_guard(lambda: run(words))
    return code, *capsys.readouterr()


def test_every_status_verdict_and_exit_code_has_its_paragraph():
    words = explained()
    assert {s.value for s in Status} | set(get_args(Verdict)) | {f"exit code {code}" for code in CODES} <= set(words)
    assert all(len(text) > 40 for text in words.values())


@pytest.mark.parametrize("word", ["Inconclusive", "no missing effect", "4", "exit code 4", "coulomb-friction"])
def test_a_word_is_explained(capsys, word):
    code, out, _ = told(capsys, "explain", word)
    assert code == 0
    assert len(out) > 60
    assert max(map(len, out.splitlines())) <= 100
    assert json.loads(told(capsys, "explain", word, "--json")[1])["meaning"].split() == out.split()


def test_every_effect_explains_itself(capsys):
    for name in catalogue():
        code, out, _ = told(capsys, "explain", name)
        assert (code, "Equation: " in out, ".. math" in out) == (0, True, False)


def test_no_word_and_a_wrong_one(capsys):
    code, _, err = told(capsys, "explain")
    assert (code, "  inconclusive\n" in err) == (2, True)
    code, _, err = told(capsys, "explain", "certifed")
    assert (code, "did you mean certified?" in err) == (2, True)


def test_robustlab_alone_says_five_things_to_do_first(capsys):
    code, out, _ = told(capsys)
    commands = [line.split()[1:] for line in out.splitlines() if line.startswith("  robustlab ")]
    assert (code, len(commands)) == (2, 5)
    for first, *_ in commands:
        assert told(capsys, first, "--help")[0] == 0


def test_every_kind_says_its_members_and_what_they_can_be_asked_for(capsys):
    for name, kind in KINDS.items():
        code, out, _ = told(capsys, "explain", name)
        assert code == 0
        text = " ".join(out.split())
        assert kind.title in text
        assert all(q in text for q in kind.quantities)
        own = {effect for effect, narrow in KIND_OF.items() if name in [k.id for k in upwards(narrow)]}
        assert own <= set(text.replace(",", " ").replace(".", " ").split())
    assert told(capsys, "explain", "dry friction")[0] == 0
