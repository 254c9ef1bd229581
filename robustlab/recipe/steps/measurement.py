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
    notes = (" ".join(step.about.split()),) if step.about else ()
    return Outcome(found, f"Record {path.name} read.", numbers, facts, notes=notes)


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
    summary = f"{step.of} against {step.record}."
    numbers = found.to_json(series=False)
    return Outcome(found, summary, numbers, tuple(facts), found.status, text=found.summary())


_CAPTIONS = {
    "time": "Measured and simulated signal, and the error over time; shaded: the window with the largest error.",
    "speed": "Where the error lives over speed and position: dry friction shows as a step at zero speed.",
    "spectrum": "Where the error lives over frequency.",
    "residual": "What is left in the residual: its correlation with itself and with the input, and the 99 % band.",
}


def _errors(unit: str, sizes: tuple[float, float, float, float, float]) -> str:
    peak, peak_percent, rms, rms_percent, fit = sizes
    peak_text = f"peak {quantity(peak, unit, 3)} ({peak_percent:.3g} % of the range)"
    return f"{peak_text}, rms {quantity(rms, unit, 3)} ({rms_percent:.3g} %), fit {fit:.4g} %"
