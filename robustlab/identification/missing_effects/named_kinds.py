"""Effect classes at places: probabilities summed over all sets with a member of the class, quantities with 95 %
intervals over the members, and the shares of the members.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from typing import NamedTuple

import numpy as np

from robustlab.arrays import Array
from robustlab.dynamics.effects.catalogue import KIND_OF, KINDS, MEANINGS, Kind, Quantity, upwards
from robustlab.dynamics.effects.contract import Site
from robustlab.dynamics.effects.parameter_effects import GroundedEffect
from robustlab.dynamics.extended.simulator import Windows
from robustlab.dynamics.plant_contract import NonlinearPlant
from robustlab.dynamics.ports.port_model import AnyPlant, Port, PortModel, port_model
from robustlab.identification import tuning
from robustlab.identification.greybox.effect_fit import Candidate, Fit, Hypothesis, Problem
from robustlab.identification.missing_effects.discovery_parts import (
    INTERVAL,
    EffectValue,
    KindMember,
    NamedKind,
    wave_amplitude,
)
from robustlab.identification.missing_effects.posterior import Posterior, Weighted

MOST_MEMBERS = 4  # that contribute to a class's quantities: smaller shares would change no digit
OF_JOINT: tuple[Quantity, ...] = ("level", "viscous", "stiffness", "force")
OF_ONE: tuple[Quantity, ...] = ("amplitude", "period")  # undefined for the sum of two waves
DIVIDES = ("inertia", "resistance")  # factors whose inverse scales the path from input to sensor
APART = 0.2  # finite difference of a parameter, in standard deviations

Place = tuple[str, str]  # class, place
Places = Callable[[Site, str], str]  # site of an effect, where its class acts


def places_of(plant: AnyPlant, model: PortModel) -> Places:
    """Return the function from an effect's site and where its class acts to the place: joint, path, or site."""
    joints = [p for p in model.ports.values() if p.kind == "joint"]
    paths = {} if len(plant.inputs) == 1 else _paths(plant, model, joints)

    @cache
    def place(site: Site, where: str) -> str:
        if where == "path" and len(plant.inputs) == 1:
            outputs = plant.outputs
            return f"{plant.inputs[0].name} to {outputs[0].name if len(outputs) == 1 else 'the sensors'}"
        if where == "path":
            return paths.get(site.name, site.name)
        if where != "joint" or site.kind != "parameter":
            return site.name
        if len(joints) == 1:
            return joints[0].name
        if isinstance(plant, NonlinearPlant) or not joints:
            return site.name
        # The joint whose equation of motion the parameters change most.
        names = site.name.split("+")
        change = port_model(plant, dict.fromkeys(names, 2.0)).A - port_model(plant).A
        moved = [float(np.abs(p.velocity[: len(change)] @ change).sum()) for p in joints]
        return joints[int(np.argmax(moved))].name

    return place


def _paths(plant: AnyPlant, model: PortModel, joints: Sequence[Port]) -> dict[str, str]:
    """Return input or output -> its path, of a plant with several inputs."""
    # An input's path ends at the first sensor of the joint that it moves most, if no other input moves that joint most.
    a, b, c = (np.abs(m).reshape(-1, *m.shape[-2:]).max(axis=0) for m in (model.A, model.B, model.C))
    moved: dict[str, list[str]] = defaultdict(list)
    for signal, pushed in zip(plant.inputs, b[:, : len(plant.inputs)].T, strict=True):
        for reach in (pushed, a @ pushed):  # at once, or through a current
            reached = [float(np.abs(p.velocity) @ reach) for p in joints]
            if max(reached, default=0.0) > 0.0:
                moved[joints[int(np.argmax(reached))].name].append(signal.name)
                break
    found = {}
    for joint in joints:
        own = [np.abs(vector) for vector in (joint.position, joint.velocity) if vector is not None]
        read = [s.name for vector in own for s, row in zip(plant.outputs, c, strict=True) if row @ vector > 0.0]
        if len(moved[joint.name]) == 1 and read:
            path = f"{moved[joint.name][0]} to {read[0]}"
            found.update(dict.fromkeys([moved[joint.name][0], *read], path))
    return found


