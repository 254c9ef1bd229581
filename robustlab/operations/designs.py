"""Operations of controller design."""

from __future__ import annotations

import fnmatch
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any, Literal

import robustlab as rl
from robustlab.errors import InputError, UsageError
from robustlab.operations.declaration import InLoop, Named, operation
from robustlab.operations.kinds import ByNumber, Keyed, Names, Number, Numbers, Sizes, Table, Thing, Weight, Whole
from robustlab.operations.words import Controller, Design, Model, Moved, SampleTime, Search, Seed, Sign, Signals, System

DESIGN, HINF = "synthesis.problem.design.", "synthesis.hinf."
Plant = Annotated[Design, "Generalised plant, tracking problem, plant or uncertain model."]
Channel = Annotated[Any, ByNumber()]
Controllers = Annotated[Any, Thing(("controller", "any"), named=True), "Steps that give controllers."]
Measured = Annotated[Channel, "Measured outputs by name, or how many of the last; a tracking problem knows its own."]
Controls = Annotated[Channel, "Control inputs by name, or how many of the last; a tracking problem knows its own."]


@dataclass(frozen=True)
class Channels:
    """The inputs and outputs of a system that a design uses."""

    measurements: Measured = None
    controls: Controls = None

    def posed(self, system: Any, where: str, nominal: bool | None = False) -> Any:
        """Return the generalised plant: of a tracking problem its own, else with channels by number or by name."""
        from robustlab.synthesis.problem.partition import as_generalized_plant
        from robustlab.synthesis.specifications.tracking import TrackingProblem

        measurements, controls = self.measurements, self.controls
        if isinstance(system, TrackingProblem):
            if measurements is not None or controls is not None:
                raise InputError("measurements or controls", "given", "neither: a tracking problem has its own")
            return system.plant if nominal is False else system.nominal
        if nominal:
            if not isinstance(system, rl.UncertainModel):
                raise InputError(f"{where}: nominal", f"a {type(system).__name__}", "an uncertain model")
            system = system.nominal
        named = [isinstance(side, list) for side in (measurements, controls)]
        if measurements is None or controls is None or any(named) != all(named):
            expected = "measurements and controls: names, or how many of the last outputs and inputs"
            raise UsageError(where, "channels are not given", expected)
        if all(named):
            return rl.generalized_plant(system, measurements, controls)
        return as_generalized_plant(system, measurements, controls, where)


Nominal = Annotated[
    bool, "Of a tracking problem or an uncertain model: at Delta = 0, without its perturbation channels."
]
# By default a tracking problem is taken at Delta = 0; all of an uncertain model's Delta counts as one full block.
NominalProblem = Annotated[
    bool | None, "At Delta = 0; left out so of a tracking problem; else all of Delta counts as one full block."
]
GammaRel = Annotated[
    float,
    Number(least=1, most=10),
    "Allowed ratio to the smallest gamma; within it the controller of lowest bandwidth is chosen.",
]
Structure = Annotated[
    str,
    "static, p, i, pi, pd, pid (one per channel), order:N, poles:-1,-20, ipd or two-layer (with :full, :diagonal, "
    ":scalar), decentralised:WORD.",
]
Order = Annotated[int | None, Whole(0, 1000)]


def _design(found: Any, system: Any = None, proved: bool = True, drawn: bool = False) -> Any:
    """Return a design, with the loop of a tracking problem against its weights where that is drawn."""
    from robustlab.synthesis.specifications.tracking import TrackingLoop, TrackingProblem

    if not drawn or not isinstance(system, TrackingProblem):
        return found
    return InLoop(found, "", (), {"functions": TrackingLoop(system, found, found.gamma if proved else None)})


# --- generalised plants -----------------------------------------------------------------------------------------------


