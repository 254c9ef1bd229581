"""Many members of an uncertain model at once: random Deltas and vertices, matrices, poles, responses and gains."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robustlab.arrays import Array, Mask
from robustlab.dynamics.simulation import sampled_inputs
from robustlab.errors import InputError, NoTrustworthyNumber
from robustlab.linear_analysis.matrices import refuse_overflow
from robustlab.statespace import Signal, real_array
from robustlab.time_base import is_uniform
from robustlab.uncertainty.blocks import Block, block_slices, structure_size
from robustlab.uncertainty.lft import ILL_POSED, UncertainModel

CHUNK = 2_000_000  # numbers of an intermediate array: memory, not the answer
ZOOM_POINTS = 7  # of each round of the zoom on the highest grid point ...
ZOOM_ROUNDS = 8  # ... each of which narrows its bracket by a factor of 4

# "all" vertices are listed up to this number of real deltas; so are the lists from which subsets are drawn.
MAX_LISTED = 16
# Members are computed in blocks that begin at its multiples: a sample's value must not depend on the number of samples.
BLOCK = 512
BLOCK_NUMBERS = 2_000_000  # limit that gives large models smaller blocks

Hold = Literal["zoh", "foh"]

# Largest relative difference of the step of t from a discrete model's sample time.
SAMPLE_TIME_TOLERANCE = 1e-6


class Excitation(NamedTuple):
    """Times ``t (n_t,)`` in s, their step ``h``, and input samples ``u (n_t, n_u)``."""

    t: Array
    h: float
    u: Array


def excitation(
    inputs: Sequence[Signal], dt: float, t: ArrayLike, u: Mapping[str, ArrayLike] | ArrayLike | None, where: str
) -> Excitation:
    """Return the time base (uniform, of the models' ``dt``) and the inputs as arrays.

    ``u``: name -> number or samples (n_t,), other inputs are zero; or an array (n_t,), or (n_t, n_u);
    None for a unit step on the only input.
    """
    clock, names = real_array("t", t, 1, where), [s.name for s in inputs]
    n = len(clock)
    if n < 2 or clock[-1] <= clock[0] or not is_uniform(clock):
        hint = "use numpy.linspace(0, t_end, n)"
        raise InputError(where, "t is not uniform", "at least 2 increasing times with one step", hint)
    h = float((clock[-1] - clock[0]) / (n - 1))
    if dt and abs(h - dt) > SAMPLE_TIME_TOLERANCE * dt:
        raise InputError(where, f"t has a step of {h:.9g} s", f"the discrete model's sample time {dt:.9g} s")
    if u is None:
        if len(names) != 1:
            hint = f"say which input steps: u={{{names[0]!r}: 1.0}}" if names else None
            raise InputError(where, f"{len(names)} inputs and no u", "one input, or u", hint)
        u = np.ones(n)
    elif isinstance(u, Mapping):
        held = {name: np.repeat(value, n) if np.ndim(value) == 0 else value for name, value in u.items()}
        u = {**dict.fromkeys(names, np.zeros(n)), **held}
    elif np.ndim(u) == 0:
        u = np.repeat(np.asarray(u), n)
    return Excitation(clock, h, sampled_inputs(tuple(inputs), u, n))


# --- Deltas -----------------------------------------------------------------------------------------------------------


class Deltas(Sequence[Mapping[str, Any]]):
    """The Deltas of n random samples, then of vertices with ``signs (n_v, k)`` of k reals, computed on access."""

    def __init__(self, blocks: Sequence[Block], n: int, seed: int, signs: Array | None = None) -> None:
        self.blocks, self.n, self.seed = tuple(blocks), n, seed
        self._reals = tuple(b.name for b in blocks if b.interval)
        self.signs: Array = np.zeros((0, len(self._reals))) if signs is None else signs

    def __len__(self) -> int:
        return self.n + len(self.signs)

    def __getitem__(self, index: Any) -> Any:
        if isinstance(index, slice):
            return tuple(self[i] for i in range(*index.indices(len(self))))
        if not -len(self) <= index < len(self):
            raise IndexError(f"sample {index} of {len(self)}")
        index %= len(self)
        if index < self.n:
            return delta_of_sample(self.blocks, self.seed, index)
        row = self.signs[index - self.n]
        values = delta_of_sample(self.blocks, self.seed, index - self.n, boundary=True)
        return {**values, **{name: float(s) for name, s in zip(self._reals, row, strict=True)}}

    def numbers(self, part: slice) -> Array:
        """Return the coordinates of some samples, shape (k, d)."""
        return np.array([encoded(self.blocks, values) for values in self[part]])

    def to_json(self) -> list[Mapping[str, Any]]:
        return list(self)


def encoded(blocks: Sequence[Block], values: Mapping[str, Any]) -> Array:
    """Return the coordinates (d,) of a Delta: one for a real scalar, else real and imaginary parts of all entries."""
    return np.concatenate([np.zeros(0), *(block.coordinates(values[block.name]) for block in blocks)], dtype=np.float64)


def decoded(blocks: Sequence[Block], numbers: Array) -> dict[str, Any]:
    """Inverse of `encoded`."""
    ends = np.cumsum([0, *(b.n_coordinates for b in blocks)])
    return {b.name: b.value_at(numbers[i:j]) for b, (i, j) in zip(blocks, pairwise(ends), strict=True)}


def delta_of_sample(blocks: Sequence[Block], seed: int, index: int, *, boundary: bool = False) -> dict[str, Any]:
    """Return the Delta of a sample; with ``boundary`` complex and full blocks are on theirs, as at vertices."""
    key = (index, 1) if boundary else (index,)
    rng = np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed, spawn_key=key)))
    return {block.name: block.draw(rng, boundary) for block in blocks}


def vertex_signs(k: int, count: int | Literal["all"], seed: int) -> Array:
    """Return vertices of the box [-1, 1]^k, shape (n, k): all where ``count`` allows it, else a seeded selection."""
    if count == "all" and k > MAX_LISTED:
        hint = "ask for a number of vertices"
        raise InputError("sample", f"all vertices of {k} real deltas (2^{k})", f"at most 2^{MAX_LISTED}", hint)
    number = 2**k if count == "all" else count
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(0, 2)))
    if k > MAX_LISTED:  # equal draws are rare among so many vertices; duplicates are dropped
        drawn = rng.integers(0, 2, (number, k))
        bits = drawn[np.sort(np.unique(drawn, axis=0, return_index=True)[1])]
    else:
        order = np.arange(2**k) if number >= 2**k else rng.permutation(2**k)[:number]
        bits = (order[:, None] >> np.arange(k)[::-1]) & 1
    return 2.0 * bits - 1.0


# --- members ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Ensemble:
    """k members of an uncertain model; real, or complex where a Delta is."""

    A: NDArray[Any]  # (k, n_x, n_x)
    B: NDArray[Any]  # (k, n_x, n_u)
    C: NDArray[Any]  # (k, n_y, n_x)
    D: NDArray[Any]  # (k, n_y, n_u)
    dt: float  # sample time in s
    ill_posed: Mask  # (k,): where I - D11 Delta is singular. The matrices there are those of the nominal model.
    # Powers of two that balance the nominal model's states, (n_x,): a member's response must not depend on which others
    # are computed with it.
    scale: Array

    def __len__(self) -> int:
        return len(self.A)

    def part(self, which: slice | NDArray[np.intp]) -> Ensemble:
        a, b, c, d = (matrix[which] for matrix in (self.A, self.B, self.C, self.D))
        return Ensemble(a, b, c, d, self.dt, self.ill_posed[which], self.scale)

    def spectral_abscissa(self) -> Array:
        """Return `StateSpaceModel.spectral_abscissa` of every member, (k,); ``inf`` where ill-posed."""
        poles = np.linalg.eigvals(self.A)
        value = np.abs(poles) - 1.0 if self.dt else poles.real
        return np.where(self.ill_posed, np.inf, value.max(axis=1, initial=-np.inf))

    def is_stable(self) -> Mask:
        """Return which members are asymptotically stable and well-posed, (k,); all well-posed ones without states."""
        return ~self.ill_posed & (self.spectral_abscissa() < 0)

    def is_unstable(self, margin: float) -> Mask:
        """Return whether a pole is unstable by more than ``margin`` times the member's largest pole."""
        poles = np.linalg.eigvals(self.A)
        size = np.abs(poles).max(axis=1, initial=0.0)
        return self.ill_posed | (size - 1.0 > margin if self.dt else (poles.real > margin * size[:, None]).any(axis=1))


def blocks_of(count: int, size: int) -> list[slice]:
    return [slice(first, min(first + size, count)) for first in range(0, count, size)]


def chunks(count: int, numbers_each: int) -> list[slice]:
    """Split ``range(count)`` into slices, each of which needs about ``CHUNK`` numbers."""
    return blocks_of(count, max(1, CHUNK // max(1, numbers_each)))


class MemberSet:
    """A set prepared for the evaluation of many members; `block` is the number for one call."""

    def __init__(self, uncertain: UncertainModel) -> None:
        from scipy.linalg import matrix_balance

        m, (q, p), self.blocks = uncertain.M, uncertain.delta_shape, uncertain.blocks
        self.n_states, self.dt = m.n_states, m.dt
        self._left, self._right = np.vstack([m.B[:, :q], m.D[p:, :q]]), np.hstack([m.C[:p], m.D[:p, q:]])
        self._d11, self._nominal = m.D[:p, :q], np.block([[m.A, m.B[:, q:]], [m.C[p:], m.D[p:, q:]]])
        ends = np.cumsum([0, *(b.n_coordinates for b in self.blocks)])
        self.parts = [slice(a, b) for a, b in pairwise(ends)]
        self.size, self.all_real = int(ends[-1]), all(b.interval for b in self.blocks)
        self._scale = np.ones(0)
        if self.n_states:
            self._scale = np.asarray(matrix_balance(m.A, permute=False, separate=True)[1][0], dtype=float)
        self.block = max(1, min(BLOCK, BLOCK_NUMBERS // max(1, self._nominal.size)))

    def deltas(self, theta: Array) -> NDArray[Any]:
        """Return Deltas (k, q, p) at coordinates (k, d); blocks outside their ball are projected onto it."""
        kind = float if all(b.is_real for b in self.blocks) else complex
        delta = np.zeros((len(theta), *structure_size(self.blocks)), kind)
        for block, part, (rows, cols) in zip(self.blocks, self.parts, block_slices(self.blocks), strict=True):
            delta[:, rows, cols] = block.members(theta[:, part])
        return delta

    def members(self, theta: Array) -> Ensemble:
        """Return the members at coordinates (k, d)."""
        k = len(theta)
        ill_posed = np.zeros(k, dtype=bool)
        delta, right = self.deltas(theta), self._right[None]
        if self._d11.any():
            loop = np.eye(len(self._d11)) - self._d11 @ delta
            ill_posed = ~(np.linalg.cond(loop) <= ILL_POSED)
            loop[ill_posed] = np.eye(len(self._d11))
            delta = np.where(ill_posed[:, None, None], 0.0, delta)
            right = np.linalg.solve(loop, np.broadcast_to(self._right, (k, *self._right.shape)))
        whole, n = self._nominal + self._left @ delta @ right, self.n_states
        blocks = whole[:, :n, :n], whole[:, :n, n:], whole[:, n:, :n], whole[:, n:, n:]
        return Ensemble(*blocks, self.dt, ill_posed, self._scale)


# --- time ------------------------------------------------------------------------------------------------------------


def time_responses(ensemble: Ensemble, drive: Excitation, x0: Array, hold: Hold = "zoh") -> Array:
    """Return the exact outputs (k, n_t, n_y) of all real members from x0; infinite or NaN where a member overflows."""
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
            x = recursion(phi, forced, x0)
            y[part] = x @ ensemble.C[part].transpose(0, 2, 1) + u @ ensemble.D[part].transpose(0, 2, 1)
    return y


def recursion(phi: Array, forced: Array, x0: Array) -> Array:
    """Compute ``x[j+1] = phi x[j] + forced[j]`` of every member, shape (k, n_t, n_x), by doubling."""
    k, steps, n = forced.shape
    x = np.concatenate([np.broadcast_to(x0, (k, 1, n)), forced], axis=1)
    power, stride = phi, 1
    with np.errstate(over="ignore", invalid="ignore"):
        while stride <= steps:
            x[:, stride:] += x[:, :-stride] @ power.transpose(0, 2, 1)
            power, stride = power @ power, 2 * stride
    return x


def transitions(ensemble: Ensemble, h: float, hold: Hold, used: NDArray[np.intp]) -> tuple[Array, Array, Array]:
    """Return Phi, Gamma, Gamma_1: x_{j+1} = Phi x_j + Gamma u_j + Gamma_1 (u_{j+1} - u_j), of ``used`` inputs."""
    from scipy.linalg import expm

    a, b = ensemble.A, ensemble.B[:, :, used]
    k, n, m = b.shape
    if ensemble.dt or n == 0:
        return a, b, np.zeros((k, n, m))
    # Van Loan's block matrix, scaled by powers of two before the exponential's squarings amplify rounding.
    scale = ensemble.scale
    size = np.abs(b / scale[:, None]).max(axis=1, keepdims=True, initial=0.0)
    column = np.exp2(np.rint(np.log2(np.maximum(size, 1e-300))))
    orders = 2 if hold == "foh" else 1
    block = np.zeros((k, n + orders * m, n + orders * m))
    block[:, :n, :n] = a / scale[:, None] * scale * h
    block[:, :n, n : n + m] = b / scale[:, None] / column * h
    block[:, n : n + m, n + m :] = np.eye(m)[:, : (orders - 1) * m]
    e = expm(block)[:, :n]
    phi = scale[:, None] * e[:, :, :n] / scale
    gamma = scale[:, None] * e[:, :, n : n + m] * column
    slope = scale[:, None] * e[:, :, n + m :] * column if orders == 2 else np.zeros((k, n, m))
    return phi, gamma, slope


# --- frequency -------------------------------------------------------------------------------------------------------


def peak_gains(ensemble: Ensemble, grid: Array) -> tuple[Array, Array]:
    """Return the largest singular value over frequency and its frequency, both (k,); ``inf`` where unstable.

    A grid with each member's own resonances, refined around its highest point: never above the H-infinity norm.
    Negative frequencies are included for complex members, whose gain is not even in frequency.
    """
    k, n, n_u = ensemble.B.shape
    if n == 0:
        return np.where(ensemble.ill_posed, np.inf, _largest_singular_value(ensemble.D)), np.zeros(k)
    value, where = np.full(k, np.inf), np.full(k, np.nan)
    stable, top = np.flatnonzero(ensemble.spectral_abscissa() < 0), np.inf
    poles: Any = np.linalg.eigvals(ensemble.A).astype(complex)
    if ensemble.dt:
        poles, top = np.log(np.where(np.abs(poles) > 1e-12, poles, 1e-12)) / ensemble.dt, np.pi / ensemble.dt
    both_sides = np.iscomplexobj(ensemble.A)
    base = np.concatenate([[0.0], grid, -grid]) if both_sides else np.append(0.0, grid)
    for piece in chunks(len(stable), (len(base) + 2 * n) * n * max(n, n_u)):
        index = stable[piece]
        own = np.hstack([np.imag(poles[index]), np.abs(poles[index])])
        omega = np.hstack([np.broadcast_to(base, (len(index), len(base))), own if both_sides else np.abs(own)])
        omega = np.sort(np.clip(omega, -top, top), axis=1)
        gain, rows = _gains(ensemble, index, omega), np.arange(len(index))
        for _ in range(ZOOM_ROUNDS):
            best = gain.argmax(axis=1)
            low = omega[rows, np.maximum(best - 1, 0)]
            high = omega[rows, np.minimum(best + 1, omega.shape[1] - 1)]
            finer = np.linspace(low, high, ZOOM_POINTS + 2, axis=1)
            omega = np.sort(np.hstack([finer, omega[rows, best][:, None]]), axis=1)
            gain = _gains(ensemble, index, omega)
        best = gain.argmax(axis=1)
        value[index], where[index] = gain[rows, best], omega[rows, best]
    direct = np.zeros(k) if ensemble.dt else _largest_singular_value(ensemble.D)
    at_infinity = direct > value
    return np.where(at_infinity, direct, value), np.where(at_infinity, np.inf, where)


def _gains(ensemble: Ensemble, index: NDArray[np.intp], omega: Array) -> Array:
    """Return the gains of the members ``index`` at their own frequencies ``omega (k, n_omega)``."""
    a, b, c, d = (getattr(ensemble, name)[index][:, None] for name in "ABCD")
    point = np.exp(1j * omega * ensemble.dt) if ensemble.dt else 1j * omega
    n = a.shape[-1]
    right = np.broadcast_to(b.astype(complex), (*omega.shape, *b.shape[2:]))
    try:
        x = np.linalg.solve(point[..., None, None] * np.eye(n) - a, right)
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
        top = np.exp2(min(float(np.frexp(size.max(initial=0.0))[1]), 1023.0))  # a power of two: exact
        return top * np.sqrt(((size / top) ** 2).sum(axis=(-2, -1)))
    return np.linalg.norm(g, 2, axis=(-2, -1))
