r"""Zeros of models: all finite invariant zeros, with their directions and what kind each is.

.. math:: P(s) = \begin{bmatrix} A - s I & B \\ C & D \end{bmatrix}, \qquad
   \text{zeros: } s \text{ where rank } P(s) \text{ falls below its rank at almost every } s

Orthogonal steps take away what belongs to infinite zeros and to directions without any, until a square pencil with an
invertible direct term is left, whose eigenvalues are the zeros: none has to be told from infinity by its size, and a
model may have any shape. Each is then looked at in P(s) itself, outside the method that found it.

References
----------
Emami-Naeini, Van Dooren, "Computation of zeros of linear multivariable systems", Automatica 18 (1982).
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import Any

import numpy as np

from robustlab.arrays import AnyArray, Array, ComplexArray
from robustlab.errors import told_as
from robustlab.magnitude import balancing_factors, moderated
from robustlab.result import Status
from robustlab.shown import Facts, Shown, listed, number
from robustlab.statespace import StateSpaceModel, as_model

EPS = float(np.finfo(float).eps)
# Singular values below this share (times the order) of the largest entry left are rounding.
ROUNDING = 100 * EPS
# Smallest singular value of P(s) at a zero, relative to P, up to which it was found to working precision.
RESIDUAL = 1e-8
# Where [A - s I, B] or [A - s I; C] is that near to losing rank, relative to its size, the zero is a hidden mode.
HIDDEN = 1e-9


@dataclass(frozen=True, eq=False)
class Zeros(Shown):
    """Finite invariant zeros of a model.

    Attributes
    ----------
    values
        Shape (n_zeros,), each as often as its multiplicity says; in rad/s, or in the z plane of a discrete model.
    kinds
        For each "transmission", "input-decoupling" (a mode that no input moves), "output-decoupling" (one that no
        output shows) or "input-output-decoupling".
    input_directions
        Unit columns, shape (n_inputs, n_zeros): ``G(z) u = 0`` in the sense of P(z). NaN where it is not one direction:
        with more inputs than the normal rank, or at a hidden mode that the inputs do not reach.
    output_directions
        Unit columns, shape (n_outputs, n_zeros), with ``y^H G(z) = 0``; NaN as for the inputs.
    normal_rank
        Rank of the transfer matrix at almost every s.
    residuals
        Singular value of P(z) that should vanish over the largest one, shape (n_zeros,), in balanced states.
    status
        CONVERGED where all residuals are below 1e-8; else INACCURATE.
    """

    values: ComplexArray
    kinds: tuple[str, ...]
    input_directions: ComplexArray
    output_directions: ComplexArray
    normal_rank: int
    residuals: Array
    status: Status

    def __len__(self) -> int:
        return len(self.values)

    def facts(self) -> Facts:
        """The zeros, how many of each kind, and the normal rank."""
        kinds = ", ".join(f"{count} {kind}" for kind, count in Counter(self.kinds).items())
        return [
            ("zeros", listed([number(complex(z)) for z in self.values]) or "none"),
            ("kinds", kinds),
            ("normal rank", str(self.normal_rank)),
            ("largest residual", number(float(self.residuals.max())) if len(self) else ""),
        ]

    def to_json(self) -> dict[str, Any]:
        """All attributes; arrays stay arrays."""
        return {"type": "Zeros", **{name: getattr(self, name) for name in self.__dataclass_fields__}}


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
        Values, kinds, directions, and the residuals in the given model's own pencil.

    Raises
    ------
    InputError
        No model.

    References
    ----------
    Emami-Naeini, Van Dooren (1982).

    Examples
    --------
    >>> allpass = StateSpaceModel([[-1.0]], [[1.0]], [[-2.0]], [[1.0]])  # (s - 1)/(s + 1)
    >>> found = zeros(allpass)
    >>> found.values.real.round(12), found.kinds
    (array([1.]), ('transmission',))
    """
    ordinary = moderated(as_model(model, "zeros"), "zeros")
    m, rate = _balanced(ordinary.model)
    at, rank = _reduced_eigenvalues(m)
    kinds, into, out, residuals = [], [], [], []
    for z in at:
        kind, u, y, residual = _looked_at(m, complex(z), rank)
        kinds.append(kind)
        into.append(u)
        out.append(y)
        residuals.append(residual)
    good = all(r <= RESIDUAL for r in residuals)
    # Columns of B and rows of C were not scaled one by one: directions are those of the model as given.
    with np.errstate(over="ignore"):
        values = at * rate if m.is_discrete else np.ldexp((at * rate).view(float), ordinary.rate).view(complex)
    return Zeros(
        values,
        tuple(kinds),
        np.array(into, dtype=complex).reshape(len(at), m.n_inputs).T,
        np.array(out, dtype=complex).reshape(len(at), m.n_outputs).T,
        rank,
        np.array(residuals, dtype=float),
        Status.CONVERGED if good else Status.INACCURATE,
    )


