"""Workers of a campaign: fresh interpreters on this machine, each with its own pipes, or many machines through Dask.

Those on this machine share no locks or queues, so that any of them may crash, hang or be killed at
any moment and only its own piece of work is concerned; a new one takes its place. Time limits follow the monotonic
clock.

Pebble 5.2's process pool starts as quickly (two workers answer after 1.3 to 2.0 s, ours after 1.4 to 1.9 s) and would
save about 150 lines, but three promises would break: its limits follow the wall clock; a worker that leaves with exit
code 0 is never missed, and its piece waits for ever; and multiprocessing's spawn runs the user's main script again in
every worker, so that a script without ``if __name__ == "__main__"`` cannot run a campaign.

Dask comes with ``pip install 'robustlab[cluster]'``, ``--cluster tcp://host:8786``. Each Dask worker gets one piece at
a time, pinned to it. The model goes there by value as plain bytes; functions go by their names, so a worker runs the
robustlab installed there, and one with other versions of the code is refused.
"""

from __future__ import annotations

import json
import queue
import subprocess
import sys
import tempfile
import threading
import time
from concurrent.futures import CancelledError
from typing import IO, Any

from robustlab.budget import child_environment
from robustlab.campaign.evaluation import (
    GRACE,
    STRUCK,
    Evaluator,
    Failure,
    Outcome,
    Payload,
    Piece,
    evaluator_of,
    perform,
)
from robustlab.campaign.settings import code_identity
from robustlab.campaign.worker_process import read_frame, write_frame
from robustlab.errors import DependencyMissing, EnvironmentFault

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

    ``payload``: the campaign.
    ``count``: how many processes.
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


CONNECT_SECONDS = 10.0
WATCH_SECONDS = 1.0
# An answer that a worker has is fetched in less; of one that died before, Dask waits for ever.
FETCH_SECONDS = 20.0
# A cluster without a single worker is given so long to get one.
EMPTY_SECONDS = 60.0

# In a Dask worker: the evaluator of the campaign it worked for last.
_here: dict[str, Evaluator] = {}


def identify() -> dict[str, str]:
    """Which code a worker runs; called there."""
    return code_identity()


def compute(key: str, payload: bytes, request: str) -> bytes:
    """One piece of work; called on a worker.

    ``key``: hash of the campaign, so that a worker builds its evaluator once.
    ``payload``: `Payload` as bytes; empty for a worker that had it before.
    ``request``: `Piece` as JSON.
    Returns: the answer; empty where the payload is needed once more.
    """
    if key not in _here:
        if not payload:
            return b""
        _here.clear()
        _here[key] = evaluator_of(Payload.from_bytes(payload))
    return perform(_here[key], json.loads(request))


