"""Stable minimum-phase weights above a bound, as close as their order allows."""

# min gamma with b <= |w| <= gamma b. The log of |w|^2 = N(x) / D(x), x = omega^2, in corner frequencies and dampings of
# N and D is fitted to that of the bound by least squares, then in p-norms of growing p, which end near minimax.

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from robustlab import checks
from robustlab.arrays import Array
from robustlab.budget import one_thread
from robustlab.display import Displayable, Facts, number
from robustlab.errors import InputError, NoTrustworthyNumber, error_context
from robustlab.linear_analysis.frequency import frequency_response
from robustlab.norms import bilinear_to_discrete
from robustlab.realisations import cascade
from robustlab.result import Status
from robustlab.statespace import StateSpaceModel

NORMS = (8, 64)  # exponents p of the norms of the error, one after the other
FINER_GRID = 10  # points of the evaluation grid for each one of the fit

Bound = Callable[[Array], Array]

ABOVE = 1e-12  # rounding in a frequency response


@dataclass(frozen=True, eq=False)
class Overbound(Displayable):
    """A weight above a bound, with its evaluation grid."""

    weight: StateSpaceModel  #: Stable, minimum phase, with as many zeros as poles: its inverse is stable, too
    #: The grid in rad/s, ten times finer than that of the fit; the bound and ``|w|`` on it
    omega: Array
    bound: Array
    magnitude: Array
    status: Status  #: CONVERGED where the excess is within the tolerance, else INACCURATE

    @property
    def order(self) -> int:
        """Return the weight's number of states."""
        return self.weight.n_states

    @property
    def excess(self) -> float:
        """Return the largest ``|w| / bound - 1`` on the grid."""
        return float((self.magnitude / self.bound).max()) - 1.0

    @property
    def lowest(self) -> float:
        """Return the smallest ``|w| / bound - 1`` on the grid: not negative."""
        return float((self.magnitude / self.bound).min()) - 1.0

    def lifted(self, factor: float, status: Status | None = None) -> Overbound:
        """Return the weight times a factor."""
        w = self.weight
        weight = StateSpaceModel(w.A, w.B, factor * w.C, factor * w.D, w.dt)
        return Overbound(weight, self.omega, self.bound, factor * self.magnitude, status or self.status)

    def facts(self) -> Facts:
        return [
            ("order", str(self.order)),
            ("above the bound", f"{100 * self.lowest:.3g} % .. {100 * self.excess:.3g} %"),
            ("frequencies", f"{number(self.omega[0])} .. {number(self.omega[-1], 'rad/s')}, {len(self.omega)} points"),
        ]

    def to_json(self) -> dict[str, Any]:
        derived = {"order": self.order, "excess": self.excess, "lowest": self.lowest}
        return {"type": "Overbound", "weight": self.weight, **derived, **vars(self)}


