"""Records that are cut short, hostile, or no records: one line, and exit code 3."""

import numpy as np
import pandas as pd
import pytest
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
