"""H-infinity and H2 norms against closed forms, and at the edges."""

from fractions import Fraction

import numpy as np
import pytest

from robustlab.linear_analysis import exactly_stable
from robustlab.norms import h2_norm, hinf_norm
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
