r"""Response of a fit's windows to small forces at ports, and likelihood of the errors under a random force: errors
J delta + X eta + O f + noise, covariance sigma^2 (1 + O s^2 K_f O^T) with K_f = exp(-2 pi f |t_j - t_k|), all else
eliminated in closed form. Only each window's products G = [O J X e]^T [O J X e] are stored.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace

import numpy as np

from robustlab.arrays import Array, Indices
from robustlab.dynamics.effects.effect import Effect, EffectParameter, Law, Scales, Site
from robustlab.dynamics.extended.simulator import Simulator
from robustlab.dynamics.plant_base import NonlinearPlant
from robustlab.dynamics.ports.law_kernel import TIME, law
from robustlab.identification.greybox.effect_fit import Fit, Hypothesis, NoiseModel, Problem
from robustlab.identification.greybox.prepared_record import averaged

SEGMENTS = 60  # of a window, at most: each is a simulation per port
PULSES = 120  # of a window at all ports together, at most
PULSE = 0.02  # of the force that moves the port: small against it, large against rounding


@law
def recorded_force(p, z, z_next, seen):  # type: ignore[no-untyped-def]
    """Return the force of p = (sample time, number of samples, force at each sample of the record)."""
    return p[2 + min(int(p[1]) - 1, int(seen[TIME] / p[0] + 1e-6))]


class _RecordedForce(Effect):
    """A force, or an addition to an input, given by its samples; not in the catalogue."""

    id = "recorded-force"
    title = "Recorded force"
    equation = "f(t)"
    site_kind = "joint"
    nameable = False

    def __init__(self, dt: float) -> None:
        self.dt = dt

    def parameters(self, scales: Scales) -> tuple[EffectParameter, ...]:
        return ()

    def laws(self, site: Site, values: Mapping[str, Array]) -> tuple[Law, ...]:  # type: ignore[override]
        if site.kind == "input":
            return ()
        samples = values["samples"]
        return (Law(recorded_force, site.name, np.append([self.dt, len(samples)], samples)),)  # type: ignore[arg-type]

    def input(self, signal: Array, values: Mapping[str, Array], h: float) -> Array:  # type: ignore[override]
        return signal + np.repeat(values["samples"], len(signal) // len(values["samples"]))


@dataclass(frozen=True, eq=False)
class PortMotion:
    """Force that moves a port (RMS), its speed and position in the windows, (n_windows, length), and their units."""

    force: float
    speed: Array | None = None
    position: Array | None = None
    unit: str = ""
    speed_unit: str = ""
    position_unit: str = ""


@dataclass(frozen=True, eq=False)
class ForceResponse:
    """Response of all windows to forces at ports."""

    gram: Array  # G, (n_windows, n, n) with n = n_pulses + n_z + n_x + 1
    points: Indices  # number of known points of each window, (n_windows,)
    edges: Indices  # first sample of each segment within a window, and the end, (n_segments + 1,)
    xi: Array  # initial states of the fit, (n_windows, n_x)
    dt: float
    ports: tuple[PortMotion, ...]
    record: Indices  # of each window, (n_windows,)
    clock: Array  # time in s, the records one after the other, (n_windows, length)
    u: Array  # (n_windows, length, n_u)
    port: int = 0  # where curves of a force act

    @property
    def segments(self) -> int:
        return len(self.edges) - 1

    @property
    def pulses(self) -> int:
        return len(self.ports) * self.segments

    @property
    def own(self) -> slice:
        """Return the columns of O of the curves' port."""
        return slice(self.port * self.segments, (self.port + 1) * self.segments)

    @property
    def motion(self) -> PortMotion:
        return self.ports[self.port]

    def mean(self, values: Array) -> Array:
        """Return means over the segments of samples (n_windows, length, ...): (n_windows, n_segments, ...)."""
        width = np.diff(self.edges).reshape(1, -1, *(1,) * (values.ndim - 2))
        return np.add.reduceat(values, self.edges[:-1], axis=1) / width


def plain_places(problem: Problem, fit: Fit) -> tuple[Site, ...]:
    """Return the plant's own joints, or its inputs without any."""
    simulator = problem.simulators(fit.hypothesis)[0]
    model = simulator.model(*problem.split(fit.hypothesis, fit.z))
    joints = tuple(Site("joint", p.name) for p in model.ports.values() if p.kind == "joint" and "." not in p.name)
    return joints or tuple(Site("input", s.name) for s in problem.plant.inputs)


