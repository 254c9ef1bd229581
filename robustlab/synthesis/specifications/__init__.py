"""From what is wanted to a problem, and from a loop to what is looked at.

weight_design     weights from specifications or measured noise, and whether they contradict
tracking_problem  a plant, what its outputs are to do and what disturbs it, as one weighted plant
loop_functions    S, T, K S, S G with their bounds, and curves of a finished design
"""
