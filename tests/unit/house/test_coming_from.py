"""Names of other programs, mistyped names, unknown arguments: each is answered with what there is."""

from __future__ import annotations

import inspect
import re
import subprocess
import sys
from pathlib import Path

import pytest

import robustlab as rl
from robustlab.coming_from import MATLAB, PROGRAMS, PYTHON_CONTROL

PAGES = Path(__file__).resolve().parents[3] / "docs" / "coming-from"


def rows(page):
    """Cells of the tables' rows, without markup."""
    for line in (PAGES / f"{page}.md").read_text(encoding="utf-8").splitlines():
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        if line.startswith("|") and not line.startswith("|---") and len(cells) == 3:
            names = re.findall(r"`([A-Za-z_]\w*)`", cells[0])
            yield names, *(re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", cell).replace("`", "") for cell in cells[1:])


@pytest.mark.parametrize(("page", "table"), [("matlab", MATLAB), ("python-control", PYTHON_CONTROL)])
def test_the_pages_say_what_the_tables_say(page, table):
    told = {name: answer for answer, names in table.items() for name in names.split()}
    on_page = {}
    for names, answer, remark in rows(page):
        for name in names:
            if name not in rl.__all__:
                on_page.setdefault(name, f"{answer}; {remark}" if answer == "not there" and remark else answer)
    assert told == on_page
    assert sum(map(len, map(str.split, table.values()))) == len(told)


def test_what_a_table_names_is_there():
    named = {name for table in PROGRAMS.values() for answer in table for name in re.findall(r"\brl\.(\w+)", answer)}
    assert len(named) > 40
    assert named <= set(rl.__all__)


@pytest.mark.parametrize(
    ("name", "answer"),
    [
        ("wcgain", "robustlab has no 'wcgain'; MATLAB's wcgain is rl.peak_gain"),
        ("hinfsyn", "robustlab has no 'hinfsyn'; MATLAB's and python-control's hinfsyn is rl.hinf"),
        ("robust_stabilty", "robustlab has no 'robust_stabilty'; did you mean robust_stability?"),
        ("step_response", "robustlab has no 'step_response'; python-control's step_response is G.step()"),
        ("wcgian", "robustlab has no 'wcgian'; did you mean wcgain? MATLAB's wcgain is rl.peak_gain"),
        ("tf2ss", "robustlab has no 'tf2ss'; MATLAB's and python-control's tf2ss is rl.tf"),
        ("qqqqqqqq", "robustlab has no 'qqqqqqqq'"),
    ],
)
def test_an_unknown_name_is_answered(name, answer):
    with pytest.raises(AttributeError) as error:
        getattr(rl, name)
    assert str(error.value) == answer
    assert not hasattr(rl, name)


def test_the_answer_loads_nothing_heavy():
    code = (
        "import sys, robustlab\n"
        "try: robustlab.wcgain\n"
        "except AttributeError: pass\n"
        "print(' '.join({m.split('.')[0] for m in sys.modules}), 'robustlab.coming_from' in sys.modules)"
    )
    *loaded, found = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    ).stdout.split()
    assert found == "True"
    assert not {"numpy", "scipy", "control", "h5py"} & set(loaded)


# --- arguments -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("call", "text"),
    [
        (lambda: rl.hinf(None, gama_rel=1.0), "hinf has no argument 'gama_rel': did you mean gamma_rel? It takes P, "),
        (lambda: rl.load("x.h5", transposed=True), "load has no argument 'transposed': did you mean transpose?"),
        (lambda: rl.discover(None, None, heldout=None), "discover has no argument 'heldout': did you mean held_out?"),
        (lambda: rl.compare(None, None, windows=1.0), "did you mean window?"),
        (
            lambda: rl.StateSpaceModel(1, 1, 1, 0, input="u"),
            "StateSpaceModel has no argument 'input': did you mean inputs?",
        ),
        (lambda: rl.Record([0, 1], output={}), "Record has no argument 'output': did you mean outputs?"),
        (lambda: rl.Record.read("x.csv", input="u"), "Record.read has no argument 'input': did you mean inputs?"),
        (lambda: rl.UncertainModel(None, (), block=()), "UncertainModel has no argument 'block'"),
        (lambda: rl.tf([1], [1, 1], zzz=1), "tf has no argument 'zzz'; it takes num, den, dt, inputs, outputs"),
    ],
)
def test_an_unknown_argument_is_answered_with_those_that_there_are(call, text):
    with pytest.raises(TypeError) as error:
        call()
    assert text in str(error.value)


def test_what_python_says_of_missing_arguments_stays():
    with pytest.raises(TypeError, match="missing 3 required"):
        rl.StateSpaceModel([[1.0]])  # pyright: ignore[reportCallIssue]


@pytest.mark.parametrize("name", [name for name in rl.__all__ if inspect.isfunction(getattr(rl, name))])
def test_every_public_function_answers_an_unknown_argument(name):
    function = getattr(rl, name)
    parameters = inspect.signature(function).parameters.values()
    if any(p.kind is p.VAR_KEYWORD for p in parameters) or not parameters:
        return  # names of its own: parameters of plants
    needed = [None for p in parameters if p.default is p.empty and p.kind is p.POSITIONAL_OR_KEYWORD]
    with pytest.raises(TypeError, match=r"has no argument 'no_such_argument'"):
        function(*needed, no_such_argument=1)


# --- help ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", [name for name in rl.__all__ if callable(getattr(rl, name))])
def test_help_begins_with_what_it_does_and_not_with_a_table_of_numbers(name):
    try:
        told = str(inspect.signature(getattr(rl, name)))
    except ValueError:
        return
    assert len(told) < 700
