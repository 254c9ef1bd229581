"""The force along a record that no effect explains, over speed, position, time and input.

It is correlated in time: bands come from a bootstrap over blocks, shares of the variance from blocks not fitted to.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robustlab.arrays import Array
from robustlab.errors import InputError
from robustlab.result import Evidence
from robustlab.statespace import real_array

WHERE = "residual force"

BLOCKS = 24
FEWEST_BLOCKS = 8
POINTS = 4000  # samples looked at: d is smooth, and a denser grid shows nothing more
REST = 0.01  # of the largest speed: slower counts as standing still
FOLDS = 8  # of cross-validation
STIFFNESS = 10.0 ** np.arange(-5.0, 3.0)  # penalty over the data's own weight
RIDGE = 1e-7
SIDE, WIDE, SLOW = 8, 14, 2  # spline coefficients on a side of zero speed and over other coordinates; degree over time
BINS = 24
REPEATS = 400  # of the bootstrap


@dataclass(frozen=True)
class ForceCurve(Evidence):
    """Residual force over one coordinate."""

    # coordinate, unit: name and unit of the coordinate
    coordinate: str
    unit: str
    # x, value, low, high: middle of each bin, mean force in it, and its 95 % band; shape (n_bins,), in order of x
    x: Array
    value: Array
    low: Array
    high: Array
    count: NDArray[np.int_]  # samples in each bin
    # share of the variance that a curve over this coordinate explains in blocks it was not fitted to, 0..1
    share: float


@dataclass(frozen=True)
class ResidualForce(Evidence):
    """The residual force over each coordinate."""

    unit: str  # unit of the force
    rms: float  # of the force
    noise_share: float  # share of its variance that the estimate's own std accounts for
    curves: Mapping[str, ForceCurve]  # coordinate -> curve
    blocks: int  # number of blocks


def residual_force(
    d: ArrayLike,
    d_std: ArrayLike,
    coordinates: Mapping[str, ArrayLike],
    units: Mapping[str, str] | None = None,
    *,
    unit: str = "",
    blocks: int | NDArray[np.int_] = BLOCKS,
    seed: int = 0,
) -> ResidualForce:
    """The force over each coordinate, with bands and held-out shares; see `moving_samples`."""
    data, rng = moving_samples(d, d_std, coordinates, blocks), np.random.default_rng(seed)
    force = data.d - np.average(data.d, weights=data.weight)
    curves: dict[str, ForceCurve] = {}
    for basis in coordinate_bases(data):
        name = basis.coordinate
        if basis.kind != "dry":
            x, value, low, high, count = _binned(data, data.x[name], role(name) == "speed", rng)
            share = _held_out_share(data, force, basis)
            curves[name] = ForceCurve(name, (units or {}).get(name, ""), x, value, low, high, count, share)
    variance = float(np.average(force**2, weights=data.weight))
    noise = min(1.0, float(np.average(data.std**2, weights=data.weight)) / variance) if variance > 0 else 1.0
    return ResidualForce(unit, float(np.sqrt(np.mean(data.d**2))), noise, curves, data.n_blocks)


@dataclass(frozen=True)
class MovingSamples:
    """Samples in motion: force (n,), weights (n,), coordinates, block of each sample, sign of the speed."""

    d: Array
    std: Array
    weight: Array
    x: dict[str, Array]
    block: NDArray[np.int_]
    n_blocks: int
    speed: str | None
    sign: Array

    def per_block(self, value: Array) -> Array:
        """Weighted sums over each block: (n, ...) -> (n_blocks, ...)."""
        belongs = (np.arange(self.n_blocks)[:, None] == self.block) * self.weight
        return (belongs @ value.reshape(len(value), -1)).reshape(self.n_blocks, *value.shape[1:])


def moving_samples(
    d: ArrayLike, d_std: ArrayLike, coordinates: Mapping[str, ArrayLike], blocks: int | NDArray[np.int_]
) -> MovingSamples:
    """The samples in motion of a force (n,) along records; ``blocks``: their number, or a label for each sample."""
    force, std = real_array("d", d, 1, WHERE), real_array("d_std", d_std, 1, WHERE)
    x = {name: real_array(name, value, 1, WHERE) for name, value in coordinates.items()}
    n = len(force)
    for name, value in (("d_std", std), *x.items()):
        if len(value) != n:
            raise InputError(f"{WHERE}: {name}", f"{len(value)} samples", f"{n} as in d")
    if not x:
        raise InputError(WHERE, "no coordinates", "at least one, for example speed")
    if not (std > 0).all():
        raise InputError(f"{WHERE}: d_std", f"{std.min():g}", "positive numbers")
    if isinstance(blocks, (int, np.integer)):
        if not FEWEST_BLOCKS <= blocks <= n // 8:
            raise InputError(f"{WHERE}: blocks", f"{blocks} for {n} samples", f"{FEWEST_BLOCKS} to {n // 8}")
        label = np.arange(n) * int(blocks) // n
    else:
        if np.shape(blocks) != (n,):
            raise InputError(f"{WHERE}: blocks", f"shape {np.shape(blocks)}", f"a number, or a label for each of {n}")
        label = np.asarray(blocks)
    speed = next((name for name in x if role(name) == "speed"), None)
    chosen = np.arange(0, n, max(1, n // POINTS))
    if speed is not None:
        moving = np.abs(x[speed]) > REST * np.abs(x[speed]).max()
        if moving[chosen].sum() >= 0.2 * len(chosen):
            chosen = chosen[moving[chosen]]
    _, block = np.unique(label[chosen], return_inverse=True)
    count = int(block.max()) + 1
    if count < FEWEST_BLOCKS:
        raise InputError(f"{WHERE}: blocks", f"{count} blocks in motion", f"at least {FEWEST_BLOCKS}")
    floor = float(np.median(std[chosen]))
    weight = 1.0 / np.maximum(std[chosen], floor) ** 2 * floor**2
    sign = np.sign(x[speed][chosen]) if speed else np.ones(len(chosen))
    return MovingSamples(
        force[chosen], std[chosen], weight, {k: v[chosen] for k, v in x.items()}, block, count, speed, sign
    )


def role(name: str) -> str:
    """First word of a coordinate's name: "speed", "position", "time" or another."""
    return name.split(maxsplit=1)[0].lower() if name.split() else ""


