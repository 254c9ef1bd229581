"""Whether what the checker answered is so: the judge of `verify_attack`. It uses nothing of `robustlab.verification`.

A claim that was proved is attacked twice. The statement: norms, stability and sets are decided in rationals; for a
bound of mu or of a gain a member is sought that breaks it (floating point seeks, 60 digits confirm). And the evidence:
coverings, structures, and the forms at sampled frequencies, in rationals or 60 digits. So an answer is *false* (a
counterexample is known) or *unjustified* (the evidence does not carry it, whether or not the statement is true).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from fractions import Fraction
from typing import Any, NamedTuple

import exact_loops as loops
import numpy as np
from exact_loops import Model, System, is_positive, joined, rational, system
from flint import fmpq, fmpq_mat
from mpmath import mp

import robustlab as rl

mp.dps = 60
Numbers = dict[str, Any]
REAL, COMPLEX, FULL = 0, 1, 2
ALLOWANCE = 1 + 1e-9
NORMS = ("norm", "bounded-real", "loop-norm", "difference-norm")
INSIDE = 1 - 1e-13  # by so much a member found in floating point is drawn in before it is judged
STEPS = 12  # of the ascent of a pole
STARTS = 4
SAMPLES = 60  # members drawn at random
POINTS = 9  # frequencies of an interval at which its form is looked at
NEWTON = 8
MULTIPLES = 25  # of a given Delta, of each sign, that are tried where the nearest ones are stable


class Part(NamedTuple):
    """A block of Delta: its kind, rows of w, columns of z, and the ends of a real number or the largest norm."""

    kind: int
    w: slice
    z: slice
    low: float
    high: float


def judge(kind: str, numbers: Numbers, proved: bool, hints: Sequence[Any] = (), seed: int = 0) -> str:
    """What is wrong with the answer; empty where nothing was found.

    ``proved``: the claim was proved, else it was refuted.
    ``hints``: Deltas next to which a counterexample may be.
    """
    rng = np.random.default_rng(seed)
    if kind in ("stable", *NORMS, "gramian"):
        return _of_norm(kind, numbers, proved)
    if kind == "set":
        return "" if _set_holds(numbers) == proved else "false: rationals say otherwise"
    if kind in ("mu-lower", "unstable-member"):
        found = _singular(numbers, ALLOWANCE) if kind == "mu-lower" else _unstable(numbers, ALLOWANCE)
        return "" if found else "unconfirmed: no such Delta was found"
    if kind == "mu-upper":
        found = _of_mu(numbers, rng)
        return found if proved else _confirmed(found.startswith("false") or _singular(numbers, 1.0))
    if kind == "mu-upper-boxes":
        return _of_matrix_boxes(kind, numbers) if proved else "unconfirmed: nothing can refute it"
    if not proved:
        unstable = not _stable(_system(numbers))
        return _confirmed(unstable or (kind in ("mu-axis", "worst-gain") and _unstable(numbers, 1.0, kind)))
    return _of_axis(kind, numbers, hints, rng)


def _confirmed(found: bool) -> str:
    return "" if found else "unconfirmed: the counterexample was not found again"


def _model(numbers: Numbers, name: str = "{}") -> System:
    parts = (numbers[name.format(x)] for x in "ABCD")
    return system(Model(*parts, abs(float(numbers.get("dt", 0.0)))), rational)


def _system(numbers: Numbers) -> System:
    """The model, the loop of a plant and a controller, or a difference."""
    if "P_A" in numbers:
        K = _model(numbers, "K_{}")
        if (K.D.ncols(), K.D.nrows()) != (int(numbers["n_meas"]), int(numbers["n_con"])):
            raise ValueError("a controller of other channels")
        return loops.closed(_model(numbers, "P_{}"), K)
    return _difference(numbers) if "A1" in numbers else _model(numbers)


def _difference(numbers: Numbers) -> System:
    G, H = _model(numbers, "{}1"), _model(numbers, "{}2")
    zero = fmpq_mat(G.A.nrows(), H.A.nrows())
    A = joined([[G.A, zero], [zero.transpose(), H.A]])
    return System(A, joined([[G.B], [H.B]]), joined([[G.C, H.C * -1]]), G.D - H.D, G.discrete)


def _stable(G: System) -> bool:
    return bool(loops.is_stable(G.A, G.discrete))


def _of_norm(kind: str, numbers: Numbers, proved: bool) -> str:
    if kind == "stable":
        holds = bool(loops.is_stable(rational(numbers["A"]), float(numbers["dt"]) != 0))
        return "" if holds == proved else "false: Routh's array says otherwise"
    build = {"norm": _model, "difference-norm": _difference}.get(kind, _system)
    try:
        G = build(numbers)
    except ZeroDivisionError:
        return "false: the loop is not well posed" if proved else ""
    stable = _stable(G)
    if kind == "gramian":
        holds = stable and (float(numbers["dt"]) > 0 or not any(v != 0 for v in G.D.entries()))
        holds = holds and h2_square(G) <= _fraction(numbers["value"]) ** 2
    else:
        holds = stable and loops.norm_is_below(G, _fraction(numbers["gamma"]))
    if holds == proved:
        return ""
    return f"false: {'a larger norm' if stable else 'not stable'}" if proved else "false: refuted although it is true"


def _fraction(x: Any) -> fmpq:
    return fmpq(*float(x).as_integer_ratio())


def _set_holds(numbers: Numbers) -> bool:
    sizes = np.asarray(numbers["blocks"])[:, 1].tolist()
    tolerance = _fraction(numbers.get("tolerance", 0.0))
    given = np.asarray(numbers["delta"]) if "delta" in numbers else np.ones(len(sizes))
    if "delta" in numbers and not all(a <= x <= b for (a, b), x in zip(numbers["ranges"], given, strict=True)):
        return False
    for end, delta in (("0", 0 * given), ("1", given)):
        try:
            member = loops.upper_closed(_model(numbers), rational(np.diag(np.repeat(delta, sizes))))
        except ZeroDivisionError:
            return False
        wanted = _model(numbers, f"{{}}{end}")
        if any(abs(x) > tolerance for X, Y in zip(member[:4], wanted[:4], strict=True) for x in (X - Y).entries()):
            return False
    return True


def _parts(numbers: Numbers, kind: str = "", allowance: float = 1.0) -> list[Part]:
    """The blocks with what they may be, in doubles."""
    table, levels = np.asarray(numbers["blocks"]).tolist(), _levels(kind, numbers)
    result, row, col = [], 0, 0
    for i, ((what, rows, cols), level) in enumerate(zip(table, levels, strict=True)):
        low, high = -allowance / level, allowance / level
        if kind.endswith("boxes") and what == REAL:
            size = 1.0 if kind.startswith("worst-gain") else float(numbers["size"])
            low, high = (size * float(x) for x in numbers["ranges"][i])
        result.append(Part(what, slice(row, row + rows), slice(col, col + cols), low, high))
        row, col = row + rows, col + cols
    return result


def _levels(kind: str, numbers: Numbers) -> list[float]:
    k = len(numbers["blocks"])
    if kind.startswith("worst-gain"):
        return [1.0] * (k - 1) + [float(numbers["gamma"])]
    return np.broadcast_to(numbers["level"], (k,)).tolist()


def _has_structure(parts: Sequence[Part], delta: Any) -> bool:
    rest = np.array(delta, dtype=complex)
    for part in parts:
        own = rest[part.w, part.z]
        if part.kind != FULL and not (own == own[0, 0] * np.eye(len(own))).all():
            return False
        if part.kind == REAL and own[0, 0].imag != 0:
            return False
        rest[part.w, part.z] = 0
    return not rest.any()


def _fits(numbers: Numbers, parts: Sequence[Part], delta: Any, allowance: float) -> bool:
    """Whether each block of a Delta of 60 digits is within what it may be."""
    levels = np.broadcast_to(numbers["level"], (len(parts),)).tolist()
    for part, level in zip(parts, levels, strict=True):
        own = delta[part.w, part.z]
        size = abs(own[0, 0]) if part.kind != FULL else spectral_norm(own)
        if size > mp.mpf(allowance) / mp.mpf(level) * (1 + mp.mpf(10) ** -40):
            return False
    return True


def _units(parts: Sequence[Part], real: bool) -> list[Any]:
    """One matrix for each real number in a Delta."""
    q, p = parts[-1].w.stop, parts[-1].z.stop
    result = []
    for part in parts:
        for i in range(part.w.stop - part.w.start):
            for j in range(part.z.stop - part.z.start):
                E = np.zeros((q, p), dtype=complex)
                if part.kind == FULL:
                    E[part.w.start + i, part.z.start + j] = 1
                elif i == j == 0:
                    E[part.w, part.z] = np.eye(part.w.stop - part.w.start)
                else:
                    continue
                result += [E] if real or part.kind == REAL else [E, 1j * E]
    return result


def _singular(numbers: Numbers, allowance: float, matrix: Any = None) -> bool:
    """Whether Newton's steps from ``delta`` find one, within its limits, that makes I - M Delta singular."""
    M = np.asarray(numbers["M"] if matrix is None else matrix)
    parts, start = _parts(numbers), np.asarray(numbers["delta"])
    if not parts or not _has_structure(parts, start):
        return False
    real = not any(mp.im(x) for X in (M, start) for x in X.ravel().tolist())
    sizes = [float(np.linalg.norm(start[part.w, part.z], 2)) for part in parts]
    found = _newton(long(M), long(start), _units(parts, real), sizes)
    return found is not None and _fits(numbers, parts, found, allowance)


