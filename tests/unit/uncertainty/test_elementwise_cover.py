"""The cover of an element-wise set: each member of the set is one of the cover, with a Delta of norm at most one."""

import numpy as np

import robustlab as rl
from robustlab.statespace import StateSpaceModel
from robustlab.uncertainty import elementwise_cover


def pair():
    rng = np.random.default_rng(3)
    shapes = ((4, 4), (4, 2), (3, 4), (3, 2))
    first = [rng.standard_normal(s) for s in shapes]
    change = [0.3 * rng.standard_normal(s) * (rng.random(s) < 0.6) for s in shapes]
    change[0][1], change[2][:, 0] = 0.0, 0.0
    return StateSpaceModel(*first), StateSpaceModel(*(a + b for a, b in zip(first, change, strict=True)))


def test_every_member_of_the_set_is_in_the_cover():
    nominal, perturbed = pair()
    entries, cover = rl.elementwise(nominal, perturbed, "elements"), elementwise_cover(nominal, perturbed)
    rng = np.random.default_rng(4)
    for _ in range(20):
        member = entries.evaluate({b.name: rng.choice([-1.0, 1.0, 0.3]) for b in entries.blocks})
        delta = {}
        for b in cover.blocks:
            kind = b.name
            size = np.abs(getattr(perturbed, kind) - getattr(nominal, kind))
            rows, columns = np.flatnonzero(size.any(axis=1)), np.flatnonzero(size.any(axis=0))
            change = (getattr(member, kind) - getattr(nominal, kind))[np.ix_(rows, columns)]
            delta[kind] = change / np.linalg.norm(size, 2)
            assert np.linalg.norm(delta[kind], 2) <= 1 + 1e-12
        again = cover.evaluate(delta)
        for kind in "ABCD":
            np.testing.assert_allclose(getattr(again, kind), getattr(member, kind), atol=1e-12)


def test_equal_models_have_no_block():
    nominal, _ = pair()
    assert elementwise_cover(nominal, nominal).blocks == ()


def test_mu_of_the_cover_is_above_that_of_the_set():
    A = [[-1.0, 0.5], [0.0, -2.0]]
    nominal = StateSpaceModel(A, [[1.0], [1.0]], [[1.0, 0.0]], [[0.0]])
    perturbed = StateSpaceModel([[-0.8, 0.7], [0.1, -1.7]], [[1.0], [1.1]], [[1.0, 0.0]], [[0.0]])
    small = rl.robust_performance(rl.elementwise(nominal, perturbed, "elements"))
    large = rl.robust_performance(elementwise_cover(nominal, perturbed))
    assert large.lower <= small.upper
