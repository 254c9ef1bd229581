"""Robust stability and worst-case gain of an uncertain model over the whole frequency axis; robust performance."""

# Each is the peak of skewed mu. Either all blocks grow with the level (stability: a level is mu), or the performance
# block alone (a level is a gain). A search finds a member that attains a level; constant D, G on intervals that cover
# the axis prove another; branch and bound over the real parameters closes the gap.

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from robustlab.arrays import Array, ComplexArray
from robustlab.budget import Budget, dense, one_thread, search_budget
from robustlab.errors import InputError, NoTrustworthyNumber, error_context
from robustlab.linear_analysis.frequency import frequency_response
from robustlab.mu_analysis.axis.intervals import (
    AxisCover,
    Piece,
    around,
    check_nominal,
    continuous,
    cover_axis,
    cover_parts,
    extend,
    extend_work,
    frequencies,
    model_frequency,
    next_points,
    remaining,
    seed_frequencies,
    typical_speed,
)
from robustlab.mu_analysis.axis.margin import PERFORMANCE, Margin, PerformanceMargin, WorstCaseGain
from robustlab.mu_analysis.axis.pole_migration import (
    REACH,
    Destabilising,
    ascended,
    directions,
    first_crossing,
    member_poles,
    member_size,
    member_work,
    shrunk,
    smaller_destabilising,
    smallest_destabilising,
)
from robustlab.mu_analysis.matrix.block_structure import delta_layout, delta_norm
from robustlab.mu_analysis.matrix.bounds import Gain, ascend, gain_at, gain_curves, largest_gain
from robustlab.mu_analysis.matrix.branch_and_bound import (
    Box,
    Improved,
    Region,
    block_entries,
    block_weights,
    box_model,
    centre_matrix,
    lowest,
    root_box,
    tighten,
)
from robustlab.mu_analysis.matrix.lower import SINGULAR, lower_bounds, singularity
from robustlab.mu_analysis.matrix.upper import (
    WORK,
    UpperBound,
    compile_kernels,
    points_below,
    points_work,
    upper_bounds,
)
from robustlab.norms import QUIET, gain_rounding, hinf_norm
from robustlab.result import Status
from robustlab.statespace import StateSpaceModel
from robustlab.uncertainty.blocks import Block, FullBlock, delta_matrix, delta_values
from robustlab.uncertainty.lft import UncertainModel

COARSE = 4e-3  # accuracy of the first cover, which decides whether branch and bound is needed
MEMBERS = 6  # members whose gain is maximised over frequency
FINEST = 1e-9  # smallest accuracy: closer bounds differ by rounding only
CONTRADICTS = 1e-5  # largest relative excess of an attained level over a proved one that is due to rounding
GAIN_ACCURACY = 1e-4  # of the cover of a gain
ASCENT_SHARE = 0.25  # of the work left, for the search by modes
NORM_WIDTH = 1e-9  # relative width of the bracket of the norm for one full block
# Search for a smaller complex Delta around a frequency: half width of the first neighbourhood in log frequency, factor
# of reduction, last width relative to the distance of the nearest pole, and the largest number.
WIDEST, NARROWER, NARROWEST, NEIGHBOURHOODS = 0.1, 5.0, 8e-4, 60
SIZES = 12  # sizes of an asymmetric set that are tried to find the largest one that D, G prove
LARGE = 1e3  # the first of them if no destabilising member is known
FINEST_SIDE = 1e-5  # smallest accuracy of a cover in a box, for its narrower side
# Of branch and bound over the axis. A region is proved where intervals with constant D, G cover its open frequencies; a
# proof for an ancestor also holds in it.
INSIDE = 0.98  # level aimed at in a region; smaller: wider intervals, more cuts
PROVED = 0.9999  # a level below this proves the point
MISSES = 3  # consecutive unproved frequencies after which a region is cut; more: fewer repeated, more useless proofs
ASCENT_WORK = 200  # measured work of a step of an ascent without its eigenvalues
CORNERS = 4  # steps of the ascent of a gain from the centre of a region
NEAR_MISS = 0.01  # log width around a missed frequency in which no other is tried before the cut
BLURRED = 1e-3  # share of the gain beyond which the rounding bound omits modes that a zero nearly cancels


