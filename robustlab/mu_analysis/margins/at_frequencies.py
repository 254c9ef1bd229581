"""Robustness at given frequencies, not between them: stability margin, worst-case gain and disk margins.

A stable nominal system is assumed: responses at points do not show it. Zhou, Doyle, Glover, *Robust and
Optimal Control* (1996), chapter 11; Seiler, Packard, Gahinet, "An introduction to disk margins" (2020).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import ArrayLike

from robustlab.arrays import Array, ComplexArray
from robustlab.budget import one_thread
from robustlab.display import Facts, Part, bracket, member, number
from robustlab.errors import InputError, NoTrustworthyNumber, error_context
from robustlab.feedback import closing
from robustlab.mu_analysis.axis.margin import PERFORMANCE, StabilityMargin
from robustlab.mu_analysis.margins.disk_margin import (
    DiskBounds,
    DiskMargins,
    Place,
    channel_names,
    channel_places,
    check_disk,
    gain_and_phase,
)
from robustlab.mu_analysis.matrix.bounds import mu
from robustlab.mu_analysis.matrix.branch_and_bound import lowest
from robustlab.mu_analysis.matrix.skew import gain_curves
from robustlab.norms import PeakGain
from robustlab.result import Status
from robustlab.tables import Table, Tabular
from robustlab.uncertainty.blocks import ComplexScalar, FullBlock, delta_values
from robustlab.uncertainty.frequency_responses import UncertainFrequencyData, closed_at, frequency_data

ASSUMED = "the nominal system is stable: taken for granted, responses at points do not show it"


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class _Curves(Tabular):
    """Base of margins with both bounds at each frequency."""

    omega: Array
    lower_at: Array
    upper_at: Array
    delta_at: tuple[Mapping[str, Any], ...]

    def details(self) -> list[Part]:
        return [_rows(self.omega, self.lower_at, self.upper_at)]

    def table(self) -> Table:
        """Both bounds over frequency."""
        return Table(("omega", self.omega), {"lower": self.lower_at, "upper": self.upper_at}, {"omega": "rad/s"})

    def to_json(self) -> dict[str, Any]:
        return {"type": type(self).__name__, **vars(self)}


@dataclass(frozen=True, eq=False)
class MarginAt(_Curves, StabilityMargin):
    """Robust stability margin at given frequencies; its bounds are those where it is smallest.

    Attributes
    ----------
    lower, upper, frequency
        The smallest margin, and where: at ``frequency`` no Delta smaller than ``lower`` makes the loop singular,
        ``delta``, of size ``upper``, does. Both inf where none can.
    omega, lower_at, upper_at, delta_at
        Frequencies in rad/s, (N,), and at each of them the bounds of the margin, (N,), and the Delta found.
    status
        CERTIFIED: ``lower_at`` proved at each frequency, ``upper_at`` attained. CONVERGED: proved, not attained
        everywhere.
    assumed
        Assumption of the answer.
    """

    assumed: str = ASSUMED

    @property
    def stable(self) -> bool | None:
        """False where a member of the set is not stable; else None: points do not show stability."""
        return False if self.upper <= 1 else None

    def headline(self) -> str:
        return f"margin of at least {number(self.lower)} {_scope(self.omega)}"

    def facts(self) -> Facts:
        return [
            ("smallest margin", bracket(self.lower, self.upper, ("proved", "attained"))),
            ("critical frequency", number(self.frequency, "rad/s")),
            ("critical member", member(self.delta, {})),
            ("holds", _scope(self.omega)),
            ("assumed", self.assumed),
        ]


@dataclass(frozen=True, eq=False)
class GainAt(Tabular, PeakGain):
    """Largest gain at given frequencies; nothing is claimed between them.

    Attributes
    ----------
    lower, upper, delta, nominal
        At ``frequency``, the one of the largest ``gain_upper``: the largest gain found, the proved bound, the Delta of
        the former by block name, and the gain of the nominal member.
    omega
        Frequencies in rad/s, (N,).
    nominal_gain, gain_lower, gain_upper
        At each of them the gain of the nominal member, the largest one found, and the proved bound, (N,); the last is
        inf where a Delta of the set may make the loop singular.
    deltas
        At each frequency the Delta of the largest gain found, by block name.
    status
        CERTIFIED: ``gain_upper`` is finite at each frequency, else INCONCLUSIVE.
    """

    frequency: float
    delta: Mapping[str, Any]
    nominal: float
    omega: Array
    nominal_gain: Array
    gain_lower: Array
    gain_upper: Array
    deltas: tuple[Mapping[str, Any], ...]

    quantities: ClassVar[Mapping[str, Any]] = {**PeakGain.quantities, "frequency": "rad/s"}

    def evidence(self) -> Facts:
        return [
            ("nominal there", number(self.nominal)),
            ("Delta", member(self.delta, {})),
            ("scope", _scope(self.omega)),
        ]

    def details(self) -> list[Part]:
        return [_rows(self.omega, self.gain_lower, self.gain_upper)]

    def table(self) -> Table:
        """Nominal gain and both bounds over frequency."""
        columns = {"nominal": self.nominal_gain, "lower": self.gain_lower, "upper": self.gain_upper}
        return Table(("omega", self.omega), columns, {"omega": "rad/s"})

    def to_json(self) -> dict[str, Any]:
        return {**super().to_json(), "assumed": ASSUMED}


@dataclass(frozen=True, eq=False)
class DiskMarginAt(_Curves, DiskBounds):
    """Disk margin of some channels at given frequencies, as `MarginAt`; ``delta_at`` by the name of the loop."""


@dataclass(frozen=True, eq=False)
class DiskMarginsAt(DiskMargins):
    """Disk margins at given frequencies ``omega``, with the attributes of `DiskMargins`; all are `DiskMarginAt`."""

    omega: Array
    assumed: str = ASSUMED

    def facts(self) -> Facts:
        return [*super().facts(), ("holds", _scope(self.omega)), ("assumed", self.assumed)]

    def details(self) -> list[Part]:
        return [*super().details(), *self.simultaneous.details()]


@error_context("robust_stability_at")
@one_thread()
def robust_stability_at(system: Any, frequency: ArrayLike | None = None, *, seed: int = 0) -> MarginAt:
    """`robustlab.robust_stability` of a model or of data at frequencies."""
    data = _data(system, frequency, "robust_stability_at")
    if not data.blocks:
        hint = "frequency_data(..., radius=...) makes one"
        raise InputError("robust_stability_at", "no uncertainty", "blocks", hint)
    return MarginAt(**_bounds_at(data.omega, data.delta_channels, data.blocks, seed))


@error_context("worst_case_gain_at")
@one_thread()
def worst_case_gain_at(system: Any, frequency: ArrayLike | None = None, *, seed: int = 0) -> GainAt:
    """`robustlab.peak_gain` at given frequencies."""
    data = _data(system, frequency, "worst_case_gain_at")
    n_u, n_y = len(data.inputs), len(data.outputs)
    if not n_u or not n_y:
        raise InputError("worst_case_gain_at", f"{n_u} inputs and {n_y} outputs", "at least one of each")
    blocks = (*data.blocks, FullBlock(PERFORMANCE, n_u, n_y))
    lower, upper, found = gain_curves(data.M, blocks, np.random.default_rng(seed), 12, 1e-4)
    if (lower > upper * (1 + 1e-8)).any():
        k = int(np.argmax(lower - upper))
        text = f"a gain of {lower[k]:.9g} above the proved {upper[k]:.9g} at {data.omega[k]:g} rad/s: digits were lost"
        raise NoTrustworthyNumber("worst_case_gain_at", text)
    deltas = tuple({} if g is None else delta_values(data.blocks, g.delta) for g in found)
    nominal = np.linalg.norm(data.nominal, 2, axis=(1, 2))
    status = Status.CERTIFIED if np.isfinite(upper).all() else Status.INCONCLUSIVE
    lower, k = np.minimum(lower, upper), int(np.argmax(upper))
    peak = float(lower[k]), float(upper[k]), float(data.omega[k])
    return GainAt(
        *peak, status, deltas[k], float(nominal[k]), data.omega, nominal, lower, upper, deltas, conditions=(ASSUMED,)
    )


@error_context("disk_margin_at")
@one_thread()
def disk_margin_at(
    plant: Any,
    K: Any = None,
    frequency: ArrayLike | None = None,
    *,
    at: Place = "output",
    skew: float = 0.0,
    sign: Literal[-1, 1] | None = None,
    seed: int = 0,
) -> DiskMarginsAt:
    """`robustlab.disk_margin` of a loop of models or of data at frequencies."""
    where = "disk_margin_at"
    check_disk(at, skew, where)
    closed = closing(_data(plant, frequency, where), K, sign, where)
    p, sign = closed.plant, closed.sign
    k = frequency_data(np.eye(len(p.inputs)) if closed.K is None else closed.K, p.omega)
    for label, data in (("plant", p), ("K", k)):
        if data.blocks:
            raise InputError(
                f"{where}: {label}", "an uncertain one", "one without blocks", "rl.robust_stability of the closed loop"
            )
    P, C = p.nominal, k.nominal
    if C.shape[1:] != P.shape[:0:-1]:
        raise InputError(f"{where}: K", f"{C.shape[1]} x {C.shape[2]}", f"{P.shape[2]} x {P.shape[1]}")
    m, n = P.shape[2], P.shape[1]
    one = np.eye(m + n)
    around = np.zeros((len(P), 2 * (m + n), 2 * (m + n)), dtype=complex)
    around[:, :m, m : m + n], around[:, m : m + n, :m] = sign * C, P
    around[:, m + n :, : m + n] = around[:, : m + n, m + n :] = one
    seen = closed_at(p.omega, around, one, where) + 0.5 * (skew - 1.0) * one
    places = channel_places(m, n, at)
    names = channel_names([s.name for s in p.inputs], [s.name for s in p.outputs], at)
    M = seen[:, list(places)][:, :, list(places)]
    channels = {
        name: _disk_margin_at(p.omega, M[:, [i]][:, :, [i]], [name], skew, seed) for i, name in enumerate(names)
    }
    together = channels[names[0]] if len(names) == 1 else _disk_margin_at(p.omega, M, names, skew, seed)
    return DiskMarginsAt.of(together, channels, at, closed.said, omega=p.omega)


def _disk_margin_at(omega: Array, M: ComplexArray, names: Sequence[str], skew: float, seed: int) -> DiskMarginAt:
    found = _bounds_at(omega, M, [ComplexScalar(name) for name in names], seed)
    low, high, phase = gain_and_phase(found["lower"], skew)
    return DiskMarginAt(**found, gain_margin=(low, high), phase_margin=phase, skew=skew)


def _data(system: Any, frequency: ArrayLike | None, where: str) -> UncertainFrequencyData:
    """Return the system at the requested frequencies; reject asymmetric ranges."""
    if isinstance(system, UncertainFrequencyData):
        if frequency is not None:
            raise InputError(f"{where}: frequency", "given beside data", "none: data have their own")
        data = system
    elif frequency is None:
        raise InputError(
            f"{where}: frequency", "none", "frequencies in rad/s", "the whole axis has functions of its own"
        )
    else:
        data = frequency_data(system, np.unique(np.asarray(frequency, dtype=float)))
    if data.blocks and not (lowest(data.blocks) == -1).all():
        name = next(b.name for b in data.blocks if not b.is_symmetric)
        found = f"the range of {name!r} is wider on one side"
        hint = "model.centred() is the same set about its middle"
        raise InputError(where, found, "symmetric ranges", hint)
    return data


def _bounds_at(omega: Array, M: ComplexArray, blocks: Sequence[Any], seed: int) -> dict[str, Any]:
    """Return the bounds of a margin at each frequency, and the smallest ones, by the names of the fields."""
    found = mu(M, blocks, seed)
    with np.errstate(divide="ignore"):
        lower, upper = 1.0 / np.asarray(found.upper), 1.0 / np.asarray(found.lower)
    delta = tuple(delta_values(blocks, d) if v else {} for d, v in zip(found.delta, found.lower, strict=True))
    k = int(np.argmin(lower))
    return {
        "lower": float(lower[k]), "upper": float(upper[k]), "frequency": float(omega[k]), "status": found.status,
        "delta": delta[k], "notes": (), "omega": omega, "lower_at": lower, "upper_at": upper, "delta_at": delta,
    }  # fmt: skip


def _rows(*columns: Array) -> Part:
    rows = [tuple(f"{value:.6g}" for value in row) for row in zip(*columns, strict=True)]
    return Part("", ("rad/s", "at least", "at most"), rows)


def _scope(omega: Array) -> str:
    if len(omega) == 1:
        return "at this frequency only"
    return f"at the {len(omega)} given frequencies only; nothing is claimed between them"
