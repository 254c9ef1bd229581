r"""Model and record for a validation: sampled, matched by names, in units of the noise bounds; cone programmes.

With w = Delta z unknown, states, z and noise are affine in w and in the initial states. At the start of a window the
observable state may jump; unobservable states start at zero, since a free one could make any w feasible.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from importlib import import_module
from itertools import pairwise
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from robustlab.arrays import Array
from robustlab.budget import Budget
from robustlab.checks import number
from robustlab.conic import Cone, solve
from robustlab.dynamics.simulation import transition
from robustlab.errors import InputError, NoTrustworthyNumber, unknown_name
from robustlab.identification.comparison.envelope import deviations
from robustlab.identification.response.response import response_of
from robustlab.record import Record
from robustlab.statespace import Signal, StateSpaceModel
from robustlab.uncertainty.blocks import Block, block_slices
from robustlab.uncertainty.lft import UncertainModel
from robustlab.worst_case_analysis.batched_members import recursion

ROUNDING = 1e-12  # responses below this share of the largest one are rounding
OBSERVABLE = 1e-9  # state directions count as observable above this share of the most observable one
MOST_ITERATIONS = 200
FEWEST_ITERATIONS = 20  # of any programme, independent of the remaining budget
BUILDING_WORK = 2.0  # to set up a programme, per stored entry, as measured
ITERATION_WORK = 0.5  # of an iteration, per stored entry, as measured
HALVINGS = 24  # of the interval in which a disproved gamma is searched
SLACK = 1e-9  # rounding in the noise of an explanation, over its bound

INFEASIBLE = ("PrimalInfeasible", "AlmostPrimalInfeasible")


@dataclass(frozen=True)
class Recorded:
    """A record matched with an uncertain model."""

    uncertain: UncertainModel  # the set, with the compared outputs only
    t: Array  # time in s, (n,)
    u: Array  # (n, n_u) in the order of the model, in deviations from its operating point
    y: Array  # (n, n_y) likewise
    outputs: tuple[Signal, ...]  # compared outputs with their units
    bound: Array  # noise bound of each output, (n_y,)
    starts: tuple[int, ...]  # first sample of each window
    at_rest: bool  # whether the first window starts at zero state; all others have a free state

    @property
    def dt(self) -> float:
        """Sample time in s."""
        return float(self.t[-1] - self.t[0]) / (len(self.t) - 1)


def prepared(
    uncertain: UncertainModel, record: Record, noise: Mapping[str, ArrayLike], *, window: float | None = None,
    at_rest: bool = False,
) -> Recorded:  # fmt: skip
    where = f"validate {record.name}"
    if not record.is_uniform:
        step = np.diff(record.t)
        worst = int(np.abs(step - record.dt).argmax()) + 1
        found = f"irregular sampling: {step.min():.6g} to {step.max():.6g} s between samples (worst at sample {worst})"
        reason = "a uniform clock: Delta acts on samples, and between unequal ones a contraction has no meaning"
        raise NoTrustworthyNumber(where, found, reason, "resample the record, or cut it where samples are missing")
    response = response_of(uncertain.nominal, record)
    names = response.output_names
    bound = noise_bounds(noise, names, where)
    shifted, _ = deviations(response.with_units(record), uncertain, names)
    chosen, starts = uncertain.select(outputs=names), (0,)
    u = np.column_stack([np.zeros((record.n, 0)), *(shifted.inputs[s.name] for s in chosen.inputs)])
    y = np.column_stack([shifted.outputs[name] for name in names])
    if window is not None:
        length, shortest = round(window / record.dt) if np.isfinite(window) else 0, max(4, 2 * uncertain.M.n_states)
        if length < shortest:
            raise InputError(where, f"windows of {window:g} s ({length} samples)", f"at least {shortest} samples")
        starts = tuple(s for s in range(0, record.n, length) if record.n - s >= shortest or s == 0)
    return Recorded(chosen, record.t, u, y, response.outputs, bound, starts, at_rest)


@dataclass(frozen=True)
class SampledProblem:
    """Affine maps of this module for one choice of the real parameters."""

    A: Array  # sampled model from w to z (C1, D11) and to the noise (C2, D21), in scaled signals
    B: Array
    C1: Array
    D11: Array
    C2: Array
    D21: Array
    z0: Array  # (n, p)
    e: Array  # (n, n_y)
    starts: tuple[int, ...]  # as in `Recorded`
    at_rest: bool
    free: Array  # orthonormal basis of the observable (free) state directions, (n_x, k)
    blocks: tuple[tuple[slice, slice, bool], ...]  # slices of w and z of each block; whether it is one system repeated
    names: tuple[str, ...]  # of the blocks
    scale: Array  # divisor of the signals w and z of each block

    @property
    def n(self) -> int:
        return len(self.e)

    @property
    def free_starts(self) -> tuple[int, ...]:
        """Samples at which the state is free."""
        return self.starts[1:] if self.at_rest else self.starts

    def respond(self, w: Array, states_at: Mapping[int, Array]) -> tuple[Array, Array]:
        """Compute z (n, p) and noise (n, n_y) for w (n, q) and jumps (k,) of the state at free starts; default 0."""
        drive, first = w @ self.B.T, np.zeros(len(self.A))
        for t, jump in states_at.items():
            if t:
                drive[t - 1] += self.free @ jump
            else:
                first = self.free @ jump
        x = states(self.A, drive, first)
        return self.z0 + x @ self.C1.T + w @ self.D11.T, self.e - x @ self.C2.T - w @ self.D21.T

    def free_response(self) -> Any:
        """Return the response of -noise to the free states of each window, sparse, (n n_y, all free states)."""
        cuts = list(pairwise([*self.starts, self.n]))
        longest, k = max(b - a for a, b in cuts), self.free.shape[1]
        moved = [states(self.A, np.zeros((longest, len(self.A))), x0) @ self.C2.T for x0 in self.free.T]
        rows = np.stack(moved, axis=2).reshape(-1, k) if moved else np.zeros((longest * self.e.shape[1], 0))
        ends = [(b - a) * self.e.shape[1] for a, b in cuts]
        parts = [rows[:end, : k if a in self.free_starts else 0] for (a, _), end in zip(cuts, ends, strict=True)]
        return sparse_matrices().block_diag(parts, format="csr")

    def z_is_known(self) -> bool:
        """Check that z depends neither on w nor on a free state: then the test is convex."""
        state, found = np.hstack([self.B, self.free]) if self.free_starts else self.B, [self.D11]
        for _ in range(max(len(self.A), 1)):
            found.append(self.C1 @ state)
            state = self.A @ state
        moved, largest = np.abs(np.hstack(found)).max(initial=0.0), np.abs(self.z0).max(initial=0.0)
        return bool(moved <= ROUNDING * max(largest, 1e-300))

    def excess(self, noise: Array) -> float:
        """Return the largest noise over its bound: at most 1 if explained."""
        return float(np.abs(noise).max(initial=0.0))

    def sizes(self, w: Array, z: Array) -> Array:
        """Return the least gain of a causal time-varying system from z to w of each block."""
        # The root of ``max_T (sum_{t <= T} |w_t|^2 / sum_{t <= T} |z_t|^2)``.
        found = []
        for rows, cols, _ in self.blocks:
            ew, ez = (np.cumsum((x**2).sum(axis=1)) for x in (w[:, rows], z[:, cols]))
            with np.errstate(divide="ignore", invalid="ignore"):
                ratio = np.where(ew > 0, ew / ez, 0.0)
            found.append(float(np.sqrt(ratio.max(initial=0.0))))
        return np.array(found)


def sampled(recorded: Recorded, M: StateSpaceModel, blocks: Sequence[Block]) -> SampledProblem:
    """Set up the problem for a model with Delta channels of the given blocks; zero-order hold on u and w."""
    # Real blocks count as systems (a relaxation). A constant may make states observable that are not so in the nominal
    # model, so the states that act on such a block are free as well.
    q, p = sum(b.rows for b in blocks), sum(b.cols for b in blocks)
    (A, B), C, D = zero_order_hold(M, recorded.dt), M.C, M.D
    x = states(A, recorded.u @ B[:, q:].T, np.zeros(len(A)))
    forced = x @ C.T + recorded.u @ D[:, q:].T
    if not np.isfinite(forced).all():
        raise NoTrustworthyNumber("validate", "the nominal response exceeds double precision", None, "use windows")
    z0, y0 = forced[:, :p], forced[:, p:]
    scale_w, scale_z, bound, slices = np.ones(q), np.ones((p, 1)), recorded.bound[:, None], block_slices(blocks)
    scales = [float(np.sqrt(np.mean(z0[:, cols] ** 2))) or 1.0 for _, cols in slices]
    for (rows, cols), size in zip(slices, scales, strict=True):
        scale_w[rows], scale_z[cols] = size, size
    constant = [C[cols] / scale_z[cols] for block, (_, cols) in zip(blocks, slices, strict=True) if block.interval]
    return SampledProblem(
        A=A,
        B=B[:, :q] * scale_w,
        C1=C[:p] / scale_z,
        D11=D[:p, :q] * scale_w / scale_z,
        C2=C[p:] / bound,
        D21=D[p:, :q] * scale_w / bound,
        z0=z0 / scale_z.T,
        e=(recorded.y - y0) / recorded.bound,
        starts=recorded.starts,
        at_rest=recorded.at_rest,
        free=observable_directions(A, np.vstack([C[p:] / bound, *constant])),
        blocks=tuple((*at, not (b.is_ball or b.interval)) for b, at in zip(blocks, slices, strict=True)),
        names=tuple(b.name for b in blocks),
        scale=np.array(scales),
    )


def zero_order_hold(M: StateSpaceModel, dt: float) -> tuple[Array, Array]:
    if M.dt:
        return M.A, M.B
    A, B, _ = transition(M, dt)
    if not (np.isfinite(A).all() and np.isfinite(B).all()):
        raise NoTrustworthyNumber("validate", f"the model cannot be sampled at {dt:g} s: its exponential overflows")
    return A, B


def at_nominal(uncertain: UncertainModel) -> tuple[StateSpaceModel, tuple[Block, ...]]:
    """Remove the channels of the real blocks from M, and return the other blocks."""
    M, (q, p) = uncertain.M, uncertain.delta_shape
    kept = [(b, at) for b, at in zip(uncertain.blocks, block_slices(uncertain.blocks), strict=True) if not b.interval]
    inputs = [*(name for _, (rows, _) in kept for name in M.input_names[rows]), *M.input_names[q:]]
    outputs = [*(name for _, (_, cols) in kept for name in M.output_names[cols]), *M.output_names[p:]]
    return M.select(inputs, outputs), tuple(b for b, _ in kept)


def observable_directions(A: Array, C: Array) -> Array:
    """Return an orthonormal basis of the observable state directions: the row space of the observability matrix."""
    if not len(A):
        return np.zeros((0, 0))
    found = [C]
    for _ in range(1, len(A)):
        rows = found[-1] @ A
        found.append(rows / (np.linalg.norm(rows, axis=1, keepdims=True) + 1e-300))
    stacked = np.vstack(found)
    stacked /= np.maximum(np.linalg.norm(stacked, axis=1, keepdims=True), 1e-300)
    _, sigma, right = np.linalg.svd(stacked)
    rank = int((sigma > OBSERVABLE * sigma[0]).sum()) if sigma[0] > 0 else 0
    return right[:rank].T


def noise_bounds(noise: Mapping[str, ArrayLike], names: tuple[str, ...], where: str) -> Array:
    """Return noise bounds (n_y,) in the order of ``names``; a bound of zero is a singular noise model."""
    for name in noise:
        if name not in names:
            raise unknown_name(f"{where}: noise of {name!r}", "no such compared output", name, names)
    found = []
    for name in names:
        if name not in noise:
            hint = f"noise={{{name!r}: ...}} in its unit: the error bound of the sensor"
            raise InputError(f"{where}: output {name!r}", "has no noise bound", "one for each compared output", hint)
        found.append(number(f"{where}: noise of {name!r}", noise[name], "a positive number", at_least=0))
        if not found[-1]:
            text = "singular noise model: with a bound of 0 the last digit of a sample would decide"
            hint = "at least the resolution of the sensor"
            raise NoTrustworthyNumber(f"{where}: noise of {name!r}", text, "a positive bound", hint)
    return np.array(found)


def states(A: Array, drive: Array, first: Array) -> Array:
    """Simulate ``x_{t+1} = A x_t + drive_t`` from ``x_0 = first``, shape (n, n_x); the last drive is not used."""
    return recursion(A[None], drive[None, :-1], first)[0]


# --- cone programmes of both domains ----------------------------------------------------------------------------------


@cache
def sparse_matrices() -> Any:
    """Import scipy.sparse untyped: its types take a minute to infer."""
    return import_module("scipy.sparse")


class Rows(NamedTuple):
    """Rows ``offset - matrix x`` in cones of one kind: zero, nonnegative, or ``|(s_2 .. s_height)| <= s_1``.

    Several second-order cones are stored with the first rows of all first, then the second rows of all, and so on.
    """

    matrix: Any
    offset: Array
    cone: Literal["zero", "positive", "second-order"]
    height: int = 1
    label: tuple[str, int] | None = None


@dataclass(frozen=True)
class Multipliers:
    """Nonnegative multipliers of a certificate: D (n, blocks) of the energies, and noise (n, n_y)."""

    D: Array
    noise: Array


@dataclass(frozen=True)
class Found:
    """Bounds of gamma with the explanation of the record, in the scaled signals of its problem."""

    lower: float
    upper: float  # inf if nothing explains the record
    # noise, excess: remaining noise (n, n_y), and its largest part over the bound; without an explanation the smallest
    noise: Array
    excess: float
    multipliers: Multipliers | None = None  # of the lower bound
    label: str = ""
    certified: bool = True
    values: Mapping[str, float] = field(default_factory=dict)  # of the constants
    problem: Any = None  # of the dynamic blocks, with their signals and the jumps of the states:
    w: Any = field(default_factory=lambda: np.zeros((0, 0)))
    z: Any = field(default_factory=lambda: np.zeros((0, 0)))
    states: Mapping[int, Array] = field(default_factory=dict)


class Search(NamedTuple):
    """Required relative width of the bounds, and the work budget."""

    precision: float
    budget: Budget


@dataclass(frozen=True)
class ConeSolution:
    """The point x, and the multipliers (height, cones) of each labelled part of the rows."""

    x: Array
    dual: dict[tuple[str, int], Array]


def solved_cones(cost: Array, rows: Sequence[Rows], budget: Budget) -> ConeSolution | None:
    """Minimise ``cost x`` over all x whose rows are in their cones; None if infeasible."""
    # The accuracy reported by the solver is not used: only the replay and the certificate of an answer count.
    matrices, offsets, turns = [], [], []
    cones: list[Cone] = []
    for part in rows:
        turn = np.arange(part.matrix.shape[0]).reshape(part.height, -1).T
        matrices.append(part.matrix.tocsr()[turn.ravel()])
        offsets.append(part.offset[turn.ravel()])
        turns.append(turn)
        several = part.height > 1
        whole: Cone = (part.cone, part.height if several else len(turn))
        cones += [whole] * (len(turn) if several else 1)
    A = sparse_matrices().vstack(matrices).tocsc()
    each = 50 + ITERATION_WORK * A.nnz
    most = min(max(budget.left / each, FEWEST_ITERATIONS), MOST_ITERATIONS)
    seconds = max(budget.seconds_left, 1.0) if budget.seconds_left < 1e6 else None
    found = solve(cost, A, np.concatenate(offsets), cones, steps=most, seconds=seconds)
    if found is None:
        raise NoTrustworthyNumber("validate", "the solver failed")
    budget.spend(200 + BUILDING_WORK * A.nnz + found.iterations * each)
    status = str(found.status)
    if status == "MaxTime":
        budget.strike()
    if status in INFEASIBLE:
        return None
    x, dual = np.array(found.x), np.array(found.z)
    if not (np.isfinite(x).all() and np.isfinite(dual).all()):
        raise NoTrustworthyNumber("validate", f"the solver gave no answer ({status})")
    parts = np.split(dual, np.cumsum([turn.size for turn in turns])[:-1])
    labelled = [(r.label, part.reshape(t.shape).T) for r, t, part in zip(rows, turns, parts, strict=True)]
    return ConeSolution(x, {label: part for label, part in labelled if label is not None})


def largest_disproved(disproved: Callable[[float], bool], start: float, finest: float) -> float:
    """Find the largest gamma below ``start`` that is disproved, to the relative width ``finest``; 0 for none."""
    # A certificate that disproves a gamma disproves every smaller one: begin close to the start, then halve.
    high, share = start, finest
    while not disproved(good := start * (1 - min(share, 1.0))):
        if share >= 1:
            return 0.0
        high, share = good, 2 * share
    for _ in range(HALVINGS):
        if high - good <= finest * high:
            break
        middle = 0.5 * (good + high)
        good, high = (middle, high) if disproved(middle) else (good, middle)
    return good
