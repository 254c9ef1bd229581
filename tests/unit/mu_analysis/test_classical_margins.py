"""Classical margins against closed forms, closed loops' eigenvalues, and crossings counted on a dense axis."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import robustlab as rl
from robustlab.statespace import StateSpaceModel

THIRD = StateSpaceModel([[0, 1, 0], [0, 0, 1], [0, -2, -3]], [[0], [0], [1]], [[3, 0, 0]], [[0]])  # 3/(s(s+1)(s+2))


def only(margins):
    (margin,) = margins.channels.values()
    return margin


def test_third_order_loop_by_hand():
    """Im L = 0 at w^2 = 2, where L = -1/2; no factor below 1 crosses."""
    margin = only(rl.classical_margins(THIRD))
    assert margin.gain_margin == pytest.approx((0.0, 2.0), rel=1e-12)
    assert margin.phase_crossings[0].frequency == pytest.approx(math.sqrt(2), rel=1e-12)
    w = margin.gain_crossings[0].frequency
    assert 3 / (w * math.hypot(1, w) * math.hypot(2, w)) == pytest.approx(1, rel=1e-12)
    lag = math.pi / 2 - math.atan(w) - math.atan(w / 2)
    assert margin.phase_margin == pytest.approx(lag, rel=1e-10)
    assert margin.delay_margin == pytest.approx(lag / w, rel=1e-10)


def test_the_delay_margin_is_zero_for_direct_terms_of_one_and_more():
    loop = StateSpaceModel([[-1.0]], [[1.0]], [[1.0]], [[1.5]])
    margin = only(rl.classical_margins(loop))
    assert margin.stable
    assert margin.delay_margin == 0.0


def test_an_unstable_loop_has_crossings_and_no_margins():
    margin = only(rl.classical_margins(3 * THIRD))
    assert not margin.stable
    assert margin.gain_margin is None
    assert margin.phase_crossings[0].factor == pytest.approx(2 / 3)
    assert "unstable" in margin.summary()


@settings(max_examples=30)
@given(st.integers(0, 10**6))
def test_crossings_and_ends_of_random_loops(seed):
    """Closed loops over a sweep of gains; sign changes of |L| - 1 and of Im L over a dense axis."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 7))
    A = rng.normal(size=(n, n))
    A -= (np.linalg.eigvals(A).real.max() + rng.choice([0.05, 0.3, -0.2])) * np.eye(n)
    L = StateSpaceModel(A, rng.normal(size=(n, 1)), 3 * rng.normal(size=(1, n)), [[rng.choice([0, 0.3, -0.4])]])
    margin = only(rl.classical_margins(L))
    assert margin.status == "converged"
    w = np.geomspace(1e-3, 1e3, 40_001)
    response = rl.frequency_response(L, w)[:, 0, 0]
    low, high = response[:-1], response[1:]
    assert len(margin.gain_crossings) >= np.sum((np.abs(low) - 1) * (np.abs(high) - 1) < 0)
    negative = ((low.imag * high.imag) < 0) & (low.real < 0)
    assert sum(0 < c.frequency < np.inf for c in margin.phase_crossings) >= negative.sum()
    for crossing in margin.gain_crossings:
        value = rl.frequency_response(L, [crossing.frequency])[0, 0, 0]
        assert abs(value * np.exp(-1j * crossing.lag) + 1) < 1e-6
    if not margin.stable:
        return
    d = float(L.D[0, 0])
    for share in (0.05, 0.5, 0.95):
        for end in margin.gain_margin:
            factor = min(max(end, 1e-3), 1e3) ** share
            closed = L.A - L.B @ L.C * factor / (1 + factor * d)
            assert np.linalg.eigvals(closed).real.max() < 1e-9


