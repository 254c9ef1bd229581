"""`discover`: the search over sets of effects, their probabilities, the answer, and the plant after it."""
