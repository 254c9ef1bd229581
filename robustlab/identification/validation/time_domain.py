r"""Validation over the samples: bounds of gamma, the replay of the explanation, and the result.

The lower bound of a constant of a discrete model is that of a time-varying system of the same size, a larger set. Its
upper bound is by descent: for fixed parameters the noise is affine in the free states; successive cone programmes
change both at once, first to meet the noise bound, then to minimise the size.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from robustlab.arrays import Array
from robustlab.errors import InputError, NoTrustworthyNumber
from robustlab.identification.validation.sampled_problem import (
    SLACK,
    Found,
    Recorded,
    Rows,
    SampledProblem,
    Search,
    at_nominal,
    sampled,
    solved_cones,
    sparse_matrices,
)
from robustlab.identification.validation.time_varying import smallest_contractions
from robustlab.identification.validation.validation_result import (
    SMALLEST,
    BlockSize,
    Validation,
    concluded,
    require_replay,
)
from robustlab.record import Record
from robustlab.statespace import StateSpaceModel
from robustlab.uncertainty.blocks import Block

MEET = 1e-4  # relative distance by which a lower bound may exceed the upper one
# Samples of a cone programme over all of them.
LONGEST = 8000
RELAXED_SHARE = 0.5  # of the work, for the lower bound of constants
RELAXATION = "lower bound with all blocks time-varying (relaxation)"
NO_BOUND = "no lower bound (a constant in continuous time, or a long record)"
WIDEST = 1e3  # parameters beyond this many times their range are not tried
MOVES = 40  # of a descent
CREEP, CREEPS = 0.995, 3  # stop after so many moves that leave more than this share of the noise beyond its bound
PRICE = 1e4  # of the noise beyond its bound, in units of the size of the parameters
STARTS = 3  # random ones besides the nominal one
SIMULATION_WORK = 500.0  # of a simulation, besides its samples
MARGIN = 1e-7  # distance of the programmes' target from the noise bound


def validate_by_samples(
    record: Record, recorded: Recorded, search: Search, progress: Callable[[str], None]
) -> Validation:
    """Compute bounds of the smallest gamma over the samples; see `robustlab.identification.validation.validate`."""
    found = _bounds(recorded, search)
    progress(f"gamma {found.lower:.4g} .. {found.upper:.4g}")
    if np.isfinite(found.upper) and found.lower > found.upper * (1 + MEET) + SMALLEST:
        found_both = f"a lower bound of gamma, {found.lower:.6g}, above the upper one, {found.upper:.6g}"
        raise NoTrustworthyNumber(f"validate {record.name}", found_both)
    measured = np.column_stack([record.outputs[s.name] for s in recorded.outputs])
    explained, error, sizes = np.full(measured.shape, np.nan), 0.0, dict[str, float]()
    if np.isfinite(found.upper):
        explained = measured - found.noise * recorded.bound
        error = require_replay(_replay_error(recorded, found), record.name)
    if found.problem is not None and found.w.size:
        sizes = dict(zip(found.problem.names, found.problem.sizes(found.w, found.z).tolist(), strict=True))
    return concluded(
        found,
        search,
        recorded.outputs,
        record=record.name,
        blocks={b.name: _block(b, found, sizes) for b in recorded.uncertain.blocks},
        noise_bound={s.name: float(b) for s, b in zip(recorded.outputs, recorded.bound, strict=True)},
        noise_norm="peak",
        replay_error=error,
        assumptions=_assumptions(recorded),
        t=record.t,
        measured=measured,
        nominal=measured - _without_starts(recorded, recorded.uncertain.nominal) * recorded.bound,
        explained=explained,
    )


def _bounds(recorded: Recorded, search: Search) -> Found:
    """Bound gamma: systems by their signals, constants by their values, both together with nominal constants."""
    blocks = recorded.uncertain.blocks
    if not any(b.interval for b in blocks):
        return _dynamic(recorded, search)
    if all(b.interval for b in blocks):
        found, what = smallest_parameters(recorded, search), "constants; upper bound by descent, replayed"
    else:
        found, what = _dynamic(recorded, search), "constants and systems; upper bound with the constants at nominal"
        values = {b.name: 0.0 for b in blocks if b.interval} if np.isfinite(found.upper) else {}
        found = replace(found, lower=0.0, values=values, multipliers=None, certified=False)
    if not recorded.uncertain.dt or not found.upper or len(recorded.t) > LONGEST:
        return replace(found, label=f"{what}, {NO_BOUND if found.upper else RELAXATION}")
    # Valid for constants in discrete time only: in continuous time w = delta z is not held between samples.
    problem = sampled(recorded, recorded.uncertain.M, blocks)
    relaxed = smallest_contractions(problem, search._replace(budget=search.budget.share(RELAXED_SHARE)))
    upper = np.inf if np.isinf(relaxed.lower) else found.upper
    label = f"{what}, {RELAXATION}"
    return replace(found, lower=relaxed.lower, upper=upper, label=label, multipliers=relaxed.multipliers)


def _dynamic(recorded: Recorded, search: Search) -> Found:
    """Bound gamma with real blocks at nominal; without a block noise alone must explain the record."""
    M, blocks = at_nominal(recorded.uncertain)
    if len(recorded.t) > LONGEST and blocks:
        hint = "take the beginning (Record.between): its lower bound holds for the whole record"
        raise InputError("validate", f"{len(recorded.t)} samples", f"at most {LONGEST} with systems in Delta", hint)
    problem = sampled(recorded, M, blocks)
    if any(repeated for _, _, repeated in problem.blocks):
        found, wanted = "a repeated complex scalar as a time-varying system", "full blocks and complex scalars"
        raise InputError("validate", found, wanted, 'domain="frequency", where blocks are time-invariant')
    c = smallest_contractions(problem, search)
    label = "time-varying contractions (lower bound exact where the Lagrangian is concave)"
    if problem.z_is_known():
        label = "time-varying contractions (exact)" if blocks else "noise alone: the set has no block"
    return replace(c, label=label)


def _block(block: Block, found: Found, sizes: Mapping[str, float]) -> BlockSize:
    if not block.interval:
        return BlockSize(block.name, "time-varying", sizes.get(block.name, np.nan))
    value, parameter = found.values.get(block.name), block.parameter
    size = np.nan if value is None else abs(value)
    if value is None or parameter is None:
        return BlockSize(block.name, "constant", size, value)
    physical = parameter.value(value)
    return BlockSize(block.name, "constant", size, value, (physical, parameter.unit), parameter.impossible(physical))


def _replay_error(recorded: Recorded, found: Found) -> float:
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
    found, free, n_y, k = error.copy(), problem.free_response(), error.shape[1], problem.free.shape[1]
    ends = dict(pairwise([*problem.starts, problem.n]))
    for i, a in enumerate(problem.free_starts):
        window = found[a : ends[a]]
        own = free[a * n_y : ends[a] * n_y, i * k : (i + 1) * k].toarray()
        window -= (own @ np.linalg.lstsq(own, window.ravel())[0]).reshape(window.shape)
    return found


def _assumptions(recorded: Recorded) -> tuple[str, ...]:
    dynamic = not all(b.interval for b in recorded.uncertain.blocks)
    windows, texts = len(recorded.starts), ["no sample of the noise is beyond its bound"]
    if dynamic:
        texts.append("complex and full blocks are causal time-varying systems with zero initial state")
    if recorded.uncertain.dt == 0:
        texts.append(f"{'u and w are' if dynamic else 'u is'} held between samples of {recorded.dt:.6g} s")
    rest, free = "the model starts at equilibrium", "observable states are free at the start, the others zero"
    texts.append(rest if recorded.at_rest else free)
    if windows > 1:
        texts.append(f"{windows} windows, each with a free start; Delta is one over all of them")
    return tuple(texts)


# --- constants --------------------------------------------------------------------------------------------------------


class _Member(NamedTuple):
    """A member of the set: noise (n, n_y) from the free states x, and the response of -noise to them (n n_y, k)."""

    delta: Array
    problem: SampledProblem
    free: Any

    def noise(self, x: Array) -> Array:
        return self.problem.e - (self.free @ x).reshape(self.problem.e.shape)

    def found(self, x: Array) -> Found:
        noise, size = self.noise(x), float(np.abs(self.delta).max())
        excess = self.problem.excess(noise)
        return Found(0.0, size if excess <= 1 + SLACK and size <= WIDEST else np.inf, noise, excess)


def smallest_parameters(recorded: Recorded, search: Search) -> Found:
    """Search the smallest ``|delta|`` that explains the record, all blocks real."""
    blocks, rng = recorded.uncertain.blocks, np.random.default_rng(0)
    m = len(blocks)
    best: tuple[Found, Array] = Found(0.0, np.inf, np.zeros(recorded.y.shape), np.inf), np.zeros(m)
    for start in (np.zeros(m), *(rng.uniform(-1, 1, m) for _ in range(STARTS if m > 1 else 1))):
        best = min(best, _descend(recorded, start, search), key=_rank)
        if not best[0].upper:
            break
    found, delta = best
    values = dict(zip([b.name for b in blocks], delta.tolist(), strict=True)) if np.isfinite(found.upper) else {}
    return replace(found, values=values, certified=not found.upper)


def _rank(found: tuple[Found, Array]) -> tuple[float, float]:
    return found[0].upper, found[0].excess


def _descend(recorded: Recorded, start: Array, search: Search) -> tuple[Found, Array]:
    """Solve successive programmes with a trust region; return the best member and its delta."""
    m, radius, creeps = len(start), 0.5, 0
    at = _member(recorded, start, search)
    fitted = None if at is None else _move(at, np.zeros((recorded.y.size, m)), search, 0.0)
    if at is None or fitted is None:
        return Found(0.0, np.inf, np.zeros(recorded.y.shape), np.inf), start
    x = fitted[1]
    here = at.found(x)
    best = here, start
    for _ in range(MOVES):
        if creeps >= CREEPS or search.budget.over or not best[0].upper:
            break
        step = 1e-5 * max(1.0, float(np.abs(at.delta).max()))
        sides = [_member(recorded, at.delta + s * step * unit, search) for unit in np.eye(m) for s in (1, -1)]
        known = [side.noise(x).ravel() for side in sides if side is not None]
        if len(known) < len(sides):
            break
        slope = np.column_stack([(a - b) / (2 * step) for a, b in zip(known[::2], known[1::2], strict=True)])
        moved = _move(at, slope, search, radius)
        if moved is None:
            break
        new = _member(recorded, at.delta + moved[0], search)
        if new is None:
            radius /= 4
            continue
        there = new.found(moved[1])
        was, now = max(here.excess - 1, 0.0) * PRICE, max(there.excess - 1, 0.0) * PRICE
        creeps = creeps + 1 if now > CREEP * was > 0 else 0
        best = min(best, (there, new.delta), key=_rank)
        if was + np.abs(at.delta).max() > now + np.abs(new.delta).max():
            length, size = float(np.abs(moved[0]).max()), float(np.abs(new.delta).max())
            at, x, here, radius = new, moved[1], there, min(2 * radius, max(4 * length, 1e-3), WIDEST)
            if length < 0.02 * search.precision * max(size, 1e-9) and (there.excess <= 1 + SLACK or length < 1e-9):
                break
        else:
            radius /= 4
            if radius < 1e-9:
                break
    return best


def _member(recorded: Recorded, delta: Array, search: Search) -> _Member | None:
    """Simulate the member at delta; None if it is ill-posed or overflows."""
    search.budget.spend(SIMULATION_WORK + 0.3 * recorded.y.size)
    uncertain = recorded.uncertain
    try:
        model = uncertain.evaluate(dict(zip([b.name for b in uncertain.blocks], delta.tolist(), strict=True)))
        problem = sampled(recorded, model, ())
    except NoTrustworthyNumber:
        return None
    free = problem.free_response()
    return _Member(delta, problem, free) if np.isfinite(free.data).all() else None


def _move(at: _Member, slope: Array, search: Search, radius: float) -> tuple[Array, Array] | None:
    """Solve the linearised problem for the change of delta and the free states; None without an answer.

    Variables: change of delta, size of delta, excess of the noise, free states of each window.
    """
    sparse, problem = sparse_matrices(), at.problem
    m, n = len(at.delta), problem.e.size
    noise = sparse.hstack([sparse.csr_matrix(slope), sparse.csr_matrix((n, 2)), -at.free]).tocsr()
    width = noise.shape[1]
    every = sparse.identity(width, format="csr")
    change, size, over = every[:m], every[m : m + 1], every[m + 1 : m + 2]
    ones = sparse.csr_matrix(np.ones((m, 1)))
    spare, e = sparse.csr_matrix(np.ones((2 * n, 1))) @ over, problem.e.ravel()
    held, sized = np.full(2 * m, radius), np.concatenate([-at.delta, at.delta])
    rows = [
        Rows(sparse.vstack([noise, -noise]) - spare, 1 - MARGIN + np.concatenate([-e, e]), "positive"),
        Rows(sparse.vstack([change, -change]), held, "positive") if radius else Rows(change, np.zeros(m), "zero"),
        Rows(sparse.vstack([change - ones @ size, -change - ones @ size]), sized, "positive"),
        Rows(-over, np.zeros(1), "positive"),
    ]
    cost = np.zeros(width)
    cost[m], cost[m + 1] = 1.0, PRICE
    found = solved_cones(cost, rows, search.budget)
    return None if found is None else (found.x[:m], found.x[m + 2 :])
