"""A finished design: the controller as stored, its verified properties, and how its search ended."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np

from robustlab.budget import MILLION, NOT_REPEATABLE, Budget, search_budget
from robustlab.display import Displayable, Facts, number
from robustlab.errors import InputError
from robustlab.linear_analysis.frequency import frequency_response
from robustlab.linear_analysis.structural import reached
from robustlab.norms import HinfNorm
from robustlab.result import Status
from robustlab.signals import law
from robustlab.statespace import StateSpaceModel, lower_lft
from robustlab.synthesis.problem.controller import Controller
from robustlab.synthesis.problem.gamma_lower_bound import GammaBound
from robustlab.synthesis.problem.generalized_plant import GeneralizedPlant

WORK = 60 * MILLION  # the usual work of a design, in units of about a microsecond


@dataclass(frozen=True, eq=False, kw_only=True)
class Design(Displayable):
    """A controller and the proved bound of its loop: base of the results of synthesis for every kind of plant."""

    quantities: ClassVar[Mapping[str, Any]] = {"gamma": float}
    saved: ClassVar[tuple[str, ...]] = ("status", "gamma", "reason", "K")  # attributes that `to_json` gives

    K: Any  # `u = K y` with positive feedback into the plant's lower LFT; its inputs record what they take
    gamma: float  # verified upper bound of the objective of the method
    closed_loop: Any  # the lower LFT of plant and K, from w to z
    # Of `gamma` of this K, not of optimality. CERTIFIED where the rebuilt loop is stable and `gamma` was proved for it;
    # INACCURATE where digits were lost; TIMEOUT where the time limit ended the search: another run may give another K.
    status: Status
    reason: str  # why the method stopped, and how much of the result is proved

    def headline(self) -> str:
        return f"A controller of {number(self.K.n_states)} states, gamma {self._gamma_text()}"

    def _gamma_text(self) -> str:
        return f"{self.gamma:.6g} (verified upper bound)"

    def to_json(self) -> dict[str, Any]:
        return {name: getattr(self, name) for name in self.saved}


@dataclass(frozen=True, eq=False, kw_only=True)
class Synthesis(Design):
    """A controller that was verified in the loop rebuilt from it."""

    quantities: ClassVar[Mapping[str, Any]] = {
        "order": "1", "stable": bool, "gamma": float, "fastest_controller_pole": float, "closed_loop_abscissa": float,
    }  # fmt: skip
    saved = (
        "method", "status", "gamma", "order", "law", "fastest_controller_pole", "closed_loop_abscissa", "limit",
        "reason", "K", "closed_loop",
    )  # fmt: skip

    K: StateSpaceModel
    closed_loop: StateSpaceModel
    limit: str  # the channels with the largest share in the peak
    plant: GeneralizedPlant  # with which the result can be checked again
    method: str  # name of the design method

    def __init_subclass__(cls, **keywords: Any) -> None:
        super().__init_subclass__(**keywords)
        base = super(cls, cls)  # a class declares only what it adds to those of its base
        cls.quantities = {**base.quantities, **cls.quantities}
        cls.saved = tuple(dict.fromkeys((*base.saved, *cls.saved)))

    def to_model(self) -> StateSpaceModel:
        return self.K

    @property
    def controller(self) -> Controller:
        """K with its verified properties, as it is stored."""
        return Controller(self.K, self.gamma, self.status, self.method, design=self)

    @property
    def order(self) -> int:
        """Number of states of K."""
        return self.K.n_states

    @property
    def law(self) -> str:
        """The feedback law, ``u = K (r - y)`` for example."""
        return law(self.K.inputs)

    @property
    def stable(self) -> bool:
        return self.closed_loop.spectral_abscissa() < 0

    @property
    def fastest_controller_pole(self) -> float:
        """Largest modulus of K's poles: in rad/s, or, for a discrete K, of the pole itself."""
        return float(np.abs(self.K.poles()).max(initial=0.0))

    @property
    def closed_loop_abscissa(self) -> float:
        """Spectral abscissa of the loop of K, without weights and filters outside of it; see `stable`."""
        return self._parts[0].spectral_abscissa()

    @property
    def _parts(self) -> tuple[StateSpaceModel, StateSpaceModel]:
        """The loop of K, and the rest of the plant: states that u does not reach or that do not reach y."""
        p, n_w, n_z = self.plant.model, self.plant.n_w, self.plant.n_z
        if p.dt != self.K.dt and (self.K.n_states or self.K.dt):  # sampled: the loop has a lifted plant
            return self.closed_loop, StateSpaceModel([], [], [], np.zeros((0, 0)), self.K.dt)
        B, C = p.B[:, n_w:], p.C[n_z:]
        acts = p.A != 0
        inside = np.flatnonzero(reached(acts, (B != 0).any(axis=1)) & reached(acts.T, (C != 0).any(axis=0)))
        outside = np.setdiff1d(np.arange(p.n_states), inside)
        around = StateSpaceModel(p.A[inside][:, inside], B[inside], C[:, inside], p.D[n_z:, n_w:], p.dt)
        n, nothing = len(outside), np.zeros
        rest = StateSpaceModel(p.A[outside][:, outside], nothing((n, 0)), nothing((0, n)), nothing((0, 0)), p.dt)
        return lower_lft(around, self.K), rest

    def facts(self) -> Facts:
        unit = "(modulus)" if self.K.is_discrete else "rad/s"
        margin = "(modulus minus one)" if self.K.is_discrete else "1/s"
        outside = self._parts[1].spectral_abscissa()
        return [
            ("gamma", self._gamma_text()),
            ("status", self.status.value),
            ("controller", f"{self.K.n_states} states, {self.K.n_inputs} inputs, {self.K.n_outputs} outputs"),
            ("loop", self.law),
            ("fastest controller pole", f"{self.fastest_controller_pole:.4g} {unit}"),
            ("closed loop, rightmost pole", f"{self.closed_loop_abscissa:.4g} {margin}"),
            ("weights and filters, rightmost pole", f"{outside:.4g} {margin}" if np.isfinite(outside) else ""),
            ("what limits it", self.limit),
            ("how", self.reason),
        ]


