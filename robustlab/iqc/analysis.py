r"""Worst-case gain and stability by integral quadratic constraints, also of a loop with the effects of its plant.

.. math:: z = M_{11} w + M_{12} u, \quad y = M_{21} w + M_{22} u, \quad w = \Delta(z), \qquad
          \|y\|_2 \le \gamma \|u\|_2 \text{ for all } u \in L_2 \text{ and all } \Delta \text{ of the class}

Every range is first centred, so that tau Delta is of the class of each Delta for tau in [0, 1] (Megretski, Rantzer
1997), and the model, at tau = 0, is stable. Theorem and proof:
robustlab/verification/theorems.md.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from robustlab.arrays import Array
from robustlab.budget import MILLION, Budget, one_thread, search_budget
from robustlab.checks import number as checked
from robustlab.checks import whole
from robustlab.display import Facts, listed, member, number
from robustlab.errors import InputError, NoTrustworthyNumber, did_you_mean, error_context
from robustlab.feedback import feedback_loop
from robustlab.iqc.block_types import BlockType, Nonlinearity, Varying
from robustlab.iqc.inequality import Filtered, Form, Inequality, Point, filter_order, law, linear
from robustlab.mu_analysis.axis.margin import StabilityMargin
from robustlab.norms import PeakGain, balancing_units, hinf_norm
from robustlab.norms.claims import block_rows
from robustlab.result import Evidence, Status
from robustlab.statespace import StateSpaceModel, as_model
from robustlab.uncertainty.blocks import Block, RealScalar, block_slices
from robustlab.uncertainty.lft import UncertainModel, recentred
from robustlab.verification.checker import check
from robustlab.verification.claim import Claim, Outcome

if TYPE_CHECKING:
    from robustlab.dynamics.extended.effect_blocks import EffectBlocks
    from robustlab.dynamics.extended.extended_plant import ExtendedPlant

WORK = 60 * MILLION  # the usual work of a proof at effort 1
POLES = (1.0, 4.0, 0.25)  # of the multipliers, relative to the model's typical speed
BALANCINGS = 4  # minimisations of the gain at most, each in states scaled by the last P
BETTER = 0.98  # and while the gain falls below this share of the last one
BACK_OFFS = (1e-5, 1e-4, 1e-3, 1e-2, 5e-2, 0.2)  # relative increases of the least gain that are tried for a proof
MEMBERS = 64  # linear members at the ends of all ranges that bound the gain from below
STATES = 60  # largest number of states of the model with its filters
MOST_ORDER = 8
CLOSE = 1e-3  # relative distance of a margin from a size not proved, of a gain from one attained
NEAR = 0.05  # the same distance, below which only the best basis so far is tried
LEAST, LARGEST = 1e-3, 64.0  # sizes of the set between which a margin is searched
HOMOTOPY = "tau Delta is of the class of Delta for every tau in [0, 1]"
# A relay F has the describing function 4 F / (pi a): at this multiple of the stick speed it is F / v_s.
STICK = 1.2732395447351628
# Effects on an input that are memoryless, odd and of slope in [0, 1].
ODD_INPUTS = ("input-saturation", "input-dead-zone")

# Name of a block, or (output, input) of a law -> its type.
BlockTypes = Mapping[Any, BlockType]


@dataclass(frozen=True)
class IqcProof(Evidence):
    """Evidence that proves a bound in ball arithmetic, without a solver."""

    constraints: Mapping[str, str]  # block -> the kinds of its constraints, in words
    pole: float  # of the multipliers' filters, in rad/s
    order: int  # their highest power
    slack: float  # distance of the inequality's matrix from singular
    P: Array  # Lyapunov matrix (of either sign), for the states and the time of the given model
    unknowns: Array  # of the multipliers


@dataclass(frozen=True)
class Posed(Evidence):
    """The problem of a proof, with unchanged numbers: the channels of the blocks come first in the model."""

    model: StateSpaceModel  # continuous; its Delta is that of the blocks, and for a law the gain itself
    blocks: tuple[Block, ...]
    ranges: Array  # ends of the entries of Delta, (k, 2); -1, 1 of blocks that are no real number
    block_types: tuple[BlockType | None, ...]  # type of each block, in Delta's unit; None: constant
    words: Mapping[str, str]  # block -> its type in words
    conditions: tuple[str, ...]  # the motions for which a law is in its sector, where not all


@dataclass(frozen=True, eq=False)
class IqcGain(PeakGain):
    """Bounds of the worst L2 gain over all blocks of their classes.

    ``lower`` is the gain of a member in which all blocks are constant gains. CERTIFIED: ``upper`` was proved in ball
    arithmetic for every block of its class. INCONCLUSIVE: nothing was proved. INFEASIBLE: the member ``delta`` is
    unstable. TIMEOUT: the time limit ended the search.
    """

    delta: Mapping[str, float]  # that member: one normalised value per block; 0 is the middle of a range
    block_types: Mapping[str, str]  # block -> its type in words
    proof: IqcProof | None  # of ``upper``; None where nothing was proved
    posed: Posed = field(kw_only=True)  # the problem, for another proof

    unsaved: ClassVar[tuple[str, ...]] = ("posed",)

    def claims(self) -> list[Claim]:
        return [] if self.proof is None else [claim_of(self.posed, self.proof, gamma=self.upper)]

    def evidence(self) -> Facts:
        return [_blocks(self.block_types), ("worst linear member", member(self.delta)), *_proof_facts(self.proof)]


@dataclass(frozen=True, eq=False)
class IqcStability(StabilityMargin):
    """Stability for all blocks of their classes.

    ``lower`` is the largest size proved in ball arithmetic (CERTIFIED), the factor by which every range is enlarged
    about its middle, and the slopes with it; 0 where none was (INCONCLUSIVE). Unstable members are not searched:
    ``upper`` is inf. TIMEOUT: the time limit ended the search; ``lower`` holds.
    """

    block_types: Mapping[str, str]
    conditions: tuple[str, ...]
    proof: IqcProof | None
    posed: Posed = field(kw_only=True)

    unsaved: ClassVar[tuple[str, ...]] = ("posed",)
    derived: ClassVar[tuple[str, ...]] = ("stable",)

    def claims(self) -> list[Claim]:
        return [] if self.proof is None else [claim_of(self.posed, self.proof, size=self.lower)]

    @property
    def stable(self) -> bool:
        """Return whether stability is proved for the set as given."""
        return self.lower >= 1

    def headline(self) -> str:
        return "proved stable for all blocks of their classes" if self.stable else "not proved stable"

    def facts(self) -> Facts:
        return [
            ("stable as given", "proved" if self.stable else "not proved"),
            ("margin", f"{number(self.lower)} (proved)"),
            _blocks(self.block_types),
            ("holds", listed(self.conditions)),
            *_proof_facts(self.proof),
        ]


def _blocks(block_type: Mapping[str, str]) -> tuple[str, str]:
    return "blocks", listed(f"{name}: {text}" for name, text in block_type.items())


def _proof_facts(proof: IqcProof | None) -> Facts:
    if proof is None:
        return []
    filters = f"pole {number(proof.pole, 'rad/s')}, order {proof.order}" if proof.order else "none"
    kinds = listed(f"{name}: {kind}" for name, kind in proof.constraints.items())
    return [("constraints", kinds), ("filters", filters), ("slack", number(proof.slack)), ("homotopy", HOMOTOPY)]


@error_context("iqc_gain")
def iqc_gain(
    model: Any,
    block_types: BlockTypes | None = None,
    inputs: Sequence[str] | None = None,
    outputs: Sequence[str] | None = None,
    order: int = 2,
    pole: float | None = None,
    time_limit: float | None = None,
    effort: float = 1.0,
) -> IqcGain:
    """`robustlab.peak_gain` with blocks that are nonlinear or vary with time."""
    problem, budget = posed("iqc_gain", model, block_types, order, pole, time_limit, effort, (inputs, outputs))
    if not problem.n_w or not problem.n_z:
        raise InputError("iqc_gain", "no input and output except those of the blocks", "a performance channel")
    with one_thread():
        lower, delta = problem.worst_member()
        best: tuple[float, IqcProof] | None = None
        enough = lower * (1 + CLOSE)
        for a in problem.poles if np.isfinite(lower) else ():
            found = problem.least_gain(a, budget, enough)
            if found is not None and (best is None or found[0] < best[0]):
                best = found
            if budget.over or (best is not None and best[0] <= enough):
                break
    upper, proof = best if best is not None else (math.inf, None)
    status = _status(best is not None, budget) if np.isfinite(lower) else Status.INFEASIBLE
    given = problem.posed
    return IqcGain(lower, upper, None, status, delta, given.words, proof, conditions=given.conditions, posed=given)


def _status(proved: bool, budget: Budget) -> Status:
    return Status.CERTIFIED if proved else Status.TIMEOUT if budget.struck else Status.INCONCLUSIVE


@error_context("iqc_stability")
def iqc_stability(
    model: Any,
    block_types: BlockTypes | None = None,
    order: int = 2,
    pole: float | None = None,
    time_limit: float | None = None,
    effort: float = 1.0,
) -> IqcStability:
    """`robustlab.robust_stability` with ``block_types``, by integral quadratic constraints; rate bounds do not grow."""
    problem, budget = posed("iqc_stability", model, block_types, order, pole, time_limit, effort)
    low, high, size = 0.0, math.inf, 1.0  # the largest that is proved, the smallest that is not, the next
    proof: IqcProof | None = None
    with one_thread():
        while not budget.over and low < LARGEST and LEAST < high > low * (1 + CLOSE):
            found = problem.proved_stable(size, budget, thorough=not low or high > low * (1 + NEAR))
            if found is None:
                high = size
            else:
                low, proof = size, found
            size = 2 * low if math.isinf(high) else 0.5 * (low + high)
    given, status = problem.posed, _status(low > 0, budget)
    return IqcStability(low, math.inf, None, status, {}, (), given.words, given.conditions, proof, posed=given)


# --- effects of a plant -----------------------------------------------------------------------------------------------


@error_context("effect_gain")
def effect_gain(
    plant: ExtendedPlant,
    controller: Any = None,
    outputs: Sequence[str] | None = None,
    amplitude: Mapping[str, float] | None = None,
    stick_speed: Mapping[str, float] | None = None,
    sign: int | None = None,
    order: int = 2,
    time_limit: float | None = None,
    effort: float = 1.0,
) -> IqcGain:
    """`robustlab.peak_gain` of a plant with effects in a loop, from disturbances at its inputs to its outputs.

    A saturation or dead zone of an input is an odd law with slopes in [0, 1], Coulomb friction with a stick speed v_s
    one with sector and slopes [0, Fc / v_s], any other effect with a sector a gain that may change at every instant.
    """
    from robustlab.dynamics.extended.effect_blocks import effect_blocks

    if controller is None:
        raise InputError("effect_gain: controller", "none for a plant with effects", "the K that closes its loop")
    slow = dict(stick_speed or {})
    places = {e.site.name: e for e in plant.effects if e.effect.id == "coulomb-friction"}
    for name, speed in slow.items():
        where = f"effect_gain: stick_speed {name!r}"
        if name not in places:
            raise InputError(where, "no Coulomb friction there", listed(places) or "none")
        checked(where, speed, "a positive speed", above=0)
    rubbing = next((name for name in places if name not in slow), None)
    if rubbing is not None:
        raise InputError(
            "effect_gain", f"Coulomb friction at {rubbing}, of sector [0, inf): no strict inequality holds",
            "a stick_speed there", "the speed below which the force grows in proportion to it, as in simulations",
        )  # fmt: skip
    levels = {**(amplitude or {}), **{name: STICK * v for name, v in slow.items()}}
    made = effect_blocks(plant, outputs, amplitude=levels, dry="gain")
    inputs = [s.name for s in plant.inputs]
    around, s, source = feedback_loop(made.model.select(inputs), controller, sign, "effect_gain")
    loop = made.model.select(inputs).feedback(around, s)
    block_types = _block_types(plant, made, amplitude or {}, slow)
    found = iqc_gain(loop, block_types, order=order, time_limit=time_limit, effort=effort)
    left = {**made.left_out, **{n.name: "a bounded error: an input, no gain" for n in made.noise}}
    return replace(found, notes=(f"loop: {source}", *(f"not in it: {name}: {why}" for name, why in left.items())))


def _block_types(
    plant: ExtendedPlant, made: EffectBlocks, amplitude: Mapping[str, float], slow: Mapping[str, float]
) -> dict[str, BlockType]:
    effects, found = {e.key: e for e in plant.effects}, dict[str, BlockType]()
    for block in made.model.blocks:
        e = effects.get(block.name.rstrip("'"))
        if e is None or block.parameter is None:
            continue
        sector, place = (block.parameter.low, block.parameter.high), e.site.name
        if e.effect.id in ODD_INPUTS:
            holds = f"while the signal stays within {amplitude[place]:g}"
            found[block.name] = Nonlinearity(sector, (0.0, 1.0), odd=True, holds=holds)
        elif e.effect.id == "coulomb-friction":
            words = f"sticking as creep below {slow[place]:g}"
            found[block.name] = Nonlinearity(sector, sector, odd=True, holds=words)
        elif block.name in made.approximate:
            where = f"effect_gain: {e.key}"
            raise InputError(where, "a gain by harmonic balance only", "an effect with a sector", "take it out")
        elif not e.effect.delay and not e.time_constant and e.scale is None:
            local = f"while its signal stays within {amplitude[place]:g}" if place in amplitude else ""
            found[block.name] = Varying(holds=local or ("within the amplitudes given" if amplitude else ""))
    return found


# --- the problem ------------------------------------------------------------------------------------------------------


def claim_of(posed: Posed, proof: IqcProof, *, gamma: float | None = None, size: float = 1.0) -> Claim:
    """Return the claim that the gain is at most ``gamma``, or without one that the set times ``size`` is stable."""
    M, blocks, block_types = posed.model, posed.blocks, posed.block_types
    q, p = UncertainModel(M, blocks).delta_shape if gamma is None else (M.n_inputs, M.n_outputs)
    level = {"size": np.array(size)} if gamma is None else {"gamma": np.array(gamma)}
    slopes, kinds = [(0.0, 0.0)] * len(blocks), [(int(n is not None), 0, 0) for n in block_types]
    for k, n in enumerate(block_types):
        if isinstance(n, Nonlinearity):
            slopes[k], kinds[k] = n.slope or (0.0, 0.0), (3 if n.slope else 2, int(n.odd), int(n.steady))
    return Claim("iqc-size" if gamma is None else "iqc-gain", {
        "A": M.A, "B": M.B[:, :q], "C": M.C[:p], "D": M.D[:p, :q], "dt": np.array(0.0),
        "blocks": block_rows(blocks), "nature": np.array(kinds, dtype=np.int64),
        "ranges": posed.ranges, "slope": np.array(slopes, dtype=float).reshape(-1, 2),
        "rate": np.array([n.rate if isinstance(n, Varying) else np.inf for n in block_types], dtype=float),
        "pole": np.array(proof.pole), "order": np.array(proof.order, dtype=np.int64), "P": proof.P,
        "multipliers": proof.unknowns, **level,
    })  # fmt: skip


def posed(
    where: str, model: Any, block_types: BlockTypes | None, order: int, pole: float | None, time_limit: float | None,
    effort: float, channel: tuple[Sequence[str] | None, Sequence[str] | None] = (None, None),
) -> tuple[Problem, Budget]:  # fmt: skip
    """Check a public function's arguments and return the problem and its budget; channel: names of inputs, outputs."""
    whole(f"{where}: order", order, 0, MOST_ORDER)
    if pole is not None:
        checked(f"{where}: pole", pole, "a positive number in rad/s", above=0)
    budget = search_budget(where, WORK, effort, time_limit)
    if block_types is not None and not isinstance(block_types, Mapping):
        expected = "block -> what it is, such as {'k': rl.Varying(0.2)}"
        raise InputError(f"{where}: block_types", f"{block_types!r}", expected)
    given = dict(block_types or {})
    laws: dict[Any, Any] = {key: one for key, one in given.items() if isinstance(key, tuple)}
    for key, one in laws.items():
        if len(key) != 2 or not isinstance(one, Nonlinearity):
            raise InputError(f"{where}: {key!r}", f"{one!r}", "(output, input) -> a Nonlinearity")
    opened = _opened(model, laws).select(*channel)
    named: dict[str, BlockType] = {":".join(k) if isinstance(k, tuple) else k: v for k, v in given.items()}
    if opened.M.is_discrete:
        raise InputError(where, f"a discrete model (dt = {opened.dt:g} s)", "a continuous one", "rl.d2c makes one")
    if not opened.blocks:
        raise InputError(where, "no block at all", "an uncertain model, or a block type with signals")
    known = [b.name for b in opened.blocks]
    for name in (name for name in named if name not in known):
        expected = f"one of {listed(known)}"
        raise InputError(f"{where}: {name!r}", "no such block", expected, did_you_mean(name, known))
    own = len(known) - len(laws)  # blocks of the set, before those of the laws
    kinds = [_in_delta(where, b, named.get(b.name), i >= own) for i, b in enumerate(opened.blocks)]
    pairs = zip(opened.blocks, kinds, strict=True)
    ranges = [n.sector if isinstance(n, Nonlinearity) else b.interval or (-1.0, 1.0) for b, n in pairs]
    words = {b.name: _in_words(b, named.get(b.name)) for b in opened.blocks}
    conditions = tuple(f"{name}: {one.holds}" for name, one in named.items() if one.holds)
    given_as = Posed(opened.M, tuple(opened.blocks), np.array(ranges, dtype=float), tuple(kinds), words, conditions)
    return Problem(where, given_as, order, pole), budget


