"""Refusals of the analysis of sets and loops: invalid requests, and problems without an answer."""

import numpy as np
import pytest
from unit.mu_analysis.test_cover import LAGS
from unit.mu_analysis.test_cover import lag as late
from unit.mu_analysis.test_frequency_data import MOTORS
from unit.mu_analysis.test_mu_margin import model_with_a_gap, oscillator
from unit.mu_analysis.test_mu_matrix import gain_problem

import robustlab as rl
from robustlab import disk_margin
from robustlab.mu_analysis import replay

EYE = rl.StateSpaceModel([], [], [], np.eye(2))
LAG = rl.StateSpaceModel([[-1.0]], [[1.0]], [[1.0]], [[0.0]])
UNSTABLE = rl.StateSpaceModel([[1.0]], [[1.0]], [[0.5]], [[0.0]])
TALL = rl.StateSpaceModel([[-1.0]], [[1.0]], [[1.0], [1.0]], np.zeros((2, 1)))
SAMPLED = rl.StateSpaceModel([[0.1]], [[1.0]], [[1.0]], [[0.0]], 0.1)
WIDE = [rl.StateSpaceModel([], [], [], [[1.0, k]]) for k in (1.0, 2.0)]
NOTHING = rl.UncertainModel(LAG, [])
ASYMMETRIC = rl.RealScalar("tau", 1, rl.ParameterRange(1.0, 0.5, below=0.25))
PERFORMANCE = rl.StateSpaceModel([[-0.5]], [[0.1, 1.0]], [[1.0], [1.0]], np.zeros((2, 2)))


def cover(models, form="elements", **options):
    return rl.cover(models, form, gain=False, **options)


def skew(fixed, tolerance=None):
    return rl.mu(*gain_problem(0, rl.RealScalar), fixed=fixed, tolerance=tolerance)


