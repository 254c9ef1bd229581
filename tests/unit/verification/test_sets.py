import numpy as np
import pytest
import verify_cases as cases

from robustlab.verification import Outcome, check


def example(seed=0, q=2, n=3, m=2, p=1, D11=None):
    """Small integers over powers of two: everything is exact in doubles, and the ends are known."""
    rng = np.random.default_rng(seed)
    A, B1, B2, C1, C2, D12, D21, D22 = (
        rng.integers(-8, 9, s) / 4.0 for s in ((n, n), (n, q), (n, m), (q, n), (p, n), (q, m), (p, q), (p, m))
    )
    D11 = np.array([[0.5, 1.0], [0.0, -1.0]]) if D11 is None else D11
    N = np.linalg.inv(np.eye(q) - D11)  # [[2, 1], [0, 1/2]]: exact
    return {
        "A": A, "B": np.hstack([B1, B2]), "C": np.vstack([C1, C2]), "D": np.block([[D11, D12], [D21, D22]]),
        "blocks": np.array([[0, 1, 1], [0, 1, 1]]), "A0": A, "B0": B2, "C0": C2, "D0": D22,
        "A1": A + B1 @ N @ C1, "B1": B2 + B1 @ N @ D12, "C1": C2 + D21 @ N @ C1, "D1": D22 + D21 @ N @ D12,
    }  # fmt: skip


@pytest.mark.parametrize("seed", range(4))
def test_the_ends_of_a_set(seed):
    numbers = example(seed)
    assert check(cases.claimed("set", numbers)).outcome is Outcome.PROVED
    for name in ("A0", "B0", "C0", "D0", "A1", "B1", "C1", "D1"):
        entry = np.unravel_index(seed % numbers[name].size, numbers[name].shape)
        changed = numbers[name].copy()
        changed[entry] = np.nextafter(changed[entry], np.inf)
        answer = check(cases.claimed("set", numbers | {name: changed}))
        assert answer.outcome is Outcome.REFUTED
        assert f" {name} " in answer.where
        assert cases.outcome("set", numbers | {name: changed}, tolerance=1e-14) == "proved"
        changed[entry] += 1e-10
        assert cases.outcome("set", numbers | {name: changed}, tolerance=1e-14) == "refuted"


def test_a_set_that_ends_in_no_model_and_ill_formed_ones():
    numbers = example()
    bad = numbers["D"].copy()
    bad[0, 0] = 1.0
    assert cases.outcome("set", numbers | {"D": bad}) == "refuted"
    assert cases.outcome("set", numbers | {"blocks": np.array([[1, 1, 1], [0, 1, 1]])}) == "not proved"
    assert cases.outcome("set", numbers | {"blocks": np.array([[0, 9, 9]])}) == "not proved"
    assert cases.outcome("set", numbers | {"A1": np.eye(2)}) == "not proved"
    assert cases.outcome("set", numbers, tolerance=-1.0) == "not proved"
    huge = numbers["A1"].copy()
    huge[0, 0] = 1e308
    assert cases.outcome("set", numbers | {"A1": huge}) == "refuted"


def test_no_states_and_no_channels():
    D = np.array([[3.0]])
    empty = np.zeros((0, 0))
    numbers = {"A": empty, "B": np.zeros((0, 1)), "C": np.zeros((1, 0)), "D": D, "blocks": np.zeros((0, 3), np.int64)}
    ends = {f"{x}{end}": numbers[x] for x in "ABCD" for end in (0, 1)}
    assert cases.outcome("set", numbers | ends) == "proved"
    assert cases.outcome("set", numbers | ends | {"D1": D + 1}) == "refuted"
