"""Figures: deterministic files, plain labels, and that they show what they are given."""

from __future__ import annotations

import numpy as np
import pytest

import robustlab as rl
from robustlab.mu_analysis import Margin
from robustlab.report.figures import axis_label, house_style, logarithmic, new_figure, save_figure
from robustlab.report.robustness_figures import mu_figure, response_figure, shares_figure, worst_case_figure
from robustlab.worst_case_analysis.worst_case_search import WorstCase, WorstResponse

T = np.linspace(0.0, 1.0, 101)


def rise(gain: float) -> np.ndarray:
    return gain * (1 - np.exp(-5 * T))


def response():
    samples = np.array([rise(g) for g in (0.8, 1.0, 1.2)])
    envelope = (samples.min(axis=0), samples.max(axis=0))
    return response_figure(T, samples, rise(1.0), envelope, output=("omega", "rad/s"), references=[(1.1, "known")])


@pytest.mark.parametrize("suffix", ["svg", "png"])
def test_the_same_figure_gives_the_same_bytes(tmp_path, suffix):
    for folder in ("a", "b"):
        save_figure(response(), tmp_path / folder, "r")
    first, second = ((tmp_path / folder / f"r.{suffix}").read_bytes() for folder in ("a", "b"))
    assert first == second
    assert b"20" + b"26-" not in first[:2000]  # no date


def test_saving_leaves_no_other_file(tmp_path):
    svg, png = save_figure(response(), tmp_path, "r")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["r.png", "r.svg"]
    assert svg.read_bytes().startswith(b"<?xml")
    assert png.read_bytes().startswith(b"\x89PNG")


def test_the_house_style_does_not_leak():
    import matplotlib as mpl

    before = dict(mpl.rcParams)
    response()
    assert dict(mpl.rcParams) == before


def test_the_enlarged_panel_shows_the_end_and_the_known_value():
    _, zoom = response().axes
    assert zoom.get_xlim() == pytest.approx((0.8, 1.0))
    low, high = zoom.get_ylim()
    assert low < rise(0.8)[-20:].min() < 1.1 < rise(1.2)[-1] < high
    assert high < 1.4


def test_the_envelope_is_drawn_as_given():
    whole, _ = response().axes
    (band,) = whole.collections
    points = band.get_paths()[0].vertices
    assert points[:, 1].max() == pytest.approx(rise(1.2).max())
    assert points[points[:, 0] == 1.0][:, 1].min() == pytest.approx(rise(0.8)[-1])


def test_the_worst_case_marks_the_largest_deviation():
    deviation = np.sin(3 * T)
    response = WorstResponse(T, rise(1.0), rise(1.0) + deviation, "y", "")
    where = (1, {}, 0.0, "", 1.0, "", None, "y", -1.0, 0, 0, response)
    found = WorstCase(1.0, {}, "peak", 0.0, rl.Status.CONVERGED, "", *where)
    _, below = worst_case_figure(found).axes
    (marker,) = [line for line in below.lines if line.get_marker() == "o"]
    assert marker.get_xdata()[0] == pytest.approx(T[np.argmax(np.abs(deviation))])


def margin(omega, lower, upper, intervals) -> Margin:
    return Margin(
        lower=1 / max(bound for _, _, bound in intervals) if max(b for _, _, b in intervals) else np.inf,
        upper=np.inf,
        frequency=None,
        delta={},
        status=rl.Status.CERTIFIED,
        physical={},
        pole=None,
        omega=omega,
        mu_lower=lower,
        mu_upper=upper,
        intervals=tuple(intervals),
        open=(),
        shares={},
        proof=(),
        notes=(),
    )


def test_the_mu_figure_shades_what_is_proved_up_to_infinity():
    omega = np.geomspace(1.0, 100.0, 5)
    figure = mu_figure(margin(omega, 0.4 * np.ones(5), 0.5 * np.ones(5), [(0.0, 10.0, 0.5), (10.0, np.inf, 0.6)]))
    (axes,) = figure.axes
    tops = [path.vertices[:, 1].max() for band in axes.collections for path in band.get_paths()]
    assert tops == [0.5, 0.6]
    assert axes.get_xlim() == pytest.approx((1.0, 100.0))


def test_the_mu_figure_of_no_uncertainty():
    mu_figure(margin(np.array([1.0, 2.0]), np.zeros(2), np.zeros(2), [(0.0, np.inf, 0.0)]))


def test_shares_are_ranked_with_the_largest_on_top():
    (axes,) = shares_figure({"a": 0.2, "b": 0.9, "c": -0.1}).axes
    assert [label.get_text() for label in axes.get_yticklabels()] == ["b", "a", "c"]
    assert [bar.get_width() for bar in axes.patches] == [0.9, 0.2, -0.1]


def test_logarithmic_ticks_are_plain_text(tmp_path):
    figure, (axes,) = new_figure()
    with house_style():
        axes.plot([1e-6, 1.0, 1e9], [1.0, 2.0, 3.0])
    logarithmic(axes.xaxis)
    figure.draw_without_rendering()
    texts = [tick.get_text() for tick in axes.get_xticklabels()]
    assert "10⁻⁶" in texts
    assert "10⁶" in texts
    assert not any("$" in text for text in texts)


def test_hostile_names_are_drawn_as_text(tmp_path):
    name = "$\\frac{1}{$ <script> \x1b[31m \u202e 電流 %s"
    figure = response_figure(
        T, rise(1.0)[None], rise(1.0), (rise(0.9), rise(1.1)), output=(name, name), references=[(1, name)]
    )
    svg, _ = save_figure(figure, tmp_path, "hostile")
    assert b"<script>" not in svg.read_bytes()


def test_axis_labels():
    assert axis_label("omega", "rad/s") == "omega [rad/s]"
    assert axis_label("gain", "") == "gain"
    assert axis_label("gain", "1") == "gain"
