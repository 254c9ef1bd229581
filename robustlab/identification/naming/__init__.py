"""`discover`: the search over hypotheses, its verdict, and the plant and uncertainty after it."""
