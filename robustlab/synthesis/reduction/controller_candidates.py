r"""Controllers of lower order as candidates: what in K matters is told by the loop it works in.

With the closed loop's controllability and observability Gramians split into plant and controller, their controller
blocks tell how much w moves each state of K, and how much each state of K moves z. Other candidates weight K with

.. math:: T_{yw} = (I - P_{22} K)^{-1} P_{21}, \qquad T_{zu} = P_{12} (I - K P_{22})^{-1}

because a change of K by a small E changes the closed loop by ``T_zu E T_yw``.

References
----------
Anderson, Liu, "Controller reduction: concepts and approaches", IEEE TAC 34 (1989); Enns (1984); Zhou, Doyle, Glover
(1996), chapter 19.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from robustlab.arrays import Array
from robustlab.errors import InputError, NoTrustworthyNumber
from robustlab.statespace import StateSpaceModel, lower_lft
from robustlab.synthesis.problem.partition import GeneralizedPlant
from robustlab.synthesis.reduction.balancing import (
    Balancing,
    Projection,
    gramian_factors,
    split_stable,
    triangular_root,
)
from robustlab.synthesis.reduction.model_reduction import CoprimeReduction, weighted_factors

__all__ = ["CandidateFamily", "candidate_families"]

T = TypeVar("T")


@dataclass(frozen=True, eq=False)
class CandidateFamily:
    """A way to reduce K: its name, the lowest and highest order it offers, and what makes the controller of an order.

    ``make`` raises `NoTrustworthyNumber` or `InputError` where there is no such controller.
    """

    name: str
    least: int
    most: int
    make: Callable[[int], StateSpaceModel]


def candidate_families(plant: GeneralizedPlant, K: StateSpaceModel) -> list[CandidateFamily]:
    """All ways that K and the loop admit; ``plant`` carries the weights and scalings that count."""
    families: list[CandidateFamily] = []
    for name, bases in (
        ("closed-loop Gramians", lambda: [_of_loop(plant.close(K), K)]),
        ("loop from measurement noise to control", lambda: [_of_loop(_signal_loop(plant, K), K)]),
    ):
        for balancing in _tried(bases):
            families += [_projected(f"{name}, {kind}", balancing, K, kind) for kind in _PROJECTIONS]
    families += [family for part in _tried(lambda: [_coprime(K)]) for family in [part]]
    families += [family for group in _tried(lambda: [_weighted(plant, K)]) for family in group]
    return families


_PROJECTIONS: tuple[Projection, ...] = ("truncation", "residualisation")


def _tried(make: Callable[[], list[T]]) -> list[T]:
    """The list, or none where the Gramians of this way do not exist for this K, or lost their digits."""
    try:
        return make()
    except (NoTrustworthyNumber, InputError):
        return []


def _of_loop(loop: StateSpaceModel, K: StateSpaceModel) -> Balancing:
    """Balancing of the controller's blocks in the Gramians of a loop whose last states are those of K."""
    reach, see = gramian_factors(loop)
    k = slice(loop.n_states - K.n_states, None)
    return Balancing.of(_block(reach[k]), _block(see[k]))


def _block(rows: Array) -> Array:
    """Square factor of the diagonal block of ``L L^T`` that belongs to some rows of L."""
    return triangular_root(rows.T).T


def _projected(name: str, balancing: Balancing, K: StateSpaceModel, kind: Projection) -> CandidateFamily:
    return CandidateFamily(name, 0, len(balancing.left), lambda order: balancing.reduced(K, order, kind))


def _signal_loop(plant: GeneralizedPlant, K: StateSpaceModel) -> StateSpaceModel:
    """From noise on the measurements to the controls, in the loop of plant and K."""
    m, n_y, n_u = plant.model, plant.n_meas, plant.n_con
    b, c = m.B[:, m.n_inputs - n_u :], m.C[m.n_outputs - n_y :]
    P = StateSpaceModel(
        m.A, np.hstack([np.zeros((m.n_states, n_y)), b]), np.vstack([np.zeros((n_u, m.n_states)), c]),
        np.block([[np.zeros((n_u, n_y)), np.eye(n_u)], [np.eye(n_y), plant.D22]]), m.dt,
    )  # fmt: skip
    return lower_lft(P, StateSpaceModel(K.A, K.B, K.C, K.D, K.dt))


def _coprime(K: StateSpaceModel) -> CandidateFamily:
    reduction = CoprimeReduction(StateSpaceModel(K.A, K.B, K.C, K.D, K.dt))
    return CandidateFamily("normalised coprime factors", 0, len(reduction.balancing.left), reduction.reduced)


def _weighted(plant: GeneralizedPlant, K: StateSpaceModel) -> list[CandidateFamily]:
    """Balanced truncation of K's stable part, plain and with the loop as weights on either side."""
    bare = StateSpaceModel(K.A, K.B, K.C, K.D, K.dt)
    split = split_stable(bare)
    if not split.stable.n_states:
        return []
    stable = StateSpaceModel(split.stable.A, split.stable.B, split.stable.C, split.stable.D, K.dt)
    into, out = _sensitivity_weights(plant, bare)
    apart, families = split.apart.n_states, list[CandidateFamily]()
    for name, weights in (("balanced", (None, None)), ("weighted by the loop on both sides", (into, out))):
        for balancing in _tried(lambda weights=weights: [Balancing.of(*weighted_factors(stable, *weights))]):

            def make(order: int, kind: Projection, balancing: Balancing = balancing) -> StateSpaceModel:
                return split.joined(balancing.reduced(stable, order - apart, kind))

            families += [
                CandidateFamily(
                    f"{name}, {kind}", apart, apart + len(balancing.left), lambda r, k=kind, m=make: m(r, k)
                )
                for kind in _PROJECTIONS
            ]
    return families


def _sensitivity_weights(plant: GeneralizedPlant, K: StateSpaceModel) -> tuple[StateSpaceModel, StateSpaceModel]:
    """``T_yw`` and ``T_zu``."""
    m, n_y, n_u = plant.model, plant.n_meas, plant.n_con
    n_w, n_z = m.n_inputs - n_u, m.n_outputs - n_y
    b1, b2, c1, c2 = m.B[:, :n_w], m.B[:, n_w:], m.C[:n_z], m.C[n_z:]
    d12, d21, d22 = m.D[:n_z, n_w:], m.D[n_z:, :n_w], plant.D22
    seen = StateSpaceModel(
        m.A, np.hstack([b1, b2]), np.vstack([c2, c2]), np.block([[d21, d22], [d21, d22]]), m.dt
    )  # the measurements once more as outputs
    moved = StateSpaceModel(
        m.A, np.hstack([b2, b2]), np.vstack([c1, c2]), np.block([[d12, d12], [d22, d22]]), m.dt
    )  # a disturbance on the controls as input
    return lower_lft(seen, K), lower_lft(moved, K)
