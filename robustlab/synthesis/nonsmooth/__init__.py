"""Nonsmooth optimisation of loops.

objectives        norm and entropy of one loop
loop_family       the loops of one plant with all controllers of an order, with gradients
design_limits     what a design must keep: poles, roll-off, a stable controller
design_problem    a law on several plants, as functions of variables without units
descent_methods   BFGS, and linear programs over all active peaks
parameter_search  many starts, the central path, descent, polish; descent from one controller
"""
