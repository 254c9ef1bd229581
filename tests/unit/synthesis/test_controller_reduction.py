"""Reduction of controllers: measures, scalings, unstable controllers, the requested order, refusals."""

from pathlib import Path

import numpy as np
import pytest

import robustlab as rl
from robustlab.errors import NoTrustworthyNumber
from robustlab.result import Status
from robustlab.statespace import StateSpaceModel, lower_lft
from robustlab.synthesis import GeneralizedPlant, ReducedController, sampled_norm
from robustlab.synthesis.problem import generalized_plant
from robustlab.uncertainty import gap_metric

PLANT = rl.StateSpaceModel(
    [[-1, 1, 0], [0, -3, 2], [0, 0, -20]], [[0, 0, 0], [1, 0, 0], [0, 0, 10]], [[1, 0, 0], [0, 0, 0], [1, 0, 0]],
    [[0, 0, 0], [0, 0, 0.1], [0, 0.1, 0]], inputs=["w", "n", "u"], outputs=["z", "effort", "y"],
)  # fmt: skip


def padded(K: rl.StateSpaceModel, extra: float = 1e-4) -> rl.StateSpaceModel:
    """Return K with two more, negligible states in mixed coordinates."""
    n = K.n_states
    A = np.block([[K.A, np.zeros((n, 2))], [np.zeros((2, n)), np.diag([-3.0, -40.0])]])
    B, C = np.vstack([K.B, np.ones((2, K.n_inputs))]), np.hstack([K.C, extra * np.ones((K.n_outputs, 2))])
    T = np.eye(n + 2) + 0.3 * np.tri(n + 2, k=-1)
    return rl.StateSpaceModel(np.linalg.solve(T, A @ T), np.linalg.solve(T, B), C @ T, K.D, K.dt, K.inputs, K.outputs)


@pytest.fixture(scope="module")
def design():
    return rl.hinf(PLANT, 1, 1, gamma_rel=1.0)


def test_negligible_states_are_removed_and_the_loop_is_proved_anew(design):
    lines: list[str] = []
    small = rl.reduce_controller(design, padded(design.K), loss=1e-3, progress=lines.append)
    assert isinstance(small, ReducedController)
    assert small.K.n_states <= design.K.n_states
    assert small.status is Status.CERTIFIED
    assert small.loss <= 1e-3
    assert rl.peak_gain(lower_lft(PLANT, small.K)).lower <= small.gamma
    assert small.original.n_states == design.K.n_states + 2
    assert [o.order for o in small.orders][:2] == [4, 3]
    assert len(lines) == len(small.orders)
    assert lines[0].startswith("order 4: hinf ")
    assert small.K.input_names == ("y",)
    assert small.K.output_names == ("u",)


def test_h2_norm_as_the_measure():
    from robustlab.norms import h2_norm

    K = rl.StateSpaceModel([[-5.0, 0.0], [0.0, -300.0]], [[1.0], [1.0]], [[-3.0, 1e-3]], [[0.0]])
    P = rl.StateSpaceModel(PLANT.A, PLANT.B, PLANT.C, np.zeros((3, 3)))
    small = rl.reduce_controller(P, K, measure="h2", loss=1e-3)
    assert small.K.n_states <= 1
    assert small.measure == "H2 norm"
    assert small.gamma == pytest.approx(h2_norm(lower_lft(P, small.K)).value, rel=1e-9)
    assert small.gamma <= 1.001 * h2_norm(lower_lft(P, K)).value * (1 + 1e-9)


def mu_problem() -> tuple[GeneralizedPlant, rl.StateSpaceModel]:
    """Return a lag with 30 % uncertainty at its input, and an integrating controller with a needless fast pole."""
    P = rl.StateSpaceModel(
        [[-1, 0], [1, -0.01]], [[1, 0, 1], [0, 1, 0]], [[0, 0], [0, 0.2], [-1, 0]],
        [[0, 0, 0.3], [0, 0.3, 0], [0, -1, 0]],
    )  # fmt: skip
    K = rl.StateSpaceModel([[-0.01, 0.0], [0.0, -1e3]], [[1.0], [1.0]], [[1.0, 0.5]], [[1.0]])
    return GeneralizedPlant(P, 1, 1, (rl.ComplexScalar("input"),)), K


