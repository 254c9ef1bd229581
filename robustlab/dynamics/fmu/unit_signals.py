"""Signals, parameters and joints of a plant, from what its unit says of itself and what the user states."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from robustlab.dynamics.fmu.description import CO_SIMULATION, MODEL_EXCHANGE
from robustlab.dynamics.fmu.unit_process import UnitProcess
from robustlab.dynamics.parameters import Parameter, overridden
from robustlab.dynamics.plant_file import BY_UNIT
from robustlab.errors import InputError, did_you_mean
from robustlab.provenance import BY_DIFFERENCES, Provenance
from robustlab.statespace import Signal
from robustlab.units import same_unit

__all__ = ["OpenedUnit", "described", "joints_of", "opened", "unit_provenance"]

JOINT_KEYS = ("position", "input", "inertia", "unit")
# Unit of what acts on a velocity or a current.
ACTS = {"m/s": "N", "rad/s": "N m", "A": "V"}


@dataclass(frozen=True)
class OpenedUnit:
    """A unit's process, its description, and the interface through which it is to be run."""

    process: UnitProcess
    about: dict[str, Any]
    kind: str


def opened(path: str | Path | None, kind: str | None, time_limit: float) -> OpenedUnit:
    """The unit's process, its description, and the interface: the one asked for, or model exchange where there is one.

    Raises
    ------
    InputError
        What is wrong with the file; an interface that it has not got.
    """
    if kind not in (None, MODEL_EXCHANGE, CO_SIMULATION):
        raise InputError(f"{path}: interface", f"{kind!r}", f"{MODEL_EXCHANGE!r} or {CO_SIMULATION!r}")
    if path is None:
        raise InputError("functional mock-up unit", "no file", "a file ending .fmu")
    process = UnitProcess(path, time_limit)
    about = process.describe()
    kinds = about["kinds"]
    chosen = kind or (MODEL_EXCHANGE if MODEL_EXCHANGE in kinds else CO_SIMULATION)
    if chosen not in kinds:
        process.close()
        hint = None if kind else 'rl.plant("FILE.fmu") takes either'
        raise InputError(str(path), f"a unit for {' and '.join(kinds)}", f"one for {chosen}", hint)
    return OpenedUnit(process, about, chosen)


def described(about: Mapping[str, Any], given: Mapping[str, Any]) -> dict[str, Any]:
    """Name, parameters and signals, as `robustlab.dynamics.plant_contract.Plant` takes them."""
    name = about["name"] or "unit"
    defaults = []
    for p in about["parameters"]:
        sign: Any = "positive" if p["low"] > 0 else "nonnegative" if p["low"] == 0 else "any"
        value = p["start"]
        if (sign == "positive" and value <= 0) or (sign == "nonnegative" and value < 0):
            raise InputError(f"{name}: {p['name']}", f"start value {value:g}", f"at least its own minimum {p['low']:g}")
        source = "the unit's description"
        defaults.append(Parameter(p["name"], value, p["unit"], 0.0, source, p["meaning"], sign))
    kinds = {kind: tuple(Signal(v["name"], v["unit"]) for v in about[kind]) for kind in ("inputs", "outputs", "states")}
    return {"name": name, "parameters": overridden(defaults, given, name), **kinds}


def joints_of(plant: Any, stated: Mapping[str, Any] | None, about: Mapping[str, Any]) -> dict[str, dict[str, str]]:
    """Velocity or current state -> how a force, torque or voltage acts there; the user's word, else the unit's.

    Raises
    ------
    InputError
        A joint that is no state, an input or parameter that there is not, a joint at which nothing says how a force
        acts.
    """
    if stated is None:
        given = {j.get("velocity", ""): {k: v for k, v in j.items() if k != "velocity"} for j in about["joints"]}
        where = f"{plant.name}: joints (as its description names them)"
    else:
        given, where = stated, f"{plant.name}: joints"
    if not isinstance(given, Mapping):
        raise InputError(where, type(given).__name__, 'a table: {"v": {"position": "x", "input": "F"}}')
    states, inputs = ({s.name: s.unit for s in kind} for kind in (plant.states, plant.inputs))
    found = {}
    for velocity, how in given.items():
        here = f"{where}: {velocity!r}"
        if velocity not in states:
            known = tuple(states)
            raise InputError(here, "no such state", f"one of {', '.join(known)}", did_you_mean(str(velocity), known))
        if not isinstance(how, Mapping) or not set(how) <= set(JOINT_KEYS) or ("input" in how) == ("inertia" in how):
            expected = "input= (the force acts as this input does) or inertia= (a parameter), and position=, unit="
            raise InputError(here, f"{how!r:.200}", expected)
        for key, known in (("position", states), ("input", inputs), ("inertia", plant.parameters)):
            if key in how and how[key] not in known:
                raise InputError(here, f"{key} {how[key]!r}", f"one of {', '.join(known) or 'none'}")
        family = next((acts for unit, acts in ACTS.items() if same_unit(unit, states[velocity])), "")
        unit = how.get("unit") or inputs.get(how.get("input", ""), "") or family
        found[velocity] = {**how, "unit": unit, "kind": "current" if family == "V" else "joint"}
    return found


def unit_provenance(process: UnitProcess, by_differences: bool) -> Provenance:
    """Where a plant and its models come from: the file with its hash, and whether derivatives are differences."""
    note = BY_DIFFERENCES if by_differences else ""
    return Provenance.now(BY_UNIT, {process.shown: process.sha256}, note=note)
