"""mu and skewed mu of constant matrices: both bounds, each with its evidence.

Skewed mu is the smallest size of some blocks while the others keep size one: Fan, Tits (1992); Ferreres, "A Practical
Approach to Robustness Analysis with Aeronautical Applications" (1999).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from robustlab.arrays import AnyArray, Array, ComplexArray, Mask
from robustlab.budget import Budget, one_thread, search_budget
from robustlab.display import Displayable, Facts, bracket, listed
from robustlab.errors import InputError, NoTrustworthyNumber, did_you_mean, error_context
from robustlab.mu_analysis.matrix.block_structure import entries, hermitian, relative, supply
from robustlab.mu_analysis.matrix.branch_and_bound import Box, MatrixProblem, centre_matrix, root_box, tighten
from robustlab.mu_analysis.matrix.lower import lower_bound, lower_bounds
from robustlab.mu_analysis.matrix.upper import WORK, UpperBound, compile_kernels, proves, upper_bounds
from robustlab.result import Status, Table, Tabular
from robustlab.uncertainty.blocks import Block, as_blocks, block_slices, structure_size

BoxProof = tuple[tuple[Box, UpperBound], ...]  # boxes of Delta that cover the set, each with its D, G


@dataclass(frozen=True, eq=False)
class MuBounds(Tabular, Displayable):
    r"""Bounds of mu with their evidence; a stack of k matrices has a leading axis k everywhere."""

    #: ``lower <= mu <= upper``; floats, or arrays (k,)
    lower: Any
    upper: Any
    #: Delta of norm ``1 / lower`` with ``det(I - M Delta) = 0``, shape (q, p); zeros where none was found (``lower =
    #: 0``)
    delta: ComplexArray
    #: Scalings (q, q) and (q, p) with :math:`M^* D_z M + j (G M - M^* G^*) - upper^2 D \preceq 0`. An ``upper`` of zero
    #: of a nilpotent structure is proved by its zero pattern; D proves it only in the limit.
    D: ComplexArray
    G: ComplexArray
    D_z: ComplexArray  #: The scaling (p, p) on the side of the outputs of M; equal to D where all blocks are square
    #: CERTIFIED: upper proved and lower attained (or both zero). CONVERGED: upper proved, no Delta found at some
    #: matrix. TIMEOUT: the time limit ended branch and bound; both bounds hold.
    status: Status
    blocks: tuple[Block, ...]  #: The blocks of Delta
    #: Number of boxes of the real parameters that branch and bound has proved for ``upper``; 0 without it
    boxes: Any = 0
    notes: tuple[str, ...] = ()  #: Remarks for the reader of a report: why branch and bound ended before its tolerance
    #: The matrices, and the names of the blocks that keep size one, for `robustlab.verify`
    M: ComplexArray | None = None
    fixed: tuple[str, ...] = ()
    #: Of every matrix the boxes that branch and bound has proved, with the D, G of each, for `robustlab.verify`; empty
    #: without it
    proof: tuple[BoxProof, ...] = ()

    def facts(self) -> Facts:
        lower, upper = np.atleast_1d(self.lower), np.atleast_1d(self.upper)
        k = int(np.argmax(upper)) if len(upper) else 0
        largest = bracket(float(lower[k]), float(upper[k]), ("attained", "proved")) if len(upper) else ""
        return [
            ("mu" if np.ndim(self.upper) == 0 else f"largest mu of {len(upper)} matrices", largest),
            ("of matrix", f"{k}, counted from 0" if np.ndim(self.upper) else ""),
            ("blocks", listed(f"{b.name} {b.rows} x {b.cols}" for b in self.blocks)),
            ("boxes", str(int(np.sum(self.boxes))) if np.any(self.boxes) else ""),
            *(("note", note) for note in self.notes),
        ]

    def table(self) -> Table:
        """Both bounds of every matrix."""
        lower, upper = np.atleast_1d(self.lower), np.atleast_1d(self.upper)
        return Table(("matrix", np.arange(len(upper))), {"lower": lower, "upper": upper})

    def to_json(self) -> dict[str, Any]:
        names = [b.name for b in self.blocks]
        keys = ("lower", "upper", "delta", "D", "G", "D_z", "status", "boxes", "notes")
        return {"type": "MuBounds", **{key: getattr(self, key) for key in keys}, "blocks": names}


@error_context("mu")
def mu(
    M: ArrayLike,
    blocks: Any,
    seed: int = 0,
    tolerance: float | None = None,
    time_limit: float | None = None,
    effort: float = 1.0,
    *,
    fixed: Sequence[str | int] = (),
) -> MuBounds:
    r"""Bounds of the structured singular value; of the skewed one where some blocks keep their size.

    .. math:: \mu(M) = 1 / \min \{ \|\Delta\| : \det(I - M \Delta) = 0 \}

    and 0 where no Delta makes the determinant vanish.

    The upper bound is that of the D-G scalings, certified with its rounding errors; the lower one is attained by an
    explicit Delta (Doyle 1982; Fan, Tits, Doyle, IEEE TAC 36, 1991; Young, Doyle 1990). With ``tolerance`` branch and
    bound over the real parameters closes the gap.

    With ``fixed`` these blocks keep size one, and the smallest size of the others is computed (Fan, Tits 1992):

    .. math:: \nu(M) = 1 / \min \{ \|\Delta_v\| : \|\Delta_f\| \le 1, \; \det(I - M \, diag(\Delta_f, \Delta_v)) = 0 \}

    Parameters
    ----------
    M
        Complex matrix (p, q), or a stack (k, p, q); Delta is (q, p).
    blocks
        Blocks, or rows of MATLAB's ``mussv``: ``[-r, 0]`` real and ``[r, 0]`` complex scalar repeated r times,
        ``[r, c]`` full; these are called ``delta1``, ``delta2``, ...
    seed
        Seed of the starting points of the lower bound.
    tolerance
        Relative gap between the bounds that branch and bound over the real scalars aims at; none by default. It needs
        a Delta to start from: where ``lower`` is zero, nothing is cut.
    time_limit, effort
        Time limit in s of branch and bound, after which the status is TIMEOUT and the result depends on the machine;
        its work as a multiple of the usual (about a minute for all matrices), counted, not timed.
    fixed
        Names or indices of the blocks that keep size one; not with ``tolerance``.

    Returns
    -------
    MuBounds
        Both bounds with their evidence. With ``fixed``, ``lower`` is attained by ``delta`` (fixed blocks within one,
        the others of size ``1 / lower``); ``D``, ``G`` prove level one of M with the inputs of the varying blocks
        divided by ``upper``, which is inf if ``I - M Delta`` is not proved regular for the fixed blocks alone.

    Raises
    ------
    InputError
        NaN or Inf, a shape that does not fit the blocks, or a parameter whose range is not symmetric: its delta does
        not fill [-1, 1] times one number; unknown names in ``fixed``, or all blocks.
    NoTrustworthyNumber
        A lower bound above the upper one.

    Examples
    --------
    >>> bounds = mu([[0.0, 4.0], [1.0, 0.0]], [[1, 0], [1, 0]])
    >>> round(bounds.lower, 6), round(bounds.upper, 6)
    (2.0, 2.0)
    >>> skewed = mu([[0.5, 1.0], [1.0, 0.0]], [[1, 0], [1, 0]], fixed=["delta1"])
    >>> round(skewed.lower, 6), round(skewed.upper, 6)
    (2.0, 2.0)
    """
    structure = as_blocks(blocks)
    for block in structure if not len(fixed) else ():
        if not block.is_symmetric:
            low, high = block.ends
            around = block.parameter.nominal if block.parameter else 0.0
            expected = "a range that is symmetric around its nominal value"
            hint = "robust_stability takes such ranges; or give the block a symmetric range that holds this one"
            where, found = f"mu: block {block.name!r}", f"range {low:g} .. {high:g} around {around:g}"
            raise InputError(where, found, expected, hint)
    stack, single = matrix_stack(M, structure)
    if tolerance is not None:
        if not tolerance > 0:
            raise InputError("mu", f"tolerance {tolerance}", "tolerance > 0")
        if len(fixed):
            raise InputError("mu: tolerance", "given with fixed blocks", "no tolerance with them")
        compile_kernels()
    budget, proof = search_budget("mu", WORK, effort, time_limit), ()
    with one_thread():
        parts, status = _bounds(stack, structure, seed, fixed)
        if tolerance is not None:
            proof = _close(stack, parts, structure, tolerance, budget)
            parts["boxes"] = np.array([len(boxes) for boxes in proof], dtype=int)
    if single:
        numbers = ("lower", "upper", "boxes")
        parts = {key: value[0].item() if key in numbers else value[0] for key, value in parts.items()}
    given = stack[0] if single else stack
    for value in (*parts.values(), given):
        if isinstance(value, np.ndarray):
            value.setflags(write=False)
    notes = (budget.remark,) if budget.remark else ()
    kept = tuple(structure[b].name if isinstance(b, int) else b for b in fixed)
    status = Status.TIMEOUT if budget.struck else status
    return MuBounds(**parts, status=status, blocks=structure, notes=notes, M=given, fixed=kept, proof=proof)


def _bounds(
    stack: ComplexArray, structure: tuple[Block, ...], seed: int, fixed: Sequence[str | int]
) -> tuple[dict[str, Any], Status]:
    """Return the D-G bounds of each matrix, the Delta found, and their status."""
    if len(fixed):
        varying = varying_inputs(structure, fixed)
        proved = [skew_upper(m, structure, varying) for m in stack]
        lowers = [skew_lower(m, structure, varying, seed) for m in stack]
    else:
        proved = [(bound.beta, bound) for bound in upper_bounds(stack, structure)]
        lowers = lower_bounds(stack, structure, seed)
    uppers = [bound for _, bound in proved]
    q, p = structure_size(structure)
    lower, upper = (np.array([value for value, _ in found], dtype=float) for found in (lowers, proved))
    # A lower bound is attained up to the rounding of its Delta: it may exceed a tight upper bound by that much.
    lower = np.where((lower > upper) & (lower <= upper * (1 + 1e-8)), upper, lower)
    if (lower > upper).any():
        k = int(np.argmax(lower - upper))
        found = f"lower bound {lower[k]:.12g} above upper bound {upper[k]:.12g}: digits were lost"
        raise NoTrustworthyNumber(f"mu: matrix {k}", found)
    sure = np.isfinite(upper).all()
    attained = ((lower > 0) | (upper == 0)).all()
    status = Status.CERTIFIED if sure and attained else Status.CONVERGED if sure else Status.INACCURATE
    k, zero = len(stack), np.zeros((q, p), dtype=complex)
    deltas = np.array([zero if d is None else d for _, d in lowers], dtype=complex).reshape(k, q, p)
    sides = ("D", "Dw", (q, q)), ("G", "G", (q, p)), ("D_z", "Dz", (p, p))
    stacks = ((key, shape, [getattr(b, own) for b in uppers]) for key, own, shape in sides)
    scalings = {key: np.array(parts, dtype=complex).reshape(k, *shape) for key, shape, parts in stacks}
    return {"lower": lower, "upper": upper, "delta": deltas, **scalings}, status


def _close(
    stack: ComplexArray, parts: dict[str, Any], blocks: tuple[Block, ...], tolerance: float, budget: Budget
) -> tuple[BoxProof, ...]:
    """Apply branch and bound to each matrix whose gap exceeds the tolerance; return the boxes."""
    boxes: list[BoxProof] = [() for _ in stack]
    some_real = any(b.interval for b in blocks)
    for k, m in enumerate(stack):
        lower, upper = parts["lower"][k], parts["upper"][k]
        if not some_real or not 0 < lower * (1 + tolerance) < upper:
            continue
        proof = tighten(MatrixProblem(m, blocks), lower, upper, tolerance, budget.share(1 / (len(stack) - k)))
        parts["upper"][k] = proof.upper
        boxes[k] = tuple(leaf.proof for leaf in proof.leaves if leaf.proof is not None)
        if proof.values is not None:
            parts["lower"][k], parts["delta"][k] = proof.lower, proof.values
    return tuple(boxes)


def matrix_stack(M: ArrayLike, blocks: Sequence[Block]) -> tuple[ComplexArray, bool]:
    """Return M as a finite complex stack (k, p, q) that fits the blocks, and whether it was a single matrix."""
    try:
        array = np.asarray(M)
    except ValueError as error:
        raise InputError("mu: M", f"ragged ({error})", "a rectangular array of numbers") from None
    if array.dtype.kind not in "fiuc":
        raise InputError("mu: M", f"dtype {array.dtype}", "numbers")
    q, p = structure_size(blocks)
    single = array.ndim == 2
    if array.ndim not in (2, 3) or array.shape[-2:] != (p, q):
        hint = "Delta has the transposed shape of M" if array.shape[-2:] == (q, p) else None
        raise InputError("mu: M", f"shape {array.shape}", f"{(p, q)} or (k, {p}, {q}) for a Delta of {(q, p)}", hint)
    bad = np.argwhere(~np.isfinite(array))
    if len(bad):
        index = ",".join(str(i) for i in bad[0])
        found = f"entry [{index}] is not finite ({len(bad)} of {array.size} entries)"
        raise InputError("mu: M", found, "finite numbers")
    stack = array.astype(np.complex128)
    return (stack[None] if single else stack), single


# --- skewed mu --------------------------------------------------------------------------------------------------------
#
# nu is an upper bound where the D-G inequality of M S^-1, S = diag(1, nu) on the inputs, holds at level one. For
# given D, G the smallest such level is known in closed form (a Schur complement): minimising the D-G level of M S^-1
# and lowering nu to it in turn converges from above.

SKEW_ROUNDS = 14  # iterations of the level of skewed mu
INFLATIONS = (0.0, *(10.0**-k for k in range(13, 2, -1)))  # of a level until its D, G prove it
LARGEST_LEVEL = 1e8  # above it, for M of norm one, the fixed blocks alone count as nearly singular


def varying_inputs(blocks: Sequence[Block], fixed: Sequence[str | int]) -> Mask:
    """Return True for the inputs of M (entries of w) of varying blocks, shape (q,)."""
    names = [b.name for b in blocks]
    kept: set[str] = set()
    for given in fixed:
        is_index = isinstance(given, (int, np.integer)) and not isinstance(given, bool)
        if is_index and -len(names) <= int(given) < len(names):
            kept.add(names[int(given)])
        elif isinstance(given, str) and given in names:
            kept.add(given)
        else:
            hint = did_you_mean(given, tuple(names)) if isinstance(given, str) else None
            raise InputError("mu: fixed", f"no block {given!r}", f"some of {', '.join(names)}", hint)
    varying = [b.name not in kept for b in blocks]
    if not any(varying):
        raise InputError("mu: fixed", "all blocks are fixed", "at least one whose size is sought")
    return np.repeat(np.array(varying, dtype=bool), [b.rows for b in blocks])


def skew_upper(M: ComplexArray, blocks: Sequence[Block], varying: Mask, tol: float = 1e-4) -> tuple[float, UpperBound]:
    """Return the smallest level found that D, G prove, and these D, G for ``M / S(level)``; inf: none."""
    q, p = structure_size(blocks)
    size = float(np.linalg.norm(M, 2))
    plain = UpperBound(np.inf, np.eye(q) + 0j, np.eye(p) + 0j, np.zeros((q, p), dtype=complex))
    if not M[:, varying].any():
        # Only the fixed blocks can make the loop singular.
        bound = upper_bounds(M[None], blocks)[0]
        return (0.0, bound) if bound.beta < 1 else (np.inf, plain)
    level, best, proof = max(size, 1e-300), np.inf, plain
    for _ in range(SKEW_ROUNDS):
        scaled = divided(M, varying, level)
        bound = upper_bounds(scaled[None], blocks, tol)[0]
        ratio = _level_of(scaled, bound, varying)
        if not np.isfinite(ratio):
            if np.isfinite(best) or level > LARGEST_LEVEL * size:
                break
            level *= 8
            continue
        for inflation in INFLATIONS:  # until D, G prove the level with their rounding errors
            reached = level * ratio * (1 + inflation)
            G = np.where(varying[:, None], bound.G * (level / reached), bound.G)
            # M / level has one more rounding per entry, far within the allowance of `proves`.
            if proves(divided(M, varying, reached), bound.Dw, bound.Dz, G, 1.0):
                break
        else:
            break
        if reached >= best * (1 - tol):
            break
        level = best = reached
        proof = UpperBound(1.0, bound.Dw, bound.Dz, G)
    return best, proof


def gain_curves(
    M: ComplexArray, blocks: Sequence[Block], rng: np.random.Generator, starts: int, tol: float
) -> tuple[Array, Array, list[Gain | None]]:
    """Return for each matrix the largest gain found, the proved level of its last block, and the gain's Delta."""
    last, box = np.arange(M.shape[2]) >= M.shape[2] - blocks[-1].rows, root_box(blocks)
    found = [largest_gain(m, blocks, box, rng, starts) for m in M]
    upper = np.array([skew_upper(m, blocks, last, tol)[0] for m in M])
    return np.array([0.0 if g is None else g.value for g in found]), upper, found


