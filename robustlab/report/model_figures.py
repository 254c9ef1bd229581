"""Figures of models and of uncertain ones: step responses, frequency responses, singular values, poles and zeros.

Of an uncertain model the nominal one is drawn over sampled members and their envelope; the true one may be wider. A
member is drawn with a constant real Delta: of complex and full blocks that is the real part of the one that was drawn.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from robustlab.arrays import AnyArray, Array
from robustlab.delays.model import DelayedModel
from robustlab.dynamics.simulation import LOOK, default_clock, simulate
from robustlab.errors import InputError
from robustlab.linear_analysis.frequency import default_grid, frequency_response
from robustlab.linear_analysis.invariant_zeros import transmission_zeros
from robustlab.report.figures import (
    COLOURS,
    axis_label,
    frequency_axis,
    house_style,
    legend_below,
    logarithmic,
    new_figure,
    plain_label,
)
from robustlab.statespace import Signal, StateSpaceModel, as_model
from robustlab.uncertainty.lft import UncertainModel
from robustlab.worst_case_analysis import sample
from robustlab.worst_case_analysis.sampling import Samples

MEMBERS, ALL_VERTICES, VERTICES = 30, 5, 32  # members drawn; vertices besides: all of up to 5 blocks, else so many
MOST = 4  # outputs or inputs side by side
POINTS = 500


@dataclass(frozen=True)
class _Drawn:
    """What is drawn: the nominal model, members around it, and how many outputs and inputs were left out."""

    nominal: StateSpaceModel | DelayedModel
    members: Sequence[StateSpaceModel] = ()
    left_out: str = ""

    @property
    def every(self) -> tuple[StateSpaceModel | DelayedModel, ...]:
        return (self.nominal, *self.members)


def step_figure(shown: Any, t: ArrayLike | None = None, n: int = MEMBERS, seed: int = 0) -> Figure:
    """Responses of every output to a unit step on every input."""
    drawn = _drawn(shown, n, seed)
    model = drawn.nominal
    clock = default_clock(_rational(model), "plot('step')") if t is None else np.asarray(t, dtype=float)
    figure, panels = _grid(model, height=2.1)
    with house_style():
        for j, u in enumerate(model.inputs):
            # a model without states answers at once
            rows = np.array([_step(m, clock, u.name) for m in drawn.every])
            for i, y in enumerate(model.outputs):
                panel = panels[i * model.n_inputs + j]
                _curves(panel, clock, rows[:, :, i], "steps-post" if model.is_discrete else "default")
                panel.set_ylabel(axis_label(y.name, _per(y, u)))
            panels[j].set_title(plain_label(f"unit step on {u.name}"))
        _bottom(panels, model, "time [s]")
        _close(figure, panels, drawn)
    return figure


def bode_figure(shown: Any, omega: ArrayLike | None = None, n: int = MEMBERS, seed: int = 0) -> Figure:
    """Magnitude and phase from every input to every output."""
    drawn = _drawn(shown, n, seed)
    model = drawn.nominal
    w = _frequencies(model, omega)
    responses = np.array([frequency_response(m, w) for m in drawn.every])
    columns = model.n_inputs
    ratios = {"height_ratios": [3, 2] * model.n_outputs}
    width = max(7.2, 3.6 * columns)
    figure, panels = new_figure(2 * model.n_outputs, columns, width, 1.75, sharex="col", gridspec_kw=ratios)
    with house_style():
        for i, y in enumerate(model.outputs):
            for j, u in enumerate(model.inputs):
                above, below = panels[2 * i * columns + j], panels[(2 * i + 1) * columns + j]
                curves = responses[:, :, i, j]
                size = np.abs(curves)
                _curves(above, w, np.where(size > 0, size, np.nan))
                logarithmic(above.yaxis)
                above.set_ylabel(axis_label("magnitude", _per(y, u)))
                above.set_title(plain_label(f"{u.name} to {y.name}"))
                _curves(below, w, np.where(size > 0, _phases(curves), np.nan))
                if not size.any():
                    above.text(0.5, 0.5, "no response", ha="center", va="center", transform=above.transAxes)
                below.set_ylabel("phase [degrees]")
                below.yaxis.set_major_locator(_quarter_turns(below))
                for panel in (above, below):
                    frequency_axis(panel, (w[0], w[-1]))
                    panel.set_xlabel("frequency [rad/s]" if panel is panels[-columns + j] else "")
        _close(figure, panels, drawn)
    return figure


def sigma_figure(shown: Any, omega: ArrayLike | None = None, n: int = MEMBERS, seed: int = 0) -> Figure:
    """Largest and smallest singular value over frequency; options as of `bode_figure`."""
    drawn = _drawn(shown, n, seed, MOST * 1000)
    model = drawn.nominal
    w = _frequencies(model, omega)
    values = np.array([np.linalg.svd(frequency_response(m, w), compute_uv=False) for m in drawn.every])
    units = {_per(y, u) for y in model.outputs for u in model.inputs}
    figure, (axes,) = new_figure(height=3.6)
    with house_style():
        _curves(axes, w, _positive(values[:, :, 0]), name="" if values.shape[2] == 1 else "largest")
        if values.shape[2] > 1:
            _curves(axes, w, _positive(values[:, :, -1]), colour="good", name="smallest")
        logarithmic(axes.yaxis)
        frequency_axis(axes, (w[0], w[-1]))
        axes.set_ylabel(axis_label("singular values", units.pop() if len(units) == 1 else "mixed units"))
        legend_below(figure, (axes,))
    return figure


def pole_figure(shown: Any, n: int = MEMBERS, seed: int = 0) -> Figure:
    """Poles and transmission zeros in the complex plane; of an uncertain model the members' poles around them."""
    drawn = _drawn(shown, n, seed, MOST * 1000)
    model = as_model(drawn.nominal, "plot")
    zeros = transmission_zeros(model)
    clouds = [m.poles() for m in drawn.members]
    return poles_figure(model.poles(), zeros, model.dt, np.concatenate(clouds) if clouds else None)


