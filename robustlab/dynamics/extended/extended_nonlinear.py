"""A nonlinear plant with effects, as a plant of its own."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from robustlab.arrays import Array
from robustlab.dynamics.extended.extended_equations import ExtendedEquations
from robustlab.dynamics.extended.nonlinear_steps import About, Drive, march, point_model, scaled, with_linear_parts
from robustlab.dynamics.extended.simulator import Simulator
from robustlab.dynamics.plant_contract import NonlinearPlant
from robustlab.dynamics.ports.motion_model import local_port_model
from robustlab.dynamics.tuning import TUNING
from robustlab.errors import InputError, NoTrustworthyNumber

__all__ = ["ExtendedNonlinearPlant"]

STILL = 1e-6  # rad, m, rad/s, m/s, A: a motion below it is none


@dataclass(frozen=True, eq=False, repr=False)
class ExtendedNonlinearPlant(ExtendedEquations):
    """A nonlinear plant with effects; made by `robustlab.dynamics.extended.extended_plant.with_effects`."""

    plant: NonlinearPlant
    changed: NonlinearPlant = field(init=False)  # the plant with the parameters that the effects give it

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "changed", scaled(self.plant, self.effects))

    def about(self, x: Array, seen: Array) -> About:
        """Rates, outputs and slopes of the plant at the point."""
        return point_model(self.changed, self.effects, x, seen)

    def turning(self, x: Array, seen: Array, forces: Mapping[str, float]) -> Array:
        """By differences of the exact models about the point, extrapolated."""
        own, n = len(self.plant.states), len(self.states)
        here, n_u = self.changed.local_models(x[None, :own], seen[None]), len(seen)
        steps = TUNING.position_step * np.maximum(np.abs(x[:own]), 1.0)
        shifts = np.concatenate([k * np.diag(steps) for k in (1.0, -1.0, 0.5, -0.5)])
        local = self.changed.local_models(x[:own] + shifts, np.tile(seen, (len(shifts), 1)))
        model = with_linear_parts(local_port_model(self.changed, local), self.effects)
        if model.A is local.A and not any(forces.values()):
            return np.zeros((n, n))
        entering = model.B[..., n_u:]
        rates = model.A @ x + entering @ here.rates[0] - (entering @ local.A) @ x[:own]
        for port, force in forces.items():
            rates = rates + force * model.ports[port].force
        up, down, near_up, near_down = rates.reshape(4, own, n)
        wide, narrow = ((a - b) / steps[:, None] for a, b in ((0.5 * up, 0.5 * down), (near_up, near_down)))
        return np.column_stack([((4.0 * narrow - wide) / 3.0).T, np.zeros((n, n - own))])

    def motion(
        self, u: Array, dt: float, t0: float, x0: Array, step: float | None, hold: Literal["zoh", "foh"] = "zoh"
    ) -> tuple[Array, Array]:
        """States and outputs, by `robustlab.dynamics.extended.nonlinear_steps`.

        The inputs are held from sample to sample, or go straight to the next one (not for a plant with effects on its
        inputs, which are given for held ones).

        Without a step the steps are halved, from 1 ms or the samples', until the states at the samples change by no
        more than ``TUNING.halved`` (1e-4), in root mean square, of the largest state of the same unit. What is left
        then is a third of that or less.

        Raises NoTrustworthyNumber: steps that many times shorter still change the motion; a motion that leaves what the
        plant can do.
        """
        if hold == "foh" and any(e.site.kind == "input" for e in self.effects):
            raise InputError(
                f"{self.name}: simulate", "inputs that are not held, with an effect on one", "hold = 'zoh'"
            )
        parts = max(1, int(np.ceil(dt / (step or TUNING.nominal_step) - 1e-9)))
        states, outputs = self._stepped(_drive(self, u, dt, t0, parts, hold), x0, None)
        if step is not None:
            return states[::parts], outputs[::parts]
        off = np.inf
        for _ in range(TUNING.most_halvings):
            coarse, parts = states, 2 * parts
            between = np.arange(len(u) * parts) / 2.0
            guess = np.column_stack([np.interp(between, np.arange(len(coarse)), column) for column in coarse.T])
            states, outputs = self._stepped(_drive(self, u, dt, t0, parts, hold), x0, guess)
            found, before = states[::parts], coarse[:: parts // 2]
            off = self._difference(found, before)
            if off <= TUNING.halved:
                return found, outputs[::parts]
        raise NoTrustworthyNumber(
            f"{self.name}: simulate",
            f"steps of {1e6 * dt / parts:.3g} us still change the motion by {off:.2g} of its size",
            None,
            "a step of your own, without error control: simulate(..., step=1e-4)",
        )

    def _stepped(self, drive: Drive, x0: Array, guess: Array | None) -> tuple[Array, Array]:
        """States and outputs at all steps of a drive."""
        own = len(self.plant.states)
        states = march(self.changed, self.effects, drive, self.whole_state(x0), guess)
        outputs = self.changed.outputs_along(states[:, :own], drive.mean - drive.rise).copy()
        for e in self.effects:
            if e.site.kind == "output":
                k = [s.name for s in self.outputs].index(e.site.name)
                outputs[:, k] = e.effect.output(outputs[None, :, k], e.values, drive.h)[0]
        return states, outputs

    def _difference(self, one: Array, other: Array) -> float:
        """Root mean square difference of two motions, as a share of the largest state of the same unit."""
        size, off = (np.sqrt(np.mean(motion**2, axis=0)) for motion in (one, one - other))
        units = np.array([s.unit for s in self.states])
        shares = (off[units == unit].max() / max(size[units == unit].max(), STILL) for unit in dict.fromkeys(units))
        return float(max(shares, default=0.0))

    def nearby(self, where: Mapping[str, Any]) -> tuple[Array, Mapping[str, Any]]:
        """The rest of the plant without force laws, and what is asked; a pose that is asked for holds the positions."""
        signals = {s.name for s in (*self.states, *self.inputs, *self.outputs)}
        given = {name: value for name, value in where.items() if name in signals}
        other = {name: value for name, value in where.items() if name not in signals}
        try:
            rest = self.changed.equilibrium(**where)
        except (InputError, NoTrustworthyNumber):
            if not other:
                return np.zeros(len(self.states) + len(self.inputs)), given
            rest = self.changed.equilibrium(**other)
        x, names = self.whole_state(rest.x).copy(), [s.name for s in self.states]
        joints = [p for p in self.plant.port_places if p.position]
        x[[names.index(p.name) for p in joints]] = 0.0  # not its rounding: that would be sliding
        if other and rest.pose is not None:
            given |= {p.position: x[names.index(p.position)] for p in joints}
        return np.concatenate([x, rest.u]), given


def _drive(plant: ExtendedNonlinearPlant, u: Array, dt: float, t0: float, parts: int, hold: str) -> Drive:
    """The inputs as the plant sees them in steps, ``parts`` of them a sample."""
    h = dt / parts
    if hold == "foh":
        between = np.arange(len(u) * parts + 1) / parts
        fine = np.column_stack([np.interp(between, np.arange(len(u)), column) for column in u.T])
        rise = 0.5 * np.diff(fine, axis=0)
        return Drive(fine[:-1] + rise, rise, h, t0)
    pairs, held = [(e.effect, e.site) for e in plant.effects], np.repeat(u, parts, axis=0)
    motion = np.zeros((2, len(plant.plant.states)))  # it steps nothing
    mean, rise = Simulator(plant.plant, pairs, held, h, sub=1, motion=motion).seen_input(
        [e.values for e in plant.effects]
    )
    return Drive(mean, rise, h, t0)
