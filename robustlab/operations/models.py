"""Operations that make, check and compare models and sets."""

from __future__ import annotations

import warnings
from typing import Annotated, Any, Literal

import robustlab as rl
from robustlab.errors import InputError, UsageError
from robustlab.operations.common_parameters import Controller, Model, Outputs, Sign, System
from robustlab.operations.declaration import InLoop, operation, public
from robustlab.operations.parameter_types import (
    Choice,
    Ends,
    Flag,
    Keyed,
    Names,
    Number,
    Numbers,
    Pair,
    Share,
    Table,
    TextFile,
    Thing,
    Whole,
    bounded,
)

COVERS = (
    "elements", "pca", "additive", "input-multiplicative", "output-multiplicative", "inverse-additive",
    "inverse-input-multiplicative", "inverse-output-multiplicative",
)  # fmt: skip
EXACT = 1e-12  # largest error of the ends of an element-wise set, relative to the largest entry
NOTHING = "no uncertainty: mu = 0"
BUILT: Any = {"result": "uncertainty.elementwise.BuiltModel", "gives": "uncertain", "made": "model"}
ANY = ("plant", "model", "uncertain", "any")
PLANT = "Name of the plant (dc-motor), file.py:name, or an HDF5 file with one."
Plant = Annotated[Any, Thing(("plant",), settings=True), PLANT]
Part = Annotated[
    list[Any], Thing(("plant", "model", "uncertain", "controller", "any"), many=True), "Files, nominal or uncertain."
]


class Rest(Table):
    """The equilibrium of a nonlinear plant: values by name; in a recipe also the six numbers of a pose."""

    def field(self) -> Any:
        return bounded(list[float], min_length=6, max_length=6) | dict[str, float]

    def of_field(self, given: Any) -> Any:
        return given


At = Annotated[
    Any,
    Rest(),
    "Equilibrium of a nonlinear plant: input, output or state, NAME=VALUE; repeatable. In a recipe a pose, too: tx, ty,"
    " tz in m, ax, ay, az in rad.",
]
Pose = Annotated[
    tuple[float, ...] | None,
    Numbers("", 6, metavar="TX,TY,TZ,AX,AY,AZ", only="command"),
    "Pose of a platform in m and rad; home if left out.",
]


def at_rest(plant: Any, at: Any, pose: Any) -> Any:
    """Return the pose or the values of the equilibrium; None for the plant's own."""
    from robustlab.dynamics.plant_base import NonlinearPlant, SteppedPlant

    if pose is not None and at:
        raise UsageError("pose", "--pose and --at", "one of them")
    if (at or pose) and (not isinstance(plant, NonlinearPlant) or isinstance(plant, SteppedPlant)):
        raise UsageError("at", f"{plant.name} has one linear model", "it for a nonlinear plant only")
    return list(pose) if pose is not None else at


@operation("model build", "linearise", result="statespace.StateSpaceModel", gives="model", infer=("of", "of"))
def linearise(
    plant: Plant,
    at: At = None,
    pose: Pose = None,
    outputs: Outputs = None,
    amplitude: Annotated[
        dict[str, float] | None, Table(Number()), "Amplitude of the speed or signal at an effect's place, NAME=VALUE."
    ] = None,
    pade: Annotated[int, Whole(0, 40), "Order of the Pade approximation of delays; 0: left out."] = 0,
) -> Any:
    """The linear state-space model of a plant; states that the kept outputs do not show are removed.

    Example: robustlab model build dc-motor --set R=2.2 --out motor.h5
    """
    from robustlab.dynamics.plant_base import NonlinearPlant, SteppedPlant
    from robustlab.linear_analysis.structural import drop_unconnected

    if pose is not None and at:
        raise UsageError("model build", "--pose and --at", "one of them")
    if at and not isinstance(plant, NonlinearPlant):
        raise UsageError("at", f"a rest of {plant.name}, which is linear", "none: the model is the same everywhere")
    point = rl.trim(plant, **at) if isinstance(at, dict) else list(pose) if pose is not None else at
    model = rl.linearise(plant, at=point, amplitude=amplitude or {}, pade=pade)
    if outputs is not None:
        model = drop_unconnected(model.select(outputs=outputs))
    missing = plant.left_out(point, amplitude or {}, pade) if isinstance(plant, SteppedPlant) else ()
    notes = tuple(f"not in it: {m.effect.effect.title} at {m.effect.site}: {m.reason}" for m in missing)
    return InLoop(model, notes=notes, extras=_place(at, pose))


