"""Blind cases: a machine with hidden effects, its measurements, and the nominal model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

import robustlab as rl
from robustlab import Record

from .effects import Setting, hidden_effect
from .excitation import reference, voltage
from .families import possible
from .machine import Array
from .plants import LEVELS, PLANTS, Setup
from .rig import Rig, generator

NOISE = tuple(LEVELS)
RECORD, HELD_OUT, REPEAT, EXPERIMENT = range(4)  # runs, each with noise of its own


@dataclass(frozen=True)
class Case:
    """One blind case. An identification method may use ``plant``, ``record``, and on request ``repeat``.

    ``*_clean``: response of the machine to the *logged* input, output name -> (n,), with all effects, without
    disturbance, noise and rounding. Effects are added to the perturbed parameters; "none" has none.
    """

    plant: Any  # the user's nominal model with its tolerances
    record: Record
    held_out: Record  # another input on the same machine, never used in a fit
    repeat: Record  # the record's input, in closed loop its reference, once more with other noise
    record_clean: Mapping[str, Array]
    held_out_clean: Mapping[str, Array]
    effects: tuple[str, ...]
    true_parameters: Mapping[str, Mapping[str, float]]
    perturbed: Mapping[str, float]  # parameter -> true over nominal value, within the tolerance
    current: bool
    rig: Rig = field(repr=False)

    def experiment(self, u: ArrayLike, *, run: int = 0, current: bool | None = None) -> Record:
        """Measure once more on the same machine, from rest at zero: input u (n,), held.

        ``run`` picks the noise; ``current`` adds a current sensor (the case's own choice by default).
        """
        got = self.rig.measured(np.asarray(u, dtype=np.float64), EXPERIMENT + run)
        return self.rig.record(got, f"experiment {run}", self.current if current is None else current)


def make_case(
    effects: str | Sequence[str],
    seed: int,
    *,
    noise: str = "mid",
    excitation: str = "rich",
    current: bool = False,
    plant: str = "dc-motor",
    duration: float = 4.8,
    dt: float | None = None,
    closed_loop: bool = False,
    parameters: Mapping[str, Mapping[str, float]] | None = None,
) -> Case:
    """Draw a case; the same arguments give the same case, bit by bit, on the same machine.

    Machine, input and noise have generators of their own, seeded by ``seed`` and the effects' names: cases that differ
    only in noise level, input or sensors share their perturbed parameters and the draws that do not refer to the input.

    ``effects``: one name, several, or "none". ``noise``: "low", "mid" or "high". ``excitation``: "rich", "square",
    "oneway", "multisine" or "steps", not used where in ``closed_loop`` a position controller follows a drawn reference
    and its voltage is logged. ``current``: a current sensor, too. ``parameters``: effect -> parameters to set instead
    of their draws. ValueError: unknown names, a current where the plant has none, an effect that it cannot have.
    """
    given = parameters or {}
    names = _checked(effects, plant, current, given)
    setup = PLANTS[plant]
    if closed_loop and setup.feedback is None:
        raise ValueError(f"no controller works on {plant}")
    dt = setup.dt if dt is None else dt
    n = round(duration / dt)
    draw = generator(seed, "machine", plant, *names)
    inputs = generator(seed, "input", plant, excitation, closed_loop, *names)
    if setup.vary is not None:
        setup = setup.vary(setup, draw)
    resonance = _resonance(setup)

    def next_input() -> Array:
        if closed_loop:
            return reference(n, dt, setup.reach, inputs)
        return voltage(excitation, n, dt, setup.largest, inputs, inputs=setup.inputs, resonance=resonance)

    perturbed = _perturbed(setup, draw)
    bare = setup.machine({name: value * perturbed[name] for name, (value, _) in setup.nominal.items()})
    feedback = (*setup.feedback, setup.largest) if closed_loop and setup.feedback else None
    first, second = next_input(), next_input()
    setting = Setting(setup, bare, first, second, dt, feedback)
    machine, true = bare, {}
    for name in names:
        hidden = hidden_effect(plant, name)
        drawn = {**hidden.draw(draw, setting), **given.get(name, {})}
        true[name] = {key: float(v) for key, v in drawn.items()}
        machine = hidden.put(machine, true[name], setting)
    rig = Rig(setup, machine, bare, true, seed, noise, dt, feedback)
    record = rig.measured(first, RECORD, closed=closed_loop)
    held_out = rig.measured(second, HELD_OUT, closed=closed_loop)
    repeat = rig.measured(first, REPEAT, closed=closed_loop)
    records = (rig.record(*of, current) for of in ((record, "record"), (held_out, "held-out"), (repeat, "repeat")))
    clean = (rig.channels(rig.clean(got[0].u, run), current) for got, run in ((record, RECORD), (held_out, HELD_OUT)))
    return Case(rl.plant(plant, **setup.nominal), *records, *clean, names, true, perturbed, current, rig)


def _resonance(setup: Setup) -> float:
    """Frequency in Hz of a plant with a spring, nominal; 0 of others."""
    value = {name: value for name, (value, _) in setup.nominal.items()}
    return float(np.sqrt(value["k"] / value["m"])) / (2 * np.pi) if setup.inputs == "resonant" else 0.0


def _checked(
    effects: str | Sequence[str], plant: str, current: bool, parameters: Mapping[str, Mapping[str, float]]
) -> tuple[str, ...]:
    """The effects' names, without "none"; refuses what does not exist."""
    names = tuple(name for name in ([effects] if isinstance(effects, str) else effects) if name != "none")
    if current and not PLANTS[plant].electrical:
        raise ValueError(f"{plant} has no current to measure")
    for name in names:
        if not possible(plant, name):
            raise ValueError(f"effect {name!r}: unknown, or makes no sense on {plant}")
    if len(set(names)) < len(names) or {*parameters} - set(names):
        raise ValueError("every effect once, and parameters only for effects of the case")
    return names


def _perturbed(setup: Setup, draw: np.random.Generator) -> dict[str, float]:
    """Factors of the nominal parameters, uniform within the tolerances; one factor for one physical constant."""
    factors = {name: 1.0 + tolerance * draw.uniform(-1, 1) for name, (_, tolerance) in setup.nominal.items()}
    for group in setup.together:
        factors.update(dict.fromkeys(group, factors[group[0]]))
    return factors
