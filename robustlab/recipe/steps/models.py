"""Steps that make models: from physics, from files, from one another."""

from __future__ import annotations

from typing import Any

from robustlab.errors import InputError
from robustlab.recipe.outcome import Fact, Outcome, Workspace, quantity
from robustlab.recipe.schema import (
    ElementwiseStep,
    LineariseStep,
    LoadStep,
    PlantStep,
    SaveStep,
    SteadyStateStep,
    StructuralStep,
    UncertainStep,
)
from robustlab.result import Status

__all__ = [
    "elementwise",
    "linearise",
    "load",
    "plant",
    "save",
    "steady_state",
    "structural",
    "uncertain",
    "uncertain_numbers",
]


def plant(step: PlantStep, _work: Workspace) -> Outcome:
    """A plant from physics, with its parameters and where they come from."""
    import robustlab as rl

    given = {name: tuple(value) if isinstance(value, list) else value for name, value in step.parameters.items()}
    made = rl.plant(step.plant, **given, **step.choices)
    facts = []
    for p in made.parameters.values():
        spread = f" ± {100 * p.tolerance:g} %" if p.tolerance else ""
        facts.append(Fact(f"{p.name}, {p.meaning}", f"{quantity(p.value, p.unit)}{spread}", p.source))
    numbers = {
        name: {"value": p.value, "unit": p.unit, "tolerance": p.tolerance} for name, p in made.parameters.items()
    }
    signals = " → ".join(", ".join(f"{s.name} [{s.unit}]" for s in side) for side in (made.inputs, made.outputs))
    return Outcome(made, f"Plant {step.plant}: {signals}.", {"parameters": numbers}, tuple(facts))


def linearise(step: LineariseStep, work: Workspace) -> Outcome:
    """The state-space model of a plant."""
    import robustlab as rl
    from robustlab.dynamics import LinearPlant
    from robustlab.structural import drop_unconnected

    given = work.values[step.of]
    if step.at is not None and isinstance(given, LinearPlant):
        raise InputError("at", f"a pose of {step.of}, which is linear", "no pose: the model is the same everywhere")
    model = rl.linearise(given, at=step.at)
    if step.outputs is not None:
        model = drop_unconnected(model.select(outputs=step.outputs))
    where = "" if step.at is None else f" at the pose {', '.join(f'{value:g}' for value in step.at)}"
    return Outcome(model, f"State-space model of {step.of}{where}.", _model_numbers(model), _model_facts(model))


def load(step: LoadStep, work: Workspace) -> Outcome:
    """An object from an HDF5 file, checked by the reader."""
    from robustlab.statespace import StateSpaceModel
    from robustlab.storage import read

    path = work.sources[work.step] if step.saved is None else work.values[step.saved]
    loaded = read(path)
    found: Any = loaded.object
    kind = type(found).__name__
    model = found.to_model() if hasattr(found, "to_model") else found
    is_model = isinstance(model, StateSpaceModel)
    proof = "its checksums and content hash are right" if loaded.verified else "it carries no content hash to check"
    return Outcome(
        found,
        f"{kind} read from {path.name}; {proof}.",
        {"kind": kind, "verified": loaded.verified, **(_model_numbers(model) if is_model else {})},
        _model_facts(model) if is_model else (),
        notes=loaded.warnings,
    )


def save(step: SaveStep, work: Workspace) -> Outcome:
    """An object to an HDF5 file in the output folder, with its provenance."""
    import robustlab as rl
    from robustlab.dynamics.extended.extended_plant import ExtendedPlant
    from robustlab.provenance import Provenance, file_sha256

    path = work.folder / step.file
    given = work.values[step.of]
    if hasattr(given, "to_uncertain"):  # a tracking problem is kept as its generalised plant
        given = given.to_uncertain()
    if not isinstance(given, (rl.StateSpaceModel, rl.UncertainModel, rl.Record, rl.Controller, ExtendedPlant)):
        given = given.to_model()  # a plant without effects is kept as its linear model
    rl.save(path, given, Provenance.now(f"recipe step {work.step}", work.inputs, work.seed))
    work.files.append(step.file)
    digest = file_sha256(path)
    return Outcome(
        path,
        f"{type(given).__name__} of {step.of} written to {step.file}.",
        {"sha256": digest},
        (Fact("SHA-256", digest),),
    )


def structural(step: StructuralStep, work: Workspace) -> Outcome:
    """Controllability and observability, by a method that does not form powers of A."""
    import robustlab as rl

    model = work.values[step.of]
    parts = {"controllability": rl.controllability(model), "observability": rl.observability(model)}
    numbers: dict[str, Any] = {
        name: {"rank": part.rank, "states": part.n_states, "full": part.rank == part.n_states}
        for name, part in parts.items()
    }
    facts = tuple(
        Fact(f"{name.capitalize()} rank", f"{part.rank} of {part.n_states} states") for name, part in parts.items()
    )
    statuses = [part.status for part in parts.values()]
    return Outcome(None, f"Structure of {step.of}.", numbers, facts, _worst(statuses))


