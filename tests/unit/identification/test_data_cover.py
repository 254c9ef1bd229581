"""The smallest unmodelled dynamics of records, and effects as loads that are known along them."""

import numpy as np
import pytest

import robustlab as rl
from robustlab.dynamics import effect_loads
from robustlab.errors import InputError

T = np.arange(400) * 5e-3
PUSH = np.where(T < 0.5, 2.0, np.where(T < 1.2, -1.5, 1.8))  # V


def axis(**effects):
    plain = rl.plant("servo-axis", M=(95.0, 0.05), Fv=(200.0, 0.1), gain=35.0)
    return rl.with_effects(plain, effects) if effects else plain


def record(plant, name="run"):
    run = rl.simulate(plant, T, PUSH)
    return rl.Record(T, {"u": PUSH}, {"q": run["q"]}, {"u": "V", "q": "m"}, name)


def test_the_linear_part_with_the_loads_reproduces_the_plant_with_effects():
    rough = axis(**{"coulomb-friction": {"Fc": 20.0}, "input-dead-zone": {"d": 0.3}})
    loads = effect_loads(rough)
    seen = loads.along(record(rough))
    drop, friction = (f"load {site}: {name}" for site, name in (("u", "input-dead-zone"), ("v", "coulomb-friction")))
    assert {x.name: x.bound for x in loads.loads} == {drop: 0.3, friction: 20.0}
    # Sliding friction is -Fc sgn v, the driver takes d off every voltage: known in closed form.
    v = rl.simulate(rough, T, PUSH)["v"]
    sliding = (np.abs(v[:-1]) > 1e-3) & (np.sign(v[:-1]) == np.sign(v[1:])) & (np.abs(v[1:]) > 1e-3)
    assert seen[friction][:-1][sliding] == pytest.approx(-np.sign(v[:-1][sliding]), abs=1e-6)
    assert seen[drop] == pytest.approx(-np.sign(PUSH))
    nominal = loads.model.nominal
    again = rl.simulate(nominal, T, {name: seen[name] for name in nominal.input_names})
    assert again["q"] == pytest.approx(seen["q"], abs=20.0 * 5e-3**2 / 95.0)  # a reversal within a sample


def test_forces_at_one_joint_are_separated_by_their_laws():
    both = axis(**{"coulomb-friction": {"Fc": 20.0}, "quadratic-drag": {"c": 400.0}})
    run = record(both)
    loads = effect_loads(both, records=[run])
    friction, drag = (x.name for x in loads.loads)
    v = rl.simulate(both, T, PUSH)["v"]
    # Half of their sum, as least squares share it, is less than the drag alone.
    assert loads.loads[1].bound == pytest.approx(400.0 * np.abs(v).max() ** 2, rel=1e-6)
    seen = loads.along(run)
    assert np.abs(seen[friction]).max() <= 1 + 1e-3
    moving = (np.abs(v[:-1]) > 0.05) & (np.abs(v[1:]) > 0.05)
    true = -0.5 * 400.0 * (v[:-1] * np.abs(v[:-1]) + v[1:] * np.abs(v[1:]))
    assert (seen[drag][:-1] * loads.loads[1].bound)[moving] == pytest.approx(true[moving], abs=0.02)
    nominal = loads.model.nominal
    again = rl.simulate(nominal, T, {name: seen[name] for name in nominal.input_names})
    assert again["q"] == pytest.approx(seen["q"], abs=20.0 * 5e-3**2 / 95.0)


@pytest.mark.parametrize(
    ("effect", "values", "times"),
    [("quadratic-drag", {"c": (400.0, 20.0)}, 1.1), ("gear-efficiency", {"eta": (0.9, 0.01)}, 1.2)],
)
def test_the_range_of_a_fitted_value_adds_to_the_bound_along_a_record(effect, values, times):
    known = {name: value for name, (value, _) in values.items()}
    run = record(axis(**{effect: known}))
    bare, ranged = (effect_loads(axis(**{effect: v}), records=[run]).loads[0].bound for v in (known, values))
    assert ranged == pytest.approx(times * bare, rel=1e-6)


def test_a_held_out_record_beyond_the_loads_of_the_set_does_not_pass():
    dragged = axis(**{"quadratic-drag": {"c": 60.0}})

    def run(size, name):
        t, u = T[:150], size * PUSH[:150]
        return rl.Record(t, {"u": u}, {"q": rl.simulate(dragged, t, u)["q"]}, {"u": "V", "q": "m"}, name)

    found = rl.data_cover(dragged, [run(1.0, "slow")], {"q": 1e-5}, held_out=[run(6.0, "fast")], at_rest=True)
    assert found.held_out <= found.radius  # the motion itself needs no unmodelled dynamics
    assert found.held_out_loads > 2
    assert found.loads[0].bound == pytest.approx(1.1 * effect_loads(dragged, records=[run(1.0, "slow")]).loads[0].bound)
    assert not found.passes
    assert "NOT explained" in found.summary()
    again = rl.data_cover(dragged, [run(1.0, "slow")], {"q": 1e-5}, held_out=[run(1.04, "little more")], at_rest=True)
    assert again.passes


@pytest.mark.parametrize("gain", [28.0, 42.0])
def test_a_wrong_gain_needs_its_own_share_of_the_input(gain):
    weak = record(rl.plant("servo-axis", M=95.0, Fv=200.0, gain=gain))
    found = rl.data_cover(axis(), [weak], {"q": 1e-7}, at_rest=True, margin=1.0)
    # q is linear in the gain, so that w = (gain / 35 - 1) u explains it; the noise saves less than the precision.
    assert found.needed == pytest.approx(0.2, rel=0.02)
    assert found.needed_lower <= 0.2
    member = found.model.evaluate({"unmodelled@u": np.array([[np.sign(gain - 35.0)]])})
    moved = rl.simulate(member, T, PUSH)
    assert moved["q"] == pytest.approx(weak["q"], rel=0.02, abs=1e-3)


def test_a_named_friction_needs_no_unmodelled_dynamics():
    rough = axis(**{"coulomb-friction": {"Fc": 20.0}})
    runs = [record(rough, "first")]
    before = rl.data_cover(axis(), runs, {"q": 1e-5}, at_rest=True)
    after = rl.data_cover(rough, runs, {"q": 1e-5}, held_out=[record(rough, "second")], at_rest=True)
    assert before.needed_lower > 0.2  # 20 N of 52 to 70 N
    assert after.needed < 1e-3
    assert after.radius == 0.02
    assert after.passes
    assert [b.name for b in after.model.blocks] == ["unmodelled@u", "M", "Fv"]
    assert [s.name for s in after.model.inputs] == ["load v: coulomb-friction", "u"]
    assert after.to_json(series=False)["held_out"] == after.held_out


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"records": []}, "no record"),
        ({"margin": 0.9}, "margin"),
        ({"least": 1.0}, "least"),
        ({"held_out": "same"}, "two records of one name"),
    ],
)
def test_bad_inputs(options, message):
    run = record(axis())
    given = {"records": [run], "held_out": (), **options}
    if given["held_out"] == "same":
        given["held_out"] = [run]
    with pytest.raises(InputError, match=message):
        rl.data_cover(axis(), given.pop("records"), {"q": 1e-6}, **given)
