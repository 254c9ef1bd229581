"""Structured perturbations judged in ball arithmetic: scalings that prove a bound, singular Deltas, unstable members.

Nothing of robustlab is used here: blocks are rows of a structure of our own, Delta and M plain arrays.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from exact_loops import (
    Model,
    System,
    adjoint,
    exact,
    eye,
    is_positive,
    is_stable,
    system,
    upper_closed,
    with_precision,
)
from flint import acb, acb_mat, arb, arb_mat

Matrix = np.ndarray
# Largest distance of a returned Delta from a singular one, relative to its own size.
NEAR = 1e-8
AT_ONCE: dict[str, Any] = {"polish": False, "vectorized": True, "updating": "deferred"}  # differential evolution


class Part(NamedTuple):
    """A block of Delta: ``real`` or ``complex`` times the unit matrix, or ``full``; a real one fills [-below, 1]."""

    kind: str
    rows: int
    cols: int
    below: float = 1.0


def slices(parts: Sequence[Part]) -> list[tuple[slice, slice]]:
    """Rows and columns of Delta of each part."""
    ends = np.cumsum([(0, 0), *((p.rows, p.cols) for p in parts)], axis=0)
    return [(slice(a[0], b[0]), slice(a[1], b[1])) for a, b in pairwise(ends)]


def count(parts: Sequence[Part]) -> int:
    """Free real numbers in a Delta."""
    return sum({"real": 1, "complex": 2, "full": 2 * p.rows * p.cols}[p.kind] for p in parts)


def block_norm(parts: Sequence[Part], delta: Matrix) -> float:
    """Return the largest block norm; negative real numbers are divided by the range below nominal."""
    sizes = []
    for p, (w, z) in zip(parts, slices(parts), strict=True):
        block = delta[w, z]
        size = float(np.linalg.norm(block, 2))
        sizes.append(size / p.below if p.kind == "real" and block[0, 0].real < 0 else size)
    return max(sizes, default=0.0)


def assembled(parts: Sequence[Part], v: Matrix, radius: float, smooth: bool = False) -> Matrix:
    """Deltas (k, q, p) of at most this radius from free numbers (k, m): what is too large is cut, or, smooth, all of
    space is drawn into the ball, so that a descent knows its way everywhere.
    """
    q, p = sum(b.rows for b in parts), sum(b.cols for b in parts)
    delta = np.zeros((len(v), q, p), dtype=complex)
    at = 0

    def kept(size: Matrix) -> Matrix:
        return np.sqrt(1 + size**2) if smooth else np.maximum(1, size)

    for b, (w, z) in zip(parts, slices(parts), strict=True):
        if b.kind == "real":
            number = v[:, at] / kept(np.abs(v[:, at]))
            delta[:, w, z] = (number * np.where(number < 0, b.below, 1.0))[:, None, None] * np.eye(b.rows)
            at += 1
        elif b.kind == "complex":
            number = v[:, at] + 1j * v[:, at + 1]
            delta[:, w, z] = (number / kept(np.abs(number)))[:, None, None] * np.eye(b.rows)
            at += 2
        else:
            m = b.rows * b.cols
            block = (v[:, at : at + m] + 1j * v[:, at + m : at + 2 * m]).reshape(-1, b.rows, b.cols)
            delta[:, w, z] = block / kept(np.linalg.norm(block, 2, axis=(1, 2)))[:, None, None]
            at += 2 * m
    return radius * delta


def _tries(parts: Sequence[Part], rng: np.random.Generator, counts: tuple[int, int, int]) -> Matrix:
    """Free numbers (k, m): inside, at vertices, of any phase; all vertices of a few real numbers."""
    m = count(parts)
    tries = [rng.uniform(-1, 1, (counts[0], m)), np.sign(rng.standard_normal((counts[1], m)))]
    tries.append(rng.standard_normal((counts[2], m)) * 3)
    return np.concatenate([*tries, _vertices(m)]) if _all_real(parts) and m <= 7 else np.concatenate(tries)


def _vertices(m: int) -> Matrix:
    return 1.0 - 2.0 * ((np.arange(2**m)[:, None] >> np.arange(m)) & 1)


def _all_real(parts: Sequence[Part]) -> bool:
    return all(b.kind == "real" for b in parts)


def structure_holds(parts: Sequence[Part], delta: Matrix) -> bool:
    """Whether a Delta has exactly the structure of the blocks."""
    rest = np.array(delta, dtype=complex)
    for b, (w, z) in zip(parts, slices(parts), strict=True):
        block = rest[w, z]
        if b.kind != "full" and not np.array_equal(block, block[0, 0] * np.eye(b.rows)):
            return False
        if b.kind == "real" and block[0, 0].imag != 0:
            return False
        rest[w, z] = 0
    return not rest.any()


def scalings_fit(parts: Sequence[Part], Dw: Matrix, Dz: Matrix, G: Matrix) -> bool:
    """``D Delta = Delta D_z`` for every Delta, D, D_z, G Hermitian, G of real blocks only: bit by bit."""
    rest_w, rest_z, rest_g = (np.array(m, dtype=complex) for m in (Dw, Dz, G))
    for b, (w, z) in zip(parts, slices(parts), strict=True):
        first, second, g = Dw[w, w], Dz[z, z], rest_g[w, z]
        if b.kind == "full":
            d = first[0, 0]
            fits = np.array_equal(first, d * np.eye(b.rows)) and np.array_equal(second, d * np.eye(b.cols))
        else:
            fits = np.array_equal(first, second)
        if not fits or not np.array_equal(first, first.conj().T):
            return False
        if b.kind == "real":
            if not np.array_equal(g, g.conj().T):
                return False
            rest_g[w, z] = 0
        rest_w[w, w], rest_z[z, z] = 0, 0
    return not (rest_w.any() or rest_z.any() or rest_g.any())


def proves(M: Any, Dw: Matrix, Dz: Matrix, G: Matrix, beta: Any) -> bool:
    """``M^* D_z M + j (G M - M^* G^*) < L D L`` and ``D > 0``, proved in balls; M an array, or what gives it in balls.

    L is beta times the unit matrix, or beta has a level for each row of D.
    """

    def test() -> bool | None:
        m = acb_mat(exact(M)) if isinstance(M, np.ndarray) else M()
        supply = acb_mat(exact(G + 0j)) * m
        D, L = acb_mat(exact(Dw + 0j)), acb_mat(exact(np.diag(np.broadcast_to(beta, len(Dw)).astype(complex))))
        slack = L * D * L
        slack -= adjoint(m) * acb_mat(exact(Dz + 0j)) * m + (supply - adjoint(supply)) * acb(0, 1)
        return True if is_positive(slack) and is_positive(D) else None

    return bool(with_precision(test))


def distance_to_singular(M: Matrix, parts: Sequence[Part], delta: Matrix) -> tuple[float, Matrix]:
    """Change of Delta that Newton's method in 200 digits needs to make ``I - M Delta`` singular, over Delta's norm, and
    the Delta that it ends at; inf if it fails.
    """
    norm, plain = block_norm(parts, delta), [p._replace(below=1.0) for p in parts]

    def test() -> tuple[float, Matrix] | None:
        if (now := singular_next_to(M, parts, delta)) is None:
            return None
        end, change = (
            np.array([[complex(v) for v in row] for row in m.tolist()]) for m in (now, now - acb_mat(exact(delta + 0j)))
        )
        return block_norm(plain, change) / norm, end

    answer = with_precision(test)
    return answer if answer is not None else (float("inf"), delta)


def singular_next_to(M: Any, parts: Sequence[Part], delta: Matrix) -> acb_mat | None:
    """The Delta, to 20 digits and more, at which Newton's method ends that makes ``I - M Delta`` singular, or None."""
    norm, directions = block_norm(parts, delta), []
    for b, (w, z) in zip(parts, slices(parts), strict=True):
        entries = [(r, c) for r in range(w.start, w.stop) for c in range(z.start, z.stop)]
        if b.kind == "full":
            directions += [([e], f) for e in entries for f in (1, 1j)]
        else:
            diagonal = [(w.start + i, z.start + i) for i in range(b.rows)]
            directions += [(diagonal, f) for f in ((1,) if b.kind == "real" else (1, 1j))]
    m = acb_mat(exact(M + 0j)) if isinstance(M, np.ndarray) else M()
    now = acb_mat(exact(delta + 0j))
    unit = acb_mat(eye(m.nrows()))

    for _ in range(80):  # a double zero, as of a Jordan block, is halved only
        loop = unit - m * now
        try:
            near = (loop + unit * acb("1e-90")).inv()
        except ZeroDivisionError:
            return now
        table, largest = near.tolist(), max(abs(v).mid() for v in near.entries())
        if not largest.is_finite():
            return now
        # The inverse is nearly x y: x and y are the null directions, sharpened by one more product with it.
        u, _, vh = np.linalg.svd(np.array([[complex((v / largest).mid()) for v in row] for row in table]))
        x, y = _normalised(near * acb_mat(exact(u[:, :1]))), _normalised(acb_mat(exact(vh[:1])) * near)
        residual = (y * loop * x)[0, 0]
        yM, xs = (y * m).tolist()[0], [row[0] for row in x.tolist()]
        gains = [sum((yM[r] * xs[c] for r, c in entries), acb(0)) * acb(complex(f)) for entries, f in directions]
        scale = sum((abs(v).mid() for v in gains), arb(0))
        if abs(residual).mid() <= arb("1e-20") * arb(norm) * scale:
            return now
        g = [(v.real.mid(), v.imag.mid()) for v in gains]
        a = sum((p * p for p, _ in g), arb(0))
        b = sum((p * q for p, q in g), arb(0))
        c = sum((q * q for _, q in g), arb(0))
        r, i = residual.real.mid(), residual.imag.mid()
        determinant = a * c - b * b
        if determinant > arb("1e-30") * (a + c) ** 2:
            alpha, beta = (c * r - b * i) / determinant, (a * i - b * r) / determinant
        elif a + c > 0:  # all gains on one line: the residual must be on it, too
            alpha, beta = r / (a + c), i / (a + c)
        else:
            return None
        values = now.tolist()
        for (entries, f), (p, q) in zip(directions, g, strict=True):
            step = acb(complex(f)) * acb(p * alpha + q * beta)
            for row, col in entries:
                values[row][col] = (values[row][col] + step).mid()
        now = acb_mat(values)
    return None


