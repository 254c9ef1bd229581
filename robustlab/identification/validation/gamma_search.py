"""What a search for the smallest Delta is given: the blocks, the precision, and the budget."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from robustlab.arrays import Array, Mask
from robustlab.budget import Budget


@dataclass(frozen=True)
class Search:
    """What every search for the smallest gamma is given."""

    scaled: Mask  # the blocks that gamma scales, (n_blocks,); the others keep the size 1
    precision: float  # relative width of the bounds to be reached
    budget: Budget  # work it may take

    def gammas(self, gamma: float) -> Array:
        """Sizes of the blocks that belong to a gamma."""
        return np.where(self.scaled, gamma, 1.0)
