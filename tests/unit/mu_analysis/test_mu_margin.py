"""Robust stability over the whole axis: published margins, closed forms, edges, refusals."""

import itertools

import numpy as np
import pytest
from mu_models import chain

import robustlab as rl
from robustlab.mu_analysis import replay
from robustlab.statespace import StateSpaceModel, series


def lag(radius: float, dt: float = 0.0) -> rl.UncertainModel:
    """x' = -(1 + radius delta) x + u (or x+ = 0.5 (1 + radius delta) x + u)."""
    a = 0.5 if dt else -1.0
    M = rl.StateSpaceModel([[a]], [[a * radius, 1.0]], [[1.0], [1.0]], np.zeros((2, 2)), dt)
    return rl.UncertainModel(M, [rl.RealScalar("pole", parameter=rl.ParameterRange(1.0, radius, "1/s"))])


@pytest.fixture(scope="module")
def two_mass() -> rl.UncertainModel:
    """m1, m2, k = 1 +- 20 %; u on m1, y = x2; C = 100 ((s + 1) / (0.001 s + 1))^3 (MathWorks' robstab example)."""
    A = np.array([[0, 1, 0, 0], [-1, 0, 1, 0], [0, 0, 0, 1], [1, 0, -1, 0.0]])
    B = np.array([[0, 0, 0, 0], [-0.2, 0, -0.2, 1], [0, 0, 0, 0], [0, -0.2, 0.2, 0]])
    C = np.array([A[1], A[3], [1, 0, -1, 0], [0, 0, 1, 0]])
    D = np.array([B[1], B[3], np.zeros(4), np.zeros(4)])
    lead = rl.StateSpaceModel([[-1000.0]], [[1.0]], [[-999000.0]], [[1000.0]])
    K = series(series(lead, lead), lead)
    K = rl.StateSpaceModel(K.A, K.B, -100 * K.C, -100 * K.D)
    blocks = [
        rl.RealScalar(name, parameter=rl.ParameterRange(1.0, 0.2, unit))
        for name, unit in (("m1", "kg"), ("m2", "kg"), ("k", "N/m"))
    ]
    return rl.UncertainModel(rl.StateSpaceModel(A, B, C, D), blocks).close(K)


@pytest.fixture(scope="module")
def two_mass_margin(two_mass):
    return rl.robust_stability(two_mass)


def test_two_mass_margin_as_published(two_mass_margin):
    margin = two_mass_margin
    assert margin.upper == pytest.approx(2.88636, abs=1e-5)
    assert margin.frequency == pytest.approx(575.03, abs=0.01)
    assert 0.997 * margin.upper <= margin.lower <= margin.upper
    assert margin.status is rl.Status.CERTIFIED


def test_two_mass_delta_destabilises(two_mass, two_mass_margin):
    margin = two_mass_margin
    assert max(abs(v) for v in margin.delta.values()) == pytest.approx(margin.upper)
    perturbed = two_mass.evaluate(margin.delta)
    assert perturbed.spectral_abscissa() >= -1e-6
    assert abs(perturbed.poles().imag[perturbed.poles().real.argmax()]) == pytest.approx(margin.frequency, rel=1e-6)
    assert margin.physical["m1"] == (pytest.approx(1 + 0.2 * margin.delta["m1"]), "kg")


def test_first_order_lag_crosses_at_zero():
    # pole -(1 + 0.2 delta): zero at delta = -5
    margin = rl.robust_stability(lag(0.2))
    assert margin.upper == pytest.approx(5.0, rel=1e-9)
    assert margin.lower == pytest.approx(5.0, rel=3e-3)
    assert margin.delta["pole"] == pytest.approx(-5.0, rel=1e-9)
    assert margin.frequency == pytest.approx(0.0, abs=1e-9)
    assert margin.physical["pole"] == (pytest.approx(0.0, abs=1e-9), "1/s")


def test_discrete_lag_on_the_unit_circle():
    # z = 0.5 (1 + 0.2 delta): 1 at delta = 5, -1 at delta = -15
    margin = rl.robust_stability(lag(0.2, dt=0.1))
    assert margin.upper == pytest.approx(5.0, rel=1e-9)
    assert margin.lower == pytest.approx(5.0, rel=3e-3)
    assert margin.pole == pytest.approx(1.0)
    assert max(high for _, high, _ in margin.intervals) == pytest.approx(np.pi / 0.1)


def test_static_model_is_judged_by_its_well_posedness():
    M = rl.StateSpaceModel(np.zeros((0, 0)), np.zeros((0, 2)), np.zeros((2, 0)), np.diag([0.5, -0.25]))
    margin = rl.robust_stability(rl.UncertainModel(M, [rl.RealScalar("a"), rl.RealScalar("b")]))
    assert margin.upper == pytest.approx(2.0)
    assert margin.lower == pytest.approx(2.0, rel=3e-3)


