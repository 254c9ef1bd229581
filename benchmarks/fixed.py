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
import statistics
from typing import Any

import numpy as np
from harness import compleib, heading, in_child, limit_cpu, over_best, timed

from robustlab import fixed_structure
from robustlab.errors import NoTrustworthyNumber
from robustlab.norms import hinf_norm
from robustlab.statespace import StateSpaceModel, lower_lft


def child(name: str, starts: int, limit: float) -> dict[str, Any]:
    """One design: its certified norm and CPU time."""
    limit_cpu(limit)
    ((_, matrices, about),) = compleib([name])
    P, n_y, n_u = StateSpaceModel(*matrices.values()), int(about["ny"]), int(about["nu"])
    tiny = StateSpaceModel([[1.0]], [[1.0, 1.0]], [[1.0], [0.0], [1.0]], [[0, 0], [0, 1], [0, 0]])
    fixed_structure(tiny, "static", n_meas=1, n_con=1, objective="h2", starts=0)  # imports

    def designed() -> tuple[float, str]:
        try:
            design = fixed_structure(P, "static", n_meas=n_y, n_con=n_u, starts=starts, effort=10.0)
        except NoTrustworthyNumber as error:
            return float("inf"), error.found
        norm = hinf_norm(lower_lft(P, design.K))
        return norm.upper, "" if norm.status.trustworthy else norm.reason

    (gamma, why), cpu = timed(designed)
    return {"gamma": gamma, "cpu": cpu, "why": why}


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("names", nargs="*", metavar="NAME")
    parser.add_argument("--states", type=int, default=16)
    parser.add_argument("--cpu-limit", type=int, default=120)
    parser.add_argument("--starts", type=int, default=16)
    parser.add_argument("--child", action="store_true")
    options = parser.parse_args()
    if options.child:
        print(json.dumps(child(options.names[0], options.starts, options.cpu_limit)))
        return
    print(heading("numpy", "scipy"), flush=True)
    rows: list[tuple[float, float, float]] = []  # our ratio, HIFOO's, CPU
    for name, _, about in compleib(options.names, options.states):
        if "static_hinf_best" not in about:
            continue
        limits = ["--starts", str(options.starts), "--cpu-limit", str(options.cpu_limit)]
        found = in_child([__file__, "--child", *limits, name], "", options.cpu_limit)
        found = {"gamma": float("inf"), "why": found.get("refused", "")} | found
        best, other = float(about["static_hinf_best"]), float(about.get("static_hinf_hifoo3501_measured", np.inf))
        ratio, theirs = (over_best(x, best, about["infimum_looks_zero"]) for x in (found["gamma"], other))
        rows.append((ratio, theirs, found["cpu"]))
        line = f"{name:10s} n={about['n']:3d}  {about['nu'] * about['ny']:3d} gains  norm {found['gamma']:12.6g}"
        line += f"  / best {ratio:9.5f}  HIFOO / best {theirs:9.5f}  {found['cpu']:6.2f} s  {found['why']}"
        print(line.rstrip(), flush=True)
    ratios, hifoo, times = zip(*rows, strict=True)
    print(f"\n{len(rows)} plants, n <= {options.states}; {options.starts} random starts besides the own one")
    for title, values in (("robustlab", ratios), ("HIFOO 3.501", hifoo)):
        shares = (f"<= {most:g}: {np.mean(np.array(values) <= most):.1%}" for most in (0.99, 1.001, 1.01, 1.05))
        print(f"{title:12s} {'  '.join(shares)}")
    better = sum(r < 0.99 * h for r, h in zip(ratios, hifoo, strict=True))
    worse = sum(r > 1.01 * h for r, h in zip(ratios, hifoo, strict=True))
    print(f"against HIFOO: more than 1 % better on {better}, more than 1 % worse on {worse}")
    print(f"CPU: median {statistics.median(times):.2f} s, largest {max(times):.2f} s")


if __name__ == "__main__":
    main()
