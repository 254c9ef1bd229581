"""A co-simulation unit as a plant: it steps itself, and shows outputs alone."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from numpy.typing import ArrayLike

from robustlab.arrays import Array
from robustlab.dynamics.fmu.description import CO_SIMULATION
from robustlab.dynamics.fmu.unit_process import UnitProcess
from robustlab.dynamics.fmu.unit_signals import OpenedUnit, described, opened, unit_provenance
from robustlab.dynamics.parameters import overridden
from robustlab.dynamics.plant_contract import SteppedPlant, Trim
from robustlab.dynamics.simulation import simulate
from robustlab.dynamics.tuning import TUNING
from robustlab.errors import InputError, UnitMismatch
from robustlab.record import Record
from robustlab.result import Status
from robustlab.shown import Facts, Shown
from robustlab.statespace import OperatingPoint, Signal, StateSpaceModel
from robustlab.units import same_unit

__all__ = ["FmuCoSimulation", "FreeRun"]

SHOWS_NONE = "a co-simulation unit steps itself: it shows no rates, and no state of it can be set"


@dataclass(frozen=True, eq=False, repr=False)
class FreeRun(Shown):
    """A record beside the simulation of its inputs from the unit's own initial state.

    Attributes
    ----------
    record, simulated
        Measured, and simulated.
    gaps
        Output -> "rms", "peak" in its unit, and "fit" in %, 100 where they are equal.
    status
        CONVERGED: the unit ran to the end; what its own solver is good for is not known.
    """

    record: Record
    simulated: Record
    gaps: Mapping[str, Mapping[str, float]]
    status: Status = Status.CONVERGED

    def facts(self) -> Facts:
        """One an output."""
        told = [("", f"{self.simulated.name} against {self.record.name}: free run from the unit's own initial state")]
        for name, gap in self.gaps.items():
            unit = self.simulated.unit(name)
            rms, peak = (f"{gap[key]:.4g} {unit}".rstrip() for key in ("rms", "peak"))
            told.append((name, f"rms {rms}, peak {peak}, fit {gap['fit']:.4g} %"))
        return told

    def to_json(self, *, series: bool = True) -> dict[str, Any]:
        """The gaps and the names of both; with ``series`` the simulated outputs over time."""
        gaps = {name: dict(gap) for name, gap in self.gaps.items()}
        found = {"record": self.record.name, "model": self.simulated.name, "gaps": gaps, "status": self.status}
        over_time = {"t": self.simulated.t, "simulated": dict(self.simulated.outputs)}
        return {**found, **over_time} if series else found


@dataclass(frozen=True, eq=False, repr=False, init=False)
class FmuCoSimulation(SteppedPlant):
    """A functional mock-up unit for co-simulation (FMI 2.0 or 3.0) as a plant without states of ours.

    It can be simulated (inputs are held between the samples, each a communication step, or ``step=`` shorter ones),
    compared with a record (`compare`), and sampled over its parameters. It has a linear model only where it offers
    directional derivatives and names its states: the one at its own initial state.

    Parameters
    ----------
    path
        File of the unit; a program, which is run in a child process.
    time_limit
        Seconds that the unit may take for one request.
    parameters
        As of `robustlab.dynamics.fmu.fmu_plant.FmuPlant`.

    Raises
    ------
    InputError, DependencyMissing
        As of `robustlab.dynamics.fmu.fmu_plant.FmuPlant`.
    """

    process: UnitProcess
    unused_signals: tuple[str, ...]
    about: dict[str, Any]

    def __init__(
        self, path: str | Path | OpenedUnit | None = None, *, time_limit: float = 60.0, **parameters: Any
    ) -> None:
        if path is None and "process" in parameters:  # dataclasses.replace, which hands over the fields
            fields = parameters
        else:
            unit = path if isinstance(path, OpenedUnit) else opened(path, CO_SIMULATION, time_limit)
            fields = {**described(unit.about, parameters), "states": (), "process": unit.process, "about": unit.about}
            fields["unused_signals"] = tuple(unit.about["left_out"])
        for key, value in fields.items():
            object.__setattr__(self, key, value)  # plants are frozen
        self.__post_init__()
        if path is not None:
            self.process.load(CO_SIMULATION)
        self.traced(unit_provenance(self.process, by_differences=False))

    def with_parameters(self, **given: Any) -> FmuCoSimulation:
        """The same plant with other values, or (value, relative tolerance), for the named parameters."""
        return replace(self, parameters=overridden(self.parameters.values(), given, self.name))

    def stepped(self, t: Array, u: Array, x0: Array, step: float | None = None) -> tuple[Array, Array]:
        """No states (n, 0), and outputs (n, n_y), at the times t for inputs (n, n_u) held between them."""
        steps = np.diff(t)
        even = not len(steps) or np.ptp(steps) <= TUNING.clock_jitter * steps.mean()
        if not even and not self.about["kinds"][CO_SIMULATION]["variable_step"]:
            raise InputError(f"simulate {self.name}", "steps that differ", "equal ones: the unit takes no others")
        longest = np.inf if step is None else step
        request = {"op": "step", "longest": min(longest, 1e300), "values": self.values}
        _, (y,) = self.process.ask(request, [t, u])
        return np.zeros((len(t), 0)), y

    def compare(self, record: Record) -> FreeRun:
        """The record's inputs simulated from the unit's own initial state, beside its outputs; nothing is fitted.

        Raises
        ------
        InputError
            An input that the record has not got, no output in common.
        UnitMismatch
            Different units of a signal.
        """
        where = f"compare {record.name}"
        missing = [s.name for s in self.inputs if s.name not in record.inputs]
        shared = [s for s in self.outputs if s.name in record.outputs]
        if missing:
            raise InputError(where, f"no input {missing[0]!r} in the record", "every input of the unit")
        if not shared:
            raise InputError(where, "no output in common", f"one of {', '.join(s.name for s in self.outputs)}")
        for name, unit in (*self.inputs, *shared):
            measured = record.unit(name)
            if unit and measured and not same_unit(unit, measured):
                raise UnitMismatch(f"{where}: {name}", f"recorded in {measured}", f"{unit} as in the unit")
        inputs = {s.name: record.inputs[s.name] for s in self.inputs}
        simulated = simulate(self, record.t, inputs)
        gaps = {}
        for name, _ in shared:
            error, spread = record.outputs[name] - simulated.outputs[name], float(np.std(record.outputs[name]))
            rms = float(np.sqrt(np.mean(error**2)))
            fit = 100.0 * (1.0 - rms / spread) if spread else float("nan")
            gaps[name] = {"rms": rms, "peak": float(np.abs(error).max()), "fit": fit}
        return FreeRun(record, simulated, gaps)

    def linear_model(
        self, at: Any = None, amplitude: Mapping[str, float] | None = None, pade: int = 0
    ) -> StateSpaceModel:
        """The model at the unit's initial state, by its directional derivatives.

        Raises
        ------
        InputError
            A unit without them, or another operating point.
        """
        where = f"linearise {self.name}"
        if amplitude or pade:
            raise InputError(where, "amplitude or pade for a plant without effects", "neither")
        if not self.about["kinds"][CO_SIMULATION]["directional"]:
            hint = "export the unit for model exchange, or identify a model from rl.simulate"
            raise InputError(where, f"{SHOWS_NONE}; and it offers no directional derivatives", None, hint)
        if at is not None:
            raise InputError(where, "an operating point", "none: a co-simulation unit is at its own initial state")
        u = np.array([v["start"] or 0.0 for v in self.about["inputs"]])
        _, (slopes, x, y) = self.process.ask({"op": "linear", "values": self.values}, [u])
        n = len(x)
        states = tuple(Signal(v["name"], v["unit"]) for v in self.about["states"])
        matrices = slopes[:n, :n], slopes[:n, n:], slopes[n:, :n], slopes[n:, n:]
        point = OperatingPoint(x, u, y)
        model = StateSpaceModel(*matrices, 0.0, self.inputs, self.outputs, states, point, self.name)
        model.traced(unit_provenance(self.process, by_differences=False))
        return model

    def left_out(self, at: Any = None, amplitude: Mapping[str, float] | None = None, pade: int = 0) -> tuple[Any, ...]:
        """Nothing that is known."""
        return ()

    def _refused(self) -> NoReturn:
        raise InputError(self.name, SHOWS_NONE, "a unit for model exchange")

    def derivative(self, x: ArrayLike, u: ArrayLike) -> Array:
        """Refused."""
        self._refused()

    def output(self, x: ArrayLike, u: ArrayLike) -> Array:
        """Refused."""
        self._refused()

    def jacobians(self, x: ArrayLike, u: ArrayLike) -> tuple[Array, Array, Array, Array]:
        """Refused."""
        self._refused()

    def equilibrium(self, **where: Any) -> Trim:
        """Refused."""
        self._refused()
