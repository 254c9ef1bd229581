"""Read a plant named on the command line: a shipped plant, or a file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import robustlab as rl
from robustlab.errors import InputError, UsageError, did_you_mean


def runs_code(name: str) -> bool:
    """Return whether reading the plant runs a user's code: ``file.py:name``, or a unit of FMI."""
    from robustlab.dynamics.plant_file import plant_reference, unit_reference

    return bool(plant_reference(name) or unit_reference(name))


def read_plant(name: str, parameters: Mapping[str, Any]) -> Any:
    """Return the shipped plant, or the plant in a Python file (``file.py:name``, which is run) or an HDF5 file."""
    from robustlab.storage.interchange import is_plant_file, load_plant

    if is_plant_file(name) and not runs_code(name):
        made = load_plant(name)
        return made.with_parameters(**parameters) if parameters else made
    if not runs_code(name):
        _require_known(name)
    return rl.plant(name, **parameters)


def named_plant(name: str, settings: Sequence[str]) -> Any:
    """Return the plant of a name or a user's code; None where the name is that of another file."""
    from robustlab.dynamics import plant_names
    from robustlab.storage.interchange import is_plant_file

    if name in plant_names() or runs_code(name) or (settings and is_plant_file(name)):
        return read_plant(name, plant_settings(settings))
    if settings:
        known = f"one of {', '.join(plant_names())}, or path/to/file.py:name"
        raise UsageError(f"--set {settings[0]}", f"{name} is no plant", known, did_you_mean(name, plant_names()))
    if not Path(name).suffix:
        _require_known(name)
    return None


def plant_settings(texts: Sequence[str] | None) -> dict[str, Any]:
    """Return ``["R=2.1", "preset=physical", "motors=true"]`` as keyword arguments of a plant."""
    values: dict[str, Any] = {}
    for text in texts or []:
        name, equals, value = text.partition("=")
        if not (name and equals and value):
            raise UsageError(f"--set {text}", "no parameter and value", "NAME=VALUE")
        words: dict[str, Any] = {"true": True, "false": False}
        try:
            values[name] = words[value] if value in words else float(value)
        except ValueError:
            values[name] = value  # a choice, such as a preset, which the plant checks
    return values


def made_of(name: str, thing: Any) -> dict[str, str]:
    """Return file -> SHA-256 of the files read for a plant or model; empty for a shipped plant."""
    from robustlab.provenance import code_of, file_sha256

    return code_of(thing) or ({name: file_sha256(name)} if Path(name).is_file() else {})


def _require_known(name: str) -> None:
    """Raise on a name of neither a plant nor a file, with the nearest name of a plant or of a file in its folder."""
    from robustlab.dynamics import plant_names

    path = Path(name)
    try:
        if name in plant_names() or path.exists():
            return
        files = [str(file) for file in path.parent.iterdir()] if path.parent.is_dir() else []
    except (OSError, ValueError):  # a name too long, a NUL in it, a folder that may not be read
        files = []
    known = f"one of {', '.join(plant_names())}, a file, path/to/file.py:name or path/to/machine.fmu"
    hint = did_you_mean(name, [*plant_names(), *files]) or "robustlab plant list"
    raise InputError(name, "no such plant, and no such file", known, hint)
