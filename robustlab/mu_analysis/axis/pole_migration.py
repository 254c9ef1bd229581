"""Destabilising perturbations: the smallest Delta that brings a pole of a state-space model to the axis."""

# Real mu is nonzero at isolated frequencies only, so a frequency grid finds nothing. Instead one pole of A + B Delta
# (I - D Delta)^-1 C is moved to the axis in small steps, each the linearised move of least max |delta_i|, then along
# the axis to a smaller Delta. A real pole that meets another and crosses at zero is found by the static problem
# det(I - M(0) Delta) = 0, a loop that becomes ill-posed by det(I - D Delta) = 0. At the end the model at Delta, or at a
# part of it, must have a pole on or beyond the axis.

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from robustlab.arrays import Array, ComplexArray
from robustlab.budget import Budget, dense
from robustlab.errors import NoTrustworthyNumber
from robustlab.linear_analysis.frequency import frequency_response
from robustlab.mu_analysis.matrix.block_structure import DeltaLayout, delta_layout, delta_norm, project
from robustlab.mu_analysis.matrix.branch_and_bound import block_entries, centre_matrix, gauge, lowest
from robustlab.mu_analysis.matrix.lower import EPS, FRACTIONS, SINGULAR, lower_bounds, singularity, smallest, unit_rows
from robustlab.statespace import StateSpaceModel
from robustlab.uncertainty.blocks import Block, block_slices

LEADING = 15  # steps that move a pole to the axis; more: smaller ones
FOLLOWING = 15  # steps along the axis
SCALING = 6  # steps at the end that change the size of Delta alone
CROSSINGS = 8  # candidates that are moved to the axis exactly
PEAKS = 6  # of mu on the grid that paths start from
AXIS_ROUNDS = 15  # of descent along the axis at most ...
LEAST_AXIS_DESCENT = 1e-5  # ... each of which has to lower the norm by this share


@dataclass(frozen=True)
class Destabilising:
    """A Delta (q, p) with a pole on or right of the axis; an ill-posed loop has ``pole = inf``."""

    norm: float
    delta: ComplexArray
    pole: complex


def smallest_destabilising(
    model: StateSpaceModel, blocks: Sequence[Block], omega: Array, seed: int = 0, random_starts: int = 12
) -> Destabilising | None:
    """The smallest destabilising Delta found for a stable continuous model with Delta channels (p, q), or None."""
    crossings: list[Destabilising] = []
    candidates, ill_posed = _matrix_candidates(model, blocks, omega, seed)
    if model.n_states:
        # A path that does not converge may overflow; its end is no crossing.
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            candidates = _migrated(model, blocks, candidates, seed, random_starts)
    for delta in candidates:
        best = min((c.norm for c in crossings), default=np.inf)
        crossing = first_crossing(model, blocks, delta, best)
        if crossing is not None:
            crossings.append(crossing)
    if ill_posed is not None and singularity(model.D.astype(complex), ill_posed) <= SINGULAR * 1e3:
        crossings.append(Destabilising(delta_norm(blocks, ill_posed), ill_posed, complex(np.inf)))
    return min(crossings, key=lambda c: c.norm, default=None)


def _matrix_candidates(
    model: StateSpaceModel, blocks: Sequence[Block], omega: Array, seed: int
) -> tuple[list[ComplexArray], ComplexArray | None]:
    """Return Deltas that solve the matrix problem at zero frequency and, with complex blocks, at the grid's peaks."""
    # At zero frequency M is real: its real Delta moves a real pole into the origin.
    ends = np.concatenate([frequency_response(model, np.array([0.0])), model.D.astype(complex)[None]])
    static, (_, ill_posed) = lower_bounds(ends, blocks, seed)
    found = [static]
    # A purely real Delta is critical at isolated frequencies only: others would find nothing.
    if len(omega) and not all(b.interval for b in blocks):
        others = lower_bounds(frequency_response(model, np.asarray(omega, dtype=float)), blocks, seed, 4, 24)
        found += sorted(others, key=lambda pair: -pair[0])[:PEAKS]
    return [delta for _, delta in found if delta is not None], ill_posed


