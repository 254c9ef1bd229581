"""Preparation of the Delta channels of an uncertain model for proofs over the frequency axis."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robustlab.arrays import AnyArray, Array, Mask
from robustlab.errors import InputError, NoTrustworthyNumber
from robustlab.linear_analysis.frequency import modes_apart, narrow_frequencies
from robustlab.linear_analysis.matrices import balancing_factors
from robustlab.linear_analysis.structural import strong_components, with_hidden
from robustlab.statespace import StateSpaceModel
from robustlab.uncertainty.blocks import Block, block_slices
from robustlab.uncertainty.lft import UncertainModel

MOST = 1e100  # largest entry of M that is accepted
HIDDEN = 1e-8  # share of the largest eigenvalue of a Gramian below which a direction counts as hidden
TINY = 1e-100  # norm of A below which Gramians overflow or vanish


def check_nominal(uncertain: UncertainModel, where: str) -> None:
    """Reject an argument that is no uncertain model, and a model whose nominal member is not stable."""
    if not isinstance(uncertain, UncertainModel):
        raise InputError(where, type(uncertain).__name__, "an UncertainModel")
    _check_magnitude(uncertain.M, where)
    poles = uncertain.M.poles()
    if not len(poles) or uncertain.M.is_stable():
        return
    worst = poles[np.abs(poles).argmax() if uncertain.M.is_discrete else poles.real.argmax()]
    raise NoTrustworthyNumber(
        where,
        with_hidden(f"nominal closed loop unstable (pole {worst.real:.6g}{worst.imag:+.6g}j)", uncertain.M),
        "a stable nominal model",
        "close the loop first (UncertainModel.close), or drop an integrator that feeds nothing back",
    )


def continuous(model: StateSpaceModel) -> StateSpaceModel:
    """Balance the model, narrow peaks in separate states; map a discrete one by ``s = (z - 1) / (z + 1)``."""
    model = modes_apart(model)
    A, B, C, D = model.A, model.B, model.C, model.D
    n = model.n_states
    if not n:
        return StateSpaceModel(A, B, C, D)
    if model.is_discrete:
        # z = (1 + s) / (1 - s): s x' = (A + I)^-1 (A - I) x + ...
        plus = np.linalg.inv(A + np.eye(n))
        A, B, C, D = plus @ (A - np.eye(n)), np.sqrt(2) * plus @ B, np.sqrt(2) * C @ plus, D - C @ plus @ B
    _check_magnitude(StateSpaceModel(A, B, C, D), "frequency axis")
    scale = balancing_factors(A)
    return _balanced(StateSpaceModel(A / scale[:, None] * scale, B / scale[:, None], C * scale[None, :], D))


def _balanced(model: StateSpaceModel) -> StateSpaceModel:
    """Return the stable model in balanced states, sorted by their Hankel singular values."""
    # These do not depend on the states of the given model, and are no farther from normal than its transfer function:
    # in others the eigenvalues of a Hamiltonian matrix may be wrong in the fourth digit.
    from scipy.linalg import solve_continuous_lyapunov

    A, B, C = model.A, model.B, model.C
    limit = 1e-6 * -model.poles().real.max() / np.finfo(float).eps
    if not (B.any() and C.any() and TINY < np.linalg.norm(A) < limit):
        return model
    strong, loud = np.abs(B).max(), np.abs(C).max()
    into, out = B / strong, C / loud  # squares of their own could vanish
    reached = _square_root(solve_continuous_lyapunov(A, -into @ into.T))
    seen = _square_root(solve_continuous_lyapunov(A.T, -out.T @ out))
    _, sizes, turn = np.linalg.svd(seen.T @ reached)
    T = reached @ turn.T / np.sqrt(sizes) * (np.sqrt(strong) / np.sqrt(loud))
    T *= np.where(np.linalg.solve(T, B).sum(axis=1) < 0, -1.0, 1.0)
    A, B = (np.linalg.solve(T, matrix) for matrix in (A @ T, B))
    return StateSpaceModel(A, B, C @ T, model.D) if np.linalg.norm(A) * np.linalg.cond(T) < limit else model


def _square_root(gramian: AnyArray) -> AnyArray:
    """Return a square root of a Gramian, its smallest eigenvalues raised to a small share of the largest."""
    sizes, vectors = np.linalg.eigh(gramian)
    return vectors * np.sqrt(np.maximum(sizes, HIDDEN * sizes[-1]))


def _check_magnitude(model: StateSpaceModel, where: str) -> None:
    """Reject a model whose products of entries overflow."""
    size = max(np.abs(m).max(initial=0.0) for m in (model.A, model.B, model.C, model.D))
    if not size <= MOST:
        hint = "choose other units of time, of signals, or of the parameters"
        raise NoTrustworthyNumber(where, f"an entry of {size:.3g} in M", f"at most {MOST:g}", hint)


def frequencies(omega: ArrayLike | None, where: str) -> Array:
    """Check and return frequencies in rad/s for the curves of a figure; none where None is given."""
    grid = np.atleast_1d(np.asarray([] if omega is None else omega, dtype=float))
    if grid.ndim != 1 or not np.isfinite(grid).all() or (grid < 0).any():
        raise InputError(f"{where}: omega", "negative or not finite frequencies", "frequencies in rad/s, >= 0")
    return grid


def seed_frequencies(model: StateSpaceModel) -> Array:
    """Return the frequencies of the poles of a continuous model, including narrow peaks."""
    poles = model.poles()
    found = np.abs(np.concatenate([poles, poles.imag]))
    # One of those closer together than 2 %, and every narrower peak.
    marks = np.unique(np.round(np.log(found[found > 0]) / 0.02))
    return np.unique(np.concatenate([np.exp(marks * 0.02), narrow_frequencies(poles)]))


def around(model: StateSpaceModel, omega: float) -> Array:
    """Return frequencies within 5 % of a frequency, and others inside the narrow peak that it may be in."""
    if not 0 < omega < np.inf:
        return np.array([omega])
    distance = np.abs(1j * omega - model.poles()).min(initial=omega)
    width = np.linspace(-1, 1, 21)
    return np.concatenate([[omega], omega * np.exp(0.05 * width), omega + 0.5 * distance * width])


def typical_speed(model: StateSpaceModel) -> float:
    """Median of the poles' moduli in rad/s; 1 without poles."""
    poles = np.abs(model.poles())
    return float(np.median(poles)) if len(poles) else 1.0


