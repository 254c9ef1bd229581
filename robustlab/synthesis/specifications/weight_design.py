r"""Weights of a mixed-sensitivity problem from specifications or from a measured noise, and whether they contradict.

.. math:: \|W_1 S\|_\infty \le 1, \quad \|W_2 K S\|_\infty \le 1, \quad \|W_3 T\|_\infty \le 1

All are proper, stable and minimum phase.

References
----------
Skogestad, Postlethwaite, *Multivariable Feedback Control* (2005), sections 2.8.2, 2.8.3, 5.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robustlab import checks
from robustlab.arrays import AnyArray
from robustlab.errors import InputError, told_as
from robustlab.linear_analysis.frequency import default_grid, frequency_response
from robustlab.norms import bilinear_to_discrete
from robustlab.shown import Facts, Shown, number
from robustlab.statespace import StateSpaceModel, append, as_model, real_array, series
from robustlab.synthesis.problem.performance_limits import performance_limits
from robustlab.uncertainty.covering.overbound import Overbound, overbound

SLACK = 1e-9  # a weight may ask for this much more than the check allows before it is called a conflict
POINTS = 600  # frequencies of the check between those of the models


@told_as("performance_weight")
def performance_weight(bandwidth: float, error: float = 1e-3, peak: float = 2.0, order: int = 1) -> StateSpaceModel:
    r"""Weight on the sensitivity S: ``|W1 S| <= 1`` keeps S below ``error`` at low frequency and below ``peak``
    everywhere.

    .. math:: W_1(s) = \left(\frac{s / M^{1/k} + \omega_B}{s + \omega_B A^{1/k}}\right)^k

    Parameters
    ----------
    bandwidth
        omega_B in rad/s: where the asymptote of ``1/|W1|`` crosses one.
    error
        A: largest steady-state error (0 < A < 1). An exact integrator (A = 0) has no stabilising controller in this
        problem.
    peak
        M: largest peak of the sensitivity (> 1).
    order
        k: slope of the weight below the bandwidth in units of 20 dB a decade.

    Returns
    -------
    StateSpaceModel
        W1 of one channel with ``order`` states.

    Raises
    ------
    InputError
        Numbers out of their ranges.

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

    ``error``: epsilon: largest error above the corner, as a share of the reference.
    ``corner``: omega_c in rad/s below which the error has to fall with the frequency.
    ``steady``: epsilon_0: largest steady-state error (0 < epsilon_0 < epsilon).

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


@told_as("control_weight")
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

    Returns
    -------
    StateSpaceModel
        W2 of one channel, a constant or of first order.

    Raises
    ------
    InputError
        Numbers out of their ranges.
    """
    where = "control weight"
    _positive(where, limit=limit)
    if bandwidth is None:
        return StateSpaceModel(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), [[1 / limit]])
    _positive(where, bandwidth=bandwidth, roll_off=roll_off)
    if roll_off <= 1:
        raise InputError(where, f"roll_off is {roll_off:g}", "more than 1")
    return _lead(roll_off / limit, roll_off * bandwidth / limit, roll_off * bandwidth)


@told_as("complementary_weight")
def complementary_weight(
    bandwidth: float, peak: float = 2.0, roll_off: float = 1e-3, order: int = 1
) -> StateSpaceModel:
    r"""Weight on the complementary sensitivity T: ``|W3 T| <= 1`` keeps T below ``peak`` and makes it fall above
    ``bandwidth``.

    .. math:: W_3(s) = \left(\frac{s + \omega_T / M^{1/k}}{A^{1/k} s + \omega_T}\right)^k

    Parameters
    ----------
    bandwidth
        omega_T in rad/s: where the asymptote of ``1/|W3|`` crosses one.
    peak
        M: largest T at low frequency (> 1).
    roll_off
        A: smallest T demanded at high frequency (0 < A < 1); keeps the weight proper.
    order
        k: slope above the bandwidth in units of -20 dB a decade.

    Returns
    -------
    StateSpaceModel
        W3 of one channel with ``order`` states.

    Raises
    ------
    InputError
        Numbers out of their ranges.

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


