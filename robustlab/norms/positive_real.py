"""Passivity: the relative index as an H-infinity norm."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np

from robustlab.arrays import AnyArray
from robustlab.errors import InputError, told_as
from robustlab.linear_analysis.magnitude import refuse_overflow
from robustlab.norms.hinfinity import QUIET, HinfNorm, hinf_norm
from robustlab.result import Status
from robustlab.shown import Facts, Shown, bracket, number
from robustlab.statespace import StateSpaceModel, as_model, is_rank_deficient

__all__ = ["Passivity", "passivity"]


@dataclass(frozen=True)
class Passivity(Shown):
    r"""Whether a model is passive, and by how much.

    Attributes
    ----------
    passive
        True where ``R <= 1`` is proved, False where ``R > 1`` is attained, None where the bracket holds 1: lossless and
        strictly proper models have R = 1 exactly or reach it at infinity, and are passive to within the bracket's
        width at best.
    lower, upper
        Bracket of the relative index R.
    frequency
        Frequency in rad/s at which ``lower`` is attained.
    status
        That of the bracket.
    reason
        Why R is infinite or inaccurate; else empty.
    system
        The model, for `robustlab.verify`.
    """

    passive: bool | None
    lower: float
    upper: float
    frequency: float
    status: Status
    reason: str = ""
    system: StateSpaceModel | None = field(default=None, compare=False, repr=False)

    quantities: ClassVar[Mapping[str, Any]] = {"lower": "1", "upper": "1", "frequency": "rad/s", "passive": bool}

    def headline(self) -> str:
        words = {True: "passive", False: "not passive", None: "on the boundary of passivity, or not decided"}
        return words[self.passive]

    def facts(self) -> Facts:
        words = {True: "yes", False: "no", None: f"to within {number(self.upper - 1)} of the relative index"}
        return [
            ("passive", words[self.passive]),
            ("relative index", bracket(self.lower, self.upper, ("attained", "proved"))),
            ("at", number(self.frequency, "rad/s")),
            ("reason", self.reason),
        ]

    def to_json(self) -> dict[str, object]:
        return {name: value for name, value in vars(self).items() if name != "system"}


@told_as("passivity")
def passivity(model: Any, rtol: float = 1e-6) -> Passivity:
    r"""Relative passivity index R of a model, as a proved bracket.

    .. math:: R = \|(I - G)(I + G)^{-1}\|_\infty, \qquad G \text{ passive} \Leftrightarrow R \le 1

    R < 1: the model stays passive in spite of a shortage elsewhere; R > 1: it lacks passivity by that factor. Poles on
    the imaginary axis are allowed, as of integrators.

    Parameters
    ----------
    model
        Square model, input k belonging to output k (force and speed, for example); continuous or discrete.
    rtol
        Relative width of the bracket.

    Returns
    -------
    Passivity
        R is infinite where ``(I + G)^-1`` is unstable or not proper, and where G has hidden modes that are not stable.

    Raises
    ------
    InputError
        A model that is not square or has no inputs, or an ``rtol`` that is not between 1e-12 and 1.
    NoTrustworthyNumber
        Products of the model's entries overflow.

    References
    ----------
    Desoer, Vidyasagar, *Feedback Systems: Input-Output Properties* (1975), chapter VI.

    Examples
    --------
    >>> damper = StateSpaceModel([[-1.0]], [[1.0]], [[1.0]], [[1.0]])  # 1 + 1 / (s + 1)
    >>> found = passivity(damper)
    >>> found.passive, round(found.lower, 6)
    (True, 0.333333)
    """
    g = as_model(model, "passivity")
    if g.n_inputs != g.n_outputs or not g.n_inputs:
        raise InputError("passivity", f"{g.n_outputs} outputs, {g.n_inputs} inputs", "a square model")
    if not 1e-12 <= rtol < 1:
        raise InputError("passivity", f"rtol is {rtol}", "between 1e-12 and 1")
    one = np.eye(g.n_inputs)
    if is_rank_deficient(one + g.D):
        text = "I + D is singular: some v has v^T (D + D^T) v < 0"
        relative = HinfNorm(np.inf, np.inf, np.inf, Status.CERTIFIED, text)
    else:
        relative = hinf_norm(_reflection(g, one), rtol)
    return Passivity(
        _verdict(relative), relative.lower, relative.upper, relative.frequency, relative.status, relative.reason, g
    )


def _verdict(relative: HinfNorm) -> bool | None:
    """What the bracket of R says; a lower end is known to the rounding that a norm does not tell."""
    if relative.status is not Status.CERTIFIED:
        return None
    if relative.upper <= 1:
        return True
    return False if relative.lower > 1 + QUIET else None


def _reflection(g: StateSpaceModel, one: AnyArray) -> StateSpaceModel:
    """``(I - G)(I + G)^-1 = 2 (I + G)^-1 - I``, with the states of G."""
    e = np.linalg.inv(one + g.D)
    with np.errstate(over="ignore", invalid="ignore"):
        A, B, C, D = g.A - g.B @ e @ g.C, g.B @ e, -2 * e @ g.C, 2 * e - one
    refuse_overflow("passivity", A, B, C, D)
    return StateSpaceModel(A, B, C, D, g.dt, where="passivity")
