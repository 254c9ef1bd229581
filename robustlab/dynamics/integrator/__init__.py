"""The compiled integrator's parts that every plant shares: its coefficients, its steps, and how kernels are loaded."""
