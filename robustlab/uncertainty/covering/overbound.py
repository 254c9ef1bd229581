"""Stable minimum-phase weights that lie above a bound, as close as their order allows.

Boyd, Vandenberghe, *Convex Optimization* (2004), section 4.2.5 (quasi-convex problems).
"""

# min gamma with b <= |w| <= gamma b. With |w|^2 = N(x) / D(x), x = omega^2, this is for each fixed gamma a linear
# programme in the coefficients of N and D (N - b^2 D >= 0, gamma^2 b^2 D - N >= 0, D > 0), so that bisection on gamma
# finds the best there is, as far as floating point solves the programme. The weight follows by spectral
# factorisation. N and D are written in orthonormal combinations of q / (x + q), relative to the last feasible N and
# D, which keeps the programme well scaled over many decades.

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from robustlab import checks
from robustlab.arrays import Array
from robustlab.budget import one_thread
from robustlab.errors import InputError, NoTrustworthyNumber, told_as
from robustlab.linear_analysis.frequency import frequency_response
from robustlab.norms import bilinear_to_discrete
from robustlab.result import Status
from robustlab.shown import Facts, Shown, number
from robustlab.statespace import StateSpaceModel, series

WEIGHT_LEVEL = 1e-3  # bisection on log(gamma) ends here; far below the tolerances that weights are asked for
WEIGHT_ROUNDS = 8  # rounds in which the points where the weight came out below the bound are added to the programme
# The grid on which a weight is judged has so many points for one of the fit's: fewer miss peaks between them.
FINER_GRID = 10
WEIGHT_RESTARTS = 4  # bisections with new bases
# The smallest D, relative to its scale: keeps poles off the imaginary axis; larger ones cost sharpness.
LEAST_DENOMINATOR = 1e-6
BASIS_RATIO = 2.0  # ratio of neighbouring q of a basis, at least: closer ones are hardly independent

Bound = Callable[[Array], Array]

ABOVE = 1e-12  # rounding in a frequency response


@dataclass(frozen=True, eq=False)
class Overbound(Shown):
    """A weight above a bound, with the grid on which that was checked.

    Attributes
    ----------
    weight
        Stable, minimum phase, with as many zeros as poles: its inverse is stable, too.
    order
        Its number of states.
    excess
        Largest ``|w| / bound - 1`` on the grid.
    lowest
        Smallest ``|w| / bound - 1`` there: not negative.
    omega, bound, magnitude
        The grid in rad/s, ten times finer than that of the fit; the bound and ``|w|`` on it.
    status
        CONVERGED where the excess is within the tolerance, INACCURATE where the order does not allow it.
    """

    weight: StateSpaceModel
    order: int
    excess: float
    lowest: float
    omega: Array
    bound: Array
    magnitude: Array
    status: Status

    def facts(self) -> Facts:
        return [
            ("order", str(self.order)),
            ("above the bound", f"{100 * self.lowest:.3g} % .. {100 * self.excess:.3g} %"),
            ("frequencies", f"{number(self.omega[0])} .. {number(self.omega[-1], 'rad/s')}, {len(self.omega)} points"),
        ]

    def to_json(self) -> dict[str, Any]:
        return {"type": "Overbound", **vars(self)}


