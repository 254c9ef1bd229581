"""A plant with effects: simulated, trimmed and linearised, judged by closed forms and other integrators."""

import numpy as np
import pytest
from oracle.stick_slip import stick_slip
from scipy.integrate import solve_ivp

import robustlab as rl
from robustlab.dynamics import Law, holding_force, is_set_valued, rest_band

T = np.arange(2001) * 1e-3


def axis(**effects):
    return rl.with_effects(rl.plant("servo-axis"), {name.replace("_", "-"): v for name, v in effects.items()})


def law_of(plant) -> Law:
    return plant.laws[0][1]


# --- laws at one instant ---------------------------------------------------------------------------------------------


def test_coulomb_friction_is_a_band_of_holding_forces_at_rest():
    law = law_of(axis(coulomb_friction={"Fc": 20.0}))
    assert is_set_valued(law, 0.0)
    assert rest_band(law, 0.0) == pytest.approx((-20.0, 20.0))
    assert holding_force(law, 0.0, 3.0, 0.5) == pytest.approx(-6.0)
    assert holding_force(law, 0.0, 30.0, 0.5) == pytest.approx(-20.0)


# --- simulation ------------------------------------------------------------------------------------------------------


def test_stick_slip_agrees_with_the_event_driven_solution():
    u = 1.5 * np.sin(6 * T)
    exact = stick_slip(rl.plant("servo-axis"), "v", 20.0, T, u)
    stroke = np.ptp(exact.record["q"])
    assert (exact.sliding == 0).any()
    assert (exact.sliding != 0).any()
    found = rl.simulate(axis(coulomb_friction={"Fc": 20.0}), T, u)
    assert np.abs(found["q"] - exact.record["q"]).max() < 1e-4 * stroke
    stuck = np.abs(found["v"][exact.sliding == 0])
    assert (stuck < 1e-15 * np.abs(found["v"]).max()).mean() > 0.98  # the rounding of the step, no creep


def test_a_smooth_effect_agrees_with_scipy_on_the_plants_own_derivative():
    plant = rl.with_effects(
        rl.plant("mass-spring-damper"), {"quadratic-drag": {"c": 0.4}, "cubic-stiffness": {"k3": 3.0}}
    )
    t = np.arange(1001) * 2e-3
    found = rl.simulate(plant, t, np.ones(len(t)), x0=[0.5, 0.0], step=1e-4)
    m, c, k = (plant.values[name] for name in ("m", "c", "k"))

    def by_hand(_, x):
        q, v = x
        return [v, (1.0 - c * v - k * q - 0.4 * v * abs(v) - 3.0 * q**3) / m]

    truth = solve_ivp(by_hand, (0, t[-1]), [0.5, 0.0], "DOP853", t_eval=t, rtol=1e-11, atol=1e-12).y
    assert np.abs(found["q"] - truth[0]).max() < 2e-6 * np.ptp(truth[0])
    for x in ([0.3, -0.7], [0.5, 2.0]):
        np.testing.assert_allclose(plant.derivative(x, [1.0]), by_hand(0, x), rtol=1e-9)


# --- trim ------------------------------------------------------------------------------------------------------------


def test_friction_holds_an_input_up_to_its_level():
    plant = axis(coulomb_friction={"Fc": 20.0})
    gain = plant.values["gain"]
    trim = rl.trim(plant, u=0.5, q=0.2)
    assert trim.x.tolist() == [0.2, 0.0]
    (held,) = trim.holding
    assert (held.effect, held.site, held.unit) == ("coulomb-friction", "v", "N")
    assert held.force == pytest.approx(-0.5 * gain)
    assert (held.lower, held.upper) == pytest.approx((-20.0, 20.0))
    assert rl.trim(plant, u=19.999 / gain).holding
    with pytest.raises(rl.NoTrustworthyNumber, match=r"no rest with u = 0\.569"):
        rl.trim(plant, u=20.01 / gain)


# --- linear models ---------------------------------------------------------------------------------------------------


