"""H-infinity synthesis on COMPleib plants, beside control.hinfsyn: share solved, and CPU time.

    python benchmarks/hinf.py [--states 24] [--cpu-limit 5] [--no-peer] [NAME ...]

A plant counts as solved to 0.1 % where the *true* norm of the loop, computed on the plant from the returned K, is at
most 1.001 times the best that is known (or at most 1e-2 where the infimum looks like zero). control.hinfsyn runs in a
child with a limit on its CPU time: its Fortran cannot be interrupted and does not always return.
"""

from __future__ import annotations

import argparse
import json
import signal
import statistics
import subprocess
import sys
import time
from pathlib import Path

import h5py
import numpy as np

from robustlab.errors import NoTrustworthyNumber
from robustlab.norms import hinf_norm
from robustlab.statespace import StateSpaceModel, lower_lft
from robustlab.synthesis import hinf

COMPLEIB = Path(__file__).parents[2] / "shared" / "data" / "compleib.h5"

# The child's own words; its limit counts from after the imports.
PEER = """
import json, resource, sys, time, warnings
import control, numpy as np
warnings.simplefilter("ignore")
p = json.load(sys.stdin)
P = control.ss(*(np.array(p[k]) for k in "ABCD"))
start = time.process_time()
limit = int(start + p["limit"]) + 1
resource.setrlimit(resource.RLIMIT_CPU, (limit, limit))
K = control.hinfsyn(P, p["n_y"], p["n_u"])[0]
cpu = time.process_time() - start
print(json.dumps({"A": K.A.tolist(), "B": K.B.tolist(), "C": K.C.tolist(), "D": K.D.tolist(), "cpu": cpu}))
"""


def plants(names: list[str], states: int) -> list[tuple[str, StateSpaceModel, dict]]:
    found = []
    with h5py.File(COMPLEIB) as file:
        for name in sorted(names or file, key=lambda k: (file[k].attrs["n"], k)):
            group, about = file[name], dict(file[name].attrs)
            if about["stabilisable"] and (names or about["n"] <= states):
                m = {key: group[key][()] for key in group}
                D = np.block([[m["D11"], m["D12"]], [m["D21"], np.zeros((about["ny"], about["nu"]))]])
                P = StateSpaceModel(m["A"], np.hstack([m["B1"], m["B"]]), np.vstack([m["C1"], m["C"]]), D)
                found.append((name, P, about))
    return found


def true_gamma(P: StateSpaceModel, K: StateSpaceModel) -> float:
    return hinf_norm(lower_lft(P, K)).value


def ours(P: StateSpaceModel, n_y: int, n_u: int, gamma_rel: float) -> tuple[float, float, float]:
    start = time.process_time()
    try:
        design = hinf(P, n_y, n_u, gamma_rel=gamma_rel)
    except NoTrustworthyNumber:
        return np.inf, time.process_time() - start, np.inf
    return true_gamma(P, design.K), time.process_time() - start, design.fastest_controller_pole


def peer(P: StateSpaceModel, n_y: int, n_u: int, limit: float) -> tuple[float, float, str]:
    problem = {**{k: getattr(P, k).tolist() for k in "ABCD"}, "n_y": n_y, "n_u": n_u, "limit": limit}
    done = subprocess.run(
        [sys.executable, "-c", PEER], input=json.dumps(problem), capture_output=True, text=True, check=False
    )
    if done.returncode:
        killed = done.returncode in (-signal.SIGXCPU, -signal.SIGKILL)
        return np.inf, limit, "no return" if killed else "refused"
    found = json.loads(done.stdout)
    matrices = [np.array(found[k], dtype=float) for k in "ABCD"]
    if not all(np.isfinite(m).all() for m in matrices):
        return np.inf, found["cpu"], "not finite"
    gamma = true_gamma(P, StateSpaceModel(*matrices))
    return gamma, found["cpu"], "" if np.isfinite(gamma) else "unstable loop"


def ratio(gamma: float, about: dict) -> float:
    if about["infimum_looks_zero"]:
        return 1.0 if gamma <= 1e-2 else np.inf
    return gamma / about["gamma_full_best_verified"]


def summary(title: str, ratios: list[float], cpu: list[float]) -> str:
    n = len(ratios)
    within = {limit: sum(r <= limit for r in ratios) for limit in (1.001, 1.01, 1.05)}
    shares = "  ".join(f"<= {limit}: {count}/{n}" for limit, count in within.items())
    times = f"CPU median {statistics.median(cpu):.2f} s, max {max(cpu):.2f} s"
    return f"{title:28s} finite {sum(map(np.isfinite, ratios))}/{n}  {shares}  {times}"


def main() -> None:
    parser = argparse.ArgumentParser(description="H-infinity synthesis on COMPleib plants.")
    parser.add_argument("names", nargs="*")
    parser.add_argument("--states", type=int, default=24)
    parser.add_argument("--cpu-limit", type=float, default=5.0)
    parser.add_argument("--no-peer", action="store_true")
    options = parser.parse_args()
    columns: dict[str, tuple[list[float], list[float]]] = {}
    slower = []
    for name, P, about in plants(options.names, options.states):
        n_y, n_u = int(about["ny"]), int(about["nu"])
        tight, tight_cpu, tight_pole = ours(P, n_y, n_u, 1.0)
        soft, soft_cpu, soft_pole = ours(P, n_y, n_u, 1.05)
        slower.append(tight_pole / soft_pole)
        line = f"{name:10s} n={about['n']:3d}  tight {ratio(tight, about):9.5f} {tight_cpu:6.2f} s"
        line += f"   default {ratio(soft, about):9.5f} {soft_cpu:6.2f} s, fastest pole / {slower[-1]:.3g}"
        rows = {"robustlab, gamma_rel = 1": (tight, tight_cpu), "robustlab, default (1.05)": (soft, soft_cpu)}
        if not options.no_peer:
            other, other_cpu, why = peer(P, n_y, n_u, options.cpu_limit)
            rows["control.hinfsyn"] = (other, other_cpu)
            line += f"   control {ratio(other, about):9.5g} {why}"
        print(line, flush=True)
        for title, (gamma, cpu) in rows.items():
            ratios, times = columns.setdefault(title, ([], []))
            ratios.append(ratio(gamma, about))
            times.append(cpu)
    print()
    for title, (ratios, times) in columns.items():
        print(summary(title, ratios, times))
    print(f"fastest controller pole, tight / default: median {statistics.median(slower):.3g}")


if __name__ == "__main__":
    main()
