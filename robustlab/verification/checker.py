"""The kinds of claims, and `check`, which proves or refutes one."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import flint
import numpy as np
from flint import arb

from robustlab.errors import InputError, NoTrustworthyNumber
from robustlab.verification.balls import PRECISIONS, precision, rounded_down
from robustlab.verification.claim import Claim, Verdict, Verification, Work, not_proved
from robustlab.verification.delay_weights import prove_delay_weight
from robustlab.verification.iqc import prove_multipliers
from robustlab.verification.models import difference, loop, model_of, static, stored
from robustlab.verification.mu import (
    ALLOWANCE,
    as_performance,
    prove_mu_axis,
    prove_mu_lower,
    prove_mu_upper,
    prove_set,
    prove_unstable_member,
)
from robustlab.verification.norms import prove_bounded_real, prove_gramian, prove_norm, prove_stable
from robustlab.verification.parameters import prove_parameters

EFFORT = 20_000  # units of `Work`: about two minutes

NORM = "H-infinity norm over all frequencies <="
GAIN = "every member is stable"
NONE = "no Delta of the structure within 1/level"
SOME = "a Delta of the structure within (1 + 1e-9)/level"


@dataclass(frozen=True)
class _Kind:
    prove: Callable[[Claim, Work], Verdict]
    words: str  # the claim
    number: str | None = None  # the dataset with the claimed number
    symbol: str = ""  # printed before the number
    below: bool = False  # a lower bound: the level divided by the allowance


# fmt: off
KINDS: Mapping[str, _Kind] = {
    "stable": _Kind(prove_stable, "all eigenvalues of A lie inside the stability boundary"),
    "norm": _Kind(lambda c, w: prove_norm(c, stored, w), "the model is stable", "gamma", NORM),
    "bounded-real": _Kind(
        lambda c, w: prove_bounded_real(c, model_of, w), "the model is stable", "gamma", NORM),
    "loop-norm": _Kind(lambda c, w: prove_norm(c, loop, w), "the loop is stable", "gamma", NORM),
    "difference-norm": _Kind(lambda c, w: prove_norm(c, difference, w), "the difference is stable", "gamma", NORM),
    "gramian": _Kind(prove_gramian, "the model is stable", "value", "H2 norm <="),
    "mu-upper": _Kind(prove_mu_upper, f"{NONE} makes I - M Delta singular", "level", "mu <="),
    "mu-axis": _Kind(
        prove_mu_axis, "stable for every Delta of the structure within 1/level", "level", "mu over all frequencies <="),
    "mu-boxes": _Kind(
        lambda c, w: prove_mu_axis(c, w, boxed=True), "stable for all real parameters within size times their ranges "
        "and all other blocks within 1/level", "size", "size >="),
    "mu-upper-boxes": _Kind(
        lambda c, w: prove_mu_axis(c, w, static, boxed=True), "no real parameters within size times their ranges, "
        "with all other blocks within 1/level, make I - M Delta singular", "size", "size >="),
    "worst-gain": _Kind(lambda c, w: prove_mu_axis(as_performance(c), w), GAIN, "gamma", "worst-case gain <="),
    "worst-gain-boxes": _Kind(
        lambda c, w: prove_mu_axis(as_performance(c), w, boxed=True), GAIN, "gamma", "worst-case gain <="),
    "iqc-size": _Kind(
        lambda c, w: prove_multipliers(c, w, gain=False), "stable for all blocks of their types within size times "
        "their ranges", "size", "size >="),
    "iqc-gain": _Kind(
        lambda c, w: prove_multipliers(c, w, gain=True), "stable for all blocks of their types", "gamma",
        "worst-case gain <="),
    "lpv-gain": _Kind(
        prove_parameters, "stable for all trajectories of the parameters within their ranges and rates", "gamma",
        "gain <="),
    "mu-lower": _Kind(prove_mu_lower, f"{SOME} makes I - M Delta singular", "level", "mu >=", below=True),
    "unstable-member": _Kind(
        prove_unstable_member, f"{SOME} gives a pole on or beyond the stability boundary, or no well-posed model",
        "level", "level", below=True),
    "delayed-stable": _Kind(
        lambda c, w: prove_mu_axis(Claim(c.kind, {**c.numbers, "level": np.array(1.0)}), w),
        "stable for every Delta of the structure within 1, so for the exact delays"),
    "delay-weight": _Kind(
        prove_delay_weight, "the weight and the tolerance cover what R misses of every delay of the range, at all "
        "frequencies", "tolerance", "tolerance"),
    "set": _Kind(prove_set, "the set is the nominal model at parameters 0 and the perturbed one at 1, by every entry"),
}
BAND = _Kind(  # "mu-axis" where a band is given
    lambda c, w: prove_mu_axis(c, w, banded=True),
    f"{NONE} makes I - M(jw) Delta singular at a frequency of the band up to pi/dt", "level", "mu <=")
NEARLY = _Kind(prove_set, "the set is the nominal model at parameters 0 and the perturbed one at 1", "tolerance",
               "every entry to within the tolerance")  # "set" where one is given
MEMBER = _Kind(prove_set, "the model is the member of the set at the given parameters, within their ranges",
               "tolerance", "every entry to within the tolerance")  # "set" with parameters
# fmt: on


def check(claim: Claim, *, effort: int = EFFORT) -> Verification:
    """Prove or refute a claim from its numbers alone.

    ``effort``: the limit, in tests of definiteness of 20 rows.
    Never raises for the content of a claim: an ill-formed one is not proved, with the reason in ``where``.
    """
    claim, work = Claim(claim.kind, dict(claim.numbers)), Work(effort)
    kind = KINDS.get(claim.kind, _Kind(_unknown, f"a claim of kind {claim.kind!r}"))
    if claim.kind == "mu-axis" and "band" in claim.numbers:
        kind = BAND
    if claim.kind == "set" and "tolerance" in claim.numbers:
        kind = MEMBER if "delta" in claim.numbers else NEARLY
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
    text = kind.words if number is None else f"{kind.words}: {kind.symbol} {number:.17g}"
    return Verification(text, verdict.outcome, number if verdict.proved else None, verdict.where, work.boxes)


def _unknown(claim: Claim, work: Work) -> Verdict:
    return not_proved(f"no such kind of claim; there are {', '.join(KINDS)}")


def _number(claim: Claim, kind: _Kind) -> float | None:
    """Return the claim's number, a lower bound rounded down; None where there is none, or blocks differ in it."""
    values = set(np.ravel(claim.numbers[kind.number]).tolist()) if kind.number is not None else set()
    if len(values) != 1:
        return None
    with precision(PRECISIONS[0]):
        return rounded_down(arb(values.pop()) / arb(ALLOWANCE)) if kind.below else float(values.pop())
