"""Measured frequency responses from text tables, as the arguments of `robustlab.frequency_data`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from robustlab.arrays import Array, ComplexArray
from robustlab.errors import InputError, did_you_mean
from robustlab.files.text_table import TextTable, read_table
from robustlab.units import factor_between

__all__ = ["read_response"]

PARTS = ("real", "imag", "magnitude", "phase", "radius")
# How a channel's columns may be called, and the one channel of a table that does not say.
CHANNEL, ONLY = "OUTPUT from INPUT", "y1 from u1"


def read_response(
    path: str | Path, units: Mapping[str, str] | None = None, delimiter: str | None = None, decimal: str = "."
) -> dict[str, Any]:
    """What a table says of a response: ``given``, ``omega``, ``radius``, ``inputs``, ``outputs``.

    The first column is the frequency, in rad/s or Hz. Each channel has the columns ``OUTPUT from INPUT real`` and
    ``... imag``, or ``... magnitude`` (dB where its unit says so) and ``... phase`` (rad or deg), and may have ``...
    radius``, what is not known of the entry. One channel alone needs no name. A column ``radius`` without a channel
    bounds the largest singular value of the error of all channels.

    Parameters
    ----------
    path, delimiter, decimal
        See `robustlab.files.text_table.read_table`.
    units
        Name of a column -> its unit, where the header ``name [unit]`` does not say it.

    Raises
    ------
    InputError
        What is wrong with the table; columns with no such name, channels that are not whole, units that are not said.
    """
    where, table = str(path), read_table(path, delimiter, decimal)
    if not table.has_header:
        raise InputError(where, "no header", f"names: frequency [Hz], {CHANNEL} real, {CHANNEL} imag")
    unit = _units(where, table, units or {})
    columns = dict(zip(table.names, table.values.T, strict=True))
    first, *others = table.names
    omega = _factor(where, first, unit, "rad/s", "the frequency, in rad/s or Hz") * columns[first]
    channels: dict[str, dict[str, str]] = {}
    for name in others:
        channel, part = _channel_and_part(where, name)
        channels.setdefault(channel, {})[part] = name
    shared = channels.pop("").get("radius") if set(channels.get("", ())) == {"radius"} else None
    if list(channels) == [""]:
        channels = {ONLY: channels[""]}
    pairs = {channel: _pair(where, channel, next(iter(parts.values()))) for channel, parts in channels.items()}
    outputs, inputs = (list(dict.fromkeys(pair[k] for pair in pairs.values())) for k in (0, 1))
    missing = [f"{y} from {u}" for y in outputs for u in inputs if f"{y} from {u}" not in channels]
    if missing or not channels:
        raise InputError(where, f"no columns of {missing[0] if missing else CHANNEL}", "every output from every input")
    bounded = [channel for channel, parts in channels.items() if "radius" in parts]
    if bounded and (shared or len(bounded) < len(channels)):
        rest = next((c for c in channels if c not in bounded), "")
        found = f"a radius of {bounded[0]}, and {f'none of {rest}' if rest else 'one without a channel'}"
        raise InputError(where, found, "one of each channel, or one for all")
    given = np.zeros((len(omega), len(outputs), len(inputs)), dtype=complex)
    radius = np.zeros(given.shape)
    for channel, (y, u) in pairs.items():
        at = slice(None), outputs.index(y), inputs.index(u)
        given[at] = _response(where, channel, channels[channel], columns, unit)
        if bounded:
            radius[at] = _plain(where, channels[channel]["radius"], columns, unit)
    found = _plain(where, shared, columns, unit) if shared else radius if bounded else None
    return {"given": given, "omega": omega, "radius": found, "inputs": inputs, "outputs": outputs}


def _units(where: str, table: TextTable, given: Mapping[str, str]) -> dict[str, str]:
    """Column -> unit: the one that was given, else that of the header."""
    for name in given:
        if name not in table.names:
            raise InputError(
                f"{where}: unit of {name!r}", "no such column", f"one of {', '.join(table.names)}",
                did_you_mean(name, table.names),
            )  # fmt: skip
    return {**dict(zip(table.names, table.units, strict=True)), **given}


def _channel_and_part(where: str, name: str) -> tuple[str, str]:
    """``"y from u real"`` or ``"real"``."""
    channel, _, part = name.rpartition(" ")
    if part not in PARTS:
        hint = did_you_mean(part, PARTS)
        raise InputError(where, f"column {name!r}", f"{CHANNEL}, then one of {', '.join(PARTS)}", hint)
    return channel, part


def _pair(where: str, channel: str, column: str) -> tuple[str, str]:
    output, found, source = channel.partition(" from ")
    if not (found and output and source):
        raise InputError(where, f"column {column!r} of no channel", f"a name that begins with {CHANNEL}")
    return output, source


def _factor(where: str, name: str, unit: Mapping[str, str], wanted: str, expected: str) -> float:
    """From the unit of a column, which must be said, to the one that is wanted."""
    factor = factor_between(unit[name], wanted) if unit[name] else None
    if factor is None:
        found = f"column {name!r} " + (f"in {unit[name]!r}" if unit[name] else "without a unit")
        raise InputError(where, found, expected, f"write {name} [{wanted}] into the header, or give its unit")
    return factor


def _response(
    where: str, channel: str, parts: Mapping[str, str], columns: Mapping[str, Array], unit: Mapping[str, str]
) -> ComplexArray:
    """From real and imaginary part, or from magnitude and phase."""
    kinds = set(parts) - {"radius"}
    if kinds == {"real", "imag"}:
        real, imag = (_plain(where, parts[kind], columns, unit) for kind in ("real", "imag"))
        return real + 1j * imag
    if kinds != {"magnitude", "phase"}:
        found = f"{channel} with {', '.join(sorted(kinds)) or 'a radius alone'}"
        raise InputError(where, found, "real and imag, or magnitude and phase")
    size, angle = parts["magnitude"], parts["phase"]
    phase = _factor(where, angle, unit, "rad", "rad or deg") * columns[angle]
    magnitude = 10.0 ** (columns[size] / 20.0) if unit[size] == "dB" else _plain(where, size, columns, unit)
    return magnitude * np.exp(1j * phase)


def _plain(where: str, name: str, columns: Mapping[str, Array], unit: Mapping[str, str]) -> Array:
    """A column in the units of the signals themselves."""
    if unit[name] not in ("", "1"):
        expected = "numbers in the units of the signals, so none" + (", or dB" if name.endswith("magnitude") else "")
        raise InputError(where, f"column {name!r} in {unit[name]!r}", expected)
    return columns[name]
