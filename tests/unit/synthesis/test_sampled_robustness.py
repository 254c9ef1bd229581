"""Robustness of sampled uncertain loops: closed forms, and exact members inside the bounds."""

from __future__ import annotations

import numpy as np
import pytest
from sampled_robustness import spectral_radius
from scipy.linalg import expm

import robustlab as rl
from robustlab.result import plain
from robustlab.synthesis.sampled.held_intervals import ChannelGroup, held_interval
from robustlab.synthesis.sampled.lifting import mean_and_variance


def gain(value, dt):
    return rl.StateSpaceModel([], [], [], [[value]], dt)


def first_order(radius=0.3):
    """x' = -(1 + radius delta) x + d + u, z = y = x."""
    return rl.UncertainModel(
        rl.StateSpaceModel([[-1.0]], [[-radius, 1.0, 1.0]], [[1.0]] * 3, [[0.0] * 3] * 3), [rl.RealScalar("pole")]
    )


def test_the_margin_of_a_first_order_lag_is_the_closed_form():
    # The sampled pole e^-aT - 3 (1 - e^-aT) / a is one at a = -3, whatever T: delta = -4 / 0.3.
    robust = rl.sampled_robustness(first_order(), gain(-3.0, 0.05))
    assert robust.status is rl.Status.CERTIFIED
    exact = 4 / 0.3
    assert 0.998 * exact < robust.stability.lower <= exact
    assert exact * (1 - 1e-12) <= robust.stability.upper < 1.002 * exact
    assert robust.stability.delta["pole"] == pytest.approx(-robust.stability.upper)
    # With a fast sampler robust performance is that of x' = -(4 + 0.3 delta) x + d: 1 / k = 1 / (4 - 0.3 k).
    assert robust.mu_lower <= robust.mu_upper < 1.002 * robust.mu_lower
    assert robust.mu_upper == pytest.approx(1.3 / 4, rel=5e-3)
    again = rl.robust_performance(robust.loop, accuracy=1e-3, expected=robust.margin)
    assert again.lower == pytest.approx(robust.margin, rel=2e-3)
    data = plain(robust)
    assert (data["status"], data["margin"]) == ("certified", robust.margin)
    assert ("status", "certified") in robust.facts()


@pytest.fixture
def lines():
    return []


def test_more_polynomials_prove_more_where_the_sampler_is_slow(lines):
    robust = rl.sampled_robustness(first_order(), gain(-3.0, 0.5), progress=lines.append)
    (one, coarse), (two, fine) = robust.history[:2]
    assert (one, two) == (1, 2)
    assert len(lines) == len(robust.history)
    assert fine < 0.85 * coarse
    assert robust.mu_lower <= robust.mu_upper < 1.01 * robust.mu_lower


def plant_with(kind, seed):
    """Three states, two parameters; with direct terms, with one that reaches the sampler, with lopsided ranges."""
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(3, 3))
    A -= (np.linalg.eigvals(A).real.max() + 0.4) * np.eye(3)
    B, C, D = rng.normal(size=(3, 5)), rng.normal(size=(5, 3)), np.zeros((5, 5))
    B[:, :2] *= 0.3
    lopsided = rl.ParameterRange(1.0, 1.0, "kg", 1.4)
    if kind == "direct":
        D[:4, :4] = 0.15 * rng.normal(size=(4, 4))
        D[2:4, 4] = 0.3
    if kind == "sampled":
        D[4, :2] = 0.3 * rng.normal(size=2)
        D[4, 3] = 0.3  # noise
    blocks = [rl.RealScalar("m", 1, lopsided if kind == "lopsided" else None), rl.RealScalar("k", 1)]
    return rl.UncertainModel(rl.StateSpaceModel(A, B, C, D), blocks)


