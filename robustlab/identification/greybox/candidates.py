"""Candidate effects of a plant and its records, with sites and magnitudes, and the refitted parameters."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache
from itertools import chain

import numpy as np
from scipy.ndimage import median_filter

from robustlab.arrays import Array, Mask
from robustlab.dynamics.effects.catalogue import catalogue
from robustlab.dynamics.effects.effect import Scales, Site
from robustlab.dynamics.parameters import tolerance_of
from robustlab.dynamics.plant_base import NonlinearPlant
from robustlab.dynamics.ports.port_model import AnyPlant, Port, PortModel, parameter_groups, shares_behind
from robustlab.errors import InputError, did_you_mean
from robustlab.identification.greybox.effect_fit import UNIFORM, Candidate, Nuisance
from robustlab.identification.greybox.prepared_record import PreparedRecord

SPATIAL_LINES = 3  # of a force over the position: more would show weaker ripples at the cost of further fits
FINEST_LINES = 1500  # periods per range of the position, at most
# Probability that a line of a force over time is noise. Without these starts the ripple of case 0007 of the naming
# benchmark, seed 2027, is not found.
LINE_P = 0.01
LINE_NEIGHBOURS = 40  # frequencies on either side of a line over time that determine the noise level
# Effective number of independent frequencies among them: a Hann taper correlates one and a half frequencies, and the
# median of exponential powers has 0.48 times the efficiency of their mean.
LINE_FREEDOM = 0.48 * (2 * LINE_NEIGHBOURS + 1) / 1.5
FEWEST_PERIODS = 2.0  # of an effect over the position, in one stroke
HOMING = 0.2  # of half the range of a position: standard deviation of its zero
ASSUMED = 0.10  # default relative tolerance of a parameter whose role no effect has

PortPath = tuple[Array, Array, Array]  # position, velocity and unknown force along a record


def candidates(plant: AnyPlant, model: PortModel, records: Sequence[PreparedRecord]) -> list[Candidate]:
    """Return every nameable effect of the catalogue at each of its sites, at the records' magnitudes."""
    # An effect with a period over the position or time appears once for each strong line.
    model = _with_observable_positions(model, records)
    scales_of = cache(lambda site: _scales(site, plant, model, records))
    return [
        Candidate(effect, site, effect.parameters(scales), effect.starts(scales), scales)
        for effect in catalogue().values() if effect.nameable and not effect.equals
        for site in effect.sites(plant, model)
        if site.kind != "output" or all(site.name in r.record.outputs for r in records)
        for scales in effect.variants(scales_of(site))
    ]  # fmt: skip


def _with_observable_positions(model: PortModel, records: Sequence[PreparedRecord]) -> PortModel:
    """Remove positions that the recorded outputs do not determine: no effect may depend on them."""
    if model.A.ndim > 2:
        return model
    c = model.C[list(records[0].columns)]
    size = max(float(np.linalg.norm(model.A, 2)), 1e-300)
    rows = [c / max(float(np.abs(c).max()), 1e-300)]
    for _ in range(len(model.A) - 1):
        rows.append(rows[-1] @ model.A / size)
    basis = np.linalg.svd(np.vstack(rows), full_matrices=False)
    span = basis.Vh[1e-9 * basis.S.max(initial=0.0) < basis.S]
    ports = {}
    for name, port in model.ports.items():
        q = port.position
        seen = q is not None and float(np.linalg.norm(q - span.T @ (span @ q))) < 1e-3 * float(np.linalg.norm(q))
        ports[name] = port if seen else replace(port, position=None, position_unit="")
    return replace(model, ports=ports)