def _newton(M: Any, delta: Any, units: list[Any], sizes: Sequence[float]) -> Any:
    """A Delta next to the given one with det(I - M Delta) = 0 to 45 digits, by the smallest steps; None: none found."""
    p = len(M)
    one, largest = long(np.eye(p)), max([*sizes, 1e-300])
    E = [long(unit) for unit in units]
    for _ in range(NEWTON):
        K = one - M.dot(delta)
        try:
            inverse = solve(K, one)
        except ZeroDivisionError:
            return delta
        # det' / det = -tr(K^-1 M E): the step of Newton on det = 0 is that to tr = 1
        R = inverse.dot(M)
        slopes = [sum((R[i, j] * unit[j, i] for i, j in zip(*np.nonzero(where.T), strict=True)), mp.mpf(0))
                  for unit, where in zip(E, units, strict=True)]  # fmt: skip
        step = _least(slopes)
        if step is None:
            return None
        delta = delta + sum((s * unit for s, unit in zip(step, E, strict=True)), 0 * E[0])
        size = max(abs(s) for s in step)
        if size < mp.mpf(10) ** -45 * largest:
            return delta
        if size > 10 * largest:
            return None
    return None


def _least(slopes: list[Any]) -> list[Any] | None:
    """The smallest real x with sum slopes_i x_i = 1."""
    a, b = [mp.re(s) for s in slopes], [mp.im(s) for s in slopes]
    aa, bb, ab = (mp.fsum(x * y for x, y in zip(u, v, strict=True)) for u, v in ((a, a), (b, b), (a, b)))
    if bb == 0:
        return [x / aa for x in a] if aa else None
    det = aa * bb - ab * ab
    if det <= 0:
        return None
    return [(bb * x - ab * y) / det for x, y in zip(a, b, strict=True)]


