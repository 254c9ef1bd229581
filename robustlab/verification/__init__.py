"""A second, small program that checks what the large one claims, in exact and ball arithmetic, from the numbers alone.

Whoever finds a proof may be as clever as he likes; whoever checks it is short enough to be read (de Bruijn's
criterion). Nothing here knows how a claim was found. `check` is the door; it and flint are loaded when it is asked for.
"""

from typing import TYPE_CHECKING, Any

from robustlab.verification.claim import Claim, Outcome, Verification

if TYPE_CHECKING:
    from robustlab.verification.checker import check

__all__ = ["Claim", "Outcome", "Verification", "check"]


def __getattr__(name: str) -> Any:
    if name == "check":
        from robustlab.verification import checker

        return checker.check
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
