r"""Robust gain margin: how much of the uncertainty leaves the gain of every member below a given level.

.. math:: k^* = \sup \Big\{ k : \; \sup_{|\Delta| \le k} \|F_u(M, \Delta)\|_\infty < \gamma \Big\}

The level stays where it is while the set grows; robust performance (`robust_performance`) grows both. The worst-case
gain of the set times k crosses gamma at k*: each end of the bracket is one worst-case gain, with its own evidence.

References
----------
Packard, Balas, Liu, Shin, "Results on worst-case performance assessment", ACC 2000.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from robustlab.budget import one_thread, search_budget
from robustlab.errors import InputError, told_as
from robustlab.mu_analysis.axis.axis_model import check_nominal
from robustlab.mu_analysis.axis.worst_gain import WorstCaseGain, gain_within
from robustlab.mu_analysis.matrix.upper import compile_kernels
from robustlab.mu_analysis.tuning import TUNING
from robustlab.norms import hinf_norm
from robustlab.result import Status
from robustlab.shown import Facts, Shown, bracket, member, number
from robustlab.statespace import StateSpaceModel
from robustlab.uncertainty.lft import UncertainModel

__all__ = ["RobustGain", "robust_gain"]

# Sets more than this many times as large as given are not looked at.
LARGEST = 2.0**20
ROUNDS = 24
PATIENT = 6  # sizes
PART = 0.3  # of the work that is left goes into one size
# Sizes are tried this share below and above the crossing, so that one of them proves and the other attains.
BESIDE = 1e-5


@dataclass(frozen=True, eq=False)
class RobustGain(Shown):
    """Largest size of the set for which every member's gain is below ``level``.

    Attributes
    ----------
    lower, upper
        ``lower <= margin <= upper``: all members of size up to ``lower`` have a gain of at most ``level``, proved; the
        member ``delta``, of size ``upper``, reaches it. Above 1 the set as given keeps the level. Both are 0 where the
        nominal model reaches the level already. Where no member of a set up to 2^20 times as large reaches it,
        ``lower`` is the largest size that was proved, and ``upper`` inf: none was found.
    level
        gamma.
    frequency
        Frequency in rad/s at which the member ``delta`` reaches the level; None where none does.
    delta
        That member, in units of the set as given: one value per block name.
    physical
        Values and units of its physical parameters.
    proof
        The worst-case gain of the set times ``lower``: its ``upper`` is at most ``level``. None where lower is 0.
    status
        CERTIFIED where both ends are within the tolerance, or ``lower`` is so large that nothing larger was looked at;
        else INCONCLUSIVE, or TIMEOUT.
    """

    lower: float
    upper: float
    level: float
    frequency: float | None
    delta: Mapping[str, Any]
    physical: Mapping[str, tuple[float, str]]
    proof: WorstCaseGain | None
    status: Status

    def facts(self) -> Facts:
        """Both bounds, and the member that reaches the level."""
        return [
            ("margin", bracket(self.lower, self.upper, ("proved", "attained"))),
            ("gain below", number(self.level, digits=6)),
            ("critical member", member(self.delta, self.physical)),
            ("critical frequency", number(self.frequency, "rad/s")),
        ]

    def to_json(self) -> dict[str, Any]:
        """All attributes but ``proof``; arrays stay arrays."""
        names = [name for name in self.__dataclass_fields__ if name != "proof"]
        return {"type": "RobustGain", **{name: getattr(self, name) for name in names}}


@told_as("robust_gain")
def robust_gain(
    uncertain: UncertainModel,
    level: float,
    tolerance: float = 0.01,
    time_limit: float | None = None,
    seed: int = 0,
    effort: float = 1.0,
) -> RobustGain:
    r"""Largest k for which all Delta of size below k leave the gain below ``level``.

    Parameters
    ----------
    uncertain
        Uncertain model; use ``select`` for some of its inputs and outputs. A range that is wider on one side grows in
        proportion on both.
    level
        gamma, positive, in the unit of the outputs over that of the inputs.
    tolerance
        Relative gap between the bounds that is aimed at.
    time_limit, seed, effort
        As in `worst_case_gain`; the work is that of all worst-case gains together.

    Returns
    -------
    RobustGain
        Both bounds, the member that reaches the level, and the worst-case gain that proves ``lower``.

    Raises
    ------
    InputError
        No uncertain model, or a level or tolerance that is not positive.
    NoTrustworthyNumber
        The nominal model is unstable.

    References
    ----------
    Packard, Balas, Liu, Shin (2000).

    Examples
    --------
    >>> from robustlab.uncertainty.blocks import RealScalar
    >>> M = StateSpaceModel([[-1.0]], [[-0.5, 1.0]], [[1.0], [1.0]], [[0.0, 0.0], [0.0, 0.0]])
    >>> found = robust_gain(UncertainModel(M, [RealScalar("pole")]), 4.0)  # 1 / (s + 1 + delta / 2): 1 / (1 - k / 2)
    >>> round(found.lower, 2), round(found.upper, 2)
    (1.49, 1.5)
    """
    check_nominal(uncertain, "robust_gain")
    if not (np.isfinite(level) and level > 0 and tolerance > 0):
        raise InputError("robust_gain", f"level {level}, tolerance {tolerance}", "both positive, the level finite")
    compile_kernels()
    budget = search_budget("robust_gain", TUNING.work, effort, time_limit)
    nominal = hinf_norm(uncertain.nominal)
    if nominal.lower >= level:
        return RobustGain(0.0, 0.0, level, nominal.frequency, {}, {}, None, nominal.status)
    search = _Search(
        level, lambda k: gain_within(scaled(uncertain, k), budget.share(PART), tolerance=tolerance / 4, seed=seed)
    )
    search.points.append((0.0, nominal.lower, nominal.upper))
    with one_thread():
        for _ in range(ROUNDS):
            k = search.next_size(tolerance)
            if k is None or budget.over:
                break
            search.look_at(k)
    return _result(uncertain, search, tolerance, budget.struck)


def scaled(uncertain: UncertainModel, size: float) -> UncertainModel:
    """The set with ``size Delta`` in place of Delta: what is called 1 in it is ``size`` in the set as given."""
    M, q = uncertain.M, uncertain.delta_shape[0]
    grown = np.append(np.full(q, size), np.ones(M.n_inputs - q))
    larger = StateSpaceModel(M.A, M.B * grown, M.C, M.D * grown, M.dt, M.inputs, M.outputs, M.states)
    return UncertainModel(larger, uncertain.blocks)


class _Search:
    """Sizes that were looked at, the largest that is proved and the smallest that reaches the level."""

    def __init__(self, level: float, gain_of: Callable[[float], WorstCaseGain]) -> None:
        self.level, self._gain_of = level, gain_of
        self.points: list[tuple[float, float, float]] = []  # size, and both bounds of the worst gain
        self.lower, self.upper = 0.0, np.inf
        self.proof: WorstCaseGain | None = None
        self.reached: WorstCaseGain | None = None

    def look_at(self, size: float) -> None:
        worst = self._gain_of(size)
        self.points.append((size, worst.lower, worst.upper))
        self.points.sort()
        if worst.upper <= self.level and size > self.lower:
            self.lower, self.proof = size, worst
        if worst.lower >= self.level and size < self.upper:
            self.upper, self.reached = size, worst

    def next_size(self, tolerance: float) -> float | None:
        """A size that may raise ``lower`` or take ``upper`` down; None where there is none."""
        if self.upper <= self.lower * (1 + tolerance):
            return None
        if not np.isfinite(self.upper):
            last = self.points[-1][0]
            proposal = self._crossing(1) if last else 1.0
            if proposal is None:
                proposal = 2 * last
            proposal = min(max(proposal * (1 + BESIDE), 1.05 * last), 32 * max(last, 1.0 / 32))
            return proposal if proposal <= LARGEST else None
        # Between the two there may be sizes whose bounds of the gain lie on both sides of the level.
        next_up = min(size for size, *_ in self.points if size > self.lower)
        next_down = max(size for size, *_ in self.points if size < self.upper)
        halves = [(_middle(self.lower, next_up), 1.0), (_middle(next_down, self.upper), 1.0)]
        proposals = [(self._crossing(2), 1 - BESIDE), (self._crossing(1), 1 + BESIDE), *halves]
        # Where a line through two points keeps missing, halving the rest does not.
        first = len(self.points) % 4 if len(self.points) > PATIENT else 0
        for size, share in (*proposals[first:], *proposals[:first]):
            if size is not None and self.lower < size * share < self.upper:
                near = min(abs(size * share / tried - 1) for tried, *_ in self.points if tried)
                if near > tolerance / 8:
                    return size * share
        return None

    def _crossing(self, column: int) -> float | None:
        """Where a bound of the gain is the level: one over the gain is nearly a straight line over the size."""
        with np.errstate(divide="ignore"):
            rest = [(p[0], 1 / p[column] - 1 / self.level if p[column] else np.inf) for p in self.points]
        below = [p for p in rest if p[1] > 0 and np.isfinite(p[1])]
        # Beyond the first unstable member the gain stays infinite: no line goes through that.
        above = [p for p in rest if -1 / self.level < p[1] <= 0]
        if not below or len(below) + len(above) < 2:
            return None
        one = below[-1]
        two = above[0] if above else below[-2]
        slope = (two[1] - one[1]) / (two[0] - one[0]) if two[0] != one[0] else 0.0
        return float(one[0] - one[1] / slope) if slope < 0 else None


def _middle(low: float, high: float) -> float:
    return float(np.sqrt(low * high)) if low else high / 2


def _result(uncertain: UncertainModel, search: _Search, tolerance: float, timed_out: bool) -> RobustGain:
    reached = search.reached
    delta: dict[str, Any] = {}
    if reached is not None:
        delta = {name: np.asarray(value)[()] * search.upper for name, value in reached.delta.items()}
    lower, upper = search.lower, search.upper
    close = upper <= lower * (1 + tolerance) or (np.isinf(upper) and lower * 32 > LARGEST)
    status = Status.CERTIFIED if close else Status.TIMEOUT if timed_out else Status.INCONCLUSIVE
    physical = uncertain.physical(delta) if delta else {}
    frequency = None if reached is None else reached.frequency
    return RobustGain(lower, upper, search.level, frequency, delta, physical, search.proof, status)
