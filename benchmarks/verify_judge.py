"""Whether what the checker answered is so: the judge of `verify_attack`. It uses nothing of `robustlab.verification`.

A claim that was proved is attacked twice. The statement: norms, stability and sets are decided in rationals; for a
bound of mu or of a gain a member is sought that breaks it (floating point seeks, rationals and balls confirm). And the
evidence: coverings, structures, and the forms at sampled frequencies, in rationals or balls. So an answer is *false* (a
counterexample is known) or *unjustified* (the evidence does not carry it, whether or not the statement is true).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from fractions import Fraction
from typing import Any

import exact_delta as deltas
import exact_loops as loops
import numpy as np
from exact_delta import Part, slices
from exact_loops import Model, System, joined, product, rational, system, with_precision
from flint import acb_mat, arb, fmpq, fmpq_mat

import robustlab as rl

Numbers = dict[str, Any]
KINDS = ("real", "complex", "full")
ALLOWANCE = 1 + 1e-9
NORMS = ("norm", "bounded-real", "loop-norm", "difference-norm")
INSIDE = 1 - 1e-13  # by so much a member found in floating point is drawn in before it is judged
POINTS = 9  # frequencies of an interval at which its form is looked at
MULTIPLES = 25  # of a given Delta, of each sign, that are tried where the nearest ones are stable


def judge(kind: str, numbers: Numbers, proved: bool, hints: Sequence[Any] = (), seed: int = 0) -> str:
    """Return the error of the answer; empty if none is found.

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
        found = _of_mu(numbers)
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


def _parts(numbers: Numbers) -> list[Part]:
    return [Part(KINDS[kind], rows, cols) for kind, rows, cols in np.asarray(numbers["blocks"]).tolist()]


def _limits(kind: str, numbers: Numbers) -> list[tuple[float, float]]:
    """The ends of each real number in Delta; of other blocks the largest norm, and less it."""
    result = [(-1 / level, 1 / level) for level in _levels(kind, numbers)]
    if kind.endswith("boxes"):
        size = 1.0 if kind.startswith("worst-gain") else float(numbers["size"])
        for i, part in enumerate(_parts(numbers)):
            if part.kind == "real":
                result[i] = tuple(size * float(x) for x in numbers["ranges"][i])
    return result


def _levels(kind: str, numbers: Numbers) -> list[float]:
    k = len(numbers["blocks"])
    if kind.startswith("worst-gain"):
        return [1.0] * (k - 1) + [float(numbers["gamma"])]
    return np.broadcast_to(numbers["level"], (k,)).tolist()


def _singular(numbers: Numbers, allowance: float, M: Any = None) -> bool:
    """Whether Newton's steps from ``delta`` find one, within its limits, that makes I - M Delta singular."""
    M = np.asarray(numbers["M"]) if M is None else M
    parts, start = _parts(numbers), np.asarray(numbers["delta"])
    if not parts or not start.any() or not deltas.structure_holds(parts, start):
        return False
    levels = np.broadcast_to(numbers["level"], (len(parts),)).tolist()

    def test() -> bool | None:
        found = deltas.singular_next_to(M, parts, start)
        if found is None:
            return False
        sizes = [loops.gain(loops.part(found, w, z)) for w, z in slices(parts)]
        return all(x * arb(v) <= arb(allowance) * arb(1 + 1e-19) for x, v in zip(sizes, levels, strict=True))

    return bool(with_precision(test))


