"""The process that reads untrusted files: it forks for each request, a line of JSON.

It never reads a file's content itself. A fork writes its answer to stdout (`robustlab.files.isolation`); if one ends
without an answer, the process exits with 128 + the fork's signal.
"""

from __future__ import annotations

import json
import os
import signal
import sys
from contextlib import suppress
from importlib import import_module
from typing import Any, BinaryIO

from robustlab.errors import InputError
from robustlab.files.isolation import send, send_tree
from robustlab.files.signature import MIB, Limits

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


def answer(request: dict[str, Any], stream: BinaryIO) -> None:
    """Read one file and send its tree or an error."""
    path, shown, limits = request.pop("path"), request.pop("shown"), Limits(**request.pop("limits"))
    kind, _ = request.pop("kind"), request.pop("wait")
    module, name = READERS[kind]
    try:
        limit_resources(kind, limits, os.stat(path).st_size)  # noqa: PTH116
        tree = getattr(import_module(module), name)(path, limits, shown=shown, **request)
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
        import_module(READERS[request["kind"]][0])
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


if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent handles Ctrl-C and closes the pipe
    serve(sys.stdin.buffer, sys.stdout.buffer)
