"""Lower bound of mu over all controllers: closed forms, sampled controllers, and members of the set."""

import numpy as np
import pytest

import robustlab as rl
from robustlab import ComplexScalar, FullBlock, RealScalar, frequency_response
from robustlab.statespace import StateSpaceModel
from robustlab.synthesis import GeneralizedPlant, mu_floor


def servo(spread: float = 0.5) -> GeneralizedPlant:
    """z = d + G u with G = 1 / ((1 + spread delta) + s), penalised u, noisy y; delta real, one performance block."""
    B = [[-spread, 1.0, 0.0, 1.0]]
    C = [[1.0], [1.0], [0.0], [1.0]]
    D = [[0, 0, 0, 0], [0, 0, 0, 0], [0, 0, 0, 0.4], [0, 0, 0.3, 0]]
    return GeneralizedPlant(StateSpaceModel([[-1.0]], B, C, D), 1, 1)


BLOCKS = [RealScalar("k"), FullBlock("p", 2, 2)]


@pytest.mark.parametrize("gain", [0.0, -0.3, -1.0, -3.0, -10.0])
def test_no_tried_controller_is_below_the_lower_bound(gain):
    """Static gains: sigma_max of the performance channels of members at size 1 / gamma on a dense grid."""
    plant = servo()
    K = StateSpaceModel(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), [[gain]])
    proved = 1 / rl.robust_stability(rl.UncertainModel(plant.close(K), BLOCKS)).lower
    floor = mu_floor(plant.matrices(), BLOCKS, proved, {"k": 1.0})
    assert 0 < floor.value <= proved
    omega = np.concatenate([[0.0], np.geomspace(1e-3, 1e3, 2000)])
    worst = 0.0
    for k in (-1.0, 0.0, 1.0):
        loop = plant.model
        A = loop.A + loop.B[:, :1] * (k / proved) @ loop.C[:1]
        member = GeneralizedPlant(StateSpaceModel(A, loop.B[:, 1:], loop.C[1:], loop.D[1:, 1:]), 1, 1).close(K)
        response = frequency_response(member, omega)
        worst = max(worst, float(np.linalg.norm(response, 2, axis=(1, 2)).max()))
    assert floor.value <= worst * (1 + 1e-6)


def test_a_disturbance_that_no_control_reaches_is_the_limit():
    """z = [d / (s + 1); 0.01 u]: the control does not affect d, so mu is at least one, attained by one controller."""
    A, B = [[-1.0]], [[0.0, 1.0, 0.0, 0.0]]
    C = [[0.0], [1.0], [0.0], [1.0]]
    D = [[0, 0, 0, 0.1], [0, 0, 0, 0], [0, 0, 0, 0.01], [0.1, 0, 0.1, 0]]
    design = rl.dk(StateSpaceModel(A, B, C, D), [ComplexScalar("g"), FullBlock("p", 2, 2)], 1, 1, effort=0.05)
    assert design.lower_bound.value == pytest.approx(1.0, rel=1e-6)
    assert design.gamma <= 1.01
    assert design.why.endswith("it is at the limit of every controller")
    assert ("why not less", design.why) in design.facts()
