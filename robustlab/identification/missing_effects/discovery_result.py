"""Result of `discover`: named effects, errors, sets with probabilities; its numbers for requirements and its texts."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar, Literal

from robustlab.display import Each, Facts, Part, listed, number
from robustlab.dynamics.effects.catalogue import KINDS, catalogue, effect
from robustlab.dynamics.effects.effect import Effect, Scales
from robustlab.dynamics.effects.parameter_effects import GroundedEffect
from robustlab.identification.constants import SURE
from robustlab.result import Evidence, Status, Table, Tabular

if TYPE_CHECKING:
    from robustlab.identification.data_checks.suitability import Finding
    from robustlab.identification.experiment_design import NextExperiment
    from robustlab.identification.greybox.residual_force import ResidualForce
    from robustlab.uncertainty.lft import UncertainModel

LINEAR = "linear about the recorded motion"
Verdict = Literal["no missing effect", "named", "ambiguous", "unknown"]
WAVES = (("Ac", "As"), ("Pc", "Ps"), ("c", "s"))  # cosine and sine part of effects periodic in the position
SHOWN_SETS = 6  # in the facts
SHOWN_SEARCH = 12  # most probable sets of the search
MODELS = ("nominal", "refitted", "updated")
ENDS = {"": "value", "_lower": "lower", "_upper": "upper"}  # suffix of a class's quantity -> field


@dataclass(frozen=True)
class EffectValue(Evidence):
    """One fitted parameter with its 95 % interval (posterior, given the effect)."""

    name: str
    value: float
    unit: str
    lower: float
    upper: float


@dataclass(frozen=True)
class NominalValue(EffectValue):
    """One refitted nominal parameter."""

    nominal: float
    tolerance: float  # relative, absolute if the nominal value is 0; 0: held fixed
    assumed: bool  # the plant has no tolerance
    beyond: bool  # the value exceeds the tolerance


@dataclass(frozen=True)
class NamedEffect(Evidence):
    """One effect identified from the records."""

    name: str  # id in the catalogue
    title: str
    site: str
    parameters: tuple[EffectValue, ...]
    confidence: float  # probability of all sets of effects that contain it; of a rival, of the most probable one
    evidence: float  # log evidence over the model without it; of a rival, over the named effect


@dataclass(frozen=True)
class Rival(NamedEffect):
    """An effect that these records cannot separate from a named one."""

    # id of the named effect that it could replace; "none" if nothing was named, but this effect is about as probable as
    # none: the tolerances of other parameters may hide it
    instead_of: str
    # refit distance in standard deviations of the noise between its best fit and the prediction of the named effect for
    # these records: below 3 indistinguishable
    distance: float


@dataclass(frozen=True)
class NamedKind(Evidence):
    """An effect class that is sure at one place."""

    kind: str  # id in `robustlab.dynamics.effects.catalogue`
    place: str
    probability: float  # of all sets with a member of it there, 0..1
    values: tuple[EffectValue, ...]  # quantities of every member, with 95 % intervals over all members
    members: Mapping[str, float]  # effect with its site -> share of the probability, the most probable first
    misfit: bool  # whether more than noise remains, which may come from a wrong form of the effect

    @property
    def title(self) -> str:
        return KINDS[self.kind].title

    @property
    def words(self) -> str:
        """Return class and place: ``dry friction at omega``, ``a time delay from u to q``."""
        return f"{self.title} {'from' if ' to ' in self.place else 'at'} {self.place}"

    @property
    def settled(self) -> bool:
        """Return whether one member alone has 95 % of the probability, without a misfit."""
        return [s >= SURE for s in self.members.values() if s > 1.0 - SURE] == [True] and not self.misfit


@dataclass(frozen=True)
class Gap(Evidence):
    """Simulation error (RMS) of one output: in windows, or in one run from the record's start."""

    output: str
    unit: str
    range: float  # measured on that data
    # of these models; infinite if the simulation diverges
    nominal: float
    refitted: float
    updated: float

    quantities: ClassVar[Mapping[str, Any]] = dict.fromkeys(("range", *MODELS), "*")


