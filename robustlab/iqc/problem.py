r"""The analysis problem of a set with natures: lower bounds by members, upper bounds by inequalities.

Every range is first centred, so that the class of each block contains zero. A `Problem` makes one inequality for each
basis of filters and each size of the set, in balanced states and channels.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any, NamedTuple

import numpy as np

from robustlab.arrays import Array
from robustlab.budget import MILLION, Budget, search_budget
from robustlab.checks import number, whole
from robustlab.display import listed
from robustlab.errors import InputError, NoTrustworthyNumber, did_you_mean
from robustlab.iqc.block_types import Nature, Nonlinearity, Varying
from robustlab.iqc.inequality import Inequality, Point
from robustlab.iqc.multipliers import Filtered, Form, filter_order, law, linear
from robustlab.norms import balancing_units, hinf_norm
from robustlab.result import Evidence
from robustlab.statespace import StateSpaceModel, as_model
from robustlab.uncertainty.blocks import Block, RealScalar, block_slices
from robustlab.uncertainty.lft import UncertainModel, recentred
from robustlab.verification.checker import check
from robustlab.verification.claim import Claim, Outcome

WORK = 60 * MILLION  # the usual work of a proof at effort 1
POLES = (1.0, 4.0, 0.25)  # of the multipliers, relative to the model's typical speed
BALANCINGS = 4  # minimisations of the gain at most, each in states scaled by the last P
BETTER = 0.98  # and while the gain falls below this share of the last one
BACK_OFFS = (1e-5, 1e-4, 1e-3, 1e-2, 5e-2, 0.2)  # relative increases of the least gain that are tried for a proof
MEMBERS = 64  # linear members at the ends of all ranges that bound the gain from below
STATES = 60  # largest number of states of the model with its filters
MOST_ORDER = 8

__all__ = ["IqcProof", "Natures", "Posed", "Problem", "posed"]

# Name of a block, or (output, input) of a law -> its type.
Natures = Mapping[Any, Nature]


class Basis(NamedTuple):
    """Pole a in rad/s and highest power of ``a / (s + a)``."""

    pole: float
    order: int


@dataclass(frozen=True)
class IqcProof(Evidence):
    """Evidence that proves a bound in ball arithmetic, without a solver.

    Attributes
    ----------
    constraints
        Block -> the kinds of its constraints, in words.
    pole, order
        Of the multipliers' filters: pole in rad/s, highest power.
    states
        Of the model with all filters.
    slack
        Distance of the inequality's matrix from singular.
    P, unknowns
        Lyapunov matrix (of either sign) and multipliers, for the states and the time of the given model.
    """

    constraints: Mapping[str, str]
    pole: float
    order: int
    states: int
    slack: float
    P: Array
    unknowns: Array


@dataclass(frozen=True)
class Posed(Evidence):
    """The problem of a proof, with unchanged numbers: the channels of the blocks come first in the model.

    Attributes
    ----------
    model
        Continuous; its Delta is that of ``blocks``, and for a law the gain itself.
    blocks
        Blocks in their order.
    ranges
        Ends of the entries of Delta, (k, 2); -1, 1 of blocks that are no real number.
    natures
        Type of each block, in Delta's unit; None: constant.
    words, conditions
        Block -> its type in words; the motions for which a law is in its sector, where not all.
    """

    model: StateSpaceModel
    blocks: tuple[Block, ...]
    ranges: Array
    natures: tuple[Nature | None, ...]
    words: Mapping[str, str]
    conditions: tuple[str, ...]


# --- claims -----------------------------------------------------------------------------------------------------------


def claim_of(posed: Posed, proof: IqcProof, *, gamma: float | None = None, size: float = 1.0) -> Claim:
    """Return the claim that the gain is at most ``gamma``, or without one that the set times ``size`` is stable."""
    M, blocks, natures = posed.model, posed.blocks, posed.natures
    q, p = (
        (M.n_inputs, M.n_outputs) if gamma is not None else (sum(b.rows for b in blocks), sum(b.cols for b in blocks))
    )
    level = {"size": np.array(size)} if gamma is None else {"gamma": np.array(gamma)}
    rows = [(0 if b.interval else 1 if b.is_scalar else 2, b.rows, b.cols) for b in blocks]
    slopes = [(n.slope or (0.0, 0.0)) if isinstance(n, Nonlinearity) else (0.0, 0.0) for n in natures]
    kinds = [
        (3 if n.slope else 2, int(n.odd), int(n.steady)) if isinstance(n, Nonlinearity) else (int(n is not None), 0, 0)
        for n in natures
    ]
    return Claim("iqc-size" if gamma is None else "iqc-gain", {
        "A": M.A, "B": M.B[:, :q], "C": M.C[:p], "D": M.D[:p, :q], "dt": np.array(0.0),
        "blocks": np.array(rows, dtype=np.int64).reshape(-1, 3), "nature": np.array(kinds, dtype=np.int64),
        "ranges": posed.ranges, "slope": np.array(slopes, dtype=float).reshape(-1, 2),
        "rate": np.array([n.rate if isinstance(n, Varying) else np.inf for n in natures], dtype=float),
        "pole": np.array(proof.pole), "order": np.array(proof.order, dtype=np.int64), "P": proof.P,
        "multipliers": proof.unknowns, **level,
    })  # fmt: skip


# --- the problem ------------------------------------------------------------------------------------------------------


def posed(
    where: str, model: Any, nature: Natures | None, order: int, pole: float | None, time_limit: float | None,
    effort: float, channel: tuple[Sequence[str] | None, Sequence[str] | None] = (None, None),
) -> tuple[Problem, Budget]:  # fmt: skip
    """Check a public function's arguments and return the problem and its budget; channel: names of inputs, outputs."""
    whole(f"{where}: order", order, 0, MOST_ORDER)
    if pole is not None:
        number(f"{where}: pole", pole, "a positive number in rad/s", above=0)
    budget = search_budget(where, WORK, effort, time_limit)
    if nature is not None and not isinstance(nature, Mapping):
        raise InputError(f"{where}: nature", f"{nature!r}", "block -> what it is, such as {'k': rl.Varying(0.2)}")
    given = dict(nature or {})
    laws: dict[Any, Any] = {key: one for key, one in given.items() if isinstance(key, tuple)}
    for key, one in laws.items():
        if len(key) != 2 or not isinstance(one, Nonlinearity):
            raise InputError(f"{where}: {key!r}", f"{one!r}", "(output, input) -> a Nonlinearity")
    opened = _opened(model, laws).select(*channel)
    named: dict[str, Nature] = {":".join(k) if isinstance(k, tuple) else k: v for k, v in given.items()}
    if opened.M.is_discrete:
        raise InputError(where, f"a discrete model (dt = {opened.dt:g} s)", "a continuous one", "rl.d2c makes one")
    if not opened.blocks:
        raise InputError(where, "no block at all", "an uncertain model, or a nature with signals")
    known = [b.name for b in opened.blocks]
    for name in named:
        if name not in known:
            expected = f"one of {listed(known)}"
            raise InputError(f"{where}: {name!r}", "no such block", expected, did_you_mean(name, known))
    own = len(known) - len(laws)  # blocks of the set, before those of the laws
    kinds = [_in_delta(where, b, named.get(b.name), i >= own) for i, b in enumerate(opened.blocks)]
    ranges = [
        n.sector if isinstance(n, Nonlinearity) else b.interval or (-1.0, 1.0)
        for b, n in zip(opened.blocks, kinds, strict=True)
    ]
    words = {b.name: _in_words(b, named.get(b.name)) for b in opened.blocks}
    conditions = tuple(f"{name}: {one.holds}" for name, one in named.items() if one.holds)
    given_as = Posed(opened.M, tuple(opened.blocks), np.array(ranges, dtype=float), tuple(kinds), words, conditions)
    return Problem(where, given_as, order, pole), budget


