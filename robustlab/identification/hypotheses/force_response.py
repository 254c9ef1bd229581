r"""What small forces at ports change in the windows of a fit, and the sums that every regression on them needs.

The errors of a window near a fit of a hypothesis, in units of the sensors' noise, are

.. math:: e = J\,\delta + X\,\eta + O\,f + \text{noise}

with :math:`\delta, \eta` the moves of the standardised parameters and of the window's start, and f the forces at the
ports, port after port, held over short segments of the window. O is simulated, pulse by pulse, all windows at once;
where the model is linear, one pulse tells all, later ones answer alike. All that is ever asked of it are its products
:math:`G = [O\; J\; X\; e]^T [O\; J\; X\; e]`, once per window: any curve of the force, any random force and any noise
level are then sums over segments, without a further simulation.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from robustlab.arrays import Array, Indices
from robustlab.dynamics.effects.contract import Effect, EffectParameter, Law, Scales, Site
from robustlab.dynamics.extended.simulator import Simulator
from robustlab.dynamics.plant_contract import NonlinearPlant
from robustlab.dynamics.ports.law_kernel import TIME, law
from robustlab.identification.hypotheses.effect_fit import Candidate, Fit, Hypothesis, Problem
from robustlab.identification.hypotheses.prepared_record import PreparedRecord, averaged

__all__ = ["ForceResponse", "PortMotion", "force_response", "plain_places"]

SEGMENTS = 60  # of a window, at most: finer ones tell faster forces, each is a simulation a port
PULSES = 120  # of a window at all ports together, at most
PULSE = 0.02  # of the force that moves the port: small against it, large against rounding
WILD = 1e6


@law
def recorded_force(p, z, z_next, seen):  # type: ignore[no-untyped-def]
    """Parameters p = (sample time, number of samples, then the force at each sample of the record)."""
    return p[2 + min(int(p[1]) - 1, int(seen[TIME] / p[0] + 1e-6))]


class _RecordedForce(Effect):
    """A force, or an addition to an input, that is given sample by sample; no effect of the catalogue."""

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
    """Along one record."""

    force: float  # RMS of the force that moves the port; ``unit`` is its unit
    unit: str
    # speed, position: of the port, (n,), None where not told; with their units
    speed: Array | None = None
    position: Array | None = None
    speed_unit: str = ""
    position_unit: str = ""


@dataclass(frozen=True, eq=False)
class ForceResponse:
    """One record's windows."""

    gram: Array  # G, (n_windows, n, n) with n = n_pulses + n_z + n_x + 1
    points: Indices  # number of known points of each window, (n_windows,)
    edges: Indices  # first sample of each segment within a window, and the end, (n_segments + 1,)
    samples: Indices  # index of each sample of the windows, (n_windows, length)
    xi: Array  # starts at the fit, (n_windows, n_x)
    record: PreparedRecord
    ports: tuple[PortMotion, ...]  # motion of each port
    port: int = 0  # the one that curves are drawn at

    @property
    def segments(self) -> int:
        """Their number in a window, at each port."""
        return len(self.edges) - 1

    @property
    def pulses(self) -> int:
        """Columns of O: the segments of all ports."""
        return len(self.ports) * self.segments

    @property
    def own(self) -> slice:
        """Columns of O of the port that curves are drawn at."""
        return slice(self.port * self.segments, (self.port + 1) * self.segments)

    @property
    def motion(self) -> PortMotion:
        """Of that port."""
        return self.ports[self.port]

    def mean(self, values: Array) -> Array:
        """Means over the segments of columns (n, k) along the record: (n_windows, n_segments, k)."""
        return np.add.reduceat(values[self.samples], self.edges[:-1], axis=1) / np.diff(self.edges)[:, None]


def plain_places(problem: Problem, fit: Fit) -> tuple[Site, ...]:
    """The plant's own joints, or its inputs where it has none."""
    simulator = problem.simulators(fit.hypothesis)[0]
    model = simulator.model(*problem.split(fit.hypothesis, fit.z))
    joints = tuple(Site("joint", p.name) for p in model.ports.values() if p.kind == "joint" and "." not in p.name)
    return joints or tuple(Site("input", s.name) for s in problem.plant.inputs)