def force_response(problem: Problem, fit: Fit, places: Sequence[Site]) -> ForceResponse:
    """Return responses at a fit to forces at joints, or to additions to inputs."""
    records, length = problem.records, problem.records[0].windows.length
    samples = [r.samples[chosen] for r, chosen in zip(records, problem.chosen, strict=True)]
    ports = tuple(_motion(problem, fit, place, samples) for place in places)
    most = min(SEGMENTS, max(1, PULSES // len(places)))
    edges = np.unique(np.append(np.arange(0, length, -(-length // most)), length))
    parts = [_products(problem, fit, places, [p.force for p in ports], edges, at, k) for k, at in enumerate(samples)]
    grams, points = (np.concatenate(part) for part in zip(*parts, strict=True))
    before = np.cumsum([0.0, *(r.record.duration for r in records)])
    return ForceResponse(
        grams, points, edges, np.concatenate(fit.starts), records[0].record.dt, ports,
        np.repeat(np.arange(len(records)), [len(at) for at in samples]),
        np.concatenate([b + r.record.t[at] for b, r, at in zip(before, records, samples, strict=False)]),
        np.concatenate([r.u[at] for r, at in zip(records, samples, strict=True)]),
    )  # fmt: skip


def _products(
    problem: Problem, fit: Fit, places: Sequence[Site], sizes: Sequence[float], edges: Indices, samples: Indices, k: int
) -> tuple[Array, Indices]:
    """Return the products of one record's windows, and the number of their known points."""
    record, chosen, xi, length = problem.records[k], problem.chosen[k], fit.starts[k], samples.shape[1]
    noise = NoiseModel(record.sensor_noise, np.zeros((0, len(record.columns))))
    simulator = problem.quick(fit.hypothesis)[k]
    (error,) = problem.on([record], [chosen]).errors(fit.hypothesis, fit.z, [xi])
    known = np.isfinite(error).reshape(len(chosen), -1)
    over_z, over_x = problem.sensitivities(k, simulator, fit.hypothesis, (fit.z, xi), fit.z, noise, len(fit.z))
    pushed = copy(simulator)
    pushed.effects = (*simulator.effects, *((_RecordedForce(record.record.dt), place) for place in places))
    setting, nothing = problem.setting(fit.hypothesis, fit.z), np.zeros(len(record.u))

    def outputs(force: Array = nothing, at: int = 0) -> Array:
        forces = [{"samples": force if j == at else nothing} for j in range(len(places))]
        return problem.outputs(k, pushed, setting._replace(values=[*setting.values, *forces]), xi)

    def pulse(s: int, at: int) -> Array:
        force, size = nothing.copy(), PULSE * sizes[at]
        force[samples[:, edges[s] : edges[s + 1]]] = size
        return (outputs(force, at) - here) / size

    columns = []
    with np.errstate(all="ignore"):
        here, shifts = outputs(), _shifts(problem, simulator, setting.values)
        for at in range(len(places)):
            if shifts:
                first = pulse(0, at)
                ends = [np.pad(first[:, : length - e], ((0, 0), (e, 0), (0, 0))) for e in edges[:-1]]
                ends[-1] *= (edges[-1] - edges[-2]) / (edges[1] - edges[0])  # the last segment may be shorter
            else:
                ends = [pulse(s, at) for s in range(len(edges) - 1)]
            columns += [noise.whitened(averaged(response, record.thin)) for response in ends]
    columns = np.concatenate([np.stack(columns, axis=2), -over_z, -over_x, noise.whitened(error)[:, :, None]], axis=2)
    columns = columns * known[:, :, None]
    return np.swapaxes(columns, 1, 2) @ columns, known.sum(axis=1)


def _shifts(problem: Problem, simulator: Simulator, values: Sequence[Mapping[str, float]]) -> bool:
    """Return whether the response is time-invariant: a linear plant, no force law, no map of an output."""
    return not isinstance(problem.plant, NonlinearPlant) and not any(
        (site.kind == "output" and not (effect.delay and v[effect.delay] == 0.0)) or effect.laws(site, v)
        for (effect, site), v in zip(simulator.effects, values, strict=True)
    )


def _motion(problem: Problem, fit: Fit, place: Site, samples: Sequence[Indices]) -> PortMotion:
    """Return the motion of a port in the windows from the smoother."""
    if place.kind == "input":
        at = [s.name for s in problem.plant.inputs].index(place.name)
        rms = max(float(np.sqrt(np.mean(r.u[:, at] ** 2))) for r in problem.records) or 1.0
        return PortMotion(rms, unit=problem.plant.inputs[at].unit)
    factors, _ = problem.split(fit.hypothesis, fit.z)
    forces, speeds, positions = [], [], []
    ports = [s.model(factors, []).ports[place.name] for s in problem.simulators(Hypothesis(()))]
    for record, port, at in zip(problem.records, ports, samples, strict=True):
        x, covariance = record.smoothed.x, record.smoothed.covariance
        v = x @ port.velocity
        forces.append(float(np.sqrt(np.mean((port.mean_inertia * np.gradient(v, record.record.dt)) ** 2))))
        speeds.append(v[at])
        if port.position is not None:
            q = x @ port.position
            std = np.sqrt(np.median(np.einsum("i,nij,j->n", port.position, covariance, port.position)))
            positions += [q[at]] if std < 0.05 * np.ptp(q) else []
    known = np.concatenate(positions) if len(positions) == len(speeds) else None
    units = ports[0].unit, ports[0].speed_unit, ports[0].position_unit
    return PortMotion(max(forces) or 1.0, np.concatenate(speeds), known, *units)


SIZES = np.concatenate([[0.0], 10.0 ** np.arange(-4.5, 0.1, 0.25)])  # s, of the force that moves the port
# Precision of the prior of initial states over that in the fit: the smoother assumes no force beyond its bandwidth, and
# a ripple changes the initial state by much more than its standard deviation.
START = 1e-4
LEAST_NOISE = 1e-8  # variance of the noise over the smoother's estimate
BANDWIDTHS = (1.0, 4.0, 16.0)  # f, per length of a window
FINER = (0.5, 1.0, 2.0)  # times the best of them
FINER_SIZES = 10.0 ** np.linspace(-0.25, 0.25, 13)


@dataclass(frozen=True, eq=False)
class NoiseLevel:
    """A random force of a size and bandwidth (Hz), and window products with it and the initial state eliminated."""

    # gram: (n_windows, n, n) over the given columns, the parameters and the errors.

    size: float
    bandwidth: float
    gram: Array
    logdet: Array
    alone_q: float  # V of the hypothesis alone
    alone: float  # its log likelihood


class FittedWindows:
    """Windows with a random force at one port or at several."""

    def __init__(self, response: ForceResponse, z: Array) -> None:
        self.response, self.z, self.points = response, z, int(response.points.sum())
        self.forces = np.array([p.force for p in response.ports])
        length = response.dt * float(response.edges[-1])
        self.bandwidths = [b / length for b in BANDWIDTHS]
        # Weight of the parameters' prior: variance of the noise, from that of the fit's errors down. A larger weight
        # would penalise parameters that the fit has changed much.
        self.weight = max(LEAST_NOISE, float(response.gram[:, -1, -1].sum()) / self.points)
        self.roots = {f: self._roots(f) for f in self.bandwidths}
        nothing = np.zeros((len(response.gram), response.segments, 0))
        for _ in range(2):
            self.alone = max(self.levels(nothing), key=lambda level: level.alone)
            self.weight = max(LEAST_NOISE, self.alone.alone_q / self.points)
        if self.alone.size > 0.0:
            self._refine(nothing)

    def at(self, port: int) -> FittedWindows:
        """Return the windows for curves at another of their ports."""
        other = copy(self)
        other.response = replace(self.response, port=port)
        return other

    def strongest(self) -> list[int]:
        """Return the ports by residual force over its standard deviation, largest first."""

        def size(port: int) -> float:
            force, std = self.at(port).force_along()
            return float(((force / std) ** 2).sum())

        return sorted(range(len(self.response.ports)), key=lambda port: -size(port))

    def _refine(self, nothing: Array) -> None:
        """Search the random force between the nodes of the grid, whose error differs between hypotheses."""
        sizes, bandwidth = self.alone.size * FINER_SIZES, self.alone.bandwidth
        for f in (factor * bandwidth for factor in FINER):
            self.roots.setdefault(f, self._roots(f))
            self.alone = max([self.alone, *self._levels_of(f, nothing, sizes)], key=lambda level: level.alone)
        self.bandwidths = sorted({*self.bandwidths, self.alone.bandwidth})
        self.weight = max(LEAST_NOISE, self.alone.alone_q / self.points)

    def _roots(self, bandwidth: float) -> tuple[Array, Array]:
        """Return U^T L^T (n_windows, n_pulses, n_pulses) and w with L L^T = K_f and L^T O^T O L = U diag(w) U^T."""
        root, s = np.linalg.cholesky(self._kernel(bandwidth)), self.response.pulses
        w, u = np.linalg.eigh(root.T @ self.response.gram[:, :s, :s] @ root)
        return np.swapaxes(u, 1, 2) @ root.T, np.maximum(w, 0.0)

    def _kernel(self, bandwidth: float) -> Array:
        """Return K_f over the segments of all ports, for forces of the sizes that move them."""
        middle = 0.5 * self.response.dt * (self.response.edges[1:] + self.response.edges[:-1])
        kernel = np.exp(-2.0 * np.pi * bandwidth * np.abs(middle[:, None] - middle))
        return np.kron(np.diag(self.forces**2), kernel + 1e-9 * np.eye(len(kernel)))

    @property
    def smaller(self) -> Array:
        """Return the sizes up to that of the hypothesis alone: a residual force reduces the random one."""
        known = np.append(SIZES[1:], self.alone.size)
        return np.append(0.0, np.unique(known[known <= 1.8 * self.alone.size]))

    @property
    def log_likelihood(self) -> float:
        """Return the log marginal likelihood of the hypothesis alone under a random force, up to a common constant."""
        # The log det of the initial states' equations depends on the scale of the outputs: only its change by a random
        # force counts. Here they have nearly no prior, in the correction that of the fit.
        n_x = self.response.xi.shape[1]
        own, unit = slice(-1 - n_x, -1), np.eye(n_x)
        free, within = self.response.gram[:, own, own], self._within_noise()[:, own, own]
        logdet = [np.linalg.slogdet(h)[1].sum() for h in (free + unit, within + unit, within + START * unit)]
        volume = float(logdet[0] - logdet[1] + logdet[2])
        return self.alone.alone + 0.5 * len(self.z) * float(np.log(self.weight)) + 0.5 * volume

    def _within_noise(self) -> Array:
        """Return the products under the noise and the random force of `alone`."""
        root, w = self.roots[self.alone.bandwidth]
        t = root @ self.response.gram[:, : self.response.pulses]
        t = t * np.sqrt(self.alone.size**2 / (1.0 + self.alone.size**2 * w))[:, :, None]
        return self.response.gram - np.swapaxes(t, 1, 2) @ t

    def levels(self, columns: Array, sizes: Array = SIZES) -> list[NoiseLevel]:
        """Return all random forces, with columns (n_windows, n_segments, k)."""
        found = []
        for f in self.bandwidths:  # size 0 has no bandwidth
            found += self._levels_of(f, columns, sizes if f == self.bandwidths[0] else sizes[1:])
        return found

    def _levels_of(self, f: float, columns: Array, sizes: Array) -> list[NoiseLevel]:
        (gram, rows), (root, w), found = self._mixed(columns, self.response.gram), self.roots[f], []
        turned = root @ rows
        for size in sizes.tolist():
            scaled = turned * np.sqrt(size**2 / (1.0 + size**2 * w))[:, :, None]
            g, logdet = self._without_start(gram - np.swapaxes(scaled, 1, 2) @ scaled)
            found.append(self._level(size, f, g, logdet + np.log1p(size**2 * w).sum(axis=1)))
        return found

    def _mixed(self, columns: Array, gram: Array) -> tuple[Array, Array]:
        """Return products of initial states, columns, parameters and errors of each window; and with the segments."""
        s, n_x, n, k = self.response.pulses, self.response.xi.shape[1], gram.shape[1], columns.shape[2]
        mix = np.zeros((len(columns), n, k + n - s))
        mix[:, self.response.own, n_x : n_x + k] = columns
        # Initial states come first, to be eliminated first.
        order = [*range(n - 1 - n_x, n - 1), *range(s, n - 1 - n_x), n - 1]
        mix[:, order, [*range(n_x), *range(n_x + k, k + n - s)]] = 1.0
        rows = gram @ mix
        return np.swapaxes(mix, 1, 2) @ rows, rows[:, :s]

    def _without_start(self, gram: Array) -> tuple[Array, Array]:
        """Eliminate the window's initial state, which comes first, with its prior; return also its log det."""
        xi, n_x = self.response.xi, self.response.xi.shape[1]
        gram = gram.copy()
        gram[:, :n_x, :n_x] += START * np.eye(n_x)
        gram[:, :n_x, -1] -= START * xi
        gram[:, -1, :n_x] -= START * xi
        gram[:, -1, -1] += START * (xi**2).sum(axis=1)
        h, right = gram[:, :n_x, :n_x], gram[:, :n_x, n_x:]
        rest = gram[:, n_x:, n_x:] - np.swapaxes(right, 1, 2) @ np.linalg.solve(h, right)
        return rest, np.linalg.slogdet(h)[1]

    def _level(self, size: float, bandwidth: float, gram: Array, logdet: Array) -> NoiseLevel:
        n_z = len(self.z)
        total = self.with_prior(gram.sum(axis=0)[-n_z - 1 :, -n_z - 1 :])
        q, det = (float(v) for v in eliminated(total, n_z))
        log_likelihood = -0.5 * self.points * np.log(q / self.points) - 0.5 * (logdet.sum() + det)
        return NoiseLevel(size, bandwidth, gram, logdet, q, log_likelihood)

    def with_prior(self, gram: Array) -> Array:
        """Add the parameters' prior to products over (..., parameters, errors)."""
        n_z = len(self.z)
        prior = np.zeros(gram.shape[-2:])
        prior[-n_z - 1 : -1, -n_z - 1 : -1] = np.eye(n_z)
        prior[-n_z - 1 : -1, -1] = prior[-1, -n_z - 1 : -1] = -self.z
        prior[-1, -1] = self.z @ self.z
        return gram + self.weight * prior

    def force_along(self) -> tuple[Array, Array]:
        """Return mean and std of the force, (n_windows, n_segments) (Rasmussen, Williams, 2006, equation 2.12)."""
        response, size = self.response, self.alone.size or SIZES[1]
        s, n = response.pulses, response.gram.shape[1]
        order = [*range(n - 1 - response.xi.shape[1], n - 1), *range(s), n - 1]
        g, _ = self._without_start(response.gram[:, order][:, :, order])
        covariance = np.linalg.inv(g[:, :s, :s] + np.linalg.inv(size**2 * self._kernel(self.alone.bandwidth)))
        mean = (covariance @ g[:, :s, -1:])[:, :, 0]
        variance = np.diagonal(covariance, axis1=1, axis2=2) * self.alone.alone_q / self.points
        return mean[:, response.own], np.sqrt(variance[:, response.own])

    def segment_sums(self) -> tuple[Array, Array]:
        """Return products of the port's segments with each other and with the errors, under the hypothesis' noise."""
        gram, s = self._within_noise(), self.response.segments
        g, _ = self._without_start(self._mixed(np.broadcast_to(np.eye(s), (len(gram), s, s)), gram)[0])
        # Parameters are eliminated approximately: at their optimum for the errors, not for each force.
        n_z = len(self.z)
        total = self.with_prior(g.sum(axis=0)[-n_z - 1 :, -n_z - 1 :])
        dz = np.linalg.solve(total[:-1, :-1], total[:-1, -1]) if n_z else np.zeros(0)
        return g[:, :s, :s], g[:, :s, -1] - g[:, :s, s:-1] @ dz


def eliminated(gram: Array, count: int) -> tuple[Array, Array]:
    """Eliminate the ``count`` unknowns before the errors; return V and log det of their equations."""
    if count == 0:
        return gram[..., -1, -1], np.zeros(gram.shape[:-2])
    h, b = gram[..., -count - 1 : -1, -count - 1 : -1], gram[..., -count - 1 : -1, -1:]
    v = gram[..., -1, -1] - (np.swapaxes(b, -1, -2) @ np.linalg.solve(h, b))[..., 0, 0]
    return v, np.linalg.slogdet(h)[1]
