r"""What every member of a kind of effects can be asked for, from the records' own motion.

With the force f of a fitted effect along the windows, the speed v and the position q of its joint: level
:math:`-\sum f v / \sum |v|`, viscous :math:`-\sum f v / \sum v^2`, stiffness :math:`-\operatorname{cov}(f, q) /
\operatorname{var} q`, force :math:`-\operatorname{mean} f`; a lateness is the sum of delay and time constant. Standard
deviations are by the delta method.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from robustlab.arrays import Array
from robustlab.dynamics.effects.kinds import Kind, Quantity
from robustlab.dynamics.effects.parameter_effects import GroundedEffect
from robustlab.dynamics.extended.simulator import Windows
from robustlab.identification.hypotheses.effect_fit import Candidate, Fit, Problem
from robustlab.identification.naming.named_effects import wave_amplitude

OF_JOINT: tuple[Quantity, ...] = ("level", "viscous", "stiffness", "force")
OF_ONE: tuple[Quantity, ...] = ("amplitude", "period")  # two waves have none in common
DIVIDES = ("inertia", "resistance")  # factors by whose inverse the path from input to sensor is scaled
APART = 0.2  # standard deviations by which a parameter is moved for differences


class Told(NamedTuple):
    """A quantity of one member: value, standard deviation, unit."""

    value: float
    std: float
    unit: str


def quantities(problem: Problem, fit: Fit, members: Sequence[int], kind: Kind) -> dict[Quantity, Told]:
    """What the effects of one kind in a fitted set say of it together; without what one of them cannot be asked for.

    ``members``: their indices. Forces and times add up, factors multiply; an amplitude and a period are those of one.
    """
    starts = np.cumsum([len(problem.nuisances), *(len(c.parameters) for c in fit.hypothesis.candidates)])
    own = np.concatenate([np.arange(starts[k], starts[k + 1]) for k in members])
    middle = _together(problem, fit, fit.z, members, kind)
    whole = np.linalg.pinv(fit.hessian) if fit.covariance is None else fit.covariance
    covariance = whole[own][:, own]
    slopes = {name: np.zeros(len(own)) for name in middle}
    for j, at in enumerate(own):
        step = max(APART * float(fit.std[at]), 1e-6)
        z = fit.z.copy()
        z[at] += step
        for name, (value, _) in _together(problem, fit, z, members, kind).items():
            slopes[name][j] = (value - middle[name][0]) / step
    found = {}
    for name, (value, unit) in middle.items():
        variance = float(slopes[name] @ covariance @ slopes[name])
        if math.isfinite(value) and math.isfinite(variance):
            found[name] = Told(value, math.sqrt(max(variance, 0.0)), unit)
    return found


def _together(
    problem: Problem, fit: Fit, z: Array, members: Sequence[int], kind: Kind
) -> dict[Quantity, tuple[float, str]]:
    """Value and unit of each quantity of all members at these parameters."""
    found: dict[Quantity, tuple[float, str]] = {}
    for name in kind.quantities:
        told = [_of_member(problem, fit, z, k, name) for k in members]
        each = [t for t in told if t is not None]
        if len(each) < len(told) or len({unit for _, unit in each}) > 1:
            continue
        if len(each) == 1:
            found[name] = each[0]
        elif name not in OF_ONE:
            values = [value for value, _ in each]
            found[name] = (math.prod(values) if name == "factor" else sum(values)), each[0][1]
    return found


def _of_member(problem: Problem, fit: Fit, z: Array, k: int, name: Quantity) -> tuple[float, str] | None:
    """Value and unit of one effect's; None where it cannot be asked."""
    candidate = fit.hypothesis.candidates[k]
    own = problem.split(fit.hypothesis, z)[1][k]
    if name in OF_JOINT:
        return _coefficient(problem, candidate, own, name) or _along(problem, fit, z, k, name)
    return _of_parameters(candidate, own, name)


def _coefficient(
    problem: Problem, candidate: Candidate, values: Mapping[str, float], name: Quantity
) -> tuple[float, str] | None:
    """Of an effect that is a coefficient: at a joint its own, of a parameter what it has more than the plant says."""
    effect = candidate.effect
    if not isinstance(effect, GroundedEffect):
        return None
    if name != ("stiffness" if effect.of == "position" else "viscous"):
        return None
    if candidate.site.kind == "joint":
        return values[effect.symbol], candidate.parameters[0].unit
    name_of, factor = next(iter(effect.factors(problem.plant, candidate.site, values).items()))
    p = problem.plant.parameters[name_of]
    return p.reference * factor - p.value, p.unit


