"""Weights from specifications."""

from __future__ import annotations

import numpy as np
import pytest

from robustlab import frequency_response, makeweight
from robustlab.statespace import StateSpaceModel


def gain(model, omega):
    return float(np.abs(frequency_response(model, [omega])[0, 0, 0]))


@pytest.mark.parametrize("order", [1, 2, 4])
def test_makeweight_goes_through_its_point(order):
    for low, high in ((100.0, 0.1), (0.02, 5.0)):
        W = makeweight(low, (3.0, 1.0), high, order=order)
        assert W.n_states == order
        assert W.is_stable()
        assert gain(W, 0.0) == pytest.approx(low)
        assert gain(W, 3.0) == pytest.approx(1.0)
        assert gain(W, np.inf) == pytest.approx(high)
        inverse = StateSpaceModel(W.A - W.B @ np.linalg.solve(W.D, W.C), W.B, W.C, W.D)
        assert inverse.is_stable()  # minimum phase


@pytest.mark.parametrize(
    ("arguments", "dt", "gains"),
    [
        ((100, 1, 0.5), 0.0, (100.0, 1.0, 0.5)),
        ((100, [1, 3], 0.5), 0.0, (100.0, 3.0, 0.5)),
        ((0.2, 2, 30, 0, 3), 0.0, (0.2, 1.0, 30.0)),
        ((100, 1, 0.5, 0.1), 0.1, (100.0, 1.0, 0.5)),
        ((100, (5, 2), 0.5, 0.1, 3), 0.1, (100.0, 2.0, 0.5)),
    ],
)
def test_makeweight_as_in_matlab(arguments, dt, gains):
    """Gains at zero frequency, at the given one, and at infinity or the Nyquist frequency."""
    W = makeweight(*arguments)
    assert W.dt == dt
    frequency = np.ravel(arguments[1])[0]
    z = (1, np.exp(1j * frequency * dt), -1) if dt else (0, 1j * frequency, 1e12)
    assert [abs(complex(W(s)[0, 0])) for s in z] == pytest.approx(gains, rel=1e-9)
