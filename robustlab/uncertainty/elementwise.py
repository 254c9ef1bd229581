"""Uncertain models from two models: a nominal one and a maximally perturbed one (Březina 2010, 10.5-10.15)."""

# [A B; C D](Delta) = nominal + L Delta R with L R = perturbed - nominal. Delta acts on constant matrices: there is no
# direct term from w to z, and every Delta is well posed. The printed form (10.13) scales whole columns: it is
# structure "columns"; the text's form, each entry by itself, is "elements".

from __future__ import annotations

import itertools
import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np

from robustlab.arrays import Array
from robustlab.checks import choice, number
from robustlab.display import Displayable, Facts, Part
from robustlab.errors import InputError, UnitMismatch, error_context
from robustlab.linear_analysis.matrices import equilibrating_exponents, system_matrix
from robustlab.result import Status
from robustlab.signals import MAX_NAME
from robustlab.statespace import MAX_STATES, StateSpaceModel, as_model
from robustlab.uncertainty.blocks import FullBlock, RealScalar
from robustlab.uncertainty.lft import UncertainModel, with_channels

EXACT = 3e-14  # error of an entry of the rank factors, relative to its natural magnitude: below the promised 1e-12
HUGE = 1 / np.finfo(float).eps  # rounding of an entry of this size exceeds entries of order one

STRUCTURES = ("elements", "columns", "rows", "matrices", "single")
# Pivot rows, pivot columns, and the rows and columns that an elimination step may change.
Stage = tuple[slice, slice, slice, slice]
_EVERYWHERE: Stage = (slice(None), slice(None), slice(None), slice(None))


@error_context("elementwise")
def elementwise(
    nominal: Any, perturbed: Any, structure: str = "elements", tolerance: float | None = None
) -> UncertainModel:
    r"""Return the set of models between (and mirrored beyond) a nominal and a maximally perturbed model.

    With one perturbed model for each physical cause it has one real parameter per cause,

    .. math:: \begin{bmatrix} A & B \\ C & D \end{bmatrix}(\Delta) =
              \begin{bmatrix} A & B \\ C & D \end{bmatrix}_{nominal} + \sum_i \delta_i L_i R_i, \qquad
              L_i R_i = perturbed_i - nominal

    repeated as often as the rank of its difference, found jointly in A, B, C, D: entries of one cause vary together,
    and causes superpose linearly (without their products).

    Parameters
    ----------
    nominal, perturbed
        Two models of equal sizes, sample time and signals (StateSpaceModel, control.StateSpace, or with ``to_model``).
        ``perturbed`` may be a table: name of a cause -> model at the upper end of that cause alone. One that changes
        nothing gives no block.
    structure
        Which entries vary together; with causes all entries of each cause do:

        ========== ===================================================================== =============================
        elements   each differing entry of A, B, C, D by itself                          rank one each
        columns    each differing column of A, of B, of C, of D (the thesis' eq. 10.13)  rank one each
        rows       each differing row of A, of B, of C, of D                             rank one each
        matrices   A, B, C, D, as far as they differ                                     repeated rank(A_D), ... times
        single     one number for everything: the straight line through both models      repeated rank(E) times
        ========== ===================================================================== =============================
    tolerance
        Differences below ``tolerance`` times an entry's natural magnitude count as noise (a linearisation by finite
        differences needs about 1e-9 to show its true rank). If omitted, nothing is dropped and the ends are met to
        1e-12; else to `endpoint_residual`.

    Returns
    -------
    UncertainModel
        With real scalars named by their signals: ``A[omega,i]``, ``A[:,i]``, ``A[omega,:]``, ``A``, ``single``.
        No block where the two models are equal. With causes, one block of its name for each cause.

    Raises
    ------
    InputError
        Sizes, sample times or signal names differ; unknown structure; no cause, or causes with a structure.
    UnitMismatch
        A signal carries different units in the two models.

    Examples
    --------
    >>> B, C, D, names = [[0.0], [1.0]], [[1.0, 0.0]], [[0.0]], ["omega", "i"]
    >>> nominal = StateSpaceModel([[-1.0, 2.0], [0.0, -3.0]], B, C, D, states=names)
    >>> perturbed = StateSpaceModel([[-1.0, 2.5], [0.0, -3.0]], B, C, D, states=names)
    >>> model = elementwise(nominal, perturbed)
    >>> model.blocks[0].name, float(model.evaluate({"A[omega,i]": 1.0}).A[0, 1])
    ('A[omega,i]', 2.5)
    """
    causes = perturbed if isinstance(perturbed, Mapping) else {"perturbed": perturbed}
    first = as_model(nominal, "elementwise: nominal")
    if causes is perturbed and structure != "elements":
        raise InputError("elementwise: structure", f"{structure!r} with causes", "none: a cause is one parameter")
    if not causes:
        raise InputError("elementwise", "no cause", "at least one: {name: perturbed model}")
    choice("elementwise: structure", structure, STRUCTURES)
    number("elementwise: tolerance", tolerance or 0.0, "a number in [0, 1)", at_least=0, below=1)
    parts: list[_Part] = []
    for name, model in causes.items():
        second = as_model(model, f"elementwise: {name}")
        check_pair(first, second)
        difference = _difference(first, second, tolerance or 0.0)
        if causes is perturbed:
            parts += [part._replace(name=name) for part in _single(difference)]
            continue
        for remark in pair_remarks(first, second):
            warnings.warn(f"elementwise: {remark}", stacklevel=3)  # the caller of elementwise
        parts = _parts(difference, structure)
    return _assemble(first, parts)


