"""For any content of a claim, `check` returns a valid verdict without an exception."""

import numpy as np
import pytest
import verify_cases as cases
from hypothesis import given, settings
from hypothesis import strategies as st

from robustlab.verification import Claim, Outcome, check

ONE = np.ones((1, 1))
LAG = {"A": -ONE, "B": ONE, "C": ONE, "D": 0 * ONE, "dt": np.array(0.0)}
BLOCK = {"blocks": np.array([[0, 1, 1]]), "level": np.array(1.1)}
CLAIMS = {
    "stable": LAG,
    "norm": LAG | {"gamma": np.array(1.1), "P": ONE},
    "loop-norm": {f"P_{x}": LAG[x] for x in "ABCD"}
    | {"P_B": np.ones((1, 2)), "P_C": np.ones((2, 1)), "P_D": np.zeros((2, 2))}
    | {f"K_{x}": -0.5 * LAG[x] if x != "A" else -ONE for x in "ABCD"}
    | {"n_meas": np.array(1), "n_con": np.array(1), "dt": np.array(0.0), "gamma": np.array(9.0)},
    "difference-norm": {f"{x}{i}": LAG[x] for x in "ABCD" for i in (1, 2)}
    | {"dt": np.array(0.0), "gamma": np.array(0.1)},
    "gramian": LAG | {"P": ONE, "value": np.array(1.1)},
    "mu-upper": BLOCK | {"M": ONE, "D_w": ONE, "D_z": ONE, "G": 0 * ONE},
    "mu-lower": BLOCK | {"M": ONE, "delta": ONE, "level": np.array(0.9)},
    "mu-axis": LAG
    | BLOCK
    | {"low": np.array([0.0]), "high": np.array([np.inf]), "D_w": ONE[None], "D_z": ONE[None], "G": 0 * ONE[None]},
    "unstable-member": LAG | BLOCK | {"delta": ONE, "level": np.array(0.9)},
    "iqc-gain": LAG
    | {"B": np.ones((1, 2)), "C": np.ones((2, 1)), "D": np.zeros((2, 2)), "blocks": BLOCK["blocks"]}
    | {"nature": np.array([[1, 0, 0]]), "ranges": np.array([[-0.5, 0.5]]), "slope": np.zeros((1, 2))}
    | {"rate": np.array([np.inf]), "pole": np.array(1.0), "order": np.array(1), "P": 2 * ONE}
    | {"multipliers": np.array([1.0]), "gamma": np.array(2.1)},
    "iqc-size": LAG
    | {"blocks": BLOCK["blocks"], "nature": np.array([[2, 0, 1]]), "ranges": np.array([[-1.0, 1.0]])}
    | {"slope": np.zeros((1, 2)), "rate": np.array([np.inf]), "pole": np.array(1.0), "order": np.array(2), "P": ONE}
    | {"multipliers": np.array([1.0, 0.0]), "size": np.array(0.9)},
    "lpv-gain": {"points0": np.array([1.0, 4.0]), "M": np.array([[[-1.0, 1.0], [1.0, 0.0]], [[-4.0, 4.0], [1.0, 0.0]]])}
    | {"n": np.array(1), "rate": np.array([np.inf]), "P": 0.5 * ONE[None], "gamma": np.array(1.3)}
    | {"deviation": np.zeros((1, 2, 2))},
    "set": {"A": -ONE, "B": np.ones((1, 2)), "C": np.ones((2, 1)), "D": np.zeros((2, 2)), "blocks": BLOCK["blocks"]}
    | {"A0": -ONE, "B0": ONE, "C0": ONE, "D0": 0 * ONE, "A1": 0 * ONE, "B1": ONE, "C1": ONE, "D1": 0 * ONE},
}
CLAIMS |= {
    "delayed-stable": CLAIMS["mu-axis"] | {"B": 0.9 * ONE},
    "delay-weight": {"R_A": np.zeros((0, 0)), "R_B": np.zeros((0, 1)), "R_C": np.zeros((1, 0)), "R_D": ONE}
    | {"W_A": -2.695 * ONE, "W_B": 2.695 * ONE, "W_C": -2.83 * ONE, "W_D": 2.83 * ONE, "dt": np.array(0.0)}
    | {"range": np.array([0.0, 1.0]), "far": np.array(3.1), "tolerance": np.array(1e-9)},
}
JUNK = [
    np.array(np.nan), np.array(-1.0), np.array(0.0), np.array(5e-324), np.array(1.7e308), np.zeros((0, 0)), -ONE,
    np.zeros((0, 1)), np.ones((1, 0)), np.full((1, 1), np.inf), np.full((1, 1), 1e308), np.full((1, 1), 5e-324),
    1j * ONE, np.array([[2, -1, -1]]), np.array([[0, 2**62, 2**62]]), np.array("x"), [[1.0], [1.0, 2.0]], None,
    np.array([True]), np.ones((1, 1, 1, 1)), ONE.astype(np.float32), np.array(7), np.array(-7), np.array([]),
]  # fmt: skip


@pytest.mark.parametrize("kind", CLAIMS)
def test_the_unchanged_claims_are_proved(kind):
    answer = check(Claim(kind, CLAIMS[kind]))
    assert answer.outcome is Outcome.PROVED, answer


@pytest.mark.parametrize("kind", CLAIMS)
def test_each_dataset_replaced_by_junk(kind):
    for name in CLAIMS[kind]:
        for junk in JUNK:
            answer = check(Claim(kind, CLAIMS[kind] | {name: junk}), effort=300)
            assert answer.outcome is Outcome.PROVED or answer.where


@pytest.mark.parametrize("kind", CLAIMS)
@settings(max_examples=12)
@given(st.data())
def test_numbers_of_any_magnitude(kind, data):
    numbers = {}
    for name, value in CLAIMS[kind].items():
        numbers[name] = value
        if value.dtype.kind == "f" and data.draw(st.booleans()):
            size = 2.0 ** data.draw(st.integers(-1070, 1020))
            numbers[name] = value * size
    assert check(Claim(kind, numbers), effort=300).outcome in Outcome


def test_empty_and_oversized_claims():
    for kind in CLAIMS:
        answer = check(Claim(kind, {}))
        assert answer.outcome is Outcome.NOT_PROVED
        assert "missing" in answer.where
    large = cases.model(0, 1, 1, 1) | {"A": -np.eye(1500), "B": np.ones((1500, 1)), "C": np.ones((1, 1500))}
    assert "effort" in check(cases.claimed("norm", large, gamma=1e9)).where
