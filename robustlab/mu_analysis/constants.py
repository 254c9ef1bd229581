"""Constants that several modules of this package share."""

from __future__ import annotations

from robustlab.budget import MILLION

WORK = 60 * MILLION  # the usual work of a proof at effort 1
SINGULAR = 1e-11  # relative smallest singular value below which I - M Delta counts as singular
