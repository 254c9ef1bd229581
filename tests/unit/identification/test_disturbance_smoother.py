"""The smoother against an independent dense Gaussian estimate, and against known torques."""

import numpy as np
import pytest
from scipy.linalg import expm

from robustlab import InputError, StateSpaceModel, simulate
from robustlab.identification import smooth_disturbance

J, FRICTION, K, R, L = 2e-4, 1e-5, 0.05, 1.0, 3e-4
H = 1e-3


def motor(outputs=("phi",)):
    """Return a motor with an electrical time constant of 0.3 ms and an integrator."""
    a = [[0, 1, 0], [0, -FRICTION / J, K / J], [0, -K / L, -R / L]]
    rows = {"phi": [1, 0, 0], "omega": [0, 1, 0], "i": [0, 0, 1]}
    return StateSpaceModel(
        a,
        [[0], [0], [1 / L]],
        [rows[name] for name in outputs],
        np.zeros((len(outputs), 1)),
        inputs=[("u", "V")],
        outputs=list(outputs),
        states=["phi", "omega", "i"],
    )


PORT = np.array([[0.0], [1 / J], [0.0]])


def record(model, t, u, torque, noise, seed=0):
    """Simulate outputs and states of the model with the torque at its port."""
    wide = StateSpaceModel(
        model.A,
        np.hstack([model.B, PORT]),
        np.vstack([model.C, np.eye(3)]),
        np.zeros((model.n_outputs + 3, 2)),
    )
    y = np.column_stack(list(simulate(wide, t, {"u1": u, "u2": torque}).outputs.values()))
    rng = np.random.default_rng(seed)
    clean, x = y[:, : model.n_outputs], y[:, model.n_outputs :]
    return clean + np.asarray(noise) * rng.standard_normal(clean.shape), x


def intensities(model, ports, h, sigma, f):
    """Return the intensities of forces observable below the frequency f: (2 pi f)^2 over the squared gain in noise."""
    gain = model.C @ np.linalg.solve(2j * np.pi * f * np.eye(model.n_states) - model.A, ports)
    return (2 * np.pi * f) ** 2 / (np.abs(gain) ** 2 / (sigma[:, None] ** 2 * h)).sum(axis=0)


def dense(model, ports, h, u, y, sigma, q, start, rounding):
    """Return the posterior of all states and forces by one solve of the joint Gaussian of the record."""
    n, n_x, m = len(u), model.n_states, ports.shape[1]
    n_z = n_x + m
    f = np.zeros((n_z, n_z))
    f[:n_x, :n_x], f[:n_x, n_x:] = model.A, ports
    b = np.vstack([model.B, np.zeros((m, model.n_inputs))])
    block = np.zeros((2 * n_z, 2 * n_z))  # Van Loan's block exponential
    block[:n_z, :n_z], block[n_z:, n_z:] = -f * h, f.T * h
    block[n_x:n_z, n_z + n_x :] = np.diag(q) * h
    e = expm(block)
    phi = e[n_z:, n_z:].T
    noise = phi @ e[:n_z, n_z:] + np.diag((rounding * start) ** 2)
    gamma = expm(np.block([[f * h, b * h], [np.zeros((model.n_inputs, n_z + model.n_inputs))]]))[:n_z, n_z:]
    mean, power = [np.zeros(n_z)], [np.eye(n_z)]
    for k in range(n - 1):
        mean.append(phi @ mean[-1] + gamma @ u[k])
        power.append(phi @ power[-1])
    prior = np.zeros((n, n, n_z, n_z))
    p = np.diag(start**2)
    for k in range(n):
        for i in range(k, n):
            prior[i, k] = power[i - k] @ p
            prior[k, i] = prior[i, k].T
        p = phi @ p @ phi.T + noise
    big = prior.transpose(0, 2, 1, 3).reshape(n * n_z, n * n_z)
    rows = np.kron(np.eye(n), np.hstack([model.C, np.zeros((model.n_outputs, m))]))
    seen = np.isfinite(y).ravel()
    rows, value = rows[seen], y.ravel()[seen]
    cross = big @ rows.T
    gain = np.linalg.solve(rows @ cross + np.diag(np.tile(sigma**2, n)[seen]), cross.T).T
    centre = np.concatenate(mean)
    found, cov = centre + gain @ (value - rows @ centre), big - gain @ cross.T
    pieces = [slice(k * n_z, (k + 1) * n_z) for k in range(n)]
    return found.reshape(n, n_z), np.stack([cov[piece, piece] for piece in pieces])


