"""Figures of a machine that was read off its records."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from robustlab.report.figures import COLOURS, axis_label, house_style, legend_below, new_figure, plain_label

if TYPE_CHECKING:
    from robustlab.dynamics.extended.feed_forward import FeedForward
    from robustlab.identification.validation.measured_machine import MeasuredMachine

POINTS = 1001
LAWS = ("nominal", "good", "limit")  # colours of the feed-forwards, in their order


def map_figure(machine: MeasuredMachine, aheads: Mapping[str, FeedForward]) -> Figure:
    """The input that each place of a period needs, and what feed-forwards give there; friction is in neither."""
    figure, (axes,) = new_figure(1, 1, width=8.0, height=3.2)
    q = np.linspace(0.0, machine.period, POINTS)
    with house_style():
        axes.plot(q, machine.at(q), color=COLOURS["sample"], lw=2.4, label="as the records show it")
        for (name, ahead), colour in zip(aheads.items(), (COLOURS[c] for c in LAWS), strict=False):
            axes.plot(q, ahead(q, np.zeros_like(q)), color=colour, lw=1.2, label=plain_label(name))
        place, needed = (axis_label(s.name, s.unit) for s in (machine.position, machine.input))
        axes.set(xlim=(0.0, machine.period), xlabel=place, ylabel=needed)
        legend_below(figure, (axes,), 3)
    return figure