def test_the_linear_model_of_smooth_effects_is_the_analytic_one():
    plant = rl.with_effects(
        rl.plant("mass-spring-damper"), {"quadratic-drag": {"c": 0.4}, "cubic-stiffness": {"k3": 3.0}}
    )
    m, c, k = (plant.values[name] for name in ("m", "c", "k"))
    model = rl.linearise(plant, at=([0.4, -0.5], [1.0]))
    truth = [[0, 1], [-(k + 9.0 * 0.16) / m, -(c + 2 * 0.4 * 0.5) / m]]
    np.testing.assert_allclose(model.A, truth, rtol=1e-8, atol=1e-12)
    assert model.operating_point.x.tolist() == [0.4, -0.5]


def test_dry_friction_is_reported_as_omitted_or_taken_at_an_amplitude():
    plant = axis(coulomb_friction={"Fc": 20.0})
    np.testing.assert_array_equal(rl.linearise(plant).A, rl.plant("servo-axis").state_space().A)
    (missing,) = plant.left_out(amplitude={})
    assert "set-valued" in missing.reason
    damped = rl.linearise(plant, amplitude={"v": 0.1})
    # half of the relay's describing function 4 Fc / (pi a)
    extra = 0.5 * 4 * 20.0 / (np.pi * 0.1) / plant.values["M"]
    assert rl.linearise(plant).A[1, 1] - damped.A[1, 1] == pytest.approx(extra, rel=1e-12)
    moving = rl.linearise(plant, at=([0.0, 0.3], [1.0]))
    np.testing.assert_allclose(moving.A, rl.linearise(plant).A, atol=1e-12)


# --- uncertainty -----------------------------------------------------------------------------------------------------


def rebuilt(parameters, effects, delta_of, name="dc-motor"):
    """A, B, C, D of the plant rebuilt with every value moved by delta_of(name) times its radius."""
    plant = rl.plant(name)
    moved = {n: plant.values[n] * (1 + delta_of(n) * tolerance) for n, tolerance in parameters.items()}
    return rl.linearise(rl.with_effects(rl.plant(name, **{n: (v, 0.0) for n, v in moved.items()}), effects))


def test_the_uncertain_model_is_the_rebuilt_plant():
    parameters = {"R": 0.1, "J": 0.2, "Kf": 0.3}
    coupling = {"f": 40.0, "zeta": 0.05, "share": 0.3}
    nominal = rl.plant("dc-motor")
    plant = rl.with_effects(
        rl.plant("dc-motor", **{n: (nominal.values[n], t) for n, t in parameters.items()}),
        {
            "flexible-coupling": coupling,
            "torque-constant": {"s": (1.1, 0.02)},
            "stiffness@omega": {"k": (1e-3, 1e-4)},
            "input-gain": {"s": (0.9, 0.03)},
            "sensor-gain@phi": {"s": (1.05, 0.01)},
        },
    )
    uncertain = rl.uncertain_from(plant).model
    names = [b.name for b in uncertain.blocks]
    assert set(names) == {
        "R", "J", "Kf", "torque-constant(Km+Kb)", "stiffness@omega.k", "input-gain@u", "sensor-gain@phi"
    }  # fmt: skip
    rng = np.random.default_rng(3)
    for _ in range(5):
        delta = {name: float(rng.uniform(-1, 1)) for name in names}
        effects = {
            "flexible-coupling": coupling,
            "torque-constant": {"s": 1.1 + 0.04 * delta["torque-constant(Km+Kb)"]},
            "stiffness@omega": {"k": 1e-3 + 2e-4 * delta["stiffness@omega.k"]},
            "input-gain": {"s": 0.9 + 0.06 * delta["input-gain@u"]},
            "sensor-gain@phi": {"s": 1.05 + 0.02 * delta["sensor-gain@phi"]},
        }
        truth, found = rebuilt(parameters, effects, delta.__getitem__), uncertain.evaluate(delta)
        for name in "ABCD":
            np.testing.assert_allclose(
                getattr(found, name), getattr(truth, name), rtol=1e-9, atol=1e-9 * np.abs(getattr(truth, name)).max()
            )


# --- a bare model, and more effects on a plant that has some ---------------------------------------------------------


def test_a_bare_model_takes_effects_as_accelerations():
    plant = rl.plant("servo-axis")
    on_model = rl.with_effects(rl.linearise(plant), {"coulomb-friction": {"Fc": 20.0 / plant.values["M"]}})
    u = np.sin(5 * T)
    np.testing.assert_allclose(
        rl.simulate(on_model, T, u)["q"], rl.simulate(axis(coulomb_friction={"Fc": 20.0}), T, u)["q"], atol=1e-13
    )
