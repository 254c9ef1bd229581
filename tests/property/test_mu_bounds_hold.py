"""Properties of mu for all matrices: order of the bounds, evidence that re-checks, invariances, no attack succeeds."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import block_diag, expm

import robustlab as rl
from robustlab import FullBlock, RealScalar
from robustlab.budget import listening
from robustlab.mu_analysis import delta_norm, proves, smallest_step
from robustlab.uncertainty import as_blocks, block_slices, delta_matrix, delta_values, structure_size

ROWS = st.sampled_from([[-1, 0], [1, 0], [-2, 0], [2, 0], [1, 2], [2, 1], [2, 2]])


@st.composite
def problems(draw):
    """A structure of up to four blocks and a matrix of any rank, sparse or not, over several decades."""
    blocks = as_blocks(draw(st.lists(ROWS, min_size=1, max_size=4)))
    rng = np.random.default_rng(draw(st.integers(0, 10**6)))
    q, p = structure_size(blocks)
    M = rng.standard_normal((p, q)) + 1j * rng.standard_normal((p, q))
    if draw(st.booleans()):
        M = M.real.astype(complex)
    if draw(st.booleans()):
        rank = int(rng.integers(1, min(p, q) + 1))
        M = M[:, :rank] @ (rng.standard_normal((rank, q)) + 0j)
    if draw(st.booleans()):
        M = M * (rng.random((p, q)) < 0.5)
    return M * 10.0 ** draw(st.integers(-8, 8)), blocks, rng


def random_delta(blocks, rng):
    q, p = structure_size(blocks)
    delta = np.zeros((q, p), dtype=complex)
    for block, (w, z) in zip(blocks, block_slices(blocks), strict=True):
        if isinstance(block, FullBlock):
            part = rng.standard_normal((block.rows, block.cols)) + 1j * rng.standard_normal((block.rows, block.cols))
            delta[w, z] = part / np.linalg.norm(part, 2)
        else:
            real = isinstance(block, RealScalar)
            value = rng.choice([-1.0, 1.0]) if real else np.exp(1j * rng.uniform(0, 2 * np.pi))
            delta[w, z] = value * np.eye(block.repeats)
    return delta


def check_evidence(M, blocks, bounds):
    if bounds.upper > 0:
        assert proves(M, bounds.D, bounds.D_z, bounds.G, bounds.upper)
    if bounds.lower > 0:
        assert np.array_equal(bounds.delta, delta_matrix(blocks, delta_values(blocks, bounds.delta)))
        values = np.linalg.svd(np.eye(len(M)) - M @ bounds.delta, compute_uv=False)
        assert values[-1] <= 1e-8 * (1 + values[0])
        assert abs(delta_norm(blocks, bounds.delta) * bounds.lower - 1) <= 1e-8


@given(problems())
@settings(max_examples=40)
def test_bounds_and_their_evidence(problem):
    M, blocks, rng = problem
    bounds = rl.mu(M, blocks)
    assert 0 <= bounds.lower <= bounds.upper
    assert np.isfinite(bounds.upper)
    check_evidence(M, blocks, bounds)
    # No Delta inside the proved ball makes the loop singular: det(I - M t Delta) keeps its distance along random rays.
    if bounds.upper > 0:
        for _ in range(5):
            eigenvalues = np.linalg.eigvals(M @ random_delta(blocks, rng))
            real = np.abs(eigenvalues.imag) <= 1e-9 * np.abs(eigenvalues)
            assert np.abs(eigenvalues[real]).max(initial=0.0) <= bounds.upper * (1 + 1e-9)


@given(st.integers(0, 10**6), st.integers(2, 5))
@settings(max_examples=15)
def test_invariant_under_scaling_that_commutes(seed, n):
    rng = np.random.default_rng(seed)
    M = rng.standard_normal((n, n)) + 1j * rng.standard_normal((n, n))
    blocks = [[int(rng.choice([-1, 1])), 0] for _ in range(n)]
    d = 10.0 ** rng.uniform(-4, 4, n)
    one, other = rl.mu(M, blocks), rl.mu(M * d[:, None] / d[None, :], blocks)
    assert abs(one.upper - other.upper) <= 1e-5 * max(one.upper, 1e-3 * np.abs(M).max())


@given(st.integers(0, 10**6), st.integers(1, 5), st.integers(0, 3))
@settings(max_examples=40)
def test_smallest_step_is_the_smallest(seed, n_real, n_complex):
    """The primal point is feasible, and the dual over a fine grid of phases proves that none is smaller."""
    rng = np.random.default_rng(seed)
    n = n_real + n_complex
    a = rng.standard_normal((1, n)) + 1j * rng.standard_normal((1, n))
    real = np.arange(n) < n_real
    if n == 1:
        return  # one real number cannot solve a complex equation
    d = smallest_step(a, real)
    assert abs((a * d).sum() - 1) < 1e-9
    assert not d[:, real].imag.any()
    # The dual has kinks where a turned number becomes imaginary: they belong to the grid.
    kinks = (np.pi / 2 - np.angle(a[0]) + np.pi / 2) % np.pi - np.pi / 2
    theta = np.concatenate([np.linspace(-np.pi / 2, np.pi / 2, 20001), kinks])
    turned = np.exp(1j * theta)[:, None] * a
    strength = np.abs(turned.real[:, real]).sum(axis=1) + np.abs(a[:, ~real]).sum()
    dual = (np.cos(theta) / strength).max()
    assert np.abs(d).max() >= dual * (1 - 1e-9)
    assert np.abs(d).max() <= dual * (1 + 1e-3)


def same_loops(m, blocks, rng):
    """The model in other states, with channels in another order, an unused one, and states that are hidden."""
    n, q, (turn, _) = m.n_states, m.n_inputs, np.linalg.qr(rng.standard_normal((m.n_states + 2,) * 2))
    for T in (np.eye(n)[rng.permutation(n)], np.eye(n)[::-1], turn[:n, :n] + 2 * np.eye(n)):
        yield rl.StateSpaceModel(T @ m.A @ np.linalg.inv(T), T @ m.B, m.C @ np.linalg.inv(T), m.D, m.dt), blocks
    yield rl.StateSpaceModel(m.A, m.B[:, ::-1], m.C[::-1], m.D[::-1, ::-1], m.dt), blocks[::-1]
    wide, tall = np.hstack([np.ones((n, 1)), m.B]), np.vstack([np.zeros((1, n)), m.C])
    unused = [rl.RealScalar("unused"), *blocks]
    yield rl.StateSpaceModel(m.A, wide, tall, np.pad(m.D, ((1, 0), (1, 0))), m.dt), unused
    mode = np.array([[-0.1, 1.0], [-1.0, -0.1]])
    A = block_diag(m.A, mode if not m.is_discrete else expm(0.5 * mode))
    for B, C in ((np.ones((2, q)), np.zeros((q, 2))), (np.zeros((2, q)), np.ones((q, 2)))):
        B, C = np.vstack([m.B, B]), np.hstack([m.C, C])
        yield rl.StateSpaceModel(turn @ A @ turn.T, turn @ B, C @ turn.T, m.D, m.dt), blocks


def counted(model, blocks):
    """Both bounds of the margin, and the work that was counted."""
    done = [0.0]
    with listening(lambda work, _: done.append(work)):
        margin = rl.robust_stability(rl.UncertainModel(model, blocks))
    return margin.lower, margin.upper, max(done)


@pytest.mark.parametrize(
    ("seed", "discrete", "one_sided"),
    [(0, False, False), (2, True, True), pytest.param(1, False, True, marks=pytest.mark.slow)],
)
def test_the_same_loop_gets_the_same_bounds_for_the_same_work(seed, discrete, one_sided):
    rng = np.random.default_rng(seed)
    w, zeta = 10 ** rng.uniform(-0.5, 0.5, 2), 10 ** rng.uniform(-3, -1, 2)
    mix = np.eye(4) + 0.3 * rng.standard_normal((4, 4))
    A = mix @ block_diag(*([[-z * v, v], [-v, -z * v]] for z, v in zip(zeta, w, strict=True))) @ np.linalg.inv(mix)
    model = rl.StateSpaceModel(
        expm(0.5 * A) if discrete else A, rng.standard_normal((4, 3)), rng.standard_normal((3, 4)), np.zeros((3, 3)),
        0.5 if discrete else 0.0,
    )  # fmt: skip
    below = 0.2 if one_sided else None
    blocks = [rl.RealScalar("a", 2, rl.ParameterRange(1.0, 0.5, "", below)), rl.RealScalar("b")]
    lower, upper, work = counted(model, blocks)
    assert upper <= lower * 1.0101
    for other in same_loops(model, blocks, rng):
        low, high, spent = counted(*other)
        assert abs(high - upper) <= 1e-6 * upper
        assert abs(low - lower) <= 0.005 * upper
        assert work / 2 <= spent <= 2 * work


@pytest.mark.parametrize("eps", [1e-14, 1e-9, 1e-3])
def test_real_mu_jumps_and_its_lower_bound_with_it(eps):
    # Im det(I - M Delta) = -a eps delta_2 (1 - a delta_1): only delta = (1 / a, 0) is singular, mu = a. For eps = 0 it
    # is larger by sqrt(2), and a Delta that attains that is singular to rounding still.
    a = 0.9653700867
    M = np.array([[a, a], [-a, a * (1 + 1j * eps)]])
    assert rl.mu(M, [[-1, 0], [-1, 0]]).lower <= a * (1 + 1e-7)
    assert rl.mu(M.real, [[-1, 0], [-1, 0]]).lower > 1.4 * a
