r"""Stable minimum-phase weights that lie above a bound, as close as their order allows.

Among all weights of order n the one is found whose largest ratio to the bound is least,

.. math:: \min \gamma \quad \text{with} \quad b(\omega) \le |w(j\omega)| \le \gamma\, b(\omega)

With :math:`|w|^2 = N(x) / D(x)`, :math:`x = \omega^2`, this is for each fixed :math:`\gamma` a linear programme in the
coefficients of N and D,

.. math:: N - b^2 D \ge 0, \qquad \gamma^2 b^2 D - N \ge 0, \qquad D > 0

so that bisection on :math:`\gamma` finds the best there is; the weight follows by spectral factorisation. N and D are
written as sums of :math:`q / (x + q)` with q near their own roots, which keeps the programme well scaled over many
decades.

References
----------
Boyd, Vandenberghe, *Convex Optimization* (2004), section 4.2.5 (quasi-convex problems); Balas, Chiang, Packard, Safonov,
*Robust Control Toolbox* (2005), the log-Chebyshev magnitude design; Březina 2010, section 4.2.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robustlab.errors import InputError, NoTrustworthyNumber
from robustlab.frequency import frequency_response
from robustlab.norms import bilinear_to_discrete
from robustlab.result import Status
from robustlab.statespace import StateSpaceModel, series

__all__ = ["Overbound", "overbound"]

Array = NDArray[np.float64]
Bound = Callable[[Array], Array]

# Bisection on log(gamma) ends here; far below the tolerances that weights are asked for.
LEVEL = 1e-3
# Rounds in which the points where the weight came out below the bound are added to the programme.
ROUNDS = 8
# The grid on which a weight is judged has so many points for one of the fit's.
FINER = 10
# Bisections with new bases.
RESTARTS = 4
# The smallest D, relative to its scale: keeps poles off the imaginary axis.
LEAST = 1e-7
# Rounding in a frequency response.
ABOVE = 1e-12


@dataclass(frozen=True, eq=False)
class Overbound:
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

    def to_json(self) -> dict[str, Any]:
        """All attributes."""
        return {"type": "Overbound", **vars(self)}


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
    known = _interpolated(w, b) if exact is None else exact
    fine = np.unique(np.concatenate([w, _refined(w)]))
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
        made = _judged(weight, n, fine, target, tolerance)
        if best is None or made.excess < best.excess:
            best = made
        if best.excess <= tolerance:
            break
    if best is None or best.lowest < 0:
        found_text = f"no weight of order {order} above a bound of {np.ptp(np.log10(b)):.3g} decades"
        raise NoTrustworthyNumber("overbound", found_text, None, "fewer decades of frequency, or another order")
    return best


def _checked(
    omega: ArrayLike, bound: ArrayLike, order: int, tolerance: float, dt: float
) -> tuple[Array, Array]:
    w, b = np.asarray(omega, dtype=np.float64), np.asarray(bound, dtype=np.float64)
    if w.ndim != 1 or w.shape != b.shape or len(w) < 2:
        raise InputError("overbound", f"shapes {w.shape} and {b.shape}", "two vectors of the same length, at least 2")
    if not (np.isfinite(w).all() and (w > 0).all() and (np.diff(w) > 0).all()):
        raise InputError("overbound: omega", "frequencies that do not increase", "finite, positive, increasing")
    if not (np.isfinite(b).all() and (b > 0).all()):
        k = int(np.flatnonzero(~(np.isfinite(b) & (b > 0)))[0])
        raise InputError("overbound: bound", f"{b[k]} at {w[k]:g} rad/s", "finite positive values")
    if isinstance(order, bool) or not isinstance(order, (int, np.integer)) or not 0 <= order <= 12:
        raise InputError("overbound: order", f"{order!r}", "a whole number from 0 to 12")
    if not 0 < tolerance < np.inf:
        raise InputError("overbound: tolerance", f"{tolerance}", "a positive number")
    if dt < 0 or (dt and w[-1] * dt >= np.pi):
        raise InputError("overbound: omega", f"{w[-1]:g} rad/s", f"below the Nyquist frequency {np.pi / dt:g} rad/s")
    return w, b


def _interpolated(w: Array, b: Array) -> Bound:
    return lambda x: np.exp(np.interp(np.log(x), np.log(w), np.log(b)))


def _refined(w: Array) -> Array:
    """FINER points for each step of the grid."""
    steps = np.arange(FINER) / FINER
    return np.exp((np.log(w[:-1, None]) + np.diff(np.log(w))[:, None] * steps).ravel())


def _judged(weight: StateSpaceModel, n: int, fine: Array, target: Array, tolerance: float) -> Overbound:
    """The weight, scaled so that it touches the bound from above on the grid (but for what rounding could take)."""
    size = np.abs(frequency_response(weight, fine)[:, 0, 0])
    ratio = size / target
    lift = (1.0 + ABOVE) / float(ratio.min())
    raised = StateSpaceModel(weight.A, weight.B, lift * weight.C, lift * weight.D, weight.dt)
    size = np.abs(frequency_response(raised, fine)[:, 0, 0])
    ratio = size / target
    excess, lowest = float(ratio.max()) - 1.0, float(ratio.min()) - 1.0
    status = Status.CONVERGED if excess <= tolerance else Status.INACCURATE
    return Overbound(raised, n, excess, lowest, fine, target, size, status)


# --- the quasi-convex problem ----------------------------------------------------------------------------------------


def _of_order(n: int, w: Array, b: Array, fine: Array, target: Array) -> StateSpaceModel | None:
    """Best weight of order n over the grid w and over the points of the fine grid that it turns out to need."""
    if n == 0:
        return StateSpaceModel([], [], [], [[float(target.max())]])
    points, values = w, b
    best: tuple[float, StateSpaceModel] | None = None
    for _ in range(ROUNDS):
        model = _minimax(n, points, values)
        if model is None:
            break
        ratio = np.abs(frequency_response(model, fine)[:, 0, 0]) / target
        spread = float(ratio.max() / ratio.min())
        if best is None or spread < best[0]:
            best = spread, model
        new = _extremes(ratio)
        points, index = np.unique(np.concatenate([points, fine[new]]), return_index=True)
        values = np.concatenate([values, target[new]])[index]
        if ratio.min() > 1.0 - 0.1 * LEVEL:
            break
    return None if best is None else best[1]


def _extremes(ratio: Array) -> NDArray[np.intp]:
    """Where the ratio has a local minimum below 1."""
    padded = np.concatenate([[np.inf], ratio, [np.inf]])
    low = (ratio <= padded[:-2]) & (ratio <= padded[2:]) & (ratio < 1.0)
    return np.flatnonzero(low)


def _minimax(n: int, w: Array, b: Array) -> StateSpaceModel | None:
    """Bisection on gamma, again and again with bases at the roots that the last feasible N and D have."""
    unit, mean = float(np.exp(0.5 * (np.log(w[0]) + np.log(w[-1])))), float(np.exp(np.log(b).mean()))
    x, square = (w / unit) ** 2, (b / mean) ** 2
    bases, reached = _corners(n, x, square), float(np.log(b.max() / b.min())) + LEVEL
    roots: tuple[Any, Any, float] | None = None
    for _ in range(RESTARTS):
        low, high, before = 0.0, reached, reached
        trial = reached if roots is None else 0.5 * reached
        while high - low > LEVEL:
            found = _programme(x, square, np.exp(2 * trial), *bases)
            made = None if found is None else _roots(found, bases)
            if made is not None:
                roots, high = made, trial
                bases = _spread(np.abs(made[0])), _spread(np.abs(made[1]))
            else:
                low = trial
            trial = 0.5 * (low + high)
        reached = high
        if reached > 0.98 * before - LEVEL and roots is not None:
            break
    if roots is None:
        return None
    zeros, poles, gain = roots
    return _sections(unit * _left(zeros), unit * _left(poles), mean * np.sqrt(gain))


def _corners(n: int, x: Array, square: Array) -> tuple[Array, Array]:
    """Real roots of N and D, (n,) each, with which log N / D comes near the bound in least squares: first bases."""
    from scipy.optimize import least_squares

    start = np.linspace(np.log(x[0]), np.log(x[-1]), 2 * n + 2)[1:-1]
    wanted, level = np.log(square), np.log(x)[:, None]

    def residual(p: Array) -> Array:
        logs = np.logaddexp(level, p[:-1])
        return p[-1] + logs[:, :n].sum(axis=1) - logs[:, n:].sum(axis=1) - wanted

    def slopes(p: Array) -> Array:
        share = 1.0 / (1.0 + np.exp(np.clip(level - p[:-1], -700.0, 700.0)))
        return np.hstack([share[:, :n], -share[:, n:], np.ones((len(x), 1))])

    begin = np.concatenate([start[::2], start[1::2], [wanted[-1]]])
    edges = np.concatenate([np.full(2 * n, level[0, 0] - 5.0), [-np.inf]]), np.concatenate(
        [np.full(2 * n, level[-1, 0] + 5.0), [np.inf]]
    )
    p = least_squares(residual, begin, slopes, edges, max_nfev=60).x
    return _spread(np.exp(p[:n])), _spread(np.exp(p[n : 2 * n]))


def _basis(x: Array, q: Array) -> Array:
    return np.hstack([np.ones((len(x), 1)), q / (x[:, None] + q)])


def _programme(x: Array, square: Array, level: float, q_n: Array, q_d: Array) -> tuple[Array, Array] | None:
    """Coefficients of N over prod(x + q_n) and of D over prod(x + q_d), or None where there are none.

    The margin t of all inequalities, relative to the size of N, is maximised: 0 or more is feasible.
    """
    from scipy.optimize import linprog

    shape = np.exp(np.log(x[:, None] + q_n).sum(axis=1) - np.log(x[:, None] + q_d).sum(axis=1)) / square
    f_n, f_d = _basis(x, q_n) * shape[:, None], _basis(x, q_d)
    k = f_n.shape[1]
    size = 1.0 / (1.0 + shape)[:, None]
    above = np.hstack([-f_n, f_d, np.ones((len(x), 1))]) * size
    under = np.hstack([f_n / level, -f_d, np.ones((len(x), 1))]) * size
    positive = np.hstack([np.zeros((len(x), k)), -f_d, np.zeros((len(x), 1))])
    ends = np.zeros((4, 2 * k + 1))  # N, D at x = 0 and at infinity
    ends[0, :k], ends[1, k : 2 * k], ends[2, 0], ends[3, k] = -1.0, -1.0, -1.0, -1.0
    norm = np.zeros((1, 2 * k + 1))
    norm[0, k : 2 * k] = f_d.mean(axis=0)
    rows = np.vstack([above, under, positive, ends])
    right = np.concatenate([np.zeros(2 * len(x)), np.full(len(x), -LEAST), np.full(4, -LEAST)])
    cost = np.zeros(2 * k + 1)
    cost[-1] = -1.0
    limits = [(None, None)] * (2 * k) + [(-1.0, 1.0)]
    answer = linprog(cost, rows, right, norm, [1.0], limits, method="highs")
    if answer.x is None or not answer.success or not np.isfinite(answer.x).all() or answer.x[-1] < 0:
        return None
    return answer.x[:k], answer.x[k : 2 * k]


def _roots(found: tuple[Array, Array], bases: tuple[Array, Array]) -> tuple[Any, Any, float] | None:
    """Roots in x of N and of D, and |w|^2 at infinity; None where one lies on the positive axis."""
    roots = []
    for coefficients, q in zip(found, bases, strict=True):
        if coefficients[0] <= 0:
            return None
        values = np.linalg.eigvals(-np.diag(q) - np.outer(np.ones(len(q)), coefficients[1:] * q) / coefficients[0])
        positive = (values.real >= 0) & (np.abs(values.imag) <= 1e-9 * np.abs(values))
        if positive.any() or not np.isfinite(values).all() or (values == 0).any():
            return None
        roots.append(values)
    return roots[0], roots[1], float(found[0][0] / found[1][0])


def _spread(q: Array) -> Array:
    """The same numbers, sorted and at least 5 % apart."""
    values = np.sort(q)
    for i in range(1, len(values)):
        values[i] = max(values[i], 1.05 * values[i - 1])
    return values


def _left(x: Any) -> Any:
    """The s with ``s^2 = -x`` and negative real part."""
    s = np.sqrt(-x.astype(np.complex128))
    return np.where(s.real > 0, -s, s)


def _sections(zeros: Any, poles: Any, gain: float) -> StateSpaceModel:
    """Gain at infinity times a cascade of biproper sections of first and second order."""
    pairs = list(zip(_polynomials(zeros), _polynomials(poles), strict=True))
    model = StateSpaceModel([], [], [], [[gain]])
    for numerator, denominator in pairs:
        model = series(_section(numerator, denominator), _anonymous(model))
    return _anonymous(model)


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


def _anonymous(model: StateSpaceModel) -> StateSpaceModel:
    return StateSpaceModel(model.A, model.B, model.C, model.D, model.dt)
