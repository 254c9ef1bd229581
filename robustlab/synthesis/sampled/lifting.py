r"""A continuous plant with sampler and hold as a discrete one over whole sample periods (lifting).

On each interval of a period w is its mean plus a rest of mean zero, and z likewise; the effect of the rest is bounded.
Chen, Francis (1995), chapters 8, 10, 13; Bamieh, Pearson (1992).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from robustlab.arrays import AnyArray
from robustlab.errors import NoTrustworthyNumber
from robustlab.statespace import StateSpaceModel
from robustlab.synthesis.problem.partition import GeneralizedPlant

SHORT = 1e-3  # |A| h below which doubling starts; smaller: more doublings
DOUBLINGS = 12  # at least; the error of the start falls by 4 in each


@dataclass(frozen=True, eq=False)
class Rest:
    """Bounds of the effect of w0, the part of w of mean zero."""

    kick: AnyArray  # factor (n, n): w0 moves the state at the end of a period by `kick v` with `|v| <= |w0|`
    # mean, variance: largest gains from w0 to the means, and to the rests, of z in the same period
    mean: float
    variance: float


@dataclass(frozen=True, eq=False)
class LiftedPlant:
    """The plant over whole periods."""

    # Discrete model with inputs [w of all intervals; held w; kick (n); u] and outputs [means of z; rests of z; y];
    # its states are those of the plant and the delayed controls.
    model: StateSpaceModel
    # n_intervals, n_means, n_rests: number of intervals; sizes of the two groups of outputs
    n_intervals: int
    n_means: int
    n_rests: int
    # n_w, n_kick: sizes of the first two groups of inputs together, and of the kick
    n_w: int
    n_kick: int
    # n_meas, n_con: sizes of y and u
    n_meas: int
    n_con: int
    held: tuple[int, ...]  # positions of the disturbances that are constant over whole periods
    rest: Rest  # bounds of the effect of w less its means

    def generalized_plant(self) -> GeneralizedPlant:
        """Return the discrete plant for synthesis: without the kick."""
        keep = [*range(self.n_w), *range(self.n_w + self.n_kick, self.model.n_inputs)]
        m = self.model
        inputs = [m.inputs[i] for i in keep]
        model = StateSpaceModel(
            m.A, m.B[:, keep], m.C, m.D[:, keep], m.dt, inputs, m.outputs, m.states, where="lifting"
        )
        return GeneralizedPlant(model, self.n_meas, self.n_con)


def lift(plant: GeneralizedPlant, dt: float, n_intervals: int, delay: float = 0.0) -> LiftedPlant:
    """Lift the plant with its controls held from ``k dt + delay`` on."""
    m = plant.model
    n, n_u, n_y = m.n_states, plant.n_con, plant.n_meas
    n_w, n_z = m.n_inputs - n_u, m.n_outputs - n_y
    held = np.flatnonzero(m.D[n_z:, :n_w].any(axis=0))
    free = np.setdiff1d(np.arange(n_w), held)
    # Controls act a delay after their sample: delayed ones are states.
    whole = int(np.floor(delay / dt + 1e-12))
    part = delay - whole * dt if delay - whole * dt > 1e-9 * dt else 0.0
    n_past = whole + (part > 0)
    ends = _breakpoints(dt, n_intervals, part)
    past = [f"{s.name} {k + 1} samples ago" for k in range(n_past) for s in plant.controls]
    names = [*m.state_names, *past]
    lengths = _lengths(ends)
    steps = {h: _Interval.of(m, free, n_z, h) for h in lengths}
    intervals = [steps[h] for h in lengths]
    # The state at the start of each interval as a linear map of (x, past controls, all w, u).
    N = len(intervals)
    n_free = len(free)
    at_w = n + n_past * n_u
    at_u = at_w + N * n_free + len(held)
    width = at_u + n_u
    # the controls of k samples ago as maps of (x, past controls, all w, u)
    aged = [np.eye(n_u, width, k) for k in (at_u, *range(n, at_w, n_u))]
    held_w = np.zeros((n_w, width))
    held_w[held, at_u - len(held) : at_u] = np.eye(len(held)) / np.sqrt(dt)
    state, means, rests = np.zeros((n, width)), [], []
    state[:, :n] = np.eye(n)
    controls = [aged[whole + bool(end < part * (1 - 1e-12))] for end in ends[:-1]]
    for i, (step, control) in enumerate(zip(intervals, controls, strict=True)):
        disturbance = held_w.copy()
        disturbance[free, at_w + i * n_free : at_w + (i + 1) * n_free] = np.eye(n_free) / np.sqrt(step.h)
        v = np.vstack([state, disturbance, control])
        means.append(step.mean @ v)
        rests.append(step.variance_root @ v)
        state = step.move @ v
    measured = np.zeros((n_y, width))
    measured[:, :n] = m.C[n_z:]
    measured += m.D[n_z:, n_w:] @ controls[0] + m.D[n_z:, :n_w] @ held_w
    rest = _rest(intervals, n, m.D[:n_z, free])
    rows = np.vstack(rests)  # or, with the same Gram matrix, no more rows than columns
    rows = rows if len(rows) <= width else np.asarray(np.linalg.qr(rows, mode="r"))
    maps = np.vstack([state, *aged[:-1]]), np.vstack(means), rows, measured
    wide = [f"{m.input_names[j]}[{i}]" for i in range(N) for j in free] + [m.input_names[j] for j in held]
    return _assembled(plant, dt, (names, wide), maps, N, rest, tuple(int(j) for j in held))


def _breakpoints(dt: float, n_intervals: int, part: float) -> AnyArray:
    ends = np.linspace(0.0, dt, n_intervals + 1)
    if part and np.abs(ends - part).min() > 1e-9 * dt:
        ends = np.sort(np.append(ends, part))
    return ends


def _lengths(ends: AnyArray) -> list[float]:
    """Return the lengths of the intervals; those that differ by rounding alone become equal."""
    lengths: list[float] = []
    for h in np.diff(ends).tolist():
        same = [known for known in lengths if abs(known - h) <= 1e-9 * known]
        lengths.append(same[0] if same else h)
    return lengths


def _assembled(
    plant: GeneralizedPlant,
    dt: float,
    names: tuple[list[str], list[str]],
    maps: tuple[AnyArray, AnyArray, AnyArray, AnyArray],
    N: int,
    rest: Rest,
    held: tuple[int, ...],
) -> LiftedPlant:
    """Build the lifted model from its maps of (states, lifted w, u) to (next states, means, rests, y)."""
    m, n = plant.model, plant.model.n_states
    states, means, rests, measured = maps
    n_x, n_wide = len(names[0]), len(names[1])
    x, w, u = slice(0, n_x), slice(n_x, n_x + n_wide), slice(n_x + n_wide, None)
    rows = np.vstack([means, rests, measured])
    kick = np.vstack([rest.kick, np.zeros((n_x - n, n))])
    performance = m.output_names[: m.n_outputs - plant.n_meas]
    outputs = [*[f"{s}[{i}]" for i in range(N) for s in performance], *[f"rest{i + 1}" for i in range(len(rests))]]
    model = StateSpaceModel(
        states[:, x], np.hstack([states[:, w], kick, states[:, u]]), rows[:, x],
        np.hstack([rows[:, w], np.zeros((len(rows), n)), rows[:, u]]), dt,
        [*names[1], *[f"kick{i + 1}" for i in range(n)], *plant.controls], [*outputs, *plant.measurements], names[0],
        where="lifting",
    )  # fmt: skip
    return LiftedPlant(model, N, len(means), len(rests), n_wide, n, plant.n_meas, plant.n_con, held, rest)


# --- one interval -----------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Interval:
    """Maps of one interval of length h from v = (x, w, u) at its start, w and u constant."""

    h: float
    move: AnyArray  # v -> x at the end
    mean: AnyArray  # v -> mean of z times sqrt(h)
    variance_root: AnyArray  # |variance_root v|^2: energy of z about its mean
    kick: AnyArray  # factor of the effect of w0 on x at the end
    output: tuple[AnyArray, AnyArray]  # mean and variance root of z for x alone
    local: float  # bound of the gain from w0 to z within the interval without D11

    @classmethod
    def of(cls, m: StateSpaceModel, free: AnyArray, n_z: int, h: float) -> _Interval:
        n = m.n_states
        generator = np.zeros((n + m.n_inputs,) * 2)
        generator[:n] = np.hstack([m.A, m.B])
        out = np.hstack([m.C[:n_z], m.D[:n_z]])
        moved, mean, variance = mean_and_variance(generator, out, h)
        b = m.B[:, free]
        _, _, kernel = mean_and_variance(m.A.T, b.T, h)
        root = _root(variance)
        energy = mean[:, :n].T @ mean[:, :n] + variance[:n, :n]
        local = float(np.sqrt(h * max(float(np.trace(b.T @ energy @ b)), 0.0)))
        return cls(h, moved[:n], mean, root, _root(kernel).T, (mean[:, :n], _root(variance[:n, :n])), local)


def mean_and_variance(A: AnyArray, C: AnyArray, h: float) -> tuple[AnyArray, AnyArray, AnyArray]:
    r"""Return ``e^(A h)``, the mean of ``C e^(A t)`` over [0, h] times :math:`\sqrt h`, and its variance times h."""
    from scipy.linalg import expm

    n = len(A)
    size = float(np.linalg.norm(A, 1)) * h if n else 0.0
    doublings = max(DOUBLINGS, int(np.ceil(np.log2(max(size, 1e-300) / SHORT))))
    # series of e^(A t) up to the third power, and a first-order formula for the variance
    small = h / 2.0**doublings
    step = A * small
    moved = expm(step)
    series = np.eye(n) + step @ (np.eye(n) / 2 + step @ (np.eye(n) / 6 + step / 24))
    mean = np.sqrt(small) * C @ series
    slope = C @ A
    variance = small**3 / 12 * slope.T @ slope
    with np.errstate(over="ignore", invalid="ignore"):
        for k in range(1, doublings + 1):
            later = mean @ moved
            change = mean - later
            variance = variance + moved.T @ variance @ moved + 0.5 * change.T @ change
            mean = (mean + later) / np.sqrt(2)
            moved = expm(A * (h / 2.0 ** (doublings - k)))  # not by squaring: errors would double each time
    if not (np.isfinite(moved).all() and np.isfinite(variance).all()):
        raise NoTrustworthyNumber("lifting", f"e^(A t) overflows within {h:g} s", "a shorter sample time")
    return moved, mean, variance


def _root(gram: AnyArray) -> AnyArray:
    """Return R (n, n) with ``R^T R = gram``; negative eigenvalues are rounding."""
    values, vectors = np.linalg.eigh(0.5 * (gram + gram.T))
    return np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T


def _rest(intervals: list[_Interval], n: int, D11: AnyArray) -> Rest:
    gram = np.zeros((n, n))
    later_mean, later_rest = np.zeros((len(intervals),) * 2), np.zeros((len(intervals),) * 2)
    for i, step in enumerate(intervals):
        reach = step.kick
        for j in range(i + 1, len(intervals)):
            mean, root = intervals[j].output
            later_mean[j, i], later_rest[j, i] = np.linalg.norm(mean @ reach), np.linalg.norm(root @ reach)
            reach = intervals[j].move[:, :n] @ reach
        gram += reach @ reach.T
    local = max((step.local for step in intervals), default=0.0)
    direct = float(np.linalg.norm(D11, 2)) if D11.size else 0.0
    gains = [float(np.linalg.norm(later, 2)) + local for later in (later_mean, later_rest)]
    return Rest(_root(gram).T, gains[0], gains[1] + direct)
