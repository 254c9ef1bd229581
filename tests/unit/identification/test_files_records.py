"""Reading records: which clock, which signals, which units; and row 36 of the fault table."""

from pathlib import Path

import h5py
import numpy as np
import pytest

import robustlab as rl
from robustlab.errors import InputError
from robustlab.identification import check_record

SHARED = Path(__file__).parents[4] / "shared" / "data"


def read(path, *args, **kwargs):
    return rl.Record.read(path, *args, isolate=False, **kwargs)


@pytest.fixture
def measured(tmp_path):
    with h5py.File(tmp_path / "m.h5", "w") as file:
        file.attrs["Ts"] = 0.5
        run = file.create_group("run")
        run["u"] = np.arange(6, dtype=np.float32)
        run["u"].attrs.update(unit="V", meaning="drive")
        run["q"] = np.arange(6)[:, None]
        run["slow"] = np.arange(3.0)
        run["slow"].attrs["Ts"] = 1.0
        run["text"] = ["a"] * 6
        run["z"] = np.ones(6) * 1j
        file["loose/u"] = np.arange(4.0)
        file["loose"].attrs["fs"] = 10.0
        file["clocked/time"] = [0.0, 0.1, 0.3]
        file["clocked/y"] = [1.0, 2.0, 3.0]
    return tmp_path / "m.h5"


def test_sample_time_of_signal_group_file_or_caller(measured):
    assert read(measured, "run", ["u"], ["q"]).dt == 0.5
    assert read(measured, "run", [], ["slow"]).dt == 1.0
    assert read(measured, "loose").dt == pytest.approx(0.1)
    assert read(measured, "run", ["u"], ["q"], dt=0.25).dt == 0.25
    np.testing.assert_array_equal(read(measured, "clocked").t, [0.0, 0.1, 0.3])
    np.testing.assert_array_equal(read(measured, "clocked", dt=1.0).t, [0.0, 1.0, 2.0])


def test_names_units_meanings(measured):
    record = read(measured, "run", ["u"], ["q"], units={"q": "m"})
    assert (record.units, record.meaning, record.name) == ({"u": "V", "q": "m"}, {"u": "drive"}, "m/run")
    assert record["q"].shape == (6,)


REFUSED = [
    ({"group": "rum"}, "missing group /rum.*\nhint: did you mean run"),
    ({"group": "run", "outputs": ["p", "Q"]}, r"missing /run/p.*\n.*missing /run/Q"),
    (
        {"group": "run", "outputs": ["q", "slow"]},
        r"/run/slow has 3 samples \(its own sample time is 1 s\), expected 6 as /run/q",
    ),
    ({"group": "run", "outputs": ["text"]}, "/run/text: dtype text, expected a column of real numbers"),
    ({"group": "run", "outputs": ["z"]}, "/run/z: dtype complex128, expected a column of real numbers"),
    ({"group": "clocked", "outputs": ["y"], "clock": "tick"}, "missing /clocked/tick"),
    ({"group": "run", "outputs": ["q"], "units": {"p": "m"}}, "a unit for 'p'"),
    ({"outputs": ["q"]}, r"missing /q, expected signals in the group given; groups are .*\nhint: group="),
]


@pytest.mark.parametrize(("arguments", "pattern"), REFUSED)
def test_refusals(arguments, pattern, measured):
    with pytest.raises(InputError, match=pattern):
        read(measured, **arguments)


def csv(path, t, **channels):
    columns = {"t": t, **channels}
    np.savetxt(path, np.column_stack(list(columns.values())), header=",".join(columns), comments="", delimiter=",")
    return path


T = np.arange(20) * 0.1


def test_row_36_clock_faults(tmp_path):
    t = T.copy()
    t[7] = t[6]
    with pytest.raises(InputError, match=r"t\[7\] = 0\.6 s repeats the stamp before it"):
        read(csv(tmp_path / "a.csv", t, q=T))
    t[7] = 0.2
    with pytest.raises(InputError, match=r"t\[7\] = 0\.2 s runs backwards"):
        read(csv(tmp_path / "b.csv", t, q=T))
    keep = np.r_[0:8, 11:20]
    path = csv(tmp_path / "c.csv", T[keep], q=T[keep])
    with pytest.raises(
        InputError, match=r"t: 3 samples missing between t\[7\] = 0\.7 s and t\[8\] = 1\.1 s \(1 gaps in all\)"
    ):
        read(path)
    assert read(path, allow_gaps=True).n == 17
    with pytest.raises(InputError, match="no clock and no sample time"):
        read(_without_clock(tmp_path / "d.csv"))