@dataclass
class _Search:
    """The level that a member attains, the smallest proved one, and the evidence of both."""

    uncertain: UncertainModel
    model: StateSpaceModel
    blocks: tuple[Block, ...]
    budget: Budget
    seed: int = 0
    attained: float = 0.0
    level: float = np.inf
    cover: AxisCover = field(default_factory=lambda: AxisCover(open=[]))
    proof: tuple[Piece, ...] | tuple[Region, ...] = ()
    # Each box with an interval that branch and bound has proved in it: the evidence of the whole proof.
    boxes: list[tuple[Box, Piece]] = field(default_factory=list)
    hot: float | None = None  # where branch and bound begins

    # Proves a level by constant D, G; takes a member that branch and bound has found.
    over_the_axis: ClassVar[Callable[..., None]]
    take_member: ClassVar[Callable[..., None]]

    def root(self, level: float) -> Region:
        """Return the set of a level on the whole axis."""
        raise NotImplementedError

    def attack(self, region: Region, level: float, budget: Budget) -> Improved | None:
        """Search for a worse member in a region."""
        raise NotImplementedError

    def better_member(self, budget: Budget) -> Improved | None:
        """Search for a worse member by another method, if there is one."""
        return None

    def prove(self, first: Array, accuracy: float, tolerance: float) -> None:
        """Cover the axis, more closely where that may suffice, then branch if the bounds are farther apart."""
        self.over_the_axis(first, max(accuracy, COARSE))
        near = self.level <= self.attained * (1 + tolerance) * (1 + 2 * COARSE)
        if not self.cover.open and accuracy < COARSE and (near or not self.attained):
            middles = [p.low + 0.5 * (p.high - p.low) for p in self.cover.pieces if np.isfinite(p.high)]
            again = replace(self)
            again.over_the_axis(np.append(first, np.unique(middles)), accuracy)
            if again.level < self.level:
                self.level, self.cover, self.proof = again.level, again.cover, again.proof
        if any(b.interval for b in self.blocks) and 0 < self.attained * (1 + tolerance) < self.level:
            self.cut(tolerance)
        if self.level < self.attained * (1 - CONTRADICTS):
            text = f"a member attains the level {self.attained:.9g} above the proved {self.level:.9g}: digits were lost"
            raise NoTrustworthyNumber("robustness", text)

    def cut(self, tolerance: float) -> None:
        """Reduce the gap of the D, G bounds by branch and bound over the real parameters."""
        found = tighten(self, self.attained, self.level, tolerance, self.budget, self.better_member)
        if found.upper < self.level:
            self.level, self.proof = found.upper, tuple(found.leaves)
            self.cover.open.clear()
        else:
            self.boxes.clear()
        if found.values is not None:
            self.take_member(found.values)

    def work(self, count: int) -> int:
        """Return the work of a D-G bound and an interval of each region, and the eigenvalues of a few members."""
        each = dense(self.model.n_states) // 2 + extend_work(self.model)
        return points_work(self.blocks, count) // 4 + count * each

    def examine(self, regions: list[Region]) -> list[Array | None]:
        """Try to prove an interval around one frequency of each region."""
        for region in regions:
            region.model = region.model or box_model(self.model, self.blocks, region.box)
        models = [r.model for r in regions]
        places = [self._frequency(r) for r in regions]
        sound = {k: m for k, m in enumerate(models) if m is not None}
        result: list[Array | None] = [np.ones(len(self.blocks)) for _ in regions]
        if not sound:
            return result
        responses = np.concatenate([frequency_response(m, np.array([places[k]])) for k, m in sound.items()])
        bounds = points_below(responses, self.blocks, INSIDE, thorough=False)
        for (k, model), M, bound in zip(sound.items(), responses, bounds, strict=True):
            region, result[k] = regions[k], None
            piece = extend(model, bound, 1.0, places[k]) if bound.beta < PROVED else None
            if piece is not None and piece.low <= places[k] <= piece.high:
                self.boxes.append((region.box, piece))
                region.open, region.in_a_row = remaining(region.open, piece.low, piece.high), 0
            else:
                region.missed.append((bound.beta, places[k], block_weights(M, bound, self.blocks)))
                region.in_a_row += 1
            if region.open and (region.in_a_row == MISSES or not self._open_parts(region)):
                _, region.hot, result[k] = max(region.missed, key=lambda miss: miss[0])
        return result

    def _open_parts(self, region: Region) -> list[tuple[float, float]]:
        """Return the open frequencies that are not next to a missed one."""
        near, left = np.exp(NEAR_MISS), region.open
        for _, omega, _ in region.missed:
            left = remaining(left, omega / near, omega * near)
        return left

    def _frequency(self, region: Region) -> float:
        """Return the frequency missed in the parent first, then the middle of the widest part."""
        if not region.missed and region.hot is not None and any(a <= region.hot <= b for a, b in region.open):
            return region.hot
        return float(next_points(self._open_parts(region), typical_speed(self.model), 1)[0])

    def fields(self, delta: Mapping[str, Any], notes: Sequence[str], last: str = "") -> dict[str, Any]:
        """Return the fields of every result about its proof and its Delta; empty notes are omitted."""
        uncertain = self.uncertain
        intervals, left_open = self.cover.reported(uncertain.dt, self.level)
        if self.proof and isinstance(self.proof[0], Region):
            notes = [*notes, f"proved by branch and bound; regions of parameters and frequency: {len(self.proof)}"]
        every = [*notes, self.budget.remark, last, *uncertain.impossible(delta), *uncertain.remarks]
        return {
            "delta": delta, "physical": uncertain.physical(delta) if delta else {}, "intervals": intervals,
            "open": left_open, "proof": self.proof, "boxes": tuple(self.boxes), "system": uncertain,
            "notes": tuple(note for note in every if note),
        }  # fmt: skip


