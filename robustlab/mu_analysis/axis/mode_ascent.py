"""Smaller destabilising members, found by moving one mode after the other to the axis in a box of real parameters."""

# max Re lambda_k(A + B Delta (I - D Delta)^-1 C) over |delta_i| <= s, by quasi-Newton steps with the exact
# derivative. Where modes are lightly damped, two that meet inside the box may exchange their damping there, and paths
# from the nominal poles, as in pole_migration, miss it: on chains of 24 masses these were 16 and 278 % too large, this
# search 5 % (benchmarks/results/mu_axis.txt). The result for one mode is a local maximum among many, so the search
# restarts from the best of each with a few parameters redrawn, more often for less damped modes (iterated local search,
# Lourenço, Martin, Stützle 2003). A mode is identified by its frequency, because the one of largest real part is nearly
# always the slowest. Branch and bound makes the same ascent from the centres of regions.

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import chain
from typing import NamedTuple

import numpy as np

from robustlab.arrays import Array, ComplexArray
from robustlab.budget import Budget, dense
from robustlab.mu_analysis.axis.pole_migration import (
    Destabilising,
    descended,
    first_crossing,
    perturbed_state_matrix,
)
from robustlab.mu_analysis.matrix.box import block_entries, centre_matrix, gauge, lowest
from robustlab.mu_analysis.matrix.delta_layout import delta_layout
from robustlab.statespace import StateSpaceModel
from robustlab.uncertainty.blocks import Block, block_slices

ASCENT_REACH = 0.99  # size of the box of the search, relative to the smallest known member
FAILED_ASCENTS = 5  # unsuccessful ascents in a box, for each mode, that end a chain of them
ASCENT_CHAINS = 3  # consecutive unsuccessful chains that end the search
ASCENT_MODES = 5  # least damped modes that are restarted more often than the others
ASCENT_REDRAWN = 3  # most parameters redrawn for a restart
ASCENT_FIRST = 0.3  # share of the way to its own corner at which a nominal mode begins
ASCENT_STEP = 0.05  # share by which the box shrinks around a mode that has crossed the axis ...
ASCENT_LAST_STEP = 0.01  # ... and at the end
ASCENTS_OF_MODE = 30  # quasi-Newton steps of one ascent
ASCENT_HALVINGS = 20  # of the way from the nominal model to an unstable member


class Ascent(NamedTuple):
    """Entries (n_blocks,) of the member at the end of an ascent, its pole, and the number of members evaluated."""

    values: Array
    pole: complex
    looks: int


def _mode_next_to(
    model: StateSpaceModel, blocks: Sequence[Block], values: Array, aim: complex
) -> tuple[complex, Array] | None:
    """Return the pole next to ``aim`` of the member with these entries, and the derivatives of its real part."""
    delta = centre_matrix(blocks, values)
    a = np.real(perturbed_state_matrix(model, delta.astype(complex)))
    if not np.isfinite(a).all():
        return None
    poles, right = np.linalg.eig(a)
    k = int(np.argmin(np.abs(poles - aim)))
    left = np.linalg.solve(right.T + 1e-13 * np.eye(len(poles)), np.eye(len(poles))[k])
    z, w = model.C @ right[:, k], model.B.T @ left
    if model.D.any():
        z = np.linalg.solve(np.eye(model.n_outputs) - model.D @ delta, z)
        w = np.linalg.solve(np.eye(model.n_inputs) - (delta @ model.D).T, w)
    slopes = [
        (w[sw] * z[sz]).sum().real if b.interval else 0.0
        for b, (sw, sz) in zip(blocks, block_slices(blocks), strict=True)
    ]
    return complex(poles[k]), np.array(slopes)


def _member_poles(model: StateSpaceModel, blocks: Sequence[Block], values: Array) -> ComplexArray:
    """Return the poles of the member with these entries; one at infinity where it is ill-posed."""
    a = np.real(perturbed_state_matrix(model, centre_matrix(blocks, values).astype(complex)))
    return np.linalg.eigvals(a).astype(complex) if np.isfinite(a).all() else np.array([complex(np.inf)])


