r"""Linear models in descriptor form as state-space models: what E says of no rate is eliminated.

.. math:: E \dot x = A x + B u, \qquad y = C x + D u

=========  =============================================================================================================
index 0    E has an inverse: ``E^-1 A``, ``E^-1 B``; the states stay
index 1    equations without a rate fix as many states: they are solved for these, and the rest are the states
index > 1  some states are determined by derivatives of the input. A staircase of orthogonal transformations separates
           them; their part of the transfer matrix is a polynomial in s. Where that is a constant it goes into D, else
           the transfer matrix is improper and there is no state-space model
=========  =============================================================================================================

With Delta channels it is closed to an uncertain state-space model:

.. math::
    E \dot x = F x + G u + L_x w, \quad y = C x + D u + L_y w, \qquad
    z = R\,[x; u; \dot x] + S w, \qquad w = \Delta z

gives, with :math:`\dot x = A x + B u + E^{-1} L_x w` put into z, the M of an upper LFT.

References
----------
Dai, *Singular Control Systems* (1989), chapter 1; Van Dooren, "The computation of Kronecker's canonical form of a
singular pencil", Linear Algebra and its Applications 27 (1979).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from robustlab.arrays import AnyArray, Array
from robustlab.errors import InputError, NoTrustworthyNumber, told_as
from robustlab.linear_analysis.structural import drop_unconnected
from robustlab.signals import Signal, SignalLike, real_array, signals
from robustlab.statespace import OperatingPoint, StateSpaceModel, is_rank_deficient
from robustlab.uncertainty.blocks import Block
from robustlab.uncertainty.lft import UncertainModel

# What counts as rounding where a rank is taken.
ROUNDING = 1e-12


class Signals(NamedTuple):
    """Inputs, outputs and states of a model."""

    inputs: Sequence[Signal]
    outputs: Sequence[Signal]
    states: Sequence[Signal]


class Channels(NamedTuple):
    """L (n_x + n_y, q), R (p, 2 n_x + n_u) and S (p, q) of the blocks, in their order."""

    left: Array
    right: Array
    inner: Array
    blocks: tuple[Block, ...]


def solved(e: Array, right: Array, where: str) -> Array:
    """``E^-1 right``; a small inductance in one row and a large mass in another say nothing of the rank of E.

    Raises InputError: E is singular.
    """
    size = np.abs(e).max(axis=1, initial=0.0)
    if (size == 0).any() or (len(e) and np.linalg.cond(e / size[:, None]) > 1 / ROUNDING):
        raise InputError(f"{where}: equations", "E is singular", "an equation for the rate of every state")
    return np.asarray(np.linalg.solve(e, right), dtype=float)


def closed_descriptor(
    nominal: StateSpaceModel,
    e: Array,
    channels: Channels,
    where: str,
    outputs: Sequence[str] | None = None,
    point: OperatingPoint | None = None,
) -> UncertainModel:
    """The uncertain model around a nominal one, whose descriptor form has E and these channels.

    ``outputs``: names of the outputs to keep; states that then neither show nor act are left out. All where left out.

    Raises InputError: a singular E, an output that there is not.
    """
    n, n_u, n_y = nominal.n_states, nominal.n_inputs, nominal.n_outputs
    left, right, inner, blocks = channels
    into_x = solved(e, left[:n], where) + 0.0  # no negative zeros
    r_x, r_u, r_rate = right[:, :n], right[:, n : n + n_u], right[:, n + n_u :]
    w_names = [f"{b.name}[{i + 1}]" if b.rows > 1 else b.name for b in blocks for i in range(b.rows)]
    z_names = [f"{b.name}[{i + 1}]" if b.cols > 1 else b.name for b in blocks for i in range(b.cols)]
    m = StateSpaceModel(
        nominal.A,
        np.hstack([into_x, nominal.B]),
        np.vstack([r_x + r_rate @ nominal.A, nominal.C]),
        np.block([[inner + r_rate @ into_x, r_u + r_rate @ nominal.B], [left[n:].reshape(n_y, -1), nominal.D]]),
        0.0,
        [*(f"w_{name}" for name in w_names), *nominal.inputs],
        [*(f"z_{name}" for name in z_names), *nominal.outputs],
        nominal.states,
        where=f"{where}: uncertain",
    )
    if outputs is None:
        return UncertainModel(m, blocks, point)
    kept = m.select(m.input_names, [*(f"z_{name}" for name in z_names), *outputs])
    # the operating point is one of all outputs
    return UncertainModel(drop_unconnected(kept), blocks)


# The model and the descriptor form must have one transfer matrix, to this accuracy.
SAME = 1e-8
# A coefficient of the polynomial part below this share of what its terms could be is zero.
CANCELLED = 1e-10
POINTS = 9


@dataclass(frozen=True, eq=False)
class Eliminated:
    """A state-space model of a descriptor form, with the evidence."""

    model: StateSpaceModel
    index: int  # 0: E has an inverse; 1: algebraic equations; more: derivatives of the input, which do not show
    # numbers of the given states that are the model's; None where its states are combinations of them
    kept: tuple[int, ...] | None
    n_given: int  # number of states given
    # largest relative difference of the two transfer matrices at nine points s (z) off the imaginary axis (the unit
    # circle)
    residual: float

    def __str__(self) -> str:
        gone = self.n_given - self.model.n_states
        what = f"{gone} of {self.n_given} states eliminated" if gone else "E has an inverse, all states stay"
        return f"descriptor form of index {self.index}: {what}; relative residual {self.residual:.1e}"


class _Form(NamedTuple):
    """E, A, B, C, D as arrays."""

    E: Array
    A: Array
    B: Array
    C: Array
    D: Array


@dataclass(frozen=True, eq=False)
class _Reduced:
    """A, B, C, D of a state-space model, the index, and which states it kept."""

    A: Array
    B: Array
    C: Array
    D: Array
    index: int
    kept: tuple[int, ...] | None


@told_as("descriptor")
def descriptor(
    A: ArrayLike,
    B: ArrayLike,
    C: ArrayLike,
    D: ArrayLike,
    E: ArrayLike,
    dt: float = 0.0,
    inputs: Iterable[SignalLike] | None = None,
    outputs: Iterable[SignalLike] | None = None,
    states: Iterable[SignalLike] | None = None,
    where: str = "descriptor",
) -> StateSpaceModel:
    r"""State-space model of a descriptor form, algebraic equations eliminated.

    .. math:: E \dot x = A x + B u, \quad y = C x + D u \quad (dt = 0) \qquad E x_{k+1} = A x_k + B u_k \quad (dt > 0)

    Parameters
    ----------
    A, B, C, D, E
        Real matrices of shape (n, n), (n, n_u), (n_y, n), (n_y, n_u), (n, n). E may be singular, s E - A not for all s.
    dt
        Sample time in s; 0 means continuous time.
    inputs, outputs, states
        Names, or (name, unit) pairs, of all n states. Where E has an inverse, and where its zero columns belong to
        the states that its zero rows determine, the states left keep their names; else they are combinations, x1, x2...
    where
        What error messages call this model (a file name, for example).

    Returns
    -------
    StateSpaceModel
        With as many states as the pencil has finite poles. Its transfer matrix is checked against
        :math:`C (s E - A)^{-1} B + D` at nine points.

    Raises
    ------
    InputError
        What `StateSpaceModel` refuses; s E - A singular for every s (too few equations for x); an improper transfer
        matrix, with the index and how often which input is differentiated.
    NoTrustworthyNumber
        The two transfer matrices differ.

    Examples
    --------
    An RC circuit; the current i is fixed by an equation without a rate: 0 = u - v - 2 i.

    >>> circuit = descriptor([[0, 1], [-1, -2]], [[0], [1]], [[0, 1]], [[0]], [[0.5, 0], [0, 0]], states=["v", "i"])
    >>> circuit.A, circuit.C, circuit.D, circuit.state_names
    (array([[-1.]]), array([[-0.5]]), array([[0.5]]), ('v',))
    """
    return eliminated(A, B, C, D, E, dt, inputs, outputs, states, where).model


def eliminated(
    A: ArrayLike,
    B: ArrayLike,
    C: ArrayLike,
    D: ArrayLike,
    E: ArrayLike,
    dt: float = 0.0,
    inputs: Iterable[SignalLike] | None = None,
    outputs: Iterable[SignalLike] | None = None,
    states: Iterable[SignalLike] | None = None,
    where: str = "descriptor",
) -> Eliminated:
    """`descriptor` with its evidence."""
    given = StateSpaceModel(A, B, C, D, dt, inputs, outputs, states, where=where)
    e, n = real_array("E", E, 2, where), given.n_states
    if e.shape != (n, n):
        raise InputError(where, f"E is {e.shape}", f"{(n, n)} as A")
    form = _Form(e, given.A, given.B, given.C, given.D)
    found = _explicit(form) or _semi_explicit(form) or _separated(form, given, where)
    names: list[Signal] | tuple[Signal, ...] | None = None
    if found.kept is not None:
        names = [given.states[k] for k in found.kept]
    model = StateSpaceModel(
        found.A, found.B, found.C, found.D, dt, given.inputs, given.outputs,
        signals(names, len(found.A), "x", where), where=where,
    )  # fmt: skip
    residual = _residual(form, model)
    if not residual <= SAME:
        text = f"the model without algebraic equations differs from the descriptor form by {residual:.1e}"
        hint = "is a singular value of E neither zero nor clearly not?"
        raise NoTrustworthyNumber(where, text, f"at most {SAME:.0e} of the transfer matrix", hint)
    return Eliminated(model, found.index, found.kept, n, residual)


# --- index 0 and 1: the given states stay -----------------------------------------------------------------------------


def _has_inverse(matrix: Array) -> bool:
    return not len(matrix) or not is_rank_deficient(matrix)


def _solved(e: AnyArray, right: Array) -> AnyArray:
    """``E^-1 right``; rows brought to one size first."""
    size = np.abs(e).max(axis=1, keepdims=True, initial=0.0)
    return np.linalg.solve(e / size, right / size)


def _explicit(form: _Form) -> _Reduced | None:
    """Where E has an inverse."""
    if not _has_inverse(form.E):
        return None
    rates = _solved(form.E, np.hstack([form.A, form.B]))
    n = len(form.E)
    return _Reduced(rates[:, :n], rates[:, n:], form.C, form.D, 0, tuple(range(n)))


def _semi_explicit(form: _Form) -> _Reduced | None:
    """Where the zero rows of E can be solved for the states of its zero columns."""
    rated, moving = form.E.any(axis=1), form.E.any(axis=0)
    if rated.sum() != moving.sum():
        return None
    inner, algebraic = form.E[np.ix_(rated, moving)], form.A[np.ix_(~rated, ~moving)]
    if not (_has_inverse(inner) and _has_inverse(algebraic)):
        return None
    n = int(moving.sum())
    # x2 = -A22^-1 (A21 x1 + B2 u)
    fixed = -_solved(algebraic, np.hstack([form.A[np.ix_(~rated, moving)], form.B[~rated]]))
    into, shown = form.A[np.ix_(rated, ~moving)] @ fixed, form.C[:, ~moving] @ fixed
    rates = _solved(inner, np.hstack([form.A[np.ix_(rated, moving)], form.B[rated]]) + into)
    kept = tuple(np.flatnonzero(moving).tolist())
    return _Reduced(rates[:, :n], rates[:, n:], form.C[:, moving] + shown[:, :n], form.D + shown[:, n:], 1, kept)


# --- any index: finite and infinite part, separated -------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Staircase:
    """``left' (s E - A) right`` block upper triangular: the first ``finite`` rows and columns have the finite poles."""

    E: Array
    A: Array
    left: Array
    right: Array
    finite: int
    index: int