def _opened(model: Any, laws: Mapping[tuple[str, str], Nonlinearity]) -> UncertainModel:
    """Return the model with a real block ``output:input`` for each law, whose input the law alone drives."""
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


def _in_delta(where: str, block: Block, block_type: BlockType | None, drives: bool) -> BlockType | None:
    """Check the type against the block and return it in Delta's unit; ``drives``: a law of signals, in their own."""
    name, span = f"{where}: {block.name!r}", block.parameter
    if not (block.is_scalar or block.is_ball):
        raise InputError(name, f"a {type(block).__name__}", "a scalar block, or a full one of gain one")
    nominal, radius = (0.0, 1.0) if span is None else (span.nominal, span.radius)
    if isinstance(block_type, Nonlinearity):
        if drives:
            return block_type
        if not (block.is_real and block.rows == 1):
            raise InputError(name, f"a {type(block).__name__} of {block.rows} x {block.cols}", "a real one, once")
        low, high = block.ends
        if not np.allclose(block_type.sector, (low, high), rtol=1e-9, atol=1e-12 * (high - low)):
            expected = f"the block's own range, {low:g} .. {high:g}"
            raise InputError(name, f"a law of sector {block_type.sector}", expected)
        sector = block.interval or (-1.0, 1.0)
        slope = block_type.slope and tuple((end - nominal) / radius for end in block_type.slope)
        # A sector is within the slope, also after rounding.
        inside = (min(slope[0], sector[0]), max(slope[1], sector[1])) if slope else None
        return replace(block_type, sector=sector, slope=inside)
    if isinstance(block_type, Varying):
        if np.isfinite(block_type.rate) and not block.is_real:
            found = f"a rate of {block_type.rate:g} for a {type(block).__name__}"
            raise InputError(name, found, "a rate of a real parameter", "Varying() for an operator that varies")
        return Varying(block_type.rate / abs(radius))
    if block_type is not None:
        raise InputError(name, f"a {type(block_type).__name__}", "Varying or Nonlinearity")
    return block_type


