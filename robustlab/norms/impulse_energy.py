"""H2 norm by Gramians and, as a voice that solves no equation, by the integral over the frequency axis."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import numpy as np

from robustlab.arrays import AnyArray
from robustlab.errors import NoTrustworthyNumber, told_as
from robustlab.linear_analysis.exact import exactly_stable
from robustlab.linear_analysis.magnitude import Moderated, balancing_factors, moderated
from robustlab.linear_analysis.matrix_equations import lyapunov
from robustlab.linear_analysis.modal_response import ModalResponse
from robustlab.linear_analysis.schur_lyapunov import SchurForm, balanced_schur
from robustlab.linear_analysis.structural import with_hidden
from robustlab.norms.axis_integral import TUNING, mean_square_gain
from robustlab.norms.hinfinity import unstable_norm
from robustlab.norms.level_set import well_scaled
from robustlab.result import Status
from robustlab.shown import Facts, Shown, number
from robustlab.statespace import StateSpaceModel, as_model

__all__ = ["H2Norm", "h2_by_channels", "h2_by_gramians", "h2_norm"]

EPS = float(np.finfo(float).eps)
# Voices that differ by more than the first share of the norm disagree; below the second nothing was lost.
AGREE, SAME = 1e-6, 1e-10


@dataclass(frozen=True)
class H2Norm(Shown):
    """H2 norm of a model with its evidence.

    Attributes
    ----------
    value
        The norm by one Gramian, where the integral is the same; where it was not asked, or does not confirm it, the
        larger of what the two Gramians give.
    status
        CONVERGED where all voices that were asked agree to 1e-6 of the norm; CERTIFIED for a norm that is infinite or
        needs no equation; INACCURATE where they disagree, FAILED without a solution.
    reason
        Why it is infinite or inaccurate; else empty.
    integral
        The norm again, from the integral over the frequency axis; None where it was not asked.
    system
        The model that it is the norm of, for `robustlab.verify`.
    """

    value: float
    status: Status
    reason: str = ""
    integral: float | None = None
    system: StateSpaceModel | None = field(default=None, compare=False)

    quantities: ClassVar[Mapping[str, Any]] = {"value": float, "integral": float}

    def headline(self) -> str:
        return f"H2 norm {number(self.value, digits=8)}"

    def facts(self) -> Facts:
        by_integral = number(self.integral, digits=6)
        return [("norm", number(self.value, digits=6)), ("by the integral", by_integral), ("reason", self.reason)]

    def to_json(self) -> dict[str, object]:
        return {name: value for name, value in vars(self).items() if name != "system"}


@told_as("h2_norm")
def h2_norm(model: Any) -> H2Norm:
    r"""H2 norm: the response to white noise, in two voices that must agree, or three.

    .. math:: \|G\|_2^2 = \frac{1}{2\pi} \int_{-\infty}^{\infty} \mathrm{tr}\, G(j\omega) G(j\omega)^* d\omega
        = \mathrm{tr}(C P C^T) = \mathrm{tr}(B^T Q B), \quad
        A P + P A^T + B B^T = 0, \quad A^T Q + Q A + C^T C = 0

    and, discrete, :math:`\|G\|_2^2 = \mathrm{tr}(C P C^T + D D^T)` with ``A P A^T - P + B B^T = 0``, the mean of
    ``tr G G^*`` over the unit circle. The integral is the sum of the residues of the model's modes, with a bound of its
    error that is proved from A, B, C; where that is too large, adaptive quadrature of frequency responses. Where it and
    the Gramian P agree to 1e-10 that is the answer. Elsewhere Q speaks too, and what the Gramians have lost is taken
    back by their residuals in extended precision, to the product of their errors; where the integral still disagrees it
    is computed once more from refined responses. A Schur form is shared by the Gramians, and gives the modes.

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
    given = as_model(model, "h2_norm")
    found = replace(_in_three_voices(given), system=given)
    return replace(found, reason=with_hidden(found.reason, given)) if np.isinf(found.value) else found


