"""Doors of margins, gains and stability: of one model, of a set, of blocks that are not linear."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Annotated, Any

import robustlab as rl
from robustlab.doors.declaration import InLoop, Named, door
from robustlab.doors.kinds import Choice, Flag, Kind, Names, Number, Numbers, Table, Thing, Whole
from robustlab.doors.words import (
    Band,
    Controller,
    Frequency,
    Loop,
    Model,
    Search,
    Seed,
    Sign,
    Signals,
    System,
    Uncertain,
)
from robustlab.errors import UsageError

# Words of a sign, as `robustlab.closing` has them; it is not imported here, for numpy's sake.
WORDS = {-1: "negative", 1: "positive"}

AT = "mu_analysis.margins.at_frequencies."
Of = Annotated[Model, Named(key="of")]
OfSet = Annotated[Uncertain, Named(key="of")]
NO_LOOP, ALL_SIGNALS, USUAL = Loop(), Signals(), Search()
Tolerance = Annotated[float, Number(above=0), "Relative gap of the bounds that is aimed at; inf: no branch and bound."]
Accuracy = Annotated[float, Number(above=0, below=1), "Relative distance to the best margin that D, G can prove."]
FilterOrder = Annotated[int, Whole(0, 8), "Order of the multipliers' filters.", Named(option="--filter-order")]
Intervals = Annotated[bool, Flag(), "Print the proved frequency intervals.", Named(only="command")]
CrossCheck = Annotated[
    bool, Flag(), "Ask SLICOT too (AB13MD, AB13DD); where it contradicts, exit code 4.", Named(only="command")
]
ON_COMMAND = Named(only="command")
Bounds = Annotated[dict[str, float] | None, Table(Number(above=0))]
Nature = Annotated[
    dict[str, str] | None,
    Table(Kind(), words="NAME=WORD:NUMBERS"),
    "Block, or OUTPUT:INPUT between two signals -> what is there: varying[:RATE], saturation, dead-zone[:SIZE:REACH], "
    "friction:LEVEL:SPEED, sector:LOW:HIGH, slope:LOW:HIGH, odd-slope:LOW:HIGH.",
]


# --- norms of one model -----------------------------------------------------------------------------------------------


@door("model norm --kind=hinf", "hinf-norm", result="norms.HinfNorm")
def hinf_norm(system: Of) -> Any:
    """A norm of a model with its evidence: peak gain (hinf; linf of unstable models), white noise (h2), passivity.

    Exit code 4: the number cannot be vouched for.

    Example: robustlab model norm motor.h5 --kind h2
    """
    return rl.peak_gain(system)


@door("model norm --kind=linf", "linf-norm", result="norms.HinfNorm")
def linf_norm(system: Of, band: Band = None) -> Any:
    """L-infinity norm of a model, which may be unstable: its peak gain over the frequency axis, or in a band."""
    return rl.peak_gain(system, norm="linf", band=band)


@door("model norm --kind=h2", "h2-norm", result="norms.impulse_energy.H2Norm")
def h2_norm(system: Of) -> Any:
    """H2 norm of a model."""
    return rl.h2_norm(system)


@door("model norm --kind=passivity", "passivity", result="norms.positive_real.Passivity")
def passivity(system: Of) -> Any:
    """Relative passivity index of a square model, input k belonging to output k, and its input and output index."""
    return rl.passivity(system)


# --- margins of a loop ------------------------------------------------------------------------------------------------


Skew = Annotated[float, Number(), "0: gain up as much as down; positive: rather up."]
At = Annotated[str, Choice(("input", "output", "both")), "Where gain and phase change."]


@door("model margins", "disk-margin", result="mu_analysis.margins.disk_margin.DiskMargins")
def disk_margin(
    plant: Annotated[System, "HDF5 or MATLAB file with the plant, or the open loop.", Named(key="of")],
    around: Loop = NO_LOOP,
    at: At = "output",
    frequency: Frequency = None,
    skew: Skew = 0.0,
    search: Search = USUAL,
    seed: Seed = 0,
) -> Any:
    """Disk margins of a loop with the worst gain and phase; for an uncertain plant those of its worst member.

    Of a plant with exact delays: with its delays exact, proved for all frequencies.

    Example: robustlab model margins plant.h5 --controller K.h5 --at both
    """
    options: dict[str, Any] = {**search.options, "seed": seed}
    given: Any = at
    loop, K, sign, words = _loop(plant, around)
    found = rl.disk_margin(loop, K, at=given, sign=sign, frequency=frequency, skew=skew, **options)
    return InLoop(replace(found, loop=words), beside={"feedback": WORDS[sign]})


@door("model margins --classical", "classical-margins", result="mu_analysis.margins.classical.ClassicalMargins")
def classical_margins(
    plant: Annotated[System, "HDF5 or MATLAB file with the plant, or the open loop.", Named(key="of")],
    around: Loop = NO_LOOP,
    at: At = "output",
) -> Any:
    """Gain, phase and delay margin of each loop alone, with all crossings."""
    if isinstance(plant, rl.UncertainModel):
        hint = "rl.disk_margin is that of the worst member"
        raise UsageError("--classical", "an uncertain plant", "one model", hint)
    given: Any = at
    loop, K, sign, words = _loop(plant, around)
    found = rl.classical_margins(loop, K, at=given, sign=sign)
    return InLoop(replace(found, loop=words), beside={"feedback": WORDS[sign]})


def _loop(plant: Any, around: Loop) -> tuple[Any, Any, Any, str]:
    """Plant, controller, sign and the loop in words; a sign that nothing says is that of the stable loop."""
    from robustlab.closing import closing, silenced
    from robustlab.delays.model import as_delayed

    K = around.controller
    if isinstance(plant, rl.DelayedModel) or isinstance(K, rl.DelayedModel):
        plant, K = (None if o is None else as_delayed(getattr(o, "K", o), "margins") for o in (plant, K))
    found = closing(plant, K, around.sign, "margins", None if K is not None else -1)
    return found.plant, None if found.K is None else silenced(found.K, "margins"), found.sign, found.said


@dataclass(frozen=True)
class Told:
    """What a command is asked to show or to have checked beside its answer."""

    intervals: Intervals = False
    cross_check: CrossCheck = False


@dataclass(frozen=True)
class Confirmed(Told):
    """The same, and a second look at the proof."""

    certify: Annotated[bool, Flag(), "Confirm the scalings in ball arithmetic.", Named(only="command")] = False


NO_TABLE, NO_MORE = Told(), Confirmed()


# --- a set ------------------------------------------------------------------------------------------------------------


def _grid(system: Any, drawn: bool) -> Any:
    """Frequencies for the curves of a figure; none where nothing is drawn."""
    from robustlab.linear_analysis.frequency import default_grid

    asked = drawn and isinstance(system, rl.UncertainModel) and system.M.n_states
    return default_grid(system.M, 60) if asked else None


def _checked(found: Any, system: Any, cross_check: bool) -> dict[str, Any]:
    """What SLICOT says, where it is asked."""
    if not cross_check:
        return {}
    from robustlab.mu_analysis.cross_check import cross_check as ask

    return {"cross_check": ask(system, found)}


@door("mu", "robust-stability", result="mu_analysis.axis.margin.Margin")
def robust_stability(
    system: OfSet,
    around: Loop = NO_LOOP,
    frequency: Frequency = None,
    tolerance: Tolerance | None = None,
    accuracy: Accuracy | None = None,
    search: Search = USUAL,
    seed: Seed = 0,
    more: Confirmed = NO_MORE,
    drawn: bool = False,
) -> Any:
    """Robust stability margin (1 / mu) over the whole frequency axis, with the critical Delta.

    With frequencies, and for a file with frequency data: at these frequencies, and nothing is claimed between them.

    Example: robustlab mu motor-uncertain.h5 --intervals --out margin.h5
    """
    from robustlab.mu_analysis.axis.critical_delta import replay
    from robustlab.mu_analysis.axis.margin import Margin, margin_in_balls

    loop, words = around.around(system, "robust stability")
    options: dict[str, Any] = {"omega": _grid(loop, drawn), "tolerance": tolerance, "accuracy": accuracy}
    if frequency is not None or issubclass(type(loop), rl.UncertainFrequencyData):
        del options["omega"]
        asked = {"--certify": more.certify, "--cross-check": more.cross_check, "--intervals": more.intervals}
        if refused := next((name for name, given in asked.items() if given), None):
            raise UsageError("mu", f"{refused} at given frequencies", "the margin, or --gain")
    found: Any = rl.robust_stability(loop, frequency=frequency, **search.options, seed=seed, **options)
    beside = _checked(found, loop, more.cross_check)
    if more.certify:
        beside["balls"] = margin_in_balls(loop, found)
    if drawn and isinstance(found, Margin) and found.delta and loop.outputs:
        try:
            beside["replay"] = replay(loop, found)
        except rl.RobustlabError as error:
            return InLoop(found, words, (f"no replay: {error}",), beside)
    return InLoop(found, words, (), beside, (found.proved_intervals(),) if more.intervals else ())


@door("mu --gain", "worst-gain", result="mu_analysis.axis.worst_gain.WorstCaseGain")
def worst_case_gain(
    system: OfSet,
    around: Loop = NO_LOOP,
    frequency: Frequency = None,
    signals: Signals = ALL_SIGNALS,
    tolerance: Tolerance | None = None,
    search: Search = USUAL,
    seed: Seed = 0,
    more: Told = NO_TABLE,
    drawn: bool = False,
) -> Any:
    """Worst-case gain from inputs to outputs."""
    loop, words = around.around(system, "worst-case gain")
    kept = signals.of(loop)
    at = frequency is not None or isinstance(kept, rl.UncertainFrequencyData)
    options: dict[str, Any] = {} if at else {
        "omega": _grid(kept, drawn), "tolerance": tolerance, **search.options
    }  # fmt: skip
    found: Any = rl.peak_gain(kept, frequency=frequency, seed=seed, **options)
    tables = (found.proved(),) if more.intervals else ()
    return InLoop(found, words, (), _checked(found, kept, more.cross_check), tables)


@door("mu --performance", "performance-margin", result="mu_analysis.axis.margin.PerformanceMargin")
def robust_performance(
    system: OfSet,
    around: Loop = NO_LOOP,
    signals: Signals = ALL_SIGNALS,
    tolerance: Tolerance = 0.01,
    accuracy: Accuracy = 3e-5,
    search: Search = USUAL,
    seed: Seed = 0,
    intervals: Intervals = False,
    drawn: bool = False,
) -> Any:
    """Robust performance margin of weighted inputs and outputs."""
    loop, words = around.around(system, "robust performance")
    kept = signals.of(loop)
    found = rl.robust_performance(
        kept, omega=_grid(kept, drawn), tolerance=tolerance, accuracy=accuracy, seed=seed,
        **search.options,
    )  # fmt: skip
    return InLoop(found, words, (), {}, (found.proved_intervals(),) if intervals else ())


@door("mu --level", "robust-gain", result="mu_analysis.axis.robust_gain.RobustGain")
def robust_gain(
    system: OfSet,
    level: Annotated[float, Number(above=0), "How much of the set keeps the gain below this level."],
    around: Loop = NO_LOOP,
    signals: Signals = ALL_SIGNALS,
    tolerance: Tolerance = 0.01,
    search: Search = USUAL,
    seed: Seed = 0,
) -> Any:
    """How much of the set keeps every member's gain below a level."""
    loop, words = around.around(system, "robust gain")
    options: dict[str, Any] = {**search.options, "seed": seed}
    return InLoop(rl.robust_gain(signals.of(loop), level, tolerance=tolerance, **options), words)


