r"""The residual force that no effect of the catalogue explains: over what it varies, and a map that corrects it.

The force d along a record (from `robustlab.identification.hypotheses.disturbance_smoother`) is set against coordinates:
speed, position, time, input. Whatever follows a coordinate is structure; what does not is noise or history. Three rules
keep the answers honest:

* d is correlated in time, so nothing is counted by samples but by contiguous blocks: bands come from a bootstrap over
  blocks, tests from a random sign for each block (exact for a force without structure, whatever its spectrum and
  spread, as long as blocks are longer than its memory).
* A share of the variance is always of blocks that the curve was not fitted to; a negative one counts as 0.
* Each curve is a penalised B-spline whose stiffness is chosen by the same cross-validation.

A coordinate whose name begins with "speed" turns dry forces round: curves over it are free to jump at zero, and for
every other coordinate x there is, besides f(x), the dry pair sgn(v) f(x). One that begins with "position" may also hide
a ripple f = a cos(kappa x) + b sin(kappa x) of any order, and hysteresis (sums of play operators of the position).
Samples at rest are left out: there a dry joint takes up any force.

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
from robustlab.errors import InputError
from robustlab.identification.unnamed.block_regression import (
    STIFFNESS,
    Basis,
    BlockRegression,
    MovingSamples,
    coordinate_bases,
    held_out,
    hysteresis_basis,
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
MOST_WAVES = 1200  # ripple orders tried
GAIN = 0.1  # a component must explain this much of what the others leave, in held-out blocks, to enter the map
ALARM = 0.01
CHANCE, LEAST, MOST = 16.0, 0.02, 0.25  # share that chance reaches, times independent values; its limits


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


@dataclass(frozen=True)
class StructureTest(Evidence):
    """Does anything systematic remain in a residual force?"""

    share: float  # Held-out share of the mean square that ``strongest`` explains, 0..1
    p_value: float  # chance that any of the looked-for structures looks as strong in a force without structure
    # the strongest of them: "constant", "f(x)", "sgn(v) f(x)", "ripple over x (k per unit)", "hysteresis over x"
    strongest: str
    # smaller shares also come about by chance, since a slow force has few independent values: 0.02 to 0.25
    smallest_share: float

    @property
    def found(self) -> bool:
        """True where structure remains: neither chance nor the force's own slowness explains it."""
        return self.p_value <= ALARM and self.share >= self.smallest_share


@dataclass(frozen=True)
class ForceTable(Evidence):
    """One component of the map, as a table; held constant outside its grid.

    ``kind`` is "plain": f(x) = value(x); "dry": sgn(v) value(x); or "speed": the grid has zero twice, first with the
    value for v -> 0 from below, then from above.
    """

    coordinate: str
    kind: str
    grid: Array
    value: Array

    def at(self, x: Array, sign: Array) -> Array:
        """Force at x, with the sign of the speed."""
        if self.kind == "speed":
            below, above = self.sides()
            left, right = np.interp(x, *below), np.interp(x, *above)
            return np.where(x < 0, left, np.where(x > 0, right, 0.5 * (left + right)))
        force = np.interp(x, self.grid, self.value)
        return sign * force if self.kind == "dry" else force

    def sides(self) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
        """(grid, value) below zero and above, of a table over speed."""
        half = len(self.grid) // 2
        return (self.grid[:half], self.value[:half]), (self.grid[half:], self.value[half:])


@dataclass(frozen=True)
class UnnamedForce(Evidence):
    """A correction without a name: an additive map, the honest last resort."""

    name: str  # "unnamed"
    unit: str  # unit of the force
    constant: float  # part that depends on nothing
    components: tuple[ForceTable, ...]  # tables, strongest first; none where nothing explains held-out blocks
    speed: str | None  # name of the coordinate whose sign dry components take, or None
    gain: float  # Held-out share of the variance (of the mean square, with the constant) that the map removes, 0..1

    def curves(self) -> dict[str, tuple[Array, Array]]:
        """``"kind coordinate" -> (grid, value)``, contiguous arrays for a compiled kernel."""
        return {f"{c.kind} {c.coordinate}": (c.grid, c.value) for c in self.components}

    def force(self, coordinates: Mapping[str, ArrayLike]) -> Array:
        """The force along a record.

        Raises
        ------
        InputError
            A coordinate of the map is not given.
        """
        needed = {c.coordinate for c in self.components} | ({self.speed} if self.speed else set())
        missing = sorted(needed - set(coordinates))
        if missing or not coordinates:
            raise InputError(WHERE, f"no coordinate {missing[0] if missing else ''!r}", ", ".join(sorted(needed)))
        x = {name: np.asarray(value, dtype=np.float64) for name, value in coordinates.items()}
        sign = np.sign(x[self.speed]) if self.speed else np.ones(len(next(iter(x.values()))))
        total = np.full(len(sign), self.constant)
        for component in self.components:
            total += component.at(x[component.coordinate], sign)
        return total


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


