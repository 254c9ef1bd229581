r"""Destabilising perturbations of a state-space model: the smallest Delta that brings a pole to the stability boundary.

Real mu lives at isolated frequencies, so a frequency grid finds nothing. Instead one pole of

.. math:: A_\Delta = A + B \Delta (I - D \Delta)^{-1} C

is led to the axis in small steps, each the linearised move of least ``max |delta_i|``, and then along the axis to a
smaller Delta. A real pole that meets another and crosses at zero is found by the static problem
``det(I - M(0) Delta) = 0``. What counts in the end is the spectral abscissa of :math:`A_\Delta` alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robustlab.errors import NoTrustworthyNumber
from robustlab.frequency import frequency_response
from robustlab.mu_analysis.certificate import delta_norm, project, singularity
from robustlab.mu_analysis.delta_layout import delta_layout
from robustlab.mu_analysis.lower import SINGULAR, lower_bound
from robustlab.statespace import StateSpaceModel
from robustlab.uncertainty.blocks import Block, FullBlock, RealScalar, structure_size

__all__ = ["Destabilising", "perturbed_state_matrix", "smallest_destabilising"]

Array = NDArray[np.floating[Any]]
ComplexArray = NDArray[np.complexfloating[Any, Any]]

LEADING = 15  # steps that lead a pole to the axis
FOLLOWING = 35  # steps along the axis


@dataclass(frozen=True)
class Destabilising:
    """A Delta (q, p) with a pole on or right of the axis; an ill-posed loop has ``pole = inf``."""

    norm: float
    delta: ComplexArray
    pole: complex


def smallest_destabilising(
    model: StateSpaceModel, blocks: Sequence[Block], omega: Array, seed: int = 0, random_starts: int = 12
) -> Destabilising | None:
    """The smallest destabilising Delta found for a stable continuous model with Delta channels (p, q), or None.

    Parameters
    ----------
    omega
        Frequencies in rad/s at which the matrix problem is tried as well (it gives starts where blocks are complex).
    seed
        Seed of the random starts.
    """
    rng = np.random.default_rng(seed)
    candidates: list[ComplexArray] = []
    # A purely real Delta reaches isolated frequencies only: trying others would find nothing.
    tried = [0.0] if all(isinstance(b, RealScalar) for b in blocks) else [0.0, *omega]
    for w, m in zip(tried, frequency_response(model, np.array(tried)), strict=True):
        # At zero frequency M is real: its real Delta moves a real pole into the origin.
        _, delta = lower_bound(m, blocks, seed, restarts=12 if w == 0 else 4, steps=40 if w == 0 else 24)
        if delta is not None:
            candidates.append(delta)
    candidates.extend(_migrate(model, blocks, candidates, rng, random_starts))
    crossings = [c for c in (_first_crossing(model, blocks, d) for d in candidates) if c is not None]
    _, ill_posed = lower_bound(model.D.astype(complex), blocks, seed)
    if ill_posed is not None and singularity(model.D.astype(complex), ill_posed) <= SINGULAR * 1e3:
        crossings.append(Destabilising(delta_norm(blocks, ill_posed), ill_posed, complex(np.inf)))
    return min(crossings, key=lambda c: c.norm, default=None)


def perturbed_state_matrix(model: StateSpaceModel, delta: ComplexArray) -> ComplexArray:
    """``A + B Delta (I - D Delta)^-1 C`` for Delta (q, p), or a stack of them; Inf where the loop is ill-posed."""
    loop = np.eye(model.n_outputs) - model.D @ delta
    try:
        return model.A + model.B @ delta @ np.linalg.solve(
            loop, np.broadcast_to(model.C, (*delta.shape[:-2], *model.C.shape))
        )
    except np.linalg.LinAlgError:
        return np.full((*delta.shape[:-2], *model.A.shape), np.inf, dtype=complex)


def _rightmost(model: StateSpaceModel, delta: ComplexArray) -> complex:
    """The pole with the largest real part; inf where the loop is ill-posed."""
    a = perturbed_state_matrix(model, delta)
    if not np.isfinite(a).all():
        return complex(np.inf)
    if not np.any(a.imag):
        a = a.real
    poles = np.linalg.eigvals(a)
    return complex(poles[poles.real.argmax()]) if len(poles) else complex(-np.inf)


def _first_crossing(model: StateSpaceModel, blocks: Sequence[Block], delta: ComplexArray) -> Destabilising | None:
    """The smallest multiple of Delta found, up to a little more than itself, at which the model is not stable."""
    delta = project(blocks, delta)
    if not np.isfinite(delta).all() or not delta.any():
        return None
    factors = np.concatenate([np.linspace(0.1, 1.0, 10), 1 + 10.0 ** np.arange(-12, -3)])
    stable = 0.0
    unstable = next((f for f in factors if _rightmost(model, f * delta).real >= 0), None)
    if unstable is None:
        return None
    for f in factors[factors < unstable]:
        stable = f
    for _ in range(60):
        middle = (stable + unstable) / 2
        if not stable < middle < unstable or unstable - stable < 1e-13 * unstable:
            break
        if _rightmost(model, middle * delta).real >= 0:
            unstable = middle
        else:
            stable = middle
    return _on_the_axis(model, blocks, unstable * delta)


def _on_the_axis(model: StateSpaceModel, blocks: Sequence[Block], delta: ComplexArray) -> Destabilising:
    """The crossing at a multiple of Delta, by ``det(I - M(j omega) Delta) = 0`` where that is the better witness.

    Eigenvalues are accurate to rounding of the largest one only: beside fast poles a slow one seems to cross long
    before it does. ``M(j omega) Delta`` then has an eigenvalue that is real but not one, and dividing by it ends at the
    crossing itself.
    """
    pole = _rightmost(model, delta)
    as_found = Destabilising(delta_norm(blocks, delta), delta, pole)
    if not np.isfinite(pole) or pole.real > 1e-6 * np.abs(model.A).max():
        return as_found
    try:
        loop = frequency_response(model, np.array([pole.imag]))[0] @ delta
    except NoTrustworthyNumber:
        return as_found
    values = np.linalg.eigvals(loop)
    nearest = complex(values[np.abs(values - 1).argmin()])
    if nearest.real <= 0 or abs(nearest.imag) > 1e-3 * abs(nearest - 1) + 1e-12:
        return as_found
    exact = delta / nearest.real
    return Destabilising(delta_norm(blocks, exact), exact, complex(0.0, pole.imag))


# --- migration -------------------------------------------------------------------------------------------------------


def _migrate(
    model: StateSpaceModel,
    blocks: Sequence[Block],
    given: Sequence[ComplexArray],
    rng: np.random.Generator,
    random_starts: int,
) -> list[ComplexArray]:
    """Deltas that have a pole close to the axis; one path per nominal pole and per random or given start."""
    if not model.n_states:
        return []
    deltas, poles = _starts(model, blocks, given, rng, random_starts)
    speed = np.maximum(np.abs(poles), 1e-9 * np.abs(model.A).max())
    best, best_norm = deltas.copy(), np.full(len(deltas), np.inf)
    for step in range(LEADING + FOLLOWING):
        try:
            pole, row, x = _eigenstructure(model, deltas, poles)
        except np.linalg.LinAlgError:
            break
        norms = np.array([delta_norm(blocks, d) for d in deltas])
        arrived = (np.abs(pole.real) <= 1e-6 * speed) & (norms < best_norm) & (norms > 0)
        best[arrived], best_norm[arrived] = deltas[arrived], norms[arrived]
        goal = pole.real * (1 - 1 / (LEADING - step)) if step < LEADING else np.zeros(len(pole))
        new = _least_move(blocks, deltas, pole, row, x, goal=goal)
        if LEADING <= step < LEADING + FOLLOWING - 8:
            gain = 0.3 + 0.7 * rng.random(len(new))
            new = deltas + gain[:, None, None] * (new - deltas)
        elif step >= LEADING + FOLLOWING - 8:
            new = _scaled_to_axis(deltas, pole, row, x)
        new = np.where((np.abs(new).max(axis=(1, 2)) < 1e8)[:, None, None], new, deltas)
        moved = np.einsum("km,kmp,kp->k", row, new - deltas, x)
        reach = 0.5 * np.abs(pole) + 1e-3 * speed
        poles = pole + moved * np.minimum(1.0, reach / np.maximum(np.abs(moved), 1e-100 * speed + 1e-200))
        deltas = new
    return [best[k] for k in np.argsort(best_norm) if np.isfinite(best_norm[k])]


def _starts(
    model: StateSpaceModel,
    blocks: Sequence[Block],
    given: Sequence[ComplexArray],
    rng: np.random.Generator,
    random_starts: int,
) -> tuple[ComplexArray, ComplexArray]:
    """Starting Deltas (k, q, p) and the pole to follow from each."""
    q, p = structure_size(blocks)
    nominal = model.poles()
    upper = nominal[nominal.imag >= 0]
    deltas, poles = [np.zeros((q, p), dtype=complex) for _ in upper], list(upper)
    zero = np.zeros((len(upper), q, p), dtype=complex)
    pole, row, x = _eigenstructure(model, zero, np.array(upper))
    gains = np.abs(delta_layout(blocks).gains(row, x)).sum(axis=1)
    distance = float(np.median(np.minimum(-pole.real / np.maximum(gains, 1e-300), 1e6)))
    for k in range(random_starts):
        values = rng.uniform(-1, 1, (1, len(blocks))) if k % 2 else rng.choice([-1.0, 1.0], (1, len(blocks)))
        values = values * distance * 10 ** rng.uniform(-1, 0.3)
        delta = delta_layout(blocks).deltas(
            values.astype(complex), *(rng.standard_normal((1, n)).astype(complex) for n in (q, p))
        )[0]
        deltas.append(delta)
        poles.append(_rightmost(model, delta))
    for delta in given:
        deltas.append(delta)
        poles.append(_rightmost(model, delta))
    keep = [k for k, pole in enumerate(poles) if np.isfinite(pole)]
    return np.stack([deltas[k] for k in keep]), np.array([poles[k] for k in keep])


def _eigenstructure(
    model: StateSpaceModel, deltas: ComplexArray, aims: ComplexArray
) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
    """The pole next to each aim, and row, x with ``d pole = row dDelta x``."""
    a = perturbed_state_matrix(model, deltas)
    if not np.isfinite(a).all():
        raise np.linalg.LinAlgError("ill-posed")
    values, right = np.linalg.eig(a)
    k = np.abs(values - aims[:, None]).argmin(axis=1)
    index = np.arange(len(deltas))
    # Rows of V^-1 are the left eigenvectors with u v = 1; the shift keeps defective cases solvable.
    left = np.linalg.inv(right + 1e-13 * np.eye(right.shape[-1]))[index, k]
    v = right[index, :, k]
    loop = np.eye(model.n_outputs) - model.D @ deltas
    x = np.linalg.solve(loop, (v @ model.C.T)[..., None])[..., 0]
    back = np.eye(model.n_inputs) - deltas @ model.D
    row = np.linalg.solve(np.swapaxes(back, 1, 2), (left @ model.B)[..., None])[..., 0]
    return values[index, k], row, x


def _least_move(
    blocks: Sequence[Block],
    deltas: ComplexArray,
    pole: ComplexArray,
    row: ComplexArray,
    x: ComplexArray,
    *,
    goal: Array,
) -> ComplexArray:
    """The Delta of least norm that, to first order, puts the real part of the pole at ``goal``."""
    gains = delta_layout(blocks).gains(row, x)
    real = np.array([isinstance(b, RealScalar) for b in blocks])
    now = np.einsum("km,kmp,kp->k", row, deltas, x)
    strength = np.where(real, np.abs(gains.real), np.abs(gains)).sum(axis=1)
    tau = np.maximum((goal - pole.real + now.real) / np.maximum(strength, 1e-300), 0.0)
    unit = np.where(real, np.sign(gains.real), np.conj(gains) / np.maximum(np.abs(gains), 1e-300))
    for i, block in enumerate(blocks):
        if isinstance(block, FullBlock):
            unit[:, i] = 1.0
    return delta_layout(blocks).deltas(tau[:, None] * unit, row, x)


def _scaled_to_axis(deltas: ComplexArray, pole: ComplexArray, row: ComplexArray, x: ComplexArray) -> ComplexArray:
    """Newton step on the size of Delta alone."""
    slope = np.einsum("km,kmp,kp->k", row, deltas, x).real
    factor = 1 - pole.real / np.where(np.abs(slope) < 1e-300, 1e-300, slope)
    return deltas * np.clip(factor, 0.5, 2.0)[:, None, None]
