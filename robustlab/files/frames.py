"""Tables of pandas and xarray as the arguments of `robustlab.record.Record`, and back; times in s, units in ``attrs``.

A frame or data set that a record was made into says in its ``attrs`` which columns are inputs and which are outputs,
their units and meanings, and the record's name; so the record comes back as it was.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from robustlab.arrays import AnyArray
from robustlab.errors import InputError
from robustlab.files.record_source import CLOCK_NAMES, Channel, Source, need
from robustlab.files.records import RecordOptions, choose
from robustlab.files.tree import Unread, canonical, table_of

if TYPE_CHECKING:
    import pandas
    import xarray

INDEX = "index"  # what messages call a row index without a name
# A frame from memory may have holes, as a record may; `check_record` tells of them.
_ANY_CLOCK = True


def frame_of(keywords: Mapping[str, Any]) -> pandas.DataFrame:
    """A data frame with index ``t`` in s; see `robustlab.record.Record.to_pandas`."""
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


def dataset_of(keywords: Mapping[str, Any]) -> xarray.Dataset:
    """A data set over ``t`` in s; see `robustlab.record.Record.to_xarray`."""
    need("Record.to_xarray", "xarray", "frames")
    import xarray

    def attrs(name: str, side: str) -> dict[str, str]:
        told = {"units": keywords["units"].get(name, ""), "meaning": keywords["meaning"].get(name, ""), "side": side}
        return {key: text for key, text in told.items() if text}

    if "t" in (*keywords["inputs"], *keywords["outputs"]):
        raise InputError("Record.to_xarray", "a signal called t", "another name: t is the coordinate")
    variables = {
        name: ("t", values, attrs(name, side))
        for side, group in (("input", keywords["inputs"]), ("output", keywords["outputs"]))
        for name, values in group.items()
    }
    clock = {"units": "s", **({"meaning": keywords["meaning"]["t"]} if "t" in keywords["meaning"] else {})}
    return xarray.Dataset(variables, {"t": ("t", keywords["t"], clock)}, {"name": keywords["name"]})


def keywords_of_frame(
    frame: Any, inputs: Sequence[str] | None, outputs: Sequence[str] | None, units: Mapping[str, str] | None
) -> dict[str, Any]:
    """Inverse of `frame_of`; see `robustlab.record.Record.from_pandas`."""
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
    told = {key: value for key, value in frame.attrs.items() if isinstance(key, str)}
    stated, meaning = (table_of(told, key) for key in ("units", "meaning"))
    source = Source(where, str(told.get("name", "frame")), "", {})
    for k, name in enumerate(names):
        values, unit = _values(frame.iloc[:, k])
        source.channels[name] = Channel(values, unit or str(stated.get(name, "")), str(meaning.get(name, "")))
    for side in ("inputs", "outputs"):
        given = told.get(side)
        getattr(source, side).extend([n for n in given if n in names] if isinstance(given, list) else [])
    if "t" in meaning:
        source.notes += str(meaning["t"]).splitlines()
    if not isinstance(frame.index, pandas.RangeIndex):
        (values, unit), name = _values(frame.index), str(frame.index.name or INDEX)
        _index_is_clock(source, name, values, unit or str(stated.get(name, "")))
    elif not any(name in names for name in CLOCK_NAMES):
        hint = "frame.index = dt * numpy.arange(len(frame)), or a column t"
        raise InputError(where, "rows are numbered, and no column is a clock", "an index of times in s", hint)
    return choose(source, RecordOptions(None, inputs, outputs, units=units, allow_gaps=_ANY_CLOCK))


def keywords_of_dataset(
    dataset: Any, inputs: Sequence[str] | None, outputs: Sequence[str] | None, units: Mapping[str, str] | None
) -> dict[str, Any]:
    """Inverse of `dataset_of`; see `robustlab.record.Record.from_xarray`."""
    where = "Record.from_xarray"
    need(where, "xarray", "frames")
    import xarray

    if not isinstance(dataset, xarray.Dataset):
        hint = "dataset = array.to_dataset(name='q')" if isinstance(dataset, xarray.DataArray) else None
        raise InputError(where, f"a {type(dataset).__name__}", "an xarray Dataset", hint)
    wide = {str(name): item.dims for name, item in dataset.data_vars.items() if len(item.dims) != 1}
    axes = {item.dims[0] for item in dataset.data_vars.values() if len(item.dims) == 1}
    if wide or len(axes) != 1:
        text = (
            "; ".join(f"{name} over {dims}" for name, dims in wide.items())
            or f"variables over {sorted(map(str, axes))}"
        )
        raise InputError(where, text, "variables over one and the same axis, that of time")
    axis = next(iter(axes))
    if axis not in dataset.coords:
        raise InputError(where, f"axis {axis!r} has no coordinate", "times in s")
    source = Source(where, str(dataset.attrs.get("name", "dataset")), "", {})
    for name, item in dataset.data_vars.items():
        values, unit = _values(item)
        attrs = item.attrs
        source.channels[str(name)] = Channel(values, unit or str(attrs.get("units", "")), str(attrs.get("meaning", "")))
        side = {"input": source.inputs, "output": source.outputs}.get(str(attrs.get("side", "")))
        if side is not None:
            side.append(str(name))
    clock = dataset.coords[axis]
    source.notes += str(clock.attrs.get("meaning", "")).splitlines()
    values, unit = _values(clock)
    _index_is_clock(source, str(axis), values, unit or str(clock.attrs.get("units", "")))
    return choose(source, RecordOptions(None, inputs, outputs, units=units, allow_gaps=_ANY_CLOCK))


def _index_is_clock(source: Source, name: str, values: AnyArray | Unread, unit: str) -> None:
    """Add the index as a channel of its own name, which no column has, and make it the clock."""
    while name in source.channels:
        name += "'"
    source.channels[name], source.clock = Channel(values, unit), name


def _values(column: Any) -> tuple[AnyArray | Unread, str]:
    """Numbers as they are; dates and durations as whole numbers with their unit; all else `Unread`."""
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
