"""Small records of an event-driven integrator, and the result of `discover` with few effects."""

from functools import cache

import numpy as np
from oracle.stick_slip import stick_slip

import robustlab as rl
from robustlab.identification import (
    Discovery,
    Problem,
    candidates,
    catalogue,
    nuisance_parameters,
    ports_of,
    prepare,
    stated_tolerances,
)

AXIS = rl.plant("servo-axis")
GAIN = AXIS.values["gain"]
DT = 2e-3
T = np.arange(1000) * DT
U = 1.5 * np.sin(2 * np.pi * 1.3 * T) + np.repeat(np.random.default_rng(1).choice([-1.0, 1.0], 20), 50)
USUAL = ("coulomb-friction", "constant-load", "sensor-gain", "inertia")


def all_but(*names: str) -> tuple[str, ...]:
    """Ids of all other effects, to be excluded."""
    return tuple(sorted(set(catalogue()) - set(names)))


def noisy(outputs, seed, size=1e-3):
    """With white noise of a thousandth of the range."""
    rng = np.random.default_rng(seed)
    return {k: y + size * np.ptp(y) * rng.normal(size=len(y)) for k, y in outputs.items()}


@cache
def machine(friction=0.0, load=0.0, seed=0, seen=("q", "v"), sign=1.0, mass=1.0, size=1e-3) -> rl.Record:
    """The axis with dry friction, a load in N (an offset of its input), or another mass."""
    u = sign * U - load / GAIN
    axis = AXIS.with_parameters(M=mass * AXIS.values["M"])
    run = stick_slip(axis, "v", friction, T, u).record if friction else rl.simulate(axis, T, u)
    return rl.Record(T, {"u": sign * U}, noisy({k: run[k] for k in seen}, seed, size), name=f"run {seed}")


@cache
def discovered(record, tried=USUAL, plant=AXIS, **options) -> Discovery:
    """Return the result of `discover` with these effects."""
    return rl.discover(plant, record, exclude=all_but(*tried), **options)


def problem_of(record, plant=AXIS, length=100, tolerances=None):
    """Its windows, and the effects that may be tried, by key."""
    model = ports_of(plant, record)
    ready = prepare(plant, model, record, length)
    problem = Problem(plant, [ready], nuisance_parameters(plant, stated_tolerances(plant, tolerances)))
    return problem, {c.key: c for c in candidates(plant, model, [ready])}
