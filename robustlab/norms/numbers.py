"""The datasets of a claim, from models and blocks of the library."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robustlab.statespace import StateSpaceModel

Numbers = dict[str, NDArray[Any]]

ABOVE = 1 + 1e-6  # ratio of the claimed to the computed level, so that the evidence holds with a margin


def above(number: float) -> float:
    """Return the level claimed for a computed number."""
    return float(number * ABOVE) if number > 0 else 1e-300


def matrices(model: StateSpaceModel, name: str = "{}") -> Numbers:
    """Return ``A, B, C, D`` under the names ``name``."""
    return {name.format(letter): getattr(model, letter) for letter in "ABCD"}


def model_numbers(model: StateSpaceModel) -> Numbers:
    """Return a model's matrices with its dt in s."""
    return {**matrices(model), "dt": np.array(float(model.dt))}


def loop_numbers(plant: StateSpaceModel, K: StateSpaceModel) -> Numbers:
    """Return a plant and the controller u = K y of its last outputs and inputs."""
    return {
        **matrices(plant, "P_{}"), **matrices(K, "K_{}"), "dt": np.array(float(plant.dt)),
        "n_meas": np.array(K.n_inputs, dtype=np.int64), "n_con": np.array(K.n_outputs, dtype=np.int64),
    }  # fmt: skip


def block_rows(blocks: Sequence[Any]) -> NDArray[np.int64]:
    """Return ``[kind, rows, cols]`` of each block: 0 real, 1 complex number times I, 2 a full matrix or another set."""
    rows = [(0 if b.interval else 1 if b.is_scalar else 2, b.rows, b.cols) for b in blocks]
    return np.array(rows, dtype=np.int64).reshape(-1, 3)
