r"""Models from coefficients of transfer functions, zeros and poles, matrices, and objects of other programs.

.. math:: G(s) = \frac{b_n s^n + \cdots + b_0}{s^n + a_{n-1} s^{n-1} + \cdots + a_0} = b_n + C (s I - A)^{-1} B

with the companion matrix of the denominator for A, in states balanced by powers of two. Zeros, poles and gain become a
cascade of sections of first and second order whose A has the poles on its block diagonal: no polynomial is formed.

References
----------
Kailath, *Linear Systems* (1980), section 2.1.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from robustlab.arrays import Array, ComplexArray
from robustlab.errors import InputError, error_context
from robustlab.linear_analysis.matrices import balancing_exponents, balancing_factors
from robustlab.linear_analysis.structural import hidden_unstable, least_order
from robustlab.signals import SignalLike, is_constant, real_array
from robustlab.statespace import StateSpaceModel, as_model, parallel

Part = tuple[Array, Array, Array]  # A, B, C

# A pole is sensitive if one rounding of each coefficient moves it by more than the first share of its modulus, or the
# second share of its distance to the stability boundary. Poles nearer than the third share count as on it.
SENSITIVE, NEARER, ON_IT = 1e-3, 0.1, 1e-6
# Distance, as a share of the entry's norm, up to which a pole of the model is that of the entry.
LOST = 1e-6
# Two roots are a conjugate pair, and one is real, up to this share of their modulus.
PAIRED = 1e-12

NESTED = "num[i][j], the coefficients from input j to output i: [[[1], [2]], [[3, 1], [4]]]"


@error_context("tf")
def tf(
    num: Any,
    den: Any,
    dt: float = 0.0,
    inputs: Iterable[SignalLike] | None = None,
    outputs: Iterable[SignalLike] | None = None,
) -> StateSpaceModel:
    r"""Make a model from the coefficients of its transfer function, highest power first.

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
        Of one channel with n states, in balanced controllable form; a common root of num and den is an unobservable
        mode, see `zeros`. Of several channels with the least number of states (`minimal`), so that a pole common to
        entries occurs once.

    Raises
    ------
    InputError
        An improper transfer function, a denominator of zero, coefficients that are no finite real numbers.

    Warns
    -----
    UserWarning
        Rounding of the coefficients moves a pole (see `zpk`). An entry of several has an unstable or integrating pole
        that its numerator cancels: the model is without it.

    Examples
    --------
    >>> G = tf([1, 3], [1, 0.5, 4], inputs=["u"], outputs=["y"])
    >>> G, G(2j).round(12)
    (StateSpaceModel(2 states, [u] -> [y], continuous), array([[2.-3.j]]))
    """
    levels = _levels(num), _levels(den)
    several = levels[0] == 3 and levels[1] in (1, 3)
    if several:
        numerators = [list(row) for row in num]
        rows, columns = len(numerators), len(numerators[0]) if numerators else 0
        denominators = [[den] * columns] * rows if levels[1] == 1 else [list(row) for row in den]
        _check_rows("num and den", numerators, denominators)
    elif max(levels) <= 1:
        numerators, denominators = [[num]], [[den]]
    else:
        found = f"num nested {levels[0]} deep, den {levels[1]} deep"
        raise InputError("tf", found, "two lists of numbers, or of several channels lists of them", NESTED)
    entries = [
        [_proper(n, d, f"tf: [{i}][{j}]" if several else "tf") for j, (n, d) in enumerate(zip(*row, strict=True))]
        for i, row in enumerate(zip(numerators, denominators, strict=True))
    ]
    for a in {tuple(a): a for row in entries for _, a in row}.values():
        _warn_of_sensitive_poles(a, dt)
    D = [[b[0] for b, _ in row] for row in entries]
    by_column = _of_columns(entries)
    if not several:
        A, B, C = by_column[0] if by_column else (np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)))
        return StateSpaceModel(A, B, C, D, dt, inputs, outputs, where="tf")
    by_row = [(A.T, C.T, B.T) for A, B, C in _of_columns([list(column) for column in zip(*entries, strict=True)])]
    parts = min(by_column, by_row, key=lambda parts: sum(len(A) for A, _, _ in parts))
    alone = {(i, j): _of_columns([[entry]]) for i, row in enumerate(entries) for j, entry in enumerate(row)}
    return _least(parts, D, alone, dt, inputs, outputs, "tf")


@error_context("zpk")
def zpk(
    zeros: Any,
    poles: Any,
    gain: Any,
    dt: float = 0.0,
    inputs: Iterable[SignalLike] | None = None,
    outputs: Iterable[SignalLike] | None = None,
) -> StateSpaceModel:
    r"""Make a model from its zeros, poles and gain, without polynomials, so that its poles are those given.

    .. math:: G(s) = k \frac{(s - z_1) \cdots (s - z_m)}{(s - p_1) \cdots (s - p_n)}

    Parameters
    ----------
    zeros, poles
        In rad/s (in the z plane with ``dt``), complex ones with their conjugates, m <= n. Of several channels lists
        ``zeros[i][j]`` of them, from input j to output i; ``poles`` alike.
    gain
        k, real; of several channels a matrix.
    dt, inputs, outputs
        As in `tf`.

    Returns
    -------
    StateSpaceModel
        A cascade of sections of first and second order, whose A is block triangular with the poles on its diagonal. Of
        several channels with the least number of states, as `tf`.

    Raises
    ------
    InputError
        More zeros than poles, a complex root without its conjugate, numbers that are not finite.

    Examples
    --------
    Coefficients of a polynomial do not determine a sixfold pole to more than three digits:

    >>> zpk([], [-1] * 6, 1.0).poles()
    array([-1.+0.j, -1.+0.j, -1.+0.j, -1.+0.j, -1.+0.j, -1.+0.j])
    """
    levels = _levels(zeros), _levels(poles)
    if levels == (3, 3):
        rows = [list(row) for row in zeros], [list(row) for row in poles]
        _check_rows("zeros and poles", *rows)
        k = real_array("gain", gain, 2, "zpk")
        if k.shape != (len(rows[0]), len(rows[0][0])):
            raise InputError("zpk: gain", f"of shape {k.shape}", f"({len(rows[0])}, {len(rows[0][0])})")
        entries = {
            (i, j): cascade(z, p, float(k[i, j]), dt, f"zpk: [{i}][{j}]")
            for i, row in enumerate(zip(*rows, strict=True))
            for j, (z, p) in enumerate(zip(*row, strict=True))
        }
        D, parts = np.zeros(k.shape), list[Part]()
        for (i, j), entry in entries.items():
            D[i, j] = entry.D.item()
            parts.append((entry.A, entry.B * np.eye(k.shape[1])[j], entry.C * np.eye(k.shape[0])[:, [i]]))
        return _least(parts, D, {at: [(m.A, m.B, m.C)] for at, m in entries.items()}, dt, inputs, outputs, "zpk")
    if max(levels) > 1:
        found = f"zeros nested {levels[0]} deep, poles {levels[1]} deep"
        raise InputError("zpk", found, "two lists of numbers, or of several channels zeros[i][j] and poles[i][j]")
    k = real_array("gain", np.reshape(gain, (1, 1)) if np.size(gain) == 1 else gain, 2, "zpk")
    if k.shape != (1, 1):
        raise InputError("zpk: gain", f"of shape {k.shape}", "a number, or zeros[i][j] and poles[i][j] with a matrix")
    model = cascade(zeros, poles, k.item(), dt, "zpk")
    return model.renamed(inputs, outputs)


@error_context("ss")
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
    """Make a `StateSpaceModel` from its matrices, or convert a model of another program.

    Parameters
    ----------
    A
        Real matrix (n_x, n_x). Alone: a model of python-control or of scipy.signal (state space, transfer function,
        zeros and poles), any model of this package, or a matrix or number, a static gain.
    B, C, D
        Real matrices (n_x, n_u), (n_y, n_x), (n_y, n_u).
    dt
        Sample time in s; 0 means continuous time. An object has its own.
    inputs, outputs, states
        Names, or (name, unit) pairs.

    Returns
    -------
    StateSpaceModel
        See there.

    Raises
    ------
    InputError
        As `StateSpaceModel`; some of the four matrices without the others; a discrete object of unknown sample time.

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
        hint = "rl.discretise(rl.d2c(G), dt): another sample time"
        raise InputError("ss", f"dt = {dt!r} with a model", "its own", hint)
    given = {"inputs": inputs, "outputs": outputs}
    return model.renamed(**given) if any(given.values()) else model


