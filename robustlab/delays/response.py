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

from dataclasses import dataclass
from math import factorial
from typing import Literal

import numpy as np

from robustlab.arrays import Array, Indices, Mask
from robustlab.checks import number
from robustlab.delays.model import DelayedModel
from robustlab.errors import NoTrustworthyNumber

DEGREE = 7  # of the polynomials in a cell
PASSES = 7  # through delays after which a jump is smoother than a polynomial of that degree resolves
MOST_CELLS = 60_000
# Runs on finer and finer meshes. A cell is halved where its last coefficients exceed this share of rtol.
REFINEMENTS, SHARE, SMALLEST = 60, 0.1, 1e-12
# Points of the mesh nearer than this share of the whole time are one.
SAME_TIME = 1e-11
# At a node on a jump the limit from inside its cell is taken.
INWARDS = 1e-7


@dataclass(frozen=True)
class Answer:
    """Outputs (n, n_y); the estimated error relative to their largest size, zero where every step is exact; cells."""

    y: Array
    error: float
    cells: int


def delayed_response(
    model: DelayedModel, t: Array, u: Array, x0: Array, hold: Literal["zoh", "foh"], rtol: float
) -> Answer:
    """Response to samples u (n, n_u) at the times t, from the state x0 of H, with nothing in the delays."""
    inside = _inside(model)
    points = _mesh(model, t, inside)
    if not inside.any():
        return Answer(_Run(model, t, u, hold, points, 1).outputs(x0), 0.0, len(points) - 1)
    mesh = _cut(points, float(model.delays[_moving(model)].min()))
    run, y, error = None, np.zeros(0), np.inf
    for _ in range(REFINEMENTS):
        run = _Run(model, t, u, hold, mesh, DEGREE)
        y = run.outputs(x0)
        if not np.isfinite(y).all():
            break
        rough = run.rough(max(SHARE * rtol, SMALLEST))
        if not rough.any():  # all cells are resolved: halving each must not change the response
            mesh = _halved(mesh, np.ones(run.cells, dtype=bool))
            finer = _Run(model, t, u, hold, mesh, DEGREE)
            again = finer.outputs(x0)
            error = float(np.abs(again - y).max(initial=0.0)) / (float(np.abs(again).max(initial=0.0)) or 1.0)
            run, y = finer, again
            if error <= rtol:
                break
        else:
            mesh = _halved(mesh, rough)
    assert run is not None
    if error <= rtol or not np.isfinite(y).all():
        return Answer(y, error, run.cells)
    found = f"the response still changes when its {run.cells} cells are halved"
    raise NoTrustworthyNumber("simulate", found, f"a change of at most {rtol:g}", "a larger rtol")


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
        if len(points) > MOST_CELLS:
            raise _too_many(len(points))
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
    if pieces.sum() > MOST_CELLS:
        raise _too_many(int(pieces.sum()))
    parts = [np.linspace(a, b, k, endpoint=False) for a, b, k in zip(points[:-1], points[1:], pieces, strict=True)]
    return np.append(np.concatenate(parts), points[-1])


def _halved(mesh: Array, which: Mask) -> Array:
    """Halve some cells of the mesh."""
    if len(mesh) + int(which.sum()) > MOST_CELLS:
        raise _too_many(len(mesh) + int(which.sum()))
    return np.sort(np.concatenate([mesh, (0.5 * (mesh[:-1] + mesh[1:]))[which]]))


def _too_many(cells: int) -> NoTrustworthyNumber:
    hint = "a clock whose step divides the delays, a shorter time, or .pade(order)"
    return NoTrustworthyNumber("simulate", f"{cells} cells for the delays", f"at most {MOST_CELLS}", hint)


# --- one run ----------------------------------------------------------------------------------------------------------


