"""Operations on controllers and models: reduction, discretisation, the closed loop."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, Any

import robustlab as rl
from robustlab.errors import UsageError
from robustlab.operations.declaration import InLoop, Named, operation
from robustlab.operations.designs import Channels, Controls, K, Measured, Of, Order, Plant
from robustlab.operations.kinds import Choice, Number, Thing
from robustlab.operations.words import Controller, SampleTime, Search, Sign, System


@dataclass(frozen=True)
class LoopChannels:
    """The inputs and outputs of a plant that its controller is connected to."""

    measurements: Measured = None
    controls: Controls = None

    def around(self, system: Any, K: Any, where: str, nominal: bool | None = False) -> Any:
        """Return the generalised plant of a controller; without names, its channels are the plant's last ones."""
        from robustlab.synthesis.specifications.tracking import TrackingProblem

        if (self.measurements is None) != (self.controls is None):
            raise UsageError(f"{where}: measurements, controls", "one of them", "both, or none")
        if self.measurements is not None or isinstance(system, TrackingProblem):
            return Channels(self.measurements, self.controls).posed(system, where, nominal)
        return Channels(K.n_inputs, K.n_outputs).posed(system, where, nominal)


@operation("synth reduce", "reduce-controller", result="synthesis.reduction.controller_reduction.ReducedController",
      gives="controller", made="controller")  # fmt: skip
def reduce_controller(
    plant: Plant,
    controller: K,
    *,
    loss: Annotated[float, Number(least=0, most=10), "Largest loss allowed, as a share."] = 0.01,
    order: Annotated[Order, "States of the result, whatever it loses."] = None,
    measure: Annotated[Any, Choice(("hinf", "h2", "mu")), "mu: robust performance, with the plant's Delta."] = "hinf",
    channels: LoopChannels,
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
    Any,
    Choice(("auto", "direct", "tustin", "tustin-prewarp", "zoh", "foh")),
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
    antialiasing: Annotated[float | None, Number(above=0), "Corner of a filter before the sampler in rad/s."] = None,
    prewarp: Annotated[
        float | None, Number("rad/s", above=0), "rad/s; the peak of the continuous loop where left out."
    ] = None,
    method: Method = "auto",
    loss: Annotated[
        float, Number(least=0, most=100), "Share of the norm from which on auto designs for the sampled plant."
    ] = 0.1,
    channels: LoopChannels,
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
        controller, dt=dt, method=method, plant=_nominal(P), delay=delay, antialiasing=antialiasing, prewarp=prewarp,
        loss=loss, progress=progress, **vars(search),
    )  # fmt: skip


def _nominal(plant: Any) -> Any:
    from robustlab.synthesis.problem.partition import GeneralizedPlant

    nominal = rl.UncertainModel(plant.model, plant.blocks).nominal
    return GeneralizedPlant(nominal, plant.n_meas, plant.n_con) if plant.blocks else plant


@operation("model reduce", "reduce-model", result="synthesis.reduction.model_reduction.ReducedModel", gives="model",
      made="model", infer="of")  # fmt: skip
def reduce_model(
    system: Of,
    order: Annotated[Order, "States of the result."] = None,
    tolerance: Annotated[
        float | None,
        Number(above=0),
        "Instead of the order: largest error, as reported.",
        Named(option="--max-error"),
    ] = None,
    method: Annotated[
        Any,
        Choice(("truncation", "residualisation", "hankel", "stochastic", "coprime")),
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
    return rl.reduce_model(
        system, order, tolerance=tolerance, method=method, floor=floor, input_weight=input_weight,
        output_weight=output_weight,
    )  # fmt: skip


@operation("model minimal", "minimal", result="synthesis.reduction.model_reduction.ReducedModel", gives="model",
      made="model", infer="of")  # fmt: skip
def minimal(
    system: Of,
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
    return rl.minimal(system, tolerance=tolerance)


def _inferred_loop(step: Any, ahead: Any) -> Any:
    inputs, outputs = ahead[step.of].inputs, ahead[step.of].outputs
    if inputs is None or outputs is None:
        return ahead[None]
    references = {f"{name}_ref": unit for name, unit in outputs.items()}
    return replace(ahead[None], inputs=references, outputs={**outputs, **inputs})


@operation("model discretise", result="statespace.StateSpaceModel", gives="model")
def discretise_by_formula(
    system: Annotated[Any, Thing(("plant", "model", "any")), "HDF5 or .mat file.", Named(key="of")],
    dt: SampleTime,
    method: Annotated[Any, Choice(("tustin", "tustin-prewarp", "zoh", "foh")), "The formula."] = "tustin",
    prewarp: Annotated[
        float | None, Number("rad/s", above=0), "Of tustin-prewarp: frequency in rad/s where it is exact."
    ] = None,
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
    found = rl.discretise(model, dt, method, prewarp=prewarp)
    return InLoop(found, notes=tuple(f"warning: {pair}" for pair in merged_modes(model.H if delayed else model, dt)))


@operation("", "close-loop", result="synthesis.specifications.tracking.ClosedLoop", gives="uncertain",
      made="model", infer=_inferred_loop)  # fmt: skip
def close_loop(
    system: Annotated[System, Named(key="of")],
    controller: Controller,
    sign: Annotated[Sign, Named(option="--feedback")] = None,
) -> Any:
    """The tracking loop of a controller around a model: reference in, the controlled outputs and controls out."""
    from robustlab.synthesis.specifications.tracking import ClosedLoop, tracking_loop, with_law

    K, words = with_law(system, controller, sign)
    return ClosedLoop(tracking_loop(system, K), words)
