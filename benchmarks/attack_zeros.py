"""An attack on zeros and crossings: badly scaled and ill-conditioned models, judged in exact arithmetic.

    nice -n 10 python benchmarks/attack_zeros.py --what zeros|crossings --first 0 --count 10000 --out zeros.jsonl
    python benchmarks/attack_zeros.py --summary zeros.jsonl crossings.jsonl

Case i needs no other. The judge (`zeros_judge`) works with the entries as rational numbers, in other ways than the
library does, and uses nothing of it. Wrong and trusted (status converged or certified, or a result without one):

- a zero that is missing, unless random relative changes of the entries by 3e-14 move it by 1 %; a value off by 1e-9 of
  every zero at which P(s), rows and columns brought to size one, keeps its rank by more than 1e-12;
- a crossing that is missing, one too many, or off by 1e-9, by roots in balls, and by signs of |L| - 1 evaluated between
  them; an infinite or too large margin.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import math
from collections import Counter, defaultdict
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import exact_loops as loops
import numpy as np
import zeros_judge as judge
from harness import append, json_lines, options, timed

import robustlab as rl

Parts = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]
CLOSE = 1e-9
ALIKE = 1e-3  # of values at which P loses its rank to rounding: multiple zeros


def dense(rng: np.random.Generator, n: int, m: int, p: int, direct: bool = False) -> Parts:
    D = rng.normal(size=(p, m)) if direct else np.zeros((p, m))
    return rng.normal(size=(n, n)), rng.normal(size=(n, m)), rng.normal(size=(p, n)), D


def rotated(rng: np.random.Generator, parts: Parts) -> Parts:
    A, B, C, D = parts
    Q = np.linalg.qr(rng.normal(size=A.shape))[0] if len(A) else A
    return Q @ A @ Q.T, Q @ B, C @ Q.T, D


def sizes(rng: np.random.Generator, most: int = 8) -> tuple[int, int]:
    n = int(rng.integers(2, most + 1))
    return n, int(rng.integers(1, min(n, 3) + 1))


def nonnormal(rng: np.random.Generator) -> Parts:
    n, m = sizes(rng)
    S = 10 ** rng.uniform(0, 5)
    _, B, C, D = dense(rng, n, m, m, rng.random() < 0.3)
    A = -(10 ** rng.uniform(-4, 0)) * np.eye(n)
    if rng.random() < 0.4:
        A += S * np.eye(n, k=1)
        B, C = (np.round(2 * x) for x in (B, C))
    else:
        A += np.triu(rng.normal(size=(n, n)) * (S if rng.random() < 0.5 else S ** rng.random((n, n))), 1)
    return A, B, C, D


def stiff(rng: np.random.Generator) -> Parts:
    n, m = sizes(rng)
    rates = 10 ** rng.uniform(-7, 7, n)
    _, B, C, D = dense(rng, n, m, m, rng.random() < 0.4)
    A = -np.diag(rates) + (rng.random() < 0.5) * np.diag(rng.normal(size=n - 1) * np.sqrt(rates[1:] * rates[:-1]), 1)
    parts = (A, B * rates[:, None] ** rng.random(), C * rates ** rng.random(), D)
    return rotated(rng, parts) if rng.random() < 0.3 else parts


def mixed(rng: np.random.Generator) -> Parts:
    n, m = sizes(rng)
    p = m if rng.random() < 0.7 else int(rng.integers(1, 4))
    t, w, z = (10.0 ** rng.integers(-9, 10, k) for k in (n, m, p))
    A, B, C, D = dense(rng, n, m, p, rng.random() < 0.5)
    return A / t[:, None] * t, B / t[:, None] * w, C * t * z[:, None], D * w * z[:, None]


def nearly_triangular(rng: np.random.Generator) -> Parts:
    n, m = sizes(rng)
    A, B, C, D = dense(rng, n, m, m, rng.random() < 0.3)
    return np.triu(A) * 10 ** rng.uniform(0, 3) + np.tril(A, -1) * 10 ** rng.uniform(-16, -5, (n, n)), B, C, D


def lightly_damped(rng: np.random.Generator) -> Parts:
    k = int(rng.integers(1, 5))
    w = 10 ** rng.uniform(-1, 3, k)
    A = np.zeros((2 * k, 2 * k))
    for i in range(k):
        A[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] = [[0, 1], [-(w[i] ** 2), -2e-9 * w[i]]]
    B, C = np.zeros((2 * k, 1)), np.zeros((1, 2 * k))
    B[1::2, 0], C[0, ::2] = rng.normal(size=k), rng.normal(size=k)
    return A, B, C, np.array([[rng.choice([0.0, 1e-3, 1.0])]])


def not_square(rng: np.random.Generator) -> Parts:
    """A plant of other numbers of inputs and outputs, in a third of the cases behind an actuator with a zero."""
    n, m = sizes(rng, 6)
    p = m + int(rng.integers(1, 3))
    A, B, C, D = dense(rng, n, m, p, rng.random() < 0.3)
    if rng.random() < 0.35 and m == 1:
        a, b, c = -rng.uniform(0.5, 3), 1.0, rng.uniform(-5, 5)
        A = np.block([[np.array([[a]]), np.zeros((1, n))], [B * c, A]])
        B, C = np.vstack([[[b]], B]), np.hstack([D * c, C])
    return (A, B, C, D) if rng.random() < 0.5 else (A.T, C.T, B.T, D.T)


def hidden_modes(rng: np.random.Generator) -> Parts:
    n, m = sizes(rng, 7)
    p = int(rng.integers(1, 4))
    A, B, C, D = (np.round(2 * x) for x in dense(rng, n, m, p, rng.random() < 0.3))
    k = int(rng.integers(1, n))
    if rng.random() < 0.5:
        B[k:], A[k:, :k] = 0, 0
    else:
        C[:, k:], A[:k, k:] = 0, 0
    return rotated(rng, (A, B, C, D)) if rng.random() < 0.3 else (A, B, C, D)


def tiny_direct_term(rng: np.random.Generator) -> Parts:
    n, m = sizes(rng, 6)
    A, B, C, _ = dense(rng, n, m, m)
    return A * 10 ** rng.uniform(-6, 0), B, C, np.diag(rng.normal(size=m) * 10 ** rng.uniform(-20, -4, m))


def integrators(rng: np.random.Generator) -> Parts:
    """Chains with whole coefficients: multiple zeros, also at zero."""
    n = int(rng.integers(2, 8))
    A, B, C = np.eye(n, k=1), np.zeros((n, 1)), np.zeros((1, n))
    B[-1] = 1.0
    k = int(rng.integers(0, n))
    C[0, : k + 1] = np.atleast_1d(np.poly(rng.integers(-2, 3, k)))[::-1]
    return A, B, C, np.zeros((1, 1))


def relative_degree(rng: np.random.Generator) -> Parts:
    """Zeros at infinity that a rotation makes finite."""
    A, B, C, D = integrators(rng)
    A[-1] = -np.poly(-rng.uniform(0.1, 4, len(A)))[:0:-1]
    return rotated(rng, (A, B, C, D))


def low_rank(rng: np.random.Generator) -> Parts:
    n, r = sizes(rng, 5)
    A, B, C, _ = (np.round(2 * x) for x in dense(rng, n, r, r))
    p, m = r + int(rng.integers(0, 3)), r + int(rng.integers(0, 3))
    return A, B @ rng.integers(-2, 3, (r, m)), rng.integers(-2, 3, (p, r)) @ C, np.zeros((p, m))


def edges(rng: np.random.Generator) -> Parts:
    n, m, p = (int(rng.integers(0, 3)) for _ in range(3))
    parts = dense(rng, n, m, p, True)
    return tuple(x * (rng.random() < 0.6) for x in parts)  # type: ignore[return-value]


def ordinary(rng: np.random.Generator) -> Parts:
    n, m = sizes(rng, 12)
    return dense(rng, n, m, m, rng.random() < 0.4)


FAMILIES: dict[str, Callable[[np.random.Generator], Parts]] = {
    "nonnormal": nonnormal, "nonnormal, rotated": lambda rng: rotated(rng, nonnormal(rng)), "stiff": stiff,
    "mixed scales": mixed, "nearly triangular": nearly_triangular, "damping 1e-9": lightly_damped,
    "not square": not_square, "hidden modes": hidden_modes, "tiny direct term": tiny_direct_term,
    "integrator chains": integrators, "relative degree, rotated": relative_degree, "low normal rank": low_rank,
    "nothing, or zero": edges, "ordinary": ordinary,
}  # fmt: skip


def zeros_case(i: int) -> dict[str, Any]:
    family = list(FAMILIES)[i % len(FAMILIES)]
    rng = np.random.default_rng([11, i])
    parts = tuple(np.asarray(x, dtype=float) for x in FAMILIES[family](rng))
    found, seconds = timed(rl.zeros, rl.StateSpaceModel(*parts))
    record = _record(family, found, seconds)
    if found.status.trustworthy:
        record["wrong"] = zeros_fault(parts, found, rng)
    return record


def _record(family: str, found: Any, seconds: float) -> dict[str, Any]:
    return {"family": family, "status": str(found.status), "reason": found.reason, "seconds": seconds, "wrong": ""}


def zeros_fault(parts: Parts, found: Any, rng: np.random.Generator) -> str:
    """Each value is a zero to the last digits, or P loses its rank there; what is missing comes from infinity."""
    left, rank = judge.invariant_zeros(*parts)
    if rank != found.normal_rank:
        return f"rank {found.normal_rank} of {rank}"
    for z in found.values.tolist():
        off = [abs(z - w) / abs(w) if w else abs(z) for w in left]
        exact = min(off, default=np.inf) <= CLOSE
        if not exact and _kept_rank(parts, z, rank) > 1e-12:
            return f"P(s) keeps its rank at {z:.4g}"
        if min(off, default=np.inf) <= (CLOSE if exact else ALIKE):
            left.pop(int(np.argmin(off)))
    if left and not _moved(parts, np.array(left), rng):
        return f"{len(left)} zeros are missing"
    return ""


def _moved(parts: Parts, near: np.ndarray, rng: np.random.Generator) -> bool:
    moved = np.zeros(len(near), dtype=bool)
    for _ in range(12):
        changed = tuple(x * (1 + 3e-14 * rng.choice([-1, 1], x.shape)) for x in parts)
        others = np.array(judge.invariant_zeros(*changed)[0])
        moved |= [not len(others) or np.abs(others - z).min() > 0.01 * abs(z) for z in near]
    return bool(moved.all())


def _kept_rank(parts: Parts, z: complex, rank: int) -> float:
    A, B, C, D = parts
    P = np.block([[A - z * np.eye(len(A)), B], [C, D]])
    for _ in range(20):
        for axis in (0, 1):
            size = np.abs(P).max(axis=axis, keepdims=True)
            P = P / np.sqrt(np.where(size > 0, size, 1.0))
    sigma = np.linalg.svd(P, compute_uv=False)
    return float(sigma[len(A) + rank - 1] / sigma[0])


def loop_case(rng: np.random.Generator, family: str) -> tuple[Parts, float]:
    """One open loop that is stable when it is closed, wherever that was to be had."""
    dt = 0.0
    for _ in range(60):
        dt = 0.0
        if family == "nonnormal":
            n = int(rng.integers(2, 6))
            A = np.triu(rng.normal(size=(n, n)) * 10 ** rng.uniform(0, 1.5), 1) - 10 ** rng.uniform(-3, 0) * np.eye(n)
            B = rng.normal(size=(n, 1))
            C = _placing(A, B, rng)
            D = np.zeros((1, 1))
        elif family == "integrators":
            A, B, C, D = integrators(rng)
            C = _placing(A, B, rng)
        else:
            maker = {"stiff": stiff, "damping 1e-9": lightly_damped, "discrete": ordinary}.get(family, ordinary)
            A, B, C, D = maker(rng)
            B, C, D = B[:, :1], C[:1], D[:1, :1]
            poles = np.linalg.eigvals(A)
            if family == "discrete":
                dt, A = float(rng.choice([0.01, 1.0])), A * (rng.uniform(0.5, 1.05) / np.abs(poles).max())
            elif rng.random() < 0.7:
                A = A - max(0.0, poles.real.max() * rng.uniform(0.5, 1.5)) * np.eye(len(A))
            C, D = C * 10 ** rng.uniform(-1, 1), D * rng.choice([0.0, 0.3])
        parts = (A, B, C, D)
        if judge.Loop(*parts, dt).stable_closed() or rng.random() < 0.05:
            break
    return parts, dt


def _placing(A: np.ndarray, B: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    from scipy.signal import place_poles

    poles = -(10 ** rng.uniform(-1, 1.5, len(A)))
    try:
        return place_poles(A, B, poles * (1 + 1e-3 * np.arange(len(A)))).gain_matrix
    except (ValueError, np.linalg.LinAlgError):
        return rng.normal(size=(1, len(A)))


LOOPS = ("nonnormal", "stiff", "damping 1e-9", "discrete", "integrators", "ordinary", "two channels")


def crossings_case(i: int) -> dict[str, Any]:
    family = LOOPS[i % len(LOOPS)]
    rng = np.random.default_rng([12, i])
    if family == "two channels":
        return two_channels(rng)
    parts, dt = loop_case(rng, family)
    try:
        found, seconds = timed(rl.classical_margins, rl.StateSpaceModel(*parts, dt))
    except rl.NoTrustworthyNumber as error:
        return {"family": family, "status": "refused", "reason": error.found, "seconds": 0.0, "wrong": ""}
    margin = next(iter(found.channels.values()))
    record = _record(family, margin, seconds)
    if margin.status.trustworthy:
        record["wrong"] = crossings_fault(judge.Loop(*parts, dt), margin)
    return record


def crossings_fault(loop: judge.Loop, margin: Any) -> str:
    gain, phase = loop.crossings()
    for reported, wanted, what in (
        ([(c.frequency, c.lag) for c in margin.gain_crossings], gain, "|L| = 1"),
        ([(c.frequency, c.factor) for c in margin.phase_crossings if 0 < c.frequency < _last(loop)], phase, "L < 0"),
    ):
        kept = [x for x in wanted if what == "|L| = 1" or x[1] > 1e-9]
        if len(reported) != len(kept):
            return f"{what}: {len(reported)} crossings of {len(kept)}"
        for (w, value), (w0, value0) in zip(reported, kept, strict=True):
            turn = abs((value - value0 + math.pi) % (2 * math.pi) - math.pi) if what == "|L| = 1" else 0.0
            far = abs(value / value0 - 1) if what == "L < 0" else 0.0
            if abs(w / w0 - 1) > CLOSE or turn > CLOSE or far > CLOSE:
                return f"{what}: at {w:.12g} for {w0:.12g}, {value:.12g} for {value0:.12g}"
    edges = [0.0, *(c.frequency for c in margin.gain_crossings)]
    inner = [math.sqrt(a * b) if a else b / 2 for a, b in pairwise(edges)]
    inner += [min(2 * edges[-1], 0.5 * (edges[-1] + _last(loop)))] if len(edges) > 1 else []
    signs = [loop.above_one(w) for w in inner]
    if any(a == b for a, b in pairwise(signs)):
        return "|L| - 1 has one sign on both sides of a crossing"
    stable = loop.stable_closed()
    if stable != margin.stable:
        return f"stable: {margin.stable} for {stable}"
    if stable and gain:
        lag = min(min(x % (2 * math.pi), 2 * math.pi - x % (2 * math.pi)) for _, x in gain)
        delay, first = min(((x % (2 * math.pi)) / w, w) for w, x in gain)
        most = lag * (1 + CLOSE) + 1e-14, delay * (1 + CLOSE) + 1e-14 / first
        if margin.phase_margin > most[0] or margin.delay_margin > most[1]:
            return f"phase margin {margin.phase_margin:.6g} for {lag:.6g}"
    return ""


def _last(loop: judge.Loop) -> float:
    return math.pi / loop.dt if loop.dt else math.inf


def two_channels(rng: np.random.Generator) -> dict[str, Any]:
    """A plant of two channels and a controller, opened at the first output: the other one closed in rationals."""
    n = int(rng.integers(2, 6))
    A, B, C, D = dense(rng, n, 2, 2)
    A -= (np.linalg.eigvals(A).real.max() + 10 ** rng.uniform(-4, 0)) * np.eye(n)
    t = 10.0 ** rng.integers(-6, 7, n)
    P = (A / t[:, None] * t, B / t[:, None], C * t, D)
    k = -rng.uniform(0.1, 5, 2)
    K = (np.diag(k), np.eye(2), rng.normal(size=(2, 2)), rng.normal(size=(2, 2)) * (rng.random() < 0.3))
    found, seconds = timed(rl.classical_margins, rl.StateSpaceModel(*P), rl.StateSpaceModel(*K))
    margin = found.channels["y1"]
    record = _record("two channels", margin, seconds)

    if margin.status.trustworthy:
        both = loops.in_series(*(loops.system(loops.Model(*map(np.asarray, m)), loops.rational) for m in (K, P)))
        minus = loops.Model(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), -np.eye(1))
        record["wrong"] = crossings_fault(
            judge.Loop(*loops.closed(both, loops.system(minus, loops.rational))[:4]), margin
        )
    return record


CASES = {"zeros": zeros_case, "crossings": crossings_case}


def run(what: str, first: int, count: int, out: Path) -> None:
    done = {record["case"] for record in json_lines([out])}
    for i in range(first, first + count):
        if i not in done:
            append(out, {"what": what, "case": i, **CASES[what](i)})


def summary(files: list[Path]) -> str:
    records = list(json_lines(files))
    lines = []
    for what in CASES:
        rows: dict[str, list[Any]] = defaultdict(list)
        for record in records:
            if record["what"] == what:
                rows[record["family"]].append(record)
        if not rows:
            continue
        lines.append(f"{what:<28}{'cases':>8}{'trusted':>13}{'inaccurate':>12}{'refused':>9}{'WRONG':>7}{'ms':>8}")
        for family, found in [*rows.items(), ("all", [r for part in rows.values() for r in part])]:
            status = Counter(r["status"] for r in found)
            wrong = sum(bool(r["wrong"]) for r in found)
            good = status["converged"] + status["certified"]
            middle = 1e3 * float(np.median([r["seconds"] for r in found]))
            columns = f"{good:>13}{status['inaccurate']:>12}{status['refused']:>9}{wrong:>7}{middle:>8.1f}"
            lines.append(f"{family:<28}{len(found):>8}{columns}")
        lines.append("")
    lines += [f"WRONG {r['what']} {r['case']} {r['family']}: {r['wrong']}" for r in records if r["wrong"]]
    return "\n".join(lines)


def main() -> None:
    given = options(__doc__, "*", what=tuple(CASES), first=0, count=1000, out="attack_zeros.jsonl", summary=False)
    if given.summary:
        print(summary([Path(name) for name in given.names]))
    else:
        run(given.what, given.first, given.count, Path(given.out))


if __name__ == "__main__":
    main()