def force_response(problem: Problem, fit: Fit, places: Sequence[Site]) -> list[ForceResponse]:
    """Responses at a fit to forces at joints, or to additions to inputs, one a record."""
    dt = problem.records[0].record.dt
    pulses = [Candidate(_RecordedForce(dt), place, (), ({},), Scales()) for place in places]
    wider = Hypothesis((*fit.hypothesis.candidates, *pulses))
    return [_of_record(problem, fit, wider, places, k, s) for k, s in enumerate(problem.simulators(wider))]


def _of_record(
    problem: Problem, fit: Fit, wider: Hypothesis, places: Sequence[Site], k: int, simulator: Simulator
) -> ForceResponse:
    record, chosen, xi, count = problem.records[k], problem.chosen[k], fit.starts[k], len(places)
    nothing = np.zeros(len(record.u))
    single = np.maximum(record.smoothed.noise_std, record.resolution / np.sqrt(12.0)) / np.sqrt(record.thin)

    def outputs(z: Array, start: Array, samples: Array = nothing, at: int = 0) -> Array:
        setting = problem.setting(wider, z)
        pushed = [{"samples": samples if j == at else nothing} for j in range(count)]
        values = [*setting.values[: len(setting.values) - count], *pushed]
        return problem.outputs(k, simulator, setting._replace(values=values), start)

    def points(difference: Array) -> Array:
        with np.errstate(all="ignore"):
            scaled = averaged(difference, record.thin) / single
        return np.clip(scaled, -WILD, WILD).reshape(len(chosen), -1)

    with np.errstate(all="ignore"):
        here = outputs(fit.z, xi)
        step, start_step = problem.tuning.step, problem.tuning.start_step
        j = [points(outputs(fit.z + step * e, xi) - here) / step for e in np.eye(len(fit.z))]
        x = [points(outputs(fit.z, xi + start_step * e) - here) / start_step for e in np.eye(xi.shape[1])]
        motions = tuple(_motion(problem, fit, place, k) for place in places)
        length = record.windows.length
        most = min(SEGMENTS, max(1, PULSES // count))
        edges = np.unique(np.append(np.arange(0, length, -(-length // most)), length))
        samples = record.windows.starts[chosen][:, None] + np.arange(length)

        def pulse(s: int, at: int) -> Array:
            force, size = nothing.copy(), PULSE * motions[at].force
            force[samples[:, edges[s] : edges[s + 1]]] = size
            return (outputs(fit.z, xi, force, at) - here) / size

        shifts, o = _shifts(problem, fit, simulator, count), []
        for at in range(count):
            if shifts:
                first = pulse(0, at)
                ends = [np.pad(first[:, : length - e], ((0, 0), (e, 0), (0, 0))) for e in edges[:-1]]
                last = (edges[-1] - edges[-2]) / (edges[1] - edges[0])  # a shorter last segment pushes less
                o += [points(r * (last if s == len(ends) - 1 else 1.0)) for s, r in enumerate(ends)]
            else:
                o += [points(pulse(s, at)) for s in range(len(edges) - 1)]
    error = points(record.measured[chosen] - here)
    known = np.isfinite(error)
    columns = np.nan_to_num(np.stack([*o, *j, *x, error], axis=2)) * known[:, :, None]
    gram = np.swapaxes(columns, 1, 2) @ columns
    return ForceResponse(gram, known.sum(axis=1), edges, samples, xi, record, motions)


def _shifts(problem: Problem, fit: Fit, simulator: Simulator, pulses: int) -> bool:
    """Whether a later pulse answers like an earlier one: a linear plant, no force law, no map of an output."""
    if isinstance(problem.plant, NonlinearPlant):
        return False
    _, values = problem.split(fit.hypothesis, fit.z)
    effects = zip(simulator.effects[:-pulses], values, strict=True)
    return not any(site.kind == "output" or effect.laws(site, v) for (effect, site), v in effects)


def _motion(problem: Problem, fit: Fit, place: Site, k: int) -> PortMotion:
    """RMS force, speed and position of the port along one record as the smoother tells them."""
    record = problem.records[k]
    if place.kind == "input":
        at = [s.name for s in problem.plant.inputs].index(place.name)
        rms = float(np.sqrt(np.mean(record.u[:, at] ** 2))) or 1.0
        return PortMotion(rms, problem.plant.inputs[at].unit)
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
    return PortMotion(rms, port.unit, v, q, port.speed_unit, port.position_unit)
