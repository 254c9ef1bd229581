r"""Kalman smoother for states and unknown force d along a record: d is a random walk at the ports of the model,
observable below the bandwidth f by its intensity. Bandwidths and noise maximise the likelihood of the innovations
(Kailath, Sayed, Hassibi, *Linear Estimation*, 2000).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from robustlab.arrays import Array
from robustlab.dynamics.simulation import transition
from robustlab.errors import InputError, NoTrustworthyNumber
from robustlab.result import Evidence
from robustlab.statespace import StateSpaceModel

if TYPE_CHECKING:
    from robustlab.identification.greybox.smoother_kernels import Filter

WHERE = "smooth_disturbance"

GRID = 9  # bandwidths tried before the search
HIGHEST = 0.1  # bandwidth over the sample rate: noise that was filtered before storage would need more
START_HORIZON = 30  # samples in which a state of its prior's size would move the outputs by START_FACTOR ranges
START_FACTOR = 10.0
ROUNDING = 1e-13  # of the prior's size: noise in every state and sample
SMALLEST_NOISE = 1e-12  # of an output's range
NODES = 8


@dataclass(frozen=True)
class SmoothedRecord(Evidence):
    """States and forces given the whole record."""

    t: Array  # clock in s, (n,)
    # x, x_std: states and their standard deviations, (n, n_x), relative to the model's operating point. A state that
    # the outputs do not determine has its prior std (much larger than the record's range).
    x: Array
    x_std: Array
    covariance: Array  # joint covariance of the states at each sample, (n, n_x, n_x)
    # d, d_std: force at each port and its standard deviation, (n, m), in the unit of the port
    d: Array
    d_std: Array
    noise_std: Array  # noise of each output, (n_y,)
    bandwidth: Array  # frequency in Hz up to which the record determines each force, (m,)
    log_likelihood: float  # of the innovations after the first n_x + m samples


def smooth_disturbance(
    model: StateSpaceModel,
    ports: ArrayLike,
    t: ArrayLike,
    u: ArrayLike,
    y: ArrayLike,
    noise_std: ArrayLike | None = None,
    bandwidth: ArrayLike | None = None,
) -> SmoothedRecord:
    """Return smoothed states and forces of a record with held inputs u; estimate noise and bandwidth (Hz) if None."""
    # ports (n_x, m): rate of the states per unit of each force. NaN in y is a missing sample.
    task = _Task(model, ports, t, u, y, noise_std)
    given = None
    if bandwidth is not None:
        given = np.log(np.broadcast_to(np.asarray(bandwidth, dtype=float), (task.m,)))
    with np.errstate(over="ignore", invalid="ignore"):
        best = _maximised(task, given, task.known_noise, task.guess)
        if not task.known_noise and (best.sigma < task.floor).any():
            best = _maximised(task, given, True, np.maximum(best.sigma, task.floor))
        mean, covariance = _smoothed(task, best)
    if not (math.isfinite(best.log_likelihood) and np.isfinite(mean).all() and np.isfinite(covariance).all()):
        raise NoTrustworthyNumber(WHERE, "the response outgrows double precision")
    n_x = model.n_states
    std = np.sqrt(np.maximum(np.diagonal(covariance, axis1=1, axis2=2), 0.0))
    return SmoothedRecord(
        task.t, mean[:, :n_x].copy(), std[:, :n_x].copy(), covariance[:, :n_x, :n_x].copy(), mean[:, n_x:].copy(),
        std[:, n_x:].copy(), best.sigma, np.exp(best.bandwidth), best.log_likelihood,
    )  # fmt: skip


def output_shares(
    model: StateSpaceModel, ports: Array, t: Array, u: Array, y: Array, smoothed: SmoothedRecord
) -> tuple[Array, Array]:
    """Return the part of each output in the smoothed states, (n_measured, n, n_x), and that of one unit more."""
    # Noise and bandwidth are fixed: the smoother is linear. Half of an output is subtracted, since a larger one would
    # raise the noise floor of a quantised output.

    def changed(j: int, output: Array) -> Array:
        other = y.copy()
        other[:, j] = output
        there = smooth_disturbance(model, ports, t, u, other, smoothed.noise_std, smoothed.bandwidth)
        return there.x - smoothed.x

    shares = [-2.0 * changed(j, 0.5 * y[:, j]) for j in range(y.shape[1])]
    sizes = [float(np.nanmax(np.abs(column))) or 1.0 for column in y.T]
    constants = [changed(j, y[:, j] + size) / size for j, size in enumerate(sizes)]
    return np.stack(shares), np.stack(constants)


class _Choice(NamedTuple):
    """Logarithms of the bandwidths, noise of the outputs, and their log-likelihood."""

    bandwidth: Array
    sigma: Array
    log_likelihood: float


# --- the problem in discrete time ------------------------------------------------------------------------------------


class _Task:
    """Problem in discrete time; z = states and forces."""

    def __init__(
        self, model: StateSpaceModel, ports: ArrayLike, t: ArrayLike, u: ArrayLike, y: ArrayLike,
        noise_std: ArrayLike | None,
    ) -> None:  # fmt: skip
        self.model, self.known_noise = model, noise_std is not None
        self.ports, self.t, u = (np.asarray(x, dtype=np.float64) for x in (ports, t, u))
        y = np.array(y, dtype=np.float64)
        self.m, n = self.ports.shape[1], len(self.t)
        n_z = model.n_states + self.m
        samples = np.isfinite(y).sum(axis=0)
        if n < 3 * n_z or samples.min(initial=n) < 3 * n_z:
            found = f"{min(n, samples.min(initial=n))} samples"
            raise InputError(WHERE, found, f"at least {3 * n_z} of every output for {n_z} states and forces")
        if model.operating_point is not None:
            u, y = u - model.operating_point.u, y - model.operating_point.y
        y = y - u @ model.D.T
        self.h = float(self.t[-1] - self.t[0]) / (n - 1)
        wide = _with_forces(model, self.ports)
        phi, gamma, _ = transition(wide, self.h)
        floor = np.maximum([resolution_of(column) / math.sqrt(12.0) for column in y.T], SMALLEST_NOISE * _size(y))
        guess = [_rough_noise(column) for column in y.T] if noise_std is None else np.asarray(noise_std, dtype=float)
        self.floor, self.guess = floor, np.maximum(guess, floor)
        self.phi, self.forced = np.ascontiguousarray(phi), np.ascontiguousarray(u @ gamma.T)
        self.H, self.y = wide.C.copy(), np.ascontiguousarray(y)
        # port_roots: L_j for q_j = 1, (m, n_z, n_z); start: prior standard deviation of z, (n_z,)
        self.port_roots = [_walk_root(wide, self.h, model.n_states + j) for j in range(self.m)]
        self.start = _prior(wide, phi, u @ gamma.T, y)


def _with_forces(model: StateSpaceModel, ports: Array) -> StateSpaceModel:
    """Append the forces as integrator states to the model."""
    n_x, m = ports.shape
    a = np.block([[model.A, ports], [np.zeros((m, n_x + m))]])
    return StateSpaceModel(
        a,
        np.vstack([model.B, np.zeros((m, model.n_inputs))]),
        np.hstack([model.C, np.zeros((model.n_outputs, m))]),
        np.zeros((model.n_outputs, model.n_inputs)),
    )


def _walk_root(wide: StateSpaceModel, h: float, place: int) -> Array:
    """Return L with L^T L = int_0^h e^{Fs} b b^T e^{F^T s} ds, b the unit vector of a force."""
    # Gauss quadrature over a step so short that it is exact to rounding, doubled up to h; the covariance itself would
    # lose half the digits of the states that the force reaches last.
    fastest = float(np.abs(wide.poles()).max(initial=0.0)) * h
    doublings = max(0, math.ceil(math.log2(fastest))) if fastest > 0 else 0
    short = h / 2.0**doublings
    nodes, weights = np.polynomial.legendre.leggauss(NODES)
    rows = [
        math.sqrt(0.5 * short * w) * transition(wide, 0.5 * short * (1.0 + s))[0][:, place]
        for s, w in zip(nodes, weights, strict=True)
    ]
    root = _compressed(np.array(rows))
    for k in range(doublings):
        root = _compressed(np.vstack([root, root @ transition(wide, short * 2.0**k)[0].T]))
    return root


def _compressed(rows: Array) -> Array:
    """Return the n x n triangle with the same R^T R."""
    n = rows.shape[1]
    missing = np.zeros((max(0, n - len(rows)), n))
    return np.asarray(np.linalg.qr(np.vstack([rows, missing]), mode="r"), dtype=np.float64)


def _size(y: Array) -> Array:
    size = np.nanmax(np.abs(y), axis=0) + (np.nanmax(y, axis=0) - np.nanmin(y, axis=0))
    return np.where(size > 0, size, 1.0)


def resolution_of(y: Array) -> float:
    """Return the smallest step between values of an output; near 0 if it is not quantised."""
    values = np.unique(y[np.isfinite(y)])
    steps = np.diff(values)
    steps = steps[steps > 1e-9 * max(abs(values[0]), abs(values[-1]))]
    return float(steps.min()) if len(steps) else 0.0


def _rough_noise(y: Array) -> float:
    """Estimate noise from third differences: white noise has 20 times its variance there, smooth motion little."""
    third = np.diff(y, 3)
    third = third[np.isfinite(third)]
    return float(np.sqrt(np.mean(third**2) / 20.0)) if len(third) else 0.0


def _prior(wide: StateSpaceModel, phi: Array, forced: Array, y: Array) -> Array:
    """Return prior standard deviations, much larger than the record's range, and finite."""
    size, n = _size(y), len(y)
    reach, row = np.zeros_like(wide.C), wide.C.copy()
    for _ in range(min(START_HORIZON, n)):
        reach = np.maximum(reach, np.abs(row))
        row = row @ phi
    with np.errstate(divide="ignore"):
        start = START_FACTOR * np.where(reach > 0, size[:, None] / reach, np.inf).min(axis=0)
    unseen = ~np.isfinite(start)
    # An unobservable state: bounded by the states that drive it over the whole record.
    for _ in range(len(start)):
        seen = np.where(np.isfinite(start), start, 0.0)
        driven = np.abs(phi - np.eye(len(phi))) @ seen * n
        start = np.where(unseen & (driven > 0), np.maximum(driven, np.where(np.isfinite(start), start, 0.0)), start)
    own = START_FACTOR * n * np.abs(forced).max(axis=0)
    start = np.where(np.isfinite(start), start, np.where(own > 0, own, 1.0))
    return np.maximum(start, 1e-150)