@told_as("overbound")
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
    """The weight of least order up to ``order`` that lies above a bound and within the tolerance of it.

    Parameters
    ----------
    omega
        Increasing positive frequencies in rad/s, (n,), n >= 2; below the Nyquist frequency of a discrete weight.
    bound
        Positive values, (n,); straight lines between them in log-log scales. Below the first and above the last
        frequency the bound stays as it is at the ends.
    order
        Largest number of states, 0..12.
    tolerance
        The excess at which a lower order is good enough.
    exact
        The bound at any frequencies, where it is known between the given ones.
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
        No weight could be computed (values that span too many decades).

    Examples
    --------
    >>> omega = np.logspace(-2, 2, 60)
    >>> fit = overbound(omega, abs((1j * omega + 0.1) / (1j * omega + 2)), tolerance=0.01)
    >>> fit.order, fit.weight.is_stable(), bool(0 <= fit.lowest <= fit.excess <= 0.01)
    (1, True, True)
    """
    w, b = _checked(omega, bound, order, tolerance, dt)
    known: Bound = exact or (lambda x: np.exp(np.interp(np.log(x), np.log(w), np.log(b))))
    steps = np.arange(FINER_GRID) / FINER_GRID
    refined = np.exp((np.log(w[:-1, None]) + np.diff(np.log(w))[:, None] * steps).ravel())
    fine = np.unique(np.concatenate([w, refined]))
    target = known(fine)
    if not (np.isfinite(target).all() and (target > 0).all()):
        raise InputError("overbound: exact", "values that are not finite and positive", "a positive bound")
    # A discrete weight is found for the bent frequency axis of the bilinear map.
    bend: Callable[[Array], Array] = (lambda x: 2.0 / dt * np.tan(0.5 * dt * x)) if dt else (lambda x: x)
    best: Overbound | None = None
    for n in range(order + 1):
        found = _of_order(n, bend(w), b, bend(fine), target)
        if found is None:
            continue
        weight = bilinear_to_discrete(found, dt) if dt else found
        made = _judged(weight, n, fine, target, known, tolerance)
        if best is None or made.excess < best.excess:
            best = made
        if best.excess <= tolerance:
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
    if not (np.isfinite(w).all() and (w > 0).all() and (np.diff(w) > 0).all()):
        raise InputError("overbound: omega", "frequencies that do not increase", "finite, positive, increasing")
    if not (np.isfinite(b).all() and (b > 0).all()):
        k = int(np.flatnonzero(~(np.isfinite(b) & (b > 0)))[0])
        raise InputError("overbound: bound", f"{b[k]} at {w[k]:g} rad/s", "finite positive values")
    checks.whole("overbound: order", order, 0, 12)
    checks.number("overbound: tolerance", tolerance, "a positive number", above=0)
    if dt < 0 or (dt and w[-1] * dt >= np.pi):
        raise InputError("overbound: omega", f"{w[-1]:g} rad/s", f"below the Nyquist frequency {np.pi / dt:g} rad/s")
    return w, b


def _judged(weight: StateSpaceModel, n: int, fine: Array, target: Array, known: Bound, tolerance: float) -> Overbound:
    """The weight, scaled so that it touches the bound from above on the grid (but for what rounding could take)."""
    ratio = np.abs(frequency_response(weight, fine)[:, 0, 0]) / target
    near = _around_lows(ratio, fine)
    ratio = np.append(ratio, np.abs(frequency_response(weight, near)[:, 0, 0]) / known(near))
    lift = (1.0 + ABOVE) / float(ratio.min())
    raised = StateSpaceModel(weight.A, weight.B, lift * weight.C, lift * weight.D, weight.dt)
    size = np.abs(frequency_response(raised, fine)[:, 0, 0])
    ratio = size / target
    excess, lowest = float(ratio.max()) - 1.0, float(ratio.min()) - 1.0
    status = Status.CONVERGED if excess <= tolerance else Status.INACCURATE
    return Overbound(raised, n, excess, lowest, fine, target, size, status)


def _around_lows(ratio: Array, fine: Array) -> Array:
    """Points between those of the grid, close to the local minima of the ratio."""
    inner = (ratio[1:-1] <= ratio[:-2]) & (ratio[1:-1] <= ratio[2:]) & (ratio[1:-1] < 1.001 * ratio.min())
    lows = 1 + np.flatnonzero(inner)
    if not len(lows):
        return fine[:1]
    return np.unique(np.concatenate([np.geomspace(fine[k - 1], fine[k + 1], 41) for k in lows]))


# --- the quasi-convex problem ----------------------------------------------------------------------------------------


