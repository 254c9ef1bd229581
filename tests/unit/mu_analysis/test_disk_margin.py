"""Disk margins: published values, python-control's grid, perturbed loops with a pole on the axis, invalid inputs."""

import numpy as np
import pytest

import robustlab as rl
from robustlab import disk_margin
from robustlab.mu_analysis import gain_and_phase
from robustlab.statespace import append, feedback, series


def satellite(c: float = 10.0) -> tuple[rl.StateSpaceModel, rl.StateSpaceModel]:
    plant = rl.StateSpaceModel([[0, 10], [-10, 0]], np.eye(2), [[1, c], [-10, 1]], np.zeros((2, 2)))
    return plant, rl.StateSpaceModel([], [], [], [[1, -2], [0, 1]])


PAPER = [25], [1, 10, 10, 10]


# --- published -------------------------------------------------------------------------------------------------------


def test_the_example_of_the_paper():
    """Seiler, Packard, Gahinet 2020, 25 / (s^3 + 10 s^2 + 10 s + 10): 0.46 at 1.94 rad/s, [0.63, 1.59], 25.8 deg."""
    margin = disk_margin(rl.tf(*PAPER)).simultaneous
    assert margin.status is rl.Status.CERTIFIED
    assert round(margin.value, 2) == 0.46
    assert margin.gain_margin == pytest.approx((0.63, 1.59), abs=0.005)
    assert np.degrees(margin.phase_margin) == pytest.approx(25.8, abs=0.05)
    assert margin.frequency == pytest.approx(1.94, rel=0.02)


def test_the_spinning_satellite_as_published_by_mathworks():
    """Loop at a time 2, [0, inf], 90 deg; all outputs at once between 0.3754 and 0.3762, [0.6839 1.4621], 21.26 deg."""
    margins = disk_margin(*satellite())
    for margin in margins.channels.values():
        assert margin.value == pytest.approx(2.0, rel=1e-7)
        assert np.degrees(margin.phase_margin) == pytest.approx(90, abs=1e-5)
        assert margin.gain_margin[0] < 1e-8
        assert margin.gain_margin[1] > 1e6
    together = margins.simultaneous
    assert 0.3754 <= round(together.lower, 4) <= round(together.upper, 4) <= 0.3762
    assert together.gain_margin[0] <= 0.6839
    assert np.degrees(together.phase_margin) >= 21.2607
    # And with another output matrix between 0.4890 and 0.4899.
    other = disk_margin(*satellite(8.0)).simultaneous
    assert 0.4890 <= round(other.lower, 4) <= round(other.upper, 4) <= 0.4899
    # For two complex scalars mu is min_t sigma_max(diag(e^t, 1) M diag(e^-t, 1)): over t and w by scipy.
    assert other.lower <= 0.489937150 <= other.upper * (1 + 1e-9)
    assert other.upper == pytest.approx(0.489937150, rel=1e-6)
    assert other.status is rl.Status.CERTIFIED


# --- closed forms and python-control ---------------------------------------------------------------------------------


@pytest.mark.parametrize("skew", [-2.0, -1.0, 0.0, 0.5, 1.0, 2.0])
def test_gain_and_phase_lie_on_the_edge_of_the_disk(skew):
    for alpha in (0.1, 0.7, 1.5):
        low, high, phase = gain_and_phase(alpha, skew)
        for f in (low, high, np.exp(1j * phase)):
            if np.isfinite(f) and not (phase == np.pi and f == np.exp(1j * phase)):
                delta = (f - 1) / ((1 - skew) / 2 + (1 + skew) / 2 * f)
                assert abs(delta) == pytest.approx(alpha, rel=1e-9)
    assert gain_and_phase(np.inf, skew) == (-np.inf, np.inf, np.pi)
    assert gain_and_phase(0.0, skew) == (1.0, 1.0, 0.0)


