"""Stability, gain and margins of models with exact delays, proved for a set that contains them.

In each set a delay is e^(-s tau) = R(s) + W(s) Delta(s), |Delta| <= 1 in the right half plane: Padé's approximation
with a proved weight of its error, or, of order 0, R = 0, W = 1. Where mu < 1 on the axis, its end included, no root
crosses while the block grows from 0 to Delta, and none comes from infinity: the model has as many roots right of the
axis as the set's nominal one. With one more block, one over a level in size, its gain is below that level: Zhou, Doyle,
Glover (1996), theorems 11.8, 11.9.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from robustlab import checks
from robustlab.arrays import Array, ComplexArray
from robustlab.budget import one_thread, search_budget
from robustlab.delays.model import DelayedModel, as_delayed
from robustlab.display import Facts, number
from robustlab.errors import NoTrustworthyNumber, error_context
from robustlab.linear_analysis.frequency import default_grid, frequency_response
from robustlab.mu_analysis.axis.intervals import Piece, continuous, cover_parts, seed_frequencies
from robustlab.mu_analysis.axis.margin import StabilityMargin
from robustlab.mu_analysis.margins.classical import ClassicalMargin, ClassicalMargins, GainCrossing, PhaseCrossing
from robustlab.mu_analysis.margins.disk_margin import (
    DiskMargin,
    DiskMargins,
    Opened,
    Place,
    disk_channels,
    opened_at,
    with_factors,
)
from robustlab.mu_analysis.matrix.bounds import mu
from robustlab.mu_analysis.matrix.upper import WORK, compile_kernels, upper_bounds
from robustlab.norms import PeakGain, unstable_norm
from robustlab.result import Status
from robustlab.statespace import StateSpaceModel
from robustlab.uncertainty.blocks import Block, ComplexScalar, FullBlock, delta_values
from robustlab.uncertainty.lft import UncertainModel

ORDERS = (0, 2, 4, 6, 8, 12, 16)  # of the approximations that are tried one after the other
STEEPER = 3  # slope of the weights minus the order: with order 6 the error is 1e-4 up to w tau = 5
BELOW, ACCURACY = 1.0 - 2e-5, 1e-5  # first level of mu, and the accuracy of the scalings
SHARE_OF_WORK = 0.1  # of the usual search: a set that needs more is too large to decide
LEVELS = (1.001, 1.01, 1.1, 2.0, 10.0)  # of a bound over the attained value; all orders are tried for the first one
TOLERANCE = 0.01  # of a certified bracket
POINTS, PEAKS = 4000, 4  # of the search for the highest gain
MU_POINTS = 200  # of that for the largest mu
TINY = 1e-100
# Of the search for crossings: phase of all delays between points, their largest number, points of each first grid, and
# about each pole.
TURN, MOST, COARSE, CIRCLE = 0.05, 200_000, 1000, 200
LEAST, LARGEST = 1e-6, 1e3  # factors of gain beyond these are not computed
TOUCHED = 1e-9  # a function this near to zero at an extreme touches it


class DelayProof(NamedTuple):
    """The order of the set, and the intervals of the axis with the scalings that keep its mu below one."""

    order: int
    pieces: tuple[Piece, ...]


def covering_set(model: DelayedModel, order: int, blocks: Sequence[Block] = (), level: float = 1.0) -> UncertainModel:
    """Return the set of this order; with blocks of sizes up to one over ``level`` at the model's own channels."""
    held = model.uncertain(order, weight_order=min(order + STEEPER, 2 * order + 1)) if order else model.as_set()
    M, q = held.M, sum(b.rows for b in held.blocks)
    by = np.where(np.arange(M.n_inputs) < q, 1.0, 1.0 / level)
    scaled = StateSpaceModel(M.A, M.B * by, M.C, M.D * by, 0.0, M.inputs, M.outputs, M.states)
    return UncertainModel(scaled, [*held.blocks, *blocks])


