"""The SVG drawn by us is the picture that the axes describe; what is left out lies on what is drawn."""

from __future__ import annotations

import re
from xml.etree import ElementTree as ET

import numpy as np
import pytest

from robustlab.report import vector
from robustlab.report.figures import house_style, logarithmic, new_figure
from robustlab.report.vector import COLUMN, OFF, svg_of, thinned


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


SVG = "{http://www.w3.org/2000/svg}"


@pytest.fixture(autouse=True)
def ours_alone(monkeypatch):
    def never(_figure):
        raise AssertionError("drawn by matplotlib")

    monkeypatch.setattr(vector, "_of_matplotlib", never)


def drawn(figure) -> ET.Element:
    with house_style():
        return ET.fromstring(svg_of(figure))


def texts(root) -> set[str]:
    return {"".join(element.itertext()) for element in root.iter(f"{SVG}text")}


def corners(path: str) -> np.ndarray:
    """The points of a path of relative lines."""
    start, _, steps = path.removeprefix("M").partition("l")
    numbers = [re.findall(r"-?(?:\d+\.?\d*|\.\d+)", part) for part in (start, steps)]
    return np.cumsum(np.concatenate([np.array(found, dtype=float).reshape(-1, 2) for found in numbers]), axis=0)


def test_a_curve_lies_where_the_axes_say():
    """On the straight line between the corners of the panel, whose places the ticks tell; logarithmic, too."""
    figure, (axes,) = new_figure()
    axes.plot([1.0, 10.0, 100.0], [0.0, 5.0, 10.0], color="#123456")
    axes.set(xlim=(1.0, 1000.0), ylim=(0.0, 20.0))
    logarithmic(axes.xaxis)
    root = drawn(figure)
    (line,) = [e for e in root.iter(f"{SVG}path") if e.get("stroke") == "#123456"]
    box = root.find(f".//{SVG}clipPath/{SVG}rect")
    x, y, width, height = (float(box.get(side)) for side in ("x", "y", "width", "height"))
    expected = [(x + width * k / 3, y + height * (1 - 0.25 * k)) for k in (0, 1, 2)]
    assert corners(line.get("d")) == pytest.approx(np.array(expected), abs=0.03)
    ticks = {e.text: float(e.get("x")) for e in root.iter(f"{SVG}text") if e.get("text-anchor") == "middle"}
    assert [ticks[t] for t in ("1", "10", "100")] == pytest.approx([x, x + width / 3, x + 2 * width / 3], abs=0.01)


def test_the_drawing_is_small_well_formed_and_keeps_its_texts():
    figure, (axes, other) = new_figure(1, 2)
    axes.plot(np.linspace(0, 1, 9000), np.random.default_rng(0).normal(size=9000), label="noise <b> & 5 %")
    axes.fill_between([0.0, 1.0], [0.0, 1.0], [2.0, 3.0])
    other.plot(np.zeros(400), np.zeros(400), "o")
    axes.set(xlabel="time [s]", ylabel="error [µm]", title="two\nlines")
    axes.legend()
    with house_style():
        whole = svg_of(figure)
    assert len(whole) < 30_000
    root = ET.fromstring(whole)
    assert {"time [s]", "error [µm]", "noise <b> & 5 %", "twolines"} <= texts(root)
    names = [element.attrib["id"] for element in root.iter() if "id" in element.attrib]
    assert len(names) == len(set(names))
    assert set(re.findall(r"url\(#([a-z0-9]+)\)", whole)) == set(names)
