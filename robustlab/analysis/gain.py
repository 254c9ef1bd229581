"""Peak gain of a model, one with delays, an uncertain or a scheduled one, a plant with effects, or data."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from robustlab.delays.model import DelayedModel
from robustlab.display import listed
from robustlab.errors import InputError, error_context
from robustlab.linear_analysis.structural import with_hidden
from robustlab.norms import PeakGain
from robustlab.statespace import StateSpaceModel, as_model
from robustlab.uncertainty.frequency_responses import UncertainFrequencyData
from robustlab.uncertainty.lft import UncertainModel

Natures = Mapping[Any, Any]  # name of a block, or (output, input) -> `Varying` or `Nonlinearity`
Norm = Literal["hinf", "linf"]
Lyapunov = Literal["constant", "varying"]

# Type of problem -> its options; the error for another one lists the types that have it.
OPTIONS: Mapping[str, tuple[str, ...]] = {
    "a model": ("norm", "band", "inputs", "outputs", "tolerance"),
    "a model with delays": ("inputs", "outputs", "effort"),
    "an uncertain model": ("inputs", "outputs", "omega", "tolerance", "seed", "effort", "time_limit"),
    "given frequencies": ("frequency", "inputs", "outputs", "seed"),
    "blocks with natures": ("natures", "inputs", "outputs", "order", "pole", "effort", "time_limit"),
    "an LPV model": ("lyapunov", "effort", "time_limit"),
    "a plant with effects": (
        "controller", "outputs", "amplitude", "stick_speed", "sign", "order", "effort", "time_limit"
    ),
}  # fmt: skip
# Hints for options that a type does not have.
WAYS = {
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
    norm: Norm | None = None,
    band: tuple[float, float] | None = None,
    frequency: ArrayLike | None = None,
    natures: Natures | None = None,
    inputs: Sequence[str] | None = None,
    outputs: Sequence[str] | None = None,
    omega: ArrayLike | None = None,
    tolerance: float | None = None,
    seed: int | None = None,
    effort: float | None = None,
    time_limit: float | None = None,
    order: int | None = None,
    pole: float | None = None,
    lyapunov: Lyapunov | None = None,
    amplitude: Mapping[str, float] | None = None,
    stick_speed: Mapping[str, float] | None = None,
    sign: int | None = None,
) -> PeakGain:
    r"""Largest gain of a system, as two bounds: one is attained, the other is proved.

    .. math:: \|G\|_\infty = \sup_\omega \sigma_{max}(G(j\omega)), \qquad
       \sup_{\Delta} \sup_{u \ne 0} \frac{\|y\|_2}{\|u\|_2} \quad
       \text{where the system is uncertain, varies with time or is not linear}

    ==============================  ==================================================================================
    system                          bounded quantity
    ==============================  ==================================================================================
    model                           H-infinity norm, infinite where it is unstable; with ``band`` or ``norm="linf"`` the
                                    peak over the frequency axis (L-infinity norm), which bounds no signals of an
                                    unstable model
    DelayedModel                    the same with its exact delays
    UncertainModel                  worst case over all :math:`|\Delta| \le 1`
    any of these, ``frequency``;    largest gain at these frequencies, without any claim between them; a stable nominal
    UncertainFrequencyData          system is assumed
    UncertainModel or model,        worst L2 gain with blocks that vary with time or are not linear, by integral
    ``natures``                     quadratic constraints
    LPVModel                        induced L2 gain over all trajectories of the parameters
    plant with effects              worst L2 gain of ``e = d + sign K y, y = G(e)`` from disturbances d at its inputs to
    (`with_effects`), `controller`  its outputs y, each effect with its own type
    ==============================  ==================================================================================

    Parameters
    ----------
    system
        System, continuous or discrete (with natures and effects continuous), of any size.
    controller
        K of a plant with effects: a model, a `Controller`, a matrix or a number. Close the loop of any other system
        first.
    norm
        Of a model: ``"hinf"``, or ``"linf"``: the peak over the axis of one that may be unstable.
    band
        Of a model: ``(low, high)`` in rad/s, ends included; the peak there, proved for every frequency in it.
    frequency
        Frequencies in rad/s, shape (N,). Data have their own.
    natures
        Name of a block -> `Varying` or `Nonlinearity`; or (output, input) -> `Nonlinearity`, which drives that input
        with a law of that output. Other blocks are as in the uncertain model. The sector of a `Nonlinearity` of a real
        block must be the range of the block.
    inputs, outputs
        Names of the channels; all by default, with natures those that no block drives. ``outputs`` of a plant with
        effects are the inputs of K, in its order.
    omega
        Of an uncertain model: frequencies in rad/s for the curves of a figure.
    tolerance
        Target of the relative gap of the bounds: 1e-6 of a model, 0.01 with delays or uncertainty, where inf means no
        branch and bound.
    seed
        Seed of the search for the worst member; 0 by default.
    effort
        Work of the proof as a multiple of the usual; counted, not timed.
    time_limit
        Time limit in s of the proof. If it is reached, the status is TIMEOUT and the result depends on the machine.
    order
        With natures and effects: highest power of the multipliers' filters ``a / (s + a)``, 0..8, 2 by default; 0:
        static multipliers.
    pole
        With natures: a in rad/s; several, by the poles of the model, are tried by default.
    lyapunov
        Of an LPV model: ``"constant"``, one P for parameters of any rate, or ``"varying"``, P multi-linear along the
        parameters whose rates are bounded; by default varying where a rate is bounded.
    amplitude
        Of a plant with effects: place -> bound of its signal. A sector that is local holds while the signal stays
        within it.
    stick_speed
        Of a plant with effects: joint -> speed below which its dry friction grows in proportion to the speed.
    sign
        Of a plant with effects: -1 for negative feedback, 1 for positive; by default as stated by the controller, else
        negative.

    Returns
    -------
    PeakGain
        ``lower``, ``upper``, ``frequency``, ``status``, and the evidence of the type of system: `HinfNorm`,
        `DelayGain`, `WorstCaseGain`, `GainAt`, `IqcGain`, `LPVGain`, `EffectGain`.

    Raises
    ------
    InputError
        No system of these types, an option that it does not have, a value out of range, no such signal or block.
    NoTrustworthyNumber
        The nominal model of a set is unstable, a pole is at a frequency, or the norm is larger than the largest
        floating-point number.

    References
    ----------
    Boyd, Balakrishnan 1990; Bruinsma, Steinbuch 1990 (a model). Fan, Tits 1992; Packard, Balas, Liu, Shin 2000 (an
    uncertain one). Megretski, Rantzer 1997; Veenman, Scherer, Köroğlu 2016 (natures). Becker, Packard 1994; Wu, Yang,
    Packard, Becker 1996; Apkarian, Tuan 2000; Rump 2006 (LPV).

    Examples
    --------
    A model, and an unstable one:

    >>> import robustlab as rl
    >>> norm = rl.peak_gain(rl.tf([3.0], [0.5, 1.0]))
    >>> norm.value, norm.frequency, norm.status.value
    (3.0, 0.0, 'certified')
    >>> runaway = rl.tf([6.0], [1.0, -2.0])
    >>> rl.peak_gain(runaway).upper, rl.peak_gain(runaway, norm="linf").value
    (inf, 3.0)

    An uncertain one, at all frequencies and at one:

    >>> M = rl.StateSpaceModel([[-1.0]], [[-0.5, 1.0]], [[1.0], [1.0]], [[0.0, 0.0], [0.0, 0.0]])
    >>> uncertain = rl.UncertainModel(M, [rl.RealScalar("pole")])
    >>> worst = rl.peak_gain(uncertain)
    >>> round(worst.lower, 6), worst.delta["pole"]
    (2.0, -1.0)
    >>> round(rl.peak_gain(uncertain, frequency=[1.0]).upper, 4)
    0.8944

    With exact delays; with a saturation fed back, 1 / (s + 1); over all trajectories of a parameter:

    >>> lag = rl.tf([1.0], [1.0, 1.0])
    >>> round(rl.peak_gain((2.0 * lag @ rl.delay(0.5)).feedback()).lower, 4)
    1.3201
    >>> plant = rl.StateSpaceModel([[-1.0]], [[-1.0, 1.0]], [[1.0]], [[0.0, 0.0]], 0, ["v", "d"], ["y"])
    >>> found = rl.peak_gain(plant, natures={("y", "v"): rl.Nonlinearity.saturation()})
    >>> round(found.lower, 4), round(found.upper, 4)
    (1.0, 1.0)
    >>> slow, fast = (rl.StateSpaceModel([[-a]], [[a]], [[1.0]], [[0.0]]) for a in (1.0, 4.0))
    >>> found = rl.peak_gain(rl.LPVModel({"a": [1.0, 4.0]}, [slow, fast]))
    >>> found.status.value, round(found.lower, 3), round(found.upper, 3)
    ('certified', 1.0, 1.25)
    """
    named = {
        "controller": controller, "norm": norm, "band": band, "frequency": frequency, "natures": natures,
        "inputs": inputs, "outputs": outputs, "omega": omega, "tolerance": tolerance, "seed": seed, "effort": effort,
        "time_limit": time_limit, "order": order, "pole": pole, "lyapunov": lyapunov, "amplitude": amplitude,
        "stick_speed": stick_speed, "sign": sign,
    }  # fmt: skip
    given = {name: value for name, value in named.items() if value is not None}
    kind, method = _kind(system, given)
    for name in given:
        if name not in OPTIONS[kind]:
            having = listed((other for other, names in OPTIONS.items() if name in names), len(OPTIONS))
            raise InputError(f"peak_gain: {name}", f"given for {kind}", f"it for {having}", WAYS.get(name))
    return method(system, **given)


Method = Callable[..., PeakGain]


def _kind(system: Any, given: Mapping[str, Any]) -> tuple[str, Method]:
    """Return the type of problem, a key of `OPTIONS`, and its method."""
    if not isinstance(system, (StateSpaceModel, UncertainModel, DelayedModel, UncertainFrequencyData)):
        # These packages load slowly and are rarely needed.
        from robustlab.dynamics.extended.extended_plant import ExtendedPlant
        from robustlab.synthesis.scheduling.parameter_varying import LPVModel

        if isinstance(system, LPVModel):
            return "an LPV model", _scheduled
        if isinstance(system, ExtendedPlant):
            return "a plant with effects", _with_effects
    if "natures" in given:
        return "blocks with natures", _with_natures
    if "frequency" in given or isinstance(system, UncertainFrequencyData):
        return "given frequencies", _at_frequencies
    if isinstance(system, DelayedModel):
        return "a model with delays", _delayed
    if isinstance(system, UncertainModel):
        return "an uncertain model", _worst_case
    return "a model", _of_model


def _of_model(
    system: Any, norm: str | None = None, band: Any = None, inputs: Any = None, outputs: Any = None,
    tolerance: float = 1e-6,
) -> PeakGain:  # fmt: skip
    from robustlab.norms import hinf_norm, linf_norm

    if norm not in (None, "hinf", "linf"):
        raise InputError("peak_gain: norm", f"{norm!r}", "'hinf' or 'linf'")
    if norm == "hinf" and band is not None:
        raise InputError("peak_gain: band", "given with norm='hinf'", "norm='linf': the peak in the band")
    model = as_model(system, "peak_gain")
    if inputs is not None or outputs is not None:
        model = model.select(inputs, outputs)
    found = hinf_norm(model, tolerance) if band is None and norm != "linf" else linf_norm(model, tolerance, band=band)
    return replace(found, reason=with_hidden(found.reason, model)) if np.isinf(found.lower) else found


def _delayed(system: DelayedModel, inputs: Any = None, outputs: Any = None, effort: float = 1.0) -> PeakGain:
    from robustlab.mu_analysis.margins.delay_margins import delay_gain

    return delay_gain(system.select(inputs, outputs), effort)


def _worst_case(system: UncertainModel, inputs: Any = None, outputs: Any = None, **options: Any) -> PeakGain:
    from robustlab.mu_analysis import worst_case_gain

    chosen = system if inputs is None and outputs is None else system.select(inputs, outputs)
    return worst_case_gain(chosen, **options)


def _at_frequencies(
    system: Any, frequency: ArrayLike | None = None, inputs: Any = None, outputs: Any = None, **options: Any
) -> PeakGain:
    from robustlab.mu_analysis.margins.at_frequencies import worst_case_gain_at

    if isinstance(system, UncertainFrequencyData):
        chosen = system[[s.name for s in system.outputs] if outputs is None else list(outputs),
                        [s.name for s in system.inputs] if inputs is None else list(inputs)]  # fmt: skip
    else:
        model = system if isinstance(system, (UncertainModel, DelayedModel)) else as_model(system, "peak_gain")
        chosen = model if inputs is None and outputs is None else model.select(inputs, outputs)
    return worst_case_gain_at(chosen, frequency, **options)


def _with_natures(system: Any, natures: Natures, **options: Any) -> PeakGain:
    from robustlab.iqc.analysis import iqc_gain

    return iqc_gain(system, natures, **options)


def _scheduled(system: Any, **options: Any) -> PeakGain:
    from robustlab.synthesis.scheduling.induced_gain import lpv_gain

    return lpv_gain(system, **options)


def _with_effects(system: Any, controller: Any = None, **options: Any) -> PeakGain:
    from robustlab.iqc.effect_gain_bounds import effect_gain

    if controller is None:
        raise InputError("peak_gain: controller", "none for a plant with effects", "the K that closes its loop")
    return effect_gain(system, controller, **options)
