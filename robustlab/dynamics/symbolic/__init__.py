"""User-defined nonlinear plants, from equations written with CasADi and evaluated without it."""
