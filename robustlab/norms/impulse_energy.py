"""H2 norm by both Gramians and, as a third voice, by the integral over the frequency axis."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from robustlab.errors import NoTrustworthyNumber, told_as
from robustlab.exact_stability import exactly_stable
from robustlab.magnitude import Moderated, balancing_factors, moderated
from robustlab.matrix_equations import gramians
from robustlab.norms.axis_integral import mean_square_gain
from robustlab.norms.hinfinity import unstable_norm
from robustlab.norms.level_set import well_scaled
from robustlab.result import Status
from robustlab.shown import Facts, Shown, number
from robustlab.statespace import StateSpaceModel, as_model

__all__ = ["H2Norm", "h2_by_gramians", "h2_norm"]

EPS = float(np.finfo(float).eps)
# Voices that differ by more than this share of the norm disagree.
AGREE = 1e-6


@dataclass(frozen=True)
class H2Norm(Shown):
    """H2 norm of a model with its evidence.

    Attributes
    ----------
    value
        The norm, the larger of what the two Gramians give.
    status
        CONVERGED where all voices that were asked agree to 1e-6 of the norm; CERTIFIED for a norm that is infinite or
        needs no equation; INACCURATE where they disagree, FAILED without a solution.
    reason
        Why it is infinite or inaccurate; else empty.
    integral
        The norm again, from the integral over the frequency axis; None where it was not asked.
    """

    value: float
    status: Status
    reason: str = ""
    integral: float | None = None

    def facts(self) -> Facts:
        """What a person wants to read, as (label, text)."""
        by_integral = number(self.integral, digits=6)
        return [("norm", number(self.value, digits=6)), ("by the integral", by_integral), ("reason", self.reason)]

    def to_json(self) -> dict[str, object]:
        """All fields."""
        return vars(self).copy()


@told_as("h2_norm")
def h2_norm(model: Any) -> H2Norm:
    r"""H2 norm: the response to white noise, in three voices that must agree.

    .. math:: \|G\|_2^2 = \frac{1}{2\pi} \int_{-\infty}^{\infty} \mathrm{tr}\, G(j\omega) G(j\omega)^* d\omega
        = \mathrm{tr}(C P C^T) = \mathrm{tr}(B^T Q B), \quad
        A P + P A^T + B B^T = 0, \quad A^T Q + Q A + C^T C = 0

    and, discrete, :math:`\|G\|_2^2 = \mathrm{tr}(C P C^T + D D^T)` with ``A P A^T - P + B B^T = 0``, the mean of
    ``tr G G^*`` over the unit circle. The two Gramians share a Schur form; the integral, by adaptive quadrature, needs
    frequency responses alone.

    Parameters
    ----------
    model
        Model with any numbers of states, inputs and outputs, including zero; or a python-control object.

    Returns
    -------
    H2Norm
        Infinite for a model that is unstable or has poles on the stability boundary, reachable or not, and for a
        continuous one with D != 0.

    Raises
    ------
    InputError
        No model.
    NoTrustworthyNumber
        The norm is larger than the largest floating-point number.

    References
    ----------
    Zhou, Doyle, Glover, *Robust and Optimal Control* (1996), section 4.4.

    Examples
    --------
    >>> lag = StateSpaceModel([[-2.0]], [[1.0]], [[6.0]], [[0.0]])
    >>> norm = h2_norm(lag)
    >>> round(norm.value, 9), round(norm.integral, 9), norm.status.value
    (3.0, 3.0, 'converged')
    """
    found = h2_by_gramians(model)
    if found.status not in (Status.CONVERGED, Status.INACCURATE) or not np.isfinite(found.value):
        return found
    ordinary = moderated(as_model(model, "h2_norm"), "h2_norm")
    try:
        square, settled = mean_square_gain(ordinary.model)
    except NoTrustworthyNumber as error:
        return replace(found, status=Status.INACCURATE, reason=f"no integral over the frequency axis: {error.found}")
    integral = ordinary.value(float(np.sqrt(square)), "h2_norm", 0.0 if ordinary.model.is_discrete else 0.5)
    found = replace(found, integral=integral)
    if found.status is Status.INACCURATE:
        return found
    if not settled:
        text = f"the integral over the frequency axis did not settle at {integral:.9g}"
    elif abs(integral - found.value) > AGREE * max(integral, found.value):
        text = f"the Gramians give {found.value:.9g}, the integral over the frequency axis {integral:.9g}"
    else:
        return found
    return replace(found, status=Status.INACCURATE, reason=text)


@told_as("h2_norm")
def h2_by_gramians(model: Any) -> H2Norm:
    """`h2_norm` without its third voice, for searches: INACCURATE where the two Gramians differ by more than 1e-6."""
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
    agree = not lost and abs(one - two) <= AGREE * max(one, two)
    reason = "a Gramian came out indefinite" if lost else f"the two Gramians give {one:.9g} and {two:.9g}"
    reason = "" if agree else reason
    return H2Norm(float(max(one, two)), Status.CONVERGED if agree else Status.INACCURATE, reason)
