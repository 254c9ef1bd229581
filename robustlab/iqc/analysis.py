r"""Worst-case gain and stability by integral quadratic constraints.

.. math:: z = M_{11} w + M_{12} u, \quad y = M_{21} w + M_{22} u, \quad w = \Delta(z), \qquad
          \|y\|_2 \le \gamma \|u\|_2 \text{ for all } u \in L_2 \text{ and all } \Delta \text{ of the class}

Every range is taken about its middle first, so that zero lies in the class of each block: with every Delta, tau Delta
belongs to it for tau in [0, 1], which is the homotopy that Megretski and Rantzer ask for, and at tau = 0 the model is
stable. The loop is well posed for all of them: where w acts on z without delay, only constraints count that hold for
differences of signals too, and the inequality is strict at infinite frequency.

References
----------
Megretski, Rantzer, "System analysis via integral quadratic constraints", IEEE TAC 42 (1997).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np

from robustlab.arrays import Array
from robustlab.budget import Budget, one_thread, search_budget
from robustlab.errors import InputError, NoTrustworthyNumber, did_you_mean, told_as
from robustlab.iqc.filtered_model import FilteredModel
from robustlab.iqc.inequality import Inequality, Judgement, Point
from robustlab.iqc.multipliers import Basis, Term, nonlinear_terms, rate_terms, repeated_terms
from robustlab.iqc.nature import Nature, Nonlinearity, Varying
from robustlab.iqc.tuning import TUNING, IqcTuning
from robustlab.norms import hinf_norm
from robustlab.norms.level_set import well_scaled
from robustlab.result import Evidence, Status
from robustlab.shown import Facts, Shown, bracket, listed, member, number
from robustlab.statespace import StateSpaceModel, as_model
from robustlab.uncertainty.algebra import centred, upper
from robustlab.uncertainty.blocks import Block, ParameterRange, RealScalar, block_slices
from robustlab.uncertainty.lft import UncertainModel

__all__ = ["IqcGain", "IqcProof", "IqcStability", "Natures", "iqc_gain", "iqc_stability", "with_nonlinearities"]

# Name of a block, or (output that is seen, input that is driven) -> what is there.
Natures = Mapping[Any, Nature]
MOST_ORDER = 8
HOMOTOPY = "tau Delta is of the class of Delta for every tau in [0, 1]"


@dataclass(frozen=True)
class IqcProof(Evidence):
    """What proves a bound; with it the bound is checked again without a solver.

    Attributes
    ----------
    constraints
        Block -> the kinds of its constraints, in words.
    pole, order
        Of the multipliers' filters: pole in rad/s, highest power.
    states
        Of the model with all filters.
    slack, rounding
        Distance of the inequality's matrix from singular, and the bound of its rounding that was taken off it.
    highest
        Largest eigenvalue of the frequency-domain inequality over its largest entry, at all candidate frequencies:
        negative.
    P, unknowns
        Lyapunov matrix (of either sign) and multipliers, in scaled states and time.
    """

    constraints: Mapping[str, str]
    pole: float
    order: int
    states: int
    slack: float
    rounding: float
    highest: float
    P: Array
    unknowns: Array


@dataclass(frozen=True, eq=False)
class IqcGain(Shown):
    """Bounds of the worst L2 gain over all blocks of their classes.

    Attributes
    ----------
    lower, upper
        ``upper`` holds for every block of its class, proved; ``lower`` is the gain of the member ``delta``, in which
        all blocks are constant gains. inf: nothing was proved; a member is unstable.
    delta
        That member: one normalised value per block; 0 the middle of a range.
    nature
        Block name -> what it was taken for, in words.
    conditions
        For which motions a law is in its sector, where that is not all.
    proof
        Evidence of ``upper``; None where nothing was proved.
    status
        CERTIFIED: ``upper`` was proved outside of the solver. INCONCLUSIVE: nothing was proved, which says nothing of
        the loop. INFEASIBLE: the member ``delta`` is unstable. TIMEOUT: the time limit ended the search.
    """

    lower: float
    upper: float
    delta: Mapping[str, float]
    nature: Mapping[str, str]
    conditions: tuple[str, ...]
    proof: IqcProof | None
    status: Status

    def facts(self) -> Facts:
        """Both bounds and what they rest on."""
        text = bracket(self.lower, self.upper, ("attained", "proved"))
        if np.isinf(self.upper):
            text = (
                f"{number(self.lower)} (attained), no bound proved"
                if np.isfinite(self.lower)
                else "a member is unstable"
            )
        return [
            ("worst-case L2 gain", text),
            ("blocks", listed(f"{name}: {text}" for name, text in self.nature.items())),
            ("worst linear member", member(self.delta)),
            ("holds", listed(self.conditions)),
            *_proof_facts(self.proof),
        ]

    def to_json(self) -> dict[str, Any]:
        """All attributes."""
        return {"type": "IqcGain", **vars(self)}


@dataclass(frozen=True, eq=False)
class IqcStability(Shown):
    """Stability for all blocks of their classes.

    Attributes
    ----------
    stable
        Whether stability is proved for the set as given.
    margin
        Largest size that is proved: every range grown about its middle by that factor, the slopes with it. At least 1
        where ``stable``; 0 where nothing was proved.
    nature, conditions, proof
        As in `IqcGain`; the proof is that of ``margin``.
    status
        CERTIFIED: ``margin`` was proved outside of the solver. INCONCLUSIVE: it is 0. TIMEOUT: the clock ended the
        search; what was proved by then holds.
    """

    stable: bool
    margin: float
    nature: Mapping[str, str]
    conditions: tuple[str, ...]
    proof: IqcProof | None
    status: Status

    def facts(self) -> Facts:
        """The margin and what it rests on."""
        return [
            ("stable as given", "proved" if self.stable else "not proved"),
            ("margin", f"{number(self.margin)} (proved)"),
            ("blocks", listed(f"{name}: {text}" for name, text in self.nature.items())),
            ("holds", listed(self.conditions)),
            *_proof_facts(self.proof),
        ]

    def to_json(self) -> dict[str, Any]:
        """All attributes."""
        return {"type": "IqcStability", **vars(self)}


def _proof_facts(proof: IqcProof | None) -> Facts:
    if proof is None:
        return []
    kinds = listed(f"{name}: {kind}" for name, kind in proof.constraints.items())
    filters = f"pole {number(proof.pole, 'rad/s')}, order {proof.order}" if proof.order else "none"
    return [
        ("constraints", kinds),
        ("filters", filters),
        ("slack", f"{number(proof.slack)}, rounding at most {number(proof.rounding, digits=2)}"),
        ("homotopy", HOMOTOPY),
    ]


@told_as("iqc_gain")
def iqc_gain(
    model: Any,
    nature: Natures | None = None,
    inputs: Sequence[str] | None = None,
    outputs: Sequence[str] | None = None,
    order: int = 2,
    pole: float | None = None,
    time_limit: float | None = None,
    effort: float = 1.0,
) -> IqcGain:
    r"""Proved bound of the worst L2 gain with nonlinear, time-varying and uncertain blocks.

    .. math:: \sup_{\Delta} \sup_{u} \|y\|_2 / \|u\|_2 \le \gamma

    A block of ``nature`` is what is said there; every other one is what it is in the uncertain model: a constant real
    parameter, or time-invariant dynamics of gain one. Each block is described by integral quadratic constraints
    (`robustlab.iqc.multipliers`), a linear matrix inequality finds the multipliers of least gamma, and what is reported
    is proved outside of the solver (`robustlab.iqc.inequality`).

    Parameters
    ----------
    model
        `UncertainModel`, or a model whose signals ``nature`` names; continuous, stable with all blocks at the middles
        of their ranges.
    nature
        Name of a block -> `Varying` or `Nonlinearity`; or (output, input) -> `Nonlinearity`, which drives that input
        with a law of that output. A `Nonlinearity` of a real block needs the sector that the range of the block is.
    inputs, outputs
        Names of u and y; all of the model that no block drives, and all outputs, where left out.
    order
        Highest power of the multipliers' filters ``a / (s + a)``, 0..8; 0: static multipliers.
    pole
        a in rad/s; several of them, by the poles of the model, are tried where left out.
    time_limit
        Seconds after which the search ends; None: no limit.
    effort
        Multiple of the usual work.

    Returns
    -------
    IqcGain
        Both bounds, what each block was taken for, and the proof.

    Raises
    ------
    InputError
        No such block or signal, a discrete model, a nature that does not fit the block, no performance channel.
    NoTrustworthyNumber
        The model is unstable with all blocks at their middles.

    References
    ----------
    Megretski, Rantzer 1997; Veenman, Scherer, Köroğlu 2016.

    Examples
    --------
    >>> plant = StateSpaceModel([[-1.0]], [[-1.0, 1.0]], [[1.0]], [[0.0, 0.0]], 0, ["v", "d"], ["y"])
    >>> found = iqc_gain(plant, {("y", "v"): Nonlinearity.saturation()})  # 1 / (s + 1) with -sat(y) fed back
    >>> round(found.lower, 4), round(found.upper, 4)
    (1.0, 1.0)
    """
    problem, budget = _problem("iqc_gain", model, nature, order, pole, time_limit, effort, (inputs, outputs))
    if not problem.n_w or not problem.n_z:
        raise InputError("iqc_gain", "no input and output beside those of the blocks", "a performance channel")
    with one_thread():
        lower, delta = problem.worst_member()
        best: tuple[float, IqcProof] | None = None
        for basis in problem.bases if np.isfinite(lower) else ():
            found = problem.least_gain(basis, budget)
            if found is not None and (best is None or found[0] < best[0]):
                best = found
            if budget.over or (best is not None and best[0] <= lower * (1 + 1e-3)):
                break
    status = Status.CERTIFIED if best is not None else Status.TIMEOUT if budget.struck else Status.INCONCLUSIVE
    if not np.isfinite(lower):
        status = Status.INFEASIBLE
    upper, proof = best if best is not None else (math.inf, None)
    return IqcGain(lower, upper, delta, problem.words, problem.conditions, proof, status)


@told_as("iqc_stability")
def iqc_stability(
    model: Any,
    nature: Natures | None = None,
    order: int = 2,
    pole: float | None = None,
    time_limit: float | None = None,
    effort: float = 1.0,
) -> IqcStability:
    """Proved stability, and by how much every range may grow about its middle, for blocks of any class.

    Parameters
    ----------
    model, nature, order, pole, time_limit, effort
        As in `iqc_gain`; no performance channel is needed. Bounds of a rate do not grow.

    Returns
    -------
    IqcStability
        Whether the set as given is proved stable, the margin, and the proof.

    Raises
    ------
    InputError
        No such block or signal, a discrete model, a nature that does not fit the block.
    NoTrustworthyNumber
        The model is unstable with all blocks at their middles.

    Examples
    --------
    >>> M = StateSpaceModel([[-1.0]], [[-0.5]], [[1.0]], [[0.0]])
    >>> from robustlab.uncertainty.blocks import RealScalar
    >>> found = iqc_stability(UncertainModel(M, [RealScalar("pole")]), {"pole": Varying()})
    >>> found.stable, round(found.margin, 2)
    (True, 2.0)
    """
    problem, budget = _problem("iqc_stability", model, nature, order, pole, time_limit, effort)
    low, high = 0.0, TUNING.largest
    proof: IqcProof | None = None
    with one_thread():
        size = 1.0
        for _ in range(TUNING.sizes):
            if budget.over or high <= low * (1 + TUNING.close):
                break
            found = problem.proved_stable(size, budget)
            if found is None:
                high = size
            else:
                low, proof = size, found
            size = min(2 * low, high) if high >= TUNING.largest and low else 0.5 * (low + high)
            if low >= TUNING.largest:
                break
    status = Status.CERTIFIED if low else Status.TIMEOUT if budget.struck else Status.INCONCLUSIVE
    return IqcStability(low >= 1, low, problem.words, problem.conditions, proof, status)


def with_nonlinearities(model: Any, laws: Mapping[tuple[str, str], Nonlinearity]) -> UncertainModel:
    """The model with a real block ``output:input`` for each law: the gain between them, in the range of its sector.

    The outputs stay, so that they can be looked at; the inputs are driven by the laws alone.
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
    # [z'; w] = [0 I; R C] [w'; z]: w = (middle + half Delta) z in the new channels, the set's own as they are
    centre = np.zeros((q + len(blocks), p + len(blocks)))
    centre[q:, p:] = np.diag([0.5 * sum(law.sector) for law in laws.values()])
    scale = np.diag([*np.ones(q), *(0.5 * (law.sector[1] - law.sector[0]) for law in laws.values())])
    change = np.block([[np.zeros(centre.T.shape), np.eye(p + len(blocks))], [scale, centre]])
    return upper(wide, UncertainModel(StateSpaceModel([], [], [], change), [*given.blocks, *blocks]))


