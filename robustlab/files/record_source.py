"""What a file holds before anything is chosen: named channels, each on a clock; of text, trees and frames.

Logs in trees are structs with times and values, as Simulink and MATLAB's timeseries have them when saved as structs.
Three forms, at any depth below the group that is read::

    log.time, log.signals(k).values, .label      Simulink's "Structure with time"
    log.Time, log.Data, .Name, .Units            a timeseries as a plain struct
    log.time, log.values                         the same in other words (time or t; data or values)

A value of several columns becomes a channel for each, numbered as MATLAB numbers them: ``q(1)``, ``q(2)``.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from robustlab.arrays import AnyArray, Array
from robustlab.errors import DependencyMissing, InputError
from robustlab.files.signature import Limits
from robustlab.files.text_table import read_table
from robustlab.files.tree import Dataset, Tree, Unread, text_attr, type_name

TIMES, VALUES = ("time", "t"), ("data", "values")
MOST_COLUMNS = 1000
# MATLAB keeps objects in a form of its own; each of these lines makes a plain struct of one.
MATLAB_RECIPES = {
    "timetable": "T = timetable2table({0}); T.(1) = seconds(T.(1) - T.(1)(1)); S = table2struct(T, 'ToScalar', true); "
    "save('run.mat', '-struct', 'S', '-v7')",
    "table": "S = table2struct({0}, 'ToScalar', true); save('run.mat', '-struct', 'S', '-v7')",
    "timeseries": "{0} = struct('Time', {0}.Time, 'Data', {0}.Data, 'Name', {0}.Name); save('run.mat', '{0}', '-v7')",
    "Dataset": "for k = 1:{0}.numElements, e = {0}{{k}}; S.(matlab.lang.makeValidName(e.Name)) = "
    "struct('Time', e.Values.Time, 'Data', e.Values.Data); end; save('run.mat', '-struct', 'S', '-v7')",
}


class Log(NamedTuple):
    """One channel: its name relative to the group that was read, its clock's name and times (None: it has none)."""

    name: str
    values: AnyArray | Unread
    unit: str
    clock: str
    times: AnyArray | None


def opaque_class(dtype: str) -> str:
    """Name of the class of MATLAB that an `Unread` stands for; empty where it stands for something else."""
    return dtype.removeprefix("MATLAB object (").removesuffix(")") if dtype.startswith("MATLAB object (") else ""


def recipe_of(variable: str, kind: str) -> str | None:
    """The line of MATLAB that saves a variable of this class as a plain struct."""
    recipe = MATLAB_RECIPES.get(kind.rpartition(".")[2])
    return recipe.format(variable) if recipe else None


def logs_of(node: Tree) -> Iterator[Log]:
    """All channels of the logs in ``node`` and below it; their lengths are those of the file."""
    yield from _logs(node, node.file, "")


def stands_alone(node: Tree) -> bool:
    """True where a group is itself a log, and nothing else."""
    found = _times(node)
    if found is None:
        return False
    if "signals" in node.groups:
        return any(group and "values" in group.datasets for group in _parts(node.groups["signals"]))
    others = {name: item.values for name, item in node.datasets.items() if name != found[0]}
    columns = [name for name, values in others.items() if isinstance(values, Unread) or _has_samples(values)]
    return len(columns) == 1 and columns[0].lower() in VALUES


def _has_samples(values: AnyArray) -> bool:
    return values.dtype.kind in "fib" and values.size > 1


def _parts(signals: Tree) -> list[Tree]:
    return [signals] if "values" in signals.datasets else list(signals.groups.values())


def _logs(node: Tree, where: str, prefix: str) -> Iterator[Log]:
    if stands_alone(node):
        yield from _own(node, where, prefix, *(_times(node) or ("", np.zeros(0))))
        return
    for name, group in node.groups.items():
        if name not in ("inputs", "outputs", "#refs#", "#subsystem#"):
            yield from _logs(group, where, f"{prefix}.{name}" if prefix else name)


