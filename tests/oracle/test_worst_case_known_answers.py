"""Worst cases that are known: closed forms, vertices, interior maxima, the thesis' motor, brute force."""

import itertools

import control
import numpy as np
import pytest
import scipy.optimize

from robustlab import ComplexScalar, FullBlock, ParameterRange, RealScalar, UncertainModel, elementwise
from robustlab.errors import InputError, NoTrustworthyNumber, UsageError
from robustlab.result import Status
from robustlab.statespace import StateSpaceModel
from robustlab.worst_case_analysis import sample, worst_case

# --- the thesis' motor (Maxon RE 35), no-load step of 42 V -----------------------------------------------------------

R, L, KM, KB, KF, J = 2.07, 0.62e-3, 0.052, 0.052, 4.8e-5, 7.2e-6


def steady_speed(kf):
    return 42.0 * KM / (R * kf + KM * KB)


def motor():
    m = StateSpaceModel(
        [[-KF / J, KM / J], [-KB / L, -R / L]],
        [[-0.35 * KF / J, 0.0], [0.0, 1 / L]],
        [[1.0, 0.0], [1.0, 0.0], [0.0, 1.0]],
        np.zeros((3, 2)),
        inputs=["w", ("u", "V")],
        outputs=["z", ("omega", "rad/s"), ("i", "A")],
        states=["omega", "i"],
    )
    return UncertainModel(m, [RealScalar("Kf", parameter=ParameterRange(KF, 0.35 * KF, "N m s"))])


def test_motor_band_of_the_no_load_speed():
    found = sample(motor(), 20, seed=1, vertices="all").respond(np.linspace(0, 0.1, 401), {"u": 42.0})
    # Published: 779.1 nominal; +-35 % in Kf give [769.52, 788.85] and cover the maker's 788.54 rad/s.
    assert found.nominal[-1, 0] == pytest.approx(steady_speed(KF), abs=1e-3)
    assert found.nominal[-1, 0] == pytest.approx(779.1, abs=0.05)
    assert found.lower[-1, 0] == pytest.approx(769.52, abs=0.005)
    assert found.upper[-1, 0] == pytest.approx(788.85, abs=0.005)
    assert found.upper[-1, 0] > 7530 * 2 * np.pi / 60


def test_motor_worst_speed_deviation():
    found = worst_case(motor(), output="omega", u={"u": 42.0}, t=np.linspace(0, 0.1, 401))
    assert found.value == pytest.approx(steady_speed(0.65 * KF) - steady_speed(KF), rel=1e-5)
    assert found.delta == {"Kf": -1.0}
    assert found.physical["Kf"] == (pytest.approx(0.65 * KF), "N m s")
    assert (found.unit, found.at, found.status) == ("rad/s", 0.1, Status.CONVERGED)
    assert found.nominal_value == 0.0
    assert "lower bound" in found.label
    assert "guarantee" not in found.label


# --- peak deviation --------------------------------------------------------------------------------------------------


def polynomial(*coefficients):
    """Static gain ``sum c_k delta^k``, as one real scalar repeated as often as its degree."""
    degree = len(coefficients)
    d11 = np.diag(np.ones(degree - 1), -1)
    d = np.block([[d11, np.eye(degree)[:, :1]], [np.array([coefficients]), np.zeros((1, 1))]])
    return UncertainModel(
        StateSpaceModel(np.zeros((0, 0)), np.zeros((0, degree + 1)), np.zeros((degree + 1, 0)), d),
        [RealScalar("x", degree)],
    )


def test_interior_maximum_of_a_polynomial():
    found = worst_case(polynomial(1.0, 0.0, -1.0), t=[0.0, 1.0])  # x - x^3
    assert found.value == pytest.approx(2 / (3 * np.sqrt(3)), rel=1e-12)
    assert abs(found.delta["x"]) == pytest.approx(1 / np.sqrt(3), abs=1e-5)


def test_more_parameters_than_vertices_can_be_listed():
    rng = np.random.default_rng(4)
    change = rng.standard_normal((1, 30))
    empty = (np.zeros((0, 0)), np.zeros((0, 30)), np.zeros((1, 0)))
    model = elementwise(StateSpaceModel(*empty, np.ones((1, 30))), StateSpaceModel(*empty, 1.0 + change))
    found = worst_case(model, t=[0.0, 1.0], u=np.ones((2, 30)), n=16)
    assert found.value == pytest.approx(np.abs(change).sum(), rel=1e-10)


