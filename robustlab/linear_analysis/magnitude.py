r"""The door for models whose entries are too large or too small to be multiplied: scaling by powers of two.

.. math:: G'(s) = 2^g \, G(2^k s): \quad A' = 2^{-k} T^{-1} A T, \quad B' C' \text{ of order one}, \quad D' = 2^g D

A square of 1e200 overflows and one of 1e-200 vanishes, though the answer may be an ordinary number. Everything here
works on exponents, so nothing overflows on the way, and powers of two cost no digit. Models of ordinary entries pass
as they are.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from robustlab.arrays import AnyArray
from robustlab.errors import NoTrustworthyNumber
from robustlab.statespace import StateSpaceModel

# A matrix is ordinary where its largest entry lies between these: products of several neither overflow nor vanish.
# Single entries may be smaller, as long as their squares do not vanish.
SMALLEST, LARGEST = 2.0**-166, 2.0**166
LEAST = 2.0**-500
SWEEPS = 20
# Dynamics this many powers of two below the direct term are nothing beside it, and need not be smaller still.
NOTHING = 300
TINY = float(np.finfo(float).tiny)


def is_moderate(*matrices: AnyArray) -> bool:
    """Whether every matrix is of an ordinary size, or zero."""
    for matrix in matrices:
        size = np.abs(matrix[matrix != 0])
        if size.size and not (SMALLEST <= size.max() <= LARGEST and size.min() >= LEAST):
            return False
    return True


def balancing_factors(matrix: AnyArray) -> AnyArray:
    """Powers of two t, shape (n,): rows and columns of ``matrix / t[:, None] * t`` are alike in size (LAPACK gebal)."""
    from scipy.linalg import lapack

    if not matrix.size:
        return np.ones(len(matrix))
    if not np.isfinite(matrix).all():
        raise ValueError("a matrix to be balanced has entries that are NaN or infinite")
    balance: Any = getattr(lapack, "zgebal" if np.iscomplexobj(matrix) else "dgebal")
    return np.asarray(balance(matrix, scale=1, permute=0)[3])


def balancing_exponents(A: AnyArray, into: AnyArray, out: AnyArray) -> AnyArray:
    """Exponents t of states ``x = 2^t x'`` that balance rows of [A, into] against columns of [A; out], shape (n,).

    ``into`` (n, m) and ``out`` (p, n) count as if their largest entries were as large as A's.

    References
    ----------
    Osborne 1960, with the largest entry as the norm, so that exponents are enough.
    """
    n = len(A)
    a, b, c = _exponents(A), _exponents(into).max(1, initial=-np.inf), _exponents(out).max(0, initial=-np.inf)
    off, t = np.where(np.eye(n, dtype=bool), -np.inf, a), np.zeros(n)
    for _ in range(SWEEPS):
        k, w, z = _top(a - t[:, None] + t), _top(b - t), _top(c + t)
        settled = True
        for i in range(n):
            row = max((off[i] + t).max() - t[i] - k, b[i] - t[i] - w)
            column = max((off[:, i] - t).max() + t[i] - k, c[i] + t[i] - z)
            if row == -np.inf and column == -np.inf:
                continue
            step = row if column == -np.inf else -column if row == -np.inf else 0.5 * (row - column)
            step = float(np.round(step))
            t[i] += step
            settled &= abs(step) <= 1
        if settled:
            break
    return t.astype(int)


def equilibrating_exponents(matrix: AnyArray) -> tuple[AnyArray, AnyArray]:
    """Exponents r, c of rows and columns: the largest entries of rows and columns of ``2^r matrix 2^c`` are near 1.

    References
    ----------
    Ruiz, "A scaling algorithm to equilibrate both rows and columns norms in matrices" (2001).
    """
    e, r, c = _exponents(np.abs(matrix)), np.zeros((len(matrix), 1)), np.zeros(matrix.shape[1])
    for _ in range(SWEEPS):
        now = e + r + c
        row, column = now.max(axis=1, initial=-np.inf, keepdims=True), now.max(axis=0, initial=-np.inf)
        r, c = r - 0.5 * np.where(np.isfinite(row), row, 0), c - 0.5 * np.where(np.isfinite(column), column, 0)
    return np.round(r[:, 0]).astype(int), np.round(c).astype(int)


@dataclass(frozen=True, eq=False)
class Moderated:
    """A model of ordinary entries and what leads back from it."""

    # `G'(s) = 2^gain G(2^rate s)`; a discrete model keeps its steps, and its sample time is `2^rate` times.
    model: StateSpaceModel
    # rate, gain: exponents; both 0 for a model that was ordinary as given
    rate: int
    gain: int
    states: AnyArray  # exponents of the states, `x = 2^states x'`, shape (n_x,)

    def value(self, size: float, where: str, rate_power: float = 0.0) -> float:
        """``size * 2^-gain * 2^(rate * rate_power)``: a norm of the model as given."""
        return scaled_down(size, self.gain - self.rate * rate_power, where)

    def as_given(self, model: StateSpaceModel, where: str) -> StateSpaceModel:
        """The model ``2^-gain M(2^-rate s)`` that belongs to one of ordinary entries, M."""
        if not (self.rate or self.gain):
            return model
        rate = 0 if model.is_discrete else self.rate
        into = (rate - self.gain) // 2
        parts = (model.A, model.B, model.C, model.D)
        shifts = (rate, into, rate - self.gain - into, -self.gain)
        a, b, c, d = (times_power(m, e) for m, e in zip(parts, shifts, strict=True))
        refuse_overflow(where, a, b, c, d)
        dt = float(np.ldexp(model.dt, -self.rate))
        return StateSpaceModel(a, b, c, d, dt, model.inputs, model.outputs, model.states, where=where)

    def frequency(self, omega: float) -> float:
        """Frequency in rad/s of the model as given; 0 or inf where no floating-point number is."""
        with np.errstate(over="ignore", under="ignore"):
            return float(np.ldexp(omega, self.rate)) if self.rate else omega


def moderated(model: StateSpaceModel, where: str) -> Moderated:
    """The model with ordinary entries, none above order one; as it is where they are ordinary already."""
    m = model
    plain_dt = not m.is_discrete or SMALLEST <= m.dt <= LARGEST
    if plain_dt and is_moderate(m.A, m.B, m.C, m.D):
        return Moderated(m, 0, 0, np.zeros(m.n_states, dtype=int))
    t = balancing_exponents(m.A, m.B, m.C)
    k = 0 if m.is_discrete else _top(_exponents(m.A) - t[:, None] + t)
    w, z = -_top(_exponents(m.B) - t[:, None]), -_top(_exponents(m.C) + t)
    direct = _top(_exponents(m.D)) if m.D.any() else None
    gain = k + w + z if m.B.any() and m.C.any() else -(direct or 0)
    if direct is not None and direct + gain > 0:  # the direct term is the larger part
        less = min(direct + gain, NOTHING)
        w, z, gain = w - less // 2, z - (less - less // 2), -direct
    a = times_power(m.A, -t[:, None] + t - k)
    # An entry that vanishes beside the others keeps its sign, which a pole at 0 would not have.
    a = np.where((a == 0) & (m.A != 0), np.copysign(TINY, m.A), a)
    rate = k if not m.is_discrete or plain_dt else -int(np.frexp(m.dt)[1])
    b, c, d = times_power(m.B, -t[:, None] + w), times_power(m.C, t + z), times_power(m.D, gain)
    dt = float(np.ldexp(m.dt, rate))
    scaled = StateSpaceModel(a, b, c, d, dt, m.inputs, m.outputs, m.states, where=where)
    return Moderated(scaled, rate, gain, t)


def refuse_overflow(where: str, *arrays: AnyArray) -> None:
    """Refuse what finite input became by multiplication: NaN and infinite entries."""
    if not all(np.isfinite(array).all() for array in arrays):
        hint = "choose units in which the model's entries are closer to one another"
        raise NoTrustworthyNumber(where, "a product of the model's entries overflows", "numbers below 1e308", hint)


def scaled_down(size: float, exponent: float, where: str) -> float:
    """``size * 2^-exponent``, to the nearest floating-point number."""
    if not exponent or not np.isfinite(size) or not size:
        return size
    whole = int(np.floor(exponent))
    size = size * 2.0 ** (whole - exponent)
    with np.errstate(over="ignore", under="ignore"):
        value = float(np.ldexp(size, -whole))
    if not np.isfinite(value):
        decades = (np.log2(abs(size)) - whole) * np.log10(2)
        raise NoTrustworthyNumber(
            where, f"the answer is about 1e{decades:.0f}: it overflows", "at most 1e308", "choose larger units"
        )
    return value


def times_power(matrix: Any, exponents: Any) -> Any:
    """``matrix * 2^exponents``, entry by entry; inf and 0 where that is no floating-point number, never on the way."""
    with np.errstate(over="ignore", under="ignore"):
        return np.ldexp(matrix, np.asarray(exponents, dtype=int))


def _exponents(matrix: AnyArray) -> AnyArray:
    """Exponent of every entry, -inf for zeros."""
    return np.where(matrix == 0, -np.inf, np.frexp(matrix)[1])


def _top(exponents: AnyArray) -> int:
    top = exponents.max(initial=-np.inf)
    return int(top) if np.isfinite(top) else 0
