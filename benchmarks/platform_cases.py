"""Blind cases of the Stewart platform: closed-loop records of a machine with something hidden in it.

``python benchmarks/platform_cases.py --seeds 1-4 --only coulomb-friction backlash --out out/platform_cases`` writes
two records (HDF5) and the truth (JSON) of each case. The machine is `platform_machine`, not robustlab's.

The user's machine carries a tool: platform and tool weigh 10 kg. A controller makes the nut angles follow a drawn path
of poses (slow, usual and fast stretches, rests, reversals of every leg). Read are the six encoders and, with motors,
the six currents; logged are the six voltages (or motor torques). Same arguments, same case.

>>> case = make_case("coulomb-friction", seed=1)
>>> case.legs, case.record.n, sorted(case.record.outputs)[:2]
((6,), 4000, ['i_1', 'i_2'])
"""

from __future__ import annotations

import argparse
import json
import math
import time
import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from hidden.sensors import coloured
from platform_machine import STEP, Array, Cable, Drives, Machine, Run, bodies, nut_angles, simulate

import robustlab as rl
from robustlab import Record

DT, DURATION = 2e-3, 8.0
LEGS = 6
OPEN = 0.01  # of a record, for which a gap must be open for its backlash to be hidden in it
GEAR = 4.8 * 41 / 21
U_MAX, TORQUE_MAX = 36.0, 0.25
MIDDLE, REACH = 0.17355, 0.0100  # actuator lengths that the path keeps to: middle, and half the range, in m

# What the user states: (value, tolerance); platform and tool together, a flat cylinder of 10 kg.
BODIES = {
    "platform_mass": (10.0, 0.05), "platform_x": (0.0896, 0.10), "platform_y": (0.0896, 0.10),
    "platform_z": (0.1125, 0.10), "link_mass": (0.435, 0.05), "nut_mass": (0.125, 0.05), "screw_mass": (0.112, 0.05),
    "motor_mass": (0.34, 0.05), "rotor_J": (7.2e-6, 0.05),
}  # fmt: skip
MOTOR = {"R": (2.07, 0.05), "L": (0.62e-3, 0.10), "Km": (0.052, 0.05), "Kb": (0.052, 0.05), "Kf": (4.8e-5, 0.35)}
TOLERANCES = {True: {**BODIES, **MOTOR}, False: BODIES}

# Encoder counts per motor turn, its noise in rad at the nut, noise of the current in A, torque from outside at each
# motor in N m (0.1 % of what the motors do at "mid"), which wanders with 5 Hz.
NOISE = {"low": (4000, 1e-4, 2e-3, 0.0), "mid": (2000, 3e-4, 5e-3, 2e-5), "high": (500, 1e-3, 2e-2, 1e-4)}


def nominal_plant(motors: bool = True) -> Any:
    """Return the nominal plant with tolerances: `rl.plant("stewart-platform", preset="physical", ...)`."""
    return rl.plant("stewart-platform", preset="physical", motors=motors, **TOLERANCES[motors])


Values = dict[str, float]
Put = Callable[[Machine, int, Values], Machine]


@dataclass(frozen=True)
class Hidden:
    """One kind of hidden effect: how its values are drawn, and what it does to the machine."""

    draw: Callable[[np.random.Generator, bool], Values]  # whether there are motors; torques and angles at the nut
    put: Put  # the machine with the effect at leg 0..5, at all or none in particular: -1
    where: str = "leg"  # or "all" legs, or "common" to the whole machine
    motors: bool | None = None  # only on machines with, without motors


def _at(**names: str) -> Put:
    """Set constants of the drive at a leg to the drawn values: constant="value"."""
    return lambda m, leg, v: replace(m, drives=m.drives.at(leg, **{own: v[name] for own, name in names.items()}))


