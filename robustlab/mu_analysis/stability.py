"""Robust stability of an uncertain model over the whole frequency axis."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robustlab.errors import InputError, NoTrustworthyNumber
from robustlab.frequency import default_grid, frequency_response
from robustlab.mu_analysis.intervals import AxisCover, cover_axis
from robustlab.mu_analysis.lower import lower_bound
from robustlab.mu_analysis.pole_migration import Destabilising, smallest_destabilising
from robustlab.mu_analysis.upper import upper_bounds
from robustlab.result import Status
from robustlab.statespace import StateSpaceModel
from robustlab.uncertainty.blocks import Block, block_slices, delta_values
from robustlab.uncertainty.lft import UncertainModel

__all__ = ["Margin", "robust_stability"]

Array = NDArray[np.floating[Any]]


@dataclass(frozen=True, eq=False)
class Margin:
    """Robust stability margin: the model is stable for all Delta of norm below ``lower``, and not for ``delta``.

    Attributes
    ----------
    lower, upper
        ``lower <= margin <= upper``; ``lower`` holds over the whole frequency axis where the status is CERTIFIED
        (else it is 0). Both are inf where nothing can destabilise.
    frequency
        Frequency in rad/s at which ``delta`` brings a pole to the stability boundary; None where no such Delta was
        found.
    delta
        The critical Delta, one value per block name; empty where none was found.
    physical
        The critical values and units of the physical parameters.
    pole
        The pole of the model perturbed by ``delta`` that lies on or beyond the stability boundary.
    status
        CERTIFIED: ``lower`` proved on the whole axis. TIMEOUT: ``open`` intervals are left, ``mu_upper`` holds on the
        grid only.
    omega, mu_lower, mu_upper
        Bounds of mu at the grid frequencies, for the figure; what lies between grid points is in ``intervals``.
    intervals
        ``(low, high, mu_upper)`` in rad/s: what is proved, together covering [0, inf] where the status is CERTIFIED.
    open
        Frequency intervals for which nothing is proved.
    notes
        Remarks for the reader of a report.
    """

    lower: float
    upper: float
    frequency: float | None
    delta: Mapping[str, Any]
    status: Status
    physical: Mapping[str, tuple[float, str]]
    pole: complex | None
    omega: Array
    mu_lower: Array
    mu_upper: Array
    intervals: tuple[tuple[float, float, float], ...]
    open: tuple[tuple[float, float], ...]
    notes: tuple[str, ...]

    def to_json(self) -> dict[str, Any]:
        """All attributes; arrays stay arrays."""
        return {"type": "Margin", **{name: getattr(self, name) for name in self.__dataclass_fields__}}


def robust_stability(
    uncertain: UncertainModel,
    omega: ArrayLike | None = None,
    accuracy: float = 0.001,
    time_limit: float = 60.0,
    seed: int = 0,
) -> Margin:
    r"""Robust stability margin :math:`1 / \sup_\omega \mu(M_{11}(j \omega))` over the whole axis.

    ``lower`` is proved: intervals on which constant D, G satisfy the D-G inequality cover [0, inf]. ``upper`` is
    attained: the model perturbed by ``delta`` has a pole on the stability boundary. A discrete model is mapped by
    ``s = (z - 1) / (z + 1)``, under which the unit circle becomes the axis and mu does not change.

    The proof is carried out in floating-point arithmetic with a slack of 5e-6 in mu: the signs of the inequality are
    tested at and between all candidates that the Hamiltonian's eigenvalues give. It is not interval arithmetic.

    Parameters
    ----------
    uncertain
        Uncertain model, continuous or discrete.
    omega
        Frequencies in rad/s for ``mu_lower`` and ``mu_upper``; by default a grid around the model's dynamics.
    accuracy
        Relative distance to which ``lower`` approaches the best margin that D, G scalings can prove.
    time_limit
        Time in s after which the cover of the axis is given up; the search for ``delta`` and the grid come on top.
    seed
        Seed of the search for the critical Delta.

    Raises
    ------
    NoTrustworthyNumber
        The nominal model is unstable.

    References
    ----------
    Doyle (1982); Sideris, "Elimination of frequency search from robustness tests" (1992); Ly, Safonov, Chiang (1998).
    """
    if not isinstance(uncertain, UncertainModel):
        raise InputError("robust_stability", type(uncertain).__name__, "an UncertainModel")
    started = time.monotonic()
    _check_nominal(uncertain)
    blocks = uncertain.blocks
    model = _continuous(uncertain.delta_channels)
    grid = _grid(uncertain.M, omega)
    if not blocks:
        zero = np.zeros(len(grid))
        return _margin(
            uncertain,
            None,
            AxisCover(open=[]),
            grid=grid,
            mu_lower=zero,
            mu_upper=zero.copy(),
            notes=("no uncertainty: mu = 0",),
        )
    seeds = _seed_frequencies(model)
    worst = smallest_destabilising(model, blocks, seeds, seed)
    peak = 1 / worst.norm if worst else 0.0
    first = np.append(seeds, abs(worst.pole.imag)) if worst and np.isfinite(worst.pole) else seeds
    cover = _cover(model, blocks, peak, first=first, until=started + time_limit, accuracy=accuracy)
    response = frequency_response(uncertain.delta_channels, grid)
    mu_lower = np.array([lower_bound(m, blocks, seed, restarts=4, steps=24)[0] for m in response])
    mu_upper = np.array([b.beta for b in upper_bounds(response, blocks, 1e-3)])
    return _margin(uncertain, worst, cover, grid=grid, mu_lower=mu_lower, mu_upper=mu_upper, notes=())


def _check_nominal(uncertain: UncertainModel) -> None:
    poles = uncertain.M.poles()
    if not len(poles) or uncertain.M.is_stable():
        return
    worst = poles[np.abs(poles).argmax() if uncertain.M.is_discrete else poles.real.argmax()]
    raise NoTrustworthyNumber(
        "robust_stability",
        f"nominal closed loop unstable (pole {worst.real:.6g}{worst.imag:+.6g}j)",
        "a stable nominal model",
        "close the loop first (UncertainModel.close), or drop an integrator that feeds nothing back",
    )


def _continuous(model: StateSpaceModel) -> StateSpaceModel:
    """The model balanced by powers of two; a discrete one mapped by ``s = (z - 1) / (z + 1)``."""
    from scipy.linalg import matrix_balance

    A, B, C, D = model.A, model.B, model.C, model.D
    n = model.n_states
    if not n:
        return StateSpaceModel(A, B, C, D)
    if model.is_discrete:
        # z = (1 + s) / (1 - s): s x' = (A + I)^-1 (A - I) x + ...
        plus = np.linalg.inv(A + np.eye(n))
        A, B, C, D = plus @ (A - np.eye(n)), np.sqrt(2) * plus @ B, np.sqrt(2) * C @ plus, D - C @ plus @ B
    A, (scale, _) = matrix_balance(A, permute=False, separate=True)
    return StateSpaceModel(A, B / scale[:, None], C * scale[None, :], D)


def _grid(model: StateSpaceModel, omega: ArrayLike | None) -> Array:
    if omega is None:
        return default_grid(model, 40) if model.n_states else np.array([0.0])
    grid = np.atleast_1d(np.asarray(omega, dtype=float))
    if grid.ndim != 1 or not np.isfinite(grid).all() or (grid < 0).any():
        raise InputError("robust_stability: omega", "negative or not finite frequencies", "frequencies in rad/s, >= 0")
    return grid


def _seed_frequencies(model: StateSpaceModel) -> Array:
    """Frequencies where something may happen: the poles' own."""
    poles = model.poles()
    found = np.abs(np.concatenate([poles, poles.imag]))
    found = found[found > 0]
    if not len(found):
        return found
    # One of those closer together than 2 %.
    marks = np.unique(np.round(np.log(found) / 0.02))
    return np.exp(marks * 0.02)


