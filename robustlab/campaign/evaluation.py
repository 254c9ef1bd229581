"""The value of sample i: a pure function of uncertain model, settings and i.

This is the one module of the room that knows metrics and searches. Samples are computed in tiles of fixed borders
(sample i belongs to tile ``i // tile``, a whole tile is computed even where it reaches beyond n), because a stack of
members shares its scaling in the matrix exponential: with other neighbours the last digit of a value could change.
So the answer depends neither on the number of workers nor on n nor on where an earlier run was interrupted.

A `Work` is one piece of it, as it is sent to a worker of either kind.
"""

from __future__ import annotations

import faulthandler
import json
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

import numpy as np

from robustlab.arrays import Array
from robustlab.campaign.settings import CampaignSettings, Identity, model_from_bytes
from robustlab.errors import NoTrustworthyNumber, plain_text
from robustlab.statespace import real_array
from robustlab.uncertainty.blocks import Block
from robustlab.uncertainty.lft import UncertainModel
from robustlab.worst_case_analysis.draws import delta_of_sample
from robustlab.worst_case_analysis.ensemble import delta_stack
from robustlab.worst_case_analysis.metric_contract import Evaluation
from robustlab.worst_case_analysis.metrics import MetricRequest, make_metric
from robustlab.worst_case_analysis.worst_case_search import worst_case

DONE, LOST = 0, 1
# Samples in a tile. It decides the last digits of a value, so it is no matter of taste.
TILE = 64
# Operations in a tile, roughly: a tile of a large model is smaller, so that its time limit stays near that of a sample.
TILE_WORK = 2e9
# The limit of a search is the limit of its sample, which whoever started the worker enforces; the search itself ends
# where nothing helps any more.
TO_THE_END = 1e9


@dataclass(frozen=True)
class Rows:
    """Consecutive samples, as they come from a worker."""

    first: int  # index of the first one
    values: Array  # the metric, shape (k,); NaN where a sample is lost
    deltas: Array  # normalised Deltas as numbers, shape (k, width); see `encode_delta`
    seconds: Array  # time each one took, shape (k,); samples computed together share their time evenly
    lost: Mapping[int, str] = field(default_factory=dict)  # index -> reason, for samples that gave no value

    def __len__(self) -> int:
        return len(self.values)

    def up_to(self, n: int) -> Rows:
        """The samples with an index below ``n``."""
        count = max(0, min(len(self), n - self.first))
        lost = {index: reason for index, reason in self.lost.items() if index < n}
        return Rows(self.first, self.values[:count], self.deltas[:count], self.seconds[:count], lost)

    def followed_by(self, others: Sequence[Rows]) -> Rows:
        """These samples and those that come next, in one piece."""
        parts = [self, *others]
        return Rows(
            self.first,
            np.concatenate([part.values for part in parts]),
            np.concatenate([part.deltas for part in parts]),
            np.concatenate([part.seconds for part in parts]),
            {index: reason for part in parts for index, reason in part.lost.items()},
        )

    def to_bytes(self) -> bytes:
        """A line of JSON, then the arrays as little-endian float64."""
        head = {"first": self.first, "shape": list(self.deltas.shape), "lost": list(self.lost.items())}
        arrays = [array.astype("<f8").tobytes() for array in (self.values, self.deltas, self.seconds)]
        return b"".join([json.dumps(head).encode(), b"\n", *arrays])

    @classmethod
    def from_bytes(cls, data: bytes) -> Rows:
        """Inverse of `to_bytes`. Raises ValueError: the bytes are something else."""
        head, _, body = data.partition(b"\n")
        content = json.loads(head)
        count, width = (int(size) for size in content["shape"])
        numbers = np.frombuffer(body, dtype="<f8").astype(np.float64)
        if numbers.size != count * (width + 2):
            raise ValueError(f"{numbers.size} numbers for {count} samples of width {width}")
        values, deltas, seconds = np.split(numbers, [count, count * (width + 1)])
        lost = {int(index): str(reason) for index, reason in content["lost"]}
        return cls(int(content["first"]), values, deltas.reshape(count, width), seconds, lost)


def delta_width(blocks: Sequence[Block]) -> int:
    """Number of real numbers that `encode_delta` needs."""
    return sum(block.n_coordinates for block in blocks)


