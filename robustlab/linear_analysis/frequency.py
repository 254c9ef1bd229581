"""Frequency grids, responses (frequency comes first: (n_omega, n_outputs, n_inputs)), and steady states."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from robustlab.arrays import AnyArray, Array, ComplexArray
from robustlab.display import AllFields, Displayable, Each, Facts, number
from robustlab.errors import InputError, NoTrustworthyNumber, error_context, unknown_name
from robustlab.linear_analysis.matrices import balancing_factors, refuse_overflow
from robustlab.linear_analysis.structural import drop_unconnected
from robustlab.result import Status
from robustlab.statespace import StateSpaceModel, as_model, real_array

# Numbers in a chunk of the (n_omega, n, n) complex systems: more need fresh pages of memory.
CHUNK = 20_000


def default_grid(model: StateSpaceModel, n: int = 200, decades: float = 2.0) -> Array:
    """Return a logarithmic grid in rad/s, from ``decades`` below the slowest to ``decades`` above the fastest pole."""
    poles = model.poles()
    if model.is_discrete:
        poles = np.log(poles[np.abs(poles) > 1e-12]) / model.dt
    size = np.abs(poles)
    size = size[size > 1e-9 * max(size.max(initial=0.0), 1e-300)]
    low, high = (size.min(), size.max()) if len(size) else (1.0, 1.0)
    grid = np.geomspace(low * 10**-decades, high * 10**decades, n)
    light = np.abs(poles.imag)[(np.abs(poles.real) < 0.3 * np.abs(poles)) & (poles.imag > 0)]
    grid = np.unique(np.concatenate([grid, light, narrow_frequencies(poles)]))
    if model.is_discrete:
        nyquist = np.pi / model.dt
        grid = np.append(grid[grid < nyquist], nyquist)
    return grid


@error_context("frequency_response")
def frequency_response(model: Any, omega: ArrayLike) -> ComplexArray:
    r"""Compute the frequency response, shape (n_omega, n_y, n_u).

    .. math:: G(j\omega) = C (j\omega I - A)^{-1} B + D, \qquad G(e^{j\omega dt}) \text{ for } dt > 0

    Parameters
    ----------
    model
        A `StateSpaceModel`, a python-control object, or a `DelayedModel`, whose delays are exact.
    omega
        Frequencies in rad/s, shape (n_omega,); ``inf`` gives D for a continuous model.

    Returns
    -------
    ndarray
        Complex, shape (n_omega, n_y, n_u).

    Raises
    ------
    InputError
        Frequencies that are NaN, or infinite for a discrete model.
    NoTrustworthyNumber
        A frequency hits a pole exactly, or the response overflows.

    Examples
    --------
    >>> lag = StateSpaceModel([[-2.0]], [[1.0]], [[6.0]], [[0.0]])
    >>> frequency_response(lag, [0.0, 2.0])[:, 0, 0]
    array([3. +0.j , 1.5-1.5j])
    """
    exact = getattr(model, "response_at", None)
    if exact is not None:  # a model with more than its state space
        return exact(omega)
    model = as_model(model, "frequency_response")
    w = np.atleast_1d(np.asarray(omega, dtype=float))
    finite = np.isfinite(w)
    real_array("omega", w[finite], 1, "frequency_response")
    if not finite.all() and (model.is_discrete or np.isnan(w).any() or (w[~finite] < 0).any()):
        raise InputError("frequency_response", "omega is not finite", "finite frequencies in rad/s")
    found = solved_response(model, w)
    refuse_overflow("frequency_response", found)
    return found


def solved_response(model: StateSpaceModel, omega: Array) -> ComplexArray:
    """Compute `frequency_response` at valid frequencies, which may be infinite, unchecked."""
    response = np.empty((len(omega), *model.D.shape), dtype=complex)
    response[:] = model.D
    where = np.flatnonzero(np.isfinite(omega))
    point = np.exp(1j * omega[where] * model.dt) if model.is_discrete else 1j * omega[where]
    response[where] = solved_on_axis(lambda s: _solved(model, s), omega[where], point)
    return response


def solved_on_axis(solved: Callable[[ComplexArray], ComplexArray], omega: Array, point: ComplexArray) -> ComplexArray:
    """Compute ``solved(point)``; NoTrustworthyNumber with the frequency of the first pole among the points."""
    try:
        return solved(point)
    except np.linalg.LinAlgError:
        at = "a frequency"
        for k, w in enumerate(omega):
            try:
                solved(point[k : k + 1])
            except np.linalg.LinAlgError:
                at = f"{w:g} rad/s"
                break
        found, expected = f"{at} hits a pole exactly", "frequencies that are no poles"
        raise NoTrustworthyNumber("frequency_response", found, expected) from None


def _solved(model: StateSpaceModel, point: ComplexArray) -> ComplexArray:
    """Compute the transfer matrix at finite complex numbers, shape (n, n_y, n_u); numpy's LinAlgError at a pole."""
    found = np.empty((len(point), *model.D.shape), dtype=complex)
    found[:] = model.D
    n = model.n_states
    if n == 0:
        return found
    eye, B = np.eye(n), model.B.astype(complex)
    step = max(1, CHUNK // (n * n))
    with np.errstate(over="ignore", invalid="ignore"):
        for first in range(0, len(point), step):
            s = point[first : first + step]
            found[first : first + step] += model.C @ np.linalg.solve(s[:, None, None] * eye - model.A, B[None])
    return found


def value_at(model: Any, s: ArrayLike) -> ComplexArray:
    """Compute ``G(s)``, see `robustlab.operators.Behaviour`."""
    point = np.asarray(s)
    if point.ndim > 1 or point.dtype.kind not in "cfiu" or not np.isfinite(point).all():
        raise InputError("G(s)", f"s = {s!r}", "a finite complex number, or a row of them", "G(1j * omega)")
    given = np.atleast_1d(point).astype(np.complex128)
    exact = getattr(model, "values_at", None)  # of a model with more than its state space
    try:
        found = _solved(as_model(model, "G(s)"), given) if exact is None else exact(given)
    except np.linalg.LinAlgError:
        raise NoTrustworthyNumber("G(s)", "s hits a pole exactly", "a number that is no pole") from None
    refuse_overflow("G(s)", found)
    return found if point.ndim else found[0]


@dataclass(frozen=True)
class SteadyState(AllFields, Displayable):
    """Outputs in steady state, by name, with the inputs and the units of both."""

    inputs: Mapping[str, float]
    outputs: Mapping[str, float]
    units: Mapping[str, str]
    status: Status = Status.CONVERGED

    quantities: ClassVar[Mapping[str, Any]] = {"outputs": Each("outputs", "*")}

    def headline(self) -> str:
        given = ", ".join(f"{name} = {number(value, self.units[name], 5)}" for name, value in self.inputs.items())
        return f"steady state at {given or 'zero'}"

    def facts(self) -> Facts:
        return [(name, number(value, self.units[name], 6)) for name, value in self.outputs.items()]


def steady_state(model: Any, inputs: Mapping[str, float], outputs: Sequence[str] | None = None) -> SteadyState:
    """Compute outputs :math:`y = G(0) u` (discrete :math:`G(1) u`) under constant inputs; inputs left out are zero."""
    given = as_model(model, "steady state")
    if outputs is not None:
        given = drop_unconnected(given.select(outputs=outputs))
    for name in inputs:
        if name not in given.input_names:
            raise unknown_name(f"inputs.{name}", "no such input", name, given.input_names)
    if not given.is_stable():
        found, hint = "is not stable, so it has no steady state", "keep only outputs that settle with outputs = [...]"
        raise InputError("model", found, "a stable model", hint)
    y = given.dc_gain() @ np.array([inputs.get(name, 0.0) for name in given.input_names])
    units = {s.name: s.unit for s in (*given.inputs, *given.outputs)}
    values = {s.name: float(value) for s, value in zip(given.outputs, y, strict=True)}
    return SteadyState({n: inputs[n] for n in given.input_names if n in inputs}, values, units)


# Distance of a pole from the axis, as a share of its frequency, below which a grid may miss its peak.
NARROW = 0.02
# Points of a peak in half widths, between which the phase turns by equal angles.
INSIDE = np.tan(np.pi / 8 * np.arange(-3, 4))
# Distance from the axis, as a share of the size of A, below which rounding of A moves the peak noticeably.
BLURRED = 1e-6
# Product of the left and right eigenvector below which a mode cannot be decoupled from another one.
ALIKE = 1e-4
# Bits of the change of states: differences of much larger terms keep all digits of a double.
BITS = 192


def narrow_frequencies(poles: AnyArray) -> Array:
    """Return frequencies in rad/s inside the peak of every pole (of the s plane) next to the frequency axis."""
    distance, at = np.abs(np.real(poles))[:, None], np.imag(poles)[:, None]
    return np.unique((at + distance * INSIDE)[(at[:, 0] > 0) & (distance < NARROW * at)[:, 0]])


def modes_apart(model: StateSpaceModel) -> StateSpaceModel:
    """Decouple modes from all others whose damping is changed by rounding.

    In a state of its own, scaled to equal input and output gains, the gain of a mode that a zero nearly cancels has all
    its digits. States are changed in ball arithmetic: only entries of the result are rounded.
    """
    poles: AnyArray = model.poles()
    if model.is_discrete:
        poles = np.log(poles[np.abs(poles) > 0])
    distance, at = np.abs(np.real(poles)), np.imag(poles)
    light = (at > 0) & (distance < NARROW * at)
    if not light.any():
        return model
    t = balancing_factors(model.A)
    A, B, C = model.A / t[:, None] * t, model.B / t[:, None], model.C * t
    poles = poles[light & (distance < BLURRED * np.linalg.norm(A, 1))]
    if model.is_discrete:
        poles = np.exp(poles)
    right, left = (_eigenvectors(matrix, poles) for matrix in (A, A.T))
    inner = np.abs((left * right).sum(axis=0))  # of vectors of length one
    kept = inner > ALIKE
    left, right, inner = left[:, kept], right[:, kept], inner[kept]
    if not len(inner):
        return model
    driven = np.linalg.norm(left.T @ B, axis=1) / inner
    seen = np.linalg.norm(C @ right, axis=0)
    with np.errstate(all="ignore"):
        size = 2.0 ** np.round(0.5 * np.log2(driven / seen))
    right = right * np.where(np.isfinite(size) & (size > 0), size, 1.0)
    others = np.linalg.qr(np.hstack([np.real(left), np.imag(left)]), mode="complete")[0][:, 2 * len(inner) :]
    T = np.hstack([others, np.stack([np.real(right), np.imag(right)], axis=2).reshape(len(A), -1)])
    apart = in_states(StateSpaceModel(A, B, C, model.D, model.dt, model.inputs, model.outputs), T)
    return model if apart is None else apart  # None: the vectors are no basis


def in_states(model: StateSpaceModel, T: AnyArray) -> StateSpaceModel | None:
    """Return the model in states x' with ``x = T x'``, each entry rounded once; None if T is no basis."""
    from robustlab.verification.balls import exact, midpoints, precision

    with precision(BITS):
        basis = exact(T)
        try:
            parts = basis.solve(exact(model.A) * basis), basis.solve(exact(model.B)), exact(model.C) * basis
        except ZeroDivisionError:
            return None
        A, B, C = (midpoints(part) for part in parts)
    if not all(np.isfinite(part).all() for part in (A, B, C)):
        return None
    return StateSpaceModel(A, B, C, model.D, model.dt, model.inputs, model.outputs)


def _eigenvectors(matrix: AnyArray, values: AnyArray) -> AnyArray:
    """Return the eigenvectors of length one whose eigenvalues are nearest to these."""
    found, vectors = np.linalg.eig(matrix)
    return vectors[:, np.abs(found - values[:, None]).argmin(axis=1)]
