r"""A linear plant with its ports: places where the forces of effects act and their motion is measured.

.. math::
    \dot x = A x + B u + \sum_j b_j f_j, \qquad v_j = c_j^T x, \qquad q_j = p_j^T x, \qquad y = C x + D u
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Literal

import numpy as np

from robustlab.arrays import Array
from robustlab.dynamics.linear_plant import Descriptor, LinearPlant
from robustlab.dynamics.parameters import Parameter
from robustlab.dynamics.plant_contract import NonlinearPlant
from robustlab.errors import InputError
from robustlab.statespace import StateSpaceModel

AnyPlant = LinearPlant | NonlinearPlant
SPEED_UNITS = {"rad/s": "N m", "m/s": "N"}  # unit of a velocity -> unit of the force at that joint
INERTIA_UNITS = {"rad/s": "kg m2", "m/s": "kg"}
COORDINATES = ("centre-of-mass", "gravity-direction")  # roles that allow the value 0
ASSUMED = "read off the matrices of the model"


@dataclass(frozen=True, eq=False)
class Port:
    """A place where a force acts."""

    name: str  # its velocity or current state
    # ``"joint"``, ``"current"``, or ``"relative"`` (between the two sides of a split joint)
    kind: Literal["joint", "current", "relative"]
    # units of the force, of the velocity or current, of the position (empty without one)
    unit: str
    speed_unit: str
    position_unit: str
    force: Array  # b, shape (n_x,), or (m, n_x) along a motion: rate of the states per unit of force
    velocity: Array  # c, shape (n_x,)
    position: Array | None  # p, shape (n_x,), or None where no state integrates the velocity
    # Nonlinear plants: inertia at the plant's start (0: unknown), and viscous friction, force per velocity.
    home_inertia: float = 0.0
    drag: float = 0.0

    @property
    def inertia(self) -> Array:
        """Force per acceleration with all other velocities free; shape (), or (m,) along a motion."""
        return np.asarray(1.0 / (self.force @ self.velocity))

    @property
    def mean_inertia(self) -> float:
        return float(np.mean(self.inertia))

    def widened(self, extra: int) -> Port:
        """Return the port of a model with ``extra`` further states at the end."""
        position = None if self.position is None else _padded(self.position, extra)
        force, velocity = _padded(self.force, extra), _padded(self.velocity, extra)
        return replace(self, force=force, velocity=velocity, position=position)


def _padded(array: Array, extra: int) -> Array:
    """Return the array with ``extra`` zeros at the end of its last axis."""
    return np.concatenate([array, np.zeros((*array.shape[:-1], extra))], axis=-1)


@dataclass(frozen=True, eq=False)
class PortModel:
    """Matrices and ports of a linear plant, or of a nonlinear one along a motion, at given parameter values."""

    # Shapes (n_x, n_x), (n_x, n_u), (n_y, n_x), (n_y, n_u). Along a motion with a leading axis of m points, as the
    # ports' forces; B then has further columns for rates: the unit matrix of the plant's own states.
    A: Array
    B: Array
    C: Array
    D: Array
    ports: Mapping[str, Port]  # name -> `Port`
    own: int  # number of leading states of the plant itself; effects append theirs

    def with_state_feedback(self, port: Port, row: Array) -> PortModel:
        """Return the model with the force ``row @ x`` at the port: ``A + b row``."""
        return replace(self, A=self.A + port.force[..., :, None] * row)

    def widened(self, rows: Array) -> PortModel:
        """Return the model with further states ``z' = rows @ [x; z]``; ``rows``: (extra, n_x + extra)."""
        extra, many = len(rows), self.A.shape[:-2]
        below = np.broadcast_to(rows, (*many, *rows.shape))
        still = np.zeros((*many, extra, self.B.shape[-1]))
        return replace(
            self,
            A=np.concatenate([_padded(self.A, extra), below], axis=-2),
            B=np.concatenate([self.B, still], axis=-2),
            C=_padded(self.C, extra),
            ports={name: port.widened(extra) for name, port in self.ports.items()},
        )


def port_model(plant: LinearPlant, factors: Mapping[str, float] | None = None) -> PortModel:
    """Return the plant's matrices and ports with some parameters at ``factors`` of `Parameter.reference`."""
    values = dict(plant.values)
    for name, factor in (factors or {}).items():
        values[name] = plant.parameters[name].reference * factor
    e, f, g, c, d = plant.matrices(values)
    n, n_u = len(plant.states), len(plant.inputs)
    solved = np.asarray(np.linalg.solve(e, np.hstack([f, g, np.eye(n)])), dtype=float)
    a, b, push = solved[:, :n], solved[:, n : n + n_u], solved[:, n + n_u :]
    ports = {}
    for k, (name, unit) in enumerate(plant.states):
        eye = np.eye(n)[k]
        if unit in SPEED_UNITS:
            q = _integrating_state(a, b, k)
            position = None if q is None else np.eye(n)[q]
            position_unit = "" if q is None else plant.states[q].unit
            inertia = INERTIA_UNITS[unit]
            per_inertia = "" if k in _mechanical(plant) else f"/({inertia})" if " " in inertia else f"/{inertia}"
            force_unit = f"{SPEED_UNITS[unit]}{per_inertia}"
            ports[name] = Port(name, "joint", force_unit, unit, position_unit, push[:, k], eye, position)
        elif unit == "A":
            ports[name] = Port(name, "current", "V", "A", "", push[:, k], eye, None)
    return PortModel(a, b, c, d, ports, n)


