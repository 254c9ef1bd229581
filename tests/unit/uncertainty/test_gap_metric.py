"""The nu-gap: closed forms, published values, independent computations, bad inputs."""

import numpy as np
import pytest

import robustlab as rl
from robustlab import coprime_margin, nu_gap
from robustlab.norms import bilinear_to_discrete


def first_order(gain: float, pole: float, direct: float = 0.0) -> rl.StateSpaceModel:
    """``gain / (s - pole) + direct``."""
    return rl.StateSpaceModel([[pole]], [[1.0]], [[gain]], [[direct]])


def random_model(n: int, p: int, m: int, seed: int, spread: float = 1.0) -> rl.StateSpaceModel:
    rng = np.random.default_rng(seed)
    A, B, C = rng.standard_normal((n, n)), rng.standard_normal((n, m)), rng.standard_normal((p, n))
    return rl.StateSpaceModel(spread * A, B, C, 0.3 * rng.standard_normal((p, m)))


# --- closed forms ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("k", [0.1, 0.7, 3.0, 40.0])
def test_integrators(k):
    assert nu_gap(first_order(1, 0), first_order(k, 0)).value == pytest.approx(abs(1 - k) / (1 + k), rel=1e-9)
    assert nu_gap(first_order(1, 0), first_order(k, 0)).frequency == pytest.approx(np.sqrt(k), rel=1e-3)


@pytest.mark.parametrize("a", [1e-4, 0.03, 0.5])
def test_a_slow_pole_on_either_side_of_the_axis(a):
    result = nu_gap(first_order(1, a), first_order(1, -a))
    assert result.value == pytest.approx(2 * a / (1 + a**2), rel=1e-9)
    assert result.frequency <= 0.01 * a  # the curve is flat there
    assert result.status is rl.Status.CERTIFIED


@pytest.mark.parametrize(("k1", "k2"), [(0.0, 1.0), (2.0, -0.3), (1.0, 1.0), (-4.0, 0.25)])
def test_static_gains_are_the_sine_of_an_angle(k1, k2):
    one, two = (rl.StateSpaceModel([], [], [], [[k]]) for k in (k1, k2))
    expected = abs(k1 - k2) / np.sqrt((1 + k1**2) * (1 + k2**2))
    assert nu_gap(one, two).value == pytest.approx(expected, abs=1e-12)


def test_the_winding_condition_decides_where_the_curves_are_close():
    """A right-half-plane pole that nearly cancels: invisible at all frequencies, and no controller suits both."""
    one, two = first_order(1, -1), rl.tf([1, -1.01], [1, 0, -1])
    result = nu_gap(one, two)
    assert result.chordal < 0.01
    assert result.winding != 0
    assert result.value == 1.0
    assert "winds" in result.reason


# --- published -------------------------------------------------------------------------------------------------------


def test_values_published_by_mathworks_for_gapmetric():
    """Printed to four digits; the documentation of an older release gives the same first two nu-gaps."""
    assert round(nu_gap(first_order(1, 0.001), first_order(1, -0.001)).value, 4) == 0.0020
    assert round(nu_gap(rl.tf([50], [1, 50]), rl.tf([400], [1, 58, 400])).value, 4) == 0.6147
    one, two, k = rl.tf([1, 2], [1, 5, 10]), rl.tf([1, 1], [1, 3, 10]), rl.tf([4.4], [1, 0])
    assert round(nu_gap(one, two).value, 4) == 0.1390
    assert round(coprime_margin(one, k).value, 4) == 0.1961


# --- independent computations ----------------------------------------------------------------------------------------


