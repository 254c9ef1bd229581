"""Saner controllers near the smallest gamma: slower poles, and no needlessly slow modes of the loop.

The controller of the smallest gamma itself is often absurdly fast. A few per cent more allow large penalties on u and x
and large noises on y and x, and with them poles that are slower by orders of magnitude.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from robustlab.synthesis.search import Candidate, Search

__all__ = ["soften"]

ROUNDS, STEPS, LATER_STEPS = 3, 5, 3
BASE_SHARE = 0.05


def soften(search: Search, start: Candidate, gamma: float) -> None:
    """Add saner candidates up to this gamma to the search.

    The added channels are made as large as the test at this gamma allows. Once with all of them relative to the gains
    of the loop; and once after half of the slack has gone into an x disturbance and penalty of fixed size, because a
    mode that w does not excite (an integrator of the plant, behind a reference) otherwise stays in the loop as slow as
    it is.
    """
    _slowest_poles(search, start, gamma, 0.0)
    half = 0.5 * (start.gamma + gamma)
    base = search.relative(start, BASE_SHARE, 0.0)
    low, high, size = 1e-4, 1e2, 0.0
    for _ in range(STEPS):
        if base is None or search.budget.over:
            return
        middle = float(np.sqrt(low * high))
        if search.found_within(replace(base, x_out=middle, x_in=middle), half) is not None:
            low = size = middle
        else:
            high = middle
    if size > 0:
        _slowest_poles(search, start, gamma, size)


def _slowest_poles(search: Search, start: Candidate, gamma: float, x: float) -> None:
    """Largest relative weights by bisection, repeated because their scale follows the loop found last."""
    low, high, steps = 1e-2, 10.0, STEPS
    for _ in range(ROUNDS):
        softest: Candidate | None = None
        for _ in range(steps):
            if search.budget.over:
                return
            middle = float(np.sqrt(low * high))
            weights = search.relative(start, middle, 0.0 if x else 0.1, 3.0)
            if weights is not None and x:
                weights = replace(weights, x_out=x, x_in=x)
            found = None if weights is None else search.found_within(weights, gamma)
            if found is not None:
                low, softest = middle, found
            else:
                high = middle
        if softest is None or softest.pace > 0.7 * start.pace:
            return
        start, low, high, steps = softest, low / 2, 3 * low, LATER_STEPS
