"""Records that are cut short, hostile, or no records: one line, and exit code 3."""

import numpy as np
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
