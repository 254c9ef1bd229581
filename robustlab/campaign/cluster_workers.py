"""Workers on many machines through Dask: ``pip install 'robustlab[cluster]'``, ``--cluster tcp://host:8786``.

Each Dask worker gets one piece at a time, pinned to it. The model goes there by value as plain bytes; functions go by
their names, so a worker runs the robustlab installed there, and one with other versions of the code is refused.
"""

from __future__ import annotations

import json
import queue
import time
from concurrent.futures import CancelledError
from typing import Any

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
from robustlab.errors import DependencyMissing, EnvironmentFault

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

    Parameters
    ----------
    key
        Hash of the campaign, so that a worker builds its evaluator once.
    payload
        `Payload` as bytes; empty for a worker that had it before.
    request
        `Piece` as JSON.

    Returns
    -------
    bytes
        The answer; empty where the payload is needed once more.
    """
    if key not in _here:
        if not payload:
            return b""
        _here.clear()
        _here[key] = evaluator_of(Payload.from_bytes(payload))
    return perform(_here[key], json.loads(request))


class ClusterWorkers:
    """Workers of a Dask cluster; see `robustlab.campaign.evaluation.Workers`.

    Parameters
    ----------
    payload
        The campaign.
    address
        Of the scheduler, for example ``"tcp://host:8786"``.

    Raises
    ------
    DependencyMissing
        dask.distributed is not installed.
    EnvironmentFault
        Nobody answers at the address; a worker has other versions of the code.
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
