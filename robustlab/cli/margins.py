"""``robustlab model margins`` and ``robustlab model gap``: disk margins of a loop, distance between two models."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, Any, Literal, cast

import typer

import robustlab as rl
from robustlab.cli.offers import one_of
from robustlab.cli.options import EffortOptions, OutputOptions, SeedOption, frequencies, grouped
from robustlab.cli.progress import ProgressOptions
from robustlab.errors import NoTrustworthyNumber, UsageError

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
    from robustlab.mu_analysis.margins.disk_margin import PLACES, Place

    if loop.at not in PLACES:
        raise UsageError(f"--at {loop.at}", "no such place", "input, output or both")
    thing: Any = rl.load(plant, transpose=transpose)
    k, asked, note = loop.read("model margins", transpose)
    closed = closing(thing, k, asked, "model margins", None if k is not None else -1)
    around: dict[str, Any] = {"at": cast(Place, loop.at), "sign": closed.sign}
    k = None if closed.K is None else silenced(closed.K, "model margins")
    with progress.shown("model margins"):
        if loop.classical:
            if loop.frequency is not None:
                raise UsageError("--frequency", "with --classical", "the disk margin")
            if isinstance(thing, rl.UncertainModel):
                expected, hint = "one model", "leave --classical out for its disk margin"
                raise UsageError("--classical", "an uncertain plant", expected, hint)
            result: Any = rl.classical_margins(closed.plant, k, **around)
        else:
            points = None if loop.frequency is None else frequencies("--frequency", loop.frequency)
            options: dict[str, Any] = {"frequency": points, "skew": loop.skew, "seed": seed, **vars(effort)}
            result = rl.disk_margin(closed.plant, k, **around, **options)
    text = replace(result, loop=loop.said(closed.said)).report()
    result = replace(result, loop=closed.said)
    output.finish("model margins", result, "\n".join(filter(None, (note, text))), feedback=WORDS[closed.sign])
