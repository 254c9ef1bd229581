"""Draw objects, for ``.plot()`` (`draw`) and for commands and reports (`pictures_of`).

`DRAWINGS`: class -> name of a drawing -> ``module.function`` in this package, imported on use; the first one is the
default. The first paragraph of the function's docstring is the caption in a report.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator, Mapping
from importlib import import_module
from typing import TYPE_CHECKING, Any, NamedTuple

from robustlab.errors import InputError, did_you_mean

if TYPE_CHECKING:
    from matplotlib.figure import Figure, SubFigure

_MODEL = {
    "bode": "model_figures.bode_figure",
    "step": "model_figures.step_figure",
    "sigma": "model_figures.sigma_figure",
    "pzmap": "model_figures.pole_figure",
}
_LOOP = {"loop": "design_figures.loop_picture", "functions": "design_figures.functions_picture"}
_DISK = {"disk": "robustness_figures.disk_figure"}
_MARGIN = {"mu": "robustness_figures.mu_figure", "shares": "robustness_figures.margin_shares"}

DRAWINGS: Mapping[str, Mapping[str, str]] = {
    # models
    "StateSpaceModel": _MODEL,
    "UncertainModel": _MODEL,
    "DelayedModel": {kind: name for kind, name in _MODEL.items() if kind != "pzmap"},
    "UncertainFrequencyData": {"bode": "model_figures.measured_response_figure"},
    "Controller": _MODEL,
    "GeneralizedPlant": _MODEL,
    "Samples": _MODEL,
    "Record": {"signals": "model_figures.record_figure"},
    "FrequencyData": {"bode": "model_figures.measured_response_figure"},
    "ReducedModel": {"sigma": "model_figures.reduction_figure"},
    # robustness
    **dict.fromkeys(("Margin", "PerformanceMargin"), _MARGIN),
    "WorstCaseGain": {"gain": "robustness_figures.gain_figure"},
    "CriticalResponse": {"replay": "robustness_figures.replay_figure"},
    "MarginAt": {"margin": "robustness_figures.bounds_at"},
    "GainAt": {"gain": "robustness_figures.bounds_at"},
    "DiskMarginAt": {"margin": "robustness_figures.bounds_at"},
    **dict.fromkeys(("DiskBounds", "DiskMargins"), _DISK),
    "Cover": {"set": "robustness_figures.cover_figure"},
    "Overbound": {"weight": "robustness_figures.overbound_figure"},
    # members
    "Responses": {"step": "robustness_figures.band_figure"},
    "WorstCase": {"delta": "robustness_figures.member_figure", "response": "robustness_figures.worst_case_figure"},
    "ViolationProbability": {
        "distribution": "robustness_figures.distribution_figure",
        "influence": "robustness_figures.violation_influence",
    },
    "CampaignResult": {"delta": "robustness_figures.member_figure"},
    # designs
    **dict.fromkeys(("Synthesis", "HinfSynthesis", "H2Synthesis", "NcfSynthesis"), _LOOP),
    **dict.fromkeys(("FixedSynthesis", "TunedSynthesis", "ReducedController", "DKSynthesis"), _LOOP),
    "PerformanceComparison": {"mu": "design_figures.performance_picture"},
    "ControlledRuns": {"runs": "design_figures.runs_picture"},
    "TrackingLoop": {"functions": "design_figures.tracking_picture"},
    "SampledController": {"loop": "design_figures.loop_picture"},
    "LoopFunctions": {"functions": "design_figures.gangs_picture"},
    # measurements
    "Comparison": {name: f"discovery.{name}_figure" for name in ("where", "time", "speed")},
    "Discovery": {
        "gap": "discovery.gap_figure",
        "force": "discovery.force_of",
        "run": "discovery.free_run_figure",
    },
    "Validation": {"record": "robustness_figures.validation_figure"},
    "DataCover": {"record": "robustness_figures.cover_record"},
    "EnvelopeCoverage": {"envelope": "robustness_figures.envelope_figure"},
}

# Class -> attribute with its outputs (names, or pairs that begin with one), each of which is drawn.
OUTPUTS: Mapping[str, str] = {
    **dict.fromkeys(("Comparison", "Validation", "Responses"), "outputs"),
    "Discovery": "gaps",
    "EnvelopeCoverage": "signals",
}


def drawings_of(kind: type) -> Mapping[str, str]:
    """Return the drawings of a class or of its nearest base."""
    return next((DRAWINGS[parent.__name__] for parent in kind.__mro__ if parent.__name__ in DRAWINGS), {})


class Picture(NamedTuple):
    """A drawing of a result with its caption."""

    figure: Figure
    caption: str


def pictures_of(shown: Any, remark: Callable[[str], None] | None = None) -> Iterator[tuple[str, Picture]]:
    """Yield every drawing of an object by name; pass to ``remark`` the reason of a missing one.

    A drawing of one output is made of each output, with the name NAME-OUTPUT.
    """
    of = OUTPUTS.get(type(shown).__name__)
    outputs = [x if isinstance(x, str) else x[0] for x in getattr(shown, of)] if of else []
    for kind, name in drawings_of(type(shown)).items():
        drawing = _function(name)
        caption = (inspect.getdoc(drawing) or "").partition("\n\n")[0].replace("\n", " ")
        takes_one = "output" in inspect.signature(drawing).parameters
        for number, output in enumerate(outputs if takes_one and of else [None], start=1):
            try:
                figure: Any = drawing(shown) if output is None else drawing(shown, output=output)
            except InputError as error:
                if remark is not None and not of:
                    remark(f"no figure {kind}: {error}")
                continue
            if output is None:
                yield kind, Picture(figure, caption)
            else:
                plain = output.isidentifier() and output.isascii()
                yield f"{kind}-{output if plain else f'output{number}'}", Picture(figure, f"{output}: {caption}")


def draw(shown: Any, kind: str | None, ax: Any, options: Mapping[str, Any]) -> Any:
    """See `robustlab.display.Displayable.plot`."""
    from matplotlib.axes import Axes

    from robustlab.report.style import drawn_on

    where, known = f"{type(shown).__name__}.plot", drawings_of(type(shown))
    if not known:
        raise InputError(where, "nothing to draw", None, "summary() describes it in text")
    if kind is not None and kind not in known:
        raise InputError(where, f"{kind!r}", f"one of {', '.join(known)}", did_you_mean(str(kind), list(known)))
    if ax is not None and not isinstance(ax, Axes):
        raise InputError(where, f"ax is a {type(ax).__name__}", "one matplotlib Axes")
    drawing = _function(known[kind or next(iter(known))])
    names = list(inspect.signature(drawing).parameters)[1:]
    for name in options:
        if name not in names:
            expected = f"one of {', '.join(names)}" if names else "none"
            raise InputError(where, f"option {name!r}", expected, did_you_mean(name, names))
    import matplotlib.pyplot as plt
    import numpy as np

    made: list[Figure] = []

    def figure_of(size: tuple[float, float]) -> Figure:
        made.append(plt.figure(figsize=size, layout="constrained"))
        return made[-1]

    try:
        with drawn_on(ax if ax is not None else figure_of):
            figure = drawing(shown, **options)
    except BaseException:
        for one in made:
            plt.close(one)
        raise
    if ax is not None and figure is ax.figure and ax in figure.axes:
        return ax
    panels = [axes for axes in figure.axes if axes.get_visible()]
    return panels[0] if len(panels) == 1 else np.array(panels, dtype=object)


def _function(name: str) -> Callable[..., Figure | SubFigure]:
    module, _, function = name.partition(".")
    return getattr(import_module(f"robustlab.report.{module}"), function)
