"""Parts of a discovery: values with intervals, named effects, errors, sets with probabilities; and its texts."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

from robustlab.display import Facts, Part, listed, number
from robustlab.dynamics.effects.catalogue import catalogue
from robustlab.identification.tuning import SURE
from robustlab.result import Evidence

LINEAR = "linear about the recorded motion"
Verdict = Literal["no missing effect", "named", "ambiguous", "unknown"]
INTERVAL = 1.96  # standard deviations of a 95 % interval
WAVES = (("Ac", "As"), ("Pc", "Ps"), ("c", "s"))  # cosine and sine part of effects periodic in the position
SHOWN_SETS = 6  # in the facts
SHOWN_SEARCH = 12  # most probable sets of the search
MODELS = ("nominal", "refitted", "updated")


@dataclass(frozen=True)
class EffectValue(Evidence):
    """One fitted parameter of an effect: value, unit, 95 % interval (posterior, given the effect), and meaning."""

    name: str
    value: float
    unit: str
    lower: float
    upper: float
    meaning: str


@dataclass(frozen=True)
class NominalValue(Evidence):
    """One refitted nominal parameter with its 95 % interval and its tolerance (0: held fixed)."""

    # assumed: the plant has no tolerance; beyond: the value exceeds it. Absolute if the nominal value is 0.

    name: str
    nominal: float
    value: float
    unit: str
    lower: float
    upper: float
    tolerance: float
    assumed: bool
    beyond: bool = False


@dataclass(frozen=True)
class Rival(Evidence):
    """An effect that these records cannot separate from a named one."""

    # name, title, site: the rival
    name: str
    title: str
    site: str
    # id of the named effect that it could replace; "none" if nothing was named, but this effect is about as probable as
    # none: the tolerances of other parameters may hide it
    instead_of: str
    # refit distance d in standard deviations of the noise: between the rival's best fit and the prediction of the named
    # effect for these records; d < 3 is indistinguishable. Of a rival of "none": between the nominal model's best fit
    # and the prediction of the rival.
    distance: float
    evidence: float  # log evidence relative to the named effect (negative: behind)
    probability: float  # of the most probable set with this replacement
    parameters: tuple[EffectValue, ...]  # as fitted


@dataclass(frozen=True)
class NamedEffect(Evidence):
    """One effect identified from the records."""

    name: str  # id in the catalogue
    title: str
    equation: str
    site: str
    parameters: tuple[EffectValue, ...]  # fitted values with intervals
    confidence: float  # probability of all sets of effects that contain it, 0..1
    evidence: float  # log evidence over the model without it
    rivals: tuple[str, ...]  # ids that these records cannot separate from it
    # windowed error on held-out data in percent of the range, refitted without this effect; NaN if not known
    error_without: float = math.nan


@dataclass(frozen=True)
class KindMember(Evidence):
    """An effect of a class: id, title, site, and its share of the class's probability, 0..1."""

    name: str
    title: str
    site: str
    share: float


@dataclass(frozen=True)
class NamedKind(Evidence):
    """An effect class that is sure at one place."""

    kind: str  # id in `robustlab.dynamics.effects.catalogue`
    title: str
    place: str
    probability: float  # of all sets with a member of it there, 0..1
    values: tuple[EffectValue, ...]  # quantities of every member, with 95 % intervals over all members
    members: tuple[KindMember, ...]  # its effects, the most probable first
    form: str  # how to distinguish the members, as an instruction
    misfit: bool = False  # whether more than noise remains, which may come from a wrong form of the effect

    quantities: ClassVar[Mapping[str, Any]] = {"probability": "1"}

    @property
    def words(self) -> str:
        """Return class and place: ``dry friction at omega``, ``a lateness from u to q``."""
        return f"{self.title} {'from' if ' to ' in self.place else 'at'} {self.place}"

    @property
    def settled(self) -> bool:
        """Return whether one member alone has 95 % of the probability, without a misfit."""
        return [m.share >= SURE for m in self.members if m.share > 1.0 - SURE] == [True] and not self.misfit

    @property
    def open_form(self) -> str:
        """Return why the form is open: several members at once, a misfit, or records that do not determine it."""
        if sum(m.share >= SURE for m in self.members) > 1:
            return "more than one at once"
        return "not settled beside what remains" if self.misfit else "not settled"


def wave_amplitude(values: Mapping[str, float]) -> float | None:
    """Return the amplitude of a periodic effect from its cosine and sine part; None for any other."""
    pair = next(((c, s) for c, s in WAVES if c in values and s in values), None)
    return math.hypot(values[pair[0]], values[pair[1]]) if pair else None


