r"""Dry friction in linear plants: Coulomb and static, with exact sticking.

In the force equation of a named velocity state v there stands a force :math:`\lambda` with, for :math:`r = v -
v_\mathrm{surface}`,

.. math::
    \lambda = -F_c \operatorname{sgn} r \quad (r \ne 0), \qquad |\lambda| \le F_s \quad (r = 0).

While no joint changes between sticking and sliding the plant is linear with known inputs, so that matrix exponentials
carry it without error. A joint that sticks keeps its velocity as a constraint, and its force is the one that holds it:

.. math:: \lambda_S = -(V_S W_S)^{-1} V_S (A x + B u + W_F \lambda_F)

with V the rows that read the velocities and W the columns through which the forces act. Changes are found by halving
the time step down to the last bits of the clock; there a sliding joint whose velocity has come to zero is set to
exactly zero, and the combination of sticking and sliding joints that satisfies the law above is taken, the one with
the most sticking joints where there are several (as long as a static force suffices, nothing moves). Nothing is
smoothed, so there is no chatter, and the friction force never does positive work against its own surface.

References
----------
Filippov, *Differential Equations with Discontinuous Righthand Sides* (1988); Acary, Brogliato, *Numerical Methods for
Nonsmooth Dynamical Systems* (2008), chapter 7 (event-driven schemes).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robustlab.arrays import Array
from robustlab.dynamics.linear_plant import LinearPlant
from robustlab.dynamics.simulation import Hold, recorded, sampled_inputs
from robustlab.dynamics.tuning import TUNING, DynamicsTuning
from robustlab.errors import InputError, NoTrustworthyNumber, unknown_name
from robustlab.record import Record
from robustlab.result import Status
from robustlab.statespace import StateSpaceModel, as_model, real_array


@dataclass(frozen=True)
class DryFriction:
    """Dry friction on one velocity.

    Raises InputError: NaN, a negative force, a static force below the sliding one, an inertia that is not positive.
    """

    velocity: str  # name of the velocity state in whose force equation it acts
    coulomb: float  # force or torque F_c while sliding, in the unit of that equation
    static: float | None = None  # largest holding force F_s; equal to `coulomb` where left out
    surface: float = 0.0  # velocity of the surface on which the joint slides (a belt); 0: the ground
    # Mass or inertia of the joint, for a model that is no `LinearPlant`: there the force is divided by it.
    inertia: float | None = None

    def __post_init__(self) -> None:
        where = f"dry friction on {self.velocity!r}"
        for name in ("coulomb", "static", "surface", "inertia"):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, float(real_array(name, getattr(self, name), 0, where)))
        if self.coulomb < 0:
            raise InputError(where, f"coulomb = {self.coulomb:g}", "no negative force")
        if self.holding < self.coulomb:
            raise InputError(where, f"static = {self.holding:g} below coulomb = {self.coulomb:g}", "static >= coulomb")
        if self.inertia is not None and not self.inertia > 0:
            raise InputError(where, f"inertia = {self.inertia:g}", "a positive number")

    @property
    def holding(self) -> float:
        """F_s."""
        return self.coulomb if self.static is None else self.static


class FrictionEvent(NamedTuple):
    """At ``time`` the joint on ``velocity`` began to slide forwards (1), backwards (-1), or to stick (0)."""

    time: float
    velocity: str
    becomes: int


@dataclass(frozen=True, eq=False)
class StickSlip:
    """Response of a plant with dry friction."""

    record: Record  # inputs and outputs
    x: Array  # states, (n, n_x)
    force: Array  # friction force of each joint, (n, n_joints); while sticking, the one that holds it
    sliding: NDArray[np.int8]  # 1, -1 or 0 (sticking) for each joint, (n, n_joints)
    events: tuple[FrictionEvent, ...]  # every change between sticking and sliding, in order
    status: Status = Status.CONVERGED  # CONVERGED: every change was located to the clock's last bits

    def __post_init__(self) -> None:
        for array in (self.x, self.force, self.sliding):
            array.setflags(write=False)

    def to_json(self) -> dict[str, Any]:
        """All attributes."""
        return {**vars(self), "events": [event._asdict() for event in self.events]}


def simulate_with_friction(
    plant: LinearPlant | StateSpaceModel | Any,
    friction: DryFriction | Sequence[DryFriction],
    t: ArrayLike,
    u: Mapping[str, ArrayLike] | ArrayLike,
    x0: ArrayLike | None = None,
    *,
    hold: Hold = "zoh",
    name: str | None = None,
    tuning: DynamicsTuning = TUNING,
) -> StickSlip:
    """Response of a linear plant with dry friction on some of its velocities, exact at the samples.

    ``plant``: a linear plant: the force enters the equation of the named velocity, divided by its inertia through E. Or
    a continuous model whose state is the velocity; then every `DryFriction` needs an inertia.
    ``friction``: one for each joint that has any.
    ``t``, ``u``, ``x0``, ``hold``, ``name``: as in `robustlab.dynamics.simulate`; ``hold`` is "zoh" or "foh".
    ``tuning``: how finely changes are located.
    Raises InputError: a name that is no state, two frictions on one velocity, a discrete model, samples so coarse that
    the plant's fastest mode passes thousands of time constants between two; NoTrustworthyNumber: the response outgrows
    double precision.

    Examples
    --------
    >>> from robustlab.dynamics import plant
    >>> axis = plant("mass-spring-damper", m=2.0, c=0.0, k=0.0)
    >>> slide = simulate_with_friction(axis, DryFriction("v", 4.0), [0, 1, 2], [0, 0, 0], x0=[0, 3.0])
    >>> slide.record["q"].round(12).tolist(), round(slide.events[-1].time, 12)  # v0^2 m / (2 Fc), v0 m / Fc
    ([0.0, 2.0, 2.25], 1.5)
    """
    joints = (friction,) if isinstance(friction, DryFriction) else tuple(friction)
    model = as_model(plant, "simulate_with_friction")
    if model.is_discrete:
        raise InputError("simulate_with_friction", f"a discrete model (dt = {model.dt:g} s)", "a continuous one")
    if hold not in ("zoh", "foh"):
        raise InputError("simulate_with_friction: hold", f"{hold!r}", "'zoh' or 'foh'")
    title = name or getattr(plant, "name", None) or "stick-slip"
    clock = Record(t, name="simulate_with_friction").t
    samples = sampled_inputs(model.inputs, u, len(clock))
    start = np.zeros(model.n_states) if x0 is None else real_array("x0", x0, 1, "simulate_with_friction")
    if len(start) != model.n_states:
        raise InputError("simulate_with_friction", f"x0 has {len(start)} entries", f"{model.n_states}")
    places, columns = _places(plant, model, joints)
    motion = _Motion(model, joints, (places, columns), tuning)
    with np.errstate(over="ignore", invalid="ignore"):
        x, force, sliding = motion.run(clock, samples, start, hold)
    y = x @ model.C.T + samples @ model.D.T
    return StickSlip(recorded(model, clock, samples, y, title), x, force, sliding, tuple(motion.events))


def _places(plant: Any, model: StateSpaceModel, joints: tuple[DryFriction, ...]) -> tuple[list[int], Array]:
    """Indices of the velocity states, and the columns (n_x, n_joints) by which unit forces enter x'."""
    names = list(model.state_names)
    for joint in joints:
        if joint.velocity not in names:
            raise unknown_name(f"dry friction on {joint.velocity!r}", "no such state", joint.velocity, names)
    places = [names.index(joint.velocity) for joint in joints]
    if len(set(places)) != len(places):
        raise InputError("dry friction", "two on one velocity", "one for each velocity, with the sum of the forces")
    unit = np.eye(len(names))[:, places]
    if isinstance(plant, LinearPlant):
        mass = np.asarray(plant.equations(plant.values).E, dtype=np.float64)
        columns = np.asarray(np.linalg.solve(mass, unit), dtype=np.float64)
    else:
        missing = [joint.velocity for joint in joints if joint.inertia is None]
        if missing:
            raise InputError(
                f"dry friction on {missing[0]!r}", "no inertia", "an inertia, as the plant is a bare model"
            )
        columns = unit / np.array([joint.inertia for joint in joints])
    inertia = columns[places]
    if places and not np.linalg.eigvalsh((inertia + inertia.T) / 2).min() > 0:
        raise InputError("dry friction", "a force that does not push its velocity", "velocities of bodies with inertia")
    return places, columns


