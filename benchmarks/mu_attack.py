"""An attack on every bound of mu and of the stability margin that robustlab gives, by code that shares none with it.

Per matrix: D, G prove the upper bound in 60-digit ball arithmetic (all leading minors positive); an exactly singular
Delta lies within 1e-8 of the one returned (Newton's method in 60 digits), or, as real mu jumps, is the one returned for
an M whose entries differ in their last bit; brute force (least squares from random starts, differential evolution, all
vertices) finds no singular Delta inside the proved ball.

Per model: no Delta inside the proved margin has an unstable pole (vertices, random points, differential evolution on
the spectral abscissa), the critical Delta has a pole on or beyond the boundary in 60 digits, and D, G prove every
sampled frequency of the intervals that they claim. Brute force at a 1 % smaller ball than the lower bound's tells how
often that one can be beaten.

``python benchmarks/mu_attack.py [share]`` needs python-flint; a share of 0.2 runs every fifth case.
"""

from __future__ import annotations

import sys
import warnings
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from flint import acb, acb_mat, arb, ctx
from mu_models import PUBLISHED, random_matrices, random_model, structure

import robustlab as rl
from robustlab.budget import MILLION, Budget
from robustlab.errors import NoTrustworthyNumber
from robustlab.mu_analysis.intervals import cover_axis
from robustlab.statespace import StateSpaceModel
from robustlab.uncertainty.blocks import Block, ComplexScalar, FullBlock, RealScalar, as_blocks, block_slices

ctx.dps = 60
Matrix = np.ndarray
SHARED = Path(__file__).resolve().parents[2] / "shared" / "data" / "compleib.h5"


# --- cases -----------------------------------------------------------------------------------------------------------


def matrices() -> Iterator[tuple[str, Matrix, list[Block]]]:
    """Random and nasty matrices."""
    kinds = ("real", "real x2", "real M", "mixed", "mixed x2", "mixed full", "complex", "complex x2", "full", "wide")
    for kind in kinds:
        for n in (4, 5, 6, 8):
            for m in random_matrices(kind, n, 3, 100):
                yield f"random {kind}", m, structure(kind, n)
    for seed in range(4):
        rng = np.random.default_rng([seed, 7])
        for kind in ("real", "real x2", "mixed", "mixed full", "complex", "complex x2", "wide"):
            m = random_matrices(kind, 6, 1, 200 + seed)[0]
            blocks = structure(kind, 6)
            p, q = m.shape
            scale_z, scale_w = 10 ** rng.uniform(-6, 6, p), 10 ** rng.uniform(-6, 6, q)
            yield "scaled over 12 decades", m * scale_z[:, None] / (scale_w if p != q else scale_z)[None, :], blocks
            u, s, vh = np.linalg.svd(m, full_matrices=False)
            yield "nearly singular", (u * 10.0 ** -np.linspace(0, 12, len(s))) @ vh, blocks
            yield "rank one", np.outer(m[:, 0], m[0]), blocks
            low = np.tril(np.ones((p, q)), -1) + 10.0 ** -rng.integers(1, 9) * np.triu(np.ones((p, q)))
            yield "non-normal", m * np.where(low < 1, low, 10.0 ** rng.uniform(0, 5)), blocks
            yield "reducible", m * np.triu(np.ones((p, q))), blocks
            yield "sparse", m * (rng.random((p, q)) < 0.4), blocks
            yield "real M of any kind", m.real + 0j, blocks
            yield "nearly real M", m.real + 1j * 10.0 ** -rng.integers(3, 14) * m.imag, blocks
            yield "integers", np.round(3 * m.real) + 1j * np.round(3 * m.imag), blocks
            yield "tiny or huge", m * 10.0 ** (150 * (-1) ** seed), blocks
            if p == q:
                yield "Hermitian", m + m.conj().T, blocks
                yield "unitary", np.linalg.qr(m)[0], blocks
                yield "imaginary", 1j * (m.real + m.real.T), blocks
                jordan = np.eye(p) * rng.choice([1.0, -1.0, 1j]) + np.eye(p, k=1)
                t = rng.standard_normal((p, p))
                yield "defective", t @ jordan @ np.linalg.inv(t), blocks
        a = rng.uniform(0.5, 2)
        for eps in (0.0, 1e-14, 1e-9, 1e-3):
            # mu jumps from a to 0 where the eigenvalue leaves the real axis
            yield "jump of real mu", np.array([[a + 1j * eps]]), as_blocks([[-1, 0]])
            yield "jump of real mu", np.array([[0, a], [1 + 1j * eps, 0]]), as_blocks([[-2, 0]])
            yield "jump of real mu", np.array([[a, a], [-a, a * (1 + 1j * eps)]]), as_blocks([[-1, 0]] * 2)
        for repeats in (3, 4):
            m = rng.standard_normal((repeats + 2, repeats + 2)) + 1j * rng.standard_normal((repeats + 2, repeats + 2))
            yield "repeated often", m, as_blocks([[-repeats, 0], [2, 0]])
            yield "repeated often", m.real + 0j, as_blocks([[-repeats, 0], [-2, 0]])
    rows = [[-1 + 6j, 2 - 3j, 3 + 8j, 3 + 8j, -5 - 9j, -6 + 2j], [4 + 2j, -2 + 5j, -6 - 7j, -4 + 11j, 8 - 7j, 12 - 1j]]
    rows.append([5 - 4j, -4 - 8j, 1 - 3j, -6 + 14j, 2 - 5j, 4 + 16j])
    yield "SLICOT's example", np.array(rows * 2), as_blocks([[-1, 0], [-1, 0], [2, 2], [1, 0], [1, 0]])


