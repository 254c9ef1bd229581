"""A nonlinear plant with effects about one point, and its simulation by iterated linearisation about its motion."""
# Hochbruck, Ostermann, "Exponential integrators", Acta Numerica 19 (2010) 209-286; Lelarasmee, Ruehli, Sangiovanni-
# Vincentelli, "The waveform relaxation method for time-domain analysis of large scale integrated circuits", IEEE Trans.
# CAD 1 (1982) 131-145.

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from robustlab.arrays import Array
from robustlab.dynamics.effects.contract import Law
from robustlab.dynamics.extended.attached_effect import AttachedEffect
from robustlab.dynamics.extended.simulator import Windows, step_laws
from robustlab.dynamics.plant_contract import LocalModels, NonlinearPlant
from robustlab.dynamics.ports.port_model import AnyPlant, Course, PortModel, exponentials, local_port_model, times
from robustlab.errors import InputError, NoTrustworthyNumber


class About(NamedTuple):
    """A plant with its linear effects at a point: model, rates (n_x,) without the laws, outputs (n_y,)."""

    model: PortModel
    rates: Array
    outputs: Array


def factors_of(plant: AnyPlant, effects: Iterable[AttachedEffect]) -> dict[str, float]:
    """Return plant parameter -> common factor of the effects."""
    factors: dict[str, float] = {}
    for e in effects:
        for name, factor in e.effect.factors(plant, e.site, e.values).items():
            factors[name] = factors.get(name, 1.0) * factor
    return factors


def scaled(plant: NonlinearPlant, effects: Iterable[AttachedEffect]) -> NonlinearPlant:
    """Return the plant with the parameters scaled by the effects."""
    changed = {name: plant.parameters[name].reference * f for name, f in factors_of(plant, effects).items()}
    return plant.with_parameters(**changed) if changed else plant


def with_linear_parts(model: PortModel, effects: Iterable[AttachedEffect]) -> PortModel:
    """Return the model extended by the linear parts of the effects."""
    for e in effects:
        model = e.effect.extend(model, e.site, e.values)
    return model


def load_coordinates(plant: NonlinearPlant, effects: Iterable[AttachedEffect]) -> Array:
    """Return rows (n_own, n_x) from all states to the plant's states in the coordinates of its load."""
    names, split = [s.name for s in plant.states], [e.site.name for e in effects if e.effect.structural]
    rows = np.eye(len(names), len(names) + 2 * len(split))
    for k, joint in enumerate(split):
        place = next(p for p in plant.port_places if p.name == joint)
        rows[names.index(joint), len(names) + 2 * k + 1] = -1.0
        if place.position:
            rows[names.index(place.position), len(names) + 2 * k] = -1.0
    return rows


def point_model(plant: NonlinearPlant, effects: Sequence[AttachedEffect], x: Array, u: Array) -> About:
    """Return the model about the state x (including effects) and effective inputs u."""
    at = load_coordinates(plant, effects) @ x
    model, entering, local = _about(plant, effects, at, u)
    rates = model.A @ x + model.B @ u + entering @ (local.rates[0] - local.A[0] @ at - local.B[0] @ u)
    return About(model, rates, local.outputs[0] + local.C[0] @ (x[: model.own] - at))


def generic_model(plant: NonlinearPlant, effects: Sequence[AttachedEffect]) -> PortModel:
    """Return the model about a point without symmetries (all states near 0.1), else the equilibrium, else zero."""
    changed = scaled(plant, effects)
    n, u = len(plant.states), np.zeros(len(plant.inputs))
    reason = ""
    for place in (lambda: 0.1 + 0.01 * np.arange(n), lambda: changed.equilibrium().x, lambda: np.zeros(n)):
        try:
            return _about(changed, effects, place(), u)[0]
        except NoTrustworthyNumber as error:
            reason = error.found
    raise InputError(f"{plant.name}: effects", f"no linear model at 0.1, at rest and at zero: {reason}", "one of them")


