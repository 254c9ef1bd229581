"""Values that an argument cannot have are refused in one clear line."""

import pytest
import shown_objects as made

import robustlab as rl
from robustlab.errors import UsageError

ONE = [[1.0]]
NAN = float("nan")

REFUSED = {
    "classical_margins at": lambda: rl.classical_margins(made.lag(), at="z"),
    "ComplexScalar name": lambda: rl.ComplexScalar(""),
    "delay n": lambda: rl.delay(0.1, n=-1),
    "elementwise signals": lambda: rl.elementwise(made.lag(), made.problem()),
    "frequency_response omega": lambda: rl.frequency_response(made.lag(), [NAN]),
    "overbound order": lambda: rl.overbound([1.0, 2.0, 3.0], [1.0, 1.0, 1.0], order=-1),
    "peak_gain tolerance": lambda: rl.peak_gain(made.lag(), tolerance=-1.0),
    "sample n": lambda: rl.sample(made.spring(), n=0),
    "violation_probability probability": lambda: rl.violation_probability(made.spring(), "hinf", 1.0, probability=2.0),
    "simulate t": lambda: rl.simulate(made.lag(), [0.0, NAN], [0.0, 0.0]),
    "ss A": lambda: rl.ss([[NAN]], ONE, ONE, [[0.0]]),
    "tf den": lambda: rl.tf([1.0], [0.0]),
    "zpk gain": lambda: rl.zpk([], [-1.0], gain=NAN),
}


@pytest.mark.parametrize("name", REFUSED)
def test_a_value_that_an_argument_cannot_have_is_refused_by_the_functions_name(name):
    with pytest.raises((rl.InputError, UsageError)) as caught:
        REFUSED[name]()
    assert all(ch.isprintable() or ch == "\n" for ch in str(caught.value))


def test_what_a_function_of_the_user_raises_is_not_swallowed():
    def progress(*_: object) -> None:
        raise TypeError("mine")

    with pytest.raises(TypeError, match="mine"):
        rl.fixed_structure(made.problem(), "static", n_meas=1, n_con=1, starts=1, progress=progress)
