"""Steps that make an uncertain model: the cover of a set of models, and what a discovery found and left over."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from robustlab.errors import InputError
from robustlab.recipe.outcome import Fact, Outcome, Workspace, quantity
from robustlab.recipe.steps.design import tracking_loop
from robustlab.recipe.steps.models import uncertain_numbers
from robustlab.recipe.uncertainty_schema import CoverModelsStep, UncertainFromStep, WithLoadsStep

if TYPE_CHECKING:
    from robustlab.dynamics.extended.effect_blocks import EffectBlocks
    from robustlab.mu_analysis.margins.cover import Cover
    from robustlab.statespace import StateSpaceModel

__all__ = ["cover_models", "uncertain_from", "with_loads"]

MOST_FACTS = 40


def cover_models(step: CoverModelsStep, work: Workspace) -> Outcome:
    """The smallest uncertain model of a form around a set of models, with its conservatism.

    Numbers: ``blocks``, ``channels``, ``members``, ``missed`` (largest miss of a model), ``size`` (largest delta);
    ``order``, ``excess``, ``least_excess`` and ``radius`` of an unstructured form; ``conservatism`` and
    ``conservatism_at_least``.
    """
    import robustlab as rl
    from robustlab.report.cover_figures import cover_figures

    models = _models(step, work)
    controller = None if step.controller is None else work.values[step.controller]
    loop = None if controller is None else lambda g: tracking_loop(g, controller)
    nominal = None if step.nominal is None else _selected(rl.linearise, work.values[step.nominal], step.outputs)
    found = rl.cover(
        models, step.form, nominal=nominal, tolerance=step.tolerance, directions=step.directions, order=step.order,
        excess=step.excess, loop=loop, gain=step.conservatism,
        effort=step.effort, time_limit=step.time_limit,
    )  # fmt: skip
    work.keep(found)
    for name, (figure, caption) in cover_figures(found, models).items():
        work.draw(figure, name, caption)
    numbers, facts = _cover_numbers(found)
    notes = [found.reason] if found.reason else []
    if found.conservatism is not None and found.conservatism.reason:
        missing = math.isnan(found.conservatism.ratio)
        notes.append(f"{'No conservatism' if missing else 'Conservatism'}: {found.conservatism.reason}.")
    summary = f"{step.form} cover of {len(models)} models: {len(found.model.blocks)} blocks."
    return Outcome(found.model, summary, numbers, facts, found.status, tuple(notes), found.summary())


def _models(step: CoverModelsStep, work: Workspace) -> list[StateSpaceModel]:
    import robustlab as rl

    made = [_selected(rl.linearise, work.values[name], step.outputs) for name in step.models]
    if step.of is not None:
        plant = work.values[step.of]
        made += [
            _selected(lambda p, at=pose: rl.linearise(p, at=rl.trim(p, pose=at)), plant, step.outputs)
            for pose in step.poses
        ]
    return made


def _selected(linearise: Any, given: Any, outputs: list[str] | None) -> StateSpaceModel:
    """A model as it is, a plant linearised; with the outputs that are kept."""
    from robustlab.dynamics import Plant
    from robustlab.statespace import as_model
    from robustlab.structural import drop_unconnected

    model = linearise(given) if isinstance(given, Plant) else as_model(given)
    return model if outputs is None else drop_unconnected(model.select(outputs=outputs))


def _cover_numbers(found: Cover) -> tuple[dict[str, Any], tuple[Fact, ...]]:
    c = found.conservatism
    numbers = {
        **uncertain_numbers(found.model),
        "count": len(found.model.blocks),
        "members": len(found.sizes),
        "size": max(found.sizes),
        "missed": max(found.misses),
        "radius": found.radius,
    }
    facts = [Fact("Largest delta that a model needs", quantity(max(found.sizes)))]
    if found.fit is not None:
        least = f"no weight of this order comes nearer than {100 * found.fit.least:.3g} %"
        numbers |= {"order": found.fit.order, "excess": found.fit.excess, "least_excess": found.fit.least}
        facts += [
            Fact("Weight", f"order {found.fit.order}, at most {100 * found.fit.excess:.3g} % above the bound", least),
            Fact("Largest error, of the models' size", f"{100 * found.radius:.3g} %"),
        ]
    else:
        facts.append(Fact("Largest miss of a model's entry, of its matrix' largest", f"{max(found.misses):.2g}"))
    if c is not None and not c.reason:
        numbers |= {"conservatism": c.ratio, "conservatism_at_least": c.least, "set_gain": c.set_gain}
        text = f"at most {c.ratio:.4g}, attained {c.least:.4g}"
        facts.append(Fact("Worst gain of the cover over that of the set", text, f"largest in model {c.set_model}"))
    return numbers, (*facts, *_block_facts(found.model))


def uncertain_from(step: UncertainFromStep, work: Workspace) -> Outcome:
    """What was named and what remains as blocks, each with its origin.

    Numbers: ``blocks``, ``count``, ``channels``, ``inputs`` (for bounded errors), ``left_out`` (how many),
    ``range.BLOCK.low`` and ``.high``, ``bound.INPUT``.
    """
    import robustlab as rl
    from robustlab.dynamics import Plant
    from robustlab.report.cover_figures import blocks_figure

    given = work.discoveries.get(step.of, work.values[step.of])
    if step.of not in work.discoveries and not isinstance(given, Plant):
        raise InputError(f"of = {step.of!r}", f"a {type(given).__name__}", "a discover step, or a plant")
    amplitude = {n: (a[0], a[1]) if isinstance(a, list) else a for n, a in step.amplitude.items()}
    made = rl.uncertain_from(
        given, step.outputs, sigmas=step.sigmas, amplitude=amplitude or None, dry=step.dry, pade=step.pade
    )
    work.keep(made)
    figure = blocks_figure(made)
    if figure is not None:
        work.draw(figure, "blocks", "How much each block alone changes the response of the nominal model, of its size.")
    ranges = {b.name: b.parameter for b in made.model.blocks if b.parameter}
    numbers = {
        **uncertain_numbers(made.model),
        "count": len(made.model.blocks),
        "inputs": len(made.noise),
        "left_out": len(made.left_out),
        "range": {name: {"low": p.low, "high": p.high} for name, p in ranges.items()},
        "bound": {n.name: n.bound for n in made.noise},
    }
    facts = [
        *_block_facts(made.model),
        *(Fact(f"input {n.name}", f"at most {quantity(n.bound, n.unit)}", n.origin) for n in made.noise),
        *(Fact(f"not in it: {name}", reason) for name, reason in made.left_out.items()),
    ]
    summary = (
        f"Uncertain model of {step.of}: blocks {len(made.model.blocks)}, inputs for bounded errors {len(made.noise)},"
        f" effects left out {len(made.left_out)}."
    )
    return Outcome(made.model, summary, numbers, tuple(facts), made.status, _notes(made))


def with_loads(step: WithLoadsStep, work: Workspace) -> Outcome:
    """The record with the loads of a plant's effects: known signals, at most one.

    Numbers: ``largest.INPUT`` along the record, ``bound.INPUT`` in its unit.
    """
    from robustlab.dynamics.extended.effect_loads import effect_loads

    record = work.record(step.record)
    made = effect_loads(work.values[step.of], step.sigmas, [record])
    shown = made.along(record)
    largest = {load.name: float(abs(shown[load.name]).max()) for load in made.loads}
    facts = tuple(
        Fact(load.name, f"at most {quantity(load.bound, load.unit)}; along the record {largest[load.name]:.3g} of it",
             load.origin)
        for load in made.loads
    )  # fmt: skip
    numbers = {"largest": largest, "bound": {load.name: load.bound for load in made.loads}}
    summary = f"{step.record} with {len(made.loads)} loads of {step.of} as known inputs."
    return Outcome(shown, summary, numbers, facts)


def _notes(made: EffectBlocks) -> tuple[str, ...]:
    notes = []
    if made.approximate:
        names = ", ".join(made.approximate)
        notes.append(
            f"{names}: holds by harmonic balance, for the oscillations that its line names, not for every motion."
        )
    if made.noise:
        notes.append("Inputs for bounded errors come first; one stands for the bound that their line names.")
    if made.left_out:
        notes.append("What is proved for this set says nothing about the effects that are not in it.")
    return tuple(notes)


def _block_facts(model: Any) -> list[Fact]:
    """One line a block: what it ranges over, and where it comes from."""
    facts = []
    for b in model.blocks[:MOST_FACTS]:
        p = b.parameter
        size = (
            f"{b.rows} x {b.cols}, gain at most 1" if p is None else f"{quantity(p.low)} … {quantity(p.high, p.unit)}"
        )
        facts.append(Fact(b.name, size, b.origin))
    if len(model.blocks) > MOST_FACTS:
        facts.append(Fact(f"and {len(model.blocks) - MOST_FACTS} more blocks", ""))
    return facts
