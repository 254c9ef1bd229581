"""Steps that design controllers and close loops with them."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import Field, model_validator
from pydantic_core import PydanticCustomError

import robustlab as rl
from robustlab.closing import SIGNS, Sign, closing
from robustlab.doors.vocabulary import (
    GUARD,
    ComplementaryWeight,
    ControlWeight,
    Effort,
    Feedback,
    Names,
    PerformanceWeight,
    Positive,
    Strict,
    TimeLimit,
    ToController,
    ToDesignable,
    ToModel,
)
from robustlab.errors import InputError
from robustlab.recipe.steps.contract import (
    Ahead,
    Fact,
    Foretold,
    Outcome,
    Step,
    Workspace,
    facts_of,
    quantity,
    step,
)
from robustlab.recipe.steps.models import UNCERTAIN, uncertain_numbers
from robustlab.signals import Taken

TAKES = {-1: "r - y", 1: "y"}  # of a controller that says nothing, by the sign that closes its loop
REFERRED = {-1: "u = K (r - y)", 1: "u = K (y - r)"}  # the same with references
GammaRel = Annotated[float, Field(ge=1, le=10)]


def numbers_of(*more: str) -> dict[str, Any]:
    """What is left of every design, see `designed`, and ``more`` numbers of one kind."""
    return {"order": "1", "stable": bool, **dict.fromkeys((*BASE, *more), float)}


BASE = ("gamma", "fastest_controller_pole", "closed_loop_abscissa")
HINF = (
    "smallest_gamma", "peak_frequency", "scalings_disagree", "gamma_lower", "estimated_optimum", "regularisation_cost",
)  # fmt: skip


@step
class MixsynStep(Step):
    """Mixed-sensitivity H-infinity controller: makes the norm of [W1 S; W2 K S; W3 T] small."""

    gives: ClassVar[str] = "controller"
    leaves: ClassVar[Any] = numbers_of(*HINF)
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

    def run(self, work: Workspace) -> Outcome:
        model = work.values[self.of]
        makers = ((self.W1, rl.performance_weight), (self.W2, rl.control_weight), (self.W3, rl.complementary_weight))
        weights = [None if given is None else make(**given.model_dump()) for given, make in makers]
        found = rl.mixsyn(model, *weights)
        _draw_sensitivities(found, model, work)
        return designed(found, f"Mixed-sensitivity controller for {self.of}.", work)


class DesignStep(Step):
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

    def generalised(self, work: Workspace, nominal: bool = False) -> tuple[Any, int | None, int | None]:
        """The generalised plant of a design step with its numbers of measurements and controls."""
        from robustlab.synthesis.specifications.tracking_problem import TrackingProblem

        given = work.values[self.of]
        if isinstance(given, TrackingProblem):
            if self.measurements is not None or self.controls is not None:
                raise InputError("measurements or controls", "given", "neither: a tracking problem has its own")
            return given.nominal if nominal else given.plant, None, None
        if self.measurements is None or self.controls is None:
            found = "measurements or controls is missing"
            raise InputError(
                self.kind, found, "how many of the last outputs are measured, of the last inputs are controls"
            )
        return given, self.measurements, self.controls


@step
class HinfStep(DesignStep):
    """H-infinity controller of a generalised plant, verified in the loop rebuilt from it."""

    leaves: ClassVar[Any] = numbers_of(*HINF)
    do: Literal["hinf"]
    gamma_rel: GammaRel = Field(1.05, description="Allowed ratio to the smallest gamma; the slowest controller wins.")
    nominal: bool = Field(
        True, description="Of a tracking problem: the nominal plant; else all of Delta counts as one full block."
    )

    def run(self, work: Workspace) -> Outcome:
        P, *channels = self.generalised(work, nominal=self.nominal)
        found = rl.hinf(P, *channels, gamma_rel=self.gamma_rel, effort=self.effort, time_limit=self.time_limit)
        _draw_loop(found, work)
        _draw_functions(found, self.of, work)
        return designed(found, f"H-infinity controller for {self.of}.", work)


@step
class CloseLoopStep(Step):
    """The tracking loop of a controller around a model: reference in, the controlled outputs out."""

    gives: ClassVar[str] = "uncertain"
    leaves: ClassVar[Any] = {**UNCERTAIN, "spectral_abscissa": float, "nominally_stable": bool}
    do: Literal["close-loop"]
    of: ToModel
    controller: ToController
    sign: Feedback = None

    def foretell(self, ahead: Ahead) -> Foretold:
        inputs, outputs = ahead[self.of].inputs, ahead[self.of].outputs
        if inputs is None or outputs is None:
            return Foretold()
        return Foretold(None, {f"{name}_ref": unit for name, unit in outputs.items()}, {**outputs, **inputs})

    def run(self, work: Workspace) -> Outcome:
        K, said = speaking(work.values[self.of], work.values[self.controller], self.sign)
        loop = tracking_loop(work.values[self.of], K)
        abscissa = loop.nominal.spectral_abscissa()
        numbers = {**uncertain_numbers(loop), "spectral_abscissa": abscissa, "nominally_stable": abscissa < 0}
        facts = (
            Fact("Loop", said),
            Fact("Inputs", ", ".join(s.name for s in loop.inputs)),
            Fact("Outputs", ", ".join(s.name for s in loop.outputs)),
            Fact("Rightmost pole of the nominal loop", quantity(abscissa, "1/s")),
        )
        word = "stable" if abscissa < 0 else "unstable"
        return Outcome(loop, f"Loop of {self.controller} around {self.of}: nominally {word}.", numbers, facts)


@step
class H2Step(DesignStep):
    """H2 (LQG) controller of a generalised plant; of a tracking problem, of the nominal one."""

    leaves: ClassVar[Any] = numbers_of("regularisation", "regularised_norm", "smallest_norm")
    do: Literal["h2"]

    def run(self, work: Workspace) -> Outcome:
        P, *channels = self.generalised(work, nominal=True)
        found = rl.h2(P, *channels, effort=self.effort, time_limit=self.time_limit)
        _draw_loop(found, work)
        _draw_functions(found, self.of, work)
        return designed(found, f"H2 controller for {self.of}.", work)


Diagonal = Positive | list[Annotated[float, Field(ge=0)]]


@step
class LqgStep(Step):
    """Linear-quadratic-Gaussian controller (u = K y, positive feedback) whose filter may know a disturbance.

    Weights are one number for all, or one for each state, control, or measurement.
    """

    gives: ClassVar[str] = "controller"
    leaves: ClassVar[Any] = numbers_of("separation", "peak")
    do: Literal["lqg"]
    of: ToModel
    Q: Diagonal = Field(1.0, description="Cost of the states.")
    R: Diagonal = Field(1.0, description="Cost of the controls.")
    W: Diagonal = Field(1.0, description="Intensity of the noise on the states.")
    V: Diagonal = Field(1.0, description="Intensity of the noise on the measurements.")
    disturbance: Literal["constant"] | Positive | None = Field(
        None, description='"constant", or the frequency of a sinusoid in rad/s.'
    )
    at: Literal["input", "output"] = Field("input", description="Where the disturbance adds.")
    channels: Annotated[list[str], Names("signals")] | None = Field(
        None, description="On which inputs or outputs; all where left out."
    )
    disturbance_noise: Positive = Field(1.0, description="The larger, the faster the disturbance is estimated.")
    regulated: Annotated[list[str], Names("outputs")] | None = Field(
        None, description="Outputs that it must leave; all where left out."
    )

    def run(self, work: Workspace) -> Outcome:
        import numpy as np

        from robustlab.report.design_figures import functions_picture
        from robustlab.statespace import as_model

        model = as_model(work.values[self.of], self.of)
        sizes = {"Q": model.n_states, "R": model.n_inputs, "W": model.n_states, "V": model.n_outputs}
        weights = []
        for name, size in sizes.items():
            given = np.atleast_1d(getattr(self, name))
            if len(given) not in (1, size):
                raise InputError(name, f"{len(given)} numbers", f"one, or {size}")
            weights.append(np.diag(np.broadcast_to(given, (size,))))
        options = self.model_dump(include={"disturbance", "at", "channels", "disturbance_noise", "regulated"})
        found = rl.lqg(model, *weights, **options)
        _draw_loop(found, work)
        work.draw(functions_picture(found), "functions", "S, K S, T and S G of the loop.")
        return designed(found, f"LQG controller for {self.of}.", work)


@step
class NcfStep(Step):
    """Loop shaping with normalised coprime factors (u = K y, positive feedback); gamma_min is exact."""

    gives: ClassVar[str] = "controller"
    leaves: ClassVar[Any] = numbers_of("gamma_min", "factor", "rho", "steady_error", "references")
    do: Literal["ncf"]
    of: ToModel
    W1: Positive | None = Field(None, description="Gain before the plant.")
    W2: Positive | None = Field(None, description="Gain behind the plant.")
    factor: Annotated[float, Field(gt=1, le=100)] = 1.1
    reference_model: ToModel | None = Field(
        None, description="Two degrees of freedom, u = K [r; y]: what the outputs are to do."
    )
    rho: Positive = Field(1.0, description="Weight of following the reference model.")
    follow: Annotated[list[str], Names("outputs")] | None = Field(
        None, description="Outputs that follow it; all where left out."
    )

    def run(self, work: Workspace) -> Outcome:
        from robustlab.report.design_figures import functions_picture

        options: dict[str, Any] = {"factor": self.factor}
        if self.reference_model is not None:
            wanted = work.values[self.reference_model]
            options |= {"reference_model": wanted, "rho": self.rho, "outputs": self.follow}
        found = rl.ncf(work.values[self.of], self.W1, self.W2, **options)
        _draw_loop(found, work)
        work.draw(functions_picture(found), "functions", "S, K S, T and S G of the loop.")
        return designed(found, f"Loop-shaping controller for {self.of}.", work)


@step
class DkStep(DesignStep):
    """Robust controller by D-K iteration and direct minimisation; gamma bounds mu at all frequencies."""

    leaves: ClassVar[Any] = numbers_of("lower", "frequency", "scaled_level", "start_mu")
    do: Literal["dk"]
    start: ToController | None = Field(None, description="Stabilising controller to start from.")
    structure: Annotated[str, Field(max_length=200)] | None = Field(
        None, description="What the controller may look like, in the words of `fixed`; D-K iteration alone then."
    )
    starts: Annotated[int, Field(ge=0, le=1000)] = Field(3, description="With a structure: number of random starts.")
    direct: bool = Field(True, description="Go on with direct minimisation.")
    mixed: bool = Field(True, description="Use that real blocks are real.")
    max_order: Annotated[int, Field(ge=0, le=1000)] | None = Field(None, description="Largest order of the controller.")
    order_rel: Annotated[float, Field(ge=0, lt=1)] = Field(
        0.01, description="Loss of level allowed for a controller of lower order, then for one with slower poles."
    )

    def run(self, work: Workspace) -> Outcome:
        from robustlab.report.design_figures import history_picture
        from robustlab.synthesis.laws.controller_structures import structure_in_words
        from robustlab.synthesis.problem.partition import as_generalized_plant

        P, *channels = self.generalised(work)
        start = None if self.start is None else work.values[self.start]
        taken = {"direct", "mixed", "max_order", "order_rel", "effort", "time_limit", "starts"}
        options: dict[str, Any] = self.model_dump(include=taken)
        if self.structure is not None:
            plant = as_generalized_plant(P, channels[0], channels[1], "dk")
            options |= {"structure": structure_in_words(self.structure, plant), "seed": work.seed}
        found = rl.dk(P, None, *channels, K0=start, **options)
        _draw_loop(found, work)
        work.draw(history_picture(found), "history", "The search: what each iterate proves of μ, and its order.")
        _draw_functions(found, self.of, work, proved=False)
        return designed(found, f"Robust controller for {self.of}.", work)


@step
class FixedStep(DesignStep):
    """Controller of a given structure with the smallest norm found; a local optimum, verified.

    Of a tracking problem or an uncertain model the worst member counts, unless `nominal`.
    """

    leaves: ClassVar[Any] = numbers_of("peak_frequency")
    do: Literal["fixed"]
    structure: Annotated[str, Field(max_length=200)] = Field(
        "static", description='static, p, i, pi, pd, pid, "order:N", "poles:-1,-20", "ipd:full", "decentralised:WORD".'
    )
    nominal: bool = Field(False, description="Of a tracking problem: the nominal plant alone.")
    objective: Literal["hinf", "h2"] = "hinf"
    starts: Annotated[int, Field(ge=0, le=1000)] = Field(3, description="Number of random starts.")

    def run(self, work: Workspace) -> Outcome:
        from robustlab.synthesis.laws.controller_structures import structure_in_words
        from robustlab.synthesis.problem.partition import as_generalized_plant

        plant = as_generalized_plant(*self.generalised(work, nominal=self.nominal), "fixed")
        options: dict[str, Any] = self.model_dump(include={"objective", "starts", "effort", "time_limit"})
        found = rl.fixed_structure(plant, structure_in_words(self.structure, plant), seed=work.seed, **options)
        _draw_loop(found, work)
        _draw_functions(found, self.of, work, proved=self.nominal and self.objective == "hinf")
        return designed(found, f"Controller of structure {self.structure} for {self.of}.", work)


class GoalWords(Strict):
    """A goal of a loop; which numbers it takes depends on its word."""

    goal: Literal["tracking", "sensitivity", "gain", "rejection", "variance", "margin", "overshoot"]
    hard: bool = Field(False, description="Must be met before the others are made small.")
    response_time: Positive | None = Field(None, description="tracking, in s")
    error: Positive | None = Field(None, description="tracking, sensitivity: at low frequency")
    peak: Positive | None = Field(None, description="tracking, sensitivity")
    bandwidth: Positive | None = Field(None, description="sensitivity, in rad/s")
    bound: Positive | None = Field(None, description="gain, rejection, variance")
    disk: Positive | None = Field(None, description="margin")
    percent: Positive | None = Field(None, description="overshoot, by its proxy")
    at: Literal["input", "output"] | None = Field(None, description="sensitivity, margin")
    inputs: Literal["reference", "disturbance", "noise"] | None = Field(None, description="gain, variance")
    outputs: Literal["output", "control", "total", "error"] | list[str] | None = Field(
        None, description="gain, variance; names of outputs for tracking"
    )


@step
class TuneStep(Step):
    """Controller u = K (r - y) of a given structure: hard goals met, the others made small, for several plants."""

    gives: ClassVar[str] = "controller"
    leaves: ClassVar[Any] = numbers_of("missed", "overshoot")
    do: Literal["tune"]
    of: ToModel
    also: list[ToModel] = Field(default_factory=list, description="Further plants for the same controller.")
    structure: Annotated[str, Field(max_length=200)] = Field("pid", description="In the words of `fixed`.")
    goals: Annotated[list[GoalWords], Field(min_length=1, max_length=50)]
    damping: Annotated[float, Field(gt=0, le=1)] | None = Field(None, description="Least damping of the loop's poles.")
    decay: Positive | None = Field(None, description="Least decay rate of the loop's poles, in 1/s.")
    bandwidth: Positive | None = Field(None, description="Largest modulus of the loop's poles, in rad/s.")
    starts: Annotated[int, Field(ge=0, le=1000)] = Field(3, description="Number of random starts.")
    effort: Effort = Field(1.0, description="Multiple of the usual work of the search.")
    time_limit: TimeLimit | None = Field(None, description=GUARD)

    def run(self, work: Workspace) -> Outcome:
        from robustlab.statespace import as_model
        from robustlab.synthesis.fixed.design_goals import goal_in_words
        from robustlab.synthesis.laws.controller_structures import structure_in_words
        from robustlab.synthesis.nonsmooth.design_limits import Bandwidth, Damping, Decay
        from robustlab.synthesis.problem.partition import GeneralizedPlant

        models = [as_model(work.values[name], name) for name in (self.of, *self.also)]
        first = models[0]
        words = structure_in_words(self.structure, GeneralizedPlant(first, first.n_outputs, first.n_inputs))
        goals: list[Any] = [
            goal_in_words(g.goal, g.model_dump(exclude={"goal", "hard"}, exclude_none=True), g.hard) for g in self.goals
        ]
        limits = ((Damping, self.damping), (Decay, self.decay), (Bandwidth, self.bandwidth))
        goals += [kind(value) for kind, value in limits if value is not None]
        options: dict[str, Any] = self.model_dump(include={"starts", "effort", "time_limit"})
        found = rl.tune(models, words, goals, seed=work.seed, **options)
        _draw_loop(found, work)
        return designed(found, f"Controller of structure {self.structure} for {self.of}.", work)


@step
class ReduceControllerStep(DesignStep):
    """The controller of lowest order whose verified loop is at most a stated share worse than the full one's."""

    leaves: ClassVar[Any] = numbers_of("original_order", "original_gamma", "loss", "allowed_loss")
    do: Literal["reduce-controller"]
    controller: ToController
    loss: Annotated[float, Field(ge=0, le=10)] = 0.01
    order: Annotated[int, Field(ge=0, le=1000)] | None = Field(None, description="The order wanted, whatever the loss.")
    measure: Literal["hinf", "h2", "mu"] = Field("hinf", description="mu: robust performance, with the plant's Delta.")

    def run(self, work: Workspace) -> Outcome:
        from robustlab.statespace import as_model

        P, n_meas, n_con = self.generalised(work, nominal=self.measure != "mu")
        K = as_model(work.values[self.controller], self.controller)
        options: dict[str, Any] = self.model_dump(include={"loss", "order", "measure", "effort", "time_limit"})
        found = rl.reduce_controller(P, K, n_meas=n_meas, n_con=n_con, **options)
        return designed(found, f"{self.controller} with fewer states.", work)


