"""Results about delays and covers are proved by the checker, and no longer where they say more than is true."""

from dataclasses import replace

import numpy as np
import pytest

import robustlab as rl
from robustlab.evidence import claims_of
from robustlab.verification import Claim, check

LAG = rl.tf([1.0], [1.0, 1.0])
LATE = rl.with_delays(LAG, inputs={0: 0.3}, outputs={0: 0.1})
MOTORS = rl.parametric([["-1/T"]], [["k/T"]], [[1]], [[0]], {"k": (2.0, 0.1), "T": (1.0, 0.2)})
RANGE = rl.with_delays(MOTORS, inputs={"u1": (0.2, 0.4)})
UNITS = [
    rl.StateSpaceModel([[-1 / t]], [[g / t]], [[1.0]], [[0.0]])
    for g, t in ((1.0, 1.0), (1.2, 1.3), (0.9, 0.8), (1.1, 0.7))
]


def pair():
    late = rl.StateSpaceModel(-np.diag([1.0, 2.0]), [[1, 0.3], [-0.2, 1]], np.eye(2), np.zeros((2, 2)))
    return rl.with_delays(late, inputs={0: 0.3, 1: 0.1}), rl.StateSpaceModel([], [], [], 2.0 * np.eye(2))


def smaller(margin):
    return replace(margin, lower=1.0001 * margin.upper)


RESULTS = {
    "stability": lambda: rl.robust_stability((2.0 * LATE).feedback()),
    "gain": lambda: rl.peak_gain((2.0 * LATE).feedback()),
    "disk margin": lambda: rl.disk_margin(2.0 * LATE),
    "disk margins": lambda: rl.disk_margin(*pair()),
    "set": lambda: (2.0 * LATE).feedback().uncertain(4),
    "range": lambda: RANGE,
    "margin": lambda: rl.robust_stability(RANGE.feedback()),
    "worst-case gain": lambda: rl.peak_gain(RANGE.feedback()),
    "elements": lambda: rl.cover(UNITS, "elements", gain=False),
    "elements about one": lambda: rl.cover(UNITS, "elements", nominal=UNITS[0], gain=False),
    "pca": lambda: rl.cover(UNITS, "pca", gain=False),
    "additive": lambda: rl.cover(UNITS, "additive", gain=False),
}  # fmt: skip


@pytest.mark.parametrize("name", RESULTS)
def test_every_claim_is_proved(name):
    found = rl.verify(RESULTS[name]())
    assert found.proved, found.summary()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("stability", lambda r: replace(r, system=(6.0 * LATE).feedback())),
        ("gain", lambda r: replace(r, upper=0.9999 * r.lower)),
        ("gain", lambda r: replace(r, system=(2.05 * LATE).feedback())),
        ("disk margin", lambda r: replace(r, simultaneous=smaller(r.simultaneous), channels={})),
        ("disk margins", lambda r: replace(r, simultaneous=smaller(r.simultaneous))),
        ("pca", lambda r: replace(r, models=(*r.models[:-1], UNITS[0]))),
        ("additive", lambda r: replace(r, fit=replace(r.fit, weight=0.9999 * r.fit.weight))),
    ],
)  # fmt: skip
def test_what_is_not_true_is_not_proved(name, change):
    assert not rl.verify(change(RESULTS[name]())).proved


def test_the_delay_margin_is_where_stability_ends():
    w = np.sqrt(15.0)  # 4 e^(-s tau) / (s + 1)
    margin = (np.pi - np.arctan(w)) / w
    below, above = (rl.robust_stability((4.0 * LAG @ rl.delay(t * margin)).feedback()) for t in (0.999, 1.001))
    assert rl.verify(below).proved
    assert above.stable is False
    assert claims_of(above) == []


@pytest.mark.parametrize("spread", [0.0, 0.1])
@pytest.mark.parametrize("order", [1, 3])
def test_a_weight_that_is_smaller_does_not_cover(order, spread):
    (claim,) = claims_of((LAG @ rl.delay(0.4)).uncertain(order, spread=spread))
    assert check(claim).outcome.value == "proved"
    smaller = {name: 0.998 * claim.numbers[name] for name in ("W_C", "W_D")}
    assert check(Claim(claim.kind, {**claim.numbers, **smaller})).outcome.value == "not proved"
    wider = {"range": claim.numbers["range"] + np.array([-2e-3, 2e-3])}
    assert check(Claim(claim.kind, {**claim.numbers, **wider})).outcome.value == "not proved"
