"""Robust stability of an uncertain model over the whole frequency axis."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import product

import numpy as np
from numpy.typing import ArrayLike

from robustlab.arrays import Array
from robustlab.budget import Budget, one_thread, search_budget
from robustlab.errors import InputError, NoTrustworthyNumber, told_as
from robustlab.linear_analysis.frequency import frequency_response
from robustlab.mu_analysis.axis.axis_model import (
    check_nominal,
    continuous,
    frequencies,
    model_frequency,
    seed_frequencies,
)
from robustlab.mu_analysis.axis.axis_problems import MarginProblem, Proved
from robustlab.mu_analysis.axis.critical_delta import pole_block_sensitivities
from robustlab.mu_analysis.axis.intervals import AxisCover, Piece, cover_axis, cover_parts
from robustlab.mu_analysis.axis.margin import Margin
from robustlab.mu_analysis.axis.mode_ascent import smaller_destabilising
from robustlab.mu_analysis.axis.pole_migration import (
    Destabilising,
    first_crossing,
    smallest_destabilising,
)
from robustlab.mu_analysis.constants import COARSE, SINGULAR, WORK
from robustlab.mu_analysis.matrix.box import block_entries, box_model, centre_matrix, gauge, lowest, root_box
from robustlab.mu_analysis.matrix.certificate import delta_norm, singularity
from robustlab.mu_analysis.matrix.lower import lower_bounds
from robustlab.mu_analysis.matrix.upper import UpperBound, compile_kernels, upper_bounds
from robustlab.norms import hinf_norm
from robustlab.result import Status
from robustlab.statespace import StateSpaceModel
from robustlab.uncertainty.blocks import Block, delta_values
from robustlab.uncertainty.lft import UncertainModel

FEW_CORNERS = 5  # real blocks at most whose corners are tried where the centre of a one-sided set is unstable
FIRST_BRANCHES = 0.02  # share of the work for it before a smaller Delta is sought by modes
SHARPENED, MOST_SHARPENINGS = (0.1, 5.0, 8e-4), 60
# half width, in log frequency, of the first neighbourhood in which a smaller complex Delta is sought, the factor by
# which the next are smaller, and the last one in shares of the distance of the nearest pole
SIZES = 12  # of an asymmetric set, tried for the largest one that D, G prove ...
LARGE = 1e3  # ... the first of them where nothing is known
ASCENT_SHARE = 0.25  # of the work left, for all of it
NORM_WIDTH = 1e-9  # relative width of the bracket of the norm that answers for one full block

__all__ = ["margin_within", "robust_stability"]

FINEST = 1e-9  # bounds closer together than this are told apart by rounding alone
FINEST_SIDE = 1e-5  # relative to the width of a box, a cover in it comes no closer to the narrower side


@dataclass
class _Found(Proved):
    """The smallest destabilising Delta known, and what is proved."""

    model: StateSpaceModel = field(kw_only=True)
    blocks: Sequence[Block] = field(kw_only=True)
    worst: Destabilising | None = None
    expected: float | None = None

    @property
    def attained(self) -> float:
        """Level (inverse size) of the destabilising Delta; 0 where none was found."""
        return 0.0 if self.worst is None else 1 / gauge(self.blocks, block_entries(self.blocks, self.worst.delta))


@told_as("robust_stability")
def robust_stability(
    uncertain: UncertainModel,
    omega: ArrayLike | None = None,
    accuracy: float = 3e-5,
    time_limit: float | None = None,
    seed: int = 0,
    tolerance: float = 0.01,
    expected: float | None = None,
    effort: float = 1.0,
) -> Margin:
    r"""Robust stability margin :math:`1 / \sup_\omega \mu(M_{11}(j \omega))` over the whole axis."""
    compile_kernels()
    budget = search_budget("robust_stability", WORK, effort, time_limit)
    with one_thread():
        return margin_within(uncertain, budget, omega, accuracy, seed, tolerance, expected)


def margin_within(
    uncertain: UncertainModel,
    budget: Budget,
    omega: ArrayLike | None = None,
    accuracy: float = 3e-5,
    seed: int = 0,
    tolerance: float = 0.01,
    expected: float | None = None,
) -> Margin:
    """`robust_stability` within the budget of a search that it is a part of."""
    check_nominal(uncertain, "robust_stability")
    if not FINEST <= accuracy < 1 or not tolerance > 0:
        found = f"accuracy {accuracy}, tolerance {tolerance}"
        raise InputError("robust_stability", found, f"{FINEST:g} <= accuracy < 1, tolerance > 0")
    if expected is not None and not 0 < expected < np.inf:
        raise InputError("robust_stability", f"expected is {expected}", "a positive finite size")
    grid = frequencies(omega, "robust_stability")
    blocks = uncertain.blocks
    model = continuous(uncertain.delta_channels)
    if not blocks:
        zero = np.zeros(len(grid))
        nothing = _Found(0.0, model=model, blocks=blocks)
        return _margin(uncertain, nothing, budget, grid, zero, zero.copy(), "no uncertainty: mu = 0")
    found = _bounds(model, blocks, accuracy, tolerance, budget, seed, expected)
    response = frequency_response(uncertain.delta_channels, grid)
    mu_lower = np.array([value for value, _ in lower_bounds(response, blocks, seed, restarts=4, steps=24)])
    mu_upper = np.array([b.beta for b in upper_bounds(response, blocks, 1e-3)])
    note = "" if len(grid) == 0 or (lowest(blocks) == -1).all() else _SYMMETRIC_CURVES
    return _margin(uncertain, found, budget, grid, mu_lower, mu_upper, note)


_SYMMETRIC_CURVES = (
    "the curves over frequency are those of ranges as wide below as above; the margin itself takes ranges as they are"
)


def _bounds(
    model: StateSpaceModel,
    blocks: Sequence[Block],
    accuracy: float,
    tolerance: float,
    budget: Budget,
    seed: int,
    expected: float | None,
) -> _Found:
    if len(blocks) == 1 and blocks[0].is_ball and blocks[0].d_order == 1 and not blocks[0].g_basis():
        norm = _of_one_full_block(model, blocks, expected)
        if norm is not None:
            return norm
    seeds = seed_frequencies(model)
    symmetric = bool((lowest(blocks) == -1).all())
    worst = smallest_destabilising(model, blocks, seeds, seed) if expected is None else None
    if not symmetric and expected is None:
        worst = _smallest_asymmetric(model, blocks, worst, seeds, seed)
    worst = worst and _as_seen(model, worst)
    if worst and symmetric:  # the search below measures entries of Delta, not their share of each side of a range
        worst = _sharpened(model, blocks, worst, seed)
    found = _Found(0.0, AxisCover(), model=model, blocks=blocks, worst=worst, expected=expected)
    first = np.append(seeds, abs(worst.pole.imag)) if worst and np.isfinite(worst.pole) else seeds

    def cover(found: _Found, first: Array, budget: Budget, accuracy: float) -> None:
        if not symmetric:
            return _cover_asymmetric(found, first, budget, accuracy)
        whole = cover_parts(model, blocks, found.attained, first=first, budget=budget, accuracy=accuracy)
        found.cover, found.level, found.proof = whole, np.inf if whole.open else whole.beta, tuple(whole.pieces)
        return None

    cover(found, first, budget, max(accuracy, COARSE))
    near = found.level <= found.attained * (1 + tolerance) * (1 + 2 * COARSE)
    if not found.cover.open and accuracy < COARSE and (near or (symmetric and not found.attained)):
        again = replace(found)
        middles = [p.low + 0.5 * (p.high - p.low) for p in found.cover.pieces if np.isfinite(p.high)]
        cover(again, np.append(first, np.unique(middles)), budget, accuracy)
        found = again if again.level < found.level else found
    if not any(b.interval for b in blocks):
        return found
    if _apart(found, tolerance):  # most gaps are closed soon
        first = budget.apart(FIRST_BRANCHES * max(budget.left, 0.0))
        _branch_and_bound(found, tolerance, first)
        if first.struck:
            budget.strike()
    if _apart(found, tolerance) and not budget.over and found.worst is not None and all(b.interval for b in blocks):
        # The gap may be that of the search: only modes that meet inside the box tell of a smaller Delta.
        better = smaller_destabilising(
            model, blocks, found.worst, budget.share(ASCENT_SHARE), seed, proved=1 / found.level
        )
        found.worst = _as_seen(model, better)
    if _apart(found, tolerance):
        _branch_and_bound(found, tolerance, budget)
    return found


def _of_one_full_block(model: StateSpaceModel, blocks: Sequence[Block], expected: float | None) -> _Found | None:
    """Of one full block mu is the largest singular value: the H-infinity norm answers; None where it is not sure."""
    norm = hinf_norm(model, NORM_WIDTH)
    if norm.status is not Status.CERTIFIED or not np.isfinite(norm.upper):
        return None
    q, p = model.n_inputs, model.n_outputs
    scalings = UpperBound(norm.upper, np.eye(q) + 0j, np.eye(p) + 0j, np.zeros((q, p), dtype=complex))
    piece = Piece(0.0, np.inf, norm.upper, scalings)
    found = _Found(norm.upper, AxisCover([piece], [], norm.upper, 1), (piece,), model=model, blocks=blocks)
    if norm.lower > 0 and expected is None:
        # An end of the axis, where M is real, if the peak is as high there.
        for omega in (0.0, np.inf, norm.frequency):
            u, sigma, vh = np.linalg.svd(frequency_response(model, [omega])[0])
            if sigma[0] >= norm.lower * (1 - NORM_WIDTH):
                break
        delta = np.outer(vh[0].conj(), u[:, 0].conj()) / sigma[0]
        found.worst = Destabilising(1 / float(sigma[0]), delta, complex(0.0, omega) if omega < np.inf else np.inf + 0j)
    return found


def _apart(found: _Found, tolerance: float) -> bool:
    """Whether a Delta is known and what is proved of all is farther from it than asked for."""
    return 0 < found.attained * (1 + tolerance) < found.level


def _as_seen(model: StateSpaceModel, worst: Destabilising) -> Destabilising:
    """The pole in the upper half plane, with the Delta that belongs to it; at infinity where the loop is ill-posed."""
    if singularity(model.D.astype(complex), worst.delta) <= SINGULAR * 1e3:
        return Destabilising(worst.norm, worst.delta, complex(np.inf))
    if np.isfinite(worst.pole) and worst.pole.imag < 0:
        return Destabilising(worst.norm, np.conj(worst.delta), np.conj(worst.pole))
    return worst


def _sharpened(
    model: StateSpaceModel,
    blocks: Sequence[Block],
    worst: Destabilising,
    seed: int,
) -> Destabilising:
    """With complex blocks mu changes smoothly over frequency: the smallest Delta at frequencies ever closer around."""
    omega = worst.pole.imag
    if not np.isfinite(worst.pole) or omega <= 0 or all(b.interval for b in blocks):
        return worst
    distance = np.abs(1j * omega - model.poles()).min(initial=omega)
    reach, factor, last = SHARPENED
    for _ in range(MOST_SHARPENINGS):
        response = frequency_response(model, omega * np.exp(np.linspace(-reach, reach, 9)))
        found = lower_bounds(response, blocks, seed)
        k = int(np.argmax([value for value, _ in found]))
        value, delta = found[k]
        if delta is not None and value > 1 / worst.norm:
            omega *= float(np.exp(reach * (k / 4 - 1)))
            worst = Destabilising(1 / value, delta, complex(0.0, omega))
            if k in (0, 8):  # the peak lies beyond
                continue
        if reach * omega < last * distance:
            break
        reach /= factor
    return worst


def _cover_asymmetric(found: _Found, first: Array, budget: Budget, accuracy: float) -> None:
    """The largest size of the set, about the nominal point, that a cover with the box's own centre proves."""
    # What the size changes by moves the narrower side of a range by so much less of the width of the box.
    low = -lowest(found.blocks)
    stretch = float(np.max((1 + low) / 2 / np.minimum(1.0, low)))
    fine = max(accuracy / stretch, FINEST_SIDE)
    room = fine * stretch
    size = 1 / found.attained / (1 + room) if found.attained else found.expected or LARGE
    failed = 1 / found.attained if found.attained else np.inf
    before: tuple[float, float] | None = None  # the last size that was too large, and the logarithm of its level
    ratio, near = 1.0, 1 + max(2 * room, COARSE)
    for _ in range(SIZES):
        inside = box_model(found.model, found.blocks, root_box(found.blocks, size))
        if inside is None or not inside.is_stable():
            failed, size = size, size / 2
            continue
        cover = cover_axis(inside, found.blocks, 1 / (1 + fine), first=first, budget=budget, accuracy=fine)
        if cover.open:
            found.cover = cover if not found.proof else found.cover
            break
        if cover.beta > 1 + 1e-12:
            over, failed = float(np.log(cover.beta * (1 + fine))), size
            if before:  # a secant: how much the level falls with the size depends on the side that it is met on
                ratio = float(np.clip(np.log(before[0] / size) / max(before[1] - over, 1e-12), 0.5, stretch))
            if found.proof and failed * found.level < near:
                break
            before = size, over
            size = max(size * float(np.exp(-ratio * over)), float(np.sqrt(size / found.level)) if found.proof else 0.0)
            continue
        found.level, found.proof = 1 / size, tuple(cover.pieces)
        # Inside the box the level is one; what it says of the set is one over the size of the box.
        found.cover = AxisCover([replace(p, beta=found.level) for p in cover.pieces], [], found.level, cover.points)
        if failed < np.inf:
            if failed < size * near:
                break
            size = min(float(np.sqrt(size * failed)), size * near if before else np.inf)
        elif found.expected is None:
            break
        else:
            size *= 2
    if not found.proof:
        found.level = float("inf")