@operation("synth hinf", "hinf", result=DESIGN + "HinfSynthesis", gives="controller", made="controller")
def hinf(
    system: Plant,
    *,
    channels: Channels,
    nominal: NominalProblem = None,
    gamma_rel: GammaRel = 1.05,
    search: Search,
    progress: Any = None,
    drawn: bool = False,
) -> Any:
    """H-infinity controller u = K y (positive feedback) of a generalised plant, verified in the loop rebuilt from K.

    Exit code 4: no controller could be verified.

    Example: robustlab synth hinf plant.h5 --measurements 1 --controls 1 --out controller.h5
    """
    P = channels.posed(system, "hinf", nominal)
    found = rl.hinf(P, gamma_rel=gamma_rel, progress=progress, **vars(search))
    return _design(found, system, drawn=drawn)


@operation("synth h2", "h2", result="synthesis.h2.H2Synthesis", gives="controller", made="controller")
def h2(
    system: Plant,
    *,
    channels: Channels,
    nominal: NominalProblem = None,
    search: Search,
    progress: Any = None,
    drawn: bool = False,
) -> Any:
    """H2 (LQG) controller u = K y (positive feedback) of a generalised plant; gamma is the verified H2 norm.

    Exit code 4: no controller could be verified, or no finite H2 norm exists.

    Example: robustlab synth h2 plant.h5 --measurements y --controls u --out controller.h5
    """
    P = channels.posed(system, "h2", nominal)
    return _design(rl.h2(P, progress=progress, **vars(search)), system, drawn=drawn)


@operation("synth dk", "dk", result="synthesis.dk.dk_iteration.DKSynthesis", gives="controller", made="controller")
def dk(
    system: Plant,
    *,
    channels: Channels,
    start: Annotated[Any, Thing(("controller", "any")), "Stabilising controller to start from."] = None,
    max_order: Annotated[Order, "Largest order of the controller."] = None,
    order_rel: Annotated[
        float,
        Number(least=0, below=1),
        "Loss of level allowed for a controller of lower order, then for one with slower poles.",
    ] = 0.01,
    search: Search,
    progress: Any = None,
    drawn: bool = False,
) -> Any:
    """Robust controller u = K y (positive feedback): makes the peak of mu small, over K and scalings together.

    The blocks of an uncertain plant are known; the other channels of w and z are the performance. gamma is an upper
    bound of mu at all frequencies. Exit code 4: no controller could be verified.

    Example: robustlab synth dk uncertain.h5 --measurements y --controls u --figure design.svg --out controller.h5
    """
    P = channels.posed(system, "dk")
    found = rl.dk(P, K0=start, max_order=max_order, order_rel=order_rel, progress=progress, **vars(search))
    return _design(found, system, proved=False, drawn=drawn)


@operation(
    "synth fixed", "fixed", result="synthesis.fixed_structure.FixedSynthesis", gives="controller", made="controller"
)
def fixed_structure(
    system: Plant,
    *,
    structure: Structure = "static",
    channels: Channels,
    nominal: Nominal = False,
    starts: Annotated[int, Whole(0, 1000), "Number of random starts."] = 3,
    seed: Seed = 0,
    search: Search,
    progress: Any = None,
    drawn: bool = False,
) -> Any:
    """Controller u = K y (positive feedback) of a given structure: the smallest norm found, verified; a local optimum.

    Of a tracking problem or an uncertain model the worst member counts, unless nominal.
    Exit code 4: no start stabilised the plant.

    Example: robustlab synth fixed plant.h5 --structure order:2 --measurements 1 --controls 1 --out controller.h5
    """
    P = channels.posed(system, "fixed", nominal)
    found = rl.fixed_structure(P, structure, starts=starts, seed=seed, progress=progress, **vars(search))
    return _design(found, system, nominal, drawn)


# --- plain models -----------------------------------------------------------------------------------------------------


