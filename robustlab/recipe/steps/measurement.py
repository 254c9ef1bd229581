"""Steps on measurements: reading a record, comparing a model with it."""

from __future__ import annotations

from typing import Any

from robustlab.recipe.outcome import Fact, Outcome, Workspace, quantity
from robustlab.recipe.schema import CompareStep, RecordStep

__all__ = ["compare", "record"]


def record(step: RecordStep, work: Workspace) -> Outcome:
    """A measured record; gaps, clocks that run backwards and NaN are refused by the reader."""
    import robustlab as rl

    options: dict[str, Any] = {"units": step.units} if step.units else {}
    path = work.sources[work.step]
    found = rl.Record.read(path, group=step.group, inputs=step.inputs, outputs=step.outputs, dt=step.dt, **options)
    signals = [f"{name} [{found.unit(name) or 'unit not stated'}]" for name in (*found.inputs, *found.outputs)]
    numbers = {"samples": found.n, "duration": found.duration, "dt": found.dt}
    facts = (
        Fact("Samples", f"{found.n}, {quantity(found.duration, 's')} in steps of {quantity(found.dt, 's')}"),
        Fact("Signals", ", ".join(signals)),
    )
    notes = (step.about,) if step.about else ()
    return Outcome(found, f"Record {path.name} read.", numbers, facts, notes=notes)


def compare(step: CompareStep, work: Workspace) -> Outcome:
    """Disagreement of a model with a record: how much, and where in time, speed and frequency it lives."""
    import robustlab as rl
    from robustlab.report.comparison_figures import comparison_figures

    options = {name: getattr(step, name) for name in ("window", "start", "lags", "speed", "position")}
    model, measured = work.values[step.of], work.values[step.record]
    found = rl.compare(model, measured, **{name: value for name, value in options.items() if value is not None})
    work.keep(found)
    facts: list[Fact] = []
    for name, gap in found.outputs.items():
        facts += [
            Fact(
                f"{name}: free run",
                f"peak error {_both(gap.peak, gap.unit, gap.peak_percent)}, rms {_both(gap.rms, gap.unit, gap.rms_percent)}, fit {gap.fit:.4g} %",
            ),
            Fact(
                f"{name}: windows of {quantity(found.window, 's')}",
                f"peak error {_both(gap.windowed_peak, gap.unit, gap.windowed_peak_percent)}, "
                f"rms {_both(gap.windowed_rms, gap.unit, gap.windowed_rms_percent)}, fit {gap.windowed_fit:.4g} %",
            ),
        ]
    for stem, figure, caption in comparison_figures(found):
        work.draw(figure, stem, caption)
    notes = (found.summary(), *found.warnings)
    return Outcome(
        found, f"{step.of} against {step.record}.", found.to_json(series=False), tuple(facts), found.status, notes
    )


def _both(value: float, unit: str, percent: float) -> str:
    return f"{quantity(value, unit, 3)} ({percent:.3g} % of the range)"