class _Mode:
    """The plant with every joint's state settled: 1 or -1 sliding, 0 sticking.

    z = (x, u, du/dt, 1) follows z' = M z; ``force`` reads the friction forces; ``guard`` reads, joint by joint,
    what must stay >= 0: the sliding velocity, or (two rows) what is left of the holding force on either side.
    """

    def __init__(self, motion: _Motion, sliding: tuple[int, ...]) -> None:
        size, n, n_u = motion.size, motion.n, motion.n_u
        free = np.zeros((size, size))
        free[:n, :n], free[:n, n : n + n_u] = motion.a, motion.b
        free[n : n + n_u, n + n_u : n + 2 * n_u] = np.eye(n_u)
        slide = np.array(sliding, dtype=np.float64)
        force = np.zeros((len(sliding), size))
        force[:, -1] = -slide * motion.coulomb
        stuck = [j for j, s in enumerate(sliding) if s == 0]
        if stuck:
            rows = [motion.places[j] for j in stuck]
            moved = free[rows] + motion.columns[rows] @ force
            force[stuck] = -np.linalg.solve(motion.columns[np.ix_(rows, stuck)], moved)
        self.matrix = free
        self.matrix[:n] += motion.columns @ force
        for j in stuck:
            self.matrix[motion.places[j]] = 0.0
        self.sliding, self.force, self.stuck, self.tuning = sliding, force, stuck, motion.tuning
        guards = []
        for j, s in enumerate(sliding):
            row = np.zeros(size)
            if s:
                row[motion.places[j]], row[-1] = s, -s * motion.surface[j]
                guards.append(row)
            else:
                row[-1] = motion.holding[j] * (1 + motion.tuning.hold_rounding)
                guards += [row - force[j], row + force[j]]
        guard = np.array(guards).reshape(-1, size)
        self.guard = np.vstack([guard, guard @ self.matrix])
        self.count = len(guards)
        self.steps: dict[tuple[float, int], Array] = {}
        self.outlooks: dict[float, Array] = {}

    def step(self, h: float, halvings: int) -> Array:
        """exp(M h / 2^halvings)."""
        key = (h, halvings)
        if key not in self.steps:
            self.steps[key] = _exponential(self.matrix * (h / 2.0**halvings), self.tuning)
        return self.steps[key]

    def changes_within(self, z: Array, h: float, halvings: int) -> bool:
        """Whether a guard fails, or may fail, in any of the 2^halvings pieces of h."""
        if h not in self.outlooks:
            piece, rows = self.step(h, halvings), [self.guard]
            for _ in range(2**halvings):
                rows.append(rows[-1] @ piece)
            self.outlooks[h] = np.vstack(rows)
        values = (self.outlooks[h] @ z).reshape(2**halvings + 1, 2 * self.count)
        fails = (values[1:, : self.count] < 0).any()
        return bool(fails or _dips(values[:-1], values[1:], self.count, h / 2.0**halvings).any())