def overall(gaps: Mapping[str, Gap], model: str) -> float:
    """Return the RMS error over the outputs of ``nominal``, ``refitted`` or ``updated`` in percent of the range."""
    shares = [getattr(g, model) / (g.range or 1.0) for g in gaps.values()]
    return 100.0 * math.sqrt(sum(share**2 for share in shares) / len(shares)) if shares else math.nan


@dataclass(frozen=True)
class SetProbability(Evidence):
    """A set of effects and its probability among all that the search evaluated."""

    effects: tuple[str, ...]  # effects with their places, ``"coulomb-friction@omega"``
    probability: float  # 0..1; the sum over all sets is one
    evidence: float  # log evidence including the set's prior, relative to the most probable set
    # refit distance from the most probable set in standard deviations of the noise; NaN if not computed
    distance: float = math.nan
    unnamed: str = ""  # the residual force of the set (``"force over speed"``)

    @property
    def names(self) -> tuple[str, ...]:
        """Return the ids in the catalogue."""
        return tuple(place.partition("@")[0] for place in self.effects)


@dataclass(frozen=True)
class InputClock(Evidence):
    """Hold of an input between its samples, and its time shift against the outputs in s."""

    input: str
    hold: Literal["held", "linear", "smooth"]
    shift: float
    std: float


# --- numbers ----------------------------------------------------------------------------------------------------------


def wave_amplitude(values: Mapping[str, float]) -> float | None:
    """Return the amplitude of a periodic effect from its cosine and sine part; None for any other."""
    pair = next(((c, s) for c, s in WAVES if c in values and s in values), None)
    return math.hypot(values[pair[0]], values[pair[1]]) if pair else None


def _units(kind: Effect) -> dict[str, Any]:
    """Return the unit of each parameter of an effect, with the amplitude of a periodic one."""
    units: dict[str, Any] = {p.name: p.unit for p in kind.parameters(Scales())}
    return units if wave_amplitude(dict.fromkeys(units, 0.0)) is None else {**units, "amplitude": float}


def units_of_effects(exclude: Sequence[str]) -> dict[str, dict[str, Any]]:
    """Return effect id, alone and with its place -> parameters with their units."""
    left_out = {effect(name).id for name in exclude}
    effects: dict[str, dict[str, Any]] = {}
    for name, kind in catalogue().items():
        # At a joint without the plant's parameter the effect has one of its own.
        units = _units(kind) | ({kind.symbol: float} if isinstance(kind, GroundedEffect) else {})
        if name not in left_out:
            effects |= {name: units, f"{name}@*": units}
    return effects


def quantities_of(kind: str) -> dict[str, Any]:
    """Return the quantities of an effect class and the ends of their 95 % intervals; units depend on the place."""
    return {f"{name}{end}": float for name in KINDS[kind].quantities for end in ENDS}


