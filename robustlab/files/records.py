"""Measured records from HDF5, MATLAB and text files, as the arguments of `robustlab.record.Record`.

What is done to a record's clock is in its meaning of ``t``, a line each. In format 1 a record has ``t``,
``inputs/<name>``, ``outputs/<name>``; attributes ``unit``, ``meaning``.
"""

from __future__ import annotations

import warnings
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from robustlab.arrays import AnyArray, Array, Mask, not_finite
from robustlab.clocks import clock_step, common_clock, held, interpolated, summarise_clock
from robustlab.errors import InputError, UnitMismatch, did_you_mean
from robustlab.files.hdf5 import read_tree
from robustlab.files.record_source import CLOCK_NAMES, Source, from_text, from_tree, one_of, opaque_class, recipe_of
from robustlab.files.signature import Limits, content_of
from robustlab.files.tree import Tree, Unread, check_header, is_stamped, link_name, signal_name, text_attr, type_name
from robustlab.units import factor_to_si, same_unit


def encode_record(tree: Tree, keywords: Mapping[str, Any]) -> None:
    """Put the arguments of a Record into ``tree``."""
    tree.attrs["name"] = keywords["name"]
    of_clock = {"meaning": keywords["meaning"]["t"]} if "t" in keywords["meaning"] else {}
    tree.put("t", keywords["t"], unit="s", **of_clock)
    for side in ("inputs", "outputs"):
        group = tree.group(side)
        for position, (name, values) in enumerate(keywords[side].items()):
            attrs = {
                "unit": keywords["units"].get(name, ""),
                "meaning": keywords["meaning"].get(name, ""),
                "position": position,
            }
            group.put(link_name(name), values, **attrs)


def decode_record(node: Tree, where: str) -> dict[str, Any]:
    """Inverse of `encode_record`."""
    problems: list[str] = []
    keywords: dict[str, Any] = {"name": str(node.attrs.get("name", "")) or "record", "units": {}, "meaning": {}}
    if "t" not in node.datasets:
        problems.append(f"missing {node.child_path('t')}")
        n = None
    else:
        keywords["t"] = _column(node, "t", problems)
        n = len(keywords["t"])
        if text := text_attr(node.datasets["t"].attrs, "meaning"):
            keywords["meaning"]["t"] = text
    for side in ("inputs", "outputs"):
        keywords[side] = {}
        group = node.groups.get(side, Tree())
        for link in sorted(group.datasets, key=lambda name: (_position(group, name), name)):
            name = signal_name(link)
            values = _column(group, link, problems)
            if n is not None and len(values) != n:
                problems.append(
                    f"{group.child_path(link)} has {len(values)} samples, expected {n} as {node.child_path('t')}"
                )
            keywords[side][name] = values
            for key, table in (("unit", "units"), ("meaning", "meaning")):
                text = np.asarray(group.datasets[link].attrs.get(key, ""))
                if text.size == 1 and str(text.flat[0]):
                    keywords[table][name] = str(text.flat[0])
    if problems:
        raise InputError(where, problems[0], None, None, tuple(f"{where}: {line}" for line in problems[1:]))
    return keywords


def _position(group: Tree, link: str) -> int:
    value = np.asarray(group.datasets[link].attrs.get("position", 1 << 30))
    return int(value.flat[0]) if value.size == 1 and value.dtype.kind in "if" else 1 << 30


def _column(node: Tree, name: str, problems: list[str]) -> AnyArray:
    values, path = node.datasets[name].values, node.child_path(name)
    if not isinstance(values, np.ndarray) or values.dtype.kind not in "fi":
        problems.append(f"{path} has dtype {type_name(values)}, expected a column of real numbers")
        return np.zeros(0)
    if values.ndim == 2 and 1 in values.shape:
        values = values.reshape(-1)
    if values.ndim != 1:
        problems.append(f"{path} is {values.shape}, expected one column")
        return np.zeros(0)
    bad = not_finite(values, "samples")
    if bad is not None:
        problems.append(f"{path}[{bad[0]}] {bad[1]}")
    return values.astype(np.float64)


