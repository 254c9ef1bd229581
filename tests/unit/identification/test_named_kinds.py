"""Answers at the level at which they are sure: kinds of effects, their quantities, and what does not matter."""

from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st
from naming_cases import AXIS, FRICTION, LOAD, T, U, machine, noisy, searched

import robustlab as rl
from robustlab.dynamics import KIND_OF, KINDS, MEANINGS, Scales, Site, catalogue, local_port_model, port_model, upwards
from robustlab.identification.naming.discovery_numbers import numbers_of
from robustlab.identification.naming.named_effects import NamedKind
from robustlab.identification.naming.named_kinds import Kinds, Places, _mixture, _quantile, kinds_of
from robustlab.identification.naming.posterior import weigh
from robustlab.identification.naming.quantities import Told

LEVEL, GIVES = 20.0, 2e-4  # N, m

# --- the tree --------------------------------------------------------------------------------------------------------


def test_every_effect_has_a_kind_and_every_kind_leads_to_the_top():
    assert set(KIND_OF) == set(catalogue())
    for name, kind in KIND_OF.items():
        way = [k.id for k in upwards(kind)]
        assert len(way) == len(set(way)), name
        assert KINDS[way[-1]].wider is None
    assert all(k.wider is None or k.wider in KINDS for k in KINDS.values())
    assert all(q in MEANINGS for k in KINDS.values() for q in k.quantities)


def posterior_of(*sets):
    """A posterior of (probability, effects at v) pairs."""

    def candidate(name):
        site = Site("joint", "v")
        return SimpleNamespace(effect=catalogue()[name], site=site, key=f"{name} @ v")

    entries = []
    for probability, names in sets:
        own = tuple(candidate(n) for n in names)
        fit = SimpleNamespace(hypothesis=SimpleNamespace(candidates=own))
        entries.append(SimpleNamespace(probability=probability, fit=fit, key=frozenset(c.key for c in own)))
    return SimpleNamespace(sets=tuple(entries))


def judged(*sets, ignored=frozenset(), sure=0.95):
    kinds = Kinds(posterior_of(*sets), Places(AXIS, port_model(AXIS)), sure, ignored)
    told = {n[0] for e in kinds.posterior.sets for c in e.fit.hypothesis.candidates if (n := kinds.told(c))}
    return told, {c.effect.id for c in kinds.open()}


def test_the_narrowest_kind_that_is_sure_is_told():
    assert judged((0.77, ["presliding"]), (0.23, ["bouc-wen"])) == ({"dry-friction"}, set())
    assert judged((0.6, ["coulomb-friction"]), (0.4, ["viscous-friction"])) == ({"resisting-force"}, set())
    # "A force" is no name: what is either friction or a load is open.
    assert judged((0.6, ["coulomb-friction"]), (0.4, ["constant-load"])) == (
        set(),
        {"coulomb-friction", "constant-load"},
    )


@pytest.mark.parametrize("motors", [False, True])
def test_input_and_sensor_of_one_leg_are_one_path(motors):
    """The rotor has nearly all of a leg's inertia: each input moves its own nut most, if through a current."""
    platform = rl.plant("stewart-platform", preset="physical", motors=motors)
    x, u = np.zeros((2, len(platform.states))), np.zeros((2, 6))
    places = Places(platform, local_port_model(platform, platform.local_models(x, u)))
    lateness, name = KINDS["lateness"], "u" if motors else "torque"
    for leg in range(1, 7):
        ends = Site("input", f"{name}_{leg}"), Site("output", f"phi_{leg}")
        assert {places.of(end, lateness) for end in ends} == {f"{name}_{leg} to phi_{leg}"}


# --- quantities ------------------------------------------------------------------------------------------------------


def dahl_run(u, sub=20):
    """The axis with Dahl's friction, by small explicit steps of its own."""
    p, h = AXIS.values, (T[1] - T[0]) / sub
    q = v = z = 0.0
    found = np.empty((len(u), 2))
    for k, now in enumerate(u):
        found[k] = q, v
        for _ in range(sub):
            force = -LEVEL / GIVES * z
            middle = v + 0.5 * h * (p["gain"] * now - p["Fv"] * v + force) / p["M"]
            z += h * (middle - abs(middle) * z / GIVES)
            v += h * (p["gain"] * now - p["Fv"] * middle - LEVEL / GIVES * z) / p["M"]
            q += h * middle
    return found


@cache
def dahl_record():
    q, v = dahl_run(U).T
    return rl.Record(T, {"u": U}, noisy({"q": q, "v": v}, 5), name="bristles")


