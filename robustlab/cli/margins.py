"""``robustlab model margins`` and ``robustlab model gap``: disk margins of a loop, distance between two models."""

from __future__ import annotations

import cmath
import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated, Any, Literal, cast

import typer

import robustlab as rl
from robustlab.cli.console import table
from robustlab.cli.members import delta_value, stands_for
from robustlab.cli.offers import one_of
from robustlab.cli.options import EffortOptions, OutputOptions, SeedOption, frequencies, grouped
from robustlab.cli.progress import ProgressOptions
from robustlab.errors import NoTrustworthyNumber, UsageError

if TYPE_CHECKING:
    from robustlab.mu_analysis.margins.classical import ClassicalMargins
    from robustlab.mu_analysis.margins.disk_margin import DiskMargin, DiskMargins
    from robustlab.mu_analysis.margins.worst_case_disk_margin import WorstCaseDiskMargin

TransposeOption = Annotated[
    bool, typer.Option("--transpose", help="The files were written column by column: swap A, B, C, D.")
]


@dataclass(frozen=True)
class ControllerOptions:
    """A controller around what a file holds."""

    controller: Annotated[
        str | None, typer.Option("--controller", "-k", help="File with the controller; left out: none.")
    ] = None
    feedback: Annotated[
        str | None,
        typer.Option(
            help="negative (u = -K y) or positive; if left out, as the controller's file says.",
            autocompletion=one_of("negative", "positive"),
        ),
    ] = None

    def read(self, where: str, transpose: bool = False) -> tuple[Any, Literal[-1, 1] | None, str]:
        """The controller (None where left out), the sign that was asked for, and a note where the file says another."""
        from robustlab.closing import SIGNS, as_controller, silenced
        from robustlab.signals import Taken, law

        k: Any = None if self.controller is None else rl.load(self.controller, transpose=transpose)
        if self.feedback is None:
            return k, None, ""
        if self.feedback not in ("negative", "positive"):
            raise UsageError(f"--feedback {self.feedback}", "no such word", "negative or positive")
        sign = -1 if self.feedback == "negative" else 1
        inputs = () if k is None else as_controller(k, where).inputs
        if all(s.sign in (0, sign) for s in inputs if isinstance(s, Taken)):
            return k, sign, ""
        note = (
            f"note: {self.controller} says {law(inputs)}; --feedback {self.feedback} closes {SIGNS[sign]} all the same"
        )
        return silenced(k, where), sign, note

    def closed(self, uncertain: Any, where: str, file: str) -> tuple[Any, str, str]:
        """What a file holds with the controller around it, the loop in words, and how a text begins that is of it."""
        from robustlab.closing import fed_back

        k, asked, note = self.read(where)
        if k is None and asked is not None:
            raise UsageError("--feedback", "without --controller", "a controller to close the loop with")
        if k is None:
            return uncertain, "", ""
        around, sign, said = fed_back(uncertain, k, asked, where, None)
        loop = uncertain.feedback(around, sign)
        self.require_stable(loop, f"{where}: {file}", said)
        return loop, said, "\n".join([*([note] if note else []), f"loop  {self.said(said)}", "", ""])

    def require_stable(self, loop: Any, where: str, said: str) -> None:
        """Refuse a nominal loop that is not stable, with the way on."""
        nominal = getattr(loop, "nominal", None)
        if not isinstance(nominal, rl.StateSpaceModel) or nominal.is_stable():
            return
        poles = nominal.poles()
        worst = poles[(abs(poles) if nominal.is_discrete else poles.real).argmax()]
        found = f"the nominal loop {self.said(said)} is unstable (pole {worst:.4g})"
        hint = "was this controller designed for this plant? --feedback negative or positive closes it otherwise"
        raise NoTrustworthyNumber(where, found, "a stable loop", hint)

    def said(self, loop: str) -> str:
        """The loop in words, with the controller's file."""
        return loop.replace("the controller", self.controller or "the file")


@dataclass(frozen=True)
class LoopOptions(ControllerOptions):
    """The loop, and where it is judged."""

    controller: Annotated[
        str | None, typer.Option("--controller", "-k", help="File with the controller; left out: unity.")
    ] = None
    classical: Annotated[
        bool, typer.Option("--classical", help="Gain, phase and delay margin of each loop alone, with all crossings.")
    ] = False
    at: Annotated[
        str,
        typer.Option(
            help="Where gain and phase change: input, output or both.", autocompletion=one_of("input", "output", "both")
        ),
    ] = "output"
    frequency: Annotated[
        str | None, typer.Option(help="Disk margins at these frequencies only, rad/s: 1,10; or 2Hz.")
    ] = None
    skew: Annotated[float, typer.Option(help="0: gain up as much as down; positive: rather up.")] = 0.0


