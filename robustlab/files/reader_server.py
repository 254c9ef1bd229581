"""A process that opens untrusted files for a whole run: it loads numpy and h5py once, and forks for each file.

What reads a file is a process of its own as before, with limits of its own, and ends with it; a crash or a hang there
ends nothing else. The server itself never sees a file's content but to hand it on. Where a system cannot fork, each
file gets a fresh interpreter.

A request is a line of JSON: what the reader is told, the seconds that it is waited for, and the number of bytes of a
document that follow. The answer is a line of JSON with the exit status and the lengths of stdout and stderr, and these.
"""

from __future__ import annotations

import atexit
import json
import os
import selectors
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from importlib import import_module
from typing import IO, Any, NamedTuple

NAME = "robustlab.files.reader_server"
LOADED = {  # kind of file -> what its reader needs; loaded before the first fork for one
    "hdf5": "robustlab.files.hdf5_reader", "matlab5": "robustlab.files.matlab",
    "table": "robustlab.files.text_table", "json": "robustlab.files.document", "toml": "robustlab.files.document",
}  # fmt: skip
STDERR = 1 << 16  # bytes of a reader's complaints that are kept
OVERDUE = 10.0  # s beyond a reader's time that the server is waited for; then it is taken for dead


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

    def ask(self, request: dict[str, Any], given: bytes, wait: float) -> Ended:
        """Have a file read. Raises OSError: the server cannot be started, or died while it was asked."""
        with self._lock:
            try:
                return self._asked(json.dumps({"reader": request, "wait": wait, "size": len(given)}), given, wait)
            except BaseException:  # an answer that is half read would be taken for the next one's
                self.close()
                raise

    def _asked(self, line: str, given: bytes, wait: float) -> Ended:
        process = self._running()
        stdin, stdout = process.stdin, process.stdout
        assert stdin is not None
        assert stdout is not None
        watch = threading.Timer(wait + OVERDUE, process.kill)
        watch.start()
        try:
            stdin.write(line.encode() + b"\n" + given)
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
                [sys.executable, "-P", "-m", NAME],
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


# --- the server's side ------------------------------------------------------------------------------------------------


def serve(requests: IO[bytes], answers: IO[bytes]) -> None:
    """Answer requests until there are no more."""
    while line := requests.readline():
        job = json.loads(line)
        given = requests.read(job["size"])
        needed = LOADED.get(job["reader"]["kind"])
        if needed is not None:
            import_module(needed)
        ended = _read_in_a_fork(job["reader"], given, job["wait"])
        head = {"status": ended.status, "out": len(ended.out), "err": len(ended.err), "late": ended.late}
        answers.write(json.dumps(head).encode() + b"\n" + ended.out + ended.err)
        answers.flush()


def _read_in_a_fork(request: dict[str, Any], given: bytes, wait: float) -> Ended:
    pipes = os.pipe(), os.pipe()
    child = os.fork()
    if child == 0:
        _be_the_reader(request, given, pipes)
    for _, end in pipes:
        os.close(end)
    found, late = _collected([start for start, _ in pipes], time.monotonic() + wait)
    if late:
        os.kill(child, signal.SIGKILL)
    _, status = os.waitpid(child, 0)
    return Ended(os.waitstatus_to_exitcode(status), found[0], found[1][-STDERR:], late)


def _be_the_reader(request: dict[str, Any], given: bytes, pipes: tuple[tuple[int, int], tuple[int, int]]) -> None:
    """The child: nothing of the server's is open in it; it does not come back."""
    status = 1
    try:
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        nothing = os.open(os.devnull, os.O_RDONLY)
        for source, target in ((nothing, 0), (pipes[0][1], 1), (pipes[1][1], 2)):
            os.dup2(source, target)
        os.closerange(3, max(64, *(end for pipe in pipes for end in pipe)) + 1)
        # By its name, as a fresh interpreter is told it: the readers' own front doors start this server.
        reader = import_module("robustlab.files.reader_process")
        with os.fdopen(1, "wb", closefd=False) as stream:
            status = reader.answered(request, stream, given)
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
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the parent, whose end closes the pipe
    serve(sys.stdin.buffer, sys.stdout.buffer)
