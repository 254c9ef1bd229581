"""Read measured records from HDF5, MATLAB and text files, as arguments of `robustlab.record.Record`.

A `Source` has all channels of a file, each with a time base. Changes to the time base are noted in the meaning of
``t``, a line each.

Logs are structs with times and values, as of Simulink and MATLAB's timeseries, at any depth below the group read::

    log.time, log.signals(k).values, .label      Simulink's "Structure with time"
    log.Time, log.Data, .Name, .Units            a timeseries as a plain struct
    log.time, log.values                         the same with other names (time or t; data or values)

Values of several columns become channels numbered as in MATLAB: ``q(1)``, ``q(2)``.
"""

from __future__ import annotations

import warnings
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from robustlab.arrays import AnyArray, Array, not_finite
from robustlab.errors import InputError, UnitMismatch, did_you_mean, require_package
from robustlab.files.file_types import Limits, content_of
from robustlab.files.hdf5 import read_tree
from robustlab.files.text_table import read_table
from robustlab.files.tree import (
    Tree,
    Unread,
    canonical,
    check_header,
    is_stamped,
    one_number,
    signal_name,
    text_attr,
    type_name,
)
from robustlab.time_base import clock_step, common_clock, held, interpolated, summarise_clock
from robustlab.units import factor_to_si, same_unit

if TYPE_CHECKING:
    import pandas

CLOCK_NAMES = ("t", "time", "Time", "TIME", "T", "timestamp", "tout", "zeit", "Zeit")
SIDES = ("inputs", "outputs")
TIMES, VALUES = ("time", "t"), ("data", "values")
MOST_COLUMNS = 1000
# MATLAB code that converts an object of each class to a plain struct.
MATLAB_RECIPES = {
    "timetable": "T = timetable2table({0}); T.(1) = seconds(T.(1) - T.(1)(1)); S = table2struct(T, 'ToScalar', true); "
    "save('run.mat', '-struct', 'S', '-v7')",
    "table": "S = table2struct({0}, 'ToScalar', true); save('run.mat', '-struct', 'S', '-v7')",
    "timeseries": "{0} = struct('Time', {0}.Time, 'Data', {0}.Data, 'Name', {0}.Name); save('run.mat', '{0}', '-v7')",
    "Dataset": "for k = 1:{0}.numElements, e = {0}{{k}}; S.(matlab.lang.makeValidName(e.Name)) = "
    "struct('Time', e.Values.Time, 'Data', e.Values.Data); end; save('run.mat', '-struct', 'S', '-v7')",
}
SECONDS = {"": 1.0, "s": 1.0, "sec": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "μs": 1e-6, "ns": 1e-9, "min": 60.0}
GAP = 1.5  # median steps; a longer step of an otherwise regular time base is a gap
# s; three years. Times in whole numbers that start later are counted from the first sample, which keeps all digits.
LONG = 1e8
TOO_LATE = 1e11  # s; some 3000 years. Larger times are in smaller units since 1970.
SAME_RATE = 1e-6  # relative difference of a given sample time from the time base; a larger one is reported


@dataclass
class Channel:
    """Samples of the file; ``clock`` is a key of `Source.clocks`, or empty for the source's own."""

    values: AnyArray | Unread
    unit: str = ""
    meaning: str = ""
    dt: float = 0.0  # sample time of the channel's attributes; 0: not stated
    clock: str = ""


@dataclass
class Source:
    """All channels of a file, or of one of its groups."""

    where: str  # the file
    name: str  # the record's name
    prefix: str  # of a channel's name in messages
    channels: dict[str, Channel]
    dt: float = 0.0  # sample time in s that the file states; 0: none
    clock: str = ""  # channel with the times that the file states
    groups: list[str] = field(default_factory=list)  # groups that could be read instead
    # Name -> times in s, of channels with their own time base; None where they have none.
    clocks: dict[str, Array | None] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)  # changes to the time bases, a line each
    # inputs, outputs: where the file states them; empty otherwise
    inputs: list[str] = field(default_factory=list)
    outputs: list[str] = field(default_factory=list)

    def add_clock(self, name: str, channel: Channel) -> None:
        """Add the channel with the times, with a unique name."""
        while name in self.channels:
            name += "'"
        self.channels[name], self.clock = channel, name


