"""Untrusted files are opened in a child process only: what crashes or hangs there is a finding about the file.

What the reader process answers is told in `robustlab.files.wire`.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from robustlab.budget import child_environment
from robustlab.errors import EnvironmentFault, InputError
from robustlab.files.reader_server import Ended, ReaderServer
from robustlab.files.signature import Limits
from robustlab.files.wire import receive, receive_document

if TYPE_CHECKING:
    from collections.abc import Callable

    from robustlab.files.tree import Tree


# The reader's own limit is processor time, which a busy machine does not use up; this many times as long is waited for
# one that sleeps.
PATIENCE = 4

HOSTILE = "do not open it with other programs either; get the file again from where it was made"


def read_isolated(kind: str, path: str | Path, limits: Limits, group: str | None = None, **options: Any) -> Tree:
    """Read a file of kind ``hdf5``, ``matlab5``, ``parquet``, ``mcap`` or ``table`` in a process of its own.

    ``options`` go to the reader: of a table ``delimiter``, ``decimal``; of Parquet and MCAP ``wanted``.

    Raises InputError: what is wrong with the file; a reader that crashed, hung, or ran out of memory. EnvironmentFault:
    the reader could not be started.
    """
    where = str(path)
    request = _request(kind, limits, path=str(Path(path).absolute()), shown=where, group=group, **options)
    return _taken(_ended(request, where, limits), where, limits, lambda data: receive(data, where))


def document_isolated(kind: str, raw: bytes, where: str, limits: Limits) -> Any:
    """Parse a document of JSON or TOML in a process of its own, which gets its bytes and not its name.

    Raises InputError, EnvironmentFault: as `read_isolated`.
    """
    request = _request(kind, limits, shown=where, size=len(raw))
    return _taken(_ended(request, where, limits, raw), where, limits, receive_document)


def run_reader(command: list[str], where: str, limits: Limits) -> Tree:
    """Start ``command``, and take a tree or an error from its stdout."""
    return _taken(_fresh(command, where, limits), where, limits, lambda data: receive(data, where))


def _request(kind: str, limits: Limits, **arguments: Any) -> dict[str, Any]:
    return {"kind": kind, "limits": asdict(limits), **arguments}


def _ended(request: dict[str, Any], where: str, limits: Limits, given: bytes = b"") -> Ended:
    """Have the file read by a fork of the server, or by a fresh interpreter where there can be none."""
    if hasattr(os, "fork"):
        with suppress(OSError):  # it could not be started, or died: a fresh interpreter tells why
            return _SERVER.ask(request, given, PATIENCE * limits.seconds)
    # -P: the folder the user happens to be in must not lend modules to the reader.
    command = [sys.executable, "-P", "-m", "robustlab.files.reader_process", json.dumps(request)]
    return _fresh(command, where, limits, given)


def _fresh(command: list[str], where: str, limits: Limits, given: bytes = b"") -> Ended:
    try:
        done = subprocess.run(  # noqa: S603  our own interpreter with our own module
            command,
            input=given,
            capture_output=True,
            env=_environment(),
            timeout=PATIENCE * limits.seconds,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return Ended(0, b"", b"", late=True)
    except (OSError, ValueError) as error:  # ValueError: a NUL in a path
        reason = getattr(error, "strerror", None) or error
        raise EnvironmentFault(where, f"the reader process cannot be started ({reason})") from error
    return Ended(done.returncode, done.stdout, done.stderr)


def _taken(done: Ended, where: str, limits: Limits, take: Callable[[bytes], Any]) -> Any:
    """What the reader sent. Raises InputError, EnvironmentFault: it crashed, hung, failed, or sent nonsense."""
    if done.late:
        raise _no_answer(where, f"{PATIENCE * limits.seconds:g} s")
    if done.status < 0:
        signal = -done.status
        if signal in _cpu_signals():
            raise _no_answer(where, "its processor time")
        raise InputError(where, f"reader crashed (signal {signal}); file is damaged or hostile", None, HOSTILE)
    if done.status > 0:
        last = done.err.decode(errors="replace").strip().splitlines()[-1:] or ["no message"]
        if "MemoryError" in last[0]:
            raise InputError(where, "needs more memory than the reader may use")
        raise EnvironmentFault(where, f"the reader process failed ({last[0][:200]})", None, "robustlab doctor")
    try:
        return take(done.out)
    except InputError:
        raise
    except (ValueError, KeyError, TypeError, IndexError, RecursionError) as error:
        raise InputError(
            where, f"reader gave no valid answer ({error}); file is damaged or hostile", None, HOSTILE
        ) from None


def _no_answer(where: str, time: str) -> InputError:
    return InputError(where, f"reader gave no answer in {time}; file is damaged or hostile", None, HOSTILE)


def _cpu_signals() -> set[int]:
    import signal

    return {int(getattr(signal, "SIGXCPU", -1))}


def _environment() -> dict[str, str]:
    """That of a child process, without HDF5's plugins."""
    env = {key: value for key, value in child_environment().items() if not key.startswith("HDF5_")}
    return {**env, "HDF5_PLUGIN_PRELOAD": "::", "HDF5_USE_FILE_LOCKING": "FALSE"}  # ::, HDF5's word for no plugins


_SERVER = ReaderServer(_environment)
