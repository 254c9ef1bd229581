"""``robustlab synth``: controllers from files."""

from __future__ import annotations

from dataclasses import dataclass
from inspect import signature
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from robustlab.cli.console import emit, note, require_trust, save_drawing, table
from robustlab.cli.offers import FORMULAS, one_of
from robustlab.cli.options import (
    DtOption,
    EffortOptions,
    JsonOption,
    OutOption,
    OutputOptions,
    PrewarpOption,
    SeedOption,
    grouped,
    names,
    rows_of_blocks,
)
from robustlab.cli.progress import ProgressOptions
from robustlab.cli.state_designs import kalman, lqi
from robustlab.errors import (
    EXIT_REQUIREMENT_NOT_MET,
    EnvironmentFault,
    InputError,
    RobustlabError,
    UsageError,
    did_you_mean,
)

if TYPE_CHECKING:
    from robustlab.statespace import StateSpaceModel
    from robustlab.synthesis.problem.design import Synthesis
    from robustlab.synthesis.problem.partition import GeneralizedPlant

app = typer.Typer(
    help="Design a controller and verify it in the loop rebuilt from it.", no_args_is_help=True, add_completion=False
)

FileArgument = Annotated[str, typer.Argument(help="HDF5 or .mat file.", show_default=False)]
NominalOption = Annotated[
    bool, typer.Option("--nominal", help="Of an uncertain file: without its perturbation channels, at Delta = 0.")
]
GammaRelOption = Annotated[
    float,
    typer.Option("--gamma-rel", help="Allowed ratio to the smallest gamma; within it the slowest controller wins."),
]
PlantArgument = Annotated[
    str, typer.Argument(help="Generalised plant: HDF5 or .mat file.", metavar="PLANT", show_default=False)
]
ControllerArgument = Annotated[
    str, typer.Argument(help="Its controller: HDF5 or .mat file.", metavar="CONTROLLER", show_default=False)
]


# --- option groups ---------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class ChannelOptions:
    """Which inputs and outputs of a file a design takes, by number or by name."""

    n_meas: Annotated[int | None, typer.Option("--n-meas", help="Number of measurements (the last outputs).")] = None
    n_con: Annotated[int | None, typer.Option("--n-con", help="Number of controls (the last inputs).")] = None
    measurements: Annotated[str | None, typer.Option("--measurements", help="Measured outputs by name: a,b.")] = None
    controls: Annotated[str | None, typer.Option("--controls", help="Control inputs by name: a,b.")] = None
    disturbances: Annotated[
        str | None,
        typer.Option("--disturbances", help="With names: the inputs w; all that are no controls where left out."),
    ] = None
    performance: Annotated[
        str | None, typer.Option("--performance", help="With names: the outputs z; all outputs where left out.")
    ] = None

    def check(self, command: str) -> None:
        """Refuse channels that are not given, or given twice."""
        by_name, by_number = (self.measurements, self.controls), (self.n_meas, self.n_con)
        named, counted = None not in by_name, None not in by_number
        halves = any(by_name) != named or any(n is not None for n in by_number) != counted
        if halves or named == counted:
            expected = "either --n-meas and --n-con, or --measurements and --controls"
            raise UsageError(command, "channels are not given", expected)
        if counted and (self.disturbances or self.performance):
            raise UsageError(command, "--disturbances or --performance", "--measurements and --controls by name, too")

    def plant(self, command: str, file: str, nominal: bool = False) -> GeneralizedPlant:
        """The generalised plant of a file."""
        from robustlab.storage import load
        from robustlab.synthesis.problem.partition import as_generalized_plant, generalized_plant
        from robustlab.uncertainty.lft import UncertainModel

        found: Any = load(file)
        if nominal:
            if not isinstance(found, UncertainModel):
                raise InputError(file, f"a {type(found).__name__}", "an uncertain model, because of --nominal")
            found = found.nominal
        if self.measurements is None or self.controls is None:
            return as_generalized_plant(found, self.n_meas, self.n_con, command)
        w, z = (None if text is None else names(text) for text in (self.disturbances, self.performance))
        return generalized_plant(found, names(self.measurements), names(self.controls), w, z)


