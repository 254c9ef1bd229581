"""Force laws evaluated directly (each solves its own equation at any stiffness and step), and closed forms."""

import ctypes
import itertools
import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.special import ellipk

import robustlab as rl
from robustlab.dynamics import Simulator, Site, Windows, effect

MASS = 2.0


def _ask(law, *numbers):
    """The compiled law, called by the addresses of its numbers as the stepping does."""
    return law.ctypes(*(a.ctypes.data_as(ctypes.POINTER(ctypes.c_double)) for a in numbers))


class Step:
    """One step of length h of a mass: initial motion, drive, and the result of a law."""

    def __init__(self, law, p, q0=0.0, v0=0.0, drive=0.0, h=5e-4, z=0.0, mass=MASS, time=0.0):
        self.gv, self.gq = h / mass, 0.5 * h * h / mass
        self.q0, self.v0, self.h, self.drive = q0, v0, h, drive
        free_q, free_v = q0 + h * v0 + self.gq * drive, v0 + self.gv * drive
        after = np.array([z])
        seen = np.array([q0, v0, free_q, free_v, self.gq, self.gv, h, time])
        self.f = _ask(effect(law).force, np.array(p, dtype=float), np.array([z]), after, seen)
        self.q, self.v, self.z = free_q + self.gq * self.f, free_v + self.gv * self.f, after[0]
        self.velocity_rounding = 1e-13 * (abs(v0) + abs(free_v) + self.gv * abs(self.f))
        self.work = self.f * (self.q - q0)


signed = st.floats(-1e3, 1e3).map(lambda x: 0.0 if abs(x) < 1e-6 else x)
positive = st.floats(-6, 6).map(lambda e: 10.0**e)
steps = st.sampled_from([1e-5, 5e-4, 1e-2])
# The same examples in every run of one version of hypothesis.
many = settings(max_examples=100)


@many
@given(positive, signed, steps)
def test_a_resting_mass_stays_exactly_at_rest_below_breakaway_and_leaves_above(level, drive, h):
    s = Step("coulomb-friction", [level], drive=drive, h=h)
    if abs(drive) <= level:
        assert s.v == 0.0
    else:
        assert s.f == pytest.approx(-math.copysign(level, drive), rel=1e-9, abs=1e-12 * abs(drive))


@many
@given(signed, signed, positive, steps)
def test_dry_friction_within_a_step_is_the_exact_motion_under_a_constant_drive(v0, drive, level, h):
    assume(abs(abs(drive) - level) > 1e-9 * level)

    def moved(v, left):
        """End velocity: slide until the velocity is zero, then stick or go on."""
        way = math.copysign(1.0, v or drive)
        if v == 0.0 and abs(drive) <= level:
            return 0.0
        rate = (drive - way * level) / MASS
        if v + rate * left > 0 if way > 0 else v + rate * left < 0:
            return v + rate * left
        return 0.0 if v == 0.0 else moved(0.0, left + v / rate)

    s = Step("coulomb-friction", [level], v0=v0, drive=drive, h=h)
    assert s.v == pytest.approx(moved(v0, h), rel=1e-9, abs=1e-9 * (abs(v0) + s.gv * (abs(drive) + level)))


@many
@given(st.floats(-3, 9).map(lambda e: 10.0**e), st.floats(0, 1e3), st.floats(-2, 2), signed, signed, steps)
def test_a_stop_never_pulls_never_creates_energy_and_lets_go(kc, dc, q0, v0, drive, h):
    s = Step("end-stop", [-1.0, 1.0, kc, dc], q0=q0, v0=v0, drive=drive, h=h)

    def stored(q):
        return 0.5 * kc * max(abs(q) - 1.0, 0.0) ** 2

    inside = max(abs(q0), abs(s.q)) <= 1.0
    assert not (inside and s.f != 0.0)
    if q0 > -1.0 and s.q > -1.0:
        assert s.f <= 0.0
    if q0 < 1.0 and s.q < 1.0:
        assert s.f >= 0.0
    if dc == 0.0 and abs(s.q - q0) < 2.0:
        rounding = 1e-9 * (stored(q0) + stored(s.q) + abs(s.f) * (abs(q0) + h * abs(v0) + s.gq * abs(s.f)))
        assert s.work <= stored(q0) - stored(s.q) + rounding + 1e-12