@pytest.mark.slow
def test_bristles_are_dry_friction_of_their_level_in_whatever_form():
    found = searched(dahl_record(), (FRICTION, "presliding @ v", "bouc-wen @ v", LOAD))
    kinds = kinds_of(found.problem, weigh(found))
    assert not kinds.open()
    (named,) = kinds.named(found.problem)
    assert (named.kind, named.place) == ("dry-friction", "v")
    assert named.probability > 0.95
    (level,) = named.values
    assert level.name == "level"
    assert level.lower < level.value < level.upper
    assert level.value == pytest.approx(LEVEL, rel=0.05)  # less what the bristles give back at reversals
    assert sum(m.share for m in named.members) == pytest.approx(1.0, abs=1e-6)


def test_a_mixture_has_the_mean_and_the_ends_of_its_members():
    one = _mixture("level", [(1.0, {"level": Told(3.0, 0.5, "N")})])
    assert (one.lower, one.upper) == pytest.approx((3.0 - 1.96 * 0.5, 3.0 + 1.96 * 0.5), abs=1e-3)
    apart = _mixture("level", [(0.5, {"level": Told(1.0, 0.01, "N")}), (0.5, {"level": Told(2.0, 0.01, "N")})])
    assert apart.value == pytest.approx(1.5)
    assert apart.lower < 1.0 < 2.0 < apart.upper
    # Sampled, as a check of the bisection.
    parts = [(0.3, Told(0.0, 1.0, "")), (0.7, Told(4.0, 0.2, ""))]
    rng = np.random.default_rng(0)
    drawn = np.where(rng.uniform(size=200_000) < 0.3, rng.normal(size=200_000), 4.0 + 0.2 * rng.normal(size=200_000))
    assert _quantile(parts, 0.1) == pytest.approx(np.quantile(drawn, 0.1), abs=0.02)
    # What has another unit, or cannot be asked, is left out; where nobody can be asked there is no value.
    mixed = _mixture("level", [(0.9, {"level": Told(1.0, 0.1, "N")}), (0.1, {"level": Told(9.0, 0.1, "")}), (0.1, {})])
    assert mixed.value == 1.0
    assert _mixture("level", [(1.0, {})]) is None
    assert _quantile([(1.0, Told(2.0, 0.0, ""))], 0.5) == pytest.approx(2.0)


# --- twins by algebra ------------------------------------------------------------------------------------------------


def path(rng):
    """A mass on a spring and a damper, three seconds, and steps of its force."""
    m, c, k = rng.uniform(0.5, 5.0), rng.uniform(1.0, 30.0), rng.uniform(60.0, 400.0)
    plant = rl.StateSpaceModel(
        [[0.0, 1.0], [-k / m, -c / m]], [[0.0], [1.0 / m]], [[1.0, 0.0]], [[0.0]],
        states=[("q", "m"), ("v", "m/s")], inputs=[("u", "N")], outputs=[("q", "m")],
    )  # fmt: skip
    t = 5e-3 * np.arange(600)
    u = np.repeat(rng.uniform(-3.0, 3.0, 30), 20)
    return plant, t, u


@pytest.mark.slow
@settings(max_examples=6, phases=[Phase.explicit, Phase.reuse, Phase.generate])
@given(seed=st.integers(0, 10_000), late=st.floats(2.5, 9.4))
def test_a_late_sensor_and_a_late_input_of_one_path_are_equally_probable(seed, late):
    """Random masses, dampings, springs; any delay, in parts of a sample too."""
    rng = np.random.default_rng(seed)
    plant, t, u = path(rng)
    shifted = np.concatenate([np.full(round(10 * late), u[0]), np.repeat(u, 10)])[:6000]
    clean = rl.simulate(plant, 5e-4 * np.arange(6000), {"u": shifted})["q"][::10]
    record = rl.Record(t, {"u": u}, noisy({"q": clean}, seed, 1e-4), {"u": "N", "q": "m"}, name="late")
    found = rl.discover(plant, record, exclude=tuple(set(catalogue()) - {"sensor-delay", "input-delay"}))
    by_names = {s.names: s.probability for s in found.posterior}
    one, other = by_names[("sensor-delay",)], by_names[("input-delay",)]
    assert abs(np.log(one / other)) < 0.1
    assert [k.kind for k in found.kinds] == ["lateness"]
    assert found.verdict == "named"
    (delay,) = found.kinds[0].values
    assert delay.value == pytest.approx(late * 5e-3, abs=3e-3)  # half a sample is what lies between the samples
    assert "a lateness of" in found.headline()