@dataclass(frozen=True)
class Gap(Evidence):
    """Simulation error (RMS) of one output: in windows, or in one run from the record's start."""

    output: str
    unit: str
    range: float  # measured on that data
    # nominal, refitted, updated: RMS error of these models; infinite if the simulation diverges
    nominal: float
    refitted: float
    updated: float

    quantities: ClassVar[Mapping[str, Any]] = dict.fromkeys(("range", "nominal", "refitted", "updated"), "*")


def overall(gaps: Mapping[str, Gap], model: str) -> float:
    """Return the RMS error over the outputs of ``nominal``, ``refitted`` or ``updated`` in percent of the range."""
    shares = [getattr(g, model) / (g.range or 1.0) for g in gaps.values()]
    return 100.0 * math.sqrt(sum(share**2 for share in shares) / len(shares)) if shares else math.nan


@dataclass(frozen=True)
class SetProbability(Evidence):
    """A set of effects and its probability among all that the search evaluated."""

    effects: tuple[str, ...]  # effects with their places, ``"coulomb-friction@omega"``
    names: tuple[str, ...]  # ids in the catalogue
    probability: float  # 0..1; the sum over all sets is one
    evidence: float  # log evidence including the set's prior, relative to the most probable set
    # refit distance from the most probable set in standard deviations of the noise; NaN if not computed
    distance: float = math.nan
    unnamed: str = ""  # the residual force of the set (``"force over speed"``)


@dataclass(frozen=True)
class InputClock(Evidence):
    """Hold of an input between its samples, and its time shift against the outputs in s."""

    input: str
    hold: Literal["held", "linear", "smooth"]
    shift: float
    std: float


# --- texts ------------------------------------------------------------------------------------------------------------


def headline_of(d: Any) -> str:
    early = "Interrupted; by then: " if d.interrupted else ""
    change = f"error on held-out data {_three_errors(d.gaps, d.effects)}"
    if d.free_run:
        worse = overall(d.free_run, "updated") > overall(d.free_run, "nominal")
        change += f"; in {d.whole_run} {_three_errors(d.free_run)}{', worse than as given' if worse else ''}"
    named = _in_a_row(_sure_titles(d))
    also = "" if d.complete else "; incomplete: something else remains"
    if d.verdict == "no missing effect":
        hidden = f"; but they do not exclude {_one_of(r.title for r in d.rivals)}" if d.rivals else ""
        shows = "matters" if d.also_detectable else "these records show"
        lacks = f"no effect that {shows}: refitted its error on held-out data is {percent(d.gap_after)} of the range"
        return f"{early}{d.plant} lacks {lacks}{hidden}"
    if d.verdict == "named":
        return f"{early}{d.plant} lacks {named}: {change}{also}"
    if d.verdict == "ambiguous":
        if not d.rivals and len(d.collection) == 1:
            return f"{early}{d.plant} may lack {named}, which is not sure ({change}{also})"
        sets = [_in_a_row(map(_title, (*p.effects, *filter(None, [p.unnamed])))) or "nothing" for p in d.collection]
        return f"{early}{d.plant} lacks either {_one_of(sets)}: these records cannot tell which ({change}{also})"
    beyond = f" beyond {named}" if d.effects else ""
    return f"{early}{d.plant} lacks something{beyond} that no effect of the catalogue explains ({change})"


def facts_of(d: Any) -> Facts:
    """Return verdict, effects with intervals, alternatives, errors, residual force, next step."""
    found = [("verdict", d.verdict if d.complete else f"{d.verdict}, incomplete: structure remains")]
    for kind in d.kinds:
        if not kind.settled:
            found += [(kind.words, kind_words(kind)), ("what would tell its form", kind.form)]
    for e in d.effects:
        found.append((in_words(e), "; ".join([f"probability {chance(e.confidence)}", *_values(e), *_wave(e)])))
        found += [(f"{e.name} or", _rival(r)) for r in d.rivals if r.instead_of == e.name]
    found.append(("error on held-out data", f"{percent(d.gap_before)} -> {percent(d.gap_after)} of the range"))
    for e in d.also_detectable:
        values = "; ".join([chance(e.confidence), *_values(e)])
        found.append(
            (f"also seen: {in_words(e)}", f"{values}; next to nothing on held-out data: not in the updated plant")
        )
    found += [("not excluded", _rival(r)) for r in d.rivals if r.instead_of == "none"]
    found += [("tried", f.message) for f in d.findings if f.kind == "refuted"]
    if len(d.collection) > 1:
        found += [("left open (3 noise sigmas tell)", _set_words(p)) for p in d.collection[:SHOWN_SETS]]
    for gaps, how in ((d.gaps, f"windows of {d.window:.3g} s"), (d.free_run, d.whole_run)):
        found += [(f"{g.output}: {how}", _sizes(g)) for g in gaps.values()]
    found.append(("remains", _remaining(d)))
    found += [("line", _line(line)) for line in d.remaining_lines]
    found += [(p.name, _nominal(p)) for p in d.nominal if p.beyond or not d.effects]
    held = d.held_out if d.free_run_on in ("", d.held_out) else f"{d.held_out}; {d.whole_run}: {d.free_run_on}"
    return [
        *found,
        ("next", _next(d)),
        ("held out", held),
        ("plant", d.plant),
        ("records", listed(d.records)),
        ("time", number(d.seconds, "s", 3)),
    ]


