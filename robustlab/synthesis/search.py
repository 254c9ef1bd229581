"""Search for a controller of small verified gamma over regularisations of one scaled generalised plant.

Most practical plants are singular for the two Riccati equations: D12 or D21 has no full rank, or there are zeros on
the imaginary axis. Each trial adds small penalties on u and x and small noises on y and x, solves that regular
problem, and judges its controller by the norm of the loop rebuilt on the plant as it was given.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robustlab.errors import InputError, NoTrustworthyNumber
from robustlab.frequency import frequency_response
from robustlab.norms import HinfNorm
from robustlab.result import Status
from robustlab.statespace import StateSpaceModel, lower_lft
from robustlab.synthesis.partition import PlantMatrices
from robustlab.synthesis.scaling import Scaling
from robustlab.synthesis.two_riccati import TwoRiccatiProblem

__all__ = ["Candidate", "Deadline", "Regularisation", "Search"]

Array = NDArray[Any]

LADDER = (1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7)
# A central controller at gamma itself is ill-conditioned: gamma is backed off until the verified norm agrees.
BACKOFF = (1e-4, 1e-3, 1e-2, 3e-2, 0.1)
# Shares of the closed loop's gain that the self-scaled regularisation may cost; the optimum rises by their squares.
SHARES = (0.2, 0.1, 0.05, 0.02, 0.01)
SELF_SCALED_STEPS = 14
IMPROVEMENT = 5e-4
REGULAR = 1e-6
SOFTENING_ROUNDS, SOFTENING_STEPS = 3, 6


class Deadline:
    """A time limit on the monotonic clock, asked between steps."""

    def __init__(self, seconds: float) -> None:
        self._end = time.monotonic() + seconds

    def passed(self) -> bool:
        """True when the time is up."""
        return time.monotonic() >= self._end


@dataclass(frozen=True, eq=False)
class Regularisation:
    """Weights of the added channels in scaled units: on u (per control), noise on y (per measurement), on x, into x."""

    u: Array | float = 0.0
    y: Array | float = 0.0
    x_out: float = 0.0
    x_in: float = 0.0

    def apply(self, plant: PlantMatrices) -> PlantMatrices:
        """The regularised plant."""
        if not any(np.any(part) for part in (self.u, self.y, self.x_out, self.x_in)):
            return plant
        return plant.with_channels(self.u, self.y, self.x_out, self.x_in)


@dataclass(frozen=True, eq=False)
class Candidate:
    """A verified controller.

    Attributes
    ----------
    K
        In the units and the time domain of the plant as given, D22 included.
    K_bare
        For the continuous plant without D22.
    norm
        Norm of the loop rebuilt on the plant as given.
    decay
        Decay rate of that loop's slowest mode in 1/s.
    """

    K: StateSpaceModel
    K_bare: StateSpaceModel
    norm: HinfNorm
    decay: float

    @property
    def gamma(self) -> float:
        """Proved upper bound of the closed loop's norm."""
        return self.norm.upper

    @property
    def pace(self) -> float:
        """Largest modulus of the poles of the continuous controller: what makes it hard to build."""
        return float(np.abs(self.K_bare.poles()).max(initial=0.0))

    @property
    def stiffness(self) -> float:
        """Fastest controller pole over slowest mode of the loop: the span of time scales that K brings in."""
        return self.pace / self.decay


