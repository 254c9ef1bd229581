"""Smaller destabilising members, by driving one mode after the other to the axis inside a box of real parameters."""

# max Re lambda_k(A + B Delta (I - D Delta)^-1 C) over |delta_i| <= s, by quasi-Newton steps with the exact
# derivative. Where modes are lightly damped, two that meet inside the box may exchange their damping there, and paths
# from the nominal poles, as in pole_migration, pass by: on chains of 24 masses these missed by 16 and 278 %, this by
# 5 (benchmarks/results/mu_axis.txt). What comes of one mode is a local maximum among many, so the search goes on from
# the best of each: a few parameters are thrown anew and the ascent is made again, more often for modes that are less
# damped by now (iterated local search, Lourenço, Martin, Stützle 2003). A mode is told by its frequency, for the one
# of largest real part is nearly always the slowest. Branch and bound asks for the same from the centres of regions.

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

ASCENT_REACH = 0.99  # of the smallest member known, the box in which a smaller one is sought
ASCENTS_IN_VAIN = 5  # as many ascents in a box, for each mode, without anything smaller end a chain of them ...
ASCENT_CHAINS = 3  # ... and so many chains in a row the search
ASCENT_MODES = 5  # so many least damped modes go on from their best more often than the others
ASCENT_THROWN = 3  # so many parameters at most are thrown anew for that
ASCENT_FIRST = 0.3  # share of the way to its own corner at which a nominal mode begins
ASCENT_STEP = 0.05  # share by which the box shrinks around a mode that was led across the axis ...
ASCENT_LAST_STEP = 0.01  # ... and at the end
ASCENTS_OF_MODE = 30  # quasi-Newton steps of one ascent
ASCENT_HALVINGS = 20  # of the way from the nominal model to an unstable member


class Ascent(NamedTuple):
    """Entries (n_blocks,) of the member that an ascent ended at, its pole, and how many members were looked at."""

    values: Array
    pole: complex
    looks: int


def _mode_next_to(
    model: StateSpaceModel, blocks: Sequence[Block], values: Array, aim: complex
) -> tuple[complex, Array] | None:
    """The pole next to ``aim`` of the member with these entries, and the derivative of its real part by each."""
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
    """Poles of the member with these entries; one at infinity where it is ill-posed."""
    a = np.real(perturbed_state_matrix(model, centre_matrix(blocks, values).astype(complex)))
    return np.linalg.eigvals(a).astype(complex) if np.isfinite(a).all() else np.array([complex(np.inf)])


def is_stable_member(model: StateSpaceModel, blocks: Sequence[Block], values: Array) -> bool:
    """Whether the member with these entries (n_blocks,) has its poles left of the axis."""
    return bool((_member_poles(model, blocks, values).real < 0).all())


def member_work(model: StateSpaceModel, members: int) -> int:
    """The work of so many members, as measured: eigenvalues with the vectors of one of them."""
    return members * dense(model.n_states) // 4


def ascended(model: StateSpaceModel, blocks: Sequence[Block], start: Array, size: float, aim: complex) -> Ascent | None:
    """Where quasi-Newton steps from ``start`` end, in a box of this size, that follow the pole next to the aim."""
    from scipy.optimize import minimize

    first = _mode_next_to(model, blocks, start, aim)
    if first is None:
        return None
    unit = max(abs(first[0].real), 1e-9 * abs(first[0]))
    place = aim

    def damping(point: Array) -> tuple[float, Array]:
        nonlocal place
        now = _mode_next_to(model, blocks, point * size, place)
        if now is None:  # as bad as it gets: the line search turns back
            return 1e3, np.zeros(len(point))
        place = 1j * now[0].imag
        return -now[0].real / unit, -now[1] * size / unit

    bounds = [(float(low), 1.0) for low in lowest(blocks)]
    options = {"maxiter": ASCENTS_OF_MODE}
    found = minimize(damping, start / size, jac=True, method="L-BFGS-B", bounds=bounds, options=options)
    return Ascent(found.x * size, complex(-found.fun * unit, abs(place.imag)), 1 + found.nfev)


def shrunk(model: StateSpaceModel, blocks: Sequence[Block], values: Array, budget: Budget) -> Array:
    """Entries (n_blocks,) of the smallest member that the unstable mode of this one leads to, a pole on the axis."""
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
    """A destabilising Delta of real blocks alone that is smaller than ``worst``, or ``worst`` where none was found."""
    return _Search(model, tuple(blocks), worst, budget).run(seed)


