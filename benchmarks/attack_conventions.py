"""Random wrong combinations of saved plants and controllers through the commands: is a number about another loop?

Every trial saves a plant and a controller and gets something about them wrong: the order or the names of signals,
units, sample times, the sign that is asked for, where the controller comes from (a design, by hand, an older file, a
plain model, a digital one, JSON). What a command then prints is judged by a closing of the loop in this file, from the
matrices in the files and the loop in words that the command prints; and the words by what the trial knows of its
controller. Usage: python benchmarks/attack_conventions.py [trials] [seed]
"""

from __future__ import annotations

import contextlib
import io
import json
import platform
import sys
import tempfile
from collections import Counter
from datetime import date
from pathlib import Path

import h5py
import numpy as np

import robustlab as rl
from robustlab.cli import main
from robustlab.cli.ending import main_guard
from robustlab.signals import Taken

WORDS = ["q", "v", "omega", "theta", "i", "p", "height", "level"]
GRID = np.geomspace(1e-4, 1e4, 6000)
SIGN = {"y": 1, "-y": -1, "r - y": -1, "y - r": 1, "r": 0}


# --- what is tried ----------------------------------------------------------------------------------------------------


class Trial:
    """One plant, one controller, what is wrong about them, and what the trial knows."""

    def __init__(self, seed: int) -> None:
        rng = self.rng = np.random.default_rng(seed)
        n, self.p = int(rng.integers(2, 4)), int(rng.integers(1, 4))
        self.names = list(rng.permutation(WORDS)[: self.p])
        A = rng.normal(size=(n, n))
        A -= (np.linalg.eigvals(A).real.max() + rng.uniform(0.05, 1.0) - (rng.uniform() < 0.2) * 1.2) * np.eye(n)
        self.A, self.B, self.C = A, rng.normal(size=(n, 1)), rng.normal(size=(self.p, n))
        self.kind = str(rng.choice(["mixsyn", "ncf", "hinf", "by hand", "plain", "old", "unsaid"]))
        self.takes = "y"
        self.K = self.controller()
        self.wrong: list[str] = []

    def plant(self) -> rl.StateSpaceModel:
        return rl.StateSpaceModel(self.A, self.B, self.C, np.zeros((self.p, 1)), inputs=["u"], outputs=self.names)

    def controller(self) -> rl.StateSpaceModel:
        G, rng = self.plant(), self.rng
        if self.kind == "mixsyn" or (self.kind == "old" and rng.uniform() < 0.5):
            self.takes = "r - y"
            K = rl.mixsyn(G, float(rng.uniform(0.3, 2.0)), float(rng.uniform(0.1, 1.0))).K
            self.method = "mixsyn"
        elif self.kind == "hinf":
            noisy = rl.StateSpaceModel(
                G.A, np.hstack([G.B, np.zeros((len(G.A), self.p)), G.B]), np.vstack([G.C, 0 * G.B.T, G.C]),
                np.block([[np.zeros((self.p, self.p + 2))], [np.zeros((1, self.p + 1)), np.eye(1)],
                          [np.zeros((self.p, 1)), np.eye(self.p), np.zeros((self.p, 1))]]),
                inputs=["d", *(f"n{k}" for k in range(self.p)), "u"],
                outputs=[*(f"z{k}" for k in range(self.p)), "cost", *self.names],
            )  # fmt: skip
            K, self.method = rl.hinf(noisy, self.p, 1).K, "hinf"
        else:
            K, self.method = rl.ncf(G, float(rng.uniform(0.5, 4.0))).K, "ncf"
            if self.kind == "by hand":
                self.takes = str(rng.choice(["y", "-y", "r - y", "y - r"]))
                s = SIGN[self.takes]
                K = rl.StateSpaceModel(K.A, K.B, s * K.C, s * K.D, inputs=list(self.names), outputs=["u"])
        return K

    def save(self, folder: Path) -> None:
        """Plant and controller, with one or two things wrong."""
        rng, G, K = self.rng, self.plant(), self.K
        plain = [s.of if hasattr(s, "of") else s.name for s in K.inputs]
        held: object = rl.Controller(K, method=self.method)
        if self.kind == "by hand":
            held = rl.Controller(K, takes=self.takes)
        elif self.kind == "plain":
            held = K.renamed([f"u{k + 1}" for k in range(self.p)], ["y1"])
        elif self.kind == "unsaid":
            held = rl.Controller(K.renamed(plain))
        elif self.kind == "old":
            held = rl.Controller(K.renamed(list(K.input_names)), method=self.method)
        self.knows = self.kind not in ("plain", "unsaid")
        ways = [self.swap, self.rename, self.units, self.digital, self.json, self.negate, self.nothing, self.reverse_k]
        for way in rng.choice(len(ways), size=int(rng.integers(1, 3)), replace=False):
            G, held = ways[way](G, held)
        self.file = "k.json" if "json" in self.wrong else "k.h5"
        rl.save(folder / "g.h5", G)
        if self.file == "k.json":
            rl.export_controller(folder / "k.json", held)
        else:
            rl.save(folder / "k.h5", held)
        self.G, self.held = G, held
        self.meets = set(plain) <= {s.name for s in G.outputs}
        M = rl.StateSpaceModel(
            G.A,
            np.hstack([0.3 * rng.normal(size=(len(G.A), 1)), G.B]),
            np.vstack([rng.normal(size=(1, len(G.A))), G.C]),
            np.zeros((self.p + 1, 2)), G.dt, ["w", "u"], ["z", *G.outputs],
        )  # fmt: skip
        self.M = M
        rl.save(folder / "set.h5", rl.UncertainModel(M, [rl.RealScalar("delta")]))

    def with_model(self, held, model):
        return model if isinstance(held, rl.StateSpaceModel) else rl.Controller(model, method=held.method)

    def swap(self, G, held):
        self.wrong.append("plant's outputs in another order")
        order = list(self.rng.permutation(self.p))
        return G[[G.output_names[k] for k in order], :], held

    def reverse_k(self, G, held):
        K = held if isinstance(held, rl.StateSpaceModel) else held.K
        self.wrong.append("controller's inputs in another order")
        return G, self.with_model(held, K[:, [K.input_names[k] for k in self.rng.permutation(self.p)]])

    def rename(self, G, held):
        self.wrong.append("plant's outputs renamed")
        some = self.rng.uniform(size=self.p) < 0.7
        names = [(f"{n}2" if s else n, unit) for (n, unit), s in zip(G.outputs, some, strict=True)]
        return G.renamed(outputs=names), held

    def units(self, G, held):
        if not self.knows:
            return G, held
        K = held.K
        self.wrong.append("units differ")
        named = [Taken(s.name, "deg", s.takes, s.of) if isinstance(s, Taken) else (s.name, "deg") for s in K.inputs]
        return G.renamed(outputs=[(s.name, "rad") for s in G.outputs]), self.with_model(held, K.renamed(named))

    def digital(self, G, held):
        self.wrong.append("digital controller at a continuous plant")
        K = held if isinstance(held, rl.StateSpaceModel) else held.K
        return G, self.with_model(held, rl.discretise(K, 0.01, "tustin"))

    def json(self, G, held):
        if isinstance(held, rl.Controller):
            self.wrong.append("json")
        return G, held

    def negate(self, G, held):
        if self.kind != "by hand":
            return G, held
        self.wrong.append("-K, which takes the opposite")
        self.takes = {"y": "-y", "-y": "y", "r - y": "y - r", "y - r": "r - y"}[self.takes]
        return G, rl.Controller(-held.K)

    def nothing(self, G, held):
        self.wrong.append("nothing")
        return G, held