def _separated(form: _Form, given: StateSpaceModel, where: str) -> _Reduced:
    rows, columns = _scales(form)
    stairs = _staircase(form.E * rows[:, None] * columns, form.A * rows[:, None] * columns, where)
    k, e, a = stairs.finite, stairs.E, stairs.A
    b, c = stairs.left.T @ (form.B * rows[:, None]), form.C * columns @ stairs.right
    shift = np.linalg.solve(a[k:, k:], e[k:, k:])  # nilpotent: shift^index = 0
    # [I Z; 0 I] and [I Y; 0 I] on both sides make the two parts one beside the other; the sum over Y ends.
    own = np.linalg.solve(e[:k, :k], a[:k, k:] @ shift - e[:k, k:])
    rates = np.linalg.solve(e[:k, :k], a[:k, :k])
    y = own
    for _ in range(stairs.index):
        y = own + rates @ y @ shift
    z = -np.linalg.solve(a[k:, k:].T, (a[:k, :k] @ y + a[:k, k:]).T).T
    gain, seen = np.linalg.solve(a[k:, k:], b[k:]), c[:, :k] @ y + c[:, k:]
    # What enters through all of b and shows in all of c: a path through the infinite part alone may be zero.
    sizes = [np.linalg.norm(c, axis=1) * (1 + np.linalg.norm(y)), np.linalg.norm(b, axis=0)]
    rounding = CANCELLED * np.outer(*sizes) * np.linalg.norm(np.linalg.inv(a[k:, k:]), 2)
    _refuse_improper(seen, shift, gain, rounding, stairs.index, given, where)
    into = np.linalg.solve(e[:k, :k], b[:k] + z @ b[k:])
    return _Reduced(rates, into, c[:, :k], form.D - seen @ gain, stairs.index, None)


