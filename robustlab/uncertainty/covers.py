"""The smallest uncertain set, of a chosen form, that holds every model of a set, and weights above a bound.

Unstructured forms: Zhou, Doyle, Glover (1996), section 9.1.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike

from robustlab import checks
from robustlab.arrays import AnyArray, Array, Indices
from robustlab.budget import one_thread
from robustlab.conversion import cascade
from robustlab.display import Displayable, Facts, number
from robustlab.errors import InputError, NoTrustworthyNumber, error_context
from robustlab.linear_analysis.frequency import frequency_response
from robustlab.linear_analysis.matrices import of_system_matrix, system_matrix
from robustlab.linear_analysis.zeros import transmission_zeros
from robustlab.norms import bilinear_to_discrete, hinf_norm
from robustlab.result import Status, Typed
from robustlab.statespace import StateSpaceModel, append, as_model
from robustlab.uncertainty.blocks import ParameterRange, RealScalar
from robustlab.uncertainty.elementwise import check_pair, elementwise, entry_scale
from robustlab.uncertainty.lft import UncertainModel
from robustlab.uncertainty.unstructured import Form, unstructured

# min gamma with b <= |w| <= gamma b. The log of |w|^2 = N(x) / D(x), x = omega^2, in corner frequencies and dampings of
# N and D is fitted to that of the bound by least squares, then in p-norms of growing p, which end near minimax.

NORMS = (8, 64)  # exponents p of the norms of the error, one after the other
FINER_GRID = 10  # points of the evaluation grid for each one of the fit

Bound = Callable[[Array], Array]
Models = tuple[StateSpaceModel, ...]

ABOVE = 1e-12  # rounding in a frequency response


@dataclass(frozen=True, eq=False)
class Overbound(Typed, Displayable):
    """A weight above a bound, with its evaluation grid."""

    weight: StateSpaceModel  #: Stable, minimum phase, with as many zeros as poles: its inverse is stable, too
    #: The grid in rad/s, ten times finer than that of the fit; the bound and ``|w|`` on it
    omega: Array
    bound: Array
    magnitude: Array
    status: Status  #: CONVERGED where the excess is within the tolerance, else INACCURATE

    derived: ClassVar[tuple[str, ...]] = ("order", "excess", "lowest")

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

    def lifted(self, factor: float) -> Overbound:
        w = self.weight
        weight = StateSpaceModel(w.A, w.B, factor * w.C, factor * w.D, w.dt)
        return replace(self, weight=weight, magnitude=factor * self.magnitude)

    def facts(self) -> Facts:
        return [
            ("order", str(self.order)),
            ("above the bound", f"{100 * self.lowest:.3g} % .. {100 * self.excess:.3g} %"),
            ("frequencies", f"{number(self.omega[0])} .. {number(self.omega[-1], 'rad/s')}, {len(self.omega)} points"),
        ]


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
    order, tolerance
        Largest number of states, 0..12; the excess at which a lower order suffices.
    exact, dt
        The bound as a function of frequencies, if known between the given ones; sample time in s of the weight, 0:
        continuous.

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


# With a nominal model G and the error E_i of model i in the chosen form, |w| >= max sigma(E_i), Delta_i = E_i / w.
# Model i is a member if Delta_i is stable with a norm of at most one. The errors have poles only where the models or
# their inverses have; the Laurent series of E_i there shows whether such a pole cancels.

BOUND_FLOOR = 1e-4  # the bound is hypot(bound, this share of its largest value), as a weight needs a positive one
GRID_POINTS = 150  # points of a frequency grid between its ends and around resonances
EPS = float(np.finfo(float).eps)
CIRCLE_POINTS = 64  # points of a circle around a pole, for Laurent coefficients


def model_set(models: Iterable[Any], same_states: bool, where: str) -> Models:
    """Check for at least two models with the same signals, units, sample time, and with ``same_states`` states."""
    if isinstance(models, (StateSpaceModel, str, bytes)) or not isinstance(models, Iterable):
        raise InputError(where, f"{type(models).__name__}", "a list of at least two models")
    found = tuple(as_model(model, f"{where}: model {i + 1}") for i, model in enumerate(models))
    if len(found) < 2:
        raise InputError(where, f"{len(found)} model{'s' * (len(found) != 1)}", "at least two models")
    for i, model in enumerate(found[1:], 2):
        first, other = found[0], model
        if same_states and model.D.shape == first.D.shape and model.n_states != first.n_states:
            hint = "models with different states: cover their frequency responses (form additive, ...)"
            raise InputError(where, f"model {i} has {model.n_states} states", f"{first.n_states} as model 1", hint)
        if not same_states:
            first, other = (StateSpaceModel([], [], [], m.D, m.dt, m.inputs, m.outputs) for m in (first, model))
        check_pair(first, other, "model 1", f"model {i}", where)
    return found


def system_matrices(models: Iterable[StateSpaceModel]) -> Array:
    """Return ``[A B; C D]`` of each model, shape (n_models, n_x + n_y, n_x + n_u)."""
    return np.array([system_matrix(m) for m in models])


def model_of(s: Array, like: StateSpaceModel) -> StateSpaceModel:
    """Return the model of ``[A B; C D]`` with the signals and states of another one."""
    return of_system_matrix(s, like.n_states, like.dt, like.inputs, like.outputs, like.states, "cover")


ANALYTIC = 1e-6  # Laurent coefficients below this share of the models' size around a point are rounding
BOUNDARY = 1e-9  # a pole this near to the stability boundary, relative to its size, may be on either side
STILL = 1e-7  # poles and zeros this slow, relative to the fastest, are integrators with rounding
# Multiples of the grid's ends at which the error is compared with the weight, and the largest growth there.
BEYOND, GROWTH = np.array([3.0, 10.0, 100.0, 1e3, 1e4]), 1.5
NEAREST = 1e-6  # smallest distance of grid points from the Nyquist frequency, relative to it
LIFT = 1.001  # a smaller lift is rounding, or a peak next to a frequency of the grid


# The set; the number of the nominal model, from 1, or 0: the middle of the matrices, None: the given one; the weight
# with its bound; each model's largest gain of its Delta; the Deltas as systems, none where one has no realisation: then
# the gains are evaluated on the grid only; the largest ratio of the bound to the models' own size.
UnstructuredCover = tuple[UncertainModel, int | None, Overbound, tuple[float, ...], Models, float]


def unstructured_cover(
    models: Models, form: Form, nominal: StateSpaceModel | None, order: int, tolerance: float
) -> UnstructuredCover:
    """Return the cover of models with the same signals; their states may differ."""
    if form != "additive" and models[0].n_inputs != models[0].n_outputs:
        found = f"models of {models[0].n_outputs} outputs and {models[0].n_inputs} inputs"
        raise InputError(f"cover: form {form}", found, "as many inputs as outputs, or form additive")
    candidates: list[tuple[int | None, StateSpaceModel]]
    candidates = [*enumerate(models, 1)] if nominal is None else [(None, nominal)]
    if nominal is None and all(m.state_names == models[0].state_names for m in models):
        stack = system_matrices(models)  # the middle of the matrices is number 0
        candidates.append((0, model_of(0.5 * (stack.min(axis=0) + stack.max(axis=0)), models[0])))
    omega = _grid(models, [c for _, c in candidates])
    judged: list[tuple[float, int | None, StateSpaceModel]] = []
    rejected: list[NoTrustworthyNumber] = []
    for label, candidate in candidates:
        try:
            _require_stable(models, candidate, form)
        except NoTrustworthyNumber as error:
            rejected.append(error)
            continue
        size = error_sizes(models, candidate, form, omega).max(axis=0)
        judged.append((float((size / _reference(models, form, omega)).max()), label, candidate))
    if not judged:
        raise rejected[0]
    radius, label, centre = min(judged, key=lambda one: one[0])
    fit, deltas, sizes = _weighted(models, centre, form, order, tolerance, omega)
    return unstructured(centre, fit.weight, form), label, fit, sizes, deltas, radius


def _weighted(
    models: Models, centre: StateSpaceModel, form: Form, order: int, tolerance: float, omega: Array
) -> tuple[Overbound, Models, tuple[float, ...]]:
    """Return the weight above all errors, the Deltas as systems (none where one has no proved norm), their gains."""

    def bound(w: Array) -> Array:
        return error_sizes(models, centre, form, w).max(axis=0)

    size, dt = bound(omega), centre.dt
    # Frequencies outside the grid; of a discrete model the last is the Nyquist frequency.
    rest = np.pi / dt - omega[-1] if dt else 0.0
    high = np.pi / dt - rest * np.linspace(0.9, 0.0, GRID_POINTS) if dt else omega[-1] * BEYOND
    beyond = np.concatenate([omega[0] / BEYOND, high])
    if not size.any():
        raise InputError("cover", "models that are all the same", "models that differ")
    outside = bound(beyond)
    worst = int(np.argmax(outside))
    if outside[worst] > GROWTH * float(size.max()):
        found = f"the error still grows at {beyond[worst]:.3g} rad/s, to {outside[worst]:.3g}"
        hint = "models whose relative degrees or integrators differ, or inverses of strictly proper ones: form additive"
        raise NoTrustworthyNumber(f"cover: form {form}", found, "an error that a proper weight bounds", hint)
    floor = BOUND_FLOOR * float(size.max())
    raised = np.hypot(size, floor)
    fit = overbound(omega, raised, order, tolerance, exact=lambda w: np.hypot(bound(w), floor), dt=dt)
    deltas = _deltas(models, centre, form, fit.weight)
    norms = [hinf_norm(d, 1e-9) for d in deltas]
    if norms and all(n.status.trustworthy and np.isfinite(n.upper) for n in norms):
        gains = np.array([n.upper for n in norms])
    else:
        at, deltas = np.concatenate([fit.omega, beyond]), ()
        weight = np.abs(frequency_response(fit.weight, at)[:, 0, 0])
        gains = (error_sizes(models, centre, form, at) / weight).max(axis=1)
    # A peak between two frequencies of the grid, or an error beyond them, lifts the weight.
    lift = max(float(gains.max()) * (1.0 + 1e-9), 1.0)
    deltas = tuple(StateSpaceModel(d.A, d.B, d.C / lift, d.D / lift, d.dt) for d in deltas)
    fit = fit.lifted(lift)
    if lift > LIFT and fit.excess > tolerance:
        fit = replace(fit, status=Status.INACCURATE)
    return fit, deltas, tuple((gains / lift).tolist())


# --- errors by frequency ---------------------------------------------------------------------------------------------


def _error(model: StateSpaceModel, centre: StateSpaceModel, form: Form, s: AnyArray) -> AnyArray:
    """Return ``E_i`` at complex s, (len(s), ., .)."""
    below, above = centre(s), model(s)
    if form.startswith("inverse"):
        below, above = above, below
    try:
        if form == "additive":
            return above - below
        if form == "inverse-additive":
            return np.linalg.solve(below, _right_divided(above - below, above))
        if form.endswith("input-multiplicative"):
            return np.linalg.solve(below, above - below)
        return _right_divided(above - below, below)
    except np.linalg.LinAlgError:
        hint = "form additive inverts no model"
        raise NoTrustworthyNumber(f"cover: form {form}", "a response without an inverse", None, hint) from None


def _right_divided(a: AnyArray, b: AnyArray) -> AnyArray:
    return np.swapaxes(np.linalg.solve(np.swapaxes(b, 1, 2), np.swapaxes(a, 1, 2)), 1, 2)


def error_sizes(models: Models, centre: StateSpaceModel, form: Form, omega: Array) -> Array:
    """Return ``sigma_max(E_i)`` of every model relative to the nominal one, (n_models, n_omega); omega in rad/s."""
    s = np.exp(1j * omega * centre.dt) if centre.dt else 1j * omega
    with np.errstate(all="ignore"):
        sizes = np.linalg.norm([_error(m, centre, form, s) for m in models], 2, axis=(2, 3))
    if not np.isfinite(sizes).all():
        k = int(np.flatnonzero(~np.isfinite(sizes).all(axis=0))[0])
        raise NoTrustworthyNumber("cover", f"the error at {omega[k]:g} rad/s is not finite")
    return sizes


def _reference(models: Models, form: Form, omega: Array) -> Array:
    """Return the scale of the bound: the models' own size for the additive forms, 1 for the relative ones."""
    if not form.endswith("additive"):
        return np.ones(len(omega))
    responses = np.array([frequency_response(m, omega) for m in models])
    plain = form == "additive"
    sizes = np.linalg.norm(responses if plain else np.linalg.inv(responses), 2, axis=(2, 3)).max(axis=0)
    return sizes + np.finfo(float).tiny if plain else sizes


