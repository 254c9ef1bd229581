"""A metric at seeded samples: a pure function of the set, the metric, the seed and the sample's number."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robustlab.errors import InputError
from robustlab.uncertainty.lft import UncertainModel
from robustlab.worst_case_analysis.draws import Deltas
from robustlab.worst_case_analysis.ensemble import delta_stack
from robustlab.worst_case_analysis.metric_contract import Metric
from robustlab.worst_case_analysis.metrics import MetricRequest, make_metric
from robustlab.worst_case_analysis.real_set import BLOCK, RealSet
from robustlab.worst_case_analysis.streaming import blocks_of, in_order

__all__ = ["MetricBatch"]

Array = NDArray[np.float64]

MOST_SAMPLES = 10_000_000


@dataclass(frozen=True)
class MetricBatch:
    """Values of a metric at samples ``first .. first + count - 1``; can be pickled and sent to another process.

    Sample i is that of ``sample(uncertain, n, seed)``, and its value is the same to the last bit in whatever batch it
    is computed.

    Attributes
    ----------
    uncertain
        The set.
    request
        The metric and its signals and times.
    seed
        Seed of the samples.

    Examples
    --------
    >>> M = StateSpaceModel([[-1.0]], [[-0.2, 1.0]], [[1.0], [1.0]], [[0.0, 0.0], [0.0, 0.0]])
    >>> batch = MetricBatch(UncertainModel(M, [RealScalar("pole")]), MetricRequest("spectral-abscissa"), 1)
    >>> bool((batch(0, 7)[5:] == batch(5, 2)).all())
    True
    """

    uncertain: UncertainModel
    request: MetricRequest
    seed: int

    def __post_init__(self) -> None:
        if isinstance(self.seed, bool) or not isinstance(self.seed, (int, np.integer)) or self.seed < 0:
            raise InputError("seed", f"{self.seed!r}", "a whole number, not negative")

    def __getstate__(self) -> dict[str, Any]:
        # What was prepared is made again where it is needed: a request and a model travel, nothing else.
        return {"uncertain": self.uncertain, "request": self.request, "seed": self.seed}

    @cached_property
    def judge(self) -> Metric:
        """The metric."""
        return make_metric(self.uncertain, self.request)

    @property
    def all_real(self) -> bool:
        """Whether every block is a real scalar."""
        return self._deltas(1).all_real

    @cached_property
    def real_set(self) -> RealSet:
        """The set, prepared for many members; for real scalars only."""
        return RealSet(self.judge.uncertain)

    def _deltas(self, n: int) -> Deltas:
        return Deltas(self.uncertain.blocks, n, self.seed, np.zeros((0, 0)))

    def __call__(self, first: int, count: int) -> Array:
        """Values of ``count`` samples, shape (count,)."""
        deltas = self._deltas(first + count)
        if not self.all_real:
            return self.judge.values(delta_stack(self.uncertain.blocks, deltas[first : first + count]))
        # Products are rounded the same for the same place in a block only: begin where a block begins.
        start = first - first % BLOCK
        values = np.empty(first + count - start)
        for part in blocks_of(len(values), self.real_set.block):
            theta = deltas.numbers(slice(start + part.start, start + part.stop))
            values[part] = self.judge.of(self.real_set.members(theta))
        return values[first - start :]

    def theta(self, n: int) -> Array:
        """Normalised deltas of the first n samples (n, d), for sets of real scalars."""
        return self._deltas(n).numbers(slice(0, n))

    def delta(self, index: int) -> dict[str, Any]:
        """Delta of one sample."""
        return dict(self._deltas(index + 1)[index])

    def all_values(self, n: int, workers: int = 1) -> Array:
        """Values of the first n samples (n,), by so many threads."""
        if isinstance(n, bool) or not isinstance(n, (int, np.integer)) or not 1 <= n <= MOST_SAMPLES:
            raise InputError("n", f"{n!r}", f"a whole number of samples from 1 to {MOST_SAMPLES}")
        if self.all_real:
            self.real_set  # noqa: B018  made before threads ask for it
        return np.concatenate(list(self._pieces(int(n), workers)))

    def _pieces(self, n: int, workers: int) -> Iterator[Array]:
        yield from in_order(lambda part: self(part.start, part.stop - part.start), blocks_of(n, BLOCK), workers)
