"""Figures of a record beside a set of models: as the smallest Delta explains it, and in the envelope of all members.

The latter are figures 11.5-11.20 of the thesis.
"""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from robustlab.errors import InputError
from robustlab.identification.comparison.envelope import SignalCoverage
from robustlab.identification.validation import Validation
from robustlab.identification.validation.data_cover import DataCover
from robustlab.report.figures import (
    COLOURS,
    axis_label,
    chosen,
    frequency_axis,
    house_style,
    legend_below,
    logarithmic,
    new_figure,
    plain_label,
)


def validation_figures(found: Validation) -> dict[str, Figure]:
    """All figures of a validation: one for each output, and ``delta`` in the frequency domain."""
    figures = {}
    for name, _ in found.outputs:
        figures[name] = record_of(found, name)
    if found.domain == "frequency" and np.isfinite(found.upper):
        figures["delta"] = delta_figure(found)
    return figures


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
        below.set_xlabel("time in the mean period [s]" if found.domain == "frequency" else "time [s]")
        above.set_title(plain_label(f"{found.record}: {found.verdict}"))
        legend_below(figure, (above, below), 4)
    return figure


def _response_figure(found: Validation, output: str) -> Figure:
    """Magnitude of a recorded frequency response, of the nominal model, and of the explanation."""
    k = [name for name, _ in found.outputs].index(output)
    figure, (axes,) = new_figure(1, 1, width=7.6, height=3.4)
    with house_style():
        axes.plot(found.t, found.nominal[:, k], color=COLOURS["nominal"], lw=1.2, ls=(0, (5, 1.5)), label="nominal")
        axes.plot(found.t, found.measured[:, k], color=COLOURS["measured"], lw=1.4, label="record")
        if np.isfinite(found.explained).all():
            axes.plot(found.t, found.explained[:, k], color=COLOURS["worst"], lw=1.1, label="with the smallest Delta")
        frequency_axis(axes)
        logarithmic(axes.yaxis)
        axes.set_ylabel(f"|{plain_label(output)}| per input")
        axes.set_title(plain_label(f"{found.record}: {found.verdict}"))
        legend_below(figure, (axes,), 3)
    return figure


def delta_figure(found: Validation) -> Figure:
    """Size of each block over frequency, and gamma.

    Raises
    ------
    InputError
        A validation in the time domain, or no Delta explains the record.
    """
    if found.domain != "frequency" or not np.isfinite(found.upper):
        raise InputError(
            "plot('delta')", f"domain {found.domain}, gamma {found.upper:.4g}", "a finite one over frequency"
        )
    figure, (axes,) = new_figure(1, 1, width=7.6, height=3.0)
    kept = found.omega > 0
    with house_style():
        for i, name in enumerate(found.blocks):
            axes.plot(found.omega[kept], found.line_sizes[kept, i], lw=1.2, marker=".", ms=4, label=plain_label(name))
        axes.axhline(found.upper, color=COLOURS["limit"], lw=1.0, ls=(0, (5, 1.5)), label=f"gamma: {found.upper:.4g}")
        frequency_axis(axes)
        axes.set_ylim(0.0, 1.15 * max(found.upper, 1e-9))
        axes.set_ylabel("size of the block")
        axes.set_title(plain_label(f"{found.record}: the Delta that explains it"))
        legend_below(figure, (axes,), 5)
    return figure


def envelope_figure(signal: SignalCoverage) -> Figure:
    """The measured signal with nominal response and envelope; below, both minus the nominal response."""
    figure, (above, below) = new_figure(2, 1, width=9.0, height=2.3, sharex=True)
    t, outside = signal.t, signal.share < 1
    with house_style():
        for axes, origin in ((above, 0.0), (below, signal.nominal)):
            lower, upper = signal.lower - origin, signal.upper - origin
            axes.fill_between(t, lower, upper, color=COLOURS["band"], alpha=0.45, lw=0, label="envelope of all members")
            axes.plot(t, signal.nominal - origin, color=COLOURS["nominal"], lw=1.0, label="nominal")
            axes.plot(t, signal.measured - origin, color=COLOURS["measured"], lw=1.2, label="record")
        if outside:
            k = int(abs(t - signal.miss_time).argmin())
            gap = signal.measured[k] - signal.nominal[k]
            below.plot(t[k], gap, "o", color=COLOURS["worst"], ms=5, label="largest miss")
        above.set_ylabel(axis_label(signal.name, signal.unit))
        below.set_ylabel(axis_label("minus nominal", signal.unit))
        below.set_xlabel("time [s]")
        legend_below(figure, (below,), 4)
    return figure


# --- single drawings --------------------------------------------------------------------------------------------------


def record_of(found: Validation, output: str | None = None) -> Figure:
    """One output of the record beside the nominal model and the explanation."""
    name = chosen([name for name, _ in found.outputs], output, "output")
    measured_response = found.domain == "frequency" and found.noise_norm == "peak"
    return _response_figure(found, name) if measured_response else validation_figure(found, name)


def cover_record(found: DataCover, record: str | None = None, output: str | None = None) -> Figure:
    """How a set explains one of its records."""
    return record_of(found.validations[chosen(list(found.validations), record, "record")], output)
