"""From what is wanted to a problem, and from a loop to what is looked at: weights, tracking, loop functions."""
