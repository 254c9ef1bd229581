"""Wrong channels are found, and missing effects are never taken for a wrong channel."""

from pathlib import Path

import numpy as np
import pytest
from hidden import make_case
from oracle.stick_slip import stick_slip

import robustlab as rl
from robustlab.identification import suitability
from robustlab.identification.data_checks import derivative_pairs, quantisation_step

SHARED = Path(__file__).parents[4] / "shared" / "data"
DT = 1e-3
T = DT * np.arange(3000)
DEGREES, TURNS = 180 / np.pi, 0.5 / np.pi


def levels(amplitude, seed=0):
    """Levels of both signs with a ripple: a recommended record."""
    held = np.repeat(np.random.default_rng(seed).uniform(-1, 1, 15), 200)
    return amplitude * (0.8 * held + 0.2 * np.sin(2 * np.pi * 3 * T))


INPUTS = {
    "levels": levels,
    "square": lambda amplitude: amplitude * np.sign(np.sin(2 * np.pi * (T + 1e-6))),
    "triangle": lambda amplitude: amplitude * 2 / np.pi * np.arcsin(np.sin(2 * np.pi * 0.5 * T)),
    "step": lambda amplitude: amplitude * (T >= 0.5),
}
MOTOR, AXIS = rl.plant("dc-motor"), rl.plant("servo-axis")


def measured(plant, u, friction=None, outputs=None, noise=2e-3, t=T):
    """A record of the plant, with dry friction that the plant does not know, and noise of 0.2 % of the range."""
    run = stick_slip(plant, *friction, t, u).record if friction else rl.simulate(plant, t, u)
    rng = np.random.default_rng(1)
    names = outputs or tuple(run.outputs)
    channels = {n: run[n] + noise * np.ptp(run[n]) * rng.standard_normal(len(t)) for n in names}
    return rl.Record(t, run.inputs, channels, {k: v for k, v in run.units.items() if k in {*run.inputs, *names}}, "run")


def changed(record, **factors):
    """The record with some channels multiplied by a factor."""

    def put(group):
        return {name: factors.get(name, 1.0) * x for name, x in group.items()}

    return rl.Record(record.t, put(record.inputs), put(record.outputs), record.units, record.name)


def wrong(plant, record):
    """Kinds and channels of the fatal findings."""
    return [(finding.kind, finding.channel) for finding in suitability(plant, record).fatal]


# --- wrong channels are found ---------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("kind", INPUTS)
@pytest.mark.parametrize(
    ("plant", "friction", "amplitude"),
    [(MOTOR, None, 12.0), (MOTOR, ("omega", 0.02), 12.0), (AXIS, ("v", 10.0), 1.5)],
)
def test_a_motion_measured_with_the_wrong_sign_contradicts_its_own_derivative(plant, friction, amplitude, kind):
    record = measured(plant, INPUTS[kind](amplitude), friction)
    position, speed = derivative_pairs(plant.state_space())[0][:2]
    assert wrong(plant, record) == []
    assert wrong(plant, changed(record, **{position: -1.0})) == [("sign", position)]
    assert wrong(plant, changed(record, **{speed: -1.0})) == [("sign", speed)]


@pytest.mark.parametrize("friction", [None, ("omega", 0.02)])
@pytest.mark.parametrize(
    ("factors", "kind", "channel", "unit"),
    [
        ({"phi": DEGREES}, "unit", "phi", "deg"),
        ({"phi": TURNS}, "unit", "phi", "turns"),
        ({"omega": 30 / np.pi}, "unit", "omega", "rpm"),
        ({"omega": DEGREES}, "unit", "omega", "deg/s"),
        ({"i": 1e3}, "unit", "i", "mA"),
        ({"u": 1e3}, "unit", "u", "mV"),
        ({"u": -1.0}, "sign", "u", ""),
        ({"i": -1.0}, "sign", "i", ""),
    ],
)
def test_the_channel_and_its_unit_are_named(factors, kind, channel, unit, friction):
    if friction and "i" in factors:
        friction = None  # under friction the plain response of the current is not the model's
    record = changed(measured(MOTOR, levels(12.0), friction), **factors)
    (finding,) = suitability(MOTOR, record).fatal
    assert (finding.kind, finding.channel, finding.evidence["unit"]) == (kind, channel, unit)
    if kind == "unit":
        assert finding.evidence["factor"] == pytest.approx(factors[channel])


def test_inputs_inverted_or_in_another_unit():
    plant = rl.plant("mass-spring-damper", m=[1.0, 3.0], c=3.0, k=[100.0, 40.0])
    t, rng = 5e-3 * np.arange(3000), np.random.default_rng(6)
    u = {name: np.repeat(rng.standard_normal(60), 50) for name in ("f1", "f2")}
    record = measured(plant, u, outputs=("q1", "q2"), t=t)
    assert wrong(plant, record) == []
    assert wrong(plant, changed(record, f2=-1.0)) == [("sign", "f2")]
    assert wrong(plant, changed(record, f1=1e3)) == [("unit", "f1")]