@dataclass(frozen=True)
class Discovery(Tabular, Evidence):
    """Result of `robustlab.identification.missing_effects.discovery.discover`."""

    status: Status  # CONVERGED; INCONCLUSIVE if ambiguous or unknown, or if most of the held-out error remains
    # "ambiguous": these records do not exclude rivals of an effect; "unknown": no effect of the catalogue explains the
    # error
    verdict: Verdict
    complete: bool  # False if structure remains beyond the named effects
    effects: tuple[NamedEffect, ...]
    rivals: tuple[Rival, ...]  # effects not excluded
    nominal: tuple[NominalValue, ...]  # refitted parameters
    # Windowed RMS error on held-out data over all outputs in percent of the range, as given, refitted and updated; that
    # of each output in its unit; description of the data
    gap_before: float
    gap_refitted: float
    gap_after: float
    gaps: Mapping[str, Gap]
    held_out: str
    plant: str
    records: tuple[str, ...]
    window: float  # length in s
    candidates: tuple[str, ...]  # effects that were tried
    # "noise_ratio": error over noise and random force; "explained": share of the mean-square error removed
    structure: Mapping[str, float]
    kinds: tuple[NamedKind, ...] = ()  # narrowest sure class at each place, with its quantities and members
    also_detectable: tuple[NamedEffect, ...] = ()  # negligible on held-out data: not in the updated plant
    posterior: tuple[SetProbability, ...] = ()  # sets of effects, the most probable first
    search: tuple[tuple[tuple[str, ...], float], ...] = ()  # every evaluated set with its log evidence
    clocks: tuple[InputClock, ...] = ()
    free_run: Mapping[str, Gap] = field(default_factory=dict)  # errors of one simulation over the whole record
    free_run_on: str = ""  # its records
    findings: tuple[Finding, ...] = ()
    remaining_lines: tuple[Mapping[str, Any], ...] = ()  # in the residual force
    next_experiment: NextExperiment | None = None  # separates the rivals
    # Force that the updated and the refitted nominal model lack, over speed, position, time and input
    residual_force: ResidualForce | None = None
    missing_force: ResidualForce | None = None
    # Signals of held-out data for figures: ``t``, measured and simulated outputs; ``free_run``
    series: Mapping[str, Any] = field(default_factory=dict)
    model: Any = None  # updated plant; None if its free run on held-out data is worse than that of the plant as given
    seconds: float = 0.0

    quantities: ClassVar[Mapping[str, Any]] = {
        "verdict": str,
        "complete": bool,
        "names": [str],
        "places": [str],
        "answer": [str],
        "kinds": [str],
        **{kind: {"probability": "1", **quantities_of(kind)} for kind in KINDS},
        "count": "1",
        **dict.fromkeys(("gap_before", "gap_refitted", "gap_after"), "%"),
        **dict.fromkeys(("gap_ratio", "refitted_ratio"), "1"),
        "gaps": Each("outputs", Gap),
        "free_run": {**dict.fromkeys(("before", "refitted", "after"), "%"), "outputs": Each("outputs", Gap)},
        "effects": {"*": {"*": float}},
        "lower": {"*": {"*": float}},
        "upper": {"*": {"*": float}},
        "confidence": {"*": "1"},
        "nominal": {"*": float},
        "next_experiment": {"name": str, "separation": float},
        "structure": {"*": ...},
        "remaining_lines": [...],
        "line": {over: {"period": unit, "amplitude": float} for over, unit in (("position", float), ("time", "s"))},
        "seconds": "s",
    }

    @property
    def whole_run(self) -> str:
        """Return the name of ``free_run``: of a nonlinear plant one run, linear about the recorded motion."""
        return "one linear run" if LINEAR in self.free_run_on else "free run"

    @property
    def names(self) -> tuple[str, ...]:
        """Return the ids of the named effects."""
        return tuple(e.name for e in self.effects)

    @property
    def answer(self) -> tuple[str, ...]:
        """Return the ids of the named effects and of all their rivals."""
        return tuple(dict.fromkeys([*self.names, *(r.name for r in self.rivals)]))

    def uncertain_model(self, outputs: Any = None, **options: Any) -> UncertainModel:
        """Return effects and residual force as blocks; see `robustlab.identification.missing_effects.updated_plant`."""
        from robustlab.identification.missing_effects.updated_plant import uncertain_from

        return uncertain_from(self, outputs, **options).model

    @property
    def collection(self) -> tuple[SetProbability, ...]:
        """Return the smallest collection of sets with 95 % of the probability."""
        total, found = 0.0, []
        for entry in self.posterior:
            if total >= SURE:
                break
            found.append(entry)
            total += entry.probability
        return tuple(found)

    @property
    def interrupted(self) -> bool:
        """Return whether the user stopped the search."""
        return any(f.kind == "interrupted" for f in self.findings)

    def numbers(self) -> dict[str, Any]:
        # An evaluated effect that is not named has confidence 0 and NaN parameters: a requirement on it is not met,
        # while a misspelt one is an error.
        known = catalogue()
        tried = {known[name].id: _units(known[name]) for name in self.candidates if name in known}
        values: dict[str, dict[str, dict[str, float]]] = {"effects": {}, "lower": {}, "upper": {}}
        for found in values.values():
            found.update({n: {p: 0.0 if p == "amplitude" else math.nan for p in own} for n, own in tried.items()})
        confidence = dict.fromkeys(tried, 0.0)
        for k, e in enumerate(self.effects):
            # A second effect of the same id has its place in the key.
            key = f"{e.name}@{e.site}" if e.name in self.names[:k] else e.name
            for found, end in zip(values.values(), ("value", "lower", "upper"), strict=True):
                found[key] = {p.name: getattr(p, end) for p in e.parameters}
            if (amplitude := wave_amplitude(values["effects"][key])) is not None:
                values["effects"][key]["amplitude"] = amplitude
            confidence[key] = e.confidence
        plain = ("verdict", "complete", "gap_before", "gap_refitted", "gap_after", "seconds")
        gaps = {"gap_ratio": self.gap_before, "refitted_ratio": self.gap_refitted}
        run = {"before": "nominal", "refitted": "refitted", "after": "updated"}
        coming = self.next_experiment
        return {
            **_kinds(self),
            **{name: getattr(self, name) for name in plain},
            **{name: gap / self.gap_after if self.gap_after > 0 else math.inf for name, gap in gaps.items()},
            "names": list(self.names),
            "places": [f"{e.name}@{e.site}" for e in self.effects],
            "answer": list(self.answer),
            "kinds": [k.kind for k in self.kinds],
            "count": len(self.effects),
            "gaps": {name: gap.to_json() for name, gap in self.gaps.items()},
            "free_run": {
                **{key: overall(self.free_run, model) for key, model in run.items()},
                "outputs": {name: gap.to_json() for name, gap in self.free_run.items()},
            },
            **values,
            "confidence": confidence,
            "nominal": {p.name: p.value for p in self.nominal},
            "next_experiment": {
                "name": coming.name if coming else "none", "separation": coming.separation if coming else math.nan,
            },
            "structure": dict(self.structure),
            "remaining_lines": [dict(line) for line in self.remaining_lines],
            "line": {over: _strongest_line(self, over) for over in ("position", "time")},
        }  # fmt: skip

    def table(self) -> Table:
        """Return a row for each parameter of a named effect, with its 95 % interval."""
        rows = [(e, p) for e in self.effects for p in e.parameters]
        columns = {"effect": [e.name for e, _ in rows], "site": [e.site for e, _ in rows]}
        values = {key: [getattr(p, key) for _, p in rows] for key in ("value", "lower", "upper", "unit")}
        return Table(
            ("parameter", [p.name for _, p in rows]),
            {**columns, **values, "probability": [e.confidence for e, _ in rows]},
        )

    def to_json(self, series: bool = False) -> dict[str, object]:
        """Return all fields but the plant object; the time series only on request."""
        excluded = {"model", "findings"} | (set() if series else {"series"})
        data: dict[str, object] = {key: value for key, value in vars(self).items() if key not in excluded}
        return data | {"names": self.names, "answer": self.answer, "findings": [vars(f) for f in self.findings]}

    def headline(self) -> str:
        errors = [percent(overall(self.gaps, model)) for model in MODELS]
        them = {0: "with the best set", 1: "with it"}.get(len(self.effects), "with them")
        change = f"error on held-out data {errors[0]} of the range as given, {errors[1]} refitted, {errors[2]} {them}"
        if self.free_run:
            run = [overall(self.free_run, model) for model in MODELS]
            change += f"; in {self.whole_run} {' -> '.join(map(percent, run))}"
            change += ", worse than as given" if run[2] > run[0] else ""
        more = change if self.complete else f"{change}; incomplete: something else remains"
        named = _in_a_row(_sure_titles(self))
        if self.verdict == "no missing effect":
            shows = "matters" if self.also_detectable else "these records show"
            finding = f"lacks no effect that {shows}: refitted its error on held-out data is {errors[2]} of the range"
            if self.rivals:
                finding += f"; but they do not exclude {_in_a_row((r.title for r in self.rivals), 'or')}"
        elif self.verdict == "named":
            finding = f"lacks {named}: {more}"
        elif self.verdict == "unknown":
            beyond = f" beyond {named}" if self.effects else ""
            finding = f"lacks something{beyond} that no effect of the catalogue explains ({change})"
        elif not self.rivals and len(self.collection) == 1:
            finding = f"may lack {named}, which is not sure ({more})"
        else:
            sets = [_in_a_row(map(_title, [*p.effects, *filter(None, [p.unnamed])])) for p in self.collection]
            either = _in_a_row((words or "nothing" for words in sets), "or")
            finding = f"lacks either {either}: these records cannot distinguish them ({more})"
        return f"{'Interrupted; by then: ' if self.interrupted else ''}{self.plant} {finding}"

    def facts(self) -> Facts:
        found = [("verdict", self.verdict if self.complete else f"{self.verdict}, incomplete: structure remains")]
        for kind in self.kinds:
            if not kind.settled:
                found += [(kind.words, kind_words(kind)), ("to determine its form", KINDS[kind.kind].form)]
        for e in self.effects:
            found.append((in_words(e), f"probability {_values(e)}{_wave(e)}"))
            found += [(f"{e.name} or", _rival(r)) for r in self.rivals if r.instead_of == e.name]
        hint = "; negligible on held-out data: not in the updated plant"
        found += [(f"also seen: {in_words(e)}", f"{_values(e)}{hint}") for e in self.also_detectable]
        found += [("not excluded", _rival(r)) for r in self.rivals if r.instead_of == "none"]
        for gaps, how in ((self.gaps, f"windows of {self.window:.3g} s"), (self.free_run, self.whole_run)):
            found += [(f"{g.output}: {how}", _sizes(g)) for g in gaps.values()]
        found.append(("remains", _remaining(self)))
        found += [("line", _line(line)) for line in self.remaining_lines]
        found += [(p.name, _nominal(p)) for p in self.nominal if p.beyond or not self.effects]
        on = "" if self.free_run_on in ("", self.held_out) else f"; {self.whole_run}: {self.free_run_on}"
        found += [("next", _next(self)), ("held out", self.held_out + on), ("plant", self.plant)]
        return [*found, ("records", listed(self.records)), ("time", number(self.seconds, "s", 3))]

    def details(self) -> list[Part]:
        known, searched = catalogue(), sorted(self.search, key=lambda e: -e[1])[:SHOWN_SEARCH]
        visited = f"search: {len(self.search)} sets evaluated, {len(self.candidates)} effects tried"
        return [
            Part("evidence", ("effect", "equation", "log evidence"),
                 [(e.name, known[e.name].equation, f"{e.evidence:+.4g}") for e in self.effects]),
            Part("nominal parameters, refitted", ("parameter", "value"), [(p.name, _nominal(p)) for p in self.nominal]),
            Part("inputs between their samples", ("input", "hold"), [(c.input, _clock(c)) for c in self.clocks]),
            Part("sets of effects (3 noise sigmas distinguish)", ("set", "probability"),
                 [_set_words(p) for p in self.collection[:SHOWN_SETS]]),
            Part("next experiment", ("", ""), self.next_experiment.facts() if self.next_experiment else []),
            Part("what remains", ("", ""), [(key, f"{v:.4g}") for key, v in self.structure.items()]),
            Part("findings on the records", ("kind", "finding"), [(f.kind, f.message) for f in self.findings]),
            Part(visited, ("log evidence", "effects"),
                 [(f"{v:.4g}", " + ".join(own) or "none") for own, v in searched]),
        ]  # fmt: skip


