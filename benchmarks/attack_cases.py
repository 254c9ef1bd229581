"""Nasty plants and matrices for the attack: case i of seed s is the same everywhere and needs no other case.

Plain arrays; nothing of robustlab is used here.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from exact_delta import Part
from exact_loops import Model

Array = np.ndarray
Rng = np.random.Generator

FUNCTIONS = ("hinf", "mixsyn", "h2", "ncf", "margin", "gain", "mu", "norm")
FAMILIES = (
    "stiff", "nearly uncontrollable", "huge D11", "light damping, fast poles", "Jordan blocks", "near cancellations",
    "denormals and huge entries", "units", "poles and zeros on the axis", "ordinary",
)  # fmt: skip


@dataclass(frozen=True)
class Case:
    """Arguments of a function call.

    ``data``: ``P, n_meas, n_con`` (hinf, h2), ``G, W1, W2, W3`` (mixsyn), ``G, W1, W2`` (ncf), ``M, parts`` (margin,
    gain), ``matrix, parts`` (mu), ``G`` (norm).
    """

    seed: int
    index: int
    function: str
    family: str
    data: dict[str, Any]

    @property
    def model(self) -> Model | None:
        return next((self.data[key] for key in ("P", "G", "M") if key in self.data), None)


def make_case(seed: int, index: int) -> Case:
    """Case ``index`` of a seed; every function meets every family once in 80 cases in a row."""
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(index,)))
    function = FUNCTIONS[index % len(FUNCTIONS)]
    family = FAMILIES[index // len(FUNCTIONS) % len(FAMILIES)]
    with np.errstate(all="ignore"):
        return Case(seed, index, function, family, MAKERS[function](family, rng))


def _modes(values: list[complex]) -> Array:
    """A real block-diagonal matrix with these eigenvalues; of a pair the one above the axis is given."""
    n = _order([*map(complex, values)])
    A, at = np.zeros((n, n)), 0
    for v in map(complex, values):
        if v.imag == 0:
            A[at, at] = v.real
            at += 1
        else:
            A[at : at + 2, at : at + 2] = [[v.real, v.imag], [-v.imag, v.real]]
            at += 2
    return A


def _order(values: list[complex]) -> int:
    return sum(1 if v.imag == 0 else 2 for v in values)


def _moderate(rng: Rng, n: int, unstable: float) -> list[complex]:
    """Eigenvalues within two decades, single ones and pairs."""
    values: list[complex] = []
    while n > 0:
        size, sign = 10 ** rng.uniform(-1, 1), 1 if rng.random() < unstable else -1
        if n > 1 and rng.random() < 0.5:
            zeta = rng.uniform(0.05, 0.9)
            values.append(size * complex(sign * zeta, np.sqrt(1 - zeta**2)))
        else:
            values.append(complex(sign * size))
        n -= 1 if values[-1].imag == 0 else 2
    return values


def _states(family: str, rng: Rng, n: int, unstable: float) -> Array:
    """The A of a family; with ``unstable = 0`` stable in exact arithmetic of its modes."""
    sign = lambda: 1 if rng.random() < unstable else -1  # noqa: E731 - a coin, thrown often
    if family == "stiff":
        values: list[complex] = []
        while (left := n - _order(values)) > 0:
            size = 10 ** rng.uniform(-6, 5)
            pair = left > 1 and rng.random() < 0.3
            values.append(size * complex(sign() * 0.4, 0.9) if pair else complex(sign() * size))
        return _modes(values)
    if family == "light damping, fast poles":
        values = [complex(sign() * 10 ** rng.uniform(3, 7)) for _ in range(1 + n % 2)]
        while _order(values) < n - 1:
            values.append(10 ** rng.uniform(-1, 2) * complex(sign() * 10 ** -rng.uniform(2, 9), 1))
        return _modes(values)
    if family == "Jordan blocks":
        value = sign() * rng.choice([0.25, 1.0, 3.0]) if unstable == 0 or rng.random() < 0.7 else 0.0
        length = int(rng.integers(2, n + 1))
        A = _modes([complex(value)] * length + _moderate(rng, n - length, unstable))
        return A + np.diag([*[10 ** rng.uniform(-1, 1)] * (length - 1), *[0.0] * (n - length)], 1)[:n, :n]
    if family == "poles and zeros on the axis":
        values = []
        while (left := n - _order(values)) > 0:
            real = 0.0 if unstable and rng.random() < 0.6 else -(10 ** -rng.uniform(0, 11))
            pair = left > 1 and rng.random() < 0.4
            values.append(complex(real, 10 ** rng.uniform(-1, 1)) if pair else complex(real))
        return _modes(values)
    return _modes(_moderate(rng, n, unstable))


def _mixed(rng: Rng, A: Array, B: Array, C: Array) -> tuple[Array, Array, Array]:
    """In other states: as they are, turned, or through a map of moderate condition."""
    n, kind = len(A), rng.integers(3)
    if kind == 0 or n == 0:
        return A, B, C
    T = np.eye(n) + 0.3 * rng.standard_normal((n, n)) if kind == 1 else np.linalg.qr(rng.standard_normal((n, n)))[0]
    back = np.linalg.inv(T)
    return T @ A @ back, T @ B, C @ back


def _plant(family: str, rng: Rng, n: int, m: int, p: int, unstable: float) -> tuple[Array, Array, Array]:
    """A, B, C of a family with m inputs and p outputs."""
    extra = 1 if family == "near cancellations" and n > 1 else 0
    A = _states(family, rng, n - extra, unstable)
    n = len(A)
    B, C = rng.standard_normal((n, m)), rng.standard_normal((p, n))
    if family == "nearly uncontrollable":
        mode = rng.integers(n)
        B[mode] *= np.where(rng.random(m) < 0.7, 10 ** -rng.uniform(2, 10, m), 1)
        C[:, mode] *= np.where(rng.random(p) < 0.5, 10 ** -rng.uniform(1, 8, p), 1)
    elif family == "stiff" and rng.random() < 0.6:
        size = np.sqrt(np.abs(np.linalg.eigvals(A)))
        B, C = B * size[:, None], C * size
    if extra:  # (s - z)/(s - p) before the last input
        pole = rng.uniform(0.1, 5) * (1 if rng.random() < unstable else -1)
        gap = pole * rng.choice([-1, 1]) * 10 ** -rng.uniform(2, 12)
        A = np.block([[A, B[:, -1:]], [np.zeros((1, n)), np.array([[pole]])]])
        B = np.vstack([B, np.zeros((1, m))])
        B[-1, -1] = gap
        C = np.hstack([C, np.zeros((p, 1))])
    A, B, C = _mixed(rng, A, B, C)
    if family == "units":
        t = 10.0 ** rng.uniform(-8, 8, len(A))
        A, B, C = A * t[:, None] / t, B * t[:, None], C / t
    return A, B, C


def _sampled(rng: Rng, A: Array, B: Array) -> tuple[Array, Array, float]:
    """Every fourth plant by Tustin's rule; else as it is."""
    if rng.random() >= 0.25 or not len(A):
        return A, B, 0.0
    size = np.abs(np.linalg.eigvals(A))
    size = size[size > 0]
    h = float(10 ** rng.uniform(-2, 0.5) / (np.exp(np.log(size).mean()) if len(size) else 1.0))
    inside = np.linalg.inv(np.eye(len(A)) - 0.5 * h * A)
    return inside @ (np.eye(len(A)) + 0.5 * h * A), h * inside @ B, float(10 ** rng.uniform(-4, 1))


