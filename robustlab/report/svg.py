"""A drawing as a file: what nobody can see left out, and its curves as numbers.

A curve of a million samples is drawn as all of its corners with six decimals. On paper a column of `COLUMN` shows no
more of it than its first, last, lowest and highest point there, and no corner that is off by less than `OFF` of a
straight line. Groups that say nothing, unused names and repeated styles go too.

The curves are what the report's page zooms and reads values from. A panel is told by its lines, its bands and its
upright bars. What cannot be told so (a loop, a text, a bar that lies) stays in the picture, which is then shown above
the curves and not replaced by them.
"""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from html import escape, unescape
from itertools import count
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.colors import to_hex
from matplotlib.container import BarContainer
from matplotlib.figure import Figure
from matplotlib.legend import Legend
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from numpy.typing import NDArray

from robustlab.arrays import Array

COLUMN = 0.4  # pt; a page shows a figure of 518 pt on 900 pixels or less, that is 0.7 pixels
OFF = 0.08  # pt
LONG = 40  # corners; a polygon with more is a curve and lies on tenths of a point, others on hundredths

SVG = "{http://www.w3.org/2000/svg}"
HREF = "{http://www.w3.org/1999/xlink}href"
# Verdana has the widths of DejaVu Sans, by which matplotlib places texts; any other font without serifs is narrower.
FONT = "font:9px 'DejaVu Sans',Verdana,sans-serif"
_FAMILY = re.compile(r"font-family:[^;]*;?|(?<![-\w])font-size:9px;?")
_NUMBER = re.compile(r"-?\d*\.?\d+(?:e[-+]?\d+)?")
_PIECE = re.compile(r"([MLCQZz])([^MLCQZz]*)")
_USED = re.compile(r"(?:(?<=url\()|^)#([^)]+)")


def compact(svg: str) -> str:
    """The same picture with fewer characters.

    ``svg``: a drawing written by matplotlib: paths of M, L, C, Q and z in absolute coordinates, styles in ``style``.
    """
    ET.register_namespace("", SVG[1:-1])
    ET.register_namespace("xlink", HREF[1:-5])
    root = ET.fromstring(svg)  # noqa: S314 - matplotlib wrote it a moment ago
    for element in root.iter():
        _shorten(element)
    _unwrap(root)
    _short_names(root)
    _shared_styles(root)
    return f'<?xml version="1.0" encoding="utf-8"?>\n{ET.tostring(root, encoding="unicode")}\n'


def _shorten(element: ET.Element) -> None:
    """Numbers, styles and white space of one element."""
    if element.tag != f"{SVG}text" and not (element.text or "").strip():
        element.text = None
    if not (element.tail or "").strip():
        element.tail = None
    style = re.sub(r"\s*([:;])\s*", r"\1", element.get("style", ""))
    if style:
        element.set("style", _FAMILY.sub("", style).strip(";"))
    if not element.get("style"):
        element.attrib.pop("style", None)
    if "d" in element.attrib:
        element.set("d", _path(element.attrib["d"]))
    turned = element.get("transform", "").startswith("rotate(")
    for name in ("x", "y", "width", "height", "transform"):
        if name in element.attrib and (name != "transform" or turned):
            element.set(name, _NUMBER.sub(lambda found: _short(round(100 * float(found[0])), 2), element.attrib[name]))
    if element.get("transform", "").startswith("rotate(0 "):
        del element.attrib["transform"]


def _unwrap(element: ET.Element) -> None:
    """Take groups away that have nothing but a name, and empty ones; markers that lie on one another are drawn once."""
    children: list[ET.Element] = []
    for child in element:
        if child.tag == f"{SVG}metadata":
            continue
        _unwrap(child)
        if child.tag == f"{SVG}g" and not set(child.attrib) - {"id"}:
            children += child
        elif len(child) or child.tag not in (f"{SVG}g", f"{SVG}defs"):
            children.append(child)
    element[:] = _seen(children)


def _seen(children: list[ET.Element]) -> Iterator[ET.Element]:
    """Without the markers that later ones of the same kind cover to a fifth of a point."""
    covered: set[tuple[str, ...]] = set()
    kept: list[ET.Element] = []
    for child in reversed(children):
        if child.tag == f"{SVG}use" and "transform" not in child.attrib:
            place = tuple(str(round(5 * float(child.get(side, "0")))) for side in "xy")
            key = (child.get(HREF, ""), child.get("style", ""), *place)
            if key in covered:
                continue
            covered.add(key)
        kept.append(child)
    return reversed(kept)


def _shared_styles(root: ET.Element) -> None:
    """Styles that come up again are classes."""
    styles = Counter(e.attrib["style"] for e in root.iter() if "style" in e.attrib)
    names = _names()
    classes = {style: next(names) for style, times in styles.items() if times > 2}
    for element in root.iter():
        if element.get("style") in classes:
            element.set("class", classes[element.attrib.pop("style")])
    sheet = root.find(f".//{SVG}style")
    if sheet is not None:
        sheet.text = f"svg{{{FONT}}}{sheet.text}" + "".join(f".{name}{{{s}}}" for s, name in classes.items())


