"""Disk margins: how much gain and phase may change in every loop at once before the closed loop is unstable.

Seiler, Packard, Gahinet, "An introduction to disk margins", IEEE Control Systems Magazine 40 (2020), equations 9-17.
"""

# Each loop is multiplied by f = (1 + (1 - sigma)/2 delta) / (1 - (1 + sigma)/2 delta), |delta| < alpha. The largest
# alpha is one over the H-infinity norm of S + (sigma - 1)/2 for one loop, and one over the peak of mu with one
# complex scalar per loop for several.

from __future__ import annotations

import cmath
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, ClassVar, Literal, Self

import numpy as np

from robustlab.budget import Budget, one_thread, search_budget
from robustlab.display import Facts, Part, bracket, number
from robustlab.errors import InputError, error_context
from robustlab.feedback import FeedbackLoop, closing
from robustlab.linear_analysis.narrow_peaks import modes_apart
from robustlab.mu_analysis.axis.robustness import margin_within
from robustlab.mu_analysis.matrix.upper import WORK, compile_kernels
from robustlab.result import Bracket, Status
from robustlab.statespace import StateSpaceModel, as_model
from robustlab.uncertainty.blocks import ComplexScalar
from robustlab.uncertainty.lft import UncertainModel
from robustlab.uncertainty.realised_delta import realise_delta

ACCURACY = 1e-4  # of the proof of several loops; that of one loop is its H-infinity norm