def _scales(site: Site, plant: AnyPlant, model: PortModel, records: Sequence[PreparedRecord]) -> Scales:
    dt, duration = records[0].record.dt, max(r.record.duration for r in records)
    if site.kind == "input":
        k = [s.name for s in plant.inputs].index(site.name)
        largest = max(float(np.abs(r.u[:, k]).max()) for r in records)
        return Scales(dt=dt, duration=duration, input=largest or 1.0, signal_unit=plant.inputs[k].unit)
    if site.kind == "output":
        k = [s.name for s in plant.outputs].index(site.name)
        half = max(float(np.ptp(r.record.outputs[site.name])) for r in records) / 2.0
        orders, unit = _orders_at_output(plant, model, site, records), plant.outputs[k].unit
        found = Scales(dt=dt, duration=duration, output=half or 1.0, signal_unit=unit, orders=orders)
        # If the equations depend on positions, their zeros come from homing, and a wrong one may be far off.
        return replace(found, zero=HOMING) if isinstance(plant, NonlinearPlant) and unit in ("rad", "m") else found
    if site.kind == "parameter":
        return Scales(dt=dt, duration=duration)
    port = model.ports[site.name]
    motion = [_port_motion(port, r) for r in records]
    speed = max(float(np.abs(v).max()) for _, v, _ in motion) or 1.0
    own = Scales(dt=dt, duration=duration, speed=speed, inertia=port.mean_inertia,
                 force_unit=port.unit, speed_unit=port.speed_unit)  # fmt: skip
    if port.kind == "current":
        largest = max(float(np.abs(r.u).max()) for r in records)
        return replace(own, force=largest or 1.0, current=speed)
    force = max(float(np.sqrt(np.mean((own.inertia * np.gradient(v, dt)) ** 2))) for _, v, _ in motion)
    lacking = max(float(np.sqrt(np.mean(d**2))) for _, _, d in motion)
    currents = (r.smoothed.x @ p.velocity for r in records for p in model.ports.values() if p.kind == "current")
    return replace(
        own,
        force=max(force, lacking) or 1.0,
        position=max(float(np.ptp(q)) for q, _, _ in motion) or 1.0,
        lowest=min(float(q.min()) for q, _, _ in motion),
        highest=max(float(q.max()) for q, _, _ in motion),
        shares=shares_behind(plant, site.name) if isinstance(plant, NonlinearPlant) else (),
        current=float(max((np.abs(i).max() for i in currents), default=1.0)) or 1.0,
        orders=_merged_orders(motion) if port.position is not None else (),
        lines=_lines(motion, records),
        position_unit=port.position_unit,
    )


def _port_motion(port: Port, record: PreparedRecord) -> PortPath:
    """Return position, velocity and unknown force along a record."""
    s = record.smoothed
    v = s.x @ port.velocity
    q = s.x @ port.position if port.position is not None else np.zeros(len(v))
    # The smoother's forces are those of the joints, in the order of the ports; a current port has none.
    pushed = port.force.reshape(-1, port.force.shape[-1]).mean(axis=0)[: len(record.push)]
    # Dual directions of the forces, so that each one responds to itself alone.
    j = int(np.argmax(np.abs(pushed @ np.linalg.pinv(record.push).T))) if record.push.shape[1] else 0
    return q, v, s.d[:, j]


def _orders_at_output(
    plant: AnyPlant, model: PortModel, site: Site, records: Sequence[PreparedRecord]
) -> tuple[float, ...]:
    """Return lines of an encoder's eccentricity: those of the force at the joint whose position it measures."""
    row = model.C[..., [s.name for s in plant.outputs].index(site.name), :].reshape(-1, model.C.shape[-1])[0]
    for port in model.ports.values():
        if port.position is not None and np.array_equal(row[: model.own] != 0, port.position != 0):
            return _merged_orders([_port_motion(port, r) for r in records])
    return ()


def _merged_orders(motion: Sequence[PortPath]) -> tuple[float, ...]:
    q, v, d = (np.concatenate(part) for part in zip(*motion, strict=True))
    moving = np.abs(v) > 0.01 * np.abs(v).max(initial=0.0)
    stroke = max(float(np.ptp(m[0])) for m in motion)
    plain, flipped = (spatial_orders(q, force, v, moving, stroke) for force in (d, d * np.sign(v)))
    merged: list[float] = []
    for k in chain.from_iterable(zip(plain, flipped, strict=False)):
        if all(abs(k - other) > 0.02 * other for other in merged):
            merged.append(k)
    return tuple(merged[: 2 * SPATIAL_LINES])


def periods_seen(k: float, position: Array, records: Sequence[PreparedRecord]) -> float:
    """Return the periods of a spatial frequency k in the longest stroke; ``position``: row over the states."""
    # Below `FEWEST_PERIODS` a spring, a stop or a load can make the same curve.
    return abs(k) * max(float(np.ptp(r.smoothed.x @ position)) for r in records) / (2.0 * np.pi)


