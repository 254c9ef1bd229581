"""What may change in a watched machine: the parameters of its model, and the effects that the model has not."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from robustlab.arrays import Array
from robustlab.identification.hypotheses.effect_fit import Candidate, Hypothesis, Problem
from robustlab.identification.monitoring.change_test import Columns
from robustlab.identification.naming.first_look import Start, extended, may_follow


@dataclass(frozen=True, eq=False)
class Change:
    """One thing that may change.

    Attributes
    ----------
    at
        Index of a parameter among the standardised ones; None of an effect that comes in.
    starts
        Of an effect that comes in: where fits of it begin.
    size
        A usual strength, in units of its column: a log factor of one for a parameter that is scaled.
    """

    at: int | None
    starts: tuple[Start, ...]
    size: float


def possible_changes(
    problem: Problem, hypothesis: Hypothesis, z: Array, pool: Sequence[Candidate]
) -> tuple[Change, ...]:
    """The parameters of the model, and every effect of the pool that it may get.

    ``hypothesis``, ``z``: the effects that it has, and all standardised parameters. A wrong parameter of the plant is
    that parameter, where it is refitted; the shift of a clock is none.
    """
    found = []
    for at, nuisance in enumerate(problem.nuisances):
        if nuisance.input:
            continue
        size = 1.0 if nuisance.additive else 1.0 / nuisance.spread
        found.append(Change(at, (), size))
    at = len(problem.nuisances)
    for candidate in hypothesis.candidates:
        for p in candidate.parameters:
            size = 1.0 / p.prior.spread if p.prior.kind == "log" else 1.0
            found.append(Change(at, (), size))
            at += 1
    refitted = {n.label for n in problem.nuisances}
    coming: dict[str, tuple[Candidate, list[Start]]] = {}
    for c in pool:
        if (
            not may_follow(c, hypothesis)
            or c.effect.long_memory
            or (c.site.kind == "parameter" and c.site.name in refitted)
        ):
            continue
        starts = [Start(c, *extended(problem, hypothesis, z, c, start)) for start in c.starts]
        coming.setdefault(c.key, (c, []))[1].extend(starts)
    return (*found, *(Change(None, tuple(starts), 1.0) for _, starts in coming.values()))


def columns_of(changes: Sequence[Change], own: int) -> Columns:
    """One column a parameter; of an effect one a start, or one a linear parameter where it has such."""
    of, size, signed = np.full(own, -1), np.ones(own), np.zeros(own, dtype=bool)
    for k, change in enumerate(changes):
        if change.at is not None:
            of[change.at], size[change.at] = k, change.size
    more = [(k, start) for k, c in enumerate(changes) for start in c.starts]
    for k, start in more:
        linear = sum(p.prior.kind == "linear" for p in start.candidate.parameters)
        of = np.append(of, [k] * max(linear, 1))
        signed = np.append(signed, [not linear] * max(linear, 1))
    size = np.append(size, np.ones(len(of) - own))
    counts = np.array([np.sum(of == k) for k in of])
    weight = np.where(of >= 0, 1.0 / (counts * max(len(changes), 1)), 0.0)
    return Columns(own, weight, size, signed)
