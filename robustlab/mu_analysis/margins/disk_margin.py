"""Disk margins: how much gain and phase may change in every loop at once before the closed loop is unstable.

Each loop is multiplied by f = (1 + (1 - sigma)/2 delta) / (1 - (1 + sigma)/2 delta), |delta| < alpha. The largest alpha
is one over the H-infinity norm of S + (sigma - 1)/2 for one loop, and one over the peak of mu with one complex scalar
per loop for several: Seiler, Packard, Gahinet 2020, equations 9-17.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, ClassVar, Literal, NamedTuple, Self

import numpy as np

from robustlab.budget import one_thread, search_budget
from robustlab.display import Facts, Part, bracket, number
from robustlab.errors import InputError, error_context
from robustlab.feedback import closing
from robustlab.linear_analysis.frequency import modes_apart
from robustlab.mu_analysis.axis.robustness import robust_stability
from robustlab.mu_analysis.matrix.upper import WORK, compile_kernels
from robustlab.result import Bracket, Status
from robustlab.statespace import StateSpaceModel, as_model
from robustlab.uncertainty.blocks import ComplexScalar
from robustlab.uncertainty.lft import UncertainModel

ACCURACY = 1e-4  # of the proof of several loops; that of one loop is its H-infinity norm

Place = Literal["input", "output", "both"]
AT: Mapping[Place, str] = {
    "input": "the plant's inputs", "output": "the plant's outputs", "both": "the plant's inputs and outputs",
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class DiskBounds(Bracket):
    """Bounds of a disk margin, and the guarantees of the lower one, which is proved: on the axis, or at frequencies.

    ``frequency``: where ``upper`` is attained, rad/s; None where nothing destabilises.
    """

    skew: float  # sigma
    delta: Mapping[str, Any]  # attains ``upper``, by the name of the loop or block; empty where nothing destabilises
    notes: tuple[str, ...]  # for the reader of a report

    quantities: ClassVar[Mapping[str, Any]] = {
        "lower": "1", "upper": "1", "frequency": "rad/s", "phase_margin": "rad",
    }  # fmt: skip
    derived: ClassVar[tuple[str, ...]] = ("gain_margin", "phase_margin")

    @property
    def value(self) -> float:
        """The proved disk margin: ``lower``."""
        return self.lower

    @property
    def gain_margin(self) -> tuple[float, float]:
        """Interval of factors that leave the loop stable, in each loop independently; it belongs to ``lower``."""
        return gain_and_phase(self.lower, self.skew)[:2]

    @property
    def phase_margin(self) -> float:
        """Change of phase in rad, either way, that leaves the loop stable, in each loop independently; pi: any."""
        return gain_and_phase(self.lower, self.skew)[2]

    def headline(self) -> str:
        low, high = self.gain_margin
        allowed = f"gain by factors {number(low)} .. {number(high)}, phase by +-{in_degrees(self.phase_margin)}"
        return f"disk margin of at least {number(self.lower)}: {allowed}"

    def facts(self) -> Facts:
        return [*self._bounds(), *self.scope()]

    def scope(self) -> Facts:
        """Return for what the bounds hold, and the notes."""
        return [("note", note) for note in self.notes]

    def _bounds(self) -> Facts:
        low, high = self.gain_margin
        phase = f"+-{number(self.phase_margin, 'rad')} ({number(math.degrees(self.phase_margin))} degrees)"
        return [
            ("disk margin", bracket(self.lower, self.upper, ("proved", "attained"))),
            ("gain", f"factors {number(low)} .. {number(high)}{in_decibels(low, high)}"),
            ("phase", phase),
            ("critical frequency", number(self.frequency, "rad/s") or "none"),
            ("skew", number(self.skew)),
        ]


@dataclass(frozen=True, eq=False)
class DiskMargin(DiskBounds):
    """Margin for disks of equal size in some loops at once: stable for all ``|delta| < lower``, not for ``delta``.

    Both bounds are inf where nothing destabilises. CERTIFIED where ``lower`` is proved; TIMEOUT where the time limit
    ended the proof.
    """

    factor: Mapping[str, complex]  # the critical factors f by the name of the loop; inf where f is infinite
    system: Any = None  # the loop at the deltas of its factors, for `robustlab.verify`
    proof: Any = None  # with exact delays the scalings

    unsaved: ClassVar[tuple[str, ...]] = ("system", "proof")

    def details(self) -> list[Part]:
        rows = [(name, _polar(factor)) for name, factor in self.factor.items()]
        return [Part(f"worst factors at {number(self.frequency, 'rad/s', 6)}:", ("loop", "factor"), rows)]


@dataclass(frozen=True, eq=False)
class DiskMargins(DiskBounds):
    """Disk margins of a loop of any type; the attributes of `DiskBounds` are those of all loops at once.

    CERTIFIED where all are, else the first status that is not.
    """

    simultaneous: DiskBounds  # all channels changed independently at once, with its evidence
    channels: Mapping[str, DiskBounds]  # each channel with the others unchanged, by name
    at: Place  # of the factors
    loop: str  # the law that closes the loop, and its source

    @classmethod
    def of(cls, opened: Opened, loop: Any, bounds: Callable[[Any, Sequence[str]], DiskBounds]) -> Self:
        """Return the margins of a closed loop at the places where it was opened; ``bounds``: of named channels."""
        names = opened.names
        channels = {name: bounds(loop[i, i], [name]) for i, name in enumerate(names)}
        whole = channels[names[0]] if len(names) == 1 else bounds(loop, names)
        shared = {f.name: getattr(whole, f.name) for f in fields(DiskBounds)}
        doubtful = [m.status for m in (*channels.values(), whole) if m.status is not Status.CERTIFIED]
        shared["status"] = doubtful[0] if doubtful else Status.CERTIFIED
        return cls(**shared, simultaneous=whole, channels=channels, at=opened.at, loop=opened.said)

    def facts(self) -> Facts:
        return [("loop", self.loop), ("at", AT[self.at]), *self._bounds(), *self.simultaneous.scope()]

    def details(self) -> list[Part]:
        every = dict(self.channels)
        if len(every) != 1:
            every["all at once"] = self.simultaneous
        rows = [_row(name, margin) for name, margin in every.items()]
        header = ("loop", "disk margin", "gain", "phase", "critical at", "status")
        return [Part("", header, rows), *self.simultaneous.details()]


def in_decibels(low: float, high: float) -> str:
    """Return two factors of gain in dB, in brackets."""
    ends = [f"{20 * math.log10(factor):.3g}" if factor > 0 else "-inf" for factor in (low, high)]
    return f" ({ends[0]} .. {ends[1]} dB)"


def in_degrees(angle: float) -> str:
    """Return an angle in rad as a text in degrees, or inf."""
    return f"{number(math.degrees(angle))} degrees" if math.isfinite(angle) else "inf"


def _row(name: str, margin: DiskBounds) -> tuple[str, ...]:
    (low, high), at = margin.gain_margin, number(margin.frequency, "rad/s", 6) or "none"
    gain, phase = f"{number(low)} .. {number(high)}", f"+-{in_degrees(margin.phase_margin)}"
    return name, f"{margin.lower:.6g} .. {margin.upper:.6g}", gain, phase, at, str(margin.status)


def _polar(factor: complex) -> str:
    if cmath.isinf(factor):
        return "infinite"
    return f"{abs(factor):.6g} at {math.degrees(cmath.phase(factor)):+.4g} degrees"


@error_context("disk_margin")
def disk_margin(
    plant: Any,
    K: Any = None,
    *,
    at: Place = "output",
    skew: float = 0.0,
    sign: Literal[-1, 1] | None = None,
    time_limit: float | None = None,
    seed: int = 0,
    effort: float = 1.0,
) -> DiskMargins:
    """`robustlab.disk_margin` of a rational plant and controller."""
    opened = opened_at(plant, K, at, sign, "disk_margin", as_model, skew)
    # The feedback connection is rounded in these states.
    opened = opened._replace(P=modes_apart(opened.P), K=modes_apart(opened.K))
    compile_kernels()
    budget = search_budget("disk_margin", WORK, effort, time_limit)

    def bounds(M: StateSpaceModel, names: Sequence[str]) -> DiskMargin:
        uncertain = UncertainModel(M, [ComplexScalar(name) for name in names])
        found = robust_stability(uncertain, accuracy=ACCURACY, seed=seed, budget=budget)
        delta = {name: complex(value) for name, value in found.delta.items()}
        made = with_factors((found.lower, found.upper), found.frequency, found.status, uncertain, delta, skew)
        return replace(made, notes=(budget.remark, *made.notes)) if budget.remark else made

    with one_thread():
        return DiskMargins.of(opened, disk_channels(opened, skew), bounds)


class Opened(NamedTuple):
    """A loop ``y = P u``, ``u = sign K y``, and the places where it is opened, one after the other."""

    P: Any
    K: Any
    sign: int
    said: str  # the law in words, and its source
    at: Place
    places: list[int]  # among the plant's inputs, then outputs
    names: list[str]


def opened_at(
    plant: Any, K: Any, at: Place, sign: int | None, where: str, read: Callable[[Any, str], Any], skew: float = 0.0
) -> Opened:
    """Return the loop of a plant and K (the identity if omitted), both read, for its margins at these places."""
    if at not in AT:
        raise InputError(f"{where}: at", f"{at!r}", "input, output or both")
    if not abs(skew) <= 1e6:
        raise InputError(f"{where}: skew", f"{skew!r}", "a number of at most 1e6 either way")
    found = closing(read(plant, f"{where}: plant"), K, sign, where)
    P, m, p = found.plant, len(found.plant.inputs), len(found.plant.outputs)
    if not m * p:
        raise InputError(where, f"an open loop of {p} x {m}", "a square one, or a K")
    places = [*range(m if at == "output" else 0, m if at == "input" else m + p)]
    names = [s.name for s in (*P.inputs, *P.outputs)][places[0] : places[-1] + 1]
    if len(set(names)) < len(names):  # an input and an output of one name
        names = [f"{'input' if i < m else 'output'} {name}" for i, name in zip(places, names, strict=True)]
    k = StateSpaceModel([], [], [], np.eye(m)) if found.K is None else found.K
    return Opened(P, read(k, f"{where}: K"), found.sign, found.said, at, places, names)


def disk_channels(loop: Opened, skew: float) -> Any:
    """Return the closed loop at the disks, ``S + (sigma - 1)/2``."""
    P, K, m = loop.P, loop.K, loop.P.n_inputs
    one = np.eye(m + P.n_outputs)
    around = loop.sign * one[:, :m] @ K @ one[m:] + one[:, m:] @ P @ one[:m]  # (u, y) from (u, y)
    # The signal after a channel is the sum of its external input and the feedback.
    S = StateSpaceModel([], [], [], one, P.dt).feedback(around, sign=1)[loop.places, loop.places]
    return S + 0.5 * (skew - 1.0) * np.eye(len(loop.places))


def with_factors(
    bounds: tuple[float, float], frequency: float | None, status: Status, system: Any, delta: Mapping[str, complex],
    skew: float, proof: Any = None,
) -> DiskMargin:  # fmt: skip
    """Return a margin with its critical factors."""
    half = 0.5 * (1.0 + skew)
    factor = {n: 1.0 + d / (1.0 - half * d) if abs(1 - half * d) > 1e-12 else complex(np.inf) for n, d in delta.items()}
    return DiskMargin(*bounds, frequency, status, skew, dict(delta), (), factor, system, proof)


def gain_and_phase(alpha: float, skew: float = 0.0) -> tuple[float, float, float]:
    """Return the gain margin interval and the phase margin in rad of the disk of size ``alpha``."""
    # Seiler, Packard, Gahinet (2020): f at delta = -+alpha, and |delta| of the factor e^(j phi).
    if not np.isfinite(alpha):
        return -np.inf, np.inf, np.pi
    low, high = 2 + alpha * (1 + skew), 2 - alpha * (1 + skew)
    gamma_min = (2 - alpha * (1 - skew)) / low if low > 0 else -np.inf
    gamma_max = (2 + alpha * (1 - skew)) / high if high > 0 else np.inf
    # |delta| of the factor e^(j phi) grows with phi up to 2/|sigma| at pi.
    if alpha * abs(skew) >= 2:
        return gamma_min, gamma_max, float(np.pi)
    cosine = (4 - alpha**2 * (1 + skew**2)) / (4 + alpha**2 * (1 - skew**2))
    return gamma_min, gamma_max, float(np.arccos(np.clip(cosine, -1.0, 1.0)))
