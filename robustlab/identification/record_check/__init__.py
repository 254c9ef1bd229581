"""Is a record what it is taken for?

suitability       `check_record` summarises it, `suitability` says whether an effect may be named from it
channel_identity  channels with another sign, unit or name than the model's
resampling        missing samples, jitter, two clocks: brought on one uniform clock
"""
