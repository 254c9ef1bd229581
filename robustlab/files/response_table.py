"""Measured frequency responses from text tables, as the arguments of `robustlab.frequency_data`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from robustlab.arrays import Array, ComplexArray
from robustlab.errors import InputError, did_you_mean
from robustlab.files.text_table import read_table
from robustlab.units import factor_between

PARTS = ("real", "imag", "magnitude", "phase", "radius")
# How the columns of a channel begin, and the one channel of a table that does not say.
CHANNEL, ONLY = "OUTPUT from INPUT", "y1 from u1"


@dataclass(frozen=True)
class _Columns:
    """The columns of a file with their units."""

    where: str
    values: Mapping[str, Array]
    unit: Mapping[str, str]

    def converted(self, name: str, wanted: str, expected: str) -> Array:
        """A column whose unit must be said."""
        unit = self.unit[name]
        factor = factor_between(unit, wanted) if unit else None
        if factor is None:
            found = f"column {name!r} " + (f"in {unit!r}" if unit else "without a unit")
            raise InputError(self.where, found, expected, f"write {name} [{wanted}] into the header, or give its unit")
        return factor * self.values[name]

    def plain(self, name: str) -> Array:
        """A column in the units of the signals themselves."""
        if self.unit[name] not in ("", "1"):
            words = ", or dB" if name.endswith("magnitude") else ""
            expected = f"numbers in the units of the signals, so none{words}"
            raise InputError(self.where, f"column {name!r} in {self.unit[name]!r}", expected)
        return self.values[name]

    def response(self, channel: str, parts: Mapping[str, str]) -> ComplexArray:
        """From real and imaginary part, or from magnitude and phase."""
        kinds = set(parts) - {"radius"}
        if kinds == {"real", "imag"}:
            return np.asarray(self.plain(parts["real"]) + 1j * self.plain(parts["imag"]), dtype=np.complex128)
        if kinds != {"magnitude", "phase"}:
            found = f"{channel} with {', '.join(sorted(kinds)) or 'a radius alone'}"
            raise InputError(self.where, found, "real and imag, or magnitude and phase")
        size, phase = parts["magnitude"], self.converted(parts["phase"], "rad", "rad or deg")
        with np.errstate(all="ignore"):  # what is not finite is refused by whoever takes it
            gain = 10.0 ** (self.values[size] / 20.0) if self.unit[size] == "dB" else self.plain(size)
            return np.asarray(gain * np.exp(1j * phase), dtype=np.complex128)


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
    for name in set(units or {}) - set(table.names):
        expected = f"one of {', '.join(table.names)}"
        raise InputError(f"{where}: unit of {name!r}", "no such column", expected, did_you_mean(name, table.names))
    said = {**dict(zip(table.names, table.units, strict=True)), **(units or {})}
    columns = _Columns(where, dict(zip(table.names, table.values.T, strict=True)), said)
    omega = columns.converted(table.names[0], "rad/s", "the frequency, in rad/s or Hz")
    channels = _channels(where, table.names[1:])
    shared = channels.pop("")["radius"] if list(channels.get("", ())) == ["radius"] else None
    if list(channels) == [""]:
        channels = {ONLY: channels[""]}
    pairs = {channel: channel.partition(" from ")[::2] for channel in channels}
    for channel, pair in pairs.items():
        if not all(pair):
            column = next(iter(channels[channel].values()))
            raise InputError(where, f"column {column!r} of no channel", f"a name that begins with {CHANNEL}")
    outputs, inputs = (list(dict.fromkeys(pair[k] for pair in pairs.values())) for k in (0, 1))
    missing = [f"{y} from {u}" for y in outputs for u in inputs if f"{y} from {u}" not in channels]
    if missing or not channels:
        raise InputError(where, f"no columns of {missing[0] if missing else CHANNEL}", "every output from every input")
    without = [channel for channel, parts in channels.items() if "radius" not in parts]
    if len(without) < len(channels) and (without or shared):
        found = f"a radius of {next(c for c in channels if c not in without)}"
        found += f", and none of {without[0]}" if without else ", and one of no channel"
        raise InputError(where, found, "one of each channel, or one for all")
    given = np.zeros((len(omega), len(outputs), len(inputs)), dtype=complex)
    radius = np.zeros(given.shape)
    for channel, (y, u) in pairs.items():
        at = slice(None), outputs.index(y), inputs.index(u)
        given[at] = columns.response(channel, channels[channel])
        if not without:
            radius[at] = columns.plain(channels[channel]["radius"])
    told = columns.plain(shared) if shared else None if without else radius
    return {"given": given, "omega": omega, "radius": told, "inputs": inputs, "outputs": outputs}


def _channels(where: str, names: tuple[str, ...]) -> dict[str, dict[str, str]]:
    """Channel -> part -> column, of names such as ``"y from u real"`` and ``"real"``."""
    found: dict[str, dict[str, str]] = {}
    for name in names:
        channel, _, part = name.rpartition(" ")
        if part not in PARTS:
            expected = f"{CHANNEL}, then one of {', '.join(PARTS)}"
            raise InputError(where, f"column {name!r}", expected, did_you_mean(part, PARTS))
        found.setdefault(channel, {})[part] = name
    return found