class ClusterWorkers:
    """Workers of a Dask cluster; see `robustlab.campaign.evaluation.Workers`.

    ``payload``: the campaign.
    ``address``: of the scheduler, for example ``"tcp://host:8786"``.

    Raises DependencyMissing: dask.distributed is not installed. EnvironmentFault: nobody answers at the address; a
    worker has other versions of the code.
    """

    def __init__(self, payload: Payload, address: str) -> None:
        try:
            from distributed import Client
        except ImportError:
            raise DependencyMissing(
                "campaign --cluster", "needs dask.distributed", None, "pip install 'robustlab[cluster]'"
            ) from None
        self.address = address
        self._key, self._payload = payload.identity.hash, payload.to_bytes()
        try:
            self._client: Any = Client(address, timeout=CONNECT_SECONDS, set_as_default=False)
        except (OSError, ValueError) as error:
            raise EnvironmentFault(
                f"--cluster {address}", f"no Dask scheduler answers ({error})", None, "dask scheduler --port 8786"
            ) from None
        self._events: queue.SimpleQueue[tuple[str, Any]] = queue.SimpleQueue()
        self._known: set[str] = set()
        # Those who were sent the payload: with every piece it would be copied, and Dask keeps some of the copies.
        self._told: set[str] = set()
        self._pieces: dict[str, tuple[Piece, Any, float]] = {}
        self._watched = 0.0
        self._seen = time.monotonic()
        try:
            self._watch()
        except BaseException:
            self.close()
            raise

    def idle(self) -> int:
        """See `robustlab.campaign.evaluation.Workers`."""
        return len(self._known) - len(self._pieces)

    def start(self, piece: Piece) -> None:
        """See `robustlab.campaign.evaluation.Workers`."""
        self._give(min(self._known - self._pieces.keys()), piece)

    def _give(self, worker: str, piece: Piece) -> None:
        future = self._client.submit(
            compute,
            self._key,
            b"" if worker in self._told else self._payload,
            json.dumps(piece.to_json()),
            workers=[worker],
            allow_other_workers=False,
            pure=False,
            retries=0,
        )
        self._told.add(worker)
        self._pieces[worker] = (piece, future, time.monotonic())
        future.add_done_callback(lambda done: self._events.put((worker, done)))

    def wait(self, seconds: float) -> list[Outcome]:
        """See `robustlab.campaign.evaluation.Workers`."""
        outcomes: list[Outcome] = []
        try:
            outcomes += self._take(*self._events.get(timeout=max(0.0, min(seconds, WATCH_SECONDS))))
            while True:
                outcomes += self._take(*self._events.get_nowait())
        except queue.Empty:
            pass
        if time.monotonic() - self._watched >= WATCH_SECONDS:
            outcomes += self._watch()
        return outcomes

    def _take(self, worker: str, future: Any) -> list[Outcome]:
        if worker not in self._pieces or self._pieces[worker][1] is not future:
            return []  # an answer nobody waits for any more
        piece, _, started = self._pieces.pop(worker)
        seconds = time.monotonic() - started
        if future.status == "finished":
            try:
                answer = future.result(timeout=FETCH_SECONDS)
            except (TimeoutError, CancelledError):  # it died with the answer
                future.cancel()
                return [Outcome(piece, _ended(piece, seconds), seconds)]
            if answer:
                return [Outcome(piece, answer, seconds)]
            self._told.discard(worker)  # it is a new process, or has worked for somebody else
            self._give(worker, piece)
            return []
        error = future.exception() if future.status == "error" else None
        if error is None or type(error).__name__ == "KilledWorker":
            return [Outcome(piece, _ended(piece, seconds), seconds)]
        return [Outcome(piece, Failure(f"worker raised {type(error).__name__}: {error}"[:500]), seconds)]

    def _watch(self) -> list[Outcome]:
        """Look which workers are there: new ones are checked and used, the work of those that vanished is given back.

        A hung sample ends its worker process after its limit (see `robustlab.campaign.evaluation.perform`); Dask's
        nanny starts a new one.
        """
        self._watched = time.monotonic()
        try:
            there = set(self._client.scheduler_info(n_workers=-1)["workers"])
        except (OSError, TimeoutError) as error:
            raise EnvironmentFault(f"--cluster {self.address}", f"the scheduler does not answer ({error})") from None
        if self._client.status not in ("running", "connecting"):
            raise EnvironmentFault(f"--cluster {self.address}", "the scheduler is gone")
        self._known &= there
        self._told &= there
        self._known |= self._checked(there - self._known)
        if self._known:
            self._seen = time.monotonic()
        elif time.monotonic() - self._seen > EMPTY_SECONDS:
            raise EnvironmentFault(
                f"--cluster {self.address}", "has no workers", None, f"dask worker {self.address} --nthreads 1"
            )
        outcomes = []
        for worker in [worker for worker in self._pieces if worker not in there]:
            piece, future, started = self._pieces.pop(worker)
            future.cancel()
            seconds = time.monotonic() - started
            outcomes.append(Outcome(piece, _ended(piece, seconds), seconds))
        return outcomes

    def _checked(self, new: set[str]) -> set[str]:
        """Those of the new workers that run our code; any other is refused by name."""
        if not new:
            return set()
        ours = code_identity()
        answers = self._client.run(identify, workers=sorted(new), on_error="return")
        for worker, theirs in answers.items():
            if not isinstance(theirs, dict):
                if isinstance(theirs, OSError):  # it went away while it was asked
                    continue
                found = f"cannot run robustlab ({type(theirs).__name__}: {theirs})"
                raise EnvironmentFault(f"worker {worker}", found, None, "pip install robustlab on every machine")
            other = [
                f"{name} {theirs.get(name)} instead of {ours[name]}" for name in ours if theirs.get(name) != ours[name]
            ]
            if other:
                hint = "install the same versions on every machine"
                raise EnvironmentFault(f"worker {worker}", f"runs other code: {', '.join(other)}", None, hint)
        return {worker for worker, theirs in answers.items() if isinstance(theirs, dict)}

    def close(self) -> None:
        """See `evaluation.Workers`; what runs on the cluster is left to end, its answer is not heard."""
        for _, future, _ in self._pieces.values():
            future.cancel()
        self._pieces.clear()
        self._client.close(timeout=2)


def _ended(piece: Piece, seconds: float) -> Failure:
    """What a worker that vanished died of: of its own time limit, or of something else."""
    if seconds >= piece.limit + GRACE:
        return Failure(f"no answer in {piece.limit:g} s{STRUCK}", timeout=True)
    return Failure("worker crashed")
