"""A robust-performance problem: controllers for given scalings with their proofs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from robustlab.arrays import AnyArray
from robustlab.budget import Budget, dense
from robustlab.errors import InputError, NoTrustworthyNumber
from robustlab.mu_analysis.axis.intervals import AxisCover, Piece, loop_axis_claims
from robustlab.norms import bilinear_to_continuous, bilinear_to_discrete, hinf_norm
from robustlab.norms.numbers import ABOVE
from robustlab.statespace import StateSpaceModel
from robustlab.synthesis.dk.dynamic_scalings import DynamicScalings, plant_at_level, proved_level
from robustlab.synthesis.dk.riccati_level import LevelSearch
from robustlab.synthesis.hinf.search import channel_gains, trial_loop
from robustlab.synthesis.problem.certify import SHARES, certified
from robustlab.synthesis.problem.partition import GeneralizedPlant, PlantMatrices, Realisation
from robustlab.synthesis.problem.rebuilt_loop import named_controller, with_direct_term
from robustlab.synthesis.problem.scaling import equilibrated, paths_first
from robustlab.uncertainty.blocks import Block
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


@dataclass(frozen=True, eq=False)
class Iterate:
    """A controller with the level that its scalings prove."""

    K: StateSpaceModel  # for the given plant, D22 included
    loop: StateSpaceModel  # the closed loop rebuilt from it, mapped to continuous time where the plant is discrete
    scalings: DynamicScalings  # D, G whose scaled loop proves `level`
    level: float  # upper bound of mu at all frequencies

    @property
    def pace(self) -> float:
        """Largest modulus of the controller's poles."""
        return float(np.abs(self.K.poles()).max(initial=0.0))


class DKProof(NamedTuple):
    """A level of mu, the intervals that prove it (none: the scaled loop's norm), and the reason of a failed proof."""

    gamma: float
    pieces: tuple[Piece, ...]
    doubt: str


class RobustProblem:
    """Plant, structure and regularisation of a robust-performance synthesis."""

    def __init__(self, plant: GeneralizedPlant, budget: Budget) -> None:
        self.plant, self.budget = plant, budget
        self._continuous = GeneralizedPlant(_mapped(plant.model), plant.n_meas, plant.n_con)
        self.bare = self._continuous.matrices()
        self.matrices = self.bare
        self.scale = paths_first(self.bare)
        self._regular = min(self.scale.apply(self.bare).direct_sizes) > REGULAR

    def search(self, scalings: DynamicScalings, alternative: bool = False) -> LevelSearch:
        """Return the level search of scalings of this form; ``alternative``: with the other numerical scaling."""

        def at(theta: AnyArray, beta: float) -> PlantMatrices:
            return plant_at_level(self.matrices, scalings.with_parameters(theta), beta)

        scaled = at(scalings.parameters(), 1.0)
        units = equilibrated(scaled) if alternative else paths_first(scaled)
        return LevelSearch(at, units, self.budget)

    def solve(self, scalings: DynamicScalings, start: float) -> Iterate | None:
        """Return the controller of smallest proved level for given scalings; None where none was found."""
        best: Iterate | None = None
        for alternative in (False, True):
            level = self.search(scalings, alternative).smallest(scalings.parameters(), start, 1e-5)
            found = None if level is None else self.at_level(scalings, level.beta, alternative)
            if found is not None and (best is None or found.level < best.level):
                best = found
            if best is not None and level is not None and best.level <= level.beta * (1 + ACCEPTED):
                break
        return best

    def at_level(self, scalings: DynamicScalings, beta: float, alternative: bool = False) -> Iterate | None:
        """Return the controller of smallest proved level among those a little above the known smallest level."""
        search, best = self.search(scalings, alternative), None
        for share in BACKOFF:
            K = search.controller(scalings.parameters(), beta * (1 + share))
            found = None if K is None else self.closed(K, scalings, beta)
            if found is not None and (best is None or found.level < best.level):
                best = found
            if best is not None and best.level <= beta * (1 + share) * (1 + 1e-3):
                break
        return best

    def relaxed(self, iterate: Iterate, limit: float) -> Iterate:
        """Return the same scalings with the controller of slowest poles whose proved level is at most ``limit``."""
        if not iterate.level:  # the loop is zero
            return iterate
        search, best = self.search(iterate.scalings), iterate
        for share in SLACK_SHARES:
            level = iterate.level * (limit / iterate.level) ** share
            K = search.controller(iterate.scalings.parameters(), level)
            found = None if K is None or self.budget.over else self.closed(K, iterate.scalings, iterate.level)
            if found is not None and found.level <= limit and found.pace < best.pace:
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

    def certified(self, iterate: Iterate, blocks: tuple[Block, ...], cover: AxisCover) -> DKProof:
        """Prove mu by the checker: the level of the cover's intervals, or else that of the iterate's scalings."""
        plant, K, doubt, best = self.plant, iterate.K, "", iterate.level
        if cover.pieces and not cover.open and cover.beta < iterate.level:
            best, doubt = cover.beta, "pieces of the proof could not be joined"
            for claim in loop_axis_claims(plant.model, K, blocks, cover.beta * ABOVE, cover.pieces):
                found = check(claim, effort=AXIS_EFFORT)
                if found.outcome is Outcome.PROVED:
                    return DKProof(cover.beta, tuple(cover.pieces), "")
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
            return DKProof(beta * max(proof.gamma, 1.0) if mixed else proof.gamma, (), "")
        return DKProof(max(best, beta * proof.gamma), (), open_doubt or doubt)

    def _scaled(self, scalings: DynamicScalings, beta: float) -> GeneralizedPlant:
        """Return the scaled plant, D22 included."""
        model = plant_at_level(self.bare, scalings, beta).model()
        D, D22 = model.D.copy(), self._continuous.D22
        D[D.shape[0] - D22.shape[0] :, D.shape[1] - D22.shape[1] :] = D22
        return GeneralizedPlant(StateSpaceModel(model.A, model.B, model.C, D), self.plant.n_meas, self.plant.n_con)

    def regularise(self, iterate: Iterate, share: float) -> None:
        """Add weak penalties on u and x and noises on y and x if the plant is singular for the Riccati equations."""
        if self._regular:
            return
        self.budget.spend(dense(iterate.loop.n_states + iterate.scalings.n_states, 4))
        _, _, n_u, _, n_y = self.bare.sizes
        out, into = 1 / self.scale.states, self.scale.states * self.scale.rate
        try:
            wide = plant_at_level(self.bare.with_channels(1.0, 1.0, out, into), iterate.scalings, 1.0)
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
