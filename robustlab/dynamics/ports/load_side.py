"""A joint split in two, the drive and the load behind it, with a gap or a coupling between them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from robustlab.arrays import Array
from robustlab.checks import number
from robustlab.dynamics.ports.carried_load import with_carried_load
from robustlab.dynamics.ports.port_model import Port, PortModel
from robustlab.errors import InputError


def with_load_side(model: PortModel, joint: str, share: float, relative: str, where: str) -> PortModel:
    """The model with the joint's load behind it, not yet connected: no force between the two."""
    port = model.ports.get(joint)
    if port is None or port.kind != "joint":
        joints = ", ".join(p.name for p in model.ports.values() if p.kind == "joint")
        raise InputError(f"{where}: {joint!r}", "no such joint", f"one of {joints}")
    if f"{joint}.load" in model.ports or "." in joint:
        raise InputError(f"{where}: {joint!r}", "another effect that splits the joint in two", "one of them at a joint")
    number(f"{where}: share", share, "a share of the inertia between 0 and 1", above=0.0, below=1.0)
    if model.A.ndim > 2:
        return with_carried_load(model, joint, share, relative)
    split = _with_less_inertia(model, port, share)
    n, drive = len(port.velocity), split.ports[joint]
    rows = np.zeros((2, n + 2))
    rows[0, n + 1] = 1.0
    wide = split.widened(rows)
    a, b = wide.A.copy(), wide.B.copy()
    a[..., n + 1, :n] = drive.velocity @ split.A  # the load is free: the rate grows as the drive's does
    b[..., n + 1, :] = drive.velocity @ split.B
    ports = {name: _on_drive(p, split.ports[name].force @ drive.velocity) for name, p in wide.ports.items()}
    drive = ports[joint]
    load = _load(drive, 1.0 / (share * port.inertia))
    reduced = (share * (1.0 - share) * port.inertia)[..., None]
    gap = replace(
        drive,
        name=f"{joint}.{relative}",
        kind="relative",
        unit=f"{drive.speed_unit.removesuffix('/s')}/s2",
        position_unit=drive.speed_unit.removesuffix("/s"),
        force=reduced * (drive.force - load.force),
        velocity=np.eye(n + 2)[n + 1],
        position=np.eye(n + 2)[n],
    )
    return replace(wide, A=a, B=b, ports={**ports, load.name: load, gap.name: gap})


def _with_less_inertia(model: PortModel, port: Port, share: float) -> PortModel:
    """The equations with :math:`(1 - s) J` at the joint."""
    pulled = (port.inertia[..., None] * port.force)[..., :, None] * port.velocity
    change = np.eye(len(port.velocity)) + share / (1.0 - share) * pulled
    ports = {name: replace(p, force=(change @ p.force[..., None])[..., 0]) for name, p in model.ports.items()}
    return replace(model, A=change @ model.A, B=change @ model.B, ports=ports)


def _on_drive(port: Port, acceleration: Array) -> Port:
    """The port with the drive's acceleration by its force in the rate of the relative velocity as well."""
    force = port.force.copy()
    force[..., -1] = acceleration
    return replace(port, force=force)


def _load(drive: Port, mobility: Array) -> Port:
    """Port of the load: its motion is the drive's less the relative one."""
    delta, rate = np.eye(len(drive.velocity))[-2:]
    position = None if drive.position is None else drive.position - delta
    name, force = f"{drive.name}.load", -mobility[..., None] * rate
    return replace(drive, name=name, force=force, velocity=drive.velocity - rate, position=position)
