"""Checks of arguments: a number of a range, a whole number, one of a few words; each returns the value in its type."""

from __future__ import annotations

from collections.abc import Iterable
from math import inf, isfinite
from operator import index
from typing import Any

from robustlab.errors import InputError, did_you_mean


def number(
    where: str,
    value: Any,
    expected: str = "",
    hint: str | None = None,
    *,
    above: float = -inf,
    at_least: float = -inf,
    below: float = inf,
    at_most: float = inf,
) -> float:
    """Return a finite real number with ``above < value < below`` and ``at_least <= value <= at_most`` as a float."""
    try:
        real = inf if isinstance(value, (bool, str, bytes)) or getattr(value, "ndim", 0) else float(value)
    except (TypeError, ValueError, OverflowError):
        real = inf
    if isfinite(real) and above < real < below and at_least <= real <= at_most:
        return real
    raise InputError(where, repr(value), expected or _range(above, at_least, below, at_most), hint)


def whole(where: str, value: Any, at_least: float = 0, at_most: float = inf, hint: str | None = None) -> int:
    """Return a whole number from ``at_least`` to ``at_most`` as an int; True and 2.0 are refused."""
    try:
        count = None if isinstance(value, bool) else index(value)
    except TypeError:
        count = None
    if count is not None and at_least <= count <= at_most:
        return count
    many = f"from {at_least} to {at_most}" if at_most < inf else f"of at least {at_least}"
    raise InputError(where, repr(value), "a whole number" if at_least == -inf else f"a whole number {many}", hint)


def choice(where: str, value: Any, words: Iterable[str], hint: str | None = None) -> str:
    """Return one of the words; the hint of an error is the closest one."""
    known = tuple(words)
    if isinstance(value, str) and value in known:
        return value
    raise InputError(where, repr(value), f"one of {', '.join(known) or 'none'}", hint or did_you_mean(value, known))


def _range(above: float, at_least: float, below: float, at_most: float) -> str:
    least, most = max(above, at_least), min(below, at_most)
    if least == -inf:
        return "a finite number" if most == inf else f"a number {'below' if below <= at_most else 'up to'} {most:g}"
    if most < inf:
        start, end = ("between", "and") if above >= at_least else ("from", "to")
        return f"a number {start} {least:g} {end} {most:g}"
    if least == 0:
        return "a positive number" if above >= at_least else "a number of 0 or more"
    return f"a number {'above' if above >= at_least else 'of at least'} {least:g}"