def _times(node: Tree) -> tuple[str, AnyArray] | None:
    for name, dataset in node.datasets.items():
        values = dataset.values
        stated = "unit" in dataset.attrs  # not by MATLAB: its logs are in s
        if name.lower() in TIMES and not stated and isinstance(values, np.ndarray) and values.dtype.kind in "fi":
            return name, values.reshape(-1)
    return None


def _own(node: Tree, where: str, prefix: str, clock: str, times: AnyArray) -> Iterator[Log]:
    key = f"{prefix or node.path.strip('/')}.{clock}".lstrip(".")
    signals = node.groups.get("signals")
    if signals is not None:
        parts = _parts(signals)
        labels = [_text(part, "label") or f"signal{k + 1}" for k, part in enumerate(parts)]
        labels = [f"{text}_{k + 1}" if labels.count(text) > 1 else text for k, text in enumerate(labels)]
        for part, label in zip(parts, labels, strict=True):
            if (dataset := part.datasets.get("values")) is not None:
                name = f"{prefix}.{label}" if prefix else label
                yield from _columns(where, name, dataset, _text(part, "unit"), key, times)
        return
    for own, data in node.datasets.items():
        if own.lower() in VALUES:
            name = prefix or _text(node, "Name") or _text(node, "name") or own
            unit = _text(node, "Units") or _text(node, "unit") or _text(node.groups.get("DataInfo", Tree()), "Units")
            yield from _columns(where, name, data, unit, key, times)


def _columns(where: str, name: str, dataset: Dataset, unit: str, clock: str, times: AnyArray) -> Iterator[Log]:
    values, n = dataset.values, len(times)
    t = times if n else None
    if isinstance(values, Unread) or values.dtype.kind not in "fib":
        yield Log(
            name, values if isinstance(values, Unread) else Unread(type_name(values), values.shape), unit, clock, t
        )
        return
    if values.ndim > 2 and n and values.shape[-1] == n:  # a matrix for each time: time runs last
        values = values.reshape(-1, n, order="F").T
    elif values.ndim == 2 and values.shape[0] != n and (values.shape[1] == n or values.shape[0] == 1):
        values = values.T
    table = values.reshape(len(values), -1, order="F") if values.ndim else values.reshape(1, 1)
    if table.shape[1] > MOST_COLUMNS:
        raise InputError(f"{where}: {name}", f"{table.shape[1]} columns", f"at most {MOST_COLUMNS}")
    for k in range(table.shape[1]):
        label = name if table.shape[1] == 1 else f"{name}({k + 1})"
        yield Log(label, np.ascontiguousarray(table[:, k]), unit, clock, t)


def _text(node: Tree, name: str) -> str:
    values: Any = node.datasets[name].values if name in node.datasets else None
    if isinstance(values, np.ndarray) and values.dtype.kind == "U" and values.size == 1:
        return str(values.flat[0]).strip()
    return ""


CLOCK_NAMES = ("t", "time", "Time", "TIME", "T", "timestamp", "tout", "zeit", "Zeit")


@dataclass
class Channel:
    """Samples as the file has them; ``clock`` is a key of `Source.clocks`, or empty for the source's own clock."""

    values: AnyArray | Unread
    unit: str = ""
    meaning: str = ""
    dt: float = 0.0  # sample time stated at the channel itself; 0 = not stated
    clock: str = ""


