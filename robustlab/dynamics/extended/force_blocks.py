"""What stands in a linear set for the force laws of a plant: gains with a range, and bounded forces."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from robustlab.arrays import Array
from robustlab.dynamics.effects.contract import Footprint
from robustlab.dynamics.extended.attached_effect import AttachedEffect
from robustlab.dynamics.extended.extended_plant import ExtendedPlant
from robustlab.dynamics.ports.port_model import Port
from robustlab.errors import InputError, unknown_name
from robustlab.shown import AllFields

# Amplitudes at which a sector that is the same is taken for one of all amplitudes.
STRETCHES = (0.5, 1.0, 2.0)

Amplitude = float | tuple[float, float]
Dry = Literal["gain", "load", "both"]


@dataclass(frozen=True, eq=False)
class ForceSector:
    """A law as a gain: ``f = -k s`` with k in [low, high]; of the signal ``force`` ``f = k T``."""

    effect: AttachedEffect
    port: Port
    signal: str
    low: float
    high: float
    valid: str
    approximate: bool

    @property
    def middle(self) -> float:
        """What the nominal member has."""
        return 0.5 * (self.low + self.high)

    @property
    def radius(self) -> float:
        """Half width of the range."""
        return 0.5 * (self.high - self.low)

    @property
    def row(self) -> Array:
        """The state's combination that the gain multiplies, (n_x,)."""
        if self.signal == "force":
            return np.zeros_like(self.port.velocity)
        row = self.port.position if self.signal == "position" else self.port.velocity
        assert row is not None
        return row

    @property
    def unit(self) -> str:
        """Of the gain."""
        if self.signal == "force":
            return ""
        below = self.port.position_unit if self.signal == "position" else self.port.speed_unit
        return f"{self.port.unit}/({below})"


@dataclass(frozen=True)
class NoiseInput(AllFields):
    """An input of the set that stands for a bounded error: its signal is at most one."""

    name: str  # of the input
    # bound, unit: what one stands for
    bound: float
    unit: str
    origin: str  # where it comes from


@dataclass(frozen=True, eq=False)
class ForceParts:
    """What stands in for all laws of a plant."""

    # sectors, bounded: the gains; the bounded forces as inputs, each with its port
    sectors: tuple[ForceSector, ...]
    bounded: tuple[tuple[NoiseInput, Port], ...]
    # index of a law -> row (n_x,) with which the nominal member has ``f = -row x`` in place of its slope
    stand_in: Mapping[int, Array]
    left_out: Mapping[str, str]  # effect at its place -> why only its slope at the point is in the model


def force_parts(
    plant: ExtendedPlant, amplitude: Mapping[str, Amplitude], dry: Dry | None = None, width: float = 2.0
) -> ForceParts:
    """Choose for every force law what stands in for it."""
    sectors: list[ForceSector] = []
    bounded: list[tuple[NoiseInput, Port]] = []
    left: dict[str, str] = {}
    stand_in: dict[int, Array] = {}
    missing: dict[str, str] = {}
    for j, (e, _, port) in enumerate(plant.laws):
        seen = e.footprint()
        reason = _no_part(e, seen, port)
        if reason or seen is None:
            left[f"{e!r}"] = reason
            continue
        key = signal_name(plant, port, seen.signal)
        as_gain, as_load = _ways(e, seen, key in amplitude, dry)
        if as_gain and key not in amplitude and not _same_everywhere(e):
            if seen.signal == "position" and not seen.offset:
                left[f"{e!r}"] = f"only its slope at the point is in the model: give an amplitude of {key}"
            else:
                missing[key] = e.effect.title
            continue
        row = np.zeros_like(port.velocity)
        if as_gain:
            found = _sector(e, port, seen, amplitude.get(key), width)
            row = found.middle * found.row
            if found.radius > 0:
                sectors.append(found)
        if as_load:
            (name,) = free_names([e.load_name], [load.name for load, _ in bounded])
            words = f"{e.in_words} as a bounded force, for every motion; {e.values_in_words}"
            bounded.append((NoiseInput(name, e.largest_offset(width), port.unit, words), port))
        stand_in[j] = row
    if missing:
        name, title = next(iter(missing.items()))
        raise InputError(
            "effect_blocks", f"{title} at {name} without an amplitude", f"amplitude for {', '.join(missing)}",
            'the amplitude of the signal there at which the effect is described; dry="load" for friction needs none',
        )  # fmt: skip
    return ForceParts(tuple(sectors), tuple(bounded), stand_in, left)


def signal_name(plant: ExtendedPlant, port: Port, signal: str) -> str:
    """The name under which the amplitude of what a law sees is given: its joint, or the state of its position."""
    if signal != "position" or port.position is None:
        return port.name
    return plant.states[int(np.flatnonzero(port.position)[0])].name


