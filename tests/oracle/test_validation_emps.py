"""`rl.validate` on EMPS, a measured servo axis; the record is not ours to ship."""

from __future__ import annotations

from pathlib import Path

import pytest

import robustlab as rl

EMPS = Path(__file__).parents[3] / "shared" / "data" / "emps.h5"


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