Place = Literal["input", "output", "both"]
AT: Mapping[Place, str] = {
    "input": "the plant's inputs", "output": "the plant's outputs", "both": "the plant's inputs and outputs",
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class DiskBounds(Bracket):
    """Bounds of a disk margin, and the guarantees of the lower one.

    Attributes
    ----------
    lower, upper
        ``lower <= margin <= upper``; ``lower`` is proved: over the whole axis, or at the given frequencies.
    frequency
        Where ``upper`` is attained, rad/s; None where nothing destabilises.
    gain_margin
        Interval of factors that leave the loop stable, in each loop independently; it belongs to ``lower``.
    phase_margin
        Change of phase in rad that leaves the loop stable, either way, in each loop independently; pi where the disk
        holds every change of phase.
    skew
        sigma.
    delta
        Values that attain ``upper``, by the name of the loop or block; empty where nothing destabilises.
    notes
        Remarks for the reader of a report.
    """

    gain_margin: tuple[float, float]
    phase_margin: float
    skew: float
    delta: Mapping[str, Any]
    notes: tuple[str, ...]

    quantities: ClassVar[Mapping[str, Any]] = {
        "lower": "1", "upper": "1", "frequency": "rad/s", "phase_margin": "rad",
    }  # fmt: skip
    kind: ClassVar[str] = "disk margin"

    @property
    def value(self) -> float:
        """The proved disk margin: ``lower``."""
        return self.lower

    def headline(self) -> str:
        low, high = self.gain_margin
        allowed = f"gain by factors {number(low)} .. {number(high)}, phase by +-{in_degrees(self.phase_margin)}"
        return f"{self.kind} of at least {number(self.lower)}: {allowed}"

    def facts(self) -> Facts:
        return [*self._bounds(), *(("note", note) for note in self.notes)]

    def _bounds(self) -> Facts:
        low, high = self.gain_margin
        phase = f"+-{number(self.phase_margin, 'rad')} ({number(math.degrees(self.phase_margin))} degrees)"
        return [
            (self.kind, bracket(self.lower, self.upper, ("proved", "attained"))),
            ("gain", f"factors {number(low)} .. {number(high)}{in_decibels(low, high)}"),
            ("phase", phase),
            ("critical frequency", number(self.frequency, "rad/s") or "none"),
            ("skew", number(self.skew)),
        ]

    def to_json(self) -> dict[str, Any]:
        kept = {name: x for name, x in vars(self).items() if name not in ("system", "proof")}
        return {"type": type(self).__name__, **kept}


@dataclass(frozen=True, eq=False)
class DiskMargin(DiskBounds):
    """Margin for disks of equal size in some loops at once, with the attributes of `DiskBounds`.

    Attributes
    ----------
    lower, upper
        Stable for all ``|delta| < lower``, not for the ``delta``, whose largest modulus is ``upper``. Both inf where
        nothing destabilises.
    factor
        The critical factors f by the name of the loop; inf where f is infinite.
    perturbation
        Models of the critical factors: stable (of first order, second at most, per loop) where ``(1 + sigma) |delta| <
        2``. Empty where a factor is infinite, or where only complex numbers at frequency zero are critical.
    status
        CERTIFIED where ``lower`` is proved; TIMEOUT where the time limit ended the proof.
    system, proof
        The loop at the deltas of its factors, and with exact delays the scalings, for `robustlab.verify`.
    """

    factor: Mapping[str, complex]
    perturbation: Mapping[str, StateSpaceModel]
    system: Any = None
    proof: Any = None


@dataclass(frozen=True, eq=False)
class DiskMargins(DiskBounds):
    """Disk margins of a loop of any type; the attributes of `DiskBounds` are those of all loops at once.

    Attributes
    ----------
    simultaneous
        Margin with all channels changed independently at once, with its evidence.
    channels
        Margin of each channel with the others unchanged, by name; empty where only all at once were requested.
    at
        ``"input"``, ``"output"`` or ``"both"``: where the factors are.
    loop
        The law that closes the loop, and its source.
    status
        CERTIFIED where all are, else the first that is not.
    """

    simultaneous: DiskBounds
    channels: Mapping[str, DiskBounds]
    at: Place
    loop: str

    @classmethod
    def of(
        cls, simultaneous: DiskBounds, channels: Mapping[str, DiskBounds], at: Place, loop: str, **evidence: Any
    ) -> Self:
        """Return the result for these margins."""
        shared = {f.name: getattr(simultaneous, f.name) for f in fields(DiskBounds)}
        every = (*channels.values(), simultaneous)
        shared["status"] = next((m.status for m in every if m.status is not Status.CERTIFIED), Status.CERTIFIED)
        return cls(**shared, simultaneous=simultaneous, channels=channels, at=at, loop=loop, **evidence)

    def facts(self) -> Facts:
        return [("loop", self.loop), ("at", AT[self.at]), *self._bounds(), *(("note", note) for note in self.notes)]

    def details(self) -> list[Part]:
        every = dict(self.channels)
        if len(every) != 1:
            every["all at once"] = self.simultaneous
        rows = [_row(name, margin) for name, margin in every.items()]
        parts = [Part("", ("loop", "disk margin", "gain", "phase", "critical at", "status"), rows)]
        factors: Mapping[str, complex] = getattr(self.simultaneous, "factor", {})
        worst = [(name, _polar(factor)) for name, factor in factors.items()]
        return [*parts, Part(f"worst factors at {number(self.frequency, 'rad/s', 6)}:", ("loop", "factor"), worst)]


def in_decibels(low: float, high: float) -> str:
    """Return two factors of gain in dB, in brackets."""
    with np.errstate(divide="ignore"):
        ends = [f"{20 * np.log10(factor):.3g}" if factor > 0 else "-inf" for factor in (low, high)]
    return f" ({ends[0]} .. {ends[1]} dB)"


def in_degrees(angle: float) -> str:
    """Return an angle in rad as a text in degrees, or inf."""
    return f"{number(math.degrees(angle))} degrees" if math.isfinite(angle) else "inf"


def _row(name: str, margin: DiskBounds) -> tuple[str, ...]:
    low, high = margin.gain_margin
    return (
        name,
        f"{margin.lower:.6g} .. {margin.upper:.6g}",
        f"{number(low)} .. {number(high)}",
        f"+-{in_degrees(margin.phase_margin)}",
        number(margin.frequency, "rad/s", 6) or "none",
        str(margin.status),
    )


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
    found = closed_around(plant, K, sign, "disk_margin")
    check_disk(at, skew, "disk_margin")
    names = channel_names(found.plant.input_names, found.plant.output_names, at)
    # The feedback connection is rounded in these states.
    loop = disk_channels(replace(found, plant=modes_apart(found.plant), K=modes_apart(found.K)), at, skew)
    compile_kernels()
    budget = search_budget("disk_margin", WORK, effort, time_limit)
    with one_thread():
        channels = {name: _margin_of(loop[i, i], [name], skew, budget, seed) for i, name in enumerate(names)}
        whole = channels[names[0]] if len(names) == 1 else _margin_of(loop, names, skew, budget, seed)
    return DiskMargins.of(whole, channels, at, found.said)


def _margin_of(M: StateSpaceModel, names: Sequence[str], skew: float, budget: Budget, seed: int = 0) -> DiskMargin:
    """Return the margin of all channels of M (see `disk_channels`) at once."""
    uncertain = UncertainModel(M, [ComplexScalar(name) for name in names])
    found = margin_within(uncertain, budget, seed=seed, accuracy=ACCURACY)
    delta = {name: complex(value) for name, value in found.delta.items()}
    made = with_factors((found.lower, found.upper), found.frequency, found.status, uncertain, delta, skew)
    return replace(made, notes=(budget.remark, *made.notes)) if budget.remark else made


def closed_around(
    plant: Any, K: Any, sign: int | None, where: str, read: Callable[[Any, str], Any] = as_model
) -> FeedbackLoop:
    """Return `robustlab.feedback.closing` of models that are read, K the identity if omitted."""
    found = closing(read(plant, f"{where}: plant"), K, sign, where)
    k = StateSpaceModel([], [], [], np.eye(len(found.plant.inputs))) if found.K is None else found.K
    return replace(found, K=read(k, f"{where}: K"))


def disk_channels(loop: FeedbackLoop, at: Place, skew: float) -> Any:
    """Return the closed loop at the disks, ``S + (sigma - 1)/2``."""
    P, K = loop.plant, loop.K
    m, p = P.n_inputs, P.n_outputs
    one, places = np.eye(m + p), list(channel_places(m, p, at))
    around = loop.sign * one[:, :m] @ K @ one[m:] + one[:, m:] @ P @ one[:m]  # (u, y) from (u, y)
    # The signal after a channel is the sum of its external input and the feedback.
    S = StateSpaceModel([], [], [], one, P.dt).feedback(around, sign=1)[places, places]
    return S + 0.5 * (skew - 1.0) * np.eye(len(places))


def check_disk(at: Place, skew: float, where: str) -> None:
    """Check the place of the disks and the skew."""
    if at not in AT:
        raise InputError(f"{where}: at", f"{at!r}", "input, output or both")
    if not abs(skew) <= 1e6:
        raise InputError(f"{where}: skew", f"{skew!r}", "a number of at most 1e6 either way")


def channel_places(n_inputs: int, n_outputs: int, at: Place) -> range:
    """Return the indices of the disks' channels among the plant's inputs, then outputs."""
    every = n_inputs + n_outputs
    return {"input": range(n_inputs), "output": range(n_inputs, every), "both": range(every)}[at]


def channel_names(inputs: Sequence[str], outputs: Sequence[str], at: Place) -> list[str]:
    """Return the names of the disks' channels."""
    names, places = [*inputs, *outputs], channel_places(len(inputs), len(outputs), at)
    chosen = [names[i] for i in places]
    if len(set(chosen)) < len(chosen):  # an input and an output of one name
        chosen = [f"{'input' if i < len(inputs) else 'output'} {names[i]}" for i in places]
    return chosen


def with_factors(
    bounds: tuple[float, float],
    frequency: float | None,
    status: Status,
    system: Any,
    delta: Mapping[str, complex],
    skew: float,
    proof: Any = None,
) -> DiskMargin:
    """Return a margin with its critical factors, and models of them where real systems have these values."""
    half = 0.5 * (1.0 + skew)
    factor = {n: 1.0 + d / (1.0 - half * d) if abs(1 - half * d) > 1e-12 else complex(np.inf) for n, d in delta.items()}
    models: dict[str, StateSpaceModel | None] = {}
    note = ""
    if delta and frequency is not None:
        try:
            made = realise_delta([ComplexScalar(name) for name in delta], delta, frequency, system.dt)
            models = {name: _factor_model(as_model(made[name]), skew) for name in delta}
        except InputError:
            note = (
                f"the critical deltas are complex at {frequency:.3g} rad/s, where systems with real coefficients are "
            )
            note += "real: no such system takes them there"
    if None in models.values():
        note = "a critical factor is infinite: no model of it is given"
    perturbation = {name: model for name, model in models.items() if model is not None and not note}
    low, high, phase = gain_and_phase(bounds[0], skew)
    return DiskMargin(
        *bounds, frequency, status, (low, high), phase, skew, dict(delta), (note,) if note else (), factor,
        perturbation, system, proof,
    )  # fmt: skip


def _factor_model(delta: StateSpaceModel, skew: float) -> StateSpaceModel | None:
    """Return ``f = 1 + delta / (1 - (1 + sigma)/2 delta)`` as a model; None where it is not proper."""
    half = (1 + skew) / 2
    below = 1 - half * float(delta.D[0, 0])
    if abs(below) < 1e-12:
        return None
    # z = u + half w with w = delta z, and f u = u + w.
    z_x, z_u = half * delta.C / below, 1 / below
    return StateSpaceModel(delta.A + delta.B @ z_x, delta.B * z_u, delta.C + delta.D @ z_x, 1 + delta.D * z_u, delta.dt)


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
