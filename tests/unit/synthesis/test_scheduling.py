"""Gain scheduling against closed forms, frozen norms, and trajectories against proved bounds."""

from dataclasses import replace

import h5py
import numpy as np
import pytest
import shown_objects
from scipy.linalg import expm

import robustlab as rl
from robustlab import frequency_response
from robustlab.errors import InputError, NoTrustworthyNumber
from robustlab.result import Status
from robustlab.statespace import lower_lft
from robustlab.synthesis import LPVController, closed_loop


def lag(a: float) -> rl.StateSpaceModel:
    return rl.StateSpaceModel([[-a]], [[a]], [[1.0]], [[0.0]])


def lags(rate: float = np.inf) -> rl.LPVModel:
    """``x' = a (w - x), z = x`` with 1 <= a <= 4."""
    return rl.LPVModel({"a": [1.0, 4.0]}, [lag(1.0), lag(4.0)], rates={"a": rate})


def oscillator(k: float) -> rl.StateSpaceModel:
    return rl.StateSpaceModel([[0, 1], [-2 - k, -1]], [[0], [1]], [[1, 0]], [[0]])


def springs() -> rl.UncertainModel:
    ranges = {"m": (3.0, 0.2), "k": (2.0, 1.6, 2.2), "c": 1.5}
    return rl.parametric([[0, 1], ["-k/m", "-c/m"]], [[0], ["1/m"]], [[1, 0]], [[0]], ranges)


def finite_gain(model: rl.LPVModel, places: np.ndarray, step: float) -> float:
    """Lower bound of the induced gain: gain for parameters and inputs constant in each step by a power iteration."""
    n, m = model.n_states, len(model.inputs)
    maps = []
    for rho in places:
        whole = model.matrix_at(np.atleast_1d(rho))
        F = np.zeros((n + m, n + m))
        F[:n] = whole[:n]
        C = whole[n:]
        # Van Loan: the transition and the output's energy over one step.
        big = expm(step * np.block([[-F.T, C.T @ C], [np.zeros_like(F), F]]))
        transition = big[n + m :, n + m :]
        maps.append((transition[:n], transition.T @ big[: n + m, n + m :]))
    w = np.random.default_rng(0).normal(size=(len(places), m))
    gain = 0.0
    for _ in range(40):
        w /= np.sqrt(step) * np.linalg.norm(w)
        x, states = np.zeros(n), []
        for (T, _), v in zip(maps, w, strict=True):
            states.append(np.append(x, v))
            x = T @ states[-1]
        energy = sum(s @ Q @ s for s, (_, Q) in zip(states, maps, strict=True))
        back, costate = np.zeros_like(w), np.zeros(n)
        for k in range(len(maps) - 1, -1, -1):
            T, Q = maps[k]
            total = (Q + Q.T) / 2 @ states[k] + T.T @ costate
            costate, back[k] = total[:n], total[n:]
        w, gain = back, float(np.sqrt(energy))
    return gain


# --- models ----------------------------------------------------------------------------------------------------------


def test_an_affine_set_is_exact_and_a_rational_one_within_its_bound():
    affine = rl.parametric([[0, 1], ["-k", "-c"]], [[0], [1]], [["k", 0]], [[0]], {"k": (2.0, 0.5), "c": (1.0, 0.2)})
    assert rl.lpv_model(affine).known == "exact"
    rational, rng = springs(), np.random.default_rng(0)
    model = rl.lpv_model(rational, {"m": 4})
    assert model.known == "proved"
    ratio = 0.0
    for _ in range(300):
        rho = {b.name: rng.uniform(b.parameter.low, b.parameter.high) for b in rational.blocks}
        delta = {b.name: b.delta((rho[b.name] - b.parameter.nominal) / b.parameter.radius) for b in rational.blocks}
        true = rational.evaluate(delta)
        error = np.abs(np.block([[true.A, true.B], [true.C, true.D]]) - model.matrix_at(model.place(rho)))
        cell = tuple(min(int(np.searchsorted(p.points, rho[p.name])) - 1, len(p.points) - 2) for p in model.parameters)
        bound = model.deviation[cell]
        assert (error <= bound + 1e-14).all()
        ratio = max(ratio, float((error / np.where(bound > 0, bound, np.inf)).max()))
    assert ratio > 0.5  # the bound is tight