def _in_three_voices(given: StateSpaceModel) -> H2Norm:
    found, solved = _by_gramians(moderated(given, "h2_norm"), with_modes=True)
    if solved is None:
        return found
    for careful in (False, True):
        try:
            square, settled = mean_square_gain(solved.model, careful=careful)
        except NoTrustworthyNumber as error:
            text = f"no integral over the frequency axis: {error.found}"
            return replace(found, status=Status.INACCURATE, reason=found.reason or text)
        integral = solved.norm(square)
        if not settled:
            break
        nothing_lost = _agree(integral, found.value, SAME)
        value = found.value if nothing_lost else solved.norm(solved.stationary_square())
        if _agree(integral, value) and not solved.doubt:
            return H2Norm(value, Status.CONVERGED, "", integral)
    text = f"the Gramians give {found.value:.9g}, the integral over the frequency axis {integral:.9g}"
    text = text if settled else f"the integral over the frequency axis did not settle at {integral:.9g}"
    return H2Norm(found.value, Status.INACCURATE, found.reason or text, integral)


def h2_by_gramians(model: Any) -> H2Norm:
    """`h2_norm` without its third voice, for searches: INACCURATE where the two Gramians differ by more than 1e-6."""
    return h2_by_channels(model)[0]


@told_as("h2_norm")
def h2_by_channels(model: Any) -> tuple[H2Norm, AnyArray, AnyArray]:
    """`h2_by_gramians`, and what outputs (n_y,) and inputs (n_u,) have of its square, in no unit; zeros without one."""
    ordinary = moderated(as_model(model, "h2_norm"), "h2_norm")
    found, solved = _by_gramians(ordinary)
    if solved is None:
        return found, np.zeros(ordinary.model.n_outputs), np.zeros(ordinary.model.n_inputs)
    s = solved.model
    out = ((s.C @ solved.reach) * s.C).sum(1) + (s.D**2).sum(1)
    return found, out, ((solved.see @ s.B) * s.B).sum(0) + (s.D**2).sum(0)


@dataclass(frozen=True)
class _Solved:
    """Both Gramians (n, n) of the ordinary model in other states and in the time unit 1/rate, where a norm comes from.

    ``doubt`` says why the model may not be stable.
    """

    ordinary: Moderated
    model: StateSpaceModel
    rate: float
    reach: AnyArray
    see: AnyArray
    doubt: str = ""

    def norm(self, square: float) -> float:
        """The norm of the model as given from the square of that of this one."""
        # A discrete sum has no time unit; a continuous integral has that of the ordinary model.
        power = 0.0 if self.model.is_discrete else 0.5
        return self.ordinary.value(float(np.sqrt(self.rate * max(square, 0.0))), "h2_norm", power)

    def of_gramians(self) -> H2Norm:
        """The norm by both of them."""
        s, direct = self.model, float((self.model.D**2).sum())
        squares = [float(np.trace(s.C @ self.reach @ s.C.T)), float(np.trace(s.B.T @ self.see @ s.B))]
        sizes = [np.abs(s.C) @ np.abs(self.reach) @ np.abs(s.C.T), np.abs(s.B.T) @ np.abs(self.see) @ np.abs(s.B)]
        one, two = (self.norm(max(x, 0.0) + direct) for x in squares)
        reason = "" if _agree(one, two) else f"the two Gramians give {one:.9g} and {two:.9g}"
        if any(x < -s.n_states * EPS * np.trace(size) for x, size in zip(squares, sizes, strict=True)):
            reason = "a Gramian came out indefinite"
        reason = reason or self.doubt
        return H2Norm(max(one, two), Status.INACCURATE if reason else Status.CONVERGED, reason)

    def stationary_square(self) -> float:
        r"""The square of the norm, off by the product of what the two Gramians are off, in extended precision.

        .. math:: \|G\|_2^2 = \mathrm{tr}(C P C^T) + \mathrm{tr}(Q R) - \mathrm{tr}(\Delta Q\, R), \qquad
            R = A P + P A^T + B B^T \quad (A P A^T - P + B B^T)
        """
        s = self.model
        A, B, C, D, P, Q = (x.astype(np.longdouble) for x in (s.A, s.B, s.C, s.D, self.reach, self.see))
        moved = A @ P
        # Q is symmetric: A P and its transpose weigh the same.
        left = moved @ A.T - P if s.is_discrete else 2 * moved
        return float((C @ P * C).sum() + (Q * left).sum() + (Q @ B * B).sum() + (D**2).sum())