def speaking(system: Any, controller: Any, sign: Sign | None = None) -> tuple[Any, str]:
    """A controller each of whose inputs knows what it takes of a model, and the loop in words.

    One that says nothing takes ``r - y`` or ``y``, as ``sign`` says, or the stability of the loop.
    Raises InputError: see `robustlab.closing.closing`; sizes that do not fit.
    """
    from robustlab.statespace import as_model

    base = system if isinstance(system, rl.UncertainModel) else as_model(system)
    K = as_model(controller, "controller")
    names = [s.name for s in base.outputs]
    fed = [s for s in K.inputs if not (isinstance(s, Taken) and not s.sign)]
    by_name = all((s.of if isinstance(s, Taken) else s.name) in names for s in fed)
    if K.n_outputs != len(base.inputs) or not (by_name or len(fed) == len(names)):
        found = f"{K.n_inputs} inputs and {K.n_outputs} outputs"
        sizes = f"{len(names)} and {len(base.inputs)}: an input per output of the model, and vice versa"
        raise InputError("controller", found, sizes)
    loop = closing(base, K, sign, "controller", None)
    own = {s.sign for s in fed if isinstance(s, Taken)}
    if by_name and own:
        return K, loop.said
    of = (
        {s.name: s.name for s in fed}
        if by_name
        else {s.name: y.name for s, y in zip(fed, loop.plant.outputs, strict=True)}
    )
    word = {} if len(own) > 1 or loop.sign in own else dict.fromkeys(of, TAKES[loop.sign])
    takes = [
        Taken(s.name, s.unit, word.get(s.name, getattr(s, "takes", "")), of[s.name]) if s.name in of else s
        for s in K.inputs
    ]
    said = loop.said.replace(SIGNS[loop.sign], REFERRED[loop.sign], 1) if not own else loop.said
    return K.renamed(inputs=takes), said


