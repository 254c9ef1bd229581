"""The style of all figures, and their saving as deterministic SVG, and as PNG on request.

Figures are made with `new_figure` (no pyplot: no global state, no window system) and saved with `save_figure`.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from itertools import pairwise
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.layout_engine import TightLayoutEngine
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from robustlab.errors import EnvironmentFault, InputError, did_you_mean
from robustlab.errors import plain_text as plain_label  # of every name in a figure: it is untrusted
from robustlab.files.atomic import atomic_write

# Okabe and Ito (2008): distinguishable for colour-blind readers, and in grey print by their lightness.
NOMINAL, WORST, GOOD, LIMIT, BAND = "#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9"
SAMPLE, MEASURED = "#8a8f98", "#222222"
CURVES = (NOMINAL, WORST, GOOD, LIMIT, SAMPLE, BAND, MEASURED)
DASHED: Any = (0, (5, 2))
COLOURS = {
    "nominal": NOMINAL, "worst": WORST, "sample": SAMPLE, "band": BAND, "reference": MEASURED, "good": GOOD,
    "measured": MEASURED, "limit": LIMIT,
}  # fmt: skip

_STYLE: dict[Any, Any] = {
    "font.family": "DejaVu Sans",
    "font.size": 9.0,
    "axes.titlesize": 10.0,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.titley": 1.0,  # fixed: otherwise matplotlib measures all ticks once more to place it
    "axes.labelsize": 9.0,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": "#666666",
    "axes.linewidth": 0.8,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#e3e5e8",
    "grid.linewidth": 0.7,
    "lines.linewidth": 1.6,
    "legend.frameon": False,
    "legend.fontsize": 8.5,
    "xtick.color": "#444444",
    "ytick.color": "#444444",
    "figure.facecolor": "white",
    "axes.formatter.useoffset": False,
    "axes.formatter.limits": (-4, 5),
    "text.parse_math": False,  # names from files may contain a dollar sign
    "svg.hashsalt": "robustlab",
    "svg.fonttype": "none",  # texts as text: smaller and searchable
    "path.simplify": True,
}

PNG_DPI = 144
MOST_POINTS = 2000  # of a curve

# Target of the next figures: a function that makes them, or Axes of a user's figure.
Canvas = Callable[[tuple[float, float]], Figure] | Axes
_CANVAS: ContextVar[Canvas] = ContextVar("canvas", default=lambda size: Figure(figsize=size, layout="constrained"))


@contextmanager
def house_style() -> Iterator[None]:
    """Set the style inside a ``with`` block; the caller's settings are restored."""
    with mpl.rc_context(_STYLE):
        yield


@contextmanager
def drawn_on(canvas: Canvas) -> Iterator[None]:
    """Make figures inside the ``with`` block by a function, or draw them into Axes; see `new_figure`."""
    token = _CANVAS.set(canvas)
    try:
        yield
    finally:
        _CANVAS.reset(token)


def new_figure(
    rows: int = 1, columns: int = 1, width: float = 7.2, height: float = 3.2, **options: Any
) -> tuple[Figure, list[Axes]]:
    """Return a figure in the common style and its axes, row by row; ``height`` is inches per row.

    Inside `drawn_on` with Axes, one panel is these Axes, several panels replace them in their figure.
    """
    canvas = _CANVAS.get()
    with house_style():
        if not isinstance(canvas, Axes):
            figure = canvas((width, height * rows))
        elif rows * columns == 1:
            return canvas.figure, [canvas]  # pyright: ignore[reportReturnType]
        elif (place := canvas.get_subplotspec()) is None:
            found = "axes that are in no grid, for a drawing of several panels"
            raise InputError("plot: ax", found, "axes of plt.subplots", "leave ax out")
        else:
            whole = canvas.figure
            canvas.remove()
            figure = whole.add_subfigure(place)
        axes = figure.subplots(rows, columns, squeeze=False, **options)
    return figure, list(axes.ravel())  # pyright: ignore[reportReturnType]


def axis_label(name: str, unit: str) -> str:
    """Return ``name [unit]``, or the name alone."""
    return plain_label(f"{name} [{unit}]" if unit and unit != "1" else name)


def logarithmic(axis: Axis) -> None:
    """Make an axis logarithmic with ticks in plain characters (the style shows no mathematics)."""
    with house_style():
        axis.axes.set(**{f"{axis.axis_name}scale": "log"})  # pyright: ignore[reportAttributeAccessIssue]
        axis.set_major_formatter(FuncFormatter(lambda value, _: _power_of_ten(value)))
        axis.set_minor_locator(LogLocator(subs=(2.0, 5.0)))  # of eight to a decade drawing takes twice the time
        axis.set_minor_formatter(NullFormatter())


