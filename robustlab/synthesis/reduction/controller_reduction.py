"""Reduction of controllers to the lowest order whose rebuilt closed loop has a proved loss within the allowed one.

The controller blocks of the closed loop's Gramians measure how much w moves each state of K, and how much each state
of K moves z: Anderson, Liu, "Controller reduction: concepts and approaches", IEEE TAC 34 (1989); Goddard, Glover 1998.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, NamedTuple, get_args

import numpy as np

from robustlab.arrays import AnyArray
from robustlab.budget import dense, one_thread
from robustlab.checks import number, whole
from robustlab.display import AllFields, Facts
from robustlab.errors import InputError, NoTrustworthyNumber, error_context
from robustlab.result import Status, Table, Tabular
from robustlab.statespace import StateSpaceModel, as_model, lower_lft, parallel
from robustlab.synthesis.hinf.loop_shaping import with_default_performance
from robustlab.synthesis.problem.certify import Evidence, MeasureName, Performance, PerformanceMeasure, make_measure
from robustlab.synthesis.problem.design import Synthesis, design_budget, final_status, limiting_channels, relative_loss
from robustlab.synthesis.problem.generalized_plant import GeneralizedPlant, as_generalized_plant
from robustlab.synthesis.reduction.balancing import Balancing, Projection, block_factor, gramian_factors, split_stable
from robustlab.uncertainty.blocks import Block

PATIENCE = 3  # orders tried after the first that loses too much: the loss is not monotone in the order
GAIN = 1e-3  # smallest relative gain for which another candidate of the same order is proved

WHERE = "reduce_controller"
Found = tuple[str, StateSpaceModel, Performance]


@dataclass(frozen=True)
class OrderTried(AllFields):
    """The best controller that was found of one order."""

    order: int  # its number of states
    method: str  # its method; empty where none of this order left the loop stable
    value: float  # verified upper bound of the measure; inf where the loop is not stable
    loss: float  # `value / value of the full controller - 1`
    status: Status  # how much `value` can be trusted


@dataclass(frozen=True, eq=False, kw_only=True)
class ReducedController(Tabular, Synthesis):
    """A controller of lower order; ``gamma`` is the measure of the loop rebuilt from it, verified."""

    quantities = dict.fromkeys(("original_order", "original_gamma", "loss", "allowed_loss"), float)
    saved = (
        "measure", "original_order", "original_gamma", "loss", "allowed_loss", "orders", "evidence", "original",
    )  # fmt: skip

    original: StateSpaceModel  # the controller that was reduced
    original_gamma: float  # the measure of its loop, verified in the same way
    measure: str  # in words
    allowed_loss: float
    orders: tuple[OrderTried, ...]  # the loss of each order, the highest first: the evidence for the order chosen
    evidence: Evidence  # the proof of `gamma`: a norm's bracket, or the margin with its scalings
    scaled: GeneralizedPlant | None = None  # the plant with the scalings of the design, whose loop has the norm `gamma`

    @property
    def original_order(self) -> int:
        return self.original.n_states

    @property
    def loss(self) -> float:
        """``gamma / original_gamma - 1``."""
        return relative_loss(self.gamma, self.original_gamma)

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
        columns = {key: [getattr(tried, key) for tried in self.orders] for key in ("method", "value", "loss")}
        return Table(("order", [tried.order for tried in self.orders]), columns)


@error_context("reduce_controller")
def reduce_controller(
    design_or_plant: Any,
    K: Any = None,
    *,
    loss: float = 0.01,
    order: int | None = None,
    measure: MeasureName | None = None,
    blocks: Sequence[Block] | None = None,
    n_meas: int | None = None,
    n_con: int | None = None,
    time_limit: float | None = None,
    effort: float = 1.0,
    progress: Callable[[str], None] | None = None,
) -> ReducedController:
    r"""Find the controller of lowest order whose verified loss against the full controller is at most ``loss``.

    .. math:: \min \text{order}(K_r) \quad \text{with} \quad J(F_l(P, K_r)) \le (1 + \text{loss}) \, J(F_l(P, K))

    Candidates of every order come from the controller's blocks of the closed loop's Gramians, for disturbances and for
    measurement noise, and from balanced truncation of K; each truncated and residualised. The loop of every candidate
    is rebuilt, and J of the best one is proved anew.

    Parameters
    ----------
    design_or_plant
        A `Synthesis`, whose plant and controller are used; or a generalised plant (see `hinf`), with K. Of a bare
        plant, whose every input is a control and every output a measurement, the four-block gain of the loop is the
        measure: from noise on y and a disturbance on u to y and u (its inverse is the coprime margin).
    K
        The controller to reduce, where it is not that of the design: ``u = K y`` with *positive* feedback. For negative
        feedback, ``u = -C y``, take ``K = -C``.
    loss, order
        Largest loss allowed, as a share; or the requested order, whose loss is then reported.
    measure
        J: ``"hinf"`` or ``"h2"`` norm of the closed loop, or ``"mu"``: robust performance at all frequencies. Where
        left out: ``"mu"`` where the design has scalings, ``"h2"`` for an H2 design, else ``"hinf"``.
    blocks
        For ``"mu"``: perturbation blocks of the plant's first channels (those of the design or the plant where left
        out). J is the scaled norm with the scalings of a design (quick); where it has none, or they include G for real
        blocks, the mu analysis finds its own for every candidate (slow).
    n_meas, n_con, time_limit, effort, progress
        As for `robustlab.hinf`; the lowest order verified by the time limit is returned.

    Returns
    -------
    ReducedController
        K itself with a loss of zero where no lower order keeps the loss; see ``reason``.

    Raises
    ------
    InputError, NoTrustworthyNumber
        A K or blocks that do not fit, a negative loss, a plant with w but no z or the other way round. The loop with
        the full K is not stable (the message names the other sign of K if that helps), or its measure is not
        trustworthy; or no controller of the requested ``order`` leaves the loop stable.
    """
    if K is None and not isinstance(design_or_plant, Synthesis):
        raise InputError(WHERE, "K is missing", "a design, or a plant and its controller")
    full = as_model(getattr(design_or_plant if K is None else K, "K", K), f"{WHERE}: K")
    if isinstance(design_or_plant, Synthesis):
        plant = as_generalized_plant(design_or_plant.plant, n_meas, n_con, WHERE)
    else:
        plant = as_generalized_plant(design_or_plant, n_meas or full.n_inputs, n_con or full.n_outputs, WHERE)
    full = plant.fitted(full, WHERE)
    plant = with_default_performance(plant, WHERE)
    number(f"{WHERE}: loss", loss, "a number >= 0 (0.01: one per cent)", at_least=0)
    budget = design_budget(WHERE, effort, time_limit)
    if order is not None:
        whole(f"{WHERE}: order", order, 0, full.n_states)
    scalings = None
    if measure in (None, "mu"):
        scalings = getattr(design_or_plant, "scalings", None)
        if getattr(scalings, "mixed", False):  # they include G, and bound no norm
            scalings, blocks = None, vars(design_or_plant)["blocks"] if blocks is None else blocks
    norm = "h2" if getattr(design_or_plant, "method", "") == "h2" else "hinf"
    name = measure or ("mu" if scalings is not None or blocks is not None else norm)
    judge = make_measure(plant, name, blocks, scalings, WHERE, budget)
    with one_thread():
        return _descended(judge, full, loss, order, progress or (lambda _: None))


def _sign_hint(plant: GeneralizedPlant, K: StateSpaceModel) -> str:
    """Return the sign convention, and whether the other sign makes the loop stable."""
    text = "K acts as u = K y, positive feedback"
    try:
        turned = plant.close(StateSpaceModel(K.A, K.B, -K.C, -K.D, K.dt))
    except InputError:
        return text
    return f"{text}; with u = -K y the loop is stable: give -K" if turned.is_stable() else text


def _descended(
    judge: PerformanceMeasure, full: StateSpaceModel, allowed: float, order: int | None, report: Callable[[str], None]
) -> ReducedController:
    """Reduce order by order, down to the requested one, or until PATIENCE orders in a row lose too much."""
    reference, budget, plant = judge.certified(full), judge.budget, judge.gramian_plant
    if not np.isfinite(reference.value) or not reference.status.trustworthy:
        reason = getattr(reference.evidence, "reason", "") or reference.doubt or reference.status
        text = f"the loop with the full controller has no trustworthy {judge.text} ({reason})"
        hint = None if judge.plant.close(full).is_stable() else _sign_hint(judge.plant, full)
        raise NoTrustworthyNumber(WHERE, text, hint=hint)
    limit = np.inf if order is not None else (1 + allowed) * reference.value
    families, tried = _families(plant, full), list[OrderTried]()
    how, chosen, performance, failed = "", full, reference, 0
    stage = full  # the best of the order before: its loop gives further candidates
    for n in range(full.n_states - 1, (order or 0) - 1, -1):
        if (order is None and failed == PATIENCE) or budget.over:
            break
        again = stage is not full and stage.n_states > n
        budget.spend(dense(plant.model.n_states + stage.n_states, 5 if again else 1))
        more = [f._replace(name=f"{f.name}, step by step") for f in _families(plant, stage)] if again else []
        found = _best(judge, full, [*families, *more], n, limit)
        enough, stage = False, full if found is None else found[1]
        if found is None:
            tried.append(OrderTried(n, "", np.inf, np.inf, Status.CONVERGED))
            report(f"order {n}: none stabilises the loop")
        else:
            method, K, proved = found
            loss = relative_loss(proved.value, reference.value)
            enough = proved.value <= limit and proved.status.trustworthy
            tried.append(OrderTried(K.n_states, method, proved.value, loss, proved.status))
            report(f"order {K.n_states}: {judge.name} {proved.value:.6g}, loss {100 * loss:.3g} % ({method})")
            if enough and order in (None, n):
                how, chosen, performance = found
        failed = 0 if enough else failed + 1
    if order is not None and chosen is full and order < full.n_states:
        text = f"no controller of order {order} could be verified{f' ({budget.remark})' if budget.remark else ''}"
        raise NoTrustworthyNumber(WHERE, text, hint="a higher order")
    reason = f"{how}; loop rebuilt, {judge.text} proved anew" if how else "no lower order keeps the loss allowed"
    status, reason = final_status(performance.status, [reason], budget, "a lower order")
    loop = judge.plant.close(chosen)
    measured = loop if judge.scaled is None else judge.scaled.close(chosen)
    peaks = judge.name != "h2" and performance.frequency >= 0
    return ReducedController(
        K=chosen, gamma=performance.value, closed_loop=loop, status=status, reason=reason,
        limit=limiting_channels(measured, performance.frequency) if peaks else "", plant=judge.plant,
        method=f"reduced {judge.name}", original=full, original_gamma=reference.value, measure=judge.text,
        allowed_loss=allowed, orders=tuple(tried), evidence=performance.evidence, scaled=judge.scaled,
    )  # fmt: skip


def _best(
    judge: PerformanceMeasure, full: StateSpaceModel, families: list[Family], order: int, limit: float
) -> Found | None:
    """Return the candidate of best verified measure; None if none of this order leaves the loop stable."""
    estimated: list[tuple[float, str, StateSpaceModel]] = []
    for family in families:
        if not family.least <= order <= family.most or judge.budget.over:
            continue
        with suppress(NoTrustworthyNumber, InputError):
            made = family.make(order)
            names = [f"k{i + 1}" for i in range(made.n_states)]
            K = StateSpaceModel(made.A, made.B, made.C, made.D, full.dt, full.inputs, full.outputs, names)
            estimated.append((judge.estimate(K), family.name, K))
    best: Found | None = None
    for estimate, name, K in sorted(estimated, key=lambda entry: entry[0]):
        if not np.isfinite(estimate) or (best is not None and estimate >= min(best[2].value, limit)):
            break
        with suppress(NoTrustworthyNumber, InputError):
            value = judge.certified(K)
            rank = not value.status.trustworthy, value.value
            if np.isfinite(value.value) and (best is None or rank < (not best[2].status.trustworthy, best[2].value)):
                best = (name, K, value)
        if best is not None and best[2].value <= min(limit, estimate * (1 + GAIN)):
            break  # the others gain less than GAIN
    return best


# --- candidates ---------------------------------------------------------------------------------------------------


class Family(NamedTuple):
    """A method to reduce K: the lowest and highest order, and the function from an order to the controller."""

    name: str
    least: int
    most: int
    make: Callable[[int], StateSpaceModel]


def _families(plant: GeneralizedPlant, K: StateSpaceModel) -> list[Family]:
    """Return the methods that apply to K and its loop; ``plant`` includes weights and scalings."""
    K, found = StateSpaceModel(K.A, K.B, K.C, K.D, K.dt), list[Family]()

    def add(name: str, reach: AnyArray, see: AnyArray, model: StateSpaceModel, apart: StateSpaceModel) -> None:
        """Add both projections of a model that these factors of Gramians balance, ``apart`` in parallel to it."""
        balancing, more = Balancing.of(reach, see), apart.n_states
        for kind in get_args(Projection):

            def make(order: int, kind: Projection = kind) -> StateSpaceModel:
                small = balancing.reduced(model, order - more, kind)
                return parallel(small, apart) if more else small

            found.append(Family(f"{name}, {kind}", more, more + len(balancing.left), make))

    def of_loop(name: str, closed: StateSpaceModel) -> None:
        """Add reductions by the controller's blocks in the Gramians of a loop whose last states are those of K."""
        own = slice(closed.n_states - K.n_states, None)
        reach, see = (block_factor(factor[own]) for factor in gramian_factors(closed))
        add(name, reach, see, K, StateSpaceModel([], [], [], 0 * K.D, K.dt))

    m, n_w, n_z = plant.model, plant.n_w, plant.n_z
    # Each is added if its Gramians exist for this K and keep their digits. Of 14 controllers four end with a state or
    # two more without the second, the plainly balanced ones and those step by step.
    with suppress(NoTrustworthyNumber, InputError):
        of_loop("closed-loop Gramians", plant.close(K))
    with suppress(NoTrustworthyNumber, InputError):
        B = np.hstack([np.zeros((m.n_states, plant.n_meas)), m.B[:, n_w:]])
        C = np.vstack([np.zeros((plant.n_con, m.n_states)), m.C[n_z:]])
        D = np.block([[np.zeros((plant.n_con, plant.n_meas)), np.eye(plant.n_con)], [np.eye(plant.n_meas), plant.D22]])
        of_loop("loop from measurement noise to control", lower_lft(StateSpaceModel(m.A, B, C, D, m.dt), K))
    with suppress(NoTrustworthyNumber, InputError):
        split = split_stable(K)
        add("balanced", *gramian_factors(split.stable), split.stable, split.apart)
    return found
