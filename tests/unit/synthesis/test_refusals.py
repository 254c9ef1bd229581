"""Refusals of synthesis: invalid requests, and problems without a trustworthy answer."""

from functools import cache

import numpy as np
import pytest
from unit.synthesis import test_controller_reduction as reduction
from unit.synthesis import test_controller_structures as structures
from unit.synthesis import test_fixed_structure as fixed
from unit.synthesis import test_loop_shaping as shaping
from unit.synthesis import test_scheduling as lpv
from unit.synthesis import test_synthesis_dk as dk
from unit.synthesis import test_synthesis_hinf as hinf
from unit.synthesis import test_synthesis_mixsyn as mixsyn
from unit.synthesis import test_tracking_problem as tracking
from unit.synthesis.test_discretisation import DELAY, FLIP, LAG, LOW
from unit.synthesis.test_goal_tuning import LAG as SERVO
from unit.synthesis.test_model_reduction import lag as slow
from unit.synthesis.test_model_reduction import stable_model

import robustlab as rl
from robustlab.errors import InputError, NoTrustworthyNumber
from robustlab.statespace import StateSpaceModel
from robustlab.synthesis import (
    PID,
    Damping,
    Decay,
    Decentralised,
    FixedOrder,
    FixedPoles,
    GainGoal,
    MarginGoal,
    MultichannelPID,
    Part,
    StaticGain,
    TrackingGoal,
    VarianceGoal,
    error_weight,
    tracking_problem,
)

NAN = float("nan")
SAMPLED = StateSpaceModel([[0.5]], [[1.0]], [[1.0]], [[0.0]], 0.1)
UNSTABLE = StateSpaceModel([[1.0]], [[1.0]], [[1.0]], [[0.0]])
DEAF = StateSpaceModel([[-1.0]], np.zeros((1, 0)), [[1.0]], np.zeros((1, 0)))


def gain(*rows, dt=0.0):
    return StateSpaceModel([], [], [], rows, dt)


def points(*models, points=(0, 1), **options):
    return rl.LPVModel({"a": list(points)}, list(models), **options)


def static(plants=None, **options):
    return rl.fixed_structure(plants or fixed.lag(1, 1), "static", **({"n_meas": 1, "n_con": 1} | options))


def structure(made, n_y=1, n_u=1):
    return structures.law_of(made, n_y, n_u)


def robust(blocks, **options):
    return rl.dk(dk.oscillator(), n_meas=1, n_con=1, blocks=blocks, **options)


def reduced(*order, **options):
    return rl.reduce_model(stable_model(4, 1), *order, **options)


@cache
def design():
    return rl.hinf(reduction.PLANT, 1, 1, gamma_rel=1.0)


def smaller(**options):
    return rl.reduce_controller(design(), **options)


def sampled(K, **options):
    return rl.sampled_data_norm(LOW, K, **({"n_meas": 1, "n_con": 1} | options))


def digital(K=None, dt=0.1, **options):
    return rl.discretise(K or gain([-1.0]), dt, plant=LOW, **options)


def bare(n_w, n_z):
    """A plant without disturbances or without performance: every norm of its loop is zero."""
    n = np.diag([1.0, -2.0]), np.ones((2, n_w + 1)), np.ones((n_z + 1, 2)), np.zeros((n_z + 1, n_w + 1))
    return StateSpaceModel(*n)


