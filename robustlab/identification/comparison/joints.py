"""Which joint of a nonlinear plant each output and each input belongs to, and its motion along a record."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from robustlab.arrays import Array
from robustlab.dynamics.plant_contract import LocalModels, NonlinearPlant
from robustlab.identification.comparison.localisation import Motion
from robustlab.record import Record

__all__ = ["motions_of_inputs", "motions_of_outputs", "without_a_joint"]

MOSTLY = 10.0  # times what ties it to any other joint: then it belongs to this one
POINTS = 60  # of the motion from which the ties are taken
NO_MOTION = Motion(None, None, "", "", "", "")


def motions_of_outputs(
    plant: NonlinearPlant, x: Array, u: Array, record: Record, columns: Sequence[int]
) -> dict[str, Motion]:
    """Output name -> motion of its joint along the states x (n, n_x); a `Motion` of nothing where it has no one joint.

    A current belongs to the joint whose speed acts on it most.
    """
    local = _about(plant, x, u)
    return {plant.outputs[k].name: _motion(plant, _joint_of_output(plant, local, x, k), x, record) for k in columns}


def motions_of_inputs(plant: NonlinearPlant, x: Array, u: Array, record: Record) -> dict[str, Motion]:
    """Input name -> motion of the joint that it drives, at once or through a current."""
    local = _about(plant, x, u)
    ties = _ties_of_inputs(plant, local, x)
    return {s.name: _motion(plant, _foremost(ties[i]), x, record) for i, s in enumerate(plant.inputs)}


def _about(plant: NonlinearPlant, x: Array, u: Array) -> LocalModels:
    at = np.unique(np.linspace(0, len(x) - 1, POINTS).astype(int))
    return plant.local_models(x[at], u[at])


def _joints(plant: NonlinearPlant) -> list[tuple[int, int]]:
    """Index of position (-1 without one) and velocity of each joint."""
    names = [s.name for s in plant.states]
    return [
        (names.index(p.position) if p.position else -1, names.index(p.name))
        for p in plant.port_places
        if p.kind == "joint"
    ]


def _joint_of_output(plant: NonlinearPlant, local: LocalModels, x: Array, output: int) -> int | None:
    """Number of the joint of an output that shows one state."""
    state = int(np.abs(local.C[:, output]).mean(axis=0).argmax())
    joints = _joints(plant)
    own = next((j for j, pair in enumerate(joints) if state in pair), None)
    return own if own is not None or not joints else _foremost(_ties_of_state(local, joints, x, state))


def _ties_of_state(local: LocalModels, joints: Sequence[tuple[int, int]], x: Array, state: int) -> Array:
    """What the speeds of the joints do to the rate of a state, (n_joints,)."""
    speeds = [v for _, v in joints]
    return np.abs(local.A[:, state, speeds]).mean(axis=0) * np.sqrt((x[:, speeds] ** 2).mean(axis=0))


def _ties_of_inputs(plant: NonlinearPlant, local: LocalModels, x: Array) -> Array:
    """Generalised force of each input at each joint, (n_u, n_joints); of a voltage, the ties of its current."""
    joints = _joints(plant)
    found = np.zeros((len(plant.inputs), len(joints)))
    if not joints:
        return found
    rows = [v for _, v in joints]
    places = [k for k, p in enumerate(plant.port_places) if p.kind == "joint"]
    inverse = np.linalg.pinv(local.push[:, rows][:, :, places])
    found[:] = np.abs(inverse @ local.B[:, rows]).mean(axis=0).T
    for i in np.flatnonzero(~found.any(axis=1)):
        for state in np.flatnonzero(np.abs(local.B[:, :, i]).mean(axis=0)):
            found[i] += _ties_of_state(local, joints, x, int(state))
    return found


def _foremost(ties: Array) -> int | None:
    order = np.argsort(ties)[::-1]
    if not len(ties) or not ties[order[0]]:
        return None
    return int(order[0]) if len(ties) == 1 or ties[order[0]] >= MOSTLY * ties[order[1]] else None


def _motion(plant: NonlinearPlant, joint: int | None, x: Array, record: Record) -> Motion:
    if joint is None:
        return NO_MOTION
    q, v = _joints(plant)[joint]
    speed, unit = plant.states[v].name, plant.states[v].unit
    if q < 0:
        return Motion(x[:, v], None, unit, "", f"{speed} (smoothed)", "")
    name = plant.states[q].name
    if name in record.outputs:
        return Motion(x[:, v], record[name], unit, record.unit(name), f"{speed} (smoothed)", name)
    return Motion(x[:, v], x[:, q], unit, plant.states[q].unit, f"{speed} (smoothed)", f"{name} (smoothed)")


def without_a_joint(motions: Mapping[str, Motion]) -> list[str]:
    """The signals that belong to no one joint."""
    return [name for name, motion in motions.items() if motion.speed is None]