def _smallest_asymmetric(
    model: StateSpaceModel, blocks: Sequence[Block], worst: Destabilising | None, seeds: Array, seed: int
) -> Destabilising | None:
    """A destabilising Delta of small size in proportion to each side of its range, sought from the set's own centre."""
    best, size = worst, np.inf if worst is None else gauge(blocks, block_entries(blocks, worst.delta))
    trial = size if np.isfinite(size) else 1e3
    for _ in range(4):
        box = root_box(blocks, trial)
        inside = box_model(model, blocks, box)
        middle = centre_matrix(blocks, box.centre).astype(complex)
        if inside is None or not inside.is_stable():
            few = len(blocks) <= FEW_CORNERS and all(b.interval for b in blocks)
            corners = product(*[(-1.0, 1.0)] * len(blocks)) if few else ()
            members = [middle, *(centre_matrix(blocks, box.centre + box.half * np.array(c)) + 0j for c in corners)]
            crossings = [c for c in (first_crossing(model, blocks, m) for m in members) if c is not None]
            found = min(crossings, key=lambda c: gauge(blocks, block_entries(blocks, c.delta)), default=None)
        else:
            again = smallest_destabilising(inside, blocks, seeds, seed)
            half = np.repeat(box.half, [b.rows for b in blocks])
            whole = middle if again is None else middle + half[:, None] * again.delta
            if again is not None and not np.isfinite(again.pole):  # a pole that runs off to infinity crosses no axis
                found = Destabilising(delta_norm(blocks, whole), whole, complex(np.inf))
            else:
                found = again and first_crossing(model, blocks, whole)
        if found is None:
            break
        new = gauge(blocks, block_entries(blocks, found.delta))
        if not new < size * (1 - 1e-7):
            break
        best, size, trial = found, new, new
    return best


