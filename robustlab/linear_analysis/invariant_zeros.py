r"""Zeros of models: all finite invariant zeros, with their kinds.

.. math:: P(s) = \begin{bmatrix} A - s I & B \\ C & D \end{bmatrix}, \qquad
   \text{zeros: } s \text{ where rank } P(s) \text{ falls below its rank at almost every } s

Those of a square model of full normal rank are the roots of :math:`\det P(s)`, which is computed in whole numbers: all
are found, and exact, for any scaling of the model. Those of other models, and of large ones, come from SLICOT's
AB08ND. Each zero is then checked in P(s) itself, independently of the method that found it.

The entries themselves carry rounding: where ``C B`` is zero but 1e-17 after a change of states, there is a zero near
1e17. Zeros beyond the fastest pole that entrywise changes of ROUNDING move away are left out.

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
from typing import Any, ClassVar

import numpy as np

from robustlab.arrays import AnyArray, Array, ComplexArray
from robustlab.display import Displayable, Facts, Part, listed, number
from robustlab.errors import NoTrustworthyNumber, error_context
from robustlab.linear_analysis import slicot
from robustlab.linear_analysis.exact import MOST_STATES, determinant, roots
from robustlab.linear_analysis.matrices import equilibrating_exponents, refuse_extremes, system_matrix
from robustlab.result import Status
from robustlab.statespace import StateSpaceModel, as_model

# Relative rounding errors of the entries from earlier calculations.
ROUNDING = 1e-14
# A zero that such changes move by this share of itself is decided by rounding ...
DECIDED = 0.1
# ... unless it moves by less than this share of the fastest pole: then it lies at zero.
STILL = 1e-9
RESIDUAL = 1e-8  # smallest singular value of P(s) at a zero, relative to P, for working precision
# A mode is hidden if [A - s I, B] or [A - s I; C], rows and columns of size one, is this near to losing rank.
HIDDEN = 1e-13


@dataclass(frozen=True, eq=False)
class Zeros(Displayable):
    """Finite invariant zeros of a model."""

    #: Shape (n_zeros,), with their multiplicities, by rising modulus; in rad/s, or in the z plane of a discrete model
    values: ComplexArray
    #: For each "transmission", "input-decoupling" (an uncontrollable mode), "output-decoupling" (an unobservable one)
    #: or "input-output-decoupling"
    kinds: tuple[str, ...]
    normal_rank: int  #: Rank of the transfer matrix at almost every s, to within rounding
    #: Singular value of P(z) that should vanish over the largest one, rows and columns of the given model's P(z)
    #: brought to size one, shape (n_zeros,)
    residuals: Array
    status: Status  #: CONVERGED: every value is accurate to rounding of the entries; else INACCURATE
    reason: str = ""  #: Why it is inaccurate; else empty
    dt: float = 0.0  #: Sample time of the model in s; 0 of a continuous one

    quantities: ClassVar[Mapping[str, Any]] = {
        "count": "1", "values": [{"re": float, "im": float}], "kinds": [str], "normal_rank": "1",
        "not_minimum_phase": "1",
    }  # fmt: skip

    def __len__(self) -> int:
        return len(self.values)

    @property
    def not_minimum_phase(self) -> int:
        """Number of zeros on the boundary of stability or beyond."""
        return int(np.count_nonzero(abs(self.values) >= 1 if self.dt else self.values.real >= 0))

    @property
    def count(self) -> int:
        """Number of zeros."""
        return len(self)

    def headline(self) -> str:
        return f"{len(self)} finite invariant zero{'s' * (len(self) != 1)}"

    def details(self) -> list[Part]:
        found = zip(self.values.tolist(), self.kinds, self.residuals.tolist(), strict=True)
        rows = [(f"{complex(z):.6g}" if z.imag else f"{z.real:.6g}", kind, f"{r:.2g}") for z, kind, r in found]
        return [Part("zeros:", ("zero", "kind", "residual"), rows)]

    def facts(self) -> Facts:
        kinds = ", ".join(f"{count} {kind}" for kind, count in Counter(self.kinds).items())
        return [
            ("zeros", listed([number(complex(z)) for z in self.values]) or "none"),
            ("kinds", kinds),
            ("on the boundary or beyond", str(self.not_minimum_phase)),
            ("normal rank", str(self.normal_rank)),
            ("largest residual", number(float(self.residuals.max())) if len(self) else ""),
            ("reason", self.reason),
        ]

    def to_json(self) -> dict[str, Any]:
        return {"type": "Zeros", **{field.name: getattr(self, field.name) for field in fields(self)}}


@error_context("zeros")
def zeros(model: Any) -> Zeros:
    r"""Compute all finite invariant zeros of a model: transmission zeros and hidden modes.

    Parameters
    ----------
    model
        Model of any shape, or a python-control object.

    Returns
    -------
    Zeros
        Values, kinds, and the residuals in the given model's own pencil. INACCURATE if rounding of the
        entries decides the place of a zero.

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
    values, rank, reason = _found(m)
    S, n = system_matrix(m), m.n_states
    tested = [_tested(S, z, n, rank) for z in values.tolist()]
    residuals = np.array([left for _, left in tested], dtype=float)
    reason = reason or _doubt(m, values, rank, residuals)
    status = Status.INACCURATE if reason else Status.CONVERGED
    return Zeros(values, tuple(kind for kind, _ in tested), rank, residuals, status, reason, m.dt)


