r"""Reduction of controllers to the lowest order whose closed loop, rebuilt and proved anew, loses no more than said.

What in K matters is told by the loop it works in. With the closed loop's controllability and observability Gramians
split into plant and controller, their controller blocks tell how much w moves each state of K, and how much each state
of K moves z. Other candidates weight K with

.. math:: T_{yw} = (I - P_{22} K)^{-1} P_{21}, \qquad T_{zu} = P_{12} (I - K P_{22})^{-1}

because a change of K by a small E changes the closed loop by ``T_zu E T_yw``.

References
----------
Anderson, Liu, "Controller reduction: concepts and approaches", IEEE TAC 34 (1989); Enns (1984); Zhou, Doyle, Glover
(1996), chapter 19.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from robustlab.budget import MILLION, Budget, dense, one_thread
from robustlab.closing import wired
from robustlab.errors import InputError, NoTrustworthyNumber, told_as
from robustlab.result import Status
from robustlab.shown import Facts
from robustlab.statespace import StateSpaceModel, as_model, lower_lft
from robustlab.synthesis.hinf.loop_shaping import with_default_performance
from robustlab.synthesis.nonsmooth.parameter_search import descend
from robustlab.synthesis.problem.design import Synthesis, design_budget, limiting_channels, told
from robustlab.synthesis.problem.partition import GeneralizedPlant, as_generalized_plant
from robustlab.synthesis.problem.performance_measure import (
    Evidence,
    MeasureName,
    Performance,
    PerformanceMeasure,
    make_measure,
)
from robustlab.synthesis.reduction.balancing import (
    Balancing,
    Projection,
    SplitModel,
    block_factor,
    gramian_factors,
    split_stable,
)
from robustlab.synthesis.reduction.coprime_reduction import CoprimeReduction
from robustlab.synthesis.reduction.model_reduction import weighted_factors
from robustlab.tables import Table, Tabular
from robustlab.uncertainty.blocks import Block

WORK = 60 * MILLION  # the usual work at effort 1, in units of about a microsecond
PATIENCE = 3  # the loss is not monotone in the order: orders tried after the first that loses too much
WORTH_IMPROVING = 10.0  # candidates up to this multiple of the loss allowed are worth an improvement ...
IMPROVEMENT_SHARE = 0.25  # ... and each gets this share of the work left
GAIN = 1e-3  # relative gain that makes another candidate of the same order worth a proof

__all__ = ["OrderTried", "ReducedController", "reduce_controller"]

WHERE = "reduce_controller"
Improvement = Callable[[GeneralizedPlant, StateSpaceModel, Budget], StateSpaceModel]
Found = tuple[str, StateSpaceModel, Performance]


@dataclass(frozen=True)
class OrderTried:
    """The best controller that was found of one order.

    Attributes
    ----------
    order
        Its number of states.
    method
        What made it; empty where none of this order left the loop stable.
    value
        Verified upper bound of the measure; inf where the loop is not stable.
    loss
        ``value / value of the full controller - 1``.
    status
        How much ``value`` can be trusted.
    """

    order: int
    method: str
    value: float
    loss: float
    status: Status

    def to_json(self) -> dict[str, Any]:
        return vars(self).copy()


@dataclass(frozen=True, eq=False, kw_only=True)
class ReducedController(Tabular, Synthesis):
    """A controller of lower order; ``gamma`` is the measure of the loop rebuilt from it, verified.

    Attributes
    ----------
    original
        The controller that was reduced.
    original_gamma
        The measure of its loop, verified in the same way.
    measure
        What was measured, in words.
    allowed_loss
        The loss that was allowed.
    orders
        What each order costs, the highest first: the evidence for the order chosen.
    evidence
        What proves ``gamma``: a norm's bracket, or the margin with its scalings.
    scaled
        The plant with the scalings given, whose loop has the norm ``gamma``; None without them.
    """

    quantities: ClassVar[Mapping[str, Any]] = {
        **Synthesis.quantities, **dict.fromkeys(("original_order", "original_gamma", "loss", "allowed_loss"), float),
    }  # fmt: skip

    original: StateSpaceModel
    original_gamma: float
    measure: str
    allowed_loss: float
    orders: tuple[OrderTried, ...]
    evidence: Evidence
    scaled: GeneralizedPlant | None = None

    @property
    def original_order(self) -> int:
        """Number of states of the controller that was reduced."""
        return self.original.n_states

    @property
    def loss(self) -> float:
        """``gamma / original_gamma - 1``."""
        return _loss(self.gamma, self.original_gamma)

    def facts(self) -> Facts:
        rows = super().facts()
        tried = [(o.order, "not stable" if np.isinf(o.value) else f"{100 * o.loss:+.2g} %") for o in self.orders]
        return [
            ("measure", self.measure),
            ("order", f"{self.original.n_states} -> {self.K.n_states} states"),
            ("loss", f"{100 * self.loss:.3g} % of {self.original_gamma:.6g} (allowed: {100 * self.allowed_loss:g} %)"),
            *rows,
            ("loss by order", ", ".join(f"{order}: {text}" for order, text in tried)),
        ]

    def table(self) -> Table:
        """A row for each order that was tried."""
        columns = {key: [getattr(tried, key) for tried in self.orders] for key in ("method", "value", "loss")}
        return Table(("order", [tried.order for tried in self.orders]), columns)

    def to_json(self) -> dict[str, Any]:
        return super().to_json() | {
            "measure": self.measure,
            "original_order": self.original_order,
            "original_gamma": self.original_gamma,
            "loss": self.loss,
            "allowed_loss": self.allowed_loss,
            "orders": [tried.to_json() for tried in self.orders],
            "evidence": self.evidence.to_json(),
            "original": self.original.to_json(),
        }


@told_as("reduce_controller")
def reduce_controller(
    design_or_plant: Any,
    K: Any = None,
    *,
    loss: float = 0.01,
    order: int | None = None,
    measure: MeasureName | None = None,
    blocks: Sequence[Block] | None = None,
    scalings: Any = None,
    n_meas: int | None = None,
    n_con: int | None = None,
    improve: Improvement | None = descend,
    time_limit: float | None = None,
    effort: float = 1.0,
    progress: Callable[[str], None] | None = None,
) -> ReducedController:
    r"""The controller of lowest order whose verified closed loop is at most ``1 + loss`` times as bad as the full one.

    .. math:: \min \text{order}(K_r) \quad \text{with} \quad J(F_l(P, K_r)) \le (1 + \text{loss}) \, J(F_l(P, K))

    Candidates of every order come from the controller's blocks of the closed loop's Gramians, from balanced coprime
    factors of K, and from balanced truncation of K with the loop as weights on both sides; each truncated and
    residualised. The loop of every candidate is rebuilt, and J of the best one is proved anew.

    Parameters
    ----------
    design_or_plant
        A `Synthesis`, whose plant and controller are taken; or a generalised plant (see `hinf`), with K. Of a bare
        plant, whose every input is a control and every output a measurement, the four-block gain of the loop is the
        measure: from noise on y and a disturbance on u to y and u (its inverse is the coprime margin).
    K
        The controller to reduce, where it is not that of the design: ``u = K y`` with *positive* feedback, as
        everywhere in this package. For negative feedback, ``u = -C y``, take ``K = -C``.
    loss
        Largest loss allowed, as a share.
    order
        The order wanted, in place of the lowest one; the loss is then reported, whatever it is.
    measure
        J: ``"hinf"`` or ``"h2"`` norm of the closed loop, or ``"mu"``: robust performance at all frequencies. Where
        left out: ``"mu"`` where scalings are given or the design brings them, ``"h2"`` for an H2 design, else
        ``"hinf"``.
    blocks
        Perturbation blocks of the plant's first channels, for ``"mu"``; those of the design or the plant where left
        out.
    scalings
        For ``"mu"``: the pair of stable models ``(D_z, D_w^-1)`` that commute with the perturbation, whose scaled norm
        then is J (quick); where left out the mu analysis finds its own scalings for every candidate (slow), also for
        a design whose scalings hold G for real blocks.
    n_meas, n_con
        Numbers of measurements and controls, where a plain plant is given.
    improve
        Called as ``improve(plant, K_r, budget)`` with the (scaled) plant and the best controller of an order that
        loses too much, but less than ten times the loss allowed; what comes back, a controller of that order with a
        smaller H-infinity norm, is verified like any other. Nonsmooth descent where left out; None for nothing. Not
        called for H2, nor for ``"mu"`` without scalings.
    time_limit
        Time in s, asked between candidates; none where left out. The lowest order verified by then is returned, with
        status TIMEOUT.
    effort
        Multiple of the usual work. The search counts what it does, so that it ends the same way everywhere.
    progress
        Called with one line for each order.

    Returns
    -------
    ReducedController
        Where no lower order is good enough, K itself with a loss of zero, and ``reason`` says so.

    Raises
    ------
    InputError
        A K that does not fit, a negative loss, blocks that do not fit, a plant with disturbances but no performance
        outputs or the other way round.
    NoTrustworthyNumber
        The loop with the full K is not stable (the message says whether it is with the other sign of K), or its measure
        cannot be vouched for; or no controller of the ``order`` wanted left the loop stable.

    References
    ----------
    Anderson, Liu 1989; Goddard, Glover 1998 (performance preserving reduction); Enns 1984.

    Examples
    --------
    >>> from robustlab.synthesis.hinf.hinf_synthesis import hinf
    >>> P = StateSpaceModel([[-1.0]], [[1.0, 0.0, 1.0]], [[1.0], [0.0], [1.0]], [[0, 0, 0], [0, 0, 1], [0, 1, 0]])
    >>> small = reduce_controller(hinf(P, 1, 1), loss=0.1)
    >>> small.K.n_states, small.loss <= 0.1, small.status.value
    (0, True, 'certified')
    """
    plant, full = _plant_and_controller(design_or_plant, K, n_meas, n_con)
    if not 0 <= loss < np.inf:
        raise InputError(WHERE, f"loss is {loss}", "a number >= 0 (0.01: one per cent)")
    budget = design_budget(WHERE, WORK, effort, time_limit)
    if order is not None and (
        isinstance(order, bool) or not isinstance(order, (int, np.integer)) or not 0 <= order <= full.n_states
    ):
        raise InputError(WHERE, f"order is {order!r}", f"a whole number from 0 to {full.n_states}")
    if scalings is None and measure in (None, "mu"):
        scalings, blocks = _of_design(design_or_plant, blocks)
    name = measure or _default_measure(design_or_plant, scalings, blocks)
    judge = make_measure(plant, name, blocks, scalings, WHERE, budget)
    with one_thread():
        return _Descent(judge, full, loss, order, improve, progress or (lambda _: None)).run()


def _plant_and_controller(
    given: Any, K: Any, n_meas: int | None, n_con: int | None
) -> tuple[GeneralizedPlant, StateSpaceModel]:
    if isinstance(given, Synthesis):
        plant = as_generalized_plant(given.plant, n_meas, n_con, WHERE)
        full = given.K if K is None else as_model(getattr(K, "K", K), f"{WHERE}: K")
    elif K is None:
        raise InputError(WHERE, "K is missing", "a design, or a plant and its controller")
    else:
        full = as_model(getattr(K, "K", K), f"{WHERE}: K")
        plant = as_generalized_plant(given, n_meas or full.n_inputs, n_con or full.n_outputs, WHERE)
    if (full.n_outputs, full.n_inputs) != (plant.n_con, plant.n_meas):
        raise InputError(WHERE, f"K is {full.n_outputs} x {full.n_inputs}", f"{plant.n_con} x {plant.n_meas}")
    full = wired(full, plant.measurements, plant.controls, WHERE)
    return with_default_performance(plant, WHERE), full


def _of_design(given: Any, blocks: Sequence[Block] | None) -> tuple[Any, Sequence[Block] | None]:
    """The scalings that a design brings, or its blocks where they hold G and so bound no norm."""
    scalings = getattr(given, "scalings", None)
    if not getattr(scalings, "mixed", False):
        return scalings, blocks
    return None, given.blocks if blocks is None else blocks


def _default_measure(given: Any, scalings: Any, blocks: Sequence[Block] | None) -> MeasureName:
    if scalings is not None or blocks is not None:
        return "mu"
    return "h2" if getattr(given, "method", "") == "h2" else "hinf"


def _sign_hint(plant: GeneralizedPlant, K: StateSpaceModel) -> str:
    """The convention, and whether the other sign is what was meant."""
    text = "K acts as u = K y, positive feedback"
    try:
        turned = plant.close(StateSpaceModel(K.A, K.B, -K.C, -K.D, K.dt))
    except InputError:
        return text
    return f"{text}; with u = -K y the loop is stable: give -K" if turned.is_stable() else text


def _loss(value: float, reference: float) -> float:
    return 0.0 if value == reference else value / reference - 1 if reference > 0 else np.inf


class _Descent:
    """The way down from the full order, with the lowest order that is good enough so far."""

    def __init__(
        self,
        judge: PerformanceMeasure,
        full: StateSpaceModel,
        allowed: float,
        order: int | None,
        improve: Improvement | None,
        progress: Callable[[str], None],
    ) -> None:
        self.judge, self.full, self.allowed, self.order, self.budget = judge, full, allowed, order, judge.budget
        self.improve = improve if judge.name == "hinf" or judge.scaled is not None else None
        self.progress = progress
        self.reference = judge.certified(full)
        if not np.isfinite(self.reference.value) or not self.reference.status.trustworthy:
            reason = getattr(self.reference.evidence, "reason", "") or self.reference.doubt or self.reference.status
            raise NoTrustworthyNumber(
                WHERE,
                f"the loop with the full controller has no trustworthy {judge.text} ({reason})",
                hint=None if judge.plant.close(full).is_stable() else _sign_hint(judge.plant, full),
            )
        self.limit = np.inf if order is not None else (1 + allowed) * self.reference.value
        self.families = candidate_families(judge.gramian_plant, full)

    def run(self) -> ReducedController:
        """Order by order; the search ends at the order wanted, or where three orders in a row lose too much."""
        tried: list[OrderTried] = []
        chosen, performance, failed = self.full, self.reference, 0
        stage = self.full  # the best of the order before: what matters in its loop is a second way down
        for n in range(self.full.n_states - 1, (self.order or 0) - 1, -1):
            if (self.order is None and failed == PATIENCE) or self.budget.over:
                break
            again = stage is not self.full and stage.n_states > n
            self.budget.spend(dense(self.judge.gramian_plant.model.n_states + stage.n_states, 5 if again else 1))
            more = candidate_families(self.judge.gramian_plant, stage) if again else []
            more = [replace(family, name=f"{family.name}, step by step") for family in more]
            found = self._improved(self._best([*self.families, *more], n), n)
            stage = self.full if found is None else found[1]
            tried.append(self._tried(n, found))
            self.progress(_line(tried[-1], self.judge.name))
            enough = found is not None and found[2].value <= self.limit and found[2].status.trustworthy
            failed = 0 if enough else failed + 1
            if found is not None and enough and self.order in (None, n):
                chosen, performance = found[1], found[2]
        if self.order is not None and chosen is self.full and self.order < self.full.n_states:
            ended = f" ({self.budget.remark})" if self.budget.remark else ""
            text = f"no controller of order {self.order} could be verified{ended}"
            raise NoTrustworthyNumber(WHERE, text, hint="a higher order")
        return self._finished(chosen, performance, tried)

    def _best(self, families: list[CandidateFamily], order: int) -> Found | None:
        """The candidate of best verified measure; None where none of this order leaves the loop stable."""
        full = self.full
        estimated: list[tuple[float, str, StateSpaceModel]] = []
        for family in families:
            if not family.least <= order <= family.most or self.judge.budget.over:
                continue
            try:
                made = family.make(order)
            except (NoTrustworthyNumber, InputError):
                continue
            named = StateSpaceModel(
                made.A, made.B, made.C, made.D, full.dt, full.inputs, full.outputs,
                [f"k{i + 1}" for i in range(made.n_states)],
            )  # fmt: skip
            estimated.append((self.judge.estimate(named), family.name, named))
        best: Found | None = None
        for estimate, name, K in sorted(estimated, key=lambda entry: entry[0]):
            if not np.isfinite(estimate) or (best is not None and estimate >= min(best[2].value, self.limit)):
                break
            try:
                value = self.judge.certified(K)
            except (InputError, NoTrustworthyNumber):
                continue
            if not np.isfinite(value.value):
                continue
            if best is None or _rank(value) < _rank(best[2]):
                best = (name, K, value)
            if best[2].value <= self.limit and best[2].value <= estimate * (1 + GAIN):
                break  # what the others can gain is not worth a proof
        return best

    def _tried(self, order: int, found: Found | None) -> OrderTried:
        if found is None:
            return OrderTried(order, "", np.inf, np.inf, Status.CONVERGED)
        method, K, value = found
        return OrderTried(K.n_states, method, value.value, _loss(value.value, self.reference.value), value.status)

    def _improved(self, found: Found | None, order: int) -> Found | None:
        """What ``improve`` makes of a controller that is almost good enough, where that is better."""
        if found is None or self.improve is None:
            return found
        name, K, value = found
        most = (1 + WORTH_IMPROVING * self.allowed) * self.reference.value
        if order != self.order if self.order is not None else not self.limit < value.value <= most:
            return found
        if self.budget.over:
            return found
        better = self.improve(self.judge.gramian_plant, K, self.budget.share(IMPROVEMENT_SHARE))
        if better.n_states > K.n_states:
            return found
        named = StateSpaceModel(better.A, better.B, better.C, better.D, K.dt, K.inputs, K.outputs)
        try:
            verified = self.judge.certified(named)
        except (InputError, NoTrustworthyNumber):
            return found
        return (f"{name}, improved", named, verified) if verified.value < value.value else found

    def _finished(
        self, chosen: StateSpaceModel, performance: Performance, tried: list[OrderTried]
    ) -> ReducedController:
        judge = self.judge
        loop = judge.plant.close(chosen)
        how = next((o.method for o in reversed(tried) if o.value == performance.value and chosen is not self.full), "")
        reason = f"{how}; loop rebuilt, {judge.text} proved anew" if how else "no lower order keeps the loss allowed"
        status, reason = told(performance.status, [reason], judge.budget, "a lower order")
        shown = loop if judge.scaled is None else judge.scaled.close(chosen)
        limit = (
            limiting_channels(shown, performance.frequency) if judge.name != "h2" and performance.frequency >= 0 else ""
        )
        return ReducedController(
            K=chosen,
            gamma=performance.value,
            closed_loop=loop,
            status=status,
            reason=reason,
            limit=limit,
            plant=judge.plant,
            method=f"reduced {judge.name}",
            original=self.full,
            original_gamma=self.reference.value,
            measure=judge.text,
            allowed_loss=self.allowed,
            orders=tuple(tried),
            evidence=performance.evidence,
            scaled=judge.scaled,
        )


def _rank(value: Performance) -> tuple[bool, float]:
    return not value.status.trustworthy, value.value


def _line(tried: OrderTried, name: str) -> str:
    if not np.isfinite(tried.value):
        return f"order {tried.order}: none stabilises the loop"
    return f"order {tried.order}: {name} {tried.value:.6g}, loss {100 * tried.loss:.3g} % ({tried.method})"


# --- candidates ---------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class CandidateFamily:
    """A way to reduce K: its name, the lowest and highest order it offers, and what makes the controller of an order.

    ``make`` raises `NoTrustworthyNumber` or `InputError` where there is no such controller.
    """

    name: str
    least: int
    most: int
    make: Callable[[int], StateSpaceModel]


def candidate_families(plant: GeneralizedPlant, K: StateSpaceModel) -> list[CandidateFamily]:
    """All ways that K and the loop admit; ``plant`` carries the weights and scalings that count."""
    K = StateSpaceModel(K.A, K.B, K.C, K.D, K.dt)
    return _tried(
        lambda: _projected("closed-loop Gramians", _of_loop(plant.close(K), K), K),
        lambda: _projected("loop from measurement noise to control", _of_loop(_signal_loop(plant, K), K), K),
        lambda: [_coprime(K)],
        lambda: _weighted(plant, K),
    )


def _tried(*ways: Callable[[], list[CandidateFamily]]) -> list[CandidateFamily]:
    """What the ways give; nothing for one whose Gramians do not exist for this K, or lost their digits."""
    families: list[CandidateFamily] = []
    for way in ways:
        with suppress(NoTrustworthyNumber, InputError):
            families += way()
    return families


def _projected(
    name: str, balancing: Balancing, model: StateSpaceModel, split: SplitModel | None = None
) -> list[CandidateFamily]:
    """Both projections of a balanced model; ``split``: of which it is the stable part."""
    apart = 0 if split is None else split.apart.n_states

    def family(kind: Projection) -> CandidateFamily:
        def make(order: int) -> StateSpaceModel:
            small = balancing.reduced(model, order - apart, kind)
            return small if split is None else split.joined(small)

        return CandidateFamily(f"{name}, {kind}", apart, apart + len(balancing.left), make)

    return [family("truncation"), family("residualisation")]


def _of_loop(loop: StateSpaceModel, K: StateSpaceModel) -> Balancing:
    """Balancing of the controller's blocks in the Gramians of a loop whose last states are those of K."""
    reach, see = gramian_factors(loop)
    k = slice(loop.n_states - K.n_states, None)
    return Balancing.of(block_factor(reach[k]), block_factor(see[k]))


