"""Designs prove the loop of P and K in ball arithmetic: a wrong rebuilt loop is detected."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import robustlab as rl
from robustlab.errors import NoTrustworthyNumber
from robustlab.result import Status
from robustlab.statespace import StateSpaceModel, lower_lft
from robustlab.synthesis.problem import partition
from robustlab.synthesis.sampled import sampled_norm
from robustlab.uncertainty.distances import coprime
from robustlab.verification import Claim, check

HOSTILE = Path(__file__).resolve().parents[4] / "shared" / "data" / "hostile" / "hinf_r150.npz"


def loop_norm_proved(P: StateSpaceModel, K: StateSpaceModel, gamma: float) -> bool:
    """Prove the norm by the checker alone."""
    numbers: dict[str, Any] = {f"P_{x}": getattr(P, x) for x in "ABCD"} | {f"K_{x}": getattr(K, x) for x in "ABCD"}
    sizes = {"n_meas": np.array(K.n_inputs), "n_con": np.array(K.n_outputs)}
    claim = Claim("loop-norm", numbers | sizes | {"dt": np.array(P.dt), "gamma": np.array(gamma)})
    return check(claim).outcome.value == "proved"


@pytest.mark.slow
@pytest.mark.shared
@pytest.mark.skipif(not HOSTILE.exists(), reason="measured data are missing")
def test_the_plant_of_a_false_certificate() -> None:
    """An earlier version certified 16.2949 for this K, whose norm is 17.25; the present design is proved."""
    d = np.load(HOSTILE)
    _, _, n_y, n_u = (int(x) for x in d["dims"])
    P = StateSpaceModel(d["A"], d["B"], d["C"], d["D"])
    K = StateSpaceModel(d["kA"], d["kB"], d["kC"], d["kD"])
    assert rl.peak_gain(lower_lft(P, K)).upper < 16.3
    with pytest.raises(NoTrustworthyNumber, match=r"closed exactly have the norm 17\.25"):
        rl.reduce_controller(P, K, n_meas=n_y, n_con=n_u)
    design = rl.hinf(P, n_y, n_u)
    assert design.status is Status.CERTIFIED
    assert loop_norm_proved(P, design.K, design.gamma * (1 + 2e-6))


# --- every synthesis uses the checker ---------------------------------------------------------------------------------

PLANT = StateSpaceModel(
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
    for module in (partition, coprime, sampled_norm):
        monkeypatch.setattr(module, "lower_lft", wrong_lft)


DESIGNS = {
    "hinf": lambda: rl.hinf(PLANT, 1, 1),
    "mixsyn": lambda: rl.mixsyn(LAG, 0.5, 0.1),
    "h2": lambda: rl.h2(PLANT, 1, 1),
    "ncf": lambda: rl.ncf(LAG),
    "dk": lambda: rl.dk(PLANT, [rl.ComplexScalar("gain")], 1, 1, direct=False),
    "fixed": lambda: rl.fixed_structure(PLANT, "static", n_meas=1, n_con=1, starts=1),
    "fixed h2": lambda: rl.fixed_structure(
        StateSpaceModel(PLANT.A, PLANT.B[:, [0, 2]], PLANT.C, [[0, 0], [0, 1], [0, 0]]),
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
        truth = lower_lft(coprime.four_block(design.shaped_plant), design.K_shaped)
    norm = rl.h2_norm(truth).value if "h2" in name else rl.peak_gain(truth).lower
    assert design.gamma == pytest.approx(norm, rel=1e-3)


def test_reduction_and_discretisation_detect_it_too(monkeypatch: pytest.MonkeyPatch) -> None:
    design = rl.hinf(PLANT, 1, 1)
    assert rl.reduce_controller(design, loss=0.5).status is Status.CERTIFIED
    assert rl.discretise(design, 0.01, method="tustin").status.trustworthy
    for module in (partition, sampled_norm):
        monkeypatch.setattr(module, "lower_lft", wrong_lft)
    with pytest.raises(NoTrustworthyNumber, match="closed exactly"):
        rl.reduce_controller(design, loss=0.5)
    # Every chosen method is checked.
    for method in ("tustin", "auto"):
        digital = rl.discretise(design, 0.01, method=method, loss=10)
        assert digital.status is Status.INACCURATE
        assert "closed exactly" in digital.reason
        assert "closed exactly" in digital.norm.reason
