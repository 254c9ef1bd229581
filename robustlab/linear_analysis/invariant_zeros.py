r"""Zeros of models: all finite invariant zeros, with their directions and what kind each is.

.. math:: P(s) = \begin{bmatrix} A - s I & B \\ C & D \end{bmatrix}, \qquad
   \text{zeros: } s \text{ where rank } P(s) \text{ falls below its rank at almost every } s

They are the roots of :math:`\det P(s)`, which is computed in whole numbers: none is missing and none is off, however
the model is scaled. A pencil that is not square, or whose normal rank is lower, is bordered by random rows and columns;
roots that two different borders have in common are its zeros. Each zero is then looked at in P(s) itself, outside the
method that found it.

What is exact of the entries need not be meant: where ``C B`` ought to be zero and is 1e-17 after a change of states,
there is a zero near 1e17, and a model with more outputs than inputs loses its zeros by any change of an entry. So both
are told apart by what entrywise changes of ROUNDING do.

References
----------
Rosenbrock, *State-space and Multivariable Theory* (1970); Emami-Naeini, Van Dooren, "Computation of zeros of linear
multivariable systems", Automatica 18 (1982). The distance to a singular matrix, entry by entry: Demmel, "The
componentwise distance to the nearest singular matrix", SIAM J. Matrix Anal. Appl. 13 (1992).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any, ClassVar, NamedTuple

import numpy as np

from robustlab.arrays import AnyArray, Array, ComplexArray, Mask
from robustlab.errors import NoTrustworthyNumber, told_as
from robustlab.linear_analysis.exact import MOST_STATES, Root, determinant, normal_rank, roots
from robustlab.linear_analysis.magnitude import equilibrating_exponents
from robustlab.result import Status
from robustlab.shown import Facts, Part, Shown, listed, number
from robustlab.statespace import StateSpaceModel, as_model

# Relative changes of the entries that earlier calculations may have left in them.
ROUNDING = 1e-14
# A zero that such changes move by this share of itself is decided by them ...
DECIDED = 0.1
# ... unless it goes by less than this share of the fastest pole: it lies at zero then.
STILL = 1e-9
# Smallest singular value of P(s) at a zero, relative to P, up to which it was found to working precision, ...
RESIDUAL = 1e-8
# ... and at a zero that the entries miss by rounding, which two borders must give alike to ALIKE.
NEARLY, ALIKE = 1e-13, 1e-6
# Where [A - s I, B] or [A - s I; C], rows and columns of size one, is that near to losing rank, the mode is hidden.
HIDDEN = 1e-13
BORDER = 2**15  # entries of borders, which are whole numbers, are smaller


@dataclass(frozen=True, eq=False)
class Zeros(Shown):
    """Finite invariant zeros of a model.

    Attributes
    ----------
    values
        Shape (n_zeros,), each as often as its multiplicity says, by rising modulus; in rad/s, or in the z plane of a
        discrete model.
    kinds
        For each "transmission", "input-decoupling" (a mode that no input moves), "output-decoupling" (one that no
        output shows) or "input-output-decoupling".
    input_directions
        Unit columns, shape (n_inputs, n_zeros): ``G(z) u = 0`` in the sense of P(z). NaN where it is not one direction:
        with more inputs than the normal rank, or at a hidden mode that the inputs do not reach.
    output_directions
        Unit columns, shape (n_outputs, n_zeros), with ``y^H G(z) = 0``; NaN as for the inputs.
    normal_rank
        Rank of the transfer matrix at almost every s, to within rounding.
    exact
        For each zero whether the model has it with its entries taken as the numbers that they are; False where they
        miss it by rounding, as happens to a model with more outputs or inputs than its normal rank.
    near_infinity
        Further zeros of the model as given, beyond its fastest pole, that relative changes of its entries by 1e-14
        bring in from infinity; inf for those beyond the range of floating-point numbers.
    sensitivities
        Relative change of each zero over relative changes of all entries, to first order, shape (n_zeros,); inf for
        multiple zeros and for those that are not exact.
    residuals
        Singular value of P(z) that should vanish over the largest one, rows and columns of the given model's P(z)
        brought to size one, shape (n_zeros,).
    status
        CONVERGED: the exact values are right to the last digits, and with those near infinity none is missing; else
        INACCURATE.
    reason
        Why it is inaccurate; else empty.
    dt
        Sample time of the model in s; 0 of a continuous one.
    """

    values: ComplexArray
    kinds: tuple[str, ...]
    input_directions: ComplexArray
    output_directions: ComplexArray
    normal_rank: int
    exact: tuple[bool, ...]
    near_infinity: ComplexArray
    sensitivities: Array
    residuals: Array
    status: Status
    reason: str = ""
    dt: float = 0.0

    quantities: ClassVar[Mapping[str, Any]] = {
        "count": "1",
        "values": [{"re": float, "im": float}],
        "kinds": [str],
        "normal_rank": "1",
        "not_minimum_phase": "1",
    }

    def __len__(self) -> int:
        return len(self.values)

    @property
    def not_minimum_phase(self) -> int:
        """How many are on the boundary of stability or beyond."""
        return int(np.count_nonzero(abs(self.values) >= 1 if self.dt else self.values.real >= 0))

    @property
    def count(self) -> int:
        """How many there are."""
        return len(self)

    def headline(self) -> str:
        return f"{len(self)} finite invariant zero{'s' * (len(self) != 1)}"

    def details(self) -> list[Part]:
        found = zip(self.values.tolist(), self.kinds, self.residuals.tolist(), strict=True)
        rows = [(f"{complex(z):.6g}" if z.imag else f"{z.real:.6g}", kind, f"{r:.2g}") for z, kind, r in found]
        return [Part("zeros:", ("zero", "kind", "residual"), rows)]

    def facts(self) -> Facts:
        kinds = ", ".join(f"{count} {kind}" for kind, count in Counter(self.kinds).items())
        missed = [number(complex(z)) for z, exact in zip(self.values, self.exact, strict=True) if not exact]
        return [
            ("zeros", listed([number(complex(z)) for z in self.values]) or "none"),
            ("kinds", kinds),
            ("on the boundary or beyond", str(self.not_minimum_phase)),
            ("missed by rounding", listed(missed) if self.status is Status.CONVERGED else ""),
            ("at infinity but for rounding", listed([number(complex(z)) for z in self.near_infinity])),
            ("normal rank", str(self.normal_rank)),
            ("largest residual", number(float(self.residuals.max())) if len(self) else ""),
            ("reason", self.reason),
        ]

    def to_json(self) -> dict[str, Any]:
        return {"type": "Zeros", **{field.name: getattr(self, field.name) for field in fields(self)}}


@told_as("zeros")
def zeros(model: Any) -> Zeros:
    r"""All finite invariant zeros of a model: transmission zeros and hidden modes, with their directions.

    Parameters
    ----------
    model
        Model of any shape, or a python-control object.

    Returns
    -------
    Zeros
        Values, kinds, directions, and the residuals in the given model's own pencil. INACCURATE where rounding of the
        entries decides where a zero is, and beyond 200 states, where the values are computed in floating point.

    Raises
    ------
    InputError
        No model.

    References
    ----------
    Rosenbrock (1970).

    Examples
    --------
    >>> allpass = StateSpaceModel([[-1.0]], [[1.0]], [[-2.0]], [[1.0]])  # (s - 1)/(s + 1)
    >>> found = zeros(allpass)
    >>> found.values, found.kinds
    (array([1.+0.j]), ('transmission',))
    """
    m = as_model(model, "zeros")
    found, S, n = _found(m), _system(m), m.n_states
    upper = {z: _looked_at(S, z, n, found.rank) for z in {_above(z) for z in found.values.tolist()}}
    looked = [upper[_above(z)] if z.imag >= 0 else upper[_above(z)].mirrored() for z in found.values.tolist()]
    sensitivities = np.array([x.sensitivity for x in looked], dtype=float)
    sensitivities[~found.exact | _repeated(found.values)] = np.inf
    residuals = np.array([x.residual for x in looked], dtype=float)
    reason = found.reason or _doubt(m, found, sensitivities, residuals)
    return Zeros(
        found.values,
        tuple(x.kind for x in looked),
        np.array([x.into for x in looked], dtype=complex).reshape(len(looked), m.n_inputs).T,
        np.array([x.out for x in looked], dtype=complex).reshape(len(looked), m.n_outputs).T,
        found.rank,
        tuple(found.exact.tolist()),
        found.near_infinity,
        sensitivities,
        residuals,
        Status.INACCURATE if reason else Status.CONVERGED,
        reason,
        m.dt,
    )


def transmission_zeros(model: Any, *, complete: bool = False) -> ComplexArray:
    """The finite invariant zeros alone, shape (n_zeros,): the ``values`` of `zeros` without their evidence."""
    found = _found(as_model(model, "zeros"))
    if complete and found.reason:
        raise NoTrustworthyNumber("zeros", found.reason)
    return found.values


# --- the values ------------------------------------------------------------------------------------------------------


class _Found(NamedTuple):
    """Zeros by rising modulus, which of them are exact, those near infinity, and why there may be others."""

    values: ComplexArray
    exact: Mask
    near_infinity: ComplexArray
    rank: int
    reason: str


def _system(m: StateSpaceModel) -> Array:
    return np.block([[m.A, m.B], [m.C, m.D]])


def _found(m: StateSpaceModel) -> _Found:
    S, n, none = _system(m), m.n_states, np.zeros(0, dtype=complex)
    rank = exactly = _rank_within_rounding(m)
    try:
        if n <= MOST_STATES:
            exactly = normal_rank(S, n) - n
        rank = min(rank, exactly)
        exact, nearly = _roots(S, n, rank, exactly)
    except NoTrustworthyNumber as error:
        values = _in_floating_point(S, n, rank)
        return _Found(values, np.zeros(len(values), dtype=bool), none, rank, error.found)
    far = 0
    if rank == m.n_inputs == m.n_outputs:
        fastest = float(np.abs(m.poles()).max(initial=0.0))
        while far < len(exact) and abs(z := complex(exact[-1 - far])) > fastest and _decided_by_rounding(S, n, z, 0.0):
            far += 1
    near, exact = exact[len(exact) - far :], exact[: len(exact) - far]
    values = np.concatenate([exact, nearly])
    order = np.argsort(np.abs(values), kind="stable")
    reason = f"the normal rank is {exactly}, and {rank} to within rounding of the entries" if rank < exactly else ""
    return _Found(values[order], (np.arange(len(values)) < len(exact))[order], near, rank, reason)


def _roots(S: Array, n: int, rank: int, exactly: int) -> tuple[ComplexArray, ComplexArray]:
    """Exact zeros by rising modulus, and those that the entries miss by rounding."""
    if n > MOST_STATES:
        raise NoTrustworthyNumber("zeros", f"{n} states: more than {MOST_STATES} are not solved exactly")
    p, m = S.shape[0] - n, S.shape[1] - n
    if rank == p == m:
        return _sorted(roots(determinant(S, n)[0])), np.zeros(0, dtype=complex)
    first, second = (determinant(_bordered(S, n, rank, seed), n)[0] for seed in (0, 1))
    exact = _sorted(roots(first.gcd(second)) if rank == exactly else [])
    # Every zero, exact or not, is a root with either border; all other roots change with it.
    one, two = _sorted(roots(first)), _sorted(roots(second))
    alike = [z for z in one if len(two) and np.abs(two - z).min() <= ALIKE * abs(z)]
    left = list(exact)
    nearly = []
    for z in alike:
        if left and min(abs(z - w) for w in left) <= ALIKE * abs(z):
            left.pop(int(np.argmin([abs(z - w) for w in left])))
        elif _looked_at(S, complex(z), n, rank).residual <= NEARLY:
            nearly.append(z)
    return exact, np.array(nearly, dtype=complex)


def _sorted(found: list[Root]) -> ComplexArray:
    values = [root.value for root in found for _ in range(root.multiplicity)]
    return np.array(sorted(values, key=lambda z: (abs(z), z.imag)), dtype=complex)


def _bordered(S: Array, n: int, rank: int, seed: int) -> Array:
    """The square matrix ``[S, X; Y, 0]``: with X and Y at random its determinant vanishes at the zeros of S."""
    p, m = S.shape[0] - n, S.shape[1] - n
    if rank == p == m:
        return S
    rng = np.random.default_rng(seed)
    r, c = equilibrating_exponents(S)
    X, Y = (rng.integers(1, BORDER, size).astype(float) for size in ((n + p, p - rank), (m - rank, n + m)))
    X, Y = np.ldexp(X / BORDER, -r[:, None]), np.ldexp(Y / BORDER, -c)
    return np.block([[S, X], [Y, np.zeros((m - rank, p - rank))]])


def _in_floating_point(S: Array, n: int, rank: int) -> ComplexArray:
    """The zeros by rising modulus as eigenvalues, without a proof."""
    from scipy.linalg import eigvals

    each = []
    for seed in (0, 1):
        M = _bordered(S, n, rank, seed)
        r, c = equilibrating_exponents(M)
        mass = np.zeros_like(M)
        mass[range(n), range(n)] = np.ldexp(1.0, r[:n] + c[:n])
        found: Any = eigvals(np.ldexp(M, r[:, None] + c), mass, homogeneous_eigvals=True)
        finite = np.abs(found[1]) > np.finfo(float).eps * np.abs(found[0])
        each.append(found[0][finite] / found[1][finite])
    alike = [z for z in each[0] if len(each[1]) and np.abs(each[1] - z).min() <= ALIKE * abs(z)]
    return np.array(sorted(alike, key=abs), dtype=complex)


# --- P(s), looked at -------------------------------------------------------------------------------------------------


class _Look(NamedTuple):
    """What P(z) says of a zero: kind, directions at input and output, sensitivity, residual."""

    kind: str
    into: AnyArray
    out: AnyArray
    sensitivity: float
    residual: float

    def mirrored(self) -> _Look:
        """That of the conjugate zero."""
        return self._replace(into=self.into.conj(), out=self.out.conj())


def _above(z: complex) -> complex:
    return z if z.imag >= 0 else z.conjugate()


def _pencil(S: Array, s: complex, n: int) -> ComplexArray:
    P = S.astype(complex)
    P[range(n), range(n)] -= s
    return P


def _times_power(values: ComplexArray, exponents: AnyArray) -> ComplexArray:
    return np.ldexp(values.real, exponents) + 1j * np.ldexp(values.imag, exponents)


class _Vectors(NamedTuple):
    """Singular values of P with scaled rows and columns, its left and right vectors in columns, and the exponents."""

    sigma: Array
    left: ComplexArray
    right: ComplexArray
    r: AnyArray
    c: AnyArray


def _singular(P: ComplexArray, size: Array) -> _Vectors:
    """``size``: of P's entries before they cancel, by which its rows and columns are scaled."""
    r, c = equilibrating_exponents(size)
    left, sigma, right = np.linalg.svd(_times_power(P, r[:, None] + c))
    return _Vectors(sigma, left, right.conj().T, r, c)


