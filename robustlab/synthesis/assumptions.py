"""What a stabilising controller needs: every mode that is not stable is controllable and observable."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from robustlab.errors import NoTrustworthyNumber
from robustlab.synthesis.partition import PlantMatrices

__all__ = ["require_stabilisable"]

# sigma_min of the Popov-Belevitch-Hautus matrix below this share of its norm counts as rank loss (plant scaled to
# order one).
PBH_TOLERANCE = 1e-11
# Real parts within this share of the largest modulus count as "on the axis".
AXIS = 1e-10


def require_stabilisable(p: PlantMatrices, states: tuple[str, ...], where: str, rate: float = 1.0) -> None:
    r"""Popov-Belevitch-Hautus test of all unstable and marginal modes.

    .. math:: \mathrm{rank}\,[A - \lambda I,\ B_2] = n, \qquad \mathrm{rank}\,[A - \lambda I;\ C_2] = n

    Parameters
    ----------
    p
        Scaled plant; its time unit is ``1/rate`` s.
    states
        Names of its states, for the message.

    Raises
    ------
    NoTrustworthyNumber
        A mode fails; the message says which, whether the controls cannot move it or the measurements do not see it, and
        the state that takes part in it most.
    """
    if not p.A.size:
        return
    poles = np.linalg.eigvals(p.A)
    size = max(float(np.abs(poles).max()), 1e-300)
    faults: list[str] = []
    for pole in poles[(poles.real >= -AXIS * size) & (poles.imag >= 0)]:
        shifted = p.A - pole * np.eye(p.A.shape[0])
        for matrix, text in (
            (np.hstack([shifted, p.B2]).conj().T, "cannot be moved by the controls"),
            (np.vstack([shifted, p.C2]), "does not show in the measurements"),
        ):
            state = _null_state(matrix)
            if state is not None:
                kind = "unstable" if pole.real > AXIS * size else "marginal"
                faults.append(f"{kind} mode s = {_text(pole * rate)} rad/s (mostly state {states[state]}) {text}")
    if faults:
        raise NoTrustworthyNumber(
            where,
            f"no stabilising controller exists: {faults[0]}",
            hint="add an actuator or a sensor for it, or take it out (robustlab.structural.drop_unconnected)",
            more=tuple(dict.fromkeys(faults[1:])),
        )


def _null_state(matrix: NDArray[Any]) -> int | None:
    """Index of the largest entry of the null vector of a tall matrix, or None where it has full column rank."""
    n = matrix.shape[1]
    _, sigma, vh = np.linalg.svd(matrix)
    if len(sigma) == n and sigma[-1] > PBH_TOLERANCE * max(float(sigma[0]), 1.0):
        return None
    return int(np.argmax(np.abs(vh[n - 1])))


def _text(pole: complex) -> str:
    return f"{pole.real:.6g}" if abs(pole.imag) <= AXIS * abs(pole) else f"{pole.real:.6g}{pole.imag:+.6g}j"
