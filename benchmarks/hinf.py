"""H-infinity synthesis on the COMPleib plants, beside control.hinfsyn, raw slycot sb10ad and dkpy's HinfSynLmi.

    python benchmarks/hinf.py [--most-states 60] [--cpu-limit 20] [--tools ours,control,sb10ad,dkpy] [NAME ...]

Every tool runs each plant in a child process with a limit on its CPU time (from after its imports) and on its wall
clock: Fortran cannot be interrupted and does not always return. The controllers come back, and the *true* norm of each
loop is the largest that three voices give: `robustlab.norms.hinf_norm`, a dense grid with zoom written here with numpy
alone, and the gain at the peak that slycot's ab13dd names (in a child; its own figure is not taken: on stiff loops
its scaling makes it wrong, on AC7 by a factor of 178 against exact arithmetic). An unstable loop has no norm. "Best
known" is the smallest verified norm in the data; where the infimum looks like zero a norm of at most 1e-2 counts as
reached. A false claim is a gamma that the tool states and the true norm exceeds by more than 0.1 %.

dkpy is left out where it is not installed, and for more than 12 states.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import statistics
import sys
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from harness import COMPLEIB, compleib, heading, in_child, limit_cpu, over_best, timed

TITLES = {
    "tight": "robustlab, gamma_rel = 1",
    "default": "robustlab, default (1.05)",
    "control": "control.hinfsyn",
    "sb10ad": "slycot sb10ad, told 10 x best",
    "dkpy": "dkpy HinfSynLmi, Clarabel",
}
LMI_STATES = 12


def child(tool: str, limit: float) -> None:
    """Read a plant from stdin, design, print the controller, the gamma claimed, and the CPU time."""
    import warnings

    warnings.simplefilter("ignore")
    problem = json.load(sys.stdin)
    P = {k: np.array(problem[k], dtype=float) for k in "ABCD"}
    design = {"control": _control, "sb10ad": _sb10ad, "dkpy": _dkpy, "ab13dd": _ab13dd}.get(tool, _ours(tool))
    run = design(P, problem)  # imports happen here
    limit_cpu(limit)

    def answer() -> dict[str, Any]:
        try:
            return run()
        except Exception as error:  # noqa: BLE001  what a tool raises is its answer
            return {"refused": f"{type(error).__name__}: {error}"[:160]}

    found, cpu = timed(answer)
    print(json.dumps(found | {"cpu": cpu}))


def _listed(K: Any, gamma: Any) -> dict[str, Any]:
    return {k: np.asarray(getattr(K, k)).tolist() for k in "ABCD"} | {"gamma": float(gamma)}


def _ours(tool: str) -> Callable[..., Callable[[], dict[str, Any]]]:
    def prepare(P: dict[str, Any], problem: dict[str, Any]) -> Callable[[], dict[str, Any]]:
        from robustlab import hinf
        from robustlab.statespace import StateSpaceModel

        tiny = StateSpaceModel([[-1.0]], [[1, 0, 1]], [[1], [0], [1]], [[0, 0, 0], [0, 0, 1], [0, 1, 0]])
        hinf(tiny, 1, 1)  # scipy's imports are not the plant's time
        model = StateSpaceModel(*P.values())

        def run() -> dict[str, Any]:
            gamma_rel = 1.0 if tool == "tight" else 1.05
            design = hinf(model, problem["n_y"], problem["n_u"], gamma_rel=gamma_rel, time_limit=problem["limit"])
            facts = {"status": design.status.value, "lower": design.gamma_lower, "pole": design.fastest_controller_pole}
            return _listed(design.K, design.gamma) | facts

        return run

    return prepare


def _control(P: dict[str, Any], problem: dict[str, Any]) -> Callable[[], dict[str, Any]]:
    import control

    plant = control.ss(*P.values())
    return lambda: _listed(*control.hinfsyn(plant, problem["n_y"], problem["n_u"])[::2])


def _sb10ad(P: dict[str, Any], problem: dict[str, Any]) -> Callable[[], dict[str, Any]]:
    import slycot

    sizes = P["A"].shape[0], P["B"].shape[1], P["C"].shape[0], problem["n_u"], problem["n_y"], problem["start"]

    def run() -> dict[str, Any]:
        gamma, *K = slycot.sb10ad(*sizes, *P.values())[:5]
        return dict(zip("ABCD", (np.asarray(part).tolist() for part in K), strict=True)) | {"gamma": gamma}

    return run


def _dkpy(P: dict[str, Any], problem: dict[str, Any]) -> Callable[[], dict[str, Any]]:
    import control
    import dkpy  # pyright: ignore[reportMissingImports]

    plant = control.ss(*P.values())

    def run() -> dict[str, Any]:
        K, _, gamma, _ = dkpy.HinfSynLmi().synthesize(plant, problem["n_y"], problem["n_u"])
        return {"refused": "no controller"} if K is None else _listed(K, gamma)

    return run


def _ab13dd(P: dict[str, Any], problem: dict[str, Any]) -> Callable[[], dict[str, Any]]:
    from slycot import ab13dd

    n, m, q = P["A"].shape[0], P["B"].shape[1], P["C"].shape[0]
    given = "C", "I", "S", "D", n, m, q, P["A"], np.eye(n), P["B"], P["C"], P["D"], 1e-8
    return lambda: dict(zip(("gamma", "peak"), ab13dd(*given), strict=True))


def asked(tool: str, problem: dict[str, Any], limit: float) -> dict[str, Any]:
    text = json.dumps(problem | {"limit": limit})
    return in_child([__file__, "--child", tool, "--cpu-limit", str(limit)], text, limit)


def loop_of(P: dict[str, Any], K: dict[str, Any]) -> dict[str, Any]:
    """Lower LFT for D22 = 0, ``u = K y``."""
    n_u, n_y = K["D"].shape
    B1, B2, C1, C2 = P["B"][:, :-n_u], P["B"][:, -n_u:], P["C"][:-n_y], P["C"][-n_y:]
    D11, D12, D21 = P["D"][:-n_y, :-n_u], P["D"][:-n_y, -n_u:], P["D"][-n_y:, :-n_u]
    return {
        "A": np.block([[P["A"] + B2 @ K["D"] @ C2, B2 @ K["C"]], [K["B"] @ C2, K["A"]]]),
        "B": np.vstack([B1 + B2 @ K["D"] @ D21, K["B"] @ D21]),
        "C": np.hstack([C1 + D12 @ K["D"] @ C2, D12 @ K["C"]]),
        "D": D11 + D12 @ K["D"] @ D21,
    }


def gains(loop: dict[str, Any], omega: np.ndarray) -> np.ndarray:
    eye = np.eye(len(loop["A"]))
    found = []
    for part in np.array_split(omega, max(1, len(omega) // 200)):
        x = np.linalg.solve(1j * part[:, None, None] * eye - loop["A"], loop["B"][None].astype(complex))
        found.append(np.linalg.svd(loop["C"] @ x + loop["D"], compute_uv=False)[:, 0])
    return np.concatenate(found)


def grid_norm(loop: dict[str, Any]) -> float:
    """Largest gain on 1500 frequencies and at all poles, zoomed in upon; from below, by nothing but evaluation."""
    poles = np.linalg.eigvals(loop["A"])
    if poles.real.max() >= 0:
        return np.inf
    size = np.abs(poles)
    omega = np.concatenate([[0.0], size, np.abs(poles.imag), np.geomspace(size.min() / 100, size.max() * 100, 1500)])
    try:
        omega = np.unique(omega)
        values = gains(loop, omega)
        best = max(float(values.max()), float(np.linalg.norm(loop["D"], 2)))
        for k in np.argsort(-values)[:8]:
            low, high = omega[max(k - 1, 0)], omega[min(k + 1, len(omega) - 1)]
            for _ in range(6):
                points = np.linspace(low, high, 15)
                fine = gains(loop, points)
                best, top = max(best, float(fine.max())), int(fine.argmax())
                low, high = points[max(top - 1, 0)], points[min(top + 1, 14)]
    except np.linalg.LinAlgError:
        return np.nan
    return best


def true_norm(P: dict[str, Any], K: dict[str, Any]) -> tuple[float, list[float]]:
    """Largest of three norms of the loop, and all three; infinite for an unstable loop."""
    from robustlab.norms import hinf_norm
    from robustlab.statespace import StateSpaceModel

    loop = loop_of(P, K)
    if not all(np.isfinite(part).all() for part in loop.values()):
        return np.nan, []
    ours = hinf_norm(StateSpaceModel(*loop.values())).lower
    peak = asked("ab13dd", {k: v.tolist() for k, v in loop.items()}, 10.0).get("peak", np.nan)
    third = float(gains(loop, np.array([peak]))[0]) if np.isfinite(peak) else np.nan
    voices = [ours, grid_norm(loop), third]
    return float(np.nanmax(voices)), voices


Column = defaultdict[str, list[Any]]  # what became of a tool's answers


def row(title: str, column: Column) -> str:
    ratios, cpu = column["ratios"], column["cpu"]
    counts = [sum(r <= limit for r in ratios) for limit in (1.001, 1.01, 1.05)]
    cells = [sum(map(np.isfinite, ratios)), *counts]
    cells += [len(column[what]) for what in ("false claims", "unstable", "no return", "refused")]
    times = f"{statistics.median(cpu):7.2f} {max(cpu):7.2f}" if cpu else ""
    return f"{title:30s} {len(ratios):3d} " + " ".join(f"{c:7d}" for c in cells) + " " + times


def judge(name: str, P: dict[str, Any], about: dict[str, Any], answer: dict[str, Any], column: Column) -> str:
    """Enter one answer into the column; a short text about it."""
    column["cpu"].append(answer["cpu"])
    if "refused" in answer:
        column["no return" if answer["refused"] == "no return" else "refused"].append(name)
        column["ratios"].append(np.inf)
        return answer["refused"][:60]
    K = {k: np.array(answer[k], dtype=float).reshape(len(answer[k]), -1) for k in "ABCD"}
    n_u, n_y = int(about["nu"]), int(about["ny"])
    if not K["A"].size:
        K = {"A": np.zeros((0, 0)), "B": np.zeros((0, n_y)), "C": np.zeros((n_u, 0)), "D": K["D"]}
    norm, voices = true_norm(P, K)
    if not np.isfinite(norm):
        column["unstable"].append(name)
        column["ratios"].append(np.inf)
        return "unstable loop returned as a success"
    if np.isfinite(voices).all() and norm > 0:
        column["voices"].append(norm / min(voices) - 1)
    claim = answer["gamma"]
    false = norm > 1.001 * claim + 1e-12
    if false:
        column["false claims"].append(f"{name} {claim:.4g} -> {norm:.4g}")
    column["ratios"].append(over_best(norm, about["gamma_full_best_verified"], about["infimum_looks_zero"]))
    return f"{column['ratios'][-1]:9.5f} {answer['cpu']:6.2f} s" + (" FALSE CLAIM" if false else "")


def main() -> None:
    parser = argparse.ArgumentParser(description="H-infinity synthesis on COMPleib plants.")
    parser.add_argument("names", nargs="*")
    parser.add_argument("--most-states", type=int, default=60)
    parser.add_argument("--cpu-limit", type=float, default=20.0)
    parser.add_argument("--tools", default="ours,control,sb10ad,dkpy")
    parser.add_argument("--data", type=Path, default=COMPLEIB)
    parser.add_argument("--child", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.child:
        child(options.child, options.cpu_limit)
        return
    print(heading("numpy", "scipy", "slycot", "control", "cvxpy-base", "clarabel", "dkpy"))
    print(f"# kill limit of every call {options.cpu_limit:g} s of CPU", flush=True)
    tools = [t for t in options.tools.replace("ours", "tight,default").split(",") if t in TITLES]
    if importlib.util.find_spec("dkpy") is None and "dkpy" in tools:
        tools.remove("dkpy")
    columns: dict[str, Column] = {tool: defaultdict(list) for tool in tools}
    poles: list[float] = []
    for name, P, about in compleib(options.names, options.most_states, options.data):
        best = max(float(about["gamma_full_best_verified"]), 1e-3)
        problem = {k: v.tolist() for k, v in P.items()}
        problem |= {"n_y": int(about["ny"]), "n_u": int(about["nu"]), "start": 10 * best}
        texts, pole = [], {}
        for tool in tools:
            if tool == "dkpy" and about["n"] > LMI_STATES:
                continue
            answer = asked(tool, problem, options.cpu_limit if tool not in ("tight", "default") else 60.0)
            pole[tool] = answer.get("pole", np.nan)
            texts.append(f"{tool} {judge(name, P, about, answer, columns[tool])}")
        poles.append(pole.get("tight", np.nan) / pole.get("default", np.nan))
        print(f"{name:10s} n={about['n']:3d}  " + "  | ".join(texts), flush=True)
    header = ("plants", "finite", "<=1.001", "<=1.01", "<=1.05", "false", "unstabl", "no ret.", "refused")
    print(f"\n{'':27s} " + " ".join(f"{h:>7s}" for h in header)[1:] + "  CPU s: median, max")
    for tool, column in columns.items():
        print(row(TITLES[tool], column))
    for tool, column in columns.items():
        if column["false claims"]:
            print(f"false claims of {TITLES[tool]}: {'; '.join(column['false claims'])}")
        if column["voices"]:
            print(f"three voices on the loops of {TITLES[tool]} differ by at most {max(column['voices']):.2g}")
    if np.isfinite(poles).any():
        print(f"fastest controller pole, tight / default: median {np.nanmedian(poles):.3g}")


if __name__ == "__main__":
    main()