def models() -> Iterator[tuple[str, StateSpaceModel, list[Block]]]:
    """Random and nasty models, continuous and discrete."""
    for name, make in PUBLISHED.items():
        yield (name, *make())
    for seed in range(4):
        for kind, n in (("real", 4), ("real x2", 6), ("mixed", 4), ("mixed full", 6), ("complex", 3), ("full", 4)):
            yield f"random {kind}", *random_model(6, structure(kind, n), (0.05, 0.7), seed)
        yield "lightly damped", *random_model(8, structure("real", 4), (1e-4, 1e-2), seed)
        model, blocks = random_model(6, structure("real", 4), (0.05, 0.7), 50 + seed)
        rng = np.random.default_rng([seed, 8])
        t = 10 ** rng.uniform(-5, 5, 6)
        s = 10 ** rng.uniform(-4, 4, 4)
        yield (
            "badly scaled",
            StateSpaceModel(
                model.A * t[:, None] / t, model.B * t[:, None] / s, model.C / t * s[:, None], model.D * s[:, None] / s
            ),
            blocks,
        )
        yield (
            "slow and fast",
            StateSpaceModel(
                np.block([[model.A, np.zeros((6, 2))], [np.zeros((2, 6)), np.diag([-1e-5, -1e5])]]),
                np.vstack([model.B, np.ones((2, 4)) * [[1e-3], [1e2]]]),
                np.hstack([model.C, np.ones((4, 2)) * [1e-3, 1e2]]),
                model.D,
            ),
            blocks,
        )
        a = -np.eye(5) * rng.uniform(0.1, 1) + np.eye(5, k=1)
        B, C = rng.standard_normal((5, 3)), rng.standard_normal((3, 5))
        yield "defective A", StateSpaceModel(a, B, C, np.zeros((3, 3))), structure("real", 3)
        # x'' = (1 + d1) u, u = -(k + d2) x - (c + d3) v
        k, c = rng.uniform(0.5, 4), rng.uniform(0.1, 2)
        A = np.array([[0, 1], [-k, -c]])
        B = np.array([[0, 0, 0], [1, -1, -1]], dtype=float)
        C = np.array([[-k, -c], [0.5 * k, 0], [0, 0.5 * c]]) * 1.0
        D = np.array([[0, -1, -1], [0, 0, 0], [0, 0, 0]], dtype=float) * 0.3
        yield "double integrator, closed", StateSpaceModel(A, B * 0.3, C, D), structure("real", 3)
        yield (
            "no states",
            StateSpaceModel(np.zeros((0, 0)), np.zeros((0, 4)), np.zeros((4, 0)), rng.standard_normal((4, 4))),
            structure("real", 4),
        )
        A = rng.standard_normal((5, 5))
        A = A / np.abs(np.linalg.eigvals(A)).max() * rng.uniform(0.6, 0.99)
        for kind in ("real", "mixed"):
            B, C = rng.standard_normal((5, 4)), rng.standard_normal((4, 5))
            yield "discrete", StateSpaceModel(A, B, C, 0.1 * rng.standard_normal((4, 4)), dt=0.1), structure(kind, 4)
    if SHARED.exists():
        yield from _compleib()


