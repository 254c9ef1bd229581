"""Claims about loops, delays and models: the certified loop is the intended one, by dense search in numpy."""

from __future__ import annotations

from dataclasses import replace

import h5py
import numpy as np
import pytest
from lqg import lqg

import robustlab as rl
from robustlab.cli import main_guard, run_command
from robustlab.errors import InputError
from robustlab.evidence import claims_of
from robustlab.synthesis import MarginGoal, TrackingGoal, VarianceGoal
from robustlab.verification import Claim, check

LAG = rl.StateSpaceModel([[-1.0]], [[1.0]], [[1.0]], [[0.0]])
SAMPLED = rl.StateSpaceModel([[0.5]], [[1.0]], [[1.0]], [[0.0]], 0.1)
OSCILLATOR = rl.tf([1.0], [1.0, 1.0, 1.0])
UNSTABLE = rl.StateSpaceModel([[1.0, 0.2], [0.0, -2.0]], [[1.0], [1.0]], [[1.0, 0.5]], [[0.0]])
SHAPE = rl.tf([3.0, 3.0], [1.0, 0.0])
WEIGHT = rl.makeweight(100, (1, 1), 0.5)
INTO, OUT = rl.tf([1.0], [1.0, 1.0]), rl.tf([2.0, 1.0], [1.0, 3.0])
NOISY = rl.StateSpaceModel(
    [[0.0]], [[1.0, 0.0, 1.0]], [[1.0], [0.0], [1.0]], [[0, 0, 0], [0, 0, 1], [0, 1, 0]],
    inputs=["d", "n", "u"], outputs=["x", "effort", "y"],
)  # fmt: skip
LATE = rl.with_delays(INTO, inputs={0: 0.3}, outputs={0: 0.1})
MOTORS = rl.parametric([["-1/T"]], [["k/T"]], [[1]], [[0]], {"k": (2.0, 0.1), "T": (1.0, 0.2)})
RANGE = rl.with_delays(MOTORS, inputs={"u1": (0.2, 0.4)})
UNITS = [
    rl.StateSpaceModel([[-1 / t]], [[g / t]], [[1.0]], [[0.0]])
    for g, t in ((1.0, 1.0), (1.2, 1.3), (0.9, 0.8), (1.1, 0.7))
]
SQUARE, GRID = np.eye(2), np.concatenate([[0.0], np.geomspace(1e-4, 1e4, 4001)])


def six() -> rl.StateSpaceModel:
    rng = np.random.default_rng(2)
    A = np.diag(-np.arange(1.0, 7)) + 0.1 * rng.standard_normal((6, 6))
    return rl.StateSpaceModel(A, rng.standard_normal((6, 2)), rng.standard_normal((2, 6)), np.zeros((2, 2)))


def with_mode(G: rl.StateSpaceModel, pole: float) -> rl.StateSpaceModel:
    """Add an uncoupled mode."""
    A = np.block([[G.A, np.zeros((6, 1))], [np.zeros((1, 6)), np.array([[pole]])]])
    return rl.StateSpaceModel(A, np.vstack([G.B, [[0.3, 0.2]]]), np.hstack([G.C, [[0.4], [0.1]]]), G.D)


def regulated() -> rl.StateSpaceModel:
    A, B = [[-1.0, 0.2], [0.1, 0.5]], [[1, 0, 0.2], [0.5, 0, 1.0]]
    return rl.StateSpaceModel(A, B, [[1, 0], [0, 0], [0, 1]], [[0, 0, 0], [0, 0, 1.0], [0, 0.3, 0]])


def two_plants() -> list[rl.StateSpaceModel]:
    return [LAG, rl.StateSpaceModel([[-1.2]], [[1.0]], [[1.0]], [[0.0]])]


def pair():
    late = rl.StateSpaceModel(-np.diag([1.0, 2.0]), [[1, 0.3], [-0.2, 1]], np.eye(2), np.zeros((2, 2)))
    return rl.with_delays(late, inputs={0: 0.3, 1: 0.1}), rl.StateSpaceModel([], [], [], 2.0 * np.eye(2))


def smaller(margin):
    return replace(margin, lower=1.0001 * margin.upper)