class _Motion:
    """The motion of one plant with friction, piece by piece."""

    def __init__(
        self, model: StateSpaceModel, joints: Sequence[DryFriction], at: tuple[list[int], Array], tuning: DynamicsTuning
    ) -> None:
        self.a, self.b, (self.places, self.columns), self.tuning = model.A, model.B, at, tuning
        self.n, self.n_u = model.n_states, model.n_inputs
        self.size = self.n + 2 * self.n_u + 1
        self.names = [joint.velocity for joint in joints]
        self.coulomb = np.array([joint.coulomb for joint in joints])
        self.holding = np.array([joint.holding for joint in joints])
        self.surface = np.array([joint.surface for joint in joints])
        self.modes: dict[tuple[int, ...], _Mode] = {}
        self.events: list[FrictionEvent] = []
        self.fastest = float(np.abs(np.linalg.eigvals(model.A)).max(initial=0.0))
        self.time, self.changes = 0.0, 0

    def mode(self, sliding: tuple[int, ...]) -> _Mode:
        if sliding not in self.modes:
            self.modes[sliding] = _Mode(self, sliding)
        return self.modes[sliding]

    def run(self, t: Array, u: Array, x0: Array, hold: Hold) -> tuple[Array, Array, NDArray[np.int8]]:
        """States, friction forces and sliding directions at the samples."""
        n, m = self.n, self.n_u
        lengths = _equal_lengths(t, self.tuning.clock_rounding)
        z = np.concatenate([x0, u[0], np.zeros(m), [1.0]])
        x, force = np.empty((len(t), n)), np.empty((len(t), len(self.names)))
        sliding = np.empty((len(t), len(self.names)), dtype=np.int8)
        mode = self.settled(z, tuple(int(s) for s in np.sign(x0[self.places] - self.surface)))
        for k in range(len(t)):
            z[n : n + m] = u[k]
            if hold == "foh" and k + 1 < len(t):
                z[n + m : -1] = (u[k + 1] - u[k]) / (t[k + 1] - t[k])
            self.time, self.changes = float(t[k]), 0
            if mode.stuck and (mode.guard[: mode.count] @ z < 0).any():
                mode = self.changed(mode, self.settled(z, mode.sliding))
            x[k], force[k], sliding[k] = z[:n], mode.force @ z, mode.sliding
            if not np.isfinite(z).all():
                raise NoTrustworthyNumber("dry friction", f"the response outgrows double precision at t = {t[k]:.9g} s")
            if k + 1 < len(t):
                h = float(lengths[k])
                pieces = self.pieces(h)
                if not mode.changes_within(z, h, pieces):
                    z = self.held(mode, mode.step(h, 0) @ z)
                    continue
                for j in range(2**pieces):
                    self.time = float(t[k]) + j * h / 2**pieces
                    z, mode = self.advance(z, mode, h, pieces)
        return x, force, sliding

    def pieces(self, h: float) -> int:
        """Halvings of h in whose pieces no velocity turns twice."""
        turn = self.fastest * h / self.tuning.piece
        if turn > self.tuning.most_pieces:
            found = f"steps of {h:g} s for a mode of {self.fastest:g} /s"
            raise InputError("simulate_with_friction", found, "finer samples, or a plant without that mode")
        return math.ceil(math.log2(turn)) if turn > 1 else 0

    def advance(self, z: Array, mode: _Mode, h: float, halvings: int) -> tuple[Array, _Mode]:
        """State and mode after h / 2^halvings; the piece is halved where a guard fails or may fail in it."""
        end = self.held(mode, mode.step(h, halvings) @ z)
        before, after, count = mode.guard @ z, mode.guard @ end, mode.count
        fails = (after[:count] < 0).any()
        if not fails and not _dips(before, after, count, h / 2.0**halvings).any():
            return end, mode
        if halvings < self.tuning.halvings:
            start = self.time
            z, mode = self.advance(z, mode, h, halvings + 1)
            self.time = start + h / 2.0 ** (halvings + 1)
            return self.advance(z, mode, h, halvings + 1)
        if not fails:
            return end, mode
        self.time += h / 2.0**self.tuning.halvings
        return end, self.changed(mode, self.settled(end, self._stopped(end, mode)))

    def held(self, mode: _Mode, z: Array) -> Array:
        """The state z with its sticking joints exactly at their surfaces' velocities."""
        for j in mode.stuck:
            z[self.places[j]] = self.surface[j]
        return z

    def _stopped(self, z: Array, mode: _Mode) -> tuple[int, ...]:
        """Puts sliding joints that have reached their surface's velocity exactly on it; returns who still slides."""
        sliding = list(mode.sliding)
        for j, s in enumerate(sliding):
            if s and s * (z[self.places[j]] - self.surface[j]) <= 0:
                z[self.places[j]], sliding[j] = self.surface[j], 0
        return tuple(sliding)

    def settled(self, z: Array, sliding: tuple[int, ...]) -> _Mode:
        """The consistent mode at z with the most sticking joints; ``sliding`` is 0 for each joint that may stick."""
        still = [j for j, s in enumerate(sliding) if s == 0]
        for choice in sorted(itertools.product((0, 1, -1), repeat=len(still)), key=np.count_nonzero):
            trial = list(sliding)
            for j, s in zip(still, choice, strict=True):
                trial[j] = s
            mode = self.mode(tuple(trial))
            rates = mode.matrix @ z
            starts = all(s * rates[self.places[j]] > 0 for j, s in zip(still, choice, strict=True) if s)
            if starts and (mode.guard[: mode.count] @ z >= 0).all():
                return mode
        raise NoTrustworthyNumber("dry friction", f"no consistent forces at t = {self.time:.9g} s")

    def changed(self, before: _Mode, after: _Mode) -> _Mode:
        """The new mode, with what changed written down."""
        for name, old, new in zip(self.names, before.sliding, after.sliding, strict=True):
            if old != new:
                self.events.append(FrictionEvent(self.time, name, new))
        self.changes += 1
        if self.changes > self.tuning.most_changes:
            raise NoTrustworthyNumber(
                "dry friction", f"more than {self.tuning.most_changes} changes in the step to {self.time:.9g} s"
            )
        return after


