"""Best linear approximation and even/odd shares against closed forms: static nonlinearities and linear filters."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import robustlab as rl
from robustlab import Record, StateSpaceModel
from robustlab.identification.comparison import (
    arbitrary_bla,
    bins,
    directions,
    even_odd,
    held_response,
    noise_floor,
    periodic_bla,
)

N, DT = 512, 0.01


def lag(pole=3.0):
    return StateSpaceModel([[-pole]], [[pole]], [[1.0]], [[0.0]], inputs=["u"], outputs=["y"])


def multisine(lines, amplitude=1.0, seed=0):
    phase = np.random.default_rng(seed).uniform(0, 2 * np.pi, len(lines))
    return amplitude * np.cos(2 * np.pi * np.outer(np.arange(N), lines) / N + phase).sum(axis=1)


def filtered(x, response):
    """A periodic signal through a filter, by its lines: exact."""
    spectrum = np.fft.rfft(x)
    lines = np.arange(len(spectrum))
    return np.fft.irfft(spectrum * np.array([response(k) for k in lines]), N)


def test_the_response_for_held_inputs_is_that_of_the_simulated_samples():
    model = StateSpaceModel([[0.0, 1.0], [-40.0, -0.6]], [[0.0], [40.0]], [[1.0, 0.0]], [[0.2]])
    u = multisine([3, 11, 40])
    y = rl.simulate(model, np.arange(40 * N) * DT, np.tile(u, 40), [0.0, 0.0])["y1"][-N:]
    lines = np.array([3, 11, 40])
    expected = np.fft.rfft(y)[lines] / np.fft.rfft(u)[lines]
    np.testing.assert_allclose(held_response(model, lines / (N * DT), DT)[:, 0, 0], expected, rtol=1e-9)


def test_a_linear_system_without_noise_is_found_exactly_and_is_the_model():
    u = multisine(np.arange(1, 100))
    y = rl.simulate(lag(), np.arange(12 * N) * DT, np.tile(u, 12), [0.0])["y"].reshape(12, N)[-3:]
    found = periodic_bla(np.tile(u, (3, 1)), y, DT, lag())
    np.testing.assert_allclose(found.response, found.model, rtol=1e-9)
    assert found.frequency[0] == pytest.approx(1 / (N * DT))
    assert max(found.relative_error) < 1e-9
    assert set(found.outside) == {0.0}
    assert found.coherence.min() > 1 - 1e-12


def test_noise_deviation_covers_the_true_response_as_often_as_stated():
    u, rng = multisine(np.arange(1, 60)), np.random.default_rng(0)
    clean = rl.simulate(lag(), np.arange(10 * N) * DT, np.tile(u, 10), [0.0])["y"][-N:]
    hits, distortion, noise = [], [], []
    for _ in range(60):
        found = periodic_bla(np.tile(u, (6, 1)), clean + 0.3 * rng.standard_normal((6, N)), DT, lag())
        hits += [np.mean(np.abs(found.response - found.model) ** 2 / found.noise_std**2)]
        noise += [np.mean(found.noise_std**2)]
        distortion += [np.mean(found.nonlinear_std**2)]
    # E |G - G0|^2 = noise variance; its estimate in the denominator has 10 degrees: E 1/chi2_10 = 10/8.
    assert np.mean(hits) == pytest.approx(10 / 8, rel=0.06)
    # The exact variance: 2 sigma^2 over N |U|^2-scaled lines, over 6 periods.
    assert np.mean(noise) == pytest.approx(4 * 0.3**2 / N / 6, rel=0.05)
    assert np.mean(distortion) < np.mean(noise)


def distortion_of_a_cube(lines, amplitude):
    """Expected |Y_k|^2 (Y = FFT / N) of x^3 at every one of the odd lines, less the part coherent with the input."""
    signed = np.concatenate([-lines[::-1], lines]).tolist()
    power = dict.fromkeys(lines.tolist(), 0.0)
    for i, p in enumerate(signed):
        for q in signed[i:]:
            for k in power:
                r = k - p - q
                if r < q or r > signed[-1] or r % 2 == 0 or 0 in (p + q, p + r, q + r):
                    continue
                orders = {1: 1, 2: 3, 3: 6}[len({p, q, r})]
                power[k] += (orders * (amplitude / 2) ** 3) ** 2
    return np.array(list(power.values()))


def test_cubic_in_front_of_a_filter_has_the_published_gain_and_distortion():
    # y = H x^3 for F equal random-phase tones of amplitude A: gain 3 sigma^2 - 3 A^2 / 4, sigma^2 = F A^2 / 2.
    lines, amplitude = np.arange(1, 101, 2), 0.2
    response = lambda k: 1.0 / (1.0 + 0.05j * k)  # noqa: E731
    variance = len(lines) * amplitude**2 / 2
    gain = 3 * variance - 0.75 * amplitude**2
    h = np.array([response(k) for k in lines])
    # Every combination of three tones that ends at a line and holds no tone with its own negative is a distortion.
    expected = distortion_of_a_cube(lines, amplitude) * np.abs(h) ** 2 / (amplitude / 2) ** 2
    # The scatter from line to line estimates it: a single realisation to 0.9, 300 of them to 0.05.
    inner, single, responses = slice(4, -4), [], []
    for seed in range(1000, 1300):
        x = multisine(lines, amplitude, seed)
        g = periodic_bla(np.tile(x, (2, 1)), np.tile(filtered(x**3, response), (2, 1)), DT)
        single.append(np.mean(g.nonlinear_std[inner] ** 2 / expected[inner]))
        responses.append(g.response / (gain * h))
    assert abs(np.mean(responses) - 1) < 4 * np.std(responses) / np.sqrt(np.size(responses))
    assert g.noise_std.max() < 1e-12
    assert np.mean(single) == pytest.approx(1.0, abs=0.15)


def test_welch_finds_two_inputs_and_its_deviation_is_honest():
    rng = np.random.default_rng(0)
    n = 60_000
    u, w = rng.standard_normal(n), rng.standard_normal(n)
    w = w + 0.6 * u  # correlated inputs
    model = StateSpaceModel(
        [[0.5, 0.0], [0.0, 0.8]], np.eye(2), [[1.0, -0.3]], [[0.0, 0.0]], dt=DT, inputs=["u", "w"], outputs=["y"]
    )
    t = np.arange(n) * DT
    y = rl.simulate(model, t, {"u": u, "w": w}, [0.0, 0.0])["y"] + 0.5 * rng.standard_normal(n)
    found = arbitrary_bla(t, {"u": u, "w": w}, y, model)
    for g in found.values():
        z = np.abs(g.response - g.model) ** 2 / g.std**2
        assert np.mean(z) == pytest.approx(1.0, abs=0.15)
        counts = np.array(g.band_table()["lines"])  # the variance is estimated too: an F distribution
        assert counts @ np.array(g.outside) / counts.sum() == pytest.approx(0.05, abs=0.015)
    # Coherence of signal and white noise: S / (S + N).
    wrong = arbitrary_bla(t, {"u": u, "w": w}, 1.3 * y, model)["u"]
    assert min(wrong.relative_error) == pytest.approx(0.3 / 1.3, rel=0.1)
    gain = StateSpaceModel(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), [[1.0]], inputs=["u"], outputs=["y"])
    flat = arbitrary_bla(t, {"u": u}, u + 0.5 * rng.standard_normal(n), gain)["u"]
    assert np.mean(flat.coherence) == pytest.approx(0.8, abs=0.02)


def judged(y, u, count=4, noise=0.0, seed=0):
    y = np.tile(y, count) + noise * np.random.default_rng(seed).standard_normal(count * N)
    t = np.arange(count * N) * DT
    floor = noise_floor(Record(t, {"u": np.tile(u, count)}, {"y": y}))
    return even_odd(floor, np.tile(u, count), {"y": y}, DT)


@settings(max_examples=25)
@given(
    a=st.floats(0.5, 2), b=st.floats(-1, 1), c=st.floats(-1, 1), A=st.floats(0.3, 2), line=st.sampled_from([1, 3, 7])
)
def test_shares_of_a_filtered_polynomial_of_one_tone_are_exact(a, b, c, A, line):
    """a x + b x^2 + c x^3 of A cos: A (a + 3 c A^2 / 4), b A^2 / 2, c A^3 / 4 at 1, 2, 3 times the line."""
    response = lambda k: 1.0 / (1.0 + 0.1j * k)  # noqa: E731
    x = A * np.cos(2 * np.pi * line * np.arange(N) / N)
    found = judged(filtered(a * x + b * x**2 + c * x**3, response), x)
    assert found.excitation.startswith("1 harmonics")  # whatever the line: the period is that of the tone
    gains = np.abs([response(line * k) for k in (1, 2, 3)]) ** 2
    power = np.array([(A * a + 0.75 * c * A**3) ** 2, (b * A**2 / 2) ** 2, (c * A**3 / 4) ** 2]) * gains
    shares = found.signals["y"]
    assert shares.even == pytest.approx(power[1] / power.sum(), rel=1e-9, abs=1e-13)
    assert shares.odd == pytest.approx(power[2] / power.sum(), rel=1e-9, abs=1e-13)
    assert shares.rms == pytest.approx(np.sqrt(power.sum() / 2), rel=1e-9)


def test_only_the_nonlinearity_that_is_there_is_found_in_noise():
    x = multisine([1, 3, 7, 9, 15, 21], 0.5)
    h = lambda k: 1.0 / (1.0 + 0.1j * k)  # noqa: E731
    for even, odd in ((0.0, 0.0), (0.1, 0.0), (0.0, 0.1)):
        s = judged(filtered(x + even * x**2 + odd * x**3, h), x, noise=0.02).signals["y"]
        assert (s.even_p < 1e-6) == (even > 0)
        assert (s.odd_p < 1e-6) == (odd > 0)
        assert ("even not beyond noise" in s.words()) == (even == 0)
        assert ("odd not beyond noise" in s.words()) == (odd == 0)


def test_false_alarms_are_as_rare_as_stated():
    x = multisine([1, 3, 7, 9], 0.5)
    found = [judged(x, x, noise=0.1, seed=seed).signals["y"] for seed in range(200)]
    p = np.array([[s.even_p, s.odd_p] for s in found])
    assert (p < 0.05).mean(axis=0) == pytest.approx(0.05, abs=0.05)
    assert (p < 0.5).mean(axis=0) == pytest.approx(0.5, abs=0.11)


def test_direction_and_amplitude_bins_are_direct_sums():
    speed = np.array([-1.0, -0.5, 0.0, 0.01, 0.4, 1.0])
    error = np.array([1.0, 1.0, 5.0, 5.0, 2.0, 4.0])
    found = directions(speed, error)
    assert [d.samples for d in found.values()] == [2, 2, 2]
    assert found["backward"].rms == pytest.approx(1.0)
    assert found["forward"].mean == pytest.approx(3.0)
    assert sum(d.share for d in found.values()) == pytest.approx(1.0)
    one_way = directions(np.abs(speed) + 1, error)["backward"]
    assert (one_way.samples, one_way.mean, one_way.rms, one_way.share) == (0, 0.0, 0.0, 0.0)
    t = np.arange(600) * DT
    u = np.repeat([0.0, 1.0, -2.0, 3.0], 150)
    y = rl.simulate(lag(), t, u, [0.0])["y"] * 1.1
    c = rl.compare(lag(), Record(t, {"u": u}, {"y": y}))
    local = c.measured["y"] - c.windowed["y"]
    groups = c.amplitude["y"]["u"]
    assert groups == bins(np.abs(u), local, np.linspace(0, 3, 7))
    assert sum(b.samples for b in groups) == 600
    assert c.noise is None
    assert "repeats" in c.noise_reason
    assert c.against_noise == {}
