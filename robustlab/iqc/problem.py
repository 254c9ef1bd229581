r"""The analysis problem of a set with natures: lower bounds by members, upper bounds by inequalities.

Every range is first centred, so that the class of each block contains zero. A `Problem` makes one inequality for each
basis of filters and each size of the set, in balanced states, channels and time.
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
from robustlab.checks import number
from robustlab.display import listed
from robustlab.errors import InputError, NoTrustworthyNumber, did_you_mean
from robustlab.iqc.block_types import Nature, Nonlinearity, Varying
from robustlab.iqc.filtered_model import FilteredModel
from robustlab.iqc.inequality import Inequality, Point
from robustlab.iqc.multipliers import POPOV, Basis, Term, nonlinear_terms, rate_terms, repeated_terms
from robustlab.norms import balancing_units, hinf_norm, well_scaled
from robustlab.result import Evidence
from robustlab.statespace import StateSpaceModel, as_model
from robustlab.uncertainty.blocks import Block, ParameterRange, RealScalar, block_slices
from robustlab.uncertainty.interconnection import recentred
from robustlab.uncertainty.lft import UncertainModel
from robustlab.verification.checker import check
from robustlab.verification.claim import Claim, Outcome

WORK = 60 * MILLION  # the usual work of a proof at effort 1
POLES = (1.0, 4.0, 0.25)  # of the multipliers, relative to the model's typical speed
BALANCINGS = 4  # minimisations of the gain at most, each in states scaled by the last P
BETTER = 0.98  # and while the gain falls below this share of the last one
BACK_OFFS = (1e-5, 1e-4, 1e-3, 1e-2, 5e-2, 0.2)  # relative increases of the least gain that are tried for a proof
MEMBERS = 64  # linear members at the ends of all ranges that bound the gain from below
STATES = 60  # largest number of states of the model with its filters

__all__ = ["IqcProof", "Natures", "Posed", "Problem", "posed"]

MOST_ORDER = 8
# Name of a block, or (output, input) of a law -> its type.
Natures = Mapping[Any, Nature]


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
    """

    model: StateSpaceModel
    blocks: tuple[Block, ...]
    ranges: Array
    natures: tuple[Nature | None, ...]


# --- claims -----------------------------------------------------------------------------------------------------------

CONSTANT, VARYING, SECTOR, SLOPE = 0, 1, 2, 3


def gain_claim(posed: Posed, proof: IqcProof, gamma: float) -> Claim:
    """Return the claim that the gain is at most ``gamma`` for all blocks of their natures."""
    M = posed.model
    model = {"A": M.A, "B": M.B, "C": M.C, "D": M.D, "dt": np.array(0.0)}
    return Claim("iqc-gain", {**model, **_proof_numbers(posed, proof), "gamma": np.array(gamma)})


def size_claim(posed: Posed, proof: IqcProof, size: float) -> Claim:
    """Return the claim that the set ``size`` times as large is stable."""
    q, p = (sum(sizes) for sizes in zip(*((b.rows, b.cols) for b in posed.blocks), strict=True))
    M = posed.model
    model = {"A": M.A, "B": M.B[:, :q], "C": M.C[:p], "D": M.D[:p, :q], "dt": np.array(0.0)}
    return Claim("iqc-size", {**model, **_proof_numbers(posed, proof), "size": np.array(size)})


def holds(claim: Claim) -> bool:
    """Prove a claim in ball arithmetic, for the given model, with the independent checker."""
    return check(claim).outcome is Outcome.PROVED


def _proof_numbers(posed: Posed, proof: IqcProof) -> dict[str, Any]:
    """Return the blocks with their natures, and the evidence of the bound."""
    rows = [(0 if b.interval else 1 if b.is_scalar else 2, b.rows, b.cols) for b in posed.blocks]
    slopes = [(n.slope or (0.0, 0.0)) if isinstance(n, Nonlinearity) else (0.0, 0.0) for n in posed.natures]
    rates = [n.rate if isinstance(n, Varying) else np.inf for n in posed.natures]
    return {
        "blocks": np.array(rows, dtype=np.int64).reshape(-1, 3),
        "nature": np.array([_row(nature) for nature in posed.natures], dtype=np.int64).reshape(-1, 3),
        "ranges": posed.ranges, "slope": np.array(slopes, dtype=float).reshape(-1, 2),
        "rate": np.array(rates, dtype=float), "pole": np.array(proof.pole),
        "order": np.array(proof.order, dtype=np.int64), "P": proof.P, "multipliers": proof.unknowns,
    }  # fmt: skip