def test_no_uncertainty_in_the_loop_is_an_infinite_margin():
    none = rl.robust_stability(rl.UncertainModel(rl.StateSpaceModel([[-1.0]], [[1.0]], [[1.0]], [[0.0]]), []))
    assert none.notes == ("no uncertainty: mu = 0",)
    assert none.frequency is None
    # delta multiplies the input: it never enters the loop
    M = rl.StateSpaceModel([[-1.0]], [[1.0, 1.0]], [[0.0], [1.0]], [[0.0, 1.0], [0.0, 0.0]])
    for margin in (none, rl.robust_stability(rl.UncertainModel(M, [rl.RealScalar("gain")]))):
        assert margin.lower == margin.upper == np.inf
        assert margin.status is rl.Status.CERTIFIED


def test_no_time_means_no_proof(two_mass):
    margin = rl.robust_stability(two_mass, omega=[1.0, 575.0], time_limit=0.0)
    assert margin.status is rl.Status.TIMEOUT
    assert margin.lower == 0.0
    assert margin.open
    assert margin.upper == pytest.approx(2.88636, abs=1e-5)
    assert any("grid only" in text for text in margin.notes)
    assert margin.omega.tolist() == [1.0, 575.0]


@pytest.mark.parametrize("fast", [1e2, 1e4, 1e6, 1e8])
@pytest.mark.parametrize("kind", [rl.RealScalar, rl.ComplexScalar])
def test_slow_pole_next_to_a_fast_one(fast, kind):
    # 1 / (s + 1e-9) + fast / (s + fast): margin 1 / (1e9 + 1). Eigenvalues alone gave down to 0.2 % of that.
    root = np.sqrt(fast)
    model = rl.StateSpaceModel(np.diag([-1e-9, -fast]), [[1.0], [root]], [[1.0, root]], [[0.0]])
    margin = rl.robust_stability(rl.UncertainModel(model, [kind("a")]), omega=[0.0])
    assert margin.upper == pytest.approx(1e-9, rel=1e-6)
    assert margin.lower == pytest.approx(1e-9, rel=2e-3)
    assert margin.lower <= 1e-9


def lag_with_time_constant(below: float, above: float) -> rl.UncertainModel:
    """tau x' = u - x with tau = 1 - below .. 1 + above; x' is the input of the uncertain part."""
    M = rl.StateSpaceModel([[-1.0]], [[-above, 1.0]], [[-1.0], [1.0]], [[-above, 1.0], [0.0, 0.0]])
    block = rl.RealScalar("tau", parameter=rl.ParameterRange(1.0, above, "s", below=below))
    return rl.UncertainModel(M, [block])


def test_a_range_that_is_wider_above_gives_400_percent():
    """1 / (tau s + 1), tau in [0.75, 1.5]: stable down to tau = 0, four times as far below; 300 % by symmetrisation."""
    margin = rl.robust_stability(lag_with_time_constant(0.25, 0.5))
    assert margin.upper == pytest.approx(4.0, rel=1e-9)
    assert margin.lower == pytest.approx(4.0, rel=1e-4)
    assert margin.physical["tau"] == (pytest.approx(0.0, abs=1e-9), "s")
    assert margin.frequency == np.inf


# Two states, one parameter twice; exact: the first zero of trace or determinant of A + e B C, e < 0 over the low end.
TWICE = [
    (  # a light mode that the narrow side makes unstable
        [[-1.449989790171713e-05, 0.16372798532577287], [-0.16372798532577287, -1.449989790171713e-05]],
        [[0.09628780937229009, -0.13075685816967256], [-0.10424474760586645, -0.04965184358523118]],
        [[-0.23193237764418947, -0.8652130762749417], [3.3229995166448827, 0.22578661322792176]],
        (1.0801407858575864, 0.713038891440776), 0.00011626206083749199,
    ),
    (
        [[-0.0021032545944165673, 14.983835963449952], [-14.983835963449952, -0.0021032545944165673]],
        [[-1.852931999692906, 0.7339759587166985], [1.2791659645990787, -0.5063300186024869]],
        [[0.25093256908418204, -0.3943520554588936], [-0.8624048655156082, -2.032552427456725]],
        (0.13499211282442, 0.006997390749017209), 0.14156436752844953,
    ),
    (  # a real pole at the origin
        [[-0.025946149534273346, 0.4237026158694307], [-0.4237026158694307, -0.025946149534273346]],
        [[0.37754200455194664, 0.3685656303372992], [0.8241175330336409, -0.6137485763165128]],
        [[-1.3206632116051251, -0.10775250794802987], [0.9987636553170226, -0.02194788627038025]],
        (1.2104094994776688, 0.11501265682721992), 2.6202215045979576,
    ),
]  # fmt: skip