def proof_below(
    model: DelayedModel, order: int, blocks: Sequence[Block] = (), level: float = 1.0, effort: float = 1.0
) -> DelayProof | None:
    """Prove mu < 1 of `covering_set`."""
    compile_kernels()
    closed = covering_set(model, order, blocks, level)
    budget = search_budget("delayed model", SHARE_OF_WORK * WORK, effort, None)
    try:
        with one_thread():
            M = continuous(closed.delta_channels)
            cover = cover_parts(M, closed.blocks, BELOW, first=seed_frequencies(M), budget=budget, accuracy=ACCURACY)
    except NoTrustworthyNumber:  # a pole of the nominal model on the axis
        return None
    return None if cover.open or cover.beta >= 1.0 else DelayProof(order, tuple(cover.pieces))


@dataclass(frozen=True, eq=False)
class DelayStability(StabilityMargin):
    """Stability of a model with exact delays, with its evidence.

    Nothing is uncertain: both bounds are inf where the model is stable, 0 where it is not, 0 and inf where neither was
    shown. CERTIFIED: proved on the whole frequency axis, in floating point. INCONCLUSIVE: not decided up to the highest
    order.
    """

    order: int  # of Padé's approximations in the set of the proof, or the last one tried; 0: it holds for all delays
    # The rightmost pole of that set's nominal model, in 1/s: near a root of the model where the order is not 0; or the
    # unstable pole of a part without delays in its loops.
    root: complex | None
    proof: DelayProof | None = None
    system: DelayedModel | None = None

    unsaved: ClassVar[tuple[str, ...]] = ("system", "proof")
    derived: ClassVar[tuple[str, ...]] = ("stable",)

    @classmethod
    def of(cls, stable: bool | None, *evidence: Any) -> DelayStability:
        """Return the verdict with its evidence: the fields from ``order`` on."""
        lower, upper = {True: (np.inf, np.inf), False: (0.0, 0.0), None: (0.0, np.inf)}[stable]
        status = Status.INCONCLUSIVE if stable is None else Status.CERTIFIED
        return cls(lower, upper, None, status, {}, (), *evidence)

    def headline(self) -> str:
        return {True: "proved stable", False: "proved unstable", None: "not proved stable"}[self.stable]

    def facts(self) -> Facts:
        verdict = {True: "yes: proved on the whole axis", False: "no: proved", None: "undecided"}[self.stable]
        return [("stable", verdict), ("order of the set", str(self.order)), ("pole", number(self.root, "1/s"))]


@error_context("delay_stability")
def delay_stability(model: DelayedModel, effort: float = 1.0) -> DelayStability:
    """`robustlab.robust_stability` of a model with exact delays, by sets of rising order."""
    g = as_delayed(model, "delay_stability")
    checks.number("delay_stability: effort", effort, "a positive finite number", above=0)
    if (pole := _undelayed_pole(g)) is not None:
        return DelayStability.of(False, 0, pole)
    order, root = 0, None
    for order in _orders(g):
        nominal = covering_set(g, order).M
        poles = nominal.poles()
        root = complex(poles[poles.real.argmax()]) if len(poles) else None
        known = nominal.is_stable() or (root is not None and root.real > 0 and _surely_unstable(nominal))
        if known and (proof := proof_below(g, order, effort=effort)) is not None:
            return DelayStability.of(nominal.is_stable(), order, root, proof, g)
    return DelayStability.of(None, order, root, None, g)


def _orders(g: DelayedModel, least: int = 0) -> list[int]:
    """Return the orders that are tried; only 0 without delays."""
    return [n for n in ORDERS if n >= least] if len(g.delays) else [0]


def _surely_unstable(model: StateSpaceModel) -> bool:
    norm = unstable_norm(model)
    return norm is not None and norm.status is Status.CERTIFIED