def _kinds(d: Discovery) -> dict[str, dict[str, float]]:
    """Return every class with its quantities: NaN if it is not sure; of two places the more probable one."""
    found: dict[str, dict[str, float]] = {
        kind: {"probability": 0.0} | dict.fromkeys(quantities_of(kind), math.nan) for kind in KINDS
    }
    for k in sorted(d.kinds, key=lambda k: k.probability):
        values = {f"{v.name}{end}": getattr(v, part) for v in k.values for end, part in ENDS.items()}
        found[k.kind] |= {"probability": k.probability, **values}
    return found


def _strongest_line(d: Discovery, over: str) -> dict[str, float]:
    """Return period and amplitude of the strongest remaining line over a coordinate; NaN without one."""
    line = next((line for line in d.remaining_lines if line["over"] == over), {})
    return {name: float(line.get(name, math.nan)) for name in ("period", "amplitude")}


# --- texts ------------------------------------------------------------------------------------------------------------


def in_words(e: NamedEffect) -> str:
    """Return title, id and place: ``Coulomb (dry) friction, coulomb-friction at omega``."""
    return f"{e.title}, {e.name} at {e.site}"


def with_interval(p: EffectValue) -> str:
    """Return value and 95 % interval with significant digits; an interval of no width is "held fixed"."""
    unit = f" {p.unit}" if p.unit and p.unit != "1" else ""
    if p.lower == p.upper:
        return f"{p.value:.4g}{unit} (held fixed)"
    digits = _digits(p.value, p.upper - p.lower)
    return f"{p.value:.{digits}g}{unit} (95 %: {p.lower:.{digits}g} to {p.upper:.{digits}g})"


