"""Constants that several modules of this package share."""

from __future__ import annotations

FIRST_POINTS = 40  # frequencies before any is added
