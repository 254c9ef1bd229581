"""The curves of a figure as numbers: what the report's page zooms, and reads values from.

A panel is told by its lines, its bands and its upright bars. What cannot be told so (a loop, a text, a bar that lies)
stays in the picture, which is then shown above the curves and not replaced by them.
"""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from html import escape, unescape
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.colors import to_hex
from matplotlib.container import BarContainer
from matplotlib.figure import Figure
from matplotlib.legend import Legend
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from robustlab.arrays import Array
from robustlab.report.vector import corners_of

MOST_POINTS = 5000  # of a figure
FEWEST_POINTS = 100  # of a curve, however many there are
MOST_OF_A_CURVE = 1000
CHART = 2000.0  # pt; a chart is a third as wide, so that there is something to zoom into
PER_POINT = ("x", "y", "widths")
_PART = re.compile(r'<metadata id="curves">(.*?)</metadata>\n?', re.DOTALL)


def curves_of(figure: Figure) -> dict[str, Any] | None:
    """Panels of the figure with their curves; None where it has none.

    ``whole`` says whether they tell all that the picture does.
    """
    seen = [axes for axes in figure.axes if axes.get_visible()]
    count = sum(len(axes.lines) + 2 * len(axes.collections) for axes in seen) or 1
    room = max(FEWEST_POINTS, min(MOST_OF_A_CURVE, MOST_POINTS // count))
    told = [_panel(axes, room) for axes in seen]
    panels = [panel for panel, _ in told if panel["series"]]
    # One legend may serve several panels: a curve without a name has that of its colour.
    names = {s["colour"]: s["label"] for panel in reversed(panels) for s in panel["series"] if s["label"]}
    for series in (s for panel in panels for s in panel["series"]):
        series["label"] = series["label"] or names.get(series["colour"], "")
    return {"whole": all(whole for _, whole in told), "panels": panels} if panels else None


def with_curves(svg: str, figure: Figure) -> str:
    """The SVG with the figure's curves as metadata."""
    curves = curves_of(figure)
    if curves is None:
        return svg
    text = escape(json.dumps(curves, separators=(",", ":"), allow_nan=False), quote=False)
    head, end, tail = svg.rpartition("</svg>")
    return f'{head}<metadata id="curves">{text}</metadata>\n{end}{tail}'


def split(svg: str) -> tuple[str, str]:
    """The picture alone, and its curves as JSON; the second is empty where there are none."""
    found = _PART.search(svg)
    return (svg, "") if found is None else (_PART.sub("", svg), unescape(found[1]))


def _panel(axes: Axes, room: int) -> tuple[dict[str, Any], bool]:
    """One panel, and whether it holds all that is drawn."""
    series: list[dict[str, Any]] = []
    whole = not (axes.images or axes.texts)
    upright = [c for c in axes.containers if isinstance(c, BarContainer) and _stands_on_zero(c)]
    series += [_bars(bars) for bars in upright]
    for collection in axes.collections:
        edges = _band(collection) if isinstance(collection, PolyCollection) else None
        whole = whole and edges is not None
        if edges is not None:
            colour, name = to_hex(tuple(np.asarray(collection.get_facecolor())[0])), _name(collection.get_label())
            for k, (x, y) in enumerate(edges):
                look = {"label": f"{name or 'band'}, {('lower', 'upper')[k]}", "colour": colour, "width": 0.5}
                series.append({**look, "band": k, **_points(x, y, axes, room, joined=True)})
    for line in axes.lines:
        curve = _line(axes, line)
        whole = whole and (curve is not None or _is_rule(axes, line))
        if curve is not None:
            look = _look(line)
            joined = look["width"] > 0 and "points" not in look
            series.append({**look, **_points(*curve, axes, room, joined)})
    series = _together(series)
    named = _names_in(axes.get_legend())
    for one in series:
        one["label"] = one["label"] or named.get(one["colour"][:7], "")
    whole = whole and len(axes.patches) == sum(len(bars) for bars in upright)
    sides = {
        name: {
            "label": label,
            "log": axis.get_scale() == "log",
            "range": [float(f"{end:.7g}") for end in sorted(limits)],
        }
        for name, label, axis, limits in (
            ("x", axes.get_xlabel() or _shared_label(axes), axes.xaxis, axes.get_xlim()),
            ("y", axes.get_ylabel(), axes.yaxis, axes.get_ylim()),
        )
    }
    return {"title": axes.get_title(loc="left") or axes.get_title(), **sides, "series": series}, whole


def _names_in(legend: Legend | None) -> dict[str, str]:
    """Colour and text of the entries of a panel's legend, which may have been made by hand."""
    found: dict[str, str] = {}
    for handle, text in zip(legend.legend_handles, legend.get_texts(), strict=True) if legend else ():
        colour = handle.get_color() if isinstance(handle, Line2D) else None
        colour = handle.get_facecolor() if isinstance(handle, Patch) else colour
        if colour is not None:
            found.setdefault(to_hex(colour), text.get_text())
    return found


def _shared_label(axes: Axes) -> str:
    """The label below the column of panels that share their horizontal axis."""
    return next((other.get_xlabel() for other in axes.get_shared_x_axes().get_siblings(axes) if other.get_xlabel()), "")


def _line(axes: Axes, line: Line2D) -> tuple[Array, Array] | None:
    """Points of a line with rising x; None where it has no such."""
    x, y = (np.atleast_1d(np.asarray(part)) for part in line.get_data(orig=False))
    if not line.get_visible() or x.dtype.kind not in "if" or y.dtype.kind not in "if" or len(x) == 0:
        return None
    if line.get_transform() is axes.get_yaxis_transform(which="grid"):  # drawn from edge to edge
        return (np.array(axes.get_xlim()), np.repeat(y[:1], 2).astype(float)) if _name(line.get_label()) else None
    if line.get_transform() is not axes.transData:
        return None
    x, y = x.astype(float), y.astype(float)
    kept = np.isfinite(x)
    x, y = np.interp(np.arange(len(x)), np.flatnonzero(kept), x[kept]) if kept.any() else x, np.where(kept, y, np.nan)
    if (np.diff(x) < 0).any():
        if line.get_linestyle() not in ("None", "", " "):
            return None
        order = np.argsort(x, kind="stable")
        x, y = x[order], y[order]
    return x, y


def _is_rule(axes: Axes, line: Line2D) -> bool:
    """A thin line without a name from edge to edge: a zero, a mean."""
    rules = (axes.get_yaxis_transform(which="grid"), axes.get_xaxis_transform(which="grid"))
    across = any(line.get_transform() is rule for rule in rules)
    return across and not _name(line.get_label())


def _look(line: Line2D) -> dict[str, Any]:
    style, marker = line.get_linestyle(), line.get_marker()
    look: dict[str, Any] = {
        "label": _name(line.get_label()),
        "colour": to_hex(line.get_color()),
        "width": round(float(line.get_linewidth()), 2),
    }
    if style in ("None", "", " "):
        look["width"] = 0
    elif style != "-":
        look["dash"] = [6, 3] if style == "--" else [2, 3] if style == ":" else [7, 3, 2, 3]
    return look | ({"points": True} if marker not in ("None", "", " ", None) else {})


def _band(collection: PolyCollection) -> Sequence[tuple[Array, Array]] | None:
    """Lower and upper edge of what lies between two curves."""
    paths = collection.get_paths()
    if len(paths) != 1:
        return None
    corners = np.asarray(paths[0].vertices, dtype=float)
    n, odd = divmod(len(corners) - 3, 2)
    if odd or n < 2:
        return None
    one, other = corners[1 : n + 1], corners[n + 2 : 2 * n + 2][::-1]
    if not np.array_equal(one[:, 0], other[:, 0]) or (np.diff(one[:, 0]) < 0).any():
        return None
    edges = (one, other) if one[:, 1].sum() <= other[:, 1].sum() else (other, one)
    return [(edge[:, 0], edge[:, 1]) for edge in edges]


def _stands_on_zero(bars: BarContainer) -> bool:
    return bars.orientation == "vertical" and len(bars) > 0 and all(b.get_y() == 0 for b in bars)


def _bars(bars: BarContainer) -> dict[str, Any]:
    """Upright bars: their middles, heights and widths."""
    return {
        "label": _name(bars.get_label()),
        "colour": to_hex(bars[0].get_facecolor(), keep_alpha=True),
        "width": 0,
        "x": [_rounded(b.get_x() + 0.5 * b.get_width(), 7) for b in bars],
        "y": [_rounded(b.get_height(), 5) for b in bars],
        "widths": [_rounded(b.get_width(), 5) for b in bars],
    }


def _together(series: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Single points, or bars, that look the same are one series, however they were drawn."""
    kept: dict[Any, dict[str, Any]] = {}
    for k, one in enumerate(series):
        single = one["width"] == 0
        look = tuple(str(item) for key, item in one.items() if key not in PER_POINT) if single else k
        parts = kept.setdefault(look, {**one, **{key: [] for key in PER_POINT if key in one}})
        for key in PER_POINT:
            if key in one:
                parts[key] = parts[key] + one[key]
    for one in kept.values():
        order = sorted(range(len(one["x"])), key=one["x"].__getitem__)
        one.update({key: [one[key][i] for i in order] for key in PER_POINT if key in one})
    return list(kept.values())


def _points(x: Array, y: Array, axes: Axes, room: int, joined: bool) -> dict[str, list[float | None]]:
    """Rounded points; what cannot be drawn is a gap.

    A long curve that is joined by lines keeps the corners that a chart of `CHART` points shows; where these are too
    many, the smallest and largest of each stretch.
    """
    logs = [axis.get_scale() == "log" for axis in (axes.xaxis, axes.yaxis)]
    keep = np.isfinite(x) & ((x > 0) if logs[0] else True)
    x, y = x[keep], y[keep]
    drawn = np.isfinite(y) & ((y > 0) if logs[1] else True)
    if joined and len(x) > FEWEST_POINTS and drawn.all():
        chosen = corners_of(_in_chart(x, axes.get_xlim(), logs[0]), _in_chart(y, axes.get_ylim(), logs[1]))
        x, y, drawn = x[chosen], y[chosen], drawn[chosen]
    if len(x) > room:
        stretches = np.array_split(np.arange(len(x)), room // 2)
        filled = np.where(drawn, y, 0.0)
        ends = [sorted({int(s[filled[s].argmin()]), int(s[filled[s].argmax()])}) for s in stretches]
        chosen = [k for pair in ends for k in pair]
        x, y, drawn = x[chosen], y[chosen], drawn[chosen]
    return {
        "x": [_rounded(v, 7) for v in x],
        "y": [_rounded(v, 5) if ok else None for v, ok in zip(y, drawn, strict=True)],
    }


def _in_chart(values: Array, limits: Sequence[float], log: bool) -> Array:
    """Place of the values along an axis of `CHART` points."""
    placed, ends = (np.log(v) if log else v for v in (values, np.asarray(limits)))
    return CHART * (placed - ends[0]) / (ends[1] - ends[0])


def _rounded(value: float, digits: int) -> float:
    return float(f"{value:.{digits}g}")


def _name(label: object) -> str:
    text = str(label or "")
    return "" if text.startswith("_") else text
