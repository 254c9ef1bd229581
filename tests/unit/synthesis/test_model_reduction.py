"""Reduction of models: closed forms, published Hankel values, modes kept apart, weights, bad requests, edge sizes."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.linalg import block_diag
from slicot_examples import model_of_ab09ad

import robustlab as rl
from robustlab.result import Status


def stable_model(n: int, seed: int, dt: float = 0.0, m: int = 2, p: int = 3) -> rl.StateSpaceModel:
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(n, n))
    poles = np.linalg.eigvals(A) if n else np.zeros(1)
    A = A / np.abs(poles).max() * 0.9 if dt else A - (poles.real.max() + 0.3) * np.eye(n)
    return rl.StateSpaceModel(A, rng.normal(size=(n, m)), rng.normal(size=(p, n)), rng.normal(size=(p, m)), dt)


def difference_on_grid(one, two, omega):
    gap = rl.frequency_response(one, omega) - rl.frequency_response(two, omega)
    return np.linalg.norm(gap, 2, axis=(1, 2)).max()


def test_hankel_values_of_slicots_documented_example():
    # The example in the documentation of AB09AD (SLICOT 5.0): its Hankel singular values, printed to four digits.
    values = rl.reduce_model(model_of_ab09ad(), 5).hankel
    np.testing.assert_allclose(values, [2.5139, 2.0846, 1.9178, 0.7666, 0.5473, 0.0253, 0.0246], atol=6e-5)


def test_truncation_of_two_states_by_hand():
    # a balanced model: A_ij = -b_i b_j / (s_i + s_j) solves A S + S A^T + B B^T = 0 with S = diag(s), and C = B^T.
    sigma, b = np.array([2.0, 0.1]), np.array([1.0, 0.5])
    G = rl.StateSpaceModel(-np.outer(b, b) / np.add.outer(sigma, sigma), b[:, None], b[None], [[0.0]])
    found = rl.reduce_model(G, 1)
    np.testing.assert_allclose(found.hankel, sigma, rtol=1e-12)
    np.testing.assert_allclose(found.model.poles(), [-0.25], rtol=1e-10)  # -b1^2 / (2 s1)
    assert found.promised == pytest.approx(0.2, rel=1e-12)
    assert found.bound == max(found.promised, found.error.upper)
    assert found.error.upper == pytest.approx(0.2, rel=1e-5)  # the last value left out alone: the bound is attained


@pytest.mark.parametrize("dt", [0.0, 0.1])
def test_modes_that_are_not_stable_are_kept(dt):
    G = stable_model(6, 2, dt, 1, 1)
    unstable = np.array([[0.3, 2.0], [-2.0, 0.3]]) if not dt else np.array([[1.1]])
    integrator = np.array([[1.0 if dt else 0.0]])
    A = np.block([
        [G.A, np.ones((6, len(unstable))), np.zeros((6, 1))],
        [np.zeros((len(unstable), 6)), unstable, np.ones((len(unstable), 1))],
        [np.zeros((1, 6 + len(unstable))), integrator],
    ])  # fmt: skip
    n = len(A)
    full = rl.StateSpaceModel(A, np.ones((n, 1)), np.ones((1, n)), [[0.5]], dt)
    found = rl.reduce_model(full, n - 3)
    assert found.n_apart == len(unstable) + 1
    kept = np.concatenate([np.linalg.eigvals(unstable), integrator[0]])
    for pole in kept:
        assert np.abs(found.model.poles() - pole).min() < 1e-7
    omega = np.linspace(0.3, 9, 50)
    assert difference_on_grid(full, found.model, omega) <= found.error.upper * (1 + 1e-6)
    assert found.status is Status.CERTIFIED
    with pytest.raises(rl.InputError, match="not stable and are kept apart"):
        rl.reduce_model(full, found.n_apart - 1)


@pytest.mark.parametrize("dt", [0.0, 0.1])
def test_coprime_factors_reduce_unstable_modes_and_bound_the_gap(dt):
    from robustlab import nu_gap

    rng = np.random.default_rng(4)
    A = rng.normal(size=(7, 7))
    A = A / np.abs(np.linalg.eigvals(A)).max() * 1.2 if dt else A
    full = rl.StateSpaceModel(A, rng.normal(size=(7, 2)), rng.normal(size=(2, 7)), np.zeros((2, 2)), dt)
    assert not full.is_stable()
    found = rl.reduce_model(full, 5, method="coprime")
    assert found.order == 5
    assert found.status is Status.CERTIFIED
    assert found.error.upper <= found.bound * (1 + 1e-6)
    # Vinnicombe 2001: the nu-gap is at most the norm of a change of the normalised right factors.
    assert nu_gap(full, found.model).lower <= found.error.upper * (1 + 1e-6)
    unstable = [np.abs(m.poles()).max() > 1 if dt else m.poles().real.max() > 0 for m in (full, found.model)]
    assert unstable == [True, True]


def test_the_lowest_order_within_the_tolerance_is_chosen():
    G = stable_model(9, 11)
    errors = [rl.reduce_model(G, r).error.upper for r in range(9)]
    tolerance = 0.5 * (errors[4] + errors[3])
    found = rl.reduce_model(G, tolerance=tolerance)
    assert found.order == min(r for r in range(9) if errors[r] <= tolerance)
    assert found.error.upper <= tolerance


@pytest.mark.parametrize("n_u", [0, 1, 2])
@pytest.mark.parametrize("method", ["truncation", "residualisation"])
def test_sizes_at_the_edge(n_u, method):
    static = rl.StateSpaceModel(np.zeros((0, 0)), np.zeros((0, n_u)), np.zeros((1, 0)), np.ones((1, n_u)))
    assert rl.reduce_model(static, 0, method=method).order == 0
    deaf = rl.StateSpaceModel([[-1.0]], np.zeros((1, n_u)), [[1.0]], np.ones((1, n_u)))
    found = rl.reduce_model(deaf, 1, method=method)
    assert found.order == 0
    assert found.error.upper == pytest.approx(0.0, abs=1e-12)


# --- least order --------------------

COPIED = rl.StateSpaceModel(  # [1/(s-1); 1/((s-1)(s+2))] with the unstable pole twice
    [[1, 0, 0], [0, -1, 2], [0, 1, 0]], [[1], [1], [0]], [[1, 0, 0], [0, 0, 1]], [[0], [0]], states=["p", "q", "r"]
)


def test_a_minimal_model_is_exact_if_the_cancellation_is():
    found = rl.minimal(COPIED)
    assert (found.order, found.error.upper, found.status.value) == (2, 0.0, "certified")
    assert found.removed == ("unstable mode 1 rad/s in p, q, r: no input moves it",)
    assert_allclose(found.model(2j), COPIED(2j), rtol=1e-14)
    assert rl.minimal(found).order == 2
    static = rl.minimal(rl.ss([[2.0, 1.0]]))
    assert (static.order, static.error.upper) == (0, 0.0)
    assert (
        rl.minimal(rl.StateSpaceModel(np.zeros((0, 0)), np.zeros((0, 0)), np.zeros((0, 0)), np.zeros((0, 0)))).order
        == 0
    )


@pytest.mark.parametrize("method", ["truncation", "coprime"])
def test_reduction_is_exact_where_an_exact_model_of_that_order_exists(method):
    found = rl.reduce_model(COPIED, 2, method=method)  # truncation kept both copies, and an error of 1/6
    assert found.order == 2
    assert found.error.upper < 1e-12
    assert found.removed == ("unstable mode 1 rad/s in p, q, r: no input moves it",)
    assert_allclose(found.model(2j), COPIED(2j), rtol=1e-12)


@pytest.mark.parametrize("dt", [0.0, 0.1])
@pytest.mark.parametrize("seed", range(4))
def test_hidden_modes_in_mixed_states_are_found(seed, dt):
    rng = np.random.default_rng(seed)
    poles = [1.0, 1.0, 1.0, -1.0, 0.5, 2.0] if dt else [0.0, 0.0, 0.0, 1.0, -1.0, -3.0]
    A = np.diag(poles) + np.diag([1.0, 0, 0, 0, 0], 1)
    # One of two Jordan blocks of the first pole without input, the last pole without output.
    B, C = rng.normal(size=(6, 2)), rng.normal(size=(2, 6))
    B[2], C[:, 5] = 0.0, 0.0
    T, units = np.linalg.qr(rng.normal(size=(6, 6)))[0], 10.0 ** rng.integers(-6, 7, 6)
    T, back = units[:, None] * T, T.T / units
    G = rl.StateSpaceModel(T @ A @ back, T @ B, C @ back, np.eye(2), dt)
    found = rl.minimal(G)
    assert found.order == 4
    assert len(found.removed) == 2
    for s in np.exp([0.4j, 1j]) if dt else (2 + 1j, 0.5j):
        wanted = C @ np.linalg.solve(s * np.eye(6) - A, B) + np.eye(2)
        assert_allclose(found.model(s), wanted, rtol=1e-9)


# --- other methods: published examples and closed forms ---------------------------------------------------------------


def lag(pole: float, gain: float) -> rl.StateSpaceModel:
    return rl.StateSpaceModel([[-pole]], [[1.0]], [[gain]], [[0.0]])


# --- Hankel norm -----------------------------------------------------------------------------------------------------


def test_the_nearest_constant_of_a_lag_in_closed_form():
    # 6 / (s + 2) has the Hankel value 1.5, and 6 / (s + 2) - 1.5 = 1.5 (2 - s) / (s + 2) is all-pass.
    found = rl.reduce_model(lag(2.0, 6.0), 0, method="hankel")
    np.testing.assert_allclose(found.model.D, [[1.5]], rtol=1e-12)
    assert 1.5 <= found.bound <= 1.5 * (1 + 2e-6)  # not below the proved error
    assert found.error.upper == pytest.approx(1.5, rel=1e-5)
    assert found.status is Status.CERTIFIED


def test_slicots_published_hankel_norm_approximation():
    found = rl.reduce_model(model_of_ab09ad(), 5, method="hankel")
    first = [[-0.5038, -5.3070, -3.2250], [1.8355, -0.5038, -2.6289], [0, 0, -1.5171]]
    A = block_diag(first, [[-1.2925, -9.0718], [0.5047, -1.2925]])
    B = [[-1.5343, 1.5343], [-0.3614, 0.3614], [-1.1096, 1.1096], [-4.5325, -4.5325], [-0.7396, -0.7396]]
    C = [
        [1.8971, -0.3055, -2.1124, 0.4421, -2.1023],
        [-0.0394, 1.1112, -0.3119, 0, 0],
        [-1.8971, 0.3055, 2.1124, 0.4421, -2.1023],
    ]
    theirs = rl.StateSpaceModel(A, B, C, np.zeros((3, 2)))
    ours = rl.StateSpaceModel(found.model.A, found.model.B, found.model.C, np.zeros((3, 2)))
    assert difference_on_grid(ours, theirs, [0.0, 0.5, 1.0, 3.0, 10.0]) < 4e-4  # printed to four digits
    # Their direct term is that of the dilation; ours replaces the unstable modes too, which halves the bound.
    assert found.error.upper <= found.bound * (1 + 1e-6)
    assert found.bound == pytest.approx(found.hankel[5:].sum())


@pytest.mark.parametrize("method", ["hankel", "stochastic"])
@pytest.mark.parametrize("dt", [0.0, 0.1])
def test_unstable_modes_are_kept_and_the_rest_is_minimal(method, dt):
    G = stable_model(4, 2, dt, 1, 1)
    twice = rl.StateSpaceModel(
        block_diag(G.A, G.A, 1.3), np.vstack([G.B, G.B, [[1.0]]]), np.hstack([G.C / 2, G.C / 2, [[1.0]]]), G.D, dt
    )
    kept = rl.reduce_model(twice, 9, method=method)
    assert (kept.order, kept.n_apart) == (5, 1)
    omega = np.linspace(0.2, 9.0, 30)
    assert difference_on_grid(twice, kept.model, omega) < 1e-7
    small = rl.reduce_model(twice, 3, method=method)
    assert small.status is Status.CERTIFIED
    assert np.abs(small.model.poles() - 1.3).min() < 1e-7


# --- relative error --------------------------------------------------------------------------------------------------


def test_slicots_published_stochastic_hankel_values():
    found = rl.reduce_model(model_of_ab09ad(), 5, method="stochastic", floor=1.0)
    np.testing.assert_allclose(found.hankel, [0.8803, 0.8506, 0.8038, 0.4494, 0.3973, 0.0214, 0.0209], atol=6e-5)
    theirs = np.linalg.eigvals([
        [1.2729, 0.0000, 6.5947, 0.0000, -3.4229], [0.0000, 0.8169, 0.0000, 2.4821, 0.0000],
        [-2.9889, 0.0000, -2.9028, 0.0000, -0.3692], [0.0000, -3.3921, 0.0000, -3.1126, 0.0000],
        [-1.4767, 0.0000, -2.0339, 0.0000, -0.6107],
    ])  # fmt: skip
    np.testing.assert_allclose(np.sort_complex(found.model.poles()), np.sort_complex(theirs), atol=2e-4)


@pytest.mark.parametrize("seed", range(4))
def test_the_relative_error_is_within_the_bound_of_the_values_left_out(seed):
    G = stable_model(6, seed, m=2, p=2)
    found = rl.reduce_model(G, 4, method="stochastic")
    assert found.status is Status.CERTIFIED
    mu = found.hankel[4:]
    relative = rl.peak_gain(G.inverse() @ (G - found.model), norm="linf")
    assert relative.lower <= np.prod((1 + mu) / (1 - mu)) - 1


def test_a_right_half_plane_zero_is_kept():
    # (s - 1)(s + 3) / ((s + 2)(s + 5)): one value is 1, the phase of the zero.
    A, B = [[-7.0, -10.0], [1.0, 0.0]], [[1.0], [0.0]]
    G = rl.StateSpaceModel(A, B, [[-5.0, -13.0]], [[1.0]])
    found = rl.reduce_model(G, 1, method="stochastic")
    assert found.hankel[0] == pytest.approx(1.0, abs=1e-9)
    np.testing.assert_allclose(rl.zeros(found.model).values.real, [1.0], rtol=1e-6)  # the zero is unchanged


def test_a_floor_helps_a_model_whose_gain_vanishes():
    washout = rl.StateSpaceModel([[-1.0]], [[1.0]], [[-1.0]], [[1.0]])  # s / (s + 1)
    assert rl.reduce_model(washout, 0, method="stochastic", floor=0.1).status is Status.CERTIFIED


# --- what splitting a model costs -------------------------------------------------------------------------------------


def mixed(apart, gain, seed=0, dt=0.0):
    """Three stable modes and others of this gain, in states mixed by a random matrix."""
    rng = np.random.default_rng(seed)
    A = block_diag([[-1.0]], [[-0.2, 3.0], [-3.0, -0.2]], apart)
    if dt:
        A = block_diag(np.diag([0.3, -0.5, 0.8]), apart)
    n = len(A)
    B, C, T = rng.normal(size=(n, 1)), rng.normal(size=(1, n)), rng.normal(size=(n, n))
    B[3:] *= np.sqrt(gain)
    C[:, 3:] *= np.sqrt(gain)
    return rl.StateSpaceModel(T @ A @ np.linalg.inv(T), T @ B, C @ np.linalg.inv(T), [[0.0]], dt)


def test_no_error_is_exceeded_where_modes_on_the_boundary_have_huge_gains():
    # Judged in balls of 60 digits, also near the poles, by code independent of the package.
    pytest.importorskip("flint")
    from reduction_attack import run

    rows = [run(seed) for seed in range(24)]
    good = [row for row in rows if row["status"] == "certified"]
    assert len(good) >= 12
    assert sum(row["left_out"] > 0 for row in good) >= 5
    assert not [row["words"] for row in good if row["false"]]


def test_a_peak_that_is_a_millionth_of_what_cancels_in_it_is_not_missed():
    # The eigenvalues of the Hamiltonian miss it: the certified error was 7e-4 too low near a resonance.
    pytest.importorskip("flint")
    from reduction_attack import run

    row = run(697)
    assert row["status"] == "certified"
    assert not row["false"]


def test_an_unstable_mode_of_huge_gain_adds_what_its_rounding_may_be():
    quiet, loud = (rl.reduce_model(mixed([[0.5]], gain), 3) for gain in (1.0, 1e14))
    assert quiet.status is loud.status is Status.CERTIFIED
    assert quiet.left_out == loud.left_out == ()
    assert quiet.error.upper <= quiet.bound * (1 + 1e-2)
    # 1e14 times rounding is a relevant part of the error, and the bracket contains it.
    assert loud.error.upper - loud.error.lower > 1e-4 * loud.error.upper
    assert quiet.error.lower <= loud.error.upper


@pytest.mark.parametrize(("apart", "dt", "centre"), [
    ([[0.0]], 0.0, 0.0),
    ([[0.0, 2.0], [-2.0, 0.0]], 0.0, 2.0),
    ([[1.0]], 0.1, 0.0),
    ([[np.cos(0.2), np.sin(0.2)], [-np.sin(0.2), np.cos(0.2)]], 0.1, 2.0),
])  # fmt: skip
def test_around_a_mode_on_the_boundary_nothing_is_proved_and_this_is_said(apart, dt, centre):
    found = rl.reduce_model(mixed(apart, 1.0, 1, dt), len(apart) + 1)
    assert found.status is Status.CERTIFIED
    ((low, high),) = found.left_out
    assert low <= centre <= high
    assert high - low < 1e-4
    assert dict(found.facts())["not proved at"]
    assert found.error.upper <= found.bound * (1 + 2e-3)


def test_what_is_not_rounded_is_proved_everywhere():
    # Parts that are apart already, and some that come apart exactly in binary numbers.
    apart = rl.StateSpaceModel(np.diag([-1.0, -50.0, 0.0]), np.ones((3, 1)), np.ones((1, 3)), [[0.0]])
    upper = rl.StateSpaceModel([[-1.0, 2.0], [0.0, 0.0]], [[3.0], [1.0]], [[1.0, 0.0]], [[0.0]])
    for model, order in ((apart, 2), (upper, 1)):
        found = rl.reduce_model(model, order)
        assert (found.status, found.left_out) == (Status.CERTIFIED, ())
    # A model without stable modes comes back as it is.
    kept = rl.reduce_model(rl.StateSpaceModel(np.diag([1.0, 2.0]), [[1.0], [1e9]], [[1.0, 0.1]], [[0.0]]), 2)
    assert np.array_equal(kept.model.A, np.diag([1.0, 2.0]))
    assert kept.error.upper == 0.0
    # Two copies of an unstable mode are one.
    one = rl.reduce_model(rl.StateSpaceModel(np.eye(2), [[1.0], [1e9]], [[1.0, 0.1]], [[0.0]]), 2)
    assert (one.model.A.tolist(), one.left_out, one.status) == ([[1.0]], (), Status.CERTIFIED)
    assert one.error.upper <= 1e-15 * (1 + 1e8)
