"""Figures of models, uncertain models, records, measured responses and reduced models.

Step responses, frequency responses, singular values, poles and zeros. An uncertain model is drawn as its nominal model
over sampled members and their envelope; the true envelope may be wider. The Delta of a member is constant and real: of
complex and full blocks the real part of the sample.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator, MultipleLocator
from numpy.typing import ArrayLike

from robustlab.arrays import AnyArray, Array
from robustlab.delays.model import DelayedModel
from robustlab.dynamics.simulation import LOOK, default_clock, simulate
from robustlab.errors import InputError
from robustlab.identification.validation import FrequencyData
from robustlab.linear_analysis.frequency import default_grid, frequency_response
from robustlab.linear_analysis.zeros import transmission_zeros
from robustlab.record import Record
from robustlab.report import style
from robustlab.statespace import Signal, StateSpaceModel, as_model
from robustlab.synthesis.reduction.model_reduction import ReducedModel
from robustlab.uncertainty.frequency_responses import UncertainFrequencyData
from robustlab.uncertainty.lft import UncertainModel
from robustlab.worst_case_analysis.sampling import Samples, sample

MEMBERS, ALL_VERTICES, VERTICES = 30, 5, 32  # members drawn; vertices besides: all of up to 5 blocks, else so many
MOST = 4  # outputs or inputs side by side
POINTS = 500
SIGNALS = 8  # panels of a record


@style.house_style()
def step_figure(shown: Any, t: ArrayLike | None = None, n: int = MEMBERS, seed: int = 0) -> Figure:
    """Responses of every output to a unit step on every input."""
    every, remark = _drawn(shown, n, seed)
    model = every[0]
    rows, columns = model.n_outputs, model.n_inputs
    clock = default_clock(_rational(model), "plot('step')") if t is None else np.asarray(t, dtype=float)
    height = 3.2 if rows == 1 else 2.1
    figure, panels = style.new_figure(rows, columns, max(7.2, 3.6 * columns), height, sharex=True)
    for j, u in enumerate(model.inputs):
        responses = np.array([_step(m, clock, u.name) for m in every])
        for i, y in enumerate(model.outputs):
            panel = panels[i * columns + j]
            _curves(panel, clock, responses[:, :, i], "steps-post" if model.is_discrete else "default")
            panel.set_ylabel(style.axis_label(y.name, _per(y, u)))
        panels[j].set_title(style.plain_label(f"unit step on {u.name}"))
        panels[-columns + j].set_xlabel("time [s]")
    return _closed(figure, panels, len(every) > 1, remark)


@style.house_style()
def bode_figure(shown: Any, omega: ArrayLike | None = None, n: int = MEMBERS, seed: int = 0) -> Figure:
    """Magnitude and phase from every input to every output."""
    every, remark = _drawn(shown, n, seed)
    model = every[0]
    w = _frequencies(model, omega)
    responses = np.array([frequency_response(m, w) for m in every])
    columns = model.n_inputs
    ratios = {"height_ratios": [3, 2] * model.n_outputs}
    width = max(7.2, 3.6 * columns)
    figure, panels = style.new_figure(2 * model.n_outputs, columns, width, 1.75, sharex="col", gridspec_kw=ratios)
    for k, (y, u) in enumerate((y, u) for y in model.outputs for u in model.inputs):
        i, j = divmod(k, columns)
        above, below = panels[2 * i * columns + j], panels[(2 * i + 1) * columns + j]
        curves = responses[:, :, i, j]
        seen, phases = np.abs(curves) > 0, np.degrees(np.unwrap(np.angle(curves), axis=1))
        phases -= 360.0 * np.round((phases[:, :1] - phases[:1, :1]) / 360.0)  # on the branch of the nominal one
        _curves(above, w, np.where(seen, np.abs(curves), np.nan))
        _curves(below, w, np.where(seen, phases, np.nan))
        if not seen.any():
            above.text(0.5, 0.5, "no response", ha="center", va="center", transform=above.transAxes)
        style.logarithmic(above.yaxis)
        label = style.axis_label("magnitude", _per(y, u))
        above.set(ylabel=label, title=style.plain_label(f"{u.name} to {y.name}"))
        below.set_ylabel("phase [degrees]")
        turns = np.ptp(below.get_ylim()) / 90.0  # ticks at multiples of 90 degrees where the phase turns far
        step = 90.0 * max(1.0, np.ceil(turns / 5.0))
        below.yaxis.set_major_locator(MultipleLocator(step) if turns > 1 else MaxNLocator(4))
        for panel in (above, below):
            style.frequency_axis(panel, (w[0], w[-1]))
            panel.set_xlabel("frequency [rad/s]" if panel is panels[-columns + j] else "")
    return _closed(figure, panels, len(every) > 1, remark)


@style.house_style()
def sigma_figure(shown: Any, omega: ArrayLike | None = None, n: int = MEMBERS, seed: int = 0) -> Figure:
    """Largest and smallest singular value over frequency."""
    every, _ = _drawn(shown, n, seed, MOST * 1000)
    model = every[0]
    w = _frequencies(model, omega)
    values = np.array([np.linalg.svd(frequency_response(m, w), compute_uv=False) for m in every])
    values = np.where(values > 0, values, np.nan)
    units = {_per(y, u) for y in model.outputs for u in model.inputs}
    figure, (axes,) = style.new_figure(height=3.6)
    several = values.shape[2] > 1
    _curves(axes, w, values[:, :, 0], name="largest" if several else "")
    if several:
        _curves(axes, w, values[:, :, -1], colour=style.GOOD, name="smallest")
    style.logarithmic(axes.yaxis)
    style.frequency_axis(axes, (w[0], w[-1]))
    axes.set_ylabel(style.axis_label("singular values", units.pop() if len(units) == 1 else "mixed units"))
    return style.legend_below(figure, (axes,))


@style.house_style()
def pole_figure(shown: Any, n: int = MEMBERS, seed: int = 0) -> Figure:
    """Poles (crosses), transmission zeros (circles), the stability boundary, and the poles of members."""
    every, _ = _drawn(shown, n, seed, MOST * 1000)
    model, *members = (as_model(m, "plot") for m in every)
    figure, (axes,) = style.new_figure(width=6.4, height=4.2)
    edge: dict[str, Any] = {"color": style.LIMIT, "ls": style.DASHED, "lw": 1.1}
    if model.dt:
        turn = np.exp(1j * np.linspace(0, 2 * np.pi, 361))
        axes.plot(np.real(turn), np.imag(turn), label="unit circle", **edge)
        axes.set_aspect("equal")
    else:
        axes.axvline(0.0, label="stability boundary", **edge)
    axes.axhline(0.0, color="#888888", lw=0.8)
    cloud = np.concatenate([np.zeros(0), *(m.poles() for m in members)])
    kinds: list[tuple[AnyArray, str, str, dict[str, Any]]] = [
        (cloud, "poles of members", ".", {"color": style.SAMPLE, "ms": 4, "alpha": 0.7}),
        (transmission_zeros(model), "zeros", "o", {"color": style.GOOD, "mfc": "none", "mew": 1.6, "ms": 8}),
        (model.poles(), "poles", "x", {"color": style.NOMINAL, "mew": 1.8, "ms": 8}),
    ]
    for points, label, marker, how in kinds:
        if len(points):
            axes.plot(np.real(points), np.imag(points), marker, label=label, **how)
    unit = "" if model.dt else "rad/s"
    axes.set(xlabel=style.axis_label("real part", unit), ylabel=style.axis_label("imaginary part", unit))
    axes.margins(0.12)
    return style.legend_below(figure, (axes,), 4)


def _drawn(shown: Any, n: int, seed: int, most: int = MOST) -> tuple[list[StateSpaceModel | DelayedModel], str]:
    """Return the nominal model, its members, and a remark on outputs and inputs that are not drawn."""
    whole: Any = shown
    deltas: Any = ()
    if isinstance(shown, Samples):
        whole, deltas = shown.uncertain, shown.deltas
    elif isinstance(shown, UncertainModel) and shown.blocks:
        corners: Any = "all" if len(shown.blocks) <= ALL_VERTICES else VERTICES
        deltas = sample(shown, n, seed, corners).deltas
    real = [{key: np.real(v) if np.iscomplexobj(v) else v for key, v in delta.items()} for delta in deltas]
    members = [whole.evaluate(delta) for delta in real]
    model = whole if isinstance(whole, DelayedModel) else as_model(whole, "plot")
    every = [model, *members]
    if not model.n_outputs or not model.n_inputs:
        raise InputError("plot", f"a model of {model.n_outputs} x {model.n_inputs}", "inputs and outputs")
    if model.n_outputs <= most and model.n_inputs <= most:
        return every, ""
    text = f"the first of {model.n_outputs} outputs and {model.n_inputs} inputs: G[outputs, inputs].plot() has others"
    return [m[:most, :most] for m in every], text


def _closed(figure: Figure, panels: Sequence[Axes], several: bool, remark: str) -> Figure:
    if several:
        style.legend_below(figure, panels)
    if remark:
        figure.suptitle(style.plain_label(remark), fontsize=9)
    return figure


def _frequencies(model: StateSpaceModel | DelayedModel, omega: ArrayLike | None) -> Array:
    if omega is None:
        return default_grid(_rational(model), POINTS, 1.0)
    given = np.atleast_1d(np.asarray(omega, dtype=float))
    if given.ndim != 1 or len(given) < 2 or not (given > 0).all() or not np.isfinite(given).all():
        raise InputError("plot: omega", f"{len(given)} frequencies", "at least two, positive and finite, in rad/s")
    return np.sort(given)


def _rational(model: StateSpaceModel | DelayedModel) -> StateSpaceModel:
    return model.pade(LOOK) if isinstance(model, DelayedModel) else model


def _step(model: StateSpaceModel | DelayedModel, t: Array, name: str) -> Array:
    record = simulate(model, t, {u: np.full(len(t), float(u == name)) for u in model.input_names})
    return np.column_stack([record.outputs[y] for y in model.output_names])


def _per(y: Signal, u: Signal) -> str:
    """Return the unit of a gain from u to y; empty for a ratio or without units."""
    if y.unit == u.unit:
        return ""
    return f"{y.unit or '1'}/{u.unit}" if u.unit and u.unit != "1" else y.unit


def _curves(
    axes: Axes, x: Array, rows: Array, drawstyle: Any = "default", colour: str = style.NOMINAL, name: str = ""
) -> None:
    """Draw the nominal curve (the first row) over the members and their envelope."""
    members, word = rows[1:], f"{name}, " if name else ""
    if len(members):
        step: Any = "post" if drawstyle == "steps-post" else None
        band, text = (np.nanmin(rows, axis=0), np.nanmax(rows, axis=0)), f"{word}envelope of {len(members)} members"
        axes.fill_between(x, *band, color=style.BAND, alpha=0.3, lw=0, step=step, label=text)
        labels = [f"{word}members", *["_"] * (len(members) - 1)]
        axes.plot(x, members.T, color=style.SAMPLE, lw=0.6, alpha=0.7, drawstyle=drawstyle, label=labels)
    label = f"{word}nominal" if len(members) else name or None
    axes.plot(x, rows[0], color=colour, drawstyle=drawstyle, label=label, zorder=3)


@style.house_style()
def record_figure(record: Record) -> Figure:
    """Every signal of a record over time, inputs first."""
    names = [*record.inputs, *record.outputs][:SIGNALS]
    figure, panels = style.new_figure(len(names), 1, 7.6, 1.5 if len(names) > 2 else 2.2, sharex=True)
    for panel, name in zip(panels, names, strict=True):
        colour = style.SAMPLE if name in record.inputs else style.MEASURED
        panel.plot(record.t, record[name], color=colour, lw=1.2)
        panel.set_ylabel(style.axis_label(name, record.unit(name)))
    rest = len(record.inputs) + len(record.outputs) - len(names)
    panels[0].set_title(style.plain_label(record.name + f": the first {len(names)} signals, {rest} more" * bool(rest)))
    panels[-1].set(xlabel="time [s]", xlim=(float(record.t[0]), float(record.t[-1])))
    return figure


@style.house_style()
def measured_response_figure(found: FrequencyData | UncertainFrequencyData) -> Figure:
    """Magnitude and phase of a measured frequency response; of data with several inputs the first one's."""
    if isinstance(found, UncertainFrequencyData):
        known = [s.name for s in found.outputs]
        found = FrequencyData(found.omega, found.nominal[:, :, 0], found.inputs[0].name, known, "nominal response")
    seen = found.omega > 0
    omega, ratios = found.omega[seen], {"height_ratios": [3, 2]}
    figure, (above, below) = style.new_figure(2, 1, 7.2, 2.2, sharex=True, gridspec_kw=ratios)
    for k, name in enumerate(found.outputs):
        curve = found.response[seen, k]
        how: dict[str, Any] = {"color": style.CURVES[k % len(style.CURVES)], "ms": 4, "lw": 1.0}
        above.plot(omega, np.abs(curve), ".-", label=style.plain_label(name), **how)
        below.plot(omega, np.degrees(np.unwrap(np.angle(curve))), ".-", **how)
    style.logarithmic(above.yaxis)
    label = f"magnitude per {style.plain_label(found.input)}"
    above.set(ylabel=label, title=style.plain_label(found.name))
    below.set_ylabel("phase [degrees]")
    style.frequency_axis(below, (omega[0], omega[-1]) if len(omega) > 1 else None)
    style.zero_line(below)
    return style.legend_below(figure, (above,))


@style.house_style()
def reduction_figure(found: ReducedModel) -> Figure:
    """Largest singular value of the full and the reduced model, and of their difference."""
    omega = default_grid(found.full, 400)
    full, small = (frequency_response(m, omega) for m in (found.full, found.model))
    figure, (axes,) = style.new_figure(height=3.6)
    for values, colour, dashes, label in (
        (full, style.NOMINAL, "-", f"as given, {found.full.n_states} states"),
        (small, style.WORST, (0, (4, 1.5)), f"reduced, {found.order} states"),
        (full - small, style.SAMPLE, "-", "difference"),
    ):
        gain = np.linalg.norm(values, 2, axis=(1, 2))
        axes.plot(omega, np.where(gain > 0, gain, np.nan), color=colour, ls=dashes, label=label)
    if found.method in ("truncation", "residualisation", "hankel") and found.error.upper > 0:
        text = f"{found.error.upper:.4g}: proved for the difference"
        axes.axhline(found.error.upper, color=style.LIMIT, lw=1.0, ls=style.DASHED, label=text)
    style.logarithmic(axes.yaxis)
    style.frequency_axis(axes, (omega[0], omega[-1]))
    axes.set_ylabel("largest singular value")
    return style.legend_below(figure, (axes,), 2)
