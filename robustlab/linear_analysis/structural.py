r"""Controllability, observability, and states that are not connected at all.

The controllable subspace is built up by orthogonal steps (the staircase form), and every mode is tested by itself,
:math:`\operatorname{rank} [A - \lambda I \;\; B] = n`, after a diagonal scaling of states and inputs that does not
depend on the model's units. Březina 2010, eqs 4.2, 4.3; Paige, IEEE TAC 26 (1981); Van Dooren, IEEE TAC 26 (1981).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from robustlab.arrays import Array, ComplexArray, Indices, Mask
from robustlab.display import AllFields, Displayable, Facts, Part, number
from robustlab.errors import error_context
from robustlab.linear_analysis.matrices import lapack
from robustlab.result import Status, least_trusted
from robustlab.statespace import StateSpaceModel, as_model

Kind = Literal["controllability", "observability"]

# Singular values of the scaled matrices, whose entries are at most 1: those above CLEAR are nonzero, those below
# ROUNDING (times n) are rounding; between the two the modes decide, and else those below ZERO count as 0.
CLEAR = 1e-10
ZERO = 1e-12
ROUNDING = 1e-14
# Entries of a basis within ROUNDED of a binary fraction of SHORT digits are that fraction.
ROUNDED, SHORT = 1e-13, 20
# States with at least this share of the largest weight belong to a mode's combination.
SHARE = 0.1


@dataclass(frozen=True)
class HiddenMode(AllFields):
    """A mode that no input moves (controllability), or that no output shows (observability)."""

    eigenvalue: complex  # in rad/s, or in the z plane for a discrete model
    stable: bool  # whether the mode decays by itself, beyond the rounding of its eigenvalue
    states: tuple[str, ...]  # names of the states whose combination it is
    meaning: str  # the same in words


@dataclass(frozen=True, eq=False)
class StructuralTest(AllFields, Displayable):
    """Result of a controllability or observability test."""

    kind: Kind  #: ``"controllability"`` or ``"observability"``
    rank: int  #: Dimension of the controllable (observable) subspace
    n_states: int  #: Number of states
    modes: tuple[HiddenMode, ...]  #: The hidden modes, ``n_states - rank`` of them
    #: Smallest singular value of ``[A - lambda I, B]`` over all modes, relative to the norm of ``[A, B]``, of the
    #: scaled model: an upper bound of the relative distance to the nearest uncontrollable (unobservable) model in that
    #: scaling; inf without states
    margin: float
    weakest: complex | None  #: The eigenvalue where the margin is attained; None without states
    status: Status  #: CONVERGED where the decision does not depend on rounding, else INACCURATE

    derived: ClassVar[tuple[str, ...]] = ("complete",)

    @property
    def complete(self) -> bool:
        """Return whether no mode is hidden: the model is controllable (observable)."""
        return self.rank == self.n_states

    @property
    def unstable_modes(self) -> tuple[HiddenMode, ...]:
        """Hidden modes that do not decay; without them the model is stabilisable (detectable)."""
        return tuple(mode for mode in self.modes if not mode.stable)

    def facts(self) -> Facts:
        word = {"controllability": "controllable", "observability": "observable"}[self.kind]
        verdict = word if self.complete else f"not {word}"
        return [
            (self.kind, f"{verdict}: rank {self.rank} of {self.n_states}, margin {self.margin:.3g}"),
            ("weakest mode", number(self.weakest)),
            *(("hidden mode", mode.meaning) for mode in self.modes),
        ]


@dataclass(frozen=True, eq=False)
class Structure(AllFields, Displayable):
    """Poles of a model, whether it is stable, and which of its modes are hidden."""

    poles: ComplexArray  # in rad/s, or in the z plane for a discrete model, the rightmost first
    stable: bool
    spectral_abscissa: float  # largest real part, in 1/s; of a discrete model the largest modulus less one
    discrete: bool
    controllability: StructuralTest
    observability: StructuralTest

    derived: ClassVar[tuple[str, ...]] = ("status",)
    quantities: ClassVar[Mapping[str, Any]] = {
        "stable": bool, "spectral_abscissa": float,
        **{kind: {"rank": "1", "states": "1", "full": bool} for kind in get_args(Kind)},
    }  # fmt: skip

    @property
    def status(self) -> Status:
        """The less trusted of both tests."""
        return least_trusted((self.controllability.status, self.observability.status))

    def numbers(self) -> dict[str, Any]:
        tests = {test.kind: test for test in (self.controllability, self.observability)}
        ranks = {k: {"rank": t.rank, "states": t.n_states, "full": t.complete} for k, t in tests.items()}
        return {**super().numbers(), **ranks}

    def headline(self) -> str:
        ranks = [f"rank of {t.kind} {t.rank} of {t.n_states}" for t in (self.controllability, self.observability)]
        return f"{'stable' if self.stable else 'NOT stable'}, {', '.join(ranks)}"

    def facts(self) -> Facts:
        top = self.spectral_abscissa
        what = ("largest pole modulus", 1 + top, "") if self.discrete else ("spectral abscissa", top, "1/s")
        size = f"{what[0]} {number(what[1], what[2], 6)}"
        stable = f"{'stable' if self.stable else 'NOT stable'}: {size}" if len(self.poles) else "static gain: no poles"
        return [("poles", stable), *self.controllability.facts(), *self.observability.facts()]

    def details(self) -> list[Part]:
        return [Part("", ("pole" if self.discrete else "pole [1/s]",), [(number(p, "", 6),) for p in self.poles])]


def structure(model: Any) -> Structure:
    m = as_model(model, "structure")
    poles = np.array(sorted(m.poles().tolist(), key=lambda p: (-p.real, p.imag)), dtype=complex)
    tests = controllability(m), observability(m)
    return Structure(poles, m.is_stable(), m.spectral_abscissa(), m.is_discrete, *tests)


@error_context("controllability")
def controllability(model: Any) -> StructuralTest:
    """Test which modes the inputs can move; see `StructuralTest`.

    Parameters
    ----------
    model
        StateSpaceModel, a linear plant, or a ``control.StateSpace``; n_x states, continuous or discrete.

    Returns
    -------
    StructuralTest
        Rank, hidden modes in rad/s (z plane where discrete), and the smallest margin of a mode.

    Raises
    ------
    InputError
        No linear model.

    Examples
    --------
    >>> pair = StateSpaceModel([[-1.0, 0.0], [0.0, 2.0]], [[1.0], [0.0]], [[1.0, 1.0]], [[0.0]])
    >>> controllability(pair)
    StructuralTest (converged)
      controllability: not controllable: rank 1 of 2, margin 0
      weakest mode: 2
      hidden mode: unstable mode 2 rad/s in x2: no input moves it
    """
    m = as_model(model, "controllability")
    return _test(m, m.A, m.B, "controllability")


@error_context("observability")
def observability(model: Any) -> StructuralTest:
    """Test which modes the outputs show: the controllability test of ``(A^T, C^T)``.

    Parameters
    ----------
    model
        As for `controllability`.

    Returns
    -------
    StructuralTest
        As for `controllability`; its hidden modes are those that no output shows.

    Raises
    ------
    InputError
        No linear model.

    Examples
    --------
    >>> pair = StateSpaceModel([[-1.0, 0.0], [0.0, 2.0]], [[1.0], [1.0]], [[1.0, 0.0]], [[0.0]])
    >>> [mode.meaning for mode in observability(pair).modes]
    ['unstable mode 2 rad/s in x2: no output shows it']
    """
    m = as_model(model, "observability")
    return _test(m, m.A.T, m.C.T, "observability")


def drop_unconnected(model: Any) -> StateSpaceModel:
    """Remove the states without a path of non-zero entries of A, B and C from an input and to an output."""
    model = as_model(model, "drop_unconnected")
    moved = reached(model.A != 0, (model.B != 0).any(axis=1))
    keep = np.flatnonzero(moved & reached((model.A != 0).T, (model.C != 0).any(axis=0)))
    point = model.operating_point
    if point is not None:
        point = replace(point, x=point.x[keep])
    states = [model.states[k] for k in keep]
    matrices = {"A": model.A[keep[:, None], keep], "B": model.B[keep], "C": model.C[:, keep]}
    return replace(model, **matrices, states=states, operating_point=point)


def _test(model: StateSpaceModel, a: Array, b: Array, kind: Kind) -> StructuralTest:
    """Test controllability of (a, b), worded for ``kind``."""
    n, found = model.n_states, _Reached.of(a, b)
    # the spectrum of the two groups, with the margins in the scaled model
    parts = slice(found.rank), slice(found.rank, None)
    inside = np.concatenate([np.linalg.eigvals(found.stairs[k, k]).astype(np.complex128) for k in parts])
    off_graph = np.linalg.eigvals(a[found.outer[:, None], found.outer]).astype(np.complex128)
    eigenvalues = np.concatenate([inside * found.rate, off_graph])
    margins = np.concatenate([_margins(found.scaled, found.into, inside), np.zeros(len(found.outer))])
    margin, weakest = (float(margins.min()), complex(eigenvalues[np.argmin(margins)])) if n else (np.inf, None)
    consistent = margin > ROUNDING * n if found.rank == n else margin < CLEAR
    status = Status.CONVERGED if found.clear and consistent else Status.INACCURATE
    return StructuralTest(kind, found.rank, n, found.modes(model, kind), margin, weakest, status)


@dataclass(frozen=True, eq=False)
class _Reached:
    """The controllable part of (a, b): states not connected to inputs, and the staircase form of the scaled others."""

    a: Array
    b: Array
    inner: Indices
    outer: Indices
    scaled: Array  # a and b of the inner states, see `_scaled`
    into: Array
    rate: float
    exponent: NDArray[np.int64]
    stairs: Array  # `q^T scaled q`, with its controllable part in the first `rank` rows and columns
    q: Array
    rank: int
    dropped: float  # largest singular value that counted as zero
    clear: bool  # whether the rank does not depend on rounding

    @classmethod
    def of(cls, a: Array, b: Array, tolerance: float | None = None) -> _Reached:
        """Decide the rank: singular values up to the tolerance count as zero; None: those below rounding.

        Rounding amplified by a weakly controllable part may lie between CLEAR and ROUNDING; the rank is clear if as
        many eigenvalues of A as directions were dropped are uncontrollable to rounding.
        """
        connected = reached(a != 0, (b != 0).any(axis=1))
        inner, outer = np.flatnonzero(connected), np.flatnonzero(~connected)
        scaled, into, rate, exponent = _scaled(a[inner[:, None], inner], b[inner])
        n, clear = len(inner), True
        steps = _staircase(scaled, into, CLEAR if tolerance is None else tolerance)
        if tolerance is None and steps[-1] >= ROUNDING * max(n, 1):
            margins = _margins(scaled, into, np.linalg.eigvals(scaled).astype(np.complex128))
            clear = bool((margins < ROUNDING * n).sum() >= n - steps[2] > 0)
            steps = steps if clear else _staircase(scaled, into, ZERO)
        return cls(a, b, inner, outer, scaled, into, rate, exponent, *steps, clear)

    def modes(self, model: StateSpaceModel, kind: Kind) -> tuple[HiddenMode, ...]:
        """Return the modes of the states not connected, and of the part that the staircase does not reach."""
        names, rest = np.array(model.state_names, dtype=object), slice(self.rank, None)
        size = float(np.linalg.norm(self.stairs, 2)) if self.rank else 0.0
        off, beyond = self.a[self.outer[:, None], self.outer], self.stairs[rest, rest]
        return (
            *_hidden_modes(off, np.eye(len(off)), names[self.outer], model.is_discrete, kind),
            *_hidden_modes(beyond, self.q[:, rest], names[self.inner], model.is_discrete, kind, self.rate, size),
        )

    def basis(self) -> tuple[Array, Indices, float]:
        """Return T and rows ``kept`` (T is I there), ``A T = T (A T)[kept]``, ``B = T B[kept]``; the residual."""
        from scipy.linalg import qr

        rank, inner, exponent = self.rank, self.inner, self.exponent
        v = self.q[:, :rank]
        order = np.asarray(qr(v.T, mode="r", pivoting=True)[-1])
        kept, rest = np.sort(order[:rank]), np.sort(order[rank:])
        share = np.linalg.solve(v[kept].T, v[rest].T).T
        share[np.abs(share) <= ROUNDING * len(v)] = 0.0
        short = np.ldexp(np.rint(np.ldexp(share, SHORT)), -SHORT)  # exact cancellations have no rounding
        share = np.where(np.abs(share - short) <= ROUNDED, short, share)
        t = np.zeros((len(self.a), rank))
        t[inner[kept], range(rank)] = 1.0
        t[inner[rest]] = np.ldexp(share, exponent[rest, None] - exponent[None, kept])
        size = np.abs(self.b).max(axis=0, initial=0.0)
        moved = (self.a @ t)[inner], self.b[inner] / np.where(size > 0, size, 1.0)
        off = [np.ldexp(m - t[inner] @ m[kept], -exponent[:, None]) for m in moved]
        off[0] = np.ldexp(off[0], exponent[None, kept]) / self.rate
        return t, inner[kept], max(float(np.abs(m).max(initial=0.0)) for m in off)


@dataclass(frozen=True, eq=False)
class LeastOrder:
    """A model without the modes that no input moves or no output shows."""

    model: StateSpaceModel  # with a subset of the given states where no output was needed to choose
    given: StateSpaceModel
    reached: StateSpaceModel  # without what no input moves
    # states of `given` are `right` times those of `reached`; those of `model` are `left` times them
    right: Array
    left: Array
    hidden: tuple[HiddenMode, ...]  # the modes that were left out
    dropped: float  # largest singular value that counted as zero, relative to the scaled model
    clear: bool  # whether the rank does not depend on rounding


def least_order(model: StateSpaceModel, tolerance: float | None = None) -> LeastOrder:
    """Remove the modes that no input moves, then those that no output shows; ``tolerance``: see `_Reached.of`."""
    first = _Reached.of(model.A, model.B, tolerance)
    t, kept, missed = first.basis()
    names = [model.states[k] for k in kept]
    A, C = _product(model.A[kept], t, missed), _product(model.C, t, missed)
    reached = replace(model, A=A, B=model.B[kept], C=C, states=names, operating_point=None)
    second = _Reached.of(reached.A.T, reached.C.T, tolerance)
    s, kept, missed = second.basis()
    names = [reached.states[k] for k in kept] if np.count_nonzero(s) == len(kept) else None
    A, B = _product(reached.A[:, kept].T, s, missed).T, _product(reached.B.T, s, missed).T
    least = replace(reached, A=A, B=B, C=reached.C[:, kept], states=names)
    hidden = first.modes(model, "controllability") + second.modes(reached, "observability")
    clear = first.clear and second.clear
    return LeastOrder(least, model, reached, t, s.T, hidden, max(first.dropped, second.dropped), clear)


def _product(a: Array, t: Array, missed: float) -> Array:
    """Multiply, with zeros where the terms cancel to rounding; ``missed``: error of t."""
    found = a @ t
    return np.where(np.abs(found) <= max(ROUNDING, 10 * missed) * (np.abs(a) @ np.abs(t)), 0.0, found)


def hidden_unstable(model: StateSpaceModel) -> tuple[HiddenMode, ...]:
    """Return the unstable modes that no input moves or no output shows, one of each conjugate pair."""
    if model.is_stable():
        return ()
    modes = _Reached.of(model.A, model.B).modes(model, "controllability")
    modes += _Reached.of(model.A.T, model.C.T).modes(model, "observability")
    return tuple(mode for mode in modes if not mode.stable and mode.eigenvalue.imag >= 0)


def with_hidden(text: str, *models: StateSpaceModel) -> str:
    """Complete the text about an unstable loop by the hidden unstable modes of its models."""
    return "; ".join([text, *(f"hidden: {mode.meaning}" for model in models for mode in hidden_unstable(model))])


def _staircase(a: Array, b: Array, zero: float) -> tuple[Array, Array, int, float]:
    """Build the controllable subspace by orthogonal steps: return ``q^T A q``, q, its rank, the largest value lost."""
    n = len(a)
    a, q = a.copy(order="F"), np.eye(n, order="F")
    block, done, dropped = b, 0, 0.0
    while done < n and block.size:
        u, s, _ = np.linalg.svd(block, full_matrices=False)
        r = int((s > zero).sum())
        dropped = max(dropped, float(s[r:].max(initial=0.0)))
        if r == 0:
            break
        # Complete u to a basis of the rest by Householder reflections and take A there: O(n^2 r) a step.
        reflectors, tau, _, _ = lapack().dgeqrf(np.asfortranarray(u[:, :r]))
        width = max(1, 64 * n)
        a[done:, :] = lapack().dormqr("L", "T", reflectors, tau, a[done:, :], width)[0]
        a[:, done:] = lapack().dormqr("R", "N", reflectors, tau, a[:, done:], width)[0]
        q[:, done:] = lapack().dormqr("R", "N", reflectors, tau, q[:, done:], width)[0]
        block = a[done + r :, done : done + r]
        done += r
    return a, q, done, dropped


def _scaled(a: Array, b: Array) -> tuple[Array, Array, float, NDArray[np.int64]]:
    r"""Return ``T^-1 A T / rate`` and ``T^-1 B S`` with entries up to 1 and one of about 1 in every row, rate, log2 T.

    T is the strongest path from the inputs to each state, :math:`t_i = \max(|b_i|, \max_j |a_{ij}| t_j / rate)`,
    rounded to powers of two; units of states cancel in it. ``rate`` is the Perron root of \|A\|, which bounds the mean
    of every cycle. Every state must be connected to an input.
    """
    n = len(a)
    magnitude = np.abs(a)
    rate = float(np.abs(np.linalg.eigvals(magnitude)).max(initial=0.0)) or 1.0
    size = np.abs(b).max(axis=0, initial=0.0)
    b = b[:, size > 0] / size[size > 0]
    with np.errstate(divide="ignore"):
        edges = np.log2(magnitude) - np.log2(rate)
        reach = np.log2(np.abs(b).max(axis=1, initial=0.0))
    for _ in range(n):
        further = np.maximum(reach, (edges + reach).max(axis=1, initial=-np.inf))
        if np.array_equal(further, reach):
            break
        reach = further
    exponent = np.round(reach).astype(np.int64)
    scaled = np.ldexp(a, exponent[None, :] - exponent[:, None]) / rate
    into = np.ldexp(b, -exponent[:, None])
    width = np.abs(into).max(axis=0, initial=0.0)
    return scaled, into / np.where(width > 0, width, 1.0), rate, exponent


def _margins(a: Array, b: Array, eigenvalues: ComplexArray) -> Array:
    """Return the smallest singular value of ``[A - lambda I, B]`` at each eigenvalue, relative to ``|[A, B]|``."""
    if not len(a):
        return np.zeros(0)
    # A conjugate pair has the same singular values.
    values, place = np.unique(eigenvalues.real + 1j * np.abs(eigenvalues.imag), return_inverse=True)
    least = [np.linalg.svd(np.hstack([a - s * np.eye(len(a)), b]), compute_uv=False)[-1] for s in values]
    return np.array(least)[place] / np.linalg.norm(np.hstack([a, b]), 2)


def _hidden_modes(
    a: Array, basis: Array, states: NDArray[np.object_], discrete: bool, kind: Kind,
    rate: float = 1.0, size: float = 0.0,
) -> list[HiddenMode]:  # fmt: skip
    """Return the modes of ``rate a``, whose entries carry the rounding of numbers of ``size`` at least."""
    from scipy.linalg import eig

    if len(a) == 0:
        return []
    values, left, right = (np.asarray(part) for part in eig(a, left=True, right=True))
    # First-order bound of a backward-stable eigenvalue: ||A|| eps / |y^H x|; a defective one gets eps^(1/2) or worse.
    overlap = np.abs(np.einsum("ij,ij->j", left.conj(), right))
    size = max(size, float(np.linalg.norm(a, 2)))
    rounding = 10 * len(a) * np.finfo(float).eps * size / np.maximum(overlap, 1e-16) * rate
    word, found = "no input moves it" if kind == "controllability" else "no output shows it", list[HiddenMode]()
    for value, blur, weight in zip((rate * values).tolist(), rounding, np.abs(basis @ left).T, strict=True):
        value = complex(value)
        stable = bool((1 - abs(value) if discrete else -value.real) > blur)
        involved = tuple(states[weight >= SHARE * weight.max()])
        re, im = (0.0 if abs(part) <= blur else part for part in (value.real, value.imag))
        number = f"{re:.6g}{im:+.6g}j" if im else f"{re:.6g}"
        where = f"z = {number}" if discrete else f"{number} rad/s"
        text = f"{'stable' if stable else 'unstable'} mode {where} in {', '.join(involved)}: {word}"
        found.append(HiddenMode(value, stable, involved, text))
    return found


def strong_components(acts: Mask) -> Indices:
    """Return the strong component of each node, numbered by first nodes; ``acts[i, j]``: edge from j to i."""
    # Squaring the matrix of paths is faster than scipy's search, with its import, for a few nodes.
    paths = acts | np.eye(len(acts), dtype=bool)
    while True:
        count = paths.astype(np.float32)
        longer = count @ count > 0
        if (longer == paths).all():
            return np.unique((paths & paths.T).argmax(axis=1), return_inverse=True)[1]
        paths = longer


def reached(edges: Mask, start: Mask) -> Mask:
    """Return the states that can be reached from ``start`` by edges from j to i, ``edges[i, j]``."""
    found, frontier = start.copy(), start.copy()
    while frontier.any():
        frontier = edges[:, frontier].any(axis=1) & ~found
        found |= frontier
    return found
