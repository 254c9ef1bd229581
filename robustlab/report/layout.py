"""Where the panels of a figure stand: room for ticks, labels, titles and legends, by the widths of their texts.

Lengths are points, of 72 an inch; heights go down from the top, as in an SVG. A figure whose panels are not all of one
grid, or that holds images, is for matplotlib to lay out and draw.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache
from itertools import zip_longest
from typing import Any, Literal, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import XAxis, YAxis
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties
from matplotlib.legend import Legend
from matplotlib.textpath import text_to_path

Side = Literal["x", "y"]
PAD = 4.0  # around the figure, and between a label and what it labels
TICK = 3.5
GAP = 8.0  # between neighbouring panels
HANDLE = 18.0  # of an entry of a legend
LINE = 1.35  # of a text's size, from line to line
SPACE = 14.0  # between columns of a legend


@lru_cache(maxsize=4096)
def width_of(text: str, size: float, bold: bool = False) -> float:
    """Width of a line of text."""
    if not text:
        return 0.0
    font = FontProperties(family="DejaVu Sans", size=size, weight="bold" if bold else "normal")
    return float(text_to_path.get_text_width_height_descent(text, font, ismath=False)[0])


def widest(text: str, size: float, bold: bool = False) -> float:
    """Width of the widest line of a text."""
    return max((width_of(line, size, bold) for line in text.split("\n")), default=0.0)


def height_of(text: str, size: float) -> float:
    """Height of a text of one or several lines; nothing of an empty one."""
    return size * (1.1 + LINE * text.count("\n")) if text else 0.0


class Ticks(NamedTuple):
    """What stands along an axis."""

    at: list[float]  # in data
    texts: list[str]  # empty where the axis shows none
    minor: list[float]
    size: float
    offset: str  # the power of ten that all texts are multiples of


class Box(NamedTuple):
    """A rectangle."""

    x: float
    y: float
    width: float
    height: float

    @property
    def right(self) -> float:
        """Its right side."""
        return self.x + self.width

    @property
    def below(self) -> float:
        """Its lower side."""
        return self.y + self.height


NONE, NOWHERE = Ticks([], [], [], 9.0, ""), Box(0.0, 0.0, 1.0, 1.0)


def ticks_of(axis: XAxis | YAxis) -> Ticks:
    """Ticks in sight with their texts."""
    low, high = sorted(axis.get_view_interval())
    at = [float(v) for v in axis.get_majorticklocs()]
    formatter = axis.get_major_formatter()
    texts = list(formatter.format_ticks(at))
    placed = axis.get_transform().transform(np.array([low, high, *at]))
    room = 1e-9 * abs(placed[1] - placed[0])
    seen = [placed[0] - room <= p <= placed[1] + room for p in placed[2:]]
    shown = axis.get_tick_params(which="major").get("labelbottom" if axis.axis_name == "x" else "labelleft", True)
    minor = [float(v) for v in axis.get_minorticklocs() if low <= v <= high]
    known = axis.majorTicks
    size = float(known[0].label1.get_fontsize()) if known else 9.0
    chosen = [t if shown else "" for t, ok in zip_longest(texts, seen, fillvalue="") if ok]
    offset = formatter.get_offset() if shown else ""
    return Ticks([v for v, ok in zip(at, seen, strict=True) if ok], chosen, minor, size, offset)


@dataclass
class LegendBlock:
    """A legend laid out in itself: columns of entries, filled one after the other."""

    legend: Legend
    entries: list[tuple[Any, str]]
    size: float
    columns: list[list[tuple[Any, str]]] = field(default_factory=list)
    widths: list[float] = field(default_factory=list)
    row: float = 0.0

    @classmethod
    def of(cls, legend: Legend, room: float = np.inf) -> LegendBlock:
        """Of a legend, in fewer columns than it asks for where these are wider than ``room``."""
        texts = legend.get_texts()
        entries = [(h, t.get_text()) for h, t in zip(legend.legend_handles, texts, strict=True)]
        size = float(texts[0].get_fontsize()) if texts else 8.5
        for count in range(max(1, min(int(getattr(legend, "_ncols", 1)), len(entries))), 0, -1):
            found = cls(legend, entries, size)
            found._arrange(count)
            if found.width <= room:
                break
        return found  # pyright: ignore[reportPossiblyUnboundVariable]

    def _arrange(self, count: int) -> None:
        shares = np.array_split(np.arange(len(self.entries)), count)
        self.columns = [[self.entries[i] for i in share] for share in shares if len(share)]
        self.widths = [max(HANDLE + PAD + widest(t, self.size) for _, t in column) for column in self.columns]
        self.row = max((height_of(text, self.size) for _, text in self.entries), default=0.0) + 1.5

    @property
    def width(self) -> float:
        """Of the whole."""
        return sum(self.widths) + SPACE * max(0, len(self.widths) - 1)

    @property
    def height(self) -> float:
        """Of the whole."""
        return self.row * max(map(len, self.columns), default=0)


@dataclass
class PanelPlan:
    """A panel with what stands around it."""

    axes: Axes
    rows: range
    columns: range
    box: Box = NOWHERE
    x: Ticks = NONE
    y: Ticks = NONE
    legend: LegendBlock | None = None

    @property
    def title(self) -> Any:
        """The text of its title, which stands on the left, or in the middle."""
        return getattr(self.axes, "_left_title") if self.axes.get_title(loc="left") else self.axes.title  # noqa: B009

    def room(self) -> tuple[float, float, float, float]:
        """What its ticks, labels and title need: on the left, on the right, above, below."""
        axes, left, right, below = self.axes, 0.0, PAD, 0.0
        if axes.axison:
            left += TICK + max((PAD + widest(t, self.y.size) for t in self.y.texts if t), default=0.0)
            below += TICK + max((PAD + height_of(t, self.x.size) for t in self.x.texts if t), default=0.0)
            right += max((0.5 * widest(t, self.x.size) for t in self.x.texts[-1:]), default=0.0)
        for text, side in ((axes.yaxis.label, "left"), (axes.xaxis.label, "below")):
            if text.get_text():
                need = PAD + height_of(text.get_text(), float(text.get_fontsize()))
                left, below = (left + need, below) if side == "left" else (left, below + need)
        if self.x.offset:
            below += PAD
        words = self.title.get_text()
        above = height_of(words, float(self.title.get_fontsize())) + PAD if words else PAD
        above = max(above, height_of(self.y.offset, 9.0) + PAD if self.y.offset else 0.0)
        if self.legend is not None:
            beside, under = outside(self.legend.legend, axes)
            right += self.legend.width + 2 * PAD if beside else 0.0
            below += self.legend.height + PAD if under else 0.0
        return left, right, above, below


def outside(legend: Legend, axes: Axes) -> tuple[bool, bool]:
    """Whether a panel's legend stands beside it, and below it."""
    anchor = legend.get_bbox_to_anchor().transformed(axes.transAxes.inverted())
    return anchor.x0 >= 1.0 and anchor.width == 0.0, anchor.y0 < -0.1


