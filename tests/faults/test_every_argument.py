"""Every argument of the public functions is given what it cannot be: a call returns, or is refused in a clear line."""

from __future__ import annotations

import inspect
from typing import Any

import numpy as np
import pytest
import shown_objects as made

import robustlab as rl

ONE = [[1.0]]
GAIN = rl.StateSpaceModel([], [], [], ONE)
TWO = rl.StateSpaceModel([[-1.0, 0.0], [0.0, -2.0]], [[1.0], [1.0]], [[1.0, 1.0]], [[0.0]])
DIGITAL = rl.StateSpaceModel([[0.5]], ONE, ONE, [[0.0]], dt=0.1)
OMEGA = np.geomspace(0.1, 10.0, 12)


def delayed() -> Any:
    return rl.with_delays(made.lag(), inputs={"u": 0.5})


# A call of each function that takes milliseconds; every argument of it is replaced in turn.
CALLS: dict[str, Any] = {
    "balanced_truncation": lambda: {"model": TWO, "order": 1},
    "by_cause": lambda: {"nominal": made.spring().nominal, "perturbed": {"a": made.four_models()[1]}},
    "care": lambda: {"A": [[0.0]], "B": ONE, "Q": ONE, "R": ONE},
    "centred": lambda: {"uncertain": made.spring(), "level": 0.5},
    "classical_margins": lambda: {"plant": made.lag(), "K": GAIN},
    "complementary_weight": lambda: {"bandwidth": 10.0},
    "control_weight": lambda: {"limit": 5.0},
    "controllability": lambda: {"model": TWO},
    "coprime_margin": lambda: {"P": made.lag(), "C": GAIN},
    "d2c": lambda: {"model": DIGITAL},
    "d2d": lambda: {"model": DIGITAL, "dt": 0.2},
    "dare": lambda: {"A": [[0.5]], "B": ONE, "Q": ONE, "R": ONE},
    "delay": lambda: {"tau": 0.1},
    "delay_classical_margins": lambda: {"plant": delayed(), "K": GAIN},
    "descriptor": lambda: {"A": [[-1.0]], "B": ONE, "C": ONE, "D": [[0.0]], "E": [[2.0]]},
    "design_weights": lambda: {"bandwidth": 10.0, "control_limit": 5.0, "noise_from": 200.0},
    "discretise": lambda: {"model": made.lag(), "dt": 0.1},
    "dlyap": lambda: {"A": [[0.5]], "Q": ONE},
    "elementwise": lambda: dict(zip(("nominal", "perturbed"), made.four_models(), strict=False)),
    "frequency_data": lambda: {"given": made.lag(), "omega": OMEGA},
    "frequency_response": lambda: {"model": made.lag(), "omega": OMEGA},
    "gap": lambda: {"P1": made.lag(), "P2": 2.0 * made.lag()},
    "generalized_plant": lambda: {"model": made.problem(), "measurements": ["y"], "controls": ["u"]},
    "h2": lambda: {"P": made.problem(), "n_meas": 1, "n_con": 1},
    "h2_norm": lambda: {"model": made.lag()},
    "hankel_singular_values": lambda: {"model": TWO},
    "hinf_norm": lambda: {"model": TWO},
    "kalman": lambda: {"G": made.spring().nominal, "W": np.eye(2), "V": ONE},
    "linf_norm": lambda: {"model": TWO},
    "lqg": lambda: {"G": made.lag(), "Q": ONE, "R": ONE, "W": ONE, "V": ONE, "disturbance": "constant"},
    "lqi": lambda: {"G": made.spring().nominal, "Q": np.eye(3), "R": ONE},
    "lqr": lambda: {"G": made.spring().nominal, "Q": np.eye(2), "R": ONE},
    "lyap": lambda: {"A": [[-0.5]], "Q": ONE},
    "makeweight": lambda: {"low_gain": 10.0, "through": (1.0, 1.0), "high_gain": 0.1},
    "ncf": lambda: {"G": made.lag()},
    "neglected_delay": lambda: {"tau_max": 0.1},
    "neglected_lag": lambda: {"tau_max": 0.1},
    "nu_gap": lambda: {"P1": made.lag(), "P2": 2.0 * made.lag()},
    "parametric": lambda: {"A": [["-a"]], "B": ONE, "C": ONE, "D": [[0.0]], "parameters": {"a": (1.0, 0.5, 2.0)}},
    "performance_weight": lambda: {"bandwidth": 1.0},
    "perturbed_model": lambda: {"uncertain": made.spring(), "delta": {"k": 0.5}},
    "place": lambda: {"G": made.spring().nominal, "poles": [-1.0, -2.0]},
    "realise_delta": lambda: {"blocks": made.spring().blocks, "delta": {"k": 0.5}, "omega": 1.0},
    "reduce_model": lambda: {"model": TWO, "order": 1},
    "reduction": lambda: {"uncertain": made.spring()},
    "sample": lambda: {"uncertain": made.spring(), "n": 5},
    "sample_size": lambda: {"probability": 0.05},
    "simulate": lambda: {"plant_or_model": made.lag(), "t": [0.0, 0.1, 0.2], "u": np.ones(3)},
    "star": lambda: {"first": made.problem(), "second": 1.0, "n_to_second": 1, "n_to_first": 1},
    "sylvester": lambda: {"A": ONE, "B": ONE, "Q": ONE},
    "unstructured": lambda: {"G": made.lag(), "W2": 0.2},
    "with_delays": lambda: {"G": made.lag(), "inputs": {"u": 0.1}},
}
BAD: tuple[Any, ...] = (
    *(None, np.nan, np.inf, -1, 0, 1e300, 1e-300, True, 2.5, 1j, "abc", "", object(), dict, DIGITAL),
    *([], [[]], [np.nan], [[np.nan]], ["a"], {}, {"a": "b"}, np.ones((3, 2)), np.ones((2, 2, 2)), np.array([None])),
)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("name", CALLS)
def test_what_an_argument_cannot_be_is_refused_in_one_clear_line(name):
    function = getattr(rl, name)
    function(**CALLS[name]())
    refused = 0
    for argument, parameter in inspect.signature(function).parameters.items():
        if argument in ("tuning", "progress") or parameter.kind is parameter.VAR_KEYWORD:
            continue
        for value in BAD:
            try:
                function(**CALLS[name]() | {argument: value})
            except rl.RobustlabError as error:
                refused += 1
                assert all(ch.isprintable() or ch == "\n" for ch in str(error))
            except Exception as error:  # noqa: BLE001  that is what is looked for
                pytest.fail(f"{name}({argument}={value!r}): {type(error).__name__}: {error}")
    assert refused > 8  # the attack bites
