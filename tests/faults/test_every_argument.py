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


def pole(a: float) -> rl.StateSpaceModel:
    return rl.StateSpaceModel([[a]], ONE, ONE, [[0.0]])


def run() -> rl.Record:
    t = 0.1 * np.arange(20)
    return rl.simulate(made.lag(), t, np.sin(t))


def delayed() -> Any:
    return rl.with_delays(made.lag(), inputs={"u": 0.5})


# A call of each function that takes milliseconds; every argument of it is replaced in turn.
CALLS: dict[str, Any] = {
    "classical_margins": lambda: {"plant": made.lag(), "K": GAIN},
    "compare": lambda: {"plant": made.lag(), "record": run()},
    "complementary_weight": lambda: {"bandwidth": 10.0},
    "ComplexScalar": lambda: {"name": "a"},
    "connect": lambda: {"inputs": ["r"], "outputs": ["y"], "sums": ["y = r"]},
    "conservatism": lambda: {"uncertain": made.spring(), "models": made.four_models()},
    "control_weight": lambda: {"limit": 5.0},
    "controllability": lambda: {"model": TWO},
    "Controller": lambda: {"K": GAIN},
    "coprime_margin": lambda: {"P": made.lag(), "C": GAIN},
    "cover": lambda: {"models": made.four_models()},
    "d2c": lambda: {"model": DIGITAL},
    "d2d": lambda: {"model": DIGITAL, "dt": 0.2},
    "delay": lambda: {"tau": 0.1},
    "DelayedModel": lambda: {"H": delayed().H, "delays": delayed().delays},
    "descriptor": lambda: {"A": [[-1.0]], "B": ONE, "C": ONE, "D": [[0.0]], "E": [[2.0]]},
    "discretise": lambda: {"model": made.lag(), "dt": 0.1},
    "discretise of a loop": lambda: {"model": made.mixsyn(), "dt": 0.1, "method": "tustin"},
    "disk_margin": lambda: {"plant": made.lag(), "K": GAIN},
    "elementwise": lambda: dict(zip(("nominal", "perturbed"), made.four_models(), strict=False)),
    "elementwise of causes": lambda: {"nominal": made.spring().nominal, "perturbed": {"a": made.four_models()[1]}},
    "fixed_structure": lambda: {"P": made.problem(), "structure": "static", "n_meas": 1, "n_con": 1, "starts": 1},
    "frequency_data": lambda: {"given": made.lag(), "omega": OMEGA},
    "frequency_data of a coherence": lambda: {
        "given": [1.0, 2.0], "omega": [1.0, 2.0], "coherence": [0.9, 0.9], "averages": 10,
    },
    "frequency_response": lambda: {"model": made.lag(), "omega": OMEGA},
    "FrequencyData": lambda: {"omega": [1.0, 2.0], "response": [1.0, 1.0], "input": "u", "outputs": ["y"]},
    "FullBlock": lambda: {"name": "a", "rows": 1, "cols": 1},
    "generalized_plant": lambda: {"model": made.problem(), "measurements": ["y"], "controls": ["u"]},
    "h2": lambda: {"P": made.problem(), "n_meas": 1, "n_con": 1},
    "h2_norm": lambda: {"model": made.lag()},
    "hankel_singular_values": lambda: {"model": TWO},
    "hinf": lambda: {"P": made.problem(), "n_meas": 1, "n_con": 1},
    "hinf of a schedule": lambda: {"P": made.scheduled_plant(), "n_meas": 1, "n_con": 1},
    "linearise": lambda: {"plant": made.motor()},
    "loop_functions": lambda: {"G": made.lag(), "K": GAIN},
    "lpv_model": lambda: {"source": made.first_order(), "points": {"pole": 2}},
    "LPVModel": lambda: {"points": {"a": [-2.0, -1.0]}, "models": [pole(-2.0), pole(-1.0)]},
    "makeweight": lambda: {"low_gain": 10.0, "through": (1.0, 1.0), "high_gain": 0.1},
    "mixsyn": lambda: {"G": made.lag(), "W1": rl.performance_weight(1.0, 0.01, 2.0), "W2": 0.1},
    "mu": lambda: {"M": [[0.5, 1.0], [1.0, 0.0]], "blocks": [[1, 0], [1, 0]]},
    "mu of fixed blocks": lambda: {"M": [[0.5, 1.0], [1.0, 0.0]], "blocks": [[1, 0], [1, 0]], "fixed": ["delta1"]},
    "ncf": lambda: {"G": made.lag()},
    "Nonlinearity": lambda: {"sector": (0.0, 1.0)},
    "nu_gap": lambda: {"P1": made.lag(), "P2": 2.0 * made.lag()},
    "observability": lambda: {"model": TWO},
    "overbound": lambda: {"omega": OMEGA, "bound": 0.1 + OMEGA / (1.0 + OMEGA), "order": 2},
    "ParameterRange": lambda: {"nominal": 1.0, "radius": 0.1},
    "parametric": lambda: {"A": [["-a"]], "B": ONE, "C": ONE, "D": [[0.0]], "parameters": {"a": (1.0, 0.5, 2.0)}},
    "passivity": lambda: {"model": TWO},
    "peak_gain": lambda: {"system": TWO},
    "performance_weight": lambda: {"bandwidth": 1.0},
    "RealScalar": lambda: {"name": "a"},
    "Record": lambda: {"t": [0.0, 0.1], "inputs": {"u": [0.0, 1.0]}, "outputs": {"y": [0.0, 1.0]}},
    "minimal": lambda: {"model": TWO},
    "reduce_model": lambda: {"model": TWO, "order": 1},
    "reduce_model of a set": lambda: {"model": made.spring(), "tolerance": 1e-9},
    "robust_gain": lambda: {"uncertain": made.first_order(), "level": 4.0},
    "robust_stability": lambda: {"system": made.first_order()},
    "sample": lambda: {"uncertain": made.spring(), "n": 5},
    "sample_size": lambda: {"probability": 0.05},
    "sampled_data_norm": lambda: {"plant": made.problem(), "K": made.digital()},
    "simulate": lambda: {"plant_or_model": made.lag(), "t": [0.0, 0.1, 0.2], "u": np.ones(3)},
    "small_gain": lambda: {"uncertain": rl.unstructured(made.lag(), 0.2).feedback(2.0)},
    "ss": lambda: {"A": [[-1.0]], "B": ONE, "C": ONE, "D": [[0.0]]},
    "star": lambda: {"first": made.problem(), "second": 1.0, "n_to_second": 1, "n_to_first": 1},
    "StateSpaceModel": lambda: {"A": [[-1.0]], "B": ONE, "C": ONE, "D": [[0.0]]},
    "tf": lambda: {"num": [1.0], "den": [1.0, 1.0]},
    "UncertainFrequencyData": lambda: {"omega": [1.0, 2.0], "M": np.ones((2, 1, 1))},
    "UncertainModel": lambda: {"M": pole(-1.0), "blocks": [rl.RealScalar("a")]},
    "unstructured": lambda: {"G": made.lag(), "W2": 0.2},
    "validate": lambda: {"uncertain": rl.unstructured(made.lag(), 0.2), "record": run(), "noise": {"y": 0.01}},
    "Varying": dict,
    "verify": lambda: {"result": rl.peak_gain(made.lag())},
    "violation_probability": lambda: {
        "uncertain": made.first_order()[0, 0],
        "metric": "peak-deviation",
        "limit": 0.3,
        "n": 50,
        "t": [0.0, 0.5, 1.0],
    },
    "well_posedness": lambda: {"uncertain": made.spring()},
    "with_delays": lambda: {"G": made.lag(), "inputs": {"u": 0.1}},
    "with_delays of a range": lambda: {"G": made.lag(), "inputs": {"u": (0.1, 0.2)}},
    "with_effects": lambda: {"plant": rl.plant("servo-axis"), "effects": {"coulomb-friction": {"Fc": 20.0}}},
    "worst_case": lambda: {
        "uncertain": made.first_order()[0, 0],
        "metric": "peak-deviation",
        "n": 16,
        "t": [0.0, 0.5, 1.0],
    },
    "zeros": lambda: {"model": TWO},
    "classical_margins of delays": lambda: {"plant": delayed(), "K": GAIN},
    "disk_margin of delays": lambda: {"plant": 2.0 * delayed()},
    "disk_margin of frequencies": lambda: {"plant": made.lag(), "K": GAIN, "frequency": [0.5, 1.0]},
    "disk_margin of a set": lambda: {"plant": made.first_order()[0, 0]},
    "peak_gain of delays": lambda: {"system": delayed()},
    "peak_gain of frequencies": lambda: {"system": made.first_order(), "frequency": [0.5, 1.0]},
    "peak_gain of natures": lambda: {
        "system": made.first_order(), "natures": {"pole": rl.Varying(0.1)}, "order": 0,
    },
    "peak_gain of a schedule": lambda: {"system": rl.LPVModel({"a": [-2.0, -1.0]}, [pole(-2.0), pole(-1.0)])},
    "peak_gain of a set": lambda: {"system": made.first_order()},
    "robust_stability of delays": lambda: {"system": delayed().feedback()},
    "robust_stability of frequencies": lambda: {"system": made.first_order(), "frequency": [0.5, 1.0]},
    "robust_stability of natures": lambda: {
        "system": made.first_order(), "natures": {"pole": rl.Varying(0.1)}, "order": 0,
    },
    "zpk": lambda: {"zeros": [], "poles": [-1.0], "gain": 2.0},
}  # fmt: skip
# What nothing is: no number, word, list, mapping, array or model can stand for all arguments.
BAD: tuple[Any, ...] = (
    *(
        None,
        np.nan,
        np.inf,
        -1,
        0,
        1e300,
        1e-300,
        5e-324,
        2**70,
        True,
        2.5,
        1j,
        "abc",
        "",
        "\x00",
        b"x",
        object(),
        dict,
    ),
    *(DIGITAL, [], [[]], [np.nan], [[np.nan]], ["a"], ["u", "u"], [1j], [1e300], [5e-324], (True,), {}, {"a": "b"}),
    *(
        {"u": 1e300},
        {"u": None},
        np.ones((3, 2)),
        np.ones((2, 2, 2)),
        np.zeros((0, 0)),
        np.array([None]),
        1j * np.eye(1),
    ),
)
# Rounding of numbers at the ends of the double range is told by numpy, and is no fault of a function.
EXTREME = (RuntimeWarning,)
# Functions of the user's own: what they raise is theirs. Parts come without a name.
OWN = {"progress", "exact", "loop", "metric", "parts"}
# With a number that is very small or large these take seconds and answer: (function, argument).
LONG = {
    *(("classical_margins of delays", "K"), ("disk_margin of delays", "K"), ("discretise of a loop", "delay")),
    *(("sampled_data_norm", "delay"), ("worst_case", "workers")),
    ("violation_probability", "workers"),
}