def encode_delta(blocks: Sequence[Block], values: Mapping[str, Any]) -> Array:
    """Delta as real numbers, shape (width,): one for a real scalar, real and imaginary parts of all entries else."""
    parts = [block.coordinates(values[block.name]) for block in blocks]
    return np.concatenate([np.zeros(0), *parts], dtype=np.float64)


def decode_delta(blocks: Sequence[Block], numbers: Array) -> dict[str, Any]:
    """Inverse of `encode_delta`.

    Examples
    --------
    >>> from robustlab.uncertainty.blocks import ComplexScalar, RealScalar
    >>> blocks = [RealScalar("k"), ComplexScalar("c")]
    >>> decode_delta(blocks, encode_delta(blocks, {"k": 0.5, "c": 0.1 - 0.2j}))
    {'k': 0.5, 'c': (0.1-0.2j)}
    """
    values: dict[str, Any] = {}
    start = 0
    for block in blocks:
        stop = start + block.n_coordinates
        values[block.name] = block.value_at(numbers[start:stop])
        start = stop
    return values


class Evaluator:
    """Computes the samples of one campaign.

    ``uncertain``: the set of models.
    ``settings``: what to compute.

    Raises UsageError, InputError, NoTrustworthyNumber: what the metric refuses: unknown names, complex blocks in time,
    an unstable nominal model.
    """

    def __init__(self, uncertain: UncertainModel, settings: CampaignSettings) -> None:
        self.uncertain, self.settings = uncertain, settings
        self._judge = make_metric(uncertain, _request(uncertain, settings), "campaign")
        self.tile = _tile_size(self._judge.uncertain.M.n_states, settings)
        self._reals = [block.name for block in uncertain.blocks if block.interval]

    @property
    def unit(self) -> str:
        """Unit of the values."""
        return self._judge.unit

    @property
    def sense(self) -> int:
        """1 where the largest value of the metric is the worst, -1 where the smallest is."""
        return 1 if self._judge.sense > 0 else -1

    @property
    def location(self) -> str:
        """What the place is at which a value is attained, for example ``"t [s]"``."""
        return self._judge.location

    def delta(self, index: int) -> dict[str, Any]:
        """Delta of a sample or a vertex: block name -> normalised value. A search finds its own: zero here."""
        blocks, seed = self.uncertain.blocks, self.settings.seed
        if self.settings.kind == "search":
            return {block.name: block.zero for block in blocks}
        if self.settings.kind == "samples":
            return delta_of_sample(blocks, seed, index)
        values = delta_of_sample(blocks, seed, index, boundary=True)
        return {**values, **dict(zip(self._reals, self._signs(index), strict=True))}

    def _signs(self, index: int) -> list[float]:
        """Vertex of the real deltas: the binary digits of the index, or random where not all of them are asked for."""
        k = len(self._reals)
        if 2**k <= self.settings.n:
            return [float(2 * (index >> (k - 1 - j) & 1) - 1) for j in range(k)]
        rng = np.random.default_rng(np.random.SeedSequence(self.settings.seed, spawn_key=(index, 2)))
        return (2.0 * rng.integers(0, 2, k) - 1.0).tolist()

    def rows(self, first: int, last: int) -> Rows:
        """Samples ``first .. last - 1``, both multiples of the tile; one that raises is computed sample by sample."""
        parts = [self._tile(start) for start in range(first, last, self.tile)]
        return parts[0].followed_by(parts[1:])

    def alone(self, index: int) -> Rows:
        """One sample on its own, its exception caught; this is what a failed tile is made of."""
        return self._guarded(index)

    def evaluate(self, delta: Mapping[str, Any]) -> Evaluation:
        """The metric at one Delta through the second path, with which a worst sample is checked."""
        return self._judge.evaluate(delta)

    def agrees(self, value: float, again: float, accurate: bool) -> bool:
        """Whether a value and its re-evaluation are the same number."""
        if not (np.isfinite(value) and np.isfinite(again)):
            return value == again and accurate
        slack = max(self._judge.slack(value), self._judge.slack(again))
        # A second path that may look between grid points can find a worse value: that is no disagreement.
        beyond = self._judge.sense * (again - value)
        return accurate and -slack <= beyond and (self._judge.one_sided or beyond <= slack)

    def _tile(self, first: int) -> Rows:
        if self.tile == 1:
            return self._guarded(first)
        started = time.perf_counter()
        deltas = [self.delta(index) for index in range(first, first + self.tile)]
        try:
            values = self._values(deltas)
        except Exception:  # noqa: BLE001  one sample spoils the stack; which one, and how, is found out below
            values = np.full(len(deltas), np.nan)
        if np.isnan(values).any():
            parts = [self._guarded(index) for index in range(first, first + self.tile)]
            return parts[0].followed_by(parts[1:])
        seconds = np.full(len(deltas), (time.perf_counter() - started) / len(deltas))
        return Rows(first, values, np.stack([encode_delta(self.uncertain.blocks, d) for d in deltas]), seconds)

    def _guarded(self, index: int) -> Rows:
        """One sample; what it raises becomes the reason why it is lost."""
        started = time.perf_counter()
        delta, value, reason = self.delta(index), np.nan, ""
        try:
            value, delta = self._search(index) if self.settings.kind == "search" else self._single(delta)
        except Exception as error:  # noqa: BLE001  whatever a sample raises concerns this sample alone
            reason = plain_text(f"{type(error).__name__}: {error}")[:500]
        if not reason and np.isnan(value):
            reason = "the metric is not a number"
        seconds = np.array([time.perf_counter() - started])
        numbers = encode_delta(self.uncertain.blocks, delta)[None]
        return Rows(index, np.array([value]), numbers, seconds, {index: reason} if reason else {})

    def _single(self, delta: dict[str, Any]) -> tuple[float, dict[str, Any]]:
        return float(self._values([delta])[0]), delta

    def _values(self, deltas: list[dict[str, Any]]) -> Array:
        return np.asarray(self._judge.values(delta_stack(self._judge.uncertain.blocks, deltas)), dtype=np.float64)

    def _search(self, index: int) -> tuple[float, dict[str, Any]]:
        s = self.settings
        own = np.random.SeedSequence(s.seed, spawn_key=(index, 3)).generate_state(2)
        asked = vars(_request(self.uncertain, s))
        found = worst_case(self.uncertain, **asked, n=s.starts, seed=int(own[0]), effort=TO_THE_END)
        if not found.status.trustworthy:
            raise NoTrustworthyNumber(
                "search", f"{found.status}: {found.search_value:.9g} found, {found.value:.9g} when evaluated again"
            )
        return found.value, dict(found.delta)

    def blank(self, index: int, reason: str, seconds: float) -> Rows:
        """The row of a sample that never came back: its Delta and why."""
        numbers = encode_delta(self.uncertain.blocks, self.delta(index))[None]
        return Rows(index, np.array([np.nan]), numbers, np.array([seconds]), {index: reason})

    @property
    def width(self) -> int:
        """Numbers per Delta."""
        return delta_width(self.uncertain.blocks)


