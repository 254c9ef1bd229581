"""Lower bounds of mu, ours beside the prototype's, quality and CPU time, in one run.

Matrices: lower over our certified upper bound (median, 10 % quantile, how many are 0), ms per matrix of a stack and of
one on its own; where the structure is purely real, beside the true mu to 1 % that branch and bound finds. Models: norm
of the destabilising Delta over the best of both, seconds each.

``python benchmarks/mu_lower.py [share]``; the prototype is taken from ../shared/prototypes/mu where it is there.
"""

from __future__ import annotations

import sys
import time
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from mu_models import CLASSES, KINDS, PUBLISHED, random_matrices, structure

from robustlab.budget import one_thread
from robustlab.mu_analysis.axis.pole_migration import smallest_destabilising
from robustlab.mu_analysis.matrix.lower import lower_bound, lower_bounds
from robustlab.mu_analysis.matrix.upper import upper_bounds
from robustlab.uncertainty.blocks import Block, ComplexScalar, RealScalar

PROTOTYPE = Path(__file__).resolve().parents[2] / "shared" / "prototypes" / "mu"


def prototype_rows(blocks: Sequence[Block]) -> list[tuple[str, int, int]]:
    """Blocks as the prototype writes them."""
    return [
        ("r" if isinstance(b, RealScalar) else "c" if isinstance(b, ComplexScalar) else "f", b.rows, b.cols)
        for b in blocks
    ]


def timed(call: Callable[[], Any]) -> tuple[Any, float]:
    """What a call returns, and its CPU seconds."""
    started = time.process_time()
    result = call()
    return result, time.process_time() - started


def compare_matrices(prototype: Any, share: float) -> None:
    """One line per kind and size."""
    print("matrices: lower / upper; ours and prototype (12 starts, 40 steps); ms CPU per matrix")
    print("kind          n  | median   q10  zeros  ms stack  ms one | median   q10  zeros  ms stack")
    for kind in KINDS:
        for n in (2, 4, 6, 12, 24):
            blocks = structure(kind, n)
            if not blocks:
                continue
            stack = random_matrices(kind, n, max(2, round(share * (12 if n < 24 else 6))))
            upper = np.array([b.beta for b in upper_bounds(stack, blocks)])
            some = upper > 0
            if not some.any():
                continue
            stack, upper = stack[some], upper[some]
            found, seconds = timed(lambda s=stack, b=blocks: lower_bounds(s, b))
            _, single = timed(lambda s=stack, b=blocks: lower_bound(s[0], b))
            line = [summary(np.array([v for v, _ in found]) / upper), 1e3 * seconds / len(stack), 1e3 * single]
            text = f"{kind:12s} {n:2d}  | {line[0]} {line[1]:8.1f} {line[2]:8.1f}"
            if prototype is not None:
                rows = prototype_rows(blocks)
                theirs, seconds = timed(lambda s=stack, r=rows: prototype_bounds(prototype, s, r))
                text += f" | {summary(theirs / upper)} {1e3 * seconds / len(stack):8.1f}"
            print(text, flush=True)


def prototype_bounds(prototype: Any, stack: np.ndarray, rows: list[tuple[str, int, int]]) -> np.ndarray:
    """The better of the prototype's two methods."""
    bounds, _, _ = prototype.slm(stack, rows, restarts=12, iters=40)
    if all(row[0] != "r" for row in rows):
        bounds = np.maximum(bounds, prototype.power(stack, rows, restarts=12)[0])
    return np.where(np.isfinite(bounds), bounds, 0.0)


def summary(ratio: np.ndarray) -> str:
    """Median, 10 % quantile, number of zeros."""
    return f"{np.median(ratio):6.4f} {np.quantile(ratio, 0.1):6.4f} {(ratio == 0).sum():3d}/{len(ratio):<2d}"


