"""Static output feedback on COMPleib plants, beside HIFOO 3.501 and the best that is known: norm reached, and CPU time.

    python benchmarks/fixed.py [--states 16] [--cpu-limit 120] [--starts 16] [NAME ...]

Every plant is designed in a child process with a limit on its CPU time. A plant counts as solved to 1 % where the
certified norm of the loop rebuilt from the returned K is at most 1.01 times the best static norm that is known (or at
most 1e-2 where the infimum looks like zero). The columns "best" and "HIFOO" are the measured figures that come with the
data, not runs of today. CPU time is that of `fixed_structure` alone, without imports.
"""

from __future__ import annotations

import argparse
import json
import resource
import signal
import statistics
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from robustlab.errors import NoTrustworthyNumber
from robustlab.norms import hinf_norm
from robustlab.statespace import StateSpaceModel, lower_lft
from robustlab.synthesis.fixed.fixed_structure import fixed_structure

COMPLEIB = Path(__file__).parents[2] / "shared" / "data" / "compleib.h5"


def plant(group: Any) -> StateSpaceModel:
    m = {key: group[key][()] for key in group}
    D = np.block([[m["D11"], m["D12"]], [m["D21"], np.zeros((m["C"].shape[0], m["B"].shape[1]))]])
    return StateSpaceModel(m["A"], np.hstack([m["B1"], m["B"]]), np.vstack([m["C1"], m["C"]]), D)


def child(name: str, starts: int) -> dict[str, Any]:
    """One design: its certified norm and CPU time."""
    with h5py.File(COMPLEIB) as file:
        P = plant(file[name])
        about: dict[str, Any] = dict(file[name].attrs)
    fixed_structure(warm_up(), "static", n_meas=1, n_con=1, objective="h2", starts=0)  # imports
    begin = time.process_time()
    try:
        design = fixed_structure(
            P, "static", n_meas=int(about["ny"]), n_con=int(about["nu"]), starts=starts, effort=10.0
        )
    except NoTrustworthyNumber as error:
        return {"gamma": float("inf"), "cpu": time.process_time() - begin, "why": error.found}
    norm = hinf_norm(lower_lft(P, design.K))
    why = "" if norm.status.trustworthy else norm.reason
    return {"gamma": norm.upper, "cpu": time.process_time() - begin, "why": why}


def warm_up() -> StateSpaceModel:
    return StateSpaceModel([[1.0]], [[1.0, 1.0]], [[1.0], [0.0], [1.0]], [[0, 0], [0, 1], [0, 0]])


def in_child(name: str, starts: int, limit: int) -> dict[str, Any]:
    command = [sys.executable, __file__, "--child", "--starts", str(starts), name]

    def limited() -> None:
        resource.setrlimit(resource.RLIMIT_CPU, (limit, limit + 5))

    done = subprocess.run(command, capture_output=True, text=True, check=False, preexec_fn=limited)
    if done.returncode:
        killed = done.returncode in (-signal.SIGXCPU, -signal.SIGKILL)
        return {"gamma": float("inf"), "cpu": float(limit), "why": "CPU limit" if killed else done.stderr[-200:]}
    return json.loads(done.stdout)


def judged(gamma: float, best: float, zero: bool) -> float:
    """The norm over the best known; where the infimum looks like zero, 1 below 1e-2 and inf above."""
    if zero:
        return 1.0 if gamma <= 1e-2 else float("inf")
    return gamma / best


SHARES = (0.99, 1.001, 1.01, 1.05)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("names", nargs="*", metavar="NAME")
    parser.add_argument("--states", type=int, default=16)
    parser.add_argument("--cpu-limit", type=int, default=120)
    parser.add_argument("--starts", type=int, default=16)
    parser.add_argument("--child", action="store_true")
    options = parser.parse_args()
    if options.child:
        print(json.dumps(child(options.names[0], options.starts)))
        return
    with h5py.File(COMPLEIB) as file:
        table: dict[str, dict[str, Any]] = {str(name): dict(file[name].attrs) for name in file}
    known = [k for k in table if "static_hinf_best" in table[k] and table[k]["n"] <= options.states]
    names = options.names or sorted(known, key=lambda k: (table[k]["n"], k))
    ratios: list[float] = []
    hifoo: list[float] = []
    times: list[float] = []
    for name in names:
        about, found = table[name], in_child(name, options.starts, options.cpu_limit)
        best, other = float(about["static_hinf_best"]), float(about.get("static_hinf_hifoo3501_measured", np.inf))
        zero = bool(about["infimum_looks_zero"])
        ratio, theirs = (judged(x, best, zero) for x in (found["gamma"], other))
        ratios.append(ratio)
        hifoo.append(theirs)
        times.append(found["cpu"])
        line = f"{name:10s} n={about['n']:3d}  {about['nu'] * about['ny']:3d} gains  norm {found['gamma']:12.6g}"
        line += f"  / best {ratio:9.5f}  HIFOO / best {theirs:9.5f}  {found['cpu']:6.2f} s  {found['why']}"
        print(line.rstrip(), flush=True)
    print(f"\n{len(names)} plants, n <= {options.states}; {options.starts} random starts besides the own one")
    for title, values in (("robustlab", ratios), ("HIFOO 3.501", hifoo)):
        shares = "  ".join(
            f"<= {most:g}: {np.mean(np.array(values) <= most):.1%}" for most in (0.99, 1.001, 1.01, 1.05)
        )
        print(f"{title:12s} {shares}")
    better = sum(r < 0.99 * h for r, h in zip(ratios, hifoo, strict=True))
    worse = sum(r > 1.01 * h for r, h in zip(ratios, hifoo, strict=True))
    print(f"against HIFOO: more than 1 % better on {better}, more than 1 % worse on {worse}")
    print(f"CPU: median {statistics.median(times):.2f} s, largest {max(times):.2f} s")


if __name__ == "__main__":
    main()
