"""Figures of single results: a disk margin, a worst member, Hankel values, records, hidden modes, weights."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from robustlab.campaign.campaign_result import CampaignResult, exceedance_curve
from robustlab.campaign.store import Store
from robustlab.errors import InputError
from robustlab.identification.validation import FrequencyData
from robustlab.linear_analysis.frequency import default_grid, frequency_response
from robustlab.linear_analysis.structural import StructuralTest
from robustlab.mu_analysis import MuBounds
from robustlab.mu_analysis.margins.disk_margin import DiskBounds, DiskMargins
from robustlab.record import Record
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
    zero_line,
)
from robustlab.report.robustness_figures import response_figure
from robustlab.synthesis.reduction.reduced_model import ReducedModel
from robustlab.synthesis.sampled.sampled_norm import SampledDataNorm
from robustlab.uncertainty.frequency_responses import UncertainFrequencyData
from robustlab.worst_case_analysis import WorstCase
from robustlab.worst_case_analysis.sampling import Responses

LARGEST_GAIN = 60  # dB; of a disk margin's curve

CURVES = ("nominal", "worst", "good", "limit", "sample", "band", "reference")
BLOCKS = 24  # side by side
SIGNALS = 8  # below one another


def record_figure(record: Record) -> Figure:
    """Every signal of a record over time, inputs first."""
    names = [*record.inputs, *record.outputs][:SIGNALS]
    figure, panels = new_figure(len(names), 1, 7.6, 1.5 if len(names) > 2 else 2.2, sharex=True)
    with house_style():
        for panel, name in zip(panels, names, strict=True):
            colour = COLOURS["sample" if name in record.inputs else "measured"]
            panel.plot(record.t, record[name], color=colour, lw=1.2)
            panel.set_ylabel(axis_label(name, record.unit(name)))
        rest = len(record.inputs) + len(record.outputs) - len(names)
        panels[0].set_title(
            plain_label(record.name + (f": the first {len(names)} signals, {rest} more" if rest else ""))
        )
        panels[-1].set_xlabel("time [s]")
        panels[-1].set_xlim(float(record.t[0]), float(record.t[-1]))
    return figure


def band_figure(found: Responses, output: str | None = None) -> Figure:
    """All responses of one output and their envelope."""
    names = [s.name for s in found.outputs]
    k = names.index(chosen(names, output, "output"))
    envelope = found.lower[:, k], found.upper[:, k]
    return response_figure(found.t, found.y[:, :, k], found.nominal[:, k], envelope, output=found.outputs[k])


def band_figures(found: Responses) -> dict[str, Figure]:
    """A figure for each output."""
    return {s.name: band_figure(found, s.name) for s in found.outputs}


def disk_figure(found: DiskMargins | DiskBounds) -> Figure:
    """Changes of gain and phase that leave the loop stable: inside of each curve, in that loop and in all at once."""
    every: Mapping[str, DiskBounds] = {"disk margin": found}
    if isinstance(found, DiskMargins):
        every = {"all at once": found.simultaneous, **found.channels}
    figure, (axes,) = new_figure(width=6.4, height=3.8)
    with house_style():
        for k, (name, margin) in enumerate(every.items()):
            colour, label = COLOURS[CURVES[k % len(CURVES)]], plain_label(f"{name}: {margin.lower:.4g}")
            if not 0 < margin.lower < np.inf:
                axes.plot([], [], color=colour, label=label)
                continue
            turn = margin.lower * np.exp(1j * np.linspace(-np.pi, np.pi, 14401))
            with np.errstate(divide="ignore", invalid="ignore"):
                factor = (1 + (1 - margin.skew) / 2 * turn) / (1 - (1 + margin.skew) / 2 * turn)
                gain, phase = 20 * np.log10(np.abs(factor)), np.degrees(np.unwrap(np.angle(factor)))
            axes.plot(gain, phase - np.mean(phase), color=colour, lw=2.4 if k == 0 else 1.4, label=label)
            if k == 0:
                axes.fill(gain, phase - np.mean(phase), color=COLOURS["band"], alpha=0.25, lw=0)
        wide = any(np.abs(np.asarray(line.get_xdata())).max(initial=0.0) > LARGEST_GAIN for line in axes.lines)
        if wide:  # near a margin of 2 the curve runs to infinity
            axes.set_xlim(-LARGEST_GAIN, LARGEST_GAIN)
        axes.plot(0.0, 0.0, "+", color=COLOURS["reference"], ms=9, mew=1.4)
        axes.set_xlabel(f"change of gain [dB]{f', shown to {LARGEST_GAIN} dB' * wide}")
        axes.set_ylabel("change of phase [degrees]")
        axes.set_title("stable for every change inside of the curve")
        legend_below(figure, (axes,), 3)
    return figure


def delta_figure(worst: WorstCase | CampaignResult) -> Figure:
    """The worst member found: where each parameter lies in its range, from -1 over nominal to 1."""
    scalar = {name: value for name, value in worst.delta.items() if np.size(value) == 1}
    if not scalar:
        raise InputError("plot('delta')", "a member without scalar blocks", "a Delta with scalar values")
    ranked = sorted(scalar, key=lambda name: -abs(np.ravel(scalar[name])[0]))[:BLOCKS]
    figure, (axes,) = new_figure(width=7.2, height=1.2 + 0.27 * max(3, len(ranked)))
    with house_style():
        for row, name in enumerate(ranked):
            value = np.ravel(scalar[name])[0]
            size = float(abs(value)) if np.iscomplexobj(value) else float(value)
            axes.plot([-1, 1], [row, row], color=COLOURS["band"], lw=6, alpha=0.35, solid_capstyle="butt")
            axes.plot(size, row, "o", color=COLOURS["worst"], ms=6)
            known = worst.physical.get(name)
            text = f"{known[0]:.4g} {known[1]}".rstrip() if known else f"{size:.3g}"
            axes.annotate(plain_label(text), (1.08, row), va="center", fontsize=8.5, annotation_clip=False)
        axes.axvline(0.0, color=COLOURS["nominal"], ls=(0, (5, 2)), lw=1.1)
        axes.set_yticks(range(len(ranked)), [plain_label(name[:40]) for name in ranked])
        axes.set(xlim=(-1.05, 1.45), ylim=(len(ranked) - 0.5, -0.5), xticks=[-1, -0.5, 0, 0.5, 1])
        axes.set_xlabel("place in the range: 0 nominal, -1 and 1 its ends")
        axes.grid(visible=False, axis="y")
        value, unit = (worst.value, worst.unit) if isinstance(worst, WorstCase) else (worst.worst, worst.unit)
        axes.set_title(plain_label(f"{worst.metric}: {value:.4g} {unit}".rstrip()))
    return figure


def campaign_figure(result: CampaignResult) -> Figure:
    """Share of the samples worse than each value, read from the campaign's store."""
    if result.kind != "samples":
        raise InputError("plot('exceedance')", f"a campaign of {result.kind}", "one of samples", "plot('delta')")
    store = Store.open(Path(result.store))
    try:
        values, share, upper = exceedance_curve(store, result.sense, result.done, result.lost)
    finally:
        store.close()
    limit = result.violation.limit if result.violation is not None else None
    figure, (axes,) = new_figure(height=3.4)
    seen = share > 0
    with house_style():
        if seen.any():
            axes.step(values[seen], share[seen], where="post", color=COLOURS["nominal"], label="share of the samples")
        axes.plot(values, upper, color=COLOURS["worst"], ls=(0, (6, 2)), label="probability, at most (95 %)")
        if len(values):
            axes.plot(values[-1], upper[-1], "o", color=COLOURS["worst"], ms=5, label="worst sample")
        if limit is not None:
            axes.axvline(limit, color=COLOURS["limit"], lw=1.3, label=plain_label(f"limit {limit:g}"))
        axes.set_xlabel(axis_label(result.metric, result.unit))
        axes.set_ylabel("probability to be worse")
        axes.legend(loc="best")
    logarithmic(axes.yaxis)
    return figure


