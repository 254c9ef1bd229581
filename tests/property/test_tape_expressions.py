"""Whatever is written with elementary operations has, as a tape, the value and slopes that CasADi gives it."""

import casadi as ca
import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from robustlab.dynamics import tape_of

BINARY = (lambda a, b: a + b, lambda a, b: a - b, lambda a, b: a * b, lambda a, b: a / (2 + b**2), ca.atan2, ca.fmin)
UNARY = (
    ca.sin,
    ca.cos,
    ca.tanh,
    lambda a: a**2,
    lambda a: ca.sqrt(1 + a**2),
    ca.fabs,
    lambda a: -a,
    lambda a: ca.exp(-(a**2)),
)
STEP = st.tuples(st.integers(0, len(BINARY) + len(UNARY) - 1), st.integers(0, 60), st.integers(0, 60))


@settings(max_examples=60)
@given(steps=st.lists(STEP, min_size=1, max_size=60), still=st.integers(0, 3), seed=st.integers(0, 99))
def test_a_tape_is_the_expression(steps, still, seed):
    x = ca.SX.sym("x", 3)
    made = [x[0], x[1], x[2], ca.SX(1.5)]
    for op, i, j in steps:
        a, b = made[i % len(made)], made[j % len(made)]
        made.append(BINARY[op](a, b) if op < len(BINARY) else UNARY[op - len(BINARY)](a))
    y = ca.vertcat(*made[-3:])
    y = ca.vertcat(y, ca.vec(ca.jacobian(y, x)))
    points = np.random.default_rng(seed).normal(size=(4, 3))
    points[1, -1] = points[0, -1]
    truth = ca.Function("f", [x], [y])
    expected = np.array([truth(p).full().ravel() for p in points])
    np.testing.assert_allclose(tape_of(x, y, still, "test")(points), expected, rtol=1e-12, atol=1e-12)
