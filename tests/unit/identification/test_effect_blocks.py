"""Effects as blocks: members are the plants with the effects' gains, delays are inside their weights, origins stay."""

import dataclasses
import math

import numpy as np
import pytest

import robustlab as rl
from robustlab import uncertain_from
from robustlab.dynamics import delay_block, effect_loads
from robustlab.identification import Discovery, ForceCurve, ResidualForce

SERVO = {"M": (95.0, 0.1), "Fv": (200.0, 0.05), "gain": 35.0}


def servo(**effects):
    return rl.with_effects(rl.plant("servo-axis", **SERVO), {k.replace("_", "-"): v for k, v in effects.items()})


def test_friction_is_a_gain_between_nothing_and_its_describing_function():
    """(M s + Fv + k) v = gain u at every mass and every k of the sector 0 .. 4 Fc / (pi a): by hand."""
    made = uncertain_from(servo(coulomb_friction={"Fc": 20.0}), ["v"], amplitude={"v": 0.05})
    (name,) = [b.name for b in made.model.blocks if "coulomb" in b.name]
    top = 4 * 20.0 / (math.pi * 0.05)
    omega = np.array([0.3, 3.0, 40.0])
    for mass, damping, sector in ((0, 0, 0), (1, -1, 1), (-1, 1, -1), (0.3, 0.2, 0.6)):
        member = made.model.evaluate({"M": mass, "Fv": damping, name: sector})
        M, k = 95 * (1 + 0.1 * mass), 200 * (1 + 0.05 * damping) + 0.5 * top * (1 + sector)
        wanted = 35.0 / (M * 1j * omega + k)
        np.testing.assert_allclose(rl.frequency_response(member, omega)[:, 0, 0], wanted, rtol=1e-9)
    parameter = next(b.parameter for b in made.model.blocks if b.name == name)
    assert (parameter.low, parameter.high) == pytest.approx((0.0, top))
    assert "Fc = 20" in made.origins[name]
    assert "Coulomb" in made.origins[name]


def test_every_block_has_an_origin_and_keeps_it_in_a_file(tmp_path):
    made = uncertain_from(
        servo(
            coulomb_friction={"Fc": (20.0, 1.0)},
            input_delay={"d": (2e-3, 1e-4)},
            input_gain={"s": (0.95, 0.01)},
            **{"quantisation@q": {"lsb": 1e-4}},
            constant_load={"T0": 3.0},
        ),
        amplitude={"v": 0.05},
    )
    assert set(made.origins) == {"M", "Fv", "coulomb-friction@v", "input-delay@u", "input-gain@u"}
    assert all(made.origins.values())
    assert {n.name: (n.bound, n.unit) for n in made.noise} == {
        "load v: constant-load": (3.0, "N"),
        "noise q: quantisation": (5e-5, "m"),
    }
    assert made.model.nominal.input_names == ("load v: constant-load", "noise q: quantisation", "u")
    path = rl.save(tmp_path / "u.h5", made.model)
    again = rl.load(path)
    assert {b.name: b.origin for b in again.blocks} == made.origins
    assert again.blocks == made.model.blocks
    centred = again.centred()  # they stay through the algebra, too
    assert {b.name: b.origin for b in centred.blocks} == made.origins
    assert dict(made.facts())["input noise q: quantisation"].startswith("at most 5e-05 m, ")
    assert all(origin in made.report() for origin in made.origins.values())


def test_loads_and_noise_act_where_they_should():
    made = uncertain_from(servo(constant_load={"T0": 3.0}, **{"quantisation@q": {"lsb": 1e-4}}), amplitude={})
    s = 1j * np.array([0.5, 7.0])
    response = rl.frequency_response(made.model.evaluate({"M": 1.0}), s.imag)
    names = made.model.nominal.output_names
    q, v = names.index("q"), names.index("v")
    np.testing.assert_allclose(response[:, v, 0], 3.0 / (95 * 1.1 * s + 200), rtol=1e-9)  # the heavier mass, too
    np.testing.assert_allclose(response[:, q, 1], 5e-5, rtol=1e-12)
    np.testing.assert_allclose(response[:, v, 1], 0.0, atol=1e-15)


