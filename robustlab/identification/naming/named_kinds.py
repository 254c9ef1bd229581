"""The answer at the level at which it is sure: probabilities of kinds of effects at places, summed over all sets that
have a member of them, their quantities with 95 % intervals over the members, and the shares of the members.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import replace
from statistics import NormalDist

import numpy as np

from robustlab.dynamics.effects.contract import Site
from robustlab.dynamics.effects.kinds import KIND_OF, KINDS, MEANINGS, Kind, Quantity, upwards
from robustlab.dynamics.plant_contract import NonlinearPlant
from robustlab.dynamics.ports.port_model import AnyPlant, Port, PortModel, port_model
from robustlab.identification import tuning
from robustlab.identification.hypotheses.effect_fit import Candidate, Hypothesis, Problem
from robustlab.identification.naming.discovery_result import EffectValue, KindMember, NamedKind
from robustlab.identification.naming.posterior import Posterior, Weighed
from robustlab.identification.naming.quantities import Told, quantities

MOST_MEMBERS = 4  # of a kind that its quantities are asked of: those of the smallest share would move no digit

Place = tuple[str, str]  # kind, place


class Places:
    """The place of an effect in a plant, by the kind that it is asked as."""

    def __init__(self, plant: AnyPlant, model: PortModel) -> None:
        self.plant = plant
        self.joints = [p for p in model.ports.values() if p.kind == "joint"]
        self._paths = {} if len(plant.inputs) == 1 else _paths(plant, model, self.joints)
        self._of: dict[tuple[Site, str], str] = {}

    def of(self, site: Site, kind: Kind) -> str:
        """The joint that it acts at, the path, or the site itself."""
        key = site, kind.where
        if key not in self._of:
            self._of[key] = self._found(site, kind)
        return self._of[key]

    def _found(self, site: Site, kind: Kind) -> str:
        if kind.where == "path":
            return self._path() if len(self.plant.inputs) == 1 else self._paths.get(site.name, site.name)
        if kind.where == "joint" and site.kind == "parameter":
            return self._joint_of(site.name.split("+"))
        return site.name

    def _path(self) -> str:
        """From the only input to the sensors."""
        outputs = self.plant.outputs
        return f"{self.plant.inputs[0].name} to {outputs[0].name if len(outputs) == 1 else 'the sensors'}"

    def _joint_of(self, names: Sequence[str]) -> str:
        """The joint whose equation of motion the parameters change most."""
        if len(self.joints) == 1:
            return self.joints[0].name
        if isinstance(self.plant, NonlinearPlant) or not self.joints:
            return "+".join(names)
        change = port_model(self.plant, dict.fromkeys(names, 2.0)).A - port_model(self.plant).A
        moved = [float(np.abs(p.velocity[: len(change)] @ change).sum()) for p in self.joints]
        return self.joints[int(np.argmax(moved))].name


def _paths(plant: AnyPlant, model: PortModel, joints: Sequence[Port]) -> dict[str, str]:
    """Input or output -> the path that it is a part of, of a plant with several inputs."""
    # An input's path goes to the first sensor of the joint that it moves most, if no other input moves that one most.
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
    """Probabilities of kinds at places over the sets of a posterior."""

    def __init__(
        self, posterior: Posterior, places: Places, sure: float, ignored: frozenset[str] = frozenset()
    ) -> None:
        self.posterior, self.places, self.sure, self.ignored = posterior, places, sure, ignored
        self.probability: dict[Place, float] = defaultdict(float)
        for entry in posterior.sets:
            held = {n for c in entry.fit.hypothesis.candidates if c.key not in ignored for n in self.above(c)}
            for node in held:
                self.probability[node] += entry.probability

    @property
    def coarse(self) -> bool:
        """Whether the best set leaves more than noise, and evidence counts in units of that."""
        return self.posterior.coarse

    def above(self, candidate: Candidate) -> list[Place]:
        """The kinds of an effect, the narrowest first, each with its place."""
        return [(kind.id, self.places.of(candidate.site, kind)) for kind in upwards(KIND_OF[candidate.effect.id])]

    def told(self, candidate: Candidate) -> Place | None:
        """The narrowest kind of the effect that is sure and informative; None where there is none."""
        # A wider kind may take the place of an open narrower one where no other kind within it is sure by itself.
        for kind, place in self.above(candidate):
            if KINDS[kind].wider is None and KIND_OF[candidate.effect.id] != kind:
                return None  # "a force" is no name
            if self.probability[kind, place] >= self.sure:
                return (kind, place) if (kind, place) == self.above(candidate)[0] or self._alone(kind, place) else None
        return None

    def _alone(self, kind: str, place: str) -> bool:
        """Whether no kind within this one is sure there."""
        return not any(
            p >= self.sure and k != kind and at == place and kind in (w.id for w in upwards(k))
            for (k, at), p in self.probability.items()
        )

    def open(self) -> list[Candidate]:
        """Effects of any set whose kind is neither sure nor excluded."""
        found: dict[str, Candidate] = {}
        for entry in self.posterior.sets:
            for c in entry.fit.hypothesis.candidates:
                narrow = self.above(c)[0]
                if c.key in self.ignored or self.probability[narrow] <= 1.0 - self.sure:
                    continue
                if self.told(c) is None:
                    found.setdefault(c.key, c)
        return list(found.values())

    def named(self, problem: Problem, remains: bool = False) -> tuple[NamedKind, ...]:
        """What is sure, in the order of the best set's effects; whether more than noise ``remains`` beside it."""
        nodes = dict.fromkeys(
            node for entry in self.posterior.sets for c in entry.fit.hypothesis.candidates
            if c.key not in self.ignored and (node := self.told(c)) is not None
        )  # fmt: skip
        return tuple(replace(self._named(problem, *node), misfit=remains or self.coarse) for node in nodes)

    def _named(self, problem: Problem, kind: str, place: str) -> NamedKind:
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
        asked = sorted(holding, key=lambda h: -h[0].probability)[:MOST_MEMBERS]
        told = [(w.probability, quantities(problem, w.fit, own, KINDS[kind])) for w, own in asked]
        values = [v for name in KINDS[kind].quantities if (v := _mixture(name, told)) is not None]
        return NamedKind(
            kind, KINDS[kind].title, place, min(1.0, self.probability[kind, place]), tuple(values), members,
            KINDS[kind].form,
        )  # fmt: skip

    def _members(self, entry: Weighed, kind: str, place: str) -> list[int]:
        """Indices of the set's effects of this kind there."""
        own = enumerate(entry.fit.hypothesis.candidates)
        return [k for k, c in own if c.key not in self.ignored and (kind, place) in self.above(c)]


