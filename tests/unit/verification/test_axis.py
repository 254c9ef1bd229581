from functools import cache

import numpy as np
import pytest
import verify_cases as cases
from hypothesis import given, settings
from hypothesis import strategies as st

import robustlab as rl
from robustlab.verification import Outcome, check

BUILD = {0: lambda i, r, c: rl.RealScalar(f"d{i}", repeats=r), 1: lambda i, r, c: rl.ComplexScalar(f"d{i}", repeats=r)}


@cache
def example(name, seed, n=4):
    """A model with blocks, its margin by the solvers, and the claim's numbers."""
    blocks = cases.STRUCTURES[name]
    q, p = cases.sizes(blocks)
    G = cases.model(seed, n, q, p, margin=0.3)
    structure = [BUILD.get(k, rl.FullBlock and (lambda i, r, c: rl.FullBlock(f"d{i}", r, c)))(i, r, c)
                 for i, (k, r, c) in enumerate(blocks)]  # fmt: skip
    model = rl.StateSpaceModel(*(G[x] for x in "ABCD"))
    margin = rl.robust_stability(rl.UncertainModel(model, structure), tolerance=np.inf)
    intervals, level = cases.interval_numbers(margin)
    return G, margin, intervals | G | {"blocks": np.array(blocks)}, level


@pytest.mark.parametrize("name", cases.STRUCTURES)
@pytest.mark.parametrize("seed", [0, 1])
def test_margins_of_the_solvers_are_proved_and_larger_ones_are_not(name, seed):
    _, margin, numbers, level = example(name, seed)
    answer = check(cases.claimed("mu-axis", numbers, level=level * (1 + 1e-6)))
    assert answer.outcome is Outcome.PROVED, answer
    if np.isfinite(margin.upper):
        assert cases.outcome("mu-axis", numbers, level=1 / margin.upper * (1 - 1e-6)) == "not proved"


def proved(numbers, **more):
    return cases.outcome("mu-axis", numbers, **more) == "proved"


def test_every_interval_is_needed():
    _, _, numbers, level = example("mixed", 0)
    level *= 1 + 1e-6
    low, high = numbers["low"], numbers["high"]
    assert proved(numbers, level=level)
    inside = np.geomspace(1e-5, 1.0, 2000)
    holding = (low <= inside[:, None]) & (inside[:, None] <= high)
    needed = sorted({int(row.argmax()) for row in holding if row.sum() == 1})
    assert needed
    for i in needed:
        fewer = {key: np.delete(numbers[key], i, axis=0) for key in ("low", "high", "D_w", "D_z", "G")}
        answer = check(cases.claimed("mu-axis", numbers | fewer, level=level))
        assert answer.outcome is Outcome.NOT_PROVED
        assert "cover" in answer.where


@pytest.mark.parametrize(
    "change",
    [
        lambda low, high: low.__setitem__(0, 1e-300),
        lambda low, high: low.__setitem__(0, -1.0),
        lambda low, high: high.__setitem__(-1, 1e300),
        lambda low, high: high.__setitem__(-1, np.nan),
        lambda low, high: low.__setitem__(-1, np.nextafter(high[-2], np.inf)),
        lambda low, high: high.__setitem__(0, -np.inf),
        lambda low, high: low.__setitem__(-1, np.inf),
    ],
)
def test_intervals_that_do_not_cover_the_axis(change):
    _, _, numbers, level = example("real", 0)
    half = {key: np.concatenate([numbers[key][:1]] * 2) for key in ("D_w", "D_z", "G")}
    low, high = np.array([0.0, 1.0]), np.array([1.0, np.inf])
    assert proved(numbers | half, low=low, high=high, level=level * 20)
    change(low, high)
    answer = check(cases.claimed("mu-axis", numbers | half, low=low, high=high, level=level * 20))
    assert answer.outcome is Outcome.NOT_PROVED
    assert answer.where


def test_an_unstable_nominal_model_is_refuted_however_small_mu_is():
    _, _, numbers, level = example("real", 0)
    unstable = numbers | {"A": -numbers["A"]}
    assert cases.outcome("mu-axis", unstable, level=level * 100) == "refuted"
    # a claim about a band says nothing about stability
    band = {"band": [0.0, np.inf]}
    assert check(cases.claimed("mu-axis", unstable, band, level=level * 1e4)).outcome is Outcome.PROVED
    assert "band" in check(cases.claimed("mu-axis", unstable, band, level=level * 1e4)).claim