def _closed(model: StateSpaceModel, delta: ComplexArray) -> tuple[NDArray[Any], NDArray[Any] | None]:
    """Return ``A + B Delta (I - D Delta)^-1 C`` of Delta (q, p), or a stack, and ``(I - D Delta)^-1`` (None: I).

    The former is Inf where the loop is ill-posed.
    """
    d: ComplexArray | Array = delta if delta.imag.any() else delta.real
    if not model.D.any():
        return model.A + model.B @ d @ model.C, None
    try:
        inverse = np.linalg.inv(np.eye(model.n_outputs) - model.D @ d)
    except np.linalg.LinAlgError:
        return np.full((*delta.shape[:-2], *model.A.shape), np.inf), None
    return model.A + model.B @ d @ (inverse @ model.C), inverse


# --- crossings -------------------------------------------------------------------------------------------------------


def _rightmost(model: StateSpaceModel, delta: ComplexArray) -> ComplexArray:
    """The pole with the largest real part for each of a stack of Deltas; inf where the loop is ill-posed."""
    a: ComplexArray = _closed(model, delta)[0]
    if not model.n_states:
        return np.full(len(delta), -np.inf, dtype=complex)
    finite = np.isfinite(a).all(axis=(1, 2))
    result = np.full(len(delta), np.inf, dtype=complex)
    if finite.any():
        poles = np.linalg.eigvals(a[finite] if a[finite].imag.any() else a[finite].real)
        result[finite] = poles[np.arange(len(poles)), poles.real.argmax(axis=1)]
    return result


def first_crossing(
    model: StateSpaceModel, blocks: Sequence[Block], delta: ComplexArray, best: float = np.inf
) -> Destabilising | None:
    """Return the smallest multiple of Delta found, up to slightly more than 1, at which the model is not stable."""
    delta = project(blocks, delta)
    if not np.isfinite(delta).all() or not delta.any():
        return None
    factors = np.concatenate([np.linspace(0.1, 1.0, 10), 1 + 10.0 ** np.arange(-12, -3)])
    right = _rightmost(model, factors[:, None, None] * delta)
    # Where rounding of eigenvalues hides the crossing, the frequency response still detects it.
    exact = _on_the_axis(model, blocks, delta, complex(right[9]))
    unstable_at = np.flatnonzero(right.real >= 0)
    first = int(unstable_at[0]) if len(unstable_at) else 0
    stable = float(factors[first - 1]) if first else 0.0
    if not len(unstable_at) or stable * delta_norm(blocks, delta) >= best:
        return min(exact, key=lambda c: c.norm, default=None)
    unstable = _bisected(model, delta, stable, float(factors[first]))
    pole = complex(_rightmost(model, unstable * delta[None])[0])
    if not np.isfinite(pole):  # the loop becomes ill-posed
        return Destabilising(unstable * delta_norm(blocks, delta), unstable * delta, pole)
    exact += _on_the_axis(model, blocks, unstable * delta, pole)
    return min(exact, key=lambda c: c.norm, default=None)


def _bisected(model: StateSpaceModel, delta: ComplexArray, stable: float, unstable: float) -> float:
    """Return the first multiple of Delta between two with a pole right of the axis; a round cuts into sixteen parts."""
    for _ in range(12):
        inner = np.linspace(stable, unstable, 17)
        beyond = _rightmost(model, inner[1:-1, None, None] * delta).real >= 0
        step = int(np.argmax(beyond)) + 1 if beyond.any() else 16
        stable, unstable = float(inner[step - 1]), float(inner[step])
        if unstable - stable <= 1e-13 * unstable:
            break
    return unstable


def _on_the_axis(
    model: StateSpaceModel, blocks: Sequence[Block], delta: ComplexArray, pole: complex
) -> list[Destabilising]:
    """Return crossings at multiples of Delta, by ``det(I - M(j omega) Delta) = 0``, from the frequency of a pole."""
    if not np.isfinite(pole):
        return []
    # A pole of a real model that is small relative to the others may be real although its eigenvalue is not.
    slow = abs(pole) <= 1e-6 * np.abs(model.A).max()
    real, found = any(b.interval for b in blocks), []
    for omega in dict.fromkeys([pole.imag, 0.0] if slow else [pole.imag]):
        met: list[tuple[float, Destabilising]] = []
        for _ in range(12):
            now = _loop_eigenvalue(model, delta, omega)
            if now is None or now[0].real <= 0:
                break
            value, slope = now
            off = abs(value.imag / value)
            # In a narrow peak no floating-point frequency is the one of the crossing.
            if off <= min(1e-12 + 8 * model.n_states * EPS * abs(omega * slope.imag / value), 1e-5):
                exact = delta / (value.real if real else value)
                met.append((off, Destabilising(delta_norm(blocks, exact), exact, complex(0.0, omega))))
            if off <= 1e-12 or slope.imag == 0:
                break
            omega -= value.imag / slope.imag
            if not np.isfinite(omega):
                break
        found += [crossing for _, crossing in sorted(met, key=lambda pair: pair[0])[:1]]
    return found


