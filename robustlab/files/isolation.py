"""Open untrusted files in a child process only, so that a crash or a hang is reported as an error of the file.

One process (this module, run by the parent) serves a whole run: it loads numpy and h5py once, never reads a file's
content itself, and forks for each request, a line of JSON. A fork sends a JSON header (a tree or an error) and the
tree's arrays; no pickle. If one ends without an answer, the process exits with 128 + the fork's signal, and the next
file gets a new process.
"""

from __future__ import annotations

import atexit
import json
import math
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict
from importlib import import_module
from pathlib import Path
from typing import IO, Any, BinaryIO

import numpy as np

from robustlab.budget import child_environment
from robustlab.errors import EnvironmentFault, InputError
from robustlab.files.file_types import MIB, Limits
from robustlab.files.tree import Dataset, Tree, Unread

# The reader's own limit is processor time; a sleeping one is ended after this many times as long.
PATIENCE = 4
OVERDUE = 10.0  # s after a reader's time until the process is killed
MAGIC = b"RLTREE1\n"
DTYPES = {"f": "<f8", "i": "<i8", "b": "|b1", "c": "<c16"}
HOSTILE = "do not open it with other programs either; get the file again from where it was made"
# -P: the reader must not import modules from the working directory.
READER = (sys.executable, "-P", "-m", "robustlab.files.isolation")
# Address space of Python, numpy and h5py (or scipy) before a file is opened, with a reserve.
BASE_ADDRESS_SPACE = 2048 * MIB
# Memory a byte of a table: a line of one digit becomes a text, a pair with its number, and a float.
BASE_TABLE, GROWTH_OF_TABLE = 1024 * MIB, 64
# Sizes nested in a MATLAB file are unknown: it is in memory as bytes, as arrays and as float64.
GROWTH_OF_MATLAB = 3
# Processor time: valid files are read at many times this rate; an endless loop in a library is ended soon.
BASE_SECONDS, BYTES_PER_SECOND = 4, 4 * MIB
# Kind of file -> module and function that read it; loaded before the first fork.
READERS = {
    "hdf5": ("robustlab.files.hdf5_reader", "read_hdf5"),
    "matlab5": ("robustlab.files.matlab", "read_matlab5"),
    "table": ("robustlab.files.text_table", "table_tree"),
}


def send_tree(stream: BinaryIO, tree: Tree) -> None:
    arrays: list[np.ndarray[Any, Any]] = []

    def value(values: Any) -> list[Any]:
        if isinstance(values, Unread):
            return ["unread", values.dtype, list(values.shape)]
        if values.dtype.kind == "U":
            return ["text", values.ravel().tolist(), list(values.shape)]
        arrays.append(values.astype(DTYPES[values.dtype.kind], copy=False))
        return [DTYPES[values.dtype.kind], None, list(values.shape)]

    def attributes(of: Tree | Dataset) -> dict[str, Any]:
        return {name: value(item) for name, item in of.attrs.items()}

    def node(tree: Tree) -> dict[str, Any]:
        attrs = attributes(tree)  # the arrays follow in this order
        datasets = {name: [value(d.values), attributes(d)] for name, d in tree.datasets.items()}
        return {"attrs": attrs, "datasets": datasets, "groups": {name: node(g) for name, g in tree.groups.items()}}

    send(stream, {"tree": node(tree)})
    for array in arrays:
        stream.write(array.tobytes())
    stream.flush()


def send(stream: BinaryIO, content: dict[str, Any]) -> None:
    """Write a header to ``stream``: a tree, or an ``error`` or ``fault`` instead."""
    raw = json.dumps(content).encode()
    stream.write(MAGIC + len(raw).to_bytes(8, "little") + raw)
    stream.flush()


