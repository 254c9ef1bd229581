"""Nonlinear plants of one's own, from equations written with CasADi and evaluated without it."""
