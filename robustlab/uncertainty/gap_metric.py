"""Distances between models for feedback: normalised coprime factors, the stability margin of a loop, the nu-gap.

Zhou, Doyle, Glover (1996), theorem 13.37 and section 16.1; Vinnicombe, *Uncertainty and Feedback* (2001); Vinnicombe,
IEEE TAC 38 (1993).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, ClassVar, Literal

import numpy as np

from robustlab.arrays import Array
from robustlab.display import Facts, bracket, number
from robustlab.errors import InputError, NoTrustworthyNumber, error_context
from robustlab.feedback import closing
from robustlab.linear_analysis.frequency import frequency_response
from robustlab.linear_analysis.matrices import RiccatiSolution, care, refuse_extremes, refuse_overflow
from robustlab.linear_analysis.structural import hidden_unstable, with_hidden
from robustlab.norms import bilinear_to_continuous, hinf_norm, well_scaled
from robustlab.result import Bracket, Status
from robustlab.statespace import StateSpaceModel, as_model, lower_lft, series

INNER = 1e-7  # allowed deviation of the factors from inner, at frequencies around the model's poles


@dataclass(frozen=True, eq=False)
class CoprimeRiccati:
    """The two Riccati equations of normalised coprime factors, in balanced states and the time unit ``1/rate``."""

    model: StateSpaceModel  # the model's transfer function of `s / rate`, in balanced states
    rate: float  # in rad/s
    # control, filtering: X with its gain `F = -R^-1 (B^T X + D^T C)`, and Z with `H^T`
    control: RiccatiSolution
    filtering: RiccatiSolution

    @property
    def best_margin(self) -> float:
        """Return the largest `coprime_margin` of any controller, ``(1 + rho(X Z))^(-1/2)``."""
        with np.errstate(over="ignore", invalid="ignore"):
            product = self.control.X @ self.filtering.X
        refuse_overflow("coprime factors", product)
        return float(1 / np.sqrt(1 + max(np.linalg.eigvals(product).real.max(initial=0.0), 0.0)))


def coprime_riccati(model: StateSpaceModel) -> CoprimeRiccati:
    """Solve both Riccati equations of a continuous, stabilisable and detectable model."""
    refuse_extremes(model, "coprime factors")
    m, rate = well_scaled(model) if model.n_states else (model, 1.0)
    p, q = m.D.shape
    r, s = np.eye(q) + m.D.T @ m.D, np.eye(p) + m.D @ m.D.T
    try:
        control = care(m.A, m.B, m.C.T @ m.C, r, m.C.T @ m.D)
        filtering = care(m.A.T, m.C.T, m.B @ m.B.T, s, m.B @ m.D.T)
    except NoTrustworthyNumber as error:
        hidden = hidden_unstable(model)
        found = hidden[0].meaning if hidden else error.found
        raise NoTrustworthyNumber("coprime factors", found, "a stabilisable and detectable model") from None
    return CoprimeRiccati(m, rate, control, filtering)


@dataclass(frozen=True, eq=False)
class CoprimeFactors:
    """Normalised coprime factors of a continuous model with p outputs and m inputs."""

    right: StateSpaceModel  # `[N; M]` (p + m outputs, m inputs), stable and inner
    left: StateSpaceModel  # `[N~, M~]` (p outputs, m + p inputs), stable and co-inner


def coprime_factors(model: StateSpaceModel) -> CoprimeFactors:
    """Return the normalised coprime factors of a continuous model, from two Riccati equations."""
    found = coprime_riccati(model)
    m = found.model
    r, s = np.eye(m.n_inputs) + m.D.T @ m.D, np.eye(m.n_outputs) + m.D @ m.D.T
    f, h = found.control.gain, found.filtering.gain.T
    root_r, root_s = _inverse_root(r), _inverse_root(s)
    C, D = np.vstack([m.C + m.D @ f, f]), np.vstack([m.D @ root_r, root_r])
    right = StateSpaceModel(m.A + m.B @ f, m.B @ root_r, C, D)
    B, D = np.hstack([m.B + h @ m.D, h]), np.hstack([root_s @ m.D, root_s])
    left = StateSpaceModel(m.A + h @ m.C, B, root_s @ m.C, D)
    _check_inner(m, right, left)
    root = np.sqrt(found.rate)
    return CoprimeFactors(*(StateSpaceModel(x.A * found.rate, x.B * root, x.C * root, x.D) for x in (right, left)))


@dataclass(frozen=True)
class CoprimeMargin(Bracket):
    """Stability margin b(P, C) of a loop, attained at ``frequency``; 0 where C does not stabilise P.

    ``status`` is that of the H-infinity norm of the computation.
    """

    best: float  #: The largest margin of any controller for this plant
    reason: str = ""  #: Why the margin is 0 or inaccurate; else empty
    loop: str = ""  #: The feedback law and its source
    #: The loop u = K y, for `robustlab.verify`
    plant: StateSpaceModel | None = field(default=None, compare=False, repr=False)
    K: StateSpaceModel | None = field(default=None, compare=False, repr=False)

    unsaved: ClassVar[tuple[str, ...]] = ("plant", "K")
    derived: ClassVar[tuple[str, ...]] = ("value",)

    @property
    def value(self) -> float:
        """Return the proved margin, ``lower``."""
        return self.lower

    def facts(self) -> Facts:
        return [
            ("loop", self.loop),
            ("coprime margin", bracket(self.lower, self.upper, ("proved", "attained"))),
            ("smallest at", number(self.frequency, "rad/s")),
            ("best of any controller", number(self.best)),
            ("reason", self.reason),
        ]


@error_context("coprime_margin")
def coprime_margin(P: Any, C: Any, *, sign: Literal[-1, 1] | None = None) -> CoprimeMargin:
    r"""Return the stability margin of the loop of P and C, a distance in the gap and nu-gap metric.

    .. math:: b(P, C) = \left\| \begin{bmatrix} P \\ I \end{bmatrix} (I - s C P)^{-1}
       \begin{bmatrix} -C & I \end{bmatrix} \right\|_\infty^{-1}

    with s = ``sign``. C stabilises every plant whose nu-gap to P is less than b(P, C). Glover, McFarlane (1989);
    Vinnicombe, *Uncertainty and Feedback* (2001), section 1.2.

    Parameters
    ----------
    P, C
        Plant (p outputs, m inputs) and controller (m outputs, p inputs), ``u = sign C y``.
    sign
        -1 for negative feedback, 1 for positive feedback; by default that of C, or negative.

    Returns
    -------
    CoprimeMargin
        The margin, 0 .. 1; 0 where C does not stabilise P.

    Raises
    ------
    InputError
        Sizes or sample times that do not fit, or an algebraic loop.

    Examples
    --------
    >>> lag = StateSpaceModel([[0.0]], [[1.0]], [[1.0]], [[0.0]])
    >>> round(coprime_margin(lag, StateSpaceModel([], [], [], [[1.0]])).value, 5)
    0.70711
    """
    found = closing(as_model(P, "coprime_margin: P"), as_model(C, "coprime_margin: C"), sign, "coprime_margin")
    plant, k, sign = found.plant, found.K, found.sign
    law = StateSpaceModel(k.A, k.B, sign * k.C, sign * k.D, k.dt)
    loop = lower_lft(four_block(plant), law)
    norm = hinf_norm(loop, rtol=1e-9)
    best = coprime_riccati(*continuous_models(plant)).best_margin
    if not np.isfinite(norm.upper):
        return CoprimeMargin(0.0, 0.0, None, norm.status, best, with_hidden(norm.reason, plant, k), found.said)
    bounds = 1 / norm.upper, 1 / norm.lower
    return CoprimeMargin(*bounds, norm.frequency, norm.status, best, norm.reason, found.said, plant, law)


def four_block(plant: StateSpaceModel) -> StateSpaceModel:
    """Return (w1, w2, u) -> (y, v, y + w1), ``v = u + w2``, ``y = P v``; the margin is 1/norm at ``u = C (y + w1)``."""
    p, m = plant.D.shape
    n = plant.n_states
    v = np.hstack([np.zeros((m, p)), np.eye(m), np.eye(m)])
    y = plant.D @ v
    measured = y + np.hstack([np.eye(p), np.zeros((p, 2 * m))])
    C = np.vstack([plant.C, np.zeros((m, n)), plant.C])
    return StateSpaceModel(plant.A, plant.B @ v, C, np.vstack([y, v, measured]), plant.dt)


def continuous_models(*models: StateSpaceModel) -> tuple[StateSpaceModel, ...]:
    """Return continuous models as they are, discrete ones mapped by ``s = (2/dt) (z - 1)/(z + 1)``."""
    times = {m.dt for m in models if m.n_states or m.dt}
    if len(times) > 1:
        raise InputError("gap", f"sample times {sorted(times)} s (0: continuous)", "one common sample time")
    if not (dt := times.pop() if times else 0.0):
        return models
    return tuple(bilinear_to_continuous(StateSpaceModel(m.A, m.B, m.C, m.D, dt)) for m in models)


def _inverse_root(matrix: Array) -> Array:
    """Return ``matrix^(-1/2)`` of a symmetric positive definite matrix."""
    values, vectors = np.linalg.eigh(matrix)
    return vectors / np.sqrt(values) @ vectors.T


def _check_inner(m: StateSpaceModel, right: StateSpaceModel, left: StateSpaceModel) -> None:
    omega = np.unique(np.concatenate([[0.0], *(np.abs(x.poles()) for x in (m, right, left))]))
    g, h = frequency_response(right, omega), np.swapaxes(frequency_response(left, omega), 1, 2)
    with np.errstate(over="ignore", invalid="ignore"):  # overflow and NaN fail the test
        off = max(np.abs(np.swapaxes(x.conj(), 1, 2) @ x - np.eye(x.shape[2])).max(initial=0.0) for x in (g, h))
    if not off <= INNER:
        raise NoTrustworthyNumber("coprime factors", f"they miss being normalised by {off:.1e}", f"at most {INNER:.0e}")


# nu-gap: with G = [N; M], G~ = [M~, -N~] it is |G~2 G1|_inf where det(G2* G1) is not 0 on the axis and winds zero times
# around the origin, else 1.
NOTHING, AGREE = 1e-12, 1e-6  # a distance indistinguishable from 0, and a difference to 1
SIDE = 1e-11  # relative real part below which the sign of an eigenvalue is uncertain


@dataclass(frozen=True)
class NuGap(Bracket):
    """The nu-gap between two models; INACCURATE where a norm or the sign of a zero is uncertain, else CERTIFIED."""

    frequency: float  #: Frequency of the largest pointwise (chordal) distance, in rad/s; ``inf`` for the direct terms
    chordal: float  #: That distance; the nu-gap where ``winding`` is 0
    #: Winding number of det(G2* G1) around the origin: its zeros minus its poles in the right half plane
    winding: int
    reason: str = ""  #: Why the value is 1 or inaccurate; else empty

    derived: ClassVar[tuple[str, ...]] = ("value",)

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


@error_context("nu_gap")
def nu_gap(P1: Any, P2: Any) -> NuGap:
    r"""Return the nu-gap metric between two models of equal size.

    The largest chordal distance over the axis is an H-infinity norm, by the level-set method; the winding number
    follows from the poles and zeros of det(G2* G1). Vinnicombe, *Uncertainty and Feedback* (2001), chapter 3.

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
    one, two = (coprime_factors(m) for m in continuous_models(m1, m2))
    # G2~ G1 = M2~ N1 - N2~ M1, stable; the left factors are ordered [N2~, M2~].
    (p, m), right = m1.D.shape, one.right
    swap = np.block([[np.zeros((m, p)), -np.eye(m)], [np.eye(p), np.zeros((p, m))]])
    norm = hinf_norm(series(StateSpaceModel(right.A, right.B, swap @ right.C, swap @ right.D), two.left), rtol=1e-9)
    frequency, dt = norm.frequency, m1.dt or m2.dt
    if dt:
        frequency = 2 / dt * float(np.arctan(frequency * dt / 2))
    if norm.lower <= NOTHING:
        return NuGap(0.0, NOTHING, frequency, Status.CERTIFIED, norm.lower, 0)
    chordal = min(norm.lower, 1.0)
    winding, sure = _winding(one, two)
    if winding is None:
        text = "det(G2* G1) vanishes on the stability boundary"
        return NuGap(1.0, 1.0, frequency, norm.status, chordal, 0, text)
    status, reason = norm.status, norm.reason
    # Where the models are 1 apart at some frequency, the winding number no longer matters.
    counted = sure or norm.lower < 1 - AGREE
    if counted and not sure:
        status, reason = Status.INACCURATE, "a zero of det(G2* G1) is too close to the stability boundary to count"
    if counted and winding != 0 and norm.lower < 1:
        text = f"det(G2* G1) winds {winding} times around the origin: no controller is good for both"
        return NuGap(1.0, 1.0, frequency, status, chordal, winding, text if sure else reason)
    upper = min(norm.upper, 1.0) if counted else 1.0
    return NuGap(chordal, upper, frequency, status, chordal, winding, reason)


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
