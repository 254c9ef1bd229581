r"""A generalised plant, or a closed loop, with the rational scalings D, G of its perturbation at a level beta.

.. math:: \tilde P_\beta: \quad \tilde z = D_z z - G_N \tilde w, \qquad w = D_w^{-1} G_M \tilde w / \beta

K makes mu at most beta, as far as these scalings can prove it, where the lower LFT of this plant and K has a norm of at
most one.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from robustlab.norms import HinfNorm, hinf_norm
from robustlab.statespace import StateSpaceModel
from robustlab.synthesis.dynamic_scalings import DynamicScalings, Realisation
from robustlab.synthesis.partition import PlantMatrices
from robustlab.uncertainty.blocks import structure_size

__all__ = ["proved_level", "scaled_loop", "scaled_plant"]

Array = NDArray[Any]


def scaled_plant(p: PlantMatrices, scalings: DynamicScalings, beta: float) -> PlantMatrices:
    """The scaled plant; channels beyond those of the blocks (regularisation) are scaled by beta alone."""
    _, n_w, n_u, n_z, n_y = p.sizes
    q, r = structure_size(scalings.blocks)
    Az, Bz, Cz, Dz = _padded(scalings.on_outputs(), n_z - r)
    Aw, Bw, Cw, Dw = _padded(scalings.on_inputs(), n_w - q)
    Ag, Bg, F, Cg = scalings.coprime()
    Bg = np.hstack([Bg, np.zeros((len(Ag), n_w - q))])
    F = np.vstack([F, np.zeros((n_w - q, len(Ag)))]) / beta
    Cg = np.vstack([Cg, np.zeros((n_z - r, len(Ag)))])
    n, a, b, g = len(p.A), len(Az), len(Aw), len(Ag)
    A = np.zeros((n + a + b + g,) * 2)
    x, z, w, c = slice(0, n), slice(n, n + a), slice(n + a, n + a + b), slice(n + a + b, None)
    A[x, x], A[x, w], A[x, c] = p.A, p.B1 @ Cw, p.B1 @ (Dw @ F)
    A[z, x], A[z, z], A[z, w], A[z, c] = Bz @ p.C1, Az, Bz @ (p.D11 @ Cw), Bz @ (p.D11 @ (Dw @ F))
    A[w, w], A[w, c], A[c, c] = Aw, Bw @ F, Ag
    Dw = Dw / beta
    B1, B2 = np.zeros((len(A), n_w)), np.zeros((len(A), n_u))
    B1[x], B1[z], B1[w], B1[c] = p.B1 @ Dw, Bz @ (p.D11 @ Dw), Bw / beta, Bg
    B2[x], B2[z] = p.B2, Bz @ p.D12
    C1, C2 = np.zeros((n_z, len(A))), np.zeros((n_y, len(A)))
    C1[:, x], C1[:, z], C1[:, w] = Dz @ p.C1, Cz, Dz @ (p.D11 @ Cw)
    C1[:, c] = Dz @ (p.D11 @ (beta * Dw @ F)) - Cg
    C2[:, x], C2[:, w], C2[:, c] = p.C2, p.D21 @ Cw, p.D21 @ (beta * Dw @ F)
    return PlantMatrices(A, B1, B2, C1, C2, Dz @ p.D11 @ Dw, Dz @ p.D12, p.D21 @ Dw)


def _padded(system: Realisation, extra: int) -> Realisation:
    """With ``extra`` channels more that go straight through."""
    A, B, C, D = system
    if not extra:
        return system
    n, m = len(A), len(D)
    direct = np.eye(m + extra)
    direct[:m, :m] = D
    return A, np.hstack([B, np.zeros((n, extra))]), np.vstack([C, np.zeros((extra, n))]), direct


def scaled_loop(loop: StateSpaceModel, scalings: DynamicScalings, beta: float = 1.0) -> StateSpaceModel:
    """The scaled closed loop (continuous, inputs and outputs those of the blocks), from w~ to z~."""
    none_in, none_out = np.zeros((loop.n_states, 0)), np.zeros((0, loop.n_states))
    bare = PlantMatrices(
        loop.A, loop.B, none_in, loop.C, none_out, loop.D, np.zeros((loop.n_outputs, 0)), np.zeros((0, loop.n_inputs))
    )
    s = scaled_plant(bare, scalings, beta)
    return StateSpaceModel(s.A, s.B1, s.C1, s.D11, where="scaled loop")


def proved_level(
    loop: StateSpaceModel, scalings: DynamicScalings, guess: float = 1.0, rtol: float = 1e-6
) -> tuple[float, HinfNorm]:
    """Smallest beta that these scalings prove for mu of a stable continuous loop at all frequencies; inf where none.

    Without G it is the norm of the scaled loop; with G the level at which that norm is one, sought from ``guess`` on
    (every larger level is proved as well). The norm that comes with it is that of the scaled loop at one and at beta.
    """
    norm = hinf_norm(scaled_loop(loop, scalings), rtol)
    if not scalings.mixed:
        return norm.upper, norm
    low, high, step, proof = 0.0, np.inf, 1e-4, None
    trial = guess
    for _ in range(80):
        norm = hinf_norm(scaled_loop(loop, scalings, trial), min(rtol, 1e-7))
        if norm.upper <= 1:
            high, proof = trial, norm
        else:
            low = trial
        if proof is not None and high - low <= rtol * high:
            break
        if proof is None:
            trial = low * (1 + step)
        else:
            trial = high * (1 - step) if low == 0.0 else float(np.sqrt(low * high))
        step = min(3 * step, 0.9)
    return (float("inf"), norm) if proof is None else (high, proof)
