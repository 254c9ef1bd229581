r"""Robust gain margin: how much of the uncertainty leaves the gain of every member below a given level.

.. math:: k^* = \sup \Big\{ k : \; \sup_{|\Delta| \le k} \|F_u(M, \Delta)\|_\infty < \gamma \Big\}

The level stays where it is while the set grows; robust performance (`robust_performance`) grows both. With a
performance block of the fixed size ``1 / gamma`` it is skewed mu: ``1 / k*`` is the largest level at which the blocks
of the set, of size one over it, make the loop singular. From above members are followed down to the level, from below
constant D, G cover the axis, and regions of parameters and frequency where these leave a gap.

References
----------
Packard, Balas, Liu, Shin, "Results on worst-case performance assessment", ACC 2000.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from robustlab.arrays import AnyArray
from robustlab.budget import Budget, dense, one_thread, search_budget
from robustlab.errors import InputError, NoTrustworthyNumber, told_as
from robustlab.linear_analysis.frequency import frequency_response
from robustlab.mu_analysis.axis.axis_model import around, check_nominal, continuous, model_frequency, seed_frequencies
from robustlab.mu_analysis.axis.axis_problems import GainMarginProblem
from robustlab.mu_analysis.axis.intervals import Piece
from robustlab.mu_analysis.axis.margin import PERFORMANCE, delta_rows
from robustlab.mu_analysis.axis.pole_migration import smallest_destabilising
from robustlab.mu_analysis.axis.worst_gain import performance_inputs, skewed_cover
from robustlab.mu_analysis.constants import COARSE, MEMBERS, WORK
from robustlab.mu_analysis.matrix.box import Box, block_entries, centre_matrix, gauge, root_box, widest
from robustlab.mu_analysis.matrix.branch_and_bound import Region, tighten
from robustlab.mu_analysis.matrix.gain import gain_at, largest_gain
from robustlab.mu_analysis.matrix.upper import compile_kernels
from robustlab.norms import hinf_norm
from robustlab.result import Bracket, Status
from robustlab.shown import Facts, Part, bracket, member, number
from robustlab.statespace import StateSpaceModel
from robustlab.uncertainty.blocks import FullBlock, delta_values
from robustlab.uncertainty.lft import UncertainModel

__all__ = ["RobustGain", "output_unit", "robust_gain"]

# Sets more than this many times as large as given are not looked at.
LARGEST = 2.0**20
# Where no Delta destabilises: sets are looked at, each this many times as large as the one before.
GROWTH = 4.0
# Looks at smaller and smaller sets, until one takes off less than this share; starts of ascents at each frequency.
ROUNDS, STILL, STARTS = 12, 1e-5, 6


@dataclass(frozen=True, eq=False)
class RobustGain(Bracket):
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
        What ``lower`` rests on: pieces of the axis with their D, G, or regions of parameters and frequency, for the
        performance block of size ``1 / level`` and the others of size ``lower``.
    system, boxes
        The set that it is about, and each box of a branch and bound with an interval proved in it, for
        `robustlab.verify`; their D, G are for outputs in the unit `output_unit`.
    status
        CERTIFIED where both ends are within the tolerance, or ``lower`` is so large that nothing larger was looked at;
        else INCONCLUSIVE, or TIMEOUT.
    """

    level: float
    delta: Mapping[str, Any]
    physical: Mapping[str, tuple[float, str]]
    proof: tuple[Piece, ...] | tuple[Region, ...]
    system: UncertainModel | None = None
    boxes: tuple[tuple[Box, Piece], ...] = ()

    quantities: ClassVar[Mapping[str, Any]] = {
        "lower": "1", "upper": "1", "frequency": "rad/s", "delta": {"*": ...}, "level": float,
    }  # fmt: skip

    def headline(self) -> str:
        kept = "proved for the whole set" if self.lower >= 1 else "not proved for the whole set"
        return f"a gain below {number(self.level, digits=6)} is {kept}"

    def details(self) -> list[Part]:
        rows = delta_rows(self.delta, self.physical)
        return [Part("member that reaches it:", ("block", "delta", "parameter"), rows)]

    def facts(self) -> Facts:
        return [
            ("robust gain margin", bracket(self.lower, self.upper, ("proved", "attained"))),
            ("gain below", number(self.level, digits=6)),
            ("critical member", member(self.delta, self.physical)),
            ("critical frequency", number(self.frequency, "rad/s")),
            ("proof", f"{len(self.proof)} parts"),
        ]

    def to_json(self) -> dict[str, Any]:
        names = [name for name in vars(self) if name not in ("proof", "system", "boxes")]
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
        As in `robustlab.peak_gain`.

    Returns
    -------
    RobustGain
        Both bounds, the member that reaches the level, and what proves ``lower``.

    Raises
    ------
    InputError
        No uncertain model, or a level or tolerance that is not positive.
    NoTrustworthyNumber
        The nominal model is unstable.

    References
    ----------
    Packard, Balas, Liu, Shin (2000); skewed mu: Fan, Tits (1992).

    Examples
    --------
    >>> from robustlab.uncertainty.blocks import RealScalar
    >>> M = StateSpaceModel([[-1.0]], [[-0.5, 1.0]], [[1.0], [1.0]], [[0.0, 0.0], [0.0, 0.0]])
    >>> found = robust_gain(UncertainModel(M, [RealScalar("pole")]), 4.0)  # 1 / (s + 1 + delta / 2): 1 / (1 - k / 2)
    >>> found.lower <= 1.5 <= found.upper * (1 + 1e-9), round(found.lower, 2)
    (True, 1.5)
    """
    check_nominal(uncertain, "robust_gain")
    if not (np.isfinite(level) and level > 0 and tolerance > 0):
        raise InputError("robust_gain", f"level {level}, tolerance {tolerance}", "both positive, the level finite")
    compile_kernels()
    budget = search_budget("robust_gain", WORK, effort, time_limit)
    nominal = hinf_norm(uncertain.nominal)
    if nominal.lower >= level:
        return RobustGain(0.0, 0.0, nominal.frequency, nominal.status, level, {}, {}, ())
    unit = output_unit(level)
    with one_thread():
        found = _Search(_in_unit(uncertain, unit), level / unit, nominal.upper / unit, budget, seed)
        if uncertain.blocks:
            found.descend()
            found.prove(tolerance)
    return _result(uncertain, level, found, tolerance, budget.struck)


def output_unit(level: float) -> float:
    """The unit of the outputs for the search: numbers near the ends of the double range would overflow in squares."""
    return 2.0 ** round(float(np.log2(level)))


def _in_unit(uncertain: UncertainModel, unit: float) -> UncertainModel:
    """The set with its outputs in another unit."""
    M, p = uncertain.M, uncertain.delta_shape[1]
    size = np.append(np.ones(p), np.full(M.n_outputs - p, 1 / unit))[:, None]
    return UncertainModel(
        StateSpaceModel(M.A, M.B, size * M.C, size * M.D, M.dt, M.inputs, M.outputs, M.states), uncertain.blocks
    )


class _Search:
    """The smallest member found that reaches the level, and the largest set that is proved to stay below it."""

    def __init__(self, uncertain: UncertainModel, level: float, nominal: float, budget: Budget, seed: int) -> None:
        self.uncertain, self.level, self.nominal, self.budget, self.seed = uncertain, level, nominal, budget, seed
        self.model = continuous(uncertain.M)
        self.blocks = (*uncertain.blocks, FullBlock(PERFORMANCE, len(uncertain.inputs), len(uncertain.outputs)))
        self.real = all(b.interval for b in uncertain.blocks)
        self.seeds = seed_frequencies(self.model)
        self.upper, self.frequency = np.inf, None
        self.delta: dict[str, Any] = {}
        self.lower = LARGEST
        self.proof: tuple[Piece, ...] | tuple[Region, ...] = ()
        self.boxes: tuple[tuple[Box, Piece], ...] = ()

    def descend(self) -> None:
        """From the smallest destabilising Delta, or a set in which the level is reached, to smaller ones."""
        channels = continuous(self.uncertain.delta_channels)
        worst = smallest_destabilising(channels, self.uncertain.blocks, self.seeds, self.seed)
        if worst is not None:  # whose pole is on the axis but for rounding
            self.take((1 + 1e-6) * worst.delta, abs(worst.pole.imag) if np.isfinite(worst.pole) else float("inf"))
        size = 1.0
        while not np.isfinite(self.upper) and size <= LARGEST and not self.budget.over:
            self._look_within(size)
            size *= GROWTH
        for _ in range(ROUNDS if np.isfinite(self.upper) else 0):
            before = self.upper
            self._look_within(before)
            if self.upper > before * (1 - STILL) or self.budget.over:
                break

    def _look_within(self, size: float) -> None:
        """Ascents of the gain at many frequencies inside the set of this size; the best are followed down."""
        box = root_box(self.blocks, size)
        rng = np.random.default_rng(self.seed)
        near = [] if self.frequency is None else [self.frequency * np.exp(0.02 * k) for k in (-1, 0, 1)]
        peak = self._on_the_axis(hinf_norm(self.uncertain.nominal).frequency)
        omega = np.unique([0.0, *self.seeds, *near, *([peak] if np.isfinite(peak) else [])])
        self.budget.spend(STARTS * len(omega) * dense(len(self.blocks)))
        met = [
            (gain, float(w))
            for w, M in zip(omega, frequency_response(self.model, omega), strict=True)
            if (gain := largest_gain(M, self.blocks, box, rng, STARTS)) is not None and gain.value >= self.level
        ]
        for gain, w in sorted(met, key=lambda pair: -pair[0].value)[:MEMBERS]:
            self.take(gain.delta, w)

    def take(self, delta: AnyArray, omega: float) -> None:
        """A Delta (q, p), shortened until it just reaches the level, if it then is the smallest."""
        size = gauge(self.uncertain.blocks, block_entries(self.uncertain.blocks, delta))
        if size == 0:
            return
        inside, outside = 0.0, min(1.0, self.upper / size)
        at = self._reached(outside * delta, omega)
        if at is None:
            return
        while outside - inside > 1e-9 * outside:
            share = 0.5 * (inside + outside)
            met = self._reached(share * delta, omega)
            if met is None:
                inside = share
            else:
                outside, at = share, met
        if outside * size < self.upper:
            self.upper, self.frequency = outside * size, at
            self.delta = delta_values(self.uncertain.blocks, outside * delta)

    def _reached(self, delta: AnyArray, omega: float) -> float | None:
        """A frequency, of the continuous model, at which the member has the level; None where none is seen."""
        if self.real:
            values = delta_values(self.uncertain.blocks, delta)
            try:
                member = self.uncertain.evaluate({name: float(np.real(value)) for name, value in values.items()})
            except NoTrustworthyNumber:
                return omega  # not well posed
            if not member.is_stable():
                return omega
            norm = hinf_norm(member)
            return self._on_the_axis(norm.frequency) if norm.lower >= self.level else None
        at = around(self.model, omega)
        met = [gain_at(M, self.blocks, delta) for M in frequency_response(self.model, at)]
        values = [np.inf if gain is None else gain.value for gain in met]
        k = int(np.argmax(values))
        return float(at[k]) if values[k] >= self.level else None

    def _on_the_axis(self, omega: float) -> float:
        """Frequency of the continuous model that belongs to one of the model as given."""
        return float(np.tan(omega * self.uncertain.dt / 2)) if self.uncertain.M.is_discrete else float(omega)

    def prove(self, tolerance: float) -> None:
        """Cover the axis with D, G at a set nearly as large; then cut it into regions where they leave a gap."""
        lower = 1 / self.upper
        varying = ~performance_inputs(self.blocks)
        # Of ranges that are wider on one side the smallest set around them that is not.
        m, ends = self.model, np.where(varying, widest(self.blocks), 1 / self.level)
        sized = StateSpaceModel(m.A, m.B * ends, m.C, m.D * ends)
        hot = self.frequency if self.frequency is not None and np.isfinite(self.frequency) else None
        first = np.unique(np.concatenate([[0.0, np.inf], self.seeds, [] if hot is None else [hot]]))
        found = np.inf
        # The performance block alone leaves no more than this to what D, G may miss.
        room = max(0.5 * (self.level / self.nominal - 1), 1e-9) if self.nominal else np.inf
        for accuracy in (min(COARSE, room), min(1e-4, room)):
            cover, upper = skewed_cover(
                sized, self.blocks, max(lower, 1 / LARGEST), varying, first=first, budget=self.budget, accuracy=accuracy
            )
            if upper < found:
                found, self.proof = upper, tuple(cover.pieces)
            if found > lower * (1 + 2 * COARSE):
                break
        if found > lower * (1 + tolerance) and lower and any(b.interval for b in self.blocks):
            problem = GainMarginProblem(self.model, self.blocks, self.level, hot)
            proof = tighten(problem, lower, found, tolerance, self.budget)
            if proof.values is not None:
                values = centre_matrix(self.uncertain.blocks, proof.values[:-1])
                self.take((1 + 1e-6) * values, hot or problem.scale)
            if proof.upper < found:
                found, self.proof, self.boxes = proof.upper, tuple(proof.leaves), tuple(problem.proved)
        self.lower = min(1 / found, LARGEST) if np.isfinite(found) else 0.0


def _result(uncertain: UncertainModel, level: float, found: _Search, tolerance: float, timed_out: bool) -> RobustGain:
    lower, upper = found.lower, found.upper
    if lower > upper * (1 + 1e-6):
        text = f"a member of size {upper:.9g} reaches the level inside the proved size {lower:.9g}: digits were lost"
        raise NoTrustworthyNumber("robust_gain", text)
    lower = min(lower, upper)
    close = upper <= lower * (1 + tolerance) * (1 + 1e-9) or (np.isinf(upper) and lower * 32 > LARGEST)
    status = Status.CERTIFIED if close else Status.TIMEOUT if timed_out else Status.INCONCLUSIVE
    physical = uncertain.physical(found.delta) if found.delta else {}
    at = found.frequency
    frequency = None if at is None or not np.isfinite(upper) else model_frequency(uncertain, at)
    return RobustGain(
        lower, upper, frequency, status, level, found.delta, physical, found.proof, uncertain, found.boxes
    )
