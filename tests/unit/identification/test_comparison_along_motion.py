"""compare for nonlinear plants: truth is the same plant's own integrator, sample by sample under a controller."""

import json
import sys
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from closed_loop import closed_loop
from scipy.linalg import solve_continuous_are

import robustlab as rl
from robustlab.report.comparison_figures import comparison_figures
from robustlab.result import plain

sys.path.insert(0, str(Path(__file__).parents[3] / "models" / "plants"))
NOISE = 2e-4


@cache
def arm(**given):
    from two_link_arm import two_link_arm

    return two_link_arm(**given)


@cache
def cart_pole(**given):
    from cart_pole import cart_pole

    return cart_pole(**given)


@cache
def arm_record(seed=2, n=1500, noise=NOISE, **given):
    """The arm on a PD controller that knows its nominal gravity."""
    rest = arm().equilibrium(q_1=0.0, q_2=0.5)

    def control(t, x):
        wanted = np.array([0.5 * np.sin(2 * t), 0.5 + 0.6 * np.sin(3.3 * t)])
        q, w = x[[0, 2]], x[[1, 3]]
        return rest.u + np.array([120.0, 40.0]) * (wanted - q) - np.array([15.0, 4.0]) * w

    assert [s.name for s in arm().states] == ["q_1", "w_1", "q_2", "w_2"]
    return closed_loop(arm(**given), control, rest.x, n, 2e-3, ["q_1", "q_2"], noise, seed)


@cache
def cart_record(**given):
    """The pole upright on state feedback; without it theta doubles every 0.13 s."""
    model = rl.linearise(cart_pole())
    gain = model.B.T @ solve_continuous_are(model.A, model.B, np.diag([10.0, 1.0, 10.0, 1.0]), np.eye(1))

    def control(t, x):
        return -gain @ (x - np.array([0.3 * np.sin(2 * t) + 0.1 * np.sin(5.1 * t), 0, 0, 0]))

    return closed_loop(cart_pole(**given), control, np.zeros(4), 1200, 4e-3, ["x", "theta"], NOISE)


@cache
def platform(**given):
    bare = rl.plant("stewart-platform", preset="physical")
    return bare.with_parameters(**given) if given else bare


@cache
def platform_record(n=600, noise=3e-4, **given):
    """The platform's nuts on a PD controller; trimmed torques are fed forward."""
    rest = platform().equilibrium()
    stiff = np.linalg.inv(rl.linearise(platform()).B[6:12])

    def control(t, x):
        wanted = 5.0 * (np.sin(9.4 * t + np.arange(6)) - np.sin(np.arange(6))) * min(1.0, t / 0.1)
        return rest.u + stiff @ (1600.0 * (wanted - x[:6]) - 80.0 * x[6:12])

    names = [f"phi_{k}" for k in range(1, 7)]
    return closed_loop(platform(**given), control, rest.x, n, 2e-3, names, noise)


@cache
def compared_arm():
    return rl.compare(arm(), arm_record()[0])


def test_the_right_plant_misses_by_the_noise_alone():
    found = compared_arm()
    for name in ("q_1", "q_2"):
        assert found.outputs[name].windowed_rms == pytest.approx(NOISE, rel=0.05)
        assert found.sensor_noise[name] == pytest.approx(NOISE, rel=0.05)
        assert found.residual[name].rms == pytest.approx(NOISE, rel=0.06)
        assert found.residual[name].whiteness.p_value > 1e-3
        assert max(found.linearisation.share.values()) < 0.01
    assert not [w for w in found.warnings if "linear" in w]
    assert any("the windows tell more" in w for w in found.warnings)  # an arm in gravity falls from above


def test_the_windows_are_those_of_the_nonlinear_plant():
    """The same start in the plant's own integrator gives the same window."""
    record, x = arm_record(noise=0.0)
    found = rl.compare(arm(), record, window=0.5)
    assert max(found.linearisation.difference.values()) < 1e-7
    assert found.outputs["q_2"].windowed_rms < 1e-6
    assert found.initial_state.x0 == pytest.approx(x[0], abs=1e-4)