def one_of(word: str, names: Sequence[str]) -> str:
    shown = ", ".join(names[:12]) + (", ..." if len(names) > 12 else "")
    return f"{word} {shown}" if names else "a file with signals"


def read_record(
    path: str | Path,
    group: str | None = None,
    *,
    delimiter: str | None = None,
    decimal: str = ".",
    no_verify: bool = False,
    limits: Limits | None = None,
    isolate: bool = True,
    **choice: Any,
) -> dict[str, Any]:
    """Read one record as keyword arguments of `robustlab.record.Record`.

    ``group``: HDF5 group or MATLAB struct with the signals; ``delimiter``, ``decimal``: of text files; ``no_verify``:
    accept a format 1 record whose content hash does not match; ``choice``: of `choose`.
    """
    where = str(path)
    if content_of(path, limits) == "text":
        if group:
            raise InputError(where, f"group {group!r} of a text file", "no group: text files have none")
        table = read_table(path, delimiter, decimal, limits, isolate)
        columns = zip(table.names, table.units, table.values.T, strict=True)
        channels = {name: Channel(np.array(values), unit) for name, unit, values in columns}
        return choose(Source(where, Path(path).stem, "", channels), **choice)
    tree = read_tree(path, group, limits, isolate)
    if is_stamped(tree):
        kind, remarks = check_header(tree, no_verify)
        if kind != "record":
            raise InputError(where, f"holds an object of kind {kind}", "a record", "robustlab model show FILE")
        for text in remarks:
            warnings.warn(f"{where}: {text}", stacklevel=3)  # the caller of Record.read
    node = tree.find(group) if group else tree
    if node is None:
        known = tree.group_names()
        hint = did_you_mean(group or "", known)
        raise InputError(where, f"missing group /{group}", one_of("one of", known), hint)
    return record_of_group(path, tree, node, group, **choice)


def record_of_group(path: str | Path, tree: Tree, node: Tree, group: str | None, **choice: Any) -> dict[str, Any]:
    """Return the arguments of the record in a group of a file, in the layout of format 1 or any other."""
    if group and is_stamped(tree):
        raise InputError(str(path), f"group {group!r} of a format 1 file", "no group: such a file holds one object")
    if set(SIDES) & set(node.groups):
        return stored_record(node, str(path), **choice)
    return choose(_of_tree(path, tree, node, group), **choice)


def stored_record(node: Tree, where: str, **choice: Any) -> dict[str, Any]:
    """Return the arguments of a record in the layout of format 1."""
    if "t" not in node.datasets:
        raise InputError(where, f"missing {node.child_path('t')}", "the times of a record")
    source = Source(where, text_attr(node.attrs, "name") or "record", node.child_path(""), {})
    for side in SIDES:
        group = node.groups.get(side, Tree())
        found, order = _datasets(group), list[tuple[float, str]]()
        for link, item in group.datasets.items():
            position = one_number(item.attrs.get("position"))
            order.append((np.inf if position is None else position, link))
        for _, link in sorted(order):
            name = signal_name(link)
            if name in source.channels:
                raise InputError(where, f"signal {name!r} is there twice", "unique names")
            source.channels[name] = found[link]
            getattr(source, side).append(name)
    clock = _datasets(node)["t"]
    source.notes, clock.meaning = clock.meaning.splitlines(), ""
    source.add_clock("t", clock)
    choice["allow_gaps"] = True
    return choose(source, **choice)


def _of_tree(path: str | Path, tree: Tree, node: Tree, group: str | None) -> Source:
    """Return the datasets of a group, and the logs in it and below it."""
    channels = {} if _log(node)[1] else _datasets(node)
    own = _sample_time(node.attrs) or _sample_time(tree.attrs)
    for name in ("Ts", "dt"):  # in MATLAB files the sample time is a variable
        values = channels[name].values if name in channels and not own else None
        if isinstance(values, np.ndarray) and values.size == 1:
            own = float(values.flat[0])
            del channels[name]
    clocks: dict[str, Array | None] = {}
    for name, channel, times in _logs(node, ""):
        channels[name], clocks[channel.clock] = channel, times.astype(np.float64) if len(times) else None
    name = Path(path).stem + (f"/{group.strip('/')}" if group else "")
    return Source(str(path), name, node.child_path(""), channels, own, groups=tree.group_names(), clocks=clocks)