@pytest.mark.parametrize("name", ["real", "mixed", "full"])
def test_a_destabilising_delta_is_a_member(name):
    G, margin, numbers, _ = example(name, 1)
    values = margin.delta
    q, p = cases.sizes(cases.STRUCTURES[name])
    delta = np.zeros((q, p), complex)
    row = col = 0
    for i, (kind, r, c) in enumerate(cases.STRUCTURES[name]):
        value = values[f"d{i}"]
        delta[row : row + r, col : col + c] = value if kind == 2 else value * np.eye(r)
        row, col = row + r, col + c
    size = cases.delta_norms(cases.STRUCTURES[name], delta).max()
    member = G | {"blocks": numbers["blocks"], "delta": delta}
    assert cases.outcome("unstable-member", member, level=1 / size) == "proved"
    assert cases.outcome("unstable-member", member, level=(1 + 1e-7) / size) == "not proved"
    assert cases.outcome("unstable-member", member | {"delta": delta * 0.5}, level=1 / size) == "not proved"
    assert cases.outcome("unstable-member", member | {"delta": delta * 0}, level=1 / size) == "not proved"


def lag(dt=0.0):
    """A pole at -1 + delta (discrete 1/2 + delta/2): unstable from delta = 1 on."""
    A, B = (0.5, 0.5) if dt else (-1.0, 1.0)
    one = np.ones((1, 1))
    G = {"A": A * one, "B": B * one, "C": one, "D": 0 * one, "dt": dt}
    return G | {"blocks": np.array([[0, 1, 1]])}


@pytest.mark.parametrize("dt", [0.0, 0.1])
def test_a_pole_that_moves_with_a_parameter(dt):
    G = lag(dt)
    scalings = {"D_w": np.ones((1, 1, 1)), "D_z": np.ones((1, 1, 1)), "G": np.zeros((1, 1, 1))}
    everywhere = scalings | {"low": [0.0], "high": [np.inf]}
    assert proved(G | everywhere, level=1 + 1e-9)
    assert not proved(G | everywhere, level=1 - 1e-9)
    for level, outcome in ((1.0, "proved"), (1 + 1e-8, "not proved"), (0.5, "proved")):
        assert cases.outcome("unstable-member", G, delta=np.ones((1, 1)), level=level) == outcome
    minus = G | {"B": -G["B"], "C": G["C"]}
    assert cases.outcome("unstable-member", minus, delta=-np.ones((1, 1)), level=1.0) == "proved"


def test_a_discrete_pole_that_leaves_at_minus_one():
    one = np.ones((1, 1))
    G = {"A": -0.5 * one, "B": 0.5 * one, "C": one, "D": 0 * one, "dt": 1.0, "blocks": np.array([[0, 1, 1]])}
    assert cases.outcome("unstable-member", G, delta=-one, level=1.0) == "proved"
    assert cases.outcome("unstable-member", G, delta=-one * (1 - 1e-7), level=1.0) == "not proved"
    assert cases.outcome("unstable-member", G, delta=one, level=1.0) == "not proved"


def test_the_end_of_the_discrete_axis_is_pi_over_dt():
    G = lag(0.1)
    scalings = {"D_w": np.ones((1, 1, 1)), "D_z": np.ones((1, 1, 1)), "G": np.zeros((1, 1, 1))}
    end = np.pi / 0.1
    for high, outcome in ((end * (1 - 1e-12), False), (end * (1 + 1e-12), True), (np.inf, True)):
        assert proved(G | scalings, low=[0.0], high=[high], level=1.1) is outcome
    assert not proved(G | scalings, low=[0.0], high=[np.inf], band=[end * 1.1, end * 1.2], level=1.1)


def test_a_model_that_is_not_well_posed_within_the_set():
    G = lag() | {"D": 2 * np.ones((1, 1))}
    assert cases.outcome("unstable-member", G, delta=[[0.5]], level=2.0) == "proved"
    scalings = {"D_w": np.ones((1, 1, 1)), "D_z": np.ones((1, 1, 1)), "G": np.zeros((1, 1, 1))}
    G["C"] = np.zeros((1, 1))
    assert proved(G | scalings, low=[0.0], high=[np.inf], level=2 + 1e-9)
    assert not proved(G | scalings, low=[0.0], high=[np.inf], level=2 - 1e-9)


NUMBERS = st.floats(allow_nan=False, allow_infinity=False) | st.floats(-10, 10)


@pytest.mark.slow
@settings(max_examples=60)
@given(st.data(), st.sampled_from(["real", "repeated real", "mixed", "full"]))
def test_no_evidence_proves_a_margin_that_a_member_contradicts(data, name):
    _, margin, numbers, _ = example(name, 1)
    changed = {key: numbers[key].copy() for key in ("D_w", "D_z", "G", "low", "high")}
    k = data.draw(st.integers(0, len(changed["low"]) - 1))
    key = data.draw(st.sampled_from(["D_w", "G", "low", "high"]))
    if key in ("low", "high"):
        changed[key][k] = data.draw(st.floats(0, 1e3))
    else:
        value = data.draw(NUMBERS)
        changed[key][k, 0, 0] = value
        if key == "D_w":
            changed["D_z"][k, 0, 0] = value
    level = 1 / margin.upper * data.draw(st.sampled_from([1 - 1e-6, 0.9, 0.3]))
    assert not proved(numbers | changed, level=level)