# --- likelihood ------------------------------------------------------------------------------------------------------


def _intensities(task: _Task, log_bandwidth: Array, sigma: Array) -> Array:
    omega = 2 * np.pi * np.exp(log_bandwidth)
    q, n_x = np.empty(task.m), task.model.n_states
    for j in range(task.m):
        gain = task.model.C @ np.linalg.solve(1j * omega[j] * np.eye(n_x) - task.model.A, task.ports[:, j])
        power = float((np.abs(gain) ** 2 / (sigma**2 * task.h)).sum())
        if not power > 0:
            raise InputError(
                f"{WHERE}: ports[:, {j}]", "no output responds to this force", "a measured output that does"
            )
        q[j] = omega[j] ** 2 / power
    return q


def _filter(task: _Task, log_bandwidth: Array, sigma: Array) -> Filter:
    from robustlab.identification.greybox.smoother_kernels import Filter

    rounding, q = np.diag(ROUNDING * task.start), _intensities(task, log_bandwidth, sigma)
    root = _compressed(np.vstack([rounding, *(math.sqrt(v) * r for v, r in zip(q, task.port_roots, strict=True))]))
    return Filter(task.phi, root, task.forced, task.H, np.array(sigma), np.diag(task.start))


def _maximised(task: _Task, given: Array | None, known: bool, sigma: Array) -> _Choice:
    """Maximise the likelihood over bandwidths and, unless the noise is known, noise ratios and a common factor."""
    from scipy.optimize import minimize

    from robustlab.identification.greybox.smoother_kernels import Kept, forward

    n_width, n_ratio = task.m if given is None else 0, 0 if known else task.model.n_outputs - 1
    low, high = math.log(0.2 / (task.h * len(task.t))), math.log(HIGHEST / task.h)  # of bandwidths in Hz
    best = _Choice(np.zeros(task.m), sigma, -np.inf)

    def cost(point: Array) -> float:
        nonlocal best
        width = np.clip(point[:n_width], low, high) if given is None else given
        noise = sigma * np.exp(np.clip(np.concatenate([[0.0], point[n_width:]]), -12.0, 12.0)) if n_ratio else sigma
        logs, squares, count = forward(_filter(task, width, noise), task.y, False, Kept.of(0, len(task.phi)))
        scale = 1.0 if known else math.sqrt(squares / count)
        value = -0.5 * (logs + (squares if known else count * (2.0 * math.log(scale) + 1.0)))
        if value > best.log_likelihood:
            best = _Choice(width, noise * scale, value)
        return -value if math.isfinite(value) else 1e300

    tried = np.linspace(low, high, GRID) if n_width else np.zeros(1)
    for width in tried:
        cost(np.concatenate([np.full(n_width, width), np.zeros(n_ratio)]))
    size = n_width + n_ratio
    if size and math.isfinite(best.log_likelihood):
        at = np.concatenate([best.bandwidth[:n_width], np.zeros(n_ratio)])
        options = {"initial_simplex": np.vstack([at, at + 0.7 * np.eye(size)]), "xatol": 0.03, "fatol": 0.1}
        minimize(cost, at, method="Nelder-Mead", options=options | {"maxfev": 40 * size})
    return best


def _smoothed(task: _Task, choice: _Choice) -> tuple[Array, Array]:
    from robustlab.identification.greybox.smoother_kernels import Kept, backward, forward

    n, n_z = len(task.t), len(task.phi)
    kept, mean, covariance = Kept.of(n, n_z), np.empty((n, n_z)), np.empty((n, n_z, n_z))
    forward(_filter(task, choice.bandwidth, choice.sigma), task.y, True, kept)
    backward(kept, mean, covariance)
    return mean, covariance
