r"""Many members of an uncertain model at once: batched matrices, poles, time responses and gains.

.. math:: \begin{bmatrix} A & B \\ C & D \end{bmatrix}_k = M_{22} + M_{21} \Delta_k (I - D_{11} \Delta_k)^{-1} M_{12}

A response is driven by an `Excitation`, a uniform clock and the samples of every input.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robustlab.arrays import Array, Mask
from robustlab.clocks import UNIFORM_TOLERANCE
from robustlab.errors import InputError, NoTrustworthyNumber, did_you_mean
from robustlab.linear_analysis.magnitude import is_moderate, refuse_overflow
from robustlab.statespace import Signal, real_array
from robustlab.uncertainty.blocks import Block, delta_matrix, structure_size
from robustlab.uncertainty.lft import UncertainModel
from robustlab.uncertainty.upper_lft import ILL_POSED

CHUNK = 2_000_000  # numbers of an intermediate array: memory, not the answer
ZOOM_POINTS = 7  # of each round of the zoom on the highest grid point ...
ZOOM_ROUNDS = 8  # ... each of which narrows its bracket by a factor of 4

Hold = Literal["zoh", "foh"]

# A discrete model's clock may differ from its sample time by this share.
SAMPLE_TIME_TOLERANCE = 1e-6


# --- what drives a response -------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Excitation:
    """Times ``t (n_t,)`` in s, their step ``h``, and input samples ``u (n_t, n_u)``."""

    t: Array
    h: float
    u: Array


def excitation(
    inputs: Sequence[Signal], dt: float, t: ArrayLike, u: Mapping[str, ArrayLike] | ArrayLike | None, where: str
) -> Excitation:
    """The clock and the inputs as arrays.

    ``inputs``, ``dt``: inputs and sample time of the models that are driven.
    ``t``: times in s, shape (n_t,), with one step; for a discrete model its ``dt``.
    ``u``: name -> number or samples (n_t,), inputs left out are zero; or an array (n_t,) for a single input, or (n_t,
    n_u); None for a unit step on the only input.
    Raises InputError: a clock that is not uniform, unknown inputs, wrong lengths, several inputs and no ``u``.
    """
    clock = real_array("t", t, 1, where)
    if len(clock) < 2:
        raise InputError(where, f"t has {len(clock)} samples", "at least 2")
    step = np.diff(clock)
    h = float((clock[-1] - clock[0]) / len(step))
    if h <= 0 or np.abs(step - h).max() > UNIFORM_TOLERANCE * h:
        raise InputError(where, "t is not uniform", "increasing times with one step", "use numpy.linspace(0, t_end, n)")
    if dt and abs(h - dt) > SAMPLE_TIME_TOLERANCE * dt:
        raise InputError(where, f"t has a step of {h:.9g} s", f"the discrete model's sample time {dt:.9g} s")
    return Excitation(clock, h, _samples(inputs, len(clock), u, where))


def _samples(inputs: Sequence[Signal], n: int, u: Mapping[str, ArrayLike] | ArrayLike | None, where: str) -> Array:
    names = [s.name for s in inputs]
    if u is None:
        if len(names) != 1:
            hint = f"say which input steps: u={{{names[0]!r}: 1.0}}" if names else None
            raise InputError(where, f"{len(names)} inputs and no u", "one input, or u", hint)
        return np.ones((n, 1))
    if isinstance(u, Mapping):
        samples = np.zeros((n, len(names)))
        for key, value in u.items():
            if key not in names:
                known = ", ".join(names) or "none"
                raise InputError(
                    f"{where}: input {key!r}", "no such input", f"one of {known}", did_you_mean(str(key), names)
                )
            samples[:, names.index(key)] = _column(f"{where}: {key}", value, n)
        return samples
    shape = np.shape(u)
    if len(shape) == 2:
        array = real_array("u", u, 2, where)
        if array.shape != (n, len(names)):
            raise InputError(where, f"u has shape {array.shape}", f"{(n, len(names))}")
        return array
    if len(names) != 1:
        raise InputError(where, f"u has shape {shape}", f"{(n, len(names))}, or a dict of name -> samples")
    return _column(where, u, n)[:, None]


def _column(where: str, value: Any, n: int) -> Array:
    if np.ndim(value) == 0:
        return np.repeat(real_array("u", [value], 1, where), n)
    column = real_array("u", value, 1, where)
    if len(column) != n:
        raise InputError(where, f"u has {len(column)} samples", f"{n} to match t")
    return column


# --- members ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Ensemble:
    """k members of an uncertain model; real, or complex where a Delta is."""

    # A, B, C, D: shapes (k, n_x, n_x), (k, n_x, n_u), (k, n_y, n_x), (k, n_y, n_u)
    A: NDArray[Any]
    B: NDArray[Any]
    C: NDArray[Any]
    D: NDArray[Any]
    dt: float  # sample time in s
    ill_posed: Mask  # shape (k,): where I - D11 Delta is singular. The matrices there are those of the nominal model.
    # Powers of two that balance the nominal model's states, shape (n_x,): the same for every member, so that a
    # member's response does not depend on which others are computed with it.
    scale: Array

    def __len__(self) -> int:
        return len(self.A)

    def part(self, which: slice | NDArray[np.intp]) -> Ensemble:
        """Some of the members."""
        a, b, c, d = (matrix[which] for matrix in (self.A, self.B, self.C, self.D))
        return Ensemble(a, b, c, d, self.dt, self.ill_posed[which], self.scale)

    def spectral_abscissa(self) -> Array:
        """As `StateSpaceModel.spectral_abscissa`, for every member; shape (k,). ``inf`` where ill-posed."""
        if not self.A.shape[1]:
            return np.where(self.ill_posed, np.inf, -np.inf)
        poles = np.linalg.eigvals(self.A)
        value = np.abs(poles).max(axis=1) - 1.0 if self.dt else poles.real.max(axis=1)
        return np.where(self.ill_posed, np.inf, value)

    def is_stable(self) -> Mask:
        """Which members are asymptotically stable and well-posed, (k,); all well-posed ones without states."""
        return ~self.ill_posed & (self.spectral_abscissa() < 0)

    def is_unstable(self, margin: float) -> Mask:
        """Whether a pole lies beyond the stability boundary by more than ``margin`` times the member's largest pole."""
        if not self.A.shape[1]:
            return self.ill_posed
        poles = np.linalg.eigvals(self.A)
        size = np.abs(poles).max(axis=1)
        return self.ill_posed | (size - 1.0 > margin if self.dt else poles.real.max(axis=1) > margin * size)


