"""`robustlab.verify`: checks the claims of a result or of a file with the independent checker."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any, ClassVar

from robustlab.display import Displayable, Facts
from robustlab.errors import InputError, error_context
from robustlab.result import Result, Status
from robustlab.verification.claim import Claim, Outcome, Verification

# Class of a result -> the function for its claims. The first class in the order of resolution counts.
CLAIMS: Mapping[str, str] = {
    "HinfNorm": "norms.hinfinity.norm_claims",
    "H2Norm": "norms.h2.h2_claims",
    "MuBounds": "evidence.claims.mu_claims",
    "Margin": "evidence.claims.margin_claims",
    "WorstCaseGain": "evidence.claims.gain_claims",
    "RobustGain": "evidence.claims.gain_claims",
    "HinfSynthesis": "evidence.claims.hinf_claims",
    "NcfSynthesis": "evidence.claims.ncf_claims",
    "H2Synthesis": "evidence.claims.h2_claims",
    "FixedSynthesis": "evidence.claims.fixed_claims",
    "TunedSynthesis": "evidence.claims.tuned_claims",
    "DKSynthesis": "evidence.claims.dk_claims",
    "ReducedController": "evidence.claims.reduced_controller_claims",
    "ReducedModel": "evidence.claims.reduction_claims",
    "BuiltModel": "evidence.claims.set_claims",
    "CoprimeMargin": "evidence.claims.coprime_claims",
    "DiskMargins": "evidence.claims.disk_claims",
    "DiskMargin": "evidence.claims.one_disk_claims",
    "Cover": "evidence.claims.cover_claims",
    "DelayStability": "evidence.claims.delayed_stability_claims",
    "DelayGain": "evidence.claims.delayed_gain_claims",
    "UncertainModel": "evidence.claims.weight_claims",
}


@dataclass(frozen=True, eq=False)
class Verified(Displayable):
    """Verdicts on the claims of a result."""

    status: Status  #: CERTIFIED: all were proved. INCONCLUSIVE: one was not, none refuted. FAILED: one was refuted
    #: Each claim in words, its outcome, the proved number, the reason of a failure, and the number of tests; for a file
    #: also its displayed numbers, compared with the proved ones
    claims: tuple[Verification, ...]
    not_covered: tuple[str, ...] = ()  #: The numbers in a file that no claim covers
    notes: tuple[str, ...] = ()  #: Remarks on the file

    quantities: ClassVar[Mapping[str, Any]] = {"proved": bool, "refuted": bool, "boxes": "1"}

    @property
    def proved(self) -> bool:
        """Return whether every claim was proved."""
        return self.status is Status.CERTIFIED

    @property
    def refuted(self) -> bool:
        """Return whether a claim was refuted."""
        return any(c.outcome is Outcome.REFUTED for c in self.claims)

    @property
    def boxes(self) -> int:
        """Return the number of tests of definiteness, boxes of frequency among them."""
        return sum(c.boxes for c in self.claims)

    def headline(self) -> str:
        if self.refuted:
            return "REFUTED: a counterexample was proved"
        if self.proved:
            return f"proved independently: {self.boxes} {'box' if self.boxes == 1 else 'boxes'}"
        return "not proved"

    def facts(self) -> Facts:
        return [
            *((c.outcome.value, f"{c.claim} ({c.where})" if c.where else c.claim) for c in self.claims),
            ("not covered by a proof", ", ".join(self.not_covered)),
            *(("note", note) for note in self.notes),
        ]

    def to_json(self) -> dict[str, Any]:
        rows = [{**vars(c), "outcome": c.outcome.value} for c in self.claims]
        more = {"not_covered": list(self.not_covered), "notes": list(self.notes)}
        return {"type": "Verified", "status": self.status, "proved": self.proved, "claims": rows, **more}


def claims_of(result: Any) -> list[Claim]:
    """Return the claims of a result; none where its class or evidence has none, or it comes from a file."""
    if isinstance(result, Result):
        return []
    own: Any = getattr(result, "claims", None)
    if own is not None and type(result).__module__.startswith("robustlab."):
        return list(own())
    for kind in type(result).__mro__:
        if kind.__name__ in CLAIMS and kind.__module__.startswith("robustlab."):
            module, _, name = CLAIMS[kind.__name__].rpartition(".")
            return getattr(import_module(f"robustlab.{module}"), name)(result)
    return []


@error_context("verify")
def verify(result: Any, *, effort: float = 1.0) -> Verified:
    """Re-verify a result from its numbers alone, in exact and ball arithmetic.

    A small independent program checks each claim: for all frequencies, all members of the set, all numbers being exact
    doubles. See the page on verification for the theorem of each.

    Parameters
    ----------
    result
        A result, or the name of its file written by `robustlab.save`.
    effort
        Limit of the work, as a multiple of the usual; counted, not timed.

    Returns
    -------
    Verified
        ``proved``, ``refuted``, and each claim with the proved number, rounded outwards.

    Raises
    ------
    InputError
        Nothing to verify: a file without claims, a result of another kind.
    """
    from robustlab.verification.checker import EFFORT, check
    from robustlab.verification.files import claims_in, displayed, read_checked

    if not 0 < effort < float("inf"):
        raise InputError("verify: effort", f"{effort}", "a positive number")
    file = read_checked(result) if isinstance(result, (str, Path)) else None
    claims = claims_of(result) if file is None else claims_in(file)
    if not claims:
        name = f"a {type(result).__name__}" if file is None else f"{result}, a file"
        hint = "docs/proofs.md says what can be; of a result that was loaded verify the file"
        raise InputError("verify", f"{name} without claims", "a result with evidence that can be checked", hint)
    found = [check(claim, effort=max(1, round(EFFORT * effort))) for claim in claims]
    rows, others, notes = ([], [], []) if file is None else displayed(file, claims, found)
    outcomes = {c.outcome for c in (*found, *rows)}
    status = (
        Status.FAILED if Outcome.REFUTED in outcomes
        else Status.INCONCLUSIVE if Outcome.NOT_PROVED in outcomes
        else Status.CERTIFIED
    )  # fmt: skip
    return Verified(status, (*found, *rows), tuple(others), tuple(notes))
