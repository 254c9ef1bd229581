"""What a recipe may say about the design of controllers: problems, methods, and what is to be checked of the result."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal, Self

from pydantic import Field, model_validator
from pydantic_core import PydanticCustomError

from robustlab.recipe.vocabulary import (
    GUARD,
    ComplementaryWeight,
    ControlWeight,
    Effort,
    ErrorWeight,
    PerformanceWeight,
    Positive,
    RefersTo,
    StepBase,
    TimeLimit,
    ToController,
    ToModel,
    ToPlant,
)

__all__ = [
    "CascadeStep",
    "DesignStep",
    "DiscretiseStep",
    "DkStep",
    "ExportStep",
    "FollowTrajectoryStep",
    "FixedStep",
    "H2Step",
    "HinfStep",
    "NcfStep",
    "ReduceControllerStep",
    "RobustPerformanceStep",
    "SimulateControlStep",
    "ToDesignable",
    "ToUncertainOrProblem",
    "TrackingProblemStep",
]

ToDesignable = Annotated[str, RefersTo(("problem", "plant", "model", "uncertain", "any"))]
ToUncertainOrProblem = Annotated[str, RefersTo(("problem", "uncertain", "any"))]
Sizes = Positive | dict[str, Positive]
Controllers = Annotated[list[ToController], Field(min_length=1, max_length=12)]
Names = Annotated[list[str], Field(min_length=1, max_length=100)]
GammaRel = Annotated[float, Field(ge=1, le=10)]


class TrackingProblemStep(StepBase):
    """What a loop is asked for: references that outputs follow, disturbances, noise, and weights on error and control.

    The controller sees the references of `controlled` and the outputs `measured`. The gain of the weighted loop is at
    most 1 where every requirement holds.
    """

    gives: ClassVar[str] = "problem"
    do: Literal["tracking-problem"]
    of: Annotated[str, RefersTo(("plant", "model", "uncertain", "any"))]
    controlled: Names = Field(description='Names of outputs; "phi_*" stands for all that begin so.')
    measured: Names = Field(description="The same.")
    W1: Positive | ErrorWeight | PerformanceWeight | None = Field(
        None, description="On the error, as a share of the reference."
    )
    W2: Positive | ControlWeight | None = Field(None, description="On the control, in its own unit.")
    W3: Positive | ComplementaryWeight | None = Field(None, description="On the output, as a share of the reference.")
    reference: Sizes = Field(1.0, description="Size of the references in the outputs' units.")
    reference_bandwidth: Positive | None = Field(None, description="rad/s, above which references get smaller.")
    disturbance: Sizes | None = Field(None, description="Size of what is added to the controls, in their units.")
    loads: dict[str, Positive] = Field(
        {}, description='Inputs of the model that are no controls, with their sizes: { "load *" = 1.0 }.'
    )
    noise: Sizes | None = Field(
        None, description='Size of the noise on what is seen, in its units: { "*_ref" = 0.1, "phi_*" = 0.1 }.'
    )

    @model_validator(mode="after")
    def _some_weight(self) -> Self:
        if self.W1 is None and self.W2 is None and self.W3 is None:
            raise PydanticCustomError("some_weight", "expected at least one of W1, W2, W3")
        return self


class CascadeStep(StepBase):
    """The two layers of L. Březina's thesis (eqs 9.1-9.4) for the linear actuator or the Stewart platform with motors.

    Of the platform it is the upper layer, which asks for torques; its torque loops stay where they are.
    """

    gives: ClassVar[str] = "controller"
    do: Literal["cascade"]
    of: ToPlant
    p_up: Positive = 236.0
    p_low: Positive = 3000.0


class DesignStep(StepBase):
    """What the steps share that design a controller of a generalised plant.

    Of a tracking problem the channels are known; of any other model the controls are its last inputs, the measurements
    its last outputs.
    """

    gives: ClassVar[str] = "controller"
    of: ToDesignable
    measurements: Annotated[int, Field(ge=1)] | None = Field(None, description="Only where `of` is no problem.")
    controls: Annotated[int, Field(ge=1)] | None = Field(None, description="Only where `of` is no problem.")
    effort: Effort = Field(1.0, description="Multiple of the usual work of the search.")
    time_limit: TimeLimit | None = Field(None, description=GUARD)


class HinfStep(DesignStep):
    """H-infinity controller of a generalised plant, verified in the loop rebuilt from it."""

    do: Literal["hinf"]
    gamma_rel: GammaRel = Field(1.05, description="Allowed ratio to the smallest gamma; the slowest controller wins.")
    nominal: bool = Field(
        True, description="Of a tracking problem: the nominal plant; else all of Delta counts as one full block."
    )


class H2Step(DesignStep):
    """H2 (LQG) controller of a generalised plant; of a tracking problem, of the nominal one."""

    do: Literal["h2"]


class DkStep(DesignStep):
    """Robust controller by D-K iteration and direct minimisation; gamma bounds mu at all frequencies."""

    do: Literal["dk"]
    start: ToController | None = Field(None, description="Stabilising controller to start from.")
    direct: bool = Field(True, description="Go on with direct minimisation.")
    mixed: bool = Field(True, description="Use that real blocks are real.")
    max_order: Annotated[int, Field(ge=0, le=1000)] | None = Field(None, description="Largest order of the controller.")
    order_rel: Annotated[float, Field(ge=0, lt=1)] = Field(
        0.01, description="Loss of level allowed for a controller of lower order, then for one with slower poles."
    )


class FixedStep(DesignStep):
    """Controller of a given structure with the smallest norm found; a local optimum, verified.

    Of a tracking problem or an uncertain model the worst member counts, unless `nominal`.
    """

    do: Literal["fixed"]
    structure: Annotated[str, Field(max_length=200)] = Field(
        "static", description='static, p, i, pi, pd, pid, "order:N", "poles:-1,-20", "ipd:full", "decentralised:WORD".'
    )
    nominal: bool = Field(False, description="Of a tracking problem: the nominal plant alone.")
    objective: Literal["hinf", "h2"] = "hinf"
    starts: Annotated[int, Field(ge=0, le=1000)] = Field(3, description="Number of random starts.")


class NcfStep(StepBase):
    """Loop shaping with normalised coprime factors (u = K y, positive feedback); gamma_min is exact."""

    gives: ClassVar[str] = "controller"
    do: Literal["ncf"]
    of: ToModel
    W1: Positive | None = Field(None, description="Gain before the plant.")
    W2: Positive | None = Field(None, description="Gain behind the plant.")
    factor: Annotated[float, Field(gt=1, le=100)] = 1.1


class ReduceControllerStep(DesignStep):
    """The controller of lowest order whose verified loop is at most a stated share worse than the full one's."""

    do: Literal["reduce-controller"]
    controller: ToController
    loss: Annotated[float, Field(ge=0, le=10)] = 0.01
    order: Annotated[int, Field(ge=0, le=1000)] | None = Field(None, description="The order wanted, whatever the loss.")
    measure: Literal["hinf", "h2", "mu"] = Field("hinf", description="mu: robust performance, with the plant's Delta.")