def test_mu_is_that_of_the_loop_with_the_reduced_controller():
    plant, K = mu_problem()
    free = rl.reduce_controller(plant, K, order=1, measure="mu")
    assert free.K.n_states == 1
    assert free.status is Status.CERTIFIED
    omega = np.geomspace(1e-3, 1e3, 60)
    bounds = rl.mu(rl.frequency_response(plant.close(free.K), omega), [[1, 0], [1, 1]])
    assert bounds.upper.max() <= free.gamma * (1 + 1e-3)


def test_an_unstable_controller_and_a_discrete_one():
    P = rl.StateSpaceModel([[1.0]], [[1, 0, 1]], [[1], [0], [1]], [[0, 0, 0], [0, 0, 0.1], [0, 0.1, 0]])
    stabilising = rl.StateSpaceModel([[0.2]], [[1.0]], [[-5.0]], [[-8.0]])
    small = rl.reduce_controller(P, padded(stabilising, 1e-3), loss=0.01)
    assert small.K.n_states <= 2
    assert small.closed_loop.is_stable()
    digital, K = rl.discretise(PLANT, 0.05, "zoh"), rl.discretise(padded(rl.hinf(PLANT, 1, 1).K), 0.05)
    discrete = rl.reduce_controller(digital, K, loss=0.01)
    assert discrete.K.dt == 0.05
    assert discrete.K.n_states < K.n_states
    assert discrete.gamma == pytest.approx(rl.peak_gain(lower_lft(digital, discrete.K)).upper, rel=1e-5)


UNSTABLE = rl.StateSpaceModel([[1.0]], [[1.0]], [[1.0]], [[0.0]])


def lag(gain: float) -> rl.StateSpaceModel:
    return rl.StateSpaceModel([[-10.0]], [[1.0]], [[gain]], [[0.0]])


def four_block_gain(K: rl.StateSpaceModel) -> float:
    """Return the peak of |[G; 1] (1 - K G)^-1 [K 1]| for G = 1/(s - 1), by formula on a fine grid."""
    s = 1j * np.concatenate([[0.0], np.geomspace(1e-3, 1e4, 20001)])
    g, k = 1 / (s - 1), rl.frequency_response(K, s.imag)[:, 0, 0]
    return float((np.sqrt(1 + np.abs(g) ** 2) * np.sqrt(1 + np.abs(k) ** 2) / np.abs(1 - k * g)).max())


@pytest.mark.parametrize("order", [None, 0, 1])
def test_an_unstable_loop_of_a_bare_plant_is_refused(order):
    """G = 1/(s - 1), K = 5/(s + 10): poles +1.437 and -10.437."""
    with pytest.raises(rl.NoTrustworthyNumber, match=r"pole 1\.43717.*unstable") as caught:
        rl.reduce_controller(UNSTABLE, lag(5.0), order=order)
    assert "u = K y, positive feedback" in str(caught.value)
    assert "give -K" not in str(caught.value)
    with pytest.raises(rl.NoTrustworthyNumber, match="with u = -K y the loop is stable: give -K"):
        rl.reduce_controller(UNSTABLE, lag(50.0), order=order)
    with pytest.raises(rl.NoTrustworthyNumber, match="continuous loop is not stable"):
        rl.discretise(lag(5.0), 0.01, plant=UNSTABLE)


def test_the_measure_of_a_bare_plant_is_the_four_block_gain_of_its_loop():
    K = rl.StateSpaceModel([[-10.0, 1.0], [0.0, -100.0]], [[1.0], [3.0]], [[-50.0, 2.0]], [[-3.0]])
    for order in (None, 0, 1):
        small = rl.reduce_controller(UNSTABLE, K, order=order)
        assert small.original_gamma == pytest.approx(four_block_gain(K), rel=1e-5)
        assert small.gamma == pytest.approx(four_block_gain(small.K), rel=1e-5)
        assert small.status is Status.CERTIFIED
        assert small.closed_loop.is_stable()
    digital = rl.discretise(K, 0.001, "tustin", plant=UNSTABLE)
    assert digital.gamma == pytest.approx(four_block_gain(K), rel=0.05)


# --- a wrong rebuilt loop is detected ---------------------------------------------------------------------------------


HOSTILE = Path(__file__).resolve().parents[4] / "shared" / "data" / "hostile" / "hinf_r150.npz"