def _unstable(numbers: Numbers, allowance: float, kind: str = "") -> bool:
    """Whether a multiple of ``delta``, within its limits, gives a pole on or beyond the boundary, in 60 digits."""
    if "delta" not in numbers:
        return False
    numbers = {**numbers, "level": np.array(_levels(kind, numbers))}
    parts, delta = _parts(numbers), long(numbers["delta"])
    if not _has_structure(parts, numbers["delta"]):
        return False
    levels = np.broadcast_to(numbers["level"], (len(parts),)).tolist()
    most = mp.inf
    for part, level in zip(parts, levels, strict=True):
        own = delta[part.w, part.z]
        size = spectral_norm(own)
        most = min(most, mp.mpf(allowance) / mp.mpf(level) / size if size else mp.inf)
    top = min(most, mp.mpf(ALLOWANCE) + mp.mpf(10) ** -6)
    G, dt = tuple(map(long, _system(numbers)[:4])), float(numbers["dt"])
    near = [top * s for s in (1, 1 - mp.mpf(10) ** -10, 1 - mp.mpf(10) ** -9)]
    # The member need not be next to the given one: any multiple within the limits will do, of either sign.
    far = [sign * min(most, 1000) * mp.mpf(k) / MULTIPLES for k in range(MULTIPLES, 0, -1) for sign in (1, -1)]
    if any(_beyond(G, delta * s, dt) for s in (*near, *far)):
        return True
    return _singular(numbers, allowance, G[3])


def _beyond(G: tuple[Any, ...], delta: Any, dt: float, strictly: bool = False) -> bool:
    """Whether the member of this Delta has a pole on or beyond the boundary, or is not well posed."""
    A, B, C, D = G
    try:
        inner = solve(long(np.eye(len(D))) - D.dot(delta), C)
    except ZeroDivisionError:
        return True
    values = eigenvalues(A + B.dot(delta).dot(inner))
    far = max((abs(x) - 1 if dt else mp.re(x) for x in values), default=mp.mpf(-1))
    return far > 0 if strictly else far >= -(mp.mpf(10) ** -45)


def _scalings_fit(table: Sequence[Any], D_w: Any, D_z: Any, G: Any) -> bool:
    """Whether scalings have the structure that the theorem asks for, to the last bit."""
    D_w, D_z, G = (np.array(X, dtype=complex) for X in (D_w, D_z, G))
    row = col = 0
    for kind, rows, cols in table:
        w, z = slice(row, row + rows), slice(col, col + cols)
        a, b, g = D_w[w, w].copy(), D_z[z, z].copy(), G[w, z].copy()
        if kind == FULL:
            good = a[0, 0].imag == 0 and (a == a[0, 0] * np.eye(rows)).all() and (b == a[0, 0] * np.eye(cols)).all()
        else:
            good = (a == b).all() and (a == a.conj().T).all()
        good = good and ((g == g.conj().T).all() if kind == REAL else not g.any())
        if not good:
            return False
        D_w[w, w], D_z[z, z], G[w, z] = 0, 0, 0
        row, col = row + rows, col + cols
    return not (D_w.any() or D_z.any() or G.any())


