"""Steps on controllers: files for other programs, feed-forward, tracking problems, comparison of controllers."""

from __future__ import annotations

import math
from collections.abc import Sequence
from fnmatch import fnmatchcase
from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import Field, model_validator
from pydantic_core import PydanticCustomError

import robustlab as rl
from robustlab.errors import InputError
from robustlab.operations.vocabulary import (
    GUARD,
    ComplementaryWeight,
    ControlWeight,
    Effort,
    ErrorWeight,
    Names,
    PerformanceWeight,
    Positive,
    RefersTo,
    TimeLimit,
    ToController,
    ToPlant,
    ToPlantOrFile,
    ToUncertainOrProblem,
)
from robustlab.recipe.steps.contract import Ahead, Fact, Inferred, Outcome, Step, Workspace, facts_of, outcome_of, step

FORMATS = (".c", ".mat", ".h5")

Sizes = Positive | dict[str, Positive]

Controllers = Annotated[list[ToController], Field(min_length=1, max_length=12)]

Outputs = Annotated[list[str], Field(min_length=1, max_length=100), Names("outputs")]


@step
class ExportStep(Step):
    """A controller for other programs: STEP.c (C99), STEP.mat and STEP.h5 in the output folder."""

    gives: ClassVar[str] = "saved"
    leaves: ClassVar[Any] = {"order": "1", "dt": "s", "sha256": {"*": str}}
    do: Literal["export"]
    of: ToController
    prefix: Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]{0,30}$")] = Field(
        "controller", description="Of every name in the C code."
    )
    saturation: dict[str, Annotated[list[float], Field(min_length=2, max_length=2)]] = Field(
        {}, description="Limits [low, high] of each control signal in the C code."
    )

    feed_forward: Annotated[str, RefersTo(("feed-forward",))] | None = Field(
        None, description="Added to a control signal in the C code, before the limits; the other files do not have it."
    )

    def run(self, work: Workspace) -> Outcome:
        from robustlab.provenance import file_sha256
        from robustlab.statespace import as_model

        given = work.values[self.of]
        K = as_model(given, self.of)
        origin = work.provenance()
        limits = {name: tuple(pair) for name, pair in self.saturation.items()} or None
        digests: dict[str, str] = {}
        for suffix in FORMATS:
            path = work.folder / f"{work.step}{suffix}"
            options: dict[str, Any] = {"prefix": self.prefix, "saturation": limits} if suffix == ".c" else {}
            if suffix == ".c" and self.feed_forward is not None:
                options["feed_forward"] = work.values[self.feed_forward]
            rl.export_controller(path, given, provenance=origin, **options)
            work.files.append(path.name)
            digests[suffix[1:]] = file_sha256(path)
        facts = (
            Fact("Sample time", f"{K.dt:g} s"),
            Fact("Measurements", ", ".join(f"{s.name} [{s.unit}]" for s in K.inputs)),
            Fact("Control signals", ", ".join(f"{s.name} [{s.unit}]" for s in K.outputs)),
            *(Fact(f"SHA-256 of {work.step}.{kind}", digest) for kind, digest in digests.items()),
        )
        if self.feed_forward is not None:
            facts += tuple(
                Fact(fact.label, fact.value, f"{work.step}.c") for fact in facts_of(work.values[self.feed_forward])
            )
        numbers = {"order": K.n_states, "dt": K.dt, "sha256": digests}
        names = ", ".join(f"{work.step}{suffix}" for suffix in FORMATS)
        return Outcome(work.folder / f"{work.step}.h5", f"{self.of} written to {names}.", numbers, facts)