def _datasets(node: Tree) -> dict[str, Channel]:
    channels = {}
    for name, dataset in node.datasets.items():
        attrs, values = dataset.attrs, dataset.values
        if isinstance(values, np.ndarray) and values.ndim == 2 and 1 in values.shape:
            values = values.reshape(-1)  # MATLAB's columns and rows are two-dimensional
        unit, meaning = text_attr(attrs, "unit") or "", text_attr(attrs, "meaning") or ""
        channels[name] = Channel(values, unit, meaning, _sample_time(attrs))
    return channels


def _sample_time(attrs: Mapping[str, Any]) -> float:
    for name in ("Ts", "dt", "fs"):
        number = one_number(attrs.get(name))
        if number is not None and number > 0:
            return 1.0 / number if name == "fs" else number
    return 0.0


# --- logs of Simulink and MATLAB --------------------------------------------------------------------------------------


def _logs(node: Tree, prefix: str) -> Iterator[tuple[str, Channel, AnyArray]]:
    """Yield name relative to the group read, channel and times of all logs in it and below it."""
    times, found = _log(node)
    if not found:
        for name, group in node.groups.items():
            if name not in SIDES:
                yield from _logs(group, f"{prefix}.{name}" if prefix else name)
        return
    key = f"{prefix or node.path.strip('/')}.{times}".lstrip(".")
    t = np.ravel(node.datasets[times].values)  # pyright: ignore[reportArgumentType, reportCallIssue]
    for label, unit, values in found:
        name = f"{prefix}.{label}" if prefix and "signals" in node.groups else prefix or label
        for column_name, column in _columns(f"{node.file}: {name}", name, values, len(t)):
            yield column_name, Channel(column, unit, clock=key), t


def _log(node: Tree) -> tuple[str, list[tuple[str, str, AnyArray | Unread]]]:
    """Return the name of a log's times, and label, unit and values of its signals; no signals if it is no log."""
    times = ""
    for name, item in node.datasets.items():  # MATLAB's logs are in s, without a unit
        numbers = isinstance(item.values, np.ndarray) and item.values.dtype.kind in "fi"
        if numbers and "unit" not in item.attrs and name.lower() in TIMES:
            times = times or name
    if not times:
        return "", []
    signals = node.groups.get("signals")
    if signals is not None:
        alone = "values" in signals.datasets
        parts = [signals] if alone else [part for part in signals.groups.values() if "values" in part.datasets]
        labels = [_text(part, "label") or f"signal{k + 1}" for k, part in enumerate(parts)]
        labels = [f"{text}_{k + 1}" if labels.count(text) > 1 else text for k, text in enumerate(labels)]
        units = [_text(part, "unit") for part in parts]
        return times, list(zip(labels, units, [part.datasets["values"].values for part in parts], strict=True))
    found = {name: item.values for name, item in node.datasets.items() if name != times}
    own = [n for n, x in found.items() if isinstance(x, Unread) or (x.dtype.kind in "fib" and x.size > 1)]
    if len(own) != 1 or own[0].lower() not in VALUES:
        return times, []
    name = _text(node, "Name") or _text(node, "name") or own[0]
    unit = _text(node, "Units") or _text(node, "unit") or _text(node.groups.get("DataInfo", Tree()), "Units")
    return times, [(name, unit, found[own[0]])]


def _columns(where: str, name: str, values: AnyArray | Unread, n: int) -> Iterator[tuple[str, AnyArray | Unread]]:
    if isinstance(values, Unread) or values.dtype.kind not in "fib":
        yield name, values if isinstance(values, Unread) else Unread(type_name(values), values.shape)
        return
    if values.ndim > 2 and n and values.shape[-1] == n:  # a matrix for each time: time runs last
        values = values.reshape(-1, n, order="F").T
    elif values.ndim == 2 and values.shape[0] != n and (values.shape[1] == n or values.shape[0] == 1):
        values = values.T
    table = values.reshape(len(values), -1, order="F") if values.ndim else values.reshape(1, 1)
    if table.shape[1] > MOST_COLUMNS:
        raise InputError(where, f"{table.shape[1]} columns", f"at most {MOST_COLUMNS}")
    for k, column in enumerate(table.T):
        yield name if table.shape[1] == 1 else f"{name}({k + 1})", np.ascontiguousarray(column)


