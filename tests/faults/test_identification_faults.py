"""Input that `compare` rejects, and its warnings."""

import numpy as np
import pytest

import robustlab as rl
from robustlab.errors import InputError, NoTrustworthyNumber, UnitMismatch
from robustlab.statespace import StateSpaceModel

T = np.arange(500) * 1e-2
U = np.repeat(np.random.default_rng(0).standard_normal(10), 50)
Q = rl.simulate(rl.plant("servo-axis"), T, U)["q"]


def record(inputs=None, outputs=None, units=None, t=T):
    return rl.Record(t, {"u": U} if inputs is None else inputs, {"q": Q} if outputs is None else outputs, units, "run3")


def test_a_missing_input_is_reported_with_the_existing_ones():
    with pytest.raises(InputError, match=r"no input 'u'.*voltage.*expected every input") as caught:
        rl.compare(rl.plant("servo-axis"), record(inputs={"voltage": U}))
    assert caught.value.exit_code == 3
    with pytest.raises(InputError, match=r"no input 'u'.*none"):
        rl.compare(rl.plant("servo-axis"), record(inputs={}))


def test_a_plant_with_effects_is_not_judged_by_its_linear_part():
    with pytest.raises(InputError, match="nonlinear plant"):
        rl.compare(rl.with_effects(rl.plant("servo-axis"), {"coulomb-friction": {"Fc": 20.0}}), record())


@pytest.mark.parametrize("units", [{"u": "A", "q": "m"}, {"q": "deg"}])
def test_units_that_disagree(units):
    with pytest.raises(UnitMismatch) as caught:
        rl.compare(rl.plant("servo-axis"), record(units=units))
    assert caught.value.exit_code == 3
    wrong = next(name for name, unit in units.items() if unit not in ("V", "m"))
    assert units[wrong] in str(caught.value)


def test_another_unit_of_the_same_measure_is_converted_and_reported():
    """A record in millimetres has the same model error as in metres."""
    plain = rl.compare(rl.plant("servo-axis"), record(units={"q": "m"}))
    other = record(inputs={"u": 1e3 * U}, outputs={"q": 1e3 * Q}, units={"u": "mV", "q": "mm"})
    found = rl.compare(rl.plant("servo-axis"), other)
    assert found.outputs["q"].unit == "m"
    assert found.outputs["q"].rms == pytest.approx(plain.outputs["q"].rms, rel=1e-9)
    assert any(text == "q: recorded in mm, converted to m (times 0.001)" for text in found.warnings)
    assert any(text == "u: recorded in mV, converted to V (times 0.001)" for text in found.warnings)


def test_units_not_stated_are_taken_from_the_model_with_a_warning():
    found = rl.compare(rl.plant("servo-axis"), record())
    assert found.outputs["q"].unit == "m"
    assert any(text.startswith("q: the record does not state a unit; taken as m") for text in found.warnings)
    assert found.speed  # and so the position is known as one
    plain = StateSpaceModel([[-1.0]], [[1.0]], [[1.0]], [[0.0]], inputs=["u"], outputs=["q"])
    assert any("neither the record nor the model" in text for text in rl.compare(plain, record()).warnings)


@pytest.mark.parametrize("window", [0.0, -1.0, 1e-3, 100.0, float("nan"), float("inf")])
def test_windows_that_do_not_fit(window):
    with pytest.raises(InputError, match="window"):
        rl.compare(rl.plant("servo-axis"), record(), window=window)


def test_overflow_of_an_unstable_free_run():
    model = StateSpaceModel([[300.0]], [[1.0]], [[1.0]], [[0.0]], inputs=["u"], outputs=["q"])
    with pytest.raises(NoTrustworthyNumber) as caught:
        rl.compare(model, record())
    assert caught.value.exit_code == 4


def test_constant_and_clipped_channels_are_named():
    still = rl.compare(rl.plant("servo-axis"), record(inputs={"u": 0 * U}, outputs={"q": 0 * Q}))
    assert "u is constant: 0 V" in still.warnings
    assert "q is constant: 0 m" in still.warnings
    assert np.isnan(still.outputs["q"].fit)
    low, high = np.quantile(Q, [0.0, 0.7])
    clipped = rl.compare(rl.plant("servo-axis"), record(outputs={"q": np.clip(Q, low, high)}))
    assert any(text.startswith("q looks clipped") for text in clipped.warnings)
    assert not any("clipped" in text for text in rl.compare(rl.plant("servo-axis"), record()).warnings)


def test_a_record_shorter_than_the_slowest_time_constant():
    slow = StateSpaceModel([[-0.01]], [[1.0]], [[1.0]], [[0.0]], inputs=["u"], outputs=["q"])
    assert any("slowest time constant of the model is 100 s" in text for text in rl.compare(slow, record()).warnings)


@pytest.mark.parametrize("n", [2, 3, 5, 21])
def test_very_short_records(n):
    short = rl.Record(T[:n], {"u": U[:n]}, {"q": Q[:n]}, {"u": "V", "q": "m"})
    found = rl.compare(rl.plant("servo-axis"), short)
    assert found.status.trustworthy
    assert found.summary()


@pytest.mark.slow
def test_a_record_without_noise_whose_windows_do_not_show_their_whole_start():
    t = np.arange(600) * 5e-3
    u = np.repeat(np.random.default_rng(0).standard_normal(24), 25)
    q = rl.simulate(rl.plant("servo-axis"), t, u)["q"]
    found = rl.discover(rl.plant("servo-axis"), [rl.Record(t, {"u": u}, {"q": q})])
    assert found.verdict == "no missing effect"
    assert found.effects == ()
