"""Untrusted files are opened in a child process only: what crashes or hangs there is a finding about the file."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import asdict
from pathlib import Path

from robustlab.errors import EnvironmentFault, InputError
from robustlab.files.limits import Limits
from robustlab.files.tree import Tree
from robustlab.files.wire import receive

__all__ = ["read_isolated", "run_reader"]

HOSTILE = "do not open it with other programs either; get the file again from where it was made"


def read_isolated(kind: str, path: str | Path, limits: Limits, group: str | None = None) -> Tree:
    """Read a file of kind ``hdf5`` or ``matlab5`` in a fresh interpreter.

    Raises
    ------
    InputError
        What is wrong with the file; a reader that crashed, hung, or ran out of memory.
    EnvironmentFault
        The reader could not be started.
    """
    arguments = [kind, str(Path(path).absolute()), str(path), group or "", json.dumps(asdict(limits))]
    # -P: the folder the user happens to be in must not lend modules to the reader.
    command = [sys.executable, "-P", "-m", "robustlab.files.reader_process", *arguments]
    return run_reader(command, str(path), limits)


def run_reader(command: list[str], where: str, limits: Limits) -> Tree:
    """Start ``command``, and take a tree or an error from its stdout."""
    try:
        done = subprocess.run(  # noqa: S603  our own interpreter with our own module
            command,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            env=_environment(),
            timeout=limits.seconds,
            check=False,
        )
    except subprocess.TimeoutExpired:
        raise _no_answer(where, limits) from None
    except OSError as error:
        raise EnvironmentFault(where, f"the reader process cannot be started ({error.strerror or error})") from error
    if done.returncode < 0:
        signal = -done.returncode
        if signal in _cpu_signals():
            raise _no_answer(where, limits)
        raise InputError(where, f"reader crashed (signal {signal}); file is damaged or hostile", None, HOSTILE)
    if done.returncode > 0:
        last = done.stderr.decode(errors="replace").strip().splitlines()[-1:] or ["no message"]
        if "MemoryError" in last[0]:
            raise InputError(where, "needs more memory than the reader may use")
        raise EnvironmentFault(where, f"the reader process failed ({last[0][:200]})", None, "robustlab doctor")
    try:
        return receive(done.stdout, where)
    except InputError:
        raise
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(
            where, f"reader gave no valid answer ({error}); file is damaged or hostile", None, HOSTILE
        ) from None


def _no_answer(where: str, limits: Limits) -> InputError:
    return InputError(
        where, f"reader gave no answer in {limits.seconds:g} s; file is damaged or hostile", None, HOSTILE
    )


def _cpu_signals() -> set[int]:
    import signal

    return {int(getattr(signal, "SIGXCPU", -1))}


def _environment() -> dict[str, str]:
    """Our environment without HDF5's plugins, and with the folder this package was imported from."""
    env = {key: value for key, value in os.environ.items() if not key.startswith("HDF5_")}
    package_root = str(Path(__file__).resolve().parents[2])
    env["PYTHONPATH"] = os.pathsep.join(part for part in (package_root, env.get("PYTHONPATH", "")) if part)
    env.update(
        HDF5_PLUGIN_PRELOAD="::",  # HDF5's own word for "load no plugins"
        HDF5_USE_FILE_LOCKING="FALSE",
        OPENBLAS_NUM_THREADS="1",
        OMP_NUM_THREADS="1",
        PYTHONUTF8="1",
    )
    return env
