"""Records that are not fit for naming: each kind by name, with what was found, expected and what to do."""

import numpy as np
import pytest

import robustlab as rl
from robustlab.errors import InputError, NoTrustworthyNumber
from robustlab.identification import suitability

AXIS, MOTOR = rl.plant("servo-axis"), rl.plant("dc-motor")
DT = 1e-3
T = DT * np.arange(2000)
U = np.repeat(np.random.default_rng(0).uniform(-1, 1, 20), 100)
RUN = rl.simulate(AXIS, T, U)
NOISE = np.random.default_rng(1).standard_normal((2, len(T)))


def record(u=U, t=T, name="run 7", **outputs):
    channels = outputs or {"q": RUN["q"] + 1e-6 * NOISE[0], "v": RUN["v"] + 1e-4 * NOISE[1]}
    units = {"u": "V", "q": "m", "v": "m/s"}
    return rl.Record(t, {"u": u}, channels, {k: units[k] for k in ("u", *channels)}, name)


def test_a_good_record_is_fit():
    found = suitability(AXIS, record())
    assert (found.fit, found.findings) == (True, ())
    found.require()
    assert found.facts() == [("", "run 7: fit for naming")]


def test_shorter_than_the_slowest_time_constant():
    short = suitability(AXIS, record().between(0.0, 0.4))  # M / Fv = 0.467 s; the integrator does not count
    (finding,) = short.of("too-short")
    assert short.fit
    assert finding.message.startswith("t: lasts 0.4 s, less than the model's slowest time constant of 0.46")
    assert not suitability(AXIS, record().between(0.0, 0.5)).findings


def swing(duration, samples=30, amplitude=0.3):
    """Free swing of m = 1 kg, k = 100 N/m with hardly any damping: a period of 0.628 s."""
    t = np.arange(0.0, duration, 2 * np.pi / 10 / samples)
    q = amplitude * np.exp(-0.01 * t) * np.cos(10 * t) + 1e-3 * np.random.default_rng(2).standard_normal(len(t))
    return rl.Record(t, {"f": 0 * t}, {"q": q}, {"f": "N", "q": "m"}, "swing")


LIGHT = rl.plant("mass-spring-damper", m=1.0, c=0.02, k=100.0)  # decays within 100 s


@pytest.mark.parametrize("samples", [90, 9, 3.3])
def test_a_free_swing_is_judged_by_its_periods_and_not_by_its_decay(samples):
    found = suitability(LIGHT, swing(14.66, samples))
    assert found.fit
    (finding,) = found.findings
    assert (finding.kind, "does not determine the gain of an input" in finding.message) == ("unexcited", True)


def test_less_than_a_period_of_an_oscillation_is_too_short():
    with pytest.raises(NoTrustworthyNumber) as caught:
        suitability(LIGHT, swing(0.5)).require()
    assert caught.value.exit_code == 4
    assert "swing: t: lasts 0.4" in str(caught.value)
    assert "expected at least one period of the model's slowest oscillation, 0.628" in str(caught.value)


def test_ripple_does_not_turn_a_sign():
    """A motor at a steady current whose ripple compensates its cogging: the step at the start shows the sign."""
    t = np.arange(0.0, 1.0, 1e-3)
    motor = rl.plant("servo-axis", M=2.5e-4, Fv=0.0, gain=0.06)
    ripple = 0.3 * np.sin(0.5 * 40.0 * t**2)
    run = rl.simulate(motor, t, 1.0 + ripple)  # the force of current and cogging together
    found = suitability(motor, rl.Record(t, {"u": 1.0 - 0.5 * ripple}, {"q": run["q"]}, {"u": "V", "q": "m"}, "ripple"))
    assert found.fit, found.summary()


def test_constant_input_and_nothing_moves():
    still = record(np.full(2000, 0.5), q=0.2 + 1e-6 * NOISE[0], v=1e-4 * NOISE[1])
    with pytest.raises(NoTrustworthyNumber, match=r"run 7: u: constant: u = 0\.5 V; no output leaves its noise"):
        suitability(AXIS, still).require()


