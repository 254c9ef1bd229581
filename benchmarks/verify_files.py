"""Test `robustlab.verify` with result files whose contents except the claims are edited: none may be accepted.

    python benchmarks/verify_files.py --mutants 10000 --seed 1

A mutant changes numbers (one bit to a factor, sign, zero, NaN), texts (names, units, laws), attributes (dt, gamma,
status, kind), shapes, or leaves out, adds, renames or exchanges datasets and groups; the content hash is old, absent or
recomputed. One of ten changes the result itself and recomputes the digest in its claims, too, so that only the
comparison with the claims can detect it. ``provenance``, which no hash covers, stays unchanged.
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections import Counter
from copy import deepcopy
from pathlib import Path
from typing import Any

import numpy as np
from harness import heading, options

import robustlab as rl
from robustlab.files.hdf5 import read_tree, write_tree
from robustlab.files.tree import Dataset, Tree, content_sha256, digest_beside_claims
from robustlab.verification import checker, files
from robustlab.verification.files import CONTROLLER, ROUNDING, SHOWN, places_at

Rng = np.random.Generator
RESULTS = Path(__file__).parent / "results" / "verify_files.txt"
KEPT = ("claims", "provenance")
TEXTS = ("y", "r - y", "r", "1/s", "N m", "certified", "failed", "")


def sources() -> dict[str, Any]:
    lag, mode = rl.tf([1.0], [1.0, 1.0, 1.0]), rl.tf([4.0], [1.0, 0.4, 4.0])
    motor = rl.plant("dc-motor", R=(2.07, 0.10), Km=(0.052, 0.05)).uncertain(outputs=["omega"])
    loop = (motor @ rl.tf([0.2, 1.0], [1.0, 0.0])).feedback()
    mixed = rl.mixsyn(lag, rl.makeweight(100, (1, 1), 0.5), 0.1, None)
    noisy = rl.StateSpaceModel([[-1.0]], [[1, 0, 1]], [[1], [0], [1]], [[0, 0, 0], [0, 0, 1], [0, 1, 0]])
    regulator = rl.h2(noisy, 1, 1)
    return {
        "peak gain": rl.peak_gain(mode), "H2 norm": rl.h2_norm(mode), "margin": rl.robust_stability(loop),
        "mu": rl.mu(np.array([[1.0, 0.4, 0.1], [0.3, -0.7, 0.5], [0.2, 0.1, 0.9]]), [[-1, 0], [1, 0], [1, 1]]),
        "worst-case gain": rl.peak_gain(loop),
        "H-infinity design": mixed, "controller": mixed.controller, "loop shaping": rl.ncf(mode),
        "H2 design": regulator, "H2 controller": regulator.controller,
        "reduced controller": rl.reduce_controller(mixed, order=2), "reduced model": rl.reduce_model(mode * lag, 2),
        "cover": rl.cover([rl.tf([k], [1.0, k]) for k in (1.0, 1.3, 0.8)], form="elements"),
        "disk margin": rl.disk_margin(lag, rl.tf([0.5], [1.0, 0.0])),
    }  # fmt: skip


def changed(rng: Rng, x: Any) -> Any:
    """Return the array with one entry changed by one bit to a factor, or to another text."""
    X, at = np.array(x), tuple(int(rng.integers(s)) for s in np.shape(x))
    if X.dtype.kind == "U":
        X = X.astype(object)
        X[at] = str(rng.choice([*TEXTS, f"{X[at]}x"]))
        return X.astype(np.str_)
    if X.dtype.kind in "bi":
        return ~X if X.dtype.kind == "b" else X + int(rng.choice([-1, 1]))
    moved = X[at] * (1 + rng.choice([-1, 1]) * 10 ** rng.uniform(-15, 0)) or 10 ** rng.uniform(-300, 2)
    X[at] = rng.choice([moved, moved, moved, -X[at], 0.0, np.nan, np.inf])
    return X


def edited(rng: Rng, tree: Tree) -> str:
    """Change one item of a tree in place and return the type of change."""
    groups = [x for p, x in tree.walk() if isinstance(x, Tree) and p.split("/")[1] not in KEPT]
    node = groups[int(rng.integers(len(groups)))]
    names, held = list(node.datasets), [k for k in node.attrs if k != "content_sha256"]
    what = str(rng.choice(["number"] * 3 + ["attribute", "shape", "left out", "exchange", "rename", "add"]))
    if what == "attribute" and held:
        key = str(rng.choice(held))
        value = node.attrs.pop(key)
        node.attrs |= {key: changed(rng, value)} if rng.random() < 0.8 else {}
    elif what == "add" or not names:
        node.put(str(rng.choice(["upper", "gamma", "E", "dt"])), rng.normal())
        return "add"
    elif what == "left out" and rng.random() < 0.3 and set(node.groups) - set(KEPT):
        del node.groups[str(rng.choice(sorted(set(node.groups) - set(KEPT))))]
    else:
        name, other = str(rng.choice(names)), str(rng.choice(names))
        own = node.datasets.pop(name)
        X = np.asarray(own.values)
        if what == "rename":
            node.datasets[f"{name}_"] = own
        elif what == "exchange" and name != other:
            node.datasets |= {name: node.datasets[other], other: own}
        elif what == "shape":
            node.datasets[name] = Dataset(
                X.T.copy() if X.ndim == 2 and rng.random() < 0.4 else X[None].copy(), own.attrs
            )
        elif what != "left out" and X.size:
            node.datasets[name] = Dataset(changed(rng, X), own.attrs)
    return what


def made_anew(rng: Rng, tree: Tree) -> str:
    """Change a number of the result by more than its claim's rounding, and recompute the digest."""
    controller = tree.attrs["kind"] == "controller"
    rules = CONTROLLER if controller else SHOWN[str(tree.attrs["type"])]
    top = tree if controller else tree.groups["data"]
    # No claim states the distance of a model to the boundary of a cover; an attained gain may be reported lower.
    found = [(r, x) for path, r in rules.items() if r != "inside" for _, x in places_at(top, path)]
    if not found:
        return edited(rng, tree)
    rule, thing = found[int(rng.integers(len(found)))]
    step = 10 ** rng.uniform(np.log10(3 * ROUNDING), 0) * (1 if rule == "gain" else rng.choice([-1, 1]))
    if isinstance(thing, Tree):
        thing = thing.datasets[str(rng.choice([x for x in "ABCD" if np.any(thing.datasets[x].values)]))]
    thing.values = np.asarray(thing.values) * (1 + step)
    if controller and not any(thing is x for x in top.datasets.values()):
        tree.attrs["gamma"] = thing.values
    tree.groups["claims"].attrs["content_sha256"] = digest_beside_claims(tree)
    return "digest made anew"