@dataclass(frozen=True)
class LoopChannelOptions:
    """Which inputs and outputs of a plant its controller is connected to."""

    measurements: Annotated[
        str | None,
        typer.Option("--measurements", help="Measured outputs by name, a,b; the last outputs where left out."),
    ] = None
    controls: Annotated[
        str | None, typer.Option("--controls", help="Control inputs by name, a,b; the last inputs where left out.")
    ] = None

    def plant(self, file: str, K: Any) -> GeneralizedPlant:
        """The generalised plant of the file: by names, or with as many channels at the end as the controller has."""
        from robustlab.storage import load
        from robustlab.synthesis.problem.partition import as_generalized_plant, generalized_plant

        if (self.measurements is None) != (self.controls is None):
            raise UsageError("--measurements, --controls", "one of them", "both, or none")
        loaded = load(file)
        if self.measurements is None or self.controls is None:
            return as_generalized_plant(loaded, K.n_inputs, K.n_outputs, file)
        return generalized_plant(loaded, names(self.measurements), names(self.controls))


@dataclass(frozen=True)
class SignalOptions:
    """Which control inputs and outputs of a plain model are used."""

    inputs: Annotated[str | None, typer.Option("--inputs", help="Control inputs of the model to use: a,b.")] = None
    outputs: Annotated[str | None, typer.Option("--outputs", help="Outputs of the model to control: a,b.")] = None

    def model(self, file: str) -> StateSpaceModel:
        """The model in a file with these signals."""
        from robustlab.statespace import as_model
        from robustlab.storage import load

        model = as_model(load(file), file)
        if not self.inputs and not self.outputs:
            return model
        sides = (None if not text else names(text) for text in (self.inputs, self.outputs))
        return model.select(*sides)


@dataclass(frozen=True)
class DesignOutput(ProgressOptions):
    """What becomes of a design, and whether its search is told step by step."""

    out: OutOption = None
    figure: Annotated[
        str | None,
        typer.Option("--figure", help="Figures to write: NAME and NAME-..., each as SVG and PNG.", show_default=False),
    ] = None
    verbose: Annotated[bool, typer.Option("--verbose", help="A line on stderr for each step of the search.")] = False
    as_json: JsonOption = False

    def check(self) -> None:
        """Refuse, before the search, a file that could not be written after it."""
        if self.out is not None and not Path(self.out).resolve().parent.is_dir():
            raise EnvironmentFault(self.out, "no such folder", "a folder that exists")

    def finish(self, command: str, found: Synthesis, file: str) -> None:
        """Print the design, store the controller, draw, and leave with the exit code of its status."""
        from robustlab.synthesis.problem.performance_limits import limits_in_words

        limits = limits_in_words(found)
        rows = found.facts()
        rows += [("" if k else "limits of any controller", line) for k, line in enumerate(limits)]
        rows += OutputOptions(self.out).keep_made(command, found.controller, [file])
        if self.figure is not None:
            _draw(found, self.figure)
        emit(command, {**found.to_json(), "limits": limits}, table(rows), self.as_json)
        require_trust(found.status)


@dataclass(frozen=True)
class QuietDesignOutput(DesignOutput):
    """The same of a design that needs no search."""

    verbose: bool = False
    progress: str = "auto"


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
    from robustlab.synthesis.hinf.hinf_synthesis import hinf as design

    plant = channels.plant("synth hinf", file, nominal)
    with output.shown("synth hinf", verbose=output.verbose) as report:
        found = design(plant, gamma_rel=gamma_rel, **vars(effort), progress=report)
    output.finish("synth hinf", found, file)


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
    from robustlab.synthesis.h2.h2_synthesis import h2 as design

    plant = channels.plant("synth h2", file, nominal)
    with output.shown("synth h2", verbose=output.verbose) as report:
        found = design(plant, **vars(effort), progress=report)
    output.finish("synth h2", found, file)


