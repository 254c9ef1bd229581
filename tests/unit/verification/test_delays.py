"""Claims about exact delays against closed forms: Lambert's function, delay margins, gains of scalar loops."""

import numpy as np
import pytest
import verify_cases as cases
from scipy.special import lambertw

ONE, ZERO = np.ones((1, 1)), np.zeros((1, 1))
CHANNEL = {"dt": np.array(0.0)}


def lag(a, b, tau, gain=1.0):
    """x' = -a x - b x(t - tau) + u, y = gain x: the delay's channel first."""
    return CHANNEL | {
        "A": -a * ONE, "B": np.array([[-b, 1.0]]), "C": np.array([[1.0], [gain]]), "D": np.zeros((2, 2)),
        "delays": np.array([tau]),
    }  # fmt: skip


def echo(k, tau):
    """y = u + k y(t - tau): neutral, without states."""
    D = np.array([[k, 1.0], [k, 1.0]])
    return CHANNEL | {
        "A": np.zeros((0, 0)), "B": np.zeros((0, 2)), "C": np.zeros((2, 0)), "D": D, "delays": np.array([tau])
    }  # fmt: skip


def test_stability_is_that_of_lamberts_roots():
    rng = np.random.default_rng(1)
    seen = set()
    for _ in range(40):
        a, b, tau = rng.normal(), 3 * rng.normal(), 10 ** rng.uniform(-2, 0.5)
        root = lambertw(-b * tau * np.exp(a * tau)) / tau - a  # the rightmost one is on the principal branch
        expected = "proved" if root.real < 0 else "refuted"
        assert cases.outcome("delayed-stable", lag(a, b, tau)) == expected, (a, b, tau, root)
        seen.add(expected)
    assert len(seen) == 2


@pytest.mark.parametrize("k", [1.5, 4.0, 50.0])
def test_a_loop_is_stable_up_to_its_delay_margin(k):
    w = np.sqrt(k * k - 1)  # k e^(-s tau) / (s + 1) crosses one there
    margin = (np.pi - np.arctan(w)) / w
    for share, expected in ((0.5, "proved"), (1 - 1e-8, "proved"), (1 + 1e-8, "refuted"), (3.0, "refuted")):
        assert cases.outcome("delayed-stable", lag(1.0, k, share * margin)) == expected


def test_a_gain_is_that_of_a_dense_search():
    a, b, tau = 1.0, 2.0, 0.4
    w = np.linspace(0, 20, 400_001)
    peak = np.abs(1 / (1j * w + a + b * np.exp(-1j * w * tau))).max()
    assert cases.outcome("delayed-norm", lag(a, b, tau), gamma=peak * (1 + 1e-7)) == "proved"
    assert cases.outcome("delayed-norm", lag(a, b, tau), gamma=peak * (1 - 1e-7)) == "not proved"
    at = float(w[np.abs(1 / (1j * w + a + b * np.exp(-1j * w * tau))).argmax()])
    assert cases.outcome("delayed-norm", lag(a, b, tau), gamma=peak * (1 - 1e-7), frequency=at) == "refuted"


def test_echoes():
    assert cases.outcome("delayed-norm", echo(0.5, 1.0), gamma=2.001) == "proved"  # 1 / (1 - k)
    assert cases.outcome("delayed-norm", echo(0.5, 1.0), gamma=1.999) == "not proved"
    assert cases.outcome("delayed-stable", echo(1.01, 1.0)) == "not proved"


@pytest.mark.parametrize("delays", [[0.0], [-1.0], [np.inf], [1.0, 1.0, 1.0]])
def test_what_is_no_delay_is_not_proved(delays):
    assert cases.outcome("delayed-stable", lag(1.0, 0.5, 1.0) | {"delays": np.array(delays)}) == "not proved"
    assert cases.outcome("delayed-stable", lag(1.0, 0.5, 1.0) | {"dt": np.array(1.0)}) == "not proved"


def first_order(gain, corner):
    """gain s / (s + corner), with the approximation 1."""
    none = {"R_A": np.zeros((0, 0)), "R_B": np.zeros((0, 1)), "R_C": np.zeros((1, 0)), "R_D": ONE}
    return CHANNEL | none | {"W_A": -corner * ONE, "W_B": corner * ONE, "W_C": -gain * ONE, "W_D": gain * ONE}


def test_a_weight_covers_or_does_not():
    good, common = first_order(2.83, 2.83 / 1.05), {"range": np.array([0.0, 1.0]), "far": 3.1, "near": 1e-3}
    assert cases.outcome("delay-weight", good, **common) == "proved"
    assert cases.outcome("delay-weight", good, **{**common, "range": np.array([0.0, 1.06])}) == "not proved"
    known = first_order(2.0, 2.0)  # tau s / (1 + tau s / 2): often used, and below the error
    assert cases.outcome("delay-weight", known, **common) == "not proved"
    assert cases.outcome("delay-weight", good | {"W_D": 2.8300001 * ONE}, **common) == "not proved"  # W(0) is not zero
    late = good | {"R_D": 1.01 * ONE}
    assert cases.outcome("delay-weight", late, **common) == "not proved"  # |1 - R| at zero
    assert cases.outcome("delay-weight", good, **{**common, "far": 2.0}) == "not proved"  # not yet passed there
    assert cases.outcome("delay-weight", good, **{**common, "far": 8.0}) == "not proved"  # the arc goes round


def test_the_arc_of_delays_counts_and_not_its_ends():
    # e^(-jw) and e^(-jw 5) nearly meet at w = pi / 2, where the delays between them are everywhere.
    weight = first_order(3.0, 3.0) | {"W_A": -20.0 * ONE, "W_B": 20.0 * ONE}
    ends = {"range": np.array([1.0, 5.0]), "far": 40.0, "tolerance": 1e-12}
    assert cases.outcome("delay-weight", weight, **ends) == "not proved"
