r"""A robust-performance design with its scalings, the proof of its mu bound, its history, and what limits it.

For every full block i and constant values of the real blocks of size at most 1 / beta_0, the peak of mu is at least
:math:`\min(\beta_0, \| T_{ii} \|_\infty)` of that member; Parrott's bound of that norm holds for every controller.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from robustlab.arrays import Array
from robustlab.display import Facts
from robustlab.mu_analysis.axis.intervals import Piece
from robustlab.mu_analysis.matrix.branch_and_bound import centre_matrix
from robustlab.statespace import StateSpaceModel
from robustlab.synthesis.dk.dynamic_scalings import DynamicScalings, proved_level
from robustlab.synthesis.problem.design import Synthesis
from robustlab.synthesis.problem.gamma_bounds import GammaBound, pointwise_bound
from robustlab.synthesis.problem.partition import PlantMatrices
from robustlab.synthesis.problem.scaling import equilibrated, paths_first
from robustlab.tables import Table, Tabular
from robustlab.uncertainty.blocks import Block, block_slices

NEAR = 0.01  # relative distance to a limit, or to the start of the search, that counts as none


@dataclass(frozen=True)
class DKStep:
    """One iterate of the search."""

    stage: str  # `"start"`, `"D-K"`, `"direct"` or `"D-G-K"`
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
        Lower bound of mu for every stabilising controller with its origin; see `robustlab.synthesis.mu_floor`.
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


def mu_floor(
    plant: PlantMatrices, blocks: Sequence[Block], gamma: float, delta: Mapping[str, Any], dt: float = 0.0
) -> GammaBound:
    """Return a lower bound, at most ``gamma``, of the peak of mu under every stabilising controller."""
    real = np.array([b.interval is not None for b in blocks])
    start = np.array([float(delta.get(b.name, 0.0)) if r else 0.0 for b, r in zip(blocks, real, strict=True)])
    best = _of_member(plant, blocks, np.zeros(len(blocks)), dt)
    if not gamma > 0:
        return replace(best, value=0.0)
    largest = float(np.abs(start).max(initial=0.0))
    member = start / (gamma * largest) if largest else start
    found = _of_member(plant, blocks, member, dt)
    for k in np.flatnonzero(real):  # one sweep over neighbouring corners
        for value in (1 / gamma, -1 / gamma):
            other = member.copy()
            other[k] = value
            tried = _of_member(plant, blocks, other, dt)
            if tried.value > found.value:
                member, found = other, tried
    if found.value > best.value:
        values = ", ".join(f"{b.name} {v:+.3g}" for b, v in zip(blocks, member, strict=True) if v)
        best = replace(found, known=f"{found.known}, of the member {values} alone")
    return replace(best, value=min(best.value, gamma))


def _of_member(plant: PlantMatrices, blocks: Sequence[Block], values: Array, dt: float) -> GammaBound:
    """Return the largest bound of the blocks' own channels for these values of the real blocks."""
    best = GammaBound(0.0, "no block's own channels keep mu from zero", True)
    p = _closed(plant, centre_matrix(blocks, values)) if values.any() else plant
    if p is None:
        return best
    for block, (w, z) in zip(blocks, block_slices(blocks), strict=True):
        if block.interval or (block.d_order > 1 and block.rows > 1):
            continue  # mu of these blocks is not a norm
        part = replace(p, B1=p.B1[:, w], D21=p.D21[:, w], C1=p.C1[z], D12=p.D12[z], D11=p.D11[z, w])
        bound = pointwise_bound(part, [paths_first(part), equilibrated(part)], dt)
        if bound.value > best.value:
            best = replace(bound, known=f"{block.name!r} alone, {bound.known}")
    return best


def _closed(p: PlantMatrices, delta: Array) -> PlantMatrices | None:
    """Return the plant with w + delta z in place of w, without the resulting D22; None: ill-posed."""
    loop = np.eye(len(p.C1)) - p.D11 @ delta
    if np.linalg.cond(loop) > 1e10:
        return None
    through = delta @ np.linalg.inv(loop)
    inside = np.eye(p.B1.shape[1]) + through @ p.D11
    return PlantMatrices(
        A=p.A + p.B1 @ through @ p.C1,
        B1=p.B1 @ inside,
        B2=p.B2 + p.B1 @ through @ p.D12,
        C1=np.linalg.solve(loop, p.C1),
        C2=p.C2 + p.D21 @ through @ p.C1,
        D11=np.linalg.solve(loop, p.D11),
        D12=np.linalg.solve(loop, p.D12),
        D21=p.D21 @ inside,
    )


def why_not_less(smallest: float, start_mu: float, floor: float, blocks: Sequence[Block]) -> str:
    """Return one sentence with the decrease from the first controller and the reason why mu is not smaller."""
    gained = 1 - smallest / start_mu if start_mu > 0 else 0.0
    text = f"mu of the first controller is {start_mu:.4g}, the smallest proved {smallest:.4g}"
    text += f" ({gained:.1%} less)" if gained > NEAR else ": D-K gains nothing over it"
    if smallest <= floor * (1 + NEAR):
        return f"{text}; it is at the limit of every controller"
    rest = f"any controller has at least {floor:.4g}"
    if len(blocks) == 1 and not blocks[0].interval and blocks[0].d_order == 1:
        return f"{text}; one full block: mu is the norm that H-infinity makes smallest, D has nothing to change; {rest}"
    return f"{text}; {rest}, and what lies between is not decided: the search is local"
