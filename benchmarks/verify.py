"""What the checker proves of H-infinity designs: ``python benchmarks/verify.py [--most-states 60] [NAME ...]``.

A line a design of the COMPleib plants, smallest gamma and the default: CPU seconds of the norm of its loop, of the
evidence, of the check; what became of each claim.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from compleib import DATA, plants
from harness import heading, options, timed

import robustlab as rl
from robustlab.budget import one_thread
from robustlab.evidence import claims_of
from robustlab.verification import check


class Tally:
    """What became of all claims, and what the checks cost beside the analyses."""

    def __init__(self) -> None:
        self.outcomes: Counter[str] = Counter()
        self.ratios: list[float] = []
        self.longest = 0.0

    def line(self, name: str, find: Callable[[], Any]) -> str:
        """Design, make the claims, check them."""
        try:
            found = find()
        except rl.RobustlabError as error:
            return f"{name:52s} no result: {str(error)[:60]}"
        if not found.status.trustworthy:
            return f"{name:52s} {found.status.value}: nothing is claimed"
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


def main() -> None:
    given = options(__doc__, "*", most_states=60, data=str(DATA))
    print(heading("numpy", "scipy", "python-flint"))
    print(f"{'':52s} {'norm':>8s} {'claims':>6s} {'checked':>7s}  CPU seconds; what became of each claim (tests)")
    tally = Tally()
    with one_thread():
        for name, P, about in plants(given.names, given.most_states, Path(given.data)):
            plant = rl.StateSpaceModel(*P.values()), int(about["ny"]), int(about["nu"])
            for said, rel in (("tight", 1.0), ("default", 1.05)):
                print(tally.line(f"{name} n={about['n']} {said}", partial(rl.hinf, *plant, gamma_rel=rel)), flush=True)
    print(tally.total())


if __name__ == "__main__":
    main()
