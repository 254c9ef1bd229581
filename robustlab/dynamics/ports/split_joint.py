"""A joint split into drive and load, for a gap or a coupling between them.

For a nonlinear plant, all forces except the drive's own act on the load.
"""
# With M the mass matrix, b = M^-1 e_j, J = 1/(e_j^T b), the drive's part (1 - s) J, a the accelerations of the whole
# plant in the load's position, D the drive's own force and F the force of the load on the drive:
# (1 - s) J v1' = D(v1) + F, v_load' = a + (1 - s)/s J b a_j - b/s (D(v2) + F) (Sherman, Morrison).

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from robustlab.arrays import Array, Indices
from robustlab.checks import number
from robustlab.dynamics.plant_contract import NonlinearPlant
from robustlab.dynamics.ports.port_model import Port, PortModel
from robustlab.errors import InputError, RobustlabError

ASIDE = 0.05  # offset of the states for the check that an inertia is constant
ROUNDING = 1e-9  # of an inertia
LEAST_SHARE = 1e-4  # of the load, at poses with less inertia than the drive's


def _with_carried_load(model: PortModel, joint: str, share: float, relative: str) -> PortModel:
    """Return `with_load_side` for a model along a motion."""
    port = model.ports[joint]
    places = {n: int(np.argmax(p.velocity)) for n, p in model.ports.items() if p.kind == "joint"}
    rows, j = np.array(sorted(places.values()), dtype=np.int64), places[joint]
    inertia = port.inertia[:, None]
    home = port.home_inertia or port.mean_inertia
    s = np.maximum(1.0 - (1.0 - share) * home / inertia, LEAST_SHARE)
    n = len(port.velocity)
    drive_a, drive_b = _drives_own(model, port, places, rows)
    wide = model.widened(np.zeros((2, n + 2)))
    a, b = wide.A.copy(), wide.B.copy()
    # the plant in the load's coordinates: the joint's states minus delta and its rate
    a[:, rows, n + 1] = -model.A[:, rows, j]
    load_a = drive_a.copy()
    load_a[:, n + 1] = -drive_a[:, j]
    if port.position is not None:
        a[:, rows, n] = -model.A[:, rows, int(np.argmax(port.position))]
    pushed = port.force[:, rows] / s
    whole_a, whole_b = a[:, j].copy(), b[:, j].copy()
    a[:, rows] += pushed[..., None] * ((1.0 - s) * inertia * whole_a - load_a)[:, None, :]
    b[:, rows] += pushed[..., None] * ((1.0 - s) * inertia * whole_b - drive_b)[:, None, :]
    load_row_a, load_row_b = a[:, j].copy(), b[:, j].copy()
    drive = (1.0 - s) * inertia
    a[:, j], b[:, j] = drive_a / drive, drive_b / drive
    a[:, n, n + 1] = 1.0
    a[:, n + 1], b[:, n + 1] = a[:, j] - load_row_a, b[:, j] - load_row_b
    ports = {name: _on_load(p, wide.ports[joint], rows, s, inertia) for name, p in wide.ports.items()}
    load = _load(wide.ports[joint], ports[joint].force)
    force = np.zeros_like(load.force)  # of the drive, on the drive and on the relative velocity
    force[:, [j, n + 1]] = 1.0 / drive
    ports[joint] = replace(wide.ports[joint], force=force)
    gap = _relative_port(ports[joint], load, f"{joint}.{relative}", (s * drive)[:, 0, None])
    return replace(wide, A=a, B=b, ports={**ports, load.name: load, gap.name: gap})


def shares_behind(plant: NonlinearPlant, joint: str) -> tuple[float, ...]:
    """Return the smallest and largest load share of a joint's inertia, if a parameter is the drive's inertia."""
    names = [s.name for s in plant.states]
    joints = [(k, names.index(p.name)) for k, p in enumerate(plant.port_places) if p.kind == "joint"]
    rows, columns = np.array([k for _, k in joints]), np.array([k for k, _ in joints])
    j = [names[k] for k in rows].index(joint)
    n = len(names)
    x = plant.start + np.outer([0.0, ASIDE], 1.0 + np.arange(n) / n)

    def masses(values: Mapping[str, float]) -> Array:
        local = plant.local_models(x, np.zeros((2, len(plant.inputs))), values)
        return np.linalg.inv(local.push[:, rows[:, None], columns])

    try:
        whole, found = masses(plant.values), []
        for name, p in plant.parameters.items():
            if p.role == "inertia" and p.value:
                part = 2.0 * (whole - masses({**plant.values, name: 0.5 * p.value}))
                own = part[0, j, j]
                rest = np.abs(part[:, j]).sum(axis=1) - own
                if own > ROUNDING * whole[0, j, j] and (np.abs([*rest, part[1, j, j] - own]) < ROUNDING * own).all():
                    found.append(1.0 - own * float(np.linalg.inv(whole[0])[j, j]))
    except (RobustlabError, np.linalg.LinAlgError):
        return ()
    found = [float(s) for s in found if 0.0 < s < 1.0]
    return (min(found), max(found))[: len(set(found))] if found else ()


