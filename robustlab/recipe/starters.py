"""Recipes to start from: an example, or one for a record of the user's, with comments where the user has to decide."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from robustlab.errors import EnvironmentFault, InputError, UsageError, plain_text
from robustlab.files.atomic import atomic_write
from robustlab.identification.record_check.column_mapping import columns_of, propose_columns
from robustlab.record import Record

STARTER = """\
# A robustlab recipe: steps, run in the order written, and requirements that decide the exit code.
#   check it:  robustlab recipe check {name}.toml
#   run it:    robustlab run {name}.toml
#   change a value without editing:  robustlab run {name}.toml --set uncertain.tolerances.Kf=0.2
schema = "robustlab.recipe/1"
name = "{name}"
title = "A DC motor with uncertain friction"
description = "Does the no-load speed stay within what the data sheet says?"
seed = 0 # of all random numbers: same seed, same answer

# Each step has a name of your choice and does one thing (`robustlab recipe schema` lists all kinds and their keys).
[step.motor]
do = "plant"
plant = "dc-motor"
# parameters = {{ R = 2.1, J = [7.2e-6, 0.1] }}   # SI units; [value, relative tolerance]

# Steps refer to earlier ones by name.
[step.uncertain]
do = "uncertain"
of = "motor"
tolerances = {{ Kf = 0.35 }} # viscous friction +-35 %
outputs = ["omega"]

[step.speed]
do = "sample"
of = "uncertain"
n = 20
vertices = 2
input = {{ u = 42.0 }} # V, applied at t = 0
t_end = 0.05 # s
reference = [{{ output = "omega", value = 788.5, text = "data sheet" }}]

# A requirement names a number of a step and a condition: at_least, at_most, within = [low, high], equals (tolerance).
[[require]]
text = "The set of models covers the data sheet's no-load speed of 788.5 rad/s"
that = "speed.outputs.omega.final.upper"
at_least = 788.5
"""

# Channels that are taken for inputs where no plant says what its inputs are: the name's first word, or the unit.
INPUT_NAME = re.compile(
    r"(u\d*|f|force|tau|torque|command|cmd|input|in|voltage|v_in|dac|pwm)([ _.\-\[].*)?", re.IGNORECASE
)
INPUT_UNITS = ("V",)
# Units that a record may have in the place of a plant's.
OTHER_UNITS = {"V": "mV", "A": "mA", "rad": "deg", "rad/s": "rpm", "m": "mm", "m/s": "mm/s", "N": "kN", "N m": "mN m"}


@dataclass(frozen=True)
class Channels:
    """Which channels of a file a recipe takes, and what was only guessed."""

    record: Record  # the record as it is read with them
    # inputs, outputs: as a record step takes them: names, or `"u=SIGNAL"`
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    clock: str | None  # channel with the times where it had to be guessed; None where the file says it
    units: dict[str, str]  # name -> unit that the file states and the plant does not use: converted when read
    # names whose unit neither the file nor anybody states -> the unit in which they are taken, where it is known
    unstated: dict[str, str]
    guessed: tuple[str, ...]  # what was guessed, a line each


def recognised(path: str, plant: Any = None, clock: str | None = None, dt: float | None = None) -> Channels:
    """Times, inputs and outputs of a record, found by names and units; with a plant, its signals are looked for.

    ``path``: the file.
    ``plant``: what knows its ``inputs`` and ``outputs``, or None.
    ``clock``, ``dt``: as for `robustlab.Record.read`, where the user says them.
    Raises InputError: what the reader refuses; no clock; a plant's input or all its outputs without a channel.
    """
    guessed: list[str] = []
    found, guess = columns_of(lambda c, step: Record.read(path, clock=c or clock, dt=step), dt)
    if guess is not None:
        guessed.append(f"{guess} rises from sample to sample: taken for the time, in s where no unit is stated")
    names = [name for name in (*found.inputs, *found.outputs) if name not in (clock, guess)]
    if plant is None:
        ins, outs = _guessed_sides(found, names)
        guessed.append(f"inputs are {', '.join(ins)}, by name and unit")
        texts, units, stated = (ins, outs), {}, {name: found.unit(name) for name in (*ins, *outs)}
        taken = {}
    else:
        mapping = propose_columns(found, plant.inputs, plant.outputs, {clock, guess})
        guessed += mapping.lines()
        if mapping.missing or not mapping.outputs:
            missing = ", ".join(mapping.missing) or ", ".join(s.name for s in plant.outputs)
            raise InputError(
                path, f"no channel for {missing} of {plant.name}; there are {', '.join(names)}",
                "a column of that name, or the only one in its unit",
                "write the recipe without --plant, and name the channels in it: inputs = [\"u=COLUMN\"]",
            )  # fmt: skip
        texts, units = (mapping.texts("inputs"), mapping.texts("outputs")), dict(mapping.units)
        stated = {name: found.unit(column) for name, column in {**mapping.inputs, **mapping.outputs}.items()}
        taken = {s.name: s.unit for s in (*plant.inputs, *plant.outputs)}
    record = Record.read(path, None, *texts, dt, clock=guess or clock, units=units or None)
    unstated = {name: taken.get(name, "") for name, unit in stated.items() if not unit}
    return Channels(record, *texts, guess or clock, units, unstated, tuple(guessed))


def _guessed_sides(found: Record, names: Sequence[str]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    ins = [name for name in names if INPUT_NAME.fullmatch(name)] or [n for n in names if found.unit(n) in INPUT_UNITS]
    if not ins or len(ins) == len(names):
        ins = list(names[:1])
    return tuple(ins), tuple(name for name in names if name not in ins)


# --- texts -----------------------------------------------------------------------------------------------------------


def record_recipe(name: str, path: str, channels: Channels, plant: str = "", dt: float | None = None) -> str:
    """The text of a recipe that reads a record and, with a plant, compares the two, for ``robustlab run`` as it is.

    ``name``: of the recipe.
    ``path``: the record's file, as the recipe is to name it.
    ``channels``: what was recognised in it.
    ``plant``: name of a plant, or ``file.py:name``; empty for none.
    ``dt``: sample time in s where the user gave it.
    """
    record = channels.record
    lines = [
        f"# A recipe for {plain_text(Path(path).name)}. DECIDE marks what only you can know.",
        f"#   check it:  robustlab recipe check {name}.toml",
        f"#   run it:    robustlab run {name}.toml",
        'schema = "robustlab.recipe/1"',
        f"name = {_text(name)}",
        f"title = {_text(_title(path, plant))}",
        "",
        "[step.record]",
        'do = "record"',
        f"path = {_text(path)}",
        *(f"# DECIDE: {plain_text(line)}. Right?" for line in channels.guessed),
        *([f"clock = {_text(channels.clock)}"] if channels.clock else []),
        *([f"dt = {dt!r} # s"] if dt else []),
        f"inputs = {_texts(channels.inputs)}",
        f"outputs = {_texts(channels.outputs)}",
    ]
    if channels.units:
        pairs = ", ".join(f"{_text(k)} = {_text(v)}" for k, v in channels.units.items())
        lines.append(f"units = {{ {pairs} }} # as the file states them; converted to SI")
    for signal, unit in channels.unstated.items():
        told = f"the file states no unit of {plain_text(signal)}; its numbers are taken as {unit or 'SI'}"
        other = OTHER_UNITS.get(unit, "deg")
        lines.append(f'# DECIDE: {told}. If they are not: units = {{ {_text(signal)} = "{other}" }}')
    lines += [
        f"# {record.n} samples in {record.duration:.6g} s. DECIDE: is it simulated? Then: simulated = true",
        'about = "" # DECIDE: which machine, who measured it, when',
    ]
    if not plant:
        return "\n".join([*lines, *_WITHOUT_PLANT.splitlines()]) + "\n"
    output = channels.outputs[0].partition("=")[0]
    more = _WITH_PLANT.replace("@PLANT@", _text(plant)).replace("@OUTPUT@", plain_text(output))
    return "\n".join([*lines, *more.splitlines()]) + "\n"


_WITHOUT_PLANT = """
# DECIDE: which plant is it? One that comes with robustlab, or your own: robustlab plant new mymachine
# [step.plant]
# do = "plant"
# plant = "servo-axis"        # or "mymachine.py:axis"
#
# [step.compare]
# do = "compare"
# of = "plant"
# record = "record"
"""

_WITH_PLANT = """
[step.plant]
do = "plant"
plant = @PLANT@
# DECIDE: your machine's values, [value, relative tolerance]; robustlab plant show lists them with those that are used.
# parameters = { NAME = [1.0, 0.1] }

