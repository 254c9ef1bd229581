"""What a functions figure shows: S, K S and T of the loops of one or several controllers, with their bounds."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from robustlab.report.design_figures import Array, FunctionPanel

if TYPE_CHECKING:
    from robustlab.synthesis.tracking_problem import TrackingProblem

__all__ = ["tracking_panels"]

HEADINGS = {"S": "S: relative error", "KS": "K S: control", "T": "T: relative output"}


def tracking_panels(
    problem: TrackingProblem, controllers: Mapping[str, Any], omega: Array, gamma: float | None = None
) -> list[FunctionPanel]:
    """S, K S and T of the nominal loop of a tracking problem under each controller.

    Parameters
    ----------
    gamma
        Verified gamma of the only controller: what it proves is drawn too.
    """
    gains = {name: problem.gains(K, omega) for name, K in controllers.items()}
    allowed = problem.bounds(omega)
    units = {s.unit for s in problem.plant.controls}
    panels = []
    for function, heading in HEADINGS.items():
        bound = allowed.get(function)
        proved = None if bound is None or gamma is None else gamma * bound
        unit = units.copy().pop() if function == "KS" and len(units) == 1 else ""
        curves = {name: found[function] for name, found in gains.items()}
        panels.append(FunctionPanel(heading, curves, bound, proved, unit))
    return panels
