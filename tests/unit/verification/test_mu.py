import numpy as np
import pytest
import verify_cases as cases
from hypothesis import given, settings
from hypothesis import strategies as st

import robustlab as rl
from robustlab.verification import Claim, Outcome, check


def matrix(seed, blocks, real=False):
    rng = np.random.default_rng(seed)
    q, p = cases.sizes(blocks)
    M = rng.standard_normal((p, q))
    return M if real else M + 1j * rng.standard_normal((p, q))


def bounds(M, blocks):
    """The bounds of the solvers, and their evidence as a claim's numbers."""
    found = rl.mu(M, cases.rows_of_mussv(blocks))
    numbers = {"M": M, "blocks": np.array(blocks), "D_w": found.D, "D_z": found.D_z, "G": found.G}
    return found, numbers


@pytest.mark.parametrize("name", cases.STRUCTURES)
@pytest.mark.parametrize("seed", range(3))
def test_bounds_of_a_matrix_from_both_sides(name, seed):
    blocks = cases.STRUCTURES[name]
    M = matrix(seed, blocks, real=name == "repeated real")
    found, numbers = bounds(M, blocks)
    answer = check(cases.claimed("mu-upper", numbers, level=float(found.upper) * (1 + 1e-6)))
    assert answer.outcome is Outcome.PROVED, answer
    assert answer.bound == float(found.upper) * (1 + 1e-6)
    assert cases.outcome("mu-upper", numbers, level=float(found.upper) * (1 - 1e-3)) == "not proved"
    if found.lower > 0:
        size = 1 / float(found.lower)
        lower = {"M": M, "blocks": numbers["blocks"], "delta": found.delta}
        assert cases.outcome("mu-lower", lower, level=1 / size) == "proved"
        assert cases.outcome("mu-lower", lower, level=1 / size * (1 + 1e-6)) == "not proved"
        assert cases.outcome("mu-lower", lower | {"delta": found.delta * (1 - 1e-3)}, level=1 / size) == "not proved"


def test_individual_levels_for_each_block():
    M = np.array([[0.0, 4.0], [1.0, 0.0]], complex)  # singular where delta1 delta2 = 1/4
    numbers = {"M": M, "blocks": np.array([[1, 1, 1], [1, 1, 1]]), "G": np.zeros((2, 2))}
    for levels, d in (([2.0, 2.0], 4.0), ([8.0, 0.5], 64.0), ([1.0, 4.0], 1.0)):
        for factor, outcome in ((1 + 1e-9, "proved"), (1 - 1e-9, "not proved")):
            D = np.diag([1.0, d])
            level = np.array(levels) * factor
            assert cases.outcome("mu-upper", numbers, D_w=D, D_z=D, level=level) == outcome
    delta = np.diag([0.125, 2.0])
    assert cases.outcome("mu-lower", numbers, delta=delta, level=[8.0, 0.5]) == "proved"
    assert cases.outcome("mu-lower", numbers, delta=delta, level=[8.0, 0.5 * (1 + 1e-8)]) == "not proved"
    assert check(cases.claimed("mu-lower", numbers, delta=delta, level=[8.0, 0.5])).bound is None


def test_real_matrices_with_real_blocks():
    M = np.array([[2.0, 1.0], [0.0, -3.0]])
    numbers = {"M": M, "blocks": np.array([[0, 1, 1], [0, 1, 1]])}
    assert cases.outcome("mu-lower", numbers, delta=np.diag([0.0, -1 / 3]), level=3.0) == "proved"
    assert cases.outcome("mu-lower", numbers, delta=np.diag([0.0, 1 / 3]), level=3.0) == "not proved"
    one = {"M": np.ones((1, 1)), "blocks": np.array([[0, 1, 1]])}
    assert cases.outcome("mu-lower", one, delta=np.ones((1, 1)), level=1.0) == "proved"


