"""Models for the benchmarks of mu: lightly damped masses, and published ones typed in from their equations."""

from __future__ import annotations

from typing import Any

import numpy as np

import robustlab as rl

Model = tuple[rl.StateSpaceModel, list[Any]]


def chain(n: int, repeats: int, seed: int, damping: float = 0.005, spread: float = 0.3) -> Model:
    """A chain of n masses on springs, lightly damped, each of n / repeats stiffnesses shared by so many springs.

    Masses and springs are in [0.5, 2] and [0.3, 3]; the first mass is pushed against the speed of the last one, seen
    through a lag at the middle frequency, at 40 % of the gain at which that loop becomes unstable. Modes that meet
    inside the set exchange what this loop does to their damping.
    """
    return _pushed_masses(np.eye(n) - np.eye(n, k=-1), repeats, np.random.default_rng(seed), damping, spread)


def spring_graph(n: int, springs: int, repeats: int, seed: int, damping: float = 0.005, spread: float = 0.3) -> Model:
    """As `chain`, but each mass hangs on a random one before it (the first on ground), and more springs join others."""
    rng = np.random.default_rng([seed, n, springs])
    ends = [(i, int(rng.integers(i)) if i else -1) for i in range(n)]
    ends += [tuple(int(i) for i in rng.choice(n, 2, replace=False)) for _ in range(springs - n)]
    elongation = np.zeros((springs, n))
    for row, (one, other) in zip(elongation, ends, strict=True):
        row[one] = 1.0
        if other >= 0:
            row[other] = -1.0
    return _pushed_masses(elongation, repeats, rng, damping, spread)