def _integrating_state(a: Array, b: Array, velocity: int) -> int | None:
    """Return the index of the state whose rate is exactly the velocity state."""
    unit = np.eye(len(a))[velocity]
    for k, row in enumerate(a):
        if np.array_equal(row, unit) and not b[k].any():
            return k
    return None


@lru_cache(maxsize=64)
def _mechanical(plant: LinearPlant) -> frozenset[int]:
    """Return the states whose equations contain an inertia with a unit, so that their terms are forces."""
    units = INERTIA_UNITS.values()
    inertias = [n for n, p in plant.parameters.items() if p.unit and (p.role == "inertia" or p.unit in units)]
    return frozenset[int]().union(*(_rows(plant, name) for name in inertias))


def _rows(plant: LinearPlant, name: str) -> frozenset[int]:
    """Return the equations that contain the parameter."""
    values = plant.values
    other = {**values, name: values[name] * 1.25 + (values[name] == 0)}
    changed = [
        np.abs(there - here).sum(axis=1)
        for there, here in zip(plant.matrices(other)[:3], plant.matrices(values)[:3], strict=True)
    ]
    return frozenset(int(k) for k in np.flatnonzero(np.sum(changed, axis=0)))


def parameter_groups(plant: AnyPlant) -> tuple[tuple[str, str, tuple[str, ...]], ...]:
    """Return groups of parameters with a common error of one physical quantity: (role, label, names)."""
    groups: dict[tuple[str, frozenset[int] | str], list[str]] = {}
    for name, parameter in plant.parameters.items():
        if parameter.role and (parameter.value or parameter.role in COORDINATES):
            if parameter.role in ("torque-constant", *COORDINATES):
                where: frozenset[int] | str = ""
            else:
                where = _rows(plant, name) if isinstance(plant, LinearPlant) else name
            groups.setdefault((parameter.role, where), []).append(name)
    return tuple((role, "+".join(names), tuple(names)) for (role, _), names in groups.items())


def linear_plant_of(plant: LinearPlant | StateSpaceModel, where: str = "effects") -> LinearPlant:
    """Return the plant itself, or a continuous model as a plant with its gains and dampings as parameters."""
    if isinstance(plant, LinearPlant):
        return plant
    if not isinstance(plant, StateSpaceModel):
        raise InputError(where, f"a {type(plant).__name__}", "a linear Plant or a StateSpaceModel")
    if plant.is_discrete:
        raise InputError(where, f"a discrete model (dt = {plant.dt:g} s)", "a continuous model")
    speeds = [(k, s) for k, s in enumerate(plant.states) if s.unit in SPEED_UNITS]
    parameters = {}
    for name, _ in plant.inputs:
        parameters[f"gain_{name}"] = Parameter(f"gain_{name}", 1.0, source=ASSUMED, role="input-gain")
    inertias = {name: _known_inertia(plant, k) for k, (name, _) in speeds}
    for k, (name, unit) in speeds:
        known = inertias[name]
        parameters[f"inertia_{name}"] = Parameter(
            f"inertia_{name}", known or 1.0, INERTIA_UNITS[unit] if known else "", 0.0, ASSUMED, role="inertia"
        )
        damping_unit = f"{SPEED_UNITS[unit]} s/{unit.removesuffix('/s')}" if known else "1/s"
        parameters[f"damping_{name}"] = Parameter(
            f"damping_{name}", -plant.A[k, k] * (known or 1.0), damping_unit, 0.0, ASSUMED, role="viscous-friction"
        )

    def equations(p: Mapping[str, float]) -> Descriptor:
        e, f = np.eye(plant.n_states), plant.A.copy()
        g = plant.B * np.array([p[f"gain_{name}"] for name in plant.input_names])
        for k, (name, _) in speeds:
            known = inertias[name] or 1.0
            f[k], g[k] = known * f[k], known * g[k]
            e[k, k] = p[f"inertia_{name}"]
            f[k, k] = -p[f"damping_{name}"]
        return Descriptor(e, f, g, plant.C, plant.D)

    return LinearPlant("model", parameters, plant.inputs, plant.outputs, plant.states, equations=equations)


def _known_inertia(model: StateSpaceModel, velocity: int) -> float | None:
    """Return the inertia of a velocity state of a model if an input is its force or a motor drives it, else None."""
    unit = model.states[velocity].unit
    speeds = [k for k, s in enumerate(model.states) if s.unit in SPEED_UNITS]
    for j, signal in enumerate(model.inputs):
        if signal.unit == SPEED_UNITS[unit] and [k for k in speeds if model.B[k, j]] == [velocity]:
            return 1.0 / abs(float(model.B[velocity, j]))
    for c, state in enumerate(model.states):
        volts = [j for j, signal in enumerate(model.inputs) if signal.unit == "V" and model.B[c, j]]
        if state.unit != "A" or len(volts) != 1 or not model.A[velocity, c]:
            continue
        found = -float(model.A[c, velocity] / (model.B[c, volts[0]] * model.A[velocity, c]))
        if found > 0.0:
            return found
    return None
