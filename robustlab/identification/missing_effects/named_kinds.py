"""Effect classes at places: probabilities summed over all sets with a member of the class, quantities with 95 %
intervals over the members, and the shares of the members.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from functools import cache

import numpy as np

from robustlab.arrays import Array
from robustlab.dynamics.effects.catalogue import KIND_OF, KINDS, Kind, Quantity, upwards
from robustlab.dynamics.effects.contract import Site
from robustlab.dynamics.effects.parameter_effects import GroundedEffect
from robustlab.dynamics.extended.simulator import Windows
from robustlab.dynamics.plant_contract import NonlinearPlant
from robustlab.dynamics.ports.port_model import AnyPlant, Port, PortModel, port_model
from robustlab.identification import tuning
from robustlab.identification.greybox.effect_fit import Candidate, Fit, Hypothesis, Problem
from robustlab.identification.missing_effects.discovery_result import EffectValue, NamedKind, wave_amplitude
from robustlab.identification.missing_effects.posterior import Posterior, place_of

MOST_MEMBERS = 4  # that contribute to a class's quantities: smaller shares would change no digit
OF_JOINT: tuple[Quantity, ...] = ("level", "viscous", "stiffness", "force")
OF_ONE: tuple[Quantity, ...] = ("amplitude", "period")  # undefined for the sum of two waves
DIVIDES = ("inertia", "resistance")  # factors whose inverse scales the path from input to sensor
APART = 0.2  # finite difference of a parameter, in standard deviations

Place = tuple[str, str]  # class, place
Values = dict[Quantity, tuple[float, str]]  # quantity -> value, unit
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
        holding = []
        for w in self.posterior.sets:
            each = enumerate(w.fit.hypothesis.candidates)
            if own := [k for k, c in each if c.key not in self.ignored and (kind, place) in self.above(c)]:
                holding.append((w, own))
        shares: dict[str, float] = defaultdict(float)
        whole = sum(w.probability for w, _ in holding)
        for w, own in holding:
            for k in own:
                shares[place_of(w.fit.hypothesis.candidates[k])] += w.probability / whole
        members = {name: min(1.0, share) for name, share in sorted(shares.items(), key=lambda m: -m[1])}
        main = sorted(holding, key=lambda h: -h[0].probability)[:MOST_MEMBERS]
        parts = [(w.probability, quantities(problem, w.fit, own, KINDS[kind])) for w, own in main]
        values = [v for name in KINDS[kind].quantities if (v := _mixture(name, parts)) is not None]
        return NamedKind(kind, place, min(1.0, self.probability[kind, place]), tuple(values), members, misfit)


Estimates = Mapping[Quantity, tuple[float, float, str]]  # quantity of one member -> value, standard deviation, unit


def _mixture(name: Quantity, members: Sequence[tuple[float, Estimates]]) -> EffectValue | None:
    """Return mean and 95 % interval of a quantity over the members that have it in the first one's unit."""
    own = [(weight, *values[name]) for weight, values in members if name in values]
    own = [part for part in own if part[3] == own[0][3]]
    total = sum(weight for weight, *_ in own)
    if not own or not total > 0.0:
        return None
    mean = sum(weight / total * value for weight, value, *_ in own)
    variance = sum(weight / total * (std**2 + (value - mean) ** 2) for weight, value, std, _ in own)
    half = tuning.INTERVAL * math.sqrt(variance)
    return EffectValue(name, mean, own[0][3], mean - half, mean + half)


# --- quantities: from the parameters, or from the force f along the records' motion, with speed v and position q ------
#     level -sum(f v) / sum|v|, viscous -sum(f v) / sum(v^2), stiffness -cov(f, q) / var(q), force -mean(f)


