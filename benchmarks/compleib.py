"""Compare synthesis on the COMPleib plants with peers: norms over the best known, false claims, CPU time.

    python benchmarks/compleib.py --what hinf|h2|static [--most-states 60] [--cpu-limit 20] [--data FILE] [NAME ...]

hinf: `rl.hinf` (smallest gamma, and the default), control.hinfsyn, slycot sb10ad from ten times the best. h2: `rl.h2`
and control.h2syn. static: `rl.fixed_structure`, with the figures of HIFOO 3.501 from the data. Every tool designs each
plant in a child process with a limit of CPU time after its imports: Fortran code does not always return.

The norm of each loop is then computed again. For H-infinity it is the larger of `rl.peak_gain` and a dense refined grid
with numpy alone; an unstable loop has no norm. If the infimum seems to be zero, a norm of at most 1e-2 counts as
reached. A false claim is a gamma that the true norm exceeds by more than 0.1 %.
"""

from __future__ import annotations

import json
import sys
import warnings
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from harness import heading, in_child, limit_cpu, middle_and_most, options, timed

import robustlab as rl

DATA = Path(__file__).parents[2] / "shared" / "data" / "compleib.h5"
Parts = dict[str, Any]  # A, B, C, D
Run = Callable[[], tuple[Any, float]]  # a controller and its gamma


def plants(
    names: Sequence[str] = (), most: float = np.inf, data: Path = DATA
) -> list[tuple[str, Parts, dict[str, Any]]]:
    """Name, A B C D (w before u, z before y) and facts of the stabilisable plants: these, or up to a size."""
    import h5py

    found = []
    with h5py.File(data) as file:
        table: Any = file
        for name in sorted(names or table, key=lambda k: (table[k].attrs["n"], k)):
            m, about = {key: table[name][key][()] for key in table[name]}, dict(table[name].attrs)
            if about["stabilisable"] and (names or about["n"] <= most):
                D = np.block([[m["D11"], m["D12"]], [m["D21"], np.zeros((about["ny"], about["nu"]))]])
                P = {"A": m["A"], "B": np.hstack([m["B1"], m["B"]]), "C": np.vstack([m["C1"], m["C"]]), "D": D}
                found.append((name, P, about))
    return found


def _ours(design: Callable[..., Any], **how: Any) -> Callable[[Parts, int, int, float], Run]:
    def prepared(P: Parts, n_y: int, n_u: int, start: float) -> Run:
        tiny = rl.StateSpaceModel([[-1.0]], [[1, 0, 1]], [[1], [0], [1]], [[0, 0, 0], [0, 0, 1], [0, 1, 0]])
        design(tiny, n_meas=1, n_con=1, **how)  # imports and compilation are not the plant's time
        model = rl.StateSpaceModel(*P.values())

        def run() -> tuple[Any, float]:
            found = design(model, n_meas=n_y, n_con=n_u, **how)
            return found.K, found.gamma

        return run

    return prepared


def _control(name: str) -> Callable[[Parts, int, int, float], Run]:
    def prepared(P: Parts, n_y: int, n_u: int, start: float) -> Run:
        import control

        plant, design = control.ss(*P.values()), getattr(control, name)
        return lambda: design(plant, n_y, n_u)[::2] if name == "hinfsyn" else (design(plant, n_y, n_u), np.inf)

    return prepared


def _sb10ad(P: Parts, n_y: int, n_u: int, start: float) -> Run:
    import slycot

    sizes = P["A"].shape[0], P["B"].shape[1], P["C"].shape[0], n_u, n_y, start

    def run() -> tuple[Any, float]:
        gamma, *K = slycot.sb10ad(*sizes, *P.values())[:5]
        return rl.StateSpaceModel(*K), gamma

    return run


TOOLS: dict[str, dict[str, Callable[[Parts, int, int, float], Run]]] = {
    "hinf": {
        "robustlab, gamma_rel = 1": _ours(rl.hinf, gamma_rel=1.0), "robustlab": _ours(rl.hinf),
        "control.hinfsyn": _control("hinfsyn"), "slycot sb10ad": _sb10ad,
    },
    "h2": {"robustlab": _ours(rl.h2), "control.h2syn": _control("h2syn")},
    "static": {"robustlab": _ours(rl.fixed_structure, effort=10.0)},
}  # fmt: skip
BEST = {"hinf": "gamma_full_best_verified", "h2": "h2_full_best_verified", "static": "static_hinf_best"}


def child() -> None:
    """Read a problem from stdin, design, print the controller, the gamma claimed, and the CPU time."""
    warnings.simplefilter("ignore")
    problem = json.load(sys.stdin)
    P = {k: np.array(problem[k], dtype=float) for k in "ABCD"}
    run = TOOLS[problem["what"]][problem["tool"]](P, problem["n_y"], problem["n_u"], problem["start"])
    limit_cpu(problem["limit"])

    def answer() -> dict[str, Any]:
        try:
            K, gamma = run()
        except Exception as error:  # noqa: BLE001  what a tool raises is its answer
            return {"refused": f"{type(error).__name__}: {error}"[:160]}
        return {k: np.asarray(getattr(K, k)).tolist() for k in "ABCD"} | {"gamma": float(gamma)}

    found, cpu = timed(answer)
    print(json.dumps(found | {"cpu": cpu}))