def _place(at: Any, pose: Any) -> dict[str, str]:
    if isinstance(at, dict) and at:
        return {"rest": ", ".join(f"{name} = {value:g}" for name, value in at.items())}
    given = pose if pose is not None else at
    return {"pose": ", ".join(f"{value:g}" for value in given)} if given is not None else {}


@operation("model check", "structural", result="linear_analysis.structural.Structure")
def check(system: System) -> Any:
    """Poles, stability, controllability and observability of a model.

    Of a model with exact delays: whether it is stable, proved for all frequencies either way.
    Exit code 4: neither could be shown.

    Example: robustlab model check motor.h5
    """
    if isinstance(system, rl.DelayedModel):
        from robustlab.mu_analysis.margins.delayed_models import delay_stability

        return delay_stability(system)
    from robustlab.dynamics.plant_base import Plant as AnyPlant
    from robustlab.linear_analysis.structural import structure

    return structure(rl.linearise(system) if isinstance(system, AnyPlant) else system)


public(
    "linear_analysis.frequency.steady_state", "", "steady-state", result="linear_analysis.frequency.SteadyState",
    kinds={
        "model": Model, "inputs": (Table(Number(), "inputs"), "Constant inputs: { u = 42 }."), "outputs": Outputs,
    },
)  # fmt: skip


@operation("model diff", "difference", result="storage.matrices.Difference")
def diff(
    first: Annotated[Any, Thing(ANY, model=True, pair=True), "HDF5 or MATLAB file."],
    second: Annotated[
        Any,
        Thing(ANY, model=True, positional=True, key="beside"),
        "The other model; omit it if the first file contains a nominal and a perturbed model.",
    ] = None,
) -> Any:
    """The entries in which two models differ.

    Example: robustlab model diff nominal.h5 perturbed.h5
    """
    from robustlab.storage.matrices import difference

    return difference(*two_models(first, second))


def two_models(first: Any, second: Any) -> tuple[Any, Any]:
    if isinstance(first, Pair):
        if second is not None:
            raise UsageError("two models", "a file of two and another one", "one of them")
        return first
    if second is None:
        raise UsageError("two models", "one model", "another file, or one that holds /nominal and /perturbed")
    return Thing(model=True).as_wanted(first, "nominal"), second


# --- sets -------------------------------------------------------------------------------------------------------------


@operation("uncertain build", "elementwise", **BUILT, infer=("nominal", "nominal"))
def elementwise(
    nominal: Annotated[
        Any, Thing(ANY, pair=True, key="nominal"), "Nominal model; or one file with groups nominal and perturbed."
    ],
    perturbed: Annotated[
        Any, Thing(ANY, model=True, positional=True), "Maximally perturbed model of the same signals."
    ] = None,
    structure: Annotated[
        Literal["elements", "columns", "rows", "matrices", "single", "cover"],
        "Entries that vary together; cover: a full block for each matrix, which contains every element-wise member.",
    ] = "elements",
) -> Any:
    """Uncertain model from a nominal model and a maximally perturbed one.

    Example: robustlab uncertain build nominal.h5 perturbed.h5 --structure elements --out uncertain.h5
    """
    from robustlab.uncertainty.elementwise import BuiltModel, elementwise_cover, endpoint_residual, pair_remarks

    first, second = two_models(nominal, perturbed)
    notes = tuple(f"warning: {remark}" for remark in pair_remarks(first, second))
    if structure == "cover":
        note = "Contains every member of the element-wise set: what is proved for it is proved for them."
        return BuiltModel(elementwise_cover(first, second), structure, rl.Status.CERTIFIED, notes=(note, *notes))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # repeated in the notes
        model = rl.elementwise(first, second, structure)
    residual = endpoint_residual(model, second)
    status = rl.Status.CERTIFIED if residual <= EXACT else rl.Status.INACCURATE
    found = BuiltModel(model, structure, status, residual, ends=(first, second))
    return InLoop(found, notes=notes if model.blocks or notes else (NOTHING,))