class Kinds:
    """Probabilities of effect classes at places over the sets of a posterior; ``ignored``: keys of excluded effects."""

    def __init__(self, problem: Problem, posterior: Posterior, ignored: frozenset[str]) -> None:
        model = problem.simulators(Hypothesis(()))[0].model({}, [])
        self.posterior, self.places, self.ignored = posterior, places_of(problem.plant, model), ignored
        self.probability: dict[Place, float] = defaultdict(float)
        for entry in posterior.sets:
            held = {n for c in entry.fit.hypothesis.candidates if c.key not in ignored for n in self.above(c)}
            for node in held:
                self.probability[node] += entry.probability

    def above(self, candidate: Candidate) -> list[Place]:
        """Return the classes of an effect with their places, the narrowest first."""
        return [(kind.id, self.places(candidate.site, kind.where)) for kind in upwards(KIND_OF[candidate.effect.id])]

    def sure_kind(self, candidate: Candidate) -> Place | None:
        """Return the narrowest sure and informative class of the effect, or None."""
        # A wider class may replace an open narrower one if no other class within it is sure.
        for kind, place in self.above(candidate):
            if KINDS[kind].wider is None and KIND_OF[candidate.effect.id] != kind:
                return None  # "a force" is no name
            if self.probability[kind, place] >= tuning.SURE:
                return (kind, place) if (kind, place) == self.above(candidate)[0] or self._alone(kind, place) else None
        return None

    def _alone(self, kind: str, place: str) -> bool:
        """Return whether no class within this one is sure there."""
        return not any(
            p >= tuning.SURE and k != kind and at == place and kind in (w.id for w in upwards(k))
            for (k, at), p in self.probability.items()
        )

    def open(self) -> list[Candidate]:
        """Return effects of any set whose class is neither sure nor excluded."""
        found: dict[str, Candidate] = {}
        for entry in self.posterior.sets:
            for c in entry.fit.hypothesis.candidates:
                narrow = self.above(c)[0]
                if c.key in self.ignored or self.probability[narrow] <= 1.0 - tuning.SURE:
                    continue
                if self.sure_kind(c) is None:
                    found.setdefault(c.key, c)
        return list(found.values())

    def named(self, problem: Problem, remains: bool) -> tuple[NamedKind, ...]:
        """Return the sure classes in order of the best set's effects; ``remains``: more than noise is unexplained."""
        nodes = dict.fromkeys(
            node for entry in self.posterior.sets for c in entry.fit.hypothesis.candidates
            if c.key not in self.ignored and (node := self.sure_kind(c)) is not None
        )  # fmt: skip
        return tuple(self._named(problem, *node, remains or self.posterior.coarse) for node in nodes)

    def _named(self, problem: Problem, kind: str, place: str, misfit: bool) -> NamedKind:
        holding = [(w, own) for w in self.posterior.sets if (own := self._members(w, kind, place))]
        shares: dict[str, float] = defaultdict(float)
        sites: dict[str, Candidate] = {}
        whole = sum(w.probability for w, _ in holding)
        for w, own in holding:
            for k in own:
                c = w.fit.hypothesis.candidates[k]
                shares[c.key] += w.probability / whole
                sites[c.key] = c
        members = tuple(
            KindMember(c.effect.id, c.effect.title, c.site.name, min(1.0, share))
            for share, c in sorted(((s, sites[key]) for key, s in shares.items()), key=lambda m: -m[0])
        )
        main = sorted(holding, key=lambda h: -h[0].probability)[:MOST_MEMBERS]
        parts = [(w.probability, quantities(problem, w.fit, own, KINDS[kind])) for w, own in main]
        values = [v for name in KINDS[kind].quantities if (v := _mixture(name, parts)) is not None]
        return NamedKind(
            kind, KINDS[kind].title, place, min(1.0, self.probability[kind, place]), tuple(values), members,
            KINDS[kind].form, misfit,
        )  # fmt: skip

    def _members(self, entry: Weighted, kind: str, place: str) -> list[int]:
        own = enumerate(entry.fit.hypothesis.candidates)
        return [k for k, c in own if c.key not in self.ignored and (kind, place) in self.above(c)]


