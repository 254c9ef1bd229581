"""Margins of loops, and covers of sets of models judged by mu."""