def _request(uncertain: UncertainModel, s: CampaignSettings) -> MetricRequest:
    clock = None if s.t_end is None else _clock(uncertain, s, s.t_end)
    return MetricRequest(s.metric, s.output, s.input, clock, s.u, s.hold, s.band)


def _tile_size(n_states: int, settings: CampaignSettings) -> int:
    """Samples per tile; it depends on the campaign alone, and never on how fast a machine is."""
    if settings.kind == "search":
        return 1
    work = (n_states + 1) ** 2 * (settings.points + 100 + 30 * n_states)
    return max(1, min(TILE, int(TILE_WORK / work)))


def _clock(uncertain: UncertainModel, settings: CampaignSettings, t_end: float) -> Array:
    if uncertain.dt:
        return real_array("t", uncertain.dt * np.arange(max(2, round(t_end / uncertain.dt) + 1)), 1)
    return real_array("t", np.linspace(0.0, t_end, settings.points), 1)


# Limits beyond this (in s) are no limits, and more than the system's clock can be asked to wait for.
LONGEST = 1e7
# What is said of a sample that its time limit ended.
STRUCK = " (the time limit, so not repeatable)"
# A worker that nobody stopped (its parent was killed while it hung) ends itself so many seconds after its limit.
GRACE = 5.0


@dataclass(frozen=True)
class Piece:
    """Samples ``first .. last - 1``, or the check of one Delta."""

    first: int
    last: int
    limit: float  # seconds after which the worker is taken for hung
    alone: bool = False  # one sample on its own, out of a tile that failed
    attempts: int = 0  # how often a worker died over it
    delta: tuple[float, ...] | None = None  # for a check: the Delta to evaluate once more, as numbers

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
