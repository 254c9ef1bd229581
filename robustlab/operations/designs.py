"""Operations of controller design."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any

import robustlab as rl
from robustlab.errors import InputError, UsageError
from robustlab.operations.declaration import InLoop, Named, operation
from robustlab.operations.kinds import ByNumber, Choice, Flag, Kind, Names, Number, Thing, Weight, Whole
from robustlab.operations.words import Design, Model, Search, Seed, Signals

DESIGN, HINF = "synthesis.problem.design.", "synthesis.hinf."
Plant = Annotated[Design, "Generalised plant, tracking problem, plant or uncertain model.", Named(key="of")]
Of = Annotated[Model, Named(key="of")]
K = Annotated[Any, Thing(("controller", "any"), model=True), "File with the controller."]
Channel = Annotated[Any, ByNumber()]
Measured = Annotated[Channel, "Measured outputs by name, or how many of the last; a tracking problem knows its own."]
Controls = Annotated[Channel, "Control inputs by name, or how many of the last; a tracking problem knows its own."]


@dataclass(frozen=True)
class Channels:
    """The inputs and outputs of a system that a design uses."""

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
        """Return the generalised plant: of a tracking problem its own, else with channels by number or by name."""
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
# By default a tracking problem is taken at Delta = 0; all of an uncertain model's Delta counts as one full block.
NominalProblem = Annotated[
    bool | None, Flag(), "At Delta = 0; left out so of a tracking problem; else all of Delta counts as one full block."
]
GammaRel = Annotated[
    float,
    Number(least=1, most=10),
    "Allowed ratio to the smallest gamma; within it the controller of lowest bandwidth is chosen.",
]
Structure = Annotated[
    str,
    Kind(),
    "static, p, i, pi, pd, pid (one per channel), order:N, poles:-1,-20, ipd or two-layer (with :full, :diagonal, "
    ":scalar), decentralised:WORD.",
]
Order = Annotated[int | None, Whole(0, 1000)]


def _design(found: Any, system: Any = None, proved: bool = True, drawn: bool = False) -> Any:
    """Return a design, with the loop of a tracking problem against its weights where that is drawn."""
    from robustlab.synthesis.specifications.tracking_problem import TrackingLoop, TrackingProblem

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


@operation("synth h2", "h2", result="synthesis.h2.h2_synthesis.H2Synthesis", gives="controller", made="controller")
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


@operation("synth dk", "dk", result="synthesis.dk.dk_design.DKSynthesis", gives="controller", made="controller")
def dk(
    system: Plant,
    *,
    channels: Channels,
    blocks: Annotated[
        str | None,
        Kind(),
        'Blocks of Delta as rows "r,c" separated by ";" (-r,0 real repeated, r,0 complex repeated, r,c full); those of '
        "the uncertain model where left out.",
    ] = None,
    start: Annotated[Any, Thing(("controller", "any")), "Stabilising controller to start from."] = None,
    direct: Annotated[bool, Flag(), "Continue with direct minimisation after D-K iteration."] = True,
    mixed: Annotated[bool, Flag(), "Use that real blocks are real."] = True,
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
    """Robust controller u = K y (positive feedback): makes the peak of mu small, by D-K iteration and directly.

    The blocks of an uncertain plant are known; the other channels of w and z are the performance. gamma is an upper
    bound of mu at all frequencies. Exit code 4: no controller could be verified.

    Example: robustlab synth dk uncertain.h5 --measurements y --controls u --figure design.svg --out controller.h5
    """
    rows = None if blocks is None else _rows(blocks)
    found = rl.dk(
        channels.posed(system, "dk"), rows, K0=start, direct=direct, mixed=mixed, max_order=max_order,
        order_rel=order_rel, progress=progress, **vars(search),
    )  # fmt: skip
    return _design(found, system, proved=False, drawn=drawn)


def _rows(text: str) -> list[list[int]]:
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
    objective: Annotated[str, Choice(("hinf", "h2")), "The norm that is made small."] = "hinf",
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
    found = rl.fixed_structure(
        P, structure, objective=objective, starts=starts, seed=seed, progress=progress, **vars(search)
    )
    return _design(found, system, nominal and objective == "hinf", drawn)


# --- plain models -----------------------------------------------------------------------------------------------------


@operation("synth mixsyn", "mixsyn", result=DESIGN + "HinfSynthesis", gives="controller", made="controller")
def mixsyn(
    system: Of,
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
    system: Of,
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
