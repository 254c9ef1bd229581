"""Which drawings every object has: the same figures as those of reports, drawn by ``.plot()`` too.

The table is `robustlab.report.drawing_table`. A function is imported when it is asked for.
`robustlab.shown.Shown.plot` calls `draw`; commands and reports draw all `pictures_of` a result.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator, Mapping
from importlib import import_module
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure

from robustlab.errors import InputError, did_you_mean
from robustlab.report.drawing_table import CAPTIONS, DRAWINGS, SETS
from robustlab.report.style import drawn_on


def drawings_of(kind: type) -> Mapping[str, str]:
    """The drawings of a class: those of its own name or of the next class that it is made from."""
    return next((DRAWINGS[parent.__name__] for parent in kind.__mro__ if parent.__name__ in DRAWINGS), {})


class Picture(NamedTuple):
    """A drawing of a result with what a report writes below it."""

    figure: Figure
    caption: str


def pictures_of(shown: Any, remark: Callable[[str], None] | None = None) -> Iterator[tuple[str, Picture]]:
    """Every drawing of an object that has something to show, by name; ``remark`` hears why another has not."""
    whole = SETS.get(type(shown).__name__, "")
    if whole:
        made: Any = _function(whole)(shown)
        yield from ((name, Picture(figure, caption_of(whole, name))) for name, figure in made.items())
        return
    for name, function in drawings_of(type(shown)).items():
        try:
            figure: Any = _function(function)(shown)
        except InputError as error:
            if remark is not None:
                remark(f"no figure {name}: {error}")
            continue
        yield name, Picture(figure, CAPTIONS.get(function, f"{name.capitalize()}."))


def caption_of(whole: str, name: str) -> str:
    """What a figure of a set shows; its name is one of the set's, or that with an output's, or an output."""
    kind, _, output = name.partition("-")
    known = CAPTIONS.get(f"{whole} {kind}")
    return CAPTIONS[whole].format(name) if known is None else known.format(output)


def draw(shown: Any, kind: str | None, ax: Any, options: Mapping[str, Any]) -> Any:
    """See `robustlab.shown.Shown.plot`."""
    where, known = f"{type(shown).__name__}.plot", drawings_of(type(shown))
    if not known:
        raise InputError(where, "nothing to draw", None, "summary() tells what there is")
    if kind is not None and kind not in known:
        raise InputError(where, f"{kind!r}", f"one of {', '.join(known)}", did_you_mean(str(kind), list(known)))
    if ax is not None and not isinstance(ax, Axes):
        raise InputError(where, f"ax is a {type(ax).__name__}", "one matplotlib Axes")
    drawing = _function(known[kind or next(iter(known))])
    _check_options(where, drawing, options)
    made: list[Figure] = []

    def figure_of(size: tuple[float, float]) -> Figure:
        import matplotlib.pyplot as plt

        made.append(plt.figure(figsize=size, layout="constrained"))
        return made[-1]

    try:
        with drawn_on(ax if ax is not None else figure_of):
            figure = drawing(shown, **options)
    except BaseException:
        _discard(made)
        raise
    return _panels(figure, ax)


def _function(name: str) -> Callable[..., Figure | SubFigure]:
    module, _, function = name.partition(".")
    return getattr(import_module(f"robustlab.report.{module}"), function)


def _check_options(where: str, drawing: Callable[..., Any], options: Mapping[str, Any]) -> None:
    known = list(inspect.signature(drawing).parameters)[1:]
    for name in options:
        if name not in known:
            expected = f"one of {', '.join(known)}" if known else "none"
            raise InputError(where, f"option {name!r}", expected, did_you_mean(name, known))


def _discard(figures: list[Figure]) -> None:
    import matplotlib.pyplot as plt

    for figure in figures:
        plt.close(figure)


def _panels(figure: Figure | SubFigure, ax: Axes | None) -> Any:
    """The Axes that were drawn into, in the order of the panels; an array where there are several."""
    if ax is not None and figure is ax.figure and ax in figure.axes:
        return ax
    panels = [axes for axes in figure.axes if axes.get_visible()]
    if len(panels) == 1:
        return panels[0]
    array = np.empty(len(panels), dtype=object)
    array[:] = panels
    return array