@told_as("makeweight")
def makeweight(
    low_gain: float, through: float | tuple[float, float], high_gain: float, dt: float = 0.0, order: int = 1
) -> StateSpaceModel:
    r"""Weight with given gains at zero and infinite frequency and at one frequency between, as MATLAB's makeweight.

    .. math:: W(s) = \left(\frac{h^{1/k} s + l^{1/k} p}{s + p}\right)^k, \qquad |W(j\omega_c)| = c

    Parameters
    ----------
    low_gain, high_gain
        l and h, positive; of a discrete weight h is the gain at the Nyquist frequency.
    through
        ``omega_c``, the frequency in rad/s at which the gain is 1, or ``(omega_c, c)`` for the gain c there, between
        the other two.
    dt
        Sample time in s of a discrete weight (Tustin's rule, exact at omega_c); 0 for a continuous one.
    order
        k: how steep.

    Returns
    -------
    StateSpaceModel
        Of one channel with ``order`` states.

    Raises
    ------
    InputError
        Gains that are not positive, the middle one not between the others, a frequency not below pi / dt.

    Examples
    --------
    >>> W = makeweight(100.0, (2.0, 1.0), 0.1)
    >>> float(W.dc_gain()[0, 0]), round(float(abs(frequency_response(W, [2.0])[0, 0, 0])), 12), float(W.D[0, 0])
    (100.0, 1.0, 0.1)

    MATLAB's form with the frequency at which the gain is 1:

    >>> round(float(abs(makeweight(100.0, 1.0, 0.5)(1j)[0, 0])), 12)
    1.0
    """
    where = "makeweight"
    try:
        omega, gain = (float(x) for x in (through if np.ndim(through) else (through, 1.0)))  # pyright: ignore
    except (TypeError, ValueError):
        raise InputError(where, f"through is {through!r}", "a frequency, or a frequency and the gain there") from None
    _positive(where, low_gain=low_gain, high_gain=high_gain, frequency=omega, gain=gain)
    if not min(low_gain, high_gain) < gain < max(low_gain, high_gain):
        raise InputError(where, f"gain {gain:g} at {omega:g} rad/s", f"between {low_gain:g} and {high_gain:g}")
    _order(where, order)
    if dt:
        _positive(where, dt=dt)
        if not omega * dt < np.pi:
            raise InputError(where, f"frequency {omega:g} rad/s", f"below pi / dt = {np.pi / dt:g} rad/s")
        omega = 2 / dt * np.tan(omega * dt / 2)
    low, middle, high = (x ** (1 / order) for x in (low_gain, gain, high_gain))
    pole = omega * np.sqrt((middle - high) / (low - middle) * ((middle + high) / (low + middle)))
    factor = _lag(high, (low - high) * pole, pole)
    return _repeated(bilinear_to_discrete(factor, dt) if dt else factor, order)


def _lead(gain: float, zero: float, pole: float) -> StateSpaceModel:
    """``(gain s + zero) / (s + pole)``."""
    return _lag(gain, zero - gain * pole, pole)


def _lag(gain: float, residue: float, pole: float) -> StateSpaceModel:
    """``gain + residue / (s + pole)`` with input and output gains of equal size."""
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


@dataclass(frozen=True)
class Conflict(Shown):
    """Weights that no controller can satisfy together with gamma = 1.

    Attributes
    ----------
    gamma
        No controller reaches less.
    frequency
        Where, in rad/s; NaN where a zero or pole of the plant makes it.
    text
        What contradicts what, and what to relax.
    """

    gamma: float
    frequency: float
    text: str

    def facts(self) -> Facts:
        """What a person wants to read, as (label, text)."""
        return [
            ("gamma", f"at least {number(self.gamma)}"),
            ("at", number(self.frequency, "rad/s")),
            ("said", self.text),
        ]

    def to_json(self) -> dict[str, Any]:
        """All attributes."""
        return vars(self).copy()