DESIGNS = (
    lambda P: rl.hinf(P, 1, 1),
    lambda P: rl.h2(P, 1, 1),
    lambda P: rl.fixed_structure(P, 1, n_meas=1, n_con=1),
    lambda P: rl.fixed_structure([P, P], 1, n_meas=1, n_con=1),
    lambda P: rl.sampled_data_norm(P, gain([-5.0], dt=0.01)),
)
ABSENT = ((0, 0, "w and no performance"), (0, 1, "w"), (1, 0, "output z"))
REQUESTS = [
    *(
        (lambda make=make, w=w, z=z: make(bare(w, z)), f"no .*{missing}.* in addition to 1 controls and 1 measurements")
        for make in DESIGNS
        for w, z, missing in ABSENT
    ),
    # scheduled models
    (lambda: rl.LPVModel({}, []), "no parameter"),
    (lambda: points(lpv.lag(1.0), points=[1.0]), "at least two"),
    (lambda: points(*[lpv.lag(1.0)] * 2, points=[1.0, 0.5]), "ascending"),
    (lambda: points(*[lpv.lag(1.0)] * 3), "3 models"),
    (lambda: points(lpv.lag(1.0), lpv.oscillator(1.0)), "model 1"),
    (lambda: points(lpv.lag(1.0), lpv.lag(1.0).renamed(["v"])), "inputs"),
    (lambda: points(*[lpv.lag(1.0)] * 2, rates={"b": 1.0}), "one of a"),
    (lambda: points(*[lpv.lag(1.0)] * 2, rates={"a": -1.0}), "rate"),
    (lambda: points(*[rl.discretise(lpv.lag(1.0), 0.1)] * 2), "discrete"),
    (lambda: points(*[lpv.lag(1.0)] * 2, deviation=np.ones((1, 2, 2))), "exact"),
    (lambda: rl.LPVModel([0, 1], [lpv.lag(1.0)] * 2), "parameter -> value"),
    (lambda: rl.lpv_model(lpv.lag, {"a": "x"}), "points of 'a'"),
    (lambda: rl.lpv_model(lpv.springs(), {"m": 1}), "of at least 2"),
    (lambda: rl.lpv_model(lpv.springs(), {"m": [0.1, 3.0]}), "points of 'm'"),
    (lambda: rl.lpv_model(rl.unstructured(lpv.lag(1.0), 0.2)), "real parameters only"),
    (lambda: rl.lpv_model(lpv.lag(1.0)), "a function of the parameters"),
    (lambda: lpv.lags().at(a=5.0), "a = 5"),
    (lambda: lpv.lags().at(b=1.0), "no parameter 'b'"),
    (lambda: lpv.lags().at(), "a is missing"),
    (lambda: rl.hinf(lpv.lags(), 1, 1), "at least one w and z"),
    (lambda: rl.peak_gain(points(*[lpv.lag(1.0).select([])] * 2)), "0 inputs"),
    (lambda: rl.peak_gain(points(*[gain([1.0])] * 2)), "without states"),
    (lambda: rl.peak_gain(lpv.lags(), lyapunov="quadratic"), "'constant' or 'varying'"),
    # fixed structures and goals
    (lambda: static(objective="h1"), "objective: 'h1'"),
    (lambda: static(starts=-1), "starts: -1"),
    (lambda: static(time_limit=NAN), "time_limit is nan"),
    (lambda: static(limits=["fast"]), "limits: 'fast'"),
    (lambda: static(bounds={"K": (0, 1)}), "parameter: 'K'"),
    (lambda: static(bounds={fixed.GAIN: (1, 0)}), r"bounds of K\[u2,y3\]: \(1, 0\)"),
    (lambda: static(bounds={fixed.GAIN: 3}), r"expected \(low, high\)"),
    (lambda: static(start={"K": 1.0}), "parameter: 'K'"),
    (lambda: static(start=[3.0]), "start: float"),
    (lambda: static(n_meas=5), "n_meas"),
    (
        lambda: static([fixed.lag(1, 1), fixed.double_integrator(0.1)]),
        "plant 2: 1 measurements, 1 controls, dt = 0.1 s",
    ),
    (lambda: rl.fixed_structure([], "static", n_meas=1, n_con=1), "empty list"),
    (lambda: static(fixed.noisy_lag(1, 1), objective="h2"), "H2 norm is infinite"),
    (lambda: rl.tune(SERVO, "p", []), "at least one goal"),
    (lambda: rl.tune(SERVO, "p", [Damping(0.5)]), "at least one goal in addition to limits"),
    (lambda: rl.tune(SERVO, "p", ["tracking"]), "'tracking'"),
    (lambda: rl.tune(SERVO, "p", [TrackingGoal(0.0)]), "response_time"),
    (lambda: rl.tune(SERVO, "p", [MarginGoal(1.0, "middle")]), "middle"),
    (lambda: rl.tune(SERVO, "p", [GainGoal(1.0, "reference", "outputs")]), "'outputs'"),
    (lambda: rl.tune(SERVO, "p", [VarianceGoal(1.0, "noise", "control")], starts=0), "H2 norm is infinite"),
    (lambda: rl.tune([SERVO, SERVO.renamed(["v"], ["y"])], "p", [TrackingGoal(1.0)]), "other signals"),
    (lambda: structure(StaticGain([[1, 1]])), r"mask: shape \(1, 2\), expected \(1, 1\)"),
    (lambda: structure(StaticGain([[0]])), "at least one of them 1"),
    (lambda: structure(FixedOrder(-1)), "order: -1"),
    (lambda: structure(FixedOrder(0, strictly_proper=True)), "strictly proper controller without states"),
    (lambda: structure(PID()), "tau: missing"),
    (lambda: structure(PID(tau=-1.0)), "tau: -1.0"),
    (lambda: structure(PID("PX")), "terms: 'PX'"),
    (lambda: structure(PID("PI"), 2), "1 controls for 2 measurements"),
    (lambda: structure(MultichannelPID("ipd"), 5, 2), "5 measurements for 2 controls"),
    (lambda: structure(MultichannelPID("three-layer"), 5, 2), "'three-layer'"),
    (lambda: structure(FixedPoles([1 + 1j])), "without its conjugate"),
    (lambda: structure(FixedPoles([])), "at least one finite pole"),
    (lambda: structure(Decentralised([StaticGain()]), 2, 2), "1 parts for 2 measurements"),
    (lambda: structure(Decentralised([Part(StaticGain(), ["z1"], ["u1"])])), "'z1': no such signal"),
    # robust performance
    (lambda: robust([]), "use hinf"),
    (lambda: robust(None), "no uncertainty"),
    (lambda: robust([rl.FullBlock("a", 3, 1)]), "blocks of 3 inputs w and 1 outputs z"),
    (lambda: robust([rl.ComplexScalar("performance")]), "another name"),
    (lambda: robust([rl.RealScalar("k", 1, rl.ParameterRange(1.0, 0.5, below=0.25))]), "centred"),
    (lambda: robust([[1, 0]], max_order=1), "max_order"),
    (lambda: robust([[1, 0]], order_rel=1.5), "order_rel"),
    (lambda: robust([[1, 0]], time_limit=0), "time_limit"),
    (lambda: robust([[1, 0]], K0=gain([1.0, 2.0])), "K0"),
    (lambda: robust([[1, 0]], K0=gain([5.0])), "not stable"),
    # H-infinity, H2, mixed sensitivity, loop shaping
    (lambda: rl.hinf(hinf.output_feedback_problem(1.0)), "missing"),
    (lambda: rl.hinf(hinf.output_feedback_problem(1.0), 1, 1, gamma_rel=0.9), "gamma_rel"),
    (lambda: rl.hinf(hinf.output_feedback_problem(1.0), 1, 1, time_limit=0), "time_limit"),
    (lambda: rl.h2(hinf.regular_plant(), 9, 1), "n_meas"),
    (lambda: rl.h2(hinf.regular_plant(), 2, 2, gamma_rel=0.9), "gamma_rel"),
    (lambda: rl.h2(hinf.regular_plant(), 2, 2, time_limit=0.0), "time_limit"),
    (lambda: rl.mixsyn(mixsyn.plant_2x2()), "no weight"),
    (lambda: rl.mixsyn(mixsyn.plant_2x2(), StateSpaceModel([[0.0]], [[1.0]], [[1.0]], [[0.0]])), "W1.*abscissa"),
    (lambda: rl.mixsyn(mixsyn.plant_2x2(), 1.0, np.eye(2)), "W2: 2 inputs"),
    (lambda: rl.mixsyn(mixsyn.plant_2x2(), SAMPLED), "W1: dt"),
    (lambda: rl.mixsyn(SAMPLED, slow(1.0, 1.0), 1.0), "W1: dt is 0 s, expected 0.1 s"),
    (lambda: rl.mixsyn(DEAF, 1.0), "mixsyn: G"),
    (lambda: rl.ncf(shaping.DISTURBED, factor=1.0), "factor"),
    (lambda: rl.ncf(shaping.DISTURBED, np.eye(2)), "W1: 2 outputs"),
    (lambda: rl.ncf(shaping.DISTURBED, None, SAMPLED), "W2: dt"),
    (lambda: rl.ncf(shaping.DISTURBED, [shaping.PI]), "no matrix"),
    (lambda: rl.ncf(DEAF), "synth ncf: G"),
    (lambda: rl.generalized_plant(hinf.uncertain_model(), ["vv"], ["u"]), "did you mean"),
    (lambda: rl.generalized_plant(hinf.uncertain_model(), ["v"], ["u"], disturbances=["u"]), "both"),
    (lambda: rl.generalized_plant(hinf.uncertain_model(), [], ["u"]), "n_meas"),
    (lambda: rl.generalized_plant(hinf.uncertain_model(), ["v"], ["u"]).close(SAMPLED), "sample time"),
    (lambda: rl.hinf(rl.generalized_plant(hinf.uncertain_model(), ["v"], ["u"]), 2, 1), "leave them out"),
    (lambda: rl.loop_functions(UNSTABLE, gain([1.0, 2.0])), "K is 1 x 2"),
    (lambda: rl.loop_functions(UNSTABLE, UNSTABLE, sign=0), "sign"),
    (lambda: rl.loop_functions(UNSTABLE, UNSTABLE).gain("L", [1.0]), "'L'"),
    (lambda: rl.loop_functions(gain([1.0]), gain([-1.0])), "not well posed"),
    # weights and tracking
    (lambda: rl.performance_weight(-1.0), "bandwidth"),
    (lambda: rl.performance_weight(1.0, error=0.0), "error"),
    (lambda: rl.performance_weight(1.0, peak=0.9), "peak"),
    (lambda: rl.performance_weight(1.0, order=0), "order"),
    (lambda: rl.control_weight(NAN), "limit"),
    (lambda: rl.control_weight(1.0, 10.0, 0.5), "roll_off"),
    (lambda: rl.complementary_weight(1.0, roll_off=2.0), "roll_off"),
    (lambda: rl.makeweight(1.0, (1.0, 2.0), 0.1), "between"),
    (lambda: rl.makeweight(1.0, (2.0, 0.5, 0.2), 0.1), "through"),
    (lambda: rl.makeweight(-1.0, (1.0, 0.5), 0.1), "low_gain"),
    (lambda: rl.makeweight(1.0, (1.0, 0.5), 0.1, order=0), "order"),
    (lambda: rl.makeweight(2.0, 4.0, 0.1, 1.0), "below pi / dt"),
    (lambda: rl.makeweight(2.0, 1.0, 1.5), "between"),
    (lambda: error_weight(0.01, 1.0, 0.02), "error"),
    (lambda: error_weight(0.01, float("inf")), "inf"),
    (lambda: tracking.problem_of(W1=None, W2=None, W3=None), "no weight"),
    (lambda: tracking.problem_of(W1=UNSTABLE), "a stable weight"),
    (lambda: tracking.problem_of(W2=StateSpaceModel([[-1.0]], [[1, 0]], [[1.0]], [[0, 0]])), "one of each"),
    (lambda: tracking.problem_of(W1=SAMPLED), "dt is 0.1 s"),
    (lambda: tracking.problem_of(reference={"q": 1.0}), "none for v"),
    (lambda: tracking.problem_of(reference=-1.0), "a positive number"),
    (lambda: tracking.problem_of(disturbance={"g": 1.0}), "one of f, u"),
    (lambda: tracking.problem_of(noise={"q": 1.0}), "one of q_ref, v_ref, v, x"),
    (lambda: tracking.problem_of(reference_bandwidth=0.0), "a positive number in rad/s"),
    (lambda: tracking_problem(tracking.plant(), [], ["q"], W1=1.0), "no output"),
    (lambda: tracking_problem(tracking.plant(), ["q"], ["qq"], W1=1.0), "did you mean q"),
    (lambda: tracking_problem(tracking.plant(), ["q", "q"], ["q"], W1=1.0), "named twice"),
    # reduction
    (reduced, "expected one of the two"),
    (lambda: reduced(order=1, tolerance=0.1), "expected one of the two"),
    (lambda: reduced(5), "whole number from 0 to 4"),
    (lambda: reduced(True), "whole number"),
    (lambda: reduced(tolerance=NAN), "a positive number"),
    (lambda: reduced(1, method="modal"), "one of truncation"),
    (lambda: reduced(1, input_weight=UNSTABLE), "not stable"),
    (lambda: reduced(1, output_weight=gain([1, 1])), "2 inputs, expected 3"),
    (lambda: reduced(1, method="coprime", input_weight=gain([1.0])), "weights"),
    (lambda: reduced(2, method="hankel", input_weight=gain([1.0])), "weights with method 'hankel'"),
    (lambda: reduced(2, floor=1.0), "floor with method 'truncation'"),
    (lambda: reduced(2, floor=-1.0, method="stochastic"), "not negative"),
    (lambda: rl.reduce_model(slow(1.0, 1.0), 0, method="stochastic"), r"no full row rank.*\n?.*floor="),
    (lambda: smaller(loss=-0.1), "loss: -0.1"),
    (lambda: smaller(loss=NAN), "loss: nan"),
    (lambda: smaller(order=99), "whole number from 0"),
    (lambda: smaller(measure="l1"), "'hinf', 'h2' or 'mu'"),
    (lambda: smaller(measure="hinf", blocks=(rl.ComplexScalar("d"),)), "measure='mu'"),
    (lambda: smaller(measure="mu"), "blocks of 0 inputs"),
    (lambda: smaller(time_limit=0.0), "time_limit is 0"),
    (lambda: smaller(K=gain([1.0], [1.0])), "K is 2 x 1, expected 1 x 1"),
    # sampling
    (lambda: rl.discretise(LAG, 0.0), "positive sample time"),
    (lambda: rl.discretise(LAG, True), "positive sample time"),
    (lambda: rl.discretise(SAMPLED, 0.1), "the model has dt = 0.1 s"),
    (lambda: rl.discretise(LAG, 0.1, "tustn"), "did you mean tustin"),
    (lambda: rl.discretise(LAG, 0.1, "tustin-prewarp"), "prewarp with 'tustin-prewarp' alone"),
    (lambda: rl.discretise(LAG, 0.1, "zoh", prewarp=1.0), "prewarp with 'tustin-prewarp' alone"),
    (lambda: rl.discretise(LAG, 0.1, "tustin-prewarp", prewarp=32.0), "Nyquist"),
    (lambda: sampled(gain([1.0])), "sample time: 0"),
    (lambda: sampled(gain([1.0], dt=0.1), delay=-0.1), "delay is -0.1"),
    (lambda: sampled(gain([1.0], dt=0.1), delay=float("inf")), "delay is inf"),
    (lambda: sampled(gain([1.0], dt=0.1), rtol=0.0), "rtol is 0"),
    (lambda: sampled(gain([1.0], dt=0.1), antialiasing=-1.0), "antialiasing is -1"),
    (lambda: sampled(gain([1.0], dt=0.1), n_meas=2), "K is 1 x 1, expected 1 x 2"),
    (lambda: digital(dt=0.0), "sample time: 0"),
    (lambda: digital(gain([-1.0], dt=0.1)), "dt = 0.1 s already"),
    (lambda: digital(gain([1.0] * 4)), "n_meas is 4"),
    (lambda: digital(delay=-1.0), "delay is -1"),
    (lambda: digital(loss=-1.0), "loss: -1"),
    (lambda: rl.d2c(LAG), "d2c: the model is continuous"),
    (lambda: rl.d2c(DELAY, "zho"), "(?s)method: 'zho', expected one of zoh, tustin.*mean zoh"),
]