def pair_remarks(nominal: StateSpaceModel, perturbed: StateSpaceModel) -> list[str]:
    """Return remarks on a nominal and a perturbed model: instability, no difference, or too wide a scale."""
    from robustlab.norms import unstable_norm

    remarks = []
    unstable = unstable_norm(perturbed)
    if unstable is not None and unstable_norm(nominal) is None:
        remarks.append(f"the perturbed model is not stable, the nominal one is: {unstable.reason}")
    whole = [system_matrix(m) for m in (nominal, perturbed)]
    if np.array_equal(whole[0], whole[1]):
        remarks.append("no uncertainty: the two models are equal")
    largest = max(float(np.abs(entries).max(initial=0.0)) for entries in whole)
    if largest >= HUGE:
        remarks.append(f"an entry of {largest:.3g}: entries of order one are lost in its rounding")
    return remarks


def endpoint_residual(uncertain: UncertainModel, perturbed: Any) -> float:
    """Compare the set at ``Delta = I`` with the perturbed model by `misses`."""
    target = as_model(perturbed, "endpoint_residual: perturbed")
    return misses(uncertain.evaluate({b.name: 1.0 for b in uncertain.blocks}), target, uncertain.nominal)


def misses(reached: StateSpaceModel, wanted: StateSpaceModel, *others: StateSpaceModel) -> float:
    """Return the largest difference of an entry, relative to the largest of its matrix in ``wanted`` and others."""
    shares = [0.0]
    for name in "ABCD":
        if miss := float(np.abs(getattr(reached, name) - getattr(wanted, name)).max(initial=0.0)):
            size = max(float(np.abs(getattr(m, name)).max(initial=0.0)) for m in (wanted, *others))
            shares.append(miss / size if size else np.inf)
    return max(shares)


@dataclass(frozen=True, eq=False)
class BuiltModel(Displayable):
    """An uncertain model with its evidence."""

    model: UncertainModel  #: The set
    structure: str  #: Which entries vary together
    #: CERTIFIED: the set is proved to contain its source models. CONVERGED: to a chosen accuracy. None: it is defined
    #: by its parameters, and there is nothing to prove.
    status: Status | None
    #: Largest relative difference to the perturbed model at Delta = I; None where it was not made of two models
    endpoint_residual: float | None = None
    notes: tuple[str, ...] = ()  #: Remarks for the reader
    #: The nominal and the perturbed model of its construction, for `robustlab.verify`
    ends: tuple[StateSpaceModel, StateSpaceModel] | None = None

    quantities: ClassVar[Mapping[str, Any]] = {**UncertainModel.quantities, "endpoint_residual": "1"}

    def numbers(self) -> dict[str, Any]:
        residual = self.endpoint_residual
        return self.model.numbers() | ({} if residual is None else {"endpoint_residual": residual})

    def headline(self) -> str:
        names = ", ".join(b.name for b in self.model.blocks) or "nothing"
        return f"{'sampled' if self.model.sampled else 'exact'} uncertain model ({self.structure}); uncertain: {names}"

    def facts(self) -> Facts:
        residual = self.endpoint_residual
        off = "" if residual is None else f"{residual:.2g} of each matrix's largest entry"
        return [("structure", self.structure), ("off the perturbed model at Delta = I", off), *self.model.facts()]

    def details(self) -> list[Part]:
        return self.model.details()

    def to_json(self) -> dict[str, object]:
        more = {"structure": self.structure, "residual": self.endpoint_residual}
        return {**self.model.to_json(), **more, "status": self.status}