@dataclass(frozen=True, eq=False)
class DesignWeights(Shown):
    """Weights for `robustlab.mixsyn` with what contradicts among them.

    Attributes
    ----------
    W1, W2, W3
        On S, K S and T; None where nothing was specified.
    conflicts
        Largest gamma first; empty where none was found.
    """

    W1: StateSpaceModel | None
    W2: StateSpaceModel | None
    W3: StateSpaceModel | None
    conflicts: tuple[Conflict, ...]

    def facts(self) -> Facts:
        """The weights, and what they ask for that cannot be had."""
        given = [(name, W) for name, W in (("W1, on S", self.W1), ("W2, on K S", self.W2), ("W3, on T", self.W3)) if W]
        sizes = [(name, f"{W.n_states} states, {W.n_outputs} x {W.n_inputs}") for name, W in given]
        return [*sizes, ("contradiction", "; ".join(c.text for c in self.conflicts) or "none was found")]


@told_as("design_weights")
def design_weights(
    *,
    bandwidth: float | None = None,
    error: float = 1e-3,
    peak: float = 2.0,
    order: int = 1,
    control_limit: float | None = None,
    noise_from: float | None = None,
    noise_gain: float = 1e-2,
    roll_off: int = 1,
    plant: Any = None,
) -> DesignWeights:
    r"""W1, W2 and W3 from what a loop is to do, with a check whether it can.

    Parameters
    ----------
    bandwidth
        Frequency in rad/s up to which disturbances are to be reduced (W1); no W1 where left out.
    error, peak, order
        Largest steady-state error as a share of the reference, largest peak of S, and the slope of S below the
        bandwidth in units of 20 dB a decade.
    control_limit
        Largest gain from reference to control, in control units per output unit (W2); no W2 where left out.
    noise_from, noise_gain, roll_off
        Frequency in rad/s from which noise and unmodelled dynamics are to be suppressed (W3: where T has to be below
        one), the smallest T ever asked for, and the slope of T in units of -20 dB a decade; no W3 where left out.
    plant
        With it, its size, its right-half-plane zeros and its poles are checked against the weights.

    Returns
    -------
    DesignWeights
        The weights, each on one channel, and what contradicts among them.

    Raises
    ------
    InputError
        Nothing specified, or numbers out of their ranges.

    References
    ----------
    Skogestad, Postlethwaite 2005, sections 2.8.2, 2.8.3, 5.

    Examples
    --------
    >>> good = design_weights(bandwidth=1.0, noise_from=20.0)
    >>> good.conflicts
    ()
    >>> bad = design_weights(bandwidth=10.0, noise_from=2.0)
    >>> print(bad.conflicts[0].text)
    gamma >= 1.62 at 4.47 rad/s: W1 asks for |S| <= 0.436, W3 for |T| <= 0.437, but S + T = 1; let T fall later
    """
    if bandwidth is None and control_limit is None and noise_from is None:
        raise InputError("design_weights", "nothing specified", "a bandwidth, a control limit or a noise frequency")
    W1 = None if bandwidth is None else performance_weight(bandwidth, error, peak, order)
    W2 = None if control_limit is None else control_weight(control_limit)
    W3 = None if noise_from is None else complementary_weight(noise_from, peak, noise_gain, roll_off)
    return DesignWeights(W1, W2, W3, tuple(check_weights(W1, W2, W3, plant=plant)))


