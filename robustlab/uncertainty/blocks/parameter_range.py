"""What a normalised real delta means in the user's own parameter."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal, get_args

import numpy as np

from robustlab.errors import InputError

Sign = Literal["any", "either", "nonnegative", "positive"]


@dataclass(frozen=True)
class ParameterRange:
    r"""What a normalised real delta in [-1, 1] means in the user's parameter; 0 is nominal, +1 and -1 are the ends.

    .. math:: value = nominal + radius \, \delta \quad (\delta \ge 0), \qquad
              value = nominal + below \, \delta \quad (\delta < 0)

    Attributes
    ----------
    nominal, radius
        Nominal value and width of the range above it, in ``unit``.
    unit
        Physical unit of the parameter.
    below
        Width of the range beneath the nominal value; None where it is the same (a width given equal to ``radius``
        becomes None).
    sign
        What physics allows beyond the range too: a mass is ``"positive"``, a friction ``"nonnegative"``, a torque
        constant ``"either"``, but never zero and never both in one machine. It limits nothing; results that name a
        value outside say so (`impossible`). Ranges that differ in nothing else are equal.

    Raises
    ------
    InputError
        ``below`` is given, and it or ``radius`` is not a positive finite number; an unknown ``sign``.

    Examples
    --------
    >>> lag = ParameterRange(1.0, 0.5, "s", below=0.25)
    >>> lag.value(1.0), lag.value(-1.0), lag.delta(0.875)
    (1.5, 0.75, -0.5)
    """

    nominal: float
    radius: float
    unit: str = ""
    below: float | None = None
    sign: Sign = field(default="any", repr=False, compare=False, kw_only=True)

    def __post_init__(self) -> None:
        if self.sign not in get_args(Sign):
            raise InputError("ParameterRange: sign", f"{self.sign!r}", f"one of {', '.join(get_args(Sign))}")
        if self.below is None:
            return
        for word, width in (("above (radius)", self.radius), ("below", self.below)):
            if isinstance(width, bool) or not isinstance(width, (int, float, np.number)) or not 0 < width < np.inf:
                raise InputError(
                    "ParameterRange",
                    f"width {width!r} {word} the nominal value" if word == "below" else f"width {width!r} {word}",
                    "a positive finite number",
                    "a range that ends at its nominal value needs another nominal value, inside of it",
                )
        if not 0 < self.below / self.radius < np.inf:
            raise InputError("ParameterRange", f"widths {self.radius} above and {self.below} below", "a finite ratio")
        if self.below == self.radius:
            object.__setattr__(self, "below", None)

    @classmethod
    def between(cls, low: float, high: float, nominal: float | None = None, unit: str = "") -> ParameterRange:
        """The range from ``low`` to ``high`` around ``nominal``, which is the middle where left out.

        Raises
        ------
        InputError
            Not ``low < nominal < high``, or numbers that are not finite.

        Examples
        --------
        >>> ParameterRange.between(0.75, 1.5, 1.0)
        ParameterRange(nominal=1.0, radius=0.5, unit='', below=0.25)
        """
        middle = 0.5 * (low + high) if nominal is None else nominal
        if not (np.isfinite([low, middle, high]).all() and low < middle < high):
            raise InputError("ParameterRange", f"{low} .. {high} around {middle}", "finite low < nominal < high")
        if nominal is None:
            return cls(middle, 0.5 * (high - low), unit)
        return cls(middle, high - middle, unit, middle - low)

    @property
    def ratio(self) -> float:
        """Width below divided by width above: what a negative delta is multiplied with to give the entry of Delta."""
        return 1.0 if self.below is None else self.below / self.radius

    @property
    def low(self) -> float:
        """The value at delta = -1."""
        return self.value(-1.0)

    @property
    def high(self) -> float:
        """The value at delta = +1."""
        return self.value(1.0)

    def value(self, delta: float) -> float:
        """Parameter value that belongs to a normalised delta."""
        width = self.radius if self.below is None or delta >= 0 else self.below
        return self.nominal + width * delta

    def delta(self, value: float) -> float:
        """Normalised delta that belongs to a parameter value."""
        width = self.radius if self.below is None or value >= self.nominal else self.below
        return (value - self.nominal) / width

    def impossible(self, value: float) -> str:
        """What physics asks of the parameter that this value does not meet; empty where it may exist.

        Examples
        --------
        >>> ParameterRange(4.8e-05, 1.68e-05, "N m s", sign="nonnegative").impossible(-1e-4)
        'it is never negative'
        """
        if self.sign == "positive" and value <= 0:
            return "it is always positive"
        if self.sign == "either" and value * self.nominal <= 0:
            return "it never changes its sign"
        return "it is never negative" if self.sign == "nonnegative" and value < 0 else ""

    def to_json(self) -> dict[str, object]:
        """The attributes; ``below`` only where it differs from ``radius``, ``sign`` only where there is one."""
        data: dict[str, object] = {"nominal": self.nominal, "radius": self.radius, "unit": self.unit}
        if self.below is not None:
            data["below"] = self.below
        return data if self.sign == "any" else {**data, "sign": self.sign}
