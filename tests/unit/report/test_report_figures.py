"""Figures: deterministic files, plain labels, and that they show what they are given."""

import numpy as np
import pytest

import robustlab as rl
from robustlab.mu_analysis import Margin
from robustlab.report import mu_figure, response_figure, save_figure

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


def test_the_mu_figure_shades_proved_intervals_up_to_infinity():
    omega = np.geomspace(1.0, 100.0, 5)
    figure = mu_figure(margin(omega, 0.4 * np.ones(5), 0.5 * np.ones(5), [(0.0, 10.0, 0.5), (10.0, np.inf, 0.6)]))
    (axes,) = figure.axes
    tops = [path.vertices[:, 1].max() for band in axes.collections for path in band.get_paths()]
    assert tops == [0.5, 0.6]
    assert axes.get_xlim() == pytest.approx((1.0, 100.0))


def test_hostile_names_are_drawn_as_text(tmp_path):
    name = "$\\frac{1}{$ <script> \x1b[31m \u202e 電流 %s"
    figure = response_figure(
        T, rise(1.0)[None], rise(1.0), (rise(0.9), rise(1.1)), output=(name, name), references=[(1, name)]
    )
    svg, _ = save_figure(figure, tmp_path, "hostile")
    assert b"<script>" not in svg.read_bytes()