def _text(node: Tree, name: str) -> str:
    return (text_attr({key: item.values for key, item in node.datasets.items()}, name) or "").strip()


def choose(
    source: Source,
    inputs: Sequence[str] | None = None,
    outputs: Sequence[str] | None = None,
    dt: float | None = None,
    clock: str | None = None,
    units: Mapping[str, str] | None = None,
    allow_gaps: bool = False,
) -> dict[str, Any]:
    """Return the keyword arguments of a record from a file's channels.

    ``"u=SIGNAL"`` renames SIGNAL to u. With neither inputs nor outputs, all are outputs (but of a format 1 record);
    with inputs only, all others are. ``dt`` overrides the file's times; without it and without a clock, ``Ts`` (or
    ``dt``, in s, or ``fs`` in Hz) of the signals, else of their group, else of the file is used. Signals of several
    time bases are resampled to it, or to the coarsest of theirs. Units known to `robustlab.units` are converted to SI.
    """
    units, known = dict(units or {}), list(source.channels)
    # With dt given the file's times are not used, and a column of that name is no signal.
    clock = clock or source.clock or next((name for name in CLOCK_NAMES if name in known), None)
    alone = inputs is None and outputs is None
    ins = _named(source.inputs if inputs is None else inputs, known)
    outs = _named(source.outputs if alone else outputs, known)
    if outputs is None and not (alone and (source.inputs or source.outputs)):
        # Those of the source's own time base, or without one all logs.
        own, logged = ([n for n, c in source.channels.items() if bool(c.clock) is log] for log in (False, True))
        usual = own if not logged or clock in own or (own and (dt or source.dt)) else logged
        outs = {name: name for name in usual if name not in (*ins.values(), clock)}
    signals = {**ins, **outs}
    wanted = [*signals.values(), *([clock] if clock and dt is None else [])]
    missing = [name for name in wanted if name not in known]
    if missing and known:
        hints = [did_you_mean(name, known) for name in missing]
        lines = [f"missing {source.prefix}{n}" + (f" ({h})" if h else "") for n, h in zip(missing, hints, strict=True)]
        more = tuple(f"{source.where}: {line}" for line in lines[1:])
        raise InputError(source.where, lines[0], one_of("one of", known), None, more)
    if missing or not signals:
        gone = f"missing {', '.join(f'{source.prefix}{name}' for name in missing)}"
        hint = f"group={source.groups[0]!r}" if len(source.groups) == 1 else "group=..." if source.groups else None
        expected = one_of("signals in the group given; groups are", source.groups)
        raise InputError(source.where, gone if missing else "no signals here", expected, hint)
    arrays = {signal: _numbers(source, signal) for signal in signals.values()}
    if clock is not None and clock in units and clock not in signals:
        _agree(source.where, clock, source.channels[clock].unit, units[clock])
        source.channels[clock].unit = units.pop(clock)
    order = dict.fromkeys(source.channels[signal].clock for signal in (*outs.values(), *ins.values()))
    first, *others = (source.clocks.get(key) for key in order)
    if not all(first is not None and t is not None and np.array_equal(t, first) for t in others):
        t, arrays = _on_one_clock(source, arrays, set(ins.values()), list(order), clock, dt, allow_gaps)
    else:
        t = _times(source, arrays, dt, clock)
        if not allow_gaps:
            _refuse_gaps(source.where, "t", t)
    meaning = {name: source.channels[signal].meaning for name, signal in signals.items()}
    meaning = {name: text for name, text in {"t": "\n".join(source.notes), **meaning}.items() if text}
    unit_of = {name: source.channels[signal].unit for name, signal in signals.items()}
    driven, seen = ({name: arrays[signal] for name, signal in side.items()} for side in (ins, outs))
    for name, unit in units.items():
        side = driven if name in driven else seen
        if name not in side:
            names = [*driven, *seen]
            hint = did_you_mean(name, names)
            raise InputError(source.where, f"a unit for {name!r}", one_of("one of", names), hint)
        _agree(source.where, name, unit_of[name], unit)
        factor, unit_of[name] = factor_to_si(unit)
        side[name] = side[name] * factor
    return {"t": t, "inputs": driven, "outputs": seen, "units": unit_of, "name": source.name, "meaning": meaning}