def _scales(form: _Form) -> tuple[Array, Array]:
    """Powers of two that bring the rows and columns of (E, A) to one size."""
    size = np.maximum(*(np.abs(m) / (np.abs(m).max(initial=0.0) or 1.0) for m in (form.E, form.A)))
    rows, columns = np.ones(len(size)), np.ones(len(size))
    for _ in range(3):
        for axis, scale in ((1, rows), (0, columns)):
            largest = (size * rows[:, None] * columns).max(axis=axis)
            scale *= np.exp2(-np.rint(np.log2(np.where(largest > 0, largest, 1.0))))
    return rows, columns


def _staircase(e: Array, a: Array, where: str) -> _Staircase:
    """Step by step the rows without a rate, and the states that they determine, go to the end."""
    n = len(e)
    left, right, size, index = np.eye(n), np.eye(n), n, 0
    small_e, small_a = (ROUNDING * float(np.linalg.norm(m, 2)) for m in (e, a))
    while size:
        u, values, _ = np.linalg.svd(e[:size, :size])
        rank = int((values > small_e).sum())
        if rank == size:
            break
        for m in (e, a):
            m[:size] = u.T @ m[:size]
        left[:, :size] = left[:, :size] @ u
        e[rank:size, :size] = 0.0
        _, values, v = np.linalg.svd(a[rank:size, :size])
        if not values.min() > small_a:
            found = "s E - A is singular for every s: the equations do not determine x"
            raise InputError(where, found, "as many independent equations as states")
        turned = np.vstack([v[size - rank :], v[: size - rank]]).T
        for m in (e, a, right):
            m[:, :size] = m[:, :size] @ turned
        a[rank:size, :rank] = 0.0
        size, index = rank, index + 1
    return _Staircase(e, a, left, right, size, index)