def mu_bars(bounds: MuBounds) -> Figure:
    """Bounds of mu of every matrix of a stack."""
    lower, upper = np.atleast_1d(bounds.lower), np.atleast_1d(bounds.upper)
    figure, (axes,) = new_figure(width=6.4, height=3.2)
    with house_style():
        place = np.arange(len(upper))
        many = len(upper) > 40
        axes.vlines(place, lower, upper, color=COLOURS["band"], lw=1.5 if many else 5)
        axes.plot(
            place,
            upper,
            "_" if not many else "-",
            color=COLOURS["nominal"],
            ms=16,
            mew=2,
            label="upper, proved by D, G",
        )
        axes.plot(place, lower, "o", color=COLOURS["worst"], ms=2.5 if many else 5, label="lower, attained by a Δ")
        axes.set_ylim(0, 1.15 * max(float(upper.max(initial=0.0)), 1e-300))
        axes.set_xlim(-0.7, len(upper) - 0.3)
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        axes.set_xlabel("matrix")
        axes.set_ylabel("structured singular value μ")
        legend_below(figure, (axes,), 2)
    return figure


def hankel_figure(found: ReducedModel) -> Figure:
    """Hankel singular values: those kept and those left out."""
    kept = found.order - found.n_apart
    place = np.arange(1, len(found.hankel) + 1)
    figure, (axes,) = new_figure(width=6.4, height=3.2)
    with house_style():
        for some, key, label in ((place <= kept, "nominal", "kept"), (place > kept, "sample", "left out")):
            if some.any():
                axes.bar(place[some], found.hankel[some], color=COLOURS[key], width=0.7, label=f"{label}: {some.sum()}")
        if (found.hankel > 0).any():
            logarithmic(axes.yaxis)
            top = float(found.hankel.max())
            axes.set_ylim(max(float(found.hankel[found.hankel > 0].min()) / 3, 1e-16 * top), 3 * top)
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        axes.set_xlabel("state of the balanced model")
        axes.set_ylabel("Hankel singular value")
        axes.set_title(f"error at most {found.error.upper:.4g}")
        legend_below(figure, (axes,), 2)
    return figure