def _rank_within_rounding(m: StateSpaceModel) -> int:
    """Largest rank of the transfer matrix at points among the sizes of its dynamics, with NEARLY for rounding."""
    S, n, best = _system(m), m.n_states, 0
    size = np.append(np.abs(m.poles()), np.abs(m.A).max(initial=0.0))
    size = size[size > 0]
    low, high = (size.min(), size.max()) if len(size) else (1.0, 1.0)
    for s in np.geomspace(low, high, 5) * 1.37 * np.exp(1.1j):
        sigma = _singular(_pencil(S, s, n), _pencil(np.abs(S), -abs(s), n).real).sigma
        best = max(best, int((sigma > NEARLY * sigma.max(initial=0.0)).sum()) - n)
        if best == min(m.n_inputs, m.n_outputs):
            break
    return best


def _looked_at(S: Array, z: complex, n: int, rank: int) -> _Look:
    P, size, k = _pencil(S, z, n), _pencil(np.abs(S), -abs(z), n).real, n + rank - 1
    sigma, left, right, r, c = _singular(P, size)
    x, y = _times_power(right[:, k], c - c.max()), _times_power(left[:, k], r - r.max())
    weight = abs(z) * abs(y[:n].conj() @ x[:n])
    with np.errstate(all="ignore"):
        sensitivity = float(np.divide(np.abs(y) @ np.abs(S) @ np.abs(x), weight))
    unreached, unseen = _loses_rank(P[:n], size[:n]), _loses_rank(P[:, :n], size[:, :n])
    kind = {(True, True): "input-output-decoupling", (True, False): "input-decoupling",
            (False, True): "output-decoupling", (False, False): "transmission"}[unreached, unseen]  # fmt: skip
    u = _direction(right[n:, k], c[n:], S.shape[1] - n == rank)
    v = _direction(left[n:, k], r[n:], S.shape[0] - n == rank)
    return _Look(kind, u, v, sensitivity, abs(float(sigma[k] / sigma[0])) if sigma[0] else 0.0)


