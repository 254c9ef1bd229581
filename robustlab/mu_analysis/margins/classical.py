"""Classical margins of single loops: every crossing of the unit circle and of the negative real axis.

A loop is a fraction of polynomials, so its crossings are the roots of two others, computed in whole numbers from the
matrices as given, without a grid and independent of scaling: Skogestad, Postlethwaite, section 2.4.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import numpy as np

from robustlab.display import AllFields, Displayable, Facts, Part, number
from robustlab.errors import NoTrustworthyNumber, error_context
from robustlab.linear_analysis.structural import with_hidden
from robustlab.linear_analysis.zeros import (
    MOST_STATES,
    all_left,
    determinant,
    even_and_odd,
    from_the_circle,
    roots,
    wired,
)
from robustlab.mu_analysis.margins.disk_margin import AT, Place, in_decibels, in_degrees, opened_at
from robustlab.result import Status, Typed
from robustlab.statespace import StateSpaceModel, as_model

if TYPE_CHECKING:
    from flint import fmpz_poly

POLE = 1e9  # larger real responses are due to a pole and give no factor of gain
LEAST = 1e-300  # factors beyond one over this are infinite


@dataclass(frozen=True)
class GainCrossing(AllFields, Displayable):
    """Where ``|L| = 1``: ``lag`` more phase lag in rad, in [0, 2 pi), brings L to -1, and so does a ``delay`` in s."""

    frequency: float
    lag: float
    delay: float

    @classmethod
    def at(cls, omega: float, angle: float) -> GainCrossing:
        """Return the crossing at a frequency where -L has this angle in rad."""
        lag = angle % (2 * math.pi)
        return cls(omega, lag, lag / omega)


@dataclass(frozen=True)
class PhaseCrossing(AllFields, Displayable):
    """Where L is real and negative: ``factor`` times the gain brings L to -1."""

    frequency: float
    factor: float


@dataclass(frozen=True, eq=False)
class ClassicalMargin(Typed, Displayable):
    """Margins of one loop, the others closed; None of an unstable one.

    CONVERGED: all crossings, to the last digits; of loops with delays those found on a grid.
    """

    stable: bool  # the closed loop as it is
    gain_margin: tuple[float, float] | None  # factors about 1 that leave it stable: 0 and inf where nothing is crossed
    phase_margin: float | None  # least change in rad, either way, that destabilises; inf where |L| never is 1
    delay_margin: float | None  # least delay in s that does; 0 of a continuous loop with a direct term of 1 or larger
    gain_crossings: tuple[GainCrossing, ...]  # by rising frequency
    phase_crossings: tuple[PhaseCrossing, ...]
    status: Status
    reason: str = ""  # that the closed loop is unstable, with the modes no feedback changes

    def facts(self) -> Facts:
        met, negative = ([number(c.frequency) for c in those] for those in (self.gain_crossings, self.phase_crossings))
        crossings = [("|L| = 1 at", ", ".join(met) or "no frequency")]
        crossings.append(("L < 0 at", ", ".join(negative) or "no frequency"))
        if self.gain_margin is None or self.phase_margin is None:
            return [("reason", self.reason), *crossings]
        low, high = self.gain_margin
        return [
            ("gain", f"factors {number(low)} .. {number(high)}{in_decibels(low, high)}"),
            ("phase", in_degrees(self.phase_margin)),
            ("delay", number(self.delay_margin, "s")),
            *crossings,
            ("reason", self.reason),
        ]

    @classmethod
    def of(
        cls, stable: bool, gain: Sequence[GainCrossing], phase: Sequence[PhaseCrossing], reason: str = "",
        *, most: float = math.inf, late: float = math.inf,
    ) -> ClassicalMargin:  # fmt: skip
        """Return the margins at these crossings; ``most``, ``late``: ends of the gain and of the delay without any."""
        if not stable:
            return cls(False, None, None, None, tuple(gain), tuple(phase), Status.CONVERGED, reason)
        low = max((c.factor for c in phase if c.factor <= 1), default=0.0)
        high = min((c.factor for c in phase if c.factor >= 1), default=most)
        lag = min((min(c.lag, 2 * math.pi - c.lag) for c in gain), default=math.inf)
        delay = min((*(c.delay for c in gain), late))
        return cls(True, (low, high), lag, delay, tuple(gain), tuple(phase), Status.CONVERGED)


@dataclass(frozen=True, eq=False)
class ClassicalMargins(Typed, Displayable):
    """Margins of each loop, one at a time, and where the loops were opened."""

    channels: Mapping[str, ClassicalMargin]  # by the name of the plant's signal
    at: Place
    status: Status
    loop: str = ""  # the law that closes the loop, and its source

    # None, all but `stable`, where the closed loop is unstable.
    quantities: ClassVar[Mapping[str, Any]] = {
        "stable": bool, "gain_high": "1", "gain_low": "1", "phase": "rad", "delay": "s",
    }  # fmt: skip

    @property
    def stable(self) -> bool:
        """Return whether the closed loop is stable as it is."""
        return all(m.stable for m in self.channels.values())

    @property
    def gain_high(self) -> float | None:
        """Largest factor of gain that every loop alone tolerates."""
        return min((m.gain_margin[1] for m in self.channels.values() if m.gain_margin is not None), default=None)

    @property
    def gain_low(self) -> float | None:
        """Smallest factor of gain that every loop alone tolerates."""
        return max((m.gain_margin[0] for m in self.channels.values() if m.gain_margin is not None), default=None)

    @property
    def phase(self) -> float | None:
        """Change of phase in rad, either way, that every loop alone tolerates."""
        return min((m.phase_margin for m in self.channels.values() if m.phase_margin is not None), default=None)

    @property
    def delay(self) -> float | None:
        """Delay in s that every loop alone tolerates."""
        return min((m.delay_margin for m in self.channels.values() if m.delay_margin is not None), default=None)

    def headline(self) -> str:
        if self.gain_low is None or self.gain_high is None or self.phase is None:
            return next((m.reason for m in self.channels.values() if not m.stable), "the closed loop is unstable")
        gain = f"gain by factors {number(self.gain_low)} .. {number(self.gain_high)}"
        phase, delay = f"phase by {in_degrees(self.phase)}", f"{number(self.delay, 's')} of delay"
        return f"every loop alone tolerates {gain}, {phase}, {delay}"

    def facts(self) -> Facts:
        facts, low, high = [("closed loop", "stable" if self.stable else "unstable")], self.gain_low, self.gain_high
        if self.stable and self.phase is not None and low is not None and high is not None:
            facts += [
                ("gain margin", f"factors {number(low)} .. {number(high)}{in_decibels(low, high)}"),
                ("phase margin", f"{in_degrees(self.phase)} ({number(self.phase, 'rad')})"),
                ("delay margin", number(self.delay, "s")),
            ]
        facts += [("loop", self.loop), ("at", AT[self.at])]
        every = [(name, "; ".join(f"{k} {v}" for k, v in margin.facts()[:3])) for name, margin in self.channels.items()]
        return [*facts, *every]

    def details(self) -> list[Part]:
        rows = []
        for name, margin in self.channels.items():
            for c in margin.gain_crossings:
                distance = f"{in_degrees(c.lag)} or {number(c.delay, 's')} of lag to -1"
                rows.append((name, number(c.frequency, "rad/s", 6), "|L| = 1", distance))
            for c in margin.phase_crossings:
                rows.append((name, number(c.frequency, "rad/s", 6), "L < 0", f"factor {number(c.factor)} to -1"))
        return [Part("crossings:", ("loop", "at", "where", "distance"), rows)]


@error_context("classical_margins")
def classical_margins(
    plant: Any, K: Any = None, *, at: Place = "output", sign: Literal[-1, 1] | None = None
) -> ClassicalMargins:
    """`robustlab.classical_margins` of a rational plant and controller."""
    opened = opened_at(plant, K, at, sign, "classical_margins", as_model)
    stable, loops = loop_fractions(opened.P, opened.K, opened.sign, opened.places)
    unstable = "" if stable else with_hidden("the closed loop is unstable", opened.P, opened.K)
    channels = {name: _margin(L, unstable, name) for name, L in zip(opened.names, loops, strict=True)}
    return ClassicalMargins(channels, at, Status.CONVERGED, opened.said)


def _margin(L: LoopFraction, unstable: str, name: str) -> ClassicalMargin:
    with_gain_one = L.with_gain_one()
    if with_gain_one is None:
        found = f"loop {name}: the gain is 1 at every frequency"
        raise NoTrustworthyNumber("classical_margins", found, "single crossings", "take the disk margin")
    gain = []
    for x in with_gain_one:
        at = L.at(x)
        assert at is not None, "a gain of 1 at a pole"
        away = math.copysign(_square_root(x * at[1] ** 2), -at[1])
        gain.append(GainCrossing.at(L.frequency(x), math.atan2(away, -at[0])))
    points = [(L.frequency(x), at[0]) for x in (Fraction(0), *L.with_real_response()) if (at := L.at(x)) is not None]
    points.append((math.pi / L.dt if L.dt else math.inf, L.at_infinity()))
    phase = [PhaseCrossing(omega, float(-1 / real)) for omega, real in points if -POLE < real < -LEAST]
    late = 0.0 if not L.dt and abs(L.at_infinity()) >= 1 else math.inf
    return ClassicalMargin.of(not unstable, gain, phase, unstable, late=late)


# L = N / D, D = det(loop opened), N + D = det(loop closed), of one matrix that holds A, B, C, D of plant and
# controller as given. With N(j omega) = N_e(x) + j omega N_o(x), x = omega^2: |L| = 1 where N_e^2 + x N_o^2 - D_e^2 -
# x D_o^2 = 0, L real where N_o D_e - N_e D_o = 0. Their positive roots are all crossings, free of rounding.

# |L| (or the angle of L to the real axis) this near to 1 (to 0), compared with its neighbourhood, counts as touched.
# Complex roots x whose imaginary part is a larger share of them than NEIGHBOURHOOD are not tested.
TOUCHED = Fraction(1, 10**9)
NEIGHBOURHOOD = Fraction(1, 10)


class LoopFraction:
    """A loop N / D without common factors; powers of s, or of ``v = (z - 1) / (z + 1)`` of a discrete loop."""

    def __init__(self, N: fmpz_poly, D: fmpz_poly, dt: float) -> None:
        shared = N.gcd(D)
        self.N, self.D, self.dt = N // shared, D // shared, dt
        self.parts = *even_and_odd(self.N), *even_and_odd(self.D)

    def frequency(self, x: Fraction) -> float:
        """Return the frequency in rad/s."""
        omega = _square_root(x)
        return 2 / self.dt * math.atan(omega) if self.dt else omega

    def at(self, x: Fraction) -> tuple[Fraction, Fraction] | None:
        """Return the response at ``omega = sqrt(x)`` as a and b of ``a + j omega b``; None at a pole."""
        from flint import fmpq

        ne, no, de, do = (part(fmpq(x.numerator, x.denominator)) for part in self.parts)
        square = fmpq(x.numerator, x.denominator)
        size = de**2 + square * do**2
        if not size:
            return None
        real, imag = (ne * de + square * no * do) / size, (no * de - ne * do) / size
        return Fraction(int(real.p), int(real.q)), Fraction(int(imag.p), int(imag.q))

    def at_infinity(self) -> Fraction:
        """Return the real limit at infinite frequency (z = -1)."""
        if self.N.degree() > (degree := self.D.degree()):
            raise NoTrustworthyNumber("classical_margins", "a loop of infinite gain at the end of the axis")
        return Fraction(int(self.N[degree]), int(self.D[degree]))

    def with_gain_one(self) -> list[Fraction] | None:
        """Return ``omega^2`` of all frequencies where ``|L| = 1``; None where it is 1 everywhere, to within TOUCHED."""
        from flint import fmpz_poly

        ne, no, de, do = self.parts
        found = _size_squared(ne, no) - _size_squared(de, do)
        size = _size_squared(*(fmpz_poly([abs(c) for c in part.coeffs()]) for part in (de, do)))
        if all(abs(found[k]) * TOUCHED.denominator <= size[k] for k in range(found.degree() + 1)):
            return None
        return self._crossed(found, lambda x, a, b: abs(a * a + x * b * b - 1))

    def with_real_response(self) -> list[Fraction]:
        """Return ``omega^2`` of all positive frequencies where L is real; none where it is real everywhere."""
        ne, no, de, do = self.parts
        share = lambda x, a, b: x * b * b / (a * a + x * b * b) if a or b else Fraction(1)  # noqa: E731
        return self._crossed(no * de - ne * do, share)

    def _crossed(self, f: fmpz_poly, height: Callable[[Fraction, Fraction, Fraction], Fraction]) -> list[Fraction]:
        """Return the positive roots of f, rising, and the points where a height counts as touched."""

        def height_at(x: Fraction) -> Fraction:
            at = self.at(x)
            return Fraction(1) if at is None else height(x, *at)

        found = list[Fraction]()
        for root in roots(f):
            if root.re <= 0 or not 0 <= root.im < NEIGHBOURHOOD * root.re:
                continue
            around = [height_at(root.re * (1 + 2 * way * NEIGHBOURHOOD)) for way in (-1, 1)] if root.im else []
            if not root.im or height_at(root.re) <= TOUCHED * min(Fraction(1), *around):
                found.append(root.re)
        return sorted(found)


def loop_fractions(
    P: StateSpaceModel, K: StateSpaceModel, sign: int, places: Iterable[int]
) -> tuple[bool, list[LoopFraction]]:
    """Return whether the loop ``y = P u``, ``u = sign K y`` is stable, and each loop with the others closed."""
    n, m, p = P.n_states + K.n_states, P.n_inputs, P.n_outputs
    if n > MOST_STATES:
        hint = "rl.reduce_model; or cut the axis: rl.classical_margins(rl.with_delays(P), K)"
        raise NoTrustworthyNumber("classical_margins", f"a loop of {n} states", f"at most {MOST_STATES}", hint)
    u, y = np.split(np.arange(m + p), [m])
    M, _ = wired([(P, u, y, 1), (K, y, u, sign)], -np.eye(m + p))
    (closed, scale), found = determinant(M, n), list[LoopFraction]()
    for signal in (n + place for place in places):
        cut = M.copy()
        cut[:signal, signal] = cut[signal + 1 :, signal] = 0.0
        D, exponent = determinant(cut, n)
        if D.degree() < n and not P.dt:
            raise NoTrustworthyNumber("classical_margins", "a loop of infinite gain at infinite frequency")
        D, whole = D * (1 << max(exponent - scale, 0)), closed * (1 << max(scale - exponent, 0))
        N = whole - D
        N, D = (from_the_circle(N, n), from_the_circle(D, n)) if P.dt else (N, D)
        found.append(LoopFraction(N, D, P.dt))
    poles = from_the_circle(closed, n) if P.dt else closed
    return poles.degree() == n and all_left(poles), found


def _size_squared(even: fmpz_poly, odd: fmpz_poly) -> fmpz_poly:
    """Return ``even^2 + x odd^2``."""
    return even * even + (odd * odd).left_shift(1)


def _square_root(x: Fraction) -> float:
    """Return the square root, also where x overflows."""
    half = (x.numerator.bit_length() - x.denominator.bit_length()) // 2
    return math.ldexp(math.sqrt(x / Fraction(4) ** half), half) if x else 0.0