def _refuse_improper(
    seen: Array, shift: Array, gain: Array, rounding: Array, index: int, given: StateSpaceModel, where: str
) -> None:
    """The polynomial part is -seen shift^k gain s^k: nothing of it but ``rounding`` may be left for k > 0."""
    power, size = gain, float(np.linalg.norm(shift, 2))
    worst: tuple[int, int, int] | None = None
    for k in range(1, index):
        power = shift @ power
        left = np.argwhere(np.abs(seen @ power) > rounding * size**k)
        if len(left):
            worst = k, int(left[0][0]), int(left[0][1])
    if worst is None:
        return
    k, i, j = worst
    out, into = given.output_names[i], given.input_names[j]
    times = "once" if k == 1 else f"{k} times"
    found = f"index {index}: the transfer matrix is improper, output {out!r} has input {into!r} differentiated {times}"
    hint = f"make that derivative of {into!r} the input, or put a lag of order {k} in front of it"
    if given.is_discrete:
        found = f"index {index}: the transfer matrix is improper, output {out!r} needs input {into!r} {k} samples ahead"
        hint = f"delay the output or the input by {k} samples"
    raise InputError(where, found, "a proper one", hint)


# --- evidence ---------------------------------------------------------------------------------------------------------


def _residual(form: _Form, model: StateSpaceModel) -> float:
    """Largest relative difference of the transfer matrices at points that are no poles."""
    worst = 0.0
    for point in _points(model):
        one = _transfer(np.eye(model.n_states), model.A, model.B, model.C, model.D, point)
        two = _transfer(form.E, form.A, form.B, form.C, form.D, point)
        size = float(np.abs(two).max(initial=0.0)) or 1.0  # squares of large entries overflow
        worst = max(worst, float(np.linalg.norm((one - two) / size)) / (float(np.linalg.norm(two / size)) or 1.0))
    return worst


def _transfer(e: Array, a: Array, b: Array, c: Array, d: Array, point: complex) -> AnyArray:
    return d + c @ _solved(point * e - a, b) if len(a) else d + 0j


def _points(model: StateSpaceModel) -> AnyArray:
    if model.is_discrete:
        return 1.37 * np.exp(1j * np.linspace(0.1, 3.0, POINTS))
    rates = np.abs(model.poles())
    rates = rates[rates > 1e-9 * rates.max(initial=0.0)]
    low, high = (rates.min(), rates.max()) if len(rates) else (1.0, 1.0)
    return np.geomspace(0.1 * low, 10 * high, POINTS) * np.exp(1j)
