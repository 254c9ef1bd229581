"""What `discover` answers: the verdict, the named effects with their evidence, the gap before and after; its text."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar, Literal

from robustlab.dynamics.effects.catalogue import catalogue
from robustlab.identification.naming.discovery_numbers import numbers_of
from robustlab.identification.naming.named_effects import (
    EffectValue,
    Gap,
    InputClock,
    NamedEffect,
    NominalValue,
    Rival,
    SearchEntry,
    SetProbability,
    overall,
    wave_amplitude,
)
from robustlab.identification.tuning import AS_LARGE
from robustlab.result import Evidence, Status
from robustlab.shown import Each, Facts, listed, number
from robustlab.tables import Table, Tabular

if TYPE_CHECKING:
    from robustlab.identification.comparison.noise_floor import NoiseFloor
    from robustlab.identification.experiment.next_experiment import NextExperiment
    from robustlab.identification.record_check.suitability import Finding
    from robustlab.identification.unnamed.unnamed_effect import ResidualForce, UnnamedForce
    from robustlab.uncertainty.lft import UncertainModel

LINEAR = "linear about the recorded motion"  # said of the records of such runs
Verdict = Literal["no missing effect", "named", "ambiguous", "unknown"]


@dataclass(frozen=True)
class Discovery(Tabular, Evidence):
    """Result of `robustlab.identification.naming.discovery.discover`.

    Attributes
    ----------
    status
        CONVERGED, or INCONCLUSIVE where the verdict is ambiguous or unknown (a finding, no failure).
    verdict
        ``"no missing effect"`` (``rivals`` has what the records do not exclude all the same), ``"named"``,
        ``"ambiguous"`` (named, but some name has rivals that these records cannot exclude), ``"unknown"`` (something is
        missing that no effect of the catalogue explains).
    complete
        False where structure remains beyond the named effects.
    effects, rivals
        Named effects in the order in which they were found; what could not be told apart.
    nominal
        Refitted nominal parameters.
    gap_before, gap_after
        Windowed RMS error on held-out data in percent of the measured range, over all outputs: nominal model, and
        updated one. ``gaps`` has each output in its unit.
    gap_refitted
        The same of the nominal model refitted.
    held_out
        What the gap was measured on: names of the held-out records, or the held-out blocks of the records.
    free_run, free_run_on
        The same errors of one simulation from the record's start to its end, without restarts; the records.
    model
        The updated plant (an `ExtendedPlant` or `LinearPlant`), ready for trim, linearise, save.
    next_experiment
        What to measure next to separate the rivals; None where there are none.
    posterior
        Sets of effects, the most probable first.
    clocks
        Hold and time shift of each input, as the records tell them.
    search
        Every set that the search visited.
    residual_force, missing_force, unnamed
        The force that the updated model still lacks over speed, position, time and input; the one that the refitted
        nominal model lacked; where something remains, the spline map of the first.
    structure
        Cross-validated share of the residual force that a smooth map explains, its p-value, and over what.
    noise_floor, floor_excess
        Model-free noise floor where the record repeats, and F of the updated model against it (1: nothing left).
    findings
        Remarks on the records.
    window
        Length of the windows in s.
    series
        Signals of a held-out stretch for figures: ``t``, and for each output ``measured``, ``nominal``, ``refitted``,
        ``updated`` (windowed simulation); ``free_run`` has the same of one held-out record from its start.
    candidates
        Ids that were tried.
    seconds
        Time that the naming took.
    """

    status: Status
    verdict: Verdict
    complete: bool
    effects: tuple[NamedEffect, ...]
    rivals: tuple[Rival, ...]
    nominal: tuple[NominalValue, ...]
    gap_before: float
    gap_refitted: float
    gap_after: float
    gaps: Mapping[str, Gap]
    held_out: str
    plant: str
    records: tuple[str, ...]
    window: float
    candidates: tuple[str, ...]
    structure: Mapping[str, Any]
    posterior: tuple[SetProbability, ...] = ()
    search: tuple[SearchEntry, ...] = ()
    clocks: tuple[InputClock, ...] = ()
    free_run: Mapping[str, Gap] = field(default_factory=dict)
    free_run_on: str = ""
    findings: tuple[Finding, ...] = ()
    remaining_lines: tuple[Mapping[str, Any], ...] = ()
    next_experiment: NextExperiment | None = None
    residual_force: ResidualForce | None = None
    missing_force: ResidualForce | None = None
    unnamed: UnnamedForce | None = None
    noise_floor: NoiseFloor | None = None
    floor_excess: Mapping[str, float] = field(default_factory=dict)
    series: Mapping[str, Any] = field(default_factory=dict)
    model: Any = None
    seconds: float = 0.0

    quantities: ClassVar[Mapping[str, Any]] = {
        "verdict": str,
        "complete": bool,
        "names": [str],
        "places": [str],
        "answer": [str],
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
        """What ``free_run`` is: of a nonlinear plant one run that is linear about the recorded motion."""
        return "one linear run" if LINEAR in self.free_run_on else "free run"

    @property
    def names(self) -> tuple[str, ...]:
        """Ids of the named effects."""
        return tuple(e.name for e in self.effects)

    @property
    def answer(self) -> tuple[str, ...]:
        """Ids of the named effects and of all their rivals."""
        return tuple(dict.fromkeys([*self.names, *(r.name for r in self.rivals)]))

    def uncertain_model(self, outputs: Any = None, **options: Any) -> UncertainModel:
        """What was found and what remains as blocks; see `robustlab.identification.naming.updated_plant`."""
        from robustlab.identification.naming.updated_plant import uncertain_from

        return uncertain_from(self, outputs, **options).model

    @property
    def collection(self) -> tuple[SetProbability, ...]:
        """The smallest collection of sets that has 95 % of the probability."""
        total, found = 0.0, []
        for entry in self.posterior:
            if total >= COLLECTED:
                break
            found.append(entry)
            total += entry.probability
        return tuple(found)

    @property
    def interrupted(self) -> bool:
        """True where the search was stopped by the user: the answer is what was known by then."""
        return any(f.kind == "interrupted" for f in self.findings)

    def headline(self) -> str:
        """The verdict in one sentence that a person understands."""
        early = "Interrupted; by then: " if self.interrupted else ""
        change = f"error on held-out data {_percent(self.gap_before)} -> {_percent(self.gap_after)} of the range"
        if self.free_run:
            run = [_percent(overall(self.free_run, model)) for model in ("nominal", "updated")]
            change += f", in {self.whole_run} {run[0]} -> {run[1]}"
        named = _listed(e.title for e in self.effects)
        if self.verdict == "no missing effect":
            error = f"refitted its error on held-out data is {_percent(self.gap_after)} of the range"
            hidden = f"; but they do not exclude {_or(r.title for r in self.rivals)}" if self.rivals else ""
            return f"{early}{self.plant} lacks no effect that these records show: {error}{hidden}"
        also = "" if self.complete else "; something else remains"
        if self.verdict == "named":
            return f"{early}{self.plant} lacks {named}: {change}{also}"
        if self.verdict == "ambiguous" and not self.rivals and self.gap_after > self.gap_refitted:
            worth = "on held-out data no nearer than the refitted model"
            return f"{early}{self.plant} may lack {named}, which is {worth} ({change}{also})"
        if self.verdict == "ambiguous" and not self.rivals and len(self.collection) == 1:
            far = "as far as the search came before its work was used up"
            return f"{early}{self.plant} lacks {named}, {far} ({change}{also})"
        if self.verdict == "ambiguous":
            return f"{early}{self.plant} lacks {_choices(self)}: these records cannot tell which ({change}{also})"
        beyond = f" beyond {named}" if self.effects else ""
        return f"{early}{self.plant} lacks something{beyond} that no effect of the catalogue explains ({change})"

    def numbers(self) -> dict[str, Any]:
        """What requirements may refer to; see `robustlab.identification.naming.discovery_numbers`."""
        return numbers_of(self)

    def summary(self, details: bool = False) -> str:
        """The result as a few lines of text; with ``details`` everything that it rests on."""
        return _text(self, details)

    def facts(self) -> Facts:
        """The verdict, the effects with their parameters, and the gap before and after."""
        named = [
            (
                in_words(e),
                f"{chance(e.confidence)}; " + "; ".join(f"{p.name} = {with_interval(p)}" for p in e.parameters),
            )
            for e in self.effects
        ]
        return [
            ("verdict", self.verdict if self.complete else f"{self.verdict}, incomplete: structure remains"),
            *named,
            ("not told apart from", listed(r.title for r in self.rivals)),
            ("error on held-out data", f"{_percent(self.gap_before)} -> {_percent(self.gap_after)} of the range"),
            ("plant", self.plant),
            ("records", listed(self.records)),
            ("time", number(self.seconds, "s")),
        ]

    def table(self) -> Table:
        """A row for each parameter of a named effect, with its 95 % interval."""
        rows = [(e, p) for e in self.effects for p in e.parameters]
        columns = {"effect": [e.name for e, _ in rows], "site": [e.site for e, _ in rows]}
        values = {key: [getattr(p, key) for _, p in rows] for key in ("value", "lower", "upper", "unit")}
        probability = {"probability": [e.confidence for e, _ in rows]}
        return Table(("parameter", [p.name for _, p in rows]), {**columns, **values, **probability})

    def to_json(self, series: bool = False) -> dict[str, object]:
        """All fields but the plant object; the time series only on request."""
        left_out = {"model", "findings"} | (set() if series else {"series"})
        data: dict[str, object] = {key: value for key, value in vars(self).items() if key not in left_out}
        data.update(names=self.names, answer=self.answer, findings=[vars(f) for f in self.findings])
        return data


# --- the text --------------------------------------------------------------------------------------------------------


COLLECTED = 0.95  # probability of the sets that an answer consists of
ALONE = 0.02  # probability of all other sets below which a name has no rival
SHOWN_SETS = 6  # in the short text
SHOWN_SEARCH = 12  # most probable sets of the search
LABEL = 14  # width of the first column
MODELS = ("nominal", "refitted", "updated")


def _text(d: Discovery, details: bool) -> str:
    """Verdict in a sentence, effects with intervals, gap, what remains, what to do next; on demand all the rest."""
    lines = [f"{d.headline()}.", "", f"verdict: {d.verdict}, {_scope(d)}"]
    for effect in d.effects:
        lines += _effect_lines(d, effect, details)
    lines += [_doubt_line(r) for r in d.rivals if r.instead_of == "none"]
    if len(d.collection) > 1:
        shown = d.collection if details else d.collection[:SHOWN_SETS]
        lines += ["what the records leave open (3 noise sigmas tell):", *(_set_line(p) for p in shown)]
        lines += [f"  and {left} more" for left in [len(d.collection) - len(shown)] if left]
    lines += ["", *_gap_lines(d), "", *_remaining_lines(d, details)]
    lines += [_nominal_line(p) for p in d.nominal if p.beyond and not details]
    if not details:
        rest = "all that it rests on: --details, summary(details=True)"
        return "\n".join([*lines, f"next: {_next(d)}", f"named in {d.seconds:.3g} s; {rest}"])
    within = "" if any(p.beyond for p in d.nominal) else " within their tolerances"
    for title, part in (
        (f"nominal parameters, refitted{within}", [_nominal_line(p) for p in d.nominal]),
        ("inputs between their samples", [_clock_line(c) for c in d.clocks]),
        ("next experiment", _experiment_lines(d)),
        ("findings on the records", [f"  {f.message}" for f in d.findings]),
        (f"search (log evidence; {len(d.search)} sets visited, {len(d.candidates)} effects tried)", _search_lines(d)),
    ):
        if part:
            lines += ["", f"{title}:", *part]
    return "\n".join([*lines, "", f"named in {d.seconds:.3g} s"])


def in_words(e: NamedEffect) -> str:
    """Title, id and place, for example ``Coulomb (dry) friction, coulomb-friction at omega``."""
    return f"{e.title}, {e.name} at {e.site}"


def with_interval(p: EffectValue | NominalValue) -> str:
    """Value and 95 % interval in the unit, with as many digits as the interval is worth; of no width: held fixed."""
    unit = f" {p.unit}" if p.unit and p.unit != "1" else ""
    if p.lower == p.upper:
        return f"{p.value:.4g}{unit} (held fixed)"
    digits = _digits(p.value, p.upper - p.lower)
    return f"{p.value:.{digits}g}{unit} (95 %: {p.lower:.{digits}g} to {p.upper:.{digits}g})"


def compared(before: float, after: float, name: str) -> str:
    """How the second error compares with the first, which is that of ``name``: ``46 times smaller than refitted``."""
    if math.isinf(before) and math.isfinite(after):
        return f"finite, unlike {name}"
    if not (math.isfinite(before) and math.isfinite(after)):
        return f"not comparable with {name}"
    if before <= 0.0 or after <= 0.0:
        return f"as large as {name}" if before == after else f"{'zero' if after <= 0.0 else 'not zero'}, unlike {name}"
    ratio = before / after
    if abs(ratio - 1.0) < AS_LARGE:
        return f"as large as {name}"
    times = max(ratio, 1.0 / ratio)
    size = f"{times:.3g}" if times < 1000.0 else f"{times:.0f}"
    return f"{size} times {'smaller' if ratio > 1.0 else 'larger'} than {name}"


def chance(probability: float) -> str:
    """A probability in percent; what is as good as sure or impossible is told by a bound."""
    if probability > 0.999:
        return "> 99.9 %"
    return "< 0.1 %" if probability < 0.001 else f"{100 * probability:.3g} %"


def _scope(d: Discovery) -> str:
    records = ", ".join(d.records)
    return f"{'complete' if d.complete else 'incomplete: structure remains'} (records: {records}; status {d.status})"


def _choices(d: Discovery) -> str:
    """What all sets of the collection have, then what they differ in: ``A and either B or C``."""
    sets = [(*p.effects, p.unnamed) if p.unnamed else p.effects for p in d.collection]
    common = [e for e in (sets[0] if sets else ()) if all(e in other for other in sets)]
    rest = [[_title(e) for e in own if e not in common] for own in sets]
    if not any(rest):
        choices = [_or([e.title, *(r.title for r in d.rivals if r.instead_of == e.name)]) for e in d.effects]
        return _listed(choices)
    both = _or(_listed(own) if own else f"nothing{' more' if common else ''}" for own in rest)
    return f"{_listed(map(_title, common))}, and either {both}" if common else f"either {both}"


def _title(effect: str) -> str:
    """Title of ``"coulomb-friction@omega"``; an unnamed force is told as it is."""
    name = effect.partition("@")[0]
    return catalogue()[name].title if name in catalogue() else f"an unnamed {name}"


def _effect_lines(d: Discovery, effect: NamedEffect, details: bool) -> list[str]:
    lines = [f"  {in_words(effect)}: probability {chance(effect.confidence)}"]
    lines += [_row(f"  {p.name}", f"{with_interval(p)}  {p.meaning}".rstrip()) for p in effect.parameters]
    lines += _wave_line(effect)
    if not details:
        return lines
    lines += [_row("  equation", effect.equation)]
    lines += [_row("  evidence", f"{effect.evidence:+.4g} (log) over the best set without it")]
    rivals = [r for r in d.rivals if r.instead_of == effect.name]
    if not rivals and 1.0 - effect.confidence < ALONE:
        lines.append(_row("  rivals", f"none: all sets without it have {chance(1.0 - effect.confidence)} together"))
    for r in rivals:
        values = ", ".join(f"{p.name} {_number(p.value, p.unit)}" for p in r.parameters)
        told = f"probability {chance(r.probability)}, {_number(r.distance)} noise sigmas apart (3 tell)"
        lines.append(_row("  or", f"{r.title}, {r.name} at {r.site} ({values}): {told}"))
    return lines


def _wave_line(effect: NamedEffect) -> list[str]:
    """Amplitude and period of an effect that is periodic: what a person looks for in its cosine and sine part."""
    values = {p.name: p.value for p in effect.parameters}
    amplitude = wave_amplitude(values)
    if amplitude is None or not values.get("k"):
        return []
    period = 2.0 * math.pi / values["k"]
    (unit,) = (p.unit for p in effect.parameters if p.name == "k")
    told = f"period {_number(period, unit.removeprefix('1/'))}"
    if "rad" in unit:
        told += f", {values['k']:.4g} a turn"
    return [_row("  amplitude", f"{_number(amplitude, effect.parameters[0].unit)}, {told}")]


def _doubt_line(r: Rival) -> str:
    """An effect that the tolerances of other parameters may hide."""
    values = ", ".join(with_interval(p) for p in r.parameters)
    told = f"probability {chance(r.probability)}, {_number(r.distance)} noise sigmas from none (3 tell)"
    return _row("not excluded", f"{r.title}, {r.name} at {r.site} ({values}): {told}")


def _set_line(p: SetProbability) -> str:
    told = " + ".join(p.effects) or "nothing missing"
    unnamed = f" + unnamed {p.unnamed}" if p.unnamed else ""
    apart = f"; {_number(p.distance)} noise sigmas from the first" if p.distance > 0.0 else ""
    return _row(chance(p.probability), f"{told}{unnamed}{apart}")


def _gap_lines(d: Discovery) -> list[str]:
    """A table: of each output the three errors in windows and in one run, and what became of the refitted one."""
    head = f"gap (rms) on data that the fit never saw: {d.held_out}"
    if d.free_run_on and d.free_run_on != d.held_out:
        head += f"; {d.whole_run}: {d.free_run_on}"
    rows: list[tuple[str, ...]] = [("", "", *MODELS, "")]
    for name, gap in d.gaps.items():
        rows.append((name, f"windows of {d.window:.3g} s", *_sizes(gap)))
        if name in d.free_run:
            rows.append(("", d.whole_run, *_sizes(d.free_run[name])))
    if len(d.gaps) > 1:
        rows.append(("all", "windows", *(_percent(overall(d.gaps, m)) for m in MODELS), ""))
        if d.free_run:
            rows.append(("", d.whole_run, *(_percent(overall(d.free_run, m)) for m in MODELS), ""))
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    return [head, *("  " + "  ".join(c.ljust(w) for c, w in zip(row, widths, strict=True)).rstrip() for row in rows)]


def _sizes(g: Gap) -> tuple[str, str, str, str]:
    def size(value: float) -> str:
        if math.isinf(value):
            return "diverges"
        return _number(value, g.unit) + (f" ({_percent(100 * value / g.range)})" if g.range > 0 else "")

    return size(g.nominal), size(g.refitted), size(g.updated), compared(g.refitted, g.updated, "refitted")


def _remaining_lines(d: Discovery, details: bool) -> list[str]:
    if d.complete:
        told = "nothing systematic was found"
    else:
        told = "the named effects do not explain everything" if d.effects else "unexplained"
    force = d.residual_force
    if force is not None and not d.complete:
        told += f"; a force of {_number(force.rms, force.unit)} (rms)"
    lines = [f"remains: {told}", *(_row("line", _line(line)) for line in d.remaining_lines)]
    if not details:
        return lines
    if d.structure:
        lines.append(_row("structure", _items(d.structure)))
    if force is not None:
        shares = [f"{100 * c.share:.3g} % follow {c.coordinate}" for c in force.curves.values()]
        lines.append(_row("force", f"rms {_number(force.rms, force.unit)}; {', '.join(shares)} (of held-out variance)"))
    if d.unnamed is not None:
        over = _listed(f"{c.kind} in {c.coordinate}" for c in d.unnamed.components) or "a constant alone"
        lines.append(_row("unnamed map", f"{over} removes {100 * d.unnamed.gain:.3g} % of the held-out variance"))
    lines += [
        _row("noise", f"{name}: F {_number(F)} of the updated model against the noise floor (1: nothing is left)")
        for name, F in d.floor_excess.items()
    ]
    return lines


def _line(line: Mapping[str, Any]) -> str:
    """A periodic line in the force that remains: its amplitude and period with units."""
    size = _number(line["amplitude"], line["force_unit"])
    return f"{size} over {line['over']}, period {_number(line['period'], line['unit'])} (p {line['p_value']:.2g})"


def _nominal_line(p: NominalValue) -> str:
    if p.lower == p.upper:
        return _row(p.name, with_interval(p))
    change = f", {100 * (p.value / p.nominal - 1):+.3g} %" if p.nominal else ""
    size = f"{100 * p.tolerance:.3g} %" if p.nominal else _number(p.tolerance, p.unit)
    stated = "assumed" if p.assumed else "stated"
    told = f"{'BEYOND its' if p.beyond else 'within its'} tolerance of {size} ({stated})"
    return _row(p.name, f"{_number(p.nominal)} -> {with_interval(p)}{change}: {told}")


def _clock_line(c: InputClock) -> str:
    between = "held from sample to sample" if c.hold == "held" else f"{c.hold} between samples"
    late = f"late by {1e3 * c.shift:.3g} ms (standard deviation {1e3 * c.std:.2g} ms)" if c.std else "clock not fitted"
    return _row(c.input, f"{between}; {late}")


def _next(d: Discovery) -> str:
    """One line on what to do with the answer."""
    if d.next_experiment is not None:
        return f"measure what tells them apart: {d.next_experiment.summary().splitlines()[0]}"
    if not d.complete:
        return "look at the force that remains, over speed, position, time and input (figure 'force')"
    return "use the updated plant (.model)" if d.effects else "the model can stay as it is, refitted"


def _experiment_lines(d: Discovery) -> list[str]:
    if d.next_experiment is None:
        return []
    return [f"  {line}" for line in d.next_experiment.summary().splitlines()]


def _search_lines(d: Discovery) -> list[str]:
    best = sorted(d.search, key=lambda e: -e.evidence)[:SHOWN_SEARCH]
    return [_row(f"{e.evidence:.4g}", f"{' + '.join(e.effects) or 'none'}: {e.decision}") for e in best]


def _row(label: str, text: str) -> str:
    return f"  {label.ljust(LABEL - 1)} {text}"


def _listed(texts: Iterable[str]) -> str:
    """``a``, ``a and b``, ``a, b and c``; first letters small where they begin a word, not a symbol."""
    words = [_small(text) for text in texts]
    return " and ".join([", ".join(words[:-1]), words[-1]]) if len(words) > 1 else "".join(words)


def _or(texts: Iterable[str]) -> str:
    words = list(dict.fromkeys(_small(text) for text in texts))
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} or {words[-1]}"


def _small(text: str) -> str:
    people = tuple(e.person for e in catalogue().values() if e.person)  # they keep their capital
    return text if text.startswith(people) else text[:1].lower() + text[1:]


def _items(table: Mapping[str, Any]) -> str:
    return ", ".join(f"{key} {_number(value) if isinstance(value, float) else value}" for key, value in table.items())


def _digits(value: float, width: float) -> int:
    """Digits of the value that show two of the interval's width."""
    if not (math.isfinite(value) and math.isfinite(width)) or width <= 0.0 or value == 0.0:
        return 4
    return min(max(math.floor(math.log10(abs(value))) - math.floor(math.log10(width)) + 2, 3), 8)


def _number(value: float, unit: str = "") -> str:
    return f"{value:.4g} {unit}" if unit and unit != "1" else f"{value:.4g}"


def _percent(value: float) -> str:
    return "diverges" if math.isinf(value) else f"{value:.3g} %"