def _extreme(rng: Rng, m: Model) -> Model:
    """The same plant in units hundreds of decades apart, or with entries next to the smallest float."""
    A, B, C, D = (np.array(x) for x in m[:4])
    kind = rng.integers(4)
    if kind == 0:
        for x in (A, B, C, D):
            x[(x == 0) & (rng.random(x.shape) < 0.5)] = 5e-324 * rng.integers(1, 100)
    elif kind == 1:
        power = rng.uniform(20, 290) * rng.choice([-1, 1])
        column = rng.integers(B.shape[1])
        B[:, column] *= 10.0**power
        D[:, column] *= 10.0**power
    elif kind == 2:
        power = rng.uniform(20, 290) * rng.choice([-1, 1])
        row = rng.integers(len(C))
        C[row] *= 10.0**power
        D[row] *= 10.0**power
    else:
        t = 10.0 ** rng.uniform(-140, 140, len(A))
        A, B, C = A * t[:, None] / t, B * t[:, None], C / t
    finite = all(np.isfinite(x).all() for x in (A, B, C, D))
    return Model(A, B, C, D, m.dt) if finite else m


def _size(rng: Rng) -> int:
    return int(rng.integers(2, 6)) if rng.random() < 0.85 else int(rng.integers(6, 11))


def _generalised(family: str, rng: Rng, h2: bool) -> dict[str, Any]:
    n, n_w, n_u, n_y = _size(rng), int(rng.integers(1, 4)), int(rng.integers(1, 3)), int(rng.integers(1, 3))
    n_z = int(rng.integers(1, 3))
    A, B, C = _plant(family, rng, n, n_w + n_u, n_z + n_y, rng.choice([0.0, 0.4, 1.0], p=[0.15, 0.55, 0.3]))
    A, B, dt = _sampled(rng, A, B)
    regular = rng.random() < (0.3 if family.startswith("poles") else 0.7)
    zeros, n = np.zeros, len(A)
    if regular:  # penalties on u and noise on y of their own
        r, v = 10 ** rng.uniform(-3, 0, 2)
        B = np.hstack([B[:, :n_w], zeros((n, n_y)), B[:, n_w:]])
        C = np.vstack([C[:n_z], zeros((n_u, n)), C[n_z:]])
        D11 = zeros((n_z + n_u, n_w + n_y))
        D12 = np.vstack([zeros((n_z, n_u)), r * np.eye(n_u)])
        D21 = np.hstack([zeros((n_y, n_w)), v * np.eye(n_y)])
    else:
        D11 = zeros((n_z, n_w))
        D12 = rng.standard_normal((n_z, n_u)) * (rng.random((n_z, n_u)) < 0.5)
        D21 = rng.standard_normal((n_y, n_w)) * (rng.random((n_y, n_w)) < 0.5)
    if family == "huge D11":
        size = 10 ** rng.uniform(3, 9)
        D11 = size * D12 @ rng.standard_normal((n_u, n_y)) @ D21
        if not h2 or dt:
            D11 = D11 + 10 ** rng.uniform(0, 7) * rng.standard_normal(D11.shape)
    elif not h2 and rng.random() < 0.3:
        D11 = rng.standard_normal(D11.shape)
    D22 = rng.standard_normal((n_y, n_u)) * (rng.random() < 0.2)
    P = Model(A, B, C, np.block([[D11, D12], [D21, D22]]), dt)
    if family.startswith("denormals"):
        P = _extreme(rng, P)
    return {"P": P, "n_meas": n_y, "n_con": n_u}