def test_friction_at_one_joint_shows_there():
    """Viscous friction of 0.6 instead of 0.3 N m s/rad at joint 2 is an addition of -0.3 w_2 to torque_2."""
    found = rl.compare(arm(), arm_record(b_2=0.6)[0], window=0.3)
    assert found.outputs["q_2"].windowed_rms > 20 * NOISE
    assert found.outputs["q_2"].windowed_rms > 2 * found.outputs["q_1"].windowed_rms
    d = found.disturbance["torque_2"]
    assert d.speed_source == "w_2 (smoothed)"
    known = np.isfinite(d.value)
    slope = np.polyfit(d.speed[known], d.value[known], 1)[0]
    assert slope == pytest.approx(-0.3, rel=0.05)
    assert d.explained_share > 0.9
    assert d.explained_share > found.disturbance["torque_1"].explained_share + 0.1
    assert found.residual["q_2"].whiteness.p_value < 1e-6


def test_every_output_is_sorted_over_its_own_joint():
    found = compared_arm()
    assert found.motions["q_1"].speed_source == "w_1 (smoothed)"
    assert found.motions["q_2"].position_name == "q_2"
    assert found.to_json(False)["speed"]["signal"] == {"q_1": "w_1 (smoothed)", "q_2": "w_2 (smoothed)"}
    stated = rl.compare(arm(), arm_record()[0], position="q_1")
    assert stated.motions["q_2"].position_name == "q_1"


def test_an_unstable_plant_is_held_in_windows_and_its_free_run_ends():
    found = rl.compare(cart_pole(), cart_record()[0])
    for name in ("x", "theta"):
        gap = found.outputs[name]
        assert gap.windowed_rms == pytest.approx(NOISE, rel=0.06)
        assert np.isnan([gap.peak, gap.rms, gap.rms_percent, gap.fit, gap.peak_time]).all()
        assert np.isnan(found.windows[name].rms).all()
        assert found.windows[name].worst_free is None
    assert 0.5 < found.free_run.end < 4.7
    assert not found.free_run.whole
    assert "10 times its recorded range" in found.free_run.reason
    assert found.simulated.t[-1] == found.free_run.end
    assert found.frequency == {}
    text = found.summary()
    assert "of the windows only" in text
    assert "free run   peak" not in text
    assert set(found.amplitude["x"]) == {"F"}
    json.dumps(plain(found.to_json()), allow_nan=False)


def test_a_heavier_pole_shows_at_the_pole():
    found = rl.compare(cart_pole(), cart_record(m=0.3)[0], window=0.6)
    assert found.outputs["theta"].windowed_rms > 2 * NOISE
    assert found.linearisation.share["theta"] < 0.01


def test_the_platform_under_a_controller():
    record, _ = platform_record()
    found = rl.compare(platform(), record)
    for name in record.outputs:
        assert found.outputs[name].windowed_rms == pytest.approx(3e-4, rel=0.08)
    assert max(found.linearisation.share.values()) < 1e-3
    assert [found.motions[f"phi_{k}"].speed_source for k in (1, 6)] == ["phidot_1 (smoothed)", "phidot_6 (smoothed)"]
    assert {d.speed_source for d in found.disturbance.values()} == {f"phidot_{k} (smoothed)" for k in range(1, 7)}


def test_the_platform_with_another_load():
    """The rotors are most of what moves: a tenth more of them is a tenth less of acceleration at all six."""
    found = rl.compare(platform(rotor_J=1.1 * platform().values["rotor_J"]), platform_record()[0])
    assert min(gap.windowed_rms for gap in found.outputs.values()) > 10 * 3e-4
    assert max(found.linearisation.share.values()) < 0.01


def test_a_free_run_that_leaves_the_workspace_ends_there():
    """Motor torques a tenth too small to hold it: the platform falls out of its workspace."""
    record, _ = platform_record()
    weak = rl.Record(
        record.t, {name: u - 0.5 * abs(u).max() for name, u in record.inputs.items()}, record.outputs, record.units
    )
    found = rl.compare(platform(), weak, window=0.1)
    assert not found.free_run.whole
    assert found.free_run.end < record.t[-1]
    assert np.isnan(found.outputs["phi_1"].rms)


