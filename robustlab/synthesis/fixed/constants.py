"""Constants that several modules of this package share."""

from __future__ import annotations

from robustlab.budget import MILLION

# Work of a design at effort 1.
WORK = 60 * MILLION
# Candidates that are verified, best first; the optimiser's own norm is not a proof. More: slower, seldom better.
VERIFIED = 4
