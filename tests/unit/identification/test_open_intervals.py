"""Of a gap that is not crossed the least width alone is told."""

from types import SimpleNamespace

import numpy as np
import pytest

from robustlab.dynamics.effects.catalogue import effect
from robustlab.dynamics.effects.contract import Scales, Site
from robustlab.identification.hypotheses.effect_fit import Candidate, Fit, Hypothesis, NoiseModel
from robustlab.identification.naming.named_effects import EffectValue
from robustlab.identification.naming.open_intervals import WIDER, opened_above

SCALES = Scales(position=10.0, shares=(0.04,))


def candidate(name):
    e = effect(name)
    return Candidate(e, Site("joint", "w"), e.parameters(SCALES), e.starts(SCALES), SCALES)


class Problem:
    """A cost that rises by ``wider`` from the fitted gap to one of `WIDER` times it."""

    nuisances = (None, None)

    def __init__(self, wider):
        self.wider, self.asked = wider, []

    def fit(self, hypothesis, noise, z, starts, plan, prior):
        assert (np.diag(prior.precision) > 1e6).sum() == 1  # all but the gap is fitted again
        self.asked.append(z)
        return SimpleNamespace(cost=100.0 + self.wider, z=np.zeros(len(z)))


def fitted(name, value):
    own = candidate(name)
    z = np.append(np.zeros(2), own.standardised(value))
    noise = NoiseModel(np.ones(1), np.zeros((0, 1)))
    fit = Fit(Hypothesis((own,)), z, (), 100.0, np.zeros(0), np.eye(len(z)), noise, 1)
    values = tuple(EffectValue(n, v, "", 0.9 * v, 1.1 * v, "") for n, v in value.items())
    return fit, values


@pytest.mark.parametrize(("wider", "is_open"), [(-1.0, True), (8.9, True), (9.1, False), (1e3, False)])
def test_a_gap_that_may_be_wider_has_the_upper_end_of_its_prior(wider, is_open):
    value = {"gap": 0.1, "share": 0.04, "f": 300.0}
    fit, values = fitted("backlash", value)
    problem = Problem(wider)
    told = opened_above(problem, fit, 0, values)
    assert told[1:] == values[1:]
    assert (told[0].lower, told[0].value) == (values[0].lower, values[0].value)
    gap = fit.hypothesis.candidates[0].parameters[0]
    assert told[0].upper == (pytest.approx(gap.prior.value(1.96)) if is_open else values[0].upper)
    assert gap.prior.value(problem.asked[0][2]) == pytest.approx(WIDER * 0.1)


def test_of_other_effects_nothing_is_asked():
    fit, values = fitted("coulomb-friction", {"Fc": 0.2})
    problem = Problem(0.0)
    assert opened_above(problem, fit, 0, values) == values
    assert not problem.asked
