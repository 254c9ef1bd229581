"""The public interface: names, docstrings, examples, errors; no numerical library loaded at import."""

import doctest
import enum
import inspect
import json
import pickle
import re
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from patience import PATIENCE
from stub import STUB, stub_text

import robustlab as rl
from robustlab import errors
from robustlab.errors import InputError, RobustlabError
from robustlab.public_names import NAMES


def test_importing_the_package_loads_nothing_heavy():
    code = "import sys, robustlab; print(' '.join(sorted({m.split('.')[0] for m in sys.modules})))"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    assert not {"numpy", "scipy", "control", "cvxpy", "h5py", "matplotlib", "pydantic"} & set(loaded)


def test_the_stub_equals_the_table():
    assert STUB.read_text(encoding="utf-8") == stub_text(), "run: python benchmarks/stub.py"


@pytest.mark.slow
def test_a_type_checker_knows_every_public_name(tmp_path):
    lines = ["import robustlab as rl", *(f"reveal_type(rl.{name})" for name in (*rl.__all__, "__version__"))]
    (tmp_path / "user.py").write_text("\n".join(lines))
    command = [sys.executable, "-m", "pyright", "--outputjson", "--pythonpath", sys.executable, "user.py"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False, timeout=PATIENCE)
    found = {d["range"]["start"]["line"]: d for d in json.loads(done.stdout)["generalDiagnostics"]}
    for k, line in enumerate(lines[1:], start=1):
        message = found[k]["message"]
        assert found[k]["severity"] == "information", message
        assert message.rpartition(" is ")[2].strip('"') not in ("Any", "Unknown"), line


# --- names of other programs, and mistyped ones -----------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "answer"),
    [("wcgain", "no 'wcgain'; here it is rl.peak_gain"), ("robust_stabilty", "did you mean robust_stability?")],
)
def test_an_unknown_name_is_answered(name, answer):
    with pytest.raises(AttributeError, match=re.escape(answer)):
        getattr(rl, name)
    assert {word for text in NAMES for word in re.findall(r"\brl\.(\w+)", text)} <= set(rl.__all__)


# --- examples in docstrings -------------------------------------------------------------------------------------------


ROOT = Path(__file__).resolve().parents[3]
MODULES = [
    ".".join(file.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")
    for file in sorted((ROOT / "robustlab").rglob("*.py"))
    if ">>> " in file.read_text()
]


@pytest.mark.parametrize("module", MODULES)
def test_examples(module):
    result = doctest.testmod(import_module(module), optionflags=doctest.NORMALIZE_WHITESPACE | doctest.ELLIPSIS)
    assert not result.failed


def test_there_are_examples():
    assert len(MODULES) > 50


# --- errors and exit codes --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "code", "base"),
    [
        ("UsageError", 2, RobustlabError),
        ("InputError", 3, ValueError),
        ("UnitMismatch", 3, InputError),
        ("NoTrustworthyNumber", 4, ArithmeticError),
        ("NativeTimeout", 4, errors.NoTrustworthyNumber),
        ("EnvironmentFault", 5, OSError),
        ("DependencyMissing", 5, errors.EnvironmentFault),
    ],
)
def test_exit_codes(name, code, base):
    kind = getattr(errors, name)
    assert kind.exit_code == code
    assert issubclass(kind, base)
    assert issubclass(kind, RobustlabError)


def test_errors_cross_process_boundaries():
    error = InputError("a", "b", "c", "d", ("e",))
    copy = pickle.loads(pickle.dumps(error))
    assert type(copy) is InputError
    assert str(copy) == str(error)


@settings(max_examples=50)
@given(st.text(max_size=40))
def test_no_control_character_reaches_the_terminal(text):
    shown = str(RobustlabError(text, text, text, text, (text,)))
    assert all(ch.isprintable() for line in shown.split("\n") for ch in line)
    assert not set("\u202a\u202b\u202c\u202d\u202e\u2066\u2067\u2068\u2069\u200e\u200f\x1b") & set(shown)


# --- docstrings -------------------------------------------------------------------------------------------------------


def sections(doc: str) -> set[str]:
    return set(re.findall(r"(?m)^(\w+(?: \w+)?)\n-{3,}$", doc))


def lacking(obj: object) -> list[str]:
    """Return the missing parts of the docstring of a public name."""
    doc = inspect.cleandoc(obj.__doc__ or "")
    found = sections(doc)
    if inspect.isclass(obj):
        exempt = issubclass(obj, (enum.Enum, BaseException))
        return [] if exempt or found & {"Parameters", "Attributes"} else ["Parameters or Attributes"]
    arguments = list(inspect.signature(obj).parameters)
    described = doc.split("Parameters\n----------")[-1] if "Parameters" in found else ""
    lack = [
        name for name in arguments if not re.search(rf"(?m)^[\w*, ]*\b{re.escape(name)}\b[\w*, ]*( :.*)?$", described)
    ]
    return lack + [s for s in ("Returns", "Raises") if s not in found]


@pytest.mark.parametrize("name", rl._PUBLIC)
def test_public_docstrings_describe_parameters_returns_and_errors(name):
    assert lacking(getattr(rl, name)) == []


def test_the_test_of_docstrings_can_fail():
    def undocumented(first: int, second: int) -> int:
        """Add.

        Parameters
        ----------
        first
            A number.
        """
        return first + second

    assert lacking(undocumented) == ["second", "Returns", "Raises"]