@operation("uncertain plant", "uncertain", **BUILT, infer=("of", "of"))
def uncertain(
    plant: Annotated[Plant, "A plant: its name, file.py:name, or HDF5 file."],
    tolerances: Annotated[
        dict[str, Any] | None,
        Table(Share(above=0, below=1), "parameters", option="--tolerance"),
        "Relative tolerance of a plant's parameter, Km=0.05 or Km=5%; repeatable.",
    ] = None,
    ranges: Annotated[
        dict[str, Any] | None,
        Table(Ends(), "parameters", metavar="NAME=LOW:HIGH", option="--range"),
        "Ends of a parameter of the plant around its value, NAME=LOW:HIGH; repeatable.",
    ] = None,
    own: Annotated[bool, Flag(in_step=False), "Keep the plant's own tolerances of the other parameters."] = True,
    outputs: Outputs = None,
    at: At = None,
    pose: Pose = None,
    hold: Annotated[
        list[str] | None, Names(), "States and inputs of a nonlinear plant that are constant while parameters change."
    ] = None,
) -> Any:
    """Uncertain model of a plant: each parameter varies in a range, or by a share of its value, 0.05 or 5%.

    Example: robustlab uncertain plant dc-motor --tolerance Kf=5% --out motor.h5
    """
    from robustlab.dynamics.plant_base import NonlinearPlant, SteppedPlant
    from robustlab.uncertainty.elementwise import BuiltModel

    nominal, shares, ends = plant.values, tolerances or {}, ranges or {}
    for name in shares:
        if name not in nominal and name not in plant.parameters:
            raise UsageError(f"tolerance {name}", f"no such parameter of {plant.name}", f"one of {', '.join(nominal)}")
    if hasattr(plant, "effects"):
        raise UsageError("uncertain plant", f"{plant.name} carries effects", "uncertain discovery, which takes it")
    exact = {} if own else {name: (p.value, 0.0) for name, p in plant.parameters.items()}
    made: Any = plant.with_parameters(**{**exact, **{n: (nominal.get(n, 1.0), share) for n, share in shares.items()}})
    options: dict[str, Any] = {"at": at_rest(made, at, pose), "hold": hold, "ranges": ends}
    if hold and (not isinstance(made, NonlinearPlant) or isinstance(made, SteppedPlant)):
        raise UsageError("hold", f"{plant.name} has one linear model", "it for a nonlinear plant only")
    model = made.uncertain(outputs, **{name: value for name, value in options.items() if value})
    without = ", ".join(sorted({*shares, *ends} - {b.name for b in model.blocks}))
    notes = (f"without effect on the linear model: {without}" if without else "", "" if model.blocks else NOTHING)
    return InLoop(BuiltModel(model, "parameters", None), notes=(*model.remarks, *filter(None, notes)))


@operation("uncertain expressions", **BUILT)
def expressions(file: Annotated[str, TextFile(), "TOML file with A, B, C, D in named parameters."]) -> Any:
    """Uncertain model from matrices of expressions in parameters with ranges.

    Example: robustlab uncertain expressions springs.toml --out springs.h5
    """
    from robustlab.storage.interchange import load_parametric
    from robustlab.uncertainty.elementwise import BuiltModel

    model = load_parametric(file)
    return InLoop(BuiltModel(model, "parameters", None), notes=() if model.blocks else (NOTHING,))


