"""The second voice: P(jw) and K(jw) evaluated on their own, against arithmetic of 60 and more digits."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import robustlab as rl
from robustlab.errors import NoTrustworthyNumber
from robustlab.norms import h2_norm
from robustlab.result import Status
from robustlab.statespace import StateSpaceModel, lower_lft
from robustlab.synthesis.problem import partition
from robustlab.synthesis.problem.independent_check import h2_voice, hinf_voice
from robustlab.synthesis.problem.partition import GeneralizedPlant
from robustlab.synthesis.sampled import sampled_norm
from robustlab.uncertainty.distances import coprime

HOSTILE = Path(__file__).resolve().parents[4] / "shared" / "data" / "hostile" / "hinf_r150.npz"
flint = pytest.importorskip("flint")
BITS = 300


def balls(X: np.ndarray) -> Any:
    return flint.acb_mat([[flint.acb(float(v)) for v in row] for row in X])


def exact_response(m: StateSpaceModel, s: Any) -> Any:
    if not m.n_states:
        return balls(m.D)
    shifted = balls(-m.A)
    for i in range(m.n_states):
        shifted[i, i] += s
    return balls(m.C) * shifted.solve(balls(m.B)) + balls(m.D)


def part(M: Any, rows: range, columns: range) -> Any:
    return flint.acb_mat([[M[i, j] for j in columns] for i in rows])


def exact_loop(plant: GeneralizedPlant, K: StateSpaceModel, omega: float) -> np.ndarray:
    """``P11 + P12 K (I - P22 K)^-1 P21`` with the matrices as they are, in 90 digits."""
    before, flint.ctx.prec = flint.ctx.prec, BITS
    try:
        m = plant.model
        s = flint.acb(0, flint.arb(float(omega)))
        if m.dt:  # the point that floating point evaluates
            z = np.exp(1j * omega * m.dt)
            s = flint.acb(float(z.real), float(z.imag))
        P, k = exact_response(m, s), exact_response(K, s)
        n_z, n_w = m.n_outputs - plant.n_meas, m.n_inputs - plant.n_con
        z, y, w, u = range(n_z), range(n_z, m.n_outputs), range(n_w), range(n_w, m.n_inputs)
        loop = -part(P, y, u) * k
        for i in range(plant.n_meas):
            loop[i, i] += 1
        T = part(P, z, w) + part(P, z, u) * k * loop.solve(part(P, y, w))
        return np.array([[complex(T[i, j].mid()) for j in w] for i in z])
    finally:
        flint.ctx.prec = before


def gain(plant: GeneralizedPlant, K: StateSpaceModel, omega: float) -> float:
    return float(np.linalg.norm(exact_loop(plant, K, omega), 2))


@pytest.mark.shared
@pytest.mark.skipif(not HOSTILE.exists(), reason="measured data not beside the checkout")
def test_the_plant_that_broke_a_certificate() -> None:
    """Certified 16.2949 once, 17.25 in truth: the second voice says so, and what hinf certifies now is true."""
    d = np.load(HOSTILE)
    _, _, n_y, n_u = (int(x) for x in d["dims"])
    plant = GeneralizedPlant(StateSpaceModel(d["A"], d["B"], d["C"], d["D"]), n_y, n_u)
    K = StateSpaceModel(d["kA"], d["kB"], d["kC"], d["kD"])
    norm = rl.peak_gain(plant.close(K))
    voice = hinf_voice(plant, K, plant.close(K), [norm.frequency])
    truth = gain(plant, K, 0.0)
    assert voice.lower <= truth <= voice.upper
    assert voice.error <= 1e-5 * truth
    assert voice.doubt(norm.lower, norm.upper)
    assert voice.larger(norm.upper) == pytest.approx(17.250928592, rel=1e-8)
    design = rl.hinf(plant.model, n_y, n_u)
    assert design.status is Status.CERTIFIED or "separately" in design.reason
    for omega in (0.0, design.peak_frequency, *np.geomspace(1e-6, 1e14, 41)):
        assert gain(plant, design.K, omega) <= design.gamma * (1 + 1e-9)


def test_a_realisation_of_another_loop_is_found_out() -> None:
    """The controller leaves the loop unstable; the realisation handed over is that of one that does not."""
    P = StateSpaceModel([[1.0]], [[1.0, 1.0]], [[1.0], [1.0]], np.zeros((2, 2)))
    plant = GeneralizedPlant(P, 1, 1)
    weak, strong = (StateSpaceModel([], [], [], [[-k]]) for k in (0.5, 2.0))
    assert plant.close(strong).is_stable()
    assert not hinf_voice(plant, strong, plant.close(strong)).doubt(1.0, 1.0)
    assert "not shown to be stable" in hinf_voice(plant, weak, plant.close(strong)).doubt(0.0, np.inf)
    assert "not shown to be stable" in h2_voice(plant, weak, plant.close(strong), 0.7).doubt(0.0, np.inf)


# --- every synthesis asks it ------------------------------------------------------------------------------------------

PLANT = StateSpaceModel(
    [[-1.0, 1.0], [0.0, -3.0]], [[1.0, 0.0, 0.0], [1.0, 0.0, 1.0]], [[1, 0], [0, 0], [1, 0]],
    [[0, 0, 0], [0, 0, 1], [0, 1, 0]], inputs=["d", "n", "u"], outputs=["x", "effort", "y"],
)  # fmt: skip
LAG = StateSpaceModel([[-0.1]], [[1.0]], [[1.0]], [[0.0]])
LYING = 0.9


def lying_lft(P: StateSpaceModel, K: StateSpaceModel) -> StateSpaceModel:
    """A rebuilt loop with nine tenths of the gain: as if digits had been lost in it."""
    true = lower_lft(P, K)
    return StateSpaceModel(
        true.A, true.B, LYING * true.C, LYING * true.D, true.dt, true.inputs, true.outputs, true.states
    )


@pytest.fixture
def lie(monkeypatch: pytest.MonkeyPatch) -> None:
    for module in (partition, coprime, sampled_norm):
        monkeypatch.setattr(module, "lower_lft", lying_lft)


def dk_blocks() -> list[Any]:
    from robustlab.uncertainty.blocks import ComplexScalar

    return [ComplexScalar("gain")]


DESIGNS = {
    "hinf": lambda: rl.hinf(PLANT, 1, 1),
    "mixsyn": lambda: rl.mixsyn(LAG, 0.5, 0.1),
    "h2": lambda: rl.h2(PLANT, 1, 1),
    "ncf": lambda: rl.ncf(LAG),
    "dk": lambda: rl.dk(PLANT, dk_blocks(), 1, 1, direct=False),
    "fixed": lambda: rl.fixed_structure(PLANT, "static", n_meas=1, n_con=1, starts=1),
    "fixed h2": lambda: rl.fixed_structure(
        StateSpaceModel(PLANT.A, PLANT.B[:, [0, 2]], PLANT.C, [[0, 0], [0, 1], [0, 0]]),
        "static", n_meas=1, n_con=1, starts=1, objective="h2",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", DESIGNS)
def test_no_design_trusts_the_rebuilt_loop_alone(name: str, lie: None) -> None:
    design = DESIGNS[name]()
    assert design.status is Status.INACCURATE
    assert "separately" in design.reason
    # The larger number is shown: what the loop of P and K has, not what the lying realisation has.
    truth = lower_lft(design.plant.model, design.K)
    if name == "ncf":
        truth = lower_lft(coprime.four_block(design.shaped_plant), design.K_shaped)
    if name != "dk":
        norm = h2_norm(truth).value if "h2" in name else rl.peak_gain(truth).lower
        assert design.gamma == pytest.approx(norm, rel=1e-3)


@pytest.mark.parametrize("name", DESIGNS)
def test_designs_of_true_loops_are_confirmed(name: str) -> None:
    assert DESIGNS[name]().status.trustworthy


def test_reduction_and_discretisation_do_not_trust_it_either(monkeypatch: pytest.MonkeyPatch) -> None:
    design = rl.hinf(PLANT, 1, 1)
    assert rl.reduce_controller(design, loss=0.5).status is Status.CERTIFIED
    assert rl.discretise(design, 0.01, method="tustin").status.trustworthy
    for module in (partition, sampled_norm):
        monkeypatch.setattr(module, "lower_lft", lying_lft)
    with pytest.raises(NoTrustworthyNumber, match="evaluated separately"):
        rl.reduce_controller(design, loss=0.5)
    # Of all methods none is taken that was not heard because another one seemed better.
    for method in ("tustin", "auto"):
        digital = rl.discretise(design, 0.01, method=method, loss=10)
        assert digital.status is Status.INACCURATE
        assert "separately" in digital.reason
        assert "separately" in digital.norm.reason
