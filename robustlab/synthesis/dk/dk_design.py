"""A robust-performance design with its scalings, the proof of its mu bound, and its history."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

from robustlab.display import Facts
from robustlab.mu_analysis.axis.intervals import Piece
from robustlab.statespace import StateSpaceModel
from robustlab.synthesis.dk.dynamic_scalings import DynamicScalings, proved_level
from robustlab.synthesis.problem.design import Synthesis
from robustlab.synthesis.problem.gamma_bounds import GammaBound
from robustlab.tables import Table, Tabular
from robustlab.uncertainty.blocks import Block


@dataclass(frozen=True)
class DKStep:
    """One iterate of the search."""

    stage: str  # `"start"`, `"nominal start"`, `"D-K"`, `"direct"` or `"D-G-K"`
    gamma: float  # bound of mu at all frequencies proved by the scalings of the iterate
    mu: float  # largest upper bound of mu at single frequencies, complex blocks; NaN where not computed
    order: int  # states of the controller
    scaling_orders: tuple[int, ...]  # orders of D (and G) of each block
    work: float  # work since the start in the units of `robustlab.budget`

    def to_json(self) -> dict[str, object]:
        return vars(self).copy()


@dataclass(frozen=True, eq=False, kw_only=True)
class DKSynthesis(Tabular, Synthesis):
    r"""A robust-performance design; ``gamma`` bounds the peak of mu of ``closed_loop`` over all frequencies.

    ``gamma < 1`` proves stability and a gain below one for every Delta of the structure with ``|Delta| <= 1``.

    Attributes
    ----------
    blocks
        The structure of mu, performance block included.
    lower
        Lower bound of the peak of mu, attained by ``delta`` at ``frequency``; 0 where none was found.
    frequency
        Frequency in rad/s of ``lower``, or of the largest upper bound where ``lower`` is zero.
    delta
        The critical perturbation there, one value per block name, of size ``1 / lower``; empty where none was found.
    scalings
        D(s), G(s) of the controller's design; for a discrete plant in ``s = (2/dt) (z - 1)/(z + 1)``.
    scaled_level
        Bound proved by ``scalings`` through the norm of the scaled loop; `proved_again` repeats the proof.
    pieces
        Proof by constant D, G on frequency intervals that together cover the axis; empty where ``scaled_level`` is the
        smaller bound. For a discrete loop, frequencies are those of its image in continuous time.
    history
        Every iterate.
    start_mu
        Largest mu, at single frequencies, of the first controller: that of H-infinity synthesis, or K0.
    lower_bound
        Lower bound of mu for every stabilising controller with its origin; see `robustlab.synthesis.dk.mu_floor`.
    why
        One sentence: the decrease from ``start_mu``, and the reason why mu is not smaller, if it is known: the limit
        of every controller, or a structure in which D changes nothing.
    """

    quantities: ClassVar[Mapping[str, Any]] = {
        **Synthesis.quantities, **dict.fromkeys(("lower", "frequency", "scaled_level", "start_mu"), float),
    }  # fmt: skip
    saved = (
        *Synthesis.saved, "lower", "frequency", "delta", "scaled_level", "scalings", "history", "start_mu",
        "lower_bound", "why",
    )  # fmt: skip

    blocks: tuple[Block, ...]
    lower: float
    frequency: float
    delta: dict[str, Any]
    scalings: DynamicScalings
    scaled_level: float
    pieces: tuple[Piece, ...]
    history: tuple[DKStep, ...]
    start_mu: float
    lower_bound: GammaBound
    why: str

    def proved_again(self) -> float:
        """Return the bound of mu that the scalings prove for the loop rebuilt from plant and K; inf: none."""
        from robustlab.norms import bilinear_to_continuous

        loop: StateSpaceModel = self.plant.close(self.K)
        if not loop.is_stable():
            return float("inf")
        loop = bilinear_to_continuous(loop) if loop.is_discrete else loop
        return proved_level(loop, self.scalings, self.scaled_level)[0]

    def _gamma_text(self) -> str:
        return f"{self.gamma:.6g} (mu is at most this at all frequencies)"

    def facts(self) -> Facts:
        rows = super().facts()
        text = f"{self.lower:.6g} at {self.frequency:.4g} rad/s" if self.lower > 0 else "none found"
        orders = ", ".join(f"{b.name} {o}" for b, o in zip(self.blocks, self.scalings.orders, strict=True) if o)
        return [
            rows[0],
            ("peak of mu, lower bound", text),
            ("no controller below", f"{self.lower_bound.value:.6g}, {self.lower_bound.known}"),
            ("why not less", self.why),
            *rows[1:5],
            ("orders of the scalings", orders or "constant"),
            ("iterates", f"{len(self.history)}, from {self.history[0].gamma:.6g}"),
            *rows[5:],
        ]

    def table(self) -> Table:
        """Return a row for each iterate."""
        columns = {key: [getattr(step, key) for step in self.history] for key in ("stage", "gamma", "mu", "order")}
        return Table(("iterate", range(1, len(self.history) + 1)), columns)

    def to_json(self) -> dict[str, Any]:
        intervals = [(p.low, p.high, p.beta) for p in self.pieces]
        return super().to_json() | {"blocks": [b.name for b in self.blocks], "intervals": intervals}
