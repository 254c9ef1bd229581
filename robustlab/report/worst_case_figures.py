"""Figures of sampled metrics: their distribution against a limit, and which parameters matter."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from robustlab.report.figures import COLOURS, axis_label, house_style, new_figure, plain_label
from robustlab.worst_case_analysis.influence import Influence
from robustlab.worst_case_analysis.statistics import ViolationProbability

__all__ = ["distribution_figure", "influence_figure"]

SHOWN = 12
BINS = 40


def distribution_figure(found: ViolationProbability) -> Figure:
    """Histogram of the metric over the samples, with the limit; what violates it is in the colour of the worst."""
    figure, (axes,) = new_figure(1, 1, width=8.0, height=3.6)
    values = found.values[np.isfinite(found.values)]
    low, high = _range(values, found.limit)
    edges = np.linspace(low, high, BINS + 1)
    # The limit is an edge, so that no bar is of two kinds.
    edges[np.argmin(np.abs(edges - found.limit))] = found.limit
    beyond = found.sense * values > found.sense * found.limit
    with house_style():
        for some, colour, label in (
            (~beyond, COLOURS["nominal"], "within the limit"),
            (beyond, COLOURS["worst"], f"violates it: {found.violations} of {found.n}"),
        ):
            axes.hist(values[some], edges.tolist(), color=colour, alpha=0.85, label=label)
        limit = f"limit {found.limit:.4g} {found.unit}".rstrip()
        axes.axvline(found.limit, color=COLOURS["reference"], ls=(0, (5, 2)), lw=1.3, label=plain_label(limit))
        axes.set_xlabel(axis_label(found.metric, found.unit))
        axes.set_ylabel("samples")
        text = f"P(violation) between {found.lower:.3g} and {found.upper:.3g}"
        axes.set_title(f"{text} at {100 * found.confidence:g} % confidence")
        figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=3)
    return figure


def influence_figure(found: Influence, metric: str) -> Figure:
    """Which parameters matter: their shares of the spread, and what each alone would save at the worst sample.

    Left: share of the variance that each parameter explains by itself; a bar that ends in the grey zone may be chance.
    Right: the metric at the worst sample (line), and where it comes to if that one parameter were nominal (dot).
    """
    order = tuple(k for k in found.order if found.matters[k])[:SHOWN] or found.order[:1]
    figure, (shares, saved) = new_figure(1, 2, width=10.4, height=1.4 + 0.3 * max(3, len(order)), sharey=True)
    rows = np.arange(len(order))
    names = [plain_label(found.names[k]) for k in order]
    kinds = {
        1: (COLOURS["worst"], f"{metric} grows with it"),
        -1: (COLOURS["nominal"], f"{metric} falls with it"),
        0: (COLOURS["sample"], "no clear direction"),
    }
    with house_style():
        for direction, (colour, label) in kinds.items():
            some = [row for row, k in enumerate(order) if found.directions[k] == direction]
            if some:
                widths = [100 * found.first_order[order[row]] for row in some]
                shares.barh(some, widths, color=colour, label=plain_label(label))
        shares.axvspan(0, 100 * found.noise, color=COLOURS["sample"], alpha=0.25, lw=0, label="may be chance")
        shares.set_yticks(rows, names)
        shares.invert_yaxis()
        shares.set_xlim(0, max(1.08 * 100 * float(found.first_order.max(initial=0.0)), 200 * found.noise, 1.0))
        shares.set_xlabel("share of the spread [%]")
        rest = len(found.names) - len(order)
        shares.set_title("which parameters matter" + (f" ({rest} more do not, or less)" if rest else ""))
        _draw_savings(saved, found, order)
        saved.set_xlabel(axis_label(metric, found.unit))
        saved.set_title("the worst sample, one parameter nominal")
        handles = [*shares.get_legend_handles_labels()[0], *saved.get_legend_handles_labels()[0]]
        labels = [*shares.get_legend_handles_labels()[1], *saved.get_legend_handles_labels()[1]]
        figure.legend(handles, labels, loc="outside lower center", ncols=3)
    return figure


def _draw_savings(axes: object, found: Influence, order: tuple[int, ...]) -> None:
    from matplotlib.axes import Axes

    assert isinstance(axes, Axes)
    restored = np.where(np.isfinite(found.restored), found.restored, found.worst_value)
    if not np.isfinite(found.worst_value):
        axes.text(0.5, 0.5, "the worst sample has no bounded value", ha="center", transform=axes.transAxes)
        axes.grid(visible=False)
        return
    axes.axvline(found.worst_value, color=COLOURS["worst"], lw=1.4, label="worst sample")
    axes.axvline(found.nominal_value, color=COLOURS["nominal"], lw=1.4, ls=(0, (5, 2)), label="nominal")
    for row, k in enumerate(order):
        axes.plot([found.worst_value, restored[k]], [row, row], color="#444444", lw=1.2)
        axes.plot(restored[k], row, "o", color="#444444", ms=5, label="that parameter nominal" if row == 0 else None)


def _range(values: np.ndarray, limit: float) -> tuple[float, float]:
    """What the axis shows: all finite values and the limit; some width where they are all the same."""
    seen = np.append(values, limit)
    low, high = float(seen.min()), float(seen.max())
    margin = 0.04 * (high - low) or 0.05 * max(abs(high), 1e-12)
    return low - margin, high + margin
