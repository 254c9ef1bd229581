"""Feed-forward of named effects against the laws themselves, against formulas, and as compiled C."""

import ctypes
import math
import shutil
import subprocess

import numpy as np
import pytest
from patience import PATIENCE

import robustlab as rl
from robustlab.dynamics import DryLevel, FeedForward, Wave, feed_forward, rest_band, steady_force
from robustlab.errors import InputError, UnitMismatch, UsageError
from robustlab.signals import Signal, Taken

CC = shutil.which("cc")
STRICT = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "-Wconversion", "-O2", "-ffp-contract=off"]
EFFECTS = {
    "cogging": {"Ac": 0.013, "As": -0.05, "k": 7.0},
    "pendulum-gravity": {"G": 0.02, "H": -0.01},
    "constant-load": {"T0": 0.004},
    "coulomb-friction": {"Fc": 0.02},
    "presliding": {"Fc": 0.02, "sigma0": 5.0},
    "stribeck-friction": {"Fc": 0.02, "dF": 0.01, "vs": 0.7},
    "asymmetric-coulomb-friction": {"F_pos": 0.03, "F_neg": 0.02},
}


def motor(**effects):
    return rl.with_effects(rl.plant("brushless-motor"), {name.replace("_", "-"): v for name, v in effects.items()})


@pytest.mark.parametrize("name", EFFECTS)
def test_it_balances_the_effects_law(name):
    """Evaluate the law of the simulation at a constant speed, over the torque per ampere."""
    plant = rl.with_effects(rl.plant("brushless-motor", Kt=0.05), {name: EFFECTS[name]})
    found, (_, force, _) = feed_forward(plant), plant.laws[0]
    for q, v in ((0.3, 2.0), (-1.7, -0.4), (40.0, 0.9)):
        assert float(found(q, v)) == pytest.approx(-steady_force(force, q, v) / 0.05, rel=1e-6)
    low, high = rest_band(force, 0.3)
    assert -float(found(0.3, 0.0)) * 0.05 == pytest.approx(0.5 * (low + high), abs=1e-9)


def test_the_exact_feed_forward_keeps_the_machine_on_its_reference():
    """Physics: with the friction's and the load's own force and that of the inertia the motor follows without feedback.

    Cogging is left out: where it pushes away from a crest, no motor follows without feedback.
    """
    plant = motor(coulomb_friction={"Fc": 0.02}, constant_load={"T0": 0.004})
    t = np.arange(4000) * 2.5e-4
    way = 1.5 * (t - np.sin(2 * np.pi * t) / (2 * np.pi))  # at rest at both ends, never backwards
    speed, rate = 1.5 * (1 - np.cos(2 * np.pi * t)), 1.5 * 2 * np.pi * np.sin(2 * np.pi * t)
    inertia = 2.5e-4 * rate / 0.06
    with_law = rl.simulate(plant, t, inertia + feed_forward(plant)(way, speed))["phi"]
    without = rl.simulate(plant, t, inertia)["phi"]
    assert np.abs(with_law - way).max() < 0.02
    assert np.abs(without - way).max() > 0.5


@pytest.mark.parametrize(
    ("plant", "message"),
    [
        (lambda: rl.plant("brushless-motor"), "no effect that is a force"),
        (lambda: rl.with_effects(rl.plant("brushless-motor"), {"inertia": {"s": 1.2}}), "no effect that is a force"),
        (lambda: rl.with_effects(rl.plant("two-mass"), {f"coulomb-friction@omega{k}": {"Fc": 1.0} for k in (1, 2)}),
         "effects at omega1, omega2"),
        (lambda: rl.with_effects(rl.plant("two-mass"), {"coulomb-friction@omega2": {"Fc": 1.0}}), "no input that acts"),
        (lambda: rl.with_effects(rl.plant("dc-motor"), {"coulomb-friction": {"Fc": 1e-3}}), "no input that acts"),
    ],
)  # fmt: skip
def test_unsuitable_plants_are_rejected(plant, message):
    with pytest.raises(InputError, match=message):
        feed_forward(plant())


LAW = FeedForward(
    Signal("i", "A"), Signal("phi", "rad"), (Wave(0.2, -0.9, 7.0), Wave(0.05, 0.0, 0.0)), (DryLevel(0.3, 0.1, 0.5),),
    ("Cogging",),
)  # fmt: skip


def digital(inputs=None):
    names = inputs or [Taken("phi_ref", "rad", "r", "phi"), Taken("phi", "rad")]
    return rl.StateSpaceModel([[0.9]], [[0.1, -0.1]], [[2.0]], [[3.0, -3.0]], 1e-3, names, [("i", "A")])


@pytest.mark.skipif(CC is None, reason="no C compiler (cc) here")
@pytest.mark.parametrize("limits", [None, (-1.0, 1.5)])
def test_the_compiled_step_adds_it_before_the_limits(tmp_path, limits):
    model = digital()
    rl.export_controller(tmp_path / "k.c", model, saturation=limits, feed_forward=LAW, anti_windup=limits and np.inf)
    library = tmp_path / "k.so"
    command = [CC, *STRICT, "-shared", "-fPIC", "-o", str(library), str(tmp_path / "k.c"), "-lm"]
    subprocess.run(command, check=True, timeout=PATIENCE)
    code, doubles = ctypes.CDLL(str(library)), ctypes.POINTER(ctypes.c_double)
    rng = np.random.default_rng(3)
    given, state, out, x = rng.standard_normal((400, 3)), np.full(1, 7.0), np.zeros(1), np.zeros(1)
    given[::7, 2] = 0.0
    code.controller_init(state.ctypes.data_as(doubles))
    for r, y, v in given:
        row = np.array([r, y, v])
        code.controller_step(state.ctypes.data_as(doubles), row.ctypes.data_as(doubles), out.ctypes.data_as(doubles))
        dry = (0.3 + 0.1 * math.exp(-((v / 0.5) ** 2))) * float(np.sign(v))
        command = 2.0 * x[0] + 3.0 * (r - y) + 0.2 * math.cos(7 * r) - 0.9 * math.sin(7 * r) + 0.05 + dry
        wanted = command if limits is None else min(max(command, limits[0]), limits[1])
        assert out[0] == pytest.approx(wanted, abs=1e-12)
        x = 0.9 * x + 0.1 * (r - y)
    text = (tmp_path / "k.c").read_text()
    assert "u[2]: rate of phi_ref [rad/s]" in text
    assert "of: Cogging" in text


def test_an_export_without_its_signals_is_refused(tmp_path):
    blind = digital([Taken("e", "rad", "r - y", "phi"), Taken("phi", "rad")])
    with pytest.raises(InputError, match="given the reference of phi"):
        rl.export_controller(tmp_path / "k.c", blind, feed_forward=LAW)
    degrees = digital([Taken("phi_ref", "deg", "r", "phi"), Taken("phi", "deg")])
    with pytest.raises(UnitMismatch):
        rl.export_controller(tmp_path / "k.c", degrees, feed_forward=LAW)
    other = FeedForward(Signal("u", "V"), LAW.position, LAW.waves)
    with pytest.raises(InputError, match="of 'u'"):
        rl.export_controller(tmp_path / "k.c", digital(), feed_forward=other)
    with pytest.raises(UsageError, match=r"\.json"):
        rl.export_controller(tmp_path / "k.json", digital(), feed_forward=LAW)
    assert not list(tmp_path.iterdir())
