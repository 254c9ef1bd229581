"""The same loop by every route, and 200 random sets judged by closed forms: bounds, gap, CPU and counted work."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import scipy
from harness import heading, middle_and_most, timed

import robustlab as rl
from robustlab.budget import listening, one_thread

SETS, GAP, SECONDS = 200, 0.01, 2.0


def random_set(seed: int) -> rl.UncertainModel:
    """2 to 6 states, 1 to 3 parameters, each 1 to 3 times; every other set one-sided, every third one discrete."""
    rng = np.random.default_rng([40, seed])
    n, count, dt = int(rng.integers(2, 7)), int(rng.integers(1, 4)), 0.5 if seed % 3 == 2 else 0.0
    A = np.zeros((n, n))
    for i in range(0, n - 1, 2):
        w, zeta = 10 ** rng.uniform(-1, 1.5), 10 ** rng.uniform(-4, 0)
        A[i : i + 2, i : i + 2] = [[-zeta * w, w], [-w, -zeta * w]]
    if n % 2:
        A[-1, -1] = -(10 ** rng.uniform(-1, 1))
    mix = np.eye(n) + 0.3 * rng.standard_normal((n, n)) / np.sqrt(n)
    A = mix @ A @ np.linalg.inv(mix)
    A = scipy.linalg.expm(dt * A) if dt else A
    blocks = []
    for i in range(count):
        above = 10 ** rng.uniform(-1, 1)
        below = above * 10 ** rng.uniform(-1.2, 0.5) if seed % 2 else None
        blocks.append(rl.RealScalar(f"d{i}", int(rng.integers(1, 4)), rl.ParameterRange(0.5, above, "", below)))
    q = sum(b.rows for b in blocks)
    B, C = rng.standard_normal((n, q)), rng.standard_normal((q, n))
    scale = 10 ** rng.uniform(-1.5, 0)
    return rl.UncertainModel(rl.StateSpaceModel(A, B * scale, C * scale, np.zeros((q, q)), dt), blocks)


def closed_form(uncertain: rl.UncertainModel) -> float:
    """Exact margin of a set of one parameter: the real e at which two poles of A + e B C mirror each other, or meet 0.

    In discrete time the products of two poles are 1. The smallest e counts that has a pole on the boundary.
    """
    M = uncertain.M
    A, E, eye, discrete = M.A, M.B @ M.C, np.eye(M.n_states), M.is_discrete
    kron, zero = np.kron, np.zeros((M.n_states**2,) * 2)
    if discrete:
        parts = kron(A, A) - kron(eye, eye), kron(A, E) + kron(E, A), kron(E, E)
    else:
        parts = kron(A, eye) + kron(eye, A), kron(E, eye) + kron(eye, E), zero
    # parts[0] + e parts[1] + e^2 parts[2] is singular, in one over e
    companion = np.block([[-np.linalg.solve(parts[0], part) for part in parts[1:]], [np.eye(len(zero)), zero]])
    low, _ = uncertain.blocks[0].interval or (-1.0, 1.0)
    inverse = np.linalg.eigvals(companion)
    sizes = []
    for e in 1 / inverse.real[(np.abs(inverse.imag) < 1e-6 * np.abs(inverse)) & (np.abs(inverse) > 1e-12)]:
        poles = np.linalg.eigvals(A + e * E)
        if abs(np.max(np.abs(poles) - 1 if discrete else poles.real / np.abs(A).max())) < 1e-6:
            sizes.append(e if e > 0 else e / low)
    return min(sizes, default=np.inf)


def attacked(uncertain: rl.UncertainModel, size: float, seed: int) -> bool:
    """Whether a vertex, or one of 4000 random members of the set of this size, is unstable."""
    rng, M, blocks = np.random.default_rng(seed), uncertain.M, uncertain.blocks
    k, ends = len(blocks), [b.interval or (-1.0, 1.0) for b in blocks]
    places = np.vstack([np.array(np.meshgrid(*[(-1.0, 1.0)] * k)).reshape(k, -1).T, rng.uniform(-1, 1, (4000, k))])
    values = size * np.where(places > 0, places, -places * np.array([low for low, _ in ends]))
    delta = np.repeat(values, [b.rows for b in blocks], axis=1)
    poles = np.linalg.eigvals(M.A + (M.B * delta[:, None, :]) @ M.C)
    return bool((np.abs(poles).max() >= 1) if M.is_discrete else (poles.real.max() >= 0))


def routes() -> Iterator[tuple[str, rl.UncertainModel]]:
    """One loop of seven parameters: closed twice, states and channels in other orders, hidden and unused ones added."""
    rng = np.random.default_rng(0)
    unclosed, K = two_trolleys()
    loop = unclosed.feedback(K)
    M, blocks, n, q = loop.M, loop.blocks, loop.M.n_states, sum(b.rows for b in loop.blocks)
    yield "feedback", loop
    G, k = unclosed.M, K.n_states  # u = -K y by hand, the controller's states first
    Bu, Cy = G.B[:, q:], G.C[q:]
    A = np.block([[K.A, K.B @ -Cy], [Bu @ K.C, G.A - Bu @ K.D @ Cy]])
    B, C = np.vstack([np.zeros((k, q)), G.B[:, :q]]), np.hstack([np.zeros((q, k)), G.C[:q]])
    C, D = C + G.D[:q, q:] @ np.hstack([K.C, -K.D @ Cy]), G.D[:q, :q]
    yield "closed by hand", rl.UncertainModel(rl.StateSpaceModel(A, B, C, D), blocks)
    for i in range(6):
        yield f"states permuted {i}", rl.UncertainModel(moved(M, np.eye(n)[rng.permutation(n)]), blocks)
    T = np.linalg.qr(rng.standard_normal((n, n)))[0] * 10 ** rng.uniform(-1, 1, n)
    yield "states turned and scaled", rl.UncertainModel(moved(M, T), blocks)
    for i in range(4):
        p = rng.permutation(q)
        w, z = np.append(p, np.arange(q, M.n_inputs)), np.append(p, np.arange(q, M.n_outputs))
        turned = rl.StateSpaceModel(M.A, M.B[:, w], M.C[z], M.D[np.ix_(z, w)])
        yield f"channels permuted {i}", rl.UncertainModel(turned, [blocks[j] for j in p])
    B, C = np.vstack([M.B, rng.standard_normal((1, M.n_inputs))]), np.hstack([M.C, np.zeros((M.n_outputs, 1))])
    hidden = rl.StateSpaceModel(scipy.linalg.block_diag(M.A, -1.0), B, C, M.D)
    turn = np.linalg.qr(rng.standard_normal((n + 1, n + 1)))[0]
    yield "with a hidden state, turned", rl.UncertainModel(moved(hidden, turn), blocks)
    B, C, D = np.insert(M.B, 0, 1.0, axis=1), np.insert(M.C, 0, 0.0, axis=0), np.pad(M.D, ((1, 0), (1, 0)))
    yield "an unused channel", rl.UncertainModel(rl.StateSpaceModel(M.A, B, C, D), [rl.RealScalar("unused"), *blocks])


def two_trolleys() -> tuple[rl.UncertainModel, rl.StateSpaceModel]:
    """Two coupled trolleys with seven uncertain entries, and a mixed-sensitivity controller."""

    def made(m: float, k: float, b: float) -> rl.StateSpaceModel:
        A = [[0, 0, 1, 0], [0, 0, 0, 1], [-40 - k, k, -b, 0], [k / m, -(k + 20) / m, 0, -b / m]]
        return rl.StateSpaceModel(A, [[0, 0], [0, 0], [1, 0], [0, 1 / m]], np.eye(2, 4), np.zeros((2, 2)))

    weights = rl.performance_weight(2, 0.01), rl.control_weight(300), rl.complementary_weight(20)
    return rl.elementwise(made(2.0, 30.0, 0.8), made(2.3, 36.0, 0.6)), rl.mixsyn(made(2.0, 30.0, 0.8), *weights).K


def moved(m: rl.StateSpaceModel, T: np.ndarray) -> rl.StateSpaceModel:
    back = np.linalg.inv(T)
    return rl.StateSpaceModel(T @ m.A @ back, T @ m.B, m.C @ back, m.D)


def main() -> None:
    print(heading("numpy", "scipy"))
    rl.robust_stability(random_set(0))  # compiled kernels are not timed
    print(f"{'route to one loop':28s} {'margin':>22s} {'parts':>6s} {'work':>8s} {'CPU s':>7s}")
    for name, uncertain in routes():
        margin, work, spent = solved(uncertain)
        print(f"{name:28s} {margin.lower:10.6f} .. {margin.upper:8.6f} {len(margin.proof):6d} {work:8.0f} {spent:7.2f}")
    rows, wrong = [], []
    for seed in range(SETS):
        uncertain = random_set(seed)
        margin, _, spent = solved(uncertain)
        truth = closed_form(uncertain) if len(uncertain.blocks) == 1 else np.nan
        gap = 0.0 if margin.upper == np.inf and margin.lower > 1e3 else margin.gap
        rows.append((gap, spent))
        if margin.lower > truth * (1 + 1e-6) or margin.upper < truth * (1 - 1e-6):
            wrong.append(f"{seed}: closed form {truth:.8g}, outside {margin.lower:.8g} .. {margin.upper:.8g}")
        if attacked(uncertain, min(0.9999 * margin.lower, 1e3), seed):
            wrong.append(f"{seed}: a member inside {margin.lower:.8g} is unstable")
        if gap > GAP * (1 + 1e-6) or spent > SECONDS:
            sizes = f"{uncertain.M.n_states} states, {[b.rows for b in uncertain.blocks]}, {margin.status.value}"
            print(f"set {seed}: {sizes}, {margin.lower:.6g} .. {margin.upper:.6g} ({truth:.6g}), {spent:.2f} s")
    gaps, times = zip(*rows, strict=True)
    print(f"{len(rows)} random sets: median and largest gap {middle_and_most(gaps, '.6f')}, ", end="")
    print(f"CPU s {middle_and_most(times, '.3f')}; outside the truth: {len(wrong)}")
    print("\n".join(wrong))


def solved(uncertain: rl.UncertainModel) -> tuple[rl.Margin, float, float]:
    """The margin, the work it counted, and its CPU time in s."""
    done: list[float] = [0.0]
    with listening(lambda work, _: done.append(work)):
        margin, spent = timed(rl.robust_stability, uncertain)
    return margin, max(done), spent


if __name__ == "__main__":
    with one_thread():
        main()
