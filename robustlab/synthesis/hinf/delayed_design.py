r"""Designs for plants with exact delays: made on a rational model, judged in the loop with the delays as they are.

No synthesis here solves the equations of a delay system. A controller is designed for Padé's approximation of the
plant; then the loop is closed with the exact delays, :math:`F_l(P, K)` with :math:`e^{-s\tau}` in it, and both its
stability and its norm are proved by `delay_stability` and `delay_gain`. What counts is that proof, not the norm of the
design.

References
----------
Zhou, Doyle, Glover, *Robust and Optimal Control* (1996), chapter 16; `robustlab.delays.pade` for the approximation.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from robustlab.closing import wired
from robustlab.delays.model import DelayedModel, as_delayed
from robustlab.errors import InputError, NoTrustworthyNumber, told_as
from robustlab.mu_analysis.margins.delay_margins import DelayGain, delay_gain
from robustlab.mu_analysis.margins.delay_stability import DelayStability, delay_stability
from robustlab.result import Status
from robustlab.shown import Facts, Shown, bracket, number
from robustlab.statespace import StateSpaceModel, as_model
from robustlab.synthesis.hinf.hinf_synthesis import HinfSynthesis, hinf
from robustlab.uncertainty.algebra import star

ORDERS = (2, 4, 6, 8)  # of Padé's approximations of the plant that designs are made for, one after the other


@dataclass(frozen=True, eq=False)
class DelayedDesign(Shown):
    """A controller in the loop with exact delays.

    Attributes
    ----------
    K
        The controller, ``u = K y``.
    loop
        The closed loop from w to z, its delays exact.
    stability
        Whether it is stable, and what shows that.
    gain
        Its largest gain over frequency, proved and attained; None where it was not proved stable.
    design
        The design on the rational model; None where a controller was given.
    order
        Order of Padé's approximation that the design was made for; 0 where a controller was given.
    status
        That of the gain; where there is none, that of the stability, FAILED where the loop is proved unstable.
    """

    K: StateSpaceModel
    loop: DelayedModel
    stability: DelayStability
    gain: DelayGain | None
    design: HinfSynthesis | None
    order: int
    status: Status

    @property
    def gamma(self) -> float:
        """The gain that is proved with exact delays; inf where none is."""
        return self.gain.upper if self.gain is not None else float("inf")

    def facts(self) -> Facts:
        """The exact loop's stability and gain, and what the design said."""
        gain = "" if self.gain is None else bracket(self.gain.lower, self.gain.upper, ("attained", "proved"))
        designed = "" if self.design is None else f"{number(self.design.gamma)}, with Padé of order {self.order}"
        return [
            ("gain with exact delays", gain),
            ("stable with exact delays", self.stability.facts()[0][1]),
            ("gamma of the design", designed),
            ("controller", f"{self.K.n_states} states"),
        ]

    def to_json(self) -> dict[str, Any]:
        """All attributes but the design, of which its gamma."""
        told: dict[str, Any] = {"type": "DelayedDesign", **vars(self), "gamma": self.gamma}
        told["design"] = None if self.design is None else self.design.gamma
        return told