def _opened(model: Any, laws: Mapping[tuple[str, str], Nonlinearity]) -> UncertainModel:
    """Return the model with a real block ``output:input`` for each law, the gain between them.

    The outputs are kept; the inputs are driven by the laws alone.
    """
    given = model if isinstance(model, UncertainModel) else UncertainModel(as_model(model, "iqc"), [])
    M, (q, p) = given.M, given.delta_shape
    ins, outs = M.input_names[q:], M.output_names[p:]
    blocks, seen, driven = [], [], []
    for output, into in laws:
        for name, known, kind in ((output, outs, "output"), (into, ins, "input")):
            if name not in known:
                where, expected = f"nonlinearity {output}:{into}", f"one of {listed(known)}"
                raise InputError(where, f"no {kind} {name!r}", expected, did_you_mean(name, known))
        if q + ins.index(into) in driven:
            raise InputError(f"nonlinearity {output}:{into}", f"{into!r} is driven twice", "one law for each input")
        blocks.append(RealScalar(f"{output}:{into}"))
        seen.append(p + outs.index(output))
        driven.append(q + ins.index(into))
    columns = [*range(q), *driven, *(j for j in range(q, M.n_inputs) if j not in driven)]
    rows = [*range(p), *seen, *range(p, M.n_outputs)]
    wide = StateSpaceModel(
        M.A, M.B[:, columns], M.C[rows], M.D[np.ix_(rows, columns)], M.dt,
        [*M.inputs[:q], *(f"w_{b.name}" for b in blocks), *(M.inputs[j] for j in columns[q + len(blocks) :])],
        [*M.outputs[:p], *(f"z_{b.name}" for b in blocks), *M.outputs[p:]], M.states, where="iqc",
    )  # fmt: skip
    return UncertainModel(wide, [*given.blocks, *blocks])


