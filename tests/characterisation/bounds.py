"""mu of matrices of every kind of structure."""

from collections.abc import Iterator
from typing import Any

import robustlab as rl

from .cases import Case, seeds

RTOL = 1e-4
KINDS = ("real", "real x2", "real M", "mixed", "mixed x2", "mixed full", "complex", "complex x2", "full", "wide")


def cases() -> Iterator[Case]:
    """Four sizes of each kind."""
    for kind in KINDS:
        for n in (2, 4, 6, 12):
            yield Case(f"mu {kind} {n}", lambda kind=kind, n=n: mu(kind, n))
    for kind in ("real", "mixed"):
        yield Case(f"mu {kind} 6, cut", lambda kind=kind: mu(kind, 6, tolerance=0.01, seed=1))


def mu(kind: str, n: int, seed: int = 0, **options: Any) -> dict[str, Any]:
    """Both bounds of a matrix with normal entries."""
    blocks = structure(kind, n)
    rng = seeds(2, n, KINDS.index(kind), seed)
    # The channels of a block are its columns in w and its rows in z.
    shapes = [(getattr(b, "cols", 1), getattr(b, "rows", 1)) for b in blocks]
    p, q = sum(s[0] for s in shapes), sum(s[1] for s in shapes)
    M = rng.standard_normal((p, q)) + (0j if kind == "real M" else 1j * rng.standard_normal((p, q)))
    found = rl.mu(M, blocks, **options)
    return {"status": found.status, "mu": {"lower": found.lower, "upper": found.upper}}


def structure(kind: str, n: int) -> list[Any]:
    """Blocks of about n columns in all."""
    if kind in ("real", "real M"):
        return [rl.RealScalar(f"d{i}") for i in range(n)]
    if kind == "real x2":
        return [rl.RealScalar(f"d{i}", 2) for i in range(n // 2)]
    if kind == "complex":
        return [rl.ComplexScalar(f"d{i}") for i in range(n)]
    if kind == "complex x2":
        return [rl.ComplexScalar(f"d{i}", 2) for i in range(n // 2)]
    if kind in ("full", "wide"):
        return [rl.FullBlock(f"d{i}", 2 if kind == "full" else 1, 2) for i in range(n // 2)]
    real = [rl.RealScalar(f"r{i}", 2 if kind == "mixed x2" else 1) for i in range(max(n // 4, 1))]
    left = n - sum(b.rows for b in real)
    if kind == "mixed full":
        return [*real, *(rl.FullBlock(f"f{i}", 2, 2) for i in range(left // 2))]
    if kind == "mixed x2":
        return [*real, *(rl.ComplexScalar(f"c{i}", 2) for i in range(left // 2))]
    return [*real, *(rl.ComplexScalar(f"c{i}") for i in range(left))]
