"""H2 norm by two Gramians that the residues of the modes confirm, or else by one in extended precision."""

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
from robustlab.norms.bounded_real import gramian_matrix, gramian_square
from robustlab.norms.hinfinity import unstable_norm
from robustlab.norms.level_set import well_scaled
from robustlab.norms.numbers import above, model_numbers
from robustlab.result import Status
from robustlab.shown import Facts, Shown, number
from robustlab.statespace import StateSpaceModel, as_model
from robustlab.verification.checker import check
from robustlab.verification.claim import Claim, Outcome

__all__ = ["H2Norm", "h2_by_channels", "h2_by_gramians", "h2_norm"]

EPS = float(np.finfo(float).eps)
# Gramians that differ by more than the first share of the norm disagree; below the second nothing was lost.
AGREE, SAME = 1e-6, 1e-10
# Bound of the error of what the modes give, as a share, up to which that confirms the Gramians.
RESIDUES = 1e-7


@dataclass(frozen=True)
class H2Norm(Shown):
    """H2 norm of a model with its evidence.

    Attributes
    ----------
    value
        The larger of what the two Gramians give, or the norm by one in extended precision.
    status
        CONVERGED where the modes give the same, or the Gramian in extended precision was proved; CERTIFIED for a norm
        that is infinite or needs no equation; INACCURATE where nothing confirms it, FAILED without a solution.
    reason
        Why it is infinite or inaccurate; else empty.
    system
        The model that it is the norm of, for `robustlab.verify`.
    """

    value: float
    status: Status
    reason: str = ""
    system: StateSpaceModel | None = field(default=None, compare=False)

    quantities: ClassVar[Mapping[str, Any]] = {"value": float}

    def headline(self) -> str:
        return f"H2 norm {number(self.value, digits=8)}"

    def facts(self) -> Facts:
        return [("norm", number(self.value, digits=6)), ("reason", self.reason)]

    def to_json(self) -> dict[str, object]:
        return {name: value for name, value in vars(self).items() if name != "system"}


@told_as("h2_norm")
def h2_norm(model: Any) -> H2Norm:
    r"""H2 norm: the response to white noise, by two Gramians that must agree.

    .. math:: \|G\|_2^2 = \frac{1}{2\pi} \int_{-\infty}^{\infty} \mathrm{tr}\, G(j\omega) G(j\omega)^* d\omega
        = \mathrm{tr}(C P C^T) = \mathrm{tr}(B^T Q B), \quad
        A P + P A^T + B B^T = 0, \quad A^T Q + Q A + C^T C = 0

    and, discrete, :math:`\|G\|_2^2 = \mathrm{tr}(C P C^T + D D^T)` with ``A P A^T - P + B B^T = 0``, the mean of
    ``tr G G^*`` over the unit circle. The sum of the residues of the model's modes, with a bound of its error that is
    proved from A, B, C, has to be the same to 1e-10; elsewhere a Gramian is computed anew by residuals in extended
    precision, and counts where ball arithmetic proves the norm from it.

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
    >>> round(norm.value, 9), norm.status.value
    (3.0, 'converged')
    """
    given = as_model(model, "h2_norm")
    found, solved = _by_gramians(moderated(given, "h2_norm"))
    if solved is not None and not _by_residues(found, solved):
        found = _in_balls(found, solved)
    found = replace(found, system=given)
    return replace(found, reason=with_hidden(found.reason, given)) if np.isinf(found.value) else found


def _by_residues(found: H2Norm, solved: _Solved) -> bool:
    """Whether the modes, which solve no equation, give the same norm: Gramians of one Schur form err together."""
    modes = ModalResponse.of_model(solved.model)
    if modes is None or found.status is not Status.CONVERGED:
        return False
    square, error = modes.mean_square(solved.model.is_discrete)
    return error <= RESIDUES * square and _agree(solved.norm(square), found.value, SAME)


def _in_balls(found: H2Norm, solved: _Solved) -> H2Norm:
    """The norm by a Gramian in extended precision where the checker proves it; else that of `found`, inaccurate."""
    model = solved.model
    square = gramian_square(model)
    if square is not None and square >= 0:
        value, numbers = float(np.sqrt(square)), model_numbers(model)
        level = above(value)
        claimed = {**numbers, "value": np.array(level), **gramian_matrix(model, value, level, numbers)}
        if check(Claim("gramian", claimed)).outcome is Outcome.PROVED:
            return H2Norm(solved.norm(square), Status.CONVERGED)
    reason = found.reason or "neither the modes nor a Gramian in extended precision confirm the Gramians"
    return replace(found, status=Status.INACCURATE, reason=reason)


def h2_by_gramians(model: Any) -> H2Norm:
    """`h2_norm` for searches: INACCURATE where the two Gramians differ by more than 1e-6."""
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

    def _squares(self) -> list[float]:
        s = self.model
        return [float(np.trace(s.C @ self.reach @ s.C.T)), float(np.trace(s.B.T @ self.see @ s.B))]

    def both(self) -> tuple[float, float]:
        """The norm by each of them."""
        direct = float((self.model.D**2).sum())
        one, two = (self.norm(max(x, 0.0) + direct) for x in self._squares())
        return one, two

    def of_gramians(self) -> H2Norm:
        """The norm by both of them."""
        s, squares = self.model, self._squares()
        sizes = [np.abs(s.C) @ np.abs(self.reach) @ np.abs(s.C.T), np.abs(s.B.T) @ np.abs(self.see) @ np.abs(s.B)]
        one, two = self.both()
        reason = "" if _agree(one, two) else f"the two Gramians give {one:.9g} and {two:.9g}"
        if any(x < -s.n_states * EPS * np.trace(size) for x, size in zip(squares, sizes, strict=True)):
            reason = "a Gramian came out indefinite"
        reason = reason or self.doubt
        return H2Norm(max(one, two), Status.INACCURATE if reason else Status.CONVERGED, reason)


def _agree(one: float, two: float, share: float = AGREE) -> bool:
    return abs(one - two) <= share * max(one, two)


def _by_gramians(ordinary: Moderated) -> tuple[H2Norm, _Solved | None]:
    """The norm by both Gramians, and these; None where the norm needs none, or there are none."""
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
    found = _solved(ordinary, s, rate, doubt)
    if found[0].status is not Status.CONVERGED:
        # States that weigh inputs and outputs alike may make A lopsided, whose Schur form then loses small entries.
        t = balancing_factors(s.A)
        again = StateSpaceModel(s.A / t[:, None] * t, s.B / t[:, None], s.C * t, s.D, s.dt)
        other = _solved(ordinary, again, rate, doubt) if (t != t[0]).any() else found
        found = other if other[0].status is Status.CONVERGED or found[1] is None else found
    return found


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
