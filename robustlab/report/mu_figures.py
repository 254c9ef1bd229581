"""Figure of mu bounds over frequency, with the intervals on which the upper bound is proved."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from robustlab.report.figures import COLOURS, house_style, logarithmic, new_figure

__all__ = ["mu_figure"]

Array = NDArray[np.floating[Any]]
PROVED = "#d6ecf8"  # opaque: the intervals overlap


def mu_figure(
    omega: Array, lower: Array, upper: Array, intervals: Sequence[tuple[float, float, float]], critical: float | None
) -> Figure:
    """Bounds of mu over frequency.

    Parameters
    ----------
    omega
        Frequencies in rad/s, shape (n,).
    lower, upper
        Bounds of mu at these frequencies, shape (n,).
    intervals
        ``(from, to, bound)``: mu is proved to be at most ``bound`` at every frequency between; the outer ones may
        reach 0 and inf.
    critical
        Frequency in rad/s at which the destabilising Delta puts a pole on the axis, or None.
    """
    figure, (axes,) = new_figure(1, 1, width=8.0, height=3.6)
    shown = np.isfinite(omega) & (omega > 0)
    low, high = (float(omega[shown].min()), float(omega[shown].max())) if shown.any() else (1e-1, 1e1)
    with house_style():
        for i, (start, stop, bound) in enumerate(intervals):
            edges = [max(start, low), min(stop, high)]
            if edges[0] < edges[1]:
                label = "proved for every frequency between" if i == 0 else None
                axes.fill_between(edges, 0, bound, color=PROVED, lw=0, label=label)
        axes.plot(omega[shown], upper[shown], color=COLOURS["nominal"], label="upper bound (proved by D, G)")
        found = shown & (lower > 0)
        axes.plot(
            omega[found],
            lower[found],
            ".",
            color=COLOURS["worst"],
            ms=4,
            label="lower bound (attained by an explicit Δ)",
        )
        axes.axhline(1.0, color=COLOURS["reference"], ls=(0, (5, 2)), lw=1.1, label="1: robust stability limit")
        if critical is not None and np.isfinite(critical) and critical > 0:
            axes.axvline(critical, color=COLOURS["worst"], lw=0.9, ls=":")
        logarithmic(axes.xaxis)
        axes.set_xlim(low, high)
        axes.set_ylim(0, 1.12 * max(1.0, float(np.nanmax(upper[shown], initial=0.0))))
        axes.set_xlabel("frequency [rad/s]")
        axes.set_ylabel("structured singular value μ")
        figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=2)
    return figure
