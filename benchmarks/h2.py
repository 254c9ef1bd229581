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
import statistics
from collections import defaultdict
from pathlib import Path

import numpy as np
from harness import compleib, heading, in_child, timed

from robustlab.errors import NoTrustworthyNumber
from robustlab.norms import h2_norm
from robustlab.statespace import StateSpaceModel, lower_lft
from robustlab.synthesis.h2.h2_synthesis import h2

# The child's own words; its limit counts from after the imports.
PEER = f"""
import json, sys, warnings
import control, numpy as np
sys.path.insert(0, {str(Path(__file__).parent)!r})
from harness import limit_cpu, timed
warnings.simplefilter("ignore")
p = json.load(sys.stdin)
P = control.ss(*(np.array(p[k]) for k in "ABCD"))
limit_cpu(p["limit"])
K, cpu = timed(control.h2syn, P, p["n_y"], p["n_u"])
print(json.dumps({{**{{k: getattr(K, k).tolist() for k in "ABCD"}}, "cpu": cpu}}))
"""


def ours(P: StateSpaceModel, n_y: int, n_u: int, gamma_rel: float) -> tuple[float, float, float, bool, str]:
    """Norm, CPU time, fastest pole, whether the infimum is attained, and why there is none."""
    steps: list[str] = []

    def designed() -> object:
        try:
            return h2(P, n_y, n_u, gamma_rel=gamma_rel, progress=steps.append)
        except NoTrustworthyNumber as error:
            return error.found

    design, cpu = timed(designed)
    if isinstance(design, str):
        return np.inf, cpu, np.nan, False, design
    norms = sorted({float(step.rsplit(" ", 1)[1]) for step in steps if "H2 norm" in step})
    settled = not design.regularisation or (
        design.regularised_norm <= 1.001 * design.gamma and norms[min(1, len(norms) - 1)] <= 1.001 * norms[0]
    )
    # The norm of K as returned, with the rounding of a cancelled direct term taken out by h2 itself.
    loop = lower_lft(P, design.K) if not design.K.D.any() else design.closed_loop
    return h2_norm(loop).value, cpu, design.fastest_controller_pole, settled, ""


def peer(P: StateSpaceModel, n_y: int, n_u: int, limit: float) -> tuple[float, float, str]:
    problem = {**{k: getattr(P, k).tolist() for k in "ABCD"}, "n_y": n_y, "n_u": n_u, "limit": limit}
    found = in_child(["-c", PEER], json.dumps(problem), limit)
    if "refused" in found:
        return np.inf, limit, "no return" if found["refused"] == "no return" else "refused"
    matrices = [np.array(found[k], dtype=float) for k in "ABCD"]
    if not all(np.isfinite(m).all() for m in matrices):
        return np.inf, found["cpu"], "not finite"
    norm = h2_norm(lower_lft(P, StateSpaceModel(*matrices))).value
    return norm, found["cpu"], "" if np.isfinite(norm) else "no finite norm"


def main() -> None:
    parser = argparse.ArgumentParser(description="H2 synthesis on COMPleib plants.")
    parser.add_argument("names", nargs="*")
    parser.add_argument("--states", type=int, default=60)
    parser.add_argument("--cpu-limit", type=float, default=5.0)
    parser.add_argument("--no-peer", action="store_true")
    options = parser.parse_args()
    print(heading("numpy", "scipy", "slycot", "control"), flush=True)
    tiny = StateSpaceModel([[-1.0]], [[1, 0, 1]], [[1], [0], [1]], [[0, 0, 0], [0, 0, 1], [0, 1, 0]])
    h2(tiny, 1, 1)  # imports do not count
    columns: dict[str, list[tuple[float, float, bool]]] = defaultdict(list)
    slower, twenty, refused = [], [], 0
    for name, matrices, about in compleib(options.names, options.states):
        P, n_y, n_u = StateSpaceModel(*matrices.values()), int(about["ny"]), int(about["nu"])
        best = float(about.get("h2_full_best_verified", np.nan))
        tight, tight_cpu, tight_pole, settled, why = ours(P, n_y, n_u, 1.0)
        default, cpu, pole, _, _ = ours(P, n_y, n_u, 1.0005)
        twenty += [cpu] * int(about["n"] == 20 and not why)
        rows = {"robustlab, gamma_rel = 1": (tight, tight_cpu), "robustlab, default": (default, cpu)}
        line = f"{name:10s} n={about['n']:3d}  best known {best:10.5g}  tight {tight / best:8.5f} {tight_cpu:6.3f} s"
        line += f"  default {default / best:8.5f} {cpu:6.3f} s, fastest pole / {tight_pole / pole:8.3g}"
        line += "" if settled or why else "  not attained"
        if not options.no_peer:
            *rows["control.h2syn"], other_why = peer(P, n_y, n_u, options.cpu_limit)
            line += f"  control {rows['control.h2syn'][0] / best:9.5g} {other_why}"
        print(f"{line}  {why}", flush=True)
        if why or not np.isfinite(best):
            refused += 1
            continue
        slower.append(tight_pole / pole)
        for title, (norm, spent) in rows.items():
            columns[title].append((norm / best, spent, settled))
    print(f"\n{refused} plants without a finite H2 norm for any controller (direct term from w to z), as the reference")
    for title, found in columns.items():
        n, ratios, cpu = len(found), [r for r, _, _ in found], [t for _, t, _ in found]
        shares = "  ".join(f"<= {limit}: {sum(r <= limit for r in ratios)}/{n}" for limit in (1.001, 1.01))
        times = f"CPU median {statistics.median(cpu):.3f} s, max {max(cpu):.3f} s"
        print(f"{title:28s} finite {sum(map(np.isfinite, ratios))}/{n}  {shares}  {times}")
    print("where the infimum is attained:")
    for title, found in columns.items():
        if ratios := [r for r, _, settled in found if settled]:
            print(f"{title:28s} <= 1.001: {sum(r <= 1.001 for r in ratios)}/{len(ratios)}, worst {max(ratios):.5f}")
    print(f"CPU at n = 20: {', '.join(f'{t:.3f}' for t in twenty)} s")
    print(f"fastest controller pole, tight / default: median {statistics.median(slower):.3g}")


if __name__ == "__main__":
    main()
