"""All figures of a finished design: which there are, and what they show."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from robustlab.report.design_figures import FunctionPanel, functions_figure, history_figure, loop_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from robustlab.synthesis.problem.design import Synthesis

__all__ = ["functions_picture", "history_picture", "loop_picture", "mu_picture", "pictures"]

PICTURE_HEADINGS = {"S": "S: r → error", "T": "T: r → y", "KS": "K S: r → u", "SG": "S G: d → y"}


def pictures(design: Synthesis) -> dict[str, Callable[[], Figure]]:
    """Suffix of the file -> what draws it; the first, without a suffix, is the weighted loop with the controller."""
    from robustlab.synthesis.dk.dk_design import DKSynthesis

    found: dict[str, Callable[[], Figure]] = {"": lambda: loop_picture(design)}
    if isinstance(design, DKSynthesis):
        return found | {"mu": lambda: mu_picture(design), "history": lambda: history_picture(design)}
    return found | {"functions": lambda: functions_picture(design)}


def loop_picture(design: Synthesis) -> Figure:
    """The weighted closed loop with its peak marked, and the controller."""
    from robustlab.synthesis.specifications.loop_functions import loop_curves

    curves = loop_curves(design)
    heading = "closed loop, channels of Δ included" if design.plant.blocks else "weighted closed loop"
    controller = (curves.controller, curves.measurements)
    return loop_figure(curves.omega, curves.closed_loop, curves.peak, controller, curves.level, heading)


def functions_picture(design: Synthesis) -> Figure:
    """S, T, K S and S G of the loop at what the controller measures, against 1 / |W| and gamma / |W| where known."""
    import numpy as np

    from robustlab.synthesis.specifications.loop_functions import FUNCTIONS, frequencies, loop_functions_of

    loop = loop_functions_of(design)
    omega = frequencies(loop.S, around=getattr(design, "peak_frequency", None))
    panels = []
    for name in FUNCTIONS:
        proved = loop.bound(name, omega)
        finite = proved is not None and bool(np.isfinite(proved).all())
        panels.append(
            FunctionPanel(
                PICTURE_HEADINGS[name],
                {"closed loop": loop.gain(name, omega)},
                proved / loop.gamma if proved is not None and finite else None,
                proved if finite else None,
            )
        )
    return functions_figure(omega, panels, loop.gamma if loop.weights else None)


def mu_picture(design: Any) -> Figure:
    """Bounds of mu of a D-K design over frequency, proved on the whole axis once more from its closed loop alone."""
    from robustlab.mu_analysis import robust_performance
    from robustlab.report.mu_figures import mu_figure
    from robustlab.synthesis.specifications.loop_functions import frequencies
    from robustlab.uncertainty.lft import UncertainModel

    loop = UncertainModel(design.closed_loop, [b for b in design.blocks if b.name != "performance"])
    omega = frequencies(design.closed_loop, 160)
    return mu_figure(robust_performance(loop, omega=omega, accuracy=1e-3, tolerance=float("inf")))


def history_picture(design: Any) -> Figure:
    """The search of a D-K design: levels and orders of all iterates."""
    steps = design.history
    mu, proved = [s.mu for s in steps], [s.gamma for s in steps]
    return history_figure(mu, proved, [s.order for s in steps], [s.stage for s in steps])