def test_a_large_gap_is_said_to_be_beyond_the_linearisation():
    found = rl.compare(arm(), arm_record(b_2=1.5)[0], window=1.0)
    assert max(found.linearisation.share.values()) > 0.1
    assert any("take shorter windows" in w for w in found.warnings)
    assert any("take shorter windows" in line for line in found.summary().splitlines())


def test_repeats_give_the_gap_in_multiples_of_the_noise():
    first, second = (arm_record(seed=seed)[0] for seed in (2, 3))
    second = rl.Record(second.t, first.inputs, second.outputs, second.units, "again")
    found = rl.compare(arm(), first, repeats=[second])
    gap = found.against_noise["q_2"]
    assert gap.std == pytest.approx(NOISE, rel=0.05)
    assert gap.windowed_rms_percent == pytest.approx(100, rel=0.06)
    assert gap.excess.p_value > 1e-3


def test_jitter_is_resampled_and_said():
    record, _ = arm_record()
    t = record.t + 1e-5 * np.random.default_rng(5).uniform(-1, 1, record.n)
    found = rl.compare(arm(), rl.Record(t, record.inputs, record.outputs, record.units))
    assert any("resampled" in w for w in found.warnings)
    assert found.outputs["q_1"].windowed_rms < 2 * NOISE


def test_figures_are_drawn(tmp_path):
    found = rl.compare(cart_pole(), cart_record()[0])
    figures = comparison_figures(found)
    assert {"where-x", "time-theta", "speed-x", "residual-theta", "outputs"} <= set(figures)
    assert not [name for name in figures if name.startswith(("spectrum", "response"))]
    for name in ("where-x", "time-theta", "outputs"):
        figures[name].savefig(tmp_path / f"{name}.png", dpi=40)
    assert len(comparison_figures(compared_arm())["speed-q_2"].axes) == 1  # noise alone: there is nothing to add
    own = comparison_figures(rl.compare(arm(), arm_record(b_2=0.6)[0]))
    assert len(own["speed-q_2"].axes) == 2  # its own torque, not the other one


# --- bad inputs ------------------------------------------------------------------------------------------------------


def changed(record, *, inputs=None, outputs=None, t=None, units=None):
    given = (inputs or dict(record.inputs), outputs or dict(record.outputs))
    named = {name for side in given for name in side}
    kept = {name: unit for name, unit in {**record.units, **(units or {})}.items() if name in named}
    return rl.Record(record.t if t is None else t, *given, kept, "run")


def test_a_position_that_is_not_recorded():
    record, _ = arm_record()
    with pytest.raises(rl.InputError, match="compare run: no measured output shows q_2"):
        rl.compare(arm(), changed(record, outputs={"q_1": record["q_1"]}))


def test_an_input_or_every_output_missing_or_another_unit():
    record, _ = arm_record()
    with pytest.raises(rl.InputError, match="no input 'torque_2'"):
        rl.compare(arm(), changed(record, inputs={"torque_1": record["torque_1"]}))
    with pytest.raises(rl.InputError, match="no output in common"):
        rl.compare(arm(), changed(record, outputs={"other": record["q_1"]}))
    with pytest.raises(rl.errors.UnitMismatch, match="recorded in V"):
        rl.compare(arm(), changed(record, units={"q_1": "V"}))


def test_too_few_samples_gaps_and_windows_that_do_not_fit():
    record, _ = arm_record()
    with pytest.raises(rl.InputError, match="30 samples"):
        rl.compare(arm(), record.between(0.0, 0.0581))
    t = record.t.copy()
    t[700:] += 0.05
    with pytest.raises(rl.InputError, match="samples missing from"):
        rl.compare(arm(), changed(record, t=t))
    with pytest.raises(rl.InputError, match="window"):
        rl.compare(arm(), record, window=50.0)


