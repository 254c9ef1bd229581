"""`rl.tf`, `rl.zpk` and `rl.ss` against the polynomials in exact arithmetic and the converted objects."""

from fractions import Fraction

import control as ct
import numpy as np
import pytest
import scipy.signal
from numpy.testing import assert_allclose

import robustlab as rl
from robustlab.errors import InputError


def value(num, den, s):
    """Return num(s) / den(s) of the coefficients as stored, rounded once."""

    def at(coefficients):
        re, im = Fraction(0), Fraction(0)
        x, y = Fraction(complex(s).real), Fraction(complex(s).imag)
        for c in coefficients:
            re, im = re * x - im * y + Fraction(float(c)), re * y + im * x
        return re, im

    (a, b), (c, d) = at(num), at(den)
    size = c * c + d * d
    return complex(float((a * c + b * d) / size), float((b * c - a * d) / size))


@pytest.mark.parametrize(
    ("num", "den"),
    [
        ([1], [1, 1]),
        ([2.0, 1.0], [4.0, 3.0]),
        ([0, 0, 3], [0, 2, 1, 5]),
        ([1, 0, 0], [1, 0, 0, 0]),
        (3.0, [1e-6, 1e-3, 1]),
        ([1, 1e6], [1, 1e3, 1e9, 0]),
        ([5], 2),
    ],
)
def test_a_transfer_function_has_its_values_and_as_many_states_as_its_denominator(num, den):
    G = rl.tf(num, den)
    n, d = (np.trim_zeros(np.atleast_1d(p), "f") for p in (num, den))
    assert G.n_states == len(d) - 1
    for s in (0.3 + 2j, -0.7 + 0.1j, 40j, 1e4j):
        assert_allclose(G(s)[0, 0], value(n, d, s), rtol=1e-12)


def test_states_are_balanced_where_coefficients_are_far_apart():
    num, den = scipy.signal.butter(8, 1e5, analog=True)  # den from 1 to 1e40
    G = rl.tf(num, den)
    assert_allclose(
        np.sort_complex(G.poles()),
        np.sort_complex(scipy.signal.butter(8, 1e5, analog=True, output="zpk")[1]),
        rtol=1e-10,
    )
    assert max(np.abs(m).max() for m in (G.A, G.B, G.C)) < 1e6
    for w in (1e3, 1e5, 1e6):
        assert_allclose(G(1j * w)[0, 0], value(num, den, 1j * w), rtol=1e-11)


def test_a_common_root_is_a_hidden_mode():
    G = rl.tf([1, -1], [1, 1, -2])  # (s - 1) / ((s - 1)(s + 2))
    assert not G.is_stable()
    assert rl.zeros(G).kinds == ("output-decoupling",)
    assert_allclose(G(3j)[0, 0], 1 / (3j + 2), rtol=1e-14)


def test_several_channels():
    num = [[[1], [2, 1]], [[3], [4, 0]], [[0], [5]]]
    den = [[[1, 1], [1, 1]], [[1, 2], [1, 2]], [[1, 2], [1]]]
    G = rl.tf(num, den, inputs=["a", "b"], outputs=[("c", "m"), "d", "e"])
    assert (G.input_names, G.output_names, G.outputs[0].unit) == (("a", "b"), ("c", "d", "e"), "m")
    s = 0.4 + 1.5j
    assert_allclose(G(s), [[value(n, d, s) for n, d in zip(*rows, strict=True)] for rows in zip(num, den, strict=True)])
    assert G.n_states == 2  # rows with one denominator share its state
    assert rl.tf([[[1], [2]]], [1, 1]).n_states == 1
    assert rl.tf([[[1]], [[2]]], [1, 1]).n_states == 1


def test_ss_takes_a_multivariable_transfer_function_of_python_control():
    given = ct.tf([[[1], [2]], [[1], [1, 0]]], [[[1, 1], [1, 2]], [[1, 3], [1, 1]]])
    G = rl.ss(given)
    assert_allclose(G(0.7j), given(0.7j), rtol=1e-12)
    assert G.input_names == ("u[0]", "u[1]")


