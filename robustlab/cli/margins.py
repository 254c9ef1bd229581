"""``robustlab model margins`` and ``robustlab model gap``: disk margins of a loop, distance between two models."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, Any, cast

import typer

from robustlab.cli.console import EffortOption, JsonOption, OutOption, SeedOption, TimeLimitOption, emit, note, table
from robustlab.errors import UsageError

if TYPE_CHECKING:
    from robustlab.mu_analysis.margins.disk_margin import DiskMargin, DiskMargins
    from robustlab.mu_analysis.margins.worst_case_disk_margin import WorstCaseDiskMargin
    from robustlab.uncertainty.distances.gap_metric import GapMetric

__all__ = ["gap", "margins"]

TransposeOption = Annotated[
    bool, typer.Option("--transpose", help="The files were written column by column: swap A, B, C, D.")
]


def margins(
    plant: Annotated[str, typer.Argument(help="HDF5 or MATLAB file with the plant, or the open loop.")],
    controller: Annotated[
        str | None,
        typer.Option("--controller", "-k", help="File with the controller; left out: unity.", show_default=False),
    ] = None,
    at: Annotated[str, typer.Option(help="Where gain and phase change: input, output or both.")] = "output",
    skew: Annotated[float, typer.Option(help="0: gain up as much as down; positive: rather up.")] = 0.0,
    feedback: Annotated[
        str | None,
        typer.Option(
            help="negative (u = -K y) or positive; if left out, positive for a file of kind controller, else negative.",
            show_default=False,
        ),
    ] = None,
    effort: EffortOption = 1.0,
    time_limit: TimeLimitOption = None,
    seed: SeedOption = 0,
    transpose: TransposeOption = False,
    out: OutOption = None,
    as_json: JsonOption = False,
) -> None:
    """Disk margins of a loop with the worst gain and phase; for an uncertain plant those of its worst member.

    Example: robustlab model margins plant.h5 --controller K.h5 --at both
    """
    from robustlab.mu_analysis.margins.disk_margin import PLACES, Place, disk_margin
    from robustlab.mu_analysis.margins.worst_case_disk_margin import worst_case_disk_margin
    from robustlab.storage import load
    from robustlab.uncertainty.lft import UncertainModel

    if at not in PLACES:
        raise UsageError(f"--at {at}", "no such place", "input, output or both")
    thing = load(plant, transpose=transpose)
    k = None if controller is None else load(controller, transpose=transpose)
    sign = _sign(feedback, k)
    place = cast(Place, at)
    options: dict[str, Any] = {"time_limit": time_limit, "effort": effort, "seed": seed}
    if isinstance(thing, UncertainModel):
        result: Any = worst_case_disk_margin(thing, k, at=place, skew=skew, sign=sign, **options)
        text = _worst_text(result)
    else:
        result = disk_margin(thing, k, at=place, skew=skew, sign=sign, **options)
        text = _text(result)
    if out is not None:
        from robustlab.storage import save

        save(out, result)
        note(f"written: {out}")
    word = "negative" if sign < 0 else "positive"
    head = f"disk margins at the {'inputs and outputs' if at == 'both' else at + 's'}, {word} feedback, skew {skew:g}"
    emit("model margins", {**result.to_json(), "feedback": word}, f"{head}\n{text}", as_json)
    if not result.status.trustworthy:
        raise typer.Exit(4)


def _sign(feedback: str | None, controller: Any) -> Any:
    from robustlab.synthesis.problem.design import Controller

    if feedback is None:
        return 1 if isinstance(controller, Controller) else -1
    if feedback not in ("negative", "positive"):
        raise UsageError(f"--feedback {feedback}", "no such word", "negative or positive")
    return -1 if feedback == "negative" else 1


def _text(margins: DiskMargins) -> str:
    rows = [_row(name, margin) for name, margin in margins.channels.items()]
    notes = margins.simultaneous.notes
    if len(rows) > 1:
        rows.append(_row("all at once", margins.simultaneous))
    worst = margins.simultaneous
    lines = [table(rows, ("loop", "disk margin", "gain", "phase", "critical at", "status"))]
    if worst.factor:
        lines += ["", f"worst factors at {_frequency(worst)}:"]
        lines.append(table([(name, _polar(f)) for name, f in worst.factor.items()], ("loop", "factor")))
    return "\n".join([*lines, *(f"note: {text}" for text in notes)])


def _worst_text(margin: WorstCaseDiskMargin) -> str:
    low, high = margin.gain_margin
    rows = [(name, _value(value), _physical(margin.physical, name)) for name, value in margin.delta.items()]
    lines = [
        f"worst-case disk margin  {margin.lower:.6g} .. {margin.upper:.6g}  ({margin.status}), all loops at once",
        f"gain                    {_gain(low)} .. {_gain(high)}",
        f"phase                   +-{_degrees(margin.phase_margin)}",
        f"nominal disk margin     {margin.nominal.lower:.6g} .. {margin.nominal.upper:.6g}",
        "",
        "worst member found:",
        table(rows, ("block", "delta", "parameter")),
    ]
    return "\n".join([*lines, *(f"note: {text}" for text in margin.notes)])


def _row(name: str, margin: DiskMargin) -> tuple[str, ...]:
    low, high = margin.gain_margin
    return (
        name,
        f"{margin.lower:.6g} .. {margin.upper:.6g}",
        f"{_gain(low)} .. {_gain(high)}",
        f"+-{_degrees(margin.phase_margin)}",
        _frequency(margin),
        str(margin.status),
    )


def _frequency(margin: DiskMargin) -> str:
    return "none" if margin.frequency is None else f"{margin.frequency:.6g} rad/s"


def _gain(value: float) -> str:
    return f"{value:.4g}"


def _degrees(phase: float) -> str:
    import math

    return f"{math.degrees(phase):.4g} deg"


def _polar(factor: complex) -> str:
    import cmath
    import math

    if cmath.isinf(factor):
        return "infinite"
    return f"{abs(factor):.6g} at {math.degrees(cmath.phase(factor)):+.4g} deg"


def _value(value: Any) -> str:
    shape = getattr(value, "shape", ())
    return f"{shape[0]} x {shape[1]} matrix" if shape else f"{value:+.6g}"


def _physical(physical: Mapping[str, tuple[float, str]], name: str) -> str:
    value = physical.get(name)
    return f"{value[0]:.6g} {value[1]}".rstrip() if value else ""


def gap(
    first: Annotated[str, typer.Argument(help="HDF5 or MATLAB file.", metavar="A")],
    second: Annotated[str, typer.Argument(help="The other file.", metavar="B")],
    transpose: TransposeOption = False,
    out: OutOption = None,
    as_json: JsonOption = False,
) -> None:
    """Distance of two models as feedback sees it, gap and nu-gap metric: 0 equal, 1 nothing in common.

    Example: robustlab model gap before.h5 after.h5
    """
    from robustlab.statespace import as_model
    from robustlab.storage import load
    from robustlab.uncertainty.distances.gap_metric import gap as gap_metric

    one, two = (as_model(load(path, transpose=transpose), path) for path in (first, second))
    result = gap_metric(one, two)
    if out is not None:
        from robustlab.storage import save

        save(out, result)
        note(f"written: {out}")
    emit("model gap", result.to_json(), _gap_text(result), as_json)
    if not result.status.trustworthy:
        raise typer.Exit(4)


def _gap_text(result: GapMetric) -> str:
    nu = result.nu
    lines = [
        f"gap     {result.value:.6g}  ({result.status})",
        f"nu-gap  {nu.value:.6g}  ({nu.status})",
        f"largest distance at one frequency: {nu.chordal:.6g} at {nu.frequency:.6g} rad/s",
    ]
    return "\n".join([*lines, *(f"note: {text}" for text in dict.fromkeys((result.reason, nu.reason)) if text)])