def _compleib() -> Iterator[tuple[str, StateSpaceModel, list[Block]]]:
    """Stable plants of COMPleib with real changes of up to four entries of A, and an unknown feedback u = Delta y."""
    import h5py

    with h5py.File(SHARED) as file:
        for name in file:
            A, B, C = (np.array(file[name][key]) for key in ("A", "B", "C"))
            n = len(A)
            if n > 10 or np.linalg.eigvals(A).real.max() > -1e-6:
                continue
            largest = np.dstack(np.unravel_index(np.argsort(-np.abs(A).ravel())[:4], A.shape))[0]
            E = np.zeros((n, 4))
            F = np.zeros((4, n))
            for i, (r, c) in enumerate(largest):
                E[r, i], F[i, c] = 0.3 * A[r, c], 1.0
            yield "COMPleib, entries of A", StateSpaceModel(A, E, F, np.zeros((4, 4))), structure("real", 4)
            feedback = FullBlock("k", B.shape[1], len(C))
            yield "COMPleib, feedback", StateSpaceModel(A, B, C, np.zeros((len(C), B.shape[1]))), [feedback]


# --- 60 digits -------------------------------------------------------------------------------------------------------


def exact(a: Any) -> acb_mat:
    """The matrix of the very numbers that the floats are."""
    return acb_mat([[acb(float(v.real), float(v.imag)) for v in row] for row in np.atleast_2d(np.asarray(a, complex))])


def adjoint(a: acb_mat) -> acb_mat:
    return a.transpose().conjugate()


def is_positive(n: acb_mat) -> bool:
    """All leading minors of the Hermitian part are positive, radii of the balls included."""
    size = n.nrows()
    h = (n + adjoint(n)) * acb(0.5)
    table = h.tolist()
    # Sylvester's criterion by elimination without pivoting: the pivots are the ratios of the minors.
    for k in range(size):
        pivot = table[k][k].real
        if not pivot > 0:
            return False
        for i in range(k + 1, size):
            factor = table[i][k] / pivot
            for j in range(k + 1, size):
                table[i][j] -= factor * table[k][j]
    return True


def inequality(M: acb_mat, Dw: Matrix, Dz: Matrix, G: Matrix, beta: float) -> acb_mat:
    product = exact(G) * M
    j = acb(0, 1)
    supply = adjoint(M) * exact(Dz) * M + (product - adjoint(product)) * j
    return exact(Dw) * acb(arb(float(beta)) ** 2) - supply


def scalings_fit(blocks: list[Block], Dw: Matrix, Dz: Matrix, G: Matrix) -> bool:
    """D commutes with every Delta, and G is Hermitian and belongs to real blocks only."""
    rng = np.random.default_rng(0)
    delta = random_delta(blocks, rng)
    d_fits = np.abs(Dw @ delta - delta @ Dz).max() <= 1e-9 * max(np.abs(Dw).max(), np.abs(Dz).max())
    rest = np.array(G, dtype=complex)
    for block, (w, z) in zip(blocks, block_slices(blocks), strict=True):
        part = rest[w, z]
        if isinstance(block, RealScalar) and np.array_equal(part, part.conj().T):
            rest[w, z] = 0
    return bool(d_fits and not rest.any())