def _short_names(root: ET.Element) -> None:
    """Short names of what is referred to; no others."""
    names = _names()
    places = [(e, key) for e in root.iter() for key, value in e.attrib.items() if key == HREF or "url(#" in value]
    short = {found[1]: "" for e, key in places for found in _USED.finditer(e.attrib[key])}
    short = {name: next(names) for name in short}
    for element, key in places:
        element.set(key, _USED.sub(lambda found: "#" + short[found[1]], element.attrib[key]))
    for element in root.iter():
        name = element.attrib.pop("id", None)
        if name in short:
            element.set("id", short[name])


def _names() -> Iterator[str]:
    """a, b, ..., z, a1, b1, ..."""
    for k in count():
        yield chr(ord("a") + k % 26) + (str(k // 26) if k > 25 else "")


# --- paths -----------------------------------------------------------------------------------------------------------


def _path(d: str) -> str:
    """A path with relative steps on a grid of tenths or hundredths of a point."""
    pieces = [(kind, np.array(_NUMBER.findall(rest), dtype=float)) for kind, rest in _PIECE.findall(d)]
    if {kind for kind, _ in pieces} & {"C", "Q"}:
        return "".join(kind.upper() + _joined([_short(round(100 * v), 2) for v in numbers]) for kind, numbers in pieces)
    polygons: list[tuple[list[Array], bool]] = []
    for kind, numbers in pieces:
        if kind == "M":
            polygons.append(([numbers], False))
        elif kind == "L":
            polygons[-1][0].append(numbers)
        else:
            polygons[-1] = polygons[-1][0], True
    return "".join(_polygon(np.concatenate(corners).reshape(-1, 2), closed) for corners, closed in polygons)


def _polygon(corners: Array, closed: bool) -> str:
    decimals = 1 if len(corners) > LONG else 2
    steps = np.rint(10**decimals * thinned(corners)).astype(int)
    steps[1:] -= steps[:-1].copy()
    moves = [_short(v, decimals) for v in steps.ravel()]
    line = f"l{_joined(moves[2:])}" if len(moves) > 2 else ""
    return f"M{_joined(moves[:2])}{line}{'z' if closed else ''}"


def _short(value: int, decimals: int) -> str:
    """An integer of tenths or hundredths as a decimal number, as short as it can be."""
    sign, digits = "-" if value < 0 else "", str(abs(value)).rjust(decimals + 1, "0")
    whole, part = digits[:-decimals], digits[-decimals:].rstrip("0")
    return sign + (whole if not part else f"{'' if whole == '0' else whole}.{part}")


def _joined(numbers: list[str]) -> str:
    """Numbers of a path; a sign is a separator."""
    return "".join(text if k == 0 or text[0] == "-" else f" {text}" for k, text in enumerate(numbers))


def thinned(corners: Array) -> Array:
    """The corners (n, 2) of a polygon without those that make no difference to the eye.

    Of every stretch that runs one way from left to right, or back, each column keeps its first, last, lowest and
    highest corner; what then lies within `OFF` of the line through its neighbours goes (Ramer 1972; Douglas and Peucker
    1973).
    """
    if len(corners) <= LONG:
        return corners
    heading = np.sign(np.diff(corners[:, 0]))
    known = np.flatnonzero(heading)
    if len(known):  # upright pieces go on as the piece before them
        at = np.maximum.accumulate(np.where(heading != 0, np.arange(len(heading)), known[0]))
        heading = heading[at]
    turns = np.flatnonzero(np.diff(heading)) + 1
    column = np.floor(corners[:, 0] / COLUMN)
    new = np.concatenate([[True], np.diff(column) != 0])
    new[turns] = True
    starts = np.flatnonzero(new)
    ends = np.append(starts[1:], len(corners))
    kept = np.zeros(len(corners), dtype=bool)
    kept[starts] = kept[ends - 1] = True
    for first, last in zip(starts, ends, strict=True):
        if last - first > 2:
            heights = corners[first:last, 1]
            kept[[first + heights.argmin(), first + heights.argmax()]] = True
    left = corners[kept]
    return left[corners_of(*left.T)]


def corners_of(x: Array, y: Array) -> NDArray[np.intp]:
    """Which points of a line are corners: the others lie within `OFF` of the line through these."""
    points = np.column_stack([x, y])
    kept = np.zeros(len(points), dtype=bool)
    kept[[0, -1]] = True
    open_ = [(0, len(points) - 1)]
    while open_:
        first, last = open_.pop()
        if last - first < 2:
            continue
        along, inner = points[last] - points[first], points[first + 1 : last] - points[first]
        length = float(np.hypot(*along))
        # The distance from the piece, not from the line that it lies on: a curve may turn back.
        share = np.clip(inner @ along / length**2, 0, 1) if length else np.zeros(len(inner))
        off = np.hypot(*(inner - share[:, None] * along).T)
        furthest = int(off.argmax())
        if off[furthest] > OFF:
            kept[first + 1 + furthest] = True
            open_ += [(first, first + 1 + furthest), (first + 1 + furthest, last)]
    return np.flatnonzero(kept)


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
