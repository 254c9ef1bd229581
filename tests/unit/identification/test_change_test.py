"""The sequential test against densities of scipy, and its detection of changes."""

import itertools

import numpy as np
import pytest
from scipy.special import logsumexp
from scipy.stats import multivariate_normal

from robustlab.identification import ChangeTest, PieceEquations, onset

# Priors of docs/watch.md: precision of a parameter, sizes of a change, pieces in which it grows, variances of random
# errors, their share.
DIFFUSE, SIZES, GROWING, SCATTERS, UNNAMED = 1e-4, (0.05, 0.5), 5.0, (1.0, 100.0), 0.5
SIZE = np.full(2, 0.4)


def piece(J, r, U):
    M = np.column_stack([J, r])
    within = U.T @ M
    return PieceEquations(M.T @ M, within.T @ within, len(r), U.shape[1])


def noise_only(rng, zeta, m=12):
    """J, r and slow directions of a piece in which nothing changes."""
    J = rng.normal(size=(m, 2))
    return J, rng.normal(size=m) - J @ zeta, np.linalg.qr(rng.normal(size=(m, 3)))[0]


def test_e_is_the_documented_mixture_of_densities():
    rng = np.random.default_rng(3)
    pieces = [noise_only(rng, np.array([0.3, -0.2])) for _ in range(3)]
    test = ChangeTest(SIZE)
    found = [test.add(piece(*p)) for p in pieces][-1]

    J, r = np.vstack([p[0] for p in pieces]), np.concatenate([p[1] for p in pieces])
    number = np.repeat(np.arange(3), 12)
    flat = J @ J.T / DIFFUSE + np.eye(36)

    def density(covariance):
        return multivariate_normal.logpdf(r, np.zeros(36), covariance)

    base, logs = density(flat), [-np.log(4.0)]  # remaining prior: later changes
    for tau in range(3):
        prior = -np.log((tau + 1.0) * (tau + 2.0))
        after, U = number >= tau, np.zeros((36, 9))
        for p in range(tau, 3):
            U[number == p, 3 * p : 3 * p + 3] = pieces[p][2]
        ways = [np.eye(36)[:, after], U]
        scatter = [density(flat + v * W @ W.T) - base for W in ways for v in SCATTERS]
        logs.append(prior + np.log(UNNAMED / len(scatter)) + logsumexp(scatter))
        if tau == 0:
            continue
        for column, grows, size in itertools.product(range(2), (False, True), SIZES):
            way = J[:, column] * after * ((number - tau + 1.0) if grows else 1.0)
            std = size * 0.4 / (GROWING if grows else 1.0)
            ratio = density(flat + std**2 * np.outer(way, way)) - base
            logs.append(prior + np.log((1.0 - UNNAMED) / 2.0 / 2.0 / len(SIZES)) + ratio)
    assert found == pytest.approx(float(logsumexp(logs)), abs=2e-4)


@pytest.mark.parametrize(("change", "column"), [("own", 1), ("growing", 1), ("scatter", None)])
def test_a_change_is_found_with_its_beginning(change, column):
    rng, test, zeta, evidence = np.random.default_rng(5), ChangeTest(SIZE), np.array([2.0, 1.0]), []
    for p in range(20):
        J, r, U = noise_only(rng, zeta, m=40)
        weight = 0.0 if p < 8 else (p - 7) / 6.0 if change == "growing" else 1.0
        if column is None:
            r = r + weight * U @ (3.0 * rng.normal(size=3))
        else:
            r = r - 0.9 * weight * J[:, column]
        evidence.append(test.add(piece(J, r, U)))
        if evidence[-1] > np.log(1e6):
            break
    assert max(evidence[:8]) < np.log(20.0) < np.log(1e6) < evidence[-1]
    assert abs(onset(test.evidence())[0] - 8) <= (2 if change == "growing" else 1)
