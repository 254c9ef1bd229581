"""Atomic writing: a file is always either the old one or the complete new one."""

from __future__ import annotations

import errno
import os
import stat
import tempfile
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from robustlab.errors import EnvironmentFault

PREFIX, SUFFIX = ".robustlab-", ".tmp"
STRAY_AGE = 3600.0  # s; an older temporary file is of a killed process
NO_FOLDER = (errno.ENOENT, errno.ENOTDIR)


def atomic_write(path: str | Path, write: Callable[[Path], object]) -> Path:
    """Call ``write(temporary_path)``, a file in the same folder, and replace ``path``, where a link is followed."""
    old, temporary = None, None
    try:
        target = Path(path).resolve()
        old = target.stat() if target.exists() else None
        if old is not None and not stat.S_ISREG(old.st_mode):
            raise EnvironmentFault(str(path), "is a directory or a device", "a file name")  # noqa: TRY301  one way out
        for stray in target.parent.glob(f"{PREFIX}*{SUFFIX}"):
            with suppress(OSError):  # removed by another process, or not permitted
                if time.time() - stray.stat().st_mtime > STRAY_AGE:
                    stray.unlink()
        handle, name = tempfile.mkstemp(SUFFIX, PREFIX, target.parent)
        os.close(handle)
        temporary = Path(name)
        write(temporary)
        with temporary.open("rb") as stream:
            os.fsync(stream.fileno())
        mask = os.umask(0o077)
        os.umask(mask)
        temporary.chmod(stat.S_IMODE(old.st_mode) if old else 0o666 & ~mask)
        temporary.replace(target)
        if os.name != "nt":  # which cannot flush a folder; it makes the renaming durable
            handle = os.open(target.parent, os.O_RDONLY)
            try:
                os.fsync(handle)
            finally:
                os.close(handle)
    except EnvironmentFault:
        raise
    except OSError as error:
        text = error.strerror or str(error)
        reason = "no such folder" if temporary is None and error.errno in NO_FOLDER else text[:1].lower() + text[1:]
        kept = "previous file kept" if old is not None and temporary is not None else "nothing was written"
        raise EnvironmentFault(str(path), f"{reason}; {kept}") from error
    finally:
        if temporary is not None:
            temporary.unlink(missing_ok=True)
    return target
