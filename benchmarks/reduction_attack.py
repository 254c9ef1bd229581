"""An attack on the errors of reduced models: unstable modes and modes on or near the boundary, with huge gains.

    python benchmarks/reduction_attack.py --first 0 --count 1000
    python benchmarks/reduction_attack.py --promised --first 0 --count 3000

Case i: a stable part of gain about 1, and integrators, double integrators, undamped pairs, unstable poles or pairs a
share of 1e-12 to 1e-4 beside the axis, whose gain is 1e-8 to 1e12; in states mixed by a random matrix; a third are
discrete. The judge uses nothing of robustlab: it evaluates both models as stored in balls of 60 digits (python-flint),
on a grid, 1e-15 to 0.3 of its frequency beside every pole, and at the ends of what the result leaves out.
A false certificate: a certified error that is exceeded by 1e-9 of it anywhere the result speaks of.

With --promised the bounds are attacked: stable models (some with an unstable mode) that are stiff, nonnormal, lightly
damped, symmetric (twice the sum of Hankel values is attained there), with repeated values, with clusters of tiny ones,
and nearly without some states; a third are discrete. Broken: a bound that the difference exceeds, by the same judge,
where the result saw its peak, beside it, and at both ends of the axis (of coprime factors: that the result's own error
exceeds).
"""

from __future__ import annotations

import argparse
import json
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from flint import acb, acb_mat, arb, ctx
from scipy.linalg import block_diag, expm

import robustlab as rl

METHODS = ("truncation", "residualisation", "hankel", "band", "stochastic", "weighted")
KINDS = (
    "integrator",
    "double integrator",
    "undamped",
    "unstable",
    "unstable pair",
    "nearly undamped",
    "barely unstable",
)


@dataclass(frozen=True, eq=False)
class Case:
    """A model, and what is asked for."""

    model: rl.StateSpaceModel
    order: int
    method: str
    options: dict[str, Any]
    words: str


def mode(kind: str, rng: np.random.Generator) -> np.ndarray:
    w = 10 ** rng.uniform(-1, 1)
    beside = w * 10 ** rng.uniform(-12, -4)
    real = {"undamped": 0.0, "unstable pair": 0.1 * w, "nearly undamped": -beside, "barely unstable": beside}
    if kind in real:
        return np.array([[real[kind], w], [-w, real[kind]]])
    return {"integrator": [[0.0]], "double integrator": [[0.0, 1.0], [0.0, 0.0]], "unstable": [[w]]}[kind]


def make_case(seed: int) -> Case:
    rng = np.random.default_rng(seed)
    dt = 0.0 if rng.random() < 0.65 else float(rng.choice([0.01, 0.1, 1.0]))
    m, p = rng.integers(1, 3, 2)
    kinds = rng.choice(KINDS, rng.integers(1, 3))
    stable = []
    for _ in range(rng.integers(1, 5)):
        w, damping = 10 ** rng.uniform(-1.5, 1.5), 10 ** rng.uniform(-2.5, 0)
        stable.append([[-w]] if rng.random() < 0.5 else [[-damping * w, w], [-w, -damping * w]])
    A, apart = block_diag(*stable), block_diag(*(mode(kind, rng) for kind in kinds))
    n_s, n = len(A), len(A) + len(apart)
    A = block_diag(A, apart)
    B, C = rng.normal(size=(n, m)), rng.normal(size=(p, n))
    gain, share = 10 ** rng.uniform(-8, 12), rng.random()
    B[n_s:] *= gain**share
    C[:, n_s:] *= gain ** (1 - share)
    if dt:
        A, B = expm(A * dt), B * dt
    mixed = rng.integers(0, 4)
    T = [np.eye(n), np.linalg.qr(rng.normal(size=(n, n)))[0], rng.normal(size=(n, n)), np.eye(n)][mixed]
    if mixed == 3:
        T = T + np.triu(rng.integers(-3, 4, size=(n, n)), 1)
    back = np.linalg.inv(T)
    D = rng.normal(size=(p, m)) * (rng.random() < 0.5)
    model = rl.StateSpaceModel(T @ A @ back, T @ B, C @ back, D, dt)
    method = str(rng.choice(METHODS, p=[0.35, 0.2, 0.15, 0.15, 0.05, 0.1]))
    options: dict[str, Any] = {"method": method}
    if method == "band":
        low = 10 ** rng.uniform(-2, 1)
        high = min(low * 10 ** rng.uniform(0.2, 1.5), 0.99 * np.pi / dt if dt else np.inf)
        options = {"band": (min(low, high / 2), high)}
    elif method == "stochastic":
        options["floor"] = 0.05
    elif method == "weighted":
        weight = rl.StateSpaceModel([[-1.0 if not dt else np.exp(-dt)]], [[dt or 1.0]], [[2.0]], [[0.1]], dt)
        options = {"input_weight": weight}
    words = f"{method}, {' + '.join(kinds)}, gain {gain:.0e}, dt {dt:g}, {n} states"
    return Case(model, int(rng.integers(n - n_s, n)), method, options, words)


