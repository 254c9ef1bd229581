"""The reader process: crashes, hangs, floods and nonsense become findings about the file."""

import os
import signal
import subprocess
import sys
import tempfile

import h5py
import numpy as np
import pytest

from robustlab.errors import InputError
from robustlab.files import isolation
from robustlab.files.hdf5 import read_tree
from robustlab.files.isolation import run_reader
from robustlab.files.signature import Limits
from robustlab.files.text_table import read_table

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


# --- one server for many files ----------------------------------------------------------------------------------------

FORKS = pytest.mark.skipif(not hasattr(os, "fork"), reason="a system without fork")


@pytest.fixture
def server(monkeypatch):
    found = isolation.ReaderServer(isolation._environment)
    monkeypatch.setattr(isolation, "_SERVER", found)
    monkeypatch.setattr(isolation, "_fresh", lambda *_: pytest.fail("a fresh interpreter was started"))
    yield found
    found.close()


def number(value=1, limits=LIMITS):
    """A number from a table, read in the reader process."""
    with tempfile.NamedTemporaryFile("w", suffix=".csv") as file:
        file.write(f"t,a\n0,{value}\n1,{value}\n")
        file.flush()
        return read_table(file.name, None, ".", limits).values[0, 1]


@FORKS
def test_one_process_serves_many_files_each_in_its_own(server, tmp_path):
    with h5py.File(tmp_path / "p.h5", "w") as file:
        file["A"] = np.eye(2)
    assert number() == 1
    process = server._process
    for _ in range(5):
        np.testing.assert_array_equal(read_tree(tmp_path / "p.h5").datasets["A"].values, np.eye(2))
        assert number(2) == 2
        with pytest.raises(InputError, match="word"):
            number("word")
    assert server._process is process


@pytest.mark.slow
@FORKS
def test_a_server_that_hangs_is_ended_and_the_file_read_by_a_fresh_interpreter(monkeypatch):
    found = isolation.ReaderServer(isolation._environment)
    monkeypatch.setattr(isolation, "_SERVER", found)
    monkeypatch.setattr(isolation, "OVERDUE", 0.3)
    number()
    stopped = found._process
    stopped.send_signal(signal.SIGSTOP)
    assert number(1, Limits(seconds=2.0)) == 1
    assert stopped.wait(10) == -signal.SIGKILL


@FORKS
def test_a_reader_that_crashes_or_hangs_ends_nothing_but_itself(server, monkeypatch):
    """What happens in a fork: the server is made to crash and to sleep by what it is told to load for a kind."""
    number()
    process = server._process
    script = (
        "import os, sys, time\nfrom robustlab.files import reader_process\n"
        "def answered(request, stream):\n"
        "    os.kill(os.getpid(), 11) if request['kind'] == 'crash' else time.sleep(60)\n"
        "reader_process.answered = answered\n"
        "reader_process.serve(sys.stdin.buffer, sys.stdout.buffer)\n"
    )
    command = [sys.executable, "-c", script]
    environment = isolation._environment()
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=environment) as bad:
        server._process = bad
        crash = server.ask({"kind": "crash"}, 20.0)
        assert (crash.status, crash.late) == (-11, False)
        late = server.ask({"kind": "hang"}, 0.2)
        assert late.late
        assert server.ask({"kind": "crash"}, 20.0).status == -11
        bad.kill()
    server._process = process
    assert number() == 1
