"""An open benchmark of naming what a model lacks: blind cases, a scorer, and what three programs answered.

`composition` defines the cases, `dataset` writes them, `answers` is the form in which a program answers,
`scoring` judges, `regression` holds two programs to compare with. ``benchmarks/naming_benchmark.py`` is the command.
"""
