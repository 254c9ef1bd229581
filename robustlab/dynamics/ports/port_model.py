"""A linear plant with ports, places where forces f_j of effects act: x' = A x + B u + sum b_j f_j, v_j = c_j x."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Literal

import numpy as np

from robustlab.arrays import Array, Indices
from robustlab.checks import number
from robustlab.dynamics.linear_plant import Descriptor, LinearPlant
from robustlab.dynamics.parameters import Parameter
from robustlab.dynamics.plant_base import LocalModels, NonlinearPlant
from robustlab.errors import InputError, RobustlabError
from robustlab.statespace import StateSpaceModel

AnyPlant = LinearPlant | NonlinearPlant
SPEED_UNITS = {"rad/s": "N m", "m/s": "N"}  # unit of a velocity -> unit of the force at that joint
INERTIA_UNITS = {"rad/s": "kg m2", "m/s": "kg"}
COORDINATES = ("centre-of-mass", "gravity-direction")  # roles that allow the value 0
ASSUMED = "read off the matrices of the model"

TERMS = 9  # of the exponential's series below half a unit of the matrix's norm: rounding
SMALL = 0.5
SHARE = 1e-3  # allowed relative change of a force's effect over half a stride
STRIDES = (16, 8, 4, 2)  # steps with common matrices

ASIDE = 0.05  # offset of the states for the check that an inertia is constant
ROUNDING = 1e-9  # of an inertia
LEAST_SHARE = 1e-4  # of the load, at poses with less inertia than the drive's


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
            # the state whose rate is exactly the velocity
            q = next((j for j, row in enumerate(a) if np.array_equal(row, eye) and not b[j].any()), None)
            position = None if q is None else np.eye(n)[q]
            position_unit = "" if q is None else plant.states[q].unit
            inertia = INERTIA_UNITS[unit]
            per_inertia = "" if k in _mechanical(plant) else f"/({inertia})" if " " in inertia else f"/{inertia}"
            force_unit = f"{SPEED_UNITS[unit]}{per_inertia}"
            ports[name] = Port(name, "joint", force_unit, unit, position_unit, push[:, k], eye, position)
        elif unit == "A":
            ports[name] = Port(name, "current", "V", "A", "", push[:, k], eye, None)
    return PortModel(a, b, c, d, ports, n)


@lru_cache(maxsize=64)
def _mechanical(plant: LinearPlant) -> frozenset[int]:
    """Return the states whose equations contain an inertia with a unit, so that their terms are forces."""
    units = INERTIA_UNITS.values()
    inertias = [n for n, p in plant.parameters.items() if p.unit and (p.role == "inertia" or p.unit in units)]
    return frozenset[int]().union(*(_rows(plant, name) for name in inertias))


def _rows(plant: LinearPlant, name: str) -> frozenset[int]:
    values = plant.values
    here, there = plant.matrices(values), plant.matrices({**values, name: values[name] * 1.25 + (values[name] == 0)})
    changed = np.hstack([after - before for before, after in zip(here[:3], there[:3], strict=True)])
    return frozenset(np.flatnonzero(changed.any(axis=1)).tolist())


def parameter_groups(plant: AnyPlant) -> tuple[tuple[str, str, tuple[str, ...]], ...]:
    """Return groups of parameters with a common error of one physical quantity: (role, label, names)."""
    groups: dict[tuple[str, frozenset[int] | str], list[str]] = {}
    for name, parameter in plant.parameters.items():
        if parameter.role and (parameter.value or parameter.role in COORDINATES):
            one = parameter.role in ("torque-constant", *COORDINATES)
            where = "" if one else _rows(plant, name) if isinstance(plant, LinearPlant) else name
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
    made = [Parameter(f"gain_{name}", 1.0, source=ASSUMED, role="input-gain") for name, _ in plant.inputs]
    inertias = {name: _known_inertia(plant, k) for k, (name, _) in speeds}
    for k, (name, unit) in speeds:
        known = inertias[name]
        units = (INERTIA_UNITS[unit], f"{SPEED_UNITS[unit]} s/{unit.removesuffix('/s')}") if known else ("", "1/s")
        damping = -plant.A[k, k] * (known or 1.0)
        made += [
            Parameter(f"inertia_{name}", known or 1.0, units[0], 0.0, ASSUMED, role="inertia"),
            Parameter(f"damping_{name}", damping, units[1], 0.0, ASSUMED, role="viscous-friction"),
        ]

    def equations(p: Mapping[str, float]) -> Descriptor:
        e, f = np.eye(plant.n_states), plant.A.copy()
        g = plant.B * np.array([p[f"gain_{name}"] for name in plant.input_names])
        for k, (name, _) in speeds:
            known = inertias[name] or 1.0
            f[k], g[k] = known * f[k], known * g[k]
            e[k, k] = p[f"inertia_{name}"]
            f[k, k] = -p[f"damping_{name}"]
        return Descriptor(e, f, g, plant.C, plant.D)

    parameters = {p.name: p for p in made}
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


# --- along a motion ---------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Course:
    """A motion about which a plant is linearised."""

    plant: NonlinearPlant
    # states (n, n_x) and inputs (n, n_u) at the samples of a record; inputs are held between them
    x: Array
    u: Array
    dt: float  # sample time in s
    like: Course | None = None  # a similar course whose stride is used

    @cached_property
    def _slope(self) -> Array:
        """Slopes per sample of a not-a-knot spline at the samples."""
        from scipy.interpolate import make_interp_spline

        n = np.arange(len(self.x))
        return np.asarray(make_interp_spline(n, self.x, k=min(3, len(self.x) - 1))(n, nu=1))

    def at(self, place: Array) -> tuple[Array, Array]:
        """Return states (k, n_x) and inputs (k, n_u) at fractional sample numbers."""
        k = np.clip(place.astype(int), 0, len(self.x) - 2)
        s = (place - k)[:, None]
        a, b, da, db = self.x[k], self.x[k + 1], self._slope[k], self._slope[k + 1]
        hermite = a + s * (da + s * (3.0 * (b - a) - 2.0 * da - db + s * (2.0 * (a - b) + da + db)))
        held = np.clip(place.astype(int), 0, len(self.u) - 1)
        return hermite, self.u[held]

    @cached_property
    def stride(self) -> int:
        """Number of samples with common matrices."""
        if self.like is not None:
            return self.like.stride
        n = len(self.x)
        places = np.unique(np.linspace(0, n - 1, min(n, 24)).astype(int)).astype(float)
        here = self.plant.local_models(*self.at(places + 0.5))
        for stride in STRIDES:
            there = self.plant.local_models(*self.at(np.minimum(places + 0.5 + 0.5 * stride, n - 1.0)))
            # The error is largest half a stride away.
            if np.abs(here.push - there.push).max(initial=0.0) <= SHARE * np.abs(here.push).max(initial=0.0):
                return stride
        return 1


@dataclass(frozen=True, eq=False)
class MotionModel:
    """A plant linearised about the steps of some windows of a course."""

    model: PortModel  # matrices and ports, with an axis of points: one every ``stride`` steps of each window
    rates: Array  # affine part of the rates in each step of the windows, (n_steps, n_own)
    offsets: Array  # affine part of the outputs at each sample of the windows, (n_samples, n_y)
    stride: int  # steps of each point
    # point of each step, (n_steps,), and of each sample, (n_samples,)
    steps: Indices
    points: Indices
    # states (n_points, n_x) and inputs (n_points, n_u) at the points, and the plant's rates and outputs there
    at: tuple[Array, Array]
    own: Array
    shown: Array


def motion_model(course: Course, factors: Mapping[str, float], starts: Indices, length: int, sub: int) -> MotionModel:
    """Linearise about windows of ``length`` samples from the samples ``starts``, in ``sub`` steps per sample."""
    plant, values = course.plant, _values(course.plant, factors)
    steps, stride = length * sub, course.stride * sub
    points = -(-steps // stride)
    middle = np.minimum((np.arange(points) + 0.5) * stride, 0.5 * (steps + np.arange(points) * stride)) / sub
    at = course.at((starts[:, None] + middle).ravel())
    local = plant.local_models(*at, values)
    own = (np.arange(len(starts))[:, None] * points + np.arange(steps) // stride).ravel()
    x, u = course.at((starts[:, None] + (np.arange(steps) + 0.5) / sub).ravel())
    rates = plant.rates_along(x, u, values) - times(local.A[own], x) - times(local.B[own], u)
    seen = (np.arange(len(starts))[:, None] * points + np.arange(length) * sub // stride).ravel()
    samples = (starts[:, None] + np.arange(length)).ravel()
    x, u = course.x[samples], course.u[samples]
    offsets = plant.outputs_along(x, u, values) - times(local.C[seen], x) - times(local.D[seen], u)
    model = local_port_model(plant, local, values)
    return MotionModel(model, rates, offsets, stride, own, seen, at, local.rates, local.outputs)


def with_factors(about: MotionModel, course: Course, factors: Mapping[str, float]) -> MotionModel:
    """Return the same matrices with the rates and outputs of other parameter values along the motion."""
    values = _values(course.plant, factors)
    rates = course.plant.rates_along(*about.at, values) - about.own
    outputs = course.plant.outputs_along(*about.at, values) - about.shown
    return replace(about, rates=about.rates + rates[about.steps], offsets=about.offsets + outputs[about.points])


def _values(plant: NonlinearPlant, factors: Mapping[str, float]) -> dict[str, float]:
    return plant.values | {name: plant.parameters[name].reference * factor for name, factor in factors.items()}


def times(matrices: Array, vectors: Array) -> Array:
    return (matrices @ vectors[..., None])[..., 0]


def local_port_model(plant: NonlinearPlant, local: LocalModels, values: Mapping[str, float] | None = None) -> PortModel:
    """Return models with an axis of points, and the plant's ports; ``values``: those of ``local``."""
    n = len(plant.states)
    home = _at_home(plant, tuple((plant.values if values is None else values).items()))
    names = [s.name for s in plant.states]
    ports = {}
    for j, place in enumerate(plant.port_places):
        k = names.index(place.name)
        q = names.index(place.position) if place.position else None
        position = None if q is None else np.eye(n)[q]
        unit = "" if q is None else plant.states[q].unit
        ports[place.name] = Port(
            place.name, place.kind, place.unit, plant.states[k].unit, unit, local.push[:, :, j], np.eye(n)[k], position,
            *home.get(place.name, (0.0, 0.0)),
        )  # fmt: skip
    wide = np.concatenate([local.B, np.broadcast_to(np.eye(n), local.A.shape)], axis=2)
    return PortModel(local.A, wide, local.C, local.D, ports, n)


