"""Claims for `verify_attack`: true ones of every kind, with evidence from the library, and what mutations make of them.

A true claim is a kind with its datasets, and hints: Deltas next to which its statement is about to break.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import numpy as np

import robustlab as rl
from robustlab.evidence import claims_of
from robustlab.mu_analysis import worst_case_gain
from robustlab.mu_analysis.matrix.branch_and_bound import Box, box_matrices, box_model
from robustlab.norms.claims import band_scalings, gramian_claims, loop_numbers, matrices, norm_matrix
from robustlab.uncertainty.blocks import delta_matrix

Rng = np.random.Generator
Numbers = dict[str, Any]
SAMPLE_TIMES = (0.01, 0.1, 1.0, 0.3)


class Case(NamedTuple):
    """A claim, and Deltas that nearly break it."""

    kind: str
    numbers: Numbers
    hints: tuple[Any, ...] = ()


def states(rng: Rng, most: int = 4) -> int:
    """Mostly 0 to ``most``, some 8."""
    return 8 if most == 4 and rng.random() < 0.04 else int(rng.integers(0, most + 1))


def model(rng: Rng, n: int, m: int, p: int, dt: float | None = None) -> rl.StateSpaceModel:
    """A stable model: ordinary, lightly damped, nonnormal, or with a repeated pole; a third are discrete."""
    if dt is None:
        dt = 0.0 if rng.random() < 0.65 else float(rng.choice(SAMPLE_TIMES))
    A = rng.normal(size=(n, n))
    kind = rng.integers(0, 5)
    if kind == 1:  # lightly damped pairs
        for i in range(0, n - 1, 2):
            w, damping = 10 ** rng.uniform(-1, 1), 10 ** rng.uniform(-4, -1)
            A[i : i + 2] = 0
            A[i : i + 2, i : i + 2] = [[-damping * w, w], [-w, -damping * w]]
    elif kind == 2:
        A = np.triu(A) * 10 ** rng.uniform(-1, 1)
    elif kind == 3:  # defective
        A = np.eye(n, k=1) - np.eye(n)
    if n:
        values = np.linalg.eigvals(A)
        if dt:
            A = A * (1 - 10 ** rng.uniform(-3, -0.3)) / max(np.abs(values).max(), 1e-3)
        elif kind != 3 and (kind != 1 or values.real.max() >= 0):
            A = A - (values.real.max() + 10 ** rng.uniform(-2, 0)) * np.eye(n)
    B, C = rng.normal(size=(n, m)), rng.normal(size=(p, n))
    D = rng.normal(size=(p, m)) * 0.3 * (rng.random() < 0.6)
    return rl.StateSpaceModel(A, B, C, D, dt)


def gain(G: rl.StateSpaceModel) -> float:
    return float(rl.peak_gain(G).upper)


def slack(rng: Rng) -> float:
    """By how much more a level is claimed than what was found."""
    return 1 + 10 ** rng.uniform(-8, -1)


def _claim(found: Any, *kinds: str) -> Numbers | None:
    """The datasets of the first claim of a result, of these kinds where any are given."""
    return next((dict(c.numbers) for c in claims_of(found) if not kinds or c.kind in kinds), None)


def _case(kind: str, numbers: Numbers | None, *hints: Any) -> Case | None:
    return None if numbers is None else Case(kind, numbers, hints)


def stable_case(rng: Rng) -> Case:
    G = model(rng, states(rng), 1, 1)
    numbers: Numbers = {"A": G.A, "dt": np.array(float(G.dt))}
    if G.n_states and rng.random() < 0.7:
        numbers["P"] = lyapunov(G.A, bool(G.dt))
    return Case("stable", numbers)


def lyapunov(A: Any, discrete: bool) -> Any:
    """P with A'P + PA + I = 0, discrete A'PA - P + I = 0, by Kronecker's product."""
    n, one = len(A), np.eye(len(A))
    system = np.eye(n * n) - np.kron(A.T, A.T) if discrete else -np.kron(A.T, one) - np.kron(one, A.T)
    P = np.linalg.solve(system, one.ravel()).reshape(n, n)
    return (P + P.T) / 2


