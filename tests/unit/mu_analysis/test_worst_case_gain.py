"""Worst-case gain and robust performance: closed forms, members inside the bounds, edges, refusals."""

import numpy as np
import pytest

import robustlab as rl
from robustlab import unstructured
from robustlab.uncertainty import FORMS, realise_delta


def oscillator(dt: float = 0.0) -> rl.UncertainModel:
    """x'' + c x' + x = u, y = x, c = 0.2 +- 0.1; peak gain 1 / (c sqrt(1 - c^2 / 4)). w = delta * 0.1 * x'."""
    M = rl.StateSpaceModel(
        [[0.0, 1.0], [-1.0, -0.2]], [[0.0, 0.0], [-0.1, 1.0]], [[0.0, 1.0], [1.0, 0.0]], np.zeros((2, 2))
    )
    if dt:
        from robustlab.norms import bilinear_to_discrete

        M = bilinear_to_discrete(M, dt)
    return rl.UncertainModel(M, [rl.RealScalar("c", parameter=rl.ParameterRange(0.2, 0.1, "N s/m"))])


def random_set(seed: int, n_blocks: int = 3, kind=rl.RealScalar, size: float = 0.5) -> rl.UncertainModel:
    """Four states, 2 x 2 performance channels; Delta of ``size`` of a margin that small gain guarantees."""
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((4, 4))
    A -= (np.linalg.eigvals(A).real.max() + 0.3) * np.eye(4)
    q = n_blocks + 2
    B, C = rng.standard_normal((4, q)), rng.standard_normal((q, 4))
    channels = rl.StateSpaceModel(A, B[:, :n_blocks], C[:n_blocks], np.zeros((n_blocks, n_blocks)))
    B[:, :n_blocks] *= size / rl.peak_gain(channels).value
    return rl.UncertainModel(rl.StateSpaceModel(A, B, C, np.zeros((q, q))), [kind(f"d{i}") for i in range(n_blocks)])


@pytest.mark.parametrize("dt", [0.0, 0.1])
def test_oscillator_has_its_closed_form(dt):
    worst = rl.peak_gain(oscillator(dt))
    truth = 1 / (0.1 * np.sqrt(1 - 0.1**2 / 4))
    assert worst.lower == pytest.approx(truth, rel=1e-6)
    assert truth * (1 - 1e-9) <= worst.upper <= 1.0002 * truth
    assert worst.delta["c"] == pytest.approx(-1.0)
    assert worst.physical["c"] == (pytest.approx(0.1), "N s/m")
    peak = np.sqrt(1 - 0.1**2 / 2)
    assert worst.frequency == pytest.approx(2 / dt * np.arctan(peak * dt / 2) if dt else peak, rel=1e-4)
    assert worst.status is rl.Status.CERTIFIED
    assert worst.nominal == pytest.approx(1 / (0.2 * np.sqrt(1 - 0.2**2 / 4)), rel=1e-6)


@pytest.mark.parametrize("seed", range(3))
def test_no_member_exceeds_the_bound_and_one_attains_it(seed):
    uncertain = random_set(seed, size=0.9)
    worst = rl.peak_gain(uncertain)
    assert worst.gap <= 0.0101
    rng = np.random.default_rng(seed)
    corners = np.array(np.meshgrid(*[[-1, 1]] * 3)).reshape(3, -1).T
    gains = [
        rl.peak_gain(uncertain.evaluate(dict(zip(("d0", "d1", "d2"), delta, strict=True)))).value
        for delta in [*corners, *rng.uniform(-1, 1, (40, 3))]
    ]
    assert max(gains) <= worst.upper
    assert max(gains) <= worst.lower * (1 + 1e-6)
    assert rl.peak_gain(uncertain.evaluate(worst.delta)).value == pytest.approx(worst.lower, rel=1e-9)


def test_complex_blocks_are_attained_at_their_frequency():
    uncertain = random_set(5, kind=rl.ComplexScalar)
    worst = rl.peak_gain(uncertain)
    gain = np.linalg.norm(uncertain.response([worst.frequency], worst.delta)[0], 2)
    assert gain == pytest.approx(worst.lower, rel=1e-9)
    assert max(abs(value) for value in worst.delta.values()) <= 1 + 1e-12
    assert worst.gap < 0.01
    real = rl.peak_gain(random_set(5))
    assert real.upper <= worst.upper * 1.01


