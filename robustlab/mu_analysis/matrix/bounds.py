"""mu of constant matrices: both bounds, each with its evidence."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from robustlab.arrays import ComplexArray
from robustlab.budget import Budget, one_thread, search_budget
from robustlab.display import Displayable, Facts, bracket, listed
from robustlab.errors import InputError, NoTrustworthyNumber, error_context
from robustlab.mu_analysis.matrix.branch_and_bound import Box, MatrixProblem, tighten
from robustlab.mu_analysis.matrix.lower import lower_bounds
from robustlab.mu_analysis.matrix.skew import skew_lower, skew_upper, varying_inputs
from robustlab.mu_analysis.matrix.upper import WORK, UpperBound, compile_kernels, upper_bounds
from robustlab.result import Status, Table, Tabular
from robustlab.uncertainty.blocks import Block, as_blocks, structure_size

BoxProof = tuple[tuple[Box, UpperBound], ...]  # boxes of Delta that cover the set, each with its D, G


@dataclass(frozen=True, eq=False)
class MuBounds(Tabular, Displayable):
    r"""Bounds of mu with their evidence; a stack of k matrices has a leading axis k everywhere.

    Attributes
    ----------
    lower, upper
        ``lower <= mu <= upper``; floats, or arrays (k,).
    delta
        Delta of norm ``1 / lower`` with ``det(I - M Delta) = 0``, shape (q, p); zeros where none was found (``lower =
        0``).
    D, G
        Scalings (q, q) and (q, p) with :math:`M^* D_z M + j (G M - M^* G^*) - upper^2 D \preceq 0`. An ``upper`` of
        zero of a nilpotent structure is proved by its zero pattern; D proves it only in the limit.
    D_z
        The scaling (p, p) on the side of the outputs of M; equal to D where all blocks are square.
    status
        CERTIFIED: upper proved and lower attained (or both zero). CONVERGED: upper proved, no Delta found at some
        matrix. TIMEOUT: the time limit ended branch and bound; both bounds hold.
    blocks
        The blocks of Delta.
    boxes
        Number of boxes of the real parameters that branch and bound has proved for ``upper``; 0 without it.
    notes
        Remarks for the reader of a report: why branch and bound ended before its tolerance.
    M, fixed
        The matrices, and the names of the blocks that keep size one, for `robustlab.verify`.
    proof
        Of every matrix the boxes that branch and bound has proved, with the D, G of each, for `robustlab.verify`; empty
        without it.
    """

    lower: Any
    upper: Any
    delta: ComplexArray
    D: ComplexArray
    G: ComplexArray
    D_z: ComplexArray
    status: Status
    blocks: tuple[Block, ...]
    boxes: Any = 0
    notes: tuple[str, ...] = ()
    M: ComplexArray | None = None
    fixed: tuple[str, ...] = ()
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
    explicit Delta. With ``tolerance`` branch and bound over the real parameters closes the gap.

    With ``fixed`` these blocks keep size one, and the smallest size of the others is computed:

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
    time_limit
        Time limit in s of branch and bound. If it is reached, the status is TIMEOUT and the result depends on the
        machine.
    effort
        Work of branch and bound as a multiple of the usual (about a minute for all matrices); counted, not timed.
    fixed
        Names or indices of the blocks that keep size one; not with ``tolerance``.

    Returns
    -------
    MuBounds
        Both bounds with their evidence: ``delta`` (q, p), ``D`` (q, q), ``D_z`` (p, p), ``G`` (q, p), each with a
        leading axis k for a stack. With ``fixed``, ``lower`` is attained by ``delta`` (fixed blocks within one, the
        others of size ``1 / lower``); ``D``, ``G`` prove level one of M with the inputs of the varying blocks divided
        by ``upper``, which is inf if ``I - M Delta`` is not proved regular for the fixed blocks alone.

    Raises
    ------
    InputError
        NaN or Inf, a shape that does not fit the blocks, or a parameter whose range is not symmetric: its delta does
        not fill [-1, 1] times one number; unknown names in ``fixed``, or all blocks.
    NoTrustworthyNumber
        A lower bound above the upper one.

    References
    ----------
    Doyle (1982); Fan, Tits, Doyle, IEEE TAC 36 (1991); Young, Doyle (1990). Skewed: Fan, Tits (1992); Ferreres (1999).

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
            raise InputError(
                f"mu: block {block.name!r}", f"range {low:g} .. {high:g} around {around:g}", expected, hint
            )
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
    parts: dict[str, Any] = {
        "lower": lower,
        "upper": upper,
        "delta": np.array([zero if d is None else d for _, d in lowers], dtype=complex).reshape(k, q, p),
        "D": np.array([b.Dw for b in uppers], dtype=complex).reshape(k, q, q),
        "G": np.array([b.G for b in uppers], dtype=complex).reshape(k, q, p),
        "D_z": np.array([b.Dz for b in uppers], dtype=complex).reshape(k, p, p),
    }
    return parts, status


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
        raise InputError(
            "mu: M", f"entry [{index}] is not finite ({len(bad)} of {array.size} entries)", "finite numbers"
        )
    stack = array.astype(np.complex128)
    return (stack[None] if single else stack), single
