"""Block types of an uncertain model that are not constant: time-varying parameters and nonlinearities."""

from __future__ import annotations

import math
from dataclasses import dataclass
from numbers import Real
from typing import Any

from robustlab.checks import number
from robustlab.errors import InputError


@dataclass(frozen=True)
class Varying:
    r"""A block that varies with time, with a bounded rate or arbitrarily fast.

    .. math:: |\delta(t)| \le 1, \qquad |\dot\delta(t)| \le \rho

    Attributes
    ----------
    rate
        Bound of the rate of change, in the parameter's unit per second; of delta per second where the block has no
        parameter. inf: no bound, the value may jump. Other blocks than real parameters take inf only: an operator of
        gain one that varies with time.
    holds
        The motions for which the range holds, in words; empty: all.

    Raises
    ------
    InputError
        A rate that is not positive.

    Examples
    --------
    >>> Varying(0.5), Varying()
    (Varying(rate=0.5, holds=''), Varying(rate=inf, holds=''))
    """

    rate: float = math.inf
    holds: str = ""

    def __post_init__(self) -> None:
        if isinstance(self.rate, bool) or not isinstance(self.rate, Real) or not self.rate > 0:
            found, hint = f"a rate of {self.rate!r}", "leave a constant parameter out"
            raise InputError("Varying", found, "a positive number, or inf", hint)


@dataclass(frozen=True)
class Nonlinearity:
    r"""A memoryless nonlinearity :math:`w = \varphi(z)` of one signal, with :math:`\varphi(0) = 0`.

    .. math:: a \le \frac{\varphi(z)}{z} \le b, \qquad m \le \frac{\varphi(z_1) - \varphi(z_2)}{z_1 - z_2} \le k

    Attributes
    ----------
    sector
        a and b, finite, a < b. A slope is intersected with it: phi(z) / z is the slope of a chord, too.
    slope
        m and k, finite; None where the slope has no bound. m < b and k > a.
    odd
        Whether :math:`\varphi(-z) = -\varphi(z)`: it admits more multipliers.
    steady
        Whether the law is constant over time. Of a time-varying one only the sector is used.
    holds
        The motions for which the sector holds, in words; empty: all.

    Raises
    ------
    InputError
        Ends that are not finite or not in order; a slope that no law of that sector has.

    Examples
    --------
    >>> Nonlinearity.saturation()
    Nonlinearity(sector=(0.0, 1.0), slope=(0.0, 1.0), odd=True, steady=True, holds='')
    """

    sector: tuple[float, float]
    slope: tuple[float, float] | None = None
    odd: bool = False
    steady: bool = True
    holds: str = ""

    def __post_init__(self) -> None:
        for name, ends in (("sector", self.sector), ("slope", self.slope)):
            if ends is None:
                continue
            if not _is_range(ends):
                hint = "an infinite end has no strict inequality: friction takes a stick_speed"
                expected = "two finite numbers, the smaller one first"
                raise InputError(f"Nonlinearity: {name}", f"{ends}", expected, hint if name == "sector" else None)
        if self.slope is not None:
            # The middle of the sector must be a law of the class, as the start of the proof's homotopy.
            both = max(self.sector[0], self.slope[0]), min(self.sector[1], self.slope[1])
            if not both[0] < both[1]:
                raise InputError("Nonlinearity: slope", f"{self.slope}", f"one that meets the sector {self.sector}")
            object.__setattr__(self, "sector", both)

    @classmethod
    def saturation(cls) -> Nonlinearity:
        r"""Saturation :math:`\max(-L, \min(L, z))` of any limit L: odd, slope and sector [0, 1]."""
        return cls((0.0, 1.0), (0.0, 1.0), odd=True)

    dead_zone = saturation  # z - max(-d, min(d, z)) of any d is of the same class

    @classmethod
    def friction(cls, level: float, stick_speed: float | None = None) -> Nonlinearity:
        r"""Dry friction :math:`F \max(-1, \min(1, v / v_s))`: odd, monotone, slope and sector [0, F / v_s].

        Coulomb's law, :math:`F \operatorname{sgn} v`, is rejected: a joint may stick away from zero with a constant
        force, and then no gain to the position is finite.

        ``level``: F. ``stick_speed``: v_s, below which the force grows in proportion to the speed.
        """
        if stick_speed is None:
            raise InputError(
                "Nonlinearity.friction", "no stick_speed", "the speed up to which the force grows in proportion",
                "Coulomb's law has the sector [0, inf): its slope at rest has no bound, and no strict inequality holds",
            )  # fmt: skip
        force = number("Nonlinearity: level", level, "a positive finite number", above=0)
        gain = force / number("Nonlinearity: stick_speed", stick_speed, "a positive finite number", above=0)
        return cls((0.0, gain), (0.0, gain), odd=True, holds=f"sticking as creep below {stick_speed:g}")


BlockType = Varying | Nonlinearity


def _is_range(ends: Any) -> bool:
    return (
        isinstance(ends, (tuple, list)) and len(ends) == 2
        and all(isinstance(e, Real) and not isinstance(e, bool) and math.isfinite(e) for e in ends)
        and ends[0] < ends[1]
    )  # fmt: skip
