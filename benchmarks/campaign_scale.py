"""A campaign of very many samples of the Stewart platform: CPU time of a sample, memory over time, kills, the digest.

    python benchmarks/campaign_scale.py SAMPLES --workers 2 [--dask] [--kill]

The set is the platform with motors (18 states) under feedback of its angles and rates, nine uncertain parameters; a
sample is the response of the loop to a step of 1 V on all motors (201 times), its value the largest deviation of leg 1
from the nominal one.
``--dask`` starts a scheduler and workers of one thread each on this machine, as on a cluster. ``--kill`` ends a worker
with SIGKILL after a quarter and half of the samples and, without Dask, the whole command after three quarters, which is
then resumed. CPU time and memory are those of all processes, looked at twice a second. Needs /proc.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import signal
import socket
import sqlite3
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import control
import numpy as np
from campaign_kill import _children, _wait_for_end

import robustlab as rl
from robustlab.campaign import saved_samples

TICK = 0.5
SHARES = (0.1, 0.25, 0.5, 0.75, 1.0)
HERTZ = os.sysconf("SC_CLK_TCK")
TOLERANCES = {
    "platform_mass": 0.1, "link_mass": 0.1, "nut_mass": 0.1, "screw_mass": 0.1, "motor_mass": 0.1,
    "Km": 0.05, "Kb": 0.05, "R": 0.1, "Kf": 0.35,
}  # fmt: skip


def platform_loop() -> rl.UncertainModel:
    """The uncertain platform, its angles and rates fed back to the voltages."""
    exact = rl.plant("stewart-platform", preset="physical", motors=True)
    ranges = {name: (exact.parameters[name].value, share) for name, share in TOLERANCES.items()}
    uncertain = rl.plant("stewart-platform", preset="physical", motors=True, **ranges).uncertain()
    weights = np.diag([1e3] * 6 + [0.1] * 6 + [0.01] * 6)
    gain = np.asarray(control.lqr(uncertain.nominal.to_control(), weights, np.eye(6))[0])
    return uncertain.feedback(gain[:, :12])  # the currents, which follow within 0.3 ms, are not measured


@dataclass
class Watched:
    """Processes below some roots: CPU seconds and memory, as last seen of each."""

    roots: list[int]
    cpu: dict[int, float] = field(default_factory=dict)
    memory: list[tuple[int, float, float]] = field(default_factory=list)

    def look(self, main: int, saved: int) -> None:
        """Take CPU time of all; of memory that of the main process and of the largest other one, in MB."""
        largest = 0.0
        own = np.nan
        for pid in self.family():
            with suppress(OSError, ValueError, IndexError):
                numbers = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()
                self.cpu[pid] = (int(numbers[11]) + int(numbers[12])) / HERTZ
                size = int(numbers[21]) * os.sysconf("SC_PAGE_SIZE") / 1e6
                own, largest = (size, largest) if pid == main else (own, max(size, largest))
        self.memory.append((saved, own, largest))

    def family(self) -> list[int]:
        """All processes below the roots, and these."""
        found = list(self.roots)
        for pid in found:
            with suppress(OSError):
                found += _children(pid)
        return found

    def workers(self, main: int) -> list[int]:
        """Processes that compute: without Dask those of the command, with it those whose parent is a nanny."""
        if main == self.roots[0] and len(self.roots) == 1:
            return _children(main)
        return [pid for pid in self.family() if _is_dask_worker(pid)]


def _is_dask_worker(pid: int) -> bool:
    with suppress(OSError):
        return b"spawn_main" in Path(f"/proc/{pid}/cmdline").read_bytes()
    return False


@contextmanager
def cluster(count: int, folder: Path) -> Iterator[tuple[str, list[int]]]:
    """A Dask scheduler and workers of one thread on this machine: address and process ids."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    address, dask = f"tcp://127.0.0.1:{port}", [sys.executable, "-m", "dask"]
    commands = (
        [*dask, "scheduler", "--host", "127.0.0.1", "--port", str(port), "--no-dashboard"],
        [*dask, "worker", address, "--nthreads", "1", "--nworkers", str(count), "--no-dashboard"],
    )
    started: list[subprocess.Popen[bytes]] = []
    with (folder / "dask.log").open("wb") as log:
        try:
            for command in commands:
                started.append(subprocess.Popen(command, cwd=folder, stdout=log, stderr=log))
                time.sleep(3.0)
            yield address, [process.pid for process in started]
        finally:
            for process in reversed(started):
                process.terminate()
                process.wait()


