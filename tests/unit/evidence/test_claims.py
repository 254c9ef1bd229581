"""The checker proves the claims of results, and does not prove them for wrong numbers."""

from dataclasses import replace

import h5py
import numpy as np
import pytest
from lqg import lqg

import robustlab as rl
from robustlab.cli import main_guard, run_command
from robustlab.errors import InputError
from robustlab.evidence import claims_of
from robustlab.operations import elementwise
from robustlab.synthesis import MarginGoal, TrackingGoal, VarianceGoal
from robustlab.verification import Claim, check

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
LAG = rl.StateSpaceModel([[-1.0]], [[1.0]], [[1.0]], [[0.0]])
SAMPLED = rl.StateSpaceModel([[0.5]], [[1.0]], [[1.0]], [[0.0]], 0.1)
UNSTABLE = rl.StateSpaceModel([[1.0, 0.2], [0.0, -2.0]], [[1.0], [1.0]], [[1.0, 0.5]], [[0.0]])
SHAPE = rl.tf([3.0, 3.0], [1.0, 0.0])
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


def rows(seed: int, n: int) -> rl.StateSpaceModel:
    rng = np.random.default_rng(seed)
    A = np.diag(-np.arange(1.0, n + 1)) + 0.1 * rng.standard_normal((n, n))
    return rl.StateSpaceModel(A, rng.standard_normal((n, 2)), rng.standard_normal((2, n)), np.zeros((2, 2)))


def regulated() -> rl.StateSpaceModel:
    A, B = [[-1.0, 0.2], [0.1, 0.5]], [[1, 0, 0.2], [0.5, 0, 1.0]]
    return rl.StateSpaceModel(A, B, [[1, 0], [0, 0], [0, 1]], [[0, 0, 0], [0, 0, 1.0], [0, 0.3, 0]])


def with_mode(G: rl.StateSpaceModel, pole: float) -> rl.StateSpaceModel:
    """Add an uncoupled mode."""
    A = np.block([[G.A, np.zeros((6, 1))], [np.zeros((1, 6)), np.array([[pole]])]])
    return rl.StateSpaceModel(A, np.vstack([G.B, [[0.3, 0.2]]]), np.hstack([G.C, [[0.4], [0.1]]]), G.D)


def two_plants() -> list[rl.StateSpaceModel]:
    return [LAG, rl.StateSpaceModel([[-1.2]], [[1.0]], [[1.0]], [[0.0]])]


def pair():
    late = rl.StateSpaceModel(-np.diag([1.0, 2.0]), [[1, 0.3], [-0.2, 1]], np.eye(2), np.zeros((2, 2)))
    return rl.with_delays(late, inputs={0: 0.3, 1: 0.1}), rl.StateSpaceModel([], [], [], 2.0 * np.eye(2))


