"""docs/analysis.md: the code runs, and what is printed beside it is right."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

import robustlab as rl

ROOT = Path(__file__).parents[3]


def blocks_of(name: str) -> list[str]:
    return re.findall(r"```python\n(.*?)```", (ROOT / name).read_text(encoding="utf-8"), flags=re.DOTALL)


@pytest.mark.slow
def test_the_page_runs_and_its_numbers_are_right(capsys):
    names = {}
    for block in blocks_of("docs/analysis.md"):
        exec(block, names)
    margin, gain, performance = names["margin"], names["gain"], names["performance"]
    # Routh: (1 - 0.2 t)(2 - 0.6 t) = 0.2 (3 + 0.6 t) where the softest, least damped, heaviest corner is just stable.
    exact = (1.12 - np.sqrt(1.12**2 - 4 * 0.12 * 1.4)) / 0.24
    assert margin.upper == pytest.approx(exact, rel=1e-6)
    assert exact * 0.99 < margin.lower < exact * (1 + 1e-9)
    assert sum(margin.shares.values()) == pytest.approx(1.0)
    assert max(margin.shares, key=margin.shares.get) == "k"
    # d ln t / d ln r by the same equation, r the range of k below its nominal value.
    slope = (1 - 0.2 * exact) * 0.6 + 0.2 * (2 - 0.6 * exact) + 0.12
    assert margin.shares["k"] == pytest.approx((1 - 0.2 * exact) * 0.6 / slope, rel=1e-4)
    assert names["four"].upper == pytest.approx(4.0, rel=1e-9)
    assert names["four"].lower == pytest.approx(4.0, rel=3e-3)
    assert names["seen"].growth == pytest.approx(1.0, abs=1e-3)
    # The gain of x / F at the softest, least damped, heaviest corner, on a grid of its own.
    s = 1j * np.linspace(0.5, 0.7, 20001)
    corner = np.abs(s / (s * (3.6 * s**2 + 0.8 * s + 1.4) + 0.2)).max()
    assert gain.lower == pytest.approx(corner, rel=1e-6)
    assert gain.lower <= gain.upper <= gain.lower * 1.01
    assert performance.lower <= performance.upper < 1 < gain.upper / 4
    assert names["bounds"].lower == pytest.approx(2.0)
    assert all(part.status is not rl.Status.TIMEOUT for part in (margin, gain, performance, names["disk"]))
    # 1 / |S - 1/2| for one loop, on a grid.
    s = 1j * np.linspace(0.5, 1.0, 20001)
    L = 0.2 / (s * (3 * s**2 + s + 2))
    assert names["disk"].lower == pytest.approx(1 / np.abs(1 / (1 + L) - 0.5).max(), rel=1e-6)
    # Chordal distance of two scalar models, on a grid: the nu-gap where the winding number is 0.
    s = 1j * np.linspace(0.5, 1.0, 20001)
    one, two = 1 / (3 * s**2 + s + 2), 1 / (3 * s**2 + s + 1.4)
    chordal = np.abs(one - two) / np.sqrt((1 + np.abs(one) ** 2) * (1 + np.abs(two) ** 2))
    assert f"{chordal.max():.5f}" == "0.36913"  # as printed
    # |1 + g K| / (0.05 |g K|), and the largest |g' / (1 + g' K)| over the disks, at the points of the page.
    s = 1j * np.geomspace(0.05, 20.0, 40)
    g, k = 1 / (3 * s**2 + s + 2), 0.2 / s
    assert names["points"].lower == pytest.approx((np.abs(1 + g * k) / (0.05 * np.abs(g * k))).min(), rel=1e-6)
    disks = g[:, None] * (1 + 0.05 * np.exp(2j * np.pi * np.arange(4000) / 4000))
    assert np.abs(disks / (1 + disks * k[:, None])).max() == pytest.approx(1.943, abs=1e-3)
    printed = capsys.readouterr().out
    for number in ("1.4868", "5.8554", "5.8560", "0.36913", "22.12", "1.943", "[1.628 1.64 ]"):
        assert number in printed
