"""The child process that runs a unit: ``python -m robustlab.dynamics.fmu.worker FILE FOLDER SHOWN``.

`robustlab.dynamics.fmu.unit_process` starts it. Messages come on stdin and go out on what was stdout; the unit itself
finds both closed, so that nothing it prints reaches anybody. The child ends when its parent does, whatever the unit is
busy with, and takes the unpacked files with it.
"""

from __future__ import annotations

import os
import queue
import shutil
import sys
import threading
from typing import Any, BinaryIO

from robustlab.dynamics.fmu.description import read_description, unpack
from robustlab.dynamics.fmu.unit_process import error_header, receive, send
from robustlab.errors import InputError, NoTrustworthyNumber


def _own_streams() -> tuple[BinaryIO, BinaryIO]:
    """The two pipes under new numbers, with nothing left behind at 0, 1 and 2 for the unit."""
    requests, answers = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
    nothing = os.open(os.devnull, os.O_RDWR)
    for number in (0, 1, 2):
        os.dup2(nothing, number)
    return requests, answers


def _listen(requests: BinaryIO, waiting: queue.SimpleQueue[Any], folder: str) -> None:
    """Take requests; when the parent is gone, end at once, even from within the unit's own code."""
    try:
        while True:
            waiting.put(receive(requests))
    except (EOFError, OSError, ValueError):
        os.chdir(os.path.dirname(folder) or os.sep)  # noqa: PTH120
        shutil.rmtree(folder, ignore_errors=True)
        os._exit(0)


class _Session:
    """One unit."""

    def __init__(self, file: str, folder: str, shown: str) -> None:
        self.file, self.folder, self.shown = file, folder, shown
        self.description: dict[str, Any] = {}
        self.unit: Any = None

    def answer(self, request: dict[str, Any], arrays: list[Any]) -> tuple[dict[str, Any], list[Any]]:
        """Do what was asked."""
        op = request["op"]
        if op == "describe":
            self.description = read_description(self.file, self.shown)
            return self.description, []
        if op == "load":
            from robustlab.dynamics.fmu.native_unit import NativeUnit

            unpack(self.file, self.shown, self.folder)
            self.unit = NativeUnit(self.description, request["kind"], self.folder)
            return {}, []
        try:
            return self._run(op, request, arrays)
        except self.unit.call_error as error:
            raise self.unit.failed(str(error).rstrip(".")) from None

    def _run(self, op: str, request: dict[str, Any], arrays: list[Any]) -> tuple[dict[str, Any], list[Any]]:
        from robustlab.dynamics.fmu import unit_runs

        values = request["values"]
        if op == "start":
            return {}, unit_runs.started(self.unit, values)
        if op == "evaluate":
            x, u = arrays
            return unit_runs.evaluated(self.unit, values, x, u, request["derivatives"])
        if op == "integrate":
            t, coefficients, broken, *x0 = arrays
            start = x0[0] if x0 else None
            return {}, unit_runs.integrated(self.unit, values, request["rtol"], t, coefficients, broken, start)
        if op == "step":
            t, u = arrays
            return {}, unit_runs.stepped(self.unit, values, t, u, request["longest"])
        if op == "linear":
            return {}, unit_runs.linear_matrices(self.unit, values, *arrays)
        raise InputError(self.shown, f"request {op!r}", None)


def main(file: str, folder: str, shown: str) -> None:
    """Answer requests until the parent is gone."""
    requests, answers = _own_streams()
    os.chdir(folder)  # what the unit writes goes with the folder
    waiting: queue.SimpleQueue[Any] = queue.SimpleQueue()
    threading.Thread(target=_listen, args=(requests, waiting, folder), daemon=True).start()
    session = _Session(file, folder, shown)
    while True:
        request, arrays = waiting.get()
        try:
            header, found = session.answer(request, arrays)
        except (InputError, NoTrustworthyNumber) as error:
            header, found = error_header(error), []
        except MemoryError:
            header, found = error_header(NoTrustworthyNumber(shown, "needs more memory than there is")), []
        except Exception as error:  # noqa: BLE001  whatever FMPy or the unit makes Python raise is told to the parent
            text = f"{type(error).__name__}: {error}"[:300]
            header, found = error_header(NoTrustworthyNumber(shown, f"the child process failed ({text})")), []
        send(answers, header, found)


if __name__ == "__main__":
    main(*sys.argv[1:])