SECONDS = {"": 1.0, "s": 1.0, "sec": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "μs": 1e-6, "ns": 1e-9, "min": 60.0}
# A step longer than this many median steps, in a clock that is otherwise regular, is a hole.
GAP = 1.5
# s; three years. A clock of whole numbers that begins later counts from its first sample, which keeps all digits.
LONG = 1e8
# s; some 3000 years. A clock beyond it shows smaller units since 1970, whatever it says.
TOO_LATE = 1e11
# A sample time given beside a clock that differs by more than this is told.
SAME_RATE = 1e-6


@dataclass(frozen=True)
class RecordOptions:
    """What is taken of a file, and how it is understood."""

    group: str | None = None  # HDF5 group or MATLAB struct that holds the signals
    # inputs, outputs: names of the signals to take; `"u=SIGNAL"` takes SIGNAL and calls it u. With neither given, all
    # signals are outputs, because only the user knows which are inputs (a format 1 record knows). With inputs only,
    # all others are outputs.
    inputs: Sequence[str] | None = None
    outputs: Sequence[str] | None = None
    # Sample time in s; wins over what the file says. Without it and without a clock, the attribute `Ts` (or `dt`, in
    # s, or `fs` in Hz) of the signals, else of their group, else of the file is used. Signals of several clocks are
    # brought on one of this sample time, or on the coarsest of theirs.
    dt: float | None = None
    # Name of the signal with the times; `t` or `time` where left out. A unit of ms, us, ns or min is converted to s.
    clock: str | None = None
    # Name -> unit that the numbers in the file are in. They are converted to the SI unit of the same kind (deg to
    # rad, rpm to rad/s, mm to m), a unit that is in no table of `robustlab.units` is kept as it is. Signals that are
    # not named keep the numbers and the unit of the file.
    units: Mapping[str, str] | None = None
    # delimiter, decimal: for text files; see `robustlab.files.text_table.read_table`
    delimiter: str | None = None
    decimal: str = "."
    allow_gaps: bool = False  # accept a clock with missing samples
    no_verify: bool = False  # accept a format 1 record whose content hash does not match


def read_record(
    path: str | Path, options: RecordOptions, limits: Limits | None = None, isolate: bool = True
) -> dict[str, Any]:
    """Read one record; the result holds the keyword arguments of `robustlab.record.Record`."""
    group, content = options.group, content_of(path, limits)
    if content == "text":
        return choose(from_text(path, group, options.delimiter, options.decimal, limits, isolate), options)
    tree = read_tree(path, group, limits, isolate)
    if is_stamped(tree):
        return _stored(_record_of_format_1(str(path), tree, options), str(path), options)
    node = tree.find(group) if group else tree
    if node is None:
        known = tree.group_names()
        raise InputError(
            str(path), f"missing group /{group}", one_of("one of", known), did_you_mean(group or "", known)
        )
    if {"inputs", "outputs"} & set(node.groups):
        return _stored(node, str(path), options)
    return choose(from_tree(path, tree, node, group), options)


def _texts(given: Sequence[str] | None) -> list[str]:
    return [given] if isinstance(given, str) else list(given or [])


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
    names = {name: name for name in known}
    if inputs is not None or outputs is not None:
        ins = {name: name for name in keywords["inputs"]} if inputs is None else _named(inputs, known)
        rest = {name: name for name in known if name not in ins.values()}
        outs = rest if outputs is None else _named(outputs, known)
        missing = [signal for signal in (*ins.values(), *outs.values()) if signal not in known]
        if missing:
            raise _missing(where, missing, one_of("one of", list(known)), list(known), node.path.rstrip("/") + "/")
        keywords["inputs"], keywords["outputs"] = ({name: known[s] for name, s in side.items()} for side in (ins, outs))
        names = {**ins, **outs}
    for key in ("units", "meaning"):
        told = keywords[key]
        of_clock = {"t": told["t"]} if "t" in told else {}
        keywords[key] = {**of_clock, **{name: told[signal] for name, signal in names.items() if signal in told}}
    _convert(where, keywords["inputs"], keywords["outputs"], keywords["units"], options.units or {})
    return keywords


