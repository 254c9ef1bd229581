"""Data checks of a record: channels, columns, time base, and fitness for effect identification."""

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
