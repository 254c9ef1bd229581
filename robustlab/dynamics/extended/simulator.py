"""Simulation of a linear plant with effects, in windows that start anew or in one run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robustlab.arrays import Array
from robustlab.dynamics.effects.contract import Effect, Law, Site
from robustlab.dynamics.linear_plant import LinearPlant
from robustlab.dynamics.ports.port_model import PortModel, port_model
from robustlab.dynamics.tuning import TUNING
from robustlab.errors import InputError

__all__ = ["Motion", "Simulator", "Windows"]

PLACES = (1, 2, 4, 8)  # numbers of laws that the kernel is compiled for


@dataclass(frozen=True)
class Windows:
    """Equally long windows of a record: first sample of each, and their length in samples."""

    starts: NDArray[np.int64]
    length: int


@dataclass(frozen=True, eq=False)
class Motion:
    """States (n_windows, length, n_x), outputs (n_windows, length, n_y), forces of the laws (n_windows, length, n)."""

    states: Array
    outputs: Array
    forces: Array


class Simulator:
    """One plant with effects at their sites, over one recorded input.

    Parameters
    ----------
    plant
        The plant; all its outputs are simulated.
    effects
        Pairs of effect and site.
    u
        Inputs held between samples, shape (n, n_u).
    dt
        Sample time in s.
    t0
        Time of the first sample (effects that depend on time count from the beginning of the run at t = 0).
    """

    def __init__(
        self, plant: LinearPlant, effects: Sequence[tuple[Effect, Site]], u: Array, dt: float, t0: float = 0.0
    ) -> None:
        self.plant, self.effects, self.dt, self.t0 = plant, tuple(effects), dt, t0
        self.sub = max([1, *(effect.substeps for effect, _ in self.effects)])
        self.held = np.ascontiguousarray(np.repeat(u, self.sub, axis=0))
        self._exponentials: dict[bytes, tuple[Array, Array]] = {}
        self._models: dict[tuple[tuple[str, float], ...], PortModel] = {}

    def run(
        self,
        factors: Mapping[str, float],
        values: Sequence[Mapping[str, float]],
        x0: Array,
        windows: Windows,
    ) -> Motion:
        """Simulate all windows.

        Parameters
        ----------
        factors
            Plant parameter -> factor of the nominal value.
        values
            Parameters of each effect.
        x0
            Plant states at the window starts, (n_windows, n_plant). States of effects start at zero and are carried
            over from window to window.
        windows
            Where they lie.
        """
        model = self.model(factors, values)
        laws = [law for (e, site), v in zip(self.effects, values, strict=True) for law in e.laws(site, v)]
        seen = self.seen_input(values)
        motion, forces = self._step(model, laws, seen, x0, windows)
        u = seen[:: self.sub][windows.starts[:, None] + np.arange(windows.length)] if model.D.any() else None
        outputs = motion @ model.C.T
        if u is not None:
            outputs = outputs + u @ model.D.T
        for (effect, site), v in zip(self.effects, values, strict=True):
            if site.kind == "output":
                k = [s.name for s in self.plant.outputs].index(site.name)
                outputs[:, :, k] = effect.output(outputs[:, :, k], v, self.dt)
        return Motion(motion, outputs, forces)

    def model(self, factors: Mapping[str, float], values: Sequence[Mapping[str, float]]) -> PortModel:
        """The linear equations at these values, extended by the effects."""
        total = dict(factors)
        for (effect, site), v in zip(self.effects, values, strict=True):
            for name, factor in effect.factors(self.plant, site, v).items():
                total[name] = total.get(name, 1.0) * factor
        key = tuple(sorted(total.items()))
        model = self._models.get(key)
        if model is None:
            if len(self._models) > TUNING.kept:
                self._models.clear()
            model = self._models[key] = port_model(self.plant, total)
        for (effect, site), v in zip(self.effects, values, strict=True):
            model = effect.extend(model, site, v)
        return model

    def seen_input(self, values: Sequence[Mapping[str, float]]) -> Array:
        """Inputs in steps of the simulation, as the plant sees them."""
        u = self.held
        names = [s.name for s in self.plant.inputs]
        for (effect, site), v in zip(self.effects, values, strict=True):
            if site.kind == "input":
                k = names.index(site.name)
                u = u.copy()
                u[:, k] = effect.input(u[:, k], v, self.dt / self.sub)
        return u

    def _step(
        self, model: PortModel, laws: Sequence[Law], u: Array, x0: Array, windows: Windows
    ) -> tuple[Array, Array]:
        from robustlab.dynamics.ports import law_kernel as kernel

        if len(laws) > kernel.MAX_LAWS:
            raise InputError("effects", f"{len(laws)} force laws at once", f"at most {kernel.MAX_LAWS}")
        n, h = len(model.A), self.dt / self.sub
        phi, psi = self._exponential(model.A, h)
        ports = [model.ports[law.port] for law in laws]
        columns = np.zeros((max(1, len(laws)), n))
        velocity, position = np.zeros_like(columns), np.zeros_like(columns)
        parameters = np.zeros((len(columns), max([1, *(len(law.parameters) for law in laws)])))
        memory = np.zeros((len(columns), max([1, *(law.memory for law in laws)])))
        for j, (law, port) in enumerate(zip(laws, ports, strict=True)):
            columns[j], velocity[j] = psi @ port.force, port.velocity
            if port.position is not None:
                position[j] = port.position
            parameters[j, : len(law.parameters)] = law.parameters
        functions = tuple(law.function for law in laws)
        functions += (kernel.no_force,) * (next(k for k in PLACES if k >= len(laws)) - len(laws))
        count = len(windows.starts)
        states = np.empty((count, windows.length, n))
        forces = np.zeros((count, windows.length, len(laws)))
        start = np.zeros((count, n))
        start[:, : model.own] = x0
        kernel.quiet_first_class_functions()
        step = kernel.HeldStep(phi, np.ascontiguousarray(psi @ model.B), columns, velocity, position)
        run = kernel.Run(u, h, self.t0, self.sub, windows.starts, windows.length, start, model.own)
        kernel.step_windows(functions, len(laws), step, parameters, memory, run, states, forces)
        return states, forces

    def _exponential(self, a: Array, h: float) -> tuple[Array, Array]:
        r"""``exp(A h)`` and :math:`\int_0^h e^{A s} ds`."""
        from scipy.linalg import expm

        key = a.tobytes()
        if key not in self._exponentials:
            if len(self._exponentials) > TUNING.kept:
                self._exponentials.clear()
            n = len(a)
            both: Array = np.asarray(expm(np.block([[a, np.eye(n)], [np.zeros((n, 2 * n))]]) * h), dtype=float)
            self._exponentials[key] = both[:n, :n].copy(), both[:n, n:].copy()
        return self._exponentials[key]
