"""Exact delays against closed forms: responses, rational approximations, their errors, and weights."""

from fractions import Fraction
from math import comb, factorial

import numpy as np
import pytest

import robustlab as rl
from robustlab.delays import error_weight, pade, phase_bound
from robustlab.errors import InputError, NoTrustworthyNumber

OMEGA = np.geomspace(1e-3, 1e3, 301)
LAG = rl.StateSpaceModel([[-1.0]], [[1.0]], [[1.0]], [[0.0]])


def response(model, omega=OMEGA):
    return rl.frequency_response(model, omega)[:, 0, 0]


# --- the model --------------------------------------------------------------------------------------------------------


def test_a_delay_changes_only_the_phase():
    assert np.abs(response(rl.delay(0.7)) - np.exp(-0.7j * OMEGA)).max() < 1e-14


def test_a_smith_predictor_has_the_delay_outside_its_loop():
    plant, pi = LAG @ rl.delay(2.0), rl.StateSpaceModel([[0.0]], [[1.0]], [[0.5]], [[1.0]])
    predictor = LAG - LAG @ rl.delay(2.0)
    controller = rl.with_delays(pi).feedback(predictor)
    loop = (plant @ controller).feedback()
    s = 1j * OMEGA
    inner = (1 + 0.5 / s) / (s + 1)
    assert np.abs(response(loop) - np.exp(-2.0 * s) * inner / (1 + inner)).max() < 1e-10


def test_delays_at_inputs_and_outputs_by_name_and_number():
    plant = rl.StateSpaceModel(
        -np.eye(2), np.eye(2), [[1.0, 2.0], [3.0, 4.0]], np.zeros((2, 2)), inputs=["u", "v"], outputs=["y", "z"]
    )
    model = rl.with_delays(plant, inputs={"u": 0.1, 1: 0.2}, outputs={"z": 0.3})
    assert (model.input_names, model.output_names) == (("u", "v"), ("y", "z"))
    turn = [[0.1, 0.2], [0.4, 0.5]]
    expected = rl.frequency_response(plant, OMEGA) * np.exp(-1j * OMEGA[:, None, None] * np.array(turn))
    assert np.abs(rl.frequency_response(model, OMEGA) - expected).max() < 1e-13


def test_a_model_with_a_delay_and_a_direct_term_has_an_inverse():
    model = rl.with_delays(rl.StateSpaceModel([], [], [], [[1.0]])) + 0.5 * rl.delay(0.3)
    assert np.abs(response(model.inverse()) * response(model) - 1).max() < 1e-13
    with pytest.raises(NoTrustworthyNumber, match="inverse"):
        rl.delay(0.3).inverse()


def test_a_discrete_delay_is_a_chain_of_states():
    plant = rl.StateSpaceModel([[0.5]], [[1.0]], [[1.0]], [[0.0]], dt=0.1, inputs=["u"])
    late = rl.with_delays(plant, inputs={"u": 0.3}, outputs={0: 0.1})
    assert late.n_states == 5
    w = np.linspace(0.1, 30, 50)
    expected = rl.frequency_response(plant, w)[:, 0, 0] * np.exp(-0.4j * w)
    assert np.abs(response(late, w) - expected).max() < 1e-13
    with pytest.raises(InputError, match="whole number of samples"):
        rl.with_delays(plant, inputs={"u": 0.25})


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (lambda: rl.delay(-1.0), "0 s or more"),
        (lambda: rl.delay(np.inf), "finite"),
        (lambda: rl.delay(1.0, n=0), "delay: n: 0, expected a whole number of at least 1"),
        (lambda: rl.delay(True), "real numbers"),
        (lambda: rl.delay("1 s"), "real numbers"),
        (lambda: rl.with_delays(LAG, inputs={"none": 1.0}), "one of u1"),
        (lambda: rl.DelayedModel(LAG, [1.0, 2.0]), "at least 2"),
        (lambda: rl.h2_norm(rl.delay(1.0)), r"pade\(order\)"),
        (lambda: rl.delay(1.0) @ rl.delay(1.0).uncertain(2), "cover the delays first"),
        (lambda: rl.delay(1.0).pade(-1), "from 0 to 40"),
        (lambda: rl.frequency_response(rl.delay(1.0), [np.inf]), "finite"),
    ],
)
def test_invalid_requests_are_rejected(wrong, message):
    with pytest.raises(InputError, match=message):
        wrong()


def test_a_loop_without_delay_that_is_not_well_posed_is_rejected():
    one = rl.StateSpaceModel([], [], [], [[0.0, 1.0], [1.0, -1.0]])
    direct = rl.DelayedModel(one, [0.3])
    with pytest.raises(NoTrustworthyNumber, match="without delay"):
        direct.feedback()
    with pytest.raises(NoTrustworthyNumber, match="delay of zero"):
        rl.DelayedModel(rl.StateSpaceModel([], [], [], [[1.0, 1.0], [1.0, 0.0]]), [0.0])


# --- Padé -------------------------------------------------------------------------------------------------------------


