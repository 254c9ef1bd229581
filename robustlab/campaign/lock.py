"""One writer per store: a lock of the operating system, which a dead process cannot keep."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path

from robustlab.errors import EnvironmentFault, RobustlabError, plain_text

__all__ = ["locked", "owner_text"]


@contextmanager
def locked(path: Path) -> Iterator[None]:
    """Hold the lock of a store; it lies beside it as ``NAME.lock`` and vanishes with the process that holds it.

    Raises
    ------
    EnvironmentFault
        Another process holds it (its pid and command are named); the folder cannot be written.
    """
    from filelock import FileLock, Timeout

    folder = path.absolute().parent
    if not folder.is_dir():  # the lock would make it
        raise EnvironmentFault(str(path), f"no such folder {folder}", "a folder that can be written")
    lock = FileLock(f"{path}.lock", timeout=0)
    try:
        lock.acquire()
    except Timeout:
        raise EnvironmentFault(str(path), f"locked by {_owner(path)}", None, "wait for it, or stop it") from None
    except (OSError, NotImplementedError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise EnvironmentFault(str(path), f"cannot be locked: {reason}", "a folder that can be written") from None
    try:
        yield
    finally:
        lock.release()


def owner_text() -> str:
    """Who this process is, as the store keeps it while it writes."""
    command = " ".join([Path(sys.argv[0] or "python").name, *sys.argv[1:]])[:300]
    return json.dumps(
        {"pid": os.getpid(), "command": command, "since": datetime.now(UTC).isoformat(timespec="seconds")}
    )


def _owner(path: Path) -> str:
    from robustlab.campaign.store import Store

    try:
        store = Store.open(path)
        text = store.get("owner")
        store.close()
        owner = json.loads(text)
        return plain_text(f"pid {owner['pid']} ({owner['command']}) since {owner['since']}")
    except (RobustlabError, ValueError, KeyError, TypeError):
        return "another process"  # it has not got as far as writing its name