def _channel_levels(table: Sequence[Any], levels: Sequence[float]) -> list[float]:
    return [level for (_, rows, _), level in zip(table, levels, strict=True) for _ in range(rows)]


def _of_mu(numbers: Numbers, rng: np.random.Generator) -> str:
    """A bound of mu of one matrix: the evidence in rationals, and Deltas that break it."""
    M, table = np.asarray(numbers["M"]), np.asarray(numbers["blocks"]).tolist()
    parts = _parts(numbers)
    word = _broken_at(long(M), parts, numbers)
    if word:
        return word
    D_w, D_z, G = (numbers[x] for x in ("D_w", "D_z", "G"))
    if not _scalings_fit(table, D_w, D_z, G):
        return "unjustified: the scalings have not the structure"
    level = np.broadcast_to(numbers["level"], (len(table),)).tolist()
    L = rational(np.diag(_channel_levels(table, level) * 2))
    m, d_w, d_z, g = (embedded(X) for X in (M, D_w, D_z, G))
    J, supply = embedded(1j * np.eye(M.shape[1])), g * m
    form = L * d_w * L - m.transpose() * d_z * m - J * (supply - supply.transpose())
    return "" if is_positive(d_w) and is_positive(form) else "unjustified: the form is not positive definite"


def _form(M: Any, D_w: Any, D_z: Any, G: Any, L: Any) -> Any:
    """``L D_w L - M^* D_z M - j (G M - M^* G)`` in 60 digits."""
    GM = long(G).dot(M)
    return L.dot(long(D_w)).dot(L) - star(M).dot(long(D_z)).dot(M) - mp.mpc(0, 1) * (GM - star(GM))


def _of_matrix_boxes(kind: str, numbers: Numbers) -> str:
    """A bound of mu of one matrix by boxes: Deltas that break it, the covering, and each form in 60 digits."""
    M, table = long(numbers["M"]), np.asarray(numbers["blocks"]).tolist()
    parts, (p, q) = _parts(numbers, kind), M.shape
    nearer = [min(part.high, -part.low) for part in parts]  # a set within, even about zero
    even = [part._replace(low=-x, high=x) for part, x in zip(parts, nearer, strict=True)]
    levels = np.array([(1 + 1e-12) / x if x else np.inf for x in nearer])
    word = _broken_at(M, even, {**numbers, "level": levels}) or _boxes_cover(kind, numbers, parts)
    if word:
        return word
    own = [1.0 if part.kind == REAL else x for part, x in zip(parts, _levels(kind, numbers), strict=True)]
    L, static = long(np.diag(_channel_levels(table, own))), [long(np.zeros(s)) for s in ((0, 0), (0, q), (p, 0))]
    for i, box in enumerate(numbers["box"]):
        D_w, D_z, G = (np.asarray(numbers[x][i]) for x in ("D_w", "D_z", "G"))
        if not (_scalings_fit(table, D_w, D_z, G) and is_positive(embedded(D_w))):
            return f"unjustified: scalings of box {i} have not the structure, or are not positive"
        inside = _inside((*static, M), parts, box, mp)[3]
        if not positive(_form(inside, D_w, D_z, G, L)):
            return f"unjustified: the form of box {i} is not positive definite"
    return ""


def _broken_at(M: Any, parts: Sequence[Part], numbers: Numbers) -> str:
    """A Delta within the limits that makes I - M Delta singular, sought by the library's lower bound."""
    limits = np.concatenate([np.full(part.w.stop - part.w.start, part.high) for part in parts])
    scaled = M.astype(complex) * limits
    rows = [[-(p.w.stop - p.w.start), 0] if p.kind == REAL else [p.w.stop - p.w.start, 0] if p.kind == COMPLEX
            else [p.w.stop - p.w.start, p.z.stop - p.z.start] for p in parts]  # fmt: skip
    size = np.abs(scaled).max(initial=0.0)
    if not 1e-100 < size < 1e100:
        return ""
    try:
        found = rl.mu(scaled, rows)
    except rl.RobustlabError:
        return ""
    if not float(np.max(found.lower)) > 1 - 1e-9:
        return ""
    delta = limits[:, None] * np.reshape(found.delta, (scaled.shape[1], scaled.shape[0]))
    again = {**numbers, "M": M, "delta": delta}
    return "false: a Delta within the level makes it singular" if _singular(again, 1.0) else ""


