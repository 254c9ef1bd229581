"""Specifications as problems (weights, tracking problems), and the closed-loop functions of a design."""