@pytest.mark.parametrize("skew", [-1.0, 0.0, 1.0, 2.0])
def test_one_loop_against_the_grid_of_python_control(skew):
    import control

    for numerator, denominator in (PAPER, ([3, 1], [1, 0.2, 4, 0.5]), ([10], [1, 3, 2, 0])):
        L = rl.tf(numerator, denominator)
        omega = np.geomspace(1e-2, 1e2, 4001)
        loop = feedback(L, rl.StateSpaceModel([], [], [], [[1.0]]))
        if not loop.is_stable():
            continue
        dm, dgm, dpm = control.disk_margins(L.to_control(), omega, skew=skew)
        ours = disk_margin(L, skew=skew).simultaneous
        assert ours.upper <= float(dm) * (1 + 1e-9)
        assert ours.lower == pytest.approx(float(dm), rel=2e-3)
        assert np.degrees(ours.phase_margin) == pytest.approx(float(dpm), rel=5e-3)
        assert 20 * np.log10(ours.gain_margin[1]) == pytest.approx(float(dgm), rel=5e-3) or skew > 0


# --- the worst perturbation ------------------------------------------------------------------------------------------


def stable_loop(seed: int, n_loops: int, dt: float) -> tuple[rl.StateSpaceModel, rl.StateSpaceModel]:
    """A random plant and a stabilising static gain."""
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((4, 4))
    A -= (np.linalg.eigvals(A).real.max() + 0.2) * np.eye(4)
    B, C = rng.standard_normal((4, n_loops)), rng.standard_normal((n_loops, 4))
    if dt:
        A, B = np.linalg.solve(np.eye(4) - 0.5 * dt * A, np.eye(4) + 0.5 * dt * A), dt * B
    K = rng.standard_normal((n_loops, n_loops))
    plant = rl.StateSpaceModel(A, B, C, np.zeros((n_loops, n_loops)), dt)
    while not feedback(plant, rl.StateSpaceModel([], [], [], K)).is_stable():
        K *= 0.7
    return plant, rl.StateSpaceModel([], [], [], K)


@pytest.mark.parametrize("dt", [0.0, 0.2])
@pytest.mark.parametrize(("n_loops", "skew", "at"), [(1, 0.0, "output"), (1, 1.5, "input"), (1, -1.0, "output"),
                                                     (2, 0.0, "output"), (2, 0.7, "input")])  # fmt: skip
def test_the_worst_factors_put_a_pole_on_the_stability_boundary(dt, n_loops, skew, at):
    """The loop is rebuilt from the plant, the controller and the models of f, without an LFT of this package."""
    for seed in (1, 3)[: 3 - n_loops]:
        plant, k = stable_loop(seed, n_loops, dt)
        margin = disk_margin(plant, k, at=at, skew=skew).simultaneous
        assert margin.status is rl.Status.CERTIFIED
        assert margin.lower <= margin.upper <= margin.lower * 1.01
        assert max(map(abs, margin.delta.values())) == pytest.approx(margin.upper, rel=1e-9)
        for name, f in margin.factor.items():
            if not np.isfinite(f):
                assert margin.delta[name] * (1 + skew) == pytest.approx(2.0)
                continue
            delta = (f - 1) / ((1 - skew) / 2 + (1 + skew) / 2 * f)
            assert delta == pytest.approx(margin.delta[name], rel=1e-9)
        G, C = (rl.frequency_response(m, [margin.frequency])[0] for m in (plant, k))
        if np.isfinite(list(margin.factor.values())).all():
            loop = np.diag(list(margin.factor.values())) @ (G @ C if at == "output" else C @ G)
            assert np.abs(np.linalg.eigvals(loop) + 1).min() <= 1e-6
        # Factors inside the disk of lower: stable.
        rng = np.random.default_rng(seed)
        for _ in range(20):
            d = 0.999 * margin.lower * rng.choice([-1.0, 1.0], n_loops)
            f = (1 + (1 - skew) / 2 * d) / (1 - (1 + skew) / 2 * d)
            gains = rl.StateSpaceModel([], [], [], np.diag(f))
            assert feedback(series(plant, gains) if at == "output" else series(gains, plant), k).is_stable()


