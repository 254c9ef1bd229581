"""Constants that several modules of this package share."""

from __future__ import annotations

# A value whose error bound exceeds this share of the largest gain (of its own size; of the polynomial) is computed
# once more with 30 digits. Smaller: more of them, slower.
QUICK = 1e-6
# Error up to which the rebuilt loop's polynomial is taken from its modes.
MODES = 1e-6