def test_a_linearised_plant_is_sampled_with_its_states():
    plant = rl.plant("stewart-platform")
    home = plant.geometry.home
    model = rl.lpv_model(
        lambda tz: rl.linearise(plant, at=home + np.array([0, 0, tz, 0, 0, 0])), {"tz": [-0.01, 0.0, 0.01]}, samples=4
    )
    assert model.known == "sampled"
    assert [s.name for s in model.states] == [s.name for s in plant.states]
    assert 0 < model.deviation.max() < 1e-2 * np.abs(model.matrices).max()


def test_the_loop_between_the_points_is_within_its_bound():
    rng = np.random.default_rng(0)

    def drawn(n, m, p, zero):
        D = rng.normal(size=(p, m))
        D[-zero:, -zero:] = 0.0
        return rl.StateSpaceModel(rng.normal(size=(n, n)), rng.normal(size=(n, m)), rng.normal(size=(p, n)), D)

    plant = rl.LPVModel({"a": [0, 1.0], "b": [0, 1.0, 3.0]}, [drawn(3, 2, 3, 1) for _ in range(6)])
    K = rl.LPVModel({"a": [0, 1.0], "b": [0, 1.0, 3.0]}, [
        rl.StateSpaceModel(*(rng.normal(size=s) for s in ((2, 2), (2, 1), (1, 2), (1, 1)))) for _ in range(6)
    ])  # fmt: skip
    loop = closed_loop(plant, K)
    for at in rng.uniform(size=(100, 2)) * [1, 3]:
        one = lower_lft(plant.at(at), K.at(at))
        error = np.abs(np.block([[one.A, one.B], [one.C, one.D]]) - loop.matrix_at(at))
        cell = tuple(
            min(int(np.searchsorted(p.points, v)) - 1, len(p.points) - 2)
            for p, v in zip(loop.parameters, at, strict=True)
        )
        assert (error <= loop.deviation[cell] + 1e-12).all()


# --- the induced gain ------------------------------------------------------------------------------------------------


def test_the_gain_of_a_switching_lag_is_five_quarters():
    """V = p x^2: p^2 a^2 <= gamma^2 (2 p a - 1) at a = 1 and 4 gives p = 5/8, gamma = 5/4 (exact: scalar)."""
    found = rl.peak_gain(lags())
    assert found.status is Status.CERTIFIED
    assert found.recheck()
    assert 1.25 <= found.upper < 1.25 * (1 + 2e-4)
    assert found.P[0].item() == pytest.approx(0.625 / found.upper, rel=0.05)
    assert found.lower == pytest.approx(1.0)
    # A switching parameter comes close to the bound.
    best = max(
        finite_gain(lags(), np.repeat(values, [n, 60 - n]), 0.1)
        for values in ([4.0, 1.0], [1.0, 4.0])
        for n in (10, 20, 30, 40, 50)
    )
    assert 1.1 < best <= found.upper


def scheduled_pi_loop(p: float) -> rl.StateSpaceModel:
    """From d to e = d - y: a lag K / (tau s + 1), Padé's delay of 0.5 s, 1.1 at the input, a scheduled PI law."""
    tau, K, T = np.sqrt(133.6 - 16.8 * p), np.sqrt(4.8 * p - 8.6), 0.5
    k_p, k_i, worst = (2 * 0.7 * 0.25 * tau - 1) / K, 0.25**2 * tau / K, 1.1
    # states: the integral, two of the delay 1 - (12 / T) s / (s^2 + (6 / T) s + 12 / T^2), the lag's
    A = np.zeros((4, 4))
    A[0, 3], A[1, 1:3], A[2, 1] = -k_i * K, [-6 / T, -12 / T**2], 1.0
    into, direct = np.array([1.0, 0, 0, -k_p * K]) * worst, k_p * worst  # of the delay, from states and from d
    A[1] += into
    A[3] = (into + np.array([0, -12 / T, 0, 0])) / tau
    A[3, 3] -= 1 / tau
    return rl.StateSpaceModel(A, [[k_i], [direct], [0], [direct / tau]], [[0, 0, 0, -K]], [[1.0]])


