"""Operations of margins and gains, of one model and of a set."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Annotated, Any, Literal

import robustlab as rl
from robustlab.errors import UsageError
from robustlab.operations.common_parameters import Frequency, Loop, Search, Seed, Signals, System, Uncertain
from robustlab.operations.declaration import InLoop, operation
from robustlab.operations.parameter_types import Flag, Number

AT, GAINS = "mu_analysis.margins.at_frequencies.", "analysis.gains_and_margins."
Intervals = Annotated[bool, Flag(only="command"), "Print the proved frequency intervals."]


# --- margins of a loop ------------------------------------------------------------------------------------------------


At = Annotated[Literal["input", "output", "both"], "Where gain and phase change."]


@operation(
    "model margins", "disk-margin", result="mu_analysis.margins.disk_margin.DiskMargins",
    public=f"{GAINS}disk_margin", kinds={"frequency": Frequency},
)  # fmt: skip
def disk_margin(
    plant: Annotated[System, "HDF5 or MATLAB file with the plant, or the open loop."],
    *,
    around: Loop,
    at: At = "output",
    **options: Any,
) -> Any:
    """Disk margins of a loop with the worst gain and phase.

    Of a plant with exact delays: with its delays exact, proved for all frequencies.

    Example: robustlab model margins plant.h5 --controller K.h5 --at both
    """
    return _of_loop(rl.disk_margin, plant, around, at=at, **options)


@operation("model classical-margins", "classical-margins", result="mu_analysis.margins.classical.ClassicalMargins")
def classical_margins(
    plant: Annotated[System, "HDF5 or MATLAB file with the plant, or the open loop."],
    *,
    around: Loop,
    at: At = "output",
) -> Any:
    """Gain, phase and delay margin of each loop alone, with all crossings.

    Example: robustlab model classical-margins plant.h5 --controller K.h5
    """
    if isinstance(plant, rl.UncertainModel):
        raise UsageError("classical-margins", "an uncertain plant", "one model")
    return _of_loop(rl.classical_margins, plant, around, at=at)


def _of_loop(margins: Callable[..., Any], plant: Any, around: Loop, **options: Any) -> InLoop:
    """Return the margins of a loop with its description; an undeclared sign is that of the stable loop."""
    from robustlab.delays.model import as_delayed
    from robustlab.feedback import closing, without_sign

    K = around.controller
    if isinstance(plant, rl.DelayedModel) or isinstance(K, rl.DelayedModel):
        plant, K = (None if o is None else as_delayed(getattr(o, "K", o), "margins") for o in (plant, K))
    loop = closing(plant, K, around.sign, "margins", None if K is not None else -1)
    K = None if loop.K is None else without_sign(loop.K, "margins")
    found = replace(margins(loop.plant, K, sign=loop.sign, **options), loop=loop.said)
    return InLoop(found, extras={"feedback": "negative" if loop.sign < 0 else "positive"})


# --- a set ------------------------------------------------------------------------------------------------------------


def _grid(system: Any, drawn: bool) -> Any:
    """Return frequencies for the curves of a figure; None where nothing is drawn."""
    from robustlab.linear_analysis.frequency import default_grid

    curves = drawn and isinstance(system, rl.UncertainModel) and system.M.n_states
    return default_grid(system.M, 60) if curves else None


@operation(
    "mu", "robust-stability", result=f"mu_analysis.axis.margin.Margin, {AT}MarginAt",
    public=f"{GAINS}robust_stability",
    kinds={"accuracy": (Number(above=0, below=1), "Relative distance to the best margin that D, G can prove.")},
)  # fmt: skip
def robust_stability(
    system: Uncertain,
    *,
    around: Loop,
    frequency: Frequency = None,
    intervals: Intervals = False,
    drawn: bool = False,
    **options: Any,
) -> Any:
    """Robust stability margin (1 / mu) over the whole frequency axis, with the critical Delta.

    With frequencies, and for a file with frequency data: at these frequencies, and nothing is claimed between them.

    Example: robustlab mu motor-uncertain.h5 --intervals --out margin.h5
    """
    from robustlab.mu_analysis.axis.margin import Margin, replay

    loop, words = around.around(system, "robust stability")
    at = frequency is not None or issubclass(type(loop), rl.UncertainFrequencyData)
    if at and intervals:
        raise UsageError("mu", "--intervals at given frequencies", "the margin")
    curves = {} if at else {"omega": _grid(loop, drawn)}
    found: Any = rl.robust_stability(loop, frequency=frequency, **options, **curves)
    extras: dict[str, Any] = {}
    if drawn and isinstance(found, Margin) and found.delta and loop.outputs:
        try:
            extras["replay"] = replay(loop, found)
        except rl.RobustlabError as error:
            return InLoop(found, words, (f"no replay: {error}",), extras)
    return InLoop(found, words, (), extras, (found.proved_intervals(),) if intervals else ())


@operation("worst-gain", "worst-gain", result=f"mu_analysis.axis.margin.WorstCaseGain, {AT}GainAt")
def worst_case_gain(
    system: Uncertain,
    *,
    around: Loop,
    frequency: Frequency = None,
    signals: Signals,
    search: Search,
    seed: Seed = 0,
    drawn: bool = False,
) -> Any:
    """Worst-case gain from inputs to outputs over all members, proved and attained, with its Delta.

    Example: robustlab worst-gain motor-uncertain.h5 --outputs omega
    """
    loop, words = around.around(system, "worst-case gain")
    kept = signals.of(loop)
    at = frequency is not None or isinstance(kept, rl.UncertainFrequencyData)
    options: dict[str, Any] = {} if at else {"omega": _grid(kept, drawn), **vars(search)}
    found: Any = rl.peak_gain(kept, frequency=frequency, seed=seed, **options)
    return InLoop(found, words)


@operation("performance-margin", "performance-margin", result="mu_analysis.axis.margin.PerformanceMargin")
def robust_performance(
    system: Uncertain, *, around: Loop, signals: Signals, search: Search, seed: Seed = 0, drawn: bool = False
) -> Any:
    """Robust performance margin of weighted inputs and outputs.

    Example: robustlab performance-margin loop-uncertain.h5
    """
    loop, words = around.around(system, "robust performance")
    kept = signals.of(loop)
    found = rl.robust_performance(kept, omega=_grid(kept, drawn), seed=seed, **vars(search))
    return InLoop(found, words)
