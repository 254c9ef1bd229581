r"""Whether an error of a form stays below a weight at all frequencies: no crossing is missing between points.

Every error of `robustlab.uncertainty.unstructured` is :math:`E = X^{-1} Y Z^{-1}` with X, Y, Z made of the two models,
and :math:`\bar\sigma(E) = |w|` at a frequency makes

.. math:: \begin{bmatrix} -X X^\sim & Y \\ Y^\sim & -(w Z)^\sim (w Z) \end{bmatrix}, \qquad X^\sim(s) = X(-s)^T,

singular there. With a signal between every two factors it is a pencil of the models' own entries, whose determinant is
an even polynomial, computed in whole numbers. Every root counts as a candidate, those beside the axis too. Between two
candidates the error is either above the weight everywhere or nowhere, and one point tells. The responses at the points
are floating point, not interval arithmetic.

References
----------
Boyd, Balakrishnan, "A regularity result for the singular values of a transfer matrix", Systems & Control Letters 15
(1990).
"""

from __future__ import annotations

import numpy as np

from robustlab.arrays import Array, ComplexArray
from robustlab.errors import RobustlabError
from robustlab.linear_analysis.exact import MOST_STATES, determinant, even_and_odd, roots, wired
from robustlab.linear_analysis.frequency import frequency_response
from robustlab.norms import bilinear_to_continuous
from robustlab.statespace import StateSpaceModel
from robustlab.uncertainty.unstructured import Form

# Beyond the outermost candidates, where the ends of the axis are judged; candidates nearer than the last are one.
FAR, SAME = 1e3, 1e-13
EPS, SHARE = float(np.finfo(float).eps), 1e-3
Difference = tuple[StateSpaceModel, StateSpaceModel]  # the first minus the second


def crossing_points(
    model: StateSpaceModel, centre: StateSpaceModel, form: Form, weight: StateSpaceModel
) -> Array | None:
    """Frequencies in rad/s, one between every two candidates: the error is below the weight where it is at all these.

    Errors with an inverse are looked at up to where rounding of the models' entries decides their responses. None where
    the candidates could not be computed, and where error and weight are equal at all frequencies.
    """
    try:
        parts = [bilinear_to_continuous(m) if m.is_discrete else m for m in (model, centre, weight)]
        zeros = _candidates(*_factors(parts[0], parts[1], form), parts[2])
        end = np.inf if form == "additive" else min(_end(m, parts[2]) for m in parts[:2])
    except RobustlabError:
        return None
    if zeros is None:
        return None
    height = np.abs(zeros.imag)
    speeds = np.abs(np.concatenate([*(p.poles() for p in parts), zeros]))
    speeds = speeds[np.isfinite(speeds) & (speeds > 0) & (speeds < end)]
    low, high = (float(speeds.min()), float(speeds.max())) if len(speeds) else (1.0, 1.0)
    height = np.unique(height[(height > 1e-9 * low) & np.isfinite(height) & (height < end)])
    apart = height[np.append(True, height[1:] > height[:-1] * (1.0 + SAME))] if len(height) else height
    points = np.concatenate([[low / FAR], apart, [high * FAR]])
    points = np.sort(points)
    between = np.concatenate([[0.5 * points[0]], np.sqrt(points[1:] * points[:-1]), [2.0 * points[-1]]])
    between = np.unique(np.minimum(between, end))
    return 2.0 / model.dt * np.arctan(between * model.dt / 2.0) if model.is_discrete else between


def _end(m: StateSpaceModel, weight: StateSpaceModel) -> float:
    """Decades above its poles up to which rounding of m's entries makes a relative error below SHARE of the weight."""
    last = float(np.abs(m.poles()).max(initial=0.0)) or 1.0
    omega = last * 10.0 ** np.arange(1, 20)
    allowed = SHARE * np.abs(frequency_response(weight, omega)[:, 0, 0])
    for w, share in zip(omega.tolist(), allowed.tolist(), strict=True):
        inside = np.linalg.inv(1j * w * np.eye(m.n_states) - m.A)
        rounding = EPS * (np.abs(m.C) @ np.abs(inside) @ np.abs(m.B) + np.abs(m.D)).max()
        if rounding > share * np.linalg.svd(m.C @ inside @ m.B + m.D, compute_uv=False).min():
            return w
    return np.inf


def _factors(
    model: StateSpaceModel, centre: StateSpaceModel, form: Form
) -> tuple[StateSpaceModel | None, Difference, StateSpaceModel | None]:
    """X, Y, Z of ``E = X^-1 Y Z^-1``; None stands for the identity."""
    forward, back = (model, centre), (centre, model)
    found: dict[str, tuple[StateSpaceModel | None, Difference, StateSpaceModel | None]] = {
        "additive": (None, forward, None),
        "input-multiplicative": (centre, forward, None),
        "output-multiplicative": (None, forward, centre),
        "inverse-additive": (model, back, centre),
        "inverse-input-multiplicative": (model, back, None),
        "inverse-output-multiplicative": (None, back, model),
    }
    return found[form]


def _mirrored(m: StateSpaceModel) -> StateSpaceModel:
    """``G(-s)^T``."""
    return StateSpaceModel(-m.A.T, -m.C.T, m.B.T, m.D.T)


def _candidates(
    X: StateSpaceModel | None, Y: Difference, Z: StateSpaceModel | None, weight: StateSpaceModel
) -> ComplexArray | None:
    """Zeros of the matrix of the module in the upper half plane or on the real axis.

    None for more states than are solved exactly, and for a matrix that is singular everywhere. With signals v = X~ a,
    t = Z b, q = w t, r = w~ q, g = Y_2 b, h = Y_2~ a its rows are ``-X v + Y_1 b - g = 0``, ``Y_1~ a - h - Z~ r = 0``.
    """
    p, m = Y[0].D.shape
    sizes = [p, m, p if X is not None else 0, m if Z is not None else 0, m, m, p, m]
    a, b, v, t, q, r, g, h = np.split(np.arange(sum(sizes)), np.cumsum(sizes)[:-1])
    J = np.zeros((sum(sizes), sum(sizes)))
    J[range(p + m, len(J)), range(p + m, len(J))] = -1.0
    J[a, g], J[b, h] = -1.0, -1.0
    blocks = [(Y[0], b, a, 1), (Y[1], b, g, 1), (_mirrored(Y[0]), a, b, 1), (_mirrored(Y[1]), a, h, 1)]
    if X is not None:
        blocks += [(X, v, a, -1), (_mirrored(X), a, v, 1)]
    else:
        J[a, a] = -1.0
    if Z is not None:
        blocks += [(Z, b, t, 1), (_mirrored(Z), r, b, -1)]
    else:
        t, J[b, r] = b, -1.0
    for k in range(m):
        blocks += [(weight, t[[k]], q[[k]], 1), (_mirrored(weight), q[[k]], r[[k]], 1)]
    M, n = wired(blocks, J)
    if n > MOST_STATES:
        return None
    found, _ = determinant(M, n)
    if not found:
        return None
    x = [root.value for root in roots(even_and_odd(found)[0])]
    return 1j * np.sqrt(np.array(x, dtype=complex))
