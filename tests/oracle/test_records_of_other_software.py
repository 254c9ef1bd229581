"""Records as scipy and h5py (MATLAB 7.3's layout) leave them; the truth is known."""

import numpy as np
import pytest
import record_files as rf
import scipy.io

import robustlab as rl
from robustlab.errors import InputError

T = np.arange(101) / 100
U, Q = np.sin(T), np.c_[T, 2 * T]


def read(path, *args, **kwargs):
    return rl.Record.read(path, *args, isolate=False, **kwargs)


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


@pytest.mark.parametrize("isolate", [True, False])
def test_logs_of_simulink(tmp_path, isolate):
    path = version5(tmp_path / "r.mat", simulink())
    record = rl.Record.read(path, "simout", ["u"], isolate=isolate)
    assert (list(record.inputs), list(record.outputs), record.meaning) == (["u"], ["q(1)", "q(2)"], {})
    np.testing.assert_array_equal(record.t, T)
    np.testing.assert_array_equal(record["q(2)"], Q[:, 1])
    assert rl.Record.read(path, "speed", isolate=isolate).units == {"speed": "m/s"}
    cube = rl.Record.read(path, outputs=["cube(1)", "b=cube(2)"], isolate=isolate)
    np.testing.assert_array_equal(cube["b"], Q[:, 1])


def test_a_struct_of_several_elements_in_version_73_names_the_way_round(tmp_path):
    path = rf.matlab73(tmp_path / "r.mat", {"simout": simulink()["simout"]})
    with pytest.raises(InputError, match=r"signal1: dtype reference, .*\nhint: .*-v7"):
        read(path, "simout")


def test_logs_of_two_rates_on_one_clock(tmp_path):
    path = version5(tmp_path / "r.mat", {key: simulink()[key] for key in ("simout", "speed")})
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