def receive(stream: IO[bytes], file: str) -> Tree:
    """Invert `send_tree`. Raises InputError: the error sent; EOFError: no more data; ValueError and others: invalid."""

    def take(size: int) -> bytes:
        data = stream.read(size)
        if len(data) < size:
            raise EOFError("it ends too early")
        return data

    def value(item: list[Any]) -> Any:
        kind, content, shape = item[0], item[1], tuple(int(n) for n in item[2])
        if kind == "unread":
            return Unread(content, shape)
        if kind == "text":
            return np.array(content, dtype=np.str_).reshape(shape)
        if kind not in DTYPES.values():
            raise ValueError(f"unknown type {kind}")
        return np.frombuffer(take(math.prod(shape) * np.dtype(kind).itemsize), dtype=kind).reshape(shape)

    def tree(node: dict[str, Any], path: str) -> Tree:
        made = Tree(path=path, file=file)
        made.attrs = {name: value(item) for name, item in node["attrs"].items()}
        for name, (values, attrs) in node["datasets"].items():
            made.datasets[name] = Dataset(value(values), {key: value(item) for key, item in attrs.items()})
        for name, group in node["groups"].items():
            made.groups[name] = tree(group, made.child_path(name))
        return made

    if take(len(MAGIC)) != MAGIC:
        raise ValueError("no header")
    header = json.loads(take(int.from_bytes(take(8), "little")))
    if "error" in header:
        where, found, expected, hint, more = header["error"]
        raise InputError(where, found, expected, hint, tuple(more))
    if "fault" in header:
        raise EnvironmentFault(file, f"the reader process failed ({header['fault']})", None, "robustlab doctor")
    return tree(header["tree"], "/")


