"""Evidence of a residual force: against dense Gaussian densities, closed forms, and records of a known ripple."""

from dataclasses import dataclass

import numpy as np
import pytest
from naming_cases import problem_of
from scipy.linalg import block_diag
from scipy.stats import multivariate_normal

import robustlab as rl
from robustlab.identification import (
    Family,
    FitPlan,
    FittedWindows,
    ForceResponse,
    Hypothesis,
    PortMotion,
    first_noise,
    fitted_windows,
    force_response,
    judged,
    plain_places,
    residual_force,
    unnamed_force,
)

START = 1e-4  # precision of the initial states' prior, over that in the fit
DT = 2e-3
M, FV, GAIN = 95.1089, 203.5034, 35.15065


# --- against dense densities -----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Dense:
    """Random windows: segments O by port, parameters J, initial states X, errors e; the force that moves each port."""

    o: np.ndarray
    j: np.ndarray
    x: np.ndarray
    e: np.ndarray
    xi: np.ndarray
    z: np.ndarray
    forces: tuple[float, ...] = (1.0,)

    def covariance(
        self, size: float, bandwidth: float, weight: float, columns: np.ndarray | None = None, strength: float = 0.0
    ):
        """Of all errors in a row, less the noise's scale, of which ``weight`` is the variance; and their mean.

        Columns act at the last port.
        """
        count, points, pulses = self.o.shape
        s = pulses // len(self.forces)
        middle = DT * (np.arange(s) * 5 + 2.5)
        kernel = size**2 * np.exp(-2 * np.pi * bandwidth * np.abs(middle[:, None] - middle))
        kernel = block_diag(*(force**2 * kernel for force in self.forces))
        j = self.j.reshape(count * points, self.j.shape[2])
        total = np.eye(count * points) + j @ j.T / weight
        mean = -j @ self.z
        for w in range(count):
            own = slice(w * points, (w + 1) * points)
            total[own, own] += self.o[w] @ kernel @ self.o[w].T + self.x[w] @ self.x[w].T / START
            mean[own] -= self.x[w] @ self.xi[w]
        if columns is not None:
            g = np.concatenate([self.o[w, :, -s:] @ columns[w] for w in range(count)])
            total = total + strength * g @ g.T
        return total, mean

    def windows(self) -> FittedWindows:
        count, points, pulses = self.o.shape
        s = pulses // len(self.forces)
        every = np.concatenate([self.o, self.j, self.x, self.e[:, :, None]], axis=2)
        response = ForceResponse(
            np.swapaxes(every, 1, 2) @ every, np.full(count, points), np.arange(s + 1) * 5, self.xi, DT,
            tuple(PortMotion(force) for force in self.forces), np.zeros(count, dtype=int), np.zeros((count, s * 5)),
            np.zeros((count, s * 5, 1)), len(self.forces) - 1,
        )  # fmt: skip
        return FittedWindows(response, self.z)


@pytest.fixture(scope="module", params=[(0, (1.0,)), (2, (1.0,)), (2, (1.0, 3.0)), (0, (0.2, 2.0, 1.0))])
def dense(request) -> Dense:
    rng = np.random.default_rng(3)
    n_z, forces = request.param
    pulses = 6 * len(forces)
    o, j, x = rng.normal(size=(4, 14, pulses)), rng.normal(size=(4, 14, n_z)), rng.normal(size=(4, 14, 2))
    e, xi, z = 0.7 * rng.normal(size=(4, 14)), 0.3 * rng.normal(size=(4, 2)), 0.5 * rng.normal(size=n_z)
    return Dense(o, j, x, e, xi, z, forces)


def profiled(e: np.ndarray, covariance: np.ndarray, mean: np.ndarray) -> float:
    """Return the log density at the best scale of the noise, without terms of the number of points alone."""
    scale = (e - mean) @ np.linalg.solve(covariance, e - mean) / len(e)
    density = multivariate_normal(mean, scale * covariance, allow_singular=False)
    return float(density.logpdf(e)) + 0.5 * len(e) * (1.0 + np.log(2.0 * np.pi))


