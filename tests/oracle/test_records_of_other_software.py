"""Records as pyarrow, pandas, scipy, h5py (MATLAB 7.3's layout) and mcap's writer leave them; the truth is known."""

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import record_files as rf
import scipy.io

import robustlab as rl
from robustlab.errors import InputError

T = np.arange(101) / 100
U, Q = np.sin(T), np.c_[T, 2 * T]


def read(path, *args, **kwargs):
    return rl.Record.read(path, *args, isolate=False, **kwargs)


# --- Parquet ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("isolate", [True, False])
@pytest.mark.parametrize("codec", ["zstd", "snappy", "none"])
def test_parquet_of_pyarrow(tmp_path, isolate, codec):
    unit = pa.field("torque", pa.float32(), metadata={"unit": "N m", "meaning": "shaft"})
    fields = [pa.field("t", pa.float64()), unit, pa.field("phi [deg]", pa.int16()), pa.field("note", pa.string())]
    columns = [T, U.astype(np.float32), np.arange(101, dtype=np.int16), ["x"] * 101]
    pq.write_table(pa.table(columns, pa.schema(fields)), tmp_path / "r.parquet", compression=codec, row_group_size=7)
    record = rl.Record.read(tmp_path / "r.parquet", None, ["torque"], ["phi"], units={"phi": "deg"}, isolate=isolate)
    np.testing.assert_array_equal(record.t, T)
    np.testing.assert_array_equal(record["torque"], U.astype(np.float32))
    np.testing.assert_allclose(record["phi"], np.radians(np.arange(101)), rtol=1e-15)
    assert (record.units, record.meaning) == ({"torque": "N m", "phi": "rad"}, {"torque": "shaft"})
    assert record.name == "r"


@pytest.mark.parametrize("unit", ["ms", "us", "ns"])
@pytest.mark.parametrize("zone", [None, "Europe/Zurich"])
def test_parquet_of_pandas_with_dates(tmp_path, unit, zone):
    index = pd.date_range("2026-01-01", periods=101, freq="10ms", tz=zone, unit=unit)
    pd.DataFrame({"q": Q[:, 1]}, index=index).to_parquet(tmp_path / "r.parquet")
    record = read(tmp_path / "r.parquet")
    np.testing.assert_array_equal(record.t, T)
    first = index[0].value // {"ms": 10**6, "us": 10**3, "ns": 1}[unit]
    assert record.meaning["t"] == f"t counts from __index_level_0__ = {first} {unit} on"


def test_parquet_of_pandas_with_durations_and_a_table_that_a_record_was(tmp_path):
    pd.DataFrame({"q": U}, index=pd.to_timedelta(10 * np.arange(101), unit="ms")).to_parquet(tmp_path / "d.parquet")
    np.testing.assert_array_equal(read(tmp_path / "d.parquet").t, T)
    made = rl.Record(T, {"u": U}, {"q": Q[:, 0]}, {"u": "V", "q": "m"}, "bench", {"q": "cart", "t": "odd"})
    made.to_pandas().to_parquet(tmp_path / "r.parquet")
    back = read(tmp_path / "r.parquet")
    assert (list(back.inputs), list(back.outputs), back.name) == (["u"], ["q"], "bench")
    assert (back.units, back.meaning) == (made.units, made.meaning)
    np.testing.assert_array_equal(back["q"], Q[:, 0])


def test_stamps_in_nanoseconds_keep_their_digits(tmp_path):
    stamps = rf.T0 + 1_000_001 * np.arange(101)
    pq.write_table(pa.table({"timestamp": stamps, "q": U}), tmp_path / "r.parquet")
    record = read(tmp_path / "r.parquet", units={"timestamp": "ns"})
    np.testing.assert_array_equal(record.t, 1_000_001 * np.arange(101) / 1e9)
    with pytest.raises(InputError, match=r"no unit, expected times in s\nhint: units=\{.timestamp.: .ns.\}"):
        read(tmp_path / "r.parquet")


def test_a_sample_time_given_is_compared_with_the_clock(tmp_path):
    pq.write_table(pa.table({"t": T * (1 + 50e-6), "q": U}), tmp_path / "r.parquet")
    record = read(tmp_path / "r.parquet", dt=0.01)
    np.testing.assert_array_equal(record.t, 0.01 * np.arange(101))
    assert record.meaning["t"] == "dt = 0.01 s as given; t has steps of 0.0100005 s (+50 ppm)"


# --- MATLAB, Simulink ------------------------------------------------------------------------------------------------


def simulink():
    """simout as "Structure with time", two signals; a timeseries and a slower log as plain structs."""
    return {
        "simout": {
            "time": T[:, None],
            "signals": [{"values": U[:, None], "label": "u"}, {"values": Q, "label": "q"}],
            "blockName": "axis/To Workspace",
        },
        "speed": {"Time": T[::2][:, None], "Data": 3 * T[::2][:, None], "Name": "speed", "Units": "m/s"},
        "cube": {"time": T[:, None], "values": Q.T.reshape(1, 2, -1)},
    }


