"""Balanced truncation of the normalised coprime factors of a model, whose modes may be of any stability."""

from __future__ import annotations

import numpy as np

from robustlab.errors import NoTrustworthyNumber
from robustlab.linear_analysis.structural import least_order
from robustlab.norms import bilinear_to_discrete
from robustlab.statespace import StateSpaceModel
from robustlab.synthesis.reduction.balancing import Balancing, gramian_factors, lost_at_least_order
from robustlab.uncertainty.distances.coprime import continuous_models, coprime_factors

__all__ = ["CoprimeReduction"]


class CoprimeReduction:
    """Balanced truncation of the normalised right coprime factors of a model, continuous or discrete.

    Modes that are not stable and hidden from the inputs or outputs are removed before; ``lost`` is what that changes.
    """

    def __init__(self, full: StateSpaceModel) -> None:
        least = least_order(full)
        hides = any(not mode.stable for mode in least.hidden)
        self.removed = tuple(mode.meaning for mode in least.hidden) if hides else ()
        self.lost = lost_at_least_order(least) if hides else None
        self.full = least.model if hides else full
        self._mapped = continuous_models(self.full)
        self.factors = coprime_factors(self._mapped.models[0]).right
        self.balancing = Balancing.of(*gramian_factors(self.factors))

    def reduced_factors(self, order: int) -> StateSpaceModel:
        """``[N_r; M_r]`` in continuous time."""
        return self.balancing.reduced(self.factors, order, "truncation")

    def reduced(self, order: int) -> StateSpaceModel:
        """``N_r M_r^{-1}``."""
        small, p = self.reduced_factors(order), self.full.n_outputs
        n, m = (small.C[:p], small.D[:p]), (small.C[p:], small.D[p:])
        if small.n_inputs and np.linalg.cond(m[1]) > 1e12:
            raise NoTrustworthyNumber("reduce_model", "the factor M of the reduced model has no inverse")
        back = np.linalg.inv(m[1])
        gain, into = back @ m[0], small.B @ back
        model = StateSpaceModel(small.A - into @ m[0], into, n[0] - n[1] @ gain, n[1] @ back)
        if self.full.dt:
            model = bilinear_to_discrete(model, self.full.dt)
            if self._mapped.mirrored:
                model = StateSpaceModel(-model.A, -model.B, model.C, model.D, self.full.dt)
        return model
