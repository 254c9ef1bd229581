"""Physical parameters of a plant: value, unit, tolerance, and where the value comes from."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal

from robustlab.errors import InputError, did_you_mean
from robustlab.uncertainty.blocks import ParameterRange, Sign

__all__ = ["Parameter", "Role", "Sign", "overridden"]

Role = Literal[
    "", "inertia", "viscous-friction", "torque-constant", "resistance", "inductance", "stiffness", "input-gain"
]
GIVEN = "given by the user"


@dataclass(frozen=True)
class Parameter:
    """One physical parameter; immutable.

    Attributes
    ----------
    name
        Symbol, for example ``"Kf"``.
    value
        Nominal value in ``unit`` (SI).
    unit
        Physical unit.
    tolerance
        Relative: the true value lies within ``value (1 - tolerance) .. value (1 + tolerance)``; 0 means taken as exact.
    source
        Where the value was published.
    meaning
        What it is, in words.
    sign
        What physics allows: a mass is ``"positive"``, a friction coefficient ``"nonnegative"``, a gain ``"any"``.
    role
        What it is to the equations of motion, where an effect may act on it: all parameters with the role ``"inertia"``
        are what an "inertia wrong" scales. Empty: no effect acts on it.

    Raises
    ------
    InputError
        NaN or infinite values, a sign that physics forbids, a tolerance that is negative or whose range leaves that
        sign.

    Examples
    --------
    >>> Parameter("Kf", 4.8e-5, "N m s", tolerance=0.35).range
    ParameterRange(nominal=4.8e-05, radius=1.68e-05, unit='N m s', below=None)
    """

    name: str
    value: float
    unit: str = ""
    tolerance: float = 0.0
    source: str = ""
    meaning: str = ""
    sign: Sign = "any"
    role: Role = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "value", _number(self.name, self.value))
        object.__setattr__(self, "tolerance", _number(f"{self.name}: tolerance", self.tolerance))
        where = f"parameter {self.name!r}"
        if self.sign == "positive" and self.value <= 0:
            raise InputError(
                where, f"{self.value:g} {self.unit}".rstrip(), f"a positive value ({self.meaning or 'by physics'})"
            )
        if self.sign == "nonnegative" and self.value < 0:
            raise InputError(
                where, f"{self.value:g} {self.unit}".rstrip(), f"no negative value ({self.meaning or 'by physics'})"
            )
        if self.tolerance < 0:
            raise InputError(
                where, f"relative tolerance {self.tolerance:g}", "0 (exact) or a positive share, 0.1 for 10 %"
            )
        if (self.sign == "positive" and self.tolerance >= 1) or (self.sign == "nonnegative" and self.tolerance > 1):
            raise InputError(
                where,
                f"relative tolerance {self.tolerance:g}",
                "less than 1: the range must keep the sign that physics asks for",
                "the tolerance is a share, not a percentage: 0.1 stands for 10 %",
            )

    @property
    def radius(self) -> float:
        """Half width of the range in the parameter's unit: ``|value| * tolerance``."""
        return abs(self.value) * self.tolerance

    @property
    def range(self) -> ParameterRange:
        """Centre and half width, as an uncertain block carries them, with the sign that physics allows."""
        return ParameterRange(self.value, self.radius, self.unit, sign=self.sign)

    def to_json(self) -> dict[str, object]:
        """All attributes as plain types."""
        return {
            "name": self.name,
            "value": self.value,
            "unit": self.unit,
            "tolerance": self.tolerance,
            "source": self.source,
            "meaning": self.meaning,
        }


def overridden(defaults: Iterable[Parameter], given: Mapping[str, Any], where: str) -> dict[str, Parameter]:
    """The default parameters with the given ones put in their places.

    Parameters
    ----------
    given
        Name -> value (the default's tolerance stays), or name -> ``(value, relative tolerance)``.
    where
        What messages call the plant.

    Raises
    ------
    InputError
        Unknown names (with the closest known one), and everything that `Parameter` refuses.

    Examples
    --------
    >>> overridden([Parameter("R", 2.07, "ohm")], {"R": (2.1, 0.05)}, "dc-motor")["R"].radius
    0.10500000000000001
    """
    known = {p.name: p for p in defaults}
    for name, value in given.items():
        if name not in known:
            names = tuple(known)
            raise InputError(
                f"{where}: {name!r}", "no such parameter", f"one of {', '.join(names)}", did_you_mean(name, names)
            )
        if isinstance(value, (tuple, list)):
            if len(value) != 2:
                raise InputError(f"{where}: {name}", f"{len(value)} entries", "a value or (value, relative tolerance)")
            nominal, tolerance = (_number(f"{where}: {name}", v) for v in value)
            if nominal == 0 and tolerance:
                raise InputError(f"{where}: {name}", "a relative tolerance of the value 0", "a value other than 0")
        else:
            nominal, tolerance = _number(f"{where}: {name}", value), known[name].tolerance
        known[name] = replace(known[name], value=nominal, tolerance=tolerance, source=GIVEN)
    return known


def _number(where: str, value: Any) -> float:
    """``value`` as a finite float; booleans, texts and complex numbers are refused."""
    shape = getattr(value, "shape", ())
    if isinstance(value, (bool, str, bytes, complex)) or shape != () or not hasattr(value, "__float__"):
        raise InputError(where, f"{value!r}", "a real number")
    number = float(value)
    if not math.isfinite(number):
        raise InputError(where, f"{number}", "a finite number")
    return number