@told_as("check_weights")
def check_weights(W1: Any = None, W2: Any = None, W3: Any = None, *, plant: Any = None) -> list[Conflict]:
    r"""Contradictions among weights on S, K S and T: lower bounds of gamma above one, largest first.

    At each frequency S v + T v = v and T = G (K S), so that for every controller

    .. math:: \gamma^2 \ge \frac{a^2 b^2}{a^2 + b^2}, \qquad a = \underline\sigma(W_1), \quad
        b^2 = \underline\sigma(W_3)^2 + \underline\sigma(W_2)^2 / \bar\sigma(G)^2

    and at the plant's right-half-plane zeros and poles the interpolation bounds of
    `PerformanceLimits.gamma_bounds`. The frequencies are a grid: each bound holds, the largest may lie between.

    Parameters
    ----------
    W1, W2, W3
        Stable models (or numbers), each on one channel or on all of them; None where there is none.
    plant
        Model G; without it only W1 and W3 are compared.

    Returns
    -------
    list of Conflict
        Largest gamma first; empty where none was found.

    Raises
    ------
    InputError
        A weight that is not stable.

    Examples
    --------
    >>> from robustlab.synthesis.specifications.weight_design import performance_weight
    >>> right = StateSpaceModel([[-1.0]], [[1.0]], [[-2.0]], [[1.0]])  # (s - 1) / (s + 1)
    >>> [round(c.gamma, 4) for c in check_weights(performance_weight(2.0), plant=right)]
    [2.495]
    """
    weights = [None if w is None else _model(w, name) for w, name in ((W1, "W1"), (W2, "W2"), (W3, "W3"))]
    g = None if plant is None else as_model(plant, "check_weights: plant")
    found: list[Conflict] = []
    given = [m for m in (*weights, g) if m is not None and m.n_states]
    if weights[0] is not None and (weights[2] is not None or (g is not None and weights[1] is not None)):
        grid = np.concatenate([default_grid(m, 100, 1.0) for m in given] or [np.ones(1)])
        between = np.geomspace(grid.min(), grid.max(), POINTS)
        pointwise = _pointwise(weights, g, np.unique(np.concatenate([grid, between])))
        if pointwise is not None:
            found.append(pointwise)
    if g is not None:
        limits = performance_limits(g)
        channels = [_on_outputs(w, g.n_outputs) for w in (weights[0], weights[2])]
        for bound in limits.gamma_bounds(*channels):
            if bound.gamma > 1 + SLACK:
                relax = "lower the bandwidth" if bound.weight == "W1" else "let T fall later"
                found.append(Conflict(bound.gamma, float("nan"), f"{bound.text}; {relax}"))
    return sorted(found, key=lambda c: -c.gamma)


def _pointwise(weights: list[StateSpaceModel | None], g: StateSpaceModel | None, omega: AnyArray) -> Conflict | None:
    a = smallest_gain(weights[0], omega)
    t, effort = smallest_gain(weights[2], omega), np.zeros(len(omega))
    if weights[1] is not None and g is not None:
        keep = _off_poles(g, omega)
        omega, a, t = omega[keep], a[keep], t[keep]
        size = np.linalg.svd(frequency_response(g, omega), compute_uv=False)[:, 0]
        effort = smallest_gain(weights[1], omega) / np.maximum(size, 1e-300)
    b = np.hypot(t, effort)
    bound = a * b / np.hypot(a, b)
    k = int(np.argmax(bound))
    if bound[k] <= 1 + SLACK:
        return None
    asked = [f"W1 asks for |S| <= {1 / a[k]:.3g}"]
    if t[k] > effort[k]:
        asked.append(f"W3 for |T| <= {1 / t[k]:.3g}, but S + T = 1; let T fall later")
    else:
        asked.append(f"W2 for |T| <= {1 / effort[k]:.3g} through |K S|, but S + T = 1; allow more control")
    return Conflict(
        float(bound[k]), float(omega[k]), f"gamma >= {bound[k]:.3g} at {omega[k]:.3g} rad/s: {', '.join(asked)}"
    )


def _off_poles(g: StateSpaceModel, omega: AnyArray) -> NDArray[np.bool_]:
    if g.is_discrete or not g.n_states:
        return np.ones(len(omega), dtype=bool)
    return np.abs(1j * omega[:, None] - g.poles()).min(axis=1) > 1e-9 * omega