RESULTS = {
    "h2": lambda: lqg(UNSTABLE, SQUARE, [[1.0]], SQUARE, [[0.1]]),
    "h2 discrete": lambda: lqg(SAMPLED, [[1.0]], [[1.0]], [[1.0]], [[1.0]]),
    "ncf with weights": lambda: rl.ncf(OSCILLATOR, SHAPE, 2.0),
    "ncf discrete": lambda: rl.ncf(SAMPLED, 5.0),
    "tuned": lambda: rl.tune(LAG, "pi", [TrackingGoal(1.0), VarianceGoal(9.0), MarginGoal(1.0, hard=True)], starts=1),
    "tuned for two plants": lambda: rl.tune(two_plants(), "pi", [TrackingGoal(1.0)], starts=1),
    "fixed for two plants": lambda: rl.fixed_structure([NOISY, 1.1 * NOISY], "pi", n_meas=1, n_con=1, starts=1),
    "reduced controller": lambda: rl.reduce_controller(rl.mixsyn(OSCILLATOR, WEIGHT, 0.1, None), loss=0.1),
    "reduced H2 controller": lambda: rl.reduce_controller(rl.h2(regulated(), 1, 1), loss=0.2),
    "one full block": lambda: rl.robust_stability(
        rl.unstructured(LAG, 0.5, "input-multiplicative").feedback(rl.ss([[3.0]]))
    ),
    "coprime margin": lambda: rl.coprime_margin(UNSTABLE, rl.ss([[3.0]]), sign=-1),
    "coprime margin, positive": lambda: rl.coprime_margin(UNSTABLE, rl.ss([[-3.0]]), sign=1),
    "coprime margin, discrete": lambda: rl.coprime_margin(SAMPLED, rl.ss([[0.3]], dt=0.1), sign=-1),
    "reduced between weights": lambda: rl.reduce_model(six(), 3, input_weight=INTO, output_weight=OUT),
    "reduced before a weight": lambda: rl.reduce_model(six(), 3, output_weight=OUT),
    "unstable, reduced": lambda: rl.reduce_model(with_mode(six(), 0.5), 4),
    "relative error": lambda: rl.reduce_model(rl.tf([1.0, 3.0, 2.0], [1.0, 2.0, 5.0]), 1, method="stochastic"),
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
    assert len(found.claims) >= 1


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("h2", lambda r: replace(r, gamma=0.99 * r.gamma)),
        ("h2", lambda r: replace(r, K=-1.0 * r.K)),
        ("ncf with weights", lambda r: replace(r, gamma=0.99 * r.gamma)),
        ("ncf with weights", lambda r: replace(r, K=-1.0 * r.K)),
        ("tuned", lambda r: replace(r, goals=(replace(r.goals[0], values=(0.9 * r.goals[0].value,)), *r.goals[1:]))),
        ("fixed for two plants", lambda r: replace(r, gammas=(r.gammas[0], 0.9 * r.gammas[1]))),
        ("reduced controller", lambda r: replace(r, K=-1.0 * r.K)),
        ("one full block", lambda r: replace(r, lower=1.001 * r.upper)),
        ("coprime margin", lambda r: replace(r, lower=1.001 * r.upper)),
        ("reduced between weights", lambda r: replace(r, weights=(1.01 * r.weights[0], r.weights[1]))),
        ("unstable, reduced", lambda r: replace(r, error=replace(r.error, upper=0.99 * r.error.lower))),
        *(
            pytest.param(name, change, marks=pytest.mark.slow)
            for name, change in (
                ("stability", lambda r: replace(r, system=(6.0 * LATE).feedback())),
                ("gain", lambda r: replace(r, upper=0.9999 * r.lower)),
                ("gain", lambda r: replace(r, system=(2.05 * LATE).feedback())),
                ("disk margin", lambda r: replace(r, simultaneous=smaller(r.simultaneous), channels={})),
                ("disk margins", lambda r: replace(r, simultaneous=smaller(r.simultaneous))),
                ("pca", lambda r: replace(r, models=(*r.models[:-1], UNITS[0]))),
                ("additive", lambda r: replace(r, fit=replace(r.fit, weight=0.9999 * r.fit.weight))),
            )
        ),
    ],
)
def test_false_claims_are_not_proved(name, change):
    found = rl.verify(change(RESULTS[name]()))
    assert not found.proved, found.summary()


def peak(gain, grid=GRID) -> float:
    """The largest singular value on the grid."""
    return max(float(np.linalg.norm(np.atleast_2d(gain(1j * w)), 2)) for w in grid)


def at(G: rl.StateSpaceModel, s: complex):
    return G.D + G.C @ np.linalg.solve(s * np.eye(G.n_states) - G.A, G.B)


def level(result, number: int = 0) -> float:
    """The claimed level."""
    numbers = claims_of(result)[number].numbers
    return float(numbers["gamma"] if "gamma" in numbers else numbers["level"])


def test_the_loop_of_a_coprime_margin_matches_its_definition():
    def four(s):  # [P; I] (I + C P)^-1 [-C, I] of negative feedback, C = 3
        P = at(UNSTABLE, s)[0, 0]
        return np.array([[P], [1.0]]) @ np.array([[-3.0, 1.0]]) / (1 + 3 * P)

    wanted = peak(four)
    for name in ("coprime margin", "coprime margin, positive"):
        assert level(RESULTS[name]()) == pytest.approx(wanted, rel=1e-5)