@pytest.mark.parametrize(("A", "B", "C", "widths", "exact"), TWICE)
def test_a_range_wider_on_one_side_has_its_exact_margin_in_little_work(A, B, C, widths, exact):
    block = rl.RealScalar("twice", 2, rl.ParameterRange(0.5, widths[0], "", widths[1]))
    margin = rl.robust_stability(rl.UncertainModel(rl.StateSpaceModel(A, B, C, np.zeros((2, 2))), [block]))
    assert margin.upper == pytest.approx(exact, rel=1e-9)
    assert 0.99 * exact <= margin.lower <= exact * (1 + 1e-9)
    assert len(margin.proof) < 500


def test_the_text_of_a_margin_below_one_begins_with_not_robust():
    first = rl.robust_stability(lag(2.0)).facts()[0]
    assert first == ("the set as stated", "not robust: the member at k = 0.5 is unstable")
    assert rl.robust_stability(lag(0.5)).headline() == "proved stable for every Delta of the set"


def test_intervals_of_an_asymmetric_set_carry_the_level_of_the_margin():
    """A margin of 0.8: mu reaches 1.25, and no interval may claim the 1 that holds inside the recentred box."""
    margin = rl.robust_stability(lag_with_time_constant(1.25, 0.5))
    assert margin.upper == pytest.approx(0.8, rel=1e-9)
    assert max(bound for _, _, bound in margin.intervals) == pytest.approx(1 / margin.lower)
    assert min(bound for _, _, bound in margin.intervals) >= 1.25


# --- physically impossible values ------------------------------------------------------------------------------------


def test_a_physically_impossible_critical_parameter_has_a_remark_that_is_saved(tmp_path):
    # J w' = Km i - Kf w, L i' = u - R i - Kb w: the slowest pole reaches 0 where Kf R + Km Kb = 0, at Kf < 0.
    plant = rl.plant("dc-motor", Kf=(4.8e-5, 0.35)).uncertain(outputs=["omega"])
    rl.save(tmp_path / "motor.h5", plant)
    for uncertain in (plant, rl.load(tmp_path / "motor.h5")):
        margin = rl.robust_stability(uncertain)
        assert margin.physical["Kf"][0] == pytest.approx(-(0.052**2) / 2.07, rel=1e-4)
        assert any("Kf = -0.00130" in note and "physically impossible" in note for note in margin.notes)
        assert uncertain.blocks[0].parameter.to_json()["sign"] == "nonnegative"


def light_modes(damping: float, seed: int) -> rl.UncertainModel:
    """M x'' + C x' + K x = 0 with M full, C and K diagonal, each 20 % uncertain: six modes close to each other."""
    rng = np.random.default_rng(seed)
    n, zero = 6, np.zeros((6, 6))
    k, root = 100 * rng.uniform(0.8, 1.2, n), np.eye(n) + 0.05 * rng.standard_normal((n, n))
    c = 20 * damping * rng.uniform(0.2, 1.0, n)
    inverse = np.linalg.inv(root @ root.T)
    A = np.block([[zero, np.eye(n)], [-inverse * k, -inverse * c]])
    B = np.vstack([np.zeros((n, 2 * n)), np.hstack([-inverse, -inverse])])
    C = np.block([[np.diag(0.2 * k), zero], [zero, np.diag(0.2 * c)]])
    blocks = [rl.RealScalar(f"{kind}{i}") for kind in "kc" for i in range(n)]
    return rl.UncertainModel(rl.StateSpaceModel(A, B, C, np.zeros((2 * n, 2 * n))), blocks)


@pytest.mark.slow
@pytest.mark.parametrize("damping", [0.002, 0.02])
def test_light_modes_are_stable_for_positive_stiffness(damping):
    """K and C positive definite: stable, by the energy. One of them singular: not. So the margin is 1 / 0.2 exactly."""
    margin = rl.robust_stability(light_modes(damping, 3))
    assert 5 * 0.999 <= margin.lower <= 5.00001
    assert margin.upper == pytest.approx(5, rel=1e-4)
    assert margin.status is rl.Status.CERTIFIED


def test_light_modes_between_resonances_are_bounded_at_their_mu():
    """With no damper left and some stiffness each frequency below the highest is a resonance: mu is 0.2 all along.

    M is nearly real there, and D of a stiffness goes to zero against G: the path to the optimum turns back on itself.
    """
    uncertain = light_modes(0.002, 3)
    omega = np.array([0.5, 2.0, 5.0, 8.0, 12.0, 13.0])
    bounds = rl.mu(rl.frequency_response(uncertain.delta_channels, omega), uncertain.blocks)
    assert (bounds.upper >= 0.2 * (1 - 1e-9)).all()
    assert (bounds.upper <= 0.2 * (1 + 5e-4)).all()