# --- stability -------------------------------------------------------------------------------------------------------


@error_context("robust_stability")
@one_thread()
def robust_stability(
    uncertain: UncertainModel,
    omega: ArrayLike | None = None,
    accuracy: float = 3e-5,
    time_limit: float | None = None,
    seed: int = 0,
    tolerance: float = 0.01,
    effort: float = 1.0,
    *,
    budget: Budget | None = None,
) -> Margin:
    """`robustlab.robust_stability` of a set; ``budget``: of a larger search, instead of an effort and a time limit."""
    compile_kernels()
    budget = budget or search_budget("robust_stability", WORK, effort, time_limit)
    check_nominal(uncertain, "robust_stability")
    if not FINEST <= accuracy < 1 or not tolerance > 0:
        found = f"accuracy {accuracy}, tolerance {tolerance}"
        raise InputError("robust_stability", found, f"{FINEST:g} <= accuracy < 1, tolerance > 0")
    grid = frequencies(omega, "robust_stability")
    blocks = uncertain.blocks
    search = _Stability(uncertain, continuous(uncertain.delta_channels), blocks, budget, seed)
    if not blocks:
        search.level = 0.0
        return search.answer(grid, np.zeros(len(grid)), np.zeros(len(grid)), "no uncertainty: mu = 0")
    first = search.find_member()
    if not search.proof:
        search.prove(first, accuracy, tolerance)
    response = frequency_response(uncertain.delta_channels, grid)
    mu_lower = np.array([value for value, _ in lower_bounds(response, blocks, seed, restarts=4, steps=24)])
    mu_upper = np.array([b.beta for b in upper_bounds(response, blocks, 1e-3)])
    symmetric = "the curves over frequency are those of ranges as wide below as above; the margin itself takes ranges "
    note = f"{symmetric}as they are" if len(grid) and not search.symmetric else ""
    return search.answer(grid, mu_lower, mu_upper, note)


