"""Generalised plants from models and uncertain models, scaling, and their loops."""

from __future__ import annotations

import numpy as np
import pytest

import robustlab as rl
from robustlab import RealScalar, UncertainModel, frequency_response, generalized_plant, hinf
from robustlab.errors import InputError
from robustlab.norms import hinf_norm
from robustlab.statespace import StateSpaceModel, lower_lft


def uncertain_model() -> UncertainModel:
    M = StateSpaceModel(
        [[-1.0, 0.2], [0.0, -2.0]],
        [[0.1, 1.0, 0.0], [0.0, 0.5, 1.0]],
        [[1.0, 0.0], [1.0, 1.0], [0.0, 1.0]],
        np.zeros((3, 3)),
        inputs=["w1", "force", "u"],
        outputs=["z1", "q", "v"],
    )
    return UncertainModel(M, [RealScalar("k")])


def test_thesis_ordering_delta_then_performance_then_measurement():
    plant = generalized_plant(uncertain_model(), measurements=["v"], controls=["u"])
    assert plant.model.input_names == ("w1", "force", "u")
    assert plant.model.output_names == ("z1", "q", "v", "v measured")
    assert (plant.n_meas, plant.n_con, len(plant.blocks)) == (1, 1, 1)
    m = plant.model
    assert m.C[2].tolist() == m.C[3].tolist()
    narrow = generalized_plant(uncertain_model(), ["v"], ["u"], disturbances=["force"], performance=["q"])
    assert narrow.model.output_names == ("z1", "q", "v")


def test_closing_the_generalised_plant_is_closing_the_uncertain_model():
    uncertain = uncertain_model()
    plant = generalized_plant(uncertain, ["v"], ["u"])
    K = StateSpaceModel([[-3.0]], [[1.0]], [[0.5]], [[-0.1]])
    loop = UncertainModel(plant.close(K), uncertain.blocks).evaluate({"k": 0.7})
    direct = lower_lft(
        generalized_plant(uncertain.evaluate({"k": 0.7}), ["v"], ["u"]).model,
        K,
    )
    omega = np.geomspace(1e-2, 1e2, 20)
    np.testing.assert_allclose(frequency_response(loop, omega), frequency_response(direct, omega), atol=1e-12)


def test_hinf_takes_an_uncertain_model_and_bounds_the_whole_of_delta_and_performance():
    plant = generalized_plant(uncertain_model(), ["v"], ["u"])
    design = hinf(plant)
    assert design.closed_loop.input_names == ("w1", "force")
    assert hinf_norm(design.closed_loop).value <= design.gamma


@pytest.mark.parametrize(("n_w", "n_z", "missing"), [(0, 0, "w and no performance"), (0, 1, "w"), (1, 0, "output z")])
@pytest.mark.parametrize("design", ["hinf", "h2", "fixed", "fixed of two", "sampled norm"])
def test_a_plant_without_performance_channels_is_refused(design, n_w, n_z, missing):
    """Every norm of its loop is zero."""
    P = StateSpaceModel(
        np.diag([1.0, -2.0]), np.ones((2, n_w + 1)), np.ones((n_z + 1, 2)), np.zeros((n_z + 1, n_w + 1))
    )
    calls = {
        "hinf": lambda: rl.hinf(P, 1, 1),
        "h2": lambda: rl.h2(P, 1, 1),
        "fixed": lambda: rl.fixed_structure(P, 1, n_meas=1, n_con=1),
        "fixed of two": lambda: rl.fixed_structure([P, P], 1, n_meas=1, n_con=1),
        "sampled norm": lambda: rl.sampled_data_norm(P, StateSpaceModel([], [], [], [[-5.0]], 0.01)),
    }
    with pytest.raises(InputError, match=f"no .*{missing}.* beside 1 controls and 1 measurements"):
        calls[design]()
