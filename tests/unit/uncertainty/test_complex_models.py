"""Complex entries: rejected with the reason by every source of models; the real model of twice the size is right."""

import h5py
import numpy as np
import pytest
from scipy.io import savemat

import robustlab as rl
from robustlab.errors import InputError

A, B, C, D = np.array([[-1.0 + 2.0j]]), np.ones((1, 1)), np.ones((1, 1)), np.zeros((1, 1))
LAG = rl.StateSpaceModel([[-1.0]], B, C, D)


def hdf5(path, **changed):
    with h5py.File(path, "w") as file:
        for name, matrix in {"A": -B, "B": B, "C": C, "D": D, **changed}.items():
            file[name] = matrix
    return path


def matlab(path):
    savemat(path, {"A": A, "B": B, "C": C, "D": D})
    return path


def stored(path, thing, matrix):
    rl.save(path, thing)
    with h5py.File(path, "a") as file:
        del file[matrix]
        file[matrix] = A
    return path


UNCERTAIN = rl.UncertainModel(
    rl.StateSpaceModel([[-1.0]], [[-0.2, 1.0]], [[1.0], [1.0]], np.zeros((2, 2))), [rl.RealScalar("k")]
)


@pytest.mark.parametrize(
    ("make", "name"),
    [
        (lambda _: rl.StateSpaceModel(A, B, C, D), "A"),
        (lambda _: rl.StateSpaceModel(-B, B, C, D + 0j), "D"),
        (lambda _: rl.descriptor(-B, B, C, D, A), "E"),
        (lambda _: np.array([[1j]]) @ LAG, "gain"),
        (lambda folder: rl.load(hdf5(folder / "m.h5", A=A)), "A"),
        (lambda folder: rl.load(hdf5(folder / "m.h5", E=A)), "E"),
        (lambda folder: rl.load(matlab(folder / "m.mat")), "A"),
        (lambda folder: rl.load(stored(folder / "m.h5", LAG, "A"), no_verify=True), "A"),
        (lambda folder: rl.load(stored(folder / "m.h5", UNCERTAIN, "M/A"), no_verify=True), "/M/A"),
        (lambda folder: rl.load(stored(folder / "m.h5", rl.Controller(LAG), "A"), no_verify=True), "A"),
    ],
)
def test_every_constructor_and_every_file_rejects_them(make, name, tmp_path):
    with pytest.raises(InputError, match=f"{name} has dtype complex128, expected real numbers") as caught:
        make(tmp_path)
    assert "[[Re, -Im], [Im, Re]]" in str(caught.value.hint)
    assert "frequencies from 0 up" in str(caught.value.hint)


def test_the_real_model_of_twice_the_size_is_the_complex_one():
    rng = np.random.default_rng(1)
    sizes = ((3, 3), (3, 2), (2, 3), (2, 2))
    a, b, c, d = (rng.standard_normal(size) + 1j * rng.standard_normal(size) for size in sizes)
    a -= 4 * np.eye(3)
    real = rl.StateSpaceModel(*(np.block([[m.real, -m.imag], [m.imag, m.real]]) for m in (a, b, c, d)))

    def singular_values(omega):
        return np.linalg.svd(d + c @ np.linalg.solve(1j * omega * np.eye(3) - a, b), compute_uv=False)

    for omega in (0.0, 0.7, 5.0):
        found = np.linalg.svd(rl.frequency_response(real, [omega])[0], compute_uv=False)
        truth = np.sort(np.concatenate([singular_values(omega), singular_values(-omega)]))[::-1]
        np.testing.assert_allclose(found, truth)
    peak = max(singular_values(omega)[0] for omega in np.linspace(-40, 40, 20001))
    assert rl.peak_gain(real).upper == pytest.approx(peak, rel=1e-5)
