"""Small records of an event-driven integrator, and searches over sets of effects on them."""

from __future__ import annotations

from contextlib import ExitStack
from functools import cache
from unittest.mock import patch

import numpy as np
from oracle.stick_slip import stick_slip

import robustlab as rl
from robustlab.dynamics import port_model
from robustlab.identification.hypotheses.candidates import candidates, nuisance_parameters, stated_tolerances
from robustlab.identification.hypotheses.effect_fit import Problem
from robustlab.identification.hypotheses.prepared_record import prepare
from robustlab.identification.naming import set_search
from robustlab.identification.naming.discovery import admissible

AXIS = rl.plant("servo-axis")
GAIN = AXIS.values["gain"]
DT = 2e-3
T = np.arange(1000) * DT
U = 1.5 * np.sin(2 * np.pi * 1.3 * T) + np.repeat(np.random.default_rng(1).choice([-1.0, 1.0], 20), 50)
TOLERANCES = (("M", 0.05), ("Fv", 1.0))
FRICTION, LOAD, GAIN_OF_Q = "coulomb-friction @ v", "constant-load @ v", "sensor-gain @ q"
POOL = (FRICTION, LOAD, "viscous-friction @ Fv", "input-delay @ u", GAIN_OF_Q)


def noisy(outputs, seed, size=1e-3):
    """With white noise of a thousandth of the range."""
    rng = np.random.default_rng(seed)
    return {k: y + size * np.ptp(y) * rng.normal(size=len(y)) for k, y in outputs.items()}


@cache
def machine(friction=0.0, load=0.0, seed=0, seen=("q", "v")) -> rl.Record:
    """The axis with dry friction, and a load in N, which is an offset of its input."""
    u = U - load / GAIN
    run = stick_slip(AXIS, "v", friction, T, u).record if friction else rl.simulate(AXIS, T, u)
    return rl.Record(T, {"u": U}, noisy({k: run[k] for k in seen}, seed), name="run")


@cache
def opened(record: rl.Record, tolerances=TOLERANCES):
    """Windows to fit, windows held out, candidates by key, and what may be an answer."""
    model = port_model(AXIS)
    ready = prepare(AXIS, model, record, 100)
    stated = stated_tolerances(AXIS, dict(tolerances))
    problem = Problem(AXIS, [ready], nuisance_parameters(AXIS, stated))
    windows = np.arange(ready.count)
    fit = problem.on([ready], [windows[windows % 5 != 2]])
    held = problem.on([ready], [windows[windows % 5 == 2]])
    return fit, held, {c.key: c for c in candidates(AXIS, model, [ready])}, admissible(AXIS, stated, fit, held)


def quiet(*_: object) -> None:
    """No word of progress."""


def searched(record: rl.Record, keys=POOL, progress=quiet, **changed) -> set_search.Found:
    """The search over these effects, with some numbers of its tuning changed."""
    fit, held, pool, allowed = opened(record)
    fit.work.clear()
    with ExitStack() as kept:
        for name, value in changed.items():
            kept.enter_context(patch.object(set_search, name.upper(), value))
        return set_search.search_sets(fit, held, [pool[k] for k in keys], allowed, progress)


@cache
def usual(friction: float = 0.0, load: float = 0.0, seed: int = 3) -> set_search.Found:
    """The search over the usual pool for what a machine lacks; not to be changed."""
    return searched(machine(friction, load, seed))


def values(found: set_search.Found, key: str) -> dict[str, float]:
    """Parameters of an effect of the best set."""
    fit = found.best.fit
    _, each = found.problem.split(fit.hypothesis, fit.z)
    return next(v for c, v in zip(fit.hypothesis.candidates, each, strict=True) if c.key == key)
