r"""Models from what one writes down: coefficients of transfer functions, matrices, objects of other programs.

.. math:: G(s) = \frac{b_n s^n + \cdots + b_0}{s^n + a_{n-1} s^{n-1} + \cdots + a_0} = b_n + C (s I - A)^{-1} B

with the companion matrix of the denominator for A, in states that powers of two balance.

References
----------
Kailath, *Linear Systems* (1980), section 2.1.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from robustlab.arrays import Array
from robustlab.errors import InputError, told_as
from robustlab.linear_analysis.magnitude import balancing_factors
from robustlab.signals import SignalLike, is_constant, real_array
from robustlab.statespace import StateSpaceModel, as_model

NESTED = "num[i][j], the coefficients from input j to output i: [[[1], [2]], [[3, 1], [4]]]"


@told_as("tf")
def tf(
    num: Any,
    den: Any,
    dt: float = 0.0,
    inputs: Iterable[SignalLike] | None = None,
    outputs: Iterable[SignalLike] | None = None,
) -> StateSpaceModel:
    r"""A model from the coefficients of its transfer function, highest power first.

    .. math:: G(s) = \frac{\mathrm{num}_0 s^m + \cdots + \mathrm{num}_m}{\mathrm{den}_0 s^n + \cdots + \mathrm{den}_n}

    Parameters
    ----------
    num, den
        Coefficients, real, shapes (m + 1,) and (n + 1,), m <= n. Of several channels lists ``num[i][j]`` of them, from
        input j to output i; ``den`` alike, or one for all.
    dt
        Sample time in s of a transfer function in z; 0 means continuous time.
    inputs, outputs
        Names, or (name, unit) pairs.

    Returns
    -------
    StateSpaceModel
        With n states, in balanced controllable form. A root that num and den share stays as a mode that no output
        shows, see `zeros`. Of several channels the entries of a column, or of a row, that have one denominator share
        states, whichever takes fewer; that need not be the least number.

    Raises
    ------
    InputError
        An improper transfer function, a denominator of zero, coefficients that are no finite real numbers.

    Examples
    --------
    >>> G = tf([1, 3], [1, 0.5, 4], inputs=["u"], outputs=["y"])
    >>> G, G(2j).round(12)
    (StateSpaceModel(2 states, [u] -> [y], continuous), array([[2.-3.j]]))
    """
    levels = _levels(num), _levels(den)
    if levels[0] == 3 and levels[1] in (1, 3):
        numerators = [list(row) for row in num]
        rows, columns = len(numerators), len(numerators[0]) if numerators else 0
        denominators = [[den] * columns] * rows if levels[1] == 1 else [list(row) for row in den]
        shape = {len(row) for row in (*numerators, *denominators)}
        if shape != {columns} or len(denominators) != rows or not columns:
            raise InputError("tf", "rows of num and den of different lengths", "as many entries in each row as inputs")
    elif max(levels) <= 1:
        numerators, denominators = [[num]], [[den]]
    else:
        found = f"num nested {levels[0]} deep, den {levels[1]} deep"
        raise InputError("tf", found, "two lists of numbers, or of several channels lists of them", NESTED)
    entries = [
        [
            _proper(n, d, f"tf: [{i}][{j}]" if levels[0] == 3 else "tf")
            for j, (n, d) in enumerate(zip(*row, strict=True))
        ]
        for i, row in enumerate(zip(numerators, denominators, strict=True))
    ]
    by_column = _of_columns(entries)
    by_row = _of_columns([list(column) for column in zip(*entries, strict=True)])
    if len(by_row[0]) < len(by_column[0]):
        A, B, C, D = by_row[0].T, by_row[2].T, by_row[1].T, by_row[3].T
    else:
        A, B, C, D = by_column
    return StateSpaceModel(A, B, C, D, dt, inputs, outputs, where="tf")


@told_as("ss")
def ss(
    A: Any,
    B: ArrayLike | None = None,
    C: ArrayLike | None = None,
    D: ArrayLike | None = None,
    dt: float = 0.0,
    inputs: Iterable[SignalLike] | None = None,
    outputs: Iterable[SignalLike] | None = None,
    states: Iterable[SignalLike] | None = None,
) -> StateSpaceModel:
    """A `StateSpaceModel`, from its matrices or from what another program made.

    Parameters
    ----------
    A
        Real matrix (n_x, n_x). Alone: a model of python-control or of scipy.signal (state space, transfer function,
        zeros and poles), anything that functions here take for a model, or a matrix or number, a static gain.
    B, C, D
        Real matrices (n_x, n_u), (n_y, n_x), (n_y, n_u).
    dt
        Sample time in s; 0 means continuous time. Of an object that is its own.
    inputs, outputs, states
        Names, or (name, unit) pairs.

    Returns
    -------
    StateSpaceModel
        What it does is said there.

    Raises
    ------
    InputError
        What `StateSpaceModel` refuses; some of the four matrices without the others; a discrete object whose sample
        time is not known.

    Examples
    --------
    >>> ss([[-2.0]], [[1.0]], [[1.0]], [[0.0]], inputs=["u"])
    StateSpaceModel(1 states, [u] -> [y1], continuous)
    """
    rest = {"B": B, "C": C, "D": D}
    missing = [name for name, matrix in rest.items() if matrix is None]
    if not missing:
        return StateSpaceModel(A, B, C, D, dt, inputs, outputs, states, where="ss")  # pyright: ignore[reportArgumentType]
    if len(missing) < len(rest):
        raise InputError("ss", f"no {', '.join(missing)}", "A, B, C and D, or a model alone")
    if is_constant(A):
        return StateSpaceModel([], [], [], real_array("D", A, 2, "ss"), dt, inputs, outputs, where="ss")
    model = _converted(A)
    if dt:
        raise InputError("ss", f"dt = {dt!r} beside a model", "its own", "rl.discretise, rl.d2d: another sample time")
    given = {"inputs": inputs, "outputs": outputs}
    return model.renamed(**given) if any(given.values()) else model


def _converted(system: Any) -> StateSpaceModel:
    """A model of python-control or scipy, or anything that is one here."""
    program, kind = type(system).__module__.partition(".")[0], type(system).__mro__
    if program == "control" and kind[0].__name__ == "TransferFunction" and (system.ninputs, system.noutputs) != (1, 1):
        if system.dt in (None, True):
            raise InputError("ss", f"dt={system.dt}", "dt = 0 or a sample time in s")
        return tf(system.num, system.den, float(system.dt), system.input_labels, system.output_labels)
    if program == "scipy" and any(parent.__name__ in ("lti", "dlti") for parent in kind):
        if system.dt is True:
            raise InputError("ss", "dt=True (discrete, sample time unknown)", "a sample time in s")
        if np.ndim(getattr(system, "num", [[]])) == 1:
            return tf(system.num, system.den, float(system.dt or 0.0))
        form = system.to_ss()
        return StateSpaceModel(form.A, form.B, form.C, form.D, float(system.dt or 0.0), where="ss")
    return as_model(system, "ss")


def _levels(given: Any) -> int:
    """How deep lists are nested; an array counts its dimensions."""
    if isinstance(given, (list, tuple)):
        return 1 + max(map(_levels, given), default=0)
    return np.ndim(given)


def _proper(num: Any, den: Any, where: str) -> tuple[Array, Array]:
    """Numerator, as long as the denominator, and the denominator, which begins with 1."""
    given = [real_array(name, np.atleast_1d(value), 1, where) for name, value in (("num", num), ("den", den))]
    b, a = (np.trim_zeros(polynomial, "f") for polynomial in given)
    if not len(a) or not len(given[0]):
        raise InputError(where, "num is empty" if len(a) else "den is zero", "a polynomial")
    if len(b) > len(a):
        found = f"num of degree {len(b) - 1} over den of degree {len(a) - 1}: improper"
        hint = "a derivative needs a pole: s / (tau s + 1) is tf([1, 0], [tau, 1])"
        raise InputError(where, found, "no more zeros than poles", hint)
    with np.errstate(over="ignore", invalid="ignore"):
        b, a = np.concatenate([np.zeros(len(a) - len(b)), b]) / a[0], a / a[0]
        if not np.isfinite([b, a, b[0] * a]).all():
            raise InputError(where, "coefficients whose ratios overflow", "numbers below 1e308 where den begins with 1")
    return b, a


def _of_columns(entries: list[list[tuple[Array, Array]]]) -> tuple[Array, Array, Array, Array]:
    """A, B, C, D of entries [i][j]: in each column one controllable form for each denominator."""
    from scipy.linalg import block_diag

    p, m = len(entries), len(entries[0])
    D = np.array([[b[0] for b, _ in row] for row in entries])
    As, Bs, Cs = [np.zeros((0, 0))], [np.zeros((0, m))], [np.zeros((p, 0))]
    for j in range(m):
        column = [row[j] for row in entries]
        for a in {tuple(a): a for _, a in column if len(a) > 1}.values():
            n = len(a) - 1
            of_it = [k for k, (b, own) in enumerate(column) if np.array_equal(own, a) and (b[1:] != b[0] * a[1:]).any()]
            if not of_it:
                continue  # constants
            A, B, C = np.eye(n, k=-1), np.zeros((n, m)), np.zeros((p, n))
            A[0], B[0, j] = -a[1:], 1.0
            for k in of_it:
                C[k] = column[k][0][1:] - column[k][0][0] * a[1:]
            t = balancing_factors(A)
            A, B, C = A * t / t[:, None], B / t[:, None], C * t
            even = np.exp2(np.round(0.5 * (np.log2(np.abs(B).max()) - np.log2(np.abs(C).max()))))
            As.append(A)
            Bs.append(B / even)
            Cs.append(C * even)
    return np.asarray(block_diag(*As)), np.vstack(Bs), np.hstack(Cs), D