def _named(texts: Sequence[str] | None, known: Collection[str]) -> dict[str, str]:
    """Return name in the record -> signal of the file, of ``u=SIGNAL`` or equal names."""
    found: dict[str, str] = {}
    for text in [texts] if isinstance(texts, str) else list(texts or []):
        name, sign, signal = text.partition("=")
        alone = text in known or not sign
        found[text if alone else name.strip()] = text if alone else signal.strip()
    return found


def _agree(where: str, name: str, stated: str, given: str) -> None:
    if stated and not same_unit(stated, given):
        raise UnitMismatch(
            f"{where}: {name}",
            f"the file states {stated}, the unit given is {given}",
            "the unit that the numbers in the file are in",
            f"units={{{name!r}: {stated!r}}} converts from it; where the file is wrong, correct it there",
        )


def _numbers(source: Source, name: str) -> Array:
    values = source.channels[name].values
    where = f"{source.where}: {source.prefix}{name}"
    if isinstance(values, Unread) and values.dtype.startswith("MATLAB object ("):
        kind = values.dtype.removeprefix("MATLAB object (").removesuffix(")")
        recipe = MATLAB_RECIPES.get(kind.rpartition(".")[2], "").format(name) or None
        raise InputError(where, f"a {kind}, which MATLAB keeps in a form of its own", "plain arrays or structs", recipe)
    if isinstance(values, Unread) or values.dtype.kind not in "fib":
        hint = "choose signals with inputs= and outputs="
        if isinstance(values, Unread) and values.dtype == "reference":
            hint = "structs of several elements are read from files that save(..., '-v7') wrote"
        raise InputError(where, f"dtype {type_name(values)}", "a column of real numbers", hint)
    if values.ndim != 1:
        raise InputError(where, f"shape {values.shape}", "one column")
    array = values.astype(np.float64)
    bad = not_finite(array, "samples")
    if bad is not None:
        raise InputError(f"{where}[{bad[0]}]", bad[1], "finite numbers")
    return array


def _on_one_clock(
    source: Source,
    arrays: dict[str, Array],
    ins: set[str],
    keys: list[str],
    clock: str | None,
    dt: float | None,
    allow_gaps: bool,
) -> tuple[Array, dict[str, Array]]:
    """Resample signals of several time bases to one, inputs held, outputs interpolated; describe it in the notes."""
    clocks: dict[str, Array] = {}
    for key in keys:
        mine = {name: values for name, values in arrays.items() if source.channels[name].clock == key}
        label = key or clock or "t"
        t = clocks[key] = _times(source, mine, None, None if key else clock)
        steps = np.diff(t)
        if len(t) < 2:
            raise InputError(f"{source.where}: {label}", f"{len(t)} samples", "at least 2")
        if (steps <= 0).any():
            k = int(np.argmax(steps <= 0)) + 1
            word = "repeats the stamp before it" if steps[k - 1] == 0 else "runs backwards"
            raise InputError(f"{source.where}: {label}[{k}]", f"{t[k]:.9g} s {word}", "strictly increasing times")
        if not allow_gaps:
            _refuse_gaps(source.where, label, t)
    t, coarse = common_clock(source.where, clocks, dt)
    step = float(np.median(np.diff(t)))
    found: dict[str, Array] = {}
    follows = f"that of {coarse or clock}" if dt is None else "as given"
    span = f"{t[0]:.6g} s to {t[-1]:.6g} s"
    source.notes.append(f"{len(keys)} clocks brought on one of {1 / step:.6g} Hz ({follows}), {span}")
    for key in keys:
        between, apart, own = np.zeros(0, bool), 0.0, summarise_clock(clocks[key])
        words, mine = [own.text()], [name for name in arrays if source.channels[name].clock == key]
        for name in mine:
            if name in ins:
                found[name] = held(t, clocks[key], arrays[name], step)
                continue
            found[name], on_stamp, gaps = interpolated(t, clocks[key], arrays[name], step)
            between, apart = ~on_stamp, float(np.where(on_stamp, 0.0, gaps).max())
        if len(between):
            most = f", over {apart:.4g} s at most" if between.any() else ""
            words.append(f"outputs interpolated at {100 * between.mean():.3g} % of the samples{most}")
        if not ins.isdisjoint(mine):
            words.append("inputs held at their last sample")
        if own.step < 0.75 * step:
            words.append(f"{step / own.step:.3g} to 1, without a filter")
        source.notes.append(f"{key or clock or 't'}: {'; '.join(words)}")
    return t, found


