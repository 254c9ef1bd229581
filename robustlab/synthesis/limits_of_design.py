"""What limits a finished design, whatever its controller: zeros, poles, integrals of the plant in its problem."""

from __future__ import annotations

from robustlab.errors import RobustlabError
from robustlab.structural import drop_unconnected
from robustlab.synthesis.design import Synthesis
from robustlab.synthesis.performance_limits import PerformanceLimits, performance_limits

__all__ = ["limits_in_words", "limits_of"]


def limits_of(design: Synthesis) -> PerformanceLimits:
    """Limits of what leads from the controls to the measurements of a design's generalised plant.

    Weights that this path does not touch are left out. See `robustlab.performance_limits`.
    """
    plant = design.plant
    names = [s.name for s in plant.controls], [s.name for s in plant.measurements]
    return performance_limits(drop_unconnected(plant.model.select(*names)))


def limits_in_words(design: Synthesis) -> list[str]:
    """The limits in sentences, with the floors of gamma of a mixed-sensitivity design; or why there are none.

    Examples
    --------
    >>> from robustlab.statespace import StateSpaceModel
    >>> from robustlab.synthesis import mixsyn, performance_weight
    >>> G = StateSpaceModel([[-1.0]], [[1.0]], [[-2.0]], [[1.0]])  # (s - 1) / (s + 1)
    >>> limits_in_words(mixsyn(G, performance_weight(0.1), 0.1))[-1][:13]
    'gamma >= 0.59'
    """
    try:
        limits = limits_of(design)
        weights = getattr(design, "weights", {})
        floors = limits.gamma_bounds(weights.get("W1"), weights.get("W3"))
    except RobustlabError as error:
        return [f"not known: {error.line}"]
    return [*limits.summary(), *(floor.text for floor in floors)]
