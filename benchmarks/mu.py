"""mu upper bound: time per matrix and tightness, ours (certified) beside three peers, in one run.

Peers: raw slycot.ab13md (no repeated and no rectangular blocks), dkpy's LMI by bisection (complex full blocks only;
where it is installed), and the D-G inequality in cvxpy with Clarabel by bisection, which knows every kind of block and
whose optimum is the measure of tightness. Slow peers get the first matrices of the batch only.
"""

from __future__ import annotations

import importlib.util
from typing import Any

import numpy as np
import slycot
from harness import heading, timed

import robustlab as rl
from robustlab.budget import one_thread
from robustlab.mu_analysis.matrix.certificate import project, proves
from robustlab.mu_analysis.matrix.upper import upper_bounds
from robustlab.uncertainty.blocks import FullBlock, RealScalar, as_blocks, structure_size

# name, rows of mussv, matrices for cvxpy and dkpy
CASES = [
    ("6 real", [[-1, 0]] * 6, 3), ("12 real", [[-1, 0]] * 12, 1), ("24 real", [[-1, 0]] * 24, 0),
    ("40 real", [[-1, 0]] * 40, 0), ("6 real twice", [[-2, 0]] * 6, 1), ("12 real twice", [[-2, 0]] * 12, 0),
    ("24 real twice", [[-2, 0]] * 24, 0), ("6 complex", [[1, 0]] * 6, 3), ("12 complex", [[1, 0]] * 12, 1),
    ("24 complex", [[1, 0]] * 24, 0), ("3 complex twice", [[2, 0]] * 3, 2), ("5 full 4x4", [[4, 4]] * 5, 0),
    ("3 full 2x3", [[2, 3]] * 3, 2), ("3 real, 3 full 2x2", [[-1, 0]] * 3 + [[2, 2]] * 3, 2),
    ("every kind", [[-2, 0], [-1, 0], [2, 0], [1, 0], [2, 1], [2, 2]], 1),
]  # fmt: skip


class Inequality:
    """The D-G inequality in cvxpy: the largest margin for a given beta^2, with the trace of D fixed."""

    def __init__(self, blocks) -> None:
        import cvxpy as cp

        q, p = structure_size(blocks)
        self.shape, constraints = (p, q), []
        d_w, d_z, g = [], [], []
        for b in blocks:
            if isinstance(b, FullBlock):
                d = cp.Variable(nonneg=True)
                parts = (d * np.eye(b.rows), d * np.eye(b.cols), np.zeros((b.rows, b.cols)))
            else:
                d = cp.Variable((b.rows, b.rows), hermitian=True) if b.rows > 1 else cp.Variable((1, 1))
                constraints.append(d >> 0)
                real = isinstance(b, RealScalar)
                free = cp.Variable((b.rows, b.rows), hermitian=True) if b.rows > 1 else cp.Variable((1, 1))
                parts = (d, d, free if real else np.zeros((b.rows, b.rows)))
            for into, part in zip((d_w, d_z, g), parts, strict=True):
                into.append(part)
        Dw, Dz, G = (_diagonal(cp, parts) for parts in (d_w, d_z, g))
        self.M, self.square, slack = cp.Parameter((p, q), complex=True), cp.Parameter(nonneg=True), cp.Variable()
        # Products of a parameter with itself are not affine in it for cvxpy: [[-t D_w - .., M^* D_z], [.., -D_z]] is.
        GM = G @ self.M
        corner = 1j * (GM - GM.H) - self.square * Dw + slack * np.eye(q)
        whole = cp.bmat([[corner, self.M.H @ Dz], [Dz @ self.M, -Dz]])
        constraints += [(whole + whole.H) / 2 << 0, cp.real(cp.trace(Dw)) == q, slack <= 1]
        self.problem, self.slack = cp.Problem(cp.Maximize(slack), constraints), slack

    def bound(self, M, accuracy: float) -> float:
        """Upper end of a bracket of relative width ``accuracy`` around the optimum."""
        import cvxpy as cp

        size = np.linalg.norm(M, 2)
        self.M.value = M / size
        low, high = 0.0, 1.0
        while high - low > accuracy * high:
            beta = (low + high) / 2
            self.square.value = beta**2
            self.problem.solve(solver=cp.CLARABEL)
            if self.slack.value is not None and self.slack.value > 1e-9:
                high = beta
            else:
                low = beta
        return high * size


def commute(blocks: Any, bound: Any) -> bool:
    """Whether ``D_w Delta = Delta D_z`` and ``Delta^* G`` is Hermitian for a random Delta of the structure."""
    rng = np.random.default_rng(1)
    delta = project(blocks, rng.standard_normal(bound.G.shape) + 1j * rng.standard_normal(bound.G.shape))
    turned = delta.conj().T @ bound.G
    off = np.linalg.norm(bound.Dw @ delta - delta @ bound.Dz) + np.linalg.norm(turned - turned.conj().T)
    return bool(off <= 1e-12 * (np.linalg.norm(bound.Dw) + np.linalg.norm(bound.G)) * np.linalg.norm(delta))


