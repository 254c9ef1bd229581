"""What to measure next.

next_experiment   `propose_experiment`: the experiment that separates the named effects from their rivals best
path_experiment   `propose_path`: the same of a platform under control, as a path of its pose
path_menu         paths of a platform's pose to choose from, as large as the machine allows
experiment_bench  experiments as records that hypotheses predict, how far apart these are, and the signals to choose
from
shut_gaps         joints at which no backlash would show, and the motion that would show one
"""
