"""Figures of step responses of an uncertain model: members, envelope, worst case (thesis figures 10.2, 10.3)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from robustlab.report.figures import COLOURS, axis_label, house_style, new_figure, plain_label

__all__ = ["response_figure", "worst_case_figure"]

Array = NDArray[np.float64]
MAX_CURVES = 60  # more sample curves than this make the file large and show nothing more than the envelope
SETTLED = 0.8  # the zoomed panel shows the last part of the response


def response_figure(
    t: Array,
    samples: Array,
    nominal: Array,
    envelope: tuple[Array, Array],
    *,
    output: tuple[str, str],
    references: Sequence[tuple[float, str]] = (),
) -> Figure:
    """All responses of one output: the whole time on the left, the end of it enlarged on the right.

    Parameters
    ----------
    t
        Times in s, shape (n_t,).
    samples
        Responses of the members, shape (n_samples, n_t).
    nominal
        Nominal response, shape (n_t,).
    envelope
        Smallest and largest value of all members at each time, each of shape (n_t,).
    output
        Name and unit.
    references
        Known values and what they are, drawn as lines.
    """
    figure, (whole, zoom) = new_figure(1, 2, width=9.6, height=3.6)
    with house_style():
        for axes in (whole, zoom):
            axes.fill_between(t, *envelope, color=COLOURS["band"], alpha=0.25, lw=0, label="envelope of all members")
            for i, curve in enumerate(samples[:MAX_CURVES]):
                axes.plot(t, curve, color=COLOURS["sample"], lw=0.6, alpha=0.8, label="members" if i == 0 else None)
            axes.plot(t, nominal, color=COLOURS["nominal"], label="nominal")
            for value, text in references:
                axes.axhline(value, color=COLOURS["worst"], ls=(0, (5, 2)), lw=1.3, label=plain_label(text))
            axes.set_xlabel("time [s]")
        whole.set_ylabel(axis_label(*output))
        whole.set_title("whole response")
        zoom.set_title("enlarged: the end of the response")
        _enlarge(zoom, t, envelope, [value for value, _ in references])
        handles, labels = whole.get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=4)
    return figure


def worst_case_figure(t: Array, nominal: Array, worst: Array, output: tuple[str, str], label: str) -> Figure:
    """Nominal and worst response of one output, and their difference below."""
    figure, (above, below) = new_figure(2, 1, width=7.6, height=2.2, sharex=True)
    with house_style():
        above.plot(t, nominal, color=COLOURS["nominal"], label="nominal")
        above.plot(t, worst, color=COLOURS["worst"], ls=(0, (6, 2)), label=plain_label(label))
        above.set_ylabel(axis_label(*output))
        above.legend(loc="best")
        below.plot(t, worst - nominal, color=COLOURS["worst"])
        below.axhline(0.0, color="#888888", lw=0.8)
        peak = int(np.argmax(np.abs(worst - nominal)))
        below.plot(t[peak], (worst - nominal)[peak], "o", color=COLOURS["worst"], ms=5)
        below.set_ylabel(axis_label("deviation", output[1]))
        below.set_xlabel("time [s]")
    return figure


def _enlarge(axes: Any, t: Array, curves: Sequence[Array], values: Sequence[float]) -> None:
    last = t >= t[0] + SETTLED * (t[-1] - t[0])
    seen = np.concatenate([*(curve[last] for curve in curves), np.asarray(values, dtype=float)])
    seen = seen[np.isfinite(seen)]
    low, high = (float(seen.min()), float(seen.max())) if len(seen) else (0.0, 1.0)
    margin = 0.12 * (high - low) or 0.05 * max(abs(high), 1e-12)
    axes.set_xlim(t[last][0], t[-1])
    axes.set_ylim(low - margin, high + margin)