def test_discrete_loop_against_its_own_eigenvalues():
    """0.5 / (z - 1) with a delay of two samples more: z^2 (z - 1) + k/2 has roots on the circle at k = 2 g."""
    A = np.array([[1.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    L = StateSpaceModel(A, [[1.0], [0], [0]], [[0, 0, 0.5]], [[0.0]], dt=0.1)
    margin = only(rl.classical_margins(L))
    high = margin.gain_margin[1]
    assert np.abs(np.roots([1, -1, 0, 0.5 * high])).max() == pytest.approx(1, abs=1e-10)
    golden = 2 * math.sin(math.pi / 10)  # |e^jw - 1| at w = pi/5, where 2 w + (w + pi)/2 = pi
    assert high == pytest.approx(golden / 0.5, rel=1e-9)
    assert margin.phase_crossings[0].frequency == pytest.approx(math.pi / 5 / 0.1, rel=1e-9)


def test_loops_of_several_channels_are_opened_one_at_a_time():
    """A triangular loop has the margins of its diagonal; a coupled one has others than its elements'."""
    diagonal = rl.StateSpaceModel(
        np.diag([-1.0, -2.0]), np.eye(2), [[4.0, 0.0], [7.0, 6.0]], np.zeros((2, 2)), outputs=["a", "b"]
    )
    found = rl.classical_margins(diagonal)
    assert list(found.channels) == ["a", "b"]
    one = only(rl.classical_margins(StateSpaceModel([[-1.0]], [[1.0]], [[4.0]], [[0.0]])))
    assert found.channels["a"].phase_margin == pytest.approx(one.phase_margin, rel=1e-9)
    # The spinning body: each loop alone has an infinite gain margin (Doyle).
    a = 10.0
    body = StateSpaceModel([[0, a], [-a, 0]], np.eye(2), [[1, a], [-a, 1]], np.zeros((2, 2)))
    for margin in rl.classical_margins(body).channels.values():
        assert margin.gain_margin[1] == math.inf
        assert margin.phase_margin == pytest.approx(math.pi / 2, rel=1e-6)
    assert rl.disk_margin(body).simultaneous.upper < 0.25


# --- independence of scaling -----------------------------------------------------------------------------------------


def test_crossings_of_a_nonnormal_loop():
    """A fourfold pole with large couplings, solved in 60 digits; a former version found no crossing."""
    A = [
        [-0.017050268598, -2.359835967076, 12.766265862204, 4.041559199822],
        [0, -0.017050268598, -10.299617301744, 1.046568025252],
        [0, 0, -0.017050268598, -0.45023573155],
        [0, 0, 0, -0.017050268598],
    ]
    b = np.array([[0.5937480717858228, 0.8911669542823284, 0.3208483045665637, -0.818230227390307]]).T
    c = [[174.53434346100428, 211.23656781974444, 4381.370520512116, 2024.5147755052005]]
    margin = only(rl.classical_margins(StateSpaceModel(A, b, c, [[0]])))
    assert margin.status == "converged"
    assert [x.frequency for x in margin.gain_crossings] == [pytest.approx(41.90081, rel=1e-6)]
    assert margin.phase_margin == pytest.approx(1.279467, rel=1e-6)
    assert margin.delay_margin == pytest.approx(0.0305356, rel=1e-5)
    exact = only(rl.classical_margins(rl.DelayedModel(StateSpaceModel(A, b, c, [[0]]), [])))
    assert margin.phase_margin == pytest.approx(exact.phase_margin, rel=1e-9)


@pytest.mark.parametrize("S", [1.0, 1e4, 1e8])
def test_crossings_of_a_chain_of_any_gains_equal_the_closed_form(S):
    """k (1 + 3 t + 3 t^2)/t^3 with t = s/S: with k = 1 the closed loop's poles are those of (1 + t)^3."""
    A, B = S * np.eye(3, k=1), np.array([[0.0], [0.0], [1.0]])
    margin = only(rl.classical_margins(StateSpaceModel(A, B, [[S, 3 * S, 3 * S]], [[0.0]])))
    x = np.roots([1, -9, -3, -1])  # w^6 = (1 - 3 w^2)^2 + 9 w^2
    w = math.sqrt(x[np.abs(x.imag) < 1e-12].real.max())
    assert [c.frequency for c in margin.gain_crossings] == [pytest.approx(w * S, rel=1e-13)]
    lag = math.atan2(3 * w, 1 - 3 * w * w) - 1.5 * math.pi + math.pi
    assert margin.phase_margin == pytest.approx(lag, rel=1e-12)
    # t^3 + 3 k t^2 + 3 k t + k: stable for 9 k^2 > k
    assert margin.gain_margin == (pytest.approx(1 / 9, rel=1e-14), math.inf)
    assert margin.status == "converged"


@pytest.mark.parametrize("damping", [1e-3, 1e-9])
def test_a_light_resonance_crosses_twice(damping):
    """|L| = 1 on both sides of the peak of 0.3/(s^2 + 2 d s + 1): (1 - x)^2 + 4 d^2 x = 0.09."""
    L = StateSpaceModel([[0, 1], [-1, -2 * damping]], [[0], [1]], [[0.3, 0]], [[0]])
    margin = only(rl.classical_margins(L))
    x = np.sort(np.roots([1, 4 * damping**2 - 2, 1 - 0.09]).real)
    assert [c.frequency for c in margin.gain_crossings] == pytest.approx(np.sqrt(x).tolist(), rel=1e-12)
    assert margin.phase_margin == pytest.approx(2 * damping * math.sqrt(x[1]) / 0.3, rel=1e-5)


def test_hidden_modes_are_no_crossings():
    """A hidden stable mode, and one of the other loop: the common factors cancel exactly."""
    A = np.diag([-1.0, -2.0, -3.0])
    hidden = StateSpaceModel(A, [[1.0], [0.0], [1.0]], [[4.0, 1.0, 0.0]], [[0.0]])
    one = only(rl.classical_margins(StateSpaceModel([[-1.0]], [[1.0]], [[4.0]], [[0.0]])))
    assert only(rl.classical_margins(hidden)).to_json() == one.to_json()


def test_a_gain_that_only_touches_one_counts():
    """|L| is 1 - 1e-12 at its peak: counts as a crossing; 1 - 1e-6 does not."""
    d = 0.1
    peak = 1 / (2 * d * math.sqrt(1 - d * d))
    L = StateSpaceModel([[0, 1], [-1, -2 * d]], [[0], [1]], [[(1 - 1e-12) / peak, 0]], [[0]])
    margin = only(rl.classical_margins(L))
    assert len(margin.gain_crossings) == 1
    assert margin.phase_margin == pytest.approx(math.pi - math.atan2(math.sqrt(1 - 2 * d * d), d), rel=1e-5)
    quiet = StateSpaceModel(L.A, L.B, (1 - 1e-6) * L.C, L.D)
    assert only(rl.classical_margins(quiet)).phase_margin == math.inf


def test_the_text_begins_with_the_three_margins():
    """L = 2 / (s (s + 1)): |L| = 1 at w^2 = (sqrt(17) - 1) / 2, the phase there is -90 - atan(w) degrees."""
    printed = repr(rl.classical_margins(rl.tf([1], [1, 1, 0]), rl.ss([[2.0]])))
    w = np.sqrt((np.sqrt(17) - 1) / 2)
    phase = np.pi / 2 - np.arctan(w)
    assert "gain margin: factors 0 .. inf" in printed
    assert f"phase margin: {np.degrees(phase):.4g} degrees" in printed
    assert f"delay margin: {phase / w:.4g} s" in printed