def check_amplitudes(plant: ExtendedPlant, amplitude: Mapping[str, Amplitude]) -> None:
    """Every amplitude is positive (a pair: increasing) and has an effect at its place."""
    joints = {signal_name(plant, port, s) for _, _, port in plant.laws for s in ("speed", "position")}
    known = tuple(dict.fromkeys([*(e.site.name for e in plant.effects), *sorted(joints)]))
    for name, value in amplitude.items():
        where = f"effect_blocks: amplitude {name!r}"
        if name not in known:
            raise unknown_name(where, "no effect there", name, known)
        pair = _pair(value)
        if not (len(pair) == 2 and all(_is_positive(a) for a in pair) and pair[0] <= pair[1]):
            raise InputError(where, f"{value!r}", "a positive number, or (least, largest) of two")
        if name not in joints and pair[0] != pair[1]:
            raise InputError(where, f"{value!r} at a driver or sensor", "one positive number")


def _is_positive(value: object) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and 0 < value < math.inf


def _pair(value: Amplitude) -> tuple[float, ...]:
    return tuple(value) if isinstance(value, (tuple, list)) else (value, value)


def _no_part(e: AttachedEffect, seen: Footprint | None, port: Port) -> str:
    """Why nothing can stand in for a law, or nothing."""
    if seen is None or seen.signal not in ("speed", "current", "position", "force", "time"):
        return "only its slope at the point is in the model"
    if e.effect.structural:
        return "it divides the joint: no force of one joint stands for it"
    if seen.signal == "force" and np.count_nonzero(port.force) != 1:
        return "only its slope at the point is in the model: its joint shares its inertia with others"
    return ""


def _ways(e: AttachedEffect, seen: Footprint, known: bool, dry: Dry | None) -> tuple[bool, bool]:
    """Whether the law becomes a gain, and whether a bounded force."""
    has_gain = seen.signal == "force" or any(
        f is not None and f.gain_upper > f.gain_lower
        for a in STRETCHES
        for f in [e.footprint(1e3 * a)]
    ) or seen.gain_upper > seen.gain_lower  # fmt: skip
    if not seen.offset:
        return True, False
    if not has_gain:
        return False, True
    mode = dry or ("gain" if known else "load")
    if mode == "both" and seen.signal == "position":  # it does not oppose a speed: |e| would be F + k |s|
        mode = "load"
    return mode != "load", mode != "gain"


def _same_everywhere(e: AttachedEffect) -> bool:
    found = [e.footprint(a) for a in STRETCHES]
    return len({(f.gain_lower, f.gain_upper) for f in found if f is not None}) == 1 and found[0] is not None


def _sector(e: AttachedEffect, port: Port, seen: Footprint, amplitude: Amplitude | None, width: float) -> ForceSector:
    ends = _pair(1.0 if amplitude is None else amplitude)
    all_of = [f for a in ends for f in e.footprints(a, width)]
    low, high = min(f.gain_lower for f in all_of), max(f.gain_upper for f in all_of)
    dry = bool(seen.offset)
    if dry and ends[0] < ends[1]:
        at_largest = [f.describing for f in e.footprints(ends[1], width)]
        low = max(low, min(at_largest)) if np.isfinite(at_largest).all() else low
    unit = port.position_unit if seen.signal == "position" else port.speed_unit
    if seen.signal == "force":
        valid = "a gain that may change at every instant, for every motion"
    elif amplitude is None:
        valid = "at every amplitude, as a gain that may change with the motion"
    elif dry:
        reach = f"of amplitude {ends[0]:.4g} {unit} and more"
        if ends[0] < ends[1]:
            reach = f"of amplitudes {ends[0]:.4g} to {ends[1]:.4g} {unit}"
        valid = f"harmonic balance, for oscillations {reach}"
    else:
        valid = f"up to {ends[1]:.4g} {unit}, as a gain that may change with the motion"
    return ForceSector(e, port, seen.signal, low, high, valid, dry and seen.signal != "force")


def force_columns(
    plant_matrices: Sequence[Array], ports: Sequence[Port], sectors: Sequence[ForceSector]
) -> tuple[Array, Array, Array]:
    """Columns of G for a force at each port; rows of C and of D (over u and those forces) for what the sectors see."""
    e, f, g = plant_matrices
    push = e @ np.array([p.force for p in ports]).T if ports else np.zeros((len(f), 0))
    c, d = np.zeros((len(sectors), len(f))), np.zeros((len(sectors), g.shape[1] + len(ports)))
    for k, s in enumerate(sectors):
        if s.signal != "force":
            c[k] = s.row
            continue
        dual = push[:, k] / float(push[:, k] @ push[:, k])
        others = push.copy()
        others[:, k] = 0.0
        c[k], d[k] = dual @ f, np.concatenate([dual @ g, dual @ others])
    return push, c, d


def free_names(names: list[str], taken: Sequence[str]) -> list[str]:
    """The names, with primes where they are taken already."""
    found: list[str] = []
    for name in names:
        while name in taken or name in found:
            name += "'"
        found.append(name)
    return found
