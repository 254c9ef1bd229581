"""Robust performance: D-K iteration, direct minimisation over the scalings, D-G-K."""
