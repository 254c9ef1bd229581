"""A model's response to a record, matched by names and units, whole or in windows with free initial states."""