def _of_order(n: int, w: Array, b: Array, fine: Array, target: Array) -> StateSpaceModel | None:
    """Best weight of order n over the grid w and over the points of the fine grid that it turns out to need."""
    if n == 0:
        return StateSpaceModel([], [], [], [[float(target.max())]])
    points, values = w, b
    best: tuple[float, StateSpaceModel] | None = None
    for _ in range(WEIGHT_ROUNDS):
        model = _minimax(n, points, values)
        if model is None:
            break
        ratio = np.abs(frequency_response(model, fine)[:, 0, 0]) / target
        spread = float(ratio.max() / ratio.min())
        if best is None or spread < best[0]:
            best = spread, model
        padded = np.concatenate([[np.inf], ratio, [np.inf]])
        new = np.flatnonzero((ratio <= padded[:-2]) & (ratio <= padded[2:]) & (ratio < 1.0))  # lowest, below the bound
        points, index = np.unique(np.concatenate([points, fine[new]]), return_index=True)
        values = np.concatenate([values, target[new]])[index]
        if ratio.min() > 1.0 - 0.1 * WEIGHT_LEVEL:
            break
    return None if best is None else best[1]


def _minimax(n: int, w: Array, b: Array) -> StateSpaceModel | None:
    """Bisection on gamma, again and again with the programme scaled by the last feasible N and D."""
    unit, mean = float(np.exp(0.5 * (np.log(w[0]) + np.log(w[-1])))), float(np.exp(np.log(b).mean()))
    x, square = (w / unit) ** 2, (b / mean) ** 2
    near, reached = _corners(n, x, square), float(np.log(b.max() / b.min())) + WEIGHT_LEVEL
    best: _Factors | None = None
    for _ in range(WEIGHT_RESTARTS):
        low, high, before = 0.0, reached, reached
        trial = reached if best is None else 0.5 * reached
        while high - low > WEIGHT_LEVEL:
            found = _programme(x, square, np.exp(2 * trial), near)
            if found is None:
                low = trial
            else:
                best, near, high = found, found, trial
            trial = 0.5 * (low + high)
        reached = high
        if reached > 0.98 * before - WEIGHT_LEVEL and best is not None:
            break
    if best is None:
        return None
    return _sections(unit * _left(best.zeros), unit * _left(best.poles), mean * np.sqrt(best.gain))


class _Factors(NamedTuple):
    """Roots in x of N and of D, and N / D at infinity."""

    zeros: Any
    poles: Any
    gain: float


def _corners(n: int, x: Array, square: Array) -> _Factors:
    """Roots of N and D with which log N / D comes near the bound in least squares: where the search begins."""
    from scipy.optimize import least_squares

    wanted, pairs, odd = np.log(square), n // 2, n % 2
    span, count = (np.log(x[0]), np.log(x[-1])), pairs + odd
    steps = np.linspace(*span, 2 * count + 2)[1:-1]
    peak = np.full(count, np.log(x[int(np.argmax(wanted))])) + 1e-2 * np.arange(count)
    starts = [(steps[::2], steps[1::2]), (steps[1::2], steps[::2]), (steps[::2], peak)]
    low = np.concatenate([np.full(2 * count, span[0] - 5.0), np.full(2 * pairs, np.log(1e-5)), [-np.inf]])
    high = np.concatenate([np.full(2 * count, span[1] + 5.0), np.full(2 * pairs, np.log(1e3)), [np.inf]])

    def parts(p: Array) -> list[tuple[Array, Array]]:
        bends = p[2 * count : 2 * count + 2 * pairs]
        return [(p[:count], bends[:pairs]), (p[count : 2 * count], bends[pairs:])]

    def residual(p: Array) -> Array:
        logs = [_log_factors(x, r, a, pairs) for r, a in parts(p)]
        return p[-1] + logs[0] - logs[1] - wanted

    best = None
    for zeros, poles in starts:
        begin = np.concatenate([zeros, poles, np.zeros(2 * pairs), [0.0]])
        begin[-1] = -float(residual(begin).mean())
        found = least_squares(residual, begin, bounds=(low, high), max_nfev=30)
        if best is None or found.cost < best.cost:
            best = found
    assert best is not None
    (r_n, a_n), (r_d, a_d) = parts(best.x)
    return _Factors(_factor_roots(r_n, a_n, pairs), _factor_roots(r_d, a_d, pairs), float(np.exp(best.x[-1])))