class _Search:
    """The smallest member so far, and the box that the next one is sought in."""

    def __init__(self, model: StateSpaceModel, blocks: tuple[Block, ...], worst: Destabilising, budget: Budget) -> None:
        self.model, self.blocks, self.budget = model, blocks, budget
        self.best, self.low = worst, lowest(blocks)
        self.size, self.all_real = gauge(blocks, block_entries(blocks, worst.delta)), all(b.interval for b in blocks)
        nominal = model.poles()
        self.frequencies = np.sort(nominal.imag[nominal.imag > 0])
        self.box = 0.0
        # Of each mode, by its order in frequency: its least damping met in this box, and the point of the unit set.
        self.led: dict[int, tuple[float, Array]] = {}

    def run(self, seed: int) -> Destabilising:
        """In boxes slightly smaller than the smallest member, until so many chains of ascents in a row were in vain."""
        rng, in_vain = np.random.default_rng(seed), 0
        if np.isfinite(self.best.pole):
            self.follow(block_entries(self.blocks, self.best.delta) * (1 + 1e-9))
        while in_vain < ASCENT_CHAINS and self._may_go_on():
            before, self.box, self.led = self.size, self.size * ASCENT_REACH, {}
            for mode, point in chain(self._ways_out(), self._thrown(rng)):
                values = self._led(mode, point) if self._may_go_on() else None
                if values is not None:
                    self.follow(values)
                    break
            in_vain = 0 if self.size < before else in_vain + 1
        return self.best

    def _ways_out(self) -> Iterator[tuple[int, Array]]:
        """For each mode a point on the nominal mode's own way to the axis."""
        for mode, aim in enumerate(1j * self.frequencies):
            now = _mode_next_to(self.model, self.blocks, np.zeros(len(self.blocks)), aim)
            slopes = np.zeros(len(self.blocks)) if now is None else now[1]
            yield mode, ASCENT_FIRST * np.where(slopes < 0, self.low, 1.0)

    def _may_go_on(self) -> bool:
        """Work is left. That it may end here is no news, for the search ends somewhere; a clock that ended it is."""
        return self.budget.left > 0 and not (self.budget.seconds_left <= 0 and self.budget.over)

    def _thrown(self, rng: np.random.Generator) -> Iterator[tuple[int, Array]]:
        """Where modes have come to in this box, with a few parameters thrown anew; less damped ones more often."""
        for _ in range(ASCENTS_IN_VAIN * len(self.frequencies)):
            order = sorted(self.led, key=lambda mode: self.led[mode][0])
            if not order:
                return
            mode = order[min(int(rng.exponential(ASCENT_MODES)), len(order) - 1)]
            point = self.led[mode][1].copy()
            thrown = rng.permutation(len(point))[: rng.integers(1, ASCENT_THROWN + 1)]
            point[thrown] = rng.uniform(self.low[thrown], 1.0)
            yield mode, point

    def _led(self, mode: int, point: Array) -> Array | None:
        """Lead a mode, told by its order in frequency, from a point of the unit set; its end where that is unstable."""
        poles = self._modes(point)
        found = self._ascent(self.box * point, self.box, 1j * poles[mode].imag) if mode < len(poles) else None
        if found is None:
            return None
        damping = -found.pole.real / max(abs(found.pole), 1e-300)
        if mode not in self.led or damping < self.led[mode][0]:
            self.led[mode] = damping, found.values / self.box
        return found.values if found.pole.real > 0 else None

    def _modes(self, point: Array) -> ComplexArray:
        """Poles of the upper half plane by their frequency, at a point of the unit set."""
        poles = self._poles(self.box * point)
        poles = poles[poles.imag > 0]
        return poles[np.argsort(poles.imag)]

    def _ascent(self, start: Array, size: float, aim: complex) -> Ascent | None:
        found = ascended(self.model, self.blocks, start, size, aim)
        self.budget.spend(member_work(self.model, 1 if found is None else found.looks))
        return found

    def follow(self, values: Array) -> None:
        """Ever smaller members along the mode that was led across the axis, then to the axis exactly."""
        step = ASCENT_STEP
        values = self._at_crossing(values)
        while self._may_go_on():
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
        """The part of an unstable member, up to the whole, at which a pole crosses, by bisection."""
        stable, unstable = 0.0, 1.0
        for _ in range(ASCENT_HALVINGS):
            middle = (stable + unstable) / 2
            beyond = not (self._poles(middle * values).real < 0).all()
            stable, unstable = (stable, middle) if beyond else (middle, unstable)
        return unstable * values

    def _poles(self, values: Array) -> ComplexArray:
        self.budget.spend(member_work(self.model, 1))
        return _member_poles(self.model, self.blocks, values)
