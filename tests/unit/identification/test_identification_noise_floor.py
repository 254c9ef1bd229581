"""Noise floor: periods that are known, noise of known size and colour, and every record that does not repeat."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import robustlab as rl
from robustlab.errors import NoTrustworthyNumber
from robustlab.identification.comparison import NoiseFloor, noise_floor, period_of
from robustlab.record import Record

DT = 0.01


def periodic(n, count, seed=0, tail=0):
    one = np.repeat(np.random.default_rng(seed).standard_normal(n // 10), 10)
    return np.concatenate([one[len(one) - tail :], np.tile(one, count)])


def record(u, noise=0.1, seed=1, gain=2.0, **more):
    rng = np.random.default_rng(seed)
    return Record(np.arange(len(u)) * DT, {"u": u, **more}, {"y": gain * u + noise * rng.standard_normal(len(u))})


def coloured(shape, pole, seed):
    from scipy.signal import lfilter

    rng = np.random.default_rng(seed)
    return lfilter([1.0], [1.0, -pole], rng.standard_normal(shape[0] * shape[1] + 500))[500:].reshape(shape)


@settings(max_examples=60)
@given(n=st.integers(8, 60), count=st.integers(2, 5), tail=st.integers(0, 59), seed=st.integers(0, 10**6))
def test_a_period_is_found_wherever_the_record_ends(n, count, tail, seed):
    one = np.random.default_rng(seed).standard_normal(n)
    assert period_of(np.resize(one, count * n + tail % n)) == n


@settings(max_examples=40)
@given(n=st.integers(20, 300), seed=st.integers(0, 10**6))
def test_noise_and_a_ramp_have_no_period(n, seed):
    x = np.random.default_rng(seed).standard_normal(n)
    assert period_of(x) is None
    assert period_of(np.arange(float(n))) is None
    assert period_of(np.round(1000 * np.arange(n) / n)) is None  # a ramp in fine steps: neighbours are nearly alike
    assert period_of(np.full(n, 3.0)) is None


@pytest.mark.parametrize(("count", "tail"), [(2, 0), (3, 70), (12, 150)])
def test_std_is_that_of_a_single_sample(count, tail):
    floor = noise_floor(record(periodic(2000, count, tail=tail)))
    assert (floor.signal, floor.count, floor.samples, floor.first) == ("u", count, 2000, tail)
    assert floor.period == pytest.approx(2000 * DT)
    # Relative standard deviation of the estimate: 1 / sqrt(2 (count - 1) 2000).
    assert floor.std["y"] == pytest.approx(0.1, rel=4 / np.sqrt(4000 * (count - 1)))
    assert floor.input_std == {}


@pytest.mark.parametrize("pole", [0.0, 0.9, 0.99])
def test_p_values_are_uniform_for_coloured_noise_without_a_model_error(pole):
    floor = NoiseFloor("u", 10.0, 1000, 3, 0, {"y": 1.0}, {}, ())
    found = [floor.excess(coloured((3, 1000), pole, seed).ravel()) for seed in range(300)]
    p = np.array([e.p_value for e in found])
    # 3 sigma of a binomial with n = 300, plus what an estimated number of degrees may be off.
    assert np.mean(p < 0.05) <= 0.05 + 3 * np.sqrt(0.05 * 0.95 / 300)
    assert np.mean(p < 0.5) == pytest.approx(0.5, abs=3 * 0.5 / np.sqrt(300))
    assert np.mean([e.F for e in found]) == pytest.approx(1.0, abs=0.1)
    # var(mean square) = 2 sigma^4 / dof defines the effective number of samples; for AR(1): N (1 - a^2) / (1 + a^2).
    assert np.median([e.dof[0] for e in found]) == pytest.approx(1000 * (1 - pole**2) / (1 + pole**2), rel=0.35)


def test_excess_is_the_known_ratio_where_a_part_repeats():
    n, count, sigma = 5000, 4, 0.2
    missing = 0.1 * np.sin(2 * np.pi * np.arange(n) / n)
    rng = np.random.default_rng(0)
    floor = noise_floor(record(periodic(n, count)))
    residuals = [(missing + sigma * rng.standard_normal((count, n))).ravel() for _ in range(40)]
    found = [floor.excess(r) for r in residuals]
    # A single repeatable rms scatters by 3 %, the mean of 40 by 0.5 %.
    assert np.mean([x.F for x in found]) == pytest.approx(1.0 + count * 0.005 / sigma**2, rel=0.02)
    assert np.mean([x.repeatable for x in found]) == pytest.approx(0.1 / np.sqrt(2), rel=0.015)
    assert np.mean([x.noise for x in found]) == pytest.approx(sigma, rel=0.005)
    assert max(x.p_value for x in found) < 1e-6


def test_in_closed_loop_the_reference_determines_the_period():
    rng = np.random.default_rng(0)
    ref = periodic(1000, 4)
    y, v, u = np.zeros(4000), 0.0, np.zeros(4000)
    for k in range(4000):
        y[k] = v + 0.05 * rng.standard_normal()
        u[k] = 2.0 * (ref[k] - y[k])
        v += 0.05 * (u[k] - v)
    t = np.arange(4000) * DT
    unknown = Record(t, {"u": u}, {"y": y, "ref": ref})
    floor = noise_floor(unknown, outputs=["y"])
    assert (floor.signal, floor.samples) == ("ref", 1000)
    assert floor.input_std["u"] == pytest.approx(2.0 * floor.std["y"], rel=1e-6)  # the reference cancels
    with pytest.raises(NoTrustworthyNumber, match="repeats") as caught:
        noise_floor(Record(t, {"u": u}, {"y": y}))
    assert caught.value.exit_code == 4


def test_a_perfect_model_leaves_nothing_to_explain_and_a_wrong_one_does():
    t = np.arange(4000) * DT
    u = np.tile(np.repeat(np.random.default_rng(0).uniform(-3, 3, 20), 50), 4)
    truth = rl.simulate(rl.plant("servo-axis"), t, u)["q"]
    q = truth + 1e-4 * np.random.default_rng(1).standard_normal(4000)
    r = Record(t, {"u": u}, {"q": q}, {"u": "V", "q": "m"})
    right = rl.compare(rl.plant("servo-axis"), r, window=1.0).against_noise["q"]
    assert pytest.approx(1.0, abs=0.2) == right.F
    assert right.p_value > 0.01
    wrong = rl.compare(rl.plant("servo-axis", Fv=260.0), r, window=1.0)
    assert wrong.against_noise["q"].p_value < 1e-6
    assert "leaves something to explain" in wrong.summary()
