"""Claims about robustness that rest on a norm of a loop."""

from __future__ import annotations

import numpy as np

from robustlab.budget import search_budget
from robustlab.evidence.axis import margin_claims
from robustlab.mu_analysis.axis.stability import margin_within
from robustlab.mu_analysis.constants import WORK
from robustlab.mu_analysis.margins.disk_margin import DiskMargin, DiskMargins
from robustlab.mu_analysis.margins.small_gain import SmallGain
from robustlab.norms import HinfNorm
from robustlab.norms.claims import loop_claims, norm_claims
from robustlab.uncertainty.distances.coprime import CoprimeMargin, four_block
from robustlab.verification.claim import Claim


def small_gain_claims(found: SmallGain) -> list[Claim]:
    """That what Delta sees is stable, with a norm of at most one over ``lower``."""
    if found.system is None or found.K is None:
        return norm_claims(found.norm)
    return loop_claims(found.system.M, found.K, found.norm.upper)


def coprime_claims(found: CoprimeMargin) -> list[Claim]:
    """That the loop is stable, with a four-block norm of at most one over ``lower``."""
    if found.plant is None or found.K is None or not found.lower > 0:
        return []
    return loop_claims(four_block(found.plant), found.K, 1 / found.lower)


def disk_claims(found: DiskMargins) -> list[Claim]:
    """Those of all loops at once, then of each loop."""
    parts = {id(part): part for part in (found.simultaneous, *found.channels.values()) if isinstance(part, DiskMargin)}
    return [claim for part in parts.values() for claim in one_disk_claims(part)]


def one_disk_claims(found: DiskMargin) -> list[Claim]:
    """That no deltas below ``lower`` in the factors' disks destabilise: of one loop a norm, of several mu."""
    uncertain = found.system
    if uncertain is None or not 0 < found.lower < np.inf:
        return []
    if len(uncertain.blocks) == 1:
        norm = HinfNorm(0.0, 1 / found.lower, np.nan, found.status, system=uncertain.delta_channels)
        return norm_claims(norm)
    budget = search_budget("verify", WORK, 1.0, None)
    margin = margin_within(uncertain, budget, accuracy=1e-4)
    return [claim for claim in margin_claims(margin) if claim.kind == "mu-axis"]
