r"""Is :math:`\det(I - D_{11} \Delta) \ne 0` for every Delta of the set? Proved, refuted by a Delta, or left open.

D11 is the constant direct way from w to z: where the determinant vanishes, the perturbed model has no solution.

* **Proof**: with :math:`N_{ij} = \bar\sigma(D_{11, ij})` between blocks, :math:`\rho(N) < 1` excludes a zero for all
  Delta of the unit ball (Perron-Frobenius; the best diagonal scaling is in it). A set of real blocks is cut into
  smaller boxes, and the bound is taken around the centre of each, until every box is proved.
* **Refutation**: the eigenvalues of :math:`D_{11} \Delta_0` on rays to vertices, to box centres and to random complex
  Deltas give singular Deltas exactly on the ray; the smallest one that was met is returned.

References
----------
Zhou, Doyle, Glover (1996), sections 5.2 and 11.2; de Gaston, Safonov, "Exact calculation of the multiloop stability
margin", IEEE TAC 33 (1988), for the cutting of boxes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robustlab.arrays import Array
from robustlab.budget import one_thread
from robustlab.errors import InputError, told_as
from robustlab.result import Status
from robustlab.shown import AllFields, Facts, Shown, member, number
from robustlab.uncertainty.blocks import Block, block_slices, delta_values, structure_size
from robustlab.uncertainty.lft import UncertainModel

# Boxes that a proof may cut the real ranges into: fewer leave more questions open.
BOXES = 2000
# Vertices of the real ranges on whose rays a singular Delta is looked for; beyond it so many random ones.
VERTICES = 1024
# Random complex Deltas that are turned and aligned for the same purpose.
RANDOM_DELTAS = 60

Matrix = NDArray[Any]

# A Perron bound this near to one proves nothing: rounding of its own eigenvalue.
CLEAR = 1e-10
# A Delta that was found counts as singular up to this residual.
SINGULAR = 1e-9


@dataclass(frozen=True, eq=False)
class WellPosedness(Shown, AllFields):
    """Answer to the question of this module.

    Attributes
    ----------
    status
        CONVERGED where the question is answered, INCONCLUSIVE where it stays open.
    well_posed
        True: proved for every Delta with normalised size up to ``level``. False: ``delta`` makes it singular. None:
        open; no singular Delta was found (or one to few digits only: status INACCURATE), and none was excluded.
    level
        Size of the set that was asked for; 1 is the set itself.
    delta
        Normalised values of the singular Delta that was found, by block name; empty where there is none.
    parameters
        Physical values and units that belong to it.
    residual
        Smallest singular value of ``I - D11 Delta`` there over ``1 + ||D11 Delta||``; 0 where there is none.
    bound
        Largest Perron bound over all boxes that were proved (or of the whole set, where that is open).
    boxes
        How many boxes were looked at.
    label
        The same in words.
    """

    status: Status
    well_posed: bool | None
    level: float
    delta: dict[str, Any]
    parameters: dict[str, tuple[float, str]]
    residual: float
    bound: float
    boxes: int
    label: str

    def facts(self) -> Facts:
        answer = {True: "yes, every member", False: "no", None: "open"}[self.well_posed]
        return [
            ("well posed", answer),
            ("level", number(self.level)),
            ("singular at", member(self.delta, self.parameters)),
            ("bound", number(self.bound)),
            ("said", self.label),
        ]

    def __str__(self) -> str:
        return self.label


@told_as("well_posedness")
@one_thread()
def well_posedness(uncertain: UncertainModel, level: float = 1.0, seed: int = 0) -> WellPosedness:
    """Whether every member of a set is well posed.

    Parameters
    ----------
    uncertain
        The set.
    level
        The set is scaled with this: 2 asks about twice the uncertainty.
    seed
        Of the random complex Deltas on whose rays a singular one is looked for.

    Returns
    -------
    WellPosedness
        The answer, with the singular Delta that was found or the bound that excludes one.

    Raises
    ------
    InputError
        A level that is not positive and finite.

    Examples
    --------
    >>> from robustlab.uncertainty.blocks import RealScalar
    >>> from robustlab.statespace import StateSpaceModel
    >>> gain = UncertainModel(StateSpaceModel([], [], [], [[0.8, 1.0], [1.0, 0.0]]), [RealScalar("k")])
    >>> print(well_posedness(gain))
    well posed for every Delta of size 1 (bound 0.8, 1 box)
    >>> print(well_posedness(gain, 2.0))
    ill-posed at Delta: k = 1.25
    """
    if isinstance(level, bool) or not isinstance(level, (int, float)) or not 0 < level < np.inf:
        raise InputError("well_posedness", f"level {level!r}", "a positive finite number")
    blocks = uncertain.blocks
    q, p = structure_size(blocks)
    d11 = uncertain.M.D[:p, :q]
    low = np.array([level * (b.interval or (-1.0, 1.0))[0] for b in blocks])
    high = np.full(len(blocks), float(level))
    whole = _perron(d11, blocks, np.maximum(-low, high))
    if whole < 1 - CLEAR:
        return _proved(level, whole, 1)
    rays = _RaySearch(d11, blocks, low, high)
    rays.run(seed)
    if rays.best is None and all(b.interval for b in blocks):
        bound, count, open_ = _cut(d11, blocks, low, high, rays)
        if rays.best is None and not open_:
            return _proved(level, bound, count)
    else:
        count = 1
    if rays.best is not None:
        return _refuted(uncertain, rays.best, d11, level, whole, count)
    text = f"open: no singular Delta of size {level:g} found, and none excluded (bound {whole:.3g}, {count} boxes)"
    return WellPosedness(Status.INCONCLUSIVE, None, level, {}, {}, 0.0, whole, count, text)


def _proved(level: float, bound: float, count: int) -> WellPosedness:
    boxes = "1 box" if count == 1 else f"{count} boxes"
    text = f"well posed for every Delta of size {level:g} (bound {bound:.3g}, {boxes})"
    return WellPosedness(Status.CONVERGED, True, level, {}, {}, 0.0, bound, count, text)


def _refuted(
    uncertain: UncertainModel, delta: Matrix, d11: Array, level: float, bound: float, count: int
) -> WellPosedness:
    values = delta_values(uncertain.blocks, delta)
    product_ = d11 @ delta
    smallest = np.linalg.svd(np.eye(len(d11)) - product_, compute_uv=False)[-1]
    residual = float(smallest / (1.0 + np.linalg.norm(product_, 2)))
    sure = residual <= SINGULAR
    text = f"{'ill-posed at' if sure else 'open: nearly singular at'} {uncertain.named(values)}"
    text = "; ".join([text, *uncertain.impossible(values)])
    status, answer = (Status.CONVERGED, False) if sure else (Status.INACCURATE, None)
    return WellPosedness(status, answer, level, values, uncertain.physical(values), residual, bound, count, text)


# --- proof -----------------------------------------------------------------------------------------------------------


def _perron(d11: Matrix, blocks: Sequence[Block], radius: Array) -> float:
    """Spectral radius of the norms between blocks, each with the radius of the block that it feeds on."""
    k = len(blocks)
    norms = np.zeros((k, k))
    slices = block_slices(blocks)
    for i, (_, z) in enumerate(slices):
        for j, (w, _) in enumerate(slices):
            part = d11[z, w]
            norms[i, j] = radius[j] * (np.linalg.norm(part, 2) if part.any() else 0.0)
    return float(np.abs(np.linalg.eigvals(norms)).max(initial=0.0))


def _cut(d11: Array, blocks: Sequence[Block], low: Array, high: Array, rays: _RaySearch) -> tuple[float, int, bool]:
    """Boxes of real entries, each proved around its centre or cut in two; (largest bound, boxes, is any left open)."""
    boxes, largest = [(low, high)], 0.0
    for count in range(1, BOXES + 1):
        lower, upper = boxes.pop()
        centre, radius = 0.5 * (lower + upper), 0.5 * (upper - lower)
        delta = rays.real_delta(centre)
        loop = np.eye(len(d11)) - d11 @ delta
        if rays.along(delta, 1.0):
            return largest, count, True
        bound = _perron(np.linalg.solve(loop, d11), blocks, radius)
        if bound < 1 - CLEAR:
            largest = max(largest, bound)
        else:
            k = int(np.argmax(radius * rays.influence))
            left, right = upper.copy(), lower.copy()
            left[k], right[k] = centre[k], centre[k]
            boxes += [(lower, left), (right, upper)]
        if not boxes:
            return largest, count, False
    return largest, BOXES, True


# --- refutation ------------------------------------------------------------------------------------------------------


class _RaySearch:
    """Singular Deltas on rays from zero, the smallest that was met is kept."""

    def __init__(self, d11: Array, blocks: Sequence[Block], low: Array, high: Array) -> None:
        self.d11, self.blocks, self.low, self.high = d11, tuple(blocks), low, high
        self.slices = block_slices(blocks)
        self.real = [i for i, b in enumerate(blocks) if b.interval]
        # A constant real matrix may not be turned in phase.
        self.turns = not any(b.is_real for b in blocks if not b.interval)
        self.shape = structure_size(blocks)
        self.best: Matrix | None = None
        self.smallest = 1.0 + 1e-12
        self.influence = np.array([np.linalg.norm(d11[:, w]) * np.linalg.norm(d11[z]) for w, z in self.slices])

    def run(self, seed: int) -> None:
        """Vertices of the real blocks, each with random complex blocks turned into every phase."""
        rng = np.random.default_rng(seed)
        k = len(self.real)
        if 2**k <= VERTICES:
            signs = np.array(list(product((-1.0, 1.0), repeat=k))).reshape(2**k, k)
        else:
            signs = rng.choice([-1.0, 1.0], (VERTICES, k))
        for sign in signs:
            self.along(self.real_delta(np.where(sign > 0, self.high[self.real], self.low[self.real])), 1.0)
        if k == len(self.blocks):
            return
        for _ in range(RANDOM_DELTAS):
            share = np.append(rng.uniform(-1, 1, k), 0.0)[:k] if rng.random() < 0.8 else np.zeros(k)
            base = self.real_delta(np.where(share > 0, self.high[self.real], -self.low[self.real]) * share)
            self._turned(base, self._complex_delta(rng))
            if self.best is not None:
                return

    def real_delta(self, entries: Array) -> Array:
        """Delta with these entries in the real blocks (in their order), zero elsewhere."""
        delta = np.zeros(self.shape)
        for i, entry in zip(self.real, entries, strict=True):
            rows, cols = self.slices[i]
            delta[rows, cols] = entry * np.eye(self.blocks[i].rows)
        return delta

    def along(self, delta: Array, reach: float) -> bool:
        """Whether ``t delta`` is singular for some 0 < t <= reach; the smallest one is kept."""
        values = np.linalg.eigvals(self.d11 @ delta)
        real = values.real[(np.abs(values.imag) <= 1e-9 * np.abs(values)) & (values.real > 0)]
        if not len(real) or 1.0 / real.max() > reach * (1 + 1e-12):
            return False
        if 1.0 / real.max() <= self.smallest:
            self.smallest, self.best = 1.0 / real.max(), delta / real.max()
        return True

    def _complex_delta(self, rng: np.random.Generator) -> Matrix:
        """Random complex and full blocks on their boundary: rank one, since that is enough for a full block."""
        delta = np.zeros(self.shape, dtype=complex)
        for i, (rows, cols) in enumerate(self.slices):
            b = self.blocks[i]
            if i in self.real:
                continue
            delta[rows, cols] = self.high[i] * b.extreme(rng, lambda n: _complex_normal(rng, n))
        return delta

    def _turned(self, base: Array, delta: Matrix) -> None:
        """With real blocks fixed at ``base``: the complex ones shrunk and turned until the loop is singular.

        A few steps towards the worst direction (power iteration on the singular vectors) first.
        """
        loop = np.eye(self.shape[1]) - self.d11 @ base
        if np.linalg.cond(loop) > 1e12:
            return
        seen = np.linalg.solve(loop, self.d11)
        for _ in range(20):
            values, vectors = np.linalg.eig(seen @ delta)
            top = int(np.argmax(np.abs(values)))
            value = values[top]
            if abs(value) >= 1.0 and (self.turns or abs(value.imag) <= 1e-12 * abs(value)):
                size = 1.0 / abs(value)
                if size <= self.smallest:
                    self.smallest, self.best = size, base + delta / (value if self.turns else value.real)
                return
            delta = self._better(seen, delta, vectors[:, top])

    def _better(self, seen: Matrix, delta: Matrix, z: Matrix) -> Matrix:
        """Each complex block aligned with the signals at the present eigenvector: w = Delta z as large as it may be."""
        left = np.linalg.eig((seen @ delta).conj().T)
        y = left[1][:, int(np.argmax(np.abs(left[0])))]
        back = seen.conj().T @ y
        result = delta.copy()
        for i, (rows, cols) in enumerate(self.slices):
            if i in self.real:
                continue
            aligned = self.blocks[i].aligned(back[rows].conj(), z[cols], self.high[i])
            if aligned is not None:
                result[rows, cols] = aligned
        return result


def _complex_normal(rng: np.random.Generator, n: int) -> Matrix:
    return rng.standard_normal(n) + 1j * rng.standard_normal(n)
