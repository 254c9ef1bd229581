"""``robustlab model discretise | d2c | d2d``: sample times."""

from __future__ import annotations

from typing import Annotated, Any

import typer

import robustlab as rl
from robustlab.cli.console import emit, note, table
from robustlab.cli.offers import FORMULAS, one_of
from robustlab.cli.options import DtOption, OutputOptions, PrewarpOption, grouped, load_model
from robustlab.cli.progress import ProgressOptions

StoredModelArgument = Annotated[str, typer.Argument(help="HDF5 or .mat file.", metavar="FILE")]
HoldOption = Annotated[
    str, typer.Option("--method", help="zoh, foh or tustin.", autocompletion=one_of("zoh", "foh", "tustin"))
]


@grouped
def discretise(
    *,
    file: StoredModelArgument,
    dt: DtOption,
    method: Annotated[
        str,
        typer.Option(help="tustin, tustin-prewarp, zoh, foh, impulse or matched.", autocompletion=one_of(*FORMULAS)),
    ] = "tustin",
    prewarp: PrewarpOption = None,
    progress: ProgressOptions,
    output: OutputOptions,
) -> None:
    """A discrete model of a continuous one, by formula.

    A model with exact delays at inputs and outputs takes zoh, which is exact.
    What a loop loses by it is what "synth discretise" computes.

    Example: robustlab model discretise motor.h5 --dt 0.001 --method zoh --out motor-1ms.h5
    """
    from robustlab.statespace import as_model
    from robustlab.synthesis.sampled.discretisation import merged_modes

    loaded = rl.load(file)
    late = isinstance(loaded, rl.DelayedModel)
    model: Any = loaded if late else as_model(loaded, file)
    method_given: Any = method
    with progress.shown("model discretise"):
        found = rl.discretise(model, dt, method_given, prewarp=prewarp)
        merged = merged_modes(model.H if late else model, dt)
    for pair in merged:
        note(f"warning: {file}: {pair}")
    rows = [("method", method), ("model", repr(found)), *output.keep_made("model discretise", found, [file])]
    emit("model discretise", {"method": method, "model": found, "pathological": merged}, table(rows), output.as_json)


@grouped
def d2c(
    *, file: StoredModelArgument, method: HoldOption = "zoh", progress: ProgressOptions, output: OutputOptions
) -> None:
    """A continuous model of a discrete one, with the error with which discretising gives it back.

    Exit code 4: there is none (a pole on the negative real axis), or digits were lost.

    Example: robustlab model d2c sampled.h5 --out plant.h5
    """
    method_given: Any = method
    with progress.shown("model d2c"):
        found = rl.d2c(load_model(file), method_given)
    output.finish_made("model d2c", found, found.model, [file])


@grouped
def d2d(
    *,
    file: StoredModelArgument,
    dt: DtOption,
    method: HoldOption = "zoh",
    progress: ProgressOptions,
    output: OutputOptions,
) -> None:
    """A discrete model with another sample time; a whole multiple needs no continuous model on the way.

    Exit code 4: there is none, or digits were lost.

    Example: robustlab model d2d fast.h5 --dt 0.01 --out slow.h5
    """
    method_given: Any = method
    with progress.shown("model d2d"):
        found = rl.d2d(load_model(file), dt, method_given)
    output.finish_made("model d2d", found, found.model, [file])