class Search:
    """Trials on one scaled plant; every verified controller is kept.

    Parameters
    ----------
    plant
        Continuous plant without D22.
    scaling
        Its scaling.
    verify
        Takes a controller for ``plant`` and returns it verified on the plant as given, or None where that loop is
        unstable.
    """

    def __init__(
        self,
        plant: PlantMatrices,
        scaling: Scaling,
        verify: Callable[[StateSpaceModel], Candidate | None],
        deadline: Deadline,
    ) -> None:
        self.scaling, self.plant = scaling, scaling.apply(plant)
        self.verify, self.deadline = verify, deadline
        self.candidates: list[Candidate] = []

    @property
    def best(self) -> Candidate | None:
        """The candidate of smallest gamma, certified ones before others."""
        return smallest(self.candidates)

    def run(self) -> None:
        """Ladder of regularisations first, then regularisations scaled by the best loop so far."""
        settled = self._ladder()
        self._self_scaled(SHARES[2:4] if settled else SHARES)

    def _ladder(self) -> bool:
        """True where the plant is regular and its own optimum was verified."""
        s_u = np.linalg.svd(self.plant.D12, compute_uv=False)
        s_y = np.linalg.svd(self.plant.D21, compute_uv=False)
        _, n_w, n_u, n_z, n_y = self.plant.sizes
        size_u = float(s_u.min()) if n_z >= n_u else 0.0
        size_y = float(s_y.min()) if n_w >= n_y else 0.0
        if size_u > REGULAR and size_y > REGULAR:
            gamma, found = self._trial(Regularisation(), 1.0)
            if found is not None and gamma is not None and found.gamma <= 1.001 * gamma:
                return True
        worse, best = 0, np.inf
        for eps in LADDER:
            if self.deadline.passed():
                break
            u = 0.0 if size_u > max(REGULAR, eps) else eps
            y = 0.0 if size_y > max(REGULAR, eps) else eps
            _, found = self._trial(Regularisation(u, y, eps / 10, eps / 10), 1.0)
            if found is None:
                continue
            worse = worse + 1 if found.gamma > 0.95 * best else 0
            best = min(best, found.gamma)
            if worse == 2:
                break
        return False

    def _self_scaled(self, shares: tuple[float, ...]) -> None:
        k = 0
        for _ in range(SELF_SCALED_STEPS):
            before = self.best
            if before is None or k == len(shares) or self.deadline.passed() or before.gamma <= 0:
                return
            regularisation = self._relative(before, shares[k], 0.3)
            if regularisation is None:
                return
            self._trial(regularisation, before.gamma * self.scaling.gain)
            after = self.best
            if after is not None and after.gamma >= before.gamma * (1 - IMPROVEMENT):
                k += 1

    def soften(self, start: Candidate, gamma: float) -> None:
        """Look for saner controllers up to this verified gamma: slower poles, and no needlessly slow modes of the loop.

        The added channels are made as large as the test at this gamma allows. Once with all of them relative to the
        gains of the loop; and once after half of the slack has gone into an x disturbance and penalty of fixed size,
        because a mode that w does not excite (an integrator of the plant, behind a reference) otherwise stays in the
        loop as slow as it is.
        """
        self._slowest_poles(start, gamma, 0.0)
        half = 0.5 * (start.gamma + gamma)
        low, high, size = 1e-4, 1e2, 0.0
        for _ in range(SOFTENING_STEPS):
            if self.deadline.passed():
                return
            middle = float(np.sqrt(low * high))
            base = self._relative(start, SHARES[2], 0.0)
            if base is not None and self._found_within(replace(base, x_out=middle, x_in=middle), half) is not None:
                low = size = middle
            else:
                high = middle
        if size > 0:
            self._slowest_poles(start, gamma, size)

    def _slowest_poles(self, start: Candidate, gamma: float, x: float) -> None:
        """Largest relative weights by bisection, up to three times, because their scale follows the loop found last."""
        for _ in range(SOFTENING_ROUNDS):
            low, high, softest = 1e-2, 10.0, None
            for _ in range(SOFTENING_STEPS):
                if self.deadline.passed():
                    return
                middle = float(np.sqrt(low * high))
                weights = self._relative(start, middle, 0.0 if x else 0.1, 3.0)
                if weights is not None and x:
                    weights = replace(weights, x_out=x, x_in=x)
                found = None if weights is None else self._found_within(weights, gamma)
                if found is not None:
                    low, softest = middle, found
                else:
                    high = middle
            if softest is None or softest.pace > 0.9 * start.pace:
                return
            start = softest

    def _found_within(self, weights: Regularisation, gamma: float) -> Candidate | None:
        """The central controller of this regularisation at gamma, where it exists and verifies at most gamma."""
        try:
            problem = TwoRiccatiProblem(weights.apply(self.plant))
        except NoTrustworthyNumber:
            return None
        found = self._central(problem, gamma * self.scaling.gain * (1 - 1e-6))
        return found if found is not None and found.gamma <= gamma else None

    def _relative(self, loop: Candidate, share: float, state_share: float, cap: float = 1.0) -> Regularisation | None:
        """Added channels that each carry about ``share`` of the gain of this loop."""
        gains = self._channel_gains(loop)
        if gains is None:
            return None
        gamma = loop.gamma * self.scaling.gain
        u, y, x_out, x_in = (gamma / np.maximum(g, gamma * share / cap) for g in gains)
        return Regularisation(
            share * u / np.sqrt(len(u)),
            share * y / np.sqrt(len(y)),
            float(state_share * share * x_out),
            float(state_share * share * x_in),
        )

    def _channel_gains(self, loop: Candidate) -> tuple[Array, Array, Array, Array] | None:
        """Peak gains in scaled units on a grid: w to each u, noise on each y to z, w to x, x disturbance to z."""
        n, n_w, n_u, n_z, n_y = self.plant.sizes
        try:
            model = self.plant.with_channels(1.0, 1.0, 1.0, 1.0).model()
            closed = lower_lft(model, self.scaling.controller_from_plant(loop.K_bare))
            size = np.abs(closed.poles())
            size = size[size > 0]
            omega = (
                np.concatenate([[0.0], size, np.geomspace(size.min() / 3, size.max() * 3, 100)]) if len(size) else [0.0]
            )
            response = frequency_response(closed, omega)
        except (InputError, NoTrustworthyNumber):
            return None
        if not np.isfinite(response).all():
            return None
        size_of = np.linalg.norm
        u = size_of(response[:, n_z : n_z + n_u, :n_w], axis=2).max(axis=0)
        y = size_of(response[:, :n_z, n_w : n_w + n_y], axis=1).max(axis=0)
        x_out = size_of(response[:, n_z + n_u :, :n_w], 2, axis=(1, 2)).max(initial=0.0) if n and n_w else 0.0
        x_in = size_of(response[:, :n_z, n_w + n_y :], 2, axis=(1, 2)).max(initial=0.0) if n and n_z else 0.0
        return u, y, np.asarray(x_out), np.asarray(x_in)

    def _trial(self, regularisation: Regularisation, start: float) -> tuple[float | None, Candidate | None]:
        """Smallest gamma of the regularised problem in the plant's units, and the best controller verified for it."""
        try:
            problem = TwoRiccatiProblem(regularisation.apply(self.plant))
        except NoTrustworthyNumber:
            return None, None
        gamma = problem.smallest_gamma(start, self.deadline.passed)
        if gamma is None:
            return None, None
        found: list[Candidate] = []
        for backoff in BACKOFF:
            candidate = self._central(problem, gamma * (1 + backoff))
            if candidate is None:
                continue
            found.append(candidate)
            if candidate.gamma <= gamma / self.scaling.gain * (1 + backoff) * 1.001:
                break
        return gamma / self.scaling.gain, smallest(found)

    def _central(self, problem: TwoRiccatiProblem, gamma: float) -> Candidate | None:
        pair = problem.solve(gamma)
        if pair is None:
            return None
        try:
            K = self.scaling.controller_to_plant(problem.central_controller(pair))
        except (NoTrustworthyNumber, InputError):  # InputError: entries overflow when scaled back
            return None
        candidate = self.verify(K)
        if candidate is not None:
            self.candidates.append(candidate)
        return candidate


def smallest(candidates: list[Candidate]) -> Candidate | None:
    """The candidate of smallest gamma; one whose norm is certified goes before one whose norm lost digits."""
    order = {Status.CERTIFIED: 0}
    return min(candidates, key=lambda c: (order.get(c.norm.status, 1), c.gamma), default=None)
