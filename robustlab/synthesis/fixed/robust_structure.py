"""Fixed-structure design for the worst member of an uncertain plant: scenarios are added where the worst case is."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from robustlab.arrays import AnyArray
from robustlab.budget import Budget
from robustlab.errors import NoTrustworthyNumber
from robustlab.mu_analysis.axis.worst_gain import WorstCaseGain, gain_within
from robustlab.result import Status
from robustlab.statespace import StateSpaceModel, lower_lft
from robustlab.synthesis.fixed.fixed_result import FixedSynthesis
from robustlab.synthesis.problem.design import told
from robustlab.synthesis.problem.partition import GeneralizedPlant
from robustlab.uncertainty.lft import UncertainModel
from robustlab.uncertainty.realised_delta import realise_delta

__all__ = ["robust_design"]

Design = Callable[[Sequence[GeneralizedPlant], Sequence[AnyArray], Budget], FixedSynthesis]

ROUNDS = 12
# Worst-case gain over the scenarios' gain at which the scenarios count as enough.
ENOUGH = 1.01
# Shares of the work that remains: for one design, and for one search for the worst member with its proof.
DESIGN_SHARE, SEARCH_SHARE = 0.5, 0.3


def robust_design(
    plant: GeneralizedPlant, design: Design, budget: Budget, say: Callable[[str], None]
) -> FixedSynthesis:
    """Design on scenarios, find the worst Delta of the loop, add it, and repeat; the best design by its proved bound.

    Parameters
    ----------
    plant
        Generalised plant with perturbation blocks; their channels come first.
    design
        ``(plants, starts as parameters, budget)`` to a verified design.
    budget
        Designs and proofs get shares of it; once it is over no further round begins.
    say
        Called with one line per round.
    """
    uncertain = UncertainModel(plant.model, plant.blocks)
    deltas: list[Mapping[str, Any]] = [{}]
    members = [GeneralizedPlant(uncertain.nominal, plant.n_meas, plant.n_con)]
    best: FixedSynthesis | None = None
    known: list[AnyArray] = []
    for number in range(ROUNDS):
        if best is not None and budget.over:
            break
        try:
            found = design(members, known, budget.share(DESIGN_SHARE))
        except NoTrustworthyNumber:
            if best is None:
                raise
            break
        known = [np.array([p.value for p in found.parameters])]
        worst = _worst(uncertain, found.K, budget.share(SEARCH_SHARE))
        found = replace(found, worst=worst, scenarios=tuple(deltas))
        say(f"round {number + 1}: {len(members)} scenarios, gain {found.gamma:.5g}, worst member {worst.lower:.5g}")
        if best is None or _order(found) < _order(best):
            best = found
        if worst.lower <= ENOUGH * found.gamma:
            break
        member = _member(uncertain, worst)
        if member is None:
            break
        deltas.append(dict(worst.delta))
        members.append(GeneralizedPlant(member, plant.n_meas, plant.n_con))
    assert best is not None
    return _judged(best, budget)


def _worst(uncertain: UncertainModel, K: StateSpaceModel, budget: Budget) -> WorstCaseGain:
    loop = UncertainModel(lower_lft(uncertain.M, K), uncertain.blocks)
    return gain_within(loop, budget, tolerance=0.02)


def _order(design: FixedSynthesis) -> tuple[float, float]:
    worst = design.worst
    return (np.inf, np.inf) if worst is None else (worst.lower, worst.upper)


def _member(uncertain: UncertainModel, worst: WorstCaseGain) -> StateSpaceModel | None:
    """The member at the worst Delta as a model; complex values are realised as stable systems."""
    frequency = worst.frequency
    try:
        if any(np.iscomplexobj(value) and np.abs(np.imag(value)).max() > 0 for value in worst.delta.values()):
            if frequency is None:
                return None
            return uncertain.evaluate(realise_delta(uncertain.blocks, worst.delta, frequency, uncertain.dt))
        return uncertain.evaluate({name: np.real(value) for name, value in worst.delta.items()})
    except NoTrustworthyNumber:
        return None


def _judged(design: FixedSynthesis, budget: Budget) -> FixedSynthesis:
    """With gamma, status and reason as the worst-case gain has them, and what ended the search."""
    worst = design.worst
    assert worst is not None
    scenarios = f"{len(design.scenarios)} scenarios"
    if np.isfinite(worst.upper) and worst.status is Status.CERTIFIED:
        gamma = worst.upper if design.status.trustworthy else max(worst.upper, design.gamma)
        sound = Status.INACCURATE if design.status is Status.INACCURATE else Status.CERTIFIED
        parts = [design.reason, "worst-case gain over the whole set proved", scenarios]
        status, reason = told(sound, parts, budget)
        return replace(design, gamma=gamma, status=status, reason=reason)
    text = "a member is unstable" if not np.isfinite(worst.lower) else "the worst-case gain was not proved"
    status, reason = told(Status.INCONCLUSIVE, [text, scenarios], budget)
    return replace(design, gamma=max(design.gamma, worst.lower), status=status, reason=reason)
