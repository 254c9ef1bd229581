"""Performance of sets: the largest size that keeps a gain below a level, and one requirement under several controllers.

Packard, Balas, Liu, Shin, "Results on worst-case performance assessment", ACC 2000.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np

from robustlab.analysis.gains_and_margins import peak_gain
from robustlab.display import Displayable, Facts, Part, bracket, member, number
from robustlab.errors import InputError, error_context
from robustlab.mu_analysis.axis.margin import Margin, WorstCaseGain
from robustlab.mu_analysis.axis.robustness import robust_performance, worst_case_gain
from robustlab.norms import PeakGain
from robustlab.result import Bracket, Status, least_trusted
from robustlab.statespace import StateSpaceModel
from robustlab.synthesis.specifications.loop_functions import frequencies
from robustlab.uncertainty.lft import UncertainModel

LARGEST = 2.0**20  # largest size of the set that is tried, relative to the given one
CLOSE = 1e-3  # a level nearer than this to the nominal gain, relative, needs no closer proof
STEPS = 20  # worst-case gains at most; 1 % takes about 5
INNER = 0.25  # each of them is proved to this share of the tolerance, less where the level is next to the nominal gain


@dataclass(frozen=True, eq=False)
class RobustGain(Bracket):
    """Largest size of a set for which every member's gain is below ``level``.

    ``lower`` is proved; the member ``delta`` of the set ``upper`` times as large reaches the level at ``frequency``,
    rad/s. Both are 0 where the nominal model reaches it; ``upper`` is inf where no member of the largest set does.
    CERTIFIED where the bounds are as close as requested; else INCONCLUSIVE.
    """

    level: float  # in the unit of the outputs over that of the inputs
    delta: Mapping[str, Any]  # that member, in units of the set as given
    physical: Mapping[str, tuple[float, str]]  # its parameters with units
    proof: WorstCaseGain | None  # of the set ``lower`` times as large; None where ``lower`` is 0

    quantities: ClassVar[Mapping[str, Any]] = {
        "lower": "1", "upper": "1", "frequency": "rad/s", "delta": {"*": ...}, "level": float,
    }  # fmt: skip
    unsaved: ClassVar[tuple[str, ...]] = ("proof",)

    def headline(self) -> str:
        kept = "proved for the whole set" if self.lower >= 1 else "not proved for the whole set"
        return f"a gain below {number(self.level, digits=6)} is {kept}"

    def facts(self) -> Facts:
        return [
            ("robust gain margin", bracket(self.lower, self.upper, ("proved", "attained"))),
            ("gain below", number(self.level, digits=6)),
            ("critical member", member(self.delta, self.physical)),
            ("critical frequency", number(self.frequency, "rad/s")),
        ]


@error_context("robust_gain")
def robust_gain(
    uncertain: UncertainModel, level: float, tolerance: float = 0.01, seed: int = 0, effort: float = 1.0
) -> RobustGain:
    r"""Largest k for which all Delta of size below k leave the gain below ``level``.

    .. math:: k^* = \sup \{ k : \; \sup_{|\Delta| \le k} \|F_u(M, \Delta)\|_\infty < \gamma \}

    The level is fixed while the set grows; in `robust_performance` both grow.

    Parameters
    ----------
    uncertain
        Uncertain model; an asymmetric range grows in proportion on both sides.
    level, tolerance
        :math:`\gamma`, positive, in units of outputs per unit of inputs; target of the relative gap of the bounds.
    seed, effort
        As in `peak_gain`, of each worst-case gain.

    Returns
    -------
    RobustGain
        Both bounds, the member that reaches the level, and the proof of ``lower``.

    Raises
    ------
    InputError, NoTrustworthyNumber
        No uncertain model, or a level or tolerance that is not positive. The nominal model is unstable.

    Examples
    --------
    >>> import robustlab as rl
    >>> M = rl.StateSpaceModel([[-1.0]], [[-0.5, 1.0]], [[1.0], [1.0]], [[0.0, 0.0], [0.0, 0.0]])
    >>> found = rl.robust_gain(rl.UncertainModel(M, [rl.RealScalar("pole")]), 4.0)  # 1 / (s + 1 + delta / 2)
    >>> found.lower <= 1.5 <= found.upper, round(found.upper, 2)
    (True, 1.5)
    """
    if not isinstance(uncertain, UncertainModel):
        raise InputError("robust_gain", type(uncertain).__name__, "an UncertainModel")
    if not (np.isfinite(level) and level > 0 and tolerance > 0):
        raise InputError("robust_gain", f"level {level}, tolerance {tolerance}", "both positive, the level finite")

    # The worst-case gain grows with k: each step has a proved upper bound and a member that attains the lower one.
    nominal = worst_case_gain(UncertainModel(uncertain.nominal, []))
    if nominal.lower >= level:
        return RobustGain(0.0, 0.0, nominal.frequency, Status.CERTIFIED, level, {}, {}, None)
    distance = level / nominal.upper - 1 if nominal.upper else 1.0
    inner = INNER * tolerance * min(max(distance, CLOSE), 1.0)
    lower, upper, proof, attained = 0.0, np.inf, None, None
    size, aside = 1.0, tolerance / 3
    for step in range(STEPS):
        found = worst_case_gain(_grown(uncertain, size), tolerance=inner, seed=seed, effort=effort)
        if found.upper < level:
            lower, proof = size, found
        elif found.lower >= level:
            upper, attained = size, found
        else:  # the level is between the bounds of the gain: aim further away from it
            aside *= 2
        if upper <= lower * (1 + tolerance) or not 1 / LARGEST < lower + size < LARGEST:
            break
        if attained is None:
            size *= 4
            continue
        # 1 / gain is about linear in the size; aims on both sides of the level in turn.
        least = (proof or nominal).upper
        share = (1 / least - 1 / level) / (1 / least - 1 / attained.lower) if least else 0.5
        aim = (lower + (upper - lower) * share) * (1 + aside if step % 2 else 1 - aside)
        size = float(np.clip(aim, lower + 0.05 * (upper - lower), upper - 0.05 * (upper - lower)))
    delta: dict[str, Any] = {} if attained is None else {name: upper * v for name, v in attained.delta.items()}
    close = upper <= lower * (1 + tolerance) or (attained is None and 4 * lower > LARGEST)
    return RobustGain(
        lower, upper, attained.frequency if attained else None, Status.CERTIFIED if close else Status.INCONCLUSIVE,
        level, delta, uncertain.physical(delta) if delta else {}, proof,
    )  # fmt: skip


def _grown(uncertain: UncertainModel, size: float) -> UncertainModel:
    """Return the set ``size`` times as large: the inputs of its Delta are scaled."""
    M = uncertain.M
    by = np.where(np.arange(M.n_inputs) < uncertain.delta_shape[0], size, 1.0)
    larger = StateSpaceModel(M.A, M.B * by, M.C, M.D * by, M.dt, M.inputs, M.outputs, M.states)
    return UncertainModel(larger, uncertain.blocks)


# --- several controllers ----------------------------------------------------------------------------------------------


class Performance(NamedTuple):
    """Order, nominal gain, margin and, if requested, worst-case gain of one controller."""

    order: int
    nominal_gain: float
    margin: Margin
    gain: PeakGain | None = None

    def numbers(self) -> dict[str, Any]:
        found = {
            "order": self.order, "nominal_gain": self.nominal_gain, "mu_lower": inverse(self.margin.upper),
            "mu_upper": inverse(self.margin.lower), "frequency": self.margin.frequency,
        }  # fmt: skip
        return found if self.gain is None else found | {"gain_lower": self.gain.lower, "gain_upper": self.gain.upper}


@dataclass(frozen=True, eq=False)
class PerformanceComparison(Displayable):
    """Robust performance of one problem under several controllers, the same requirement for all."""

    controllers: Mapping[str, Performance]  # controller -> its performance

    quantities: ClassVar[Mapping[str, Any]] = {
        "controllers": {
            "*": dict.fromkeys(("order", "nominal_gain", "mu_lower", "mu_upper", "gain_lower", "gain_upper"), "1")
            | {"frequency": "rad/s"}
        }
    }

    @property
    def margins(self) -> dict[str, Margin]:
        return {name: one.margin for name, one in self.controllers.items()}

    @property
    def status(self) -> Status:
        """Least trusted status of all proofs."""
        return least_trusted([part.status for part in self._proofs().values()])

    @property
    def notes(self) -> tuple[str, ...]:
        first = (
            "μ at most 1: for every Δ of the set the weighted gain is at most 1. The worst-case gain is over that set."
        )
        return (first, *(f"{of}: {text}." for of, part in self._proofs().items() for text in part.notes))

    def _proofs(self) -> dict[str, Any]:
        found: dict[str, Any] = {}
        for name, one in self.controllers.items():
            found |= {f"{name}, μ": one.margin} | ({} if one.gain is None else {f"{name}, gain": one.gain})
        return found

    def headline(self) -> str:
        return f"robust performance under {len(self.controllers)} controllers, the same requirement for all"

    def facts(self) -> Facts:
        met = [name for name, one in self.controllers.items() if inverse(one.margin.lower) <= 1]
        return [("requirement met by every member, proved", ", ".join(met) or "by none of them")]

    def details(self) -> list[Part]:
        header = ["controller", "order", "nominal gain", "μ, attained .. proved"]
        rows = []
        for name, one in self.controllers.items():
            mu = f"{inverse(one.margin.upper):.4g} .. {inverse(one.margin.lower):.4g}"
            gain = [] if one.gain is None else [f"{one.gain.lower:.4g} .. {one.gain.upper:.4g}"]
            rows.append((name, str(one.order), f"{one.nominal_gain:.4g}", mu, *gain))
        return [Part("", (*header, "worst-case gain")[: max(map(len, rows), default=4)], rows)]

    def numbers(self) -> dict[str, Any]:
        return {"controllers": {name: one.numbers() for name, one in self.controllers.items()}}

    def to_json(self) -> dict[str, Any]:
        return {"status": self.status, **self.numbers()}


def compare_performance(
    loops: Mapping[str, tuple[UncertainModel, int]],
    *,
    gain: bool = True,
    points: int = 120,
    accuracy: float = 1e-3,
    **options: Any,
) -> PerformanceComparison:
    """Proved mu of robust performance of each loop, and its worst-case gain.

    ``loops``: controller -> the weighted loop under it, whose gain is to be at most 1, and the controller's order.
    ``points``: frequencies of the margins' curves. ``options``: ``effort``, ``time_limit``, ``seed`` of the proofs.
    """
    found: dict[str, Performance] = {}
    for name, (loop, order) in loops.items():
        if not loop.nominal.is_stable():
            raise InputError(f"controller {name!r}", "does not stabilise the problem", "a stable nominal loop")
        margin = robust_performance(
            loop, omega=frequencies(loop.M, points), accuracy=accuracy, tolerance=math.inf, **options
        )
        worst = peak_gain(loop, tolerance=0.01, **options) if gain else None
        found[name] = Performance(order, float(peak_gain(loop.nominal).upper), margin, worst)
    return PerformanceComparison(found)


def inverse(value: float) -> float:
    """One over a margin; inf for none."""
    return 1 / value if value > 0 else math.inf
