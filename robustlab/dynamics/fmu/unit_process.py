"""The parent's end of a unit: it runs in a child process, and what crashes or hangs there is one line here.

Messages between the two are a JSON header and float64 arrays. No pickle.
"""

from __future__ import annotations

import json
import math
import os
import shutil
import subprocess
import sys
import tempfile
import threading
import weakref
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any, BinaryIO, cast

import numpy as np

from robustlab.arrays import Array
from robustlab.budget import NOT_REPEATABLE, Budget, child_environment
from robustlab.checks import number
from robustlab.errors import (
    DependencyMissing,
    EnvironmentFault,
    InputError,
    NativeTimeout,
    NoTrustworthyNumber,
    RobustlabError,
)
from robustlab.provenance import file_sha256

LARGEST_HEADER = 1 << 28  # bytes; a description of 200 000 variables has a third of it
LARGEST_ARRAY = 1 << 33


def send(stream: BinaryIO, header: dict[str, Any], arrays: Sequence[Array] = ()) -> None:
    """Write one message."""
    plain = [np.ascontiguousarray(a, dtype="<f8") for a in arrays]
    raw = json.dumps({**header, "shapes": [a.shape for a in plain]}).encode()
    stream.write(len(raw).to_bytes(8, "little") + raw)
    for a in plain:
        stream.write(a.tobytes())
    stream.flush()


def receive(stream: BinaryIO) -> tuple[dict[str, Any], list[Array]]:
    """Read one message. Raises EOFError: the other end is gone; ValueError: what came is no message."""
    size = int.from_bytes(_exactly(stream, 8), "little")
    if size > LARGEST_HEADER:
        raise ValueError("no header")
    header = json.loads(_exactly(stream, size))
    arrays = []
    for shape in header.pop("shapes"):
        count = math.prod(int(n) for n in shape)
        if not 0 <= 8 * count <= LARGEST_ARRAY:
            raise ValueError("no array")
        arrays.append(np.frombuffer(bytearray(_exactly(stream, 8 * count)), dtype="<f8").reshape(shape))
    return header, arrays


def error_header(error: RobustlabError) -> dict[str, Any]:
    """An error as a message's header."""
    kind = "number" if isinstance(error, NoTrustworthyNumber) else "input"
    return {"error": [kind, error.where, error.found, error.expected, error.hint]}


def raise_sent(header: dict[str, Any]) -> None:
    """Raise the error that a header holds, if it does."""
    if "error" in header:
        kind, *said = header["error"]
        raise (NoTrustworthyNumber if kind == "number" else InputError)(*said)


def _exactly(stream: BinaryIO, size: int) -> bytes:
    data = stream.read(size) if size else b""
    if data is None or len(data) < size:
        raise EOFError
    return data


# Seconds at least for what is not the unit's own work: starting an interpreter, reading and unpacking the archive.
START_LIMIT, STARTING = 60.0, ("describe", "load")