def norm_case(rng: Rng) -> Case | None:
    G = model(rng, states(rng), int(rng.integers(1, 4)), int(rng.integers(1, 4)))
    found = rl.peak_gain(G)
    numbers = _claim(found)
    if numbers is None:
        return None
    if rng.random() < 0.5:  # the frequency route, or a P for another level
        level = float(found.upper) * slack(rng)
        numbers["gamma"] = np.array(level)
        numbers.pop("P", None)
        numbers.pop("P_low", None)
        numbers |= norm_matrix(G, level, float(found.upper)) if rng.random() < 0.3 else {}
    if rng.random() < 0.3 and np.isfinite(found.frequency):
        numbers["frequency"] = np.array(float(found.frequency))
    return Case("norm", numbers)


def loop_norm_case(rng: Rng) -> Case | None:
    y, u = int(rng.integers(1, 3)), int(rng.integers(1, 3))
    P, K = plant_and_controller(rng, 3, u + int(rng.integers(1, 3)), y + int(rng.integers(1, 3)), y, u)
    if rng.random() < 0.3:
        D = P.D.copy()
        D[-y:, -u:] = 0
        try:
            found = rl.hinf(rl.StateSpaceModel(P.A, P.B, P.C, D, P.dt), y, u)
        except rl.RobustlabError:
            return None
        return _case("loop-norm", _claim(found))
    numbers = loop_numbers(P, K)
    G = closed(P, K, y, u)
    level = gain(G) * slack(rng)
    if not np.isfinite(level) or level <= 0:
        return None
    proof = norm_matrix(G, level, gain(G)) if rng.random() < 0.7 else {}
    return Case("loop-norm", numbers | {"gamma": np.array(level)} | proof)


def closed(P: rl.StateSpaceModel, K: rl.StateSpaceModel, y: int, u: int) -> rl.StateSpaceModel:
    m, p = P.n_inputs - u, P.n_outputs - y
    N = np.linalg.inv(np.eye(y) - P.D[p:, m:] @ K.D)
    Y = [N @ P.C[p:], N @ P.D[p:, m:] @ K.C, N @ P.D[p:, :m]]
    U = [K.D @ Y[0], K.C + K.D @ Y[1], K.D @ Y[2]]
    B2, D12 = P.B[:, m:], P.D[:p, m:]
    A = np.block([[P.A + B2 @ U[0], B2 @ U[1]], [K.B @ Y[0], K.A + K.B @ Y[1]]])
    B = np.vstack([P.B[:, :m] + B2 @ U[2], K.B @ Y[2]])
    return rl.StateSpaceModel(A, B, np.hstack([P.C[:p] + D12 @ U[0], D12 @ U[1]]), P.D[:p, :m] + D12 @ U[2], P.dt)


def bounded_real_case(rng: Rng) -> Case | None:
    """A norm of a model, a loop or a difference, by P alone."""
    case = (norm_case, loop_norm_case, difference_case)[rng.integers(3)](rng)
    return None if case is None or "P" not in case.numbers else Case("bounded-real", case.numbers)


def difference_case(rng: Rng, banded: bool = False) -> Case | None:
    """The norm of a difference; ``banded``: its gain over a band, as a claim of mu."""
    G = model(rng, states(rng, 3), int(rng.integers(1, 3)), int(rng.integers(1, 3)))
    if rng.random() < 0.5:
        H = rl.StateSpaceModel(G.A, G.B * (1 + 1e-3 * rng.normal()), G.C, G.D, G.dt)
    else:
        H = model(rng, int(rng.integers(0, 3)), G.n_inputs, G.n_outputs, float(G.dt))
    zero = np.zeros((G.n_states, H.n_states))
    E = rl.StateSpaceModel(np.block([[G.A, zero], [zero.T, H.A]]), np.vstack([G.B, H.B]), np.hstack([G.C, -H.C]),
                           G.D - H.D, G.dt)  # fmt: skip
    level = gain(E) * slack(rng)
    if not 0 < level < np.inf:
        return None
    numbers = {**matrices(G, "{}1"), **matrices(H, "{}2"), "dt": np.array(float(G.dt))}
    if banded:
        band = tuple(np.sort(10 ** rng.uniform(-2, np.log10(3 / G.dt) if G.dt else 2, 2)).tolist())
        return Case("mu-axis", {**numbers, "level": np.array(level), **band_scalings(G.n_inputs, G.n_outputs, band)})
    proof = norm_matrix(E, level, gain(E)) if rng.random() < 0.7 else {}
    return Case("difference-norm", {**numbers, "gamma": np.array(level), **proof})


