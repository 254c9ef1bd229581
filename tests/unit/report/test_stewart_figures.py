"""Figures of the Stewart platform show what they are given."""

import numpy as np
import pytest

from robustlab.thesis import case_figure

T = np.linspace(0.0, 1.0, 51)


def test_case_figure_has_nominal_worst_and_all_members():
    members = (1 + 1e-4 * np.linspace(-1, 1, 20))[:, None, None] * np.stack([T, 3 * T], axis=1)
    nominal, worst = members.mean(axis=0), members[-1]
    figure = case_figure(T, members, nominal, worst, [("phi_1", "rad"), ("phidot_1", "rad/s")], 0.014, "worst Δ = -I")
    assert figure._suptitle.get_text() == "worst Δ = -I"
    for k, (whole, change) in enumerate((figure.axes[:2], figure.axes[2:])):
        assert [line.get_label() for line in whole.lines[-2:]] == ["nominal", "worst Δ"]
        assert len(whole.lines) == 22
        np.testing.assert_array_equal(whole.lines[-1].get_ydata(), worst[:, k])
        assert change.lines[21].get_ydata()[-1] == pytest.approx(0.01, rel=1e-6)
