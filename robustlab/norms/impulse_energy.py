"""H2 norm by both Gramians."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from robustlab.errors import NoTrustworthyNumber, told_as
from robustlab.exact_stability import exactly_stable
from robustlab.magnitude import Moderated, balancing_factors, moderated
from robustlab.matrix_equations import gramians
from robustlab.norms.hinfinity import unstable_norm, well_scaled
from robustlab.result import Status
from robustlab.shown import Facts, Shown, number
from robustlab.statespace import StateSpaceModel, as_model

__all__ = ["H2Norm", "h2_norm"]

EPS = float(np.finfo(float).eps)


@dataclass(frozen=True)
class H2Norm(Shown):
    """H2 norm of a model: value, status, and why it is infinite or inaccurate."""

    value: float
    status: Status
    reason: str = ""

    def facts(self) -> Facts:
        """What a person wants to read, as (label, text)."""
        return [("norm", number(self.value, digits=6)), ("reason", self.reason)]

    def to_json(self) -> dict[str, object]:
        """All fields."""
        return vars(self).copy()


@told_as("h2_norm")
def h2_norm(model: Any) -> H2Norm:
    r"""H2 norm from both Gramians, which must agree.

    .. math:: \|G\|_2^2 = \mathrm{tr}(C P C^T) = \mathrm{tr}(B^T Q B), \quad A P + P A^T + B B^T = 0, \quad A^T Q + Q A
    + C^T C = 0

    and, discrete, :math:`\|G\|_2^2 = \mathrm{tr}(C P C^T + D D^T)` with ``A P A^T - P + B B^T = 0``.
    Infinite for an unstable model, and for a continuous one with D != 0.
    INACCURATE where the two Gramians differ by more than 1e-6.
    """
    ordinary = moderated(as_model(model, "h2_norm"), "h2_norm")
    m = ordinary.model
    outside = unstable_norm(m, ordinary.rate) if m.n_states else None
    if outside is not None and (outside.status is Status.CERTIFIED or not m.is_stable()):
        return H2Norm(np.inf, outside.status, outside.reason)
    if not m.is_discrete and m.D.any():
        return H2Norm(np.inf, Status.CERTIFIED, "the model has a direct term")
    if not m.n_states:
        return H2Norm(ordinary.value(float(np.linalg.norm(m.D)), "h2_norm"), Status.CERTIFIED)
    # In the time unit 1/rate the impulse response keeps its square integral divided by rate.
    s, rate = (m, 1.0) if m.is_discrete else well_scaled(m)
    found = _by_gramians(ordinary, s, rate)
    if found.status is not Status.CONVERGED:
        # States that weigh inputs and outputs alike may make A lopsided, whose Schur form then loses small entries.
        t = balancing_factors(s.A)
        again = StateSpaceModel(s.A / t[:, None] * t, s.B / t[:, None], s.C * t, s.D, s.dt)
        other = _by_gramians(ordinary, again, rate) if (t != t[0]).any() else found
        found = other if other.status is Status.CONVERGED else found
    if outside is not None and exactly_stable(m.A, m.is_discrete) is None and found.status is Status.CONVERGED:
        return H2Norm(found.value, Status.INACCURATE, outside.reason)
    return found


def _by_gramians(ordinary: Moderated, s: StateSpaceModel, rate: float) -> H2Norm:
    """The H2 norm of the model as given from s, which is the ordinary one in other states and in the unit 1/rate."""
    try:
        reach, see = gramians(s.A, s.B, s.C, s.is_discrete)
    except NoTrustworthyNumber as error:
        return H2Norm(np.inf, Status.FAILED, error.line)
    traces = [float(np.trace(s.C @ reach @ s.C.T)), float(np.trace(s.B.T @ see @ s.B))]
    terms = [np.abs(s.C) @ np.abs(reach) @ np.abs(s.C.T), np.abs(s.B.T) @ np.abs(see) @ np.abs(s.B)]
    lost = any(x < -len(s.A) * EPS * np.trace(t) for x, t in zip(traces, terms, strict=True))
    squares = [max(x, 0.0) for x in traces]
    # A discrete sum has no time unit; a continuous integral has that of the ordinary model.
    power, direct = (0.0, float((s.D**2).sum())) if s.is_discrete else (0.5, 0.0)
    one, two = (ordinary.value(float(np.sqrt(rate * x + direct)), "h2_norm", power) for x in squares)
    agree = not lost and abs(one - two) <= 1e-6 * max(one, two)
    reason = "a Gramian came out indefinite" if lost else f"the two Gramians give {one:.9g} and {two:.9g}"
    reason = "" if agree else reason
    return H2Norm(float(max(one, two)), Status.CONVERGED if agree else Status.INACCURATE, reason)