def poles_figure(poles: AnyArray, zeros: AnyArray, dt: float, cloud: AnyArray | None = None) -> Figure:
    """Poles (crosses), zeros (circles) and the stability boundary; behind them the poles of members."""
    figure, (axes,) = new_figure(width=6.4, height=4.2)
    with house_style():
        if dt:
            turn = np.exp(1j * np.linspace(0, 2 * np.pi, 361))
            axes.plot(np.real(turn), np.imag(turn), color=COLOURS["limit"], ls=(0, (5, 2)), lw=1.1, label="unit circle")
            axes.set_aspect("equal")
        else:
            axes.axvline(0.0, color=COLOURS["limit"], ls=(0, (5, 2)), lw=1.1, label="stability boundary")
        axes.axhline(0.0, color="#888888", lw=0.8)
        if cloud is not None and len(cloud):
            axes.plot(
                np.real(cloud), np.imag(cloud), ".", color=COLOURS["sample"], ms=4, alpha=0.7, label="poles of members"
            )
        if len(zeros):
            style: dict[str, Any] = {"mfc": "none", "mew": 1.6, "ms": 8, "color": COLOURS["good"]}
            axes.plot(np.real(zeros), np.imag(zeros), "o", label="zeros", **style)
        if len(poles):
            axes.plot(np.real(poles), np.imag(poles), "x", color=COLOURS["nominal"], mew=1.8, ms=8, label="poles")
        unit = "" if dt else "rad/s"
        axes.set_xlabel(axis_label("real part", unit))
        axes.set_ylabel(axis_label("imaginary part", unit))
        axes.margins(0.12)
        legend_below(figure, (axes,), 4)
    return figure


# --- what is drawn ----------------------------------------------------------------------------------------------------


