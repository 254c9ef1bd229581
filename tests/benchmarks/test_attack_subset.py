"""A small fixed part of the attack on certificates, the judge on closed forms, and false claims it must detect."""

import math
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("flint")

import attack_zeros
import zeros_judge
from attack import call, claim_of, run_case
from attack_cases import FAMILIES, FUNCTIONS, Case, make_case
from attack_verdicts import judge
from exact_delta import Part, distance_to_singular, proves, singular_inside
from exact_loops import Model, exact, is_stable, with_precision
from verify_claims import MAKERS
from verify_judge import judge as judge_of_checker

import robustlab as rl

# Half of a round through all families and functions, like a chess board; the first two rows have every function.
SUBSET = [
    k if k < 2 * len(FUNCTIONS) else pytest.param(k, marks=pytest.mark.slow)
    for k in range(80)
    if (k // len(FUNCTIONS) + k % len(FUNCTIONS)) % 2 == 0
]
LAG = Model(*map(np.array, ([[-1.0]], [[1.0]], [[1.0]], [[0.0]])))


@pytest.mark.parametrize("index", SUBSET)
def test_no_certificate_of_the_subset_is_false(index):
    record = run_case(make_case(1, index))
    assert record["outcome"] in ("held", "refused", "not certified"), record


# --- what the attack has found ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("index", [311, 511])
def test_rounding_at_the_peak_counts_in_a_norm(index):
    # Poles 1e-11 from the axis and fast ones: the gain was off by 2e-5 and 1e-6 and certified to 1e-6.
    assert run_case(make_case(2, index))["outcome"] != "false"


HELD = [
    (1, 38),  # real mu of a nearly defective matrix
    (3, 429),  # the gain of a member whose response loses digits
    (41, 5),  # and of one whose pole 1e-7 from the unit circle cost 6.9e-5 of it, of which 5.5e-5 were counted
    (41, 118),  # next to a double root Delta was singular to within 1.5e-8, where 1e-8 is stated
]


@pytest.mark.parametrize(("seed", "index"), HELD)
def test_what_was_false_holds(seed, index):
    assert run_case(make_case(seed, index))["outcome"] == "held"


def test_mu_below_the_inverse_of_the_largest_float():
    # A Delta of size 1e322 was given, whose entries were infinite, as one that is singular.
    data = {"matrix": np.array([[1.2e-322]]) + 0j, "parts": (Part("complex", 1, 1),)}
    case = Case(0, 0, "mu", "denormals and huge entries", data)
    bounds = call(case)
    assert bounds.lower == 0
    assert np.isfinite(bounds.delta).all()
    assert bounds.upper >= 1.2e-322
    assert run_case(case)["outcome"] in ("held", "not certified")


# --- the judge on closed forms ---------------------------------------------------------------------------------------


def exactly(test):
    return with_precision(test)


@pytest.mark.parametrize(
    ("A", "dt", "stable"),
    [
        ([[-1.0, 1e6], [0.0, -1.0]], 0, True),
        ([[0.0, 1.0], [0.0, -1.0]], 0, False),  # an integrator
        ([[-5e-324, 1.0], [0.0, -1.0]], 0, True),
        ([[1e-300, 1e300], [0.0, -1.0]], 0, False),
        ([[0.0, 1.0], [-1.0, -1e-200]], 0, True),
        ([[0.0, 1.0], [-1.0, 1e-200]], 0, False),
        ([[1 - 2**-53, 1.0], [0.0, 0.5]], 1, True),
        ([[1.0, 1.0], [0.0, 0.5]], 1, False),
        ([[-1.0]], 1, False),
        ([[1j * 3 - 1]], 0, True),
        ([[1j * 3 + 1e-30]], 0, False),
    ],
)
def test_stability_is_exact(A, dt, stable):
    assert (exactly(lambda: is_stable(exact(np.array(A)), dt > 0)) is True) == stable


def test_singular_deltas():
    M, parts = np.array([[0, 4.0], [1.0, 0]]) + 0j, (Part("complex", 1, 1), Part("complex", 1, 1))
    delta = np.diag([0.5, 0.5]) + 0j
    assert distance_to_singular(M, parts, delta)[0] < 1e-15
    assert 1e-7 < distance_to_singular(M, parts, delta * (1 + 1e-6))[0] < 1e-5
    rng = np.random.default_rng(0)
    assert singular_inside(M, parts, 0.499, rng) is None
    assert abs(singular_inside(M, parts, 0.51, rng) - 0.505) < 0.0051
    D = np.diag([1.0, 4.0]) + 0j
    assert proves(M, D, D, np.zeros((2, 2)) + 0j, 2 * (1 + 1e-12))
    assert not proves(M, D, D, np.zeros((2, 2)) + 0j, 2 * (1 - 1e-12))


# --- false claims ----------------------------------------------------------------------------------------------------

ORDINARY = 8 * FAMILIES.index("ordinary")


def found(case, claim, **changes):
    findings = judge(case, claim | changes, np.random.default_rng(1))
    return [f for f in findings if f.startswith("FALSE")]


def certified(function, seed=11):
    """Return an ordinary case and a true certified claim about it."""
    case = make_case(seed, ORDINARY + FUNCTIONS.index(function))
    claim = claim_of(case, call(case))
    assert claim["trusted"]
    assert not found(case, claim)
    return case, claim


@pytest.mark.parametrize("function", ["hinf", "mixsyn", "h2", "ncf"])
def test_false_claims_about_designs_are_found(function):
    case, claim = certified(function)
    assert found(case, claim, gamma=0.99 * claim["gamma"])
    K = claim["K"]
    # A controller with an unstable mode that is neither observable nor controllable.
    n, hidden = len(K.A), np.zeros((len(K.A), 1))
    unstable = Model(
        np.block([[K.A, hidden], [hidden.T, np.array([[1e-9 if not K.dt else 1 + 1e-9]])]]),
        np.vstack([K.B, np.zeros((1, K.B.shape[1]))]),
        np.hstack([K.C, np.zeros((len(K.C), 1))]),
        K.D,
        K.dt,
    )
    assert len(unstable.A) == n + 1
    change = {"K": unstable} | ({"K_shaped": unstable} if function == "ncf" else {})
    assert any("not stable" in f for f in found(case, claim, **change))


def test_false_claims_about_norms_are_found():
    case, claim = certified("norm")
    assert found(case, claim, upper=0.99 * claim["lower"], lower=0.98 * claim["lower"])
    assert found(case, claim, lower=1.01 * claim["upper"], upper=1.02 * claim["upper"])
    assert found(case, claim, lower=np.inf, upper=np.inf)
    outside = Model(*map(np.array, ([[1e-9]], [[1.0]], [[1.0]], [[0.0]])))
    false = {"trusted": True, "lower": 1.0, "upper": 1.0, "frequency": 0.0, "h2_trusted": True, "h2": 1.0}
    assert len(found(Case(0, 0, "norm", "ordinary", {"G": outside}), false)) == 2
    assert found(Case(0, 0, "norm", "ordinary", {"G": LAG}), false | {"h2": 0.7})


def test_false_claims_about_mu_are_found():
    case, claim = certified("mu", 14)
    assert claim["lower"] > 0.98 * claim["upper"]
    assert found(case, claim, upper=0.99 * claim["lower"], lower=0.98 * claim["lower"])
    assert found(case, claim, delta=0.99 * claim["delta"])
    assert found(case, claim, delta=0.99 * claim["delta"], lower=claim["lower"] / 0.99, upper=claim["upper"] / 0.98)
    assert found(case, claim, D=claim["D"] + np.full(claim["D"].shape, 1e-12))


def test_false_claims_about_margins_are_found():
    case, claim = certified("margin", 21)
    assert np.isfinite(claim["upper"])
    assert found(case, claim, delta=0.99 * claim["delta"])
    assert found(case, claim, delta=0.99 * claim["delta"], upper=0.99 * claim["upper"], lower=0.9 * claim["lower"])
    assert found(case, claim, lower=1.02 * claim["upper"], upper=np.inf)
    members, low, high, beta, *scalings = claim["pieces"][0]
    assert found(case, claim, pieces=[(members, low, high, 0.5 * beta, *scalings)])


def test_h2_of_entries_that_overflow_is_refused_in_a_line():
    record = run_case(make_case(12, 370))
    assert (record["outcome"], record["kind"]) == ("refused", "NoTrustworthyNumber")


def test_mu_of_a_matrix_with_denormal_entries():
    # a bare LinAlgError of the singular values; by hand: both scalars are one, mu is the larger eigenvalue's modulus
    data = {"matrix": np.array([[1.5 - 2j, 2e-322], [2e-322, -1.0]]), "parts": (Part("complex", 2, 2),)}
    record = run_case(Case(0, 0, "mu", "denormals and huge entries", data))
    assert record["outcome"] == "held"
    assert abs(record["figures"]["lower"] - 2.5) < 1e-8


def test_false_claims_about_gains_are_found():
    case, claim = certified("gain")
    assert found(case, claim, upper=0.99 * claim["lower"], lower=0.98 * claim["lower"])
    assert found(case, claim, lower=1.01 * claim["upper"], upper=1.02 * claim["upper"])
    assert found(case, claim, lower=np.inf, upper=np.inf)


# --- the judge of the checker: true claims pass, false ones do not -----------------------------------------------

LEVELS = {"norm": "gamma", "mu-upper": "level", "mu-axis": "level", "worst-gain": "gamma", "gramian": "value"}


@pytest.mark.parametrize("kind", LEVELS)
def test_a_level_that_is_too_low_is_found(kind):
    rng, found = np.random.default_rng(3), 0
    for _ in range(6):
        case = MAKERS[kind](rng)
        if case is None:
            continue
        assert judge_of_checker(kind, case.numbers, True, case.hints) == ""
        false = case.numbers | {LEVELS[kind]: np.asarray(case.numbers[LEVELS[kind]]) * 0.5}
        assert judge_of_checker(kind, false, True, case.hints).startswith(("false", "unjustified"))
        found += 1
    assert found


# --- zeros and crossings: nothing that is vouched for is wrong, in exact arithmetic -----------------------------------

# The first cases of every family, and what the attack has found: a slow zero on the right that was taken for a hidden
# mode, products of matched zeros that overflow, poles that rounding moves over the axis.
ZEROS = {
    "zeros": range(12 * len(attack_zeros.FAMILIES)),
    "crossings": range(7 * len(attack_zeros.LOOPS)),
}


@pytest.mark.parametrize("what", ZEROS)
def test_nothing_that_is_vouched_for_is_wrong(what):
    found = [attack_zeros.CASES[what](i) for i in ZEROS[what]]
    assert [r for r in found if r["wrong"]] == []
    vouched = sum(r["status"] in ("converged", "certified") for r in found)
    assert vouched >= 0.97 * len(found)


def test_the_judge_on_closed_forms():
    assert zeros_judge.invariant_zeros([[-1e-6]], [[1.0]], [[1.0]], [[1.0]]) == ([pytest.approx(-1 - 1e-6)], 1)
    lag = zeros_judge.Loop([[1.0]], [[1.0]], [[4.0]], [[0.0]])  # 4/(s - 1): |L| = 1 at sqrt(15)
    gain, phase = lag.crossings()
    assert gain == [(pytest.approx(15**0.5), pytest.approx(math.acos(0.25)))]
    assert (phase, lag.stable_closed(), lag.above_one(3.8), lag.above_one(3.9)) == ([], True, True, False)


def test_the_judge_catches_what_is_missing():
    parts = tuple(map(np.array, ([[0.0, 1.0], [-6.0, -5.0]], [[0.0], [1.0]], [[2.0, 1.0]], [[0.0]])))
    found = rl.zeros(rl.StateSpaceModel(*parts))
    rng = np.random.default_rng(0)
    assert attack_zeros.zeros_fault(parts, found, rng) == ""
    for false in (replace(found, values=found.values[:0]), replace(found, values=found.values * (1 + 1e-8))):
        assert attack_zeros.zeros_fault(parts, false, rng)
    unstable = ([[1.0]], [[1.0]], [[4.0]], [[0.0]])
    loop, margin = zeros_judge.Loop(*unstable), rl.classical_margins(rl.StateSpaceModel(*unstable)).channels["y1"]
    assert attack_zeros.crossings_fault(loop, margin) == ""
    assert attack_zeros.crossings_fault(loop, replace(margin, gain_crossings=()))
    assert attack_zeros.crossings_fault(loop, replace(margin, phase_margin=margin.phase_margin * 1.001))