def _cover(
    model: StateSpaceModel, blocks: Sequence[Block], peak: float, *, first: Array, until: float, accuracy: float
) -> AxisCover:
    """Cover the axis for each strongly connected part of M11 on its own; mu of the whole is the largest of theirs."""
    parts = _parts(model, blocks)
    covers = []
    slices = block_slices(blocks)
    for members in parts:
        w = np.concatenate([np.arange(slices[i][0].start, slices[i][0].stop) for i in members])
        z = np.concatenate([np.arange(slices[i][1].start, slices[i][1].stop) for i in members])
        part = StateSpaceModel(model.A, model.B[:, w], model.C[z], model.D[z[:, None], w])
        covers.append(cover_axis(part, [blocks[i] for i in members], peak, first=first, until=until, accuracy=accuracy))
    whole = AxisCover(open=[])
    for cover in covers:
        whole.pieces.extend(cover.pieces)
        whole.open.extend(cover.open)
        whole.beta = max(whole.beta, cover.beta)
        whole.points += cover.points
    return whole


def _parts(model: StateSpaceModel, blocks: Sequence[Block]) -> list[NDArray[np.intp]]:
    """Blocks that act on each other in a cycle, by the zero pattern of A, B, C, D; others have mu = 0."""
    from scipy.sparse.csgraph import connected_components

    n = model.n_states
    slices = block_slices(blocks)
    pick_w = np.zeros((model.n_inputs, len(blocks)))
    pick_z = np.zeros((len(blocks), model.n_outputs))
    for i, (w, z) in enumerate(slices):
        pick_w[w, i] = 1
        pick_z[i, z] = 1
    # Nodes: states, then blocks; an edge from j to i where j acts on i directly.
    acts = (
        np.block([[model.A != 0, (model.B != 0) @ pick_w], [pick_z @ (model.C != 0), pick_z @ (model.D != 0) @ pick_w]])
        > 0
    )
    _, labels = connected_components(acts, directed=True, connection="strong")
    groups = [np.flatnonzero(labels[n:] == label) for label in np.unique(labels[n:])]
    return [g for g in groups if len(g) > 1 or acts[n + g[0], n + g[0]] or (labels[:n] == labels[n + g[0]]).any()]


