r"""Responses of models with exact delays over time, by the method of steps.

On a mesh of all samples and all their delayed times, signals are smooth between the points: the input is a polynomial,
and the signals in the delays are interpolated by polynomials. Between two points

.. math:: x(a + h) = e^{A h} x(a) + \int_0^h e^{A (h - s)} \bigl(B_1 w(a + s) + B_2 u(a + s)\bigr) ds, \qquad w_i(t) =
   z_i(t - \tau_i)

is evaluated by matrix exponentials for these polynomials, without error. With delays of
inputs and outputs only, the whole response is exact. The signal in a delay inside a loop, or between two dynamic parts,
is no polynomial: it is stored at Chebyshev points of each cell. Cells that do not resolve it are halved, and at the end
all of them, until the response at the samples no longer changes.

References
----------
Bellman, Zwanziger, "Solution of delay differential equations by the method of steps"; Bellen, Zennaro, *Numerical
Methods for Delay Differential Equations* (2003); Van Loan, IEEE TAC 23 (1978) for the integrals.
"""

from __future__ import annotations

from math import factorial
from typing import Literal

import numpy as np

from robustlab.arrays import Array, Indices, Mask
from robustlab.delays.model import DelayedModel
from robustlab.errors import NoTrustworthyNumber

Hold = Literal["zoh", "foh"]
DEGREE = 7  # of the polynomials in a cell
PASSES = 7  # through delays after which a jump is smoother than a polynomial of that degree resolves
MOST_CELLS = 60_000
# Runs on finer and finer meshes. A cell is halved where its last coefficients exceed this share of rtol.
REFINEMENTS, SHARE, SMALLEST = 60, 0.1, 1e-12
# Points of the mesh nearer than this share of the whole time are one.
SAME_TIME = 1e-11
# At a node on a jump the limit from inside its cell is taken.
INWARDS = 1e-7


def delayed_response(model: DelayedModel, t: Array, u: Array, x0: Array, hold: Hold, rtol: float) -> Array:
    """Return the outputs (n, n_y) at the times t for samples u (n, n_u), from the state x0 of H, with empty delays."""
    inside = _inside(model)
    mesh = _mesh(model, t, inside)
    if not inside.any():
        return _run(model, t, u, x0, hold, mesh, 1)[0]
    mesh, resolved, y = _cut(mesh, float(model.delays[_moving(model)].min())), False, np.zeros((len(t), 0))
    for _ in range(REFINEMENTS):
        last, (y, tail) = y, _run(model, t, u, x0, hold, mesh, DEGREE)
        if not np.isfinite(y).all():
            return y
        # Where all cells were resolved, halving each must not have changed the response.
        if resolved and np.abs(y - last).max(initial=0.0) <= rtol * np.abs(y).max(initial=0.0):
            return y
        rough = tail > max(SHARE * rtol, SMALLEST)
        resolved = not rough.any()
        cells = rough | resolved
        _limited(len(mesh) + int(cells.sum()))
        mesh = np.sort(np.concatenate([mesh, (0.5 * (mesh[:-1] + mesh[1:]))[cells]]))
    found = f"the response still changes when its {len(mesh)} cells are halved"
    raise NoTrustworthyNumber("simulate", found, f"a change of at most {rtol:g}", "a larger rtol")


def _limited(cells: int) -> None:
    if cells > MOST_CELLS:
        hint = "a clock whose step divides the delays, a shorter time, or .pade(order)"
        raise NoTrustworthyNumber("simulate", f"{cells} cells for the delays", f"at most {MOST_CELLS}", hint)


# --- the mesh ---------------------------------------------------------------------------------------------------------


def _moving(model: DelayedModel) -> Indices:
    """Return the delays whose output enters a state or another delay."""
    n = len(model.delays)
    return np.flatnonzero(np.vstack([model.H.B, model.H.D[:n]])[:, :n].any(axis=0))


def _inside(model: DelayedModel) -> Mask:
    """Return which delays pass a signal that is no polynomial on to states or other delays, shape (n,)."""
    n = len(model.delays)
    found = np.zeros(n, dtype=bool)
    found[_moving(model)] = True
    return found & np.hstack([model.H.C[:n], model.H.D[:n, :n]]).any(axis=1)


def _mesh(model: DelayedModel, t: Array, inside: Mask) -> Array:
    """Return all samples, their delayed times, and for each sample the earlier times of delayed outputs."""
    moving, end = _moving(model), t[-1]
    points = new = t
    echoes = bool(model.H.D[moving][:, moving].any())  # jumps that no state smooths recur without end
    passes = 0
    while len(new) and (passes < (PASSES if inside.any() else 1) or echoes):
        passes += 1
        new = _merged(np.concatenate([[], *(new + tau for tau in np.unique(model.delays[moving]))]), t)
        new = new[new < end]
        points = _merged(np.concatenate([points, new]), t)
        _limited(len(points))
    outer = np.setdiff1d(np.arange(len(model.delays)), moving)
    earlier = np.concatenate([points, *(t - tau for tau in np.unique(model.delays[outer]))])
    return _merged(earlier[earlier >= t[0]], t)


def _merged(points: Array, t: Array) -> Array:
    """Sort the points and merge those that differ by rounding; samples are unchanged."""
    same = SAME_TIME * (t[-1] - t[0])
    nearest = t[np.clip(np.searchsorted(t, points - same), 0, len(t) - 1)]
    points = np.sort(np.where(np.abs(nearest - points) <= same, nearest, points))
    return points[np.concatenate([[True], np.diff(points) > same])] if len(points) else points