def quantities(problem: Problem, fit: Fit, members: Sequence[int], kind: Kind) -> Estimates:
    """Return the combined quantities of the effects of one class (indices ``members``) in a fitted set."""
    places = problem.slices(fit.hypothesis)
    own = np.concatenate([np.arange(len(fit.z))[places[k][1]] for k in members])
    middle = _together(problem, fit, fit.z, members, kind)
    whole = np.linalg.pinv(fit.hessian) if fit.covariance is None else fit.covariance
    slopes = {name: np.zeros(len(own)) for name in middle}
    for j, at in enumerate(own):
        step = max(APART * float(fit.std[at]), 1e-6)
        z = fit.z.copy()
        z[at] += step
        for name, (value, _) in _together(problem, fit, z, members, kind).items():
            slopes[name][j] = (value - middle[name][0]) / step
    found = {}
    for name, (value, unit) in middle.items():
        variance = float(slopes[name] @ whole[own][:, own] @ slopes[name])
        if math.isfinite(value) and math.isfinite(variance):
            found[name] = value, math.sqrt(max(variance, 0.0)), unit
    return found


def _together(problem: Problem, fit: Fit, z: Array, members: Sequence[int], kind: Kind) -> Values:
    """Return the combined quantities at the parameters z: forces and times add up, factors multiply."""
    each = [_of_effect(problem, fit, z, k, kind) for k in members]
    found: Values = {}
    for name in kind.quantities:
        own = [values[name] for values in each if name in values]
        if len(own) < len(each) or len({unit for _, unit in own}) > 1:
            continue
        if len(own) == 1 or name not in OF_ONE:
            values = [value for value, _ in own]
            found[name] = (math.prod(values) if name == "factor" else sum(values)), own[0][1]
    return found


def _of_effect(problem: Problem, fit: Fit, z: Array, k: int, kind: Kind) -> Values:
    """Return the quantities of one effect, at least those of the class that it has."""
    candidate, found = fit.hypothesis.candidates[k], Values()
    effect, own = candidate.effect, problem.split(fit.hypothesis, z)[1][k]
    unit = candidate.parameters[0].unit
    if set(OF_JOINT) & set(kind.quantities) and (motion := _motion(problem, fit, z, k)) is not None:
        f, v, q, (force, speed, position) = motion
        found["level"] = _over(-float(f @ v), float(np.abs(v).sum())), force
        found["viscous"] = _over(-float(f @ v), float(v @ v)), f"{force} s/{speed.removesuffix('/s')}" if force else ""
        found["force"] = -float(f.mean()), force
        if q is not None:
            q = q - q.mean()
            found["stiffness"] = _over(-float(f @ q), float(q @ q)), f"{force}/{position}" if force else ""
    if isinstance(effect, GroundedEffect):
        name = "stiffness" if effect.of == "position" else "viscous"
        if name in kind.quantities and candidate.site.kind == "joint":
            found[name] = own[effect.symbol], unit
        elif name in kind.quantities:  # the change of the plant's parameter
            parameter, factor = next(iter(effect.factors(problem.plant, candidate.site, own).items()))
            p = problem.plant.parameters[parameter]
            found[name] = p.reference * factor - p.value, p.unit
    if "delay" in kind.quantities and (late := [own[p] for p in (effect.delay, effect.time_constant) if p]):
        found["delay"] = sum(late), "s"
    if "factor" in kind.quantities and effect.scale:
        s = own[effect.scale]
        found["factor"] = (1.0 / s if effect.id in DIVIDES else s), "1"
    if "amplitude" in kind.quantities:
        size = wave_amplitude(own)
        if size is None and len(own) >= 2 and not effect.spatial:  # a pendulum: horizontal and vertical part
            size = math.hypot(*list(own.values())[:2])
        if size is not None:
            found["amplitude"] = size, unit
    if "period" in kind.quantities:
        found["period"] = 2.0 * math.pi, "rad"
        if effect.timed:
            found["period"] = 1.0 / own[effect.timed], "s"
        elif "k" in own:
            (per,) = (p.unit for p in candidate.parameters if p.name == "k")
            found["period"] = 2.0 * math.pi / own["k"], per.rpartition("/")[2]
    return found


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
    return 0.0 if motion is None else float(np.sqrt(np.mean(motion[0] ** 2))) / candidate.scales.force


# Over all simulated windows: an effect's force, speed and position (or None) of its joint, their units.
Motion = tuple[Array, Array, Array | None, tuple[str, str, str]]


def _motion(problem: Problem, fit: Fit, z: Array, k: int) -> Motion | None:
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
    return np.concatenate(forces), np.concatenate(speeds), q, units


def _over(a: float, b: float) -> float:
    return a / b if b > 0.0 else math.nan
