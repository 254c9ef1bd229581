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
from robustlab.dynamics.effects.contract import Effect, EffectParameter, Law, Scales, Site
from robustlab.dynamics.extended.simulator import Simulator
from robustlab.dynamics.plant_contract import NonlinearPlant
from robustlab.dynamics.ports.law_kernel import TIME, law
from robustlab.identification.greybox.effect_fit import Fit, Hypothesis, NoiseModel, Problem
from robustlab.identification.greybox.prepared_record import PreparedRecord, averaged

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
    """Motion of a port along one record."""

    force: float  # RMS of the force that moves the port
    speed: Array | None = None  # (n,)
    position: Array | None = None  # (n,)
    unit: str = ""
    speed_unit: str = ""
    position_unit: str = ""


@dataclass(frozen=True, eq=False)
class ForceResponse:
    """Response of one record's windows to forces at ports."""

    gram: Array  # G, (n_windows, n, n) with n = n_pulses + n_z + n_x + 1
    points: Indices  # number of known points of each window, (n_windows,)
    edges: Indices  # first sample of each segment within a window, and the end, (n_segments + 1,)
    samples: Indices  # index of each sample of the windows, (n_windows, length)
    xi: Array  # initial states of the fit, (n_windows, n_x)
    record: PreparedRecord
    ports: tuple[PortMotion, ...]
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
        """Return means over the segments of columns (n, k) along the record: (n_windows, n_segments, k)."""
        return np.add.reduceat(values[self.samples], self.edges[:-1], axis=1) / np.diff(self.edges)[:, None]


def plain_places(problem: Problem, fit: Fit) -> tuple[Site, ...]:
    """Return the plant's own joints, or its inputs without any."""
    simulator = problem.simulators(fit.hypothesis)[0]
    model = simulator.model(*problem.split(fit.hypothesis, fit.z))
    joints = tuple(Site("joint", p.name) for p in model.ports.values() if p.kind == "joint" and "." not in p.name)
    return joints or tuple(Site("input", s.name) for s in problem.plant.inputs)


def force_response(problem: Problem, fit: Fit, places: Sequence[Site]) -> list[ForceResponse]:
    """Return responses at a fit to forces at joints, or to additions to inputs, one per record."""
    return [_of_record(problem, fit, places, k) for k in range(len(problem.records))]


