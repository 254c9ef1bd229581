"""What a recipe may say (format ``robustlab.recipe/1``): one small model per kind of step, one for a requirement.

The JSON Schema made from these models is committed as ``recipes/recipe.schema.json``, so that an editor can complete
and check recipes.
"""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import Field, model_validator
from pydantic_core import PydanticCustomError

from robustlab.recipe.control_schema import (
    CascadeStep,
    DiscretiseStep,
    DkStep,
    ExportStep,
    FixedStep,
    FollowTrajectoryStep,
    H2Step,
    HinfStep,
    NcfStep,
    ReduceControllerStep,
    RobustPerformanceStep,
    SimulateControlStep,
    TrackingProblemStep,
)
from robustlab.recipe.story_schema import DataCoverStep, StoryStep
from robustlab.recipe.uncertainty_schema import CoverModelsStep, UncertainFromStep, WithLoadsStep
from robustlab.recipe.vocabulary import (
    GUARD,
    ComplementaryWeight,
    ControlWeight,
    Count,
    Effort,
    FileName,
    NumberOrPair,
    PerformanceWeight,
    Points,
    Positive,
    PriorTolerance,
    ReferenceLine,
    RelativeTolerance,
    StepBase,
    StepName,
    Strict,
    Text,
    TimeLimit,
    ToAnything,
    ToController,
    Tolerance,
    ToModel,
    ToOneModel,
    ToPlant,
    ToRecord,
    ToSaved,
    ToUncertain,
)

__all__ = ["SCHEMA", "Recipe", "Requirement", "Step", "json_schema"]

SCHEMA = "robustlab.recipe/1"


# --- models ----------------------------------------------------------------------------------------------------------


class PlantStep(StepBase):
    """A plant from physics."""

    gives: ClassVar[str] = "plant"
    do: Literal["plant"]
    plant: str = Field(description='Name of the plant, for example "dc-motor".')
    parameters: dict[str, NumberOrPair] = Field(
        {}, description='Values in SI units, [value, relative tolerance], or texts: "0.5 mH", "10%".'
    )
    choices: dict[str, str | bool | list[float]] = Field(
        {}, description='What is no single number: preset = "physical", motors = true, m = [1.0, 2.0] for a chain.'
    )

    @model_validator(mode="after")
    def _named_once(self) -> Self:
        twice = sorted(set(self.parameters) & set(self.choices))
        if twice:
            raise PydanticCustomError("named_once", "{name} is among parameters and choices", {"name": twice[0]})
        return self


class LineariseStep(StepBase):
    """The linear state-space model of a plant; states that the kept outputs do not show are left out."""

    gives: ClassVar[str] = "model"
    do: Literal["linearise"]
    of: ToPlant
    at: Annotated[list[float], Field(min_length=6, max_length=6)] | None = Field(
        None, description="Pose of a mechanism: tx, ty, tz in m, ax, ay, az in rad; home where left out."
    )
    outputs: list[str] | None = None


class LoadStep(StepBase):
    """A model from an HDF5 file: a path, or the file that an earlier step saved."""

    gives: ClassVar[str] = "any"
    do: Literal["load"]
    path: Text | None = None
    saved: ToSaved | None = None

    @model_validator(mode="after")
    def _one_source(self) -> Self:
        if (self.path is None) == (self.saved is None):
            raise PydanticCustomError("one_source", "expected either path or saved")
        return self


class SaveStep(StepBase):
    """Write the object of an earlier step to an HDF5 file in the output folder."""

    gives: ClassVar[str] = "saved"
    do: Literal["save"]
    of: ToAnything
    file: FileName


class StructuralStep(StepBase):
    """Controllability and observability."""

    do: Literal["structural"]
    of: ToModel


class SteadyStateStep(StepBase):
    """Outputs in steady state under constant inputs; inputs left out are zero."""

    do: Literal["steady-state"]
    of: ToModel
    inputs: dict[str, float]
    outputs: list[str] | None = None


class UncertainStep(StepBase):
    """An uncertain model of a plant: each parameter in `tolerances` varies by that share of its value, 0.05 or "5%"."""

    gives: ClassVar[str] = "uncertain"
    do: Literal["uncertain"]
    of: ToPlant
    tolerances: Annotated[dict[str, RelativeTolerance], Field(min_length=1)]
    outputs: list[str] | None = None


