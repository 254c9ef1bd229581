"""Fit of one hypothesis: against dense least squares, closed-form evidence, and records of another integrator."""

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from oracle.stick_slip import stick_slip

import robustlab as rl
from robustlab.dynamics import port_model
from robustlab.identification.hypotheses.candidates import candidates, nuisance_parameters, stated_tolerances
from robustlab.identification.hypotheses.effect_fit import (
    Candidate,
    Fit,
    FitPlan,
    Hypothesis,
    Problem,
    _total,
)
from robustlab.identification.hypotheses.noise import first_noise
from robustlab.identification.hypotheses.normal_equations import NoiseModel
from robustlab.identification.hypotheses.prepared_record import prepare

AXIS = rl.plant("servo-axis")
T = np.arange(1000) * 2e-3
U = 1.5 * np.sin(2 * np.pi * 1.3 * T) + np.repeat(np.random.default_rng(1).choice([-1.0, 1.0], 20), 50)
NONE = Hypothesis(())


def problem_of(record, plant=AXIS, length=100, tolerances=None) -> tuple[Problem, dict[str, Candidate]]:
    model = port_model(plant)
    ready = prepare(plant, model, record, length)
    nuisances = nuisance_parameters(plant, stated_tolerances(plant, tolerances))
    return Problem(plant, [ready], nuisances), {c.key: c for c in candidates(plant, model, [ready])}


def cost(problem, hypothesis, noise, z, starts):
    """V at a point."""
    return _total(problem.whitened(problem.errors(hypothesis, z, starts), noise), starts) + float(z @ z)


def noisy(record, seed=0, share=1e-3):
    rng = np.random.default_rng(seed)
    outputs = {k: y + share * np.ptp(y) * rng.normal(size=len(y)) for k, y in record.outputs.items()}
    return rl.Record(record.t, record.inputs, outputs, record.units)


@cache
def exact() -> tuple[Problem, dict[str, Candidate]]:
    """A noisy record of the plant itself; its parameters are known without error."""
    return problem_of(noisy(rl.simulate(AXIS, T, U)), tolerances={"M": 0.0, "Fv": 0.0})


WHITE = NoiseModel(np.array([2e-4, 2e-3]), np.zeros((0, 2)))


# --- the normal equations --------------------------------------------------------------------------------------------


def dense_parts(problem: Problem, hypothesis: Hypothesis, noise: NoiseModel):
    """Residuals at z = 0 without a shift of the starts, and their exact slopes for a problem linear in both."""
    n_z, starts = problem.size(hypothesis), np.zeros((len(problem.chosen[0]), len(problem.plant.states)))

    def residual(z, xi):
        return problem.whitened(problem.errors(hypothesis, z, [xi]), noise)[0]

    zero = np.zeros(n_z)
    r = residual(zero, starts)
    j = np.stack([residual(e, starts) - r for e in np.eye(n_z)] or [np.zeros_like(r)], axis=2)[:, :, :n_z]
    x = np.stack([residual(zero, starts + e) - r for e in np.eye(starts.shape[1])], axis=2)
    return r, j, x


def linear_hypotheses() -> dict[str, Hypothesis]:
    """The records depend linearly on a constant load and on a bias of the speed sensor; their priors are normal."""
    load, bias = exact()[1]["constant-load @ v"], exact()[1]["sensor-bias @ v"]
    return {"none": NONE, "load": Hypothesis((load,)), "bias": Hypothesis((bias,)), "both": Hypothesis((load, bias))}


def fitted(hypothesis: Hypothesis, **options) -> Fit:
    problem = exact()[0]
    return problem.fit(hypothesis, WHITE, np.zeros(problem.size(hypothesis)), plan=FitPlan(tolerance=1e-9, **options))


@pytest.mark.parametrize("name", ["load", "bias", "both"])
def test_a_linear_problem_is_solved_as_by_dense_least_squares(name):
    hypothesis = linear_hypotheses()[name]
    r, j, x = dense_parts(exact()[0], hypothesis, WHITE)
    expected = marginal(r, j, x)
    fit = fitted(hypothesis)
    assert fit.z == pytest.approx(expected["z"], abs=1e-5)
    assert fit.cost == pytest.approx(expected["cost"], rel=1e-8)
    assert fit.hessian == pytest.approx(expected["hessian"], rel=1e-5)