def _converted(system: Any) -> StateSpaceModel:
    """Convert a model of python-control, scipy or this package."""
    program, kind = type(system).__module__.partition(".")[0], type(system).__mro__
    if program == "scipy" and any(parent.__name__ in ("lti", "dlti") for parent in kind):
        if system.dt is True:
            raise InputError("ss", "dt=True (discrete, sample time unknown)", "a sample time in s")
        if hasattr(system, "gain"):
            return zpk(system.zeros, system.poles, system.gain, float(system.dt or 0.0))
        if np.ndim(getattr(system, "num", [[]])) == 1:
            return tf(system.num, system.den, float(system.dt or 0.0))
        form = system.to_ss()
        return StateSpaceModel(form.A, form.B, form.C, form.D, float(system.dt or 0.0), where="ss")
    return as_model(system, "ss")


def _levels(given: Any) -> int:
    """Return how deep lists are nested; an array counts its dimensions."""
    if isinstance(given, (list, tuple)):
        return 1 + max(map(_levels, given), default=0)
    return np.ndim(given)


def _check_rows(names: str, first: list[list[Any]], second: list[list[Any]]) -> None:
    columns = len(first[0]) if first else 0
    if {len(row) for row in (*first, *second)} != {columns} or len(second) != len(first) or not columns:
        where = "tf" if names.startswith("num") else "zpk"
        raise InputError(where, f"rows of {names} of different lengths", "as many entries in each row as inputs")