@operation("synth mixsyn", "mixsyn", result=DESIGN + "HinfSynthesis", gives="controller", made="controller")
def mixsyn(
    system: Model,
    *,
    w1: Annotated[
        Any,
        Weight(("performance_weight",)),
        'On the error: a number, or "bandwidth=10,error=0.01,peak=2".',
        Named(key="W1"),
    ] = None,
    w2: Annotated[
        Any, Weight(("control_weight",)), 'On the control: a number, or "limit=20,bandwidth=1000".', Named(key="W2")
    ] = None,
    w3: Annotated[
        Any,
        Weight(("complementary_weight",)),
        'On the output: a number, or "bandwidth=100,peak=2,roll_off=0.001".',
        Named(key="W3"),
    ] = None,
    signals: Signals,
    gamma_rel: GammaRel = 1.05,
    search: Search,
    progress: Any = None,
) -> Any:
    """Mixed-sensitivity controller u = K (r - y) of a plant: makes the norm of [W1 S; W2 K S; W3 T] small, verified.

    States that are not connected to the chosen inputs and outputs are removed, with a note.
    Exit code 4: no controller could be verified.

    Example: robustlab synth mixsyn motor.h5 --outputs omega --w1 bandwidth=100,error=0.01 --w2 limit=2 --out k.h5
    """
    from robustlab.linear_analysis.structural import drop_unconnected

    model = signals.of(system)
    kept = drop_unconnected(model)
    gone = [name for name in model.state_names if name not in kept.state_names]
    notes = (f"left out, for no chosen input or output touches them: states {', '.join(gone)}",) if gone else ()
    found = rl.mixsyn(kept, w1, w2, w3, gamma_rel=gamma_rel, progress=progress, **vars(search))
    return InLoop(found, "", notes)


@operation("synth ncf", "ncf", result=f"{HINF}loop_shaping.NcfSynthesis", gives="controller", made="controller")
def ncf(
    system: Model,
    *,
    w1: Annotated[
        Any,
        Thing(("model", "any"), model=True, number=True),
        "Before the plant: a number, or a model.",
        Named(key="W1"),
    ] = None,
    w2: Annotated[
        Any,
        Thing(("model", "any"), model=True, number=True),
        "Behind the plant: a number, or a model.",
        Named(key="W2"),
    ] = None,
    signals: Signals,
    factor: Annotated[float, Number(above=1, most=100), "Back-off from the smallest gamma, above 1."] = 1.1,
) -> Any:
    """Loop shaping with normalised coprime factors: u = K y (positive feedback), gamma_min exact.

    Choose W1 and W2 so that W2 G W1 has the wanted shape. A margin (1 / gamma) above 0.25 keeps it.
    Exit code 4: no controller could be verified.

    Example: robustlab synth ncf motor.h5 --outputs omega --w1 10 --out controller.h5
    """
    return rl.ncf(signals.of(system), w1, w2, factor=factor)


# --- reduction, discretisation, the closed loop -----------------------------------------------------------------------


REDUCED: Any = {
    "result": "synthesis.reduction.model_reduction.ReducedModel", "gives": "model", "made": "model", "infer": "of"
}  # fmt: skip


@operation("model reduce", "reduce-model", calls="synthesis.reduction.model_reduction.reduce_model", **REDUCED)
def reduce_model(
    model: Model,
    order: Annotated[Order, "States of the result."] = None,
    tolerance: Annotated[
        float | None, Number(above=0), "Instead of the order: largest error, as reported.", Named(option="--max-error")
    ] = None,
    method: Annotated[
        Literal["truncation", "residualisation", "hankel", "stochastic", "coprime"],
        "stochastic: relative error; coprime: unstable modes too.",
    ] = "truncation",
    input_weight: Annotated[Any, Thing(("model", "any")), "A stable model W_i: the error is W_o (G - Gr) W_i."] = None,
    output_weight: Annotated[Any, Thing(("model", "any")), "The same for W_o."] = None,
    floor: Annotated[float, Number(least=0), "Of stochastic: gain below which errors count absolutely."] = 0.0,
) -> Any:
    """A model of lower order, with its certified error and the bound of theory.

    Modes that are not stable are kept, or reduced too with the method coprime.
    Exit code 4: the error could not be certified, or the model of that order is not stable.

    Example: robustlab model reduce plant.h5 --max-error 0.01 --out small.h5
    """


