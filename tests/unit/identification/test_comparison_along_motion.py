"""compare for nonlinear plants: the truth is the plant's own integrator, sample by sample with a controller."""

import json
import sys
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from closed_loop import closed_loop
from scipy.linalg import solve_continuous_are

import robustlab as rl
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
    """The arm with a PD controller and feedforward of its nominal gravity."""
    rest = arm().equilibrium(q_1=0.0, q_2=0.5)

    def control(t, x):
        wanted = np.array([0.5 * np.sin(2 * t), 0.5 + 0.6 * np.sin(3.3 * t)])
        q, w = x[[0, 2]], x[[1, 3]]
        return rest.u + np.array([120.0, 40.0]) * (wanted - q) - np.array([15.0, 4.0]) * w

    assert [s.name for s in arm().states] == ["q_1", "w_1", "q_2", "w_2"]
    return closed_loop(arm(**given), control, rest.x, n, 2e-3, ["q_1", "q_2"], noise, seed)


@cache
def cart_record(**given):
    """The upright pole with state feedback; without it theta doubles every 0.13 s."""
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
    """The platform's nuts with a PD controller and feedforward of trimmed torques."""
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


def test_the_error_of_the_right_plant_is_the_noise():
    found = compared_arm()
    for name in ("q_1", "q_2"):
        assert found.outputs[name].windowed_rms == pytest.approx(NOISE, rel=0.05)
        assert found.sensor_noise[name] == pytest.approx(NOISE, rel=0.05)
        assert found.residual[name].rms == pytest.approx(NOISE, rel=0.06)
        assert found.residual[name].whiteness.p_value > 1e-3
        assert max(found.linearisation.share.values()) < 0.01
    assert not [w for w in found.warnings if "linear" in w]
    assert any("the windows are more informative" in w for w in found.warnings)  # an arm in gravity falls from above


def test_friction_at_one_joint_is_located_there():
    """Viscous friction of 0.6 instead of 0.3 N m s/rad at joint 2 is an addition of -0.3 w_2 to torque_2."""
    found = rl.compare(arm(), arm_record(b_2=0.6)[0], window=0.3)
    assert found.outputs["q_2"].windowed_rms > 20 * NOISE
    assert found.outputs["q_2"].windowed_rms > 2 * found.outputs["q_1"].windowed_rms
    d = found.disturbance["torque at w_2"]
    assert d.speed_source == "w_2 (smoothed)"
    known = np.isfinite(d.value)
    slope = np.polyfit(d.speed[known], d.value[known], 1)[0]
    assert slope == pytest.approx(-0.3, rel=0.05)
    assert d.explained_share > 0.9
    assert d.explained_share > found.disturbance["torque at w_1"].explained_share + 0.1
    assert found.residual["q_2"].whiteness.p_value < 1e-6


def test_an_unstable_plant_is_compared_in_windows_and_its_free_run_ends():
    found = rl.compare(cart_pole(), cart_record()[0])
    for name in ("x", "theta"):
        gap = found.outputs[name]
        assert gap.windowed_rms == pytest.approx(NOISE, rel=0.06)
        assert np.isnan([gap.peak, gap.rms, gap.rms_percent, gap.fit, gap.peak_time]).all()
    assert 0.5 < found.free_run.end < 4.7
    assert not found.free_run.whole
    assert "10 times its recorded range" in found.free_run.reason
    assert found.simulated.t[-1] == found.free_run.end
    assert found.frequency == {}
    assert "x: free run" not in found.summary()
    json.dumps(plain(found.to_json()), allow_nan=False)


def test_the_platform_under_a_controller():
    record, _ = platform_record()
    found = rl.compare(platform(), record)
    for name in record.outputs:
        assert found.outputs[name].windowed_rms == pytest.approx(3e-4, rel=0.08)
    assert max(found.linearisation.share.values()) < 1e-3
    assert [found.motions[f"phi_{k}"].speed_source for k in (1, 6)] == ["phidot_1 (smoothed)", "phidot_6 (smoothed)"]
    assert {d.speed_source for d in found.disturbance.values()} == {f"phidot_{k} (smoothed)" for k in range(1, 7)}


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


# --- bad inputs ------------------------------------------------------------------------------------------------------


def changed(inputs=None, outputs=None, units=None, gap=False):
    record, _ = arm_record()
    given = inputs or dict(record.inputs), outputs or dict(record.outputs)
    kept = {k: u for k, u in {**record.units, **(units or {})}.items() if any(k in side for side in given)}
    return rl.Record(record.t + 0.05 * gap * (np.arange(record.n) >= 700), *given, kept, "run")


@pytest.mark.parametrize(
    ("record", "options", "message"),
    [
        (lambda r: changed(outputs={"q_1": r["q_1"]}), {}, "compare run: no measured output shows q_2"),
        (lambda r: changed(inputs={"torque_1": r["torque_1"]}), {}, "no input 'torque_2'"),
        (lambda r: changed(outputs={"other": r["q_1"]}), {}, "no output in common"),
        (lambda r: changed(units={"q_1": "V"}), {}, "recorded in V"),
        (lambda r: r.between(0.0, 0.0581), {}, "30 samples"),
        (lambda r: changed(gap=True), {}, "samples missing from"),
        (lambda r: r, {"window": 50.0}, "window"),
        (lambda r: changed(outputs={"q_1": r["q_1"], "q_2": 0 * r["q_2"] + 0.5}), {}, "q_2 .*0.5 rad throughout"),
    ],
)  # fmt: skip
def test_invalid_comparisons_are_refused(record, options, message):
    with pytest.raises(rl.InputError, match=message):
        rl.compare(arm(), record(arm_record()[0]), **options)


@pytest.mark.parametrize("name", ["torque_2", "q_1"])
def test_a_record_check_finds_an_inverted_channel(name):
    from robustlab.identification import suitability

    record, _ = arm_record()
    assert suitability(arm(), arm_record(b_2=1.5)[0]).fit  # a missing friction is no wrong sign
    sides = [{key: -x if key == name else x for key, x in side.items()} for side in (record.inputs, record.outputs)]
    found = suitability(arm(), changed(*sides))
    assert [(f.kind, f.channel) for f in found.fatal] == [("sign", name)]


def test_validate_and_cover_require_a_linear_set():
    from robustlab.identification import cover

    for call in (lambda plant, record: rl.validate(plant, record, {"q_1": 1e-3}), cover):
        with pytest.raises(rl.InputError, match="an uncertain linear model about a trim"):
            call(arm(), arm_record()[0])