def transmission_zeros(model: Any, *, complete: bool = False) -> ComplexArray:
    """Return the ``values`` of `zeros` alone, shape (n_zeros,)."""
    values, _, reason = _found(as_model(model, "zeros"))
    if complete and reason:
        raise NoTrustworthyNumber("zeros", reason)
    return values


def _found(m: StateSpaceModel) -> tuple[ComplexArray, int, str]:
    """Find the zeros by rising modulus, the normal rank, and a reason why there may be others."""
    refuse_extremes(m, "zeros")
    S, n, reason = system_matrix(m), m.n_states, ""
    values, rank = slicot.invariant_zeros(m.A, m.B, m.C, m.D)
    if n and m.n_inputs == m.n_outputs and n <= MOST_STATES:
        try:
            polynomial = determinant(S, n)[0]
        except NoTrustworthyNumber as error:
            return values, rank, error.found
        if polynomial and rank < m.n_inputs:
            reason = f"the normal rank is {m.n_inputs}, and {rank} to within rounding of the entries"
        elif polynomial:
            found = [root.value for root in roots(polynomial) for _ in range(root.multiplicity)]
            values = np.array(sorted(found, key=lambda z: (abs(z), z.imag)), dtype=complex)
            fastest = float(np.abs(m.poles()).max(initial=0.0))
            while len(values) and abs(values[-1]) > fastest and _decided_by_rounding(S, n, complex(values[-1]), 0.0):
                values = values[:-1]
    return values, rank, reason


def _pencil(S: Array, s: complex, n: int) -> ComplexArray:
    P = S.astype(complex)
    P[range(n), range(n)] -= s
    return P


def _times_power(values: ComplexArray, exponents: AnyArray) -> ComplexArray:
    return np.ldexp(values.real, exponents) + 1j * np.ldexp(values.imag, exponents)


def _singular_values(P: ComplexArray, size: Array) -> Array:
    """Return the singular values of P with rows and columns scaled by powers of two, from ``size``."""
    r, c = equilibrating_exponents(size)
    return np.linalg.svd(_times_power(P, r[:, None] + c), compute_uv=False)


def _tested(S: Array, z: complex, n: int, rank: int) -> tuple[str, float]:
    """Test a zero in P(z): return its kind and its residual."""
    P, size = _pencil(S, z, n), _pencil(np.abs(S), -abs(z), n).real
    sigma = _singular_values(P, size)
    unreached, unseen = _loses_rank(P[:n], size[:n]), _loses_rank(P[:, :n], size[:, :n])
    kind = {(True, True): "input-output-decoupling", (True, False): "input-decoupling",
            (False, True): "output-decoupling", (False, False): "transmission"}[unreached, unseen]  # fmt: skip
    return kind, float(sigma[n + rank - 1] / sigma[0]) if sigma[0] else 0.0


def _loses_rank(block: ComplexArray, size: Array) -> bool:
    sigma = _singular_values(block, size)
    return bool(sigma[-1] <= HIDDEN * sigma[0])


def _decided_by_rounding(S: Array, n: int, z: complex, least: float) -> bool:
    r"""Return whether entrywise changes by ROUNDING may move the zero by DECIDED of itself, and by ``least`` at least.

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


def _doubt(m: StateSpaceModel, values: ComplexArray, rank: int, residuals: Array) -> str:
    """Return why the zeros are not accurate; empty if they are."""
    if (residuals > RESIDUAL).any():
        return f"P(s) at a zero misses a lower rank by {residuals.max():.1e}"
    if rank < max(m.n_inputs, m.n_outputs):
        return ""
    S, n = system_matrix(m), m.n_states
    least = STILL * float(np.abs(np.concatenate([m.poles(), values])).max(initial=0.0))
    for z in values.tolist():
        if z.imag >= 0 and (least or z) and _decided_by_rounding(S, n, z, least):
            return f"rounding of the model's entries decides where the zero {z:.6g} is"
    return ""