def _unstable(numbers: Numbers, allowance: float, kind: str = "") -> bool:
    """Whether a multiple of ``delta``, within its limits, gives a pole on or beyond the boundary."""
    if "delta" not in numbers:
        return False
    numbers = {**numbers, "level": np.array(_levels(kind, numbers))}
    parts, delta = _parts(numbers), np.asarray(numbers["delta"])
    if not deltas.structure_holds(parts, delta):
        return False
    sizes = [float(np.linalg.norm(delta[w, z], 2)) for w, z in slices(parts)]
    most = min((allowance / v / x for v, x in zip(numbers["level"], sizes, strict=True) if x), default=math.inf)
    top, G = min(most, ALLOWANCE + 1e-6), _system(numbers)
    # The member need not be next to the given one: any multiple within the limits will do, of either sign.
    far = [sign * min(most, 1000) * k / MULTIPLES for k in range(MULTIPLES, 0, -1) for sign in (1, -1)]
    if not all(deltas.member_is_stable(G, delta, s) for s in (top, top * (1 - 1e-10), top * (1 - 1e-9), *far)):
        return True
    return _singular(numbers, allowance, lambda: acb_mat(G.D))


def _channels(parts: Sequence[Part], values: Sequence[float]) -> np.ndarray:
    """A value for each row of Delta from one for each block."""
    return np.repeat(values, [part.rows for part in parts])


def _of_mu(numbers: Numbers) -> str:
    """A bound of mu of one matrix: Deltas that break it, and the evidence."""
    M, parts = np.asarray(numbers["M"]) + 0j, _parts(numbers)
    levels = np.broadcast_to(numbers["level"], (len(parts),)).tolist()
    word = _broken_at(M, numbers)
    if word:
        return word
    D_w, D_z, G = (np.asarray(numbers[x]) for x in ("D_w", "D_z", "G"))
    if not deltas.scalings_fit(parts, D_w, D_z, G):
        return "unjustified: the scalings have not the structure"
    holds = deltas.proves(M, D_w, D_z, G, _channels(parts, levels))
    return "" if holds else "unjustified: the form is not positive definite"


def _of_matrix_boxes(kind: str, numbers: Numbers) -> str:
    """A bound of mu of one matrix by boxes: Deltas that break it, the covering, and each form."""
    M, parts = np.asarray(numbers["M"]) + 0j, _parts(numbers)
    nearer = [min(high, -low) for low, high in _limits(kind, numbers)]  # a set within, even about zero
    levels = np.array([(1 + 1e-12) / x if x else np.inf for x in nearer])
    word = _broken_at(M, {**numbers, "level": levels}) or _boxes_cover(kind, numbers, parts)
    if word:
        return word
    own = [1.0 if part.kind == "real" else x for part, x in zip(parts, _levels(kind, numbers), strict=True)]
    p, q = M.shape
    for i, box in enumerate(numbers["box"]):
        D_w, D_z, G = (np.asarray(numbers[x][i]) for x in ("D_w", "D_z", "G"))
        if not deltas.scalings_fit(parts, D_w, D_z, G):
            return f"unjustified: scalings of box {i} have not the structure"

        def inside(box: Any = box) -> Any:
            static = System(acb_mat(0, 0), acb_mat(0, q), acb_mat(p, 0), acb_mat(loops.exact(M)), False)
            return _inside(static, parts, box).D

        if not deltas.proves(inside, D_w, D_z, G, _channels(parts, own)):
            return f"unjustified: the form of box {i} is not positive definite"
    return ""


def _broken_at(M: Any, numbers: Numbers) -> str:
    """A Delta within the limits that makes I - M Delta singular, sought by the library's lower bound."""
    parts = _parts(numbers)
    limits = _channels(parts, 1 / np.broadcast_to(numbers["level"], (len(parts),)))
    floats = M if isinstance(M, np.ndarray) else np.array([[complex(v) for v in row] for row in M().tolist()])
    scaled = floats * limits
    rows = [[-b.rows, 0] if b.kind == "real" else [b.rows, 0 if b.kind == "complex" else b.cols] for b in parts]
    if not 1e-100 < np.abs(scaled).max(initial=0.0) < 1e100:
        return ""
    try:
        found = rl.mu(scaled, rows)
    except rl.RobustlabError:
        return ""
    if not float(np.max(found.lower)) > 1 - 1e-9:
        return ""
    again = {**numbers, "delta": limits[:, None] * np.reshape(found.delta, scaled.shape[::-1])}
    return "false: a Delta within the level makes it singular" if _singular(again, 1.0, M) else ""


