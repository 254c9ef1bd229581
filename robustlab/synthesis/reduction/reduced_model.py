"""Result of model reduction: the model, its certified error, the a-priori bound, and the Hankel values."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, NamedTuple

import numpy as np

from robustlab.arrays import Array
from robustlab.display import Displayable, Facts, number
from robustlab.norms import HinfNorm
from robustlab.result import Status
from robustlab.statespace import StateSpaceModel

__all__ = ["ReducedModel"]

LABELS = {"weighted": "weighted error", "coprime": "error of the coprime factors", "stochastic": "relative error"}


class Evidence(NamedTuple):
    """The error of a reduced model with its proof; see the properties of `ReducedModel`."""

    error: HinfNorm
    left_out: tuple[tuple[float, float], ...] = ()
    reason: str = ""
    difference: HinfNorm | None = None


@dataclass(frozen=True, eq=False)
class ReducedModel(Displayable):
    r"""A model of lower order with its certified error, which is computed when it is first read.

    Attributes
    ----------
    model
        The reduced model, with the inputs and outputs of the one given.
    method
        ``"truncation"`` or ``"residualisation"``, with ``"weighted "`` before it where there are weights;
        ``"hankel"``, ``"stochastic"``, ``"coprime"`` or ``"minimal"``.
    hankel
        Hankel singular values of the reduced part (of the coprime factors for ``"coprime"``, of the phase of the model
        for ``"stochastic"``), in decreasing order.
    n_apart
        Number of states kept apart, because their modes are not stable.
    full
        The model as given.
    promised
        A-priori bound of the error, without rounding; NaN where there is none.
    weights
        The weights on inputs and outputs, where there are any; for `robustlab.verify`.
    removed
        The uncontrollable or unobservable modes that were removed: with ``"minimal"`` all, with other methods those
        that are not stable.
    """

    quantities: ClassVar[Mapping[str, Any]] = {
        "order": "1", "error": float, "states": "1", "bound": float, "n_apart": "1", "hankel": [float], "stable": bool,
    }  # fmt: skip

    model: StateSpaceModel
    method: str
    hankel: Array
    n_apart: int
    full: StateSpaceModel
    promised: float
    judge: Callable[[], Evidence]
    weights: tuple[StateSpaceModel | None, StateSpaceModel | None] = (None, None)
    removed: tuple[str, ...] = ()

    @cached_property
    def evidence(self) -> Evidence:
        """The error with its proof."""
        return self.judge()

    @property
    def error(self) -> HinfNorm:
        """Largest gain of the difference of the two models, as given and as returned, but at ``left_out``.

        Times the weights where there are any; relative to the gain of the stable part for ``"stochastic"``; for
        ``"coprime"`` of the normalised right coprime factors ``[N; M]``.
        """
        return self.evidence.error

    @property
    def bound(self) -> float:
        """``promised``, or ``error.upper`` where that is larger, as the model returned is rounded."""
        return self.promised if np.isnan(self.promised) else max(self.promised, self.error.upper)

    @property
    def left_out(self) -> tuple[tuple[float, float], ...]:
        """Intervals (low, high) in rad/s for which ``error`` says nothing, around modes on the stability boundary.

        Rounding moves such a mode, or its share of the response, and no bound of the difference is finite there. Their
        width keeps the contribution of rounding to ``error`` below a thousandth of it.
        """
        return self.evidence.left_out

    @property
    def difference(self) -> HinfNorm | None:
        """H-infinity norm of the difference at all frequencies, where ``error`` is a relative one."""
        return self.evidence.difference

    @property
    def reason(self) -> str:
        """Why the status is INACCURATE; else empty."""
        return self.evidence.reason

    @property
    def status(self) -> Status:
        """CERTIFIED where ``error`` is proved, and within what theory promises; INACCURATE where digits were lost."""
        sure = not self.reason and self.error.status is Status.CERTIFIED
        return Status.CERTIFIED if sure else Status.INACCURATE

    @property
    def order(self) -> int:
        """Number of states of the reduced model."""
        return self.model.n_states

    def to_model(self) -> StateSpaceModel:
        """Return the reduced model."""
        return self.model

    def headline(self) -> str:
        kept = f"{self.order} of {self.full.n_states} states by {self.method}"
        return f"{kept}, with an error of at most {number(self.error.upper)}"

    def numbers(self) -> dict[str, Any]:
        return {
            "order": self.order, "error": self.error.upper, "states": self.full.n_states,
            "bound": None if np.isnan(self.bound) else self.bound, "n_apart": self.n_apart,
            "hankel": self.hankel, "stable": self.model.is_stable(),
        }  # fmt: skip

    def facts(self) -> Facts:
        at = "" if np.isnan(self.error.frequency) else f" at {self.error.frequency:.4g} rad/s"
        bound = f"; promised: at most {self.bound:.6g}" if np.isfinite(self.bound) else ""
        around = ", ".join(
            f"{0.5 * (low + high):.6g} +- {0.5 * (high - low):.2g}" if low else f"0 to {high:.2g}"
            for low, high in self.left_out
        )
        return [
            ("order", f"{self.order} of {self.full.n_states} states"),
            ("method", self.method),
            (
                LABELS.get(self.method.partition(" ")[0], "error"),
                f"{self.error.upper:.6g}{at} (verified upper bound{bound})",
            ),
            ("not proved at", around and f"{around} rad/s (modes on the stability boundary, kept apart)"),
            ("status", self.status.value),
            ("error at all frequencies", "" if self.difference is None else number(self.difference.upper, digits=6)),
            ("Hankel values", ", ".join(f"{value:.4g}" for value in self.hankel[:12]) or "none"),
            ("kept apart", f"{self.n_apart} states of modes that are not stable" if self.n_apart else ""),
            *(("removed", mode) for mode in self.removed),
            ("why", self.reason),
        ]

    def to_json(self) -> dict[str, Any]:
        names = "model method error bound hankel n_apart status reason difference left_out removed order"
        data = {name: getattr(self, name) for name in names.split()}
        return {"type": "ReducedModel", **data, "full_order": self.full.n_states}