def test_an_ill_posed_critical_loop_is_reported():
    """Two direct terms: the smallest factors make the algebraic loop singular, at infinite frequency."""
    L = rl.StateSpaceModel(-np.eye(2), -0.1 * np.eye(2), np.eye(2), [[1.0, 2.0], [0.5, 3.0]])
    margin = disk_margin(L).simultaneous
    assert margin.status is rl.Status.CERTIFIED
    assert margin.frequency == np.inf


def nearly_cancelled(damping: float) -> rl.StateSpaceModel:
    """A mode on the axis that a zero next to it nearly cancels: in the loop it has a narrow peak."""
    return rl.tf([5, 10 * damping, 500], np.polymul([1, 0, 100], [1, 1]))


def flexible_satellite(notch: float) -> rl.StateSpaceModel:
    """A rigid body with a lead, and modes at 2 and 5 rad/s under slightly more damped notches."""
    notches = np.polymul([1, 2 * notch, 4], [1, 2 * notch, 25])
    modes = np.polymul([1, notch / 3, 4], [1, notch / 4, 25])
    return rl.tf(np.polymul([4, 0.5], notches), np.polymul([0.05, 1, 0, 0], modes))


# One over the largest |S - 1/2|, and over that of |S| / 2, in 50 digits (mpmath) on the transfer functions.
NARROW = [
    (nearly_cancelled(1e-3), 0.565210702294, 1.19398552),
    (nearly_cancelled(1e-4), 0.565229990024, 1.19403871718),
    (nearly_cancelled(1e-6), 0.565232111757, 1.19404456914),
    (nearly_cancelled(1e-8), 0.565232132975, 1.19404462766),
    (flexible_satellite(1e-8), 0.600765436156, 1.30100482268),
]


@pytest.mark.parametrize(("loop", "disk", "additive"), NARROW)
def test_margins_at_a_nearly_cancelled_mode_are_those_of_its_narrow_peak(loop, disk, additive):
    from robustlab.norms import bilinear_to_discrete

    uncertain = rl.unstructured(loop, 0.5, "additive").feedback()
    for margin, truth in [
        (disk_margin(loop), disk),
        (disk_margin(bilinear_to_discrete(loop, 0.05)), disk),
        (rl.robust_stability(uncertain), additive),
    ]:
        assert margin.status is rl.Status.CERTIFIED
        assert margin.lower <= truth * (1 + 1e-6)
        assert margin.upper == pytest.approx(truth, rel=1e-6)
        assert margin.lower >= truth * (1 - 1e-4)


def test_two_loops_with_narrow_peaks_are_as_good_as_the_worse_one():
    one, two = nearly_cancelled(1e-7), flexible_satellite(1e-7)
    loops = append(one.renamed(inputs=["u"], outputs=["y"]), two)
    margin = disk_margin(loops)
    assert margin.status is rl.Status.CERTIFIED
    assert 0.5652321307 * (1 - 2e-4) <= margin.lower <= 0.5652321314
    assert margin.upper == pytest.approx(0.565232131, rel=1e-6)


def test_modes_close_to_each_other_do_not_blur_their_narrow_peaks():
    """Zeros of damping 1e-8 / 10 and twice that next to modes at 10 and sqrt(100.5) rad/s."""
    e = 1e-8
    zeros, modes = np.polymul([1, 2 * e, 100], [1, 4 * e, 100.5]), np.polymul([1, 0, 100], [1, 0, 100.5])
    margin = disk_margin(rl.tf(5 * zeros, np.polymul(modes, [1, 1])))
    assert margin.lower <= 0.563978705 * (1 + 1e-6)
    assert margin.upper == pytest.approx(0.563978705, rel=1e-6)