def reduction_figure(found: ReducedModel) -> Figure:
    """Largest singular value of the full and the reduced model, and of their difference."""
    omega = default_grid(found.full, 400)
    full, small = (frequency_response(m, omega) for m in (found.full, found.model))
    figure, (axes,) = new_figure(height=3.6)
    with house_style():
        for values, key, dashes, label in (
            (full, "nominal", "-", f"as given, {found.full.n_states} states"),
            (small, "worst", (0, (4, 1.5)), f"reduced, {found.order} states"),
            (full - small, "sample", "-", "difference"),
        ):
            gain = np.linalg.norm(values, 2, axis=(1, 2))
            axes.plot(omega, np.where(gain > 0, gain, np.nan), color=COLOURS[key], ls=dashes, label=label)
        if found.method in ("truncation", "residualisation", "hankel") and found.error.upper > 0:
            text = f"{found.error.upper:.4g}: proved for the difference"
            axes.axhline(found.error.upper, color=COLOURS["limit"], lw=1.0, ls=(0, (5, 2)), label=text)
        logarithmic(axes.yaxis)
        frequency_axis(axes, (omega[0], omega[-1]))
        axes.set_ylabel("largest singular value")
        legend_below(figure, (axes,), 2)
    return figure


def norm_history(found: SampledDataNorm) -> Figure:
    """Both bounds of a sampled-data norm over the number of intervals of a period."""
    counts = [n for n, _, _ in found.history]
    lower, upper = ([row[k] for row in found.history] for k in (1, 2))
    figure, (axes,) = new_figure(width=6.4, height=3.2)
    with house_style():
        axes.fill_between(counts, lower, upper, color=COLOURS["band"], alpha=0.3, lw=0)
        axes.plot(counts, upper, "o-", color=COLOURS["nominal"], ms=4, label="upper, proved")
        axes.plot(counts, lower, "o-", color=COLOURS["worst"], ms=4, label="lower, attained")
        axes.set_xscale("log", base=2)
        axes.set_xticks(counts, [str(n) for n in counts])
        axes.set_xlabel("intervals of a sample period")
        axes.set_ylabel("sampled-data norm")
        legend_below(figure, (axes,), 2)
    return figure


def mode_figure(found: StructuralTest) -> Figure:
    """How far each mode is from being hidden: relative size of the change of the model that would hide it."""
    order = np.argsort(found.margins)[:BLOCKS]
    figure, (axes,) = new_figure(width=6.4, height=1.2 + 0.27 * max(3, len(order)))
    with house_style():
        floor = 1e-16
        values = np.maximum(found.margins[order], floor)
        axes.barh(range(len(order)), values, left=floor, color=COLOURS["nominal"], height=0.65)
        axes.set_yticks(range(len(order)), [_mode(complex(found.eigenvalues[k])) for k in order])
        axes.invert_yaxis()
        logarithmic(axes.xaxis)
        axes.set_xlim(floor, 3 * float(values.max(initial=1.0)))
        axes.grid(visible=False, axis="y")
        axes.set_ylabel("mode")
        axes.set_xlabel("relative change that would hide it")
        axes.set_title(f"{found.kind}: rank {found.rank} of {found.n_states}")
    return figure


def _mode(value: complex) -> str:
    return f"{value.real:.4g}" if abs(value.imag) <= 1e-12 * abs(value) else f"{value:.4g}"


def measured_response_figure(found: FrequencyData | UncertainFrequencyData) -> Figure:
    """Magnitude and phase of a measured frequency response; of data with several inputs the first one's."""
    if isinstance(found, UncertainFrequencyData):
        known = [s.name for s in found.outputs]
        found = FrequencyData(found.omega, found.nominal[:, :, 0], found.inputs[0].name, known, "nominal response")
    seen = found.omega > 0
    omega = found.omega[seen]
    figure, (above, below) = new_figure(2, 1, 7.2, 2.2, sharex=True, gridspec_kw={"height_ratios": [3, 2]})
    with house_style():
        for k, name in enumerate(found.outputs):
            curve, colour = found.response[seen, k], COLOURS[CURVES[k % len(CURVES)]]
            above.plot(omega, np.abs(curve), ".-", color=colour, ms=4, lw=1.0, label=plain_label(name))
            below.plot(omega, np.degrees(np.unwrap(np.angle(curve))), ".-", color=colour, ms=4, lw=1.0)
        logarithmic(above.yaxis)
        above.set_ylabel(f"magnitude per {plain_label(found.input)}")
        above.set_title(plain_label(found.name))
        below.set_ylabel("phase [degrees]")
        frequency_axis(below, (omega[0], omega[-1]) if len(omega) > 1 else None)
        zero_line(below)
        legend_below(figure, (above,))
    return figure