@pytest.mark.parametrize(
    ("spread", "pade"), [(0.0, 1), (0.0, 3), (1e-5, 4), (3e-3, 1), (3e-3, 2), (10e-3, 2), (0.03, 3)]
)
def test_every_delay_lies_inside_the_weight(spread, pade):
    delay = 10e-3
    made = delay_block(delay, spread, pade, "delay")
    omega = np.geomspace(0.05, 9e6, 40001)
    nominal = rl.frequency_response(made.nominal, omega)[:, 0, 0]
    weight = rl.frequency_response(made.M, omega)[:, 0, 1]
    np.testing.assert_allclose(np.abs(nominal), 1.0, rtol=1e-9)
    assert made.M.is_stable()
    assert rl.zeros(made.M[0, 1]).values.real.max() <= 0.03 / delay  # Delta = error / w is stable
    largest = np.zeros(len(omega))
    for d in np.linspace(max(delay - spread, 0.0), delay + spread, 7):
        error = np.exp(-1j * omega * d) - nominal
        seen = np.abs(error) > 1e-8  # below that the differences of these exponentials are rounding
        assert (np.abs(error) <= np.abs(weight))[seen].all()
        largest = np.maximum(largest, np.abs(error))
        k = 20000
        member = made.response(omega[k : k + 1], {"delay": [[error[k] / weight[k]]]})[0, 0, 0]
        assert member == pytest.approx(np.exp(-1j * omega[k] * d), rel=1e-9)
    # and is not much larger than necessary: the error decreases repeatedly, the weight bounds its running maximum
    hull = np.maximum.accumulate(largest)
    assert (np.abs(weight) / hull)[hull > 0.1].max() < 1.75


def test_dry_friction_is_a_bounded_force_at_every_speed():
    """Without an amplitude it is no gain at all; the steady speed under a constant drive is that of the simulation."""
    plant = servo(coulomb_friction={"Fc": (20.0, 1.5)})
    made = uncertain_from(plant, ["v"])
    assert {b.name for b in made.model.blocks} == {"M", "Fv"}
    (load,) = made.noise
    assert (load.bound, load.unit) == (pytest.approx(23.0), "N")  # two standard deviations more
    assert "every motion" in load.origin
    assert made.approximate == ()
    t = np.arange(4000) * 1e-3
    speed = rl.simulate(plant, t, np.full(4000, 5.0))["v"][-1]
    reached = made.model.nominal.dc_gain() @ [-20.0 / load.bound, 5.0]
    assert speed == pytest.approx(float(reached[0]), rel=1e-3)
    with pytest.raises(rl.InputError, match="without an amplitude"):
        uncertain_from(servo(quadratic_drag={"c": 30.0}), ["v"])  # grows with the speed: no bound


@pytest.mark.parametrize("share", [-1.0, 0.0, 1.0])
def test_friction_both_ways_makes_every_motion_within_its_reach(share):
    """-k v + e, |e| <= Fc, is the true force at each instant: at standstill, moving, for every gain of the block."""
    both = uncertain_from(servo(coulomb_friction={"Fc": 20.0}), ["v"], amplitude={"v": (0.05, 0.5)}, dry="both")
    gain = next(b.parameter for b in both.model.blocks if "coulomb" in b.name).value(share)
    (load,) = both.noise
    v = np.linspace(-1.0, 1.0, 401) * min(0.5 * math.pi * 0.5, 2 * 20.0 / gain)
    force = np.where(v == 0, 20.0, -20.0 * np.sign(v))  # sticking: any force up to Fc
    assert np.abs(force + gain * v).max() <= load.bound * (1 + 1e-12)
    s = 1j * np.array([0.3, 9.0])
    member = rl.frequency_response(both.model.evaluate({"coulomb-friction@v": share}), s.imag)[:, 0]
    np.testing.assert_allclose(member, np.array([[20.0, 35.0]]) / (95 * s + 200 + gain)[:, None], rtol=1e-9)


def test_gear_losses_scale_the_net_force_whatever_the_mass():
    """M v' = (1 + (1 - eta) delta) (gain u - Fv v): at delta = -1 a machine that speeds up, as simulated."""
    plant = servo(gear_efficiency={"eta": (0.8, 0.01)})
    made = uncertain_from(plant, ["v"], amplitude={})
    assert made.left_out == {}
    name = "gear-efficiency@v"
    s = 1j * np.array([0.3, 3.0, 40.0])
    for mass, loss in ((0.0, 1.0), (1.0, -1.0), (-1.0, 0.4)):
        member = made.model.evaluate({"M": mass, name: loss})
        share = 1 + 0.22 * loss  # eta less two standard deviations
        wanted = share * 35 / (95 * (1 + 0.1 * mass) * s + share * 200)
        np.testing.assert_allclose(rl.frequency_response(member, s.imag)[:, 0, 0], wanted, rtol=1e-9)
    t = np.arange(1500) * 1e-3
    measured = rl.simulate(plant, t, np.full(1500, 4.0))["v"]
    member = uncertain_from(servo(gear_efficiency={"eta": 0.8}), ["v"]).model.evaluate({name: -1.0})
    np.testing.assert_allclose(rl.simulate(member, t, np.full(1500, 4.0))["v"], measured, rtol=2e-3, atol=1e-5)