def _normalised(v: acb_mat) -> acb_mat:
    """The vector over its largest entry."""
    return v * (acb(1) / max(v.entries(), key=lambda entry: abs(entry).mid()).mid())


def last_places(M: Matrix, delta: Matrix) -> float:
    """By how many times the spacing of floats the entries of M have to change for ``I - M Delta`` to be singular."""
    size = len(M)
    u, _, vh = np.linalg.svd(np.eye(size) - M @ delta)
    x, y = np.conj(vh[-1:]).T, u[:, -1:]
    loop = acb_mat(eye(size)) - acb_mat(exact(M + 0j)) * acb_mat(exact(delta + 0j))
    residual = float(abs((adjoint(acb_mat(exact(y + 0j))) * loop * acb_mat(exact(x + 0j)))[0, 0]).mid())
    change = float((np.abs(y).T @ np.abs(M) @ np.abs(delta) @ np.abs(x))[0, 0])
    return residual / (np.finfo(float).eps * change) if change else np.inf


def singular_inside(M: Matrix, parts: Sequence[Part], radius: float, rng: np.random.Generator) -> float | None:
    """Size of an exactly singular Delta within this radius that brute force finds, or None.

    M is of moderate size. All vertices of real numbers; the largest spectral radius of ``M Delta`` where every block is
    complex; least squares for an eigenvalue of one from random starts and from differential evolution.
    """
    from scipy.optimize import differential_evolution, least_squares, minimize

    m = count(parts)

    def eigenvalues(v: Matrix) -> Matrix:
        return np.linalg.eigvals(M @ assembled(parts, v, radius, smooth=True))

    def nearest(v: Matrix) -> Matrix:
        values = 1 - eigenvalues(v[None])[0]
        value = values[np.abs(values).argmin()]
        return np.array([value.real, value.imag])

    def smallest(v: Matrix) -> Matrix:
        return np.abs(1 - eigenvalues(v.T)).min(axis=1)

    met: list[Matrix] = []
    guesses = [3 * rng.standard_normal(m) for _ in range(3)]
    if _all_real(parts) and len(parts) <= 8:
        corners = assembled(parts, _vertices(len(parts)), radius)
        values = np.linalg.eigvals(M @ corners)
        best = np.where(np.abs(values.imag) <= 1e-13 * np.abs(values), values.real, 0.0).max(axis=1)
        k = int(best.argmax())
        if best[k] >= 1:
            met.append(corners[k] / best[k])
    if all(b.kind != "real" for b in parts):
        for guess in guesses[:2]:  # any phase can be turned away

            def size(v: Matrix) -> float:
                return -float(np.log(np.abs(eigenvalues(v[None])).max() + 1e-300))

            end = assembled(parts, minimize(size, guess, method="L-BFGS-B", options={"maxiter": 25}).x[None], radius)[0]
            values = np.linalg.eigvals(M @ end)
            value = values[np.abs(values).argmax()]
            if abs(value) >= 1:
                met.append(end / value)
    if m <= 8:
        guesses.append(differential_evolution(smallest, [(-4, 4)] * m, rng=rng, maxiter=20, popsize=6, **AT_ONCE).x)
    for guess in guesses:
        end = least_squares(nearest, guess, method="trf", max_nfev=25, xtol=1e-15, ftol=1e-15, gtol=1e-15)
        if np.hypot(*end.fun) <= 1e-9:
            met.append(assembled(parts, end.x[None], radius, smooth=True)[0])
    for delta in met:
        moved, at = distance_to_singular(M, parts, delta)
        size_at = block_norm(parts, at)
        if moved < 1e-3 and size_at < radius:
            return size_at
    return None


