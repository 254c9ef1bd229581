"""Claims about models that stand for others: reduced ones, and sets that end in two given models."""

from __future__ import annotations

from fractions import Fraction

import numpy as np

from robustlab.norms import HinfNorm
from robustlab.norms.claims import band_scalings, loop_claims, norm_matrix
from robustlab.norms.numbers import Numbers, above, block_rows, matrices, model_numbers
from robustlab.statespace import StateSpaceModel, append
from robustlab.synthesis.reduction.reduced_model import ReducedModel
from robustlab.uncertainty.built import BuiltModel
from robustlab.verification.claim import Claim


def reduction_claims(found: ReducedModel) -> list[Claim]:
    """That the two models differ by no more than was found: at all frequencies, or between the weights.

    Nothing is claimed of an error that is relative, or that of coprime factors.
    """
    if found.left_out:
        return []
    if found.weights != (None, None):
        return _weighted(found)
    plain = found.method in ("truncation", "residualisation", "hankel")
    whole = found.error if plain else found.difference
    return [] if whole is None else _difference(found, whole)


def _difference(found: ReducedModel, norm: HinfNorm) -> list[Claim]:
    """That of full and reduced model; where it is not stable, as a gain alone."""
    if not np.isfinite(norm.upper):
        return []
    full, small, level = found.full, found.model, above(norm.upper)
    numbers: Numbers = {**matrices(full, "{}1"), **matrices(small, "{}2"), "dt": np.array(float(full.dt))}
    n, k = full.n_states, small.n_states
    apart = StateSpaceModel(
        np.block([[full.A, np.zeros((n, k))], [np.zeros((k, n)), small.A]]), np.vstack([full.B, small.B]),
        np.hstack([full.C, -small.C]), full.D - small.D, full.dt,
    )  # fmt: skip
    if apart.is_stable():
        proof = norm_matrix(apart, level, norm.upper)
        return [Claim("difference-norm", {**numbers, "gamma": np.array(level), **proof})]
    scalings = band_scalings(full.n_inputs, full.n_outputs, (0.0, np.inf))
    return [Claim("mu-axis", {**numbers, "level": np.array(level), **scalings})]


def _weighted(found: ReducedModel) -> list[Claim]:
    """The weighted difference: all models side by side as u = K y, around a plant that only wires them.

    The inputs of both models are what the first weight puts out (or w), that of the second is their difference.
    """
    full, small = found.full, found.model
    m, p, dt = full.n_inputs, full.n_outputs, full.dt
    first, last = (
        StateSpaceModel([], [], [], np.eye(size), dt) if weight is None else weight
        for weight, size in zip(found.weights, (m, p), strict=True)
    )
    parts = [full, small, first, last]
    K = append(*(g.renamed([f"{i} in {k}" for k in range(g.n_inputs)], [f"{i} out {k}" for k in range(g.n_outputs)])
                 for i, g in enumerate(parts)))  # fmt: skip
    w, z = first.n_inputs, last.n_outputs
    u = np.cumsum([w, p, p, m])  # where the outputs of each part are among the inputs of the wiring
    y = np.cumsum([z, m, m, w])
    D = np.zeros((z + K.n_inputs, w + K.n_outputs))
    D[:z, u[3] :] = np.eye(z)
    D[y[0] : y[1], u[2] : u[3]] = D[y[1] : y[2], u[2] : u[3]] = np.eye(m)
    D[y[2] : y[3], :w] = np.eye(w)
    D[y[3] :, u[0] : u[1]], D[y[3] :, u[1] : u[2]] = np.eye(p), -np.eye(p)
    if not K.is_stable():
        return []
    return loop_claims(StateSpaceModel([], [], [], D, dt), K, found.error.upper)


def set_claims(found: BuiltModel) -> list[Claim]:
    """That the set is the nominal model at Delta = 0 and the perturbed one at Delta = I, entry by entry.

    Where a difference of two entries is no double, the set can only come as near as half of its last digit; then the
    claim says how near.
    """
    if found.ends is None or any(b.interval != (-1.0, 1.0) for b in found.model.blocks):
        return []
    nominal, perturbed = found.ends
    numbers = {
        **{key: value for key, value in model_numbers(found.model.M).items() if key != "dt"},
        **matrices(nominal, "{}0"), **matrices(perturbed, "{}1"), "blocks": block_rows(found.model.blocks),
    }  # fmt: skip
    pairs = [
        pair for name in "ABCD"
        for pair in zip(*(getattr(end, name).ravel().tolist() for end in found.ends), strict=True)
    ]  # fmt: skip
    off = max((abs(float(Fraction(y) - Fraction(x) - Fraction(y - x))) for x, y in pairs), default=0.0)
    return [Claim("set", numbers if off == 0 else {**numbers, "tolerance": np.array(off)})]