def gramian_case(rng: Rng) -> Case | None:
    if rng.random() < 0.3:
        y, u = int(rng.integers(1, 3)), int(rng.integers(1, 3))
        P, K = plant_and_controller(rng, 2, u + int(rng.integers(1, 3)), y + int(rng.integers(1, 3)), y, u)
        D = P.D.copy()
        D[:-y, :-u] = 0
        D[:-y, -u:] *= rng.random() < 0.3 and P.dt > 0
        P = rl.StateSpaceModel(P.A, P.B, P.C, D, P.dt)
        G = closed(P, K, y, u)
        if (np.linalg.eigvals(G.A).real < -1e-9).all() or P.dt:
            claims = gramian_claims(G, float(rl.h2_norm(G).value))
            kept = {x: v for x, v in (claims[0].numbers.items() if claims else ()) if x not in "ABCD"}
            return Case("gramian", kept | loop_numbers(P, K)) if claims else None
    G = model(rng, max(1, states(rng)), int(rng.integers(1, 3)), int(rng.integers(1, 3)))
    if not G.dt:
        G = rl.StateSpaceModel(G.A, G.B, G.C, 0 * G.D, 0.0)
    claims = gramian_claims(G, float(rl.h2_norm(G).value))
    return Case("gramian", dict(claims[0].numbers)) if claims else None


STRUCTURES = (
    [[0, 1, 1]], [[0, 2, 2]], [[0, 1, 1], [0, 1, 1]], [[0, 2, 2], [0, 1, 1]], [[1, 1, 1]], [[1, 2, 2]],
    [[1, 1, 1], [1, 1, 1]], [[1, 2, 2], [1, 1, 1]], [[2, 2, 2]], [[2, 1, 2]], [[2, 2, 1]], [[0, 1, 1], [1, 1, 1]],
    [[0, 1, 1], [2, 1, 2]], [[0, 2, 2], [2, 2, 1]], [[1, 1, 1], [2, 1, 2]], [[0, 1, 1], [1, 1, 1], [2, 1, 1]],
    [[0, 2, 2], [1, 1, 1]], [[0, 1, 1], [0, 1, 1], [0, 1, 1]], [[2, 1, 2], [2, 2, 1]], [[0, 1, 1], [1, 2, 2]],
)  # fmt: skip


def structure(rng: Rng) -> tuple[list[list[int]], int, int]:
    """Rows of a structure, and how many rows and columns its Delta has."""
    rows = STRUCTURES[rng.integers(len(STRUCTURES))]
    return rows, sum(row[1] for row in rows), sum(row[2] for row in rows)


def blocks_of(rows: Any, rng: Rng | None = None) -> list[Any]:
    """The library's blocks; with ``rng`` some real ones have a range that is not symmetric."""
    made: list[Any] = []
    for i, (kind, r, c) in enumerate(rows):
        name = f"b{i}"
        if kind == 0 and rng is not None and rng.random() < 0.7:
            below = 0.5 * float(rng.choice([0.5, 0.25, 0.75, 0.3]))
            made.append(rl.RealScalar(name, r, rl.ParameterRange(1.0, 0.5, "", below=below)))
        else:
            made.append(rl.RealScalar(name, r) if kind == 0 else rl.ComplexScalar(name, r) if kind == 1
                        else rl.FullBlock(name, r, c))  # fmt: skip
    return made


def matrix_case(rng: Rng, kind: str) -> Case | None:
    rows, q, p = structure(rng)
    M = rng.normal(size=(p, q)) + (1j * rng.normal(size=(p, q)) if rng.random() < 0.7 else 0.0)
    M = M * 10 ** rng.uniform(-2, 2)
    found = rl.mu(M, blocks_of(rows))
    claim = _claim(found, kind)
    if claim is None:
        return None
    numbers = {name: np.array(x) for name, x in claim.items()}
    if rng.random() < 0.3:  # levels of their own: channels of w in other units
        powers = 2.0 ** rng.integers(-2, 3, len(rows))
        each = np.repeat(powers, [row[1] for row in rows])
        numbers["M"] = numbers["M"] * each
        numbers["level"] = float(numbers["level"]) * powers
        for name in ("G", "delta"):
            if name in numbers:
                numbers[name] = numbers[name] * (each if name == "G" else 1 / each)[:, None]
    delta = np.reshape(found.delta, (q, p))
    if kind == "mu-upper" and rng.random() < 0.5:
        numbers["delta"] = delta if np.ndim(numbers["level"]) == 0 else delta / each[:, None]
    return Case(kind, numbers)