def mass(effects, values, n, h, x0=(0.0, 0.0), force=None, t0=0.0, c=0.0):
    """States (n, 2) and forces (n, laws) of a free mass with effects at its joint."""
    plant = rl.plant("mass-spring-damper", m=MASS, c=c, k=0.0)
    pairs = [(effect(name), Site("joint", "v")) for name in effects]
    u = np.zeros(n) if force is None else force
    motion = Simulator(plant, pairs, u[:, None], h, t0).run({}, values, np.array([x0]), Windows(np.array([0]), n))
    return motion.states[0], motion.forces[0]


def test_stribeck_breakaway_level_and_stopping_time():
    values = {"Fc": 2.0, "dF": 3.0, "vs": 0.5}
    ramp = np.arange(4000) * 1e-3 * 2.0
    states, force = mass(["stribeck-friction"], [values], 4000, 1e-3, force=ramp)
    first = np.flatnonzero(states[:, 1])[0]
    assert 5.0 < ramp[first - 1] <= 5.0 + 2.0e-3 * (1 + 1e-9)  # breaks away with the first force above Fc + dF
    assert force[-1, 0] == pytest.approx(-2.0, abs=1e-6)  # and slides at Fc

    def friction(v):
        return 2.0 + 3.0 * math.exp(-((v / 0.5) ** 2))

    states, _ = mass(["stribeck-friction"], [values], 3000, 1e-3, x0=(0.0, 2.0))
    time = quad(lambda v: MASS / friction(v), 0, 2.0)[0]
    way = quad(lambda v: MASS * v / friction(v), 0, 2.0)[0]
    assert np.flatnonzero(states[:, 1] == 0)[0] * 1e-3 == pytest.approx(time, abs=1e-3)
    assert states[-1, 0] == pytest.approx(way, rel=1e-6)


def test_presliding_hysteresis_loop_has_the_area_of_dahls():
    level, stiffness, a = 2.0, 1e4, 5e-4
    limit, n = level / stiffness, 4000
    q = a * np.sin(2 * np.pi * np.arange(3 * n) / n)
    z, f = 0.0, []
    for here, there in itertools.pairwise(q):
        s = Step("presliding", [level, stiffness], v0=(there - here) / 1e-3, h=1e-3, z=z, mass=1e12)
        z = s.z
        f.append(s.f)
    area = -np.sum((f * np.diff(q))[n : 2 * n])
    x = a / limit
    assert area == pytest.approx(4 * level * (a - limit * math.tanh(x)), rel=3e-3)
    assert max(f[n:]) == pytest.approx(level * math.tanh(x), rel=1e-6)


@pytest.mark.parametrize("v0", [0.5, 4.0])  # caught in a well, and running over the crests
def test_cogging_keeps_the_energy(v0):
    values = {"Ac": 3.0, "As": 1.0, "k": 7.0}
    states, _ = mass(["cogging"], [values], 20000, 1e-3, x0=(0.0, v0))
    q, v = states.T
    energy = 0.5 * MASS * v**2 - (3.0 * np.sin(7 * q) - 1.0 * np.cos(7 * q)) / 7
    np.testing.assert_allclose(energy, energy[0], rtol=1e-9)
    assert np.ptp(q) < 2 if v0 < 1 else np.ptp(q) > 50


def test_a_cubic_spring_swings_with_duffings_period_and_keeps_the_energy():
    k3, a = 40.0, 0.3
    states, _ = mass(["cubic-stiffness"], [{"k3": k3}], 40000, 1e-3, x0=(a, 0.0))
    q, v = states.T
    energy = 0.5 * MASS * v**2 + k3 * q**4 / 4
    np.testing.assert_allclose(energy, energy[0], rtol=1e-9)
    down = np.flatnonzero((q[:-1] > 0) & (q[1:] <= 0))
    crossing = 1e-3 * (down + q[down] / (q[down] - q[down + 1]))
    period = 4 * ellipk(0.5) / (a * math.sqrt(k3 / MASS))
    assert np.diff(crossing).mean() == pytest.approx(period, rel=1e-4)