def _loop_eigenvalue(model: StateSpaceModel, delta: ComplexArray, omega: float) -> tuple[complex, complex] | None:
    """The eigenvalue of ``M(j omega) Delta`` next to one, and its derivative by omega."""
    try:
        response = frequency_response(model, np.array([omega]))[0]
        states = np.linalg.solve(1j * omega * np.eye(model.n_states) - model.A, model.B @ delta)
        out = np.linalg.solve((1j * omega * np.eye(model.n_states) - model.A).T, model.C.T).T
    except (NoTrustworthyNumber, np.linalg.LinAlgError):
        return None
    loop = response @ delta
    if not np.isfinite(loop).all():
        return None
    values, right = np.linalg.eig(loop)
    k = int(np.abs(values - 1).argmin())
    left = np.linalg.inv(right + 1e-13 * np.eye(len(loop)))[k]
    return complex(values[k]), complex(-1j * (left @ out @ (states @ right[:, k])))


# --- migration -------------------------------------------------------------------------------------------------------


def _migrated(
    model: StateSpaceModel, blocks: Sequence[Block], given: list[ComplexArray], seed: int, random_starts: int
) -> list[ComplexArray]:
    """Return Deltas, the smallest first, with a pole close to the axis: those given, and the ends of paths."""
    layout, rng, nominal = delta_layout(blocks), np.random.default_rng(seed), model.poles()
    upper = nominal[nominal.imag >= 0]
    zero = np.zeros((len(upper), layout.q, layout.p), dtype=complex)
    pole, _, _, row, x = directions(model, zero, upper)
    # The norm at which a typical pole reaches the axis to first order.
    gains = np.maximum(np.abs(layout.gains(row, x)).sum(axis=1), 1e-300)
    size = float(np.median(np.minimum(-pole.real / gains, 1e6)))
    scattered = _scattered(model, layout, rng, size, (random_starts + 1) // 2)
    start = np.concatenate([zero, scattered, *(g[None] for g in given)])
    aims = np.concatenate([upper, _rightmost(model, start[len(upper) :])])
    found, norm = _migrate(model, layout, start, aims)
    if np.isfinite(norm).any():
        size = float(norm.min())
    again = _scattered(model, layout, rng, size, random_starts)
    right = _rightmost(model, again)
    more, more_norm = _migrate(model, layout, again, right)
    unstable = np.where(right.real >= 0, layout.sizes(again).max(axis=1), np.inf)
    pool = np.concatenate([found, more, again, *(g[None] for g in given)])
    norm = np.concatenate([norm, more_norm, unstable, [delta_norm(blocks, g) for g in given]])
    chosen = pool[smallest(np.zeros(len(pool), dtype=int), norm, CROSSINGS + len(given))]
    lower = descended(model, layout, chosen)
    return [*lower[np.argsort(layout.sizes(lower).max(axis=1))], *chosen[:2], *given]


def _scattered(
    model: StateSpaceModel, layout: DeltaLayout, rng: np.random.Generator, size: float, count: int
) -> ComplexArray:
    """Return well-posed random Deltas (<= count, q, p), every other one a corner, of 0.1 to 2 times a size."""
    values = rng.uniform(-1, 1, (count, layout.n))
    values[::2] = np.sign(values[::2])
    turned = values * np.where(layout.real, 1.0, np.exp(2j * np.pi * rng.random((count, layout.n))))
    turned = turned * size * 10 ** rng.uniform(-1, 0.3, (count, 1))
    row, x = (rng.standard_normal((count, n)).astype(complex) for n in (layout.q, layout.p))
    deltas = layout.deltas(turned, row, x)
    return deltas[np.isfinite(_closed(model, deltas)[0]).all(axis=(1, 2))]


def _migrate(
    model: StateSpaceModel, layout: DeltaLayout, deltas: ComplexArray, poles: ComplexArray
) -> tuple[ComplexArray, Array]:
    """Return the smallest Delta of each path with its pole close to the axis, and its norm (inf where none has)."""
    going = np.isfinite(poles) & (np.abs(poles) < np.inf)
    deltas, poles = deltas[going], poles[going]
    best, best_norm = deltas.copy(), np.full(len(deltas), np.inf)
    if not len(deltas):
        return best, best_norm
    speed = np.maximum(np.abs(poles), 1e-9 * np.abs(model.A).max())
    # A pole next to the axis must move before it counts as arrived.
    close = np.minimum(1e-6 * speed, np.maximum(1e-3 * np.abs(poles.real), 100 * EPS * speed))
    phase = np.arange(len(deltas)) * 0.754877666 % 1.0
    new: ComplexArray  # declared: inferring it around the loop takes pyright long
    first: Array = np.zeros(len(deltas))
    at: Directions | None = None
    for step in range(LEADING + FOLLOWING):
        try:
            # Poles may meet and leave the real axis in pairs: all eigenvalues are needed to identify the next one.
            if at is None or step <= LEADING:
                at = directions(model, deltas, poles)
            else:
                at = _by_inverse_iteration(model, deltas, poles, at)
        except np.linalg.LinAlgError:
            break
        norms = layout.sizes(deltas).max(axis=1)
        arrived = (np.abs(at.pole.real) <= close) & (norms < best_norm) & (norms > 0)
        best[arrived], best_norm[arrived] = deltas[arrived], norms[arrived]
        goal = at.pole.real * (1 - 1 / (LEADING - step)) if step < LEADING else np.zeros(len(deltas))
        new = _least_move(layout, deltas, at, goal)
        if LEADING <= step < LEADING + FOLLOWING - SCALING:
            gain = 0.3 + 0.7 * ((phase + step * 0.569840291) % 1.0)
            new = deltas + gain[:, None, None] * (new - deltas)
        elif step >= LEADING + FOLLOWING - SCALING:
            new = _scaled_to_axis(deltas, at)
        size = layout.sizes(new).max(axis=1)
        first = size if step == 0 else first
        # The linearisation does not hold far away: where a loop becomes ill-posed, a whole step is useless.
        new = new * np.minimum(1.0, (first + 1.5 * norms) / np.maximum(size, 1e-300))[:, None, None]
        moved = np.einsum("km,kmp,kp->k", at.row, new - deltas, at.x)
        reach = 0.5 * np.abs(at.pole) + 1e-3 * speed
        poles = at.pole + moved * np.minimum(1.0, reach / np.maximum(np.abs(moved), 1e-100 * speed + 1e-200))
        deltas = new
    return best, best_norm


def descended(model: StateSpaceModel, layout: DeltaLayout, deltas: ComplexArray) -> ComplexArray:
    """Move Deltas with a pole on the axis to smaller ones along the axis while the norm falls."""
    # Where several blocks end inside their range, whole steps only jump around the minimum: part of the way to the
    # Delta of least norm of the linearised problem, then back to the axis by size.
    if not len(deltas):
        return deltas
    deltas, norm = deltas.copy(), layout.sizes(deltas).max(axis=1)
    going, trials = np.arange(len(deltas)), len(FRACTIONS)
    tried: ComplexArray  # declared: inferring it around the loop takes pyright long
    aims = _rightmost(model, deltas)
    aims = np.where(np.isfinite(aims), aims, 0.0)
    try:
        at = directions(model, deltas, aims)
        for _ in range(AXIS_ROUNDS):
            now = deltas[going]
            aim = _least_move(layout, now, at, np.zeros(len(now)))
            tried = (now[:, None] + FRACTIONS[None, :, None, None] * (aim - now)[:, None]).reshape(-1, *now.shape[1:])
            back, at = np.repeat(now, trials, axis=0), Directions(*(np.repeat(part, trials, axis=0) for part in at))
            start, poles = at.pole, at.pole + np.einsum("km,kmp,kp->k", at.row, tried - back, at.x)
            for _ in range(3):
                at = _by_inverse_iteration(model, tried, poles, at)
                tried, poles = _scaled_to_axis(tried, at), at.pole
            at = _by_inverse_iteration(model, tried, poles, at)
            close = np.abs(at.pole.real) <= 1e-7 * np.maximum(np.abs(start), 1e-9 * np.abs(model.A).max())
            reached = np.where(close, layout.sizes(tried).max(axis=1), np.inf).reshape(-1, trials)
            best = reached.argmin(axis=1) + trials * np.arange(len(going))
            better = reached.min(axis=1) < norm[going] * (1 - LEAST_AXIS_DESCENT)
            best, going = best[better], going[better]
            if not len(going):
                break
            deltas[going], norm[going] = tried[best], reached.min(axis=1)[better]
            at = Directions(*(part[best] for part in at))
    except np.linalg.LinAlgError:
        pass
    return deltas


class Directions(NamedTuple):
    """A pole of each Delta, its left and right eigenvectors, ``u v = 1``, and row, x with ``d pole = row dDelta x``."""

    pole: ComplexArray
    u: ComplexArray
    v: ComplexArray
    row: ComplexArray
    x: ComplexArray


def directions(model: StateSpaceModel, deltas: ComplexArray, aims: ComplexArray) -> Directions:
    """Return those of the pole next to each aim."""
    a, loop_inverse = _closed(model, deltas)
    if not np.isfinite(a).all():
        raise np.linalg.LinAlgError("ill-posed")
    values, right = np.linalg.eig(a)
    k = np.abs(values - aims[:, None]).argmin(axis=1)
    index = np.arange(len(deltas))
    # Rows of V^-1 are the left eigenvectors with u v = 1; the shift keeps defective cases solvable.
    u: Any = np.linalg.inv(right + 1e-13 * np.eye(right.shape[-1]))[index, k]
    v = right[index, :, k]
    return Directions(values[index, k], u, v, *_gradient(model, deltas, loop_inverse, u, v))


def _by_inverse_iteration(
    model: StateSpaceModel, deltas: ComplexArray, aims: ComplexArray, before: Directions
) -> Directions:
    """As `directions`, by two steps from the former eigenvectors: a tenth of the work."""
    u, v = before.u, before.v
    a, loop_inverse = _closed(model, deltas)
    if not np.isfinite(a).all():
        raise np.linalg.LinAlgError("ill-posed")
    eye = np.eye(model.n_states)
    # The shift keeps the matrix regular where the aim is exact.
    aims = aims + 1e-9 * (1 + 1j) * (np.abs(aims) + 1e-6 * np.abs(a).max(axis=(1, 2)))
    inverse = np.linalg.inv(a - aims[:, None, None] * eye)
    for _ in range(2):
        v, _ = unit_rows((inverse @ v[..., None])[..., 0], v)
        u, _ = unit_rows((u[:, None, :] @ inverse)[:, 0], u)
    inner = (u * v).sum(axis=1)
    u = u / np.where(np.abs(inner) < 1e-10, 1e-10, inner)[:, None]
    pole = ((u[:, None, :] @ a)[:, 0] * v).sum(axis=1)
    pole = np.where(np.abs(inner) < 1e-10, aims, pole)
    return Directions(pole, u, v, *_gradient(model, deltas, loop_inverse, u, v))


def _gradient(
    model: StateSpaceModel, deltas: ComplexArray, inverse: ComplexArray | None, u: ComplexArray, v: ComplexArray
) -> tuple[ComplexArray, ComplexArray]:
    """Return row (k, q) and x (k, p) with ``d pole = row dDelta x``, from the eigenvectors with ``u v = 1``."""
    x, row = v @ model.C.T, u @ model.B
    if inverse is None:
        return row, x
    # (I - Delta D)^-1 = I + Delta (I - D Delta)^-1 D
    return row + ((row[:, None, :] @ deltas) @ inverse)[:, 0] @ model.D, (inverse @ x[..., None])[..., 0]


def _least_move(layout: DeltaLayout, deltas: ComplexArray, at: Directions, goal: Array) -> ComplexArray:
    """Return the Delta of least norm that, to first order, puts the real part of the pole at ``goal``."""
    gains = layout.gains(at.row, at.x)
    now = np.einsum("km,kmp,kp->k", at.row, deltas, at.x)
    strength = np.where(layout.real, np.abs(gains.real), np.abs(gains)).sum(axis=1)
    tau = np.maximum((goal - at.pole.real + now.real) / np.maximum(strength, 1e-300), 0.0)
    unit = np.where(layout.real, np.sign(gains.real), np.conj(gains) / np.maximum(np.abs(gains), 1e-300))
    return layout.deltas(tau[:, None] * unit, at.row, at.x)


def _scaled_to_axis(deltas: ComplexArray, at: Directions) -> ComplexArray:
    """Make a Newton step on the size of Delta."""
    slope = np.einsum("km,kmp,kp->k", at.row, deltas, at.x).real
    factor = 1 - at.pole.real / np.where(np.abs(slope) < 1e-300, 1e-300, slope)
    return deltas * np.clip(factor, 0.5, 2.0)[:, None, None]


# --- ascent of modes --------------------------------------------------------------------------------------------------

# max Re lambda_k(A + B Delta (I - D Delta)^-1 C) over |delta_i| <= s, by quasi-Newton steps with the exact
# derivative. Where modes are lightly damped, two that meet inside the box may exchange their damping there, and paths
# from the nominal poles, as in pole_migration, miss it: on chains of 24 masses (benchmarks/mu.py) gaps are 11 and 55 %
# without this search and 5 % with it. The result for one mode is a local maximum among many, so the search restarts
# from the best of each with a few parameters redrawn, more often for less damped modes (iterated local search,
# Lourenço, Martin, Stützle 2003). A mode is identified by its frequency, because the one of largest real part is nearly
# always the slowest. Branch and bound makes the same ascent from the centres of regions.

REACH = 0.99  # size of the box of the search, relative to the smallest known member
FAILED = 5  # unsuccessful ascents in a box, for each mode, that end a chain of them
CHAINS = 3  # consecutive unsuccessful chains that end the search
LEAST_DAMPED = 5  # modes that are restarted more often than the others
REDRAWN = 3  # most parameters redrawn for a restart
FIRST = 0.3  # share of the way to its own corner at which a nominal mode begins
SHRINKING = (0.05, 0.01)  # shares by which the box shrinks around a mode that has crossed the axis
STEPS = 30  # quasi-Newton steps of one ascent


class Ascent(NamedTuple):
    """Entries (n_blocks,) of the member at the end of an ascent, its pole, and the number of members evaluated."""

    values: Array
    pole: complex
    looks: int


def _mode_next_to(
    model: StateSpaceModel, blocks: Sequence[Block], values: Array, aim: complex
) -> tuple[complex, Array] | None:
    """Return the pole next to ``aim`` of the member with these entries, and the derivatives of its real part."""
    delta = centre_matrix(blocks, values)
    a = np.real(_closed(model, delta.astype(complex))[0])
    if not np.isfinite(a).all():
        return None
    poles, right = np.linalg.eig(a)
    k = int(np.argmin(np.abs(poles - aim)))
    left = np.linalg.solve(right.T + 1e-13 * np.eye(len(poles)), np.eye(len(poles))[k])
    z, w = model.C @ right[:, k], model.B.T @ left
    if model.D.any():
        z = np.linalg.solve(np.eye(model.n_outputs) - model.D @ delta, z)
        w = np.linalg.solve(np.eye(model.n_inputs) - (delta @ model.D).T, w)
    pairs = zip(blocks, block_slices(blocks), strict=True)
    return complex(poles[k]), np.array([(w[i] * z[j]).sum().real if b.interval else 0.0 for b, (i, j) in pairs])


def member_poles(model: StateSpaceModel, blocks: Sequence[Block], values: Array) -> ComplexArray:
    """Return the poles of the member with these entries (n_blocks,); one at infinity where it is ill-posed."""
    a = np.real(_closed(model, centre_matrix(blocks, values).astype(complex))[0])
    return np.linalg.eigvals(a).astype(complex) if np.isfinite(a).all() else np.array([complex(np.inf)])


def member_work(model: StateSpaceModel, members: int) -> int:
    """Return the measured work of this number of members: eigenvalues with the vectors of one of them."""
    return members * dense(model.n_states) // 4


def ascended(model: StateSpaceModel, blocks: Sequence[Block], start: Array, size: float, aim: complex) -> Ascent | None:
    """Maximise the real part of the pole next to the aim by quasi-Newton steps from ``start`` in a box of this size."""
    from scipy.optimize import minimize

    first = _mode_next_to(model, blocks, start, aim)
    if first is None:
        return None
    unit = max(abs(first[0].real), 1e-9 * abs(first[0]))
    place = aim

    def damping(point: Array) -> tuple[float, Array]:
        nonlocal place
        now = _mode_next_to(model, blocks, point * size, place)
        if now is None:  # worst value: the line search turns back
            return 1e3, np.zeros(len(point))
        place = 1j * now[0].imag
        return -now[0].real / unit, -now[1] * size / unit

    bounds = [(float(low), 1.0) for low in lowest(blocks)]
    found = minimize(damping, start / size, jac=True, method="L-BFGS-B", bounds=bounds, options={"maxiter": STEPS})
    return Ascent(found.x * size, complex(-found.fun * unit, abs(place.imag)), 1 + found.nfev)


def shrunk(
    model: StateSpaceModel, blocks: Sequence[Block], values: Array, worst: Destabilising, budget: Budget
) -> Destabilising:
    """Shrink an unstable member along its mode and move it onto the axis; return it, or ``worst`` if not smaller."""
    low = lowest(blocks)
    for step in SHRINKING:
        while _work_left(budget):
            poles, smaller = member_poles(model, blocks, values), gauge(blocks, values) * (1 - step)
            aim = 1j * abs(float(poles[poles.real.argmax()].imag))
            found = ascended(model, blocks, np.clip(values, smaller * low, smaller), smaller, aim)
            budget.spend(member_work(model, 2 if found is None else 1 + found.looks))
            if found is None or found.pole.real <= 0:
                break
            values = found.values
    delta = centre_matrix(blocks, values).astype(complex)
    lower = [descended(model, delta_layout(blocks), delta[None])[0]] if all(b.interval for b in blocks) else []
    for candidate in (*lower, delta):
        crossing = first_crossing(model, blocks, candidate)
        if crossing is not None and member_size(blocks, crossing) < member_size(blocks, worst):
            return crossing
    return worst


def member_size(blocks: Sequence[Block], member: Destabilising) -> float:
    """Return the size of the smallest set that holds this member."""
    return gauge(blocks, block_entries(blocks, member.delta))


def _work_left(budget: Budget) -> bool:
    """Return whether work is left; record only the end by a time limit."""
    return budget.left > 0 and not (budget.seconds_left <= 0 and budget.over)


def smaller_destabilising(
    model: StateSpaceModel, blocks: Sequence[Block], worst: Destabilising, budget: Budget, seed: int = 0
) -> Destabilising:
    """Return a destabilising Delta of real blocks that is smaller than ``worst``, or ``worst`` where none was found."""
    rng, low, in_vain = np.random.default_rng(seed), lowest(blocks), 0
    nominal = model.poles()
    frequencies = np.sort(nominal.imag[nominal.imag > 0])
    slopes = [_mode_next_to(model, blocks, np.zeros(len(blocks)), 1j * w) for w in frequencies]
    corners = [FIRST * np.where(s is not None and s[1] < 0, low, 1.0) for s in slopes]
    if np.isfinite(worst.pole):
        worst = shrunk(model, blocks, block_entries(blocks, worst.delta) * (1 + 1e-9), worst, budget)
    while in_vain < CHAINS and _work_left(budget):
        size = member_size(blocks, worst)
        box = size * REACH
        best: dict[int, tuple[float, Array]] = {}  # of each mode its least damping in this box, and where
        for k in range((1 + FAILED) * len(corners)):
            if not _work_left(budget) or (k >= len(corners) and not best):
                break
            if k < len(corners):
                mode, point = k, corners[k]
            else:
                order = sorted(best, key=lambda mode: best[mode][0])
                mode = order[min(int(rng.exponential(LEAST_DAMPED)), len(order) - 1)]
                point = best[mode][1].copy()
                redrawn = rng.permutation(len(point))[: rng.integers(1, REDRAWN + 1)]
                point[redrawn] = rng.uniform(low[redrawn], 1.0)
            poles = member_poles(model, blocks, box * point)
            upper = np.sort(poles.imag[poles.imag > 0])
            found = ascended(model, blocks, box * point, box, 1j * upper[mode]) if mode < len(upper) else None
            budget.spend(member_work(model, 2 if found is None else 1 + found.looks))
            if found is None:
                continue
            damping = -found.pole.real / max(abs(found.pole), 1e-300)
            if mode not in best or damping < best[mode][0]:
                best[mode] = damping, found.values / box
            if found.pole.real > 0:
                worst = shrunk(model, blocks, found.values, worst, budget)
                break
        in_vain = 0 if member_size(blocks, worst) < size else in_vain + 1
    return worst