def smaller(margin):
    return replace(margin, lower=1.0001 * margin.upper)


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
    "gain with a law": lambda: rl.peak_gain(EVEN, block_types={"k": rl.Varying(0.1)}, order=1),
    "margin of parameters that vary": lambda: rl.robust_stability(
        EVEN, block_types={"k": rl.Varying(), "m": rl.Varying()}
    ),
    "gain of a scheduled model": lambda: rl.peak_gain(SCHEDULED),
    "elementwise": lambda: elementwise(
        rl.StateSpaceModel([[-1.0, 0.2], [0.1, -0.5]], [[1.0], [0.5]], [[1, 0]], [[0]]),
        rl.StateSpaceModel([[-1.1, 0.7], [-0.1, -0.7]], [[1.2], [0.5]], [[1, 0]], [[0.3]]),
    ).result,
    "lqg": lambda: lqg(UNSTABLE, SQUARE, [[1.0]], SQUARE, [[0.1]]),
    "lqg discrete": lambda: lqg(SAMPLED, [[1.0]], [[1.0]], [[1.0]], [[1.0]]),
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
    "reduced between weights": lambda: rl.reduce_model(rows(2, 6), 3, input_weight=INTO, output_weight=OUT),
    "reduced before a weight": lambda: rl.reduce_model(rows(2, 6), 3, output_weight=OUT),
    "unstable, reduced": lambda: rl.reduce_model(with_mode(rows(2, 6), 0.5), 4),
    "delayed stability": lambda: rl.robust_stability((2.0 * LATE).feedback()),
    "delayed stability of an open loop": lambda: rl.robust_stability(LATE),
    "delayed gain": lambda: rl.peak_gain((2.0 * LATE).feedback()),
    "delayed disk margin": lambda: rl.disk_margin(2.0 * LATE),
    "delayed disk margins": lambda: rl.disk_margin(*pair()),
    "set": lambda: (2.0 * LATE).feedback().uncertain(4),
    "range": lambda: RANGE,
    "delayed margin": lambda: rl.robust_stability(RANGE.feedback()),
    "delayed worst-case gain": lambda: rl.peak_gain(RANGE.feedback()),
    "elements": lambda: rl.cover(UNITS, "elements", gain=False),
    "elements about one": lambda: rl.cover(UNITS, "elements", nominal=UNITS[0], gain=False),
    "pca": lambda: rl.cover(UNITS, "pca", gain=False),
    "additive": lambda: rl.cover(UNITS, "additive", gain=False),
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
        ("lqg", lambda r: replace(r, gamma=0.99 * r.gamma)),
        ("lqg", lambda r: replace(r, K=-1.0 * r.K)),
        ("ncf with weights", lambda r: replace(r, gamma=0.99 * r.gamma)),
        ("ncf with weights", lambda r: replace(r, K=-1.0 * r.K)),
        ("tuned", lambda r: replace(r, goals=(replace(r.goals[0], values=(0.9 * r.goals[0].value,)), *r.goals[1:]))),
        ("fixed for two plants", lambda r: replace(r, gammas=(r.gammas[0], 0.9 * r.gammas[1]))),
        ("reduced controller", lambda r: replace(r, K=-1.0 * r.K)),
        ("one full block", lambda r: replace(r, lower=1.001 * r.upper)),
        ("coprime margin", lambda r: replace(r, lower=1.001 * r.upper)),
        ("reduced between weights", lambda r: replace(r, weights=(1.01 * r.weights[0], r.weights[1]))),
        (
            "unstable, reduced",
            lambda r: replace(r, judge=lambda: r.evidence._replace(error=replace(r.error, upper=0.99 * r.error.lower))),
        ),
        *(
            pytest.param(name, change, marks=pytest.mark.slow)
            for name, change in (
                ("delayed stability", lambda r: replace(r, system=(6.0 * LATE).feedback())),
                ("delayed gain", lambda r: replace(r, upper=0.9999 * r.lower)),
                ("delayed gain", lambda r: replace(r, system=(2.05 * LATE).feedback())),
                ("delayed disk margin", lambda r: replace(r, simultaneous=smaller(r.simultaneous), channels={})),
                ("delayed disk margins", lambda r: replace(r, simultaneous=smaller(r.simultaneous))),
                ("pca", lambda r: replace(r, models=(*r.models[:-1], UNITS[0]))),
                ("additive", lambda r: replace(r, fit=replace(r.fit, weight=0.9999 * r.fit.weight))),
            )
        ),
    ],
)
def test_false_claims_are_not_proved(name, change):
    found = rl.verify(change(RESULTS[name]()))
    assert not found.proved, found.summary()


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
    G, found = rows(2, 6), RESULTS["reduced between weights"]()
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
    for name in ("ncf with weights", "lqg"):
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
    design = RESULTS["lqg"]()
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
@pytest.mark.parametrize("order", [1, 3, 8])
def test_a_smaller_weight_does_not_cover(order, spread):
    (claim,) = claims_of(rl.with_delays(INTO, inputs={0: (0.4 - spread, 0.4 + spread)}, order=order))
    assert check(claim).outcome.value == "proved"
    smaller = {name: 0.998 * claim.numbers[name] for name in ("W_C", "W_D")}
    assert check(Claim(claim.kind, {**claim.numbers, **smaller})).outcome.value == "not proved"
    wider = {"range": claim.numbers["range"] + np.array([-2e-3, 2e-3])}
    assert check(Claim(claim.kind, {**claim.numbers, **wider})).outcome.value == "not proved"