def elementwise_cover(nominal: Any, perturbed: Any) -> UncertainModel:
    """Return a small set around the element-wise one: a full block for each of A, B, C, D that differ."""
    # |E o delta| <= | |E| | for |delta_ij| <= 1 (Horn, Johnson 2013, theorem 8.1.18). It needs four scalings, not
    # dozens, but has additional members, complex and dynamic ones among them.
    first, second = as_model(nominal, "elementwise: nominal"), as_model(perturbed, "elementwise: perturbed")
    check_pair(first, second)
    d, parts = _difference(first, second, 0.0), []
    for m in "ABCD":
        size = np.zeros(d.E.shape)
        size[d.part(m)] = np.abs(d.E[d.part(m)])
        rows, columns = np.flatnonzero(size.any(axis=1)), np.flatnonzero(size.any(axis=0))
        if len(rows):
            root = float(np.sqrt(np.linalg.norm(size, 2)))
            parts.append(_Part(m, root * np.eye(len(d.E))[:, rows], root * np.eye(len(d.E.T))[columns]))
    return _assemble(first, parts, full=True)


@dataclass(frozen=True)
class _Difference:
    """E = perturbed - nominal, shape (n_x + n_y, n_x + n_u), and the data to factor it."""

    E: Array
    scale: Array
    allowance: Array
    n_states: int
    names: tuple[tuple[str, ...], tuple[str, ...]]  # of rows, of columns

    def part(self, matrix: str) -> tuple[slice, slice]:
        n = self.n_states
        upper, lower = slice(0, n), slice(n, None)
        return {"A": (upper, upper), "B": (upper, lower), "C": (lower, upper), "D": (lower, lower)}[matrix]


class _Part(NamedTuple):
    """One block: E contains ``left @ right``, left (n_x + n_y, r), right (r, n_x + n_u)."""

    name: str
    left: Array
    right: Array


def _difference(nominal: StateSpaceModel, perturbed: StateSpaceModel, tolerance: float) -> _Difference:
    first, second = system_matrix(nominal), system_matrix(perturbed)
    size, n = np.maximum(np.abs(first), np.abs(second)), nominal.n_states
    limit, e = entry_scale(size, n), second - first
    e[np.abs(e) <= tolerance * limit] = 0.0
    names = nominal.state_names + nominal.output_names, nominal.state_names + nominal.input_names
    return _Difference(e, natural_magnitude(size), max(tolerance, EXACT) * limit, n, names)


def entry_scale(size: Array, n: int) -> Array:
    """Return the natural magnitude of each entry of ``[A B; C D]``, at most the largest entry of its matrix."""
    # The large units of its row and column must not hide an entry of a matrix of small numbers.
    scale, sides = natural_magnitude(size), (slice(0, n), slice(n, None))
    for part in itertools.product(sides, sides):
        scale[part] = np.minimum(scale[part], size[part].max(initial=0.0))
    return scale


def natural_magnitude(size: Array) -> Array:
    """Return powers of two ``r_i c_j`` for which ``size / (r c^T)`` has rows and columns with maxima near 1."""
    row, col = equilibrating_exponents(size)
    return np.exp2(-1.0 * (row[:, None] + col))


# --- factorisations of the structures --------------------------------------------------------------------------------


def _parts(d: _Difference, structure: str) -> list[_Part]:
    """Return a part for each differing entry, column, row or matrix, of A, B, C, D in this order."""
    if structure == "single":
        return _single(d)
    found: list[tuple[str, _Part]] = []
    for m in "ABCD":
        own = np.zeros(d.E.shape)
        own[d.part(m)] = d.E[d.part(m)]
        i, j = np.nonzero(own)
        cells: dict[str, Iterable[tuple[Any, Any]]] = {
            "elements": zip(i, j, strict=True),
            "columns": ((None, k) for k in np.unique(j)),
            "rows": ((k, None) for k in np.unique(i)),
            "matrices": [(None, None)] if len(i) else [],
        }
        for row, col in cells[structure]:
            e, cell = np.zeros(own.shape), tuple(slice(None) if k is None else k for k in (row, col))
            e[cell] = own[cell]
            factors = _rank_factors(e, d.allowance, d.scale, [_EVERYWHERE])
            if structure == "rows":
                factors = np.eye(len(e))[:, [row]], e[[row]]
            ends = zip(d.names, (row, col), strict=True)
            labels = [(":", ":") if k is None else (names[k], f"{k}") for names, k in ends]
            by_signal, by_number = (f"{m}[{r},{c}]" for r, c in zip(*labels, strict=True))
            found.append((by_number, _Part(m if structure == "matrices" else by_signal, *factors)))
    # Names by signal where they are short (room is left for the channel's prefix and number) and unambiguous.
    names = [part.name for _, part in found]
    clear = len(set(names)) == len(names) and all(len(name) <= MAX_NAME - 20 for name in names)
    return [part if clear else part._replace(name=by_number) for by_number, part in found]


