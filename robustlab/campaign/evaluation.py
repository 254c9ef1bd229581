"""The value of sample i: a pure function of uncertain model, settings and i.

Samples are computed in fixed tiles: members of a tile share their scaling.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from robustlab.arrays import Array
from robustlab.budget import one_thread
from robustlab.campaign.settings import CampaignSettings, Identity, code_identity, differences, model_from_bytes
from robustlab.errors import EnvironmentFault, NoTrustworthyNumber, plain_text
from robustlab.uncertainty.lft import UncertainModel
from robustlab.worst_case_analysis.members import Deltas, delta_of_sample, encoded
from robustlab.worst_case_analysis.metrics import make_metric
from robustlab.worst_case_analysis.worst_case_search import worst_case

DONE, LOST = 0, 1
TILE = 64  # samples in a tile; it affects the last digits of a value
TILE_WORK = 2e9  # approximate operations in a tile: a large model has smaller tiles, so that a kill loses little
UNLIMITED_EFFORT = 1e9  # effort with which a search ends only when nothing improves


@dataclass(frozen=True)
class Rows:
    """Consecutive samples from a worker."""

    first: int  # index of the first one
    values: Array  # the metric, shape (k,); NaN where a sample is lost
    deltas: Array  # normalised Deltas as numbers, shape (k, width); see `robustlab.worst_case_analysis.members.encoded`
    seconds: Array  # time each one took, shape (k,); samples computed together share their time evenly
    lost: Mapping[int, str] = field(default_factory=dict)  # index -> reason, for samples without a value


class Evaluator:
    """Computes the samples of one campaign."""

    def __init__(self, uncertain: UncertainModel, settings: CampaignSettings) -> None:
        self.uncertain, self.settings = uncertain, settings
        s, t = settings, None
        if s.t_end is not None:
            dt = uncertain.dt
            t = dt * np.arange(max(2, round(s.t_end / dt) + 1)) if dt else np.linspace(0.0, s.t_end, s.points)
        self._asked: dict[str, Any] = {
            "metric": s.metric, "output": s.output, "input": s.input, "t": t, "u": s.u, "hold": s.hold, "band": s.band,
        }  # fmt: skip
        self.metric = make_metric(uncertain, **self._asked, where="campaign")
        n = self.metric.uncertain.M.n_states
        work = (n + 1) ** 2 * (s.points + 100 + 30 * n)
        # The samples per tile depend on the campaign alone, not on the machine.
        self.tile = 1 if s.kind == "search" else max(1, min(TILE, int(TILE_WORK / work)))
        self._reals = [block.name for block in uncertain.blocks if block.interval]
        self.sense = 1 if self.metric.sense > 0 else -1  # -1 where the smallest value of the metric is the worst

    def _theta(self, first: int, last: int) -> Array:
        """Return the coordinates of samples (k, width)."""
        blocks, seed = self.uncertain.blocks, self.settings.seed
        if self.settings.kind == "search":
            return np.zeros((last - first, self.metric.set.size))
        if self.settings.kind == "samples":
            return Deltas(blocks, last, seed).numbers(slice(first, last))
        corners = [
            delta_of_sample(blocks, seed, k, boundary=True) | dict(zip(self._reals, self._signs(k), strict=True))
            for k in range(first, last)
        ]
        return np.array([encoded(blocks, corner) for corner in corners])

    def _signs(self, index: int) -> list[float]:
        """Return the vertex of the real deltas: the binary digits of the index, or random if not all are requested."""
        k = len(self._reals)
        if 2**k <= self.settings.n:
            return [float(2 * (index >> (k - 1 - j) & 1) - 1) for j in range(k)]
        rng = np.random.default_rng(np.random.SeedSequence(self.settings.seed, spawn_key=(index, 2)))
        return (2.0 * rng.integers(0, 2, k) - 1.0).tolist()

    def rows(self, first: int, last: int) -> Rows:
        """Compute samples ``first .. last - 1`` below n, multiples of the tile; a failed tile sample by sample."""
        parts = [part for start in range(first, last, self.tile) for part in self._tile(start)]
        n = self.settings.n
        values, deltas, seconds = (
            np.concatenate([getattr(part, name) for part in parts])[: n - first]
            for name in ("values", "deltas", "seconds")
        )
        return Rows(first, values, deltas, seconds, {i: why for part in parts for i, why in part.lost.items() if i < n})

    def _tile(self, first: int) -> list[Rows]:
        indices = range(first, first + self.tile)
        if self.tile > 1:
            started, theta = time.perf_counter(), self._theta(first, indices.stop)
            try:
                values = self._values(theta)
            except Exception:  # noqa: BLE001  one sample fails the tile; it is found below
                values = np.full(len(theta), np.nan)
            if not np.isnan(values).any():
                return [Rows(first, values, theta, np.full(len(theta), (time.perf_counter() - started) / len(theta)))]
        return [self._alone(index) for index in indices]

    def _alone(self, index: int) -> Rows:
        """Compute one sample; its exception becomes the reason of a lost sample."""
        started, theta, value, reason = time.perf_counter(), self._theta(index, index + 1), np.nan, ""
        try:
            if self.settings.kind == "search":
                value, delta = self._search(index)
                theta = encoded(self.uncertain.blocks, delta)[None]
            else:
                value = float(self._values(theta)[0])
        except Exception as error:  # noqa: BLE001  any failure concerns this sample alone
            reason = plain_text(f"{type(error).__name__}: {error}")[:500]
        if not reason and np.isnan(value):
            reason = "the metric is not a number"
        seconds = np.array([time.perf_counter() - started])
        return Rows(index, np.array([value]), theta, seconds, {index: reason} if reason else {})

    def _values(self, theta: Array) -> Array:
        return self.metric.of(self.metric.set.members(theta))

    def _search(self, index: int) -> tuple[float, dict[str, Any]]:
        s = self.settings
        seed = int(np.random.SeedSequence(s.seed, spawn_key=(index, 3)).generate_state(2)[0])
        found = worst_case(self.uncertain, **self._asked, n=s.starts, seed=seed, effort=UNLIMITED_EFFORT)
        if not found.status.trustworthy:
            raise NoTrustworthyNumber(
                "search", f"{found.status}: {found.search_value:.9g} found, {found.value:.9g} when evaluated again"
            )
        return found.value, dict(found.delta)


_evaluators: dict[str, Evaluator] = {}  # of this process: that of its last campaign


def compute(identity: Identity, model: bytes, first: int, last: int) -> Rows:
    """Compute samples ``first .. last - 1`` in a worker."""
    if identity.hash not in _evaluators:
        changes = differences(identity, Identity(identity.model, identity.settings, code_identity()))
        if changes:
            raise EnvironmentFault("worker", f"runs other code: {changes[0]}", "the same versions on every machine")
        _evaluators.clear()
        _evaluators[identity.hash] = Evaluator(model_from_bytes(model, "campaign"), identity.settings)
    with one_thread():
        return _evaluators[identity.hash].rows(first, last)
