"""Check the claims of H-infinity designs: ``python benchmarks/verify.py [--most-states 60] [NAME ...]``.

Print one line per design for the COMPleib plants, smallest gamma and default: CPU seconds of the loop's norm, of the
evidence, of the check; outcome of each claim.
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
    """Outcomes of all claims, and the cost of the checks relative to the analyses."""

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
        results, checked = timed(lambda: [check(claim) for claim in claims])
        self.outcomes.update(one.outcome.value for one in results)
        if not results:
            self.outcomes["no claims"] += 1
        self.ratios.append((made + checked) / max(spent, 1e-3))
        self.longest = max(self.longest, checked)
        words = ", ".join(f"{one.outcome.value} ({one.boxes})" for one in results) or "no claims"
        where = "; ".join(one.where for one in results if one.where)
        return f"{name:52s} {spent:8.2f} {made:6.2f} {checked:7.2f}  {words}{': ' if where else ''}{where[:150]}"

    def total(self) -> str:
        counts = ", ".join(f"{name} {count}" for name, count in sorted(self.outcomes.items()))
        ratio = f"evidence and check over analysis: median {np.median(self.ratios):.1f}" if self.ratios else ""
        return f"{counts}; {ratio}; longest check {self.longest:.1f} s"


def main() -> None:
    given = options(__doc__, "*", most_states=60, data=str(DATA))
    print(heading("numpy", "scipy", "python-flint"))
    print(f"{'':52s} {'norm':>8s} {'claims':>6s} {'checked':>7s}  CPU seconds; outcome of each claim (tests)")
    tally = Tally()
    with one_thread():
        for name, P, about in plants(given.names, given.most_states, Path(given.data)):
            plant = rl.StateSpaceModel(*P.values()), int(about["ny"]), int(about["nu"])
            for label, rel in (("tight", 1.0), ("default", 1.05)):
                print(tally.line(f"{name} n={about['n']} {label}", partial(rl.hinf, *plant, gamma_rel=rel)), flush=True)
    print(tally.total())


if __name__ == "__main__":
    main()
