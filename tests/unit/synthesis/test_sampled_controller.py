"""Digital controllers: the best formula, the direct design, refusals."""

from __future__ import annotations

import numpy as np
import pytest

import robustlab as rl
from robustlab.result import Status
from robustlab.synthesis import lift

LOW = rl.StateSpaceModel(
    [[-1.0]], [[1, 0, 1]], [[1], [0], [1]], [[0, 0, 0], [0, 0, 1], [0, 1, 0]],
    inputs=["w", "n", "u"], outputs=["z", "effort", "y"],
)  # fmt: skip


@pytest.fixture(scope="module")
def design():
    return rl.hinf(LOW, 1, 1)


@pytest.fixture(scope="module")
def flexible():
    """Three equal masses and springs, damping ratio 0.5 %: force on the first, measured at the last."""
    n, zero = 3, np.zeros((3, 3))
    stiffness = np.array([[1.0, -1, 0], [-1, 2, -1], [0, -1, 1]])
    squares, modes = np.linalg.eigh(stiffness)
    damping = modes @ np.diag(0.01 * np.sqrt(np.maximum(squares, 0))) @ modes.T
    A = np.block([[zero, np.eye(n)], [-stiffness, -damping]])
    B, C = np.zeros((2 * n, 3)), np.zeros((3, 2 * n))
    B[n + 2, 0] = B[n, 2] = C[0, 2] = C[2, 2] = 1.0
    names = ["force", "noise", "u"], ["position", "effort", "y"]
    P = rl.StateSpaceModel(A, B, C, [[0, 0, 0], [0, 0, 1], [0, 0.1, 0]], 0.0, *names)
    plant = rl.generalized_plant(P, ["y"], ["u"])
    return plant, rl.hinf(plant)


def crossover(plant, K):
    omega = np.geomspace(1e-3, 1e2, 4000)
    loop = rl.frequency_response(plant.model, omega)[:, 2, 2] * rl.frequency_response(K, omega)[:, 0, 0]
    return omega[np.abs(loop) > 1].max()


def test_fast_sampling_loses_nothing_and_reports_the_methods_tried(design):
    lines: list[str] = []
    found = rl.discretise(design, 1e-3, progress=lines.append)
    assert found.status is Status.CERTIFIED
    assert abs(found.loss) < 0.01
    assert {t.method for t in found.trials} >= {"tustin", "zoh", "foh", "matched"}
    assert all(t.method != "direct" for t in found.trials)
    assert len(lines) == len(found.trials)
    assert found.norm.held == ("n",)
    again = rl.sampled_data_norm(LOW, found.K, n_meas=1, n_con=1)
    assert again.upper == pytest.approx(found.gamma, rel=1e-9)


def test_on_a_flexible_chain_the_direct_design_loses_little_where_no_formula_is_stable(flexible):
    plant, design = flexible
    dt = 2 * np.pi / (12 * crossover(plant, design.K))
    found = rl.discretise(design, dt)
    assert found.chosen == "direct"
    assert found.loss < 0.1
    assert all(not np.isfinite(t.upper) for t in found.trials if t.method != "direct")
    assert found.K.is_discrete
    assert found.K.n_states <= plant.model.n_states
    again = rl.sampled_data_norm(plant, found.K)
    assert again.status is Status.CERTIFIED
    assert again.upper == pytest.approx(found.gamma, rel=1e-9)
    # the exact discrete loop is stable, too
    from robustlab.statespace import lower_lft

    assert lower_lft(rl.discretise(plant.model, dt, "zoh"), found.K).is_stable()


def test_the_direct_design_loses_less_by_a_delay(design):
    losses = [rl.discretise(design, 0.3, method="direct", delay=delay).loss for delay in (0.0, 0.45)]
    assert losses[0] < losses[1]
    tustin = rl.discretise(design, 0.3, method="tustin", delay=0.45).loss
    assert losses[1] < tustin * 1.02 + 0.02


def test_pathological_sampling_of_an_oscillator_is_named():
    # an undamped oscillator sampled every half period
    P = rl.StateSpaceModel(
        [[0, 10], [-10, 0]], [[0, 0, 0], [1, 0, 1]], [[1, 0], [0, 0], [1, 0]], [[0, 0, 0], [0, 0, 0.1], [0, 0.1, 0]]
    )
    design = rl.hinf(P, 1, 1, gamma_rel=1.0)
    with pytest.raises(rl.NoTrustworthyNumber) as caught:
        rl.discretise(design, np.pi / 10, method="tustin")
    assert any("pathological sampling" in line for line in caught.value.more)


def test_lifting_repeats_the_plant_over_a_period():
    # Without delay the lifted state map is the exact discrete one for any number of intervals.
    held = rl.discretise(LOW, 0.4, "zoh")
    for n_intervals, delay in ((1, 0.0), (3, 0.0), (4, 0.1)):
        model = lift(rl.synthesis.GeneralizedPlant(LOW, 1, 1), 0.4, n_intervals, delay).generalized_plant().model
        assert model.A[0, 0] == pytest.approx(held.A[0, 0], rel=1e-12)
        if not delay:
            assert model.B[0, -1] == pytest.approx(held.B[0, 2], rel=1e-12)
        else:  # the old control acts for 0.1 s, the new one for 0.3 s
            assert model.B[0, -1] == pytest.approx(1 - np.exp(-0.3), rel=1e-12)
            assert model.A[0, 1] == pytest.approx(np.exp(-0.3) * (1 - np.exp(-0.1)), rel=1e-12)