def is_stable_member(model: StateSpaceModel, blocks: Sequence[Block], values: Array) -> bool:
    """Return whether the member with these entries (n_blocks,) has its poles left of the axis."""
    return bool((_member_poles(model, blocks, values).real < 0).all())


def member_work(model: StateSpaceModel, members: int) -> int:
    """Return the measured work of this number of members: eigenvalues with the vectors of one of them."""
    return members * dense(model.n_states) // 4


def ascended(model: StateSpaceModel, blocks: Sequence[Block], start: Array, size: float, aim: complex) -> Ascent | None:
    """Maximise the real part of the pole next to the aim by quasi-Newton steps from ``start`` in a box of this size."""
    from scipy.optimize import minimize

    first = _mode_next_to(model, blocks, start, aim)
    if first is None:
        return None
    unit = max(abs(first[0].real), 1e-9 * abs(first[0]))
    place = aim

    def damping(point: Array) -> tuple[float, Array]:
        nonlocal place
        now = _mode_next_to(model, blocks, point * size, place)
        if now is None:  # worst value: the line search turns back
            return 1e3, np.zeros(len(point))
        place = 1j * now[0].imag
        return -now[0].real / unit, -now[1] * size / unit

    bounds = [(float(low), 1.0) for low in lowest(blocks)]
    options = {"maxiter": ASCENTS_OF_MODE}
    found = minimize(damping, start / size, jac=True, method="L-BFGS-B", bounds=bounds, options=options)
    return Ascent(found.x * size, complex(-found.fun * unit, abs(place.imag)), 1 + found.nfev)


def shrunk(model: StateSpaceModel, blocks: Sequence[Block], values: Array, budget: Budget) -> Array:
    """Return the entries (n_blocks,) of the smallest member found along the unstable mode, a pole on the axis."""
    delta = centre_matrix(blocks, values).astype(complex)
    search = _Search(model, tuple(blocks), Destabilising(gauge(blocks, values), delta, complex(np.inf)), budget)
    search.follow(values)
    return block_entries(blocks, search.best.delta)


def smaller_destabilising(
    model: StateSpaceModel,
    blocks: Sequence[Block],
    worst: Destabilising,
    budget: Budget,
    seed: int = 0,
) -> Destabilising:
    """Return a destabilising Delta of real blocks that is smaller than ``worst``, or ``worst`` where none was found."""
    return _Search(model, tuple(blocks), worst, budget).run(seed)


