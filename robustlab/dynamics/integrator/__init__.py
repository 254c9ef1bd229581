"""Shared parts of the compiled integrator: coefficients, steps, loading of kernels."""
