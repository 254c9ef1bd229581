"""The published frictionless model of the EMPS axis against the measured record (Janot, Gautier, Brunot 2019)."""

from pathlib import Path

import numpy as np
import pytest

import robustlab as rl

EMPS = Path(__file__).parents[3] / "shared" / "data" / "emps.h5"
pytestmark = [pytest.mark.shared, pytest.mark.skipif(not EMPS.exists(), reason="the measured record is not here")]


@pytest.fixture(scope="module", params=["train", "test"])
def comparison(request):
    record = rl.Record.read(EMPS, group=request.param, inputs=["u"], outputs=["q"])
    return request.param, rl.compare(rl.plant("servo-axis"), record, window=0.48)


def test_open_loop_error_over_25_seconds(comparison):
    # An independent program (own stepping, own start) got 132.5 and 137.5 mm.
    group, found = comparison
    expected = {"train": 132.5, "test": 137.5}[group]
    assert 1e3 * found.outputs["q"].rms == pytest.approx(expected, rel=0.005)


def test_windowed_error(comparison):
    # The same program with windows of 480 samples, the model's own free response projected out: 1.79 and 1.885 mm.
    # (With a time constant of 0.4 s in place of M / Fv = 0.467 s and every tenth sample it is 1.997 mm on "test".)
    group, found = comparison
    expected = {"train": 1.796, "test": 1.885}[group]
    assert 1e3 * found.outputs["q"].windowed_rms == pytest.approx(expected, rel=0.01)


def test_the_missing_friction_shows_at_the_input_with_its_published_size(comparison):
    # Published: Coulomb 20.39 N, offset -3.16 N, gain 35.15 N/V: 0.490 V forward, 0.670 V backward (from "train").
    group, found = comparison
    d = found.disturbance["u"]
    tolerance = 0.03 if group == "train" else 0.1
    assert d.forward == pytest.approx(-(20.3935 - 3.1648) / 35.15065, rel=tolerance)
    assert d.backward == pytest.approx((20.3935 + 3.1648) / 35.15065, rel=tolerance)
    assert d.explained_share > 0.98


def test_the_residual_is_far_from_white_and_no_warning_is_made_up(comparison):
    _, found = comparison
    tests = found.residual["q"]
    assert tests.whiteness.p_value < 1e-6
    assert tests.whiteness.explained_share > 0.9
    assert found.warnings == ()
    assert np.isfinite(found.frequency["q"].error_share).all()


@pytest.fixture(scope="module")
def repeated():
    record = rl.Record.read(EMPS, group="train", inputs=["u"], outputs=["q", "q_ref"])
    return record, rl.compare(rl.plant("servo-axis"), record, window=0.48)


def test_the_reference_tells_the_period_and_the_noise_floor(repeated):
    record, found = repeated
    noise = found.noise
    assert (noise.signal, noise.samples, noise.count) == ("q_ref", 6240, 3)
    q = record["q"][-3 * 6240 :].reshape(3, 6240)
    assert noise.std["q"] == pytest.approx(np.sqrt(q.var(axis=0, ddof=1).mean()), rel=1e-12)
    # The encoder's step is 5e-8 m: the spread is more than its rounding, and far below the gap.
    assert 1.4e-8 < noise.std["q"] < 1e-6
    gap = found.against_noise["q"]
    assert gap.p_value < 1e-6
    assert gap.repeatable == pytest.approx(found.outputs["q"].windowed_rms, rel=0.02)
    assert gap.noise < 0.02 * gap.repeatable


# --- validation -------------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.shared
def test_a_linear_axis_does_not_explain_the_record_and_a_millimetre_hides_it():
    """24841 samples in windows of 0.48 s: no mass and viscous friction is found that leaves less than 1.7 mm."""
    if not EMPS.is_file():
        pytest.skip("the measured record is not at hand")
    record = rl.Record.read(EMPS, group="test", inputs=["u"], outputs=["q"])
    model = rl.plant("servo-axis", M=(95.1089, 0.05), Fv=(203.5, 0.3)).uncertain(outputs=["q"])
    found = rl.validate(model, record, {"q": 1e-3}, window=0.48)
    assert (found.status, found.upper) == (rl.Status.INCONCLUSIVE, float("inf"))
    assert 1.5 < found.excess < 2.0
