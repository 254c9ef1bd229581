"""A figure as SVG, drawn by us from its panels, curves, bands and words: some milliseconds where matplotlib takes 200.

matplotlib's axes are the description: what is in them is read and written down at the places of
`robustlab.report.layout`. What is not known here (an image, a picture in a picture) matplotlib draws itself.

A curve of a million samples has no more corners than can be seen: a column of `COLUMN` shows its first, last, lowest
and highest point there, and no corner that is off by less than `OFF` of a straight line.
"""

from __future__ import annotations

from functools import lru_cache
from html import escape
from io import StringIO
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.cbook import STEP_LOOKUP_MAP
from matplotlib.collections import Collection, LineCollection, PolyCollection
from matplotlib.colors import to_hex, to_rgba
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.text import Annotation
from numpy.typing import NDArray

from robustlab.arrays import Array
from robustlab.report.layout import (
    HANDLE,
    LINE,
    PAD,
    TICK,
    Box,
    FigurePlan,
    LegendBlock,
    PanelPlan,
    outside,
    plan,
    widest,
)

COLUMN = 0.4  # pt; a page shows a figure of 518 pt on 900 pixels or less, that is 0.7 pixels
OFF = 0.08  # pt
LONG = 40  # corners; a polygon with more is a curve and lies on tenths of a point, others on hundredths
HEAVY = ("bold", 700)
FAR = 1e4  # pt; what lies further out is not seen, and browsers compute with few digits
# Verdana has the widths of DejaVu Sans, by which texts are placed; any other font without serifs is narrower.
STYLE = (
    "svg{font:9px 'DejaVu Sans',Verdana,sans-serif}path{fill:none;stroke-linejoin:round}text{white-space:pre}"
    ".g{stroke:#e3e5e8;stroke-width:.7}.a{stroke:#666;stroke-width:.8}.t{fill:#444}"
)
LEGEND_AT = {  # matplotlib's numbers of places: shares of the free width and height
    1: (1.0, 0.0), 2: (0.0, 0.0), 3: (0.0, 1.0), 4: (1.0, 1.0), 5: (1.0, 0.5), 6: (0.0, 0.5), 7: (1.0, 0.5),
    8: (0.5, 1.0), 9: (0.5, 0.0), 10: (0.5, 0.5),
}  # fmt: skip
# Markers as paths in halves of their size; o and . are dots.
SHAPES = {
    "s": "M-1-1H1V1H-1z", "D": "M0-1.4 1.4 0 0 1.4-1.4 0z", "d": "M0-1.4.85 0 0 1.4-.85 0z",
    "^": "M0-1 1 1H-1z", "v": "M0 1 1-1H-1z", "<": "M-1 0 1-1V1z", ">": "M1 0-1-1V1z",
    "x": "M-1-1 1 1M-1 1 1-1", "+": "M-1 0H1M0-1V1", "|": "M0-1V1", "_": "M-1 0H1",
    "*": "M-1 0H1M-.5-.87.5.87M-.5.87.5-.87",
}  # fmt: skip


class _Unknown(Exception):
    """Something that is not written down here."""


def svg_of(figure: Figure) -> str:
    """The figure as an SVG; the same figure gives the same characters."""
    found = plan(figure)
    if found is None:
        return _of_matplotlib(figure)
    try:
        body = [_Panel(panel, k).drawn() for k, panel in enumerate(found.panels)]
    except _Unknown:
        return _of_matplotlib(figure)
    body += [_legend(block, x, y) for block, x, y in found.legends]
    if found.heading:
        body.append(_text(found.heading, PAD, PAD + 10.5, 10.5, bold=True))
    return _document(found, "".join(body))


def _document(found: FigurePlan, body: str) -> str:
    width, height = _n(found.width), _n(found.height)
    size = f'width="{width}pt" height="{height}pt" viewBox="0 0 {width} {height}"'
    back = f'<rect width="{width}" height="{height}" fill="#fff"/>'
    head = '<?xml version="1.0" encoding="utf-8"?>\n'
    return f'{head}<svg xmlns="http://www.w3.org/2000/svg" {size}><style>{STYLE}</style>{back}{body}</svg>\n'


def _of_matplotlib(figure: Figure) -> str:
    text = StringIO()
    figure.savefig(text, format="svg", metadata={"Date": None})
    return text.getvalue()