def _of_axis(kind: str, numbers: Numbers, hints: Sequence[Any], rng: np.random.Generator) -> str:
    """A claim over frequencies that was proved: nominal stability, members, coverings, forms."""
    dt, parts, exact = float(numbers["dt"]), _parts(numbers, kind), _system(numbers)
    floats, long_ones = tuple(map(doubles, exact[:4])), tuple(map(long, exact[:4]))
    if not (kind == "mu-axis" and "band" in numbers):
        if not _stable(exact):
            return "false: the nominal model is not stable"
        member = seek(floats, dt, parts, hints, rng)
        if member is not None and _beyond(long_ones, long(member * INSIDE), dt, strictly=True):
            return "false: an unstable member"
    elif _broken_in_band(numbers, parts, long_ones, dt):
        return "false: a Delta within the level makes it singular in the band"
    if kind.endswith("boxes"):
        word = _boxes_cover(kind, numbers, parts)
    else:
        word = _intervals_cover(numbers, kind == "mu-axis")
    return word or _forms(kind, numbers, parts, floats, long_ones)


def _broken_in_band(numbers: Numbers, parts: Sequence[Part], G: tuple[Any, ...], dt: float) -> bool:
    """Whether a Delta is found at an end, or in the middle, of a band."""
    a, b = (float(x) for x in numbers["band"])
    b = min(b, math.pi / dt * (1 - 1e-15)) if dt else b
    middle = math.sqrt(a * b) if a and math.isfinite(b) else a + 1.0
    inside = [w for w in (a, middle, b) if a <= w <= b]
    return any(_broken_at(response(G, dt, mp.mpf(w)), parts, numbers) for w in inside)


def seek(G: tuple[Any, ...], dt: float, parts: Sequence[Part], hints: Sequence[Any], rng: np.random.Generator) -> Any:
    """The Delta within its limits whose worst pole lies farthest out, where one is on or beyond the boundary.

    From each start the pole's derivative tells which Delta is best for it (ends of ranges, a matrix of rank one), and
    that one is taken, again and again; besides, members are drawn at random.
    """
    A, B, C, D = G
    q, p, n = B.shape[1], C.shape[0], len(A)
    if not n or not q or not p or not parts:
        return None
    starts = [_drawn_in(parts, h) for h in hints if np.shape(h) == (q, p)] + [
        _random(parts, rng) for _ in range(STARTS)
    ]
    best, worst = -math.inf, None
    for start in starts:
        delta = start
        for _ in range(STEPS):
            try:
                inner = np.linalg.solve(np.eye(p) - D @ delta, np.hstack([C, D]))
                values, right = np.linalg.eig(A + B @ delta @ inner[:, :n])
                left = np.linalg.inv(right)
            except np.linalg.LinAlgError:
                break
            sizes = np.abs(values) - 1 if dt else values.real
            k = int(np.argmax(sizes))
            if sizes[k] > best:
                best, worst = sizes[k], delta
            column = inner[:, :n] @ right[:, k]
            row = left[k] @ (B + B @ delta @ inner[:, n:])
            turn = np.conj(values[k]) / max(abs(values[k]), 1e-300) if dt else 1.0
            moved = _steepest(parts, turn * row, column)
            if np.abs(moved - delta).max() <= 1e-15:
                break
            delta = moved
    draws = np.stack([_random(parts, rng, inner=True) for _ in range(SAMPLES)])
    try:
        poles = np.linalg.eigvals(
            A + B @ draws @ np.linalg.solve(np.eye(p) - D @ draws, np.broadcast_to(C, (SAMPLES, p, n)))
        )
    except np.linalg.LinAlgError:
        poles = np.zeros((0, n))
    sizes = (np.abs(poles) - 1 if dt else poles.real).max(axis=1, initial=-math.inf)
    if len(sizes) and sizes.max() > best:
        best, worst = float(sizes.max()), draws[int(np.argmax(sizes))]
    return worst if best > -1e-9 * max(1.0, float(np.abs(A).max())) else None


def _assembled(parts: Sequence[Part], block: Callable[[Part], Any]) -> Any:
    """A Delta from its blocks; a number stands for its multiple of the unit matrix."""
    delta = np.zeros((parts[-1].w.stop, parts[-1].z.stop), dtype=complex)
    for part in parts:
        value = block(part)
        delta[part.w, part.z] = value if part.kind == FULL else value * np.eye(part.w.stop - part.w.start)
    return delta


def _drawn_in(parts: Sequence[Part], hint: Any) -> Any:
    """The hint, perhaps of another structure, with each block made one of its kind and brought to its limit."""

    def block(part: Part) -> Any:
        own = np.asarray(hint, dtype=complex)[part.w, part.z]
        if part.kind == REAL:
            return np.clip(own[0, 0].real, part.low, part.high)
        own = own if part.kind == FULL else own[0, 0]
        size = np.linalg.norm(own, 2) if part.kind == FULL else abs(own)
        return own / size * part.high if size else 0 * own

    return _assembled(parts, block)