@operation("model minimal", "minimal", calls="synthesis.reduction.model_reduction.minimal", **REDUCED)
def minimal(
    model: Model,
    tolerance: Annotated[
        float | None,
        Number(above=0, below=1),
        "Singular values of the scaled staircase up to this count as zero.",
        Named(option="--rank-tolerance"),
    ] = None,
) -> Any:
    """The model without uncontrollable or unobservable modes, unstable ones too; with the certified error.

    Exit code 4: the order depends on rounding.

    Example: robustlab model minimal plant.h5 --out minimal.h5
    """


def _inferred_loop(step: Any, ahead: Any) -> Any:
    inputs, outputs = ahead[step.of].inputs, ahead[step.of].outputs
    if inputs is None or outputs is None:
        return ahead[None]
    references = {f"{name}_ref": unit for name, unit in outputs.items()}
    return replace(ahead[None], inputs=references, outputs={**outputs, **inputs})


@operation("model discretise", result="statespace.StateSpaceModel", gives="model")
def discretise_by_formula(
    system: Annotated[Any, Thing(("plant", "model", "any")), "HDF5 or .mat file."],
    dt: SampleTime,
    method: Annotated[Literal["tustin", "zoh", "foh"], "The formula."] = "tustin",
) -> Any:
    """A discrete model of a continuous one, by formula.

    A model with exact delays at inputs and outputs takes zoh, which is exact.
    For the loss in a closed loop see rl.discretise.

    Example: robustlab model discretise motor.h5 --dt 0.001 --method zoh --out motor-1ms.h5
    """
    from robustlab.statespace import as_model
    from robustlab.synthesis.discretisation import merged_modes

    delayed = isinstance(system, rl.DelayedModel)
    model: Any = system if delayed else as_model(system, "model discretise")
    found = rl.discretise(model, dt, method)
    return InLoop(found, notes=tuple(f"warning: {pair}" for pair in merged_modes(model.H if delayed else model, dt)))


# --- problems, and controllers compared -------------------------------------------------------------------------------


@operation("", "tracking-problem", result="synthesis.specifications.tracking.TrackingProblem", gives="problem")
def tracking_problem(
    system: System,
    controlled: Annotated[list[str], Names("outputs"), 'Names of outputs; "phi_*" matches all with this prefix.'],
    measured: Annotated[list[str], Names("outputs"), "The same."],
    *,
    W1: Annotated[
        Any, Weight(("performance_weight", "error_weight")), "On the error, as a share of the reference."
    ] = None,
    W2: Annotated[Any, Weight(("control_weight",)), "On the control, in its own unit."] = None,
    W3: Annotated[Any, Weight(("complementary_weight",)), "On the output, as a share of the reference."] = None,
    reference: Annotated[Any, Sizes(), "Size of the references in the outputs' units."] = 1.0,
    reference_bandwidth: Annotated[float | None, Number(above=0), "rad/s, above which references get smaller."] = None,
    disturbance: Annotated[Any, Sizes(), "Size of the disturbance at the controls, in their units."] = None,
    loads: Annotated[
        dict[str, float] | None,
        Table(Number(above=0), "inputs"),
        'Inputs of the model that are no controls, with their sizes: { "load *" = 1.0 }.',
    ] = None,
    noise: Annotated[
        Any, Sizes(), 'Size of the noise on the measurements, in their units: { "*_ref" = 0.1, "phi_*" = 0.1 }.'
    ] = None,
) -> Any:
    """A tracking problem: references that outputs follow, disturbances, noise, and weights on error and control.

    The controller sees the references of `controlled` and the outputs `measured`. The gain of the weighted loop is at
    most 1 where every requirement holds.
    """
    from robustlab.statespace import as_model
    from robustlab.synthesis.specifications.tracking import tracking_problem as pose

    G = system.uncertain() if hasattr(system, "uncertain") and hasattr(system, "with_parameters") else system
    base = G if hasattr(G, "blocks") else as_model(G, "tracking problem")
    inputs, outputs = ([s.name for s in side] for side in (base.inputs, base.outputs))
    controlled, measured = _matching(controlled, outputs), _matching(measured, outputs)
    forces = {name: size for name, size in (_sizes_of(loads, inputs) or {}).items() if "*" not in name}
    controls = [name for name in inputs if name not in forces]
    return pose(
        G, controlled, measured, W1=W1, W2=W2, W3=W3, reference=_sizes_of(reference, controlled),
        reference_bandwidth=reference_bandwidth, disturbance=_sizes_of(disturbance, controls), loads=forces,
        noise=_sizes_of(noise, [*(f"{name}_ref" for name in controlled), *measured]),
    )  # fmt: skip


