"""What a step proves, proved once more: `robustlab.verify` reads the files that the step wrote, and nothing else."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import robustlab as rl
from robustlab.evidence import Verified
from robustlab.recipe.steps.contract import Fact, Outcome
from robustlab.result import least_trusted
from robustlab.verification.reading import claims_in_file


def verified(outcome: Outcome, files: Sequence[Path], asked: bool) -> Outcome:
    """The outcome with what became of its claims; its status is no better than theirs."""
    found = [rl.verify(path) for path in files if claims_in_file(path)]
    if not found:
        if not asked:
            return outcome
        note = "Nothing of this step can be verified: what it found holds no claims."
        return replace(outcome, status=_with(outcome, [rl.Status.INCONCLUSIVE]), notes=(*outcome.notes, note))
    facts = [
        Fact(_label(one), text, "verify")
        for one in found
        for text in (one.headline(), *(f"{label}: {said}" for label, said in one.facts() if said and label != "proved"))
    ]
    numbers = {**outcome.numbers, "verified": all(one.proved for one in found)}
    status = _with(outcome, [one.status for one in found])
    return replace(outcome, facts=(*outcome.facts, *facts), numbers=numbers, status=status)


def _label(one: Verified) -> str:
    return "Proved independently" if one.proved else "Refuted" if one.refuted else "Not proved independently"


def _with(outcome: Outcome, statuses: Sequence[rl.Status]) -> rl.Status:
    """What is proved does not become better trusted than it was."""
    own = [] if outcome.status is None else [outcome.status]
    return least_trusted([*own, *statuses])