def spatial_orders(q: Array, d: Array, v: Array, moving: Mask, stroke: float = math.inf) -> tuple[float, ...]:
    """Return spatial frequencies of the force d over the position q, rad per unit of q, strongest first."""
    # Fewer than two periods in the longest stroke of one record are a curve and not a line.
    q, d, v = q[moving], d[moving], v[moving]
    span = float(np.ptp(q)) if len(q) else 0.0
    if len(q) < 50 or span == 0.0:
        return ()
    trend = np.column_stack([np.ones_like(v), np.sign(v), v, np.abs(v)])
    rest = d - trend @ np.linalg.lstsq(trend, d, rcond=None)[0]
    # Periodogram by one zero-padded transform of the force in fine bins of the position.
    bins = int(min(4 * FINEST_LINES, max(64, len(q) // 2)))
    place = np.minimum(((q - q.min()) / span * bins).astype(int), bins - 1)
    padded = 8 * bins
    k = 2.0 * np.pi / span * bins / padded * np.arange(padded // 2 + 1)
    lowest = FEWEST_PERIODS * 2.0 * np.pi / min(span, stroke)
    keep = (k >= lowest) & (k <= 2.0 * np.pi / span * min(FINEST_LINES, bins / 4))
    k = k[keep]
    found: list[float] = []
    # Side lobes can exceed weaker lines: each line is subtracted before the next is searched.
    for _ in range(SPATIAL_LINES):
        power = np.abs(np.fft.rfft(np.bincount(place, weights=rest, minlength=bins), padded))[keep]
        peaks = np.flatnonzero((power[1:-1] >= power[:-2]) & (power[1:-1] >= power[2:])) + 1
        if not len(peaks):
            break
        found.append(float(k[peaks[np.argmax(power[peaks])]]))
        wave = np.column_stack([np.cos(found[-1] * q), np.sin(found[-1] * q)])
        rest = rest - wave @ np.linalg.lstsq(wave, rest, rcond=None)[0]
    return tuple(found)


def _lines(motion: Sequence[PortPath], records: Sequence[PreparedRecord]) -> tuple[float, ...]:
    """Return lines over time in the longest record, with at least two periods in a window."""
    k = int(np.argmax([r.record.duration for r in records]))
    (_, v, d), dt = motion[k], records[k].record.dt
    return timed_lines(d, v, dt, 2.0 / (records[k].windows.length * dt))


def timed_lines(d: Array, v: Array, dt: float, lowest: float) -> tuple[float, ...]:
    """Return significant lines of the force d over time in Hz, from ``lowest`` up, strongest first."""
    # For noise with a smooth spectrum, power over the mean m of K neighbours has P(p > x m) = (1 + x/K)^-K; a line is
    # significant if that, times the number of frequencies, is below LINE_P.
    trend = np.column_stack([np.ones_like(v), np.sign(v), v, np.abs(v)])
    rest = d - trend @ np.linalg.lstsq(trend, d, rcond=None)[0]
    n = len(rest)
    t, f = dt * np.arange(n), np.fft.rfftfreq(n, dt)
    taper = np.hanning(n)
    allowed = (f >= lowest) & (f <= 0.4 / dt)  # at most 2.5 samples per period: beyond the smoother's bandwidth
    found: list[tuple[float, float]] = []
    for _ in range(SPATIAL_LINES):
        keep = np.flatnonzero(allowed)
        if len(keep) < 2 * LINE_NEIGHBOURS:
            break
        power = np.abs(np.fft.rfft(rest * taper)) ** 2
        around = median_filter(power, 2 * LINE_NEIGHBOURS + 1, mode="reflect") / math.log(2.0)  # the mean by the median
        height = power[keep] / np.maximum(around[keep], 1e-300)
        best = int(keep[np.argmax(height)])
        if len(keep) * (1.0 + height.max() / LINE_FREEDOM) ** -LINE_FREEDOM > LINE_P:
            break
        line = _between(power, best) / (n * dt)
        wave = np.column_stack([np.cos(2.0 * np.pi * line * t), np.sin(2.0 * np.pi * line * t)])
        parts = np.linalg.lstsq(wave, rest, rcond=None)[0]
        found.append((float(parts @ parts), line))
        rest = rest - wave @ parts
        allowed[max(0, best - 2) : best + 3] = False  # its residue is not another line
    return tuple(line for _, line in sorted(found, reverse=True))


def _between(power: Array, k: int) -> float:
    """Interpolate the peak at k of a Hann-tapered line's periodogram, in bins, by its larger neighbour."""
    if not 0 < k < len(power) - 1:
        return float(k)
    side = 1 if power[k + 1] > power[k - 1] else -1
    ratio = math.sqrt(power[k + side] / power[k])
    return k + side * min(0.5, max(0.0, (2.0 * ratio - 1.0) / (ratio + 1.0)))


def stated_tolerances(plant: AnyPlant, given: Mapping[str, float] | None) -> dict[str, tuple[float, bool]]:
    """Return parameter -> (tolerance, whether it is assumed): relative, or absolute in its unit for the value 0."""
    # ``given``: 0.05, "5%" or "0.2 N s/m" by name, over the plant's own; 0 fixes the parameter.
    own, known = dict[str, float](), tuple(plant.parameters)
    for name, value in (given or {}).items():
        if name not in known:
            text, hint = f"no such parameter of {plant.name}", did_you_mean(name, known)
            raise InputError(f"tolerances: {name!r}", text, ", ".join(known), hint)
        p = plant.parameters[name]
        own[name] = tolerance_of(f"tolerances: {name}", value, p.value, p.unit)
        if own[name] < 0:
            raise InputError(f"tolerances: {name}", f"{own[name]}", "a tolerance of 0 or more")
    result = {}
    for name, parameter in plant.parameters.items():
        if name in own:
            result[name] = (own[name], False)
        elif parameter.tolerance or not parameter.role or not parameter.value:
            result[name] = (parameter.tolerance, False)
        else:
            effect = catalogue().get(parameter.role)  # a role is the id of its parameter effect
            result[name] = (ASSUMED if effect is None else effect.tolerance, True)
    return result


def with_absolute_tolerances(plant: AnyPlant, stated: Mapping[str, tuple[float, bool]]) -> AnyPlant:
    """Return the plant with the tolerances of `stated_tolerances` on its parameters of the value 0."""
    zero = {n: (0.0, t) for n, (t, _) in stated.items() if t and not plant.parameters[n].value}
    return plant.with_parameters(**zero) if zero else plant


def nuisance_parameters(plant: AnyPlant, tolerances: Mapping[str, tuple[float, bool]]) -> tuple[Nuisance, ...]:
    """Return the groups of parameters with a tolerance r, each with a common factor exp(s z), z standard normal."""
    # s = ln(1 + r) / sqrt(3) is the standard deviation of a uniform log factor within the tolerance. The value 0 moves
    # by s z with s = r / sqrt(3), a friction never below 0. Parameters outside the equations are excluded.
    found, seen = [], set[str]()
    for _, label, names in parameter_groups(plant):
        seen.update(names)
        moving = tuple(name for name in names if tolerances[name][0] > 0)
        if moving:
            widest = max(tolerances[name][0] for name in moving)
            found.append(Nuisance(label, moving, math.log1p(widest) / UNIFORM))
    for name, p in plant.parameters.items():
        tolerance = tolerances[name][0]
        if name in seen or not tolerance or not _in_equations(plant, name):
            continue
        if p.value:
            found.append(Nuisance(name, (name,), math.log1p(tolerance) / UNIFORM))
        else:
            bounded = p.sign == "nonnegative" or p.role == "viscous-friction"
            found.append(Nuisance(name, (name,), tolerance / UNIFORM, additive=True, never_negative=bounded))
    return tuple(found)


def _in_equations(plant: AnyPlant, name: str) -> bool:
    """Return whether the parameter enters the plant's equations; assumed for a nonlinear plant."""
    if isinstance(plant, NonlinearPlant):
        return True
    values = plant.values
    moved = plant.matrices({**values, name: values[name] + 0.25 * plant.parameters[name].reference})
    return any(not np.array_equal(a, b) for a, b in zip(moved, plant.matrices(values), strict=True))
