"""Records that are cut short, hostile, or no records: one line, and exit code 3."""

import sys
import tracemalloc

import h5py
import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import record_files as rf
import scipy.io
import xarray as xr
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

import robustlab as rl
from robustlab.errors import DependencyMissing, InputError
from robustlab.files.signature import MIB, Limits

T = np.arange(21) / 10
JUMP = np.where(np.arange(21) == 7, 0.0, T)


def read(path, *args, **kwargs):
    return rl.Record.read(path, *args, isolate=False, **kwargs)


def refused(match, path, *args, **kwargs):
    with pytest.raises(InputError, match=match) as caught:
        read(path, *args, **kwargs)
    assert caught.value.exit_code == 3
    assert "\n" not in str(caught.value).partition("\nhint:")[0]


NESTED = pa.array([{"x": 1.0}] * 21)
TABLES = [
    ({"t": T, "q": ["a"] * 21}, r"q: dtype string, expected a column of real numbers"),
    ({"t": T, "q": NESTED}, r"q: dtype struct<x: double>, expected a column"),
    ({"t": T, "q": [[1.0, 2.0]] * 21}, r"q: dtype list<.*>, expected a column"),
    ({"t": T, "q": np.where(T == 1, np.nan, T)}, r"q\[10\]: is NaN|q\[10\].* NaN"),
    ({"t": T, "q": [None, *T[1:]]}, r"q\[0\]: no value \(null\)"),
    ({"t": JUMP, "q": T}, r"t\[7\] = 0 s runs backwards"),
    ({"t": np.delete(np.arange(22) / 10, 5), "q": T}, r"t: 1 samples missing between t\[4\]"),
    ({"v": T, "q": T}, r"no clock and no sample time, expected a column t, or one of v, q"),
    ({"t": 1e15 + T, "q": T}, r"no unit, expected times in s"),
    ({"t": np.array([], float), "q": np.array([], float)}, "no rows"),
    ({"t": T[:1], "q": T[:1]}, "1 samples, expected at least 2"),
    ({"t": T, "q [m]": T, "q [mm]": T}, "column name 'q' is used twice"),
    ({"t": T, "x" * 300: T}, "a column name of 300 characters"),
    ({"t": T, "q": T.astype(str)}, "dtype string"),
    ({"t": T, "q": np.full(21, 2**63, np.uint64)}, "a whole number beyond 64 bits"),
    ({"t": T, "q": pa.array([b"x"] * 21)}, "dtype binary"),
]


@pytest.mark.parametrize(("columns", "match"), TABLES)
def test_tables(tmp_path, columns, match):
    pq.write_table(pa.table(columns), tmp_path / "r.parquet")
    refused(match, tmp_path / "r.parquet")


def test_columns_of_one_name(tmp_path):
    pq.write_table(pa.table([T, T, T], names=["t", "q", "q"]), tmp_path / "r.parquet")
    refused("column name 'q' is used twice", tmp_path / "r.parquet")


def test_a_group_of_a_table_and_names_that_are_not_there(tmp_path):
    pq.write_table(pa.table({"t": T, "speed": T}), tmp_path / "r.parquet")
    refused("group 'a' of a Parquet file, expected no group", tmp_path / "r.parquet", "a")
    refused(
        r"missing sped \(did you mean speed\?\), expected one of t, speed", tmp_path / "r.parquet", outputs=["sped"]
    )


