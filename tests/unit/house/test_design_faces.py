"""What requirements may refer to is declared by the results of designs, reductions and resampling, and is there."""

from __future__ import annotations

import pytest
import shown_objects

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
