"""Files with wrong numbers that earlier versions certified: the command proves none of them."""

from pathlib import Path

import h5py
import numpy as np
import pytest
from attack_cases import make_case
from exact_loops import Model, h2_norm, system, with_precision
from scipy.linalg import solve_continuous_lyapunov

import robustlab as rl
from robustlab.cli import main_guard, run_command
from robustlab.evidence import hinf_claims
from robustlab.norms import loop_numbers, model_numbers
from robustlab.verification import Claim, Outcome, check

HOSTILE = Path(__file__).parents[4] / "shared" / "data" / "hostile" / "hinf_r150.npz"


def written(path, claim):
    with h5py.File(path, "w") as file:
        group = file.create_group("claims/0")
        group.attrs["claim"] = claim.kind
        for name, values in claim.numbers.items():
            group[name] = values
    return path


def command(path):
    return main_guard(lambda: run_command(["verify", str(path)]))


def test_an_h2_design_next_to_an_ill_posed_loop():
    # Case 578 of seed 11 of benchmarks/attack.py: a direct term of 1e-6 is left in the exact loop, none in doubles.
    data = make_case(11, 578).data
    P = data["P"]
    with pytest.raises(rl.NoTrustworthyNumber, match="no controller could be verified"):  # one was certified
        rl.h2(rl.StateSpaceModel(P.A, P.B, P.C, P.D, P.dt), data["n_meas"], data["n_con"])


@pytest.mark.slow
@pytest.mark.skipif(not HOSTILE.exists(), reason="needs ../shared")
def test_a_stiff_h_infinity_loop(tmp_path, capsys):
    """Certified 16.2949 once, 17.25 in truth; with the true number the same loop is proved."""
    d = np.load(HOSTILE)
    n_y, n_u = (int(x) for x in d["dims"][2:])
    plant = rl.StateSpaceModel(d["A"], d["B"], d["C"], d["D"])
    K = rl.StateSpaceModel(d["kA"], d["kB"], d["kC"], d["kD"])
    numbers = loop_numbers(plant, K)
    found = check(Claim("loop-norm", {**numbers, "gamma": np.array(16.2949)}))
    assert found.outcome is Outcome.REFUTED
    assert command(written(tmp_path / "false.h5", Claim("loop-norm", {**numbers, "gamma": np.array(16.2949)}))) == 1
    assert "refuted" in capsys.readouterr().out
    true = command(written(tmp_path / "true.h5", Claim("loop-norm", {**numbers, "gamma": np.array(17.2509286)})))
    assert true == 4  # the number is proved; a bare claim is no file whose display could be
    assert "proved: the loop is stable" in capsys.readouterr().out
    design = rl.hinf(plant, n_y, n_u)
    assert all(check(claim).outcome is Outcome.PROVED for claim in hinf_claims(design))


# Poles with damping of 1e-5 and less: a Gramian in doubles, once the only voice, is off by 1e-6 to 0.1.
@pytest.mark.parametrize("index", [2591, 18831, 30831])
def test_an_h2_norm_from_one_gramian(tmp_path, index):
    data = make_case(71, index).data["G"]
    G = rl.StateSpaceModel(data.A, data.B, data.C, data.D, data.dt)
    reached, seen = solve_continuous_lyapunov(G.A, -G.B @ G.B.T), solve_continuous_lyapunov(G.A.T, -G.C.T @ G.C)
    exact = with_precision(lambda: h2_norm(system(Model(data.A, data.B, data.C, data.D, data.dt))))
    value = np.sqrt(min(np.trace(G.C @ reached @ G.C.T), np.trace(G.B.T @ seen @ G.B)))
    if exact is not None:  # on another processor the Gramian may be off the other way
        value = min(value, float(exact) * (1 - 1e-6))
    claim = Claim("gramian", {**model_numbers(G), "P": 0.5 * (reached + reached.T), "value": np.array(value)})
    assert check(claim).outcome is not Outcome.PROVED
    assert command(written(tmp_path / "claim.h5", claim)) in (1, 4)
