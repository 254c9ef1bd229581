"""Worker processes on this machine: each a fresh interpreter with its own pipes.

No locks or queues are shared between them, so that any of them may crash, hang or be killed at any moment and only its
own piece of work is concerned; a new one takes its place. Time limits follow the monotonic clock.

Pebble 5.2's process pool starts as quickly (two workers answer after 1.3 to 2.0 s, ours after 1.4 to 1.9 s) and would
save about 150 lines, but three promises would break: its limits follow the wall clock; a worker that leaves with exit
code 0 is never missed, and its piece waits for ever; and multiprocessing's spawn runs the user's main script again in
every worker, so that a script without ``if __name__ == "__main__"`` cannot run a campaign.
"""

from __future__ import annotations

import json
import queue
import subprocess
import sys
import tempfile
import threading
import time
from typing import IO, Any

from robustlab.budget import child_environment
from robustlab.campaign.evaluation import STRUCK, Failure, Outcome, Payload, Piece
from robustlab.campaign.worker_process import read_frame, write_frame
from robustlab.errors import EnvironmentFault

# So many workers in a row that never began mean that none ever will.
MAX_STILLBORN = 5


class _Process:
    """One worker process, the thread that listens to it, and what it works on."""

    def __init__(self, payload: bytes, events: queue.SimpleQueue[tuple[_Process, bytes | None]]) -> None:
        self.piece: Piece | None = None
        self.started = self.deadline = 0.0
        self.ready = False
        self._events, self._payload = events, payload
        self._complaints: IO[Any] = tempfile.TemporaryFile()  # noqa: SIM115  closed with the process
        # -P: the folder the user happens to be in must not lend modules to the worker.
        command = [sys.executable, "-P", "-m", "robustlab.campaign.worker_process"]
        try:
            self._process = subprocess.Popen(  # noqa: S603  our own interpreter with our own module
                command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=self._complaints, env=child_environment()
            )
        except OSError:
            self._complaints.close()
            raise
        self._thread = threading.Thread(target=self._listen, daemon=True)
        self._thread.start()

    def start(self, piece: Piece) -> None:
        self.piece, self.started = piece, time.monotonic()
        self.deadline = self.started + piece.limit
        self._send(json.dumps(piece.to_json()).encode())

    def kill(self) -> None:
        """End it; whatever it still says is not heard."""
        self._process.kill()
        self._process.wait()
        self._thread.join()
        for stream in (self._process.stdin, self._process.stdout, self._complaints):
            try:
                assert stream is not None
                stream.close()
            except OSError:
                pass  # what was left to send has no receiver any more

    def last_words(self) -> str:
        """How the process ended, the same words whenever the cause is the same."""
        code = self._process.wait()
        self._complaints.seek(0)
        lines = self._complaints.read().decode(errors="replace").strip().splitlines()
        said = f": {lines[-1][:200]}" if lines and code > 0 else ""
        return f"worker crashed (signal {-code})" if code < 0 else f"worker left with exit code {code}{said}"

    def _listen(self) -> None:
        self._send(self._payload)
        assert self._process.stdout is not None
        while (frame := read_frame(self._process.stdout)) is not None:  # pyright: ignore[reportArgumentType]
            self._events.put((self, frame))
        self._events.put((self, None))

    def _send(self, content: bytes) -> None:
        try:
            assert self._process.stdin is not None
            write_frame(self._process.stdin, content)  # pyright: ignore[reportArgumentType]
        except OSError:
            pass  # it is dead: the listening thread sees the end of its output, and says so


class LocalWorkers:
    """Worker processes on this machine; see `robustlab.campaign.evaluation.Workers`.

    Parameters
    ----------
    payload
        The campaign.
    count
        How many processes.
    """

    def __init__(self, payload: Payload, count: int) -> None:
        self._payload = payload.to_bytes()
        self._events: queue.SimpleQueue[tuple[_Process, bytes | None]] = queue.SimpleQueue()
        self._stillborn = 0
        self._workers: list[_Process] = []
        for _ in range(count):
            self._workers.append(self._new())

    def _new(self) -> _Process:
        try:
            return _Process(self._payload, self._events)
        except OSError as error:
            self.close()
            raise EnvironmentFault("campaign", f"a worker cannot be started ({error.strerror or error})") from error

    @property
    def pids(self) -> list[int]:
        """Process ids of the workers that live now."""
        return [worker._process.pid for worker in self._workers]

    def idle(self) -> int:
        """See `robustlab.campaign.evaluation.Workers`."""
        return sum(worker.ready and worker.piece is None for worker in self._workers)

    def start(self, piece: Piece) -> None:
        """See `robustlab.campaign.evaluation.Workers`."""
        next(worker for worker in self._workers if worker.ready and worker.piece is None).start(piece)

    def wait(self, seconds: float) -> list[Outcome]:
        """See `robustlab.campaign.evaluation.Workers`."""
        busy = [worker for worker in self._workers if worker.piece is not None]
        until = min([time.monotonic() + seconds, *(worker.deadline for worker in busy)])
        outcomes: list[Outcome] = []
        try:
            outcomes += self._take(*self._events.get(timeout=max(0.0, until - time.monotonic())))
            while True:  # whoever has answered is not late
                outcomes += self._take(*self._events.get_nowait())
        except queue.Empty:
            pass
        now = time.monotonic()
        for worker in self._workers[:]:
            if worker.piece is not None and now >= worker.deadline:
                failure = Failure(f"no answer in {worker.piece.limit:g} s{STRUCK}", timeout=True)
                outcomes.append(Outcome(worker.piece, failure, now - worker.started))
                self._replace(worker)
        return outcomes

    def _take(self, worker: _Process, frame: bytes | None) -> list[Outcome]:
        if worker not in self._workers:  # the last words of one that was ended already
            return []
        piece, seconds = worker.piece, time.monotonic() - worker.started
        if frame is None:
            words = worker.last_words()
            self._stillborn = 0 if worker.ready else self._stillborn + 1
            if self._stillborn >= MAX_STILLBORN:
                raise EnvironmentFault("campaign", f"no worker can begin; the last {words}", None, "robustlab doctor")
            self._replace(worker)
            return [] if piece is None else [Outcome(piece, Failure(words), seconds)]
        worker.piece = None
        if piece is None:
            worker.ready, self._stillborn = True, 0
            return []
        return [Outcome(piece, frame, seconds)]

    def _replace(self, worker: _Process) -> None:
        self._workers.remove(worker)
        worker.kill()
        self._workers.append(self._new())

    def close(self) -> None:
        """See `robustlab.campaign.evaluation.Workers`."""
        while self._workers:
            self._workers.pop().kill()