def _grid(models: Models, others: list[StateSpaceModel]) -> Array:
    """Return frequencies over all models' dynamics, dense about their resonances and anti-resonances."""
    dt = models[0].dt
    poles = np.concatenate([m.poles() for m in (*models, *others)])
    zeros = np.concatenate([transmission_zeros(m) for m in (*models, *others)])
    if dt:
        poles, zeros = (np.log(x[np.abs(x) > 1e-12]) / dt for x in (poles, zeros))
    known = np.concatenate([poles, zeros])
    known = known[np.abs(known) > STILL * np.abs(poles).max(initial=0.0)]
    size = np.abs(known) if len(known) else np.ones(1)
    low, top = float(size.min()) * 1e-2, np.pi / dt if dt else np.inf
    high = 0.999 * top if dt else float(size.max()) * 1e2
    omega = [np.geomspace(min(low, 0.1 * high), high, GRID_POINTS)]
    if dt:  # negative real poles and zeros are resonances at the Nyquist frequency
        rates = np.abs(known.real[np.abs(known.imag) > high])
        rates = np.unique(np.log(np.maximum(rates[rates < 0.03 * top], NEAREST * top)).round(1))
        omega += [top - rate * np.geomspace(0.03, 30.0, 25) for rate in np.exp(rates).tolist()]
        high = top * (1 - 0.01 * NEAREST)
    for p in known.tolist():
        if abs(p.real) < 0.3 * abs(p.imag) and abs(p.imag) < high:
            near = abs(p.imag) + max(abs(p.real), 1e-6 * abs(p.imag)) * np.linspace(-3, 3, 13)
            omega.append(near[(near > low) & (near < high)])
    return np.unique(np.concatenate(omega))