def test_a_sample_time_is_kept_and_an_unknown_one_is_refused():
    assert rl.ss(scipy.signal.dlti([1.0], [1.0, -0.5], dt=0.2)).dt == 0.2
    for system in (scipy.signal.dlti([1.0], [1.0, -0.5]), ct.tf([1.0], [1.0, -0.5], True)):
        with pytest.raises(InputError, match="dt=True"):
            rl.ss(system)
    with pytest.raises(InputError, match="its own"):
        rl.ss(rl.tf([1], [1, 1]), dt=0.1)
    with pytest.raises(InputError, match="no C, D"):
        rl.ss([[1.0]], [[1.0]])


# --- a pole common to several entries ---------------------------------------------------------------------------------

SHARED = {  # num, den, the gains of u = -K y, and of the loop: states, peak gain, disk margin at the input
    "an integrator": ([[[1]], [[1]]], [[[1, 0]], [[1, 1, 0]]], [2, 1], 2, 0.482720, 1.664101),
    "two": ([[[1]], [[1]]], [[[1, 0, 0]], [[1, 0]]], [2, 1], 2, 1.233862, 0.666667),
    "an unstable pole": ([[[1]], [[1]]], [[[1, -1]], [[1, 1, -2]]], [6, 3], 2, 0.180257, 1.420764),
}


@pytest.mark.parametrize("name", SHARED)
@pytest.mark.parametrize("dual", [False, True])
def test_entries_share_poles_that_are_not_stable(name, dual):
    num, den, gains, order, peak, margin = SHARED[name]
    if dual:
        num, den = ([[row[0] for row in side]] for side in (num, den))
    G = rl.tf(num, den)
    K = rl.ss([[gain] for gain in gains]) if dual else rl.ss([gains])
    assert G.n_states == order
    loop = G.feedback(K)
    assert rl.peak_gain(loop).value == pytest.approx(peak, rel=1e-5)
    at = "output" if dual else "input"
    assert rl.disk_margin(G, K, at=at).lower == pytest.approx(margin, rel=1e-5)
    assert rl.classical_margins(G, K, at=at).stable


def test_least_order_of_larger_matrices():
    quartic = [float(c) for c in np.poly([1] * 4)]  # ControlSystems.jl, issue 890
    G = rl.tf([[[1]], [[1]], [[1, 0]], [[1, 0, 0]], [[1, 0, 0, 0]]], [[[*quartic, 0.0]], *[[quartic]] * 4])
    assert G.n_states == 5
    assert rl.tf([[[1], [1]], [[1], [1]]], [1, 0]).n_states == 1  # rank one at the pole
    assert rl.tf([[[1], [0]], [[0], [1]]], [1, 0]).n_states == 2
    assert rl.tf([[[1e-9], [1e3]], [[1e-12], [1]]], [1, -1], 0.1).n_states == 1  # units do not matter
    assert rl.tf([[[1], [1]], [[1], [1 + 1e-9]]], [1, -1]).n_states == 2  # and small differences do
    assert rl.tf([[[0], [3]], [[0], [0]]], [1, 0]).n_states == 1
    assert rl.tf([[[2], [3]]], [1]).n_states == 0
    s = 0.3 + 0.8j
    num, den = [[[1, 2], [3]], [[4], [1, -1, 5]]], [[[1, -1, 0, 0], [1, 0]], [[1, -2, 1], [1, -1, 0, 0]]]
    wanted = [[value(n, d, s) for n, d in zip(*rows, strict=True)] for rows in zip(num, den, strict=True)]
    assert_allclose(rl.tf(num, den)(s), wanted, rtol=1e-12)


def test_a_warning_names_a_root_that_one_entry_cancels():
    with pytest.warns(UserWarning, match=r"tf: \[0\]\[1\]: a zero cancels the unstable mode 1 rad/s"):
        assert rl.tf([[[1], [1, -1]]], [[[1, 1], [1, 1, -2]]]).is_stable()
    rl.tf([[[1]], [[1, 0]]], [1, 0, 0])  # the common denominator of 1/s^2 and 1/s: nothing is lost