def _random(parts: Sequence[Part], rng: np.random.Generator, inner: bool = False) -> Any:
    def block(part: Part) -> Any:
        if part.kind == REAL:
            return rng.uniform(part.low, part.high) if inner else rng.choice([part.low, part.high])
        if part.kind == COMPLEX:
            return part.high * np.exp(2j * np.pi * rng.random())
        sides = part.w.stop - part.w.start, part.z.stop - part.z.start
        u, v = (rng.normal(size=k) + 1j * rng.normal(size=k) for k in sides)
        return part.high * np.outer(u, v) / np.linalg.norm(u) / np.linalg.norm(v)

    return _assembled(parts, block)


def _steepest(parts: Sequence[Part], row: Any, column: Any) -> Any:
    """The Delta with the largest Re(row Delta column)."""

    def block(part: Part) -> Any:
        y, x = row[part.w], column[part.z]
        if part.kind == FULL:
            size = np.linalg.norm(y) * np.linalg.norm(x)
            return part.high * np.outer(y.conj(), x.conj()) / (size or 1.0)
        slope = y @ x
        if part.kind == REAL:
            return part.high if slope.real > 0 else part.low
        return part.high * np.conj(slope) / abs(slope) if slope else 0.0

    return _assembled(parts, block)


def _intervals_cover(numbers: Numbers, banded: bool) -> str:
    """Whether the union of the intervals holds all that the claim speaks of."""
    low, high, dt = np.asarray(numbers["low"]), np.asarray(numbers["high"]), float(numbers["dt"])
    start, stop = (float(x) for x in numbers["band"]) if banded and "band" in numbers else (0.0, math.inf)
    reached, first = start, True
    while first or not (reached >= stop or (dt and mp.mpf(reached) * mp.mpf(dt) >= mp.pi)):
        further = [float(b) for a, b in zip(low, high, strict=True) if a <= reached and b >= reached]
        if not further or (max(further) == reached and not first):
            return f"unjustified: nothing covers what follows {reached} rad/s"
        reached, first = max(further), False
    return ""


def _boxes_cover(kind: str, numbers: Numbers, parts: Sequence[Part]) -> str:
    """Whether boxes and intervals cover the set at all frequencies: every cell between faces, in rationals."""
    boxes, dt = np.asarray(numbers["box"]), float(numbers.get("dt", 0.0))
    low, high = np.asarray(numbers["low"]), np.asarray(numbers["high"])
    size = Fraction(1) if kind.startswith("worst-gain") else Fraction(float(numbers["size"]))
    cuts = []
    for i, part in enumerate(parts):
        a, b = (size * Fraction(float(x)) if part.kind == REAL else Fraction(0) for x in numbers["ranges"][i])
        faces = {Fraction(x) for x in boxes[:, i].ravel().tolist()}
        inside = sorted({a, b} | {x for x in faces if a < x < b})
        middles = [(x + y) / 2 for x, y in itertools.pairwise(inside)] or [a]
        cuts.append(middles)
    ends = sorted({0.0, *low.tolist(), *(x for x in high.tolist() if math.isfinite(x))})
    frequencies = [(x + y) / 2 for x, y in itertools.pairwise(ends)] + [ends[-1] * 2 + 1]
    if dt:
        frequencies = [w for w in frequencies if w < math.pi / dt * (1 - 1e-12)] + [math.pi / dt * (1 - 1e-15)]
    below = [np.array([[float(b[0]) <= m for m in cut] for b in boxes[:, i]]) for i, cut in enumerate(cuts)]
    above = [np.array([[float(b[1]) >= m for m in cut] for b in boxes[:, i]]) for i, cut in enumerate(cuts)]
    for w in frequencies:
        active = (low <= w) & (high >= w)
        covered = np.ones((int(active.sum()),) + (1,) * len(cuts), dtype=bool)
        for i in range(len(cuts)):
            shape = [-1] + [1] * len(cuts)
            shape[1 + i] = len(cuts[i])
            covered = covered & (below[i] & above[i])[active].reshape(shape)
        if not covered.any(axis=0).all():
            return f"unjustified: boxes leave something open near {w} rad/s"
    return ""


