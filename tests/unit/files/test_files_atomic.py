"""Atomic writing under injected faults: the file is the old one or the new one, and nothing else is left."""

import errno
import os
import pathlib
import stat
import subprocess
import sys

import pytest

import robustlab as rl
from robustlab.errors import EnvironmentFault, UsageError
from robustlab.files import atomic_write

OLD, NEW = b"old content", b"new content"


def write_new(path):
    return path.write_bytes(NEW)


def test_writes_and_replaces(tmp_path):
    target = tmp_path / "r.h5"
    atomic_write(target, write_new)
    assert target.read_bytes() == NEW
    atomic_write(target, lambda path: path.write_bytes(b"newer"))
    assert [p.name for p in tmp_path.iterdir()] == ["r.h5"]
    assert target.read_bytes() == b"newer"


STEPS = [(os, "fsync"), (pathlib.Path, "replace"), (pathlib.Path, "chmod")]


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EROFS, errno.EDQUOT, errno.EIO, errno.EACCES])
@pytest.mark.parametrize(("owner", "name"), STEPS, ids=[name for _, name in STEPS])
def test_a_fault_at_any_step_keeps_the_previous_file(owner, name, number, tmp_path, monkeypatch):
    target = tmp_path / "r.h5"
    target.write_bytes(OLD)

    def fail(*_args, **_kwargs):
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(owner, name, fail)
    with pytest.raises(EnvironmentFault, match=r"r\.h5: .*; previous file kept") as caught:
        atomic_write(target, write_new)
    assert caught.value.exit_code == 5
    assert target.read_bytes() == OLD
    assert [p.name for p in tmp_path.iterdir()] == ["r.h5"]


@pytest.mark.skipif(os.name == "nt", reason="POSIX limits")
def test_a_file_system_that_is_really_full(tmp_path):
    """RLIMIT_FSIZE lets the system itself refuse the bytes."""
    script = """
import resource, sys, numpy as np, robustlab as rl
from robustlab.errors import RobustlabError
resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096))
try:
    rl.save("r.h5", rl.StateSpaceModel(np.random.rand(60, 60), np.ones((60, 1)), np.ones((1, 60)), [[0]]))
except RobustlabError as error:
    print(error); sys.exit(error.exit_code)
"""
    rl.save(tmp_path / "r.h5", rl.StateSpaceModel([[1.0]], [[1.0]], [[1.0]], [[0.0]]))
    before = (tmp_path / "r.h5").read_bytes()
    done = subprocess.run([sys.executable, "-c", script], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 5, done.stderr
    assert done.stdout == "r.h5: file too large; previous file kept\n"
    assert (tmp_path / "r.h5").read_bytes() == before
    assert len(list(tmp_path.iterdir())) == 1


def test_no_such_folder_and_a_folder_as_target(tmp_path):
    with pytest.raises(EnvironmentFault, match="no such folder; nothing was written"):
        atomic_write(tmp_path / "nowhere" / "r.h5", write_new)
    with pytest.raises(EnvironmentFault, match="is a directory"):
        atomic_write(tmp_path, write_new)
    with pytest.raises(UsageError, match="extension"):
        rl.save(tmp_path / "r.xyz", rl.StateSpaceModel([[1.0]], [[1.0]], [[1.0]], [[0.0]]))


@pytest.mark.skipif(os.name == "nt", reason="POSIX permissions")
def test_permissions_and_links_stay(tmp_path):
    target = tmp_path / "real.h5"
    target.write_bytes(OLD)
    target.chmod(0o640)
    link = tmp_path / "link.h5"
    link.symlink_to(target)
    atomic_write(link, write_new)
    assert link.is_symlink()
    assert target.read_bytes() == NEW
    assert stat.S_IMODE(target.stat().st_mode) == 0o640
    mask = os.umask(0o027)
    try:
        atomic_write(tmp_path / "fresh.h5", write_new)
    finally:
        os.umask(mask)
    assert stat.S_IMODE((tmp_path / "fresh.h5").stat().st_mode) == 0o640
