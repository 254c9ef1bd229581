"""The sign of feedback and the order of signals travel with the controller, into files and into every loop."""

import pickle

import numpy as np
import pytest

import robustlab as rl
from robustlab.errors import InputError, UnitMismatch
from robustlab.feedback import closing, feedback_loop, wired
from robustlab.signals import law
from robustlab.storage import c_source
from robustlab.synthesis import tracking_loop, with_law

PLANT = rl.StateSpaceModel(
    [[0.0, 1.0], [-1.0, -0.2]], [[0.0], [1.0]], [[1.0, 0.0]], [[0.0]], inputs=[("u", "V")], outputs=[("q", "m")]
)
TWO = rl.StateSpaceModel(
    [[0.0, 1.0], [-1.0, -0.2]], [[0.0], [1.0]], np.eye(2), [[0.0], [0.0]], inputs=["u"],
    outputs=[("q", "m"), ("v", "m/s")],
)  # fmt: skip
OSCILLATORS = rl.parametric([[0, 1], ["-k", "-c"]], [[0], [1]], [[1, 0]], [[0]], {"k": (1, 0.2), "c": (0.2, 0.3)})


def poles(model):
    return np.sort_complex(model.poles())


def pd(takes, names=("q", "v"), gains=(3.0, 1.0)):
    """u = 3 q + v times the sign of what is taken."""
    K = rl.StateSpaceModel([], [], [], [list(gains)], inputs=list(names), outputs=["u"])
    return rl.Controller(K, takes=takes)


# --- every design states its input -----------------------------------------------------------------------------------


def designs():
    W1, W2 = rl.performance_weight(bandwidth=2.0, error=0.05), rl.control_weight(5.0)
    P = rl.mixsyn(PLANT, W1, W2).plant
    noisy = rl.StateSpaceModel(
        PLANT.A, np.hstack([PLANT.B, [[0], [0]], PLANT.B]), np.vstack([PLANT.C, [[0, 0]], PLANT.C]),
        [[0, 0, 0], [0, 0, 1], [0, 1, 0]], inputs=["d", "n", "u"], outputs=["q", "cost", "y"],
    )  # fmt: skip
    yield "mixsyn", lambda: rl.mixsyn(PLANT, W1, W2), "u = K (r - y)"
    yield "tune", lambda: rl.tune(PLANT, "pid", [rl_goal()], starts=1), "u = K (r - y)"
    yield "hinf of an error", lambda: rl.hinf(P), "u = K (r - y)"
    yield "hinf", lambda: rl.hinf(noisy, 1, 1), "u = K y"
    yield "h2", lambda: rl.h2(noisy, 1, 1), "u = K y"
    yield "ncf", lambda: rl.ncf(PLANT, 4.0), "u = K y"
    yield "fixed", lambda: rl.fixed_structure(noisy, "static", n_meas=1, n_con=1, starts=1), "u = K y"
    yield "dk", lambda: rl.dk(noisy, [[1, 0], [1, 0]], 1, 1, effort=0.2), "u = K y"
    yield "reduced", lambda: rl.reduce_controller(rl.mixsyn(PLANT, W1, W2), loss=0.5), "u = K (r - y)"
    yield "sampled", lambda: rl.discretise(rl.mixsyn(PLANT, W1, W2), 0.01), "u = K (r - y)"


def rl_goal():
    from robustlab.synthesis import TrackingGoal

    return TrackingGoal(2.0)


def lag(time):
    return rl.StateSpaceModel([[-1 / time]], [[1.0]], [[1 / time]], [[0.0]])


