"""Untrusted files are opened in a child process only: what crashes or hangs there is a finding about the file.

The reader process sends a JSON header (a tree or an error), then the tree's arrays. No pickle. One process serves a
whole run: it loads numpy and h5py once, and forks for each file; a crash or a hang in a fork ends nothing else. It is
asked with a line of JSON: what the reader is told, and the seconds that it is waited for; it answers with the exit
status and the lengths of stdout and stderr, and these. Where a system cannot fork, each file gets a fresh interpreter.
"""

from __future__ import annotations

import atexit
import json
import math
import os
import subprocess
import sys
import threading
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, NamedTuple

from robustlab.budget import child_environment
from robustlab.errors import EnvironmentFault, InputError
from robustlab.files.signature import Limits

if TYPE_CHECKING:
    from collections.abc import Callable

    import numpy as np

    from robustlab.files.tree import Tree


# The reader's own limit is processor time, which a busy machine does not use up; this many times as long is waited for
# one that sleeps.
PATIENCE = 4

READER = "robustlab.files.reader_process"
OVERDUE = 10.0  # s beyond a reader's time that the server is waited for; then it is taken for dead
MAGIC = b"RLTREE1\n"
DTYPES = {"f": "<f8", "i": "<i8", "b": "|b1", "c": "<c16"}


def send_tree(stream: BinaryIO, tree: Tree) -> None:
    """Write ``tree`` to ``stream``."""
    arrays: list[np.ndarray[Any, Any]] = []
    _header(stream, {"tree": _node(tree, arrays)})
    for array in arrays:
        stream.write(array.tobytes())
    stream.flush()


def send_error(stream: BinaryIO, error: InputError) -> None:
    """Write an error to ``stream`` in the place of a tree."""
    _header(stream, {"error": [error.where, error.found, error.expected, error.hint, list(error.more)]})
    stream.flush()


def receive(data: bytes, file: str) -> Tree:
    """Inverse of `send_tree` and `send_error`."""
    header, end = _header_of(data)
    return _Received(memoryview(data)[end:], file).tree(header["tree"], "/")


def _header_of(data: bytes) -> tuple[dict[str, Any], int]:
    """The JSON header and where it ends. Raises InputError: the error that was sent; ValueError: there is no header."""
    start = len(MAGIC) + 8
    if not data.startswith(MAGIC) or len(data) < start:
        raise ValueError("no header")
    end = start + int.from_bytes(data[len(MAGIC) : start], "little")
    header = json.loads(data[start:end])
    if "error" in header:
        where, found, expected, hint, more = header["error"]
        raise InputError(where, found, expected, hint, tuple(more))
    return header, end


def _header(stream: BinaryIO, content: dict[str, Any]) -> None:
    raw = json.dumps(content).encode()
    stream.write(MAGIC + len(raw).to_bytes(8, "little") + raw)


def _node(tree: Tree, arrays: list[np.ndarray[Any, Any]]) -> dict[str, Any]:
    return {
        "attrs": {name: _value(value, arrays) for name, value in tree.attrs.items()},
        "datasets": {
            name: [_value(d.values, arrays), {key: _value(item, arrays) for key, item in d.attrs.items()}]
            for name, d in tree.datasets.items()
        },
        "groups": {name: _node(group, arrays) for name, group in tree.groups.items()},
    }


def _value(value: Any, arrays: list[np.ndarray[Any, Any]]) -> list[Any]:
    from robustlab.files.tree import Unread

    if isinstance(value, Unread):
        return ["unread", value.dtype, list(value.shape)]
    if value.dtype.kind == "U":
        return ["text", value.ravel().tolist(), list(value.shape)]
    array = value.astype(DTYPES[value.dtype.kind], copy=False)
    arrays.append(array)
    return [DTYPES[value.dtype.kind], None, list(value.shape)]


class _Received:
    """Takes the arrays from the bytes in the order in which they were sent."""

    def __init__(self, data: memoryview, file: str) -> None:
        self.data, self.file, self.position = data, file, 0

    def tree(self, node: dict[str, Any], path: str) -> Tree:
        from robustlab.files.tree import Dataset, Tree

        tree = Tree(path=path, file=self.file)
        tree.attrs = {name: self.value(item) for name, item in node["attrs"].items()}
        for name, (values, attrs) in node["datasets"].items():
            tree.datasets[name] = Dataset(self.value(values), {key: self.value(item) for key, item in attrs.items()})
        for name, group in node["groups"].items():
            tree.groups[name] = self.tree(group, tree.child_path(name))
        return tree

    def value(self, item: list[Any]) -> Any:
        import numpy as np

        from robustlab.files.tree import Unread

        kind, content, shape = item[0], item[1], tuple(int(n) for n in item[2])
        if kind == "unread":
            return Unread(content, shape)
        if kind == "text":
            return np.array(content, dtype=np.str_).reshape(shape)
        if kind not in DTYPES.values():
            raise ValueError(f"unknown type {kind}")
        count = math.prod(shape)
        array = np.frombuffer(self.data, dtype=kind, count=count, offset=self.position) if count else np.zeros(0, kind)
        self.position += array.nbytes
        return array.reshape(shape)


HOSTILE = "do not open it with other programs either; get the file again from where it was made"


class Ended(NamedTuple):
    """How a reader ended."""

    status: int  # exit code; minus a signal's number
    out: bytes
    err: bytes
    late: bool = False  # it was ended because its time was over


