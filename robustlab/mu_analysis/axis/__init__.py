"""Bounds that hold on the whole frequency axis: robust stability, worst-case gain, and the critical Delta."""
