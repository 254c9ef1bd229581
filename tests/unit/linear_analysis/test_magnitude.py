"""Models of extreme magnitude: the right number, or an error about the model under the name of the function called."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import robustlab as rl
from robustlab.norms import h2_norm

Model = rl.StateSpaceModel
EXTREME = (5e-324, 1e-310, 1e150, 1e300)


def plant(dt: float, name: str, size: float, whole: bool) -> Model:
    """Two stable states of order one, with one entry of A, B, C or D, or all of that matrix, of another size."""
    parts = {
        "A": [[0.5, 0.2], [-0.2, 0.3]] if dt else [[-1.0, 0.5], [-0.5, -2.0]],
        "B": [[1.0], [0.5]],
        "C": [[1.0, -0.5]],
        "D": [[0.25]],
    }
    parts = {key: np.array(value) for key, value in parts.items()}
    if whole:
        parts[name] = parts[name] * size
    else:
        parts[name][0, 0] = np.copysign(size, parts[name][0, 0])
    return Model(*parts.values(), dt)


ALL = [(dt, name, size, whole) for dt in (0.0, 0.1) for name in "ABCD" for size in EXTREME for whole in (False, True)]
SOME = [(0.0, "A", 1e-310, True), (0.0, "B", 1e150, False), (0.1, "C", 5e-324, True), (0.1, "D", 1e300, True)]


def uncertain(m: Model, block: Any) -> rl.UncertainModel:
    """The block, driven by the output, changes a tenth of the input and of the direct term."""
    B, C = np.hstack([0.1 * m.B, m.B]), np.vstack([m.C, m.C])
    return rl.UncertainModel(Model(m.A, B, C, np.tile([[0.1, 1.0]], (2, 1)) * m.D, m.dt), [block])


def generalised(m: Model) -> Model:
    """w1 at the input, w2 at the measurement; z is the output and the control."""
    zero = np.zeros_like(m.B)
    D = np.array([[0, 0, 0], [0, 0, 1], [0, 1, m.D[0, 0]]])
    return Model(m.A, np.hstack([m.B, zero, m.B]), np.vstack([m.C, 0 * m.C, m.C]), D, m.dt)


K = Model([], [], [], [[0.1]])


def real(m: Model) -> rl.UncertainModel:
    return uncertain(m, rl.RealScalar("k"))


def simulated(m: Model) -> rl.Record:
    t = (m.dt or 0.1) * np.arange(11)
    return rl.simulate(m, t, np.ones((11, 1)))


# The call, the name in its errors, and whether it is quick enough for all models.
CALLS: dict[str, tuple[Callable[[Model], Any], str, bool]] = {
    "peak_gain": (rl.peak_gain, "peak_gain", True),
    "h2_norm": (h2_norm, "h2_norm", True),
    "h2": (lambda m: rl.h2(generalised(m), 1, 1), "synth h2", True),
    "hinf": (lambda m: rl.hinf(generalised(m), 1, 1, effort=0.05), "synth hinf", False),
    "dk": (lambda m: rl.dk(generalised(m), [rl.FullBlock("k", 1, 1)], 1, 1, effort=0.05), "synth dk", False),
    "mixsyn": (lambda m: rl.mixsyn(m, W1=0.5, W2=0.1, effort=0.05), "synth mixsyn", False),
    "ncf": (rl.ncf, "synth ncf", True),
    "mu": (lambda m: rl.mu(rl.frequency_response(m, [1.0])[0], [rl.RealScalar("k")]), "", False),
    "robust_stability": (lambda m: rl.robust_stability(real(m)), "robust_stability", False),
    "robust_performance": (lambda m: rl.robust_performance(real(m)), "robust_performance", False),
    "worst_case_gain": (lambda m: rl.peak_gain(real(m)), "peak_gain", False),
    "worst_case": (lambda m: rl.worst_case(real(m), "hinf"), "worst_case", False),
    "disk_margin": (lambda m: rl.disk_margin(m, K), "disk_margin", True),
    "nu_gap": (lambda m: rl.nu_gap(m, Model(m.A, m.B, 1.1 * m.C, m.D, m.dt)), "nu_gap", True),
    "coprime_margin": (lambda m: rl.coprime_margin(m, K), "coprime_margin", True),
    "controllability": (rl.controllability, "controllability", True),
    "observability": (rl.observability, "observability", True),
    "frequency_response": (lambda m: rl.frequency_response(m, [0.0, 1.0]), "frequency_response", True),
    "truncated": (lambda m: rl.reduce_model(m, 1), "reduce_model", True),
    "reduce_model": (lambda m: rl.reduce_model(m, 1, method="residualisation"), "reduce_model", True),
    "simulate": (simulated, "simul", True),
    "discretise": (lambda m: m if m.dt else rl.discretise(m, 0.1), "discretise", True),
    "elementwise": (lambda m: rl.elementwise(m, Model(1.1 * m.A, m.B, m.C, m.D, m.dt)), "elementwise", True),
}
CASES = [(name, case) for name, (_, _, quick) in CALLS.items() for case in (ALL if quick else SOME)]


@pytest.mark.slow
def test_each_call_returns_a_result_or_an_error_that_names_the_call_and_no_nan_in_finite_input():
    wrong = []
    for name, case in CASES:
        call, where, _ = CALLS[name]
        try:
            call(plant(*case))
        except rl.RobustlabError as error:
            text = str(error)
            if not error.where.startswith(where) or any(word in text for word in ("NaN", "infs", " is infinite (")):
                wrong.append(f"{name} {case}: {text}")
        except Exception as error:  # noqa: BLE001 - a bare LinAlgError, ValueError, RuntimeWarning, ...
            wrong.append(f"{name} {case}: {type(error).__name__}: {error}")
    assert not wrong, "\n".join(wrong)


# --- against exact arithmetic ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("b1", [1.0, 1e10, 1e50])
def test_hinf_of_any_disturbance_gain(b1):
    """P12 = s/(s - 1) has a zero at 0, so that no gain is below |P11(0)| = b1; K = -1 - eps comes close to it."""
    design = rl.hinf(Model([[1.0]], [[b1, 1]], [[1], [1]], [[0, 1], [1, 0]]), 1, 1)
    assert design.status is rl.Status.CERTIFIED
    assert b1 * (1 - 1e-9) <= design.gamma <= 1.05 * b1


def test_h2_where_the_control_acts_1e20_times_weaker_than_the_disturbance():
    """D12, D21 are square: A - B2 C1 and A - B1 C2 are unstable, X = 2 (a - b)/b^2, Y = 2 (a - 1), F = -(b X + 1)."""
    a, b = 1e10, 1e-10
    X, Y = 2 * (a - b) / b**2, 2 * (a - 1)
    design = rl.h2(Model([[a]], [[1, b]], [[1], [1]], [[0, 1], [1, 0]]), 1, 1)
    assert design.gamma == pytest.approx(np.sqrt(X + (b * X + 1) ** 2 * Y), rel=1e-8)


@pytest.mark.parametrize("b", [1e-200, 1e300])
@pytest.mark.parametrize("call", [rl.peak_gain, rl.h2_norm, lambda m: rl.reduce_model(m, 0)])
def test_models_beyond_all_units_are_refused(call, b):
    with pytest.raises(rl.NoTrustworthyNumber, match=r"between 1e-100 and 1e100(.|\n)*other units"):
        call(Model([[-1.0]], [[b]], [[1.0]], [[0.0]]))