@door(
    "", "robustness-at", result="mu_analysis.margins.at_frequencies.MarginAt, mu_analysis.margins.at_frequencies.GainAt"
)
def robustness_at(
    system: OfSet,
    around: Loop = NO_LOOP,
    frequency: Frequency = None,
    what: Annotated[str, Choice(("margin", "gain")), "Stability margin, or largest gain."] = "margin",
    seed: Seed = 0,
) -> Any:
    """Margin, or worst-case gain, at given frequencies; nothing is claimed between them."""
    loop, words = around.around(system, "robustness at frequencies")
    asked: Any = rl.robust_stability if what == "margin" else rl.peak_gain
    return InLoop(asked(loop, frequency=frequency, seed=seed), words)


# --- blocks that are not linear, or vary with time --------------------------------------------------------------------


def _natures(nature: dict[str, str] | None, system: Any) -> Any:
    from robustlab.iqc.nature import natures_in_words

    return natures_in_words(nature or {}, "--nature", [b.name for b in getattr(system, "blocks", ())])


@door("iqc gain", "iqc-gain", result="iqc.IqcGain")
def iqc_gain(
    system: Annotated[System, "Uncertain model, model, or a plant with effects: HDF5 file.", Named(key="of")],
    nature: Nature = None,
    around: Loop = NO_LOOP,
    signals: Signals = ALL_SIGNALS,
    order: FilterOrder = 2,
    search: Search = USUAL,
    amplitude: Annotated[
        Bounds, "Of a plant with effects: place of an effect -> bound of its signal.", ON_COMMAND
    ] = None,
    stick_speed: Annotated[
        Bounds, "Of a plant with effects: joint -> speed below which dry friction is creep.", ON_COMMAND
    ] = None,
) -> Any:
    """Worst L2 gain, proved for blocks that are nonlinear, vary with time, or are uncertain.

    Example: robustlab iqc gain loop.h5 --nature y:u=saturation --nature k=varying:0.5
    """
    from robustlab.dynamics.extended.extended_plant import ExtendedPlant

    if isinstance(system, ExtendedPlant):
        if around.controller is None:
            raise UsageError("iqc gain", "a plant with effects without --controller", "the loop that it stands in")
        if nature or signals.inputs:
            expected, hint = "none of them", "its effects say what they are"
            raise UsageError("iqc gain", "--nature or --inputs for a plant with effects", expected, hint)
        found = (system, around.controller, signals.outputs, amplitude, stick_speed)
        return effect_gain(*found, around.sign, order, search)
    if amplitude or stick_speed:
        found, expected = f"--amplitude or --stick-speed for a {type(system).__name__}", "a plant with effects"
        raise UsageError("iqc gain", found, expected, "nature=... says what a block is")
    loop, words = around.around(system, "iqc gain")
    found = rl.peak_gain(
        loop, natures=_natures(nature, loop), inputs=signals.inputs, outputs=signals.outputs, order=order,
        **search.options,
    )  # fmt: skip
    return InLoop(found, words)