def test_the_sign_before_j_does_not_matter_but_a_skew_G_does():
    M = np.array([[1j]])  # real delta: never singular
    numbers = {"M": M, "blocks": np.array([[0, 1, 1]]), "D_w": np.eye(1), "D_z": np.eye(1)}
    assert cases.outcome("mu-upper", numbers, G=[[-1e3]], level=1e-3) != cases.outcome(
        "mu-upper", numbers, G=[[1e3]], level=1e-3
    )
    assert "proved" in {cases.outcome("mu-upper", numbers, G=[[g]], level=1e-3) for g in (1e3, -1e3)}
    assert cases.outcome("mu-upper", numbers, G=np.array([[1e3j]]), level=1e-3) == "not proved"
    assert cases.outcome("mu-upper", numbers | {"M": np.eye(1)}, G=np.array([[1e3j]]), level=1e-3) == "not proved"


def broken(numbers, change):
    copy = {k: np.array(v, complex if k in "D_w D_z G M" else None) for k, v in numbers.items()}
    change(copy)
    return check(Claim("mu-upper", copy))


@pytest.mark.parametrize(
    "change",
    [
        lambda n: n["D_w"].__setitem__((0, 1), n["D_w"][0, 1] * (1 + 1e-15) + 1e-300),  # Hermitian no longer
        lambda n: n["D_w"].__setitem__((0, 5), 1e-300),  # outside the blocks
        lambda n: n["D_z"].__setitem__((0, 0), n["D_z"][0, 0] * (1 + 1e-15)),  # two different D
        lambda n: n["D_w"].__setitem__((3, 3), n["D_w"][3, 3] * (1 - 1e-15)),  # a full block's D is no multiple of I
        lambda n: n["G"].__setitem__((2, 2), 1e-300),  # G of a complex block
        lambda n: n["G"].__setitem__((0, 0), n["G"][0, 0] + 1e-300j),  # G not Hermitian
        lambda n: n["G"].__setitem__((0, 4), 1e-300),  # G outside the blocks
        lambda n: n.update(D_w=-n["D_w"], D_z=-n["D_z"]),
        lambda n: n.update(blocks=n["blocks"][:-1]),
        lambda n: n.update(blocks=n["blocks"].astype(float)),
        lambda n: n.update(blocks=np.array([[3, 2, 2], *n["blocks"][1:].tolist()])),
        lambda n: n.update(blocks=np.array([[0, 0, 0], *n["blocks"].tolist()]), level=np.full(5, 9.0)),
        lambda n: n.update(blocks=np.array([[0, 2, 1], [1, 1, 2], *n["blocks"][2:].tolist()])),
        lambda n: n.update(level=np.array([9.0, 9.0])),
        lambda n: n.update(level=np.array([9.0, 9.0, 9.0, 0.0])),
        lambda n: n.update(level=np.array(np.inf)),
        lambda n: n.update(level=np.array(np.nan)),
        lambda n: n.update(M=n["M"].T),
    ],
)
def test_scalings_that_are_not_of_the_structure_prove_nothing(change):
    blocks = cases.STRUCTURES["mixed"]
    found, numbers = bounds(matrix(0, blocks), blocks)
    numbers["level"] = np.array(2 * float(found.upper))
    assert broken(numbers, lambda n: None).outcome is Outcome.PROVED
    answer = broken(numbers, change)
    assert answer.outcome is Outcome.NOT_PROVED
    assert answer.where


@pytest.mark.parametrize(
    "change",
    [
        lambda n: n["delta"].__setitem__((0, 0), n["delta"][0, 0] + 1e-18j),
        lambda n: n["delta"].__setitem__((0, 1), 1e-300),
        lambda n: n["delta"].__setitem__((0, 4), 1e-300),
        lambda n: n["delta"].__setitem__((0, 0), n["delta"][0, 0] + 1e-10),
        lambda n: n.update(delta=n["delta"].T),
    ],
)
def test_a_delta_that_is_not_of_the_structure_proves_nothing(change):
    blocks = cases.STRUCTURES["mixed"]
    M = matrix(0, blocks)
    found, _ = bounds(M, blocks)
    numbers = {"M": M, "blocks": np.array(blocks), "delta": found.delta.copy(), "level": np.array(found.lower * 0.9)}
    assert check(Claim("mu-lower", numbers)).outcome is Outcome.PROVED
    change(numbers)
    assert check(Claim("mu-lower", numbers)).outcome is Outcome.NOT_PROVED


NUMBERS = st.floats(allow_nan=False, allow_infinity=False) | st.floats(-10, 10)