# --- missing effects are not wrong channels -------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("kind", INPUTS)
@pytest.mark.parametrize("share", [0.6, 0.9, 1.2])
def test_friction_up_to_sticking(kind, share):
    """Dry friction up to more than the input can overcome."""
    friction = ("v", share * 1.5 * 35.15)
    for outputs in (("q",), ("q", "v")):
        record = measured(AXIS, INPUTS[kind](1.5), friction, outputs, noise=0.0)
        noise = 1e-6 * np.random.default_rng(2).standard_normal((len(outputs), record.n))
        noisy = {name: record[name] + e for name, e in zip(outputs, noise, strict=True)}
        found = suitability(AXIS, rl.Record(T, record.inputs, noisy, record.units, "stuck"))
        assert {finding.kind for finding in found.fatal} <= {"unexcited"}


def test_a_spring_that_the_model_lacks_is_no_wrong_sign():
    """Slowly excited, a spring moves with the force; the free axis of the model moves against it (-1/w^2)."""
    spring = rl.plant("mass-spring-damper", m=95.1089, c=203.5034, k=2e5)
    for u in (35.15 * np.sin(2 * np.pi * 2 * T), 35.15 * levels(1.5), 35.15 * INPUTS["triangle"](1.5)):
        run = measured(spring, u)
        record = rl.Record(T, {"u": u / 35.15}, {"q": run["q"]}, {"u": "V", "q": "m"}, "spring")
        assert wrong(AXIS, record) == []


@pytest.mark.parametrize("samples", [1, 5, 20])
def test_a_delay_is_no_wrong_sign(samples):
    u = levels(12.0)
    late = np.concatenate([np.zeros(samples), u[:-samples]])
    record = measured(MOTOR, late, ("omega", 0.01))
    assert wrong(MOTOR, rl.Record(T, {"u": u}, record.outputs, record.units, "late")) == []


def test_a_sensor_gain_of_8_percent_and_a_bias_are_no_wrong_channels():
    record = measured(MOTOR, levels(12.0), ("omega", 0.02))
    biased = {**changed(record, phi=1.08, omega=0.92).outputs}
    biased["omega"] = biased["omega"] + 5.0
    assert wrong(MOTOR, rl.Record(T, record.inputs, biased, record.units, "biased")) == []


@pytest.mark.parametrize(
    ("effect", "excitation", "plant"),
    [
        ("backlash", "rich", "dc-motor"),
        ("flexible-coupling", "rich", "dc-motor"),
        ("input-saturation", "square", "dc-motor"),
        ("sensor-gain", "oneway", "dc-motor"),
        ("stiffness", "rich", "servo-axis"),
        ("end-stop", "square", "servo-axis"),
        ("none", "rich", "servo-axis"),
    ],
)
def test_blind_cases_pass(effect, excitation, plant):
    case = make_case(effect, seed=11, noise="mid", excitation=excitation, plant=plant)
    assert wrong(case.plant, case.record) == []


def test_closed_loop_records():
    case = make_case("coulomb-friction", seed=12, noise="mid", closed_loop=True)
    assert wrong(case.plant, case.record) == []
    assert wrong(case.plant, changed(case.record, phi=-1.0)) == [("sign", "phi, u")]


@pytest.mark.shared
@pytest.mark.skipif(not SHARED.is_dir(), reason="measured data absent")
def test_measured_emps():
    """The model lacks dry friction and no channel is wrong, unless inverted or in mm."""
    whole = rl.Record.read(SHARED / "emps.h5", "train", ["u"], ["q"])
    record = whole.between(0.0, 8.0)
    found = suitability(AXIS, record)
    assert found.fit
    assert found.of("quantisation")[0].evidence["step"] == pytest.approx(5e-8, rel=1e-6)
    assert wrong(AXIS, changed(record, q=-1.0)) == [("sign", "q, u")]
    assert wrong(AXIS, changed(record, q=1e3)) == [("unit", "q, u")]


# --- parts ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("step", [5e-8, 1e-4, 2 * np.pi / 2000, 0.25, 1.0])
@pytest.mark.parametrize("offset", [0.0, 0.37])
def test_quantisation_step_of_encoders(step, offset):
    y = np.cumsum(np.random.default_rng(4).normal(0, 3, 2000))
    assert quantisation_step(offset + step * np.round(y)) == pytest.approx(step, rel=1e-6)
    assert quantisation_step(step * y) is None
    assert quantisation_step((step * y).astype(np.float32).astype(float)) is None