# --- how it is judged -------------------------------------------------------------------------------------------------


def run(folder: Path, *words: str) -> tuple[int, str, str]:
    out, err = io.StringIO(), io.StringIO()
    with contextlib.chdir(folder), contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = main_guard(lambda: main.run([*words]))
    return code, out.getvalue(), err.getvalue()


def printed_sign(loop: str) -> int:
    law = loop.split(",", maxsplit=1)[0].split(":", maxsplit=1)[0]
    return {"u = K y": 1, "u = K (y - r)": 1, "u = -K y": -1, "u = K (r - y)": -1}[law]


def columns(trial: Trial) -> list[int]:
    """For each output of the saved plant the input of K that meets it: by name, else by place; own code."""
    K = trial.held if isinstance(trial.held, rl.StateSpaceModel) else trial.held.K
    labels = [getattr(s, "of", s.name) for s in K.inputs]
    if trial.kind == "old" and trial.method == "mixsyn":
        labels = [name.removeprefix("e ") for name in labels]
    names = [s.name for s in trial.G.outputs]
    return [labels.index(n) for n in names] if set(labels) == set(names) else list(range(len(names)))


def closed(trial: Trial, sign: int) -> tuple[np.ndarray, ...]:
    """K in the order of the plant's outputs, and the A of the loop u = sign K y."""
    K = trial.held if isinstance(trial.held, rl.StateSpaceModel) else trial.held.K
    order, G = columns(trial), trial.G
    kB, kD = K.B[:, order], K.D[:, order]
    A = np.block([[G.A + sign * G.B @ kD @ G.C, sign * G.B @ K.C], [kB @ G.C, K.A]])
    return A, kB, kD


def channel_margins(trial: Trial, sign: int) -> dict[str, float]:
    """Smallest 1 / |S_ii - 1/2| over the grid, for each output."""
    K = trial.held if isinstance(trial.held, rl.StateSpaceModel) else trial.held.K
    _, kB, kD = closed(trial, sign)
    G = trial.G
    largest = np.zeros(trial.p)
    for w in GRID:
        P = G.C @ np.linalg.solve(1j * w * np.eye(len(G.A)) - G.A, G.B)
        C = K.C @ np.linalg.solve(1j * w * np.eye(len(K.A)) - K.A, kB) + kD
        S = np.linalg.inv(np.eye(trial.p) - sign * P @ C)
        largest = np.maximum(largest, np.abs(np.diag(S) - 0.5))
    return dict(zip([s.name for s in G.outputs], 1 / largest, strict=True))