def skew_lower(
    M: ComplexArray, blocks: Sequence[Block], varying: Mask, seed: int = 0, rounds: int = 10
) -> tuple[float, ComplexArray | None]:
    """Return ``(1 / size of the varying blocks, Delta)`` of the smallest Delta found with fixed blocks within one."""
    level = size = float(np.linalg.norm(M, 2))
    slices = block_slices(blocks)
    moving = [i for i, (w, _) in enumerate(slices) if varying[w.start]]
    if len(moving) == 1 and blocks[moving[0]].is_ball:
        return _largest_gain(M, blocks, moving[0], seed)
    best: tuple[float, ComplexArray | None] = (0.0, None)
    failed = np.inf
    for _ in range(rounds):
        if level <= 1e-9 * size:
            break
        value, delta = lower_bound(divided(M, varying, level), blocks, seed, restarts=8, steps=30)
        if delta is not None and value >= 1 - 1e-12:
            scaled = np.where(varying[:, None], delta / level, delta)
            reached = 1 / max(blocks[i].norm(scaled[slices[i]]) for i in moving)
            if reached <= best[0] * (1 + 1e-9):
                break
            best = reached, scaled
            level = max(reached, level) * 1.0001
        else:
            failed = level
            level *= value or 0.25
        if best[0] and np.isfinite(failed):
            level = np.sqrt(best[0] * failed)
    return best


