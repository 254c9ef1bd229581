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

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from robustlab.delays.model import DelayedModel, as_delayed
from robustlab.errors import InputError, NoTrustworthyNumber
from robustlab.mu_analysis.margins.delay_margins import DelayGain, delay_gain
from robustlab.mu_analysis.margins.delay_stability import DelayStability, delay_stability
from robustlab.result import Status
from robustlab.shown import Facts, bracket, number
from robustlab.statespace import StateSpaceModel, as_model
from robustlab.synthesis.problem.design import Design, HinfSynthesis

ORDERS = (2, 4, 6, 8)  # of Padé's approximations of the plant that designs are made for, one after the other


@dataclass(frozen=True, eq=False, kw_only=True)
class DelayedDesign(Design):
    """A controller in the loop with exact delays.

    Attributes
    ----------
    K
        The controller, ``u = K y``.
    gamma
        The gain that is proved with exact delays; inf where none is.
    closed_loop
        The closed loop from w to z, its delays exact.
    stability
        Whether it is stable, and what shows that.
    gain
        Its largest gain over frequency, proved and attained; None where it was not proved stable.
    design
        The design on the rational model; None where a controller was given.
    order
        Order of Padé's approximation that the design was made for; 0 where a controller was given.
    plant
        The generalised plant with its delays; None where K has delays, too.
    status
        That of the gain; where there is none, that of the stability, FAILED where the loop is proved unstable.
    """

    K: StateSpaceModel
    closed_loop: DelayedModel
    stability: DelayStability
    gain: DelayGain | None
    design: HinfSynthesis | None = None
    order: int = 0
    plant: DelayedModel | None = None

    def _gamma_text(self) -> str:
        return "" if self.gain is None else bracket(self.gain.lower, self.gain.upper, ("attained", "proved"))

    def facts(self) -> Facts:
        """The exact loop's stability and gain, and what the design said."""
        designed = "" if self.design is None else f"{number(self.design.gamma)}, with Padé of order {self.order}"
        return [
            ("gain with exact delays", self._gamma_text()),
            ("stable with exact delays", self.stability.facts()[0][1]),
            ("gamma of the design", designed),
            ("controller", f"{self.K.n_states} states"),
        ]

    def to_json(self) -> dict[str, Any]:
        """All attributes but the plant, and of the design its gamma."""
        gamma = None if self.design is None else self.design.gamma
        kept = {name: x for name, x in vars(self).items() if name != "plant"}
        return {"type": "DelayedDesign", **kept, "design": gamma}


def judged(P: Any, K: Any, where: str = "hinf", tolerance: float = 0.01) -> DelayedDesign:
    """Stability and gain of the loop of a generalised plant with exact delays and a controller, proved.

    Raises InputError: sizes that do not fit, no w or z. NoTrustworthyNumber: a loop that is not well posed.
    """
    plant, given = as_delayed(P, f"{where}: P"), getattr(K, "K", K)
    k = given if isinstance(given, DelayedModel) else as_model(given, f"{where}: K")
    if plant.n_inputs <= k.n_outputs or plant.n_outputs <= k.n_inputs:
        found = f"P of {plant.n_outputs} x {plant.n_inputs} and K of {k.n_outputs} x {k.n_inputs}"
        raise InputError(where, found, "w and z beside the controls and measurements in P")
    loop = plant.close(k)
    stability = delay_stability(loop)
    gain = delay_gain(loop, tolerance) if stability.stable else None
    if gain is not None:
        status = gain.status
    else:
        status = Status.FAILED if stability.stable is False else stability.status
    return DelayedDesign(
        K=k if isinstance(k, StateSpaceModel) else k.undelayed(),
        gamma=gain.upper if gain is not None else float("inf"),
        closed_loop=loop,
        stability=stability,
        gain=gain,
        plant=plant if isinstance(k, StateSpaceModel) else None,
        status=status,
        reason=stability.facts()[0][1],
    )


def delayed_hinf(
    plant: DelayedModel, design_for: Callable[[StateSpaceModel], HinfSynthesis], tolerance: float
) -> DelayedDesign:
    """`hinf` of a plant with exact delays, by ``design_for`` rational models; see there."""
    best: DelayedDesign | None = None
    for order in ORDERS if len(plant.delays) else (0,):
        design = design_for(plant.pade(order))
        found = judged(plant, design, "hinf", tolerance)
        if found.gain is not None and (best is None or found.gamma < best.gamma):
            best = replace(found, design=design, order=order, reason=design.reason)
        if best is not None and best.gamma <= (1.0 + 2.0 * tolerance) * design.gamma:
            break
    if best is None:
        found = f"no design up to Padé of order {ORDERS[-1]} is proved to stabilise the plant with its exact delays"
        hint = "rl.dk on .uncertain(order) designs for the set that holds the plant"
        raise NoTrustworthyNumber("hinf", found, None, hint)
    return best
