"""Gains and margins of any kind of system: the method of each kind is in its own package.

A table of a question has a row for each kind of system: the method, imported on first use, and its options.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from importlib import import_module
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from robustlab.delays.model import DelayedModel
from robustlab.display import listed
from robustlab.errors import InputError, error_context
from robustlab.linear_analysis.structural import with_hidden
from robustlab.mu_analysis.axis.margin import StabilityMargin
from robustlab.mu_analysis.margins.classical import ClassicalMargins
from robustlab.mu_analysis.margins.disk_margin import DiskMargins, Place
from robustlab.norms import PeakGain, hinf_norm, linf_norm
from robustlab.statespace import StateSpaceModel, as_model
from robustlab.uncertainty.frequency_responses import UncertainFrequencyData
from robustlab.uncertainty.lft import UncertainModel

MODEL, SET, DELAYED = "a model", "an uncertain model", "a model with exact delays"
BLOCK_TYPES, FREQUENCIES, LPV, EFFECTS = (
    "blocks with types",
    "given frequencies",
    "an LPV model",
    "a plant with effects",
)

OWN = "mu_analysis.margins."
GAIN = {
    MODEL: ("analysis.gains_and_margins.gain_of_model", "norm band inputs outputs tolerance"),
    DELAYED: (f"{OWN}delayed_models.delay_gain", "inputs outputs effort"),
    SET: ("mu_analysis.worst_case_gain", "inputs outputs omega tolerance seed effort time_limit"),
    FREQUENCIES: (f"{OWN}at_frequencies.worst_case_gain_at", "frequency inputs outputs seed"),
    BLOCK_TYPES: ("iqc.analysis.iqc_gain", "block_types inputs outputs order pole effort time_limit"),
    LPV: ("synthesis.scheduling.scheduled_synthesis.lpv_gain", "lyapunov effort time_limit"),
    EFFECTS: (
        "iqc.analysis.effect_gain", "controller outputs amplitude stick_speed sign order effort time_limit"
    ),
}  # fmt: skip
OF_SET = ("mu_analysis.axis.robustness.robust_stability", "omega tolerance accuracy seed effort time_limit")
STABILITY = {
    MODEL: OF_SET,
    SET: OF_SET,
    DELAYED: (f"{OWN}delayed_models.delay_stability", "effort"),
    FREQUENCIES: (f"{OWN}at_frequencies.robust_stability_at", "frequency seed"),
    BLOCK_TYPES: ("iqc.analysis.iqc_stability", "block_types order pole effort time_limit"),
}
DISK = {
    MODEL: (f"{OWN}disk_margin.disk_margin", "at skew sign seed effort time_limit"),
    DELAYED: (f"{OWN}delayed_models.delay_disk_margins", "at skew sign seed effort"),
    FREQUENCIES: (f"{OWN}at_frequencies.disk_margin_at", "frequency at skew sign seed"),
}
CLASSICAL = {
    MODEL: (f"{OWN}classical.classical_margins", "at sign"),
    DELAYED: (f"{OWN}delayed_models.delay_classical_margins", "at sign"),
}
# Of an option of `peak_gain`, and of a kind that lacks an option of a margin.
GAIN_HINTS = {
    "controller": "close the loop first: G.feedback(K)",
    "band": "frequency= asks at points; a band-pass weight, weight @ G, asks about a band",
    "norm": "frequency= asks at points of what may be unstable",
    "omega": "frequency= asks at points",
    "inputs": "take the channels first: G.select(inputs, outputs)",
    "outputs": "take the channels first: G.select(inputs, outputs)",
}
HINTS = {
    DELAYED: ".uncertain(order) makes a set of it", FREQUENCIES: "leave the frequencies out for the whole axis"
}  # fmt: skip


def kind_of(*systems: Any, block_types: Any = None, frequency: Any = None) -> str:
    if block_types is not None:
        return BLOCK_TYPES
    if frequency is not None or any(isinstance(one, UncertainFrequencyData) for one in systems):
        return FREQUENCIES
    if any(isinstance(one, DelayedModel) for one in systems):
        return DELAYED
    if any(isinstance(one, UncertainModel) for one in systems):
        return SET
    if not isinstance(systems[0], StateSpaceModel):
        # These packages load slowly and are rarely needed.
        from robustlab.dynamics.extended.extended_plant import ExtendedPlant
        from robustlab.synthesis.scheduling.parameter_varying import LPVModel

        return LPV if isinstance(systems[0], LPVModel) else EFFECTS if isinstance(systems[0], ExtendedPlant) else MODEL
    return MODEL


def ask(
    question: str, kinds: Mapping[str, tuple[str, str]], kind: str, systems: tuple[Any, ...], given: Mapping[str, Any],
    hints: Mapping[str, str], **common: Any,
) -> Any:  # fmt: skip
    """Call the method of a kind with the options that were given (not None); reject those that it does not have.

    ``common``: passed where the method has them. ``hints``: of an option, or of a kind.
    """
    method, options = kinds.get(kind, kinds[MODEL])  # which says what it expects
    chosen = {name: value for name, value in common.items() if name in options.split()}
    for name, value in given.items():
        if value is None:
            continue
        if name not in options.split():
            having = listed((k for k, (_, text) in kinds.items() if name in text.split()), len(kinds))
            hint = hints.get(name) or hints.get(kind)
            raise InputError(f"{question}: {name}", f"given for {kind}", f"it for {having}", hint)
        chosen[name] = value
    module, _, function = method.rpartition(".")
    return getattr(import_module(f"robustlab.{module}"), function)(*systems, **chosen)


@error_context("peak_gain")
def peak_gain(
    system: Any,
    controller: Any = None,
    *,
    norm: Literal["hinf", "linf"] | None = None,
    band: tuple[float, float] | None = None,
    frequency: ArrayLike | None = None,
    block_types: Mapping[Any, Any] | None = None,
    inputs: Sequence[str] | None = None,
    outputs: Sequence[str] | None = None,
    omega: ArrayLike | None = None,
    tolerance: float | None = None,
    seed: int | None = None,
    effort: float | None = None,
    time_limit: float | None = None,
    order: int | None = None,
    pole: float | None = None,
    lyapunov: Literal["constant", "varying"] | None = None,
    amplitude: Mapping[str, float] | None = None,
    stick_speed: Mapping[str, float] | None = None,
    sign: int | None = None,
) -> PeakGain:
    r"""Largest gain of a system, as two bounds: one is attained, the other is proved.

    .. math:: \|G\|_\infty = \sup_\omega \sigma_{max}(G(j\omega)), \qquad
       \sup_{\Delta} \sup_{u \ne 0} \frac{\|y\|_2}{\|u\|_2} \quad
       \text{where the system is uncertain, varies with time or is not linear}

    Boyd, Balakrishnan 1990; Fan, Tits 1992; Packard, Balas, Liu, Shin 2000; Megretski, Rantzer 1997; Wu, Yang, Packard,
    Becker 1996.

    Parameters
    ----------
    system
        A model or a DelayedModel (H-infinity norm, infinite where unstable); an UncertainModel (worst case over all
        :math:`|\Delta| \le 1`); UncertainFrequencyData; an LPVModel (induced L2 gain over all trajectories); a plant
        with effects (`with_effects`): worst L2 gain of ``e = d + sign K y, y = G(e)`` from d to y.
    controller, sign, amplitude, stick_speed
        Of a plant with effects: K; -1 for negative feedback, 1 for positive, by default as stated by K, else negative;
        place -> assumed bound of its signal; joint -> speed below which dry friction is proportional to the speed.
    norm, band, frequency
        Of a model: ``"linf"``, the peak over the axis of what may be unstable; (low, high) in rad/s: the peak there.
        Frequencies in rad/s of the largest gain, without any claim between them; a stable nominal system is assumed.
    block_types, order, pole
        Name of a block -> `Varying` or `Nonlinearity`, or (output, input) -> `Nonlinearity`, a law that drives that
        input, by integral quadratic constraints with filters ``a / (s + a)`` up to this power (0..8) and with this a in
        rad/s.
    inputs, outputs
        Names of the channels, all by default; ``outputs`` of a plant with effects: the inputs of K, in its order.
    omega, tolerance, lyapunov
        Of an uncertain model: frequencies in rad/s of a figure's curves. Relative gap of the bounds: 1e-6 of a model,
        0.01 with delays or uncertainty; inf: no branch and bound. Of an LPV model: ``"constant"`` (any rate) or
        ``"varying"``, the default where a rate is bounded.
    seed, effort, time_limit
        Seed of the searches; their work as a multiple of the usual; s, after which the result depends on the machine.

    Returns
    -------
    PeakGain
        Both bounds, and the evidence of the kind of system: `HinfNorm`, `DelayGain`, `WorstCaseGain`, `GainAt`,
        `IqcGain`, `LPVGain`.

    Raises
    ------
    InputError, NoTrustworthyNumber
        An option that this kind of system does not have, a value out of range, no such signal or block. The nominal
        model of a set is unstable, or a pole is at a frequency.

    Examples
    --------
    >>> import robustlab as rl
    >>> norm = rl.peak_gain(rl.tf([3.0], [0.5, 1.0]))
    >>> norm.value, norm.frequency, norm.status.value
    (3.0, 0.0, 'certified')
    >>> M = rl.StateSpaceModel([[-1.0]], [[-0.5, 1.0]], [[1.0], [1.0]], [[0.0, 0.0], [0.0, 0.0]])
    >>> uncertain = rl.UncertainModel(M, [rl.RealScalar("pole")])
    >>> round(rl.peak_gain(uncertain).lower, 6), round(rl.peak_gain(uncertain, frequency=[1.0]).upper, 4)
    (2.0, 0.8944)
    """
    given = dict(locals())
    kind = kind_of(given.pop("system"), block_types=block_types, frequency=frequency)
    if kind in (MODEL, DELAYED, SET, FREQUENCIES):
        system = _selected(system, given.pop("inputs"), given.pop("outputs"))
    return ask("peak_gain", GAIN, kind, (system,), given, GAIN_HINTS)


def _selected(system: Any, inputs: Sequence[str] | None, outputs: Sequence[str] | None) -> Any:
    if isinstance(system, UncertainFrequencyData):
        ins, outs = ([s.name for s in side] for side in (system.inputs, system.outputs))
        return system[outs if outputs is None else list(outputs), ins if inputs is None else list(inputs)]
    known = isinstance(system, (StateSpaceModel, UncertainModel, DelayedModel))
    model = system if known else as_model(system, "peak_gain")
    return model if inputs is None and outputs is None else model.select(inputs, outputs)


def gain_of_model(
    model: StateSpaceModel, norm: str | None = None, band: Any = None, tolerance: float = 1e-6
) -> PeakGain:
    if norm not in (None, "hinf", "linf"):
        raise InputError("peak_gain: norm", f"{norm!r}", "'hinf' or 'linf'")
    if norm == "hinf" and band is not None:
        raise InputError("peak_gain: band", "given with norm='hinf'", "norm='linf': the peak in the band")
    found = hinf_norm(model, tolerance) if band is None and norm != "linf" else linf_norm(model, tolerance, band=band)
    return replace(found, reason=with_hidden(found.reason, model)) if np.isinf(found.lower) else found


@error_context("robust_stability")
def robust_stability(
    system: Any,
    *,
    block_types: Mapping[Any, Any] | None = None,
    frequency: ArrayLike | None = None,
    omega: ArrayLike | None = None,
    tolerance: float | None = None,
    accuracy: float | None = None,
    order: int | None = None,
    pole: float | None = None,
    seed: int = 0,
    effort: float = 1.0,
    time_limit: float | None = None,
) -> StabilityMargin:
    r"""Robust stability margin: the system is stable for all Delta of norm below ``lower``.

    .. math:: k = 1 / \sup_\omega \mu(M_{11}(j \omega))

    Of an uncertain model ``lower`` is proved on the whole axis, in floating point with a slack of 5e-6 in mu; ``upper``
    is attained by the member ``delta``, which has a pole on the stability boundary. A range that is wider on one side
    grows in proportion on both. With exact delays: whether the system is stable, by a set that holds it. Doyle 1982;
    Sideris 1992; Newlin, Young 1997; Megretski, Rantzer 1997; Zhou, Doyle, Glover 1996, chapter 11.

    Parameters
    ----------
    system
        An UncertainModel, with ``block_types`` also a model, a DelayedModel, or UncertainFrequencyData.
    block_types, order, pole
        As in `peak_gain`: blocks that vary or are nonlinear. Empty: the same proof of constant blocks.
    frequency
        Frequencies in rad/s of the margins, without any claim between them; a stable nominal system is assumed.
    omega, tolerance, accuracy
        Of an uncertain model: frequencies in rad/s for ``mu_lower`` and ``mu_upper``, the curves of a figure; relative
        gap for branch and bound (0.01; inf: none); relative distance to the best margin that D, G can prove (3e-5).
    seed, effort, time_limit
        As in `peak_gain`.

    Returns
    -------
    StabilityMargin
        Both bounds with status and evidence: a `Margin`, an `IqcStability` with block types, a `MarginAt` at
        frequencies, a `DelayStability` with delays.

    Raises
    ------
    InputError, NoTrustworthyNumber
        No uncertainty at frequencies, no such block, an option that this kind of system does not have. The nominal
        model is unstable; a pole is at a given frequency.

    Examples
    --------
    >>> import robustlab as rl
    >>> M = rl.StateSpaceModel([[-1.0]], [[-0.5]], [[1.0]], [[0.0]])
    >>> pole = rl.UncertainModel(M, [rl.RealScalar("pole")])  # s + 1 + 0.5 delta
    >>> found = rl.robust_stability(pole)
    >>> found.stable, round(found.upper, 6), round(rl.robust_stability(pole, frequency=[1.0]).lower, 6)
    (True, 2.0, inf)
    """
    given = dict(locals())
    for name in ("system", "seed", "effort"):
        del given[name]
    kind = kind_of(system, block_types=block_types, frequency=frequency)
    return ask("robust_stability", STABILITY, kind, (system,), given, HINTS, seed=seed, effort=effort)


@error_context("disk_margin")
def disk_margin(
    plant: Any,
    K: Any = None,
    *,
    at: Place = "output",
    frequency: ArrayLike | None = None,
    skew: float = 0.0,
    sign: Literal[-1, 1] | None = None,
    seed: int = 0,
    effort: float = 1.0,
    time_limit: float | None = None,
) -> DiskMargins:
    r"""Disk margins of the loop ``y = P u``, ``u = sign K y``, one loop at a time and all loops at once.

    .. math:: \alpha = 1 / \sup_\omega \mu\left( S(j\omega) + \tfrac{\sigma - 1}{2} I \right), \qquad S = (I + L)^{-1}

    Each loop is multiplied by a complex factor of the disk (Seiler, Packard, Gahinet, "An introduction to disk
    margins", IEEE Control Systems Magazine 40, 2020, equations 9-17)

    .. math:: f = \frac{1 + \frac{1 - \sigma}{2} \delta}{1 - \frac{1 + \sigma}{2} \delta}, \qquad |\delta| < \alpha .

    Parameters
    ----------
    plant, K
        Plant (p outputs, m inputs) and controller (m outputs, p inputs, or signals with names that the plant has), or
        the open loop L alone: models, either with exact delays, or UncertainFrequencyData without blocks.
    at
        Where the factors act: on the plant's outputs, its inputs, or both at once.
    frequency
        Frequencies in rad/s of the margins, without any claim between them. Data have their own.
    skew
        sigma: 0 balanced, positive if the gain is more likely to rise, negative if it is more likely to fall.
    sign
        -1 for negative feedback, 1 for positive; by default as stated by the controller, else negative.
    seed, effort, time_limit
        As in `peak_gain`.

    Returns
    -------
    DiskMargins
        ``lower`` proved and ``upper`` attained, of all loops at once; ``channels`` by the name of the plant's signal.

    Raises
    ------
    InputError, NoTrustworthyNumber
        Sizes, names or sample times that do not fit; a sign that contradicts the controller; an option that this kind
        of loop does not have. The nominal loop is unstable, or not proved stable; a pole is at a given frequency.

    Examples
    --------
    >>> import robustlab as rl
    >>> margin = rl.disk_margin(rl.tf([0.5, -0.5], [1, 1]))
    >>> round(margin.lower, 6), [round(g, 6) for g in margin.gain_margin]
    (0.666667, [0.5, 2.0])
    """
    kind = kind_of(plant, getattr(K, "K", K), frequency=frequency)
    if kind == SET and isinstance(plant, UncertainModel):
        if plant.blocks:
            hint = "robust_stability of the set with a disk block in its loop proves it for all (docs/analysis.md)"
            raise InputError("disk_margin: plant", "an UncertainModel", "one model, such as .nominal", hint)
        plant = plant.nominal
    given = {"frequency": frequency, "time_limit": time_limit}
    common: dict[str, Any] = {"at": at, "skew": skew, "sign": sign, "seed": seed, "effort": effort}
    return ask("disk_margin", DISK, kind, (plant, K), given, HINTS, **common)


@error_context("classical_margins")
def classical_margins(
    plant: Any, K: Any = None, *, at: Place = "output", sign: Literal[-1, 1] | None = None
) -> ClassicalMargins:
    r"""Gain, phase and delay margins of the loop ``y = P u``, ``u = sign K y``, one loop at a time, with all crossings.

    .. math:: |L(j\omega)| = 1, \qquad L(j\omega) < 0

    Each loop is opened alone, with the others closed. Crossings are computed in whole numbers from the matrices as
    given, without a grid; with delays they are found on a grid that is dense for the poles and the delays. Skogestad,
    Postlethwaite, *Multivariable Feedback Control*, section 2.4.

    Parameters
    ----------
    plant, K, sign, at
        As in `disk_margin`; no data. Loops are opened at the plant's outputs, its inputs, or both in turn.

    Returns
    -------
    ClassicalMargins
        One `ClassicalMargin` per channel by the name of the plant's signal. With delays there may be infinitely many
        crossings: they are listed up to the one that bounds the gain margin, factors from 1e-6 to 1000.

    Raises
    ------
    InputError, NoTrustworthyNumber
        As `disk_margin`; an uncertain plant, a loop whose gain is 1 at every frequency, more than 200 states; with
        delays a loop whose falling gain could not be shown.

    Examples
    --------
    >>> import robustlab as rl
    >>> margin = rl.classical_margins(rl.tf([3], [1, 3, 2, 0]))  # 3 / (s (s + 1) (s + 2))
    >>> round(margin.gain_high, 9), round(margin.channels["y1"].phase_crossings[0].frequency ** 2, 9)
    (2.0, 2.0)
    """
    kind = kind_of(plant, getattr(K, "K", K))
    if kind in (SET, FREQUENCIES):
        found = "an uncertain plant, or data"
        raise InputError("classical_margins", found, "one model", "rl.disk_margin is that of the worst member")
    return ask("classical_margins", CLASSICAL, kind, (plant, K), {}, HINTS, at=at, sign=sign)