def _row(nature: Nature | None) -> tuple[int, int, int]:
    """Return ``[kind, odd, steady]``."""
    if isinstance(nature, Nonlinearity):
        return SECTOR if nature.slope is None else SLOPE, int(nature.odd), int(nature.steady)
    return (CONSTANT if nature is None else VARYING), 0, 0


# --- the problem ------------------------------------------------------------------------------------------------------


def _opened(model: Any, laws: Mapping[tuple[str, str], Nonlinearity]) -> UncertainModel:
    """Return the model with a real block ``output:input`` for each law, the gain between them.

    The outputs are kept; the inputs are driven by the laws alone.
    """
    given = model if isinstance(model, UncertainModel) else UncertainModel(as_model(model, "iqc"), [])
    M, (q, p) = given.M, given.delta_shape
    ins, outs = M.input_names[q:], M.output_names[p:]
    blocks, seen, driven = [], [], []
    for (output, into), law in laws.items():
        for name, known, kind in ((output, outs, "output"), (into, ins, "input")):
            if name not in known:
                where, expected = f"nonlinearity {output}:{into}", f"one of {listed(known)}"
                raise InputError(where, f"no {kind} {name!r}", expected, did_you_mean(name, known))
        if q + ins.index(into) in driven:
            raise InputError(f"nonlinearity {output}:{into}", f"{into!r} is driven twice", "one law for each input")
        blocks.append(RealScalar(f"{output}:{into}", 1, ParameterRange.between(*law.sector)))
        seen.append(p + outs.index(output))
        driven.append(q + ins.index(into))
    columns = [*range(q), *driven, *(j for j in range(q, M.n_inputs) if j not in driven)]
    rows = [*range(p), *seen, *range(p, M.n_outputs)]
    names = [f"w_{b.name}" for b in blocks], [f"z_{b.name}" for b in blocks]
    wide = StateSpaceModel(
        M.A, M.B[:, columns], M.C[rows], M.D[np.ix_(rows, columns)], M.dt,
        [*M.inputs[:q], *names[0], *(M.inputs[j] for j in columns[q + len(blocks) :])],
        [*M.outputs[:p], *names[1], *M.outputs[p:]], M.states, where="iqc",
    )  # fmt: skip
    return UncertainModel(wide, [*given.blocks, *blocks])


def _normalised(opened: UncertainModel, laws: Mapping[tuple[str, str], Nonlinearity]) -> UncertainModel:
    """Normalise the gains of the laws, the last blocks, to their sectors."""
    (q, p), k = opened.delta_shape, len(laws)
    # w = (middle + half Delta) z in the new channels, the set's own as they are
    centre = np.zeros((q, p))
    centre[q - k :, p - k :] = np.diag([0.5 * sum(law.sector) for law in laws.values()])
    scale = np.diag([*np.ones(q - k), *(0.5 * (law.sector[1] - law.sector[0]) for law in laws.values())])
    return UncertainModel(recentred(opened.M, opened.blocks, centre, scale, "iqc"), opened.blocks)


def posed(
    where: str, model: Any, nature: Natures | None, order: int, pole: float | None, time_limit: float | None,
    effort: float, channel: tuple[Sequence[str] | None, Sequence[str] | None] = (None, None),
) -> tuple[Problem, Budget]:  # fmt: skip
    """Check a public function's arguments and return the problem and its budget; channel: names of inputs, outputs."""
    if isinstance(order, bool) or not isinstance(order, int) or not 0 <= order <= MOST_ORDER:
        raise InputError(f"{where}: order", f"{order!r}", f"a whole number from 0 to {MOST_ORDER}")
    if pole is not None:
        number(f"{where}: pole", pole, "a positive number in rad/s", above=0)
    budget = search_budget(where, WORK, effort, time_limit)
    if nature is not None and not isinstance(nature, Mapping):
        raise InputError(f"{where}: nature", f"{nature!r}", "block -> what it is, such as {'k': rl.Varying(0.2)}")
    given = dict(nature or {})
    laws: dict[tuple[str, str], Nonlinearity] = {}
    for key, law in given.items():
        if isinstance(key, tuple):
            if len(key) != 2 or not isinstance(law, Nonlinearity):
                raise InputError(f"{where}: {key!r}", f"{law!r}", "(output, input) -> a Nonlinearity")
            laws[key] = law
    opened = _opened(model, laws).select(*channel)
    whole = _normalised(opened, laws)
    named: dict[str, Nature] = {":".join(k) if isinstance(k, tuple) else k: v for k, v in given.items()}
    if whole.M.is_discrete:
        raise InputError(where, f"a discrete model (dt = {whole.dt:g} s)", "a continuous one", "rl.d2c makes one")
    if not whole.blocks:
        raise InputError(where, "no block at all", "an uncertain model, or a nature with signals")
    known = [b.name for b in whole.blocks]
    for name in named:
        if name not in known:
            raise InputError(
                f"{where}: {name!r}", "no such block", f"one of {listed(known)}", did_you_mean(name, known)
            )
    problem = Problem(where, whole.centred(), named, order, pole)
    problem.posed = _posed(opened, laws, problem)
    return problem, budget