@pytest.mark.slow
def test_a_published_gain_of_a_scheduled_loop():
    """LPVTools manual (Balas, Hjartarson, Packard, Seiler 2015), "Worst-Case Gain Analysis of LPV System", after Tan,
    Hang, Chai 1997: with the uncertainty at its worst, 0.1, at any rate 20.1476; at 0.1 per second between 1.2968 and
    1.8925, for the six points."""
    points = np.arange(2.0, 8.0)
    loop = rl.LPVModel({"p": points}, [scheduled_pi_loop(p) for p in points])
    found = rl.peak_gain(loop)
    assert found.status is Status.CERTIFIED
    assert found.upper == pytest.approx(20.1476, rel=1e-3)
    fine = np.linspace(2.0, 7.0, 21)
    slow = rl.peak_gain(rl.LPVModel({"p": fine}, [scheduled_pi_loop(p) for p in fine], rates={"p": 0.1}))
    assert slow.status is Status.CERTIFIED
    assert 1.2968 < slow.upper < 1.8925


def test_quadratic_stability_ends_as_by_the_circle_criterion():
    """x'' + x' + (2 + k(t)) x = w, 0 <= k <= kmax: one Lyapunov matrix exists up to kmax = 1 + 2 sqrt(2) exactly."""
    for k, proved in ((3.82, True), (3.83, False)):
        found = rl.peak_gain(rl.LPVModel({"k": [0.0, k]}, [oscillator(0.0), oscillator(k)]))
        assert np.isfinite(found.upper) == proved
        assert found.status.trustworthy == proved
        assert (found.P.size > 0) == proved


def test_a_sampled_model_is_not_certified():
    """The interpolation error of 1 / a is at most 0.05."""
    family = rl.lpv_model(lambda a: lag(1.0 / a), {"a": [0.5, 0.75, 1.0]}, samples=20)
    found = rl.peak_gain(family)
    assert found.status is Status.CONVERGED
    assert "samples" in found.scope
    assert found.recheck()
    assert max(rl.peak_gain(lag(1.0 / a)).upper for a in (0.6, 0.9)) <= found.upper


def test_a_wrong_certificate_is_rejected():
    found = rl.peak_gain(lags())
    assert found.recheck()
    assert not replace(found, upper=1.2499).recheck()
    assert not any(replace(found, P=P).recheck() for P in (1.2 * found.P, -found.P, np.full_like(found.P, np.nan)))
    deviating = rl.LPVModel({"a": [1.0, 4.0]}, [lag(1.0), lag(4.0)], deviation=np.full((1, 2, 2), 1e-3), known="proved")
    assert not replace(found, model=deviating).recheck()


def test_an_unstable_frozen_model_is_reported_with_its_pole():
    """Poles ``a +- 2j`` at a = -1 and 1: the gain at constant a = 1 is infinite."""
    turning = {a: rl.StateSpaceModel([[a, 2.0], [-2.0, a]], [[1.0], [0.0]], [[1.0, 0.0]], [[0.0]]) for a in (-1.0, 1.0)}
    found = rl.peak_gain(rl.LPVModel({"a": [-1.0, 1.0]}, list(turning.values())))
    assert (found.status, found.lower, found.upper) == (Status.INFEASIBLE, np.inf, np.inf)
    assert found.at == {"a": 1.0}
    assert found.frequency == pytest.approx(2.0)
    assert "a = 1: pole 1+2j is unstable" in found.reason
    assert "attained" not in str(found)