def _branch_and_bound(found: _Found, tolerance: float, budget: Budget) -> None:
    assert found.worst is not None
    hot = abs(found.worst.pole.imag) if np.isfinite(found.worst.pole) else None
    values = found.cut(MarginProblem(found.model, found.blocks, hot), found.attained, tolerance, budget)
    if values is not None:
        delta = centre_matrix(found.blocks, values).astype(complex)
        better = first_crossing(found.model, found.blocks, delta) or found.worst
        if gauge(found.blocks, block_entries(found.blocks, better.delta)) < 1 / found.attained:
            found.worst = better


def _margin(
    uncertain: UncertainModel, found: _Found, budget: Budget, grid: Array, mu_lower: Array, mu_upper: Array, note: str
) -> Margin:
    worst, cover = found.worst, found.cover
    delta = delta_values(uncertain.blocks, worst.delta) if worst else {}
    upper = 1 / found.attained if found.attained else float("inf")
    lower = 0.0 if cover.open else 1 / found.level if found.level > 0 else float("inf")
    # A Delta that attains its level to rounding may pass a proof that is as tight, by that much and no more.
    if upper < lower * (1 - 1e-5):
        text = f"a Delta of size {upper:.9g} destabilises inside the proved margin {lower:.9g}: digits were lost"
        raise NoTrustworthyNumber("robust_stability", text)
    left = f"{len(cover.open)} frequency intervals not proved: mu_upper holds on the grid only" if cover.open else ""
    for array in (grid, mu_lower, mu_upper):
        array.setflags(write=False)
    frequency, pole = None, None
    if worst is not None:
        pole, frequency = worst.pole, model_frequency(uncertain, abs(worst.pole.imag))
        if not np.isfinite(pole):
            frequency = model_frequency(uncertain, np.inf)
        if uncertain.M.is_discrete:
            pole = (1 + pole) / (1 - pole) if np.isfinite(pole) else -1.0 + 0j
    return Margin(
        lower=min(lower, upper),
        upper=upper,
        frequency=frequency,
        status=Status.TIMEOUT if budget.struck else Status.INCONCLUSIVE if cover.open else Status.CERTIFIED,
        pole=pole,
        omega=grid,
        mu_lower=mu_lower,
        mu_upper=mu_upper,
        shares=_shares(found.model, uncertain.blocks, worst) if worst else {},
        **found.fields(uncertain, delta, budget, [note, left]),
    )


def _shares(model: StateSpaceModel, blocks: Sequence[Block], worst: Destabilising) -> dict[str, float]:
    """Share of each block in the margin, summing to one; empty where the margin has no derivative."""
    if not np.isfinite(worst.pole) or not model.n_states:
        return {}
    try:
        slopes = pole_block_sensitivities(model, blocks, worst.delta, worst.pole)
    except (NoTrustworthyNumber, np.linalg.LinAlgError):
        return {}
    shares = -slopes / worst.norm
    # Parts that cancel to rounding say nothing.
    if not np.isfinite(shares).all() or np.abs(shares).sum() > 1e9:
        return {}
    return {b.name: float(share) for b, share in zip(blocks, shares, strict=True)}