@grouped
def margins(
    *,
    plant: Annotated[str, typer.Argument(help="HDF5 or MATLAB file with the plant, or the open loop.")],
    loop: LoopOptions,
    effort: EffortOptions,
    seed: SeedOption = 0,
    transpose: TransposeOption = False,
    progress: ProgressOptions,
    output: OutputOptions,
) -> None:
    """Disk margins of a loop with the worst gain and phase; for an uncertain plant those of its worst member.

    Of a plant with exact delays: with its delays exact, proved for all frequencies.

    Example: robustlab model margins plant.h5 --controller K.h5 --at both
    """
    from robustlab.closing import WORDS, closing, silenced
    from robustlab.delays.model import as_delayed
    from robustlab.mu_analysis.margins.disk_margin import PLACES, Place

    if loop.at not in PLACES:
        raise UsageError(f"--at {loop.at}", "no such place", "input, output or both")
    thing: Any = rl.load(plant, transpose=transpose)
    k, asked, note = loop.read("model margins", transpose)
    late = isinstance(thing, rl.DelayedModel) or isinstance(k, rl.DelayedModel)
    if late:
        thing, k = (None if o is None else as_delayed(getattr(o, "K", o), plant) for o in (thing, k))
    closed = closing(thing, k, asked, "model margins", None if k is not None else -1)
    thing, sign = closed.plant, closed.sign
    k = None if closed.K is None else silenced(closed.K, "model margins")
    options: dict[str, Any] = {"at": cast(Place, loop.at), "skew": loop.skew, "sign": sign, "seed": seed}
    with progress.shown("model margins"):
        if loop.frequency is not None or isinstance(thing, rl.UncertainFrequencyData):
            if loop.classical:
                raise UsageError("--frequency", "with --classical", "the disk margin")
            points = None if loop.frequency is None else frequencies("--frequency", loop.frequency)
            result: Any = rl.disk_margin_at(thing, k, points, **options)
            text = replace(result, loop=closed.said).summary()
        elif loop.classical:
            if isinstance(thing, rl.UncertainModel):
                expected, hint = "one model", "leave --classical out for its disk margin"
                raise UsageError("--classical", "an uncertain plant", expected, hint)
            of_loop = rl.delay_classical_margins if late else rl.classical_margins
            result = of_loop(thing, k, at=options["at"], sign=sign)
            text = _classical_text(result)
        elif late and (options["at"] != "output" or thing.n_outputs > 1):
            result = rl.delay_disk_margins(thing, k, **options)
            text = _text(result)
        elif late:
            result = rl.delay_disk_margin(
                thing if k is None else thing @ k, skew=loop.skew, sign=sign, effort=effort.effort
            )
            text = replace(result, loop=closed.said).summary()
        elif isinstance(thing, rl.UncertainModel):
            result = rl.worst_case_disk_margin(thing, k, **options, **vars(effort))
            text = _worst_text(result)
        else:
            result = rl.disk_margin(thing, k, **options, **vars(effort))
            text = _text(result)
    result = replace(result, loop=closed.said)
    where = "inputs and outputs" if loop.at == "both" else f"{loop.at}s"
    kind, skew = ("classical", "") if loop.classical else ("disk", f", skew {loop.skew:g}")
    head = f"{kind} margins at the {where}, {WORDS[sign]} feedback{skew}\nloop: {loop.said(closed.said)}"
    output.finish("model margins", result, "\n".join(filter(None, (note, head, text))), feedback=WORDS[sign])


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


def _classical_text(margins: ClassicalMargins) -> str:
    rows = []
    crossings = []
    for name, margin in margins.channels.items():
        if margin.gain_margin is None or margin.phase_margin is None or margin.delay_margin is None:
            rows.append((name, "unstable", "", "", str(margin.status)))
        else:
            low, high = margin.gain_margin
            phase, delay = margin.phase_margin, margin.delay_margin
            said = _degrees(phase) if math.isfinite(phase) else "inf"
            rows.append((name, f"{_gain(low)} .. {_gain(high)}", said, f"{delay:.4g} s", str(margin.status)))
        for c in margin.gain_crossings:
            said = f"{_degrees(c.lag)} or {c.delay:.4g} s of lag to -1"
            crossings.append((name, f"{c.frequency:.6g} rad/s", "|L| = 1", said))
        for c in margin.phase_crossings:
            crossings.append((name, f"{c.frequency:.6g} rad/s", "L < 0", f"factor {_gain(c.factor)} to -1"))
    lines = [table(rows, ("loop", "gain", "phase", "delay", "status"))]
    if crossings:
        lines += ["", "crossings:", table(crossings, ("loop", "at", "where", "distance"))]
    return "\n".join(lines)


def _worst_text(margin: WorstCaseDiskMargin) -> str:
    low, high = margin.gain_margin
    rows = [
        (name, delta_value(value, "+"), stands_for(margin.physical, name, "")) for name, value in margin.delta.items()
    ]
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
    return f"{math.degrees(phase):.4g} deg"


def _polar(factor: complex) -> str:
    if cmath.isinf(factor):
        return "infinite"
    return f"{abs(factor):.6g} at {math.degrees(cmath.phase(factor)):+.4g} deg"
