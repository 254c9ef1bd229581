"""CPU time (user + system, with children) of start-up and of first answers, each in a process of its own.

The first run, into an empty cache of numba, and the median of the following ones.
"""

from __future__ import annotations

import os
import resource
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).parents[1]
CLI, MODEL = ["-m", "robustlab.cli.main"], str(ROOT / "models" / "motor_nominal.h5")
MU = "import numpy as np, robustlab as rl; rl.mu(np.array([[1, 2j], [0.5, 1]]), [[-1, 0], [1, 0]])"
COMMANDS = {
    "python -c pass": ["-c", "pass"],
    "robustlab --help": [*CLI, "--help"],
    "import robustlab": ["-c", "import robustlab"],
    "rl.mu": ["-c", MU],
    "robustlab model show FILE": [*CLI, "model", "show", MODEL],
    "robustlab data check FILE": [*CLI, "data", "check", str(ROOT / "recipes" / "data" / "motor_record.csv")],
    "robustlab run first-light": [*CLI, "run", "first-light", "--out", "out"],
}
RUNS = 5


def cpu_ms(arguments: list[str], cache: str) -> float:
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    environment = {**os.environ, "NUMBA_CACHE_DIR": cache, "OPENBLAS_NUM_THREADS": "1"}
    subprocess.run([sys.executable, *arguments], check=True, stdout=subprocess.DEVNULL, env=environment, cwd=cache)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return 1e3 * (after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime)


if __name__ == "__main__":
    for name, arguments in COMMANDS.items():
        with tempfile.TemporaryDirectory() as folder:
            first, *later = (cpu_ms(arguments, folder) for _ in range(RUNS + 1))
        print(f"{name:28} first {first:7.0f} ms, then {statistics.median(later):6.0f} ms", flush=True)