def _undelayed_pole(g: DelayedModel) -> complex | None:
    """Return a pole on or right of the axis of a part of the model whose loops hold no delay; None if there is none."""
    # A strongly connected component of the graph of states and delays: its eigenvalues are poles for all delays.
    from scipy.sparse.csgraph import connected_components

    h, n, k = g.H, g.H.n_states, len(g.delays)
    whole = np.block([[h.A, h.B[:, :k]], [h.C[:k], h.D[:k, :k]]])
    labels = connected_components(whole != 0, connection="strong")[1]
    for label in set(labels[:n]) - set(labels[n:]):
        part = np.flatnonzero(labels[:n] == label)
        A = h.A[part][:, part]
        if _surely_unstable(StateSpaceModel(A, np.zeros((len(A), 1)), np.zeros((1, len(A))), [[0.0]])):
            poles = np.linalg.eigvals(A)
            return complex(poles[poles.real.argmax()])
    return None


# --- gain -------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class DelayGain(PeakGain):
    """Bounds of the largest gain over frequency of a model with exact delays.

    ``lower`` is the exact gain at ``frequency``; ``upper`` is proved on the whole axis. CERTIFIED where the bounds are
    within the tolerance, INACCURATE where they are not, INCONCLUSIVE without an upper one.
    """

    frequency: float
    unstable: ClassVar[str] = "infinite: the model is not stable"

    stability: DelayStability  # without it no gain is proved
    system: DelayedModel | None = None
    proof: DelayProof | None = None

    unsaved: ClassVar[tuple[str, ...]] = ("system", "proof")

    def evidence(self) -> Facts:
        facts = self.stability.facts()
        return [facts[0], *(facts[2:] if self.stability.stable is False else [])]


@error_context("delay_gain")
def delay_gain(model: DelayedModel, effort: float = 1.0) -> DelayGain:
    """`robustlab.peak_gain` of a model with exact delays."""
    g = as_delayed(model, "delay_gain")
    known = delay_stability(g, effort)
    if known.stable is False:
        return DelayGain(np.inf, np.inf, np.nan, Status.CERTIFIED, known)
    lower, frequency = highest(g, lambda response: np.linalg.svd(response, compute_uv=False).max(axis=1, initial=0.0))
    upper, proof = np.inf, None
    if known.stable:
        block = FullBlock("performance", g.n_inputs, g.n_outputs)
        upper, proof = proved_level(g, [block], lower or TINY, effort, known.order)
    close = upper <= (1.0 + TOLERANCE) * (lower or TINY)
    status = Status.CERTIFIED if close else Status.INACCURATE if proof else Status.INCONCLUSIVE
    return DelayGain(lower, upper, frequency, status, known, g, proof)


def proved_level(
    g: DelayedModel, blocks: Sequence[Block], lower: float, effort: float, order: int
) -> tuple[float, DelayProof | None]:
    """Return the lowest level that is proved of the blocks at the channels of a stable model, from orders on."""
    orders = _orders(g, order)
    ends = dict.fromkeys((orders[0], orders[-1]))
    for n, share in [(n, LEVELS[0]) for n in orders] + [(n, share) for share in LEVELS[1:] for n in ends]:
        if (proof := proof_below(g, n, blocks, share * lower, effort)) is not None:
            return share * lower, proof
    return np.inf, None


def highest(g: DelayedModel, size: Any, points: int = POINTS) -> tuple[float, float]:
    """Find the largest size of the exact responses, and its frequency: on a grid, then about its highest peaks."""
    from scipy.optimize import minimize_scalar

    grid = np.concatenate([[0.0], default_grid(g.pade(4), points)])
    if len(g.delays):  # echoes repeat with the period of the delay factors
        grid = np.union1d(grid, np.linspace(0.0, 40.0, points) / g.delays.max())
    sizes: Array = size(frequency_response(g, grid))
    inner = np.flatnonzero((sizes[1:-1] >= sizes[:-2]) & (sizes[1:-1] >= sizes[2:])) + 1
    found = [(float(sizes.max()), float(grid[np.argmax(sizes)]))]
    for k in inner[np.argsort(-sizes[inner])][:PEAKS]:
        ends = float(grid[k - 1]), float(grid[k + 1])
        near: Any = minimize_scalar(lambda w: -size(frequency_response(g, [w]))[0], bounds=ends, method="bounded")
        found.append((-float(near.fun), float(near.x)))
    return max(found)


