"""Nonsmooth optimisation of loops."""
