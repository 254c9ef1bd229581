"""The text of a `Discovery`: its headline, its short summary, and everything that it rests on.

The result imports its text, so the text names no type of it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any

from robustlab.dynamics.effects.catalogue import catalogue
from robustlab.identification.naming.named_effects import (
    SURE,
    EffectValue,
    Gap,
    InputClock,
    NamedEffect,
    NamedKind,
    NominalValue,
    Rival,
    SetProbability,
    overall,
    wave_amplitude,
)
from robustlab.identification.tuning import AS_LARGE

ALONE = 0.02  # probability of all other sets below which a name has no rival
SHOWN_SETS = 6  # in the short text
SHOWN_SEARCH = 12  # most probable sets of the search
LABEL = 14  # width of the first column
MODELS = ("nominal", "refitted", "updated")


def headline_of(d: Any) -> str:
    """The verdict in one sentence that a person understands."""
    early = "Interrupted; by then: " if d.interrupted else ""
    change = f"error on held-out data {_three_errors(d.gaps, d.effects)}"
    if d.free_run:
        worse = overall(d.free_run, "updated") > overall(d.free_run, "nominal")
        change += f"; in {d.whole_run} {_three_errors(d.free_run)}{', worse than as given' if worse else ''}"
    named = _in_a_row(_sure_words(d))
    if d.verdict == "no missing effect":
        error = f"refitted its error on held-out data is {percent(d.gap_after)} of the range"
        hidden = f"; but they do not exclude {_one_of(r.title for r in d.rivals)}" if d.rivals else ""
        return f"{early}{d.plant} lacks no effect that {_what_shows(d)}: {error}{hidden}"
    also = "" if d.complete else "; incomplete: something else remains"
    if d.verdict == "named":
        return f"{early}{d.plant} lacks {named}: {change}{also}"
    if d.verdict == "ambiguous" and not d.rivals and d.gap_after > d.gap_refitted:
        worth = "on held-out data no nearer than the refitted model"
        return f"{early}{d.plant} may lack {named}, which is {worth} ({change}{also})"
    if d.verdict == "ambiguous" and not d.rivals and len(d.collection) == 1:
        far = "as far as the search came before its work was used up"
        return f"{early}{d.plant} lacks {named}, {far} ({change}{also})"
    if d.verdict == "ambiguous":
        return f"{early}{d.plant} lacks {_choices(d)}: these records cannot tell which ({change}{also})"
    beyond = f" beyond {named}" if d.effects else ""
    return f"{early}{d.plant} lacks something{beyond} that no effect of the catalogue explains ({change})"


def summary_of(d: Any, details: bool) -> str:
    """Verdict in a sentence, effects with intervals, gap, what remains, what to do next; on demand all the rest."""
    lines = [f"{d.headline()}.", "", f"verdict: {d.verdict}, {_scope(d)}"]
    for kind in d.kinds:
        lines += _kind_lines(kind, details)
    for effect in d.effects:
        lines += _effect_lines(d, effect, details)
    lines += [_slight_line(e) for e in d.also_detectable]
    lines += [_doubt_line(r) for r in d.rivals if r.instead_of == "none"]
    lines += [f"  tried: {f.message}" for f in d.findings if f.kind == "refuted"]
    lines += [row for f in d.findings if f.kind == "shut-gap" for row in (f"  {f.message}", f"    to tell: {f.hint}")]
    if len(d.collection) > 1:
        shown = d.collection if details else d.collection[:SHOWN_SETS]
        lines += ["what the records leave open (3 noise sigmas tell):", *(_set_line(p) for p in shown)]
        lines += [f"  and {left} more" for left in [len(d.collection) - len(shown)] if left]
    lines += ["", *_gap_lines(d), "", *_remaining_lines(d, details)]
    lines += [_nominal_line(p) for p in d.nominal if (p.beyond or not d.effects) and not details]
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


def _sure_words(d: Any) -> list[str]:
    """What is sure, in words: a kind by its size where its form is not settled, else the effects; else the best set."""
    if not d.kinds:
        return [e.title for e in d.effects]
    words: list[str] = []
    for kind in d.kinds:
        sure = [m.title for m in kind.members if m.share >= SURE and kind.settled]
        size = f" of {_sized(kind.values[0].value, kind.values[0].unit)}" if kind.values else ""
        words += sure or [f"{kind.title}{size}"]
    return list(dict.fromkeys(words))


def kind_words(kind: NamedKind) -> str:
    """Probability and quantities of a kind whose form is not settled, and what it may be."""
    values = [f"{v.name} {with_interval(v)}" for v in kind.values]
    return "; ".join([chance(kind.probability), *values, f"its form is {kind.open_form}: {_shares(kind)}"])


def _shares(kind: NamedKind) -> str:
    shown = [f"{_small_first(m.title)} {chance(m.share)}" for m in kind.members if m.share >= 0.01]
    return ", ".join(shown[:SHOWN_SETS])


def _three_errors(gaps: Mapping[str, Gap], named: Iterable[NamedEffect] | None = None) -> str:
    """Errors as given, refitted and with the names, of the range; said what they are where the names are given."""
    given, refitted, updated = (percent(overall(gaps, model)) for model in MODELS)
    if named is None:
        return f"{given} -> {refitted} -> {updated}"
    them = {0: "with the best set", 1: "with it"}.get(len(list(named)), "with them")
    return f"{given} of the range as given, {refitted} refitted, {updated} {them}"


def _what_shows(d: Any) -> str:
    return "matters" if d.also_detectable else "these records show"


def _scope(d: Any) -> str:
    records = ", ".join(d.records)
    return f"{'complete' if d.complete else 'incomplete: structure remains'} (records: {records}; status {d.status})"


def _choices(d: Any) -> str:
    """What all sets of the collection have, then what they differ in: ``A and either B or C``."""
    sets = [(*p.effects, p.unnamed) if p.unnamed else p.effects for p in d.collection]
    common = [e for e in (sets[0] if sets else ()) if all(e in other for other in sets)]
    rest = [[_title(e) for e in own if e not in common] for own in sets]
    if not any(rest):
        choices = [_one_of([e.title, *(r.title for r in d.rivals if r.instead_of == e.name)]) for e in d.effects]
        return _in_a_row(choices)
    both = _one_of(_in_a_row(own) if own else f"nothing{' more' if common else ''}" for own in rest)
    return f"{_in_a_row(map(_title, common))}, and either {both}" if common else f"either {both}"


def _title(effect: str) -> str:
    """Title of ``"coulomb-friction@omega"``; an unnamed force is told as it is."""
    name = effect.partition("@")[0]
    return catalogue()[name].title if name in catalogue() else f"an unnamed {name}"


def _kind_lines(kind: NamedKind, details: bool) -> list[str]:
    """A kind whose form is not settled; of a settled one, whose effect follows, its quantities on demand."""
    rows = [_row(f"  {v.name}", f"{with_interval(v)}  {v.meaning}") for v in kind.values]
    if kind.settled and not details:
        return []
    lines = [f"  {kind.words[:1].upper()}{kind.words[1:]}: probability {chance(kind.probability)}", *rows]
    if not kind.settled:
        lines.append(_row("  form", f"{kind.open_form}: {_shares(kind)}"))
        lines.append(_row("", f"what tells: {kind.form}"))
    return lines


def _slight_line(e: NamedEffect) -> str:
    """An effect that the records show and that does not matter."""
    values = ", ".join(f"{p.name} {_sized(p.value, p.unit)}" for p in e.parameters)
    error = f" (error without it {percent(e.error_without)})" if math.isfinite(e.error_without) else ""
    told = f"{chance(e.confidence)}, brings next to nothing on held-out data{error}: not in the updated plant"
    return _row("also seen", f"{in_words(e)} ({values}): {told}")


def _effect_lines(d: Any, effect: NamedEffect, details: bool) -> list[str]:
    lines = [f"  {in_words(effect)}: probability {chance(effect.confidence)}"]
    lines += [_row(f"  {p.name}", f"{with_interval(p)}  {p.meaning}".rstrip()) for p in effect.parameters]
    lines += _wave_line(effect)
    if not details:
        return lines
    if math.isfinite(effect.error_without):
        error = f"{percent(effect.error_without)} of the range on held-out data, {percent(d.gap_after)} with it"
        lines.append(_row("  without it", error))
    lines += [_row("  equation", effect.equation)]
    lines += [_row("  evidence", f"{effect.evidence:+.4g} (log) over the best set without it")]
    rivals = [r for r in d.rivals if r.instead_of == effect.name]
    if not rivals and 1.0 - effect.confidence < ALONE:
        lines.append(_row("  rivals", f"none: all sets without it have {chance(1.0 - effect.confidence)} together"))
    for r in rivals:
        values = ", ".join(f"{p.name} {_sized(p.value, p.unit)}" for p in r.parameters)
        told = f"probability {chance(r.probability)}, {_sized(r.distance)} noise sigmas apart (3 tell)"
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
    told = f"period {_sized(period, unit.rpartition('/')[2])}"
    if "rad" in unit:
        told += f", {values['k']:.4g} a turn"
    return [_row("  amplitude", f"{_sized(amplitude, effect.parameters[0].unit)}, {told}")]


def _doubt_line(r: Rival) -> str:
    """An effect that the tolerances of other parameters may hide."""
    values = ", ".join(with_interval(p) for p in r.parameters)
    told = f"probability {chance(r.probability)}, {_sized(r.distance)} noise sigmas from none (3 tell)"
    return _row("not excluded", f"{r.title}, {r.name} at {r.site} ({values}): {told}")


def _set_line(p: SetProbability) -> str:
    told = " + ".join(p.effects) or "nothing missing"
    unnamed = f" + unnamed {p.unnamed}" if p.unnamed else ""
    apart = f"; {_sized(p.distance)} noise sigmas from the first" if p.distance > 0.0 else ""
    return _row(chance(p.probability), f"{told}{unnamed}{apart}")


def _gap_lines(d: Any) -> list[str]:
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
        rows.append(("all", "windows", *(percent(overall(d.gaps, m)) for m in MODELS), ""))
        if d.free_run:
            rows.append(("", d.whole_run, *(percent(overall(d.free_run, m)) for m in MODELS), ""))
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    return [head, *("  " + "  ".join(c.ljust(w) for c, w in zip(row, widths, strict=True)).rstrip() for row in rows)]


def _sizes(g: Gap) -> tuple[str, str, str, str]:
    def size(value: float) -> str:
        if math.isinf(value):
            return "diverges"
        return _sized(value, g.unit) + (f" ({percent(100 * value / g.range)})" if g.range > 0 else "")

    changes = [compared(g.nominal, g.updated, "the given model"), compared(g.refitted, g.updated, "refitted")]
    return size(g.nominal), size(g.refitted), size(g.updated), ", ".join(changes)


def _remaining_lines(d: Any, details: bool) -> list[str]:
    if d.complete:
        told = "nothing systematic was found"
    elif d.effects and "explained" in d.structure:
        told = (
            f"the named effects explain {percent(100.0 * d.structure['explained'])} of the mean-square error as given"
        )
    else:
        told = "the named effects do not explain everything" if d.effects else "unexplained"
    force = d.residual_force
    if force is not None and not d.complete:
        told += f"; a force of {_sized(force.rms, force.unit)} (rms)"
    lines = [f"remains: {told}", *(_row("line", _line(line)) for line in d.remaining_lines)]
    if not details:
        return lines
    if d.structure:
        lines.append(_row("structure", _items(d.structure)))
    if force is not None:
        shares = [f"{100 * c.share:.3g} % follow {c.coordinate}" for c in force.curves.values()]
        lines.append(_row("force", f"rms {_sized(force.rms, force.unit)}; {', '.join(shares)} (of held-out variance)"))
    lines += [
        _row("noise", f"{name}: F {_sized(F)} of the updated model against the noise floor (1: nothing is left)")
        for name, F in d.floor_excess.items()
    ]
    return lines


def _line(line: Mapping[str, Any]) -> str:
    """A periodic line in the force that remains: its amplitude and period with units."""
    size = _sized(line["amplitude"], line["force_unit"])
    return f"{size} over {line['over']}, period {_sized(line['period'], line['unit'])} (p {line['p_value']:.2g})"


def _nominal_line(p: NominalValue) -> str:
    if p.lower == p.upper:
        return _row(p.name, with_interval(p))
    change = f", {100 * (p.value / p.nominal - 1):+.3g} %" if p.nominal else ""
    size = f"{100 * p.tolerance:.3g} %" if p.nominal else _sized(p.tolerance, p.unit)
    stated = "assumed" if p.assumed else "stated"
    told = f"{'BEYOND its' if p.beyond else 'within its'} tolerance of {size} ({stated})"
    return _row(p.name, f"{_sized(p.nominal)} -> {with_interval(p)}{change}: {told}")


def _clock_line(c: InputClock) -> str:
    between = "held from sample to sample" if c.hold == "held" else f"{c.hold} between samples"
    late = f"late by {1e3 * c.shift:.3g} ms (standard deviation {1e3 * c.std:.2g} ms)" if c.std else "clock not fitted"
    return _row(c.input, f"{between}; {late}")


def _next(d: Any) -> str:
    """One line on what to do with the answer."""
    if d.next_experiment is not None:
        return f"measure what tells them apart: {d.next_experiment.summary().splitlines()[0]}"
    if not d.complete:
        return "look at the force that remains, over speed, position, time and input (figure 'force')"
    return "use the updated plant (.model)" if d.effects else "the model can stay as it is, refitted"


def _experiment_lines(d: Any) -> list[str]:
    if d.next_experiment is None:
        return []
    return [f"  {line}" for line in d.next_experiment.summary().splitlines()]


def _search_lines(d: Any) -> list[str]:
    best = sorted(d.search, key=lambda e: -e.evidence)[:SHOWN_SEARCH]
    return [_row(f"{e.evidence:.4g}", f"{' + '.join(e.effects) or 'none'}: {e.decision}") for e in best]


def _row(label: str, text: str) -> str:
    return f"  {label.ljust(LABEL - 1)} {text}"


def _in_a_row(texts: Iterable[str]) -> str:
    """``a``, ``a and b``, ``a, b and c``; first letters small where they begin a word, not a symbol."""
    words = [_small_first(text) for text in texts]
    return " and ".join([", ".join(words[:-1]), words[-1]]) if len(words) > 1 else "".join(words)


def _one_of(texts: Iterable[str]) -> str:
    words = list(dict.fromkeys(_small_first(text) for text in texts))
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} or {words[-1]}"


def _small_first(text: str) -> str:
    people = tuple(e.person for e in catalogue().values() if e.person)  # they keep their capital
    return text if text.startswith(people) else text[:1].lower() + text[1:]


def _items(table: Mapping[str, Any]) -> str:
    return ", ".join(f"{key} {_sized(value) if isinstance(value, float) else value}" for key, value in table.items())


def _digits(value: float, width: float) -> int:
    """Digits of the value that show two of the interval's width."""
    if not (math.isfinite(value) and math.isfinite(width)) or width <= 0.0 or value == 0.0:
        return 4
    return min(max(math.floor(math.log10(abs(value))) - math.floor(math.log10(width)) + 2, 3), 8)


def _sized(value: float, unit: str = "") -> str:
    return f"{value:.4g} {unit}" if unit and unit != "1" else f"{value:.4g}"


def percent(value: float) -> str:
    """A share of the range, given in percent."""
    return "diverges" if math.isinf(value) else f"{value:.3g} %"
