"""CPU time (user + system, with children) of start-up and of first answers, each in a process of its own.

The median over many runs, and for what takes longer the least of five; what compiles into an empty cache of numba, and
what finds it full, once and a few times.
"""

from __future__ import annotations

import os
import resource
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

CLI = ["-m", "robustlab.cli.main"]
ROOT = Path(__file__).parents[1]
MODELS = ROOT / "models"
MU = """
import numpy as np, robustlab as rl
M = np.random.default_rng(0).normal(size=(2, 4, 4))
rl.mu(M[0] + 1j * M[1], [[-1, 0], [-1, 0], [1, 0], [1, 1]])
"""
HINF = """
import robustlab as rl
B, C = [[1, 0, 0], [0, 0, 1]], [[1, 0], [0, 0], [1, 1]]
rl.hinf(rl.StateSpaceModel([[-1, 0.5], [0, -2]], B, C, [[0, 0, 0], [0, 0, 1], [0, 1, 0]]), 1, 1)
"""
MIXSYN = """
import robustlab as rl
G = rl.StateSpaceModel([[0, 1], [-100, -2]], [[0], [100]], [[1, 0]], [[0]])
rl.mixsyn(G, W1=rl.StateSpaceModel([[-0.01]], [[1]], [[1]], [[0.5]]), W2=rl.StateSpaceModel([], [], [], [[0.1]]))
"""
COMMANDS = {
    "python -c pass": ["-c", "pass"],
    "robustlab --help": [*CLI, "--help"],
    "robustlab run --help": [*CLI, "run", "--help"],
    "import robustlab": ["-c", "import robustlab"],
    "first rl.hinf": ["-c", HINF],
    "first rl.mixsyn": ["-c", MIXSYN],
}
RUNS, WARM_RUNS = 25, 7


def cpu_ms(arguments: list[str], cache: str) -> float:
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    environment = {**os.environ, "NUMBA_CACHE_DIR": cache, "OPENBLAS_NUM_THREADS": "1"}
    subprocess.run([sys.executable, *arguments], check=True, stdout=subprocess.DEVNULL, env=environment)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return 1e3 * (after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime)


def report(name: str, ms: float) -> None:
    print(f"{name:32} {ms:6.0f} ms", flush=True)


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        for name, arguments in COMMANDS.items():
            report(name, statistics.median(cpu_ms(arguments, folder) for _ in range(RUNS)))
        uncertain = f"{folder}/uncertain.h5"
        pair = [str(MODELS / f"motor_{which}.h5") for which in ("nominal", "perturbed")]
        cpu_ms([*CLI, "uncertain", "build", *pair, "--out", uncertain], folder)
        for name, arguments in {"rl.mu": ["-c", MU], "robustlab mu FILE": [*CLI, "mu", uncertain]}.items():
            with tempfile.TemporaryDirectory() as cache:
                report(f"{name}, empty cache", cpu_ms(arguments, cache))
                report(f"{name}, full cache", statistics.median(cpu_ms(arguments, cache) for _ in range(WARM_RUNS)))
                report(f"{name}, full cache, least of 5", min(cpu_ms(arguments, cache) for _ in range(5)))
        record = str(ROOT / "recipes" / "data" / "motor_record.csv")
        longer = {
            "robustlab model show FILE": [*CLI, "model", "show", pair[0]],
            "robustlab data check FILE": [*CLI, "data", "check", record],
            "robustlab run first-light": [*CLI, "run", "first-light", "--out", f"{folder}/out"],
        }
        for name, arguments in longer.items():
            cold = cpu_ms(arguments, folder)
            report(f"{name}, first", cold)
            report(f"{name}, least of 5", min(cpu_ms(arguments, folder) for _ in range(5)))