# --- choosing --------------------------------------------------------------------------------------------------------


def choose(source: Source, options: RecordOptions) -> dict[str, Any]:
    """Keywords of a record from what a file (or a table in memory) holds; errors as `read_record`."""
    dt, units = options.dt, dict(options.units or {})
    known = list(source.channels)
    # With dt given the file's clock is not used, and a column of that name is no signal either.
    clock = options.clock or source.clock or next((name for name in CLOCK_NAMES if name in known), None)
    stated = options.inputs is None and options.outputs is None and (source.inputs or source.outputs)
    ins = _named(source.inputs if stated else options.inputs, known)
    outs = _named(source.outputs if stated else options.outputs, known)
    if options.outputs is None and not stated:
        outs = {name: name for name in _of_default_clock(source, clock, dt) if name not in (*ins.values(), clock)}
    signals = {**ins, **outs}
    asked = [*signals.values(), *([clock] if clock and dt is None else [])]
    missing = [name for name in asked if name not in known]
    if missing and not known:
        raise _no_signals(source, f"missing {', '.join(source.label(name) for name in missing)}")
    if missing:
        raise _missing(source.where, missing, source.shown(), known, source.prefix)
    if not signals:
        raise _no_signals(source, "no signals here")
    arrays = {signal: _numbers(source, signal) for signal in signals.values()}
    if clock is not None and clock in units and clock not in signals:
        _agree(source.where, clock, source.channels[clock].unit, units[clock])
        source.channels[clock].unit = units.pop(clock)
    order = dict.fromkeys(source.channels[signal].clock for signal in (*outs.values(), *ins.values()))
    if len(order) > 1 and not _same_clock([source.clocks.get(key) for key in order]):
        t, arrays = _on_one_clock(source, arrays, set(ins.values()), list(order), clock, options)
    else:
        n = _common_length(source, arrays)
        t = _times(source, list(arrays), n, dt, clock)
        if not options.allow_gaps:
            _refuse_gaps(source.where, "t", t)
    meaning = {name: source.channels[signal].meaning for name, signal in signals.items()}
    meaning = {name: text for name, text in {"t": "\n".join(source.notes), **meaning}.items() if text}
    told = {name: source.channels[signal].unit for name, signal in signals.items()}
    inputs, outputs = ({name: arrays[signal] for name, signal in side.items()} for side in (ins, outs))
    _convert(source.where, inputs, outputs, told, units)
    return {"t": t, "inputs": inputs, "outputs": outputs, "units": told, "name": source.name, "meaning": meaning}


def _named(texts: Sequence[str] | None, known: Collection[str]) -> dict[str, str]:
    """Name in the record -> signal of the file: ``u=SIGNAL``, or both are the same."""
    found: dict[str, str] = {}
    for text in _texts(texts):
        name, sign, signal = text.partition("=")
        alone = text in known or not sign
        found[text if alone else name.strip()] = text if alone else signal.strip()
    return found


def _of_default_clock(source: Source, clock: str | None, dt: float | None) -> list[str]:
    """What is read where nothing is named: the signals of the source's own clock, or where it has none all logs."""
    own = [name for name, channel in source.channels.items() if not channel.clock]
    logged = [name for name, channel in source.channels.items() if channel.clock]
    return own if not logged or clock in own or (own and (dt or source.dt)) else logged


def _same_clock(clocks: list[Array | None]) -> bool:
    first = clocks[0]
    return first is not None and all(t is not None and np.array_equal(t, first) for t in clocks[1:])