def chance(probability: float) -> str:
    """Return a probability in percent, near 0 and 1 as a bound."""
    if probability > 0.999:
        return "> 99.9 %"
    return "< 0.1 %" if probability < 0.001 else f"{100 * probability:.3g} %"


def _sure_titles(d: Discovery) -> list[str]:
    """Return titles of the sure classes, with their size if the form is open; without any, of the best set."""
    if not d.kinds:
        return [e.title for e in d.effects]
    words: list[str] = []
    for kind in d.kinds:
        sure = [_title(name) for name, share in kind.members.items() if share >= SURE and kind.settled]
        size = f" of {number(kind.values[0].value, kind.values[0].unit)}" if kind.values else ""
        words += sure or [f"{kind.title}{size}"]
    return list(dict.fromkeys(words))


def kind_words(kind: NamedKind) -> str:
    """Return probability, quantities and possible forms of a class whose form is open."""
    values = [f"{v.name} {with_interval(v)}" for v in kind.values]
    why = "not settled, because of the remaining error" if kind.misfit else "not settled"
    if sum(share >= SURE for share in kind.members.values()) > 1:
        why = "more than one at once"
    shares = [f"{_small_first(_title(e))} {chance(share)}" for e, share in kind.members.items() if share >= 0.01]
    return "; ".join([chance(kind.probability), *values, f"its form is {why}: {', '.join(shares[:SHOWN_SETS])}"])