def _agree(one: float, two: float, share: float = AGREE) -> bool:
    return abs(one - two) <= share * max(one, two)


def _by_gramians(ordinary: Moderated, with_modes: bool = False) -> tuple[H2Norm, _Solved | None]:
    """The norm by both Gramians, and these; None where the norm needs none, or there are none, or the modes agree."""
    m = ordinary.model
    outside = unstable_norm(m, ordinary.rate) if m.n_states else None
    if outside is not None and (outside.status is Status.CERTIFIED or not m.is_stable()):
        return H2Norm(np.inf, outside.status, outside.reason), None
    if not m.is_discrete and m.D.any():
        return H2Norm(np.inf, Status.CERTIFIED, "the model has a direct term"), None
    if not m.n_states:
        return H2Norm(ordinary.value(float(np.linalg.norm(m.D)), "h2_norm"), Status.CERTIFIED), None
    doubt = outside.reason if outside is not None and exactly_stable(m.A, m.is_discrete) is None else ""
    if not m.is_discrete and "_schur" in vars(m):
        form, t = balanced_schur(m)
        balanced = StateSpaceModel(m.A / t[:, None] * t, m.B / t[:, None], m.C * t, m.D, m.dt)
        found = _solved(ordinary, balanced, 1.0, doubt, form)
        if found[0].status is Status.CONVERGED:
            return found
    # In the time unit 1/rate the impulse response keeps its square integral divided by rate.
    s, rate = (m, 1.0) if m.is_discrete else well_scaled(m)
    confirmed = _confirmed(ordinary, s, rate) if with_modes and not doubt and not m.is_discrete else None
    if confirmed is not None:
        return confirmed, None
    found = _solved(ordinary, s, rate, doubt)
    if found[0].status is not Status.CONVERGED:
        # States that weigh inputs and outputs alike may make A lopsided, whose Schur form then loses small entries.
        t = balancing_factors(s.A)
        again = StateSpaceModel(s.A / t[:, None] * t, s.B / t[:, None], s.C * t, s.D, s.dt)
        other = _solved(ordinary, again, rate, doubt) if (t != t[0]).any() else found
        found = other if other[0].status is Status.CONVERGED or found[1] is None else found
    return found


def _confirmed(ordinary: Moderated, s: StateSpaceModel, rate: float) -> H2Norm | None:
    """The norm of a continuous model by one Gramian and by its modes; None where they do not agree to all digits."""
    try:
        form = SchurForm.of(s.A, "gramians")
        solved = _Solved(ordinary, s, rate, form.gramian(s.B), np.zeros_like(s.A))
    except NoTrustworthyNumber:
        return None
    modes = ModalResponse.of_model(s._with_modes(form.modes()))
    square, error = (0.0, np.inf) if modes is None else modes.mean_square(False)
    value, integral = solved.norm(float(((s.C @ solved.reach) * s.C).sum())), solved.norm(square)
    if not (error <= TUNING.rtol * square and _agree(value, integral, SAME)):
        return None
    return H2Norm(value, Status.CONVERGED, "", integral)


def _solved(
    ordinary: Moderated, s: StateSpaceModel, rate: float, doubt: str, form: SchurForm | None = None
) -> tuple[H2Norm, _Solved | None]:
    try:
        if s.is_discrete:
            reach, see = lyapunov(s.A, s.B @ s.B.T, True), lyapunov(s.A.T, s.C.T @ s.C, True)
        else:
            form = form or SchurForm.of(s.A, "gramians")
            reach, see = form.gramian(s.B), form.gramian(s.C.T, dual=True)
        solved = _Solved(ordinary, s, rate, reach, see, doubt)
    except NoTrustworthyNumber as error:
        return H2Norm(np.inf, Status.FAILED, error.line), None
    return solved.of_gramians(), solved
