"""Claims about the weights of delays, against weights known to be large enough or too small."""

import numpy as np
import verify_cases as cases

ONE = np.ones((1, 1))
CHANNEL = {"dt": np.array(0.0)}


def first_order(gain, corner):
    """gain s / (s + corner), with the approximation 1."""
    none = {"R_A": np.zeros((0, 0)), "R_B": np.zeros((0, 1)), "R_C": np.zeros((1, 0)), "R_D": ONE}
    return CHANNEL | none | {"W_A": -corner * ONE, "W_B": corner * ONE, "W_C": -gain * ONE, "W_D": gain * ONE}


def test_a_weight_covers_or_does_not():
    good, common = first_order(2.83, 2.83 / 1.05), {"range": np.array([0.0, 1.0]), "far": 3.1, "tolerance": 1e-6}
    assert cases.outcome("delay-weight", good, **common) == "proved"
    assert cases.outcome("delay-weight", good, **{**common, "range": np.array([0.0, 1.06])}) == "not proved"
    known = first_order(2.0, 2.0)  # tau s / (1 + tau s / 2): often used, and below the error
    assert cases.outcome("delay-weight", known, **common) == "not proved"
    assert cases.outcome("delay-weight", good | {"W_D": 2.8 * ONE}, **common) == "not proved"
    late = good | {"R_D": 1.01 * ONE}
    assert cases.outcome("delay-weight", late, **common) == "not proved"  # |1 - R| at zero
    assert cases.outcome("delay-weight", good, **{**common, "far": 2.0}) == "not proved"  # not yet passed there
    assert cases.outcome("delay-weight", good, **{**common, "far": 8.0}) == "not proved"  # the arc goes round


def test_the_whole_arc_of_delays_is_covered():
    # e^(-jw) and e^(-jw 5) nearly meet at w = pi / 2, where the delays between them are everywhere.
    weight = first_order(3.0, 3.0) | {"W_A": -20.0 * ONE, "W_B": 20.0 * ONE}
    ends = {"range": np.array([1.0, 5.0]), "far": 40.0, "tolerance": 1e-12}
    assert cases.outcome("delay-weight", weight, **ends) == "not proved"
