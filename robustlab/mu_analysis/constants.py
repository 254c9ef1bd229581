"""Constants that several modules of this package share."""

from __future__ import annotations

from robustlab.budget import MILLION

WORK = 60 * MILLION  # the usual work of a proof at effort 1
SINGULAR = 1e-11  # relative smallest singular value below which I - M Delta counts as singular
FREQUENCIES = 8  # at which D, G are sought together
COARSE = 4e-3  # accuracy of the first cover, which tells whether branch and bound has to follow
MEMBERS = 6  # of the set that are followed to a peak of their own
ASCENT_REACH = 0.99  # ... and of the largest one