def true_sign(trial: Trial) -> int | None:
    return SIGN[trial.takes] if trial.knows and trial.meets else None


def judge(trial: Trial, command: str, asked: str | None, text: str) -> str:
    """Empty where the number is about the loop that is printed, and that is the one meant."""
    data = json.loads(text)
    sign = printed_sign(data["loop"])
    meant = true_sign(trial)
    if asked is None and meant is not None and sign != meant:
        return f"another loop than the controller's: {data['loop']}, meant {meant}"
    if asked is not None and sign != {"negative": -1, "positive": 1}[asked]:
        return "another loop than was asked for"
    if asked is None and meant is None and "only this sign" not in data["loop"]:
        return f"a sign out of nowhere: {data['loop']}"
    A = closed(trial, sign)[0]
    if np.linalg.eigvals(A).real.max() >= 0:
        return "a number about an unstable loop"
    if command == "margins":
        truth = channel_margins(trial, sign)
        for name, margin in data["channels"].items():
            if not margin["lower"] <= truth[name] * (1 + 1e-6):
                return f"{name}: {margin['lower']} is proved, {truth[name]} is true"
            if not truth[name] <= margin["upper"] * 1.05:
                return f"{name}: {margin['upper']} is attained, {truth[name]} is true"
        return ""
    M = trial.M
    E = np.zeros_like(A)
    n = len(M.A)
    E[:n, :n] = M.B[:, :1] @ M.C[:1]
    low = min(data["lower"], 1e3)
    worst = max(np.linalg.eigvals(A + d * E).real.max() for d in np.linspace(-0.999 * low, 0.999 * low, 201))
    if worst >= 1e-9:
        return f"a member within the proved margin {low} is unstable ({worst:.2g})"
    if data["delta"]:
        pole = np.linalg.eigvals(A + data["delta"]["delta"] * E)
        if np.abs(pole.real).min() > 1e-5 * (1 + np.abs(pole).max()):
            return "the critical Delta is that of another loop"
    return ""


def attack(trials: int, seed: int) -> int:
    counts: Counter[str] = Counter()
    wrong: list[str] = []
    kinds: Counter[str] = Counter()
    for k in range(trials):
        try:
            trial = Trial(seed * 100_000 + k)
        except rl.RobustlabError:
            counts["no such design"] += 1
            continue
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            trial.save(folder)
            asked = None if trial.rng.uniform() < 0.6 else str(trial.rng.choice(["negative", "positive"]))
            command = str(trial.rng.choice(["margins", "mu"]))
            words = ["model", "margins", "g.h5"] if command == "margins" else ["mu", "set.h5"]
            words += ["-k", trial.file, *([] if asked is None else ["--feedback", asked])]
            code, _, err = run(folder, *words, "--json")
            code_text, shown, _ = run(folder, *words)
            if code != 0:
                counts[f"refused, exit code {code}"] += 1
                kinds[err.splitlines()[0].split(":", 2)[-1][:60]] += 1
                if code not in (2, 3, 4) or code != code_text:
                    wrong.append(f"trial {k}: exit code {code}: {err[:300]}")
                continue
            _, out, _ = run(folder, *words, "--json")
            fault = judge(trial, command, asked, out)
            law_known = true_sign(trial)
            contradicted = asked is not None and law_known not in (None, {"negative": -1, "positive": 1}[asked])
            if contradicted and not shown.startswith("note: "):
                fault = fault or "a contradiction without a note"
            if "units differ" in trial.wrong:
                fault = fault or "units that differ were not seen"
            if "loop" not in " ".join(shown.splitlines()[:3]):
                fault = fault or "the loop is not printed above the number"
            counts["judged: the loop printed, and meant" if not fault else "WRONG"] += 1
            if fault:
                wrong.append(f"trial {k} ({trial.kind}; {', '.join(trial.wrong)}; {asked}): {fault}")
    versions = f"robustlab {rl.__version__}, numpy {np.__version__}, h5py {h5py.__version__}"
    print(f"{date.today()}, {versions}, Python {platform.python_version()}; {trials} trials, seed {seed}")
    for what, count in counts.most_common():
        print(f"{count:6d}  {what}")
    print("reasons of refusal (beginnings):")
    for what, count in kinds.most_common(12):
        print(f"{count:6d}  {what}")
    print("\n".join(wrong) or "no certified number about another loop than the one printed and meant")
    return bool(wrong)


if __name__ == "__main__":
    sys.exit(attack(*(int(text) for text in [*sys.argv[1:], *["500", "1"][len(sys.argv) - 1 :]][:2])))
