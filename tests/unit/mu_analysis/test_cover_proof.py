"""Covers over the whole axis: no crossing between points is missed."""

from __future__ import annotations

import numpy as np
import pytest

import robustlab as rl
from robustlab.uncertainty import FORMS, error_sizes

OMEGA = np.geomspace(1e-3, 1e4, 20_001)


def family(seed, direct):
    rng = np.random.default_rng(seed)

    def one():
        A = np.array([[-1.0, 2.0, 0.0], [-2.0, -1.0, 0.5], [0.0, 0.3, -4.0]]) + 0.15 * rng.standard_normal((3, 3))
        B = np.array([[1.0, 0.0], [0.0, 1.0], [0.3, 0.2]]) + 0.15 * rng.standard_normal((3, 2))
        C = np.array([[1.0, 0.0, 0.2], [0.0, 1.0, 0.1]]) + 0.15 * rng.standard_normal((2, 3))
        return rl.StateSpaceModel(A, B, C, direct * np.eye(2))

    return [one() for _ in range(4)]


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("dt", [0.0, 0.1])
def test_every_form_is_proved_and_holds_on_a_dense_grid(form, dt):
    models = family(1, 1.0)
    if dt:
        models = [rl.discretise(m, dt) for m in models]
    found = rl.cover(models, form, gain=False)
    assert found.status is rl.Status.CERTIFIED
    omega = np.linspace(1e-4, np.pi / dt * (1 - 1e-9), 20_001) if dt else OMEGA
    weight = np.abs(rl.frequency_response(found.fit.weight, omega)[:, 0, 0])
    ratio = error_sizes(tuple(models), found.model.nominal, form, omega) / weight
    assert ratio.max() <= 1.0 + 1e-8
    assert ratio.max() > 0.9  # the weight is tight


@pytest.mark.slow
def test_a_peak_too_narrow_for_any_grid_is_below_the_weight():
    """A needle of 2 at sqrt(7), 1e-7 wide, is the whole error of the additive form and of those of a biproper model."""
    plain = rl.StateSpaceModel([[-1.0]], [[1.0]], [[1.0]], [[1.0]])
    needle = rl.StateSpaceModel([[0, 1], [-7.0, -2e-7]], [[0], [1]], [[1e-6, 0]], [[0]])
    for form in ("additive", "input-multiplicative"):
        found = rl.cover([plain, plain + needle], form, nominal=plain, gain=False)
        error = error_sizes((plain + needle,), plain, form, np.array([np.sqrt(7)])).max()
        assert error > 0.5
        assert abs(found.fit.weight(1j * np.sqrt(7))[0, 0]) >= error * (1 - 1e-6)


@pytest.mark.parametrize("form", ["input-multiplicative", "inverse-output-multiplicative"])
def test_relative_errors_of_strictly_proper_models_are_proved(form):
    """Two poles more than zeros: the factors that make the models invertible cancel."""
    models = [rl.tf([k], [1.0, 0.8 * k, 1.0]) for k in (1.0, 1.1, 0.95)]
    models = [rl.StateSpaceModel(m.A, m.B, m.C, [[0.0]]) for m in models]
    found = rl.cover(models, form, gain=False)
    assert found.status is rl.Status.CERTIFIED
    weight = np.abs(rl.frequency_response(found.fit.weight, OMEGA)[:, 0, 0])
    assert (error_sizes(tuple(models), found.model.nominal, form, OMEGA) / weight).max() <= 1 + 1e-7


def test_other_unstable_poles_go_into_inverse_forms():
    models = [rl.StateSpaceModel([[p]], [[1.0]], [[1.0]], [[0.0]]) for p in (-0.5, 0.2, 1.0)]
    for form in ("additive", "input-multiplicative", "output-multiplicative"):
        with pytest.raises(rl.NoTrustworthyNumber, match=r"(?s)unstable error.*an inverse form"):
            rl.cover(models, form, gain=False)
    inverse = rl.cover(models, "inverse-additive", gain=False)
    assert inverse.status is rl.Status.CONVERGED  # inverses of strictly proper models are no systems: by frequency
    assert inverse.fit.order == 0  # 1 / G_i - 1 / G = p - p_i, and the middle is at 0.25
    assert inverse.fit.magnitude.max() == pytest.approx(0.75, rel=1e-3)


@pytest.mark.parametrize("form", ["input-multiplicative", "output-multiplicative", "inverse-additive"])
def test_models_without_an_inverse_are_rejected(form):
    models = [rl.StateSpaceModel([[-p]], [[1.0, 2.0]], [[1.0], [1.0]], np.zeros((2, 2))) for p in (1.0, 1.2)]
    with pytest.raises(rl.NoTrustworthyNumber, match=r"inverse|unstable error"):
        rl.cover(models, form, gain=False)


# --- through the zeros: chains of large gains ------------------------------------------------------------------------


def chain(c, d=0.0, S=1e5):
    """A chain of integrators of rate S, almost: its zeros are those of the polynomial c in (s + 1e-3)/S."""
    A = -1e-3 * np.eye(4) + S * np.eye(4, k=1)
    return rl.StateSpaceModel(A, np.eye(4)[:, 3:], [c], [[d]])


@pytest.mark.parametrize("form", ["input-multiplicative", "output-multiplicative"])
def test_an_error_with_poles_at_right_half_plane_zeros_is_rejected(form):
    """Zeros at 1e5 (1, 2, 3); a former version found one at 6/11 e5 and certified the error."""
    models = [chain([-6.0, 11.0, -6.0, 1.0]), chain([-5.0, 11.0, -6.0, 1.0])]
    with pytest.raises(rl.NoTrustworthyNumber, match=r"unstable error \(pole 100000"):
        rl.cover(models, form, nominal=models[0], gain=False)


def test_models_whose_relative_degree_changes_by_rounding_are_covered():
    """Two poles more than zeros in turned states: far beyond the grid rounding decides the errors' responses."""
    rng = np.random.default_rng(2)
    models = []
    for _ in range(3):
        A = np.array([[0, 1, 0], [0, 0, 1], [-6.0, -11, -6]]) * (1 + 0.02 * rng.normal(size=(3, 3)))
        Q = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        models.append(rl.StateSpaceModel(Q @ A @ Q.T, Q @ [[0], [0], [1]], np.array([[2.0, 1, 0]]) @ Q.T, [[0.0]]))
    found = rl.cover(models, "inverse-input-multiplicative", gain=False)
    assert found.status is rl.Status.CERTIFIED
    assert found.fit.magnitude.max() < 0.3
