"""rl.descriptor: transfer functions by hand, C (sE - A)^-1 B + D at random points, indices, files, refusals."""

import h5py
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.io import savemat
from scipy.linalg import block_diag, eigvals, expm

import robustlab as rl
from robustlab.cli import main_guard, run_command
from robustlab.dynamics import eliminated
from robustlab.errors import InputError

POINTS = np.array([0.3 + 0.2j, 2.0j, 4.0 - 1.0j, 30.0j])


def transfer(e, a, b, c, d, s):
    return d + c @ np.linalg.inv(s * e - a) @ b


def agrees(model, e, a, b, c, d, tolerance=1e-8):
    for s in POINTS:
        truth = transfer(e, a, b, c, d, s)
        got = transfer(np.eye(model.n_states), model.A, model.B, model.C, model.D, s)
        assert np.abs(got - truth).max() <= tolerance * max(1.0, np.abs(truth).max())


def test_an_invertible_e_keeps_the_states():
    # mass 2 kg on a spring of 8 N/m: 2 v' = -8 q + f
    m = rl.descriptor([[0, 1], [-8, 0]], [[0], [1]], [[1, 0]], [[0]], np.diag([1.0, 2.0]), states=["q", ("v", "m/s")])
    assert m.A.tolist() == [[0, 1], [-4, 0]]
    assert m.B.tolist() == [[0], [0.5]]
    assert [tuple(s) for s in m.states] == [("q", ""), ("v", "m/s")]


def test_algebraic_equations_are_eliminated_and_the_other_states_keep_their_names():
    # v' = i / C, 0 = u - v - R i, y = i with R = 2, C = 0.5; the algebraic state first
    e, a = [[0, 0.5], [0, 0]], [[1, 0], [-2, -1]]
    given = rl.StateSpaceModel(a, [[0], [1]], [[1, 0]], [[0]], states=[("i", "A"), ("v", "V")])
    m, kept, _ = eliminated(given, e)
    assert kept == [1]
    assert (m.A.item(), m.B.item(), m.C.item(), m.D.item()) == (-1.0, 1.0, -0.5, 0.5)
    assert [tuple(s) for s in m.states] == [("v", "V")]


@settings(max_examples=40)
@given(st.integers(0, 100_000), st.integers(0, 4), st.integers(0, 3), st.booleans())
def test_hidden_states_and_algebraic_equations_are_separated(seed, n, fixed, mixed):
    """Weierstrass form of index 1 with known poles, mixed by random transformations."""
    rng = np.random.default_rng(seed)
    total = n + fixed
    if total == 0:
        return
    j = rng.standard_normal((n, n)) - 2 * np.eye(n)
    e, a = block_diag(np.eye(n), np.zeros((fixed, fixed))), block_diag(j, np.eye(fixed))
    b, c, d = rng.standard_normal((total, 2)), rng.standard_normal((2, total)), rng.standard_normal((2, 2))
    if mixed:
        p, q = (expm(0.4 * rng.standard_normal((total, total))) for _ in range(2))
        e, a, b, c = p @ e @ q, p @ a @ q, p @ b, c @ q
    model, _, residual = eliminated(rl.StateSpaceModel(a, b, c, d), e)
    assert model.n_states == n
    assert residual < 1e-9
    agrees(model, e, a, b, c, d)
    np.testing.assert_allclose(np.sort_complex(model.poles()), np.sort_complex(eigvals(j)), atol=1e-7)


@pytest.mark.parametrize("mixed", [False, True])
@pytest.mark.parametrize("k", [2, 3])
def test_a_higher_index_is_refused(k, mixed):
    e, a = block_diag(np.eye(1), np.eye(k, k=1)), block_diag([[-1.0]], np.eye(k))
    if mixed:
        rng = np.random.default_rng(k)
        p, q = rng.standard_normal((2, k + 1, k + 1))
        e, a = p @ e @ q, p @ a @ q
    with pytest.raises(InputError, match="an index above 1"):
        rl.descriptor(a, np.ones((k + 1, 1)), np.ones((1, k + 1)), [[0.0]], e)


def test_bad_arguments_are_rejected():
    one = np.ones((2, 1)), np.ones((1, 2)), [[0.0]]
    with pytest.raises(InputError, match="descriptor: s E - A is singular for every s"):
        rl.descriptor([[1.0, 1.0], [1.0, 1.0]], *one, np.zeros((2, 2)))
    with pytest.raises(InputError, match=r"file.h5: E is \(1, 1\), expected \(2, 2\) as A"):
        rl.descriptor(np.eye(2), *one, [[1.0]], where="file.h5")
    with pytest.raises(InputError, match=r"descriptor: E\[0,1\] is NaN"):
        rl.descriptor(np.eye(2), *one, [[1.0, np.nan], [0.0, 1.0]])


# --- files ------------------------------------------------------------------------------------------------------------

CIRCUIT = {
    "A": np.array([[1.0, 0.0], [-2.0, -1.0]]), "B": np.array([[0.0], [1.0]]), "C": np.array([[1.0, 0.0]]),
    "D": np.zeros((1, 1)), "E": np.array([[0.0, 0.5], [0.0, 0.0]]),
}  # fmt: skip


def hdf5(path, prefix="", **changed):
    with h5py.File(path, "a") as file:
        for name, matrix in {**CIRCUIT, **changed}.items():
            file[f"{prefix}{name}"] = matrix
    return str(path)


def test_files_with_e(tmp_path, capsys):
    path = hdf5(tmp_path / "circuit.h5")
    savemat(tmp_path / "circuit.mat", CIRCUIT)
    for name in (path, str(tmp_path / "circuit.mat")):
        m = rl.load(name)
        assert (m.A.item(), m.C.item(), m.D.item()) == (-1.0, -0.5, 0.5)
    assert main_guard(lambda: run_command(["model", "show", path])) == 0
    assert "descriptor form of index 1: 1 of 2 states eliminated; relative residual" in capsys.readouterr().err
    turned = {name: matrix.T for name, matrix in CIRCUIT.items()}
    assert rl.load(hdf5(tmp_path / "turned.h5", **turned), transpose=True).A.item() == -1.0
    savemat(tmp_path / "plain.mat", {**CIRCUIT, "E": np.zeros((0, 0))})  # MATLAB's word for the identity
    assert rl.load(tmp_path / "plain.mat").A.tolist() == CIRCUIT["A"].tolist()


def test_bad_files_are_rejected(tmp_path):
    with pytest.raises(InputError, match=r"/E is \(1, 1\), expected \(2, 2\) as /A"):
        rl.load(hdf5(tmp_path / "small.h5", E=np.ones((1, 1))))
    with pytest.raises(InputError, match="an index above 1"):
        rl.load(hdf5(tmp_path / "improper.h5", A=np.eye(2), E=np.eye(2, k=1)))
    path = hdf5(tmp_path / "pair.h5", "nominal/")
    hdf5(path, "perturbed/")
    with pytest.raises(InputError, match="/nominal/E: a pair in descriptor form"):
        rl.load(path)
    assert rl.load(path, group="nominal").A.item() == -1.0
