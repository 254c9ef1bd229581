"""The search over sets of effects, on records of an event-driven integrator: what it finds, drops and merges."""

import numpy as np
import pytest
from naming_cases import (
    FRICTION,
    LOAD,
    POOL,
    machine,
    opened,
    searched,
    usual,
    values,
)
from scipy.linalg import block_diag

from robustlab.identification.hypotheses.effect_fit import FitPlan, Hypothesis
from robustlab.identification.hypotheses.noise import first_noise, held_out_fit, predictive
from robustlab.identification.naming.set_search import Key

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


@pytest.mark.slow
def test_the_answer_does_not_depend_on_the_order_of_the_pool():
    one = usual(friction=20.0, load=8.0)
    other = searched(machine(friction=20.0, load=8.0, seed=3), POOL[::-1])
    assert one.best.key == other.best.key
    assert one.best.evidence - one.empty.evidence == pytest.approx(other.best.evidence - other.empty.evidence, abs=1.0)