def test_the_likelihood_of_a_random_force_is_that_of_the_dense_gaussian(dense):
    windows = dense.windows()
    levels = windows.levels(np.zeros((4, 6, 0)), np.array([0.0, 0.03, 0.3]))
    assert len(levels) == 1 + len(windows.bandwidths) * 2
    for level in levels:
        covariance, mean = dense.covariance(level.size, level.bandwidth, windows.weight)
        free = 4 * np.log(1.0 / START)  # of the initial states' prior, common to all; that of the parameters as well
        free -= 0.5 * len(dense.z) * np.log(windows.weight)
        assert level.alone == pytest.approx(profiled(dense.e.ravel(), covariance, mean) + free, rel=1e-8, abs=1e-8)


def test_the_force_along_the_windows_is_that_of_the_dense_gaussian(dense):
    windows = dense.windows()
    size, f = windows.alone.size or 10.0**-4.5, windows.alone.bandwidth
    kernel, _ = Dense(np.eye(len(dense.forces) * 6)[None], *(np.zeros((1, 6 * len(dense.forces), 0)),) * 2, np.zeros(
        (1, 6 * len(dense.forces))), np.zeros((1, 0)), np.zeros(0), dense.forces).covariance(size, f, 1.0)  # fmt: skip
    kernel = kernel - np.eye(len(kernel))
    found, std = windows.force_along()
    for w in range(4):
        total = np.eye(14) + dense.o[w] @ kernel @ dense.o[w].T + dense.x[w] @ dense.x[w].T / START
        gain = kernel @ dense.o[w].T @ np.linalg.inv(total)
        spread = np.diag(kernel - gain @ dense.o[w] @ kernel) * windows.alone.alone_q / windows.points
        assert found[w] == pytest.approx((gain @ (dense.e[w] + dense.x[w] @ dense.xi[w]))[-6:], rel=1e-5, abs=1e-9)
        assert std[w] == pytest.approx(np.sqrt(spread[-6:]), rel=1e-5)


def test_evidence_and_cross_validation_are_those_of_the_dense_gaussian(dense):
    windows = dense.windows()
    columns = np.random.default_rng(5).normal(size=(4, 6, 3))
    best = judged(windows, Family("speed", columns, price=1.5), 1, "v")
    e = dense.e.ravel()

    def of(level, strength):
        return dense.covariance(level.size, level.bandwidth, windows.weight, columns, strength)

    alone = max(profiled(e, *of(level, 0.0)) for level in [*windows.levels(columns), windows.alone])
    with_it = profiled(e, *of(best.level, best.strength))
    tried = 8  # strengths of the family: 10^-3.5 to 1 in half decades
    assert best.evidence == pytest.approx(with_it - alone - np.log(tried) - 1.5, abs=1e-7)

    def predictive(covariance, mean, scale):
        total = 0.0
        for w in range(4):
            own = np.arange(56) // 14 == w
            inner = np.linalg.solve(covariance[np.ix_(~own, ~own)], covariance[np.ix_(~own, own)])
            at = mean[own] + inner.T @ (e - mean)[~own]
            spread = covariance[np.ix_(own, own)] - covariance[np.ix_(own, ~own)] @ inner
            total += multivariate_normal(at, scale * spread).logpdf(e[own])
        return total

    expected = predictive(*of(best.level, best.strength), best.q / 56)
    expected -= predictive(*of(windows.alone, 0.0), windows.alone.alone_q / 56)
    assert best.cross_validated == pytest.approx(expected, abs=1e-7)


def test_forces_at_several_ports_are_distinguished():
    rng = np.random.default_rng(9)
    o, j, x = rng.normal(size=(30, 40, 18)), np.zeros((30, 40, 0)), rng.normal(size=(30, 40, 2))
    xi, z, forces, noise = np.zeros((30, 2)), np.zeros(0), (1.0, 1.0, 1.0), rng.normal(size=(30, 40))
    sizes = np.repeat([0.1, 1.0, 0.0], 6)[:, None]
    uneven = Dense(o, j, x, (o @ (sizes * rng.normal(size=(30, 18, 1))))[:, :, 0] + noise, xi, z, forces).windows()
    assert uneven.strongest() == [1, 0, 2]
    errors = (o @ (0.5 * rng.normal(size=(30, 18, 1))))[:, :, 0] + noise
    everywhere = Dense(o, j, x, errors, xi, z, forces).windows()
    assert everywhere.log_likelihood > Dense(o[:, :, :6], j, x, errors, xi, z).windows().log_likelihood + 100.0
    assert everywhere.alone.size == pytest.approx(0.5, rel=0.4)
    assert everywhere.alone.alone_q / errors.size == pytest.approx(1.0, rel=0.2)


