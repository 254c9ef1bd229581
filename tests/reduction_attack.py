"""Judge in balls the claims of reductions of models whose unstable and boundary modes have huge gains.

The judge uses nothing of robustlab. It evaluates both stored models in balls of 60 digits: on a grid, near every pole,
and at the ends of the intervals that the result leaves out. False: the error exceeds its certified bound by 1e-9.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from flint import acb, acb_mat, arb, ctx
from scipy.linalg import block_diag, expm

import robustlab as rl

METHODS = ("truncation", "residualisation", "hankel", "stochastic", "weighted")


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
    """A model and a requested reduction."""

    model: rl.StateSpaceModel
    order: int
    method: str
    options: dict[str, Any]
    words: str


def mode(kind: str, rng: np.random.Generator) -> np.ndarray:
    w = 10 ** rng.uniform(-1, 1)
    near = w * 10 ** rng.uniform(-12, -4)
    real = {"undamped": 0.0, "unstable pair": 0.1 * w, "nearly undamped": -near, "barely unstable": near}
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
    method = str(rng.choice(METHODS, p=[0.4, 0.25, 0.2, 0.05, 0.1]))
    options: dict[str, Any] = {"method": method}
    if method == "stochastic":
        options["floor"] = 0.05
    elif method == "weighted":
        weight = rl.StateSpaceModel([[-1.0 if not dt else np.exp(-dt)]], [[dt or 1.0]], [[2.0]], [[0.1]], dt)
        options = {"input_weight": weight}
    words = f"{method}, {' + '.join(kinds)}, gain {gain:.0e}, dt {dt:g}, {n} states"
    return Case(model, int(rng.integers(n - n_s, n)), method, options, words)


def entries(m: acb_mat) -> np.ndarray:
    return np.array([[complex(m[i, j]) for j in range(m.ncols())] for i in range(m.nrows())])


def exactly(m: rl.StateSpaceModel) -> Callable[[float], acb_mat]:
    """Return the response of the stored matrices at a frequency, in balls."""
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
        near = 10.0 ** rng.uniform(-15, -0.5, 10) * (centre if centre > 1e-6 * scale else scale)
        found += [centre + near, centre - near]
    omega = np.abs(np.concatenate(found))
    return omega[(omega > 0) & (omega < (np.pi / dt if dt else np.inf))]


def run(seed: int) -> dict[str, Any]:
    """Return the claims about a case, and the largest difference at the frequencies that they cover."""
    case, rng = make_case(seed), np.random.default_rng([seed, 1])
    record: dict[str, Any] = {"seed": seed, "words": case.words}
    try:
        found = rl.reduce_model(case.model, case.order, **case.options)
    except rl.RobustlabError as error:
        return record | {"status": "refused", "reason": str(error).splitlines()[0]}
    record |= {"status": found.status.value, "reason": found.reason}
    error = found.error
    omega = frequencies([case.model, found.model], rng)
    ends = np.array(found.left_out).reshape(-1)
    omega = np.concatenate([omega, ends, ends * (1 + 1e-12), ends * (1 - 1e-12)])
    omega = omega[(omega > 0) & (omega <= (np.pi / case.model.dt if case.model.dt else np.inf))]
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
    return record | {
        "upper": error.upper, "lower": error.lower, "worst": worst, "left_out": len(found.left_out),
        "widest": max(widths, default=0.0), "false": worst > error.upper * (1 + 1e-9),
    }  # fmt: skip


ctx.dps = 60
