"""Blind cases: reproducible, within tolerance, of the requested kind, and visible."""

import numpy as np
import pytest
from hidden import CURRENT_ONLY, FAMILIES, make_case

import robustlab as rl

MOTOR, AXIS, ACTUATOR = (FAMILIES[name] for name in ("motor", "axis", "actuator"))
PAIRS = MOTOR.pairs


def same(a, b):
    return all(np.array_equal(a[name], b[name]) for name in (*a.inputs, *a.outputs))


def test_enough_classes():
    assert len(FAMILIES) == 6
    for family in FAMILIES.values():
        assert len(family.classes) >= 20
        assert len(family.outside) >= 7
        assert len(family.pairs) >= 8
        assert len(set(family.classes)) == len(family.classes)
        assert not set(family.outside) & {*family.classes}
        assert all(len(set(pair)) == 2 and set(pair) <= set(family.classes) for pair in family.pairs)
    assert {*CURRENT_ONLY} <= {*FAMILIES["motor-current"].classes} - {*MOTOR.classes}


@pytest.mark.slow
@pytest.mark.parametrize("effect", ["none", "stribeck-friction", "telegraph-load", PAIRS[0]])
def test_a_seed_is_a_case(effect):
    a, b, c = (make_case(effect, seed, duration=0.6, current=True) for seed in (3, 3, 4))
    assert same(a.record, b.record)
    assert same(a.held_out, b.held_out)
    assert same(a.repeat, b.repeat)
    assert a.true_parameters == b.true_parameters
    assert not np.array_equal(a.record["u"], c.record["u"])
    assert a.perturbed != c.perturbed
    assert effect == "none" or a.true_parameters != c.true_parameters


@pytest.mark.parametrize("plant", ["dc-motor", "linear-actuator", "servo-axis", "mass-spring-damper", "two-mass"])
def test_every_nominal_parameter_is_off_within_its_tolerance(plant):
    seen = []
    for seed in range(12):
        case = make_case("none", seed, plant=plant, duration=0.05)
        for name, factor in case.perturbed.items():
            p = case.plant.parameters[name]
            assert p.tolerance > 0
            assert abs(factor - 1) <= p.tolerance
            seen.append((factor - 1) / p.tolerance)
        if "Km" in case.perturbed:
            assert case.perturbed["Km"] == case.perturbed["Kb"]
        assert case.true_parameters == {}
    assert min(seen) < -0.7  # and the tolerance is used
    assert max(seen) > 0.7


@pytest.mark.parametrize("effect", ["none", "coulomb-friction", "sensor-gain"])
def test_the_three_records(effect):
    case = make_case(effect, 1, duration=1.2, current=True)
    assert case.record.n == case.held_out.n == case.repeat.n == 1200
    assert case.record.dt == pytest.approx(1e-3)
    assert (case.record.unit("u"), case.record.unit("phi"), case.record.unit("i")) == ("V", "rad", "A")
    assert np.array_equal(case.record["u"], case.repeat["u"])
    assert not np.array_equal(case.record["phi"], case.repeat["phi"])
    assert not np.array_equal(case.record["u"], case.held_out["u"])
    counts = case.record["phi"] / (2 * np.pi / 2000)
    assert np.allclose(counts, np.round(counts), atol=1e-6)
    # Noise of record and repeat are draws of one kind, about the same truth.
    noise = [np.diff(r["phi"] - case.record_clean["phi"]) for r in (case.record, case.repeat)]
    assert np.std(noise[0]) == pytest.approx(np.std(noise[1]), rel=0.1)
    assert abs(np.corrcoef(*noise)[0, 1]) < 0.15
    current = case.record["i"] - case.record_clean["i"]
    assert np.std(current) == pytest.approx(2e-2, rel=0.15)


def test_the_nominal_plant_of_none_is_the_truth_up_to_its_tolerance():
    case = make_case("none", 7, noise="low", duration=2.0, current=True)
    exact = {name: p.value * case.perturbed[name] for name, p in case.plant.parameters.items()}
    got = rl.simulate(rl.plant("dc-motor", **exact), case.record.t, case.record["u"])
    assert np.abs(got["phi"] - case.record_clean["phi"]).max() < 1e-4
    assert np.abs(got["i"] - case.record_clean["i"]).max() < 1e-4
