"""One motion under several controllers: a linear plant follows a sine, the Stewart platform a path."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, NamedTuple

import numpy as np

from robustlab.arrays import Array
from robustlab.display import Displayable, Facts, Part, number
from robustlab.dynamics.control.controlled_plant import controlled_plant, driver_in_loop
from robustlab.dynamics.control.platform import (
    MOST_TORQUE,
    MOST_VOLTAGE,
    LayeredController,
    SineTrajectory,
    TrajectoryFollowing,
    closed_loop,
    ease,
    follow,
    follow_with_torques,
    torque_loop,
    two_layer,
)
from robustlab.dynamics.extended.extended_plant import ExtendedNonlinearPlant, with_effects
from robustlab.dynamics.linear_plant import LinearPlant
from robustlab.dynamics.linearisation import linearise, trim
from robustlab.dynamics.plant_contract import Trim
from robustlab.dynamics.simulation import simulate
from robustlab.dynamics.stewart.kinematics import nut_angles
from robustlab.dynamics.stewart.stewart_platform import StewartPlatform
from robustlab.errors import InputError, unknown_name
from robustlab.result import Status
from robustlab.statespace import as_model


class TimePanel(NamedTuple):
    """One signal of several runs over time: label with unit, run -> samples (n,), and a limit to draw."""

    label: str
    curves: Mapping[str, Array]
    limit: float | None = None


@dataclass(frozen=True, eq=False)
class ControlledRuns(Displayable):
    """Simulated runs of one machine under several controllers."""

    controllers: Mapping[str, Mapping[str, Any]]
    columns: tuple[tuple[str, tuple[str, ...], float], ...]
    t: Array
    panels: tuple[TimePanel, ...]
    words: Facts
    notes: tuple[str, ...]
    status: Status = Status.CONVERGED

    quantities: ClassVar[Mapping[str, Any]] = {
        "controllers": {
            "*": {
                **dict.fromkeys(("largest_error", "worst_error", "largest_torque", "largest_voltage"), float),
                "order": "1", "largest": {"*": float}, "within_limits": bool, "spectral_abscissa": "1/s",
                "position_error": "m", "orientation_error": "rad", "nut_errors": {"phi_*": "rad"},
            }
        }
    }  # fmt: skip

    def headline(self) -> str:
        return f"simulated under {len(self.controllers)} controllers"

    def facts(self) -> Facts:
        return self.words

    def details(self) -> list[Part]:
        header = ("controller", "order", *(title for title, _, _ in self.columns))
        rows = [
            (name, str(row["order"]), *(_cell(row, where, factor) for _, where, factor in self.columns))
            for name, row in self.controllers.items()
        ]
        return [Part("", header, rows)]

    def numbers(self) -> dict[str, Any]:
        return {"controllers": self.controllers}

    def to_json(self) -> dict[str, Any]:
        texts = {"facts": dict(self.facts()), "notes": self.notes}
        return {"status": self.status, "controllers": self.controllers, **texts}


def _cell(row: Mapping[str, Any], where: tuple[str, ...], factor: float) -> str:
    value: Any = row
    for key in where:
        value = value[key]
    return ("yes" if value else "no") if isinstance(value, bool) else f"{factor * value:.4g}"


def follow_sine(
    plant: Any,
    controllers: Mapping[str, Any],
    controlled: Sequence[str],
    measured: Sequence[str],
    *,
    amplitude: float,
    omega: float,
    rise_time: float,
    t_end: float,
    limits: Mapping[str, float] | None = None,
    points: int = 2001,
    step: float = 1e-4,
    after: float = 0.0,
    scale: float = 1.0,
    unit: str = "",
    effects: Mapping[str, Mapping[str, float]] | None = None,
    members: Sequence[Mapping[str, float]] = (),
) -> ControlledRuns:
    """Simulate a linear plant that follows a growing sine, nominal and sampled models, with unmodelled effects."""
    if not isinstance(plant, LinearPlant):
        raise InputError("follow_sine: plant", type(plant).__name__, "a linear plant")
    units, limits = {s.name: s.unit for s in (*plant.outputs, *plant.inputs)}, limits or {}
    for name in limits:
        if name not in units:
            raise unknown_name(f"limits.{name}", "no such signal", name, list(units))
    fine = max(1, math.ceil(t_end / (points - 1) / step))  # steps between two stored points
    t = np.linspace(0.0, t_end, fine * (points - 1) + 1)
    wave = amplitude * ease(t / rise_time) * np.sin(omega * t)
    late, known = t >= after, dict(effects or {})
    rows: dict[str, dict[str, Any]] = {}
    errors: dict[str, Array] = {}
    sizes: dict[str, dict[str, Array]] = {name: {} for name in limits}
    for name, K in controllers.items():
        loop = controlled_plant(plant, K, controlled, measured)
        made = [_with_effects(loop, plant, known, member) for member in ({}, *members)]
        runs = [simulate(one, t, np.tile(wave[:, None], len(controlled))) for one in made]
        error = [np.column_stack([wave - run[c] for c in controlled]) * scale for run in runs]
        largest = {n: float(max(np.abs(run[n]).max() for run in runs)) for n in limits}
        rows[name] = {
            "order": len(loop.states) - len(plant.states),
            "largest_error": float(np.abs(error[0][late]).max()),
            "worst_error": float(max(np.abs(e[late]).max() for e in error)),
            "largest": largest,
            "within_limits": all(largest[n] <= limit for n, limit in limits.items()),
        }
        errors[name] = error[0][::fine, 0]
        for signal in limits:
            sizes[signal][name] = runs[0][signal][::fine]
    unit = unit or units[controlled[0]]
    columns = [(f"error [{unit}]", ("largest_error",), 1.0), (f"of the worst member [{unit}]", ("worst_error",), 1.0)]
    columns += [(f"largest {n} [{units[n]}]", ("largest", n), 1.0) for n in limits]
    panels = [TimePanel(f"error of {controlled[0]} [{unit}]", errors)]
    panels += [TimePanel(f"{n} [{units[n]}]", sizes[n], limit) for n, limit in limits.items()]
    words = " and ".join(e.replace("-", " ").replace("@", " at ") for e in known) or "no further effect"
    facts = [
        ("reference", f"{number(float(amplitude), units[controlled[0]], 5)} at {number(float(omega), 'rad/s', 5)}"),
        ("effects that no design knew", words),
        ("further members simulated", str(len(members))),
        ("errors count from", number(after, "s", 5)),
    ]
    note = "Limits are compared with, not applied: nothing is clipped."
    return ControlledRuns(rows, tuple(columns), t[::fine], tuple(panels), facts, (note,))


def _with_effects(
    loop: Any, plant: Any, effects: Mapping[str, Mapping[str, float]], member: Mapping[str, float]
) -> Any:
    """Return the loop of a sampled model with effects; those at a control act on the controller's command."""
    made, own = (p.with_parameters(**member) if member else p for p in (loop, plant))
    at_controls = [f"input-dead-zone@{s.name}" for s in plant.inputs]
    rest = {key: values for key, values in effects.items() if key not in at_controls}
    moved = with_effects(made, rest) if rest else made
    for key in at_controls:
        if key in effects:
            moved = with_effects(moved, driver_in_loop(made, own, key.partition("@")[2], effects[key]))
    return moved


