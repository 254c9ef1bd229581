"""H-infinity, L-infinity and H2 norms against closed forms, mirrored models and grids; `rl.peak_gain` of all kinds."""

from fractions import Fraction

import numpy as np
import pytest
import shown_objects as made
from attack_cases import make_case

import robustlab as rl
from robustlab.linear_analysis import exactly_stable
from robustlab.norms import PeakGain, h2_norm, hinf_norm
from robustlab.result import Status
from robustlab.statespace import StateSpaceModel


def resonance(zeta: float, omega: float = 1.0, gain: float = 1.0) -> StateSpaceModel:
    """gain * omega^2 / (s^2 + 2 zeta omega s + omega^2)."""
    return StateSpaceModel([[0, 1], [-(omega**2), -2 * zeta * omega]], [[0], [1]], [[gain * omega**2, 0]], [[0]])


@pytest.mark.parametrize("zeta", [0.5, 1e-2, 1e-4, 1e-6])
@pytest.mark.parametrize("omega", [1e-3, 1.0, 1e5])
def test_peak_of_a_resonance(zeta, omega):
    norm = hinf_norm(resonance(zeta, omega))
    assert norm.status is Status.CERTIFIED
    assert norm.value == pytest.approx(1 / (2 * zeta * np.sqrt(1 - zeta**2)), rel=1e-8)
    assert norm.frequency == pytest.approx(omega * np.sqrt(1 - 2 * zeta**2), rel=1e-3)
    assert norm.lower <= norm.upper <= norm.lower * (1 + 2e-6)


def test_the_higher_of_two_distant_narrow_peaks_is_found():
    low, high = resonance(1e-5, 1.0, 1.0), resonance(1e-7, 1e4, 0.0101)
    zeros = np.zeros((2, 2))
    both = StateSpaceModel(
        np.block([[low.A, zeros], [zeros, high.A]]), np.vstack([low.B, high.B]), np.hstack([low.C, high.C]), [[0]]
    )
    norm = hinf_norm(both)
    assert norm.frequency == pytest.approx(1e4, rel=1e-6)
    assert norm.value == pytest.approx(0.0101 / 2e-7, rel=1e-4)


def test_peak_at_infinite_frequency_and_at_zero():
    high_pass = StateSpaceModel([[-1.0]], [[1.0]], [[-3.0]], [[3.0]])
    assert hinf_norm(high_pass).value == pytest.approx(3.0, rel=1e-12)
    lag = StateSpaceModel([[-1e-9]], [[1.0]], [[5e-9]], [[0.0]])
    norm = hinf_norm(lag)
    assert (norm.value, norm.frequency) == (pytest.approx(5.0, rel=1e-12), 0.0)


@pytest.mark.parametrize(("n_inputs", "n_outputs", "n_states"), [(0, 2, 1), (2, 0, 1), (0, 0, 0), (0, 0, 3), (3, 0, 0)])
def test_empty_sizes_have_norm_zero(n_inputs, n_outputs, n_states):
    model = StateSpaceModel(
        -np.eye(n_states),
        np.ones((n_states, n_inputs)),
        np.ones((n_outputs, n_states)),
        np.zeros((n_outputs, n_inputs)),
    )
    assert hinf_norm(model).value == 0.0
    if n_states:  # also without channels it may be unstable
        assert hinf_norm(StateSpaceModel(-model.A, model.B, model.C, model.D)).upper == np.inf


@pytest.mark.parametrize("pole", [0.0, 1.0, 1e-9])
def test_not_stable_means_infinite_even_where_unreachable(pole):
    for b in (1.0, 0.0):
        norm = hinf_norm(StateSpaceModel([[pole, 0], [0, -1]], [[b], [1]], [[1, 1]], [[0]]))
        assert norm.value == np.inf
        assert "pole" in norm.reason


@pytest.mark.parametrize("pole", [0.9, -0.9, 0.0, 0.999999])
def test_discrete_lag(pole):
    norm = hinf_norm(StateSpaceModel([[pole]], [[1.0]], [[1.0]], [[0.0]], 0.1))
    assert norm.value == pytest.approx(1 / (1 - abs(pole)), rel=1e-8)
    if pole < 0:
        assert norm.frequency == pytest.approx(np.pi / 0.1)