def _exponential(x: Array, tuning: DynamicsTuning) -> Array:
    """exp(x); of a small x, as most are, by the few terms of its series that count."""
    if np.abs(x).sum(axis=1).max() > tuning.small:
        from scipy.linalg import expm

        return np.asarray(expm(x), dtype=np.float64)
    total = one = np.eye(len(x))
    for order in range(tuning.series, 0, -1):
        total = one + x @ total / order
    return total


def _equal_lengths(t: Array, rounding: float) -> Array:
    """Steps of the clock, with those that differ by its rounding made equal."""
    step = np.diff(t)
    _, kind = np.unique(np.round(step / (rounding * step.mean())), return_inverse=True)
    return (np.bincount(kind, weights=step) / np.bincount(kind))[kind]


def _dips(before: Array, after: Array, count: int, h: float) -> NDArray[np.bool_]:
    """Which guards, positive at both ends, fall first and rise again, with tangents that cross below zero."""
    g0, g1, slope0, slope1 = before[..., :count], after[..., :count], before[..., count:], after[..., count:]
    falls = (slope0 < 0) & (slope1 > 0)
    if not falls.any():
        return falls
    with np.errstate(divide="ignore", invalid="ignore"):
        meeting = (g1 - g0 - slope1 * h) / (slope0 - slope1)
        lowest = g0 + slope0 * np.clip(meeting, 0.0, h)
    return falls & (lowest < 0)