def marginal(r, j, x) -> dict:
    """Posterior mean of z, V there, and log p(y), all with every window's start integrated out: S = 1 + X X^T."""
    n_z = j.shape[2]
    hessian, gradient, quadratic, logdet = np.eye(n_z), np.zeros(n_z), 0.0, 0.0
    for rw, jw, xw in zip(r, j, x, strict=True):
        s = np.eye(len(rw)) + xw @ xw.T
        hessian += jw.T @ np.linalg.solve(s, jw)
        gradient += jw.T @ np.linalg.solve(s, rw)
        quadratic += rw @ np.linalg.solve(s, rw)
        logdet += np.linalg.slogdet(s)[1]
    z = -np.linalg.solve(hessian, gradient)
    cost = quadratic + gradient @ z
    # Matrix determinant lemma: det(S + J J^T) = det S det H.
    return {
        "z": z, "cost": cost, "hessian": hessian,
        "evidence": -0.5 * cost - 0.5 * logdet - 0.5 * np.linalg.slogdet(hessian)[1],
    }  # fmt: skip


def test_the_evidence_is_the_marginal_likelihood_with_the_starts_integrated_out():
    # Up to -1/2 log det(1 + X^T X) of the starts, which is the same for hypotheses whose starts act alike.
    ours, theirs = {}, {}
    for name, hypothesis in linear_hypotheses().items():
        ours[name] = fitted(hypothesis).evidence
        theirs[name] = marginal(*dense_parts(exact()[0], hypothesis, WHITE))["evidence"]
    for name in ("load", "bias", "both"):
        assert ours[name] - ours["none"] == pytest.approx(theirs[name] - theirs["none"], abs=1e-4)
    assert len({round(v, 2) for v in theirs.values()}) == 4  # they differ at all


def test_the_robust_covariance_is_the_sandwich_over_windows():
    hypothesis = linear_hypotheses()["both"]
    r, j, x = dense_parts(exact()[0], hypothesis, WHITE)
    found = marginal(r, j, x)
    scores = [
        jw.T @ np.linalg.solve(np.eye(len(rw)) + xw @ xw.T, rw + jw @ found["z"])
        for rw, jw, xw in zip(r, j, x, strict=True)
    ]
    bread = np.linalg.inv(found["hessian"])
    sandwich = bread @ sum(np.outer(g, g) for g in scores) @ bread * len(scores) / (len(scores) - 1)
    fit = fitted(hypothesis, robust=True)
    assert fit.covariance == pytest.approx(sandwich, rel=1e-3)
    assert fit.std == pytest.approx(np.sqrt(np.maximum(np.diag(bread), np.diag(sandwich))), rel=1e-3)
    assert fitted(hypothesis).std == pytest.approx(np.sqrt(np.diag(bread)), rel=1e-4)


# --- errors ----------------------------------------------------------------------------------------------------------


def test_a_parameter_of_the_value_zero_is_found_within_its_absolute_tolerance():
    """Recorded with a viscosity of 30 N s/m, of which the model says 0 +- 50."""
    true = rl.simulate(rl.plant("servo-axis", Fv=30.0), T, U)
    problem, _ = problem_of(noisy(true), rl.plant("servo-axis", Fv=(0.0, 50.0)), tolerances={"M": 0.0})
    fit = problem.fit(NONE, WHITE, np.zeros(1))
    factors, _ = problem.split(fit.hypothesis, fit.z)
    assert factors["Fv"] == pytest.approx(30.0, rel=0.05)


