"""Lower bounds of mu: quality and CPU time. ``python benchmarks/mu_lower.py [share]``.

Matrices: lower over our certified upper bound (median, 10 % quantile, how many are 0), ms per matrix of a stack and of
one on its own. Models: norm of the destabilising Delta, seconds each. The results beside the research code that this
was built from are in benchmarks/results/mu_lower.txt.
"""

from __future__ import annotations

import sys
from typing import Any

import numpy as np
from harness import timed
from mu_models import CLASSES, KINDS, PUBLISHED, random_matrices, structure

from robustlab.budget import one_thread
from robustlab.mu_analysis.axis.axis_model import continuous, seed_frequencies
from robustlab.mu_analysis.axis.pole_migration import smallest_destabilising
from robustlab.mu_analysis.matrix.lower import lower_bound, lower_bounds
from robustlab.mu_analysis.matrix.upper import upper_bounds


def matrices(share: float) -> None:
    """One line per kind and size."""
    print("matrices: lower / upper; ms CPU per matrix\nkind          n  | median   q10  zeros  ms stack  ms one")
    for kind in KINDS:
        for n in (2, 4, 6, 12, 24):
            blocks = structure(kind, n)
            stack = random_matrices(kind, n, max(2, round(share * (12 if n < 24 else 6)))) if blocks else np.zeros(0)
            upper = np.array([b.beta for b in upper_bounds(stack, blocks)] if blocks else [])
            stack, upper = stack[upper > 0], upper[upper > 0]
            if len(stack):
                found, seconds = timed(lower_bounds, stack, blocks)
                _, single = timed(lower_bound, stack[0], blocks)
                ratio = np.array([v for v, _ in found]) / upper
                text = (
                    f"{np.median(ratio):6.4f} {np.quantile(ratio, 0.1):6.4f} {(ratio == 0).sum():3d}/{len(ratio):<2d}"
                )
                print(f"{kind:12s} {n:2d}  | {text} {1e3 * seconds / len(stack):8.1f} {1e3 * single:8.1f}", flush=True)


def models(share: float) -> None:
    """One line per class of models."""
    print("\nmodels: norm of the smallest destabilising Delta: least, median, largest; median CPU s")
    makers: dict[str, list[Any]] = {
        name: [make(s) for s in range(max(1, round(20 * share)))] for name, make in CLASSES.items()
    }
    for name, cases in {**makers, **{name: [make()] for name, make in PUBLISHED.items()}}.items():
        norms, spent = [], []
        for given, blocks in cases:
            model = continuous(given)
            found, seconds = timed(smallest_destabilising, model, blocks, seed_frequencies(model))
            norms.append(found.norm if found else np.inf)
            spent.append(seconds)
        ends = f"{min(norms):9.5f} {np.median(norms):9.5f} {max(norms):9.5f}"
        print(f"{name:48s} | {ends} {np.median(spent):6.2f}", flush=True)


if __name__ == "__main__":
    with one_thread():  # spinning threads of a busy machine would be counted as work
        given = float(sys.argv[1]) if len(sys.argv) > 1 else 1.0
        matrices(given)
        models(given)