def _title(place: str) -> str:
    """Return the title of ``"coulomb-friction@omega"`` or of an unnamed force."""
    name = place.partition("@")[0]
    return catalogue()[name].title if name in catalogue() else f"an unnamed {name}"


def _values(e: NamedEffect) -> str:
    return "; ".join([chance(e.confidence), *(f"{p.name} = {with_interval(p)}" for p in e.parameters)])


def _wave(e: NamedEffect) -> str:
    values = {p.name: p.value for p in e.parameters}
    amplitude = wave_amplitude(values)
    if amplitude is None or not values.get("k"):
        return ""
    (unit,) = (p.unit for p in e.parameters if p.name == "k")
    turns = f", {values['k']:.4g} a turn" if "rad" in unit else ""
    period = number(2.0 * math.pi / values["k"], unit.rpartition("/")[2])
    return f"; amplitude {number(amplitude, e.parameters[0].unit)}, period {period}{turns}"


def _rival(r: Rival) -> str:
    apart = f"; {number(r.distance)} noise sigmas apart (3 distinguish)" if math.isfinite(r.distance) else ""
    return f"{in_words(r)}; probability {_values(r)}{apart}"


def _set_words(p: SetProbability) -> tuple[str, str]:
    names = [*p.effects, *([f"unnamed {p.unnamed}"] if p.unnamed else [])]
    apart = f", {number(p.distance)} noise sigmas from the first" if p.distance > 0.0 else ""
    return " + ".join(names) or "nothing missing", f"{chance(p.probability)}{apart}"


