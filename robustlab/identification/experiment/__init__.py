"""What to measure next.

next_experiment   `propose_experiment`: the experiment that separates the named effects from their rivals best
experiment_bench  experiments as records that hypotheses predict, how far apart these are, and the signals to choose
from
shut_gaps         joints at which no backlash would show, and the motion that would show one
"""
