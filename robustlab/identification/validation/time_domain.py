"""Validation over the samples: bounds of gamma, the replay of the explanation, and the result.

The lower bound of a constant of a discrete model is that of a time-varying system of the same size, a larger set.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from robustlab.arrays import Array
from robustlab.errors import InputError, NoTrustworthyNumber
from robustlab.identification.validation.cone_programme import Search
from robustlab.identification.validation.constant_parameters import smallest_parameters
from robustlab.identification.validation.sampled_problem import Recorded, SampledProblem, at_nominal, sampled
from robustlab.identification.validation.time_varying import disproved_by, smallest_contractions
from robustlab.identification.validation.validation_result import (
    SMALLEST,
    BlockSize,
    Validation,
    concluded,
    in_own_units,
    require_replay,
)
from robustlab.record import Record
from robustlab.statespace import StateSpaceModel
from robustlab.uncertainty.blocks import Block

MEET = 1e-4  # relative distance by which a lower bound may exceed the upper one
# Samples of a cone programme over all of them, and of a relaxation: only the beginning of longer records is used.
LONGEST_PROGRAMME, LONGEST_RELAXED = 8000, 4000
RELAXED_SHARE = 0.5  # of the work, for the lower bound of constants
RELAXATION = "lower bound with all blocks time-varying (relaxation)"
NO_BOUND = "no lower bound (a constant in continuous time)"


@dataclass(frozen=True)
class _Found:
    """Bounds of gamma with the explanation of the record."""

    lower: float
    upper: float
    label: str
    certified: bool
    noise: Array
    excess: float
    values: Mapping[str, float] = field(default_factory=dict)  # of the constants
    problem: SampledProblem | None = None  # of the dynamic blocks, with their signals and states:
    w: Array = field(default_factory=lambda: np.zeros((0, 0)))
    z: Array = field(default_factory=lambda: np.zeros((0, 0)))
    states: Mapping[int, Array] = field(default_factory=dict)
    multipliers: Mapping[str, Array] = field(default_factory=dict)
    recheck: Callable[[], float] | None = None


def validate_by_samples(
    record: Record, recorded: Recorded, search: Search, progress: Callable[[str], None], estimated: bool
) -> Validation:
    """Compute bounds of the smallest gamma over the samples; see `robustlab.identification.validation.validate`."""
    found = _bounds(recorded, search)
    progress(f"gamma {found.lower:.4g} .. {found.upper:.4g}")
    if np.isfinite(found.upper) and found.lower > found.upper * (1 + MEET) + SMALLEST:
        found_both = f"a lower bound of gamma, {found.lower:.6g}, above the upper one, {found.upper:.6g}"
        raise NoTrustworthyNumber(f"validate {record.name}", found_both)
    measured = np.column_stack([record.outputs[s.name] for s in recorded.outputs])
    explained, error = np.full(measured.shape, np.nan), 0.0
    if np.isfinite(found.upper):
        explained = measured - found.noise * recorded.bound
        error = _replay_error(recorded, found)
        require_replay(error, record.name)
    w, z, sizes = found.w, found.z, {}
    if found.problem is not None and w.size:
        sizes = dict(zip(found.problem.names, found.problem.sizes(w, z).tolist(), strict=True))
        w, z = in_own_units(w, z, found.problem.blocks, found.problem.scale)
    return Validation(
        status=concluded(found.lower, found.upper, search, certified=found.certified),
        record=record.name,
        lower=float(min(found.lower, found.upper)),
        upper=float(found.upper),
        label=found.label,
        blocks={b.name: _block(b, found, sizes) for b in recorded.uncertain.blocks},
        noise_bound={s.name: float(b) for s, b in zip(recorded.outputs, recorded.bound, strict=True)},
        noise_norm=recorded.norm,
        excess=found.excess,
        replay_error=error,
        assumptions=_assumptions(recorded, estimated),
        t=record.t,
        measured=measured,
        nominal=measured - _without_starts(recorded, recorded.uncertain.nominal) * recorded.bound,
        explained=explained,
        outputs=tuple((s.name, s.unit) for s in recorded.outputs),
        w=w,
        z=z,
        multipliers=found.multipliers,
        recheck=found.recheck,
        notes=(search.budget.remark,) if search.budget.remark else (),
    )


def _bounds(recorded: Recorded, search: Search) -> _Found:
    """Bound gamma: systems by their signals, constants by their values, both together with nominal constants."""
    blocks = recorded.uncertain.blocks
    if not any(b.interval for b in blocks):
        return _dynamic(recorded, search)
    if all(b.interval for b in blocks):
        best = smallest_parameters(recorded, search)
        values = {b.name: float(v) for b, v in zip(blocks, best.delta, strict=True)} if np.isfinite(best.upper) else {}
        what = "constants; upper bound by descent, replayed"
        found = _Found(0.0, best.upper, "", not best.upper, best.noise, best.excess, values)
    else:
        found = _dynamic(recorded, search)
        values = {b.name: 0.0 for b in blocks if b.interval} if np.isfinite(found.upper) else {}
        what = "constants and systems; upper bound with the constants at nominal"
        found = replace(found, lower=0.0, values=values, multipliers={}, recheck=None, certified=False)
    if not recorded.uncertain.dt or not found.upper:
        return replace(found, label=f"{what}, {NO_BOUND if found.upper else RELAXATION}")
    # Valid for constants in discrete time only: in continuous time w = delta z is not held between samples.
    problem = sampled(recorded.first(LONGEST_RELAXED), recorded.uncertain.M, blocks)
    relaxed = smallest_contractions(problem, search._replace(budget=search.budget.share(RELAXED_SHARE)))
    lower, multipliers = relaxed.lower, relaxed.multipliers.arrays()
    upper = np.inf if np.isinf(lower) else found.upper
    return replace(found, lower=lower, upper=upper, label=f"{what}, {RELAXATION}", multipliers=multipliers)


def _dynamic(recorded: Recorded, search: Search) -> _Found:
    """Bound gamma with real blocks at nominal; without a block noise alone must explain the record."""
    M, blocks = at_nominal(recorded.uncertain)
    long = len(recorded.t) > LONGEST_PROGRAMME and bool(blocks)
    problem = sampled(recorded.first(LONGEST_PROGRAMME) if long else recorded, M, blocks)
    if any(repeated for _, _, repeated in problem.blocks):
        found, wanted = "a repeated complex scalar as a time-varying system", "full blocks and complex scalars"
        raise InputError("validate", found, wanted, 'domain="frequency", where blocks are time-invariant')
    c = smallest_contractions(problem, search)
    label = "time-varying contractions (lower bound exact where the Lagrangian is concave)"
    if problem.z_is_known():
        label = "time-varying contractions (exact)" if blocks else "noise alone: the set has no block"
    recheck = None
    if c.lower > 0:
        start = c.lower * (1 + search.precision) if np.isfinite(c.lower) else np.inf
        recheck = lambda: disproved_by(problem, c.multipliers, search, start)  # noqa: E731
    if long:
        label = f"lower bound from the first {LONGEST_PROGRAMME} samples (time-varying), no explanation sought"
        return _Found(
            c.lower, np.inf, label, True, c.noise, c.excess, multipliers=c.multipliers.arrays(), recheck=recheck
        )
    arrays = c.multipliers.arrays()
    return _Found(c.lower, c.upper, label, True, c.noise, c.excess, {}, problem, c.w, c.z, c.states, arrays, recheck)


def _block(block: Block, found: _Found, sizes: Mapping[str, float]) -> BlockSize:
    if not block.interval:
        return BlockSize(block.name, "time-varying", sizes.get(block.name, np.nan))
    value = found.values.get(block.name)
    if value is None or block.parameter is None:
        return BlockSize(block.name, "constant", np.nan if value is None else abs(value), value)
    size = block.parameter.value(value)
    physical, impossible = (size, block.parameter.unit), block.parameter.impossible(size)
    return BlockSize(block.name, "constant", abs(value), value, physical, impossible)


def _replay_error(recorded: Recorded, found: _Found) -> float:
    """Recompute the explanation independently and compare its noise, over the bound."""
    if found.problem is not None:
        _, noise = found.problem.respond(found.w, found.states)
        return float(np.abs(noise - found.noise).max(initial=0.0))
    from robustlab.dynamics import simulate  # constants: the member itself

    member = recorded.uncertain.evaluate(found.values)
    t = recorded.t - recorded.t[0]
    t = member.dt * np.arange(len(t)) if member.is_discrete else t
    run = simulate(member, t, dict(zip(member.input_names, recorded.u.T, strict=True)))
    y = np.column_stack([run.outputs[s.name] for s in recorded.outputs])
    return float(np.abs(_without_starts(recorded, member, (recorded.y - y) / recorded.bound - found.noise)).max())


def _without_starts(recorded: Recorded, M: StateSpaceModel, error: Array | None = None) -> Array:
    """Remove the response of free initial states from the error of a model without Delta, or ``error``, (n, n_y)."""
    problem = sampled(recorded, M, ())
    error = problem.e if error is None else error
    free = problem.free_response().reshape(error.size, -1)
    x = np.linalg.lstsq(free, error.ravel())[0] if free.shape[1] else np.zeros(0)
    return error - (free @ x).reshape(error.shape)


def _assumptions(recorded: Recorded, estimated: bool) -> tuple[str, ...]:
    dynamic = not all(b.interval for b in recorded.uncertain.blocks)
    peak, windows = recorded.norm == "peak", len(recorded.starts)
    texts = [
        "no sample of the noise is beyond its bound"
        if peak
        else "the root mean square of the noise over the record is within its bound"
    ]
    if estimated:
        texts.append("the noise bound was estimated from the record's own periods")
    if dynamic:
        texts.append("complex and full blocks are causal time-varying systems with zero initial state")
    if recorded.uncertain.dt == 0:
        texts.append(f"{'u and w are' if dynamic else 'u is'} held between samples of {recorded.dt:.6g} s")
    rest, free = "the model starts at equilibrium", "observable states are free at the start, the others zero"
    texts.append(rest if recorded.at_rest else free)
    if windows > 1:
        texts.append(f"{windows} windows, each with a free start; Delta is one over all of them")
    return tuple(texts)