def frequency_axis(axes: Axes, span: tuple[float, float] | None = None) -> None:
    """Set a logarithmic axis of frequencies in rad/s, from the first to the last where they are given."""
    logarithmic(axes.xaxis)
    axes.set_xlabel("frequency [rad/s]")
    if span is not None:
        axes.set_xlim(*span)


def zero_line(axes: Axes) -> None:
    """Draw a thin line at zero of the vertical axis."""
    axes.axhline(0.0, color="#888888", lw=0.8)


def headroom(axes: Axes, below: float = 0.0, above: float = 0.0) -> None:
    """Add room for a legend, in shares of the height."""
    low, high = axes.get_ylim()
    axes.set_ylim(low - below * (high - low), high + above * (high - low))


def legend_below(figure: Figure, panels: Sequence[Axes], ncols: int | None = None) -> Figure:
    """Draw one legend for all panels below them, each label once, and return the figure.

    In the Axes of a user's figure, or without a layout engine, it is inside the first panel.
    """
    if _CANVAS.get() is panels[0] or figure.get_layout_engine() is None:
        panels[0].legend(loc="best", fontsize="small")
        return figure
    entries: dict[str, Artist] = {}
    for panel in panels:
        for handle, label in zip(*panel.get_legend_handles_labels(), strict=True):
            entries.setdefault(label, handle)
    columns = min(4, max(2, len(entries))) if ncols is None else ncols
    figure.legend(list(entries.values()), list(entries), loc="outside lower center", ncols=columns)
    return figure


def chosen(names: Sequence[str], name: str | None, kind: str) -> str:
    """Return the given name, by default the first one. Raises InputError: no such name, or no names."""
    if not names:
        raise InputError(f"plot: {kind}", "nothing to draw", f"a result with one {kind} at least")
    if name is None:
        return names[0]
    if name not in names:
        hint = did_you_mean(name, list(names))
        raise InputError(f"plot: {kind} {name!r}", f"no such {kind}", f"one of {', '.join(names)}", hint)
    return name


def _power_of_ten(value: float) -> str:
    exponent = math.floor(math.log10(value) + 1e-9) if value > 0 else 0
    if -3 <= exponent <= 3:
        return f"{value:g}"
    digits = str(exponent).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))
    factor = value / 10.0**exponent
    return f"10{digits}" if abs(factor - 1) < 1e-6 else f"{factor:.3g}·10{digits}"


def _thinned(figure: Figure) -> None:
    """Replace every long curve over an increasing abscissa by the extremes of each stretch, in order."""
    for line in (line for axes in figure.axes for line in axes.lines):
        x, y = (np.asarray(part, dtype=float) for part in line.get_data(orig=False))
        if len(x) > MOST_POINTS and (np.diff(x) >= 0).all() and line.get_linestyle() != "None":
            edges = np.linspace(0, len(y), MOST_POINTS // 2 + 1).astype(int)
            ends = [(a + int(y[a:b].argmin()), a + int(y[a:b].argmax())) for a, b in pairwise(edges.tolist())]
            index = np.sort(ends, axis=1).ravel()
            line.set_data(x[index], y[index])


def save_figure(figure: Figure, folder: str | Path, name: str, png: bool = True) -> tuple[Path, ...]:
    """Write ``name.svg``, and ``name.png``, into ``folder`` atomically; the same figure gives the same bytes."""
    folder = Path(folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise EnvironmentFault(str(folder), f"the folder cannot be made ({error.strerror})") from error
    svg, raster = folder / f"{name}.svg", folder / f"{name}.png"
    with house_style(), warnings.catch_warnings():
        # Characters that the font lacks are drawn as boxes; the caption in the report has them.
        warnings.filterwarnings("ignore", message="Glyph .* missing from")
        _thinned(figure)
        if figure.get_layout_engine() is not None:
            # Once for all files, and in one pass (no rectangle): measuring labels takes as long as drawing them.
            figure.set_layout_engine(None)
            TightLayoutEngine(rect=None).execute(figure)  # pyright: ignore[reportArgumentType]
            legends = max((legend.get_window_extent().height for legend in figure.legends), default=0.0)
            room = figure.subplotpars
            height, below = room.top - room.bottom, legends / figure.bbox.height
            figure.subplots_adjust(bottom=room.bottom + below, hspace=room.hspace * height / (height - below))
        if png:
            FigureCanvasAgg(figure)
            metadata = {"Software": "robustlab"}
            atomic_write(raster, lambda path: figure.savefig(path, format="png", dpi=PNG_DPI, metadata=metadata))
        about = {"Date": None, "Creator": "robustlab"}
        atomic_write(svg, lambda path: figure.savefig(path, format="svg", metadata=about))
    return (svg, raster) if png else (svg,)
