r"""Weights for what a model leaves out: a delay or a lag of any length up to a given one, covered at all frequencies.

.. math:: |e^{-j \omega \tau} - 1| \le |W(j\omega)| \quad \text{for all } 0 \le \tau \le \tau_{\max} \text{ and all }
   \omega \ge 0

With :math:`z = (\omega \tau_{\max})^2` the largest error is :math:`E^2 = 2 - 2 \cos \sqrt z` up to :math:`z = \pi^2`
and 4 above, and :math:`|W|^2 = N(z) / D(z)`. Taylor's sums of the cosine lie alternately above and below it, for every
z; with T one that gives an upper bound of :math:`E^2`, two polynomials in z have to be positive,

.. math:: N - T D > 0 \text{ on } (0, z_0], \qquad N - 4 D > 0 \text{ on } [z_0, \infty), \qquad z_0 = 9.86 < \pi^2 .

Sturm's sequences decide that in rational numbers, without rounding.

References
----------
Wang, Lundström, Skogestad, "Representation of uncertain time delays in the H-infinity framework", Int. J. Control 59
(1994); Skogestad, Postlethwaite, *Multivariable Feedback Control* (2005), section 7.4; Sturm 1829.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from fractions import Fraction
from functools import cache
from itertools import pairwise
from math import factorial
from typing import Any, ClassVar

from robustlab.delays.pade import SHORTEST
from robustlab.errors import InputError, NoTrustworthyNumber, told_as
from robustlab.result import Status
from robustlab.shown import Facts, Shown
from robustlab.statespace import StateSpaceModel, series

Polynomial = Sequence[Fraction]  # constant first

# Where the error is bounded by 4 instead of Taylor's sum: below pi^2.
SPLIT = Fraction(986, 100)
TERMS = 13  # odd: the sum then lies above 2 - 2 cos
# What the weights are larger than the ones that are proved, for the rounding of their realisation.
ROUNDING = 1e-9

# What shows that a weight covers, in words.
PROOFS = {
    "delay": "|W|^2 lies above 2 - 2 cos x up to x^2 = 9.86 and above 4 beyond: Sturm's sequences in rational numbers",
    "lag": "the error rises with the time constant, and the weight is that of the longest",
}

# The weights for a delay of 1 s: numerator and denominator in s, constant first.
# Order 1: 5 % above the error at low frequencies, 2.83 at high ones. A slope of exactly one would end at 3.46.
# Order 3: of Wang, Lundstroem and Skogestad; ends at 2, as the error itself does.
_CORNER = Fraction(2363, 1000)
_FORMS: dict[int, tuple[list[Fraction], list[Fraction]]] = {
    1: ([Fraction(0), Fraction(21, 20)], [Fraction(1), Fraction(21 * 100, 20 * 283)]),
    3: (
        [Fraction(0), Fraction(1), 2 * Fraction(838, 1000) / _CORNER, 1 / _CORNER**2],
        [
            Fraction(1),
            Fraction(1, 2) + 2 * Fraction(685, 1000) / _CORNER,
            1 / _CORNER**2 + Fraction(685, 1000) / _CORNER,
            1 / (2 * _CORNER**2),
        ],
    ),
}


@dataclass(frozen=True, eq=False)
class NeglectedWeight(Shown):
    """The weight of the relative error of a model that leaves something out.

    Attributes
    ----------
    weight
        A stable model W with ``|error| <= |W|`` at all frequencies.
    neglected
        What is left out, with its length.
    proof
        Why it covers.
    status
        CERTIFIED.
    delay
        The longest delay in s that is left out; None of a lag.
    """

    weight: StateSpaceModel
    neglected: str
    proof: str
    status: Status = Status.CERTIFIED
    delay: float | None = None

    quantities: ClassVar[Mapping[str, Any]] = StateSpaceModel.quantities

    def numbers(self) -> dict[str, Any]:
        return self.weight.numbers()

    def headline(self) -> str:
        return f"weight of the relative error of a model that leaves out {self.neglected}"

    def facts(self) -> Facts:
        return [("leaves out", self.neglected), ("weight", repr(self.weight)), ("proof", self.proof)]

    def to_json(self) -> dict[str, object]:
        return {f.name: getattr(self, f.name) for f in fields(self)}


def neglected_weight(delay: float | None = None, lag: float | None = None, order: int = 1) -> NeglectedWeight:
    """The weight for a delay or a lag up to a length in s; see `neglected_dynamics`.

    Examples
    --------
    >>> neglected_weight(delay=0.02).neglected
    'a delay of up to 0.02 s'
    """
    if delay is not None and lag is None:
        weight = neglected_dynamics(delay=delay, order=order)
        return NeglectedWeight(weight, f"a delay of up to {delay:g} s", PROOFS["delay"], delay=float(delay))
    if lag is not None and delay is None:
        return NeglectedWeight(neglected_dynamics(lag=lag), f"a lag of up to {lag:g} s", PROOFS["lag"])
    raise InputError("neglected_weight", "delay and lag" if lag is not None else "neither", "one of them")


@told_as("neglected_dynamics")
def neglected_dynamics(
    *, delay: float | None = None, lag: float | None = None, order: int | None = None
) -> StateSpaceModel:
    r"""Weight of the relative error when a delay or a first-order lag of at most a given length is left out of a model.

    .. math:: |e^{-j \omega \tau} - 1| \le |W(j\omega)| \qquad \text{or} \qquad
       \left| \frac{1}{1 + j \omega \tau} - 1 \right| \le |W(j\omega)|

    for all :math:`0 \le \tau \le \tau_{\max}` and all frequencies. Of a delay it is proved in rational numbers, see
    `robustlab.delays.neglected`; of a lag :math:`W(s) = \tau_{\max} s / (1 + \tau_{\max} s)`: the error rises with
    :math:`\tau`, so that equality at :math:`\tau_{\max}` is the proof. Use it as the weight of `robustlab.unstructured`
    in the form "input-multiplicative" or "output-multiplicative".

    Parameters
    ----------
    delay, lag
        The longest delay or the longest time constant in s, positive; one of the two.
    order
        Of the weight of a delay; 1 where left out: 5 % above the error at low frequencies, 2.83 at high ones. 3: equal
        to the error at low frequencies, and 2 at high ones, as the error itself; nowhere more than 2.1 % above it.

    Returns
    -------
    StateSpaceModel
        A stable weight with ``order`` states; of a lag with one.

    Raises
    ------
    InputError
        Both or neither, a length that is not positive and finite, another order.

    References
    ----------
    Wang, Lundström, Skogestad (1994); Skogestad, Postlethwaite, *Multivariable Feedback Control* (2005), section 7.4.

    Examples
    --------
    >>> weight = neglected_dynamics(delay=0.1)
    >>> weight.n_states, float(weight.D[0, 0].round(3))
    (1, 2.83)
    >>> neglected_dynamics(lag=0.5).poles()
    array([-2.+0.j])
    """
    if (delay is None) == (lag is None):
        raise InputError("neglected_dynamics", f"delay={delay}, lag={lag}", "one of the two")
    if lag is not None:
        _check_time("neglected_dynamics: lag", lag)
        if order is not None:
            raise InputError("neglected_dynamics: order", f"{order!r} with a lag", "none: its weight has one state")
        return _first_order(1.0 + ROUNDING, 1.0 / lag)
    assert delay is not None
    _check_time("neglected_dynamics: delay", delay)
    return _delay_weight(delay, 1 if order is None else order)


def _delay_weight(delay: float, order: int) -> StateSpaceModel:
    if isinstance(order, bool) or order not in _FORMS:
        raise InputError("neglected_dynamics: order", f"{order!r}", "1 or 3")
    if not _proved(order):
        raise NoTrustworthyNumber("neglected_dynamics", f"the weight of order {order} is not proved to cover")
    size = 1.0 + ROUNDING
    if order == 1:
        _, (_, low) = (_FORMS[1][0], _FORMS[1][1])
        corner = 1.0 / (float(low) * delay)
        return _first_order(size * 2.83, corner)
    first = _first_order(size * 2.0, 2.0 / delay)
    rate = float(_CORNER) / delay
    second = StateSpaceModel(
        [[-2 * 0.685 * rate, -rate], [rate, 0.0]], [[rate], [0.0]], [[2 * (0.838 - 0.685), 0.0]], [[1.0]]
    )
    whole = series(first, second)
    return StateSpaceModel(whole.A, whole.B, whole.C, whole.D)


def _first_order(gain: float, corner: float) -> StateSpaceModel:
    """``gain s / (s + corner)``, which blocks a constant exactly."""
    return StateSpaceModel([[-corner]], [[corner]], [[-gain]], [[gain]])


def _check_time(where: str, value: object) -> None:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not SHORTEST <= value <= 1 / SHORTEST:
        raise InputError(where, f"{value!r}", f"a positive number of seconds, {SHORTEST:g} to {1 / SHORTEST:g}")


# --- the proof --------------------------------------------------------------------------------------------------------


@cache
def _proved(order: int) -> bool:
    return covers_delay(*_FORMS[order])


def covers_delay(numerator: Polynomial, denominator: Polynomial) -> bool:
    r"""Whether :math:`|e^{-j\omega\tau} - 1| < |N(j\omega) / D(j\omega)|` for all :math:`0 < \tau \le 1`, :math:`\omega
    > 0`.

    ``numerator``, ``denominator``: coefficients in s, constant first.
    Returns: True is a proof; False says that it did not succeed.
    """
    n, d = _square(numerator), _square(denominator)
    taylor = [Fraction(0)] + [Fraction((-1) ** (k + 1) * 2, factorial(2 * k)) for k in range(1, TERMS + 1)]
    below, above = _difference(n, _times(taylor, d)), _difference(n, [4 * c for c in d])
    while below and below[0] == 0:  # z > 0 divided out
        below = below[1:]
    return positive_between(below, Fraction(0), SPLIT) and positive_between(above, SPLIT, None)


def positive_between(p: Polynomial, low: Fraction, high: Fraction | None) -> bool:
    """Whether a polynomial is positive on [low, high], or [low, infinity) for None; by Sturm's sequence, exactly.

    Examples
    --------
    >>> p = [Fraction(2), Fraction(-3), Fraction(1)]  # (z - 1)(z - 2)
    >>> positive_between(p, Fraction(3), None), positive_between(p, Fraction(0), Fraction(3))
    (True, False)
    """
    p = _trimmed(list(p))
    if not p or _at(p, low) <= 0 or (high is not None and _at(p, high) <= 0):
        return False
    chain = [p, _trimmed([i * c for i, c in enumerate(p)][1:])]
    while chain[-1]:
        chain.append(_trimmed([-c for c in _remainder(chain[-2], chain[-1])]))
    chain.pop()
    at_low = [_at(q, low) for q in chain]
    at_high = [q[-1] for q in chain] if high is None else [_at(q, high) for q in chain]
    return _changes(at_low) == _changes(at_high) and (high is not None or p[-1] > 0)


def _changes(values: list[Fraction]) -> int:
    signs = [v > 0 for v in values if v]
    return sum(a != b for a, b in pairwise(signs))


def _at(p: Polynomial, z: Fraction) -> Fraction:
    value = Fraction(0)
    for c in reversed(p):
        value = value * z + c
    return value


def _trimmed(p: list[Fraction]) -> list[Fraction]:
    while p and p[-1] == 0:
        p.pop()
    return p


def _remainder(a: Polynomial, b: Polynomial) -> list[Fraction]:
    rest = list(a)
    while len(rest) >= len(b):
        factor, shift = rest[-1] / b[-1], len(rest) - len(b)
        for i, c in enumerate(b):
            rest[shift + i] -= factor * c
        rest.pop()
    return rest


def _times(a: Polynomial, b: Polynomial) -> list[Fraction]:
    found = [Fraction(0)] * (len(a) + len(b) - 1)
    for i, x in enumerate(a):
        for j, y in enumerate(b):
            found[i + j] += x * y
    return found


def _difference(a: Polynomial, b: Polynomial) -> list[Fraction]:
    size = max(len(a), len(b))
    first, second = ([*p, *[Fraction(0)] * (size - len(p))] for p in (a, b))
    return [x - y for x, y in zip(first, second, strict=True)]


def _square(p: Polynomial) -> list[Fraction]:
    r""":math:`|p(j \sqrt z)|^2` as a polynomial in z."""
    product = _times(p, [c * (-1) ** i for i, c in enumerate(p)])
    return [c * (-1) ** i for i, c in enumerate(product[::2])]