@pytest.mark.parametrize(
    ("kind", "seed", "dt", "delay"),
    [("lopsided", 1, 0.1, 0.0), ("direct", 2, 0.2, 0.1), ("sampled", 3, 0.1, 0.1)],
)
def test_no_member_violates_what_was_proved(kind, seed, dt, delay):
    uncertain = plant_with(kind, seed)
    K = rl.StateSpaceModel([[0.5]], [[1.0]], [[0.02]], [[-0.05]], dt)
    robust = rl.sampled_robustness(uncertain, K, delay=delay, degree=1)
    assert robust.status is rl.Status.CERTIFIED
    assert robust.mu_lower <= robust.mu_upper < 1.03 * robust.mu_lower
    assert robust.held == (("u4",) if kind == "sampled" else ())
    rng = np.random.default_rng(seed)
    for i in range(8):
        direction = rng.choice([-1.0, 1.0], 2) if i < 4 else rng.uniform(-1, 1, 2)
        names = dict(zip("mk", direction, strict=True))
        stable = uncertain.evaluate({n: 0.9999 * robust.stability.lower * v for n, v in names.items()})
        assert spectral_radius(stable, K, delay) < 1
        if i < 2:
            member = uncertain.evaluate({n: 0.9999 * robust.margin * v for n, v in names.items()})
            assert rl.sampled_data_norm(member, K, delay=delay, rtol=0.05).lower <= robust.mu_upper
    # The member that is shown attains what is said.
    shown = rl.sampled_data_norm(uncertain.evaluate(robust.member), K, delay=delay)
    size = max(abs(v) for v in robust.member.values())
    assert robust.mu_lower == pytest.approx(min(1 / size, shown.lower), rel=2e-2)
    unstable = uncertain.evaluate(robust.stability.delta)
    assert spectral_radius(unstable, K, delay) >= 1 - 1e-9


def multiplicative(at_output):
    """1 / (s + 1) with 20 % unmodelled dynamics at its input or its output; disturbance at the input; z = x, y."""
    if at_output:
        B, C = [[0.0, 1.0, 1.0]], [[1.0], [1.0], [1.0]]
        D = [[0, 0, 0], [0, 0, 0], [0.2, 0, 0]]
    else:
        B, C = [[1.0, 1.0, 1.0]], [[0.0], [1.0], [1.0]]
        D = [[0, 0, 0.2], [0, 0, 0], [0, 0, 0]]
    return rl.UncertainModel(rl.StateSpaceModel([[-1.0]], B, C, D), [rl.FullBlock("dynamics", 1, 1)])


def test_dynamic_blocks_hold_for_every_delta_of_s():
    uncertain, K = multiplicative(at_output=False), gain(-3.0, 0.1)
    robust = rl.sampled_robustness(uncertain, K, delay=0.02)
    assert robust.status is rl.Status.CERTIFIED
    assert any("dynamic" in note for note in robust.notes)
    size = 0.999 * robust.margin
    for pole in (1.0, 10.0):
        lag = rl.StateSpaceModel([[-pole]], [[pole]], [[-size]], [[0.0]])
        allpass = rl.StateSpaceModel([[-pole]], [[2 * pole]], [[size]], [[-size]])
        for delta in (lag, allpass):
            norm = rl.sampled_data_norm(uncertain.evaluate({"dynamics": delta}), K, delay=0.02, n_meas=1, n_con=1)
            assert norm.lower <= robust.mu_upper


def test_a_dynamic_block_at_the_sampler_needs_a_filter():
    uncertain, K = multiplicative(at_output=True), gain(-3.0, 0.1)
    with pytest.raises(rl.InputError, match="'dynamics': dynamic, and it reaches the sampler directly") as caught:
        rl.sampled_robustness(uncertain, K)
    assert "antialiasing" in str(caught.value)
    robust = rl.sampled_robustness(uncertain, K, antialiasing=30.0)
    assert robust.status is rl.Status.CERTIFIED
    assert robust.antialiasing == 30.0


def test_without_disturbances_stability_alone():
    model = first_order().M.select(["u1", "u3"], ["y1", "y3"])
    robust = rl.sampled_robustness(rl.UncertainModel(model, [rl.RealScalar("pole")]), gain(-3.0, 0.05))
    assert robust.performance is None
    assert robust.margin == robust.stability.lower
    assert robust.mu_lower == pytest.approx(0.3 / 4, rel=2e-3)
    assert robust.member_gain == np.inf


def test_without_uncertainty_mu_is_the_norm():
    nominal = rl.UncertainModel(first_order().nominal, [])
    robust = rl.sampled_robustness(nominal, gain(-3.0, 0.05))
    norm = rl.sampled_data_norm(first_order().nominal, gain(-3.0, 0.05))
    assert robust.mu_upper == pytest.approx(norm.lower, rel=5e-3)
    assert robust.stability.lower == np.inf


def test_a_nominal_loop_that_is_not_stable():
    with pytest.raises(rl.NoTrustworthyNumber, match=r"nominal sampled loop is not stable \(a pole of modulus 1"):
        rl.sampled_robustness(first_order(), gain(2.0, 0.05))