def test_stops_hold_a_load_and_return_what_their_damping_leaves():
    stop = {"q_min": -1.0, "q_max": 1.0, "kc": 500.0, "dc": 0.0}
    states, _ = mass(["end-stop"], [stop], 20000, 1e-3, x0=(0.0, 2.0))
    assert states[-1, 1] ** 2 == pytest.approx(4.0, rel=1e-6) or abs(states[-1, 0]) > 1.0
    inside = np.abs(states[:, 0]) < 0.99
    np.testing.assert_allclose(np.abs(states[inside, 1]), 2.0, rtol=1e-6)
    assert np.abs(states[:, 0]).max() == pytest.approx(1 + 2.0 * math.sqrt(MASS / 500.0), rel=1e-3)
    # A damped impact that lets go where spring and damper no longer push: Kelvin-Voigt's restitution.
    zeta = 0.3
    damped = {**stop, "dc": 2 * zeta * math.sqrt(500.0 * MASS)}
    states, _ = mass(["end-stop"], [damped], 12000, 1e-4, x0=(0.9, 2.0))
    swing = math.sqrt(1 - zeta**2)
    expected = math.exp(-zeta / swing * math.atan2(2 * zeta * swing, 2 * zeta**2 - 1))
    after = states[np.flatnonzero(states[:, 1] < 0)[-1], 1] if states[-1, 0] < 0.9 else states[-1, 1]
    assert -after / 2.0 == pytest.approx(expected, rel=0.01)
    states, _ = mass(["end-stop"], [damped], 20000, 1e-3, force=np.full(20000, 50.0))
    assert states[-1] == pytest.approx([1.0 + 50.0 / 500.0, 0.0], abs=1e-9)


@pytest.mark.parametrize("amplitude", [0.3, 2.0, 50.0])
def test_footprints_of_dry_laws_are_describing_functions(amplitude):
    values = {"Fc": 2.0, "dF": 3.0, "vs": 1.5}

    def first_harmonic(friction):
        return quad(lambda a: friction(amplitude * math.sin(a)) * math.sin(a), 0, math.pi)[0] / (
            0.5 * math.pi * amplitude
        )

    found = effect("stribeck-friction").footprint(Site("joint", "v"), values, amplitude)
    expected = first_harmonic(lambda v: 2.0 + 3.0 * math.exp(-((v / 1.5) ** 2)))
    assert found.gain_upper == pytest.approx(expected, rel=1e-6)
    found = effect("coulomb-friction").footprint(Site("joint", "v"), {"Fc": 2.0}, amplitude)
    assert found.gain_upper == pytest.approx(first_harmonic(lambda v: 2.0), rel=1e-9)
    found = effect("brush-drop").footprint(Site("current", "i"), {"Vb": 2.0}, amplitude)
    assert found.gain_upper == pytest.approx(first_harmonic(lambda v: 2.0), rel=1e-9)


def test_footprints_of_smooth_laws_are_their_sectors():
    a = 3.0
    x = np.concatenate([np.linspace(-a, -1e-6, 501), np.linspace(1e-6, a, 501)])
    for name, values, force in (
        ("quadratic-drag", {"c": 0.4}, 0.4 * x * np.abs(x)),
        ("asymmetric-viscous-friction", {"dFv": -0.4}, -0.4 * np.abs(x)),
        ("cubic-stiffness", {"k3": -0.4}, -0.4 * x**3),
    ):
        found = effect(name).footprint(Site("joint", "v"), values, a)
        assert (force / x).min() == pytest.approx(found.gain_lower, abs=1e-6)
        assert (force / x).max() == pytest.approx(found.gain_upper, abs=1e-6)
    slope = -0.3 * 5 * np.cos(5 * x) + 0.4 * 5 * np.sin(5 * x)
    found = effect("cogging").footprint(Site("joint", "v"), {"Ac": 0.4, "As": 0.3, "k": 5.0}, a)
    assert (slope.min(), slope.max()) == pytest.approx((found.gain_lower, found.gain_upper), rel=1e-4)
    assert found.offset == pytest.approx(0.5)