@told_as("verify_delayed_loop")
def verify_delayed_loop(P: Any, K: Any, *, tolerance: float = 0.01, highest_order: int = 16) -> DelayedDesign:
    r"""Stability and gain of the loop of a generalised plant with exact delays and a controller, proved.

    Parameters
    ----------
    P
        Generalised plant [w; u] -> [z; y], a DelayedModel; controls and measurements last.
    K
        Controller ``u = K y`` (positive feedback into the lower LFT): a model, a design, or one with delays itself.
    tolerance, highest_order
        As in `delay_gain`.

    Returns
    -------
    DelayedDesign
        The closed loop with `DelayStability` and `DelayGain`.

    Raises
    ------
    InputError
        Sizes that do not fit; a plant without w or z.
    NoTrustworthyNumber
        A loop that is not well posed.

    Examples
    --------
    >>> from robustlab.delays import with_delays
    >>> P = StateSpaceModel([[-1.0]], [[1.0, 0.0, 1.0]], [[1.0], [0.0], [1.0]], [[0, 0, 0], [0, 0, 1], [0, 1, 0]])
    >>> found = verify_delayed_loop(with_delays(P, inputs={2: 0.1}), StateSpaceModel([], [], [], [[-0.4]]))
    >>> found.stability.stable, str(found.status)
    (True, 'certified')
    """
    plant = as_delayed(P, "verify_delayed_loop: P")
    given = getattr(K, "K", K)
    k = given if isinstance(given, DelayedModel) else as_model(given, "verify_delayed_loop: K")
    if plant.n_inputs <= k.n_outputs or plant.n_outputs <= k.n_inputs:
        found = f"P of {plant.n_outputs} x {plant.n_inputs} and K of {k.n_outputs} x {k.n_inputs}"
        raise InputError("verify_delayed_loop", found, "w and z beside the controls and measurements in P")
    y, u = plant.outputs[plant.n_outputs - k.n_inputs :], plant.inputs[plant.n_inputs - k.n_outputs :]
    k = wired(k, y, u, "verify_delayed_loop")
    loop: Any = star(plant, _plain(k), k.n_inputs, k.n_outputs)
    stability = delay_stability(loop, highest_order)
    gain = delay_gain(loop, tolerance, highest_order) if stability.stable else None
    if gain is not None:
        status = gain.status
    else:
        status = Status.FAILED if stability.stable is False else stability.status
    model = k if isinstance(k, StateSpaceModel) else k.undelayed()
    return DelayedDesign(model, loop, stability, gain, None, 0, status)


def _plain(k: StateSpaceModel | DelayedModel) -> StateSpaceModel | DelayedModel:
    """Without units, which a controller's file may not state."""
    if isinstance(k, DelayedModel):
        return k
    ins, outs = [f"k.y{i}" for i in range(k.n_inputs)], [f"k.u{i}" for i in range(k.n_outputs)]
    return StateSpaceModel(k.A, k.B, k.C, k.D, k.dt, ins, outs)


@told_as("delay_hinf")
def delay_hinf(P: Any, n_meas: int, n_con: int, *, tolerance: float = 0.01, **options: Any) -> DelayedDesign:
    r"""H-infinity controller for a plant with exact delays, judged in the loop with these delays.

    Designs are made for Padé's approximations of order 2, 4, 6, 8 of the plant, until one is proved to keep its gamma
    with the exact delays within the tolerance. The smallest proved gain counts.

    Parameters
    ----------
    P
        Generalised plant [w; u] -> [z; y], a DelayedModel; controls and measurements last.
    n_meas, n_con
        Numbers of measurements and controls.
    tolerance
        How much larger than the gamma of the design the proved gain may be for the search to end.
    **options
        Those of `hinf`.

    Returns
    -------
    DelayedDesign
        ``gamma`` is proved with exact delays; ``design.gamma`` is that of the rational model.

    Raises
    ------
    InputError
        What `hinf` refuses.
    NoTrustworthyNumber
        No design is proved to stabilise the plant with its delays, or what `hinf` says.

    Examples
    --------
    >>> from robustlab.delays import with_delays
    >>> P = StateSpaceModel([[-1.0]], [[1.0, 0.0, 1.0]], [[1.0], [0.0], [1.0]], [[0, 0, 0], [0, 0, 1], [0, 1, 0]])
    >>> found = delay_hinf(with_delays(P, inputs={2: 0.1}), 1, 1)
    >>> found.stability.stable, found.gamma <= 1.02 * found.design.gamma
    (True, True)
    """
    plant = as_delayed(P, "delay_hinf: P")
    best: DelayedDesign | None = None
    for order in ORDERS if len(plant.delays) else (0,):
        design = hinf(plant.pade(order), n_meas, n_con, **options)
        found = verify_delayed_loop(plant, design, tolerance=tolerance)
        if found.gain is not None and (best is None or found.gamma < best.gamma):
            best = DelayedDesign(found.K, found.loop, found.stability, found.gain, design, order, found.status)
        if best is not None and best.design is not None and best.gamma <= (1.0 + 2.0 * tolerance) * design.gamma:
            break
    if best is None:
        found = f"no design up to Padé of order {ORDERS[-1]} is proved to stabilise the plant with its exact delays"
        hint = "rl.dk on .uncertain(order) designs for the set that holds the plant"
        raise NoTrustworthyNumber("delay_hinf", found, None, hint)
    return best
