"""Robust performance: direct minimisation over D(s) and G(s), with K from two Riccati equations."""
