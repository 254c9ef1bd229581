"""Claims about models that depend on moving parameters, and about loops with scheduled controllers."""

from __future__ import annotations

import numpy as np

from robustlab.evidence.norms import above
from robustlab.evidence.numbers import Numbers
from robustlab.synthesis.scheduling.induced_gain import LPVGain
from robustlab.synthesis.scheduling.parameter_varying import LPVModel
from robustlab.synthesis.scheduling.scheduled_synthesis import LPVSynthesis
from robustlab.verification.claim import Claim


def gain_claims(found: LPVGain) -> list[Claim]:
    """That the induced gain is at most ``upper``; nothing where the model between the points was only sampled."""
    if not _proved(found):
        return []
    return [Claim("lpv-gain", {**_model_numbers(found.model), **_proof_numbers(found)})]


def design_claims(found: LPVSynthesis) -> list[Claim]:
    """That plant and controller, as they are stored, make a loop with that gain.

    Nothing where B2, C2, D12 or D21 depend on a parameter: that loop is not multi-linear between the points.
    """
    plant, K, n = found.plant, found.K, found.plant.n_states
    alike = [(p.name, p.points) for p in plant.parameters] == [(p.name, p.points) for p in K.parameters]
    z, w = len(plant.outputs) - len(K.inputs), len(plant.inputs) - len(K.outputs)
    M, E = (X.reshape(-1, *X.shape[-2:]) for X in (plant.matrices, plant.deviation))
    moving = (M[0] != M).any(axis=0) | E.any(axis=0)
    if not _proved(found.gain) or not alike or moving[n + z :].any() or moving[:, n + w :].any():
        return []
    numbers: Numbers = {
        **_model_numbers(plant), **_proof_numbers(found.gain), "K": K.matrices, "n_K": np.array(K.n_states),
        "n_meas": np.array(len(K.inputs)), "n_con": np.array(len(K.outputs)),
    }  # fmt: skip
    return [Claim("lpv-gain", numbers)]


def _proved(found: LPVGain) -> bool:
    return found.status.value == "certified" and bool(found.P.size) and bool(np.isfinite(found.upper))


def _model_numbers(model: LPVModel) -> Numbers:
    """Grid, matrices at its points, rates, and the deviation between them where there is any."""
    numbers: Numbers = {f"points{i}": np.array(p.points) for i, p in enumerate(model.parameters)}
    numbers |= {
        "M": model.matrices,
        "n": np.array(model.n_states),
        "rate": np.array([p.rate for p in model.parameters]),
    }
    return {**numbers, "deviation": model.deviation} if model.deviation.any() else numbers


def _proof_numbers(found: LPVGain) -> Numbers:
    """P, with one entry along the parameters with which it does not vary, and the level."""
    k = len(found.model.parameters)
    P = found.P if found.P.ndim == k + 2 else found.P.reshape((1,) * k + found.P.shape)
    return {"P": P, "gamma": np.array(above(found.upper))}
