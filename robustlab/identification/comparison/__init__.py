"""`compare`: how large the gap is, where it lives, what the residual still contains."""
