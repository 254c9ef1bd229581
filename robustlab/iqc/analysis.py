r"""Worst-case gain and stability by integral quadratic constraints.

.. math:: z = M_{11} w + M_{12} u, \quad y = M_{21} w + M_{22} u, \quad w = \Delta(z), \qquad
          \|y\|_2 \le \gamma \|u\|_2 \text{ for all } u \in L_2 \text{ and all } \Delta \text{ of the class}

Every range is first centred, so that the class of each block contains zero: with every Delta, tau Delta belongs to it
for tau in [0, 1], the homotopy of Megretski and Rantzer, and at tau = 0 the model is stable. The loop is well posed for
all of them: where w acts on z without delay, only constraints are used that hold for differences of signals too, and
the inequality is strict at infinite frequency.

References
----------
Megretski, Rantzer, "System analysis via integral quadratic constraints", IEEE TAC 42 (1997).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np

from robustlab.budget import Budget, one_thread
from robustlab.display import Facts, listed, member, number
from robustlab.errors import InputError, error_context
from robustlab.iqc.problem import IqcProof, Natures, Posed, claim_of, posed
from robustlab.mu_analysis.axis.margin import StabilityMargin
from robustlab.norms import PeakGain
from robustlab.result import Status
from robustlab.verification.claim import Claim

CLOSE = 1e-3  # relative distance of a margin from a size not proved, of a gain from one attained
NEAR = 0.05  # the same distance, below which only the best basis so far is tried
LEAST, LARGEST = 1e-3, 64.0  # sizes of the set between which a margin is searched

__all__ = ["IqcGain", "IqcStability", "iqc_gain", "iqc_stability"]

HOMOTOPY = "tau Delta is of the class of Delta for every tau in [0, 1]"


@dataclass(frozen=True, eq=False)
class IqcGain(PeakGain):
    """Bounds of the worst L2 gain over all blocks of their classes.

    Attributes
    ----------
    lower, upper
        ``upper`` is proved for every block of its class; ``lower`` is the gain of the member ``delta``, in which all
        blocks are constant gains. inf: nothing was proved; a member is unstable.
    delta
        That member: one normalised value per block; 0 is the middle of a range.
    nature, conditions
        Block -> its type in words; the motions for which a law is in its sector, where not all.
    proof, posed
        Evidence of ``upper`` (None where nothing was proved), and the problem, for another proof.
    status
        CERTIFIED: ``upper`` was proved in ball arithmetic. INCONCLUSIVE: nothing was proved, the loop may be stable.
        INFEASIBLE: the member ``delta`` is unstable. TIMEOUT: the time limit ended the search.
    """

    delta: Mapping[str, float]
    nature: Mapping[str, str]
    proof: IqcProof | None
    posed: Posed = field(kw_only=True)

    unsaved: ClassVar[tuple[str, ...]] = ("posed",)

    def claims(self) -> list[Claim]:
        """Return the claim that the gain is at most ``upper``, for `robustlab.verify`."""
        return [] if self.proof is None else [claim_of(self.posed, self.proof, gamma=self.upper)]

    def evidence(self) -> Facts:
        """Return the block types, the worst linear member, and the proof."""
        return [_blocks(self.nature), ("worst linear member", member(self.delta)), *_proof_facts(self.proof)]


@dataclass(frozen=True, eq=False)
class IqcStability(StabilityMargin):
    """Stability for all blocks of their classes.

    Attributes
    ----------
    lower, upper
        Largest proved size: the factor by which every range is enlarged about its middle, and the slopes with it. At
        least 1 where ``stable``; 0 where nothing was proved. Unstable members are not searched: ``upper`` is inf.
    nature, conditions, proof, posed
        As in `IqcGain`; the proof is that of ``lower``.
    status
        CERTIFIED: ``lower`` was proved in ball arithmetic. INCONCLUSIVE: it is 0. TIMEOUT: the time limit ended the
        search; ``lower`` holds.
    """

    quantities: ClassVar[Mapping[str, Any]] = {**StabilityMargin.quantities, "margin": "1"}

    nature: Mapping[str, str]
    conditions: tuple[str, ...]
    proof: IqcProof | None
    posed: Posed = field(kw_only=True)

    def claims(self) -> list[Claim]:
        """Return the claim that the set ``lower`` times as large is stable, for `robustlab.verify`."""
        return [] if self.proof is None else [claim_of(self.posed, self.proof, size=self.lower)]

    @property
    def stable(self) -> bool:
        """Return whether stability is proved for the set as given."""
        return self.lower >= 1

    @property
    def margin(self) -> float:
        """Return the proved size, ``lower``."""
        return self.lower

    def headline(self) -> str:
        return "proved stable for all blocks of their classes" if self.stable else "not proved stable"

    def facts(self) -> Facts:
        return [
            ("stable as given", "proved" if self.stable else "not proved"),
            ("margin", f"{number(self.margin)} (proved)"),
            _blocks(self.nature),
            ("holds", listed(self.conditions)),
            *_proof_facts(self.proof),
        ]

    def to_json(self) -> dict[str, Any]:
        kept = {name: value for name, value in vars(self).items() if name != "posed"}
        return {"type": "IqcStability", "stable": self.stable, "margin": self.margin, **kept}


def _blocks(nature: Mapping[str, str]) -> tuple[str, str]:
    return "blocks", listed(f"{name}: {text}" for name, text in nature.items())


def _proof_facts(proof: IqcProof | None) -> Facts:
    if proof is None:
        return []
    filters = f"pole {number(proof.pole, 'rad/s')}, order {proof.order}" if proof.order else "none"
    kinds = listed(f"{name}: {kind}" for name, kind in proof.constraints.items())
    return [("constraints", kinds), ("filters", filters), ("slack", number(proof.slack)), ("homotopy", HOMOTOPY)]


@error_context("iqc_gain")
def iqc_gain(
    model: Any,
    nature: Natures | None = None,
    inputs: Sequence[str] | None = None,
    outputs: Sequence[str] | None = None,
    order: int = 2,
    pole: float | None = None,
    time_limit: float | None = None,
    effort: float = 1.0,
) -> IqcGain:
    """`robustlab.peak_gain` with blocks that are nonlinear or vary with time; ``nature``: its ``natures``."""
    problem, budget = posed("iqc_gain", model, nature, order, pole, time_limit, effort, (inputs, outputs))
    if not problem.n_w or not problem.n_z:
        raise InputError("iqc_gain", "no input and output except those of the blocks", "a performance channel")
    with one_thread():
        lower, delta = problem.worst_member()
        best: tuple[float, IqcProof] | None = None
        enough = lower * (1 + CLOSE)
        for basis in problem.bases if np.isfinite(lower) else ():
            found = problem.least_gain(basis, budget, enough)
            if found is not None and (best is None or found[0] < best[0]):
                best = found
            if budget.over or (best is not None and best[0] <= enough):
                break
    upper, proof = best if best is not None else (math.inf, None)
    status = _status(best is not None, budget) if np.isfinite(lower) else Status.INFEASIBLE
    given = problem.posed
    return IqcGain(lower, upper, None, status, delta, given.words, proof, conditions=given.conditions, posed=given)


def _status(proved: bool, budget: Budget) -> Status:
    return Status.CERTIFIED if proved else Status.TIMEOUT if budget.struck else Status.INCONCLUSIVE


@error_context("iqc_stability")
def iqc_stability(
    model: Any,
    nature: Natures | None = None,
    order: int = 2,
    pole: float | None = None,
    time_limit: float | None = None,
    effort: float = 1.0,
) -> IqcStability:
    """`robustlab.robust_stability` with ``natures``, by integral quadratic constraints; rate bounds do not grow."""
    problem, budget = posed("iqc_stability", model, nature, order, pole, time_limit, effort)
    low, high, size = 0.0, math.inf, 1.0  # the largest that is proved, the smallest that is not, the next
    proof: IqcProof | None = None
    with one_thread():
        while not budget.over and low < LARGEST and LEAST < high > low * (1 + CLOSE):
            found = problem.proved_stable(size, budget, thorough=not low or high > low * (1 + NEAR))
            if found is None:
                high = size
            else:
                low, proof = size, found
            size = 2 * low if math.isinf(high) else 0.5 * (low + high)
    given = problem.posed
    words, status = given.words, _status(low > 0, budget)
    return IqcStability(low, math.inf, None, status, {}, (), words, given.conditions, proof, posed=given)
