"""The response of an interconnection of delayed models is that of their responses, at every frequency."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

import robustlab as rl
from robustlab.delays import DelayedModel, error_weight, pade

OMEGA = np.array([0.0, 0.13, 0.9, 4.1, 33.0])
LENGTHS = st.sampled_from([0.0, 0.1, 0.1, 0.25, 0.7])


@st.composite
def delayed(draw, n=2):
    """A square model with delays at its signals and inside."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    states, inner = draw(st.integers(0, 3)), draw(st.integers(0, 2))
    a = rng.normal(size=(states, states)) - 4.0 * np.eye(states)
    size = n + inner
    b, c, d = rng.normal(size=(states, size)), rng.normal(size=(size, states)), 0.2 * rng.normal(size=(size, size))
    lengths = [draw(LENGTHS) for _ in range(inner)]
    model = DelayedModel(rl.StateSpaceModel(a, b, c, d), lengths)
    ends = {i: draw(LENGTHS) for i in range(n)}
    return rl.with_delays(model, inputs=ends, outputs={0: draw(LENGTHS)})


def at(model):
    return rl.frequency_response(model, OMEGA)


def close(found, expected):
    assert np.abs(found - expected).max() <= 1e-8 * (1 + np.abs(expected).max())


@settings(max_examples=40)
@given(delayed(), delayed())
def test_products_sums_and_stacks(g, h):
    close(at(g @ h), at(g) @ at(h))
    close(at(g + h), at(g) + at(h))
    close(at(g - 2.0 * h), at(g) - 2.0 * at(h))
    close(at(g[1, [1, 0]]), at(g)[:, 1:, ::-1])


@settings(max_examples=40)
@given(delayed(), delayed())
def test_loops_and_inverses(g, h):
    loop = (0.1 * g).feedback(h)
    first, second = 0.1 * at(g), at(h)
    close(at(loop), np.linalg.solve(np.eye(2) + first @ second, first))
    whole = rl.with_delays(rl.StateSpaceModel([], [], [], 5.0 * np.eye(2))) + 0.1 * g
    close(at(whole.inverse()) @ (5 * np.eye(2) + first), np.tile(np.eye(2), (len(OMEGA), 1, 1)))


@settings(max_examples=25)
@given(delayed(), st.integers(1, 6))
def test_the_cover_is_pade_at_its_centre(g, order):
    close(at(g.uncertain(order).nominal), at(g.pade(order)))


@settings(max_examples=30)
@given(delayed(), st.integers(0, 6), st.sampled_from([0.13, 0.9, 4.1, 33.0]))
def test_the_cover_holds_the_exact_model(g, order, w):
    cover = g.uncertain(order)
    delta = {}
    for tau, block in zip(sorted(set(g.delays.tolist())), cover.blocks, strict=True):
        assert block.name.startswith(f"delay of {tau!r} s")
        weight = error_weight(order, min(3, 2 * order + 1)).scaled(tau)
        miss = np.exp(-1j * w * tau) - rl.frequency_response(pade(tau, order), [w])[0, 0, 0]
        delta[block.name] = complex(miss / rl.frequency_response(weight, [w])[0, 0, 0])
        assert abs(delta[block.name]) <= 1.0 + 1e-6 or abs(miss) < 1e-12
    close(cover.response([w], delta), rl.frequency_response(g, [w]))