def mutant(rng: Rng, tree: Tree) -> tuple[str, Tree]:
    """Return the type of change and the tree; repeat until the content differs."""
    while True:
        new = deepcopy(tree)
        what = made_anew(rng, new) if rng.random() < 0.1 else edited(rng, new)
        if content_sha256(new) != tree.attrs["content_sha256"]:
            break
    treatment = "anew" if what == "digest made anew" else str(rng.choice(["anew", "absent", "old"]))
    if treatment != "old":
        new.attrs.pop("content_sha256", None)
    if treatment == "anew":
        new.attrs["content_sha256"] = content_sha256(new)
    return what, new


def main() -> int:
    """Run and write; 1 where a mutant was accepted."""
    given, known, prove = options(__doc__, mutants=10_000, seed=1), {}, checker.check

    def once(claim: Any, *, effort: int = checker.EFFORT) -> Any:
        """The claims are the same in all mutants of a file: each is proved once."""
        key = claim.kind + "".join(f"{x}{np.shape(v)}{np.asarray(v).tobytes()!r}" for x, v in claim.numbers.items())
        known[key] = known.get(key) or prove(claim, effort=effort)
        return known[key]

    checker.check = once  # type: ignore[assignment]
    rng, counts, start = np.random.default_rng(given.seed), {}, time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        path, trees = Path(folder) / "mutant.h5", {}
        for kind, result in sources().items():
            trees[kind] = read_tree(rl.save(path, result))
            if not rl.verify(path).proved:
                raise SystemExit(f"{kind}: the file itself was not proved\n{rl.verify(path)}")
        for i in range(given.mutants):
            kind = str(rng.choice(list(trees)))
            what, tree = mutant(rng, trees[kind])
            try:
                if i % 10 == 0:  # one of ten goes through a file, which takes most of the time
                    tree = read_tree(write_tree(path, tree), isolate=False)
                files.read_tree = lambda _, tree=tree: tree
                answer = "accepted" if rl.verify(path).proved else "not proved"
            except rl.InputError:
                answer = "refused"
            for key in (kind, what, "all"):
                counts.setdefault(key, Counter())[answer] += 1
            if counts["all"].total() % 1000 == 0:
                print(f"{counts['all'].total()} mutants, {time.perf_counter() - start:.0f} s", flush=True)
            if answer == "accepted":
                print(f"ACCEPTED: {kind}, {what}", flush=True)
    lines = [heading("robustlab", "numpy", "h5py", "python-flint"), f"# {time.perf_counter() - start:.0f} s",
             f"{'':20s}{'accepted':>12s}{'not proved':>12s}{'refused':>12s}   (exit codes 0, 4, 3)"]  # fmt: skip
    lines += [f"{key:20s}" + "".join(f"{counts[key][x]:12d}" for x in ("accepted", "not proved", "refused"))
              for key in sorted(counts)]  # fmt: skip
    RESULTS.write_text("\n".join(lines) + "\n")
    print("\n".join(lines))
    return int(counts["all"]["accepted"] > 0)


if __name__ == "__main__":
    sys.exit(main())