def test_an_input_too_small_to_move_anything():
    run = rl.simulate(AXIS, T, 1e-6 * U)
    found = suitability(AXIS, record(1e-6 * U, q=run["q"] + 1e-6 * NOISE[0], v=run["v"] + 1e-4 * NOISE[1]))
    assert {(f.kind, f.fatal) for f in found.findings} == {("unexcited", True)}
    with pytest.raises(NoTrustworthyNumber, match="does not leave its noise"):
        found.require()


def test_an_encoder_that_never_turns_three_steps():
    lsb = 1e-4
    run = rl.simulate(AXIS, T, 1e-3 * U)
    found = suitability(AXIS, record(1e-3 * U, q=lsb * np.round((run["q"] + 0.3 * lsb * NOISE[0]) / lsb)))
    assert ("unexcited", True) in {(f.kind, f.fatal) for f in found.findings}


def test_dead_sensors():
    one = suitability(AXIS, record(q=RUN["q"] + 1e-6 * NOISE[0], v=np.full(2000, 0.125)))
    assert one.fit
    assert one.of("constant-output")[0].message.startswith("v: is 0.125 m/s throughout: a dead sensor")
    with pytest.raises(InputError, match=r"run 7: q: is 0 m throughout") as caught:
        suitability(AXIS, record(q=np.zeros(2000), v=np.zeros(2000))).require()
    assert caught.value.exit_code == 3
    assert "run 7: v: is 0 m/s" in str(caught.value)


def test_clipped_outputs_are_named_with_their_samples():
    limit = 0.6 * RUN["v"].max()
    found = suitability(AXIS, record(v=np.minimum(RUN["v"], limit)))
    (clip,) = found.of("clipped")
    assert (clip.channel, clip.fatal) == ("v", False)
    first, last = clip.evidence["runs"][0]
    assert (RUN["v"][first:last] >= limit).all()


def test_gaps():
    keep = np.ones(2000, dtype=bool)
    keep[[300, 301, 302, 900]] = False
    whole = record()
    outputs = {k: x[keep] for k, x in whole.outputs.items()}
    holed = rl.Record(T[keep], {"u": U[keep]}, outputs, whole.units, "holed")
    (gaps,) = suitability(AXIS, holed).findings
    assert (gaps.kind, gaps.fatal, gaps.evidence["missing"]) == ("gaps", False, 4)
    assert "the longest from 0.299 s to 0.303 s" in gaps.message


def test_wrong_channels_are_found_through_gaps_and_jitter():
    keep = np.random.default_rng(3).random(2000) > 0.01
    keep[:2] = True
    t = T + 1e-4 * np.random.default_rng(2).uniform(-1, 1, 2000)
    whole = record()
    outputs = {"q": -whole["q"][keep], "v": whole["v"][keep]}
    found = suitability(AXIS, rl.Record(t[keep], {"u": U[keep]}, outputs, whole.units, "holed"))
    assert [(f.kind, f.channel) for f in found.fatal] == [("sign", "q")]


def test_all_faults_are_listed_the_wrong_channel_first():
    short = swing(0.5)
    turned = {"q": short["q"], "v": -np.gradient(short["q"], short.dt)}
    both = rl.Record(short.t, dict(short.inputs), turned, {"f": "N", "q": "m", "v": "m/s"}, "swing")
    with pytest.raises(InputError) as caught:
        suitability(LIGHT, both).require()
    text = str(caught.value)
    assert text.startswith("swing: q, v: q or v seems to be measured with the other sign")
    assert "swing: t: lasts 0.4" in text
    assert "hint: check the wiring" in text


def test_an_unstable_model_is_no_obstacle():
    """Closed loop around an unstable plant: only short windows are simulated."""
    model = rl.StateSpaceModel([[20.0]], [[1.0]], [[1.0]], [[0.0]], inputs=[("u", "V")], outputs=[("x", "m")])
    x, y, u = 0.0, np.empty(2000), np.empty(2000)
    for k in range(2000):
        u[k] = 40.0 * (U[k] - x)
        y[k] = x
        x = x + DT * (20.0 * x + u[k])
    assert suitability(model, rl.Record(T, {"u": u}, {"x": y})).fit
    assert suitability(model, rl.Record(T, {"u": u}, {"x": -y})).fatal[0].kind == "sign"
