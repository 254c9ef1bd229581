"""Figures of designs: what they draw is what they were given, and their spans leave nothing out."""

from __future__ import annotations

import numpy as np
import pytest

from robustlab.report.design_figures import (
    FunctionPanel,
    functions_figure,
    loop_figure,
)
from robustlab.report.figures import save_figure
from robustlab.statespace import StateSpaceModel
from robustlab.synthesis.hinf.hinf_synthesis import hinf
from robustlab.synthesis.specifications.loop_functions import loop_curves

OMEGA = np.geomspace(0.1, 100, 50)


def labels(figure):
    found = {text.get_text() for legend in figure.legends for text in legend.get_texts()}
    for axes in figure.axes:
        if axes.get_legend() is not None:
            found |= {text.get_text() for text in axes.get_legend().get_texts()}
    return found


def test_functions_against_what_is_asked_for_and_what_is_proved(tmp_path):
    gain = 1 / (1 + OMEGA)
    panels = [
        FunctionPanel("S", {"pid": gain, "hinf": 0.5 * gain}, 2 + OMEGA, 1 + 0.5 * OMEGA, "V"),
        FunctionPanel("T", {"pid": gain}),
    ]
    figure = functions_figure(OMEGA, panels, 0.5)
    assert labels(figure) == {"pid", "hinf", "1 / |W|, what is asked for", "γ / |W|, proved, γ = 0.5"}
    low, high = figure.axes[0].get_ylim()
    assert low < 0.5 * gain.min()
    assert high > 2.1  # the nearest point of what is asked for is in the picture
    first, second = (path.read_bytes() for path in save_figure(figure, tmp_path, "f")[:1] * 2)
    assert first == second


def test_loop_with_its_peak_and_many_measurements_as_one_kind():
    sigma = np.column_stack([2 / (1 + OMEGA), 1e-9 * OMEGA])
    figure = loop_figure(OMEGA, sigma, (0.1, 1.9), (np.ones((50, 18)), [f"y{i}" for i in range(18)]), "γ, verified")
    assert {"largest", "γ, verified: 1.9", "each of the 18 measurements"} <= labels(figure)
    assert "others" not in labels(figure)  # far below the picture


def test_curves_of_a_design_touch_gamma_at_the_peak_and_nowhere_exceed_it():
    P = StateSpaceModel([[-1.0]], [[1.0, 0.0, 1.0]], [[1.0], [0.0], [1.0]], [[0, 0, 0], [0, 0, 1], [0, 1, 0]])
    design = hinf(P, 1, 1, gamma_rel=1.0)
    curves = loop_curves(design)
    assert (curves.closed_loop[:, 0] <= design.gamma * (1 + 1e-9)).all()
    assert curves.closed_loop[:, 0].max() == pytest.approx(design.gamma, rel=1e-2)
    assert curves.controller.shape == (len(curves.omega), 1)