def distance_to_singular(M: acb_mat, blocks: list[Block], delta: Matrix) -> float:
    """Largest block of the change that Newton's method in 60 digits needs, over Delta's norm; inf if it fails."""
    directions = []
    for block, (w, z) in zip(blocks, block_slices(blocks), strict=True):
        entries = [(r, c) for r in range(w.start, w.stop) for c in range(z.start, z.stop)]
        if isinstance(block, FullBlock):
            directions += [([e], f) for e in entries for f in (1, 1j)]
        else:
            diagonal = [(w.start + i, z.start + i) for i in range(block.repeats)]
            directions += [(diagonal, f) for f in ((1,) if isinstance(block, RealScalar) else (1, 1j))]
    size = M.nrows()
    eye = acb_mat([[int(i == j) for j in range(size)] for i in range(size)])
    now = exact(delta)
    norm = block_norm(blocks, delta)
    for _ in range(12):
        loop = eye - M * now
        try:
            tiny = acb("1e-55")
            inverse = (loop + eye * tiny).inv()
        except ZeroDivisionError:
            return _moved(now, delta, blocks) / norm
        table = np.array([[complex(v) for v in row] for row in (inverse).tolist()])
        if not np.isfinite(table).all():
            return _moved(now, delta, blocks) / norm
        # The inverse is nearly x y: x and y are the null directions, sharpened by one more product with it.
        u, _, vh = np.linalg.svd(table / np.abs(table).max())
        x, y = normalised(inverse * exact(u[:, :1])), normalised(exact(vh[:1]) * inverse)
        residual = (y * loop * x).tolist()[0][0]
        yM = (y * M).tolist()[0]
        xs = [row[0] for row in x.tolist()]
        gains = [sum((yM[r] * xs[c] for r, c in entries), acb(0)) * acb(complex(f)) for entries, f in directions]
        if abs(complex(residual)) <= 1e-25 * norm * sum(abs(complex(v)) for v in gains):
            return _moved(now, delta, blocks) / norm
        g = [(v.real.mid(), v.imag.mid()) for v in gains]
        a = sum((p * p for p, _ in g), arb(0))
        b = sum((p * q for p, q in g), arb(0))
        c = sum((q * q for _, q in g), arb(0))
        r, i = residual.real.mid(), residual.imag.mid()
        determinant = a * c - b * b
        if determinant > arb(1e-30) * (a + c) ** 2:
            alpha, beta = (c * r - b * i) / determinant, (a * i - b * r) / determinant
        else:
            # All gains on one line: the residual has to lie on it too.
            along = a + c
            alpha, beta = (r / along, i / along) if along > 0 else (arb(0), arb(0))
            if not along > 0:
                return float("inf")
        values = now.tolist()
        for (entries, f), (p, q) in zip(directions, g, strict=True):
            step = acb(complex(f)) * acb(p * alpha + q * beta)
            for row, col in entries:
                values[row][col] = (values[row][col] + step).mid()
        now = acb_mat(values)
    return float("inf")


def last_places(M: Matrix, delta: Matrix) -> float:
    """By how many times the spacing of floats the entries of M have to change for ``I - M Delta`` to be singular."""
    eye = np.eye(len(M))
    u, _, vh = np.linalg.svd(eye - M @ delta)
    x, y = np.conj(vh[-1:]).T, u[:, -1:]
    residual = abs(complex((adjoint(exact(y)) * (exact(eye) - exact(M) * exact(delta)) * exact(x)).tolist()[0][0]))
    change = (np.abs(y).T @ np.abs(M) @ np.abs(delta) @ np.abs(x))[0, 0]
    return float(residual / (np.finfo(float).eps * change))


def normalised(v: acb_mat) -> acb_mat:
    """The vector over its largest entry."""
    largest = max((entry for row in v.tolist() for entry in row), key=lambda entry: abs(complex(entry)))
    return v * (acb(1) / largest)


def _moved(now: acb_mat, delta: Matrix, blocks: list[Block]) -> float:
    change = np.array([[complex(v) for v in row] for row in (now - exact(delta)).tolist()])
    return block_norm(blocks, change)


# --- brute force -----------------------------------------------------------------------------------------------------


def block_norm(blocks: list[Block], delta: Matrix) -> float:
    return max(float(np.linalg.norm(delta[w, z], 2)) for w, z in block_slices(blocks))


def random_delta(blocks: list[Block], rng: np.random.Generator) -> Matrix:
    return assembled(blocks, rng.standard_normal((1, count(blocks))) * 2, 1.0)[0]


def count(blocks: list[Block]) -> int:
    sizes = {RealScalar: lambda b: 1, ComplexScalar: lambda b: 2, FullBlock: lambda b: 2 * b.rows * b.cols}
    return sum(sizes[type(b)](b) for b in blocks)