@pytest.mark.parametrize("m", [1, 2])
def test_equals_the_dense_gaussian_posterior(m, monkeypatch):
    # A prior wide enough to be negligible, and narrow enough for the digits of the dense solve.
    monkeypatch.setattr("robustlab.identification.greybox.disturbance_smoother.START_FACTOR", 1e3)
    rng = np.random.default_rng(3)
    a = np.array([[0.0, 1.0, 0.0], [-2.0, -0.4, 0.3], [0.5, 0.0, -3.0]])
    model = StateSpaceModel(a, [[0.0], [1.0], [0.2]], [[1, 0, 0], [0, 0, 1]], [[0.0], [0.5]])
    ports = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 2.0]])[:, :m]
    n, h = 40, 0.1
    t, u = h * np.arange(n), rng.standard_normal((n, 1))
    y = np.cumsum(rng.standard_normal((n, 2)), axis=0)
    y[5, 0] = y[9] = np.nan
    y[20:23, 1] = np.nan
    sigma = np.array([0.3, 0.2])
    found = smooth_disturbance(model, ports, t, u, y, sigma, bandwidth=0.8)
    start = np.full(3 + m, 1e4)
    mean, cov = dense(
        model, ports, h, u, y - u @ model.D.T, sigma, intensities(model, ports, h, sigma, 0.8), start, 0.0
    )
    std = np.sqrt(np.diagonal(cov, axis1=1, axis2=2))
    np.testing.assert_allclose(found.x, mean[:, :3], atol=1e-5 * np.abs(mean).max())
    np.testing.assert_allclose(found.d, mean[:, 3:], atol=1e-5 * np.abs(mean).max())
    np.testing.assert_allclose(found.x_std, std[:, :3], rtol=1e-5)
    np.testing.assert_allclose(found.d_std, std[:, 3:], rtol=1e-5)
    np.testing.assert_allclose(found.covariance, cov[:, :3, :3], atol=1e-5 * cov[:, :3, :3].max())


def test_a_linear_plant_without_disturbance_has_no_residual_force():
    t = H * np.arange(4000)
    u = np.repeat(np.random.default_rng(5).uniform(-3, 3, 80), 50)
    inside = []
    for seed in range(8):
        y, _ = record(motor(), t, u, np.zeros(4000), 1e-3, seed)
        found = smooth_disturbance(motor(), PORT, t, u[:, None], y)
        inside.append(np.abs(found.d[:, 0]) < 3 * found.d_std[:, 0])
        assert found.noise_std[0] == pytest.approx(1e-3, rel=0.05)
    assert np.mean(inside) > 0.97


def test_a_sinusoidal_load_and_the_unmeasured_states_are_recovered():
    t = H * np.arange(5000)
    u = np.repeat(np.random.default_rng(6).uniform(-3, 3, 100), 50)
    torque = 0.01 * np.sin(2 * np.pi * 2.0 * t)
    y, x = record(motor(("phi", "i")), t, u, torque, [1e-3, 0.02])
    found = smooth_disturbance(motor(("phi", "i")), PORT, t, u[:, None], y)
    error = (found.d[:, 0] - torque) / found.d_std[:, 0]
    assert np.mean(np.abs(error) < 3) > 0.98
    assert np.sqrt(np.mean((found.d[200:-200, 0] - torque[200:-200]) ** 2)) < 0.1 * np.std(torque)
    np.testing.assert_allclose(found.noise_std, [1e-3, 0.02], rtol=0.05)
    assert np.mean(np.abs(found.x - x) < 3 * found.x_std) > 0.98


def test_an_unobservable_state_has_its_prior_std():
    t = H * np.arange(2000)
    y, _ = record(motor(("omega",)), t, np.ones(2000), np.zeros(2000), 0.01)
    found = smooth_disturbance(motor(("omega",)), PORT, t, np.ones((2000, 1)), y)
    assert np.isfinite(found.x_std).all()
    assert (found.x_std[:, 0] > np.ptp(y) * 2.0).all()
    assert found.x_std[500, 1] < 0.01


def test_gaps_are_bridged_with_wider_bands():
    t = H * np.arange(3000)
    torque = 0.01 * np.sin(2 * np.pi * t)
    y, x = record(motor(), t, np.zeros(3000), torque, 1e-3)
    y[1000:1100] = np.nan
    found = smooth_disturbance(motor(), PORT, t, np.zeros((3000, 1)), y)
    assert found.x_std[1050, 0] > 3 * found.x_std[500, 0]
    assert (np.abs(found.x[1000:1100, 0] - x[1000:1100, 0]) < 4 * found.x_std[1000:1100, 0]).all()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"ports": np.zeros((3, 1))}, "no output responds"),
        ({"y": np.full((100, 1), np.nan)}, "0 samples"),
    ],
)
def test_bad_input_is_an_error(change, message):
    usual = {"model": motor(), "ports": PORT, "t": H * np.arange(100), "u": np.zeros((100, 1)), "y": np.ones((100, 1))}
    with pytest.raises(InputError, match=message):
        smooth_disturbance(**(usual | change))