def transmission_zeros(model: Any) -> ComplexArray:
    """The finite invariant zeros alone, shape (n_zeros,): the ``values`` of `zeros` without their evidence."""
    m, rate = _balanced(as_model(model, "zeros"))
    return _reduced_eigenvalues(m)[0] * rate


def _balanced(m: StateSpaceModel) -> tuple[StateSpaceModel, float]:
    """The model with A, B, C of size one in the unit ``rate`` of s, and in balanced states."""
    if not m.n_states:
        return m, 1.0
    t = balancing_factors(m.A)
    a, b, c = m.A / t[:, None] * t, m.B / t[:, None], m.C * t
    rate, into, out = (_power(np.linalg.norm(x)) for x in (a, b, c))
    # D / (into out) * rate: the transfer matrix of the scaled model is that of the given one times a number.
    return StateSpaceModel(a / rate, b / into, c / out, m.D / into / out * rate, m.dt), rate


def _power(size: Any) -> float:
    """The power of two next to a size; 1 for zero."""
    return float(2.0 ** np.round(np.log2(size))) if size > 0 else 1.0


def _reduced_eigenvalues(m: StateSpaceModel) -> tuple[ComplexArray, int]:
    """Finite zeros and the normal rank of a scaled model."""
    from scipy.linalg import eigvals

    size = max(1.0, float(np.abs(m.D).max(initial=0.0)))
    least = ROUNDING * (m.n_states + m.n_inputs + m.n_outputs) * size
    A, B, C, D = _without_infinite(m.A, m.B, m.C, m.D, least)
    # The same for columns, on what is left, transposed.
    A, C, B, D = (x.T for x in _without_infinite(A.T, C.T, B.T, D.T, least))
    rank = len(D)
    if not len(A):
        return np.zeros(0, dtype=complex), rank
    if not rank:
        return np.asarray(np.linalg.eigvals(A), dtype=complex), 0
    # States and inputs with C x + D u = 0: an orthogonal basis of them, and the pencil on it.
    n = len(A)
    _, _, vh = np.linalg.svd(np.hstack([C, D]))
    kernel = vh[rank:].T
    found = eigvals(np.hstack([A, B]) @ kernel, kernel[:n], homogeneous_eigvals=True)
    alpha, beta = np.asarray(found[0]), np.asarray(found[1])
    finite = np.abs(beta) > EPS * np.abs(alpha)
    return np.asarray(alpha[finite] / beta[finite], dtype=complex), rank


def _without_infinite(
    A: AnyArray, B: AnyArray, C: AnyArray, D: AnyArray, least: float
) -> tuple[AnyArray, AnyArray, AnyArray, AnyArray]:
    """A model with the same finite zeros and normal rank, whose D has full row rank: the first of the two reductions.

    Rows of D that vanish leave ``C2 x = 0``: the states that C2 sees vanish with them, and their equations become
    outputs of what is left.
    """
    while True:
        u, sigma, _ = np.linalg.svd(D)
        r = int((sigma > least).sum())
        D, C = u.T @ D, u.T @ C
        D, C, C2 = D[:r], C[:r], C[r:]
        if not len(C2) or not len(A):
            return A, B, C, D
        _, seen, vh = np.linalg.svd(C2)
        k = int((seen > least).sum())
        if not k:
            return A, B, C, D
        T = np.vstack([vh[k:], vh[:k]])  # unseen states first
        n = len(A) - k
        A, B, C = T @ A @ T.T, T @ B, C @ T.T
        C = np.vstack([C[:, :n], A[n:, :n]])
        D = np.vstack([D, B[n:]])
        A, B = A[:n, :n], B[:n]


def _looked_at(m: StateSpaceModel, z: complex, rank: int) -> tuple[str, AnyArray, AnyArray, float]:
    """Kind, directions at the input and output, and the residual of one zero, from P(z) itself."""
    n = m.n_states
    block = np.block([[m.A - z * np.eye(n), m.B], [m.C, m.D]])
    left, sigma, right = np.linalg.svd(block)
    k = n + rank - 1
    residual = float(sigma[k] / sigma[0]) if sigma[0] else 0.0
    u = _direction(right[k, n:].conj(), m.n_inputs == rank)
    y = _direction(left[n:, k], m.n_outputs == rank)
    unreached = _least(block[:n], n) <= HIDDEN
    unseen = _least(block[:, :n], n) <= HIDDEN
    kind = {(True, True): "input-output-decoupling", (True, False): "input-decoupling",
            (False, True): "output-decoupling", (False, False): "transmission"}[unreached, unseen]  # fmt: skip
    return kind, u, y, residual


def _direction(vector: AnyArray, single: bool) -> AnyArray:
    size = np.linalg.norm(vector)
    return vector / size if single and size > HIDDEN else np.full(len(vector), np.nan, dtype=complex)


def _least(matrix: AnyArray, n: int) -> float:
    """Smallest of the n singular values over the largest entry's size."""
    sigma = np.linalg.svd(matrix, compute_uv=False)
    return float(sigma[n - 1] / max(sigma[0], 1e-300))
