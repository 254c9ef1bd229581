"""Claims about loops with blocks that vary or are nonlinear, from the multipliers that were found."""

from __future__ import annotations

import numpy as np

from robustlab.evidence.norms import above
from robustlab.evidence.numbers import Numbers, block_rows, model_numbers
from robustlab.iqc.analysis import IqcGain, IqcStability
from robustlab.iqc.effect_gain_bounds import EffectGain
from robustlab.iqc.nature import Nature, Nonlinearity, Varying
from robustlab.iqc.problem import IqcProof, Posed
from robustlab.verification.claim import Claim

CONSTANT, VARYING, SECTOR, SLOPE = 0, 1, 2, 3


def gain_claims(found: IqcGain) -> list[Claim]:
    """That the gain is at most ``upper`` for all blocks of their natures."""
    if found.posed is None or found.proof is None or not np.isfinite(found.upper):
        return []
    numbers = {**model_numbers(found.posed.model), **_proof_numbers(found.posed, found.proof)}
    return [Claim("iqc-gain", {**numbers, "gamma": np.array(above(found.upper))})]


def size_claims(found: IqcStability) -> list[Claim]:
    """That the set ``lower`` times as large is stable."""
    if found.posed is None or found.proof is None or not found.lower > 0:
        return []
    posed = found.posed
    q, p = (sum(sizes) for sizes in zip(*((b.rows, b.cols) for b in posed.blocks), strict=True))
    M = posed.model
    numbers = {"A": M.A, "B": M.B[:, :q], "C": M.C[:p], "D": M.D[:p, :q], "dt": np.array(0.0)}
    return [Claim("iqc-size", {**numbers, **_proof_numbers(posed, found.proof), "size": np.array(found.lower)})]


def effect_claims(found: EffectGain) -> list[Claim]:
    """That of the gain with each effect taken for what it is."""
    return gain_claims(found.proved)


def _proof_numbers(posed: Posed, proof: IqcProof) -> Numbers:
    """Blocks with their natures, and what proves the bound."""
    table = np.array([_row(nature) for nature in posed.natures], dtype=np.int64).reshape(-1, 3)
    slopes = [(n.slope or (0.0, 0.0)) if isinstance(n, Nonlinearity) else (0.0, 0.0) for n in posed.natures]
    rates = [n.rate if isinstance(n, Varying) else np.inf for n in posed.natures]
    return {
        "blocks": block_rows(posed.blocks), "nature": table, "ranges": posed.ranges,
        "slope": np.array(slopes, dtype=float).reshape(-1, 2), "rate": np.array(rates, dtype=float),
        "pole": np.array(proof.pole), "order": np.array(proof.order, dtype=np.int64), "P": proof.P,
        "multipliers": proof.unknowns,
    }  # fmt: skip


def _row(nature: Nature | None) -> tuple[int, int, int]:
    """``[kind, odd, steady]``."""
    if isinstance(nature, Nonlinearity):
        return SECTOR if nature.slope is None else SLOPE, int(nature.odd), int(nature.steady)
    return (CONSTANT if nature is None else VARYING), 0, 0
