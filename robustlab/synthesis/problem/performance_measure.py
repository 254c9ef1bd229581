"""Measures of a closed loop: its H-infinity norm, its H2 norm, or its robust performance, each with its proof."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from robustlab.budget import MILLION, Budget, dense
from robustlab.errors import InputError, NoTrustworthyNumber
from robustlab.linear_analysis.frequency import default_grid, frequency_response
from robustlab.mu_analysis.axis.margin import PERFORMANCE, Margin
from robustlab.mu_analysis.axis.robustness import margin_within, with_performance
from robustlab.mu_analysis.matrix.bounds import mu
from robustlab.mu_analysis.matrix.upper import points_work
from robustlab.norms import H2Norm, HinfNorm, bilinear_to_discrete, h2_by_gramians, hinf_norm
from robustlab.result import Status
from robustlab.statespace import StateSpaceModel, append, as_model, series
from robustlab.synthesis.problem.certify import certified
from robustlab.synthesis.problem.partition import GeneralizedPlant
from robustlab.uncertainty.blocks import Block, FullBlock, structure_size
from robustlab.uncertainty.lft import UncertainModel

# Points of the grid on which candidates are compared before the proof.
MEASURE_GRID = 60
# Most work of the proof of one candidate without scalings.
MARGIN_WORK = 30 * MILLION

MeasureName = Literal["hinf", "h2", "mu"]
Evidence = HinfNorm | H2Norm | Margin
Scalings = tuple[StateSpaceModel, StateSpaceModel]


@dataclass(frozen=True)
class Performance:
    """An upper bound of the measure with its evidence."""

    value: float
    doubt: str  # why it is not proved; empty if it is
    evidence: Evidence
    frequency: float  # of the peak; NaN without one

    @property
    def status(self) -> Status:
        """How much the value can be trusted."""
        if self.doubt:
            return Status.INACCURATE
        return Status.CERTIFIED if isinstance(self.evidence, HinfNorm) else self.evidence.status


@dataclass(frozen=True, eq=False)
class PerformanceMeasure:
    """A measure of closed loops of one generalised plant, to be minimised."""

    plant: GeneralizedPlant  # the plant as given
    name: MeasureName  # `"hinf"`, `"h2"` or `"mu"`
    # Perturbation blocks of the plant's first inputs and outputs, without the performance block; for `"mu"`.
    blocks: tuple[Block, ...] = ()
    # The plant with scalings, whose closed-loop norm bounds mu; None without scalings.
    scaled: GeneralizedPlant | None = None
    budget: Budget = field(default_factory=Budget)  # of estimates and proofs

    @property
    def text(self) -> str:
        """The measure in words."""
        if self.name == "mu":
            return "mu of robust performance, at all frequencies" + (" (by the scalings given)" if self.scaled else "")
        return {"hinf": "H-infinity norm", "h2": "H2 norm"}[self.name]

    @property
    def gramian_plant(self) -> GeneralizedPlant:
        """The plant of the closed-loop Gramians: the scaled one where there is one."""
        return self.scaled or self.plant

    def certified(self, K: StateSpaceModel) -> Performance:
        """Prove the measure of the loop with K; infinite if the loop is not stable."""
        loop, margin = self.gramian_plant.close(K), None
        if self.name == "mu" and self.scaled is None:
            part = self.budget.share(min(1.0, MARGIN_WORK / max(self.budget.left, 1.0)))
            with suppress(NoTrustworthyNumber):  # the nominal loop is not stable
                margin = margin_within(with_performance(UncertainModel(loop, self.blocks)), part, tolerance=1e-3)
        else:
            self.budget.spend(dense(loop.n_states, 2 if self.name == "h2" else 12))
        norm = h2_by_gramians(loop) if self.name == "h2" else hinf_norm(loop)
        if margin is not None:
            value = 1 / margin.lower if margin.lower > 0 else np.inf
            frequency = float("nan") if margin.frequency is None else margin.frequency
            return Performance(value, certified(self.plant, K, norm).doubt, margin, frequency)
        frequency = np.nan if isinstance(norm, H2Norm) else norm.frequency
        return Performance(*certified(self.gramian_plant, K, norm), norm, frequency)

    def estimate(self, K: StateSpaceModel) -> float:
        """Estimate the measure from below, on a grid; inf if the loop is not stable or not well posed."""
        try:
            loop = self.gramian_plant.close(K)
            self.budget.spend(dense(loop.n_states, 4))
            if not loop.is_stable():
                return np.inf
            if self.name == "h2":
                return h2_by_gramians(loop).value
            response = frequency_response(loop, default_grid(loop, MEASURE_GRID))
        except (InputError, NoTrustworthyNumber):
            return np.inf
        if not np.isfinite(response).all():
            return np.inf
        if self.name == "hinf" or self.scaled is not None:
            return float(np.linalg.norm(response, 2, axis=(1, 2)).max()) if response.size else 0.0
        q, p = structure_size(self.blocks)
        blocks = (*self.blocks, FullBlock(PERFORMANCE, loop.n_inputs - q, loop.n_outputs - p))
        self.budget.spend(2 * points_work(blocks, len(response)))
        return float(np.max(mu(response, blocks).upper))


def make_measure(
    plant: GeneralizedPlant, name: str, blocks: Sequence[Block] | None, scalings: Any, where: str, budget: Budget
) -> PerformanceMeasure:
    """Check the arguments of a public function and return their measure, with its work counted in ``budget``."""
    if name not in ("hinf", "h2", "mu"):
        raise InputError(where, f"measure {name!r}", "'hinf', 'h2' or 'mu'")
    if name != "mu" and (blocks is not None or scalings is not None):
        raise InputError(where, f"blocks or scalings with measure {name!r}", "measure='mu'")
    if name != "mu":
        return PerformanceMeasure(plant, name, budget=budget)
    known = tuple(plant.blocks if blocks is None else blocks)
    n_w, n_z = plant.n_w, plant.n_z
    if known and structure_size(known) == (n_w, n_z) and known[-1].is_ball and not known[-1].is_scalar:
        known = known[:-1]  # the last block is the performance block
    if scalings is not None:
        scaled = plant_with_scalings(plant, given_scalings(scalings, plant.model.dt, where), where)
        return PerformanceMeasure(plant, "mu", known, scaled, budget)
    q, p = structure_size(known) if known else (0, 0)
    if not known or q >= n_w or p >= n_z:
        raise InputError(
            where, f"blocks of {q} inputs and {p} outputs in a plant with {n_w} and {n_z}",
            "blocks of the plant's first channels, and channels of performance behind them", "blocks=",
        )  # fmt: skip
    return PerformanceMeasure(plant, "mu", known, None, budget)


def plant_with_scalings(plant: GeneralizedPlant, scalings: Scalings, where: str = "scaled plant") -> GeneralizedPlant:
    r"""Return the plant with ``z -> D_z z`` and ``w -> D_w^{-1} w``; ``scalings``: ``(D_z, D_w^{-1})``, both stable."""
    m, n_y, n_u = plant.model, plant.n_meas, plant.n_con
    wide = list[StateSpaceModel]()
    for name, d, size, rest in (("D_z", scalings[0], plant.n_z, n_y), ("D_w^-1", scalings[1], plant.n_w, n_u)):
        if (d.n_outputs, d.n_inputs) != (size, size):
            raise InputError(where, f"{name} is {d.n_outputs} x {d.n_inputs}", f"{size} x {size}")
        if d.n_states and not d.is_stable():
            raise InputError(where, f"{name} is not stable", "a stable scaling with a stable inverse")
        names = [f"straight{i}" for i in range(rest)]
        through = StateSpaceModel([], [], [], np.eye(rest), m.dt, names, names)
        wide.append(append(StateSpaceModel(d.A, d.B, d.C, d.D, d.dt or m.dt), through))
    scaled = series(series(wide[1], StateSpaceModel(m.A, m.B, m.C, m.D, m.dt)), wide[0])  # without units
    return GeneralizedPlant(scaled.renamed(m.inputs, m.outputs), n_y, n_u, plant.blocks)


def given_scalings(scalings: Any, dt: float, where: str) -> Scalings:
    """Return the pair ``(D_z, D_w^-1)`` for a plant with this sample time."""
    if hasattr(scalings, "on_outputs") and hasattr(scalings, "on_inputs"):
        if getattr(scalings, "mixed", False):
            raise InputError(where, "scalings with G for real blocks", "D scalings alone, or none", "leave them out")
        made = StateSpaceModel(*scalings.on_outputs()), StateSpaceModel(*scalings.on_inputs())
        return (bilinear_to_discrete(made[0], dt), bilinear_to_discrete(made[1], dt)) if dt else made
    try:
        on_z, on_w = scalings
    except (TypeError, ValueError):
        raise InputError(where, f"scalings of type {type(scalings).__name__}", "the pair (D_z, D_w^-1)") from None
    pair = as_model(on_z, f"{where}: D_z"), as_model(on_w, f"{where}: D_w^-1")
    for model in pair:
        if model.n_states and model.dt != dt:
            raise InputError(where, f"a scaling with dt = {model.dt:g} s", f"dt = {dt:g} s, that of the plant")
    return pair