def version5(path, variables):
    """The same through scipy: lists are struct arrays."""

    def struct(value):
        if isinstance(value, dict):
            return {key: struct(item) for key, item in value.items()}
        if isinstance(value, list):
            array = np.empty((1, len(value)), dtype=[(key, object) for key in value[0]])
            for k, item in enumerate(value):
                array[0, k] = tuple(item.values())
            return array
        return value

    scipy.io.savemat(path, struct(variables), do_compression=True)
    return path


@pytest.mark.parametrize("write", [version5, rf.matlab73])
@pytest.mark.parametrize("isolate", [True, False])
def test_logs_of_simulink(tmp_path, write, isolate):
    path = write(tmp_path / "r.mat", {k: v for k, v in simulink().items() if k != "cube" or write is version5})
    record = rl.Record.read(path, "simout", ["u"], isolate=isolate)
    assert (list(record.inputs), list(record.outputs), record.meaning) == (["u"], ["q(1)", "q(2)"], {})
    np.testing.assert_array_equal(record.t, T)
    np.testing.assert_array_equal(record["q(2)"], Q[:, 1])
    assert rl.Record.read(path, "speed", isolate=isolate).units == {"speed": "m/s"}
    if write is version5:
        cube = rl.Record.read(path, outputs=["cube(1)", "b=cube(2)"], isolate=isolate)
        np.testing.assert_array_equal(cube["b"], Q[:, 1])