def _sizes(g: Gap) -> str:
    sizes = []
    for value in (getattr(g, model) for model in MODELS):
        share = f" ({percent(100 * value / g.range)})" if g.range > 0 else ""
        sizes.append("diverges" if math.isinf(value) else f"{number(value, g.unit)}{share}")
    return f"rms {' -> '.join(sizes)}"


def _remaining(d: Discovery) -> str:
    if d.complete:
        return "nothing systematic was found"
    share = percent(100.0 * d.structure.get("explained", math.nan))
    texts = [f"the named effects explain {share} of the mean-square error as given" if d.effects else "unexplained"]
    if (force := d.residual_force) is not None:
        texts.append(f"a force of {number(force.rms, force.unit)} (rms)")
        texts += [f"{100 * c.share:.3g} % follow {c.coordinate}" for c in force.curves.values()]
    return "; ".join(texts)


def _line(line: Mapping[str, Any]) -> str:
    size, period = number(line["amplitude"], line["force_unit"]), number(line["period"], line["unit"])
    return f"{size} over {line['over']}, period {period} (log evidence {line['evidence']:.3g})"


def _nominal(p: NominalValue) -> str:
    if p.lower == p.upper:
        return with_interval(p)
    change = f", {100 * (p.value / p.nominal - 1):+.3g} %" if p.nominal else ""
    size = f"{100 * p.tolerance:.3g} %" if p.nominal else number(p.tolerance, p.unit)
    limit = f"{'BEYOND its' if p.beyond else 'within its'} tolerance of {size} ({'assumed' if p.assumed else 'stated'})"
    return f"{number(p.nominal)} -> {with_interval(p)}{change}: {limit}"


def _clock(c: InputClock) -> str:
    between = "held from sample to sample" if c.hold == "held" else f"{c.hold} between samples"
    late = f"late by {1e3 * c.shift:.3g} ms (standard deviation {1e3 * c.std:.2g} ms)" if c.std else "clock not fitted"
    return f"{between}; {late}"


def _next(d: Discovery) -> str:
    if d.next_experiment is not None:
        return f"measure to distinguish them: {d.next_experiment.description}"
    if not d.complete:
        return "look at the force that remains, over speed, position, time and input (figure 'force')"
    return "use the updated plant (.model)" if d.effects else "the model can stay as it is, refitted"


def _in_a_row(texts: Iterable[str], last: str = "and") -> str:
    """Join as ``a``, ``a and b``, ``a, b and c``, each once, first letters in lower case."""
    words = list(dict.fromkeys(map(_small_first, texts)))
    return f" {last} ".join(filter(None, [", ".join(words[:-1]), *words[-1:]]))


def _small_first(text: str) -> str:
    people = tuple(e.person for e in catalogue().values() if e.person)
    return text if text.startswith(people) else text[:1].lower() + text[1:]


def _digits(value: float, width: float) -> int:
    """Return the digits of the value that show two of the interval's width."""
    if not (math.isfinite(value) and math.isfinite(width)) or width <= 0.0 or value == 0.0:
        return 4
    return min(max(math.floor(math.log10(abs(value))) - math.floor(math.log10(width)) + 2, 3), 8)


def percent(value: float) -> str:
    return "diverges" if math.isinf(value) else f"{value:.3g} %"