def _refuse_gaps(where: str, label: str, t: Array) -> None:
    """Raise on missing samples: long steps in an otherwise regular time base."""
    steps = np.diff(t)
    if len(steps) < 2 or (steps <= 0).any():
        return  # Record raises on times that do not increase
    median = float(np.median(steps))
    regular = np.abs(steps - median) <= 0.05 * median
    holes = np.flatnonzero(steps > GAP * median)
    if len(holes) and regular.mean() >= 0.9:
        k = int(holes[0])
        lost = round(float(steps[k]) / median) - 1
        ends = f"t[{k}] = {t[k]:.9g} s and t[{k + 1}] = {t[k + 1]:.9g} s ({len(holes)} gaps in all)"
        found, hint = f"{lost} samples missing between {ends}", "cut the record there, or allow_gaps=True"
        raise InputError(where, f"{label}: {found}", f"a sample every {median:.6g} s", hint)


def _times(source: Source, arrays: Mapping[str, Array], dt: float | None, clock: str | None) -> Array:
    names = list(arrays)
    first, n, key = names[0], len(arrays[names[0]]), source.channels[names[0]].clock
    others = [
        f"{source.prefix}{name} has {len(values)} samples"
        + (f" (its own sample time is {source.channels[name].dt:g} s)" if source.channels[name].dt else "")
        for name, values in arrays.items()
        if len(values) != n
    ]
    if others:
        hint = "choose signals of one clock with inputs= and outputs="
        raise InputError(source.where, "; ".join(others), f"{n} as {source.prefix}{first}", hint)
    given = source.clocks[key] if key else None
    if not key and clock and clock in source.channels:
        try:
            given = _clock(source, clock, note=dt is None)
        except InputError:
            if dt is None:
                raise  # with dt given the channel need not hold times
    if dt is None and given is not None:
        if len(given) != n:
            label = key or f"{source.prefix}{clock or 't'}"
            raise InputError(source.where, f"{label} has {len(given)} samples, the signals {n}", "equal lengths")
        return given
    if dt is None:
        own = {name: source.channels[name].dt or source.dt for name in names}
        if len(set(own.values())) > 1:
            text = ", ".join(f"{source.prefix}{name} {value:g} s" for name, value in own.items())
            raise InputError(source.where, f"sample times differ: {text}", "signals of one clock")
        dt = own[first]
    if not dt:
        columns = one_of("a column t, or one of", names) + " as clock="
        raise InputError(source.where, "no clock and no sample time", columns, "dt=..., in s, or clock=...")
    if not np.isfinite(dt) or dt < 0:
        raise InputError(source.where, f"dt is {dt}", "a positive sample time in s")
    if given is not None and len(given) > 1 and (np.diff(given) > 0).all():
        step = clock_step(given)
        if abs(step / dt - 1) > SAME_RATE:
            ppm = f"{1e6 * (step / dt - 1):+.3g} ppm"
            source.notes.append(f"dt = {dt:g} s as given; {key or clock} has steps of {step:.9g} s ({ppm})")
    return np.arange(n, dtype=np.float64) * np.float64(dt)


def _clock(source: Source, name: str, note: bool) -> Array:
    channel, where = source.channels[name], f"{source.where}: {source.prefix}{name}"
    if channel.unit not in SECONDS:
        known = f"one of {', '.join(filter(None, SECONDS))}"
        raise InputError(where, f"unit {channel.unit!r}", known, f"units={{{name!r}: 'ms'}}")
    t, factor = _numbers(source, name), SECONDS[channel.unit]
    raw, late = channel.values, np.abs(t).max(initial=0.0)
    if factor == 1.0 and late > TOO_LATE:
        unit = next(u for u, most in (("ms", 1e14), ("us", 1e17), ("ns", np.inf)) if late <= most)
        found = f"times of {t[0]:.4g} {channel.unit or 'and no unit'}"
        raise InputError(where, found, "times in s", f"units={{{name!r}: {unit!r}}}, if it is {unit}")
    if isinstance(raw, np.ndarray) and raw.dtype.kind == "i" and len(raw) and abs(float(raw[0])) * factor > LONG:
        if note:
            source.notes.append(f"t counts from {name} = {int(raw[0])} {channel.unit or 's'} on")
        t = (raw - raw[0]).astype(np.float64)
    return t / round(1 / factor) if factor < 1 else t * factor


