"""mu upper bound: time per matrix and tightness, ours (certified) against raw slycot.ab13md, in one run."""

from __future__ import annotations

import time

import numpy as np
import slycot
from threadpoolctl import threadpool_limits

from robustlab.mu_analysis.upper import upper_bounds
from robustlab.uncertainty.blocks import RealScalar


def main(count: int = 10) -> None:
    """Print one line per order of purely real uncertainty."""
    rng = np.random.default_rng(0)
    upper_bounds(np.ones((1, 2, 2), dtype=complex), [RealScalar("a"), RealScalar("b")])  # imports are not timed
    print("real scalars   ours ms   ab13md ms   time ratio   bound ratio (min .. max)")
    for n in (6, 12, 24):
        M = rng.standard_normal((count, n, n)) + 1j * rng.standard_normal((count, n, n))
        blocks = [RealScalar(f"d{i}") for i in range(n)]
        started = time.process_time()
        ours = np.array([bound.beta for bound in upper_bounds(M, blocks)])
        middle = time.process_time()
        peer = np.array([slycot.ab13md(m, np.ones(n, dtype=int), np.ones(n, dtype=int))[0] for m in M])
        ended = time.process_time()
        own_ms, peer_ms = (1e3 * t / count for t in (middle - started, ended - middle))
        ratio = ours / peer
        print(
            f"{n:12d} {own_ms:9.1f} {peer_ms:11.1f} {own_ms / peer_ms:12.2f}   {ratio.min():.9f} .. {ratio.max():.9f}"
        )


if __name__ == "__main__":
    with threadpool_limits(1):  # spinning threads of a busy machine would be counted as work
        main()
