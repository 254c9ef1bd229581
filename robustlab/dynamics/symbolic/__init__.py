"""Nonlinear plants of one's own, from equations written with CasADi and evaluated without it.

`equations` takes the user's expressions (`PlantEquations`), `tape` turns them into numbers, `tape_kernels` evaluates
and integrates those, `symbolic_plant` is the plant (`SymbolicPlant`).
"""