# --- on records ------------------------------------------------------------------------------------------------------


def measured(extra, noise=2e-5, seconds=6.0, seed=0) -> rl.Record:
    """Simulate the axis with a force ``extra(t, q, v)`` in N by a Runge-Kutta method; position with noise."""
    rng = np.random.default_rng(seed)
    t = np.arange(round(seconds / DT)) * DT
    u = 1.5 * np.sin(2 * np.pi * 0.9 * t) + np.repeat(rng.choice([-1.0, 1.0], len(t) // 100), 100)

    def rate(now, held, q, v):
        return np.array([v, (GAIN * held - FV * v + extra(now, q, v)) / M])

    q, x = np.zeros(len(t)), np.zeros(2)
    for k, now in enumerate(t):
        q[k] = x[0]
        a = rate(now, u[k], *x)
        b = rate(now + DT / 2, u[k], *(x + DT / 2 * a))
        c = rate(now + DT / 2, u[k], *(x + DT / 2 * b))
        x = x + DT / 6 * (a + 2 * b + 2 * c + rate(now + DT, u[k], *(x + DT * c)))
    return rl.Record(t, {"u": u}, {"q": q + noise * rng.normal(size=len(t))}, {"u": "V", "q": "m"})


def fitted(record: rl.Record):
    problem, _ = problem_of(record, length=200)
    zero = np.zeros(len(problem.nuisances))
    return problem, problem.fit(Hypothesis(()), first_noise(problem), zero, plan=FitPlan(10))


def test_the_response_of_a_mass_to_a_pulse_is_the_closed_form():
    problem, fit = fitted(measured(lambda t, q, v: 0.0))
    response = force_response(problem, fit, plain_places(problem, fit))
    record = problem.records[0]
    factors, _ = problem.split(fit.hypothesis, fit.z)
    mass, damping = M * factors["M"], FV * factors["Fv"]

    def moved(t, push):  # position of the mass at rest, pushed by one newton for a time
        tau = mass / damping

        def step(s):
            s = np.maximum(s, 0.0)
            return (s - tau * (1.0 - np.exp(-s / tau))) / damping

        return step(t) - step(t - push)

    first, width = response.edges[7], response.edges[8] - response.edges[7]
    t = DT * (np.arange(200) - first)
    y = np.where(t > 0, moved(t, DT * width), 0.0)[10:]
    points = y[: len(y) // record.thin * record.thin].reshape(-1, record.thin).mean(axis=1)
    single = max(record.smoothed.noise_std[0], record.resolution[0] / np.sqrt(12)) / np.sqrt(record.thin)
    assert response.gram[3, 7, 7] == pytest.approx(np.sum((points / single) ** 2), rel=1e-6)


def left_by(problem, fit):
    return unnamed_force(*fitted_windows(problem, fit)[0])


def test_no_force_is_significant_for_a_complete_model():
    problem, fit = fitted(measured(lambda t, q, v: 0.0))
    left = left_by(problem, fit)
    assert not any(force.wins for force in left.forces)
    assert left.noise_ratio < 1.1


def test_a_ripple_over_time_is_found_with_its_period_and_amplitude():
    problem, fit = fitted(measured(lambda t, q, v: 1.2 * np.cos(2 * np.pi * 7.0 * t + 1.0)))
    left = left_by(problem, fit)
    best = left.forces[0]
    assert best.wins
    assert best.over == "line over time"
    assert best.period == pytest.approx(1.0 / 7.0, rel=0.01)
    assert np.hypot(*best.wave) == pytest.approx(1.2, abs=0.12)


def test_a_friction_over_speed_is_found():
    problem, fit = fitted(measured(lambda t, q, v: -3.0 * np.tanh(v / 2e-3)))
    best = left_by(problem, fit).forces[0]
    assert best.wins
    assert best.over == "speed"
    force = residual_force(problem.plant, fitted_windows(problem, fit))
    curve = force.curves["speed"]
    assert force.unit == "N"
    assert curve.share > 0.7
    # The refitted viscous friction takes a part of it, which is linear in the speed.
    jump, _ = np.linalg.lstsq(np.column_stack([np.sign(curve.x), curve.x]), curve.value, rcond=None)[0]
    assert jump == pytest.approx(-3.0, abs=0.5)
