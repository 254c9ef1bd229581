"""What `discover` answers: the verdict, the named effects with their evidence, the gap before and after; its text."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal

from robustlab.dynamics.effects.catalogue import catalogue
from robustlab.result import Evidence, Status

if TYPE_CHECKING:
    from robustlab.identification.comparison.noise_floor import NoiseFloor
    from robustlab.identification.experiment.next_experiment import NextExperiment
    from robustlab.identification.record_check.suitability import Finding
    from robustlab.identification.unnamed.unnamed_effect import ResidualForce, UnnamedForce
    from robustlab.uncertainty.lft import UncertainModel

__all__ = [
    "Discovery",
    "EffectValue",
    "Gap",
    "NamedEffect",
    "NamingStep",
    "NominalValue",
    "Rival",
    "StepEntry",
    "Verdict",
    "compared",
    "headline",
    "in_words",
    "with_interval",
]


Verdict = Literal["no missing effect", "named", "ambiguous", "unknown"]


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
    """One refitted nominal parameter: value before and after, unit, 95 % interval, and the tolerance it was given.

    ``assumed`` is True where the plant states no tolerance and one was assumed.
    """

    name: str
    nominal: float
    value: float
    unit: str
    lower: float
    upper: float
    tolerance: float
    assumed: bool


@dataclass(frozen=True)
class Rival(Evidence):
    """An effect that these records cannot separate from a named one.

    Attributes
    ----------
    name, title, site
        The rival.
    instead_of
        Id of the named effect whose place it could take; "none" where nothing was named, but this effect is about as
        probable as none: the tolerances of other parameters may hide it.
    distance
        Refit distance d in standard deviations of the noise: how far the rival's best fit stays from what the named
        effect predicts for these very records. d < 3 cannot be told apart. Of a rival of "none" it is how far the bare
        model stays from what the rival predicts.
    evidence
        Log evidence relative to the named effect (negative: behind).
    wins
        Share of bootstrap samples in which it was the best.
    parameters
        As it was fitted.
    """

    name: str
    title: str
    site: str
    instead_of: str
    distance: float
    evidence: float
    wins: float
    parameters: tuple[EffectValue, ...]


@dataclass(frozen=True)
class NamedEffect(Evidence):
    """One effect that the records show.

    Attributes
    ----------
    name
        Id in the catalogue.
    title, equation, site
        In words; as a formula; where it sits.
    parameters
        Fitted values with intervals.
    confidence
        Share of bootstrap samples of the windows in which it was the best of all candidates, 0..1.
    evidence
        Log evidence over the model without it.
    rivals
        Ids that these records cannot separate from it; empty where the name is unique.
    """

    name: str
    title: str
    equation: str
    site: str
    parameters: tuple[EffectValue, ...]
    confidence: float
    evidence: float
    rivals: tuple[str, ...]


@dataclass(frozen=True)
class Gap(Evidence):
    """Windowed simulation error (RMS) of one output on data that the fit never saw.

    Attributes
    ----------
    output, unit, range
        The output, its unit, its measured range on that data.
    nominal, refitted, updated
        RMS of the nominal model as given, of the nominal model refitted within its tolerances, and of the updated one.
    """

    output: str
    unit: str
    range: float
    nominal: float
    refitted: float
    updated: float


@dataclass(frozen=True)
class StepEntry(Evidence):
    """One hypothesis of a step: effect id and site ("none" for nothing added), log evidence and bootstrap share."""

    name: str
    site: str
    evidence: float
    wins: float


@dataclass(frozen=True)
class NamingStep(Evidence):
    """One step of the greedy search: what it had named before, the ranking, and what it decided.

    ``held_out`` is the windowed RMS error on held-out data, in percent of the outputs' ranges, with the best addition.
    """

    named_before: tuple[str, ...]
    ranking: tuple[StepEntry, ...]
    decision: str
    held_out: float


@dataclass(frozen=True)
class Discovery(Evidence):
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
        The same of the nominal model refitted within its tolerances.
    held_out
        What the gap was measured on: names of the held-out records, or the held-out blocks of the records.
    model
        The updated plant (an `ExtendedPlant` or `LinearPlant`), ready for trim, linearise, save.
    next_experiment
        What to measure next to separate the rivals; None where there are none.
    steps
        The greedy search.
    residual_force, unnamed
        Where something remains: the residual force over speed, position, time and input; its spline map.
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
        ``updated`` (windowed simulation).
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
    steps: tuple[NamingStep, ...]
    candidates: tuple[str, ...]
    structure: Mapping[str, Any]
    findings: tuple[Finding, ...] = ()
    remaining_lines: tuple[Mapping[str, Any], ...] = ()
    next_experiment: NextExperiment | None = None
    residual_force: ResidualForce | None = None
    unnamed: UnnamedForce | None = None
    noise_floor: NoiseFloor | None = None
    floor_excess: Mapping[str, float] = field(default_factory=dict)
    series: Mapping[str, Any] = field(default_factory=dict)
    model: Any = None
    seconds: float = 0.0

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

    def summary(self) -> str:
        """The result as a few lines of text."""
        return _text(self)

    def to_json(self, series: bool = False) -> dict[str, object]:
        """All fields but the plant object; the time series only on request."""
        left_out = {"model", "findings"} | (set() if series else {"series"})
        data: dict[str, object] = {key: value for key, value in vars(self).items() if key not in left_out}
        data.update(names=self.names, answer=self.answer, findings=[vars(f) for f in self.findings])
        return data


# --- the text --------------------------------------------------------------------------------------------------------


SHOWN_CANDIDATES = 4  # of each step
LABEL = 14  # width of the first column


def _text(d: Discovery) -> str:
    """Verdict in a sentence, effects, gap, what remains, nominal parameters, next experiment, findings, steps."""
    lines = [headline(d), "", f"verdict: {d.verdict}, {_scope(d)}"]
    for k, effect in enumerate(d.effects, start=1):
        lines += ["", *_effect_lines(d, k, effect)]
    lines += [_doubt_line(r) for r in d.rivals if r.instead_of == "none"]
    lines += ["", *_gap_lines(d), "", *_remaining_lines(d)]
    for title, part in (
        ("nominal parameters, refitted within their tolerances", [_nominal_line(p) for p in d.nominal]),
        ("next experiment", _experiment_lines(d)),
        ("findings on the records", [f"  {f.message}" for f in d.findings]),
        (f"steps (log evidence behind the best; {len(d.candidates)} effects tried)", list(_step_lines(d.steps))),
    ):
        if part:
            lines += ["", f"{title}:", *part]
    return "\n".join([*lines, "", f"named in {d.seconds:.3g} s"])


def headline(d: Discovery) -> str:
    """The verdict in one sentence that a person understands."""
    change = f"error on held-out data {_percent(d.gap_before)} -> {_percent(d.gap_after)} of the range"
    if d.verdict == "no missing effect":
        within = f"refitted within its tolerances its error on held-out data is {_percent(d.gap_after)} of the range"
        hidden = f"; but they do not exclude {_or(r.title for r in d.rivals)}" if d.rivals else ""
        return f"{d.plant} lacks no effect that these records show: {within}{hidden}."
    if d.verdict == "named":
        also = "" if d.complete else "; something else remains"
        return f"{d.plant} lacks {_listed(e.title for e in d.effects)}: {change}{also}."
    if d.verdict == "ambiguous":
        choices = [_or([e.title, *(r.title for r in _rivals_of(d, e))]) for e in d.effects]
        text = f"{d.plant} lacks {_listed(choices)}: these records cannot tell which"
        return f"{text} ({change}{'' if d.complete else '; something else remains'})."
    beyond = f" beyond {_listed(e.title for e in d.effects)}" if d.effects else ""
    return f"{d.plant} lacks something{beyond} that no effect of the catalogue explains ({change})."


def in_words(e: NamedEffect) -> str:
    """Title, id and place, for example ``Coulomb (dry) friction, coulomb-friction at omega``."""
    return f"{e.title}, {e.name} at {e.site}"


def with_interval(p: EffectValue | NominalValue) -> str:
    """Value and 95 % interval in the unit, with as many digits as the interval is worth."""
    digits = _digits(p.value, p.upper - p.lower)
    unit = f" {p.unit}" if p.unit and p.unit != "1" else ""
    return f"{p.value:.{digits}g}{unit} (95 %: {p.lower:.{digits}g} to {p.upper:.{digits}g})"


def compared(before: float, after: float, name: str) -> str:
    """How the second error compares with the first, which is that of ``name``: ``46 times smaller than refitted``."""
    if not (math.isfinite(before) and math.isfinite(after)):
        return f"not comparable with {name}"
    if before <= 0.0 or after <= 0.0:
        return f"as large as {name}" if before == after else f"{'zero' if after <= 0.0 else 'not zero'}, unlike {name}"
    ratio = before / after
    if abs(ratio - 1.0) < 5e-3:
        return f"as large as {name}"
    times = max(ratio, 1.0 / ratio)
    size = f"{times:.3g}" if times < 1000.0 else f"{times:.0f}"
    return f"{size} times {'smaller' if ratio > 1.0 else 'larger'} than {name}"


def _scope(d: Discovery) -> str:
    records = ", ".join(d.records)
    return f"{'complete' if d.complete else 'incomplete: structure remains'} (records: {records}; status {d.status})"


def _rivals_of(d: Discovery, effect: NamedEffect) -> list[Rival]:
    return [r for r in d.rivals if r.instead_of == effect.name]


def _effect_lines(d: Discovery, k: int, effect: NamedEffect) -> list[str]:
    lines = [f"effect {k}: {in_words(effect)}", _row("equation", effect.equation)]
    lines += [_row(p.name, f"{with_interval(p)}  {p.meaning}".rstrip()) for p in effect.parameters]
    best = f"best in {100 * effect.confidence:.3g} % of the resampled windows"
    lines.append(_row("confidence", f"{best}; log evidence {effect.evidence:+.4g} over the model without it"))
    rivals = _rivals_of(d, effect)
    if not rivals:
        lines.append(_row("rivals", "none: these records exclude every other effect in its place"))
    for r in rivals:
        values = ", ".join(f"{p.name} {_number(p.value, p.unit)}" for p in r.parameters)
        told = f"{_number(r.distance)} noise sigmas apart (3 tell), log evidence {r.evidence:+.3g}"
        lines.append(_row("or", f"{r.title}, {r.name} at {r.site} ({values}): {told}, best in {100 * r.wins:.3g} %"))
    return lines


def _doubt_line(r: Rival) -> str:
    """An effect that the tolerances of other parameters may hide."""
    values = ", ".join(with_interval(p) for p in r.parameters)
    told = f"log evidence {r.evidence:+.3g} over none, {_number(r.distance)} noise sigmas from it (3 tell)"
    return _row("not excluded", f"{r.title}, {r.name} at {r.site} ({values}): {told}")


def _gap_lines(d: Discovery) -> list[str]:
    whole = (
        f"  all outputs   nominal {_percent(d.gap_before)}, refitted {_percent(d.gap_refitted)}, updated "
        f"{_percent(d.gap_after)} of the range: {compared(d.gap_before, d.gap_after, 'nominal')}, "
        f"{compared(d.gap_refitted, d.gap_after, 'refitted')}"
    )
    head = f"gap (rms) on data that the fit never saw: {d.held_out}; windows of {d.window:.4g} s"
    return [head, *(_gap_line(g) for g in d.gaps.values()), *([whole] if len(d.gaps) > 1 else [])]


def _gap_line(g: Gap) -> str:
    def size(word: str, value: float) -> str:
        share = f" ({_percent(100 * value / g.range)})" if g.range > 0 else ""
        return f"{word} {_number(value, g.unit)}{share}"

    sizes = ", ".join(size(word, getattr(g, word)) for word in ("nominal", "refitted", "updated"))
    than = f"{compared(g.nominal, g.updated, 'nominal')}, {compared(g.refitted, g.updated, 'refitted')}"
    return _row(g.output, f"{sizes}: {than}")


def _remaining_lines(d: Discovery) -> list[str]:
    lines = [
        "what remains: nothing systematic was found"
        if d.complete
        else "what remains: the named effects do not explain everything"
        if d.effects
        else "what remains: unexplained"
    ]
    if d.structure:
        lines.append(_row("structure", _items(d.structure)))
    lines += [_row("line", _items(line)) for line in d.remaining_lines]
    force = d.residual_force
    if force is not None:
        told = [f"{100 * c.share:.3g} % follow {c.coordinate}" for c in force.curves.values()]
        lines.append(_row("force", f"rms {_number(force.rms, force.unit)}; {', '.join(told)} (of held-out variance)"))
    if d.unnamed is not None:
        over = _listed(f"{c.kind} in {c.coordinate}" for c in d.unnamed.components) or "a constant alone"
        lines.append(_row("unnamed map", f"{over} removes {100 * d.unnamed.gain:.3g} % of the held-out variance"))
    lines += [
        _row("noise", f"{name}: F {_number(F)} of the updated model against the noise floor (1: nothing is left)")
        for name, F in d.floor_excess.items()
    ]
    return lines


def _nominal_line(p: NominalValue) -> str:
    change = f"{100 * (p.value / p.nominal - 1):+.3g} %" if p.nominal else "nominal zero"
    stated = "assumed" if p.assumed else "stated"
    width = f"{100 * p.tolerance:.3g} %" if p.nominal else _number(p.tolerance, p.unit)
    tolerance = f"tolerance {width} {stated}" if p.tolerance else "held fixed"
    return _row(p.name, f"{_number(p.nominal)} -> {with_interval(p)}, {change}; {tolerance}")


def _experiment_lines(d: Discovery) -> list[str]:
    if d.next_experiment is None:
        return []
    return [f"  {line}" for line in d.next_experiment.summary().splitlines()]


def _step_lines(steps: Iterable[NamingStep]) -> Iterable[str]:
    for k, step in enumerate(steps, start=1):
        shown = [f"{e.name} {e.evidence:.4g}" for e in step.ranking[:SHOWN_CANDIDATES]]
        shown += [f"none {e.evidence:.4g}" for e in step.ranking[SHOWN_CANDIDATES:] if e.name == "none"]
        yield f"  {k}  {', '.join(shown)}"
        yield f"     {step.decision}"


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
    return f"{value:.3g} %"
