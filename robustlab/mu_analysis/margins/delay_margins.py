"""Stability and gain of models with exact delays, proved for a set that contains them."""

# In each set a delay is e^(-s tau) = R(s) + W(s) Delta(s), |Delta| <= 1 in the right half plane: Padé's approximation
# with a proved weight of its error, or, of order 0, R = 0, W = 1. Where mu < 1 on the axis, its
# end included, no root crosses while the block grows from 0 to Delta, and none comes from infinity: the model has as
# many roots right of the axis as the set's nominal one. With one more block, one over a level in size, its gain is
# below that level. Zhou, Doyle, Glover (1996), theorems 11.8, 11.9.

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np

from robustlab import checks
from robustlab.arrays import Array
from robustlab.budget import one_thread, search_budget
from robustlab.delays.model import DelayedModel, as_delayed
from robustlab.display import Facts, number
from robustlab.errors import InputError, NoTrustworthyNumber, error_context
from robustlab.linear_analysis.frequency import default_grid, frequency_response
from robustlab.mu_analysis.axis.axis_model import continuous, seed_frequencies
from robustlab.mu_analysis.axis.intervals import Piece, cover_parts
from robustlab.mu_analysis.axis.margin import StabilityMargin
from robustlab.mu_analysis.constants import WORK
from robustlab.mu_analysis.matrix.upper import compile_kernels
from robustlab.norms import PeakGain, unstable_norm
from robustlab.result import Status
from robustlab.statespace import StateSpaceModel
from robustlab.uncertainty.blocks import Block, FullBlock
from robustlab.uncertainty.lft import UncertainModel

__all__ = ["FINEST", "DelayGain", "DelayProof", "DelayStability", "delay_gain", "delay_stability", "proof_below"]

FINEST = 1e-6  # smallest tolerance
ORDERS = (0, 2, 4, 6, 8, 12, 16)  # of the approximations that are tried one after the other
STEEPER = 3  # slope of the weights minus the order: with order 6 the error is 1e-4 up to w tau = 5
BELOW, ACCURACY = 1.0 - 2e-5, 1e-5  # first level of mu, and the accuracy of the scalings
LEAST_GAP = 1e-4  # between the bounds of a gain
SHARE_OF_WORK = 0.1  # of the usual search: a set that needs more is too large to decide
SHARE = 0.1  # target gap of a bound, relative to the tolerance
WIDER = (1.001, 1.005, 1.01, 1.1, 2.0, 10.0)  # levels that are tried where no order proves the target
POINTS, PEAKS = 4000, 4
TINY = 1e-100


class DelayProof(NamedTuple):
    """The order of the set, and the intervals of the axis with the scalings that keep its mu below one."""

    order: int
    pieces: tuple[Piece, ...]


def covering_set(model: DelayedModel, order: int, blocks: Sequence[Block] = (), level: float = 1.0) -> UncertainModel:
    """Return the set of this order; with blocks of sizes up to one over ``level`` at the model's own channels."""
    held = model.uncertain(order, weight_order=min(order + STEEPER, 2 * order + 1)) if order else model.as_set()
    M, q = held.M, sum(b.rows for b in held.blocks)
    scale = np.ones(M.n_inputs)
    scale[q:] = 1.0 / level
    return UncertainModel(
        StateSpaceModel(M.A, M.B * scale, M.C, M.D * scale, 0.0, M.inputs, M.outputs, M.states),
        [*held.blocks, *blocks],
    )


