"""Models and claims of the checker's tests, and the truth about them by dense search in floating point."""

import numpy as np
from scipy.optimize import minimize_scalar

from robustlab.verification import Claim, check


def model(seed, n, m, p, dt=0.0, margin=0.1):
    rng = np.random.default_rng(seed)
    A, B, C, D = (rng.standard_normal(s) for s in ((n, n), (n, m), (p, n), (p, m)))
    if n:
        eig = np.linalg.eigvals(A)
        A = A * (1 - margin) / np.abs(eig).max() if dt else A - (eig.real.max() + margin) * np.eye(n)
    return {"A": A, "B": B, "C": C, "D": D, "dt": np.array(float(dt))}


def response(G, w):
    A, B, C, D = (G[x] for x in "ABCD")
    if np.isinf(w) or not len(A):
        return D + 0j
    s = np.exp(1j * w * G["dt"]) if G["dt"] else 1j * w
    return D + C @ np.linalg.solve(s * np.eye(len(A)) - A, B)


def norm(G, points=3000):
    """The H-infinity norm of a stable model to about 1e-13, by a dense grid and a search around its best points."""

    def gain(w):
        return float(np.linalg.norm(response(G, w), 2))

    dt = float(G["dt"])
    size = np.abs(np.linalg.eigvals(G["A"])) if len(G["A"]) else np.ones(1)
    grid = (
        np.linspace(0, np.pi / dt, points)
        if dt
        else np.unique(np.r_[0, np.geomspace(size.min() / 100, size.max() * 100, points), size])
    )
    values = np.array([gain(w) for w in grid])
    best = max(values.max(), 0.0 if dt else gain(np.inf))
    for i in np.argsort(-values)[:3]:
        around = grid[max(i - 1, 0)], grid[min(i + 1, len(grid) - 1)]
        best = max(
            best, -minimize_scalar(lambda w: -gain(w), bounds=around, method="bounded", options={"xatol": 0}).fun
        )
    return best


def claimed(kind, *parts, **more):
    numbers = {}
    for part in parts:
        numbers |= part
    return Claim(kind, numbers | {k: np.array(v) for k, v in more.items()})


def outcome(kind, *parts, effort=20_000, **more):
    return check(claimed(kind, *parts, **more), effort=effort).outcome.value


def bounded_real_solution(G, gamma):
    """A strict solution of the bounded real inequality, from scipy's Riccati solvers with a part added to C'C."""
    from scipy.linalg import solve_continuous_are, solve_discrete_are

    A, B, C, D = (G[x] for x in "ABCD")
    n, m = B.shape
    more = 1e-9 * np.eye(n)
    solver = solve_discrete_are if G["dt"] else solve_continuous_are
    P = -solver(A, B, -(C.T @ C + more), gamma**2 * np.eye(m) - D.T @ D, s=-C.T @ D)
    return (P + P.T) / 2


STRUCTURES = {
    "full": [[2, 2, 3], [2, 1, 1]],
    "complex": [[1, 1, 1], [1, 2, 2]],
    "real": [[0, 1, 1], [0, 1, 1], [0, 2, 2]],
    "repeated real": [[0, 3, 3]],
    "mixed": [[0, 2, 2], [1, 1, 1], [2, 2, 1], [0, 1, 1]],
}


def rows_of_mussv(blocks):
    return [[-r, 0] if kind == 0 else [r, 0] if kind == 1 else [r, c] for kind, r, c in blocks]


def sizes(blocks):
    """(q, p) of Delta."""
    return sum(b[1] for b in blocks), sum(b[2] for b in blocks)


def delta_norms(blocks, delta):
    result, row, col = [], 0, 0
    for _, r, c in blocks:
        result.append(np.linalg.norm(delta[row : row + r, col : col + c], 2))
        row, col = row + r, col + c
    return np.array(result)


def interval_numbers(margin):
    """The intervals of a margin's proof with their scalings, and the largest level that they prove."""
    pieces = sorted(margin.proof, key=lambda piece: piece.low)
    assert len({piece.members for piece in pieces}) == 1  # all blocks are one coupled whole
    numbers = {"low": [p.low for p in pieces], "high": [p.high for p in pieces]}
    parts = {"D_w": [p.bound.Dw for p in pieces], "D_z": [p.bound.Dz for p in pieces], "G": [p.bound.G for p in pieces]}
    return {k: np.array(v) for k, v in (numbers | parts).items()}, max(p.beta for p in pieces)
