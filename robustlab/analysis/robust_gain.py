"""Largest size of a set for which every member's gain is below a level."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from robustlab.display import Facts, Part, bracket, member, number
from robustlab.errors import InputError, error_context
from robustlab.mu_analysis import WorstCaseGain, worst_case_gain
from robustlab.mu_analysis.axis.margin import delta_rows
from robustlab.result import Bracket, Status
from robustlab.statespace import StateSpaceModel
from robustlab.uncertainty.lft import UncertainModel

LARGEST = 2.0**20  # largest size of the set that is tried, relative to the given one
CLOSE = 1e-3  # a level nearer than this to the nominal gain, relative, needs no closer proof
STEPS = 20  # worst-case gains at most; 1 % takes about 5
INNER = 0.25  # each of them is proved to this share of the tolerance, less where the level is next to the nominal gain


@dataclass(frozen=True, eq=False)
class RobustGain(Bracket):
    """Largest size of a set for which every member's gain is below ``level``.

    Attributes
    ----------
    lower, upper, frequency
        Every member of the set ``lower`` times as large has a gain below ``level``, proved; the member ``delta`` of the
        set ``upper`` times as large reaches it at ``frequency``, rad/s. Both are 0 where the nominal model reaches it;
        ``upper`` is inf where no member of the largest set does. Above 1 the set as given stays below the level.
    level
        In the unit of the outputs over that of the inputs.
    delta, physical
        That member, in units of the set as given, and its physical parameters with units.
    proof
        The worst-case gain of the set ``lower`` times as large; None where ``lower`` is 0.
    status
        CERTIFIED where the bounds are as close as requested; else INCONCLUSIVE.
    """

    level: float
    delta: Mapping[str, Any]
    physical: Mapping[str, tuple[float, str]]
    proof: WorstCaseGain | None

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

    def details(self) -> list[Part]:
        rows = delta_rows(self.delta, self.physical)
        return [Part("member that reaches it:", ("block", "delta", "parameter"), rows)]


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
    level
        :math:`\gamma`, positive, in the unit of the outputs over that of the inputs.
    tolerance
        Target of the relative gap between the bounds.
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

    References
    ----------
    Packard, Balas, Liu, Shin, "Results on worst-case performance assessment", ACC 2000.

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