def curve_and_encirclements(one: rl.StateSpaceModel, two: rl.StateSpaceModel) -> tuple[float, float]:
    """Largest chordal distance on a dense grid, and the winding condition in terms of P1 and P2 themselves."""
    omega = np.concatenate([[0.0], np.geomspace(1e-4, 1e4, 10001)])
    p1, p2 = rl.frequency_response(one, omega), rl.frequency_response(two, omega)
    eye_m, eye_p = np.eye(one.n_inputs), np.eye(one.n_outputs)
    h1, h2 = np.swapaxes(p1.conj(), 1, 2), np.swapaxes(p2.conj(), 1, 2)
    left = np.linalg.inv(np.linalg.cholesky(eye_p + p2 @ h2))
    right = np.linalg.inv(np.linalg.cholesky(eye_m + h1 @ p1))
    chordal = np.linalg.svd(left @ (p2 - p1) @ np.swapaxes(right.conj(), 1, 2), compute_uv=False)[:, 0]
    det = np.linalg.det(eye_m + h2 @ p1)
    turns = 2 * np.diff(np.unwrap(np.angle(det)))[:].sum() / (2 * np.pi)  # both halves of the axis, upwards
    unstable = [int((m.poles().real > 0).sum()) for m in (one, two)]
    # Upwards along the axis is clockwise around the right half plane as far as its arc at infinity, where det is real.
    return float(chordal.max()), -turns + unstable[0] - unstable[1]


@pytest.mark.parametrize("seed", range(8))
def test_against_a_grid_and_the_encirclements_of_the_models_themselves(seed):
    p, m = [(1, 1), (2, 2), (1, 2), (3, 2)][seed % 4]
    one, two = random_model(2, p, m, seed), random_model(3, p, m, seed + 100, 0.6)
    if seed % 3 == 0:  # close to each other
        rng = np.random.default_rng(seed)
        two = rl.StateSpaceModel(*(getattr(one, x) + 0.1 * rng.standard_normal(getattr(one, x).shape) for x in "ABCD"))
    chordal, index = curve_and_encirclements(one, two)
    result = nu_gap(one, two)
    assert result.status is rl.Status.CERTIFIED
    assert result.chordal >= chordal * (1 - 1e-9)
    assert result.chordal == pytest.approx(chordal, rel=1e-4)
    assert result.winding == pytest.approx(index, abs=0.05)
    assert result.value == (pytest.approx(chordal, rel=1e-4) if round(index) == 0 else 1.0)


def test_the_best_margin_matches_the_literature():
    """Glover, McFarlane: 1/s has b_opt = 1/sqrt(2), reached by C = 1; the margin of any C is not above it."""
    integrator = first_order(1, 0)
    assert coprime_margin(integrator, rl.StateSpaceModel([], [], [], [[1.0]])).best == pytest.approx(1 / np.sqrt(2))
    for k in (0.3, 1.0, 5.0):
        margin = coprime_margin(integrator, rl.StateSpaceModel([], [], [], [[k]]))
        assert margin.value <= margin.best * (1 + 1e-9)


def test_a_controller_that_does_not_stabilise_has_no_margin():
    margin = coprime_margin(first_order(1, 1), rl.StateSpaceModel([], [], [], [[0.5]]))
    assert margin.value == margin.upper == 0.0
    assert "unstable" in margin.reason
    plus = coprime_margin(first_order(1, 1), rl.StateSpaceModel([], [], [], [[-2.0]]), sign=1)
    assert plus.value == pytest.approx(coprime_margin(first_order(1, 1), rl.StateSpaceModel([], [], [], [[2.0]])).value)


# --- discrete time ---------------------------------------------------------------------------------------------------


def test_discrete_models_through_the_bilinear_map():
    one, two = random_model(2, 2, 1, 3), random_model(3, 2, 1, 4, 0.5)
    z_one, z_two = (bilinear_to_discrete(m, 0.1) for m in (one, two))
    assert nu_gap(z_one, z_two).chordal == pytest.approx(nu_gap(one, two).chordal, rel=1e-8)
    k = bilinear_to_discrete(first_order(1, 0), 0.1)
    assert nu_gap(k, bilinear_to_discrete(first_order(4, 0), 0.1)).frequency == pytest.approx(
        2 / 0.1 * np.arctan(2.0 * 0.05), rel=1e-3
    )
