"""Operations of controller design."""

from __future__ import annotations

import fnmatch
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any, Literal

import robustlab as rl
from robustlab.errors import InputError, UsageError
from robustlab.operations.common_parameters import (
    Channel,
    Controller,
    Design,
    Model,
    Moved,
    Search,
    Seed,
    Sign,
    Signals,
    System,
)
from robustlab.operations.declaration import InLoop, operation, public
from robustlab.operations.parameter_types import (
    Choice,
    Keyed,
    Names,
    Number,
    Numbers,
    Sizes,
    Table,
    Thing,
    Weight,
    Whole,
)

DESIGN, HINF, TRACKING = "synthesis.problem.design.", "synthesis.hinf.", "synthesis.specifications.tracking."
Plant = Annotated[Design, "Generalised plant, tracking problem, plant or uncertain model."]
Controllers = Annotated[Any, Thing(("controller", "any"), named=True), "Steps that give controllers."]
Measured = Annotated[Channel, "Measured outputs: names, or how many of the last. A tracking problem defines its own."]
Controls = Annotated[Channel, "Control inputs: names, or how many of the last. A tracking problem defines its own."]


@dataclass(frozen=True)
class Channels:
    """The inputs and outputs of a system that a design uses."""

    measurements: Measured = None
    controls: Controls = None

    def posed(self, system: Any, where: str, nominal: bool | None = False) -> Any:
        """Return the generalised plant: of a tracking problem its own, else with channels by number or by name."""
        from robustlab.synthesis.problem.generalized_plant import as_generalized_plant
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
    bool | None, "Design at Delta = 0 (default for a tracking problem); else all of Delta counts as one full block."
]
GAMMA_REL = {"gamma_rel": Number(least=1, most=10)}
Structure = Annotated[
    str,
    "static, p, i, pi, pd, pid (one per channel), order:N, poles:-1,-20, ipd or two-layer (with :full, :diagonal, "
    ":scalar), decentralised:WORD.",
]
CONTROLLER: Any = {"gives": "controller", "made": "controller"}


def _design(found: Any, system: Any, proved: bool = True) -> InLoop:
    """Return a design, of a tracking problem with its loop against the weights."""
    from robustlab.synthesis.specifications.tracking import TrackingLoop, TrackingProblem

    if not isinstance(system, TrackingProblem):
        return InLoop(found)
    return InLoop(found, extras={"functions": TrackingLoop(system, found, found.gamma if proved else None)})


# --- generalised plants -----------------------------------------------------------------------------------------------


@operation(
    "synth hinf", "hinf", result=DESIGN + "HinfSynthesis", public="analysis.hinf_and_gap.hinf", kinds=GAMMA_REL,
    **CONTROLLER,
)  # fmt: skip
def hinf(system: Plant, *, channels: Channels, nominal: NominalProblem = None, **options: Any) -> Any:
    """H-infinity controller u = K y (positive feedback) of a generalised plant, verified in the loop rebuilt from K.

    Exit code 4: no controller could be verified.

    Example: robustlab synth hinf plant.h5 --measurements 1 --controls 1 --out controller.h5
    """
    return _design(rl.hinf(channels.posed(system, "hinf", nominal), **options), system)


@operation("synth h2", "h2", result="synthesis.h2.H2Synthesis", public="synthesis.h2.h2", **CONTROLLER)
def h2(system: Plant, *, channels: Channels, nominal: NominalProblem = None, **options: Any) -> Any:
    """H2 (LQG) controller u = K y (positive feedback) of a generalised plant; gamma is the verified H2 norm.

    Exit code 4: no controller could be verified, or no finite H2 norm exists.

    Example: robustlab synth h2 plant.h5 --measurements y --controls u --out controller.h5
    """
    return _design(rl.h2(channels.posed(system, "h2", nominal), **options), system)


