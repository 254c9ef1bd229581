"""Convert tables of pandas to arguments of `robustlab.record.Record`, and back; times in s.

The frame's ``attrs`` hold inputs, outputs, units, meanings and the record's name, so that no information is lost.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from robustlab.arrays import AnyArray
from robustlab.errors import DependencyMissing, InputError
from robustlab.files.records import CLOCK_NAMES, Channel, RecordOptions, Source, choose
from robustlab.files.tree import Unread, canonical

if TYPE_CHECKING:
    import pandas


def need(where: str, package: str, extra: str) -> None:
    """Raise where an optional package is not installed."""
    if importlib.util.find_spec(package) is None:
        raise DependencyMissing(where, f"needs the package {package}", None, f"pip install 'robustlab[{extra}]'")


def frame_of(keywords: Mapping[str, Any]) -> pandas.DataFrame:
    """Return a data frame with index ``t`` in s; see `robustlab.record.Record.to_pandas`."""
    need("Record.to_pandas", "pandas", "frames")
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
    need(where, "pandas", "frames")
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
    for side in ("inputs", "outputs"):
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
    # Gaps are allowed; `check_record` reports them.
    return choose(source, RecordOptions(None, inputs, outputs, units=units, allow_gaps=True))


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
