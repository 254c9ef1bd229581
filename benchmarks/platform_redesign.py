r"""The hidden platform under the controllers of `platform-discover`: a slow path with reversals, before and after.

``robustlab run platform-discover --out out/pd``, then ``python benchmarks/platform_redesign.py out/pd`` makes the runs
anew and prints them; with ``--out recipes/data/platform_runs.h5`` it writes the records that the recipe judges.

The machine is that of the recipe's other records (case coulomb-friction of seed 1): `platform_machine`, which shares no
equation with robustlab. Controllers run at 500 Hz, by Tustin's formula, with the encoder's noise and steps and with the
small torques that come from outside. Commands are logged in steps of 1 uN m, references in steps of 1 urad: what a
drive does.

The reference, in the six pose coordinates, :math:`p_j(t) = h_j + e(t)\, a_j \sin \omega_j t`, is slow (at most 1.7
rad/s at a nut, 1 mm/s) and turns every leg round three or four times.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from hidden.sensors import coloured
from platform_cases import DT, GEAR, LEGS, NOISE, generator, make_case, nominal_plant
from platform_machine import Array, Machine, Run, nut_angles, simulate

import robustlab as rl
from robustlab.dynamics.extended.feed_forward import feed_forward

HOME = np.array([0.0, 0.0, 0.1162, 0.0, 0.0, 0.0])  # in the middle of the heights of the designs
AMPLITUDE = np.array([0.15e-3, 0.15e-3, 0.25e-3, 1.0e-3, 1.0e-3, 1.5e-3])  # m, rad
RATE = 2 * np.pi * np.array([0.25, 0.35, 0.30, 0.40, 0.20, 0.33])  # rad/s
DURATION, RISE = 6.0, 1.0  # s
COUNTS, SPREAD, _, LOAD = NOISE["mid"]
LSB = 2 * np.pi / (COUNTS * GEAR)  # rad at the nut
LOG, LOG_ANGLE = 1e-6, 1e-6  # N m, rad


def path() -> tuple[Array, Array]:
    """First pose (6,), and the nut angles asked for, (n, 6), as they are logged."""
    t = np.arange(round(DURATION / DT)) * DT
    s = np.clip(t / RISE, 0.0, 1.0)[:, None]
    poses = HOME + s**3 * (10 - 15 * s + 6 * s**2) * AMPLITUDE * np.sin(RATE * t[:, None])
    return poses[0], LOG_ANGLE * np.round(nut_angles(poses) / LOG_ANGLE)


def run(machine: Machine, K: rl.StateSpaceModel, rest: Array, ahead: Array, word: str) -> Run:
    """The machine under a digital controller about a rest's torques (6,), with ``ahead`` (n, 6) fed forward."""
    start, asked = path()
    x = np.zeros(K.n_states)
    shake = SPREAD * generator(1, "encoder", "redesign", word).normal(size=asked.shape)
    draw = generator(1, "push", "redesign", word)
    push = GEAR * LOAD * np.column_stack([coloured(len(asked), DT, draw) for _ in range(LEGS)])

    def controller(k: int, y: Array) -> Array:
        nonlocal x
        v = np.concatenate([asked[k], y]) - np.tile(asked[0], 2)
        u = rest + K.C @ x + K.D @ v + ahead[k]
        x = K.A @ x + K.B @ v
        return LOG * np.round(u / LOG)

    return simulate(
        machine, start, len(asked), DT, controller, seen=lambda k, y: LSB * np.round((y + shake[k]) / LSB), push=push
    )


def runs(folder: Path) -> dict[str, Run]:
    """Before, with the redesign's feedback alone, and after, with the controllers of a recipe's run."""
    stated: Any = nominal_plant(motors=False)
    updated: Any = rl.load(folder / "naming-plant.h5")
    machine = make_case("coulomb-friction", 1, motors=False, duration=0.02).machine
    assert machine is not None
    law, asked = feed_forward(updated), path()[1]
    leg = int(law.position.name[-1]) - 1
    friction = np.zeros_like(asked)
    friction[:, leg] = law(asked[:, leg], np.gradient(asked[:, leg], DT))
    found = {}
    for word, file, plant, ahead in (
        ("before", "before", stated, 0.0 * friction), ("alone", "after", updated, 0.0 * friction),
        ("after", "after", updated, friction),
    ):  # fmt: skip
        kept: Any = rl.load(folder / "evidence" / f"{file}.h5")
        design = kept.data["K"]
        K = rl.discretise(rl.StateSpaceModel(*(design[part] for part in "ABCD")), DT, "tustin")
        found[word] = run(machine, K, np.asarray(rl.trim(plant, pose=HOME).u, dtype=np.float64), ahead, word)
    return found


TITLE = (
    "SIMULATED: the machine of platform.h5 under two controllers of platform-discover; benchmarks/platform_redesign.py"
)


def write(found: dict[str, Run], file: Path) -> None:
    """The records: clock, torques, what the encoders read, references."""
    asked = path()[1]
    with h5py.File(file, "w") as out:
        out.attrs["title"] = TITLE
        for word in ("before", "after"):
            group, one = out.create_group(word), found[word]
            columns = {"t": (one.t, "s")}
            for j in range(LEGS):
                columns |= {
                    f"torque_{j + 1}": (one.u[:, j], "N m"), f"phi_{j + 1}": (one.readings[:, j], "rad"),
                    f"phi_{j + 1}_ref": (asked[:, j], "rad"),
                }  # fmt: skip
            for name, (values, unit) in columns.items():
                kind = np.float64 if name == "t" else np.float32  # 24 bits, more than any of these has
                data = group.create_dataset(
                    name, data=values.astype(kind), shuffle=True, compression=9, fletcher32=True
                )
                data.attrs["unit"] = unit


def told(found: dict[str, Run]) -> str:
    """Errors of leg 6 and of the worst other leg, in counts of the encoder."""
    asked, late = path()[1], np.arange(round(DURATION / DT)) * DT >= RISE
    rows = [f"{'':8s} {'read rms':>9s} {'largest':>8s} {'true rms':>9s} {'largest':>8s} {'others':>7s}"]
    for word, one in found.items():
        seen, true = ((value - asked)[late] / LSB for value in (one.readings, one.phi))
        rms = np.sqrt((true**2).mean(axis=0))
        rows.append(
            f"{word:8s} {np.sqrt((seen[:, 5] ** 2).mean()):9.2f} {np.abs(seen[:, 5]).max():8.2f} {rms[5]:9.2f} "
            f"{np.abs(true[:, 5]).max():8.2f} {rms[:5].max():7.2f}"
        )
    return "\n".join([*rows, f"a count is {1e3 * LSB:.4f} mrad of the nut, {1e6 * LSB * 0.004 / (2 * np.pi):.3f} um"])


def main(argv: Sequence[str] | None = None) -> None:
    """Run, print, and write what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="output folder of platform-discover")
    parser.add_argument("--out", type=Path, help="HDF5 file for the records")
    asked = parser.parse_args(argv)
    found = runs(asked.folder)
    print(told(found))
    if asked.out:
        write(found, asked.out)


if __name__ == "__main__":
    main()
