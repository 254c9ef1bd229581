"""What requirements may refer to is declared by the results of designs, reductions and resampling, and is there."""

from __future__ import annotations

import pytest
import shown_objects

from robustlab.recipe.steps import contract
from robustlab.result import plain
from robustlab.synthesis import Design

KINDS = [
    *("DKSynthesis", "FixedSynthesis", "H2Synthesis", "HinfSynthesis"),
    *("LPVSynthesis", "NcfSynthesis", "ReducedController", "ReducedModel"),
    *("SampledController", "TunedSynthesis"),
]


@pytest.mark.parametrize("kind", KINDS)
def test_what_is_declared_is_there(kind):
    found = shown_objects.made(kind)
    numbers = plain(found.numbers())
    unset = {name for name in found.quantities if getattr(found, name, "") is None}  # a filter that is not there
    assert set(numbers) == set(found.quantities) - unset
    if isinstance(found, Design):
        assert found.headline()
        assert numbers["gamma"] == plain(found.gamma)


# Kind of step -> the results that it leaves.
LEFT = {
    "mixsyn": ["HinfSynthesis"],
    "hinf": ["HinfSynthesis"],
    "h2": ["H2Synthesis"],
    "ncf": ["NcfSynthesis"],
    "dk": ["DKSynthesis"],
    "fixed": ["FixedSynthesis"],
    "reduce-controller": ["ReducedController"],
    "reduce-model": ["ReducedModel"],
}


@pytest.mark.parametrize("kind", LEFT)
def test_a_step_leaves_what_its_result_declares(kind):
    declared = {}
    for result in LEFT[kind]:
        declared |= type(shown_objects.made(result)).quantities
    assert contract.KINDS[kind].leaves == declared