def _direction(vector: ComplexArray, exponents: AnyArray, single: bool) -> ComplexArray:
    """A part of a singular vector as a unit vector of the model as given; NaN where it is none."""
    if not single or np.linalg.norm(vector) <= HIDDEN:
        return np.full(len(vector), np.nan, dtype=complex)
    given = _times_power(vector, exponents - exponents.max())
    return given / np.linalg.norm(given)


def _loses_rank(block: ComplexArray, size: Array) -> bool:
    sigma = _singular(block, size).sigma
    return bool(sigma[-1] <= HIDDEN * sigma[0])


# --- what rounding of the entries does -------------------------------------------------------------------------------


def _decided_by_rounding(S: Array, n: int, z: complex, least: float) -> bool:
    r"""Whether entrywise changes by ROUNDING may move the zero by DECIDED of itself, and by ``least`` at least.

    They make :math:`P(s)` singular at no point s with :math:`\rho(|P(s)^{-1}| |S|)` below 1 / ROUNDING.
    """
    if not np.isfinite(z):
        return True
    for turn in (1, 3, 5, 7):
        P = _pencil(S, z + max(DECIDED * abs(z), least) * np.exp(1j * np.pi / 4 * turn), n)
        r, c = equilibrating_exponents(P)
        try:
            back = np.linalg.inv(_times_power(P, r[:, None] + c))
        except np.linalg.LinAlgError:
            return True
        reach = np.abs(back) @ np.ldexp(np.abs(S), r[:, None] + c)
        if np.abs(np.linalg.eigvals(reach)).max() * ROUNDING >= 1:
            return True
    return False


def _doubt(m: StateSpaceModel, found: _Found, sensitivities: Array, residuals: Array) -> str:
    """Why the zeros are not to be trusted; empty where they are."""
    if (residuals > RESIDUAL).any():
        return f"P(s) at a zero misses a lower rank by {residuals.max():.1e}"
    if found.rank < max(m.n_inputs, m.n_outputs):
        return ""
    S, n = _system(m), m.n_states
    least = STILL * float(np.abs(np.concatenate([m.poles(), found.values])).max(initial=0.0))
    loose = found.values[sensitivities * ROUNDING > 0.1 * DECIDED]
    moved = [z for z in loose.tolist() if z.imag >= 0 and (least or z) and _decided_by_rounding(S, n, z, least)]
    if not moved:
        return ""
    return f"rounding of the model's entries decides where the zero {moved[0]:.6g} is"


def _repeated(values: ComplexArray) -> Mask:
    return np.array([np.count_nonzero(values == z) > 1 for z in values], dtype=bool)