def _on_one_clock(
    source: Source, arrays: dict[str, Array], ins: set[str], keys: list[str], clock: str | None, options: RecordOptions
) -> tuple[Array, dict[str, Array]]:
    """Signals of several clocks on one: inputs held, outputs interpolated; what was done goes to the notes."""
    clocks: dict[str, Array] = {}
    for key in keys:
        mine = {name: values for name, values in arrays.items() if source.channels[name].clock == key}
        label = key or clock or "t"
        t = _times(source, list(mine), _common_length(source, mine), None, None if key else clock)
        _refuse_backwards(source.where, label, t)
        if not options.allow_gaps:
            _refuse_gaps(source.where, label, t)
        clocks[key] = t
    t, coarse = common_clock(source.where, clocks, options.dt)
    step = float(np.median(np.diff(t)))
    found: dict[str, Array] = {}
    follows = f"that of {coarse or clock}" if options.dt is None else "as given"
    source.notes.append(
        f"{len(keys)} clocks brought on one of {1 / step:.6g} Hz ({follows}), {t[0]:.6g} s to {t[-1]:.6g} s"
    )
    for key in keys:
        mine = [name for name in arrays if source.channels[name].clock == key]
        between, apart = np.zeros(len(t), bool), 0.0
        for name in mine:
            if name in ins:
                found[name] = held(t, clocks[key], arrays[name], step)
                continue
            found[name], own, gaps = interpolated(t, clocks[key], arrays[name], step)
            between, apart = ~own, float(np.where(own, 0.0, gaps).max())
        source.notes.append(f"{key or clock}: {_done(mine, ins, clocks[key], between, apart, step)}")
    return t, found


def _done(mine: list[str], ins: set[str], t: Array, between: Mask, apart: float, step: float) -> str:
    """What one of several clocks is like, and what was done to its signals."""
    own, words = summarise_clock(t), []
    if not ins.issuperset(mine):
        words.append(
            f"outputs interpolated at {100 * between.mean():.3g} % of the samples"
            + (f", over {apart:.4g} s at most" if between.any() else "")
        )
    if not ins.isdisjoint(mine):
        words.append("inputs held at their last sample")
    if own.step < 0.75 * step:
        words.append(f"{step / own.step:.3g} to 1, without a filter")
    return "; ".join([own.text(), *words])


def _refuse_backwards(where: str, label: str, t: Array) -> None:
    if len(t) < 2:
        raise InputError(f"{where}: {label}", f"{len(t)} samples", "at least 2")
    steps = np.diff(t)
    if (steps <= 0).any():
        k = int(np.argmax(steps <= 0)) + 1
        word = "repeats the stamp before it" if steps[k - 1] == 0 else "runs backwards"
        raise InputError(f"{where}: {label}[{k}]", f"{t[k]:.9g} s {word}", "strictly increasing times")


def _convert(
    where: str, inputs: dict[str, Array], outputs: dict[str, Array], stated: dict[str, str], given: Mapping[str, str]
) -> None:
    """Bring the named signals from the unit given for their numbers to SI; changes the first three tables."""
    for name, unit in given.items():
        side = inputs if name in inputs else outputs
        if name not in side:
            known = [*inputs, *outputs]
            raise InputError(where, f"a unit for {name!r}", one_of("one of", known), did_you_mean(name, known))
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
            f"units={{{name!r}: {stated!r}}} converts from it; where the file is wrong, correct it there",
        )


def _no_signals(source: Source, found: str) -> InputError:
    if not source.groups:
        return InputError(source.where, found, "a file with signals")
    return InputError(
        source.where,
        found,
        one_of("signals in the group given; groups are", source.groups),
        f"group={source.groups[0]!r}" if len(source.groups) == 1 else "group=...",
    )


def _numbers(source: Source, name: str) -> Array:
    values = source.channels[name].values
    where = f"{source.where}: {source.label(name)}"
    if isinstance(values, Unread) and (kind := opaque_class(values.dtype)):
        hint = recipe_of(name, kind)
        raise InputError(where, f"a {kind}, which MATLAB keeps in a form of its own", "plain arrays or structs", hint)
    if isinstance(values, Unread) or values.dtype.kind not in "fib":
        raise InputError(
            where, f"dtype {type_name(values)}", "a column of real numbers", "choose signals with inputs= and outputs="
        )
    if values.ndim != 1:
        raise InputError(where, f"shape {values.shape}", "one column")
    array = values.astype(np.float64)
    bad = not_finite(array, "samples")
    if bad is not None:
        raise InputError(f"{where}[{bad[0]}]", bad[1], "finite numbers")
    return array


