"""Formats of others that optional packages read: Parquet files, and ROS 2 bags in MCAP files, as trees.

They are read in a child process; see `robustlab.files.isolation`.

Of a Parquet file each column is a dataset with its unit. Sizes are looked at in the file's footer before a column is
read, and columns are read in pieces.

Of a bag the numeric fields of the topics that are asked for are read, and the stamps of their messages. The file is
read once from front to end, chunk by chunk, with its checksums; a chunk's declared size is looked at before it is
decompressed. A topic becomes a group with the datasets ``log`` (when it was written) and ``stamp`` (when it was
measured, by the message's header; absent without one), whole nanoseconds, and one for each field. Fields nobody asked
for are `Unread`, so that messages can list them. So are columns.
"""

from __future__ import annotations

import json
import re
import time
from array import array
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from robustlab.arrays import AnyArray
from robustlab.errors import InputError
from robustlab.files.signature import Limits, size_text
from robustlab.files.text_table import name_and_unit
from robustlab.files.tree import Dataset, Tree, Unread, canonical, table_of, text_attr

ROWS_AT_A_TIME = 1 << 17


def parquet_tree(
    path: str,
    wanted: Sequence[str] | None,
    limits: Limits,
    shown: str | None = None,
    allow: Callable[[int], None] = lambda _: None,
) -> Tree:
    """Read the columns ``wanted`` (all for None) of a Parquet file.

    Numbers become float64 or int64; times and durations int64 with their unit as attribute ``unit``. The root has the
    attribute ``clock`` where an index of pandas, or the only column of times, says what the clock is; and
    ``inputs``, ``outputs``, ``name`` where `robustlab.record.Record.to_pandas` made the table.

    Raises InputError: a truncated or damaged file, columns of one name, more than the limits.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    where = shown or path
    try:
        with pq.ParquetFile(path, memory_map=False, thrift_string_size_limit=64 << 20) as file:
            return _read(file, where, wanted, limits, allow)
    except InputError:
        raise
    except (MemoryError, pa.ArrowMemoryError):
        raise InputError(where, "needs more memory than the reader may use") from None
    except Exception as error:  # whatever the library says about a damaged file is a finding about the file
        text = " ".join(str(error).split())[:160]
        raise InputError(where, f"truncated or damaged Parquet file ({text})", None, "copy the file again") from error


def _read(file: Any, where: str, wanted: Sequence[str] | None, limits: Limits, allow: Callable[[int], None]) -> Tree:
    schema, rows = file.schema_arrow, file.metadata.num_rows
    if len(schema.names) > limits.objects:
        raise InputError(where, f"{len(schema.names)} columns", f"at most {limits.objects}")
    told = _metadata(schema)
    of_record = "inputs" in table_of(told, "attributes")  # its names are what they are
    labels = [(name, "") if of_record else name_and_unit(name) for name in schema.names]
    names = [name for name, _ in labels]
    twice = sorted({name for name in names if names.count(name) > 1}) if len(set(names)) < len(names) else []
    if twice:
        raise InputError(where, f"column name {twice[0]!r} is used twice", "unique names")
    if too_long := [name for name in names if len(name) > limits.name]:
        raise InputError(where, f"a column name of {len(too_long[0])} characters", f"at most {limits.name}")
    if rows == 0:
        raise InputError(where, "no rows", "a table with samples")
    tree, columns = Tree(file=where), list(zip(schema, labels, strict=True))
    _tell(tree, told, columns)
    also = {*(wanted or []), text_attr(tree.attrs, "clock") or ""}
    chosen = [(f, name) for f, (name, _) in columns if _is_numeric(f.type) and (wanted is None or name in also)]
    declared = 8 * rows
    for part, limit in ((declared, limits.dataset), (declared * len(chosen), limits.total)):
        if part > limit:
            found = f"{rows} rows in {len(chosen)} columns take {size_text(part)} in memory"
            raise InputError(where, found, f"at most {size_text(limit)}", "choose columns with inputs= and outputs=")
    allow(declared * len(chosen))
    for f, (name, _) in columns:
        tree.datasets[name].values = Unread("not read" if _is_numeric(f.type) else str(f.type)[:60], (rows,))
    for f, name in chosen:
        tree.datasets[name].values = canonical(_column(file, f, rows, where), f"{where}: {name}")
    return tree


def _tell(tree: Tree, told: dict[str, Any], columns: list[tuple[Any, tuple[str, str]]]) -> None:
    """What the file says of its columns, beside their values; ``told`` is what pandas left there."""
    attrs = table_of(told, "attributes")
    units, meanings = table_of(attrs, "units"), table_of(attrs, "meaning")
    for f, (name, unit) in columns:
        dataset = tree.datasets[name] = Dataset(Unread("not read", ()))
        own = {
            key.decode(errors="replace"): value.decode(errors="replace") for key, value in (f.metadata or {}).items()
        }
        unit = _clock_unit(f.type) or unit or own.get("unit") or own.get("units") or units.get(name) or ""
        meaning = own.get("meaning") or meanings.get(name) or ""
        for key, text in (("unit", unit), ("meaning", meaning)):
            if text and isinstance(text, str):
                dataset.attrs[key] = canonical(text[:1000].replace("\x00", ""), key)
    stored = {f.name: name for f, (name, _) in columns}
    index = [stored[text] for text in told.get("index_columns", []) if isinstance(text, str) and text in stored]
    times = [name for f, (name, _) in columns if _clock_unit(f.type)]
    clock = index[0] if len(index) == 1 else times[0] if len(times) == 1 else ""
    if clock:
        tree.attrs["clock"] = canonical(clock, "clock")
    for side in ("inputs", "outputs"):
        given = attrs.get(side)
        if isinstance(given, list) and all(isinstance(item, str) for item in given):
            tree.attrs[side] = canonical(np.array(given, np.str_), side)
    if isinstance(attrs.get("name"), str):
        tree.attrs["name"] = canonical(attrs["name"][:200], "name")
    if isinstance(meanings.get("t"), str):
        tree.attrs["meaning"] = canonical(meanings["t"][:10_000], "meaning")


def _metadata(schema: Any) -> dict[str, Any]:
    """What pandas has left in the footer."""
    raw = (schema.metadata or {}).get(b"pandas", b"{}")
    try:
        told = json.loads(raw)
    except (ValueError, RecursionError):
        return {}
    return told if isinstance(told, dict) else {}


def _clock_unit(kind: Any) -> str:
    """s, ms, us or ns of times and durations; empty of other types."""
    import pyarrow.types as t

    return str(kind.unit) if t.is_timestamp(kind) or t.is_duration(kind) else ""


def _is_numeric(kind: Any) -> bool:
    import pyarrow.types as t

    return t.is_integer(kind) or t.is_floating(kind) or t.is_boolean(kind) or bool(_clock_unit(kind))


def _column(file: Any, f: Any, rows: int, where: str) -> AnyArray:
    import pyarrow as pa
    import pyarrow.types as t

    whole = t.is_integer(f.type) or bool(_clock_unit(f.type))
    found = np.empty(rows, np.uint64 if f.type == pa.uint64() else np.int64 if whole else np.float64)
    done = 0
    for batch in file.iter_batches(batch_size=ROWS_AT_A_TIME, columns=[f.name], use_threads=False):
        part = batch.column(0)
        if done + len(part) > rows:
            raise InputError(where, f"more rows than the {rows} of the footer", None, "file is damaged or hostile")
        if part.null_count:
            k = done + int(np.argmax(np.asarray(part.is_null())))
            raise InputError(f"{where}: {f.name}[{k}]", "no value (null)", "a number in every row")
        if _clock_unit(f.type):
            part = part.cast(pa.int64())
        elif f.type == pa.float16():
            part = part.cast(pa.float32())
        found[done : done + len(part)] = part.to_numpy(zero_copy_only=False)
        done += len(part)
    if done != rows:
        raise InputError(where, f"{done} of the {rows} rows of the footer", None, "file is damaged; copy it again")
    return found


NOT_LISTED = 32  # entries of an array beyond these are found by their path only
PART = re.compile(r"([A-Za-z_]\w*)((?:\[[^\[\]]+\])*)")
INDEX = re.compile(r"\[([^\[\]]+)\]")
RECOVER = "mcap recover IN -o OUT"
DEEPEST = 12  # of messages in messages


@dataclass
class _Topic:
    """What is known of a topic so far."""

    name: str
    encoding: str
    decode: Callable[[bytes], Any] | None
    fields: dict[str, int] = field(default_factory=dict)  # path -> entries that the array at its end has; 0 = a number
    wanted: list[tuple[str, list[str | int]]] = field(default_factory=list)
    values: list[array[float]] = field(default_factory=list)
    log: array[int] = field(default_factory=lambda: array("q"))
    stamp: array[int] | None = None


def bag_tree(path: str, group: str | None, wanted: Sequence[str] | None, limits: Limits, shown: str | None) -> Tree:
    """Read the fields ``wanted`` (``/topic.field[0]``, or ``field[0]`` of the topic ``group``); None: all of the group.

    Raises InputError: a truncated or damaged file, chunks beyond the limits, a field that some messages lack or that is
    no number.
    """
    where = shown or path
    bag = _Bag(where, limits, group, None if wanted is None else list(wanted))
    try:
        with Path(path).open("rb") as stream:
            for record in _records(stream, where, limits):
                bag.take(record)
    except InputError:
        raise
    except MemoryError:
        raise InputError(where, "needs more memory than the reader may use") from None
    except Exception as error:  # whatever the library says about a damaged file is a finding about the file
        name, text = type(error).__name__, str(error)[:120]
        if name == "EndOfFile" or "unpack requires" in text or "Error -5" in text:
            found = f"truncated after {bag.messages} messages"
        else:
            found = f"damaged MCAP file ({name}: {text})"
        raise InputError(where, found, None, f"copy the file again, or {RECOVER}") from error
    return bag.tree()


def _records(stream: Any, where: str, limits: Limits) -> Iterator[Any]:
    """All records in order, those in chunks too."""
    from mcap.records import Chunk
    from mcap.stream_reader import StreamReader, breakup_chunk

    end = time.process_time() + 0.8 * limits.seconds
    for record in StreamReader(stream, emit_chunks=True, validate_crcs=True, record_size_limit=limits.dataset).records:
        if not isinstance(record, Chunk):
            yield record
            continue
        if record.uncompressed_size > limits.dataset:
            size = size_text(record.uncompressed_size)
            raise InputError(where, f"a chunk declares {size}, limit {size_text(limits.dataset)}")
        yield from breakup_chunk(record, validate_crc=True)
        if time.process_time() > end:
            raise InputError(
                where,
                f"not read to its end in {0.8 * limits.seconds:g} s of processor time",
                "a shorter bag",
                "mcap filter IN -o OUT --include-topic-regex '/joint_states|/command'",
            )


class _Bag:
    """Collects what the records of a bag say."""

    def __init__(self, where: str, limits: Limits, group: str | None, wanted: list[str] | None) -> None:
        from mcap_ros2.decoder import DecoderFactory

        self.where, self.limits, self.group = where, limits, group
        self.wanted, self.messages = wanted, 0
        self.factory = DecoderFactory()
        self.schemas: dict[int, Any] = {}
        self.channels: dict[int, _Topic] = {}
        self.topics: dict[str, _Topic] = {}
        self.taken = 0

    def take(self, record: Any) -> None:
        from mcap.records import Channel, Message, Schema

        if isinstance(record, Message):
            topic = self.channels.get(record.channel_id)
            if topic is None:
                raise InputError(self.where, f"a message of channel {record.channel_id}, which the file does not name")
            self._message(topic, record)
        elif isinstance(record, Schema):
            self.schemas[record.id] = record
        elif isinstance(record, Channel) and record.id not in self.channels:
            if len(self.channels) >= self.limits.objects:
                raise InputError(self.where, f"more than {self.limits.objects} channels")
            schema = self.schemas.get(record.schema_id)
            decode = self.factory.decoder_for(record.message_encoding, schema)
            encoding = f"{record.message_encoding or '?'} with {schema.encoding if schema else 'no'} schema"
            # Several publishers of one topic have a channel each.
            topic = self.topics.setdefault(record.topic, _Topic(record.topic, encoding, decode))
            self.channels[record.id] = topic

    def _message(self, topic: _Topic, record: Any) -> None:
        self.messages += 1
        first = not topic.log
        topic.log.append(min(record.log_time, 2**63 - 1))
        if topic.decode is None or not (first or topic.values):
            return
        message = topic.decode(record.data)
        if first:
            self._first(topic, message)
        for (path, parts), values in zip(topic.wanted, topic.values, strict=True):
            values.append(self._number(topic, path, parts, message))
        if topic.stamp is not None and topic.values:
            stamp = message.header.stamp
            topic.stamp.append(stamp.sec * 10**9 + stamp.nanosec)
        self.taken += 8 * (len(topic.values) + 2)
        if self.taken > self.limits.total:
            raise InputError(self.where, "the fields asked for take more", f"at most {size_text(self.limits.total)}")

    def _first(self, topic: _Topic, message: Any) -> None:
        """What a topic holds, and what of it is wanted, from its first message."""
        topic.fields = dict(_numeric(message, "", 0))
        stamp = getattr(getattr(message, "header", None), "stamp", None)
        if hasattr(stamp, "sec") and hasattr(stamp, "nanosec"):
            topic.stamp = array("q")
        if self.group is not None and topic.name != self.group:
            return
        if self.wanted is None:
            paths = [path for path, size in topic.fields.items() if size <= NOT_LISTED] if self.group else []
        elif self.group is None:
            prefix = f"{topic.name}."
            paths = [text.removeprefix(prefix) for text in self.wanted if text.startswith(prefix)]
        else:
            paths = self.wanted
        for path in dict.fromkeys(paths):
            parts = _parts(path)
            if parts is not None and _found(message, parts) is not None:
                topic.wanted.append((path, parts))
                topic.values.append(array("d"))

    def _number(self, topic: _Topic, path: str, parts: list[str | int], message: Any) -> float:
        value = _found(message, parts)
        if isinstance(value, (bool, int, float)):
            return float(value)
        k, where = len(topic.log) - 1, f"{self.where}: {topic.name}.{path}"
        if value is None:
            raise InputError(where, f"message {k} has no such field or entry", "a number in every message")
        found = f"{len(value)} entries" if isinstance(value, (list, bytes, array)) else f"a {type(value).__name__}"
        hint = f"{path}[0] is the first of them" if isinstance(value, (list, bytes, array)) else None
        raise InputError(where, found, "a number", hint)

    def tree(self) -> Tree:
        tree = Tree(file=self.where)
        for name, topic in sorted(self.topics.items()):
            group = tree.groups[name] = Tree(path=name, file=self.where)
            group.attrs["encoding"] = canonical("" if topic.decode else topic.encoding, name)
            group.attrs["count"] = canonical(len(topic.log), name)
            group.attrs["fields"] = canonical(np.array(_patterns(topic.fields), np.str_), name)
            log = np.array(topic.log, np.int64)
            if len(log) > 1 and np.ptp(log):
                group.attrs["rate"] = canonical(1e9 * (len(log) - 1) / float(np.ptp(log)), name)
            for path, size in topic.fields.items():
                if size <= NOT_LISTED:
                    group.datasets[path] = Dataset(Unread("not read", (len(log),)))
            if topic.values:
                group.put("log", log)
                if topic.stamp is not None:
                    group.put("stamp", np.array(topic.stamp, np.int64))
            for (path, _), values in zip(topic.wanted, topic.values, strict=True):
                group.put(path, np.array(values, np.float64))
        return tree


def _numeric(value: Any, path: str, depth: int) -> Iterator[tuple[str, int]]:
    """Paths of the numbers in a message, each with the length of the longest array on its way; no headers."""
    if isinstance(value, (bool, int, float)):
        yield path, 0
    elif isinstance(value, (list, bytes, array)):
        for k, item in enumerate(value[: NOT_LISTED + 1]):
            for inner, size in _numeric(item, f"{path}[{k}]", depth + 1):
                yield inner, max(len(value), size)
    elif hasattr(value, "__slots__") and depth < DEEPEST:
        for name in value.__slots__:
            inner_path = f"{path}.{name}" if path else name
            if inner_path != "header":
                yield from _numeric(getattr(value, name), inner_path, depth + 1)


def _patterns(fields: dict[str, int]) -> list[str]:
    """``position[0..5]`` for the paths of an array."""
    ends: dict[str, tuple[int, int]] = {}
    for path, size in fields.items():
        name = re.sub(r"\[\d+\]", "[]", path)
        ends[name] = (max(size, ends.get(name, (0, 0))[0]), path.count("["))
    return [
        re.sub(r"\[\]", f"[0..{size - 1}]", name) if size > 1 and count == 1 else name.replace("[]", "[0]")
        for name, (size, count) in ends.items()
    ]


def _parts(path: str) -> list[str | int] | None:
    """``a.b[2]`` as ``["a", "b", 2]``; ``position[elbow]`` as ``["position", "[elbow"]``: an entry by its name."""
    parts: list[str | int] = []
    for text in re.split(r"\.(?![^\[]*\])", path):
        match = PART.fullmatch(text)
        if match is None:
            return None
        parts.append(match[1])
        for index in INDEX.findall(match[2]):
            parts.append(int(index) if index.isdecimal() and len(index) < 10 else f"[{index}")
    return parts


def _found(message: Any, parts: list[str | int]) -> Any:
    """The value at a path, or None. A name in brackets is looked up in the list ``name`` beside the array."""
    value, owner = message, message
    for part in parts:
        if isinstance(part, int) or part.startswith("["):
            names = getattr(owner, "name", None)
            if isinstance(part, str):
                if not isinstance(names, list) or part[1:] not in names:
                    return None
                part = names.index(part[1:])
            if not isinstance(value, (list, bytes, array)) or part >= len(value):
                return None
            value = value[part]
        else:
            if part not in getattr(value, "__slots__", ()):
                return None
            owner, value = value, getattr(value, part)
    return value