def _signal_loop(plant: GeneralizedPlant, K: StateSpaceModel) -> StateSpaceModel:
    """From noise on the measurements to the controls, in the loop of plant and K."""
    m, n_y, n_u = plant.model, plant.n_meas, plant.n_con
    b, c = m.B[:, m.n_inputs - n_u :], m.C[m.n_outputs - n_y :]
    P = StateSpaceModel(
        m.A, np.hstack([np.zeros((m.n_states, n_y)), b]), np.vstack([np.zeros((n_u, m.n_states)), c]),
        np.block([[np.zeros((n_u, n_y)), np.eye(n_u)], [np.eye(n_y), plant.D22]]), m.dt,
    )  # fmt: skip
    return lower_lft(P, K)


def _coprime(K: StateSpaceModel) -> CandidateFamily:
    reduction = CoprimeReduction(K)
    return CandidateFamily("normalised coprime factors", 0, len(reduction.balancing.left), reduction.reduced)


def _weighted(plant: GeneralizedPlant, K: StateSpaceModel) -> list[CandidateFamily]:
    """Balanced truncation of K's stable part, plain and with the loop as weights on either side."""
    split = split_stable(K)
    if not split.stable.n_states:
        return []
    stable = split.stable
    into, out = _sensitivity_weights(plant, K)
    return _tried(
        lambda: _projected("balanced", Balancing.of(*weighted_factors(stable, None, None)), stable, split),
        lambda: _projected(
            "weighted by the loop on both sides", Balancing.of(*weighted_factors(stable, into, out)), stable, split
        ),
    )


def _sensitivity_weights(plant: GeneralizedPlant, K: StateSpaceModel) -> tuple[StateSpaceModel, StateSpaceModel]:
    """``T_yw`` and ``T_zu``."""
    m, n_y, n_u = plant.model, plant.n_meas, plant.n_con
    n_w, n_z = m.n_inputs - n_u, m.n_outputs - n_y
    b1, b2, c1, c2 = m.B[:, :n_w], m.B[:, n_w:], m.C[:n_z], m.C[n_z:]
    d12, d21, d22 = m.D[:n_z, n_w:], m.D[n_z:, :n_w], plant.D22
    seen = StateSpaceModel(
        m.A, np.hstack([b1, b2]), np.vstack([c2, c2]), np.block([[d21, d22], [d21, d22]]), m.dt
    )  # the measurements once more as outputs
    moved = StateSpaceModel(
        m.A, np.hstack([b2, b2]), np.vstack([c1, c2]), np.block([[d12, d12], [d22, d22]]), m.dt
    )  # a disturbance on the controls as input
    return lower_lft(seen, K), lower_lft(moved, K)