# --- tables of pandas -------------------------------------------------------------------------------------------------
# The frame's ``attrs`` hold inputs, outputs, units, meanings and the record's name, so that no information is lost.


def frame_of(keywords: Mapping[str, Any]) -> pandas.DataFrame:
    """Return a data frame with index ``t`` in s; see `robustlab.record.Record.to_pandas`."""
    require_package("Record.to_pandas", "pandas", "frames")
    import pandas

    inputs, outputs = keywords["inputs"], keywords["outputs"]
    frame = pandas.DataFrame({**inputs, **outputs}, index=pandas.Index(keywords["t"], name="t"))
    frame.attrs = {
        "name": keywords["name"],
        "units": {"t": "s", **keywords["units"]},
        "meaning": dict(keywords["meaning"]),
        "inputs": list(inputs),
        "outputs": list(outputs),
    }
    return frame


def keywords_of_frame(
    frame: Any, inputs: Sequence[str] | None, outputs: Sequence[str] | None, units: Mapping[str, str] | None
) -> dict[str, Any]:
    """Invert `frame_of`; see `robustlab.record.Record.from_pandas`."""
    where = "Record.from_pandas"
    require_package(where, "pandas", "frames")
    import pandas

    if not isinstance(frame, pandas.DataFrame):
        raise InputError(where, f"a {type(frame).__name__}", "a pandas DataFrame")
    if isinstance(frame.columns, pandas.MultiIndex) or isinstance(frame.index, pandas.MultiIndex):
        raise InputError(where, "nested columns or rows (a MultiIndex)", "one name a column, one time a row")
    names = [str(name) for name in frame.columns]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise InputError(where, f"column name {twice[0]!r} is used twice", "unique names")
    attrs = {key: value for key, value in frame.attrs.items() if isinstance(key, str)}
    stated, meaning = (attrs[key] if isinstance(attrs.get(key), dict) else {} for key in ("units", "meaning"))
    source = Source(where, str(attrs.get("name", "frame")), "", {})
    for k, name in enumerate(names):
        values, unit = _values(frame.iloc[:, k])
        source.channels[name] = Channel(values, unit or str(stated.get(name, "")), str(meaning.get(name, "")))
    for side in SIDES:
        given = attrs.get(side)
        getattr(source, side).extend([n for n in given if n in names] if isinstance(given, list) else [])
    if "t" in meaning:
        source.notes += str(meaning["t"]).splitlines()
    if not isinstance(frame.index, pandas.RangeIndex):
        (values, unit), name = _values(frame.index), str(frame.index.name or "index")
        source.add_clock(name, Channel(values, unit or str(stated.get(name, ""))))
    elif not any(name in names for name in CLOCK_NAMES):
        hint = "frame.index = dt * numpy.arange(len(frame)), or a column t"
        raise InputError(where, "rows are numbered, and no column is a clock", "an index of times in s", hint)
    # `check_record` reports gaps.
    return choose(source, inputs, outputs, units=units, allow_gaps=True)


def _values(column: Any) -> tuple[AnyArray | Unread, str]:
    """Return numbers; dates and durations as whole numbers with their unit; anything else as `Unread`."""
    kind = column.dtype
    code = getattr(kind, "kind", "O")
    if code in "mM":
        raw = np.asarray(column)
        if raw.dtype.kind == "O":  # with a time zone
            raw = np.asarray(column, dtype="datetime64[ns]")
        if np.isnat(raw).any():
            return Unread(f"{kind} with times that are none (NaT)", (len(column),)), ""
        return np.ascontiguousarray(raw).view(np.int64), str(np.datetime_data(raw.dtype)[0])
    if code not in "fiub":
        return Unread(str(kind), (len(column),)), ""
    if isinstance(kind, np.dtype):
        return canonical(np.asarray(column), "column"), ""
    whole = code in "iu" and not column.isna().any()
    return canonical(column.to_numpy(np.int64) if whole else column.to_numpy(np.float64, na_value=np.nan), "column"), ""
