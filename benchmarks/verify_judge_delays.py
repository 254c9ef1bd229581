"""The judge of `verify_attack` for loops with exact delays and for weights of delays; nothing of the checker.

Floating point looks for what breaks a claim (a root on the right from the points of the axis where the characteristic
matrix is nearly singular, a gain, a delay that is not covered), 60 digits confirm it.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from mpmath import mp
from verify_exact import Quad, eye, gain_above, is_stable, long, positive, rational, solve, star

Numbers = dict[str, Any]
DELAYED = ("delayed-stable", "delayed-norm", "delayed-mu", "delay-weight")
POINTS = 1000  # frequencies that are looked at
STARTS = 12  # of Newton's steps for roots
NEWTON = 60
POLISHED = 40  # steps of a golden section
FULL = 2


def judged(kind: str, numbers: Numbers, proved: bool, loop: Quad | None = None) -> str:
    """What is wrong with the answer; empty where nothing was found. ``loop``: the model, where it is put together."""
    if kind == "delay-weight":
        word = _of_weight(numbers)
        if proved:
            return word
        return "" if word.startswith("false") else "unconfirmed: the counterexample was not found again"
    G = loop if loop is not None else tuple(rational(numbers[x]) for x in "ABCD")
    exact, floats = tuple(long(X) for X in G), tuple(X.astype(float) for X in G)
    delays = np.asarray(numbers["delays"], dtype=float)
    grid = _grid(floats, delays)
    root = _root_on_the_right(exact, floats, delays, grid) if len(delays) else not is_stable(G[0], 0.0)
    if not proved:
        if root or (kind == "delayed-norm" and _gain_at(exact, delays, numbers["frequency"], numbers["gamma"])):
            return ""
        return "unconfirmed: the counterexample was not found again"
    if root:
        return "false: a root on the right"
    if kind == "delayed-norm":
        w = _highest(floats, delays, grid, lambda M: float(np.linalg.norm(M, 2)))
        return "false: a larger gain" if _gain_at(exact, delays, w, numbers["gamma"]) else ""
    return _of_forms(numbers, exact, floats, delays, grid) if kind == "delayed-mu" else ""


def _grid(G: Any, delays: Any) -> Any:
    """Frequencies about the poles, and along the turns of the delays."""
    sizes = np.abs(np.linalg.eigvals(G[0])) if len(G[0]) else np.ones(1)
    far = 30 * max(
        float(sizes.max(initial=0.0)), float(np.abs(G[1]).max(initial=0.0) * np.abs(G[2]).max(initial=0.0)), 1.0
    )
    turns = np.linspace(0, 60, POINTS) / max(float(delays.max(initial=0.0)), 1e-3)
    return np.unique(np.concatenate([[0.0], np.geomspace(1e-4, far, POINTS), turns]))


def _characteristic(G: Any, delays: Any, s: Any, exp: Any) -> Any:
    A, B, C, D = G
    n, k = len(A), len(delays)
    F = np.block([[-A, -B[:, :k]], [-C[:k], -D[:k, :k]]]).astype(object if exp is mp.exp else complex)
    for i in range(n):
        F[i, i] = F[i, i] + s
    for i, tau in enumerate(delays.tolist()):
        F[n + i, n + i] = F[n + i, n + i] + exp(s * tau)
    return F


def _response(G: Any, delays: Any, w: Any, long_: bool) -> Any:
    _, B, C, D = G
    k = len(delays)
    s, exp, solver = (mp.mpc(0, w), mp.exp, solve) if long_ else (1j * w, np.exp, np.linalg.solve)
    F = _characteristic(G, delays, s, exp)
    right = np.vstack([B[:, k:], D[:k, k:]])
    return D[k:, k:] + np.hstack([C[k:], D[k:, :k]]).dot(solver(F, right))


def _stack(G: Any, delays: Any, grid: Any) -> Any:
    F = np.repeat(_characteristic(G, delays, 0.0, np.exp)[None], len(grid), axis=0)
    own, late = range(len(G[0])), range(len(G[0]), len(G[0]) + len(delays))
    F[:, own, own] += 1j * grid[:, None]
    F[:, late, late] += np.exp(1j * grid[:, None] * delays) - 1
    return F


def _root_on_the_right(exact: Any, floats: Any, delays: Any, grid: Any) -> bool:
    """Whether Newton's steps find a root of det F with a real part above zero, or on the axis, in 60 digits."""
    F = _stack(floats, delays, grid)
    if not F.shape[1]:
        return False
    least = np.linalg.svd(F, compute_uv=False)[:, -1]
    inner = [i for i in range(len(grid)) if (i == 0 or least[i] <= least[i - 1]) and
             (i == len(grid) - 1 or least[i] <= least[i + 1])]  # fmt: skip
    starts = sorted(inner, key=lambda i: least[i])[:STARTS]
    size = float(np.abs(F).max())
    shifts = (0.0, 0.3, 3.0)
    points = [complex(x * (1 + abs(grid[i])), grid[i]) for i in starts for x in shifts] + [1e-2, 1e-1, 1.0, size]
    points += [r * np.exp(1j * angle) for r in np.geomspace(1e-2, 30.0, 8) for angle in (0.0, 0.4, 0.8, 1.2, 1.5)]
    return any(_newton(exact, floats, delays, complex(s)) for s in points)