class _Search:
    """The smallest member so far, and the box of the next search."""

    def __init__(self, model: StateSpaceModel, blocks: tuple[Block, ...], worst: Destabilising, budget: Budget) -> None:
        self.model, self.blocks, self.budget = model, blocks, budget
        self.best, self.low = worst, lowest(blocks)
        self.size, self.all_real = gauge(blocks, block_entries(blocks, worst.delta)), all(b.interval for b in blocks)
        nominal = model.poles()
        self.frequencies = np.sort(nominal.imag[nominal.imag > 0])
        self.box = 0.0
        # Of each mode, by its order in frequency: its least damping in this box, and the point of the unit set.
        self.best_of_mode: dict[int, tuple[float, Array]] = {}

    def run(self, seed: int) -> Destabilising:
        """Search boxes slightly smaller than the smallest member until ASCENT_CHAINS consecutive chains fail."""
        rng, in_vain = np.random.default_rng(seed), 0
        if np.isfinite(self.best.pole):
            self.follow(block_entries(self.blocks, self.best.delta) * (1 + 1e-9))
        while in_vain < ASCENT_CHAINS and self._work_left():
            before, self.box, self.best_of_mode = self.size, self.size * ASCENT_REACH, {}
            for mode, point in chain(self._nominal_starts(), self._restarts(rng)):
                values = self._ascend_mode(mode, point) if self._work_left() else None
                if values is not None:
                    self.follow(values)
                    break
            in_vain = 0 if self.size < before else in_vain + 1
        return self.best

    def _nominal_starts(self) -> Iterator[tuple[int, Array]]:
        """Yield for each mode a point in the direction that destabilises the nominal mode."""
        for mode, aim in enumerate(1j * self.frequencies):
            now = _mode_next_to(self.model, self.blocks, np.zeros(len(self.blocks)), aim)
            slopes = np.zeros(len(self.blocks)) if now is None else now[1]
            yield mode, ASCENT_FIRST * np.where(slopes < 0, self.low, 1.0)

    def _work_left(self) -> bool:
        """Return whether work is left; record only the end by a time limit."""
        return self.budget.left > 0 and not (self.budget.seconds_left <= 0 and self.budget.over)

    def _restarts(self, rng: np.random.Generator) -> Iterator[tuple[int, Array]]:
        """Yield the best points of modes in this box with a few parameters redrawn; less damped modes more often."""
        for _ in range(FAILED_ASCENTS * len(self.frequencies)):
            order = sorted(self.best_of_mode, key=lambda mode: self.best_of_mode[mode][0])
            if not order:
                return
            mode = order[min(int(rng.exponential(ASCENT_MODES)), len(order) - 1)]
            point = self.best_of_mode[mode][1].copy()
            redrawn = rng.permutation(len(point))[: rng.integers(1, ASCENT_REDRAWN + 1)]
            point[redrawn] = rng.uniform(self.low[redrawn], 1.0)
            yield mode, point

    def _ascend_mode(self, mode: int, point: Array) -> Array | None:
        """Ascend with a mode, given by its order in frequency, from a point of the unit set; return an unstable end."""
        poles = self._modes(point)
        found = self._ascent(self.box * point, self.box, 1j * poles[mode].imag) if mode < len(poles) else None
        if found is None:
            return None
        damping = -found.pole.real / max(abs(found.pole), 1e-300)
        if mode not in self.best_of_mode or damping < self.best_of_mode[mode][0]:
            self.best_of_mode[mode] = damping, found.values / self.box
        return found.values if found.pole.real > 0 else None

    def _modes(self, point: Array) -> ComplexArray:
        """Return the poles of the upper half plane by frequency, at a point of the unit set."""
        poles = self._poles(self.box * point)
        poles = poles[poles.imag > 0]
        return poles[np.argsort(poles.imag)]

    def _ascent(self, start: Array, size: float, aim: complex) -> Ascent | None:
        found = ascended(self.model, self.blocks, start, size, aim)
        self.budget.spend(member_work(self.model, 1 if found is None else found.looks))
        return found

    def follow(self, values: Array) -> None:
        """Shrink an unstable member along its mode, then move it onto the axis exactly."""
        step = ASCENT_STEP
        values = self._at_crossing(values)
        while self._work_left():
            size = gauge(self.blocks, values)
            poles = self._poles(values)
            aim = 1j * abs(float(poles[poles.real.argmax()].imag))
            smaller = size * (1 - step)
            found = self._ascent(np.clip(values, smaller * self.low, smaller), smaller, aim)
            if found is not None and found.pole.real > 0:
                values = self._at_crossing(found.values)
            elif step == ASCENT_STEP and size < self.size / (1 - step):
                step = ASCENT_LAST_STEP
            else:
                break
        if gauge(self.blocks, values) > self.size * (1 + ASCENT_LAST_STEP):
            return
        delta = centre_matrix(self.blocks, values).astype(complex)
        lower = [descended(self.model, delta_layout(self.blocks), delta[None])[0]] if self.all_real else []
        for candidate in (*lower, delta):
            crossing = first_crossing(self.model, self.blocks, candidate)
            reached = np.inf if crossing is None else gauge(self.blocks, block_entries(self.blocks, crossing.delta))
            if crossing is not None and reached < self.size:
                self.best, self.size = crossing, reached
                break

    def _at_crossing(self, values: Array) -> Array:
        """Return the multiple (at most 1) of an unstable member at which a pole crosses, by bisection."""
        stable, unstable = 0.0, 1.0
        for _ in range(ASCENT_HALVINGS):
            middle = (stable + unstable) / 2
            beyond = not (self._poles(middle * values).real < 0).all()
            stable, unstable = (stable, middle) if beyond else (middle, unstable)
        return unstable * values

    def _poles(self, values: Array) -> ComplexArray:
        self.budget.spend(member_work(self.model, 1))
        return _member_poles(self.model, self.blocks, values)
