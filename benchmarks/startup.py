"""CPU time (user + system) of start-up: the median over many runs of each command, in ms."""

from __future__ import annotations

import resource
import statistics
import subprocess
import sys

COMMANDS = {
    "python -c pass": ["-c", "pass"],
    "robustlab --help": ["-m", "robustlab.cli.main", "--help"],
    "robustlab run --help": ["-m", "robustlab.cli.main", "run", "--help"],
    "import robustlab": ["-c", "import robustlab"],
}
RUNS = 25


def cpu_ms(arguments: list[str]) -> float:
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run([sys.executable, *arguments], check=True, stdout=subprocess.DEVNULL)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return 1e3 * (after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime)


if __name__ == "__main__":
    for name, arguments in COMMANDS.items():
        print(f"{name:22} {statistics.median(cpu_ms(arguments) for _ in range(RUNS)):6.0f} ms")
