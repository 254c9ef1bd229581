"""``robustlab model discretise | d2c | d2d | delay``, ``uncertain delays | neglected``: sample times, and delays."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

import typer

import robustlab as rl
from robustlab.cli.console import emit, note, table
from robustlab.cli.offers import FORMULAS, one_of
from robustlab.cli.options import DtOption, OutputOptions, PrewarpOption, assignments, ends, grouped, load_model
from robustlab.cli.plant import made_of, plant_or_model
from robustlab.cli.progress import ProgressOptions
from robustlab.errors import UsageError

if TYPE_CHECKING:
    from robustlab.mu_analysis.axis.margin import StabilityMargin

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


ModelArgument = Annotated[str, typer.Argument(help="Model file, name of a plant, or file.py:name.", metavar="MODEL")]
PadeOption = Annotated[int, typer.Option("--pade", help="Order of the Padé approximations.")]


@grouped
def delay_model(
    *,
    file: ModelArgument,
    inputs: Annotated[
        list[str] | None, typer.Option("--input-delay", help="Delay of an input in s, u=0.01; repeatable.")
    ] = None,
    outputs: Annotated[
        list[str] | None, typer.Option("--output-delay", help="Delay of an output in s; repeatable.")
    ] = None,
    pade: Annotated[
        int | None, typer.Option(help="Write a rational model of this order in the place of exact delays.")
    ] = None,
    output: OutputOptions,
) -> None:
    """Exact delays at the inputs and outputs of a model; of a discrete one as states.

    Example: robustlab model delay motor.h5 --input-delay u=0.01 --out late.h5
    """
    given, model = _read(file)
    units = {s.name: "s" for s in (*model.inputs, *model.outputs)}
    sides = (
        assignments(option, texts, units) for option, texts in (("--input-delay", inputs), ("--output-delay", outputs))
    )
    found: Any = rl.with_delays(model, *sides)
    if pade is not None:
        if not isinstance(found, rl.DelayedModel):
            raise UsageError("--pade", f"{file} is discrete: its delays are states", "no --pade")
        found = found.pade(pade)
    rows = [("model", repr(found)), *_written("model delay", found, output, file, given)]
    emit("model delay", {"model": found}, table(rows), output.as_json)


@grouped
def cover_delays(
    *,
    file: ModelArgument,
    inputs: Annotated[
        list[str] | None,
        typer.Option("--input-delay", help="Delay of an input in s, u=0.01, or its range, u=0.01:0.03; repeatable."),
    ] = None,
    outputs: Annotated[
        list[str] | None, typer.Option("--output-delay", help="Delay of an output in s, or its range; repeatable.")
    ] = None,
    pade: PadeOption = 3,
    weight_order: Annotated[int, typer.Option(help="Order of the weight of their error.")] = 3,
    progress: ProgressOptions,
    output: OutputOptions,
) -> None:
    """A set that holds the model with its exact delays: rational ones, and blocks for what these miss at any frequency.

    MODEL may be uncertain, or have exact delays already. What is proved of the set is proved of the model.

    Example: robustlab uncertain delays motor.h5 --input-delay u=0.005:0.015 --out set.h5
    """
    from robustlab.delays import uncertain_delays

    given, model = _read(file)
    units = {s.name: "s" for s in (*model.inputs, *model.outputs)}
    sides: list[dict[str, Any]] = []
    for option, texts in (("--input-delay", inputs), ("--output-delay", outputs)):
        whole = [text for text in texts or [] if ":" not in text.rpartition("=")[2]]
        ranged = [text for text in texts or [] if text not in whole]
        sides.append({**assignments(option, whole, units), **ends(option, ranged, units)})
    with progress.shown("uncertain delays"):
        found = uncertain_delays(model, *sides, order=pade, weight_order=weight_order)
    rows = [
        ("set", repr(found)),
        *((block.name, block.origin) for block in found.blocks),
        *_written("uncertain delays", found, output, file, given),
    ]
    emit("uncertain delays", {"set": found}, table(rows), output.as_json)


@grouped
def neglected_weight(
    *,
    delay: Annotated[float | None, typer.Option(help="Longest delay in s that is left out.")] = None,
    lag: Annotated[float | None, typer.Option(help="Longest time constant in s that is left out.")] = None,
    weight_order: Annotated[int, typer.Option(help="Order of the weight for a delay: 1 or 3.")] = 1,
    output: OutputOptions,
) -> None:
    """The weight of the relative error of a model that leaves out a delay or a lag, proved for all frequencies.

    Example: robustlab uncertain neglected --delay 0.02 --out weight.h5
    """
    from robustlab.delays.neglected import PROOFS

    if (delay is None) == (lag is None):
        raise UsageError("uncertain neglected", "--delay and --lag" if lag is not None else "neither", "one of them")
    order = weight_order if delay is not None else None
    found = rl.neglected_dynamics(delay=delay, lag=lag if delay is None else None, order=order)
    proof = PROOFS["delay" if delay is not None else "lag"]
    rows = [("weight", repr(found)), ("status", str(rl.Status.CERTIFIED)), ("proof", proof)]
    rows += output.keep_made("uncertain neglected", found, [])
    result = {"weight": found, "status": rl.Status.CERTIFIED, "proof": proof}
    emit("uncertain neglected", result, table(rows), output.as_json)


def stability_lines(model: Any) -> tuple[list[str], StabilityMargin]:
    """What ``robustlab model check`` says of a model with exact delays."""
    found = rl.robust_stability(model)
    lines = [f"  {label}: {text}" for label, text in found.facts() if text]
    return [repr(model), *lines, f"  status: {found.status}"], found


def _read(file: str) -> tuple[Any, Any]:
    """What was named, and the model of it."""
    from robustlab.dynamics import Plant

    given = plant_or_model(file, [])
    return given, rl.linearise(given) if isinstance(given, Plant) else given


def _written(command: str, found: Any, output: OutputOptions, file: str, given: Any) -> list[tuple[str, str]]:
    return output.keep_made(command, found, list(made_of(file, given)))
