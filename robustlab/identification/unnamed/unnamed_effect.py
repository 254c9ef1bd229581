r"""The residual force that no effect of the catalogue explains: over what it varies.

The force d along a record (from `robustlab.identification.hypotheses.disturbance_smoother`) is set against coordinates:
speed, position, time, input. Whatever follows a coordinate is structure; what does not is noise or history. Three rules
keep the answers honest:

* d is correlated in time, so nothing is counted by samples but by contiguous blocks: bands come from a bootstrap over
  blocks, tests from a random sign for each block (exact for a force without structure, whatever its spectrum and
  spread, as long as blocks are longer than its memory).
* A share of the variance is always of blocks that the curve was not fitted to; a negative one counts as 0.
* Each curve is a penalised B-spline whose stiffness is chosen by the same cross-validation.

Curves over a coordinate whose name begins with "speed" may jump at zero, and every other coordinate x has, besides
f(x), the dry pair sgn(v) f(x). Samples at rest are left out: there a dry joint takes up any force.

References
----------
Eilers, Marx, "Flexible smoothing with B-splines and penalties", Statistical Science 11 (1996); Cameron, Gelbach,
Miller, "Bootstrap-based improvements for inference with clustered errors" (2008); Brokate, Sprekels, *Hysteresis and
Phase Transitions* (1996), chapter 2 (play operators).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robustlab.arrays import Array
from robustlab.identification.unnamed.block_regression import (
    Basis,
    BlockRegression,
    MovingSamples,
    coordinate_bases,
    moving_samples,
    p_value,
    random_signs,
    role,
)
from robustlab.result import Evidence

WHERE = "unnamed effect"

BLOCKS = 24
BINS = 24
REPEATS = 400  # of the bootstrap


# --- results ---------------------------------------------------------------------------------------------------------


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
    p_value: float  # chance of such a share where the force does not depend on the coordinate


@dataclass(frozen=True)
class ResidualForce(Evidence):
    """The residual force over each coordinate."""

    unit: str  # unit of the force
    rms: float  # of the force
    noise_share: float  # share of its variance that the estimate's own std accounts for
    curves: Mapping[str, ForceCurve]  # coordinate -> curve
    # coordinate x -> further held-out share of sgn(v) f(x) on top of the curve over the speed; empty without one
    dry_share: Mapping[str, float]
    joint_share: float  # Held-out share of all coordinates together, added up
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
    """The residual force over each coordinate, with bands and held-out shares.

    Parameters
    ----------
    d, d_std
        Force along the record and its standard deviation, (n,).
    coordinates
        Name -> samples (n,). The first word of a name is its role: "speed", "position", "time", or any other.
    units
        Name -> unit.
    unit
        Unit of the force.
    blocks
        Number of contiguous blocks, or a label for each sample (several records: labels that no two share).
    seed
        Of bootstrap and signs.

    Raises
    ------
    InputError
        Lengths that differ, NaN, a std that is not positive, no coordinate, fewer than 8 blocks in motion.
    """
    data = moving_samples(d, d_std, coordinates, blocks)
    force = data.d - np.average(data.d, weights=data.weight)
    signs, rng = random_signs(data.n_blocks, seed), np.random.default_rng(seed)
    curves: dict[str, ForceCurve] = {}
    dry: dict[str, float] = {}
    bases = coordinate_bases(data)
    for basis in bases:
        name = basis.coordinate
        if basis.kind == "dry":
            continue
        shares, _ = BlockRegression(data, force, basis.columns, basis.penalty).best(signs)
        share = max(0.0, float(shares[0]))
        x, value, low, high, count = _binned(data, data.x[name], role(name) == "speed", rng)
        unit_x = (units or {}).get(name, "")
        curves[name] = ForceCurve(name, unit_x, x, value, low, high, count, share, p_value(shares))
    for basis in bases:
        if basis.kind == "dry" and data.speed in curves:
            both = [next(b for b in bases if b.kind == "speed"), basis]
            dry[basis.coordinate] = max(0.0, _share(data, force, both) - curves[data.speed].share)
    joint = _share(data, force, bases) if bases else 0.0
    variance = float(np.average(force**2, weights=data.weight))
    noise = min(1.0, float(np.average(data.std**2, weights=data.weight)) / variance) if variance > 0 else 1.0
    rms = math.sqrt(float(np.mean(data.d**2)))
    return ResidualForce(unit, rms, noise, curves, dry, joint, data.n_blocks)


def _share(data: MovingSamples, force: Array, bases: Sequence[Basis]) -> float:
    """Held-out share of several components together."""
    both = BlockRegression(data, force, np.hstack([b.columns for b in bases]), _block_diagonal(bases))
    return max(0.0, float(both.best(np.ones((1, data.n_blocks)))[0][0]))


def _block_diagonal(bases: Sequence[Basis]) -> Array:
    from scipy.linalg import block_diag

    return np.asarray(block_diag(*(b.penalty for b in bases)), dtype=np.float64)


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


def _explained(signs: Array, moment: Array, inverse: Array) -> Array:
    """Explained power of every wave for every set of signs, (n_signs, n_waves)."""
    turned = np.einsum("sb,bwp->swp", signs, moment, optimize=True)
    return np.einsum("swp,wpq,swq->sw", turned, inverse, turned, optimize=True)


# --- the map ---------------------------------------------------------------------------------------------------------