def _times(*names: str) -> Put:
    """Multiply constants of the drive at a leg (-1: at all) by the drawn factor."""

    def put(m: Machine, leg: int, v: Values) -> Machine:
        drives = m.drives
        for j in range(LEGS) if leg < 0 else (leg,):
            drives = drives.at(j, **{name: drives.column(name)[j] * v["factor"] for name in names})
        return replace(m, drives=drives)

    return put


def _off(low: float, high: float) -> Callable[[np.random.Generator, bool], Values]:
    """A factor above or below one by a share between low and high."""
    return lambda r, _: {"factor": 1.0 + float(r.choice([-1.0, 1.0]) * r.uniform(low, high))}


def _log(r: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(r.uniform(math.log(low), math.log(high))))


def _stribeck(r: np.random.Generator, _: bool) -> Values:
    level = GEAR * _log(r, 1.5e-3, 4e-3)
    return {"Fc": level, "dF": level * r.uniform(0.4, 1.5), "vs": _log(r, 0.5, 4.0)}


def _ripple(r: np.random.Generator, _: bool) -> Values:
    order = float(r.choice([1.0, 2.0, 4.0, GEAR]))
    return {"A": GEAR * _log(r, 1.5e-3, 5e-3), "order": order, "phase": r.uniform(0, 2 * np.pi)}


def _platform_mass(m: Machine, _: int, v: Values) -> Machine:
    old = m.bodies.platform
    return replace(m, bodies=replace(m.bodies, platform=type(old)(old.mass * v["factor"], old.inertia)))


def _centre(r: np.random.Generator, _: bool) -> Values:
    off, angle = r.uniform(0.015, 0.04), r.uniform(0, 2 * np.pi)
    return {"x": off * math.cos(angle), "y": off * math.sin(angle), "z": r.uniform(-0.01, 0.01)}


def _tilt(r: np.random.Generator, _: bool) -> Values:
    size, angle = np.radians(r.uniform(1.5, 5.0)), r.uniform(0, 2 * np.pi)
    return {"x": float(size * math.cos(angle)), "y": float(size * math.sin(angle))}


def _put_cable(m: Machine, _: int, v: Values) -> Machine:
    """From the edge of the platform to a pillar 0.3 m outside and 0.2 m above it."""
    out = np.array([math.cos(v["side"]), math.sin(v["side"]), 0.0])
    point, anchor = 0.19 * out, 0.49 * out + [0.0, 0.0, 0.1262 + 0.2]
    length = math.hypot(0.3, 0.2) + v["slack"]
    return replace(m, cable=Cable(tuple(anchor), tuple(point), length, v["k"]))


