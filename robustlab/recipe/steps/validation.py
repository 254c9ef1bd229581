"""Step on measurements: could this uncertain model have produced this record?"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from robustlab.recipe.outcome import Fact, Outcome, Workspace, quantity
from robustlab.recipe.schema import ValidateStep

if TYPE_CHECKING:
    from robustlab.identification.validation import Validation

__all__ = ["validate"]

_CAPTION = (
    "{}: the record, the nominal model, and the member that explains it with the smallest Delta; below, what each of "
    "them leaves, in the noise bound."
)
_LINES = "How large each block of Delta is at each frequency in the explanation."
_NOTE = "Not invalidated is not proved: another record may still invalidate the set."


def validate(step: ValidateStep, work: Workspace) -> Outcome:
    """Bounds of the smallest scaling of Delta that explains a record; ``gamma`` is the one that was shown to."""
    from robustlab.identification.validation import validate as validate_with
    from robustlab.report.validation_figures import validation_figures

    found = validate_with(
        work.uncertain(step.of),
        work.record(step.record),
        step.noise or None,
        domain=step.domain,
        noise_norm=step.noise_norm,
        delta=step.delta,
        at_rest=step.at_rest,
        window=step.window,
        period=step.period,
        per_block=step.per_block,
        precision=step.precision,
        effort=step.effort,
        time_limit=step.time_limit,
    )
    work.keep(found)
    for name, figure in validation_figures(found).items():
        caption = _LINES if name == "delta" and found.domain == "frequency" else _CAPTION.format(name)
        work.draw(figure, name, caption)
    numbers = {**found.to_json(series=False), "gamma": found.upper}
    summary = f"{step.record} as a record of {step.of}: {found.verdict}."
    return Outcome(found, summary, numbers, _facts(found), found.status, (_NOTE, *found.notes), found.summary())


def _facts(found: Validation) -> tuple[Fact, ...]:
    shown = quantity(found.upper) if np.isfinite(found.upper) else "none was found"
    facts = [
        Fact("Smallest gamma that explains the record", shown, found.label),
        Fact("No smaller gamma than", quantity(found.lower)),
    ]
    units = dict(found.outputs)
    for name, bound in found.noise_bound.items():
        facts.append(Fact(f"{name}: noise bound ({found.noise_norm})", quantity(bound, units[name], 3)))
    for name, block in found.blocks.items():
        told = [f"size {quantity(block.size, digits=4)} in the explanation"] if np.isfinite(block.size) else []
        if block.physical is not None:
            told.append(quantity(*block.physical))
        if block.impossible:
            told.append(f"physically impossible: {block.impossible}")
        if not np.isnan(block.lower):
            told.append(f"alone, the others within 1: {block.lower:.4g} to {block.upper:.4g}")
        if told:
            facts.append(Fact(f"{name} ({block.kind})", "; ".join(told)))
    return tuple(facts)