# Designs and searches of a tenth of a second and more, some fifty times each argument.
SLOW = {"fixed_structure", "robust_stability of natures", "disk_margin of a set"}


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.slow) if name in SLOW else name for name in CALLS]
)
def test_what_an_argument_cannot_be_is_refused_in_one_clear_line(name):
    function = getattr(rl, name.partition(" ")[0])  # "peak_gain of delays": of a kind of what it is given
    function(**CALLS[name]())
    refused = 0
    for argument, parameter in inspect.signature(function).parameters.items():
        if argument in OWN or (name, argument) in LONG or parameter.kind is parameter.VAR_KEYWORD:
            continue
        for value in BAD:
            try:
                function(**CALLS[name]() | {argument: value})
            except rl.RobustlabError as error:
                refused += 1
                assert all(ch.isprintable() or ch == "\n" for ch in str(error))
            except EXTREME:
                continue
            except Exception as error:  # noqa: BLE001  that is what is looked for
                pytest.fail(f"{name}({argument}={value!r}): {type(error).__name__}: {error}")
    assert refused > 8  # the attack bites


def test_every_public_function_that_takes_milliseconds_is_attacked():
    """What is left out searches for seconds, makes files, or takes anything by name."""
    apart = {
        *("data_cover", "discover", "dk", "reduce_controller", "tune", "watch"),
        *("robust_performance",),
        *("load", "save", "export_controller", "plant", "trim", "PlantEquations"),
        *("beside", "stacked", "uncertain_from", "Signal", "Status"),
        *("RobustlabError", "InputError", "NoTrustworthyNumber"),
    }
    assert set(rl.__all__) == {name.partition(" ")[0] for name in CALLS} | apart
