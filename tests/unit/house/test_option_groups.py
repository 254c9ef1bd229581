"""Option groups: the parser sees the fields in the group's place, the command receives one object."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import pytest
import typer
from typer.testing import CliRunner

from robustlab.cli.options import EffortOptions, grouped


@dataclass(frozen=True)
class Where:
    """Two options."""

    group: Annotated[str | None, typer.Option("--group", help="Of the file.")] = None
    dt: Annotated[float, typer.Option("--dt", help="In s.")] = 0.1


@dataclass(frozen=True)
class OnlyDt(Where):
    """The same without the group, and with another help."""

    group: None = None
    dt: Annotated[float, typer.Option("--dt", help="Sample time.")] = 0.2


def runner(kind):
    """A command of a file, a group of options and the effort; what it received."""
    app = typer.Typer(rich_markup_mode=None)
    got = []

    def command(*, file, where, effort):
        """Do it."""
        got.append((file, where, effort))

    command.__annotations__ = {"file": str, "where": kind, "effort": EffortOptions}
    app.command()(grouped(command))
    return got, lambda *words: CliRunner().invoke(app, words)


def test_a_command_receives_objects():
    got, run = runner(Where)
    assert run("a.h5", "--dt", "0.5", "--effort", "2").exit_code == 0
    assert got == [("a.h5", Where(None, 0.5), EffortOptions(2.0, None))]


@pytest.mark.parametrize(("words", "code"), [(("a.h5",), 0), (("a.h5", "--group", "g"), 2)])
def test_a_group_leaves_out_what_it_has_no_option_for(words, code):
    got, run = runner(OnlyDt)
    assert run(*words).exit_code == code
    assert got == ([("a.h5", OnlyDt(None, 0.2), EffortOptions())] if code == 0 else [])
    assert "Sample time." in run("--help").output