@app.command()
@grouped
def ncf(
    *,
    file: FileArgument,
    w1: Annotated[str | None, typer.Option("--w1", help="Before the plant: a number or a model file.")] = None,
    w2: Annotated[str | None, typer.Option("--w2", help="Behind the plant: a number or a model file.")] = None,
    signals: SignalOptions,
    factor: Annotated[float, typer.Option("--factor", help="Back-off from the smallest gamma, above 1.")] = 1.1,
    reference_model: Annotated[
        str | None,
        typer.Option("--reference-model", help="Two degrees of freedom: what the outputs are to do, a file."),
    ] = None,
    rho: Annotated[float, typer.Option("--rho", help="With it: weight of following it, 1 to 3.")] = 1.0,
    follow: Annotated[str | None, typer.Option("--follow", help="With it: the outputs that follow: a,b; all.")] = None,
    output: QuietDesignOutput,
) -> None:
    """Loop shaping with normalised coprime factors: u = K y (positive feedback), gamma_min exact.

    Choose W1 and W2 so that W2 G W1 has the wanted shape. A margin (1 / gamma) above 0.25 keeps it.
    With a reference model the controller takes references too, u = K [r; y]. Exit code 4: no controller could be
    vouched for.

    Example: robustlab synth ncf motor.h5 --outputs omega --w1 10 --out controller.h5
    """
    from robustlab.synthesis.hinf.loop_shaping import ncf as design

    output.check()
    model = signals.model(file)
    weights = [None if text is None else _number_or_model(text) for text in (w1, w2)]
    if reference_model is None:
        output.finish("synth ncf", design(model, *weights, factor=factor), file)
        return
    wanted, outputs = _number_or_model(reference_model), None if follow is None else names(follow)
    found = design(model, *weights, factor=factor, reference_model=wanted, rho=rho, outputs=outputs)
    output.finish("synth ncf", found, file)


@dataclass(frozen=True)
class GaussianOptions:
    """Weights and noises of a linear-quadratic-Gaussian design: a number for all, or a,b,... for each on its own."""

    q: Annotated[str, typer.Option("--q", help="Cost of the states: a number, or one for each: a,b.")] = "1"
    r: Annotated[str, typer.Option("--r", help="Cost of the controls.")] = "1"
    w: Annotated[str, typer.Option("--w", help="Intensity of the noise on the states.")] = "1"
    v: Annotated[str, typer.Option("--v", help="Intensity of the noise on the measurements.")] = "1"
    disturbance: Annotated[
        str | None,
        typer.Option("--disturbance", help="constant, the frequency of a sinusoid in rad/s, or the file of a filter."),
    ] = None
    at: Annotated[
        str, typer.Option("--at", help="Where it adds: input or output.", autocompletion=one_of("input", "output"))
    ] = "input"
    channels: Annotated[str | None, typer.Option("--channels", help="On which of them: a,b; all.")] = None
    disturbance_noise: Annotated[str, typer.Option("--disturbance-noise", help="Intensity of its noise.")] = "1"
    regulated: Annotated[str | None, typer.Option("--regulated", help="Outputs that it must leave: a,b; all.")] = None

    def design(self, model: StateSpaceModel) -> Synthesis:
        """The design for a model."""
        import numpy as np

        from robustlab.synthesis.h2.gaussian_regulator import lqg as design

        sizes = (model.n_states, model.n_inputs, model.n_states, model.n_outputs)
        weights = [
            np.diag(np.broadcast_to(_numbers(f"--{name}", getattr(self, name), size), (size,)))
            for name, size in zip("qrwv", sizes, strict=True)
        ]
        text = self.disturbance
        given = text if text is None or text == "constant" else _number_or_model(text)
        named = [None if text is None else names(text) for text in (self.channels, self.regulated)]
        noise, at = (
            _numbers("--disturbance-noise", self.disturbance_noise),
            "output" if self.at == "output" else "input",
        )
        if self.at != at:
            raise UsageError("--at", repr(self.at), "input or output")
        return design(
            model, *weights, disturbance=given, at=at, channels=named[0], disturbance_noise=noise, regulated=named[1]
        )