def _drives_own(model: PortModel, port: Port, places: Mapping[str, int], rows: Indices) -> tuple[Array, Array]:
    """Return the drive's own force by inputs, currents and viscous friction, as rows over states and columns of B."""
    joints = [p for p in model.ports.values() if p.kind == "joint"]
    push = np.stack([p.force[:, rows] for p in joints], axis=2)
    unit = np.array([float(p.name == port.name) for p in joints])[:, None]
    # the joint's row of the mass matrix, (n_points, n_joints)
    row = np.linalg.solve(np.swapaxes(push, 1, 2), np.broadcast_to(unit, (len(push), *unit.shape)))[..., 0]
    n, n_u = len(port.velocity), model.B.shape[-1] - model.own
    over_x = np.zeros((len(row), n + 2))
    for other in model.ports.values():
        if other.kind == "current":
            k = int(np.argmax(other.velocity))
            over_x[:, k] = np.einsum("mr,mr->m", row, model.A[:, rows, k])
    over_x[:, places[port.name]] = -port.drag
    over_b = np.zeros((len(row), model.B.shape[-1]))
    over_b[:, :n_u] = np.einsum("mr,mru->mu", row, model.B[:, rows, :n_u])
    return over_x, over_b


def _on_load(port: Port, joint: Port, rows: Indices, s: Array, inertia: Array) -> Port:
    """Return the port at which a force acts on the machine without the drive."""
    j = int(np.argmax(joint.velocity))
    at_joint = port.force[:, j, None]
    force = port.force.copy()
    force[:, rows] += (1.0 - s) / s * inertia * joint.force[:, rows] * at_joint
    force[:, -1] = -force[:, j]
    force[:, j] = 0.0
    return replace(port, force=force)


def _load(joint: Port, force: Array) -> Port:
    """Return the port of the load: its motion is the joint's minus the relative one."""
    delta, rate = np.eye(len(joint.velocity))[-2:]
    position = None if joint.position is None else joint.position - delta
    return replace(joint, name=f"{joint.name}.load", force=force, velocity=joint.velocity - rate, position=position)


def with_load_side(model: PortModel, joint: str, share: float, relative: str, where: str) -> PortModel:
    """Return the model with the joint's load as a separate body, without force between drive and load."""
    port = model.ports[joint]
    if f"{joint}.load" in model.ports or "." in joint:
        raise InputError(f"{where}: {joint!r}", "another effect that splits the joint in two", "one of them at a joint")
    number(f"{where}: share", share, "a share of the inertia between 0 and 1", above=0.0, below=1.0)
    if model.A.ndim > 2:
        return _with_carried_load(model, joint, share, relative)
    split = _with_less_inertia(model, port, share)
    n, drive = len(port.velocity), split.ports[joint]
    rows = np.zeros((2, n + 2))
    rows[0, n + 1] = 1.0
    wide = split.widened(rows)
    a, b = wide.A.copy(), wide.B.copy()
    a[..., n + 1, :n] = drive.velocity @ split.A  # free load: the relative acceleration is the drive's
    b[..., n + 1, :] = drive.velocity @ split.B
    ports = {}
    for name, p in wide.ports.items():
        force = p.force.copy()
        force[..., -1] = split.ports[name].force @ drive.velocity
        ports[name] = replace(p, force=force)
    drive = ports[joint]
    load = _load(drive, -1.0 / (share * port.inertia[..., None]) * np.eye(n + 2)[-1])
    gap = _relative_port(drive, load, f"{joint}.{relative}", (share * (1.0 - share) * port.inertia)[..., None])
    return replace(wide, A=a, B=b, ports={**ports, load.name: load, gap.name: gap})


def _relative_port(drive: Port, load: Port, name: str, reduced: Array) -> Port:
    """Return the port of the relative motion, with forces per reduced inertia."""
    (delta, rate), unit = np.eye(len(drive.velocity))[-2:], drive.speed_unit.removesuffix("/s")
    return replace(
        drive, name=name, kind="relative", unit=f"{unit}/s2", position_unit=unit,
        force=reduced * (drive.force - load.force), velocity=rate, position=delta,
    )  # fmt: skip


def _with_less_inertia(model: PortModel, port: Port, share: float) -> PortModel:
    """Return the equations with :math:`(1 - s) J` at the joint."""
    pulled = (port.inertia[..., None] * port.force)[..., :, None] * port.velocity
    change = np.eye(len(port.velocity)) + share / (1.0 - share) * pulled
    ports = {name: replace(p, force=(change @ p.force[..., None])[..., 0]) for name, p in model.ports.items()}
    return replace(model, A=change @ model.A, B=change @ model.B, ports=ports)
