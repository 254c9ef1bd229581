import flint
import numpy as np
import pytest
import verify_cases as cases
from hypothesis import given, settings
from hypothesis import strategies as st

from robustlab.verification import Claim, Outcome, check


def test_a_first_order_lag_has_its_closed_form():
    one = np.ones((1, 1))
    G = {"A": -2 * one, "B": 3 * one, "C": one, "D": 0 * one, "dt": np.array(0.0)}
    assert cases.outcome("norm", G, gamma=1.5 * (1 + 1e-9)) == "proved"
    assert cases.outcome("norm", G, gamma=1.5 * (1 - 1e-9)) == "refuted"
    answer = check(cases.claimed("norm", G, gamma=2.0))
    assert answer.claim == "the model is stable: H-infinity norm over all frequencies <= 2"
    assert (answer.bound, answer.where) == (2.0, "")
    assert answer.boxes > 0


@pytest.mark.parametrize("dt", [0.0, 0.5])
def test_evidence_proves_in_two_tests_and_a_mutant_does_not_carry_a_wrong_bound(dt):
    G = cases.model(3, 5, 2, 3, dt)
    peak = cases.norm(G)
    P = cases.bounded_real_solution(G, peak * (1 + 1e-6))
    answer = check(cases.claimed("norm", G, gamma=peak * (1 + 2e-6), P=P))
    assert (answer.outcome, answer.boxes) == (Outcome.PROVED, 1)
    assert cases.outcome("norm", G, gamma=peak * (1 - 1e-6), P=P) == "refuted"
    assert cases.outcome("norm", G, gamma=peak * (1 + 2e-6), P=-P) == "proved"  # not by P


def test_an_unstable_model_has_no_norm_however_small_its_gain():
    G = cases.model(1, 4, 2, 2)
    G["A"] = -G["A"]
    assert cases.outcome("stable", G) == "refuted"
    assert cases.outcome("norm", G, gamma=1e6) == "refuted"


@pytest.mark.parametrize("A", [[[0.0]], [[0.0, 1.0], [-1.0, 0.0]], [[0.0, 1.0], [0.0, 0.0]]])
def test_poles_on_the_axis_are_not_proved_stable(A):
    n = len(A)
    G = {"A": np.array(A), "B": np.eye(n), "C": np.eye(n), "D": np.zeros((n, n)), "dt": np.array(0.0)}
    assert cases.outcome("stable", G) == "not proved"
    assert cases.outcome("norm", G, gamma=1e9) != "proved"


def test_badly_scaled_states():
    G = cases.model(9, 6, 2, 2)
    peak = cases.norm(G)
    T = np.exp2([300, -300, 20, 0, -90, 150])
    scaled = G | {"A": G["A"] * T / T[:, None], "B": G["B"] / T[:, None], "C": G["C"] * T}
    assert cases.outcome("norm", scaled, gamma=peak * (1 - 1e-6)) != "proved"
    assert cases.outcome("norm", scaled, gamma=peak * (1 + 1e-6)) == "proved"
    P = cases.bounded_real_solution(G, peak * (1 + 1e-6)) * T * T[:, None]
    assert cases.outcome("norm", scaled, gamma=peak * (1 + 2e-6), P=P) == "proved"


def test_a_loop_and_a_difference():
    K = cases.model(5, 2, 2, 1)
    P = cases.model(6, 3, 3, 4)
    n_con, n_meas = 1, 2
    B1, B2, C1, C2 = P["B"][:, :2], P["B"][:, 2:], P["C"][:2], P["C"][2:]
    D11, D12, D21, D22 = P["D"][:2, :2], P["D"][:2, 2:], P["D"][2:, :2], P["D"][2:, 2:]
    P["A"] = P["A"] - 9 * np.eye(3)
    K["A"] = K["A"] - 9 * np.eye(2)
    F = np.linalg.inv(np.eye(n_con) - K["D"] @ D22)  # u = F (C_K x_K + D_K (C_2 x + D_21 w)), by the other inverse
    A = np.block(
        [
            [P["A"] + B2 @ F @ K["D"] @ C2, B2 @ F @ K["C"]],
            [K["B"] @ (C2 + D22 @ F @ K["D"] @ C2), K["A"] + K["B"] @ D22 @ F @ K["C"]],
        ]
    )
    B = np.vstack([B1 + B2 @ F @ K["D"] @ D21, K["B"] @ (D21 + D22 @ F @ K["D"] @ D21)])
    C = np.hstack([C1 + D12 @ F @ K["D"] @ C2, D12 @ F @ K["C"]])
    closed = {"A": A, "B": B, "C": C, "D": D11 + D12 @ F @ K["D"] @ D21, "dt": np.array(0.0)}
    peak = cases.norm(closed)
    assert np.linalg.eigvals(A).real.max() < 0
    numbers = {f"P_{x}": P[x] for x in "ABCD"} | {f"K_{x}": K[x] for x in "ABCD"}
    sizes = {"n_meas": n_meas, "n_con": n_con, "dt": 0.0}
    assert cases.outcome("loop-norm", numbers, sizes, gamma=peak * (1 + 1e-6)) == "proved"
    assert cases.outcome("loop-norm", numbers, sizes, gamma=peak * (1 - 1e-6)) == "refuted"
    evidence = cases.bounded_real_solution(closed, peak * (1 + 1e-6))
    answer = check(cases.claimed("loop-norm", numbers, sizes, gamma=peak * (1 + 2e-6), P=evidence))
    assert (answer.outcome, answer.boxes) == (Outcome.PROVED, 1)
    assert cases.outcome("loop-norm", numbers, sizes | {"n_con": 2}, gamma=1e6) == "not proved"

    G1, G2 = cases.model(7, 4, 2, 2), cases.model(8, 3, 2, 2)
    both = {f"{x}1": G1[x] for x in "ABCD"} | {f"{x}2": G2[x] for x in "ABCD"} | {"dt": 0.0}
    zero = np.zeros((4, 3))
    G = {
        "A": np.block([[G1["A"], zero], [zero.T, G2["A"]]]),
        "B": np.vstack([G1["B"], G2["B"]]),
        "C": np.hstack([G1["C"], -G2["C"]]),
        "D": G1["D"] - G2["D"],
        "dt": np.array(0.0),
    }
    peak = cases.norm(G)
    assert cases.outcome("difference-norm", both, gamma=peak * (1 + 1e-6)) == "proved"
    assert cases.outcome("difference-norm", both, gamma=peak * (1 - 1e-6)) == "refuted"