def _posed(opened: UncertainModel, laws: Mapping[tuple[str, str], Nonlinearity], problem: Problem) -> Posed:
    """Return the problem in the units of Delta of the opened model."""
    ranges, natures = [], []
    gains = {":".join(key): law for key, law in laws.items()}
    for block in opened.blocks:
        known = problem.laws[block.name]
        low, high = gains[block.name].sector if block.name in gains else block.interval or (-1.0, 1.0)
        middle, half = 0.5 * (low + high), 0.5 * (high - low)
        if isinstance(known, Varying):
            known = Varying(known.rate * half)
        elif isinstance(known, Nonlinearity):
            m, k = known.slope or (0.0, 0.0)
            slope = gains[block.name].slope if block.name in gains else (middle + half * m, middle + half * k)
            # A sector is within the slope, also after rounding.
            inside = None if known.slope is None or slope is None else (min(slope[0], low), max(slope[1], high))
            known = replace(known, sector=(low, high), slope=inside)
        ranges.append((low, high))
        natures.append(known)
    return Posed(opened.M, tuple(opened.blocks), np.array(ranges, dtype=float).reshape(-1, 2), tuple(natures))


class Units(NamedTuple):
    """Units of an inequality: of each block's channels, of time, of the states."""

    blocks: Mapping[str, float]
    rate: float
    states: Array


