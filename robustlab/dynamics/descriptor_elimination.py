"""State-space models of linear descriptor forms E x' = A x + B u, y = C x + D u, algebraic equations eliminated."""
# Dai, *Singular Control Systems* (1989), chapter 1.

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from robustlab.arrays import AnyArray, Array, Mask
from robustlab.errors import InputError, NoTrustworthyNumber, error_context
from robustlab.linear_analysis.matrices import equilibrating_exponents
from robustlab.linear_analysis.structural import drop_unconnected
from robustlab.signals import SignalLike, real_array, signals
from robustlab.statespace import StateSpaceModel, is_rank_deficient
from robustlab.uncertainty.blocks import Block
from robustlab.uncertainty.lft import UncertainModel, with_channels

# Relative rounding in rank decisions.
ROUNDING = 1e-12


def solved(e: Array, right: Array, where: str) -> Array:
    """Return ``E^-1 right``; the rank of E is decided with rows scaled to equal size."""
    size = np.abs(e).max(axis=1, initial=0.0)
    if (size == 0).any() or (len(e) and np.linalg.cond(e / size[:, None]) > 1 / ROUNDING):
        raise InputError(f"{where}: equations", "E is singular", "an equation for the rate of every state")
    return np.asarray(np.linalg.solve(e, right), dtype=float)


def closed_descriptor(
    nominal: StateSpaceModel, e: Array, left: Array, right: Array, inner: Array, blocks: Sequence[Block], where: str
) -> UncertainModel:
    """Return the set around a model in descriptor form with E and the blocks' L, R (p, 2 n_x + n_u) and S (p, q)."""
    n, m = nominal.n_states, nominal.n_states + nominal.n_inputs
    into_x, rate = solved(e, left[:n], where) + 0.0, right[:, m:]  # no negative zeros
    seen = right[:, :m] + rate @ np.hstack([nominal.A, nominal.B])
    return with_channels(nominal, blocks, np.vstack([into_x, left[n:]]), seen, inner + rate @ into_x)


def with_outputs(model: UncertainModel, outputs: Sequence[str] | None) -> UncertainModel:
    """Return the set with some outputs only, without the states and the operating point of the others."""
    if outputs is None:
        return model
    return UncertainModel(drop_unconnected(model.select(outputs=outputs).M), model.blocks)


# Allowed relative difference between the transfer matrices of the model and the descriptor form.
SAME = 1e-8
POINTS = 9


