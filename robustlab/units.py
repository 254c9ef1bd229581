"""Units of records and numbers: their sizes, their spellings, and numbers with a unit.

The first unit of each family is the SI unit (angles in rad), in which everything is computed. (Pint 0.25 needs 0.34 s
of CPU before its first unit, these tables 1.5 ms; and it has no 1/min and Hz for rotations, and no cm2.)
"""

from __future__ import annotations

import math
import re
from typing import Any

from robustlab.errors import InputError

# Sizes of units in the first unit of each family: units of records, and units mistaken for one another.
UNIT_SIZES: tuple[dict[str, float], ...] = (
    {"rad": 1.0, "deg": math.pi / 180, "turns": 2 * math.pi, "mrad": 1e-3},
    {"rad/s": 1.0, "deg/s": math.pi / 180, "rpm": math.pi / 30, "turns/s": 2 * math.pi, "mrad/s": 1e-3},
    {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "um": 1e-6},
    {"m/s": 1.0, "mm/s": 1e-3, "cm/s": 1e-2, "m/min": 1 / 60},
    {"V": 1.0, "mV": 1e-3, "kV": 1e3},
    {"A": 1.0, "mA": 1e-3, "kA": 1e3},
    {"N": 1.0, "mN": 1e-3, "kN": 1e3, "kgf": 9.80665},
    {"N m": 1.0, "mN m": 1e-3, "N cm": 1e-2, "N mm": 1e-3, "kgf m": 9.80665},
    {"ohm": 1.0, "mohm": 1e-3, "kohm": 1e3},
    {"H": 1.0, "mH": 1e-3, "uH": 1e-6},
    {"kg": 1.0, "g": 1e-3},
    {"kg m2": 1.0, "kg cm2": 1e-4, "g cm2": 1e-7},
    {"N m/A": 1.0, "mN m/A": 1e-3},
    {"V s/rad": 1.0, "mV s/rad": 1e-3},
    {"N/m": 1.0, "N/mm": 1e3},
)
SPELLINGS = {
    "1/min": "rpm", "min-1": "rpm", "Hz": "turns/s", "°": "deg", "°/s": "deg/s", "rev": "turns", "rev/s": "turns/s",
    "Ω": "ohm", "mΩ": "mohm", "kΩ": "kohm", "µm": "um", "µH": "uH",
}  # fmt: skip
_NUMBER = re.compile(r"([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)(.*)", re.DOTALL)
_LONGEST = 100  # characters of a number with its unit


def _bare(unit: str) -> str:
    """Return a unit in one spelling of products and powers: ``N m``, ``N*m``, ``N·m`` and ``Nm`` are one unit."""
    plain = unit.replace("²", "2").replace("^2", "2").replace("μ", "µ")
    plain = SPELLINGS.get(plain.strip(), plain)
    return "".join(ch for ch in plain if ch not in " *·⋅.")


def same_unit(one: str, other: str) -> bool:
    return _bare(one) == _bare(other)


def unit_family(unit: str) -> tuple[dict[str, float], float] | None:
    """Return the family of a unit, and its size there; None if it is in no family."""
    for family in UNIT_SIZES:
        for name, size in family.items():
            if same_unit(name, unit):
                return family, size
    return None


def factor_between(unit: str, wanted: str) -> float | None:
    """Return the factor from a number in ``unit`` to ``wanted``; None if the units measure different quantities."""
    if same_unit(unit, wanted):
        return 1.0
    there, here = unit_family(wanted), unit_family(unit)
    return None if here is None or there is None or here[0] is not there[0] else here[1] / there[1]


def factor_to_si(unit: str) -> tuple[float, str]:
    """Return the factor to the SI unit of the same family, and that unit; (1, unit) if it is in no family."""
    found = unit_family(unit)
    return (1.0, unit) if found is None else (found[1], next(iter(found[0])))


def amount(where: str, given: Any, unit: str) -> Any:
    """Convert a text to a number in ``unit``; other values are returned unchanged."""
    if not isinstance(given, str):
        return given
    number, stated = _parted(where, given, f"a number in {unit}" if unit else "a number")
    factor = factor_between(stated, unit) if stated and unit else None if stated else 1.0
    if factor is None:
        expected = f"a number in {unit}" if unit else "a number without a unit: none is stated for it"
        raise InputError(where, f"{given.strip()!r}", expected)
    return number * factor


def share(where: str, given: Any) -> Any:
    """Convert a text, per cent or not, to a share; other values are returned unchanged."""
    if not isinstance(given, str):
        return given
    expected = 'a share of the value: 0.05, or "5%"'
    number, stated = _parted(where, given, expected)
    if stated not in ("", "%"):
        raise InputError(where, f"{given.strip()!r}", expected)
    return number / 100 if stated else number


def _parted(where: str, text: str, expected: str) -> tuple[float, str]:
    """Return the number and the unit of a text."""
    try:
        return float(text.replace("_", "?")), ""  # not 1_0, which Python reads as ten
    except ValueError:
        found = _NUMBER.fullmatch(text.strip()) if len(text) <= _LONGEST else None
    if found is None:
        raise InputError(where, f"{text[:_LONGEST]!r}", expected) from None
    return float(found[1]), found[2].strip()