# --- zeros, poles, gain --------------------


def test_a_narrow_band_pass_keeps_its_poles():
    z, p, k = scipy.signal.butter(8, [2 * np.pi * 99, 2 * np.pi * 101], "bandpass", analog=True, output="zpk")
    G = rl.ss(scipy.signal.ZerosPolesGain(z, p, k))
    assert max(np.abs(p - pole).min() for pole in G.poles()) < 1e-12
    assert G.spectral_abscissa() == pytest.approx(-1.213766, rel=1e-6)
    assert abs(G(200j * np.pi)[0, 0]) == pytest.approx(1, rel=1e-11)
    assert rl.h2_norm(G).value == pytest.approx(2.00644, rel=3e-6)
    assert rl.peak_gain(G).value == pytest.approx(1, rel=1e-6)
    with pytest.warns(UserWarning, match="rounding of the coefficients moves the pole .*rl.zpk"):
        rl.ss(ct.zpk(z, p, k))


def test_repeated_poles_are_exact():
    G = rl.zpk([], [-1] * 6, 2.0, inputs=["u"])
    assert G.poles().tolist() == [-1] * 6
    assert_allclose(G(1j)[0, 0], 2 / (1 + 1j) ** 6, rtol=1e-14)
    D = rl.zpk([0.5, 0.2 + 0.3j, 0.2 - 0.3j], [1, 1, 1, 1e-3], 3.0, 0.1)
    assert sorted(D.poles().real) == [1e-3, 1, 1, 1]
    assert D.dt == 0.1
    z = np.exp(0.7j)
    assert_allclose(D(z)[0, 0], 3 * (z - 0.5) * ((z - 0.2) ** 2 + 0.09) / ((z - 1) ** 3 * (z - 1e-3)), rtol=1e-12)


def test_zeros_poles_and_gains_of_several_channels():
    G = rl.zpk([[[]], [[]]], [[[0]], [[0, -1]]], [[1.0], [1.0]])
    assert sorted(G.poles()) == [-1, 0]
    assert_allclose(G(2j), [[1 / 2j], [1 / (2j * (2j + 1))]], rtol=1e-14)
    assert rl.zpk([], [], 3.0).D.tolist() == [[3.0]]


@pytest.mark.parametrize(
    ("make", "given", "text"),
    [
        (rl.tf, ([1, 0, 0], [1, 1]), "num of degree 2 over den of degree 1: improper"),
        (rl.tf, ([1], [0, 0]), "den is zero"),
        (rl.tf, ([], [1]), "num is empty"),
        (rl.tf, ([1], [1, np.nan]), "NaN"),
        (rl.tf, ([1j], [1, 1]), "real numbers"),
        (rl.tf, ("s", [1]), "real numbers"),
        (rl.tf, ([[1, 2]], [1, 1]), "num nested 2 deep"),
        (rl.tf, ([[[1], [2]], [[3]]], [1, 1]), "different lengths"),
        (rl.tf, ([[[1], [2]]], [[[1, 1]]]), "different lengths"),
        (rl.tf, ([[[1, 0]]], [1]), r"\[0\]\[0\]: num of degree 1"),
        (rl.tf, ([1], [1e-300, 1e300]), "overflow"),
        (rl.zpk, ([0, 0], [-1], 1), "2 zeros and 1 poles: improper"),
        (rl.zpk, ([], [1j], 1), "without its conjugate"),
        (rl.zpk, ([], [np.inf], 1), "finite numbers"),
        (rl.zpk, ([], "s", 1), "numbers"),
        (rl.zpk, ([], [-1], [[1, 2]]), "gain: of shape"),
        (rl.zpk, ([], [-1], np.nan), r"gain\[0,0\] is NaN"),
        (rl.zpk, ([[[]]], [[[-1], [-2]]], [[1.0]]), "different lengths"),
        (rl.zpk, ([], [[-1]], 1), "nested"),
    ],
)
def test_invalid_arguments_are_refused(make, given, text):
    with pytest.raises(InputError, match=text):
        make(*given)