def _mixture(name: Quantity, members: Sequence[tuple[float, Mapping[Quantity, Estimate]]]) -> EffectValue | None:
    """Return mean and 95 % interval of a quantity over the members that have it in the first one's unit."""
    own = [(weight, values[name]) for weight, values in members if name in values]
    own = [(weight, t) for weight, t in own if t.unit == own[0][1].unit]
    total = sum(weight for weight, _ in own)
    if not own or not total > 0.0:
        return None
    parts = [(weight / total, t) for weight, t in own]
    mean = sum(weight * t.value for weight, t in parts)
    half = INTERVAL * math.sqrt(sum(weight * (t.std**2 + (t.value - mean) ** 2) for weight, t in parts))
    return EffectValue(name, mean, parts[0][1].unit, mean - half, mean + half, MEANINGS[name])


# --- quantities: from the parameters, or from the force f along the records' motion, with speed v and position q ------
#     level -sum(f v) / sum|v|, viscous -sum(f v) / sum(v^2), stiffness -cov(f, q) / var(q), force -mean(f)


class Estimate(NamedTuple):
    """A quantity of one member: value, standard deviation, unit."""

    value: float
    std: float
    unit: str


def quantities(problem: Problem, fit: Fit, members: Sequence[int], kind: Kind) -> dict[Quantity, Estimate]:
    """Return the combined quantities of the effects of one class (indices ``members``) in a fitted set."""
    # Forces and times add up, factors multiply; amplitude and period are defined for one effect only.
    places = problem.slices(fit.hypothesis)
    own = np.concatenate([np.arange(len(fit.z))[places[k][1]] for k in members])
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
            found[name] = Estimate(value, math.sqrt(max(variance, 0.0)), unit)
    return found


def _together(
    problem: Problem, fit: Fit, z: Array, members: Sequence[int], kind: Kind
) -> dict[Quantity, tuple[float, str]]:
    """Return value and unit of each combined quantity at the parameters z."""
    found: dict[Quantity, tuple[float, str]] = {}
    for name in kind.quantities:
        each = [t for k in members if (t := _of_member(problem, fit, z, k, name)) is not None]
        if len(each) < len(members) or len({unit for _, unit in each}) > 1:
            continue
        if len(each) == 1:
            found[name] = each[0]
        elif name not in OF_ONE:
            values = [value for value, _ in each]
            found[name] = (math.prod(values) if name == "factor" else sum(values)), each[0][1]
    return found


def _of_member(problem: Problem, fit: Fit, z: Array, k: int, name: Quantity) -> tuple[float, str] | None:
    """Return value and unit of one effect's quantity; None if it has none."""
    candidate = fit.hypothesis.candidates[k]
    own = problem.split(fit.hypothesis, z)[1][k]
    if name in OF_JOINT:
        return _coefficient(problem, candidate, own, name) or _along(problem, fit, z, k, name)
    return _of_parameters(candidate, own, name)


def _coefficient(
    problem: Problem, candidate: Candidate, values: Mapping[str, float], name: Quantity
) -> tuple[float, str] | None:
    """Return the coefficient of a linear effect at a joint, or the change of the plant's parameter."""
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
    """Return the RMS of the k-th effect's force over that of the force that moves its joint; 0 without a force."""
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
    """Over all simulated windows: the effect's force, speed and position (or None) of its joint, units."""

    force: Array
    speed: Array
    position: Array | None
    units: tuple[str, str, str]


def _motion(problem: Problem, fit: Fit, z: Array, k: int) -> _Motion | None:
    """Simulate the force of an effect with a force law at a joint; None for any other."""
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
        # The force stored at a sample is that of the step before it.
        forces.append(motion.forces[:, 1:, laws.index(k)].ravel())
        speeds.append((0.5 * (v[:, 1:] + v[:, :-1])).ravel())
        if port.position is not None:
            q = x @ port.position[:n]
            places.append((0.5 * (q[:, 1:] + q[:, :-1])).ravel())
        units = port.unit, port.speed_unit, port.position_unit
    q = np.concatenate(places) if places else None
    return _Motion(np.concatenate(forces), np.concatenate(speeds), q, units)


def _along(problem: Problem, fit: Fit, z: Array, k: int, name: Quantity) -> tuple[float, str] | None:
    """Return the quantity of an effect with a force law from its force over the simulated windows."""
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