@operation(
    "uncertain cover", "cover-models", result="mu_analysis.margins.uncertainty_cover.Cover", gives="uncertain",
    made="model", infer=("", "of models"), numbers={"loads": {"*": float}},
    public="mu_analysis.margins.uncertainty_cover.cover",
    kinds={
        "form": (Choice(COVERS), "Of the cover."), "tolerance": Number(least=0, below=1, only="step"),
        "gain": (Flag(only="step", key="conservatism"), "Compare the worst gain of the cover with that of the set."),
    },
)  # fmt: skip
def cover(
    models: Annotated[
        Any, Thing(ANY, model=True, many=True, positional=True, key="models"), "Models to cover; at least two."
    ] = None,
    plant: Annotated[
        Any, Thing(("plant", "any"), key="of", only="step"), "A mechanism, linearised at each of `poses`."
    ] = None,
    poses: Annotated[
        Any, Keyed(list[list[float]], only="step"), "Operating points: tx, ty, tz in m, ax, ay, az in rad."
    ] = (),
    *,
    controller: Annotated[
        Controller | None, "A controller, with its sign: the cover's worst gain is that of its loop."
    ] = None,
    sign: Sign = None,
    **options: Any,
) -> Any:
    """The smallest uncertain model of a form that contains a set of models, with its conservatism.

    In a recipe the set may be one plant linearised at several poses. Of a plant with effects, as after `discover`,
    those that have no linear model (dry friction) become bounded inputs ("load *"), exact for every motion: a tracking
    problem takes them as loads.

    Example: robustlab uncertain cover unit1.h5 unit2.h5 unit3.h5 --form pca --out set.h5
    """
    if sign is not None and controller is None:
        raise UsageError("--feedback", "without --controller", "a controller to close the loop with")
    if (plant is None) != (not poses):
        raise InputError("cover", "one of them", "of and poses belong together")
    at_poses = [_at_pose(plant, pose) for pose in poses]
    models = [*(models or ()), *(model for model, _ in at_poses)]
    loop, words = None, ""
    if controller is not None:
        from robustlab.feedback import feedback_loop

        around, closed, words = feedback_loop(models[0], controller, sign, "cover", None)
        loop = lambda g: g.feedback(around, closed)  # noqa: E731
    found = rl.cover(models, loop=loop, **options)
    loads = at_poses[0][1] if at_poses else ()
    numbers = {"loads": {load.name: load.bound for load in loads}}
    return InLoop(found, words, tuple(load.in_words for load in loads), numbers=numbers)


def _at_pose(plant: Any, pose: list[float]) -> tuple[Any, tuple[Any, ...]]:
    """Linearise a plant at a pose; return the model with the effects' loads before its inputs, and the loads."""
    from robustlab.dynamics.extended.effect_blocks import loaded_model
    from robustlab.dynamics.extended.extended_plant import ExtendedPlant

    at = rl.trim(plant, pose=pose)
    return loaded_model(plant, at) if isinstance(plant, ExtendedPlant) else (rl.linearise(plant, at=at), ())


@operation(
    "uncertain discovery", "uncertain-from", result="dynamics.extended.effect_blocks.EffectBlocks", gives="uncertain",
    made="model", infer=("", "of"), public="identification.missing_effects.updated_plant.uncertain_from",
    kinds={
        "amplitude": (
            Table(Ends(least=0, single=True)),
            "Amplitude of a speed or signal at which effects are described, or LOW:HIGH, NAME=VALUE; repeatable.",
        ),
        "dry": (
            Choice(("gain", "load", "both")),
            "Bounded forces: load, an exact input; gain, of the describing function, as with an amplitude; or both.",
        ),
    },
)  # fmt: skip
def uncertain_from(
    discovery: Annotated[
        Any, Thing(("plant", "any"), discovery=True), "Folder of data discover --out, or its updated plant."
    ],
    outputs: Outputs = None,
    **options: Any,
) -> Any:
    """Uncertain model of the effects and the residual of a discovery; each block has its origin.

    Example: robustlab uncertain discovery found/ --amplitude v=0.05 --out set.h5
    """
    try:
        return rl.uncertain_from(discovery, outputs, **options)
    except InputError as error:
        if "amplitude" in (error.expected or "") and error.hint:
            raise UsageError("uncertain_from", error.found, "--amplitude NAME=VALUE for it", error.hint) from None
        raise
