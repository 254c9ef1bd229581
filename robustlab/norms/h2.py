"""H2 norm by two Gramians that must agree, or else by one in extended precision, proved in ball arithmetic."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import numpy as np

from robustlab.arrays import AnyArray
from robustlab.display import Displayable, Facts, number
from robustlab.errors import NoTrustworthyNumber, error_context
from robustlab.linear_analysis import slicot
from robustlab.linear_analysis.matrices import balancing_factors, refuse_extremes, small_residual
from robustlab.linear_analysis.structural import with_hidden
from robustlab.linear_analysis.zeros import exactly_stable
from robustlab.norms.claims import above, gramian_claims, gramian_matrix, gramian_square, model_numbers
from robustlab.norms.hinfinity import unstable_norm, well_scaled
from robustlab.result import Status
from robustlab.statespace import StateSpaceModel, as_model
from robustlab.verification.checker import check
from robustlab.verification.claim import Claim, Outcome

EPS = float(np.finfo(float).eps)
# Gramians disagree if they differ by more than the first share of the norm; below the second no digits were lost.
AGREE, SAME = 1e-6, 1e-10
# A pole nearer to the boundary than this share of the fastest one has few digits: both Gramians may have one error.
DAMPED = 1e-8


@dataclass(frozen=True)
class H2Norm(Displayable):
    """H2 norm of a model with its evidence."""

    value: float  #: The larger of the values from the two Gramians, or the norm by one in extended precision
    #: CONVERGED where the Gramians agree to 1e-10, or the one in extended precision was proved; CERTIFIED for a norm
    #: that is infinite or needs no equation; INACCURATE where it is not confirmed, FAILED without a solution
    status: Status
    reason: str = ""  #: Why it is infinite or inaccurate; else empty
    system: StateSpaceModel | None = field(default=None, compare=False)  #: The model, for `robustlab.verify`

    quantities: ClassVar[Mapping[str, Any]] = {"value": float}

    def headline(self) -> str:
        return f"H2 norm {number(self.value, digits=8)}"

    def facts(self) -> Facts:
        return [("norm", number(self.value, digits=6)), ("reason", self.reason)]

    def to_json(self) -> dict[str, object]:
        return {name: value for name, value in vars(self).items() if name != "system"}


@error_context("h2_norm")
def h2_norm(model: Any) -> H2Norm:
    r"""Compute the H2 norm: the response to white noise, by two Gramians that must agree.

    .. math:: \|G\|_2^2 = \frac{1}{2\pi} \int_{-\infty}^{\infty} \mathrm{tr}\, G(j\omega) G(j\omega)^* d\omega
        = \mathrm{tr}(C P C^T) = \mathrm{tr}(B^T Q B), \quad
        A P + P A^T + B B^T = 0, \quad A^T Q + Q A + C^T C = 0

    and, discrete, :math:`\|G\|_2^2 = \mathrm{tr}(C P C^T + D D^T)` with ``A P A^T - P + B B^T = 0``, the mean of
    ``tr G G^*`` over the unit circle. If they do not agree to 1e-10, or a pole is next to the stability boundary, a
    Gramian is computed by residuals in extended precision, and used if ball arithmetic proves the norm from it.
    Zhou, Doyle, Glover, *Robust and Optimal Control* (1996), section 4.4.

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
        Entries of the model are below 1e-100 or above 1e100.

    Examples
    --------
    >>> lag = StateSpaceModel([[-2.0]], [[1.0]], [[6.0]], [[0.0]])
    >>> norm = h2_norm(lag)
    >>> round(norm.value, 9), norm.status.value
    (3.0, 'converged')
    """
    m = as_model(model, "h2_norm")
    found, gap, _, _ = h2_by_channels(m)
    if np.isnan(gap) and found.status is not Status.FAILED:
        return replace(found, system=m, reason=with_hidden(found.reason, m) if np.isinf(found.value) else found.reason)
    poles = m.poles()
    damping = (1 - np.abs(poles) if m.is_discrete else -poles.real / np.abs(poles).max()).min()
    if found.status is not Status.CONVERGED or not gap <= SAME or damping < DAMPED:
        found = _in_balls(found, m)
    return replace(found, system=m)


def _in_balls(found: H2Norm, m: StateSpaceModel) -> H2Norm:
    """Return the norm by a Gramian in extended precision if the checker proves it; else `found`, inaccurate."""
    square = gramian_square(m)
    if square is not None and square >= 0:
        value, numbers = float(np.sqrt(square)), model_numbers(m)
        level = above(value)
        claimed = {**numbers, "value": np.array(level), **gramian_matrix(m, value, level, numbers)}
        if check(Claim("gramian", claimed)).outcome is Outcome.PROVED:
            return H2Norm(value, Status.CONVERGED)
    if found.status is Status.FAILED:
        return found
    reason = found.reason or "a Gramian in extended precision does not confirm the others"
    return replace(found, status=Status.INACCURATE, reason=reason)


@error_context("h2_norm")
def h2_by_gramians(model: Any) -> H2Norm:
    """Compute `h2_norm` for searches: INACCURATE if the two Gramians differ by more than 1e-6."""
    return h2_by_channels(as_model(model, "h2_norm"))[0]


def h2_by_channels(m: StateSpaceModel) -> tuple[H2Norm, float, AnyArray, AnyArray]:
    """Compute the norm, the relative difference of both Gramians, and the parts of its square by outputs and inputs.

    Without Gramians the difference is NaN, and the parts are zero.
    """
    refuse_extremes(m, "h2_norm")
    none = np.nan, np.zeros(m.n_outputs), np.zeros(m.n_inputs)
    outside = unstable_norm(m) if m.n_states else None
    if outside is not None and (outside.status is Status.CERTIFIED or not m.is_stable()):
        return H2Norm(np.inf, outside.status, outside.reason), *none
    if not m.is_discrete and m.D.any():
        return H2Norm(np.inf, Status.CERTIFIED, "the model has a direct term"), *none
    if not m.n_states:
        return H2Norm(float(np.linalg.norm(m.D)), Status.CERTIFIED), *none
    doubt = outside.reason if outside is not None and exactly_stable(m.A, m.is_discrete) is None else ""
    if m.is_discrete:
        t = balancing_factors(m.A)
        return _solved(m._in_states(m.A / t[:, None] * t, m.B / t[:, None], m.C * t), 1.0, doubt)
    return _solved(*well_scaled(m), doubt)  # in the time unit 1/rate the impulse's square integral is divided by rate


def _solved(s: StateSpaceModel, rate: float, doubt: str) -> tuple[H2Norm, float, AnyArray, AnyArray]:
    """Compute the same in these states, whose time unit is 1/rate."""
    direct = s.D**2
    try:
        L_c, L_o = slicot.gramian_factors(s.A, s.B, s.C, s.is_discrete)
    except NoTrustworthyNumber as error:
        return H2Norm(np.inf, Status.FAILED, error.line), np.nan, np.zeros(s.n_outputs), np.zeros(s.n_inputs)
    try:
        for A, L, known in ((s.A, L_c, s.B @ s.B.T), (s.A.T, L_o, s.C.T @ s.C)):
            X = L @ L.T
            small_residual("gramians", 0.5 * (A @ X @ A.T - X) if s.is_discrete else A @ X, known, AGREE)
    except NoTrustworthyNumber as error:
        doubt = doubt or error.line
    # Only squares of the factors are added, so that an output that is nearly zero keeps its digits.
    out, into = ((s.C @ L_c) ** 2).sum(1), ((L_o.T @ s.B) ** 2).sum(0)
    one, two = (float(np.sqrt(rate * (x.sum() + direct.sum()))) for x in (out, into))
    gap = abs(one - two) / max(one, two) if max(one, two) else 0.0
    reason = doubt if gap <= AGREE else f"the two Gramians give {one:.9g} and {two:.9g}"
    norm = H2Norm(max(one, two), Status.INACCURATE if reason else Status.CONVERGED, reason)
    return norm, gap, out + direct.sum(1), into + direct.sum(0)


def h2_claims(found: H2Norm) -> list[Claim]:
    model = found.system
    if model is None or not np.isfinite(found.value) or not found.status.trustworthy:
        return []
    return gramian_claims(model, found.value)
