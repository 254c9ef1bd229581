"""Mixed H2/H-infinity synthesis: the bound is kept by the true loop, and the H2 norm lies where theory says."""

from __future__ import annotations

import numpy as np
import pytest

from robustlab.errors import InputError, NoTrustworthyNumber
from robustlab.norms import h2_norm, hinf_norm
from robustlab.result import Status
from robustlab.statespace import StateSpaceModel, lower_lft
from robustlab.synthesis.h2.h2_synthesis import h2
from robustlab.synthesis.h2.mixed_h2_hinf import h2_hinf

INTEGRATOR = StateSpaceModel(
    [[0.0]], [[1.0, 0.0, 1.0]], [[1.0], [0.0], [1.0]], [[0, 0, 0], [0, 0, 1], [0, 1, 0]],
    inputs=["d", "n", "u"], outputs=["x", "effort", "y"],
)  # fmt: skip
BOTH = ["x", "effort"]


def random_plant(seed, dt=0.0):
    """z1, z2 for H2 and z3, z4 for H-infinity, three disturbances, two controls, two measurements."""
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((4, 4)) / (1.8 if dt else 1.0)
    D = rng.standard_normal((6, 5))
    D[:4, :3] = 0
    D[4:, 3:] *= 0.2  # D22
    return StateSpaceModel(
        A, rng.standard_normal((4, 5)), rng.standard_normal((6, 4)), D, dt, outputs=["z1", "z2", "z3", "z4", "y1", "y2"]
    )


def part(loop, rows):
    return StateSpaceModel(loop.A, loop.B, loop.C[rows], loop.D[rows], loop.dt)


def test_the_h2_optimum_is_the_answer_where_it_keeps_the_bound():
    design = h2_hinf(INTEGRATOR, 1, 1, gamma=5.0, h2_outputs=BOTH, hinf_outputs=BOTH)
    assert design.gamma == pytest.approx(np.sqrt(2.0), rel=1e-9)
    assert "H2 optimum" in design.reason


def test_a_tighter_bound_costs_more():
    norms = [h2_hinf(INTEGRATOR, 1, 1, gamma=g, h2_outputs=BOTH, hinf_outputs=BOTH) for g in (1.6, 1.45)]
    assert norms[0].gamma < norms[1].gamma
    assert all(d.hinf_norm.upper <= d.bound for d in norms)
    # None of a grid of first-order controllers that keep the bound is better by 1 %.
    assert norms[0].gamma <= 1.01 * _best_first_order(1.6)


def _best_first_order(gamma):
    """Brute force over u = c xhat, xhat' = a xhat + y: the H2 norm of the best that keeps the bound."""
    best = np.inf
    for a in -np.geomspace(0.5, 20, 14):
        for c in -np.geomspace(0.05, 60, 20):
            loop = lower_lft(INTEGRATOR, StateSpaceModel([[a]], [[1.0]], [[c]], [[0.0]]))
            if loop.is_stable():
                value = h2_norm(loop).value
                if value < best and hinf_norm(loop, rtol=1e-3).value <= gamma:
                    best = value
    return best


@pytest.mark.parametrize("dt", [0.0, 0.1])
def test_random_plants_with_d22_keep_the_bound_in_the_rebuilt_loop(dt):
    P = random_plant(2, dt)
    lines: list[str] = []
    gamma = 1.3 * 4.6586 if dt else 12.0
    design = h2_hinf(P, 2, 2, gamma=gamma, h2_outputs=["z1", "z2"], progress=lines.append)
    assert design.status is Status.CONVERGED
    loop = lower_lft(P, design.K)
    assert loop.is_stable()
    assert hinf_norm(part(loop, [2, 3])).upper <= gamma * (1 + 1e-9)
    assert h2_norm(part(loop, [0, 1])).value == pytest.approx(design.gamma, rel=1e-6)
    rows = [0, 1, 4, 5]
    alone = h2(StateSpaceModel(P.A, P.B, P.C[rows], P.D[rows], dt), 2, 2).gamma
    assert design.h2_optimum == pytest.approx(alone, rel=1e-9)
    assert alone * (1 - 1e-9) <= design.gamma < 2 * alone
    assert any(line.startswith("level") for line in lines) or design.gamma == pytest.approx(alone)
    assert dict(design.facts())["H-infinity norm"]
    assert design.to_json()["bound"] == gamma


def test_a_bound_below_every_controller_is_named():
    with pytest.raises(NoTrustworthyNumber, match=r"below 1\.2.*gamma above 1\.414"):
        h2_hinf(INTEGRATOR, 1, 1, gamma=1.2, h2_outputs=BOTH, hinf_outputs=BOTH)


def test_a_spent_time_limit_still_gives_a_verified_loop_or_an_error():
    try:
        design = h2_hinf(INTEGRATOR, 1, 1, gamma=1.6, h2_outputs=BOTH, hinf_outputs=BOTH, time_limit=1e-4)
    except NoTrustworthyNumber:
        return
    assert design.hinf_norm.upper <= 1.6


def test_refusals():
    with pytest.raises(InputError, match="h2_outputs"):
        h2_hinf(INTEGRATOR, 1, 1, gamma=2.0, h2_outputs=["effrt"])
    with pytest.raises(InputError, match="hinf_outputs is empty"):
        h2_hinf(INTEGRATOR, 1, 1, gamma=2.0, h2_outputs=BOTH)
    with pytest.raises(InputError, match="gamma"):
        h2_hinf(INTEGRATOR, 1, 1, gamma=-1.0, h2_outputs=BOTH)
    with pytest.raises(InputError, match="time_limit"):
        h2_hinf(INTEGRATOR, 1, 1, gamma=1.0, h2_outputs=BOTH, time_limit=0)
