"""From continuous to discrete: closed forms, exactness, pathological sampling, bad requests."""

import control
import numpy as np
import pytest
from scipy.signal import cont2discrete

import robustlab as rl
from robustlab.result import Status

LAG = rl.StateSpaceModel([[-2.0]], [[1.0]], [[2.0]], [[0.0]], inputs=[("u", "V")], outputs=[("y", "m")])
TWO_BY_TWO = rl.StateSpaceModel([[-1.0, 2.0], [0.0, -3.0]], np.eye(2), np.eye(2), [[1.0, 0.0], [0.0, 0.5]])


def at(model, z):
    return (model.D + model.C @ np.linalg.solve(z * np.eye(model.n_states) - model.A, model.B))[0, 0]


@pytest.mark.parametrize(
    ("method", "expected"),
    [  # 2/(s + 2) with T = 0.1, q = e^-0.2, as functions of z
        ("zoh", lambda z, q: (1 - q) / (z - q)),
        ("tustin", lambda z, q: 2 / (20 * (z - 1) / (z + 1) + 2)),
        # Franklin, Powell, Workman, section 6.3.2: (z - 1)^2 / (T z) Z{G / s^2}
        ("foh", lambda z, q: 1 - (1 - q) * (z - 1) / (0.2 * (z - q))),
    ],
)
def test_a_lag_in_closed_form(method, expected):
    found = rl.discretise(LAG, 0.1, method)
    for z in (0.3 + 0.4j, -0.5 + 0j, 2.0 + 1j):
        assert at(found, z) == pytest.approx(expected(z, np.exp(-0.2)), rel=1e-10)
    assert found.dt == 0.1
    assert found.inputs == LAG.inputs
    assert found.outputs == LAG.outputs


def test_holds_are_exact_at_the_samples():
    t, u = 0.5 * np.arange(9), np.random.default_rng(0).normal(size=(9, 2))
    for method in ("zoh", "foh"):
        exact = rl.simulate(TWO_BY_TWO, t, u, hold=method)
        found = rl.discretise(TWO_BY_TWO, 0.5, method)
        # The state of the first-order hold is x - slope u, which gives x0 for x = 0 at the first sample.
        slope = found.D - TWO_BY_TWO.D
        stepped = rl.simulate(found, t, u, x0=-slope @ u[0] if method == "foh" else None)
        for name in ("y1", "y2"):
            np.testing.assert_allclose(stepped[name], exact[name], atol=1e-12)


# --- back to continuous time ------------------------------------------------------------------------------------------


T = 0.1
FLIP = rl.StateSpaceModel([[-0.5]], [[1.0]], [[1.0]], [[0.0]], T)
DELAY = rl.StateSpaceModel([[0.0, 1.0], [0.0, 0.0]], [[0.0], [1.0]], [[1.0, 0.0]], [[0.0]], T)


def plant(seed=0):
    """Continuous, with poles well below the Nyquist frequency of 31 rad/s, one of them at 0."""
    rng = np.random.default_rng(seed)
    a = 4 * rng.standard_normal((3, 3))
    a -= (np.linalg.eigvals(a).real.max() - 0.5) * np.eye(3)
    a[:, 0] = 0.0
    b, c, d = rng.standard_normal((3, 2)), rng.standard_normal((2, 3)), rng.standard_normal((2, 2))
    return rl.StateSpaceModel(a, b, c, d, inputs=[("u", "V"), "d"], outputs=["y", ("omega", "rad/s")])


@pytest.mark.parametrize("seed", range(5))
def test_models_discretised_by_scipy_are_recovered(seed):
    truth = plant(seed)
    given = rl.StateSpaceModel(
        *cont2discrete((truth.A, truth.B, truth.C, truth.D), T)[:4], T, truth.inputs, truth.outputs
    )
    back = rl.d2c(given)
    np.testing.assert_allclose(np.hstack([back.A, back.B]), np.hstack([truth.A, truth.B]), atol=1e-9)
    assert (back.dt, back.inputs, back.outputs) == (0.0, truth.inputs, truth.outputs)


def test_tustin_is_the_map_of_python_control():
    truth = plant()
    found = rl.d2c(control.sample_system(truth.to_control(), T, method="bilinear"), "tustin")
    one, two = (rl.frequency_response(m, [0.1, 3.0, 50.0]) for m in (found, truth))
    np.testing.assert_allclose(one, two, rtol=1e-9)


# --- digital controllers: the best formula, the direct design ---------------------------------------------------------


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
    assert {t.method for t in found.trials} >= {"tustin", "zoh", "foh"}
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
