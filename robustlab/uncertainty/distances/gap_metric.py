"""The distance between two models for feedback: the nu-gap (Vinnicombe, IEEE TAC 38, 1993)."""

# With G = [N; M], G~ = [M~, -N~]: |G~2 G1|_inf where det(G2* G1) is not 0 on the axis and winds zero times around the
# origin, else 1.

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from robustlab.display import Displayable, Facts, bracket, number
from robustlab.errors import InputError, error_context
from robustlab.norms import hinf_norm
from robustlab.result import Status
from robustlab.statespace import StateSpaceModel, as_model, series
from robustlab.uncertainty.distances.coprime import CoprimeFactors, continuous_models, coprime_factors

NOTHING, AGREE = 1e-12, 1e-6  # a distance indistinguishable from 0, and a difference to 1
SIDE = 1e-11  # relative real part below which the sign of an eigenvalue is uncertain


@dataclass(frozen=True)
class NuGap(Displayable):
    """The nu-gap between two models, with its evidence.

    Attributes
    ----------
    lower, upper
        ``lower <= nu-gap <= upper``.
    frequency
        Frequency of the largest pointwise (chordal) distance, in rad/s; ``inf`` for the direct terms.
    chordal
        That distance; the nu-gap where ``winding`` is 0.
    winding
        Winding number of det(G2* G1) around the origin: its zeros minus its poles in the right half plane.
    status
        CERTIFIED, or INACCURATE where a norm or the sign of a zero is uncertain.
    reason
        Why the value is 1 or inaccurate; else empty.
    """

    lower: float
    upper: float
    frequency: float
    chordal: float
    winding: int
    status: Status
    reason: str = ""

    @property
    def value(self) -> float:
        """Return the nu-gap, ``lower``."""
        return self.lower

    def facts(self) -> Facts:
        return [
            ("nu-gap", bracket(self.lower, self.upper, ("attained", "proved"))),
            ("largest at", number(self.frequency, "rad/s")),
            ("winding number", str(self.winding)),
            ("reason", self.reason),
        ]

    def to_json(self) -> dict[str, Any]:
        return {"type": "NuGap", "value": self.value, **vars(self)}


@error_context("nu_gap")
def nu_gap(P1: Any, P2: Any) -> NuGap:
    r"""Return the nu-gap metric between two models of equal size.

    The largest chordal distance over the axis is an H-infinity norm, by the level-set method; the winding number
    follows from the poles and zeros of det(G2* G1).

    Parameters
    ----------
    P1, P2
        Models with the same numbers of inputs and outputs, stable or not; both continuous or both discrete with one
        sample time. Hidden modes must be stable.

    Returns
    -------
    NuGap
        ``value`` is 1 where the winding condition fails: no controller suits both.

    Raises
    ------
    InputError
        Sizes or sample times that do not fit.
    NoTrustworthyNumber
        A model with a hidden unstable mode.

    References
    ----------
    Vinnicombe (1993); Vinnicombe, *Uncertainty and Feedback* (2001), chapter 3.

    Examples
    --------
    >>> one = StateSpaceModel([[0.001]], [[1.0]], [[1.0]], [[0.0]])
    >>> two = StateSpaceModel([[-0.001]], [[1.0]], [[1.0]], [[0.0]])
    >>> round(nu_gap(one, two).value, 6)
    0.002
    """
    m1, m2 = as_model(P1, "nu_gap: first model"), as_model(P2, "nu_gap: second model")
    if m1.D.shape != m2.D.shape:
        sizes = [f"{m.n_outputs} x {m.n_inputs}" for m in (m1, m2)]
        raise InputError("nu_gap", f"models of {sizes[0]} and {sizes[1]}", "equal sizes")
    if not m1.D.size:
        raise InputError("nu_gap", f"a model of {m1.n_outputs} x {m1.n_inputs}", "inputs and outputs")
    mapped = continuous_models(m1, m2)
    one, two = (coprime_factors(m) for m in mapped.models)
    # G2~ G1 = M2~ N1 - N2~ M1, stable; the left factors are ordered [N2~, M2~].
    (p, m), right = m1.D.shape, one.right
    swap = np.block([[np.zeros((m, p)), -np.eye(m)], [np.eye(p), np.zeros((p, m))]])
    norm = hinf_norm(series(StateSpaceModel(right.A, right.B, swap @ right.C, swap @ right.D), two.left), rtol=1e-9)
    frequency = mapped.frequency(norm.frequency)
    if norm.lower <= NOTHING:
        return NuGap(0.0, NOTHING, frequency, norm.lower, 0, Status.CERTIFIED)
    chordal = min(norm.lower, 1.0)
    winding, sure = _winding(one, two)
    if winding is None:
        text = "det(G2* G1) vanishes on the stability boundary"
        return NuGap(1.0, 1.0, frequency, chordal, 0, norm.status, text)
    status, reason = norm.status, norm.reason
    # Where the models are 1 apart at some frequency, the winding number no longer matters.
    counted = sure or norm.lower < 1 - AGREE
    if counted and not sure:
        status, reason = Status.INACCURATE, "a zero of det(G2* G1) lies too close to the stability boundary to count"
    if counted and winding != 0 and norm.lower < 1:
        text = f"det(G2* G1) winds {winding} times around the origin: no controller is good for both"
        return NuGap(1.0, 1.0, frequency, chordal, winding, status, text if sure else reason)
    upper = min(norm.upper, 1.0) if counted else 1.0
    return NuGap(chordal, upper, frequency, chordal, winding, status, reason)


def _winding(one: CoprimeFactors, two: CoprimeFactors) -> tuple[int | None, bool]:
    """Return zeros minus poles of det(G2* G1) in the right half plane, and whether all signs are certain."""
    g1, g2 = one.right, two.right
    # G2*(s) = G2(-s)^T has the matrices (-A^T, C^T, -B^T, D^T).
    A = np.block([[g1.A, np.zeros((g1.n_states, g2.n_states))], [g2.C.T @ g1.C, -g2.A.T]])
    B = np.vstack([g1.B, g2.C.T @ g1.D])
    C = np.hstack([g2.D.T @ g1.C, -g2.B.T])
    D = g2.D.T @ g1.D
    if np.linalg.svd(D, compute_uv=False)[-1] < SIDE:
        return None, True
    zeros = np.linalg.eigvals(A - B @ np.linalg.solve(D, C)) if len(A) else np.zeros(0)
    sure = bool((np.abs(zeros.real) > SIDE * np.abs(zeros).max(initial=0.0)).all())
    return int((zeros.real > 0).sum()) - g2.n_states, sure
