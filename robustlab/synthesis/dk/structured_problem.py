"""A robust-performance problem whose controllers have a given structure: for given D a descent of its parameters."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from robustlab.arrays import AnyArray
from robustlab.budget import Budget
from robustlab.errors import InputError, NoTrustworthyNumber, did_you_mean
from robustlab.norms import bilinear_to_discrete
from robustlab.synthesis.dk.dynamic_scalings import DynamicScalings
from robustlab.synthesis.dk.robust_problem import Iterate, RobustProblem
from robustlab.synthesis.dk.tuning import DKTuning
from robustlab.synthesis.laws.controller_laws import Law, model_of
from robustlab.synthesis.laws.controller_structures import as_structure
from robustlab.synthesis.nonsmooth.design_problem import DesignProblem
from robustlab.synthesis.nonsmooth.parameter_search import central_path, multi_start, polished
from robustlab.synthesis.problem.partition import GeneralizedPlant
from robustlab.synthesis.problem.scaling import common_scaling


class StructuredProblem(RobustProblem):
    """See `RobustProblem`; an `Iterate` has the parameters of its controller, too.

    Parameters
    ----------
    plant, budget, tuning
        As there.
    structure
        As for `robustlab.fixed_structure`.
    starts, seed
        Random starts of the first search, for D = I.
    """

    def __init__(
        self, plant: GeneralizedPlant, structure: Any, starts: int, seed: int, budget: Budget, tuning: DKTuning
    ) -> None:
        super().__init__(plant, budget, tuning)
        rate = common_scaling([plant])[0].rate
        self.law: Law = as_structure(structure, rate).law(plant.measurements, plant.controls, plant.model.dt)
        self.starts, self.seed = starts, seed
        self._last: AnyArray = np.array([q.start for q in self.law.parameters], dtype=float)

    def values(self, iterate: Iterate) -> dict[str, float]:
        """The parameters of an iterate by name."""
        assert iterate.p is not None
        return {q.name: float(x) for q, x in zip(self.law.parameters, iterate.p, strict=True)}

    def first(self, given: Mapping[str, float] | None, scalings: DynamicScalings) -> list[Iterate]:
        """The best ends of a search from many starts for the plant without scalings, or what the given values make."""
        if given is not None:
            found = [self._given(given)]
        else:
            problem = DesignProblem([self.plant], self.law, "hinf", (), self.budget)
            ends = multi_start(problem, [], self.starts, self.seed, lambda _: None)
            found = [end.p for end in ends if np.isfinite(end.gamma)][: self.tuning.structured_ends]
        proved = [self._proved(p, scalings, 1.0) for p in found]
        return [iterate for iterate in proved if iterate is not None]

    def follow(self, iterate: Iterate) -> None:
        """Go on from this one."""
        assert iterate.p is not None
        self._last = iterate.p

    def solve(self, scalings: DynamicScalings, start: float) -> Iterate | None:
        """Descent of the scaled loop's norm from the parameters followed; those themselves where nothing is better."""
        scaled = self._scaled(scalings, 1.0)
        if self.plant.model.is_discrete:
            model = bilinear_to_discrete(scaled.model, self.plant.model.dt)
            scaled = GeneralizedPlant(model, scaled.n_meas, scaled.n_con)
        problem = DesignProblem([scaled], self.law, "hinf", (), self.budget)
        v = problem.variables(self._last)
        if np.isfinite(problem.norm(v)[0]):
            v, _ = central_path(problem, v, problem.tuning.barrier_known)
            p, _ = polished(problem, problem.parameters(v)[0])
            found = self._proved(p, scalings, start)
            if found is not None:
                self._last = p
                return found
        return self._proved(self._last, scalings, start)

    def softened(self, iterate: Iterate, limit: float) -> Iterate:
        """The iterate itself: its structure says how fast it may be."""
        return iterate

    def regularise(self, iterate: Iterate, share: float) -> None:
        """Nothing: a descent needs no regular plant."""

    def _proved(self, p: AnyArray, scalings: DynamicScalings, guess: float) -> Iterate | None:
        try:
            K = model_of(self.law, p, self.plant.model.dt)
        except (InputError, NoTrustworthyNumber):  # entries overflow
            return None
        found = self.proved(K, scalings, guess)
        if found is None:
            return None
        return replace(found, p=p)

    def _given(self, values: Mapping[str, float]) -> AnyArray:
        names = [q.name for q in self.law.parameters]
        p = self._last.copy()
        for name, value in values.items():
            if name not in names:
                where, known = f"synth dk: K0: parameter {name!r}", ", ".join(names[:20])
                raise InputError(where, "no such parameter", f"one of {known}", did_you_mean(name, names))
            p[names.index(name)] = float(value)
        return p
