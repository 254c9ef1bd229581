"""What no controller can do better for a given plant: limits from right-half-plane zeros and poles, and from delay.

The same in words for a finished design, whose plant is what leads from its controls to its measurements.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from robustlab.arrays import AnyArray, Mask
from robustlab.errors import InputError, NoTrustworthyNumber, RobustlabError, told_as
from robustlab.linear_analysis.invariant_zeros import ROUNDING, zeros
from robustlab.linear_analysis.matrix_equations import lyapunov
from robustlab.linear_analysis.structural import drop_unconnected
from robustlab.norms import bilinear_to_continuous
from robustlab.result import Status
from robustlab.shown import Facts, Shown, listed, number
from robustlab.statespace import StateSpaceModel, as_model
from robustlab.synthesis.problem.partition import GeneralizedPlant

# Zeros this close to the boundary, relative to themselves, and poles, relative to the largest, bind nothing; nor do
# zeros that small beside the fastest pole which rounding moves by their own size.
BOUNDARY = 1e-9
# Zeros further apart than this share of themselves are taken one by one, others by their invariant subspace.
SEPARATE = 1e-3
# The factor by which |S| may exceed one in the rules of thumb for bandwidth.
PEAK = 2.0


@dataclass(frozen=True, eq=False)
class Mode:
    """A zero or pole in the right half plane (outside the unit circle) with its directions at the plant."""

    value: complex  # in rad/s, or in the z plane
    # output, input: unit vectors, shapes (n_y,), (n_u,): a zero blocks `output^H G(z) = 0`; a pole is seen in
    # `output` and driven through `input`
    output: AnyArray
    input: AnyArray

    def to_json(self) -> dict[str, Any]:
        """All attributes."""
        return vars(self).copy()


@dataclass(frozen=True)
class WeightedBound:
    """A lower bound of gamma, the zero or pole that makes it, the weight, and the same in words."""

    gamma: float
    at: complex
    weight: str
    text: str


@dataclass(frozen=True, eq=False)
class PerformanceLimits(Shown):
    r"""Limits of every stabilising controller of one plant.

    Attributes
    ----------
    zeros, poles
        Right-half-plane transmission zeros and poles with directions.
    sensitivity_peak, complementary_peak
        Smallest possible peaks of S and of T at the plant's output; 1 where nothing forces more. Exact for distinct
        zeros and poles of a square or wide plant without delay; with delay a lower bound.
    control_peak
        Smallest possible peak of ``K S``: the inverse of the smallest Hankel singular value of the plant's unstable
        part; 0 for a stable plant.
    sensitivity_integral
        :math:`\int_0^\infty \ln|\det S(j\omega)|\,d\omega` of every loop whose gain falls by two orders at least
        (discrete: :math:`\int_0^{\pi/dt}` for a strictly proper loop), in rad/s, for a stable controller; an unstable
        one adds its own poles.
    bandwidth_above, bandwidth_below
        Rules of thumb for a peak of 2, in rad/s: poles ask for a bandwidth above the first (0 where none do), zeros and
        delay for one below the second (inf where none do).
    delay
        What was given, in s.
    dt
        Sample time of the plant.
    status
        CONVERGED; INACCURATE where the zeros are, or where those close together were not found in the peaks' formula
        again.
    reason
        Why it is inaccurate; else empty.
    """

    zeros: tuple[Mode, ...]
    poles: tuple[Mode, ...]
    sensitivity_peak: float
    complementary_peak: float
    control_peak: float
    sensitivity_integral: float
    bandwidth_above: float
    bandwidth_below: float
    delay: float
    dt: float
    status: Status
    reason: str = ""

    def poisson_weight(self, zero: complex, omega: Any) -> AnyArray:
        r"""The weight with which a zero x + jy sees the frequencies, shape of ``omega`` (continuous time).

        .. math:: W(z, \omega) = \frac{x}{x^2 + (y - \omega)^2} + \frac{x}{x^2 + (y + \omega)^2}
        """
        w, x, y = np.asarray(omega, dtype=float), zero.real, zero.imag
        return x / (x**2 + (y - w) ** 2) + x / (x**2 + (y + w) ** 2)

    def poisson_integral(self, zero: complex) -> float:
        r"""Value of :math:`\int_0^\infty \ln|S(j\omega)|\, W(z, \omega)\, d\omega` for one input and output.

        .. math:: \pi \ln \prod_i \left| \frac{p_i + z}{\bar p_i - z} \right|

        It binds every loop, whatever its controller (one without right-half-plane poles of its own).

        References
        ----------
        Skogestad, Postlethwaite 2005, eq. 5.8; Freudenberg, Looze 1985.
        """
        if self.dt:
            raise InputError("poisson_integral", f"a discrete plant (dt = {self.dt:g} s)", "a continuous one")
        ratios = [abs((pole.value + zero) / (np.conj(pole.value) - zero)) for pole in self.poles]
        return float(np.pi * np.sum(np.log(ratios)))

    def gamma_bounds(self, W1: StateSpaceModel | None = None, W3: StateSpaceModel | None = None) -> list[WeightedBound]:
        r"""What zeros and poles say about gamma of `robustlab.mixsyn` with these weights, whatever the controller.

        .. math:: \gamma \ge \frac{1}{\|y_z^H W_1(z)^{-1}\|}, \qquad \gamma \ge \|W_3(p)\, y_p\|

        because ``y_z^H S(z) = y_z^H`` and ``T(p) y_p = y_p``. With one output each is multiplied by the other modes'
        ``|(z + p) / (z - p)|`` (continuous time).

        Parameters
        ----------
        W1, W3
            Weights on the plant's outputs; stable, n_y inputs, W1 square.

        References
        ----------
        Skogestad, Postlethwaite 2005, eqs 5.28, 5.31, 6.14.
        """
        found: list[WeightedBound] = []
        for mode, others, W, what in (
            *((z, self.poles, W1, "zero") for z in self.zeros),
            *((p, self.zeros, W3, "pole") for p in self.poles),
        ):
            if W is None:
                continue
            value = W.C @ np.linalg.solve(mode.value * np.eye(W.n_states) - W.A, W.B) + W.D
            if what == "zero":
                size = 1 / max(float(np.linalg.norm(np.linalg.solve(value.T, mode.output.conj()))), 1e-300)
            else:
                size = float(np.linalg.norm(value @ mode.output))
            if len(mode.output) == 1 and not self.dt:
                size *= float(np.prod([abs((mode.value + o.value) / (mode.value - o.value)) for o in others]))
            name, function = ("W1", "S") if what == "zero" else ("W3", "T")
            text = f"gamma >= {size:.4g}: {name} against the {what} at {mode.value:.4g}, where {function} is fixed"
            found.append(WeightedBound(size, mode.value, name, text))
        return sorted(found, key=lambda b: -b.gamma)

    def sentences(self) -> list[str]:
        """The limits in sentences."""
        place = "outside the unit circle" if self.dt else "in the right half plane"
        if not self.zeros and not self.poles and not self.delay:
            lines = [f"No zero and no pole {place}: only control effort, noise and uncertainty limit what can be done."]
        else:
            lines = [_listed("zero", self.zeros, place), _listed("pole", self.poles, place)]
        if self.delay:
            lines.append(f"Delay of {self.delay:g} s: whatever happens cannot be answered before.")
        word = "at least" if self.delay else "no less than"
        lines.append(f"The peak of the sensitivity S is {word} {self.sensitivity_peak:.4g} with any controller.")
        lines.append(f"The peak of the complementary sensitivity T is {word} {self.complementary_peak:.4g}.")
        if self.control_peak:
            lines.append(f"Stabilising alone asks for a peak of K S of {self.control_peak:.4g}.")
        if np.isfinite(self.bandwidth_below):
            lines.append(f"The bandwidth cannot be much above {self.bandwidth_below:.4g} rad/s (zeros and delay).")
        if self.bandwidth_above:
            lines.append(f"The bandwidth has to be above about {self.bandwidth_above:.4g} rad/s (unstable poles).")
        if self.bandwidth_above > self.bandwidth_below:
            lines.append("The two leave no room for a robust loop: think of another sensor or actuator.")
        area = self.sensitivity_integral
        lines.append(
            f"Bode integral of ln|det S| over frequency: {area:.4g} rad/s"
            + (" (what is gained at one frequency is paid at another, and more)." if area > 0
               else ": what is gained at one frequency is paid at another.")
        )  # fmt: skip
        return [*lines, f"Not to be trusted: {self.reason}."] if self.reason else lines

    def facts(self) -> Facts:
        """Zeros, poles and least peaks."""
        peaks = (
            f"S {number(self.sensitivity_peak)}, T {number(self.complementary_peak)}, K S {number(self.control_peak)}"
        )
        return [
            ("zeros beyond the boundary", listed(f"{number(m.value)} rad/s" for m in self.zeros) or "none"),
            ("poles beyond the boundary", listed(f"{number(m.value)} rad/s" for m in self.poles) or "none"),
            ("least peaks", peaks),
            ("bandwidth", f"above {number(self.bandwidth_above)}, below {number(self.bandwidth_below, 'rad/s')}"),
            ("Bode integral of ln|det S|", number(self.sensitivity_integral, "rad/s")),
            ("reason", self.reason),
        ]

    def summary(self) -> str:
        """The limits in sentences."""
        return "\n".join(self.sentences())

    def to_json(self) -> dict[str, Any]:
        """All attributes."""
        modes = {"zeros": [m.to_json() for m in self.zeros], "poles": [m.to_json() for m in self.poles]}
        return {"type": "PerformanceLimits", **vars(self), **modes}


@told_as("performance_limits")
def performance_limits(G: Any, *, delay: float = 0.0) -> PerformanceLimits:
    r"""Limits that the plant's unstable zeros, unstable poles and delay put on every stabilising controller.

    .. math:: \min_K \|S\|_\infty = \min_K \|T\|_\infty
        = \sqrt{1 + \bar\sigma^2 (Q_z^{-1/2} Q_{zp} Q_p^{-1/2})}

    .. math:: [Q_z]_{ij} = \frac{y_{z,i}^H y_{z,j}}{z_i + \bar z_j}, \quad
        [Q_p]_{ij} = \frac{y_{p,i}^H y_{p,j}}{\bar p_i + p_j}, \quad
        [Q_{zp}]_{ij} = \frac{y_{z,i}^H y_{p,j}}{z_i - p_j}

    for distinct right-half-plane zeros and poles with output directions y, where there is at least one of each. A
    discrete plant is mapped by the bilinear rule, which keeps peaks and directions.

    Parameters
    ----------
    G
        Plant: StateSpaceModel, or what becomes one; minimal (hidden modes count as zeros and poles).
    delay
        Time delay of the loop in s, of a continuous plant with one input and output: T is at least as large as its
        values at the poles, ``|exp(p delay)|``; not in the plant.

    Returns
    -------
    PerformanceLimits
        Peaks of S, T and K S that nothing gets below, with zeros, poles and the rules of thumb for bandwidth.

    Raises
    ------
    InputError
        No inputs or outputs, a negative delay, or a delay with several channels or a discrete plant.
    NoTrustworthyNumber
        Poles that rounding moves over the stability boundary.

    References
    ----------
    Chen 2000; Skogestad, Postlethwaite 2005, eqs 5.6 to 5.19, 5.28, 6.8 to 6.13; Glover 1986 (control_peak);
    Sung, Hara 1988 (discrete integral).

    Examples
    --------
    >>> G = StateSpaceModel([[1.0, 0.0], [1.0, -5.0]], [[1.0], [0.0]], [[-1.0, 8.0]], [[0.0]])  # zero at 3, pole at 1
    >>> limits = performance_limits(G)
    >>> round(limits.sensitivity_peak, 6)
    2.0
    """
    g = as_model(G, "performance_limits")
    if not g.n_inputs or not g.n_outputs:
        raise InputError("performance_limits", f"{g.n_outputs} outputs, {g.n_inputs} inputs", "at least one of each")
    if not np.isfinite(delay) or delay < 0:
        raise InputError("performance_limits: delay", f"{delay} s", "0 or a positive time in s")
    single = g.n_inputs == g.n_outputs == 1
    if delay and (g.is_discrete or not single):
        found = "a discrete plant" if g.is_discrete else f"{g.n_outputs} x {g.n_inputs} channels"
        raise InputError("performance_limits: delay", found, "a continuous plant with one input and output",
                         "put the delay's samples or a Pade approximation into the plant")  # fmt: skip
    blocked, poles = _unstable_zeros(g), _unstable_poles(g)
    s_peak, t_peak, reason = _peaks(blocked, poles, g, delay)
    reason = blocked.reason or reason
    above, below = _bandwidths(blocked.modes, poles, delay, g.dt)
    rates = np.array([p.value for p in poles], dtype=complex)
    if g.is_discrete:
        area = np.pi / g.dt * float(np.log(np.abs(rates)).sum())
    else:
        area = np.pi * float(np.real(rates).sum())
    return PerformanceLimits(
        tuple(blocked.modes), tuple(poles), s_peak, t_peak, _control_peak(g), area, above, below, float(delay), g.dt,
        Status.INACCURATE if reason else Status.CONVERGED, reason,
    )  # fmt: skip


# --- zeros and poles --------------------------------------------------------------------------------------------------


def _pencil(A: AnyArray, B: AnyArray, C: AnyArray, D: AnyArray) -> tuple[float, AnyArray, AnyArray]:
    """Size of A, and the system pencil in that unit of frequency with input and output of size one."""
    n, k = len(A), D.shape[0]
    b, c = max(np.linalg.norm(B), 1e-300), max(np.linalg.norm(C), 1e-300)
    size = float(np.abs(A).max()) or 1.0
    mass = np.zeros((n + k, n + k))
    mass[:n, :n] = np.eye(n)
    return size, np.block([[A / size, B / b], [C / c, D * size / (b * c)]]), mass


class _Blocked(NamedTuple):
    """Zeros beyond the boundary with directions, how many there are with hidden ones, and why there may be others."""

    modes: list[Mode]
    number: int
    reason: str


def _unstable_zeros(g: StateSpaceModel) -> _Blocked:
    found, modes = zeros(g), list[Mode]()
    size, fastest = np.abs(found.values), float(np.abs(g.poles()).max(initial=0.0))
    still = (size <= BOUNDARY * fastest) & (found.sensitivities * ROUNDING >= 1)
    beyond = size > 1 + BOUNDARY if g.is_discrete else (found.values.real > BOUNDARY * size) & ~still
    for k in np.flatnonzero(beyond):
        if found.kinds[k].startswith("input"):  # a mode that the inputs do not move: no limit of the transfer function
            continue
        z, y, u = complex(found.values[k]), found.output_directions[:, k], found.input_directions[:, k]
        if np.isnan(y).any() or np.isnan(u).any():  # one of several: of more outputs than inputs, or the other way
            left, _, right = np.linalg.svd(np.block([[g.A - z * np.eye(g.n_states), g.B], [g.C, g.D]]))
            y = _unit(left[g.n_states :, -1]) if np.isnan(y).any() else y
            u = _unit(right[-1].conj()[g.n_states :]) if np.isnan(u).any() else u
        modes.append(Mode(z, y, u))
    modes.sort(key=lambda m: (abs(m.value), m.value.imag))
    return _Blocked(modes, int(beyond.sum()), found.reason)


def _unstable_poles(g: StateSpaceModel) -> list[Mode]:
    if not g.n_states:
        return []
    from scipy.linalg import eig

    parts: Any = eig(g.A, left=True, right=True)
    values, left, right = parts
    found: list[Mode] = []
    size = np.abs(values)
    outside = size > 1 + BOUNDARY if g.is_discrete else values.real > BOUNDARY * size.max()
    for k in np.flatnonzero(outside):
        p = complex(values[k].real, 0.0) if abs(values[k].imag) <= 1e-12 * abs(values[k]) else complex(values[k])
        found.append(Mode(p, _unit(g.C @ right[:, k]), _unit(g.B.T @ left[:, k])))
    return sorted(found, key=lambda m: (abs(m.value), m.value.imag))


def _unit(vector: AnyArray) -> AnyArray:
    size = np.linalg.norm(vector)
    return vector / size if size else vector


# --- the limits -------------------------------------------------------------------------------------------------------


def _peaks(blocked: _Blocked, poles: list[Mode], g: StateSpaceModel, delay: float) -> tuple[float, float, str]:
    """Smallest peaks of S and T, and why they may be others."""
    late = float(max((np.exp(p.value.real * delay) for p in poles), default=1.0))
    # The zeros at infinity of a discrete plant, its delay of a sample, come to lie in the right half plane.
    m = bilinear_to_continuous(g) if g.is_discrete else g
    A_p, C_p, _ = _unstable_part(m)
    if not len(A_p):
        return 1.0, late, ""
    mapped = _unstable_zeros(m) if g.is_discrete else blocked
    A_z, Y = _zero_part(m, mapped)
    if not len(A_z):
        return 1.0, late, ""
    from scipy.linalg import solve_sylvester

    # The formula of the docstring in the basis of invariant subspaces: repeated modes are no exception.
    Qz = solve_sylvester(A_z, A_z.conj().T, Y @ Y.conj().T)
    Qp = solve_sylvester(A_p.conj().T, A_p, C_p.conj().T @ C_p)
    Qzp = solve_sylvester(A_z, -A_p.astype(complex), Y @ C_p)
    gain = np.linalg.norm(_inverse_root(Qz).conj().T @ Qzp @ _inverse_root(Qp), 2)
    peak = float(np.sqrt(1 + gain**2))
    alike = len(A_z) in (len(mapped.modes), mapped.number)
    reason = "" if alike else f"{mapped.number} zeros close together, of which {len(A_z)} were found again"
    if not delay:
        return peak, peak, reason
    z = np.linalg.eigvals(A_z)  # each pole by itself: a bound, where the formula without delay is exact
    each = [np.exp(p.value.real * delay) * np.prod(np.abs((z + p.value) / (z - p.value))) for p in poles]
    return peak, float(max(peak, *each)), reason


def _zero_part(m: StateSpaceModel, blocked: _Blocked) -> tuple[AnyArray, AnyArray]:
    """``(A_z, Y)`` with ``X A + Y C = A_z X``, ``X B + Y D = 0``: the unstable zeros and their output directions."""
    from scipy.linalg import ordqz

    n, values = m.n_states, np.array([mode.value for mode in blocked.modes], dtype=complex)
    apart = np.abs(values[:, None] - values) / np.maximum(np.abs(values[:, None]), np.abs(values))
    np.fill_diagonal(apart, 1.0)
    if m.n_inputs != m.n_outputs or apart.min(initial=1.0) > SEPARATE:
        Y = np.array([mode.output.conj() for mode in blocked.modes], dtype=complex).reshape(len(values), m.n_outputs)
        return np.diag(values), Y
    size, pencil, mass = _pencil(m.A, m.B, m.C, m.D)
    last = (1 + SEPARATE) * float(np.abs(values).max()) / size

    def chosen(alpha: AnyArray, beta: AnyArray) -> Mask:
        near = np.abs(alpha) <= last * np.abs(beta)
        value = np.divide(alpha, beta, out=np.zeros_like(alpha), where=near)
        return near & (np.real(value) > BOUNDARY * np.abs(value))

    sort: Any = chosen
    aa, bb, alpha, beta, _, Z = ordqz(pencil.T, mass, sort=sort, output="complex")
    k = int(chosen(alpha, beta).sum())
    S = np.linalg.solve(bb[:k, :k], aa[:k, :k])
    c = max(float(np.linalg.norm(m.C)), 1e-300)
    return size * S.T, Z[n:, :k].T / c


def _inverse_root(Q: AnyArray) -> AnyArray:
    """R with ``R R^H = Q^+``, on the range of a positive semidefinite matrix."""
    values, vectors = np.linalg.eigh(0.5 * (Q + Q.conj().T))
    kept = values > 1e-12 * values.max()
    return vectors[:, kept] / np.sqrt(values[kept])


def _unstable_part(m: StateSpaceModel) -> tuple[AnyArray, AnyArray, AnyArray]:
    """``A_u, C_u, B_u`` of the unstable part of a continuous model: ``G = C_u (s - A_u)^-1 B_u +`` a stable model."""
    from scipy.linalg import schur, solve_sylvester

    n = m.n_states
    edge = BOUNDARY * float(np.abs(m.poles()).max(initial=0.0))
    if not n:
        return m.A, m.C, m.B
    try:
        parts: Any = schur(m.A, output="real", sort=lambda re, im=0.0: re > edge)
    except np.linalg.LinAlgError:
        found = "rounding moves poles over the stability boundary when they are sorted"
        raise NoTrustworthyNumber("performance_limits", found) from None
    T, U, k = parts
    B, C = U.T @ m.B, m.C @ U
    across = solve_sylvester(T[:k, :k], -T[k:, k:], -T[:k, k:]) if 0 < k < n else np.zeros((k, n - k))
    return T[:k, :k], C[:, :k], B[:k] - across @ B[k:]


def _control_peak(g: StateSpaceModel) -> float:
    """Inverse of the smallest Hankel singular value of the mirrored unstable part."""
    A, C, B = _unstable_part(bilinear_to_continuous(g) if g.is_discrete else g)
    if not len(A):
        return 0.0
    reach, see = lyapunov(-A, B @ B.T), lyapunov(-A.T, C.T @ C)
    smallest = float(np.sqrt(max(np.linalg.eigvals(reach @ see).real.min(), 0.0)))
    return 1 / smallest if smallest else np.inf


def _bandwidths(zeros: list[Mode], poles: list[Mode], delay: float, dt: float) -> tuple[float, float]:
    """Rules of thumb in rad/s for one input and output (Skogestad, Postlethwaite 2005, sections 5.7 to 5.9)."""

    def rate(value: complex) -> complex:
        return complex(np.log(value)) / dt if dt else value

    def least(p: complex) -> float:
        return 2 / 3 * (p.real + np.sqrt(4 * p.real**2 + 3 * p.imag**2))

    def most(z: complex) -> float:
        if not z.imag:
            return z.real * (1 - 1 / PEAK)
        return abs(z) / (4.0 if abs(z.imag) < 0.5 * z.real else 2.8 if abs(z.imag) < 2 * z.real else 1.0)

    above = max((least(rate(p.value)) for p in poles), default=0.0)
    # A discrete zero on the negative axis lies beyond the Nyquist frequency and binds no bandwidth below it.
    below = min((most(rate(z.value)) for z in zeros if not dt or z.value.real > 0), default=np.inf)
    return float(above), float(min(below, 1 / delay if delay else np.inf))


def _listed(word: str, modes: tuple[Mode, ...], place: str) -> str:
    if not modes:
        return f"No {word} {place}."
    texts = [f"{m.value.real:.4g}" if not m.value.imag else f"{m.value.real:.4g}{m.value.imag:+.4g}j" for m in modes]
    return f"{len(modes)} {word}{'s' if len(modes) > 1 else ''} {place}: {', '.join(texts)}."


def limits_of(plant: GeneralizedPlant) -> PerformanceLimits:
    """Limits of what leads from the controls to the measurements of a generalised plant.

    Weights that this path does not touch are left out. See `robustlab.performance_limits`.
    """
    names = [s.name for s in plant.controls], [s.name for s in plant.measurements]
    return performance_limits(drop_unconnected(plant.model.select(*names)))


def limits_in_words(plant: GeneralizedPlant, weights: Mapping[str, Any]) -> list[str]:
    """The limits in sentences, with the floors of gamma of mixed-sensitivity weights; or why there are none.

    Examples
    --------
    >>> import robustlab as rl
    >>> G = StateSpaceModel([[-1.0]], [[1.0]], [[-2.0]], [[1.0]])  # (s - 1) / (s + 1)
    >>> design = rl.mixsyn(G, rl.performance_weight(0.1), 0.1)
    >>> limits_in_words(design.plant, design.weights)[-1][:13]
    'gamma >= 0.59'
    """
    try:
        limits = limits_of(plant)
        floors = limits.gamma_bounds(weights.get("W1"), weights.get("W3"))
    except RobustlabError as error:
        return [f"not known: {error.line}"]
    return [*limits.sentences(), *(floor.text for floor in floors)]
