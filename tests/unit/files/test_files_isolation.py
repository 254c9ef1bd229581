"""The reader process: crashes, hangs, floods and nonsense become findings about the file."""

import os
import sys

import h5py
import numpy as np
import pytest

from robustlab.errors import EnvironmentFault, InputError
from robustlab.files.hdf5 import read_tree
from robustlab.files.isolation import run_reader
from robustlab.files.signature import Limits

LIMITS = Limits(seconds=20.0)  # no reader here comes near it


def reader(script):
    return [sys.executable, "-S", "-c", script]


@pytest.mark.skipif(os.name == "nt", reason="signals")
def test_a_crash_is_named():
    with pytest.raises(InputError, match=r"p\.h5: reader crashed \(signal 11\); file is damaged or hostile"):
        run_reader(reader("import os; os.kill(os.getpid(), 11)"), "p.h5", LIMITS)


def test_a_hang_is_named():
    with pytest.raises(InputError, match=r"p\.h5: reader gave no answer in 2 s"):
        run_reader(reader("import time; time.sleep(60)"), "p.h5", Limits(seconds=0.5))


@pytest.mark.skipif(os.name == "nt", reason="signals")
def test_the_processor_limit_counts_as_a_hang():
    with pytest.raises(InputError, match=r"gave no answer"):
        run_reader(reader("import os, signal; os.kill(os.getpid(), signal.SIGXCPU)"), "p.h5", LIMITS)


NONSENSE = [
    "print('hello')",
    "import sys; sys.stdout.write('RLTREE1\\n')",
    "import sys; sys.stdout.buffer.write(b'RLTREE1\\n' + (2).to_bytes(8, 'little') + b'[]')",
    "import sys; sys.stdout.buffer.write(b'RLTREE1\\n' + (2).to_bytes(8, 'little') + b'{}')",
    """import sys; h = b'{"tree": {"attrs": {"x": ["<f8", null, [9]]}, "datasets": {}, "groups": {}}}'
sys.stdout.buffer.write(b'RLTREE1\\n' + len(h).to_bytes(8, 'little') + h)""",
]


@pytest.mark.parametrize("script", NONSENSE)
def test_nonsense_is_not_believed(script):
    with pytest.raises(InputError, match="reader gave no valid answer"):
        run_reader(reader(script), "p.h5", LIMITS)


def test_a_reader_that_cannot_work_is_no_fault_of_the_file():
    with pytest.raises(EnvironmentFault, match="reader process failed"):
        run_reader(reader("import nothing_of_that_name"), "p.h5", LIMITS)
    with pytest.raises(EnvironmentFault, match="cannot be started"):
        run_reader(["/nonexistent/python"], "p.h5", LIMITS)


def test_the_users_folder_lends_no_modules_to_the_reader(tmp_path, monkeypatch):
    (tmp_path / "h5py.py").write_text("raise SystemExit('hijacked')")
    (tmp_path / "numpy.py").write_text("raise SystemExit('hijacked')")
    with h5py.File(tmp_path / "p.h5", "w") as file:
        file["A"] = np.eye(2)
    monkeypatch.chdir(tmp_path)
    np.testing.assert_array_equal(read_tree("p.h5").datasets["A"].values, np.eye(2))


LIMITED = [
    (Limits(file=100), "at most 100 bytes"),
    (Limits(dataset=100), r"/wide: declares 6 x 6 \(288 bytes\), limit 100 bytes"),
    (Limits(total=300), r"with this dataset \d+ bytes in all, limit 300 bytes"),
    (Limits(objects=3), r"(more than 3 objects|\d+ objects in one group, limit 3)"),
    (Limits(depth=1), "/a/b: groups are nested deeper than 1"),
    (Limits(name=4), r"name of 5 characters, limit 4"),
]


@pytest.mark.parametrize(("limits", "text"), LIMITED, ids=["file", "dataset", "total", "objects", "depth", "name"])
def test_limits(limits, text, tmp_path):
    with h5py.File(tmp_path / "p.h5", "w") as file:
        file["wide"] = np.ones((6, 6))
        file["a/b/x"] = np.eye(2)
        file["longs"] = 1.0
    with pytest.raises(InputError, match=text):
        read_tree(tmp_path / "p.h5", limits=limits, isolate=False)
    if limits.dataset == 100:  # one of them shows that limits reach the reader process
        with pytest.raises(InputError, match=text):
            read_tree(tmp_path / "p.h5", limits=limits)


def test_dtype_table(tmp_path):
    """Real numbers of every width and byte order come out as float64 or int64, exactly."""
    numbers = np.array([[1, 2], [3, 100]])
    with h5py.File(tmp_path / "p.h5", "w") as file:
        for dtype in ("<f4", ">f4", ">f8", "<i2", ">i4", "u1", "<u8", "i8"):
            file[dtype] = numbers.astype(dtype)
    tree = read_tree(tmp_path / "p.h5", isolate=False)
    for name, dataset in tree.datasets.items():
        assert dataset.values.dtype == (np.float64 if "f" in name else np.int64)
        np.testing.assert_array_equal(dataset.values, numbers)