def assembled(blocks: list[Block], v: Matrix, radius: float) -> Matrix:
    """Deltas (k, q, p) of at most this radius from free numbers (k, m): what is too large is cut."""
    q, p = sum(b.rows for b in blocks), sum(b.cols for b in blocks)
    delta = np.zeros((len(v), q, p), dtype=complex)
    at = 0
    for block, (w, z) in zip(blocks, block_slices(blocks), strict=True):
        if isinstance(block, RealScalar):
            delta[:, w, z] = np.clip(v[:, at], -1, 1)[:, None, None] * np.eye(block.repeats)
            at += 1
        elif isinstance(block, ComplexScalar):
            number = v[:, at] + 1j * v[:, at + 1]
            delta[:, w, z] = (number / np.maximum(1, np.abs(number)))[:, None, None] * np.eye(block.repeats)
            at += 2
        else:
            m = block.rows * block.cols
            part = (v[:, at : at + m] + 1j * v[:, at + m : at + 2 * m]).reshape(-1, block.rows, block.cols)
            size = np.linalg.norm(part, 2, axis=(1, 2))
            delta[:, w, z] = part / np.maximum(1, size)[:, None, None]
            at += 2 * m
    return radius * delta


def breaks(M: Matrix, blocks: list[Block], radius: float, rng: np.random.Generator, starts: int = 6) -> bool:
    """Whether brute force finds a Delta of at most this radius that makes ``I - M Delta`` singular to 1e-11."""
    from scipy.optimize import differential_evolution, least_squares

    m, eye = count(blocks), np.eye(len(M))

    def nearest(v: Matrix) -> Matrix:
        values = np.linalg.eigvals(eye - M @ assembled(blocks, v[None], radius)[0])
        value = values[np.abs(values).argmin()]
        return np.array([value.real, value.imag])

    def smallest(v: Matrix) -> Matrix:
        loops = eye - M @ assembled(blocks, v.T, radius)
        return np.linalg.svd(loops, compute_uv=False)[:, -1]

    if all(isinstance(b, RealScalar) for b in blocks) and len(blocks) <= 8:
        bits = 1.0 - 2.0 * ((np.arange(2 ** len(blocks))[:, None] >> np.arange(len(blocks))) & 1)
        values = np.linalg.eigvals(M @ assembled(blocks, bits, radius))
        if (np.abs(values.imag) <= 1e-13 * np.abs(values)).any() and (
            values.real[np.abs(values.imag) <= 1e-13 * np.abs(values)].max() >= 1
        ):
            return True
    guesses = [rng.uniform(-1, 1, m) * 1.2 for _ in range(starts)]
    if m <= 8:
        found = differential_evolution(
            smallest,
            [(-1.2, 1.2)] * m,
            maxiter=30,
            popsize=6,
            polish=False,
            vectorized=True,
            updating="deferred",
            rng=rng,
        )
        guesses.append(found.x)
    for guess in guesses:
        end = least_squares(nearest, guess, method="trf", max_nfev=30, xtol=1e-15, ftol=1e-15, gtol=1e-15)
        if np.hypot(*end.fun) <= 1e-11 and smallest(end.x[:, None])[0] <= 1e-11:
            return True
    return False


# --- verdicts --------------------------------------------------------------------------------------------------------


def attack_matrix(M: Matrix, blocks: list[Block], rng: np.random.Generator) -> list[str]:
    """What is wrong with the bounds of one matrix, and what came out."""
    try:
        bounds = rl.mu(M, blocks)
    except NoTrustworthyNumber:
        return ["refused"]
    words = []
    size = float(np.abs(M).max()) or 1.0
    M_exact, upper = exact(M), bounds.upper
    if upper > 0:
        fits = scalings_fit(blocks, bounds.D, bounds.D_z, bounds.G)
        if not (fits and is_positive(inequality(M_exact, bounds.D, bounds.D_z, bounds.G, upper))):
            words.append("WRONG: D, G do not prove the upper bound")
    # An upper bound of zero says that nothing is singular: a ball as large as sensible is tried.
    radius = (1 - 1e-7) / upper if upper > 0 else 1e3 / size
    if upper < np.inf and breaks(M, blocks, radius, rng):
        words.append("WRONG: a singular Delta inside the proved ball")
    if bounds.lower > 0:
        if bounds.lower > upper:
            words.append("WRONG: lower above upper")
        moved = distance_to_singular(M_exact, blocks, bounds.delta)
        norm = block_norm(blocks, bounds.delta)
        if moved > 1e-8 and last_places(M, bounds.delta) <= 1.01:
            words.append("singular for M with other last bits")
            moved = 0.0
        if not (moved <= 1e-8 and abs(norm * bounds.lower - 1) <= 2e-8):
            words.append(f"WRONG: Delta is not singular to within its claim ({moved:.1e})")
        if bounds.lower < 0.99 * upper and breaks(M, blocks, 0.99 / bounds.lower, rng):
            words.append("beaten by 1 %")
    elif upper > 0:
        words.append("no Delta found")
        if breaks(M, blocks, 100 / upper, rng):
            words.append("beaten: brute force found one")
    return words