def tracking_loop(system: Any, controller: Any) -> Any:
    """The loop of a controller with references around a model or an uncertain model, as an uncertain model.

    ``u = K (r - y)`` for a controller that takes the error; ``u = K (y - r)`` for one that takes y;
    one with inputs for references gets these. Inputs: a reference for each output. Outputs: the outputs y and the
    control signals u.
    """
    import numpy as np

    from robustlab.statespace import as_model

    base = system if isinstance(system, rl.UncertainModel) else rl.UncertainModel(as_model(system), [])
    K, _ = speaking(base, controller)
    takes: list[Any] = list(K.inputs)
    names = [s.name for s in base.outputs]
    m, (q, p) = base.M, base.delta_shape
    n, n_u, n_y = m.n_states, m.n_inputs - q, m.n_outputs - p
    # v = F r + S y is what K takes; one with inputs for references gets those there, and y as it is.
    F, S = np.zeros((len(takes), n_y)), np.zeros((len(takes), n_y))
    referred = {s.of for s in takes if not s.sign}
    order = iter(range(n_y))
    for row, s in enumerate(takes):
        j = names.index(s.of) if s.of in names else next(order)
        S[row, j], F[row, j] = s.sign, 1.0 if not s.sign else 0.0 if s.of in referred else -s.sign
    none = np.zeros((n_u, n_y))
    plant = rl.StateSpaceModel(
        m.A,
        np.hstack([m.B[:, :q], np.zeros((n, n_y)), m.B[:, q:]]),
        np.vstack([m.C, np.zeros((n_u, n)), S @ m.C[p:]]),
        np.block(
            [
                [m.D[:, :q], np.zeros((m.n_outputs, n_y)), m.D[:, q:]],
                [np.zeros((n_u, q)), none, np.eye(n_u)],
                [S @ m.D[p:, :q], F, S @ m.D[p:, q:]],
            ]
        ),
        m.dt,
        [*m.inputs[:q], *(rl.Signal(f"{s.name}_ref", s.unit) for s in base.outputs), *base.inputs],
        [*m.outputs, *base.inputs, *(Taken(f"{s.name} taken", s.unit, s.takes, s.of) for s in takes)],
        m.states,
        where="tracking loop",
    )
    return rl.UncertainModel(plant, base.blocks).close(K)