class _Run:
    """A simulation on one mesh; quantities that do not depend on the signals are computed for all cells at once."""

    def __init__(self, model: DelayedModel, t: Array, u: Array, hold: str, mesh: Array, degree: int) -> None:
        self.model, self.t, self.u, self.mesh = model, t, u, mesh
        self.nodes = 0.5 - 0.5 * np.cos(np.pi * np.arange(degree + 1) / degree)
        self.series = np.linalg.inv(_chebyshev(self.nodes, degree))  # coefficients from values at the nodes
        self.steps = np.diff(self.mesh)
        self.cells = len(self.steps)
        times = self.mesh[:-1, None] + self.steps[:, None] * self.nodes
        self.force = self._held(times, hold)
        self.source, self.weights = self._lookup(times, 0.5 * (self.mesh[:-1] + self.mesh[1:]))

    def _held(self, times: Array, hold: str) -> Array:
        """The inputs at the nodes of all cells, (cells, nodes, n_u)."""
        k = np.clip(np.searchsorted(self.t, 0.5 * (times[:, 0] + times[:, -1]), side="right") - 1, 0, len(self.t) - 2)
        held = np.broadcast_to(self.u[k][:, None], (*times.shape, self.u.shape[1]))
        if hold == "zoh":
            return held
        share = (times - self.t[k][:, None]) / (self.t[k + 1] - self.t[k])[:, None]
        return held + share[:, :, None] * (self.u[k + 1] - self.u[k])[:, None]

    def _lookup(self, times: Array, middle: Array) -> tuple[Indices, Array]:
        """For each time (cells, nodes) and delay: the cell of the delayed time (-1: none), and its weights there."""
        back = times[:, :, None] - self.model.delays
        inner = back + INWARDS * (middle[:, None] - times)[:, :, None]
        source = np.searchsorted(self.mesh, inner, side="right") - 1
        known = np.clip(source, 0, self.cells - 1)
        place = np.clip((back - self.mesh[known]) / self.steps[known], 0.0, 1.0)
        return np.where(source < 0, -1, known), _chebyshev(place, len(self.nodes) - 1) @ self.series

    def outputs(self, x0: Array) -> Array:
        """Return the outputs just after each sample."""
        H, n = self.model.H, len(self.model.delays)
        C1, D11, D12 = H.C[:n], H.D[:n, :n], H.D[:n, n:]
        maps, kind = _maps(H.A, H.B, self.steps, self.nodes, float(np.abs(self.mesh).max()))
        held = np.zeros((self.cells + 1, len(self.nodes), n))  # z at the nodes; the last row: before the first sample
        held[:-1] = self.force @ D12.T  # a delay of inputs alone may refer to the current cell
        states, late = np.zeros((self.cells + 1, H.n_states)), np.zeros((self.cells + 1, n))
        states[0] = x0
        came = np.zeros((self.cells, len(self.nodes), n))  # w at the nodes
        delay = np.arange(n)
        for c in range(self.cells):
            # (nodes, n, nodes of the delayed cell)
            w = np.einsum("jil,jil->ji", held[self.source[c], :, delay], self.weights[c])
            free, forced = maps[kind[c]]
            inputs = np.hstack([w, self.force[c]])
            x = free @ states[c] + np.tensordot(forced, inputs, ([2, 3], [0, 1]))
            held[c] = x @ C1.T + w @ D11.T + self.force[c] @ D12.T
            states[c + 1], late[c], came[c] = x[-1], w[0], w
        self.signals = np.concatenate([held[:-1], came[:, :, _moving(self.model)]], axis=2)
        end = np.full((1, 1), self.mesh[-1])
        source, weights = self._lookup(end, np.full(1, self.mesh[-1] + self.steps[-1]))
        late[-1] = np.einsum("jil,jil->ji", held[source[0], :, delay], weights[0])[0]
        at = np.searchsorted(self.mesh, self.t)
        return states[at] @ H.C[n:].T + late[at] @ H.D[n:, :n].T + self.u @ H.D[n:, n:].T

    def rough(self, tolerance: float) -> Mask:
        """Return the cells in which the last coefficients of a signal into or out of a delay are not small."""
        size = np.abs(self.signals).max(axis=(0, 1), initial=0.0)
        tail = np.abs(np.einsum("kj,cji->cki", self.series[-2:], self.signals)).max(axis=1, initial=0.0)
        return (tail > tolerance * size).any(axis=1)


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


def checked_rtol(rtol: float | None) -> float:
    """The given relative error, or the usual one."""
    if rtol is None:
        return 1e-9
    number("simulate: rtol", rtol, "a number between 0 and 1", above=0, below=1)
    return float(rtol)