def _least(
    parts: list[Part], D: Any, entries: dict[tuple[int, int], list[Part]], dt: float, inputs: Any, outputs: Any,
    where: str,
) -> StateSpaceModel:  # fmt: skip
    """Sum up parts of a transfer matrix in least order; warn of what cancels in one of ``entries``."""
    zero = np.zeros(np.shape(D))
    models = [least_order(StateSpaceModel(*part, zero, dt)).model for part in parts]
    while len(models) > 1:
        pairs = zip(models[::2], models[1::2], strict=False)
        odd = models[-1:] if len(models) % 2 else []
        models = [least_order(parallel(first, second)).model for first, second in pairs] + odd
    found = models[0] if models else StateSpaceModel([], [], [], zero, dt)
    for (i, j), entry in entries.items():
        for mode in (mode for part in entry for mode in hidden_unstable(StateSpaceModel(*part, [[0.0]], dt))):
            near = LOST * sum(float(np.linalg.norm(A)) for A, _, _ in entry)
            if not (np.abs(found.poles() - mode.eigenvalue) <= near).any():
                words = mode.meaning.partition(" in ")[0]
                text = f"{where}: [{i}][{j}]: a zero cancels the {words}: the model is without it"
                warnings.warn(text, stacklevel=4)  # the caller of rl.tf
    return StateSpaceModel(found.A, found.B, found.C, D, dt, inputs, outputs, where=where)


def _warn_of_sensitive_poles(den: Array, dt: float) -> None:
    """Warn if the last digits of the coefficients decide a pole."""
    roots = np.roots(den)
    if len(roots) < 3:
        return
    rng = np.random.default_rng(0)
    rounded = [np.roots(den * (1 + np.finfo(float).eps * rng.choice([-1.0, 1.0], len(den)))) for _ in range(3)]
    moved = np.max([np.abs(roots[:, None] - other).min(axis=1) for other in rounded if len(other)], axis=0)
    size = np.abs(roots)
    distance = np.abs(1 - size) if dt else np.abs(roots.real)
    share = moved / np.where(size > 0, size, np.inf)
    doubtful = (share > SENSITIVE) | ((moved > NEARER * distance) & (distance > ON_IT * size))
    if doubtful.any():
        worst = int(np.argmax(np.where(doubtful, share, -1.0)))
        at = complex(roots[worst])
        text = f"{at.real:.6g}" if not at.imag else f"{at.real:.6g}{at.imag:+.6g}j"
        warnings.warn(
            f"tf: rounding of the coefficients moves the pole {text} by {moved[worst]:.1e}, {share[worst]:.1e} of it;"
            " rl.zpk takes zeros, poles and gain",
            stacklevel=4,  # the caller of rl.tf
        )