def proof_below(
    model: DelayedModel, order: int, blocks: Sequence[Block] = (), level: float = 1.0, effort: float = 1.0
) -> DelayProof | None:
    """Prove mu < 1 of the set of this order, with blocks of sizes up to one over ``level`` at the model's channels."""
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
    """Whether a model with exact delays is stable, and the evidence.

    Attributes
    ----------
    lower, upper
        Nothing is uncertain: both inf where the model is stable, both 0 where it is not, 0 and inf where neither could
        be shown.
    status
        CERTIFIED: proved on the whole frequency axis, in floating point. INCONCLUSIVE: not decided up to the highest
        order.
    order
        Order of Padé's approximations in the set of the proof, or the last one that was tried; 0 where the result holds
        for all delays.
    root
        The rightmost pole of that set's nominal model, in 1/s: near a root of the model where the order is not 0; or
        the unstable pole of a part without delays in its loops.
    system, proof
        The model and the scalings, for `robustlab.verify`.
    """

    order: int
    root: complex | None
    proof: DelayProof | None = None
    system: DelayedModel | None = None

    unsaved: ClassVar[tuple[str, ...]] = ("system", "proof")

    @classmethod
    def of(cls, stable: bool | None, *evidence: Any) -> DelayStability:
        """Return the verdict with its evidence: the fields from ``order`` on."""
        lower, upper = {True: (np.inf, np.inf), False: (0.0, 0.0), None: (0.0, np.inf)}[stable]
        status = Status.INCONCLUSIVE if stable is None else Status.CERTIFIED
        return cls(lower, upper, None, status, {}, (), *evidence)

    @property
    def stable(self) -> bool | None:
        """True, False, or None where neither could be shown."""
        return True if self.lower > 0 else False if self.upper == 0 else None

    def headline(self) -> str:
        return {True: "proved stable", False: "proved unstable", None: "not proved stable"}[self.stable]

    def facts(self) -> Facts:
        verdict = {True: "yes: proved on the whole axis", False: "no: proved", None: "undecided"}[self.stable]
        return [("stable", verdict), ("order of the set", str(self.order)), ("pole", number(self.root, "1/s"))]

    def to_json(self) -> dict[str, object]:
        kept = {name: x for name, x in vars(self).items() if name not in self.unsaved}
        return {"type": "DelayStability", "stable": self.stable, **kept}


@error_context("delay_stability")
def delay_stability(model: DelayedModel, highest_order: int = 16, effort: float = 1.0) -> DelayStability:
    """`robustlab.robust_stability` of a model with exact delays, by sets of rising order."""
    g = as_delayed(model, "delay_stability")
    if isinstance(highest_order, bool) or not isinstance(highest_order, int) or not 1 <= highest_order <= ORDERS[-1]:
        raise InputError("delay_stability: highest_order", f"{highest_order!r}", f"a number from 1 to {ORDERS[-1]}")
    checks.number("delay_stability: effort", effort, "a positive finite number", above=0)
    if (pole := _undelayed_pole(g)) is not None:
        return DelayStability.of(False, 0, pole)
    order, root = 0, None
    for order in _orders(g, 0, highest_order):
        nominal = covering_set(g, order).M
        poles = nominal.poles()
        root = complex(poles[poles.real.argmax()]) if len(poles) else None
        norm = unstable_norm(nominal) if root is not None and root.real > 0 else None
        known = nominal.is_stable() or (norm is not None and norm.status is Status.CERTIFIED)
        if known and (proof := proof_below(g, order, effort=effort)) is not None:
            return DelayStability.of(nominal.is_stable(), order, root, proof, g)
    return DelayStability.of(None, order, root, None, g)


def _orders(g: DelayedModel, least: int, highest: int) -> list[int]:
    """Return the orders that are tried; only 0 without delays."""
    return [n for n in ORDERS if least <= n <= max(highest, least)] if len(g.delays) else [0]


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
        norm = unstable_norm(StateSpaceModel(A, np.zeros((len(A), 1)), np.zeros((1, len(A))), [[0.0]]))
        if norm is not None and norm.status is Status.CERTIFIED:
            poles = np.linalg.eigvals(A)
            return complex(poles[poles.real.argmax()])
    return None


