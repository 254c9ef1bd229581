"""Constants that several modules of this package share."""

from __future__ import annotations

# Work that both may take at effort 1, in the units of `robustlab.budget`.
WORK = 4e8
# Rounds in which states are balanced by what the LMIs gave in the last.
BALANCINGS = 8
# A loop this close (relative) to the LMIs' optimum ends the search over back-offs.
NEAR = 0.02