@error_context("descriptor")
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
        the states that its zero rows determine, the remaining states keep their names; else they are combinations, x1,
        x2...
    where
        Name of this model in error messages (a file name, for example).

    Returns
    -------
    StateSpaceModel
        With as many states as E has rank. Its transfer matrix is checked against
        :math:`C (s E - A)^{-1} B + D` at nine points.

    Raises
    ------
    InputError
        Arguments that `StateSpaceModel` rejects; s E - A singular for every s (too few equations for x); an index above
        1, where states are determined by derivatives of the input.
    NoTrustworthyNumber
        The two transfer matrices differ.

    Examples
    --------
    An RC circuit; the current i is fixed by an equation without a rate: 0 = u - v - 2 i.

    >>> circuit = descriptor([[0, 1], [-1, -2]], [[0], [1]], [[0, 1]], [[0]], [[0.5, 0], [0, 0]], states=["v", "i"])
    >>> circuit.A, circuit.C, circuit.D, circuit.state_names
    (array([[-1.]]), array([[-0.5]]), array([[0.5]]), ('v',))
    """
    return eliminated(StateSpaceModel(A, B, C, D, dt, inputs, outputs, states, where=where), E, where)[0]


def eliminated(
    given: StateSpaceModel, E: ArrayLike, where: str = "descriptor"
) -> tuple[StateSpaceModel, list[int] | None, float]:
    """Return the model, the remaining states (None for combinations), and the relative error of its response."""
    e, n = real_array("E", E, 2, where), given.n_states
    if e.shape != (n, n):
        raise InputError(where, f"E is {e.shape}", f"{(n, n)} as A")
    rated, kept = (np.asarray(e.any(axis=axis), dtype=np.bool_) for axis in (1, 0))
    found = _without_algebraic((e, given.A, given.B, given.C, given.D), rated, kept)
    own: list[int] | None = np.flatnonzero(kept).tolist()
    if found is None:  # only other coordinates separate the states with a rate from those without
        turned, rated = _turned(e, given, where)
        found, own = _without_algebraic(turned, rated, rated), None
        assert found is not None
    a, b, c, d = found
    states = signals(None if own is None else [given.states[k] for k in own], len(a), "x", where)
    model = StateSpaceModel(a, b, c, d, given.dt, given.inputs, given.outputs, states, where=where)
    residual = 0.0
    for s in _points(model):
        one, two = d + c @ _solved(s * np.eye(len(a)) - a, b), given.D + given.C @ _solved(s * e - given.A, given.B)
        size = float(np.abs(two).max(initial=0.0)) or 1.0  # squares of large entries overflow
        off = float(np.linalg.norm((one - two) / size)) / (float(np.linalg.norm(two / size)) or 1.0)
        residual = max(residual, off)
    if not residual <= SAME:
        text = f"the model without algebraic equations differs from the descriptor form by {residual:.1e}"
        hint = "is a singular value of E neither zero nor clearly not?"
        raise NoTrustworthyNumber(where, text, f"at most {SAME:.0e} of the transfer matrix", hint)
    return model, own, residual


def _has_inverse(matrix: Array) -> bool:
    return not len(matrix) or not is_rank_deficient(matrix)


def _solved(e: AnyArray, right: Array) -> AnyArray:
    """Return ``E^-1 right`` with rows scaled to equal size."""
    if not len(e):
        return np.zeros_like(right)
    size = np.abs(e).max(axis=1, keepdims=True, initial=0.0)
    return np.linalg.solve(e / size, right / size)


def _without_algebraic(form: tuple[Array, ...], rated: Any, moving: Any) -> tuple[Array, Array, Array, Array] | None:
    """Return A, B, C, D if the equations without a rate determine the states without one, else None."""
    e, a, b, c, d = form
    if rated.sum() != moving.sum():
        return None
    inner, algebraic = e[np.ix_(rated, moving)], a[np.ix_(~rated, ~moving)]
    if not (_has_inverse(inner) and _has_inverse(algebraic)):
        return None
    n = int(moving.sum())
    # x2 = -A22^-1 (A21 x1 + B2 u)
    fixed = -_solved(algebraic, np.hstack([a[np.ix_(~rated, moving)], b[~rated]]))
    rates = np.hstack([a[np.ix_(rated, moving)], b[rated]]) + a[np.ix_(rated, ~moving)] @ fixed
    rates, outputs = _solved(inner, rates), np.hstack([c[:, moving], d]) + c[:, ~moving] @ fixed
    return rates[:, :n], rates[:, n:], outputs[:, :n], outputs[:, n:]


def _turned(e: Array, given: StateSpaceModel, where: str) -> tuple[tuple[Array, ...], Mask]:
    """Return the form in the singular coordinates of E and a mask of those with a rate; the index must be 1."""
    # scale the rows and columns of (E, A) to equal size by powers of two
    size = np.maximum(*(np.abs(m) / (np.abs(m).max(initial=0.0) or 1.0) for m in (e, given.A)))
    rows, columns = (np.exp2(1.0 * exponents) for exponents in equilibrating_exponents(size))
    scaled, a = (m * rows[:, None] * columns for m in (e, given.A))
    u, values, v = np.linalg.svd(scaled)
    rated = values > ROUNDING * values.max(initial=0.0)
    turned, small = u.T @ a @ v.T, ROUNDING * float(np.linalg.norm(a, 2))
    if np.linalg.svd(turned[~rated][:, ~rated], compute_uv=False).min(initial=np.inf) <= small:
        far = [s * float(np.linalg.norm(a, 2)) / (values.max(initial=0.0) or 1.0) for s in (0.37, 1.71, -2.3)]
        alone = np.linalg.svd(turned[~rated], compute_uv=False).min() <= small
        if alone or not any(_has_inverse(s * scaled - a) for s in far):
            found = "s E - A is singular for every s: the equations do not determine x"
            raise InputError(where, found, "as many independent equations as states")
        hint = "solve the constraints that are differentiated for the states that they determine"
        raise InputError(where, "an index above 1: derivatives determine states", "index 0 or 1", hint)
    b, c = u.T @ (given.B * rows[:, None]), given.C * columns @ v.T
    return (np.diag(np.where(rated, values, 0.0)), turned, b, c, given.D), rated


def _points(model: StateSpaceModel) -> AnyArray:
    if model.is_discrete:
        return 1.37 * np.exp(1j * np.linspace(0.1, 3.0, POINTS))
    rates = np.abs(model.poles())
    rates = rates[rates > 1e-9 * rates.max(initial=0.0)]
    low, high = (rates.min(), rates.max()) if len(rates) else (1.0, 1.0)
    return np.geomspace(0.1 * low, 10 * high, POINTS) * np.exp(1j)