# --- gain ------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class DelayGain(PeakGain):
    """Bounds of the largest gain over frequency of a model with exact delays.

    Attributes
    ----------
    lower, upper
        ``lower <= gain <= upper``: the exact gain at ``frequency``, and a bound that is proved on the whole axis; inf
        where none was. Both inf where the model is proved not to be stable.
    frequency
        In rad/s.
    stability
        Stability of the model, without which no gain is proved.
    status
        CERTIFIED where the bounds are within the tolerance, INACCURATE where they are not, INCONCLUSIVE without an
        upper one.
    system, proof
        The model and the scalings, for `robustlab.verify`.
    """

    frequency: float
    unstable: ClassVar[str] = "infinite: the model is not stable"

    stability: DelayStability
    system: DelayedModel | None = None
    proof: DelayProof | None = None

    unsaved: ClassVar[tuple[str, ...]] = ("system", "proof")

    def evidence(self) -> Facts:
        """Stability of the model, and an unstable pole."""
        facts = self.stability.facts()
        return [facts[0], *(facts[2:] if self.stability.stable is False else [])]


@error_context("delay_gain")
def delay_gain(
    model: DelayedModel,
    tolerance: float = 0.01,
    highest_order: int = 16,
    effort: float = 1.0,
    known: DelayStability | None = None,
) -> DelayGain:
    """`robustlab.peak_gain` of a model with exact delays, or of one without; its stability may be known."""
    g = as_delayed(model, "delay_gain")
    if not FINEST <= tolerance < 1:
        raise InputError("delay_gain: tolerance", f"{tolerance!r}", f"a number from {FINEST:g} to 1")
    known = delay_stability(g, highest_order, effort) if known is None else known
    if known.stable is False:
        return DelayGain(np.inf, np.inf, np.nan, Status.CERTIFIED, known)
    lower, frequency = highest(g, lambda response: np.linalg.svd(response, compute_uv=False).max(axis=1, initial=0.0))
    if not known.stable:
        return DelayGain(lower, np.inf, frequency, Status.INCONCLUSIVE, known)
    size = lower or TINY  # without a path from an input to an output, any level can be proved
    block = FullBlock("performance", g.n_inputs, g.n_outputs)
    upper, proof = proved_level(g, [block], size, tolerance, highest_order, effort, known.order)
    near = upper <= (1.0 + tolerance) * size
    status = Status.CERTIFIED if near else Status.INACCURATE if proof else Status.INCONCLUSIVE
    return DelayGain(lower, upper, frequency, status, known, g, proof)


def proved_level(
    g: DelayedModel,
    blocks: Sequence[Block],
    lower: float,
    tolerance: float,
    highest_order: int,
    effort: float,
    order: int,
) -> tuple[float, DelayProof | None]:
    """Return the lowest level that is proved of the blocks at the channels of a stable model, from orders on."""
    orders, gap = _orders(g, order, highest_order), max(SHARE * tolerance, LEAST_GAP)
    ends = dict.fromkeys((orders[0], orders[-1]))
    tried = [(n, 1.0 + gap) for n in orders] + [(n, share) for share in WIDER if share > 1.0 + gap for n in ends]
    for n, share in tried:
        if (proof := proof_below(g, n, blocks, share * lower, effort)) is not None:
            return share * lower, proof
    return np.inf, None


def highest(g: DelayedModel, size: Any, points: int = POINTS) -> tuple[float, float]:
    """Find the largest size of the exact responses, and its frequency: on a grid, then about its highest peaks."""
    from scipy.optimize import minimize_scalar

    grid = np.concatenate([[0.0], default_grid(g.pade(4), points)])
    if len(g.delays):  # echoes repeat with the period of the delay factors
        turns = np.linspace(0.0, 40.0, points) / g.delays.max()
        grid = np.unique(np.concatenate([grid, turns]))
    sizes: Array = size(frequency_response(g, grid))
    inner = np.flatnonzero((sizes[1:-1] >= sizes[:-2]) & (sizes[1:-1] >= sizes[2:])) + 1
    found = [(float(sizes.max()), float(grid[np.argmax(sizes)]))]
    for k in inner[np.argsort(-sizes[inner])][:PEAKS]:
        ends = float(grid[k - 1]), float(grid[k + 1])
        near: Any = minimize_scalar(lambda w: -size(frequency_response(g, [w]))[0], bounds=ends, method="bounded")
        found.append((-float(near.fun), float(near.x)))
    return max(found)
