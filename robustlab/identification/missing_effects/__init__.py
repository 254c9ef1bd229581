"""`discover`: search over sets of effects, their posterior, the result, and the updated plant."""
