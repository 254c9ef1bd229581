"""The thesis' numbers: rows R within the fair tolerances, the others at the values of an independent model."""

from __future__ import annotations

import math

import numpy as np
import pytest

import robustlab as rl
from robustlab.dynamics.stewart.thesis_numbers import PublishedNumber, published_numbers
from robustlab.dynamics.stewart.thesis_runs import sine_run


@pytest.fixture(scope="module")
def found():
    return published_numbers()


def ours(found, key):
    return found.rows[key].ours


def test_every_item_has_a_row(found):
    assert {int(key.partition("-")[0]) for key in found.rows} == set(range(1, 30))
    assert list(found.rows) == [row.key for row in found.rows.values()]


def test_rows_r_agree(found):
    assert found.disagreeing == []
    for row in found.with_status("R"):
        assert row.agrees is True
        assert row.tolerance is not None
    assert {int(row.key.partition("-")[0]) for row in found.with_status("R")} >= {
        *range(1, 13), 20, 21, 22, 23,
    }  # fmt: skip


def test_what_is_not_reproduced_has_a_reason(found):
    for row in (*found.with_status("P"), *found.with_status("N")):
        assert row.why, row.key


@pytest.mark.parametrize(
    ("key", "value", "tolerance"),
    [  # from a model written apart from ours
        ("4-max", 188.06, 6e-3),
        ("4-min", 160.71, 6e-3),
        ("7", 0.87012e-3, 1.2e-8),
        ("11", 788.85, 6e-3),
        ("13-20Hz", 0.14096, 1e-5),
        ("13-1mNm", 0.14215, 1e-5),
        ("14-angle", 0.18, 0.02),
        ("14-rate", 0.33, 0.02),
        ("14-angle-1mNm", 0.85, 0.01),
        ("14-rate-1mNm", 2.37, 0.01),
        ("15", 1.044, 1e-3),
        ("16", 0.0122, 1e-4),
        ("17", 0.0486, 1e-4),
        ("18", 2.529, 1e-3),
        ("19", 0.0577, 1e-4),
        ("20", 0.200, 5e-4),
        ("21", 0.799, 1e-3),
        ("22", 0.0087, 2e-4),
        ("22-signs", 0.0111, 2e-4),
        ("23", 20.8, 0.05),
        ("23-signs", 26.5, 0.05),
        ("27-second", 1.25, 0.01),
        ("28-first", 0.003, 1e-3),
        ("29-friction", 6.2e-6, 5e-8),
        ("29-current", 0.719, 5e-4),
    ],
)
def test_against_an_independent_model(found, key, value, tolerance):
    assert ours(found, key) == pytest.approx(value, abs=tolerance)


def test_friction_that_the_data_sheet_needs(found):
    """Closed form of the no-load speed, 42 Km / (Kb Km + R Kf) = 788.5 rad/s."""
    kf = 4.8e-5 * (1 + ours(found, "11-need") / 100)
    assert 42 * 0.052 / (0.052**2 + 2.07 * kf) == pytest.approx(788.5, rel=1e-12)


def test_poles_bracket_the_published_limits(found):
    assert 2000 < ours(found, "25") < 2200
    assert 1400 < ours(found, "25-rotor") < 1500


def test_case_2c_is_a_closed_form(found):
    case = found.cases[3]
    assert case.gain_percent == pytest.approx(100 * (1 / 1.025 - 1), rel=1e-9)
    assert case.released == pytest.approx(-0.025 * 0.8701e-3, rel=1e-4)


def test_a_small_sine_is_linear():
    run = sine_run(rl.plant("stewart-platform"), 1e-5, 20.0, 0.05, 2001)
    _, angle, rate = run.percent()
    assert max(np.abs(angle).max(), np.abs(rate).max()) < 1e-3
    assert math.isinf(run.when_height(0.1407))


def test_a_row_that_is_off_is_found():
    def row(ours, bound="equal", tolerance=0.1):
        return PublishedNumber("1", "q", "w", 1.0, ours, "", "R", tolerance, "", bound)

    assert row(1.05).agrees is True
    assert row(1.2).agrees is row(0.8).agrees is False
    assert row(0.2, "at most").agrees is row(9.0, "at least").agrees is True
    assert row(1.2, "at most").agrees is row(0.8, "at least").agrees is False
    assert row(None).agrees is None
    assert row(math.nan).agrees is False


def test_table_has_every_row_and_reason(found):
    text = found.table()
    for row in found.rows.values():
        assert f"\n{row.key} " in text
        assert row.why in text