def limit_resources(kind: str, limits: Limits, size: int) -> None:
    """Limit memory and processor time of this process, and forbid writing files."""
    try:
        import resource
    except ImportError:  # Windows: the parent's time limit remains
        return
    seconds = min(int(limits.seconds) + 1, BASE_SECONDS + size // BYTES_PER_SECOND)
    memory = BASE_ADDRESS_SPACE + 4 * limits.total
    if kind == "matlab5":
        import_module("scipy.io")  # before the measurement of memory
        memory = GROWTH_OF_MATLAB * limits.total
    if kind == "table":
        memory = min(memory, BASE_TABLE + GROWTH_OF_TABLE * size)
    with suppress(OSError, ValueError, IndexError), open("/proc/self/statm", encoding="ascii") as pages:  # noqa: PTH123
        memory += int(pages.read().split()[0]) * os.sysconf("SC_PAGE_SIZE")  # a fork starts with this much
    wanted = {
        resource.RLIMIT_AS: memory, resource.RLIMIT_CPU: seconds, resource.RLIMIT_CORE: 0, resource.RLIMIT_FSIZE: 0,
    }  # fmt: skip
    for name, value in wanted.items():
        _, hard = resource.getrlimit(name)
        resource.setrlimit(name, (value if hard == resource.RLIM_INFINITY else min(value, hard), hard))


def reader(kind: str) -> Callable[..., Tree]:
    module, name = READERS[kind]
    return getattr(import_module(module), name)


def answer(request: dict[str, Any], stream: BinaryIO) -> None:
    """Read one file and send its tree or an error."""
    path, shown, limits = request.pop("path"), request.pop("shown"), Limits(**request.pop("limits"))
    kind, _ = request.pop("kind"), request.pop("wait")
    try:
        limit_resources(kind, limits, os.stat(path).st_size)  # noqa: PTH116
        tree = reader(kind)(path, limits, shown=shown, **request)
    except InputError as error:
        send(stream, {"error": [error.where, error.found, error.expected, error.hint, list(error.more)]})
    except MemoryError:
        send(stream, {"error": [shown, "needs more memory than the reader may use", None, None, []]})
    except Exception as error:  # noqa: BLE001  reported by the parent
        send(stream, {"fault": f"{type(error).__name__}: {error}"[:200]})
    else:
        send_tree(stream, tree)


def serve(requests: BinaryIO, answers: BinaryIO) -> None:
    """Answer requests until the end of the stream, or until a reader ends without an answer."""
    while line := requests.readline():
        request = json.loads(line)
        reader(request["kind"])  # loaded before the fork
        if not hasattr(os, "fork"):
            return answer(request, answers)  # a process for each file
        child = os.fork()
        if child == 0:
            status = 1
            try:
                os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
                signal.setitimer(signal.ITIMER_REAL, request["wait"])
                answer(request, answers)
                status = 0
            finally:
                os._exit(status)
        status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        if status:
            os._exit(status if status > 0 else 128 - status)
    return None


class ReaderServer:
    """The parent's side of the reader process, which is started on use and after it ended."""

    process: subprocess.Popen[bytes] | None = None

    def __init__(self, command: tuple[str, ...] = READER) -> None:
        self.command, self._lock, self._owner = command, threading.Lock(), 0
        atexit.register(self.close)

    def read(self, kind: str, path: str | Path, limits: Limits, **options: Any) -> Tree:
        """Read a file of kind ``hdf5``, ``matlab5`` or ``table``."""
        where, wait = str(path), PATIENCE * limits.seconds
        request = {"kind": kind, "limits": asdict(limits), "path": str(Path(path).absolute()), "shown": where,
                   "wait": wait, **options}  # fmt: skip
        with self._lock:
            process = self._running(where)
            stdin, stdout = process.stdin, process.stdout
            assert stdin is not None
            assert stdout is not None
            late = threading.Event()
            watch = threading.Timer(wait + OVERDUE, lambda: (late.set(), process.kill()))
            watch.start()
            try:
                with suppress(BrokenPipeError):  # it has ended; its message or exit code gives the reason
                    stdin.write(json.dumps(request).encode() + b"\n")
                    stdin.flush()
                return receive(stdout, where)
            except (InputError, EnvironmentFault):
                raise
            except EOFError:
                status = process.wait()
                self.close()
                raise _ended(where, status, late.is_set(), wait) from None
            except (ValueError, KeyError, TypeError, IndexError, RecursionError) as error:
                self.close()  # the remaining output would be read as the next answer
                found = f"reader gave no valid answer ({error}); file is damaged or hostile"
                raise InputError(where, found, None, HOSTILE) from None
            except BaseException:
                self.close()
                raise
            finally:
                watch.cancel()

    def _running(self, where: str) -> subprocess.Popen[bytes]:
        if self.process is not None and (self._owner != os.getpid() or self.process.poll() is not None):
            self.close()  # it belongs to the parent of a fork, or has ended
        if self.process is None:
            environment = {key: value for key, value in child_environment().items() if not key.startswith("HDF5_")}
            # "::" is HDF5's word for no plugins
            environment |= {"HDF5_PLUGIN_PRELOAD": "::", "HDF5_USE_FILE_LOCKING": "FALSE"}
            try:
                self.process = subprocess.Popen(  # noqa: S603  our own interpreter with our own module
                    self.command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
                    env=environment,
                )  # fmt: skip
            except OSError as error:
                reason = error.strerror or error
                raise EnvironmentFault(where, f"the reader process cannot be started ({reason})") from error
            self._owner = os.getpid()
        return self.process

    def close(self) -> None:
        process, self.process = self.process, None
        if process is None:
            return
        ours = self._owner == os.getpid()
        if ours:
            process.kill()
        for stream in filter(None, (process.stdin, process.stdout)):
            with suppress(OSError):
                stream.close()
        if ours:
            process.wait()
        else:
            process.returncode = 0  # the parent waits for it


def _ended(where: str, status: int, late: bool, wait: float) -> InputError | EnvironmentFault:
    """Return the reason of a reader without answer by its exit code: 128 + signal of the fork, or -signal."""
    number = status - 128 if status > 128 else -status
    timers = [getattr(signal, name, None) for name in ("SIGALRM", "SIGXCPU")]
    if late or number in timers:
        time = "its processor time" if number == timers[1] else f"{wait:g} s"
        found = f"reader gave no answer in {time}; file is damaged or hostile"
    elif number > 0:
        found = f"reader crashed (signal {number}); file is damaged or hostile"
    else:
        return EnvironmentFault(where, f"the reader process ended with exit code {status}", None, "robustlab doctor")
    return InputError(where, found, None, HOSTILE)


_SERVER = ReaderServer()
read_isolated = _SERVER.read


if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent handles Ctrl-C and closes the pipe
    serve(sys.stdin.buffer, sys.stdout.buffer)
