"""Energy is never created, the samples do not matter, and a crude time-stepping scheme converges to the same motion."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

import robustlab as rl
from robustlab.dynamics.dry_friction import DryFriction, simulate_with_friction

M, K = np.array([1.0, 0.5, 2.0]), np.array([40.0, 10.0, 25.0])  # a chain on the wall
numbers = st.floats(-1.0, 1.0)


def chain():
    return rl.plant("mass-spring-damper", m=M.tolist(), c=[0.0, 0.0, 0.0], k=K.tolist())


def states(plant, q, v):
    values = {f"q{i + 1}": q[i] for i in range(3)} | {f"v{i + 1}": v[i] for i in range(3)}
    return [values[s.name] for s in plant.states]


def energy(found):
    r = found.record
    q = np.column_stack([np.zeros(r.n), *(r[f"q{i}"] for i in (1, 2, 3))])
    v = np.column_stack([r[f"v{i}"] for i in (1, 2, 3)])
    return (v**2 @ M + np.diff(q, axis=1) ** 2 @ K) / 2


@settings(max_examples=12, deadline=None, derandomize=True)
@given(
    q=st.tuples(numbers, numbers, numbers),
    v=st.tuples(numbers, numbers, numbers),
    coulomb=st.tuples(*[st.floats(0.0, 3.0)] * 3),
    extra=st.floats(1.0, 2.0),
)
def test_free_motion_only_loses_energy_and_ends(q, v, coulomb, extra):
    plant, t = chain(), np.linspace(0, 8, 161)
    friction = [DryFriction(f"v{i + 1}", f, static=extra * f) for i, f in enumerate(coulomb)]
    found = simulate_with_friction(plant, friction, t, np.zeros((len(t), 3)), x0=states(plant, q, v))
    total = energy(found)
    assert (np.diff(total) <= 1e-12 * (1 + total[0])).all()
    held = found.sliding == 0
    rates = np.column_stack([found.record[f"v{i}"] for i in (1, 2, 3)])
    assert (rates[held] == 0).all()
    limits = np.where(held, extra * np.array(coulomb), coulomb)
    assert (np.abs(found.force) <= limits * (1 + 1e-11) + 1e-15).all()
    sliding = rates != 0
    assert (np.sign(found.force[sliding]) == -np.sign(rates[sliding]) * (limits[sliding] > 0)).all()


def test_all_at_rest_stays_at_rest_bit_by_bit():
    plant, t = chain(), np.linspace(0, 5, 101)
    friction = [DryFriction(f"v{i}", 2.0) for i in (1, 2, 3)]
    found = simulate_with_friction(plant, friction, t, np.tile([1.0, -1.5, 0.5], (101, 1)))
    assert not found.events
    assert (found.x == 0).all()
    assert np.count_nonzero(np.diff(np.sign(found.x), axis=0)) == 0


def test_samples_do_not_matter():
    plant = chain()
    friction = [DryFriction("v1", 0.6, 0.9), DryFriction("v3", 0.4)]
    start = states(plant, [0.3, -0.2, 0.5], [0.0, 1.0, -0.3])
    fine, coarse = np.linspace(0, 6, 1201), np.linspace(0, 6, 31)
    uneven = np.unique(np.concatenate([coarse, np.random.default_rng(1).uniform(0, 6, 40)]))
    results = [
        simulate_with_friction(plant, friction, t, np.zeros((len(t), 3)), x0=start) for t in (fine, coarse, uneven)
    ]
    np.testing.assert_allclose(results[0].x[::40], results[1].x, atol=1e-11)
    np.testing.assert_allclose(results[2].x[np.isin(uneven, coarse)], results[1].x, atol=1e-11)
    times = [[e.time for e in r.events] for r in results]
    assert len(times[0]) > 10
    np.testing.assert_allclose(times[0], times[1], atol=1e-10)
    np.testing.assert_allclose(times[0], times[2], atol=1e-10)
    assert [e.becomes for e in results[0].events] == [e.becomes for e in results[1].events]


def time_stepping(t_end, steps, q, v, coulomb):
    """Moreau's scheme: implicit in the friction impulses, each projected onto its interval."""
    h = t_end / steps
    q, v = np.array(q), np.array(v)
    stiffness = np.array([[K[0] + K[1], -K[1], 0], [-K[1], K[1] + K[2], -K[2]], [0, -K[2], K[2]]])
    for _ in range(steps):
        free = v - h / M * (stiffness @ (q + h / 2 * v))
        v_next = free + h / M * np.clip(-free * M / h, -coulomb, coulomb)
        q = q + h * (v + v_next) / 2
        v = v_next
    return np.concatenate([q, v])


def test_time_stepping_converges_to_it():
    plant, coulomb = chain(), np.array([1.5, 0.7, 0.4])
    q, v = [0.3, -0.2, 0.5], [0.0, 1.0, -0.3]
    t = np.linspace(0, 2, 41)
    friction = [DryFriction(f"v{i + 1}", f) for i, f in enumerate(coulomb)]
    found = simulate_with_friction(plant, friction, t, np.zeros((41, 3)), x0=states(plant, q, v))
    assert len(found.events) > 6
    exact = np.array([found.record[name][-1] for name in ("q1", "q2", "q3", "v1", "v2", "v3")])
    errors = [np.abs(time_stepping(2.0, n, q, v, coulomb) - exact).max() for n in (2000, 16000)]
    assert errors[1] < 2e-3
    assert errors[1] < errors[0] / 4  # first order: a factor of 8