@pytest.mark.slow
@pytest.mark.shared
@pytest.mark.skipif(not HOSTILE.exists(), reason="measured data are missing")
def test_the_plant_of_a_false_certificate() -> None:
    """An earlier version certified 16.2949 for this K, whose norm is 17.25."""
    d = np.load(HOSTILE)
    _, _, n_y, n_u = (int(x) for x in d["dims"])
    P = StateSpaceModel(d["A"], d["B"], d["C"], d["D"])
    K = StateSpaceModel(d["kA"], d["kB"], d["kC"], d["kD"])
    assert rl.peak_gain(lower_lft(P, K)).upper < 16.3
    with pytest.raises(NoTrustworthyNumber, match=r"closed exactly have the norm 17\.25"):
        rl.reduce_controller(P, K, n_meas=n_y, n_con=n_u)


# --- every synthesis uses the checker ---------------------------------------------------------------------------------

WATCHED = StateSpaceModel(
    [[-1.0, 1.0], [0.0, -3.0]], [[1.0, 0.0, 0.0], [1.0, 0.0, 1.0]], [[1, 0], [0, 0], [1, 0]],
    [[0, 0, 0], [0, 0, 1], [0, 1, 0]], inputs=["d", "n", "u"], outputs=["x", "effort", "y"],
)  # fmt: skip
LAG = StateSpaceModel([[-0.1]], [[1.0]], [[1.0]], [[0.0]])
WRONG = 0.9


def wrong_lft(P: StateSpaceModel, K: StateSpaceModel) -> StateSpaceModel:
    """Return a rebuilt loop with nine tenths of the gain, as if digits had been lost in it."""
    true = lower_lft(P, K)
    return StateSpaceModel(
        true.A, true.B, WRONG * true.C, WRONG * true.D, true.dt, true.inputs, true.outputs, true.states
    )


@pytest.fixture
def wrong_loops(monkeypatch: pytest.MonkeyPatch) -> None:
    for module in (generalized_plant, gap_metric, sampled_norm):
        monkeypatch.setattr(module, "lower_lft", wrong_lft)


DESIGNS = {
    "hinf": lambda: rl.hinf(WATCHED, 1, 1),
    "mixsyn": lambda: rl.mixsyn(LAG, 0.5, 0.1),
    "h2": lambda: rl.h2(WATCHED, 1, 1),
    "ncf": lambda: rl.ncf(LAG),
    "dk": lambda: rl.dk(WATCHED, [rl.ComplexScalar("gain")], 1, 1, direct=False),
    "fixed": lambda: rl.fixed_structure(WATCHED, "static", n_meas=1, n_con=1, starts=1),
    "fixed h2": lambda: rl.fixed_structure(
        StateSpaceModel(WATCHED.A, WATCHED.B[:, [0, 2]], WATCHED.C, [[0, 0], [0, 1], [0, 0]]),
        "static", n_meas=1, n_con=1, starts=1, objective="h2",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", DESIGNS)
def test_designs_detect_a_wrong_rebuilt_loop(name: str, wrong_loops: None) -> None:
    design = DESIGNS[name]()
    assert design.status is Status.INACCURATE
    assert "closed exactly" in design.reason
    assert "proved in ball" not in design.reason
    if name == "dk":
        return
    # gamma is the larger norm, of the loop of P and K
    truth = lower_lft(design.plant.model, design.K)
    if name == "ncf":
        truth = lower_lft(gap_metric.four_block(design.shaped_plant), design.K_shaped)
    norm = rl.h2_norm(truth).value if "h2" in name else rl.peak_gain(truth).lower
    assert design.gamma == pytest.approx(norm, rel=1e-3)


def test_reduction_and_discretisation_detect_it_too(monkeypatch: pytest.MonkeyPatch) -> None:
    design = rl.hinf(WATCHED, 1, 1)
    assert rl.reduce_controller(design, loss=0.5).status is Status.CERTIFIED
    assert rl.discretise(design, 0.01, method="tustin").status.trustworthy
    for module in (generalized_plant, sampled_norm):
        monkeypatch.setattr(module, "lower_lft", wrong_lft)
    with pytest.raises(NoTrustworthyNumber, match="closed exactly"):
        rl.reduce_controller(design, loss=0.5)
    # Every chosen method is checked.
    for method in ("tustin", "auto"):
        digital = rl.discretise(design, 0.01, method=method, loss=10)
        assert digital.status is Status.INACCURATE
        assert "closed exactly" in digital.reason
        assert "closed exactly" in digital.norm.reason