@operation(
    "synth dk", "dk", result="synthesis.dk.dk_iteration.DKSynthesis", public="synthesis.dk.dk_iteration.dk",
    kinds={"max_order": Whole(0, 1000), "order_rel": Number(least=0, below=1)}, **CONTROLLER,
)  # fmt: skip
def dk(
    system: Plant,
    *,
    channels: Channels,
    start: Annotated[Any, Thing(("controller", "any")), "Stabilising controller to start from."] = None,
    **options: Any,
) -> Any:
    """Robust controller u = K y (positive feedback): makes the peak of mu small, over K and scalings together.

    The blocks of an uncertain plant are known; the other channels of w and z are the performance. gamma is an upper
    bound of mu at all frequencies. Exit code 4: no controller could be verified.

    Example: robustlab synth dk uncertain.h5 --measurements y --controls u --figure design.svg --out controller.h5
    """
    return _design(rl.dk(channels.posed(system, "dk"), K0=start, **options), system, proved=False)


@operation(
    "synth fixed", "fixed", result="synthesis.fixed_structure.FixedSynthesis",
    public="synthesis.fixed_structure.fixed_structure", **CONTROLLER,
)  # fmt: skip
def fixed_structure(
    system: Plant,
    *,
    structure: Structure = "static",
    channels: Channels,
    nominal: Nominal = False,
    starts: Annotated[int, Whole(0, 1000), "Number of random starts."] = 3,
    **options: Any,
) -> Any:
    """Controller u = K y (positive feedback) of a given structure: the smallest norm found, verified; a local optimum.

    Of a tracking problem or an uncertain model the worst member counts, unless nominal.
    Exit code 4: no start stabilised the plant.

    Example: robustlab synth fixed plant.h5 --structure order:2 --measurements 1 --controls 1 --out controller.h5
    """
    found = rl.fixed_structure(channels.posed(system, "fixed", nominal), structure, starts=starts, **options)
    return _design(found, system, nominal)


# --- plain models -----------------------------------------------------------------------------------------------------


