"""Linear models of a nonlinear plant about a recorded motion."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np

from robustlab.arrays import Array, Indices
from robustlab.dynamics.plant_contract import LocalModels, NonlinearPlant
from robustlab.dynamics.ports.port_model import Port, PortModel
from robustlab.errors import RobustlabError

TERMS = 9  # of the exponential's series below half a unit of the matrix's norm: rounding
SMALL = 0.5
SHARE = 1e-3  # allowed relative change of a force's effect over half a stride
STRIDES = (16, 8, 4, 2)  # steps with common matrices


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
    def _spline(self) -> tuple[Array, Array]:
        """Slopes per sample of a not-a-knot spline at the samples."""
        from scipy.interpolate import make_interp_spline

        n = np.arange(len(self.x))
        spline = make_interp_spline(n, self.x, k=min(3, len(self.x) - 1))
        return self.x, np.asarray(spline(n, nu=1))

    def at(self, place: Array) -> tuple[Array, Array]:
        """Return states (k, n_x) and inputs (k, n_u) at fractional sample numbers."""
        k = np.clip(place.astype(int), 0, len(self.x) - 2)
        s = (place - k)[:, None]
        x, slope = self._spline
        a, b, da, db = x[k], x[k + 1], slope[k], slope[k + 1]
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
    """Return the products (..., p) of matrices (..., p, q) and vectors (..., q)."""
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
