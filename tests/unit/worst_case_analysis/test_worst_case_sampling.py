"""Samples and their responses: seeds, vertices, envelopes against a model-by-model simulation."""

import numpy as np
import pytest
import scipy.signal

from robustlab import (
    ComplexScalar,
    FullBlock,
    InputError,
    NoTrustworthyNumber,
    RealScalar,
    StateSpaceModel,
    Status,
    UncertainModel,
    elementwise,
    sample,
    simulate,
)

T = np.linspace(0.0, 4.0, 81)


def oscillator(c=0.4, k=4.0, d=0.0):
    return StateSpaceModel(
        [[0.0, 1.0], [-k, -c]], [[0.0], [1.0]], [[1.0, 0.0], [0.0, 1.0]], [[d], [0.0]],
        inputs=["f"], outputs=[("q", "m"), ("v", "m/s")],
    )  # fmt: skip


def uncertain(**changed):
    return elementwise(oscillator(), oscillator(**{"c": 0.7, "k": 5.0, "d": 0.1, **changed}))


def mixed():
    rng = np.random.default_rng(0)
    m = StateSpaceModel(
        -np.eye(2), 0.1 * rng.standard_normal((2, 6)), 0.1 * rng.standard_normal((5, 2)), np.zeros((5, 6))
    )
    return UncertainModel(m, [RealScalar("r"), ComplexScalar("c"), FullBlock("f", 3, 2)])


def test_sample_i_does_not_depend_on_n():
    few, many = sample(mixed(), 3, seed=7), sample(mixed(), 9, seed=7)
    for a, b in zip(few.deltas, many.deltas[:3], strict=True):
        assert a["r"] == b["r"]
        np.testing.assert_array_equal(a["f"], b["f"])
    assert sample(mixed(), 3, seed=8).deltas[0]["r"] != few.deltas[0]["r"]


def test_samples_are_in_the_set_and_fill_it():
    deltas = sample(mixed(), 400, seed=1).deltas
    real = np.array([d["r"] for d in deltas])
    disc = np.array([d["c"] for d in deltas])
    norms = np.array([np.linalg.norm(d["f"], 2) for d in deltas])
    assert np.abs(real).max() <= 1
    assert np.abs(real.mean()) < 0.1
    assert np.var(real) == pytest.approx(1 / 3, rel=0.15)
    assert np.abs(disc).max() <= 1
    assert (np.abs(disc) ** 2).mean() == pytest.approx(0.5, abs=0.06)  # uniform in the disc
    assert 0.9 < norms.max() <= 1


@pytest.mark.parametrize(
    ("arguments", "text"),
    [((0,), "no samples"), ((-1,), "n: -1"), ((1.5,), "n: 1.5"), ((1, -2), "seed"), ((1, 0, "every"), "vertices")],
)
def test_invalid_counts_are_rejected(arguments, text):
    with pytest.raises(InputError, match=text):
        sample(uncertain(), *arguments)


# --- responses -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("hold", ["zoh", "foh"])
def test_every_response_equals_that_of_its_model(hold):
    samples = sample(uncertain(), 6, seed=2, vertices=2)
    u = np.sin(3 * T) + 0.5
    x0 = [0.1, -0.3]
    found = samples.respond(T, u, x0, hold)
    for model, y in zip(samples.models(), found.y, strict=True):
        alone = simulate(model, T, u, x0, hold=hold)
        np.testing.assert_allclose(y, np.column_stack([alone["q"], alone["v"]]), rtol=1e-9, atol=1e-11)
        if hold == "foh":
            _, by_scipy, _ = scipy.signal.lsim((model.A, model.B, model.C, model.D), u, T, X0=x0)
            np.testing.assert_allclose(y, by_scipy, rtol=1e-7, atol=1e-9)
    everything = np.concatenate([found.y, found.nominal[None]])
    np.testing.assert_array_equal(found.lower, everything.min(axis=0))
    np.testing.assert_array_equal(found.upper, everything.max(axis=0))
    deviation = np.abs(found.y - found.nominal).max(axis=1)
    assert found.worst == tuple(deviation.argmax(axis=0))
    np.testing.assert_allclose(found.peak_deviation, deviation.max(axis=0))
    assert found.status is Status.CONVERGED
    assert "sampled" in found.label


def test_unit_step_is_the_default_and_inputs_have_names():
    samples = sample(uncertain(), 2)
    step = samples.respond(T)
    np.testing.assert_array_equal(step.y, samples.respond(T, {"f": 1.0}).y)
    np.testing.assert_array_equal(step.y, samples.respond(T, np.ones((81, 1))).y)
    np.testing.assert_allclose(samples.respond(T, {"f": 42.0}).y, 42 * step.y, rtol=1e-12)
    np.testing.assert_array_equal(samples.respond(T, {}).y, 0.0)


def test_unstable_samples_are_reported_and_overflow_is_not_hidden():
    samples = sample(elementwise(oscillator(), oscillator(c=-0.9)), 0, vertices="all")
    found = samples.respond(T)
    assert found.unstable == (1,)
    assert found.status is Status.CONVERGED
    far = samples.respond(np.linspace(0, 1e5, 1001))
    assert far.status is Status.INACCURATE
    assert not np.isfinite(far.upper[-1]).any()
    assert np.isfinite(far.y[0]).all()


def test_an_integrator_is_not_called_unstable():
    def drive(b):
        return StateSpaceModel([[0.0, 1.0], [0.0, -b]], [[0.0], [1.0]], [[1.0, 0.0]], [[0.0]])

    assert sample(elementwise(drive(1.0), drive(1.2)), 5).respond(T).unstable == ()


def test_complex_members_have_no_response():
    with pytest.raises(InputError, match="block 'c' is complex"):
        sample(mixed(), 1).respond(T, np.ones((81, 3)))
    m = StateSpaceModel(np.zeros((0, 0)), np.zeros((0, 2)), np.zeros((2, 0)), [[1.0, 1.0], [1.0, 0.0]])
    with pytest.raises(NoTrustworthyNumber, match="sample 1 makes the model ill-posed"):
        sample(UncertainModel(m, [RealScalar("k")]), 0, vertices="all").respond([0.0, 1.0])


@pytest.mark.parametrize(
    ("t", "u", "x0", "text"),
    [
        (T[:1], None, None, "at least 2"),
        (T[::-1], None, None, "not uniform"),
        (np.delete(T, 3), None, None, "not uniform"),
        (T, {"g": 1.0}, None, "input 'g'"),
        (T, np.ones(80), None, r"shape \(80, 1\)"),
        (T, np.ones((81, 2)), None, r"shape \(81, 2\)"),
        (T, {"f": np.where(T > 1, np.nan, 1.0)}, None, "NaN"),
        (T, None, [1.0], "x0 has 1 entries"),
    ],
)
def test_invalid_requests_are_rejected(t, u, x0, text):
    with pytest.raises(InputError, match=text):
        sample(uncertain(), 1).respond(t, u, x0)