@pytest.mark.parametrize("write", [version5, rf.matlab73])
def test_logs_of_two_rates_on_one_clock(tmp_path, write):
    path = write(tmp_path / "r.mat", {key: simulink()[key] for key in ("simout", "speed")})
    record = read(path, inputs=["u=simout.u"], outputs=["v=speed"])
    np.testing.assert_array_equal(record.t, T[::2])
    np.testing.assert_array_equal(record["u"], U[::2])
    assert record.unit("v") == "m/s"
    assert record.meaning["t"].splitlines()[0] == "2 clocks brought on one of 50 Hz (that of speed.Time), 0 s to 1 s"
    fine = read(path, inputs=["simout.u"], outputs=["speed"], dt=0.005)
    np.testing.assert_allclose(fine["speed"], 3 * fine.t, atol=1e-12)
    np.testing.assert_array_equal(fine["simout.u"], U[(np.arange(fine.n) + 0.5).astype(int) // 2])
    assert (
        "speed.Time: 51 samples at 50 Hz; outputs interpolated at 74.6 % of the samples, over 0.02 s at"
        in (fine.meaning["t"])
    )
    with pytest.raises(InputError, match=r"missing /simout.v .*expected one of simout.u, simout.q"):
        read(path, outputs=["simout.v"])


def test_logs_on_equal_clocks_are_not_touched(tmp_path):
    logs = {"a": {"time": T[:, None], "values": U[:, None]}, "b": {"time": T[:, None], "values": Q[:, :1]}}
    record = read(version5(tmp_path / "r.mat", {"out": logs}))
    assert (list(record.outputs), record.meaning) == (["out.a", "out.b"], {})
    np.testing.assert_array_equal(record["out.b"], Q[:, 0])


@pytest.mark.parametrize("kind", ["timetable", "timeseries", "Simulink.SimulationData.Dataset"])
def test_objects_of_matlab_are_refused_with_the_line_that_converts_them(tmp_path, kind):
    for path in (rf.matlab5_object(tmp_path / "5.mat", "run7", kind), rf.matlab73(tmp_path / "7.mat", {})):
        if path.name == "7.mat":
            import h5py

            with h5py.File(path, "a") as file:
                file["run7"] = np.array([[0xDD000000, 2, 1, 1, 1, 1]], np.uint32)
                file["run7"].attrs["MATLAB_class"] = np.bytes_(kind)
        with pytest.raises(InputError, match=f"/run7: a {kind}, which MATLAB keeps .*\nhint: .*run7.*save\\('run"):
            read(path)


def test_flat_variables_come_before_logs_and_what_a_timetable_becomes(tmp_path):
    """The line for timetables leaves ``Time`` and a variable for each column."""
    scipy.io.savemat(
        tmp_path / "r.mat", {"Time": T[:, None], "q": U[:, None], **simulink(), "bad": {"t": T, "data": U[:5]}}
    )
    record = read(tmp_path / "r.mat", inputs=["q"], outputs=None)
    assert (list(record.inputs), list(record.outputs)) == (["q"], [])
    assert list(read(tmp_path / "r.mat").outputs) == ["q"]
    assert read(tmp_path / "r.mat", outputs=["speed"]).n == 51
    with pytest.raises(InputError, match=r"bad.t has 101 samples, the signals 5, expected equal lengths"):
        read(tmp_path / "r.mat", outputs=["bad"])


# --- ROS 2 -----------------------------------------------------------------------------------------------------------


def drive(n=400, ppm=80.0, seed=0):
    """Joints at 100 Hz, their stamps running fast by so much, logged 1 to 2 ms late; a command at 250 Hz."""
    rng = np.random.default_rng(seed)
    events = []
    for k in range(n):
        true = 10_000_000 * k
        stamp = rf.T0 + round(true * (1 + 1e-6 * ppm))
        events.append(("/joints", "joints", rf.T0 + true + int(rng.uniform(1e6, 2e6)), rf.joints(stamp, [k, -k])))
    for k in range(5 * n // 2):
        events.append(("/command", "number", rf.T0 + 4_000_000 * k + 500_000, {"data": float(k)}))
    return sorted(events, key=lambda event: event[2])


@pytest.mark.parametrize("isolate", [True, False])
def test_a_topic_of_a_bag(tmp_path, isolate):
    path = rf.bag(tmp_path / "r.mcap", drive())
    record = rl.Record.read(path, "/joints", isolate=isolate)
    assert list(record.outputs) == ["position[0]", "position[1]"]
    np.testing.assert_allclose(record.t, 0.01 * np.arange(400) * (1 + 80e-6), atol=1e-9)
    np.testing.assert_array_equal(record["position[1]"], -np.arange(400))
    first, second = record.meaning["t"].splitlines()
    assert first == f"times are those of the message stamps, from {rf.T0} ns on"
    said = float(second.partition("drift ")[2].partition(" ppm")[0])
    sure = float(second.partition("± ")[2].partition(")")[0])
    assert abs(said - 80) < 1.5 * sure < 60
    assert rl.Record.read(path, "/joints", clock="log", isolate=isolate).t[1] == pytest.approx(0.01, abs=1e-3)


@pytest.mark.parametrize("options", [{}, {"use_chunking": False}])
def test_two_topics_of_a_bag(tmp_path, options):
    from mcap.writer import CompressionType

    compressed = options or {"compression": CompressionType.LZ4}
    path = rf.bag(tmp_path / "r.mcap", drive(), **compressed)
    record = read(path, inputs=["u=/command.data"], outputs=["q=/joints.position[b]"])
    lines = record.meaning["t"].splitlines()
    assert lines[0].startswith("times are those of the log (/command has no stamps), from 17000000000005")
    assert lines[2].startswith("2 clocks brought on one of 100 Hz (that of /joints)") or "(that of /joints)" in lines[2]
    assert "outputs interpolated at 9" in lines[3]
    assert "jitter 0.0004" in lines[3]
    assert lines[4].startswith("/command: 1000 samples at 250 Hz; inputs held")
    assert "2.5 to 1, without a filter" in lines[4]
    true = record.t + 500_000e-9  # times count from the first command
    assert np.abs(record["q"] + (true - 1.5e-3) / 0.01).max() < 0.11  # late by 1 to 2 ms, at 100 a second
    held = np.floor(record.t / 0.004 + 1e-6)
    np.testing.assert_array_equal(record["u"], held)


def test_joints_by_name_whatever_their_order(tmp_path):
    events = [
        ("/j", "joints", rf.T0 + k * 10**7, rf.joints(rf.T0 + k * 10**7, x, names))
        for k, (x, names) in enumerate([((1, 2), "ab"), ((2, 1), "ba"), ((1, 2), "ab")])
    ]
    record = read(rf.bag(tmp_path / "r.mcap", events), outputs=["/j.position[a]", "/j.position[0]"])
    assert record["/j.position[a]"].tolist() == [1, 1, 1]
    assert record["/j.position[0]"].tolist() == [1, 2, 1]


def test_fields_in_fields(tmp_path):
    events = [
        ("/w", "wrench", rf.T0 + k * 10**6, {"force": {"x": k, "y": 0.5}, "valid": k > 1, "note": "n"})
        for k in range(4)
    ]
    record = read(rf.bag(tmp_path / "r.mcap", events), "/w", ["force.x"])
    assert list(record.outputs) == ["force.y", "valid"]
    assert record["valid"].tolist() == [0, 0, 1, 1]
    assert record.dt == pytest.approx(1e-3)


def test_what_a_bag_holds_is_said(tmp_path):
    path = rf.bag(tmp_path / "r.mcap", drive())
    listing = r"numeric fields of /command \(250 Hz\): data; /joints \(100 Hz\): position\[0\.\.1\]"
    with pytest.raises(InputError, match=f"no signals chosen, expected {listing}"):
        read(path)
    with pytest.raises(InputError, match=rf"missing /joints.positoin\[0\] \(did you mean .*\), expected {listing}"):
        read(path, outputs=["/joints.positoin[0]"])
    with pytest.raises(InputError, match=f"no outputs chosen, expected {listing}"):
        read(path, inputs=["/command.data"])
    with pytest.raises(InputError, match=r"missing topic /joint, .*\nhint: did you mean /joints"):
        read(path, "/joint")
