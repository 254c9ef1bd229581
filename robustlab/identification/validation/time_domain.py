r"""Validation in the time domain, sample by sample: constants, systems, and both together.

Systems are found as cone programmes (time-varying) or by their pulse responses (time-invariant), constants by descent
and branch and bound. For fixed constants the systems beside them are found by their own methods, so

.. math:: \gamma^* = \min_\delta \max(|\delta|_\infty, \gamma_{dyn}(\delta))

is searched from above (pattern search). From below every constant is allowed to be a time-varying system of the same
size, a larger set, whose multipliers disprove a gamma.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from robustlab.arrays import Array, Mask
from robustlab.errors import InputError, NoTrustworthyNumber
from robustlab.identification.validation.constant_parameters import WindowFit, smallest_parameters
from robustlab.identification.validation.sampled_problem import Recorded, SampledProblem, sampled, with_delta_of
from robustlab.identification.validation.time_invariant import PulseResponses, smallest_pulse_responses
from robustlab.identification.validation.time_varying import Contractions, largest_disproved, smallest_contractions
from robustlab.identification.validation.tuning import Search
from robustlab.identification.validation.validation_result import (
    BlockSize,
    Validation,
    concluded,
    each_alone,
    in_own_units,
    require_replay,
)
from robustlab.record import Record
from robustlab.statespace import StateSpaceModel
from robustlab.uncertainty.blocks import Block

DeltaKind = Literal["time-invariant", "time-varying"]

# Sizes below this count as zero; rounding in the noise of an explanation, over its bound; and between a lower and an
# upper bound that meet.
SMALLEST, SLACK, MEET = 1e-6, 1e-9, 1e-4


def _nothing() -> Array:
    return np.zeros((0, 0))


def validate_by_samples(
    record: Record,
    recorded: Recorded,
    delta: DeltaKind,
    search: Search,
    *,
    per_block: bool,
    progress: Callable[[str], None],
    estimated: bool,
) -> Validation:
    """Bounds of the smallest gamma over the samples; see `robustlab.identification.validation.validate`."""
    job = _Job(recorded, delta, progress)
    found, alone = job.bounds(search), {}
    if per_block and np.isfinite(found.upper):
        alone = each_alone([b.name for b in recorded.uncertain.blocks], search, job.bounds, progress)
    return _result(record, job, found, alone, _assumptions(recorded, delta, estimated), search)


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
    pulses: tuple[Array, ...] = ()
    states: Mapping[int, Array] = field(default_factory=dict)
    sizes: Mapping[str, float] = field(default_factory=dict)
    multipliers: Mapping[str, Array] = field(default_factory=dict)
    recheck: Callable[[], float] | None = None


@dataclass(frozen=True)
class _Job:
    """A record, what the systems of Delta are, and who is told."""

    recorded: Recorded
    delta: DeltaKind
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
        fit, none = WindowFit(self.recorded, [], search.budget, search.tuning), np.zeros(0)
        excess, noise, weights = fit.excess(fit.windows(none))
        gamma = 0.0 if excess <= 1 + SLACK else np.inf
        if gamma and not fit.witness(weights, none) > 1:
            found = f"the noise bound is missed by {excess - 1:.1e} of itself: too close to tell"
            raise NoTrustworthyNumber(f"validate: {self.recorded.uncertain!r}", found)
        label = "noise alone: the set has no block"
        recheck = (lambda: np.inf if fit.witness(weights, none) > 1 else 0.0) if gamma else None
        return _Found(gamma, gamma, label, True, fit.whole(noise), excess, recheck=recheck)

    def constant(self, search: Search) -> _Found:
        """All blocks are real."""
        blocks = [b for b in self.recorded.uncertain.blocks if b.interval]
        found = smallest_parameters(self.recorded, blocks, search)
        self.progress(f"constants: gamma {found.lower:.4g} .. {found.upper:.4g}, {found.boxes} boxes")
        label = f"constants; upper bound replayed, lower bound from {found.boxes} boxes tested at points"
        values: dict[str, float] = {}
        if np.isfinite(found.upper):
            values = {b.name: float(v) for b, v in zip(blocks, found.delta, strict=True)}
        return _Found(
            found.lower, found.upper, label, False, found.noise, found.least_excess, values,
            sizes={n: abs(v) for n, v in values.items()},
        )  # fmt: skip

    def mixed(self, search: Search, real: Mask) -> _Found:
        """Some blocks are ``real`` (n_blocks,), the others systems."""
        blocks, tuning = self.recorded.uncertain.blocks, search.tuning
        names = [b.name for b, constant in zip(blocks, real, strict=True) if constant]
        free, kept = search.scaled[real], replace(search, scaled=search.scaled[~real])
        problem = sampled(self.recorded.part(0, tuning.longest_relaxed), self.recorded.uncertain.M, blocks)
        relaxed = smallest_contractions(problem, search)
        if np.isinf(relaxed.lower):
            everything = replace(search, scaled=np.ones(len(problem.blocks), dtype=bool))
            return replace(self._varying(problem, relaxed, everything, {}), sizes={})
        part = replace(kept, budget=search.budget.share(tuning.constants_share))

        def named(delta: Array) -> dict[str, float]:
            return dict(zip(names, map(float, delta), strict=True))

        def size_at(delta: Array) -> float:
            if (np.abs(delta[~free]) > 1).any():
                return np.inf
            try:
                found = self.dynamic(named(delta), part, quick=True)
            except NoTrustworthyNumber:
                return np.inf
            return max(found.upper, float(np.abs(delta[free]).max(initial=0.0)))

        delta = np.zeros(len(names))
        best, step = size_at(delta), 0.5
        if len(self.recorded.t) > tuning.longest_relaxed:
            step = 0.0  # nothing explains a record of which only the beginning is judged
        while step > tuning.finest_step * max(best if np.isfinite(best) else 1.0, 0.05) and not part.budget.over:
            better = False
            for k in range(len(names)):
                for sign in (1.0, -1.0):
                    trial = delta.copy()
                    trial[k] += sign * step
                    size = size_at(trial)
                    if size < best * (1 - 1e-4) or (np.isinf(best) and np.isfinite(size)):
                        delta, best, better = trial, size, True
                        break
            step = step if better else step / 2
        found = self.dynamic(named(delta), kept)
        return replace(
            found,
            lower=relaxed.lower,
            upper=max(found.upper, float(np.abs(delta[free]).max(initial=0.0))),
            label="constants and systems; lower bound with all blocks time-varying (relaxation), upper bound by search",
            multipliers={"energy": relaxed.multipliers.D, "noise": relaxed.multipliers.noise},
            recheck=None,
            certified=False,
        )

    def dynamic(self, values: Mapping[str, float], search: Search, quick: bool = False) -> _Found:
        """The real blocks are set; the search is over the blocks that remain."""
        M, blocks = with_delta_of(self.recorded.uncertain, values)
        most = search.tuning.longest_programme
        long = len(self.recorded.t) > most
        problem = sampled(self.recorded.part(0, most) if long else self.recorded, M, blocks)
        varying = smallest_contractions(problem, search)
        self.progress(f"time-varying: gamma {varying.lower:.4g} .. {varying.upper:.4g}")
        found = self._varying(problem, varying, search, values)
        if long:
            label = f"lower bound from the first {most} samples (time-varying), no explanation sought"
            return replace(found, upper=np.inf, w=_nothing(), z=_nothing(), sizes={}, label=label)
        repeated = any(r for _, _, r in problem.blocks)
        if np.isinf(varying.lower) or (quick and not repeated):
            return found
        if self.delta == "time-varying":
            if repeated:
                raise InputError(
                    "validate", "a repeated complex scalar as a time-varying system", "time-invariant ones",
                    'delta="time-invariant"',
                )  # fmt: skip
            return found
        return self._invariant(
            varying, replace(found, upper=np.inf, w=_nothing(), z=_nothing(), sizes={}), search, blocks, M
        )

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

    def _invariant(
        self, c: Contractions, relaxed: _Found, search: Search, blocks: tuple[Block, ...], M: StateSpaceModel
    ) -> _Found:
        problem, tuning = relaxed.problem, search.tuning
        assert problem is not None
        each = sum(1 if r else (a.stop - a.start) * (b.stop - b.start) for a, b, r in problem.blocks)
        longest = min(tuning.longest_pulses, tuning.most_unknowns // max(each, 1))
        if problem.n > longest:
            start = sampled(self.recorded.part(0, longest), M, blocks)
            head = smallest_pulse_responses(start, search, c.upper if np.isfinite(c.upper) else 1.0)
            lower = max(c.lower, head.lower if head is not None else 0.0)
            label = f"time-invariant: lower bound from the first {longest} samples and from time-varying systems"
            return replace(relaxed, lower=lower, label=label)
        guess = c.upper if np.isfinite(c.upper) else max(1.0, c.lower)
        found = smallest_pulse_responses(problem, search, guess, c.z if c.z.size else None)
        if found is None:
            label = "time-invariant: lower bound from time-varying systems (relaxation), no explanation found"
            return replace(relaxed, label=label)
        self.progress(f"time-invariant: gamma {found.lower:.4g} .. {found.upper:.4g}")
        return _pulses(problem, c, found, relaxed)


def _pulses(problem: SampledProblem, c: Contractions, found: PulseResponses, relaxed: _Found) -> _Found:
    convex, k = found.lower > c.lower, problem.free.shape[1]
    return replace(
        relaxed,
        lower=max(found.lower, c.lower),
        upper=found.upper,
        label="time-invariant systems (exact)" if c.convex else "time-invariant; lower bound from time-varying systems",
        w=found.w,
        z=found.z,
        noise=found.noise,
        pulses=found.h,
        states={t: found.states[i * k : (i + 1) * k] for i, t in enumerate(problem.free_starts)},
        sizes=dict(zip(problem.names, map(float, found.sizes), strict=True)),
        multipliers={"noise": found.dual} if convex else relaxed.multipliers,
        recheck=found.recheck if convex else relaxed.recheck,
        excess=problem.excess(found.noise),
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
        blocks={b.name: _block(b, found, alone, job.delta) for b in recorded.uncertain.blocks},
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


def _block(block: Block, found: _Found, alone: Mapping[str, tuple[float, float]], delta: DeltaKind) -> BlockSize:
    lower, upper = alone.get(block.name, (np.nan, np.nan))
    if block.interval and (not found.problem or block.name not in found.problem.names):
        value = found.values.get(block.name)
        physical, impossible = None, ""
        if block.parameter is not None and value is not None:
            physical = block.parameter.value(value), block.parameter.unit
            impossible = block.parameter.impossible(physical[0])
        size = abs(value) if value is not None else np.nan
        return BlockSize(block.name, "constant", size, lower, upper, value, physical, impossible)
    pulse = None
    if found.problem is not None and found.pulses:
        pulse = found.pulses[found.problem.names.index(block.name)]
    return BlockSize(block.name, delta, found.sizes.get(block.name, np.nan), lower, upper, pulse)


def _replay_error(recorded: Recorded, found: _Found) -> float:
    """The explanation once more on another way, against its noise, over the bound."""
    if found.problem is None:  # constants: the member itself, in the simulation of `robustlab.dynamics`
        return _member_error(recorded, found)
    problem = found.problem
    w = found.w
    if found.pulses:
        w = _in_the_loop(problem, found)
    _, noise = problem.respond(w, found.states)
    return float(np.abs((noise - found.noise)[problem.used]).max(initial=0.0))


def _in_the_loop(problem: SampledProblem, found: _Found) -> Array:
    """W sample by sample: Delta sees z as it comes."""
    n, q = problem.n, problem.B.shape[1]
    w, z = np.zeros((n, q)), np.zeros_like(problem.z0)
    state = np.zeros(len(problem.A))
    first = np.zeros((q, len(problem.C1)))
    wholes = []
    for (rows, cols, repeated), h in zip(problem.blocks, found.pulses, strict=True):
        full = h * np.eye(rows.stop - rows.start) if repeated else h
        wholes.append((rows, cols, full))
        first[rows, cols] = full[0]
    inner = np.linalg.inv(np.eye(q) - first @ problem.D11)
    for t in range(n):
        if t in found.states:
            state = state + problem.free @ found.states[t]
        came = problem.z0[t] + problem.C1 @ state
        past = np.zeros(q)
        for rows, cols, full in wholes:
            if t:
                past[rows] = np.einsum("kab,kb->a", full[t:0:-1], z[:t, cols])
        w[t] = inner @ (past + first @ came)
        z[t] = came + problem.D11 @ w[t]
        state = problem.A @ state + problem.B @ w[t]
    return w


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


def _assumptions(recorded: Recorded, delta: DeltaKind, estimated: bool) -> tuple[str, ...]:
    dynamic = not all(b.interval for b in recorded.uncertain.blocks)
    said = []
    if recorded.norm == "peak":
        said.append("no sample of the noise is beyond its bound")
    else:
        said.append("the root mean square of the noise over the record is within its bound")
    if estimated:
        said.append("the noise bound was estimated from the record's own periods")
    if dynamic:
        said.append(f"complex and full blocks are causal {delta} systems at rest before the record")
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
