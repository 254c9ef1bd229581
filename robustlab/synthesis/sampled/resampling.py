r"""From discrete time back to continuous time, and from one sample time to another.

==========  ============================================================================================================
``zoh``     the continuous model whose samples under a held input are the given ones; its modes lie below the Nyquist
            frequency. By the principal logarithm :math:`A = \log(A_d) / T`
``foh``     likewise for an input that goes straight from sample to sample
``tustin``  :math:`z = (1 + s T/2) / (1 - s T/2)`
==========  ============================================================================================================

A real matrix with an eigenvalue on the closed negative real axis has no real principal logarithm: a mode that changes
its sign from sample to sample, or ends after one, is none of a continuous model of the same order. A whole multiple of
the sample time needs no logarithm.

References
----------
Franklin, Powell, Workman, *Digital Control of Dynamic Systems* (1998), chapter 6; Higham, *Functions of Matrices*
(2008), theorem 1.31.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Literal

import numpy as np

from robustlab.arrays import Array
from robustlab.errors import InputError, NoTrustworthyNumber, did_you_mean, told_as
from robustlab.linear_analysis.frequency import frequency_response
from robustlab.norms import bilinear_to_continuous
from robustlab.result import Status
from robustlab.shown import Facts, Shown, number
from robustlab.statespace import StateSpaceModel, as_model
from robustlab.synthesis.sampled.discretisation import by_formula

Hold = Literal["zoh", "foh", "tustin"]
HOLDS: tuple[Hold, ...] = ("zoh", "foh", "tustin")

# The discretised result must be the given model to this accuracy.
CLOSE = 1e-8
# A sample time this near to a whole multiple, relative to it, is one.
WHOLE = 1e-9
EPS = float(np.finfo(float).eps)


@dataclass(frozen=True, eq=False)
class Resampled(Shown):
    """A model in another time, and the evidence that it is the given one.

    Attributes
    ----------
    model
        The continuous model, or the discrete one with the other sample time; signals are those of the model given.
    method
        ``"zoh"``, ``"foh"`` or ``"tustin"``.
    steps
        Of `d2d`: how many old samples are one new one, where this is a whole number and no logarithm was taken; else 0.
    error
        The continuous model, discretised again, against the given one: the larger of the relative differences of A and
        of the frequency responses up to the Nyquist frequency. With ``steps``: of the states and outputs after that
        many single steps of the given model, relative to the largest.
    status
        CONVERGED where ``error`` is below 1e-8, INACCURATE otherwise.
    """

    quantities: ClassVar[Mapping[str, Any]] = {"dt": "s", "error": float}

    model: StateSpaceModel
    method: str
    steps: int
    error: float
    status: Status

    @property
    def dt(self) -> float:
        """Sample time of the model in s; 0 in continuous time."""
        return self.model.dt

    def to_model(self) -> StateSpaceModel:
        """The model."""
        return self.model

    def headline(self) -> str:
        """Its time, and how well the given model comes back."""
        time = f"A model with a sample time of {number(self.dt, 's')}" if self.dt else "A continuous model"
        return f"{time} by {self.method}, relative error {number(self.error)}"

    def facts(self) -> Facts:
        """What a person wants to read, as (label, text)."""
        against = f"{self.steps} single steps" if self.steps else "the given model, discretised again"
        return [
            ("method", self.method),
            ("model", repr(self.model)),
            ("relative error", f"{number(self.error)} against {against}"),
        ]

    def to_json(self) -> dict[str, Any]:
        """All fields; the model as its own plain types."""
        return dict(vars(self))


@told_as("d2c")
def d2c(model: Any, method: Hold = "zoh") -> Resampled:
    r"""Continuous model of a discrete one.

    .. math:: x_{k+1} = A_d x_k + B_d u_k \quad\to\quad \dot x = A x + B u

    Parameters
    ----------
    model
        Discrete StateSpaceModel with n states and sample time T in s, controller or python-control object.
    method
        See the table of this module.

    Returns
    -------
    Resampled
        Continuous ``model`` with n states, and the error with which `discretise` gives the model back. With
        ``"zoh"`` its states are those of the model, and so is the operating point.

    Raises
    ------
    InputError
        A continuous model, an unknown method.
    NoTrustworthyNumber
        ``"zoh"``, ``"foh"``: a pole on the closed negative real axis. ``"tustin"``: a pole at z = -1.

    Examples
    --------
    >>> lag = StateSpaceModel([[0.5]], [[0.5]], [[1.0]], [[0.0]], dt=0.1)
    >>> found = d2c(lag)
    >>> found.model.A.round(6), str(found.status)
    (array([[-6.931472]]), 'converged')
    """
    m = _discrete(model, method, "d2c")
    found = bilinear_to_continuous(m) if method == "tustin" else _held(m, method)
    found = _labelled(found, m, method)
    error = _difference(by_formula(found, m.dt, method), m)
    return Resampled(found, method, 0, error, _judged(error))


@told_as("d2d")
def d2d(model: Any, dt: float, method: Hold = "zoh") -> Resampled:
    r"""Discrete model with another sample time.

    With ``"zoh"`` and a whole multiple k of the sample time, k steps are one, whatever the poles:

    .. math:: x_{i+k} = A_d^k x_i + (A_d^{k-1} + \cdots + A_d + I) B_d u_i

    Every other case goes through continuous time: `d2c`, then `discretise`.

    Parameters
    ----------
    model
        Discrete StateSpaceModel with n states, controller or python-control object.
    dt
        The new sample time in s.
    method
        See the table of this module.

    Returns
    -------
    Resampled
        ``model`` with n states and sample time ``dt``, and its error.

    Raises
    ------
    InputError
        A continuous model, a sample time that is not positive, an unknown method.
    NoTrustworthyNumber
        Through continuous time: what `d2c` and `discretise` refuse. A whole multiple: numbers that overflow.

    Examples
    --------
    >>> flip = StateSpaceModel([[-0.5]], [[1.0]], [[1.0]], [[0.0]], dt=0.1)
    >>> found = d2d(flip, 0.2)
    >>> found.model.A, found.model.B, found.steps
    (array([[0.25]]), array([[0.5]]), 2)
    """
    m = _discrete(model, method, "d2d")
    if isinstance(dt, bool) or not isinstance(dt, (int, float, np.number)) or not 0 < dt < np.inf:
        raise InputError("d2d", f"dt is {dt!r}", "a positive sample time in s")
    steps = round(float(dt / m.dt)) if dt / m.dt < 1e9 else 0
    if method == "zoh" and steps >= 1 and abs(dt / m.dt - steps) <= WHOLE * steps:
        return _whole_multiple(m, float(dt), steps)
    continuous = d2c(m, method)
    found = _labelled(by_formula(continuous.model, float(dt), method), m, method)
    return Resampled(found, method, 0, continuous.error, continuous.status)


def _discrete(model: Any, method: str, where: str) -> StateSpaceModel:
    m = as_model(getattr(model, "K", model), where)
    if not m.is_discrete:
        raise InputError(where, "the model is continuous (dt = 0)", "a discrete one", "rl.discretise makes one")
    if method not in HOLDS:
        raise InputError(where, f"method {method!r}", f"one of {', '.join(HOLDS)}", did_you_mean(str(method), HOLDS))
    return m


def _labelled(found: StateSpaceModel, given: StateSpaceModel, method: str) -> StateSpaceModel:
    """Signals of the given model; its operating point where the states are the same."""
    point = given.operating_point if method == "zoh" else None
    return replace(found, inputs=given.inputs, outputs=given.outputs, states=given.states, operating_point=point)


# --- through continuous time ------------------------------------------------------------------------------------------


def _held(m: StateSpaceModel, method: str) -> StateSpaceModel:
    """The continuous model by the principal logarithm; B and D follow from what the hold makes of them."""
    from scipy.linalg import expm, logm

    n, where = m.n_states, f"d2c ({method})"
    if not n:
        return StateSpaceModel([], [], [], m.D)
    _refuse_without_logarithm(m, where)
    with warnings.catch_warnings():  # scipy's own estimate of the error; ours is that of the model, see `Resampled`
        warnings.simplefilter("ignore", RuntimeWarning)
        logarithm: Any = logm(m.A)
    if not np.isfinite(logarithm).all() or np.abs(np.imag(logarithm)).max() > CLOSE * np.abs(logarithm).max():
        raise NoTrustworthyNumber(where, "the logarithm of A is not real: a pole near the negative real axis")
    rate: Array = np.real(logarithm)
    zero, one = np.zeros((n, n)), np.eye(n)
    powers = expm(np.block([[rate, one * m.dt, zero], [zero, zero, one], [zero, zero, zero]]))
    constant, ramp = powers[:n, n : 2 * n], powers[:n, 2 * n :]
    if method == "zoh":
        b = np.linalg.solve(constant, m.B)
        return StateSpaceModel(rate / m.dt, b, m.C, m.D)
    b = np.linalg.solve(constant - ramp + m.A @ ramp, m.B)
    return StateSpaceModel(rate / m.dt, b, m.C, m.D - m.C @ ramp @ b)


def _refuse_without_logarithm(m: StateSpaceModel, where: str) -> None:
    poles = m.poles()
    sizes = np.linalg.svd(m.A, compute_uv=False)
    hint = "rl.d2d to a whole multiple of the sample time needs no logarithm; method='tustin' maps this pole"
    if sizes[-1] <= len(poles) * EPS * sizes[0]:
        found = "a pole at z = 0 (to rounding): a mode that is gone after one sample is none of a continuous model"
        raise NoTrustworthyNumber(where, found, "poles off the closed negative real axis", hint)
    flips = poles[(np.abs(poles.imag) <= 1e-12 * np.abs(poles)) & (poles.real < 0)].real
    if len(flips):
        found = f"a pole at z = {flips.min():.6g}: a mode that changes its sign at every sample has no real logarithm"
        raise NoTrustworthyNumber(where, found, "poles off the closed negative real axis", hint)


def _difference(found: StateSpaceModel, given: StateSpaceModel) -> float:
    """The larger of the relative differences of A and of the frequency responses up to the Nyquist frequency."""
    omega = np.pi / given.dt * np.append(np.geomspace(1e-3, 0.3, 12), np.linspace(0.35, 0.98, 12))
    one, two = (frequency_response(model, omega) for model in (found, given))
    size, off = (np.linalg.norm(response, axis=(1, 2)) for response in (two, one - two))
    floor = np.maximum(size, 1e-6 * size.max(initial=0.0))
    response = float((off / np.where(floor > 0, floor, 1.0)).max(initial=0.0))
    return max(_relative(found.A - given.A, given.A), response)


def _relative(difference: Array, given: Array) -> float:
    size = float(np.linalg.norm(given))
    return float(np.linalg.norm(difference)) / (size or 1.0)


def _judged(error: float) -> Status:
    return Status.CONVERGED if error <= CLOSE else Status.INACCURATE


# --- whole multiples --------------------------------------------------------------------------------------------------


def _whole_multiple(m: StateSpaceModel, dt: float, steps: int) -> Resampled:
    n, n_u = m.n_states, m.n_inputs
    held = np.block([[m.A, m.B], [np.zeros((n_u, n)), np.eye(n_u)]])
    with np.errstate(over="ignore", invalid="ignore"):
        power = np.linalg.matrix_power(held, steps)
    if not np.isfinite(power).all():
        raise NoTrustworthyNumber("d2d", f"A^{steps} overflows: a pole of modulus {1 + m.spectral_abscissa():.6g}")
    found = replace(m, A=power[:n, :n], B=power[:n, n:], dt=dt)
    # One step of the new model against so many of the given one, from a random state under a random held input.
    rng = np.random.default_rng(0)
    x, u = rng.standard_normal(n), rng.standard_normal(n_u)
    once, size = found.A @ x + found.B @ u, 0.0
    for _ in range(steps):
        x = m.A @ x + m.B @ u
        size = max(size, float(np.abs(x).max(initial=0.0)))
    error = float(np.abs(once - x).max(initial=0.0)) / (size or 1.0)
    return Resampled(found, "zoh", steps, error, _judged(error))