def kinds_of(problem: Problem, posterior: Posterior, ignored: frozenset[str] = frozenset()) -> Kinds:
    """The kinds of a posterior; ``ignored``: keys of effects that decide nothing."""
    model = problem.simulators(Hypothesis(()))[0].model({}, [])
    return Kinds(posterior, Places(problem.plant, model), tuning.SURE, ignored)


def _mixture(name: Quantity, members: Sequence[tuple[float, Mapping[Quantity, Told]]]) -> EffectValue | None:
    """Mean and 95 % interval of a quantity over its members; those that cannot be asked, or in another unit, aside."""
    own = [(weight, told[name]) for weight, told in members if name in told]
    own = [(weight, t) for weight, t in own if t.unit == own[0][1].unit]
    total = sum(weight for weight, _ in own)
    if not own or not total > 0.0:
        return None
    parts = [(weight / total, t) for weight, t in own]
    mean = sum(weight * t.value for weight, t in parts)
    low, high = (_quantile(parts, q) for q in (0.025, 0.975))
    return EffectValue(name, mean, parts[0][1].unit, low, high, MEANINGS[name])


def _quantile(parts: Sequence[tuple[float, Told]], q: float) -> float:
    """Of a mixture of normal distributions, by bisection."""
    low = min(t.value - 9.0 * t.std for _, t in parts)
    high = max(t.value + 9.0 * t.std for _, t in parts)
    spread = [(weight, NormalDist(t.value, t.std) if t.std > 0.0 else None, t.value) for weight, t in parts]

    def below(x: float) -> float:
        return sum(w * (float(x >= v) if d is None else d.cdf(x)) for w, d, v in spread)

    for _ in range(80):
        middle = 0.5 * (low + high)
        if below(middle) < q:
            low = middle
        else:
            high = middle
        if math.isclose(low, high, rel_tol=1e-12, abs_tol=0.0):
            break
    return 0.5 * (low + high)
