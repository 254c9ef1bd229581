"""L-infinity and H2 norms against closed forms, mirrored models and dense grids."""

import numpy as np
import pytest
from attack_cases import make_case

import robustlab as rl
from robustlab.errors import InputError
from robustlab.result import Status


def resonance(zeta: float, omega: float = 1.0) -> rl.StateSpaceModel:
    return rl.StateSpaceModel([[0, 1], [-(omega**2), -2 * zeta * omega]], [[0], [1]], [[omega**2, 0]], [[0]])


def random_model(seed: int, *, square: bool = False) -> rl.StateSpaceModel:
    """Stable; discrete for odd seeds."""
    rng = np.random.default_rng(seed)
    n, m, p = rng.integers(1, 8), rng.integers(1, 4), rng.integers(1, 4)
    dt, p = 0.1 * (seed % 2), m if square else p
    A = rng.standard_normal((n, n))
    A = A * 0.9 / np.abs(np.linalg.eigvals(A)).max() if dt else A - np.eye(n) * (np.linalg.eigvals(A).real.max() + 0.1)
    D = rng.standard_normal((p, m)) * (seed % 3)
    return rl.StateSpaceModel(A, rng.standard_normal((n, m)), rng.standard_normal((p, n)), D, dt)


def companion(*factors: list[float]) -> np.ndarray:
    p = np.array([1.0])
    for factor in factors:
        p = np.polymul(p, factor)
    A = np.eye(len(p) - 1, k=1)
    A[-1] = -p[:0:-1]
    return A


# --- L-infinity ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(30))
def test_a_model_mirrored_in_the_axis_has_the_same_peak(seed):
    """``G(-s)^T`` is unstable where G is stable, with the same singular values."""
    G = random_model(2 * seed)
    mirrored = rl.StateSpaceModel(-G.A, -G.B, G.C, G.D)
    half, whole = rl.peak_gain(mirrored, norm="linf"), rl.peak_gain(G)
    assert half.status is Status.CERTIFIED
    assert half.lower <= whole.upper
    assert whole.lower <= half.upper <= half.lower * (1 + 3e-6)
    assert rl.peak_gain(mirrored).value == np.inf


def test_a_discrete_unstable_pole():
    """1 / (z - 2) has its peak -1 at z = 1."""
    found = rl.peak_gain(rl.StateSpaceModel([[2.0]], [[1.0]], [[1.0]], [[0.0]], 0.1), norm="linf")
    assert (found.value, found.frequency) == (pytest.approx(1.0, rel=1e-9), pytest.approx(0.0, abs=1e-6))
    assert found.status is Status.CERTIFIED


@pytest.mark.parametrize(
    "A", [[[0.0]], [[0, 1], [-4, 0]], companion([1, 0, 4], [1, 0, 4], [1, -1]), companion(*[[1, 0]] * 6)]
)
def test_a_pole_on_the_boundary_makes_it_infinite(A):
    n = len(A)
    found = rl.peak_gain(rl.StateSpaceModel(A, np.ones((n, 1)), np.ones((1, n)), [[0]]), norm="linf")
    assert (found.value, found.status) == (np.inf, Status.CERTIFIED)
    assert "stability boundary" in found.reason


@pytest.mark.parametrize("seed", range(20))
def test_the_peak_in_a_band_against_a_dense_grid(seed):
    G, rng = random_model(seed), np.random.default_rng(seed)
    last = np.pi / G.dt if G.dt else 50.0
    low, high = np.sort(rng.uniform(0, last, 2))
    found = rl.peak_gain(G, band=(low, high))
    grid = np.linspace(low, high, 20_001)
    seen = np.linalg.norm(rl.frequency_response(G, grid), 2, axis=(1, 2)).max()
    assert found.status is Status.CERTIFIED
    assert low <= found.frequency <= high * (1 + 1e-12)
    assert found.lower * (1 - 1e-4) <= seen <= found.upper * (1 + 1e-9)


def test_the_peak_in_a_band_in_closed_form():
    # Above its peak the gain of a resonance falls: the peak is at the low end.
    assert rl.peak_gain(resonance(0.1), band=(2.0, np.inf)).lower == pytest.approx(1 / np.hypot(3, 0.4), rel=1e-9)
    whole, over = rl.peak_gain(resonance(0.1), norm="linf"), rl.peak_gain(resonance(0.1), band=(0.5, 2.0))
    assert (whole.lower, whole.frequency) == pytest.approx((over.lower, over.frequency), rel=1e-6)
    assert rl.peak_gain(rl.StateSpaceModel([], [], [], [[-2.0]]), band=(1.0, 2.0)).value == 2.0


