r"""Robust-performance designs: controllers for given scalings with their proofs, and the result with what limits it.

For every full block i and constant values of the real blocks of size at most 1 / beta_0, the peak of mu is at least
:math:`\min(\beta_0, \| T_{ii} \|_\infty)` of that member; Parrott's bound of that norm holds for every controller.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from robustlab.arrays import AnyArray, Array
from robustlab.budget import Budget, dense
from robustlab.display import AllFields, Facts
from robustlab.errors import InputError, NoTrustworthyNumber
from robustlab.mu_analysis.axis.intervals import AxisCover, Piece, loop_axis_claims
from robustlab.mu_analysis.matrix.branch_and_bound import centre_matrix
from robustlab.norms import bilinear_to_continuous, bilinear_to_discrete, hinf_norm
from robustlab.norms.claims import ABOVE
from robustlab.statespace import StateSpaceModel
from robustlab.synthesis.dk.riccati_level import LevelSearch
from robustlab.synthesis.dk.scalings import DynamicScalings, plant_at_level, proved_level
from robustlab.synthesis.hinf.hinf_synthesis import channel_gains, trial_loop
from robustlab.synthesis.problem.certify import SHARES, certified, named_controller, with_direct_term
from robustlab.synthesis.problem.design import Synthesis
from robustlab.synthesis.problem.limits import GammaBound, pointwise_bound
from robustlab.synthesis.problem.partition import GeneralizedPlant, PlantMatrices, Realisation
from robustlab.synthesis.problem.scaling import equilibrated, paths_first
from robustlab.tables import Table, Tabular
from robustlab.uncertainty.blocks import Block, block_slices
from robustlab.verification.checker import check
from robustlab.verification.claim import Outcome

# The central controller at the smallest level is ill-conditioned: the level is increased by these shares until the
# proof succeeds. The last ones are for badly scaled plants, where the controller loses digits.
BACKOFF = (1e-4, 1e-3, 1e-2, 5e-2, 0.1, 0.2, 0.3, 0.4, 0.6, 1.0)
ACCEPTED = 1e-2  # loss against the Riccati level above which the other numerical scaling is tried as well
SLACK_SHARES = (0.999, 0.8, 0.5)  # shares (of a logarithm) of the slack for slower controllers
REGULAR = 1e-6  # D12, D21 below this size in scaled units need regularisation
STATE_SHARE = 0.3  # share of the regularisation for penalties and noises on the states
AXIS_EFFORT = 1500  # effort of the checker for mu by intervals: some seconds
BELOW_ONE = 1 - 2e-6  # a level claimed to a millionth, below one
NEAR = 0.01  # relative distance to a limit, or to the start of the search, that counts as none


@dataclass(frozen=True)
class DKStep(AllFields):
    """One iterate of the search."""

    stage: str  # `"start"`, `"D-K"` (constant D), `"direct"` or `"D-G-K"`
    gamma: float  # bound of mu at all frequencies proved by the scalings of the iterate
    mu: float  # largest upper bound of mu at single frequencies, complex blocks; NaN where not computed
    order: int  # states of the controller
    scaling_orders: tuple[int, ...]  # orders of D (and G) of each block
    work: float  # work since the start in the units of `robustlab.budget`


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
        loop: StateSpaceModel = self.plant.close(self.K)
        if not loop.is_stable():
            return float("inf")
        return proved_level(_mapped(loop), self.scalings, self.scaled_level)[0]

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
    (A, B, C, D), n_w, n_z = p.whole(), p.B1.shape[1], len(p.C1)
    through = delta @ np.linalg.inv(loop)
    into, out = np.vstack([B[:, :n_w], D[:, :n_w]]) @ through, np.hstack([C[:n_z], D[:n_z]])
    moved, n = np.block([[A, B], [C, D]]) + into @ out, len(A)
    return PlantMatrices.of(Realisation(moved[:n, :n], moved[:n, n:], moved[n:, :n], moved[n:, n:]), n_w, n_z)


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


@dataclass(frozen=True, eq=False)
class Iterate:
    """A controller with the level that its scalings prove."""

    K: StateSpaceModel  # for the given plant, D22 included
    loop: StateSpaceModel  # the closed loop rebuilt from it, mapped to continuous time where the plant is discrete
    scalings: DynamicScalings  # D, G whose scaled loop proves `level`
    level: float  # upper bound of mu at all frequencies


class RobustProblem:
    """Plant, structure and regularisation of a robust-performance synthesis."""

    def __init__(self, plant: GeneralizedPlant, budget: Budget) -> None:
        self.plant, self.budget = plant, budget
        self._continuous = plant.continuous()
        self.bare = self._continuous.matrices()
        self.matrices = self.bare
        self.scale = paths_first(self.bare)
        self._regular = min(self.scale.apply(self.bare).direct_sizes) > REGULAR

    def search(self, scalings: DynamicScalings, alternative: bool = False) -> LevelSearch:
        """Return the level search of scalings of this form; ``alternative``: with the other numerical scaling."""
        whole, sizes = self.matrices.whole(), self.matrices.sizes

        def at(theta: AnyArray, beta: float) -> PlantMatrices:
            return plant_at_level(whole, sizes, scalings.with_parameters(theta), beta)

        scaled = at(scalings.parameters(), 1.0)
        units = equilibrated(scaled) if alternative else paths_first(scaled)
        return LevelSearch(at, units, self.budget)

    def solve(self, scalings: DynamicScalings, beta: float) -> Iterate | None:
        """Return the controller of smallest proved level among those a little above the known smallest level."""
        best: Iterate | None = None
        for alternative in (False, True):
            search = self.search(scalings, alternative)
            for share in BACKOFF:
                K = search.controller(scalings.parameters(), beta * (1 + share))
                found = None if K is None else self.closed(K, scalings, beta)
                if found is not None and (best is None or found.level < best.level):
                    best = found
                if best is not None and best.level <= beta * (1 + share) * (1 + 1e-3):
                    break
            if best is not None and best.level <= beta * (1 + ACCEPTED):
                break
        return best

    def relaxed(self, iterate: Iterate, limit: float) -> Iterate:
        """Return the same scalings with the controller of slowest poles whose proved level is at most ``limit``."""
        if not iterate.level:  # the loop is zero
            return iterate

        def fastest(of: Iterate) -> float:
            return float(np.abs(of.K.poles()).max(initial=0.0))

        search, best = self.search(iterate.scalings), iterate
        for share in SLACK_SHARES:
            level = iterate.level * (limit / iterate.level) ** share
            K = search.controller(iterate.scalings.parameters(), level)
            found = None if K is None or self.budget.over else self.closed(K, iterate.scalings, iterate.level)
            if found is not None and found.level <= limit and fastest(found) < fastest(best):
                best = found
        return best

    def closed(self, K: StateSpaceModel, scalings: DynamicScalings, guess: float) -> Iterate | None:
        """Return the iterate of a controller for the continuous plant without D22; None where it is unstable."""
        try:
            full = with_direct_term(K, self._continuous.D22)
            if self.plant.model.is_discrete:
                full = bilinear_to_discrete(full, self.plant.model.dt)
        except (InputError, NoTrustworthyNumber):
            return None
        return self.proved(full, scalings, guess)

    def proved(self, K: StateSpaceModel, scalings: DynamicScalings, guess: float) -> Iterate | None:
        """Return the iterate of a controller for the given plant; None where it is unstable or proves no level."""
        try:
            K = named_controller(K, self.plant.measurements, self.plant.controls, K.dt)
            loop = self.plant.close(K)
            if not loop.is_stable():
                return None
            loop = _mapped(loop)
            self.budget.spend(dense(loop.n_states + scalings.n_states, 20 * 10 if scalings.mixed else 10))
            level, _ = proved_level(loop, scalings, guess)
        except (InputError, NoTrustworthyNumber, np.linalg.LinAlgError):
            return None
        return Iterate(K, loop, scalings, level) if np.isfinite(level) else None

    def certified(
        self, iterate: Iterate, blocks: tuple[Block, ...], cover: AxisCover
    ) -> tuple[float, tuple[Piece, ...], str]:
        """Prove mu by the checker: the level of the cover's intervals, or else that of the iterate's scalings.

        Return it with the intervals that prove it (none: the norm of the scaled loop) and the reason of a failed proof.
        """
        plant, K, doubt, best = self.plant, iterate.K, "", iterate.level
        if cover.pieces and not cover.open and cover.beta < iterate.level:
            best, doubt = cover.beta, "pieces of the proof could not be joined"
            for claim in loop_axis_claims(plant.model, K, blocks, cover.beta * ABOVE, cover.pieces):
                found = check(claim, effort=AXIS_EFFORT)
                if found.outcome is Outcome.PROVED:
                    return cover.beta, tuple(cover.pieces), ""
                doubt = f"not proved in ball arithmetic of P and K as they are: {found.where}"
        # The norm of the scaled loop: with G at a slightly higher level, where it is below one; without G at level one.
        mixed = iterate.scalings.mixed
        beta = iterate.level * (1 + SHARES[0]) if mixed else 1.0
        scaled, mapped = self._scaled(iterate.scalings, beta), _mapped(K)
        proof = certified(scaled, mapped, hinf_norm(scaled.close(mapped)), BELOW_ONE if mixed else None)
        open_doubt = proof.doubt
        if plant.model.is_discrete:  # the image of K differs from K by the rounding of the map
            open_doubt = open_doubt or certified(plant, K, hinf_norm(plant.close(K))).doubt
        if not open_doubt:
            return (beta * max(proof.gamma, 1.0) if mixed else proof.gamma), (), ""
        return max(best, beta * proof.gamma), (), open_doubt or doubt

    def _scaled(self, scalings: DynamicScalings, beta: float) -> GeneralizedPlant:
        """Return the scaled plant, D22 included."""
        whole = plant_at_level(self.bare.whole(), self.bare.sizes, scalings, beta).whole()
        whole.D[-self.plant.n_meas :, -self.plant.n_con :] = self._continuous.D22
        return GeneralizedPlant(StateSpaceModel(*whole), self.plant.n_meas, self.plant.n_con)

    def regularise(self, iterate: Iterate, share: float) -> None:
        """Add weak penalties on u and x and noises on y and x if the plant is singular for the Riccati equations."""
        if self._regular:
            return
        self.budget.spend(dense(iterate.loop.n_states + iterate.scalings.n_states, 4))
        _, _, n_u, _, n_y = self.bare.sizes
        out, into = 1 / self.scale.states, self.scale.states * self.scale.rate
        try:
            wide = self.bare.with_channels(1.0, 1.0, out, into)
            wide = plant_at_level(wide.whole(), wide.sizes, iterate.scalings, 1.0)
            K = with_direct_term(_mapped(iterate.K), -self._continuous.D22)
        except (InputError, NoTrustworthyNumber):
            return
        gains = channel_gains(trial_loop(wide, Realisation.of(K)), self.bare.sizes)
        if gains is None:
            return
        # Each channel gets about this share of the gain of the scaled loop; the smallest level rises by its square.
        level = share * iterate.level
        u, y, x_out, x_in = (level / np.maximum(g, level) for g in gains)  # at most one
        self.matrices = self.bare.with_channels(
            u / np.sqrt(n_u), y / np.sqrt(n_y), STATE_SHARE * x_out * out, STATE_SHARE * x_in * into
        )


def _mapped(model: StateSpaceModel) -> StateSpaceModel:
    return bilinear_to_continuous(model) if model.is_discrete else model
