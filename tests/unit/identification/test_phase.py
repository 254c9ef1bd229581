"""Phases of a ripple over time in records that begin at other times, against scipy's solution of the equations."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import robustlab as rl
from robustlab.dynamics.effects.catalogue import effect
from robustlab.dynamics.effects.contract import Scales, Site
from robustlab.dynamics.ports.port_model import port_model
from robustlab.identification.hypotheses.effect_fit import Candidate, Fit, Hypothesis, Problem
from robustlab.identification.hypotheses.noise import held_out_fit, in_phase
from robustlab.identification.hypotheses.normal_equations import NoiseModel
from robustlab.identification.hypotheses.prepared_record import prepare

AXIS = rl.plant("servo-axis")
N, DT, LATER = 600, 2e-3, 0.093
WAVE = {"Ac": 12.0, "As": -9.0, "f": 7.0}
T = np.arange(N) * DT
U = np.repeat(np.random.default_rng(1).choice([-1.0, 1.0], 12), 50)


def measured(later):
    """The axis under a held input and a ripple that had run for so long when the record began."""
    p = AXIS.values

    def rate(t, x, u):
        turn = 2 * np.pi * WAVE["f"] * (t + later)
        force = WAVE["Ac"] * np.cos(turn) + WAVE["As"] * np.sin(turn)
        return [x[1], (p["gain"] * u - p["Fv"] * x[1] + force) / p["M"]]

    x = np.zeros((N, 2))
    for k in range(N - 1):
        x[k + 1] = solve_ivp(rate, (T[k], T[k + 1]), x[k], args=(U[k],), rtol=1e-8, atol=1e-12).y[:, -1]
    noise = np.random.default_rng(3).normal(size=(N, 2)) * [1e-5, 1e-4]
    q, v = (x + noise).T
    return rl.Record(T, {"u": U}, {"q": q, "v": v}, {"u": "V", "q": "m", "v": "m/s"}, f"{later}")


@cache
def parts():
    ripple = effect("torque-ripple")
    scales = Scales(force=50.0, lines=(7.1,), dt=DT, duration=N * DT)
    c = Candidate(ripple, Site("joint", "v"), ripple.parameters(scales), ripple.starts(scales), scales)
    records = [prepare(AXIS, port_model(AXIS), measured(later), 60) for later in (0.0, LATER)]
    noise = NoiseModel(np.array([1e-5, 1e-4]) / np.sqrt(records[0].thin), np.zeros((1, 2)))
    problem = Problem(AXIS, records, ())
    return problem, Fit(Hypothesis((c,)), c.standardised(WAVE), (), 0.0, np.zeros(0), np.eye(0), noise, 0)


def test_parameters_of_a_record_that_begins_later_make_the_same_ripple():
    def force(values, t):
        turn = 2 * np.pi * values["f"] * t
        return values["Ac"] * np.cos(turn) + values["As"] * np.sin(turn)

    t = np.linspace(0.0, 1.0, 50)
    for later in (0.0, 0.02, LATER, 3.0):
        there = effect("torque-ripple").begun(WAVE, later)
        assert force(there, t) == pytest.approx(force(WAVE, t + later), abs=1e-10)


def test_a_record_is_put_where_its_ripple_began():
    problem, fit = parts()
    known = problem.records[:1]
    before = held_out_fit(problem.on(problem.records[1:]), fit, fit.noise).cost
    put, price = in_phase(problem, fit, known)
    assert put.records[0] is problem.records[0]
    assert put.records[1].begun == pytest.approx(LATER % (1.0 / WAVE["f"]), abs=1e-3)
    assert price == pytest.approx(np.log(16.0))
    after = held_out_fit(put.on(put.records[1:]), fit, fit.noise).cost
    points = sum(
        np.isfinite(e).sum() for e in put.on(put.records[1:]).errors(fit.hypothesis, fit.z, [np.zeros((10, 2))])
    )
    assert after < 1.3 * points
    assert before > 5.0 * after
