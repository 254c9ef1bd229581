"""Values that an argument cannot have are refused in one clear line; a wrong type is Python's own error."""

from __future__ import annotations

import numpy as np
import pytest
import shown_objects as made

import robustlab as rl
from robustlab.errors import UsageError

ONE = [[1.0]]
NAN = float("nan")

REFUSED = {
    "classical_margins at": lambda: rl.classical_margins(made.lag(), at="z"),
    "compare window": lambda: rl.compare(made.lag(), run(), window=-1.0),
    "ComplexScalar name": lambda: rl.ComplexScalar(""),
    "control_weight limit": lambda: rl.control_weight(limit=0.0),
    "delay n": lambda: rl.delay(0.1, n=-1),
    "discretise method": lambda: rl.discretise(made.lag(), 0.1, method="tusting"),
    "elementwise signals": lambda: rl.elementwise(made.lag(), made.problem()),
    "frequency_response omega": lambda: rl.frequency_response(made.lag(), [NAN]),
    "hinf gamma_rel": lambda: rl.hinf(made.problem(), n_meas=1, n_con=1, gamma_rel=0.5),
    "hinf n_meas": lambda: rl.hinf(made.problem(), n_meas=9, n_con=1),
    "mu blocks": lambda: rl.mu(ONE, [[2, 0]]),
    "mu M": lambda: rl.mu([[NAN]], [[1, 0]]),
    "overbound order": lambda: rl.overbound([1.0, 2.0, 3.0], [1.0, 1.0, 1.0], order=-1),
    "parametric range": lambda: rl.parametric([["-a"]], ONE, ONE, [[0.0]], {"a": (1.0, 2.0, 0.5)}),
    "peak_gain tolerance": lambda: rl.peak_gain(made.lag(), tolerance=-1.0),
    "performance_weight bandwidth": lambda: rl.performance_weight(-1.0),
    "Record t": lambda: rl.Record([0.0, 0.0], {}, {"y": [0.0, 1.0]}),
    "reduce_model order": lambda: rl.reduce_model(made.lag(), order=-1),
    "sample n": lambda: rl.sample(made.spring(), n=0),
    "violation_probability probability": lambda: rl.violation_probability(made.spring(), "hinf", 1.0, probability=2.0),
    "simulate t": lambda: rl.simulate(made.lag(), [0.0, NAN], [0.0, 0.0]),
    "simulate u": lambda: rl.simulate(made.lag(), [0.0, 0.1], np.full(2, NAN)),
    "ss A": lambda: rl.ss([[NAN]], ONE, ONE, [[0.0]]),
    "tf den": lambda: rl.tf([1.0], [0.0]),
    "validate noise": lambda: rl.validate(rl.unstructured(made.lag(), 0.2), run(), noise={"y": -1.0}),
    "worst_case metric": lambda: rl.worst_case(made.first_order()[0, 0], metric="peak-devaition"),
    "zpk gain": lambda: rl.zpk([], [-1.0], gain=NAN),
}
PYTHON = {
    "an unknown name": lambda: rl.peak_gain(made.lag(), tolerence=0.1),
    "a missing one": lambda: rl.hinf(made.problem()),
    "of a class": lambda: rl.StateSpaceModel([[-1.0]], ONE, ONE, [[0.0]], dtt=0.1),
    "a text for a number": lambda: rl.delay("0.1"),
    "no model": lambda: rl.well_posedness(3.0),
    "of a reader": lambda: rl.Record.read("run.csv", delimitter=";"),
}


def run() -> rl.Record:
    t = 0.1 * np.arange(20)
    return rl.simulate(made.lag(), t, np.sin(t))


@pytest.mark.parametrize("name", REFUSED)
def test_a_value_that_an_argument_cannot_have_is_refused_by_the_functions_name(name):
    with pytest.raises((rl.InputError, UsageError)) as caught:
        REFUSED[name]()
    assert all(ch.isprintable() or ch == "\n" for ch in str(caught.value))


@pytest.mark.parametrize("name", PYTHON)
def test_a_wrong_type_is_pythons_own_error(name):
    with pytest.raises((TypeError, AttributeError, rl.InputError)):
        PYTHON[name]()


def test_what_a_function_of_the_user_raises_is_not_swallowed():
    def progress(*_: object) -> None:
        raise TypeError("mine")

    with pytest.raises(TypeError, match="mine"):
        rl.fixed_structure(made.problem(), "static", n_meas=1, n_con=1, starts=1, progress=progress)
