"""What the commands on the members of an uncertain model share: the file, the metric, a Delta in print."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from math import isnan
from typing import Annotated, Any

import typer

import robustlab as rl
from robustlab.cli.options import names
from robustlab.doors.kinds import Number, Table
from robustlab.errors import InputError, UsageError

SHOWN_BLOCKS = 40

UncertainArgument = Annotated[str, typer.Argument(help="HDF5 file with an uncertain model.", metavar="FILE")]
InputOption = Annotated[
    list[str] | None,
    typer.Option("--input-value", help="Constant input, u=42 or u=42V; repeatable. A unit step where left out."),
]
EndOption = Annotated[float | None, typer.Option("--t-end", help="End time in s; from the nominal poles if left out.")]
PointsOption = Annotated[int, typer.Option("--points", help="Number of times, where --t-end is given.")]


@dataclass(frozen=True)
class ResponseOptions:
    """What drives a response, and its times."""

    values: InputOption = None
    t_end: EndOption = None
    points: PointsOption = 401

    def driven(self, model: rl.UncertainModel) -> dict[str, float] | None:
        """Constant inputs by name; None for the default."""
        return Table(Number()).read("--input-value", self.values, {s.name: s.unit for s in model.inputs})

    def times(self, model: rl.UncertainModel) -> Any:
        """Times from 0 on, every sample of a discrete model; None where no end was given."""
        import numpy as np

        if self.t_end is None:
            return None
        if not 0 < self.t_end < float("inf") or self.points < 2:
            found = f"--t-end {self.t_end:g} with --points {self.points}"
            raise UsageError("times", found, "a positive time and at least 2 points")
        if model.dt:
            return np.arange(round(self.t_end / model.dt) + 1) * model.dt
        return np.linspace(0.0, self.t_end, self.points)


@dataclass(frozen=True)
class MetricOptions:
    """What of a member a metric looks at."""

    outputs: Annotated[str | None, typer.Option(help="The one output to look at.")] = None
    inputs: Annotated[str | None, typer.Option(help="For norms: the one input to look from; all if left out.")] = None
    values: InputOption = None
    t_end: EndOption = None
    points: PointsOption = 401
    band: Annotated[float, typer.Option("--settling-band", help="Share of the final value that counts as settled.")] = (
        0.02
    )

    @property
    def output(self) -> str | None:
        return _only("--outputs", self.outputs)

    @property
    def from_input(self) -> str | None:
        """The input that is named."""
        return _only("--inputs", self.inputs)

    @property
    def response(self) -> ResponseOptions:
        """The part of a metric of a response."""
        return ResponseOptions(self.values, self.t_end, self.points)


def _only(option: str, text: str | None) -> str | None:
    found = names(text or "")
    if len(found) > 1:
        raise UsageError(option, f"{len(found)} names", "one: a metric looks at one signal of each side")
    return found[0] if found else None


def load_uncertain(file: str) -> rl.UncertainModel:
    """The uncertain model in a file, or an error that says what the file holds instead."""
    model = rl.load(file)
    if not isinstance(model, rl.UncertainModel):
        raise InputError(
            file, f"holds a {type(model).__name__}", "an uncertain model", "make one with: robustlab uncertain build"
        )
    return model


# --- printing --------------------------------------------------------------------------------------------------------


def named(signals: Iterable[rl.Signal]) -> list[str]:
    """Signals with their units."""
    return [f"{s.name} [{s.unit}]" if s.unit else s.name for s in signals]


def place(at: float, location: str) -> str:
    """`` at t = 0.1 s`` for 0.1 and ``t [s]``; nothing where there is no place."""
    what, _, unit = location.partition(" ")
    return f" at {what} = {at:.6g} {unit.strip('[]')}" if what and not isnan(at) else ""