def compare_truth(prototype: Any, share: float) -> None:
    """Ours over what branch and bound (prototype, 20 s each, it searches as well) attains."""
    import bnb  # pyright: ignore[reportMissingImports]

    print("\npurely real, up to 12 columns: ours / best lower bound of branch and bound (proved to 1 % or 20 s)")
    for kind, n in (
        ("real", 4),
        ("real", 6),
        ("real", 8),
        ("real", 12),
        ("real x2", 6),
        ("real x2", 12),
        ("real M", 12),
    ):
        blocks = structure(kind, n)
        stack = random_matrices(kind, n, max(2, round(10 * share)), 1)
        ours = np.array([v for v, _ in lower_bounds(stack, blocks)])
        best, proved = [], 0
        for m, own in zip(stack, ours, strict=True):
            rows = prototype_rows(blocks)
            bound, delta, _ = prototype.slm(m[None], rows, restarts=30, iters=40)
            if not 0 < bound[0] < np.inf:
                best.append(own)
                continue
            value, _, upper, _, _ = bnb.close_gap(m, rows, bound[0], delta[0], eps_list=(0.01,), tlimit=20)
            best.append(value)
            proved += upper is not None
        ratio = ours / np.maximum(np.array(best), 1e-300)
        print(
            f"{kind:8s} {n:2d}: {(ratio >= 0.99).sum()} of {len(ratio)} within 1 %, least {ratio.min():.4f}, largest "
            f"{ratio.max():.4f}, {proved} proved",
            flush=True,
        )


def compare_models(prototype: Any, share: float) -> None:
    """One line per class of models."""
    from robustlab.mu_analysis.axis.axis_model import continuous, seed_frequencies

    print("\nmodels: norm of the smallest destabilising Delta over the best of both; median CPU s")
    print(f"{'class':48s} | ours: within 1e-4, worst, s | prototype: within 1e-4, worst, s")
    makers: dict[str, list[Any]] = {
        name: [make(s) for s in range(max(1, round(20 * share)))] for name, make in CLASSES.items()
    }
    makers.update({name: [make()] for name, make in PUBLISHED.items()})
    for name, cases in makers.items():
        ours, theirs, own_seconds, their_seconds = [], [], [], []
        for model, blocks in cases:
            model = continuous(model)
            found, seconds = timed(lambda m=model, b=blocks: smallest_destabilising(m, b, seed_frequencies(m)))
            ours.append(found.norm if found else np.inf)
            own_seconds.append(seconds)
            if prototype is not None:
                args = (model.A, model.B, model.C, model.D, prototype_rows(blocks))
                result, seconds = timed(lambda a=args: prototype_axis(a))
                theirs.append(1 / result if result > 0 else np.inf)
                their_seconds.append(seconds)
        best = np.minimum(ours, theirs) if theirs else np.array(ours)
        text = f"{name:48s} | {against(np.array(ours), best)} {np.median(own_seconds):6.2f}"
        if theirs:
            text += f" | {against(np.array(theirs), best)} {np.median(their_seconds):6.2f}"
        print(text, flush=True)


def prototype_axis(args: tuple[Any, ...]) -> float:
    """The prototype's lower bound of mu over the axis."""
    import ssmu  # pyright: ignore[reportMissingImports]

    return float(ssmu.lower_axis(*args)[0])


def against(norms: np.ndarray, best: np.ndarray) -> str:
    """How many are within 1e-4 of the best, and the worst ratio."""
    ratio = norms / best
    return f"{(ratio <= 1 + 1e-4).sum():2d} of {len(ratio):2d} {ratio.max():9.5f}"


def main(share: float = 1.0) -> None:
    """Everything in turn."""
    warnings.simplefilter("ignore")
    prototype = None
    if PROTOTYPE.exists():
        sys.path.insert(0, str(PROTOTYPE))
        import lower as prototype  # pyright: ignore[reportMissingImports]
    compare_matrices(prototype, share)
    if prototype is not None:
        compare_truth(prototype, share)
    compare_models(prototype, share)


if __name__ == "__main__":
    with one_thread():  # spinning threads of a busy machine would be counted as work
        main(float(sys.argv[1]) if len(sys.argv) > 1 else 1.0)