class _Panel:
    """One panel, from its grid to its legend."""

    def __init__(self, panel: PanelPlan, number: int) -> None:
        self.plan, self.axes, self.box, self.number = panel, panel.axes, panel.box, number
        axes = panel.axes
        self.ends = [
            axis.get_transform().transform(np.asarray(limits, dtype=float))
            for axis, limits in ((axes.xaxis, axes.get_xlim()), (axes.yaxis, axes.get_ylim()))
        ]

    def drawn(self) -> str:
        """All of it."""
        axes, box = self.axes, self.box
        clip = f'<clipPath id="c{self.number}"><rect {_rectangle(box)}/></clipPath>'
        artists = [*axes.patches, *axes.collections, *axes.lines]
        if axes.artists or axes.tables or axes.child_axes:
            raise _Unknown
        inside = [self._artist(one) for one in sorted(filter(_seen, artists), key=lambda one: one.get_zorder())]
        marks = "".join(text for text, clipped in inside if clipped)
        free = "".join(text for text, clipped in inside if not clipped)
        parts = [self._grid() if axes.axison else "", f'<g clip-path="url(#c{self.number})">{marks}</g>', free]
        parts += [self._frame() if axes.axison else "", *(self._note(text) for text in axes.texts if _seen(text))]
        return clip + "".join(parts) + self._words() + self._own_legend()

    def x(self, values: Any) -> Array:
        """Places of values along the horizontal axis."""
        return self._along(self.axes.xaxis, values, self.ends[0], self.box.x, self.box.width)

    def y(self, values: Any) -> Array:
        """Places of values along the vertical axis."""
        return self._along(self.axes.yaxis, values, self.ends[1], self.box.below, -self.box.height)

    @staticmethod
    def _along(axis: Any, values: Any, ends: Array, start: float, length: float) -> Array:
        with np.errstate(all="ignore"):
            at = axis.get_transform().transform(np.asarray(values, dtype=float))
            return np.clip(start + length * (at - ends[0]) / (ends[1] - ends[0]), -FAR, FAR)

    def _placed(self, points: Array, transform: Any) -> Array:
        """Points (n, 2) in data, or shares of the panel where the transform says so."""
        axes, box = self.axes, self.box
        data = [transform in kinds for kinds in (
            (axes.transData, axes.get_xaxis_transform(which="grid"), axes.get_xaxis_transform()),
            (axes.transData, axes.get_yaxis_transform(which="grid"), axes.get_yaxis_transform()),
        )]  # fmt: skip
        if not any(data) and transform != axes.transAxes:
            raise _Unknown
        x = self.x(points[:, 0]) if data[0] else box.x + box.width * points[:, 0]
        y = self.y(points[:, 1]) if data[1] else box.below - box.height * points[:, 1]
        return np.column_stack([x, y])

    # --- what stands around -------------------------------------------------------------------------------------

    def _grid(self) -> str:
        box, found = self.box, ""
        if self.axes.xaxis.get_tick_params(which="major").get("gridOn"):
            found += "".join(f"M{_n(x)} {_n(box.y)}V{_n(box.below)}" for x in self.x(self.plan.x.at))
        if self.axes.yaxis.get_tick_params(which="major").get("gridOn"):
            found += "".join(f"M{_n(box.x)} {_n(y)}H{_n(box.right)}" for y in self.y(self.plan.y.at))
        return f'<path class="g" d="{found}"/>' if found else ""

    def _frame(self) -> str:
        """Spines, ticks and what they say."""
        box, axes = self.box, self.axes
        left, right, top, bottom = _n(box.x), _n(box.right), _n(box.y), _n(box.below)
        sides = {
            "bottom": f"M{left} {bottom}H{right}", "top": f"M{left} {top}H{right}",
            "left": f"M{left} {top}V{bottom}", "right": f"M{right} {top}V{bottom}",
        }  # fmt: skip
        lines = "".join(path for side, path in sides.items() if axes.spines[side].get_visible())
        for along, up, length in ((self.plan.x.at, self.plan.y.at, TICK), (self.plan.x.minor, self.plan.y.minor, 2.0)):
            lines += "".join(f"M{_n(x)} {bottom}v{_n(length)}" for x in self.x(along))
            lines += "".join(f"M{left} {_n(y)}h{_n(-length)}" for y in self.y(up))
        return f'<path class="a" d="{lines}"/>{self._tick_texts()}'

    def _tick_texts(self) -> str:
        box, (along, up) = self.box, (self.plan.x, self.plan.y)
        found = [
            _text(text, x, box.below + TICK + PAD + 0.75 * along.size, along.size, "middle", kind="t")
            for x, text in zip(self.x(along.at), along.texts, strict=True) if text
        ]  # fmt: skip
        for y, text in zip(self.y(up.at), up.texts, strict=True):
            if text:
                middle = y + 0.35 * up.size - 0.5 * up.size * LINE * text.count("\n")
                found.append(_text(text, box.x - TICK - PAD, middle, up.size, "end", kind="t"))
        if up.offset:
            found.append(_text(up.offset, box.x, box.y - PAD, 9.0, kind="t"))
        if along.offset:
            found.append(_text(along.offset, box.right, box.below + self.plan.room()[3], 9.0, "end", kind="t"))
        return "".join(found)

    def _words(self) -> str:
        """Title and labels."""
        box, axes, found = self.box, self.axes, ""
        left, _, _, below = self.plan.room()
        title = self.plan.title
        if title.get_text():
            words, size = title.get_text(), float(title.get_fontsize())
            x, anchor = box.x + 0.5 * box.width, "middle"
            if axes.get_title(loc="left"):  # it may stand over the ticks of the axis where it would not fit beside them
                x, anchor = box.x - min(max(widest(words, size, bold=True) - box.width, 0.0), left - PAD), "start"
            y = box.y - PAD - 0.2 * size - size * LINE * words.count("\n")
            found += _text(words, x, y, size, anchor, bold=title.get_fontweight() in HEAVY)
        label = axes.yaxis.label
        if label.get_text():
            size = float(label.get_fontsize())
            at = box.x - left + 0.8 * size, box.y + 0.5 * box.height
            found += _text(label.get_text(), *at, size, "middle", turned=True)
        label = axes.xaxis.label
        if label.get_text():
            size, legend = float(label.get_fontsize()), self.plan.legend
            if legend is not None and outside(legend.legend, axes)[1]:
                below -= legend.height + PAD
            y = box.below + below - 0.25 * size - size * LINE * label.get_text().count("\n")
            found += _text(label.get_text(), box.x + 0.5 * box.width, y, size, "middle")
        return found

    def _own_legend(self) -> str:
        block = self.plan.legend
        if block is None or not block.entries:
            return ""
        legend, box = block.legend, self.box
        beside, under = outside(legend, self.axes)
        if beside:
            return _legend(block, box.right + 2 * PAD, box.y)
        if under:
            x, y = box.x + 0.5 * (box.width - block.width), box.below + self.plan.room()[3] - block.height
            return _legend(block, x, y)
        place = getattr(legend, "_loc", 0)  # its place has no other name
        inner = Box(box.x + PAD, box.y + PAD, box.width - 2 * PAD - block.width, box.height - 2 * PAD - block.height)
        share = LEGEND_AT.get(place) if isinstance(place, int) else None
        if share is None:
            share = self._emptiest(inner, block)
        return _legend(block, inner.x + share[0] * inner.width, inner.y + share[1] * inner.height)

    def _emptiest(self, inner: Box, block: LegendBlock) -> tuple[float, float]:
        """The place for a legend where the fewest points of curves lie."""
        points = [self._placed(self._points_of(line), line.get_transform()) for line in self.axes.lines if _seen(line)]
        points += [
            self._placed(np.asarray(path.vertices, dtype=float), one.get_transform())
            for one in self.axes.collections if isinstance(one, PolyCollection) for path in one.get_paths()
        ]  # fmt: skip
        every = np.concatenate([np.zeros((0, 2)), *(p[:: max(1, len(p) // 2000)] for p in points)])

        def covered(share: tuple[float, float]) -> int:
            x, y = inner.x + share[0] * inner.width, inner.y + share[1] * inner.height
            inside = (every > (x, y)) & (every < (x + block.width, y + block.height))
            return int(inside.all(axis=1).sum())

        return min((LEGEND_AT[k] for k in (1, 2, 3, 4, 6, 7, 8, 9, 10)), key=covered)

    # --- what is drawn in it ------------------------------------------------------------------------------------

    def _artist(self, one: Any) -> tuple[str, bool]:
        """Its drawing, and whether it ends at the panel's edges."""
        if isinstance(one, Line2D):
            return self._line(one), bool(one.get_clip_on()) and not _is_dot_on_edge(one)
        if isinstance(one, Patch):
            path = one.get_path().transformed(one.get_patch_transform())
            placed = [
                self._placed(np.asarray(p), one.get_data_transform()) for p in path.to_polygons(closed_only=False)
            ]
            return _filled(placed, one.get_facecolor(), one), True
        if isinstance(one, LineCollection):
            segments = [self._placed(np.asarray(s, dtype=float), one.get_transform()) for s in one.get_segments()]
            return f'<path d="{"".join(_polygon(s, closed=False) for s in segments)}" {_sticks(one)}/>', True
        if isinstance(one, PolyCollection):
            placed = [self._placed(np.asarray(p.vertices, dtype=float), one.get_transform()) for p in one.get_paths()]
            colours = np.asarray(one.get_facecolor())
            return (_filled(placed, tuple(colours[0]), one) if len(colours) else ""), True
        raise _Unknown

    @staticmethod
    def _points_of(line: Line2D) -> Array:
        x, y = (np.asarray(side, dtype=float) for side in line.get_data(orig=False))
        style = line.get_drawstyle()
        if style != "default":
            x, y = STEP_LOOKUP_MAP[style](x, y)
        return np.column_stack([np.atleast_1d(x), np.atleast_1d(y)])

    def _line(self, line: Line2D) -> str:
        placed = self._placed(self._points_of(line), line.get_transform())
        known = np.isfinite(placed).all(axis=1)
        found = ""
        if line.get_linestyle() not in ("None", "", " ") and line.get_linewidth() > 0:
            cuts = np.flatnonzero(np.diff(known.astype(int))) + 1
            pieces = [p for p, k in zip(np.split(placed, cuts), np.split(known, cuts), strict=True) if len(k) and k[0]]
            d = "".join(_polygon(piece, closed=False) for piece in pieces if len(piece) > 1)
            found += f'<path d="{d}" {_stroke(line)}/>' if d else ""
        return found + _markers(line, placed[known])

    def _note(self, text: Any) -> str:
        """A text at a point of the panel."""
        x, y = text.get_position() if not isinstance(text, Annotation) else text.xy
        dx = dy = 0.0
        transform: Any = text.get_transform()
        if isinstance(text, Annotation):
            if text.arrow_patch is not None or text.xycoords != "data":
                raise _Unknown
            transform = self.axes.transData
            if text.anncoords == "offset points":
                dx, dy = text.xyann
        place = self._placed(np.array([[x, y]], dtype=float), transform)[0] + (dx, -dy)
        size, words = float(text.get_fontsize()), text.get_text()
        shift = {"center": 0.35, "top": 0.8, "bottom": -0.2, "center_baseline": 0.35}.get(
            text.get_verticalalignment(), 0.0
        ) * size
        shift -= (
            0.5 * size * LINE * words.count("\n")
            if text.get_verticalalignment() in ("center", "center_baseline")
            else 0.0
        )
        anchor = {"center": "middle", "right": "end"}.get(text.get_horizontalalignment(), "start")
        heavy, colour = text.get_fontweight() in HEAVY, _hex(text.get_color())
        return _text(words, place[0], place[1] + shift, size, anchor, bold=heavy, colour=colour)


def _seen(one: Artist) -> bool:
    return one.get_visible()


def _is_dot_on_edge(line: Line2D) -> bool:
    """Whether it is single marks alone: these are not cut at the panel's edge."""
    return line.get_linestyle() in ("None", "", " ") and len(np.atleast_1d(line.get_xdata())) == 1


# --- looks -----------------------------------------------------------------------------------------------------------


def _hex(colour: Any) -> str:
    return to_hex(to_rgba(colour))


def _opacity(colour: Any, alpha: float | None, of: str) -> str:
    share = to_rgba(colour)[3] if alpha is None else alpha
    return f' {of}-opacity="{_n(share)}"' if share < 1 else ""


def _stroke(line: Line2D) -> str:
    width, colour = float(line.get_linewidth()), line.get_color()
    look = f'stroke="{_hex(colour)}" stroke-width="{_n(width)}"{_opacity(colour, line.get_alpha(), "stroke")}'
    dashes = getattr(line, "_dash_pattern", (0, None))[1]
    if dashes:
        return f'{look} stroke-dasharray="{" ".join(_n(d) for d in dashes)}"'
    return look + (' stroke-linecap="square"' if line.get_solid_capstyle() != "butt" else "")


def _sticks(lines: LineCollection) -> str:
    width = float(np.ravel(lines.get_linewidth())[0])
    return f'stroke="{_hex(np.atleast_2d(lines.get_color())[0])}" stroke-width="{_n(width)}"'


def _filled(polygons: list[Array], colour: Any, one: Patch | Collection) -> str:
    d = "".join(_polygon(p[np.isfinite(p).all(axis=1)], closed=True) for p in polygons)
    if not d:
        return ""
    alpha: Any = one.get_alpha()
    edge, width = (np.ravel(v) for v in (one.get_edgecolor(), one.get_linewidth()))
    look = f'style="fill:{_hex(colour)}"{_opacity(colour, alpha, "fill")}'
    if len(edge) >= 4 and edge[3] > 0 and len(width) and width[0] > 0:
        look += f' stroke="{_hex(tuple(edge[:4]))}" stroke-width="{_n(float(width[0]))}"'
    found = f'<path d="{d}" {look}/>'
    if one.get_hatch():  # stripes over it
        name = f"h{_hex(colour)[1:]}"
        stripes = '<path d="M-1 1 1-1M0 6 6 0M5 7 7 5" style="stroke:#444;stroke-width:.7"/>'
        pattern = f'<pattern id="{name}" width="6" height="6" patternUnits="userSpaceOnUse">{stripes}</pattern>'
        found += f'{pattern}<path d="{d}" style="fill:url(#{name})"/>'
    return found


def _markers(line: Line2D, points: Array) -> str:
    """Its markers; of those that lie on one another to a fifth of a point, one."""
    kind, size = line.get_marker(), float(line.get_markersize())
    if kind in ("None", "", " ", None) or not len(points):
        return ""
    kept = points[np.sort(np.unique(np.rint(5 * points), axis=0, return_index=True)[1])]
    alpha = line.get_alpha()
    face, edge, width = line.get_markerfacecolor(), line.get_markeredgecolor(), float(line.get_markeredgewidth())
    hollow = isinstance(face, str) and face == "none"
    border = f' stroke="{_hex(edge)}" stroke-width="{_n(width)}"{_opacity(edge, alpha, "stroke")}' if width > 0 else ""
    fill = "fill:none" if hollow else f"fill:{_hex(face)}"
    look = f'style="{fill}"{"" if hollow else _opacity(face, alpha, "fill")}{border}'
    if kind in ("o", "."):
        r = 0.5 * size * (0.5 if kind == "." else 1.0)
        same = not hollow and (width == 0 or _hex(face) == _hex(edge))
        if same:  # dots are the round ends of strokes without length
            d = "".join(f"M{_n(x)} {_n(y)}h0" for x, y in kept)
            broad = f'stroke-width="{_n(2 * r + width)}" stroke-linecap="round"'
            return f'<path d="{d}" stroke="{_hex(face)}" {broad}{_opacity(face, alpha, "stroke")}/>'
        return "".join(f'<circle cx="{_n(x)}" cy="{_n(y)}" r="{_n(r)}" {look}/>' for x, y in kept)
    if kind not in SHAPES:
        raise _Unknown
    shape, half = SHAPES[str(kind)], 0.5 * size
    thin = f' stroke-width="{_n(max(width, 0.5) / half)}"' if border else ""
    look = look.replace(f' stroke-width="{_n(width)}"', thin)
    return "".join(
        f'<path d="{shape}" transform="translate({_n(x)} {_n(y)})scale({_n(half)})" {look}/>' for x, y in kept
    )


def _legend(block: LegendBlock, x: float, y: float) -> str:
    found = []
    for column, width in zip(block.columns, block.widths, strict=True):
        for k, (handle, text) in enumerate(column):
            middle = y + (k + 0.5) * block.row
            found.append(_sample(handle, x, middle))
            lines = text.count("\n")
            at = middle + 0.35 * block.size - 0.5 * block.size * LINE * lines
            found.append(_text(text, x + HANDLE + PAD, at, block.size))
        x += width + 14.0
    return "".join(found)


def _sample(handle: Any, x: float, y: float) -> str:
    """What an entry of a legend stands for."""
    if isinstance(handle, Line2D):
        drawn = handle.get_linestyle() not in ("None", "", " ") and handle.get_linewidth() > 0
        line = f'<path d="M{_n(x)} {_n(y)}h{_n(HANDLE)}" {_stroke(handle)}/>' if drawn else ""
        return line + _markers(handle, np.array([[x + 0.5 * HANDLE, y]]))
    if isinstance(handle, Patch):
        corners = np.array([[x, y - 3], [x + HANDLE, y - 3], [x + HANDLE, y + 3], [x, y + 3]])
        return _filled([corners], handle.get_facecolor(), handle)
    if isinstance(handle, LineCollection):
        return f'<path d="M{_n(x)} {_n(y)}h{_n(HANDLE)}" {_sticks(handle)}/>'
    raise _Unknown


def _text(
    words: str, x: float, y: float, size: float, anchor: str = "start", *, bold: bool = False, turned: bool = False,
    kind: str = "", colour: str = "",
) -> str:  # fmt: skip
    """Words at a point of their first base line; ``turned``: upwards, in the middle of it."""
    look = f' text-anchor="{anchor}"' if anchor != "start" else ""
    style = f"font-size:{_n(size)}px;" if size != 9.0 else ""
    style += "font-weight:bold;" if bold else ""
    style += f"fill:{colour};" if colour not in ("", "#000000") else ""
    look += f' style="{style[:-1]}"' if style else ""
    look += f' class="{kind}"' if kind else ""
    look += f' transform="rotate(-90 {_n(x)} {_n(y)})"' if turned else ""
    lines = words.split("\n")
    inside = escape(lines[0], quote=False) + "".join(
        f'<tspan x="{_n(x)}" dy="{_n(size * LINE)}">{escape(line, quote=False)}</tspan>' for line in lines[1:]
    )
    return f'<text x="{_n(x)}" y="{_n(y)}"{look}>{inside}</text>'


def _rectangle(box: Box) -> str:
    return f'x="{_n(box.x)}" y="{_n(box.y)}" width="{_n(box.width)}" height="{_n(box.height)}"'


def _n(value: float) -> str:
    """A number of hundredths, as short as it can be."""
    return _short(round(100 * float(value)), 2)


# --- curves ----------------------------------------------------------------------------------------------------------


def _polygon(corners: Array, closed: bool) -> str:
    """A path with relative steps on a grid of tenths or hundredths of a point."""
    if not len(corners):
        return ""
    decimals = 1 if len(corners) > LONG else 2
    steps = np.rint(10**decimals * thinned(corners)).astype(int)
    steps[1:] -= steps[:-1].copy()
    moves = [_short(v, decimals) for v in steps.ravel().tolist()]
    line = f"l{_joined(moves[2:])}" if len(moves) > 2 else ""
    return f"M{_joined(moves[:2])}{line}{'z' if closed else ''}"


@lru_cache(maxsize=1 << 15)
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
    if len(points) < 3:
        return np.arange(len(points))
    ends = np.array([0, len(points) - 1])  # of pieces; those between are cut where a point is too far off
    open_ = np.array([0])
    while len(open_):
        first, last = ends[open_], ends[open_ + 1]
        counts = last - first - 1
        starts = np.concatenate([[0], np.cumsum(counts)[:-1]])
        inner = np.arange(counts.sum()) + np.repeat(first + 1 - starts, counts)
        along, away = (
            np.repeat(points[last] - points[first], counts, axis=0),
            points[inner] - np.repeat(points[first], counts, axis=0),
        )
        square = (along**2).sum(axis=1)
        # The distance from the piece, not from the line that it lies on: a curve may turn back.
        share = np.clip((away * along).sum(axis=1) / np.where(square > 0, square, 1.0), 0, 1)
        off = np.hypot(*(away - share[:, None] * along).T)
        most = np.maximum.reduceat(off, starts)
        far = most > OFF
        peaks = np.flatnonzero(off == np.repeat(most, counts))
        furthest = inner[peaks[np.searchsorted(peaks, starts)]]  # the first one of each piece
        new = furthest[far]
        ends = np.sort(np.concatenate([ends, new]))
        at = np.searchsorted(ends, new)
        both = np.concatenate([at - 1, at])
        open_ = np.sort(both[ends[both + 1] - ends[both] > 1])
    return ends
