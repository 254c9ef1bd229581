"""Answers do not depend on the machine's load: budgets count work, and a clock that ends a search is told."""

from __future__ import annotations

from repeatable import same_under_load


def test_mu_to_a_tolerance_is_the_same_under_load():
    found = same_under_load("""
rng = np.random.default_rng(3)
M = rng.standard_normal((2, 8, 8)) + 1j * rng.standard_normal((2, 8, 8))
bounds = rl.mu(M, [[-1, 0]] * 8, tolerance=1e-4, effort=0.002)
print(*bounds.notes, digest(bounds))
""")
    assert "work budget used up; a larger effort may prove more" in found


CHAIN = """
n = 8
D = np.zeros((n + 1, n + 1))
A = np.diag(-np.arange(1.0, n + 1)) + 0.6 * np.diag(np.ones(n - 1), 1) - 0.5 * np.diag(np.ones(n - 1), -1)
B, C = np.hstack([0.4 * np.eye(n), np.ones((n, 1))]), np.vstack([np.eye(n), np.ones((1, n))])
model = rl.UncertainModel(rl.StateSpaceModel(A, B, C, D), [rl.RealScalar(f"p{i}") for i in range(n)])
"""


def test_the_worst_member_is_the_same_under_load_and_for_any_number_of_threads():
    found = same_under_load(
        CHAIN
        + """
found = [rl.worst_case(model, "h2", n=64, workers=w, effort=e) for w, e in ((1, 1.0), (1, 1e-3), (2, 1e-3))]
print(*[f.status for f in found], found[1].label, digest(found[0]), digest(found[1]), digest(found[2]))
"""
    )
    assert found.startswith("converged inconclusive inconclusive ")
    assert "work budget used up" in found
    assert found.split()[-1] == found.split()[-2]