# --- what is left ----------------------------------------------------------------------------------------------------


def structure_left(
    d: ArrayLike,
    d_std: ArrayLike,
    coordinates: Mapping[str, ArrayLike],
    blocks: int | NDArray[np.int_] = BLOCKS,
    *,
    seed: int = 0,
) -> StructureTest:
    """Whether anything systematic remains in a residual force.

    Looked for are a constant, a curve over each coordinate, its dry pair, a ripple of any order and hysteresis over
    each position. The strongest is judged against the strongest of all under random signs of the blocks, so that
    looking in many places is paid for. Parameters and errors as in `residual_force`.
    """
    data = moving_samples(d, d_std, coordinates, blocks)
    signs = random_signs(data.n_blocks, seed)
    one, zero = np.ones((len(data.d), 1)), np.zeros((1, 1))
    found = {"constant": BlockRegression(data, data.d, one, zero).best(signs, STIFFNESS[:1])[0]}
    shares = {"constant": float(found["constant"][0])}
    bases = coordinate_bases(data)
    bases += [hysteresis_basis(name, x) for name, x in data.x.items() if role(name) == "position" and np.ptp(x) > 0]
    for basis in bases:
        found[basis.label] = BlockRegression(data, data.d, basis.columns, basis.penalty).best(signs, STIFFNESS[::2])[0]
        shares[basis.label] = float(found[basis.label][0])
    for name, x in data.x.items():
        if role(name) == "position" and np.ptp(x) > 0:
            label, statistic, share = _ripple(data, name, x, signs)
            found[label], shares[label] = statistic, share
    statistics = np.stack(list(found.values()))
    null = statistics[:, 1:]
    spread = null.std(axis=1, keepdims=True)
    level = (statistics - null.mean(axis=1, keepdims=True)) / np.where(spread > 0, spread, 1.0)
    strongest = max(shares, key=lambda label: shares[label])
    smallest = min(MOST, max(LEAST, CHANCE / _independent(data)))
    return StructureTest(max(0.0, shares[strongest]), p_value(level.max(axis=0)), strongest, smallest)


def _independent(data: MovingSamples) -> float:
    """Number of independent values in the force: samples over the sum of its squared autocorrelation (Bartlett)."""
    force = data.d - data.d.mean()
    power = np.abs(np.fft.rfft(force, 2 * len(force))) ** 2
    correlation = np.fft.irfft(power)[: len(force)]
    if not correlation[0] > 0:
        return 1.0
    correlation = correlation / correlation[0]
    return float(len(force) / (1.0 + 2.0 * (correlation[1:] ** 2).sum()))


def _ripple(data: MovingSamples, name: str, x: Array, signs: Array) -> tuple[str, Array, float]:
    """The strongest periodicity over x: its label, the explained power for each set of signs, its held-out share."""
    span = float(np.ptp(x))
    # A turn of the ripple needs a few samples where the motion is fastest.
    step = np.abs(np.diff(x))
    finest = 0.25 * span / max(float(np.quantile(step, 0.9)), 1e-12 * span)
    top = min(finest, MOST_WAVES / 1.5)
    waves = np.linspace(2.0, max(top, 2.5), int(min(MOST_WAVES, max(2, 1.5 * (top - 2.0)))))
    phase = 2.0 * np.pi * np.outer((x - x.min()) / span, waves)
    parts = [np.cos(phase), np.sin(phase)]
    if data.speed:
        parts += [part * data.sign[:, None] for part in parts]
    moment = np.stack([data.per_block(p * data.d[:, None]) for p in parts], axis=2)  # (blocks, waves, parts)
    gram = np.empty((len(waves), len(parts), len(parts)))
    for i, a in enumerate(parts):
        for j, b in enumerate(parts[: i + 1]):
            gram[:, i, j] = gram[:, j, i] = np.einsum("nw,nw,n->w", a, b, data.weight)
    inverse = np.linalg.inv(gram + 1e-6 * data.weight.sum() * np.eye(len(parts)))
    power = _explained(signs, moment, inverse)
    # The order is chosen anew without each fold, or the share would be of data that chose it.
    folds, error = held_out(data.n_blocks), 0.0
    for k, wave in enumerate(_explained((~folds).astype(np.float64), moment, inverse).argmax(axis=1).tolist()):
        one = BlockRegression(data, data.d, np.column_stack([p[:, wave] for p in parts]), 1e-3 * np.eye(len(parts)))
        error += float(one.errors(1.0, np.ones((1, data.n_blocks)))[0, k])
    total = float(data.per_block(data.d**2).sum())
    best = int(power[0].argmax())
    label = f"ripple over {name} ({waves[best] / span:.4g} per unit)"
    return label, np.sqrt(power.max(axis=1)), 1.0 - error / total if total > 0 else 0.0


