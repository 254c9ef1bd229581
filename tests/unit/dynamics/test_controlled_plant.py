"""Plants under feedback: loop algebra, members, dry friction; any upper layer above the platform's torque loops."""

import numpy as np
import pytest

import robustlab as rl
from robustlab.dynamics import actuator_cascade, controlled_plant
from robustlab.errors import InputError
from robustlab.statespace import StateSpaceModel

SEEN = ["phi", "omega", "i"]


@pytest.fixture(scope="module")
def actuator():
    return rl.plant("linear-actuator")


@pytest.fixture(scope="module")
def machine():
    return rl.plant("stewart-platform", motors=True)


def loop_by_hand(model, K):
    """A of the loop u = C x_k + D (r, x) around a model whose outputs are its states."""
    a = np.block([[model.A + model.B @ K.D[:, 1:], model.B @ K.C], [K.B[:, 1:], K.A]])
    return np.sort_complex(np.linalg.eigvals(a))


@pytest.mark.parametrize("member", [{}, {"R": 2.277, "J": 6.48e-6, "Km": 0.0494}])
def test_the_loop_of_every_member_has_the_poles_of_the_loop_algebra(actuator, member):
    K = actuator_cascade(actuator)
    loop = controlled_plant(actuator, K, ["phi"], SEEN)
    made = loop.with_parameters(**member) if member else loop
    model = actuator.with_parameters(**member).state_space() if member else actuator.state_space()
    np.testing.assert_allclose(np.sort_complex(made.state_space().poles()), loop_by_hand(model, K), rtol=1e-7)
    assert made.state_space().dc_gain()[0, 0] == pytest.approx(1.0, abs=1e-9)  # the angle follows


def test_the_cascade_has_its_triple_pole_where_the_torque_loop_is_fast(actuator):
    """(s + p)^3 for the upper layer, to the extent that 20000 /s is fast compared with 50 /s."""
    slow = actuator_cascade(actuator, 50.0, 20000.0)
    poles = controlled_plant(actuator, slow, ["phi"], SEEN).state_space().poles()
    upper = poles[np.abs(poles) < 1000]
    np.testing.assert_allclose(np.poly(upper), np.poly([-50.0] * 3), rtol=0.03)


def test_the_control_signal_is_an_output_and_friction_takes_its_volts(actuator):
    """Dry friction of 5 mN m on the way costs R / Km * 5e-3 V more than the free motor at the same speed."""
    loop = controlled_plant(actuator, actuator_cascade(actuator), ["phi"], SEEN)
    t = np.arange(0.0, 0.6, 1e-4)
    ramp = 100.0 * t[:, None]
    free = rl.simulate(loop, t, ramp)
    rough = rl.simulate(rl.with_effects(loop, {"coulomb-friction@omega": {"Fc": 5e-3}}), t, ramp)
    extra = rough["u"][-1] - free["u"][-1]
    assert rough["omega"][-1] == pytest.approx(100.0, rel=1e-3)
    assert extra == pytest.approx(2.07 / 0.052 * 5e-3, rel=1e-2)


def test_bad_loops(actuator):
    K = actuator_cascade(actuator)
    with pytest.raises(InputError, match="did you mean phi"):
        controlled_plant(actuator, K, ["phii"], SEEN)
    with pytest.raises(InputError, match="3 and 1"):
        controlled_plant(actuator, K, ["phi"], ["phi", "omega"])
    discrete = StateSpaceModel(K.A * 0, K.B, K.C, K.D, 0.01)
    with pytest.raises(InputError, match="continuous"):
        controlled_plant(actuator, discrete, ["phi"], SEEN)


@pytest.mark.parametrize(("p_up", "p_low"), [(0.0, 3000.0), (236.0, -1.0), (np.nan, 3000.0)])
def test_bad_poles(actuator, p_up, p_low):
    with pytest.raises(InputError):
        actuator_cascade(actuator, p_up, p_low)
