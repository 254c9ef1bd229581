"""Physical parameters of a plant: value, unit, tolerance and source."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any, Literal

from robustlab.errors import InputError, unknown_name
from robustlab.uncertainty.blocks import ParameterRange, Sign
from robustlab.units import amount, share

Role = Literal[
    "", "inertia", "viscous-friction", "torque-constant", "resistance", "inductance", "stiffness", "input-gain",
    "centre-of-mass", "gravity-direction",
]  # fmt: skip
GIVEN = "given by the user"


@dataclass(frozen=True)
class Parameter:
    """One physical parameter; immutable."""

    name: str  # symbol, for example "Kf"
    value: float  # nominal, in ``unit`` (SI)
    unit: str = ""
    # Relative: the true value is within ``value (1 - tolerance) .. value (1 + tolerance)``; 0: exact. Absolute in
    # ``unit`` for a value of 0.
    tolerance: float = 0.0
    source: str = ""  # where the value was published
    meaning: str = ""
    # Physical sign: a mass is "positive", a friction coefficient "nonnegative", a coordinate "any". "either": a torque
    # constant is positive or negative as the machine is wired, and its range excludes zero.
    sign: Sign = "any"
    # Effect that may act on it: a misjudged "inertia" scales all parameters of this role. Empty: none.
    role: Role = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "value", _number(self.name, self.value))
        object.__setattr__(self, "tolerance", _number(f"{self.name}: tolerance", self.tolerance))
        where, found = f"parameter {self.name!r}", f"{self.value:g} {self.unit}".rstrip()
        why = self.meaning or "by physics"
        if self.sign == "positive" and self.value <= 0:
            raise InputError(where, found, f"a positive value ({why})")
        if self.sign == "nonnegative" and self.value < 0:
            raise InputError(where, found, f"no negative value ({why})")
        if self.tolerance < 0:
            expected = "0 (exact) or a positive share, 0.1 for 10 %"
            raise InputError(where, f"relative tolerance {self.tolerance:g}", expected)
        limited = self.sign in ("positive", "either")
        if limited and self.tolerance and not self.value:
            raise InputError(where, "a tolerance of the value 0", "a value other than 0: its range must hold no zero")
        if self.value and ((limited and self.tolerance >= 1) or (self.sign == "nonnegative" and self.tolerance > 1)):
            ends = f"a range from {self.value - self.radius:g} to {self.value + self.radius:g} {self.unit}".rstrip()
            hint = f"did you mean {self.tolerance:g}% = {self.tolerance / 100:g}?"
            expected = "less than 1: the parameter must not change its sign"
            raise InputError(where, f"relative tolerance {self.tolerance:g}, {ends}", expected, hint)

    @property
    def reference(self) -> float:
        """Reference of tolerances and factors: the value, or one unit where that is 0."""
        return self.value or 1.0

    @property
    def radius(self) -> float:
        """Half width of the range in the parameter's unit."""
        return abs(self.reference) * self.tolerance

    @property
    def tolerance_text(self) -> str:
        return f"{100 * self.tolerance:g} %" if self.value else f"{self.tolerance:g} {self.unit}".rstrip()

    @property
    def range(self) -> ParameterRange:
        return ParameterRange(self.value, self.radius, self.unit, sign=self.sign)

    def to_json(self) -> dict[str, object]:
        return {key: getattr(self, key) for key in ("name", "value", "unit", "tolerance", "source", "meaning")}


@cache
def published(file: Path) -> dict[str, tuple[Parameter, ...]]:
    """Read parameters from a TOML table: part -> parameters."""
    table = tomllib.loads(file.read_text(encoding="utf-8"))
    return {part: tuple(Parameter(name, **given) for name, given in rows.items()) for part, rows in table.items()}


def overridden(defaults: Iterable[Parameter], given: Mapping[str, Any], where: str) -> dict[str, Parameter]:
    """Return the default parameters, overridden by the given ones."""
    known = {p.name: p for p in defaults}
    for name, value in given.items():
        if name not in known:
            raise unknown_name(f"{where}: {name!r}", "no such parameter", name, known)
        place, unit = f"{where}: {name}", known[name].unit
        if isinstance(value, (tuple, list)):
            if len(value) != 2:
                raise InputError(place, f"{len(value)} entries", "a value or (value, relative tolerance)")
            nominal = _number(place, amount(place, value[0], unit))
            tolerance = tolerance_of(place, value[1], nominal, unit)
        else:
            nominal = _number(place, amount(place, value, unit))
            # A relative tolerance is not valid as an absolute one.
            tolerance = known[name].tolerance if bool(nominal) == bool(known[name].value) else 0.0
        known[name] = replace(known[name], value=nominal, tolerance=tolerance, source=GIVEN)
    return known


def parameter_ranges(
    parameters: Mapping[str, Parameter], given: Mapping[str, Any], where: str, exact: Collection[str] = ()
) -> dict[str, ParameterRange]:
    """Return the range of every parameter that has one: as given, or from its tolerance."""
    known = tuple(parameters)
    for name in given:
        place = f"{where}: uncertain: {name!r}"
        if name not in known:
            raise unknown_name(place, "no such parameter", name, known)
        if name in exact:
            raise InputError(place, "a range", "none: it is taken as exact")
    ranges: dict[str, ParameterRange] = {}
    for name, p in parameters.items():
        if name in given:
            if len(given[name]) != 2:
                raise InputError(f"{where}: uncertain: {name!r}", f"{given[name]!r}", "(low, high)")
            low, high = (amount(f"{where}: uncertain: {name!r}", end, p.unit) for end in given[name])
            for end in (low, high):  # of the physical sign
                replace(p, value=end, tolerance=0.0)
            if p.sign == "either" and low <= 0 <= high:
                found = f"a range from {low:g} to {high:g} {p.unit}".rstrip()
                expected = f"one that does not hold 0 ({p.meaning or 'by physics'})"
                raise InputError(f"parameter {name!r}", found, expected)
            ranges[name] = replace(ParameterRange.between(low, high, p.value, p.unit), sign=p.sign)
        elif p.radius:
            ranges[name] = p.range
    return ranges


def tolerance_of(where: str, given: Any, nominal: float, unit: str) -> float:
    """Return a tolerance as stored in `Parameter`: relative, for the value 0 absolute in ``unit``."""
    text = given.strip().removeprefix("+-").removeprefix("±").strip() if isinstance(given, str) else given
    try:
        tolerance = _number(where, share(where, text))
    except InputError as no_share:
        try:
            return _number(where, amount(where, text, unit)) / abs(nominal or 1.0)
        except InputError:
            raise no_share from None
    if nominal == 0 and tolerance and isinstance(text, str) and text.endswith("%"):
        found = f"{text} of the value 0, which leaves it no room to move"
        raise InputError(where, found, f"an absolute tolerance: a number in {unit or 'its unit'}, 0 to hold it")
    return tolerance


def _number(where: str, value: Any) -> float:
    """Return ``value`` as a finite float; reject booleans, texts and complex numbers."""
    shape = getattr(value, "shape", ())
    if isinstance(value, (bool, str, bytes, complex)) or shape != () or not hasattr(value, "__float__"):
        raise InputError(where, f"{value!r}", "a real number")
    number = float(value)
    if not math.isfinite(number):
        raise InputError(where, f"{number}", "a finite number")
    return number
