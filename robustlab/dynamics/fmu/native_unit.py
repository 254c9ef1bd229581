"""The functions of a unit's library, FMI 2.0 and 3.0 alike, called through FMPy; in the child process only.

A unit's functions return a status; FMPy raises from "discard" on. What the unit logs is kept for the message, and
never printed.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from ctypes import POINTER, byref, c_double, c_uint
from typing import Any

import numpy as np

from robustlab.arrays import Array
from robustlab.dynamics.fmu.description import MODEL_EXCHANGE
from robustlab.errors import InputError, NoTrustworthyNumber

DISCARD = 2  # status of a point that the unit cannot evaluate: a shorter step may be possible
MOST_EVENT_ITERATIONS = 1000  # of one event; more is a unit that never settles


class _Numbers:
    """A buffer of float64 whose address a C function takes."""

    def __init__(self, n: int) -> None:
        self.values = np.zeros(n)
        self.at = self.values.ctypes.data_as(POINTER(c_double))


class _References:
    """Value references, and a buffer for the values."""

    def __init__(self, variables: list[int]) -> None:
        self.list = variables
        self.n = len(variables)
        self.at = (c_uint * self.n)(*variables)
        self.numbers = _Numbers(self.n)


class NativeUnit:
    """One loaded library, and at most one instance of it.

    ``description``: as of `robustlab.dynamics.fmu.description.read_description`.
    ``kind``: model exchange or co-simulation.
    ``folder``: where the archive was unpacked.
    """

    def __init__(self, description: Mapping[str, Any], kind: str, folder: str) -> None:
        self.name = description["name"]
        self.description, self.kind = description, kind
        self.can = description["kinds"][kind]
        self.three = description["version"].startswith("3")
        self.states, self.rates_of, self.inputs, self.outputs = (
            _References([v["reference"] for v in variables])
            for variables in (
                description["states"],
                [{"reference": r} for r in description["rates"]],
                description["inputs"],
                description["outputs"],
            )
        )
        self.parameters = {p["name"]: p for p in description["parameters"]}
        self.x, self.f, self.z = (_Numbers(n) for n in (self.states.n, self.states.n, description["indicators"]))
        self.said: deque[str] = deque(maxlen=3)
        self.unit = self._library(folder)
        self.live = False
        from fmpy.fmi1 import FMICallException

        self.call_error = FMICallException

    # --- life --------------------------------------------------------------------------------------------------------

    def begin(self, values: Mapping[str, float], time: float, u: Array | None = None) -> float:
        """A fresh instance, initialised at a time with parameter values and inputs (its own where left out).

        Model exchange: in continuous-time mode after its first event iteration; the time of the next event, inf where
        none is announced.
        """
        self.end()
        self.said.clear()
        try:
            self._instantiate()
        except Exception as error:  # noqa: BLE001  FMPy has no type of its own for this
            raise self.failed(f"cannot be instantiated ({error})") from None
        self.live = True
        changed = {self.parameters[n]["reference"]: v for n, v in values.items() if v != self.parameters[n]["start"]}
        if changed:
            self._set(list(changed), list(changed.values()))
        if u is not None:
            self.set_inputs(u)
        if self.three:
            self.unit.enterInitializationMode(startTime=time)
        else:
            self.unit.setupExperiment(startTime=time)
            self.unit.enterInitializationMode()
        self.unit.exitInitializationMode()
        if self.kind == MODEL_EXCHANGE:
            return self._settle()
        return math.inf  # co-simulation without event mode: in step mode now

    def end(self) -> None:
        """Free the instance; the library stays."""
        if self.live:
            self.live = False
            free = self.unit.fmi3FreeInstance if self.three else self.unit.fmi2FreeInstance
            free(self.unit.component)

    def _library(self, folder: str) -> Any:
        arguments = {
            "guid": self.description["token"],
            "modelIdentifier": self.can["identifier"],
            "unzipDirectory": folder,
            "instanceName": "robustlab",
        }
        from fmpy import fmi2, fmi3

        module, number = (fmi3, "3") if self.three else (fmi2, "2")
        maker = getattr(module, f"FMU{number}{'Model' if self.kind == MODEL_EXCHANGE else 'Slave'}")
        try:
            return maker(**arguments)
        except Exception as error:  # noqa: BLE001  FMPy has no type of its own for this
            from fmpy import platform_tuple

            reason = str(error).replace(folder, "")
            hint = f"the unit must hold a library for {platform_tuple} with all functions of its interface"
            if self.can["needs_tool"]:
                hint += "; this one says that it needs the tool it came from"
            raise InputError(self.name, f"its library cannot be loaded ({reason})", None, hint) from None

    def _instantiate(self) -> None:
        if self.three:
            self.unit.instantiate(logMessage=lambda _e, _s, _c, text: self._log(text))
            return
        if not hasattr(self, "callbacks"):
            from fmpy import calloc, fmi2, free
            from fmpy.logging import addLoggerProxy

            self.callbacks = fmi2.fmi2CallbackFunctions()
            self.callbacks.logger = fmi2.fmi2CallbackLoggerTYPE(lambda _e, _n, _s, _c, text: self._log(text))
            self.callbacks.allocateMemory = fmi2.fmi2CallbackAllocateMemoryTYPE(calloc)
            self.callbacks.freeMemory = fmi2.fmi2CallbackFreeMemoryTYPE(free)
            addLoggerProxy(byref(self.callbacks))
        self.unit.instantiate(callbacks=self.callbacks)

    def _log(self, text: bytes | None) -> None:
        self.said.append((text or b"").decode(errors="replace")[:200])

    def failed(self, what: str) -> NoTrustworthyNumber:
        """An error with what the unit logged last."""
        logged = "; ".join(self.said)
        return NoTrustworthyNumber(self.name, what + (f'; the unit says "{logged}"' if logged else ""))

    # --- values ------------------------------------------------------------------------------------------------------

    def _set(self, references: list[int], values: list[float]) -> None:
        (self.unit.setFloat64 if self.three else self.unit.setReal)(references, values)

    def set_inputs(self, u: Array) -> None:
        """Inputs (n_u,)."""
        if self.inputs.n:
            r = self.inputs
            r.numbers.values[:] = u
            if self.three:
                self.unit.fmi3SetFloat64(self.unit.component, r.at, r.n, r.numbers.at, r.n)
            else:
                self.unit.fmi2SetReal(self.unit.component, r.at, r.n, r.numbers.at)

    def value(self, reference: int) -> float:
        """One real variable."""
        return float((self.unit.getFloat64 if self.three else self.unit.getReal)([reference])[0])

    def get_inputs(self) -> Array:
        """Inputs as they are set."""
        return self._get(self.inputs)

    def get_outputs(self) -> Array:
        """Outputs (n_y,)."""
        return self._get(self.outputs)

    def _get(self, r: _References) -> Array:
        if r.n and self.three:
            self.unit.fmi3GetFloat64(self.unit.component, r.at, r.n, r.numbers.at, r.n)
        elif r.n:
            self.unit.fmi2GetReal(self.unit.component, r.at, r.n, r.numbers.at)
        return r.numbers.values.copy()

    # --- model exchange ----------------------------------------------------------------------------------------------

    def set_point(self, time: float, x: Array, u: Array) -> None:
        """Time, states and inputs, in continuous-time mode."""
        self.unit.setTime(time)
        if self.states.n:
            self.x.values[:] = x
            self.unit.setContinuousStates(self.x.at, self.states.n)
        self.set_inputs(u)

    def get_states(self) -> Array:
        """Continuous states (n_x,)."""
        if self.states.n:
            self.unit.getContinuousStates(self.x.at, self.states.n)
        return self.x.values.copy()

    def get_rates(self) -> Array:
        """Rates of the states (n_x,); NaN where the unit discards the point."""
        if self.states.n:
            get = self.unit.getContinuousStateDerivatives if self.three else self.unit.getDerivatives
            try:
                get(self.f.at, self.states.n)
            except self.call_error as error:
                if error.status != DISCARD:
                    raise
                self.f.values[:] = np.nan
        return self.f.values.copy()

    def get_indicators(self) -> Array:
        """Event indicators (n_z,)."""
        n = len(self.z.values)
        if n:
            self.unit.getEventIndicators(self.z.at, n)
        return self.z.values.copy()

    def step_done(self) -> bool:
        """Tell the unit of a step that is accepted; whether it wants an event."""
        if not self.can["every_step_told"]:
            return False
        event, ended = self.unit.completedIntegratorStep()
        if ended:
            raise self.failed("the unit ended the simulation")
        return bool(event)

    def event(self, u: Array) -> float:
        """An event at the time and states that are set, with new inputs; the time of the next one."""
        self.unit.enterEventMode()
        self.set_inputs(u)
        return self._settle()

    def _settle(self) -> float:
        for _ in range(MOST_EVENT_ITERATIONS):
            again, ended, _, _, announced, when = (
                self.unit.updateDiscreteStates() if self.three else self.unit.newDiscreteStates()
            )
            if ended:
                raise self.failed("the unit ended the simulation")
            if not again:
                self.unit.enterContinuousTimeMode()
                return float(when) if announced else math.inf
        raise self.failed(f"an event that does not settle in {MOST_EVENT_ITERATIONS} iterations")

    # --- derivatives -------------------------------------------------------------------------------------------------

    def directional(self, columns: int) -> Array:
        """``[[A, B], [C, D]]`` at the point that is set, by seeds of one; the first ``columns`` knowns.

        Outputs that are states or inputs themselves have known rows, and discrete ones do not move between events.
        """
        knowns = [*self.states.list, *self.inputs.list]
        place = {reference: k for k, reference in enumerate(knowns)}
        found = np.zeros((self.states.n + self.outputs.n, len(knowns)))
        rows, asked = list(range(self.states.n)), list(self.rates_of.list)
        for k, v in enumerate(self.description["outputs"], self.states.n):
            if v["reference"] in place:
                found[k, place[v["reference"]]] = 1.0
            elif v.get("variability") == "continuous":
                rows.append(k)
                asked.append(v["reference"])
        for k, known in enumerate(knowns[:columns]):
            if asked:
                found[rows, k] = self.unit.getDirectionalDerivative(asked, [known], [1.0])
        return found

    # --- co-simulation -----------------------------------------------------------------------------------------------

    def step(self, time: float, length: float) -> None:
        """One communication step."""
        told = self.unit.doStep(time, length)
        if self.three and (told[1] or told[2]):
            raise self.failed(f"the unit ended its step at t = {told[3]:.9g} s")