def test_a_frozen_model_of_undecided_stability_has_no_bound():
    """-1e-17 and -1 in mixed states: the rounding of A moves the slow pole across the axis."""
    T = np.array([[1.0, 0.3], [0.7, 1.0]])
    slow = rl.StateSpaceModel(T @ np.diag([-1e-17, -1.0]) @ np.linalg.inv(T), [[1.0], [1.0]], [[1.0, 1.0]], [[0.0]])
    quick = rl.StateSpaceModel(-np.eye(2), [[1.0], [1.0]], [[1.0, 1.0]], [[0.0]])
    found = rl.peak_gain(rl.LPVModel({"a": [0.0, 1.0]}, [slow, quick]))
    assert not found.status.trustworthy
    assert found.upper == np.inf
    assert "a = 0: pole" in found.reason


def test_a_model_without_effect_on_its_output_has_gain_zero():
    still = rl.StateSpaceModel([[-1.0]], [[0.0]], [[1.0]], [[0.0]])
    found = rl.peak_gain(rl.LPVModel({"a": [0, 1]}, [still, still]))
    assert found.status is Status.CERTIFIED
    assert found.upper < 1e-4


# --- synthesis -------------------------------------------------------------------------------------------------------


def vertex(a: float) -> rl.StateSpaceModel:
    return rl.StateSpaceModel([[a]], [[1, 0, 1]], [[1], [0], [1]], [[0, 0, 0], [0, 0, 1], [0, 1, 0]])


def test_the_design_of_a_constant_plant_is_hinf():
    design = rl.hinf(rl.LPVModel({"a": [0, 1]}, [vertex(0.0), vertex(0.0)]), 1, 1)
    exact = np.sqrt(2.0)  # 1/s with unit weights
    assert design.status is Status.CERTIFIED
    assert design.lmi_gamma == pytest.approx(exact, rel=1e-4)
    assert exact * (1 - 1e-6) <= design.gamma < 1.02 * exact


def test_a_scheduled_loop_keeps_its_bound_along_trajectories():
    design = shown_objects.scheduled()
    plant, rng = shown_objects.scheduled_plant(), np.random.default_rng(0)
    worst = max(rl.hinf(vertex(a), 1, 1, gamma_rel=1.0).gamma for a in (-2.0, 0.0))
    assert worst * (1 - 1e-3) <= design.gamma < 1.02 * worst
    assert design.gain.recheck()
    for a in rng.uniform(-2, 0, 10):
        assert rl.peak_gain(lower_lft(plant.at(a=a), design.controller.at(a=a))).upper <= design.gamma * (1 + 1e-9)
    for _ in range(5):
        places = np.repeat(rng.choice([-2.0, 0.0], 20), 4)
        assert finite_gain(design.closed_loop, places, 0.1) <= design.gamma


@pytest.mark.slow
def test_a_varying_control_matrix_is_bounded_between_the_points():
    def gained(b: float) -> rl.StateSpaceModel:
        m = vertex(-1.0)
        return rl.StateSpaceModel(m.A, [[1, 0, b]], m.C, m.D)

    plant = rl.LPVModel({"b": np.linspace(1, 2, 5)}, [gained(b) for b in np.linspace(1, 2, 5)])
    design = rl.hinf(plant, 1, 1)
    assert design.status is Status.CERTIFIED
    assert design.closed_loop.deviation.max() > 0
    for b in np.random.default_rng(0).uniform(1, 2, 20):
        assert rl.peak_gain(lower_lft(plant.at(b=b), design.controller.at(b=b))).upper <= design.gamma


