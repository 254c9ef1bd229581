"""Constants that several modules of this package share."""

from __future__ import annotations

from robustlab.budget import MILLION

# Work of a design at effort 1; few plants need a tenth. More: longer searches on hard plants.
WORK = 60 * MILLION
# Shares of the smallest gamma found that are tried once more (the first one; with care all of them): the test in
# floating point is not monotone in gamma. Longer: fewer false ends, more tests.
PROBES = (0.93, 0.8, 0.6, 0.4, 0.2, 0.07, 0.02)
