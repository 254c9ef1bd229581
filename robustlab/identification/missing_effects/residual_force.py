"""Residual force of a fitted set: the posterior mean of the random force at a place, as curves over speed, position,
time and input with bands, and the periodic lines that have evidence.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robustlab.arrays import Array
from robustlab.dynamics.effects.contract import Site
from robustlab.dynamics.ports.port_model import AnyPlant
from robustlab.identification.greybox.random_force import FittedWindows
from robustlab.identification.greybox.unnamed_force import Unnamed
from robustlab.result import Evidence

FEWEST_BLOCKS = 8
REST = 0.01  # of the largest speed: slower counts as rest, where dry friction balances any force
BINS = 24
BINS_OF_TIME = 6  # each with several blocks: a share is of blocks that the curve has not seen


@dataclass(frozen=True)
class ForceCurve(Evidence):
    """Residual force over one coordinate."""

    coordinate: str
    unit: str
    # x, value, low, high: middle of each bin, mean force in it, and its 95 % band, (n_bins,), in order of x
    x: Array
    value: Array
    low: Array
    high: Array
    count: NDArray[np.int_]  # samples in each bin
    share: float  # of the variance explained by a curve over this coordinate in blocks not fitted, 0..1


@dataclass(frozen=True)
class ResidualForce(Evidence):
    """The residual force over each coordinate."""

    unit: str  # of the force
    rms: float
    noise_share: float  # of its variance, by the estimate's own std
    curves: Mapping[str, ForceCurve]  # coordinate -> curve
    blocks: int  # number of blocks


def residual_force(plant: AnyPlant, places: Sequence[tuple[FittedWindows, Site]]) -> ResidualForce | None:
    """Return the residual force at the most probable place; a block is a window."""
    windows, _ = max(places, key=lambda there: there[0].log_likelihood)
    force, std = windows.force_along()
    coordinates, units = dict[str, Array](), dict[str, str]()
    for name, unit, x in _coordinates(windows, plant):
        coordinates[name], units[name] = windows.response.mean(x).ravel(), unit
    block = np.repeat(np.arange(len(force)), force.shape[1])
    return force_curves(force.ravel(), std.ravel(), coordinates, block, units, windows.response.motion.unit)


def _coordinates(windows: FittedWindows, plant: AnyPlant) -> Iterator[tuple[str, str, Array]]:
    """Yield name, unit and samples of each coordinate."""
    response, motion = windows.response, windows.response.motion
    yield "time", "s", response.clock
    if motion.speed is not None:
        yield "speed", motion.speed_unit, motion.speed
    if motion.position is not None:
        yield "position", motion.position_unit, motion.position
    for j, signal in enumerate(plant.inputs):
        yield f"input {signal.name}", signal.unit, response.u[:, :, j]


def force_curves(
    force: Array, std: Array, x: Mapping[str, Array], block: NDArray[np.int_], units: Mapping[str, str], unit: str
) -> ResidualForce | None:
    """Return curves of a force (n,) over the coordinates, of the samples in motion; None with too few blocks."""
    if "speed" in x:
        moving = np.abs(x["speed"]) > REST * np.abs(x["speed"]).max()
        if moving.mean() >= 0.2:
            force, std, block = force[moving], std[moving], block[moving]
            x = {name: values[moving] for name, values in x.items()}
    count = len(used := np.unique(block))
    if count < FEWEST_BLOCKS:
        return None
    belongs = (used[:, None] == block).astype(float)
    curves = {
        name: _curve(name, units.get(name, ""), force, std, values, belongs)
        for name, values in x.items()
        if np.ptp(values) > 0.0
    }
    variance = float(np.var(force))
    noise = min(1.0, float(np.mean(std**2)) / variance) if variance > 0.0 else 1.0
    return ResidualForce(unit, float(np.sqrt(np.mean(force**2))), noise, curves, count)


def _curve(name: str, unit: str, force: Array, std: Array, x: Array, belongs: Array) -> ForceCurve:
    """Return means in bins with equal counts, bands from the scatter of the blocks, and the held-out share."""
    sides = [side for side in (x[x < 0], x[x > 0]) if len(side)] if name == "speed" else [x]
    most = BINS_OF_TIME if name == "time" else BINS
    parts = [np.quantile(s, np.linspace(0.0, 1.0, max(2, round(most * len(s) / len(x))) + 1)) for s in sides]
    edges = np.unique(np.concatenate(parts))
    place = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, max(0, len(edges) - 2))
    used, place = np.unique(place, return_inverse=True)
    one = (place[:, None] == np.arange(len(used))).astype(float)
    count, weight, sums = one.sum(axis=0), belongs @ one, belongs @ (one * force[:, None])
    value = sums.sum(axis=0) / count
    # In a bin with few blocks the spread between blocks is unreliable: the spread within the bin counts as well.
    visits = (weight > 0).sum(axis=0)
    between = np.sqrt(((sums - value * weight) ** 2).sum(axis=0) * visits / np.maximum(visits - 1, 1)) / count
    inside = np.sqrt((one * (force[:, None] - value) ** 2).sum(axis=0) / count)
    own = np.sqrt((one * std[:, None] ** 2).sum(axis=0) / count / visits)
    spread = np.maximum(between, own)
    band = 2.0 * np.where(visits < 4, np.maximum(spread, inside), spread)
    # Each block is predicted by the means of the others; where they have none, by their mean over all bins.
    others = sums.sum(axis=0) - sums, count - weight
    mean = (others[0].sum(axis=1) / others[1].sum(axis=1))[:, None]
    predicted = np.where(others[1] > 0, others[0] / np.maximum(others[1], 1.0), mean)
    left = float(force @ force - 2.0 * (predicted * sums).sum() + (predicted**2 * weight).sum())
    whole = float(force @ force - 2.0 * (mean * sums).sum() + (mean**2 * weight).sum())
    share = max(0.0, 1.0 - left / whole) if whole > 0.0 else 0.0
    middle = (one * x[:, None]).sum(axis=0) / count
    return ForceCurve(name, unit, middle, value, value - band, value + band, count.astype(int), share)


def remaining_lines(
    places: Sequence[tuple[FittedWindows, Site]], left: Sequence[Unnamed]
) -> tuple[dict[str, Any], ...]:
    """Return the most probable line with evidence over position and over time at each place, the largest first."""
    found = []
    for (windows, _), forces in zip(places, left, strict=False):  # none is left of singular equations
        motion = windows.response.motion
        lines = [f for f in forces.forces if f.wins and np.isfinite(f.period)]
        for over, unit in (("position", motion.position_unit), ("time", "s")):
            if (line := next((f for f in lines if f.over.endswith(over)), None)) is not None:
                size = {"amplitude": float(np.hypot(*line.wave)), "force_unit": motion.unit}
                found.append({"over": over, "period": line.period, "unit": unit, **size, "evidence": line.evidence})
    return tuple(sorted(found, key=lambda line: -line["amplitude"]))
