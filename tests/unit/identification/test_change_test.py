"""The sequential test by itself: against densities of scipy, and by counting its alarms."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from scipy.special import logsumexp
from scipy.stats import binom, multivariate_normal, norm

from robustlab.identification.monitoring.change_test import (
    DIFFUSE,
    GROWING,
    SCATTERS,
    SIZES,
    UNNAMED,
    ChangeTest,
    Columns,
    PieceEquations,
    log_sum,
)


def piece(J, G, r, U):
    M = np.column_stack([J, G, r])
    within = U.T @ M
    return PieceEquations(M.T @ M, within.T @ within, len(r), U.shape[1])


def columns(k, g):
    return Columns(k, np.full(k + g, 1.0 / (k + g)), np.full(k + g, 0.4), np.arange(k + g) >= k)


def noise_only(rng, zeta, k=2, g=2, m=12):
    """J, G, r and slow directions of a piece in which nothing changes."""
    M = rng.normal(size=(m, k + g))
    return M[:, :k], M[:, k:], rng.normal(size=m) - M[:, :k] @ zeta, np.linalg.qr(rng.normal(size=(m, 3)))[0]


def test_e_is_the_mixture_of_densities_that_it_is_said_to_be():
    rng = np.random.default_rng(3)
    pieces = [noise_only(rng, np.array([0.3, -0.2])) for _ in range(3)]
    test = ChangeTest(columns(2, 2), 0, 1)
    found = [test.add(piece(*p)) for p in pieces][-1]

    J, r = np.vstack([p[0] for p in pieces]), np.concatenate([p[2] for p in pieces])
    number = np.repeat(np.arange(3), 12)
    flat = J @ J.T / DIFFUSE + np.eye(36)

    def density(covariance):
        return multivariate_normal.logpdf(r, np.zeros(36), covariance)

    def half(column, std):
        """A strength that is not negative: integrated by quadrature, noise = r + column * strength."""
        at = np.linspace(0.0, 8.0 * std, 301)
        logs = [multivariate_normal.logpdf(r + column * s, np.zeros(36), flat) for s in at]
        weights = np.log(2.0 * norm.pdf(at, scale=std) * (at[1] - at[0])) + np.log(np.where(at == 0.0, 0.5, 1.0))
        return logsumexp(np.array(logs) + weights)

    base, logs = density(flat), [-np.log(4.0)]  # what is left of the prior: changes that are still to come
    for tau in range(3):
        prior = -np.log((tau + 1.0) * (tau + 2.0))
        after, U = number >= tau, np.zeros((36, 9))
        for p in range(tau, 3):
            U[number == p, 3 * p : 3 * p + 3] = pieces[p][3]
        ways = [np.eye(36)[:, after], U]
        scatter = [density(flat + v * W @ W.T) - base for W in ways for v in SCATTERS]
        logs.append(prior + np.log(UNNAMED / len(scatter)) + logsumexp(scatter))
        if tau == 0:
            continue
        for column, grows, size in itertools.product(range(4), (False, True), SIZES):
            own = np.concatenate([np.column_stack(p[:2])[:, column] for p in pieces])
            way = own * after * ((number - tau + 1.0) if grows else 1.0)
            std = size * 0.4 / (GROWING if grows else 1.0)
            ratio = (half(way, std) if column >= 2 else density(flat + std**2 * np.outer(way, way))) - base
            logs.append(prior + np.log((1.0 - UNNAMED) / 2.0 / 4.0 / len(SIZES)) + ratio)
    assert found == pytest.approx(float(logsumexp(logs)), abs=2e-4)


def test_e_does_not_depend_on_what_the_parameters_are():
    rng = np.random.default_rng(8)
    pieces = [noise_only(rng, np.zeros(2)) for _ in range(5)]
    one, other = ChangeTest(columns(2, 2), 0, 1), ChangeTest(columns(2, 2), 0, 1)
    for J, G, r, U in pieces:
        assert one.add(piece(J, G, r, U)) == pytest.approx(other.add(piece(J, G, r - J @ [3.0, -2.0], U)), abs=5e-3)


@pytest.mark.parametrize("kind", ["normal", "uniform"])
def test_alarms_where_nothing_changes_are_as_rare_as_stated(kind):
    """300 runs of 10 pieces, with parameters of their own, and noise that is normal, or bounded with proxy one."""
    alpha, runs, alarms, rng = 0.05, 300, 0, np.random.default_rng(11)
    for _ in range(runs):
        test, largest, zeta = ChangeTest(columns(2, 2), 0, 1), -np.inf, rng.normal(size=2)
        for _ in range(10):
            J, G, r, U = noise_only(rng, zeta)
            if kind == "uniform":
                r = rng.uniform(-(3.0**0.5), 3.0**0.5, len(r)) - J @ zeta
            largest = max(largest, test.add(piece(J, G, r, U)))
        alarms += largest >= -np.log(alpha)
    assert alarms <= binom.ppf(0.999, runs, alpha)


@pytest.mark.parametrize(("change", "column"), [("own", 1), ("coming", 2), ("growing", 1), ("scatter", None)])
def test_a_change_is_found_with_its_beginning(change, column):
    rng, test, zeta, evidence = np.random.default_rng(5), ChangeTest(columns(2, 2), 0, 1), np.array([2.0, 1.0]), []
    for p in range(20):
        J, G, r, U = noise_only(rng, zeta, m=40)
        weight = 0.0 if p < 8 else (p - 7) / 6.0 if change == "growing" else 1.0
        if column is None:
            r = r + weight * U @ (3.0 * rng.normal(size=3))
        else:
            r = r - 0.9 * weight * np.column_stack([J, G])[:, column]
        evidence.append(test.add(piece(J, G, r, U)))
        if evidence[-1] > np.log(1e6):
            break
    assert max(evidence[:8]) < np.log(20.0) < np.log(1e6) < evidence[-1]
    found = test.alternatives()
    assert abs(int(found.since[np.argmax(found.each)]) - 8) <= (2 if change == "growing" else 1)
    named = log_sum(found.named, axis=(0, 1))
    assert log_sum(found.unnamed) > named.max() if column is None else int(np.argmax(named)) == column


def test_one_that_cannot_be_negative_is_not_found_with_the_wrong_sign():
    rng, tests = np.random.default_rng(5), (ChangeTest(columns(2, 2), 0, 1), ChangeTest(columns(2, 2), 0, 1))
    for p in range(12):
        J, G, r, U = noise_only(rng, np.zeros(2), m=40)
        for sign, test in zip((1.0, -1.0), tests, strict=True):
            test.add(piece(J, G, r - sign * (p >= 5) * 0.4 * G[:, 0], U))
    right, wrong = (log_sum(t.alternatives().named[:, :, 2]) for t in tests)
    assert wrong < 0.0 < 10.0 < right
