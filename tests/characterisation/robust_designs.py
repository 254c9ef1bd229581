"""D-K designs of small plants."""

import json
from collections.abc import Iterator
from typing import Any

import numpy as np

import robustlab as rl

from .cases import SHARED, Case, seeds

RTOL = 1e-3
# With the usual effort a design takes up to minutes.
SHORT = 0.02


def cases() -> Iterator[Case]:
    """Twelve."""
    real = [rl.RealScalar("k"), rl.FullBlock("p", 2, 2)]
    complex_ = [rl.ComplexScalar("k"), rl.FullBlock("p", 2, 2)]
    for name, plant in (("oscillator", oscillator), ("two masses", two_masses)):
        yield Case(f"dk {name}, complex", lambda plant=plant: dk(plant(), complex_, 1, 1), name == "two masses")
        yield Case(f"dk {name}, real", lambda plant=plant: dk(plant(), real, 1, 1), True)
    for seed in range(6):
        yield Case(f"dk random {seed}", lambda seed=seed: dk(random_plant(seed), complex_, 1, 1), True)
    for file in ("mass_damper_spring", "distillation_column"):
        yield Case(f"dk {file}", lambda file=file: shared(file), True, True)


def dk(plant: Any, blocks: list[Any], n_y: int, n_u: int) -> dict[str, Any]:
    """The level; a proof of its own takes minutes (`rl.verify`) and is left out."""
    found = rl.dk(plant, blocks, n_y, n_u, effort=SHORT)
    return {"status": found.status, "gamma": found.gamma}


def oscillator() -> Any:
    """x'' = -(1 + 0.5 delta) x - 0.02 x' + u + 0.1 d, y = x + 0.1 n, z = [x; u]."""
    D = np.zeros((4, 4))
    D[2, 3], D[3, 2] = 1.0, 0.1
    B, C = [[0, 0, 0, 0], [-1, 0.1, 0, 1]], [[0.5, 0], [1, 0], [0, 0], [1, 0]]
    return rl.StateSpaceModel([[0, 1], [-1, -0.02]], B, C, D)


def two_masses() -> Any:
    """Two unit masses, a spring 1 + 0.5 delta and a damper 0.02 between them; u on the first, the second is seen."""
    c, D = 0.02, np.zeros((4, 4))
    A = [[0, 0, 1, 0], [0, 0, 0, 1], [-1, 1, -c, c], [1, -1, c, -c]]
    B = [[0, 0, 0, 0], [0, 0, 0, 0], [-1, 0, 0, 1], [1, 0.05, 0, 0]]
    D[2, 3], D[3, 2] = 0.5, 0.05
    return rl.StateSpaceModel(A, B, [[0.5, -0.5, 0, 0], [0, 0.5, 0, 0], [0, 0, 0, 0], [0, 1, 0, 0]], D)


def random_plant(seed: int) -> Any:
    """Three states, one uncertain channel, two of performance, a measurement with noise and a control with a cost."""
    rng = seeds(1, seed)
    A = rng.standard_normal((3, 3)) - np.eye(3)
    B, C = rng.standard_normal((3, 4)), rng.standard_normal((4, 3))
    D = np.zeros((4, 4))
    D[2, 3], D[3, 2] = 0.5, 0.3
    B[:, 2] = C[2] = 0.0
    B[:, 0], C[0] = 0.4 * B[:, 0], 0.4 * C[0]
    return rl.StateSpaceModel(A, B, C, D)


def shared(file: str) -> dict[str, Any]:
    """Return a published plant of the data next to the checkout."""
    data = json.loads((SHARED / "robust-designs" / f"{file}.json").read_text(encoding="utf-8"))
    m = {key: np.array(value, dtype=float) for key, value in data["plant"].items()}
    n_y, n_u = len(m["C"]), m["B"].shape[1]
    D = np.block([[m["D11"], m["D12"]], [m["D21"], np.zeros((n_y, n_u))]])
    plant = rl.StateSpaceModel(m["A"], np.hstack([m["B1"], m["B"]]), np.vstack([m["C1"], m["C"]]), D)
    blocks = [block(k, b) for k, b in enumerate(data["blocks"])]
    return dk(plant, blocks[:-1] if file == "distillation_column" else blocks, n_y, n_u)


def block(k: int, b: dict[str, Any]) -> Any:
    """A block of the file."""
    if b["type"] == "real":
        return rl.RealScalar(f"d{k}", b["size"])
    return rl.ComplexScalar(f"d{k}") if b["size"] == 1 else rl.FullBlock(f"d{k}", b["size"], b["size"])