def closed(P: Parts, K: Parts) -> rl.StateSpaceModel:
    """Lower LFT for D22 = 0, ``u = K y``; a direct term that is rounding of what cancels in it is none."""
    n_u, n_y = K["D"].shape
    B1, B2, C1, C2 = P["B"][:, :-n_u], P["B"][:, -n_u:], P["C"][:-n_y], P["C"][-n_y:]
    D11, D12, D21 = P["D"][:-n_y, :-n_u], P["D"][:-n_y, -n_u:], P["D"][-n_y:, :-n_u]
    D, cancels = D11 + D12 @ K["D"] @ D21, np.abs(D11) + np.abs(D12) @ np.abs(K["D"]) @ np.abs(D21)
    A = np.block([[P["A"] + B2 @ K["D"] @ C2, B2 @ K["C"]], [K["B"] @ C2, K["A"]]])
    B, C = np.vstack([B1 + B2 @ K["D"] @ D21, K["B"] @ D21]), np.hstack([C1 + D12 @ K["D"] @ C2, D12 @ K["C"]])
    return rl.StateSpaceModel(A, B, C, D * (np.abs(D) > 1e-10 * cancels.max(initial=0.0)))


def grid_norm(loop: rl.StateSpaceModel) -> float:
    """Largest gain on 1500 frequencies and at all poles, zoomed in upon; from below, by nothing but evaluation."""

    def gains(omega: np.ndarray) -> np.ndarray:
        found = []
        for part in np.array_split(omega, max(1, len(omega) // 200)):
            x = np.linalg.solve(1j * part[:, None, None] * np.eye(loop.n_states) - loop.A, loop.B[None] + 0j)
            found.append(np.linalg.svd(loop.C @ x + loop.D, compute_uv=False)[:, 0])
        return np.concatenate(found)

    poles = np.linalg.eigvals(loop.A)
    if poles.real.max(initial=-1.0) >= 0:
        return np.inf
    size = np.abs(poles)
    omega = np.concatenate([[0.0], size, np.abs(poles.imag), np.geomspace(size.min() / 100, size.max() * 100, 1500)])
    omega = np.unique(omega)
    values = gains(omega)
    best = max(float(values.max()), float(np.linalg.norm(loop.D, 2)))
    for k in np.argsort(-values)[:8]:
        low, high = omega[max(k - 1, 0)], omega[min(k + 1, len(omega) - 1)]
        for _ in range(6):
            points = np.linspace(low, high, 15)
            fine = gains(points)
            best, top = max(best, float(fine.max())), int(fine.argmax())
            low, high = points[max(top - 1, 0)], points[min(top + 1, 14)]
    return best


def true_norm(what: str, P: Parts, answer: dict[str, Any]) -> float:
    """The norm of the loop rebuilt from the controller that came back; infinite where there is none."""
    n, (n_u, n_y) = len(answer["A"]), np.shape(answer["D"])
    shapes = {"A": (n, n), "B": (n, n_y), "C": (n_u, n), "D": (n_u, n_y)}
    K = {k: np.reshape(np.array(answer[k], dtype=float), shape) for k, shape in shapes.items()}
    if not all(np.isfinite(part).all() for part in K.values()):
        return np.inf
    loop = closed(P, K)
    if what == "h2":
        return rl.h2_norm(loop).value
    return max(rl.peak_gain(loop).lower, grid_norm(loop))


def main() -> None:
    given = options(__doc__, "*", what=tuple(TOOLS), most_states=60, cpu_limit=20.0, data=str(DATA), child=False)
    if given.child:
        child()
        return
    print(heading("numpy", "scipy", "slycot", "control", "clarabel"))
    tools = [*TOOLS[given.what], *(["HIFOO 3.501"] if given.what == "static" else [])]
    counts, columns = {tool: Counter() for tool in tools}, {tool: [] for tool in tools}
    for name, P, about in plants(given.names, given.most_states, Path(given.data)):
        if not np.isfinite(best := float(about.get(BEST[given.what], np.nan))):
            continue
        problem = {k: v.tolist() for k, v in P.items()} | {"what": given.what, "limit": given.cpu_limit}
        problem |= {"n_y": int(about["ny"]), "n_u": int(about["nu"]), "start": 10 * max(best, 1e-3)}
        words = []
        for tool in tools:
            if tool == "HIFOO 3.501":
                answer: dict[str, Any] = {"gamma": np.inf, "cpu": np.nan}
                norm = float(about.get("static_hinf_hifoo3501_measured", np.inf))
            else:
                answer = in_child([__file__, "--child"], json.dumps(problem | {"tool": tool}), given.cpu_limit)
                norm = np.inf if "refused" in answer else true_norm(given.what, P, answer)
            zero = given.what != "h2" and about["infimum_looks_zero"]
            ratio = (1.0 if norm <= 1e-2 else np.inf) if zero else norm / best
            false = np.isfinite(norm) and norm > 1.001 * answer.get("gamma", np.inf) + 1e-12
            ending = answer.get("refused", "" if np.isfinite(norm) else "unstable loop returned as a success")
            word = "refused" if "refused" in answer and ending != "no return" else ending.partition(" loop")[0]
            counts[tool][word] += bool(ending)
            counts[tool]["false claims"] += bool(false)
            columns[tool].append((ratio, answer["cpu"]))
            ending = " ".join(ending.split())[:60] + " FALSE CLAIM" * bool(false)
            words.append(f"{tool} {ratio:9.5f} {answer['cpu']:6.2f} s {ending}")
        print(f"{name:10s} n={about['n']:3d}  " + "  | ".join(words), flush=True)
    print(f"\n{'':28s} plants finite <=1.001 <=1.01 <=1.05  CPU s: median, max")
    for tool, rows in columns.items():
        ratios, times = zip(*rows, strict=True)
        reached = "".join(f"{sum(r <= most for r in ratios):7d}" for most in (np.finfo(float).max, 1.001, 1.01, 1.05))
        ends = ", ".join(f"{word} {n}" for word, n in counts[tool].items() if n)
        print(f"{tool:28s}{len(rows):7d}{reached}  {middle_and_most(times, '7.2f')}  {ends}")


if __name__ == "__main__":
    main()
