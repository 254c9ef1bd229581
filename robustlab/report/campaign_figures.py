"""Figure of a campaign: how often the metric exceeds a value."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from robustlab.report.figures import COLOURS, axis_label, house_style, logarithmic, new_figure, plain_label

__all__ = ["exceedance_figure"]

Array = NDArray[np.float64]


def exceedance_figure(
    values: Array, share: Array, upper: Array, *, metric: tuple[str, str], limit: float | None = None
) -> Figure:
    """Share of the samples worse than each value, with its upper confidence bound; the logarithmic axis shows the tail.

    Parameters
    ----------
    values
        Values of the metric from the best to the worst, shape (m,).
    share
        Share of the samples worse than each, shape (m,).
    upper
        One-sided 95 % bound of the probability that a member is worse than each, shape (m,).
    metric
        Its name and unit.
    limit
        A value to mark.
    """
    figure, (axes,) = new_figure(height=3.4)
    seen = share > 0
    with house_style():
        if seen.any():
            axes.step(values[seen], share[seen], where="post", color=COLOURS["nominal"], label="share of the samples")
        axes.plot(values, upper, color=COLOURS["worst"], ls=(0, (6, 2)), label="probability, at most (95 %)")
        if len(values):
            axes.plot(values[-1], upper[-1], "o", color=COLOURS["worst"], ms=5, label="worst sample")
        if limit is not None:
            axes.axvline(limit, color=COLOURS["limit"], lw=1.3, label=plain_label(f"limit {limit:g}"))
        axes.set_xlabel(axis_label(*metric))
        axes.set_ylabel("probability to be worse")
        axes.legend(loc="best")
    logarithmic(axes.yaxis)
    return figure