def _largest_gain(
    M: ComplexArray, blocks: Sequence[Block], moving: int, seed: int
) -> tuple[float, ComplexArray | None]:
    """Solve for one varying full block: its level is the largest gain of the channels that it closes."""
    order = [*(i for i in range(len(blocks)) if i != moving), moving]
    (w, z), ordered = entries(blocks, order), [blocks[i] for i in order]
    gain = largest_gain(M[z[:, None], w], ordered, root_box(ordered), np.random.default_rng(seed))
    if gain is None or gain.value == 0:
        return 0.0, None
    last_w, last_z = block_slices(ordered)[-1]
    whole, back = np.zeros((2, *structure_size(blocks)), dtype=complex)
    whole[: last_w.start, : last_z.start] = gain.delta
    whole[last_w, last_z] = np.outer(gain.v, np.conj(gain.u)) / gain.value  # makes the loop singular
    back[w[:, None], z] = whole
    return 1 / float(np.linalg.norm(whole[last_w, last_z], 2)), back


def divided(M: AnyArray, varying: Mask, level: float) -> AnyArray:
    """Divide the columns of the varying inputs of M, or of a stack, by the level."""
    return np.where(varying, M / level, M)


def _level_of(M: ComplexArray, bound: UpperBound, varying: Mask) -> float:
    """Return the factor on the level at which D, G hold with equality; inf where the fixed part never does."""
    needed, fixed = supply(M, bound.Dz, bound.G), ~varying
    try:
        rest = needed[varying][:, varying]
        if fixed.any():
            inner = bound.Dw[fixed][:, fixed] - needed[fixed][:, fixed]
            factor = np.linalg.cholesky((inner + hermitian(inner)) / 2)
            half = np.linalg.solve(factor, needed[fixed][:, varying])
            rest = rest + hermitian(half) @ half
        value = float(np.linalg.eigvalsh(relative(bound.Dw[varying][:, varying], rest))[-1])
    except np.linalg.LinAlgError:
        return float("inf")
    return float(np.sqrt(max(value, 1e-30))) if np.isfinite(value) else float("inf")


