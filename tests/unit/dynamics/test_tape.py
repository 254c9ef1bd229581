"""Tapes: every operation against numpy, and invalid tapes."""

import casadi as ca
import numpy as np
import pytest
from scipy import special

from robustlab.dynamics import OPERATIONS, Tape, tape_of
from robustlab.errors import InputError

A = np.array([-1.7, -0.4, 0.0, 0.3, 0.9, 1.0, 2.5])
B = np.array([0.3, -0.4, 1.2, 0.0, 2.0, 1.0, -1.5])
OF_ONE = {
    "NEG": np.negative, "SQ": np.square, "TWICE": lambda a: 2 * a, "INV": lambda a: 1 / a, "SQRT": np.sqrt,
    "SIN": np.sin, "COS": np.cos, "TAN": np.tan, "ASIN": np.arcsin, "ACOS": np.arccos, "ATAN": np.arctan, "EXP": np.exp,
    "LOG": np.log, "SINH": np.sinh, "COSH": np.cosh, "TANH": np.tanh, "ASINH": np.arcsinh, "ACOSH": np.arccosh,
    "ATANH": np.arctanh, "EXPM1": np.expm1, "LOG1P": np.log1p, "FABS": np.abs, "SIGN": np.sign, "NOT": np.logical_not,
    "ERF": special.erf,
}  # fmt: skip
OF_TWO = {
    "ADD": np.add, "SUB": np.subtract, "MUL": np.multiply, "DIV": np.divide, "ATAN2": np.arctan2, "POW": np.power,
    "HYPOT": np.hypot, "FMIN": np.minimum, "FMAX": np.maximum, "LT": np.less, "LE": np.less_equal, "EQ": np.equal,
    "NE": np.not_equal, "AND": np.logical_and, "OR": np.logical_or, "COPYSIGN": np.copysign,
    "IF_ELSE_ZERO": lambda a, b: np.where(a != 0, b, 0.0),
}  # fmt: skip


@pytest.mark.parametrize("name", OPERATIONS)
def test_every_operation_is_that_of_numpy(name):
    k = OPERATIONS.index(name)
    tape = Tape(2, np.array([k]), np.array([0]), np.array([1]), np.zeros(0), np.array([2]))
    with np.errstate(all="ignore"):
        expected = np.asarray(OF_ONE[name](A) if name in OF_ONE else OF_TWO[name](A, B), dtype=float)
    np.testing.assert_allclose(tape(np.column_stack([A, B]))[:, 0], expected, rtol=1e-15, atol=1e-16)


def test_expressions_of_casadi_keep_their_values():
    x = ca.SX.sym("x", 4)
    y = ca.vertcat(
        ca.if_else(x[0] > 0.5, ca.sqrt(x[1]), x[2] ** 3),
        x[0] ** x[1] + x[2] ** 1.5,
        ca.atan2(x[0], x[3]) / (1 + x[1] ** 2) + 7.25,
        3.0,
        x[2],
        ca.dot(x, x) * ca.exp(-x[0]),
    )
    points = np.random.default_rng(1).uniform(0.0, 1.0, (50, 4))
    truth = ca.Function("f", [x], [y])
    for still in range(5):
        found = tape_of(x, y, still, "test")(points)
        np.testing.assert_allclose(found, [truth(p).full().ravel() for p in points], rtol=1e-14)


GOOD = {
    "n_in": 2,
    "operations": np.array([2, 0]),
    "left": np.array([0, 3]),
    "right": np.array([2, 1]),
    "constants": np.array([2.0]),
    "outputs": np.array([4]),
}


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"operations": np.array([2, len(OPERATIONS)])}, "operations: entry 1 is 42"),
        ({"operations": np.array([2.0, 0.0])}, "operations: float64"),
        ({"left": np.array([0, 4])}, "left: entry 1 is 4"),
        ({"right": np.array([2, -5])}, "right: entry 1 is -5"),
        ({"right": np.array([2])}, "2 and 1 arguments"),
        ({"outputs": np.array([5])}, "outputs: entry 0 is 5"),
        ({"constants": np.array([np.nan])}, "constants: entry 0"),
        ({"constants": np.array([[2.0]])}, "constants: shape"),
    ],
)
def test_invalid_tapes_are_rejected(wrong, message):
    Tape(**GOOD)
    with pytest.raises(InputError, match=message):
        Tape(**{**GOOD, **wrong})
