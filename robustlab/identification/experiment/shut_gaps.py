"""Joints at which a record could not show a backlash, since its load never leaves the drive; and a motion that would.

A gap opens where the force that keeps the load at the drive changes its sign
(`robustlab.dynamics.ports.split_joint.carried_force`), beyond an acceleration a* of the joint. The motion
proposed: about the visited pose of smallest a* the joint alone swings with `TIMES` a*, at a share of the
records' largest speed.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from robustlab.arrays import Array
from robustlab.dynamics.plant_contract import NonlinearPlant
from robustlab.dynamics.ports.motion_model import local_port_model
from robustlab.dynamics.ports.port_model import AnyPlant, PortModel
from robustlab.dynamics.ports.split_joint import Motion, carried_force, shares_behind
from robustlab.errors import RobustlabError
from robustlab.identification.hypotheses.prepared_record import PreparedRecord
from robustlab.identification.record_check.suitability import Finding

POSES = 60  # visited, among which the one for the proposed motion is chosen
TIMES = 2.0  # the acceleration at which the load is left: flights long enough to be seen
SPEED = 0.5  # of the largest that the records have at the joint
PERIOD = 64  # points of a period at which the proposed motion is looked at


@dataclass(frozen=True, eq=False)
class _Place:
    """A joint with its states, and the share of its inertia that hangs behind its drive."""

    joint: str
    position: int
    velocity: int
    share: float


class _Swing(NamedTuple):
    """A sine of one joint about a pose, the positions of all joints.

    Amplitude; frequency in Hz; peak acceleration, and that to which the load follows; share of the time open.
    """

    pose: tuple[float, ...]
    amplitude: float
    frequency: float
    acceleration: float
    follows: float
    open: float


def shut_gaps(plant: AnyPlant, records: Sequence[PreparedRecord]) -> tuple[Finding, ...]:
    """One finding for each joint of a nonlinear plant whose load never leaves its drive in any of the records.

    Nothing is said of a joint where no parameter tells what hangs behind it.
    """
    if not isinstance(plant, NonlinearPlant):
        return ()
    names = [s.name for s in plant.states]
    places = [
        _Place(p.name, names.index(p.position), names.index(p.name), share)
        for p in plant.port_places if p.kind == "joint" and p.position
        for share in shares_behind(plant, p.name)
    ]  # fmt: skip
    if not places:
        return ()
    motions = [(r.motion, r.u, np.gradient(r.motion, r.record.dt, axis=0)) for r in records if r.motion is not None]
    about = [_about(plant, *motion) for motion in motions]
    forces = [np.concatenate([carried_force(m, p.joint, p.share, motion) for m, motion in about]) for p in places]
    shut = [k for k, f in enumerate(forces) if f.min() > 0.0 or f.max() < 0.0]
    open_ones = {p.joint for k, p in enumerate(places) if k not in shut}
    x = np.concatenate([motion[0] for motion in motions])
    found = []
    for k in shut:
        if places[k].joint not in open_ones and not any(f.channel == places[k].joint for f in found):
            found.append(_finding(plant, places[k], forces[k], x))
    return tuple(found)


def _about(plant: NonlinearPlant, x: Array, u: Array, accelerations: Array) -> tuple[PortModel, Motion]:
    local = plant.local_models(x, u)
    return local_port_model(plant, local), Motion(x, u, local.rates, accelerations)


def _finding(plant: NonlinearPlant, place: _Place, force: Array, x: Array) -> Finding:
    """What is said of a joint; ``force``: that keeps its load, along the records' states ``x``."""
    port = next(p for p in plant.port_places if p.name == place.joint)
    unit = plant.states[place.position].unit
    said = f"a backlash here would not show: its gap never opens, the load stays with {force.min():.3g} to "
    said += f"{force.max():.3g} {port.unit} at one flank"
    evidence: dict[str, object] = {"force": [float(force.min()), float(force.max())]}
    swing = _proposed(plant, place, x)
    if swing is None:
        return Finding("shut-gap", place.joint, said, "", "a motion that takes the load off its drive", False, evidence)
    names = [plant.states[k].name for k in _positions(plant)]
    at = ", ".join(f"{name} = {value:.4g}" for name, value in zip(names, swing.pose, strict=True))
    hint = (
        f"swing {plant.states[place.position].name} by {swing.amplitude:.3g} {unit} at {swing.frequency:.3g} Hz about "
        f"{at} with the other joints at rest: the drive is then accelerated by up to {swing.acceleration:.4g} "
        f"{unit}/s2, the load follows to {swing.follows:.4g}, and the gap opens for {100 * swing.open:.2g} % of the "
        "time"
    )
    told = {**swing._asdict(), "pose": dict(zip(names, swing.pose, strict=True))}
    return Finding("shut-gap", place.joint, said, "", hint, False, evidence | told)


def _positions(plant: NonlinearPlant) -> list[int]:
    names = [s.name for s in plant.states]
    return [names.index(p.position) for p in plant.port_places if p.position]


def _proposed(plant: NonlinearPlant, place: _Place, x: Array) -> _Swing | None:
    """The swing of one joint that takes its load off.

    None where no acceleration takes the load off, or the swing would leave the positions that the records visit.
    """
    visited, own = x[np.unique(np.linspace(0, len(x) - 1, POSES).astype(int))], _positions(plant)
    poses = np.zeros_like(visited)
    poses[:, own] = visited[:, own]
    still, one = np.zeros_like(poses), np.zeros_like(poses)
    one[:, place.velocity] = 1.0
    at_rest, accelerated = (_along(plant, place, poses, rates) for rates in (still, one))
    needed = -at_rest / (accelerated - at_rest)
    k = int(np.argmin(np.abs(needed)))
    largest, follows = TIMES * abs(float(needed[k])), abs(float(needed[k]))
    speed = SPEED * float(np.abs(x[:, place.velocity]).max())
    rate = largest / speed if speed else math.inf
    if not (0.0 < rate < math.inf) or 2.0 * speed / rate > float(np.ptp(x[:, place.position])):
        return None
    phase = 2.0 * np.pi * np.arange(PERIOD) / PERIOD
    swing, rates = np.repeat(poses[k][None], PERIOD, axis=0), np.zeros((PERIOD, x.shape[1]))
    swing[:, place.position] += speed / rate * np.sin(phase)
    swing[:, place.velocity] = speed * np.cos(phase)
    rates[:, place.velocity] = -largest * np.sin(phase)
    try:
        share = float(np.mean(_along(plant, place, swing, rates) * at_rest[k] < 0.0))
    except RobustlabError:  # it leads where the plant cannot be
        return None
    pose = tuple(float(q) for q in poses[k, own])
    return _Swing(pose, speed / rate, rate / (2.0 * math.pi), largest, follows, share) if share else None


def _along(plant: NonlinearPlant, place: _Place, x: Array, accelerations: Array) -> Array:
    """Force that keeps the load at its drive along a motion that is asked for; no input is needed to tell it."""
    model, motion = _about(plant, x, np.zeros((len(x), len(plant.inputs))), accelerations)
    return carried_force(model, place.joint, place.share, motion)
