r"""Smaller destabilising members, by driving one mode after the other to the axis inside a box of real parameters.

.. math:: \max_{|\delta_i| \le s} \; \mathrm{Re} \, \lambda_k (A + B \Delta (I - D \Delta)^{-1} C)

Where modes are lightly damped, two of them that meet somewhere inside the box may exchange their damping there, and
nothing at its centre tells so: paths from the nominal poles, as in `pole_migration`, pass by. Here modes are followed
from those of many members of a box that damp them least, by quasi-Newton steps with the exact derivative; the box is
slightly smaller than the smallest member known. The mode is told by its frequency, for the one of largest real part is
nearly always the slowest, whatever the others do. What is found is made smaller as far as that mode leads, and ends on
the axis exactly. Branch and bound asks for the same from the centres of the regions that it cannot prove.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

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
from robustlab.mu_analysis.tuning import TUNING, MuTuning
from robustlab.statespace import StateSpaceModel
from robustlab.uncertainty.blocks import Block, block_slices

__all__ = ["Mode", "ascended", "is_stable_member", "mode_next_to", "shrunk", "smaller_destabilising"]


@dataclass(frozen=True)
class Mode:
    """A pole of a member, and the derivative of its real part by each real block (n_blocks,); complex blocks: 0."""

    pole: complex
    slopes: Array


def mode_next_to(model: StateSpaceModel, blocks: Sequence[Block], values: Array, aim: complex) -> Mode | None:
    """The mode of the member with these entries (n_blocks,) whose pole is next to ``aim``; None: ill-posed."""
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
    return Mode(complex(poles[k]), np.array(slopes))


def _member_poles(model: StateSpaceModel, blocks: Sequence[Block], values: Array) -> ComplexArray:
    """Poles of the member with these entries; one at infinity where it is ill-posed."""
    a = np.real(perturbed_state_matrix(model, centre_matrix(blocks, values).astype(complex)))
    return np.linalg.eigvals(a).astype(complex) if np.isfinite(a).all() else np.array([complex(np.inf)])


def is_stable_member(model: StateSpaceModel, blocks: Sequence[Block], values: Array) -> bool:
    """Whether the member with these entries (n_blocks,) has its poles left of the axis."""
    return bool((_member_poles(model, blocks, values).real < 0).all())


def ascended(
    model: StateSpaceModel, blocks: Sequence[Block], start: Array, size: float, aim: complex, tuning: MuTuning = TUNING
) -> tuple[Array | None, int]:
    """The member of a box that quasi-Newton steps end at, None where it is stable; and how many they looked at.

    The pole next to the imaginary aim is followed by its frequency, from the entries ``start`` (n_blocks,).
    """
    from scipy.optimize import minimize

    first = mode_next_to(model, blocks, start, aim)
    if first is None:
        return None, 1
    unit = max(abs(first.pole.real), 1e-9 * abs(first.pole))
    place = aim

    def damping(point: Array) -> tuple[float, Array]:
        nonlocal place
        now = mode_next_to(model, blocks, point * size, place)
        if now is None:  # as bad as it gets: the line search turns back
            return 1e3, np.zeros(len(point))
        place = 1j * now.pole.imag
        return -now.pole.real / unit, -now.slopes * size / unit

    bounds = [(float(low), 1.0) for low in lowest(blocks)]
    options = {"maxiter": tuning.ascents_of_mode}
    found = minimize(damping, start / size, jac=True, method="L-BFGS-B", bounds=bounds, options=options)
    return (found.x * size if found.fun < 0 else None), 1 + found.nfev


def shrunk(
    model: StateSpaceModel, blocks: Sequence[Block], values: Array, budget: Budget, tuning: MuTuning = TUNING
) -> Array:
    """Entries (n_blocks,) of the smallest member that the unstable mode of this one leads to, a pole on the axis."""
    delta = centre_matrix(blocks, values).astype(complex)
    search = _Search(model, tuple(blocks), Destabilising(gauge(blocks, values), delta, complex(np.inf)), budget, tuning)
    search.follow(values)
    return block_entries(blocks, search.best.delta)


def smaller_destabilising(
    model: StateSpaceModel,
    blocks: Sequence[Block],
    worst: Destabilising,
    budget: Budget,
    seed: int = 0,
    tuning: MuTuning = TUNING,
) -> Destabilising:
    """A destabilising Delta of real blocks alone that is smaller than ``worst``, or ``worst`` where none was found.

    Parameters
    ----------
    model
        Stable continuous model with Delta channels (p, q).
    blocks
        Real scalars, repeated or not; sizes are shares of each side of their ranges.
    budget
        Where it is over, the search ends with what it has.
    seed
        Seed of the points where ascents begin.
    """
    return _Search(model, tuple(blocks), worst, budget, tuning).run(seed)


class _Search:
    """The smallest member so far, and the box that the next one is sought in."""

    def __init__(
        self,
        model: StateSpaceModel,
        blocks: tuple[Block, ...],
        worst: Destabilising,
        budget: Budget,
        tuning: MuTuning,
    ) -> None:
        self.model, self.blocks, self.budget, self.tuning = model, blocks, budget, tuning
        self.best, self.low = worst, lowest(blocks)
        self.size, self.all_real = gauge(blocks, block_entries(blocks, worst.delta)), all(b.interval for b in blocks)
        nominal = model.poles()
        self.frequencies = np.sort(nominal.imag[nominal.imag > 0])

    def run(self, seed: int) -> Destabilising:
        """From each nominal mode, then from members that are lightly damped already, until these lead to nothing."""
        rng = np.random.default_rng(seed)
        if np.isfinite(self.best.pole):
            self.follow(block_entries(self.blocks, self.best.delta) * (1 + 1e-9))
        reaches = self.tuning.ascent_reaches
        self._ascend_from(self._nominal_modes(), reaches[0])
        failed = 0
        while failed < self.tuning.ascent_rounds and self._may_go_on():
            reach = reaches[failed % len(reaches)]
            failed = 0 if self._ascend_from(self._least_damped(rng, reach), reach) else failed + 1
        return self.best

    def _may_go_on(self) -> bool:
        """Work is left. That it may end here is no news, for the search ends somewhere; a clock that ended it is."""
        return self.budget.left > 0 and not (self.budget.seconds_left <= 0 and self.budget.over)

    def _ascend_from(self, starts: list[tuple[Array, complex]], reach: float) -> bool:
        """Ascents from points of the unit set, each of the mode next to an aim; whether any led to smaller members.

        The box has the share ``reach`` of the smallest size known: a much smaller one hides less among more.
        """
        before = self.size
        for point, aim in starts:
            if not self._may_go_on():
                break
            size = self.size * reach
            found = self._ascent(size * point, size, aim)
            if found is not None:
                self.follow(found)
        return self.size < before * (1 - self.tuning.ascent_gain)

    def _nominal_modes(self) -> list[tuple[Array, complex]]:
        """Each mode of the nominal model, on its own way out."""
        starts = []
        for aim in 1j * self.frequencies:
            now = mode_next_to(self.model, self.blocks, np.zeros(len(self.blocks)), aim)
            slopes = np.zeros(len(self.blocks)) if now is None else now.slopes
            starts.append((self.tuning.ascent_first * np.where(slopes < 0, self.low, 1.0), aim))
        return starts

    def _least_damped(self, rng: np.random.Generator, reach: float) -> list[tuple[Array, complex]]:
        """Of random corners and points, for each mode the one that damps it least: the least damped, and some others.

        Modes are told by their order in frequency.
        """
        size = self.size * reach
        best: dict[int, tuple[float, Array, complex]] = {}
        for turn in range(self.tuning.ascent_members):
            share = rng.random(len(self.blocks))
            point = self.low + (1 - self.low) * (np.round(share) if turn % 2 else share)
            poles = self._poles(size * point)
            poles = poles[poles.imag > 0]
            for k, pole in enumerate(poles[np.argsort(poles.imag)]):
                damping = float(-pole.real / abs(pole))
                if k not in best or damping < best[k][0]:
                    best[k] = damping, point, 1j * float(pole.imag)
        met = [(point, aim) for _, point, aim in sorted(best.values(), key=lambda start: start[0])]
        least, others = met[: self.tuning.ascent_modes], met[self.tuning.ascent_modes :]
        picked = rng.permutation(len(others))[: self.tuning.ascent_modes]
        return least + [others[k] for k in picked]

    def _ascent(self, start: Array, size: float, aim: complex) -> Array | None:
        """`ascended` inside the box of this size, counted."""
        values, looks = ascended(self.model, self.blocks, start, size, aim, self.tuning)
        self._count(looks)
        return values

    def follow(self, values: Array) -> None:
        """Ever smaller members along the mode that was led across the axis, then to the axis exactly."""
        step = self.tuning.ascent_step
        values = self._at_crossing(values)
        while self._may_go_on():
            size = gauge(self.blocks, values)
            poles = self._poles(values)
            aim = 1j * abs(float(poles[poles.real.argmax()].imag))
            smaller = size * (1 - step)
            found = self._ascent(np.clip(values, smaller * self.low, smaller), smaller, aim)
            if found is not None:
                values = self._at_crossing(found)
            elif step == self.tuning.ascent_step and size < self.size / (1 - step):
                step = self.tuning.ascent_last_step
            else:
                break
        if gauge(self.blocks, values) > self.size * (1 + self.tuning.ascent_last_step):
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
        for _ in range(self.tuning.ascent_halvings):
            middle = (stable + unstable) / 2
            self._count()
            beyond = not is_stable_member(self.model, self.blocks, middle * values)
            stable, unstable = (stable, middle) if beyond else (middle, unstable)
        return unstable * values

    def _poles(self, values: Array) -> ComplexArray:
        self._count()
        return _member_poles(self.model, self.blocks, values)

    def _count(self, members: int = 1) -> None:
        """The work of so many members, as measured: eigenvalues with the vectors of one of them."""
        self.budget.spend(members * dense(self.model.n_states) // 4)
