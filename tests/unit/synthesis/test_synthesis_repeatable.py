"""Designs do not depend on the machine's load: searches count their work, and report a time limit that ends one."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from characterisation.robust_designs import oscillator
from repeatable import same_under_load

import robustlab as rl
from robustlab import ComplexScalar, budget
from robustlab.budget import NOT_REPEATABLE
from robustlab.result import Status
from robustlab.statespace import StateSpaceModel

USED_UP = "work budget used up: a larger effort may find"
TESTS = f"import sys; sys.path.insert(0, {str(Path(__file__).parents[2])!r})\n"
# Six states, singular for the Riccati equations: no penalty on u, no noise on y.
PLANT = """
rng = np.random.default_rng(5)
n = 6
A = rng.standard_normal((n, n)) - 1.5 * np.eye(n)
P = rl.StateSpaceModel(A, rng.standard_normal((n, 4)), rng.standard_normal((4, n)), np.zeros((4, 4)))
"""


def plant() -> StateSpaceModel:
    """The same here."""
    place: dict[str, Any] = {"rl": rl, "np": np}
    exec(PLANT, place)
    model = place["P"]
    assert isinstance(model, StateSpaceModel)
    return model


class Clock:
    """A clock that is constant for a number of calls, and then beyond every limit."""

    def __init__(self, calls: float) -> None:
        self.calls = calls

    def monotonic(self) -> float:
        self.calls -= 1
        return 0.0 if self.calls >= 0 else 1e9


@pytest.mark.slow
def test_designs_whose_work_is_used_up_are_the_same_under_load() -> None:
    found = same_under_load(
        TESTS
        + PLANT
        + """
from characterisation.robust_designs import oscillator
loose = rl.hinf(P, 2, 2, effort=5e-4)
designs = {
    "hinf": loose,
    "h2": rl.h2(P, 2, 2, effort=5e-5),
    "mixsyn": rl.mixsyn(P.select(P.input_names[:1], P.output_names[:1]), 2.0, 0.1, effort=2e-4),
    "dk": rl.dk(oscillator(), [rl.RealScalar("k")], 1, 1, effort=0.0025),
    "fixed": rl.fixed_structure(P, 1, n_meas=2, n_con=2, starts=4, effort=0.005),
    "reduce": rl.reduce_controller(loose, loss=0.05, effort=0.002),
}
for name, design in designs.items():
    print(name, design.status, digest(design.K, design.gamma, design.reason), design.reason)
"""
    )
    lines = found.splitlines()
    assert [line.split()[0] for line in lines] == ["hinf", "h2", "mixsyn", "dk", "fixed", "reduce"]
    assert [line.split()[0] for line in lines if USED_UP not in line] == []


def designs(time_limit: float) -> dict[str, Callable[[], Any]]:
    """Return one design by each method, as functions."""
    P, K = plant(), rl.hinf(plant(), 2, 2)
    limit: dict[str, Any] = {"time_limit": time_limit}
    dk = oscillator()
    return {
        "hinf": lambda: rl.hinf(P, 2, 2, **limit),
        "h2": lambda: rl.h2(P, 2, 2, **limit),
        "dk": lambda: rl.dk(dk, [ComplexScalar("k")], 1, 1, **limit),
        "fixed": lambda: rl.fixed_structure(P, "static", n_meas=2, n_con=2, starts=20, **limit),
        "reduce": lambda: rl.reduce_controller(K, loss=0.05, **limit),
        "discretise": lambda: rl.discretise(K, 0.01, plant=P, **limit),
    }  # fmt: skip


@pytest.mark.parametrize(
    ("name", "calls"),
    [("hinf", 60), ("h2", 2), ("dk", 100), ("fixed", 300), ("reduce", 20), ("discretise", 3)],
)
def test_a_time_limit_that_ends_the_search_is_reported(name: str, calls: int, monkeypatch: pytest.MonkeyPatch) -> None:
    make = designs(1.0)[name]
    monkeypatch.setattr(budget, "time", Clock(calls))
    found = make()
    assert found.status is Status.TIMEOUT
    assert NOT_REPEATABLE in found.reason
    assert ("how", found.reason) in found.facts()
