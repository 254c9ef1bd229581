"""The value of sample i: a pure function of uncertain model, settings and i.

This is the one module of the room that knows metrics and searches. Samples are computed in tiles of fixed borders
(sample i belongs to tile ``i // tile``, a whole tile is computed even where it reaches beyond n), because a stack of
members shares its scaling in the matrix exponential: with other neighbours the last digit of a value could change.
So the answer depends neither on the number of workers nor on n nor on where an earlier run was interrupted.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from robustlab.arrays import Array
from robustlab.budget import one_thread
from robustlab.campaign.settings import CampaignSettings, Identity, code_identity, differences, model_from_bytes
from robustlab.errors import EnvironmentFault, NoTrustworthyNumber, plain_text
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
# A search ends by itself, where nothing improves it any more.
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

    def agrees(self, value: float, again: Evaluation) -> bool:
        """Whether a value and its re-evaluation are the same number."""
        return again.accurate and self._judge.agrees(value, again.value)

    def evaluate(self, delta: Mapping[str, Any]) -> Evaluation:
        """The metric at one Delta through the second path, with which a worst sample is checked."""
        return self._judge.evaluate(delta)

    def _tile(self, first: int) -> Rows:
        if self.tile == 1:
            return self.alone(first)
        started = time.perf_counter()
        deltas = [self.delta(index) for index in range(first, first + self.tile)]
        try:
            values = self._values(deltas)
        except Exception:  # noqa: BLE001  one sample spoils the stack; which one, and how, is found out below
            values = np.full(len(deltas), np.nan)
        if np.isnan(values).any():
            parts = [self.alone(index) for index in range(first, first + self.tile)]
            return parts[0].followed_by(parts[1:])
        seconds = np.full(len(deltas), (time.perf_counter() - started) / len(deltas))
        return Rows(first, values, np.stack([encode_delta(self.uncertain.blocks, d) for d in deltas]), seconds)

    def alone(self, index: int) -> Rows:
        """One sample; what it raises becomes the reason why it is lost."""
        started = time.perf_counter()
        delta, value, reason = self.delta(index), np.nan, ""
        try:
            if self.settings.kind == "search":
                value, delta = self._search(index)
            else:
                value = float(self._values([delta])[0])
        except Exception as error:  # noqa: BLE001  whatever a sample raises concerns this sample alone
            reason = plain_text(f"{type(error).__name__}: {error}")[:500]
        if not reason and np.isnan(value):
            reason = "the metric is not a number"
        seconds = np.array([time.perf_counter() - started])
        numbers = encode_delta(self.uncertain.blocks, delta)[None]
        return Rows(index, np.array([value]), numbers, seconds, {index: reason} if reason else {})

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


_evaluators: dict[str, Evaluator] = {}  # of this process: that of the campaign it worked for last


def compute(identity: Identity, model: bytes, first: int, last: int) -> Rows:
    """Samples ``first .. last - 1``, in a worker.

    Raises EnvironmentFault: the worker runs other code than the campaign.
    """
    if identity.hash not in _evaluators:
        changes = differences(identity, Identity(identity.model, identity.settings, code_identity()))
        if changes:
            raise EnvironmentFault("worker", f"runs other code: {changes[0]}", "the same versions on every machine")
        _evaluators.clear()
        _evaluators[identity.hash] = Evaluator(model_from_bytes(model, "campaign"), identity.settings)
    with one_thread():
        return _evaluators[identity.hash].rows(first, last)
