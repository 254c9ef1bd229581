r"""Distances between two models that count for feedback: the nu-gap and the gap metric.

Both lie between 0 and 1, and a controller that is good for one model is good for the other where they are small,
however different the open loops look: :math:`1/(s - 0.001)` and :math:`1/(s + 0.001)` are 0.002 apart. With the
normalised graph symbols :math:`G = [N; M]`, :math:`\tilde G = [\tilde M, -\tilde N]`

.. math:: \delta_\nu(P_1, P_2) = \| \tilde G_2 G_1 \|_\infty \; \text{ where } \det(G_2^* G_1) \ne 0 \text{ on the axis
   and winds zero times around the origin, else } 1

.. math:: \delta_g(P_1, P_2) = \max(\vec\delta(P_1, P_2), \vec\delta(P_2, P_1)), \qquad
   \vec\delta(P_1, P_2) = \inf_{Q \in H_\infty} \| G_1 - G_2 Q \|_\infty

References
----------
Vinnicombe, "Frequency domain uncertainty and the graph topology", IEEE TAC 38 (1993); Georgiou, "On the computation of
the gap metric", Systems and Control Letters 11 (1988); Zhou, Doyle, Glover (1996), section 17.2.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from robustlab.errors import InputError, NoTrustworthyNumber, told_as
from robustlab.linear_analysis.matrix_equations import care, lyapunov
from robustlab.norms import HinfNorm, hinf_norm
from robustlab.result import Status
from robustlab.shown import Facts, Shown, bracket, listed, number
from robustlab.statespace import StateSpaceModel, as_model, parallel, series
from robustlab.uncertainty.distances.coprime import (
    CoprimeFactors,
    MappedModels,
    continuous_models,
    coprime_factors,
    inverse_root,
)

# Relative width of the bracket of the gap.
GAP_RTOL = 1e-8

# A step of the bisection, and a distance, that cannot be told from zero.
ROUNDING = 1e-13
NOTHING = 1e-12
# Below this distance rounding hides in the spectral factor, and Q = 1 is tried as well.
CLOSE = 1e-6
# Both directed gaps are equal where they are below 1; they are computed from different equations.
AGREE = 1e-6
# An eigenvalue whose real part is below this share of the largest has no sure side of the axis.
SIDE = 1e-11


@dataclass(frozen=True)
class NuGap(Shown):
    """The nu-gap between two models, with its evidence.

    Attributes
    ----------
    lower, upper
        ``lower <= nu-gap <= upper``.
    frequency
        Where the pointwise (chordal) distance is largest, in rad/s; ``inf`` for the direct terms.
    chordal
        That largest pointwise distance; it is the nu-gap where ``winding`` is 0.
    winding
        Winding number of det(G2* G1) around the origin: its zeros minus its poles in the right half plane.
    status
        CERTIFIED, or INACCURATE where a norm or the side of a zero is not sure.
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
        """The nu-gap; equal to ``lower``."""
        return self.lower

    def facts(self) -> Facts:
        """What a person wants to read, as (label, text)."""
        return [
            ("nu-gap", bracket(self.lower, self.upper, ("attained", "proved"))),
            ("largest at", number(self.frequency, "rad/s")),
            ("winding number", str(self.winding)),
            ("reason", self.reason),
        ]

    def to_json(self) -> dict[str, Any]:
        """All attributes."""
        return {"type": "NuGap", "value": self.value, **vars(self)}


@dataclass(frozen=True)
class GapMetric(Shown):
    """The gap between two models, with its evidence.

    Attributes
    ----------
    lower, upper
        ``lower <= gap <= upper``, in floating-point arithmetic.
    directed
        The two directed gaps (from the first model to the second, and back): equal where both are less than 1.
    nu
        The nu-gap, which is never larger.
    status
        CONVERGED, or INACCURATE where the directed gaps contradict each other or the nu-gap.
    reason
        Why it is inaccurate; else empty.
    """

    lower: float
    upper: float
    directed: tuple[float, float]
    nu: NuGap
    status: Status
    reason: str = ""
    quantities: ClassVar[Mapping[str, Any]] = {"value": "1", "lower": "1", "upper": "1", "nu_gap": "1"}

    @property
    def nu_gap(self) -> float:
        """The nu-gap: that of ``nu``."""
        return self.nu.value

    def headline(self) -> str:
        """The two distances."""
        return f"gap {number(self.value)}, nu-gap {number(self.nu_gap)}"

    @property
    def value(self) -> float:
        """The gap: the upper end of its bracket."""
        return self.upper

    def facts(self) -> Facts:
        """What a person wants to read, as (label, text)."""
        return [
            ("gap", f"{number(self.lower)} .. {number(self.upper)}"),
            ("directed gaps", listed(map(number, self.directed))),
            ("nu-gap", bracket(self.nu.lower, self.nu.upper, ("attained", "proved"))),
            ("largest at", number(self.nu.frequency, "rad/s")),
            ("reason", self.reason),
        ]

    def to_json(self) -> dict[str, Any]:
        """All attributes."""
        return {"type": "GapMetric", "value": self.value, **vars(self)}