def cascade(zeros: Any, poles: Any, gain: float, dt: float, where: str) -> StateSpaceModel:
    """Realise a transfer function by sections of first and second order in series, the last section's states first."""
    (z, real_z), (p, real_p) = (_roots(name, given, where) for name, given in (("zeros", zeros), ("poles", poles)))
    n_zeros, n_poles = 2 * len(z) + len(real_z), 2 * len(p) + len(real_p)
    if n_zeros > n_poles:
        hint = "a derivative needs a pole: zpk([0], [-1000], 1000)"
        raise InputError(where, f"{n_zeros} zeros and {n_poles} poles: improper", "no more zeros than poles", hint)
    sections: list[tuple[list[complex], list[complex]]] = [([pole, pole.conjugate()], []) for pole in p]
    sections += [(real_p[k : k + 2], []) for k in range(0, len(real_p), 2)]
    for group in [*([zero, zero.conjugate()] for zero in z), *([zero] for zero in real_z)]:
        free = [section for section in sections if len(section[0]) - len(section[1]) >= len(group)]
        min(free, key=lambda section: abs(section[0][0] - group[0]))[1].extend(group)
    a, b, c, d = np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), np.ones((1, 1))
    for section in sections:
        (own, into, out, direct), unit = _section(*section)
        a = np.block([[own, into @ c], [np.zeros((len(a), len(own))), a]])
        b, c, d = np.vstack([into @ d, b]), np.hstack([out, direct * c]), direct * d
        gain *= unit
    c, d = gain * c, gain * d
    t = balancing_exponents(a, b, c)
    a, b, c = np.ldexp(a, t - t[:, None]), np.ldexp(b, -t[:, None]), np.ldexp(c, t)
    if not all(np.isfinite(m).all() for m in (a, b, c, d)):
        raise InputError(where, "roots or a gain that overflow", "numbers below 1e308")
    return StateSpaceModel(a, b, c, d, dt, where=where)


def _section(poles: list[complex], zeros: list[complex]) -> tuple[tuple[Array, Array, Array, float], float]:
    """Realise one or two poles with at most as many zeros, gain about one, and return the missing factor."""
    first, last = poles[0].real, poles[-1].real
    size = 2.0 ** round(float(np.log2(max(map(abs, poles)) or 1.0)))
    unit = size ** (len(poles) - len(zeros))
    if len(poles) == 1:
        parts = np.array([[first]]), np.ones((1, 1)), np.array([[first - zeros[0].real if zeros else unit]])
        return (*parts, float(len(zeros))), 1 / unit
    # (sI - A)^-1 B = [link; s - first] / den(s), den(first) = turn^2
    turn = poles[0].imag
    link = turn if turn > 0.1 * size else size
    at_first = np.prod([first - zero for zero in zeros]).real
    out = {
        0: [unit / link, 0.0],
        1: [unit * at_first / link, unit],
        2: [(at_first - turn * turn) / link, first + last - sum(zeros).real],
    }[len(zeros)]
    own = np.array([[first, link], [-turn * (turn / link), last]])
    return (own, np.array([[0.0], [1.0]]), np.array([out]), float(len(zeros) == 2)), 1 / unit


def _roots(name: str, given: Any, where: str) -> tuple[list[complex], list[complex]]:
    """Return the upper root of every conjugate pair, and the real roots in order."""
    try:
        roots: ComplexArray = np.atleast_1d(np.asarray(given, dtype=np.complex128))
    except (TypeError, ValueError):
        raise InputError(f"{where}: {name}", repr(given), "numbers") from None
    if roots.ndim != 1 or not np.isfinite(roots).all():
        raise InputError(f"{where}: {name}", f"{given!r}", "a list of finite numbers")
    real = np.abs(roots.imag) <= PAIRED * np.abs(roots)
    upper, lower = ([root for root in roots[~real].tolist() if sign * root.imag > 0] for sign in (1, -1))
    for root in upper:
        mate = min(lower, key=lambda other: abs(other - root.conjugate()), default=np.inf)
        if not abs(mate - root.conjugate()) <= PAIRED * abs(root):
            raise InputError(f"{where}: {name}", f"{root:.6g} without its conjugate", "conjugate pairs")
        lower.remove(mate)
    if lower:
        raise InputError(f"{where}: {name}", f"{lower[0]:.6g} without its conjugate", "conjugate pairs")
    return upper, [complex(root) for root in np.sort(roots[real].real).tolist()]


def _proper(num: Any, den: Any, where: str) -> tuple[Array, Array]:
    """Return the numerator, as long as the denominator, and the monic denominator."""
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


def _of_columns(entries: list[list[tuple[Array, Array]]]) -> list[Part]:
    """Realise entries [i][j] without direct terms: in each column one controllable form for each denominator."""
    p, m = len(entries), len(entries[0])
    parts = list[Part]()
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
            parts.append((A, B / even, C * even))
    return parts