@dataclass
class Source:
    """All channels of a file (or of one group of it) before anything is chosen."""

    # where, name, prefix: the file, the record's name, and what messages put before a channel's name
    where: str
    name: str
    prefix: str
    channels: dict[str, Channel]  # name -> channel
    # dt, clock: sample time in s (0: not stated), and the channel with the times, as the file states them
    dt: float = 0.0
    clock: str = ""
    groups: list[str] = field(default_factory=list)  # groups that could be read instead
    # Name -> times in s, of channels with a clock of their own; None where they have none.
    clocks: dict[str, Array | None] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)  # what was done to the clocks so far, a line each
    # inputs, outputs: where the file states them; empty otherwise
    inputs: list[str] = field(default_factory=list)
    outputs: list[str] = field(default_factory=list)

    def label(self, name: str) -> str:
        """What messages call a channel."""
        return f"{self.prefix}{name}"

    def shown(self) -> str:
        """The signals there are, for messages."""
        return one_of("one of", list(self.channels))


def one_of(word: str, names: Sequence[str]) -> str:
    """``word`` and the first dozen of the names."""
    shown = ", ".join(names[:12]) + (", ..." if len(names) > 12 else "")
    return f"{word} {shown}" if names else "a file with signals"


def need(where: str, package: str, extra: str) -> None:
    """Go on only where an optional package is installed."""
    if importlib.util.find_spec(package) is None:
        raise DependencyMissing(where, f"needs the package {package}", None, f"pip install 'robustlab[{extra}]'")


def from_text(
    path: str | Path, group: str | None, delimiter: str | None, decimal: str, limits: Limits | None, isolate: bool
) -> Source:
    """The columns of a text file."""
    where = str(path)
    _no_group(where, group, "a text file")
    table = read_table(path, delimiter, decimal, limits, isolate)
    columns = zip(table.names, table.units, table.values.T, strict=True)
    channels = {name: Channel(np.array(values), unit) for name, unit, values in columns}
    return Source(where, Path(path).stem, "", channels)


def _no_group(where: str, group: str | None, kind: str) -> None:
    if group:
        raise InputError(where, f"group {group!r} of {kind}", f"no group: {kind.removeprefix('a ')}s have none")


# --- trees: HDF5, MATLAB ---------------------------------------------------------------------------------------------


def from_tree(path: str | Path, tree: Tree, node: Tree, group: str | None) -> Source:
    """The datasets of a group, and the logs in it and below it (see `robustlab.files.record_source`)."""
    channels = {} if stands_alone(node) else _datasets(node)
    own = _sample_time(node.attrs) or _sample_time(tree.attrs)
    for name in ("Ts", "dt"):  # MATLAB has no attributes: there the sample time is a variable
        values = channels[name].values if name in channels and not own else None
        if isinstance(values, np.ndarray) and values.size == 1:
            own = float(values.flat[0])
            del channels[name]
    clocks: dict[str, Array | None] = {}
    for log in logs_of(node):
        clocks[log.clock] = None if log.times is None else log.times.astype(np.float64)
        channels[log.name] = Channel(log.values, log.unit, clock=log.clock)
    stem = Path(path).stem
    prefix = f"{node.path.rstrip('/')}/"
    name = f"{stem}/{group.strip('/')}" if group else stem
    return Source(str(path), name, prefix, channels, own, groups=tree.group_names(), clocks=clocks)


def _datasets(node: Tree) -> dict[str, Channel]:
    channels = {}
    for name, dataset in node.datasets.items():
        attrs, values = dataset.attrs, dataset.values
        if isinstance(values, np.ndarray) and values.ndim == 2 and 1 in values.shape:
            values = values.reshape(-1)  # MATLAB's columns and rows are two-dimensional; a record's channels are not
        unit, meaning = text_attr(attrs, "unit") or "", text_attr(attrs, "meaning") or ""
        channels[name] = Channel(values, unit, meaning, _sample_time(attrs))
    return channels


def _sample_time(attrs: Mapping[str, Any]) -> float:
    for name in ("Ts", "dt", "fs"):
        value = np.asarray(attrs.get(name, 0.0))
        if value.dtype.kind in "fi" and value.size == 1 and float(value.flat[0]) > 0:
            number = float(value.flat[0])
            return 1.0 / number if name == "fs" else number
    return 0.0
