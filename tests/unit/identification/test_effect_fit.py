"""Fit of one hypothesis: against dense least squares, closed-form evidence, and records of another integrator."""

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from naming_cases import AXIS, T, U, noisy, problem_of
from oracle.stick_slip import stick_slip

import robustlab as rl
from robustlab.identification import FitPlan, Hypothesis, NoiseModel, Problem, first_noise, ports_of, prepare

NONE = Hypothesis(())


def cost(problem, hypothesis, noise, z, starts):
    """Return V at a point."""
    parts = [*problem.whitened(problem.errors(hypothesis, z, starts), noise), *starts, z]
    return sum(float((part**2).sum()) for part in parts)


def recorded(run, seed=0):
    """Add white noise of a thousandth of the range."""
    return rl.Record(T, {"u": U}, noisy(run.outputs, seed))


@cache
def exact():
    """Return the problem of a noisy record of the exact plant."""
    return problem_of(recorded(rl.simulate(AXIS, T, U)), tolerances={"M": 0.0, "Fv": 0.0})


WHITE = NoiseModel(np.array([2e-4, 2e-3]), np.zeros((0, 2)))


# --- the normal equations --------------------------------------------------------------------------------------------


def dense_parts(problem: Problem, hypothesis: Hypothesis, noise: NoiseModel):
    """Return residuals at z = 0 and xi = 0, and their exact derivatives for a linear problem."""
    n_z, starts = problem.size(hypothesis), np.zeros((len(problem.chosen[0]), len(problem.plant.states)))

    def residual(z, xi):
        return problem.whitened(problem.errors(hypothesis, z, [xi]), noise)[0]

    zero = np.zeros(n_z)
    r = residual(zero, starts)
    j = np.stack([residual(e, starts) - r for e in np.eye(n_z)] or [np.zeros_like(r)], axis=2)[:, :, :n_z]
    x = np.stack([residual(zero, starts + e) - r for e in np.eye(starts.shape[1])], axis=2)
    return r, j, x


def linear_hypotheses() -> dict[str, Hypothesis]:
    """Return hypotheses with linear effects of normal prior: a constant load and a bias of the speed sensor."""
    load, bias = exact()[1]["constant-load@v"], exact()[1]["sensor-bias@v"]
    return {"none": NONE, "load": Hypothesis((load,)), "bias": Hypothesis((bias,)), "both": Hypothesis((load, bias))}


def fitted(hypothesis: Hypothesis, **options):
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
    """Return posterior mean of z, V there, and log p(y), with initial states integrated out: S = 1 + X X^T."""
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
    # Up to -1/2 log det(1 + X^T X) of the initial states, which is the same for these hypotheses.
    ours, theirs = {}, {}
    for name, hypothesis in linear_hypotheses().items():
        ours[name] = fitted(hypothesis).evidence
        theirs[name] = marginal(*dense_parts(exact()[0], hypothesis, WHITE))["evidence"]
    for name in ("load", "bias", "both"):
        assert ours[name] - ours["none"] == pytest.approx(theirs[name] - theirs["none"], abs=1e-4)
    assert len({round(v, 2) for v in theirs.values()}) == 4  # they differ


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
    """The viscosity is 30 N s/m, in the model 0 +- 50."""
    true = rl.simulate(rl.plant("servo-axis", Fv=30.0), T, U)
    problem, _ = problem_of(recorded(true), rl.plant("servo-axis", Fv=(0.0, 50.0)), tolerances={"M": 0.0})
    fit = problem.fit(NONE, WHITE, np.zeros(1))
    factors, _ = problem.split(fit.hypothesis, fit.z)
    assert factors["Fv"] == pytest.approx(30.0, rel=0.05)


@pytest.mark.parametrize("value", [np.inf, -np.inf, np.nan])
def test_a_diverged_simulation_is_not_a_missing_sample(monkeypatch, value):
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
    run = recorded(rl.simulate(AXIS, T, U))
    encoder = rl.Record(T, run.inputs, {"q": run["q"]})
    model, load = ports_of(AXIS, run), linear_hypotheses()["load"]
    both = [prepare(AXIS, model, r, 100, outputs={"q", "v"}) for r in (run, encoder)]
    problem = exact()[0].on(both)
    fit = problem.fit(load, WHITE, np.zeros(1), plan=FitPlan(tolerance=1e-9))
    # Each record alone with its noise.
    alone = exact()[0].on([prepare(AXIS, model, encoder, 100)])
    parts = cost(exact()[0], load, WHITE, fit.z, fit.starts[:1])
    parts += cost(alone, load, NoiseModel(WHITE.std[:1], WHITE.ar[:, :1]), fit.z, fit.starts[1:])
    assert fit.cost == pytest.approx(parts - float(fit.z @ fit.z), rel=1e-9)  # the prior counts once
    assert np.isfinite(fit.std).all()


# --- known parameters ------------------------------------------------------------------------------------------------


@cache
def with_friction():
    true = AXIS.with_parameters(M=1.03 * AXIS.values["M"])
    return stick_slip(true, "v", 20.0, T, U).record


def test_coulomb_friction_is_found_in_an_event_driven_simulation():
    problem, pool = problem_of(with_friction())
    friction = pool["coulomb-friction@v"]
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
        problem, pool = problem_of(recorded(with_friction(), seed))
        friction = pool["coulomb-friction@v"]
        noise = NoiseModel(1e-3 * np.ptp(problem.records[0].y, axis=0), np.zeros((0, 2)))
        fit = problem.fit(Hypothesis((friction,)), noise, np.zeros(3), plan=FitPlan(20))
        spread = np.array([n.spread for n in problem.nuisances] + [friction.parameters[0].prior.spread])
        centre = np.array([0.0, 0.0, math.log(friction.parameters[0].prior.centre)])
        misses.append((fit.z - (true - centre) / spread) / fit.std)
    assert np.abs(misses).max() < 4.0
    assert np.sqrt(np.mean(np.square(misses))) < 2.0
