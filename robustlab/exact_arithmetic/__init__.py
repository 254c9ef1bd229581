"""Determinants of pencils as polynomials in whole numbers, and their roots: where rounding would decide, none happens.

A floating-point number is a fraction, so what a model says about its zeros, its poles and its loops' crossings is the
answer of a problem in whole numbers. `determinant` solves it modulo many primes at once, `roots` finds what the
polynomial's roots are to the last digit. Nothing here has a tolerance that a badly scaled model could meet.
"""

from robustlab.exact_arithmetic.determinant import MOST_STATES, Determinant, determinant, normal_rank, wired
from robustlab.exact_arithmetic.polynomials import (
    Root,
    added,
    common_factor,
    divided,
    from_the_circle,
    product,
    roots,
    value,
)

__all__ = [
    "MOST_STATES",
    "Determinant",
    "Root",
    "added",
    "common_factor",
    "determinant",
    "divided",
    "from_the_circle",
    "normal_rank",
    "product",
    "roots",
    "value",
    "wired",
]