@pytest.mark.parametrize("value", [np.inf, -np.inf, np.nan])
def test_a_simulation_that_diverges_is_no_missing_sample(monkeypatch, value):
    problem = exact()[0]
    starts = [np.zeros((problem.records[0].count, 2))]
    right = cost(problem, Hypothesis(()), WHITE, np.zeros(0), starts)
    simulated = Problem.outputs

    def diverging(self, k, *given):
        outputs = simulated(self, k, *given)
        outputs[:, outputs.shape[1] // 2 :] = value
        return outputs

    monkeypatch.setattr(Problem, "outputs", diverging)
    assert cost(problem, Hypothesis(()), WHITE, np.zeros(0), starts) > 1e12 > right


def test_missing_samples_carry_no_weight():
    problem = exact()[0]
    ready = problem.records[0]
    rows = slice(100, 200)  # the second window's speed
    gone = ready.y.copy()
    gone[rows, 1] = np.nan
    fit = problem.on([replace(ready, y=gone)]).fit(
        linear_hypotheses()["load"], WHITE, np.zeros(1), plan=FitPlan(tolerance=1e-9)
    )
    r, j, x = dense_parts(problem, linear_hypotheses()["load"], WHITE)
    known = np.arange(r.shape[1]) % 2 == 0  # residuals are (points, outputs) in a row: q, v, q, v
    for part in (r, j, x):
        part[1][~known] = 0.0
    expected = marginal(r, j, x)
    assert fit.z == pytest.approx(expected["z"], abs=1e-5)
    assert fit.cost == pytest.approx(expected["cost"], rel=1e-8)


def test_records_of_different_sensors_are_fitted_together():
    run = noisy(rl.simulate(AXIS, T, U))
    encoder = rl.Record(T, run.inputs, {"q": run["q"]})
    model, load = port_model(AXIS), linear_hypotheses()["load"]
    both = [prepare(AXIS, model, r, 100, outputs={"q", "v"}) for r in (run, encoder)]
    problem = exact()[0].on(both)
    fit = problem.fit(load, WHITE, np.zeros(1), plan=FitPlan(tolerance=1e-9))
    # One by one: the encoder's record alone, its noise alone.
    alone = exact()[0].on([prepare(AXIS, model, encoder, 100)])
    parts = cost(exact()[0], load, WHITE, fit.z, fit.starts[:1])
    parts += cost(alone, load, NoiseModel(WHITE.std[:1], WHITE.ar[:, :1]), fit.z, fit.starts[1:])
    assert fit.cost == pytest.approx(parts - float(fit.z @ fit.z), rel=1e-9)  # the prior counts once
    assert np.isfinite(fit.std).all()


# --- known parameters are found again --------------------------------------------------------------------------------


@cache
def with_friction():
    true = AXIS.with_parameters(M=1.03 * AXIS.values["M"])
    return stick_slip(true, "v", 20.0, T, U).record


def test_coulomb_friction_is_found_in_an_event_driven_simulation():
    problem, pool = problem_of(with_friction())
    friction = pool["coulomb-friction @ v"]
    hypothesis = Hypothesis((friction,))
    start = np.array([0.0, 0.0, *friction.standardised(friction.starts[0])])
    fit = problem.fit(hypothesis, first_noise(problem), start, plan=FitPlan(25))
    factors, (values,) = problem.split(hypothesis, fit.z)
    assert values["Fc"] == pytest.approx(20.0, rel=5e-4)  # a step of 1 ms against events between the steps
    assert factors == pytest.approx({"M": 1.03, "Fv": 1.0}, rel=5e-4)


def test_parameters_lie_within_their_intervals():
    true = np.array([math.log(1.03), 0.0, math.log(20.0)])
    misses = []
    for seed in range(4):
        problem, pool = problem_of(noisy(with_friction(), seed))
        friction = pool["coulomb-friction @ v"]
        noise = NoiseModel(1e-3 * np.ptp(problem.records[0].y, axis=0), np.zeros((0, 2)))
        fit = problem.fit(Hypothesis((friction,)), noise, np.zeros(3), plan=FitPlan(20))
        spread = np.array([n.spread for n in problem.nuisances] + [friction.parameters[0].prior.spread])
        centre = np.array([0.0, 0.0, math.log(friction.parameters[0].prior.centre)])
        misses.append((fit.z - (true - centre) / spread) / fit.std)
    assert np.abs(misses).max() < 4.0
    assert np.sqrt(np.mean(np.square(misses))) < 2.0