def test_peak_deviation_of_a_resonance_against_brute_force():
    def model(k):
        return StateSpaceModel([[0.0, 1.0], [-k, -0.3]], [[0.0], [1.0]], [[1.0, 0.0]], [[0.0]])

    t = np.linspace(0.0, 6.0, 121)

    def deviation(delta):
        y = [
            control.forced_response(model(k).to_control(), t, np.ones_like(t)).outputs for k in (4.0 + 2.0 * delta, 4.0)
        ]
        return np.abs(y[0] - y[1]).max()

    found = worst_case(elementwise(model(4.0), model(6.0)), t=t)
    brute = max(deviation(d) for d in np.linspace(-1, 1, 81))
    assert found.value >= brute * (1 - 1e-9)
    assert found.value == pytest.approx(deviation(next(iter(found.delta.values()))), rel=1e-6)


# --- H-infinity gain -------------------------------------------------------------------------------------------------


def test_interior_worst_gain_where_two_resonances_meet():
    """Product of a fixed resonance at 1 rad/s and one that the parameter moves across it."""

    def product(k):
        a = [[0, 1, 0, 0], [-k, -0.1, 0, 0], [0, 0, 0, 1], [1, 0, -1, -0.1]]
        return StateSpaceModel(a, [[0], [1], [0], [0]], [[0, 0, 1, 0]], [[0]])

    def peak(k):
        w = np.linspace(0.5, 1.6, 20_001)
        s = 1j * w
        return np.abs(1 / ((s * s + 0.1 * s + k) * (s * s + 0.1 * s + 1))).max()

    found = worst_case(elementwise(product(1.2), product(1.7)), "hinf")
    delta = next(iter(found.delta.values()))
    best = scipy.optimize.minimize_scalar(
        lambda k: -peak(k), bounds=(0.7, 1.7), method="bounded", options={"xatol": 1e-6}
    )
    assert found.value == pytest.approx(-best.fun, rel=1e-5)
    assert 1.2 + 0.5 * delta == pytest.approx(best.x, abs=1e-3)
    assert -0.9 < delta < 0.9
    assert found.status is Status.CONVERGED
    assert found.value > 2 * found.nominal_value


@pytest.mark.parametrize("block", [ComplexScalar("d"), FullBlock("d", 1, 1)])
def test_complex_scalar_in_closed_form(block):
    """|2 + 0.5 d| <= 2.5 in the disc, attained at d = 1 times any lag's peak at zero frequency."""
    m = StateSpaceModel([[-1.0]], [[0.5, 2.0]], [[0.0], [1.0]], [[0.0, 1.0], [0.0, 0.0]])
    found = worst_case(UncertainModel(m, [block]), "hinf")
    assert found.value == pytest.approx(2.5, rel=1e-6)
    assert found.status is Status.CONVERGED


def test_full_block_in_closed_form():
    """``|d + a Delta b|`` over ``sigma_max(Delta) <= 1`` is ``|d| + |a| |b|``."""
    a, b = np.array([[3.0, -4.0]]), np.array([[1.0], [2.0], [2.0]])
    d = np.block([[np.zeros((3, 2)), b], [a, np.array([[-7.0]])]])
    m = StateSpaceModel(np.zeros((0, 0)), np.zeros((0, 3)), np.zeros((4, 0)), d)
    found = worst_case(UncertainModel(m, [FullBlock("f", 2, 3)]), "hinf")
    assert found.value == pytest.approx(7.0 + 5.0 * 3.0, rel=1e-6)
    assert np.linalg.norm(found.delta["f"], 2) <= 1 + 1e-12


def test_a_frequency_dependent_complex_delta():
    """1/(s + 1) closed by w = 0.5 d z: |1 / (jw + 1 - 0.5 d)| <= 2, attained at w = 0 and d = 1."""
    m = StateSpaceModel([[-1.0]], [[0.5, 1.0]], [[1.0], [1.0]], np.zeros((2, 2)))
    found = worst_case(UncertainModel(m, [ComplexScalar("d")]), "hinf")
    assert found.value == pytest.approx(2.0, rel=1e-5)