class ElementwiseStep(StepBase):
    """An uncertain model from a nominal model and the same model perturbed as far as it may go."""

    gives: ClassVar[str] = "uncertain"
    do: Literal["elementwise"]
    nominal: ToModel
    perturbed: ToModel
    structure: Literal["elements", "columns", "rows", "matrices", "single", "cover"] = Field(
        "elements", description="cover: a full block for each matrix, which holds every element-wise member."
    )


# --- analysis --------------------------------------------------------------------------------------------------------


class DrivenStep(StepBase):
    """What the steps share that drive a model: a step of `input` at t = 0, plus a `sine` of `frequency`."""

    input: dict[str, float] = Field({}, description="Amplitude of the step on each input.")
    sine: dict[str, float] = Field({}, description="Amplitude of the sine on each input.")
    frequency: Positive | None = Field(None, description="Frequency of the sine in Hz.")

    @model_validator(mode="after")
    def _sine_has_a_frequency(self) -> Self:
        if bool(self.sine) != (self.frequency is not None):
            raise PydanticCustomError("sine", "sine and frequency belong together")
        return self


class ResponseStep(DrivenStep):
    """What the steps that simulate responses share; they are watched until `t_end`."""

    of: ToUncertain
    t_end: Positive
    points: Points = 401
    seed: Annotated[int, Field(ge=0)] | None = Field(None, description="The recipe's seed where left out.")

    @model_validator(mode="after")
    def _is_driven(self) -> Self:
        if not self.input and not self.sine:
            raise PydanticCustomError("driven", "expected input, or sine with frequency")
        return self


class SampleStep(ResponseStep):
    """Responses of random members of an uncertain model and of vertices of Delta, with their envelope."""

    do: Literal["sample"]
    n: Count = 20
    vertices: Count = 0
    reference: list[ReferenceLine] = Field([])
    outputs: Annotated[list[str], Field(min_length=1)] | None = Field(None, description="All where left out.")
    percent: float | None = Field(
        None, gt=0, description="Draw the members' deviation in percent too, beside this published band (+-)."
    )


class MetricStep(DrivenStep):
    """What the steps share that judge members by a metric."""

    of: ToUncertain
    metric: Literal[
        "peak-deviation",
        "peak",
        "rms",
        "overshoot",
        "settling-time",
        "hinf",
        "h2",
        "spectral-abscissa",
        "damping",
        "controllability",
        "hankel",
    ] = "peak-deviation"
    output: str | None = None
    from_input: str | None = Field(None, description="Input of a norm or of controllability; all where left out.")
    t_end: Positive | None = None
    points: Points = 401
    band: Tolerance = Field(0.02, description="Share of the final value that counts as settled.")
    seed: Annotated[int, Field(ge=0)] | None = None

    @property
    def of_a_response(self) -> bool:
        """Whether the metric is that of a time response."""
        return self.metric in ("peak-deviation", "peak", "rms", "overshoot", "settling-time")

    @model_validator(mode="after")
    def _needs_a_response(self) -> Self:
        if self.of_a_response and (not (self.input or self.sine) or self.t_end is None):
            raise PydanticCustomError(
                "needs_response", "{metric} needs input (or sine) and t_end", {"metric": self.metric}
            )
        return self


class WorstCaseStep(MetricStep):
    """Search over Delta for the worst value of a metric."""

    do: Literal["worst-case"]
    n: Annotated[int, Field(ge=1, le=100_000)] | None = Field(None, description="Points that the search starts from.")
    effort: Effort = Field(1.0, description="Multiple of the usual work of the search.")
    time_limit: TimeLimit | None = Field(None, description=GUARD)


class ViolationStep(MetricStep):
    """Probability that random members violate a limit of a metric, with Clopper-Pearson bounds; what matters for it."""

    do: Literal["violation-probability"]
    limit: float = Field(description="Values beyond it violate; in `unit`.")
    unit: str | None = Field(None, description="Unit of the limit: that of the metric, else the step is refused.")
    probability: Tolerance | None = Field(None, description="What is to be shown: P(violation) at most so large.")
    confidence: Tolerance = 0.95
    n: Annotated[int, Field(ge=1, le=10_000_000)] | None = Field(
        None, description="Samples; as many as show `probability` without a violation, or 1000, where left out."
    )


