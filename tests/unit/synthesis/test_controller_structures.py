"""Controller structures: names, units, matrices against transfer functions, derivatives, bad input."""

import numpy as np
import pytest

from robustlab import frequency_response
from robustlab.dynamics import LayeredController, TorqueGains, Trim, upper_layer
from robustlab.statespace import Signal
from robustlab.synthesis import PID, Decentralised, FixedOrder, FixedPoles, MultichannelPID, Part, StaticGain

OMEGA = np.array([0.1, 0.7, 3.0])


def signals(prefix, count, unit):
    return tuple(Signal(f"{prefix}{i + 1}", unit) for i in range(count))


def law_of(structure, n_y, n_u, dt=0.0):
    return structure.law(signals("y", n_y, "rad"), signals("u", n_u, "V"), dt)


CASES = [
    (StaticGain(), 3, 2, 0.0),
    (StaticGain([[1, 0, 1], [0, 1, 0]]), 3, 2, 0.0),
    (FixedOrder(3), 3, 2, 0.0),
    (FixedOrder(0), 1, 2, 0.0),
    (FixedOrder(3, strictly_proper=True), 3, 2, 0.1),
    (PID(tau=(0.1, 1.0)), 2, 2, 0.0),
    (PID(tau=(0.1, 1.0)), 2, 2, 0.1),
    (MultichannelPID(terms="PD", tau=(0.1, 2.0)), 2, 3, 0.0),
    (MultichannelPID("ipd"), 6, 2, 0.0),
    (MultichannelPID("two-layer", "diagonal"), 8, 2, 0.0),
    (FixedPoles([-1, -2 + 1j, -2 - 1j]), 2, 2, 0.0),
    (Decentralised([PID(tau=(0.1, 1.0)), FixedOrder(2)]), 2, 2, 0.0),
    (StaticGain() + FixedPoles([-1], strictly_proper=True), 2, 2, 0.0),
]


@pytest.mark.parametrize(("structure", "n_y", "n_u", "dt"), CASES)
def test_the_pullback_is_the_derivative(structure, n_y, n_u, dt):
    """Against complex steps."""
    law = law_of(structure, n_y, n_u, dt)
    rng = np.random.default_rng(0)
    p = rng.uniform(0.2, 1.0, len(law.parameters))
    G = rng.standard_normal(law.packed(p).shape)
    steps = [(law.packed(p + 1e-20j * e) * G).sum().imag * 1e20 for e in np.eye(len(p))]
    np.testing.assert_allclose(law.pullback(p, G), steps, rtol=1e-12, atol=1e-13)
    k, n_u, n_y = law.sizes
    assert law.packed(p).shape == (k + n_u, k + n_y)
    names = [q.name for q in law.parameters]
    assert len(set(names)) == len(names)


def test_a_pid_is_its_transfer_function():
    law = law_of(PID(tau=(0.01, 1.0)), 1, 1)
    assert [(q.name, q.unit) for q in law.parameters] == [
        ("Kp[1]", "V/rad"),
        ("Ki[1]", "V/(rad s)"),
        ("Kd[1]", "V s/rad"),
        ("tau", "s"),
    ]
    s = 1j * OMEGA
    expected = 2.0 + 3.0 / s + 0.5 * s / (0.1 * s + 1)
    K = law.model(np.array([2.0, 3.0, 0.5, 0.1]), 0.0)
    np.testing.assert_allclose(frequency_response(K, OMEGA)[:, 0, 0], expected, rtol=1e-12)


def test_a_discrete_pid_is_its_difference_equation():
    """Forward Euler for the integral, backward Euler for the filtered derivative."""
    dt, tau = 0.1, 0.3
    K = law_of(PID(tau=(0.01, 1.0)), 1, 1, dt).model(np.array([2.0, 3.0, 0.5, tau]), dt)
    z = np.exp(1j * OMEGA * dt)
    expected = 2.0 + 3.0 * dt / (z - 1) + 0.5 * (z - 1) / ((tau + dt) * z - tau)
    np.testing.assert_allclose(frequency_response(K, OMEGA)[:, 0, 0], expected, rtol=1e-12)


def test_fixed_poles_are_the_controllers_poles():
    law = law_of(FixedPoles([-1.0, -2 + 1j, -2 - 1j]), 1, 1)
    p = np.array([5.0, 2.0, 3.0, 0.25])
    K = law.model(p, 0.0)
    assert sorted(K.poles(), key=lambda x: (x.real, x.imag)) == pytest.approx([-2 - 1j, -2 + 1j, -1])
    s = 1j * OMEGA
    # The 2 x 2 block of a pair acts on (1, 0): residues a (s + 2) - b over ((s + 2)^2 + 1).
    expected = 5 / (s + 1) + (2 * (s + 2) - 3) / ((s + 2) ** 2 + 1) + 0.25
    np.testing.assert_allclose(frequency_response(K, OMEGA)[:, 0, 0], expected, rtol=1e-12)


def test_the_two_layers_are_the_thesis_controller():
    rng = np.random.default_rng(3)
    low = TorqueGains(kp=2.0, kd=3.0, ki=5.0)
    gains = {name: rng.standard_normal((6, 6)) for name in ("Kp", "Kd", "Ki")}
    made = LayeredController(upper_layer(**gains), low, Trim("unused", *np.zeros((3, 6)), 0.0))
    model = made.state_space()
    law = MultichannelPID("two-layer").law(model.inputs, model.outputs, 0.0)
    values = {f"{name}[{i + 1},{j + 1}]": x for name, gain in gains.items() for (i, j), x in np.ndenumerate(gain)}
    values |= {"kp": low.kp, "kd": low.kd, "ki": low.ki}
    K = law.model(np.array([values[q.name] for q in law.parameters]), 0.0)
    for ours, theirs in ((K.A, model.A), (K.B, model.B), (K.C, model.C), (K.D, model.D)):
        np.testing.assert_array_equal(ours, theirs)
    units = {q.name: q.unit for q in law.parameters}
    assert units["Kp[1,1]"] == "N m/rad"
    assert units["kd"] == "V/N m"
    assert len(law.parameters) == 3 * 36 + 3


def test_decentralised_parts_take_named_channels():
    parts = [Part(StaticGain(), ["y3"], ["u1"]), Part(FixedPoles([-1.0]), ["y1", "y2"], ["u2"])]
    law = law_of(Decentralised(parts), 3, 2)
    p = np.arange(1.0, len(law.parameters) + 1)
    K = frequency_response(law.model(p, 0.0), [0.5])[0]
    assert (np.abs(K) > 0).tolist() == [[False, False, True], [True, True, False]]
    assert [q.name for q in law.parameters][:2] == ["1.K[u1,y3]", "2.R1[u2,y1]"]