@pytest.mark.parametrize("name", ["r.parquet", "r.mcap"])
@pytest.mark.parametrize("isolate", [True, False])
def test_cut_short(tmp_path, name, isolate):
    path = tmp_path / name
    if name == "r.mcap":
        rf.bag(path, [("/c", "number", rf.T0 + k, {"data": 0.5}) for k in range(300)], chunk_size=1000)
    else:
        pq.write_table(pa.table({"t": T, "q": T}), path)
    whole = path.read_bytes()
    for size in (9, len(whole) // 2, len(whole) - 3):
        path.write_bytes(whole[:size])
        with pytest.raises(InputError, match=r"truncated|damaged"):
            rl.Record.read(path, None, [], ["/c.data"] if name == "r.mcap" else ["q"], isolate=isolate)
    path.write_bytes(b"")
    refused(r"empty file \(0 bytes\)", path)
    path.write_bytes(b"hello, hello, hello")
    refused(r"not an? (MCAP|Parquet) file \(first bytes 68 65 6c 6c\)", path)


SMALL = rf.T0 + 10**7


@pytest.fixture(scope="module")
def spoilt(tmp_path_factory):
    """A small file of each kind, and how it is read."""
    folder = tmp_path_factory.mktemp("spoilt")
    pq.write_table(pa.table({"t": T, "q": T}), folder / "r.parquet")
    rf.bag(folder / "r.mcap", [("/j", "joints", rf.T0 + k * 10**7, rf.joints(rf.T0 + k, [k])) for k in range(9)])
    log = {"time": T[:, None], "signals": [{"values": T[:, None], "label": "u"}, {"values": T[:, None], "label": "q"}]}
    rf.matlab73(folder / "r.mat", {"log": log})
    names = {"r.parquet": ["q"], "r.mcap": ["/j.position[0]"], "r.mat": ["log.q"]}
    return [(folder / name, outputs) for name, outputs in names.items()]


@settings(max_examples=120, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(which=st.integers(0, 1), place=st.floats(0, 1), byte=st.integers(0, 255), cut=st.booleans())
@example(which=0, place=0.99, byte=255, cut=False)
@example(which=1, place=95.5 / 1459, byte=255, cut=False)  # a length beyond all memory
def test_spoilt_bytes_end_in_one_line_or_in_a_record(spoilt, which, place, byte, cut):
    path, outputs = spoilt[which]
    whole = path.read_bytes()
    k = min(int(place * len(whole)), len(whole) - 1)
    damaged = whole[:k] if cut else whole[:k] + bytes([byte]) + whole[k + 1 :]
    target = path.with_name(f"x{path.suffix}")
    target.write_bytes(damaged or b"x")
    try:
        found = read(target, None, [], outputs)
    except InputError as error:
        assert "\n" not in str(error).partition("\nhint:")[0]
    else:
        assert found.n >= 2


# --- sizes -----------------------------------------------------------------------------------------------------------


def test_ten_million_rows_stay_within_the_memory(tmp_path):
    n = 10**7
    pq.write_table(
        pa.table({"t": np.arange(n) * 1e-4, "q": np.zeros(n, np.int8), "z": np.zeros(n)}), tmp_path / "r.parquet"
    )
    tracemalloc.start()
    try:
        record = rl.Record.read(tmp_path / "r.parquet", outputs=["q"])
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert record.n == n
    assert peak < 12 * 8 * n  # the answer of the reader twice, the record, and what checks it
    refused(
        r"10000000 rows in 3 columns take 240 MB in memory, expected at most 200 MiB", tmp_path / "r.parquet",
        limits=Limits(total=200 * MIB),
    )  # fmt: skip


def test_a_small_table_that_grows(tmp_path):
    pq.write_table(pa.table({"t": np.zeros(40 * MIB)}), tmp_path / "r.parquet", compression="zstd")
    assert (tmp_path / "r.parquet").stat().st_size < MIB
    refused("41943040 rows in 1 columns take 320 MiB in memory, expected at most 256 MiB", tmp_path / "r.parquet")


def test_a_chunk_that_grows(tmp_path):
    text = "x" * 400_000
    message = {"force": {"x": 0.0, "y": 0.0}, "valid": True, "note": text}
    rf.bag(tmp_path / "r.mcap", [("/w", "wrench", rf.T0 + k, message) for k in range(9)], chunk_size=4 * MIB)
    assert (tmp_path / "r.mcap").stat().st_size < MIB // 8
    limits = Limits(dataset=MIB)
    refused(r"a chunk declares 3\.\d+ MB, limit 1 MiB", tmp_path / "r.mcap", "/w", limits=limits)
    assert read(tmp_path / "r.mcap", "/w").n == 9
    refused(
        "the fields asked for take more, expected at most 100 bytes",
        tmp_path / "r.mcap",
        "/w",
        limits=Limits(total=100),
    )


def test_structs_that_lead_in_circles(tmp_path):
    """Elements of a struct array that refer to the struct array itself."""
    path = rf.matlab73(tmp_path / "r.mat", {"log": [{"a": np.zeros((2, 1))}] * 3})
    with h5py.File(path, "a") as file:
        refs = file["#refs#"]
        inner = refs.create_group("loop")
        inner.attrs["MATLAB_class"] = np.bytes_("struct")
        for name in "ab":
            inner.create_dataset(name, data=np.array([[inner.ref] * 8], dtype=object), dtype=h5py.ref_dtype)
        file["log/a"][...] = np.array([[inner.ref]] * 3, dtype=object)
    refused("more than 10000 structs, or nested too deep", path)


def test_logs_that_do_not_fit_their_times(tmp_path):
    scipy.io.savemat(tmp_path / "r.mat", {"a": {"time": T[:, None], "values": T[:-1, None]}})
    refused(r"r\.mat: a\.time has 21 samples, the signals 20, expected equal lengths", tmp_path / "r.mat")
    scipy.io.savemat(tmp_path / "c.mat", {"a": {"time": T, "values": T}, "b": {"time": T + 5, "values": T}})
    refused("the clocks run from 0 s to 2 s and 5 s to 7 s, expected times that overlap", tmp_path / "c.mat")
    scipy.io.savemat(tmp_path / "d.mat", {"a": {"time": JUMP, "values": T}, "b": {"time": T / 2, "values": T}})
    refused(r"a\.time\[7\]: 0 s runs backwards, expected strictly increasing times", tmp_path / "d.mat")
    scipy.io.savemat(tmp_path / "e.mat", {"a": {"time": np.zeros((0, 0)), "values": T[:, None]}})
    refused("no clock and no sample time", tmp_path / "e.mat")
    assert read(tmp_path / "e.mat", dt=0.5).dt == 0.5


# --- bags ------------------------------------------------------------------------------------------------------------


def test_bags(tmp_path):
    path = tmp_path / "r.mcap"
    rf.bag(path, [("/j", "joints", rf.T0 + k, rf.joints(rf.T0 + k, [1.0] * (2 - k))) for k in range(3)])
    refused(r"/j\.position\[1\]: message 1 has no such field or entry", path, outputs=["/j.position[1]"])
    refused(r"/j\.position: 2 entries, expected a number\nhint: position\[0\]", path, outputs=["/j.position"])
    refused(r"/j\.header: a Header, expected a number", path, outputs=["/j.header"])
    refused("clock 'gps', expected stamp or log", path, outputs=["/j.position[0]"], clock="gps")
    back = [("/j", "joints", rf.T0 + k * 10**7, rf.joints(rf.T0 - k * 10**7, [1.0])) for k in range(4)]
    rf.bag(path, back)
    assert "(the stamps of /j stand still or run backwards at message 1)" in read(path, "/j").meaning["t"]
    refused("stand still or run backwards at message 1, expected stamps that run", path, "/j", clock="stamp")
    rf.bag(path, [("/c", "number", rf.T0, {"data": 1.0})] * 3)
    refused(r"t\[1\] = 0 s repeats the stamp before it", path, "/c")
    rf.bag(path, [("/c", "number", rf.T0, {"data": 1.0})])
    refused("1 samples", path, "/c")
    rf.bag(path, [])
    refused("no signals chosen, expected a bag with numeric fields", path)


def test_a_topic_of_another_encoding(tmp_path):
    from mcap.writer import Writer

    with (tmp_path / "r.mcap").open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        schema = writer.register_schema("Pose", "jsonschema", b"{}")
        channel = writer.register_channel("/pose", "json", schema)
        writer.add_message(channel, rf.T0, b"{}", rf.T0)
        writer.finish()
    refused("/pose: messages in json with jsonschema schema, expected cdr", tmp_path / "r.mcap", outputs=["/pose.x"])


def test_a_bag_in_sqlite(tmp_path):
    (tmp_path / "r.db3").write_bytes(b"SQLite format 3\x00" + bytes(100))
    refused("an SQLite database, .*\nhint: ros2 bag convert", tmp_path / "r.db3")


@pytest.mark.parametrize(("name", "package", "extra"), [("r.parquet", "pyarrow", "parquet"), ("r.mcap", "mcap", "ros")])
def test_a_package_that_is_missing(tmp_path, monkeypatch, name, package, extra):
    magic = {"r.parquet": b"PAR1", "r.mcap": b"\x89MCAP0\r\n"}[name]
    (tmp_path / name).write_bytes(magic + bytes(20))
    monkeypatch.setattr("importlib.util.find_spec", lambda asked, *_: None if asked == package else sys.modules)
    with pytest.raises(
        DependencyMissing, match=rf"needs the package {package}\nhint: pip install 'robustlab\[{extra}\]'"
    ):
        read(tmp_path / name, outputs=["q"])


# --- tables in memory ------------------------------------------------------------------------------------------------

FRAMES = [
    (pd.DataFrame({"q": T}), "rows are numbered, and no column is a clock"),
    (pd.DataFrame({"q": ["a"] * 21}, index=T), "q: dtype (str|object), expected a column"),
    (pd.DataFrame({"q": [T] * 21}, index=T), "q: dtype object, expected a column"),
    (pd.DataFrame({"q": 1j * T}, index=T), "q: dtype complex128"),
    (pd.DataFrame({"q": pd.array([None, *T[1:]], "Float64")}, index=T), r"q\[0\] is NaN|q\[0\].*NaN"),
    (pd.DataFrame(np.c_[T, T], index=T, columns=["q", "q"]), "column name 'q' is used twice"),
    (pd.DataFrame(np.c_[T, T], index=T, columns=[["a", "a"], ["b", "c"]]), "nested columns"),
    (pd.DataFrame({"q": T}, index=JUMP), r"t\[7\] = 0 s runs backwards"),
    (pd.DataFrame({"q": T}, index=pd.DatetimeIndex([pd.NaT] * 21)), "with times that are none"),
    (pd.DataFrame({"q": T}, index=["a"] * 21), "index: dtype (str|object)"),
    (
        pd.DataFrame({"q": T}, index=rf.T0 + np.arange(21)),
        r"index: times of 1.7e\+18 and no unit, .*\nhint: units=\{.index.: .ns.\}",
    ),
    (pd.DataFrame(index=T), "no signals here"),
    (T, "a ndarray, expected a pandas DataFrame"),
]


@pytest.mark.parametrize(("frame", "match"), FRAMES)
def test_frames(frame, match):
    with pytest.raises(InputError, match=match):
        rl.Record.from_pandas(frame)


DATASETS = [
    (xr.Dataset({"q": (("t", "x"), np.zeros((2, 2)))}), r"q over \('t', 'x'\), expected variables over one"),
    (xr.Dataset({"q": ("t", T), "p": ("s", T)}), r"variables over \['s', 't'\]"),
    (xr.Dataset({"q": ("t", T)}), "axis 't' has no coordinate"),
    (xr.Dataset({"q": ("t", T)}, {"t": JUMP}), "runs backwards"),
    (xr.Dataset({"q": ("t", T)}, {"t": ("t", T, {"units": "furlong"})}), "unit 'furlong'"),
    (xr.DataArray(T, {"t": T}, name="q"), "a DataArray, expected an xarray Dataset\nhint: dataset = array.to_dataset"),
]


@pytest.mark.parametrize(("dataset", "match"), DATASETS)
def test_datasets(dataset, match):
    with pytest.raises(InputError, match=match):
        rl.Record.from_xarray(dataset)
