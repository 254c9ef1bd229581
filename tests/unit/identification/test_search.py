"""The search over sets of effects, on records of an event-driven integrator: what it finds, drops and merges."""

import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
from naming_cases import (
    AXIS,
    FRICTION,
    GAIN_OF_Q,
    LOAD,
    POOL,
    T,
    U,
    machine,
    noisy,
    opened,
    quiet,
    searched,
    usual,
    values,
)
from scipy.linalg import block_diag

import robustlab as rl
from robustlab.dynamics.effects.catalogue import effect
from robustlab.identification import tuning
from robustlab.identification.hypotheses.effect_fit import Fit, FitPlan, Hypothesis, Problem
from robustlab.identification.hypotheses.noise import first_noise, held_out_fit, predictive
from robustlab.identification.naming import set_search as module
from robustlab.identification.naming.set_search import Key, log_prior, search_sets

# --- what is found ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", [3, 4])
def test_nothing_is_found_where_nothing_is_missing(seed):
    found = usual(seed=seed)
    assert found.best.key == Key()
    assert found.best is found.empty
    assert found.settled


def test_one_effect_is_found():
    found = usual(friction=20.0)
    assert found.best.key == {FRICTION}
    assert values(found, FRICTION)["Fc"] == pytest.approx(20.0, rel=0.02)
    assert found.settled
    assert found.best.evidence - found.empty.evidence > 100.0


def test_a_set_of_two_is_found():
    found = usual(friction=20.0, load=8.0)
    assert found.best.key == {FRICTION, LOAD}
    assert values(found, FRICTION)["Fc"] == pytest.approx(20.0, rel=0.005)
    assert values(found, LOAD)["T0"] == pytest.approx(8.0, rel=0.01)
    assert found.settled


@pytest.fixture
def seen_late(monkeypatch):
    """Hide effects from the first looks; they are free to be found from then on."""

    def hide(looks: int, *hidden: str) -> None:
        plain, done = module.promising, []

        def looked(problem, base, best, pool, *rest):
            done.append(base)
            seen = pool if len(done) > looks else [c for c in pool if c.key not in hidden]
            return plain(problem, base, best, seen, *rest)

        monkeypatch.setattr(module, "promising", looked)

    return hide


def test_two_names_for_one_are_merged(seen_late):
    """A sensor that shows 8 % too much: a smaller inertia and a smaller friction together do just the same."""
    run = rl.simulate(AXIS, T, U)
    record = rl.Record(T, {"u": U}, noisy({"q": 1.08 * run["q"]}, 0), name="gain")
    fit, held, pool, allowed = opened(record, (("M", 0.01), ("Fv", 0.01)))
    keys = ["inertia @ M", "viscous-friction @ Fv", GAIN_OF_Q]
    seen_late(2, GAIN_OF_Q)
    found = search_sets(fit, held, [pool[k] for k in keys], allowed, quiet)
    assert found.best.key == {GAIN_OF_Q}
    assert len(found.best.key) < max(len(v.key) for v in found.sets)


def test_an_effect_that_came_first_and_only_stood_for_others_is_dropped(seen_late, monkeypatch):
    first, told, plain = "asymmetric-viscous-friction @ v", [], module._Search._sharpen

    def sharpened(search):
        told.append(search._told().key)
        plain(search)

    monkeypatch.setattr(module._Search, "_sharpen", sharpened)
    seen_late(1, FRICTION, LOAD)
    found = searched(machine(friction=20.0, load=8.0), (first, FRICTION, LOAD))
    assert told[0] == {first}
    assert found.best.key == {FRICTION, LOAD}
    assert found.settled


def test_what_stood_for_an_effect_and_goes_back_to_its_tolerance_leaves_the_effect_alone():
    """Dry friction beside a viscous one within its tolerance is no answer; it alone is asked, and is the best."""
    fit_on, held, pool, allowed = opened(machine(friction=20.0))
    viscous, n = "viscous-friction @ Fv", len(fit_on.nuisances)
    with ThreadPoolExecutor(1) as workers:
        search = module._Search(fit_on, held, list(pool.values()), allowed, quiet, workers)
        search.noise = first_noise(fit_on)
        for keys in ((), (viscous, FRICTION)):
            own = tuple(pool[k] for k in keys)
            z = np.concatenate([np.zeros(n), *(c.standardised(c.starts[0]) for c in own)])
            search._visit(fit_on.fit(Hypothesis(own), search.noise, z, plan=FitPlan(20)))
        assert not search.visited[Key({viscous, FRICTION})].allowed
        search._within_tolerance()
        assert search.best.key == {FRICTION}
        assert search.visited[Key({FRICTION})].fit.cost < 1.1 * search.visited[Key({viscous, FRICTION})].fit.cost


# --- how sets are judged ---------------------------------------------------------------------------------------------


def test_the_held_out_likelihood_is_that_of_the_dense_gaussian():
    """Windows and parameters jointly normal: the parameters as the fit left them, each window's start integrated out.

    The determinant of the windows alone is common to all sets and left out.
    """
    found = usual()
    fit, noise, held = found.empty.fit, found.noise, found.held
    zero, n = np.zeros((len(held.chosen[0]), 2)), len(fit.z)

    def residual(z, xi):
        return held.whitened(held.errors(fit.hypothesis, z, [xi]), noise)[0]

    r = residual(fit.z, zero)
    x = np.stack([residual(fit.z, zero + e) - r for e in np.eye(2)], axis=2)
    j = np.stack([(residual(fit.z + 1e-3 * e, zero) - r) / 1e-3 for e in np.eye(n)], axis=2).reshape(-1, n)
    windows = block_diag(*(np.eye(r.shape[1]) + x @ np.swapaxes(x, 1, 2)))
    spread = windows + j @ np.linalg.solve(fit.hessian, j.T)
    change = np.linalg.slogdet(spread)[1] - np.linalg.slogdet(windows)[1]
    expected = -0.5 * (r.ravel() @ np.linalg.solve(spread, r.ravel()) + change)
    assert found.empty.held_out == pytest.approx(expected, abs=0.05)


