"""Claims about H-infinity and H2 norms of a model, or of the loop of a plant and a controller as stored.

The checker closes loops itself, in balls: `u = K y`.
"""

from __future__ import annotations

import numpy as np

from robustlab.norms import HinfNorm
from robustlab.norms.bounded_real import gramian_matrix, norm_matrix
from robustlab.norms.h2 import H2Norm
from robustlab.norms.numbers import Numbers, above, loop_numbers, model_numbers
from robustlab.result import Status
from robustlab.statespace import StateSpaceModel, lower_lft
from robustlab.verification.claim import Claim


def norm_claims(found: HinfNorm) -> list[Claim]:
    """Claim that the gain stays below ``upper``: of a stable model, or over a band of one that may be unstable."""
    model = found.system
    if model is None or not np.isfinite(found.upper) or found.status is not Status.CERTIFIED:
        return []
    level = above(found.upper)
    if found.band is None:
        return [
            Claim("norm", {**model_numbers(model), "gamma": np.array(level), **norm_matrix(model, level, found.upper)})
        ]
    scalings = band_scalings(model.n_inputs, model.n_outputs, found.band)
    return [Claim("mu-axis", {**model_numbers(model), "level": np.array(level), **scalings})]


def band_scalings(q: int, p: int, band: tuple[float, float]) -> Numbers:
    """Return one full block with D = 1 over the band: its mu is the gain."""
    low, high = band
    whole = {"low": np.array([low]), "high": np.array([high]), "band": np.array([low, high])}
    scalings = {"D_w": np.eye(q)[None], "D_z": np.eye(p)[None], "G": np.zeros((1, q, p))}
    return {"blocks": np.array([[2, q, p]], dtype=np.int64), **whole, **scalings}


def h2_claims(found: H2Norm) -> list[Claim]:
    """Claim that the H2 norm is at most ``value``, by a slightly enlarged Gramian."""
    model = found.system
    if model is None or not np.isfinite(found.value) or not found.status.trustworthy:
        return []
    return gramian_claims(model, found.value)


def gramian_claims(model: StateSpaceModel, value: float, numbers: Numbers | None = None) -> list[Claim]:
    """Claim the level ``value`` (1 + 1e-6) of a model, or the loop of ``numbers``, by a slightly enlarged Gramian."""
    numbers, level = model_numbers(model) if numbers is None else numbers, above(value)
    proof = gramian_matrix(model, value, level, numbers) if model.n_states else {}
    return [Claim("gramian", {**numbers, "value": np.array(level), **proof})] if proof else []


def loop_claims(plant: StateSpaceModel, K: StateSpaceModel, gamma: float) -> list[Claim]:
    """Claim that K, on the last outputs and inputs of the plant, makes a stable loop with a norm up to ``gamma``."""
    if not np.isfinite(gamma):
        return []
    numbers, level = loop_numbers(plant, K), above(gamma)
    proof = norm_matrix(lower_lft(plant, K), level, gamma, numbers)
    return [Claim("loop-norm", {**numbers, "gamma": np.array(level), **proof})]


def h2_loop_claims(plant: StateSpaceModel, K: StateSpaceModel, value: float) -> list[Claim]:
    """Claim the same of the H2 norm."""
    return gramian_claims(lower_lft(plant, K), value, loop_numbers(plant, K)) if np.isfinite(value) else []