class UnitProcess:
    """A unit in its child process, which is started when it is first asked and again after a crash.

    ``path``: file of the unit. It must stay as it is.
    ``time_limit``: seconds that the unit may take for one request.

    Raises InputError: no such file; DependencyMissing: FMPy is not installed.
    """

    def __init__(self, path: str | Path, time_limit: float) -> None:
        self.shown, self.path = str(path), Path(path).absolute()
        number(f"{path}: time_limit", time_limit, "a time in s", above=0)
        if not self.path.is_file():
            raise InputError(self.shown, "no such file", "a functional mock-up unit (.fmu)")
        if find_spec("fmpy") is None:
            raise DependencyMissing("fmpy", "not installed", "the package FMPy", "pip install 'robustlab[fmi]'")
        self.time_limit, self.kind = time_limit, ""
        self.sha256 = file_sha256(self.path)
        self._lock = threading.RLock()
        self._child: subprocess.Popen[bytes] | None = None
        self._owner, self._end = 0, lambda: None

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in vars(self).items() if name not in ("_lock", "_child", "_end")}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        self._lock, self._child, self._owner, self._end = threading.RLock(), None, 0, lambda: None

    def describe(self) -> dict[str, Any]:
        """The unit's description, see `robustlab.dynamics.fmu.description.read_description`; runs none of its code."""
        with self._lock:
            self._start()
            return self._exchange({"op": "describe"}, ())[0]

    def ask(self, request: dict[str, Any], arrays: Sequence[Array] = ()) -> tuple[dict[str, Any], list[Array]]:
        """Let the unit, loaded as its ``kind``, do what is asked.

        Raises NativeTimeout: no answer within the time limit; the child was ended; NoTrustworthyNumber: the unit
        crashed, or ended with an error; InputError: the file is not what it was.
        """
        with self._lock:
            if self._start():
                self._exchange({"op": "describe"}, ())
                self._exchange({"op": "load", "kind": self.kind}, ())
            return self._exchange(request, arrays)

    def load(self, kind: str) -> None:
        """Load the unit's library for model exchange or co-simulation; after `describe`."""
        self.kind = kind
        with self._lock:
            if self._start():
                self._exchange({"op": "describe"}, ())
            self._exchange({"op": "load", "kind": kind}, ())

    def close(self) -> None:
        """End the child."""
        with self._lock:
            self._end()
            self._child = None

    def _start(self) -> bool:
        """Start a child where there is none; whether it was started."""
        # A forked copy of this process must not talk to the child of the original.
        if self._child is not None and self._owner == os.getpid() and self._child.poll() is None:
            return False
        self._end()
        if file_sha256(self.path) != self.sha256:
            raise InputError(self.shown, "is not the file that it was", None, "make the plant anew")
        folder = tempfile.mkdtemp(prefix="robustlab-fmu-")
        # -P: the folder the user happens to be in must not lend modules to the child.
        command = [sys.executable, "-P", "-m", "robustlab.dynamics.fmu.worker", str(self.path), folder, self.shown]
        try:
            child = subprocess.Popen(  # noqa: S603  our own interpreter with our own module
                command,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                env=child_environment(),
            )
        except OSError as error:
            shutil.rmtree(folder, ignore_errors=True)
            raise EnvironmentFault(self.shown, f"the child process cannot be started ({error.strerror})") from error
        self._child, self._owner = child, os.getpid()
        self._end = weakref.finalize(self, _ended, child, folder, self._owner)
        return True

    def _exchange(self, request: dict[str, Any], arrays: Sequence[Array]) -> tuple[dict[str, Any], list[Array]]:
        child = self._child
        assert child is not None
        limit = max(START_LIMIT, self.time_limit) if request["op"] in STARTING else self.time_limit
        budget = Budget(time_limit=limit)

        def strike() -> None:
            budget.strike()
            child.kill()

        clock = threading.Timer(limit, strike)
        clock.daemon = True
        clock.start()
        try:
            send(cast(BinaryIO, child.stdin), request, arrays)
            header, found = receive(cast(BinaryIO, child.stdout))
        except (EOFError, OSError, ValueError, KeyError, TypeError):
            raise self._gone(request["op"], budget) from None
        except BaseException:  # Ctrl-C: an answer that comes later must not be taken for another one's
            self.close()
            raise
        finally:
            clock.cancel()
        raise_sent(header)
        return header, found

    def _gone(self, op: str, budget: Budget) -> Exception:
        """The error for a child that gave no answer."""
        child = self._child
        assert child is not None
        try:
            code = child.wait(timeout=5)
        except subprocess.TimeoutExpired:
            code = 0  # it lives and has sent no message
        self.close()
        if budget.struck:
            return NativeTimeout(
                self.shown,
                f"the unit gave no answer in its {self.time_limit:g} s; its process was ended",
                None,
                f"{NOT_REPEATABLE}; time_limit= gives it longer",
            )
        how = f"crashed (signal {-code})" if code < 0 else "gave no valid answer" if not code else f"ended with {code}"
        if op in ("describe", "load"):
            return InputError(self.shown, f"the unit {how} while it was loaded", None, "export the unit anew")
        return NoTrustworthyNumber(self.shown, f"the unit {how}", None, "its process is started anew when next asked")


def _ended(child: subprocess.Popen[bytes], folder: str, owner: int) -> None:
    """End the child and remove what was unpacked for it."""
    if os.getpid() != owner:
        return
    child.kill()
    child.wait()
    for pipe in (child.stdin, child.stdout):
        if pipe is not None:
            try:
                pipe.close()
            except BrokenPipeError:
                continue  # what was still to be sent has no reader
    shutil.rmtree(folder, ignore_errors=True)
