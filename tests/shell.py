"""The command ``robustlab`` in this process."""

import io
import json
from contextlib import redirect_stderr, redirect_stdout
from typing import Any, NamedTuple

from robustlab.cli import main_guard
from robustlab.cli import run_command as run

__all__ = ["Ending", "robustlab"]


class Ending(NamedTuple):
    """How a command ended, and what it printed."""

    code: int
    out: str
    err: str

    @property
    def json(self) -> Any:
        return json.loads(self.out)


def robustlab(*words: object, code: int | None = None) -> Ending:
    """Run a command; where its exit code is given, it must be that one."""
    with redirect_stdout(io.StringIO()) as out, redirect_stderr(io.StringIO()) as err:
        found = main_guard(lambda: run([str(word) for word in words]))
    ending = Ending(found, out.getvalue(), err.getvalue())
    assert code is None or found == code, ending
    return ending