def matrix_boxes_case(rng: Rng) -> Case | None:
    """A bound of mu of a matrix by boxes: those of branch and bound, or others, of ranges that may be uneven."""
    rows, q, p = structure(rng)
    if not any(kind == 0 for kind, _, _ in rows):
        return None
    M = (rng.normal(size=(p, q)) + 1j * rng.normal(size=(p, q)) * (rng.random() < 0.7)) * 10 ** rng.uniform(-2, 2)
    plain = blocks_of(rows)
    if rng.random() < 0.3:
        found = rl.mu(M, plain, tolerance=1e-3, effort=0.1)
        if (numbers := _claim(found, "mu-upper-boxes")) is not None:
            return Case("mu-upper-boxes", numbers, (found.delta,))
    upper = float(rl.mu(M, plain).upper)
    if not 0 < upper < np.inf:
        return None
    blocks, size = blocks_of(rows, rng), (1 - 10 ** rng.uniform(-4, -0.5)) / upper
    ranges = np.array([b.interval or (-1.0, 1.0) for b in blocks], dtype=float)
    whole = [(size * a, size * b) if x.interval else (-1.0, 1.0) for x, (a, b) in zip(blocks, ranges, strict=True)]
    level = np.array([1.0 if b.interval else 1 / size for b in blocks])
    sides = [[]]
    for block, (a, b) in zip(blocks, whole, strict=True):
        cuts = [a, a + (b - a) * float(rng.choice([0.5, 0.37])), b] if block.interval and len(sides) < 4 else [a, b]
        sides = [[*old, side] for old in sides for side in itertools.pairwise(cuts)]
    parts: dict[str, list[Any]] = {name: [] for name in ("D_w", "D_z", "G")}
    for box in sides:
        centre = np.array([(x + y) / 2 if b.interval else 0.0 for b, (x, y) in zip(blocks, box, strict=True)])
        half = np.array([(y - x) / 2 if b.interval else size for b, (x, y) in zip(blocks, box, strict=True)])
        bound = rl.mu(box_matrices(M.astype(complex), blocks, [Box(centre, half)])[0], plain)
        if not bound.upper < 1:
            return None
        for name, X in zip(parts, (bound.D, bound.D_z, bound.G), strict=True):
            parts[name].append(X)
    count = len(sides)
    numbers = {"M": M, "blocks": np.array(rows, dtype=np.int64), "ranges": ranges, "size": np.array(size * (1 - 1e-12))}
    ends = {"level": level, "box": np.array(sides), "low": np.zeros(count), "high": np.full(count, np.inf)}
    return Case("mu-upper-boxes", numbers | ends | {name: np.array(x) for name, x in parts.items()})


def uncertain(rng: Rng, asymmetric: bool, performance: bool) -> rl.UncertainModel:
    """A small uncertain model, of which the set is mostly not far from instability."""
    rows, q, p = structure(rng)
    u, y = (int(rng.integers(1, 3)), int(rng.integers(1, 3))) if performance else (0, 0)
    G = model(rng, max(1, states(rng, 3)), q + u, p + y)
    if performance:
        inner = rl.StateSpaceModel(G.A, G.B[:, :q], G.C[:p], G.D[:p, :q], G.dt)
        size = min(1.0, 0.5 / max(gain(inner), 1e-3))
        B, D = G.B.copy(), G.D.copy()
        B[:, :q] *= size
        D[:, :q] *= size
        G = rl.StateSpaceModel(G.A, B, G.C, D, G.dt)
    return rl.UncertainModel(G, blocks_of(rows, rng if asymmetric else None))


def margin_case(rng: Rng, kind: str) -> Case | None:
    if kind == "mu-axis" and rng.random() < 0.3:
        return loop_margin_case(rng) if rng.random() < 0.7 else difference_case(rng, banded=True)
    set_of = uncertain(rng, kind == "mu-boxes", False)
    found = rl.robust_stability(set_of)
    hints = (np.asarray(delta_matrix(set_of.blocks, found.delta)),) if found.delta else ()
    numbers = to_the_end(_claim(found, kind))
    if numbers is None:
        return None
    if kind == "mu-axis":
        if rng.random() < 0.25:
            numbers = banded(numbers, rng)
        elif rng.random() < 0.4 and hints:
            numbers["delta"] = hints[0]
    if kind in ("mu-axis", "mu-boxes") and "band" not in numbers and len(numbers["A"]) and rng.random() < 0.3:
        numbers["P"] = lyapunov(numbers["A"], float(numbers["dt"]) > 0)
    if kind == "mu-boxes" and rng.random() < 0.5:
        return Case(kind, split_boxes(numbers, set_of, rng) or numbers, hints)
    return Case(kind, numbers, hints)