@dataclass
class FigurePlan:
    """A figure with the places of its panels."""

    figure: Figure
    width: float
    height: float
    panels: list[PanelPlan]
    legends: list[tuple[LegendBlock, float, float]]  # those of the figure, with their upper left corners
    heading: str


def plan(figure: Figure) -> FigurePlan | None:
    """The places of all panels; None of a figure that is for matplotlib to lay out. The axes are put there, too."""
    panels = _panels(figure)
    if panels is None:
        return None
    width, height = (72.0 * float(side) for side in figure.get_size_inches())
    found = FigurePlan(figure, width, height, panels, [], figure.get_suptitle())
    for _ in range(2):  # how many ticks there are depends on how large a panel is, and that on the texts of the ticks
        for panel in panels:
            panel.x, panel.y = ticks_of(panel.axes.xaxis), ticks_of(panel.axes.yaxis)
            legend = panel.axes.get_legend()
            panel.legend = LegendBlock.of(legend, 0.98 * width) if legend is not None else None
        _place(found)
    return found


def _panels(figure: Figure) -> list[PanelPlan] | None:
    """The visible panels, where all are of one grid and none shows an image."""
    found: list[PanelPlan] = []
    grids: list[Any] = []
    for axes in figure.axes:
        if not axes.get_visible():
            continue
        spec = axes.get_subplotspec()
        if spec is None or axes.images or figure.subfigs:
            return None
        grids.append(spec.get_gridspec())
        found.append(PanelPlan(axes, spec.rowspan, spec.colspan))
    return found if found and all(grid is grids[0] for grid in grids) else None