# --- the problem that is solved ---------------------------------------------------------------------------------------


def _problem(
    where: str, model: Any, nature: Natures | None, order: int, pole: float | None, time_limit: float | None,
    effort: float, channel: tuple[Sequence[str] | None, Sequence[str] | None] = (None, None),
) -> tuple[_Problem, Budget]:  # fmt: skip
    if isinstance(order, bool) or not isinstance(order, int) or not 0 <= order <= MOST_ORDER:
        raise InputError(f"{where}: order", f"{order!r}", f"a whole number from 0 to {MOST_ORDER}")
    if pole is not None and not 0 < pole < np.inf:
        raise InputError(f"{where}: pole", f"{pole!r}", "a positive number in rad/s")
    budget = search_budget(where, TUNING.work, effort, time_limit)
    given = dict(nature or {})
    laws: dict[tuple[str, str], Nonlinearity] = {}
    for key, law in given.items():
        if isinstance(key, tuple):
            if len(key) != 2 or not isinstance(law, Nonlinearity):
                raise InputError(f"{where}: {key!r}", f"{law!r}", "(output, input) -> a Nonlinearity")
            laws[key] = law
    whole = with_nonlinearities(model, laws).select(*channel)
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
    return _Problem(where, centred(whole), named, order, pole), budget