def _drawn(shown: Any, n: int, seed: int, most: int = MOST) -> _Drawn:
    if isinstance(shown, Samples):
        whole: Any = shown.uncertain
        members = [whole.evaluate(_real(delta)) for delta in list(shown.deltas)]
    elif isinstance(shown, UncertainModel):
        whole = shown
        corners: Any = "all" if len(shown.blocks) <= ALL_VERTICES else VERTICES
        found = sample(shown, n, seed, corners) if shown.blocks else None
        members = [shown.evaluate(_real(delta)) for delta in list(found.deltas)] if found else []
    else:
        whole, members = shown, []
    model = whole if isinstance(whole, DelayedModel) else as_model(whole, "plot")
    if not model.n_outputs or not model.n_inputs:
        raise InputError("plot", f"a model of {model.n_outputs} x {model.n_inputs}", "inputs and outputs")
    if model.n_outputs <= most and model.n_inputs <= most:
        return _Drawn(model, members)
    told = f"the first of {model.n_outputs} outputs and {model.n_inputs} inputs: G[outputs, inputs].plot() has others"
    first = (slice(0, most), slice(0, most))
    return _Drawn(model[first], [m[first] for m in members], told)


def _real(delta: Any) -> dict[str, Any]:
    return {name: np.real(value) if np.iscomplexobj(value) else value for name, value in delta.items()}


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


def _phases(curves: AnyArray) -> Array:
    """Unwrapped phases in degrees, each on the branch that the nominal one (the first) begins on."""
    phases = np.degrees(np.unwrap(np.angle(curves), axis=1))
    return phases - 360.0 * np.round((phases[:, :1] - phases[:1, :1]) / 360.0)


def _positive(values: Array) -> Array:
    return np.where(values > 0, values, np.nan)


def _per(y: Signal, u: Signal) -> str:
    """Unit of a gain from u to y; empty for a ratio or where neither has a unit."""
    if y.unit == u.unit:
        return ""
    return f"{y.unit or '1'}/{u.unit}" if u.unit and u.unit != "1" else y.unit


# --- panels -----------------------------------------------------------------------------------------------------------


def _grid(model: StateSpaceModel | DelayedModel, height: float) -> tuple[Figure, list[Axes]]:
    rows, columns = model.n_outputs, model.n_inputs
    height = max(height, 3.2) if rows == 1 else height
    return new_figure(rows, columns, max(7.2, 3.6 * columns), height, sharex=True)


def _curves(
    axes: Axes, x: Array, rows: Array, drawstyle: Any = "default", colour: str = "nominal", name: str = ""
) -> None:
    """The nominal curve (the first row) over the members and their envelope."""
    nominal, members = rows[0], rows[1:]
    word = f"{name}, " if name else ""
    if len(members):
        low, high = np.nanmin(rows, axis=0), np.nanmax(rows, axis=0)
        step: Any = "post" if drawstyle == "steps-post" else None
        text = f"{word}envelope of {len(members)} members"
        axes.fill_between(x, low, high, color=COLOURS["band"], alpha=0.3, lw=0, step=step, label=text)
        for k, row in enumerate(members):
            label = f"{word}members" if k == 0 else None
            axes.plot(x, row, color=COLOURS["sample"], lw=0.6, alpha=0.7, drawstyle=drawstyle, label=label)
    label = f"{word}nominal" if len(members) else name or None
    axes.plot(x, nominal, color=COLOURS[colour], drawstyle=drawstyle, label=label, zorder=3)


def _quarter_turns(axes: Axes) -> Any:
    """Ticks at multiples of 90 degrees where the phase turns far, else where matplotlib puts them."""
    from matplotlib.ticker import MaxNLocator, MultipleLocator

    low, high = axes.get_ylim()
    turns = (high - low) / 90.0
    return MultipleLocator(90.0 * max(1.0, np.ceil(turns / 5.0))) if turns > 1 else MaxNLocator(4)


def _bottom(panels: Sequence[Axes], model: StateSpaceModel | DelayedModel, label: str) -> None:
    for panel in panels[-model.n_inputs :]:
        panel.set_xlabel(label)


def _close(figure: Figure, panels: Sequence[Axes], drawn: _Drawn) -> None:
    if drawn.members:
        legend_below(figure, panels)
    if drawn.left_out:
        figure.suptitle(plain_label(drawn.left_out), fontsize=9)
