"""The largest H-infinity gain over an uncertain model's whole set and the whole frequency axis; robust performance."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from robustlab.arrays import Array
from robustlab.budget import Budget, one_thread, search_budget
from robustlab.errors import InputError, NoTrustworthyNumber, told_as
from robustlab.linear_analysis.frequency import frequency_response
from robustlab.mu_analysis.axis.axis_model import (
    around,
    check_nominal,
    continuous,
    frequencies,
    model_frequency,
    seed_frequencies,
)
from robustlab.mu_analysis.axis.axis_problems import GainProblem, Proved
from robustlab.mu_analysis.axis.intervals import AxisCover, Piece, cover_axis
from robustlab.mu_analysis.axis.margin import PERFORMANCE, Margin, PerformanceMargin, delta_rows
from robustlab.mu_analysis.axis.pole_migration import smallest_destabilising
from robustlab.mu_analysis.axis.stability import robust_stability
from robustlab.mu_analysis.constants import COARSE, MEMBERS, WORK
from robustlab.mu_analysis.matrix.box import Box, block_entries, box_model, centre_matrix, gauge, root_box
from robustlab.mu_analysis.matrix.branch_and_bound import Region
from robustlab.mu_analysis.matrix.gain import Gain, ascend, gain_at, largest_gain
from robustlab.mu_analysis.matrix.skew import gain_curves
from robustlab.mu_analysis.matrix.upper import compile_kernels
from robustlab.norms import QUIET, PeakGain, gain_rounding, hinf_norm
from robustlab.result import Status
from robustlab.shown import Facts, Part, member, number
from robustlab.statespace import StateSpaceModel
from robustlab.tables import Table, Tabular
from robustlab.uncertainty.blocks import Block, FullBlock, delta_matrix, delta_values
from robustlab.uncertainty.lft import UncertainModel

BLURRED = 1e-3  # share of the gain beyond which the bound of rounding leaves out what a zero nearly cancels

__all__ = ["WorstCaseGain", "gain_within", "robust_performance", "worst_case_gain"]


@dataclass(frozen=True, eq=False)
class WorstCaseGain(Tabular, PeakGain):
    """Bounds of the largest gain ``sigma_max`` of any member of the set at any frequency.

    Attributes
    ----------
    lower, upper
        ``lower <= worst gain <= upper``. ``lower`` is the gain of the member at ``delta``; ``upper`` is proved over the
        whole frequency axis and the whole set. Both are inf where a member is unstable.
    frequency
        Frequency in rad/s at which the member at ``delta`` has the gain ``lower`` (of an unstable one: of its pole).
    delta
        The worst Delta found, one value per block name.
    physical
        The worst values and units of the physical parameters.
    nominal
        Gain of the nominal member.
    status
        CERTIFIED: ``upper`` is proved. INCONCLUSIVE: it is not, and reads inf. TIMEOUT: the time limit ended the
        proof; ``upper`` is what was proved by then. INACCURATE: there is no uncertainty, and digits of the nominal
        gain were lost.
    omega, nominal_gain, gain_lower, gain_upper
        Curves over the frequencies that were asked for.
    intervals
        ``(low, high, bound)`` in rad/s: what is proved with D, G scalings.
    open
        Frequency intervals for which nothing is proved.
    proof
        What ``upper`` rests on: pieces of the axis with their D, G, or regions of parameters and frequency.
    notes
        Remarks for the reader of a report.
    system, boxes
        The set that it is about, and each box of a branch and bound with an interval proved in it, for
        `robustlab.verify`.
    """

    delta: Mapping[str, Any]
    physical: Mapping[str, tuple[float, str]]
    nominal: float
    omega: Array
    nominal_gain: Array
    gain_lower: Array
    gain_upper: Array
    intervals: tuple[tuple[float, float, float], ...]
    open: tuple[tuple[float, float], ...]
    proof: tuple[Piece, ...] | tuple[Region, ...]
    system: UncertainModel | None = None
    boxes: tuple[tuple[Box, Piece], ...] = ()

    quantities: ClassVar[Mapping[str, Any]] = {**PeakGain.quantities, "frequency": "rad/s", "nominal": float}
    unsaved: ClassVar[tuple[str, ...]] = ("proof", "system", "boxes")

    @property
    def gap(self) -> float:
        """``upper / lower - 1``; 0 where both are zero or both infinite."""
        if self.lower == self.upper:
            return 0.0
        return self.upper / self.lower - 1 if self.lower > 0 else float("inf")

    def evidence(self) -> Facts:
        """The worst member, and what proves the bound."""
        return [
            ("nominal gain", number(self.nominal)),
            ("worst member", member(self.delta, self.physical)),
            ("proof", f"{len(self.proof)} parts, {len(self.open)} intervals of frequency left open"),
        ]

    def details(self) -> list[Part]:
        return [Part("worst Delta found:", ("block", "delta", "parameter"), delta_rows(self.delta, self.physical))]

    def proved(self) -> Part:
        """The frequency intervals with the bound of the gain that is proved in each; inf: none is."""
        rows = [*self.intervals, *((low, high, math.inf) for low, high in self.open)]
        texts = [(f"{low:.6g}", f"{high:.6g}", f"{bound:.6g}") for low, high, bound in sorted(rows)]
        return Part("proved intervals:", ("from rad/s", "to rad/s", "gain at most"), texts)

    def table(self) -> Table:
        """Nominal gain and both bounds over the frequencies that were asked for."""
        columns = {"nominal": self.nominal_gain, "lower": self.gain_lower, "upper": self.gain_upper}
        return Table(("omega", self.omega), columns, {"omega": "rad/s"})

    def to_json(self) -> dict[str, Any]:
        return {**super().to_json(), "gap": self.gap}


@told_as("worst_case_gain")
def worst_case_gain(
    uncertain: UncertainModel,
    omega: ArrayLike | None = None,
    tolerance: float = 0.01,
    time_limit: float | None = None,
    seed: int = 0,
    effort: float = 1.0,
) -> WorstCaseGain:
    """`robustlab.peak_gain` of an uncertain model."""
    compile_kernels()
    budget = search_budget("worst_case_gain", WORK, effort, time_limit)
    with one_thread():
        return gain_within(uncertain, budget, omega, tolerance, seed)


def gain_within(
    uncertain: UncertainModel,
    budget: Budget,
    omega: ArrayLike | None = None,
    tolerance: float = 0.01,
    seed: int = 0,
) -> WorstCaseGain:
    """`worst_case_gain` within the budget of a search that it is a part of."""
    check_nominal(uncertain, "worst_case_gain")
    if not tolerance > 0:
        raise InputError("worst_case_gain", f"tolerance {tolerance}", "tolerance > 0")
    grid = frequencies(omega, "worst_case_gain")
    n_u, n_y = len(uncertain.inputs), len(uncertain.outputs)
    nominal = hinf_norm(uncertain.nominal)
    if not n_u or not n_y:
        return _result(uncertain, nominal.value, _Known(0.0), budget, (), grid)
    if not uncertain.blocks:
        known = _Known(nominal.upper, lower=nominal.lower, frequency=nominal.frequency)
        notes = ("no uncertainty: the gain is the nominal one", *([nominal.reason] if nominal.reason else []))
        found = _result(uncertain, nominal.value, known, budget, notes, grid)
        return found if nominal.status is Status.CERTIFIED else replace(found, status=nominal.status)
    blocks = (*uncertain.blocks, FullBlock(PERFORMANCE, n_u, n_y))
    model = continuous(uncertain.M)
    seeds = seed_frequencies(model)
    unstable = smallest_destabilising(continuous(uncertain.delta_channels), uncertain.blocks, seeds, seed)
    if unstable is not None and gauge(uncertain.blocks, block_entries(uncertain.blocks, unstable.delta)) <= 1:
        at = model_frequency(uncertain, abs(unstable.pole.imag)) if np.isfinite(unstable.pole) else None
        known = _Known(lower=np.inf, delta=delta_values(uncertain.blocks, unstable.delta), frequency=at)
        return _result(uncertain, nominal.value, known, budget, ("a member of the set is unstable",), grid)
    known = _largest_member(uncertain, model, blocks, seeds, seed)
    _prove(known, model, blocks, seeds, tolerance, budget, uncertain)
    with np.errstate(all="ignore"):
        error = _rounding(known, uncertain)
    if not error <= QUIET * known.lower:
        # Four times: the member is rounded, mapped to continuous time, scaled, and its response is solved for.
        known.lower = max(known.lower - 4.0 * error, 0.0) if np.isfinite(error) else 0.0
    return _result(uncertain, nominal.value, known, budget, (), grid, model, blocks, seed)


@told_as("robust_performance")
def robust_performance(uncertain: UncertainModel, **options: Any) -> Margin:
    r"""Robust performance margin: the largest k with gain below ``1 / k`` for all Delta of size below k.

    It is the stability margin of the set with a full performance block between the outputs and the inputs, called
    ``"performance"``: :math:`1 / \sup_\omega \mu_{\Delta, P}(M(j \omega))`. Above 1, every member of the set has a gain
    below 1.

    Parameters
    ----------
    uncertain
        Uncertain model whose inputs and outputs are weighted.
    **options
        Those of `robust_stability`.

    Returns
    -------
    Margin
        As of `robust_stability`; ``delta`` holds the performance block ``(n_inputs, n_outputs)`` as well.

    Raises
    ------
    InputError
        No inputs or no outputs, or a block that is called ``"performance"`` already.
    NoTrustworthyNumber
        The nominal model is unstable.

    References
    ----------
    Doyle, Wall, Stein, "Performance and robustness analysis for structured uncertainty" (1982), main loop theorem.
    """
    return PerformanceMargin(**vars(robust_stability(with_performance(uncertain), **options)))


def with_performance(uncertain: UncertainModel) -> UncertainModel:
    """The model with a full performance block between its outputs and its inputs; see `robust_performance`."""
    check_nominal(uncertain, "robust_performance")
    n_u, n_y = len(uncertain.inputs), len(uncertain.outputs)
    if not n_u or not n_y:
        raise InputError("robust_performance", f"{n_u} inputs and {n_y} outputs", "at least one of each")
    if PERFORMANCE in [b.name for b in uncertain.blocks]:
        raise InputError("robust_performance", f"a block is called {PERFORMANCE!r}", "another name for it")
    return UncertainModel(uncertain.M, (*uncertain.blocks, FullBlock(PERFORMANCE, n_u, n_y)))


# --- from below ------------------------------------------------------------------------------------------------------


@dataclass
class _Known(Proved):
    """The member of largest gain known, and what is proved (``level``)."""

    lower: float = 0.0
    delta: Mapping[str, Any] = field(default_factory=dict)
    frequency: float | None = None


def _largest_member(
    uncertain: UncertainModel,
    model: StateSpaceModel,
    blocks: Sequence[Block],
    seeds: Array,
    seed: int,
) -> _Known:
    """The member of largest gain found: ascents at many frequencies, the best ones followed to their own peaks."""
    rng = np.random.default_rng(seed)
    peak = hinf_norm(uncertain.nominal).frequency
    omega = np.unique(np.concatenate([[0.0], seeds, [_mapped(uncertain, peak)]]))
    omega = omega[np.isfinite(omega)]
    box = root_box(blocks)
    met = [
        (gain, float(w))
        for w, M in zip(omega, frequency_response(model, omega), strict=True)
        if (gain := largest_gain(M, blocks, box, rng, 4)) is not None
    ]
    best = _Known()
    for gain, w in sorted(met, key=lambda pair: -pair[0].value)[:MEMBERS]:
        found = _followed(uncertain, model, blocks, gain, w, box)
        if found.lower > best.lower:
            best = found
    return best


def _followed(
    uncertain: UncertainModel, model: StateSpaceModel, blocks: Sequence[Block], gain: Gain, omega: float, box: Box
) -> _Known:
    """In turn the peak frequency of a member and the ascent at that frequency, as long as the gain rises."""
    best = _Known()
    for _ in range(20):
        reached = _member_gain(uncertain, model, blocks, gain, omega)
        if reached.lower <= best.lower * (1 + 1e-9):
            break
        best = reached
        omega = _mapped(uncertain, reached.frequency or 0.0)
        if not np.isfinite(omega):
            break
        M = frequency_response(model, np.array([omega]))[0]
        higher = ascend(M, blocks, gain.delta, box)
        if higher is None:
            break
        gain = higher
    return best


def _member_gain(
    uncertain: UncertainModel, model: StateSpaceModel, blocks: Sequence[Block], gain: Gain, omega: float
) -> _Known:
    """The gain of one member: its H-infinity norm where Delta is real, else its largest gain over frequency nearby."""
    values = delta_values(uncertain.blocks, gain.delta)
    if all(b.interval for b in uncertain.blocks):
        clipped = {name: float(np.clip(value, -1.0, 1.0)) for name, value in values.items()}
        norm = hinf_norm(uncertain.evaluate(clipped))
        return _Known(lower=norm.lower, delta=clipped, frequency=norm.frequency)
    at = around(model, omega)
    gains = [gain_at(M, blocks, gain.delta) for M in frequency_response(model, at)]
    k = int(np.argmax([0.0 if g is None else g.value for g in gains]))
    chosen = gains[k]
    frequency = model_frequency(uncertain, float(at[k]))
    return _Known(lower=0.0 if chosen is None else chosen.value, delta=values, frequency=frequency)


def _rounding(known: _Known, uncertain: UncertainModel) -> float:
    """What rounding may have added to the lower bound; 0 where there is none."""
    if not 0 < known.lower < np.inf or known.frequency is None:
        return 0.0
    M, delta = uncertain.M, np.asarray(delta_matrix(uncertain.blocks, known.delta))
    q, p = delta.shape
    left = delta @ np.linalg.inv(np.eye(p) - M.D[:p, :q] @ delta)
    A, B = M.A + M.B[:, :q] @ left @ M.C[:p], M.B[:, q:] + M.B[:, :q] @ left @ M.D[:p, q:]
    C, D = M.C[p:] + M.D[p:, :q] @ left @ M.C[:p], M.D[p:, q:] + M.D[p:, :q] @ left @ M.D[:p, q:]
    # What cancels in the member's matrices is rounded before it cancels.
    across, onto = np.abs(M.B[:, :q]) @ np.abs(left), np.abs(M.D[p:, :q]) @ np.abs(left)
    into, through = np.abs(M.C[:p]), np.abs(M.D[:p, q:])
    sums = (
        np.abs(M.A) + across @ into, np.abs(M.B[:, q:]) + across @ through,
        np.abs(M.C[p:]) + onto @ into, np.abs(M.D[p:, q:]) + onto @ through,
    )  # fmt: skip
    s = np.exp(1j * known.frequency * M.dt) if M.is_discrete else 1j * known.frequency
    at = complex(s) if np.isfinite(known.frequency) else complex(np.inf)
    error = gain_rounding(A, B, C, D, at, sums)
    if error <= BLURRED * known.lower or not np.isfinite(at):
        return error
    # What a zero nearly cancels in a mode is not seen: C (sI - A)^-1 in the place of |C| |(sI - A)^-1|.
    n, eps = len(A), float(np.finfo(float).eps)
    inverse = np.linalg.inv(at * np.eye(n) - A)
    X, terms, seen = np.abs(inverse @ B), sums[0] + abs(at) * np.eye(n), np.abs(C @ inverse)
    seen = seen + n * eps * (seen @ terms) @ np.abs(inverse)
    return n * eps * float(np.linalg.norm(sums[3] + sums[2] @ X + seen @ (terms @ X + sums[1])))


def _mapped(uncertain: UncertainModel, omega: float) -> float:
    """Frequency on the axis of the continuous model that belongs to one of the model itself."""
    return float(np.tan(omega * uncertain.dt / 2)) if uncertain.M.is_discrete else float(omega)


# --- from above ------------------------------------------------------------------------------------------------------


def _prove(
    known: _Known,
    model: StateSpaceModel,
    blocks: Sequence[Block],
    seeds: Array,
    tolerance: float,
    budget: Budget,
    uncertain: UncertainModel,
) -> None:
    """Cover the axis with D, G; then cut the set into boxes where they leave more than the tolerance."""
    peak = _mapped(uncertain, known.frequency or 0.0)
    first, centred = np.append(seeds, peak), _about_the_centre(model, blocks)
    known.cover = AxisCover()
    if centred is not None:
        varying = np.arange(model.n_inputs) >= model.n_inputs - blocks[-1].rows  # the performance is the last block
        for accuracy in (COARSE, 1e-4):
            cover = cover_axis(
                centred, blocks, known.lower, first=first, budget=budget, accuracy=accuracy, varying=varying
            )
            if accuracy == COARSE or (not cover.open and cover.beta < known.level):
                known.cover, known.level = cover, np.inf if cover.open else cover.beta
            if known.level > known.lower * (1 + 2 * COARSE):
                break
    known.proof = tuple(known.cover.pieces)
    if any(b.interval for b in blocks) and 0 < known.lower * (1 + tolerance) < known.level:
        values = known.cut(GainProblem(model, blocks, peak), known.lower, tolerance, budget)
        if values is not None:
            _take_member(known, uncertain, blocks, values)
    if known.level < known.lower * (1 - 1e-5):
        text = f"a member has the gain {known.lower:.9g} above the proved bound {known.level:.9g}: digits were lost"
        raise NoTrustworthyNumber("worst_case_gain", text)
    known.level = max(known.level, known.lower)


def _take_member(known: _Known, uncertain: UncertainModel, blocks: Sequence[Block], values: Array) -> None:
    """A member met in branch and bound, by its own norm."""
    delta = centre_matrix(blocks[:-1], values[:-1]).astype(complex)
    member = delta_values(uncertain.blocks, delta)
    if not all(b.interval for b in uncertain.blocks):
        member = {name: value for name, value in member.items() if np.any(value)}
    norm = hinf_norm(uncertain.evaluate(member))
    if norm.lower > known.lower:
        known.lower, known.delta, known.frequency = norm.lower, member, norm.frequency


def _about_the_centre(model: StateSpaceModel, blocks: Sequence[Block]) -> StateSpaceModel | None:
    """The model as the normalised Delta sees it where ranges are asymmetric; None where it is not stable there."""
    box = root_box(blocks)
    if not box.centre.any():
        return model
    shifted = box_model(model, blocks, Box(box.centre, np.append(box.half[:-1], 1.0)))
    return None if shifted is None or not shifted.is_stable() else shifted


# --- the answer ------------------------------------------------------------------------------------------------------


def _result(
    uncertain: UncertainModel,
    nominal: float,
    known: _Known,
    budget: Budget,
    notes: tuple[str, ...],
    grid: Array,
    model: StateSpaceModel | None = None,
    blocks: Sequence[Block] = (),
    seed: int = 0,
) -> WorstCaseGain:
    proved = np.isfinite(known.level) or not np.isfinite(known.lower)
    nominal_gain, low, high = _curves(uncertain, grid, model, blocks, seed)
    unproved = "" if proved else "no upper bound: the set was not proved stable"
    return WorstCaseGain(
        lower=known.lower,
        upper=known.level,
        frequency=known.frequency,
        status=Status.TIMEOUT if budget.struck else Status.CERTIFIED if proved else Status.INCONCLUSIVE,
        nominal=nominal,
        omega=grid,
        nominal_gain=nominal_gain,
        gain_lower=low,
        gain_upper=high,
        **known.fields(uncertain, known.delta, budget, notes, unproved),
    )


def _curves(
    uncertain: UncertainModel, grid: Array, model: StateSpaceModel | None, blocks: Sequence[Block], seed: int
) -> tuple[Array, Array, Array]:
    """Nominal gain, largest gain found and D-G bound of it at each frequency of the grid."""
    nominal = frequency_response(uncertain.nominal, grid)
    gain = np.linalg.norm(nominal, 2, axis=(1, 2)) if nominal.size else np.zeros(len(grid))
    if model is None or not len(grid):
        return gain, gain.copy(), gain.copy()
    response = frequency_response(uncertain.M, grid)
    low, high, _ = gain_curves(response, blocks, np.random.default_rng(seed), 4, 1e-3)
    return gain, low, np.maximum(high, low)
