"""What to measure next: a menu of experiments, and how far apart hypotheses are in each."""
