"""One piece of work, as it is sent to a worker of either kind, and what the worker does with it."""

from __future__ import annotations

import faulthandler
import json
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any, Protocol

from robustlab.campaign.evaluation import Evaluator, decode_delta
from robustlab.campaign.settings import Identity, model_from_bytes

# Limits beyond this (in s) are no limits, and more than the system's clock can be asked to wait for.
LONGEST = 1e7
# What is said of a sample that its time limit ended.
STRUCK = " (the time limit, so not repeatable)"
# A worker that nobody stopped (its parent was killed while it hung) ends itself so many seconds after its limit.
GRACE = 5.0


@dataclass(frozen=True)
class Piece:
    """Samples ``first .. last - 1``, or the check of one Delta.

    Attributes
    ----------
    alone
        One sample on its own, out of a tile that failed.
    limit
        Seconds after which the worker is taken for hung.
    attempts
        How often a worker died over it.
    delta
        For a check: the Delta to evaluate once more, as numbers.
    """

    first: int
    last: int
    limit: float
    alone: bool = False
    attempts: int = 0
    delta: tuple[float, ...] | None = None

    def __len__(self) -> int:
        return self.last - self.first

    def again(self) -> Piece:
        """The same work for another worker."""
        return replace(self, attempts=self.attempts + 1)

    def to_json(self) -> dict[str, Any]:
        """What the worker needs to know."""
        return {
            "first": self.first,
            "last": self.last,
            "limit": self.limit if self.limit < LONGEST else None,
            "alone": self.alone,
            "delta": None if self.delta is None else list(self.delta),
        }


@dataclass(frozen=True)
class Failure:
    """A worker did not answer: ``timeout`` tells a hung one from one that died."""

    reason: str
    timeout: bool = False


@dataclass(frozen=True)
class Outcome:
    """What became of a piece: the worker's answer, or a failure; and the seconds it took."""

    piece: Piece
    answer: bytes | Failure
    seconds: float


@dataclass(frozen=True)
class Payload:
    """A campaign by value, as every worker gets it: who it is, and the model as plain bytes."""

    identity: Identity
    model: bytes

    def to_bytes(self) -> bytes:
        """A line of JSON, then the model."""
        return json.dumps(self.identity.to_json()).encode() + b"\n" + self.model

    @classmethod
    def from_bytes(cls, data: bytes) -> Payload:
        """Inverse of `to_bytes`."""
        head, _, model = data.partition(b"\n")
        return cls(Identity.from_json(json.loads(head)), model)


class Workers(Protocol):
    """Processes that compute pieces, here or elsewhere; one piece at a time each."""

    def idle(self) -> int:
        """How many pieces could be started now."""
        ...

    def start(self, piece: Piece) -> None:
        """Give a piece to an idle worker."""
        ...

    def wait(self, seconds: float) -> Sequence[Outcome]:
        """Pieces that ended; waits for one at most so long. A piece beyond its limit is ended."""
        ...

    def close(self) -> None:
        """End all workers at once, whatever they do."""
        ...


def evaluator_of(payload: Payload) -> Evaluator:
    """The evaluator of a campaign in this process."""
    return Evaluator(model_from_bytes(payload.model, "campaign"), payload.identity.settings)


def perform(evaluator: Evaluator, request: Mapping[str, Any]) -> bytes:
    """Do one piece of work: the rows as bytes, or for a check a line of JSON."""
    with _end_when_hung(request["limit"]):
        if request["delta"] is not None:
            import numpy as np

            delta = decode_delta(evaluator.uncertain.blocks, np.array(request["delta"], dtype=np.float64))
            again = evaluator.evaluate(delta)
            return json.dumps({"value": again.value, "at": again.at, "accurate": bool(again.accurate)}).encode()
        if request["alone"]:
            return evaluator.alone(request["first"]).to_bytes()
        return evaluator.rows(request["first"], request["last"]).to_bytes()


@contextmanager
def _end_when_hung(limit: float | None) -> Iterator[None]:
    """End this process when the time is over; a thread in C does it, since hung native code never lets Python run."""
    if limit is None:
        yield
        return
    faulthandler.dump_traceback_later(limit + GRACE, exit=True, file=sys.__stderr__ or sys.stderr)
    try:
        yield
    finally:
        faulthandler.cancel_dump_traceback_later()