def _require_stable(models: Models, centre: StateSpaceModel, form: Form) -> None:
    """Check that every error is analytic in the closed unstable region."""
    for i, model in enumerate(models, 1):
        if model is centre:
            continue
        above, below = (centre, model) if form.startswith("inverse") else (model, centre)
        zeros = form == "inverse-additive", form != "additive"  # whose zeros are poles of the error
        pairs = zip((above, below), zeros, strict=True)
        parts = [transmission_zeros(m, complete=True) if z else m.poles() for m, z in pairs]
        bad = _pole_that_stays(model, centre, form, np.concatenate(parts))
        if bad is not None:
            text = f"model {i} differs from the nominal one by an unstable error (pole {bad.real:.6g}{bad.imag:+.6g}j)"
            hint = "an inverse form holds other poles on the right, additive other zeros"
            raise NoTrustworthyNumber(f"cover: form {form}", text, "a stable one", hint)


def _pole_that_stays(model: StateSpaceModel, centre: StateSpaceModel, form: Form, singular: AnyArray) -> complex | None:
    """Return a pole on the right of the error among these numbers, by its Laurent series there; None without one."""
    scale = float(np.abs(singular).max(initial=0.0)) or 1.0
    size = np.maximum(np.abs(singular), 1e-6 * scale)
    outside = (np.abs(singular) - 1.0 if model.is_discrete else np.real(singular) / size) >= -BOUNDARY
    turns = np.exp(2j * np.pi * (np.arange(CIRCLE_POINTS) + 0.5) / CIRCLE_POINTS)
    for p in singular[outside].tolist():
        far = np.abs(singular[~outside] - p).min(initial=max(abs(p), 1e-3 * scale))
        points, own = p + 0.5 * float(far) * turns, 1.0  # own: size of the terms of the difference
        with np.errstate(all="ignore"):
            error = _error(model, centre, form, points)
            if form.endswith("additive"):
                here = centre(points)
                own = float(np.abs(here if form == "additive" else np.linalg.inv(here)).max())
            reference = float(np.abs(error).max() + own)
        laurent = [np.abs((error * turns[:, None, None] ** k).mean(axis=0)).max() for k in range(1, 9)]
        if not np.isfinite(reference) or max(laurent) > ANALYTIC * reference:
            return p
    return None