@pytest.mark.parametrize(("make", "expected"), [pytest.param(m, e, id=n) for n, m, e in designs()])
def test_a_design_declares_the_inputs_of_its_controller_and_files_keep_them(make, expected, tmp_path):
    found = make()
    held = found if isinstance(found, rl.Controller) else found.controller
    assert held.law == expected
    for suffix in (".h5", ".mat"):
        rl.export_controller(tmp_path / f"k{suffix}", held)
        again = rl.load(tmp_path / f"k{suffix}")
        model = getattr(again, "K", again)
        assert law(model.inputs) == expected
        assert [s.of for s in model.inputs] == [s.of for s in held.K.inputs]
    assert pickle.loads(pickle.dumps(held)).law == expected
    if held.K.is_discrete:
        assert f"LOOP: {expected}" in c_source(held.K)


# --- loops that are closed --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("takes", "sign"), [("y", 1), ("-y", -1), ("r - y", -1), ("y - r", 1)])
def test_what_is_taken_closes_the_loop(takes, sign):
    expected = poles(rl.StateSpaceModel(TWO.A + sign * TWO.B @ [[3.0, 1.0]], TWO.B, TWO.C, TWO.D))
    loop = rl.UncertainModel(TWO, []).feedback(pd(takes))
    np.testing.assert_allclose(poles(loop.nominal), expected, atol=1e-12)


def test_signals_meet_by_name_whatever_their_order():
    expected = poles(rl.UncertainModel(TWO, []).feedback(pd("r - y")).nominal)
    swapped = pd("r - y", names=("v", "q"), gains=(1.0, 3.0))
    np.testing.assert_allclose(poles(rl.UncertainModel(TWO, []).feedback(swapped).nominal), expected, atol=1e-12)
    plain = rl.StateSpaceModel([], [], [], [[1.0, 3.0]], inputs=["v", "q"], outputs=["u"])
    np.testing.assert_allclose(poles(rl.UncertainModel(TWO, []).feedback(plain).nominal), expected, atol=1e-12)
    same = rl.disk_margin(TWO, pd("r - y"), at="input").simultaneous.lower
    assert rl.disk_margin(TWO, swapped, at="input").simultaneous.lower == pytest.approx(same, rel=1e-9)
    assert rl.disk_margin(TWO, plain, at="input").simultaneous.lower == pytest.approx(same, rel=1e-9)


def test_a_controller_of_one_signal_takes_it_from_a_plant_of_several():
    one = pd("r - y", names=("v",), gains=(1.0,))
    expected = poles(rl.StateSpaceModel(TWO.A - TWO.B @ [[0.0, 1.0]], TWO.B, TWO.C, TWO.D))
    np.testing.assert_allclose(poles(rl.UncertainModel(TWO, []).feedback(one).nominal), expected, atol=1e-12)
    assert list(rl.disk_margin(TWO, one).channels) == ["v"]


def test_signs_may_differ_from_input_to_input():
    mixed = pd(["r - y", "y"], gains=(3.0, -1.0))
    expected = poles(rl.StateSpaceModel(TWO.A - TWO.B @ [[3.0, 1.0]], TWO.B, TWO.C, TWO.D))
    np.testing.assert_allclose(poles(rl.UncertainModel(TWO, []).feedback(mixed).nominal), expected, atol=1e-12)
    assert rl.disk_margin(TWO, mixed, at="input").loop == "u = K [r - q; v], as the controller says"
    with pytest.raises(InputError, match="one sign for all inputs"):
        rl.disk_margin(TWO, mixed, sign=-1)


def test_products_keep_the_declared_inputs():
    K = rl.ncf(PLANT, 4.0).K
    expected = rl.disk_margin(PLANT, K).simultaneous.lower
    for L in (PLANT @ K, K @ PLANT, 2 * (PLANT @ K) * 0.5, rl.UncertainModel(PLANT, []).nominal @ K):
        assert rl.disk_margin(L).simultaneous.lower == pytest.approx(expected, rel=1e-6)
    assert rl.disk_margin(-(PLANT @ K)).simultaneous.lower == pytest.approx(expected, rel=1e-6)  # -K takes -y
    with pytest.raises(InputError, match=r"sign: -1 .* expected 1: u = K y"):
        rl.disk_margin(PLANT @ K, sign=-1)
    sets = OSCILLATORS @ rl.ncf(OSCILLATORS.nominal, 4.0).K
    assert law(sets.inputs) == "u = K y"


