"""What `rl.verify` proves of what robustlab found: ``python benchmarks/verify.py hinf|mu|axis|recipes``.

    hinf     designs on the COMPleib plants, smallest gamma and the default, up to 60 states
    mu       both bounds of the matrices of benchmarks/mu.py
    axis     margins and worst-case gains of the models of benchmarks/mu_axis.py, published cases
    recipes  the evidence of runs: folders of runs behind the word (``robustlab run``)

A line a case: CPU seconds of the analysis or the design, of the evidence, of the check; what became of each claim. Of
a design the analysis is the norm of its loop.
"""

from __future__ import annotations

import argparse
import platform
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

import robustlab as rl
from robustlab.budget import one_thread
from robustlab.evidence import claims_of
from robustlab.verification.checker import check

sys.path.insert(0, str(Path(__file__).parent))

Case = tuple[str, Callable[[], Any]]


def designs(most: int) -> Iterator[Case]:
    """A design of each plant, as close to the optimum as it comes, and the default."""
    from hinf import COMPLEIB, plants

    for name, P, about in plants(COMPLEIB, [], most):
        model = rl.StateSpaceModel(*P.values())
        for said, rel in (("tight", 1.0), ("default", 1.05)):
            yield (
                f"{name} n={about['n']} {said}",
                lambda m=model, a=about, r=rel: rl.hinf(m, int(a["ny"]), int(a["nu"]), gamma_rel=r),
            )


def matrices(count: int) -> Iterator[Case]:
    """The first matrices of each class of benchmarks/mu.py."""
    from mu import CASES

    from robustlab.uncertainty.blocks import as_blocks, structure_size

    for name, rows, _ in CASES:
        blocks = as_blocks(rows)
        q, p = structure_size(blocks)
        rng = np.random.default_rng(len(rows) * 100 + q)
        M = rng.standard_normal((20, p, q)) + 1j * rng.standard_normal((20, p, q))
        for k in range(count):
            yield f"{name}, {k}", lambda m=M[k], b=blocks: rl.mu(m, b)


def axis(seeds: range) -> Iterator[Case]:
    """Margins and gains of random models, chains, and cases with known answers."""
    import mu_models
    from mu_axis import CHAINS, CLASSES, model, with_performance

    for name, given in CLASSES.items():
        for seed in seeds:
            uncertain = model(*given, seed)
            yield f"margin, {name}, {seed}", lambda u=uncertain: rl.robust_stability(u)

            def gain(u: Any = uncertain, s: int = seed) -> Any:
                size = 0.5 * rl.robust_stability(u, tolerance=np.inf).lower
                return rl.peak_gain(with_performance(u, size, s))

            yield f"gain, {name}, {seed}", gain
    for n, repeats, seed in CHAINS:
        uncertain = rl.UncertainModel(*mu_models.chain(n, repeats, seed))
        yield f"margin, chain {n} x {repeats}, {seed}", lambda u=uncertain: rl.robust_stability(u, effort=0.3)
    for name, made in (("two-mass", mu_models.two_mass), ("three masses", mu_models.spring_mass_damper),
                       ("an island", mu_models.two_parameters_with_an_island)):  # fmt: skip
        uncertain = rl.UncertainModel(*made())
        yield f"margin, {name}", lambda u=uncertain: rl.robust_stability(u)


class Tally:
    """What became of all claims, and what the checks cost beside the analyses."""

    def __init__(self) -> None:
        self.outcomes: Counter[str] = Counter()
        self.ratios: list[float] = []
        self.longest = 0.0

    def line(self, name: str, find: Callable[[], Any]) -> str:
        """Find a result, make its claims, check them."""
        begun = time.process_time()
        try:
            found = find()
        except rl.RobustlabError as error:
            return f"{name:52s} no result: {str(error)[:60]}"
        spent = time.process_time() - begun
        if not found.status.trustworthy:
            return f"{name:52s} {spent:8.2f}          {found.status.value}: nothing is claimed"
        if hasattr(found, "closed_loop"):
            begun = time.process_time()
            rl.peak_gain(found.closed_loop)
            spent = time.process_time() - begun
        begun = time.process_time()
        claims = claims_of(found)
        made = time.process_time() - begun
        begun = time.process_time()
        said = [check(claim) for claim in claims]
        checked = time.process_time() - begun
        self.outcomes.update(one.outcome.value for one in said)
        if not said:
            self.outcomes["no claims"] += 1
        self.ratios.append((made + checked) / max(spent, 1e-3))
        self.longest = max(self.longest, checked)
        words = ", ".join(f"{one.outcome.value} ({one.boxes})" for one in said) or "no claims"
        where = "; ".join(one.where for one in said if one.where)
        return f"{name:52s} {spent:8.2f} {made:6.2f} {checked:7.2f}  {words}{': ' if where else ''}{where[:150]}"

    def total(self) -> str:
        """All of them."""
        told = ", ".join(f"{name} {count}" for name, count in sorted(self.outcomes.items()))
        ratio = f"evidence and check over analysis: median {np.median(self.ratios):.1f}" if self.ratios else ""
        return f"{told}; {ratio}; longest check {self.longest:.1f} s"


def recipes(folders: list[str]) -> None:
    """The evidence that runs have written."""
    for folder in folders:
        outcomes: Counter[str] = Counter()
        begun = time.process_time()
        for path in sorted(Path(folder).glob("evidence/*.h5")):
            try:
                found = rl.verify(path)
            except rl.InputError:
                outcomes["files without claims"] += 1
                continue
            outcomes.update(c.outcome.value for c in found.claims)
            for c in found.claims:
                if c.where:
                    print(f"    {path.name}: {c.outcome.value}: {c.where[:150]}")
        told = ", ".join(f"{name} {count}" for name, count in sorted(outcomes.items()))
        print(f"{Path(folder).name:28s} {told}; {time.process_time() - begun:.1f} s", flush=True)


def main() -> None:
    """The part that was asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("part", choices=("hinf", "mu", "axis", "recipes"))
    parser.add_argument("folders", nargs="*")
    parser.add_argument("--most-states", type=int, default=60)
    parser.add_argument("--seeds", type=int, default=2)
    given = parser.parse_args()
    versions = ", ".join(f"{name} {version(name)}" for name in ("numpy", "scipy", "python-flint"))
    print(f"# {datetime.now(UTC):%Y-%m-%d}, {platform.system()} {platform.machine()}, {versions}")
    if given.part == "recipes":
        recipes(given.folders)
        return
    cases = {
        "hinf": lambda: designs(given.most_states), "mu": lambda: matrices(3), "axis": lambda: axis(range(given.seeds))
    }[given.part]()  # fmt: skip
    print(f"{'':52s} {'found':>8s} {'claims':>6s} {'checked':>7s}  CPU seconds; what became of each claim (tests)")
    tally = Tally()
    with one_thread():
        for name, find in cases:
            print(tally.line(name, find), flush=True)
    print(tally.total())


if __name__ == "__main__":
    main()