SPECTRA = (
    "ordinary",
    "stiff",
    "nonnormal",
    "lightly damped",
    "symmetric",
    "repeated",
    "clusters",
    "nearly without states",
    "stiff, nearly without states",
    "unstable",
)
FLOOR = 0.05


def modes(n: int, frequencies: float, damping: tuple[float, float], rng: np.random.Generator) -> np.ndarray:
    """Poles and pairs of frequencies within so many decades of 1 and dampings between two powers of ten."""
    blocks: list[list[list[float]]] = []
    while sum(map(len, blocks)) < n:
        w, d = 10 ** rng.uniform(-frequencies, frequencies), 10 ** rng.uniform(*damping)
        pair = n - sum(map(len, blocks)) > 1 and rng.random() < 0.6
        blocks.append([[-d * w, w], [-w, -d * w]] if pair else [[-w]])
    return block_diag(*blocks)


def balanced(n: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A, B, C with Hankel values over nine decades, some of which nearly agree (Ober 1987)."""
    sigma, b = 10 ** -rng.uniform(0, 9, n), rng.uniform(0.3, 2, n)
    sign = rng.choice([-1.0, 1.0], n) ** rng.integers(0, 2)
    for i in range(1, n):
        if rng.random() < 0.4:
            sigma[i], sign[i] = sigma[i - 1] * (1 + 10 ** rng.uniform(-13, -1)), sign[i - 1]
    b = b * sigma ** rng.uniform(0, 1)
    return -np.outer(b, b) / (sigma + np.outer(sign, sign) * sigma[:, None]), b[:, None], (sign * b)[None]


def make_promised(seed: int) -> Case:
    rng = np.random.default_rng([seed, 2])
    kind, dt = str(rng.choice(SPECTRA)), 0.0 if rng.random() < 0.67 else float(rng.choice([0.01, 0.1, 1.0]))
    method = str(rng.choice(["truncation", "residualisation", "hankel", "stochastic", "coprime"]))
    n, m, p = int(rng.integers(2, 11)), int(rng.integers(1, 4)), int(rng.integers(1, 4))
    damping = (-7.0, -2.0) if kind == "lightly damped" else (-2.0, 0.0)
    A, B, C = modes(n, 5 if kind.startswith("stiff") else 1, damping, rng), rng.normal(size=(n, m)), None
    if kind == "nonnormal":
        A = -np.diag(10 ** rng.uniform(-1, 1, n)) + np.triu(rng.normal(size=(n, n)), 1) * 10 ** rng.uniform(0, 2.5)
    elif kind == "symmetric":
        turn = np.linalg.qr(rng.normal(size=(n, n)))[0]
        A, C = -(turn * 10 ** rng.uniform(-3, 3, n)) @ turn.T, B.T
        A = 0.5 * (A + A.T)
    elif kind == "repeated":
        A, B, C = (np.kron(np.eye(2), x) for x in (A, B[:, :1], rng.normal(size=(1, n))))
    elif kind == "clusters":
        A, B, C = balanced(n, rng)
    elif kind == "unstable":
        A = block_diag(A[:-1, :-1], 0.5)
    C = rng.normal(size=(p, n)) if C is None else C
    if kind.endswith("without states"):
        B, C = B * 10 ** rng.uniform(-8, 0, (n, 1)), C * 10 ** rng.uniform(-8, 0, n)
    n = len(A)
    D = rng.normal(size=(len(C), B.shape[1])) * (kind != "symmetric" and rng.random() < 0.5)
    if kind != "symmetric" or rng.random() < 0.3:
        turns = (
            np.eye(n),
            np.linalg.qr(rng.normal(size=(n, n)))[0],
            rng.normal(size=(n, n)),
            np.diag(10 ** rng.uniform(-4, 4, n)),
        )
        T = turns[rng.integers(0, 4)]
        A, B, C = T @ A @ np.linalg.inv(T), T @ B, C @ np.linalg.inv(T)
    if dt:  # by Tustin's rule
        h = rng.uniform(0.1, 1) / np.median(np.abs(np.linalg.eigvals(A)))
        back = np.linalg.inv(np.eye(n) - h * A)
        A, B, C, D = (
            back @ (np.eye(n) + h * A),
            np.sqrt(2 * h) * back @ B,
            np.sqrt(2 * h) * C @ back,
            D + h * C @ back @ B,
        )
    order = int(rng.integers(0, n))
    options = {"method": method} | ({"floor": FLOOR} if method == "stochastic" else {})
    words = f"{kind}, {method}, dt {dt:g}, {n} -> {order} states"
    return Case(rl.StateSpaceModel(A, B, C, D, dt), order, method, options, words)


def promised(seed: int) -> dict[str, Any]:
    """What is promised for a case, and the largest difference seen."""
    case = make_promised(seed)
    told: dict[str, Any] = {"seed": seed, "words": case.words}
    try:
        found = rl.reduce_model(case.model, case.order, **case.options)
    except rl.RobustlabError as error:
        return told | {"status": "refused", "reason": str(error).splitlines()[0]}
    # The error of the coprime factors, and that relative to a stable part, are not seen from outside.
    relative = case.method == "stochastic"
    hidden = case.method == "coprime" or (relative and found.n_apart)
    worst, at, end = 0.0, found.error.frequency, np.pi / case.model.dt if case.model.dt else np.inf
    if hidden:
        worst = found.error.lower if found.status.trustworthy else 0.0
    elif not case.model.dt and not relative:
        worst = float(np.linalg.norm(case.model.D - found.model.D, 2))
    full, small = exactly(case.model), exactly(found.model)
    looked = [0.0, *(at * (1 + x) for x in (0, 1e-6, -1e-6, 1e-4, -1e-4))] if np.isfinite(at) else [0.0]
    for w in () if hidden else looked:
        if w > end or any(low <= w <= high for low, high in found.left_out):
            continue
        try:
            response = full(w)
            gap = response - small(w)
        except ZeroDivisionError:  # a pole, to 60 digits
            continue
        whole, rest = entries(response), entries(gap)
        if relative:
            turn, gains, _ = np.linalg.svd(whole)
            rest = turn.conj().T @ rest / np.hypot(np.pad(gains, (0, len(turn) - len(gains))), FLOOR)[:, None]
        worst = max(worst, float(np.linalg.norm(rest, 2)))
    return told | {
        "status": found.status.value, "reason": found.reason, "bound": found.bound, "worst": worst,
        "upper": found.error.upper, "broken": bool(worst > found.bound * (1 + 1e-14)),
    }  # fmt: skip


def entries(m: acb_mat) -> np.ndarray:
    return np.array([[complex(m[i, j]) for j in range(m.ncols())] for i in range(m.nrows())])


def exactly(m: rl.StateSpaceModel) -> Callable[[float], acb_mat]:
    """The response of the stored matrices at a frequency, in balls."""
    A, B, C, D = (acb_mat(*x.shape, [acb(float(y)) for y in x.ravel()]) for x in (m.A, m.B, m.C, m.D))
    n = m.n_states
    eye = acb_mat(n, n, [acb(int(i == j)) for i in range(n) for j in range(n)])

    def response(omega: float) -> acb_mat:
        s = (acb(0, arb(omega) * arb(m.dt))).exp() if m.dt else acb(0, arb(omega))
        return C * (eye * s - A).solve(B) + D if n else D

    return response


def frequencies(models: list[rl.StateSpaceModel], rng: np.random.Generator) -> np.ndarray:
    dt = models[0].dt
    poles = np.concatenate([m.poles() for m in models])
    if dt:
        poles = np.log(poles[np.abs(poles) > 1e-9]) / dt
    scale, found = np.abs(poles).max(), [np.geomspace(1e-3, 1e3, 25) * 10 ** rng.uniform(-0.1, 0.1)]
    for centre in np.unique(np.abs(poles.imag)):
        beside = 10.0 ** rng.uniform(-15, -0.5, 10) * (centre if centre > 1e-6 * scale else scale)
        found += [centre + beside, centre - beside]
    omega = np.abs(np.concatenate(found))
    return omega[(omega > 0) & (omega < (np.pi / dt if dt else np.inf))]


def run(seed: int) -> dict[str, Any]:
    """What is claimed for a case, and the largest difference seen where it is claimed."""
    case, rng = make_case(seed), np.random.default_rng([seed, 1])
    told: dict[str, Any] = {"seed": seed, "words": case.words}
    start = time.process_time()
    try:
        found = rl.reduce_model(case.model, case.order, **case.options)
    except rl.RobustlabError as error:
        return told | {"status": "refused", "reason": str(error).splitlines()[0]}
    told |= {"status": found.status.value, "reason": found.reason, "ms": 1e3 * (time.process_time() - start)}
    error = found.difference if case.method == "stochastic" else found.error
    assert error is not None
    omega = frequencies([case.model, found.model], rng)
    ends = np.array(found.left_out).reshape(-1)
    omega = np.concatenate([omega, ends, ends * (1 + 1e-12), ends * (1 - 1e-12)])
    low, high = case.options.get("band", (0.0, np.pi / case.model.dt if case.model.dt else np.inf))
    if "band" in case.options:
        omega = np.concatenate([omega, np.linspace(low, high, 20)])
    omega = omega[(omega > 0) & (omega >= low) & (omega <= high)]
    for a, b in found.left_out:
        omega = omega[(omega <= a) | (omega >= b)]
    weight = case.options.get("input_weight")
    full, small, into = exactly(case.model), exactly(found.model), None if weight is None else exactly(weight)
    worst = 0.0
    for w in map(float, omega):
        try:
            gap = full(w) - small(w)
        except ZeroDivisionError:  # a pole, to 60 digits
            continue
        if into is not None:
            gap = gap * into(w)[0, 0]
        radius = sum(float(x.real.rad()) + float(x.imag.rad()) for x in gap.entries())
        worst = max(worst, float(np.linalg.norm(entries(gap), 2)) - radius)
    widths = [(b - a) / (a + b) if a else b for a, b in found.left_out]
    return told | {
        "upper": error.upper, "lower": error.lower, "worst": worst, "left_out": len(found.left_out),
        "widest": max(widths, default=0.0), "false": worst > error.upper * (1 + 1e-9),
    }  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description="Attack on the certified errors of reduced models.")
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--count", type=int, default=100)
    parser.add_argument("--promised", action="store_true", help="attack the bounds")
    parser.add_argument("--out", help="file to which each case is added, one line of JSON")
    options = parser.parse_args()
    rows = []
    for seed in range(options.first, options.first + options.count):
        rows.append((promised if options.promised else run)(seed))
        if options.out:
            with open(options.out, "a") as file:  # noqa: PTH123
                file.write(json.dumps(rows[-1]) + "\n")
    (promises if options.promised else summary)(rows)


def promises(rows: list[dict[str, Any]]) -> None:
    """Counts, and the bounds that are exceeded, the worst first."""
    for word in ("certified", "inaccurate", "refused"):
        own = [row for row in rows if row["status"] == word]
        some = sorted(
            (row for row in own if row.get("broken")), key=lambda row: -row["worst"] / (row["bound"] or 1e-300)
        )
        print(f"{len(own)} {word}, bounds exceeded: {len(some)}")
        for row in some[:10]:
            print(f"  seed {row['seed']}, {row['words']}: {row['worst']:.9g} > {row['bound']:.9g}")


def summary(rows: list[dict[str, Any]]) -> None:
    """Counts, and the false certificates one by one."""
    by = {word: [row for row in rows if row["status"] == word] for word in ("certified", "inaccurate", "refused")}
    good = by["certified"]
    print(f"{len(rows)} cases: " + ", ".join(f"{len(some)} {word}" for word, some in by.items()))
    print(f"false certificates: {sum(row['false'] for row in good)}")
    print(f"errors exceeded among the inaccurate: {sum(row['false'] for row in by['inaccurate'])}")
    share = [row["worst"] / row["upper"] for row in good if row["upper"]]
    quantiles = ", ".join(f"{x:.4f}" for x in np.quantile(share, [0.05, 0.5, 1.0])) if share else "none"
    print(f"largest difference seen, as a share of the certified error (5 %, median, largest): {quantiles}")
    left = [row["widest"] for row in good if row["left_out"]]
    wide = ", ".join(f"{x:.1e}" for x in np.quantile(left, [0.5, 0.9])) if left else "none"
    print(f"certified with frequencies left out: {len(left)}; half width, as a share of them (median, 90 %): {wide}")
    for word in ("inaccurate", "refused"):
        reasons = Counter("".join(c for c in row["reason"] if not c.isdigit())[:64] for row in by[word])
        print(*(f"  {word}: {count} x {text}" for text, count in reasons.most_common(6)), sep="\n")
    for row in good:
        if row["false"]:
            print(f"  FALSE: seed {row['seed']}, {row['words']}: {row['worst']:.6g} > {row['upper']:.6g}")


ctx.dps = 60
if __name__ == "__main__":
    main()