@dataclass(frozen=True)
class Basis:
    """Columns (n, p) with their roughness penalty (p, p)."""

    coordinate: str
    kind: str
    columns: Array
    penalty: Array


def _spline(x: Array, low: float, high: float, size: int) -> Array:
    """Cubic B-splines on an even grid from low to high, (n, size); constant outside."""
    from scipy.interpolate import BSpline

    inner = np.linspace(low, high, size - 2)
    step = inner[1] - inner[0]
    knots = np.concatenate([low - step * np.arange(3, 0, -1), inner, high + step * np.arange(1, 4)])
    return np.asarray(BSpline.design_matrix(np.clip(x, low, high), knots, 3).toarray())


def _roughness(size: int) -> Array:
    second = np.diff(np.eye(size), 2, axis=0)
    return np.asarray(second.T @ second, dtype=np.float64)


def _speed_basis(name: str, x: Array) -> Basis:
    """Splines over sqrt(abs(v)), one set below zero and one above, so that the curve may jump and bend at zero."""
    top = float(np.abs(x).max()) or 1.0
    side = _spline(np.sqrt(np.abs(x) / top), 0.0, 1.0, SIDE)
    penalty = np.asarray(np.kron(np.eye(2), _roughness(SIDE)), dtype=np.float64)
    return Basis(name, "speed", np.hstack([side * (x < 0)[:, None], side * (x > 0)[:, None]]), penalty)


def _plain_basis(name: str, x: Array, sign: Array, dry: bool) -> Basis:
    low, high = float(x.min()), float(x.max())
    slow, span = role(name) == "time", (high - low) or 1.0
    if slow:  # held-out blocks at the ends of the record ask for extrapolation: a polynomial stays tame
        base = np.vander((x - low) / span - 0.5, SLOW + 1, increasing=True)
    else:
        base = _spline(x, low, low + span, WIDE)
    penalty = np.diag([0.0, *[1.0] * SLOW]) if slow else _roughness(WIDE)
    return Basis(name, "dry" if dry else "plain", base * sign[:, None] if dry else base, penalty)