def _of_axis(kind: str, numbers: Numbers, hints: Sequence[Any], rng: np.random.Generator) -> str:
    """A claim over frequencies that was proved: nominal stability, members, coverings, forms."""
    dt, parts, G = float(numbers["dt"]), _parts(numbers), _system(numbers)
    if not (kind == "mu-axis" and "band" in numbers):
        if not _stable(G):
            return "false: the nominal model is not stable"
        limits = _limits(kind, numbers)
        high = _channels(parts, [b for _, b in limits])
        if all(a < 0 < b for a, b in limits):
            A, B, C, D = map(_doubles, G[:4])
            unit = [part._replace(below=-a / b) for part, (a, b) in zip(parts, limits, strict=True)]
            for hint in [*(h for h in hints if np.shape(h) == (B.shape[1], len(C))), None][:2]:
                known = None if hint is None else np.asarray(hint) / high[:, None]
                known = known if known is not None and deltas.structure_holds(unit, known) else None
                found = deltas.unstable_inside(Model(A, B * high, C, D * high, dt), unit, INSIDE, rng, known)
                if found is not None and not deltas.member_is_stable(G, found * high[:, None]):
                    return "false: an unstable member"
    elif _broken_in_band(numbers, Model(*G[:4], dt)):
        return "false: a Delta within the level makes it singular in the band"
    if kind.endswith("boxes"):
        word = _boxes_cover(kind, numbers, parts)
    else:
        word = _intervals_cover(numbers, kind == "mu-axis")
    return word or _forms(kind, numbers, parts, G)


def _broken_in_band(numbers: Numbers, G: Model) -> bool:
    """Whether a Delta is found at an end, or in the middle, of a band."""
    a, b = (float(x) for x in numbers["band"])
    b = min(b, math.pi / G.dt * (1 - 1e-15)) if G.dt else b
    middle = math.sqrt(a * b) if a and math.isfinite(b) else a + 1.0
    inside = [w for w in (a, middle, b) if a <= w <= b]
    return any(_broken_at(lambda w=w: loops.response(G, w), numbers) for w in inside)


def _intervals_cover(numbers: Numbers, banded: bool) -> str:
    """Whether the union of the intervals holds all that the claim speaks of."""
    low, high, dt = np.asarray(numbers["low"]), np.asarray(numbers["high"]), float(numbers["dt"])
    start, stop = (float(x) for x in numbers["band"]) if banded and "band" in numbers else (0.0, math.inf)
    reached, first = start, True
    while first or not (reached >= stop or (dt and arb(reached) * arb(dt) >= arb.pi())):
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
        a, b = (size * Fraction(float(x)) if part.kind == "real" else Fraction(0) for x in numbers["ranges"][i])
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


