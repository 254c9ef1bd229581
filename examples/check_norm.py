"""A second checker of one claim: a continuous model is stable and its H-infinity norm is at most gamma.

    robustlab verify norm.h5 --export claims.json && python examples/check_norm.py claims.json

It shares nothing with robustlab but the file. By the bounded-real lemma the claim holds where P > 0 and

    F = -[[A'P + PA + C'C, PB + C'D], [B'P + D'C, D'D - gamma^2 I]] > 0,

P + P_low in the place of P. A matrix is positive definite where all pivots of LDL' are balls above zero.
"""

import json
import sys
from pathlib import Path

from flint import arb, arb_mat, ctx

ctx.prec = 300  # bits


def matrix(numbers, name):
    """The exact matrix that the hexadecimal numbers are."""
    rows, cols = numbers[name]["shape"]
    return arb_mat(rows, cols, [float.fromhex(x) for x in numbers[name]["real"]])


def positive_definite(X):
    """Whether all pivots are surely positive."""
    n = X.nrows()
    rows = [[X[i, j] for j in range(n)] for i in range(n)]
    for k in range(n):
        if not rows[k][k] > 0:
            return False
        for i in range(k + 1, n):
            share = rows[i][k] / rows[k][k]
            rows[i] = [a - share * b for a, b in zip(rows[i], rows[k], strict=True)]
    return True


def proved(numbers):
    """Whether P proves the norm of this model."""
    A, B, C, D = (matrix(numbers, name) for name in "ABCD")
    P = matrix(numbers, "P") + matrix(numbers, "P_low")
    n, m = A.nrows(), B.ncols()
    gamma = arb(float.fromhex(numbers["gamma"]["real"][0]))
    corner = P * A + (P * A).transpose() + C.transpose() * C
    side, last = P * B + C.transpose() * D, D.transpose() * D
    rows = [[corner[i, j] for j in range(n)] + [side[i, j] for j in range(m)] for i in range(n)]
    rows += [
        [side[j, i] for j in range(n)] + [last[i, j] - (gamma**2 if i == j else 0) for j in range(m)] for i in range(m)
    ]
    F = -arb_mat(rows)
    return positive_definite(P) and positive_definite(F)


claims = json.loads(Path(sys.argv[1]).read_text(encoding="utf-8"))["claims"]
answers = [proved(claim["numbers"]) for claim in claims if claim["claim"] == "norm"]
print("proved" if answers and all(answers) else "not proved")
sys.exit(not (answers and all(answers)))