# --- branch and bound -------------------------------------------------------------------------------------------------


def model_with_a_gap(seed: int = 10, n: int = 6) -> rl.UncertainModel:
    """Random stable model, n states and n real parameters; for seed 10 the gap of D, G is 3.5 %."""
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((n, n)) / np.sqrt(n)
    A -= (np.linalg.eigvals(A).real.max() + 0.1 + 0.3 * rng.random()) * np.eye(n)
    B, C = rng.standard_normal((2, n, n)) / np.sqrt(n)
    D = 0.1 * rng.standard_normal((n, n))
    return rl.UncertainModel(rl.StateSpaceModel(A, B, C, D), [rl.RealScalar(f"d{i}") for i in range(n)])


@pytest.fixture(scope="module")
def uncertain() -> rl.UncertainModel:
    return model_with_a_gap()


@pytest.fixture(scope="module")
def margins(uncertain):
    return rl.robust_stability(uncertain, tolerance=np.inf), rl.robust_stability(uncertain, tolerance=0.01)


def test_branch_and_bound_closes_the_gap_of_the_scalings(margins):
    scalings, cut = margins
    assert scalings.gap > 0.02
    assert cut.gap <= 0.01 * (1 + 1e-9)
    assert scalings.lower <= cut.lower <= cut.upper <= scalings.upper * (1 + 1e-9)
    assert cut.status is rl.Status.CERTIFIED
    assert "branch and bound" in cut.notes[0]


def test_no_delta_inside_the_proved_margin_destabilises(uncertain, margins):
    size = margins[1].lower
    names = [b.name for b in uncertain.blocks]
    rng = np.random.default_rng(0)
    corners = itertools.product([-size, size], repeat=len(names))
    inside = size * rng.uniform(-1, 1, (200, len(names)))
    for delta in itertools.chain(corners, inside):
        assert uncertain.evaluate(dict(zip(names, delta, strict=True))).spectral_abscissa() < 0


# --- a chain with light damping ---------------------------------------------------------------------------------------


def member(model: StateSpaceModel, values: np.ndarray, repeats: int) -> np.ndarray:
    """A + B Delta (I - D Delta)^-1 C, written out."""
    delta = np.diag(np.repeat(values, repeats))
    return model.A + model.B @ delta @ np.linalg.solve(np.eye(len(delta)) - model.D @ delta, model.C)


@pytest.mark.slow
def test_the_margin_of_a_chain_closes_and_holds_for_members_inside():
    model, blocks = chain(12, 3, 0)
    margin = rl.robust_stability(rl.UncertainModel(model, blocks), tolerance=0.05)
    assert margin.gap <= 0.0501
    assert margin.upper < 2.0
    rng = np.random.default_rng(1)
    for _ in range(300):
        values = 0.999 * margin.lower * rng.uniform(-1, 1, 4)
        values = np.sign(values) * 0.999 * margin.lower if rng.random() < 0.5 else values
        assert np.linalg.eigvals(member(model, values, 3)).real.max() < 0


# --- the critical Delta in the time domain ----------------------------------------------------------------------------


def oscillator(kind, dt: float = 0.0) -> rl.UncertainModel:
    """x'' + (0.4 - 0.1 delta) x' + x = u: delta = 4 removes the damping, at 1 rad/s."""
    M = rl.StateSpaceModel(
        [[0.0, 1.0], [-1.0, -0.4]], [[0.0, 0.0], [0.1, 1.0]], [[0.0, 1.0], [1.0, 0.0]], np.zeros((2, 2))
    )
    if dt:
        from robustlab.norms import bilinear_to_discrete

        M = bilinear_to_discrete(M, dt)
    return rl.UncertainModel(M, [kind("c")])


@pytest.mark.parametrize("dt", [0.0, 0.05])
@pytest.mark.parametrize("kind", [rl.RealScalar, rl.ComplexScalar])
def test_the_critical_delta_has_an_undamped_oscillation(kind, dt):
    uncertain = oscillator(kind, dt)
    margin = rl.robust_stability(uncertain)
    assert margin.upper == pytest.approx(4.0, rel=1e-6)
    shown = replay(uncertain, margin)
    assert shown.growth == pytest.approx(1.0, abs=1e-3)
    assert shown.period == pytest.approx(2 * np.pi, rel=1e-3)
    assert np.abs(shown.nominal[-20:]).max() < 1e-4
    inside = np.abs(shown.inside)
    assert inside[-40:].max() < 0.9 * inside[:40].max()
