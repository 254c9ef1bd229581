"""Shared by the benchmarks: options, a heading, CPU time, calls in a child under a limit of CPU time, JSON lines."""

from __future__ import annotations

import argparse
import json
import os
import platform
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from datetime import UTC, datetime
from importlib.metadata import distributions
from pathlib import Path
from typing import Any

import numpy as np


def options(description: str | None, names: Sequence[str] | str = (), **defaults: Any) -> argparse.Namespace:
    """Return the command line arguments: ``names`` (of these, or any with "*") and ``--key VALUE``.

    A value has the type of its default. False makes a flag; a tuple of words is a choice, its first entry the default.
    """
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    if names:
        parser.add_argument("names", nargs="*", choices=None if names == "*" else [*names, []])
    for key, default in defaults.items():
        how: dict[str, Any] = {"type": type(default), "default": default}
        if default is False:
            how = {"action": "store_true"}
        elif isinstance(default, tuple):
            how = {"choices": default, "default": default[0]}
        parser.add_argument(f"--{key.replace('_', '-')}", **how)
    return parser.parse_args()


def heading(*packages: str) -> str:
    """Return command, day, machine and versions as two lines of comment."""
    machine = f"{platform.machine()} {platform.system()}, load {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores"
    installed = {d.metadata["Name"].lower(): d.version for d in distributions()}
    found = ", ".join(f"{name} {installed[name]}" for name in packages if name in installed)
    command = " ".join([f"benchmarks/{Path(sys.argv[0]).name}", *sys.argv[1:]])
    return f"# python {command}\n# {datetime.now(UTC):%Y-%m-%d}, {machine}, Python {platform.python_version()}, {found}"


def timed(call: Callable[..., Any], *given: Any, **options: Any) -> tuple[Any, float]:
    """Return the result of a call and its CPU seconds."""
    start = time.process_time()
    found = call(*given, **options)
    return found, time.process_time() - start


def middle_and_most(values: Iterable[float], form: str = "9.3f") -> str:
    values = np.array(list(values))
    return f"{np.median(values):{form}} {values.max():{form}}"


def limit_cpu(seconds: float) -> None:
    """Let the kernel end this process after so many more seconds of CPU time."""
    used = resource.getrusage(resource.RUSAGE_SELF)
    soft = int(used.ru_utime + used.ru_stime + seconds) + 1
    resource.setrlimit(resource.RLIMIT_CPU, (soft, resource.getrlimit(resource.RLIMIT_CPU)[1]))


def in_child(arguments: Sequence[str], text: str, limit: float = 0.0, *, wall: float | None = None) -> dict[str, Any]:
    """The JSON that a Python child prints last; ``refused``: why there is none.

    The child limits its own CPU time (`limit_cpu`); it and its children end after so much wall time.
    """
    command, wall = [sys.executable, "-W", "ignore", *arguments], wall or 8 * limit + 60
    pipes = dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.PIPE)
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}
    child = subprocess.Popen(command, text=True, env=environment, start_new_session=True, **pipes)  # type: ignore
    try:
        out, errors = child.communicate(text, timeout=wall)
    except subprocess.TimeoutExpired:
        os.killpg(child.pid, signal.SIGKILL)
        out, errors = child.communicate()
    lines = [line for line in out.splitlines() if line.startswith("{")]
    if not lines and child.returncode in (-signal.SIGXCPU, -signal.SIGKILL):
        return {"refused": "no return", "cpu": limit}
    if not lines:
        last = (errors.strip().splitlines() or ["no message"])[-1]
        return {"refused": f"died ({child.returncode}): {last[:120]}", "cpu": float("nan")}
    return json.loads(lines[-1])


def json_lines(files: Iterable[Path]) -> Iterator[dict[str, Any]]:
    """Records of files that are there; a line that a kill cut short is left out."""
    for path in files:
        for line in path.read_text(encoding="utf-8").splitlines() if path.exists() else ():
            if line.endswith("}"):
                yield json.loads(line)


def append(path: Path, record: dict[str, Any]) -> None:
    """Add a record to a file of JSON lines."""
    with path.open("a", encoding="utf-8") as file:
        file.write(json.dumps(record, default=float) + "\n")
