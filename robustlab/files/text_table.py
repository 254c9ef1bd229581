"""Read tables in text files: detect delimiter, header and units; report a bad cell with its line and column.

A table of measured frequency responses is read as arguments of `robustlab.frequency_data`.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from robustlab.arrays import Array, ComplexArray
from robustlab.errors import InputError, did_you_mean
from robustlab.files.file_types import Limits, require_file, size_text
from robustlab.files.tree import Tree, canonical
from robustlab.units import factor_between

COMMENTS = ("#", "%")
DECIMAL_COMMA = re.compile(r"^[+-]?\d+,\d+(?:[eE][+-]?\d+)?$")
# A line whose first cell is a number, for any delimiter and decimal sign.
NUMERIC = re.compile(r'"?\s*[+-]?(\d|[.,]\d|(nan|inf(inity)?)\b)', re.IGNORECASE)
WHITESPACE = " "


@dataclass(frozen=True)
class TextTable:
    """Columns of a text file."""

    names: tuple[str, ...]  # from the header; `c1, c2, ...` without one
    units: tuple[str, ...]  # empty where not stated
    values: Array  # shape (n, columns)
    has_header: bool  # True where the names come from the file


def read_table(
    path: str | Path,
    delimiter: str | None = None,
    decimal: str = ".",
    limits: Limits | None = None,
    isolate: bool = True,
) -> TextTable:
    """Read a table of numbers from a text file, in the reader process (see `robustlab.files.isolation`)."""
    limits = limits or Limits()
    require_file(path, limits)
    if isolate:
        from robustlab.files.isolation import read_isolated

        tree = read_isolated("table", path, limits, delimiter=delimiter, decimal=decimal)
    else:
        tree = table_tree(path, limits, delimiter, decimal)
    names, units, values = (np.asarray(tree.datasets[name].values) for name in ("names", "units", "values"))
    return TextTable(tuple(names.tolist()), tuple(units.tolist()), values, bool(tree.attrs["has_header"]))


def table_tree(path: str | Path, limits: Limits, delimiter: str | None, decimal: str, shown: str | None = None) -> Tree:
    """Read a table as datasets ``names``, ``units``, ``values`` (runs in the reader process)."""
    where, size = shown or str(path), Path(path).stat().st_size
    if decimal not in (".", ","):
        raise InputError(where, f"decimal sign {decimal!r}", "'.' or ','")
    if size > limits.dataset:
        expected = f"at most {size_text(limits.dataset)}"
        raise InputError(where, f"text file of {size_text(size)}", expected, "convert it to HDF5 in parts")
    raw = Path(path).read_bytes()
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = raw.decode("latin-1")  # degree signs of old loggers
    numbered = [(number, line.strip()) for number, line in enumerate(text.splitlines(), start=1) if line.strip()]
    rows = [row for row in numbered if not row[1].startswith(COMMENTS)]
    if not rows:
        raise InputError(where, "no numbers", "lines of numbers, one column per signal")
    first = next((i for i, (_, line) in enumerate(rows[:50]) if NUMERIC.match(line)), None)
    if first is None:
        raise InputError(where, f"line {rows[0][0]}: {rows[0][1][:40]!r}", "numbers: is this a table?")
    if first > 1:
        found = f"line {rows[0][0]}: {first} lines of text before the numbers"
        raise InputError(where, found, "one header line", "begin other lines with #")
    data = rows[first:]
    sign = _delimiter(where, data, rows[0][1] if first else None, given=delimiter, decimal=decimal)
    width = len(_cells(data[0][1], sign))
    if width > limits.objects:
        raise InputError(where, f"line {data[0][0]} has {width} cells", f"at most {limits.objects} columns")
    names = _cells(rows[0][1], sign) if first else None  # else a comment above with a name for each column
    if names is not None and len(names) != width:
        found = f"line {data[0][0]} has {width} cells, the header in line {rows[0][0]} has {len(names)}"
        hint = "if the numbers have decimal commas: decimal=',' and delimiter=';'" if sign == "," else None
        raise InputError(where, found, "equal numbers", hint)
    above = next((line for number, line in numbered if number == data[0][0] - 1), "")
    if names is None and above.startswith(COMMENTS):
        above = above.lstrip("#% \t")
        given = _cells(above, sign) if sign != WHITESPACE or not name_and_unit(above)[1] else []
        names = given if len(given) == width else None
    labels = [name_and_unit(name) for name in names] if names else [(f"c{i + 1}", "") for i in range(width)]
    seen = set[str]()
    for i, (name, unit) in enumerate(labels):
        if not name:
            raise InputError(where, f"column {i + 1} has no name in the header", "a name for every column")
        if len(name) > limits.name or len(unit) > limits.name:
            found = f"column {i + 1} has a name of {len(name)} and a unit of {len(unit)} characters"
            raise InputError(where, found, f"at most {limits.name} of each")
        if name in seen:
            raise InputError(where, f"column name {name!r} is used twice", "unique names")
        seen.add(name)
    tree = Tree({"has_header": canonical(names is not None, where)}, file=where)
    tree.put("names", np.array([name for name, _ in labels], np.str_))
    tree.put("units", np.array([unit for _, unit in labels], np.str_))
    tree.put("values", _numbers(where, data, sign, decimal, width, names))
    return tree


def _delimiter(where: str, data: list[tuple[int, str]], header: str | None, *, given: str | None, decimal: str) -> str:
    if given is not None:
        if given not in (",", ";", "\t", "\\t", WHITESPACE):
            raise InputError(where, f"delimiter {given!r}", "one of ',' ';' tab or ' '")
        if given == decimal:
            raise InputError(where, f"delimiter and decimal sign are both {given!r}", "different ones")
        return "\t" if given == "\\t" else given
    sample = [text for _, text in data[:20]]
    # The header defines the number of cells; if no delimiter fits it, the first line of numbers does.
    for pattern in ([header] if header else []) + sample[:1]:
        fits: dict[str, int] = {}
        for sign in (";", "\t", ",", WHITESPACE):
            count, cells = len(_cells(pattern, sign)), [_cells(text, sign) for text in sample]
            whole = not any(len(cell.split()) > 1 for row in cells for cell in row)
            fits[sign] = sum(len(row) == count for row in cells) if sign != decimal and count > 1 and whole else 0
        best = max(fits, key=lambda sign: fits[sign])
        if fits[best]:
            return best
    return WHITESPACE


def _cells(text: str, delimiter: str) -> list[str]:
    parts = text.split() if delimiter == WHITESPACE else text.split(delimiter)
    cells = [part.strip().strip('"').strip() for part in parts]
    # a delimiter at the end of every line is common
    return cells[:-1] if len(cells) > 1 and not cells[-1] else cells


def _numbers(
    where: str, data: list[tuple[int, str]], delimiter: str, decimal: str, width: int, names: list[str] | None
) -> Array:
    texts = [text for _, text in data]
    try:
        if decimal == "." and not any('"' in text or text.endswith(delimiter) for text in texts):
            split: dict[str, Any] = {} if delimiter == WHITESPACE else {"delimiter": delimiter}
            return np.loadtxt(texts, dtype=np.float64, comments=None, ndmin=2, **split)
    except ValueError:
        pass  # the loop below finds the line and the column
    result = np.empty((len(data), width))
    for i, (number, text) in enumerate(data):
        cells = _cells(text, delimiter)
        if len(cells) != width:
            raise InputError(where, f"line {number} has {len(cells)} cells", f"{width} as in line {data[0][0]}")
        for j, cell in enumerate(cells):
            plain = cell.replace(",", ".") if decimal == "," and "." not in cell else cell
            try:
                # Python would read 1_000 as a thousand
                result[i, j] = float(plain.replace("_", "?"))
            except ValueError:
                place = f"{where}: line {number}, column {j + 1}" + (f" ({names[j]})" if names else "")
                if decimal == "." and DECIMAL_COMMA.match(cell):
                    raise InputError(place, f"decimal comma in {cell!r}", "a decimal point", "decimal=','") from None
                raise InputError(place, repr(cell[:40]) if cell else "empty cell", "a number") from None
    return result


def name_and_unit(text: str) -> tuple[str, str]:
    """Return ``q [m]`` or ``q (m)`` as name and unit; a regular expression would be slow on many blanks."""
    text = text.strip()
    for opening, closing in ("[]", "()"):
        if text.endswith(closing):
            name, found, unit = text[:-1].rpartition(opening)
            if found and name.strip() and closing not in unit:
                return name.strip(), unit.strip()
    return text, ""


PARTS = ("real", "imag", "magnitude", "phase", "radius")
# The names of a channel's columns, and the default channel.
CHANNEL, ONLY = "OUTPUT from INPUT", "y1 from u1"


def read_response(
    path: str | Path, units: Mapping[str, str] | None = None, delimiter: str | None = None, decimal: str = "."
) -> dict[str, Any]:
    """Read a table of a response, in the form that ``docs/analysis.md`` describes."""
    where, table = str(path), read_table(path, delimiter, decimal)
    if not table.has_header:
        raise InputError(where, "no header", f"names: frequency [Hz], {CHANNEL} real, {CHANNEL} imag")
    for name in set(units or {}) - set(table.names):
        expected = f"one of {', '.join(table.names)}"
        raise InputError(f"{where}: unit of {name!r}", "no such column", expected, did_you_mean(name, table.names))
    unit_of = {**dict(zip(table.names, table.units, strict=True)), **(units or {})}
    values = dict(zip(table.names, table.values.T, strict=True))

    def column(name: str, wanted: str = "", expected: str = "") -> Array:
        """Return a column in a required unit, or in the units of the signals."""
        unit = unit_of[name]
        found = f"column {name!r} " + (f"in {unit!r}" if unit else "without a unit")
        if not wanted and unit not in ("", "1"):
            words = ", or dB" if name.endswith("magnitude") else ""
            raise InputError(where, found, f"numbers in the units of the signals, so none{words}")
        factor = 1.0 if not wanted else factor_between(unit, wanted) if unit else None
        if factor is None:
            raise InputError(where, found, expected, f"write {name} [{wanted}] into the header, or give its unit")
        return factor * values[name]

    def response(channel: str, parts: Mapping[str, str]) -> ComplexArray:
        """Return the response from real and imaginary part, or from magnitude and phase."""
        kinds = set(parts) - {"radius"}
        if kinds == {"real", "imag"}:
            return np.asarray(column(parts["real"]) + 1j * column(parts["imag"]), dtype=np.complex128)
        if kinds != {"magnitude", "phase"}:
            found = f"{channel} with {', '.join(sorted(kinds)) or 'a radius alone'}"
            raise InputError(where, found, "real and imag, or magnitude and phase")
        size, phase = parts["magnitude"], column(parts["phase"], "rad", "rad or deg")
        with np.errstate(all="ignore"):  # `frequency_data` rejects values that are not finite
            gain = 10.0 ** (values[size] / 20.0) if unit_of[size] == "dB" else column(size)
            return np.asarray(gain * np.exp(1j * phase), dtype=np.complex128)

    omega = column(table.names[0], "rad/s", "the frequency, in rad/s or Hz")
    channels: dict[str, dict[str, str]] = {}  # channel -> part -> column
    for name in table.names[1:]:
        channel, _, part = name.rpartition(" ")
        if part not in PARTS:
            expected = f"{CHANNEL}, then one of {', '.join(PARTS)}"
            raise InputError(where, f"column {name!r}", expected, did_you_mean(part, PARTS))
        channels.setdefault(channel, {})[part] = name
    shared = channels.pop("")["radius"] if list(channels.get("", ())) == ["radius"] else None
    if list(channels) == [""]:
        channels = {ONLY: channels[""]}
    pairs = {channel: channel.partition(" from ")[::2] for channel in channels}
    for channel, pair in pairs.items():
        if not all(pair):
            first = next(iter(channels[channel].values()))
            raise InputError(where, f"column {first!r} of no channel", f"a name that begins with {CHANNEL}")
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
        given[at] = response(channel, channels[channel])
        if not without:
            radius[at] = column(channels[channel]["radius"])
    bound = column(shared) if shared else None if without else radius
    return {"given": given, "omega": omega, "radius": bound, "inputs": inputs, "outputs": outputs}
