"""``robustlab lpv``: models that depend on measured parameters, their induced gain, scheduled controllers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any

import typer

import robustlab as rl
from robustlab.cli.console import emit, table
from robustlab.cli.offers import one_of
from robustlab.cli.options import EffortOptions, OutputOptions, assignments, grouped
from robustlab.cli.progress import ProgressOptions
from robustlab.errors import InputError, UsageError

app = typer.Typer(
    help="Gain scheduling: LPV models, their induced gain, scheduled controllers.", no_args_is_help=True,
    add_completion=False,
)  # fmt: skip

FileArgument = Annotated[str, typer.Argument(help="LPV or uncertain model: HDF5 file.")]
LyapunovOption = Annotated[
    str | None,
    typer.Option(
        "--lyapunov",
        help="constant or varying; both, as far as rates are bounded, where left out.",
        autocompletion=one_of("constant", "varying"),
    ),
]


@dataclass(frozen=True)
class SchedulingOptions:
    """How an uncertain model becomes an LPV model."""

    points: Annotated[
        list[str] | None,
        typer.Option("--grid", help="Number of points of a parameter, k=5; 2 where left out; repeatable."),
    ] = None
    rates: Annotated[
        list[str] | None,
        typer.Option(
            "--rate", help="Bound of a parameter's rate, NAME=0.5 per second; any where left out; repeatable."
        ),
    ] = None

    def model(self, file: str) -> rl.LPVModel:
        """The LPV model in a file, or of the uncertain one there."""
        found: Any = rl.load(file)
        rates = assignments("--rate", self.rates)
        given = assignments("--grid", self.points)
        for name, value in given.items():
            if not value.is_integer():  # nan and inf are none
                raise UsageError(f"--grid {name}={value:g}", "no whole number", "2 or more")
        counts = {name: int(value) for name, value in given.items()}
        if isinstance(found, rl.UncertainModel):
            return rl.lpv_model(found, counts, rates)
        if not isinstance(found, rl.LPVModel):
            raise InputError(file, f"a {type(found).__name__}", "an LPV or an uncertain model")
        if counts:
            raise UsageError("--grid", f"{file} has its points", "an uncertain model's file")
        return found.with_rates(**rates)


@app.command()
@grouped
def build(
    *, file: FileArgument, scheduling: SchedulingOptions, progress: ProgressOptions, output: OutputOptions
) -> None:
    """LPV model of an uncertain one: its real parameters become measured ones; what it is between the points is proved.

    Example: robustlab lpv build spring.h5 --grid k=5 --rate k=0.5 --out lpv.h5
    """
    with progress.shown("lpv build"):
        found = scheduling.model(file)
    rows = [*found.facts(), *output.keep_made("lpv build", found, [file])]
    emit("lpv build", found.to_json(), table(rows), output.as_json)


@app.command()
@grouped
def gain(
    *,
    file: FileArgument,
    scheduling: SchedulingOptions,
    lyapunov: LyapunovOption = None,
    effort: EffortOptions,
    progress: ProgressOptions,
    output: OutputOptions,
) -> None:
    """Proved bound of the induced L2 gain over all trajectories of the parameters.

    Exit code 4: none could be proved.

    Example: robustlab lpv gain lpv.h5 --rate k=0.5
    """
    model, kind = scheduling.model(file), _kind(lyapunov)
    with progress.shown("lpv gain"):
        found = rl.peak_gain(model, lyapunov=kind, **vars(effort))
    output.finish("lpv gain", found, found.report())


@app.command()
@grouped
def hinf(
    *,
    file: FileArgument,
    n_meas: Annotated[int, typer.Option(help="Number of measurements (the last outputs).")],
    n_con: Annotated[int, typer.Option(help="Number of controls (the last inputs).")],
    scheduling: SchedulingOptions,
    lyapunov: LyapunovOption = None,
    effort: EffortOptions,
    progress: ProgressOptions,
    output: OutputOptions,
) -> None:
    """Scheduled H-infinity controller u = K(rho) y (positive feedback), its loop verified by lpv gain.

    Exit code 4: no controller could be vouched for.

    Example: robustlab lpv hinf plant.h5 --n-meas 1 --n-con 1 --out controller.h5
    """
    model, kind = scheduling.model(file), _kind(lyapunov)
    with progress.shown("lpv hinf") as report:
        found = rl.hinf(model, n_meas, n_con, lyapunov=kind, **vars(effort), progress=report)
    output.finish_made("lpv hinf", found, found.controller, [file])


@app.command()
@grouped
def at(
    *,
    file: Annotated[str, typer.Argument(help="LPV model or scheduled controller: HDF5 file.")],
    values: Annotated[list[str], typer.Argument(help="Value of each parameter: NAME=VALUE.")],
    output: OutputOptions,
) -> None:
    """The model or the controller at one value of every parameter.

    Example: robustlab lpv at controller.h5 k=2.5 --out frozen.h5
    """
    from robustlab.synthesis import LPVController

    found: Any = rl.load(file)
    if not isinstance(found, (rl.LPVModel, LPVController)):
        raise InputError(file, f"a {type(found).__name__}", "an LPV model or a scheduled controller")
    model = found.at(assignments("NAME=VALUE", values))
    rows = [*model.facts(), *output.keep_made("lpv at", model, [file])]
    emit("lpv at", model.to_json(), table(rows), output.as_json)


def _kind(word: str | None) -> Any:
    if word not in (None, "constant", "varying"):
        raise UsageError("--lyapunov", f"{word!r}", "constant or varying")
    return word
