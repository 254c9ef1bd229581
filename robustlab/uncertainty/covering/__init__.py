"""Covers: the smallest uncertain set, of a chosen form, that holds every model of a set."""
