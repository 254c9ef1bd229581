"""Result of model reduction: the model, its certified error, the a-priori bound, and the Hankel values."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any, ClassVar

import numpy as np

from robustlab.arrays import Array
from robustlab.display import Displayable, Facts, number
from robustlab.norms import HinfNorm
from robustlab.result import Status
from robustlab.statespace import StateSpaceModel

__all__ = ["ReducedModel"]


@dataclass(frozen=True, eq=False)
class ReducedModel(Displayable):
    r"""A model of lower order with its certified error.

    Attributes
    ----------
    model
        The reduced model, with the inputs and outputs of the one given.
    method
        ``"truncation"`` or ``"residualisation"``, with ``"weighted "`` before it where there are weights;
        ``"hankel"``, ``"stochastic"``, ``"coprime"`` or ``"minimal"``.
    error
        Largest gain of the difference of the two models, as given and as returned, at all frequencies but those in
        ``left_out``; times the weights where there are any; relative to the gain of
        the stable part for ``"stochastic"``; for ``"coprime"`` of the normalised right coprime factors ``[N; M]``.
    bound
        A-priori bound of ``error``, as in `reduce_model`; raised to ``error.upper`` where that is larger, as the model
        returned is rounded. NaN with weights, for which there is none.
    hankel
        Hankel singular values of the reduced part (of the coprime factors for ``"coprime"``, of the phase of the model
        for ``"stochastic"``), in decreasing order.
    n_apart
        Number of states kept apart, because their modes are not stable.
    full
        The model as given.
    status
        CERTIFIED where ``error`` is proved and the two models agree with it wherever they were compared; INACCURATE
        where digits were lost.
    reason
        Why it is inaccurate; else empty.
    difference
        H-infinity norm of the difference at all frequencies, where ``error`` is a relative one.
    left_out
        Intervals (low, high) in rad/s, around modes on the stability boundary that are kept apart: rounding moves such
        a mode, or its share of the response, and no bound of the difference is finite there. Their width keeps the
        contribution of rounding to ``error`` below a thousandth of it.
    weights
        The weights on inputs and outputs, where there are any; for `robustlab.verify`.
    hankel_error
        Hankel norm of the difference of the stable parts, from its own Gramians; NaN for other methods than
        ``"hankel"``.
    removed
        The uncontrollable or unobservable modes that were removed: with ``"minimal"`` all, with other methods those
        that are not stable.
    """

    quantities: ClassVar[Mapping[str, Any]] = {
        "order": "1", "error": float, "states": "1", "bound": float, "n_apart": "1", "hankel": [float], "stable": bool,
    }  # fmt: skip

    model: StateSpaceModel
    method: str
    error: HinfNorm
    bound: float
    hankel: Array
    n_apart: int
    full: StateSpaceModel
    status: Status
    reason: str = ""
    difference: HinfNorm | None = None
    left_out: tuple[tuple[float, float], ...] = ()
    hankel_error: float = np.nan
    weights: tuple[StateSpaceModel | None, StateSpaceModel | None] = (None, None)
    removed: tuple[str, ...] = ()

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
        words = {
            "weighted": "weighted error",
            "coprime": "error of the coprime factors",
            "stochastic": "relative error",
        }
        kind = self.method.partition(" ")[0]
        label = words.get(kind, "error")
        bound = "" if not np.isfinite(self.bound) else f"; promised: at most {self.bound:.6g}"
        at = "" if np.isnan(self.error.frequency) else f" at {self.error.frequency:.4g} rad/s"
        around = ", ".join(
            f"{0.5 * (low + high):.6g} +- {0.5 * (high - low):.2g}" if low else f"0 to {high:.2g}"
            for low, high in self.left_out
        )
        rows = [
            ("order", f"{self.order} of {self.full.n_states} states"),
            ("method", self.method),
            (label, f"{self.error.upper:.6g}{at} (verified upper bound{bound})"),
            ("not proved at", around and f"{around} rad/s (modes on the stability boundary, kept apart)"),
            ("status", self.status.value),
            ("Hankel norm of the error", number(self.hankel_error, digits=6)),
            ("error at all frequencies", "" if self.difference is None else number(self.difference.upper, digits=6)),
            ("Hankel values", ", ".join(f"{value:.4g}" for value in self.hankel[:12]) or "none"),
        ]
        if self.n_apart:
            rows.append(("kept apart", f"{self.n_apart} states of modes that are not stable"))
        rows += [("removed", mode) for mode in self.removed]
        return [*rows, ("why", self.reason)] if self.reason else rows

    def to_json(self) -> dict[str, Any]:
        return {
            "type": "ReducedModel",
            **{f.name: getattr(self, f.name) for f in fields(self) if f.name not in ("full", "weights")},
            "order": self.order,
            "full_order": self.full.n_states,
        }
