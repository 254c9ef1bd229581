"""What the benchmarks share: a heading, CPU time, calls in a child under a limit of CPU time, JSON lines, COMPleib."""

from __future__ import annotations

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

COMPLEIB = Path(__file__).parents[2] / "shared" / "data" / "compleib.h5"


def heading(*packages: str) -> str:
    """Command, day, machine and versions, as two lines of comment."""
    machine = f"{platform.machine()} {platform.system()}, load {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores"
    installed = {d.metadata["Name"].lower(): d.version for d in distributions()}
    found = ", ".join(f"{name} {installed[name]}" for name in packages if name in installed)
    command = " ".join([f"benchmarks/{Path(sys.argv[0]).name}", *sys.argv[1:]])
    return f"# python {command}\n# {datetime.now(UTC):%Y-%m-%d}, {machine}, Python {platform.python_version()}, {found}"


def timed(call: Callable[..., Any], *given: Any, **options: Any) -> tuple[Any, float]:
    """What a call returns, and its CPU seconds."""
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
    if child.returncode in (-signal.SIGXCPU, -signal.SIGKILL):
        return {"refused": "no return", "cpu": limit}
    lines = [line for line in out.splitlines() if line.startswith("{")]
    if child.returncode or not lines:
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


def compleib(
    names: Sequence[str] = (), most: float = np.inf, data: Path = COMPLEIB
) -> list[tuple[str, dict[str, Any], dict[str, Any]]]:
    """Name, A B C D (w before u, z before y) and facts of the stabilisable plants: these, or up to a size."""
    import h5py

    found = []
    with h5py.File(data) as file:
        table: Any = file
        for name in sorted(names or table, key=lambda k: (table[k].attrs["n"], k)):
            m, about = {key: table[name][key][()] for key in table[name]}, dict(table[name].attrs)
            if about["stabilisable"] and (names or about["n"] <= most):
                D = np.block([[m["D11"], m["D12"]], [m["D21"], np.zeros((about["ny"], about["nu"]))]])
                P = {"A": m["A"], "B": np.hstack([m["B1"], m["B"]]), "C": np.vstack([m["C1"], m["C"]]), "D": D}
                found.append((name, P, about))
    return found


def over_best(norm: float, best: float, zero: bool) -> float:
    """The norm over the best known; where the infimum looks like zero, 1 up to 1e-2 and inf above."""
    if zero:
        return 1.0 if norm <= 1e-2 else np.inf
    return norm / best