def _diagonal(cp, parts):
    shapes = [part.shape for part in parts]
    rows = range(len(parts))
    return cp.bmat([[parts[i] if i == j else np.zeros((shapes[i][0], shapes[j][1])) for j in rows] for i in rows])


def random_stack(rows, count: int) -> tuple[np.ndarray, list]:
    """Random complex matrices for rows of mussv, and their blocks."""
    blocks = as_blocks(rows)
    q, p = structure_size(blocks)
    rng = np.random.default_rng(len(rows) * 100 + q)
    return rng.standard_normal((count, p, q)) + 1j * rng.standard_normal((count, p, q)), list(blocks)


def each(function, items) -> tuple[float, list]:
    answers, seconds = timed(lambda: [function(item) for item in items])
    return 1e3 * seconds / max(len(items), 1), answers


def ab13md(blocks):
    """A call of raw slycot for these blocks, or None where it has none."""
    if any((b.rows != b.cols) if isinstance(b, FullBlock) else b.repeats > 1 for b in blocks):
        return None
    sizes = np.array([b.rows for b in blocks])
    kinds = np.array([1 if isinstance(b, RealScalar) else 2 for b in blocks])
    return lambda m: slycot.ab13md(m, sizes, kinds)[0]


def dkpy_bound(blocks):
    """dkpy's bisection with its default tolerances, or None where it has none for these blocks."""
    full = all(isinstance(b, FullBlock) or (not isinstance(b, RealScalar) and b.repeats == 1) for b in blocks)
    if not full or importlib.util.find_spec("dkpy") is None:
        return None
    import dkpy

    structure = [dkpy.ComplexFullBlock(b.rows, b.cols) for b in blocks]
    solver = dkpy.SsvLmiBisection(n_jobs=1)
    return lambda m: float(solver.compute_ssv(m[:, :, None], structure)[0][0])


def line(name: str, rows, slow: int, count: int) -> str:
    M, blocks = random_stack(rows, count)
    q = M.shape[2]
    bounds, spent = timed(upper_bounds, M, blocks)
    own_ms = 1e3 * spent / count
    own = np.array([b.beta for b in bounds])
    lower = rl.mu(M[:3], blocks).lower
    proved = [commute(blocks, b) and proves(m, b.Dw, b.Dz, b.G, b.beta) for m, b in zip(M, bounds, strict=True)]
    wrong = count - sum(proved) + int((own[:3] < lower * (1 - 1e-8)).sum())
    cells = [f"{name:20s}{own_ms:9.2f}"]
    for peer, some in ((ab13md(blocks), M if q <= 12 else M[:3] if q <= 24 else M[:1]), (dkpy_bound(blocks), M[:slow])):
        if peer is None or not len(some):
            cells.append(f"{'-':>10s}{'-':>9s}{'-':>10s}")
            continue
        peer_ms, answers = each(peer, some)
        cells.append(f"{peer_ms:10.1f}{own_ms / peer_ms:9.4f}{(np.array(answers) / own[: len(some)]).max():10.6f}")
    if slow:
        inequality = Inequality(blocks)
        inequality.bound(M[0], 0.5)  # cvxpy's own compilation is not counted
        peer_ms, answers = each(lambda m: inequality.bound(m, 2e-4), M[:slow])
        ratio = own[:slow] / np.array(answers)
        cells.append(f"{peer_ms:10.0f}{own_ms / peer_ms:10.5f}{ratio.max():12.6f}")
    else:
        cells.append(f"{'-':>10s}{'-':>10s}{'-':>12s}")
    return "".join(cells) + f"{wrong:7d}"


def main(count: int = 20) -> None:
    upper_bounds(np.array([[[0, 2], [1, 1j]]]), as_blocks([[-1, 0]] * 2))  # imports and compilation are not timed
    print(heading("robustlab", "numpy", "slycot", "cvxpy-base", "clarabel", "numba"))
    print(f"CPU ms per random complex matrix, batch of {count},")
    print("one thread; time: ours / peer; bound: largest peer / ours, for the LMI largest ours / optimum (to 2e-4);")
    print("wrong: bounds of ours below a verified lower bound, or not proved by their D, G")
    print(
        f"\n{'':20s}{'ours ms':>9s}{'ab13md':>10s}{'time':>9s}{'bound':>10s}{'dkpy':>10s}{'time':>9s}{'bound':>10s}"
        f"{'cvxpy':>10s}{'time':>10s}{'ours/LMI':>12s}{'wrong':>7s}"
    )
    for case in CASES:
        print(line(*case, count), flush=True)


if __name__ == "__main__":
    with one_thread():  # spinning threads of a busy machine would be counted as work
        main()