@app.command()
@grouped
def lqg(*, file: FileArgument, signals: SignalOptions, weights: GaussianOptions, output: QuietDesignOutput) -> None:
    """Linear-quadratic-Gaussian controller u = K y (positive feedback), with disturbances that its filter estimates.

    Of a constant or sinusoidal disturbance nothing is left in the regulated outputs. The summary has the disk margins:
    LQG guarantees none. Exit code 4: no controller could be vouched for.

    Example: robustlab synth lqg motor.h5 --outputs omega --q 1 --r 0.1 --disturbance constant --out controller.h5
    """
    output.check()
    output.finish("synth lqg", weights.design(signals.model(file)), file)


@app.command()
@grouped
def dk(
    *,
    file: FileArgument,
    channels: ChannelOptions,
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
    from robustlab.synthesis.dk.dk_iteration import dk as design

    plant = channels.plant("synth dk", file)
    with output.shown("synth dk", verbose=output.verbose) as report:
        found = design(
            plant, rows, direct=direct, mixed=mixed, max_order=max_order, **vars(effort),
            progress=report,
        )  # fmt: skip
    output.finish("synth dk", found, file)


@app.command()
@grouped
def fixed(
    *,
    file: FileArgument,
    structure: Annotated[
        str,
        typer.Option(
            "--structure",
            help="static, p, i, pi, pd, pid (one per channel), order:N, poles:-1,-20, ipd or two-layer (with :full, "
            ":diagonal, :scalar), decentralised:WORD.",
            autocompletion=one_of("static", "p", "i", "pi", "pd", "pid", "ipd", "two-layer"),
        ),
    ] = "static",
    channels: ChannelOptions,
    nominal: NominalOption = False,
    objective: Annotated[
        str, typer.Option("--objective", help="hinf or h2.", autocompletion=one_of("hinf", "h2"))
    ] = "hinf",
    starts: Annotated[int, typer.Option("--starts", help="Number of random starts.")] = 3,
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
    output.finish("synth fixed", found, file)


@app.command()
@grouped
def mixsyn(
    *,
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
    from robustlab.structural import drop_unconnected
    from robustlab.synthesis.hinf.mixed_sensitivity import mixsyn as design
    from robustlab.synthesis.specifications.weight_design import (
        complementary_weight,
        control_weight,
        performance_weight,
    )

    weights = (
        _weight("--w1", w1, performance_weight),
        _weight("--w2", w2, control_weight),
        _weight("--w3", w3, complementary_weight),
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
        found = design(kept, *weights, gamma_rel=gamma_rel, **vars(effort), progress=report)
    output.finish("synth mixsyn", found, file)


@app.command()
@grouped
def reduce(
    *,
    plant: PlantArgument,
    controller: ControllerArgument,
    loss: Annotated[float, typer.Option("--loss", help="Largest loss allowed, as a share.")] = 0.01,
    order: Annotated[int | None, typer.Option("--order", help="States of the result, whatever it loses.")] = None,
    measure: Annotated[
        str,
        typer.Option(
            "--measure",
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
    from robustlab.statespace import as_model
    from robustlab.storage import load
    from robustlab.synthesis.reduction.controller_reduction import reduce_controller

    K = as_model(load(controller), controller)
    measure_given: Any = measure
    with progress.shown("synth reduce") as report:
        found = reduce_controller(
            channels.plant(plant, K), K, loss=loss, order=order, measure=measure_given, **vars(effort), progress=report
        )
    rows = [*found.facts(), *output.keep_made("synth reduce", found.controller, (plant, controller))]
    emit("synth reduce", found.to_json(), table(rows), output.as_json)
    require_trust(found.status)


@dataclass(frozen=True)
class SamplingOptions:
    """How a controller is made digital."""

    dt: DtOption
    method: Annotated[
        str,
        typer.Option(
            "--method",
            help="auto, direct, tustin, tustin-prewarp, zoh, foh, impulse or matched.",
            autocompletion=one_of("auto", "direct", *FORMULAS),
        ),
    ] = "auto"
    loss: Annotated[float, typer.Option("--loss", help="Loss from which on auto tries a direct design.")] = 0.1
    delay: Annotated[float, typer.Option("--delay", help="Computational delay in s.")] = 0.0
    antialiasing: Annotated[
        float | None, typer.Option("--antialiasing", help="Corner of a filter before the sampler in rad/s.")
    ] = None
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
    from robustlab.statespace import as_model
    from robustlab.storage import load
    from robustlab.synthesis.sampled.sampled_controller import discretise_controller

    K = as_model(load(controller), controller)
    given = channels.plant(plant, K)
    robust = None
    with progress.shown("synth discretise") as report:
        found = discretise_controller(_nominal(given), K=K, **vars(sampling), **vars(effort), progress=report)
        if given.blocks:
            from robustlab.synthesis.sampled.sampled_robustness import sampled_robustness

            robust = sampled_robustness(
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


app.command()(lqi)
app.command()(kalman)


# --- reading ---------------------------------------------------------------------------------------------------------


def _number_or_model(text: str) -> StateSpaceModel | float:
    """A weight: a number, or a file with a model."""
    from robustlab.statespace import as_model
    from robustlab.storage import load

    try:
        return float(text)
    except ValueError:
        return as_model(load(text), text)


def _number(where: str, text: str) -> float:
    """A number, or a usage error."""
    try:
        return float(text)
    except ValueError:
        raise UsageError(where, f"{text.strip()!r}", "a number") from None


def _numbers(option: str, text: str, most: int | None = None) -> list[float]:
    """One number, or as many as there are channels."""
    found = [_number(option, part) for part in names(text)]
    if most is not None and len(found) not in (1, most):
        raise UsageError(option, f"{len(found)} numbers", f"one, or {most}")
    return found


def _weight(option: str, text: str | None, make: Any) -> Any:
    """A number, or the weight that ``key=value,...`` specifies; None where left out."""
    if text is None:
        return None
    if "=" not in text:
        return _number(option, text)
    known = list(signature(make).parameters)
    specification: dict[str, float] = {}
    for part in names(text):
        key, _, value = part.partition("=")
        key = key.strip().replace("-", "_")
        if key not in known:
            raise UsageError(option, f"unknown word {key!r}", f"one of {', '.join(known)}", did_you_mean(key, known))
        specification[key] = _number(f"{option}: {key}", value)
    if "order" in specification and specification["order"].is_integer():
        specification["order"] = int(specification["order"])
    required = known[0]
    if required not in specification:
        raise UsageError(option, f"{required} is missing", f"at least {required}=NUMBER")
    return make(**specification)


def _nominal(plant: GeneralizedPlant) -> GeneralizedPlant:
    """The plant at Delta = 0."""
    from robustlab.synthesis.problem.partition import GeneralizedPlant
    from robustlab.uncertainty.lft import UncertainModel

    return GeneralizedPlant(UncertainModel(plant.model, plant.blocks).nominal, plant.n_meas, plant.n_con)


def _draw(found: Synthesis, figure: str) -> None:
    """Write all figures that there are of a design."""
    from robustlab.report.design_figures import pictures

    for suffix, make in pictures(found).items():
        try:
            drawing = make()
        except RobustlabError as error:
            note(f"no figure {suffix or 'of the loop'}: {error}")
            continue
        save_drawing(drawing, figure, f"-{suffix}" if suffix else "")