@pytest.mark.parametrize("seed", [0, *(pytest.param(k, marks=pytest.mark.slow) for k in (1, 2))])
@pytest.mark.parametrize(
    ("pair", "gain", "bias", "apart", "kinds"),
    [
        (("input-gain", "sensor-gain"), 1.12, 0.0, 0.1, ["factor"]),
        (("constant-load", "sensor-bias"), 1.0, 2e-3, 0.3, []),
    ],
)
def test_gains_and_zeros_of_one_path_are_equally_probable(seed, pair, gain, bias, apart, kinds):
    """What a gain does before a linear plant it does behind it; a bias of a spring's end is a load on it."""
    rng = np.random.default_rng(seed)
    plant, t, u = path(rng)
    clean = rl.simulate(plant, t, {"u": gain * u})["q"] + bias
    record = rl.Record(t, {"u": u}, noisy({"q": clean}, seed, 1e-4), {"u": "N", "q": "m"}, name="twins")
    found = rl.discover(plant, record, exclude=tuple(set(catalogue()) - set(pair)))
    by_names = {s.names: s.probability for s in found.posterior}
    assert abs(np.log(by_names[pair[:1]] / by_names[pair[1:]])) < apart
    assert [kind.kind for kind in found.kinds] == kinds
    assert found.verdict == ("named" if kinds else "ambiguous")


# --- what matters ----------------------------------------------------------------------------------------------------


def test_what_only_a_parameter_beyond_its_tolerance_can_replace_matters():
    """A gain a tenth off: the mass, 9 % off, does the same, and may be 5 % off."""
    run = rl.simulate(AXIS.with_parameters(gain=1.1 * AXIS.values["gain"]), T, U)
    record = rl.Record(T, {"u": U}, noisy({k: run[k] for k in ("q", "v")}, 0), name="strong")
    few = tuple(set(catalogue()) - {"input-gain", "coulomb-friction"})
    found = rl.discover(AXIS, record, exclude=few, tolerances={"M": 0.05, "Fv": 0.05})
    assert found.names == ("input-gain",)
    assert not found.also_detectable
    (factor,) = found.kinds[0].values
    assert found.kinds[0].kind == "factor"
    assert factor.value == pytest.approx(1.1, rel=0.03)


# --- what may be an answer -------------------------------------------------------------------------------------------

SEEN = Scales(speed=2.0, position=0.1, lowest=-0.05, highest=0.05, duration=4.0, position_unit="m")


@pytest.mark.parametrize(
    ("name", "inside", "outside"),
    [
        ("presliding", {"Fc": 20.0, "sigma0": 1e4}, {"Fc": 20.0, "sigma0": 100.0}),
        ("bouc-wen", {"qy": 0.02}, {"qy": 0.73}),
        ("stribeck-friction", {"vs": 0.1}, {"vs": 2.5}),
        ("end-stop", {"q_min": -0.2, "q_max": 0.04}, {"q_min": -0.2, "q_max": 0.06}),
        ("torque-ripple", {"f": 1.0}, {"f": 0.3}),
        ("resistance-heating", {"T": 40.0}, {"T": 0.034}),
    ],
)
def test_an_effect_whose_scale_the_record_does_not_visit_is_no_answer(name, inside, outside):
    assert catalogue()[name].visited(inside, SEEN)
    assert not catalogue()[name].visited(outside, SEEN)
    if name in ("presliding", "bouc-wen", "end-stop"):  # of a joint whose position nobody knows nothing is said
        assert catalogue()[name].visited(outside, Scales())


# --- what is told ----------------------------------------------------------------------------------------------------


def test_requirements_may_ask_for_a_kind_and_its_quantities():
    found = rl.discover(AXIS, machine(friction=20.0, seed=3), exclude=tuple(set(catalogue()) - {"coulomb-friction"}))
    numbers = numbers_of(found)
    dry = numbers["dry-friction"]
    assert numbers["kinds"] == ["dry-friction"]
    assert dry["probability"] > 0.95
    assert dry["level_lower"] < 20.0 < dry["level_upper"]
    assert numbers["lateness"]["probability"] == 0.0
    assert np.isnan(numbers["lateness"]["delay"])
    assert set(numbers) <= set(type(found).quantities)
    (kind,) = found.kinds
    assert isinstance(kind, NamedKind)
    assert kind.settled
    assert kind.words == "dry friction at v"
    assert "work against the motion" not in found.summary()  # its form is settled: the effect says it
