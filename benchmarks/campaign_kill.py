"""A campaign killed at random and resumed, against an unbroken one: the same result, and how much work was redone.

``python benchmarks/campaign_kill.py [SAMPLES] [KILLS]`` (default 100000 and 10) kills with ``kill -9``, each time at a
random moment of the remaining work: the main process, or the main process and all workers. Every piece of
work that a worker begins is written to a log (by a `sitecustomize` in its interpreter), which tells what was redone.
Needs /proc.
"""

from __future__ import annotations

import json
import os
import platform
import random
import signal
import sqlite3
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import closing, suppress
from dataclasses import dataclass, field
from pathlib import Path

import robustlab as rl
from robustlab.campaign import CampaignResult, CampaignSettings, Crew, run_campaign

SPY = '''\
"""Log every piece of work that a worker begins."""
import os
import sys
import time

if "--multiprocessing-fork" in sys.orig_argv:
    from robustlab.campaign import evaluation

    original = evaluation.compute

    def open_below():
        with open(os.environ["PIECES_GATE"], encoding="utf-8") as gate:
            return int(gate.read() or 0)

    def compute(identity, model, first, last):
        with open(os.environ["PIECES_LOG"], "a", encoding="utf-8") as log:
            log.write(f"{first} {last}\\n")
        while first >= open_below():
            time.sleep(0.02)
        return original(identity, model, first, last)

    evaluation.compute = compute
'''
ROOT = Path(__file__).resolve().parents[1]


@dataclass
class Outcome:
    """What the killed and the unbroken run gave."""

    unbroken: CampaignResult
    killed: dict[str, object]
    samples: int
    unbroken_seconds: float = 0.0
    killed_seconds: float = 0.0
    kills: list[str] = field(default_factory=list)
    pieces: list[tuple[int, int]] = field(default_factory=list)
    redone_per_kill: list[int] = field(default_factory=list)

    @property
    def redone_samples(self) -> int:
        """Samples that were begun more than once, counted as often as they were begun again."""
        return sum(min(last, self.samples) - first for first, last in self.pieces) - self.samples


def measure(
    folder: Path,
    samples: int,
    kills: int,
    workers: int = 2,
    seed: int = 1,
    gated: bool = False,
    unbroken_workers: int | None = None,
) -> Outcome:
    """Run both campaigns in ``folder``.

    Parameters
    ----------
    samples, kills
        Size of the campaign, and how often it is killed.
    seed
        Of the moments and the victims.
    gated
        Whether each kill comes with the first saved piece, which all later ones wait for: a small campaign cannot
        end before it.
    unbroken_workers
        Workers of the unbroken run; the same where left out.
    """
    uncertain = rl.plant("dc-motor", Kf=(4.8e-5, 0.35), R=(2.07, 0.1), Km=(0.052, 0.05)).uncertain(outputs=["omega"])
    rl.save(folder / "motor.h5", uncertain)
    settings = CampaignSettings("peak-deviation", samples, seed=1, u={"u": 42.0}, t_end=0.1)
    begun = time.monotonic()
    unbroken = run_campaign(uncertain, settings, folder / "unbroken.sqlite", crew=Crew(unbroken_workers or workers))
    unbroken_seconds = time.monotonic() - begun

    spy = folder / "spy"
    spy.mkdir()
    (spy / "sitecustomize.py").write_text(SPY, encoding="utf-8")
    store, log = folder / "killed.sqlite", folder / "pieces.log"
    log.touch()
    gate = folder / "pieces.gate"
    gate.write_text(str(samples), encoding="utf-8")
    path = os.pathsep.join(part for part in (str(spy), str(ROOT), os.environ.get("PYTHONPATH", "")) if part)
    watched = {**os.environ, "PYTHONPATH": path, "PIECES_LOG": str(log), "PIECES_GATE": str(gate)}
    task = ["campaign", "run", "motor.h5", "--input", "u=42", "--t-end", "0.1", "-n", str(samples), "--seed", "1"]
    task += ["--workers", str(workers), "--json", "--store", str(store)]
    command = [sys.executable, "-m", "robustlab.cli.main", *task]

    outcome = Outcome(unbroken, {}, samples, unbroken_seconds)
    started: list[subprocess.Popen[bytes]] = []

    def start() -> subprocess.Popen[bytes]:
        started.append(subprocess.Popen(command, cwd=folder, env=watched, stdout=subprocess.PIPE))
        return started[-1]

    begun = time.monotonic()
    try:
        process = _kill_and_resume(outcome, start, (store, log, gate if gated else None), kills, seed)
        outcome.killed = json.loads(process.communicate()[0])
    finally:
        for process in started:
            with process:  # closes its pipe and waits
                process.kill()
    outcome.killed_seconds = time.monotonic() - begun
    outcome.pieces = _pieces(log)
    return outcome