def _without_clock(path):
    np.savetxt(path, np.ones((5, 2)), header="a b", comments="")
    return path


def test_row_36_nan_is_reported_with_channel_and_sample(tmp_path):
    q = T.copy()
    q[[4, 9]] = np.nan
    with pytest.raises(InputError, match=r"q\[4\]: is NaN \(2 of 20 samples\)"):
        read(csv(tmp_path / "a.csv", T, q=q))


def test_row_36_constant_and_clipped_channels_are_remarked(tmp_path):
    t = np.arange(400) * 0.01
    wave = np.sin(7 * t)
    record = read(csv(tmp_path / "a.csv", t, u=np.zeros(400), q=np.clip(wave, -2, 0.8), ref=np.sign(wave)))
    remarks = "\n".join(check_record(record).remarks)
    assert "u is constant: 0" in remarks
    assert "q looks clipped" in remarks
    assert "ref looks" not in remarks
    assert "q: no unit stated" in remarks


def test_format_1_record_keeps_sides_and_order(tmp_path):
    record = rl.Record(T, {"z": T, "a": 2 * T}, {"dq/dt": 3 * T, ".hidden": T}, {"z": "V"}, "bench", {"a": "second"})
    rl.save(tmp_path / "r.h5", record)
    back = read(tmp_path / "r.h5")
    assert (list(back.inputs), list(back.outputs)) == (["z", "a"], ["dq/dt", ".hidden"])
    assert (back.units, back.meaning, back.name) == (record.units, record.meaning, "bench")
    part = read(tmp_path / "r.h5", inputs=["a"], outputs=["dq/dt"])
    np.testing.assert_array_equal(part["dq/dt"], 3 * T)
    with pytest.raises(InputError, match="missing /q"):
        read(tmp_path / "r.h5", inputs=["a"], outputs=["q"])
    rl.save(tmp_path / "m.h5", rl.StateSpaceModel([[1.0]], [[1.0]], [[1.0]], [[0.0]]))
    with pytest.raises(InputError, match="holds an object of kind state-space, expected a record"):
        read(tmp_path / "m.h5")


def test_format_1_record_is_checked_too(tmp_path):
    rl.save(tmp_path / "r.h5", rl.Record(T, {"u": T}, {"q": T}))
    with h5py.File(tmp_path / "r.h5", "a") as file:
        file["outputs/q"][3] = 9.0
    with pytest.raises(InputError, match="checksum mismatch"):
        read(tmp_path / "r.h5")
    with pytest.warns(UserWarning, match="content_sha256 does not match"):
        assert read(tmp_path / "r.h5", no_verify=True)["q"][3] == 9.0


def test_load_gives_a_record_for_text_with_all_columns_as_outputs(tmp_path):
    record = rl.load(csv(tmp_path / "a.dat", T, u=T, q=T))
    assert isinstance(record, rl.Record)
    assert (list(record.inputs), list(record.outputs)) == ([], ["u", "q"])


@pytest.mark.shared
@pytest.mark.skipif(not SHARED.is_dir(), reason="measured data absent")
def test_published_records():
    """Sizes and sample times as the sources state them."""
    emps = read(SHARED / "emps.h5", "train", ["u"], ["q"])
    assert (emps.n, emps.units) == (24841, {"u": "V", "q": "m"})
    assert emps.dt == pytest.approx(1e-3)
    motor = SHARED / "hsm150_torque_steps.h5"
    assert read(motor, "idf_neg_0.045_1", ["u"], ["phi"]).n == 20000
    assert read(motor, "idf_neg_0.045_1", [], ["tau", "i"]).dt == pytest.approx(0.01)
    with pytest.raises(InputError, match="has 2000 samples"):
        read(motor, "idf_neg_0.045_1", ["u"], ["phi", "i"])
    rack = SHARED / "rack_pinion_friction.h5"
    assert read(rack, None, ["torque_pct"], ["speed"], clock="t_speed").n == 1024
    with pytest.raises(InputError, match="/speed has 1024 samples, expected 1077 as /force"):
        read(rack, None, ["force"], ["speed"], clock="t_force")