def member_is_stable(model: Any, delta: Matrix, factor: float = 1.0) -> bool:
    """Whether the model (or a System of it in rationals) closed by a multiple of Delta is well-posed, surely stable."""

    def test() -> bool | None:
        q, p = delta.shape
        if isinstance(model, Model):
            channels = system(Model(model.A, model.B[:, :q], model.C[:p], model.D[:p, :q], model.dt))
        else:
            channels = System(*map(arb_mat, model[:4]), model.discrete)
        loop = upper_closed(channels, exact(delta if np.imag(delta).any() else np.real(delta)) * arb(factor))
        return is_stable(loop.A, loop.discrete)

    return bool(with_precision(test))


def is_on_boundary(model: Model, parts: Sequence[Part], delta: Matrix, near: float) -> bool:
    """Whether Delta, changed in size by a share of at most ``near``, leaves no stable model."""
    if any(not member_is_stable(model, delta * (1 + s)) for s in (0.0, near, -near, near / 10, -near / 10)):
        return True
    q, p = delta.shape
    return bool(model.D.any()) and distance_to_singular(model.D[:p, :q], parts, delta)[0] <= near


def instability(model: Model, deltas: Matrix) -> Matrix:
    """How far the worst pole of each member is outside, relative to its size; negative inside."""
    q, p = deltas.shape[-2:]
    B, C, D = model.B[:, :q], model.C[:p], model.D[:p, :q]
    try:
        right = np.linalg.solve(np.eye(p) - D @ deltas, np.broadcast_to(C, (len(deltas), *C.shape)) + 0j)
        found = np.linalg.eigvals(model.A + B @ deltas @ right)
    except np.linalg.LinAlgError:
        return np.full(len(deltas), -1.0)
    if model.dt:
        return np.abs(found).max(axis=1) - 1
    return (np.real(found) / (np.abs(found) + 1e-300)).max(axis=1)