@told_as("nu_gap")
def nu_gap(P1: Any, P2: Any) -> NuGap:
    r"""Nu-gap metric between two models of equal size.

    The largest chordal distance over the axis is an H-infinity norm, by the level-set method; the winding number is
    counted from the poles and zeros of det(G2* G1), not from a curve.

    Parameters
    ----------
    P1, P2
        Models with the same numbers of inputs and outputs, stable or not, with poles on the axis or not; both
        continuous or both discrete with one sample time. Hidden modes must be stable.

    Returns
    -------
    NuGap
        ``value`` is 1 where the winding condition fails: no controller is good for both.

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
    mapped = _mapped(P1, P2, "nu_gap")
    one, two = (coprime_factors(m) for m in mapped.models)
    return _nu_gap(one, two, mapped)


@told_as("gap")
def gap(P1: Any, P2: Any) -> GapMetric:
    r"""Gap metric between two models of equal size.

    With :math:`[G_2^*; \tilde G_2]` unitary the directed gap is a two-block problem,

    .. math:: \vec\delta = \inf_Q \left\| \begin{bmatrix} G_2^* G_1 - Q \\ \tilde G_2 G_1 \end{bmatrix} \right\|_\infty
       \le \gamma \Leftrightarrow \| (G_2^* G_1 \Phi_\gamma^{-1})_{antistable} \|_{Hankel} \le 1, \qquad
       \Phi_\gamma^* \Phi_\gamma = \gamma^2 I - G_1^* \tilde G_2^* \tilde G_2 G_1

    solved by bisection over gamma.

    Parameters
    ----------
    P1, P2
        As for `nu_gap`.

    Returns
    -------
    GapMetric
        The value with its bounds, and the nu-gap, which never exceeds it.

    Raises
    ------
    InputError, NoTrustworthyNumber
        As for `nu_gap`.

    References
    ----------
    Georgiou (1988); Georgiou, Smith, "Optimal robustness in the gap metric", IEEE TAC 35 (1990).

    Examples
    --------
    >>> one = StateSpaceModel([[-1.0]], [[1.0]], [[1.0]], [[0.0]])
    >>> round(gap(one, one).value, 6)
    0.0
    """
    mapped = _mapped(P1, P2, "gap")
    one, two = (coprime_factors(m) for m in mapped.models)
    nu = _nu_gap(one, two, mapped)
    there, back = _directed(one, two), _directed(two, one)
    low, high = max(there[0], back[0], nu.lower), max(there[1], back[1], nu.lower)
    reason = ""
    if high < 1 and abs(there[1] - back[1]) > AGREE:
        reason = f"the directed gaps {there[1]:.9g} and {back[1]:.9g} must be equal below 1"
    elif nu.lower > max(there[1], back[1]) + AGREE:
        reason = f"the nu-gap {nu.lower:.9g} exceeds {max(there[1], back[1]):.9g}: digits were lost"
    elif high - low > AGREE:
        reason = f"rounding leaves {high - low:.1e} between the bounds"
    elif not nu.status.trustworthy:
        reason = nu.reason
    status = Status.INACCURATE if reason else Status.CONVERGED
    return GapMetric(min(low, high), high, (there[1], back[1]), nu, status, reason)


def _mapped(P1: Any, P2: Any, where: str) -> MappedModels:
    m1, m2 = as_model(P1, f"{where}: first model"), as_model(P2, f"{where}: second model")
    if m1.D.shape != m2.D.shape:
        raise InputError(
            where, f"models of {m1.n_outputs} x {m1.n_inputs} and {m2.n_outputs} x {m2.n_inputs}", "equal sizes"
        )
    if not m1.D.size:
        raise InputError(where, f"a model of {m1.n_outputs} x {m1.n_inputs}", "inputs and outputs")
    return continuous_models(m1, m2)


def _distance(one: CoprimeFactors, two: CoprimeFactors) -> StateSpaceModel:
    """``M2~ N1 - N2~ M1``, stable: states of G1, then of G2~. The left factors are ordered [N2~, M2~]."""
    p, m = one.right.n_outputs - one.right.n_inputs, one.right.n_inputs
    swap = np.block([[np.zeros((m, p)), -np.eye(m)], [np.eye(p), np.zeros((p, m))]])
    right = one.right
    return series(
        StateSpaceModel(right.A, right.B, swap @ right.C, swap @ right.D),
        StateSpaceModel(two.left.A, two.left.B, two.left.C, two.left.D),
    )


def _nu_gap(one: CoprimeFactors, two: CoprimeFactors, mapped: MappedModels) -> NuGap:
    norm = hinf_norm(_distance(one, two), rtol=1e-9)
    frequency = mapped.frequency(norm.frequency)
    if norm.lower <= NOTHING:
        return NuGap(0.0, NOTHING, frequency, norm.lower, 0, Status.CERTIFIED)
    chordal = min(norm.lower, 1.0)
    winding, sure = _winding(one, two)
    if winding is None:
        text = "det(G2* G1) vanishes on the stability boundary"
        return NuGap(1.0, 1.0, frequency, chordal, 0, norm.status, text)
    # Where the models are 1 apart at some frequency, the winding number no longer matters.
    if not sure and norm.lower >= 1 - AGREE:
        return NuGap(chordal, 1.0, frequency, chordal, winding, norm.status, norm.reason)
    if winding != 0 and norm.lower < 1:
        status = norm.status if sure else Status.INACCURATE
        text = f"det(G2* G1) winds {winding} times around the origin: no controller is good for both"
        return NuGap(1.0, 1.0, frequency, chordal, winding, status, text if sure else _UNSURE)
    status = norm.status if sure else Status.INACCURATE
    reason = norm.reason if status is norm.status else _UNSURE
    return NuGap(chordal, min(norm.upper, 1.0), frequency, chordal, winding, status, reason)


_UNSURE = "a zero of det(G2* G1) lies too close to the stability boundary to count"


def _winding(one: CoprimeFactors, two: CoprimeFactors) -> tuple[int | None, bool]:
    """Zeros minus poles of det(G2* G1) in the right half plane, and whether every one has a sure side.

    None where it vanishes at infinity. The poles are those of G1 (left) and of G2* (right), by construction.
    """
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


# --- the directed gap ------------------------------------------------------------------------------------------------


def _directed(one: CoprimeFactors, two: CoprimeFactors) -> tuple[float, float]:
    """Bracket of ``inf ||G1 - G2 Q||`` over stable Q."""
    from scipy.optimize import brentq

    distance = _distance(one, two)
    norm: HinfNorm = hinf_norm(distance, rtol=GAP_RTOL)
    low = min(norm.lower, 1.0)
    if low <= NOTHING:
        low = 0.0
    if low <= CLOSE:
        difference = hinf_norm(parallel(one.right, two.right, -1))
        if difference.upper <= CLOSE:
            return low, difference.upper
    first = min(norm.upper * (1 + GAP_RTOL) + ROUNDING, 1.0)
    if first == 1.0 or _hankel(one, two, distance, first) <= 1:
        return low, first

    def excess(gamma: float) -> float:
        # Q = 0 reaches 1, where the spectral factor may not exist.
        return float(np.clip(np.log(_hankel(one, two, distance, gamma)), -1.0, 1.0)) if gamma < 1.0 else -1.0

    root = float(brentq(excess, first, 1.0, xtol=ROUNDING, rtol=GAP_RTOL))  # pyright: ignore[reportArgumentType]
    # Each side of the root is asked by itself; rounding blurs it where the distance itself is next to nothing.
    steps = (2 * GAP_RTOL, 1e-6, 1e-4, 1e-2, 1.0, 10.0, 100.0)
    over = next((root * (1 + step) for step in steps if root * (1 + step) < 1 and excess(root * (1 + step)) <= 0), 1.0)
    under = next((root * (1 - step) for step in steps[:4] if excess(max(root * (1 - step), first)) > 0), low)
    return max(low, under), over


def _hankel(one: CoprimeFactors, two: CoprimeFactors, distance: StateSpaceModel, gamma: float) -> float:
    """Hankel norm of what Q cannot remove: some stable Q gives ``||G1 - G2 Q|| <= gamma`` iff it is at most 1.

    Infinite where gamma is below the norm of the part that Q does not touch at all.
    """
    s, g1, g2 = distance, one.right, two.right
    weight = gamma**2 * np.eye(s.n_inputs) - s.D.T @ s.D
    if np.linalg.eigvalsh(weight)[0] <= 0:
        return np.inf
    try:
        gain = care(s.A, s.B, s.C.T @ s.C, -weight, s.C.T @ s.D).gain
    except NoTrustworthyNumber:
        return np.inf
    # Phi^-1 = (A + B K, B W^-1, K, W^-1) for W^2 = weight, and G1 Phi^-1 shares its states.
    root = inverse_root(weight)
    A, B = s.A + s.B @ gain, s.B @ root
    C = np.hstack([g1.C, np.zeros((g1.n_outputs, two.left.n_states))]) + g1.D @ gain
    D = g1.D @ root
    if not g2.n_states:
        return np.finfo(float).tiny
    from scipy.linalg import solve_sylvester

    # The antistable part of G2* (C (s - A)^-1 B + D), in the states of G2*.
    across = solve_sylvester(g2.A.T, A, g2.C.T @ C) if len(A) else np.zeros((g2.n_states, 0))
    into = g2.C.T @ D - across @ B
    try:
        reach = lyapunov(g2.A.T, into @ into.T)
        see = lyapunov(g2.A, g2.B @ g2.B.T)
    except NoTrustworthyNumber:
        return np.inf
    square = float(np.linalg.eigvals(reach @ see).real.max())
    return float(np.sqrt(max(square, np.finfo(float).tiny)))
