"""Tables in text files: delimiter, header and units are found; every bad cell is named with its line and column.

A table of measured frequency responses comes back as the arguments of `robustlab.frequency_data`.
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
from robustlab.files.signature import Limits, require_file, size_text
from robustlab.files.tree import Tree, canonical
from robustlab.units import factor_between

COMMENTS = ("#", "%")
BRACKETS = ("[]", "()")  # of a unit behind a name
DECIMAL_COMMA = re.compile(r"^[+-]?\d+,\d+(?:[eE][+-]?\d+)?$")
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
    """Read a table of numbers from a text file, in the reader process (see `robustlab.files.isolation`).

    Lines that begin with ``#`` or ``%`` are comments; the first line that is not made of numbers is the header. Without
    one, a comment directly above the numbers with as many names as there are columns is taken. Names may carry units:
    ``q [m]``, ``q (m)``.
    """
    limits = limits or Limits()
    require_file(path, limits)
    if isolate:
        from robustlab.files.isolation import read_isolated

        tree = read_isolated("table", path, limits, delimiter=delimiter, decimal=decimal)
    else:
        tree = table_tree(path, limits, delimiter, decimal)
    names, units, values = (tree.datasets[name].values for name in ("names", "units", "values"))
    assert isinstance(names, np.ndarray)
    assert isinstance(units, np.ndarray)
    assert isinstance(values, np.ndarray)
    return TextTable(tuple(names.tolist()), tuple(units.tolist()), values, bool(tree.attrs["has_header"]))


def table_tree(path: str | Path, limits: Limits, delimiter: str | None, decimal: str, shown: str | None = None) -> Tree:
    """What `read_table` reads, as datasets ``names``, ``units``, ``values``; runs in the reader process."""
    where = shown or str(path)
    if decimal not in (".", ","):
        raise InputError(where, f"decimal sign {decimal!r}", "'.' or ','")
    lines = _content_lines(path, where, limits)
    comment, rows = _split_comments(lines)
    if not rows:
        raise InputError(where, "no numbers", "lines of numbers, one column per signal")
    first_data = next((i for i, (_, text) in enumerate(rows[:50]) if _looks_numeric(text)), None)
    if first_data is None:
        raise InputError(where, f"line {rows[0][0]}: {rows[0][1][:40]!r}", "numbers: is this a table?")
    if first_data > 1:
        raise InputError(
            where,
            f"line {rows[0][0]}: {first_data} lines of text before the numbers",
            "one header line",
            "begin other lines with #",
        )
    data = rows[first_data:]
    header = rows[0] if first_data else None
    sign = _delimiter(where, data, header[1] if header else None, given=delimiter, decimal=decimal)
    width = len(_cells(data[0][1], sign))
    if width > limits.objects:
        raise InputError(where, f"line {data[0][0]} has {width} cells", f"at most {limits.objects} columns")
    names = _cells(header[1], sign) if header else None
    if header and names is not None and len(names) != width:
        raise InputError(
            where,
            f"line {data[0][0]} has {width} cells, the header in line {header[0]} has {len(names)}",
            "equal numbers",
            "if the numbers have decimal commas: decimal=',' and delimiter=';'" if sign == "," else None,
        )
    if names is None and comment is not None and comment[0] == data[0][0] - 1:
        given = _cells(comment[1], sign) if sign != WHITESPACE or not name_and_unit(comment[1])[1] else None
        names = given if given and len(given) == width else None
    values = _numbers(where, data, sign, decimal=decimal, width=width, names=names)
    labels = [name_and_unit(name) for name in names] if names else [(f"c{i + 1}", "") for i in range(width)]
    _check_names(where, labels, limits)
    tree = Tree({"has_header": canonical(names is not None, where)}, file=where)
    tree.put("names", np.array([name for name, _ in labels], np.str_))
    tree.put("units", np.array([unit for _, unit in labels], np.str_))
    tree.put("values", values)
    return tree


def _content_lines(path: str | Path, where: str, limits: Limits) -> list[str]:
    size = Path(path).stat().st_size
    if size > limits.dataset:
        raise InputError(
            where,
            f"text file of {size_text(size)}",
            f"at most {size_text(limits.dataset)}",
            "convert it to HDF5 in parts",
        )
    raw = Path(path).read_bytes()
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = raw.decode("latin-1")  # degree signs of old loggers; a wrong letter in a name does no harm
    return text.splitlines()


def _split_comments(lines: list[str]) -> tuple[tuple[int, str] | None, list[tuple[int, str]]]:
    """The last comment before the first row, and the rows; both with line numbers from 1."""
    comment, rows = None, []
    for number, line in enumerate(lines, start=1):
        stripped = line.strip()
        if not stripped:
            continue
        if stripped.startswith(COMMENTS):
            if not rows:
                comment = (number, stripped.lstrip("#% \t"))
        else:
            rows.append((number, stripped))
    return comment, rows


def _looks_numeric(text: str) -> bool:
    """True where the first cell of the line is a number (with any delimiter and any decimal sign)."""
    first = re.split(r"[;\t ]|,(?!\d)", text.lstrip(), maxsplit=1)[0].strip().strip('"')
    return bool(re.match(r"^[+-]?(\d|[.,]\d|nan$|inf)", first, re.IGNORECASE))


def _delimiter(where: str, data: list[tuple[int, str]], header: str | None, *, given: str | None, decimal: str) -> str:
    if given is not None:
        if given not in (",", ";", "\t", "\\t", WHITESPACE):
            raise InputError(where, f"delimiter {given!r}", "one of ',' ';' tab or ' '")
        if given == decimal:
            raise InputError(where, f"delimiter and decimal sign are both {given!r}", "different ones")
        return "\t" if given == "\\t" else given
    sample = [text for _, text in data[:20]]
    # The header says how many cells a line has; where no delimiter fits it, the first line of numbers does.
    for pattern in ([header] if header else []) + sample[:1]:
        fits = {
            sign: _share_that_fits(pattern, sample, sign) for sign in (";", "\t", ",", WHITESPACE) if sign != decimal
        }
        best = max(fits, key=lambda sign: fits[sign])
        if fits[best] > 0:
            return best
    return WHITESPACE


def _share_that_fits(pattern: str, sample: list[str], sign: str) -> float:
    """Share of the lines with as many cells as ``pattern``; 0 where the delimiter does not even part the pattern."""
    count = len(_cells(pattern, sign))
    if count < 2 or any(len(cell.split()) > 1 for text in sample for cell in _cells(text, sign)):
        return 0.0
    return sum(len(_cells(text, sign)) == count for text in sample) / len(sample)


def _cells(text: str, delimiter: str) -> list[str]:
    parts = text.split() if delimiter == WHITESPACE else text.split(delimiter)
    cells = [part.strip().strip('"').strip() for part in parts]
    # a delimiter at the end of every line is common and means nothing
    return cells[:-1] if len(cells) > 1 and not cells[-1] else cells


def _numbers(
    where: str, data: list[tuple[int, str]], delimiter: str, *, decimal: str, width: int, names: list[str] | None
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
            place = f"{where}: line {number}, column {j + 1}" + (f" ({names[j]})" if names else "")
            result[i, j] = _number(place, cell, decimal)
    return result


def _number(where: str, cell: str, decimal: str) -> float:
    if decimal == "," and "." not in cell:
        cell = cell.replace(",", ".")
    elif decimal == "." and DECIMAL_COMMA.match(cell):
        raise InputError(where, f"decimal comma in {cell!r}", "a decimal point", "decimal=','")
    try:
        return float(cell.replace("_", "?"))  # Python reads 1_000 as a thousand; no logger writes that
    except ValueError:
        raise InputError(where, repr(cell[:40]) if cell else "empty cell", "a number") from None


def name_and_unit(text: str) -> tuple[str, str]:
    """``q [m]`` or ``q (m)`` as name and unit, without a regular expression: those take their time with blanks."""
    text = text.strip()
    for opening, closing in BRACKETS:
        if text.endswith(closing):
            name, found, unit = text[:-1].rpartition(opening)
            if found and name.strip() and closing not in unit:
                return name.strip(), unit.strip()
    return text, ""


def _check_names(where: str, labels: list[tuple[str, str]], limits: Limits) -> None:
    seen: set[str] = set()
    for i, (name, unit) in enumerate(labels):
        if not name:
            raise InputError(where, f"column {i + 1} has no name in the header", "a name for every column")
        if len(name) > limits.name or len(unit) > limits.name:
            found = f"column {i + 1} has a name of {len(name)} and a unit of {len(unit)} characters"
            raise InputError(where, found, f"at most {limits.name} of each")
        if name in seen:
            raise InputError(where, f"column name {name!r} is used twice", "unique names")
        seen.add(name)


# --- tables of responses ---------------------------------------------------------------------------------------------


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