def acting(model: StateSpaceModel, blocks: Sequence[Block]) -> Mask:
    """Return which states, then blocks, act directly on which, by the zeros of A, B, C, D: ``[i, j]``, j on i."""
    into, out = np.zeros((model.n_inputs, len(blocks))), np.zeros((len(blocks), model.n_outputs))
    for i, (w, z) in enumerate(block_slices(blocks)):
        into[w, i] = out[i, z] = 1
    B, C, D = (model.B != 0) @ into, out @ (model.C != 0), out @ (model.D != 0) @ into
    return np.block([[model.A != 0, B], [C, D]]) > 0


def coupled_blocks(model: StateSpaceModel, blocks: Sequence[Block]) -> list[NDArray[np.intp]]:
    """Return the groups of blocks that act on each other in a cycle; others have mu = 0."""
    n, acts = model.n_states, acting(model, blocks)
    labels = strong_components(acts)
    groups = [np.flatnonzero(labels[n:] == label) for label in np.unique(labels[n:])]
    return [g for g in groups if len(g) > 1 or acts[n + g[0], n + g[0]] or (labels[:n] == labels[n + g[0]]).any()]


def model_frequency(uncertain: UncertainModel, omega: float) -> float:
    """Frequency in rad/s of the model itself: ``w = 2 atan(omega) / dt`` where it was mapped."""
    return float(2 * np.arctan(omega) / uncertain.dt) if uncertain.M.is_discrete else float(omega)