def disks_plant() -> rl.LPVModel:
    """Two masses that slide on spinning disks, joined by a wire: rho_i = Omega_i^2, measured, in 0..9 and 0..25.

    r1'' = (rho_1 - 200) r1 - 200 r2 - r1' + a + 0.1 d1, r2'' = 2 (-200 r1 - 200 r2 - r2' + 0.1 d2) + rho_2 r2, the
    actuator a' = 100 (u - a); z = (Wu u, 1e-5 a, We (r2 - reference)), y = (reference, r2 + Wn n) with We = (0.3 s +
    1.2) / (s + 0.04), Wu = (s + 0.1) / (0.01 s + 125), Wn = (s + 0.4) / (0.01 s + 400): the example of Wu's thesis
    (Berkeley 1995) as in the manual of LPVTools ("Modeling and Control of a LFT-based LPV System", Balas,
    Hjartarson, Packard, Seiler 2015), gamma 1.3361 there.
    """

    def vertex(rho1: float, rho2: float) -> rl.StateSpaceModel:
        A, B, C, D = np.zeros((8, 8)), np.zeros((8, 5)), np.zeros((5, 8)), np.zeros((5, 5))
        A[0, 2] = A[1, 3] = A[2, 4] = 1.0
        A[2, :3], A[3, :2], A[3, 3] = [rho1 - 200, -200, -1], [-400, rho2 - 400], -2
        B[2, 1], B[3, 2] = 0.1, 0.2
        A[4, 4], B[4, 4] = -100, 100
        A[5, 5], B[5, 4], C[0, 5], D[0, 4] = -12500, 1, 100 * (0.1 - 12500), 100
        A[6, 6], A[6, 1], B[6, 0] = -0.04, 1, -1
        C[2, 6], C[2, 1], D[2, 0] = 1.2 - 0.3 * 0.04, 0.3, -0.3
        A[7, 7], B[7, 3], C[4, 7], D[4, 3] = -40000, 1, 100 * (0.4 - 40000), 100
        C[1, 4], D[3, 0], C[4, 1] = 1e-5, 1, 1
        return rl.StateSpaceModel(A, B, C, D)

    ranges = {"rho1": [0.0, 9.0], "rho2": [0.0, 25.0]}
    return rl.LPVModel(ranges, [vertex(a, b) for a in ranges["rho1"] for b in ranges["rho2"]])


@pytest.mark.slow
def test_the_spinning_disks_improve_on_the_published_gain():
    """Wu 1995, in LPVTools' manual: 1.3361, of which up to a fifth is for conditioning; lower bound of the frozen loops
    0.8150. Weights with poles at 0.04 and 40000 rad/s."""
    plant = disks_plant()
    design = rl.hinf(plant, 2, 1)
    assert design.status is Status.CERTIFIED
    assert design.gain.recheck()
    assert 0.8150 < design.lmi_gamma <= design.gamma < 1.16
    rng = np.random.default_rng(0)
    for at in rng.uniform(size=(10, 2)) * [9, 25]:
        loop = lower_lft(plant.at(at), design.controller.at(at))
        gains = np.linalg.svd(frequency_response(loop, np.geomspace(1e-3, 1e5, 400)), compute_uv=False)
        assert gains.max() <= design.gamma
    assert all(np.abs(K.poles()).max() < 2e3 for _, K in design.K.nodes())


@pytest.mark.slow
def test_the_missile_of_the_lmi_control_toolbox():
    """``misldem``: q measured without noise, so the problem is singular; controllers have poles of 4e4 rad/s."""

    def missile(Z: float, M: float) -> rl.StateSpaceModel:
        # x = alpha, q, of W1 = 2.01 / (s + 0.201), of W2 = (9.678 s^3 + 0.029 s^2) / (s^3 + 1.206e4 s^2 + ...)
        A, B, C, D = np.zeros((6, 6)), np.zeros((6, 2)), np.zeros((4, 6)), np.zeros((4, 2))
        a = np.array([1.206e4, 1.136e7 / 1e3, 1.066e10 / 1e6])
        A[0, :2], A[1, 0], A[2, [0, 2]], A[3, 3:], A[4, 3], A[5, 4] = [-Z, 1], -M, [1, -0.201], -a, 1e3, 1e3
        B[1, 1], B[2, 0], B[3, 1] = 1, 1, 1
        C[0, 2], C[1, 3:], C[2, 0], C[3, 1] = 2.01, [0.029, 0, 0] - 9.678 * a, 1, 1
        D[1, 1], D[2, 0] = 9.678, 1
        return rl.StateSpaceModel(A, B, C, D)

    ranges = {"Z": [0.5, 4.0], "M": [0.0, 106.0]}
    design = rl.hinf(rl.LPVModel(ranges, [missile(Z, M) for Z in ranges["Z"] for M in ranges["M"]]), 2, 1)
    assert design.status is Status.CERTIFIED
    assert design.lmi_gamma <= design.gamma < 0.16