def unstable_inside(
    model: Model, parts: Sequence[Part], radius: float, rng: np.random.Generator, known: Matrix | None = None
) -> Matrix | None:
    """A Delta of at most this radius whose member is not stable, confirmed in balls, or None.

    Vertices, random points, a known Delta cut to the radius, differential evolution on the worst pole, and a descent
    from the best of them.
    """
    from scipy.optimize import differential_evolution, minimize

    if not len(model.A):
        return None
    m = count(parts)
    points = _tries(parts, rng, (60, 60, 30))

    def worst(v: Matrix) -> Matrix:
        return -instability(model, assembled(parts, v.T, radius))

    end = differential_evolution(worst, [(-1.2, 1.2)] * m, rng=rng, maxiter=25, popsize=5, **AT_ONCE)
    start = end.x if end.fun <= worst(points.T).min() else points[worst(points.T).argmin()]
    if m <= 8:
        start = minimize(lambda v: float(worst(v[:, None])[0]), start, method="Nelder-Mead", options={"maxfev": 200}).x
    points = np.vstack([start, end.x, points])
    deltas = assembled(parts, points, radius)
    if known is not None and (norm := block_norm(parts, known)) > 0:
        deltas = np.concatenate([known[None] * (radius / norm), deltas])
    values = instability(model, deltas)
    for k in np.argsort(-values)[:3]:
        if values[k] > -1e-6 and not member_is_stable(model, deltas[k]):
            return deltas[k]
    return None