def _in_delta(where: str, block: Block, nature: Nature | None, drives: bool) -> Nature | None:
    """Check the nature against the block and return it in Delta's unit; ``drives``: a law of signals, in their own."""
    name, span = f"{where}: {block.name!r}", block.parameter
    if not (block.is_scalar or block.is_ball):
        raise InputError(name, f"a {type(block).__name__}", "a scalar block, or a full one of gain one")
    nominal, radius = (0.0, 1.0) if span is None else (span.nominal, span.radius)
    if isinstance(nature, Nonlinearity):
        if drives:
            return nature
        if not (block.is_real and block.rows == 1):
            raise InputError(name, f"a {type(block).__name__} of {block.rows} x {block.cols}", "a real one, once")
        low, high = block.ends
        if not np.allclose(nature.sector, (low, high), rtol=1e-9, atol=1e-12 * (high - low)):
            raise InputError(name, f"a law of sector {nature.sector}", f"the block's own range, {low:g} .. {high:g}")
        sector = block.interval or (-1.0, 1.0)
        slope = nature.slope and tuple((end - nominal) / radius for end in nature.slope)
        # A sector is within the slope, also after rounding.
        inside = (min(slope[0], sector[0]), max(slope[1], sector[1])) if slope else None
        return replace(nature, sector=sector, slope=inside)
    if isinstance(nature, Varying):
        if np.isfinite(nature.rate) and not block.is_real:
            found = f"a rate of {nature.rate:g} for a {type(block).__name__}"
            raise InputError(name, found, "a rate of a real parameter", "Varying() for an operator that varies")
        return Varying(nature.rate / abs(radius))
    if nature is not None:
        raise InputError(name, f"a {type(nature).__name__}", "Varying or Nonlinearity")
    return nature


def _in_words(block: Block, nature: Nature | None) -> str:
    unit = "delta" if block.parameter is None else block.parameter.unit or "1"
    if nature is None:
        return "constant real parameter" if block.is_real else "time-invariant dynamics"
    if isinstance(nature, Varying):
        return f"varies by at most {nature.rate:g} {unit}/s" if np.isfinite(nature.rate) else "varies arbitrarily fast"
    low, high = nature.sector
    text = f"{'odd ' if nature.odd else ''}nonlinearity, sector [{low:.4g}, {high:.4g}]"
    text += f", slope [{nature.slope[0]:.4g}, {nature.slope[1]:.4g}]" if nature.slope else ""
    return text if nature.steady else f"{text}, varies"