def _common_length(source: Source, arrays: Mapping[str, Array]) -> int:
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


def _times(source: Source, names: list[str], n: int, dt: float | None, clock: str | None) -> Array:
    key = source.channels[names[0]].clock
    given = source.clocks[key] if key else None
    if not key and clock and clock in source.channels:
        try:
            given = _clock(source, clock, tell=dt is None)
        except InputError:
            if dt is None:
                raise  # with dt given the clock need not be one
    if dt is None and given is not None:
        if len(given) != n:
            label = key or source.label(clock or "t")
            raise InputError(source.where, f"{label} has {len(given)} samples, the signals {n}", "equal lengths")
        return given
    if dt is None:
        own = {name: source.channels[name].dt for name in names}
        if len(set(own.values())) > 1:
            text = ", ".join(f"{source.label(name)} {value or source.dt:g} s" for name, value in own.items())
            raise InputError(source.where, f"sample times differ: {text}", "signals of one clock")
        dt = next(iter(own.values())) or source.dt
    if not dt:
        columns = one_of("a column t, or one of", names)
        raise InputError(
            source.where, "no clock and no sample time", columns + " as clock=", "dt=..., in s, or clock=..."
        )
    if not np.isfinite(dt) or dt < 0:
        raise InputError(source.where, f"dt is {dt}", "a positive sample time in s")
    if given is not None and len(given) > 1 and (np.diff(given) > 0).all():
        gain = clock_step(given) / dt - 1
        if abs(gain) > SAME_RATE:
            source.notes.append(
                f"dt = {dt:g} s as given; {key or clock} has steps of {clock_step(given):.9g} s ({1e6 * gain:+.3g} ppm)"
            )
    return np.arange(n, dtype=np.float64) * np.float64(dt)


def _clock(source: Source, name: str, tell: bool) -> Array:
    channel, where = source.channels[name], f"{source.where}: {source.label(name)}"
    if channel.unit not in SECONDS:
        raise InputError(
            where, f"unit {channel.unit!r}", f"one of {', '.join(filter(None, SECONDS))}", f"units={{{name!r}: 'ms'}}"
        )
    t, factor = _numbers(source, name), SECONDS[channel.unit]
    raw = channel.values
    if factor == 1.0 and len(t) and np.abs(t).max() > TOO_LATE:
        unit = next(u for u, most in (("ms", 1e14), ("us", 1e17), ("ns", np.inf)) if np.abs(t).max() <= most)
        found = f"times of {t[0]:.4g} {channel.unit or 'and no unit'}"
        raise InputError(where, found, "times in s", f"units={{{name!r}: {unit!r}}}, if it is {unit}")
    if isinstance(raw, np.ndarray) and raw.dtype.kind == "i" and len(raw) and abs(float(raw[0])) * factor > LONG:
        if tell:
            source.notes.append(f"t counts from {name} = {int(raw[0])} {channel.unit or 's'} on")
        t = (raw - raw[0]).astype(np.float64)
    return t / round(1 / factor) if factor < 1 else t * factor


def _refuse_gaps(where: str, label: str, t: Array) -> None:
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
            f"{label}: {lost} samples missing between t[{k}] = {t[k]:.9g} s and t[{k + 1}] = {t[k + 1]:.9g} s "
            f"({len(holes)} gaps in all)",
            f"a sample every {median:.6g} s",
            "cut the record there, or allow_gaps=True",
        )


def _missing(where: str, missing: list[str], shown: str, known: list[str], prefix: str) -> InputError:
    lines = []
    for name in missing:
        near = did_you_mean(name, known)
        lines.append(f"missing {prefix}{name}" + (f" ({near})" if near else ""))
    return InputError(where, lines[0], shown, None, tuple(f"{where}: {line}" for line in lines[1:]))