CLASSES: Mapping[str, Hidden] = {
    "none": Hidden(lambda r, _: {}, lambda m, *_: m, "common"),
    "coulomb-friction": Hidden(lambda r, _: {"Fc": GEAR * _log(r, 1.5e-3, 6e-3)}, _at(coulomb="Fc")),
    "viscous-friction": Hidden(
        lambda r, motors: {"c": GEAR**2 * (_log(r, 3e-5, 1.0e-4) if motors else _log(r, 1e-5, 6e-5))}, _at(viscous="c")
    ),
    "stribeck-friction": Hidden(_stribeck, _at(coulomb="Fc", breakaway="dF", stribeck="vs")),
    "backlash": Hidden(lambda r, _: {"gap": _log(r, 0.1, 0.5)}, _at(gap="gap")),
    "cogging": Hidden(_ripple, _at(ripple="A", order="order", phase="phase")),
    "torque-constant": Hidden(_off(0.12, 0.3), _times("Km", "Kb"), motors=True),
    "input-gain": Hidden(_off(0.1, 0.25), _times("gain"), motors=False),
    "resistance": Hidden(_off(0.25, 0.5), _times("R"), motors=True),
    "sensor-delay": Hidden(lambda r, _: {"d": STEP * round(r.uniform(3e-3, 9e-3) / STEP)}, _at(delay_out="d")),
    "input-delay": Hidden(lambda r, _: {"d": STEP * round(r.uniform(3e-3, 9e-3) / STEP)}, _at(delay_in="d")),
    "encoder-offset": Hidden(
        lambda r, _: {"offset": float(r.choice([-1.0, 1.0]) * r.uniform(2.5, 6.0))}, _at(offset="offset")
    ),
    "platform-mass": Hidden(_off(0.15, 0.4), _platform_mass, "common"),
    "platform-centre": Hidden(
        _centre, lambda m, _, v: replace(m, bodies=replace(m.bodies, platform_cg=(v["x"], v["y"], v["z"]))), "common"
    ),
    "gravity-direction": Hidden(
        _tilt, lambda m, _, v: replace(m, bodies=replace(m.bodies, tilt=(v["x"], v["y"]))), "common"
    ),
    "torque-constant-all": Hidden(_off(0.12, 0.25), _times("Km", "Kb"), "all", motors=True),
    "resistance-all": Hidden(_off(0.2, 0.4), _times("R"), "all", motors=True),
    "cable": Hidden(  # no effect of a catalogue of joints
        lambda r, _: {"k": _log(r, 1.5e3, 5e3), "side": r.uniform(0, 2 * np.pi), "slack": r.uniform(-0.006, 0.001)},
        _put_cable,
        "common",
    ),
}
OUTSIDE = ("cable",)
TWICE = ("coulomb-friction", "viscous-friction", "stribeck-friction", "cogging", "torque-constant", "input-gain")


def names(motors: bool = True) -> tuple[str, ...]:
    """Classes that a machine with or without motors can have; "2x name" hides the same effect at two legs."""
    single = [name for name, hidden in CLASSES.items() if hidden.motors in (None, motors)]
    return (*single, *(f"2x {name}" for name in TWICE if name in single))


def generator(seed: int, *words: object) -> np.random.Generator:
    """Random numbers that belong to the seed and the words, and to nothing else."""
    return np.random.default_rng([seed, zlib.crc32("/".join(str(word) for word in words).encode())])


def _stretches(r: np.random.Generator, n: int) -> tuple[Array, Array]:
    """Speed along the slow path and size of the fast one over time: rests, slow, usual and fast stretches, smoothed."""
    kinds = [("rest", 0.0, 0.0), ("slow", 0.35, 0.0), ("usual", 1.0, 0.0), ("fast", 1.0, 1.0), ("shake", 0.0, 1.6)]
    share = {"rest": 0.10, "slow": 0.25, "usual": 0.25, "fast": 0.25, "shake": 0.15}
    order = [kinds[k] for half in range(2) for k in r.permutation(len(kinds))]
    speed, fast = np.empty(n), np.empty(n)
    edges = np.cumsum([0.0, *(share[kind] / 2 for kind, _, _ in order)])
    places = np.round(edges / edges[-1] * n).astype(int)
    for (_, s, f), a, b in zip(order, places, places[1:], strict=False):
        speed[a:b], fast[a:b] = s, f
    window = np.hanning(round(0.25 / DT) + 2)[1:-1]
    window /= window.sum()
    half = len(window) // 2
    return tuple(np.convolve(np.pad(x, half, "edge"), window, "same")[half : half + n] for x in (speed, fast))


def _tones(r: np.random.Generator, count: int, low: float, high: float) -> tuple[Array, Array, Array]:
    """Frequencies (rad per s of path), phases, and weights of the tones of six coordinates (6, count)."""
    frequency = 2 * np.pi * np.exp(r.uniform(math.log(low), math.log(high), (6, count)))
    return frequency, r.uniform(0, 2 * np.pi, (6, count)), r.uniform(0.5, 1.0, (6, count)) / np.sqrt(frequency)


