"""Figure of a residual force without a name: over each coordinate with bands, shares, and the map that corrects it."""

from __future__ import annotations

import math

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from robustlab.identification.unnamed_effect import ForceCurve, ForceTable, ResidualForce, UnnamedForce
from robustlab.report.figures import COLOURS, axis_label, house_style, new_figure, plain_label

__all__ = ["residual_force_figure"]

Array = NDArray[np.float64]
COLUMNS = 2
ASIDE = 0.03  # of the bands' ends may lie outside the vertical axis on either side


def residual_force_figure(residual: ResidualForce, unnamed: UnnamedForce | None = None, name: str = "force") -> Figure:
    """Residual force over each coordinate; below it, what share of it each explains.

    Parameters
    ----------
    residual
        Curves and shares.
    unnamed
        The map fitted to it, drawn over the same coordinates where it has a component that is no dry pair.
    name
        What the force is called on the axes.
    """
    curves = list(residual.curves.values())
    rows = math.ceil((len(curves) + 1) / COLUMNS)
    figure, panels = new_figure(rows, COLUMNS, width=8.4, height=2.7)
    with house_style():
        low, high = _limits(curves)
        for panel, curve in zip(panels, curves, strict=False):
            _curve(panel, curve)
            if unnamed is not None:
                for table in unnamed.components:
                    if table.coordinate == curve.coordinate and table.kind != "dry":
                        _table(panel, table)
            panel.set_ylim(low, high)
            panel.set_xlabel(axis_label(curve.coordinate, curve.unit))
            panel.set_ylabel(axis_label(name, residual.unit))
        _shares(panels[len(curves)], residual, unnamed)
        for panel in panels[len(curves) + 1 :]:
            panel.set_visible(False)
        if curves:
            handles, labels = _once(panels[: len(curves)])
            figure.legend(handles, labels, loc="outside lower center", ncols=3)
    return figure


def _limits(curves: list[ForceCurve]) -> tuple[float, float]:
    """One scale for all panels; single bins with a giant band do not set it."""
    ends = np.concatenate([np.concatenate([c.low, c.high]) for c in curves] or [np.zeros(1)])
    middles = np.concatenate([c.value for c in curves] or [np.zeros(1)])
    low, high = np.quantile(ends, [ASIDE, 1.0 - ASIDE])
    low, high = min(float(low), float(middles.min()), 0.0), max(float(high), float(middles.max()), 0.0)
    edge = 0.06 * (high - low) or 1.0
    return low - edge, high + edge


def _curve(panel: Axes, curve: ForceCurve) -> None:
    panel.axhline(0.0, color="#888888", lw=0.8)
    # A line across zero speed would hide the jump there.
    sides = (curve.x < 0, curve.x >= 0) if curve.coordinate.lower().startswith("speed") else (curve.x == curve.x,)
    for k, side in enumerate(sides):
        panel.fill_between(
            curve.x[side], curve.low[side], curve.high[side], color=COLOURS["band"], alpha=0.35, lw=0,
            label="95 % band" if k == 0 else None,
        )  # fmt: skip
        panel.plot(
            curve.x[side], curve.value[side], "o-", ms=2.8, lw=1.2, color=COLOURS["nominal"],
            label="mean over a bin" if k == 0 else None,
        )  # fmt: skip
    if len(sides) == 2:
        panel.axvline(0.0, color="#888888", lw=0.8)
    chance = "p < 0.005" if curve.p_value < 0.005 else f"p = {curve.p_value:.2g}"
    panel.set_title(f"{plain_label(curve.coordinate)}: explains {100 * curve.share:.0f} % ({chance})")


def _table(panel: Axes, table: ForceTable) -> None:
    halves = table.sides() if table.kind == "speed" else ((table.grid, table.value),)
    for k, (grid, value) in enumerate(halves):
        label = "part of the unnamed map" if k == 0 else None
        panel.plot(grid, value, color=COLOURS["worst"], ls=(0, (5, 1.5)), lw=1.4, label=label)


def _shares(panel: Axes, residual: ResidualForce, unnamed: UnnamedForce | None) -> None:
    rows = [(f"f({name})", curve.share, COLOURS["nominal"]) for name, curve in residual.curves.items()]
    rows += [(f"+ sgn(v) f({name})", share, COLOURS["band"]) for name, share in residual.dry_share.items()]
    rows.append(("all together", residual.joint_share, COLOURS["good"]))
    if unnamed is not None:
        rows.append(("unnamed map", unnamed.gain, COLOURS["worst"]))
    rows.append(("noise of the estimate", residual.noise_share, COLOURS["sample"]))
    place = np.arange(len(rows))[::-1]
    panel.barh(place, [100 * share for _, share, _ in rows], color=[colour for *_, colour in rows], height=0.65)
    for y, (_, share, _) in zip(place, rows, strict=True):
        panel.text(100 * share + 1.5, float(y), f"{100 * share:.0f}", va="center", fontsize=8)
    panel.set_yticks(place, [plain_label(label) for label, *_ in rows], fontsize=8)
    panel.set_xlim(0, 112)
    panel.set_xticks([0, 25, 50, 75, 100])
    panel.grid(axis="y", visible=False)
    panel.set_xlabel("share of the variance, held-out [%]")
    panel.set_title("what explains it")


def _once(panels: list[Axes]) -> tuple[list[Artist], list[str]]:
    """Handles and labels of all panels, each label once."""
    found: dict[str, Artist] = {}
    for panel in panels:
        for handle, label in zip(*panel.get_legend_handles_labels(), strict=True):
            found.setdefault(label, handle)
    return list(found.values()), list(found)
