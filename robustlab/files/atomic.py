"""Atomic writing: a file is either the old one or the complete new one, whatever happens in between."""

from __future__ import annotations

import errno
import os
import stat
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from robustlab.errors import EnvironmentFault

PREFIX = ".robustlab-"
SUFFIX = ".tmp"
STRAY_AGE = 3600.0  # s; a temporary file this old was left by a process that was killed

_REASONS = {
    errno.ENOSPC: "no space left",
    errno.EDQUOT: "disk quota exceeded",
    errno.EFBIG: "larger than the system allows",
    errno.EACCES: "no permission to write",
    errno.EPERM: "no permission to write",
    errno.EROFS: "read-only file system",
    errno.ENOENT: "no such folder",
    errno.ENOTDIR: "no such folder",
    errno.EIO: "disk error",
    errno.ENAMETOOLONG: "name too long",
}


def atomic_write(path: str | Path, write: Callable[[Path], object]) -> Path:
    """Call ``write(temporary_path)`` and put what it wrote in the place of ``path``.

    The temporary file lies in the same folder; it is flushed to disk, renamed, and the folder is flushed. A link is
    followed: the file it points to is replaced. Temporary files that a killed process left in the folder more than an
    hour ago are removed.
    """
    where = str(path)
    try:
        target = Path(path).resolve()
        old = _previous(target, where)
        _sweep(target.parent)
        handle, name = tempfile.mkstemp(SUFFIX, PREFIX, target.parent)
    except EnvironmentFault:
        raise
    except OSError as error:
        raise _fault(where, error, kept=False) from error
    os.close(handle)
    temporary = Path(name)
    try:
        write(temporary)
        with temporary.open("rb") as stream:
            os.fsync(stream.fileno())
        temporary.chmod(stat.S_IMODE(old.st_mode) if old else 0o666 & ~_umask())
        temporary.replace(target)
        _flush_folder(target.parent)
    except EnvironmentFault:
        raise
    except OSError as error:
        raise _fault(where, error, kept=old is not None) from error
    finally:
        temporary.unlink(missing_ok=True)
    return target


def _previous(target: Path, where: str) -> os.stat_result | None:
    if not target.exists():
        return None
    old = target.stat()
    if not stat.S_ISREG(old.st_mode):
        raise EnvironmentFault(where, "is a directory or a device", "a file name")
    return old


def _fault(where: str, error: OSError, kept: bool) -> EnvironmentFault:
    reason = _REASONS.get(error.errno or 0, error.strerror or str(error))
    return EnvironmentFault(where, f"{reason}; previous file kept" if kept else f"{reason}; nothing was written")


def _umask() -> int:
    mask = os.umask(0o077)
    os.umask(mask)
    return mask


def _flush_folder(folder: Path) -> None:
    """Make the renaming itself durable; Windows has no such call for folders."""
    if os.name == "nt":
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def _sweep(folder: Path) -> None:
    for stray in folder.glob(f"{PREFIX}*{SUFFIX}"):
        try:
            if time.time() - stray.stat().st_mtime > STRAY_AGE:
                stray.unlink()
        except OSError:
            continue  # another process was faster, or it is not ours to remove: a stray file does no harm
