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
