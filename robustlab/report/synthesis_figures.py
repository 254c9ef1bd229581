"""Figures of a mixed-sensitivity design: S, KS and T against the inverses of their weights."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from robustlab.report.figures import COLOURS, house_style, logarithmic, new_figure, plain_label

__all__ = ["WeightedResponse", "sensitivity_figure"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class WeightedResponse:
    """Largest singular value of one closed-loop function over frequency, and the bound its weight asks for.

    Attributes
    ----------
    name
        For example ``"S (control error)"``.
    gain
        Shape (n_omega,).
    bound
        ``gamma / |W|``, shape (n_omega,), or None where the function has no weight.
    """

    name: str
    gain: Array
    bound: Array | None


def sensitivity_figure(omega: Array, responses: Sequence[WeightedResponse], gamma: float) -> Figure:
    """One panel per function: its gain, and below which curve the verified ``gamma`` keeps it."""
    figure, panels = new_figure(1, len(responses), width=3.4 * max(2, len(responses)), height=3.4)
    with house_style():
        for axes, response in zip(panels, responses, strict=True):
            axes.plot(omega, response.gain, color=COLOURS["nominal"], label="closed loop")
            if response.bound is not None:
                axes.plot(
                    omega, response.bound, color=COLOURS["worst"], ls=(0, (5, 2)), label=f"γ / |W|, γ = {gamma:.4g}"
                )
            logarithmic(axes.xaxis)
            logarithmic(axes.yaxis)
            axes.set_title(plain_label(response.name))
            axes.set_xlabel("frequency [rad/s]")
        panels[0].set_ylabel("largest singular value")
        labelled = max(panels, key=lambda axes: len(axes.get_legend_handles_labels()[0]))
        figure.legend(*labelled.get_legend_handles_labels(), loc="outside lower center", ncols=2)
    return figure