def chunks(count: int, numbers_each: int) -> Iterator[slice]:
    """Slices of ``range(count)``, each of which needs about ``CHUNK`` numbers."""
    step = max(1, CHUNK // max(1, numbers_each))
    for first in range(0, count, step):
        yield slice(first, min(first + step, count))


def delta_stack(blocks: Sequence[Block], deltas: Sequence[Mapping[str, Any]]) -> NDArray[Any]:
    """One Delta for each mapping of names to values, shape (k, q, p)."""
    if not deltas:
        return np.zeros((0, *structure_size(blocks)))
    return np.stack([delta_matrix(blocks, values) for values in deltas])


def members(uncertain: UncertainModel, delta: NDArray[Any]) -> Ensemble:
    """The members at a stack of Deltas, shape (k, q, p)."""
    left, right, d11, nominal = lft_parts(uncertain)
    k = len(delta)
    ill_posed = np.zeros(k, dtype=bool)
    if d11.any():
        loop = np.eye(len(d11)) - d11 @ delta
        ill_posed = ~(np.linalg.cond(loop) <= ILL_POSED)
        loop[ill_posed] = np.eye(len(d11))
        delta = np.where(ill_posed[:, None, None], 0.0, delta)
        change = left @ delta @ np.linalg.solve(loop, np.broadcast_to(right, (k, *right.shape)))
    else:
        change = left @ delta @ right
    m = uncertain.M
    return split(nominal + change, m.n_states, m.dt, ill_posed, state_scale(m.A))


def lft_parts(uncertain: UncertainModel) -> tuple[Array, Array, Array, Array]:
    """left, right, D11 and nominal, with ``[A B; C D] = nominal + left Delta (I - D11 Delta)^-1 right``."""
    m, (q, p) = uncertain.M, uncertain.delta_shape
    left, right = np.vstack([m.B[:, :q], m.D[p:, :q]]), np.hstack([m.C[:p], m.D[:p, q:]])
    return left, right, m.D[:p, :q], np.block([[m.A, m.B[:, q:]], [m.C[p:], m.D[p:, q:]]])


def split(whole: NDArray[Any], n: int, dt: float, ill_posed: Mask, scale: Array) -> Ensemble:
    """The members whose matrices ``[A B; C D]`` are given, shape (k, n_x + n_y, n_x + n_u)."""
    return Ensemble(whole[:, :n, :n], whole[:, :n, n:], whole[:, n:, :n], whole[:, n:, n:], dt, ill_posed, scale)


def blocks_of(count: int, size: int) -> list[slice]:
    """The blocks of ``range(count)``."""
    return [slice(first, min(first + size, count)) for first in range(0, count, size)]


def state_scale(a: Array) -> Array:
    """Powers of two that balance A (n_x, n_x), shape (n_x,)."""
    from scipy.linalg import matrix_balance

    if not len(a):
        return np.ones(0)
    return np.asarray(matrix_balance(a, permute=False, separate=True)[1][0], dtype=float)


# --- time ------------------------------------------------------------------------------------------------------------


def time_responses(ensemble: Ensemble, drive: Excitation, x0: Array, hold: Hold = "zoh") -> Array:
    r"""Outputs of all (real) members for one input on a uniform clock, shape (k, n_t, n_y).

    .. math:: x_{j+1} = \Phi x_j + \Gamma u_j + \Gamma_1 (u_{j+1} - u_j)

    exact for an input that is piecewise constant (``hold = "zoh"``, without the last term) or linear (``"foh"``).
    A member that outgrows double precision gives infinite or NaN samples.

    ``x0``: initial state, shape (n_x,).
    """
    h, u = drive.h, drive.u
    k, n_t = len(ensemble), len(u)
    y = np.empty((k, n_t, ensemble.C.shape[1]))
    used = np.flatnonzero(u.any(axis=0))
    with np.errstate(over="ignore", invalid="ignore"):
        for part in chunks(k, max(1, len(x0)) * n_t):
            phi, gamma, slope = transitions(ensemble.part(part), h, hold, used)
            forced = u[:-1, used] @ gamma.transpose(0, 2, 1)
            if hold == "foh":
                forced += np.diff(u[:, used], axis=0) @ slope.transpose(0, 2, 1)
            x = _recursion(phi, forced, x0)
            y[part] = x @ ensemble.C[part].transpose(0, 2, 1) + u @ ensemble.D[part].transpose(0, 2, 1)
    return y


def _recursion(phi: Array, forced: Array, x0: Array) -> Array:
    """``x[j+1] = phi x[j] + forced[j]`` for every member, shape (k, n_t, n_x).

    A scan by doubling: after the pass with stride s every x[j] holds the last 2 s terms of its sum. That is log2(n_t)
    passes over all times instead of n_t steps.
    """
    k, steps, n = forced.shape
    x = np.concatenate([np.broadcast_to(x0, (k, 1, n)), forced], axis=1)
    power, stride = phi, 1
    while stride <= steps:
        x[:, stride:] += x[:, :-stride] @ power.transpose(0, 2, 1)
        power, stride = power @ power, 2 * stride
    return x


def transitions(
    ensemble: Ensemble, h: float, hold: Hold, used: NDArray[np.intp] | slice = slice(None)
) -> tuple[Array, Array, Array]:
    r"""Matrices of ``x_{j+1} = \Phi x_j + \Gamma u_j + \Gamma_1 (u_{j+1} - u_j)`` for every member.

    Shapes (k, n_x, n_x), (k, n_x, n_u) and (k, n_x, n_u); the last is zero for ``hold = "zoh"``.

    ``used``: the inputs that are wanted; n_u counts them only.
    """
    from scipy.linalg import expm

    a, b = ensemble.A, ensemble.B[:, :, used]
    k, n, m = b.shape
    if ensemble.dt or n == 0:
        return a, b, np.zeros((k, n, m))
    # Van Loan's block matrix; powers of two take bad scaling out before the exponential's squarings amplify rounding.
    scale = ensemble.scale
    size = np.abs(b / scale[:, None]).max(axis=1, keepdims=True, initial=0.0)
    column = np.exp2(np.rint(np.log2(np.maximum(size, 1e-300))))
    orders = 2 if hold == "foh" else 1
    block = np.zeros((k, n + orders * m, n + orders * m))
    block[:, :n, :n] = a / scale[:, None] * scale * h
    block[:, :n, n : n + m] = b / scale[:, None] / column * h
    if orders == 2:
        block[:, n : n + m, n + m :] = np.eye(m)
    e = expm(block)[:, :n]
    phi = scale[:, None] * e[:, :, :n] / scale
    gamma = scale[:, None] * e[:, :, n : n + m] * column
    slope = scale[:, None] * e[:, :, n + m :] * column if orders == 2 else np.zeros((k, n, m))
    return phi, gamma, slope


# --- frequency -------------------------------------------------------------------------------------------------------


def peak_gains(ensemble: Ensemble, grid: Array) -> tuple[Array, Array]:
    """Largest singular value over frequency and where it was found, both of shape (k,); ``inf`` where unstable.

    A grid search with each member's own resonances in the grid and a zoom on its highest point: quick, and never above
    the H-infinity norm, which `robustlab.norms.hinf_norm` brackets.

    ``grid``: frequencies in rad/s, shape (n_omega,); mirrored for complex members, whose gain is not even in frequency.
    """
    k, n, n_u = ensemble.B.shape
    if n == 0:
        return np.where(ensemble.ill_posed, np.inf, _largest_singular_value(ensemble.D)), np.zeros(k)
    value, where = np.full(k, np.inf), np.full(k, np.nan)
    stable = np.flatnonzero(ensemble.spectral_abscissa() < 0)
    top = np.pi / ensemble.dt if ensemble.dt else np.inf
    poles = np.linalg.eigvals(ensemble.A).astype(complex)
    if ensemble.dt:
        poles = np.log(np.where(np.abs(poles) > 1e-12, poles, 1e-12)) / ensemble.dt
    both_sides = np.iscomplexobj(ensemble.A)
    base = np.concatenate([[0.0], grid, -grid]) if both_sides else np.append(0.0, grid)
    for piece in chunks(len(stable), (len(base) + 2 * n) * n * max(n, n_u)):
        index = stable[piece]
        own = np.hstack([np.imag(poles[index]), np.abs(poles[index])])
        omega = np.hstack([np.broadcast_to(base, (len(index), len(base))), own if both_sides else np.abs(own)])
        omega = np.sort(np.clip(omega, -top, top), axis=1)
        gain = _gains(ensemble, index, omega)
        for _ in range(ZOOM_ROUNDS):
            best = gain.argmax(axis=1)
            rows = np.arange(len(index))
            low = omega[rows, np.maximum(best - 1, 0)]
            high = omega[rows, np.minimum(best + 1, omega.shape[1] - 1)]
            finer = np.linspace(low, high, ZOOM_POINTS + 2, axis=1)
            omega = np.sort(np.hstack([finer, omega[rows, best][:, None]]), axis=1)
            gain = _gains(ensemble, index, omega)
        best = gain.argmax(axis=1)
        value[index], where[index] = gain[np.arange(len(index)), best], omega[np.arange(len(index)), best]
    direct = np.zeros(k) if ensemble.dt else _largest_singular_value(ensemble.D)
    at_infinity = direct > value
    return np.where(at_infinity, direct, value), np.where(at_infinity, np.inf, where)


def _gains(ensemble: Ensemble, index: NDArray[np.intp], omega: Array) -> Array:
    """Largest singular values of the members ``index`` at their own frequencies ``omega (k, n_omega)``."""
    a, b, c, d = (getattr(ensemble, name)[index][:, None] for name in "ABCD")
    point = np.exp(1j * omega * ensemble.dt) if ensemble.dt else 1j * omega
    n = a.shape[-1]
    lhs = point[..., None, None] * np.eye(n) - a
    try:
        x = np.linalg.solve(lhs, np.broadcast_to(b.astype(complex), (*omega.shape, *b.shape[2:])))
    except np.linalg.LinAlgError:
        found = "a member has a pole so close to the stability boundary that its gain overflows"
        raise NoTrustworthyNumber("worst_case", found) from None
    with np.errstate(over="ignore", invalid="ignore"):
        response = c @ x + d
    refuse_overflow("worst_case", response)
    return _largest_singular_value(response)


def _largest_singular_value(g: NDArray[Any]) -> Array:
    if 0 in g.shape[-2:]:
        return np.zeros(g.shape[:-2])
    if 1 in g.shape[-2:]:
        size = np.abs(g)
        if is_moderate(size):
            return np.sqrt((size**2).sum(axis=(-2, -1)))
        top = np.maximum(size.max(axis=(-2, -1), keepdims=True), np.finfo(float).tiny)
        return np.sqrt(((size / top) ** 2).sum(axis=(-2, -1))) * top[..., 0, 0]
    return np.linalg.norm(g, 2, axis=(-2, -1))