def test_the_bound_holds_between_the_frequencies_of_any_grid():
    uncertain = oscillator()
    worst = rl.peak_gain(uncertain, omega=np.geomspace(0.1, 10, 30))
    reached = 0.0
    for low, high, bound in sorted(worst.intervals):
        assert low <= reached
        assert bound <= worst.upper * (1 + 1e-12)
        reached = max(reached, high)
    assert reached == np.inf
    assert (worst.nominal_gain <= worst.gain_lower + 1e-12).all()
    assert (worst.gain_lower <= worst.gain_upper).all()
    assert (worst.gain_upper <= worst.upper * (1 + 1e-3)).all()


def test_a_set_with_an_unstable_member_has_no_gain():
    M = rl.StateSpaceModel([[-1.0]], [[1.2, 1.0]], [[1.0], [1.0]], np.zeros((2, 2)))
    worst = rl.peak_gain(rl.UncertainModel(M, [rl.RealScalar("pole")]))
    assert worst.lower == worst.upper == np.inf
    assert rl.UncertainModel(M, [rl.RealScalar("pole")]).evaluate(worst.delta).spectral_abscissa() >= -1e-9
    assert "unstable" in worst.notes[0]


def test_wider_below_than_above():
    """1 / (s + a), a in [0.25, 1.5] around 1: the worst gain is 4, not the 2 of a symmetric range."""
    M = rl.StateSpaceModel([[-1.0]], [[-0.5, 1.0]], [[1.0], [1.0]], np.zeros((2, 2)))
    block = rl.RealScalar("a", parameter=rl.ParameterRange(1.0, 0.5, "1/s", below=0.75))
    worst = rl.peak_gain(rl.UncertainModel(M, [block]))
    assert worst.lower == pytest.approx(4.0, rel=1e-9)
    assert worst.upper == pytest.approx(4.0, rel=1e-3)
    assert worst.physical["a"] == (pytest.approx(0.25), "1/s")


def test_robust_performance_is_the_fixed_point_of_the_worst_case_gain():
    """At margin k the set of size k has a worst gain of 1 / k."""
    uncertain = random_set(1)
    margin = rl.robust_performance(uncertain)
    assert margin.gap < 0.02
    M = uncertain.M
    scaled = np.concatenate([np.full(3, margin.upper), np.ones(2)])
    inside = rl.UncertainModel(rl.StateSpaceModel(M.A, M.B * scaled, M.C, M.D * scaled), uncertain.blocks)
    assert rl.peak_gain(inside).lower == pytest.approx(1 / margin.upper, rel=0.02)
    assert np.linalg.norm(margin.delta["performance"], 2) <= margin.upper * (1 + 1e-9)


def test_the_gain_without_uncertainty_has_the_status_of_the_norm():
    """1/(s + 1) - (1 - 1e-13)/(s + 1): the difference has lost its digits."""
    little = rl.StateSpaceModel(-np.eye(2), [[1.0], [1.0]], [[1.0, 1e-13 - 1.0]], [[0.0]])
    worst = rl.peak_gain(rl.UncertainModel(little, []))
    assert worst.status is rl.Status.INACCURATE
    assert any("digits were lost" in note for note in worst.notes)


def test_the_worst_gain_of_a_nearly_cancelled_mode_is_that_of_its_narrow_peak():
    """max |S| / (1 - 0.2 |T|) of L = (s^2 + 2e-7 s + 100) / ((s^2 + 100) (s + 1)) times 5, in 50 digits (mpmath)."""
    L = rl.tf([5, 1e-6, 500], np.polymul([1, 0, 100], [1, 1]))
    M = rl.StateSpaceModel(
        L.A - L.B @ L.C, np.hstack([-L.B, L.B]), np.vstack([0.2 * L.C, -L.C]), [[0.0, 0.0], [-1.0, 1.0]]
    )
    found = rl.peak_gain(rl.UncertainModel(M, [rl.ComplexScalar("k")]))
    assert found.status is rl.Status.CERTIFIED
    assert found.lower <= 2.74200471 * (1 + 1e-5)
    assert found.lower >= 2.74200471 * (1 - 1e-4)
    assert 2.74200471 * (1 - 1e-5) <= found.upper <= 2.74200471 * (1 + 1e-3)