@lru_cache(maxsize=4)
def reference(seed: int, run: int, n: int) -> tuple[Array, Array]:
    """Return reference poses (n, 6), within reach of the legs and of the motors, and their nut angles (n, 6)."""
    r = generator(seed, "path", run)
    speed, fast = _stretches(r, n)
    t = np.arange(n) * DT
    way = np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1])) * DT])
    size = np.array([1.0, 1.0, 0.9, 5.0, 5.0, 7.0])  # m to rad: as much at the legs
    slow_tones, fast_tones = _tones(r, 3, 0.15, 1.0), _tones(r, 2, 3.0, 6.0)

    def wave(tones: tuple[Array, Array, Array], at: Array) -> Array:
        frequency, phase, weight = tones
        return size * np.einsum("ij,ijn->ni", weight, np.sin(frequency[:, :, None] * at + phase[:, :, None]))

    slow, quick = wave(slow_tones, way), fast[:, None] * wave(fast_tones, t)
    home = np.array([0.0, 0.0, 0.1259, 0.0, 0.0, 0.0])
    top = 0.65 * U_MAX / (0.052 * GEAR)  # rad/s at the nut, voltage left for the accelerations

    def largest(parts: Callable[[float], Array], fits: Callable[[Array], bool]) -> float:
        low, high = 0.0, 1.0
        for _ in range(18):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if fits(nut_angles(parts(middle))) else (low, middle)
        return low

    reach = REACH * 2 * np.pi / 0.004
    centre = nut_angles(home[None])[0]

    def inside(phi: Array, share: float) -> bool:
        rates = np.diff(phi, axis=0) / DT
        return bool(np.abs(phi - centre).max() < share * reach and np.abs(rates).max() < share * top)

    def gentle(phi: Array) -> bool:
        rates = np.diff(phi, axis=0) / DT
        return inside(phi, 1.0) and bool(np.abs(np.diff(rates, axis=0)).max() / DT < 2600.0)

    a = largest(lambda g: home + 0.1 * g * slow, lambda phi: inside(phi, 0.8))
    b = largest(lambda g: home + 0.1 * a * slow + 0.1 * g * quick, gentle)
    poses = home + 0.1 * a * slow + 0.1 * b * quick
    return poses, nut_angles(poses)


def _controller(machine: Machine, target: Array, r: np.random.Generator) -> Callable[[int, Array], Array]:
    """PD on the nut angles with the reference's rate fed forward; the D part of torques is a filtered difference."""
    scale, n = r.uniform(0.85, 1.15), len(target)
    rates = np.gradient(target, DT, axis=0)
    acceleration = np.gradient(rates, DT, axis=0)
    last, slope = np.zeros(6), np.zeros(6)
    keep = math.exp(-300.0 * DT)

    def of(k: int, y: Array) -> Array:
        nonlocal last, slope
        if k == 0:
            last = y
        slope = keep * slope + (1 - keep) * (y - last) / DT
        last = y
        k = min(k, n - 1)
        error, rate = target[k] - y, rates[k] - slope
        if machine.motors:
            u = 20.0 * scale * error + 0.02 * rate + 0.052 * GEAR * rates[k]
            return np.clip(u, -U_MAX, U_MAX)
        u = 0.12 * scale * error + 4e-3 * rate + 6.6e-4 / GEAR * acceleration[k]
        return np.clip(u, -TORQUE_MAX, TORQUE_MAX)

    return of


@dataclass(frozen=True)
class PlatformCase:
    """One blind case; a namer sees `nominal_plant(motors)`, ``record`` and ``held_out``. Of files it has no machine."""

    name: str
    legs: tuple[int, ...]  # where it is hidden, 1..6; none for what is common to the machine
    values: tuple[Mapping[str, float], ...]  # at each leg, or one set of common ones; torques and angles at the nut
    perturbed: Mapping[str, float]  # parameter -> true over nominal value, within tolerance
    seed: int
    motors: bool
    noise: str
    record: Record
    held_out: Record
    machine: Machine | None = None
    bare: Machine | None = None
    runs: tuple[Run, Run] | None = None

    @property
    def effect(self) -> str:
        """The effect's name in the catalogue's words, without how often; "none" and "cable" are no effects."""
        return self.name.removeprefix("2x ").removesuffix("-all")

    def truth(self) -> dict[str, Any]:
        return {
            "name": self.name, "effect": self.effect, "legs": list(self.legs), "values": [dict(v) for v in self.values],
            "perturbed": dict(self.perturbed), "seed": self.seed, "motors": self.motors, "noise": self.noise,
        }  # fmt: skip