def _cut(points: Array, longest: float) -> Array:
    """Return the mesh with steps of at most ``longest``, so that every delay refers to a finished cell."""
    pieces = np.maximum(1, np.ceil(np.diff(points) / longest * (1.0 - 1e-9))).astype(int)
    _limited(int(pieces.sum()))
    parts = [np.linspace(a, b, k, endpoint=False) for a, b, k in zip(points[:-1], points[1:], pieces, strict=True)]
    return np.append(np.concatenate(parts), points[-1])


# --- one run ----------------------------------------------------------------------------------------------------------


def _run(
    model: DelayedModel, t: Array, u: Array, x0: Array, hold: Hold, mesh: Array, degree: int
) -> tuple[Array, Array]:
    """Return the outputs just after each sample, and of each cell the last coefficients of the signals in its delays.

    The latter are relative to the largest value of each signal.
    """
    H, n, cells = model.H, len(model.delays), len(mesh) - 1
    C1, D11, D12 = H.C[:n], H.D[:n, :n], H.D[:n, n:]
    nodes = 0.5 - 0.5 * np.cos(np.pi * np.arange(degree + 1) / degree)
    series = np.linalg.inv(_chebyshev(nodes, degree))  # coefficients from values at the nodes
    steps, middle = np.diff(mesh), 0.5 * (mesh[:-1] + mesh[1:])
    times = mesh[:-1, None] + steps[:, None] * nodes

    k = np.clip(np.searchsorted(t, middle, side="right") - 1, 0, len(t) - 2)
    share = (times - t[k][:, None]) / (t[k + 1] - t[k])[:, None] if hold == "foh" else np.zeros_like(times)
    force = u[k][:, None] + share[:, :, None] * (u[k + 1] - u[k])[:, None]  # inputs at the nodes of all cells

    def delayed(times: Array, middle: Array) -> tuple[Indices, Array]:
        """For each time and delay: the cell of the delayed time (-1: none), and the weights of its nodes there."""
        back = times[:, :, None] - model.delays
        inner = back + INWARDS * (middle[:, None] - times)[:, :, None]
        source = np.searchsorted(mesh, inner, side="right") - 1
        known = np.clip(source, 0, cells - 1)
        place = np.clip((back - mesh[known]) / steps[known], 0.0, 1.0)
        return np.where(source < 0, -1, known), _chebyshev(place, degree) @ series

    source, weights = delayed(times, middle)
    maps, kind = _maps(H.A, H.B, steps, nodes, float(np.abs(mesh).max()))
    held = np.zeros((cells + 1, degree + 1, n))  # z at the nodes; the last row: before the first sample
    held[:-1] = force @ D12.T  # a delay of inputs alone may refer to the current cell
    states, came, each = np.zeros((cells + 1, H.n_states)), np.zeros((cells + 1, degree + 1, n)), np.arange(n)
    states[0] = x0
    for c in range(cells):
        # (nodes, n, nodes of the delayed cell)
        came[c] = w = np.einsum("jil,jil->ji", held[source[c], :, each], weights[c])
        free, forced = maps[kind[c]]
        x = free @ states[c] + np.tensordot(forced, np.hstack([w, force[c]]), ([2, 3], [0, 1]))
        held[c] = x @ C1.T + w @ D11.T + force[c] @ D12.T
        states[c + 1] = x[-1]
    last, weights = delayed(np.full((1, 1), mesh[-1]), np.full(1, mesh[-1] + steps[-1]))
    came[-1, 0] = np.einsum("jil,jil->ji", held[last[0], :, each], weights[0])
    at = np.searchsorted(mesh, t)
    y = states[at] @ H.C[n:].T + came[at, 0] @ H.D[n:, :n].T + u @ H.D[n:, n:].T
    signals = np.concatenate([held[:-1], came[:-1, :, _moving(model)]], axis=2)
    size = np.abs(signals).max(axis=(0, 1), initial=0.0)
    tail = np.abs(np.einsum("kj,cji->cki", series[-2:], signals)).max(axis=1, initial=0.0)
    return y, (tail / np.where(size > 0, size, 1.0)).max(axis=1, initial=0.0)


def _chebyshev(place: Array, degree: int) -> Array:
    """Chebyshev's polynomials at each place in [0, 1], shape (*place.shape, degree + 1)."""
    return np.asarray(np.polynomial.chebyshev.chebvander(2.0 * place - 1.0, degree))


def _maps(A: Array, B: Array, steps: Array, nodes: Array, end: float) -> tuple[list[tuple[Array, Array]], Indices]:
    """Return for each length of step the maps from the first state and the inputs to the states at the nodes."""
    from scipy.linalg import expm

    same = 8.0 * np.finfo(float).eps * end  # steps of one period differ by rounding
    _, first, kind = np.unique(np.round(steps / same), return_index=True, return_inverse=True)
    n, m, count = len(A), B.shape[1], len(nodes)
    # The input's derivatives are additional states.
    factorials = np.array([factorial(k) for k in range(count)], dtype=float)
    derivatives = factorials[:, None] * np.linalg.inv(np.vander(nodes, increasing=True))
    made = []
    for h in steps[first]:
        block = np.zeros((n + m * count, n + m * count))
        block[:n, :n], block[:n, n : n + m] = A * h, B * h
        block[n : n + m * (count - 1), n + m :] = np.eye(m * (count - 1))
        e = np.asarray([expm(block * s)[:n] for s in nodes])
        forced = e[:, :, n:].reshape(count, n, count, m)
        made.append((e[:, :, :n], np.einsum("jnkm,kl->jnlm", forced, derivatives)))
    return made, kind