def _first_order(rng: Rng, low: float, high: float, corner: float, dt: float) -> Model:
    """A stable lag from gain ``low`` at frequency 0 to ``high`` at infinity."""
    model = Model(np.array([[-corner]]), np.ones((1, 1)), np.array([[corner * (low - high)]]), np.array([[high]]))
    if not dt:
        return model
    h = 2 * np.tan(min(corner * dt / 2, 1.4)) / corner if corner * dt > 1e-6 else dt
    inside = 1 / (1 + 0.5 * h * corner)
    # z-domain by Tustin's rule: x+ = a x + b u, y = c (x + b' u) + d u
    A, B = np.array([[(1 - 0.5 * h * corner) * inside]]), np.array([[h * inside]])
    return Model(A, B, model.C * inside, model.D + model.C * 0.5 * h * inside, dt)


def _static(gain: float, dt: float) -> Model:
    return Model(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), np.array([[gain]]), dt)


def _own_plant(family: str, rng: Rng) -> Model:
    """A plant from u to y for mixsyn and ncf."""
    n, n_u, n_y = _size(rng), int(rng.random() < 0.3) + 1, int(rng.random() < 0.3) + 1
    A, B, C = _plant(family, rng, n, n_u, n_y, 0.4)
    A, B, dt = _sampled(rng, A, B)
    D = rng.standard_normal((n_y, n_u)) * (rng.random() < 0.3)
    if family == "huge D11":
        D = 10 ** rng.uniform(2, 9) * rng.standard_normal((n_y, n_u))
    G = Model(A, B, C, D, dt)
    return _extreme(rng, G) if family.startswith("denormals") else G


def _pace(rng: Rng, G: Model) -> float:
    """A frequency within the plant's own, in rad/s."""
    found = np.linalg.eigvals(G.A)
    if G.dt:
        found = np.log(found[found != 0]) / G.dt
    size = np.abs(found)
    size = size[np.isfinite(size) & (size > 1e-100) & (size < 1e100)]
    pace = float(np.exp(np.log(size).mean())) if len(size) else 1.0
    return min(pace * 10 ** rng.uniform(-0.5, 1), 1 / G.dt if G.dt else np.inf)


