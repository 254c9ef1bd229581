"""Claims, their verdicts, and the checked reading of a claim's numbers.

All matrices are exact binary numbers, so an integer in place of a real number is rejected (its conversion could round),
and so is any precision but double.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robustlab.errors import InputError, NoTrustworthyNumber


class Outcome(Enum):
    """Outcome of a check; ``NOT_PROVED`` leaves open whether the claim is true."""

    PROVED = "proved"
    NOT_PROVED = "not proved"
    REFUTED = "refuted"


@dataclass(frozen=True)
class Claim:
    """A statement with its evidence: its kind, and its datasets by name (float64, complex128, int64)."""

    kind: str
    numbers: Mapping[str, NDArray[Any]]


@dataclass(frozen=True)
class Verification:
    """The result of checking a claim."""

    claim: str  # the claim in words, with its number
    outcome: Outcome
    bound: float | None  # the proved number, rounded outwards; None where the claim has none
    where: str  # not proved: the failed step and its margin; refuted: the counterexample; proved: ""
    boxes: int  # tests of definiteness, boxes of frequency among them


@dataclass(frozen=True)
class Verdict:
    """The result of one attempt in one precision."""

    outcome: Outcome
    where: str = ""
    at: float | None = None  # not proved: the frequency in rad/s at which a form failed

    @property
    def proved(self) -> bool:
        return self.outcome is Outcome.PROVED


PROVED = Verdict(Outcome.PROVED)


def not_proved(where: str, at: float | None = None) -> Verdict:
    return Verdict(Outcome.NOT_PROVED, where, at)


def refuted(where: str) -> Verdict:
    return Verdict(Outcome.REFUTED, where)


class Blurred(ArithmeticError):
    """The balls have become so wide that more bits are needed."""


class Work:
    """Counts tests, and ends the check at the limit ``effort``, the same on every machine.

    One unit is a test of a matrix of 20 rows (some milliseconds); the cost grows with the cube of the rows.
    """

    def __init__(self, effort: int) -> None:
        self.left = float(effort)
        self.boxes = 0

    def spend(self, size: int) -> None:
        """Count one test of matrices with ``size`` rows; NoTrustworthyNumber beyond the limit."""
        self.left -= max(1.0, (size / 20) ** 3)
        if self.left < 0:
            raise NoTrustworthyNumber("effort", f"spent after {self.boxes} tests", "a claim that takes less")
        self.boxes += 1


def real(claim: Claim, name: str, shape: tuple[int | None, ...], *, infinite: bool = False) -> NDArray[np.float64]:
    """Return the float64 dataset of this shape (None: any length), finite except +inf where ``infinite`` allows it."""
    values = _values(claim, name, shape, (np.float64,))
    if not (np.isfinite(values) | (infinite & np.isposinf(values))).all():
        raise InputError(name, "NaN or infinity", "finite numbers")
    return values


def complex_or_real(claim: Claim, name: str, shape: tuple[int | None, ...]) -> NDArray[Any]:
    """Return the float64 or complex128 dataset of this shape, finite; real where all imaginary parts are zero."""
    values: Any = _values(claim, name, shape, (np.float64, np.complex128))
    if not np.isfinite(values).all():
        raise InputError(name, "NaN or infinity", "finite numbers")
    return values if values.imag.any() else np.ascontiguousarray(values.real).reshape(values.shape)


def whole(claim: Claim, name: str, shape: tuple[int | None, ...]) -> NDArray[np.int64]:
    """Return the int64 dataset of this shape."""
    return _values(claim, name, shape, (np.int64,))


def scalar(claim: Claim, name: str, *, zero: bool = False) -> float:
    """Return the positive number (``zero``: not negative)."""
    value = float(real(claim, name, ()))
    if value < 0 or (value == 0 and not zero):
        raise InputError(name, f"{value}", "a number not below zero" if zero else "a number above zero")
    return value


def symmetric(claim: Claim, name: str, n: int) -> NDArray[np.float64]:
    """Return the real matrix (n, n), symmetric to the last bit."""
    P = real(claim, name, (n, n))
    if not (P == P.T).all():
        raise InputError(name, "not symmetric to the last bit", "a symmetric matrix")
    return P


def _values(claim: Claim, name: str, shape: tuple[int | None, ...], types: tuple[type, ...]) -> NDArray[Any]:
    if name not in claim.numbers:
        raise InputError(name, "missing", "a dataset")
    try:
        values = np.array(claim.numbers[name])  # a copy, safe from changes by the caller
    except (ValueError, TypeError):
        raise InputError(name, "no array", "a dataset") from None
    if not any(values.dtype == kind for kind in types):
        raise InputError(name, f"type {values.dtype}", " or ".join(np.dtype(kind).name for kind in types))
    fits = values.ndim == len(shape) and all(s in (None, v) for s, v in zip(shape, values.shape, strict=True))
    if not fits:
        wanted = "(" + ", ".join("any" if s is None else str(s) for s in shape) + ")"
        raise InputError(name, f"shape {values.shape}", f"shape {wanted}")
    return values