def test_digital_and_smaller_controllers_take_the_same():
    K = rl.ncf(PLANT, 4.0).K
    digital = rl.discretise(K, 0.01)
    for other in (digital, rl.d2c(digital), rl.reduce_model(K, 1).model):
        assert law(other.inputs) == "u = K y"


# --- every function uses and reports the same sign --------------------------------------------------------------------

NCF = rl.ncf(OSCILLATORS.nominal, 4.0)  # u = K y: with negative feedback, the default of old, the loop is another
SIGNED = {
    "disk_margin": lambda **s: rl.disk_margin(OSCILLATORS.nominal, NCF.K, **s).simultaneous.lower,
    "classical_margins": lambda **s: rl.classical_margins(OSCILLATORS.nominal, NCF.K, **s).channels["y1"],
    "coprime_margin": lambda **s: rl.coprime_margin(OSCILLATORS.nominal, NCF.K, **s).lower,
    "disk_margin at": lambda **s: rl.disk_margin(OSCILLATORS.nominal, NCF.K, frequency=[0.5, 2.0], **s).lower,
    "disk_margin with a delay": lambda **s: rl.disk_margin(
        OSCILLATORS.nominal @ rl.delay(0.01), NCF.K, **s).simultaneous.lower,
    "classical_margins with a delay": lambda **s: next(iter(rl.classical_margins(
        OSCILLATORS.nominal @ rl.delay(0.01), NCF.K, **s).channels.values())),
    "loop_functions": lambda **s: rl.loop_functions(OSCILLATORS.nominal, NCF.K, **s).S.dc_gain(),
    "feedback": lambda **s: rl.robust_stability(OSCILLATORS.feedback(NCF.K, **s)).lower,
}  # fmt: skip


@pytest.mark.parametrize("name", SIGNED)
def test_by_default_the_sign_is_that_of_the_controller_and_a_contradiction_is_rejected(name):
    left_out, stated = SIGNED[name](), SIGNED[name](sign=1)
    if hasattr(left_out, "to_json"):
        left_out, stated = left_out.to_json()["gain_margin"], stated.to_json()["gain_margin"]
    np.testing.assert_allclose(left_out, stated, rtol=1e-9)
    with pytest.raises(InputError, match=r"sign: -1 \(u = -K y\), expected 1: u = K y"):
        SIGNED[name](sign=-1)


def test_a_result_reports_its_loop():
    assert ("loop", "u = K y, as the controller says") in rl.disk_margin(OSCILLATORS.nominal, NCF.K).facts()
    gain = rl.StateSpaceModel([], [], [], [[0.5]])
    assert rl.disk_margin(OSCILLATORS.nominal, gain).loop == "u = -K y, negative feedback by default"
    assert rl.disk_margin(OSCILLATORS.nominal, gain, sign=1).loop == "u = K y, as requested"