def test_nominal_must_be_stable_but_hidden_integrators_do_not_matter():
    def drive(b):
        return StateSpaceModel(
            [[0.0, 1.0], [0.0, -b]], [[0.0], [1.0]], np.eye(2), np.zeros((2, 1)), outputs=["q", "v"], states=["q", "v"]
        )

    model = elementwise(drive(2.0), drive(3.0))
    assert worst_case(model, "hinf", output="v").value == pytest.approx(1.0, rel=1e-6)
    with pytest.raises(NoTrustworthyNumber, match="not asymptotically stable"):
        worst_case(model, "hinf")


def test_ill_posed_members_are_infinite():
    m = StateSpaceModel(np.zeros((0, 0)), np.zeros((0, 2)), np.zeros((2, 0)), [[1.0, 1.0], [1.0, 0.0]])
    assert worst_case(UncertainModel(m, [RealScalar("k")]), "hinf").value == np.inf


def test_discrete_gain():
    def lag(a):
        return StateSpaceModel([[a]], [[1.0]], [[1.0]], [[0.0]], 0.1)

    found = worst_case(elementwise(lag(0.2), lag(-0.5)), "hinf")  # 1 / (1 - |a|), a in [-0.5, 0.9]
    assert found.value == pytest.approx(10.0, rel=1e-6)
    assert next(iter(found.delta.values())) == -1.0


# --- spectral abscissa -----------------------------------------------------------------------------------------------


def test_spectral_abscissa_in_closed_form():
    """Poles of [[-3, 2 d], [2 d, -3]] are -3 +- 2 d."""
    into, out = np.hstack([2 * np.eye(2), np.ones((2, 1))]), np.vstack([np.eye(2)[::-1], [[1.0, 1.0]]])
    m = StateSpaceModel(-3 * np.eye(2), into, out, np.zeros((3, 3)))
    found = worst_case(UncertainModel(m, [RealScalar("d", 2)]), "spectral-abscissa")
    assert found.value == pytest.approx(-1.0, rel=1e-9)
    assert found.nominal_value == -3.0


def test_spectral_abscissa_of_a_random_family_against_vertices_and_samples():
    rng = np.random.default_rng(5)
    a = rng.standard_normal((6, 6)) - 3 * np.eye(6)
    other = a + 0.3 * rng.standard_normal((6, 6)) * (rng.random((6, 6)) < 0.2)
    rest = (np.ones((6, 1)), np.ones((1, 6)), [[0.0]])
    model = elementwise(StateSpaceModel(a, *rest), StateSpaceModel(other, *rest))
    found = worst_case(model, "spectral-abscissa")
    entries = np.argwhere(other != a)
    best = -np.inf
    for signs in itertools.product([-1, 1], repeat=len(entries)):
        member = a.copy()
        for s, (i, j) in zip(signs, entries, strict=True):
            member[i, j] += s * (other - a)[i, j]
        best = max(best, np.linalg.eigvals(member).real.max())
    assert found.value >= best - 1e-12
    assert found.value == pytest.approx(model.evaluate(found.delta).spectral_abscissa(), rel=1e-12)


# --- the search as such ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("metric", ["peak-deviation", "hinf", "spectral-abscissa"])
def test_no_uncertainty(metric):
    lag = StateSpaceModel([[-2.0]], [[1.0]], [[1.0]], [[0.0]])
    found = worst_case(elementwise(lag, lag), metric)
    assert found.value == found.nominal_value == pytest.approx({"peak-deviation": 0.0, "hinf": 0.5}.get(metric, -2.0))
    assert (found.delta, found.status) == ({}, Status.CONVERGED)


LAG = StateSpaceModel([[-1.0]], [[0.5, 1.0]], [[1.0], [1.0]], np.zeros((2, 2)))
GROWING = StateSpaceModel([[0.1]], [[1.0]], [[1.0]], [[0.0]])


@pytest.mark.parametrize(
    ("call", "error", "text"),
    [
        (lambda: worst_case(motor()), UsageError, "2 outputs and none named"),
        (lambda: worst_case(motor(), "h3"), UsageError, "metric 'h3'"),
        (lambda: worst_case(motor(), "hinf", output="speed"), InputError, "output 'speed'"),
        (lambda: worst_case(motor(), "hinf", n=0), InputError, "n: 0"),
        (lambda: worst_case(UncertainModel(LAG, [ComplexScalar("d")])), InputError, "is complex"),
        (lambda: worst_case(elementwise(GROWING, GROWING)), InputError, "unstable and no times"),
    ],
)
def test_requests_that_make_no_sense(call, error, text):
    with pytest.raises(error, match=text):
        call()