def _forms(kind: str, numbers: Numbers, parts: Sequence[Part], exactly: System) -> str:
    """Each form at sampled frequencies of its interval in floating point, the least of all in balls."""
    dt, boxed, banded = float(numbers["dt"]), kind.endswith("boxes"), "band" in numbers and kind == "mu-axis"
    reached, stop = (float(x) for x in numbers["band"]) if banded else (0.0, math.inf)
    levels = _levels(kind, numbers)
    if boxed:
        levels = [1.0 if part.kind == "real" else level for part, level in zip(parts, levels, strict=True)]
    L, A = _channels(parts, levels), _doubles(exactly.A)
    poles = np.linalg.eigvals(A) if len(A) else np.zeros(0)
    poles = np.abs(np.log(poles[poles != 0].astype(complex)) / dt) if dt else np.abs(poles.imag)
    worst: list[tuple[float, int, float]] = []
    for i, (a, b) in enumerate(
        zip(np.asarray(numbers["low"]).tolist(), np.asarray(numbers["high"]).tolist(), strict=True)
    ):
        b = min(b, stop)
        begin = a if boxed else max(a, reached)
        if begin > b or (begin == b and worst and not boxed):  # proved by one before it
            continue
        reached = max(reached, b)
        D_w, D_z, G = (np.asarray(numbers[x][i]) for x in ("D_w", "D_z", "G"))
        if not deltas.scalings_fit(parts, D_w, D_z, G):
            return f"unjustified: scalings of interval {i} have not the structure"
        seen = _inside(exactly, parts, numbers["box"][i]) if boxed else exactly
        floats = Model(*map(_doubles, seen[:4]), dt)
        points = _points(begin, b, dt, poles)
        worst.append(min((_least_eigenvalue(floats, w, D_w, D_z, G, L), i, w) for w in points))
    for _, i, w in sorted(worst)[:2]:
        seen = Model(*(_inside(exactly, parts, numbers["box"][i]) if boxed else exactly)[:4], dt)
        scalings = (np.asarray(numbers[x][i]) for x in ("D_w", "D_z", "G"))

        def response(seen: Model = seen, w: float = w) -> Any:
            return loops.response(seen, arb.pi() / arb(dt) if dt and math.isinf(w) else w)

        if not deltas.proves(response, *scalings, L):
            return f"unjustified: the form of interval {i} is not positive definite at {w} rad/s"
    return ""


def _inside(G: System, parts: Sequence[Part], box: Any) -> System:
    """The model that the normalised Delta of a box sees."""
    n, p, q = G.A.nrows(), G.D.nrows(), G.D.ncols()
    centre, half = fmpq_mat(q, p), loops.eye(q)
    for part, (w, z), (a, b) in zip(parts, slices(parts), box, strict=True):
        for i, j in zip(range(w.start, w.stop), range(z.start, z.stop), strict=True) if part.kind == "real" else ():
            centre[i, j], half[i, i] = (_fraction(a) + _fraction(b)) / 2, (_fraction(b) - _fraction(a)) / 2
    of = type(G.D)
    inner = loops.inverse(of(loops.eye(p)) - product(G.D, of(centre)))
    to_z, direct, back = product(inner, G.C), product(inner, G.D), product(G.B, of(centre))
    if not n:
        return G._replace(C=to_z, D=product(direct, of(half)))
    B = product(G.B + product(back, direct), of(half))
    return System(G.A + product(back, to_z), B, to_z, product(direct, of(half)), G.discrete)


def _points(a: float, b: float, dt: float, poles: Any) -> list[float]:
    """Frequencies of an interval: its ends, some between, those next to poles."""
    if dt:
        b = min(b, math.pi / dt)
        a = min(a, b)
    last = b if math.isfinite(b) else max(10 * float(poles.max(initial=1.0)), 10 * a, 1.0)
    between = np.linspace(a, last, POINTS) if dt or a == 0 else np.geomspace(a, max(last, a), POINTS)
    return [*between.tolist(), *(float(w) for w in poles if a <= w <= b), *([math.inf] if math.isinf(b) else [])]


def _least_eigenvalue(G: Model, w: float, D_w: Any, D_z: Any, S: Any, L: Any) -> float:
    """Of the form at a frequency, scaled so that L D_w L has a diagonal of ones; a pole there makes it the least."""
    try:
        M = deltas.float_response(G, min(w, math.pi / G.dt) if G.dt else w)
    except np.linalg.LinAlgError:
        return -math.inf
    weighted = D_w * L[:, None] * L
    scale = 1 / np.sqrt(np.abs(np.diag(weighted)).clip(1e-300))
    SM = S @ M
    F = (weighted - M.conj().T @ D_z @ M - 1j * (SM - SM.conj().T)) * scale[:, None] * scale
    return float(np.linalg.eigvalsh(F)[0]) if np.isfinite(F).all() else -math.inf


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


def _doubles(X: fmpq_mat) -> Any:
    return np.array([float(Fraction(int(x.p), int(x.q))) for x in X.entries()]).reshape(X.nrows(), X.ncols())
