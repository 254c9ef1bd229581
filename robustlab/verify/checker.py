"""`check`: a claim in, its verdict out; never an exception, and "proved" only where a theorem's conditions were proved."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import flint
import numpy as np
from flint import arb

from robustlab.errors import InputError, NoTrustworthyNumber
from robustlab.verify.balls import PRECISIONS, precision, rounded_down
from robustlab.verify.claim import Claim, Verdict, Verification, Work, not_proved
from robustlab.verify.members import ALLOWANCE, prove_mu_lower, prove_unstable_member
from robustlab.verify.models import difference, loop, stored
from robustlab.verify.mu import prove_mu_axis, prove_mu_upper
from robustlab.verify.norms import prove_gramian, prove_norm, prove_stable
from robustlab.verify.sets import prove_set

EFFORT = 20_000  # units of `Work`: about two minutes


@dataclass(frozen=True)
class _Kind:
    prove: Callable[[Claim, Work], Verdict]
    words: str  # what is claimed
    number: str | None = None  # the dataset with the number that is claimed
    symbol: str = ""  # what stands before the number
    below: bool = False  # a lower bound: the number is what the level says with a Delta as large as allowed


KINDS: Mapping[str, _Kind] = {
    "stable": _Kind(prove_stable, "all eigenvalues of A lie inside the stability boundary"),
    "norm": _Kind(
        lambda c, w: prove_norm(c, stored, w), "the model is stable", "gamma", "H-infinity norm over all frequencies <="
    ),
    "loop-norm": _Kind(
        lambda c, w: prove_norm(c, loop, w), "the loop is stable", "gamma", "H-infinity norm over all frequencies <="
    ),
    "difference-norm": _Kind(
        lambda c, w: prove_norm(c, difference, w), "the difference is stable", "gamma", "H-infinity norm of it <="
    ),
    "gramian": _Kind(prove_gramian, "the model is stable", "value", "H2 norm <="),
    "mu-upper": _Kind(
        prove_mu_upper, "no Delta of the structure within 1/level makes I - M Delta singular", "level", "mu <="
    ),
    "mu-axis": _Kind(
        prove_mu_axis,
        "stable, and at no frequency a Delta of the structure within 1/level makes I - M(jw) Delta singular",
        "level",
        "mu over all frequencies <=",
    ),
    "mu-lower": _Kind(
        prove_mu_lower,
        "a Delta of the structure within (1 + 1e-9)/level makes I - M Delta singular",
        "level",
        "mu >=",
        below=True,
    ),
    "unstable-member": _Kind(
        prove_unstable_member,
        "a Delta within (1 + 1e-9)/level gives a pole on or beyond the stability boundary, or no well-posed model",
        "level",
        "level",
        below=True,
    ),
    "set": _Kind(prove_set, "the set is the nominal model at parameters 0 and the perturbed one at 1, by every entry"),
}
BAND = _Kind(  # "mu-axis" where a band is given
    prove_mu_axis,
    "at no frequency of the band (below pi/dt) a Delta within 1/level makes I - M(jw) Delta singular",
    "level",
    "mu over the band <=",
)


def check(claim: Claim, *, effort: int = EFFORT) -> Verification:
    """Judge a claim from its numbers alone.

    ``claim``: what is claimed, with its evidence.
    ``effort``: tests of definiteness of 20 rows that it may cost; the count and not the clock ends a check.
    Never raises for what a claim holds: what is ill-formed is not proved, and ``where`` says why.
    """
    claim, work = Claim(claim.kind, dict(claim.numbers)), Work(effort)
    kind = KINDS.get(claim.kind, _Kind(_unknown, f"a claim of kind {claim.kind!r}"))
    if claim.kind == "mu-axis" and "band" in claim.numbers:
        kind = BAND
    number = None
    before = flint.ctx.prec
    try:
        with np.errstate(all="ignore"):
            verdict = kind.prove(claim, work)
        number = _number(claim, kind)
    except (InputError, NoTrustworthyNumber) as error:
        verdict = not_proved(str(error))
    except (ArithmeticError, np.linalg.LinAlgError) as error:
        # Overflow or no convergence in a hint, or a division by a ball around zero: no proof was reached.
        verdict = not_proved(f"the arithmetic ended: {error}")
    finally:
        flint.ctx.prec = before
    told = kind.words if number is None else f"{kind.words}: {kind.symbol} {number:.17g}"
    return Verification(told, verdict.outcome, number if verdict.proved else None, verdict.where, work.boxes)


def _unknown(claim: Claim, work: Work) -> Verdict:
    return not_proved(f"no such kind of claim; there are {', '.join(KINDS)}")


def _number(claim: Claim, kind: _Kind) -> float | None:
    """The one number of the claim, a lower bound rounded down; None where there is none, or blocks differ in it."""
    values = set(np.ravel(claim.numbers[kind.number]).tolist()) if kind.number is not None else set()
    if len(values) != 1:
        return None
    with precision(PRECISIONS[0]):
        return rounded_down(arb(values.pop()) / arb(ALLOWANCE)) if kind.below else float(values.pop())