class Problem:
    """The centred set, the types of its blocks, and the inequalities at a basis and a size."""

    posed: Posed

    def __init__(
        self, where: str, middle: UncertainModel, nature: Mapping[str, Nature], order: int, pole: float | None,
        ) -> None:  # fmt: skip
        self.where, self.middle, self.nature = where, middle, nature
        M, (self.q, self.p) = middle.M, middle.delta_shape
        poles = M.poles()
        if len(poles) and not M.is_stable():
            worst = poles[poles.real.argmax()]
            raise NoTrustworthyNumber(
                where, f"unstable with all blocks at their middles (pole {worst.real:.6g}{worst.imag:+.6g}j)",
                "a stable model there", "no proof holds for a class with an unstable member: take narrower ranges",
            )  # fmt: skip
        self.n_w, self.n_z = M.n_inputs - self.q, M.n_outputs - self.p
        self.laws = {b.name: _law(where, b, nature.get(b.name)) for b in middle.blocks}
        self.words = {b.name: _in_words(b, nature.get(b.name)) for b in middle.blocks}
        self.conditions = tuple(f"{name}: {law.holds}" for name, law in nature.items() if law.holds)
        speed = np.abs(poles[np.abs(poles) > 0])
        typical = float(np.median(speed)) if len(speed) else 1.0
        filtered = order and any(not isinstance(n, Varying) or np.isfinite(n.rate) for n in self.laws.values())
        tried = POLES if filtered else (1.0,)
        self.bases = [Basis(pole, order)] if pole is not None else [Basis(typical * t, order) for t in tried]

    # --- from below ---------------------------------------------------------------------------------------------------

    def worst_member(self) -> tuple[float, dict[str, float]]:
        """Return the largest gain of a linear member at the ends of the ranges (inf: unstable), and that member."""
        reach: dict[str, tuple[float, float]] = {}
        for b in self.middle.blocks:
            law = self.laws[b.name]
            if isinstance(law, Nonlinearity):
                m, k = law.slope or (-1.0, 1.0)
                reach[b.name] = max(-1.0, m), min(1.0, k)
            elif b.is_scalar:
                reach[b.name] = (-1.0, 1.0)
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
        unit, states = 2.0 ** round(math.log2(size)), np.ones(self.middle.M.n_states)
        best: tuple[float, IqcProof] | None = None
        for _ in range(BALANCINGS):
            found, states = self._least_gain(basis, budget, unit, states)
            if found is None:
                break
            settled = best is not None and found[0] >= BETTER * best[0]
            if best is None or found[0] < best[0]:
                best = found
            if settled or best[0] <= enough or budget.over:
                break
        return best

    def _least_gain(
        self, basis: Basis, budget: Budget, unit: float, states: Array
    ) -> tuple[tuple[float, IqcProof] | None, Array]:
        """Return the same for states scaled by ``states``, and scales that would give P a diagonal of ones.

        Clarabel stops far above the least gain if P's entries have very different sizes.
        """
        made = self._inequality(basis, 1.0, unit, states)
        least = None if made is None else made[0].solve(budget)
        if made is None or least is None or not least.square > 0:
            return None, states
        inequality, units = made
        size = np.abs(np.diag(least.P))[: len(states)]
        with np.errstate(divide="ignore"):
            again = states * 2.0 ** np.where(size > 0, np.clip(np.rint(-0.5 * np.log2(size)), -20, 20), 0.0)
        for share in BACK_OFFS:
            point = inequality.solve(budget, least.square * (1 + share) ** 2)
            if point is None:
                continue
            gain = unit * math.sqrt(point.square) * (1 + 1e-15)
            proof = self._proof(basis, inequality, point, units, unit)
            if proof is not None and holds(gain_claim(self.posed, proof, gain)):
                return (gain, proof), again
        return None, again

    def proved_stable(self, size: float, budget: Budget, thorough: bool = True) -> IqcProof | None:
        """Return a proof that the set times ``size`` is stable, with any basis or the best so far, or None."""
        for basis in tuple(self.bases if thorough else self.bases[:1]):
            made = self._inequality(basis, size, None)
            point = None if made is None or budget.over else made[0].solve(budget)
            if made is None or point is None:
                continue
            proof = self._proof(basis, made[0], point, made[1], 1.0)
            if proof is not None and holds(size_claim(self.posed, proof, size)):
                self.bases.sort(key=lambda one: one is not basis)  # tried first at the next size
                return proof
        return None

    def _inequality(
        self, basis: Basis, size: float, unit: float | None, states: Array | float = 1.0
    ) -> tuple[Inequality, Units] | None:
        """Return the inequality in balanced states and its own time unit, with these units; None: too many states.

        ``unit``: of the gain, None for stability alone; ``states``: powers of two of larger units of the states.
        """
        M, q, p = self.middle.M, self.q, self.p
        n_w, n_z = (self.n_w, self.n_z) if unit is not None else (0, 0)
        into = np.concatenate([np.full(q, size), np.ones(n_w)])
        out = np.concatenate([np.ones(p), np.full(n_z, 1.0 / (unit or 1.0))])
        B, C = M.B[:, : q + n_w] * into, M.C[: p + n_z] * out[:, None]
        D = M.D[: p + n_z, : q + n_w] * into * out[:, None]
        scaled, rate = StateSpaceModel(M.A, B, C, D), 1.0
        units = np.ones(scaled.n_states)
        if scaled.n_states:
            t = np.broadcast_to(states, scaled.n_states)
            units = np.sqrt(balancing_units(scaled)[1]) / (balancing_units(scaled)[0] * t)
            scaled, rate = well_scaled(scaled)
            A, B, C = scaled.A / t[:, None] * t, scaled.B / t[:, None], scaled.C * t
            scaled = StateSpaceModel(A, B, C, scaled.D)
        balance = _channel_balance(self.middle.blocks, scaled)
        B, C, D = (part.copy() for part in (scaled.B, scaled.C, scaled.D))
        for d, (w, z) in zip(balance, block_slices(self.middle.blocks), strict=True):
            B[:, w] /= d
            D[:, w] /= d
            C[z] *= d
            D[z] *= d
        model, own = FilteredModel(scaled.A, B, C, D), Basis(basis.pole / rate, basis.order)
        terms: list[Term] = []
        for block, d, (w, z) in zip(self.middle.blocks, balance, block_slices(self.middle.blocks), strict=True):
            terms += self._terms(model, block, w, z, own, size, rate)
            units = np.append(units, np.full(model.n - len(units), d))
        if model.n > STATES:
            return None
        seen = model.outputs(slice(p, p + n_z)) if n_z else None
        blocks = {b.name: d for b, d in zip(self.middle.blocks, balance, strict=True)}
        return Inequality(model, terms, seen, slice(q, q + n_w)), Units(blocks, rate, units)

    def _proof(self, basis: Basis, inequality: Inequality, point: Point, units: Units, unit: float) -> IqcProof | None:
        """Return P and all unknowns in the units of the given loop; None where the solver's point is infeasible."""
        slack, square = inequality.slack_of(point), unit**2
        if not slack > 0:
            return None
        kinds: dict[str, str] = {}
        parts: list[Array] = []
        for t, x in zip(inequality.terms, point.unknowns, strict=True):
            kinds[t.block] = f"{kinds[t.block]}, {t.kind}" if t.block in kinds else t.kind
            # Popov's multiplier acts on a derivative.
            parts.append(x * (square * units.blocks[t.block] ** 2) / (units.rate if t.kind == POPOV else 1.0))
        P = point.P * np.outer(units.states, units.states) * (square / units.rate)  # symmetric to the last bit
        return IqcProof(kinds, basis.pole, basis.order, inequality.n, slack, P, np.concatenate(parts))

    def _terms(
        self, model: FilteredModel, block: Block, w: slice, z: slice, basis: Basis, size: float, rate: float
    ) -> list[Term]:
        law, name = self.laws[block.name], block.name
        seen, acts = model.outputs(z), model.inputs(w)
        if isinstance(law, Nonlinearity):
            loops = bool(seen.d[:, : self.q].any())
            found = nonlinear_terms(model, name, seen, acts, basis, law, loops)
            if loops and law.slope is None:
                raise InputError(
                    f"{self.where}: {name!r}", "an algebraic loop around a law whose slope has no bound",
                    "a bound of the slope, or a model in which the law does not act on its own input without delay",
                )  # fmt: skip
            return found
        if isinstance(law, Varying) and np.isfinite(law.rate) and basis.order:
            return rate_terms(model, name, seen, acts, basis, law.rate / size / rate)
        own = Basis(basis.pole, 0) if isinstance(law, Varying) else basis
        return repeated_terms(model, name, seen, acts, own, scalar=block.is_scalar, real=block.is_real)


