"""The judge of the checker: what is true passes, planted lies do not."""

import numpy as np
import pytest

pytest.importorskip("flint")

from verify_claims import MAKERS
from verify_judge import judge

LIES = {"norm": "gamma", "mu-upper": "level", "mu-axis": "level", "worst-gain": "gamma", "gramian": "value"}


@pytest.mark.parametrize("kind", LIES)
def test_a_level_that_is_too_low_is_found(kind):
    rng, found = np.random.default_rng(3), 0
    for _ in range(6):
        case = MAKERS[kind](rng)
        if case is None:
            continue
        assert judge(kind, case.numbers, True, case.hints) == ""
        lie = case.numbers | {LIES[kind]: np.asarray(case.numbers[LIES[kind]]) * 0.5}
        assert judge(kind, lie, True, case.hints).startswith(("false", "unjustified"))
        found += 1
    assert found