class CampaignStep(MetricStep):
    """A metric of many members, computed in worker processes and stored one by one; an interrupted run goes on."""

    do: Literal["campaign"]
    draw: Literal["samples", "vertices", "search"] = Field(
        "samples", description="Random members, vertices of Delta, or whole worst-case searches from own starts."
    )
    n: Annotated[int, Field(ge=1, le=1_000_000_000)] = 1000
    limit: float | None = Field(None, description="Count how often the metric is worse than it.")
    workers: Annotated[int, Field(ge=1, le=1024)] | None = Field(None, description="One per processor where left out.")
    time_limit_per_sample: Positive = Field(60.0, description="s; a sample that takes longer is lost.")


class HinfNormStep(StepBase):
    """H-infinity norm of a model."""

    do: Literal["hinf-norm"]
    of: ToModel


class RobustStabilityStep(StepBase):
    """Robust stability margin over the whole frequency axis, with its mu bounds."""

    do: Literal["robust-stability"]
    of: ToUncertain
    effort: Effort = Field(1.0, description="Multiple of the usual work of the proof.")
    time_limit: TimeLimit | None = Field(None, description=GUARD)


# --- synthesis -------------------------------------------------------------------------------------------------------


class MixsynStep(StepBase):
    """Mixed-sensitivity H-infinity controller: makes the norm of [W1 S; W2 K S; W3 T] small."""

    gives: ClassVar[str] = "controller"
    do: Literal["mixsyn"]
    of: ToModel
    W1: PerformanceWeight | None = None
    W2: ControlWeight | None = None
    W3: ComplementaryWeight | None = None

    @model_validator(mode="after")
    def _some_weight(self) -> Self:
        if self.W1 is None and self.W2 is None and self.W3 is None:
            raise PydanticCustomError("some_weight", "expected at least one of W1, W2, W3")
        return self


class CloseLoopStep(StepBase):
    """The tracking loop of a controller around a model: reference in, the controlled outputs out."""

    gives: ClassVar[str] = "uncertain"
    do: Literal["close-loop"]
    of: ToModel
    controller: ToController


# --- measurements ----------------------------------------------------------------------------------------------------


class RecordStep(StepBase):
    """A record from HDF5, MATLAB or CSV; its file may lie anywhere: measured data are not ours to ship."""

    gives: ClassVar[str] = "record"
    do: Literal["record"]
    path: Text
    group: str | None = None
    inputs: list[str] | None = None
    outputs: list[str] | None = None
    dt: Positive | None = None
    clock: str | None = Field(None, description="Signal with the times, where it is not called t or time.")
    units: dict[str, str] = Field(
        {}, description='Unit that the numbers in the file are in: { phi = "deg" }; they are converted to SI.'
    )
    simulated: bool = Field(False, description="The record is simulated, not measured; report and figures say so.")
    about: Text = Field(
        "", description="What the record is, who published it, how to get it; shown where the file is absent."
    )


class JoinStep(StepBase):
    """One record from two loggers with sample times of their own; a shift between their clocks is not looked for."""

    gives: ClassVar[str] = "record"
    do: Literal["join"]
    first: ToRecord
    second: ToRecord
    dt: Positive | None = Field(None, description="s; the coarser of the two where left out.")


class CompareStep(StepBase):
    """Simulate a model with the inputs of a record and report the disagreement."""

    do: Literal["compare"]
    of: ToModel
    record: ToRecord
    window: Positive | None = Field(
        None, description="Length of the windows in s; chosen from the model where left out."
    )
    start: Positive | None = Field(
        None, description="Longest opening stretch in s to which the initial state is fitted."
    )
    lags: Annotated[int, Field(ge=1, le=1000)] | None = None
    speed: str | None = Field(None, description="Output over which the error is sorted by speed.")
    position: str | None = Field(None, description="Output over which the error is sorted by position.")