@door("iqc gain --stability", "iqc-stability", result="iqc.IqcStability")
def iqc_stability(
    system: Annotated[System, "Uncertain model, or model: HDF5 file.", Named(key="of")],
    nature: Nature = None,
    around: Loop = NO_LOOP,
    order: FilterOrder = 2,
    search: Search = USUAL,
) -> Any:
    """Stability, proved for blocks that are nonlinear, vary with time, or are uncertain."""
    loop, words = around.around(system, "iqc gain")
    options: dict[str, Any] = {"order": order, **search.options}
    return InLoop(rl.robust_stability(loop, natures=_natures(nature, loop), **options), words)


@door("", "effect-gain", result="iqc.effect_gain_bounds.EffectGain")
def effect_gain(
    plant: Annotated[
        Any, Thing(("plant", "any")), "A plant with effects: what a discovery found, or its file.", Named(key="of")
    ],
    controller: Annotated[Controller, Named(option="--controller,-k")],
    outputs: Annotated[list[str] | None, Names("outputs"), "Outputs that the controller sees; all if left out."] = None,
    amplitude: Annotated[
        dict[str, float] | None, Table(Number(above=0)), "Place of an effect -> bound of its signal."
    ] = None,
    stick_speed: Annotated[
        dict[str, float] | None, Table(Number(above=0)), "Joint -> speed below which dry friction is creep."
    ] = None,
    sign: Annotated[Sign, Named(option="--feedback")] = None,
    order: FilterOrder = 2,
    search: Search = USUAL,
) -> Any:
    """Worst L2 gain of a loop with the plant's effects as nonlinearities, beside that of constant gains.

    It is what ``iqc gain`` does for a plant with effects.
    """
    from robustlab.closing import closing

    base = getattr(getattr(plant, "plant", None), "state_space", None)
    if base is not None:
        sign = closing(base().select(None, outputs), controller, sign, "effects", None).sign
    return rl.peak_gain(
        plant, controller, outputs=outputs, amplitude=amplitude, stick_speed=stick_speed, sign=sign, order=order,
        **search.options,
    )  # fmt: skip