def test_forces_over_the_position():
    """M s^2 + Fv s + k with k anywhere in the sector 0 .. k3 a^2; cogging is a bounded force, or a stiffness +- k A."""
    stiff = servo(cubic_stiffness={"k3": 1e4})
    made = uncertain_from(stiff, ["q"], amplitude={"q": 0.2})
    s = 1j * np.array([0.7, 5.0])
    member = made.model.evaluate({"cubic-stiffness@v": 0.5})
    np.testing.assert_allclose(
        rl.frequency_response(member, s.imag)[:, 0, 0], 35 / (95 * s**2 + 200 * s + 0.75 * 400), rtol=1e-9
    )
    wave = servo(cogging={"Ac": 3.0, "As": 4.0, "k": 100.0})
    (load,) = uncertain_from(wave, ["q"]).noise
    assert load.bound == 5.0
    shaped = uncertain_from(wave, ["q"], amplitude={"q": 0.01})
    found = next(b.parameter for b in shaped.model.blocks if "cogging" in b.name)
    assert (found.low, found.high) == (-500.0, 500.0)
    assert uncertain_from(wave, ["q"], amplitude={"q": 0.01}, dry="both").approximate == ()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"dry": "gain"}, "without an amplitude"),
        ({"dry": "wet"}, "one of gain, load, both"),
        ({"amplitude": {"v": 1.0, "nowhere": 1.0}}, "no effect there"),
        ({"amplitude": {"v": -1.0}}, "positive"),
        ({"amplitude": {"v": (2.0, 1.0)}}, "least, largest"),
        ({"amplitude": {"v": 1.0}, "sigmas": -1.0}, "sigmas"),
        ({"amplitude": {"v": 1.0}, "pade": 0}, "a whole number from 1 to 8"),
    ],
)
def test_bad_inputs_are_named(options, words):
    with pytest.raises(rl.InputError, match=words):
        uncertain_from(servo(coulomb_friction={"Fc": 20.0}), **options)


def test_a_discovery_becomes_a_set_with_what_it_could_not_explain():
    x = np.array([-0.3, -0.1, 0.1, 0.2, 0.4])
    curve = ForceCurve("speed", "m/s", x, x, x - 1, x + 1, np.full(5, 40), 0.4)
    found = Discovery(
        status=rl.Status.INCONCLUSIVE, verdict="unknown", complete=False, effects=(), rivals=(), nominal=(),
        gap_before=3.0, gap_refitted=2.0, gap_after=1.0, gaps={}, held_out="test", plant="servo-axis",
        records=("train",), window=1.0, candidates=(), structure={},
        residual_force=ResidualForce("N", 2.5, 0.1, {"speed": curve}, 16),
        model=servo(coulomb_friction={"Fc": 20.0}),
    )  # fmt: skip
    made = uncertain_from(found, ["v"])
    assert [(n.name, n.bound) for n in made.noise] == [("load v: coulomb-friction", 20.0), ("load v: unnamed", 7.5)]
    assert "train" in made.noise[1].origin
    drag = dataclasses.replace(found, model=servo(quadratic_drag={"c": 50.0}))
    assert drag.uncertain_model(["v"]).blocks[-1].parameter.high == pytest.approx(50 * 0.4)  # the largest speed
    assert found.uncertain_model(["v"], amplitude={"v": 1.0}).blocks[-1].parameter.high == pytest.approx(80 / math.pi)
    with pytest.raises(rl.InputError, match="without an updated plant"):
        uncertain_from(dataclasses.replace(found, model=None))
    settled = uncertain_from(dataclasses.replace(found, complete=True), ["v"])
    assert [n.name for n in settled.noise] == ["load v: coulomb-friction"]


def test_a_set_with_friction_as_a_load_makes_the_record_of_another_machine_within_its_ranges():
    """The member at the true mass, driven by the true friction (read off a simulation at coarse, rounded times)."""
    true = rl.with_effects(rl.plant("servo-axis", M=101.0, Fv=200.0, gain=35.0), {"coulomb-friction": {"Fc": 21.5}})
    t = np.arange(500) * 2.5e-3
    u = 3.0 * np.sin(9.0 * t) + np.sign(np.sin(4.0 * t))
    record = rl.simulate(true, t, u)
    rounded = rl.Record(np.round(t * (1 + 1e-7), 7), {"u": u}, {"q": record["q"]}, {"u": "V", "q": "m"}, "run")
    made = uncertain_from(servo(coulomb_friction={"Fc": (20.0, 1.0)}), ["q"])
    seen = effect_loads(true).along(rounded)
    signal = seen["load v: coulomb-friction"] * 21.5 / made.noise[0].bound
    assert np.abs(signal).max() <= 1.0
    mass = next(b.parameter for b in made.model.blocks if b.name == "M").delta(101.0)
    member = made.model.evaluate({"M": mass})
    again = rl.simulate(member, t, np.column_stack([signal, u]))["q"]
    np.testing.assert_allclose(again, record["q"], atol=2e-5 * np.ptp(record["q"]))