# --- sets with one full block -----------------------------------------------------------------------------------------


LAG = rl.StateSpaceModel([[-1.0]], [[1.0]], [[1.0]], [[0.2]])


def plant(p: int, m: int, dt: float = 0.0, seed: int = 0) -> rl.StateSpaceModel:
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((3, 3)) - 2.5 * np.eye(3)
    if dt:
        A = np.linalg.solve(np.eye(3) - 0.5 * dt * A, np.eye(3) + 0.5 * dt * A)
    B = rng.standard_normal((3, m)) * (dt or 1.0)
    return rl.StateSpaceModel(A, B, rng.standard_normal((p, 3)), np.zeros((p, m)), dt)


def closed_form(form: str, G: np.ndarray, K: np.ndarray) -> np.ndarray:
    """M at the channels of Delta up to sign, negative feedback, by textbook formulas."""
    p, m = G.shape
    So, Si = np.linalg.inv(np.eye(p) + G @ K), np.linalg.inv(np.eye(m) + K @ G)
    return {
        "additive": K @ So,
        "input-multiplicative": K @ So @ G,
        "output-multiplicative": G @ K @ So,
        "inverse-additive": So @ G,
        "inverse-input-multiplicative": Si,
        "inverse-output-multiplicative": So,
    }[form]


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize(("p", "m"), [(1, 1), (2, 3)])
@pytest.mark.parametrize("dt", [0.0, 0.1])
def test_m_norm_and_worst_delta(form, p, m, dt):
    G, K = plant(p, m, dt), rl.StateSpaceModel([], [], [], 0.3 * np.random.default_rng(5).standard_normal((m, p)))
    weight = rl.StateSpaceModel(LAG.A * 0 + 0.9, 0.1 * LAG.B, LAG.C, LAG.D, dt) if dt else LAG
    uncertain = unstructured(G, weight, form, name="d")
    loop = uncertain.feedback(K)
    test = rl.robust_stability(loop)
    assert test.status is rl.Status.CERTIFIED
    omega = np.geomspace(1e-2, 30, 40)
    g, k, w = (rl.frequency_response(s, omega) for s in (G, K, weight))
    expected = np.array([np.linalg.norm(w[i] * closed_form(form, g[i], k[i]), 2) for i in range(len(omega))])
    sigma = np.linalg.svd(rl.frequency_response(loop.delta_channels, omega), compute_uv=False)[:, 0]
    assert sigma == pytest.approx(expected, rel=1e-9)
    assert expected.max() <= 1 / test.lower
    # The worst Delta: of the norm of the margin, and on the stability boundary as a system; less of it is stable.
    assert np.linalg.norm(test.delta["d"], 2) == pytest.approx(test.upper, rel=1e-12)
    assert test.lower <= test.upper <= test.lower * (1 + 1e-8)
    if test.frequency < np.inf:
        made = realise_delta(loop.blocks, test.delta, test.frequency, dt)
        at = np.exp(1j * test.frequency * dt) if dt else 1j * test.frequency
        assert abs(test.pole - at) <= 1e-6
        assert rl.peak_gain(made["d"]).upper <= test.upper * (1 + 2e-6)
        less = realise_delta(loop.blocks, {"d": 0.99 * test.delta["d"]}, test.frequency, dt)
        assert loop.evaluate(less).is_stable()


def test_a_peak_in_the_direct_term_is_an_ill_posed_loop():
    lead = rl.StateSpaceModel([[-1.0]], [[1.0]], [[-1.0]], [[2.0]])  # (2 s + 1)/(s + 1)
    uncertain = unstructured(rl.StateSpaceModel([], [], [], [[1.0]]), lead)
    assert rl.robust_stability(uncertain).upper == np.inf
    closed = rl.robust_stability(uncertain.feedback())
    assert closed.frequency == np.inf
    assert closed.upper == pytest.approx(1.0)