@step
class FeedForwardStep(Step):
    """The input that a motion needs because of named effects, from its reference."""

    gives: ClassVar[str] = "feed-forward"
    leaves: ClassVar[Any] = {"largest": float, "waves": [float], "counts": ["1"], "dry": float, "left": float}
    do: Literal["feed-forward"]
    of: ToPlantOrFile = Field(description="A discover step, or a plant with effects.")

    def run(self, work: Workspace) -> Outcome:
        from robustlab.dynamics.extended.feed_forward import feed_forward

        found = feed_forward(work.values[self.of])
        numbers = {
            "largest": found.largest, "waves": [math.hypot(w.c, w.s) for w in found.waves],
            "counts": [w.k for w in found.waves], "dry": sum(d.level for d in found.dry), "left": found.left,
        }  # fmt: skip
        return Outcome(found, f"Feed-forward of {self.of}.", numbers, facts_of(found))


@step
class TrackingProblemStep(Step):
    """A tracking problem: references that outputs follow, disturbances, noise, and weights on error and control.

    The controller sees the references of `controlled` and the outputs `measured`. The gain of the weighted loop is at
    most 1 where every requirement holds.
    """

    gives: ClassVar[str] = "problem"
    leaves: ClassVar[Any] = {"states": "1", "blocks": [str], "channels": "1", "measurements": "1", "controls": "1"}
    do: Literal["tracking-problem"]
    of: Annotated[str, RefersTo(("plant", "model", "uncertain", "any"))]
    controlled: Outputs = Field(description='Names of outputs; "phi_*" matches all with this prefix.')
    measured: Outputs = Field(description="The same.")
    W1: Positive | ErrorWeight | PerformanceWeight | None = Field(
        None, description="On the error, as a share of the reference."
    )
    W2: Positive | ControlWeight | None = Field(None, description="On the control, in its own unit.")
    W3: Positive | ComplementaryWeight | None = Field(None, description="On the output, as a share of the reference.")
    reference: Sizes = Field(1.0, description="Size of the references in the outputs' units.")
    reference_bandwidth: Positive | None = Field(None, description="rad/s, above which references get smaller.")
    disturbance: Sizes | None = Field(None, description="Size of the disturbance at the controls, in their units.")
    loads: Annotated[dict[str, Positive], Names("inputs")] = Field(
        {}, description='Inputs of the model that are no controls, with their sizes: { "load *" = 1.0 }.'
    )
    noise: Sizes | None = Field(
        None, description='Size of the noise on the measurements, in their units: { "*_ref" = 0.1, "phi_*" = 0.1 }.'
    )

    @model_validator(mode="after")
    def _some_weight(self) -> Self:
        if self.W1 is None and self.W2 is None and self.W3 is None:
            raise PydanticCustomError("some_weight", "expected at least one of W1, W2, W3")
        return self

    def run(self, work: Workspace) -> Outcome:
        from robustlab.statespace import as_model
        from robustlab.synthesis.specifications.tracking import tracking_problem as pose
        from robustlab.synthesis.specifications.weight_design import error_weight

        given = work.values[self.of]
        G = given.uncertain() if hasattr(given, "uncertain") and hasattr(given, "with_parameters") else given
        first = error_weight if isinstance(self.W1, ErrorWeight) else rl.performance_weight
        makers = {"W1": first, "W2": rl.control_weight, "W3": rl.complementary_weight}
        base = G if hasattr(G, "blocks") else as_model(G, "tracking problem")
        inputs, outputs = ([s.name for s in side] for side in (base.inputs, base.outputs))
        controlled, measured = _matching(self.controlled, outputs), _matching(self.measured, outputs)
        loads = {k: v for k, v in _sizes_of(self.loads, inputs).items() if "*" not in k}
        problem = pose(
            G,
            controlled,
            measured,
            **{name: _weight(getattr(self, name), make) for name, make in makers.items()},
            reference=_sizes_of(self.reference, controlled),
            reference_bandwidth=self.reference_bandwidth,
            disturbance=_sizes_of(self.disturbance, [name for name in inputs if name not in loads]),
            loads=loads,
            noise=_sizes_of(self.noise, [*(f"{name}_ref" for name in controlled), *measured]),
        )
        return outcome_of(problem, problem, f"Tracking problem of {self.of}: a gain of at most 1 is required.", work)


