r"""Whether an error of a form stays below a weight at all frequencies: no crossing is missing between points.

Every error of `robustlab.uncertainty.unstructured` is :math:`E = X^{-1} Y Z^{-1}` with X, Y, Z made of the two models,
and :math:`\bar\sigma(E) = |w|` at a frequency makes

.. math:: \begin{bmatrix} -X X^\sim & Y \\ Y^\sim & -(w Z)^\sim (w Z) \end{bmatrix}, \qquad X^\sim(s) = X(-s)^T,

singular there. Its zeros are those of a state-space model without an inverse of X or Z in it; the imaginary part of
*every* zero counts as a candidate, without a tolerance on its real part. Between two candidates the error is either
above the weight everywhere or nowhere, and one point tells. Floating point, not interval arithmetic.

References
----------
Boyd, Balakrishnan, "A regularity result for the singular values of a transfer matrix", Systems & Control Letters 15
(1990).
"""

from __future__ import annotations

import numpy as np

from robustlab.arrays import Array
from robustlab.errors import RobustlabError
from robustlab.invariant_zeros import transmission_zeros
from robustlab.norms import bilinear_to_continuous
from robustlab.statespace import StateSpaceModel, append
from robustlab.uncertainty.covering.overbound import anonymous
from robustlab.uncertainty.unstructured import Form

# Beyond the outermost candidates, where the ends of the axis are judged; candidates nearer than the last are one.
FAR, SAME = 1e3, 1e-9


def crossing_points(
    model: StateSpaceModel, centre: StateSpaceModel, form: Form, weight: StateSpaceModel
) -> Array | None:
    """Frequencies in rad/s, one between every two candidates: the error is below the weight where it is at all these.

    None where the zeros could not be computed.
    """
    try:
        parts = [bilinear_to_continuous(m) if m.is_discrete else m for m in (model, centre, weight)]
        zeros = transmission_zeros(_pencil(*_factors(parts[0], parts[1], form), parts[2]))
    except (RobustlabError, np.linalg.LinAlgError):
        return None
    height = np.abs(zeros.imag)
    speeds = np.abs(np.concatenate([*(p.poles() for p in parts), zeros]))
    speeds = speeds[np.isfinite(speeds) & (speeds > 0)]
    low, high = (float(speeds.min()), float(speeds.max())) if len(speeds) else (1.0, 1.0)
    height = np.unique(height[(height > 1e-9 * low) & np.isfinite(height)])
    apart = height[np.append(True, height[1:] > height[:-1] * (1.0 + SAME))] if len(height) else height
    points = np.concatenate([[low / FAR], apart, [high * FAR]])
    points = np.sort(points)
    between = np.concatenate([[0.5 * points[0]], np.sqrt(points[1:] * points[:-1]), [2.0 * points[-1]]])
    return 2.0 / model.dt * np.arctan(between * model.dt / 2.0) if model.is_discrete else between


def _factors(
    model: StateSpaceModel, centre: StateSpaceModel, form: Form
) -> tuple[StateSpaceModel | None, StateSpaceModel, StateSpaceModel | None]:
    """X, Y, Z of ``E = X^-1 Y Z^-1``; None stands for the identity."""
    forward, back = _difference(model, centre), _difference(centre, model)
    found: dict[str, tuple[StateSpaceModel | None, StateSpaceModel, StateSpaceModel | None]] = {
        "additive": (None, forward, None),
        "input-multiplicative": (centre, forward, None),
        "output-multiplicative": (None, forward, centre),
        "inverse-additive": (model, back, centre),
        "inverse-input-multiplicative": (model, back, None),
        "inverse-output-multiplicative": (None, back, model),
    }
    return found[form]


def _difference(a: StateSpaceModel, b: StateSpaceModel) -> StateSpaceModel:
    n, k = a.n_states, b.n_states
    A = np.block([[a.A, np.zeros((n, k))], [np.zeros((k, n)), b.A]])
    return StateSpaceModel(A, np.vstack([a.B, b.B]), np.hstack([a.C, -b.C]), a.D - b.D)


def _mirrored(m: StateSpaceModel) -> StateSpaceModel:
    """``G(-s)^T``."""
    return StateSpaceModel(-m.A.T, -m.C.T, m.B.T, m.D.T)


def _pencil(
    X: StateSpaceModel | None, Y: StateSpaceModel, Z: StateSpaceModel | None, weight: StateSpaceModel
) -> StateSpaceModel:
    """The matrix of the module as one model."""
    p, m = Y.n_outputs, Y.n_inputs
    bank = anonymous(append(*(weight.renamed([f"u{k}"], [f"y{k}"]) for k in range(m))))
    right = bank if Z is None else _chain(bank, anonymous(Z))
    x = anonymous(X) if X is not None else StateSpaceModel([], [], [], np.eye(p))
    return _blocks(_chain(_mirrored(x), x), Y, _mirrored(Y), _chain(right, _mirrored(right)))


def _chain(first: StateSpaceModel, second: StateSpaceModel) -> StateSpaceModel:
    """``second`` driven by ``first``."""
    n, k = first.n_states, second.n_states
    A = np.block([[first.A, np.zeros((n, k))], [second.B @ first.C, second.A]])
    B = np.vstack([first.B, second.B @ first.D])
    return StateSpaceModel(A, B, np.hstack([second.D @ first.C, second.C]), second.D @ first.D)


def _blocks(a: StateSpaceModel, b: StateSpaceModel, c: StateSpaceModel, d: StateSpaceModel) -> StateSpaceModel:
    """``[-a, b; c, -d]``."""
    from scipy.linalg import block_diag

    A = np.asarray(block_diag(a.A, b.A, c.A, d.A))
    p, m = a.n_inputs, b.n_inputs
    B = np.vstack(
        [np.hstack([k.B, np.zeros((k.n_states, m))]) if k in (a, c) else np.hstack([np.zeros((k.n_states, p)), k.B])
         for k in (a, b, c, d)]
    )  # fmt: skip
    C = np.vstack(
        [
            np.hstack([-a.C, b.C, np.zeros((len(a.C), c.n_states + d.n_states))]),
            np.hstack([np.zeros((len(c.C), a.n_states + b.n_states)), c.C, -d.C]),
        ]
    )
    return StateSpaceModel(A, B, C, np.block([[-a.D, b.D], [c.D, -d.D]]))
