"""Discrete models of continuous ones with delays: exact at the samples, whatever the lengths."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm

import robustlab as rl

LAG = rl.StateSpaceModel([[-1.0]], [[1.0]], [[1.0]], [[0.0]])


def held(model, t, u):
    run = rl.simulate(model, t, u)
    return np.column_stack([run.outputs[name] for name in model.output_names])


@pytest.mark.parametrize("seed", range(12))
def test_it_is_the_response_by_the_method_of_steps(seed):
    rng = np.random.default_rng(seed)
    n, dt = 3, 0.1
    A = rng.standard_normal((n, n)) - 2.5 * np.eye(n)
    D = rng.standard_normal((2, 2)) * (seed % 2)
    G = rl.StateSpaceModel(A, rng.standard_normal((n, 2)), rng.standard_normal((2, n)), D)
    taus = [float(rng.choice([0.0, 0.1, 0.3, rng.uniform(0, 0.45), rng.uniform(0, 0.09)])) for _ in range(4)]
    late = rl.with_delays(G, inputs={0: taus[0], 1: taus[1]}, outputs={0: taus[2], 1: taus[3]})
    if seed % 3 == 0:
        late = late + rl.with_delays(G, inputs={0: 0.17})
    discrete = rl.discretise(late, dt, "zoh")
    t, u = np.arange(60) * dt, rng.standard_normal((60, 2))
    y = held(late, t, u)
    assert np.abs(held(discrete, t, u) - y).max() < 1e-12 * (1.0 + np.abs(y).max())
    assert discrete.input_names == late.input_names
    assert discrete.output_names == late.output_names


def test_it_is_the_convolution_by_hand():
    A, B = np.array([[-1.0, 0.3], [0.0, -2.0]]), np.array([[1.0, 0.0], [0.5, 1.0]])
    taus, dt, rng = (0.1, 0.025, 0.083, 0.048), 0.1, np.random.default_rng(4)
    t, u = np.arange(20) * dt, rng.standard_normal((20, 2))

    def state(time):
        total = np.zeros(2)
        for j in range(2):
            for k in range(20):
                begin, end = t[k] + taus[j], min(t[k] + taus[j] + dt, time)
                if end > begin:
                    block = np.zeros((3, 3))
                    block[:2, :2], block[:2, 2] = A * (end - begin), B[:, j] * (end - begin)
                    total = total + expm(A * (time - end)) @ expm(block)[:2, 2] * u[k, j]
        return total

    model = rl.StateSpaceModel(A, B, np.eye(2), np.zeros((2, 2)))
    late = rl.with_delays(model, inputs={0: taus[0], 1: taus[1]}, outputs={0: taus[2], 1: taus[3]})
    exact = np.array([[state(s - taus[2])[0], state(s - taus[3])[1]] for s in t])
    assert np.abs(held(rl.discretise(late, dt, "zoh"), t, u) - exact).max() < 1e-14


def test_what_has_no_finite_exact_model_is_refused():
    with pytest.raises(rl.InputError, match=r"(?s)inside a loop.*close the loop then"):
        rl.discretise((LAG @ rl.delay(0.2)).feedback(), 0.1, "zoh")
    with pytest.raises(rl.InputError, match="inside a loop or between"):
        rl.discretise(LAG @ rl.delay(0.2) @ LAG, 0.1, "zoh")
    with pytest.raises(rl.InputError, match="'zoh'"):
        rl.discretise(rl.with_delays(LAG, inputs={0: 0.2}), 0.1)
    with pytest.raises(rl.InputError, match="samples of delay"):
        rl.discretise(rl.with_delays(LAG, inputs={0: 2.0}), 1e-4, "zoh")
