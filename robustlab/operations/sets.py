"""Operations that make uncertain models: from two models, a plant's ranges, expressions, models, a discovery."""

from __future__ import annotations

import warnings
from dataclasses import replace
from typing import Annotated, Any

import robustlab as rl
from robustlab.errors import InputError, UsageError
from robustlab.operations.declaration import InLoop, Named, operation
from robustlab.operations.kinds import (
    Choice,
    Flag,
    Names,
    Number,
    Quantity,
    Share,
    Table,
    TextFile,
    Thing,
    Whole,
    in_units,
)
from robustlab.operations.models import At, Plant, Pose, at_rest, left_out, two_models
from robustlab.operations.words import Controller, Outputs, Search, Sign

STRUCTURES = ("elements", "columns", "rows", "matrices", "single", "cover")
COVERS = (
    "elements", "pca", "additive", "input-multiplicative", "output-multiplicative", "inverse-additive",
    "inverse-input-multiplicative", "inverse-output-multiplicative",
)  # fmt: skip
EXACT = 1e-12  # largest error of the ends of an element-wise set, relative to the largest entry
ANY = ("plant", "model", "uncertain", "any")
NOTHING = "no uncertainty: mu = 0"


@operation(
    "uncertain build",
    "elementwise",
    result="uncertainty.elementwise.BuiltModel",
    gives="uncertain",
    made="model",
    infer="nominal",
)
def elementwise(
    nominal: Annotated[Any, Thing(ANY, pair=True), "Nominal model; or one file with groups nominal and perturbed."],
    perturbed: Annotated[
        Any, Thing(ANY, model=True, positional=True), "Maximally perturbed model of the same signals."
    ] = None,
    structure: Annotated[
        str,
        Choice(STRUCTURES),
        "Entries that vary together; cover: a full block for each matrix, which contains every element-wise member.",
    ] = "elements",
    rtol: Annotated[
        float | None, Number(least=0, below=1), "Relative differences up to this are noise; none where left out."
    ] = None,
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
        model = rl.elementwise(first, second, structure, rtol)
    residual = endpoint_residual(model, second)
    status = rl.Status.CERTIFIED if residual.largest <= EXACT else rl.Status.INACCURATE
    if rtol and not status.trustworthy:
        status = rl.Status.CONVERGED  # within rtol
    found = BuiltModel(model, structure, status, residual, ends=(first, second))
    return InLoop(found, notes=notes if model.blocks or notes else (NOTHING,))


@operation("uncertain plant", "uncertain", result="uncertainty.elementwise.BuiltModel", gives="uncertain", made="model",
      infer="of")  # fmt: skip
def uncertain(
    plant: Annotated[Plant, "A plant: its name, file.py:name, or HDF5 file.", Named(key="of")],
    tolerances: Annotated[
        dict[str, Any] | None,
        Table(Share(above=0, below=1), "parameters"),
        "Relative tolerance of a plant's parameter, Km=0.05 or Km=5%; repeatable.",
        Named(option="--tolerance"),
    ] = None,
    ranges: Annotated[
        dict[str, Any] | None,
        Table(Quantity("must"), "parameters", words="NAME=LOW:HIGH"),
        "Ends of a parameter of the plant around its value, NAME=LOW:HIGH; repeatable.",
        Named(option="--range"),
    ] = None,
    own: Annotated[
        bool, Flag(), "Keep the plant's own tolerances of the other parameters.", Named(in_step=False)
    ] = True,
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
    from robustlab.dynamics.plant_contract import NonlinearPlant, SteppedPlant
    from robustlab.uncertainty.elementwise import BuiltModel

    nominal, shares = plant.values, tolerances or {}
    ends = in_units("range", ranges, {p.name: p.unit for p in plant.parameters.values()})
    for name in shares:
        if name not in nominal and name not in plant.parameters:
            raise UsageError(f"tolerance {name}", f"no such parameter of {plant.name}", f"one of {', '.join(nominal)}")
    if ends and hasattr(plant, "effects"):
        raise UsageError("range", f"{plant.name} carries effects", "tolerances")
    exact = {} if own else {name: (p.value, 0.0) for name, p in plant.parameters.items()}
    made: Any = plant.with_parameters(**{**exact, **{n: (nominal.get(n, 1.0), share) for n, share in shares.items()}})
    options: dict[str, Any] = {"at": at_rest(made, at, pose), "hold": hold, "ranges": ends}
    if hold and (not isinstance(made, NonlinearPlant) or isinstance(made, SteppedPlant)):
        raise UsageError("hold", f"{plant.name} has one linear model", "it for a nonlinear plant only")
    model = made.uncertain(outputs, **{name: value for name, value in options.items() if value})
    missing = getattr(made, "left_out", tuple)()
    notes = [*left_out(missing), *model.remarks]
    without = {*shares, *ends} - {b.name for b in model.blocks}
    if without and not hasattr(made, "effects"):
        notes.append(f"without effect on the linear model: {', '.join(sorted(without))}")
    notes += [] if model.blocks else [NOTHING]
    return InLoop(BuiltModel(model, "parameters", None), notes=tuple(notes))


@operation("uncertain expressions", result="uncertainty.elementwise.BuiltModel", gives="uncertain", made="model")
def expressions(file: Annotated[str, TextFile(), "TOML file with A, B, C, D in named parameters."]) -> Any:
    """Uncertain model from matrices of expressions in parameters with ranges.

    Example: robustlab uncertain expressions springs.toml --out springs.h5
    """
    from robustlab.storage.expression_files import load_parametric
    from robustlab.uncertainty.elementwise import BuiltModel

    model = load_parametric(file)
    return InLoop(BuiltModel(model, "parameters", None), notes=() if model.blocks else (NOTHING,))


@operation("uncertain cover", result="mu_analysis.margins.cover.Cover", gives="uncertain", made="model")
def cover(
    models: Annotated[list[Any], Thing(ANY, model=True, many=True), "Files of the models to cover; at least two."],
    *,
    form: Annotated[str, Choice(COVERS), "Of the cover."] = "elements",
    rtol: Annotated[
        float, Number(least=0, below=1), "Relative differences up to this are noise; none where left out."
    ] = 1e-9,
    weight_order: Annotated[int, Whole(0, 12), "Largest order of the cover's weight."] = 4,
    directions: Annotated[int | None, Whole(1, 100), "Number of directions of the form pca."] = None,
    controller: Annotated[
        Controller,
        "File of a controller, with its sign: the cover's worst gain is that of its loop.",
        Named(option="--controller,-k"),
    ] = None,
    feedback: Sign = None,
    search: Search,
    progress: Any = None,
) -> Any:
    """The smallest uncertain model of a form that contains a set of models, with its conservatism.

    Example: robustlab uncertain cover unit1.h5 unit2.h5 unit3.h5 --form pca --out set.h5
    """
    loop: Any = None
    words = ""
    if feedback is not None and controller is None:
        raise UsageError("--feedback", "without --controller", "a controller to close the loop with")
    if controller is not None:
        from robustlab.feedback import feedback_loop

        around, sign, words = feedback_loop(models[0], controller, feedback, "cover", None)
        loop = lambda g: g.feedback(around, sign)  # noqa: E731
    found = rl.cover(
        models, form, tolerance=rtol, directions=directions, order=weight_order, loop=loop, progress=progress,
        **vars(search),
    )  # fmt: skip
    return InLoop(found, words)


def _inferred_blocks(step: Any, ahead: Any) -> Any:
    # Bounded errors come before its inputs.
    return replace(ahead[step.of].select(step.outputs), inputs=None, leaves=type(step).leaves)


@operation(
    "uncertain discovery",
    "uncertain-from",
    result="dynamics.extended.effect_blocks.EffectBlocks",
    gives="uncertain",
    made="model",
    infer=_inferred_blocks,
)
def uncertain_from(
    discovery: Annotated[
        Any,
        Thing(("plant", "any"), discovery=True),
        "Folder of data discover --out, or its updated plant.",
        Named(key="of"),
    ],
    outputs: Outputs = None,
    amplitude: Annotated[
        dict[str, Any] | None,
        Table(Quantity("may", least=0)),
        "Amplitude of a speed or signal at which effects are described, or LOW:HIGH, NAME=VALUE; repeatable.",
    ] = None,
    dry: Annotated[
        Any,
        Choice(("gain", "load", "both")),
        "Dry friction and other bounded forces: load, an input, exact at any speed; gain, that of the describing "
        "function; where left out, a gain where an amplitude is given, else a load.",
    ] = None,
    sigmas: Annotated[
        float, Number(least=0, most=10), "Half width of the range of a fitted value in its standard deviations."
    ] = 2.0,
    pade: Annotated[int, Whole(1, 8), "Order of the Pade part of delays."] = 2,
) -> Any:
    """Uncertain model of the effects and the residual of a discovery; each block has its origin.

    Example: robustlab uncertain discovery found/ --amplitude v=0.05 --out set.h5
    """
    named = in_units("amplitude", amplitude, {})
    try:
        return rl.uncertain_from(discovery, outputs, sigmas=sigmas, amplitude=named or None, dry=dry, pade=pade)
    except InputError as error:
        if "amplitude" in (error.expected or "") and error.hint:
            raise UsageError("uncertain_from", error.found, "--amplitude NAME=VALUE for it", error.hint) from None
        raise
