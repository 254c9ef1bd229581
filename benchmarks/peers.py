"""Compare CPU times with peers on the same problem: norms, reduction, synthesis, mu; 3, 20 and 60 states.

    python benchmarks/peers.py [--repeats 15] [NAME ...]

All in one process and one run, one BLAS thread, warm, the minimum of several alternating calls; fixed seeds. robustlab
returns the number with its evidence (bracket, second path, verified loop, certificate); the peers return the number.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable, Iterator
from functools import partial

import control
import numpy as np
import slycot
from harness import heading, options

import robustlab as rl
from robustlab.budget import one_thread
from robustlab.norms import h2_norm

SIZES = (3, 20, 60)
Case = tuple[str, int, Callable[[], object], Callable[[], object]]


def random_model(n: int, n_u: int = 2, n_y: int = 2) -> rl.StateSpaceModel:
    """Stable, strictly proper, damping between 1 % and 100 %, poles over three decades."""
    rng = np.random.default_rng(1000 + n)
    A = np.zeros((n, n))
    for k in range(0, n - 1, 2):
        size, damping = 10 ** rng.uniform(-1, 2), 10 ** rng.uniform(-2, 0)
        turn = size * np.sqrt(1 - damping**2)
        A[k : k + 2, k : k + 2] = [[-damping * size, turn], [-turn, -damping * size]]
    if n % 2:
        A[-1, -1] = -(10 ** rng.uniform(-1, 2))
    T = np.linalg.qr(rng.standard_normal((n, n)))[0] * 10 ** rng.uniform(-0.5, 0.5, n)
    B, C = rng.standard_normal((n, n_u)), rng.standard_normal((n_y, n))
    return rl.StateSpaceModel(np.linalg.solve(T, A @ T), B, C, np.zeros((n_y, n_u)))


def random_plant(n: int) -> rl.StateSpaceModel:
    """Two measurements and controls; w is disturbances and noises, z outputs and controls: a regular problem."""
    G = random_model(n, 4, 4)
    one, none = np.eye(2), np.zeros((2, 2))
    B = np.hstack([G.B[:, :2], np.zeros((n, 2)), G.B[:, 2:]])
    C = np.vstack([G.C[:2], np.zeros((2, n)), G.C[2:]])
    D = np.block([[none, none, none], [none, none, one], [none, one, none]])
    return rl.StateSpaceModel(G.A, B, C, D)


def cases() -> Iterator[Case]:
    for n in SIZES:
        G, P = random_model(n), random_plant(n)
        theirs, plant, r = G.to_control(), P.to_control(), max(1, n // 3)
        abcd = G.A, G.B, G.C, G.D
        at = partial(slycot.ab13dd, "C", "I", "S", "D", n, 2, 2, G.A, np.eye(n), *abcd[1:], 1e-6)
        yield "hinf_norm / slycot ab13dd", n, lambda G=G: rl.peak_gain(G).value, at
        square = lambda n=n, abcd=abcd: slycot.ab13bd("C", "H", n, 2, 2, *(m.copy() for m in abcd))  # noqa: E731
        yield "h2_norm / slycot ab13bd", n, lambda G=G: h2_norm(G).value, square
        yield "reduce_model / control.balred", n, partial(rl.reduce_model, G, r), partial(control.balred, theirs, r)
        proved = lambda G=G, r=r: rl.reduce_model(G, r).error  # noqa: E731
        yield "reduce_model and its error / control.balred", n, proved, partial(control.balred, theirs, r)
        yield "h2 / control.h2syn", n, partial(rl.h2, P, 2, 2), partial(control.h2syn, plant, 2, 2)
        yield "hinf / control.hinfsyn", n, partial(rl.hinf, P, 2, 2), partial(control.hinfsyn, plant, 2, 2)
    for count in (4, 12):
        rng = np.random.default_rng(count)
        M = rng.standard_normal((count, count)) + 1j * rng.standard_normal((count, count))
        sizes = np.ones(count, dtype=int)
        name = f"mu, {count} complex scalars / slycot ab13md"
        yield name, count, partial(rl.mu, M, [[1, 0]] * count), partial(slycot.ab13md, M, sizes, 2 * sizes)


def fastest(calls: tuple[Callable[[], object], ...], repeats: int, patience: float = 8.0) -> list[float]:
    """Least CPU milliseconds of each call, called in turn; slow ones fewer times, at least three."""
    for call in calls:
        call()
    least, started = [np.inf] * len(calls), time.process_time()
    for turn in range(repeats):
        for k, call in enumerate(calls):
            before = time.process_time()
            call()
            least[k] = min(least[k], 1e3 * (time.process_time() - before))
        if turn >= 2 and time.process_time() - started > patience:
            break
    return least


def main() -> None:
    given = options(__doc__, "*", repeats=15)
    print(heading("robustlab", "numpy", "scipy", "slycot", "control"))
    print(f"\n{'ours / peer':44s} {'size':>4s} {'ours ms':>9s} {'peer ms':>9s} {'ratio':>7s}")
    warnings.simplefilter("ignore")
    with one_thread():
        for name, n, ours, peer in sorted(cases(), key=lambda case: case[0]):
            if given.names and not any(name.startswith(wanted) for wanted in given.names):
                continue
            own, other = fastest((ours, peer), given.repeats)
            print(f"{name:44s} {n:4d} {own:9.2f} {other:9.2f} {own / other:7.1f}", flush=True)


if __name__ == "__main__":
    main()