def _single(d: _Difference) -> list[_Part]:
    if not d.E.any():
        return []
    every, x, rest = slice(None), slice(0, d.n_states), slice(d.n_states, None)
    stages = [_EVERYWHERE]
    if not d.E[d.part("D")].any():
        # D_D = 0 is kept exactly (noise in D would make a strictly proper model proper): with
        # rank E = rank C_D + rank B_D + rank(rest of A_D), no channel connects an input to an output.
        stages = [(rest, x, every, x), (x, rest, x, every), (x, x, x, x)]
    return [_Part("single", *_rank_factors(d.E, d.allowance, d.scale, stages))]


def _rank_factors(e: Array, allowance: Array, scale: Array, stages: Sequence[Stage]) -> tuple[Array, Array]:
    """Return ``left (m, r), right (r, n)`` with ``|left @ right - e| <= allowance`` and a small r."""
    # Complete pivoting relative to the scale reveals the rank like a singular value decomposition, but its error in an
    # entry is rounding of that entry's own terms, and zeros of rows and columns stay zeros.
    residual, lefts, rights = e.copy(), [], []
    used_rows, used_cols = e.any(axis=1), e.any(axis=0)
    full = min(used_rows.sum(), used_cols.sum())
    for rows, cols, changed_rows, changed_cols in stages:
        part = (rows, cols)
        while len(lefts) < full and (np.abs(residual[part]) > allowance[part]).any():
            index = np.unravel_index(np.argmax(np.abs(residual[part]) / scale[part]), residual[part].shape)
            i, j = int(index[0]) + (rows.start or 0), int(index[1]) + (cols.start or 0)
            left, right = np.zeros(e.shape[0]), np.zeros(e.shape[1])
            left[changed_rows] = residual[changed_rows, j]
            right[changed_cols] = residual[i, changed_cols] / residual[i, j]
            residual -= np.outer(left, right)
            lefts.append(left)
            rights.append(right)
    if 0 < len(lefts) < full:
        return np.array(lefts).T, np.array(rights)
    if used_cols.sum() <= used_rows.sum():
        return e[:, used_cols], np.eye(e.shape[1])[used_cols]
    return np.eye(e.shape[0])[:, used_rows], e[used_rows]


def _assemble(nominal: StateSpaceModel, parts: list[_Part], full: bool = False) -> UncertainModel:
    """Return the nominal model with the channels of Delta in front (eqs 10.8, 10.9)."""
    size = sum(p.right.shape[0] for p in parts)
    if size > MAX_STATES:
        hint = "use structure matrices or single"
        raise InputError("elementwise", f"{size} channels of Delta", f"at most {MAX_STATES}", hint)
    n, n_u, n_y = nominal.n_states, nominal.n_inputs, nominal.n_outputs
    left = np.hstack([np.zeros((n + n_y, 0)), *(part.left for part in parts)])
    right = np.vstack([np.zeros((0, n + n_u)), *(part.right for part in parts)])
    sizes = [(p.name, p.left.shape[1], p.right.shape[0]) for p in parts]
    blocks = [FullBlock(name, r, c) if full else RealScalar(name, r) for name, r, c in sizes]
    return with_channels(nominal, blocks, left, right)


def check_pair(
    nominal: StateSpaceModel, perturbed: StateSpaceModel, first: str = "nominal", second: str = "perturbed",
    where: str = "elementwise",
) -> None:  # fmt: skip
    """Check that two models, called ``first`` and ``second``, have the same sizes, sample time, signals and units."""
    shapes = {name: (getattr(perturbed, name).shape, getattr(nominal, name).shape) for name in "ABCD"}
    sizes = [(name, found, wanted) for name, (found, wanted) in shapes.items() if found != wanted]
    if wrong := [f"{second} {name} is {a}, expected {b} to match {first} {name}" for name, a, b in sizes]:
        raise InputError(where, wrong[0], more=tuple(wrong[1:]))
    if nominal.dt != perturbed.dt:
        raise InputError(where, f"{second} has dt = {perturbed.dt:g} s", f"{nominal.dt:g} s to match {first}")
    for kind, prefix in (("inputs", "u"), ("outputs", "y"), ("states", "x")):
        mine, theirs = getattr(nominal, kind), getattr(perturbed, kind)
        names, others = [s.name for s in mine], [s.name for s in theirs]
        # Default names of signals here and in python-control.
        unnamed = ([f"{prefix}{i + 1}" for i in range(len(mine))], [f"{prefix}[{i}]" for i in range(len(mine))])
        if names != others and names not in unnamed and others not in unnamed:
            hint = f"bring them into one order with select({kind}=...)" if sorted(names) == sorted(others) else None
            found, expected = f"{second} {kind} are {', '.join(others)}", f"{', '.join(names)} to match {first}"
            raise InputError(where, found, expected, hint)
        for a, b in zip(mine, theirs, strict=True):
            if a.unit and b.unit and a.unit != b.unit:
                raise UnitMismatch(where, f"{second} {b.name} is in {b.unit}", f"{a.unit} to match {first}")