@pytest.mark.parametrize("friction", [0.0, 20.0])
def test_fitted_and_held_out_windows_together_are_as_probable_as_one_after_the_other(friction):
    """The chain rule: p(y_f) p(y_h | y_f) = p(y_f, y_h); at the fitted values alone it is not."""
    fit_on, held, pool, _ = opened(machine(friction=friction))
    own = Hypothesis((pool[FRICTION],) if friction else ())
    z, noise = np.zeros(len(fit_on.nuisances) + len(own.candidates)), first_noise(fit_on)
    fit_on = fit_on.on(fit_on.records, [c[::4] for c in fit_on.chosen])  # few: the parameters are not well known
    fit = fit_on.fit(own, noise, z, plan=FitPlan(30, 1e-6))
    both = fit_on.on([*fit_on.records, *held.records], [*fit_on.chosen, *held.chosen])
    joint = both.fit(own, noise, fit.z, plan=FitPlan(30, 1e-6))
    told = predictive(held, fit, noise)
    assert told == pytest.approx(joint.evidence - fit.evidence, abs=0.5)
    fixed = held_out_fit(held, fit, noise)
    if friction:
        assert told > -0.5 * (fixed.cost - float(fit.z @ fit.z)) + 0.5


def test_the_prior_pays_for_each_effect_more_for_a_refinement_and_for_the_choice_of_a_period():
    _, _, pool, _ = opened(machine(friction=20.0))

    def prior(*keys: str) -> float:
        return log_prior(Hypothesis(tuple(pool[k] for k in keys)))

    each = math.log(tuning.PRIOR_EFFECT)
    assert prior() == 0.0
    assert prior(FRICTION) == pytest.approx(each)
    assert prior(FRICTION, LOAD) == pytest.approx(2 * each)
    assert prior("stribeck-friction @ v") == pytest.approx(each + math.log(tuning.PRIOR_REFINEMENT))
    assert prior("cogging @ v") == pytest.approx(each - math.log(tuning.LOOKED_ELSEWHERE))


def test_what_equals_two_effects_together_is_told_by_their_names():
    _, _, pool, _ = opened(machine(friction=20.0))
    assert set(effect("asymmetric-coulomb-friction").equals) == {"coulomb-friction", "constant-load"}
    assert {FRICTION, LOAD} <= pool.keys()
    assert "asymmetric-coulomb-friction @ v" not in pool


def test_a_set_that_may_be_no_answer_is_kept_and_never_the_best():
    fit, held, pool, _ = opened(machine(friction=20.0))

    def no_friction(_: Problem, fit) -> bool:
        return FRICTION not in {c.key for c in fit.hypothesis.candidates}

    found = search_sets(fit, held, [pool[k] for k in (FRICTION, LOAD)], no_friction, quiet)
    assert FRICTION not in found.best.key
    judged = next(v for v in found.sets if v.key == {FRICTION})
    assert not judged.allowed
    assert judged.evidence > found.best.evidence


@pytest.mark.parametrize("last", [0, 1])
def test_a_ripple_that_may_be_the_answer_is_not_lost_to_one_of_another_period_that_may_not(last):
    found = usual(friction=20.0)
    fit = found.best.fit
    (candidate,) = fit.hypothesis.candidates
    other = replace(fit, hypothesis=Hypothesis((replace(candidate),)), cost=fit.cost - 20.0)

    def allowed(_: Problem, fitted: Fit) -> bool:
        return candidate in fitted.hypothesis.candidates

    search = module._Search(found.problem, found.held, [], allowed, quiet, ThreadPoolExecutor(1))
    search.noise = found.noise
    for visit in [fit, other][:: 1 if last else -1]:
        search._visit(visit)
    assert search.visited[found.best.key].fit is fit
    # Of the same effect the better fit stands, whether it may be the answer or not.
    search.allowed = lambda *_: False
    search._visit(replace(fit, cost=fit.cost - 1.0))
    assert not search.visited[found.best.key].allowed


# --- where it ends ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("budget", [{"most_expansions": 1}, {"most_work": 1}])
def test_a_search_whose_budget_ends_is_not_settled(budget):
    found = searched(machine(friction=20.0), **budget)
    assert not found.settled
    assert not found.interrupted
    assert found.expanded == 1
    assert FRICTION in found.best.key


@pytest.mark.parametrize("after", [1, 8, 20])
def test_an_interrupted_search_gives_what_was_known(after):
    calls = []

    def stop(*_: object) -> None:
        calls.append(1)
        if len(calls) == after:
            raise KeyboardInterrupt

    found = searched(machine(friction=20.0), progress=stop)
    assert found.interrupted
    assert not found.settled
    assert found.empty in found.sets
    assert (found.best.key == {FRICTION}) == (after == 20)


def test_an_empty_pool_leaves_the_empty_set():
    found = searched(machine(friction=20.0), ())
    assert [v.key for v in found.sets] == [Key()]
    assert found.settled


def test_the_answer_does_not_depend_on_the_order_of_the_pool():
    one = usual(friction=20.0, load=8.0)
    other = searched(machine(friction=20.0, load=8.0, seed=3), POOL[::-1])
    assert one.best.key == other.best.key
    assert one.best.evidence - one.empty.evidence == pytest.approx(other.best.evidence - other.empty.evidence, abs=1.0)
