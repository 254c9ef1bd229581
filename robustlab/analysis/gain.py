"""Peak gain of any kind of system."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from robustlab.analysis.kinds import DELAYED, EFFECTS, FREQUENCIES, LPV, MODEL, NATURES, SET, ask, kind_of
from robustlab.delays.model import DelayedModel
from robustlab.errors import InputError, error_context
from robustlab.linear_analysis.structural import with_hidden
from robustlab.norms import PeakGain, hinf_norm, linf_norm
from robustlab.statespace import StateSpaceModel, as_model
from robustlab.uncertainty.frequency_responses import UncertainFrequencyData
from robustlab.uncertainty.lft import UncertainModel

KINDS = {
    MODEL: ("analysis.gain.gain_of_model", "norm band inputs outputs tolerance"),
    DELAYED: (
        "mu_analysis.margins.delay_margins.delay_gain", "inputs outputs effort"),
    SET: ("mu_analysis.worst_case_gain", "inputs outputs omega tolerance seed effort time_limit"),
    FREQUENCIES: ("mu_analysis.margins.at_frequencies.worst_case_gain_at", "frequency inputs outputs seed"),
    NATURES: ("iqc.analysis.iqc_gain", "natures=nature inputs outputs order pole effort time_limit"),
    LPV: ("synthesis.scheduling.induced_gain.lpv_gain", "lyapunov effort time_limit"),
    EFFECTS: (
        "iqc.effect_gain_bounds.effect_gain",
        "controller outputs amplitude stick_speed sign order effort time_limit"),
}  # fmt: skip
HINTS = {
    "controller": "close the loop first: G.feedback(K)",
    "band": "frequency= asks at points; a band-pass weight, weight @ G, asks about a band",
    "norm": "frequency= asks at points of what may be unstable",
    "omega": "frequency= asks at points",
    "inputs": "take the channels first: G.select(inputs, outputs)",
    "outputs": "take the channels first: G.select(inputs, outputs)",
}


@error_context("peak_gain")
def peak_gain(
    system: Any,
    controller: Any = None,
    *,
    norm: Literal["hinf", "linf"] | None = None,
    band: tuple[float, float] | None = None,
    frequency: ArrayLike | None = None,
    natures: Mapping[Any, Any] | None = None,
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

    Parameters
    ----------
    system
        A model or a DelayedModel (H-infinity norm, infinite where unstable); an UncertainModel (worst case over all
        :math:`|\Delta| \le 1`); UncertainFrequencyData; an LPVModel (induced L2 gain over all trajectories); a plant
        with effects (`with_effects`): worst L2 gain of ``e = d + sign K y, y = G(e)`` from d to y.
    controller, sign, amplitude, stick_speed
        Of a plant with effects: K; -1 for negative feedback, 1 for positive, by default as stated by K, else negative;
        place -> assumed bound of its signal; joint -> speed below which dry friction is proportional to the speed.
    norm, band
        Of a model: ``"linf"``, the peak over the axis of what may be unstable; (low, high) in rad/s: the peak there.
    frequency
        Frequencies in rad/s of the largest gain, without any claim between them; a stable nominal system is assumed.
    natures, order, pole
        Name of a block -> `Varying` or `Nonlinearity`, or (output, input) -> `Nonlinearity`, a law that drives that
        input, by integral quadratic constraints with filters ``a / (s + a)`` up to this power (0..8) and with this a in
        rad/s.
    inputs, outputs
        Names of the channels, all by default; ``outputs`` of a plant with effects: the inputs of K, in its order.
    omega, tolerance
        Of an uncertain model: frequencies in rad/s of a figure's curves. Relative gap of the bounds: 1e-6 of a model,
        0.01 with delays or uncertainty; inf: no branch and bound.
    lyapunov
        Of an LPV model: ``"constant"`` (any rate) or ``"varying"``, the default where a rate is bounded.
    seed, effort, time_limit
        Seed of the searches; their work as a multiple of the usual; s, after which the result depends on the machine.

    Returns
    -------
    PeakGain
        Both bounds, and the evidence of the kind of system: `HinfNorm`, `DelayGain`, `WorstCaseGain`, `GainAt`,
        `IqcGain`, `LPVGain`, `EffectGain`.

    Raises
    ------
    InputError, NoTrustworthyNumber
        An option that this kind of system does not have, a value out of range, no such signal or block. The nominal
        model of a set is unstable, or a pole is at a frequency.

    References
    ----------
    Boyd, Balakrishnan 1990; Fan, Tits 1992; Packard, Balas, Liu, Shin 2000; Megretski, Rantzer 1997; Wu, Yang, Packard,
    Becker 1996.

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
    kind = kind_of(given.pop("system"), natures=natures, frequency=frequency)
    if kind in (MODEL, DELAYED, SET, FREQUENCIES):
        system = _selected(system, given.pop("inputs"), given.pop("outputs"))
    return ask("peak_gain", KINDS, kind, (system,), given, HINTS)


def _selected(system: Any, inputs: Sequence[str] | None, outputs: Sequence[str] | None) -> Any:
    """Return the system with these channels."""
    if isinstance(system, UncertainFrequencyData):
        ins, outs = ([s.name for s in side] for side in (system.inputs, system.outputs))
        return system[outs if outputs is None else list(outputs), ins if inputs is None else list(inputs)]
    known = isinstance(system, (StateSpaceModel, UncertainModel, DelayedModel))
    model = system if known else as_model(system, "peak_gain")
    return model if inputs is None and outputs is None else model.select(inputs, outputs)


def gain_of_model(
    model: StateSpaceModel, norm: str | None = None, band: Any = None, tolerance: float = 1e-6
) -> PeakGain:
    """Compute `peak_gain` of a model."""
    if norm not in (None, "hinf", "linf"):
        raise InputError("peak_gain: norm", f"{norm!r}", "'hinf' or 'linf'")
    if norm == "hinf" and band is not None:
        raise InputError("peak_gain: band", "given with norm='hinf'", "norm='linf': the peak in the band")
    found = hinf_norm(model, tolerance) if band is None and norm != "linf" else linf_norm(model, tolerance, band=band)
    return replace(found, reason=with_hidden(found.reason, model)) if np.isinf(found.lower) else found
