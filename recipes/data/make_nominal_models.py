"""Make the nominal models of four measured records: ``models/hsm150.h5``, ``rack_pinion.h5``, ``cascaded_tanks.h5`` and
``coupled_drives.h5``.

Run it with ``python recipes/data/make_nominal_models.py``. Each is the simplest linear model that somebody would begin
with; what the machine has beyond it is for `discover` to find. Two come from a catalogue or a scale, two are fitted.
"""

from __future__ import annotations

from pathlib import Path

import robustlab as rl
from robustlab.provenance import Provenance
from robustlab.statespace import Signal, StateSpaceModel

# Servo motor HSM150: inertia and viscous friction as its catalogue prints them (kg m^2, N m s/rad).
HSM150_J, HSM150_B = 1.2e-4, 7.03e-5

# Rack and pinion: the mass alone, seen at the rack (kg). Nothing is known of its friction.
RACK_MASS = 24.7

# Two tanks, each a lag of first order (1/s); pump gain (1/s). Least squares on the record `train` of the benchmark by
# simulation: 1.15 V rms. Levels are in volts of the sensor. A root of the level, as Bernoulli has it, is not linear.
TANK_RATE, TANK_GAIN = 0.0141, 0.0290

# Two drives turn a pulley on a spring: a lag of first order and a resonance. Gain in ticks/s per V, rates in rad/s.
# Least squares of the magnitude of the simulated speed on the first 400 samples of both records: 0.30 ticks/s rms.
DRIVE_GAIN, DRIVE_LAG, DRIVE_RESONANCE, DRIVE_DAMPING = 0.896, 4.88, 22.9, 0.154


def hsm150() -> StateSpaceModel:
    """J domega/dt = u - B omega, dphi/dt = omega; the shaft angle is measured."""
    phi, omega = Signal("phi", "rad"), Signal("omega", "rad/s")
    a = [[0.0, 1.0], [0.0, -HSM150_B / HSM150_J]]
    b, c = [[0.0], [1.0 / HSM150_J]], [[1.0, 0.0]]
    return StateSpaceModel(a, b, c, [[0.0]], 0.0, [Signal("u", "N m")], [phi], [phi, omega])


def rack_pinion() -> StateSpaceModel:
    """Mass alone: m dv/dt = F; the speed is measured. No position: nothing measures it, nothing depends on it."""
    speed = Signal("speed", "m/s")
    b = [[1.0 / RACK_MASS]]
    return StateSpaceModel([[0.0]], b, [[1.0]], [[0.0]], 0.0, [Signal("force", "N")], [speed], [speed])


def cascaded_tanks() -> StateSpaceModel:
    """Upper and lower level as two equal lags; the lower level is measured."""
    a, b = [[-TANK_RATE, 0.0], [TANK_RATE, -TANK_RATE]], [[TANK_GAIN], [0.0]]
    upper, lower = Signal("upper", "V"), Signal("y", "V")
    return StateSpaceModel(a, b, [[0.0, 1.0]], [[0.0]], 0.0, [Signal("u", "V")], [lower], [upper, lower])


def coupled_drives() -> StateSpaceModel:
    """Belt speed as a lag of the voltage, pulley speed as a damped resonance of the belt speed."""
    square = DRIVE_RESONANCE**2
    a = [[-DRIVE_LAG, 0.0, 0.0], [0.0, 0.0, 1.0], [square, -square, -2.0 * DRIVE_DAMPING * DRIVE_RESONANCE]]
    b, c = [[DRIVE_GAIN * DRIVE_LAG], [0.0], [0.0]], [[0.0, 1.0, 0.0]]
    ticks = "ticks/s (scaled)"
    pulley = Signal("y", ticks)
    return StateSpaceModel(
        a, b, c, [[0.0]], 0.0, [Signal("u", "V")], [pulley], [Signal("belt", ticks), pulley, Signal("rate", "")]
    )


MODELS = {
    "hsm150": hsm150,
    "rack_pinion": rack_pinion,
    "cascaded_tanks": cascaded_tanks,
    "coupled_drives": coupled_drives,
}


def main() -> None:
    """Write the files."""
    folder = Path(__file__).parents[2] / "models"
    for name, make in MODELS.items():
        path = folder / f"{name}.h5"
        rl.save(path, make(), Provenance.now("recipes/data/make_nominal_models.py"))
        print(f"{path.name}: {path.stat().st_size} bytes")


if __name__ == "__main__":
    main()