@pytest.mark.parametrize(
    ("plant", "K", "options", "words"),
    [
        (first_order(), gain(-3.0, 0.0), {}, "sample time is 0"),
        (first_order(), gain(-3.0, 0.1), {"delay": -0.1}, "delay is -0.1"),
        (first_order(), gain(-3.0, 0.1), {"degree": 0}, "degree is 0"),
        (first_order(), gain(-3.0, 0.1), {"accuracy": 1.0}, "accuracy 1"),
        (first_order(), gain(-3.0, 0.1), {"antialiasing": -1.0}, "antialiasing is -1"),
        (first_order(), gain(-3.0, 0.1), {"n_meas": 2}, "K is 1 x 1, expected 1 x 2"),
        (rl.discretise(first_order().M, 0.1), gain(-3.0, 0.1), {}, "the plant has dt = 0.1 s"),
        (rl.UncertainModel(first_order().M, [rl.RealScalar("performance")]), gain(-3.0, 0.1), {}, "another name"),
        (rl.UncertainModel(first_order().M, [rl.RealScalar("a", 3)]), gain(-3.0, 0.1), {}, "at least"),
    ],
)
def test_bad_requests_are_named(plant, K, options, words):
    with pytest.raises(rl.InputError, match=words):
        rl.sampled_robustness(plant, K, **options)


def test_an_expected_margin_must_be_a_size():
    with pytest.raises(rl.InputError, match="expected is 0"):
        rl.robust_stability(first_order(), expected=0.0)


# --- one interval -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_energies_and_gramians_of_an_interval(degree):
    rng = np.random.default_rng(degree)
    A = rng.normal(size=(3, 3)) - 2 * np.eye(3)
    A[0] *= 40.0  # a fast mode
    m = rl.StateSpaceModel(A, rng.normal(size=(3, 4)), rng.normal(size=(2, 3)), rng.normal(size=(2, 4)))
    groups = [ChannelGroup(np.array([0]), np.array([0])), ChannelGroup(np.array([1, 2]), np.array([1]))]
    h = 0.2
    part = held_interval(m, groups, np.array([3]), 2, h, degree)
    np.testing.assert_allclose(part.move[:, :3], expm(A * h), atol=1e-12)
    # Constant inputs: the first coefficient is 1 / sqrt(h), and all energy is in coefficients and rests.
    x, w = rng.normal(size=3), rng.normal(size=4)
    coefficients = np.zeros((degree, 3))
    coefficients[0] = w[:3] * np.sqrt(h)
    v = np.concatenate([x, coefficients.ravel(), w[3:]])
    generator = np.zeros((7, 7))
    generator[:3] = np.hstack([m.A, m.B])
    moved, mean, variance = mean_and_variance(generator, np.hstack([m.C, m.D]), h)
    state = np.concatenate([x, w])
    np.testing.assert_allclose(part.move @ v, (moved @ state)[:3], atol=1e-12)
    rests = sum(np.linalg.norm(rest @ v) ** 2 for rest in part.rests)
    energy = np.linalg.norm(mean @ state) ** 2 + state @ variance @ state
    assert np.linalg.norm(part.means @ v) ** 2 + rests == pytest.approx(energy, rel=1e-10)
    if degree == 1:  # the first coefficient times sqrt(h) is the mean; what inputs of mean zero do to the state
        np.testing.assert_allclose(part.means @ v, mean @ state, atol=1e-12)
        for group, kick in zip(groups, part.kicks, strict=True):
            gram = mean_and_variance(A.T, m.B[:, group.w].T, h)[2]
            np.testing.assert_allclose(kick[:3] @ kick[:3].T, gram, atol=1e-12 * np.abs(gram).max() + 1e-15)


def test_a_gain_among_rests_bounds_what_fast_inputs_do():
    # z = integral of w: the largest gain on inputs of mean zero over [0, h] to outputs of mean zero is h / (2 pi).
    integrator = rl.StateSpaceModel([[0.0]], [[1.0]], [[1.0]], [[0.0]])
    group = [ChannelGroup(np.array([0]), np.array([0]))]
    found = [held_interval(integrator, group, np.array([], dtype=int), 1, 0.5, m).gains[0, 0] for m in (1, 2, 3)]
    assert 0.5 / (2 * np.pi) <= found[0] < 2 * 0.5 / (2 * np.pi)
    assert found[0] > found[1] > found[2]


def test_modes_that_no_quadrature_follows_are_refused():
    fast = rl.StateSpaceModel([[0.0, 1e9], [-1e9, 0.0]], [[0.0], [1.0]], [[1.0, 0.0]], [[0.0]])
    group = [ChannelGroup(np.array([0]), np.array([0]))]
    with pytest.raises(rl.NoTrustworthyNumber, match="too fast"):
        held_interval(fast, group, np.array([], dtype=int), 1, 0.5, 1)
