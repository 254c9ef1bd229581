"""Untrusted files are opened in a child process only: what crashes or hangs there is a finding about the file."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from robustlab.budget import child_environment
from robustlab.errors import EnvironmentFault, InputError
from robustlab.files.signature import Limits
from robustlab.files.wire import receive, receive_document

if TYPE_CHECKING:
    from collections.abc import Callable

    from robustlab.files.tree import Tree

HOSTILE = "do not open it with other programs either; get the file again from where it was made"


def read_isolated(kind: str, path: str | Path, limits: Limits, group: str | None = None, **options: Any) -> Tree:
    """Read a file of kind ``hdf5``, ``matlab5``, ``parquet``, ``mcap`` or ``table`` in a fresh interpreter.

    ``options`` go to the reader: of a table ``delimiter``, ``decimal``; of Parquet and MCAP ``wanted``.

    Raises
    ------
    InputError
        What is wrong with the file; a reader that crashed, hung, or ran out of memory.
    EnvironmentFault
        The reader could not be started.
    """
    command = _command(kind, limits, path=str(Path(path).absolute()), shown=str(path), group=group, **options)
    return run_reader(command, str(path), limits)


def document_isolated(kind: str, raw: bytes, where: str, limits: Limits) -> Any:
    """Parse a document of JSON or TOML in a fresh interpreter, which gets its bytes and not its name.

    Raises
    ------
    InputError, EnvironmentFault
        As `read_isolated`.
    """
    command = _command(kind, limits, shown=where, size=len(raw))
    return _answer(command, where, limits, receive_document, raw)


def run_reader(command: list[str], where: str, limits: Limits) -> Tree:
    """Start ``command``, and take a tree or an error from its stdout."""
    return _answer(command, where, limits, lambda data: receive(data, where))


def _command(kind: str, limits: Limits, **arguments: Any) -> list[str]:
    # -P: the folder the user happens to be in must not lend modules to the reader.
    request = json.dumps({"kind": kind, "limits": asdict(limits), **arguments})
    return [sys.executable, "-P", "-m", "robustlab.files.reader_process", request]


def _answer(command: list[str], where: str, limits: Limits, take: Callable[[bytes], Any], given: bytes = b"") -> Any:
    try:
        done = subprocess.run(  # noqa: S603  our own interpreter with our own module
            command, input=given, capture_output=True, env=_environment(), timeout=limits.seconds, check=False
        )
    except subprocess.TimeoutExpired:
        raise _no_answer(where, f"{limits.seconds:g} s") from None
    except (OSError, ValueError) as error:  # ValueError: a NUL in a path
        reason = getattr(error, "strerror", None) or error
        raise EnvironmentFault(where, f"the reader process cannot be started ({reason})") from error
    if done.returncode < 0:
        signal = -done.returncode
        if signal in _cpu_signals():
            raise _no_answer(where, "its processor time")
        raise InputError(where, f"reader crashed (signal {signal}); file is damaged or hostile", None, HOSTILE)
    if done.returncode > 0:
        last = done.stderr.decode(errors="replace").strip().splitlines()[-1:] or ["no message"]
        if "MemoryError" in last[0]:
            raise InputError(where, "needs more memory than the reader may use")
        raise EnvironmentFault(where, f"the reader process failed ({last[0][:200]})", None, "robustlab doctor")
    try:
        return take(done.stdout)
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
