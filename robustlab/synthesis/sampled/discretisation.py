r"""From continuous to discrete time by formula, and back.

====================  ==================================================================================================
``tustin``            :math:`s = (2/T) (z - 1)/(z + 1)`: keeps stability and the H-infinity norm, bends frequencies
``tustin-prewarp``    :math:`s = (\omega_0 / \tan(\omega_0 T / 2)) (z - 1)/(z + 1)`: exact at :math:`\omega_0`
``zoh``               exact at the samples for an input held over the sample time (a D/A converter)
``foh``               exact at the samples for an input that is linear from sample to sample
``impulse``           T times the samples of the impulse response (no direct term)
``matched``           poles and zeros by :math:`z = e^{s T}`, zeros at infinity to z = -1, equal gain at zero frequency
====================  ==================================================================================================
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any, Literal

import numpy as np

from robustlab.arrays import AnyArray
from robustlab.checks import choice, number
from robustlab.errors import InputError, NoTrustworthyNumber, error_context
from robustlab.linear_analysis.frequency import frequency_response
from robustlab.linear_analysis.zeros import transmission_zeros
from robustlab.norms import bilinear_to_continuous, bilinear_to_discrete
from robustlab.realisations import cascade
from robustlab.statespace import StateSpaceModel, as_model

Method = Literal["tustin", "tustin-prewarp", "zoh", "foh", "impulse", "matched"]
SampledMethod = Literal["auto", "direct", "tustin", "tustin-prewarp", "zoh", "foh", "impulse", "matched"]
Hold = Literal["zoh", "tustin"]
HOLDS: tuple[Hold, ...] = ("zoh", "tustin")
METHODS: tuple[Method, ...] = ("tustin", "tustin-prewarp", "zoh", "foh", "impulse", "matched")

# Two sampled modes closer than this, relative to their modulus, count as one mode.
MERGED = 1e-6
# Accuracy to which the poles and zeros of a matched model must reproduce its response.
MATCHED = 1e-6
# Accuracy to which the exponential of a logarithm must reproduce the matrix.
CLOSE = 1e-10
EPS = float(np.finfo(float).eps)
LARGEST = 300.0  # exponent of e up to which products of matched poles and zeros do not overflow


@error_context("discretise")
def by_formula(model: Any, dt: float, method: str, prewarp: float | None = None) -> StateSpaceModel:
    """Discretise a model without a plant; see `robustlab.discretise`."""
    m = as_model(getattr(model, "K", model), "discretise")
    if m.is_discrete:
        raise InputError("discretise", f"the model has dt = {m.dt:g} s", "a continuous model (dt = 0)")
    number("discretise: dt", dt, "a positive sample time in s", above=0)
    choice("discretise: method", method, METHODS)
    if (prewarp is None) == (method == "tustin-prewarp"):
        found = f"method {method!r} with prewarp={prewarp}"
        raise InputError("discretise", found, "prewarp with 'tustin-prewarp' alone")
    if prewarp is not None and not 0 < prewarp < np.pi / dt:
        expected = f"between 0 and the Nyquist frequency {np.pi / dt:g}"
        raise InputError("discretise", f"prewarp is {prewarp:g} rad/s", expected)
    if method == "matched":
        found = _matched(m, dt)
    elif method in ("tustin", "tustin-prewarp"):
        found = bilinear_to_discrete(m, 2 * float(np.tan(prewarp * dt / 2)) / prewarp if prewarp else dt)
    else:
        found = _sampled(m, dt, method)
    return StateSpaceModel(
        found.A, found.B, found.C, found.D, dt, m.inputs, m.outputs,
        m.states if found.n_states == m.n_states else None,
        m.operating_point if method in ("zoh", "impulse") else None, where=f"discretise ({method})",
    )  # fmt: skip


def _sampled(m: StateSpaceModel, dt: float, method: str) -> StateSpaceModel:
    """Discretise by one matrix exponential; the state of ``foh`` is ``x_k`` less its part from ``u_k``."""
    from scipy.signal import cont2discrete

    if method == "impulse" and m.D.any():
        raise InputError("discretise", "a direct term with method 'impulse'", "a model without one, or another method")
    with np.errstate(over="ignore", invalid="ignore"):
        made: Any = cont2discrete((m.A, m.B, m.C, m.D), dt, method=method)
    a, b, c, d = made[:4]
    if not (np.isfinite(a).all() and np.isfinite(b).all()):
        fastest = m.spectral_abscissa()
        found = f"e^(A dt) overflows: a pole at {fastest:.6g} 1/s grows too much in dt = {dt:g} s"
        if fastest < 0:
            rate = float(np.abs(m.poles()).max())
            found = f"e^(A dt) overflows on its way: rates up to {rate:.3g} 1/s in dt = {dt:g} s"
        raise NoTrustworthyNumber(f"discretise ({method})", found)
    return StateSpaceModel(a, b, c, d)


# --- back to continuous time, and to another sample time --------------------------------------------------------------


@error_context("d2c")
def d2c(model: Any, method: Hold = "zoh") -> StateSpaceModel:
    r"""Compute a continuous model of a discrete one.

    .. math:: \begin{bmatrix} A & B \\ 0 & 0 \end{bmatrix}
              = \frac{1}{T} \log \begin{bmatrix} A_d & B_d \\ 0 & I \end{bmatrix}

    Parameters
    ----------
    model
        Discrete StateSpaceModel with sample time T in s, controller or python-control object.
    method
        ``"zoh"``: the model whose samples under a held input these are, with its modes below the Nyquist frequency.
        ``"tustin"``: the inverse of Tustin's rule.

    Returns
    -------
    StateSpaceModel
        With the signals of the model; with ``"zoh"`` also its states and its operating point.

    Raises
    ------
    InputError
        A continuous model, an unknown method.
    NoTrustworthyNumber
        ``"zoh"``: a pole on the closed negative real axis, or a logarithm that does not reproduce the model to 1e-10.
        ``"tustin"``: a pole at z = -1.

    References
    ----------
    Higham, *Functions of Matrices* (2008), theorem 1.31.

    Examples
    --------
    >>> d2c(StateSpaceModel([[0.5]], [[0.5]], [[1.0]], [[0.0]], dt=0.1)).A.round(6)
    array([[-6.931472]])
    """
    m = as_model(getattr(model, "K", model), "d2c")
    if not m.is_discrete:
        raise InputError("d2c", "the model is continuous (dt = 0)", "a discrete one", "rl.discretise makes one")
    if choice("d2c: method", method, HOLDS) == "tustin":
        return replace(bilinear_to_continuous(m), inputs=m.inputs, outputs=m.outputs, states=m.states)
    from scipy.linalg import expm, logm

    poles, n = m.poles(), m.n_states
    real = poles[np.abs(poles.imag) <= 1e-12 * np.abs(poles)].real
    sizes = np.linalg.svd(m.A, compute_uv=False)
    singular = n and sizes[-1] <= n * EPS * sizes[0]
    if singular or (real <= 0).any():
        found = (
            f"a pole at z = {0.0 if singular else real.min():.6g}: no continuous model of this order has such samples"
        )
        hint = "method='tustin' maps this pole"
        raise NoTrustworthyNumber("d2c (zoh)", found, "poles off the closed negative real axis", hint)
    held = np.block([[m.A, m.B], [np.zeros((m.n_inputs, n)), np.eye(m.n_inputs)]])
    with warnings.catch_warnings():  # scipy's own estimate; the exponential below decides
        warnings.simplefilter("ignore", RuntimeWarning)
        rate: Any = logm(held)
    size = np.abs(held).max(initial=1.0)
    off = np.abs(expm(rate.real) - held).max(initial=0.0) / size if np.isfinite(rate).all() else np.inf
    if not off <= CLOSE:
        raise NoTrustworthyNumber("d2c (zoh)", f"the exponential of log A gives A back to {off:.1e} of its size only")
    rate = rate.real / m.dt
    return replace(m, A=rate[:n, :n], B=rate[:n, n:], dt=0.0)


# --- matched poles and zeros ------------------------------------------------------------------------------------------


def _matched(m: StateSpaceModel, dt: float) -> StateSpaceModel:
    if (m.n_inputs, m.n_outputs) != (1, 1):
        found = f"method 'matched' with {m.n_inputs} inputs and {m.n_outputs} outputs"
        raise InputError("discretise", found, "one of each", "take 'tustin' for several channels")
    if not m.n_states or not (m.B.any() and m.C.any()):
        return StateSpaceModel([], [], [], m.D)
    poles, zeros = m.poles(), transmission_zeros(m, complete=True)
    both = np.concatenate([poles, zeros])
    s = 1.7 * max(float(np.abs(both).max()), 1e-6 / dt)  # right of all poles, on the real axis

    def product(at: AnyArray) -> AnyArray:
        return np.prod(at[:, None] - zeros, axis=1) / np.prod(at[:, None] - poles, axis=1)

    value = (m.D + m.C @ np.linalg.solve(s * np.eye(m.n_states) - m.A, m.B))[0, 0]
    gain = value / product(np.array([s]))[0]
    omega = np.abs(both) * 1.3 + 1e-3 * s
    truth = frequency_response(m, omega)[:, 0, 0]
    off = float(np.abs(gain * product(1j * omega) / truth - 1).max()) if truth.all() else np.inf
    if not off <= MATCHED:
        raise NoTrustworthyNumber("discretise (matched)", f"poles and zeros give the response back to {off:.1e} only")
    growth = float(np.maximum(both.real, 0.0).sum()) * dt
    if growth > LARGEST:
        found = f"poles and zeros that grow by e^{growth:.3g} in dt = {dt:g} s"
        raise NoTrustworthyNumber("discretise (matched)", found, None, "a shorter sample time, or another method")
    z_poles, z_zeros = np.exp(poles * dt), np.append(np.exp(zeros * dt), -np.ones(len(poles) - len(zeros)))
    # Equal gain at s = 0, z = 1; next to it on the real axis if there is a pole or a zero.
    at = 0.0 if np.abs(both).min() > 1e-9 * s else 1e-3 / dt
    z = np.exp(at * dt)
    k = float((gain * product(np.array([at]))[0] * np.prod(z - z_poles) / np.prod(z - z_zeros)).real)
    return cascade(_paired(z_zeros), _paired(z_poles), k, dt, "discretise (matched)")


def _paired(roots: AnyArray) -> AnyArray:
    """Return roots of a real polynomial as exact conjugate pairs and real ones."""
    least = 1e-12 * np.abs(roots)
    upper = roots[np.imag(roots) > least]
    return np.concatenate([upper, np.conj(upper), np.real(roots[np.abs(np.imag(roots)) <= least])])


# --- pathological sampling --------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class MergedModes:
    """Two modes of a plant with one sampled mode: pathological sampling."""

    modes: tuple[complex, complex]  # the two eigenvalues in rad/s
    multiple: int  # their difference in sampling frequencies
    # True if the modes decay: then they are only uncontrollable, else no digital controller stabilises the plant.
    stable: bool

    def __str__(self) -> str:
        one, two = (f"{pole.real:.6g}{pole.imag:+.6g}j" for pole in self.modes)
        effect = "they cannot be controlled one by one" if self.stable else "no digital controller moves both"
        multiple = f"differ by {self.multiple} sampling frequencies"
        return f"pathological sampling: modes {one} and {two} rad/s {multiple}; {effect}"

    def to_json(self) -> dict[str, Any]:
        return {**vars(self), "text": str(self)}


def merged_modes(model: StateSpaceModel, dt: float) -> tuple[MergedModes, ...]:
    r"""Return pairs of different modes with :math:`e^{\lambda_i T} = e^{\lambda_j T}` up to 1e-6."""
    found = list[MergedModes]()
    for one, two in combinations(model.poles().astype(complex).tolist(), 2):
        multiple = round((one - two).imag * dt / (2 * np.pi))
        if multiple and abs((one - two) * dt - 2j * np.pi * multiple) <= MERGED:
            found.append(MergedModes((one, two), abs(multiple), one.real < 0))
    return tuple(found)