@operation(
    "synth mixsyn", "mixsyn", result=DESIGN + "HinfSynthesis", public=f"{HINF}loop_shaping.mixsyn", kinds=GAMMA_REL,
    **CONTROLLER,
)  # fmt: skip
def mixsyn(
    system: Model,
    *,
    w1: Annotated[
        Any, Weight(("performance_weight",), key="W1"), 'On the error: a number, or "bandwidth=10,error=0.01,peak=2".'
    ] = None,
    w2: Annotated[
        Any, Weight(("control_weight",), key="W2"), 'On the control: a number, or "limit=20,bandwidth=1000".'
    ] = None,
    w3: Annotated[
        Any, Weight(("complementary_weight",), key="W3"), 'On the output: "bandwidth=100,peak=2,roll_off=0.001".'
    ] = None,
    signals: Signals,
    **options: Any,
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
    return InLoop(rl.mixsyn(kept, w1, w2, w3, **options), "", notes)


@operation(
    "synth ncf", "ncf", result=f"{HINF}loop_shaping.NcfSynthesis", public=f"{HINF}loop_shaping.ncf",
    kinds={"factor": Number(above=1, most=100)}, **CONTROLLER,
)  # fmt: skip
def ncf(
    system: Model,
    *,
    w1: Annotated[
        Any, Thing(("model", "any"), model=True, number=True, key="W1"), "Before the plant: a number, or a model."
    ] = None,
    w2: Annotated[
        Any, Thing(("model", "any"), model=True, number=True, key="W2"), "Behind the plant: a number, or a model."
    ] = None,
    signals: Signals,
    **options: Any,
) -> Any:
    """Loop shaping with normalised coprime factors: u = K y (positive feedback), gamma_min exact.

    Choose W1 and W2 so that W2 G W1 has the wanted shape. A margin (1 / gamma) above 0.25 keeps it.
    Exit code 4: no controller could be verified.

    Example: robustlab synth ncf motor.h5 --outputs omega --w1 10 --out controller.h5
    """
    return rl.ncf(signals.of(system), w1, w2, **options)


# --- reduction, discretisation, the closed loop -----------------------------------------------------------------------


REDUCTION, WEIGHT = "synthesis.reduction.model_reduction.", Thing(("model", "any"))
REDUCED: Any = {"result": REDUCTION + "ReducedModel", "gives": "model", "made": "model", "infer": ("of", "of")}

public(
    f"{REDUCTION}reduce_model", "model reduce", "reduce-model", **REDUCED,
    kinds={
        "model": Model, "order": Whole(0, 1000), "tolerance": Number(above=0, option="--max-error"),
        "method": Choice(("truncation", "residualisation", "hankel", "stochastic", "coprime")),
        "input_weight": (WEIGHT, "A stable model W_i: the error is W_o (G - Gr) W_i."),
        "output_weight": (WEIGHT, "The same for W_o."), "floor": Number(least=0),
    },
    text="""Modes that are not stable are kept, or reduced too with the method coprime.
Exit code 4: the error could not be certified, or the model of that order is not stable.

Example: robustlab model reduce plant.h5 --max-error 0.01 --out small.h5""",
)  # fmt: skip
public(
    f"{REDUCTION}minimal", "model minimal", "minimal", **REDUCED,
    kinds={"model": Model, "tolerance": Number(above=0, below=1, option="--rank-tolerance")},
    text="""Exit code 4: the order depends on rounding.

Example: robustlab model minimal plant.h5 --out minimal.h5""",
)  # fmt: skip


def _inferred_loop(step: Any, ahead: Any) -> Any:
    inputs, outputs = ahead[step.of].inputs, ahead[step.of].outputs
    if inputs is None or outputs is None:
        return ahead[None]
    references = {f"{name}_ref": unit for name, unit in outputs.items()}
    return replace(ahead[None], inputs=references, outputs={**outputs, **inputs})


@operation("model discretise", result="statespace.StateSpaceModel", gives="model")
def discretise_by_formula(
    system: Annotated[Any, Thing(("plant", "model", "any")), "HDF5 or .mat file."],
    dt: Annotated[float, Number(above=0), "Sample time in s."],
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


@operation(
    "", "tracking-problem", result=f"{TRACKING}TrackingProblem", gives="problem", public=f"{TRACKING}tracking_problem",
    kinds={
        "W1": (Weight(("performance_weight", "error_weight")), "On the error, as a share of the reference."),
        "W2": (Weight(("control_weight",)), "On the control, in its own unit."),
        "W3": (Weight(("complementary_weight",)), "On the output, as a share of the reference."),
        "reference_bandwidth": (Number(above=0), "rad/s, above which references get smaller."),
    },
)  # fmt: skip
def tracking_problem(
    system: System,
    controlled: Annotated[list[str], Names("outputs"), 'Names of outputs; "phi_*" matches all with this prefix.'],
    measured: Annotated[list[str], Names("outputs"), "The same."],
    *,
    reference: Annotated[Any, Sizes(), "Size of the references in the outputs' units."] = 1.0,
    disturbance: Annotated[Any, Sizes(), "Size of the disturbance at the controls, in their units."] = None,
    loads: Annotated[
        dict[str, float] | None,
        Table(Number(above=0), "inputs"),
        'Inputs of the model that are no controls, with their sizes: { "load *" = 1.0 }.',
    ] = None,
    noise: Annotated[
        Any, Sizes(), 'Size of the noise on the measurements, in their units: { "*_ref" = 0.1, "phi_*" = 0.1 }.'
    ] = None,
    **options: Any,
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
        G, controlled, measured, reference=_sizes_of(reference, controlled), loads=forces,
        disturbance=_sizes_of(disturbance, controls),
        noise=_sizes_of(noise, [*(f"{name}_ref" for name in controlled), *measured]), **options,
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


public(
    "dynamics.extended.feed_forward.feed_forward", "", "feed-forward", gives="feed-forward",
    result="dynamics.extended.feed_forward.FeedForward", kinds={"plant": Moved, "sigmas": None},
    text="It is the input that a motion needs because of the effects, from its reference.",
)  # fmt: skip


@operation(
    "", "robust-performance", result="analysis.performance.PerformanceComparison",
    public="analysis.performance.compare_performance",
    kinds={
        "gain": "The worst-case gain, too.", "points": (Whole(2, 10_000), "Frequencies of the curves in the figure."),
        "accuracy": (Number(above=0, below=1), "Relative distance to the best proof."),
    },
)  # fmt: skip
def compare_performance(
    system: Annotated[Any, Thing(("problem", "uncertain", "any")), "Tracking problem, or an uncertain model."],
    controllers: Controllers,
    *,
    search: Search,
    seed: Seed = 0,
    **options: Any,
) -> Any:
    """Robust performance of one problem under several controllers: certified mu, worst-case gain, order."""
    from robustlab.analysis.performance import compare_performance as compared
    from robustlab.statespace import as_model

    if not hasattr(system, "close"):
        raise InputError("robust-performance", f"a {type(system).__name__}", "a tracking problem or an uncertain model")
    models = {name: as_model(K, name) for name, K in controllers.items()}
    loops = {name: (system.close(K), K.n_states) for name, K in models.items()}
    found = compared(loops, seed=seed, **vars(search), **options)
    return InLoop(found, extras=found.margins)


RUNS, POSITIVE = "dynamics.control.platform.", Number(above=0)

public(
    RUNS + "follow_sine", "", "simulate-control", result=RUNS + "ControlledRuns",
    kinds={
        "plant": (Thing(("plant",)), "A linear plant."), "controllers": Controllers,
        "controlled": (Names("outputs"), "Outputs that follow the reference."),
        "measured": (Names("outputs"), "Outputs that the controllers see."),
        "amplitude": (POSITIVE, "Of the reference, in the controlled output's unit."),
        "omega": (POSITIVE, "Of the reference in rad/s."),
        "rise_time": (POSITIVE, "s, in which the sine grows to its amplitude."),
        "t_end": (POSITIVE, "End time in s."),
        "after": (Number(least=0), "s from which on the error counts."),
        "points": (Whole(2, 100_000), "Stored samples."),
        "step": (POSITIVE, "s between samples of the reference; it is held between them."),
        "effects": (
            Keyed(dict[str, dict[str, float]]),
            'As "coulomb-friction@omega" = { Fc = 3e-3 }, "input-dead-zone@u" = { d = 0.6 }.',
        ),
        "members": (Keyed(list[dict[str, float]]), "Parameters of further members of the set to simulate."),
        "scale": (POSITIVE, "Factor from the controlled output to `unit`."),
        "unit": "Unit of the errors; the controlled output's if left out.",
        "limits": (Table(POSITIVE, "signals"), "Largest magnitude of a signal; compared, not clipped."),
    },
)  # fmt: skip
public(
    RUNS + "follow_path", "", "follow-trajectory", result=RUNS + "ControlledRuns",
    kinds={
        "plant": Moved, "controllers": Controllers,
        "p_low": (POSITIVE, "Triple pole of the motors' torque loops in 1/s."),
        "at": (Numbers("", 6), "Pose at the start; home, the trim point of the controllers, where left out."),
        "scale": (POSITIVE, "Of the path: at 1 a lift of 5 mm, sines of 5 mm and 20 mrad."),
        "rise_time": (Number(least=0), "s, in which the sines grow."),
        "t_end": (POSITIVE, "End time in s."),
        "after": (Number(least=0), "s from which on the errors count."),
        "points": (Whole(2, 100_000), "Stored samples."),
    },
    text="""With motors the controllers are upper layers with torques as outputs, above the motors' torque loops.
Without, the machine takes their torques; it may have effects then, as after `discover`, and controllers may see angles
alone.""",
)  # fmt: skip


@operation("", "close-loop", result=f"{TRACKING}ClosedLoop", gives="uncertain",
      made="model", infer=_inferred_loop)  # fmt: skip
def close_loop(system: System, controller: Controller, sign: Sign = None) -> Any:
    """The tracking loop of a controller around a model: reference in, the controlled outputs and controls out."""
    from robustlab.synthesis.specifications.tracking import ClosedLoop, tracking_loop, with_law

    K, words = with_law(system, controller, sign)
    return ClosedLoop(tracking_loop(system, K), words)
