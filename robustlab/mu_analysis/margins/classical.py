r"""Classical margins of single loops: every crossing of the unit circle and of the negative real axis.

.. math:: 1 - L^\sim(s) L(s) = 0 \;\text{(gain)}, \qquad L(s) - L^\sim(s) = 0 \;\text{(phase)}, \qquad
   L^\sim(s) = L(-s)

The zeros of these two on the imaginary axis are the crossings, all of them: nothing is looked for on a grid. The
imaginary part of *every* zero counts as a candidate, without a tolerance on its real part; the loop itself, evaluated
between the candidates, says which of them are crossings.

One loop and one change at a time is what these margins speak of; `robustlab.mu_analysis.margins.disk_margin` speaks of
gain and phase together, in all loops at once.

References
----------
Skogestad, Postlethwaite, *Multivariable Feedback Control*, section 2.4. The zeros as eigenvalues: Boyd, Balakrishnan
1990, for the gain.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from robustlab.arrays import AnyArray, Array
from robustlab.errors import NoTrustworthyNumber, told_as
from robustlab.frequency import frequency_response
from robustlab.invariant_zeros import transmission_zeros
from robustlab.mu_analysis.margins.disk_margin import Place, closed_around, disk_channels
from robustlab.mu_analysis.margins.small_gain import signed
from robustlab.norms import bilinear_to_continuous
from robustlab.result import Status
from robustlab.shown import Facts, Shown, number
from robustlab.statespace import StateSpaceModel, as_model, series

__all__ = ["ClassicalMargin", "ClassicalMargins", "GainCrossing", "PhaseCrossing", "classical_margins"]

# |L| (or the angle of L to the real axis) this near to 1 (to 0) at a candidate without a change of sign, compared with
# its neighbourhood: it is touched.
TOUCHED = 1e-9
ONE = 1e-8  # relative distance of candidates that are one
POLE = 1e9  # a response beyond this, where L is real, belongs to a pole there: no factor of gain is meant by it
# Factors of gain by which the closed loop is tried, as shares of the way from 1 to the margin's ends, in logarithms.
INSIDE, BEYOND = (0.25, 0.75, 0.999), 1.001
NEAR = 1e-7  # share of the fastest pole within which one lies on the boundary
DECADES = 4  # beyond the outermost candidates, where the ends of the axis are judged


@dataclass(frozen=True)
class GainCrossing(Shown):
    """Where ``|L| = 1``: ``lag`` more phase lag in rad, in [0, 2 pi), brings L to -1, and so does a ``delay`` in s."""

    frequency: float
    lag: float
    delay: float


@dataclass(frozen=True)
class PhaseCrossing(Shown):
    """Where L is real and negative: ``factor`` times the gain brings L to -1."""

    frequency: float
    factor: float


@dataclass(frozen=True, eq=False)
class ClassicalMargin(Shown):
    """Margins of one loop, the others closed.

    Attributes
    ----------
    stable
        Whether the closed loop is stable as it is; margins of an unstable one are None.
    gain_margin
        Ends of the positive factors of gain about 1 that leave it stable: 0 and inf where nothing is crossed.
    phase_margin
        Least change of phase in rad, either way, that destabilises; inf where ``|L|`` never is 1.
    delay_margin
        Least delay in s that destabilises; inf where ``|L|`` never is 1, 0 where the direct term is 1 or larger (any
        delay, however small, then destabilises a continuous loop).
    gain_crossings, phase_crossings
        All of them, by rising frequency.
    status
        CONVERGED where the closed loops at factors on both sides of each end are as stable as the margins say; else
        INACCURATE.
    """

    stable: bool
    gain_margin: tuple[float, float] | None
    phase_margin: float | None
    delay_margin: float | None
    gain_crossings: tuple[GainCrossing, ...]
    phase_crossings: tuple[PhaseCrossing, ...]
    status: Status

    def facts(self) -> Facts:
        """The margins with the frequencies they belong to."""
        if self.gain_margin is None or self.phase_margin is None:
            return [("closed loop", "unstable"), *self._crossings()]
        low, high = self.gain_margin
        phase = f"{number(math.degrees(self.phase_margin))} degrees" if np.isfinite(self.phase_margin) else "inf"
        return [
            ("gain", f"factors {number(low)} .. {number(high)}{_decibels(low, high)}"),
            ("phase", phase),
            ("delay", number(self.delay_margin, "s")),
            *self._crossings(),
        ]

    def _crossings(self) -> Facts:
        return [
            ("|L| = 1 at", ", ".join(number(c.frequency) for c in self.gain_crossings) or "no frequency"),
            ("L < 0 at", ", ".join(number(c.frequency) for c in self.phase_crossings) or "no frequency"),
        ]

    def to_json(self) -> dict[str, Any]:
        """All attributes."""
        told: dict[str, Any] = {"type": "ClassicalMargin", **vars(self)}
        for name in ("gain_crossings", "phase_crossings"):
            told[name] = [vars(crossing).copy() for crossing in told[name]]
        return told


@dataclass(frozen=True, eq=False)
class ClassicalMargins(Shown):
    """Margins of each loop by the name of its signal, one at a time, and where the loops were opened.

    Attributes
    ----------
    channels
        `ClassicalMargin` by the name of the plant's signal.
    at
        Where the loops were opened: at the plant's "output", "input" or "both".
    status
        The least of the channels'.
    loop
        The law that closes the loop, and who says so.
    """

    channels: Mapping[str, ClassicalMargin]
    at: Place
    status: Status
    loop: str = ""

    def facts(self) -> Facts:
        """Gain, phase and delay margin of each loop."""
        every = [(name, "; ".join(f"{k} {v}" for k, v in margin.facts()[:3])) for name, margin in self.channels.items()]
        return [("loop", self.loop), *every]

    def to_json(self) -> dict[str, Any]:
        """All attributes."""
        return {
            "type": "ClassicalMargins",
            "channels": {name: margin.to_json() for name, margin in self.channels.items()},
            "at": self.at,
            "loop": self.loop,
            "status": self.status,
        }


@told_as("classical_margins")
def classical_margins(
    plant: Any, K: Any = None, *, at: Place = "output", sign: Literal[-1, 1] | None = None
) -> ClassicalMargins:
    r"""Gain, phase and delay margins of the loop ``y = P u``, ``u = sign K y``, one loop at a time.

    Each loop is opened alone, the others stay closed. Crossings are computed, not searched on a grid; the ends of the
    gain margin are tried on the closed loop.

    Parameters
    ----------
    plant
        Plant P (p outputs, m inputs), or the whole open loop L, square, where K is left out.
    K
        Controller (m outputs, p inputs), or one whose signals have names that the plant has too.
    at
        Where the loops are opened: at the plant's outputs, its inputs, or both in turn.
    sign
        -1 for negative feedback, 1 for positive feedback; left out: as in `disk_margin`.

    Returns
    -------
    ClassicalMargins
        One `ClassicalMargin` per channel by the name of the plant's signal.

    Raises
    ------
    InputError
        Sizes, names or sample times that do not fit, a sign that contradicts the controller, or a closed loop that is
        not well posed.
    NoTrustworthyNumber
        A loop whose gain is 1 at every frequency: it has no crossings; take `disk_margin`.

    References
    ----------
    Skogestad, Postlethwaite, section 2.4.

    Examples
    --------
    >>> L = StateSpaceModel([[0, 1, 0], [0, 0, 1], [0, -2, -3]], [[0], [0], [1]], [[3, 0, 0]], [[0]])
    >>> margin = classical_margins(L).channels["y1"]  # 3 / (s (s + 1) (s + 2))
    >>> round(margin.gain_margin[1], 9), round(margin.phase_crossings[0].frequency ** 2, 9)
    (2.0, 2.0)
    """
    p = as_model(plant, "classical_margins: plant")
    closed = closed_around(p, K, sign, "classical_margins")
    p, k = closed.plant, closed.K
    # With the skew -1 the channel sees v and adds w to it: the closed loop from w to v.
    loop, names = disk_channels(p, k, (0, 0), at, -1.0, closed.sign)
    stable = loop.is_stable()
    channels = {}
    for i, name in enumerate(names):
        if len(names) == 1:
            order = (p, signed(k, -closed.sign)) if at == "input" else (signed(k, -closed.sign), p)
            opened = series(*order)
        else:
            opened = _opened(loop.select([loop.input_names[i]], [loop.output_names[i]]), name)
        channels[name] = _margin(StateSpaceModel(opened.A, opened.B, opened.C, opened.D, opened.dt), stable, name)
    good = all(margin.status is Status.CONVERGED for margin in channels.values())
    return ClassicalMargins(channels, at, Status.CONVERGED if good else Status.INACCURATE, closed.said)


def _opened(closed: StateSpaceModel, name: str) -> StateSpaceModel:
    """L of negative feedback from what is seen of the loop closed: ``v = M w`` with ``v = -L (v + w)``."""
    whole = 1 + float(closed.D[0, 0])
    if whole == 0:
        found = f"loop {name}: infinite gain at infinite frequency"
        raise NoTrustworthyNumber("classical_margins", found, "a loop that can be opened there")
    B, C = closed.B / whole, -closed.C / whole
    return StateSpaceModel(closed.A - B @ closed.C, B, C, -closed.D / whole, closed.dt)


def _decibels(low: float, high: float) -> str:
    with np.errstate(divide="ignore"):
        ends = [f"{20 * np.log10(factor):.3g}" for factor in (low, high)]
    return f" ({ends[0]} .. {ends[1]} dB)"


# --- crossings --------------------------------------------------------------------------------------------------------


def _margin(L: StateSpaceModel, stable: bool, name: str) -> ClassicalMargin:
    axis = bilinear_to_continuous(L) if L.is_discrete else L
    if L.n_states and _one_everywhere(axis):
        found = f"loop {name}: the gain is 1 at every frequency"
        raise NoTrustworthyNumber("classical_margins", found, "single crossings", "take the disk margin")
    gain = tuple(_gain_crossing(L, w) for w in _crossings(L, _candidates(axis, "gain"), _log_gain))
    phase = tuple(_phase_crossings(L, _crossings(L, _candidates(axis, "phase"), _imaginary)))
    if not stable:
        return ClassicalMargin(False, None, None, None, gain, phase, Status.CONVERGED)
    factors = [c.factor for c in phase]
    low = max((k for k in factors if k <= 1), default=0.0)
    high = min((k for k in factors if k >= 1), default=math.inf)
    lag = min((min(c.lag, 2 * math.pi - c.lag) for c in gain), default=math.inf)
    delay = min((c.delay for c in gain), default=math.inf)
    if not L.is_discrete and abs(L.D[0, 0]) >= 1:
        delay = 0.0
    status = Status.CONVERGED if _as_tried(L, low, high) else Status.INACCURATE
    return ClassicalMargin(True, (low, high), lag, delay, gain, phase, status)


def _candidates(axis: StateSpaceModel, kind: Literal["gain", "phase"]) -> Array:
    """Positive frequencies next to which a crossing of a continuous loop may lie, in rad/s, rising."""
    A, b, c, d = axis.A, axis.B, axis.C, axis.D
    n, nothing = len(A), np.zeros((len(A), len(A)))
    if kind == "gain":  # 1 - L~ L: L drives L~ = (-A', c', -b', d)
        model = StateSpaceModel(
            np.block([[A, nothing], [c.T @ c, -A.T]]), np.vstack([b, c.T @ d]), np.hstack([-d @ c, b.T]), 1 - d @ d
        )
    else:  # L - L~
        model = StateSpaceModel(
            np.block([[A, nothing], [nothing, -A.T]]), np.vstack([b, c.T]), np.hstack([c, b.T]), np.zeros((1, 1))
        )
    height = np.abs(np.imag(transmission_zeros(model)))
    size = float(np.abs(axis.poles()).max(initial=0.0)) or 1.0
    return np.unique(height[height > 1e-14 * size]) if n else np.zeros(0)


def _one_everywhere(axis: StateSpaceModel) -> bool:
    size = float(np.abs(axis.poles()).max(initial=0.0)) or 1.0
    points = size * np.array([0.0137, 0.173, 1.31, 19.7])
    return bool(np.abs(_log_gain(frequency_response(axis, points)[:, 0, 0])).max() <= TOUCHED)


def _log_gain(response: AnyArray) -> Array:
    with np.errstate(divide="ignore"):
        return np.log(np.abs(response))


def _imaginary(response: AnyArray) -> Array:
    """Sine of the angle to the real axis: no matter how small or large L is."""
    size = np.abs(response)
    return np.divide(np.imag(response), size, out=np.zeros(len(size)), where=(size > 0) & np.isfinite(size))


def _crossings(L: StateSpaceModel, candidates: Array, height: Any) -> Iterator[float]:
    """Frequencies in rad/s, of the loop as given, at which ``height`` of the response changes its sign or is zero."""
    if L.is_discrete:
        candidates = 2 / L.dt * np.arctan(candidates * L.dt / 2)
    if not len(candidates):
        return
    candidates = np.sort(candidates)
    candidates = candidates[np.append(True, candidates[1:] > candidates[:-1] * (1 + ONE))]
    far = 10.0**DECADES
    last = min(candidates[-1] * far, np.pi / L.dt) if L.is_discrete else candidates[-1] * far
    between = np.concatenate([[candidates[0] / far], np.sqrt(candidates[1:] * candidates[:-1]), [last]])
    values = height(_response(L, between))
    for k, w in enumerate(candidates):
        here = values[k], values[k + 1]
        if np.isfinite(here).all() and here[0] * here[1] < 0 and np.abs(here).max() > TOUCHED:
            yield _root(L, height, between[k], between[k + 1])
        elif abs(height(_response(L, np.array([w]))[:1])[0]) <= TOUCHED * min(1.0, *np.abs(here)):
            yield float(w)


def _root(L: StateSpaceModel, height: Any, low: float, high: float) -> float:
    from scipy.optimize import brentq

    def at(x: float) -> float:
        return float(height(_response(L, np.array([math.exp(x)])))[0])

    solve: Any = brentq
    root = solve(at, math.log(low), math.log(high), xtol=1e-15, rtol=1e-15)
    return math.exp(root)


def _response(L: StateSpaceModel, omega: Array) -> AnyArray:
    """L at frequencies, shape (n_omega,); inf at a pole."""
    try:
        return frequency_response(L, omega)[:, 0, 0]
    except NoTrustworthyNumber:
        if len(omega) == 1:
            return np.array([complex(np.inf)])
        return np.concatenate([_response(L, omega[k : k + 1]) for k in range(len(omega))])


def _gain_crossing(L: StateSpaceModel, omega: float) -> GainCrossing:
    angle = float(np.angle(_response(L, np.array([omega]))[0]))
    lag = (angle + math.pi) % (2 * math.pi)
    return GainCrossing(omega, lag, lag / omega)


def _phase_crossings(L: StateSpaceModel, crossings: Iterator[float]) -> Iterator[PhaseCrossing]:
    """Those where L is negative; the ends of the axis, where it is real always, are among them."""
    ends = (0.0, np.pi / L.dt) if L.is_discrete else (0.0, np.inf)
    for omega in sorted({*ends, *crossings}):
        response = complex(_response(L, np.array([omega]))[0])
        if -POLE < response.real < 0:
            yield PhaseCrossing(omega, -1 / response.real)


# --- the other voice: closed loops -----------------------------------------------------------------------------------


def _as_tried(L: StateSpaceModel, low: float, high: float) -> bool:
    """Closed loops between the ends are stable; just beyond an end, or where L only touches -1 at it, they are not."""
    for end in (low, high):
        reach = min(max(end, 1e-3), 1e3)
        if abs(math.log(reach)) < 1e-6:
            continue
        if not all(_stable(L, reach**share) for share in INSIDE):
            return False
        if reach == end and _stable(L, end**BEYOND) and _stable(L, end, NEAR):
            return False
    return True


def _stable(L: StateSpaceModel, factor: float, near: float = 0.0) -> bool:
    """Whether the closed loop with so much gain is stable, by more than the share ``near`` of its fastest pole."""
    whole = 1 + factor * float(L.D[0, 0])
    if whole == 0:
        return False
    closed = StateSpaceModel(L.A - L.B @ L.C * (factor / whole), L.B, L.C, L.D, L.dt)
    fastest = float(np.abs(closed.poles()).max(initial=0.0))
    return not closed.n_states or closed.spectral_abscissa() < -near * fastest
