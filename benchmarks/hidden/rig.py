"""A machine on its test rig: runs of it, clean or measured, in open or closed loop."""

from __future__ import annotations

import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from robustlab import Record

from .effects import ALL_EFFECTS
from .machine import Array, Machine, Run, simulate
from .plants import LEVELS, Setup
from .sensors import Noise, noise


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

    def clean(self, u: Array, run: int = 0) -> Run:
        """Answer to an input without noise or disturbance, in open loop."""
        load, alive = self._by_the_clock(len(u))
        return simulate(self._in_phase(run), u, self.dt, external=load, alive=alive)

    def _in_phase(self, run: int) -> Machine:
        """The machine as a run finds it: no run waits for the mains."""
        m = self.machine
        if m.rip == 0.0 or run == 0:
            return m
        return m._replace(rip_a=m.rip_a + generator(self.seed, "mains", run).uniform(0, 2 * np.pi))

    def measured(self, u: Array, run: int, *, closed: bool = False) -> tuple[Run, Noise]:
        """Answer to an input, or in closed loop to the reference u, with the noise of this run."""
        n = len(u)
        load, alive = self._by_the_clock(n)
        draws = generator(self.seed, "noise", *self.parameters, run)
        drawn = noise(LEVELS[self.level], self.setup, n, self.dt, draws)
        sensors: dict[str, Any] = {"angle_noise": drawn.angle, "current_noise": drawn.current, "lsb": drawn.lsb}
        around = {"external": load + drawn.torque, "alive": alive, "feedback": self.feedback if closed else None}
        got = simulate(self._in_phase(run), u, self.dt, **sensors, **around)
        return got, drawn

    def channels(self, run: Run, current: bool, drawn: Noise | None = None) -> dict[str, Array]:
        """The outputs that the user sees, name -> (n,); the second coordinate's noise is added here."""
        outputs = {self.setup.output: run.y}
        if self.setup.second:
            second = run.load_phi
            if drawn is not None:
                second = np.round((second + drawn.second) / drawn.lsb) * drawn.lsb
            outputs[self.setup.second] = second
        return {**outputs, "i": run.i} if current else outputs

    def record(self, measured: tuple[Run, Noise], name: str, current: bool) -> Record:
        run, drawn = measured
        setup = self.setup
        outputs = self.channels(run, current, drawn)
        units = {setup.input: setup.input_unit, **dict.fromkeys(outputs, setup.unit)} | ({"i": "A"} if current else {})
        return Record(np.arange(len(run.u)) * self.dt, {setup.input: run.u}, outputs, units, name)

    def _by_the_clock(self, n: int) -> tuple[Array, Array]:
        load, alive = np.zeros(n), np.ones(n)
        for name, parameters in self.parameters.items():
            clock = ALL_EFFECTS[name].by_the_clock
            if clock is not None:
                line = clock(dict(parameters), n, self.dt)
                load, alive = load + line.load, alive * line.alive
        return load, alive
