"""Nonsmooth optimisation of loops: families of closed loops, objectives with their gradients, descent."""
