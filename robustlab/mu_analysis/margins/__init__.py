"""Margins of loops: disk margins, the small-gain test; and covers of sets of models judged by mu."""
