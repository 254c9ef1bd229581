"""Validation sample by sample: systems from both sides by cone programmes, constants by descent.

From below a constant of a discrete model counts as a time-varying system of the same size, a larger set.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from robustlab.arrays import Array, Mask
from robustlab.errors import InputError, NoTrustworthyNumber
from robustlab.identification.validation.cone_programme import Search
from robustlab.identification.validation.constant_parameters import WindowFit, smallest_parameters
from robustlab.identification.validation.sampled_problem import Recorded, SampledProblem, sampled, with_delta_of
from robustlab.identification.validation.time_varying import Contractions, largest_disproved, smallest_contractions
from robustlab.identification.validation.validation_result import (
    BlockSize,
    Validation,
    concluded,
    each_alone,
    in_own_units,
    require_replay,
)
from robustlab.record import Record
from robustlab.uncertainty.blocks import Block

# Sizes below this count as zero; rounding in the noise of an explanation, over its bound; and between a lower and an
# upper bound that meet.
SMALLEST, SLACK, MEET = 1e-6, 1e-9, 1e-4
# Samples of a cone programme over all of them, and of a relaxation: longer records are judged by their beginning.
LONGEST_PROGRAMME, LONGEST_RELAXED = 8000, 4000
RELAXED_SHARE = 0.5  # of the work, for the lower bound of constants
RELAXATION = "lower bound with all blocks time-varying (relaxation)"
NO_BOUND = "no lower bound (a constant in continuous time)"


def _nothing() -> Array:
    return np.zeros((0, 0))


def validate_by_samples(
    record: Record,
    recorded: Recorded,
    search: Search,
    *,
    per_block: bool,
    progress: Callable[[str], None],
    estimated: bool,
) -> Validation:
    """Bounds of the smallest gamma over the samples; see `robustlab.identification.validation.validate`."""
    job = _Job(recorded, progress)
    found, alone = job.bounds(search), {}
    if per_block and np.isfinite(found.upper):
        alone = each_alone([b.name for b in recorded.uncertain.blocks], search, job.bounds, progress)
    return _result(record, job, found, alone, _assumptions(recorded, estimated), search)


@dataclass(frozen=True)
class _Found:
    """Bounds of one problem with what explains the record."""

    lower: float
    upper: float
    label: str
    certified: bool
    noise: Array
    excess: float
    values: Mapping[str, float] = field(default_factory=dict)
    problem: SampledProblem | None = None
    w: Array = field(default_factory=_nothing)
    z: Array = field(default_factory=_nothing)
    states: Mapping[int, Array] = field(default_factory=dict)
    sizes: Mapping[str, float] = field(default_factory=dict)
    multipliers: Mapping[str, Array] = field(default_factory=dict)
    recheck: Callable[[], float] | None = None


@dataclass(frozen=True)
class _Job:
    """A record, and the listener for progress."""

    recorded: Recorded
    progress: Callable[[str], None]

    def bounds(self, search: Search) -> _Found:
        """Bounds over the blocks that are scaled, the others within 1."""
        blocks = self.recorded.uncertain.blocks
        real = np.array([b.interval is not None for b in blocks], dtype=bool)
        if not blocks:
            return self.noise_alone(search)
        if not real.any():
            return self.dynamic({}, search)
        if real.all():
            return self.constant(search)
        return self.mixed(search, real)

    def noise_alone(self, search: Search) -> _Found:
        """Without a block the record is explained by its noise, or not at all."""
        fit = WindowFit(self.recorded, search.budget)
        at = fit.windows(np.zeros(0))
        if at is None:
            raise NoTrustworthyNumber("validate", "the response outgrows every number", None, "use windows")
        excess, noise, weights = fit.excess(at)
        gamma = 0.0 if excess <= 1 + SLACK else np.inf
        if gamma and not fit.witness(weights, at) > 1:
            found = f"the noise bound is missed by {excess - 1:.1e} of itself: too close to tell"
            raise NoTrustworthyNumber(f"validate: {self.recorded.uncertain!r}", found)
        label = "noise alone: the set has no block"
        recheck = (lambda: np.inf if fit.witness(weights, at) > 1 else 0.0) if gamma else None
        return _Found(gamma, gamma, label, True, fit.whole(noise), excess, recheck=recheck)

    def relaxed(self, search: Search) -> tuple[float, Mapping[str, Array]]:
        """Lower bound with every block a system that may vary in time, and its multipliers.

        Of constants in discrete time only: in continuous time a constant's w = delta z is not held between samples.
        """
        uncertain = self.recorded.uncertain
        if not uncertain.dt:
            return 0.0, {}
        problem = sampled(self.recorded.part(0, LONGEST_RELAXED), uncertain.M, uncertain.blocks)
        found = smallest_contractions(problem, replace(search, budget=search.budget.share(RELAXED_SHARE)))
        return found.lower, {"energy": found.multipliers.D, "noise": found.multipliers.noise}

    def constant(self, search: Search) -> _Found:
        """All blocks are real."""
        blocks = [b for b in self.recorded.uncertain.blocks if b.interval]
        found = smallest_parameters(self.recorded, blocks, search)
        lower, multipliers = self.relaxed(search) if found.upper > 0 else (0.0, {})
        self.progress(f"constants: gamma {lower:.4g} .. {found.upper:.4g}")
        values: dict[str, float] = {}
        if np.isfinite(found.upper):
            values = {b.name: float(v) for b, v in zip(blocks, found.delta, strict=True)}
        bound = RELAXATION if multipliers or not found.upper else NO_BOUND
        return _Found(
            lower, found.upper, f"constants; upper bound by descent, replayed, {bound}", lower == found.upper,
            found.noise, found.least_excess, values, sizes={n: abs(v) for n, v in values.items()},
            multipliers=multipliers,
        )  # fmt: skip

    def mixed(self, search: Search, real: Mask) -> _Found:
        """Some blocks are ``real`` (n_blocks,): they are kept at nominal for the upper bound; the others systems."""
        blocks = self.recorded.uncertain.blocks
        lower, multipliers = self.relaxed(search)
        nominal = {b.name: 0.0 for b, constant in zip(blocks, real, strict=True) if constant}
        found = self.dynamic(nominal, replace(search, scaled=search.scaled[~real]))
        bound = RELAXATION if multipliers else NO_BOUND
        label = f"constants and systems; upper bound with the constants at nominal, {bound}"
        if np.isinf(lower):
            found = replace(found, upper=np.inf, sizes={})
        return replace(found, lower=lower, label=label, multipliers=multipliers, recheck=None, certified=False)

    def dynamic(self, values: Mapping[str, float], search: Search) -> _Found:
        """The real blocks are set; the search is over the blocks that remain."""
        M, blocks = with_delta_of(self.recorded.uncertain, values)
        long = len(self.recorded.t) > LONGEST_PROGRAMME
        problem = sampled(self.recorded.part(0, LONGEST_PROGRAMME) if long else self.recorded, M, blocks)
        if any(repeated for _, _, repeated in problem.blocks):
            found, wanted = "a repeated complex scalar as a time-varying system", "full blocks and complex scalars"
            raise InputError("validate", found, wanted, 'domain="frequency", where blocks are time-invariant')
        varying = smallest_contractions(problem, search)
        self.progress(f"time-varying: gamma {varying.lower:.4g} .. {varying.upper:.4g}")
        found = self._varying(problem, varying, search, values)
        if long:
            label = f"lower bound from the first {LONGEST_PROGRAMME} samples (time-varying), no explanation sought"
            return replace(found, upper=np.inf, w=_nothing(), z=_nothing(), sizes={}, label=label)
        return found

    def _varying(self, problem: SampledProblem, c: Contractions, search: Search, values: Mapping[str, float]) -> _Found:
        exact = "exact" if c.convex else "lower bound exact where the Lagrangian is concave"
        recheck = None
        if np.isfinite(c.lower) and c.lower > 0:
            finer, start = replace(search, precision=search.precision / 10), c.lower * (1 + search.precision)
            recheck = lambda: largest_disproved(problem, c.multipliers, finer, start)  # noqa: E731
        return _Found(
            c.lower,
            c.upper,
            f"time-varying contractions ({exact})",
            True,
            c.noise,
            c.least_noise if not c.w.size else problem.excess(c.noise),
            values,
            problem,
            c.w,
            c.z,
            states=c.states,
            sizes=dict(zip(problem.names, map(float, c.sizes), strict=True)) if len(c.sizes) else {},
            multipliers={"energy": c.multipliers.D, "noise": c.multipliers.noise},
            recheck=recheck,
        )


# --- result ----------------------------------------------------------------------------------------------------------


def _result(
    record: Record,
    job: _Job,
    found: _Found,
    alone: Mapping[str, tuple[float, float]],
    assumptions: tuple[str, ...],
    search: Search,
) -> Validation:
    if np.isfinite(found.upper) and found.lower > found.upper * (1 + MEET) + SMALLEST:
        contradiction = f"a lower bound of gamma, {found.lower:.6g}, above the upper one, {found.upper:.6g}"
        raise NoTrustworthyNumber(f"validate {record.name}", contradiction)
    recorded, budget = job.recorded, search.budget
    offset = np.column_stack([record.outputs[s.name] for s in recorded.outputs]) - recorded.y
    measured = recorded.y + offset
    explained, error = np.full(measured.shape, np.nan), 0.0
    if np.isfinite(found.upper):
        explained = measured - found.noise * recorded.bound
        error = _replay_error(recorded, found)
        require_replay(error, record.name)
    w, z = found.w, found.z
    if found.problem is not None and w.size:
        w, z = in_own_units(w, z, found.problem.blocks, found.problem.scale)
    return Validation(
        status=concluded(found.lower, found.upper, search.precision, budget, certified=found.certified),
        record=record.name,
        lower=float(min(found.lower, found.upper)),
        upper=float(found.upper),
        label=found.label,
        blocks={b.name: _block(b, found, alone) for b in recorded.uncertain.blocks},
        noise_bound={s.name: float(b) for s, b in zip(recorded.outputs, recorded.bound, strict=True)},
        noise_norm=recorded.norm,
        excess=found.excess,
        replay_error=error,
        assumptions=assumptions,
        t=record.t,
        measured=measured,
        nominal=_nominal(recorded) + offset,
        explained=explained,
        outputs=tuple((s.name, s.unit) for s in recorded.outputs),
        w=w,
        z=z,
        multipliers=found.multipliers,
        recheck=found.recheck,
        notes=(budget.remark,) if budget.remark else (),
    )


def _block(block: Block, found: _Found, alone: Mapping[str, tuple[float, float]]) -> BlockSize:
    lower, upper = alone.get(block.name, (np.nan, np.nan))
    if block.interval and (not found.problem or block.name not in found.problem.names):
        value = found.values.get(block.name)
        physical, impossible = None, ""
        if block.parameter is not None and value is not None:
            physical = block.parameter.value(value), block.parameter.unit
            impossible = block.parameter.impossible(physical[0])
        size = abs(value) if value is not None else np.nan
        return BlockSize(block.name, "constant", size, lower, upper, value, physical, impossible)
    return BlockSize(block.name, "time-varying", found.sizes.get(block.name, np.nan), lower, upper)


def _replay_error(recorded: Recorded, found: _Found) -> float:
    """The explanation once more on another way, against its noise, over the bound."""
    if found.problem is None:  # constants: the member itself, in the simulation of `robustlab.dynamics`
        return _member_error(recorded, found)
    problem = found.problem
    _, noise = problem.respond(found.w, found.states)
    return float(np.abs((noise - found.noise)[problem.used]).max(initial=0.0))


def _member_error(recorded: Recorded, found: _Found) -> float:
    from robustlab.dynamics import simulate

    member = recorded.uncertain.evaluate(found.values)
    names = member.input_names
    t = recorded.t - recorded.t[0]
    t = member.dt * np.arange(len(t)) if member.is_discrete else t
    run = simulate(member, t, dict(zip(names, recorded.u.T, strict=True)))
    y = np.column_stack([run.outputs[s.name] for s in recorded.outputs])
    wanted = (recorded.y - y) / recorded.bound
    M, rest = with_delta_of(recorded.uncertain, found.values)
    _, free = sampled(recorded, M, rest).free_response()
    left = (wanted - found.noise)[recorded.used]
    basis = free[recorded.used]
    if basis.shape[1]:
        left = left - basis @ np.linalg.lstsq(basis, left, rcond=None)[0]
    return float(np.abs(left).max(initial=0.0))


def _nominal(recorded: Recorded) -> Array:
    """Response of the nominal model with its free states fitted (n, n_y)."""
    M, rest = with_delta_of(recorded.uncertain, {b.name: 0.0 for b in recorded.uncertain.blocks if b.interval})
    problem = sampled(recorded, M, rest)
    _, free = problem.free_response()
    basis = free[problem.used]
    x = np.linalg.lstsq(basis, problem.e[problem.used], rcond=None)[0] if basis.shape[1] else np.zeros(0)
    return recorded.y - (problem.e - free @ x) * recorded.bound


def _assumptions(recorded: Recorded, estimated: bool) -> tuple[str, ...]:
    dynamic = not all(b.interval for b in recorded.uncertain.blocks)
    said = []
    if recorded.norm == "peak":
        said.append("no sample of the noise is beyond its bound")
    else:
        said.append("the root mean square of the noise over the record is within its bound")
    if estimated:
        said.append("the noise bound was estimated from the record's own periods")
    if dynamic:
        said.append("complex and full blocks are causal time-varying systems at rest before the record")
    if recorded.uncertain.dt == 0:
        held = "u and w" if dynamic else "u"
        said.append(f"{held} {'are' if dynamic else 'is'} held between samples of {recorded.dt:.6g} s")
    if recorded.at_rest:
        said.append("the model is at rest before the record")
    else:
        said.append("states that the outputs show are free at the start, the others at rest")
    if len(recorded.starts) > 1:
        said.append(f"{len(recorded.starts)} windows, each with a free start; Delta is one over all of them")
    lost = int((~recorded.used).sum())
    if lost:
        said.append(f"{lost} samples are missing and not judged")
    return tuple(said)