def loop_margin_case(rng: Rng) -> Case | None:
    """mu-axis of a plant whose Delta channels are left open and a controller, both as they are stored."""
    rows, q, p = structure(rng)
    y, u = int(rng.integers(1, 3)), int(rng.integers(1, 3))
    P, K = plant_and_controller(rng, 2, q + u, p + y, y, u)
    set_of = rl.UncertainModel(closed(P, K, y, u), blocks_of(rows))
    found = rl.robust_stability(set_of)
    numbers = to_the_end(_claim(found, "mu-axis"))
    if numbers is None:
        return None
    numbers = {x: v for x, v in numbers.items() if x not in "ABCD"}
    hints = (np.asarray(delta_matrix(set_of.blocks, found.delta)),) if found.delta else ()
    return Case("mu-axis", numbers | loop_numbers(P, K), hints)


def plant_and_controller(
    rng: Rng, n: int, m: int, p: int, y: int, u: int
) -> tuple[rl.StateSpaceModel, rl.StateSpaceModel]:
    """A stable plant and a controller with a loop gain of a half."""
    P = model(rng, max(1, states(rng, n)), m, p)
    K = model(rng, int(rng.integers(0, 3)), y, u, float(P.dt))
    size = 0.5 / max(gain(K) * gain(P), 1e-3)
    return P, rl.StateSpaceModel(K.A, K.B, K.C * size, K.D * size, K.dt)


def to_the_end(given: Numbers | None) -> Numbers | None:
    """A claim's datasets, with intervals that end at pi/dt but for rounding brought to infinity."""
    if given is None:
        return None
    numbers = {name: np.array(x) for name, x in given.items()}
    dt = float(numbers["dt"])
    if dt and "high" in numbers:
        numbers["high"] = np.where(numbers["high"] * dt >= np.pi * (1 - 1e-12), np.inf, numbers["high"])
        kept = numbers["low"] * dt < np.pi * (1 - 1e-12)
        numbers |= {x: numbers[x][kept] for x in ("low", "high", "D_w", "D_z", "G", "box") if x in numbers}
    return numbers


def banded(numbers: Numbers, rng: Rng) -> Numbers:
    """The same over a band within the axis."""
    ends = np.unique(np.concatenate([numbers["low"], numbers["high"][np.isfinite(numbers["high"])]]))
    a, b = sorted(rng.choice(ends, 2)) if len(ends) > 1 else (0.0, 1.0)
    if b <= a:
        b = a + 1.0
    kept = (numbers["high"] >= a) & (numbers["low"] <= b)
    cut = {name: numbers[name][kept] for name in ("low", "high", "D_w", "D_z", "G")}
    return numbers | cut | {"band": np.array([a, b])}


def split_boxes(numbers: Numbers, set_of: rl.UncertainModel, rng: Rng) -> Numbers | None:
    """The set, a little smaller, cut into boxes along its real parameters, each with scalings of its own."""
    rows, model_ = set_of.blocks, set_of.delta_channels
    size = float(numbers["size"]) * 0.9
    ends = [(size * a, size * b) for a, b in numbers["ranges"].tolist()]
    pieces: list[list[tuple[float, float]]] = [[]]
    for block, (a, b) in zip(rows, ends, strict=True):
        cut = block.interval and len(pieces) < 4 and rng.random() < 0.7
        middle = a + (b - a) * float(rng.choice([0.5, 0.37]))
        sides = [(a, middle), (middle, b)] if cut else [(a, b)]
        pieces = [[*old, side if block.interval else (-1.0, 1.0)] for old in pieces for side in sides]
    parts: dict[str, list[Any]] = {name: [] for name in ("box", "low", "high", "D_w", "D_z", "G")}
    inner = [rl.RealScalar(b.name, b.rows) if b.interval else b for b in rows]
    own = np.broadcast_to(numbers["level"], (len(rows),))
    for sides in pieces:
        # A little beyond, so that rounding leaves nothing open between a box and the set.
        wide = [(x - 1e-12, y + 1e-12) if b.interval else (x, y) for b, (x, y) in zip(rows, sides, strict=True)]
        centre = np.array([(x + y) / 2 if b.interval else 0.0 for b, (x, y) in zip(rows, wide, strict=True)])
        half = np.array([(y - x) / 2 if b.interval else 1 / v for b, (x, y), v in zip(rows, wide, own, strict=True)])
        seen = box_model(model_, rows, Box(centre, half))
        if seen is None:
            return None
        try:
            found = rl.robust_stability(rl.UncertainModel(seen, inner))
        except rl.RobustlabError:
            return None
        part = to_the_end(_claim(found, "mu-axis"))
        if part is None or found.lower < 1.0001:
            return None
        count = len(part["low"])
        parts["box"] += [wide] * count
        for name in ("low", "high", "D_w", "D_z", "G"):
            parts[name] += list(part[name])
    return numbers | {"size": np.array(size)} | {name: np.array(x) for name, x in parts.items()}


