"""The processes that read untrusted files: a server, which forks for each file, or a fresh interpreter for one.

It is told a JSON table: kind (``hdf5``, ``matlab5``, ``table``), the limits, what messages call the file, and its path.
It answers on stdout with a tree or an error; a crash or a hang is seen by the parent. Without an argument it is the
server (`robustlab.files.isolation` tells what it is asked), which never sees a file's content but to hand it on.
"""

from __future__ import annotations

import json
import os
import selectors
import signal
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from importlib import import_module
from typing import Any, BinaryIO

from robustlab.errors import InputError
from robustlab.files.isolation import Ended, send_error, send_tree
from robustlab.files.signature import MIB, Limits

# What Python, numpy and h5py (or scipy) take of the address space before a file is opened, with room to spare.
BASE_ADDRESS_SPACE = 2048 * MIB
# Each byte of a table: a line of one digit becomes a text, a pair with its number, and a float.
BASE_TABLE, GROWTH_OF_TABLE = 1024 * MIB, 64
# Nobody has added up what is nested in a MATLAB file: what it holds as bytes, as arrays and as float64.
GROWTH_OF_MATLAB = 3
# Processor time: honest files are read at many times these rates. Values of HDF5 add theirs when they are reached, so
# that a library that runs in circles in a spoiled header (it does) is ended soon.
BASE_SECONDS, BYTES_PER_SECOND, VALUES_PER_SECOND = 4, 4 * MIB, 32 * MIB


LOADED = {  # kind of file -> what its reader needs; loaded before the first fork for one
    "hdf5": "robustlab.files.hdf5_reader", "matlab5": "robustlab.files.matlab",
    "table": "robustlab.files.text_table",
}  # fmt: skip
STDERR = 1 << 16  # bytes of a reader's complaints that are kept


