"""Operations of controller design."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, Any, Literal

import robustlab as rl
from robustlab.errors import InputError, UsageError
from robustlab.operations.declaration import InLoop, Named, operation
from robustlab.operations.kinds import ByNumber, Number, Thing, Weight, Whole
from robustlab.operations.words import Controller, Design, Model, SampleTime, Search, Seed, Sign, Signals, System

DESIGN, HINF = "synthesis.problem.design.", "synthesis.hinf."
Plant = Annotated[Design, "Generalised plant, tracking problem, plant or uncertain model."]
K = Annotated[Any, Thing(("controller", "any"), model=True), "File with the controller."]
Channel = Annotated[Any, ByNumber()]
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

    def around(self, system: Any, K: Any, where: str, nominal: bool | None = False) -> Any:
        """Return the generalised plant of a controller; without names, its channels are the plant's last ones."""
        from robustlab.synthesis.specifications.tracking import TrackingProblem

        if (self.measurements is None) != (self.controls is None):
            raise UsageError(f"{where}: measurements, controls", "one of them", "both, or none")
        if self.measurements is not None or isinstance(system, TrackingProblem):
            return self.posed(system, where, nominal)
        return Channels(K.n_inputs, K.n_outputs).posed(system, where, nominal)


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
    "synth fixed",
    "fixed",
    result="synthesis.fixed_structure.FixedSynthesis",
    gives="controller",
    made="controller",
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
        Weight("performance_weight"),
        'On the error: a number, or "bandwidth=10,error=0.01,peak=2".',
        Named(key="W1"),
    ] = None,
    w2: Annotated[
        Any, Weight("control_weight"), 'On the control: a number, or "limit=20,bandwidth=1000".', Named(key="W2")
    ] = None,
    w3: Annotated[
        Any,
        Weight("complementary_weight"),
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


@operation("synth reduce", "reduce-controller", result="synthesis.reduction.controller_reduction.ReducedController",
      gives="controller", made="controller")  # fmt: skip
def reduce_controller(
    plant: Plant,
    controller: K,
    *,
    loss: Annotated[float, Number(least=0, most=10), "Largest loss allowed, as a share."] = 0.01,
    order: Annotated[Order, "States of the result, whatever it loses."] = None,
    measure: Annotated[Literal["hinf", "h2", "mu"], "mu: robust performance, with the plant's Delta."] = "hinf",
    channels: Channels,
    search: Search,
    progress: Any = None,
) -> Any:
    """Controller of the lowest order whose closed loop, rebuilt and proved anew, loses no more than a stated share.

    Exit code 4: no controller of that order could be verified.

    Example: robustlab synth reduce plant.h5 controller.h5 --loss 0.02 --out small.h5
    """
    P = channels.around(plant, controller, "reduce-controller", False if measure == "mu" else None)
    return rl.reduce_controller(
        P, controller, loss=loss, order=order, measure=measure, progress=progress, **vars(search)
    )


Method = Annotated[
    Literal["auto", "direct", "tustin", "tustin-prewarp", "zoh", "foh"],
    "Formula, or a design for the sampled plant.",
]


@operation("synth discretise", "discretise", result="synthesis.discretisation.SampledController",
      gives="controller", made="controller")  # fmt: skip
def discretise(
    plant: Annotated[
        Plant, "The problem or generalised plant that the controller was designed for.", Named(key="plant")
    ],
    controller: Annotated[K, Named(key="of")],
    *,
    dt: SampleTime,
    delay: Annotated[float, Number(least=0), "Computation delay in s."] = 0.0,
    method: Method = "auto",
    loss: Annotated[
        float, Number(least=0, most=100), "Share of the norm from which on auto designs for the sampled plant."
    ] = 0.1,
    channels: Channels,
    search: Search,
    progress: Any = None,
) -> Any:
    """Digital form of a controller, with the proved norm of the sampled loop, between samples too, and its loss.

    Of an uncertain plant the norm is that of the nominal loop.

    Exit code 1: the loss is above --loss. Exit code 4: no method kept the sampled loop stable.

    Example: robustlab synth discretise plant.h5 controller.h5 --dt 0.01 --out digital.h5
    """
    P = channels.around(plant, controller, "discretise")
    return rl.discretise(
        controller, dt=dt, method=method, plant=_nominal(P), delay=delay, loss=loss, progress=progress, **vars(search)
    )


def _nominal(plant: Any) -> Any:
    from robustlab.synthesis.problem.partition import GeneralizedPlant

    nominal = rl.UncertainModel(plant.model, plant.blocks).nominal
    return GeneralizedPlant(nominal, plant.n_meas, plant.n_con) if plant.blocks else plant


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
    For the loss in a closed loop see "synth discretise".

    Example: robustlab model discretise motor.h5 --dt 0.001 --method zoh --out motor-1ms.h5
    """
    from robustlab.statespace import as_model
    from robustlab.synthesis.discretisation import merged_modes

    delayed = isinstance(system, rl.DelayedModel)
    model: Any = system if delayed else as_model(system, "model discretise")
    found = rl.discretise(model, dt, method)
    return InLoop(found, notes=tuple(f"warning: {pair}" for pair in merged_modes(model.H if delayed else model, dt)))


@operation("", "close-loop", result="synthesis.specifications.tracking.ClosedLoop", gives="uncertain",
      made="model", infer=_inferred_loop)  # fmt: skip
def close_loop(system: System, controller: Controller, sign: Annotated[Sign, Named(option="--feedback")] = None) -> Any:
    """The tracking loop of a controller around a model: reference in, the controlled outputs and controls out."""
    from robustlab.synthesis.specifications.tracking import ClosedLoop, tracking_loop, with_law

    K, words = with_law(system, controller, sign)
    return ClosedLoop(tracking_loop(system, K), words)
