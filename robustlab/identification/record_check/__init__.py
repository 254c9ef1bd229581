"""Is a record what it is taken for?

suitability       `check_record` summarises it, `suitability` says whether an effect may be named from it
channel_identity  channels with another sign, unit or name than the model's
resampling        missing samples, jitter, two clocks: brought on one uniform clock
"""

from robustlab.identification.record_check.channel_identity import derivative_pairs
from robustlab.identification.record_check.resampling import counted_from, join_clocks, position_datum, uniform
from robustlab.identification.record_check.suitability import (
    Finding,
    check_record,
    clipped_runs,
    quantisation_step,
    suitability,
)

__all__ = [
    "Finding",
    "check_record",
    "clipped_runs",
    "counted_from",
    "derivative_pairs",
    "join_clocks",
    "position_datum",
    "quantisation_step",
    "suitability",
    "uniform",
]
