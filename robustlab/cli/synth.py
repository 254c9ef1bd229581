"""``robustlab synth``: controllers from files."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

import typer

from robustlab.cli import reduction
from robustlab.cli.console import EffortOption, JsonOption, OutOption, SeedOption, TimeLimitOption, note, status_line
from robustlab.cli.design_output import (
    Channels,
    ControlsOption,
    DisturbancesOption,
    FigureOption,
    FileArgument,
    GammaRelOption,
    MeasurementsOption,
    NConOption,
    NMeasOption,
    NominalOption,
    PerformanceOption,
    VerboseOption,
    check_target,
    finish,
    names,
    rows_of_blocks,
    weight,
)
from robustlab.errors import UsageError

if TYPE_CHECKING:
    from robustlab.statespace import StateSpaceModel

app = typer.Typer(help="Design a controller and verify it in the loop rebuilt from it.", no_args_is_help=True)


@app.command()
def hinf(
    file: FileArgument,
    n_meas: NMeasOption = None,
    n_con: NConOption = None,
    measurements: MeasurementsOption = None,
    controls: ControlsOption = None,
    disturbances: DisturbancesOption = None,
    performance: PerformanceOption = None,
    nominal: NominalOption = False,
    gamma_rel: GammaRelOption = 1.05,
    effort: EffortOption = 1.0,
    time_limit: TimeLimitOption = None,
    out: OutOption = None,
    figure: FigureOption = None,
    verbose: VerboseOption = False,
    as_json: JsonOption = False,
) -> None:
    """H-infinity controller u = K y (positive feedback) of a generalised plant, verified in the loop rebuilt from K.

    Give the channels by number (--n-meas, --n-con: they come last in the file) or by name (--measurements, --controls).
    Exit code 4: no controller could be vouched for.

    Example: robustlab synth hinf plant.h5 --n-meas 1 --n-con 1 --out controller.h5
    """
    channels = Channels("synth hinf", n_meas, n_con, measurements, controls, disturbances, performance)
    check_target(out)
    from robustlab.synthesis.hinf.hinf_synthesis import hinf as design

    plant = channels.plant(file, nominal)
    with status_line("H-infinity", verbose) as report:
        found = design(plant, gamma_rel=gamma_rel, effort=effort, time_limit=time_limit, progress=report)
    finish("synth hinf", found, file, out, figure, as_json)


@app.command()
def h2(
    file: FileArgument,
    n_meas: NMeasOption = None,
    n_con: NConOption = None,
    measurements: MeasurementsOption = None,
    controls: ControlsOption = None,
    disturbances: DisturbancesOption = None,
    performance: PerformanceOption = None,
    nominal: NominalOption = False,
    effort: EffortOption = 1.0,
    time_limit: TimeLimitOption = None,
    out: OutOption = None,
    figure: FigureOption = None,
    verbose: VerboseOption = False,
    as_json: JsonOption = False,
) -> None:
    """H2 (LQG) controller u = K y (positive feedback) of a generalised plant; gamma is the verified H2 norm.

    Channels as for hinf. Exit code 4: no controller could be vouched for, or no finite H2 norm exists.

    Example: robustlab synth h2 plant.h5 --measurements y --controls u --out controller.h5
    """
    channels = Channels("synth h2", n_meas, n_con, measurements, controls, disturbances, performance)
    check_target(out)
    from robustlab.synthesis.h2.h2_synthesis import h2 as design

    plant = channels.plant(file, nominal)
    with status_line("H2", verbose) as report:
        found = design(plant, effort=effort, time_limit=time_limit, progress=report)
    finish("synth h2", found, file, out, figure, as_json)


@app.command()
def ncf(
    file: FileArgument,
    w1: Annotated[str | None, typer.Option("--w1", help="Before the plant: a number or a model file.")] = None,
    w2: Annotated[str | None, typer.Option("--w2", help="Behind the plant: a number or a model file.")] = None,
    inputs: Annotated[str | None, typer.Option("--inputs", help="Control inputs of the model to use: a,b.")] = None,
    outputs: Annotated[str | None, typer.Option("--outputs", help="Outputs of the model to control: a,b.")] = None,
    factor: Annotated[float, typer.Option("--factor", help="Back-off from the smallest gamma, above 1.")] = 1.1,
    out: OutOption = None,
    figure: FigureOption = None,
    as_json: JsonOption = False,
) -> None:
    """Loop shaping with normalised coprime factors: u = K y (positive feedback), gamma_min exact.

    Choose W1 and W2 so that W2 G W1 has the wanted shape. A margin (1 / gamma) above 0.25 keeps it.
    Exit code 4: no controller could be vouched for.

    Example: robustlab synth ncf motor.h5 --outputs omega --w1 10 --out controller.h5
    """
    from robustlab.statespace import as_model
    from robustlab.storage import load
    from robustlab.synthesis.hinf.loop_shaping import ncf as design

    check_target(out)
    model = _selected(as_model(load(file), file), inputs, outputs)
    weights = [None if text is None else _number_or_model(text) for text in (w1, w2)]
    finish("synth ncf", design(model, *weights, factor=factor), file, out, figure, as_json)


@app.command()
def dk(
    file: FileArgument,
    n_meas: NMeasOption = None,
    n_con: NConOption = None,
    measurements: MeasurementsOption = None,
    controls: ControlsOption = None,
    disturbances: DisturbancesOption = None,
    performance: PerformanceOption = None,
    blocks: Annotated[
        str | None,
        typer.Option(
            "--blocks",
            help='Blocks of Delta as rows "r,c" separated by ";" (-r,0 real repeated, r,0 complex repeated, r,c full); '
            "those of the uncertain file where left out.",
            show_default=False,
        ),
    ] = None,
    direct: Annotated[bool, typer.Option(help="Go on with direct minimisation after D-K iteration.")] = True,
    mixed: Annotated[bool, typer.Option(help="Use that real blocks are real.")] = True,
    max_order: Annotated[int | None, typer.Option(help="Largest order of the controller.", show_default=False)] = None,
    effort: EffortOption = 1.0,
    time_limit: TimeLimitOption = None,
    out: OutOption = None,
    figure: FigureOption = None,
    verbose: VerboseOption = False,
    as_json: JsonOption = False,
) -> None:
    """Robust controller u = K y (positive feedback): makes the peak of mu small, by D-K iteration and directly.

    Of an uncertain file the blocks are known; what they leave of w and z is the performance. gamma is an upper bound of
    mu at all frequencies. Channels as for hinf. Exit code 4: no controller could be vouched for.

    Example: robustlab synth dk uncertain.h5 --measurements y --controls u --figure design.svg --out controller.h5
    """
    channels = Channels("synth dk", n_meas, n_con, measurements, controls, disturbances, performance)
    check_target(out)
    rows = None if blocks is None else rows_of_blocks(blocks)
    from robustlab.synthesis.dk.dk_iteration import dk as design

    plant = channels.plant(file)
    with status_line("D-K", verbose) as report:
        found = design(
            plant, rows, direct=direct, mixed=mixed, max_order=max_order, effort=effort, time_limit=time_limit,
            progress=report,
        )  # fmt: skip
    finish("synth dk", found, file, out, figure, as_json)


@app.command()
def fixed(
    file: FileArgument,
    structure: Annotated[
        str,
        typer.Option(
            "--structure",
            help="static, p, i, pi, pd, pid (one per channel), order:N, poles:-1,-20, ipd or two-layer (with :full, "
            ":diagonal, :scalar), decentralised:WORD.",
        ),
    ] = "static",
    n_meas: NMeasOption = None,
    n_con: NConOption = None,
    measurements: MeasurementsOption = None,
    controls: ControlsOption = None,
    disturbances: DisturbancesOption = None,
    performance: PerformanceOption = None,
    nominal: NominalOption = False,
    objective: Annotated[str, typer.Option("--objective", help="hinf or h2.")] = "hinf",
    starts: Annotated[int, typer.Option("--starts", help="Number of random starts.")] = 3,
    seed: SeedOption = 0,
    effort: EffortOption = 1.0,
    time_limit: TimeLimitOption = None,
    out: OutOption = None,
    figure: FigureOption = None,
    verbose: VerboseOption = False,
    as_json: JsonOption = False,
) -> None:
    """Controller u = K y (positive feedback) of a given structure: the smallest norm found, verified; a local optimum.

    Of an uncertain file the worst member counts, unless --nominal. Channels as for hinf.
    Exit code 4: no start stabilised the plant.

    Example: robustlab synth fixed plant.h5 --structure order:2 --n-meas 1 --n-con 1 --out controller.h5
    """
    channels = Channels("synth fixed", n_meas, n_con, measurements, controls, disturbances, performance)
    check_target(out)
    from robustlab.synthesis.fixed import fixed_structure as design
    from robustlab.synthesis.laws.controller_structures import structure_in_words

    plant = channels.plant(file, nominal)
    words = structure_in_words(structure, plant)
    options: dict[str, Any] = {"objective": objective, "starts": starts, "seed": seed}
    options |= {"effort": effort, "time_limit": time_limit}
    with status_line("fixed structure", verbose) as report:
        found = design(plant, words, progress=report, **options)
    finish("synth fixed", found, file, out, figure, as_json)


@app.command()
def mixsyn(
    file: FileArgument,
    w1: Annotated[
        str | None, typer.Option("--w1", help='On the error: a number, or "bandwidth=10,error=0.01,peak=2".')
    ] = None,
    w2: Annotated[
        str | None, typer.Option("--w2", help='On the control: a number, or "limit=20,bandwidth=1000".')
    ] = None,
    w3: Annotated[
        str | None, typer.Option("--w3", help='On the output: a number, or "bandwidth=100,peak=2,roll_off=0.001".')
    ] = None,
    inputs: Annotated[str | None, typer.Option("--inputs", help="Control inputs of the model to use: a,b.")] = None,
    outputs: Annotated[str | None, typer.Option("--outputs", help="Outputs of the model to control: a,b.")] = None,
    gamma_rel: GammaRelOption = 1.05,
    effort: EffortOption = 1.0,
    time_limit: TimeLimitOption = None,
    out: OutOption = None,
    figure: FigureOption = None,
    verbose: VerboseOption = False,
    as_json: JsonOption = False,
) -> None:
    """Mixed-sensitivity controller u = K (r - y) of a plant, verified in the loop rebuilt from K.

    States that the chosen inputs and outputs do not touch are left out, with a note.
    Exit code 4: no controller could be vouched for.

    Example: robustlab synth mixsyn motor.h5 --outputs omega --w1 bandwidth=100,error=0.01 --w2 limit=2 --out k.h5
    """
    from robustlab.statespace import as_model
    from robustlab.storage import load
    from robustlab.structural import drop_unconnected
    from robustlab.synthesis.hinf.mixed_sensitivity import mixsyn as design
    from robustlab.synthesis.specifications.weight_design import (
        complementary_weight,
        control_weight,
        performance_weight,
    )

    weights = (
        weight("--w1", w1, performance_weight),
        weight("--w2", w2, control_weight),
        weight("--w3", w3, complementary_weight),
    )
    if all(weight is None for weight in weights):
        raise UsageError("synth mixsyn", "no weight", "at least one of --w1, --w2, --w3")
    check_target(out)
    model = _selected(as_model(load(file), file), inputs, outputs)
    kept = drop_unconnected(model)
    left_out = [name for name in model.state_names if name not in kept.state_names]
    if left_out:
        note(f"left out, for no chosen input or output touches them: states {', '.join(left_out)}")
    with status_line("mixed sensitivity", verbose) as report:
        found = design(kept, *weights, gamma_rel=gamma_rel, effort=effort, time_limit=time_limit, progress=report)
    finish("synth mixsyn", found, file, out, figure, as_json)


app.command("reduce")(reduction.reduce_controller)
app.command("discretise")(reduction.discretise_controller)


def _selected(model: StateSpaceModel, inputs: str | None, outputs: str | None) -> StateSpaceModel:
    if not inputs and not outputs:
        return model
    return model.select(names(inputs) if inputs else None, names(outputs) if outputs else None)


def _number_or_model(text: str) -> StateSpaceModel | float:
    """A weight: a number, or a file with a model."""
    from robustlab.statespace import as_model
    from robustlab.storage import load

    try:
        return float(text)
    except ValueError:
        return as_model(load(text), text)