# --- gain of a matrix closed by Delta, its derivative, and ascent ----------------------------------------------------
#
# F = M22 + M21 Delta (I - M11 Delta)^-1 M12, d sigma_max(F) = Re l dDelta r with l = u^* M21 (I - Delta M11)^-1 and r
# = (I - M11 Delta)^-1 M12 v. The performance channels are the last block of M.

ASCENTS = 40  # steps of an ascent
RISE = 1e-7  # an ascent ends where a step gains less than this share


@dataclass(frozen=True)
class Gain:
    """``sigma_max`` with its u and v, the Delta (q, p) of the other blocks, and the directions l (q,), r (p,)."""

    value: float
    delta: ComplexArray
    left: ComplexArray
    right: ComplexArray
    u: ComplexArray
    v: ComplexArray


def gain_at(M: ComplexArray, blocks: Sequence[Block], delta: ComplexArray) -> Gain | None:
    """Return the gain with the given Delta of all blocks but the last; None where the loop is singular."""
    w, z = block_slices(blocks)[-1]
    q, p = w.start, z.start
    try:
        inside = np.linalg.solve(np.eye(p) - M[:p, :q] @ delta, M[:p, q:])
        outside = np.linalg.solve((np.eye(q) - delta @ M[:p, :q]).T, M[p:, :q].T).T
        closed = M[p:, q:] + outside @ delta @ M[:p, q:]
        if not np.isfinite(closed).all():
            return None
        u, sigma, vh = np.linalg.svd(closed)
    except np.linalg.LinAlgError:
        return None
    return Gain(float(sigma[0]), delta, np.conj(u[:, 0]) @ outside, inside @ np.conj(vh[0]), u[:, 0], np.conj(vh[0]))


