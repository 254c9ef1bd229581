"""H2 synthesis on COMPleib plants, beside control.h2syn (slycot sb10hd): norm against the best known, and CPU time.

    python benchmarks/h2.py [--states 60] [--cpu-limit 5] [--no-peer] [NAME ...]

The norm is computed again on the plant from the returned K. A plant counts as attained where a controller reaches the
infimum to 0.1 %: where it does not, the norm falls for ever as regularisation goes to zero (in the tight run, the
regularised optimum is still more than 0.1 % above the norm, or a step of ten gained more than 0.1 %), and a ratio
compares two arbitrary stops. control.h2syn runs in a child with a limit on its CPU time.
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
from robustlab.norms import h2_norm
from robustlab.statespace import StateSpaceModel, lower_lft
from robustlab.synthesis.h2.h2_synthesis import h2

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
K = control.h2syn(P, p["n_y"], p["n_u"])
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


def true_norm(P: StateSpaceModel, K: StateSpaceModel) -> float:
    return h2_norm(lower_lft(P, K)).value


def ours(P: StateSpaceModel, n_y: int, n_u: int, gamma_rel: float) -> tuple[float, float, float, bool, str]:
    """Norm, CPU time, fastest pole, whether the infimum is attained, and why there is none."""
    steps: list[str] = []
    start = time.process_time()
    try:
        design = h2(P, n_y, n_u, gamma_rel=gamma_rel, progress=steps.append)
    except NoTrustworthyNumber as error:
        return np.inf, time.process_time() - start, np.nan, False, error.found
    cpu = time.process_time() - start
    norms = sorted({float(step.rsplit(" ", 1)[1]) for step in steps if "H2 norm" in step})
    settled = not design.regularisation or (
        design.regularised_norm <= 1.001 * design.gamma and norms[min(1, len(norms) - 1)] <= 1.001 * norms[0]
    )
    # The norm of K as returned, with the rounding of a cancelled direct term taken out by h2 itself.
    norm = true_norm(P, design.K) if not design.K.D.any() else h2_norm(design.closed_loop).value
    return norm, cpu, design.fastest_controller_pole, settled, ""


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
    norm = true_norm(P, StateSpaceModel(*matrices))
    return norm, found["cpu"], "" if np.isfinite(norm) else "no finite norm"


def summary(title: str, ratios: list[float], cpu: list[float]) -> str:
    n = len(ratios)
    within = {limit: sum(r <= limit for r in ratios) for limit in (1.001, 1.01)}
    shares = "  ".join(f"<= {limit}: {count}/{n}" for limit, count in within.items())
    times = f"CPU median {statistics.median(cpu):.3f} s, max {max(cpu):.3f} s"
    return f"{title:28s} finite {sum(map(np.isfinite, ratios))}/{n}  {shares}  {times}"


def main() -> None:
    parser = argparse.ArgumentParser(description="H2 synthesis on COMPleib plants.")
    parser.add_argument("names", nargs="*")
    parser.add_argument("--states", type=int, default=60)
    parser.add_argument("--cpu-limit", type=float, default=5.0)
    parser.add_argument("--no-peer", action="store_true")
    options = parser.parse_args()
    chosen = plants(options.names, options.states)
    h2(chosen[0][1], int(chosen[0][2]["ny"]), int(chosen[0][2]["nu"]))  # imports do not count
    columns: dict[str, tuple[list[float], list[float]]] = {}
    attained: dict[str, list[float]] = {}
    slower, twenty, refused = [], [], 0
    for name, P, about in chosen:
        n_y, n_u, best = int(about["ny"]), int(about["nu"]), float(about.get("h2_full_best_verified", np.nan))
        tight, tight_cpu, tight_pole, settled, why = ours(P, n_y, n_u, 1.0)
        default, cpu, pole, _, _ = ours(P, n_y, n_u, 1.0005)
        twenty += [cpu] * int(about["n"] == 20 and not why)
        rows = {"robustlab, gamma_rel = 1": (tight, tight_cpu), "robustlab, default": (default, cpu)}
        line = f"{name:10s} n={about['n']:3d}  best known {best:10.5g}  tight {tight / best:8.5f} {tight_cpu:6.3f} s"
        line += f"  default {default / best:8.5f} {cpu:6.3f} s, fastest pole / {tight_pole / pole:8.3g}"
        line += "" if settled or why else "  not attained"
        if not options.no_peer:
            other, other_cpu, other_why = peer(P, n_y, n_u, options.cpu_limit)
            rows["control.h2syn"] = (other, other_cpu)
            line += f"  control {other / best:9.5g} {other_why}"
        print(f"{line}  {why}", flush=True)
        if why or not np.isfinite(best):
            refused += 1
            continue
        slower.append(tight_pole / pole)
        for title, (norm, time_taken) in rows.items():
            ratios, times = columns.setdefault(title, ([], []))
            ratios.append(norm / best)
            times.append(time_taken)
            if settled:
                attained.setdefault(title, []).append(norm / best)
    print(f"\n{refused} plants without a finite H2 norm for any controller (direct term from w to z), as the reference")
    for title, (ratios, times) in columns.items():
        print(summary(title, ratios, times))
    print("where the infimum is attained:")
    for title, ratios in attained.items():
        within = sum(r <= 1.001 for r in ratios)
        print(f"{title:28s} <= 1.001: {within}/{len(ratios)}, worst {max(ratios):.5f}")
    print(f"CPU at n = 20: {', '.join(f'{t:.3f}' for t in twenty)} s")
    print(f"fastest controller pole, tight / default: median {statistics.median(slower):.3g}")


if __name__ == "__main__":
    main()
