"""``robustlab synth``: controllers from files; ``lqr | lqi | kalman`` take weights and noises by name."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any

import typer

import robustlab as rl
from robustlab.cli.console import emit, note, require_trust, table
from robustlab.cli.design_options import (
    ChannelOptions,
    DesignOutput,
    GaussianOptions,
    LoopChannelOptions,
    QuietDesignOutput,
    SignalOptions,
    goal_of,
    limit_of,
    number_or_model,
    weight_of,
)
from robustlab.cli.offers import FORMULAS, one_of
from robustlab.cli.options import (
    DtOption,
    EffortOptions,
    OutputOptions,
    PrewarpOption,
    SeedOption,
    assignments,
    grouped,
    load_model,
    names,
    rows_of_blocks,
)
from robustlab.cli.progress import ProgressOptions
from robustlab.errors import EXIT_REQUIREMENT_NOT_MET, UsageError

if TYPE_CHECKING:
    from robustlab.synthesis.problem.partition import GeneralizedPlant

ModelArgument = Annotated[str, typer.Argument(help="HDF5 or .mat file.", metavar="FILE")]


IntegralOption = Annotated[
    list[str] | None,
    typer.Option(
        "--integral", help="Output that is to follow, with the weight on its integrated error: NAME=VALUE; repeatable."
    ),
]
StateOption = Annotated[
    list[str] | None, typer.Option("--state-weight", help="Weight on a state, omega=100; repeatable.")
]
ControlOption = Annotated[
    list[str] | None, typer.Option("--control-weight", help="Weight on a control, u=0.1; repeatable. Else 1.")
]
ProcessOption = Annotated[
    list[str] | None,
    typer.Option("--process-noise", help="Intensity of the noise on a state or input, u=0.04; repeatable."),
]
MeasurementOption = Annotated[
    list[str] | None, typer.Option("--measurement-noise", help="The same of each output; repeatable.")
]


@grouped
def lqr(
    *,
    file: ModelArgument,
    state: StateOption = None,
    control: ControlOption = None,
    progress: ProgressOptions,
    output: OutputOptions,
) -> None:
    """State feedback u = -K x of least quadratic cost; all states are measured. --out writes K, to close with x.

    Exit code 4: no gain could be vouched for.

    Example: robustlab synth lqr motor.h5 --state-weight omega=100 --control-weight u=0.1 --out k.h5
    """
    from robustlab.synthesis.h2.named_weights import integral_weights
    from robustlab.synthesis.h2.state_feedback import gain_controller

    weights = assignments("--state-weight", state)
    if not weights:
        raise UsageError(
            "synth lqr", "no state", "--state-weight NAME=VALUE: which state is to be small, and its weight"
        )
    model = load_model(file)
    Q, R = integral_weights(model, {}, weights, assignments("--control-weight", control))
    with progress.shown("synth lqr"):
        found = rl.lqr(model, Q, R)
    output.finish_made("synth lqr", found, gain_controller(model, found), [file])


@grouped
def lqi(
    *,
    file: ModelArgument,
    integral: IntegralOption = None,
    state: StateOption = None,
    control: ControlOption = None,
    progress: ProgressOptions,
    output: OutputOptions,
) -> None:
    """State feedback with integral action: outputs follow constant references without error; the loop is rebuilt.

    All states are measured. Exit code 4: no controller could be vouched for.

    Example: robustlab synth lqi motor.h5 --integral omega=100 --control-weight u=0.1 --out k.h5
    """
    from robustlab.synthesis.h2.named_weights import integral_weights

    followed = assignments("--integral", integral)
    if not followed:
        raise UsageError("synth lqi", "no output", "--integral NAME=VALUE: which output follows, and its weight")
    model = load_model(file)
    Q, R = integral_weights(
        model, followed, assignments("--state-weight", state), assignments("--control-weight", control)
    )
    with progress.shown("synth lqi"):
        found = rl.lqi(model, Q, R, outputs=list(followed))
    output.finish_made("synth lqi", found, found.controller, [file])


@grouped
def kalman(
    *,
    file: ModelArgument,
    process: ProcessOption = None,
    measurement: MeasurementOption = None,
    progress: ProgressOptions,
    output: OutputOptions,
) -> None:
    """Steady-state Kalman filter: from inputs and measured outputs to estimated states; checked by a second equation.

    White noise; of a discrete model the numbers are variances. Exit code 4: no filter could be vouched for.

    Example: robustlab synth kalman motor.h5 --process-noise u=0.04 --measurement-noise omega=1e-4 --out filter.h5
    """
    from robustlab.synthesis.h2.named_weights import diagonal_weight, process_noise

    model = load_model(file)
    W = process_noise(model, assignments("--process-noise", process), "--process-noise")
    V = diagonal_weight(assignments("--measurement-noise", measurement), model.output_names, "--measurement-noise")
    with progress.shown("synth kalman"):
        found = rl.kalman(model, W, V)
    output.finish_made("synth kalman", found, found.estimator, [file])


app = typer.Typer(
    help="Design a controller and verify it in the loop rebuilt from it.", no_args_is_help=True, add_completion=False
)

FileArgument = Annotated[str, typer.Argument(help="HDF5 or .mat file.")]
NominalOption = Annotated[
    bool, typer.Option("--nominal", help="Of an uncertain file: without its perturbation channels, at Delta = 0.")
]
GammaRelOption = Annotated[
    float,
    typer.Option("--gamma-rel", help="Allowed ratio to the smallest gamma; within it the slowest controller wins."),
]
PlantArgument = Annotated[str, typer.Argument(help="Generalised plant: HDF5 or .mat file.", metavar="PLANT")]
ControllerArgument = Annotated[str, typer.Argument(help="Its controller: HDF5 or .mat file.", metavar="CONTROLLER")]


# --- commands --------------------------------------------------------------------------------------------------------


@app.command()
@grouped
def hinf(
    *,
    file: FileArgument,
    channels: ChannelOptions,
    nominal: NominalOption = False,
    gamma_rel: GammaRelOption = 1.05,
    effort: EffortOptions,
    output: DesignOutput,
) -> None:
    """H-infinity controller u = K y (positive feedback) of a generalised plant, verified in the loop rebuilt from K.

    Give the channels by number (--n-meas, --n-con: they come last in the file) or by name (--measurements, --controls).
    Exit code 4: no controller could be vouched for.

    Example: robustlab synth hinf plant.h5 --n-meas 1 --n-con 1 --out controller.h5
    """
    channels.check("synth hinf")
    output.check()

    plant = channels.plant("synth hinf", file, nominal)
    with output.shown("synth hinf", verbose=output.verbose) as report:
        found = rl.hinf(plant, gamma_rel=gamma_rel, **vars(effort), progress=report)
        kept = output.keep("synth hinf", found, file, report)
    output.finish("synth hinf", found, kept)


@app.command()
@grouped
def h2(
    *,
    file: FileArgument,
    channels: ChannelOptions,
    nominal: NominalOption = False,
    effort: EffortOptions,
    output: DesignOutput,
) -> None:
    """H2 (LQG) controller u = K y (positive feedback) of a generalised plant; gamma is the verified H2 norm.

    Channels as for hinf. Exit code 4: no controller could be vouched for, or no finite H2 norm exists.

    Example: robustlab synth h2 plant.h5 --measurements y --controls u --out controller.h5
    """
    channels.check("synth h2")
    output.check()

    plant = channels.plant("synth h2", file, nominal)
    with output.shown("synth h2", verbose=output.verbose) as report:
        found = rl.h2(plant, **vars(effort), progress=report)
        kept = output.keep("synth h2", found, file, report)
    output.finish("synth h2", found, kept)


@app.command()
@grouped
def ncf(
    *,
    file: FileArgument,
    w1: Annotated[str | None, typer.Option(help="Before the plant: a number or a model file.")] = None,
    w2: Annotated[str | None, typer.Option(help="Behind the plant: a number or a model file.")] = None,
    signals: SignalOptions,
    factor: Annotated[float, typer.Option(help="Back-off from the smallest gamma, above 1.")] = 1.1,
    reference_model: Annotated[
        str | None, typer.Option(help="Two degrees of freedom: what the outputs are to do, a file.")
    ] = None,
    rho: Annotated[float, typer.Option(help="With it: weight of following it, 1 to 3.")] = 1.0,
    follow: Annotated[str | None, typer.Option(help="With it: the outputs that follow: a,b; all.")] = None,
    output: QuietDesignOutput,
) -> None:
    """Loop shaping with normalised coprime factors: u = K y (positive feedback), gamma_min exact.

    Choose W1 and W2 so that W2 G W1 has the wanted shape. A margin (1 / gamma) above 0.25 keeps it.
    With a reference model the controller takes references too, u = K [r; y]. Exit code 4: no controller could be
    vouched for.

    Example: robustlab synth ncf motor.h5 --outputs omega --w1 10 --out controller.h5
    """
    output.check()
    model = signals.model(file)
    weights = [None if text is None else number_or_model(text) for text in (w1, w2)]
    if reference_model is None:
        with output.shown("synth ncf") as report:
            found = rl.ncf(model, *weights, factor=factor)
            kept = output.keep("synth ncf", found, file, report)
        output.finish("synth ncf", found, kept)
        return
    wanted, outputs = number_or_model(reference_model), None if follow is None else names(follow)
    with output.shown("synth ncf") as report:
        found = rl.ncf(model, *weights, factor=factor, reference_model=wanted, rho=rho, outputs=outputs)
        kept = output.keep("synth ncf", found, file, report)
    output.finish("synth ncf", found, kept)


@app.command()
@grouped
def lqg(*, file: FileArgument, signals: SignalOptions, weights: GaussianOptions, output: QuietDesignOutput) -> None:
    """Linear-quadratic-Gaussian controller u = K y (positive feedback), with disturbances that its filter estimates.

    Of a constant or sinusoidal disturbance nothing is left in the regulated outputs. The summary has the disk margins:
    LQG guarantees none. Exit code 4: no controller could be vouched for.

    Example: robustlab synth lqg motor.h5 --outputs omega --q 1 --r 0.1 --disturbance constant --out controller.h5
    """
    output.check()
    with output.shown("synth lqg") as report:
        found = weights.design(signals.model(file))
        kept = output.keep("synth lqg", found, file, report)
    output.finish("synth lqg", found, kept)


@app.command()
@grouped
def dk(
    *,
    file: FileArgument,
    channels: ChannelOptions,
    blocks: Annotated[
        str | None,
        typer.Option(
            help='Blocks of Delta as rows "r,c" separated by ";" (-r,0 real repeated, r,0 complex repeated, r,c full); '
            "those of the uncertain file where left out."
        ),
    ] = None,
    structure: Annotated[
        str | None, typer.Option(help="What the controller may look like, as for fixed; D-K alone then.")
    ] = None,
    starts: Annotated[int, typer.Option(help="With a structure: random starts.")] = 3,
    seed: SeedOption = 0,
    direct: Annotated[bool, typer.Option(help="Go on with direct minimisation after D-K iteration.")] = True,
    mixed: Annotated[bool, typer.Option(help="Use that real blocks are real.")] = True,
    max_order: Annotated[int | None, typer.Option(help="Largest order of the controller.")] = None,
    effort: EffortOptions,
    output: DesignOutput,
) -> None:
    """Robust controller u = K y (positive feedback): makes the peak of mu small, by D-K iteration and directly.

    Of an uncertain file the blocks are known; what they leave of w and z is the performance. gamma is an upper bound of
    mu at all frequencies. Channels as for hinf. Exit code 4: no controller could be vouched for.

    Example: robustlab synth dk uncertain.h5 --measurements y --controls u --figure design.svg --out controller.h5
    """
    channels.check("synth dk")
    output.check()
    rows = None if blocks is None else rows_of_blocks(blocks)
    from robustlab.synthesis.laws.controller_structures import structure_in_words

    plant = channels.plant("synth dk", file)
    words = None if structure is None else structure_in_words(structure, plant)
    given: dict[str, Any] = {"structure": words, "starts": starts, "seed": seed, **vars(effort)}
    with output.shown("synth dk", verbose=output.verbose) as report:
        found = rl.dk(plant, rows, direct=direct, mixed=mixed, max_order=max_order, progress=report, **given)
        kept = output.keep("synth dk", found, file, report)
    output.finish("synth dk", found, kept)


@app.command()
@grouped
def fixed(
    *,
    file: FileArgument,
    structure: Annotated[
        str,
        typer.Option(
            help="static, p, i, pi, pd, pid (one per channel), order:N, poles:-1,-20, ipd or two-layer (with :full, "
            ":diagonal, :scalar), decentralised:WORD.",
            autocompletion=one_of("static", "p", "i", "pi", "pd", "pid", "ipd", "two-layer"),
        ),
    ] = "static",
    channels: ChannelOptions,
    nominal: NominalOption = False,
    objective: Annotated[str, typer.Option(help="hinf or h2.", autocompletion=one_of("hinf", "h2"))] = "hinf",
    starts: Annotated[int, typer.Option(help="Number of random starts.")] = 3,
    seed: SeedOption = 0,
    effort: EffortOptions,
    output: DesignOutput,
) -> None:
    """Controller u = K y (positive feedback) of a given structure: the smallest norm found, verified; a local optimum.

    Of an uncertain file the worst member counts, unless --nominal. Channels as for hinf.
    Exit code 4: no start stabilised the plant.

    Example: robustlab synth fixed plant.h5 --structure order:2 --n-meas 1 --n-con 1 --out controller.h5
    """
    channels.check("synth fixed")
    output.check()
    from robustlab import fixed_structure as design
    from robustlab.synthesis.laws.controller_structures import structure_in_words

    plant = channels.plant("synth fixed", file, nominal)
    words = structure_in_words(structure, plant)
    options: dict[str, Any] = {"objective": objective, "starts": starts, "seed": seed, **vars(effort)}
    with output.shown("synth fixed", verbose=output.verbose) as report:
        found = design(plant, words, progress=report, **options)
        kept = output.keep("synth fixed", found, file, report)
    output.finish("synth fixed", found, kept)


@app.command()
@grouped
def tune(
    *,
    files: Annotated[list[str], typer.Argument(help="Plants, HDF5 or .mat files: one controller for all.")],
    structure: Annotated[
        str, typer.Option(help="As for fixed.", autocompletion=one_of("static", "pi", "pd", "pid"))
    ] = "pid",
    goal: Annotated[
        list[str] | None,
        typer.Option(help='Made small: "tracking:response_time=1,error=0.01", "gain:bound=20,inputs=noise".'),
    ] = None,
    hard: Annotated[list[str] | None, typer.Option(help='Must be met: "margin:disk=0.8,at=input".')] = None,
    limit: Annotated[
        list[str] | None,
        typer.Option("--pole-limit", help="Always kept: damping=0.5, decay=1 (1/s), bandwidth=100 (rad/s)."),
    ] = None,
    signals: SignalOptions,
    starts: Annotated[int, typer.Option(help="Number of random starts.")] = 3,
    seed: SeedOption = 0,
    effort: EffortOptions,
    output: DesignOutput,
) -> None:
    """Controller u = K (r - y) of a given structure that meets hard goals and makes the others small.

    Goals: tracking, sensitivity, gain, rejection, variance, margin, overshoot (by a proxy); each is met where its value
    is at most 1. Exit code 4: a hard goal is missed, or no controller could be vouched for.

    Example: robustlab synth tune motor.h5 --structure pi --outputs omega --goal tracking:response_time=0.1 \
    --hard margin:disk=0.8 --out controller.h5
    """
    output.check()
    from robustlab.synthesis.fixed.design_goals import goal_in_words
    from robustlab.synthesis.laws.controller_structures import structure_in_words
    from robustlab.synthesis.problem.partition import GeneralizedPlant

    models = [signals.model(file) for file in files]
    first = models[0]
    words = structure_in_words(structure, GeneralizedPlant(first, max(first.n_outputs, 1), max(first.n_inputs, 1)))
    goals: list[Any] = [goal_in_words(*goal_of(text)) for text in goal or []]
    goals += [goal_in_words(*goal_of(text), hard=True) for text in hard or []]
    goals += [limit_of(text) for text in limit or []]
    options: dict[str, Any] = {"starts": starts, "seed": seed, **vars(effort)}
    with output.shown("synth tune", verbose=output.verbose) as report:
        found = rl.tune(models, words, goals, progress=report, **options)
        kept = output.keep("synth tune", found, files[0], report)
    output.finish("synth tune", found, kept)


@app.command()
@grouped
def mixsyn(
    *,
    file: FileArgument,
    w1: Annotated[str | None, typer.Option(help='On the error: a number, or "bandwidth=10,error=0.01,peak=2".')] = None,
    w2: Annotated[str | None, typer.Option(help='On the control: a number, or "limit=20,bandwidth=1000".')] = None,
    w3: Annotated[
        str | None, typer.Option(help='On the output: a number, or "bandwidth=100,peak=2,roll_off=0.001".')
    ] = None,
    signals: SignalOptions,
    gamma_rel: GammaRelOption = 1.05,
    effort: EffortOptions,
    output: DesignOutput,
) -> None:
    """Mixed-sensitivity controller u = K (r - y) of a plant, verified in the loop rebuilt from K.

    States that the chosen inputs and outputs do not touch are left out, with a note.
    Exit code 4: no controller could be vouched for.

    Example: robustlab synth mixsyn motor.h5 --outputs omega --w1 bandwidth=100,error=0.01 --w2 limit=2 --out k.h5
    """
    from robustlab.linear_analysis.structural import drop_unconnected

    weights = (
        weight_of("--w1", w1, rl.performance_weight),
        weight_of("--w2", w2, rl.control_weight),
        weight_of("--w3", w3, rl.complementary_weight),
    )
    if all(weight is None for weight in weights):
        raise UsageError("synth mixsyn", "no weight", "at least one of --w1, --w2, --w3")
    output.check()
    model = signals.model(file)
    kept = drop_unconnected(model)
    left_out = [name for name in model.state_names if name not in kept.state_names]
    if left_out:
        note(f"left out, for no chosen input or output touches them: states {', '.join(left_out)}")
    with output.shown("synth mixsyn", verbose=output.verbose) as report:
        found = rl.mixsyn(kept, *weights, gamma_rel=gamma_rel, **vars(effort), progress=report)
        kept = output.keep("synth mixsyn", found, file, report)
    output.finish("synth mixsyn", found, kept)


@app.command()
@grouped
def reduce(
    *,
    plant: PlantArgument,
    controller: ControllerArgument,
    loss: Annotated[float, typer.Option(help="Largest loss allowed, as a share.")] = 0.01,
    order: Annotated[int | None, typer.Option(help="States of the result, whatever it loses.")] = None,
    measure: Annotated[
        str,
        typer.Option(
            help="hinf, h2, or mu (robust performance of an uncertain plant).",
            autocompletion=one_of("hinf", "h2", "mu"),
        ),
    ] = "hinf",
    channels: LoopChannelOptions,
    effort: EffortOptions,
    progress: ProgressOptions,
    output: OutputOptions,
) -> None:
    """Controller of the lowest order whose closed loop, rebuilt and proved anew, loses no more than --loss.

    Exit code 4: no controller of the order wanted could be vouched for.

    Example: robustlab synth reduce plant.h5 controller.h5 --loss 0.02 --out small.h5
    """
    K = load_model(controller)
    measure_given: Any = measure
    with progress.shown("synth reduce") as report:
        found = rl.reduce_controller(
            channels.plant(plant, K), K, loss=loss, order=order, measure=measure_given, **vars(effort), progress=report
        )
    output.finish_made("synth reduce", found, found.controller, (plant, controller))


@dataclass(frozen=True)
class SamplingOptions:
    """How a controller is made digital."""

    dt: DtOption
    method: Annotated[
        str,
        typer.Option(
            help="auto, direct, tustin, tustin-prewarp, zoh, foh, impulse or matched.",
            autocompletion=one_of("auto", "direct", *FORMULAS),
        ),
    ] = "auto"
    loss: Annotated[float, typer.Option(help="Loss from which on auto tries a direct design.")] = 0.1
    delay: Annotated[float, typer.Option(help="Computational delay in s.")] = 0.0
    antialiasing: Annotated[float | None, typer.Option(help="Corner of a filter before the sampler in rad/s.")] = None
    prewarp: PrewarpOption = None


@app.command()
@grouped
def discretise(
    *,
    plant: PlantArgument,
    controller: ControllerArgument,
    sampling: SamplingOptions,
    channels: LoopChannelOptions,
    effort: EffortOptions,
    progress: ProgressOptions,
    output: OutputOptions,
) -> None:
    """Digital controller, with the proved norm of the sampled loop, between samples too, and what it loses.

    Of an uncertain plant the norm is that of the nominal loop, and mu of robust performance is proved for the sampled
    loop as well.

    Exit code 1: it loses more than --loss. Exit code 4: no method left the sampled loop stable.

    Example: robustlab synth discretise plant.h5 controller.h5 --dt 0.01 --out digital.h5
    """
    K = load_model(controller)
    given = channels.plant(plant, K)
    robust = None
    with progress.shown("synth discretise") as report:
        found = rl.discretise(K, plant=_nominal(given), **vars(sampling), **vars(effort), progress=report)
        if given.blocks:
            robust = rl.sampled_robustness(
                given, found.K, delay=sampling.delay, antialiasing=sampling.antialiasing, **vars(effort),
                progress=report,
            )  # fmt: skip
    proved = [(f"sampled: {label}", text) for label, text in robust.facts()] if robust else []
    rows = [*found.facts(), *proved, *output.keep_made("synth discretise", found.controller, (plant, controller))]
    data = found.to_json() | ({"robustness": robust.to_json()} if robust else {})
    emit("synth discretise", data, table(rows), output.as_json)
    require_trust(found.status)
    if robust is not None:
        require_trust(robust.status)
    if found.loss > sampling.loss:
        raise typer.Exit(EXIT_REQUIREMENT_NOT_MET)


app.command()(lqr)
app.command()(lqi)
app.command()(kalman)


def _nominal(plant: GeneralizedPlant) -> GeneralizedPlant:
    """The plant at Delta = 0."""
    from robustlab.synthesis.problem.partition import GeneralizedPlant

    return GeneralizedPlant(rl.UncertainModel(plant.model, plant.blocks).nominal, plant.n_meas, plant.n_con)