def exact_phase_error(x: float, n: int) -> tuple[float, float]:
    """Real and imaginary part of R_n(jx) from the textbook sum, in rational numbers."""
    v = Fraction(x)
    terms = [Fraction(factorial(2 * n - k) * comb(n, k), factorial(2 * n)) for k in range(n + 1)]
    re = sum(c * v**k * (-1) ** (k // 2) for k, c in enumerate(terms) if k % 2 == 0)
    im = sum(c * v**k * (-1) ** (k // 2) for k, c in enumerate(terms) if k % 2)
    size = re * re + im * im
    return float((re * re - im * im) / size), float(-2 * re * im / size)


@pytest.mark.parametrize("order", [1, 2, 3, 5, 8, 13, 20, 40])
def test_the_realisation_is_the_textbook_fraction_and_an_all_pass(order):
    x = np.array([0.01, 0.3, 1.0, 4.0, 20.0, 100.0])
    model = pade(0.5, order)
    found = response(model, x / 0.5)
    expected = np.array([complex(*exact_phase_error(v, order)) for v in x])
    assert np.abs(found - expected).max() < 2e-14 * order
    assert np.abs(np.abs(response(model)) - 1).max() < 1e-13
    assert model.is_stable()
    # balanced: both Gramians are the identity
    assert np.abs(model.A + model.A.T + model.B @ model.B.T).max() < 1e-12 * np.abs(model.A).max()


@pytest.mark.parametrize("order", [0, 1, 2, 3, 4, 6, 9, 15, 25, 40])
def test_the_bound_and_the_weight_exceed_the_true_error(order):
    x = np.sort(np.concatenate([np.geomspace(1e-3, 1e3, 1500), np.linspace(0.1, 80, 3000)]))
    turn = np.exp(-1j * x)
    error = np.abs(turn - response(pade(1.0, order), x))
    bound = phase_bound(order)
    assert (error <= np.minimum(2.0, bound.coefficient * x**bound.power) + 1e-13).all()
    for k in {1, min(3, 2 * order + 1), 2 * order + 1 if order < 5 else 3}:
        weight = error_weight(order, k)
        size = np.abs(response(weight.scaled(1.0), x))
        assert (error <= size + 1e-13).all()
        formula = weight.gain * x**k / np.sqrt(x ** (2 * k) + weight.corner ** (2 * k))
        assert size == pytest.approx(formula, rel=1e-6)
    # tight: somewhere the default weight is within 1 % of it, except where slopes are equal
    if order > 1:
        near = error > 1e-6
        size = np.abs(response(error_weight(order, 3).scaled(1.0), x))
        assert (size[near] / error[near]).min() < 1.01


@pytest.mark.parametrize("order", [4, 5, 6, 9])
def test_a_range_from_zero_to_twice_the_delay_is_covered_in_every_order(order):
    cover = rl.with_delays(LAG, inputs={0: (0.0, 0.8)}, order=order)
    (block,) = cover.blocks
    weight = error_weight(order, 3, 1.0).scaled(0.4)
    # Padé's coefficients from the textbook, (2n - k)! / (2n)! times n over k
    den = [factorial(2 * order - k) * comb(order, k) / factorial(2 * order) for k in range(order + 1)]
    for w in np.geomspace(0.01, 300.0, 60):
        q = np.polyval(den[::-1], 0.4j * w)
        missed = np.exp(-1j * w * np.linspace(0.0, 0.8, 41)) - q.conjugate() / q
        size = abs(response(weight, [w])[0])
        assert np.abs(missed).max() <= size
        member = cover.response([w], {block.name: complex(missed[-1] / response(weight, [w])[0])})[0, 0, 0]
        assert member == pytest.approx(np.exp(-0.8j * w) / (1 + 1j * w), abs=1e-9)


def test_an_uncertain_model_with_a_delay_in_a_range():
    plant = rl.parametric([["-1/T"]], [["1/T"]], [[1]], [[0]], {"T": (1.0, 0.2)})
    late = rl.with_delays(plant, inputs={"u1": (0.1, 0.3)}, outputs={0: 0.2})
    known, ranged = "delay of 0.2 s (order 3, slope 3)", "u1: spread 1 of 0.2 s +- 0.1 s"
    assert {b.name for b in late.blocks} == {"T", known, ranged}
    w, rational = 3.0, response(pade(0.2, 3), [3.0])[0]
    turn, true = np.exp(-0.2j * w), np.exp(-0.14j * w)
    delta = {
        "T": 0.5,
        known: complex((turn - rational) / response(error_weight(3, 3).scaled(0.2), [w])[0]),
        ranged: complex((true - rational) / response(error_weight(3, 3, 0.1 / 0.2).scaled(0.2), [w])[0]),
    }
    assert all(abs(d) <= 1 for d in delta.values())
    expected = turn * true / (1 + 1j * w * plant.physical({"T": 0.5})["T"][0])
    assert late.response([w], delta)[0, 0, 0] == pytest.approx(expected, abs=1e-12)
    with pytest.raises(InputError, match="range of such"):
        rl.with_delays(plant, inputs={0: (0.3, 0.1)})
