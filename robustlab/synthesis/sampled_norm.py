r"""The H-infinity norm of a loop of continuous plant, sampler, digital controller and hold, between the samples too.

The plant with sampler and hold is a discrete one over whole sample periods (lifting). On each interval of a period w is
its mean plus a rest of mean zero, and z likewise. With Q the mean and Q' = I - Q, :math:`\|T Q\|` bounds the norm from
below, and the norm of the 2 x 2 matrix of the gains of Q T Q, Q T Q', Q' T Q, Q' T Q' from above. Chen, Francis (1995),
chapters 8, 10, 13; Bamieh, Pearson (1992).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from robustlab.arrays import AnyArray
from robustlab.budget import one_thread
from robustlab.checks import number
from robustlab.display import Facts, listed
from robustlab.display import number as in_words
from robustlab.errors import InputError, NoTrustworthyNumber, error_context
from robustlab.norms import HinfNorm, PeakGain, hinf_norm
from robustlab.result import Status
from robustlab.statespace import StateSpaceModel, as_model, lower_lft, series
from robustlab.synthesis.problem.certify import certified
from robustlab.synthesis.problem.generalized_plant import GeneralizedPlant, as_generalized_plant, require_performance

INTERVALS = (2, 4, 8, 16, 32, 64)  # of a period, tried in this order until the bracket is closed
MOST_LIFTED = 256  # lifted disturbance or performance channels at most: norms cost their cube
LONGEST_DELAY = 1000  # samples: each is a state of every control
SHORT = 1e-3  # |A| h below which doubling starts; smaller: more doublings
DOUBLINGS = 12  # at least; the error of the start falls by 4 in each


@dataclass(frozen=True, eq=False)
class SampledDataNorm(PeakGain):
    """Norm of a sampled-data loop as a bracket, ``lower <= norm <= upper``.

    ``lower`` is the gain of a disturbance that is constant on the intervals, ``upper`` for all; both are inf where
    the loop is not stable. CERTIFIED: the bracket is proved and closed to the requested tolerance. CONVERGED: ``lower``
    has settled to it, the proved bracket is wider. INACCURATE: neither.
    """

    frequency: float  # in rad/s, from 0 to pi / dt, of the loop over whole periods, at which `lower` is attained
    n_intervals: int  # of a period in the end
    history: tuple[tuple[int, float, float], ...]  # `(n_intervals, lower, upper)` of every step
    # The discrete closed loop over whole periods, whose norm is `lower`: from means of w to means and rests of z.
    loop: StateSpaceModel
    held: tuple[str, ...]  # disturbances that change at the samples only, because they reach the sampler directly
    reason: str = ""  # why it is not certified, or infinite; else empty

    unsaved: ClassVar[tuple[str, ...]] = ("loop",)
    unstable: ClassVar[str] = "infinite: the loop is not stable"

    @property
    def value(self) -> float:
        return self.upper

    def evidence(self) -> Facts:
        return [
            ("sample time", in_words(self.loop.dt, "s")),
            ("intervals of a period", str(self.n_intervals)),
            ("taken as constant between samples", listed(self.held)),
            ("reason", self.reason),
        ]


@error_context("sampled_data_norm")
def sampled_data_norm(
    plant: Any,
    K: Any,
    *,
    delay: float = 0.0,
    antialiasing: float | None = None,
    n_meas: int | None = None,
    n_con: int | None = None,
    rtol: float = 1e-2,
) -> SampledDataNorm:
    """Bound the H-infinity norm from w to z of a continuous plant with a digital controller, also between samples.

    The measurements are sampled at ``k dt``, the controls change at ``k dt + delay`` and are held (zero order).

    Parameters
    ----------
    plant, n_meas, n_con
        Continuous generalised plant, and for a plain one its numbers of measurements and controls (see `hinf`).
    K
        Discrete controller, ``u = K y``; its dt is the sample time.
    delay, antialiasing
        Computational delay in s, of any length; corner frequency in rad/s of a first-order low-pass filter before the
        sampler, on every measurement that w or u reach directly. With it w is any disturbance of finite energy; where
        left out, those that reach the sampler directly change at the samples only (``held`` names them).
    rtol
        Relative width of the bracket that ends the refinement.

    Returns
    -------
    SampledDataNorm
        The bracket, the frequency of the peak, and the loop over whole periods.

    Raises
    ------
    InputError
        A discrete plant, a continuous K, sizes that do not fit, a negative delay, a loop that is not well posed.

    Examples
    --------
    >>> P = StateSpaceModel([[-1.0]], [[1.0, 1.0]], [[1.0], [1.0]], [[0, 0], [0, 0]])  # x' = -x + w + u, z = y = x
    >>> norm = sampled_data_norm(P, StateSpaceModel([], [], [], [[-3.0]], 0.01), n_meas=1, n_con=1)
    >>> norm.status.value, 0.25 < norm.lower < norm.upper < 0.254
    ('certified', True)
    """
    where = "sampled_data_norm"
    k = as_model(getattr(K, "K", K), f"{where}: K")
    p = as_generalized_plant(plant, n_meas or k.n_inputs, n_con or k.n_outputs, where)
    require_performance(p, where)
    k = check_sampling(p, k, k.dt, delay, where)
    if not 0 < rtol < 1:
        raise InputError(where, f"rtol is {rtol}", "between 0 and 1")
    with one_thread():
        return sampled_loop_norm(with_antialiasing(p, antialiasing, where), k, delay, rtol)


def check_sampling(plant: GeneralizedPlant, K: StateSpaceModel, dt: float, delay: float, where: str) -> StateSpaceModel:
    """Require a continuous plant, a positive sample time, no negative delay; return the controller that fits."""
    if plant.model.dt:
        raise InputError(where, f"the plant has dt = {plant.model.dt:g} s", "a continuous plant (dt = 0)")
    number(f"{where}: sample time", dt, "a positive time in s", "discretise the controller first", above=0)
    if not 0 <= delay <= LONGEST_DELAY * dt:
        raise InputError(where, f"delay is {delay}", f"a time in s, not negative, of at most {LONGEST_DELAY} samples")
    return plant.fitted(K, where)


def with_antialiasing(plant: GeneralizedPlant, corner: float | None, where: str) -> GeneralizedPlant:
    r"""Add :math:`1 / (s / \omega_f + 1)` to the measurements that w or u reach directly (D21, D22)."""
    if corner is None:
        return plant
    if not 0 < corner < np.inf:
        raise InputError(where, f"antialiasing is {corner}", "a positive corner frequency in rad/s")
    m, n_z = plant.model, plant.n_z
    select = np.eye(m.n_outputs)[:, n_z + np.flatnonzero(m.D[n_z:].any(axis=1))]
    k = select.shape[1]
    filters = StateSpaceModel(-corner * np.eye(k), corner * select.T, select, np.eye(m.n_outputs) - select @ select.T)
    behind = series(StateSpaceModel(m.A, m.B, m.C, m.D), filters)
    return GeneralizedPlant(behind.renamed(m.inputs, m.outputs), plant.n_meas, plant.n_con, plant.blocks)


def sampled_loop_norm(
    plant: GeneralizedPlant, K: StateSpaceModel, delay: float, rtol: float, enough: float = np.inf
) -> SampledDataNorm:
    """Bound the norm with more and more intervals until the bracket is closed, or ``lower`` exceeds ``enough``."""
    K = StateSpaceModel(K.A, K.B, K.C, K.D, K.dt)
    history: list[tuple[int, float, float]] = []
    while True:
        lifted = lift(plant, K.dt, INTERVALS[len(history)], delay)
        found = _bracket(lifted, lower_lft(lifted.model, K), min(1e-4, 0.1 * rtol))
        history.append((lifted.n_intervals, found.lower, found.upper))
        lower, upper = max(h[1] for h in history), min(h[2] for h in history)
        status, reason = found.status, found.reason
        if np.isfinite(upper) and status is Status.CERTIFIED and upper > lower * (1 + rtol):
            settled = len(history) > 1 and history[-1][1] <= history[-2][1] * (1 + rtol / 3)
            status = Status.CONVERGED if settled else Status.INACCURATE
            reason = f"the proved bracket is {100 * (upper / lower - 1):.2g} % wide" if lower else "the bracket is open"
        best = replace(found, lower=lower, upper=upper, status=status, history=tuple(history), reason=reason)
        if not np.isfinite(upper) or lower > enough:
            return best
        most = len(history) == len(INTERVALS) or INTERVALS[len(history)] * max(plant.n_w, plant.n_z) > MOST_LIFTED
        if upper <= lower * (1 + rtol) or most:
            return _confirmed(best, lifted, K)


def _confirmed(norm: SampledDataNorm, lifted: LiftedPlant, K: StateSpaceModel) -> SampledDataNorm:
    """Return the norm; INACCURATE unless that of the lifted plant and K as stored is proved to be in the bracket."""
    plant = lifted.generalized_plant()
    m, n_z = plant.model, plant.n_z
    few = _few_outputs(m, slice(0, n_z))
    C, D = np.vstack([few.C, m.C[n_z:]]), np.vstack([few.D, m.D[n_z:]])
    narrow = GeneralizedPlant(StateSpaceModel(m.A, m.B, C, D, m.dt), plant.n_meas, plant.n_con)
    proof = certified(narrow, K, HinfNorm(norm.lower, norm.upper, norm.frequency, norm.status), norm.upper)
    return replace(norm, upper=proof.gamma, status=Status.INACCURATE, reason=proof.doubt) if proof.doubt else norm


def _bracket(lifted: LiftedPlant, loop: StateSpaceModel, rtol: float) -> SampledDataNorm:
    """Return the bracket of one number of intervals."""
    n = lifted.n_w
    w, kick = slice(0, n), slice(n, loop.n_inputs)
    mean, rest, all_z = slice(0, lifted.n_means), slice(lifted.n_means, loop.n_outputs), slice(0, loop.n_outputs)

    def norm(rows: slice, columns: slice, rtol: float) -> HinfNorm:
        return hinf_norm(_few_outputs(loop, rows, columns), rtol)

    lower = norm(all_z, w, rtol)
    upper, norms = lower.upper, [lower]
    if np.isfinite(upper) and len(lifted.held) < n:  # if all of w is held, it has no rest
        norms.append(norm(mean, w, rtol))
        b, c, d = (norm(i, j, 1e-2).upper for i, j in ((mean, kick), (rest, w), (rest, kick)))
        gains = np.array([[norms[1].upper, b + lifted.to_mean], [c, d + lifted.to_rest]])
        upper = max(float(np.linalg.norm(gains, 2)), upper)
    doubtful = next((norm for norm in norms if norm.status is not Status.CERTIFIED), None)
    status = Status.CERTIFIED if doubtful is None else Status.INACCURATE
    names, reason = loop.input_names[:n], (doubtful or lower).reason
    whole, held = loop.select(names), names[n - len(lifted.held) :]
    return SampledDataNorm(lower.lower, upper, lower.frequency, status, lifted.n_intervals, (), whole, held, reason)


def _few_outputs(m: StateSpaceModel, rows: slice, columns: slice = slice(None)) -> StateSpaceModel:
    """Return a part of a model; an orthogonal transformation leaves no more outputs than states and inputs."""
    out = np.hstack([m.C[rows], m.D[rows, columns]])
    if len(out) > out.shape[1]:
        out = np.asarray(np.linalg.qr(out, mode="r"))
    return StateSpaceModel(m.A, m.B[:, columns], out[:, : m.n_states], out[:, m.n_states :], m.dt)


# --- lifting ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class LiftedPlant:
    """The plant over whole periods.

    w0 is the part of w of mean zero: it moves the state at the end of a period by ``kick v`` with ``|v| <= |w0|``.
    """

    # Discrete model with inputs [w of all intervals; held w; kick (n); u] and outputs [means of z; rests of z; y];
    # its states are those of the plant and the delayed controls.
    model: StateSpaceModel
    n_intervals: int
    n_means: int  # size of the first group of outputs
    n_w: int  # of the first two groups of inputs together
    n_meas: int
    n_con: int
    held: tuple[int, ...]  # positions of the disturbances that are constant over whole periods
    to_mean: float  # largest gains from w0 to the means, and to the rests, of z in the same period
    to_rest: float

    def generalized_plant(self) -> GeneralizedPlant:
        """Return the discrete plant for synthesis: without the kick."""
        names = self.model.input_names
        keep = [*names[: self.n_w], *names[-self.n_con :]]
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
    return LiftedPlant(model, N, N * n_z, len(wide), n_y, n_u, tuple(held.tolist()), to_mean, to_rest)


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