@step
class CascadeStep(Step):
    """The two layers of L. Březina's thesis (eqs 9.1-9.4) for the linear actuator or the Stewart platform with motors.

    Of the platform it is the upper layer, whose outputs are torques; the torque loops remain in the plant.
    """

    gives: ClassVar[str] = "controller"
    leaves: ClassVar[Any] = {"order": "1", "p_up": "1/s", "p_low": "1/s"}
    do: Literal["cascade"]
    of: ToPlant
    p_up: Positive = 236.0
    p_low: Positive = 3000.0

    def run(self, work: Workspace) -> Outcome:
        from robustlab.dynamics.control.controlled_plant import actuator_cascade
        from robustlab.dynamics.control.platform import two_layer
        from robustlab.dynamics.stewart.stewart_platform import StewartPlatform

        plant = work.values[self.of]
        if isinstance(plant, StewartPlatform):
            K = two_layer(plant, self.p_up, self.p_low).upper
            what = "upper layer of the thesis, angles and rates to torques"
        else:
            K = actuator_cascade(plant, self.p_up, self.p_low)
            what = "two layers of the thesis, angle, speed and current to volts"
        numbers = {"order": K.n_states, "p_up": self.p_up, "p_low": self.p_low}
        poles = f"{self.p_up:g} and {self.p_low:g} 1/s, triple"
        facts = (Fact("Order", str(K.n_states)), Fact("Poles of the layers", poles))
        return Outcome(rl.Controller(K, method="cascade"), f"{what[:1].upper()}{what[1:]}.", numbers, facts)


@step
class RobustPerformanceStep(Step):
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

    def infer(self, ahead: Ahead) -> Inferred:
        pure = ("order", "nominal_gain", "mu_lower", "mu_upper", *(("gain_lower", "gain_upper") if self.gain else ()))
        row = {**dict.fromkeys(pure, "1"), "frequency": "rad/s"}
        return Inferred(leaves={"controllers": dict.fromkeys(self.controllers, row)})

    def run(self, work: Workspace) -> Outcome:
        from robustlab.analysis.performance import compare_performance

        loops = {name: _closed(self, work, name) for name in self.controllers}
        options: dict[str, Any] = {"effort": self.effort, "time_limit": self.time_limit, "seed": work.seed}
        found = compare_performance(loops, gain=self.gain, points=self.points, accuracy=self.accuracy, **options)
        for name, margin in found.margins.items():
            work.keep(margin, name)
        where = self.of if self.set is None else f"{self.of} on {self.set}"
        summary = f"Robust performance of {where} under {len(loops)} controllers, the same requirement for all."
        return outcome_of(found, found.margins, summary, work)


@step
class SimulateControlStep(Step):
    """A linear plant with effects under several controllers: tracking of a sine, also by members of the set."""

    gives: ClassVar[str] = "runs"
    do: Literal["simulate-control"]
    of: ToPlant
    controllers: Controllers
    controlled: Outputs
    measured: Outputs
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
    limits: Annotated[dict[str, Positive], Names("signals")] = Field(
        {}, description="Largest magnitude of a signal; compared, not clipped."
    )

    def infer(self, ahead: Ahead) -> Inferred:
        known = {**(ahead[self.of].inputs or {}), **(ahead[self.of].outputs or {})}
        plant = ahead[self.of].value
        if plant is not None:  # raises on unknown effects, places and parameters
            for member in self.members:
                plant.with_parameters(**member)
            if self.effects:
                rl.with_effects(plant, self.effects)
        unit = self.unit or known.get(self.controlled[0], float)
        row = {
            "order": "1", "largest_error": unit, "worst_error": unit, "within_limits": bool,
            "largest": {name: known.get(name, float) for name in self.limits},
        }  # fmt: skip
        return Inferred(leaves={"controllers": dict.fromkeys(self.controllers, row)})

    def run(self, work: Workspace) -> Outcome:
        from robustlab.dynamics.control.platform import follow_sine

        controllers = {name: work.values[name] for name in self.controllers}
        own = {*Step.model_fields, "do", "of", "controllers", "controlled", "measured"}
        options = {key: value for key, value in vars(self).items() if key not in own}
        found = follow_sine(work.values[self.of], controllers, self.controlled, self.measured, **options)
        return outcome_of(found, found, f"{self.of} {found.headline()}.", work)