def test_a_loop_that_is_not_well_posed():
    one = np.ones((1, 1))
    P = {"P_A": -one, "P_B": np.ones((1, 2)), "P_C": np.ones((2, 1)), "P_D": np.ones((2, 2))}
    K = {"K_A": -one, "K_B": one, "K_C": one, "K_D": one}
    answer = check(cases.claimed("loop-norm", P, K, n_meas=1, n_con=1, dt=0.0, gamma=1e9))
    assert answer.outcome is Outcome.NOT_PROVED
    assert "regular" in answer.where


@pytest.mark.parametrize("dt", [0.0, 0.2])
def test_h2_norms(dt):
    from scipy.linalg import solve_continuous_lyapunov, solve_discrete_lyapunov

    G = cases.model(4, 5, 2, 3, dt)
    if not dt:
        G["D"] = np.zeros((3, 2))

    def gramian(more):
        Q = G["C"].T @ G["C"] + more * np.eye(5)
        P = solve_discrete_lyapunov(G["A"].T, Q) if dt else solve_continuous_lyapunov(G["A"].T, -Q)
        return (P + P.T) / 2

    value = np.sqrt(np.trace(G["B"].T @ gramian(0.0) @ G["B"] + G["D"].T @ G["D"]))
    P = gramian(1e-9)
    assert cases.outcome("gramian", G, P=P, value=value * (1 + 1e-6)) == "proved"
    assert cases.outcome("gramian", G, P=P, value=value * (1 - 1e-6)) == "not proved"
    assert cases.outcome("gramian", G, P=P * (1 - 1e-6), value=value * (1 - 1e-7)) == "not proved"
    if not dt:
        assert cases.outcome("gramian", G | {"D": np.full((3, 2), 5e-324)}, P=P, value=value * 2) == "refuted"


BROKEN = [
    ("no gamma", lambda g: g.pop("gamma")),
    ("NaN", lambda g: g["A"].__setitem__((0, 0), np.nan)),
    ("infinity", lambda g: g["D"].__setitem__((0, 0), np.inf)),
    ("shape", lambda g: g.update(B=g["B"].T)),
    ("vector", lambda g: g.update(A=g["A"].ravel())),
    ("type", lambda g: g.update(A=g["A"].astype(np.float32))),
    ("complex", lambda g: g.update(A=g["A"] + 0j)),
    ("negative gamma", lambda g: g.update(gamma=np.array(-1e9))),
    ("zero gamma", lambda g: g.update(gamma=np.array(0.0))),
    ("negative dt", lambda g: g.update(dt=np.array(-1.0))),
    ("P not symmetric", lambda g: g.update(P=np.triu(np.ones((3, 3))))),
    ("P of another size", lambda g: g.update(P=np.eye(2))),
    ("text", lambda g: g.update(A=np.array("A"))),
    ("ragged", lambda g: g.update(A=[[1.0], [1.0, 2.0]])),
]


@pytest.mark.parametrize("break_it", [b for _, b in BROKEN], ids=[name for name, _ in BROKEN])
def test_ill_formed_claims_are_not_proved_with_a_reason(break_it):
    numbers = cases.model(2, 3, 2, 2) | {"gamma": np.array(1e6)}
    assert check(Claim("norm", numbers)).outcome is Outcome.PROVED
    break_it(numbers)
    answer = check(Claim("norm", numbers))
    assert answer.outcome is Outcome.NOT_PROVED
    assert answer.where
    assert answer.bound is None


def test_unknown_kinds_and_the_precision_is_restored():
    before = flint.ctx.prec
    flint.ctx.prec = 77
    try:
        assert check(Claim("wishes", {})).outcome is Outcome.NOT_PROVED
        assert cases.outcome("norm", cases.model(1, 3, 1, 1), gamma=1e-3) == "refuted"
        assert flint.ctx.prec == 77
    finally:
        flint.ctx.prec = before


NUMBERS = st.floats(allow_nan=False, allow_infinity=False, width=64) | st.floats(-10, 10)


@pytest.mark.slow
@settings(max_examples=60)
@given(st.data(), st.integers(0, 5), st.booleans())
def test_no_evidence_at_all_proves_a_norm_below_the_true_one(data, seed, discrete):
    n = 2
    G = cases.model(seed, n, 1, 2, 1.0 if discrete else 0.0)
    peak = cases.norm(G, 300)
    P = cases.bounded_real_solution(G, peak * 1.0001)
    for i in range(n):
        for j in range(i + 1):
            P[i, j] = P[j, i] = data.draw(NUMBERS | st.just(float(P[i, j])))
    factor = data.draw(st.sampled_from([1 - 1e-9, 1 - 1e-6, 0.9, 0.1]))
    assert cases.outcome("norm", G, gamma=peak * factor, P=P) != "proved"
