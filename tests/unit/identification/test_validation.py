"""`rl.validate`: known smallest gammas, bounds that hold, replays, and what is refused."""

import json

import numpy as np
import pytest
import validation_cases as benchmark
from hypothesis import given, settings
from hypothesis import strategies as st

import robustlab as rl
from robustlab.cli import main_guard, run_command
from robustlab.errors import InputError


def check(case, gamma, within=0.006, **more):
    model, record, noise, options = case
    found = rl.validate(model, record, noise, precision=0.005, **{**options, **more})
    assert found.lower <= gamma * (1 + 1e-6)
    assert found.lower >= gamma * (1 - within)
    assert abs(found.upper / gamma - 1) < within
    assert found.excess <= 1 + 1e-6
    assert found.replay_error < 1e-6
    return found


@pytest.mark.parametrize(("seed", "n", "blocks"), [(100, 60, 1), (101, 80, 2), (102, 60, 3)])
def test_time_varying_systems_of_known_size(seed, n, blocks):
    found = check(benchmark.varying_case(seed, n, blocks, 0.8), 0.8)
    assert found.status is rl.Status.CERTIFIED
    assert len(found.blocks) == blocks


@pytest.mark.parametrize(("seed", "blocks"), [(300, 1), (301, 2)])
def test_constants_of_known_size(seed, blocks):
    model, record, noise, options = benchmark.constant_case(seed, 120, blocks, 0.6)
    found = rl.validate(model, record, noise, precision=0.005, **options)
    assert found.upper == pytest.approx(0.6, rel=0.012)
    assert (found.lower, found.status, found.replay_error < 1e-6) == (0.0, rl.Status.CONVERGED, True)
    assert "no lower bound" in found.label


def test_a_constant_of_a_discrete_model_has_bounds_on_both_sides():
    # y = (2 + k) u with y = 2.5 u and noise of 0.1: k is 0.4 at least.
    gain = rl.UncertainModel(rl.StateSpaceModel([], [], [], [[0.0, 1.0], [1.0, 2.0]], dt=1.0), [rl.RealScalar("k")])
    record = rl.Record(range(4), {"u2": [1, -1, 1, 1]}, {"y2": [2.5, -2.5, 2.5, 2.5]})
    found = rl.validate(gain, record, {"y2": 0.1}, at_rest=True)
    assert found.lower == pytest.approx(0.4, rel=0.01)
    assert found.upper == pytest.approx(0.4, rel=0.01)
    far = rl.validate(
        gain, rl.Record(range(4), {"u2": [1, -1, 1, 1]}, {"y2": [4, -4, 4, 4]}), {"y2": 0.1}, at_rest=True
    )
    assert far.invalidated


def test_a_system_in_the_loop_is_bracketed_too():
    check(benchmark.feedback_case(400, 100, 0.5), 0.5)


@given(seed=st.integers(0, 10_000))
@settings(max_examples=12)
def test_a_true_model_is_never_invalidated(seed):
    model, inputs, y, noise, bound = benchmark.plausible(seed, 40)
    record = benchmark.record_of(inputs, {"y": y + noise})
    assert not rl.validate(model, record, {"y": bound}, at_rest=True).invalidated


def test_a_wrong_constant_is_undecided():
    model, record, noise, options = benchmark.constant_case(302, 120, 1, 1.5)
    found = rl.validate(model, record, noise, **options)
    assert (found.status, found.upper) == (rl.Status.INCONCLUSIVE, pytest.approx(1.5, rel=0.02))


def test_a_record_from_elsewhere_is_invalidated_at_every_gamma():
    two = rl.StateSpaceModel([], [], [], [[0.0, 1.0], [1.0, 1.0], [0.0, 1.0]], 0.1, ["w", "u"], ["z", "y", "v"])
    model = rl.UncertainModel(two, [rl.FullBlock("d", 1, 1)])
    t = np.arange(20) * 0.1
    record = rl.Record(t, {"u": np.ones(20)}, {"y": np.ones(20), "v": np.full(20, 3.0)})  # Delta does not reach v
    found = rl.validate(model, record, {"y": 0.1, "v": 0.1})
    assert found.status is rl.Status.INFEASIBLE
    assert found.verdict == "invalidated at every gamma"
    assert found.excess == pytest.approx(20.0, rel=1e-3)


