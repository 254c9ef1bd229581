"""D-K iteration with a controller of given structure: brute force over its one gain, and the full-order controller."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import robustlab as rl
from robustlab.errors import NoTrustworthyNumber
from robustlab.norms import bilinear_to_discrete

OMEGA = np.concatenate([[0.0], np.geomspace(1e-2, 1e3, 40)])


def lag(dt: float = 0.0) -> rl.StateSpaceModel:
    """x' = -x + 0.6 d1 + w + u, the gain of u uncertain by 40 %, z = (x, 0.5 u), y = x: two blocks and performance."""
    P = rl.StateSpaceModel(
        [[-1.0]], [[0.6, 0.4, 1.0, 1.0]], [[1.0], [0.0], [1.0], [0.0], [1.0]],
        [[0, 0, 0, 0], [0, 0, 0, 1.0], [0, 0, 0, 0], [0, 0, 0, 0.5], [0, 0, 0, 0]],
    )  # fmt: skip
    return bilinear_to_discrete(P, dt) if dt else P


BLOCKS = [rl.ComplexScalar("pole"), rl.ComplexScalar("gain")]


def peak_of_mu(P: rl.StateSpaceModel, k: float) -> float:
    loop = rl.generalized_plant(
        P, P.output_names[-1:], P.input_names[-1:], P.input_names[:-1], P.output_names[:-1]
    ).close(rl.StateSpaceModel([], [], [], [[k]], P.dt))
    if not loop.is_stable():
        return np.inf
    omega = OMEGA if not P.dt else np.concatenate([[0.0], np.geomspace(1e-2, np.pi / P.dt, 40)])
    bounds = rl.mu(rl.frequency_response(loop, omega), [*BLOCKS, rl.FullBlock("performance", 1, 2)])
    return float(np.max(bounds.upper))


@pytest.mark.parametrize("dt", [0.0, 0.2])
def test_one_gain_is_that_of_brute_force(dt: float) -> None:
    P = lag(dt)
    design = rl.dk(P, BLOCKS, 1, 1, structure="static", starts=2)
    gains = np.linspace(-12, 0.5, 26)
    curve = [peak_of_mu(P, k) for k in gains]
    best = int(np.argmin(curve))
    assert design.status is rl.Status.CERTIFIED, design.reason
    assert design.gamma == pytest.approx(min(curve), rel=1e-2)
    (k,) = design.parameters.values()
    assert k == pytest.approx(gains[best], abs=1.0)
    assert design.K.D[0, 0] == pytest.approx(k)
    # What is proved holds for this gain at every frequency of the grid, and a Delta attains the lower bound.
    assert peak_of_mu(P, k) <= design.gamma * (1 + 1e-6)
    assert design.lower > 0.98 * design.gamma
    assert design.proved_again() == pytest.approx(design.scaled_level, rel=1e-5)


def test_more_freedom_is_never_worse_than_less_and_full_order_is_the_floor() -> None:
    P = lag()
    static = rl.dk(P, BLOCKS, 1, 1, structure="static", starts=1)
    dynamic = rl.dk(P, BLOCKS, 1, 1, structure=2, starts=2)
    full = rl.dk(P, BLOCKS, 1, 1)
    assert full.gamma * 0.99 <= dynamic.gamma <= static.gamma * 1.01
    assert dynamic.K.n_states == 2
    assert dynamic.history[0].stage == "start"


def test_a_structure_that_cannot_stabilise_is_said() -> None:
    """A double integrator with a static gain of its position."""
    P = rl.StateSpaceModel(
        [[0, 1], [0, 0]], [[0, 0, 0], [0.1, 1, 1]], [[1, 0], [1, 0], [1, 0]], np.zeros((3, 3))
    )  # fmt: skip
    blocks: list[Any] = [rl.ComplexScalar("d")]
    with pytest.raises(NoTrustworthyNumber, match="no start stabilised the plant with this structure"):
        rl.dk(P, blocks, 1, 1, structure="static", starts=1)
