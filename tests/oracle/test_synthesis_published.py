"""Published designs and benchmark plants: gamma against the best that is known, HIFOO 3.501 among them."""

import json
from pathlib import Path

import control
import h5py
import numpy as np
import pytest
from characterisation.designs import plant as plant_of

import robustlab as rl
from robustlab import h2, hinf, mixsyn, performance_weight
from robustlab.errors import NoTrustworthyNumber
from robustlab.norms import h2_norm, hinf_norm
from robustlab.result import Status
from robustlab.statespace import StateSpaceModel, append, lower_lft

SHARED = Path(__file__).parents[3] / "shared"
COMPLEIB = SHARED / "data" / "compleib.h5"
MASS = SHARED / "data" / "robust-designs" / "mass_damper_spring.json"

# Small plants of every kind of difficulty: singular D12 and D21, unstable, marginal, badly scaled.
PLANTS = ("NN1", "AC17", "AC5", "DIS5", "HE1", "HF2D13", "ROC7", "NN13", "PSM", "TF1", "HE5", "AC9", "EB3")


def skogestad_2_17() -> control.StateSpace:
    s = control.tf("s")
    return control.ss(200 / ((10 * s + 1) * (0.05 * s + 1) ** 2))


def skogestad_3_8() -> StateSpaceModel:
    """[[1, 1], [2 s + 1, 2]] / (0.2 s^2 + 1.2 s + 1): one second-order chain per input."""
    chain, zeros = np.array([[0.0, 1.0], [-5.0, -6.0]]), np.zeros((2, 2))
    A = np.block([[chain, zeros], [zeros, chain]])
    B = np.array([[0, 0], [1, 0], [0, 0], [0, 1]])
    return StateSpaceModel(A, B, [[5, 0, 5, 0], [5, 10, 10, 0]], np.zeros((2, 2)))


def assert_verified(design, gamma, tolerance):
    assert design.status is Status.CERTIFIED
    assert design.closed_loop.is_stable()
    assert hinf_norm(design.closed_loop).lower <= design.gamma
    assert design.gamma <= gamma * tolerance


def test_skogestad_2_17_first_weight():
    plant = skogestad_2_17()
    assert_verified(mixsyn(plant, performance_weight(10.0, 1e-4, 1.5), 1.0, gamma_rel=1.0), 1.36593, 1.001)


def test_skogestad_2_17_squared_weight_is_stable_where_python_control_is_not():
    """control.mixsyn returns gamma 2.2083 with an unstable loop here; see the record of that trap."""
    s = control.tf("s")
    plant = skogestad_2_17()
    weight = (s / 1.5**0.5 + 10) ** 2 / (s + 10 * 1e-4) ** 2
    # 2.2088 is attained; balls prove a level 0.1 % above it (weights of 1e-3 and 10 rad/s squared), and none nearer.
    assert_verified(mixsyn(plant, control.ss(weight), 1.0, gamma_rel=1.0), 2.2083, 1.0015)


@pytest.mark.parametrize(
    ("bandwidths", "gamma"), [((0.25, 0.25), 2.79548), ((0.25, 25.0), 2.91618), ((25.0, 0.25), 6.72285)]
)
def test_skogestad_3_8(bandwidths, gamma):
    first, second = (performance_weight(b, 1e-4, 1.5) for b in bandwidths)
    W1 = append(first.renamed(["u1"], ["y1"]), second.renamed(["u2"], ["y2"]))
    design = mixsyn(skogestad_3_8(), W1, 1.0, gamma_rel=1.0)
    assert_verified(design, gamma, 1.001)
    assert design.gamma >= gamma * 0.999


def test_scherer_1997_example_7():
    A = [[0, 10, 2], [-1, 1, 0], [0, 2, -5]]
    plant = StateSpaceModel(A, [[1, 0], [0, 1], [1, 0]], [[1, 0, 0], [0, 0, 0], [0, 1, 0]], [[0, 0], [0, 1], [2, 0]])
    design = hinf(plant, 1, 1, gamma_rel=1.0)
    assert_verified(design, 9.51, 1.001)
    assert design.gamma >= 9.5


