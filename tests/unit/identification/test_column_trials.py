"""Which unnamed column is which signal: records of textbook equations, made by scipy, with parameters that are off."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import robustlab as rl
from robustlab.identification.record_check.column_mapping import propose_columns

T = np.arange(800) * 2e-3
BARE = "abcdefg"


def moved(rates, order, u):
    """States at the samples, the input held between them."""
    x = [np.zeros(order)]
    for a, b, held in zip(T[:-1], T[1:], u[:-1], strict=True):
        run = solve_ivp(lambda _, x, held=held: rates(x, held), (a, b), x[-1], rtol=1e-7, atol=1e-9)
        x.append(run.y[:, -1])
    return np.array(x)


def excitation(rng, kind, size, period):
    if kind == "steps":
        return size * np.repeat(rng.uniform(-1, 1, 20), 40)
    if kind == "sine":
        return size * np.sin(2 * np.pi * T / period)
    return size * sum(np.sin(2 * np.pi * k * T / (3 * period) + rng.uniform(0, 6)) for k in (1, 2, 3, 5, 8)) / 2.5


def columns(name, rng, kind, off, dry):
    """Signal -> samples of a machine whose parameters are off, with dry friction that the model does not know."""

    def made(*values):
        return np.array(values) * (1 + rng.uniform(-off, off, len(values)))

    if name == "dc-motor":
        R, L, K, J, F = made(2.07, 0.62e-3, 0.052, 7.2e-6, 4.8e-5)
        u = excitation(rng, kind, 12.0, 0.5)

        def rates(x, v):
            return [x[1], (K * x[2] - F * x[1] - dry * 12e-3 * np.tanh(x[1])) / J, (v - R * x[2] - K * x[1]) / L]

        known, noise, order = ("u", "phi", "omega", "i"), (1e-3, 0.3, 0.02), 3
    elif name == "servo-axis":
        M, F, gain = made(95.1089, 203.5034, 35.15065)
        u = excitation(rng, kind, 4.0, 0.6)

        def rates(x, v):
            return [x[1], (gain * v - F * x[1] - dry * 20.0 * np.tanh(x[1] / 1e-3)) / M]

        known, noise, order = ("u", "q", "v"), (1e-5, 1e-3), 2
    elif name == "two-mass":
        J1, J2, c, k = made(1e-3, 2e-3, 2e-3, 10.0)
        u = excitation(rng, kind, 0.3, 0.4)

        def rates(x, v):
            twist = c * (x[2] - x[3]) + k * (x[0] - x[1])
            return [x[2], x[3], (v - twist) / J1, (twist - dry * 0.05 * np.tanh(x[3] / 0.2)) / J2]

        known, noise, order = ("torque", "phi1", "phi2"), (1e-4, 1e-4), 4
    else:
        m, c, k = made(1.0, 1.0, 100.0)
        u = excitation(rng, kind, 20.0, 0.6)

        def rates(x, v):
            return [x[1], (v - c * x[1] - k * x[0] - dry * 3.0 * np.tanh(x[1] / 0.01)) / m]

        known, noise, order = ("f", "q", "v"), (1e-4, 1e-2), 2
    x = moved(rates, order, u)[:, : len(noise)]
    return dict(zip(known, [u, *(x + np.array(noise) * rng.normal(size=x.shape)).T], strict=True))


def bare(signals, rng):
    """A record of the columns in some order under names that say nothing, and which is which."""
    order = list(signals)
    rng.shuffle(order)
    names = dict(zip(order, BARE, strict=False))
    return rl.Record(T, {}, {names[s]: signals[s] for s in order}, {}, "bare"), names


MACHINES = ("dc-motor", "servo-axis", "two-mass", "mass-spring-damper")


@pytest.mark.parametrize("machine", MACHINES)
@pytest.mark.parametrize("kind", ["tones", "steps", "sine"])
@pytest.mark.parametrize("dry", [0.0, 1.0])
def test_shuffled_columns_without_names_are_recognised(machine, kind, dry):
    """What is called sure is right; all is right, where it is undecided by the first that is named."""
    rng = np.random.default_rng([MACHINES.index(machine), len(kind), int(dry)])
    plant = rl.plant(machine)
    signals = columns(machine, rng, kind, 0.15, dry)
    for _ in range(3):
        record, names = bare(signals, rng)
        found = propose_columns(record, plant.inputs, plant.outputs, (), plant)
        assert {**found.inputs, **found.outputs} == names
        assert not found.left
        assert not found.missing
        assert all("by simulation: the model leaves" in found.reasons[s] for s in names)
        unsure = {line.split()[0] for line in found.undecided}
        assert unsure <= ({"phi1", "phi2"} if machine == "two-mass" else set())  # nearly alike below the resonance


def test_two_alike_columns_stay_undecided():
    """A stiff shaft: which end is which cannot be seen, and it is said."""
    rng = np.random.default_rng(3)
    signals = columns("two-mass", rng, "steps", 0.2, 1.0)
    record, names = bare(signals, rng)
    plant = rl.plant("two-mass")
    found = propose_columns(record, plant.inputs, plant.outputs, (), plant)
    assert found.inputs == {"torque": names["torque"]}
    assert {line.split()[0] for line in found.undecided} == {"phi1", "phi2"}
    assert all("the model follows both ways" in line for line in found.undecided)


def test_a_column_that_the_model_knows_nothing_of_is_left_over():
    rng = np.random.default_rng(4)
    signals = columns("servo-axis", rng, "tones", 0.1, 0.0)
    record, names = bare({**signals, "temperature": 20 + np.cumsum(rng.normal(size=len(T)))}, rng)
    plant = rl.plant("servo-axis")
    found = propose_columns(record, plant.inputs, plant.outputs, (), plant)
    assert {**found.inputs, **found.outputs} == {s: names[s] for s in signals}
    assert found.left == (names["temperature"],)
    assert not found.undecided


def test_names_and_units_come_first():
    """A column in volts is the voltage, whatever the model would like."""
    rng = np.random.default_rng(5)
    signals = columns("dc-motor", rng, "tones", 0.1, 0.0)
    named = {"a": signals["i"], "speed": signals["omega"], "c": signals["u"], "d": np.rad2deg(signals["phi"])}
    record = rl.Record(T, {}, named, {"c": "V", "d": "deg"}, "part")
    plant = rl.plant("dc-motor")
    found = propose_columns(record, plant.inputs, plant.outputs, (), plant)
    assert found.inputs == {"u": "c"}
    assert found.outputs == {"phi": "d", "omega": "speed", "i": "a"}
    assert found.reasons["u"].startswith("in V")
    assert "by simulation" in found.reasons["i"]


def test_the_last_column_left_is_no_signal_that_it_does_not_follow():
    rng = np.random.default_rng(7)
    signals = columns("dc-motor", rng, "tones", 0.1, 0.0)
    named = {"u": signals["u"], "phi": signals["phi"], "omega": signals["omega"], "z": rng.normal(size=len(T))}
    plant = rl.plant("dc-motor")
    found = propose_columns(rl.Record(T, {}, named, {}, "noise"), plant.inputs, plant.outputs, (), plant)
    assert found.undecided == ("i is z: the model does not follow it",)


def test_a_model_that_does_not_follow_decides_nothing():
    rng = np.random.default_rng(6)
    record = rl.Record(T, {}, {name: np.cumsum(rng.normal(size=len(T))) for name in "abcd"}, {}, "noise")
    plant = rl.plant("dc-motor")
    found = propose_columns(record, plant.inputs, plant.outputs, (), plant)
    assert found.undecided
    assert not any("by simulation" in reason for reason in found.reasons.values())
