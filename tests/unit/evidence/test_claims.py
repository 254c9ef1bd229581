"""The checker proves the claims of results, and does not prove them for wrong numbers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import robustlab as rl
from robustlab.errors import InputError
from robustlab.evidence import claims_of
from robustlab.operations import elementwise

SPRING = rl.parametric(
    [[0, 1], ["-k/m", "-c/m"]], [[0], ["1/m"]], [[1, 0]], [[0]],
    {"m": (3.0, 0.2), "c": (1.0, 0.7, 1.1), "k": (2.0, 0.3)},
)  # fmt: skip
EVEN = rl.parametric(
    [[0, 1], ["-k/m", "-c/m"]], [[0], ["1/m"]], [[1, 0]], [[0]], {"m": (3.0, 0.2), "c": (1.0, 0.2), "k": (2.0, 0.3)}
)
INTEGRAL = rl.StateSpaceModel([[0.0]], [[1.0]], [[0.2]], [[0.0]])
OSCILLATOR = rl.tf([1.0], [1.0, 1.0, 1.0])
WEIGHT = rl.makeweight(100, (1, 1), 0.5)


def rows(seed: int, n: int) -> rl.StateSpaceModel:
    rng = np.random.default_rng(seed)
    A = np.diag(-np.arange(1.0, n + 1)) + 0.1 * rng.standard_normal((n, n))
    return rl.StateSpaceModel(A, rng.standard_normal((n, 2)), rng.standard_normal((2, n)), np.zeros((2, 2)))


def regulated() -> rl.StateSpaceModel:
    A, B = [[-1.0, 0.2], [0.1, 0.5]], [[1, 0, 0.2], [0.5, 0, 1.0]]
    return rl.StateSpaceModel(A, B, [[1, 0], [0, 0], [0, 1]], [[0, 0, 0], [0, 0, 1.0], [0, 0.3, 0]])


SCHEDULED = rl.LPVModel(
    {"a": [1.0, 4.0]}, [rl.StateSpaceModel([[-a]], [[a]], [[1.0]], [[0.0]]) for a in (1.0, 4.0)], rates={"a": 1.0}
)
RESULTS = {
    "margin": lambda: rl.robust_stability(EVEN.feedback(INTEGRAL)),
    "margin of uneven ranges": lambda: rl.robust_stability(SPRING.feedback(INTEGRAL)),
    "margin without blocks": lambda: rl.robust_stability(rl.UncertainModel(OSCILLATOR, ())),
    "worst-case gain": lambda: rl.peak_gain(EVEN.feedback(INTEGRAL)),
    "worst-case gain of uneven ranges": lambda: rl.peak_gain(SPRING.feedback(INTEGRAL)),
    "robust performance": lambda: rl.robust_performance(EVEN.feedback(INTEGRAL)),
    "norm": lambda: rl.peak_gain(OSCILLATOR),
    "norm of a gain": lambda: rl.peak_gain(rl.ss([[2.0, 1.0], [0.0, 1.0]])),
    "norm of a discrete model": lambda: rl.peak_gain(rl.tf([1.0], [1.0, -0.9], dt=0.1)),
    "peak of an unstable model": lambda: rl.peak_gain(rl.tf([6.0], [1.0, -2.0]), norm="linf"),
    "peak in a band": lambda: rl.peak_gain(OSCILLATOR, band=(0.1, 0.5)),
    "H2 norm": lambda: rl.h2_norm(rows(0, 4)),
    "mu": lambda: rl.mu([[0.5, 1.0 + 1j], [1.0, 0.2j]], [[-1, 0], [1, 0]]),
    "mu of several": lambda: rl.mu(np.ones((2, 2, 3)) * np.array([1.0, 2.0])[:, None, None], [[-1, 0], [2, 1]]),
    "skewed mu": lambda: rl.mu([[0.5, 1.0], [1.0, 0.0]], [[1, 0], [1, 0]], fixed=["delta1"]),
    "disk margins": lambda: rl.disk_margin(OSCILLATOR, INTEGRAL),
    "disk margins of two loops": lambda: rl.disk_margin(rows(1, 3)),
    "mixsyn": lambda: rl.mixsyn(OSCILLATOR, WEIGHT, 0.1, None),
    "ncf": lambda: rl.ncf(OSCILLATOR),
    "h2": lambda: rl.h2(regulated(), 1, 1),
    "reduced model": lambda: rl.reduce_model(rows(2, 6), 3),
    "gain with a law": lambda: rl.peak_gain(EVEN, natures={"k": rl.Varying(0.1)}, order=1),
    "margin of parameters that vary": lambda: rl.robust_stability(EVEN, natures={"k": rl.Varying(), "m": rl.Varying()}),
    "gain of a scheduled model": lambda: rl.peak_gain(SCHEDULED),
    "elementwise": lambda: elementwise(
        rl.StateSpaceModel([[-1.0, 0.2], [0.1, -0.5]], [[1.0], [0.5]], [[1, 0]], [[0]]),
        rl.StateSpaceModel([[-1.1, 0.7], [-0.1, -0.7]], [[1.2], [0.5]], [[1, 0]], [[0.3]]),
    ).result,
}  # fmt: skip


@pytest.mark.parametrize("name", RESULTS)
def test_every_claim_of_a_result_is_proved(name):
    found = rl.verify(RESULTS[name]())
    assert found.proved, found.summary()
    assert not found.refuted
    assert found.boxes >= len(found.claims) >= 1


def test_branch_and_bound_keeps_its_proof():
    chain = _boxed()
    assert chain.boxes
    found = rl.verify(chain)
    assert found.proved, found.summary()
    less = replace(chain, boxes=chain.boxes[1:])
    assert not rl.verify(less).proved


def _boxed() -> rl.RobustlabError:
    rng = np.random.default_rng(9)
    for _ in range(40):
        A = np.diag([-1.0, -1.0, -0.3, -0.3]) + np.array(
            [[0, 2.0, 0, 0], [-2.0, 0, 0, 0], [0, 0, 0, 5.0], [0, 0, -5.0, 0]]
        )
        B, C = rng.standard_normal((4, 4)), rng.standard_normal((4, 4))
        M = rl.StateSpaceModel(A, B, C, np.zeros((4, 4)))
        found = rl.robust_stability(rl.UncertainModel(M, [rl.RealScalar(f"d{i}") for i in range(4)]), tolerance=0.003)
        if found.boxes:
            return found
    raise AssertionError("none of these needed boxes")


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("norm", lambda r: replace(r, upper=0.999 * r.lower)),
        ("margin", lambda r: replace(r, lower=1.01 * r.upper)),
        ("margin of uneven ranges", lambda r: replace(r, lower=1.01 * r.upper)),
        ("worst-case gain", lambda r: replace(r, upper=0.99 * r.lower)),
        ("H2 norm", lambda r: replace(r, value=0.99 * r.value)),
        ("mixsyn", lambda r: replace(r, gamma=0.99 * r.gamma)),
        ("mixsyn", lambda r: replace(r, K=-1.0 * r.K)),
        ("h2", lambda r: replace(r, gamma=0.99 * r.gamma)),
    ],
)
def test_false_claims_are_not_proved(name, change):
    found = rl.verify(change(RESULTS[name]()))
    assert not found.proved


def test_a_wrong_sign_is_refuted_with_its_pole():
    design = RESULTS["mixsyn"]()
    turned = replace(design, K=design.K.renamed(design.K.inputs), plant=design.plant)
    wrong = replace(turned, K=rl.StateSpaceModel(turned.K.A, turned.K.B, -1e3 * turned.K.C, -1e3 * turned.K.D))
    found = rl.verify(wrong)
    assert found.refuted
    assert not found.proved


def test_a_result_without_claims_is_rejected():
    with pytest.raises(InputError, match="without claims"):
        rl.verify(rl.zeros(OSCILLATOR))
    assert claims_of(rl.peak_gain(rl.tf([1.0], [1.0, -1.0]))) == []


def test_effort_ends_a_check():
    found = rl.verify(RESULTS["worst-case gain"](), effort=1e-4)
    assert not found.proved
    assert "effort" in found.claims[0].where