def _log_factors(x: Array, r: Array, a: Array, pairs: int) -> Array:
    size = np.exp(r)
    two = (x[:, None] - size[:pairs]) ** 2 + 2.0 * np.exp(a) * size[:pairs] * x[:, None]
    return np.log(two).sum(axis=1) + np.log(x[:, None] + size[pairs:]).sum(axis=1)


def _factor_roots(r: Array, a: Array, pairs: int) -> Any:
    size, bend = np.exp(r).astype(np.complex128), np.exp(a) - 1.0
    half = np.sqrt(bend.astype(np.complex128) ** 2 - 1.0)
    return np.concatenate([size[:pairs] * (half - bend), size[:pairs] * (-half - bend), -size[pairs:]])


class _Basis(NamedTuple):
    """Polynomials of degree n in x, divided by a given one of size 1 or so at every point, in orthonormal columns."""

    values: Array
    to_sums: Array
    q: Array


def _basis(x: Array, roots: Any) -> _Basis:
    size = np.abs(roots)
    q = np.exp(np.linspace(np.log(size.min()), np.log(size.max()), len(size)))
    if len(q) > 1 and q[-1] < BASIS_RATIO ** (len(q) - 1) * q[0]:
        q = np.sqrt(q[0] * q[-1]) * BASIS_RATIO ** (np.arange(len(q)) - 0.5 * (len(q) - 1))
    relative = np.exp(np.log(x[:, None] + q).sum(axis=1) - np.log(np.abs(x[:, None] - roots)).sum(axis=1))
    sums = np.hstack([np.ones((len(x), 1)), q / (x[:, None] + q)]) * relative[:, None]
    orthonormal, upper = np.linalg.qr(sums)
    root = np.sqrt(len(x))
    return _Basis(root * orthonormal, root * np.linalg.inv(upper), q)


def _programme(x: Array, square: Array, level: float, near: _Factors) -> _Factors | None:
    """N and D between the bound and gamma times the bound, or None where there are none."""
    # The margin of both inequalities, relative to the terms that they compare, is maximised: 0 or more is feasible.
    extra = np.zeros(0)
    for _ in range(WEIGHT_ROUNDS):
        points = np.concatenate([x, extra])
        n, d = _basis(points, near.zeros), _basis(points, near.poles)
        up, down = (np.log(np.abs(x[:, None] - roots)).sum(axis=1) for roots in (near.zeros, near.poles))
        coefficients = _solved(n, d, square, level, near.gain * np.exp(up - down) / square, len(x))
        if coefficients is None:
            return None
        parts = [_roots(basis, c) for basis, c in zip((n, d), coefficients, strict=True)]
        wrong = [
            r.real
            for part in parts
            if part is not None
            for r in part[0]
            if r.real >= 0 and abs(r.imag) <= 1e-9 * abs(r)
        ]
        if any(part is None for part in parts):
            return None
        if not wrong:
            (zeros, top), (poles, bottom) = (part for part in parts if part is not None)
            return _Factors(zeros, poles, near.gain * top / bottom) if top > 0 and bottom > 0 else None
        extra = np.concatenate([extra, wrong])
    return None