[step.compare]
do = "compare"
of = "plant"
record = "record"

# What does the plant lack? Takes a minute or several; better with a second record that no fit sees, in held_out.
# [step.naming]
# do = "discover"
# of = "plant"
# records = ["record"]

# DECIDE: what must hold; without a requirement the exit code only says that every step ended well.
# [[require]]
# text = "The plant explains the record within windows: fit above 90 %"
# that = "compare.outputs.@OUTPUT@.windowed_fit"
# at_least = 90
"""


def _title(path: str, plant: str) -> str:
    return f"{plant} against {Path(path).name}" if plant else f"The record {Path(path).name}"


def _text(text: str) -> str:
    """A TOML string: control characters escaped."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def _texts(texts: Sequence[str]) -> str:
    return f"[{', '.join(map(_text, texts))}]"


# --- writing ---------------------------------------------------------------------------------------------------------


def write_starter(name: str, text: str = "", force: bool = False) -> Path:
    """Write ``NAME.toml`` in the working directory, or in the folder before the name: the example, or ``text``.

    Raises UsageError: a name that a recipe cannot have. EnvironmentFault: the file exists already, and ``force`` is not
    given; there is no such folder.
    """
    path = Path(os.path.dirname(name), f"{stem_of(name)}.toml")  # noqa: PTH120  a slash at the end is no name
    if path.exists() and not force:
        raise EnvironmentFault(str(path), "exists already", "a new name, or --force to write over it")
    content = text or STARTER.format(name=path.stem)
    atomic_write(path, lambda temporary: temporary.write_text(content, encoding="utf-8"))
    return path


def stem_of(name: str) -> str:
    """The recipe's name without folder and ``.toml``; refused where a recipe cannot have it."""
    stem = os.path.basename(name).removesuffix(".toml")  # noqa: PTH119  empty after a slash at the end
    if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_-]{0,59}", stem):
        raise UsageError(f"recipe new {name}", "not a name", "letters, digits, - and _, with a letter first")
    return stem