def _newton(exact: Any, floats: Any, delays: Any, s: complex) -> bool:
    """By doubles first, then in 60 digits; a root counts where its real part is not below zero for certain."""
    weight = np.concatenate([np.ones(len(floats[0])), delays])

    def step(G: Any, s: Any, exp: Any) -> Any:
        F = _characteristic(G, delays, s, exp)
        rate = [1] * len(G[0]) + [tau * exp(s * tau) for tau in delays.tolist()]
        inverse = solve(F, np.array(eye(len(F)) * (mp.mpf(1) if exp is mp.exp else 1.0)))
        slope = sum(inverse[i, i] * r for i, r in enumerate(rate))
        return 1 / slope

    for _ in range(NEWTON):
        try:
            with np.errstate(all="ignore"):
                F = _characteristic(floats, delays, s, np.exp)
                slope = np.trace(np.linalg.inv(F) @ np.diag(weight * np.concatenate(
                    [np.ones(len(floats[0])), np.exp(s * delays)])))  # fmt: skip
                change = 1 / slope
        except np.linalg.LinAlgError:
            break
        if not np.isfinite(change) or abs(s - change) > 1e6 or (s - change).real * delays.max(initial=0.0) > 300:
            return False
        s = s - change
        if abs(change) < 1e-13 * (1 + abs(s)):
            break
    else:
        return False
    if s.real < -1e-6 * (1 + abs(s)):
        return False
    root = mp.mpc(s)
    for _ in range(8):
        try:
            change = step(exact, root, mp.exp)
        except ZeroDivisionError:
            break
        root -= change
        if abs(change) < mp.mpf(10) ** -40:
            break
    else:
        return False
    return mp.re(root) > -(mp.mpf(10) ** -35)


def _gain_at(exact: Any, delays: Any, w: Any, gamma: Any) -> bool:
    try:
        return gain_above(_response(exact, delays, mp.mpf(float(w)), True), mp.mpf(float(gamma)))
    except ZeroDivisionError:
        return True