@error_context("overbound")
@one_thread()
def overbound(
    omega: ArrayLike,
    bound: ArrayLike,
    order: int = 4,
    tolerance: float = 0.1,
    *,
    exact: Bound | None = None,
    dt: float = 0.0,
) -> Overbound:
    """Return the weight of least order up to ``order`` above a bound and within the tolerance of it.

    Parameters
    ----------
    omega
        Increasing positive frequencies in rad/s, (n,), n >= 2; below the Nyquist frequency of a discrete weight.
    bound
        Positive values, (n,), interpolated in log-log scales and constant outside the frequencies.
    order
        Largest number of states, 0..12.
    tolerance
        The excess at which a lower order suffices.
    exact
        The bound as a function of frequencies, if known between the given ones.
    dt
        Sample time in s of the weight; 0: continuous.

    Returns
    -------
    Overbound
        The weight, stable and minimum-phase, with its excess over the bound.

    Raises
    ------
    InputError
        Frequencies or values that are not finite, positive, increasing; an order out of its range.
    NoTrustworthyNumber
        No weight could be computed (values over too many decades).

    Examples
    --------
    >>> omega = np.logspace(-2, 2, 60)
    >>> fit = overbound(omega, abs((1j * omega + 0.1) / (1j * omega + 2)), tolerance=0.01)
    >>> fit.order, fit.weight.is_stable(), bool(0 <= fit.lowest <= fit.excess <= 0.01)
    (1, True, True)
    """
    w, b = _checked(omega, bound, order, tolerance, dt)
    known: Bound = exact or (lambda x: np.exp(np.interp(np.log(x), np.log(w), np.log(b))))
    steps = np.arange(1, FINER_GRID) / FINER_GRID
    refined = np.exp((np.log(w[:-1, None]) + np.diff(np.log(w))[:, None] * steps).ravel())
    fine = np.unique(np.concatenate([w, refined]))
    target = known(fine)
    if not (np.isfinite(target).all() and (target > 0).all()):
        raise InputError("overbound: exact", "values that are not finite and positive", "a positive bound")
    # A discrete weight is computed on the warped frequency axis of the bilinear map.
    axis = 2.0 / dt * np.tan(0.5 * dt * fine) if dt else fine
    best: Overbound | None = None
    for n in range(order + 1):
        found = _fitted(n, axis, target)
        weight = bilinear_to_discrete(found, dt) if dt else found
        size = np.abs(frequency_response(weight, fine)[:, 0, 0])
        made = Overbound(weight, fine, target, size, Status.INACCURATE).lifted((1.0 + ABOVE) / (size / target).min())
        if best is None or made.excess < best.excess:
            best = made
        if best.excess <= tolerance:
            best = replace(best, status=Status.CONVERGED)
            break
    if best is None or best.lowest < 0:
        found_text = f"no weight of order {order} above a bound of {np.ptp(np.log10(b)):.3g} decades"
        raise NoTrustworthyNumber("overbound", found_text, None, "fewer decades of frequency, or another order")
    return best


def _checked(omega: ArrayLike, bound: ArrayLike, order: int, tolerance: float, dt: float) -> tuple[Array, Array]:
    w, b = np.asarray(omega, dtype=np.float64), np.asarray(bound)
    if b.dtype.kind not in "biuf":
        raise InputError("overbound: bound", f"dtype {b.dtype}", "real numbers")
    if w.ndim != 1 or w.shape != b.shape or len(w) < 2:
        raise InputError("overbound", f"shapes {w.shape} and {b.shape}", "two vectors of the same length, at least 2")
    if not (np.isfinite(w).all() and w[0] > 0 and (np.diff(w) > 0).all()):
        raise InputError("overbound: omega", "frequencies that do not increase", "finite, positive, increasing")
    bad = np.flatnonzero(~(np.isfinite(b) & (b > 0)))
    if len(bad):
        raise InputError("overbound: bound", f"{b[bad[0]]} at {w[bad[0]]:g} rad/s", "finite positive values")
    checks.whole("overbound: order", order, 0, 12)
    checks.number("overbound: tolerance", tolerance, "a positive number", above=0)
    if dt < 0 or (dt and w[-1] * dt >= np.pi):
        raise InputError("overbound: omega", f"{w[-1]:g} rad/s", f"below the Nyquist frequency {np.pi / dt:g} rad/s")
    return w, b


# --- a curve of given order above a bound -----------------------------------------------------------------------------


