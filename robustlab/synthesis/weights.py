"""Weights of mixed-sensitivity problems from specifications; all are proper, stable and minimum phase."""

from __future__ import annotations

import numpy as np

from robustlab.errors import InputError
from robustlab.statespace import StateSpaceModel, series

__all__ = ["complementary_weight", "control_weight", "error_weight", "performance_weight"]


def performance_weight(bandwidth: float, error: float = 1e-3, peak: float = 2.0, order: int = 1) -> StateSpaceModel:
    r"""Weight on the sensitivity S: ``|W1 S| <= 1`` keeps S below ``error`` at low frequency and below ``peak``
    everywhere.

    .. math:: W_1(s) = \left(\frac{s / M^{1/k} + \omega_B}{s + \omega_B A^{1/k}}\right)^k

    Parameters
    ----------
    bandwidth
        omega_B in rad/s: where the asymptote of 1/|W1| crosses one.
    error
        A: largest steady-state error (0 < A < 1). An exact integrator (A = 0) has no stabilising controller in this
        problem.
    peak
        M: largest peak of the sensitivity (> 1).
    order
        k: slope of the weight below the bandwidth in units of 20 dB a decade.

    References
    ----------
    Skogestad, Postlethwaite 2005, section 2.8.2, eqs 2.105, 2.106.

    Examples
    --------
    >>> W1 = performance_weight(bandwidth=10.0, error=0.01, peak=2.0)
    >>> round(float(W1.dc_gain()[0, 0]), 9), float(W1.D[0, 0])
    (100.0, 0.5)
    """
    where = "performance weight"
    _positive(where, bandwidth=bandwidth, error=error, peak=peak)
    if error >= 1 or peak <= 1:
        raise InputError(where, f"error is {error:g}, peak is {peak:g}", "error < 1 < peak")
    _order(where, order)
    return _repeated(_lead(1 / peak ** (1 / order), bandwidth, bandwidth * error ** (1 / order)), order)


def error_weight(error: float, corner: float, steady: float = 1e-3) -> StateSpaceModel:
    r"""Weight on the error that shaped references leave: ``error`` above the corner, ever less below it.

    .. math:: W_1(s) = \frac{1}{\varepsilon} \frac{s + \omega_c}{s + \omega_c \varepsilon_0 / \varepsilon}

    Parameters
    ----------
    error
        epsilon: largest error above the corner, as a share of the reference.
    corner
        omega_c in rad/s below which the error has to fall with the frequency.
    steady
        epsilon_0: largest steady-state error (0 < epsilon_0 < epsilon).

    Examples
    --------
    >>> W1 = error_weight(error=0.04, corner=1.0, steady=1e-3)
    >>> round(float(W1.dc_gain()[0, 0]), 6), float(W1.D[0, 0])
    (1000.0, 25.0)
    """
    where = "error weight"
    _positive(where, error=error, corner=corner, steady=steady)
    if steady >= error:
        raise InputError(where, f"steady is {steady:g}, error is {error:g}", "steady < error")
    return _lead(1 / error, corner / error, corner * steady / error)


def control_weight(limit: float, bandwidth: float | None = None, roll_off: float = 100.0) -> StateSpaceModel:
    r"""Weight on the control effort K S: ``|W2 K S| <= 1`` keeps K S below ``limit``, and ever lower above
    ``bandwidth``.

    .. math:: W_2(s) = \frac{1}{L} \qquad\text{or}\qquad W_2(s) = \frac{1}{L} \frac{s/\omega_c + 1}{s/(r \omega_c) + 1}

    Parameters
    ----------
    limit
        L: largest gain from reference to control, in control units per output unit.
    bandwidth
        omega_c in rad/s above which the control has to fall by 20 dB a decade; a constant weight where left out.
    roll_off
        r: by how much in the end (> 1).
    """
    where = "control weight"
    _positive(where, limit=limit)
    if bandwidth is None:
        return StateSpaceModel(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), [[1 / limit]])
    _positive(where, bandwidth=bandwidth, roll_off=roll_off)
    if roll_off <= 1:
        raise InputError(where, f"roll_off is {roll_off:g}", "more than 1")
    return _lead(roll_off / limit, roll_off * bandwidth / limit, roll_off * bandwidth)


def complementary_weight(
    bandwidth: float, peak: float = 2.0, roll_off: float = 1e-3, order: int = 1
) -> StateSpaceModel:
    r"""Weight on the complementary sensitivity T: ``|W3 T| <= 1`` keeps T below ``peak`` and makes it fall above
    ``bandwidth``.

    .. math:: W_3(s) = \left(\frac{s + \omega_T / M^{1/k}}{A^{1/k} s + \omega_T}\right)^k

    Parameters
    ----------
    bandwidth
        omega_T in rad/s: where the asymptote of 1/|W3| crosses one.
    peak
        M: largest T at low frequency (> 1).
    roll_off
        A: smallest T demanded at high frequency (0 < A < 1); keeps the weight proper.
    order
        k: slope above the bandwidth in units of -20 dB a decade.

    References
    ----------
    Skogestad, Postlethwaite 2005, section 2.8.3.
    """
    where = "complementary weight"
    _positive(where, bandwidth=bandwidth, peak=peak, roll_off=roll_off)
    if roll_off >= 1 or peak <= 1:
        raise InputError(where, f"roll_off is {roll_off:g}, peak is {peak:g}", "roll_off < 1 < peak")
    _order(where, order)
    a, m = roll_off ** (1 / order), peak ** (1 / order)
    return _repeated(_lead(1 / a, bandwidth / m / a, bandwidth / a), order)


def _lead(gain: float, zero: float, pole: float) -> StateSpaceModel:
    """``(gain s + zero) / (s + pole)`` with input and output gains of equal size."""
    residue = zero - gain * pole
    root = np.sqrt(abs(residue))
    return StateSpaceModel([[-pole]], [[root]], [[np.sign(residue) * root]], [[gain]])


def _repeated(factor: StateSpaceModel, order: int) -> StateSpaceModel:
    result = factor
    for _ in range(order - 1):
        result = series(result, factor)
    return result


def _positive(where: str, **numbers: float) -> None:
    for name, value in numbers.items():
        if not np.isfinite(value) or value <= 0:
            raise InputError(where, f"{name} is {value}", "a positive number")


def _order(where: str, order: int) -> None:
    if isinstance(order, bool) or order not in range(1, 11):
        raise InputError(where, f"order is {order}", "a whole number from 1 to 10")