def _of_parameters(candidate: Candidate, values: Mapping[str, float], name: Quantity) -> tuple[float, str] | None:
    effect = candidate.effect
    units = {p.name: p.unit for p in candidate.parameters}
    if name == "delay":
        parts = [values[p] for p in (effect.delay, effect.time_constant) if p]
        return (sum(parts), "s") if parts else None
    if name == "factor":
        if not effect.scale:
            return None
        s = values[effect.scale]
        return (1.0 / s if effect.id in DIVIDES else s), "1"
    if name == "amplitude":
        size = wave_amplitude(values)
        if size is None and len(values) >= 2 and not effect.spatial:  # a pendulum: horizontal and vertical part
            size = math.hypot(*list(values.values())[:2])
        return None if size is None else (size, candidate.parameters[0].unit)
    if name == "period":
        if effect.timed:
            return 1.0 / values[effect.timed], "s"
        if "k" in values:
            return 2.0 * math.pi / values["k"], units["k"].rpartition("/")[2]
        return 2.0 * math.pi, "rad"
    return None


def force_share(problem: Problem, fit: Fit, k: int) -> float:
    """RMS of the k-th effect's force over that of the force that moves its joint; 0 of what is no force at a joint."""
    candidate = fit.hypothesis.candidates[k]
    values = problem.split(fit.hypothesis, fit.z)[1][k]
    if isinstance(candidate.effect, GroundedEffect) and candidate.site.kind == "joint":
        model = problem.simulators(fit.hypothesis)[0].model(*problem.setting(fit.hypothesis, fit.z)[:2])
        row = getattr(model.ports[candidate.site.name], candidate.effect.of)[: len(problem.plant.states)]
        x = np.concatenate([r.smoothed.x if r.motion is None else r.motion for r in problem.records])
        size = abs(values[candidate.effect.symbol]) * float(np.sqrt(np.mean((x @ row) ** 2)))
        return size / candidate.scales.force
    motion = _motion(problem, fit, fit.z, k)
    return 0.0 if motion is None else float(np.sqrt(np.mean(motion.force**2))) / candidate.scales.force


class _Motion(NamedTuple):
    """Along all simulated windows: the effect's force, speed and position (None without one) of its joint, units."""

    force: Array
    speed: Array
    position: Array | None
    units: tuple[str, str, str]


def _motion(problem: Problem, fit: Fit, z: Array, k: int) -> _Motion | None:
    """Of an effect with a force law at a joint; None of any other."""
    if fit.hypothesis.candidates[k].site.kind != "joint":
        return None
    forces, speeds, places, units = [], [], [], ("", "", "")
    for i, simulator in enumerate(problem.simulators(fit.hypothesis)):
        record, chosen = problem.records[i], problem.chosen[i]
        factors, values, shift = problem.setting(fit.hypothesis, z)
        each = zip(simulator.effects, values, strict=True)
        laws = [j for j, ((e, site), v) in enumerate(each) for _ in e.laws(site, v)]
        if k not in laws:
            return None
        x0 = problem.starts_seen(i, simulator, values)
        x0[chosen] += record.x0_std[chosen] * fit.starts[i]
        windows = Windows(record.windows.starts[chosen], record.windows.length)
        motion = simulator.run(factors, values, x0[chosen], windows, shift)
        port = motion.model.ports[simulator.laws(values)[laws.index(k)].port]
        used = windows.starts[:, None] + np.arange(windows.length)
        x = motion.states if record.motion is None else record.motion[used]
        n = x.shape[-1]
        v = x @ port.velocity[:n]
        # The force noted at a sample is that of the step before it.
        forces.append(motion.forces[:, 1:, laws.index(k)].ravel())
        speeds.append((0.5 * (v[:, 1:] + v[:, :-1])).ravel())
        if port.position is not None:
            q = x @ port.position[:n]
            places.append((0.5 * (q[:, 1:] + q[:, :-1])).ravel())
        units = port.unit, port.speed_unit, port.position_unit
    q = np.concatenate(places) if places else None
    return _Motion(np.concatenate(forces), np.concatenate(speeds), q, units)


def _along(problem: Problem, fit: Fit, z: Array, k: int, name: Quantity) -> tuple[float, str] | None:
    """Of an effect with a force law: from its force along the simulated windows."""
    motion = _motion(problem, fit, z, k)
    if motion is None:
        return None
    f, v, q, units = motion
    if name == "level":
        return _over(-float(f @ v), float(np.abs(v).sum())), units[0]
    if name == "viscous":
        return _over(-float(f @ v), float(v @ v)), f"{units[0]} s/{units[1].removesuffix('/s')}" if units[0] else ""
    if name == "force":
        return -float(f.mean()), units[0]
    if q is None:
        return None
    q = q - q.mean()
    return _over(-float(f @ q), float(q @ q)), f"{units[0]}/{units[2]}" if units[0] else ""


def _over(a: float, b: float) -> float:
    return a / b if b > 0.0 else math.nan