def _deltas(models: Models, centre: StateSpaceModel, form: Form, weight: StateSpaceModel) -> Models:
    """Return ``E_i / w`` as systems; none where a required inverse is not proper."""
    one = weight.inverse()
    back = anonymous(append(*(one.renamed([f"u{k}"], [f"y{k}"]) for k in range(centre.n_inputs))))
    try:
        return tuple(anonymous(_error_model(anonymous(m), anonymous(centre), form) @ back) for m in models)
    except NoTrustworthyNumber:
        return ()


def _error_model(model: StateSpaceModel, centre: StateSpaceModel, form: Form) -> StateSpaceModel:
    """Return ``E_i`` as a system."""
    if form == "additive":
        return model - centre
    if form == "inverse-additive":
        return model.inverse() - centre.inverse()
    if form.startswith("inverse"):
        model, centre = centre, model
    if form.endswith("output-multiplicative"):
        inverse, other = _proper_quotient(_transposed(centre), _transposed(model))
        return _transposed(inverse @ other) - np.eye(centre.n_inputs)
    inverse, other = _proper_quotient(centre, model)
    return inverse @ other - np.eye(centre.n_inputs)


def _proper_quotient(below: StateSpaceModel, above: StateSpaceModel) -> tuple[StateSpaceModel, StateSpaceModel]:
    """Return ``(P below)^-1``, ``P above``, P a diagonal of powers of s + a (discrete: z) for a proper inverse."""
    a = 0.0 if below.is_discrete else float(np.abs(below.poles()).max(initial=0.0)) or 1.0
    for _ in range(below.n_states):
        rows = np.flatnonzero(~(below.D.any(axis=1) | above.D.any(axis=1)))
        if not len(rows):
            break
        below, above = (_times_s(m, rows, a) for m in (below, above))
    return below.inverse(), above