class DiscretiseStep(StepBase):
    """The digital form of a controller, with what the sampled loop loses; robust performance is proved for it anew.

    The norm and mu are those of the continuous plant with sampler, computation delay and hold, between the samples too.
    """

    gives: ClassVar[str] = "controller"
    do: Literal["discretise"]
    of: ToController
    plant: ToDesignable = Field(description="The problem or generalised plant that the controller was designed for.")
    dt: Positive = Field(description="Sample time in s.")
    method: Literal["auto", "direct", "tustin", "tustin-prewarp", "zoh", "foh", "impulse", "matched"] = "auto"
    delay: Annotated[float, Field(ge=0)] = Field(0.0, description="Computation delay in s.")
    prewarp: Positive | None = Field(None, description="rad/s; the peak of the continuous loop where left out.")
    loss: Annotated[float, Field(ge=0, le=100)] = Field(
        0.1, description="Share of the norm from which on auto designs for the sampled plant."
    )
    antialiasing: Positive | None = Field(None, description="Corner of a filter before the sampler in rad/s.")
    effort: Effort = Field(1.0, description="Multiple of the usual work of the search and of each proof.")
    time_limit: TimeLimit | None = Field(None, description=GUARD)


class ExportStep(StepBase):
    """A controller for other programs: STEP.c (C99), STEP.json, STEP.mat and STEP.h5 in the output folder."""

    gives: ClassVar[str] = "saved"
    do: Literal["export"]
    of: ToController
    prefix: Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]{0,30}$")] = Field(
        "controller", description="Of every name in the C code."
    )
    saturation: dict[str, Annotated[list[float], Field(min_length=2, max_length=2)]] = Field(
        {}, description="Limits [low, high] of each control signal in the C code."
    )