def _place(found: FigurePlan) -> None:
    grid = found.panels[0].axes.get_subplotspec().get_gridspec()  # pyright: ignore[reportOptionalMemberAccess]
    rows, columns = grid.get_geometry()
    left, right, above, below = (np.zeros(n) for n in (columns, columns, rows, rows))
    for panel in found.panels:
        need = panel.room()
        for sizes, at, size in (
            (left, panel.columns[0], need[0]), (right, panel.columns[-1], need[1]),
            (above, panel.rows[0], need[2]), (below, panel.rows[-1], need[3]),
        ):  # fmt: skip
            sizes[at] = max(sizes[at], size)
    top, bottom, aside = _around(found)
    across = _shared(found.width - aside - 2 * PAD, left, right, grid.get_width_ratios(), columns)
    down = _shared(found.height - top - bottom - 2 * PAD, above, below, grid.get_height_ratios(), rows)
    for panel in found.panels:
        x, x_end = across[panel.columns[0]][0], across[panel.columns[-1]][1]
        y, y_end = (top + v for v in (down[panel.rows[0]][0], down[panel.rows[-1]][1]))
        _put(panel, Box(PAD + x, PAD + y, x_end - x, y_end - y), found)


def _put(panel: PanelPlan, box: Box, found: FigurePlan) -> None:
    """Move the axes there; one of equal scales takes less of it."""
    w, h = found.width, found.height
    panel.axes.set_position((box.x / w, 1 - box.below / h, box.width / w, box.height / h))
    panel.axes.apply_aspect()
    place = panel.axes.get_position()
    panel.box = Box(place.x0 * w, (1 - place.y1) * h, place.width * w, place.height * h)


def _shared(total: float, before: np.ndarray, after: np.ndarray, ratios: Any, n: int) -> list[tuple[float, float]]:
    """Start and end of every row or column of panels."""
    share = np.asarray(ratios if ratios is not None else np.ones(n), dtype=float)
    room = max(total - float(before.sum() + after.sum()) - GAP * (n - 1), 10.0 * n)
    sizes = room * share / share.sum()
    found, at = list[tuple[float, float]](), 0.0
    for k in range(n):
        at += float(before[k])
        found.append((at, at + float(sizes[k])))
        at += float(sizes[k] + after[k]) + GAP
    return found


def _around(found: FigurePlan) -> tuple[float, float, float]:
    """Room above and below all panels and beside them, for a heading and the figure's own legends."""
    top = height_of(found.heading, 10.5) + PAD if found.heading else 0.0
    bottom = aside = 0.0
    found.legends = []
    for legend in found.figure.legends:
        block = LegendBlock.of(legend, found.width - 2 * PAD)
        if str(getattr(legend, "_outside_loc", "")).startswith("right"):
            aside = block.width + 2 * PAD
            found.legends.append((block, found.width - block.width - PAD, top + PAD))
        else:
            bottom = block.height + PAD
            found.legends.append((block, 0.5 * (found.width - block.width), found.height - block.height - 2.0))
    return top, bottom, aside