@pytest.mark.slow
@settings(max_examples=100)
@given(st.data(), st.integers(0, 3), st.sampled_from(["real", "complex", "repeated real"]))
def test_no_scalings_prove_less_than_mu(data, seed, name):
    blocks = cases.STRUCTURES[name]
    M = matrix(seed, blocks, real=True)
    found, numbers = bounds(M, blocks)
    D, G = found.D.copy(), found.G.copy()
    i = data.draw(st.integers(0, len(D) - 1))
    D[i, i] = data.draw(NUMBERS)
    if name != "complex":
        G[i, i] = data.draw(NUMBERS)
    for factor in (1 - 1e-6, 0.5):
        level = max(float(found.lower) * factor, 1e-6)
        answer = check(cases.claimed("mu-upper", numbers | {"D_w": D, "D_z": D, "G": G}, level=level))
        assert answer.outcome is not Outcome.PROVED or not found.lower


@pytest.mark.slow
@settings(max_examples=100)
@given(st.data(), st.integers(0, 3), st.sampled_from(list(cases.STRUCTURES)))
def test_no_delta_proves_more_than_mu(data, seed, name):
    blocks = cases.STRUCTURES[name]
    M = matrix(seed, blocks)
    found, _ = bounds(M, blocks)
    factor = data.draw(st.floats(0.5, 2.0) | st.just(1.0))
    numbers = {"M": M, "blocks": np.array(blocks), "delta": found.delta * factor}
    level = float(found.upper) * data.draw(st.sampled_from([1 + 1e-6, 1.1]))
    assert cases.outcome("mu-lower", numbers, level=level) != "proved"


def test_boxes_of_a_matrix_with_an_uneven_range():
    one = {"D_w": np.ones((1, 1, 1)), "D_z": np.ones((1, 1, 1)), "G": np.zeros((1, 1, 1))}
    one |= {"low": np.zeros(1), "high": np.full(1, np.inf)}
    numbers = {**one, "M": np.eye(1), "blocks": np.array([[0, 1, 1]]), "level": np.ones(1), "size": 1.0}

    def verdict(ranges, box, **more):  # 1 - delta is singular at delta = 1 and nowhere else
        return cases.outcome("mu-upper-boxes", numbers | {"ranges": [ranges], "box": [[box]]} | more)

    assert verdict((-2.0, 0.9), (-2.0, 0.9)) == "proved"
    assert verdict((-2.0, 0.9), (-2.5, 0.95)) == "proved"
    assert verdict((-2.0, 1.0), (-2.0, 1.0)) == "not proved"
    assert verdict((-2.0, 0.9), (-2.0, 0.8)) == "not proved"
    assert verdict((-2.0, 0.9), (-2.0, 0.9), high=[5.0]) == "not proved"
    assert verdict((-2.0, 0.9), (-2.0, 0.9), size=1.01) == "not proved"
    assert verdict((-1.0, 1.0), (-100.0, 100.0), size=100.0, M=np.array([[1j]]), G=np.full((1, 1, 1), 1e3)) == "proved"
    assert verdict((-1.0, 1.0), (-100.0, 100.0), size=100.0, G=np.full((1, 1, 1), 1e3)) == "not proved"


def test_a_difference_over_a_band():
    G = {"A1": -np.eye(1), "B1": np.eye(1), "C1": np.eye(1), "D1": np.zeros((1, 1)), "dt": 0.0}
    H = {"A2": np.zeros((0, 0)), "B2": np.zeros((0, 1)), "C2": np.zeros((1, 0)), "D2": np.eye(1)}
    one = {"D_w": np.ones((1, 1, 1)), "D_z": np.ones((1, 1, 1)), "G": np.zeros((1, 1, 1)), "low": [0.0], "high": [1.0]}
    numbers = {**G, **H, **one, "blocks": np.array([[2, 1, 1]]), "band": [0.0, 1.0]}
    peak = 1 / np.sqrt(2)  # of 1/(s + 1) - 1 = -s/(s + 1) up to 1 rad/s
    assert cases.outcome("mu-axis", numbers, level=peak * (1 + 1e-9)) == "proved"
    assert cases.outcome("mu-axis", numbers, level=peak * (1 - 1e-9)) == "not proved"
    assert cases.outcome("mu-axis", numbers, D2=-np.eye(1), level=peak * (1 + 1e-9)) == "not proved"