@pytest.mark.shared
@pytest.mark.skipif(not MASS.exists(), reason="measured data not next to the checkout")
def test_mass_damper_spring():
    data = {k: np.array(v) for k, v in json.loads(MASS.read_text(encoding="utf-8"))["plant"].items()}
    w, z = slice(3, None), slice(3, None)  # the performance channel; the first three belong to Delta
    plant = StateSpaceModel(
        data["A"],
        np.hstack([data["B1"][:, w], data["B"]]),
        np.vstack([data["C1"][z], data["C"]]),
        np.block([[data["D11"][z, w], data["D12"][z]], [data["D21"][:, w], np.zeros((1, 1))]]),
    )
    assert_verified(hinf(plant, 1, 1, gamma_rel=1.0), 0.95, 1.001)


def compleib(name, best="gamma_full_best_verified"):
    with h5py.File(COMPLEIB) as file:
        known = float(file[name].attrs.get(best, np.nan))
    return *plant_of(name), known


@pytest.mark.slow
@pytest.mark.shared
@pytest.mark.skipif(not COMPLEIB.exists(), reason="measured data not next to the checkout")
def test_a_plant_whose_best_loops_lose_digits_says_so():
    """The optimum of NN3 has controller poles so fast that neither norm nor stability can be vouched for there."""
    plant, n_y, n_u, best = compleib("NN3")
    tight, calm = hinf(plant, n_y, n_u, gamma_rel=1.0), hinf(plant, n_y, n_u)
    assert tight.gamma <= 1.001 * best
    assert tight.status is Status.CERTIFIED or "not proved in ball arithmetic" in tight.reason
    assert_verified(calm, 1.05 * best, 1.001)


@pytest.mark.shared
@pytest.mark.skipif(not COMPLEIB.exists(), reason="measured data not next to the checkout")
@pytest.mark.parametrize("name", PLANTS)
def test_compleib_plants_reach_the_best_known_gamma(name):
    plant, n_y, n_u, best = compleib(name)
    design = hinf(plant, n_y, n_u, gamma_rel=1.0)
    assert_verified(design, best, 1.001)
    assert lower_lft(plant, design.K).is_stable()


@pytest.mark.shared
@pytest.mark.skipif(not COMPLEIB.exists(), reason="measured data not next to the checkout")
@pytest.mark.parametrize(
    "name", ["NN1", "AC5", "DIS5", "HE1", "NN3", "HF2D13", "ROC7", "PSM", "TF1", "HE5", "CSE1", "EB5"]
)
def test_compleib_plants_reach_the_best_known_h2_norm(name):
    plant, n_y, n_u, best = compleib(name, "h2_full_best_verified")
    design = h2(plant, n_y, n_u)
    # Without penalty and noise of its own NN3 gets a controller pole of 4e8 rad/s: whether the stability of that loop
    # is proved turns on the last bits of the processor's linear algebra. If it is not, the result reports it.
    unproved = name == "NN3" and design.reason.startswith("stability rests on ill-conditioned eigenvalues")
    assert design.status is (Status.INACCURATE if unproved else Status.CONVERGED)
    assert design.gamma <= 1.001 * best
    loop = lower_lft(plant, design.K)
    assert loop.is_stable()
    assert h2_norm(loop).value == pytest.approx(design.gamma, rel=1e-6)


@pytest.mark.shared
@pytest.mark.skipif(not COMPLEIB.exists(), reason="measured data not next to the checkout")
def test_a_plant_whose_direct_term_no_controller_cancels_is_refused():
    plant, n_y, n_u, _ = compleib("NN13")
    with pytest.raises(NoTrustworthyNumber, match="infinite for every controller"):
        h2(plant, n_y, n_u)


# --- static output feedback -------------------------------------------------------------------------------------------


@pytest.mark.shared
@pytest.mark.skipif(not COMPLEIB.exists(), reason="measured data not next to the checkout")
@pytest.mark.parametrize("name", ["NN15", "AC17", "AC5"])
def test_static_output_feedback_reaches_the_best_known(name):
    P, n_y, n_u, best = compleib(name, "static_hinf_best")
    *_, hifoo = compleib(name, "static_hinf_hifoo3501_measured")
    design = rl.fixed_structure(P, "static", n_meas=n_y, n_con=n_u, starts=2)
    norm = hinf_norm(lower_lft(P, design.K))
    assert norm.upper == pytest.approx(design.gamma, rel=1e-9)
    assert norm.upper <= 1.001 * min(best, hifoo)
