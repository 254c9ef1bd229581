"""Figures of the linear part of a record and of what is beyond it: frequency response, and lines of a periodic one."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter
from numpy.typing import NDArray

from robustlab.identification.comparison import Comparison
from robustlab.report.figures import COLOURS, axis_label, house_style, logarithmic, new_figure, plain_label

__all__ = ["harmonics_figure", "response_figure"]

Array = NDArray[np.float64]

FEW_LINES = 60  # drawn with a marker each
SHOWN_BEYOND = 3.0  # times the highest excited line
FEWEST_SHOWN = 20  # lines


def response_figure(comparison: Comparison, output: str) -> Figure:
    """Magnitude, phase and coherence of the recorded response from each input, beside the model's."""
    row = comparison.linear[output]
    figure, axes = new_figure(
        3, len(row), width=max(7.6, 4.6 * len(row)), height=2.2, sharex="col", gridspec_kw={"height_ratios": [3, 2, 2]}
    )
    with house_style():
        for j, (u, g) in enumerate(row.items()):
            above, middle, below = axes[j :: len(row)]
            few = len(g.frequency) <= FEW_LINES
            f, marker = g.frequency, "o" if few else ""
            # Of many lines, those whose deviation is larger than they are say nothing.
            size = np.where(few | (g.std < np.abs(g.response)), np.abs(g.response), np.nan)
            bottom = 0.3 * float(np.nanmin(np.append(size[size > 0], np.abs(g.model).min() or np.nan)))
            if g.noise_std is not None and (g.noise_std > 0).any():
                bottom = min(bottom, 0.5 * float(g.noise_std[g.noise_std > 0].min()))
            above.fill_between(
                f, np.maximum(size - 2 * g.std, bottom), size + 2 * g.std, color=COLOURS["band"], alpha=0.35, lw=0
            )
            above.fill_between([], [], [], color=COLOURS["band"], alpha=0.35, lw=0, label="± 2 std")
            above.plot(f, size, color=COLOURS["measured"], marker=marker, ms=3, lw=1.2, label="record")
            above.plot(f, np.abs(g.model), color=COLOURS["worst"], ls=(0, (5, 1.5)), lw=1.4, label="model")
            for level, key, label in (
                (g.nonlinear_std, "limit", "nonlinear distortion"),
                (g.noise_std, "good", "noise"),
            ):
                if level is not None and (level > 0).any():
                    above.plot(f, np.where(level > 0, level, np.nan), color=COLOURS[key], lw=1.2, label=label)
            logarithmic(above.yaxis)
            above.set_ylim(bottom, 3.0 * float(np.nanmax(np.append(size, np.abs(g.model)))))
            units = comparison.outputs[output].unit or "1", comparison.measured.unit(u) or "1"
            above.set_ylabel(plain_label(f"magnitude [{units[0]}/{units[1]}]"))
            above.set_title(plain_label(f"{u} to {output}: best linear approximation ({g.method})"))
            above.legend(loc="best", ncols=2)
            for values, colour, line in (
                (np.where(np.isfinite(size), g.response, np.nan), COLOURS["measured"], "-"),
                (g.model, COLOURS["worst"], (0, (5, 1.5))),
            ):
                middle.plot(f, _near(np.angle(g.model), np.angle(values)), color=colour, ls=line, lw=1.2)
            middle.set_ylabel("phase [degrees]")
            below.plot(f, g.coherence, color=COLOURS["nominal"], marker=marker, ms=3, lw=1.2)
            below.set_ylim(-0.03, 1.05)
            below.set_ylabel("coherence")
            below.set_xlabel("frequency [Hz]")
            below.set_xscale("log")
            below.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
            below.xaxis.set_minor_formatter(NullFormatter())
            below.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0), numticks=20))
            if len(f) > 1:
                below.set_xlim(f[0], f[-1])
    return figure


def harmonics_figure(comparison: Comparison) -> Figure:
    """Lines of every judged signal: excited, even and odd ones that are not, over the noise."""
    test = comparison.nonlinearity
    figure, axes = new_figure(len(test.signals), 1, width=7.6, height=2.6, sharex=True)
    kinds = ((0, "excited", "measured", "o"), (1, "even", "worst", "s"), (2, "odd, not excited", "nominal", "D"))
    with house_style():
        for panel, (name, s) in zip(axes, test.signals.items(), strict=True):
            excited = s.frequency[s.kind == 0]
            shown = s.frequency <= max(SHOWN_BEYOND * excited.max(), FEWEST_SHOWN * s.frequency[0])
            for kind, label, colour, marker in kinds:
                chosen = shown & (s.kind == kind) & (s.amplitude > 0)
                panel.plot(
                    s.frequency[chosen], s.amplitude[chosen], marker, ms=4, mew=0, color=COLOURS[colour], label=label
                )
            chosen = shown & (s.noise > 0)
            panel.plot(s.frequency[chosen], s.noise[chosen], "-", lw=1.0, color=COLOURS["good"], label="noise alone")
            logarithmic(panel.yaxis)
            top = float(s.amplitude[shown].max())
            panel.set_ylim(bottom=max(panel.get_ylim()[0], 1e-9 * top), top=5.0 * top)
            unit = comparison.measured.units.get(name, "")
            panel.set_ylabel(axis_label("amplitude", unit))
            panel.set_title(plain_label(f"{name}: {s.words()} of its power is nonlinear"))
        axes[0].legend(loc="upper right", ncols=4)
        axes[-1].set_xlabel("frequency [Hz]")
    return figure


def _near(reference: Array, angle: Array) -> Array:
    """Angles in degrees, each within half a turn of the unwrapped ``reference``."""
    unwrapped = np.unwrap(reference)
    return np.degrees(unwrapped + np.angle(np.exp(1j * (angle - unwrapped))))
