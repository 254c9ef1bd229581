r"""Regression of a force along a record on coordinates, judged by blocks of time.

Everything that a fit, its cross-validation and a test under random signs of the blocks need of the samples are the
normal equations of each block; they are summed once, and all else is linear algebra on small matrices.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robustlab.arrays import Array
from robustlab.errors import InputError
from robustlab.statespace import real_array

WHERE = "unnamed effect"

FEWEST_BLOCKS = 8
POINTS = 4000  # samples looked at: d is smooth, and a denser grid tells nothing more
REST = 0.01  # of the largest speed: slower counts as standing still
FOLDS = 8  # of cross-validation
FLIPS = 400  # random signs
STIFFNESS = 10.0 ** np.arange(-5.0, 3.0)  # penalty over the data's own weight
RIDGE = 1e-7
SIDE, WIDE, SLOW = 8, 14, 2  # spline coefficients on a side of zero speed and over other coordinates; degree over time


# --- the data --------------------------------------------------------------------------------------------------------


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
    """The checked samples in motion; parameters and errors as in `robustlab.identification.unnamed.unnamed_effect`."""
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


# --- components: bases with penalties --------------------------------------------------------------------------------


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


# --- cross-validation by blocks --------------------------------------------------------------------------------------


class BlockRegression:
    """Normal equations of every block for one set of columns; all else follows from them, whatever the signs."""

    def __init__(self, data: MovingSamples, force: Array, columns: Array, penalty: Array) -> None:
        n, p = data.n_blocks, columns.shape[1]
        self.gram, self.moment = np.zeros((n, p, p)), np.zeros((n, p))
        for b in range(n):
            part = data.block == b
            weighted = columns[part] * data.weight[part, None]
            self.gram[b], self.moment[b] = weighted.T @ columns[part], weighted.T @ force[part]
        self.power = data.per_block(force**2)
        whole = self.gram.sum(axis=0)
        size = float(np.trace(whole)) / p
        # Dimensionless: the same stiffness means the same smoothing for any unit, length and number of columns.
        self.penalty, self.ridge = penalty * size, RIDGE * size * np.eye(p)

    def solve(self, stiffness: float, kept: NDArray[np.bool_] | None = None, signs: Array | None = None) -> Array:
        """Coefficients (p, n_signs) from the kept blocks, all if left out."""
        kept = np.ones(len(self.power), dtype=bool) if kept is None else kept
        gram = self.gram[kept].sum(axis=0) + stiffness * self.penalty + self.ridge
        signs = np.ones((1, len(self.power))) if signs is None else signs
        return np.linalg.solve(gram, (signs[:, kept] @ self.moment[kept]).T)

    def errors(self, stiffness: float, signs: Array) -> Array:
        """Squared error of each fold under the fit to the others, (n_signs, n_folds)."""
        folds = held_out(len(self.power))
        result = np.empty((len(signs), len(folds)))
        for k, out in enumerate(folds):
            c = self.solve(stiffness, ~out, signs)
            moment = (signs[:, out] @ self.moment[out]).T
            result[:, k] = self.power[out].sum() + ((self.gram[out].sum(axis=0) @ c - 2.0 * moment) * c).sum(axis=0)
        return result

    def best(self, signs: Array, stiffnesses: Array = STIFFNESS) -> tuple[Array, Array]:
        """Held-out share (n_signs,) at the best stiffness of each, and that stiffness."""
        total = float(self.power.sum()) or 1.0
        share = np.stack([1.0 - self.errors(s, signs).sum(axis=1) / total for s in stiffnesses])
        at = share.argmax(axis=0)
        return share[at, np.arange(share.shape[1])], stiffnesses[at]


def held_out(n_blocks: int) -> NDArray[np.bool_]:
    """Which blocks each fold holds out, (n_folds, n_blocks): runs of neighbours."""
    n_folds = min(FOLDS, n_blocks)
    return np.arange(n_blocks) * n_folds // n_blocks == np.arange(n_folds)[:, None]


def random_signs(n_blocks: int, seed: int) -> Array:
    """Signs (1 + FLIPS, n_blocks); the first row is all ones."""
    rng = np.random.default_rng(seed)
    return np.vstack([np.ones(n_blocks), rng.choice([-1.0, 1.0], size=(FLIPS, n_blocks))])


def p_value(statistic: Array) -> float:
    """Chance of a statistic as large as the first one, among those of random signs; never 0."""
    return float((1 + (statistic[1:] >= statistic[0]).sum()) / len(statistic))