class DiscoverStep(StepBase):
    """Name the effect that a model lacks; gives the updated plant, which is kept as STEP-plant.h5, too."""

    gives: ClassVar[str] = "plant"
    do: Literal["discover"]
    of: ToOneModel
    records: Annotated[list[ToRecord], Field(min_length=1, max_length=50, description="Records of one machine.")]
    held_out: list[ToRecord] = Field(
        [], description="Records that no fit sees; every fourth window of the others where left out."
    )
    repeats: list[ToRecord] = Field([], description="Further records with the same input, for the noise floor.")
    tolerances: dict[str, PriorTolerance] = Field(
        {}, description="Relative tolerance of a parameter, over the one that the plant states."
    )
    exclude: list[str] = Field([], description="Ids of effects that are not tried.")
    window: Positive | None = Field(None, description="Length of the windows in s.")
    period: Positive | None = Field(None, description="Period of the excitation in s.")
    accept: Annotated[list[Literal["no missing effect", "named", "ambiguous", "unknown"]], Field(min_length=1)] = Field(
        ["no missing effect", "named"],
        description="Verdicts that this recipe takes for an answer; any other is no trustworthy number (exit code 4).",
    )


class SheetPointEntry(Strict):
    """One operating point of a data sheet; quantities that it does not print are left out."""

    name: StepName
    voltage: float | None = Field(None, description="V")
    speed: float | None = Field(None, description="rad/s; m/s for a linear axis.")
    current: float | None = Field(None, description="A")
    torque: float | None = Field(None, description="N m (N) of the load, positive against a positive speed.")
    tolerance: Annotated[float, Field(ge=0, lt=1)] = Field(0.01, description="What the printed numbers may be off.")
    source: Text = ""


class DataSheetStep(StepBase):
    """Check printed operating points against the equilibrium of a plant; contradictions are named."""

    do: Literal["data-sheet"]
    of: ToPlant
    points: Annotated[list[SheetPointEntry], Field(min_length=1, max_length=100)]


class CoverStep(StepBase):
    """Does the envelope of an uncertain model's members hold a record?"""

    do: Literal["cover"]
    of: ToUncertain
    record: ToRecord
    n: Count = 20
    vertices: Count = 0
    rate: Positive | None = Field(None, description="s, over which mean rates of the outputs are judged as well.")
    allowance: dict[str, Annotated[float, Field(ge=0)]] = Field(
        {}, description="What the sensor of an output may be off, in its unit."
    )
    seed: Annotated[int, Field(ge=0)] | None = Field(None, description="The recipe's seed where left out.")


class ValidateStep(StepBase):
    """The smallest scaling gamma of Delta for which an uncertain model could have produced a record."""

    do: Literal["validate"]
    of: ToUncertain
    record: ToRecord
    noise: dict[str, Annotated[float, Field(ge=0)]] = Field(
        {}, description="Noise bound of an output, in its unit; from the record's own repeats where all are left out."
    )
    domain: Literal["time", "frequency"] = Field(
        "time", description="frequency: whole periods of a record in steady state, line by line."
    )
    period: Positive | None = Field(None, description="s, frequency domain: where no recorded signal tells it.")
    noise_norm: Literal["peak", "rms"] | None = Field(
        None, description="peak where left out; in the frequency domain rms."
    )
    delta: Literal["time-invariant", "time-varying"] = Field(
        "time-invariant", description="What complex and full blocks are; real ones are constants."
    )
    at_rest: bool = Field(False, description="The record starts at rest; otherwise its initial state is free.")
    window: Positive | None = Field(None, description="s; windows with a free start each, for long records.")
    per_block: bool = Field(False, description="Also the smallest scaling of each block alone.")
    precision: Annotated[float, Field(ge=1e-4, le=0.2)] = 0.01
    effort: Effort = Field(1.0, description="Multiple of the usual work.")
    time_limit: TimeLimit | None = Field(None, description=GUARD)


# --- published numbers -----------------------------------------------------------------------------------------------


class PublishedNumbersStep(StepBase):
    """Every number that L. Březina's thesis prints about its Stewart platform beside ours, with its figures redrawn."""

    do: Literal["published-numbers"]
    n: Annotated[int, Field(ge=1, le=1000)] = Field(20, description="Random members in each figure of perturbed models")


class ThesisCaseStep(StepBase):
    """The platform of L. Březina's thesis, uncertain as in a case of its section 10.3.1.

    Inputs: the six torques, and `gravity`: 1 where the holding torque stays that of the nominal machine while gravity
    acts on the perturbed one, 0 where each member is trimmed anew.
    """

    gives: ClassVar[str] = "uncertain"
    do: Literal["thesis-case"]
    case: Literal["1", "2a", "2b", "2c"]
    structure: Literal["elements", "columns", "rows", "matrices", "single"] = "single"
    n: Count = Field(0, description="Random members in the picture with nominal and worst Δ; no picture where 0.")