def _times_s(m: StateSpaceModel, rows: Indices, a: float) -> StateSpaceModel:
    """Multiply the rows of a model that have no direct term by s + a."""
    C, D = m.C.copy(), m.D.copy()
    C[rows], D[rows] = m.C[rows] @ m.A + a * m.C[rows], m.C[rows] @ m.B
    D[rows] *= np.abs(D[rows]) > 16 * EPS * (np.abs(m.C[rows]) @ np.abs(m.B))  # rounding of a cancellation is zero
    return StateSpaceModel(m.A, m.B, C, D, m.dt)


def _transposed(m: StateSpaceModel) -> StateSpaceModel:
    return StateSpaceModel(m.A.T, m.C.T, m.B.T, m.D.T, m.dt)


# S_i = S_0 + sum_j delta_ij E_j, |delta_ij| <= 1, S = [A B; C D]. "elements": the interval hull, each differing entry
# is a parameter. "pca": the E_j are the principal components of the models, scaled to their extent, and S_0 is the
# middle of that box.

ParametricForm = Literal["elements", "pca"]
PARAMETRIC_FORMS: tuple[ParametricForm, ...] = get_args(ParametricForm)

ROUNDING = 1e-13  # relative difference of equal entries, from the rounding of a linearisation

Made = tuple[UncertainModel, tuple[dict[str, float], ...], tuple[float, ...]]  # the set, deltas of the models, spread


def parametric_cover(
    models: Models, form: ParametricForm, nominal: StateSpaceModel | None, tolerance: float, directions: int | None
) -> Made:
    """Return the cover of models with the same states, the parameter values of each, and their principal extents."""
    checks.number("cover: tolerance", tolerance, "a number in [0, 1)", at_least=0, below=1)
    if directions is not None:
        checks.whole("cover: directions", directions, 1)
    if form == "elements":
        if directions is not None:
            raise InputError("cover: directions", f"{directions} with form elements", "form pca")
        return _hull(models, nominal, tolerance)
    if nominal is not None:
        raise InputError("cover: nominal", f"a nominal model for form {form}", "none: it is the middle of the box")
    return _directions(models, tolerance, directions)