class RobustPerformanceStep(StepBase):
    """Robust performance of one problem under several controllers: certified mu, worst-case gain, order."""

    gives: ClassVar[str] = "performance"
    do: Literal["robust-performance"]
    of: ToUncertainOrProblem
    controllers: Controllers
    accuracy: Annotated[float, Field(gt=0, lt=1)] = Field(1e-3, description="Relative distance to the best proof.")
    effort: Effort = Field(1.0, description="Multiple of the usual work, for mu and for the gain of each controller.")
    time_limit: TimeLimit | None = Field(None, description=GUARD)
    set: Annotated[str, RefersTo(("uncertain", "any"))] | None = Field(
        None, description="Of a tracking problem: another set of models to judge it on."
    )
    gain: bool = Field(True, description="The worst-case gain, too.")
    points: Annotated[int, Field(ge=2, le=10_000)] = Field(120, description="Frequencies of the curves in the figure.")


class SimulateControlStep(StepBase):
    """A linear plant with effects under several controllers: a sine is followed, members of the set included."""

    gives: ClassVar[str] = "runs"
    do: Literal["simulate-control"]
    of: ToPlant
    controllers: Controllers
    controlled: Names
    measured: Names
    amplitude: Positive = Field(description="Of the reference, in the controlled output's unit.")
    omega: Positive = Field(description="Of the reference in rad/s.")
    rise_time: Positive = Field(description="s, in which the sine grows to its amplitude.")
    t_end: Positive
    after: Annotated[float, Field(ge=0)] = Field(0.0, description="s from which on the error counts.")
    points: Annotated[int, Field(ge=2, le=100_000)] = 2001
    step: Positive = Field(1e-4, description="s between samples of the reference; it is held between them.")
    effects: dict[str, dict[str, float]] = Field(
        {}, description='As "coulomb-friction@omega" = { Fc = 3e-3 }, "input-dead-zone@u" = { d = 0.6 }.'
    )
    members: list[dict[str, float]] = Field([], description="Parameters of further members of the set to simulate.")
    scale: Positive = Field(1.0, description="Factor from the controlled output to `unit`.")
    unit: str = ""
    limits: dict[str, Positive] = Field({}, description="Largest magnitude of a signal; compared, not clipped.")


class FollowTrajectoryStep(StepBase):
    """The nonlinear Stewart platform with motors under several upper layers, following the path of section 9.1.3."""

    gives: ClassVar[str] = "runs"
    do: Literal["follow-trajectory"]
    of: ToPlant
    controllers: Controllers
    p_low: Positive = Field(3000.0, description="Triple pole of the motors' torque loops in 1/s.")
    at: Annotated[list[float], Field(min_length=6, max_length=6)] | None = Field(
        None, description="Pose at which the path begins; home, where the controllers are trimmed, where left out."
    )
    rise_time: Annotated[float, Field(ge=0)] = 0.0
    t_end: Positive = 5.0
    after: Annotated[float, Field(ge=0)] = Field(3.0, description="s from which on the errors count.")
    points: Annotated[int, Field(ge=2, le=100_000)] = 2501
