"""Search for the worst member of an uncertain model: centre, vertices, a Latin hypercube, then local refinement
of the best.

A search attains what it reports; it proves no bound. Guaranteed bounds are `robustlab.mu_analysis`' business.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robustlab.errors import InputError, UsageError, did_you_mean
from robustlab.result import Status
from robustlab.uncertainty.blocks import Block, RealScalar, block_slices, delta_values, structure_size
from robustlab.uncertainty.lft import UncertainModel
from robustlab.worst_case_analysis.draws import vertex_signs
from robustlab.worst_case_analysis.ensemble import chunks, members
from robustlab.worst_case_analysis.excitation import default_clock, excitation
from robustlab.worst_case_analysis.metrics import HinfGain, Metric, PeakDeviation, SpectralAbscissa

__all__ = ["METRICS", "WorstCase", "worst_case"]

Array = NDArray[np.float64]

METRICS = ("peak-deviation", "hinf", "spectral-abscissa")
LABEL = "sampled: a lower bound of the true worst case"

MAX_VERTICES = 1024
STARTS = 4
SMALLEST_STEP = 1e-7
# Search and re-evaluation must agree to this share of the value.
AGREEMENT = 1e-6


@dataclass(frozen=True)
class WorstCase:
    """The worst member that a search found.

    Attributes
    ----------
    value
        The metric at ``delta``, re-evaluated through another path than the search's; ``inf`` where it is unbounded.
    delta
        Block name -> value.
    metric
        Which metric.
    nominal_value
        The metric at Delta = 0, by the same path as ``value``.
    status
        CONVERGED; INACCURATE where search and re-evaluation disagree or digits were lost; TIMEOUT where the time limit
        ended the search.
    label
        What the value is, and is not.
    evaluations
        Number of members that were evaluated.
    physical
        Block name -> (parameter value, unit), for blocks that stand for a physical parameter.
    at
        Time in s or frequency in rad/s at which the value is attained; NaN where there is none.
    location
        What ``at`` is.
    search_value
        What the search had computed for ``delta``.
    unit
        Unit of the value.
    input, output
        Signals that the metric was restricted to; None for all.
    spectral_abscissa
        Of the member at ``delta``, all states.
    seed
        Seed of the search.
    """

    value: float
    delta: Mapping[str, Any]
    metric: str
    nominal_value: float
    status: Status
    label: str
    evaluations: int
    physical: Mapping[str, tuple[float, str]]
    at: float
    location: str
    search_value: float
    unit: str
    input: str | None
    output: str | None
    spectral_abscissa: float
    seed: int

    def to_json(self) -> dict[str, object]:
        """All fields."""
        return vars(self).copy()


def worst_case(
    uncertain: UncertainModel,
    metric: Literal["peak-deviation", "hinf", "spectral-abscissa"] = "peak-deviation",
    *,
    output: str | None = None,
    input: str | None = None,
    t: ArrayLike | None = None,
    u: Mapping[str, ArrayLike] | ArrayLike | None = None,
    hold: Literal["zoh", "foh"] = "zoh",
    n: int = 256,
    seed: int = 0,
    time_limit: float = 60.0,
) -> WorstCase:
    """The worst member of a set that a search over all normalised Delta finds.

    Parameters
    ----------
    metric
        ``"peak-deviation"``: largest ``|y(t; Delta) - y(t; 0)|`` of one output over the given times.
        ``"hinf"``: H-infinity gain; unstable members count as infinite.
        ``"spectral-abscissa"``: largest real part of the poles.
    output, input
        Signals to look at. An output is needed for the peak deviation where there are several; the gain is taken
        between all signals where none is named.
    t, u, hold
        Times and inputs for the peak deviation, as in `Samples.respond`. Left out: eight time constants of the nominal
        model, and a unit step on ``input`` or on the only input.
    n
        Points of a Latin hypercube, besides the centre and up to 1024 vertices.
    seed
        Same seed, same answer.
    time_limit
        In s; what was found by then comes back with status TIMEOUT.

    Raises
    ------
    UsageError
        Unknown metric, or several outputs and none named.
    InputError
        Unknown signals, complex blocks in time, an unstable nominal model without times.
    NoTrustworthyNumber
        The nominal model has no finite gain.
    """
    deadline = time.monotonic() + time_limit
    if not isinstance(uncertain, UncertainModel):
        raise InputError("worst_case", type(uncertain).__name__, "an UncertainModel")
    judge = _metric(uncertain, metric, output=output, input=input, t=t, u=u, hold=hold)
    if isinstance(n, bool) or not isinstance(n, (int, np.integer)) or n < 1:
        raise InputError("worst_case", f"n is {n!r}", "a whole number of points, at least 1")
    search = _Search(judge, _Box(uncertain.blocks), deadline)
    theta, found = search.run(int(n), seed)
    stack = search.box.deltas(theta[None])
    delta = delta_values(uncertain.blocks, stack[0])
    value, at, accurate = judge.evaluate(delta)
    nominal_value = judge.evaluate({}).value
    status = Status.CONVERGED if accurate and _agree(found, value, judge) else Status.INACCURATE
    if search.out_of_time:
        status = Status.TIMEOUT
    label = LABEL if np.isfinite(value) else "attained: this member has no bounded value"
    return WorstCase(
        value,
        delta,
        metric,
        nominal_value,
        status,
        label,
        search.evaluations,
        uncertain.physical(delta),
        at,
        judge.location,
        found,
        judge.unit,
        input,
        output,
        float(members(uncertain, stack).spectral_abscissa()[0]),
        seed,
    )


def _metric(
    uncertain: UncertainModel,
    metric: str,
    *,
    output: str | None,
    input: str | None,
    t: ArrayLike | None,
    u: Mapping[str, ArrayLike] | ArrayLike | None,
    hold: Literal["zoh", "foh"],
) -> Metric:
    if metric not in METRICS:
        raise UsageError(
            "worst_case", f"metric {metric!r}", f"one of {', '.join(METRICS)}", did_you_mean(metric, METRICS)
        )
    if metric == "spectral-abscissa":
        return SpectralAbscissa(uncertain)
    if metric == "hinf":
        return HinfGain(uncertain, input, output)
    names = [s.name for s in uncertain.outputs]
    if output is None and len(names) != 1:
        expected, hint = f"output: one of {', '.join(names)}", f"name one: output={names[0]!r}, or --output {names[0]}"
        raise UsageError("worst_case", f"{len(names)} outputs and none named", expected, hint)
    if u is None and input is not None:
        u = {input: 1.0}
    nominal = uncertain.nominal
    clock = default_clock(nominal, "worst_case") if t is None else t
    drive = excitation(uncertain.inputs, uncertain.dt, clock, u, "worst_case")
    return PeakDeviation(uncertain, output or names[0], drive, hold)


def _agree(found: float, value: float, judge: Metric) -> bool:
    if not np.isfinite(value) or not np.isfinite(found):
        return value == found
    if isinstance(judge, SpectralAbscissa):
        # Poles are as accurate as the largest of them.
        size = max(abs(value), float(np.abs(judge.uncertain.nominal.poles()).max()))
        return abs(found - value) <= AGREEMENT * size
    # The second path of the gain may find a higher peak between the search's grid points: that is no fault.
    slack = AGREEMENT * max(abs(value), abs(found))
    return found <= value + slack and (isinstance(judge, HinfGain) or value <= found + slack)


# --- parameters of Delta ---------------------------------------------------------------------------------------------


class _Box:
    """Delta from a vector in [-1, 1]^d: a number for a real scalar, real and imaginary parts for the rest.

    A complex scalar or a full matrix outside its ball is drawn back onto it, so every vector gives a Delta of the set.
    """

    def __init__(self, blocks: Sequence[Block]) -> None:
        self.blocks = tuple(blocks)
        self.slices: list[slice] = []
        size = 0
        for b in self.blocks:
            width = 1 if isinstance(b, RealScalar) else 2 * self._entries(b)
            self.slices.append(slice(size, size + width))
            size += width
        self.size = size
        self.real = [s.start for b, s in zip(self.blocks, self.slices, strict=True) if isinstance(b, RealScalar)]

    @staticmethod
    def _entries(block: Block) -> int:
        return block.rows * block.cols if not hasattr(block, "repeats") else 1

    def deltas(self, theta: Array) -> NDArray[Any]:
        """Stack of Deltas (k, q, p) from vectors (k, d)."""
        dtype = float if len(self.real) == len(self.blocks) else complex
        delta = np.zeros((len(theta), *structure_size(self.blocks)), dtype=dtype)
        for block, part, (rows, cols) in zip(self.blocks, self.slices, block_slices(self.blocks), strict=True):
            number = theta[:, part]
            if isinstance(block, RealScalar):
                delta[:, rows, cols] = number[:, :, None] * np.eye(block.rows)
                continue
            half = number.shape[1] // 2
            entries = number[:, :half] + 1j * number[:, half:]
            if half == 1:
                entries = entries / np.maximum(np.abs(entries), 1.0)
                delta[:, rows, cols] = entries[:, :, None] * np.eye(block.rows, block.cols)
                continue
            matrix = entries.reshape(-1, block.rows, block.cols)
            delta[:, rows, cols] = matrix / np.maximum(np.linalg.norm(matrix, 2, axis=(1, 2)), 1.0)[:, None, None]
        return delta


# --- the search ------------------------------------------------------------------------------------------------------


class _Search:
    def __init__(self, judge: Metric, box: _Box, deadline: float) -> None:
        self.judge, self.box, self.deadline = judge, box, deadline
        self.evaluations = 0
        self.out_of_time = False

    def run(self, n: int, seed: int) -> tuple[Array, float]:
        """The best vector and its value."""
        points = self._start_points(n, seed)
        values = self._values(points)
        order = np.argsort(-values, kind="stable")
        best, top = points[order[0]], float(values[order[0]])
        if not self.box.size:
            return best, top
        for index in order[:STARTS]:
            if np.isposinf(top) or self.out_of_time:
                break
            theta, value = self._refine(points[index], float(values[index]))
            if value > top:
                best, top = theta, value
        return best, top

    def _start_points(self, n: int, seed: int) -> Array:
        d = self.box.size
        centre = np.zeros((1, d))
        if d == 0:
            return centre
        signs = vertex_signs(len(self.box.real), MAX_VERTICES, seed) if self.box.real else np.zeros((0, 0))
        vertices = np.zeros((len(signs), d))
        vertices[:, self.box.real] = signs
        # Latin hypercube: every parameter is seen in each of n equal parts of its range.
        rng = np.random.default_rng(seed)
        strata = rng.permuted(np.tile(np.arange(n), (d, 1)), axis=1).T
        return np.vstack([centre, vertices, 2.0 * (strata + rng.random((n, d))) / n - 1.0])

    def _values(self, theta: Array) -> Array:
        """Values at vectors (k, d); after the deadline the rest counts as -inf."""
        values = np.full(len(theta), -np.inf)
        m = self.judge.uncertain.M
        for part in chunks(len(theta), 64 * (m.A.size + m.D.size + 1)):
            if self.evaluations and time.monotonic() > self.deadline:
                self.out_of_time = True
                break
            values[part] = self.judge.values(self.box.deltas(theta[part]))
            self.evaluations += part.stop - part.start
        return values

    def _refine(self, theta: Array, value: float) -> tuple[Array, float]:
        """Compass search in the box: steps along every coordinate, along the projected slope, and all gains together.

        The first steps are as wide as the box (a vertex's neighbours), the last ones as small as SMALLEST_STEP.
        """
        step = 2.0
        while step > SMALLEST_STEP and not self.out_of_time:
            trials = self._trials(theta, value, step)
            values = self._values(trials)
            best = int(values.argmax())
            if values[best] > value + 1e-12 * abs(value):
                theta, value = trials[best], float(values[best])
                if np.isposinf(value):
                    break
            else:
                step /= 4.0
        return theta, value

    def _trials(self, theta: Array, value: float, step: float) -> Array:
        d = len(theta)
        ahead = np.clip(theta + step * np.eye(d), -1.0, 1.0)
        behind = np.clip(theta - step * np.eye(d), -1.0, 1.0)
        up, down = self._values(ahead), self._values(behind)
        if np.isposinf([*up, *down]).any():
            return np.vstack([ahead, behind])[np.isposinf([*up, *down])][:1]
        width = np.diag(ahead) - np.diag(behind)
        finite = np.isfinite(up) & np.isfinite(down)
        slope = np.subtract(up, down, where=finite, out=np.zeros(d)) / np.where(width > 0, width, 1.0)
        slope /= max(float(np.abs(slope).max()), np.finfo(float).tiny)
        along = np.clip(theta + step * np.exp2([[-2.0], [-1.0], [0.0], [1.0], [2.0]]) * slope, -1.0, 1.0)
        gains = np.where((up > value) & (up >= down), np.diag(ahead), np.where(down > value, np.diag(behind), theta))
        best = ahead[np.argmax(up)] if up.max() >= down.max() else behind[np.argmax(down)]
        return np.vstack([along, gains[None], best[None]])
