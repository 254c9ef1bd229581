"""Former errors of the checker, each with the smallest claim that shows it."""

import numpy as np
import verify_cases as cases

from robustlab.verification import Outcome, check

ONE, ZERO = np.ones((1, 1)), np.zeros((1, 1))
LAG = {"A": -ONE, "B": ONE, "C": ONE, "D": ZERO, "dt": np.array(0.0)}
STATIC = {"K_A": np.zeros((0, 0)), "K_B": np.zeros((0, 1)), "K_C": np.zeros((1, 0))}
CHANNELS = {"n_meas": np.array(1), "n_con": np.array(1), "dt": np.array(0.0)}
SCALINGS = {"D_w": ONE[None], "D_z": ONE[None], "G": ZERO[None]}


def arrays(**numbers):
    return {name: np.array(value) for name, value in numbers.items()}


def test_a_ball_around_zero_is_not_a_zero_direct_term():
    # D = -1 + (1 + e)(1 - e) = -2^-104 is less than the radius of the balls, and makes the H2 norm infinite.
    e = 2.0**-52
    loop = arrays(
        P_A=-ONE, P_B=[[1.0, 0.0]], P_C=[[1.0], [0.0]], P_D=[[-1.0, 1 + e], [1.0, 0.0]], K_D=[[1 - e]], P=ONE, value=1.1
    )
    assert cases.outcome("gramian", loop, STATIC, CHANNELS) == "refuted"
    loop["P_D"][0, 1] = 0.0
    assert cases.outcome("gramian", loop | {"P_D": loop["P_D"] * [[0, 1], [1, 1]]}, STATIC, CHANNELS) == "proved"


def test_a_claim_about_all_frequencies_is_not_proved_over_a_band():
    unstable = LAG | {"A": ONE}
    band = arrays(blocks=[[2, 1, 1]], gamma=0.2, low=[10.0], high=[20.0], band=[10.0, 20.0])
    for kind in ("worst-gain", "delayed-stable"):
        assert cases.outcome(kind, unstable, band, SCALINGS) != "proved"
        assert cases.outcome(kind, LAG, band, SCALINGS) == "not proved"


def test_a_worst_case_gain_is_that_over_the_whole_set():
    blocks = arrays(blocks=[[0, 1, 1], [2, 1, 1]], ranges=[[-1.0, 1.0], [-1.0, 1.0]], box=[[[-1.0, 1.0], [-1.0, 1.0]]])
    two = LAG | arrays(B=[[0.5, 1.0]], C=[[1.0], [1.0]], D=np.zeros((2, 2)))
    more = arrays(low=[0.0], high=[np.inf], gamma=2.5, D_w=[np.diag([1.0, 0.5])], D_z=[np.diag([1.0, 0.5])])
    more["G"] = np.zeros((1, 2, 2))
    for size, expected in ((1.0, "proved"), (1e-3, "not proved")):
        assert cases.outcome("worst-gain-boxes", two, blocks, more, size=size) == expected


def test_a_claim_is_about_one_model():
    # The loop has a gain of a half and the claim is true; A .. D are another model.
    loop = arrays(P_A=-ONE, P_B=[[1.0, 0.0]], P_C=[[0.5], [0.0]], P_D=np.zeros((2, 2)), K_D=ZERO)
    claim = arrays(blocks=[[0, 1, 1]], level=1.0, low=[0.0], high=[np.inf])
    assert cases.outcome("mu-axis", loop, STATIC, CHANNELS, claim, SCALINGS) == "proved"
    assert cases.outcome("mu-axis", loop, STATIC, CHANNELS, claim, SCALINGS, LAG) == "not proved"


def test_a_tolerance_appears_in_the_claim_of_a_set():
    exact = {x: LAG[x] for x in ("A", "dt")} | arrays(B=np.ones((1, 2)), C=np.ones((2, 1)), D=np.zeros((2, 2)))
    ends = {f"{x}{i}": LAG[x] for x in "ABCD" for i in (0, 1)} | {"A1": ZERO, "blocks": np.array([[0, 1, 1]])}
    assert "tolerance" not in check(cases.claimed("set", exact, ends)).claim
    loose = check(cases.claimed("set", exact, ends | {"A1": 9 * ONE}, tolerance=10.0))
    assert loose.outcome is Outcome.PROVED
    assert "tolerance 10" in loose.claim
