"""Constants that several modules of this package share."""

from __future__ import annotations

# Those for a start that has come down the norm already, and for a controller that is known to be good.
BARRIER_CLOSER = (0.1, 0.03)
BARRIER_KNOWN = (0.3, 0.1, 0.03)
