"""Records that are cut short, hostile, or no records: one line, and exit code 3."""

import h5py
import numpy as np
import pandas as pd
import pytest
import record_files as rf
import scipy.io

import robustlab as rl
from robustlab.errors import InputError

T = np.arange(21) / 10
JUMP = np.where(np.arange(21) == 7, 0.0, T)


def read(path, *args, **kwargs):
    return rl.Record.read(path, *args, isolate=False, **kwargs)


def refused(match, path, *args, **kwargs):
    with pytest.raises(InputError, match=match) as caught:
        read(path, *args, **kwargs)
    assert caught.value.exit_code == 3
    assert "\n" not in str(caught.value).partition("\nhint:")[0]


# --- sizes -----------------------------------------------------------------------------------------------------------


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
        pd.DataFrame({"q": T}, index=1_700_000_000_000_000_000 + np.arange(21)),
        r"index: times of 1.7e\+18 and no unit, .*\nhint: units=\{.index.: .ns.\}",
    ),
    (pd.DataFrame(index=T), "no signals here"),
    (T, "a ndarray, expected a pandas DataFrame"),
]


@pytest.mark.parametrize(("frame", "match"), FRAMES)
def test_frames(frame, match):
    with pytest.raises(InputError, match=match):
        rl.Record.from_pandas(frame)