@pytest.mark.parametrize(("call", "text"), REQUESTS)
def test_a_request_that_makes_no_sense_is_refused_in_one_line(call, text):
    with pytest.raises(InputError, match=text) as caught:
        call()
    assert "\n" not in caught.value.line


def test_what_a_function_of_the_user_raises_is_not_swallowed():
    def progress(*_):
        raise TypeError("mine")

    with pytest.raises(TypeError, match="mine"):
        rl.fixed_structure(fixed.lag(1, 1), "static", n_meas=1, n_con=1, starts=1, progress=progress)


def hidden(pole, B2, C2):
    """A mode that the control, or the measurement, does not see."""
    B, C = np.hstack([np.ones((2, 1)), B2]), np.vstack([np.ones((1, 2)), C2])
    return StateSpaceModel(np.diag([pole, -1.0]), B, C, np.zeros((2, 2)), states=["runaway", "calm"])


MOVED = r"runaway.*cannot be moved by the controls"
SHOWN = r"runaway.*does not show in the measurements"
TANK = StateSpaceModel(
    [[0.5, 0], [0, -1]], [[1, 1, 0], [1, 1, 1]], [[1, 1], [1, 0], [1, 1]], np.zeros((3, 3)), states=["tank", "lag"]
)
DOUBLE = StateSpaceModel([[0, 1], [0, 0]], [[0], [1]], [[1, 0]], [[0]])
WASHOUT = StateSpaceModel([[-1.0]], [[1.0]], [[-1.0]], [[1.0]])  # s / (s + 1)
BOTH = np.array([[1.0], [1.0]])
NO_ANSWER = [
    (lambda: rl.hinf(hidden(0.7, [[0.0], [1.0]], BOTH.T), 1, 1), r"s = 0\.7 .*" + MOVED),
    (lambda: rl.hinf(hidden(0.0, [[0.0], [1.0]], BOTH.T), 1, 1), "s = 0 .*" + MOVED),
    (lambda: rl.hinf(hidden(0.7, BOTH, [[0.0, 1.0]]), 1, 1), r"s = 0\.7 .*" + SHOWN),
    (lambda: rl.hinf(hidden(0.0, BOTH, [[0.0, 1.0]]), 1, 1), "s = 0 .*" + SHOWN),
    (lambda: rl.h2(hidden(0.7, [[0.0], [1.0]], BOTH.T), 1, 1), MOVED),
    (lambda: rl.dk(TANK, [[1, 0]], 1, 1), r"unstable mode s = 0\.5 .*tank.* cannot be moved"),
    (lambda: rl.h2(hinf.regular_plant(D11=True), 2, 2), "infinite for every controller"),  # D12 is 3 x 2
    (lambda: rl.ncf(WASHOUT, shaping.PI), "W2 G W1"),  # the plant differentiates what the weight integrates
    (lambda: static([fixed.lag(1, 1), fixed.lag(1, -1)], starts=2),
     r"(?s)no start stabilised plant [12]: nearest pole s = .*no proof that there is none"),
    (lambda: static(fixed.double_integrator(), starts=1), "no start stabilised the plant"),
    (lambda: static([fixed.lag(1, 1), fixed.lag(1, 0)]), "plant 2: no stabilising .* unstable mode s = 1 "),
    (lambda: static(fixed.lag(-1, 1), limits=[Decay(5.0)], bounds={fixed.GAIN: (-1, 1)}, starts=1), "rate >= 5 1/s"),
    (lambda: rl.tune(DOUBLE, "p", [TrackingGoal(1.0)], starts=0), "no start stabilised"),
    (lambda: rl.reduce_model(WASHOUT, 0, method="stochastic"), "the gain vanishes at some frequency"),
    (lambda: rl.discretise(slow(-20.0, 1.0), 0.1, "tustin"), "2/dt"),
    (lambda: rl.discretise(slow(-1e6, 1.0), 0.1, "zoh"), "overflows"),
    (lambda: rl.d2c(FLIP), r"d2c \(zoh\): a pole at z = -0\.5: no continuous model"),
    (lambda: rl.d2c(DELAY), r"d2c \(zoh\): a pole at z = 0: no continuous model"),
    (lambda: rl.d2c(StateSpaceModel([[-1.0]], [[1.0]], [[1.0]], [[0.0]], 0.1), "tustin"), "a pole at z = -1"),
    (lambda: rl.d2c(StateSpaceModel(1e-4 * np.eye(3) + np.eye(3, k=1), BOTH[[0, 0, 0]], [[1.0] * 3], [[0.0]], 0.1)),
     "gives A back to"),
]  # fmt: skip


@pytest.mark.parametrize(("call", "text"), NO_ANSWER)
def test_a_problem_without_a_trustworthy_answer_says_why(call, text):
    with pytest.raises(NoTrustworthyNumber, match=text) as caught:
        call()
    assert caught.value.exit_code == 4
