"""Doors of designs: controllers by every method, what makes them smaller or digital, state feedback, scheduling."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, Any

import robustlab as rl
from robustlab.doors.declaration import InLoop, Named, door
from robustlab.doors.design_kinds import ByNumber, Diagonal, Disturbance, Goals, Weight
from robustlab.doors.kinds import Choice, Flag, Kind, Names, Number, Table, Thing, Whole
from robustlab.doors.words import Band, Design, Model, SampleTime, Search, Seed, Sign, Signals
from robustlab.errors import InputError, UsageError

DESIGN, HINF = "synthesis.problem.design.", "synthesis.hinf."
Plant = Annotated[Design, "Generalised plant, tracking problem, plant or uncertain model.", Named(key="of")]
Of = Annotated[Model, Named(key="of")]
K = Annotated[Any, Thing(("controller", "any"), model=True), "File with the controller."]
Channel = Annotated[Any, ByNumber()]
Measured = Annotated[Channel, "Measured outputs by name, or how many of the last; a tracking problem knows its own."]
Controls = Annotated[Channel, "Control inputs by name, or how many of the last; a tracking problem knows its own."]


@dataclass(frozen=True)
class LoopChannels:
    """Which inputs and outputs of a plant its controller is connected to."""

    measurements: Measured = None
    controls: Controls = None

    def around(self, system: Any, K: Any, where: str, nominal: bool | None = False) -> Any:
        """The generalised plant of a controller: with as many channels at the end as it has where none are named."""
        from robustlab.synthesis.specifications.tracking_problem import TrackingProblem

        if (self.measurements is None) != (self.controls is None):
            raise UsageError(f"{where}: measurements, controls", "one of them", "both, or none")
        if self.measurements is not None or isinstance(system, TrackingProblem):
            return Channels(self.measurements, self.controls).posed(system, where, nominal)
        return Channels(K.n_inputs, K.n_outputs).posed(system, where, nominal)


@dataclass(frozen=True)
class Channels:
    """Which inputs and outputs of a system a design takes."""

    measurements: Measured = None
    controls: Controls = None
    disturbances: Annotated[
        list[str] | None,
        Names(),
        "With names: the inputs w; all that are no controls where left out.",
        Named(option="--disturbance-inputs"),
    ] = None
    performance: Annotated[
        list[str] | None,
        Names(),
        "With names: the outputs z; all outputs where left out.",
        Named(option="--performance-outputs"),
    ] = None

    def posed(self, system: Any, where: str, nominal: bool | None = False) -> Any:
        """The generalised plant: of a tracking problem its own, else with channels by number or by name.

        ``nominal``: at Delta = 0; None: so of a tracking problem alone.
        """
        from robustlab.synthesis.problem.partition import as_generalized_plant
        from robustlab.synthesis.specifications.tracking_problem import TrackingProblem

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
            return rl.generalized_plant(system, measurements, controls, self.disturbances, self.performance)
        if self.disturbances or self.performance:
            raise UsageError(
                where, "disturbance inputs or performance outputs", "measurements and controls by name, too"
            )
        return as_generalized_plant(system, measurements, controls, where)


Nominal = Annotated[
    bool, Flag(), "Of a tracking problem or an uncertain model: at Delta = 0, without its perturbation channels."
]
# Left out, a tracking problem is taken at Delta = 0; all of an uncertain model's Delta counts as one full block.
NominalProblem = Annotated[
    bool | None, Flag(), "At Delta = 0; left out so of a tracking problem; else all of Delta counts as one full block."
]
GammaRel = Annotated[
    float, Number(least=1, most=10), "Allowed ratio to the smallest gamma; within it the slowest controller wins."
]
Structure = Annotated[
    str,
    Kind(),
    "static, p, i, pi, pd, pid (one per channel), order:N, poles:-1,-20, ipd or two-layer (with :full, :diagonal, "
    ":scalar), decentralised:WORD.",
]
Starts = Annotated[int, Whole(0, 1000), "Number of random starts."]
Order = Annotated[int | None, Whole(0, 1000)]


UNSAID, AS_CONTROLLER, USUAL, ALL_SIGNALS = Channels(), LoopChannels(), Search(), Signals()


def _design(found: Any, system: Any = None, proved: bool = True, drawn: bool = False) -> Any:
    """A design, beside it the loop of a tracking problem against its weights, where that is drawn."""
    from robustlab.synthesis.specifications.tracking_problem import TrackingLoop, TrackingProblem

    if not drawn or not isinstance(system, TrackingProblem):
        return found
    return InLoop(found, "", (), {"functions": TrackingLoop(system, found, found.gamma if proved else None)})


# --- generalised plants -----------------------------------------------------------------------------------------------


@door("synth hinf", "hinf", result=DESIGN + "HinfSynthesis", gives="controller", made="controller")
def hinf(
    system: Plant,
    channels: Channels = UNSAID,
    nominal: NominalProblem = None,
    gamma_rel: GammaRel = 1.05,
    search: Search = USUAL,
    progress: Any = None,
    drawn: bool = False,
) -> Any:
    """H-infinity controller u = K y (positive feedback) of a generalised plant, verified in the loop rebuilt from K.

    Exit code 4: no controller could be vouched for.

    Example: robustlab synth hinf plant.h5 --measurements 1 --controls 1 --out controller.h5
    """
    P = channels.posed(system, "hinf", nominal)
    found = rl.hinf(P, gamma_rel=gamma_rel, progress=progress, **search.options)
    return _design(found, system, drawn=drawn)


@door("synth h2", "h2", result="synthesis.h2.h2_synthesis.H2Synthesis", gives="controller", made="controller")
def h2(
    system: Plant,
    channels: Channels = UNSAID,
    nominal: NominalProblem = None,
    search: Search = USUAL,
    progress: Any = None,
    drawn: bool = False,
) -> Any:
    """H2 (LQG) controller u = K y (positive feedback) of a generalised plant; gamma is the verified H2 norm.

    Exit code 4: no controller could be vouched for, or no finite H2 norm exists.

    Example: robustlab synth h2 plant.h5 --measurements y --controls u --out controller.h5
    """
    P = channels.posed(system, "h2", nominal)
    return _design(rl.h2(P, progress=progress, **search.options), system, drawn=drawn)


@door("synth dk", "dk", result="synthesis.dk.dk_design.DKSynthesis", gives="controller", made="controller")
def dk(
    system: Plant,
    channels: Channels = UNSAID,
    blocks: Annotated[
        str | None,
        Kind(),
        'Blocks of Delta as rows "r,c" separated by ";" (-r,0 real repeated, r,0 complex repeated, r,c full); those of '
        "the uncertain model where left out.",
    ] = None,
    start: Annotated[Any, Thing(("controller", "any")), "Stabilising controller to start from."] = None,
    structure: Annotated[Structure | None, "What the controller may look like, as for fixed; D-K alone then."] = None,
    starts: Annotated[Starts, "With a structure: random starts."] = 3,
    direct: Annotated[bool, Flag(), "Go on with direct minimisation after D-K iteration."] = True,
    mixed: Annotated[bool, Flag(), "Use that real blocks are real."] = True,
    max_order: Annotated[Order, "Largest order of the controller."] = None,
    order_rel: Annotated[
        float,
        Number(least=0, below=1),
        "Loss of level allowed for a controller of lower order, then for one with slower poles.",
    ] = 0.01,
    search: Search = USUAL,
    seed: Seed = 0,
    progress: Any = None,
    drawn: bool = False,
) -> Any:
    """Robust controller u = K y (positive feedback): makes the peak of mu small, by D-K iteration and directly.

    Of an uncertain plant the blocks are known; what they leave of w and z is the performance. gamma is an upper bound
    of mu at all frequencies. Exit code 4: no controller could be vouched for.

    Example: robustlab synth dk uncertain.h5 --measurements y --controls u --figure design.svg --out controller.h5
    """
    from robustlab.synthesis.laws.controller_structures import structure_in_words

    rows = None if blocks is None else _rows(blocks)
    P = channels.posed(system, "dk")
    options: dict[str, Any] = {"starts": starts, "seed": seed} if structure is not None else {}
    found = rl.dk(
        P, rows, K0=start, structure=None if structure is None else structure_in_words(structure, P), direct=direct,
        mixed=mixed, max_order=max_order, order_rel=order_rel, progress=progress, **search.options,
        **options,
    )  # fmt: skip
    return _design(found, system, proved=False, drawn=drawn)


def _rows(text: str) -> list[list[int]]:
    """``"-2,0; 2,2"`` as the rows of `robustlab.mu`."""
    rows: list[list[int]] = []
    for part in text.split(";"):
        try:
            row = [int(number) for number in part.split(",")]
        except ValueError:
            row = []
        if len(row) != 2:
            expected = 'rows "r,c" separated by ";": -r,0 real repeated r times, r,0 complex repeated, r,c a full block'
            raise UsageError("--blocks", repr(part.strip()), expected)
        rows.append(row)
    return rows


@door(
    "synth fixed",
    "fixed",
    result="synthesis.fixed.fixed_structure.FixedSynthesis",
    gives="controller",
    made="controller",
)
def fixed_structure(
    system: Plant,
    structure: Structure = "static",
    channels: Channels = UNSAID,
    nominal: Nominal = False,
    objective: Annotated[str, Choice(("hinf", "h2")), "The norm that is made small."] = "hinf",
    starts: Starts = 3,
    search: Search = USUAL,
    seed: Seed = 0,
    progress: Any = None,
    drawn: bool = False,
) -> Any:
    """Controller u = K y (positive feedback) of a given structure: the smallest norm found, verified; a local optimum.

    Of a tracking problem or an uncertain model the worst member counts, unless nominal.
    Exit code 4: no start stabilised the plant.

    Example: robustlab synth fixed plant.h5 --structure order:2 --measurements 1 --controls 1 --out controller.h5
    """
    from robustlab.synthesis.laws.controller_structures import structure_in_words

    P = channels.posed(system, "fixed", nominal)
    found = rl.fixed_structure(
        P, structure_in_words(structure, P), objective=objective, starts=starts, seed=seed, progress=progress,
        **search.options,
    )  # fmt: skip
    return _design(found, system, nominal and objective == "hinf", drawn)


# --- plain models -----------------------------------------------------------------------------------------------------


def _some_weight(w1: Any, w2: Any, w3: Any) -> None:
    if w1 is None and w2 is None and w3 is None:
        raise UsageError("mixsyn", "no weight", "at least one of W1, W2, W3")


@door("synth mixsyn", "mixsyn", result=DESIGN + "HinfSynthesis", gives="controller", made="controller",
      check=_some_weight)  # fmt: skip
def mixsyn(
    system: Of,
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
    signals: Signals = ALL_SIGNALS,
    gamma_rel: GammaRel = 1.05,
    search: Search = USUAL,
    progress: Any = None,
) -> Any:
    """Mixed-sensitivity controller u = K (r - y) of a plant: makes the norm of [W1 S; W2 K S; W3 T] small, verified.

    States that the chosen inputs and outputs do not touch are left out, with a note.
    Exit code 4: no controller could be vouched for.

    Example: robustlab synth mixsyn motor.h5 --outputs omega --w1 bandwidth=100,error=0.01 --w2 limit=2 --out k.h5
    """
    from robustlab.linear_analysis.structural import drop_unconnected

    model = signals.of(system)
    kept = drop_unconnected(model)
    gone = [name for name in model.state_names if name not in kept.state_names]
    notes = (f"left out, for no chosen input or output touches them: states {', '.join(gone)}",) if gone else ()
    found = rl.mixsyn(kept, w1, w2, w3, gamma_rel=gamma_rel, progress=progress, **search.options)
    return InLoop(found, "", notes)


@door("synth ncf", "ncf", result=f"{HINF}loop_shaping.NcfSynthesis, {HINF}two_degree.TwoDegreeSynthesis",
      gives="controller", made="controller")  # fmt: skip
def ncf(
    system: Of,
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
    signals: Signals = ALL_SIGNALS,
    factor: Annotated[float, Number(above=1, most=100), "Back-off from the smallest gamma, above 1."] = 1.1,
    reference_model: Annotated[
        Model | None, "Two degrees of freedom, u = K [r; y]: what the outputs are to do."
    ] = None,
    rho: Annotated[float, Number(above=0), "Weight of following the reference model, 1 to 3."] = 1.0,
    follow: Annotated[list[str] | None, Names("outputs"), "Outputs that follow it; all where left out."] = None,
) -> Any:
    """Loop shaping with normalised coprime factors: u = K y (positive feedback), gamma_min exact.

    Choose W1 and W2 so that W2 G W1 has the wanted shape. A margin (1 / gamma) above 0.25 keeps it.
    With a reference model the controller takes references too, u = K [r; y]. Exit code 4: no controller could be
    vouched for.

    Example: robustlab synth ncf motor.h5 --outputs omega --w1 10 --out controller.h5
    """
    options: dict[str, Any] = {"factor": factor}
    if reference_model is not None:
        options |= {"reference_model": reference_model, "rho": rho, "outputs": follow}
    return rl.ncf(signals.of(system), w1, w2, **options)


@door("synth lqg", "lqg", result="synthesis.h2.gaussian_regulator.LqgSynthesis", gives="controller", made="controller")
def lqg(
    system: Of,
    q: Annotated[Any, Diagonal(), "Cost of the states: a number, or one for each.", Named(key="Q")] = 1.0,
    r: Annotated[Any, Diagonal(), "Cost of the controls.", Named(key="R")] = 1.0,
    w: Annotated[Any, Diagonal(), "Intensity of the noise on the states.", Named(key="W")] = 1.0,
    v: Annotated[Any, Diagonal(), "Intensity of the noise on the measurements.", Named(key="V")] = 1.0,
    signals: Signals = ALL_SIGNALS,
    disturbance: Annotated[
        Any, Disturbance(), "constant, the frequency of a sinusoid in rad/s, or a file with a filter."
    ] = None,
    at: Annotated[
        str, Choice(("input", "output")), "Where the disturbance adds.", Named(option="--disturbance-at")
    ] = "input",
    channels: Annotated[list[str] | None, Names("signals"), "On which inputs or outputs; all where left out."] = None,
    disturbance_noise: Annotated[Any, Diagonal(), "The larger, the faster the disturbance is estimated."] = 1.0,
    regulated: Annotated[list[str] | None, Names("outputs"), "Outputs that it must leave; all where left out."] = None,
) -> Any:
    """Linear-quadratic-Gaussian controller u = K y (positive feedback), with disturbances that its filter estimates.

    Of a constant or sinusoidal disturbance nothing is left in the regulated outputs. The disk margins are beside it:
    LQG guarantees none. Exit code 4: no controller could be vouched for.

    Example: robustlab synth lqg motor.h5 --outputs omega --q 1 --r 0.1 --disturbance constant --out controller.h5
    """
    import numpy as np

    model = signals.of(system)
    sizes = {"q": model.n_states, "r": model.n_inputs, "w": model.n_states, "v": model.n_outputs}
    weights = []
    for (name, size), given in zip(sizes.items(), (q, r, w, v), strict=True):
        values = np.atleast_1d(np.asarray(given, dtype=float))
        if len(values) not in (1, size):
            raise UsageError(name, f"{len(values)} numbers", f"one, or {size}")
        weights.append(np.diag(np.broadcast_to(values, (size,))))
    options: dict[str, Any] = {"disturbance": disturbance, "at": at, "channels": channels, "regulated": regulated}
    return rl.lqg(model, *weights, disturbance_noise=disturbance_noise, **options)


@door("synth tune", "tune", result="synthesis.fixed.goal_tuning.TunedSynthesis", gives="controller", made="controller")
def tune(
    system: Of,
    also: Annotated[
        list[Any] | None,
        Thing(("plant", "model", "uncertain", "any"), model=True, many=True, positional=True),
        "Further plants for the same controller.",
    ] = None,
    structure: Structure = "pid",
    goals: Annotated[
        Any,
        Goals(),
        'Made small: "tracking:response_time=1,error=0.01", "gain:bound=20,inputs=noise".',
        Named(option="--goal", in_step=...),
    ] = None,
    hard: Annotated[Any, Goals(hard=True), 'Must be met: "margin:disk=0.8,at=input".', Named(only="command")] = None,
    pole_limit: Annotated[
        dict[str, float] | None,
        Table(Number(above=0)),
        "Always kept by the loop's poles: damping=0.5, decay=1 (1/s), bandwidth=100 (rad/s).",
    ] = None,
    damping: Annotated[
        float | None, Number(above=0, most=1), "Least damping of the loop's poles.", Named(only="step")
    ] = None,
    decay: Annotated[
        float | None, Number(above=0), "Least decay rate of the loop's poles, in 1/s.", Named(only="step")
    ] = None,
    bandwidth: Annotated[
        float | None, Number(above=0), "Largest modulus of the loop's poles, in rad/s.", Named(only="step")
    ] = None,
    signals: Signals = ALL_SIGNALS,
    starts: Starts = 3,
    search: Search = USUAL,
    seed: Seed = 0,
    progress: Any = None,
) -> Any:
    """Controller u = K (r - y) of a given structure that meets hard goals and makes the others small.

    Goals: tracking, sensitivity, gain, rejection, variance, margin, overshoot (by a proxy); each is met where its value
    is at most 1. Exit code 4: a hard goal is missed, or no controller could be vouched for.

    Example: robustlab synth tune motor.h5 --structure pi --outputs omega --goal tracking:response_time=0.1
    """
    from robustlab.synthesis.laws.controller_structures import structure_in_words
    from robustlab.synthesis.nonsmooth.design_limits import Bandwidth, Damping, Decay
    from robustlab.synthesis.problem.partition import GeneralizedPlant

    models = [signals.of(model) for model in (system, *(also or []))]
    first = models[0]
    words = structure_in_words(structure, GeneralizedPlant(first, max(first.n_outputs, 1), max(first.n_inputs, 1)))
    known: dict[str, Any] = {"damping": Damping, "decay": Decay, "bandwidth": Bandwidth}
    given = {"damping": damping, "decay": decay, "bandwidth": bandwidth, **(pole_limit or {})}
    unknown = [name for name in given if name not in known]
    if unknown:
        raise UsageError("--pole-limit", repr(unknown[0]), f"one of {', '.join(known)}, each =NUMBER")
    limits = [known[name](value) for name, value in given.items() if value is not None]
    options: dict[str, Any] = {"starts": starts, "seed": seed, **search.options}
    return rl.tune(models, words, [*(goals or []), *(hard or []), *limits], progress=progress, **options)


# --- state feedback and estimators ------------------------------------------------------------------------------------

Weights = dict[str, float] | None
States = Annotated[Weights, Table(Number(least=0)), "Weights on states by name; 0 where left out.",
                   Named(option="--state-weight", key="states")]  # fmt: skip
ControlWeights = Annotated[Weights, Table(Number(above=0), "inputs"), "Weights on controls by name; 1 where left out.",
                           Named(option="--control-weight", key="controls")]  # fmt: skip


@door("synth lqr", "lqr", result="synthesis.h2.state_feedback.StateFeedback", gives="controller", made="controller")
def lqr(
    system: Of,
    states: Annotated[States, Named(option="--state-weight", key="states", in_step=...)] = None,
    controls: ControlWeights = None,
) -> Any:
    """State feedback u = -K x of least quadratic cost; all states are measured.

    The controller takes the states, by their names. Exit code 4: no gain could be vouched for.

    Example: robustlab synth lqr motor.h5 --state-weight omega=100 --control-weight u=0.1 --out k.h5
    """
    from robustlab.synthesis.h2.named_weights import integral_weights

    if not states:
        raise UsageError("lqr", "no state", "weights on states: which is to be small, and its weight")
    return rl.lqr(system, *integral_weights(system, {}, states, controls or {}))


@door("synth lqi", "lqi", result="synthesis.h2.integral_feedback.IntegralFeedback", gives="controller",
      made="controller")  # fmt: skip
def lqi(
    system: Of,
    integral: Annotated[
        Weights,
        Table(Number(above=0), "outputs"),
        "Outputs that are to follow, with the weights on their integrated errors.",
        Named(in_step=...),
    ] = None,
    states: States = None,
    controls: ControlWeights = None,
) -> Any:
    """State feedback with integral action: outputs follow constant references without error; the loop is rebuilt.

    All states are measured. The controller takes references, followed outputs and states; it is made for export, not
    for `close-loop`. Exit code 4: no controller could be vouched for.

    Example: robustlab synth lqi motor.h5 --integral omega=100 --control-weight u=0.1 --out k.h5
    """
    from robustlab.synthesis.h2.named_weights import integral_weights

    if not integral:
        raise UsageError("lqi", "no output", "integral: which output follows, and its weight")
    Q, R = integral_weights(system, integral, states or {}, controls or {})
    return rl.lqi(system, Q, R, outputs=list(integral))


@door("synth kalman", "kalman", result="synthesis.h2.kalman_filter.KalmanFilter", gives="model", made="estimator")
def kalman(
    system: Of,
    process: Annotated[
        Weights,
        Table(Number(least=0)),
        "Intensities of the noise on states, or on inputs, by name.",
        Named(option="--process-noise", key="process", in_step=...),
    ] = None,
    measurement: Annotated[
        Weights,
        Table(Number(least=0), "outputs"),
        "Intensities of the noise on each output by name; discrete: variances.",
        Named(option="--measurement-noise", key="measurement", in_step=...),
    ] = None,
) -> Any:
    """Steady-state Kalman filter: from inputs and measured outputs to estimated states; checked by a second equation.

    White noise; of a discrete model the numbers are variances. Exit code 4: no filter could be vouched for.

    Example: robustlab synth kalman motor.h5 --process-noise u=0.04 --measurement-noise omega=1e-4 --out filter.h5
    """
    from robustlab.synthesis.h2.named_weights import diagonal_weight, process_noise

    W = process_noise(system, process or {}, "process")
    return rl.kalman(system, W, diagonal_weight(measurement or {}, system.output_names, "measurement"))


# --- smaller, digital -------------------------------------------------------------------------------------------------


@door("synth reduce", "reduce-controller", result="synthesis.reduction.controller_reduction.ReducedController",
      gives="controller", made="controller")  # fmt: skip
def reduce_controller(
    plant: Plant,
    controller: K,
    loss: Annotated[float, Number(least=0, most=10), "Largest loss allowed, as a share."] = 0.01,
    order: Annotated[Order, "States of the result, whatever it loses."] = None,
    measure: Annotated[str, Choice(("hinf", "h2", "mu")), "mu: robust performance, with the plant's Delta."] = "hinf",
    channels: LoopChannels = AS_CONTROLLER,
    search: Search = USUAL,
    progress: Any = None,
) -> Any:
    """Controller of the lowest order whose closed loop, rebuilt and proved anew, loses no more than a stated share.

    Exit code 4: no controller of the order wanted could be vouched for.

    Example: robustlab synth reduce plant.h5 controller.h5 --loss 0.02 --out small.h5
    """
    P = channels.around(plant, controller, "reduce-controller", False if measure == "mu" else None)
    given: Any = measure
    return rl.reduce_controller(
        P, controller, loss=loss, order=order, measure=given, progress=progress, **search.options
    )


Method = Annotated[
    str,
    Choice(("auto", "direct", "tustin", "tustin-prewarp", "zoh", "foh", "impulse", "matched")),
    "Formula, or a design for the sampled plant.",
]


@door("synth discretise", "discretise", result="synthesis.sampled.sampled_robustness.RobustSampledController",
      gives="controller", made="controller")  # fmt: skip
def discretise(
    plant: Annotated[
        Plant, "The problem or generalised plant that the controller was designed for.", Named(key="plant")
    ],
    controller: Annotated[K, Named(key="of")],
    dt: SampleTime,
    method: Method = "auto",
    loss: Annotated[
        float, Number(least=0, most=100), "Share of the norm from which on auto designs for the sampled plant."
    ] = 0.1,
    delay: Annotated[float, Number(least=0), "Computation delay in s."] = 0.0,
    antialiasing: Annotated[float | None, Number(above=0), "Corner of a filter before the sampler in rad/s."] = None,
    prewarp: Annotated[
        float | None, Number("rad/s", above=0), "rad/s; the peak of the continuous loop where left out."
    ] = None,
    channels: LoopChannels = AS_CONTROLLER,
    search: Search = USUAL,
    seed: Seed = 0,
    progress: Any = None,
) -> Any:
    """Digital form of a controller, with the proved norm of the sampled loop, between samples too, and what it loses.

    Of an uncertain plant the norm is that of the nominal loop, and mu of robust performance is proved for the sampled
    loop as well, beside that of the continuous one.

    Exit code 1: it loses more than --loss. Exit code 4: no method left the sampled loop stable.

    Example: robustlab synth discretise plant.h5 controller.h5 --dt 0.01 --out digital.h5
    """
    import math

    from robustlab.synthesis.sampled.sampled_robustness import RobustSampledController

    P = channels.around(plant, controller, "discretise")
    given: Any = method
    options: dict[str, Any] = {**search.options}
    found = rl.discretise(
        controller, dt, given, plant=_at_rest(P), loss=loss, delay=delay, antialiasing=antialiasing, prewarp=prewarp,
        progress=progress, **options,
    )  # fmt: skip
    if not P.blocks:
        return found
    options["seed"] = seed
    loop = rl.UncertainModel(P.model, P.blocks).close(controller)
    before = rl.robust_performance(loop, accuracy=1e-3, tolerance=math.inf, **options)
    judged = {"delay": delay, "antialiasing": antialiasing, "progress": progress}
    after = rl.sampled_robustness(P, found.K, **judged, **options)
    status = max((found.status, before.status, after.status), key=list(rl.Status).index)
    robust = RobustSampledController(**{**vars(found), "status": status}, before=before, after=after)
    return InLoop(robust, "", (), {"robustness": after})


def _at_rest(plant: Any) -> Any:
    """The generalised plant at Delta = 0."""
    from robustlab.synthesis.problem.partition import GeneralizedPlant

    nominal = rl.UncertainModel(plant.model, plant.blocks).nominal
    return GeneralizedPlant(nominal, plant.n_meas, plant.n_con) if plant.blocks else plant


def _one_measure(order: int | None, tolerance: float | None) -> None:
    if (order is None) == (tolerance is None):
        raise InputError("reduce_model", f"order={order}, tolerance={tolerance}", "one of the two")


@door("model reduce", "reduce-model", result="synthesis.reduction.reduced_model.ReducedModel", gives="model",
      made="model", foretell="of", check=_one_measure)  # fmt: skip
def reduce_model(
    system: Of,
    order: Annotated[Order, "States of the result."] = None,
    tolerance: Annotated[
        float | None,
        Number(above=0),
        "In place of the order: largest error, as it is told.",
        Named(option="--max-error"),
    ] = None,
    method: Annotated[
        str,
        Choice(("truncation", "residualisation", "hankel", "stochastic", "coprime")),
        "stochastic: relative error; coprime: unstable modes too.",
    ] = "truncation",
    input_weight: Annotated[Any, Thing(("model", "any")), "A stable model W_i: the error is W_o (G - Gr) W_i."] = None,
    output_weight: Annotated[Any, Thing(("model", "any")), "The same for W_o."] = None,
    band: Band = None,
    floor: Annotated[float, Number(least=0), "Of stochastic: gain below which errors count absolutely."] = 0.0,
) -> Any:
    """A model of lower order, with its certified error beside what theory promises.

    Modes that are not stable are kept, or reduced too with the method coprime.
    Exit code 4: the error cannot be vouched for, or the model of that order is not stable.

    Example: robustlab model reduce plant.h5 --max-error 0.01 --out small.h5
    """
    given: Any = method
    return rl.reduce_model(
        system, order, tolerance=tolerance, method=given, band=band, floor=floor, input_weight=input_weight,
        output_weight=output_weight,
    )  # fmt: skip


Hold = Annotated[str, Choice(("zoh", "foh", "tustin")), "What is held between the samples."]
RESAMPLED = "synthesis.sampled.resampling.Resampled"


@door("model discretise", result="statespace.StateSpaceModel", gives="model")
def discretise_by_formula(
    system: Annotated[Any, Thing(("plant", "model", "any")), "HDF5 or .mat file.", Named(key="of")],
    dt: SampleTime,
    method: Annotated[
        str,
        Choice(("tustin", "tustin-prewarp", "zoh", "foh", "impulse", "matched")),
        "The formula.",
    ] = "tustin",
    prewarp: Annotated[
        float | None, Number("rad/s", above=0), "Of tustin-prewarp: frequency in rad/s where it is exact."
    ] = None,
) -> Any:
    """A discrete model of a continuous one, by formula.

    A model with exact delays at inputs and outputs takes zoh, which is exact.
    What a loop loses by it is what "synth discretise" computes.

    Example: robustlab model discretise motor.h5 --dt 0.001 --method zoh --out motor-1ms.h5
    """
    from robustlab.statespace import as_model
    from robustlab.synthesis.sampled.discretisation import merged_modes

    late = isinstance(system, rl.DelayedModel)
    model: Any = system if late else as_model(system, "model discretise")
    given: Any = method
    found = rl.discretise(model, dt, given, prewarp=prewarp)
    return InLoop(found, notes=tuple(f"warning: {pair}" for pair in merged_modes(model.H if late else model, dt)))


@door("model d2c", result=RESAMPLED, gives="model", made="model")
def d2c(system: Of, method: Hold = "zoh") -> Any:
    """A continuous model of a discrete one, with the error with which discretising gives it back.

    Exit code 4: there is none (a pole on the negative real axis), or digits were lost.

    Example: robustlab model d2c sampled.h5 --out plant.h5
    """
    given: Any = method
    return rl.d2c(system, given)


@door("model d2d", result=RESAMPLED, gives="model", made="model")
def d2d(system: Of, dt: SampleTime, method: Hold = "zoh") -> Any:
    """A discrete model with another sample time; a whole multiple needs no continuous model on the way.

    Exit code 4: there is none, or digits were lost.

    Example: robustlab model d2d fast.h5 --dt 0.01 --out slow.h5
    """
    given: Any = method
    return rl.d2d(system, dt, given)


def _foretold_loop(step: Any, ahead: Any) -> Any:
    """References in; the outputs and the control signals out."""
    inputs, outputs = ahead[step.of].inputs, ahead[step.of].outputs
    if inputs is None or outputs is None:
        return ahead[None]
    references = {f"{name}_ref": unit for name, unit in outputs.items()}
    return replace(ahead[None], inputs=references, outputs={**outputs, **inputs})


@door("model close", "close-loop", result="synthesis.specifications.tracking_loop.ClosedLoop", gives="uncertain",
      made="model", foretell=_foretold_loop)  # fmt: skip
def close_loop(
    system: Annotated[Any, Thing(("plant", "model", "uncertain", "any")), "HDF5 or MATLAB file.", Named(key="of")],
    controller: Annotated[Any, Thing(("controller", "any")), "File with the controller."],
    sign: Annotated[Sign, Named(option="--feedback")] = None,
) -> Any:
    """The tracking loop of a controller around a model: reference in, the controlled outputs and controls out.

    Example: robustlab model close motor.h5 k.h5 --out loop.h5
    """
    from robustlab.synthesis.specifications.tracking_loop import close_loop as closed

    given: Any = sign
    return closed(system, controller, given)


# --- scheduling -------------------------------------------------------------------------------------------------------

Scheduled = Annotated[
    Any, Thing(("uncertain", "model", "any")), "Uncertain model with real parameters, or an LPV model.", Named(key="of")
]
Points = Annotated[
    dict[str, int] | None,
    Table(Whole(2, 100), words="NAME=NUMBER"),
    "Parameter -> how many points its range gets; 2 where left out.",
    Named(option="--grid", key="points"),
]
Rates = Annotated[
    dict[str, float] | None,
    Table(Number(least=0)),
    "Parameter -> bound of its rate per second; any rate where left out.",
    Named(option="--rate", key="rates"),
]
Lyapunov = Annotated[
    str | None, Choice(("constant", "varying")), "Lyapunov matrix; both, as far as rates are bounded, where left out."
]


def _scheduled(system: Any, points: dict[str, int] | None, rates: dict[str, float] | None) -> Any:
    """The LPV model, or that of an uncertain one."""
    if isinstance(system, rl.UncertainModel):
        return rl.lpv_model(system, points, rates)
    if not isinstance(system, rl.LPVModel):
        raise InputError("lpv", f"a {type(system).__name__}", "an LPV or an uncertain model")
    if points:
        raise InputError("points", "given", "none: the LPV model has its own")
    return system.with_rates(**(rates or {}))


@door("lpv build", "lpv", result="synthesis.scheduling.parameter_varying.LPVModel", gives="any")
def lpv_model(system: Scheduled, points: Points = None, rates: Rates = None) -> Any:
    """LPV model of an uncertain one: its real parameters become measured ones; what it is between the points is proved.

    Example: robustlab lpv build spring.h5 --grid k=5 --rate k=0.5 --out lpv.h5
    """
    return _scheduled(system, points, rates)


@door("lpv gain", "lpv-gain", result="synthesis.scheduling.induced_gain.LPVGain")
def lpv_gain(
    system: Scheduled,
    points: Points = None,
    rates: Rates = None,
    lyapunov: Lyapunov = None,
    search: Search = USUAL,
) -> Any:
    """Induced L2 gain over all trajectories of measured parameters, proved between the points too.

    Exit code 4: none could be proved.

    Example: robustlab lpv gain lpv.h5 --rate k=0.5
    """
    given: Any = lyapunov
    return rl.peak_gain(_scheduled(system, points, rates), lyapunov=given, **search.options)


@door("lpv hinf", "lpv-hinf", result="synthesis.scheduling.scheduled_synthesis.LPVSynthesis", gives="controller",
      made="controller")  # fmt: skip
def lpv_hinf(
    system: Scheduled,
    measurements: Annotated[int, Whole(1), "How many of the last outputs are measured."],
    controls: Annotated[int, Whole(1), "How many of the last inputs are controls."],
    points: Points = None,
    rates: Rates = None,
    lyapunov: Lyapunov = None,
    search: Search = USUAL,
    progress: Any = None,
) -> Any:
    """Scheduled H-infinity controller u = K(rho) y (positive feedback), its loop verified for all trajectories.

    Exit code 4: no controller could be vouched for.

    Example: robustlab lpv hinf plant.h5 --measurements 1 --controls 1 --out controller.h5
    """
    given: Any = lyapunov
    options: dict[str, Any] = {**search.options, "progress": progress}
    return rl.hinf(_scheduled(system, points, rates), measurements, controls, lyapunov=given, **options)


@door("lpv at", "lpv-at", result="statespace.StateSpaceModel", gives="model")
def lpv_at(
    system: Annotated[Any, Thing(("any",)), "LPV model or scheduled controller: HDF5 file.", Named(key="of")],
    values: Annotated[dict[str, float] | None, Table(Number()), "Value of each parameter.", Named(option="*")] = None,
) -> Any:
    """The model or the controller at one value of every parameter.

    Example: robustlab lpv at controller.h5 k=2.5 --out frozen.h5
    """
    from robustlab.synthesis.scheduling.scheduled_controller import LPVController

    if not values:
        raise UsageError("lpv at", "no values", "one of each parameter: NAME=VALUE")
    if not isinstance(system, (rl.LPVModel, LPVController)):
        raise InputError("lpv at", f"a {type(system).__name__}", "an LPV model or a scheduled controller")
    return system.at(values or {})