def _limit_resources(kind: str, limits: Limits, size: int) -> None:
    try:
        import resource
    except ImportError:  # Windows: the parent's time limit remains
        return
    seconds, memory = int(limits.seconds) + 1, BASE_ADDRESS_SPACE + 4 * limits.total
    if kind != "matlab5":
        seconds = min(seconds, BASE_SECONDS + size // BYTES_PER_SECOND)
    else:
        import_module("scipy.io")  # so that it does not count
        memory = GROWTH_OF_MATLAB * limits.total
    if kind == "table":
        memory = min(memory, BASE_TABLE + GROWTH_OF_TABLE * size)
    memory += _mapped()  # a fork begins with all that the server has loaded
    wanted = {
        resource.RLIMIT_AS: memory,
        resource.RLIMIT_CPU: seconds,
        resource.RLIMIT_CORE: 0,
        resource.RLIMIT_FSIZE: 0,  # a reader writes no files
    }
    for name, value in wanted.items():
        _, hard = resource.getrlimit(name)
        value = value if hard == resource.RLIM_INFINITY else min(value, hard)
        resource.setrlimit(name, (value, hard))


def _mapped() -> int:
    """Address space that this process has already, in bytes; 0 where the system does not tell."""
    try:
        with open("/proc/self/statm", encoding="ascii") as told:  # noqa: PTH123
            return int(told.read().split()[0]) * os.sysconf("SC_PAGE_SIZE")
    except (OSError, ValueError, IndexError):
        return 0


def _more_time(limits: Limits) -> Callable[[int], None]:
    """What the HDF5 reader calls with the bytes of values that it is about to read."""
    read = 0

    def allow(size: int) -> None:
        nonlocal read
        before, read = read, read + size
        try:
            import resource
        except ImportError:  # Windows: there is the parent's time limit alone
            return
        soft, hard = resource.getrlimit(resource.RLIMIT_CPU)
        more = read // VALUES_PER_SECOND - before // VALUES_PER_SECOND
        wanted = min(soft + more, int(limits.seconds) + 1)
        resource.setrlimit(resource.RLIMIT_CPU, (wanted if hard == resource.RLIM_INFINITY else min(wanted, hard), hard))

    return allow


def answered(request: dict[str, Any], answer: BinaryIO) -> int:
    """Read one file and send it; the exit code."""
    kind, shown, limits = request["kind"], request["shown"], Limits(**request["limits"])
    _limit_resources(kind, limits, os.stat(request["path"]).st_size)  # noqa: PTH116
    try:
        tree = _tree(kind, request, limits)
    except InputError as error:
        send_error(answer, error)
        return 0
    except MemoryError:
        send_error(answer, InputError(shown, "needs more memory than the reader may use"))
        return 0
    send_tree(answer, tree)
    return 0


def _tree(kind: str, request: dict[str, Any], limits: Limits) -> Any:
    path, shown = request["path"], request["shown"]
    if kind == "hdf5":
        from robustlab.files.hdf5_reader import read_hdf5

        return read_hdf5(path, limits, request["group"], shown, _more_time(limits))
    if kind == "matlab5":
        from robustlab.files.matlab import read_matlab5

        return read_matlab5(path, limits, shown)
    from robustlab.files.text_table import table_tree

    return table_tree(path, request["delimiter"], request["decimal"], limits, shown)


# --- the server -------------------------------------------------------------------------------------------------------


def serve(requests: BinaryIO, answers: BinaryIO) -> None:
    """Answer requests until there are no more."""
    while line := requests.readline():
        job = json.loads(line)
        needed = LOADED.get(job["reader"]["kind"])
        if needed is not None:
            import_module(needed)
        ended = _read_in_a_fork(job["reader"], job["wait"])
        head = {"status": ended.status, "out": len(ended.out), "err": len(ended.err), "late": ended.late}
        answers.write(json.dumps(head).encode() + b"\n" + ended.out + ended.err)
        answers.flush()


def _read_in_a_fork(request: dict[str, Any], wait: float) -> Ended:
    pipes = os.pipe(), os.pipe()
    child = os.fork()
    if child == 0:
        _be_the_reader(request, pipes)
    for _, end in pipes:
        os.close(end)
    found, late = _collected([start for start, _ in pipes], time.monotonic() + wait)
    if late:
        os.kill(child, signal.SIGKILL)
    _, status = os.waitpid(child, 0)
    return Ended(os.waitstatus_to_exitcode(status), found[0], found[1][-STDERR:], late)


def _be_the_reader(request: dict[str, Any], pipes: tuple[tuple[int, int], tuple[int, int]]) -> None:
    """The child: nothing of the server's is open in it; it does not come back."""
    status = 1
    try:
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        nothing = os.open(os.devnull, os.O_RDONLY)
        for source, target in ((nothing, 0), (pipes[0][1], 1), (pipes[1][1], 2)):
            os.dup2(source, target)
        os.closerange(3, max(64, *(end for pipe in pipes for end in pipe)) + 1)
        with os.fdopen(1, "wb", closefd=False) as stream:
            status = answered(request, stream)
    except BaseException as error:  # noqa: BLE001 - whatever it was, this process ends here, and the parent is told
        with suppress(OSError):
            os.write(2, f"{type(error).__name__}: {error}\n".encode(errors="replace"))
    finally:
        os._exit(status)


def _collected(ends: list[int], until: float) -> tuple[list[bytes], bool]:
    """What comes out of the pipes until both are closed, and whether the time was over before."""
    found: dict[int, list[bytes]] = {end: [] for end in ends}
    late = False
    with selectors.DefaultSelector() as watched:
        for end in ends:
            watched.register(end, selectors.EVENT_READ)
        while watched.get_map():
            ready = watched.select(max(0.0, until - time.monotonic()))
            if not ready and time.monotonic() >= until:
                late = True
                break
            for key, _ in ready:
                part = os.read(key.fd, 1 << 20)
                if part:
                    found[key.fd].append(part)
                else:
                    watched.unregister(key.fd)
    for end in ends:
        os.close(end)
    return [b"".join(found[end]) for end in ends], late


if __name__ == "__main__":
    if len(sys.argv) > 1:
        sys.exit(answered(json.loads(sys.argv[1]), sys.stdout.buffer))
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the parent, whose end closes the pipe
    serve(sys.stdin.buffer, sys.stdout.buffer)