def _fitted(n: int, w: Array, b: Array) -> StateSpaceModel:
    """Return a weight of order n with a small largest error of its log-magnitude, from several starts."""
    from scipy.optimize import least_squares

    unit, mean = float(np.sqrt(w[0] * w[-1])), float(np.exp(np.log(b).mean()))
    if n == 0:
        return StateSpaceModel([], [], [], [[mean]])
    x, wanted = (w / unit) ** 2, 2 * np.log(b / mean)
    count, pairs = n - n // 2, n // 2
    span = np.log(x[0]), np.log(x[-1])
    wide = np.concatenate([np.full(count, 5.0), np.zeros(pairs)])
    low = np.concatenate([np.full(count, span[0]), np.full(pairs, np.log(1e-12))]) - wide
    high = np.concatenate([np.full(count, span[1]), np.full(pairs, np.log(1e3))]) + wide
    box = np.array([[*low, *low, -np.inf], [*high, *high, np.inf]])

    def improved(start: Array, points: slice, half: float, level: float = 1.0) -> Any:
        def residual(p: Array) -> Array:
            miss = _miss(p, x[points], wanted[points], pairs)[0] / level
            return np.sign(miss) * np.abs(miss) ** half

        def slopes(p: Array) -> Array:
            miss, columns = _miss(p, x[points], wanted[points], pairs)
            return half / level * np.abs(miss / level)[:, None] ** (half - 1) * columns

        settings: Any = {"jac": slopes, "bounds": box, "max_nfev": 60}
        with np.errstate(over="ignore"):  # of a step that is too long, which is rejected
            return least_squares(residual, start, **settings)

    starts = []
    for zeros, poles in _starts(x, wanted, count):
        start = np.concatenate([zeros, np.zeros(pairs), poles, np.zeros(pairs), [0.0]])
        start[-1] = -float(_miss(start, x, wanted, pairs)[0].mean())
        starts.append(improved(start, slice(None, None, FINER_GRID), 1.0))
    p = min(starts, key=lambda found: found.cost).x
    for norm in NORMS:
        p = improved(p, slice(None), norm / 2, float(np.abs(_miss(p, x, wanted, pairs)[0]).max()) or 1.0).x
    zeros, poles = (_roots(part, pairs, unit) for part in np.split(p[:-1], 2))
    return anonymous(cascade(zeros, poles, mean * float(np.exp(0.5 * p[-1])), 0.0, "overbound"))


def _starts(x: Array, wanted: Array, count: int) -> list[tuple[Array, Array]]:
    """Return corners of N and of D (log): alternating, poles at the peak, and by the curvature of the bound."""
    at = np.log(x)
    steps = np.linspace(at[0], at[-1], 2 * count + 2)[1:-1]
    peak = np.full(count, at[int(np.argmax(wanted))]) + 1e-2 * np.arange(count)
    bend = np.gradient(np.gradient(wanted, at), at) * np.gradient(at)
    shares = (np.cumsum(np.maximum(part, 0.0) + 1e-9) for part in (bend, -bend))
    zeros, poles = (np.interp((np.arange(count) + 0.5) / count * share[-1], share, at) for share in shares)
    return [(steps[::2], steps[1::2]), (steps[1::2], steps[::2]), (steps[::2], peak), (zeros, poles)]


def _miss(p: Array, x: Array, wanted: Array, pairs: int) -> tuple[Array, Array]:
    """Return the error of ``log |w|^2`` and its derivative; p: log of corners and dampings of N, of D, of the gain.

    In x = omega^2 a pair is ``(x - c)^2 + 2 e^a c x``, a single corner ``x + c``.
    """
    value, columns = p[-1] - wanted, []
    for part, sign in zip(np.split(p[:-1], 2), (1.0, -1.0), strict=True):
        corner, bend = np.exp(part[: len(part) - pairs]), np.exp(part[len(part) - pairs :])
        c, s = corner[:pairs], x[:, None]
        pair, single = (s - c) ** 2 + 2 * bend * c * s, s + corner[pairs:]
        value = value + sign * (np.log(pair).sum(axis=1) + np.log(single).sum(axis=1))
        columns += [2 * c * (c - s + bend * s) / pair, corner[pairs:] / single, 2 * bend * c * s / pair]
        columns[-3:] = [sign * column for column in columns[-3:]]
    return value, np.hstack([*columns, np.ones((len(x), 1))])


def _roots(part: Array, pairs: int, unit: float) -> list[complex]:
    """Return the stable roots of pairs and single corners."""
    corner = unit * np.exp(0.5 * part[: len(part) - pairs])
    damping = np.sqrt(2 * np.exp(part[len(part) - pairs :]))
    found = [complex(-c) for c in corner[pairs:]]
    for c, d in zip(corner[:pairs].tolist(), damping.tolist(), strict=True):
        root = c * (-0.5 * d - np.sqrt(complex(0.25 * d * d - 1)))
        found += [root, root.conjugate() if root.imag else c * c / root]
    return found


def anonymous(model: StateSpaceModel) -> StateSpaceModel:
    return StateSpaceModel(model.A, model.B, model.C, model.D, model.dt)
