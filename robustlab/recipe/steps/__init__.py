"""What each kind of step does: one function per kind, from the checked step to its `Outcome`.

These functions call the public functions of the rooms below, choose the numbers that requirements may address, and
draw. No mathematics lives here.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from robustlab.recipe.outcome import Outcome, Workspace
from robustlab.recipe.steps import (
    analysis,
    campaign,
    control,
    covers,
    design,
    discovery,
    measurement,
    models,
    published,
    story,
)

__all__ = ["EXECUTORS"]

EXECUTORS: dict[str, Callable[[Any, Workspace], Outcome]] = {
    "plant": models.plant,
    "linearise": models.linearise,
    "load": models.load,
    "save": models.save,
    "structural": models.structural,
    "steady-state": models.steady_state,
    "uncertain": models.uncertain,
    "elementwise": models.elementwise,
    "cover-models": covers.cover_models,
    "uncertain-from": covers.uncertain_from,
    "with-loads": covers.with_loads,
    "sample": analysis.sample,
    "worst-case": analysis.worst_case,
    "violation-probability": analysis.violation_probability,
    "campaign": campaign.campaign,
    "hinf-norm": analysis.hinf_norm,
    "robust-stability": analysis.robust_stability,
    "mixsyn": design.mixsyn,
    "hinf": design.hinf,
    "h2": design.h2,
    "ncf": design.ncf,
    "dk": design.dk,
    "fixed": design.fixed,
    "reduce-controller": design.reduce_controller,
    "close-loop": design.close_loop,
    "tracking-problem": control.tracking_problem,
    "cascade": control.cascade,
    "robust-performance": control.robust_performance,
    "simulate-control": control.simulate_control,
    "follow-trajectory": control.follow_trajectory,
    "record": measurement.record,
    "join": measurement.join,
    "compare": measurement.compare,
    "discover": discovery.discover,
    "data-sheet": measurement.data_sheet,
    "cover": measurement.cover,
    "data-cover": story.data_cover,
    "story": story.story,
    "published-numbers": published.published_numbers,
    "thesis-case": published.thesis_case,
}