def _forms(kind: str, numbers: Numbers, parts: Sequence[Part], floats: tuple[Any, ...], exact: tuple[Any, ...]) -> str:
    """Each form at sampled frequencies of its interval in floating point, the least of all in 60 digits."""
    table, dt = np.asarray(numbers["blocks"]).tolist(), float(numbers["dt"])
    low, high = np.asarray(numbers["low"]), np.asarray(numbers["high"])
    stop = float(numbers["band"][1]) if "band" in numbers and kind == "mu-axis" else math.inf
    start = float(numbers["band"][0]) if "band" in numbers and kind == "mu-axis" else 0.0
    levels = _levels(kind, numbers)
    if kind.endswith("boxes"):
        levels = [1.0 if part.kind == REAL else level for part, level in zip(parts, levels, strict=True)]
    poles = np.linalg.eigvals(floats[0]) if len(floats[0]) else np.zeros(0)
    poles = np.abs(np.log(poles[poles != 0].astype(complex)) / dt) if dt else np.abs(poles.imag)
    worst: list[tuple[float, int, float]] = []
    reached = start
    for i, (a, b) in enumerate(zip(low.tolist(), high.tolist(), strict=True)):
        b = min(b, stop)
        begin = a if kind.endswith("boxes") else max(a, reached)
        if begin > b or (begin == b and worst and not kind.endswith("boxes")):  # proved by one before it
            continue
        reached = max(reached, b)
        D_w, D_z, G = (np.asarray(numbers[x][i]) for x in ("D_w", "D_z", "G"))
        if not _scalings_fit(table, D_w, D_z, G):
            return f"unjustified: scalings of interval {i} have not the structure"
        if not is_positive(embedded(D_w)):
            return f"unjustified: D_w of interval {i} is not positive definite"
        inside = floats if not kind.endswith("boxes") else _inside(floats, parts, numbers["box"][i], np)
        points = _points(begin, b, dt, poles)
        L = np.diag(_channel_levels(table, levels))
        least, w = min((_least_eigenvalue(_float_response(inside, dt, w), D_w, D_z, G, L), w) for w in points)
        worst.append((least, i, w))
    for _, i, w in sorted(worst)[:2]:
        model = exact if not kind.endswith("boxes") else _inside(exact, parts, numbers["box"][i], mp)
        M = response(model, dt, mp.pi / mp.mpf(dt) if dt and math.isinf(w) else mp.mpf(w))
        L = long(np.diag(_channel_levels(table, levels)))
        if not positive(_form(M, *(numbers[x][i] for x in ("D_w", "D_z", "G")), L)):
            return f"unjustified: the form of interval {i} is not positive definite at {w} rad/s"
    return ""


def _inside(G: tuple[Any, ...], parts: Sequence[Part], box: Any, numbers: Any) -> tuple[Any, ...]:
    """The model that the normalised Delta of a box sees, in floating point or 60 digits."""
    A, B, C, D = G
    q, p = B.shape[1], C.shape[0]
    centre, half = np.zeros((q, p)), np.ones(q)
    exactly = numbers is mp
    if exactly:
        centre, half = long(centre), long(half)
    for part, (a, b) in zip(parts, box, strict=True):
        if part.kind == REAL:
            middle, reach = (
                ((mp.mpf(a) + mp.mpf(b)) / 2, (mp.mpf(b) - mp.mpf(a)) / 2) if exactly else ((a + b) / 2, (b - a) / 2)
            )
            for w, z in zip(range(part.w.start, part.w.stop), range(part.z.start, part.z.stop), strict=True):
                centre[w, z], half[w] = middle, reach
    one = long(np.eye(p)) if exactly else np.eye(p)
    inner = (solve if exactly else np.linalg.solve)(one - D.dot(centre), np.hstack([C, D]))
    n = len(A)
    to_z, direct = inner[:, :n], inner[:, n:]
    back = B.dot(centre)
    return A + back.dot(to_z), (B + back.dot(direct)) * half, to_z, direct * half


def _points(a: float, b: float, dt: float, poles: Any) -> list[float]:
    """Frequencies of an interval: its ends, some between, those next to poles."""
    if dt:
        b = min(b, math.pi / dt)
        a = min(a, b)
    last = b if math.isfinite(b) else max(10 * float(poles.max(initial=1.0)), 10 * a, 1.0)
    between = np.linspace(a, last, POINTS) if dt or a == 0 else np.geomspace(a, max(last, a), POINTS)
    return [*between.tolist(), *(float(w) for w in poles if a <= w <= b), *([math.inf] if math.isinf(b) else [])]


def _float_response(G: tuple[Any, ...], dt: float, w: float) -> Any:
    A, B, C, D = G
    if not len(A) or math.isinf(w):
        return D + 0j
    s = np.exp(1j * w * dt) if dt else 1j * w
    try:
        return D + C @ np.linalg.solve(s * np.eye(len(A)) - A, B)
    except np.linalg.LinAlgError:
        return np.full(D.shape, 1e150 + 0j)