class _Problem:
    """The set about its middles, what each block is, and the inequalities at a basis and a size."""

    def __init__(
        self, where: str, middle: UncertainModel, nature: Mapping[str, Nature], order: int, pole: float | None,
        tuning: IqcTuning = TUNING,
    ) -> None:  # fmt: skip
        self.where, self.middle, self.nature, self.tuning = where, middle, nature, tuning
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
        holds = ((name, law.holds) for name, law in nature.items() if isinstance(law, Nonlinearity))
        self.conditions = tuple(f"{name}: {text}" for name, text in holds if text)
        speed = np.abs(poles[np.abs(poles) > 0])
        typical = float(np.median(speed)) if len(speed) else 1.0
        filtered = order and any(not isinstance(n, Varying) or np.isfinite(n.rate) for n in self.laws.values())
        tried = tuning.poles if filtered else (1.0,)
        self.bases = [Basis(pole, order)] if pole is not None else [Basis(typical * t, order) for t in tried]

    # --- from below ---------------------------------------------------------------------------------------------------

    def worst_member(self) -> tuple[float, dict[str, float]]:
        """Largest gain of a linear member at the ends of the ranges, inf where one is unstable; and that member."""
        reach: dict[str, tuple[float, float]] = {}
        for b in self.middle.blocks:
            law = self.laws[b.name]
            if isinstance(law, Nonlinearity):
                m, k = law.slope or (-1.0, 1.0)
                reach[b.name] = max(-1.0, m), min(1.0, k)
            elif b.is_scalar:
                reach[b.name] = (-1.0, 1.0)
        every = (
            product(*reach.values()) if 2 ** len(reach) <= self.tuning.members else self._drawn(list(reach.values()))
        )
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

    def _drawn(self, ends: list[tuple[float, float]]) -> list[tuple[float, ...]]:
        rng = np.random.default_rng(0)
        return [tuple(pair[rng.integers(2)] for pair in ends) for _ in range(self.tuning.members)]

    # --- from above ---------------------------------------------------------------------------------------------------

    def least_gain(self, basis: Basis, budget: Budget) -> tuple[float, IqcProof] | None:
        """The least gain that is proved with these filters, and its proof; None where there is none."""
        size = float(max(hinf_norm(self.middle.nominal).upper, 1e-12))
        unit = 2.0 ** round(math.log2(size))
        inequality, terms = self._inequality(basis, 1.0, unit)
        if inequality is None:
            return None
        least = inequality.solve(budget)
        if least is None or not least.square > 0:
            return None
        for share in self.tuning.back_offs:
            point = inequality.solve(budget, least.square * (1 + share) ** 2)
            if point is None:
                continue
            judged = inequality.judged(point)
            if judged.proved:
                gain = unit * math.sqrt(point.square) * (1 + 1e-15)
                return gain, _proof(basis, inequality, terms, point, judged)
        return None

    def proved_stable(self, size: float, budget: Budget) -> IqcProof | None:
        """The proof that the set times ``size`` is stable; None where none was found."""
        for basis in tuple(self.bases):
            inequality, terms = self._inequality(basis, size, None)
            point = None if inequality is None or budget.over else inequality.solve(budget)
            if inequality is None or point is None:
                continue
            judged = inequality.judged(point)
            if judged.proved:
                self.bases.sort(key=lambda one: one is not basis)  # the first to be tried at the next size
                return _proof(basis, inequality, terms, point, judged)
        return None

    def _inequality(self, basis: Basis, size: float, unit: float | None) -> tuple[Inequality | None, list[Term]]:
        """In balanced states and in a time unit of its own; ``unit`` of the gain, None for stability alone."""
        M, q, p = self.middle.M, self.q, self.p
        n_w, n_z = (self.n_w, self.n_z) if unit is not None else (0, 0)
        into = np.concatenate([np.full(q, size), np.ones(n_w)])
        out = np.concatenate([np.ones(p), np.full(n_z, 1.0 / (unit or 1.0))])
        B, C = M.B[:, : q + n_w] * into, M.C[: p + n_z] * out[:, None]
        D = M.D[: p + n_z, : q + n_w] * into * out[:, None]
        scaled, rate = StateSpaceModel(M.A, B, C, D), 1.0
        if scaled.n_states:
            scaled, rate = well_scaled(scaled)
        B, C, D = _channels_balanced(self.middle.blocks, scaled)
        model, own = FilteredModel(scaled.A, B, C, D), Basis(basis.pole / rate, basis.order)
        terms: list[Term] = []
        for block, (w, z) in zip(self.middle.blocks, block_slices(self.middle.blocks), strict=True):
            terms += self._terms(model, block, w, z, own, size, rate)
        if model.n > self.tuning.states:
            return None, terms
        seen = model.outputs(slice(p, p + n_z)) if n_z else None
        return Inequality(model, terms, seen, slice(q, q + n_w)), terms

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
    """The nature in normalised units, checked against the block; None: constant."""
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
        return Varying(nature.rate / (1.0 if span is None else span.radius))
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


def _channels_balanced(blocks: Sequence[Block], m: StateSpaceModel) -> tuple[Array, Array, Array]:
    """B, C, D with as much into each block's channels as out of them, by powers of two; the classes do not change."""
    B, C, D = m.B.copy(), m.C.copy(), m.D.copy()
    for w, z in block_slices(blocks):
        into, out = np.linalg.norm(B[:, w]), np.linalg.norm(C[z])
        if into and out:
            d = 2.0 ** round(0.5 * math.log2(into / out))
            B[:, w], D[:, w], C[z], D[z] = B[:, w] / d, D[:, w] / d, C[z] * d, D[z] * d
    return B, C, D


def _proof(basis: Basis, inequality: Inequality, terms: list[Term], point: Point, judged: Judgement) -> IqcProof:
    kinds: dict[str, str] = {}
    for term in terms:
        kinds[term.block] = f"{kinds[term.block]}, {term.kind}" if term.block in kinds else term.kind
    unknowns = np.concatenate(point.unknowns)
    return IqcProof(
        kinds, basis.pole, basis.order, inequality.n, judged.slack, judged.rounding, judged.highest, point.P, unknowns
    )