@door("iqc anti-windup", "anti-windup", result="synthesis.windup.static_anti_windup.AntiWindup")
def anti_windup(
    plant: Annotated[Model, "The plant; u and y are its last inputs and outputs.", Named(key="of")],
    controller: Annotated[Any, Thing(("controller", "any"), model=True), "Controller u = K y."],
    limits: Annotated[
        dict[str, tuple[float, float]] | None,
        Table(Numbers(count=2), words="NAME=LOW:HIGH"),
        "Limits of each control signal; -1:1 where left out.",
        Named(option="--saturation"),
    ] = None,
    reach: Annotated[
        float, Number(above=1), "Bound of the demanded signal as a multiple of its limit; where the plant is unstable."
    ] = math.inf,
    direct: Annotated[
        bool, Flag(), "Correct the outputs too, an algebraic loop.", Named(option="--correct-outputs")
    ] = False,
    dt: Annotated[
        float | None, Number(above=0), "With --code: sample time in s of what is written.", Named(only="command")
    ] = None,
    code: Annotated[
        str | None, Kind(), "C file to write: the controller held, with its gain.", Named(only="command")
    ] = None,
    order: FilterOrder = 2,
    search: Search = USUAL,
) -> Any:
    """Static anti-windup gain of least proved L2 gain, beside back-calculation and none.

    Example: robustlab iqc anti-windup motor.h5 pi.h5 --saturation u=-10:10 --out windup.h5
    """
    from robustlab.signals import law

    unknown = [name for name in limits or {} if name not in controller.output_names]
    if unknown:
        expected = f"one of {', '.join(controller.output_names)}"
        raise UsageError(f"--saturation {unknown[0]}", "no such control signal", expected)
    if (code is None) != (dt is None):
        raise UsageError("iqc anti-windup", "one of --code and --dt", "both, or none")
    pairs = [(limits or {}).get(name, (-1.0, 1.0)) for name in controller.output_names]
    found = rl.anti_windup(plant, controller, pairs, reach, direct, order=order, **search.options)
    words = (
        f"{law(controller.inputs)}, as the controller says"
        if law(controller.inputs)
        else "u = K y; nothing else is said of it"
    )
    if code is not None and dt is not None:
        held, back = found.sampled(dt)
        saturation = dict(zip(controller.output_names, pairs, strict=True))
        rl.export_controller(code, held, saturation=saturation, anti_windup=back)
        return InLoop(found, words, beside={"written": code})
    return InLoop(found, words)