def _in_words(block: Block, block_type: BlockType | None) -> str:
    unit = "delta" if block.parameter is None else block.parameter.unit or "1"
    if block_type is None:
        return "constant real parameter" if block.is_real else "time-invariant dynamics"
    if isinstance(block_type, Varying):
        bounded = np.isfinite(block_type.rate)
        return f"varies by at most {block_type.rate:g} {unit}/s" if bounded else "varies arbitrarily fast"
    low, high = block_type.sector
    text = f"{'odd ' if block_type.odd else ''}nonlinearity, sector [{low:.4g}, {high:.4g}]"
    text += f", slope [{block_type.slope[0]:.4g}, {block_type.slope[1]:.4g}]" if block_type.slope else ""
    return text if block_type.steady else f"{text}, varies"


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
        self.n_w, self.n_z, self.block_types = M.n_inputs - self.q, M.n_outputs - self.p, list[BlockType | None]()
        for block, block_type, m, h, (_, z) in zip(posed.blocks, posed.block_types, middle, half, slices, strict=True):
            if isinstance(block_type, Nonlinearity):
                if block_type.slope is None and M.D[z, : self.q].any():
                    raise InputError(
                        f"{where}: {block.name!r}", "an algebraic loop around a law whose slope has no bound",
                        "a bound of the slope, or a model in which the law does not act on its own input without delay",
                    )  # fmt: skip
                slope = block_type.slope and ((block_type.slope[0] - m) / h, (block_type.slope[1] - m) / h)
                block_type = replace(block_type, sector=(-1.0, 1.0), slope=slope)
            self.block_types.append(Varying(block_type.rate / h) if isinstance(block_type, Varying) else block_type)
        speed = np.abs(poles[np.abs(poles) > 0])
        self.speed = float(np.median(speed)) if len(speed) else 1.0
        filtered = any(filter_order(block_type, order) for block_type in self.block_types)
        # Of the filters in rad/s, and the highest power of a / (s + a).
        self.poles = [self.speed * t for t in (POLES if filtered else (1.0,))] if pole is None else [pole]
        self.order = order

    def worst_member(self) -> tuple[float, dict[str, float]]:
        """Return the largest gain of a linear member at the ends of the ranges (inf: unstable), and that member."""
        names = [b.name for b in self.middle.blocks if b.is_scalar]
        corners: Any = product((-1.0, 1.0), repeat=len(names))
        if 2 ** len(names) > MEMBERS:
            corners = np.random.default_rng(0).choice([-1.0, 1.0], (MEMBERS, len(names))).tolist()
        worst, at = hinf_norm(self.middle.nominal).lower, dict.fromkeys(names, 0.0)
        for values in corners:
            delta = dict(zip(names, values, strict=True))
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

    def least_gain(self, pole: float, budget: Budget, enough: float = 0.0) -> tuple[float, IqcProof] | None:
        """Return the least gain proved with these filters and its proof, or None; the search ends below ``enough``."""
        size = float(max(hinf_norm(self.middle.nominal).upper, 1e-12))
        if math.isinf(size):  # a pole indistinguishable from the axis
            return None
        unit, scales = 2.0 ** round(math.log2(size)), np.ones(self.middle.M.n_states)
        best: tuple[float, IqcProof] | None = None
        for _ in range(BALANCINGS):
            made = self._inequality(pole, 1.0, unit, scales)
            least = made and made.solve(budget)
            if made is None or least is None or not least.square > 0:
                break
            found = self._backed_off(pole, made, least.square, unit, budget)
            if found is None:
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
        self, pole: float, made: Inequality, least: float, unit: float, budget: Budget
    ) -> tuple[float, IqcProof] | None:
        """Return a gain a little above the least one that is proved, and its proof."""
        for share in BACK_OFFS:
            point = made.solve(budget, least * (1 + share) ** 2)
            if point is None or not point.slack > 0:
                continue
            gain = unit * math.sqrt(point.square) * (1 + 1e-15)
            if (proof := self._proof(pole, made, point, unit**2, gamma=gain)) is not None:
                return gain, proof
        return None

    def _proof(self, pole: float, made: Inequality, point: Point, square: float, **level: float) -> IqcProof | None:
        """Return a point as a proof, if the independent checker accepts it for the given model, in ball arithmetic."""
        P, unknowns = square * point.P, square * point.multipliers
        proof = IqcProof(made.kinds, pole, self.order, point.slack, P, unknowns)
        return proof if check(claim_of(self.posed, proof, **level)).outcome is Outcome.PROVED else None

    def proved_stable(self, size: float, budget: Budget, thorough: bool = True) -> IqcProof | None:
        """Return a proof that the set times ``size`` is stable, with any filters or the best so far, or None."""
        for pole in tuple(self.poles if thorough else self.poles[:1]):
            made = self._inequality(pole, size, None)
            point = None if made is None or budget.over else made.solve(budget)
            if made is None or point is None or not point.slack > 0:
                continue
            if (proof := self._proof(pole, made, point, 1.0, size=size)) is not None:
                self.poles.sort(key=lambda one: one != pole)  # tried first at the next size
                return proof
        return None

    def _inequality(
        self, pole: float, size: float, unit: float | None, scales: Array | float = 1.0
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
        parts = list(zip(self.middle.blocks, self.block_types, block_slices(self.middle.blocks), strict=True))
        orders = [filter_order(block_type, self.order) for _, block_type, _ in parts]
        rated = [k * b.cols if isinstance(n, Varying) else 0 for k, (b, n, _) in zip(orders, parts, strict=True)]
        filters = sum(k * (b.cols + b.rows) for k, (b, *_) in zip(orders, parts, strict=True))
        if M.n_states + filters > STATES:
            return None
        F = Filtered(M.A, B, C, D, filters, sum(rated))
        found: dict[str, tuple[str, Form, float]] = {}
        inputs, added = np.ones(q + n_w), []
        for order, extra, (block, block_type, (w, z)) in zip(orders, rated, parts, strict=True):
            # A power of two that balances the gains into and out of the channels: without it nothing is proved of the
            # servo axis with a saturation.
            ins, outs = np.linalg.norm(B[:, w] / units[: len(B), None]) / rate, np.linalg.norm(C[z] * units[: len(B)])
            d = 2.0 ** round(0.5 * math.log2(ins / outs)) if ins and outs else 1.0
            if isinstance(block_type, Nonlinearity):
                free = not D[z, :q].any(), not D[z].any()
                kinds, form = law(F, z, F.input(w), order, pole, block_type, free)
            else:
                kinds, form = linear(
                    F, F.outputs[z], F.input(w), order, pole, scalar=block.is_scalar, real=block.is_real,
                    rate=np.inf if block_type is None else block_type.rate / size,
                )  # fmt: skip
            found[block.name] = kinds, form, d**2
            units = np.append(units, np.full(order * (block.cols + block.rows), 1 / d))
            inputs[w], added = 1 / d, [*added, *[1 / d] * extra]
        units = np.concatenate([units, inputs, added])
        return Inequality(F, units, found, F.outputs[p : p + n_z], F.input(slice(q, q + n_w)))
