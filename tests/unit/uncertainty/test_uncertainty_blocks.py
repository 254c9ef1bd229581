"""Blocks of Delta: mussv's notation, sizes, and Delta from values."""

import numpy as np
import pytest

from robustlab import ComplexScalar, FullBlock, ParameterRange, RealScalar, UncertainModel
from robustlab.statespace import StateSpaceModel
from robustlab.uncertainty import as_blocks, block_slices, delta_matrix, delta_values, structure_size


def test_mussv_rows():
    blocks = as_blocks([[-1, 0], [-3, 0], [1, 1], [2, 0], [2, 3], [-1, 1], [1, 0]])
    assert blocks == (
        RealScalar("delta1"),
        RealScalar("delta2", 3),
        ComplexScalar("delta3"),
        ComplexScalar("delta4", 2),
        FullBlock("delta5", 2, 3),
        RealScalar("delta6"),
        ComplexScalar("delta7"),
    )
    assert structure_size(blocks) == (11, 12)
    assert block_slices(blocks)[4] == (slice(7, 9), slice(7, 10))
    assert as_blocks(np.array([[-2, 0]])) == (RealScalar("delta1", 2),)
    assert as_blocks(RealScalar("k")) == (RealScalar("k"),)


def test_a_range_wider_above_than_below():
    span = ParameterRange(1.0, 0.5, "s", below=0.25)
    assert (span.low, span.high, span.ratio) == (0.75, 1.5, 0.5)
    assert [span.delta(v) for v in (0.75, 0.5, 1.0, 1.25, 2.0)] == [-1.0, -2.0, 0.0, 0.5, 2.0]
    assert ParameterRange.between(0.75, 1.5, 1.0, "s") == span
    assert ParameterRange.between(0.75, 1.25) == ParameterRange(1.0, 0.25)
    assert ParameterRange(1.0, 0.5, below=0.5) == ParameterRange(1.0, 0.5)


@pytest.mark.parametrize("delta", [-1.0, -2.5, -0.3, 0.0, 0.4, 1.0, 3.0])
def test_delta_is_piecewise_and_the_member_has_the_parameter_value(delta):
    """1 / (tau s + 1) written by hand: tau s x = -x + u with tau = 1 + 0.5 e, e the entry of Delta."""
    span = ParameterRange(1.0, 0.5, "s", below=0.25)
    m = StateSpaceModel([[-1.0]], [[-0.5, 1.0]], [[-1.0], [1.0]], [[-0.5, 1.0], [0.0, 0.0]])
    lag = UncertainModel(m, [RealScalar("tau", 1, span)])
    tau = 1.0 + (0.5 if delta >= 0 else 0.25) * delta
    if tau > 0:
        np.testing.assert_allclose(lag.evaluate({"tau": delta}).A, [[-1.0 / tau]], rtol=1e-14)
    assert lag.physical({"tau": delta})["tau"] == (pytest.approx(tau), "s")
    block = RealScalar("tau", 2, span)
    entries = delta_matrix([block], {"tau": delta})
    np.testing.assert_allclose(entries, (delta if delta >= 0 else 0.5 * delta) * np.eye(2))
    assert delta_values([block], entries)["tau"] == pytest.approx(delta, rel=1e-15)


@pytest.mark.parametrize(
    "use",
    [lambda k: -k, lambda k: 2 * k, lambda k: k / 3, lambda k: 1 + k, lambda k: k**2, lambda k: np.eye(2) * k],
)
def test_arithmetic_with_a_block_points_to_expressions(use):
    for block in (RealScalar("k"), FullBlock("k", 2, 2)):
        with pytest.raises(TypeError, match=r"'k' is an uncertainty block, no number\nhint: rl\.parametric"):
            use(block)
