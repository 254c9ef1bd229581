"""Steps on measurements: reading a record, comparing a model or a set of models with it, checking a data sheet."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from robustlab.recipe.outcome import Fact, Outcome, Workspace, quantity
from robustlab.recipe.schema import CompareStep, CoverStep, DataSheetStep, JoinStep, RecordStep

if TYPE_CHECKING:
    from robustlab.record import Record

__all__ = ["compare", "cover", "data_sheet", "join", "record"]


def record(step: RecordStep, work: Workspace) -> Outcome:
    """A record, measured or simulated; gaps, clocks that run backwards and NaN are refused by the reader."""
    import robustlab as rl

    options: dict[str, Any] = {"units": step.units} if step.units else {}
    if step.clock is not None:
        options["clock"] = step.clock
    path = work.sources[work.step]
    found = rl.Record.read(path, group=step.group, inputs=step.inputs, outputs=step.outputs, dt=step.dt, **options)
    notes = (" ".join(step.about.split()),) if step.about else ()
    if step.simulated:
        work.simulated.add(work.step)
    return _as_record(found, f"Record {path.name} read ({work.origin(work.step)}).", notes)


def join(step: JoinStep, work: Workspace) -> Outcome:
    """The signals of two loggers on one clock."""
    from robustlab.identification.record_check.resampling import join_clocks

    if work.simulated & {step.first, step.second}:
        work.simulated.add(work.step)
    found = join_clocks(work.record(step.first), work.record(step.second), step.dt)
    return _as_record(found, f"{step.first} and {step.second} on one clock.", ())


def _as_record(found: Record, summary: str, notes: tuple[str, ...]) -> Outcome:
    signals = [f"{name} [{found.unit(name) or 'unit not stated'}]" for name in (*found.inputs, *found.outputs)]
    numbers = {"samples": found.n, "duration": found.duration, "dt": found.dt}
    facts = (
        Fact("Samples", f"{found.n}, {quantity(found.duration, 's')} in steps of {quantity(found.dt, 's')}"),
        Fact("Signals", ", ".join(signals)),
    )
    return Outcome(found, summary, numbers, facts, notes=notes)


def compare(step: CompareStep, work: Workspace) -> Outcome:
    """Disagreement of a model with a record: how much, and where in time, speed and frequency it lives."""
    import robustlab as rl
    from robustlab.report.comparison_figures import comparison_figures

    options = {name: getattr(step, name) for name in ("window", "start", "lags", "speed", "position")}
    model, measured = work.values[step.of], work.record(step.record)
    found = rl.compare(model, measured, **{name: value for name, value in options.items() if value is not None})
    work.keep(found)
    facts: list[Fact] = []
    for name, gap in found.outputs.items():
        free = (gap.peak, gap.peak_percent, gap.rms, gap.rms_percent, gap.fit)
        windowed = (
            gap.windowed_peak,
            gap.windowed_peak_percent,
            gap.windowed_rms,
            gap.windowed_rms_percent,
            gap.windowed_fit,
        )
        facts.append(Fact(f"{name}: free run", _errors(gap.unit, free)))
        facts.append(Fact(f"{name}: restarted every {quantity(found.window, 's', 3)}", _errors(gap.unit, windowed)))
    for name, figure in comparison_figures(found).items():
        work.draw(figure, name, _CAPTIONS.get(name.partition("-")[0], name))
    summary = f"{step.of} against {step.record}, a {work.origin(step.record)} record."
    numbers = found.to_json(series=False)
    return Outcome(found, summary, numbers, tuple(facts), found.status, text=found.summary())


_CAPTIONS = {
    "time": "The record and its simulation, and the error over time; shaded: the window with the largest error.",
    "speed": "Where the error lives over speed and position: dry friction shows as a step at zero speed.",
    "spectrum": "Where the error lives over frequency.",
    "residual": "What is left in the residual: its correlation with itself and with the input, and the 99 % band.",
}


def _errors(unit: str, sizes: tuple[float, float, float, float, float]) -> str:
    peak, peak_percent, rms, rms_percent, fit = sizes
    peak_text = f"peak {quantity(peak, unit, 3)} ({peak_percent:.3g} % of the range)"
    return f"{peak_text}, rms {quantity(rms, unit, 3)} ({rms_percent:.3g} %), fit {fit:.4g} %"


def data_sheet(step: DataSheetStep, work: Workspace) -> Outcome:
    """Printed operating points against the equilibrium of a plant: what contradicts it, and which effect would not."""
    from robustlab.identification.record_check.steady_state import SheetPoint, compare_steady_state

    points = [SheetPoint(**vars(p)) for p in step.points]
    found = compare_steady_state(work.values[step.of], points)
    work.keep(found)
    facts = [Fact(p.name, ", ".join(f"{k} {quantity(v)}" for k, v in p.stated.items()), p.source) for p in points]
    for c in found.checks:
        told = "contradicted" if c.contradicted else "agrees within the tolerances"
        if c.contradicted:
            named = [f"{c.effect} ({quantity(c.factor, digits=3)} times off)"] if c.effect else []
            told += f"; explained by {' or '.join([*named, *c.rivals]) or 'no effect alone'}"
        facts.append(Fact(f"{c.point}: {c.balance} balance", told))
    count = len(found.contradictions)
    summary = f"{len(found.checks)} balances of {step.of} checked at {len(points)} points; {count} contradicted."
    return Outcome(found, summary, found.to_json(), tuple(facts), found.status, text=found.summary())


def cover(step: CoverStep, work: Workspace) -> Outcome:
    """Whether a record lies in the envelope of an uncertain model's members, and by how much it does not."""
    from robustlab.identification.comparison.envelope import cover as cover_record
    from robustlab.report.validation_figures import envelope_figure

    seed = work.seed if step.seed is None else step.seed
    found = cover_record(
        work.uncertain(step.of),
        work.record(step.record),
        n=step.n,
        vertices=step.vertices,
        seed=seed,
        rate=step.rate,
        allowance=step.allowance,
    )
    work.keep(found)
    facts: list[Fact] = []
    for name, s in found.signals.items():
        miss = "" if not s.miss else f"; misses by {quantity(s.miss, s.unit, 3)} ({s.miss_percent:.3g} %)"
        facts.append(Fact(f"{name}: inside the envelope", f"{100 * s.share:.3g} % of the time{miss}"))
        facts.append(Fact(f"{name}: gap of the nominal model", f"{quantity(s.gap, s.unit, 3)} ({s.gap_percent:.3g} %)"))
        reach = f"{quantity(s.reach, s.unit, 3)} ({s.reach_percent:.3g} %)"
        facts.append(Fact(f"{name}: how far the set reaches", reach))
        caption = (
            f"{name}: the record, and below it the record minus the nominal model, in the envelope of all members."
        )
        work.draw(envelope_figure(s), name, caption)
    verdict = "lies in the envelope" if found.covered else "is not covered"
    kind = work.origin(step.record)
    summary = f"{step.record} ({kind}) {verdict} of {found.members} members of {step.of} (seed {seed})."
    notes = (
        "Sampled, not proved: members that were not drawn may reach further.",
        "Covered is not explained: a set that is wide enough covers anything.",
    )
    return Outcome(found, summary, found.to_json(series=False), tuple(facts), found.status, notes, found.summary())
