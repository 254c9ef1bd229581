"""The reader process: crashes, hangs, floods and nonsense become findings about the file."""

import os
import sys

import h5py
import numpy as np
import pytest

from robustlab.errors import EnvironmentFault, InputError
from robustlab.files import Limits, ReaderServer, read_table, read_tree

LIMITS = Limits(seconds=20.0)  # no reader here comes near it
TREE = """h = b'{"tree": {"attrs": {"x": ["<f8", null, [1]]}, "datasets": {}, "groups": {}}}'
w(b'RLTREE1\\n' + len(h).to_bytes(8, 'little') + h + bytes(8))"""
FORKED = """from robustlab.files import isolation as r
def answer(request, stream):
    os.kill(os.getpid(), 11) if request['kind'] == 'hdf5' else time.sleep(60)
r.answer = answer
r.serve(sys.stdin.buffer, sys.stdout.buffer)"""


def server(script):
    start = "import os, sys, time, signal\nw = lambda b: (sys.stdout.buffer.write(b), sys.stdout.flush())\n"
    return ReaderServer((sys.executable, "-c", f"{start}{script}"))


@pytest.mark.skipif(os.name == "nt", reason="signals")
@pytest.mark.parametrize(
    ("script", "kind", "text"),
    [
        ("os.kill(os.getpid(), 11)", "hdf5", r"p\.h5: reader crashed \(signal 11\); file is damaged or hostile"),
        ("os.kill(os.getpid(), signal.SIGXCPU)", "hdf5", "gave no answer in its processor time"),
        (FORKED, "hdf5", r"reader crashed \(signal 11\)"),
        (FORKED, "matlab5", r"p\.h5: reader gave no answer in 2 s"),
        ("print('hello to everybody')\ninput()", "hdf5", "gave no valid answer"),
        ("w(b'RLTREE1\\n' + (2).to_bytes(8, 'little') + b'[]')\ninput()\ninput()", "hdf5", "no valid answer"),
        ("w(b'RLTREE1\\n' + (2).to_bytes(8, 'little') + b'{}')\ninput()\ninput()", "hdf5", "no valid answer"),
        (f"{TREE.replace('<f8', '<f2')}\ninput()\ninput()", "hdf5", "no valid answer"),
    ],
)
def test_what_a_reader_does_wrong_is_named(script, kind, text):
    limits = Limits(seconds=0.5) if kind == "matlab5" else LIMITS
    with pytest.raises(InputError, match=text):
        server(script).read(kind, "p.h5", limits)


def test_a_reader_that_ends_is_started_anew():
    one = server(f"{TREE}\nsys.exit(3)")
    assert one.read("hdf5", "p.h5", LIMITS).attrs["x"] == [0.0]
    one.process.wait()
    assert one.read("hdf5", "p.h5", LIMITS).attrs["x"] == [0.0]
    with pytest.raises(EnvironmentFault, match="exit code 3"):
        server("sys.exit(3)").read("hdf5", "p.h5", LIMITS)


def test_one_process_serves_many_files_and_the_users_folder_lends_no_modules(tmp_path, monkeypatch):
    (tmp_path / "h5py.py").write_text("raise SystemExit('hijacked')")
    (tmp_path / "numpy.py").write_text("raise SystemExit('hijacked')")
    (tmp_path / "a.csv").write_text("t,a\n0,2\n1,2\n")
    (tmp_path / "b.csv").write_text("t,a\n0,word\n1,2\n")
    with h5py.File(tmp_path / "p.h5", "w") as file:
        file["A"] = np.eye(2)
    monkeypatch.chdir(tmp_path)
    one, table = ReaderServer(), {"delimiter": None, "decimal": "."}
    seen = set()
    for _ in range(3):
        np.testing.assert_array_equal(one.read("hdf5", "p.h5", LIMITS).datasets["A"].values, np.eye(2))
        assert one.read("table", "a.csv", LIMITS, **table).datasets["values"].values[0, 1] == 2
        with pytest.raises(InputError, match="word"):
            one.read("table", "b.csv", LIMITS, **table)
        seen.add(one.process.pid)
    assert len(seen) == 1
    assert read_table("a.csv").values[0, 1] == 2


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
    for isolate in (False, True):
        with pytest.raises(InputError, match=text):
            read_tree(tmp_path / "p.h5", limits=limits, isolate=isolate)