def _hull(models: Models, nominal: StateSpaceModel | None, tolerance: float) -> Made:
    stack = system_matrices(models)
    low, high = stack.min(axis=0), stack.max(axis=0)
    allowance = max(tolerance, ROUNDING) * entry_scale(np.abs(stack).max(axis=0), models[0].n_states)
    still = high - low <= allowance
    if nominal is None:
        middle, above = 0.5 * (low + high), 0.5 * (high - low)
        below = above
    else:
        (middle,) = system_matrices([nominal])
        inside = (low < middle) & (middle < high)
        furthest = np.maximum(np.abs(high - middle), np.abs(middle - low))
        above, below = np.where(inside, high - middle, furthest), np.where(inside, middle - low, furthest)
        still &= furthest <= allowance
    above, below = np.where(still, 0.0, above), np.where(still, 0.0, below)
    first = models[0] if nominal is None else nominal
    centre = model_of(middle, first)
    made = elementwise(centre, model_of(middle + above, first), "elements")
    at = _entries(middle + above - middle, first.n_states)
    ranges = [ParameterRange(float(middle[i]), float(above[i]), "", float(below[i])) for i in at]
    blocks = [RealScalar(b.name, b.rows, r) for b, r in zip(made.blocks, ranges, strict=True)]
    values = [[float(np.clip(r.delta(float(s[i])), -1.0, 1.0)) for r, i in zip(ranges, at, strict=True)] for s in stack]
    deltas = tuple(dict(zip((b.name for b in blocks), row, strict=True)) for row in values)
    return UncertainModel(made.M, blocks, made.operating_point), deltas, ()


def _entries(e: Array, n: int) -> list[tuple[int, int]]:
    """Return the non-zero entries in the order of the blocks of `elementwise`: those of A, of B, of C, of D."""
    parts = ((0, 0, e[:n, :n]), (0, n, e[:n, n:]), (n, 0, e[n:, :n]), (n, n, e[n:, n:]))
    return [(int(i) + row, int(j) + col) for row, col, part in parts for i, j in np.argwhere(part)]


def _directions(models: Models, tolerance: float, directions: int | None) -> Made:
    stack = system_matrices(models)
    scale = entry_scale(np.abs(stack).max(axis=0), models[0].n_states)
    scale[scale == 0] = 1.0
    middle = stack.mean(axis=0)
    cloud = ((stack - middle) / scale).reshape(len(models), -1)
    cloud[:, np.ptp(cloud, axis=0) <= ROUNDING] = 0.0
    axes = np.linalg.svd(cloud, full_matrices=False)[2]
    along, count = cloud @ axes.T, len(axes) if directions is None else min(directions, len(axes))
    if directions is None:  # the fewest that represent every entry of every model within the tolerance
        off = (np.abs(cloud - along[:, :k] @ axes[:k]).max(initial=0.0) for k in range(len(axes)))
        count = next((k for k, missed in enumerate(off) if missed <= max(tolerance, ROUNDING)), len(axes))
    centre, half = 0.5 * (along.max(axis=0) + along.min(axis=0)), 0.5 * np.ptp(along, axis=0)
    order = np.argsort(-half[:count], kind="stable")
    order = order[half[order] > ROUNDING]
    left = tuple(r for r in half[count:].tolist() if r > ROUNDING)
    axes, along, centre, half = axes[order], along[:, order], centre[order], half[order]
    nominal = model_of(middle + scale * (centre @ axes).reshape(scale.shape), models[0])
    (start,) = system_matrices([nominal])
    moved = (start + scale * (size * axis).reshape(scale.shape) for size, axis in zip(half, axes, strict=True))
    ends = {f"direction{j}": model_of(matrix, models[0]) for j, matrix in enumerate(moved, 1)}
    made = elementwise(nominal, ends) if ends else UncertainModel(nominal, [])
    share = np.clip((along - centre) / half, -1.0, 1.0)
    return made, tuple(dict(zip(ends, row, strict=True)) for row in share.tolist()), (*half.tolist(), *left)
