r"""What a continuous plant does over an interval in which its control is held, for polynomial and for any other inputs.

On an interval of length h every input w is a polynomial of degree below m, its projection on Legendre polynomials
:math:`\varphi_0 .. \varphi_{m-1}` (orthonormal on [0, h]), plus a rest orthogonal to them; so is every output z. With x
the state at the start, a the coefficients of w, c constant inputs and v = (x, a, c):

.. math:: x(h) = F v + \int_0^h e^{A (h - r)} B w_0(r)\, dr, \qquad
   \langle \varphi_k, z \rangle = M_k v + \int_0^h \kappa_k(r) w_0(r)\, dr, \qquad
   \| z_0 \| \le \| R v \| + g \| w_0 \|

F, M, R and the Gramians of the kernels are exact up to quadrature, which is checked; g is a Hilbert-Schmidt norm.

References
----------
Chen, Francis, *Optimal Sampled-Data Control Systems* (1995), chapter 10 (lifting); Dullerud, *Control of Uncertain
Sampled-Data Systems* (1996), chapter 3.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robustlab.arrays import AnyArray
from robustlab.errors import NoTrustworthyNumber
from robustlab.statespace import StateSpaceModel
from robustlab.synthesis.reduction.balancing import triangular_root
from robustlab.synthesis.sampled.lifting import mean_and_variance
from robustlab.synthesis.sampled.tuning import TUNING

# Relative difference of energies by quadrature and by doubling that is still rounding.
AGREE = 1e-8
# Directions this far below the largest are rounding.
NEGLIGIBLE = 1e-13
# What is left of a difference of squares by rounding, relative to the first of them.
CANCELLED = 1e-14
WHERE, SLOWER = "sampled uncertain plant", "a shorter sample time, or leave out the fastest modes of the plant"


@dataclass(frozen=True, eq=False)
class ChannelGroup:
    """Inputs and outputs that belong together: those of one perturbation block, or disturbances and performance."""

    # w, z: their positions among the plant's inputs and outputs
    w: NDArray[np.intp]
    z: NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class HeldInterval:
    """One interval; v = (x, coefficients of all free inputs degree by degree, constant inputs)."""

    length: float  # h in s
    move: AnyArray  # state at the end, (n, n_v)
    means: AnyArray  # coefficients of all outputs, degree by degree, (m n_z, n_v)
    # For each group R with `|z_0| <= |R v|` for what its outputs have beyond the polynomials.
    rests: tuple[AnyArray, ...]
    # For each group K, (n + m n_z, any): what the rest of its inputs does to state and coefficients is `K q` with
    # `|q| <= |w_0|`.
    kicks: tuple[AnyArray, ...]
    # `gains[i, j]` bounds the gain from the rest of group j's inputs to the rest of group i's outputs within the
    # interval, direct terms left out.
    gains: AnyArray


def held_interval(
    model: StateSpaceModel,
    groups: Sequence[ChannelGroup],
    constant: NDArray[np.intp],
    n_z: int,
    length: float,
    degree: int,
) -> HeldInterval:
    """The interval of a continuous model.

    ``model``: continuous model with n states; its first ``n_z`` outputs are looked at.
    ``groups``: groups that hold every free input and every of those outputs once.
    ``constant``: positions of the inputs that are constant over the interval.
    ``length``: h in s.
    ``degree``: m, number of polynomials.
    Raises NoTrustworthyNumber: ``e^(A t)`` overflows within the interval, modes too fast for it, or energies that do
    not agree.
    """
    free = np.concatenate([g.w for g in groups])
    nodes = _Nodes.of(model.poles(), length)
    s, weights = nodes.sigma * length, nodes.weights * length
    phi = _legendre(nodes.sigma, degree) / np.sqrt(length)  # (m, n_nodes)
    forward = _Forward(model, free, constant, n_z, length, degree)
    z, state_part, pulse, move = forward.at(nodes)
    means = np.tensordot(phi * weights, z, 1)
    rest = np.sqrt(weights)[:, None, None] * (z - np.tensordot(phi.T, means, 1))
    forward.check(z, weights, length)
    y, kernel_x = _backward(model, n_z, length, degree, nodes)
    signs = (-1.0) ** np.arange(degree)
    kicks, kernels = [], []
    for group in groups:
        b = model.B[:, group.w]
        # Kernels at the time r = h - s: of the state at the end, (g, n, r), and of the coefficients, (g, m, n_z, r).
        to_state = kernel_x @ b
        to_means = signs[None, :, None, None] * (y.transpose(0, 1, 3, 2) @ b)
        kernels.append(to_means)
        stack = np.concatenate([to_state, to_means.reshape(len(s), degree * n_z, len(group.w))], axis=1)
        stack = stack - np.tensordot(phi.T, np.tensordot(phi * weights, stack, 1), 1)
        rows = np.sqrt(weights)[:, None, None] * stack
        kicks.append(thin_rows(rows.transpose(0, 2, 1).reshape(len(s) * len(group.w), stack.shape[1])).T)
    rests = tuple(thin_rows(rest[:, g.z].reshape(len(s) * len(g.z), rest.shape[2])) for g in groups)
    gains = _gains(groups, free, phi, weights, s, length, pulse, kernels, state_part)
    return HeldInterval(length, move, means.reshape(degree * n_z, means.shape[2]), rests, tuple(kicks), gains)


class _Forward:
    """The plant with its inputs' polynomials as further states: ``v' = N v`` in the time sigma = s / h."""

    def __init__(
        self, m: StateSpaceModel, free: AnyArray, constant: AnyArray, n_z: int, length: float, degree: int
    ) -> None:
        n, k = m.n_states, len(free)
        self.n, self.k, self.degree = n, k, degree
        width = n + degree * k + len(constant)
        N, start, out = np.zeros((width, width)), np.eye(width), np.zeros((n_z, width))
        inner = slice(0, n + degree * k)
        N[inner, inner], start[n : inner.stop, n : inner.stop] = _driven(m.A, m.B[:, free], length, degree)
        N[:n, inner.stop :] = m.B[:, constant] * length
        out[:, :n], out[:, n : n + k] = m.C[:n_z], m.D[:n_z][:, free]
        out[:, width - len(constant) :] = m.D[:n_z][:, constant]
        self.N, self.out, self.start, self.B = N, out, start, m.B[:, free]
        self.state_out = np.zeros_like(out)
        self.state_out[:, :n] = m.C[:n_z]

    def at(self, nodes: _Nodes) -> tuple[AnyArray, AnyArray, AnyArray, AnyArray]:
        """At the nodes z, its part by way of the state, and the pulse response; the state at the end."""
        flow, end = nodes.flow(self.N)
        flow = flow @ self.start
        z, through = self.out @ flow, self.state_out @ flow
        state_part = through[:, :, self.n : self.n + self.degree * self.k]
        return z, state_part, through[:, :, : self.n] @ self.B, (end @ self.start)[: self.n]

    def check(self, z: AnyArray, weights: AnyArray, length: float) -> None:
        """Energies by quadrature against those by doubling."""
        _, mean, variance = mean_and_variance(self.N / length, self.out, length)
        exact = self.start.T @ (mean.T @ mean + variance) @ self.start
        rows = (np.sqrt(weights)[:, None, None] * z).reshape(-1, z.shape[2])
        found = rows.T @ rows
        size = np.sqrt(np.maximum(np.diag(exact), 0.0))
        off = np.abs(found - exact) > AGREE * (np.outer(size, size) + 1e-300)
        if not np.isfinite(found).all() or off.any():
            found = f"energies over {length:g} s do not agree: modes too fast for it"
            raise NoTrustworthyNumber(WHERE, found, hint=SLOWER)


def _driven(A: AnyArray, B: AnyArray, length: float, degree: int) -> tuple[AnyArray, AnyArray]:
    """Generator, in the time sigma, of ``x' = A x + B w`` with w and its derivatives as further states, and what these
    are at the start for each coefficient of w.
    """
    n, k = B.shape
    N = np.zeros((n + degree * k,) * 2)
    N[:n, :n], N[:n, n : n + k] = A * length, B * length
    N[n : len(N) - k, n + k :] = np.eye((degree - 1) * k)
    return N, np.kron(_derivatives(degree) / np.sqrt(length), np.eye(k))


def _backward(m: StateSpaceModel, n_z: int, length: float, degree: int, nodes: _Nodes) -> tuple[AnyArray, AnyArray]:
    r"""At the nodes :math:`\int_0^s \varphi_k(t)\, e^{A^T (s-t)} C^T dt` (g, m, n, n_z), and ``e^(A s)`` (g, n, n)."""
    n = m.n_states
    N, start = _driven(m.A.T, m.C[:n_z].T, length, degree)
    flow, _ = nodes.flow(N)
    driven = flow[:, :n, n:] @ start
    return driven.reshape(len(flow), n, degree, n_z).transpose(0, 2, 1, 3), flow[:, :n, :n].transpose(0, 2, 1)


def _gains(
    groups: Sequence[ChannelGroup],
    free: AnyArray,
    phi: AnyArray,
    weights: AnyArray,
    s: AnyArray,
    length: float,
    pulse: AnyArray,
    kernels: Sequence[AnyArray],
    state_part: AnyArray,
) -> AnyArray:
    r"""Hilbert-Schmidt norms of ``(I - Q) K (I - Q)``, K the causal map from inputs to outputs by way of the state.

    .. math:: \|(I-Q) K (I-Q)\|^2 = \|K\|^2 - \|Q K\|^2 - \|K Q\|^2 + \|Q K Q\|^2
    """
    k = len(phi)
    columns = [np.array([np.flatnonzero(free == i)[0] for i in g.w], dtype=int) for g in groups]
    found = np.zeros((len(groups), len(groups)))
    for j, column in enumerate(columns):
        pieces = np.concatenate([column + d * len(free) for d in range(k)])
        for i, other in enumerate(groups):
            whole = float(weights * (length - s) @ (pulse[:, other.z][:, :, column] ** 2).sum(axis=(1, 2)))
            means = float(weights @ (kernels[j][:, :, other.z] ** 2).sum(axis=(1, 2, 3)))
            smooth = state_part[:, other.z][:, :, pieces]
            by_means = float(weights @ (smooth**2).sum(axis=(1, 2)))
            both = float((np.tensordot(phi * weights, smooth, 1) ** 2).sum())
            found[i, j] = np.sqrt(max(whole - means - by_means + both, 0.0) + CANCELLED * whole)
    return found


# --- quadrature -------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Nodes:
    """Gauss nodes ``sigma`` and weights on [0, 1], panel by panel; ``panels`` are (start, size)."""

    sigma: AnyArray
    weights: AnyArray
    panels: tuple[tuple[float, float], ...]

    @classmethod
    def of(cls, poles: AnyArray, length: float) -> _Nodes:
        """Panels of a dyadic grid, short where modes that are still alive are fast."""
        x, w = np.polynomial.legendre.leggauss(TUNING.nodes)
        at, panels = 0.0, list[tuple[float, float]]()
        while at < 1 - 1e-12:
            alive = np.abs(poles[np.real(poles) * at * length > -TUNING.gone])
            fastest = float(alive.max(initial=0.0)) * length
            size = 0.5 ** max(0, int(np.ceil(np.log2(max(fastest / TUNING.node_reach, 1.0)))))
            while at / size != np.floor(at / size):
                size /= 2
            panels.append((at, size))
            at += size
            if len(panels) > TUNING.most_panels:
                found = f"a mode at {fastest / length:.4g} rad/s is too fast for {length:g} s"
                raise NoTrustworthyNumber(WHERE, found, hint=SLOWER)
        sigma = np.concatenate([start + size * (x + 1) / 2 for start, size in panels])
        return cls(sigma, np.concatenate([size * w / 2 for _, size in panels]), tuple(panels))

    def flow(self, N: AnyArray) -> tuple[AnyArray, AnyArray]:
        """``e^(N sigma)`` at all nodes, and at 1."""
        from scipy.linalg import expm

        x, _ = np.polynomial.legendre.leggauss(TUNING.nodes)
        known: dict[float, tuple[AnyArray, AnyArray]] = {}
        start, parts = np.eye(len(N)), []
        with np.errstate(over="ignore", invalid="ignore"):
            for _, size in self.panels:
                if size not in known:
                    inside = np.array([expm(N * (size * (value + 1) / 2)) for value in x])
                    known[size] = inside, expm(N * size)
                inside, whole = known[size]
                parts.append(inside @ start)
                start = whole @ start
        flow = np.concatenate(parts)
        if not (np.isfinite(flow).all() and np.isfinite(start).all()):
            raise NoTrustworthyNumber(WHERE, "e^(A t) overflows within a sample", hint="a shorter sample time")
        return flow, start


def _legendre(sigma: AnyArray, degree: int) -> AnyArray:
    """Legendre polynomials orthonormal on [0, 1] at sigma, (m, n)."""
    return np.array(
        [np.sqrt(2 * k + 1) * np.polynomial.legendre.Legendre.basis(k)(2 * sigma - 1) for k in range(degree)]
    )


def _derivatives(degree: int) -> AnyArray:
    """Derivatives at 0 of those polynomials: entry (j, k) is the j-th one of the k-th."""
    table = np.zeros((degree, degree))
    for k in range(degree):
        p = np.polynomial.legendre.Legendre.basis(k, domain=[0, 1]).convert(kind=np.polynomial.Polynomial)
        for j, coefficient in enumerate(p.coef):
            table[j, k] = np.sqrt(2 * k + 1) * coefficient * float(np.prod(np.arange(1, j + 1)))
    return table


def thin_rows(rows: AnyArray) -> AnyArray:
    """Rows with the same Gram matrix, as few as its rank."""
    if not rows.size:
        return np.zeros((0, rows.shape[1]))
    _, values, directions = np.linalg.svd(triangular_root(rows) if len(rows) > rows.shape[1] else rows)
    keep = int((values > NEGLIGIBLE * values[0]).sum()) if values[0] > 0 else 0
    return values[:keep, None] * directions[:keep]
