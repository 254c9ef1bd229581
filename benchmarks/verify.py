"""What `rl.verify` proves of what robustlab found: ``python benchmarks/verify.py --what hinf|mu|axis|recipes``.

    hinf     designs on the COMPleib plants, smallest gamma and the default, up to 60 states
    mu       both bounds of the matrices of benchmarks/mu.py
    axis     margins and worst-case gains of the models of benchmarks/mu.py, published cases
    recipes  the evidence of runs: folders of runs behind the word (``robustlab run``)

A line a case: CPU seconds of the analysis or the design, of the evidence, of the check; what became of each claim. Of
a design the analysis is the norm of its loop.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import mu_models
import numpy as np
from compleib import DATA, plants
from harness import heading, options, timed
from mu import CASES, CHAINS, CLASSES, model, random_stack, with_performance

import robustlab as rl
from robustlab.budget import one_thread
from robustlab.evidence import claims_of
from robustlab.verification import check

Case = tuple[str, Callable[[], Any]]


def designs(most: int, data: str) -> Iterator[Case]:
    """A design of each plant, as close to the optimum as it comes, and the default."""
    for name, P, about in plants(most=most, data=Path(data)):
        plant = rl.StateSpaceModel(*P.values()), int(about["ny"]), int(about["nu"])
        for said, rel in (("tight", 1.0), ("default", 1.05)):
            yield f"{name} n={about['n']} {said}", partial(rl.hinf, *plant, gamma_rel=rel)


def matrices(count: int) -> Iterator[Case]:
    """The first matrices of each class of benchmarks/mu.py."""
    for name, rows, _ in CASES:
        M, blocks = random_stack(rows, 20)
        for k in range(count):
            yield f"{name}, {k}", partial(rl.mu, M[k], blocks)


def axis(seeds: range) -> Iterator[Case]:
    """Margins and gains of random models, chains, and cases with known answers."""
    for name, given in CLASSES.items():
        for seed in seeds:
            uncertain = model(*given, seed)
            yield f"margin, {name}, {seed}", partial(rl.robust_stability, uncertain)

            def gain(u: Any = uncertain, s: int = seed) -> Any:
                size = 0.5 * rl.robust_stability(u, tolerance=np.inf).lower
                return rl.peak_gain(with_performance(u, size, s))

            yield f"gain, {name}, {seed}", gain
    for n, repeats, seed in CHAINS:
        uncertain = rl.UncertainModel(*mu_models.chain(n, repeats, seed))
        yield f"margin, chain {n} x {repeats}, {seed}", partial(rl.robust_stability, uncertain, effort=0.3)
    for name, made in mu_models.PUBLISHED.items():
        uncertain = rl.UncertainModel(*made())
        yield f"margin, {name}", partial(rl.robust_stability, uncertain)


class Tally:
    """What became of all claims, and what the checks cost beside the analyses."""

    def __init__(self) -> None:
        self.outcomes: Counter[str] = Counter()
        self.ratios: list[float] = []
        self.longest = 0.0

    def line(self, name: str, find: Callable[[], Any]) -> str:
        """Find a result, make its claims, check them."""
        try:
            found, spent = timed(find)
        except rl.RobustlabError as error:
            return f"{name:52s} no result: {str(error)[:60]}"
        if not found.status.trustworthy:
            return f"{name:52s} {spent:8.2f}          {found.status.value}: nothing is claimed"
        if hasattr(found, "closed_loop"):
            _, spent = timed(rl.peak_gain, found.closed_loop)
        claims, made = timed(claims_of, found)
        said, checked = timed(lambda: [check(claim) for claim in claims])
        self.outcomes.update(one.outcome.value for one in said)
        if not said:
            self.outcomes["no claims"] += 1
        self.ratios.append((made + checked) / max(spent, 1e-3))
        self.longest = max(self.longest, checked)
        words = ", ".join(f"{one.outcome.value} ({one.boxes})" for one in said) or "no claims"
        where = "; ".join(one.where for one in said if one.where)
        return f"{name:52s} {spent:8.2f} {made:6.2f} {checked:7.2f}  {words}{': ' if where else ''}{where[:150]}"

    def total(self) -> str:
        told = ", ".join(f"{name} {count}" for name, count in sorted(self.outcomes.items()))
        ratio = f"evidence and check over analysis: median {np.median(self.ratios):.1f}" if self.ratios else ""
        return f"{told}; {ratio}; longest check {self.longest:.1f} s"


def recipes(folder: str) -> str:
    """The evidence that a run has written."""
    outcomes: Counter[str] = Counter()
    for path in sorted(Path(folder).glob("evidence/*.h5")):
        try:
            claims = rl.verify(path).claims
        except rl.InputError:
            outcomes["files without claims"] += 1
            continue
        outcomes.update(c.outcome.value for c in claims)
        for c in claims:
            if c.where:
                print(f"    {path.name}: {c.outcome.value}: {c.where[:150]}")
    return ", ".join(f"{name} {count}" for name, count in sorted(outcomes.items()))


def main() -> None:
    what = ("hinf", "mu", "axis", "recipes")
    given = options(__doc__, "*", what=what, most_states=60, seeds=2, data=str(DATA))
    print(heading("numpy", "scipy", "python-flint"))
    if given.what == "recipes":
        for folder in given.names:
            told, seconds = timed(recipes, folder)
            print(f"{Path(folder).name:28s} {told}; {seconds:.1f} s", flush=True)
        return
    cases = {
        "hinf": lambda: designs(given.most_states, given.data), "mu": lambda: matrices(3),
        "axis": lambda: axis(range(given.seeds)),
    }[given.what]()  # fmt: skip
    print(f"{'':52s} {'found':>8s} {'claims':>6s} {'checked':>7s}  CPU seconds; what became of each claim (tests)")
    tally = Tally()
    with one_thread():
        for name, find in cases:
            print(tally.line(name, find), flush=True)
    print(tally.total())


if __name__ == "__main__":
    main()