def follow_path(
    plant: Any,
    controllers: Mapping[str, Any],
    *,
    at: Sequence[float] | None = None,
    scale: float,
    rise_time: float,
    t_end: float,
    points: int,
    after: float,
    p_low: float,
) -> ControlledRuns:
    """Simulate the nonlinear Stewart platform along the path of section 9.1.3; ``at``: its start, None: home."""
    machine = plant.plant if isinstance(plant, ExtendedNonlinearPlant) else plant
    if not isinstance(machine, StewartPlatform) or (machine.motors and machine is not plant):
        expected = "one, with motors, or without them and perhaps with effects"
        raise InputError("follow_path: plant", "no Stewart platform that can be followed here", expected)
    point = trim(plant) if at is None else trim(plant, pose=at)
    sines = SineTrajectory(machine.geometry.home if at is None else at, rise_time=rise_time)
    sines = replace(sines, lift=scale * np.asarray(sines.lift), amplitude=scale * np.asarray(sines.amplitude))
    t = np.linspace(0.0, t_end, points)
    late, angles = t >= after, nut_angles(machine.geometry, sines.pose(t))
    runs, abscissas, below = _followed(plant, machine, controllers, sines, t, point, p_low)
    rows: dict[str, dict[str, Any]] = {}
    curves: dict[str, dict[str, Array]] = {key: {} for key in ("position", "torque", "voltage")}
    for name, run in runs.items():
        error = run.largest_error(after)
        curves["position"][name] = distance = 1e3 * np.linalg.norm(run.error[:, :3], axis=1)
        largest = np.abs((run.phi - angles)[late]).max(axis=0)
        rows[name] = {
            "order": as_model(controllers[name], name).n_states,
            "worst_error": float(distance[late].max()),
            "position_error": float(error[:3].max()),
            "orientation_error": float(error[3:].max()),
            "nut_errors": {f"phi_{i + 1}": float(off) for i, off in enumerate(largest)},
            "largest_torque": float(run.largest_torque().max()),
            "within_limits": run.within_limits,
            "spectral_abscissa": abscissas[name],
        }
        curves["torque"][name] = 1e3 * np.abs(run.torque).max(axis=1)
        if run.voltage.size:
            rows[name]["largest_voltage"] = float(run.largest_voltage().max())
            curves["voltage"][name] = np.abs(run.voltage).max(axis=1)
    panels = (
        TimePanel("distance to path [mm]", curves["position"]),
        TimePanel("largest |torque| [mN m]", curves["torque"], 1e3 * MOST_TORQUE),
        TimePanel("largest |voltage| [V]", curves["voltage"], MOST_VOLTAGE),
    )
    columns = (
        ("position [mm]", ("position_error",), 1e3),
        ("angle [mrad]", ("orientation_error",), 1e3),
        ("torque [mN m]", ("largest_torque",), 1e3),
        *([("voltage [V]", ("largest_voltage",), 1.0)] if curves["voltage"] else []),
        ("in limits", ("within_limits",), 1.0),
    )
    pose = "home" if at is None else ", ".join(f"{v:g}" for v in at)
    size = f"{5 * scale:g} mm"
    words = f"a lift of {size}, then sines of {size} and {20 * scale:g} mrad"
    facts = [("path begins at", pose), ("path", words), below, ("errors count from", number(after, "s", 5))]
    limits = "torque and voltage" if curves["voltage"] else "torque"
    note = f"Nothing is clipped: 'in limits' says whether the motors' {limits} would have been enough."
    kept = tuple(panel for panel in panels if panel.curves)
    return ControlledRuns(rows, columns, t, kept, facts, (note,))


def _followed(
    plant: Any, machine: StewartPlatform, controllers: Mapping[str, Any], path: SineTrajectory, t: Array, at: Trim,
    p_low: float,
) -> tuple[dict[str, TrajectoryFollowing], dict[str, float], tuple[str, str]]:  # fmt: skip
    """Return the run and the spectral abscissa of each loop, and the inner loops in words."""
    models = {name: as_model(K, name) for name, K in controllers.items()}
    if not machine.motors:
        named = f", with {', '.join(e.in_words for e in plant.effects)}" if machine is not plant else ""
        runs = {name: follow_with_torques(plant, K, path, t, at=at) for name, K in models.items()}
        poles = {name: linearise(torque_loop(machine, K, at)).spectral_abscissa() for name, K in models.items()}
        return runs, poles, ("the machine", f"takes torques{named}")
    lower = two_layer(machine, p_low=p_low).lower
    layered = {name: LayeredController(K, lower, at) for name, K in models.items()}
    runs = {name: follow(machine, controller, path, t) for name, controller in layered.items()}
    poles = {name: closed_loop(machine, controller).spectral_abscissa() for name, controller in layered.items()}
    return runs, poles, ("torque loops below", f"triple pole at {p_low:g} 1/s")
