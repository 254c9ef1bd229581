"""The certificate of every design: the norm of the loop of P and K as stored, proved in ball arithmetic.

The rebuilt loop carries rounding: the checker (`robustlab.verification`) closes P and K itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple

import numpy as np

from robustlab.arrays import AnyArray, Array
from robustlab.budget import MILLION, Budget, dense
from robustlab.errors import InputError, NoTrustworthyNumber
from robustlab.linear_analysis.frequency import default_grid, frequency_response, in_states
from robustlab.linear_analysis.matrices import balancing_factors, refuse_overflow
from robustlab.mu_analysis.axis.margin import PERFORMANCE, Margin
from robustlab.mu_analysis.axis.robustness import robust_stability, with_performance
from robustlab.mu_analysis.matrix.bounds import mu
from robustlab.mu_analysis.matrix.upper import points_work
from robustlab.norms import H2Norm, HinfNorm, bilinear_to_discrete, h2_by_gramians, hinf_norm
from robustlab.norms.claims import above, gramian_claims, h2_loop_claims, loop_numbers, norm_matrix
from robustlab.norms.hinfinity import eigenvalue_blur
from robustlab.result import Status
from robustlab.signals import Taken
from robustlab.statespace import StateSpaceModel, series
from robustlab.synthesis.problem.generalized_plant import GeneralizedPlant, Realisation, side_by_side
from robustlab.uncertainty.blocks import Block, FullBlock, structure_size
from robustlab.uncertainty.lft import UncertainModel
from robustlab.verification.balls import midpoints, precision
from robustlab.verification.checker import check
from robustlab.verification.claim import Claim, Outcome
from robustlab.verification.models import loop as closed_in_balls

ILL_POSED = 1e10  # largest condition number of I + D_K D22 at which the controller with D22 included keeps its digits
DISTANCES = (1e-4, 1e-3, 1e-2, 1e-1)  # smallest singular values of I + D22 D_K that replace smaller ones
NO_BASIS = 1e12  # largest condition number of a basis of modes
HIDDEN = 1e6  # Skeel's condition number above which other states are tried
# Shares above the gain at the peak at which a proof is tried; norms that differ by more than the last disagree.
SHARES = (1e-4, 1e-3)
AGREEMENT = SHARES[-1]
# Effort of the checker at 20 states where no matrix proves the norm: enough for a counterexample, and for some boxes.
EFFORT = 400
BITS = 192
CANCELLED = 1e-10  # a direct term from w to z below this share of D11 is rounding of the cancellation by D_K
MEASURE_GRID = 60  # points of the grid on which candidates are compared before the proof
MARGIN_WORK = 30 * MILLION  # most work of the proof of one candidate without scalings

MeasureName = Literal["hinf", "h2", "mu"]
Evidence = HinfNorm | H2Norm | Margin


def with_direct_term(K: StateSpaceModel, D22: Array) -> StateSpaceModel:
    """Return ``K (I + D22 K)^{-1}``, the controller for a plant with D22, from that for the plant without."""
    if not D22.any():
        return K
    loop = np.eye(K.n_outputs) + K.D @ D22
    if np.linalg.cond(loop) > ILL_POSED:
        raise NoTrustworthyNumber("controller", "I + D_K D22 is singular: the loop is not well posed")
    C, D = np.linalg.solve(loop, K.C), np.linalg.solve(loop, K.D)
    with np.errstate(over="ignore", invalid="ignore"):
        A, B = K.A - K.B @ D22 @ C, K.B - K.B @ D22 @ D
    refuse_overflow("controller", A, B, C, D)
    return StateSpaceModel(A, B, C, D, K.dt)


def well_posed_neighbours(K: Realisation, D22: AnyArray) -> list[Realisation]:
    """K itself where ``I + D22 D_K`` is far from singular; else controllers with the smallest change of ``D_K``.

    A single weight on S has its optimum at such a K: of ten such test plants mixsyn failed on four without them.
    """
    with np.errstate(all="ignore"):
        back = np.eye(len(D22)) + D22 @ K.D
    if not np.isfinite(back).all():  # K overflows
        return []
    U, s, Vt = np.linalg.svd(back)
    if s[-1] >= DISTANCES[0]:
        return [K]
    inverse = np.linalg.pinv(D22, rcond=1e-10)
    return [K._replace(D=K.D + inverse @ (U * np.maximum(delta - s, 0.0)) @ Vt) for delta in DISTANCES]


def named_controller(K: StateSpaceModel, inputs: Any, outputs: Any, dt: float) -> StateSpaceModel:
    """Return K in balanced states, with the names of its signals and the takes of its inputs (by default ``y``)."""
    inputs = [s if isinstance(s, Taken) else Taken(*s) for s in inputs]
    names = [f"k{i + 1}" for i in range(K.n_states)]
    K = balanced_states(K)
    return StateSpaceModel(K.A, K.B, K.C, K.D, dt, inputs, outputs, names)


def balanced_states(model: StateSpaceModel) -> StateSpaceModel:
    """Scale states by powers of two, exactly, so that rows of [A B] and columns of [A; C] have about one size."""
    n, m, p = model.n_states, model.n_inputs, model.n_outputs
    if not n:
        return model
    whole = np.zeros((n + m + p,) * 2)
    whole[:n, :n], whole[:n, n : n + m], whole[n + m :, :n] = model.A, model.B, model.C
    scale = balancing_factors(whole)[:n]
    with np.errstate(invalid="ignore", over="ignore"):
        A, B, C = model.A / scale[:, None] * scale, model.B / scale[:, None], model.C * scale
        exact = (A / scale * scale[:, None] == model.A).all() and (B * scale[:, None] == model.B).all()
        if not exact or not (C / scale == model.C).all():  # overflow, or digits lost to underflow
            return model
    return model._in_states(A, B, C)


def moderate_states(model: StateSpaceModel) -> StateSpaceModel:
    """Return a model in balanced states, or in coordinates of its modes where these keep more digits."""
    balanced = balanced_states(model)
    hidden = _cancellation(balanced.A)
    if not hidden > HIDDEN:
        return balanced
    values, vectors = np.linalg.eig(balanced.A)
    # real and imaginary part of a conjugate pair
    basis = np.where(np.imag(values) < 0, np.imag(vectors), np.real(vectors))
    if not np.isfinite(basis).all() or not np.linalg.cond(basis) < NO_BASIS:
        return balanced
    modes = in_states(balanced, basis)
    modes = balanced if modes is None else balanced_states(modes)
    return modes if _cancellation(modes.A) < 1e-2 * hidden else balanced


def _cancellation(A: Array) -> float:
    """Compute Skeel's condition number: the effect of relative errors of A's entries on A^-1."""
    try:
        return float((np.abs(np.linalg.inv(A)) @ np.abs(A)).sum(axis=1).max(initial=0.0))
    except np.linalg.LinAlgError:
        return float("inf")


def surely_stable(loop: StateSpaceModel) -> bool:
    """Return whether every pole is further inside the stability region than rounding of eigenvalues may move it."""
    return not loop.n_states or loop.spectral_abscissa() < -eigenvalue_blur(loop)


class Certificate(NamedTuple):
    """An upper bound of the norm of a loop, and why it is not certified (empty if it is)."""

    gamma: float
    doubt: str


def certified(
    plant: GeneralizedPlant, K: StateSpaceModel, norm: HinfNorm | H2Norm, level: float | None = None,
    effort: int = EFFORT,
) -> Certificate:  # fmt: skip
    """Prove the norm of the loop of P and K; if that loop has a larger norm, return the larger one with a doubt."""
    value = norm.value if isinstance(norm, H2Norm) else norm.upper if level is None else level
    if not np.isfinite(value):
        return Certificate(value, norm.reason)
    numbers = loop_numbers(plant.model, K)
    work = round(effort * max(1.0, ((plant.model.n_states + K.n_states) / 20) ** 3))
    with precision(BITS):  # the loop of P and K, each entry rounded once
        exact = closed_in_balls(Claim("", numbers))
        A, B, C, D = (midpoints(X) for X in (exact.A, exact.B, exact.C, exact.D))
        true = StateSpaceModel(A, B, C, D, plant.model.dt)
    if isinstance(norm, H2Norm):
        if not norm.status.trustworthy or not true.n_states:
            return _in_floats(true, norm, value, norm.reason)
        where = "no Gramian was found"
        for gamma in (value, value * (1 + AGREEMENT)):
            for claim in _h2_claims(plant, K, true, gamma):
                found = check(claim, effort=work)
                where = found.where
                if found.outcome is Outcome.PROVED:
                    return Certificate(gamma, "")
    else:
        levels = [value]
        if level is None and true.n_states:
            levels = sorted({value, *(norm.lower * (1 + share) for share in SHARES)})
        for gamma in levels:
            if norm_matrix(true, above(gamma), min(norm.lower, gamma), numbers):  # checked there
                return Certificate(gamma, "")
        found = check(Claim("loop-norm", {**numbers, "gamma": np.array(above(levels[-1]))}), effort=work)
        where = found.where
        if found.outcome is Outcome.PROVED:
            return Certificate(levels[-1], "")
    return _in_floats(true, norm, value, f"not proved in ball arithmetic of P and K as they are: {where}")


def _in_floats(true: StateSpaceModel, norm: HinfNorm | H2Norm, value: float, doubt: str) -> Certificate:
    """Return the doubt, or the norm of the loop of P and K where it is larger than that of the rebuilt loop."""
    larger = h2_by_gramians(true).value if isinstance(norm, H2Norm) else hinf_norm(true).upper
    if not value * (1 + AGREEMENT) < larger < np.inf:
        return Certificate(value, doubt)
    text = f"P and K closed exactly have the norm {larger:.6g}, the rebuilt loop {value:.6g}: digits were lost"
    return Certificate(larger, text)


def _h2_claims(plant: GeneralizedPlant, K: StateSpaceModel, true: StateSpaceModel, level: float) -> list[Claim]:
    """Return the claims of the loop; of its rounded matrices without D if D_K cancels D11 up to rounding."""
    D11 = plant.model.D[: plant.n_z, : plant.n_w]
    cancelled = CANCELLED * max(np.abs(D11).max(initial=0.0), np.abs(K.D).max(initial=0.0))
    if true.dt or not 0 < np.abs(true.D).max(initial=0.0) <= cancelled:
        return h2_loop_claims(plant.model, K, level)
    return gramian_claims(StateSpaceModel(true.A, true.B, true.C, np.zeros_like(true.D)), level)


@dataclass(frozen=True)
class Performance:
    """An upper bound of the measure with its evidence."""

    value: float
    doubt: str  # why it is not proved; empty if it is
    evidence: Evidence
    frequency: float  # of the peak; NaN without one

    @property
    def status(self) -> Status:
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
        by = " (by the design's scalings)" if self.scaled else ""
        mu = f"mu of robust performance, at all frequencies{by}"
        return {"hinf": "H-infinity norm", "h2": "H2 norm", "mu": mu}[self.name]

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
                performing = with_performance(UncertainModel(loop, self.blocks))
                margin = robust_stability(performing, tolerance=1e-3, budget=part)
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
    if name != "mu" and blocks is not None:
        raise InputError(where, f"blocks with measure {name!r}", "measure='mu'")
    if name != "mu":
        return PerformanceMeasure(plant, name, budget=budget)
    known = tuple(plant.blocks if blocks is None else blocks)
    n_w, n_z = plant.n_w, plant.n_z
    if known and structure_size(known) == (n_w, n_z) and known[-1].is_ball and not known[-1].is_scalar:
        known = known[:-1]  # the last block is the performance block
    if scalings is not None:
        return PerformanceMeasure(plant, "mu", known, plant_with_scalings(plant, scalings), budget)
    q, p = structure_size(known) if known else (0, 0)
    if not known or q >= n_w or p >= n_z:
        raise InputError(
            where, f"blocks of {q} inputs and {p} outputs in a plant with {n_w} and {n_z}",
            "blocks of the plant's first channels, and channels of performance behind them", "blocks=",
        )  # fmt: skip
    return PerformanceMeasure(plant, "mu", known, None, budget)


def plant_with_scalings(plant: GeneralizedPlant, scalings: Any) -> GeneralizedPlant:
    """Return the plant with ``z -> D_z z`` and ``w -> D_w^-1 w``, by the `DynamicScalings` of a design."""
    m, wide = plant.model, list[StateSpaceModel]()
    for made, rest in ((scalings.on_outputs(), plant.n_meas), (scalings.on_inputs(), plant.n_con)):
        d = bilinear_to_discrete(StateSpaceModel(*made), m.dt) if m.dt else StateSpaceModel(*made)
        wide.append(side_by_side(d, StateSpaceModel([], [], [], np.eye(rest), m.dt)))
    scaled = series(series(wide[1], StateSpaceModel(m.A, m.B, m.C, m.D, m.dt)), wide[0])  # without units
    return GeneralizedPlant(scaled.renamed(m.inputs, m.outputs), plant.n_meas, plant.n_con, plant.blocks)
