"""Claims about robustness by a norm of a loop."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from robustlab.budget import search_budget
from robustlab.delays.model import DelayedModel
from robustlab.evidence.axis import joined_scalings, margin_claims, weight_claims
from robustlab.mu_analysis.axis.robustness import margin_within
from robustlab.mu_analysis.constants import WORK
from robustlab.mu_analysis.margins.delay_margins import DelayGain, DelayProof, DelayStability, covering_set
from robustlab.mu_analysis.margins.disk_margin import DiskMargin, DiskMargins
from robustlab.norms import HinfNorm
from robustlab.norms.claims import loop_claims, norm_claims
from robustlab.norms.numbers import ABOVE, Numbers, block_rows, model_numbers
from robustlab.uncertainty.blocks import Block, ComplexScalar, FullBlock
from robustlab.uncertainty.distances.coprime import CoprimeMargin, four_block
from robustlab.verification.claim import Claim


def coprime_claims(found: CoprimeMargin) -> list[Claim]:
    """Return the claim of a stable loop with a four-block norm of at most one over ``lower``."""
    if found.plant is None or found.K is None or not found.lower > 0:
        return []
    return loop_claims(four_block(found.plant), found.K, 1 / found.lower)


def disk_claims(found: DiskMargins) -> list[Claim]:
    """Return the claims of all loops at once, then of each loop."""
    parts = {id(part): part for part in (found.simultaneous, *found.channels.values()) if isinstance(part, DiskMargin)}
    return [claim for part in parts.values() for claim in one_disk_claims(part)]


def one_disk_claims(found: DiskMargin) -> list[Claim]:
    """Return the claim that no deltas below ``lower`` destabilise: for one loop a norm, for several mu."""
    system = found.system
    if system is None or not 0 < found.lower < np.inf:
        return []
    if isinstance(system, DelayedModel):
        return _delayed_disk_claims(found, system)
    if len(system.blocks) == 1:
        norm = HinfNorm(0.0, 1 / found.lower, np.nan, found.status, system=system.delta_channels)
        return norm_claims(norm)
    budget = search_budget("verify", WORK, 1.0, None)
    margin = margin_within(system, budget, accuracy=1e-4)
    return [claim for claim in margin_claims(margin) if claim.kind == "mu-axis"]


# --- exact delays ----------------------------------------------------------------------------------------------------


def delayed_stability_claims(found: DelayStability) -> list[Claim]:
    """Return the claim, if proved, that every member of the set, which contains the delayed model, is stable."""
    if found.system is None or not found.stable:
        return []
    return _claims_of_set("delayed-stable", found.system, found.proof, [], {})


def delayed_gain_claims(found: DelayGain) -> list[Claim]:
    """Return the claim that no member has a gain above ``upper``."""
    if found.system is None or not np.isfinite(found.upper):
        return []
    block = FullBlock("performance", found.system.n_inputs, found.system.n_outputs)
    return _claims_of_set("worst-gain", found.system, found.proof, [block], {"gamma": np.array(found.upper * ABOVE)})


def _delayed_disk_claims(found: DiskMargin, system: DelayedModel) -> list[Claim]:
    """Return the claim of the bound of mu of the deltas, with the blocks of the delays."""
    if found.proof is None:
        return []
    blocks = [ComplexScalar(name) for name in found.factor] or [ComplexScalar("delta")]
    delays = len(covering_set(system, found.proof.order).blocks)
    level = np.array([1.0] * delays + [ABOVE / found.lower] * len(blocks))
    return _claims_of_set("mu-axis", system, found.proof, blocks, {"level": level})


def _claims_of_set(
    kind: str, model: DelayedModel, proof: DelayProof | None, blocks: Sequence[Block], numbers: Numbers
) -> list[Claim]:
    """Return the claim about the set that contains the model, and that its weights cover the delays."""
    if proof is None:
        return []
    held = covering_set(model, proof.order, blocks)
    M = held.delta_channels
    scalings = joined_scalings(M, held.blocks, proof.pieces, float)
    if scalings is None:
        return []
    rows = {**model_numbers(M), "blocks": block_rows(held.blocks)}
    return [Claim(kind, {**rows, **numbers, **scalings}), *weight_claims(held.blocks)]
