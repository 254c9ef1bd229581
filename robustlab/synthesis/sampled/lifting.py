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
class LiftedPlant:
    """The plant over whole periods.

    w0 is the part of w of mean zero: it moves the state at the end of a period by ``kick v`` with ``|v| <= |w0|``.
    """

    # Discrete model with inputs [w of all intervals; held w; kick (n); u] and outputs [means of z; rests of z; y];
    # its states are those of the plant and the delayed controls.
    model: StateSpaceModel
    n_intervals: int
    n_means: int  # sizes of the first two groups of outputs
    n_rests: int
    n_w: int  # of the first two groups of inputs together, and of the kick
    n_kick: int
    n_meas: int
    n_con: int
    held: tuple[int, ...]  # positions of the disturbances that are constant over whole periods
    to_mean: float  # largest gains from w0 to the means, and to the rests, of z in the same period
    to_rest: float

    def generalized_plant(self) -> GeneralizedPlant:
        """Return the discrete plant for synthesis: without the kick."""
        names = self.model.input_names
        keep = [*names[: self.n_w], *names[self.n_w + self.n_kick :]]
        return GeneralizedPlant(self.model.select(keep), self.n_meas, self.n_con)


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
    ends = np.linspace(0.0, dt, n_intervals + 1)
    if part and np.abs(ends - part).min() > 1e-9 * dt:
        ends = np.sort(np.append(ends, part))
    # Lengths that differ by rounding alone are computed once.
    steps = {float(f"{h:.9g}"): h for h in np.diff(ends).tolist()}
    made = {key: _Interval.of(m, free, n_z, h) for key, h in steps.items()}
    intervals = [made[float(f"{h:.9g}")] for h in np.diff(ends).tolist()]
    # The state at the start of each interval as a linear map of (x, past controls, all w, u).
    N, n_free = len(intervals), len(free)
    n_x = n + n_past * n_u
    at_u = n_x + N * n_free + len(held)
    width = at_u + n_u
    # the controls of k samples ago as maps of (x, past controls, all w, u)
    aged = [np.eye(n_u, width, k) for k in (at_u, *range(n, n_x, n_u))]
    held_w = np.zeros((n_w, width))
    held_w[held, at_u - len(held) : at_u] = np.eye(len(held)) / np.sqrt(dt)
    state, means, rests = np.eye(n, width), [], []
    controls = [aged[whole + bool(end < part * (1 - 1e-12))] for end in ends[:-1]]
    for i, (step, control) in enumerate(zip(intervals, controls, strict=True)):
        disturbance = held_w.copy()
        disturbance[free, n_x + i * n_free : n_x + (i + 1) * n_free] = np.eye(n_free) / np.sqrt(step.h)
        v = np.vstack([state, disturbance, control])
        means.append(step.mean @ v)
        rests.append(step.variance_root @ v)
        state = step.move @ v
    measured = m.C[n_z:] @ np.eye(n, width) + m.D[n_z:, n_w:] @ controls[0] + m.D[n_z:, :n_w] @ held_w
    kick, to_mean, to_rest = _rest(intervals, n, m.D[:n_z, free])
    rows = np.vstack(rests)  # or, with the same Gram matrix, no more rows than columns
    rows = rows if len(rows) <= width else np.asarray(np.linalg.qr(rows, mode="r"))
    states, out = np.vstack([state, *aged[:-1]]), np.vstack([*means, rows, measured])
    kick = np.vstack([kick, np.zeros((n_x - n, n))])
    past = [f"{s.name} {k + 1} samples ago" for k in range(n_past) for s in plant.controls]
    wide = [f"{m.input_names[j]}[{i}]" for i in range(N) for j in free] + [m.input_names[j] for j in held]
    outputs = [f"{s}[{i}]" for i in range(N) for s in m.output_names[:n_z]]
    outputs += [f"rest{i + 1}" for i in range(len(rows))]
    model = StateSpaceModel(
        states[:, :n_x], np.hstack([states[:, n_x:at_u], kick, states[:, at_u:]]), out[:, :n_x],
        np.hstack([out[:, n_x:at_u], np.zeros((len(out), n)), out[:, at_u:]]), dt,
        [*wide, *[f"kick{i + 1}" for i in range(n)], *plant.controls], [*outputs, *plant.measurements],
        [*m.state_names, *past], where="lifting",
    )  # fmt: skip
    sizes = N, N * n_z, len(rows), len(wide), n, n_y, n_u
    return LiftedPlant(model, *sizes, tuple(held.tolist()), to_mean, to_rest)


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


def _rest(intervals: list[_Interval], n: int, D11: AnyArray) -> tuple[AnyArray, float, float]:
    """Return the kick and both gains of `LiftedPlant`."""
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
    return _root(gram).T, gains[0], gains[1] + direct