@lru_cache(maxsize=256)
def _at_home(plant: NonlinearPlant, values: tuple[tuple[str, float], ...]) -> dict[str, tuple[float, float]]:
    """Return inertia at the plant's start and viscous friction of each joint."""
    given, x, u = dict(values), plant.start[None], np.zeros((1, len(plant.inputs)))
    viscous = [n for n, p in plant.parameters.items() if p.role == "viscous-friction" and given[n]]
    try:
        here = plant.local_models(x, u, given)
        without = plant.local_models(x, u, given | dict.fromkeys(viscous, 0.0)) if viscous else here
    except RobustlabError:
        return {}
    names = [s.name for s in plant.states]
    joints = [(j, names.index(p.name)) for j, p in enumerate(plant.port_places) if p.kind == "joint"]
    rows = [k for _, k in joints]
    push, change = here.push[0][np.ix_(rows, [j for j, _ in joints])], (here.A - without.A)[0][np.ix_(rows, rows)]
    if not joints or not np.isfinite(push).all() or np.linalg.matrix_rank(push) < len(push):
        return {}
    drag = -np.diag(np.linalg.solve(push, change))
    return {names[k]: (float(1.0 / push[i, i]), float(drag[i])) for i, (_, k) in enumerate(joints)}


def exponentials(a: Array, h: float) -> tuple[Array, Array, Array]:
    r"""Return `robustlab.dynamics.extended.simulator.exponential` of matrices (m, n, n)."""
    # Hochbruck, Ostermann, "Exponential integrators", Acta Numerica 19 (2010).
    size = float(np.abs(a).sum(axis=-1).max(initial=0.0)) * h
    doublings = max(0, int(np.ceil(np.log2(size / SMALL)))) if size > 0.0 else 0
    z, one = a * (h / 2.0**doublings), np.eye(a.shape[-1])
    second = np.broadcast_to(one / math.factorial(TERMS + 2), z.shape)
    for j in range(TERMS - 1, -1, -1):  # sum of z^j / (j + 2)! by Horner's rule
        second = one / math.factorial(j + 2) + z @ second
    first = one + z @ second
    zeroth = one + z @ first
    for _ in range(doublings):
        second = 0.25 * (first @ first + 2.0 * second)
        first = 0.5 * (zeroth @ first + first)
        zeroth = zeroth @ zeroth
    return zeroth, h * first, h * (2.0 * second - first)


