"""A second, small program that checks what the large one claims, in exact and ball arithmetic, from the numbers alone.

Whoever finds a proof may be as clever as he likes; whoever checks it is short enough to be read (de Bruijn's
criterion). Nothing here knows how a claim was found. `check` is the door.
"""

from robustlab.verification.checker import check
from robustlab.verification.claim import Claim, Outcome, Verification

__all__ = ["Claim", "Outcome", "Verification", "check"]