def ascend(
    M: ComplexArray, blocks: Sequence[Block], start: ComplexArray, box: Box, steps: int = ASCENTS
) -> Gain | None:
    """Ascend to a large gain inside the box from a Delta (q, p): each step aligns all blocks with l and r."""
    best = gain_at(M, blocks, start)
    for _ in range(steps):
        if best is None:
            break
        aim = centre_matrix(blocks[:-1], box.centre[:-1]).astype(complex)  # raises the gain most, to first order
        for block, (w, z), half in zip(blocks[:-1], block_slices(blocks[:-1]), box.half[:-1], strict=True):
            aligned = block.aligned(best.left[w], best.right[z], half)
            aim[w, z] = best.delta[w, z] if aligned is None else aim[w, z] + aligned
        before = best
        for step in 3.0 ** -np.arange(7):
            trial = gain_at(M, blocks, before.delta + step * (aim - before.delta))
            if trial is not None and trial.value > before.value:
                best = trial
                break
        if best.value <= before.value * (1 + RISE):
            break
    return best


def largest_gain(
    M: ComplexArray, blocks: Sequence[Block], box: Box, rng: np.random.Generator, starts: int = 12
) -> Gain | None:
    """Return the largest gain of ascents from the centre of the box and from random corners."""
    others, found = blocks[:-1], []
    for k in range(starts if others else 1):
        delta = centre_matrix(others, box.centre[:-1]).astype(complex)
        for block, (w, z), half in zip(others, block_slices(others), box.half[:-1], strict=True):
            if k and block.interval:
                delta[w, z] += half * rng.choice([-1.0, 1.0]) * np.eye(block.rows)
            elif k:
                delta[w, z] = half * block.extreme(rng, lambda n: rng.standard_normal((n, 2)) @ np.array([1, 1j]))
        found.append(ascend(M, blocks, delta, box))
    return max((g for g in found if g is not None), key=lambda g: g.value, default=None)
