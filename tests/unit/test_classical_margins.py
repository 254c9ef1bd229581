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


def test_a_loop_that_needs_gain_has_a_lower_end():
    """k / (s - 1) is stable for k > 1; with k = 4: |L| = 1 at sqrt(15)."""
    margin = only(rl.classical_margins(StateSpaceModel([[1.0]], [[1.0]], [[4.0]], [[0.0]])))
    assert margin.gain_margin == pytest.approx((0.25, math.inf))
    assert margin.gain_crossings[0].frequency == pytest.approx(math.sqrt(15))
    assert margin.delay_margin == pytest.approx(math.acos(0.25) / math.sqrt(15))  # e^-jwT 4/(jw - 1) = -1


def test_positive_feedback_is_negative_feedback_of_the_negative():
    one = only(rl.classical_margins(THIRD))
    other = only(rl.classical_margins(-1 * THIRD, sign=1))
    assert one.gain_margin == pytest.approx(other.gain_margin, rel=1e-12)
    assert (one.phase_margin, one.delay_margin) == pytest.approx((other.phase_margin, other.delay_margin), rel=1e-12)
    assert one.status is other.status


def test_direct_terms_of_one_and_more_stand_no_delay():
    loop = StateSpaceModel([[-1.0]], [[1.0]], [[1.0]], [[1.5]])
    margin = only(rl.classical_margins(loop))
    assert margin.stable
    assert margin.delay_margin == 0.0


def test_static_loops_and_loops_below_one():
    margin = only(rl.classical_margins(StateSpaceModel([], [], [], [[-0.5]])))
    assert margin.gain_margin == (0.0, 2.0)
    assert margin.phase_margin == math.inf
    quiet = only(rl.classical_margins(StateSpaceModel([[-1.0]], [[1.0]], [[0.5]], [[0.0]])))
    assert (quiet.gain_margin, quiet.phase_margin, quiet.delay_margin) == ((0.0, math.inf), math.inf, math.inf)


def test_an_unstable_loop_has_crossings_and_no_margins():
    margin = only(rl.classical_margins(3 * THIRD))
    assert not margin.stable
    assert margin.gain_margin is None
    assert margin.phase_crossings[0].factor == pytest.approx(2 / 3)
    assert "unstable" in margin.summary()


def test_a_gain_of_one_everywhere_is_refused():
    allpass = StateSpaceModel([[-1.0]], [[1.0]], [[-2.0]], [[1.0]])
    with pytest.raises(rl.NoTrustworthyNumber, match="gain is 1 at every frequency"):
        rl.classical_margins(allpass)


@settings(max_examples=30, deadline=None)
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
    # The spinning body: each loop alone looks perfect, with infinite gain margins (Doyle).
    a = 10.0
    body = StateSpaceModel([[0, a], [-a, 0]], np.eye(2), [[1, a], [-a, 1]], np.zeros((2, 2)))
    for margin in rl.classical_margins(body).channels.values():
        assert margin.gain_margin[1] == math.inf
        assert margin.phase_margin == pytest.approx(math.pi / 2, rel=1e-6)
    assert rl.disk_margin(body).simultaneous.upper < 0.25