def _about(
    plant: NonlinearPlant, effects: Sequence[AttachedEffect], x: Array, u: Array
) -> tuple[PortModel, Array, LocalModels]:
    """Return the model with the effects, the input matrix of the plant's rates (n_x, n_own), and the plant's model."""
    local = plant.local_models(x[None], u[None])
    wide = with_linear_parts(local_port_model(plant, local), effects)
    ports = {name: replace(p, force=p.force[0] if p.force.ndim > 1 else p.force) for name, p in wide.ports.items()}
    b, entering = np.split(wide.B[0], [len(u)], axis=1)
    return PortModel(wide.A[0], b, wide.C[0], wide.D[0], ports, len(x)), entering, local


FIRST, MOST = 32, 256  # steps of a block
PASSES = 8  # iterations of a block before it is shortened
QUICK = 4  # iterations up to which the next block is lengthened
AGREED = 1e-8  # relative change in the last iteration; convergence is quadratic
LEAST = 1e-12  # rad, m, rad/s, m/s, A: rounding
GAUSS = 0.5 / 3.0**0.5  # distance of the Gauss points from the middle, in steps


@dataclass(frozen=True, eq=False)
class Drive:
    """Effective inputs in steps, ``mean + rise (2 tau/h - 1)``, (n, n_u) each; h, t0 in s."""

    mean: Array
    rise: Array
    h: float
    t0: float