def smallest_gain(W: StateSpaceModel | None, omega: AnyArray) -> AnyArray:
    """Smallest singular value over frequency, (n_omega,); 0 without a weight, or with fewer outputs than inputs."""
    if W is None or W.n_outputs < W.n_inputs:
        return np.zeros(len(omega))
    return np.linalg.svd(frequency_response(W, omega), compute_uv=False)[:, -1]


def _on_outputs(W: StateSpaceModel | None, n: int) -> StateSpaceModel | None:
    """The weight on n channels; None where it has another number of them, or is not square."""
    if W is not None and (W.n_inputs, W.n_outputs) == (1, 1) and n > 1:
        W = append(*(W.renamed([f"u{i}"], [f"y{i}"]) for i in range(n)))
    return W if W is not None and W.n_inputs == W.n_outputs == n else None


def _model(weight: Any, name: str) -> StateSpaceModel:
    if isinstance(weight, (int, float, np.number)):
        weight = StateSpaceModel([], [], [], [[float(weight)]], where=f"check_weights: {name}")
    model = as_model(weight, f"check_weights: {name}")
    if not model.is_stable():
        raise InputError(
            f"check_weights: {name}", f"spectral abscissa {model.spectral_abscissa():.3g}", "a stable weight"
        )
    return model


@told_as("noise_weight")
def noise_weight(
    samples: ArrayLike, dt: float, *, order: int = 4, tolerance: float = 0.3, bands: int = 8, segments: int = 16
) -> Overbound:
    r"""Stable minimum-phase weight that white noise of unit intensity passes to look like a measured noise.

    .. math:: |W(j\omega)|^2 \ge \hat S(\omega)

    with the two-sided spectral density :math:`\hat S` in unit squared per Hz by Welch's method, averaged in bands;
    close above it. What the record's length and rate cannot show, below the first and above the last band, is taken as
    it is there. The estimate scatters by about one over the root of the number of averages: W bounds the estimate, not
    the truth.

    Parameters
    ----------
    samples
        Measured noise, shape (n,), without signal; its mean is taken away.
    dt
        Sample time in s.
    order, tolerance
        Largest order of W, and the excess over the estimate at which a lower one is good enough.
    bands
        Averaging bands a decade.
    segments
        How many half-overlapping segments the record is cut into: more scatter less and resolve less.

    Returns
    -------
    Overbound
        ``weight`` is continuous; evidence on a grid ten times finer.

    Raises
    ------
    InputError
        Too few samples, NaN, a constant record.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> fit = noise_weight(rng.standard_normal(20000), 0.01)  # density 1 * 0.01 per Hz
    >>> bool(0.09 < abs(frequency_response(fit.weight, [30.0])[0, 0, 0]) < 0.13)
    True
    """
    from scipy.signal import welch

    x = real_array("samples", samples, 1, "noise_weight")
    if not np.isfinite(dt) or dt <= 0:
        raise InputError("noise_weight: dt", f"{dt} s", "a positive sample time in s")
    for name, value in (("bands", bands), ("segments", segments)):
        checks.whole(f"noise_weight: {name}", value, 1)
    length = int(2 * len(x) // (segments + 1))
    if length < 32:
        raise InputError("noise_weight", f"{len(x)} samples", f"at least {16 * (segments + 1)} for {segments} segments")
    if np.ptp(x) <= 1e-12 * np.abs(x).max(initial=0.0):
        raise InputError("noise_weight", "a constant record", "noise")
    frequency, density = welch(x, 1 / dt, nperseg=length, detrend="linear")
    # One-sided to two-sided; the lines that detrending and the Nyquist fold spoil are left out.
    omega, density = 2 * np.pi * frequency[2:-1], density[2:-1] / 2
    band = np.floor(bands * np.log10(omega / omega[0])).astype(int)
    count = np.bincount(band)
    centre = np.exp(np.bincount(band, np.log(omega))[count > 0] / count[count > 0])
    mean = np.bincount(band, density)[count > 0] / count[count > 0]
    return overbound(centre, np.sqrt(mean), order, tolerance)