def attack_model(model: StateSpaceModel, blocks: list[Block], rng: np.random.Generator) -> list[str]:
    """What is wrong with the margin of one model, and what came out."""
    try:
        margin = rl.robust_stability(rl.UncertainModel(model, blocks), accuracy=0.01, time_limit=15.0, omega=[0.0])
    except NoTrustworthyNumber:
        return ["refused"]
    words = [] if margin.status is rl.Status.CERTIFIED else [str(margin.status)]
    if margin.lower > margin.upper * (1 + 1e-8):
        words.append("WRONG: proved margin above an attained one")
    inside = min(margin.lower * (1 - 1e-6), 1e3)
    if margin.lower > 0 and unstable_inside(model, blocks, inside, rng):
        words.append("WRONG: an unstable Delta inside the proved margin")
    if np.isfinite(margin.upper):
        delta = np.asarray(rl_delta(blocks, margin.delta))
        if abs(block_norm(blocks, delta) / margin.upper - 1) > 1e-8 or not on_boundary(model, blocks, delta):
            words.append("WRONG: the critical Delta leaves the model stable")
        if margin.upper > margin.lower * 1.01 and unstable_inside(model, blocks, margin.upper * 0.99, rng):
            words.append("beaten by 1 %")
    if not model.is_discrete and model.n_states and not intervals_hold(model, blocks, rng):
        words.append("WRONG: D, G do not prove a frequency of their interval")
    return words


def rl_delta(blocks: list[Block], values: Any) -> Matrix:
    delta = np.zeros((sum(b.rows for b in blocks), sum(b.cols for b in blocks)), dtype=complex)
    for block, (w, z) in zip(blocks, block_slices(blocks), strict=True):
        delta[w, z] = values[block.name] if isinstance(block, FullBlock) else values[block.name] * np.eye(block.repeats)
    return delta


def closed(model: StateSpaceModel, delta: Matrix) -> Matrix:
    loop = np.eye(delta.shape[-1]) - model.D @ delta
    return model.A + model.B @ delta @ np.linalg.solve(
        loop, np.broadcast_to(model.C, (*delta.shape[:-2], *model.C.shape))
    )


def unstable_inside(model: StateSpaceModel, blocks: list[Block], radius: float, rng: np.random.Generator) -> bool:
    """Vertices, random points and differential evolution on the abscissa; a finding is confirmed in 60 digits."""
    from scipy.optimize import differential_evolution

    m = count(blocks)

    def worst(v: Matrix) -> Matrix:
        deltas = assembled(blocks, v.T, radius)
        if not model.n_states:
            return np.linalg.svd(np.eye(deltas.shape[-1]) - model.D @ deltas, compute_uv=False)[:, -1] - 1e-12
        poles = np.linalg.eigvals(closed(model, deltas))
        return 1 - np.abs(poles).max(axis=1) if model.is_discrete else -poles.real.max(axis=1)

    tries = [rng.uniform(-1, 1, (200, m)), np.sign(rng.standard_normal((100, m))), rng.standard_normal((100, m)) * 3]
    if all(isinstance(b, RealScalar) for b in blocks) and m <= 8:
        tries.append(1.0 - 2.0 * ((np.arange(2**m)[:, None] >> np.arange(m)) & 1))
    points = np.concatenate(tries)
    found = differential_evolution(
        worst, [(-1.2, 1.2)] * m, maxiter=40, popsize=6, polish=False, vectorized=True, updating="deferred", rng=rng
    )
    points = np.vstack([points, found.x])
    values = worst(points.T)
    for k in np.argsort(values)[:3]:
        delta = assembled(blocks, points[k][None], radius)[0]
        if values[k] < 0 and (not model.n_states or exactly_unstable(model, delta)):
            return True
    return False