def details_of(d: Any) -> list[Part]:
    """Return the evidence, refitted parameters, input holds, next experiment, findings and search as tables."""
    best = sorted(d.search, key=lambda e: -e[1])[:SHOWN_SEARCH]
    without = {e.name: percent(e.error_without) if math.isfinite(e.error_without) else "" for e in d.effects}
    structure = [(key, f"{v:.4g}") for key, v in d.structure.items()]
    visited = f"search: {len(d.search)} sets visited, {len(d.candidates)} effects tried"
    return [
        Part("evidence", ("effect", "equation", "log evidence", "held-out error without it"),
             [(e.name, e.equation, f"{e.evidence:+.4g}", without[e.name]) for e in d.effects]),
        Part("nominal parameters, refitted", ("parameter", "value"), [(p.name, _nominal(p)) for p in d.nominal]),
        Part("inputs between their samples", ("input", "hold"), [(c.input, _clock(c)) for c in d.clocks]),
        Part("next experiment", ("", ""), [] if d.next_experiment is None else d.next_experiment.facts()),
        Part("what remains", ("", ""), structure),
        Part("findings on the records", ("kind", "finding"), [(f.kind, f.message) for f in d.findings]),
        Part(visited, ("log evidence", "effects"), [(f"{v:.4g}", " + ".join(own) or "none") for own, v in best]),
    ]  # fmt: skip


def in_words(e: NamedEffect) -> str:
    """Return title, id and place: ``Coulomb (dry) friction, coulomb-friction at omega``."""
    return f"{e.title}, {e.name} at {e.site}"


def with_interval(p: EffectValue | NominalValue) -> str:
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


def _sure_titles(d: Any) -> list[str]:
    """Return titles of the sure classes, with their size if the form is open; without any, of the best set."""
    if not d.kinds:
        return [e.title for e in d.effects]
    words: list[str] = []
    for kind in d.kinds:
        sure = [m.title for m in kind.members if m.share >= SURE and kind.settled]
        size = f" of {_sized(kind.values[0].value, kind.values[0].unit)}" if kind.values else ""
        words += sure or [f"{kind.title}{size}"]
    return list(dict.fromkeys(words))


def kind_words(kind: NamedKind) -> str:
    """Return probability, quantities and possible forms of a class whose form is open."""
    values = [f"{v.name} {with_interval(v)}" for v in kind.values]
    shares = [f"{_small_first(m.title)} {chance(m.share)}" for m in kind.members if m.share >= 0.01][:SHOWN_SETS]
    return "; ".join([chance(kind.probability), *values, f"its form is {kind.open_form}: {', '.join(shares)}"])


def _three_errors(gaps: Mapping[str, Gap], named: Iterable[NamedEffect] | None = None) -> str:
    """Return the errors of the given, refitted and updated model, in words if the effects are given."""
    given, refitted, updated = (percent(overall(gaps, model)) for model in MODELS)
    if named is None:
        return f"{given} -> {refitted} -> {updated}"
    them = {0: "with the best set", 1: "with it"}.get(len(list(named)), "with them")
    return f"{given} of the range as given, {refitted} refitted, {updated} {them}"


def _title(effect: str) -> str:
    """Return the title of ``"coulomb-friction@omega"`` or of an unnamed force."""
    name = effect.partition("@")[0]
    return catalogue()[name].title if name in catalogue() else f"an unnamed {name}"


def _values(e: NamedEffect | Rival) -> list[str]:
    return [f"{p.name} = {with_interval(p)}" for p in e.parameters]


