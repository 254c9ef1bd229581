"""Which drawings every object has: the same figures as those of reports, drawn by ``.plot()`` too.

`DRAWINGS` is the table: class -> name of a drawing -> function that makes the figure, the first one is drawn where none
is named. A function is imported when it is asked for. `robustlab.shown.Shown.plot` calls `draw`.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from importlib import import_module
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure

from robustlab.errors import InputError, did_you_mean
from robustlab.report.figures import drawn_on

_MODEL = {
    "bode": "model_figures.bode_figure",
    "step": "model_figures.step_figure",
    "sigma": "model_figures.sigma_figure",
    "pzmap": "model_figures.pole_figure",
}
_LOOP = {"loop": "design_figures.loop_picture", "functions": "design_figures.functions_picture"}
_DISK = {"disk": "result_figures.disk_figure"}

DRAWINGS: Mapping[str, Mapping[str, str]] = {
    # models
    "StateSpaceModel": _MODEL,
    "UncertainModel": _MODEL,
    "DelayedModel": {kind: name for kind, name in _MODEL.items() if kind != "pzmap"},
    "UncertainFrequencyData": {"bode": "result_figures.measured_response_figure"},
    "Controller": _MODEL,
    "GeneralizedPlant": _MODEL,
    "Samples": _MODEL,
    "EffectBlocks": {"blocks": "set_figures.blocks_of"},
    "Record": {"signals": "result_figures.record_figure"},
    "FrequencyData": {"bode": "result_figures.measured_response_figure"},
    "ReducedModel": {"sigma": "result_figures.reduction_figure", "hankel": "result_figures.hankel_figure"},
    "StructuralTest": {"modes": "result_figures.mode_figure"},
    # robustness
    "Margin": {"mu": "robustness_figures.mu_figure", "shares": "robustness_figures.margin_shares"},
    "WorstCaseGain": {"gain": "robustness_figures.gain_figure"},
    "MarginAt": {"margin": "robustness_figures.bounds_at"},
    "GainAt": {"gain": "robustness_figures.bounds_at"},
    "DiskMarginAt": {"margin": "robustness_figures.bounds_at"},
    "DiskMarginsAt": {"margin": "robustness_figures.bounds_at", **_DISK},
    "MuBounds": {"mu": "result_figures.mu_bars"},
    "SmallGain": {"gain": "result_figures.small_gain_figure"},
    "DiskBounds": _DISK,
    "SampledRobustness": {"mu": "robustness_figures.sampled_figure"},
    "SampledDataNorm": {"history": "result_figures.norm_history"},
    "Cover": {"set": "set_figures.cover_figure"},
    "Overbound": {"weight": "set_figures.overbound_figure"},
    # members
    "Responses": {"step": "result_figures.band_figure"},
    "WorstCase": {"delta": "result_figures.delta_figure"},
    "ViolationProbability": {
        "distribution": "robustness_figures.distribution_figure",
        "influence": "robustness_figures.violation_influence",
    },
    "CampaignResult": {"exceedance": "result_figures.campaign_figure", "delta": "result_figures.delta_figure"},
    # designs
    "Synthesis": _LOOP,
    "DKSynthesis": {**_LOOP, "mu": "design_figures.mu_picture", "history": "design_figures.history_picture"},
    "SampledController": {"loop": "design_figures.loop_picture"},
    "LoopFunctions": {"functions": "design_figures.gangs_picture"},
    "StateFeedback": {"pzmap": "result_figures.feedback_figure"},
    "KalmanFilter": {"pzmap": "result_figures.estimator_figure"},
    "IntegralFeedback": {"pzmap": "result_figures.estimator_figure"},
    "DesignWeights": {"weights": "result_figures.weights_figure"},
    # measurements
    "Comparison": {
        name: f"comparison_figures.{name}_figure"
        for name in ("where", "time", "speed", "spectrum", "response", "residual", "outputs", "harmonics")
    },
    "Discovery": {
        "gap": "discovery.gap_figure",
        "force": "discovery.force_of",
        "run": "discovery.free_run_figure",
        "stretch": "discovery.stretch_figure",
        "posterior": "discovery.posterior_figure",
    },
    "Validation": {"record": "set_figures.record_of", "delta": "set_figures.delta_figure"},
    "DataCover": {"record": "set_figures.cover_record"},
}


def drawings_of(kind: type) -> Mapping[str, str]:
    """The drawings of a class: those of its own name or of the next class that it is made from."""
    return next((DRAWINGS[parent.__name__] for parent in kind.__mro__ if parent.__name__ in DRAWINGS), {})


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
    """A drawing that failed leaves no figure behind."""
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
