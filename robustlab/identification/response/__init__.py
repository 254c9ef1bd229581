"""A model's response to a record, matched by names and units, whole or in windows with their own starts."""