def test_an_lft_takes_the_sign_too():
    """Around y a controller of r - y is closed with the minus that it needs, around r - y as it is."""
    W1 = rl.performance_weight(bandwidth=2.0, error=0.05)
    design = rl.mixsyn(PLANT, W1, 0.2)
    around_y = rl.generalized_plant(PLANT, ["q"], ["u"], disturbances=[])
    expected = poles(rl.UncertainModel(PLANT, []).feedback(design.K, -1).nominal)
    np.testing.assert_allclose(poles(around_y.close(design.K)), expected, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(poles(rl.UncertainModel(PLANT, []).close(design.K).nominal), expected, rtol=1e-9)
    assert design.plant.close(design.K).is_stable()
    small = rl.reduce_controller(PLANT, design.K, loss=0.5)  # noise on y, a disturbance on u: the plant offers y
    assert small.closed_loop.is_stable()
    assert law(small.K.inputs) == "u = K (y - r)"


def test_references_follow_whatever_is_taken():
    """The steady state of the tracking loop is its own truth: y follows r with K of either convention."""
    W1 = rl.performance_weight(bandwidth=2.0, error=1e-4)
    follows = rl.mixsyn(PLANT, W1, 0.02).K
    turned = rl.Controller(rl.StateSpaceModel(follows.A, follows.B, -follows.C, -follows.D, inputs=["q"]), takes="y").K
    for K in (follows, turned, -follows):
        T = tracking_loop(PLANT, K).nominal
        assert T.is_stable()
        assert T.dc_gain()[0, 0] == pytest.approx(1.0, abs=1e-3)


def test_a_tracking_loop_follows_by_the_sign_that_was_found():
    """The steady state of y is K G / (1 + K G) of the reference: 2 at one, 2 (-1) / (1 - 2)."""
    G = rl.StateSpaceModel([[1.0]], [[1.0]], [[1.0]], [[0.0]], inputs=["u"], outputs=["y"])
    for gain in (2.0, -2.0):
        K, _ = with_law(G, rl.StateSpaceModel([], [], [], [[gain]], inputs=["other"], outputs=["u"]))
        assert tracking_loop(G, K).nominal.dc_gain()[0, 0] == pytest.approx(2.0)


# --- messages about wrong signals -------------------------------------------------------------------------------------


def test_other_signals_are_refused():
    with pytest.raises(InputError, match="no 'w', which K has"):
        rl.disk_margin(TWO, pd("y", names=("q", "w")), at="input")
    with pytest.raises(UnitMismatch):
        rl.disk_margin(PLANT, rl.StateSpaceModel([], [], [], [[1.0]], inputs=[("q", "mm")], outputs=["u"]))
    offers_e = rl.generalized_plant(PLANT.renamed(outputs=["e"]), ["e"], ["u"], disturbances=[])
    with pytest.raises(InputError, match="K has q, expected e"):
        offers_e.close(NAMED)
    with pytest.raises(InputError, match="one, or 2"):
        pd(["y", "y", "y"])
    with pytest.raises(InputError, match="takes 'e'"):
        pd("e")


NAMED = rl.Controller(rl.StateSpaceModel([], [], [], [[-3.0]], inputs=["q"], outputs=["u"]), takes="y").K


def test_an_unknown_plant_is_closed_by_the_sign_that_is_stable_or_not_at_all():
    other = PLANT.renamed(outputs=["position"])
    assert "only this sign leaves the loop stable" in rl.disk_margin(other, NAMED).loop
    weak = rl.Controller(rl.StateSpaceModel([], [], [], [[0.3]], inputs=["q"], outputs=["u"]), takes="y").K
    with pytest.raises(InputError, match="it takes q, this plant has position, and both signs leave the loop stable"):
        rl.disk_margin(other, weak)
    assert rl.disk_margin(other, weak, sign=-1).loop == "u = -K y, as requested"


def test_an_operation_without_an_assumed_sign_requires_one():
    weak = rl.StateSpaceModel([], [], [], [[0.3]])
    with pytest.raises(InputError, match="does not say its sign, and both signs leave the loop stable"):
        closing(PLANT, weak, None, "mu", None)
    strong = rl.StateSpaceModel([], [], [], [[3.0]])
    assert closing(PLANT, strong, None, "mu", None).sign == -1
    with pytest.raises(InputError, match="does not say its sign"):
        closing(rl.frequency_data(PLANT, [1.0]), strong, None, "mu", None)


def test_edges_static_and_empty():
    assert closing(rl.StateSpaceModel([], [], [], [[2.0]]), None).sign == -1
    with pytest.raises(InputError, match="expected 1 x 2"):
        feedback_loop(TWO, rl.StateSpaceModel([], [], [], np.eye(2)))
    K = rl.StateSpaceModel([], [], [], [[1.0]], inputs=["a"], outputs=["b"])
    assert wired(K, [rl.Signal("y")], [rl.Signal("u")], "close") is K
