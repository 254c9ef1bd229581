"""Required of a plant: stabilisable modes; assumptions of the Riccati method: direct penalties and noises."""

from __future__ import annotations

from typing import Any

import numpy as np

from robustlab.arrays import AnyArray, Array
from robustlab.errors import NoTrustworthyNumber
from robustlab.linear_analysis import slicot
from robustlab.synthesis.problem.partition import GeneralizedPlant, PlantMatrices, dual

# sigma_min of the Popov-Belevitch-Hautus matrix below this share of its norm counts as rank loss (plant scaled to
# order one).
PBH_TOLERANCE = 1e-11
# Channels weaker than this share of the fastest pole are scaled up to it before the test.
WEAK = 1e-6
# Real parts within this share of the largest modulus count as "on the axis".
AXIS = 1e-10
# A singular value of D12 or D21 below this (plant scaled to order one) is regularised.
DIRECT = 1e-6
# sigma_min of the system matrix below this share of its norm is a zero; candidates this near to the axis are tested.
ZERO, NEAR = 1e-9, 1e-5


def require_stabilisable(p: PlantMatrices, states: tuple[str, ...], where: str, rate: float = 1.0) -> None:
    """Apply the Popov-Belevitch-Hautus test to all unstable and marginal modes."""
    if not p.A.size:
        return
    poles = np.linalg.eigvals(p.A)
    size = max(float(np.abs(poles).max()), 1e-300)
    # The strength of a control or a measurement depends on its unit: each counts as if it were as large as A.
    into, out = _like(p.B2, 0, size), _like(p.C2, 1, size)
    faults: list[str] = []
    for pole in poles[(poles.real >= -AXIS * size) & (poles.imag >= 0)]:
        shifted = p.A - pole * np.eye(p.A.shape[0])
        for matrix, text in (
            (np.hstack([shifted, into]).conj().T, "cannot be moved by the controls"),
            (np.vstack([shifted, out]), "does not show in the measurements"),
        ):
            state = _null_state(matrix)
            if state is not None:
                kind = "unstable" if pole.real > AXIS * size else "marginal"
                faults.append(f"{kind} mode s = {_text(pole * rate)} rad/s (mostly state {states[state]}) {text}")
    if faults:
        hint = "add an actuator or a sensor for it; rl.minimal takes out what is hidden from all signals"
        found = f"no stabilising controller exists: {faults[0]}"
        raise NoTrustworthyNumber(where, found, hint=hint, more=tuple(dict.fromkeys(faults[1:])))


def _like(matrix: AnyArray, axis: int, size: float) -> AnyArray:
    """Scale columns (axis 0) or rows (axis 1) up to ``size`` that would else be indistinguishable from rounding."""
    norms = np.linalg.norm(matrix, axis=axis, keepdims=True)
    weak = (norms > 0) & (norms < WEAK * size)
    return matrix * np.where(weak, size / np.where(weak, norms, 1.0), 1.0)


def _null_state(matrix: AnyArray) -> int | None:
    """Return the index of the largest entry of the null vector of a tall matrix; None if it has full column rank."""
    n = matrix.shape[1]
    _, sigma, vh = np.linalg.svd(matrix)
    if len(sigma) == n and sigma[-1] > PBH_TOLERANCE * max(float(sigma[0]), 1.0):
        return None
    return int(np.argmax(np.abs(vh[n - 1])))


def _text(pole: complex) -> str:
    return f"{pole.real:.6g}" if abs(pole.imag) <= AXIS * abs(pole) else f"{pole.real:.6g}{pole.imag:+.6g}j"


def broken_assumptions(p: PlantMatrices, plant: GeneralizedPlant, rate: float = 1.0) -> tuple[str, ...]:
    """Return the assumptions of the Riccati method that the plant violates, each with its physical meaning."""
    controls, measurements = ([s.name for s in group] for group in (plant.controls, plant.measurements))
    found = [
        f"{name} has no direct penalty: no performance output limits how fast it may act (D12 lacks column rank)"
        for name in _free_channels(p.D12, controls, "control")
    ]
    found += [
        f"{name} has no direct noise: nothing limits how much it may be differentiated (D21 lacks row rank)"
        for name in _free_channels(p.D21.T, measurements, "measurement")
    ]
    states = plant.model.state_names
    missing = ("performance output showing it", "disturbance driving it through the measurements")
    for side, text in zip((p, dual(p)), missing, strict=True):
        found += [
            f"zero on the axis at {_rounded(omega * rate)} rad/s: a motion mostly of {states[state]} can go on "
            f"undamped without any {text}"
            for omega, state in _axis_zeros(side.A, side.B2, side.C1, side.D12)
        ]
    return tuple(found)


def _free_channels(D: Array, names: list[str], kind: str) -> list[str]:
    """Return the channels, or combinations of channels, in the null space of the columns of D."""
    _, sigma, vh = np.linalg.svd(D)
    rank = int((sigma > DIRECT * max(1.0, sigma.max(initial=0.0))).sum())
    free = []
    for row in vh[rank:]:
        main = np.flatnonzero(np.abs(row) > 0.1)
        if len(main) == 1:
            free.append(f"{kind} {names[main[0]]}")
        else:
            free.append(f"a combination of the {kind}s {', '.join(names[i] for i in main)}")
    return list(dict.fromkeys(free))


def _axis_zeros(A: Any, B: Any, C: Any, D: Any) -> list[tuple[float, int]]:
    """Return the frequencies at which ``[A - jw, B; C, D]`` loses column rank, with the state of largest share."""
    n, m = B.shape
    if n == 0 or len(C) < m:
        return []
    found, whole = list[tuple[float, int]](), np.block([[A, B], [C, D]]).astype(complex)
    size = float(np.linalg.norm(whole, 2))
    for zero in slicot.invariant_zeros(A, B, C, D)[0]:
        if abs(zero.real) > NEAR * max(abs(zero), 1e-3 * size) or zero.imag < 0:
            continue
        matrix = whole.copy()
        matrix[range(n), range(n)] -= 1j * zero.imag
        _, sigma, vh = np.linalg.svd(matrix)
        if sigma[n + m - 1] <= ZERO * size and not any(abs(zero.imag - w) <= 1e-6 * size for w, _ in found):
            found.append((float(zero.imag), int(np.argmax(np.abs(vh[n + m - 1, :n])))))
    return sorted(found)


def _rounded(omega: float) -> str:
    return f"{omega:.4g}" if abs(omega) > 1e-9 else "0"
