"""Realises a complex Delta at one frequency by stable systems of the same norm."""

# An all-pass +-|d| (a - s)/(a + s) realises a complex number. A unitary matrix is O1 diag(e^(j theta)) O2 with real
# orthogonal O1, O2, where O1 diagonalises the real and the imaginary part of U U^T: only phases must be realised.
# The singular values are those of Delta at every frequency, hence so is the H-infinity norm, for any rank.

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from robustlab.arrays import Array, ComplexArray
from robustlab.checks import number
from robustlab.conversion import cascade
from robustlab.errors import InputError, NoTrustworthyNumber, error_context
from robustlab.linear_analysis.frequency import frequency_response
from robustlab.norms import bilinear_to_discrete
from robustlab.statespace import StateSpaceModel, append, series
from robustlab.uncertainty.blocks import Block, delta_matrix

REAL = 1e-7  # relative imaginary part that is rounding where only real values exist (omega = 0, end of the axis)
END = 1e-9  # a discrete frequency is an end of the axis if omega dt / 2 is this close to 0 or pi / 2
MISSED = 1e-10  # allowed relative error of a realised value
NEAR = 1e-2  # phases closer to 0 than this need two factors: one would have its pole 1/NEAR away from omega
MIX = 0.5772156649  # of real and imaginary part
NOTHING = 1e-14  # relative singular values below this are not realised


@error_context("realise_delta")
def realise_delta(
    blocks: Sequence[Block], delta: Mapping[str, Any], omega: float, dt: float = 0.0
) -> dict[str, float | StateSpaceModel]:
    """Return stable systems for the blocks of a complex Delta, of its H-infinity norm, equal to it at ``omega``."""
    where = "realise_delta"
    number(f"{where}: dt", dt, "0 (continuous) or a positive sample time in s", at_least=0)
    end = np.pi / dt if dt else np.inf
    if omega is None or np.ndim(omega) or not 0 <= omega <= end * (1 + 1e-12):
        raise InputError(where, f"omega = {omega} rad/s", f"between 0 and {end:g} rad/s")
    delta_matrix(blocks, delta)  # names, shapes and finite numbers
    result: dict[str, Any] = {}
    for block in blocks:
        if block.name not in delta:
            continue
        value = np.asarray(delta[block.name], dtype=complex)
        if block.is_real:
            result[block.name] = np.real(value).reshape(()).item() if block.is_scalar else np.real(value)
            continue
        matrix = value.reshape(block.value_shape)
        result[block.name] = _realised(matrix, float(omega), dt, f"{where}: block {block.name!r}")
    return result


def _realised(value: ComplexArray, omega: float, dt: float, where: str) -> StateSpaceModel:
    """Return a stable model (rows, cols) of the norm of ``value`` that equals it at ``omega``, checked."""
    turn = omega * dt / 2
    # A discrete slow pole is stored as its distance to z = 1, and too close to it the phase is lost in rounding.
    at_end = not END < turn < np.pi / 2 - END if dt else omega == 0 or not np.isfinite(omega)
    size = float(np.abs(value).max(initial=0.0))
    if at_end or not np.any(value.imag):
        if np.abs(value.imag).max(initial=0.0) > REAL * size:
            found = f"a complex value at omega = {omega:g} rad/s, where models with real coefficients are real"
            raise InputError(where, found, "a real value", "take a frequency close by")
        return StateSpaceModel([], [], [], value.real, dt)
    # In discrete time s = (2/dt) (z - 1)/(z + 1) bends the axis.
    at = 2 / dt * float(np.tan(turn)) if dt else omega
    if value.shape == (1, 1):
        made = _scaled(np.angle(value[0]), at, np.abs(value), np.eye(1))
    else:
        made = _matrix(value, at)
    made = bilinear_to_discrete(made, dt) if dt else made
    missed = float(np.abs(frequency_response(made, [omega])[0] - value).max())
    lost = 1e3 * np.finfo(float).eps / np.sin(omega * dt) if dt else 0.0
    if missed > (MISSED + lost) * size or not made.is_stable():
        raise NoTrustworthyNumber(where, f"the realisation misses its value by {missed / size:.1e} at {omega:g} rad/s")
    return made


def _matrix(value: ComplexArray, omega: float) -> StateSpaceModel:
    """Realise ``U diag(sigma) V^H`` with both unitary factors in their real-orthogonal and phase parts."""
    u, sigma, vh = np.linalg.svd(value, full_matrices=False)
    rank = int((sigma > NOTHING * sigma[0]).sum())
    left, theta, mid_left = _orthogonal_and_phases(u[:, :rank])
    right, phi, mid_right = _orthogonal_and_phases(vh[:rank].T)
    # U e^{-j t} and e^{j t} V^H give the same product: one phase of U becomes 0 and needs no state.
    shift = float(theta[0])
    # value = left e^{j theta} (mid_left diag(sigma) mid_right^T) e^{j phi} right^T
    middle = mid_left * sigma[:rank] @ mid_right.T
    inner = _scaled(phi + shift, omega, middle, right.T)
    return series(inner, _scaled(theta - shift, omega, left, np.eye(len(theta))))


def _orthogonal_and_phases(columns: ComplexArray) -> tuple[Array, Array, Array]:
    """Factor ``columns = left diag(e^{j theta}) right`` for orthonormal columns (n, r): left (n, m), right (m, r)."""
    basis, s, _ = np.linalg.svd(np.hstack([columns.real, columns.imag]), full_matrices=False)
    basis = basis[:, s > 1e-13]
    small = basis.T @ columns
    # Completed to a square unitary matrix.
    unitary = np.hstack([small, np.linalg.svd(small, full_matrices=True)[0][:, small.shape[1] :]])
    symmetric = unitary @ unitary.T

    # Real and imaginary part commute; a generic combination of them has their common eigenvectors.
    _, vectors = np.linalg.eigh(symmetric.real + MIX * symmetric.imag)
    theta = np.angle(np.einsum("ik,ij,jk->k", vectors, symmetric, vectors)) / 2
    right = np.exp(-1j * theta)[:, None] * (vectors.T @ small)
    return basis @ vectors, theta, right.real


def _scaled(theta: Array, omega: float, left: Array, right: Array) -> StateSpaceModel:
    """Return ``left diag(all-pass functions) right``, the functions with these phases at omega."""
    channels = [_all_pass(float(np.angle(np.exp(1j * t))), omega) for t in theta]
    m = append(*(channel.renamed([f"u{k}"], [f"y{k}"]) for k, channel in enumerate(channels)))
    return StateSpaceModel(m.A, m.B @ right, left @ m.C, left @ m.D @ right)


def _all_pass(theta: float, omega: float) -> StateSpaceModel:
    """Return ``sign`` times a product of factors ``(a - s)/(a + s)`` with this phase at omega."""
    sign, corners = 1.0 if abs(theta) <= np.pi / 2 else -1.0, []
    small = theta if sign > 0 else theta - np.copysign(np.pi, theta)
    if abs(np.sin(theta)) > 4 * np.finfo(float).eps:
        if abs(small) < NEAR:
            # +90 degrees and back: both poles are next to omega.
            sign, corners = -sign, [omega, omega / np.tan(np.pi / 4 - small / 2)]
        else:  # (a - s)/(a + s) turns by -2 atan(omega / a): between 0 and -180 degrees
            sign, corner = (1.0, omega / np.tan(-theta / 2)) if theta < 0 else (-1.0, omega * np.tan(theta / 2))
            corners = [corner]
    return cascade(corners, [-a for a in corners], sign * (-1.0) ** len(corners), 0.0, "realise_delta")
