"""Structured controllers: their laws, the loops of them, what is minimised, and the search."""