def test_a_dead_sensor_and_a_wrong_sign_end_in_one_line_or_a_large_gap():
    record, _ = arm_record()
    with pytest.raises(rl.InputError, match=r"q_2 stands at 0.5 rad throughout"):
        rl.compare(arm(), changed(record, outputs={"q_1": record["q_1"], "q_2": np.full(record.n, 0.5)}))
    turned = rl.compare(arm(), changed(record, outputs={"q_1": record["q_1"], "q_2": -record["q_2"]}))
    assert turned.outputs["q_1"].windowed_rms > 20 * NOISE


def test_a_motion_that_the_platform_cannot_have():
    record, _ = platform_record()
    swapped = {**record.outputs, "phi_1": 1e4 * record["phi_1"]}
    with pytest.raises((rl.InputError, rl.NoTrustworthyNumber)):
        rl.compare(platform(), changed(record, outputs=swapped))


@pytest.mark.parametrize("name", ["torque_2", "q_1"])
def test_a_record_check_tells_a_turned_channel(name):
    from robustlab.identification.record_check.suitability import suitability

    record, _ = arm_record()
    assert suitability(arm(), record).fit
    assert suitability(arm(), arm_record(b_2=1.5)[0]).fit  # a missing friction is no wrong sign
    sides = [{key: -x if key == name else x for key, x in side.items()} for side in (record.inputs, record.outputs)]
    found = suitability(arm(), changed(record, inputs=sides[0], outputs=sides[1]))
    assert [(f.kind, f.channel) for f in found.fatal] == [("sign", name)]


def test_a_record_check_tells_a_joint_that_is_not_measured():
    from robustlab.identification.record_check.suitability import suitability

    record, _ = arm_record()
    found = suitability(arm(), changed(record, outputs={"q_1": record["q_1"]}))
    assert found.of("motion")[0].fatal
    assert "q_2" in found.of("motion")[0].found
    dead = suitability(arm(), changed(record, outputs={"q_1": record["q_1"], "q_2": np.full(record.n, 0.5)}))
    assert [f.kind for f in dead.fatal] == ["constant-output"]
    with pytest.raises(rl.InputError, match="no input 'torque_2'"):
        suitability(arm(), changed(record, inputs={"torque_1": record["torque_1"]}))


def test_validate_and_cover_ask_for_a_linear_set():
    from robustlab.identification.comparison.envelope import cover

    record, _ = arm_record()
    for call in (rl.validate, cover):
        with pytest.raises(rl.InputError, match="an uncertain linear model about a trim"):
            call(arm(), record)


@pytest.fixture
def run(capsys):
    from robustlab.cli.data import app
    from robustlab.cli.ending import main_guard

    def call(*arguments):
        code = main_guard(lambda: app([str(a) for a in arguments], standalone_mode=False))
        captured = capsys.readouterr()
        return code, captured.out, captured.err

    return call


def test_the_command_line(run, tmp_path):
    plant, path = tmp_path / "cart-pole.h5", tmp_path / "run.h5"
    rl.save(plant, cart_pole())
    rl.save(path, cart_record()[0])
    code, out, _ = run("check", path, "--model", plant)
    assert (code, "fit for naming" in out) == (0, True)
    files = ("--figure", f"{tmp_path}/figures/", "--out", tmp_path / "gap.h5")
    code, out, err = run("compare", plant, path, *files, "--json")
    assert code == 0, err
    result = json.loads(out)
    assert result["free_run"]["reason"]
    assert result["outputs"]["x"]["rms"] == "nan"
    assert result["linearisation"]["share"]["theta"] < 0.01
    assert {"outputs.svg", "time-x.svg"} <= {p.name for p in (tmp_path / "figures").iterdir()}
    assert rl.load(tmp_path / "gap.h5").status is rl.Status.CONVERGED
    short = tmp_path / "short.h5"
    rl.save(short, changed(cart_record()[0], outputs={"x": cart_record()[0]["x"]}))
    code, out, err = run("compare", plant, short)
    assert code == 3
    assert "no measured output shows theta" in err