def exactly_unstable(model: StateSpaceModel, delta: Matrix) -> bool:
    """Whether a pole lies right of the boundary, by the eigenvalues of the exact closed loop in 60 digits."""
    D, d = exact(model.D), exact(delta)
    size = D.nrows()
    eye = acb_mat([[int(i == j) for j in range(size)] for i in range(size)])
    a = exact(model.A) + exact(model.B) * d * (eye - D * d).inv() * exact(model.C)
    try:
        poles = a.eig(algorithm="approx")
    except (ValueError, ArithmeticError):
        return True
    return any(bool(abs(p).mid() > 1) if model.is_discrete else bool(p.real.mid() > 0) for p in poles)


def on_boundary(model: StateSpaceModel, blocks: list[Block], delta: Matrix) -> bool:
    """Whether Delta, enlarged by 1e-8, has a pole on or beyond the boundary, or makes the loop ill-posed."""
    D = exact(model.D)
    if model.D.any() and distance_to_singular(D, blocks, delta) <= 1e-8:
        return True
    if not model.n_states:
        return False
    return any(exactly_unstable(model, delta * (1 + s)) for s in (1e-8, -1e-8, 1e-7))


def intervals_hold(model: StateSpaceModel, blocks: list[Block], rng: np.random.Generator) -> bool:
    """D and G of every interval of a cover of the axis prove random frequencies in it, in 60 digits."""
    first = np.unique(np.abs(model.poles()))
    cover = cover_axis(model, blocks, 0.0, first=first[first > 0], budget=Budget(5 * MILLION), accuracy=0.01)
    n = model.n_states
    for piece in cover.pieces[:12]:
        high = piece.high if np.isfinite(piece.high) else 1e3 * max(piece.low, float(first.max(initial=1.0)))
        ends = [piece.low, high] if piece.low > 0 else [high]
        for omega in [*ends, *rng.uniform(piece.low, high, 2), np.sqrt(max(piece.low, 1e-6 * high) * high)]:
            resolvent = acb_mat([[acb(0, float(omega)) * int(i == j) for j in range(n)] for i in range(n)]) - exact(
                model.A
            )
            M = exact(model.C) * resolvent.inv() * exact(model.B) + exact(model.D)
            bound = piece.bound
            if not is_positive(inequality(M, bound.Dw, bound.Dz, bound.G, piece.beta)):
                return False
    return True


def main(share: float = 1.0) -> None:
    """Print one line per group of cases, and every case with something wrong."""
    warnings.simplefilter("ignore")
    tally: dict[str, Counter[str]] = {}
    cases: list[tuple[Any, ...]] = [(attack_matrix, *c) for c in matrices()] + [(attack_model, *c) for c in models()]
    step = max(1, round(1 / share))
    for k, (attack, name, subject, blocks) in enumerate(cases):
        if k % step:
            continue
        rng = np.random.default_rng([k, 99])
        try:
            words = attack(subject, blocks, rng)
        except Exception as error:  # noqa: BLE001 - whatever it is, it is told and the campaign goes on
            words = [f"WRONG: {type(error).__name__} {error}"]
        group = tally.setdefault(("matrix: " if attack is attack_matrix else "model: ") + name, Counter())
        group["cases"] += 1
        group.update(w.split("(")[0].strip() for w in words)
        for word in words:
            if word.startswith("WRONG"):
                print(f"case {k} ({name}): {word}", flush=True)
    report(tally)


def report(tally: dict[str, Counter[str]]) -> None:
    """One line per group, and their sum."""
    print(f"{'group':60s} cases  wrong  refused  beaten  other")
    total: Counter[str] = Counter()
    for name, group in tally.items():
        wrong = sum(v for key, v in group.items() if key.startswith("WRONG"))
        beaten = sum(v for key, v in group.items() if key.startswith("beaten"))
        rest = {key: v for key, v in group.items() if not key.startswith(("WRONG", "beaten", "cases", "refused"))}
        print(f"{name:60s} {group['cases']:5d} {wrong:6d} {group['refused']:8d} {beaten:7d}  {rest or ''}")
        total.update(cases=group["cases"], wrong=wrong, refused=group["refused"], beaten=beaten)
    print(f"{'all':60s} {total['cases']:5d} {total['wrong']:6d} {total['refused']:8d} {total['beaten']:7d}")


if __name__ == "__main__":
    main(float(sys.argv[1]) if len(sys.argv) > 1 else 1.0)
