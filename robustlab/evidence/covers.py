"""Claims about covers: each model is a member of the set, at given real parameters, or by the norm of its error.

What is claimed is claimed of the models, the set and the weight as they are stored, not of a Delta that was computed.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from robustlab.arrays import Array
from robustlab.mu_analysis.margins.cover import Cover
from robustlab.norms.claims import proof_of_norm
from robustlab.norms.numbers import Numbers, above, block_rows, loop_numbers, matrices, model_numbers
from robustlab.statespace import StateSpaceModel
from robustlab.verification.claim import Claim

ROUNDING = 1e-14  # of the largest entry: allowed for beside what the result says that a member misses
ADDITIVE = "additive"


def cover_claims(found: Cover) -> list[Claim]:
    """That each model is inside: at its parameters, or, of the form ``additive``, by an H-infinity norm."""
    if len(found.deltas) != len(found.models):
        return []
    if found.form == ADDITIVE:
        return _norms(found)
    blocks = found.model.blocks
    return _members(found, blocks) if all(b.interval for b in blocks) else []


def _members(found: Cover, blocks: Sequence[Any]) -> list[Claim]:
    """Each model is the member at its parameters, every entry to within a tolerance."""
    common: Numbers = {
        **{key: value for key, value in model_numbers(found.model.M).items() if key != "dt"},
        **matrices(found.model.nominal, "{}0"), "blocks": block_rows(blocks),
        "ranges": np.array([b.interval for b in blocks], dtype=float).reshape(-1, 2),
    }  # fmt: skip
    claims: list[Claim] = []
    for model, deltas, miss in zip(found.models, found.deltas, found.misses, strict=True):
        size = max(float(np.abs(getattr(model, x)).max(initial=0.0)) for x in "ABCD")
        delta = np.array([complex(b.entry(deltas[b.name])).real for b in blocks])
        tolerance = np.array((miss + ROUNDING) * size)
        claims.append(Claim("set", {**common, **matrices(model, "{}1"), "delta": delta, "tolerance": tolerance}))
    return claims


def _norms(found: Cover) -> list[Claim]:
    r"""Of each model: :math:`w^{-1} (G_i - G)` is stable with a norm of at most one."""
    if found.fit is None:
        return []
    weight, M, (q, p) = found.fit.weight, found.model.M, found.model.delta_shape
    n = M.n_states - weight.n_states * found.model.nominal.n_inputs
    centre = StateSpaceModel(M.A[:n, :n], M.B[:n, q:], M.C[p:, :n], M.D[p:, q:], M.dt)
    return [
        _inside(model, centre, weight, size)
        for i, (model, size) in enumerate(zip(found.models, found.sizes, strict=True), 1) if i != found.nominal
    ]  # fmt: skip


def _inside(model: StateSpaceModel, centre: StateSpaceModel, weight: StateSpaceModel, size: float) -> Claim:
    r"""The error behind the weight's inverse, as a loop of which every entry is one of the models'.

    In each channel :math:`w v = r` is :math:`d v = r - C_w x_w`. With K = 1/s, s the power of two next to d, and the
    direct term s - d (no rounding: they are within a factor of two) :math:`y = r - C_w x_w + (s - d) v`, v = K y, says
    the same. K gives v twice, so that the direct terms of both models stay apart.
    """
    m, p, n = model.n_inputs, model.n_outputs, model.n_states + centre.n_states
    d = float(weight.D[0, 0])
    s = math.copysign(2.0 ** round(math.log2(abs(d))), d)
    one = np.eye(m)
    A_w, B_w, C_w = (np.kron(one, X) for X in (weight.A, weight.B, weight.C))
    A, k = _diagonal(_diagonal(model.A, centre.A), A_w), len(A_w)
    B = np.vstack([_diagonal(model.B, centre.B), np.hstack([B_w, np.zeros((k, m))])])
    C = np.block([[model.C, -centre.C, np.zeros((p, k))], [np.zeros((m, n)), -C_w]])
    D = np.block([[np.zeros((p, m)), model.D, -centre.D], [one, (s - d) * one, np.zeros((m, m))]])
    P = StateSpaceModel(A, np.hstack([np.zeros((n + k, m)), B]), C, D, model.dt)
    K = StateSpaceModel([], [], [], np.vstack([one, one]) / s, model.dt)
    v_x, both = np.hstack([np.zeros((m, n)), -C_w]) / d, B[:, :m] + B[:, m:]
    direct = model.D - centre.D
    loop = StateSpaceModel(A + both @ v_x, both / d, C[:p] + direct @ v_x, direct / d, model.dt)
    level = 1.0 if size < 1.0 else above(size)
    numbers = loop_numbers(P, K)
    return Claim("loop-norm", {**numbers, "gamma": np.array(level), **proof_of_norm(loop, level, size, numbers)})


def _diagonal(X: Array, Y: Array) -> Array:
    return np.block([[X, np.zeros((len(X), Y.shape[1]))], [np.zeros((len(Y), X.shape[1])), Y]])