def _least_eigenvalue(M: Any, D_w: Any, D_z: Any, G: Any, L: Any) -> float:
    """Of the form, scaled so that L D_w L has a diagonal of ones."""
    weighted = L @ D_w @ L
    scale = 1 / np.sqrt(np.abs(np.diag(weighted)).clip(1e-300))
    GM = G @ M
    F = (weighted - M.conj().T @ D_z @ M - 1j * (GM - GM.conj().T)) * scale[:, None] * scale
    return float(np.linalg.eigvalsh(F)[0]) if np.isfinite(F).all() else -math.inf


def embedded(X: Any) -> fmpq_mat:
    """The real matrix ``[[Re, -Im], [Im, Re]]`` of fractions: products and definiteness go over to it."""
    X = np.asarray(X, dtype=complex)
    R, J = rational(X.real), rational(X.imag)
    return joined([[R, J * -1], [J, R]])


def h2_square(G: System) -> fmpq:
    """Square of the H2 norm of a stable model in rationals; D counts where it is discrete."""
    n, D = G.A.nrows(), sum((d * d for d in G.D.entries()), fmpq(0))
    if not n:
        return D
    # A^T X + X A + C^T C = 0, or A^T X A - X + C^T C = 0, row by row
    one, A = np.array([[fmpq(int(i == j)) for j in range(n)] for i in range(n)]), np.array(G.A.transpose().tolist())
    system = np.kron(A, A) - np.kron(one, one) if G.discrete else np.kron(A, one) + np.kron(one, A)
    right = fmpq_mat(n * n, 1, [-v for v in (G.C.transpose() * G.C).entries()])
    X = fmpq_mat(n, n, fmpq_mat(n * n, n * n, system.ravel().tolist()).solve(right).entries())
    BXB = G.B.transpose() * X * G.B
    return D + sum((BXB[i, i] for i in range(BXB.nrows())), fmpq(0))


def long(X: Any) -> Any:
    """Doubles, or fractions, as numbers of 60 digits."""
    if isinstance(X, fmpq_mat):
        result = np.empty((X.nrows(), X.ncols()), dtype=object)
        result.ravel()[:] = [mp.mpf(int(x.p)) / int(x.q) for x in X.entries()]
        return result
    X = np.asarray(X)
    result = np.empty(X.shape, dtype=object)
    result.ravel()[:] = [mp.mpmathify(x) for x in X.ravel().tolist()]
    return result


def doubles(X: fmpq_mat) -> Any:
    return np.array([float(Fraction(int(x.p), int(x.q))) for x in X.entries()]).reshape(X.nrows(), X.ncols())


def solve(A: Any, B: Any) -> Any:
    """``A^-1 B`` by elimination; ZeroDivisionError where A is singular."""
    A, B = np.array(A, dtype=object), np.array(B, dtype=object)
    n = len(A)
    for i in range(n):
        k = max(range(i, n), key=lambda r: abs(A[r, i]))
        if A[k, i] == 0:
            raise ZeroDivisionError("singular")
        A[[i, k]], B[[i, k]] = A[[k, i]], B[[k, i]]
        for r in range(i + 1, n):
            f = A[r, i] / A[i, i]
            A[r, i:], B[r] = A[r, i:] - f * A[i, i:], B[r] - f * B[i]
    for i in reversed(range(n)):
        if i + 1 < n:
            B[i] = B[i] - A[i, i + 1 :].dot(B[i + 1 :])
        B[i] = B[i] / A[i, i]
    return B


def positive(X: Any) -> bool:
    """Whether a Hermitian matrix is positive definite, by its pivots."""
    X = np.array(X, dtype=object)
    for i in range(len(X)):
        if not mp.re(X[i, i]) > 0:
            return False
        for r in range(i + 1, len(X)):
            X[r, i + 1 :] = X[r, i + 1 :] - (X[r, i] / mp.re(X[i, i])) * X[i, i + 1 :]
    return True


def star(X: Any) -> Any:
    X = X.T.copy()
    X.ravel()[:] = [mp.conj(x) for x in X.ravel()]
    return X


def response(G: tuple[Any, ...], dt: float, w: Any) -> Any:
    """The response of A, B, C, D at w rad/s; inf: D."""
    A, B, C, D = G
    if not len(A) or (not dt and mp.isinf(w)):
        return D
    s = mp.expjpi(mp.mpf(w) * mp.mpf(dt) / mp.pi) if dt else mp.mpc(0, w)
    return D + C.dot(solve(long(np.eye(len(A))) * s - A, B))


def spectral_norm(X: Any) -> Any:
    if X.shape == (1, 1):
        return abs(X[0, 0])
    return max(mp.svd_c(mp.matrix(X.tolist()), compute_uv=False))


def eigenvalues(A: Any) -> list[Any]:
    if len(A) <= 1:  # mpmath 1.3 gives one state's with its vectors
        return A.ravel().tolist()
    return list(mp.eig(mp.matrix(A.tolist()), left=False, right=False))