def _margin(
    uncertain: UncertainModel,
    worst: Destabilising | None,
    cover: AxisCover,
    *,
    grid: Array,
    mu_lower: Array,
    mu_upper: Array,
    notes: tuple[str, ...],
) -> Margin:
    delta = delta_values(uncertain.blocks, worst.delta) if worst else {}
    upper = worst.norm if worst else float("inf")
    lower = 0.0 if cover.open else (1 / cover.beta if cover.beta > 0 else float("inf"))
    if cover.open:
        notes = (*notes, f"{len(cover.open)} frequency intervals not proved in time: mu_upper holds on the grid only")
    for array in (grid, mu_lower, mu_upper):
        array.setflags(write=False)
    return Margin(
        lower=lower,
        upper=upper,
        frequency=_frequency(uncertain, worst),
        delta=delta,
        status=Status.TIMEOUT if cover.open else Status.CERTIFIED,
        physical=uncertain.physical(delta) if delta else {},
        pole=_pole(uncertain, worst),
        omega=grid,
        mu_lower=mu_lower,
        mu_upper=mu_upper,
        intervals=tuple((_real_axis(uncertain, p.low), _real_axis(uncertain, p.high), p.beta) for p in cover.pieces),
        open=tuple((_real_axis(uncertain, low), _real_axis(uncertain, high)) for low, high in cover.open),
        notes=notes,
    )


def _pole(uncertain: UncertainModel, worst: Destabilising | None) -> complex | None:
    if worst is None or not uncertain.M.is_discrete:
        return worst.pole if worst else None
    return (1 + worst.pole) / (1 - worst.pole) if np.isfinite(worst.pole) else -1.0 + 0j


def _frequency(uncertain: UncertainModel, worst: Destabilising | None) -> float | None:
    if worst is None:
        return None
    return _real_axis(uncertain, abs(worst.pole.imag) if np.isfinite(worst.pole) else float("inf"))


def _real_axis(uncertain: UncertainModel, omega: float) -> float:
    """Frequency in rad/s of the model itself: ``w = 2 atan(omega) / dt`` where it was mapped."""
    return float(2 * np.arctan(omega) / uncertain.dt) if uncertain.M.is_discrete else float(omega)