def gain_case(rng: Rng, kind: str) -> Case | None:
    set_of = uncertain(rng, kind == "worst-gain-boxes", True)
    try:
        found = worst_case_gain(set_of)
    except rl.RobustlabError:
        return None
    return _case(kind, to_the_end(_claim(found, kind)))


def set_case(rng: Rng) -> Case:
    """A set whose ends have doubles as entries: D11 is strictly triangular with small whole numbers."""
    n, q, m, p = int(rng.integers(0, 4)), int(rng.integers(0, 4)), int(rng.integers(1, 3)), int(rng.integers(1, 3))
    whole = rng.integers(-4, 5, size=(n + q + p, n + q + m)) / 4.0
    inner = slice(n, n + q)
    whole[inner, inner] = np.triu(whole[inner, inner], 1)
    kept = [*range(n), *range(n + q, n + q + p)], [*range(n), *range(n + q, n + q + m)]
    base = whole[np.ix_(*kept)]
    moved = base + whole[kept[0]][:, inner] @ np.linalg.solve(np.eye(q) - whole[inner, inner], whole[inner][:, kept[1]])
    blocks, left = [], q
    while left:
        r = int(rng.integers(1, left + 1))
        blocks.append([0, r, r])
        left -= r
    numbers: Numbers = {"A": whole[:n, :n], "B": whole[:n, n:], "C": whole[n:, :n], "D": whole[n:, n:]}
    for end, X in (("0", base), ("1", moved)):
        numbers |= {f"A{end}": X[:n, :n], f"B{end}": X[:n, n:], f"C{end}": X[n:, :n], f"D{end}": X[n:, n:]}
    numbers["blocks"] = np.array(blocks, dtype=np.int64).reshape(-1, 3)
    if rng.random() < 0.3:  # a member at parameters, met but for rounding
        delta = np.round(rng.uniform(-1, 1, len(blocks)), 2)
        each = np.repeat(delta, [rows for _, rows, _ in blocks])
        inside = whole[inner, inner] * each
        moved = base + whole[kept[0]][:, inner] * each @ np.linalg.solve(np.eye(q) - inside, whole[inner][:, kept[1]])
        numbers |= {"delta": delta, "ranges": np.tile([-1.0, 1.0], (len(blocks), 1)), "tolerance": np.array(1e-13)}
        numbers |= {"A1": moved[:n, :n], "B1": moved[:n, n:], "C1": moved[n:, :n], "D1": moved[n:, n:]}
    elif rng.random() < 0.3:
        numbers["tolerance"] = np.array(10 ** rng.uniform(-9, -2))
    return Case("set", numbers)


MAKERS: dict[str, Callable[[Rng], Case | None]] = {
    "stable": stable_case, "norm": norm_case, "bounded-real": bounded_real_case, "loop-norm": loop_norm_case,
    "difference-norm": difference_case, "gramian": gramian_case, "mu-upper-boxes": matrix_boxes_case, "set": set_case,
    **{kind: partial(matrix_case, kind=kind) for kind in ("mu-upper", "mu-lower")},
    **{kind: partial(margin_case, kind=kind) for kind in ("mu-axis", "mu-boxes", "unstable-member")},
    **{kind: partial(gain_case, kind=kind) for kind in ("worst-gain", "worst-gain-boxes")},
}  # fmt: skip