class Problem:
    """The set with unit blocks about the middles of their ranges, and the inequalities at a basis and a size."""

    def __init__(self, where: str, posed: Posed, order: int, pole: float | None) -> None:
        self.posed = posed
        (low, high), slices = posed.ranges.T, block_slices(posed.blocks)
        middle, half = 0.5 * (low + high), 0.5 * (high - low)
        self.q, self.p = slices[-1][0].stop, slices[-1][1].stop
        centre, scale = np.zeros((self.q, self.p)), np.eye(self.q)
        for m, h, (w, z) in zip(middle, half, slices, strict=True):
            if m:
                centre[w, z] = m * np.eye(w.stop - w.start)
            scale[w, w] *= h
        M = recentred(posed.model, posed.blocks, centre, scale, where)
        units = [RealScalar(b.name, b.rows) if b.interval else b for b in posed.blocks]
        self.middle = UncertainModel(M, units)
        poles = M.poles()
        if len(poles) and not M.is_stable():
            worst = poles[poles.real.argmax()]
            raise NoTrustworthyNumber(
                where, f"unstable with all blocks at their middles (pole {worst.real:.6g}{worst.imag:+.6g}j)",
                "a stable model there", "no proof holds for a class with an unstable member: take narrower ranges",
            )  # fmt: skip
        self.n_w, self.n_z = M.n_inputs - self.q, M.n_outputs - self.p
        self.natures: list[Nature | None] = []
        for block, nature, m, h, (_, z) in zip(posed.blocks, posed.natures, middle, half, slices, strict=True):
            if isinstance(nature, Nonlinearity):
                if nature.slope is None and M.D[z, : self.q].any():
                    raise InputError(
                        f"{where}: {block.name!r}", "an algebraic loop around a law whose slope has no bound",
                        "a bound of the slope, or a model in which the law does not act on its own input without delay",
                    )  # fmt: skip
                slope = nature.slope and ((nature.slope[0] - m) / h, (nature.slope[1] - m) / h)
                nature = replace(nature, sector=(-1.0, 1.0), slope=slope)
            self.natures.append(Varying(nature.rate / h) if isinstance(nature, Varying) else nature)
        speed = np.abs(poles[np.abs(poles) > 0])
        self.speed = float(np.median(speed)) if len(speed) else 1.0
        filtered = any(filter_order(nature, order) for nature in self.natures)
        tried = [self.speed * t for t in (POLES if filtered else (1.0,))] if pole is None else [pole]
        self.bases = [Basis(a, order) for a in tried]

    # --- from below ---------------------------------------------------------------------------------------------------

    def worst_member(self) -> tuple[float, dict[str, float]]:
        """Return the largest gain of a linear member at the ends of the ranges (inf: unstable), and that member."""
        reach: dict[str, tuple[float, float]] = {}
        for b, nature in zip(self.middle.blocks, self.natures, strict=True):
            if b.is_scalar:
                m, k = (isinstance(nature, Nonlinearity) and nature.slope) or (-1.0, 1.0)
                reach[b.name] = max(-1.0, m), min(1.0, k)
        every: Iterable[tuple[float, ...]] = product(*reach.values())
        if 2 ** len(reach) > MEMBERS:
            rng = np.random.default_rng(0)
            every = [tuple(pair[rng.integers(2)] for pair in reach.values()) for _ in range(MEMBERS)]
        worst, at = hinf_norm(self.middle.nominal).lower, dict.fromkeys(reach, 0.0)
        for values in every:
            delta = dict(zip(reach, values, strict=True))
            try:
                one = self.middle.evaluate(delta)
            except NoTrustworthyNumber:  # not well posed
                return np.inf, delta
            gain = hinf_norm(one).lower if not one.n_states or one.is_stable() else np.inf
            if gain > worst:
                worst, at = gain, delta
            if np.isinf(worst):
                break
        return float(worst), at

    # --- from above ---------------------------------------------------------------------------------------------------

    def least_gain(self, basis: Basis, budget: Budget, enough: float = 0.0) -> tuple[float, IqcProof] | None:
        """Return the least gain proved with these filters and its proof, or None; the search ends below ``enough``."""
        size = float(max(hinf_norm(self.middle.nominal).upper, 1e-12))
        if math.isinf(size):  # a pole indistinguishable from the axis
            return None
        unit, scales = 2.0 ** round(math.log2(size)), np.ones(self.middle.M.n_states)
        best: tuple[float, IqcProof] | None = None
        for _ in range(BALANCINGS):
            made = self._inequality(basis, 1.0, unit, scales)
            least = None if made is None else made.solve(budget)
            found = None
            if made is not None and least is not None and least.square > 0:
                found = self._backed_off(basis, made, least.square, unit, budget)
            if made is None or least is None or found is None:
                break
            settled = best is not None and found[0] >= BETTER * best[0]
            best = found if best is None or found[0] < best[0] else best
            if settled or best[0] <= enough or budget.over:
                break
            # Clarabel stops far above the least gain if P's entries have very different sizes: scale its diagonal to 1.
            n = len(scales)
            sizes = np.abs(np.diag(least.P)[:n]) * self.speed * made.units[:n] ** 2
            with np.errstate(divide="ignore"):
                scales = scales * 2.0 ** np.where(sizes > 0, np.clip(np.rint(-0.5 * np.log2(sizes)), -20, 20), 0.0)
        return best

    def _backed_off(
        self, basis: Basis, made: Inequality, least: float, unit: float, budget: Budget
    ) -> tuple[float, IqcProof] | None:
        """Return a gain a little above the least one that is proved, and its proof."""
        for share in BACK_OFFS:
            point = made.solve(budget, least * (1 + share) ** 2)
            if point is None or not point.slack > 0:
                continue
            gain = unit * math.sqrt(point.square) * (1 + 1e-15)
            proof = _proof(basis, made, point, unit**2)
            if holds(claim_of(self.posed, proof, gamma=gain)):
                return gain, proof
        return None

    def proved_stable(self, size: float, budget: Budget, thorough: bool = True) -> IqcProof | None:
        """Return a proof that the set times ``size`` is stable, with any basis or the best so far, or None."""
        for basis in tuple(self.bases if thorough else self.bases[:1]):
            made = self._inequality(basis, size, None)
            point = None if made is None or budget.over else made.solve(budget)
            if made is None or point is None or not point.slack > 0:
                continue
            proof = _proof(basis, made, point, 1.0)
            if holds(claim_of(self.posed, proof, size=size)):
                self.bases.sort(key=lambda one: one is not basis)  # tried first at the next size
                return proof
        return None

    def _inequality(
        self, basis: Basis, size: float, unit: float | None, scales: Array | float = 1.0
    ) -> Inequality | None:
        """Return the inequality in balanced states; None: too many states.

        ``unit``: of the gain, None for stability alone; ``scales``: powers of two of larger units of the states.
        """
        M, q, p = self.middle.M, self.q, self.p
        n_w, n_z = (self.n_w, self.n_z) if unit is not None else (0, 0)
        into = np.concatenate([np.full(q, size), np.ones(n_w)])
        out = np.concatenate([np.ones(p), np.full(n_z, 1.0 / (unit or 1.0))])
        B, C = M.B[:, : q + n_w] * into, M.C[: p + n_z] * out[:, None]
        D = M.D[: p + n_z, : q + n_w] * into * out[:, None]
        units, rate = np.ones(M.n_states), 1.0
        if M.n_states:
            balance, rate = balancing_units(StateSpaceModel(M.A, B, C, D))
            units = balance * scales / np.sqrt(rate)
        parts = list(zip(self.middle.blocks, self.natures, block_slices(self.middle.blocks), strict=True))
        orders = [filter_order(nature, basis.order) for _, nature, _ in parts]
        rated = [k * b.cols if isinstance(n, Varying) else 0 for k, (b, n, _) in zip(orders, parts, strict=True)]
        filters = sum(k * (b.cols + b.rows) for k, (b, *_) in zip(orders, parts, strict=True))
        if M.n_states + filters > STATES:
            return None
        F = Filtered(M.A, B, C, D, filters, sum(rated))
        found: dict[str, tuple[str, Form, float]] = {}
        inputs, added = np.ones(q + n_w), []
        for order, extra, (block, nature, (w, z)) in zip(orders, rated, parts, strict=True):
            # A power of two that balances the gains into and out of the channels: without it nothing is proved of the
            # servo axis with a saturation.
            ins, outs = np.linalg.norm(B[:, w] / units[: len(B), None]) / rate, np.linalg.norm(C[z] * units[: len(B)])
            d = 2.0 ** round(0.5 * math.log2(ins / outs)) if ins and outs else 1.0
            if isinstance(nature, Nonlinearity):
                free = not D[z, :q].any(), not D[z].any()
                kinds, form = law(F, z, F.input(w), order, basis.pole, nature, free)
            else:
                kinds, form = linear(
                    F, F.outputs[z], F.input(w), order, basis.pole, scalar=block.is_scalar, real=block.is_real,
                    rate=np.inf if nature is None else nature.rate / size,
                )  # fmt: skip
            found[block.name] = kinds, form, d**2
            units = np.append(units, np.full(order * (block.cols + block.rows), 1 / d))
            inputs[w], added = 1 / d, [*added, *[1 / d] * extra]
        units = np.concatenate([units, inputs, added])
        return Inequality(F, units, found, F.outputs[p : p + n_z], F.input(slice(q, q + n_w)))


def _proof(basis: Basis, made: Inequality, point: Point, square: float) -> IqcProof:
    """Return the proof of a point; ``square``: of the unit of the gain."""
    P, unknowns = square * point.P, square * point.multipliers
    return IqcProof(made.kinds, basis.pole, basis.order, made.n, point.slack, P, unknowns)


def holds(claim: Claim) -> bool:
    """Prove a claim in ball arithmetic, for the given model, with the independent checker."""
    return check(claim).outcome is Outcome.PROVED
