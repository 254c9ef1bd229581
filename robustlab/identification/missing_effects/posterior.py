"""Posterior of the sets of effects, P(S) ~ exp(E(S) / T) with the log evidence E under sensor noise and a random force,
and of the effect classes at places: probabilities summed over all sets with a member, quantities over the members.

T is 1, or more if a residual force of the best set has evidence (coarsened posterior: Miller, Dunson, JASA 114, 2019).
Evidence of an effect that the refit distance does not support (below 3) does not count.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property

import numpy as np

from robustlab.arrays import Array
from robustlab.dynamics.effects.catalogue import KIND_OF, KINDS, Kind, Quantity, upwards
from robustlab.dynamics.effects.effect import Site
from robustlab.dynamics.effects.parameter_effects import GroundedEffect
from robustlab.dynamics.extended.simulator import Windows
from robustlab.dynamics.plant_base import NonlinearPlant
from robustlab.dynamics.ports.port_model import AnyPlant, Port, PortModel, port_model
from robustlab.identification import constants
from robustlab.identification.greybox import noise as noises
from robustlab.identification.greybox import residual_force as residual
from robustlab.identification.greybox.effect_fit import Candidate, Fit, Hypothesis, NoiseModel, Problem, refit_distance
from robustlab.identification.greybox.random_force import FittedWindows
from robustlab.identification.missing_effects.discovery_result import EffectValue, NamedKind, wave_amplitude
from robustlab.identification.missing_effects.effect_search import Found, Key, Scored, related

TEMPERATURE = 1.0  # smallest divisor of log evidence: above 1, less sure
MOST_WEIGHED = 5  # sets evaluated under a random force
MOST_RIVALS = 5  # examined for each named effect
NO_EVIDENCE = 2.0  # log Bayes factor without significance
IRRELEVANT = 0.005  # probability below which a set does not change the verdict
MOST_MEMBERS = 4  # that contribute to a class's quantities: smaller shares would change no digit
OF_JOINT: tuple[Quantity, ...] = ("level", "viscous", "stiffness", "force")
OF_ONE: tuple[Quantity, ...] = ("amplitude", "period")  # undefined for the sum of two waves
DIVIDES = ("inertia", "resistance")  # factors whose inverse scales the path from input to sensor
APART = 0.2  # finite difference of a parameter, in standard deviations

Place = tuple[str, str]  # class, place
Values = dict[Quantity, tuple[float, str]]  # quantity -> value, unit
Estimates = Mapping[Quantity, tuple[float, float, str]]  # quantity of one member -> value, standard deviation, unit
# Over all simulated windows: an effect's force, speed and position (or None) of its joint, their units.
Motion = tuple[Array, Array, Array | None, tuple[str, str, str]]


@dataclass(frozen=True, eq=False)
class Weighted:
    """A set with probability, log evidence, refit distance from the best (NaN: not computed), and residual force."""

    scored: Scored
    probability: float
    evidence: float
    distance: float
    unnamed: residual.UnnamedEvidence | None = None

    @property
    def fit(self) -> Fit:
        return self.scored.fit

    @property
    def key(self) -> Key:
        return self.scored.key


@dataclass(frozen=True, eq=False)
class Posterior:
    """Sets of effects, the most probable first."""

    sets: tuple[Weighted, ...]
    collection: tuple[Weighted, ...]  # the smallest that is sure, and sets indistinguishable from the best
    generalises: bool  # False if every more probable set than the empty one fails on held-out data
    weight: Weight | None  # of the best set
    coarse: bool  # whether log evidence is divided because of a residual force

    @property
    def left(self) -> tuple[residual.Unnamed, ...]:
        """Return the residual force of the best set by place; nothing if it is unknown."""
        return self.weight.left if self.weight else ()

    @property
    def noise_ratio(self) -> float:
        """Return the error of the best set over noise and random force, the largest over the places; NaN if unknown."""
        return max((u.noise_ratio for u in self.left), default=np.nan)

    @property
    def best(self) -> Weighted:
        return self.sets[0]

    def alternatives(self) -> list[tuple[Candidate, Candidate | None, Weighted]]:
        """Return each effect that the best set lacks, the one that it replaces (None: added), and its set."""
        here = {c.key: c for c in self.best.fit.hypothesis.candidates}
        found: dict[str, tuple[Candidate, Candidate | None, Weighted]] = {}
        for other in self.collection[1:]:
            missing = [c for key, c in here.items() if key not in other.key]
            for candidate in other.fit.hypothesis.candidates:
                if candidate.key not in here and candidate.key not in found:
                    place = next((m for m in missing if m.site == candidate.site), missing[0] if missing else None)
                    found[candidate.key] = candidate, place, other
        return list(found.values())


@dataclass(frozen=True, eq=False)
class Weight:
    """A set over all windows under a random force at each possible place; ``price``: log cost of fitted phases."""

    places: tuple[tuple[FittedWindows, Site], ...]
    price: float

    @property
    def log_likelihood(self) -> float:
        """Return the log likelihood at the most probable place of the random force."""
        return max(windows.log_likelihood for windows, _ in self.places) - self.price

    @property
    def random_share(self) -> float:
        """Return the random force over the force that moves the port, the largest over the places."""
        return max(windows.alone.size for windows, _ in self.places)

    @cached_property
    def left(self) -> tuple[residual.Unnamed, ...]:
        """Return the residual force by place; nothing if its equations are singular."""
        try:
            with np.errstate(all="ignore"):
                return tuple(residual.unnamed_force(windows, place) for windows, place in self.places)
        except residual.SINGULAR:
            return ()

    @property
    def force(self) -> residual.UnnamedEvidence | None:
        """Return the most probable of the significant residual forces."""
        return max((f for u in self.left for f in u.forces if f.wins), key=lambda f: f.gain, default=None)


def weigh(found: Found) -> Posterior:
    """Return the posterior of the evaluated sets."""
    problem = found.problem
    ordered, generalises = _generalising(found)
    # If the error is far beyond the sensor noise, a random force predicts the next sample better than any law: then the
    # simulated windows determine the evidence, and the force only shows whether something remains.
    near = noises.noise_ratio(problem, ordered[0].fit) < constants.BEYOND_NOISE
    weights = _weights(found, ordered) if near else {}
    evidence = {v.key: v.evidence for v in ordered}
    if ordered[0].key in weights:
        again = {v.key: weights[v.key].log_likelihood + v.prior for v in ordered if v.key in weights}
        before, now = max(evidence[key] for key in again), max(again.values())
        # Sets too far behind for a second evaluation keep their distance.
        evidence = {key: again.get(key, value - before + now) for key, value in evidence.items()}
    evidence = {v.key: evidence[v.key] + _within(problem, v.fit) for v in ordered}
    forces = _forces(ordered, evidence, weights)
    if near:
        evidence = {key: value + (forces[key].gain if key in forces else 0.0) for key, value in evidence.items()}
    ordered.sort(key=lambda v: -evidence[v.key])
    distance = _lift(problem, ordered, evidence)
    temperature = _temperature(ordered[0], weights)
    log = np.array([evidence[v.key] for v in ordered]) / temperature
    share = np.exp(log - log.max())
    share /= share.sum()
    weighed = [
        Weighted(v, float(p), evidence[v.key], distance.get(v.key, np.nan), forces.get(v.key))
        for v, p in zip(ordered, share, strict=True)
    ]
    sets = sorted(_without_undecided(problem, weighed, temperature), key=lambda w: -w.probability)
    if sets[0].key not in weights and (weight := weight_of(found, sets[0].fit)) is not None:
        weights[sets[0].key] = weight
        sets[0] = replace(sets[0], unnamed=weight.force)
    # The smallest collection that is sure, and the sets indistinguishable from the best.
    before = np.cumsum([0.0, *(w.probability for w in sets)])
    collection = tuple(
        w for w, total in zip(sets, before.tolist(), strict=False)
        if total < constants.SURE or distance.get(w.key, np.inf) < constants.CANNOT_TELL
    )  # fmt: skip
    return Posterior(tuple(sets), collection, generalises, weights.get(sets[0].key), temperature > TEMPERATURE)


def _within(problem: Problem, fit: Fit) -> float:
    """Return the log probability that the parameters which a fit moved beyond their tolerances lie within them."""
    # Such a parameter may also be a parameter effect: both sets predict the same, and the tolerance decides.
    each = zip(problem.nuisances, fit.z.tolist(), fit.std.tolist(), strict=False)
    return sum(n.log_within(z, std) for n, z, std in each if not n.ends[0] <= z <= n.ends[1])


def _temperature(best: Scored, weights: Mapping[Key, Weight]) -> float:
    """Return the divisor of log evidence: that of the residual force over that of a sure effect."""
    # A line over position or time does not count: it cannot come from a wrong form of another effect.
    left = weights[best.key].left if best.key in weights else ()
    smooth = (f.gain for u in left for f in u.forces if f.wins and not np.isfinite(f.period))
    gain = max(smooth, default=0.0)
    return max(TEMPERATURE, gain / float(np.log(constants.SURE / (1.0 - constants.SURE))))


def _weights(found: Found, ordered: Sequence[Scored]) -> dict[Key, Weight]:
    """Evaluate the sets close to the best, and the smaller sets of the one that is best under a random force."""
    # The noise of the search has no random force, whose path an effect with a free period can follow: then the smaller
    # set is far behind in the search.
    close = [v for v in ordered if ordered[0].evidence - v.evidence < constants.FAR_BEHIND][:MOST_WEIGHED]
    close += [v for v in ordered if not v.key and v not in close]
    weights: dict[Key, Weight] = {}
    plausible, tried = weights, set[Key]()
    while close:
        tried |= {v.key for v in close}
        weights |= {v.key: weight for v in close if (weight := weight_of(found, v.fit)) is not None}
        # A larger random force is not noise: it replaces a missing effect, and predicts the next sample better than any
        # law.
        plausible = {k: w for k, w in weights.items() if w.random_share < constants.MOST_RANDOM} or weights
        rated = [(plausible[v.key].log_likelihood + v.prior, v) for v in ordered if v.key in plausible]
        best = max(rated, key=lambda r: r[0])[1] if rated else None
        close = [v for v in _one_apart(best, ordered)[0] if v.key not in tried] if best else []
    return plausible


def _lift(problem: Problem, ordered: Sequence[Scored], evidence: dict[Key, float]) -> dict[Key, float]:
    """Raise the evidence of sets indistinguishable from the best one; return refit distances from the best."""

    def raised(best: Scored, others: Sequence[Scored]) -> dict[Key, float]:
        distance = {other.key: refit_distance(problem, best.fit, other.fit) for other in others}
        for other in others:
            d = distance[other.key]
            if d < constants.CANNOT_TELL:
                change = other.prior + _within(problem, other.fit) - best.prior - _within(problem, best.fit)
                evidence[other.key] = max(evidence[other.key], evidence[best.key] - 0.5 * d**2 + change)
        return distance

    # A set with one effect less that becomes more probable replaces the best one.
    best = ordered[0]
    while True:
        near = [v for v in ordered if v is not best and best.evidence - v.evidence <= constants.FAR_BEHIND]
        less, exchanged = _one_apart(best, near)
        distance = {best.key: 0.0} | raised(best, less)
        ahead = max([best, *less], key=lambda v: evidence[v.key])
        if ahead is best:
            return distance | raised(best, exchanged[:MOST_RIVALS])
        best = ahead


def _without_undecided(problem: Problem, weighed: Sequence[Weighted], temperature: float) -> list[Weighted]:
    """Drop sets with a further effect for which the records have no evidence either way."""

    # Judged by the evidence without priors, or by the refit distance; the smaller set gets their probability.
    def undecided(entry: Weighted, less: Weighted) -> bool:
        if not less.key < entry.key:
            return False
        gain = entry.evidence - entry.scored.prior - (less.evidence - less.scored.prior)
        if gain < NO_EVIDENCE * temperature:
            return True
        relevant = entry.probability > IRRELEVANT and less.probability > entry.probability
        return relevant and refit_distance(problem, entry.fit, less.fit) < constants.CANNOT_TELL

    kept: dict[Key, Weighted] = {}
    for entry in sorted(weighed, key=lambda w: len(w.key)):
        within = [less for less in kept.values() if undecided(entry, less)]
        if within:
            less = max(within, key=lambda w: w.probability)
            kept[less.key] = replace(less, probability=less.probability + entry.probability)
        else:
            kept[entry.key] = entry
    return [kept[w.key] for w in weighed if w.key in kept]


def weight_of(found: Found, fit: Fit) -> Weight | None:
    """Evaluate a set on all windows under a random force; None with too little motion."""
    problem = found.problem
    held, price = noises.in_phase(found.held, fit, problem.records)
    # Fitted and held-out windows of a record are joined in order of time.
    records, chosen, starts = list(problem.records), list(problem.chosen), list(fit.starts)
    placed = noises.held_out_fit(held, fit, found.noise).starts
    for record, more, theirs in zip(held.records, held.chosen, placed, strict=True):
        k = next((k for k, r in enumerate(records) if r is record), len(records))
        own, at = (chosen[k], starts[k]) if k < len(records) else (more[:0], theirs[:0])
        order = np.argsort(every := np.append(own, more))
        records[k : k + 1], chosen[k : k + 1] = [record], [every[order]]
        starts[k : k + 1] = [np.concatenate([at, theirs])[order]]
    try:
        with np.errstate(all="ignore"):
            whole = residual.fitted_windows(problem.on(records, chosen), replace(fit, starts=tuple(starts)))
            weight = Weight(whole, price)
    except residual.SINGULAR:
        return None
    return weight if np.isfinite(weight.log_likelihood) else None


def _forces(
    ordered: Sequence[Scored], evidence: Mapping[Key, float], weights: Mapping[Key, Weight]
) -> dict[Key, residual.UnnamedEvidence]:
    """Return the residual force of each set; if the best set has none, only that of the empty one."""
    best = max((v.key for v in ordered), key=evidence.__getitem__)
    keys = weights if best in weights and weights[best].force is not None else {Key(), best} & weights.keys()
    return {key: force for key in keys if (force := weights[key].force) is not None}


def _generalising(found: Found) -> tuple[list[Scored], bool]:
    """Return the allowed sets that do not fail on held-out data, and whether the best set does not fail."""
    plain = NoiseModel(found.noise.std, found.noise.ar[:0])

    def errors(visited: Scored) -> Array:
        phased, _ = noises.in_phase(found.held, visited.fit, found.problem.records)
        return noises.window_errors(phased, noises.held_out_fit(phased, visited.fit, plain))

    refitted, left, failed = errors(found.empty), list[Scored](), list[Scored]()
    for visited in (v for v in found.sets if v.allowed):
        judged = visited.key and len(left) < MOST_WEIGHED
        (failed if judged and noises.clearly_larger(errors(visited), refitted) else left).append(visited)
    return left, bool(left[0].key) or not any(v.evidence > found.empty.evidence for v in failed)


def _one_apart(best: Scored, others: Iterable[Scored]) -> tuple[list[Scored], list[Scored]]:
    """Return sets with one effect less or refined by one of the best set, and sets with one effect exchanged."""
    less, exchanged = [], []
    for other in others:
        out = [c for c in best.fit.hypothesis.candidates if c.key not in other.key]
        new = [c for c in other.fit.hypothesis.candidates if c.key not in best.key]
        if len(out) != 1 or len(new) > 1:
            continue
        if all(c.site == out[0].site and c.effect.id == out[0].effect.refines for c in new):
            less.append(other)
        elif not related(new[0], out[0]):
            exchanged.append(other)
    return less, exchanged


# --- classes at places -----------------------------------------------------------------------------------------------


def places_of(plant: AnyPlant, model: PortModel) -> Callable[[Site, str], str]:
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
        self.problem, self.posterior, self.places = problem, posterior, places_of(problem.plant, model)
        self.effects = [
            (w, k, c) for w in posterior.sets for k, c in enumerate(w.fit.hypothesis.candidates)
            if c.key not in ignored
        ]  # fmt: skip
        self.probability: dict[Place, float] = defaultdict(float)
        for w, node in dict.fromkeys((w, node) for w, _, c in self.effects for node in self.above(c)):
            self.probability[node] += w.probability

    def above(self, candidate: Candidate) -> list[Place]:
        """Return the classes of an effect with their places, the narrowest first."""
        return [(kind.id, self.places(candidate.site, kind.where)) for kind in upwards(KIND_OF[candidate.effect.id])]

    def sure_kind(self, candidate: Candidate) -> Place | None:
        """Return the narrowest sure and informative class of the effect, or None."""
        # A wider class may replace an open narrower one if no other class within it is sure.
        for kind, place in self.above(candidate):
            if KINDS[kind].wider is None and KIND_OF[candidate.effect.id] != kind:
                return None  # "a force" is no name
            if self.probability[kind, place] >= constants.SURE:
                return (kind, place) if (kind, place) == self.above(candidate)[0] or self._alone(kind, place) else None
        return None

    def _alone(self, kind: str, place: str) -> bool:
        """Return whether no class within this one is sure there."""
        return not any(
            p >= constants.SURE and k != kind and at == place and kind in (w.id for w in upwards(k))
            for (k, at), p in self.probability.items()
        )

    @property
    def open(self) -> bool:
        """Return whether a set has an effect whose class is neither sure nor excluded."""
        return any(
            self.probability[self.above(c)[0]] > 1.0 - constants.SURE and self.sure_kind(c) is None
            for _, _, c in self.effects
        )

    def named(self, remains: bool) -> tuple[NamedKind, ...]:
        """Return the sure classes in order of the best set's effects; ``remains``: more than noise is unexplained."""
        nodes = dict.fromkeys(node for _, _, c in self.effects if (node := self.sure_kind(c)) is not None)
        return tuple(self._named(*node, remains or self.posterior.coarse) for node in nodes)

    def _named(self, kind: str, place: str, misfit: bool) -> NamedKind:
        holding: dict[Weighted, list[int]] = defaultdict(list)
        for w, k, c in self.effects:
            if (kind, place) in self.above(c):
                holding[w].append(k)
        shares: dict[str, float] = defaultdict(float)
        whole = sum(w.probability for w in holding)
        for w, own in holding.items():
            for k in own:
                shares[w.fit.hypothesis.candidates[k].key] += w.probability / whole
        members = {name: min(1.0, share) for name, share in sorted(shares.items(), key=lambda m: -m[1])}
        main = sorted(holding, key=lambda w: -w.probability)[:MOST_MEMBERS]
        parts = [(w.probability, quantities(self.problem, w.fit, holding[w], KINDS[kind])) for w in main]
        values = [v for name in KINDS[kind].quantities if (v := _mixture(name, parts)) is not None]
        return NamedKind(kind, place, min(1.0, self.probability[kind, place]), tuple(values), members, misfit)


def _mixture(name: Quantity, members: Sequence[tuple[float, Estimates]]) -> EffectValue | None:
    """Return mean and 95 % interval of a quantity over the members that have it in the first one's unit."""
    own = [(weight, *values[name]) for weight, values in members if name in values]
    own = [part for part in own if part[3] == own[0][3]]
    total = sum(weight for weight, *_ in own)
    if not own or not total > 0.0:
        return None
    mean = sum(weight / total * value for weight, value, *_ in own)
    variance = sum(weight / total * (std**2 + (value - mean) ** 2) for weight, value, std, _ in own)
    half = constants.INTERVAL * math.sqrt(variance)
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
        x = motion.states if record.motion is None else record.motion[record.samples[chosen]]
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