def make_case(
    name: str, seed: int, *, motors: bool = True, noise: str = "mid", duration: float = DURATION
) -> PlatformCase:
    """Draw and run a case; "2x coulomb-friction" is at two legs. ValueError: a name that this machine cannot have."""
    if name not in names(motors):
        raise ValueError(f"{name!r}: one of {', '.join(names(motors))}")
    if noise not in NOISE:
        raise ValueError(f"noise {noise!r}: one of {', '.join(NOISE)}")
    draw = generator(seed, "machine", name, motors)
    stated = TOLERANCES[motors]
    factors = {key: 1.0 + tolerance * draw.uniform(-1, 1) for key, (_, tolerance) in stated.items()}
    if motors:
        factors["Kb"] = factors["Km"]  # one physical constant
    true = {key: value * factors[key] for key, (value, _) in stated.items()}
    drives = Drives(**{key: true[key] for key in MOTOR}) if motors else Drives()
    bare = machine = Machine(bodies(true), drives, motors)
    hidden = CLASSES[name.removeprefix("2x ")]
    order = [int(j) for j in draw.permutation(LEGS)]
    legs = tuple(sorted(order[: 2 if name.startswith("2x ") else 1]))
    values = []
    for leg in legs if hidden.where == "leg" else (-1,):
        values.append({key: float(v) for key, v in hidden.draw(draw, motors).items()})
        machine = hidden.put(machine, leg, values[-1])
    runs = tuple(_run(machine, seed, name, run, noise, round(duration / DT)) for run in range(2))
    if name == "backlash":
        legs, machine, runs = _opening(bare, values[0], order, (legs, machine, runs), (seed, noise, duration))
    where = {"leg": tuple(j + 1 for j in legs), "all": tuple(range(1, LEGS + 1)), "common": ()}[hidden.where]
    records = [_record(run, noise, motors, generator(seed, "current", name, k), word)
               for k, (run, word) in enumerate(zip(runs, ("record", "held-out"), strict=True))]  # fmt: skip
    return PlatformCase(name, where, tuple(values), factors, seed, motors, noise, *records, machine, bare, runs)


def _opening(
    bare: Machine, values: Values, order: Sequence[int], first: Any, how: tuple[int, str, float]
) -> tuple[tuple[int, ...], Machine, tuple[Run, ...]]:
    """The first leg in the order whose gap opens in both records, else the one where it opens most.

    The weight on a leg may hold its gap shut along a whole path: then nothing is hidden there.
    """
    seed, noise, duration = how
    tried = []
    for leg in order:
        machine = CLASSES["backlash"].put(bare, leg, values)
        runs = first[2] if (leg,) == first[0] else tuple(
            _run(machine, seed, "backlash", run, noise, round(duration / DT)) for run in range(2)
        )  # fmt: skip
        open_for = min(float(np.mean(run.flights[:, leg])) for run in runs)
        tried.append((open_for, (leg,), machine, runs))
        if open_for >= OPEN:
            break
    return max(tried, key=lambda t: t[0])[1:]


