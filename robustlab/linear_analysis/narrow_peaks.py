"""Modes next to the frequency axis: the frequencies of their narrow peaks, and states that decouple them."""

from __future__ import annotations

import numpy as np

from robustlab.arrays import AnyArray, Array
from robustlab.linear_analysis.magnitude import balancing_factors
from robustlab.statespace import StateSpaceModel

# Distance of a pole from the axis, as a share of its frequency, below which a grid may miss its peak.
NARROW = 0.02
# Points of a peak in half widths, between which the phase turns by equal angles.
INSIDE = np.tan(np.pi / 8 * np.arange(-3, 4))
# Distance from the axis, as a share of the size of A, below which rounding of A moves the peak noticeably.
BLURRED = 1e-6
# Product of the left and right eigenvector below which a mode cannot be decoupled from another one.
ALIKE = 1e-4
# Eigenvectors as parallel as this are one, found twice.
SAME = 1e-12
# Bits of the change of states: differences of much larger terms keep all digits of a double.
BITS = 192


def narrow_frequencies(poles: AnyArray) -> Array:
    """Return frequencies in rad/s inside the peak of every pole (of the s plane) next to the frequency axis."""
    distance, at = np.abs(np.real(poles))[:, None], np.imag(poles)[:, None]
    return np.unique((at + distance * INSIDE)[(at[:, 0] > 0) & (distance < NARROW * at)[:, 0]])


def modes_apart(model: StateSpaceModel) -> StateSpaceModel:
    """Decouple modes from all others whose damping is changed by rounding.

    The input or output gain of a mode that a zero nearly cancels is a difference of large terms; in a state of its own,
    scaled to equal input and output gains, it is a small number with all its digits. States are changed in ball
    arithmetic: only entries of the result are rounded, so the response does not depend on the basis.
    """
    poles: AnyArray = model.poles()
    if model.is_discrete:
        poles = np.log(poles[np.abs(poles) > 0])
    distance, at = np.abs(np.real(poles)), np.imag(poles)
    light = (at > 0) & (distance < NARROW * at)
    if not light.any():
        return model
    t = balancing_factors(model.A)
    A, B, C = model.A / t[:, None] * t, model.B / t[:, None], model.C * t
    poles = poles[light & (distance < BLURRED * np.linalg.norm(A, 1))]
    if not len(poles):
        return model
    if model.is_discrete:
        poles = np.exp(poles)
    right, left = (_eigenvectors(matrix, poles) for matrix in (A, A.T))
    inner = np.abs((left * right).sum(axis=0))  # of vectors of length one
    alone = np.abs(right.conj().T @ right - np.eye(len(poles))).max(axis=0, initial=0.0) < 1 - SAME
    kept = (inner > ALIKE) & alone
    left, right, inner = left[:, kept], right[:, kept], inner[kept]
    if not len(inner):
        return model
    driven = np.linalg.norm(left.T @ B, axis=1) / inner
    seen = np.linalg.norm(C @ right, axis=0)
    with np.errstate(all="ignore"):
        size = 2.0 ** np.round(0.5 * np.log2(driven / seen))
    right = right * np.where(np.isfinite(size) & (size > 0), size, 1.0)
    others = np.linalg.qr(np.hstack([np.real(left), np.imag(left)]), mode="complete")[0][:, 2 * len(inner) :]
    T = np.hstack([others, np.stack([np.real(right), np.imag(right)], axis=2).reshape(len(A), -1)])
    apart = in_states(StateSpaceModel(A, B, C, model.D, model.dt, model.inputs, model.outputs), T)
    return model if apart is None else apart  # None: the vectors are no basis


def in_states(model: StateSpaceModel, T: AnyArray) -> StateSpaceModel | None:
    """Return the model in states x' with ``x = T x'``, each entry rounded once; None if T is no basis."""
    from robustlab.verification.balls import exact, midpoints, precision

    with precision(BITS):
        basis = exact(T)
        try:
            parts = basis.solve(exact(model.A) * basis), basis.solve(exact(model.B)), exact(model.C) * basis
        except ZeroDivisionError:
            return None
        A, B, C = (midpoints(part) for part in parts)
    if not all(np.isfinite(part).all() for part in (A, B, C)):
        return None
    return StateSpaceModel(A, B, C, model.D, model.dt, model.inputs, model.outputs)


def _eigenvectors(matrix: AnyArray, values: AnyArray) -> AnyArray:
    """Return the eigenvectors of length one whose eigenvalues are nearest to these."""
    found, vectors = np.linalg.eig(matrix)
    return vectors[:, np.abs(found - values[:, None]).argmin(axis=1)]
