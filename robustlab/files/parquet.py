"""Parquet files as trees: a dataset for each column, with its unit; columns nobody asked for stay `Unread`.

Runs in a child process; see `robustlab.files.isolation`. Sizes are looked at in the file's footer before a column is
read, and columns are read in pieces.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
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

    Raises
    ------
    InputError
        A truncated or damaged file, columns of one name, more than the limits.
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
    chosen = [(f, name) for f, (name, _) in columns if _numeric(f.type) and (wanted is None or name in also)]
    declared = 8 * rows
    for part, limit in ((declared, limits.dataset), (declared * len(chosen), limits.total)):
        if part > limit:
            found = f"{rows} rows in {len(chosen)} columns take {size_text(part)} in memory"
            raise InputError(where, found, f"at most {size_text(limit)}", "choose columns with inputs= and outputs=")
    allow(declared * len(chosen))
    for f, (name, _) in columns:
        tree.datasets[name].values = Unread("not read" if _numeric(f.type) else str(f.type)[:60], (rows,))
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


def _numeric(kind: Any) -> bool:
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
