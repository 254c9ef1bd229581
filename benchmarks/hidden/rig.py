"""A machine on its test rig: runs of it, clean or measured, in open or closed loop."""

from __future__ import annotations

import zlib
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from robustlab import Record

from .effects import EFFECTS, OUTSIDE_EFFECTS
from .machine import Array, Machine, Run, simulate
from .plants import LEVELS, Setup
from .sensors import noise

__all__ = ["ALL_EFFECTS", "Rig", "generator"]

ALL_EFFECTS = {**EFFECTS, **OUTSIDE_EFFECTS}


def generator(seed: int, *names: object) -> np.random.Generator:
    """Random numbers that belong to the seed and the names, and to nothing else."""
    return np.random.default_rng([seed, zlib.crc32("/".join(str(name) for name in names).encode())])


@dataclass(frozen=True)
class Rig:
    """The true machine, the machine without its effects, and the sensors' noise level."""

    setup: Setup
    machine: Machine
    bare: Machine
    parameters: Mapping[str, Mapping[str, float]]
    seed: int
    level: str
    dt: float
    feedback: tuple[float, float, float] | None = None

    def clean(self, u: Array, *, effects: bool = True) -> Run:
        """Answer to the voltage u (n,) without noise or disturbance, in open loop."""
        load, alive = self._by_the_clock(len(u))
        if not effects:
            return simulate(self.bare, u, self.dt)
        return simulate(self.machine, u, self.dt, external=load, alive=alive)

    def measured(self, u: Array, run: int, *, closed: bool = False) -> Run:
        """Answer to the voltage u (n,), or in closed loop to the reference u, with the noise of this run."""
        n = len(u)
        load, alive = self._by_the_clock(n)
        draws = generator(self.seed, "noise", *self.parameters, run)
        drawn = noise(LEVELS[self.level], self.setup, n, self.dt, draws)
        return simulate(
            self.machine,
            u,
            self.dt,
            external=load + drawn.torque,
            alive=alive,
            angle_noise=drawn.angle,
            current_noise=drawn.current,
            lsb=drawn.lsb,
            feedback=self.feedback if closed else None,
        )

    def channels(self, run: Run, current: bool) -> dict[str, Array]:
        """The outputs that the user sees, name -> (n,)."""
        outputs = {self.setup.output: run.y}
        return {**outputs, "i": run.i} if current else outputs

    def record(self, run: Run, name: str, current: bool) -> Record:
        """A run as a `Record` with units."""
        outputs = self.channels(run, current)
        units = {"u": "V", self.setup.output: self.setup.unit} | ({"i": "A"} if current else {})
        return Record(np.arange(len(run.u)) * self.dt, {"u": run.u}, outputs, units, name)

    def _by_the_clock(self, n: int) -> tuple[Array, Array]:
        load, alive = np.zeros(n), np.ones(n)
        for name, parameters in self.parameters.items():
            clock = ALL_EFFECTS[name].by_the_clock
            if clock is not None:
                line = clock(dict(parameters), n, self.dt)
                load, alive = load + line.load, alive * line.alive
        return load, alive