def _explained(signs: Array, moment: Array, inverse: Array) -> Array:
    """Explained power of every wave for every set of signs, (n_signs, n_waves)."""
    turned = np.einsum("sb,bwp->swp", signs, moment, optimize=True)
    return np.einsum("swp,wpq,swq->sw", turned, inverse, turned, optimize=True)


# --- the map ---------------------------------------------------------------------------------------------------------


def fit_unnamed(
    d: ArrayLike,
    d_std: ArrayLike,
    coordinates: Mapping[str, ArrayLike],
    blocks: int | NDArray[np.int_] = BLOCKS,
    *,
    unit: str = "",
) -> UnnamedForce:
    """An additive map of the force: components enter one by one while they explain held-out blocks.

    Coordinates with the role "time" do not enter: a map of time explains nothing on another record. Parameters and
    errors as in `residual_force`.
    """
    data = moving_samples(d, d_std, coordinates, blocks)
    alone, constant_basis = np.ones((1, data.n_blocks)), np.ones((len(data.d), 1))
    candidates = [b for b in coordinate_bases(data) if role(b.coordinate) != "time"]
    chosen: list[Basis] = []
    stiff: list[float] = []
    gain = float(BlockRegression(data, data.d, constant_basis, np.zeros((1, 1))).best(alone, STIFFNESS[:1])[0][0])
    while candidates:
        trials = [_with(data, chosen, stiff, basis) for basis in candidates]
        k = int(np.argmax([share for share, _ in trials]))
        if not trials[k][0] > max(gain, 0.0) + GAIN * (1.0 - max(gain, 0.0)):
            break
        gain = trials[k][0]
        stiff.append(trials[k][1])
        chosen.append(candidates.pop(k))
    blocks_of = BlockRegression(data, data.d, *_joined(data, chosen, stiff))
    c = blocks_of.solve(1.0)[:, 0]
    if not chosen and gain <= 0:
        c = np.zeros_like(c)
    constant, at = float(c[0]), 1
    friction = next((k for k, basis in enumerate(chosen) if basis.kind == "speed"), None)
    values: list[Array] = []
    turned = 0.0  # part of the dry pairs that only takes the sign of the speed
    for basis in chosen:
        part = c[at : at + basis.columns.shape[1]]
        at += len(part)
        value = basis.at(basis.grid, _side(basis)) @ part
        if basis.kind != "speed":  # what is the same everywhere belongs to the constant, or to the curve over speed
            mean = float(np.average(basis.columns @ part * _turn(basis, data), weights=data.weight))
            if basis.kind == "plain":
                value, constant = value - mean, constant + mean
            elif friction is not None:
                value, turned = value - mean, turned + mean
        values.append(value)
    if friction is not None:
        values[friction] = values[friction] + constant + turned * _side(chosen[friction])
        constant = 0.0
    tables = [ForceTable(b.coordinate, b.kind, b.grid.copy(), v) for b, v in zip(chosen, values, strict=True)]
    return UnnamedForce("unnamed", unit, constant, tuple(tables), data.speed, max(0.0, gain))


def _side(basis: Basis) -> Array:
    """Sign of the speed that each point of a component's grid stands for."""
    side = np.ones(len(basis.grid))
    if basis.kind == "speed":
        side[: len(side) // 2] = -1.0
    return side


def _turn(basis: Basis, data: MovingSamples) -> Array:
    return data.sign if basis.kind == "dry" else np.ones_like(data.sign)


def _with(data: MovingSamples, chosen: list[Basis], stiff: list[float], basis: Basis) -> tuple[float, float]:
    """Best held-out share with one more component, and its stiffness."""
    alone = np.ones((1, data.n_blocks))
    trials = [
        float(
            BlockRegression(data, data.d, *_joined(data, [*chosen, basis], [*stiff, s])).best(alone, np.ones(1))[0][0]
        )
        for s in STIFFNESS[1::2].tolist()
    ]
    k = int(np.argmax(trials))
    return trials[k], float(STIFFNESS[1::2][k])


def _joined(data: MovingSamples, bases: list[Basis], stiff: list[float]) -> tuple[Array, Array]:
    """Columns of a constant and all components, and the penalty with each one's stiffness in it.

    A small ridge gives the constant, which every spline could also carry, to the column of ones.
    """
    from scipy.linalg import block_diag

    columns = np.hstack([np.ones((len(data.d), 1)), *(b.columns for b in bases)])
    penalty = [s * b.penalty + 1e-6 * np.eye(len(b.penalty)) for s, b in zip(stiff, bases, strict=True)]
    return columns, np.asarray(block_diag(np.zeros((1, 1)), *penalty), dtype=np.float64)
