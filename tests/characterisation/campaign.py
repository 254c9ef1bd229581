"""Compare a campaign that is killed twice and resumed with an uninterrupted one, bit by bit."""

import json
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import robustlab as rl

from .cases import Case
from .sets import motor

RTOL = 1e-9
SAMPLES = 3000
SCRIPT = """
from importlib.metadata import entry_points
next(iter(entry_points(group="console_scripts", name="robustlab"))).load()()
"""


def cases() -> Iterator[Case]:
    """One."""
    yield Case("killed twice", killed_twice, True)


def killed_twice() -> dict[str, Any]:
    """The answers of both, and whether they are the same."""
    with tempfile.TemporaryDirectory() as folder:
        rl.save(Path(folder, "motors.h5"), motor())
        alone = json.loads(begin(folder, "alone.sqlite").communicate()[0])
        kills = 0
        for _ in range(2):
            process = begin(folder, "killed.sqlite")
            store = Path(folder, "killed.sqlite")
            size = store.stat().st_size if store.exists() else 0
            # Killed when it has saved something new.
            while process.poll() is None and (not store.exists() or store.stat().st_size <= size):
                time.sleep(0.02)
            time.sleep(0.3)
            process.send_signal(signal.SIGKILL)
            process.communicate()
            kills += process.returncode == -signal.SIGKILL
        killed = json.loads(begin(folder, "killed.sqlite").communicate()[0])
    same = all(alone[key] == killed[key] for key in ("digest", "worst", "worst_index", "done", "lost"))
    keys = ("status", "worst", "worst_index", "done", "lost", "violation")
    return {"kills": kills, "same": same, **{key: killed[key] for key in keys}}


def begin(folder: str, store: str) -> subprocess.Popen[str]:
    """The campaign, from where its store left it."""
    words = ["run", "motors.h5", "--input-value", "u=42", "--t-end", "0.1", "-n", str(SAMPLES), "--workers", "1",
             "--limit", "34", "--store", store, "--json"]  # fmt: skip
    return subprocess.Popen(
        [sys.executable, "-c", SCRIPT, "campaign", *words],
        cwd=folder,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    )
