"""Inputs between their samples and shifted in time, against closed forms and scipy's integrator."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy.integrate import solve_ivp

import robustlab as rl
from robustlab.dynamics import SampledInput, Simulator, Site, Windows, effect

HOLDS = ("zoh", "linear", "smooth")
signals = hnp.arrays(np.float64, st.integers(2, 40), elements=st.floats(-10, 10))
DT = 1e-3


def whole(n):
    return Windows(np.array([0]), n)


def oscillator(samples_a_period, ratio=0.01):
    omega = 2 * np.pi / (samples_a_period * DT)
    return rl.plant("mass-spring-damper", m=1.0, k=omega**2, c=2 * ratio * omega), omega


@given(signals, st.integers(-50, 50), st.integers(1, 5), st.sampled_from(HOLDS))
def test_a_shift_by_whole_samples_shifts_the_record(u, late, sub, hold):
    n = len(u)
    moved = SampledInput(u, hold).steps(sub, late).reshape(n, sub, 2)
    plain = SampledInput(u, hold).steps(sub).reshape(n, sub, 2)
    size = 1e-9 * (1 + np.abs(plain).max())
    for k in range(n):
        if k < late:
            expected = np.full((sub, 2), u[0])
        elif k - late > n - 1:
            expected = np.full((sub, 2), u[-1])
        else:
            expected = plain[k - late]
        assert np.abs(moved[k] - expected).max() <= size


@pytest.mark.parametrize("samples_a_period", [8, 9, 12])
def test_a_resonance_under_a_continuous_force(samples_a_period):
    plant, omega = oscillator(samples_a_period)
    k, c = plant.values["k"], plant.values["c"]
    n, late = 400, 0.37 * DT

    def force(t):
        return k * (np.sin(omega * t + 0.3) + 0.4 * np.cos(0.7 * omega * t))

    t = np.arange(n) * DT
    for shift in (0.0, late):
        truth = solve_ivp(
            lambda s, x, shift=shift: [x[1], force(s - shift) - c * x[1] - k * x[0]],
            (0, t[-1]), [0, 0], t_eval=t, rtol=1e-10, atol=1e-12, method="DOP853",
        ).y  # fmt: skip
        first = 10  # the input is constant before the first sample
        for sub in (2, 4):
            run = Simulator(plant, [], force(t)[:, None], DT, sub=sub, hold=("smooth",))
            window = Windows(np.array([first]), n - first)
            found = run.run({}, [], truth[None, :, first], window, (shift,)).outputs[0, :, 0]
            assert np.abs(found - truth[0, first:]).max() < 1e-4 * np.abs(truth[0]).max()


def test_a_delay_equals_a_shift():
    plant, _ = oscillator(20)
    u = np.random.default_rng(4).normal(size=(90, 1))
    pairs = [(effect("input-dead-zone"), Site("input", "f")), (effect("input-delay"), Site("input", "f"))]
    values = [{"d": 0.2}, {"d": 1.3e-3}]
    late = Simulator(plant, pairs, u, DT, sub=2).run({}, values, np.zeros((1, 2)), whole(90)).outputs
    moved = Simulator(plant, pairs[:1], u, DT, sub=2)
    moved = moved.run({}, values[:1], np.zeros((1, 2)), whole(90), (1.3e-3,)).outputs
    assert (late == moved).all()