@pytest.mark.parametrize("damping", [1e-6, 1e-9, 1e-12, 1e-14])
def test_a_peak_between_two_neighbouring_numbers_is_not_certified(damping):
    # 1 / (s^2 + 2 d s + 1) peaks at sqrt(1 - 2 d^2), which no floating-point number reaches for d = 1e-14
    norm = hinf_norm(StateSpaceModel([[0, 1], [-1, -2 * damping]], [[0], [1]], [[1, 0]], [[0]]))
    expected = 1 / (2 * damping * np.sqrt(1 - damping**2))
    if norm.status is Status.CERTIFIED:
        assert norm.lower <= expected * (1 + 1e-12)
        assert norm.upper >= expected
    assert (norm.status is Status.CERTIFIED) == (damping > 1e-13)


@pytest.mark.parametrize("dt", [0.0, 0.1])
@pytest.mark.parametrize("size", [1e-8, 1.0, 1e8])
def test_a_norm_that_is_zero_up_to_rounding_is_certified_as_zero(dt, size):
    """One model less itself, in states of other sizes, has zero gain."""
    A = np.array([[0.5, 0.3], [-0.2, 0.1]]) if dt else np.array([[-1.0, 7.0], [-0.3, -0.1]])
    B, C, t = np.array([[1.0], [0.3]]), size * np.array([[0.7, -1.1]]), np.array([1.0, 64.0])
    zero = np.zeros((2, 2))
    whole = np.block([[A, zero], [zero, A / t[:, None] * t]]), np.vstack([B, B / t[:, None]]), np.hstack([C, -C * t])
    norm = hinf_norm(StateSpaceModel(*whole, [[0.0]], dt))
    assert norm.status is Status.CERTIFIED
    assert norm.lower == 0.0
    assert 0 <= norm.upper <= 1e-11 * size
    # A gain of a millionth of the terms is nonzero, with its rounding in the bracket.
    whole[2][0, 2:] *= 1 - 1e-6
    norm, alone = hinf_norm(StateSpaceModel(*whole, [[0.0]], dt)), hinf_norm(StateSpaceModel(A, B, C, [[0.0]], dt))
    assert norm.status is Status.CERTIFIED
    assert norm.lower == pytest.approx(1e-6 * alone.lower, rel=1e-5)


@pytest.mark.parametrize(
    ("A", "discrete", "stable"),
    [
        ([[0.0, 1.0], [-1.0, 0.0]], False, False),
        ([[0.0, 1.0], [-1.0, -1e-300]], False, True),
        ([[0.0, 1.0], [-1.0, 1e-300]], False, False),
        ([[0.0]], False, False),
        ([[1.0 - 2.0**-53]], True, True),
        ([[1.0]], True, False),
        ([[-1.0]], True, False),
        ([[0.6, 0.8], [-0.8, 0.6]], True, False),  # 0.6^2 + 0.8^2 of the floats is above 1
        ([[-2.0, 1e9], [-4e-9, 2.0]], False, False),  # trace 0
        (np.diag([-1e-200] * 5) + np.diag([1e200] * 4, 1), False, True),
        (np.zeros((13, 13)), False, None),
        (np.zeros((0, 0)), False, True),
    ],
)
def test_stability_in_exact_arithmetic(A, discrete, stable):
    """Fractions decide whether the determinant of the rotation, 0.36 + 0.64 of the floats, is below 1."""
    A = np.array(A)
    if A.shape == (2, 2) and discrete:
        a, b = (Fraction(x) for x in A[0])
        stable = a * a + b * b < 1
    assert exactly_stable(A, discrete) is stable


def test_a_stable_jordan_block_of_unstable_computed_eigenvalues_is_not_certified_unstable():
    """(s + a)^6 with a = 1e-4: computed roots scatter by eps^(1/6) = 2e-3 around it, some of them to the right."""
    T = np.linalg.qr(np.random.default_rng(3).standard_normal((6, 6)))[0]
    A = T @ (np.diag([-1e-4] * 6) + np.diag([1.0] * 5, 1)) @ T.T
    model = StateSpaceModel(A, np.ones((6, 1)), np.ones((1, 6)), [[0.0]])
    norm = hinf_norm(model)
    truth = exactly_stable(A)
    assert truth is not None
    if np.isinf(norm.lower):
        assert not truth
    assert (h2_norm(model).status is Status.CERTIFIED) <= (not truth)


