"""Passivity: the relative index as an H-infinity norm, input and output index as proved brackets over the axis."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np

from robustlab.arrays import AnyArray
from robustlab.errors import InputError, NoTrustworthyNumber, told_as
from robustlab.linear_analysis.frequency import frequency_response
from robustlab.linear_analysis.magnitude import Moderated, moderated, refuse_overflow, scaled_down
from robustlab.norms.bilinear_map import bilinear_to_continuous
from robustlab.norms.hinfinity import (
    QUIET,
    HinfNorm,
    axis_point,
    balanced,
    gain_rounding,
    hinf_norm,
    unstable_norm,
)
from robustlab.norms.level_set import search_grid, well_scaled
from robustlab.result import Status
from robustlab.shown import Facts, Shown, bracket, number
from robustlab.statespace import StateSpaceModel, as_model, is_rank_deficient

__all__ = ["PassivityIndex", "Passivity", "passivity"]

EPS = float(np.finfo(float).eps)
LEVELS, GRID = 60, 400
# A matrix is symmetric, and null spaces are one, to this share: beyond it no feedback makes a model passive.
SYMMETRIC = 1e-10


@dataclass(frozen=True)
class PassivityIndex(Shown):
    r"""Input passivity index ``nu`` of G, the smallest eigenvalue of ``(G + G^*) / 2`` over the axis.

    The output index ``rho`` is that of the inverse of G.

    Attributes
    ----------
    lower
        Level below which no eigenvalue lies, by a Hamiltonian test: proved.
    upper
        The smallest eigenvalue at ``frequency``, evaluated: attained.
    frequency
        In rad/s; may be infinite.
    status
        CERTIFIED, or INACCURATE where the test did not settle.
    """

    lower: float
    upper: float
    frequency: float
    status: Status

    def facts(self) -> Facts:
        """What a person wants to read, as (label, text)."""
        return [
            ("index", bracket(self.lower, self.upper, ("proved", "attained"))),
            ("at", number(self.frequency, "rad/s")),
        ]

    def to_json(self) -> dict[str, object]:
        """All fields."""
        return vars(self).copy()


@dataclass(frozen=True)
class Passivity(Shown):
    r"""Whether a model is passive, and by how much.

    Attributes
    ----------
    passive
        True where ``R <= 1`` is proved, False where ``R > 1`` is attained, None where the bracket holds 1: lossless and
        strictly proper models have R = 1 exactly or reach it at infinity, and are passive to within the bracket's
        width at best.
    lower, upper
        Bracket of the relative index R.
    frequency
        Frequency in rad/s at which ``lower`` is attained.
    input_index
        Input passivity index; None for a model that is not stable, which has none.
    output_index
        Output passivity index; None where the inverse does not exist or is not stable.
    status
        That of the bracket of R; of both indices too where there are any.
    reason
        Why R is infinite or inaccurate; else empty.
    system
        The model, for `robustlab.verify`.
    """

    passive: bool | None
    lower: float
    upper: float
    frequency: float
    input_index: PassivityIndex | None
    status: Status
    reason: str = ""
    output_index: PassivityIndex | None = None
    system: StateSpaceModel | None = field(default=None, compare=False, repr=False)

    quantities: ClassVar[Mapping[str, Any]] = {
        "lower": "1", "upper": "1", "frequency": "rad/s", "passive": bool, "input_index": float, "output_index": float,
    }  # fmt: skip

    def numbers(self) -> dict[str, Any]:
        """The indices by what is proved of them."""
        both = {"input_index": self.input_index, "output_index": self.output_index}
        return {**super().numbers(), **{name: None if index is None else index.lower for name, index in both.items()}}

    def headline(self) -> str:
        """Whether it is passive."""
        words = {True: "passive", False: "not passive", None: "on the boundary of passivity, or not decided"}
        return words[self.passive]

    def facts(self) -> Facts:
        """What a person wants to read, as (label, text)."""
        words = {True: "yes", False: "no", None: f"to within {number(self.upper - 1)} of the relative index"}
        sides = (("input", self.input_index), ("output", self.output_index))
        told = [(side, *fact) for side, index in sides if index is not None for fact in index.facts()]
        return [
            ("passive", words[self.passive]),
            ("relative index", bracket(self.lower, self.upper, ("attained", "proved"))),
            ("at", number(self.frequency, "rad/s")),
            *((f"{side} {label}" if label == "index" else f"its {side}", text) for side, label, text in told),
            ("reason", self.reason),
        ]

    def to_json(self) -> dict[str, object]:
        """All fields but ``system``."""
        return {name: value for name, value in vars(self).items() if name != "system"}


@told_as("passivity")
def passivity(model: Any, rtol: float = 1e-6) -> Passivity:
    r"""Relative passivity index R, input passivity index nu and output passivity index rho, as proved brackets.

    .. math:: R = \|(I - G)(I + G)^{-1}\|_\infty, \qquad G \text{ passive} \Leftrightarrow R \le 1

    .. math:: \nu = \inf_\omega \tfrac{1}{2} \lambda_{min}(G + G^*), \qquad
        \rho = \inf_\omega \tfrac{1}{2} \lambda_{min}(G^{-1} + G^{-*}): \quad G + G^* \succeq 2 \rho \, G^* G

    R < 1: the model stays passive in spite of a shortage elsewhere; R > 1: it lacks passivity by that factor. Poles on
    the imaginary axis are allowed, as of integrators. A stable model with nu > 0 is input strictly passive, with
    nu < 0 a feedthrough of -nu would make it passive. A model with a stable inverse is output strictly passive with
    rho > 0, with rho < 0 a feedback of -rho around it would make it passive; it need not be stable itself.

    Parameters
    ----------
    model
        Square model, input k belonging to output k (force and speed, for example); continuous or discrete.
    rtol
        Relative width of the bracket of R; that of nu is this share of the largest ``|G + G^*| / 2`` on a grid, and
        that of rho likewise for what the inverse is without its pole at infinity.

    Returns
    -------
    Passivity
        R is infinite where ``(I + G)^-1`` is unstable or not proper, and where G has hidden modes that are not stable;
        rho is -inf where no feedback makes G passive: the gain falls too fast, or with the wrong sign or symmetry.

    Raises
    ------
    InputError
        A model that is not square or has no inputs, or an ``rtol`` that is not between 1e-12 and 1.
    NoTrustworthyNumber
        Products of the model's entries overflow.

    References
    ----------
    Desoer, Vidyasagar, *Feedback Systems: Input-Output Properties* (1975), chapter VI; Boyd, Balakrishnan 1990 for the
    level test; Bao, Lee, *Process Control: The Passive Systems Approach* (2007), chapter 2.

    Examples
    --------
    >>> damper = StateSpaceModel([[-1.0]], [[1.0]], [[1.0]], [[1.0]])  # 1 + 1 / (s + 1)
    >>> found = passivity(damper)
    >>> found.passive, round(found.lower, 6), round(found.input_index.lower, 4)
    (True, 0.333333, 1.0)
    >>> round(found.output_index.lower, 4)  # (s + 1) / (s + 2) is 1/2 at 0
    0.5
    """
    g = as_model(model, "passivity")
    if g.n_inputs != g.n_outputs or not g.n_inputs:
        raise InputError("passivity", f"{g.n_outputs} outputs, {g.n_inputs} inputs", "a square model")
    if not 1e-12 <= rtol < 1:
        raise InputError("passivity", f"rtol is {rtol}", "between 1e-12 and 1")
    one = np.eye(g.n_inputs)
    if is_rank_deficient(one + g.D):
        text = "I + D is singular: some v has v^T (D + D^T) v < 0"
        relative = HinfNorm(np.inf, np.inf, np.inf, Status.CERTIFIED, text)
    else:
        relative = hinf_norm(_reflection(g, one), rtol)
    nu, rho = _input_index(g, rtol), _output_index(g, rtol)
    statuses = {part.status for part in (relative, nu, rho) if part is not None}
    status = Status.CERTIFIED if statuses == {Status.CERTIFIED} else Status.INACCURATE
    return Passivity(
        _verdict(relative), relative.lower, relative.upper, relative.frequency, nu, status, relative.reason, rho, g
    )


def _verdict(relative: HinfNorm) -> bool | None:
    """What the bracket of R says; a lower end is known to the rounding that a norm does not tell."""
    if relative.status is not Status.CERTIFIED:
        return None
    if relative.upper <= 1:
        return True
    return False if relative.lower > 1 + QUIET else None


def _reflection(g: StateSpaceModel, one: AnyArray) -> StateSpaceModel:
    """``(I - G)(I + G)^-1 = 2 (I + G)^-1 - I``, with the states of G."""
    e = np.linalg.inv(one + g.D)
    with np.errstate(over="ignore", invalid="ignore"):
        A, B, C, D = g.A - g.B @ e @ g.C, g.B @ e, -2 * e @ g.C, 2 * e - one
    refuse_overflow("passivity", A, B, C, D)
    return StateSpaceModel(A, B, C, D, g.dt, where="passivity")


def _input_index(g: StateSpaceModel, rtol: float) -> PassivityIndex | None:
    """The bracket of nu; None for a model that is not stable."""
    ordinary = moderated(g, "passivity")
    m = ordinary.model
    if m.n_states and unstable_norm(m) is not None:
        return None
    if not m.n_states:
        value = ordinary.value(float(_lowest(m, np.zeros(1))[0]), "passivity")
        return PassivityIndex(value, value, 0.0, Status.CERTIFIED)
    scaled, rate = well_scaled(bilinear_to_continuous(m) if m.is_discrete else m)
    omega = search_grid(scaled, GRID)
    part = np.linalg.eigvalsh(_symmetric(scaled, omega))
    size, smallest = float(np.abs(part).max()), part[:, 0]
    at, upper = float(omega[smallest.argmin()]), float(smallest.min())
    trusted, level = size == 0, upper
    for _ in range(LEVELS if size else 0):
        level = upper - rtol * size
        tried = _crossings(scaled, level)
        values = _lowest(scaled, tried)
        if values.min() < upper:
            at, upper = float(tried[values.argmin()]), float(values.min())
        if upper >= level:
            trusted = True
            break
    omega_at = at * rate
    if m.is_discrete:  # the bilinear map bends the frequency axis
        omega_at = 2 / m.dt * float(np.arctan(omega_at * m.dt / 2)) if np.isfinite(omega_at) else np.pi / m.dt
    attained = float(_lowest(m, np.array([omega_at]))[0])
    error = gain_rounding(m.A, m.B, m.C, m.D, axis_point(m, omega_at))
    if abs(attained - upper) > 10 * rtol * size + error:
        trusted = False
    slack = error if error > QUIET * size else 0.0
    lower, upper = (ordinary.value(x, "passivity") for x in (min(level, attained) - slack, attained + slack))
    status = Status.CERTIFIED if trusted else Status.INACCURATE
    return PassivityIndex(lower, upper, ordinary.frequency(omega_at), status)


def _output_index(g: StateSpaceModel, rtol: float) -> PassivityIndex | None:
    """The bracket of rho: the input index of the inverse. None where there is no inverse, or none that is stable."""
    ordinary = moderated(g, "passivity")
    dt = ordinary.model.dt
    try:
        m = bilinear_to_continuous(ordinary.model) if dt else ordinary.model
    except NoTrustworthyNumber:  # a pole at z = -1 is a zero of the inverse there
        return None
    if _is_singular_everywhere(m):
        return None
    inverse = _inverse_without_derivative(m)
    if inverse is None:
        return PassivityIndex(-np.inf, -np.inf, np.inf, Status.CERTIFIED)
    found = _input_index(inverse, rtol)
    if found is None:
        return None
    at = 2 / dt * float(np.arctan(found.frequency * dt / 2)) if dt else found.frequency
    # A second voice, without any inverse: G + G* - 2 rho G* G has no negative eigenvalue on a grid away from poles.
    grid = search_grid(m, GRID) * 1.0123 if m.n_states else np.ones(1)
    response = frequency_response(m, grid[(grid > 0) & np.isfinite(grid)])
    square = response.conj().transpose(0, 2, 1) @ response
    size = np.linalg.norm(response, 2, axis=(1, 2)) + abs(found.lower) * np.linalg.norm(square, 2, axis=(1, 2))
    left = np.linalg.eigvalsh(0.5 * (response + response.conj().transpose(0, 2, 1)) - found.lower * square)[:, 0]
    agreed = bool((left >= -rtol * size).all())
    lower, upper = (_times_gain(x, ordinary) for x in (found.lower, found.upper))
    return PassivityIndex(lower, upper, ordinary.frequency(at), found.status if agreed else Status.INACCURATE)


def _is_singular_everywhere(m: StateSpaceModel) -> bool:
    """Whether G(s) has no inverse at any s: looked at on points that no model knows of."""
    size = float(np.abs(m.A).max(initial=0.0)) or 1.0
    points = size * np.array([1.2347 + 0.3719j, 0.4711 + 1.9173j])
    one = np.eye(m.n_states)
    return all(is_rank_deficient(m.C @ np.linalg.solve(s * one - m.A, m.B) + m.D) for s in points)


def _times_gain(value: float, ordinary: Moderated) -> float:
    """An inverse gain of the model as given."""
    return scaled_down(value, -ordinary.gain, "passivity")


def _inverse_without_derivative(m: StateSpaceModel) -> StateSpaceModel | None:
    r"""``G^{-1} - s L``, proper, of a continuous model; None where that is not so with a symmetric ``L >= 0``.

    What D does not pass (its null space, which must be that of D^T) is seen in the derivatives of those outputs:
    ``y_2' = C_2 A x + C_2 B u``. States of the inverse lie where C_2 x follows from y_2.
    """
    _, size, vt = np.linalg.svd(m.D)
    rank = int((size > len(size) * EPS * size.max(initial=0.0)).sum())
    one, two = vt[:rank].T, vt[rank:].T
    if np.abs(two.T @ m.D).max(initial=0.0) > SYMMETRIC * size.max(initial=0.0):
        return None
    b1, b2, c1, c2 = m.B @ one, m.B @ two, one.T @ m.C, two.T @ m.C
    if len(c2) and is_rank_deficient(c2 @ b2):
        return None
    E, back = np.linalg.inv(c2 @ b2), np.linalg.inv(one.T @ m.D @ one)
    if np.abs(E - E.T).max(initial=0.0) > SYMMETRIC * np.abs(E).max(initial=0.0):
        return None
    if len(E) and np.linalg.eigvalsh(E + E.T)[0] <= 0:
        return None
    kernel = np.linalg.svd(c2)[2][len(c2) :].T if len(c2) else np.eye(m.n_states)
    # u_1 = f x + back y_1 and u_2 = h x + k y_1, but for E times the derivative of y_2; x = kernel w + B_2 E y_2.
    f, across = -back @ c1, E @ c2 @ b1
    h, k = -E @ c2 @ m.A - across @ f, -across @ back
    a = m.A + b1 @ f + b2 @ h
    seen = b2 @ E @ two.T
    out, direct = one @ f + two @ h, one @ back @ one.T + two @ k @ one.T
    return StateSpaceModel(
        kernel.T @ a @ kernel,
        kernel.T @ (a @ seen + (b1 @ back + b2 @ k) @ one.T),
        out @ kernel,
        direct + out @ seen,
        where="passivity",
    )


def _symmetric(m: StateSpaceModel, omega: AnyArray) -> AnyArray:
    response = frequency_response(m, omega)
    return 0.5 * (response + response.conj().transpose(0, 2, 1))


def _lowest(m: StateSpaceModel, omega: AnyArray) -> AnyArray:
    """Smallest eigenvalue of ``(G + G^*) / 2`` at each frequency, shape (n_omega,)."""
    return np.linalg.eigvalsh(_symmetric(m, omega))[:, 0]


def _crossings(m: StateSpaceModel, level: float) -> AnyArray:
    """Imaginary parts of all zeros of ``G + G~ - 2 level I``, and points between and beyond them, and infinity."""
    weight = m.D + m.D.T - 2 * level * np.eye(m.n_inputs)
    into, out = np.vstack([m.B, -m.C.T]), np.hstack([m.C, m.B.T])
    nothing = np.zeros_like(m.A)
    hamiltonian = np.block([[m.A, nothing], [nothing, -m.A.T]]) - into @ np.linalg.solve(weight, out)
    if not np.isfinite(hamiltonian).all():
        raise NoTrustworthyNumber("passivity", "the Hamiltonian overflows")
    crossing = np.unique(np.append(0.0, np.abs(np.linalg.eigvals(balanced(hamiltonian)).imag)))
    between = 0.5 * (crossing[:-1] + crossing[1:])
    return np.concatenate([crossing, between, [2 * crossing[-1], 10 * crossing[-1], np.inf]])