def test_errors_of_reduced_models_are_the_intended_differences():
    G, found = six(), RESULTS["reduced between weights"]()
    weighted = peak(lambda s: at(OUT, s)[0, 0] * (at(G, s) - at(found.model, s)) * at(INTO, s)[0, 0])
    assert level(found) == pytest.approx(weighted, rel=1e-4)


def cut() -> object:
    rng = np.random.default_rng(3)
    for _ in range(20):
        found = rl.mu(rng.standard_normal((4, 4)) + 1j * rng.standard_normal((4, 4)), [[-1, 0]] * 4, tolerance=1e-3)
        if found.boxes:
            return found
    raise AssertionError("none of these needed boxes")


def test_a_bound_after_branch_and_bound_is_proved_box_by_box():
    found = cut()
    checked = rl.verify(found)
    assert checked.proved, checked.summary()
    assert [claim.kind for claim in claims_of(found)] == ["mu-upper-boxes", "mu-lower"]
    assert checked.claims[0].bound == pytest.approx(1 / found.upper, rel=2e-6)
    assert found.upper < found.scaled
    (boxes,) = found.proof
    assert not rl.verify(replace(found, proof=(boxes[1:],))).proved
    assert not rl.verify(replace(found, upper=0.999 * found.lower)).proved
    several = rl.mu(np.stack([np.diag([1.0, 2.0]), np.ones((2, 2))]), [[-1, 0], [-1, 0]], tolerance=0.01)
    assert rl.verify(several).proved


def test_skewed_mu_of_real_blocks_that_vary():
    rng = np.random.default_rng(0)
    M = (rng.standard_normal((4, 4)) + 1j * rng.standard_normal((4, 4))) / 2
    for fixed in ("delta2", "delta3"):
        found = rl.mu(M, [[-1, 0], [-2, 0], [1, 0]], fixed=[fixed])
        assert np.abs(found.G).max() > 0
        assert rl.verify(found).proved


# --- files of controllers --------------------------------------------------------------------------------------------


def call(*arguments: str) -> int:
    return main_guard(lambda: run_command(["verify", *arguments]))


def test_the_file_of_a_controller_carries_the_claims_of_its_design(tmp_path, capsys):
    for name in ("ncf with weights", "h2"):
        design, path = RESULTS[name](), tmp_path / "K.h5"
        rl.save(path, design.controller)
        assert call(str(path)) == 0
        assert "proved independently" in capsys.readouterr().out
        assert (rl.load(path).K.A == design.K.A).all()
    with h5py.File(path, "r+") as file:
        file["C"][...] = 1.001 * file["C"][()]
        del file.attrs["content_sha256"]
    assert call(str(path)) == 4
    assert "the controller is not the model of a claim that was proved" in capsys.readouterr().out


def test_another_controller_has_no_claims(tmp_path):
    design = RESULTS["h2"]()
    rl.save(tmp_path / "half.h5", replace(design.controller, K=0.5 * design.K, takes=None))
    with pytest.raises(InputError, match="without claims"):
        rl.verify(tmp_path / "half.h5")
    rl.save(tmp_path / "own.h5", rl.Controller(design.K))
    with pytest.raises(InputError, match="without claims"):
        rl.verify(tmp_path / "own.h5")


def test_the_delay_margin_is_the_limit_of_stability():
    w = np.sqrt(15.0)  # 4 e^(-s tau) / (s + 1)
    margin = (np.pi - np.arctan(w)) / w
    below, above = (rl.robust_stability((4.0 * INTO @ rl.delay(t * margin)).feedback()) for t in (0.999, 1.001))
    assert rl.verify(below).proved
    assert above.stable is False
    assert claims_of(above) == []


@pytest.mark.parametrize("spread", [0.0, 0.1])
@pytest.mark.parametrize("order", [1, 3])
def test_a_smaller_weight_does_not_cover(order, spread):
    (claim,) = claims_of((INTO @ rl.delay(0.4)).uncertain(order, spread=spread))
    assert check(claim).outcome.value == "proved"
    smaller = {name: 0.998 * claim.numbers[name] for name in ("W_C", "W_D")}
    assert check(Claim(claim.kind, {**claim.numbers, **smaller})).outcome.value == "not proved"
    wider = {"range": claim.numbers["range"] + np.array([-2e-3, 2e-3])}
    assert check(Claim(claim.kind, {**claim.numbers, **wider})).outcome.value == "not proved"
