"""`check`: a claim in, its verdict out; never an exception, and "proved" only where a theorem's conditions were proved."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import flint
import numpy as np

from robustlab.errors import InputError, NoTrustworthyNumber
from robustlab.verify.claim import Claim, Outcome, Verdict, Verification, Work, not_proved
from robustlab.verify.models import difference, loop, stored
from robustlab.verify.norms import prove_gramian, prove_norm, prove_stable

EFFORT = 20_000  # units of `Work`: some two minutes


# kind: how it is proved, the claim in words, the dataset whose number the words end with
PROVERS: Mapping[str, tuple[Callable[[Claim, Work], Verdict], str, str | None]] = {
    "stable": (prove_stable, "all eigenvalues of A lie inside the stability boundary", None),
    "norm": (lambda c, w: prove_norm(c, stored, w), "stable, and H-infinity norm <=", "gamma"),
    "loop-norm": (lambda c, w: prove_norm(c, loop, w), "the loop is stable, and its H-infinity norm <=", "gamma"),
    "difference-norm": (
        lambda c, w: prove_norm(c, difference, w),
        "the difference is stable, and its H-infinity norm <=",
        "gamma",
    ),
    "gramian": (prove_gramian, "stable, and H2 norm <=", "value"),
}


def check(claim: Claim, *, effort: int = EFFORT) -> Verification:
    """Judge a claim from its numbers alone.

    ``claim``: what is claimed, with its evidence.
    ``effort``: tests of definiteness of 20 rows that it may cost; the count and not the clock ends a check.
    Never raises for what a claim holds: what is ill-formed is not proved, and ``where`` says why.
    """
    work = Work(effort)
    prover, words, name = PROVERS.get(claim.kind, (_unknown, f"a claim of kind {claim.kind!r}", None))
    number = None
    before = flint.ctx.prec
    try:
        with np.errstate(all="ignore"):
            verdict = prover(claim, work)
        number = _number(claim, name)
    except (InputError, NoTrustworthyNumber) as error:
        verdict = not_proved(str(error))
    except (ArithmeticError, np.linalg.LinAlgError) as error:
        # Overflow or no convergence in a hint, or a division by a ball around zero: no proof was reached.
        verdict = not_proved(f"the arithmetic ended: {error}")
    finally:
        flint.ctx.prec = before
    told = words if number is None else f"{words} {number:.17g}"
    return Verification(told, verdict.outcome, number if verdict.proved else None, verdict.where, work.boxes)


def _unknown(claim: Claim, work: Work) -> Verdict:
    return not_proved(f"no such kind of claim; there are {', '.join(PROVERS)}")


def _number(claim: Claim, name: str | None) -> float | None:
    """The one number of the named dataset; None where its entries differ."""
    values = set(np.ravel(claim.numbers[name]).tolist()) if name is not None else set()
    return float(values.pop()) if len(values) == 1 else None
