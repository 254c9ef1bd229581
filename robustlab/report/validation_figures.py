"""Figure of a record with what the smallest Delta makes of it, and the noise that is left."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from robustlab.identification.validation import Validation
from robustlab.report.figures import COLOURS, axis_label, house_style, new_figure, plain_label

__all__ = ["validation_figure"]


def validation_figure(found: Validation, output: str) -> Figure:
    """Recorded, nominal and explained output; below, the record minus each of the two against the noise bound."""
    k = [name for name, _ in found.outputs].index(output)
    unit = found.outputs[k][1]
    measured, nominal, explained = (a[:, k] for a in (found.measured, found.nominal, found.explained))
    figure, (above, below) = new_figure(2, 1, width=7.6, height=2.4, sharex=True)
    known = bool(np.isfinite(explained).all())
    bound = found.noise_bound[output]
    with house_style():
        above.plot(found.t, nominal, color=COLOURS["nominal"], lw=1.2, ls=(0, (5, 1.5)), label="nominal")
        above.plot(found.t, measured, color=COLOURS["measured"], lw=1.4, label="recorded")
        below.plot(found.t, measured - nominal, color=COLOURS["nominal"], lw=1.0, ls=(0, (5, 1.5)))
        if known:
            above.plot(found.t, explained, color=COLOURS["worst"], lw=1.1, label="with the smallest Delta")
            below.plot(found.t, measured - explained, color=COLOURS["worst"], lw=0.9)
        word = "noise bound" if found.noise_norm == "peak" else "rms noise bound"
        below.axhspan(-bound, bound, color=COLOURS["band"], alpha=0.35, lw=0, label=word)
        above.set_ylabel(axis_label(output, unit))
        below.set_ylabel(axis_label("record minus model", unit))
        below.set_xlabel("time [s]")
        above.set_title(plain_label(f"{found.record}: {found.verdict}"))
        handles = [*above.get_legend_handles_labels()[0], *below.get_legend_handles_labels()[0]]
        figure.legend(handles, [str(h.get_label()) for h in handles], loc="outside lower center", ncols=4)
    return figure