def _mixsyn(family: str, rng: Rng) -> dict[str, Any]:
    G = _own_plant(family, rng)
    corner, dt = _pace(rng, G), G.dt
    a = 10 ** -rng.uniform(1, 7)
    data = {"G": G, "W1": _first_order(rng, 1 / a, 0.5, corner * a, dt), "W2": None, "W3": None}
    if rng.random() < 0.8:
        data["W2"] = _static(10 ** rng.uniform(-4, 0), dt)
    if rng.random() < 0.4:
        data["W3"] = _first_order(rng, 10 ** -rng.uniform(1, 3), 10 ** rng.uniform(0, 2), 10 * corner, dt)
    return data


def _ncf(family: str, rng: Rng) -> dict[str, Any]:
    G = _own_plant(family, rng)
    data: dict[str, Any] = {"G": G, "W1": None, "W2": None}
    if rng.random() < 0.5:
        corner, dt = _pace(rng, G), G.dt
        data["W1"] = _first_order(rng, 10 ** rng.uniform(0, 4), 10 ** rng.uniform(-1, 0), corner * 1e-2, dt)
    if rng.random() < 0.3:
        data["W2"] = _static(10 ** rng.uniform(-2, 2), G.dt)
    return data


def _parts(rng: Rng, most: int = 5) -> tuple[Part, ...]:
    kind = rng.choice(["real", "mixed", "complex", "full"], p=[0.45, 0.3, 0.1, 0.15])
    parts: list[Part] = []
    while (left := most - sum(b.rows for b in parts)) > 0 and (not parts or rng.random() < 0.8):
        own = kind if kind != "mixed" else rng.choice(["real", "complex", "full"])
        twice = min(left, 2 if rng.random() < 0.25 else 1)
        if own == "full":
            rows, cols = int(rng.integers(1, min(left, 2) + 1)), int(rng.integers(1, 3))
            parts.append(Part("full", rows, cols))
        else:
            parts.append(Part(str(own), twice, twice))
    return tuple(parts)


def _uncertain(family: str, rng: Rng, n_in: int, n_out: int, level: tuple[float, float]) -> dict[str, Any]:
    parts = _parts(rng)
    q, p = sum(b.rows for b in parts), sum(b.cols for b in parts)
    A, B, C = _plant(family, rng, _size(rng), q + n_in, p + n_out, 0.0)
    A, B, dt = _sampled(rng, A, B)
    D = rng.standard_normal((p + n_out, q + n_in)) * (rng.random() < 0.5) * 0.3
    # Of a size at which a Delta of about one matters.
    found = np.linalg.eigvals(A)
    points = np.concatenate([np.exp(1j * np.angle(found)), [1.0, -1.0]]) if dt else 1j * np.append(np.abs(found), 0.0)
    sizes = [
        np.linalg.norm(D[:p, :q] + C[:p] @ np.linalg.solve(s * np.eye(len(A)) - A, B[:, :q]), 2)
        for s in points
        if np.linalg.matrix_rank(s * np.eye(len(A)) - A) == len(A)
    ]
    largest = max((v for v in sizes if np.isfinite(v)), default=1.0)
    factor = 10 ** rng.uniform(*level) / largest if largest else 1.0
    B[:, :q], D[:, :q] = B[:, :q] * factor, D[:, :q] * factor
    if family == "huge D11":
        size = 10 ** rng.uniform(2, 8)
        D[p:, q:] += size * rng.standard_normal((n_out, n_in))
        t = np.where(rng.random(min(p, q)) < 0.5, size, 1.0)  # and units of the channels that differ by as much
        k = min(p, q) if all(b.kind != "full" for b in parts) else 0
        B[:, :k], D[:, :k] = B[:, :k] * t[:k], D[:, :k] * t[:k]
        C[:k], D[:k] = C[:k] / t[:k, None], D[:k] / t[:k, None]
    if all(b.kind == "real" for b in parts) and rng.random() < 0.3:
        parts = tuple(b._replace(below=float(rng.choice([0.25, 0.5, 2.0]))) for b in parts)
    M = Model(A, B, C, D, dt)
    return {"M": _extreme(rng, M) if family.startswith("denormals") else M, "parts": parts}


