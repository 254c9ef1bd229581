"""The nu-gap is a metric, and it bounds the remaining stability margin."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

import robustlab as rl
from robustlab import coprime_margin, nu_gap


def near(seed: int, n: int, p: int, m: int, step: float) -> tuple[rl.StateSpaceModel, ...]:
    """Three models around a common one, stable or not."""
    rng = np.random.default_rng(seed)
    matrices = [rng.standard_normal(shape) for shape in ((n, n), (n, m), (p, n), (p, m))]
    return tuple(
        rl.StateSpaceModel(*(matrix + step * rng.standard_normal(matrix.shape) for matrix in matrices))
        for _ in range(3)
    )


CASES = {
    "seed": st.integers(0, 10_000),
    "n": st.integers(0, 3),
    "p": st.integers(1, 2),
    "m": st.integers(1, 2),
    "step": st.sampled_from([0.0, 0.01, 0.1, 0.5]),
}


@given(**CASES)
@settings(max_examples=8)
def test_they_are_metrics(seed, n, p, m, step):
    a, b, c = near(seed, n, p, m, step)
    slack = 1e-7  # the factors of both models are rounded: 2.4e-8 was seen
    ab, ba, bc, ac = (nu_gap(*pair).value for pair in ((a, b), (b, a), (b, c), (a, c)))
    assert 0 <= ab <= 1
    assert abs(ab - ba) <= slack
    assert ac <= ab + bc + slack
    if step == 0:
        assert ab <= slack


@given(**CASES, gain=st.floats(0.1, 3.0))
@settings(max_examples=15)
def test_the_margin_that_is_left(seed, n, p, m, step, gain):
    """Vinnicombe: arcsin b(P2, C) >= arcsin b(P1, C) - arcsin delta_nu(P1, P2)."""
    one, two, _ = near(seed, n, p, m, step)
    # A controller that stabilises P1: state feedback on an observer, from two Riccati equations.
    from robustlab.linear_analysis import care

    f = care(one.A, one.B, gain * np.eye(n), np.eye(m)).gain
    h = care(one.A.T, one.C.T, np.eye(n), gain * np.eye(p)).gain.T
    K = rl.StateSpaceModel(one.A + one.B @ f + h @ one.C + h @ one.D @ f, -h, f, np.zeros((m, p)))
    first = coprime_margin(one, K, sign=1)
    assert 0 < first.value <= first.best * (1 + 1e-6)
    second = coprime_margin(two, K, sign=1)
    left = np.arcsin(first.value) - np.arcsin(nu_gap(one, two).value)
    assert second.upper >= np.sin(left) - 1e-7