def steady_state(step: SteadyStateStep, work: Workspace) -> Outcome:
    """Outputs in steady state: the dc gain times the constant inputs."""
    import numpy as np

    from robustlab.errors import did_you_mean
    from robustlab.statespace import as_model
    from robustlab.structural import drop_unconnected

    model = as_model(work.values[step.of])
    if step.outputs is not None:
        model = drop_unconnected(model.select(outputs=step.outputs))
    for name in step.inputs:
        if name not in model.input_names:
            raise InputError(
                f"inputs.{name}",
                "no such input",
                f"one of {', '.join(model.input_names)}",
                did_you_mean(name, model.input_names),
            )
    if not model.is_stable():
        raise InputError(
            f"model {step.of}",
            "is not stable, so it has no steady state",
            "a stable model",
            "keep only outputs that settle with outputs = [...]",
        )
    u = np.array([step.inputs.get(name, 0.0) for name in model.input_names])
    y = model.dc_gain() @ u
    numbers = {s.name: float(value) for s, value in zip(model.outputs, y, strict=True)}
    facts = tuple(Fact(s.name, quantity(float(value), s.unit)) for s, value in zip(model.outputs, y, strict=True))
    inputs = ", ".join(
        f"{s.name} = {quantity(step.inputs[s.name], s.unit)}" for s in model.inputs if s.name in step.inputs
    )
    return Outcome(None, f"Steady state of {step.of} at {inputs}.", {"outputs": numbers}, facts)


def uncertain(step: UncertainStep, work: Workspace) -> Outcome:
    """The exact LFT of a plant over the ranges of the named parameters; all others are taken as exact."""
    given = work.values[step.of]
    exact = {name: (p.value, 0.0) for name, p in given.parameters.items()}
    ranges = {name: (given.values.get(name, 1.0), tolerance) for name, tolerance in step.tolerances.items()}
    made = given.with_parameters(**{**exact, **ranges})  # an unknown name is refused there, with the nearest known one
    model = made.uncertain(step.outputs)
    facts = [Fact(b.name, _range(b)) for b in model.blocks]
    summary = f"Exact uncertain model of {step.of}; uncertain: {', '.join(b.name for b in model.blocks)}."
    return Outcome(model, summary, uncertain_numbers(model), tuple(facts))


def elementwise(step: ElementwiseStep, work: Workspace) -> Outcome:
    """The set of models between a nominal and a maximally perturbed one, checked at its two ends."""
    import robustlab as rl
    from robustlab.uncertainty.covering.elementwise_cover import elementwise_cover
    from robustlab.uncertainty.elementwise import endpoint_residual

    perturbed = work.values[step.perturbed]
    if step.structure == "cover":
        cover = elementwise_cover(work.values[step.nominal], perturbed)
        facts = (Fact("Blocks of Δ", ", ".join(f"{b.name} {b.rows} x {b.cols}" for b in cover.blocks) or "none"),)
        note = "Contains every member of the element-wise set: what is proved for it is proved for them."
        summary = f"Cover of the element-wise uncertainty from {step.nominal} and {step.perturbed}."
        return Outcome(cover, summary, uncertain_numbers(cover), facts, notes=(note,))
    model = rl.elementwise(work.values[step.nominal], perturbed, step.structure)
    residual = endpoint_residual(model, perturbed).largest
    numbers = {**uncertain_numbers(model), "endpoint_residual": residual}
    facts = (
        Fact("Structure", step.structure),
        Fact("Blocks of Δ", ", ".join(b.name for b in model.blocks) or "none: the models are equal"),
        Fact("Largest relative difference to the perturbed model at Δ = I", f"{residual:.2g}"),
    )
    status = Status.CERTIFIED if residual <= 1e-12 else Status.INACCURATE
    notes = ("No uncertainty: nominal and perturbed model are equal.",) if not model.blocks else ()
    return Outcome(
        model, f"Element-wise uncertainty from {step.nominal} and {step.perturbed}.", numbers, facts, status, notes
    )


def _model_numbers(model: Any) -> dict[str, Any]:
    return {
        "states": model.n_states,
        "inputs": list(model.input_names),
        "outputs": list(model.output_names),
        "spectral_abscissa": model.spectral_abscissa(),
        "poles": model.poles(),
    }


def _model_facts(model: Any) -> tuple[Fact, ...]:
    poles = ", ".join(
        f"{p.real:.5g}{p.imag:+.5g}j" if p.imag else f"{p.real:.5g}" for p in sorted(model.poles(), key=abs)[:12]
    )
    return (
        Fact("States", ", ".join(model.state_names) or "none"),
        Fact("Poles", f"{poles or 'none'} {'rad/s' if not model.dt else ''}"),
    )


def uncertain_numbers(model: Any) -> dict[str, Any]:
    """Size of an uncertain model, for requirements."""
    return {"blocks": [b.name for b in model.blocks], "channels": model.delta_shape[0], "states": model.M.n_states}


def _range(block: Any) -> str:
    p = block.parameter
    if p is None:
        return f"{block.rows} channels"
    return f"{quantity(p.low)} … {quantity(p.high, p.unit)}"


def _worst(statuses: list[Status]) -> Status:
    order = list(Status)
    return max(statuses, key=order.index)
