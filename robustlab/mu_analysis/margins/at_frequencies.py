"""Robustness at given frequencies, not between them: stability margin, worst-case gain and disk margins.

A stable nominal system is assumed: responses at points do not show it. Zhou, Doyle, Glover, *Robust and Optimal
Control* (1996), chapter 11.
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
from robustlab.mu_analysis.axis.margin import PERFORMANCE, StabilityMargin
from robustlab.mu_analysis.margins.disk_margin import DiskBounds, DiskMargins, Place, opened_at
from robustlab.mu_analysis.matrix.bounds import gain_curves, mu
from robustlab.mu_analysis.matrix.branch_and_bound import lowest
from robustlab.norms import PeakGain
from robustlab.result import Status, Table, Tabular
from robustlab.uncertainty.blocks import ComplexScalar, FullBlock, delta_values
from robustlab.uncertainty.frequency_responses import UncertainFrequencyData, frequency_data

ASSUMED = "the nominal system is stable: taken for granted, responses at points do not show it"


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class _Curves(Tabular):
    """Base of results with both bounds at each frequency."""

    omega: Array  # rad/s, (N,)
    lower_at: Array  # (N,)
    upper_at: Array  # (N,)
    delta_at: tuple[Mapping[str, Any], ...]  # the Delta of the bound that is attained
    assumed: str = ASSUMED

    def scope(self) -> Facts:
        return [("holds", _scope(self.omega)), ("assumed", self.assumed)]

    def details(self) -> list[Part]:
        columns = zip(self.omega, self.lower_at, self.upper_at, strict=True)
        return [Part("", ("rad/s", "at least", "at most"), [tuple(f"{x:.6g}" for x in row) for row in columns])]

    def table(self) -> Table:
        """Both bounds over frequency."""
        return Table(("omega", self.omega), {"lower": self.lower_at, "upper": self.upper_at}, {"omega": "rad/s"})


@dataclass(frozen=True, eq=False)
class MarginAt(_Curves, StabilityMargin):
    """Robust stability margin at given frequencies; its bounds are those where it is smallest.

    At ``frequency`` no Delta smaller than ``lower`` makes the loop singular, ``delta``, of size ``upper``, does; both
    inf where none can. CERTIFIED: ``lower_at`` proved at each frequency, ``upper_at`` attained. CONVERGED: not attained
    everywhere.
    """

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
            *self.scope(),
        ]


@dataclass(frozen=True, eq=False)
class GainAt(_Curves, PeakGain):
    """Largest gain at given frequencies, where ``upper_at`` is proved and ``lower_at`` attained by ``delta_at``.

    Its bounds are those where ``upper_at`` is largest; that is inf where a Delta of the set may make the loop singular.
    CERTIFIED: it is finite at each frequency, else INCONCLUSIVE.
    """

    frequency: float
    delta: Mapping[str, Any]  # of ``lower``, by block name
    nominal: float  # gain of the nominal member there

    quantities: ClassVar[Mapping[str, Any]] = {**PeakGain.quantities, "frequency": "rad/s"}

    def evidence(self) -> Facts:
        return [("nominal there", number(self.nominal)), ("Delta", member(self.delta)), ("scope", _scope(self.omega))]


@dataclass(frozen=True, eq=False)
class DiskMarginAt(_Curves, DiskBounds):
    """Disk margin of some channels at given frequencies, as `MarginAt`; ``delta_at`` by the name of the loop."""


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
    lower, k = np.minimum(lower, upper), int(np.argmax(upper))
    return GainAt(
        float(lower[k]), float(upper[k]), float(data.omega[k]),
        Status.CERTIFIED if np.isfinite(upper).all() else Status.INCONCLUSIVE, deltas[k],
        float(np.linalg.norm(data.nominal[k], 2)), conditions=(ASSUMED,), omega=data.omega, lower_at=lower,
        upper_at=upper, delta_at=deltas,
    )  # fmt: skip


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
) -> DiskMargins:
    """`robustlab.disk_margin` of a loop of models or of data at frequencies."""
    where = "disk_margin_at"
    P = _data(plant, frequency, where)

    def read(given: Any, where: str) -> UncertainFrequencyData:
        data = P if given is P else frequency_data(given, P.omega)
        if data.blocks:
            expected, hint = "one without blocks", "rl.robust_stability of the closed loop"
            raise InputError(where, "an uncertain one", expected, hint)
        return data

    opened = opened_at(P, K, at, sign, where, read, skew)
    G, C = opened.P.M, opened.K.M
    (_, n, m), one = G.shape, np.eye(G.shape[1] + G.shape[2])
    if C.shape[1:] != (m, n):
        raise InputError(f"{where}: K", f"{C.shape[1]} x {C.shape[2]}", f"{m} x {n}")
    around = np.zeros((len(G), *one.shape), dtype=complex)  # (u, y) from (u, y)
    around[:, :m, m:], around[:, m:, :m] = opened.sign * C, G
    T = UncertainFrequencyData(P.omega, around).feedback(one, sign=1)  # S - I
    loop = UncertainFrequencyData(P.omega, T.M + 0.5 * (skew + 1.0) * one)[opened.places, opened.places]

    def bounds(loop: UncertainFrequencyData, names: Sequence[str]) -> DiskMarginAt:
        return DiskMarginAt(**_bounds_at(loop.omega, loop.M, [ComplexScalar(name) for name in names], seed), skew=skew)

    return DiskMargins.of(opened, loop, bounds)


def _data(system: Any, frequency: ArrayLike | None, where: str) -> UncertainFrequencyData:
    """Return the system at the requested frequencies; reject asymmetric ranges."""
    if isinstance(system, UncertainFrequencyData):
        if frequency is not None:
            raise InputError(f"{where}: frequency", "given with data", "none: data have their own")
        data = system
    elif frequency is None:
        hint = "the whole axis has functions of its own"
        raise InputError(f"{where}: frequency", "none", "frequencies in rad/s", hint)
    else:
        data = frequency_data(system, np.unique(np.asarray(frequency, dtype=float)))
    if data.blocks and not (lowest(data.blocks) == -1).all():
        name = next(b.name for b in data.blocks if not b.is_symmetric)
        found, hint = f"the range of {name!r} is wider on one side", "model.centred() is the same set about its middle"
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


def _scope(omega: Array) -> str:
    if len(omega) == 1:
        return "at this frequency only"
    return f"at the {len(omega)} given frequencies only; nothing is claimed between them"
