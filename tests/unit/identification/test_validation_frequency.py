"""`rl.validate` in the frequency domain: against brute force, closed forms and cvxpy, and what it refuses."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import cont2discrete

import robustlab as rl

LAG = rl.StateSpaceModel([[-1.0]], [[1.0]], [[1.0]], [[0.0]], 0.0, ["u"], ["y"])
OMEGA = np.geomspace(0.1, 10, 9)
AT = 1 / (1j * OMEGA + 1)
DELAY = 0.7 * np.exp(-1.3j * OMEGA)


def response(form):
    return {
        "additive": AT + 0.3 * DELAY,
        "output-multiplicative": AT * (1 + 0.3 * DELAY),
        "inverse-output-multiplicative": AT / (1 - 0.3 * DELAY),
    }[form]


@pytest.mark.parametrize("form", ["additive", "output-multiplicative", "inverse-output-multiplicative"])
def test_one_block_against_every_noise_in_its_disk(form):
    model, G, bound = rl.unstructured(LAG, 0.3, form), response(form), 0.04
    found = rl.validate(model, rl.FrequencyData(OMEGA, G, "u", ["y"]), {"y": bound}, domain="frequency")
    # Delta is known where the true output is: try all of the noise disk.
    radius, angle = np.meshgrid(np.linspace(0, bound, 200), np.linspace(0, 2 * np.pi, 721))
    true = G[:, None] - (radius * np.exp(1j * angle)).ravel()
    delta = {
        "additive": (true - AT[:, None]) / 0.3,
        "output-multiplicative": (true / AT[:, None] - 1) / 0.3,
        "inverse-output-multiplicative": (1 - AT[:, None] / true) / 0.3,
    }[form]
    wanted = np.abs(delta).min(axis=1).max()
    assert found.status is rl.Status.CERTIFIED
    assert found.lower <= wanted * (1 + 1e-9)
    assert found.upper == pytest.approx(wanted, rel=1e-4)
    assert found.replay_error < 1e-6


def several(rng, outputs=2):
    """Two inputs of Delta that are known: blocks of 1 x 1, 2 x 1 and 1 x 2 on a random stable model."""
    q, p = 4, 4
    A = -np.diag(rng.uniform(0.3, 3, 3))
    C, D = rng.standard_normal((p + outputs, 3)), rng.standard_normal((p + outputs, q + 1))
    B = rng.standard_normal((3, q + 1))
    C[:p], D[:p, :q] = 0.0, 0.0  # z is a gain of u: known
    M = rl.StateSpaceModel(A, B, C, D, 0.0, [*(f"w{i}" for i in range(q)), "u"],
                           [*(f"z{i}" for i in range(p)), *(f"y{j}" for j in range(outputs))])  # fmt: skip
    return rl.UncertainModel(M, [rl.FullBlock("a", 1, 1), rl.FullBlock("b", 2, 1), rl.FullBlock("c", 1, 2)])


def test_several_blocks_and_outputs_against_cvxpy():
    import cvxpy as cp

    rng = np.random.default_rng(3)
    model, n = several(rng), 3
    omega = np.array([0.3, 1.0, 4.0])
    nominal = rl.frequency_response(model.nominal, omega)[:, :, 0]
    G = nominal + rng.standard_normal((n, 2)) + 1j * rng.standard_normal((n, 2))
    bound = {"y0": 0.1, "y1": np.array([0.2, 0.3, 0.4])}
    found = rl.validate(model, rl.FrequencyData(omega, G, "u", ["y0", "y1"]), bound, domain="frequency")
    M = rl.frequency_response(model.M, omega)
    worst = 0.0
    for k in range(n):
        w, gamma, z = cp.Variable(4, complex=True), cp.Variable(), M[k, :4, 4]
        left = G[k] - nominal[k] - M[k, 4:, :4] @ w
        limits = [cp.norm(w[:1]) <= gamma * abs(z[0]), cp.norm(w[1:3]) <= gamma * abs(z[1]),
                  cp.norm(w[3:]) <= gamma * np.linalg.norm(z[2:]),
                  cp.abs(left[0]) <= 0.1, cp.abs(left[1]) <= bound["y1"][k]]  # fmt: skip
        worst = max(worst, cp.Problem(cp.Minimize(gamma), limits).solve(solver="CLARABEL"))
    assert found.upper == pytest.approx(worst, rel=1e-5)
    assert found.lower == pytest.approx(worst, rel=1e-5)


def held_response(model, f, dt):
    """The response (n_f,) at f in Hz of a model whose input is held between samples, by scipy."""
    A, B, C, D, _ = cont2discrete((model.A, model.B, model.C, model.D), dt)
    return np.array([(C @ np.linalg.solve(np.exp(2j * np.pi * k * dt) * np.eye(len(A)) - A, B) + D)[0, 0] for k in f])


def steady(model, values, periods=3, n=64, noise=0.0, seed=0):
    """A record of whole periods of a member, after its transient."""
    rng = np.random.default_rng(seed)
    u = np.sign(rng.standard_normal(n))
    many = np.tile(u, periods + 8)
    y = rl.simulate(model.evaluate(values), np.arange(len(many)) * 0.2, {"u": many})["y"][-n * periods :]
    y = y + noise * rng.standard_normal(n * periods)
    return rl.Record(np.arange(n * periods) * 0.2, {"u": np.tile(u, periods)}, {"y": y})


def test_a_record_against_the_closed_form():
    model = rl.unstructured(LAG, 0.3, "output-multiplicative")
    record, bound, n = steady(model, {"unmodelled": 0.7}, noise=0.02), 0.021, 64
    found = rl.validate(model, record, {"y": bound}, domain="frequency")
    y = record["y"].reshape(-1, n)
    f = np.arange(n // 2 + 1) / (n * 0.2)
    forced = held_response(LAG, f, 0.2) * np.fft.rfft(record["u"][:n]) / n
    e = np.abs(np.fft.rfft(y.mean(axis=0)) / n - forced)
    weight = np.where((np.arange(n // 2 + 1) % (n // 2)) == 0, 1.0, 2.0)
    left = bound**2 - ((y - y.mean(axis=0)) ** 2).mean()

    def energy(gamma):
        return weight @ np.maximum(e - gamma * 0.3 * np.abs(forced), 0) ** 2

    low, high = 0.0, 1.0
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (middle, high) if energy(middle) > left else (low, middle)
    assert found.status is rl.Status.CERTIFIED
    assert found.upper == pytest.approx(high, rel=1e-5)
    assert found.lower == pytest.approx(high, rel=1e-5)
    assert np.sqrt(np.mean((found.measured - found.explained) ** 2)) <= bound
    assert found.line_sizes.shape == (n // 2 + 1, 1)


@given(seed=st.integers(0, 10_000))
@settings(max_examples=8)
def test_a_true_model_is_never_invalidated(seed):
    rng = np.random.default_rng(seed)
    form = ["additive", "output-multiplicative", "inverse-output-multiplicative", "inverse-additive"][seed % 4]
    model = rl.unstructured(LAG, 0.4, form)
    record = steady(model, {"unmodelled": rng.uniform(-1, 1)}, noise=0.01, seed=seed)
    clean = steady(model, {"unmodelled": rng.uniform(-1, 1)}, seed=seed)
    assert rl.validate(model, clean, {"y": 1e-3}, domain="frequency").replay_error < 1e-6
    assert not rl.validate(model, record, {"y": 0.013}, domain="frequency").invalidated


def test_an_unreachable_harmonic_is_invalidated_at_every_gamma():
    model = rl.unstructured(LAG, 0.3)
    record = steady(model, {"unmodelled": 0.5})
    harmonic = 0.3 * np.tile(np.cos(2 * np.pi * np.arange(64) * 5 / 64), 3)
    u = np.tile(np.sin(2 * np.pi * np.arange(64) / 64), 3)  # one line is driven, another one answers
    t = np.arange(192) * 0.2
    found = rl.validate(model, rl.Record(t, {"u": u}, {"y": harmonic}), {"y": 0.02}, domain="frequency")
    assert found.status is rl.Status.INFEASIBLE
    assert found.verdict == "invalidated at every gamma"
    assert found.excess == pytest.approx(0.3 / np.sqrt(2) / 0.02, rel=0.01)
    assert rl.validate(model, record, {"y": 0.02}, domain="frequency").blocks["unmodelled"].size <= 0.51


@pytest.mark.parametrize("form", ["inverse-output-multiplicative", "inverse-additive"])
def test_an_undriven_loop_is_at_zero(form):
    """A harmonic that the input does not hold is not explained by a Delta that makes the loop singular."""
    model, t = rl.unstructured(LAG, 0.4, form), np.arange(192) * 0.2
    u = np.tile(np.sin(2 * np.pi * np.arange(64) / 64), 3)
    y = 0.8 * np.tile(np.sin(2 * np.pi * np.arange(64) / 64), 3) + 0.3 * np.cos(2 * np.pi * np.arange(192) * 3 / 64)
    found = rl.validate(model, rl.Record(t, {"u": u}, {"y": y}), {"y": 0.02}, domain="frequency")
    assert found.verdict == "invalidated at every gamma"


def test_an_integrator_is_judged_without_its_mean():
    axis = rl.StateSpaceModel([[0.0, 1.0], [0.0, -2.0]], [[0.0], [1.0]], [[1.0, 0.0]], [[0.0]], 0.0, ["u"], ["y"])
    model, n = rl.unstructured(axis, 0.2, "input-multiplicative"), 60
    t, u = np.arange(3 * n) * 0.1, np.tile(np.sign(np.sin(2 * np.pi * (np.arange(n) + 0.5) / n)), 3)
    U = np.fft.rfft(u[:n])
    G = np.zeros(n // 2 + 1, dtype=complex)
    G[1:] = held_response(axis, np.arange(1, n // 2 + 1) / (n * 0.1), 0.1)
    y = np.tile(np.fft.irfft(1.1 * G * U, n), 3) + 0.4
    found = rl.validate(model, rl.Record(t, {"u": u}, {"y": y}), {"y": 1e-4}, domain="frequency")
    assert found.upper == pytest.approx(0.5, rel=1e-2)
    assert any("integrates" in text for text in found.assumptions)


def test_invalid_input_is_refused():
    model = rl.unstructured(LAG, 0.3)
    record = steady(model, {"unmodelled": 0.5})
    data = rl.FrequencyData(OMEGA, response("additive"), "u", ["y"])
    lines = {"domain": "frequency"}
    start = rl.Record(record.t, record.inputs, {"y": record["y"] + np.exp(-record.t / 30)})
    moving = rl.Record(record.t, {"u": record["u"] + 0.3 * np.sin(record.t**1.3)}, record.outputs)
    refused = [
        ((model, record, {"y": 0.1}), {"domain": "both"}, rl.InputError, "domain"),
        ((model, record, {"y": 0.1}), {"window": 3.0, **lines}, rl.InputError, "windows"),
        ((model, record, {"y": 0.0}), lines, rl.NoTrustworthyNumber, "singular noise model"),
        ((model, start, {"y": 0.01}), lines, rl.NoTrustworthyNumber, "not in steady state"),
        ((model, moving, {"y": 0.1}), lines, rl.NoTrustworthyNumber, "no steady periods"),
        ((model, data, {"y": 0.1}), {}, rl.InputError, "in the time domain"),
        ((model, data, {}), lines, rl.InputError, "no noise bound"),
        ((model, data, {"x": 0.1}), lines, rl.InputError, "no such compared output"),
        ((model, data, {"y": np.zeros(9)}), lines, rl.NoTrustworthyNumber, "singular noise model"),
        ((model, data, {"y": np.ones(3)}), lines, rl.InputError, "shape"),
    ]  # fmt: skip
    for arguments, options, error, words in refused:
        with pytest.raises(error, match=words):
            rl.validate(*arguments, **options)
    real = rl.plant("mass-spring-damper", m=2.0, c=(1.5, 0.25), k=8.0).uncertain()
    with pytest.raises(rl.InputError, match="real constant"):
        rl.validate(real, rl.FrequencyData(OMEGA, AT, "f", ["q"]), {"q": 0.1}, **lines)
    twice = rl.UncertainModel(rl.StateSpaceModel([], [], [], np.ones((3, 3)) - np.eye(3), 0.0, ["w1", "w2", "u"],
                                                 ["z1", "z2", "y"]), [rl.ComplexScalar("d", 2)])  # fmt: skip
    with pytest.raises(rl.InputError, match="repeated 2 times"):
        rl.validate(twice, data, {"y": 0.1}, **lines)
    for omega, G in (([1.0, 1.0], [1, 1]), ([1.0, np.nan], [1, 1]), ([1.0], [1, 2]), ([1.0, 2.0], [1, np.inf])):
        with pytest.raises(rl.InputError):
            rl.FrequencyData(omega, G, "u", ["y"])