def _run(machine: Machine, seed: int, name: str, run: int, noise: str, n: int) -> Run:
    """One run; half a second before the record the controller takes hold of the machine at rest."""
    before = round(0.5 / DT)
    poses, phi = reference(seed, run, n)
    target = np.concatenate([np.repeat(phi[:1], before, axis=0), phi])
    # the way into the motion from rest, as smooth as the path
    rise = 0.5 - 0.5 * np.cos(np.pi * np.minimum(np.arange(n) * DT / 0.3, 1.0))
    target[before:] = phi[0] + rise[:, None] * (phi - phi[0])
    counts, spread, _, load = NOISE[noise]
    lsb = 2 * np.pi / (counts * GEAR)
    shake = spread * generator(seed, "encoder", name, run).normal(size=(before + n, 6))
    draw = generator(seed, "push", name, run)
    push = GEAR * load * np.column_stack([coloured(before + n, DT, draw) for _ in range(LEGS)])
    of = simulate(
        machine, poses[0], before + n, DT, _controller(machine, target, generator(seed, "controller", name)),
        seen=lambda k, y: lsb * np.round((y + shake[k]) / lsb), push=push,
    )  # fmt: skip
    return Run(np.arange(n) * DT, *(value[before:] for key, value in vars(of).items() if key != "t"))


def _record(run: Run, noise: str, motors: bool, r: np.random.Generator, name: str) -> Record:
    word, unit = ("u", "V") if motors else ("torque", "N m")
    inputs = {f"{word}_{j + 1}": run.u[:, j] for j in range(LEGS)}
    outputs = {f"phi_{j + 1}": run.readings[:, j] for j in range(LEGS)}
    units = {**dict.fromkeys(inputs, unit), **dict.fromkeys(outputs, "rad")}
    if motors:
        currents = {f"i_{j + 1}": run.currents[:, j] + NOISE[noise][2] * r.normal(size=len(run.t)) for j in range(LEGS)}
        outputs |= currents
        units |= dict.fromkeys(currents, "A")
    return Record(run.t, inputs, outputs, units, name)


def cached_case(
    folder: Path, name: str, seed: int, *, motors: bool = True, noise: str = "mid", duration: float = DURATION
) -> PlatformCase:
    """Return the case from its files in the folder; write missing files."""
    word = f"{name.replace(' ', '-')}_{'motors' if motors else 'torques'}_{noise}_{duration:g}s_{seed}"
    truth, first, second = (folder / f"{word}{end}" for end in (".json", "_record.h5", "_held-out.h5"))
    if not truth.exists():
        folder.mkdir(parents=True, exist_ok=True)
        case = make_case(name, seed, motors=motors, noise=noise, duration=duration)
        rl.save(first, case.record)
        rl.save(second, case.held_out)
        truth.write_text(json.dumps(case.truth(), indent=1), encoding="utf-8")
        return case
    saved = json.loads(truth.read_text(encoding="utf-8"))
    return PlatformCase(
        saved["name"], tuple(saved["legs"]), tuple(saved["values"]), saved["perturbed"], saved["seed"], saved["motors"],
        saved["noise"], rl.load(first), rl.load(second),
    )  # fmt: skip


def main(argv: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", default="1", help="like 1-3,7")
    parser.add_argument("--only", nargs="+", help="classes (all)")
    parser.add_argument("--torques", action="store_true", help="without motors")
    parser.add_argument("--noise", choices=NOISE, default="mid")
    parser.add_argument("--out", type=Path, default=Path("out/platform_cases"))
    args = parser.parse_args(argv)
    for seed in seeds(args.seeds):
        for name in args.only or names(not args.torques):
            began = time.process_time()
            case = cached_case(args.out, name, seed, motors=not args.torques, noise=args.noise)
            print(f"{name} {seed}: legs {list(case.legs)}, {list(case.values)}, {time.process_time() - began:.1f} s")


def seeds(text: str) -> list[int]:
    """ "1-3,7" -> [1, 2, 3, 7]."""
    ends = [part.split("-") for part in text.split(",")]
    return [seed for end in ends for seed in range(int(end[0]), int(end[-1]) + 1)]


if __name__ == "__main__":
    main()