def test_a_pole_on_the_boundary_counts_in_its_band_alone():
    integrator = rl.StateSpaceModel([[0.0]], [[1.0]], [[1.0]], [[0.0]])
    assert rl.peak_gain(integrator, band=(2.0, 5.0)).upper == pytest.approx(0.5, rel=1e-5)
    assert rl.peak_gain(integrator, band=(0.0, 5.0)).value == np.inf
    undamped = rl.StateSpaceModel([[0, 1], [-1, 0]], [[0], [1]], [[1, 0]], [[0]])
    assert rl.peak_gain(undamped, band=(2.0, 5.0)).lower == pytest.approx(1 / 3, rel=1e-9)
    assert "on the stability boundary" in rl.peak_gain(undamped, band=(0.5, 5.0)).reason
    twice = np.array([[0, 1.0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1], [-1, 0, -2, 0]])  # (s^2 + 1)^2: blurred to 1e-8
    double = rl.StateSpaceModel(twice, np.eye(4)[:, 3:], np.eye(4)[:1], [[0.0]])
    assert rl.peak_gain(double, band=(0.5, 5.0)).status is Status.CERTIFIED
    assert rl.peak_gain(double, band=(2.0, 5.0)).lower == pytest.approx(1 / 9, rel=1e-9)
    # an integrator, and a pole in the band that may or may not lie on the axis
    A = np.array([[0.0, 0, 0], [0, 0, 1], [0, -1, -1e-16]])
    beside = rl.StateSpaceModel(A, np.ones((3, 1)), np.ones((1, 3)), [[0.0]])
    assert rl.peak_gain(beside, band=(0.5, 5.0)).status is Status.INACCURATE
    summing = rl.StateSpaceModel([[1.0]], [[1.0]], [[1.0]], [[0.0]], 0.1)
    assert rl.peak_gain(summing, band=(2.0, 5.0)).lower == pytest.approx(1 / abs(np.exp(0.2j) - 1), rel=1e-9)
    assert rl.peak_gain(summing, band=(0.0, 5.0)).value == np.inf


@pytest.mark.parametrize("band", [(2.0, 1.0), (-1.0, 1.0), (1.0, 1.0), (1.0, 40.0), (np.nan, 1.0), (1.0,), "ab"])
def test_invalid_bands_are_refused(band):
    with pytest.raises(InputError, match="band"):
        rl.peak_gain(rl.StateSpaceModel([[0.5]], [[1.0]], [[1.0]], [[0.0]], 0.1), band=band)


@pytest.mark.parametrize("zeta", [0.5, 1e-2, 1e-5])
@pytest.mark.parametrize("omega", [1e-3, 1.0, 1e5])
def test_the_h2_norm_of_a_resonance_has_its_closed_form(zeta, omega):
    norm = rl.h2_norm(resonance(zeta, omega))
    assert norm.status is Status.CONVERGED
    assert norm.value == pytest.approx(np.sqrt(omega / (4 * zeta)), rel=1e-9)


def exact_case(index):
    """Return a model of the attack, and its H2 norm in balls of 200 digits and more, by independent code.

    The last bits of such a model, and with them its norm, depend on the processor that multiplied its matrices.
    """
    pytest.importorskip("flint")
    from exact_loops import Model, system, with_precision
    from exact_loops import h2_norm as exact_norm

    data = make_case(71, index).data["G"]
    exact = with_precision(lambda: exact_norm(system(Model(data.A, data.B, data.C, data.D, data.dt))))
    return rl.StateSpaceModel(data.A, data.B, data.C, data.D, data.dt), None if exact is None else float(exact)


# Poles with damping of 1e-5 and less: on some processor the Gramians lose 1e-7 of the norm, or all of it.
HARD = (2591, 7711, 9631, 11631, 18831, 30831)


@pytest.mark.parametrize("index", HARD)
def test_a_norm_next_to_the_stability_boundary_is_right_or_inaccurate(index):
    model, exact = exact_case(index)
    found = rl.h2_norm(model)
    if exact is None or not found.status.trustworthy:
        assert found.status is Status.INACCURATE
    else:
        assert found.value == pytest.approx(exact, rel=1e-6)


def test_h2_of_edges():
    discrete = rl.StateSpaceModel([[0.5]], [[1.0]], [[1.0]], [[2.0]], 1.0)
    assert rl.h2_norm(discrete).value == pytest.approx(np.sqrt(4 + 4 / 3))
    assert rl.h2_norm(rl.StateSpaceModel([[1.0]], [[1.0]], [[1.0]], [[0.0]])).value == np.inf
    assert rl.h2_norm(rl.StateSpaceModel([[-1.0]], [[1.0]], [[1.0]], [[1.0]])).value == np.inf
    assert rl.h2_norm(rl.StateSpaceModel([], [], [], [[3.0, 4.0]], 0.1)).value == 5.0
    assert rl.h2_norm(rl.StateSpaceModel([[-1.0]], [[0.0]], [[1.0]], [[0.0]])).value == 0.0


def test_a_tolerance_of_zero_is_refused():
    with pytest.raises(InputError, match="rtol"):
        rl.peak_gain(rl.StateSpaceModel([[-1.0]], [[1.0]], [[1.0]], [[0.0]]), tolerance=0, norm="linf")