@step
class FollowTrajectoryStep(Step):
    """The nonlinear Stewart platform under several controllers, following the path of section 9.1.3.

    With motors the controllers are upper layers with torques as outputs, above the motors' torque loops. Without, the
    machine takes their torques; it may have effects then, as after `discover`, and controllers may see angles alone.
    """

    gives: ClassVar[str] = "runs"
    do: Literal["follow-trajectory"]
    of: ToPlantOrFile
    controllers: Controllers
    p_low: Positive = Field(3000.0, description="Triple pole of the motors' torque loops in 1/s.")
    at: Annotated[list[float], Field(min_length=6, max_length=6)] | None = Field(
        None, description="Pose at which the path begins; home, the trim point of the controllers, where left out."
    )
    scale: Positive = Field(1.0, description="Of the path: at 1 a lift of 5 mm, sines of 5 mm and 20 mrad.")
    rise_time: Annotated[float, Field(ge=0)] = 0.0
    t_end: Positive = 5.0
    after: Annotated[float, Field(ge=0)] = Field(3.0, description="s from which on the errors count.")
    points: Annotated[int, Field(ge=2, le=100_000)] = 2501

    def infer(self, ahead: Ahead) -> Inferred:
        row = {
            "order": "1", "worst_error": "mm", "position_error": "m", "orientation_error": "rad",
            "nut_errors": {f"phi_{i}": "rad" for i in range(1, 7)}, "largest_torque": "N m", "largest_voltage": "V",
            "within_limits": bool, "spectral_abscissa": "1/s",
        }  # fmt: skip
        return Inferred(leaves={"controllers": dict.fromkeys(self.controllers, row)})

    def run(self, work: Workspace) -> Outcome:
        from robustlab.dynamics.control.platform import follow_path

        controllers = {name: work.values[name] for name in self.controllers}
        own = {*Step.model_fields, "do", "of", "controllers"}
        options = {key: value for key, value in vars(self).items() if key not in own}
        found = follow_path(work.values[self.of], controllers, **options)
        return outcome_of(
            found, found, f"Nonlinear simulation of {self.of} under {len(controllers)} controllers.", work
        )


def _closed(step: RobustPerformanceStep, work: Workspace, name: str) -> tuple[Any, int]:
    """Close a problem or a generalised plant with a controller; return the loop and the controller's order."""
    from robustlab.statespace import as_model
    from robustlab.synthesis.specifications.tracking import TrackingProblem

    given, K = work.values[step.of], as_model(work.values[name], name)
    if isinstance(given, TrackingProblem):
        problem = given if step.set is None else given.on(work.wanted(step.set, rl.UncertainModel))
        return problem.close(K), K.n_states
    if step.set is not None:
        raise InputError("set", f"given, but {step.of} is no tracking problem", "no set")
    return work.wanted(step.of, rl.UncertainModel).close(K), K.n_states


def _matching(names: Sequence[str], known: Sequence[str]) -> list[str]:
    """Replace each pattern by the names it matches; a pattern without a match is kept, and rejected later."""
    found: list[str] = []
    for name in names:
        found += [k for k in known if fnmatchcase(k, name)] or [name] if "*" in name else [name]
    return found


def _sizes_of(given: Any, known: Sequence[str]) -> Any:
    """Replace each pattern by the names it matches; the first pattern that matches a signal counts."""
    if not isinstance(given, dict):
        return given
    sizes: dict[str, float] = {}
    for pattern, size in given.items():
        for name in _matching([pattern], known):
            sizes.setdefault(name, size)
    return sizes


def _weight(given: Any, make: Any) -> Any:
    return given if given is None or isinstance(given, float) else make(**given.model_dump())
