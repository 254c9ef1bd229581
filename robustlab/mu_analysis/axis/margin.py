"""The robust stability margin and the worst-case gain with their evidence; the critical member in time."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from robustlab.arrays import Array
from robustlab.display import SHOWN_BLOCKS, AllFields, Displayable, Facts, Part, bracket, listed, member, number
from robustlab.errors import InputError, NoTrustworthyNumber
from robustlab.mu_analysis.axis.intervals import Piece
from robustlab.mu_analysis.matrix.branch_and_bound import Box, Region
from robustlab.norms import PeakGain
from robustlab.result import Bracket, Table, Tabular
from robustlab.statespace import Signal, StateSpaceModel
from robustlab.uncertainty.lft import UncertainModel
from robustlab.uncertainty.perturbation_systems import realise_delta

PERFORMANCE = "performance"  # the block that robust_performance adds; no range of the user's


@dataclass(frozen=True, eq=False)
class StabilityMargin(Bracket):
    """Largest size of a set without an unstable member, for any type of system.

    ``lower``, ``upper``: ``lower <= margin <= upper``, 1 for the set as given: stable for every member of a set
    ``lower`` times as large, which is proved; one of size ``upper`` is unstable, inf where none was found. Where
    nothing is uncertain: inf of a stable system, 0 of an unstable one.
    ``frequency``: Where the pole of that member crosses the stability boundary, rad/s; None where that is unknown.
    ``status``: CERTIFIED where ``lower`` is proved.
    """

    quantities: ClassVar[Mapping[str, Any]] = {
        "lower": "1", "upper": "1", "frequency": "rad/s", "stable": bool, "delta": {"*": ...},
    }  # fmt: skip

    #: The smallest unstable member found, one normalised value per block name; empty where none was
    delta: Mapping[str, Any]
    notes: tuple[str, ...]  #: Remarks for the reader of a report

    @property
    def stable(self) -> bool | None:
        """Return whether every member of the set as given is stable; None where neither was shown."""
        return True if self.lower > 1 else False if self.upper <= 1 else None

    def headline(self) -> str:
        if self.stable is None:
            return "not proved stable over the whole set"
        if self.stable:
            return "proved stable for every Delta of the set"
        return f"not robust: the member at k = {number(self.upper)} is unstable"


@dataclass(frozen=True, eq=False, kw_only=True)
class AxisResult(Tabular, Bracket):
    """Evidence of a result over the whole frequency axis."""

    bounded: ClassVar[str]  # what an interval bounds

    physical: Mapping[str, tuple[float, str]]  #: The values and units of the physical parameters at ``delta``
    omega: Array  #: Requested frequencies of the curves for figures, rad/s
    #: ``(low, high, bound)`` in rad/s: proved with D, G scalings, together covering [0, inf] where the status is
    #: CERTIFIED
    intervals: tuple[tuple[float, float, float], ...]
    open: tuple[tuple[float, float], ...]  #: Frequency intervals for which nothing is proved
    #: Evidence of the proved bound: pieces of the axis with their D, G, or, after branch and bound, the proved regions
    #: (boxes of parameters with frequencies)
    proof: tuple[Piece, ...] | tuple[Region, ...]
    #: The set, and each box of a branch and bound with an interval proved in it, for `robustlab.verify`
    system: UncertainModel | None = None
    boxes: tuple[tuple[Box, Piece], ...] = ()

    unsaved: ClassVar[tuple[str, ...]] = ("proof", "system", "boxes")
    derived: ClassVar[tuple[str, ...]] = ("gap",)

    @property
    def gap(self) -> float:
        """``upper / lower - 1``; 0 where both are equal, inf where ``lower`` is 0."""
        lower, upper = self.lower, self.upper
        return 0.0 if lower == upper else upper / lower - 1 if lower > 0 else float("inf")

    def proved_intervals(self) -> Part:
        """Proved bound of each interval of frequency, and the open intervals."""
        proved = [(f"{low:.6g}", f"{high:.6g}", f"{bound:.6g}") for low, high, bound in sorted(self.intervals)]
        unproved = [(f"{low:.6g}", f"{high:.6g}", "not proved") for low, high in self.open]
        header = ("from rad/s", "to rad/s", f"{self.bounded} at most")
        return Part("proved intervals:", header, [*proved, *unproved])

    def size_of_proof(self) -> tuple[str, str]:
        """Return the number of parts of the proof, as a fact."""
        return "proof", f"{len(self.proof)} parts, {len(self.open)} intervals of frequency left open"


@dataclass(frozen=True, eq=False)
class Margin(AxisResult, StabilityMargin):
    """Robust stability margin over the whole frequency axis: a `StabilityMargin` with the evidence of `AxisResult`.

    ``status``: CERTIFIED: ``lower`` proved on the whole axis. INCONCLUSIVE: ``open`` intervals are left,
    ``mu_upper`` holds on the grid only. TIMEOUT: the time limit ended the proof; ``lower`` and ``open`` give the
    part that was proved.
    """

    kind: ClassVar[str] = "robust stability margin"

    bounded: ClassVar[str] = "mu"

    pole: complex | None  #: The pole on or beyond the stability boundary of the model perturbed by ``delta``
    #: Bounds of mu at the frequencies ``omega``; ``intervals`` has the bounds between them
    mu_lower: Array
    mu_upper: Array
    #: Share of each block in the margin: with 1 % less range of a block it grows by share percent
    shares: Mapping[str, float]

    def facts(self) -> Facts:
        peak = bracket(1 / self.upper, 1 / self.lower, ("attained", "proved")) if self.upper and self.lower else ""
        ranked = sorted(self.shares.items(), key=lambda pair: -abs(pair[1]))
        first = next((pair for pair in ranked if pair[0] in self.physical or pair[0] != PERFORMANCE), None)
        gain = f"{first[0]}: a range 1 % smaller raises the margin by {first[1]:.2g} %" if first else ""
        return [
            *([("the set as stated", self.headline())] if self.stable is False else []),
            (self.kind, bracket(self.lower, self.upper, ("proved", "attained"))),
            ("peak of mu", peak),
            ("critical member", member(self.delta, self.physical) or "none found"),
            ("critical frequency", number(self.frequency, "rad/s")),
            ("shares of the blocks", listed(f"{name} {100 * share:.0f} %" for name, share in ranked)),
            ("most sensitive to", gain),
            self.size_of_proof(),
            ("a margin of 1", "is the set as stated; at 2 every range could be twice as wide"),
            *(("note", note) for note in self.notes),
        ]

    def details(self) -> list[Part]:
        header = ("block", "delta", "parameter", *(("share",) if self.shares else ()))
        return [Part("critical Delta (smallest found):", header, delta_rows(self.delta, self.physical, self.shares))]

    def table(self) -> Table:
        """Both bounds of mu over the requested frequencies."""
        columns = {"mu_lower": self.mu_lower, "mu_upper": self.mu_upper}
        return Table(("omega", self.omega), columns, {"omega": "rad/s"})


@dataclass(frozen=True, eq=False)
class PerformanceMargin(Margin):
    """Robust performance margin: a `Margin` whose set has a performance block, too."""

    kind: ClassVar[str] = "robust performance margin"

    def headline(self) -> str:
        if self.stable is False:
            return f"not robust: the member at k = {number(self.upper)} does not perform"
        kept = "proved for every Delta of the set" if self.stable else "not proved over the whole set"
        return f"performance is {kept}"


@dataclass(frozen=True, eq=False)
class WorstCaseGain(AxisResult, PeakGain):
    """Bounds of the largest gain ``sigma_max`` of any member of the set at any frequency, with their `AxisResult`.

    ``lower``, ``upper``, ``frequency``: ``lower`` is the gain of the member at ``delta``, at ``frequency`` in rad/s
    (of an unstable one: of its pole); ``upper`` is proved over the whole frequency axis and the whole set. Both are
    inf where a member is unstable.
    ``status``: CERTIFIED: ``upper`` is proved. INCONCLUSIVE: it is not, and reads inf. TIMEOUT: the time limit
    ended the proof; ``upper`` is the bound proved by then. INACCURATE: there is no uncertainty, and digits of the
    nominal gain were lost.
    """

    bounded: ClassVar[str] = "gain"

    delta: Mapping[str, Any]  #: The worst Delta found, one value per block name
    nominal: float  #: Gain of the nominal member
    #: Curves over the frequencies ``omega``
    nominal_gain: Array
    gain_lower: Array
    gain_upper: Array

    quantities: ClassVar[Mapping[str, Any]] = {**PeakGain.quantities, "frequency": "rad/s", "nominal": float}

    def evidence(self) -> Facts:
        """The worst member, and the size of the proof."""
        worst = member(self.delta, self.physical)
        return [("nominal gain", number(self.nominal)), ("worst member", worst), self.size_of_proof()]

    def details(self) -> list[Part]:
        return [Part("worst Delta found:", ("block", "delta", "parameter"), delta_rows(self.delta, self.physical))]

    def table(self) -> Table:
        """Nominal gain and both bounds over the requested frequencies."""
        columns = {"nominal": self.nominal_gain, "lower": self.gain_lower, "upper": self.gain_upper}
        return Table(("omega", self.omega), columns, {"omega": "rad/s"})


def delta_rows(
    delta: Mapping[str, Any], physical: Mapping[str, tuple[float, str]], shares: Mapping[str, float] | None = None
) -> list[tuple[str, ...]]:
    """One row a block: name, normalised value, parameter with unit; with ``shares`` these too, the largest first."""
    order = sorted(delta, key=lambda name: -abs(shares.get(name, 0.0))) if shares else list(delta)
    rows = []
    for name in order[:SHOWN_BLOCKS]:
        value = delta[name]
        text = f"{value.shape[0]} x {value.shape[1]} matrix" if getattr(value, "ndim", 0) else f"{value:+.6g}"
        row = (name, text, number(*physical[name], digits=6) if name in physical else "")
        rows.append((*row, f"{100 * shares[name]:.1f} %" if name in shares else "") if shares else row)
    if len(order) > SHOWN_BLOCKS:
        rows.append((f"... and {len(order) - SHOWN_BLOCKS} more blocks", *([""] * (3 if shares else 2))))
    return rows


# --- time response of the critical Delta ---------------------------------------------------------------------------

INSIDE = 0.95  # share of the critical Delta of the response just inside the margin


@dataclass(frozen=True, eq=False)
class CriticalResponse(AllFields, Displayable):
    """Free responses from the critical mode: nominal, just inside the margin, and at the critical Delta."""

    t: Array  #: Times in s, shape (n,)
    outputs: tuple[Signal, ...]  #: Signals of the columns
    #: Outputs (n, n_outputs) with no Delta, with 0.95 times the critical one, and with it; the largest output of the
    #: last starts at one
    nominal: Array
    inside: Array
    critical: Array
    #: Size of ``critical`` over the last period divided by that over the first: 1 on the stability boundary
    growth: float
    #: Period in s of the critical mode; the time constant of the nominal model's slowest mode where it does not
    #: oscillate
    period: float

    def facts(self) -> Facts:
        return [("last period over the first", number(self.growth)), ("period", number(self.period, "s"))]


def replay(uncertain: UncertainModel, margin: Margin, periods: int = 12, points: int = 40) -> CriticalResponse:
    """Simulate the model from the mode that the critical Delta brings to the stability boundary."""
    if not margin.delta or margin.frequency is None:
        raise InputError("replay", "a margin without a critical Delta", "one that was attained")
    if set(margin.delta) - {b.name for b in uncertain.blocks}:
        raise InputError("replay", f"blocks {', '.join(margin.delta)}", "the margin of this very model")
    if not np.isfinite(margin.frequency) or periods < 2 or points < 4:
        found = f"frequency {margin.frequency}, {periods} periods, {points} points"
        raise NoTrustworthyNumber("replay", f"{found}: a loop that is ill-posed, or too short a record, shows nothing")

    omega, nominal = float(margin.frequency), uncertain.nominal

    def member(factor: float) -> StateSpaceModel:
        values = {name: factor * value for name, value in margin.delta.items()}
        return uncertain.evaluate(realise_delta(uncertain.blocks, values, omega, uncertain.dt))

    critical = member(1.0)
    poles, right = np.linalg.eig(critical.A)
    aim = margin.pole if margin.pole is not None else 1j * omega
    k = int(np.argmin(np.minimum(np.abs(poles - aim), np.abs(np.conj(poles) - aim))))
    mode = right[:, k]
    x0 = np.real(mode) if np.abs(np.real(mode)).max() > 1e-3 else np.imag(mode)
    slow = nominal.poles()
    rates = -np.log(np.abs(slow[np.abs(slow) > 0])) / nominal.dt if nominal.is_discrete else -slow.real
    period = 2 * np.pi / omega if omega > 0 else 1 / rates.min() if (rates > 0).all() and len(rates) else 1.0
    t = np.linspace(0.0, periods * period, periods * points + 1)
    if uncertain.dt:
        t = np.arange(max(round(periods * period / uncertain.dt), 2) + 1) * uncertain.dt
    response = _free(critical, x0, t)
    first = float(np.abs(response[t < period]).max(initial=0.0))
    if not first > 1e-12 * float(np.abs(x0).max()):
        raise NoTrustworthyNumber("replay", "the critical mode does not show at any output")
    x0 = x0 / first
    growth = float(np.abs(response[t >= t[-1] - period]).max() / first)
    free, inside = _free(nominal, x0[: uncertain.M.n_states], t), _free(member(INSIDE), x0, t)
    return CriticalResponse(t, uncertain.outputs, free, inside, response / first, growth, float(period))


def _free(model: StateSpaceModel, x0: Array, t: Array) -> Array:
    """Outputs (n, n_outputs) without input."""
    from scipy.linalg import expm

    step = model.A if model.is_discrete else expm(model.A * (t[1] - t[0]))
    states = np.empty((len(t), model.n_states))
    states[0] = x0
    for i in range(1, len(t)):
        states[i] = step @ states[i - 1]
    return states @ model.C.T
