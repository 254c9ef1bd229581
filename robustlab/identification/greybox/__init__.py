"""Hypotheses on missing effects: prepared records, candidate effects, fits, and their residual force."""