# --- margins of loops -------------------------------------------------------------------------------------------------


@error_context("delay_disk_margins")
@one_thread()
def delay_disk_margins(
    plant: Any,
    K: Any = None,
    *,
    at: Place = "output",
    skew: float = 0.0,
    sign: Literal[-1, 1] | None = None,
    seed: int = 0,
    effort: float = 1.0,
) -> DiskMargins:
    """`robustlab.disk_margin` of a loop with exact delays."""
    where = "delay_disk_margins"
    opened = opened_at(plant, K, at, sign, where, as_delayed, skew)
    loop, known = _closed(opened, skew, effort, where)
    if not known.stable:
        raise NoTrustworthyNumber(where, "the closed loop is unstable", "a stable one")

    def bounds(system: DelayedModel, names: Sequence[str]) -> DiskMargin:
        """Return the peak of mu with its Delta, and a proof."""
        blocks = [ComplexScalar(name) for name in names]
        if len(names) == 1:
            _, frequency = highest(system, lambda M: np.abs(M[:, 0, 0]))
        else:
            _, frequency = highest(
                system, lambda M: np.array([b.beta for b in upper_bounds(M, blocks, 1e-3)]), MU_POINTS
            )
        found = mu(frequency_response(system, [frequency]), blocks, seed)
        value = float(found.lower[0])
        upper, proof = proved_level(system, blocks, value or TINY, effort, known.order)
        delta = delta_values(blocks, found.delta[0]) if value else {}
        status = Status.CERTIFIED if upper <= value * (1.0 + TOLERANCE) else Status.INACCURATE
        ends = 1.0 / upper, 1.0 / value if value else np.inf
        return with_factors(ends, frequency, status, system, delta, skew, proof)

    return DiskMargins.of(opened, loop, bounds)


def _closed(opened: Opened, skew: float, effort: float, where: str) -> tuple[DelayedModel, DelayStability]:
    """Return the closed loop at the channels of its disks, and its stability."""
    loop = disk_channels(opened, skew)
    known = delay_stability(loop, effort)
    if known.stable is None:
        text = f"no set up to order {ORDERS[-1]} shows whether the closed loop is stable"
        raise NoTrustworthyNumber(where, text, None, "rl.robust_stability(loop, effort=...) may")
    return loop, known


@error_context("delay_classical_margins")
@one_thread()
def delay_classical_margins(
    plant: Any, K: Any = None, *, at: Place = "output", sign: Literal[-1, 1] | None = None
) -> ClassicalMargins:
    """`robustlab.classical_margins` of a loop with exact delays."""
    where = "delay_classical_margins"
    opened = opened_at(plant, K, at, sign, where, as_delayed)
    S, known = _closed(opened, 1.0, 1.0, where)
    channels = {name: _classical(S[i, i], known.stable is True, name) for i, name in enumerate(opened.names)}
    return ClassicalMargins(channels, at, Status.CONVERGED, opened.said)


# With S = 1 / (1 + L) of the loop that is opened, the others closed: |L| = 1 where Re S = 1/2, L < 0 where Im S = 0
# and S is not in [0, 1]; S has no pole on the axis. Zeros are where signs change between points that are close enough
# for the poles of L and S and for the delays.


