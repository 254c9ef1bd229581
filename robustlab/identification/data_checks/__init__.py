"""Data checks of a record: channels, columns, time base, and fitness for effect identification."""

from robustlab.public_names import lazily

__all__, __getattr__ = lazily(
    __name__,
    {
        "channel_identity": "derivative_pairs",
        "resampling": "counted_from join_clocks position_datum uniform",
        "suitability": "Finding check_record clipped_runs quantisation_step suitability",
    },
)