def designed(found: Any, summary: str, work: Workspace) -> Outcome:
    """What a design leaves: every number of it that stands alone, and what a person wants to read."""
    work.keep(found)
    numbers = {key: value for key, value in found.numbers().items() if value is not None}
    reason = f"{found.reason[:1].upper()}{found.reason[1:]}"
    text = "\n".join(line for part in found.details() for line in (f"{part.title}:", *(row[0] for row in part.rows)))
    return Outcome(found.controller, f"{summary} {reason}.", numbers, facts_of(found), found.status, (), text)


def _draw_loop(found: Any, work: Workspace) -> None:
    """Singular values of the weighted loop with the peak, and the controller."""
    from robustlab.report.design_figures import loop_picture

    work.draw(loop_picture(found), "loop", "The weighted closed loop with its peak, and the controller.")


def _draw_functions(found: Any, of: str, work: Workspace, proved: bool = True) -> None:
    """S, K S and T of a tracking problem against what the weights ask for and, if wanted, what gamma proves."""
    from robustlab.report.design_figures import functions_figure, tracking_panels
    from robustlab.synthesis.specifications.loop_functions import frequencies
    from robustlab.synthesis.specifications.tracking_problem import TrackingProblem

    problem = work.values[of]
    if not isinstance(problem, TrackingProblem):
        return
    omega = frequencies(found.closed_loop)
    gamma = found.gamma if proved else None
    panels = tracking_panels(problem, {found.method: found.K}, omega, gamma)
    work.draw(functions_figure(omega, panels, gamma), "functions", "The nominal loop against its weights.")


def _draw_sensitivities(found: Any, model: Any, work: Workspace) -> None:
    import numpy as np

    from robustlab.linear_analysis.frequency import default_grid
    from robustlab.report.design_figures import WeightedResponse, sensitivity_figure
    from robustlab.statespace import as_model

    loop = tracking_loop(as_model(model), found.K).nominal
    omega = default_grid(as_model(model), 400, decades=3.0)  # the weights live around the plant's dynamics
    response = rl.frequency_response(loop, omega)
    n_y = as_model(model).n_outputs
    output, control = response[:, :n_y], response[:, n_y:]
    functions = {
        "W1": ("S: control error", np.eye(n_y) - output),
        "W2": ("KS: control signal", control),
        "W3": ("T: output", output),
    }
    curves = []
    for name, (label, values) in functions.items():
        bound = None
        if name in found.weights:
            bound = found.gamma / np.abs(rl.frequency_response(found.weights[name], omega)[:, 0, 0])
        curves.append(WeightedResponse(label, np.linalg.norm(values, 2, axis=(1, 2)), bound))
    caption = "Closed loop against its weights: each curve lies below γ / |W|, with the verified γ."
    work.draw(sensitivity_figure(omega, curves, found.gamma), "sensitivities", caption)