def _classical(S: DelayedModel, stable: bool, name: str) -> ClassicalMargin:
    """Return both types of crossings of one loop, and its margins."""

    def response(omega: ArrayLike) -> ComplexArray:
        return frequency_response(S, omega)[:, 0, 0]

    near = [model.pade(4) for model in (S, S.inverse())]
    poles = np.concatenate([model.poles() for model in near])
    # About a light pole the response is a circle in the tangent of the distance over the damping.
    light = poles[np.abs(poles.real) < 0.3 * np.abs(poles)]
    width = np.maximum(np.abs(light.real), 1e-12 * np.abs(light))
    around = (np.abs(light.imag) + np.outer(np.tan(np.linspace(-1.57, 1.57, CIRCLE)), width)).ravel()
    coarse = np.unique(np.concatenate([*(default_grid(model, COARSE, 4.0) for model in near), around[around > 0]]))
    with np.errstate(divide="ignore", invalid="ignore"):
        size = np.abs(1.0 / response(coarse) - 1.0)
    step, most = TURN / max(float(S.delays.sum()), TINY), 2.0
    while True:  # until no frequency beyond can bound the gain margin
        end = min(float(coarse[size > 0.5 / most].max(initial=coarse[0])), MOST * step)
        omega = np.union1d(coarse[coarse <= end], np.arange(step, end, step))
        values = response(omega)
        real_at = (0.0, *_zeros(lambda w: response(w).imag, omega, values.imag))
        points = [(w, float(response([w])[0].real)) for w in real_at]
        crossings = [PhaseCrossing(w, s / (s - 1.0)) for w, s in points if s < -LEAST or s > 1.0 + 0.5 / LARGEST]
        high = min((c.factor for c in crossings if c.factor >= 1), default=LARGEST)
        if most >= high:
            break
        most = min(4.0 * most, high)
    if size[coarse > end].max(initial=size[-1]) * high > 1.0:
        found = f"loop {name}: its gain at high frequencies does not fall below {1 / high:.3g}"
        hint = "a loop with a direct path through a delay: take rl.disk_margin of it"
        raise NoTrustworthyNumber("delay_classical_margins", found, "a loop whose gain falls", hint)
    one_at = _zeros(lambda w: response(w).real - 0.5, omega, values.real - 0.5)
    gain = [GainCrossing.at(w, float(np.angle(1.0 / response([w])[0] - 1.0)) + math.pi) for w in one_at]
    kept = [c for c in crossings if c.factor <= high * (1 + 1e-9)]
    return ClassicalMargin.of(stable, gain, kept, most=LARGEST)


def _zeros(f: Callable[[ArrayLike], Array], omega: Array, values: Array) -> list[float]:
    """Return the zeros of a function where its sign changes between points, and where an extreme touches zero."""
    from scipy.optimize import brentq, minimize_scalar

    above, found = values >= 0, list[float]()
    before, here, after = (np.where(above, values, -values)[k : len(omega) - 2 + k] for k in range(3))
    level = (above[:-2] == above[1:-1]) & (above[1:-1] == above[2:])
    near = level & (here < before) & (here <= after) & (2.0 * here <= np.maximum(before, after))  # it may reach zero
    for k in np.flatnonzero(near) + 1:
        way, bounds, fine = 1.0 if above[k] else -1.0, (omega[k - 1], omega[k + 1]), {"xatol": 1e-12 * omega[k]}
        least: Any = minimize_scalar(lambda w: way * f([w])[0], bounds=bounds, method="bounded", options=fine)  # noqa: B023
        omega, values = np.append(omega, least.x), np.append(values, way * least.fun)
        found += [float(least.x)] if 0 <= least.fun < TOUCHED else []
    order = np.argsort(omega)
    omega, above = omega[order], values[order] >= 0
    solve: Any = brentq
    for k in np.flatnonzero(above[1:] != above[:-1]):
        low, high = omega[k], omega[k + 1]
        found.append(float(solve(lambda w: f([w])[0], low, high, xtol=1e-14 * high, rtol=1e-14)))
    return sorted(found)