def march(
    plant: NonlinearPlant, effects: Sequence[AttachedEffect], drive: Drive, x0: Array, guess: Array | None = None
) -> Array:
    """Simulate block by block; return states (n, n_x) at the beginnings of the steps."""
    laws = [law for e in effects for law in e.laws()]
    memory = np.zeros((len(laws), max([1, *(law.memory for law in laws)])))
    last = len(drive.mean) - 1
    states = np.empty((last + 1, len(x0)))
    states[0] = x0
    at, length = 0, FIRST if guess is None else MOST
    while at < last:
        count = min(length, last - at)
        block = _Block(plant, effects, laws, drive, at, count, memory)
        try:
            found, passes = block.settled(states[at], None if guess is None else guess[at : at + count + 1])
            words = "" if found is not None else "the motion over one step does not settle"
        except NoTrustworthyNumber as error:
            found, passes, words = None, PASSES, f"{error.where}: {error.found}"
        if found is None:
            if count == 1:
                time = drive.t0 + at * drive.h
                raise NoTrustworthyNumber(
                    f"{plant.name}: simulate",
                    f"no motion beyond t = {time:.6g} s: {words}",
                    None,
                    "shorter steps, or a motion within the machine's reach",
                )
            length = max(1, count // 4)
            continue
        reached = found[1:, : len(plant.states)]
        plant.check_reach(drive.t0 + drive.h * (at + 1 + np.arange(count)), reached)
        states[at : at + count + 1] = found
        memory = block.after
        at += count
        length = min(2 * count, MOST) if passes <= QUICK else count if passes < PASSES else max(1, count // 2)
    return states


@dataclass(eq=False)
class _Block:
    """A block of steps."""

    plant: NonlinearPlant
    effects: Sequence[AttachedEffect]
    laws: Sequence[Law]
    drive: Drive
    at: int
    count: int
    memory: Array  # of the laws before its first step

    def __post_init__(self) -> None:
        self.load_coordinates, self.after = load_coordinates(self.plant, self.effects), self.memory
        chosen = slice(self.at, self.at + self.count)
        self.mean, self.rise = self.drive.mean[chosen], self.drive.rise[chosen]

    def settled(self, start: Array, guess: Array | None) -> tuple[Array | None, int]:
        """Return states (count + 1, n_x), or None without convergence, and the number of iterations."""
        motion = start[None].repeat(self.count + 1, axis=0) if guess is None else guess
        before = np.inf
        for k in range(1, PASSES + 1):
            # The first iteration without a guess is about one point.
            found, speed = self._iterated(start, motion, self.count if guess is None and k == 1 else 1)
            if not np.isfinite(found).all():
                return None, k
            size = AGREED * (np.abs(found).max(axis=0) + speed * self.drive.h) + LEAST
            change = float((np.abs(found - motion).max(axis=0) / size).max())
            motion = found
            if change <= 1.0:
                if any(law.memory for law in self.laws):
                    self.after = self.memory.copy()
                    self._stepped(start, self.after, self.count)
                return found, k
            if k > 3 and change > before:
                return None, k
            before = change
        return None, PASSES

    def _iterated(self, start: Array, motion: Array, stride: int) -> tuple[Array, Array]:
        """Simulate the plant linearised about a motion; return states (count + 1, n_x) and the largest rates."""
        h, count, n_u, own = self.drive.h, self.count, self.mean.shape[1], len(self.plant.states)
        course = Course(self.plant, motion, self.mean, h)
        steps = np.arange(count)
        of = steps // stride
        x, u = course.at(np.minimum((np.arange(of[-1] + 1) + 0.5) * stride, count - 0.5))
        local = self.plant.local_models(x @ self.load_coordinates.T, u)
        model = with_linear_parts(local_port_model(self.plant, local), self.effects)
        halves = exponentials(model.A, 0.5 * h)
        parts = []
        if model.A is not local.A:
            entering, added = model.B[..., n_u:], model.A.copy()
            added -= entering @ local.A @ self.load_coordinates
            parts = [_with_differences(part) for part in (entering, added, model.B[..., :n_u] - entering @ local.B)]
        sides, size = [], np.zeros(model.A.shape[-1])
        for share in (-GAUSS, GAUSS):
            x, _ = course.at(steps + 0.5 + share)
            u = self.mean + 2.0 * share * self.rise
            rates = self.plant.rates_along(x @ self.load_coordinates.T, u)
            size[:own] = np.maximum(size[:own], np.abs(rates).max(axis=0))
            if parts:  # transformed by the effects
                enters, adds, drives = ((here + share * by + 0.5 * share**2 * twice)[of] for here, by, twice in parts)
                rates = times(enters, rates) + times(adds, x) + times(drives, u)
            sides.append(rates - times(model.A[of], x))
        phi, psi, ramp = (matrices[of] for matrices in halves)
        middle, rise = 0.5 * (sides[0] + sides[1]), (sides[1] - sides[0]) / (4.0 * GAUSS)
        turned = times(ramp, 0.5 * rise)
        first = times(psi, middle - 0.5 * rise) + turned
        second = times(psi, middle + 0.5 * rise) + turned
        drift = np.array([times(phi, first) + second, first, second])
        push = np.zeros((2, len(model.A), len(self.laws), model.A.shape[-1]))
        for j, law in enumerate(self.laws):
            here, by, twice = _with_differences(model.ports[law.port].force)
            for k, share in enumerate((-0.25, 0.25)):  # over the halves: mean, and half of the rise
                rising = 0.25 * by + 0.5 * share * twice
                push[k, :, j] = times(halves[1], here + share * by + twice / 24.0) + times(halves[2], rising)
        whole = push[0] @ np.swapaxes(halves[0], 1, 2) + push[1]
        phi = np.array([halves[0] @ halves[0], halves[0], halves[0]])
        push = np.array([whole, *push])
        rows = np.minimum(np.arange(-(-(count + 1) // stride)), phi.shape[1] - 1)
        if len(rows) > phi.shape[1]:  # one more step, for the state at the end
            phi, push = (np.ascontiguousarray(np.take(part, rows, axis=1)) for part in (phi, push))
        drift = np.concatenate([drift, drift[:, -1:]], axis=1)
        self._table = (phi, push, drift), model.ports, stride
        return self._stepped(start, self.memory.copy(), count + 1), size

    def _stepped(self, start: Array, memory: Array, length: int) -> Array:
        """Step; return states (length, n_x) at the beginnings of the steps, and update the memory."""
        (phi, push, drift), ports, stride = self._table
        no_input = np.zeros((*phi.shape[:3], 0))
        table = phi, no_input, push, np.ascontiguousarray(drift[:, :length]), stride
        inputs = np.zeros((self.at + length, 0)), self.drive.h, self.drive.t0, 1
        window = Windows(np.array([self.at], dtype=np.int64), length)
        return step_laws(self.laws, ports, table, inputs, window, start[None].copy(), phi.shape[-1], True, memory)[0][0]


def _with_differences(values: Array) -> tuple[Array, Array, Array]:
    """Return values (m, ...) and their first and second differences."""
    if len(values) < 3:
        return values, np.zeros_like(values), np.zeros_like(values)
    first = np.gradient(values, axis=0, edge_order=2)
    return values, first, np.gradient(first, axis=0, edge_order=2)
