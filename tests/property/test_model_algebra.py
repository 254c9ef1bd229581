"""Arithmetic of models and of sets of them: identities, python-control as the judge, and what is refused."""

import control
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robustlab import ComplexScalar, RealScalar, UncertainModel, frequency_response
from robustlab.errors import InputError, NoTrustworthyNumber, UnitMismatch
from robustlab.statespace import StateSpaceModel, append, feedback, lower_lft

OMEGA = np.append(0.0, np.geomspace(0.05, 50.0, 11))
SEEDS = st.integers(0, 10**6)
SIZES = st.integers(1, 3)
TIMES = st.sampled_from([0.0, 0.1])


def model(rng, n, n_y, n_u, dt=0.0, invertible=False):
    """A stable random model; with ``invertible`` its D is far from singular."""
    a = rng.normal(size=(n, n))
    size = max(np.abs(np.linalg.eigvals(a)).max(initial=0.0), 1.0)
    a = 0.7 * a / size if dt else a - (size + 0.5) * np.eye(n)
    d = rng.normal(size=(n_y, n_u))
    if invertible:
        d = np.linalg.qr(d)[0] * rng.uniform(0.5, 2.0, n_u)
    return StateSpaceModel(a, rng.normal(size=(n, n_u)), rng.normal(size=(n_y, n)), d, dt)


def at(g):
    return frequency_response(g, OMEGA)


def judged(system):
    """Response by python-control, frequency first."""
    return np.moveaxis(
        np.asarray(system(1j * OMEGA if not system.dt else np.exp(1j * OMEGA * system.dt), squeeze=False)), -1, 0
    )


def close(found, wanted):
    return np.abs(found - wanted).max(initial=0.0) <= 1e-12 * max(1.0, np.abs(wanted).max(initial=0.0))


@settings(max_examples=25)
@given(SEEDS, st.integers(0, 4), st.integers(0, 4), SIZES, SIZES, SIZES, TIMES)
def test_every_expression_is_that_of_python_control(seed, n1, n2, n_y, n_m, n_u, dt):
    rng = np.random.default_rng(seed)
    G, H, F = model(rng, n1, n_y, n_m, dt), model(rng, n2, n_m, n_u, dt), model(rng, n2, n_y, n_m, dt)
    g, h, f = (m.to_control() for m in (G, H, F))
    matrix = rng.normal(size=(n_y, n_y))
    for ours, theirs in (
        (G * H, g * h),
        (G @ H, g * h),
        (G + F, g + f),
        (G - F, g - f),
        (-G, -g),
        (2 * G, 2 * g),
        (G * 2.5, g * 2.5),
        (G / 4, g / 4),
        (matrix @ G, control.ss([], [], [], matrix, dt) * g),
        (G[:, 0], g[:, 0]),
        (G[0, :], g[0, :]),
        (G[-1, [n_m - 1]], g[n_y - 1, n_m - 1]),
        (G["y1", "u1"], g["y1", "u1"]),
        (G * h, g * h),
        (G + f, g + f),
    ):
        assert isinstance(ours, StateSpaceModel)
        assert close(at(ours), judged(theirs))


@settings(max_examples=25)
@given(SEEDS, st.integers(0, 4), SIZES, TIMES, st.integers(-2, 3))
def test_powers_are_those_of_python_control(seed, n, size, dt, exponent):
    G = model(np.random.default_rng(seed), n, size, size, dt, invertible=True)
    wanted = np.linalg.matrix_power(at(G), exponent)
    found = at(G**exponent)
    assert np.abs(found - wanted).max() <= 1e-9 * max(1.0, np.abs(wanted).max())
    if exponent > 0:
        assert close(found, judged(G.to_control() ** exponent))


def lag(dt=0.0, **names):
    return StateSpaceModel([[0.5 if dt else -1.0]], [[1.0]], [[1.0]], [[0.0]], dt, **names)


VOLTS, METRES = {"inputs": [("u", "V")], "outputs": [("y", "m")]}, {"inputs": [("w", "N")], "outputs": [("z", "rad")]}
TWO = StateSpaceModel([], [], [], np.eye(2), inputs=["u", "v"], outputs=["y", "z"])
SET = UncertainModel(StateSpaceModel([], [], [], [[0.0, 0.5], [1.0, 1.0]]), [RealScalar("k")])