REQUESTS = [
    (lambda: rl.mu([[np.nan, 0], [0, 1]], [[1, 0]] * 2), r"entry \[0,0\] is not finite"),
    (lambda: rl.mu([[1, 0], [0, np.inf]], [[1, 0]] * 2), r"entry \[1,1\] is not finite"),
    (lambda: rl.mu(np.eye(3), [[1, 0]] * 2), r"expected \(2, 2\)"),
    (lambda: rl.mu(np.ones((2, 3)), [[2, 3]]), "transposed"),
    (lambda: rl.mu(np.ones(3), [[1, 0]] * 3), "shape"),
    (lambda: rl.mu([["a"]], [[1, 0]]), "numbers"),
    (lambda: rl.mu([[1, 2], [3]], [[1, 0]] * 2), "ragged"),
    (lambda: rl.mu([[2.0]], [ASYMMETRIC]), r"(?s)block 'tau'.*range 0.75 .. 1.5 around 1.*robust_stability"),
    (lambda: rl.mu([[1.0]], [[-1, 0]], tolerance=0.0), "tolerance"),
    (lambda: rl.mu([[1.0]], [[-1, 0]], tolerance=0.1, time_limit=-1.0), "time_limit"),
    (lambda: rl.robust_stability(model_with_a_gap(), tolerance=-1.0), "tolerance"),
    (lambda: rl.robust_stability(model_with_a_gap(), tolerance=0.1, time_limit=-1.0), "time_limit"),
    (lambda: rl.robust_performance(rl.UncertainModel(PERFORMANCE, [rl.RealScalar("performance")])), "another name"),
    (lambda: skew(["d9"]), "no block 'd9'"),
    (lambda: skew([9]), "no block 9"),
    (lambda: skew(["d0", "d1", "d2", "p"]), "all blocks are fixed"),
    (lambda: skew([0], 0.1), "given with fixed blocks"),
    (lambda: replay(NOTHING, rl.robust_stability(NOTHING)), "without a critical Delta"),
    (lambda: replay(NOTHING, rl.robust_stability(oscillator(rl.RealScalar))), "this very model"),
    # loops
    (lambda: disk_margin(TALL), "a square one, or a K"),
    (lambda: disk_margin(rl.with_delays(TALL)), "a square one"),
    (lambda: disk_margin(rl.DelayedModel(rl.StateSpaceModel([], [], [], np.zeros((0, 0))), [])), "0 x 0"),
    (lambda: disk_margin(LAG, EYE), "1 x 1"),
    (lambda: disk_margin(LAG, at="everywhere"), "input, output or both"),
    (lambda: rl.classical_margins(LAG, at="z"), "input, output or both"),
    (lambda: rl.frequency_response(LAG, [np.nan]), "omega is not finite"),
    (lambda: rl.peak_gain(LAG, tolerance=-1.0), "rtol: -1.0"),
    (lambda: disk_margin(LAG, skew=np.nan), "skew"),
    (lambda: disk_margin(LAG, sign=0), "sign"),
    (lambda: disk_margin(LAG, SAMPLED), "sample time"),
    (lambda: disk_margin(MOTORS, frequency=[1.0]), "without blocks"),
    (lambda: rl.robust_stability(rl.delay(1.0), order=4), "order: given for a model with exact delays"),
    (lambda: rl.robust_stability(rl.delay(1.0), pole=1.0), "pole: given for a model with exact delays"),
    (lambda: rl.violation_probability(oscillator(rl.RealScalar), "hinf", 1.0, probability=2.0), "between 0 and 1"),
    (lambda: rl.robust_gain(oscillator(rl.RealScalar), -1.0), "level"),
    (lambda: rl.robust_gain(LAG, 1.0), "UncertainModel"),
    # frequency data
    (lambda: rl.frequency_data([1.0], [0.0, 1.0]), "UncertainFrequencyData|frequency_data: M"),
    (lambda: rl.frequency_data([1.0, 2.0], [1.0, 0.5]), "do not increase"),
    (lambda: rl.frequency_data(LAG, [1.0], radius=0.1), "a radius of a model"),
    (lambda: rl.frequency_data([1.0, 2.0], [0.0, 1.0], radius=-1.0), "negative"),
    (lambda: rl.peak_gain(MOTORS, frequency=[]), "frequencies that do not increase"),
    (lambda: rl.robust_stability(MOTORS, frequency=[1.0], order=3), "order: given for given frequencies"),
    (lambda: rl.robust_stability(rl.frequency_data(LAG, [1.0])), "no uncertainty"),
    (lambda: rl.frequency_data(LAG, [1.0]).feedback(np.eye(2)), "what is fed back is 2 x 2|1 x 1"),
    (lambda: rl.h2_norm(rl.frequency_data(LAG, [1.0])), "no state-space model"),
    (lambda: rl.frequency_data([1.0], "abc"), "omega"),
    (lambda: rl.frequency_data(["a"], [1.0]), "response"),
    (lambda: rl.frequency_data([1.0], [1.0], radius=1j), "radius"),
    (lambda: rl.UncertainFrequencyData([1.0], [[[1.0]]], inputs=3.0), "signals 3.0"),
    # covers
    (lambda: cover([LAGS[0]]), "at least two"),
    (lambda: cover(LAGS[0]), "a list"),
    (lambda: cover([LAGS[0], "no model"]), "model 2"),
    (lambda: cover([LAGS[0], late(1, 1, 0.1)]), "dt"),
    (lambda: cover(LAGS, "element"), "did you mean elements"),
    (lambda: cover(LAGS, tolerance=-1.0), "tolerance"),
    (lambda: cover(LAGS, "pca", directions=0), "directions: 0, expected a whole number of at least 1"),
    (lambda: cover(LAGS, directions=2), "form pca"),
    (lambda: cover(LAGS, "additive", directions=2), "form pca"),
    (lambda: cover(LAGS, "pca", nominal=LAGS[0]), "middle of the box"),
    (lambda: cover(WIDE, "input-multiplicative"), "as many"),
    (lambda: cover(LAGS, "additive", order=99), "0 to 12"),
    (lambda: rl.cover(LAGS, loop=3), "cover: loop"),
    (lambda: rl.cover(LAGS, loop=lambda g: None), "cover: loop"),
]
LATE = rl.delay(1.0)
NO_ANSWER = [
    (lambda: rl.robust_stability(rl.UncertainModel(UNSTABLE, [rl.RealScalar("a")])),
     r"nominal closed loop unstable \(pole 1\+0j\)"),
    (lambda: rl.robust_stability(rl.UncertainModel(rl.StateSpaceModel([[1.2]], [[1.0]], [[1.0]], [[0.0]], 0.1),
                                                   [rl.RealScalar("a")])), r"unstable \(pole 1.2\+0j\)"),
    (lambda: disk_margin(UNSTABLE), "unstable"),
    (lambda: disk_margin(5.0 * LAG @ LATE), "unstable"),
    (lambda: rl.classical_margins((LAG + 0.8 * np.eye(1)) @ LATE), "gain at high frequencies|shows whether"),
    (lambda: rl.classical_margins(rl.StateSpaceModel([[-1.0]], [[1.0]], [[-2.0]], [[1.0]])), "gain is 1 at every freq"),
    (lambda: rl.frequency_data([-1.0, 2.0], [1.0, 2.0]).feedback(1.0), "singular at 1 rad/s"),
]  # fmt: skip


@pytest.mark.parametrize(("call", "text"), REQUESTS)
def test_a_request_that_makes_no_sense_is_refused(call, text):
    with pytest.raises(rl.InputError, match=text):
        call()


@pytest.mark.parametrize(("call", "text"), NO_ANSWER)
def test_a_question_without_an_answer_says_why(call, text):
    with pytest.raises(rl.NoTrustworthyNumber, match=text):
        call()
