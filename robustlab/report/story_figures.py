"""The whole story in one picture: gap, uncertainty, what is proved, and what a simulated machine then does."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from robustlab.arrays import Array
from robustlab.report.figures import (
    COLOURS,
    frequency_axis,
    headroom,
    house_style,
    logarithmic,
    new_figure,
    plain_label,
)

if TYPE_CHECKING:
    from robustlab.mu_analysis import Margin

BEFORE, AFTER = COLOURS["worst"], COLOURS["nominal"]
WORDS = ("before", "after")


@dataclass(frozen=True, eq=False)
class Story:
    """What the picture shows; pairs are before and after.

    Attributes
    ----------
    gap
        ``t``, ``record``, ``origin`` (measured or simulated), ``curves`` (two simulations), ``rms`` and ``label`` of
        a record; None without one.
    radii
        Unmodelled dynamics in the sets, shares of the input; None where they are told otherwise.
    held_out
        ``before`` and ``after``: what held-out records need; None without such.
    margins, mu
        Margins of robust performance, and the mu that they prove.
    t, curves, errors, unit, after
        Of the referee, which is a simulation: time in s, tracking error over it, largest error of any member, unit, and
        the time in s from which it counts.
    """

    gap: Mapping[str, Any] | None
    radii: Sequence[float] | None
    held_out: Mapping[str, float] | None
    margins: Sequence[Margin]
    mu: Sequence[float]
    t: Array
    curves: Sequence[Array]
    errors: Sequence[float]
    unit: str
    after: float = 0.0


def story_figure(story: Story) -> Figure:
    """Two by two panels; without a record or radii those panels are left out."""
    panels = [_mu, _error]
    if story.radii is not None:
        panels.insert(0, _uncertainty)
    if story.gap is not None:
        panels.insert(0, _gap)
    columns = 2 if len(panels) > 1 else 1
    figure, axes = new_figure(-(-len(panels) // columns), columns, width=11.0, height=3.7)
    with house_style():
        for number, (panel, ax) in enumerate(zip(panels, axes, strict=False), start=1):
            panel(ax, story, number)
        for ax in axes[len(panels) :]:
            ax.set_visible(False)
    return figure


def _gap(axes: Axes, story: Story, number: int) -> None:
    assert story.gap is not None
    gap = story.gap
    axes.plot(gap["t"], gap["record"], color=COLOURS["sample"], lw=3.2, label=f"{gap['origin']} record")
    axes.plot(gap["t"], gap["curves"][0], color=BEFORE, lw=1.2, label="model before")
    axes.plot(gap["t"], gap["curves"][1], color=AFTER, lw=1.2, ls=(0, (4, 1.5)), label="with the named effects")
    axes.set(xlabel="time [s]", ylabel=plain_label(gap["label"]), xlim=(gap["t"][0], gap["t"][-1]))
    axes.set_title(f"{number}  The gap: {times_in_words(gap['rms'][0], gap['rms'][1])} (RMS)", loc="left")
    axes.legend(loc="best")


def _uncertainty(axes: Axes, story: Story, number: int) -> None:
    assert story.radii is not None
    floor = 1e-6
    for k, (radius, colour) in enumerate(zip(story.radii, (BEFORE, AFTER), strict=True)):
        seen, label = max(radius, floor), "unmodelled, in the set" if k == 0 else None
        axes.barh(k, seen, color=colour, alpha=0.8, height=0.5, label=label)
        axes.annotate(f"{100 * radius:.3g} %", (seen, k), (5, 0), textcoords="offset points", va="center")
        if story.held_out is not None:
            need = max(story.held_out[WORDS[k]], floor)
            label = "needed by held-out data" if k == 0 else None
            axes.plot(need, k, "o", color=COLOURS["reference"], ms=7, mfc="white", mew=1.6, label=label, zorder=4)
    logarithmic(axes.xaxis)
    shown = [*story.radii, *(v for k, v in (story.held_out or {}).items() if k in WORDS)]
    lowest, highest = min(max(v, floor) for v in shown), max(*story.radii, floor)
    axes.set(yticks=[0, 1], yticklabels=WORDS, ylim=(1.6, -0.6), xlim=(lowest / 3, 4 * highest))
    axes.set_xlabel("unmodelled dynamics, share of the input")
    fall = times_in_words(story.radii[0], story.radii[1]) if story.radii[1] > 0 else "none is left"
    axes.set_title(f"{number}  The uncertainty: {fall}", loc="left")
    axes.legend(loc="lower right")


def _mu(axes: Axes, story: Story, number: int) -> None:
    for word, margin, mu, colour in zip(WORDS, story.margins, story.mu, (BEFORE, AFTER), strict=True):
        proved = f"at most {mu:.3g} at all frequencies" if np.isfinite(mu) else "nothing is proved"
        axes.plot(margin.omega, margin.mu_upper, color=colour, label=f"{word}: {proved}")
        if np.isfinite(mu):
            axes.axhline(mu, color=colour, lw=0.7, alpha=0.7)
    axes.axhline(1.0, color=COLOURS["limit"], ls=(0, (5, 2)), label="1: requirement met by every member")
    omega = story.margins[0].omega
    frequency_axis(axes, (omega[0], omega[-1]))
    axes.set_ylabel("μ of robust performance")
    axes.set_ylim(0, 1.35 * max(1.0, *(mu for mu in story.mu if np.isfinite(mu))))
    axes.set_title(f"{number}  What is proved: μ {fall_in_words(*story.mu)}", loc="left")
    axes.legend(loc="upper right")


def _error(axes: Axes, story: Story, number: int) -> None:
    for word, curve, largest, colour in zip(WORDS, story.curves, story.errors, (BEFORE, AFTER), strict=True):
        counted = f" from {story.after:g} s on" if story.after > 0 else ""
        label = f"{word}: at most {largest:.3g} {story.unit}{counted}"
        axes.plot(story.t, curve, color=colour, lw=1.2, label=label)
    axes.set(xlabel="time [s]", ylabel=plain_label(f"tracking error [{story.unit}]"), xlim=(story.t[0], story.t[-1]))
    headroom(axes, above=0.25)
    axes.set_title(f"{number}  Simulated machine: error {times_in_words(*story.errors)}", loc="left")
    axes.legend(loc="upper right")


def fall_percent(before: float, after: float) -> float:
    """By how many percent mu fell; NaN where one of both is not proved: a fall from infinity is none."""
    return 100 * (1 - after / before) if np.isfinite([before, after]).all() and before > 0 else float("nan")


def fall_in_words(before: float, after: float) -> str:
    """The fall of mu, or that there is none to tell."""
    fall = fall_percent(before, after)
    if not np.isfinite(fall):
        return "not to be compared"
    return f"{abs(fall):.3g} % {'higher' if fall < 0 else 'lower'}"


def times_in_words(before: float, after: float) -> str:
    """How many times smaller, or larger, the second is: ``1.1 times larger``."""
    if after > before:
        return f"{_number(after / max(before, 1e-300))} times larger"
    return f"{_number(before / max(after, 1e-300))} times smaller"


def _number(ratio: float) -> str:
    """Three digits, and no powers of ten below a million."""
    return f"{ratio:.0f}" if 100 <= ratio < 1e6 else f"{ratio:.3g}"