def _kill_and_resume(
    outcome: Outcome,
    start: Callable[[], subprocess.Popen[bytes]],
    files: tuple[Path, Path, Path | None],
    kills: int,
    seed: int,
) -> subprocess.Popen[bytes]:
    """Kill ``kills`` times, start again each time, and return the process that is left to end by itself.

    ``files`` are the store, the log of pieces and, where there is one, the gate of the pieces.
    """
    store, log, gate = files
    rng, process = random.Random(seed), None
    earlier = 0
    for number in range(kills):
        # Never before anything new is saved; without a gate at a random moment of the i-th part of the work.
        at = _saved(store) + 1
        if gate is None:
            at = max(at, int(outcome.samples * (number + rng.random()) / (kills + 1)))
        else:
            gate.write_text(str(at), encoding="utf-8")
        process = process or start()
        while _saved(store) < at and process.poll() is None:
            time.sleep(0.05)
        time.sleep(0.2 * rng.random())
        assert process.poll() is None, f"it ended before kill {number + 1} of {kills}"
        crew = _children(process.pid)
        victim = ("main", "all")[number % 2]
        outcome.kills.append(f"{victim} at {_saved(store)}")
        for pid in {"main": [process.pid], "all": [process.pid, *crew]}[victim]:
            _kill(pid)
        if gate is not None:
            gate.write_text(str(outcome.samples), encoding="utf-8")
        process.communicate()
        process = None
        _wait_for_end(crew)
        open_pieces = [p for p in _pieces(log)[earlier:] if not _is_stored(store, p, outcome.samples)]
        outcome.redone_per_kill.append(len(open_pieces))
        earlier = len(_pieces(log))
    return process or start()


def _saved(store: Path) -> int:
    """Rows in the store; it is looked at many times a second, so without the checks of `robustlab.campaign`."""
    return _count(store, 0, sys.maxsize)


def _is_stored(store: Path, piece: tuple[int, int], samples: int) -> bool:
    first, last = piece[0], min(piece[1], samples)
    return _count(store, first, last) == last - first


def _count(store: Path, first: int, last: int) -> int:
    if not store.exists() or not store.stat().st_size:
        return 0
    with closing(sqlite3.connect(f"{store.as_uri()}?mode=ro", uri=True, timeout=10)) as db:
        try:
            found = db.execute("SELECT COUNT(*) FROM sample WHERE idx >= ? AND idx < ?", (first, last)).fetchone()
        except sqlite3.OperationalError:  # killed before the tables were there
            return 0
    return int(found[0])


def _pieces(log: Path) -> list[tuple[int, int]]:
    pairs = [line.split() for line in log.read_text(encoding="utf-8").splitlines()]
    return [(int(first), int(last)) for first, last in pairs]


def _children(pid: int) -> list[int]:
    found: list[int] = []
    for task in Path(f"/proc/{pid}/task").glob("*/children"):
        found += [int(child) for child in task.read_text(encoding="utf-8").split()]
    return found


def _kill(pid: int) -> None:
    with suppress(ProcessLookupError):
        os.kill(pid, signal.SIGKILL)


def _wait_for_end(pids: list[int], seconds: float = 20.0) -> None:
    """Workers end by themselves when their parent is gone; a worker that stays is a fault."""
    until = time.monotonic() + seconds
    while any(Path(f"/proc/{pid}").exists() for pid in pids):
        assert time.monotonic() < until, "a worker outlived its parent"
        time.sleep(0.02)


def main() -> None:
    """Measure and print."""
    samples, kills = (int(text) for text in (*sys.argv[1:], "100000", "10")[:2])
    if len(sys.argv) == 2:
        kills = 10
    with tempfile.TemporaryDirectory() as name:
        found = measure(Path(name), samples, kills)
    same = found.unbroken.digest == found.killed["digest"]
    sizes = [last - first for first, last in found.pieces]
    print(f"Python {platform.python_version()}, {os.cpu_count()} processors, 2 workers, load {os.getloadavg()[0]:.1f}")
    print(f"{samples} samples, killed {len(found.kills)} times: {', '.join(found.kills)}")
    print(f"digest unbroken {found.unbroken.digest}")
    print(f"digest killed   {found.killed['digest']}: {'identical' if same else 'DIFFERENT'}")
    print(f"worst sample    {found.unbroken.worst!r} and {found.killed['worst']!r}")
    print(f"lost samples    {found.unbroken.lost} and {found.killed['lost']}")
    middle = sorted(sizes)[len(sizes) // 2]
    print(f"pieces          {len(sizes)} begun; {middle} samples in the median one, {max(sizes)} in the largest")
    print(
        f"redone          {found.redone_samples} samples ({100 * found.redone_samples / samples:.2g} %) after all kills"
    )
    print(f"                pieces under way at each kill of the main process: {found.redone_per_kill} (2 workers)")
    print(f"seconds         {found.unbroken_seconds:.1f} unbroken, {found.killed_seconds:.1f} killed and resumed")


if __name__ == "__main__":
    main()