# --- on the axis and in a band ----------------------------------------------------------------------------------------


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
    # an integrator, and a pole in the band that may or may not be on the axis
    A = np.array([[0.0, 0, 0], [0, 0, 1], [0, -1, -1e-16]])
    nearby = rl.StateSpaceModel(A, np.ones((3, 1)), np.ones((1, 3)), [[0.0]])
    assert rl.peak_gain(nearby, band=(0.5, 5.0)).status is Status.INACCURATE
    summing = rl.StateSpaceModel([[1.0]], [[1.0]], [[1.0]], [[0.0]], 0.1)
    assert rl.peak_gain(summing, band=(2.0, 5.0)).lower == pytest.approx(1 / abs(np.exp(0.2j) - 1), rel=1e-9)
    assert rl.peak_gain(summing, band=(0.0, 5.0)).value == np.inf


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


# --- `rl.peak_gain` of every kind of system: the class of the result, and refused options with their hints ------------


LAG = rl.tf([1.0], [1.0, 1.0])
ROUGH = rl.with_effects(rl.plant("servo-axis"), {"input-saturation": {"u_max": 10.0}})


@pytest.mark.parametrize(
    ("system", "options", "kind"),
    [
        (LAG, {}, "HinfNorm"),
        (LAG @ rl.delay(0.1), {}, "DelayGain"),
        (made.first_order(), {}, "WorstCaseGain"),
        (made.first_order(), {"frequency": [0.5, 1.0]}, "GainAt"),
        (LAG @ rl.delay(0.1), {"frequency": [0.5, 1.0]}, "GainAt"),
        (made.first_order(), {"block_types": {"pole": rl.Varying(0.1)}, "order": 0}, "IqcGain"),
        (rl.LPVModel({"a": [1.0, 4.0]}, [LAG, LAG]), {}, "LPVGain"),
    ],
)
def test_each_kind_has_one_class_of_bounds(system, options, kind):
    found = rl.peak_gain(system, **options)
    assert isinstance(found, PeakGain)
    assert type(found).__name__ == kind
    assert found.lower <= found.upper * (1 + 1e-9)
    assert set(found.numbers()) <= {*found.to_json(), "value"}
    assert found.facts()[0][0] == "largest gain"
    assert found.headline()


def test_channels_are_chosen_by_name():
    both = [[1.0], [3.0]] @ LAG
    last = both.outputs[-1].name
    assert rl.peak_gain(both, outputs=[last]).upper == pytest.approx(3.0, rel=1e-5)
    assert rl.peak_gain(both, outputs=[last], frequency=[0.0]).upper == pytest.approx(3.0, rel=1e-5)


BANDS = ((2.0, 1.0), (-1.0, 1.0), (1.0, 1.0), (1.0, 40.0), (np.nan, 1.0), (1.0,), "ab")


@pytest.mark.parametrize(
    ("call", "text"),
    [
        *((lambda band=band: rl.peak_gain(rl.tf([1.0], [1.0, -0.5], dt=0.1), band=band), "band") for band in BANDS),
        (lambda: rl.peak_gain(LAG, tolerance=0, norm="linf"), "rtol"),
        (lambda: rl.peak_gain(made.first_order(), band=(1.0, 2.0)), "band: given for an uncertain model, expected it"),
        (lambda: rl.peak_gain(LAG, LAG), r"close the loop first: G.feedback\(K\)"),
        (lambda: rl.peak_gain(LAG, lyapunov="constant"), "expected it for an LPV model"),
        (lambda: rl.peak_gain(LAG, time_limit=1.0), "an uncertain model, blocks with types, an LPV model"),
        (lambda: rl.peak_gain(made.first_order(), norm="hinf"), "norm: given for an uncertain model"),
        (lambda: rl.peak_gain(LAG, norm="h2"), "'hinf' or 'linf'"),
        (lambda: rl.peak_gain(LAG, norm="hinf", band=(1.0, 2.0)), "norm='linf': the peak in the band"),
        (lambda: rl.peak_gain(ROUGH), "controller: none for a plant"),
    ],
)
def test_an_option_of_another_kind_is_refused_with_a_hint(call, text):
    with pytest.raises(rl.InputError, match=text) as caught:
        call()
    assert caught.value.where.startswith("peak_gain")