def _law(where: str, block: Block, nature: Nature | None) -> Nature | None:
    """Check the nature against the block and return it in normalised units; None: constant."""
    name = f"{where}: {block.name!r}"
    if not (block.is_scalar or block.is_ball):
        raise InputError(name, f"a {type(block).__name__}", "a scalar block, or a full one of gain one")
    span = block.parameter
    if isinstance(nature, Nonlinearity):
        if not (block.is_real and block.rows == 1):
            raise InputError(name, f"a {type(block).__name__} of {block.rows} x {block.cols}", "a real one, once")
        low, high = (-1.0, 1.0) if span is None else (span.nominal - span.radius, span.nominal + span.radius)
        if not np.allclose(nature.sector, (low, high), rtol=1e-9, atol=1e-12 * (high - low)):
            raise InputError(name, f"a law of sector {nature.sector}", f"the block's own range, {low:g} .. {high:g}")
        return nature.normalised()
    if isinstance(nature, Varying) and np.isfinite(nature.rate):
        if not block.is_real:
            found = f"a rate of {nature.rate:g} for a {type(block).__name__}"
            raise InputError(name, found, "a rate of a real parameter", "Varying() for an operator that varies")
        return Varying(nature.rate / (1.0 if span is None else abs(span.radius)))
    if nature is not None and not isinstance(nature, Varying):
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


def _channel_balance(blocks: Sequence[Block], m: StateSpaceModel) -> list[float]:
    """Return a power of two for each block that balances the gains into and out of its channels."""
    found = []
    for w, z in block_slices(blocks):
        into, out = np.linalg.norm(m.B[:, w]), np.linalg.norm(m.C[z])
        found.append(2.0 ** round(0.5 * math.log2(into / out)) if into and out else 1.0)
    return found