def _of_record(problem: Problem, fit: Fit, places: Sequence[Site], k: int) -> ForceResponse:
    record, chosen, xi, length = problem.records[k], problem.chosen[k], fit.starts[k], problem.records[k].windows.length
    noise = NoiseModel(record.sensor_noise, np.zeros((0, len(record.columns))))
    simulator = problem.quick(fit.hypothesis)[k]
    (error,) = problem.on([record], [chosen]).errors(fit.hypothesis, fit.z, [xi])
    known = np.isfinite(error).reshape(len(chosen), -1)
    over_z, over_x = problem.sensitivities(k, simulator, fit.hypothesis, (fit.z, xi), fit.z, noise, len(fit.z))
    motions = tuple(_motion(problem, fit, place, k) for place in places)
    most = min(SEGMENTS, max(1, PULSES // len(places)))
    edges = np.unique(np.append(np.arange(0, length, -(-length // most)), length))
    samples = record.windows.starts[chosen][:, None] + np.arange(length)
    pushed = copy(simulator)
    pushed.effects = (*simulator.effects, *((_RecordedForce(record.record.dt), place) for place in places))
    setting, nothing = problem.setting(fit.hypothesis, fit.z), np.zeros(len(record.u))

    def outputs(force: Array = nothing, at: int = 0) -> Array:
        forces = [{"samples": force if j == at else nothing} for j in range(len(places))]
        return problem.outputs(k, pushed, setting._replace(values=[*setting.values, *forces]), xi)

    def pulse(s: int, at: int) -> Array:
        force, size = nothing.copy(), PULSE * motions[at].force
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
    columns = np.concatenate(
        [np.stack(columns, axis=2), -over_z, -over_x, noise.whitened(error)[:, :, None]], axis=2
    ) * known[:, :, None]  # fmt: skip
    gram = np.swapaxes(columns, 1, 2) @ columns
    return ForceResponse(gram, known.sum(axis=1), edges, samples, xi, record, motions)


def _shifts(problem: Problem, simulator: Simulator, values: Sequence[Mapping[str, float]]) -> bool:
    """Return whether the response is time-invariant: a linear plant, no force law, no map of an output."""
    return not isinstance(problem.plant, NonlinearPlant) and not any(
        (site.kind == "output" and not (effect.delay and v[effect.delay] == 0.0)) or effect.laws(site, v)
        for (effect, site), v in zip(simulator.effects, values, strict=True)
    )


def _motion(problem: Problem, fit: Fit, place: Site, k: int) -> PortMotion:
    """Return RMS force, speed and position of the port along one record from the smoother."""
    record = problem.records[k]
    if place.kind == "input":
        at = [s.name for s in problem.plant.inputs].index(place.name)
        rms = float(np.sqrt(np.mean(record.u[:, at] ** 2))) or 1.0
        return PortMotion(rms, unit=problem.plant.inputs[at].unit)
    factors, _ = problem.split(fit.hypothesis, fit.z)
    port = problem.simulators(Hypothesis(()))[k].model(factors, []).ports[place.name]
    x, covariance = record.smoothed.x, record.smoothed.covariance
    v = x @ port.velocity
    inertia = port.mean_inertia
    rms = float(np.sqrt(np.mean((inertia * np.gradient(v, record.record.dt)) ** 2))) or 1.0
    q = None
    if port.position is not None:
        q = x @ port.position
        std = np.sqrt(np.median(np.einsum("i,nij,j->n", port.position, covariance, port.position)))
        q = q if std < 0.05 * np.ptp(q) else None
    return PortMotion(rms, v, q, port.unit, port.speed_unit, port.position_unit)


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
    """Windows of all records, with a random force at one port or at several."""

    def __init__(self, records: list[ForceResponse], z: Array, problem: Problem) -> None:
        self.records, self.z, self.problem = records, z, problem
        self.points = int(sum(r.points.sum() for r in records))
        self.forces = np.max([[p.force for p in r.ports] for r in records], axis=0)
        self.dt = problem.records[0].record.dt
        length = self.dt * records[0].samples.shape[1]
        self.bandwidths = [b / length for b in BANDWIDTHS]
        # Weight of the parameters' prior: variance of the noise, from that of the fit's errors down. A larger weight
        # would penalise parameters that the fit has changed much.
        left = sum(float(r.gram[:, -1, -1].sum()) for r in records)
        self.weight = max(LEAST_NOISE, left / self.points)
        self.roots = {f: [self._roots(r, f) for r in records] for f in self.bandwidths}
        nothing = [np.zeros((len(r.gram), r.segments, 0)) for r in records]
        for _ in range(2):
            self.alone = max(self.levels(nothing), key=lambda level: level.alone)
            self.weight = max(LEAST_NOISE, self.alone.alone_q / self.points)
        if self.alone.size > 0.0:
            self._refine(nothing)

    def at(self, port: int) -> FittedWindows:
        """Return the windows for curves at another of their ports."""
        other = copy(self)
        other.records = [replace(r, port=port) for r in self.records]
        return other

    @property
    def force(self) -> float:
        """Return the RMS of the force that moves the curves' port."""
        return float(self.forces[self.records[0].port])

    def strongest(self) -> list[int]:
        """Return the ports by residual force over its standard deviation, largest first."""

        def size(port: int) -> float:
            return sum(float(((force / std) ** 2).sum()) for force, std in self.at(port).force_along())

        return sorted(range(len(self.records[0].ports)), key=lambda port: -size(port))

    def _refine(self, nothing: Sequence[Array]) -> None:
        """Search the random force between the nodes of the grid, whose error differs between hypotheses."""
        sizes, bandwidth = self.alone.size * FINER_SIZES, self.alone.bandwidth
        for f in (factor * bandwidth for factor in FINER):
            self.roots.setdefault(f, [self._roots(r, f) for r in self.records])
            self.alone = max([self.alone, *self._levels_of(f, nothing, sizes)], key=lambda level: level.alone)
        self.bandwidths = sorted({*self.bandwidths, self.alone.bandwidth})
        self.weight = max(LEAST_NOISE, self.alone.alone_q / self.points)

    def _roots(self, record: ForceResponse, bandwidth: float) -> tuple[Array, Array]:
        """Return U^T L^T (n_windows, n_pulses, n_pulses) and w with L L^T = K_f and L^T O^T O L = U diag(w) U^T."""
        kernel = self._kernel(record, bandwidth)
        root = np.linalg.cholesky(kernel + 1e-9 * np.eye(len(kernel)))
        root = np.kron(np.diag(self.forces), root)
        s = record.pulses
        w, u = np.linalg.eigh(root.T @ record.gram[:, :s, :s] @ root)
        return np.swapaxes(u, 1, 2) @ root.T, np.maximum(w, 0.0)

    def _kernel(self, record: ForceResponse, bandwidth: float) -> Array:
        """Return K_f over the segments of one port, for a force of 1."""
        middle = 0.5 * self.dt * (record.edges[1:] + record.edges[:-1])
        return np.exp(-2.0 * np.pi * bandwidth * np.abs(middle[:, None] - middle))

    @property
    def smaller(self) -> Array:
        """Return the sizes up to that of the hypothesis alone: a residual force reduces the random one."""
        known = np.append(SIZES[1:], self.alone.size)
        return np.append(0.0, np.unique(known[known <= 1.8 * self.alone.size]))

    @property
    def start_volume(self) -> float:
        """Return the correction of twice the log likelihood for the initial states, to compare hypotheses."""
        # The log det of their equations depends on the scale of the outputs: only its change by a random force counts.
        # Here the initial states have nearly no prior, in the correction that of the fit.
        total = 0.0
        for k, record in enumerate(self.records):
            own = slice(-1 - record.xi.shape[1], -1)
            unit = np.eye(record.xi.shape[1])
            free, within = record.gram[:, own, own], self._within_noise(k, self.alone.size)[:, own, own]
            logdet = [np.linalg.slogdet(h)[1].sum() for h in (free + unit, within + unit, within + START * unit)]
            total += float(logdet[0] - logdet[1] + logdet[2])
        return total

    @property
    def log_likelihood(self) -> float:
        """Return the log marginal likelihood of the hypothesis alone under a random force, up to a common constant."""
        return self.alone.alone + 0.5 * len(self.z) * float(np.log(self.weight)) + 0.5 * self.start_volume

    def _within_noise(self, k: int, size: float) -> Array:
        """Return products of one record under noise and a random force of this size, at the bandwidth of `alone`."""
        record = self.records[k]
        root, w = self.roots[self.alone.bandwidth][k]
        t = root @ record.gram[:, : record.pulses]
        t = t * np.sqrt(size**2 / (1.0 + size**2 * w))[:, :, None]
        return record.gram - np.swapaxes(t, 1, 2) @ t

    def levels(self, columns: Sequence[Array], sizes: Array = SIZES) -> list[NoiseLevel]:
        """Return all random forces, with columns (n_windows, n_segments, k) per record."""
        found = []
        for f in self.bandwidths:  # size 0 has no bandwidth
            found += self._levels_of(f, columns, sizes if f == self.bandwidths[0] else sizes[1:])
        return found

    def _levels_of(self, f: float, columns: Sequence[Array], sizes: Sequence[float] | Array) -> list[NoiseLevel]:
        mixed = [self._mixed(r, c, r.gram) for r, c in zip(self.records, columns, strict=True)]
        turned = [root @ rows for (root, _), (_, rows) in zip(self.roots[f], mixed, strict=True)]
        found = []
        for size in sizes:
            grams, logdets = [], []
            for record, (_, w), (gram, _), t in zip(self.records, self.roots[f], mixed, turned, strict=True):
                a = size**2
                scaled = t * np.sqrt(a / (1.0 + a * w))[:, :, None]
                g, logdet = _without_start(gram - np.swapaxes(scaled, 1, 2) @ scaled, record)
                grams.append(g)
                logdets.append(logdet + np.log1p(a * w).sum(axis=1))
            found.append(self._level(float(size), f, np.concatenate(grams), np.concatenate(logdets)))
        return found

    def _mixed(self, record: ForceResponse, columns: Array, gram: Array) -> tuple[Array, Array]:
        """Return products of initial states, columns, parameters and errors of each window; and with the segments."""
        s, n_x = record.pulses, record.xi.shape[1]
        n = gram.shape[1]
        k = columns.shape[2]
        mix = np.zeros((len(columns), n, k + n - s))
        mix[:, record.own, :k] = columns
        order = [*range(n - 1 - n_x, n - 1), *range(s, n - 1 - n_x), n - 1]  # initial states, parameters, errors
        mix[:, order, k + np.arange(n - s)] = 1.0
        rows = gram @ mix
        # Initial states come first, to be eliminated first.
        gram = np.swapaxes(mix, 1, 2) @ rows
        first = [*range(k, k + n_x), *range(k), *range(k + n_x, gram.shape[1])]
        return gram[:, first][:, :, first], rows[:, :s][:, :, first]

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

    def force_along(self) -> list[tuple[Array, Array]]:
        """Return the port's force given the errors and the parameters: mean and std by record, (n_windows, n_segments).

        The posterior of the random force (Rasmussen, Williams, 2006, equation 2.12).
        """
        found, size = [], self.alone.size or SIZES[1]
        for record in self.records:
            s, n = record.pulses, record.gram.shape[1]
            kernel = self._kernel(record, self.alone.bandwidth)
            prior = np.kron(np.diag((size * self.forces) ** 2), kernel + 1e-9 * np.eye(len(kernel)))
            order = [*range(n - 1 - record.xi.shape[1], n - 1), *range(s), n - 1]
            g, _ = _without_start(record.gram[:, order][:, :, order], record)
            covariance = np.linalg.inv(g[:, :s, :s] + np.linalg.inv(prior))
            mean = (covariance @ g[:, :s, -1:])[:, :, 0]
            variance = np.diagonal(covariance, axis1=1, axis2=2) * self.alone.alone_q / self.points
            found.append((mean[:, record.own], np.sqrt(variance[:, record.own])))
        return found

    def segment_sums(self) -> list[tuple[Array, Array]]:
        """Return products of the port's segments with each other and with the errors, under the hypothesis' noise."""
        found = []
        for k, record in enumerate(self.records):
            s, gram = record.segments, self._within_noise(k, self.alone.size)
            g, _ = _without_start(self._mixed(record, np.broadcast_to(np.eye(s), (len(gram), s, s)), gram)[0], record)
            found.append((g, g[:, :s, -1]))
        # Parameters are eliminated approximately: at their optimum for the errors, not for each force.
        n_z = len(self.z)
        total = self.with_prior(np.sum([g.sum(axis=0)[-n_z - 1 :, -n_z - 1 :] for g, _ in found], axis=0))
        dz = np.linalg.solve(total[:-1, :-1], total[:-1, -1]) if n_z else np.zeros(0)
        return [(g[:, : r.segments, : r.segments], b - g[:, : r.segments, r.segments : -1] @ dz)
                for (g, b), r in zip(found, self.records, strict=True)]  # fmt: skip


def _without_start(gram: Array, record: ForceResponse) -> tuple[Array, Array]:
    """Eliminate the window's initial state, which comes first, with its prior; return also its log det."""
    n_x = record.xi.shape[1]
    gram = gram.copy()
    gram[:, :n_x, :n_x] += START * np.eye(n_x)
    gram[:, :n_x, -1] -= START * record.xi
    gram[:, -1, :n_x] -= START * record.xi
    gram[:, -1, -1] += START * (record.xi**2).sum(axis=1)
    h, right = gram[:, :n_x, :n_x], gram[:, :n_x, n_x:]
    rest = gram[:, n_x:, n_x:] - np.swapaxes(right, 1, 2) @ np.linalg.solve(h, right)
    return rest, np.linalg.slogdet(h)[1]


def eliminated(gram: Array, count: int) -> tuple[Array, Array]:
    """Eliminate the ``count`` unknowns before the errors; return V and log det of their equations."""
    if count == 0:
        return gram[..., -1, -1], np.zeros(gram.shape[:-2])
    h, b = gram[..., -count - 1 : -1, -count - 1 : -1], gram[..., -count - 1 : -1, -1:]
    v = gram[..., -1, -1] - (np.swapaxes(b, -1, -2) @ np.linalg.solve(h, b))[..., 0, 0]
    return v, np.linalg.slogdet(h)[1]
