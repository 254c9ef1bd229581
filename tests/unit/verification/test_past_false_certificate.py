"""A number that an earlier version vouched for, and that is not true: the checker refutes it."""

from attack_cases import make_case

import robustlab as rl
from robustlab.evidence.designs import h2_claims
from robustlab.verification import Outcome, check


def test_an_h2_design_next_to_an_ill_posed_loop():
    # Case 578 of seed 11 of benchmarks/attack.py: a direct term of 1e-6 is left in the exact loop, none in doubles.
    data = make_case(11, 578).data
    P = data["P"]
    design = rl.h2(rl.StateSpaceModel(P.A, P.B, P.C, P.D, P.dt), data["n_meas"], data["n_con"])
    assert not design.status.trustworthy  # it was certified, with this gamma
    (claim,) = h2_claims(design)
    found = check(claim)
    assert found.outcome is Outcome.REFUTED
    assert "infinite" in found.where