def _solved(n: _Basis, d: _Basis, square: Array, level: float, shape: Array, m: int) -> tuple[Array, Array] | None:
    """Coefficients of N and D in their bases; ``shape`` is what N / D b^2 is where both quotients are 1."""
    from scipy.optimize import linprog

    k = n.values.shape[1]
    f_n, f_d, one = shape[:, None] * n.values[:m], d.values[:m], np.ones((m, 1))
    size = 1.0 / (1.0 + shape)[:, None]
    above, under = np.hstack([-f_n, f_d, one]) * size, np.hstack([f_n / level, -f_d, one]) * size
    none = np.zeros((len(n.values), k))
    positive = np.vstack([np.hstack([-n.values, none]), np.hstack([none, -d.values])])
    # at x = 0 and at infinity
    last = [np.concatenate([[1.0], np.zeros(k - 1)]), np.ones(k)]
    ends = np.vstack(
        [np.hstack([v @ n.to_sums, np.zeros(k)]) / _peak(v @ n.to_sums) for v in last]
        + [np.hstack([np.zeros(k), v @ d.to_sums]) / _peak(v @ d.to_sums) for v in last]
    )
    signs = np.vstack([positive, -ends])
    rows = np.vstack([above, under, np.hstack([signs, np.zeros((len(signs), 1))])])
    right = np.concatenate([np.zeros(2 * m), np.full(len(signs), -LEAST_DENOMINATOR)])
    norm = np.concatenate([np.zeros(k), d.values.mean(axis=0), [0.0]])[None]
    cost = np.append(np.zeros(2 * k), -1.0)
    limits = [(None, None)] * (2 * k) + [(-1.0, 1.0)]
    answer = linprog(cost, rows, right, norm, [1.0], limits, method="highs")
    if not answer.success or answer.x is None or not np.isfinite(answer.x).all() or answer.x[-1] < 0:
        return None
    return answer.x[:k], answer.x[k : 2 * k]


def _peak(row: Array) -> float:
    return float(np.abs(row).max())


def _roots(basis: _Basis, coefficients: Array) -> tuple[Any, float] | None:
    """Roots in x, and the leading coefficient of the quotient; None where rounding took them."""
    sums, q = basis.to_sums @ coefficients, basis.q
    if sums[0] == 0:
        return None
    values = np.linalg.eigvals(-np.diag(q) - np.outer(np.ones(len(q)), sums[1:] * q) / sums[0])
    if not np.isfinite(values).all() or (values == 0).any():
        return None
    return values, float(sums[0])


def _left(x: Any) -> Any:
    """The s with ``s^2 = -x`` and negative real part."""
    s = np.sqrt(-x.astype(np.complex128))
    return np.where(s.real > 0, -s, s)


def _sections(zeros: Any, poles: Any, gain: float) -> StateSpaceModel:
    """Gain at infinity times a cascade of biproper sections of first and second order."""
    pairs = list(zip(_polynomials(zeros), _polynomials(poles), strict=True))
    model = StateSpaceModel([], [], [], [[gain]])
    for numerator, denominator in pairs:
        model = series(_section(numerator, denominator), anonymous(model))
    return anonymous(model)


def _polynomials(roots: Any) -> list[Array]:
    """Real monic polynomials of degree two (the last of degree one where the number is odd), sorted by size."""
    upper = sorted((r for r in roots if r.imag > 1e-12 * abs(r)), key=abs)
    real = sorted((r.real for r in roots if abs(r.imag) <= 1e-12 * abs(r)), key=abs)
    single = [real.pop()] if len(real) % 2 else []
    made = [np.array([1.0, -2.0 * r.real, abs(r) ** 2]) for r in upper]
    made += [np.array([1.0, -(a + b), a * b]) for a, b in zip(real[::2], real[1::2], strict=True)]
    made.sort(key=lambda p: p[2])
    return [*made, *(np.array([1.0, -a]) for a in single)]


def _section(numerator: Array, denominator: Array) -> StateSpaceModel:
    """``n(s) / d(s)`` of degree one or two, both monic, balanced in its own frequency."""
    rest = (numerator - denominator)[1:]
    if len(rest) == 1:
        size = np.sqrt(abs(rest[0])) or 1.0
        return StateSpaceModel([[-denominator[1]]], [[size]], [[rest[0] / size]], [[1.0]])
    rate = float(np.sqrt(denominator[2]))
    a = np.array([[0.0, rate], [-rate, -denominator[1]]])
    return StateSpaceModel(a, [[0.0], [1.0]], [[rest[1] / rate, rest[0]]], [[1.0]])


def anonymous(model: StateSpaceModel) -> StateSpaceModel:
    """The same model without names and units of its signals."""
    return StateSpaceModel(model.A, model.B, model.C, model.D, model.dt)