def _highest(G: Any, delays: Any, grid: Any, size: Any) -> float:
    """Where a function of the response is largest on the grid, polished."""

    def at(w: float) -> float:
        try:
            return size(_response(G, delays, w, False))
        except np.linalg.LinAlgError:
            return math.inf

    values = [at(w) for w in grid[:: max(1, len(grid) // 2000)]]
    thin = grid[:: max(1, len(grid) // 2000)]
    i = int(np.argmax(values))
    return _polished(at, float(thin[max(i - 1, 0)]), float(thin[min(i + 1, len(thin) - 1)]), float(thin[i]))


def _polished(at: Any, a: float, b: float, best: float) -> float:
    ratio, ends = (math.sqrt(5) - 1) / 2, (a, b)
    for _ in range(POLISHED):
        left, right = b - ratio * (b - a), a + ratio * (b - a)
        if at(left) > at(right):
            b = right
        else:
            a = left
    return max((*ends, best, (a + b) / 2), key=at)


def _of_forms(numbers: Numbers, exact: Any, floats: Any, delays: Any, grid: Any) -> str:
    """Structure of the scalings, and the forms at points of their intervals: those of least room in 60 digits."""
    table = np.asarray(numbers["blocks"]).tolist()
    level = np.broadcast_to(numbers["level"], (len(table),)).tolist()
    L = np.diag([x for (_, rows, _), x in zip(table, level, strict=True) for _ in range(rows)])
    reached, worst = 0.0, []
    for i, (a, b) in enumerate(zip(numbers["low"].tolist(), numbers["high"].tolist(), strict=True)):
        if b <= reached and i:
            continue
        a, reached = max(a, reached), max(b, reached)
        D_w, D_z, X = (np.asarray(numbers[x][i]) for x in ("D_w", "D_z", "G"))
        if not _fits(table, D_w, D_z, X):
            return f"unjustified: scalings of interval {i} have not the structure"
        if not positive(long(D_w)):
            return f"unjustified: D_w of interval {i} is not positive definite"
        inside = grid[(grid >= a) & (grid <= b)]
        for w in [a, *inside[:: max(1, len(inside) // 60)].tolist(), *([b] if math.isfinite(b) else [])]:
            M = _response(floats, delays, w, False)
            XM = X @ M
            F = L @ D_w @ L - M.conj().T @ D_z @ M - 1j * (XM - XM.conj().T)
            worst.append((float(np.linalg.eigvalsh(F / np.abs(L @ D_w @ L).max())[0]), i, w))
    for _, i, w in sorted(worst)[:2]:
        D_w, D_z, X = (long(np.asarray(numbers[x][i])) for x in ("D_w", "D_z", "G"))
        M, L_ = _response(exact, delays, mp.mpf(w), True), long(L)
        XM = X.dot(M)
        F = L_.dot(D_w).dot(L_) - star(M).dot(D_z).dot(M) - mp.mpc(0, 1) * (XM - star(XM))
        if not positive(F):
            return f"unjustified: the form of interval {i} is not positive definite at {w} rad/s"
    return ""


def _fits(table: Any, D_w: Any, D_z: Any, G: Any) -> bool:
    """Whether the scalings have the structure of the blocks, to the last bit."""
    D_w, D_z, G = (np.array(X, dtype=complex) for X in (D_w, D_z, G))
    row = col = 0
    for kind, rows, cols in table:
        w, z = slice(row, row + rows), slice(col, col + cols)
        a, b, g = D_w[w, w].copy(), D_z[z, z].copy(), G[w, z].copy()
        if kind == FULL:
            good = a[0, 0].imag == 0 and (a == a[0, 0] * np.eye(rows)).all() and (b == a[0, 0] * np.eye(cols)).all()
        else:
            good = (a == b).all() and (a == a.conj().T).all()
        if not good or not ((g == g.conj().T).all() if kind == 0 else not g.any()):
            return False
        D_w[w, w], D_z[z, z], G[w, z] = 0, 0, 0
        row, col = row + rows, col + cols
    return not (D_w.any() or D_z.any() or G.any())


# --- weights ---------------------------------------------------------------------------------------------------------


def _of_weight(numbers: Numbers) -> str:
    """A weight that was proved: R stable in rationals, frequencies and delays that may break it in 60 digits."""
    R, W = (tuple(rational(numbers[f"{which}_{x}"]) for x in "ABCD") for which in "RW")
    if not is_stable(R[0], 0.0):
        return "false: R is not stable"
    low, high = (float(x) for x in numbers["range"])
    epsilon = float(numbers.get("tolerance", 0.0))
    r, w = (tuple(X.astype(float) for X in G) for G in (R, W))
    grid = np.geomspace(1e-9, 1e4, POINTS) / max(high, 1e-300)
    taus = np.linspace(low, high, 9)
    sides = np.stack([_on_grid(r, grid), _on_grid(w, grid)])

    def share(omega: Any, R_at: Any, W_at: Any) -> Any:
        missed = np.abs(np.exp(-1j * np.multiply.outer(omega, taus)) - np.asarray(R_at)[..., None]) ** 2
        return missed.max(axis=-1) / (np.abs(W_at) ** 2 + epsilon**2 + 1e-300)

    def farthest(omega: float) -> float:
        return float(share(omega, _at(r, omega), _at(w, omega)))

    places = [0.0]
    for i in np.argsort(-np.nan_to_num(share(grid, *sides), nan=-1.0))[:3].tolist():
        places.append(_polished(farthest, grid[max(i - 1, 0)], grid[min(i + 1, len(grid) - 1)], grid[i]))
    for omega in places:
        R_at, W_at = (_at(tuple(map(long, G)), mp.mpf(omega), True) for G in (R, W))
        for tau in taus.tolist():
            missed = abs(mp.exp(mp.mpc(0, -mp.mpf(omega) * mp.mpf(tau))) - R_at)
            if missed**2 > abs(W_at) ** 2 + mp.mpf(epsilon) ** 2:
                return f"false: a delay of {tau} s is not covered at {omega} rad/s"
    return ""


def _on_grid(G: Any, grid: Any) -> Any:
    A, B, C, D = G
    if not len(A):
        return np.full(len(grid), complex(D[0, 0]))
    F = 1j * grid[:, None, None] * np.eye(len(A)) - A
    return D[0, 0] + (C @ np.linalg.solve(F, np.broadcast_to(B, (len(grid), *B.shape))))[:, 0, 0]


def _at(G: Any, omega: Any, exactly: bool = False) -> Any:
    A, B, C, D = G
    if not len(A):
        return D[0, 0]
    F = (long(np.eye(len(A))) * mp.mpc(0, omega) if exactly else 1j * omega * np.eye(len(A))) - A
    return D[0, 0] + C.dot((solve if exactly else np.linalg.solve)(F, B))[0, 0]


__all__ = ["DELAYED", "judged"]