class ReaderServer:
    """The parent's side: started when it is first asked, and started again where it has died."""

    def __init__(self, environment: Callable[[], dict[str, str]]) -> None:
        self._environment, self._lock = environment, threading.Lock()
        self._process: subprocess.Popen[bytes] | None = None
        self._owner = 0
        atexit.register(self.close)

    def ask(self, request: dict[str, Any], wait: float) -> Ended:
        """Have a file read. Raises OSError: the server cannot be started, or died while it was asked."""
        with self._lock:
            try:
                return self._asked(json.dumps({"reader": request, "wait": wait}), wait)
            except BaseException:  # an answer that is half read would be taken for the next one's
                self.close()
                raise

    def _asked(self, line: str, wait: float) -> Ended:
        process = self._running()
        stdin, stdout = process.stdin, process.stdout
        assert stdin is not None
        assert stdout is not None
        watch = threading.Timer(wait + OVERDUE, process.kill)
        watch.start()
        try:
            stdin.write(line.encode() + b"\n")
            stdin.flush()
            head = stdout.readline()
            answer: dict[str, Any] = json.loads(head) if head.endswith(b"\n") else {"out": 1, "err": 0}
            out, err = stdout.read(answer["out"]), stdout.read(answer["err"])
        finally:
            watch.cancel()
        if len(out) + len(err) < answer["out"] + answer["err"]:
            raise OSError(0, "the reader process has died")
        return Ended(answer["status"], out, err, answer["late"])

    def _running(self) -> subprocess.Popen[bytes]:
        if self._process is not None and (self._owner != os.getpid() or self._process.poll() is not None):
            self.close()  # of the process that this one was forked from, or dead
        if self._process is None:
            # -P: the folder the user happens to be in must not lend modules to the reader.
            self._process = subprocess.Popen(  # noqa: S603  our own interpreter with our own module
                [sys.executable, "-P", "-m", READER],
                stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, env=self._environment(),
            )  # fmt: skip
            self._owner = os.getpid()
        return self._process

    def close(self) -> None:
        """End the server."""
        process, self._process = self._process, None
        if process is None:
            return
        ours = self._owner == os.getpid()
        if ours:
            process.kill()
        for stream in (process.stdin, process.stdout):
            if stream is not None:
                with suppress(OSError):
                    stream.close()
        if ours:
            process.wait()
        else:
            process.returncode = 0  # who started it waits for it


def read_isolated(kind: str, path: str | Path, limits: Limits, group: str | None = None, **options: Any) -> Tree:
    """Read a file of kind ``hdf5``, ``matlab5`` or ``table`` in a process of its own.

    ``options`` go to the reader: of a table ``delimiter``, ``decimal``.
    """
    where = str(path)
    request = _request(kind, limits, path=str(Path(path).absolute()), shown=where, group=group, **options)
    return _taken(_ended(request, where, limits), where, limits)


def run_reader(command: list[str], where: str, limits: Limits) -> Tree:
    """Start ``command``, and take a tree or an error from its stdout."""
    return _taken(_fresh(command, where, limits), where, limits)


def _request(kind: str, limits: Limits, **arguments: Any) -> dict[str, Any]:
    return {"kind": kind, "limits": asdict(limits), **arguments}


def _ended(request: dict[str, Any], where: str, limits: Limits) -> Ended:
    """Have the file read by a fork of the server, or by a fresh interpreter where there can be none."""
    if hasattr(os, "fork"):
        with suppress(OSError):  # it could not be started, or died: a fresh interpreter tells why
            return _SERVER.ask(request, PATIENCE * limits.seconds)
    # -P: the folder the user happens to be in must not lend modules to the reader.
    command = [sys.executable, "-P", "-m", READER, json.dumps(request)]
    return _fresh(command, where, limits)


def _fresh(command: list[str], where: str, limits: Limits) -> Ended:
    try:
        done = subprocess.run(  # noqa: S603  our own interpreter with our own module
            command,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            env=_environment(),
            timeout=PATIENCE * limits.seconds,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return Ended(0, b"", b"", late=True)
    except (OSError, ValueError) as error:  # ValueError: a NUL in a path
        reason = getattr(error, "strerror", None) or error
        raise EnvironmentFault(where, f"the reader process cannot be started ({reason})") from error
    return Ended(done.returncode, done.stdout, done.stderr)


def _taken(done: Ended, where: str, limits: Limits) -> Tree:
    """What the reader sent. Raises InputError, EnvironmentFault: it crashed, hung, failed, or sent nonsense."""
    if done.late:
        raise _no_answer(where, f"{PATIENCE * limits.seconds:g} s")
    if done.status < 0:
        signal = -done.status
        if signal in _cpu_signals():
            raise _no_answer(where, "its processor time")
        raise InputError(where, f"reader crashed (signal {signal}); file is damaged or hostile", None, HOSTILE)
    if done.status > 0:
        last = done.err.decode(errors="replace").strip().splitlines()[-1:] or ["no message"]
        if "MemoryError" in last[0]:
            raise InputError(where, "needs more memory than the reader may use")
        raise EnvironmentFault(where, f"the reader process failed ({last[0][:200]})", None, "robustlab doctor")
    try:
        return receive(done.out, where)
    except InputError:
        raise
    except (ValueError, KeyError, TypeError, IndexError, RecursionError) as error:
        raise InputError(
            where, f"reader gave no valid answer ({error}); file is damaged or hostile", None, HOSTILE
        ) from None


def _no_answer(where: str, time: str) -> InputError:
    return InputError(where, f"reader gave no answer in {time}; file is damaged or hostile", None, HOSTILE)


def _cpu_signals() -> set[int]:
    import signal

    return {int(getattr(signal, "SIGXCPU", -1))}


def _environment() -> dict[str, str]:
    """That of a child process, without HDF5's plugins."""
    env = {key: value for key, value in child_environment().items() if not key.startswith("HDF5_")}
    return {**env, "HDF5_PLUGIN_PRELOAD": "::", "HDF5_USE_FILE_LOCKING": "FALSE"}  # ::, HDF5's word for no plugins


_SERVER = ReaderServer(_environment)