def test_windows_and_free_starts_are_weaker_tests():
    model, inputs, y, noise, bound = benchmark.plausible(5, 60)
    record = benchmark.record_of(inputs, {"y": y + noise})
    rest, free, windows = (
        rl.validate(model, record, {"y": bound}, **options) for options in ({"at_rest": True}, {}, {"window": 0.2})
    )
    assert windows.lower <= free.upper <= rest.upper * 1.001


def test_constants_and_systems_together():
    M = rl.StateSpaceModel(
        [[-1.0]], [[0.4, 0.0, 1.0]], [[1.0], [0.0], [1.0]], [[0, 0, 0], [0, 0, 0.3], [0, 1.0, 0]], 0.0,
        ["w1", "w2", "u"], ["z1", "z2", "y"],
    )  # fmt: skip
    model = rl.UncertainModel(M, [rl.RealScalar("pole"), rl.FullBlock("gain", 1, 1)])
    t = np.arange(50) * 0.1
    u = np.sign(np.sin(1.3 * t))
    truth = rl.simulate(model.evaluate({"pole": 0.8, "gain": 0.2}), t, {"u": u})
    found = rl.validate(model, rl.Record(t, {"u": u}, {"y": truth["y"]}), {"y": 0.02}, at_rest=True, effort=0.05)
    assert found.lower <= found.upper <= 0.82
    assert found.blocks["pole"].kind == "constant"
    assert found.excess <= 1 + 1e-6


def small():
    gain_set = rl.unstructured(rl.StateSpaceModel([], [], [], [[2.0]], dt=0.1, inputs=["u"], outputs=["y"]), 1.0)
    return gain_set, rl.Record(np.arange(8) * 0.1, {"u": np.ones(8)}, {"y": np.full(8, 2.5)})


def test_invalid_input_is_refused():
    model, record = small()
    t = record.t.copy()
    t[5:] += 0.05
    uneven = rl.Record(t, record.inputs, record.outputs)
    for measured, noise, options, error, message in [
        (uneven, {"y": 0.1}, {}, rl.NoTrustworthyNumber, "irregular sampling"),
        (record, {"y": 0.0}, {}, rl.NoTrustworthyNumber, "singular noise model"),
        (record, {}, {}, rl.InputError, "no noise bound"),
        (record, {"y": 0.1, "x": 0.1}, {}, rl.InputError, "no such compared output"),
        (record, {"y": -1.0}, {}, rl.InputError, "positive number"),
        (record, {"y": 0.1}, {"window": 0.1}, rl.InputError, "windows of"),
        (record, {"y": 0.1}, {"precision": 0.0}, rl.InputError, "precision"),
    ]:
        with pytest.raises(error, match=message):
            rl.validate(model, measured, noise, **options)


@pytest.fixture
def files(tmp_path):
    model, record = small()
    rl.save(tmp_path / "set.h5", model)
    rl.save(tmp_path / "run.h5", record)
    return tmp_path


def command(capsys, *arguments):
    code = main_guard(lambda: run_command(["data", "validate", *map(str, arguments)]))
    captured = capsys.readouterr()
    return code, captured.out, captured.err


def test_the_command(files, capsys):
    options = (files / "set.h5", files / "run.h5", "--noise", "y=0.1")
    code, out, _ = command(capsys, *options, "--json", "--figure", f"{files}/f/", "--out", files / "v.h5")
    result = json.loads(out)
    assert (code, result["command"], result["status"]) == (0, "data validate", "certified")
    assert result["upper"] == pytest.approx(0.4, rel=0.01)
    assert (files / "f" / "record-y.svg").exists()
    assert rl.load(files / "v.h5").status is rl.Status.CERTIFIED
    assert command(capsys, files / "set.h5", files / "run.h5", "--noise", "y=0")[0] == 4
    assert command(capsys, files / "run.h5", files / "run.h5", "--noise", "y=0.1")[0] == 3


