"""What `robustlab.discover` says of measured machines: verdict, names with intervals, errors held out, CPU seconds.

python benchmarks/real_machines.py odrive-nocomp cart    (all without names; `--json FILE` keeps the figures)

The data lie in ../shared/data of the checkout (README there), or in the folder that `--data` names:

    odrive    brushless motor, 7 pole pairs, 12 slots: torque 0.06 N m/A. Measured apart from this: friction 0.3-0.4 A,
              cogging of 7 periods a turn of 0.26-1.0 A; with anti-cogging (comp) next to none of it.
    cart      motor-driven cart on a rail: dry friction of 2.5-4 N that varies with place and direction, no cogging.
    emps      drive with a ball screw: published M 95.1 kg, Fv 203.5 N s/m, Fc 20.4 N, offset -3.2 N.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np

import robustlab as rl
from robustlab.dynamics import Descriptor, LinearPlant, Parameter
from robustlab.statespace import Signal

DATA = Path(__file__).resolve().parents[2] / "shared" / "data"


FITTED, JUDGED = (20, 25, 28), (22, 27)  # runs of the brushless motor


@dataclass(frozen=True)
class Machine:
    """A nominal plant, records to fit and records to judge."""

    plant: LinearPlant
    fitted: list[rl.Record]
    judged: list[rl.Record]


def axis(unit: str, force: str, source: str, m: tuple[float, float], gain: tuple[float, float]) -> LinearPlant:
    """``q' = v, M v' = gain u`` with (value, relative tolerance) each; q in ``unit``, u in ``source``."""
    inertia = "kg m2" if force == "N m" else "kg"
    parameters = {
        "M": Parameter("M", m[0], inertia, m[1], sign="positive", role="inertia"),
        "Fv": Parameter("Fv", 0.0, f"{force} s/{unit}", sign="nonnegative", role="viscous-friction"),
        "gain": Parameter("gain", gain[0], f"{force}/{source}", gain[1], sign="either", role="input-gain"),
    }
    states = (Signal("q", unit), Signal("v", f"{unit}/s"))

    def equations(p: Any) -> Descriptor:
        return Descriptor([[1, 0], [0, p["M"]]], [[0, 1], [0, -p["Fv"]]], [[0], [p["gain"]]], [[1, 0], [0, 1]])

    return LinearPlant("axis", parameters, (Signal("u", source),), states, states, equations=equations)


def record(group: Any, name: str, u: Any, outputs: dict[str, str]) -> rl.Record:
    """A group of a file as a record that begins at t = 0."""
    t = np.asarray(group["t"])
    columns = {key: np.asarray(group[column]) for key, column in outputs.items()}
    return rl.Record(t - t[0], {"u": np.asarray(u)}, columns, name=name)


def odrive(data: Path, series: str, measured: bool) -> Machine:
    """Current steps both ways; as input the measured current, or the one that was set."""
    with h5py.File(data / "odrive.h5") as file:

        def run(k: int) -> rl.Record:
            group = file[series][f"run{k:02d}"]
            i = np.asarray(group["i"])
            # The file keeps the size of the step; every second run goes backwards.
            steps = np.full(len(i), float(group.attrs["set_current"]) * (-1.0) ** k)
            return record(group, f"run{k:02d}", i if measured else steps, {"q": "phi"})

        plant = axis("rad", "N m", "A", (2.5e-4, 0.10), (0.06, 0.20))
        return Machine(plant, [run(k) for k in FITTED], [run(k) for k in JUDGED])


def cart(data: Path) -> Machine:
    """Two places to fit, a third one to judge."""
    with h5py.File(data / "cart.h5") as file:

        def run(place: str) -> rl.Record:
            return record(file[place], place, file[place]["f"], {"q": "q", "v": "v"})

        plant = axis("m", "N", "N", (6.28, 0.02), (1.0, 0.0))
        return Machine(plant, [run("series2_20cm"), run("series2_50cm")], [run("series3_40cm")])


def emps(data: Path) -> Machine:
    """The benchmark's own split."""
    with h5py.File(data / "emps.h5") as file:
        runs = [record(file[part], part, file[part]["u"], {"q": "q"}) for part in ("train", "test")]
    return Machine(rl.plant("servo-axis"), runs[:1], runs[1:])


MACHINES: dict[str, Callable[[Path], Machine]] = {
    "odrive-nocomp": lambda data: odrive(data, "spinup_4_nocomp", True),
    "odrive-nocomp-set": lambda data: odrive(data, "spinup_4_nocomp", False),
    "odrive-comp": lambda data: odrive(data, "spinup_7_comp", True),
    "odrive-comp-set": lambda data: odrive(data, "spinup_7_comp", False),
    "cart": cart,
    "emps": emps,
}


def told(found: Any) -> dict[str, Any]:
    """What is compared with the truth."""

    def values(parameters: Sequence[Any]) -> dict[str, list[float]]:
        return {p.name: [p.value, p.lower, p.upper] for p in parameters}

    return {
        "verdict": found.verdict,
        "complete": found.complete,
        "kinds": [
            {
                "kind": k.kind,
                "place": k.place,
                "probability": k.probability,
                "values": values(k.values),
                "members": {m.name: m.share for m in k.members},
            }
            for k in found.kinds
        ],
        "effects": [{"name": e.name, "site": e.site, "values": values(e.parameters)} for e in found.effects],
        "rivals": [r.name for r in found.rivals],
        "nominal": {p.name: [p.value, p.lower, p.upper] for p in found.nominal},
        "gaps_percent": {"nominal": found.gap_before, "refitted": found.gap_refitted, "updated": found.gap_after},
        "noise_ratio": found.structure.get("noise_ratio"),
    }


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", choices=[*MACHINES, []])
    parser.add_argument("--data", type=Path, default=DATA)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    kept = {}
    for name in options.names or MACHINES:
        machine = MACHINES[name](options.data)
        wall, cpu = time.perf_counter(), time.process_time()
        try:
            said = told(rl.discover(machine.plant, machine.fitted, machine.judged))
        except rl.RobustlabError as error:
            said = {"error": str(error)}
        said |= {"wall_s": time.perf_counter() - wall, "cpu_s": time.process_time() - cpu}
        kept[name] = said
        print(f"\n{name}: {said['wall_s']:.0f} s, {said['cpu_s']:.0f} s CPU")
        for key, value in said.items():
            for line in value if isinstance(value, list) else [value]:
                print(f"  {key}: {line}", flush=True)
        if options.json:
            options.json.write_text(json.dumps(kept, indent=1))


if __name__ == "__main__":
    main()
