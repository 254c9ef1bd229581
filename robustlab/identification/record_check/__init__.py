"""Is a record what it is taken for?

suitability       `check_record` summarises it, `suitability` says whether an effect may be named from it
channel_identity  channels with another sign, unit or name than the model's
column_mapping    which column is which signal: a proposal where the names are not the model's
column_trials     that tried with the model, where names and units leave it open
resampling        missing samples, jitter, two clocks: brought on one uniform clock
"""