def _wave(effect: NamedEffect) -> list[str]:
    values = {p.name: p.value for p in effect.parameters}
    amplitude = wave_amplitude(values)
    if amplitude is None or not values.get("k"):
        return []
    period = 2.0 * math.pi / values["k"]
    (unit,) = (p.unit for p in effect.parameters if p.name == "k")
    turns = f", {values['k']:.4g} a turn" if "rad" in unit else ""
    size = _sized(amplitude, effect.parameters[0].unit)
    return [f"amplitude {size}, period {_sized(period, unit.rpartition('/')[2])}{turns}"]


def _rival(r: Rival) -> str:
    apart = f"probability {chance(r.probability)}, {_sized(r.distance)} noise sigmas apart (3 tell)"
    return "; ".join([f"{r.title}, {r.name} at {r.site}", *_values(r), apart])


def _set_words(p: SetProbability) -> str:
    unnamed = f" + unnamed {p.unnamed}" if p.unnamed else ""
    apart = f", {_sized(p.distance)} noise sigmas from the first" if p.distance > 0.0 else ""
    return f"{' + '.join(p.effects) or 'nothing missing'}{unnamed}: {chance(p.probability)}{apart}"


def _sizes(g: Gap) -> str:
    def size(value: float) -> str:
        if math.isinf(value):
            return "diverges"
        return _sized(value, g.unit) + (f" ({percent(100 * value / g.range)})" if g.range > 0 else "")

    return f"rms {size(g.nominal)} -> {size(g.refitted)} -> {size(g.updated)}"


def _remaining(d: Any) -> str:
    if d.complete:
        return "nothing systematic was found"
    text = "the named effects do not explain everything" if d.effects else "unexplained"
    if d.effects and "explained" in d.structure:
        share = percent(100.0 * d.structure["explained"])
        text = f"the named effects explain {share} of the mean-square error as given"
    force = d.residual_force
    if force is None:
        return text
    shares = [f"{100 * c.share:.3g} % follow {c.coordinate}" for c in force.curves.values()]
    return "; ".join([text, f"a force of {_sized(force.rms, force.unit)} (rms)", *shares])


def _line(line: Mapping[str, Any]) -> str:
    size = _sized(line["amplitude"], line["force_unit"])
    period = _sized(line["period"], line["unit"])
    return f"{size} over {line['over']}, period {period} (log evidence {line['evidence']:.3g})"


def _nominal(p: NominalValue) -> str:
    if p.lower == p.upper:
        return with_interval(p)
    change = f", {100 * (p.value / p.nominal - 1):+.3g} %" if p.nominal else ""
    size = f"{100 * p.tolerance:.3g} %" if p.nominal else _sized(p.tolerance, p.unit)
    stated = "assumed" if p.assumed else "stated"
    limit = f"{'BEYOND its' if p.beyond else 'within its'} tolerance of {size} ({stated})"
    return f"{_sized(p.nominal)} -> {with_interval(p)}{change}: {limit}"


def _clock(c: InputClock) -> str:
    between = "held from sample to sample" if c.hold == "held" else f"{c.hold} between samples"
    late = f"late by {1e3 * c.shift:.3g} ms (standard deviation {1e3 * c.std:.2g} ms)" if c.std else "clock not fitted"
    return f"{between}; {late}"


def _next(d: Any) -> str:
    if d.next_experiment is not None:
        return f"measure what tells them apart: {d.next_experiment.description}"
    if not d.complete:
        return "look at the force that remains, over speed, position, time and input (figure 'force')"
    return "use the updated plant (.model)" if d.effects else "the model can stay as it is, refitted"


def _in_a_row(texts: Iterable[str]) -> str:
    """Join as ``a``, ``a and b``, ``a, b and c``, first letters in lower case."""
    words = [_small_first(text) for text in texts]
    return " and ".join([", ".join(words[:-1]), words[-1]]) if len(words) > 1 else "".join(words)


def _one_of(texts: Iterable[str]) -> str:
    words = list(dict.fromkeys(_small_first(text) for text in texts))
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} or {words[-1]}"


def _small_first(text: str) -> str:
    people = tuple(e.person for e in catalogue().values() if e.person)
    return text if text.startswith(people) else text[:1].lower() + text[1:]


def _digits(value: float, width: float) -> int:
    """Return the digits of the value that show two of the interval's width."""
    if not (math.isfinite(value) and math.isfinite(width)) or width <= 0.0 or value == 0.0:
        return 4
    return min(max(math.floor(math.log10(abs(value))) - math.floor(math.log10(width)) + 2, 3), 8)


def _sized(value: float, unit: str = "") -> str:
    return f"{value:.4g} {unit}" if unit and unit != "1" else f"{value:.4g}"


def percent(value: float) -> str:
    return "diverges" if math.isinf(value) else f"{value:.3g} %"