def _matching(names: Sequence[str], known: Sequence[str]) -> list[str]:
    """Replace each pattern by the names it matches; a pattern without a match is kept, and rejected later."""
    return [k for name in names for k in ("*" in name and fnmatch.filter(known, name)) or [name]]


def _sizes_of(given: Any, known: Sequence[str]) -> Any:
    """Replace each pattern by the names it matches; the first pattern that matches a signal counts."""
    if not isinstance(given, dict):
        return given
    sizes: dict[str, float] = {}
    for pattern, size in given.items():
        for name in _matching([pattern], known):
            sizes.setdefault(name, size)
    return sizes


@operation("", "cascade", result="statespace.StateSpaceModel", gives="controller")
def cascade(
    plant: Annotated[Any, Thing(("plant",)), "A linear actuator, or a Stewart platform with motors."],
    p_up: Annotated[float, Number(above=0), "Triple pole of the upper layer in 1/s."] = 236.0,
    p_low: Annotated[float, Number(above=0), "Triple pole of the lower layer in 1/s."] = 3000.0,
) -> Any:
    """The two layers of L. Březina's thesis (eqs 9.1-9.4) for the linear actuator or the Stewart platform with motors.

    Of the platform it is the upper layer, whose outputs are torques; the torque loops remain in the plant.
    """
    from robustlab.dynamics.control.controlled_plant import actuator_cascade
    from robustlab.dynamics.control.platform import two_layer
    from robustlab.dynamics.stewart.stewart_platform import StewartPlatform

    platform = isinstance(plant, StewartPlatform)
    return two_layer(plant, p_up, p_low).upper if platform else actuator_cascade(plant, p_up, p_low)


@operation("", "feed-forward", result="dynamics.extended.feed_forward.FeedForward", gives="feed-forward",
           calls="dynamics.extended.feed_forward.feed_forward")  # fmt: skip
def feed_forward(plant: Moved) -> Any:
    """The input that a motion needs because of named effects, from its reference."""


@operation("", "robust-performance", result="analysis.performance.PerformanceComparison")
def compare_performance(
    system: Annotated[Any, Thing(("problem", "uncertain", "any")), "Tracking problem, or an uncertain model."],
    controllers: Controllers,
    *,
    accuracy: Annotated[float, Number(above=0, below=1), "Relative distance to the best proof."] = 1e-3,
    search: Search,
    gain: Annotated[bool, "The worst-case gain, too."] = True,
    points: Annotated[int, Whole(2, 10_000), "Frequencies of the curves in the figure."] = 120,
    seed: Seed = 0,
) -> Any:
    """Robust performance of one problem under several controllers: certified mu, worst-case gain, order."""
    from robustlab.analysis.performance import compare_performance as compared
    from robustlab.statespace import as_model

    if not hasattr(system, "close"):
        raise InputError("robust-performance", f"a {type(system).__name__}", "a tracking problem or an uncertain model")
    models = {name: as_model(K, name) for name, K in controllers.items()}
    loops = {name: (system.close(K), K.n_states) for name, K in models.items()}
    found = compared(loops, gain=gain, points=points, accuracy=accuracy, seed=seed, **vars(search))
    return InLoop(found, beside=found.margins)


