"""Zeros of models, against closed forms, the pencil itself, and models of given zeros."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import robustlab as rl
from robustlab.statespace import StateSpaceModel, series


def random_model(seed, n=4, m=2, p=2, direct=False):
    rng = np.random.default_rng(seed)
    D = rng.normal(size=(p, m)) if direct else np.zeros((p, m))
    return StateSpaceModel(rng.normal(size=(n, n)), rng.normal(size=(n, m)), rng.normal(size=(p, n)), D)


def pencil(model, s):
    return np.block([[model.A - s * np.eye(model.n_states), model.B], [model.C, model.D]])


def matched(found, wanted):
    """Return the largest distance of two sets of numbers, each to its nearest partner."""
    found, rest, worst = list(found), list(wanted), 0.0
    assert len(found) == len(rest)
    for z in found:
        k = int(np.argmin([abs(z - w) for w in rest]))
        worst = max(worst, abs(z - rest.pop(k)))
    return worst


@settings(max_examples=40)
@given(st.integers(0, 10**6), st.integers(1, 8), st.integers(1, 3), st.booleans())
def test_zeros_of_square_models_make_the_pencil_singular(seed, n, m, direct):
    G = random_model(seed, n, m, m, direct)
    found = rl.zeros(G)
    assert found.status == "converged"
    assert found.normal_rank == m or n < m
    for z in found.values:
        P = pencil(G, z)
        assert np.linalg.svd(P, compute_uv=False)[-1] <= 1e-8 * np.linalg.norm(P, 2)


def test_zeros_of_a_factor_in_series_are_found_in_any_shape():
    factor = StateSpaceModel([[-2.0]], [[1.0]], [[-4.0]], [[1.0]])  # (s - 2)/(s + 2)
    wide = series(random_model(3, 3, 3, 1), factor)
    tall = series(factor, random_model(4, 3, 1, 3))
    for model in (wide, tall):
        found = rl.zeros(model)
        assert matched(found.values, [2.0]) < 1e-8
        assert found.kinds == ("transmission",)


def test_a_double_zero_and_zeros_far_apart():
    A = np.diag([1.0, -3.0, -4.0])
    twice = StateSpaceModel(A, np.ones((3, 1)), [[1 / 20, -25 / 4, 36 / 5]], [[0.0]])  # (s - 2)^2 / ...
    assert matched(rl.zeros(twice).values, [2.0, 2.0]) < 1e-6
    poles = np.array([-1.0, -1e4, -1e8])
    at = np.array([-1e-3, -1e6])
    residues = [np.prod(p - at) / np.prod(p - np.delete(poles, k)) for k, p in enumerate(poles)]
    spread = StateSpaceModel(np.diag(poles), np.ones((3, 1)), [residues], [[0.0]])
    found = np.sort(rl.zeros(spread).values.real)
    np.testing.assert_allclose(found, [-1e6, -1e-3], rtol=1e-5)


def test_kinds_of_hidden_modes():
    """Poles -1 (controllable and observable), -2 (observable), -3 (controllable), -4 (neither)."""
    A = np.diag([-1.0, -2.0, -3.0, -4.0])
    model = StateSpaceModel(A, [[1.0], [0.0], [1.0], [0.0]], [[1.0, 1.0, 0.0, 0.0]], [[0.0]])
    found = rl.zeros(model)
    kinds = dict(zip(found.values.real.round(9), found.kinds, strict=True))
    assert kinds == {-2.0: "input-decoupling", -3.0: "output-decoupling", -4.0: "input-output-decoupling"}


def test_units_and_time_scale_change_nothing():
    G = random_model(5, 5, 2, 2)
    scale = 10.0 ** np.array([6, -4, 0, 3, -7])
    scaled = StateSpaceModel(1e5 * G.A * scale[:, None] / scale, G.B * scale[:, None] * 1e-3, 1e9 * G.C / scale, G.D)
    assert matched(rl.zeros(scaled).values / 1e5, rl.zeros(G).values) < 1e-7


def test_edges():
    assert len(rl.zeros(StateSpaceModel([], [], [], [[1.0, 2.0]]))) == 0
    assert rl.zeros(StateSpaceModel([], [], [], [[1.0, 2.0], [2.0, 4.0]])).normal_rank == 1
    nothing = StateSpaceModel([[-1.0]], [[0.0]], [[0.0]], [[0.0]])
    found = rl.zeros(nothing)
    assert (found.normal_rank, found.kinds) == (0, ("input-output-decoupling",))
    assert "none" in repr(rl.zeros(StateSpaceModel([[-1.0]], [[1.0]], [[1.0]], [[0.0]])))
    with pytest.raises(rl.InputError, match="zeros"):
        rl.zeros("a model")
    with pytest.raises(rl.NoTrustworthyNumber, match="other units"):
        rl.zeros(StateSpaceModel([[-1e200]], [[1.0]], [[-2e200]], [[1.0]]))


# --- any scaling of the model ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("S", [1e3, 1e5])
def test_zeros_of_a_chain_with_large_gains(S):
    """In t = (s + 1e-3)/S the zeros are the roots of t^3 + t^2 + t/2 + 1/2 = (t + 1)(t^2 + 1/2)."""
    A = -1e-3 * np.eye(4) + S * np.eye(4, k=1)
    found = rl.zeros(StateSpaceModel(A, [[0], [1], [0], [1]], [[1, 1, 1, 1]], [[0]]))
    wanted = np.array([-S - 1e-3, -1e-3 + 1j * S / np.sqrt(2), -1e-3 - 1j * S / np.sqrt(2)])
    assert matched(found.values, wanted) < 1e-13 * S
    assert found.status == "converged"
    assert found.residuals.max() < 1e-15


def test_a_zero_far_beyond_the_dynamics_is_kept():
    found = rl.zeros(StateSpaceModel([[-1e-6]], [[1]], [[1]], [[1e-8]]))  # 1e-8 + 1 / (s + 1e-6)
    np.testing.assert_allclose(found.values, [-1e8 - 1e-6], rtol=1e-15)


def test_a_rank_that_rounding_decides_is_inaccurate_with_a_reason():
    """Three sensors of two quantities: the third row of C is a combination of the others up to rounding."""
    rng = np.random.default_rng(4)
    A, B, C = rng.normal(size=(4, 4)), rng.normal(size=(4, 2)), rng.normal(size=(2, 4))
    model = StateSpaceModel(A, B @ rng.normal(size=(2, 3)), rng.normal(size=(3, 2)) @ C, np.zeros((3, 3)))
    found = rl.zeros(model)
    assert (found.status, found.normal_rank) == ("inaccurate", 2)
    assert found.reason == "the normal rank is 3, and 2 to within rounding of the entries"
    assert matched(found.values, rl.zeros(StateSpaceModel(A, B, C, np.zeros((2, 2)))).values) < 1e-9


def test_a_zero_that_rounding_decides_is_inaccurate_with_a_reason():
    """(s^2 + 2e-16) and a fast pole: the last digit of an entry decides between zeros at +-1.4e-8 j and at 0."""
    A = np.array([[0, 1, 0], [0, 0, 1], [-6.0, -11, -6]])
    Q = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]
    found = rl.zeros(StateSpaceModel(Q @ A @ Q.T, Q @ [[0], [0], [1]], np.array([[0, 0, 1.0]]) @ Q.T, [[0.0]]))
    assert found.status == "inaccurate"
    assert found.reason.startswith("rounding of the model's entries decides where the zero")


def test_multiple_zeros_of_whole_numbers_are_exact():
    """s^2 (s + 1)^3 over s^7."""
    C = np.zeros((1, 7))
    C[0, 2:6] = [1, 3, 3, 1]
    found = rl.zeros(StateSpaceModel(np.eye(7, k=1), np.eye(7)[:, 6:], C, [[0.0]]))
    assert sorted(found.values.tolist(), key=abs) == [0, 0, -1, -1, -1]
    assert found.status == "converged"
