"""A smaller drawing is the same picture: what is left out lies on what is drawn."""

from __future__ import annotations

import re
from io import StringIO
from xml.etree import ElementTree as ET

import numpy as np
import pytest

from robustlab.report.figures import house_style, new_figure
from robustlab.report.svg import COLUMN, HREF, OFF, SVG, compact, corners_of, thinned


def raw(figure) -> str:
    text = StringIO()
    with house_style():
        figure.savefig(text, format="svg", metadata={"Date": None})
    return text.getvalue()


def distance(points, line) -> float:
    """The largest distance of the points from a polygon, by each piece of it."""
    furthest = 0.0
    start, along = line[:-1], np.diff(line, axis=0)
    square = np.maximum((along**2).sum(axis=1), 1e-30)
    for point in points:
        share = np.clip(((point - start) * along).sum(axis=1) / square, 0, 1)
        furthest = max(furthest, float(np.hypot(*(start + share[:, None] * along - point).T).min()))
    return furthest


S = np.linspace(0.0, 1.0, 6000)
SHAPES = {
    "sine": np.column_stack([350 * S, 80 * np.sin(20 * S)]),
    "loop": np.column_stack([100 * np.cos(7 * S), 60 * np.sin(14 * S)]),
    "band": np.concatenate([np.column_stack([350 * S, S**2]), np.column_stack([350 * S, -40 + S])[::-1]]),
    "stairs": np.column_stack([350 * S, 30 * np.floor(6 * S)]),
    "noise": np.column_stack([350 * S, 20 * np.random.default_rng(3).normal(size=len(S))]),
}


@pytest.mark.parametrize("kind", SHAPES)
def test_what_is_left_out_lies_on_what_is_drawn(kind):
    corners = SHAPES[kind]
    found = thinned(corners)
    assert len(found) < (0.6 if kind == "noise" else 0.1) * len(corners)
    assert distance(corners[::3], found) < COLUMN
    for end in (np.min, np.max):
        assert end(found, axis=0) == pytest.approx(end(corners, axis=0), abs=OFF)


def test_corners_lie_within_the_tolerance():
    x = np.linspace(0.0, 100.0, 1001)
    y = np.cos(x / 10) * 30
    chosen = corners_of(x, y)
    assert distance(np.column_stack([x, y]), np.column_stack([x[chosen], y[chosen]])) <= OFF
    assert len(chosen) < 120


def test_the_drawing_is_small_well_formed_and_keeps_its_texts():
    figure, (axes, other) = new_figure(1, 2)
    axes.plot(np.linspace(0, 1, 9000), np.random.default_rng(0).normal(size=9000), label="noise <b> & 5 %")
    axes.fill_between([0.0, 1.0], [0.0, 1.0], [2.0, 3.0])
    other.plot(np.zeros(400), np.zeros(400), "o")
    axes.set(xlabel="time [s]", ylabel="error [µm]")
    axes.legend()
    whole = raw(figure)
    small = compact(whole)
    assert len(small) < 0.25 * len(whole)
    root = ET.fromstring(small)
    texts = {element.text for element in root.iter(f"{SVG}text")}
    assert {"time [s]", "error [µm]", "noise <b> & 5 %"} <= texts
    names = [element.attrib["id"] for element in root.iter() if "id" in element.attrib]
    assert len(names) == len(set(names))
    assert {found[2:-1] for found in re.findall(r"(?:\"|\()#[a-z0-9]+[)\"]", small)} == set(names)


def test_markers_that_cover_one_another_are_drawn_once_and_others_all():
    figure, (axes,) = new_figure()
    axes.plot([0.2] * 300 + [0.4, 0.6], [0.5] * 302, "o", color="#D55E00")
    root = ET.fromstring(compact(raw(figure)))
    (round_,) = [e.get("id") for e in root.iter(f"{SVG}path") if "C" in e.get("d", "")]  # ticks have straight lines
    assert sum(e.get(HREF) == f"#{round_}" for e in root.iter(f"{SVG}use")) == 3


def test_a_hatched_bar_keeps_its_hatching():
    figure, (axes,) = new_figure()
    axes.bar([0], [1], hatch="//")
    root = ET.fromstring(compact(raw(figure)))
    (pattern,) = root.iter(f"{SVG}pattern")
    assert f"url(#{pattern.get('id')})" in ET.tostring(root, encoding="unicode")


def test_the_same_drawing_gives_the_same_characters():
    figure, (axes,) = new_figure()
    axes.plot([0, 1], [1, 0])
    assert compact(raw(figure)) == compact(raw(figure))
