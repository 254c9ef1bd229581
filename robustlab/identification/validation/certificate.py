r"""A bound on gamma from multipliers, checked by one backward recursion and nothing else.

Suppose blocks of size gamma_i explain the record. Then for non-increasing :math:`D_{i,t} \ge 0` and
:math:`\lambda_{j,t} \ge 0`

.. math:: L(w, x_0) = \sum_{i,t} D_{i,t} (\gamma_i^2 |z_{i,t}|^2 - |w_{i,t}|^2)
                    + \sum_j \Lambda_j(n_j) \ge 0

at the w and x_0 that do it, because each block has :math:`\sum_{t \le T} |w_t|^2 \le \gamma^2 \sum_{t \le T} |z_t|^2`
for every T, and where :math:`\Lambda_j = \sum_t \lambda_{j,t} (1 - n_{j,t}^2)` for peak bounds and
:math:`\lambda_j (r_j^2 - \sum_t n_{j,t}^2)` for rms bounds. So :math:`\max L < 0` proves that they do not. L is
quadratic and the model a recursion, hence the maximum is one backward sweep of dynamic programming.

References
----------
Poolla, Khargonekar, Tikku, Krause, Nagpal, "A time-domain approach to model validation", IEEE TAC 39 (1994), theorem
3.3 (time-varying Delta); the multipliers are those of its dual.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from robustlab.arrays import Array
from robustlab.identification.response.response import Evidence
from robustlab.identification.validation.sampled_problem import SampledProblem

__all__ = ["Multipliers", "largest_disproved", "lagrangian_maximum"]


# A multiplier of this share of the largest, everywhere, keeps every sweep strictly concave and is as valid.
FLOOR = 1e-7
# Curvatures below this share of the largest are rounding: they count as zero, and what is linear there must vanish.
FLAT = 1e-11
STEPS = 30


@dataclass(frozen=True)
class Multipliers(Evidence):
    """Multipliers of a certificate: D (n, blocks), not increasing along a column; noise (n, n_y), both not negative."""

    D: Array
    noise: Array

    @classmethod
    def cleaned(cls, D: Array, noise: Array) -> Multipliers:
        """Any numbers made valid multipliers, scaled to a largest noise multiplier of one."""
        scale = float(np.abs(noise).max(initial=0.0)) or 1.0
        noise = np.maximum(noise, 0.0) / scale
        D = np.maximum(D, 0.0) / scale
        D = np.maximum.accumulate(D[::-1], axis=0)[::-1]
        return cls(D + FLOOR * np.maximum(D.max(axis=0, initial=0.0), 1e-12), noise)


def lagrangian_maximum(problem: SampledProblem, multipliers: Multipliers, gammas: Array) -> float:
    """Largest value of L over all w and free states; +inf where L is not bounded above. Negative is a proof."""
    n_x, q = problem.B.shape
    D, noise = multipliers.D, np.where(problem.used, multipliers.noise, 0.0)
    if problem.norm == "rms":  # one multiplier for an output
        noise = np.where(problem.used, noise.max(axis=0), 0.0)
    constant = float(noise.sum()) if problem.norm == "peak" else float(noise.max(axis=0) @ problem.radius**2)
    p, n_y = len(problem.C1), len(problem.C2)
    # Rows of (x, w, 1) to z, w and n; their last columns change with t.
    to_z = np.hstack([problem.C1, problem.D11, np.zeros((p, 1))])
    to_n = np.hstack([-problem.C2, -problem.D21, np.zeros((n_y, 1))])
    to_w = np.hstack([np.zeros((q, n_x)), np.eye(q), np.zeros((q, 1))])
    step = np.zeros((n_x + 1, n_x + q + 1))
    step[:n_x, :n_x], step[:n_x, n_x : n_x + q], step[n_x, -1] = problem.A, problem.B, 1.0
    weight_z, weight_w = np.zeros((problem.n, p)), np.zeros((problem.n, q))
    for k, (rows, cols, _) in enumerate(problem.blocks):
        weight_z[:, cols] = (gammas[k] ** 2 * D[:, k])[:, None]
        weight_w[:, rows] = D[:, k][:, None]
    value = np.zeros((n_x + 1, n_x + 1))
    keep, move = [*range(n_x), n_x + q], list(range(n_x, n_x + q))
    for t in range(problem.n - 1, -1, -1):
        to_z[:, -1], to_n[:, -1] = problem.z0[t], problem.e[t]
        H = step.T @ value @ step + to_z.T @ (weight_z[t][:, None] * to_z)
        H -= to_w.T @ (weight_w[t][:, None] * to_w) + to_n.T @ (noise[t][:, None] * to_n)
        reduced = _maximised(H, keep, move)
        if reduced is None:
            return np.inf
        value = reduced
        if t in problem.free_starts:  # x + free xi for the best xi
            jump = np.zeros((n_x + 1, n_x + 1 + problem.free.shape[1]))
            jump[:n_x, :n_x], jump[n_x, n_x], jump[:n_x, n_x + 1 :] = np.eye(n_x), 1.0, problem.free
            reduced = _maximised(jump.T @ value @ jump, [*range(n_x + 1)], list(range(n_x + 1, jump.shape[1])))
            if reduced is None:
                return np.inf
            value = reduced
    return float(value[n_x, n_x] + constant)


def _maximised(H: Array, keep: list[int], move: list[int]) -> Array | None:
    """The quadratic form left when the variables ``move`` are chosen for its maximum; None where there is none."""
    if not move:
        return H[np.ix_(keep, keep)]
    inner, cross = H[np.ix_(move, move)], H[np.ix_(move, keep)]
    values, vectors = np.linalg.eigh(0.5 * (inner + inner.T))
    size = float(np.abs(values).max(initial=0.0))
    turned = vectors.T @ cross
    flat = values > -FLAT * max(size, 1e-300)
    if (values[flat] > FLAT * size).any():
        return None
    if flat.any() and np.abs(turned[flat]).max() > 1e-7 * np.abs(H).max():
        return None
    gain = turned[~flat] / np.sqrt(-values[~flat])[:, None]
    outer = H[np.ix_(keep, keep)] + gain.T @ gain
    return 0.5 * (outer + outer.T)


def largest_disproved(
    problem: SampledProblem, multipliers: Multipliers, gammas: Callable[[float], Array], start: float, precision: float
) -> float:
    """Largest gamma, not above ``start``, that the multipliers disprove; 0 where they disprove none.

    ``gammas`` gives the sizes of the blocks that belong to a gamma. L grows with gamma, so halving is enough.
    """

    def disproved(gamma: float) -> bool:
        return lagrangian_maximum(problem, multipliers, gammas(gamma)) < 0

    share, good = precision / 10, 0.0
    for _ in range(STEPS):  # first close to the start, then further away
        trial = start * (1 - share)
        if share >= 1:
            break
        if disproved(trial):
            good = trial
            break
        share *= 2
    else:
        return 0.0
    if good == 0.0:
        return 0.0
    high = start * (1 - share / 2) if share > precision / 10 else start
    while high - good > 0.1 * precision * high:
        middle = 0.5 * (high + good)
        good, high = (middle, high) if disproved(middle) else (good, middle)
    return good