def gain_inside(
    model: Model, parts: Sequence[Part], omega: Matrix, rng: np.random.Generator
) -> tuple[float, Matrix, float]:
    """Largest gain met by local search over Delta in the unit set at these frequencies: value, Delta, frequency.

    In floats: to choose which member is judged.
    """
    from scipy.optimize import minimize

    m = count(parts)
    q, p = sum(b.rows for b in parts), sum(b.cols for b in parts)
    points = _tries(parts, rng, (40, 60, 20))
    deltas = assembled(parts, points, 1.0)
    best = (-1.0, deltas[0], 0.0)
    tops: list[tuple[float, float, Matrix]] = []
    for w in omega:
        M = float_response(model, w)
        values = member_gains(M, deltas, q, p)
        k = int(np.argmax(values))
        tops.append((float(values[k]), float(w), points[k]))
    for value, w, v in sorted(tops, key=lambda t: -t[0])[:3]:
        M = float_response(model, w)

        def negative(x: Matrix, M: Matrix = M) -> float:
            return -float(member_gains(M, assembled(parts, x[None], 1.0), q, p)[0])

        end = minimize(negative, v, method="Nelder-Mead", options={"maxfev": 60 * m, "xatol": 1e-9, "fatol": 0})
        reached, x = (-end.fun, end.x) if -end.fun > value else (value, v)
        if reached > best[0]:
            best = reached, assembled(parts, x[None], 1.0)[0], w
    return best


def float_response(model: Model, omega: float) -> Matrix:
    if not len(model.A) or np.isinf(omega):
        return model.D + 0j
    s = np.exp(1j * omega * model.dt) if model.dt else 1j * omega
    return model.D + model.C @ np.linalg.solve(s * np.eye(len(model.A)) - model.A, model.B + 0j)


def member_gains(M: Matrix, deltas: Matrix, q: int, p: int) -> Matrix:
    """Gains of the members at one frequency, (k,); what is singular counts as nothing."""
    inner = np.eye(p) - M[:p, :q] @ deltas
    try:
        right = np.linalg.solve(inner, np.broadcast_to(M[:p, q:], (len(deltas), *M[:p, q:].shape)))
    except np.linalg.LinAlgError:
        return np.zeros(len(deltas))
    member = M[p:, q:] + M[p:, :q] @ deltas @ right
    size = np.abs(member).max(axis=(1, 2))
    ok = np.isfinite(size) & (size > 0)
    gains = np.zeros(len(deltas))
    gains[ok] = np.linalg.norm(member[ok] / size[ok, None, None], 2, axis=(1, 2)) * size[ok]
    return gains