@pytest.mark.parametrize(
    ("ask", "error", "text"),
    [
        (lambda: lag() ** -1, NoTrustworthyNumber, "inverse: D is singular"),
        (lambda: TWO[:, 0] ** -1, InputError, "inverse: 2 x 1, expected a square model"),
        (lambda: TWO**0.5, InputError, "exponent 0.5, expected a whole number"),
        (lambda: TWO + lag(), InputError, "2 x 2 and 1 x 1, expected equal sizes"),
        (lambda: TWO + 1.0, InputError, "equal sizes"),
        (lambda: TWO @ lag(), InputError, "1 outputs into 2 inputs, expected equal numbers"),
        (lambda: lag(**VOLTS) @ lag(**METRES), UnitMismatch, r"z \[rad\] meets u \[V\]"),
        (lambda: lag(**VOLTS) + lag(**METRES), UnitMismatch, r"u \[V\] meets w \[N\]"),
        (lambda: lag() + lag(0.1), InputError, "sample times"),
        (lambda: TWO[0], InputError, r"two indices: G\[outputs, inputs\]"),
        (lambda: TWO[2, 0], InputError, "output 2: no such signal, expected a name, or a number from 0 to 1"),
        (lambda: TWO["x", "u"], InputError, "output 'x': no such signal, expected one of y, z"),
        (lambda: TWO[:, True], InputError, "input True"),
        (lambda: TWO / 0, InputError, "division: by 0"),
        (lambda: TWO / TWO, InputError, "by StateSpaceModel, expected a number"),
        (lambda: TWO * "two", InputError, "str, expected a StateSpaceModel"),
        (lambda: TWO * [[1j, 0], [0, 1]], InputError, "complex"),
        (lambda: SET[0, 1], InputError, "input 1: no such signal"),
        (lambda: SET + UncertainModel(SET.M, [ComplexScalar("k")]), InputError, "'k'"),
    ],
)
def test_what_does_not_fit_is_refused_in_one_line(ask, error, text):
    with pytest.raises(error, match=text) as raised:
        ask()
    assert "\n" not in raised.value.line


def test_signals_keep_their_names_and_units():
    g, h = lag(**VOLTS), lag(**METRES)
    assert (2 * g).outputs == (np.eye(1) @ g).outputs == g.outputs
    assert (g * 2).inputs == g.inputs
    assert (g + 1.0).outputs == (1.0 + g).outputs == g.outputs
    assert (h.renamed([("y", "m")]) @ g).inputs == g.inputs
    assert g["y", "u"].outputs == g.outputs
    assert (TWO**-1).inputs == TWO.outputs


# --- interconnections judged by the algebra of their frequency responses, and by python-control's own -----------------


def pair(seed, first, second, dt=0.0):
    """Two models of given (states, outputs, inputs)."""
    rng = np.random.default_rng(seed)
    return model(rng, *first, dt), model(rng, *second, dt)


STATES, CHANNELS = st.integers(0, 4), st.integers(0, 3)


@settings(max_examples=40)
@given(SEEDS, STATES, STATES, SIZES, SIZES, TIMES, st.sampled_from([-1, 1]))
def test_feedback_solves_the_loop_equation(seed, n1, n2, n_u, n_y, dt, sign):
    plant, controller = pair(seed, (n1, n_y, n_u), (n2, n_u, n_y), dt)
    if np.linalg.cond(np.eye(n_u) - sign * controller.D @ plant.D) > 1e6:
        return
    g, k, t = at(plant), at(controller), at(feedback(plant, controller, sign))
    # y = G (r + sign K y)
    np.testing.assert_allclose(t, g + sign * g @ k @ t, rtol=1e-7, atol=1e-7 * max(1.0, np.abs(t).max()))


@settings(max_examples=40)
@given(SEEDS, STATES, STATES, SIZES, SIZES, SIZES, SIZES, TIMES)
def test_lower_lft_is_its_formula(seed, n1, n2, n_w, n_z, n_u, n_y, dt):
    plant, controller = pair(seed, (n1, n_z + n_y, n_w + n_u), (n2, n_u, n_y), dt)
    if np.linalg.cond(np.eye(n_u) - controller.D @ plant.D[n_z:, n_w:]) > 1e6:
        return
    p, k = at(plant), at(controller)
    p11, p12, p21, p22 = p[:, :n_z, :n_w], p[:, :n_z, n_w:], p[:, n_z:, :n_w], p[:, n_z:, n_w:]
    wanted = p11 + p12 @ k @ np.linalg.solve(np.eye(n_y) - p22 @ k, p21)
    found = lower_lft(plant, controller)
    np.testing.assert_allclose(at(found), wanted, rtol=1e-7, atol=1e-7 * max(1.0, np.abs(wanted).max()))
    assert found.input_names == plant.input_names[:n_w]
    assert found.output_names == plant.output_names[:n_z]


@settings(max_examples=40)
@given(SEEDS, STATES, STATES, CHANNELS, SIZES, SIZES, CHANNELS)
def test_append_is_block_diagonal(seed, n1, n2, u1, y1, u2, y2):
    first, second = pair(seed, (n1, y1, u1), (n2, y2, u2))
    second = second.renamed([f"v{k}" for k in range(u2)], [f"z{k}" for k in range(y2)])
    g = at(append(first, second))
    assert g.shape == (len(OMEGA), y1 + y2, u1 + u2)
    np.testing.assert_allclose(g[:, :y1, :u1], at(first), atol=1e-12)
    np.testing.assert_allclose(g[:, y1:, u1:], at(second), atol=1e-12)
    assert not g[:, :y1, u1:].any()
    assert not g[:, y1:, :u1].any()