# --- a joint split into drive and load --------------------------------------------------------------------------------
# For a nonlinear plant, all forces except the drive's own act on the load. With M the mass matrix, b = M^-1 e_j,
# J = 1/(e_j^T b), the drive's part (1 - s) J, a the accelerations of the whole plant in the load's position, D the
# drive's own force and F the force of the load on the drive:
# (1 - s) J v1' = D(v1) + F, v_load' = a + (1 - s)/s J b a_j - b/s (D(v2) + F) (Sherman, Morrison).


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
    n = len(port.velocity)
    # the equations with (1 - s) J at the joint
    change = np.eye(n) + share / (1.0 - share) * ((port.inertia * port.force)[:, None] * port.velocity)
    lighter = {name: replace(p, force=(change @ p.force[:, None])[:, 0]) for name, p in model.ports.items()}
    split = replace(model, A=change @ model.A, B=change @ model.B, ports=lighter)
    rows = np.zeros((2, n + 2))
    rows[0, n + 1] = 1.0
    wide = split.widened(rows)
    a, b = wide.A.copy(), wide.B.copy()
    a[n + 1, :n] = port.velocity @ split.A  # free load: the relative acceleration is the drive's
    b[n + 1] = port.velocity @ split.B
    rates = {name: p.force @ port.velocity for name, p in lighter.items()}
    ports = {name: replace(p, force=np.append(p.force[:-1], rates[name])) for name, p in wide.ports.items()}
    drive = ports[joint]
    load = _load(drive, -1.0 / (share * port.inertia) * np.eye(n + 2)[-1])
    gap = _relative_port(drive, load, f"{joint}.{relative}", share * (1.0 - share) * port.inertia)
    return replace(wide, A=a, B=b, ports={**ports, load.name: load, gap.name: gap})


def _relative_port(drive: Port, load: Port, name: str, reduced: Array) -> Port:
    """Return the port of the relative motion, with forces per reduced inertia."""
    (delta, rate), unit = np.eye(len(drive.velocity))[-2:], drive.speed_unit.removesuffix("/s")
    return replace(
        drive, name=name, kind="relative", unit=f"{unit}/s2", position_unit=unit,
        force=reduced * (drive.force - load.force), velocity=rate, position=delta,
    )  # fmt: skip