RUNS = "dynamics.control.platform."


@operation("", "simulate-control", result=RUNS + "ControlledRuns", calls=RUNS + "follow_sine")
def follow_sine(
    plant: Annotated[Any, Thing(("plant",)), "A linear plant."],
    controllers: Controllers,
    controlled: Annotated[list[str], Names("outputs"), "Outputs that follow the reference."],
    measured: Annotated[list[str], Names("outputs"), "Outputs that the controllers see."],
    *,
    amplitude: Annotated[float, Number(above=0), "Of the reference, in the controlled output's unit."],
    omega: Annotated[float, Number(above=0), "Of the reference in rad/s."],
    rise_time: Annotated[float, Number(above=0), "s, in which the sine grows to its amplitude."],
    t_end: Annotated[float, Number(above=0), "End time in s."],
    after: Annotated[float, Number(least=0), "s from which on the error counts."] = 0.0,
    points: Annotated[int, Whole(2, 100_000), "Stored samples."] = 2001,
    step: Annotated[float, Number(above=0), "s between samples of the reference; it is held between them."] = 1e-4,
    effects: Annotated[
        Any,
        Keyed(dict[str, dict[str, float]]),
        'As "coulomb-friction@omega" = { Fc = 3e-3 }, "input-dead-zone@u" = { d = 0.6 }.',
    ] = None,
    members: Annotated[
        Any, Keyed(list[dict[str, float]]), "Parameters of further members of the set to simulate."
    ] = (),
    scale: Annotated[float, Number(above=0), "Factor from the controlled output to `unit`."] = 1.0,
    unit: Annotated[str, "Unit of the errors; the controlled output's if left out."] = "",
    limits: Annotated[
        dict[str, float] | None,
        Table(Number(above=0), "signals"),
        "Largest magnitude of a signal; compared, not clipped.",
    ] = None,
) -> Any:
    """A linear plant with effects under several controllers: tracking of a sine, also by members of the set."""


@operation("", "follow-trajectory", result=RUNS + "ControlledRuns", calls=RUNS + "follow_path")
def follow_path(
    plant: Moved,
    controllers: Controllers,
    *,
    p_low: Annotated[float, Number(above=0), "Triple pole of the motors' torque loops in 1/s."] = 3000.0,
    at: Annotated[
        Any, Numbers("", 6), "Pose at which the path begins; home, the trim point of the controllers, where left out."
    ] = None,
    scale: Annotated[float, Number(above=0), "Of the path: at 1 a lift of 5 mm, sines of 5 mm and 20 mrad."] = 1.0,
    rise_time: Annotated[float, Number(least=0), "s, in which the sines grow."] = 0.0,
    t_end: Annotated[float, Number(above=0), "End time in s."] = 5.0,
    after: Annotated[float, Number(least=0), "s from which on the errors count."] = 3.0,
    points: Annotated[int, Whole(2, 100_000), "Stored samples."] = 2501,
) -> Any:
    """The nonlinear Stewart platform under several controllers, following the path of section 9.1.3.

    With motors the controllers are upper layers with torques as outputs, above the motors' torque loops. Without, the
    machine takes their torques; it may have effects then, as after `discover`, and controllers may see angles alone.
    """


@operation("", "close-loop", result="synthesis.specifications.tracking.ClosedLoop", gives="uncertain",
      made="model", infer=_inferred_loop)  # fmt: skip
def close_loop(system: System, controller: Controller, sign: Annotated[Sign, Named(option="--feedback")] = None) -> Any:
    """The tracking loop of a controller around a model: reference in, the controlled outputs and controls out."""
    from robustlab.synthesis.specifications.tracking import ClosedLoop, tracking_loop, with_law

    K, words = with_law(system, controller, sign)
    return ClosedLoop(tracking_loop(system, K), words)
