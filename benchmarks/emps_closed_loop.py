"""EMPS in closed loop: does the updated plant ask its controller for the force that was measured?

``python benchmarks/emps_closed_loop.py EMPS.h5 [PLANT.h5]``: the published PD law drives the plant along the reference
of the record `test`, pulses included, and the motor force gain u is compared with the measured one:

    force error = norm(gain u_measured - gain u_simulated) / norm(gain u_measured)

PLANT.h5 is what `discover` saves (`naming-plant.h5` of the recipe emps-discover); without it the nominal model and the
published ones stand alone. The axis is integrated here, by Euler steps of 50 us in which dry friction stops the
carriage exactly, and not by robustlab, so that a fault of its simulator would show.

Source: Janot, Gautier, Brunot 2019; the law and its constants are attributes of the group `published`.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, replace
from typing import Any

import h5py
import numpy as np

import robustlab as rl

TS, SUBSTEPS = 1e-3, 20
SKIPPED = 20  # samples at the start that the benchmark does not score: the state is taken from them
KNOWN = ("coulomb-friction", "asymmetric-viscous-friction", "viscous-friction", "constant-load")
GOAL = 4.4  # percent


@dataclass(frozen=True)
class Axis:
    """M dv/dt = gain u - Fv(sign v) v - Fc(sign v) sign(v) - load; forwards and backwards of their own."""

    mass: float
    gain: float
    viscous: tuple[float, float]
    dry: tuple[float, float] = (0.0, 0.0)
    load: float = 0.0

    def step(self, q: float, v: float, u: float, h: float) -> tuple[float, float]:
        """Position and speed after h: friction opposes the motion and stops it, but does not turn it."""
        drive = self.gain * u - self.load
        side = v > 0 or (v == 0 and drive > 0)
        dry, viscous = (self.dry[0], self.viscous[0]) if side else (self.dry[1], self.viscous[1])
        if v == 0 and abs(drive) <= dry:
            return q, 0.0
        new = v + h / self.mass * (drive - viscous * v - (dry if side else -dry))
        if v * new < 0 and abs(drive) <= max(self.dry):
            new = 0.0
        return q + 0.5 * h * (v + new), new


def of_plant(plant: Any) -> Axis:
    """The axis that a saved plant describes, with the effects that this script knows."""
    p, effects = dict(getattr(plant, "plant", plant).values), getattr(plant, "effects", ())
    axis = Axis(p["M"], p["gain"], (p["Fv"], p["Fv"]))
    for e in effects:
        values = dict(e.values)
        if e.effect.id not in KNOWN:
            raise SystemExit(f"{e.effect.id}: this script knows {', '.join(KNOWN)} only")
        if e.effect.id == "coulomb-friction":
            axis = replace(axis, dry=(values["Fc"], values["Fc"]))
        elif e.effect.id == "constant-load":
            axis = replace(axis, load=axis.load + next(iter(values.values())))
        else:
            extra = next(iter(values.values()))
            back = -extra if e.effect.id == "asymmetric-viscous-friction" else extra
            axis = replace(axis, viscous=(axis.viscous[0] + extra, axis.viscous[1] + back))
    return axis


def force_error(axis: Axis, record: Any, law: Any) -> float:
    """Percent, over the record but its first samples."""
    reference, measured = record["q_ref"][()], record["u"][()]
    kp, kv, limit = (float(law[name]) for name in ("kp", "kv", "u_sat"))
    # The pulses as they were, edges and all: what the recorded voltage has beyond the law at the measured position.
    seen = record["q"][()]
    moved = np.concatenate([[0.0, 0.0], seen[2:] - seen[:-2]]) / (2.0 * TS)
    pulse = measured - np.clip(kp * kv * (reference - seen) - kv * moved, -limit, limit)
    q, v = float(seen[SKIPPED]), float(moved[SKIPPED])
    past = seen[SKIPPED - 2 : SKIPPED].tolist()
    u = np.empty(len(reference) - SKIPPED)
    for k, target in enumerate(reference[SKIPPED:].tolist()):
        speed = (q - past[0]) / (2.0 * TS)
        u[k] = np.clip(kp * kv * (target - q) - kv * speed, -limit, limit) + pulse[SKIPPED + k]
        past = [past[1], q]
        for _ in range(SUBSTEPS):
            q, v = axis.step(q, v, float(u[k]), TS / SUBSTEPS)
    return float(100.0 * np.linalg.norm(measured[SKIPPED:] - u) / np.linalg.norm(measured[SKIPPED:]))


def main(emps: str, plant: str | None = None) -> None:
    """Print the force error of each model."""
    with h5py.File(emps) as file:
        record, law = file["test"], file["published"].attrs
        p = {name: float(value) for name, value in law.items() if np.ndim(value) == 0 and not isinstance(value, str)}
        symmetric = Axis(p["M"], p["gtau"], (p["Fv"],) * 2, (p["Fc"],) * 2, p["offset"])
        asymmetric = Axis(
            p["asym_M"], p["gtau"], (p["asym_Fv_pos"], p["asym_Fv_neg"]), (p["asym_Fc_pos"], p["asym_Fc_neg"])
        )
        models = {
            "nominal, without dry friction": of_plant(rl.plant("servo-axis")),
            "published, symmetric": symmetric,
            "published, asymmetric": asymmetric,
        }
        if plant is not None:
            models["updated by discover"] = of_plant(rl.load(plant))
        for name, axis in models.items():
            print(f"{name:32} {force_error(axis, record, law):6.2f} %   goal of the updated one <= {GOAL} %")


if __name__ == "__main__":
    main(*sys.argv[1:])