def _gain(family: str, rng: Rng) -> dict[str, Any]:
    return _uncertain(family, rng, int(rng.integers(1, 3)), int(rng.integers(1, 3)), (-1.5, -0.1))


def _mu(family: str, rng: Rng) -> dict[str, Any]:
    parts = _parts(rng, 6)
    q, p = sum(b.rows for b in parts), sum(b.cols for b in parts)
    m = rng.standard_normal((p, q)) + 1j * rng.standard_normal((p, q))
    if rng.random() < 0.3:
        m = m.real + 0j
    if family == "stiff":
        scale = 10 ** rng.uniform(-6, 6, max(p, q))
        m = m * scale[:p, None] / scale[None, :q]
    elif family == "nearly uncontrollable":
        u, _, vh = np.linalg.svd(m, full_matrices=False)
        m = (u * 10.0 ** -np.linspace(0, rng.uniform(6, 16), len(vh))) @ vh
    elif family == "huge D11":
        m[rng.integers(p), rng.integers(q)] *= 10 ** rng.uniform(3, 12)
    elif family == "light damping, fast poles":  # a response next to a resonance: rank one and large, plus a rest
        m = np.outer(m[:, 0], m[0]) * 1j * 10 ** rng.uniform(2, 9) + m
    elif family == "Jordan blocks" and p == q:
        t = rng.standard_normal((p, p))
        jordan = np.eye(p) * rng.choice([1.0, -1.0, 1j, 0.0]) + np.eye(p, k=1)
        m = t @ jordan @ np.linalg.inv(t) if rng.random() < 0.5 else jordan * 10 ** rng.uniform(-1, 1)
    elif family == "near cancellations":  # real mu jumps where an eigenvalue leaves the real axis
        m = m.real + 1j * rng.choice([0.0, 1e-14, 1e-11, 1e-8, 1e-4]) * m.imag
        if rng.random() < 0.4:
            a = rng.uniform(0.5, 2)
            m = np.array([[a, a], [-a, a * (1 + 1j * 10 ** -rng.uniform(3, 15))]])
            parts = (Part("real", 1, 1), Part("real", 1, 1))
    elif family.startswith("denormals"):
        if rng.random() < 0.5:
            m = m * 10.0 ** (rng.uniform(100, 300) * rng.choice([-1, 1]))
        else:
            m = np.where(rng.random((p, q)) < 0.4, 5e-324 * rng.integers(1, 50), m)
    elif family == "units":
        low = np.tril(np.ones((p, q)), -1) + 10.0 ** -rng.integers(1, 9) * np.triu(np.ones((p, q)))
        m = m * np.where(low < 1, low, 10.0 ** rng.uniform(0, 5))
    elif family.startswith("poles"):  # Hermitian, unitary, integers, sparse, nilpotent
        kind = rng.integers(5)
        if kind == 0 and p == q:
            m = m + m.conj().T
        elif kind == 1 and p == q:
            m = np.linalg.qr(m)[0]
        elif kind == 2:
            m = np.round(3 * m.real) + 1j * np.round(3 * m.imag)
        elif kind == 3:
            m = m * (rng.random((p, q)) < 0.4)
        else:
            m = m * np.triu(np.ones((p, q)), int(rng.integers(2)))
    return {"matrix": m, "parts": parts}


def _norm(family: str, rng: Rng) -> dict[str, Any]:
    m, p = int(rng.integers(1, 4)), int(rng.integers(1, 4))
    A, B, C = _plant(family, rng, _size(rng), m, p, 0.05 if rng.random() < 0.3 else 0.0)
    A, B, dt = _sampled(rng, A, B)
    D = rng.standard_normal((p, m)) * (rng.random() < 0.5)
    if family == "huge D11":
        D = 10 ** rng.uniform(3, 12) * rng.standard_normal((p, m))
    G = Model(A, B, C, D, dt)
    return {"G": _extreme(rng, G) if family.startswith("denormals") else G}


MAKERS: dict[str, Callable[[str, Rng], dict[str, Any]]] = {
    "hinf": partial(_generalised, h2=False), "h2": partial(_generalised, h2=True), "mixsyn": _mixsyn, "ncf": _ncf,
    "margin": partial(_uncertain, n_in=0, n_out=0, level=(-0.7, 0.7)), "gain": _gain, "mu": _mu, "norm": _norm,
}  # fmt: skip
