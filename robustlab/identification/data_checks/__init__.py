"""Data checks of a record: channels, columns, time base, and fitness for effect identification."""

from robustlab.identification.data_checks.channel_identity import derivative_pairs
from robustlab.identification.data_checks.resampling import counted_from, join_clocks, position_datum, uniform
from robustlab.identification.data_checks.suitability import (
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
