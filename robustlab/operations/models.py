"""Operations that make, check and compare models."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated, Any

import robustlab as rl
from robustlab.errors import UsageError
from robustlab.operations.declaration import InLoop, Named, operation
from robustlab.operations.kinds import Number, Numbers, Pair, Quantity, Table, Thing, Whole, bounded, in_units
from robustlab.operations.words import Model, Outputs, System

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
    Numbers("", 6, "TX,TY,TZ,AX,AY,AZ"),
    "Pose of a platform in m and rad; home if left out.",
    Named(only="command"),
]


def at_rest(plant: Any, at: Any, pose: Any) -> Any:
    """Return the pose or the values of the equilibrium; None for the plant's own."""
    from robustlab.dynamics.plant_contract import NonlinearPlant, SteppedPlant

    if pose is not None and at:
        raise UsageError("pose", "--pose and --at", "one of them")
    if (at or pose) and (not isinstance(plant, NonlinearPlant) or isinstance(plant, SteppedPlant)):
        raise UsageError("at", f"{plant.name} has one linear model", "it for a nonlinear plant only")
    return list(pose) if pose is not None else at


@operation("model build", "linearise", result="statespace.StateSpaceModel", gives="model", infer="of")
def linearise(
    plant: Annotated[Plant, Named(key="of")],
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
    from robustlab.dynamics.plant_contract import NonlinearPlant, SteppedPlant
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
    return InLoop(model, notes=left_out(missing), beside=_place(at, pose))


def _place(at: Any, pose: Any) -> dict[str, str]:
    if isinstance(at, dict) and at:
        return {"rest": ", ".join(f"{name} = {value:g}" for name, value in at.items())}
    given = pose if pose is not None else at
    return {"pose": ", ".join(f"{value:g}" for value in given)} if given is not None else {}


def left_out(missing: Any) -> tuple[str, ...]:
    """Return a line for each effect that is not in a model."""
    return tuple(f"not in it: {m.effect.effect.title} at {m.effect.site}: {m.reason}" for m in missing)


@operation("model check", "structural", result="linear_analysis.structural.Structure")
def check(
    system: Annotated[System, Named(key="of")],
) -> Any:
    """Poles, stability, controllability and observability of a model.

    Of a model with exact delays: whether it is stable, proved for all frequencies either way.
    Exit code 4: neither could be shown.

    Example: robustlab model check motor.h5
    """
    if isinstance(system, rl.DelayedModel):
        from robustlab.mu_analysis.margins.delay_margins import delay_stability

        return delay_stability(system)
    from robustlab.dynamics.plant_contract import Plant as AnyPlant
    from robustlab.linear_analysis.structural import structure

    return structure(rl.linearise(system) if isinstance(system, AnyPlant) else system)


def _inferred_steady_state(step: Any, ahead: Any) -> Any:
    kept = ahead[step.of].select(step.outputs).outputs
    return replace(ahead[None], leaves={"outputs": {"*": float} if kept is None else dict(kept)})


@operation("", "steady-state", result="linear_analysis.frequency.SteadyState", infer=_inferred_steady_state)
def steady_state(
    model: Annotated[Model, Named(key="of")],
    inputs: Annotated[
        dict[str, Any],
        Table(Quantity(), "inputs"),
        "Constant input, u=42 or u=42V; repeatable.",
        Named(option="--input-value"),
    ],
    outputs: Outputs = None,
) -> Any:
    """Outputs in steady state under constant inputs; inputs left out are zero."""
    from robustlab.linear_analysis.frequency import steady_state as computed

    return computed(model, in_units("input", inputs, {s.name: s.unit for s in model.inputs}), outputs)


@operation("model diff", "difference", result="storage.pairs.Difference")
def diff(
    first: Annotated[
        Any,
        Thing(("plant", "model", "uncertain", "any"), model=True, pair=True),
        "HDF5 or MATLAB file.",
        Named(key="of"),
    ],
    second: Annotated[
        Any,
        Thing(("plant", "model", "uncertain", "any"), model=True, positional=True),
        "The other file; left out where the first one holds a nominal and a perturbed model.",
        Named(key="beside"),
    ] = None,
    rtol: Annotated[float, Number(least=0), "Relative changes up to this are not shown."] = 0.0,
) -> Any:
    """The entries in which two models differ.

    Example: robustlab model diff nominal.h5 perturbed.h5
    """
    from robustlab.storage.pairs import difference

    return difference(*two_models(first, second), rtol)


def two_models(first: Any, second: Any) -> tuple[Any, Any]:
    """Return both models, of two files or of one that holds two."""
    if isinstance(first, Pair):
        if second is not None:
            raise UsageError("two models", "a file of two and another one", "one of them")
        return first
    if second is None:
        raise UsageError("two models", "one model", "another file, or one that holds /nominal and /perturbed")
    return Thing(model=True).as_wanted(first, "nominal"), second