@pytest.mark.parametrize(("r", "c"), [(1, 1), (2, 1), (1, 2), (2, 2)])
def test_a_full_block_against_the_theorem(r, c):
    """Poolla et al., theorem 3.3: without noise gamma^2 is the largest ratio of the energies of y and u so far."""
    n, rng = 20, np.random.default_rng(3)
    u = rng.standard_normal((n, c)) + 3 * (np.arange(n) == 0)[:, None]
    D = np.block([[np.zeros((c, r)), np.eye(c)], [np.eye(r), np.zeros((r, c))]])
    names = [[f"{letter}{i}" for i in range(k)] for letter, k in (("w", r), ("u", c), ("z", c), ("y", r))]
    M = rl.StateSpaceModel([], [], [], D, 0.1, names[0] + names[1], names[2] + names[3])
    h = rng.standard_normal((5, r, c)) * 0.5 ** np.arange(5)[:, None, None]
    y = sum(np.vstack([np.zeros((k, r)), u[: n - k] @ h[k].T]) for k in range(5))
    record = rl.Record(np.arange(n) * 0.1, dict(zip(names[1], u.T, strict=True)), dict(zip(names[3], y.T, strict=True)))
    model, noise = rl.UncertainModel(M, [rl.FullBlock("d", r, c)]), dict.fromkeys(names[3], 1e-6)
    found = rl.validate(model, record, noise, at_rest=True, precision=0.005)
    gamma = np.sqrt((np.cumsum((y**2).sum(axis=1)) / np.cumsum((u**2).sum(axis=1))).max())
    assert found.lower <= gamma * (1 + 1e-9)
    assert found.lower >= 0.995 * gamma
    assert found.upper == pytest.approx(gamma, rel=1e-3)


def test_constants_over_windows():
    # Four windows, each with states of its own.
    model, t = rl.plant("servo-axis", M=95.0, Fv=(200.0, 0.3)).uncertain(outputs=["q"]), np.arange(400) * 0.01
    u = np.sign(np.sin(t**1.1))
    q = rl.simulate(model.evaluate({"Fv": -0.8}), t, {"u": u})["q"]
    q = q + 1e-4 * np.random.default_rng(0).uniform(-1, 1, len(t))
    run = rl.Record(t, {"u": u}, {"q": q})
    found = rl.validate(model, run, {"q": 1e-4}, window=1.0, precision=0.05)
    assert found.lower <= 0.8 + 1e-9
    assert 0.5 < found.upper <= 0.8 * 1.001
    assert found.replay_error < 1e-3
    far = rl.validate(model, rl.Record(t, {"u": u}, {"q": q + 0.01 * np.sin(9 * t)}), {"q": 1e-4}, window=1.0)
    assert (far.status, far.upper, far.excess > 10) == (rl.Status.INCONCLUSIVE, np.inf, True)


def test_without_blocks_noise_alone_explains_a_record_or_nothing_does():
    alone = rl.UncertainModel(rl.StateSpaceModel([[-1.0]], [[1.0]], [[1.0]], [[0.0]], 0.0, ["u"], ["y"]), [])
    t = np.arange(100) * 0.1
    noise = np.random.default_rng(0).uniform(-1, 1, 100)
    y = rl.simulate(alone.nominal, t, np.sin(t), [0.7])["y"]
    near = rl.validate(alone, rl.Record(t, {"u": np.sin(t)}, {"y": y + 0.009 * noise}), {"y": 0.01})
    assert (near.lower, near.upper, near.status) == (0.0, 0.0, rl.Status.CERTIFIED)
    assert 0.8 < near.excess <= 1
    far_record = rl.Record(t, {"u": np.sin(t)}, {"y": y + 0.018 * noise})
    far = rl.validate(alone, far_record, {"y": 0.01})
    assert far.status is rl.Status.INFEASIBLE
    assert far.excess == pytest.approx(2 * near.excess, rel=1e-3)  # affine in the noise, free states included
    with pytest.raises(InputError, match="without blocks"):
        rl.validate(alone, far_record, {"y": 0.01}, domain="frequency")
