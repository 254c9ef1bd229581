"""The frame of the command line: table of groups, laziness, exit codes."""

import subprocess
import sys

import pytest

from robustlab.cli import GROUPS, help_text, main_guard, parser
from robustlab.cli import run_command as run
from robustlab.errors import InputError, NoTrustworthyNumber, UsageError

HEAVY = ["numpy", "scipy", "control", "cvxpy", "h5py", "matplotlib", "pydantic", "slycot", "clarabel", "jinja2"]


LAZY = """
import sys
from robustlab.cli import run_command as run
print(run(["--help"]), "typer" in sys.modules)
from robustlab.cli import GROUPS
print([run([group, "--help"]) for group in GROUPS].count(0) - len(GROUPS), file=sys.stderr)
print(*{m.split(".")[0] for m in sys.modules}, file=sys.stderr)
"""


def test_help_of_every_group_loads_no_numerical_library():
    done = subprocess.run([sys.executable, "-c", LAZY], capture_output=True, text=True, check=True)
    assert "\n0 False\n" in done.stdout
    wrong, loaded = done.stderr.splitlines()
    assert wrong == "0"
    assert "robustlab" in loaded.split()
    assert not set(loaded.split()) & set(HEAVY)


@pytest.mark.parametrize("group", GROUPS)
def test_every_group_of_the_table_exists(group):
    _, line = GROUPS[group]
    assert parser(group).params or parser(group).commands
    assert line.endswith(".")
    assert len(line) < 60


def test_help_names_every_group_and_fits_a_terminal(capsys):
    assert run(["--help"]) == 0
    text = capsys.readouterr().out
    assert text == help_text()
    assert all(f"  {name} " in text for name in GROUPS)
    assert max(map(len, text.splitlines())) <= 80


def test_no_command_is_a_usage_error_that_shows_the_help(capsys):
    assert run([]) == 2
    assert "What one can do first:\n  robustlab run first-light" in capsys.readouterr().out


def test_version(capsys):
    from importlib.metadata import version

    assert run(["--version"]) == 0
    assert capsys.readouterr().out.strip() == version("robustlab")


@pytest.mark.parametrize(
    ("error", "code"),
    [
        (InputError("p.h5", "no such file"), 3),
        (NoTrustworthyNumber("mu", "no answer"), 4),
        (UsageError("robustlab", "no such command"), 2),
        (OSError(28, "No space left on device", "out/r.h5"), 5),
        (OSError(30, "Read-only file system", "out/r.h5"), 5),
        (KeyboardInterrupt(), 130),
        (BrokenPipeError(), 141),
        (ZeroDivisionError("a bug"), 70),
        (OSError(2, "No such file or directory", "x"), 70),
    ],
)
def test_every_way_to_end_has_its_exit_code(error, code, capfd, monkeypatch, tmp_path):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    monkeypatch.setattr("os.dup2", lambda *_: None)

    def fail() -> int:
        raise error

    assert main_guard(fail) == code
    out, err = capfd.readouterr()
    assert out == ""
    assert len(err.strip().splitlines()) <= 2


def test_control_characters_of_a_message_do_not_reach_the_terminal(capsys):
    def fail() -> int:
        raise InputError("p\x1b[31m.h5", "evil \u202e name")

    assert main_guard(fail) == 3
    err = capsys.readouterr().err
    assert "\x1b" not in err
    assert "\u202e" not in err