def test_controllers_have_moderate_entries():
    # A weak actuator and a sensor in small units: entries are 7.6e7 in the states of the LMIs, for the same loop.
    def vertex(a):
        B, C, D = [[1, 0, 1e-3]], [[1], [0], [1e3]], [[0, 0, 0], [0, 0, 1], [0, 1e-3, 0]]
        return rl.StateSpaceModel([[a]], B, C, D)

    plant = rl.LPVModel({"a": [-2.0, 0.0]}, [vertex(-2.0), vertex(0.0)])
    design = rl.hinf(plant, 1, 1)
    assert design.status is Status.CERTIFIED
    assert np.abs(design.K.matrices).max() < 2e5
    # Row and column of the state are balanced, with the same units at both points.
    size = np.abs(design.K.matrices).sum(axis=0)
    assert 0.2 < size[0, 1] / size[1, 0] < 5
    # The bound holds for the frozen loops of the returned controller.
    for a in (-2.0, -1.0, 0.0):
        assert rl.peak_gain(lower_lft(plant.at(a=a), design.K.at(a=a))).lower <= design.gamma * (1 + 1e-9)


def test_an_uncontrollable_mode_gives_no_controller():
    def hopeless(a: float) -> rl.StateSpaceModel:
        m = vertex(a)
        return rl.StateSpaceModel(
            np.diag([a, 1.0]), np.vstack([m.B, [[1, 0, 0]]]), np.hstack([m.C, [[1], [0], [0]]]), m.D
        )

    with pytest.raises(NoTrustworthyNumber, match="hinf"):
        rl.hinf(rl.LPVModel({"a": [-1, 0]}, [hopeless(-1), hopeless(0)]), 1, 1)


# --- files and errors ------------------------------------------------------------------------------------------------


def test_models_and_controllers_are_saved_and_loaded(tmp_path):
    model = rl.lpv_model(springs(), {"m": 3}, {"m": 0.5}, {"m": "kg"})
    rl.save(tmp_path / "m.h5", model)
    back = rl.load(tmp_path / "m.h5")
    assert isinstance(back, rl.LPVModel)
    assert back.parameters == model.parameters
    assert (back.known, back.states, back.inputs, back.outputs) == ("proved", model.states, model.inputs, model.outputs)
    np.testing.assert_array_equal(back.matrices, model.matrices)
    np.testing.assert_array_equal(back.deviation, model.deviation)
    rl.save(tmp_path / "k.h5", shown_objects.scheduled().controller)
    controller = rl.load(tmp_path / "k.h5")
    assert isinstance(controller, LPVController)
    assert controller.gamma == shown_objects.scheduled().gamma
    assert controller.status is Status.CERTIFIED
    rl.save(tmp_path / "g.h5", shown_objects.scheduled().gain)
    assert rl.load(tmp_path / "g.h5").type == "LPVGain"


def test_a_damaged_file_is_rejected(tmp_path):
    rl.save(tmp_path / "m.h5", lags())
    with h5py.File(tmp_path / "m.h5", "a") as file:
        del file.attrs["content_sha256"]
        file["parameters/count"][...] = 3
    with pytest.raises(InputError, match="no LPV model: parameters: 2 points"):
        rl.load(tmp_path / "m.h5")
