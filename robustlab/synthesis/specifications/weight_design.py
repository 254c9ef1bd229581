"""Weights of a mixed-sensitivity problem from specifications: proper, stable and minimum phase.

Skogestad, Postlethwaite, *Multivariable Feedback Control*, 2005, section 2.8.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from robustlab.checks import number, whole
from robustlab.errors import InputError, error_context
from robustlab.norms import bilinear_to_discrete
from robustlab.statespace import StateSpaceModel, append, as_model, series


@error_context("performance_weight")
def performance_weight(bandwidth: float, error: float = 1e-3, peak: float = 2.0, order: int = 1) -> StateSpaceModel:
    r"""Return a weight on the sensitivity S: ``|W1 S| <= 1`` bounds S by ``peak``, at low frequency by ``error``.

    .. math:: W_1(s) = \left(\frac{s / M^{1/k} + \omega_B}{s + \omega_B A^{1/k}}\right)^k

    Parameters
    ----------
    bandwidth, order
        omega_B in rad/s, at which the asymptote of ``1/|W1|`` crosses one; k: slope below it in units of 20 dB a
        decade, and number of states.
    error, peak
        A: largest steady-state error (0 < A < 1; an integrator, A = 0, has no stabilising controller in this problem);
        M: largest peak of the sensitivity (> 1).

    Returns
    -------
    StateSpaceModel
        Of one channel, as all weights here.

    Raises
    ------
    InputError
        Numbers out of their ranges.

    Examples
    --------
    >>> W1 = performance_weight(bandwidth=10.0, error=0.01, peak=2.0)
    >>> round(float(W1.dc_gain()[0, 0]), 9), float(W1.D[0, 0])
    (100.0, 0.5)
    """
    where = "performance weight"
    _positive(where, order, bandwidth=bandwidth, error=error, peak=peak)
    if error >= 1 or peak <= 1:
        raise InputError(where, f"error is {error:g}, peak is {peak:g}", "error < 1 < peak")
    return _lead(1 / peak ** (1 / order), bandwidth, bandwidth * error ** (1 / order), order)


def error_weight(error: float, corner: float, steady: float = 1e-3) -> StateSpaceModel:
    r"""Return a weight on the error of shaped references: ``error`` above the corner, decreasing below it.

    .. math:: W_1(s) = \frac{1}{\varepsilon} \frac{s + \omega_c}{s + \omega_c \varepsilon_0 / \varepsilon}

    epsilon: the largest error above the corner omega_c, relative to the reference; below it the error falls with the
    frequency to the largest steady-state error epsilon_0.
    """
    where = "error weight"
    _positive(where, error=error, corner=corner, steady=steady)
    if steady >= error:
        raise InputError(where, f"steady is {steady:g}, error is {error:g}", "steady < error")
    return _lead(1 / error, corner / error, corner * steady / error)


@error_context("control_weight")
def control_weight(limit: float, bandwidth: float | None = None, roll_off: float = 100.0) -> StateSpaceModel:
    r"""Return a weight on the control effort K S: ``|W2 K S| <= 1`` bounds K S by ``limit``, less above ``bandwidth``.

    .. math:: W_2(s) = \frac{1}{L} \qquad\text{or}\qquad W_2(s) = \frac{1}{L} \frac{s/\omega_c + 1}{s/(r \omega_c) + 1}

    Parameters
    ----------
    limit, bandwidth, roll_off
        L: largest gain from reference to control, in control units per output unit; omega_c in rad/s above which the
        control falls by 20 dB a decade (default: a constant weight); r: total reduction at high frequency (> 1).

    Returns
    -------
    StateSpaceModel
        The weight, of one channel.

    Raises
    ------
    InputError
        Numbers out of their ranges.
    """
    where = "control weight"
    _positive(where, limit=limit)
    if bandwidth is None:
        return StateSpaceModel([], [], [], [[1 / limit]])
    _positive(where, bandwidth=bandwidth, roll_off=roll_off)
    if roll_off <= 1:
        raise InputError(where, f"roll_off is {roll_off:g}", "more than 1")
    return _lead(roll_off / limit, roll_off * bandwidth / limit, roll_off * bandwidth)


@error_context("complementary_weight")
def complementary_weight(
    bandwidth: float, peak: float = 2.0, roll_off: float = 1e-3, order: int = 1
) -> StateSpaceModel:
    r"""Return a weight on the complementary sensitivity T: ``|W3 T| <= 1`` bounds T by ``peak``, less above bandwidth.

    .. math:: W_3(s) = \left(\frac{s + \omega_T / M^{1/k}}{A^{1/k} s + \omega_T}\right)^k

    Parameters
    ----------
    bandwidth, order
        omega_T in rad/s, at which the asymptote of ``1/|W3|`` crosses one; k: slope above it in units of -20 dB a
        decade, and number of states.
    peak, roll_off
        M: largest T at low frequency (> 1); A: bound of T at high frequency (0 < A < 1), which makes the weight proper.

    Returns
    -------
    StateSpaceModel
        The weight, of one channel.

    Raises
    ------
    InputError
        Numbers out of their ranges.
    """
    where = "complementary weight"
    _positive(where, order, bandwidth=bandwidth, peak=peak, roll_off=roll_off)
    if roll_off >= 1 or peak <= 1:
        raise InputError(where, f"roll_off is {roll_off:g}, peak is {peak:g}", "roll_off < 1 < peak")
    a, m = roll_off ** (1 / order), peak ** (1 / order)
    return _lead(1 / a, bandwidth / m / a, bandwidth / a, order)


@error_context("makeweight")
def makeweight(
    low_gain: float, through: float | tuple[float, float], high_gain: float, dt: float = 0.0, order: int = 1
) -> StateSpaceModel:
    r"""Return a weight with given gains at zero, infinite and one intermediate frequency, as MATLAB's makeweight.

    .. math:: W(s) = \left(\frac{h^{1/k} s + l^{1/k} p}{s + p}\right)^k, \qquad |W(j\omega_c)| = c

    Parameters
    ----------
    low_gain, through, high_gain
        l and h, positive; of a discrete weight h is the gain at the Nyquist frequency. ``omega_c``, the frequency in
        rad/s at which the gain is 1, or ``(omega_c, c)`` for the gain c there, between the other two.
    dt, order
        Sample time in s of a discrete weight (Tustin's rule, exact at omega_c), 0 for a continuous one; k: slope of the
        weight in units of 20 dB a decade, and number of states.

    Returns
    -------
    StateSpaceModel
        The weight, of one channel.

    Raises
    ------
    InputError
        Gains that are not positive, the middle one not between the others, a frequency not below pi / dt.

    Examples
    --------
    >>> W = makeweight(100.0, (2.0, 1.0), 0.1)
    >>> float(W.dc_gain()[0, 0]), round(float(abs(W(2j)[0, 0])), 12), float(W.D[0, 0])
    (100.0, 1.0, 0.1)
    """
    where = "makeweight"
    try:
        omega, gain = (float(x) for x in (through if np.ndim(through) else (through, 1.0)))  # pyright: ignore
    except (TypeError, ValueError):
        raise InputError(where, f"through is {through!r}", "a frequency, or a frequency and the gain there") from None
    _positive(where, order, low_gain=low_gain, high_gain=high_gain, frequency=omega, gain=gain)
    if not min(low_gain, high_gain) < gain < max(low_gain, high_gain):
        raise InputError(where, f"gain {gain:g} at {omega:g} rad/s", f"between {low_gain:g} and {high_gain:g}")
    if dt:
        _positive(where, dt=dt)
        if not omega * dt < np.pi:
            raise InputError(where, f"frequency {omega:g} rad/s", f"below pi / dt = {np.pi / dt:g} rad/s")
        omega = 2 / dt * np.tan(omega * dt / 2)
    low, middle, high = (x ** (1 / order) for x in (low_gain, gain, high_gain))
    pole = omega * np.sqrt((middle - high) / (low - middle) * ((middle + high) / (low + middle)))
    return _lead(high, low * pole, pole, order, dt)


def in_time_of_plant(weight: StateSpaceModel, dt: float, where: str) -> StateSpaceModel:
    """Return a weight with the plant's sample time, which one without states can have."""
    if not weight.n_states and weight.dt != dt:
        weight = StateSpaceModel(weight.A, weight.B, weight.C, weight.D, dt)
    if weight.dt != dt:
        raise InputError(where, f"dt is {weight.dt:g} s", f"{dt:g} s, as the plant")
    return weight


def _lead(gain: float, zero: float, pole: float, order: int = 1, dt: float = 0.0) -> StateSpaceModel:
    """Return ``((gain s + zero) / (s + pole))^order`` with input and output gains of equal size."""
    residue = zero - gain * pole
    root = np.sqrt(abs(residue))
    factor = StateSpaceModel([[-pole]], [[root]], [[np.sign(residue) * root]], [[gain]])
    factor = result = bilinear_to_discrete(factor, dt) if dt else factor
    for _ in range(order - 1):
        result = series(result, factor)
    return result


def _positive(where: str, order: int = 1, **numbers: float) -> None:
    for name, value in numbers.items():
        number(f"{where}: {name}", value, "a positive number", above=0)
    whole(f"{where}: order", order, 1, 10)


# --- given weights ----------------------------------------------------------------------------------------------------


def stable_weight(given: Any, n: int, dt: float, where: str, hint: str | None = None) -> StateSpaceModel:
    """Return the weight as a stable model with n inputs, in the plant's time."""
    weight = weight_on_channels(given, n, dt, where, hint)
    if not weight.is_stable():
        hint = "no controller can move a weight's pole; make an integrator a slow lag: s + omega_B * A instead of s"
        raise InputError(where, f"spectral abscissa is {weight.spectral_abscissa():.3g}", "a stable weight", hint)
    if weight.n_inputs != n:
        raise InputError(where, f"{weight.n_inputs} inputs", f"{n}, or one input and one output")
    return weight


def weight_on_channels(given: Any, n: int, dt: float, where: str, hint: str | None = None) -> StateSpaceModel:
    """Return a weight (a number, a matrix or a model) in the plant's time; one of one channel is used on all n."""
    if isinstance(given, (int, float, list, tuple, np.ndarray, np.number)):
        try:
            gain = np.atleast_2d(given)
            if gain.dtype.kind in "bc":
                raise InputError(where, f"{gain.dtype} numbers", "a model or real numbers", hint)
            gain = gain.astype(float)
        except (TypeError, ValueError):
            raise InputError(where, f"a {type(given).__name__} that is no matrix", "a model or numbers", hint) from None
        given = StateSpaceModel([], [], [], gain, where=where)
    weight = as_model(given, where)
    if not weight.n_states and weight.dt != dt:
        weight = StateSpaceModel(weight.A, weight.B, weight.C, weight.D, dt)
    if weight.dt != dt:
        raise InputError(where, f"dt is {weight.dt:g} s", f"{dt:g} s, as the plant")
    if n > 1 and (weight.n_inputs, weight.n_outputs) == (1, 1):
        weight = append(*(weight.renamed([f"u{i}"], [f"y{i}"]) for i in range(n)))
    return weight