def saved(store: Path) -> int:
    """The largest index in the store: cheap, and near enough to the number of rows."""
    if not store.exists() or not store.stat().st_size:
        return 0
    with closing(sqlite3.connect(f"{store.as_uri()}?mode=ro", uri=True, timeout=10)) as db:
        try:
            return int(db.execute("SELECT MAX(idx) FROM sample").fetchone()[0] or 0)
        except sqlite3.OperationalError:  # the tables are not there yet
            return 0


def command_line(samples: int, workers: int, dask: str | None, store: Path) -> list[str]:
    """The campaign as a user starts it."""
    words = f"campaign run platform.h5 --output phi_1 --t-end 0.25 --points 201 -n {samples} --seed 1 --progress none"
    steps = [word for leg in range(1, 7) for word in ("--input", f"u_{leg}=1")]
    crew = ["--cluster", dask] if dask else ["--workers", str(workers)]
    return [sys.executable, "-m", "robustlab.cli.main", *words.split(), *steps, "--json", "--store", str(store), *crew]


def run(samples: int, workers: int, dask: str | None, roots: list[int], kill: bool, folder: Path) -> None:
    """One campaign, watched, and what was seen of it printed."""
    store = folder / "platform.sqlite"
    command = command_line(samples, workers, dask, store)
    # Who dies after which share of the samples.
    plan = [(0.25, "worker"), (0.5, "worker"), *([] if dask else [(0.75, "main")])] if kill else []
    begun, kills, cpu, history = time.monotonic(), [], 0.0, []
    while True:
        process = subprocess.Popen(command, cwd=folder, stdout=subprocess.PIPE)
        watched = Watched([*roots, process.pid])
        while process.poll() is None:
            here = saved(store)
            watched.look(process.pid, here)
            if plan and here >= plan[0][0] * samples:
                victim, crew = plan.pop(0)[1], watched.workers(process.pid)
                os.kill(process.pid if victim == "main" else crew[0], signal.SIGKILL)
                kills.append(f"{victim} at {here}")
                if victim == "main":
                    process.wait()
                    _wait_for_end(crew)
                    break
            time.sleep(TICK)
        cpu += sum(watched.cpu.values())
        history += watched.memory
        if process.returncode != -signal.SIGKILL:
            break
    assert process.stdout is not None
    answer = json.loads(process.stdout.read())
    how = f"dask, {workers} workers" if dask else f"{workers} workers"
    print(f"\n{samples} samples, {how}{', killed: ' + ', '.join(kills) if kills else ''}: exit {process.returncode}")
    report(samples, store, answer, (cpu, time.monotonic() - begun), history)


def report(
    samples: int, store: Path, answer: Any, spent: tuple[float, float], history: list[tuple[int, float, float]]
) -> None:
    """What came of it, what it took (CPU, wall time), and memory after some shares of the samples."""
    (cpu, seconds), (done, of) = spent, saved_samples(store)
    print(f"  rows           {done} of {of}, lost {answer['lost']}, status {answer['status']}")
    print(f"  digest         {answer['digest']}")
    print(f"  worst          {answer['worst']!r} rad, second path {answer['again']!r}")
    print(f"  CPU            {cpu:.1f} s of all processes, {1e6 * cpu / samples:.0f} us a sample")
    print(f"  wall           {seconds:.1f} s, {samples / seconds:.0f} samples/s, load {os.getloadavg()[0]:.1f}")
    print(f"  store          {store.stat().st_size / 1e6:.1f} MB")
    marks = [min(history, key=lambda row, at=share * samples: abs(row[0] - at)) for share in SHARES]
    print("  memory MB      " + "; ".join(f"{at}: main {own:.0f}, largest other {most:.0f}" for at, own, most in marks))
    print(f"  at most        main {np.nanmax([own for _, own, _ in history]):.0f} MB", flush=True)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description="A campaign of very many platform samples.")
    parser.add_argument("samples", type=int)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--dask", action="store_true")
    parser.add_argument("--kill", action="store_true")
    options = parser.parse_args()
    print(f"Python {platform.python_version()}, {os.cpu_count()} processors")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        rl.save(folder / "platform.h5", platform_loop())
        if not options.dask:
            run(options.samples, options.workers, None, [], options.kill, folder)
            return
        with cluster(options.workers, folder) as (address, roots):
            run(options.samples, options.workers, address, roots, options.kill, folder)


if __name__ == "__main__":
    main()