def _pushed_masses(
    elongation: np.ndarray, repeats: int, rng: np.random.Generator, damping: float, spread: float
) -> Model:
    """Return masses on springs, given by the rows of ``elongation`` (springs, masses), in the loop of `chain`."""
    springs, n = elongation.shape
    eye = np.eye(n)
    k, m = 10 ** rng.uniform(-0.5, 0.5, springs), 10 ** rng.uniform(-0.3, 0.3, n)
    stiffness, root = elongation.T @ np.diag(k) @ elongation, np.sqrt(m)
    squares, modes = np.linalg.eigh(stiffness / root[:, None] / root)
    omega = np.sqrt(squares)
    damper = root[:, None] * (modes * (2 * damping * omega)) @ modes.T * root
    order = rng.permutation(springs)
    A = np.block([[0 * eye, eye], [-stiffness / m[:, None], -damper / m[:, None]]])
    into = -(elongation.T * (spread * k))[:, order] / m[:, None]
    B = np.vstack([np.zeros((n, springs)), into, np.zeros((1, springs))])
    C = np.hstack([elongation[order], np.zeros((springs, n + 1))])
    push, speed, lag = np.eye(2 * n)[:, n : n + 1] / m[0], np.eye(2 * n)[2 * n - 1 :], 1 / np.median(omega)

    def closed(gain: float) -> np.ndarray:
        return np.block([[A, push], [-gain / lag * speed, -np.eye(1) / lag]])

    low, high = 0.0, 10.0
    for _ in range(60):
        middle = (low + high) / 2
        stable = np.linalg.eigvals(closed(middle)).real.max() < 0
        low, high = (middle, high) if stable else (low, middle)
    blocks = [rl.RealScalar(f"k{i}", repeats) for i in range(springs // repeats)]
    return rl.StateSpaceModel(closed(0.4 * low), B, C, np.zeros((springs, springs))), blocks


def platform_legs(tolerances: dict[str, float], p_low: float = 3000.0) -> Model:
    """The thesis' platform at home under two layers of PID: a parameter of its six motors is one real, six times.

    The torques that the lower layer reads are made of currents and speeds with the nominal Km and Kf. ``p_low`` is the
    triple pole (1/s) that the torque loops were designed for: at 2086.632 their six modes have damping 0.001.
    """
    import robustlab as rl
    from robustlab.dynamics import measured, two_layer

    nominal = rl.plant("stewart-platform", motors=True)
    ranges = {name: (nominal.values[name], tolerance) for name, tolerance in tolerances.items()}
    members = rl.plant("stewart-platform", motors=True, **ranges).uncertain(at=[0, 0, 0.1262, 0, 0, 0])
    M, blocks = members.M, list(members.blocks)
    q, p = sum(b.rows for b in blocks), sum(b.cols for b in blocks)
    K, read = two_layer(nominal, 236.0, p_low).state_space(), measured(nominal)
    direct, into = K.D[:, 6:] @ read, K.B[:, 6:] @ read
    B, D = M.B[:, q:], M.D[:p, q:]
    A = np.block([[M.A + B @ direct, B @ K.C], [into, K.A]])
    B_w = np.vstack([M.B[:, :q], np.zeros((K.n_states, q))])
    return rl.StateSpaceModel(A, B_w, np.hstack([M.C[:p] + D @ direct, D @ K.C]), M.D[:p, :q]), blocks


def _under(A, B, C, D, Ak, Bk, Ck, Dk) -> rl.StateSpaceModel:
    """The first three channels of a plant under u = -K y of the fourth."""
    loop = np.block([[A - B[:, 3:] * Dk @ C[3:], -B[:, 3:] @ Ck], [Bk @ C[3:], Ak]])
    C_all = np.hstack([C[:3] - D[:3, 3:] * Dk @ C[3:], -D[:3, 3:] @ Ck])
    return rl.StateSpaceModel(loop, np.vstack([B[:, :3], Bk @ D[3:, :3]]), C_all, D[:3, :3])


def two_mass() -> Model:
    """MathWorks' example: two masses and a spring, each 1 +- 20 %, under 100 ((s + 1) / (0.001 s + 1))^3.

    Published robust stability margin 2.8826 .. 2.8864 at 575.03 rad/s.
    """
    # w and z of m1, m2, k; the controller reads the position of mass 2 and pushes mass 1.
    # acceleration_1 = u - f - 0.2 w1, acceleration_2 = f - 0.2 w2, f = x1 - x2 + 0.2 w3.
    A = np.array([[0, 1, 0, 0], [-1, 0, 1, 0], [0, 0, 0, 1], [1, 0, -1, 0]], dtype=float)
    B = np.zeros((4, 4))
    B[1], B[3] = [-0.2, 0, -0.2, 1], [0, -0.2, 0.2, 0]
    C = np.array([A[1], A[3], [1, 0, -1, 0], [0, 0, 1, 0]])
    D = np.array([B[1], B[3], [0] * 4, [0] * 4])
    # One factor (s + 1) / (0.001 s + 1) = 1000 - 999000 / (s + 1000); three in series, gain 100.
    Ak, Bk, Ck, Dk = -1000.0 * np.eye(3), np.zeros((3, 1)), np.zeros((1, 3)), 100.0 * 1000.0**3
    for i in range(3):
        Ak[i, :i] = -999000.0 * 1000.0 ** np.arange(i - 1, -1, -1)
        Bk[i, 0] = 1000.0**i
        Ck[0, i] = -100.0 * 999000.0 * 1000.0 ** (2 - i)
    M = _under(A, B, C, D, Ak, Bk, Ck, Dk)
    return M, [rl.RealScalar("m1"), rl.RealScalar("m2"), rl.RealScalar("k")]


def two_parameters_with_an_island(r: float = 0.1) -> Model:
    """``s^3 + (q1 + q2 + 1) s^2 + (q1 + q2 + 3) s + 1 + r^2 + 6 q1 + 6 q2 + 2 q1 q2``: unstable inside a small circle.

    Classic of the parametric literature (Ackermann). q1 = 1.4 +- 1.1, q2 = 0.85 +- 0.85; the instability is a disk of
    radius r in the middle of a stable box.
    """
    q1, q2, h1, h2 = 1.4, 0.85, 1.1, 0.85
    s = q1 + q2
    A = np.array([[0, 1, 0], [0, 0, 1], [-(1 + r * r + 6 * s + 2 * q1 * q2), -(s + 3), -(s + 1)]])
    B = np.array([[0, 0, 0], [0, 0, 0], [-1, -1, 0]], dtype=float)
    C = np.array([[h1 * (6 + 2 * q2), h1, h1], [h2 * (6 + 2 * q1), h2, h2], [1, 0, 0]])
    D = np.zeros((3, 3))
    D[0, 2] = 2 * h1 * h2
    return rl.StateSpaceModel(A, B, C, D), [rl.RealScalar("q1"), rl.RealScalar("q2", 2)]


def spring_mass_damper() -> Model:
    """Gu, Petkov, Konstantinov: m 3 +- 40 %, c 1 +- 20 %, k 2 +- 30 %, under a stiff lead controller of our own."""
    # m x'' + c x' + k x = u; channels: w_m = delta_m z_m on 1 / m, w_c, w_k.
    A = np.array([[0, 1.0], [-2 / 3, -1 / 3]])
    B = np.array([[0, 0, 0, 0], [-0.4, -0.2 / 3, -0.3 / 3, 1 / 3]])
    C = np.array([[-2 / 3, -1 / 3], [0, 1], [2, 0], [1, 0]])
    D = np.zeros((4, 4))
    D[0] = [-0.4, -0.2 / 3, -0.3 / 3, 1 / 3]
    # u = -K y with K = 400 (s + 2) / (s + 40) + 20 / s
    Ak, Bk = np.diag([-40.0, 0.0]), np.array([[1.0], [1.0]])
    Ck, Dk = np.array([[400.0 * -38, 20.0]]), 400.0
    return _under(A, B, C, D, Ak, Bk, Ck, Dk), [rl.RealScalar("m"), rl.RealScalar("c"), rl.RealScalar("k")]


PUBLISHED = {
    "two-mass (MathWorks; truth 2.88636)": two_mass,
    "island (Ackermann)": two_parameters_with_an_island,
    "mass-spring-damper (Gu, Petkov, Konstantinov)": spring_mass_damper,
}