def coordinate_bases(data: MovingSamples) -> list[Basis]:
    """A curve over each coordinate that varies, and its dry pair."""
    result: list[Basis] = []
    for name, x in data.x.items():
        if np.ptp(x) == 0:
            continue
        result.append(_speed_basis(name, x) if role(name) == "speed" else _plain_basis(name, x, data.sign, False))
        if data.speed and role(name) != "speed":
            result.append(_plain_basis(name, x, data.sign, True))
    return result


def without_curves(data: MovingSamples, stiffness: float) -> Array:
    """The force less a sum of smooth curves over all coordinates."""
    from scipy.linalg import block_diag

    bases = coordinate_bases(data)
    if not bases:
        return data.d - np.average(data.d, weights=data.weight)
    columns, penalty = np.hstack([b.columns for b in bases]), np.asarray(block_diag(*(b.penalty for b in bases)))
    weighted = columns.T * data.weight
    return data.d - columns @ _solved(weighted @ columns, weighted @ data.d, stiffness, penalty, weighted @ columns)


def _solved(gram: Array, moment: Array, stiffness: float, penalty: Array, whole: Array) -> Array:
    """Coefficients; the same stiffness means the same smoothing for any unit, length and number of columns."""
    size = float(np.trace(whole)) / len(whole)
    return np.linalg.solve(gram + size * (stiffness * penalty + RIDGE * np.eye(len(whole))), moment)


def _held_out_share(data: MovingSamples, force: Array, basis: Basis) -> float:
    """Share of the variance that a curve explains in runs of blocks it was not fitted to, at the best stiffness."""
    folds = data.block * min(FOLDS, data.n_blocks) // data.n_blocks
    parts = [(basis.columns[folds == k], data.weight[folds == k], force[folds == k]) for k in np.unique(folds)]
    grams = [(c.T * w) @ c for c, w, _ in parts]
    moments = [(c.T * w) @ f for c, w, f in parts]
    gram, moment = np.sum(grams, axis=0), np.sum(moments, axis=0)
    total = float(data.weight @ force**2) or 1.0
    left = [
        sum(float(w @ (f - c @ _solved(gram - g, moment - m, s, basis.penalty, gram)) ** 2)
            for (c, w, f), g, m in zip(parts, grams, moments, strict=True))
        for s in STIFFNESS
    ]  # fmt: skip
    return max(0.0, 1.0 - min(left) / total)


def _binned(
    data: MovingSamples, x: Array, split: bool, rng: np.random.Generator
) -> tuple[Array, Array, Array, Array, NDArray[np.int_]]:
    """Means of the force in bins of x with as many samples each, and bands from a bootstrap over blocks."""
    if split:
        sides = [side for side in (x[x < 0], x[x > 0]) if len(side)]
        edges = np.unique(np.concatenate([_quantiles(s, max(2, round(BINS * len(s) / len(x)))) for s in sides]))
    else:
        edges = _quantiles(x, BINS)
    place = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, max(0, len(edges) - 2))
    used, place = np.unique(place, return_inverse=True)
    n = len(used)
    one = np.zeros((len(x), n))
    one[np.arange(len(x)), place] = 1.0
    weight, force = data.per_block(one), data.per_block(one * data.d[:, None])
    at, count = data.per_block(one * x[:, None]).sum(0) / weight.sum(0), one.sum(0).astype(int)
    value = force.sum(0) / weight.sum(0)
    times = rng.multinomial(data.n_blocks, np.full(data.n_blocks, 1.0 / data.n_blocks), size=REPEATS)
    total = times @ weight
    drawn = np.where(total > 0, (times @ force) / np.where(total > 0, total, 1.0), np.nan)
    spread = np.sqrt(np.nanmean((drawn - value) ** 2, axis=0))
    # A bin that few blocks visit has no spread between blocks to speak of: then the spread within it counts as one.
    visits = (weight > 0).sum(axis=0)
    inside = np.sqrt(np.maximum((one * (data.d[:, None] - value) ** 2).sum(0) / np.maximum(count, 1), 0.0))
    own = np.sqrt((one * data.std[:, None] ** 2).sum(0) / np.maximum(count, 1))
    spread = np.maximum(spread * np.sqrt(visits / np.maximum(visits - 1, 1)), own / np.sqrt(visits))
    band = 2.0 * np.where(visits < 4, np.maximum(spread, inside), spread)
    return at, value, value - band, value + band, count


def _quantiles(x: Array, n: int) -> Array:
    return np.unique(np.quantile(x, np.linspace(0.0, 1.0, n + 1)))
