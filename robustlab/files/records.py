"""Measured records from HDF5, MATLAB and text files, as the arguments of `robustlab.record.Record`."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from robustlab.arrays import AnyArray, Array, not_finite
from robustlab.errors import InputError, UnitMismatch, did_you_mean
from robustlab.files.hdf5 import read_tree
from robustlab.files.record_layout import decode_record
from robustlab.files.signature import Limits, content_of
from robustlab.files.text_table import read_table
from robustlab.files.tree import Tree, Unread, check_header, is_stamped, text_attr, type_name
from robustlab.units import factor_to_si, same_unit

__all__ = ["CLOCK_NAMES", "RecordOptions", "read_record"]

CLOCK_NAMES = ("t", "time", "Time", "TIME", "T", "timestamp", "zeit", "Zeit")
SECONDS = {"": 1.0, "s": 1.0, "sec": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "μs": 1e-6, "min": 60.0}
# A step longer than this many median steps, in a clock that is otherwise regular, is a hole.
GAP = 1.5


@dataclass
class _Channel:
    values: AnyArray | Unread
    unit: str = ""
    meaning: str = ""
    dt: float = 0.0  # sample time stated at the channel itself; 0 = not stated


@dataclass
class _Source:
    """All channels of a file (or of one group of it) before anything is chosen."""

    where: str
    name: str
    prefix: str
    channels: dict[str, _Channel]
    dt: float = 0.0
    groups: list[str] = field(default_factory=list)

    def label(self, name: str) -> str:
        return f"{self.prefix}{name}"


@dataclass(frozen=True)
class RecordOptions:
    """What is taken of a file, and how it is understood.

    Attributes
    ----------
    group
        HDF5 group or MATLAB struct that holds the signals.
    inputs, outputs
        Names of the signals to take. With neither given, all signals are outputs, because only the user knows which are
        inputs (a format 1 record knows). With inputs only, all others are outputs.
    dt
        Sample time in s; wins over what the file says. Without it and without a clock, the attribute ``Ts`` (or ``dt``,
        in s, or ``fs`` in Hz) of the signals, else of their group, else of the file is used.
    clock
        Name of the signal with the times; ``t`` or ``time`` where left out. A unit of ms, us or min is converted to s.
    units
        Name -> unit that the numbers in the file are in. They are converted to the SI unit of the same kind (deg to
        rad, rpm to rad/s, mm to m), a unit that is in no table of `robustlab.units` is kept as it is. Signals that are
        not named keep the numbers and the unit of the file.
    delimiter, decimal
        For text files; see `robustlab.files.text_table.read_table`.
    allow_gaps
        Accept a clock with missing samples.
    no_verify
        Accept a format 1 record whose content hash does not match.
    """

    group: str | None = None
    inputs: Sequence[str] | None = None
    outputs: Sequence[str] | None = None
    dt: float | None = None
    clock: str | None = None
    units: Mapping[str, str] | None = None
    delimiter: str | None = None
    decimal: str = "."
    allow_gaps: bool = False
    no_verify: bool = False


def read_record(
    path: str | Path, options: RecordOptions, limits: Limits | None = None, isolate: bool = True
) -> dict[str, Any]:
    """Read one record; the result holds the keyword arguments of `robustlab.record.Record`.

    Parameters
    ----------
    path
        HDF5 (format 1 or plain), MATLAB 5 or 7.3, or a text file; told by content.
    options
        What to take of it.
    limits, isolate
        See `robustlab.files.hdf5.read_tree`.

    Raises
    ------
    InputError
        Signals that are missing (all of them, with the nearest names), are not columns of numbers, differ in length; no
        clock; missing samples; a unit for no signal, or another one than the file states.
    """
    group = options.group
    if content_of(path, limits) == "text":
        return _choose(_from_text(path, options, limits, isolate), options)
    tree = read_tree(path, group, limits, isolate)
    if is_stamped(tree):
        return _stored(_record_of_format_1(str(path), tree, options), str(path), options)
    node = tree.find(group) if group else tree
    if node is None:
        known = tree.group_names()
        raise InputError(str(path), f"missing group /{group}", _list("one of", known), did_you_mean(group or "", known))
    if {"inputs", "outputs"} & set(node.groups):
        return _stored(node, str(path), options)
    return _choose(_from_tree(path, tree, node, group), options)


# --- what the file holds ---------------------------------------------------------------------------------------------


def _from_text(path: str | Path, options: RecordOptions, limits: Limits | None, isolate: bool) -> _Source:
    where = str(path)
    if options.group:
        raise InputError(where, f"group {options.group!r} of a text file", "no group: text files have none")
    table = read_table(path, options.delimiter, options.decimal, limits, isolate)
    columns = zip(table.names, table.units, table.values.T, strict=True)
    return _Source(
        where, Path(path).stem, "", {name: _Channel(np.array(values), unit) for name, unit, values in columns}
    )


def _from_tree(path: str | Path, tree: Tree, node: Tree, group: str | None) -> _Source:
    channels = {}
    for name, dataset in node.datasets.items():
        attrs = dataset.attrs
        channels[name] = _Channel(
            _column(dataset.values),
            text_attr(attrs, "unit") or "",
            text_attr(attrs, "meaning") or "",
            _sample_time(attrs),
        )
    own = _sample_time(node.attrs) or _sample_time(tree.attrs)
    for name in ("Ts", "dt"):  # MATLAB has no attributes: there the sample time is a variable
        if (
            not own
            and name in channels
            and isinstance(values := channels[name].values, np.ndarray)
            and values.size == 1
        ):
            own = float(channels.pop(name).values.flat[0])
    stem = Path(path).stem
    prefix = f"{node.path.rstrip('/')}/"
    return _Source(
        str(path), f"{stem}/{group.strip('/')}" if group else stem, prefix, channels, own, tree.group_names()
    )


def _column(values: AnyArray | Unread) -> AnyArray | Unread:
    """MATLAB's columns and rows are two-dimensional; a record's channels are not."""
    if isinstance(values, np.ndarray) and values.ndim == 2 and 1 in values.shape:
        return values.reshape(-1)
    return values


def _sample_time(attrs: Mapping[str, Any]) -> float:
    for name in ("Ts", "dt", "fs"):
        value = np.asarray(attrs.get(name, 0.0))
        if value.dtype.kind in "fi" and value.size == 1 and float(value.flat[0]) > 0:
            number = float(value.flat[0])
            return 1.0 / number if name == "fs" else number
    return 0.0


# --- a record of format 1 --------------------------------------------------------------------------------------------


def _record_of_format_1(where: str, tree: Tree, options: RecordOptions) -> Tree:
    if options.group:
        raise InputError(where, f"group {options.group!r} of a format 1 file", "no group: such a file holds one object")
    kind, remarks = check_header(tree, options.no_verify)
    if kind != "record":
        raise InputError(where, f"holds an object of kind {kind}", "a record", "robustlab model show FILE")
    for text in remarks:
        warnings.warn(f"{where}: {text}", stacklevel=4)  # the caller of Record.read
    return tree


def _stored(node: Tree, where: str, options: RecordOptions) -> dict[str, Any]:
    """Groups ``inputs`` and ``outputs``: the layout of format 1, which `robustlab.storage` reads too."""
    keywords, inputs, outputs = decode_record(node, where), options.inputs, options.outputs
    known = {**keywords["inputs"], **keywords["outputs"]}
    if inputs is not None or outputs is not None:
        wanted = [*(inputs or []), *(outputs or [])]
        missing = [name for name in wanted if name not in known]
        if missing:
            raise _missing(where, missing, list(known), node.path.rstrip("/") + "/")
        keywords["inputs"] = {name: known[name] for name in (inputs if inputs is not None else keywords["inputs"])}
        rest = [name for name in known if name not in keywords["inputs"]] if outputs is None else outputs
        keywords["outputs"] = {name: known[name] for name in rest}
    taken = {*keywords["inputs"], *keywords["outputs"]}
    for key in ("units", "meaning"):
        keywords[key] = {name: text for name, text in keywords[key].items() if name in taken}
    _convert(where, keywords["inputs"], keywords["outputs"], keywords["units"], options.units or {})
    return keywords


# --- choosing --------------------------------------------------------------------------------------------------------


def _choose(source: _Source, options: RecordOptions) -> dict[str, Any]:
    inputs, outputs, dt, units = options.inputs, options.outputs, options.dt, options.units or {}
    known = list(source.channels)
    # With dt given the file's clock is not used, and a column of that name is no signal either.
    clock = options.clock or next((name for name in CLOCK_NAMES if name in known), None)
    ins = [inputs] if isinstance(inputs, str) else list(inputs or [])
    outs = [outputs] if isinstance(outputs, str) else list(outputs or [])
    if outputs is None:
        outs = [name for name in known if name not in (*ins, clock)]
    asked = [*ins, *outs, *([clock] if clock and dt is None else [])]
    missing = [name for name in asked if name not in known]
    if missing and not known:
        raise _no_signals(source, f"missing {', '.join(source.label(name) for name in missing)}")
    if missing:
        raise _missing(source.where, missing, known, source.prefix)
    if not outs and not ins:
        raise _no_signals(source, "no signals here")
    arrays = {name: _numbers(source, name) for name in dict.fromkeys([*ins, *outs])}
    n = _common_length(source, arrays)
    if clock is not None and clock in units and clock not in arrays:
        _agree(source.where, clock, source.channels[clock].unit, units[clock])
        source.channels[clock].unit = units[clock]
        units = {name: unit for name, unit in units.items() if name != clock}
    t = _times(source, list(arrays), n, dt, clock)
    if not options.allow_gaps:
        _refuse_gaps(source.where, t)
    meanings = {name: source.channels[name].meaning for name in arrays if source.channels[name].meaning}
    stated = {name: source.channels[name].unit for name in arrays}
    taken = {name: arrays[name] for name in ins}, {name: arrays[name] for name in outs}
    _convert(source.where, *taken, stated, units)
    return {"t": t, "inputs": taken[0], "outputs": taken[1], "units": stated, "name": source.name, "meaning": meanings}


def _convert(
    where: str,
    inputs: dict[str, Array],
    outputs: dict[str, Array],
    stated: dict[str, str],
    given: Mapping[str, str],
) -> None:
    """Bring the named signals from the unit given for their numbers to SI; changes the first three tables."""
    for name, unit in given.items():
        side = inputs if name in inputs else outputs
        if name not in side:
            known = [*inputs, *outputs]
            raise InputError(where, f"a unit for {name!r}", _list("one of", known), did_you_mean(name, known))
        _agree(where, name, stated.get(name, ""), unit)
        factor, stated[name] = factor_to_si(unit)
        if factor != 1.0:
            side[name] = side[name] * factor


def _agree(where: str, name: str, stated: str, given: str) -> None:
    if stated and not same_unit(stated, given):
        raise UnitMismatch(
            f"{where}: {name}",
            f"the file states {stated}, the unit given is {given}",
            "the unit that the numbers in the file are in",
            f"--unit {name}={stated} converts from it; where the file is wrong, correct it there",
        )


def _no_signals(source: _Source, found: str) -> InputError:
    if not source.groups:
        return InputError(source.where, found, "a file with signals")
    return InputError(
        source.where,
        found,
        _list("signals in the group given; groups are", source.groups),
        f"--group {source.groups[0] if len(source.groups) == 1 else 'NAME'}",
    )


def _numbers(source: _Source, name: str) -> Array:
    values = source.channels[name].values
    where = f"{source.where}: {source.label(name)}"
    if isinstance(values, Unread) or values.dtype.kind not in "fib":
        raise InputError(where, f"dtype {type_name(values)}", "a column of real numbers")
    if values.ndim != 1:
        raise InputError(where, f"shape {values.shape}", "one column")
    array = values.astype(np.float64)
    bad = not_finite(array, "samples")
    if bad is not None:
        raise InputError(f"{where}[{bad[0]}]", bad[1], "finite numbers")
    return array


def _common_length(source: _Source, arrays: Mapping[str, Array]) -> int:
    lengths = {name: len(values) for name, values in arrays.items()}
    if len(set(lengths.values())) > 1:
        first = next(iter(lengths))
        others = [name for name, n in lengths.items() if n != lengths[first]]
        text = "; ".join(
            f"{source.label(name)} has {lengths[name]} samples"
            + (f" (its own sample time is {source.channels[name].dt:g} s)" if source.channels[name].dt else "")
            for name in others
        )
        raise InputError(
            source.where,
            text,
            f"{lengths[first]} as {source.label(first)}",
            "choose signals of one clock with inputs= and outputs=",
        )
    return next(iter(lengths.values()))


def _times(source: _Source, names: list[str], n: int, dt: float | None, clock: str | None) -> Array:
    if dt is None and clock is not None:
        t = _numbers(source, clock)
        unit = source.channels[clock].unit
        if unit not in SECONDS:
            raise InputError(
                f"{source.where}: {source.label(clock)}",
                f"unit {unit!r}",
                f"one of {', '.join(u for u in SECONDS if u)}",
            )
        if len(t) != n:
            raise InputError(
                source.where,
                f"{source.label(names[0])} has {n} samples",
                f"{len(t)} as the clock {source.label(clock)}",
            )
        return np.multiply(t, SECONDS[unit], dtype=np.float64)
    if dt is None:
        own = {name: source.channels[name].dt for name in names}
        if len(set(own.values())) > 1:
            text = ", ".join(f"{source.label(name)} {value or source.dt:g} s" for name, value in own.items())
            raise InputError(source.where, f"sample times differ: {text}", "signals of one clock")
        dt = next(iter(own.values())) or source.dt
    if not dt:
        columns = _list("a column t, or one of", names)
        raise InputError(
            source.where, "no clock and no sample time", columns + " as clock=", "--dt SECONDS, or --clock NAME"
        )
    if not np.isfinite(dt) or dt < 0:
        raise InputError(source.where, f"dt is {dt}", "a positive sample time in s")
    return np.arange(n, dtype=np.float64) * np.float64(dt)


def _refuse_gaps(where: str, t: Array) -> None:
    """Missing samples: steps far longer than the others of a clock that is otherwise regular."""
    steps = np.diff(t)
    if len(steps) < 2 or (steps <= 0).any():
        return  # Record names a clock that stands still or runs backwards
    median = float(np.median(steps))
    regular = np.abs(steps - median) <= 0.05 * median
    holes = np.flatnonzero(steps > GAP * median)
    if len(holes) and regular.mean() >= 0.9:
        k = int(holes[0])
        lost = round(float(steps[k]) / median) - 1
        raise InputError(
            where,
            f"t: {lost} samples missing between t[{k}] = {t[k]:.9g} s and t[{k + 1}] = {t[k + 1]:.9g} s "
            f"({len(holes)} gaps in all)",
            f"a sample every {median:.6g} s",
            "cut the record there, or allow_gaps=True (--allow-gaps)",
        )


def _missing(where: str, missing: list[str], known: list[str], prefix: str) -> InputError:
    lines = []
    for name in missing:
        near = did_you_mean(name, known)
        lines.append(f"missing {prefix}{name}" + (f" ({near})" if near else ""))
    return InputError(where, lines[0], _list("one of", known), None, tuple(f"{where}: {line}" for line in lines[1:]))


def _list(word: str, names: Sequence[str]) -> str:
    shown = ", ".join(names[:12]) + (", ..." if len(names) > 12 else "")
    return f"{word} {shown}" if names else "a file with signals"