@dataclass(frozen=True, eq=False, kw_only=True)
class HinfSynthesis(Synthesis):
    """An H-infinity design; ``gamma`` bounds the H-infinity norm of ``closed_loop``."""

    quantities = dict.fromkeys(("smallest_gamma", "peak_frequency", "gamma_lower"), float)
    saved = ("smallest_gamma", "peak_frequency", "norm", "gamma_lower", "lower_bound", "assumptions")

    peak_frequency: float  # in rad/s, at which the closed loop attains its norm
    smallest_gamma: float  # verified, of the search; K may be a slower controller within the allowed ratio of it
    norm: HinfNorm  # bracket of the closed loop's norm
    lower_bound: GammaBound  # of gamma over all stabilising controllers
    assumptions: tuple[str, ...]  # textbook assumptions that the plant violates; where any, the search regularised
    weights: Mapping[str, StateSpaceModel] = field(default_factory=dict)  # of a mixed-sensitivity problem, by name

    def _gamma_text(self) -> str:
        return f"{self.gamma:.6g} at {self.peak_frequency:.4g} rad/s (verified upper bound)"

    def facts(self) -> Facts:
        rows = super().facts()
        found = f"{self.smallest_gamma:.6g}"
        bound = f"{self.lower_bound.value:.6g}, {self.lower_bound.known}"
        broken = [("regularised, because" if i == 0 else "", text) for i, text in enumerate(self.assumptions)]
        return [*rows[:2], ("smallest gamma found", found), ("no controller below", bound), *rows[2:], *broken]

    @property
    def gamma_lower(self) -> float:
        """Lower bound of gamma over all stabilising controllers."""
        return self.lower_bound.value


def design_budget(where: str, effort: float, time_limit: float | None, work: float = WORK) -> Budget:
    """Return the budget of a design; a time limit of zero is refused, because there is no design without a search."""
    if time_limit is not None and not time_limit > 0:
        raise InputError(where, f"time_limit is {time_limit}", "a positive time in s, or none")
    return search_budget(where, work, effort, time_limit)


def final_status(
    status: Status, parts: Sequence[str], budget: Budget, smaller: str = "a smaller gamma"
) -> tuple[Status, str]:
    """Return status and reason of a design; the reason names the budget where it ended the search."""
    reason, ended = "; ".join(parts), ""
    if budget.struck:
        status, ended = (Status.TIMEOUT if status.trustworthy else status), NOT_REPEATABLE
    elif budget.remark:
        ended = f"work budget used up: a larger effort may find {smaller}"
    # A part of the search may have reported it already.
    return status, reason if not ended or ended in reason else f"{reason}; {ended}"


def relative_loss(value: float, reference: float) -> float:
    """Return ``value / reference - 1``; 0 for equal values, infinite where the reference is 0."""
    return 0.0 if value == reference else value / reference - 1 if reference > 0 else np.inf


def limiting_channels(loop: StateSpaceModel, omega: float) -> str:
    """Return the output and the input with the largest share in the singular vectors of the peak, in words."""
    if (not np.isfinite(omega) and loop.is_discrete) or not loop.n_inputs or not loop.n_outputs:
        return ""
    left, _, right = np.linalg.svd(frequency_response(loop, [omega])[0])
    out, into = np.abs(left[:, 0]) ** 2, np.abs(right[0]) ** 2
    i, j = int(out.argmax()), int(into.argmax())
    names = loop.output_names[i], loop.input_names[j]
    return f"{names[0]} ({out[i]:.0%} of the peak) driven by {names[1]} ({into[j]:.0%})"
