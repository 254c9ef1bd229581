"""Figure of a record in the envelope of an uncertain model's members (thesis figures 11.5-11.20)."""

from __future__ import annotations

from matplotlib.figure import Figure

from robustlab.identification.envelope import SignalCoverage
from robustlab.report.figures import COLOURS, axis_label, house_style, new_figure

__all__ = ["envelope_figure"]


def envelope_figure(signal: SignalCoverage) -> Figure:
    """The measured signal with nominal response and envelope; below, both minus the nominal response."""
    figure, (above, below) = new_figure(2, 1, width=9.0, height=2.3, sharex=True)
    t, outside = signal.t, signal.share < 1
    with house_style():
        for axes, origin in ((above, 0.0), (below, signal.nominal)):
            lower, upper = signal.lower - origin, signal.upper - origin
            axes.fill_between(t, lower, upper, color=COLOURS["band"], alpha=0.45, lw=0, label="envelope of all members")
            axes.plot(t, signal.nominal - origin, color=COLOURS["nominal"], lw=1.0, label="nominal")
            axes.plot(t, signal.measured - origin, color=COLOURS["measured"], lw=1.2, label="record")
        if outside:
            k = int(abs(t - signal.miss_time).argmin())
            gap = signal.measured[k] - signal.nominal[k]
            below.plot(t[k], gap, "o", color=COLOURS["worst"], ms=5, label="largest miss")
        above.set_ylabel(axis_label(signal.name, signal.unit))
        below.set_ylabel(axis_label("minus nominal", signal.unit))
        below.set_xlabel("time [s]")
        handles, labels = below.get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=4)
    return figure