@dataclass
class _Stability(_Search):
    """Levels are mu: the smallest destabilising Delta known has the size of one over ``attained``."""

    worst: Destabilising | None = None

    @property
    def symmetric(self) -> bool:
        return bool((lowest(self.blocks) == -1).all())

    def take(self, found: Destabilising | None) -> bool:
        """Keep a destabilising Delta that is smaller than the one known; return whether it is."""
        size = np.inf if found is None else member_size(self.blocks, found)
        if found is None or not size * self.attained < 1:
            return False
        if singularity(self.model.D.astype(complex), found.delta) <= SINGULAR * 1e3:  # the loop is ill-posed
            found = Destabilising(found.norm, found.delta, complex(np.inf))
        if np.isfinite(found.pole) and found.pole.imag < 0:
            found = Destabilising(found.norm, np.conj(found.delta), np.conj(found.pole))
        self.worst, self.attained = found, 1 / size
        self.hot = abs(found.pole.imag) if np.isfinite(found.pole) else None
        return True

    def find_member(self) -> Array:
        """Search for a small destabilising Delta; return the first frequencies of a cover."""
        if self._solve_one_full_block():
            return np.zeros(0)
        seeds = seed_frequencies(self.model)
        self.take(smallest_destabilising(self.model, self.blocks, seeds, self.seed))
        if self.symmetric:  # this search measures entries of Delta, not their share of each side of a range
            self._sharpen()
        else:
            self._smallest_asymmetric(seeds)
        return seeds if self.hot is None else np.append(seeds, self.hot)

    def _solve_one_full_block(self) -> bool:
        """Use the H-infinity norm if there is one full block; return whether it does."""
        model, block = self.model, self.blocks[0]
        if len(self.blocks) > 1 or not block.is_ball or block.d_order > 1 or block.g_basis():
            return False
        norm = hinf_norm(model, NORM_WIDTH)
        if norm.status is not Status.CERTIFIED or not np.isfinite(norm.upper):
            return False
        q, p = model.n_inputs, model.n_outputs
        scalings = UpperBound(norm.upper, np.eye(q) + 0j, np.eye(p) + 0j, np.zeros((q, p), dtype=complex))
        self.level, self.proof = norm.upper, (Piece(0.0, np.inf, norm.upper, scalings),)
        self.cover = AxisCover(list(self.proof), [])
        if norm.lower > 0:  # prefer an end of the axis, where M is real, if the peak is as high there
            for omega in (0.0, np.inf, norm.frequency):
                u, sigma, vh = np.linalg.svd(frequency_response(model, [omega])[0])
                if sigma[0] >= norm.lower * (1 - NORM_WIDTH):
                    break
            delta = np.outer(vh[0].conj(), u[:, 0].conj()) / sigma[0]
            pole = complex(0.0, omega) if omega < np.inf else complex(np.inf)
            self.take(Destabilising(1 / float(sigma[0]), delta, pole))
        return True

    def _sharpen(self) -> None:
        """Refine the smallest Delta around its peak, since mu with complex blocks is smooth over frequency."""
        model, blocks = self.model, self.blocks
        if self.worst is None or not np.isfinite(self.worst.pole) or all(b.interval for b in blocks):
            return
        omega, reach = self.worst.pole.imag, WIDEST
        distance = np.abs(1j * omega - model.poles()).min(initial=omega)
        for _ in range(NEIGHBOURHOODS if omega > 0 else 0):
            response = frequency_response(model, omega * np.exp(np.linspace(-reach, reach, 9)))
            found = lower_bounds(response, blocks, self.seed, restarts=12)
            k = int(np.argmax([value for value, _ in found]))
            value, delta = found[k]
            at = omega * float(np.exp(reach * (k / 4 - 1)))
            if delta is not None and self.take(Destabilising(1 / value, delta, complex(0.0, at))):
                omega = at
                if k in (0, 8):  # the peak is outside
                    continue
            if reach * omega < NARROWEST * distance:
                break
            reach /= NARROWER

    def _smallest_asymmetric(self, seeds: Array) -> None:
        """Search from the set's centre for a destabilising Delta that is small relative to each side of its range."""
        model, blocks = self.model, self.blocks
        for _ in range(4):
            box = root_box(blocks, 1 / self.attained if self.attained else LARGE)
            inside = box_model(model, blocks, box)
            whole = centre_matrix(blocks, box.centre).astype(complex)
            found: Destabilising | None = None
            if inside is not None and inside.is_stable():
                again = smallest_destabilising(inside, blocks, seeds, self.seed)
                if again is None:
                    break
                whole = whole + np.repeat(box.half, [b.rows for b in blocks])[:, None] * again.delta
                if not np.isfinite(again.pole):  # a pole at infinity crosses no axis
                    found = Destabilising(delta_norm(blocks, whole), whole, complex(np.inf))
            if not self.take(found or first_crossing(model, blocks, whole)):
                break

    def over_the_axis(self, first: Array, accuracy: float) -> None:
        if not self.symmetric:
            return self._over_the_axis_asymmetric(first, accuracy)
        cover = cover_parts(self.model, self.blocks, self.attained, first=first, budget=self.budget, accuracy=accuracy)
        self.cover, self.proof, self.level = cover, tuple(cover.pieces), np.inf if cover.open else cover.beta
        return None

    def _over_the_axis_asymmetric(self, first: Array, accuracy: float) -> None:
        """Find the largest size of the set about the nominal point that a cover about the box's centre proves."""
        # A change of the size moves the narrower side of a range by a smaller share of the width of the box.
        low = -lowest(self.blocks)
        stretch = float(np.max((1 + low) / 2 / np.minimum(1.0, low)))
        fine = max(accuracy / stretch, FINEST_SIDE)
        near = 1 + max(2 * fine * stretch, COARSE)
        self.proof, self.level, failed = (), np.inf, np.inf
        size = 1 / (self.attained * (1 + fine * stretch)) if self.attained else LARGE
        for _ in range(SIZES):
            inside = box_model(self.model, self.blocks, root_box(self.blocks, size))
            cover, level = AxisCover(), 2.0
            if inside is not None and inside.is_stable():
                cover = cover_axis(inside, self.blocks, 1 / (1 + fine), first=first, budget=self.budget, accuracy=fine)
                if cover.open:
                    self.cover = self.cover if self.proof else cover
                    break
                level = cover.beta
            if level <= 1 + 1e-12:
                self.level, self.proof = 1 / size, tuple(cover.pieces)
                # Inside the box the level is one; for the set it is one over the size of the box.
                pieces = [replace(p, beta=self.level) for p in cover.pieces]
                self.cover = AxisCover(pieces, [])
            else:
                failed = size
                size /= level
            if failed * self.level < near or (self.proof and np.isinf(failed)):
                break
            if self.proof:
                size = float(np.sqrt(failed / self.level))

    def root(self, level: float) -> Region:
        """All Delta of size ``1 / level`` on the whole axis."""
        return Region(root_box(self.blocks, 1 / level), [(0.0, float("inf"))], self.hot)

    def attack(self, region: Region, level: float, budget: Budget) -> Improved | None:
        """Ascend from the centre along the mode next to the missed frequency, in a smaller box."""
        values, blocks, aim = region.box.centre, self.blocks, 1j * (region.hot or 0.0)
        if (member_poles(self.model, blocks, values).real < 0).all():
            found = ascended(self.model, blocks, values, REACH / level, aim)
            looks = 1 if found is None else found.looks
            budget.spend(looks * ASCENT_WORK + member_work(self.model, looks))
            if found is None or found.pole.real <= 0:
                return None
            values = found.values
        whole = Destabilising(np.inf, centre_matrix(blocks, values).astype(complex), complex(np.inf))
        found = shrunk(self.model, blocks, values, whole, budget)
        size = member_size(blocks, found)
        return Improved(1 / size, block_entries(blocks, found.delta)) if size > 0 else None

    def better_member(self, budget: Budget) -> Improved | None:
        # The gap may be due to the search: modes that meet inside the box may give a smaller Delta.
        if self.worst is None or not all(b.interval for b in self.blocks):
            return None
        found = smaller_destabilising(self.model, self.blocks, self.worst, budget.share(ASCENT_SHARE), self.seed)
        return Improved(1 / member_size(self.blocks, found), block_entries(self.blocks, found.delta))

    def take_member(self, values: Array) -> None:
        self.take(first_crossing(self.model, self.blocks, centre_matrix(self.blocks, values).astype(complex)))

    def answer(self, grid: Array, mu_lower: Array, mu_upper: Array, note: str) -> Margin:
        uncertain, worst, unproved = self.uncertain, self.worst, self.cover.open
        delta = delta_values(uncertain.blocks, worst.delta) if worst else {}
        upper = 1 / self.attained if self.attained else np.inf
        lower = 0.0 if unproved else 1 / self.level if self.level > 0 else np.inf
        for array in (grid, mu_lower, mu_upper):
            array.setflags(write=False)
        frequency, pole = None, None
        if worst is not None:
            pole, end = worst.pole, not np.isfinite(worst.pole)
            rounding = 1e-14 * np.linalg.norm(uncertain.M.A)
            at = np.inf if end else abs(pole.imag) if abs(pole.imag) > rounding else 0.0
            frequency = model_frequency(uncertain.dt, at)
            if uncertain.M.is_discrete:
                pole = -1.0 + 0j if end else (1 + pole) / (1 - pole)
        gaps = f"{len(unproved)} frequency intervals not proved: mu_upper holds on the grid only" if unproved else ""
        status = Status.TIMEOUT if self.budget.struck else Status.INCONCLUSIVE if unproved else Status.CERTIFIED
        return Margin(
            lower=min(lower, upper), upper=upper, frequency=frequency, status=status, pole=pole, omega=grid,
            mu_lower=mu_lower, mu_upper=mu_upper, shares=self._shares(), **self.fields(delta, [note, gaps]),
        )  # fmt: skip

    def _shares(self) -> dict[str, float]:
        """Return the share of each block in the margin, summing to one; empty where the margin has no derivative."""
        # Let block i be s_i times as large. The parts c_i = row_i Delta_i x_i of the derivative of the pole that
        # crosses give, by the envelope theorem, d log m / d log s_i = - Re c_i / sum_j Re c_j.
        if self.worst is None or not np.isfinite(self.worst.pole) or not self.model.n_states:
            return {}
        delta = self.worst.delta[None]
        try:
            at = directions(self.model, delta, np.array([self.worst.pole]))
        except np.linalg.LinAlgError:
            return {}
        parts = delta_layout(self.blocks).contributions(delta, at.row, at.x)[0].real
        with np.errstate(divide="ignore", invalid="ignore"):
            shares = parts / parts.sum()
        # Parts that cancel to rounding carry no information, nor does a pole that is not simple.
        if not np.isfinite(shares).all() or np.abs(shares).sum() > 1e9 or np.linalg.norm(at.u) > 1e10:
            return {}
        return {b.name: float(share) for b, share in zip(self.blocks, shares, strict=True)}