Step = Annotated[
    PlantStep
    | LineariseStep
    | LoadStep
    | SaveStep
    | StructuralStep
    | SteadyStateStep
    | UncertainStep
    | ElementwiseStep
    | DataCoverStep
    | StoryStep
    | CoverModelsStep
    | UncertainFromStep
    | WithLoadsStep
    | SampleStep
    | WorstCaseStep
    | ViolationStep
    | CampaignStep
    | HinfNormStep
    | RobustStabilityStep
    | MixsynStep
    | HinfStep
    | CloseLoopStep
    | H2Step
    | NcfStep
    | DkStep
    | FixedStep
    | ReduceControllerStep
    | DiscretiseStep
    | ExportStep
    | TrackingProblemStep
    | CascadeStep
    | RobustPerformanceStep
    | SimulateControlStep
    | FollowTrajectoryStep
    | RecordStep
    | JoinStep
    | CompareStep
    | DiscoverStep
    | DataSheetStep
    | CoverStep
    | ValidateStep
    | PublishedNumbersStep
    | ThesisCaseStep,
    Field(discriminator="do"),
]


# --- requirements and the recipe -------------------------------------------------------------------------------------


class Requirement(Strict):
    """A statement about a number of a step; together the requirements decide the exit code."""

    that: Annotated[str, Field(min_length=1, max_length=300)] = Field(description='For example "margin.lower".')
    text: Text = Field(description="What is required and why, in a sentence.")
    at_least: float | None = None
    at_most: float | None = None
    within: Annotated[list[float], Field(min_length=2, max_length=2)] | None = None
    equals: float | bool | str | None = None
    contains: Annotated[str, Field(min_length=1, max_length=300)] | None = Field(
        None, description="A text that a list of texts must have among its items."
    )
    tolerance: Annotated[float, Field(ge=0)] | None = Field(
        None, description="Largest allowed difference from `equals`."
    )

    @model_validator(mode="after")
    def _one_condition(self) -> Self:
        given = [n for n in ("at_least", "at_most", "within", "equals", "contains") if getattr(self, n) is not None]
        if not given:
            raise PydanticCustomError("condition", "expected at_least, at_most, within, equals or contains")
        if len(given) > 1:
            raise PydanticCustomError("condition", "expected one condition; a range is within = [low, high]")
        if self.within is not None and self.within[0] > self.within[1]:
            raise PydanticCustomError("condition", "within is [low, high], and low is above high")
        if self.tolerance is not None and (isinstance(self.equals, (bool, str)) or self.equals is None):
            raise PydanticCustomError("condition", "tolerance belongs to an equals with a number")
        return self

    @property
    def condition(self) -> str:
        """The condition in words, for example ``at least 1``."""
        if self.at_least is not None:
            return f"at least {self.at_least:.10g}"
        if self.at_most is not None:
            return f"at most {self.at_most:.10g}"
        if self.within is not None:
            return f"between {self.within[0]:.10g} and {self.within[1]:.10g}"
        if self.contains is not None:
            return f"contains {self.contains!r}"
        if isinstance(self.equals, bool):
            return "yes" if self.equals else "no"
        if isinstance(self.equals, str):
            return f"{self.equals!r}"
        margin = f" ± {self.tolerance:.10g}" if self.tolerance else ""
        return f"{self.equals:.10g}{margin}"


class Recipe(Strict):
    """A whole recipe."""

    schema_: Literal["robustlab.recipe/1"] = Field(alias="schema")
    name: StepName
    title: Text = Field("", description="Heading of the report; the name where left out.")
    description: Annotated[str, Field(max_length=10_000)] = ""
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0
    step: Annotated[dict[StepName, Step], Field(min_length=1, max_length=200)] = Field(
        description="Run in the order written."
    )
    require: Annotated[list[Requirement], Field(max_length=1000)] = Field([])


def json_schema() -> dict[str, Any]:
    """The JSON Schema of a recipe, as committed in ``recipes/recipe.schema.json``."""
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **Recipe.model_json_schema(by_alias=True)}