# --- performance -----------------------------------------------------------------------------------------------------


@error_context("robust_performance")
def robust_performance(uncertain: UncertainModel, **options: Any) -> Margin:
    r"""Robust performance margin: the largest k with gain below ``1 / k`` for all Delta of size below k.

    It is the stability margin of the set with a full performance block between the outputs and the inputs, called
    ``"performance"``: :math:`1 / \sup_\omega \mu_{\Delta, P}(M(j \omega))`. Above 1, every member of the set has a gain
    below 1 (main loop theorem: Doyle, Wall, Stein, "Performance and robustness analysis for structured uncertainty",
    1982).

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


@error_context("worst_case_gain")
@one_thread()
def worst_case_gain(
    uncertain: UncertainModel,
    omega: ArrayLike | None = None,
    tolerance: float = 0.01,
    time_limit: float | None = None,
    seed: int = 0,
    effort: float = 1.0,
    *,
    budget: Budget | None = None,
) -> WorstCaseGain:
    """`robustlab.peak_gain` of an uncertain model; ``budget`` as in `robust_stability`."""
    compile_kernels()
    budget = budget or search_budget("worst_case_gain", WORK, effort, time_limit)
    check_nominal(uncertain, "worst_case_gain")
    if not tolerance > 0:
        raise InputError("worst_case_gain", f"tolerance {tolerance}", "tolerance > 0")
    grid = frequencies(omega, "worst_case_gain")
    n_u, n_y = len(uncertain.inputs), len(uncertain.outputs)
    nominal = hinf_norm(uncertain.nominal)
    blocks = (*uncertain.blocks, FullBlock(PERFORMANCE, n_u, n_y)) if n_u and n_y else ()
    search = _Gain(uncertain, continuous(uncertain.M), blocks, budget, seed)
    if not blocks:
        search.level = 0.0
        return search.answer(nominal.value, grid)
    if not uncertain.blocks:
        search.level, search.attained, search.frequency = nominal.upper, nominal.lower, nominal.frequency
        notes = ("no uncertainty: the gain is the nominal one", *([nominal.reason] if nominal.reason else []))
        found = search.answer(nominal.value, grid, *notes)
        return found if nominal.status is Status.CERTIFIED else replace(found, status=nominal.status)
    seeds = seed_frequencies(search.model)
    unstable = smallest_destabilising(continuous(uncertain.delta_channels), uncertain.blocks, seeds, seed)
    if unstable is not None and member_size(uncertain.blocks, unstable) <= 1:
        at = model_frequency(uncertain.dt, abs(unstable.pole.imag)) if np.isfinite(unstable.pole) else None
        search.attained, search.delta, search.frequency = np.inf, delta_values(uncertain.blocks, unstable.delta), at
        return search.answer(nominal.value, grid, "a member of the set is unstable")
    search.find_member(seeds, nominal.frequency)
    search.hot = search.mapped(search.frequency or 0.0)
    search.prove(np.append(seeds, search.hot), GAIN_ACCURACY, tolerance)
    search.level = max(search.level, search.attained)
    with np.errstate(all="ignore"):
        error = search.rounding()
    if not error <= QUIET * search.attained:
        # Four times: the member is rounded, mapped to continuous time, scaled, and its response is computed.
        search.attained = max(search.attained - 4.0 * error, 0.0) if np.isfinite(error) else 0.0
    return search.answer(nominal.value, grid)


@dataclass
class _Gain(_Search):
    """Levels are gains: the last block is the performance block, the member at ``delta`` attains one."""

    delta: Mapping[str, Any] = field(default_factory=dict)
    frequency: float | None = None

    def mapped(self, omega: float) -> float:
        """Map a frequency of the given model to the axis of the continuous one."""
        return float(np.tan(omega * self.uncertain.dt / 2)) if self.uncertain.M.is_discrete else float(omega)

    def find_member(self, seeds: Array, nominal_peak: float) -> None:
        """Ascend to large gains at many frequencies; maximise the best ones over frequency."""
        rng, box = np.random.default_rng(self.seed), root_box(self.blocks)
        omega = np.unique(np.concatenate([[0.0], seeds, [self.mapped(nominal_peak)]]))
        omega = omega[np.isfinite(omega)]
        gains = [largest_gain(M, self.blocks, box, rng, 4) for M in frequency_response(self.model, omega)]
        met = [(gain, float(w)) for gain, w in zip(gains, omega, strict=True) if gain is not None]
        for gain, w in sorted(met, key=lambda pair: -pair[0].value)[:MEMBERS]:
            self._take(*self._maximised(gain, w, box))

    def _maximised(self, gain: Gain, omega: float, box: Box) -> tuple[float, Mapping[str, Any], float | None]:
        """Alternate between the peak frequency of a member and an ascent at it while the gain rises."""
        best: tuple[float, Mapping[str, Any], float | None] = 0.0, {}, None
        higher: Gain | None = gain
        for _ in range(20):
            if higher is None or not np.isfinite(omega):
                break
            reached = self._member(higher.delta, omega)
            if reached[0] <= best[0] * (1 + 1e-9):
                break
            best, omega = reached, self.mapped(reached[2])
            if np.isfinite(omega):
                M = frequency_response(self.model, np.array([omega]))[0]
                higher = ascend(M, self.blocks, higher.delta, box)
        return best

    def _member(self, delta: ComplexArray, omega: float) -> tuple[float, Mapping[str, Any], float]:
        """Return a member's gain: its H-infinity norm where Delta is real, else its largest gain near ``omega``."""
        uncertain = self.uncertain
        values = delta_values(uncertain.blocks, delta)
        if all(b.interval for b in uncertain.blocks):
            clipped = {name: float(np.clip(value, -1.0, 1.0)) for name, value in values.items()}
            norm = hinf_norm(uncertain.evaluate(clipped))
            return norm.lower, clipped, norm.frequency
        at = around(self.model, omega)
        gains = [gain_at(M, self.blocks, delta) for M in frequency_response(self.model, at)]
        sizes = [0.0 if g is None else g.value for g in gains]
        k = int(np.argmax(sizes))
        return sizes[k], values, model_frequency(uncertain.dt, float(at[k]))

    def over_the_axis(self, first: Array, accuracy: float) -> None:
        model, box, self.cover = self.model, root_box(self.blocks), AxisCover()
        if box.centre.any():  # the model centred in asymmetric ranges; nothing is proved unless it is stable there
            shifted = box_model(model, self.blocks, Box(box.centre, np.append(box.half[:-1], 1.0)))
            model = shifted if shifted is not None and shifted.is_stable() else None
        if model is not None:
            varying = np.arange(model.n_inputs) >= model.n_inputs - self.blocks[-1].rows
            options: Any = {"first": first, "budget": self.budget, "accuracy": accuracy, "varying": varying}
            self.cover = cover_axis(model, self.blocks, self.attained, **options)
        self.proof, self.level = tuple(self.cover.pieces), np.inf if self.cover.open else self.cover.beta

    def root(self, level: float) -> Region:
        """The unit set, and a performance block of size ``1 / level``."""
        whole = root_box(self.blocks)
        half = whole.half.copy()
        half[-1] = 1 / level
        return Region(Box(whole.centre, half), [(0.0, float("inf"))], self.hot)

    def attack(self, region: Region, level: float, budget: Budget) -> Improved | None:
        """Ascend from the centre to a larger gain at the missed frequency; return the Delta and that frequency."""
        omega = region.hot if region.hot is not None else typical_speed(self.model)
        M, centre = frequency_response(self.model, np.array([omega]))[0], region.box.centre[:-1]
        best = ascend(M, self.blocks, centre_matrix(self.blocks[:-1], centre) + 0j, region.box, CORNERS)
        return None if best is None else Improved(best.value, (best.delta, omega))

    def take_member(self, values: tuple[ComplexArray, float]) -> None:
        self._take(*self._member(*values))

    def _take(self, lower: float, delta: Mapping[str, Any], frequency: float | None) -> None:
        """Keep a member of larger gain."""
        if lower > self.attained:
            self.attained, self.delta, self.frequency = lower, delta, frequency

    def rounding(self) -> float:
        """Return a bound of the rounding error of the lower bound."""
        if not 0 < self.attained < np.inf or self.frequency is None:
            return 0.0
        M, delta = self.uncertain.M, np.asarray(delta_matrix(self.uncertain.blocks, self.delta))
        (q, p), n = delta.shape, M.n_states
        left = delta @ np.linalg.inv(np.eye(p) - M.D[:p, :q] @ delta)
        onto, into = np.vstack([M.B[:, :q], M.D[p:, :q]]), np.hstack([M.C[:p], M.D[:p, q:]])
        rest = np.block([[M.A, M.B[:, q:]], [M.C[p:], M.D[p:, q:]]])
        whole = rest + onto @ left @ into
        # Terms that cancel in the member's matrices are rounded before they cancel.
        terms = np.abs(rest) + np.abs(onto) @ np.abs(left) @ np.abs(into)
        (A, B, C, D), sums = ((X[:n, :n], X[:n, n:], X[n:, :n], X[n:, n:]) for X in (whole, terms))
        s = np.exp(1j * self.frequency * M.dt) if M.is_discrete else 1j * self.frequency
        at = complex(s) if np.isfinite(self.frequency) else complex(np.inf)
        error = float(gain_rounding(A, B, C, D, np.array([at]), sums)[1][0])
        if error <= BLURRED * self.attained or not np.isfinite(at):
            return error
        # Omit modes that a zero nearly cancels: C (sI - A)^-1 in the place of |C| |(sI - A)^-1|.
        eps, inverse = float(np.finfo(float).eps), np.linalg.inv(at * np.eye(n) - A)
        X, terms, seen = np.abs(inverse @ B), sums[0] + abs(at) * np.eye(n), np.abs(C @ inverse)
        seen = seen + n * eps * (seen @ terms) @ np.abs(inverse)
        return n * eps * float(np.linalg.norm(sums[3] + sums[2] @ X + seen @ (terms @ X + sums[1])))

    def answer(self, nominal: float, grid: Array, *notes: str) -> WorstCaseGain:
        """Return the worst gain with its evidence and the curves over the grid."""
        uncertain, proved = self.uncertain, np.isfinite(self.level) or np.isinf(self.attained)
        response = frequency_response(uncertain.nominal, grid)
        curve = np.linalg.norm(response, 2, axis=(1, 2)) if response.size else np.zeros(len(grid))
        low, high = curve.copy(), curve.copy()
        if len(grid) and uncertain.blocks and self.blocks and np.isfinite(self.attained):
            response, rng = frequency_response(uncertain.M, grid), np.random.default_rng(self.seed)
            low, high, _ = gain_curves(response, self.blocks, rng, 4, 1e-3)
            high = np.maximum(high, low)
        status = Status.TIMEOUT if self.budget.struck else Status.CERTIFIED if proved else Status.INCONCLUSIVE
        last = "" if proved else "no upper bound: the set was not proved stable"
        return WorstCaseGain(
            lower=self.attained, upper=self.level, frequency=self.frequency, status=status, nominal=nominal, omega=grid,
            nominal_gain=curve, gain_lower=low, gain_upper=high, **self.fields(self.delta, notes, last),
        )  # fmt: skip
