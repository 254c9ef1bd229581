r"""Validation over the samples: bounds of gamma, the replay of the explanation, and the result.

Systems are causal time-varying contractions (Poolla et al., IEEE TAC 39, 1994, theorem 3.3). Cone programmes bound
gamma from above, convex-concave where z depends on w; multipliers D, lambda >= 0 from below: the maximum of
L = sum D (gamma^2 |z|^2 - |w|^2) + Lambda(n) over w and starts takes one backward sweep; negative, it is a proof.

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

from robustlab.arrays import Array, Mask
from robustlab.errors import InputError, NoTrustworthyNumber
from robustlab.identification.validation.sampled_problem import (
    SLACK,
    ConeSolution,
    Found,
    Multipliers,
    Recorded,
    Rows,
    SampledProblem,
    Search,
    at_nominal,
    largest_disproved,
    sampled,
    solved_cones,
    sparse_matrices,
)
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
    """Solve the linearised problem for the change of delta and the free states; None without an answer."""
    # Variables: change of delta, size of delta, excess of the noise, free states of each window.
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


NOISE_MARGIN = 1e-7  # distance of the solver's target from the noise bound: larger is safer to replay, costs gamma
VARYING_ROUNDS = 25  # convex-concave steps at most
SWEEP_WORK = 250.0  # per sample, to find the gamma that multipliers disprove: some 15 sweeps over the record
AHEAD = 3.0  # initial energy of z in the first guess: larger, and no early sample decides
FLOOR = 1e-7  # a multiplier of this share of the largest makes every sweep strictly concave, and is as valid
FLAT = 1e-11  # curvatures below this share of the largest count as zero, and the linear term there must vanish
UNBOUNDED = 1e9  # multiplier of a signal that is zero anyhow, over those of the noise
NONE = np.zeros((0, 0))
NO_ENERGY = 1e-18  # an energy of z below this share of its final one forces w to zero for any finite gain


# --- the certificate -------------------------------------------------------------------------------------------------


def _cleaned(D: Array, noise: Array) -> Multipliers:
    """Make any numbers valid multipliers, D nonincreasing, scaled to a largest noise multiplier of one."""
    scale = float(np.abs(noise).max(initial=0.0)) or 1.0
    noise, D = np.maximum(noise, 0.0) / scale, np.maximum(D, 0.0) / scale
    D = np.maximum.accumulate(D[::-1], axis=0)[::-1]
    return Multipliers(D + FLOOR * np.maximum(D.max(axis=0, initial=0.0), 1e-12), noise)


def lagrangian_maximum(problem: SampledProblem, multipliers: Multipliers, gamma: float) -> float:
    """Maximise L over all w and free states; +inf if L is not bounded above. A negative value is a proof."""
    (n_x, q), p, n_y = problem.B.shape, len(problem.C1), len(problem.C2)
    D, noise = multipliers.D, multipliers.noise
    # Rows of (x, w, 1) to z, w and n; their last columns change with t.
    to_z = np.hstack([problem.C1, problem.D11, np.zeros((p, 1))])
    to_n = np.hstack([-problem.C2, -problem.D21, np.zeros((n_y, 1))])
    to_w = np.hstack([np.zeros((q, n_x)), np.eye(q), np.zeros((q, 1))])
    step = np.zeros((n_x + 1, n_x + q + 1))
    step[:n_x, :n_x], step[:n_x, n_x : n_x + q], step[n_x, -1] = problem.A, problem.B, 1.0
    weight_z, weight_w = np.zeros((problem.n, p)), np.zeros((problem.n, q))
    for k, (rows, cols, _) in enumerate(problem.blocks):
        weight_z[:, cols] = (gamma**2 * D[:, k])[:, None]
        weight_w[:, rows] = D[:, k][:, None]
    value = np.zeros((n_x + 1, n_x + 1))
    keep, move = [*range(n_x), n_x + q], list(range(n_x, n_x + q))
    for t in range(problem.n - 1, -1, -1):
        to_z[:, -1], to_n[:, -1] = problem.z0[t], problem.e[t]
        H = step.T @ value @ step + to_z.T @ (weight_z[t][:, None] * to_z)
        H -= to_w.T @ (weight_w[t][:, None] * to_w) + to_n.T @ (noise[t][:, None] * to_n)
        value = _maximised(H, keep, move)
        if value is not None and t in problem.free_starts:  # x + free xi for the best xi
            jump = np.zeros((n_x + 1, n_x + 1 + problem.free.shape[1]))
            jump[:n_x, :n_x], jump[n_x, n_x], jump[:n_x, n_x + 1 :] = np.eye(n_x), 1.0, problem.free
            value = _maximised(jump.T @ value @ jump, [*range(n_x + 1)], list(range(n_x + 1, jump.shape[1])))
        if value is None:
            return np.inf
    return float(value[n_x, n_x] + noise.sum())


def _maximised(H: Array, keep: list[int], move: list[int]) -> Array | None:
    """Maximise a quadratic form over the variables ``move`` and return the form in ``keep``; None if unbounded."""
    if not move:
        return H[np.ix_(keep, keep)]
    inner, cross = H[np.ix_(move, move)], H[np.ix_(move, keep)]
    values, vectors = np.linalg.eigh(0.5 * (inner + inner.T))
    size = float(np.abs(values).max(initial=0.0))
    turned = vectors.T @ cross
    flat = values > -FLAT * max(size, 1e-300)
    if (values[flat] > FLAT * size).any() or np.abs(turned[flat]).max(initial=0.0) > 1e-7 * np.abs(H).max():
        return None
    gain = turned[~flat] / np.sqrt(-values[~flat])[:, None]
    outer = H[np.ix_(keep, keep)] + gain.T @ gain
    return 0.5 * (outer + outer.T)


def disproved_by(problem: SampledProblem, multipliers: Multipliers, search: Search, start: float) -> float:
    """Find the largest gamma below ``start`` that the multipliers disprove; 0 for none."""
    # An infinite ``start`` belongs to multipliers D that are zero where w is free: they disprove every gamma or none.
    search.budget.spend(SWEEP_WORK * problem.n)
    if np.isinf(start):
        return np.inf if lagrangian_maximum(problem, multipliers, 1.0) < 0 else 0.0
    return largest_disproved(lambda g: lagrangian_maximum(problem, multipliers, g) < 0, start, search.precision / 10)


# --- the search ------------------------------------------------------------------------------------------------------


def smallest_contractions(problem: SampledProblem, search: Search) -> Found:
    """Compute bounds of the smallest gamma over all blocks."""
    programme = _Programme(problem, search)
    if not problem.blocks:
        return _by_noise(programme)
    z = problem.z0
    if not programme.convex:
        # As if the nominal z acted, with some initial energy so that no early sample decides.
        guess = programme.smallest(z, known=True, ahead=AHEAD) or programme.least_noise()
        z = problem.respond(*programme.signals(guess.x))[0]
    solution, before = None, np.inf
    nothing = Multipliers(np.zeros((problem.n, len(problem.blocks))), np.zeros(problem.e.shape))
    best = Found(0.0, np.inf, NONE, 1.0, nothing, problem=problem)
    for _ in range(1 if programme.convex else VARYING_ROUNDS):
        found = programme.smallest(z, known=programme.convex)
        if found is None:
            break
        solution = found
        w, jumps = programme.signals(found.x)
        for rows, cols, _ in problem.blocks:  # the solver's zeros are small numbers, for which no gain is enough
            w[_silent(problem, z, cols), rows] = 0.0
        z, noise = problem.respond(w, jumps)
        excess, gamma = problem.excess(noise), float(problem.sizes(w, z).max(initial=0.0))
        if excess > 1 + SLACK:
            break
        if gamma < best.upper:
            best = replace(best, upper=gamma, noise=noise, excess=excess, w=w, z=z, states=jumps)
        reached = programme.gamma(found)
        if reached > before * (1 - 0.02 * search.precision) or search.budget.over:
            break
        before = reached
    if solution is None:
        return _by_noise(programme)
    top = best.upper if np.isfinite(best.upper) else programme.gamma(solution)
    multipliers = programme.multipliers(solution)
    lower = disproved_by(problem, multipliers, search, top) if top > 0 else 0.0
    return replace(best, lower=lower, multipliers=multipliers)


def _silent(problem: SampledProblem, z: Array, cols: slice) -> Mask:
    """Return the first samples at which z has no energy: w must be zero there for any finite gain."""
    # From equilibrium that is so until the nominal z moves, even where w could move z.
    energy = np.cumsum((z[:, cols] ** 2).sum(axis=1))
    silent = energy <= NO_ENERGY * max(energy[-1], 1e-300)
    if problem.at_rest:
        nominal = np.cumsum((problem.z0[:, cols] ** 2).sum(axis=1))
        silent |= nominal <= NO_ENERGY * nominal[-1]
    return silent


def _by_noise(programme: _Programme) -> Found:
    """Minimise the noise over any w, and test whether its multipliers disprove every gamma."""
    # Where z is known, w is zero before z moves: its multipliers there are unbounded.
    problem = programme.problem
    silent = np.zeros((problem.n, len(problem.blocks)), dtype=bool)
    for k, (_, cols, _) in enumerate(problem.blocks if programme.convex else ()):
        silent[:, k] = _silent(problem, problem.z0, cols)
    solved = programme.least_noise(silent)
    D = np.where(np.cumsum(~silent, axis=0) == 0, UNBOUNDED, 0.0)
    multipliers = Multipliers(D, _cleaned(np.zeros_like(D), programme.multipliers(solved).noise).noise)
    w, jumps = programme.signals(solved.x)
    z, noise = problem.respond(w, jumps)
    excess = problem.excess(noise)
    if not problem.blocks and excess <= 1 + SLACK:
        return Found(0.0, 0.0, noise, excess, multipliers, problem=problem, w=w, z=z, states=jumps)
    # w is free where D is zero, and z is zero elsewhere: L is the same for every gamma.
    lower = disproved_by(problem, multipliers, programme.search, np.inf)
    return Found(lower, np.inf, NONE, excess, multipliers, problem=problem)


# --- the programme ---------------------------------------------------------------------------------------------------


class _Programme:
    """The cone programme in the sparse variables (x_t, w_t, cumulative energies of w and z, g)."""

    def __init__(self, problem: SampledProblem, search: Search) -> None:
        self.problem, self.search = problem, search
        sparse, n, (n_x, q), m = sparse_matrices(), problem.n, problem.B.shape, len(problem.blocks)
        every = sparse.identity(n * (n_x + q + 2 * m) + 1, format="csr")
        parts = np.split(np.arange(every.shape[0]), np.cumsum([n * n_x, n * q, n * m, n * m]))
        self.x, self.w, self.taken, self.there, self.last = (every[part] for part in parts)  # rows of one variable each
        self.before = sparse.eye(n, k=-1, format="csr")
        self.convex = problem.z_is_known()
        self._dynamics = self._motion()

    def _affine(self, on_x: Array, on_w: Array) -> Any:
        """Return the rows of matrices on x_t and w_t, for all t in turn."""
        sparse = sparse_matrices()
        eye = sparse.identity(self.problem.n, format="csr")
        return (sparse.kron(eye, on_x) @ self.x + sparse.kron(eye, on_w) @ self.w).tocsr()

    def _motion(self) -> Rows:
        """Return the equations of motion; at free starts only across the directions in which the state may jump."""
        from scipy import linalg

        sparse, p = sparse_matrices(), self.problem
        n_x = len(p.A)
        rows = self.x - sparse.kron(self.before, p.A) @ self.x - sparse.kron(self.before, p.B) @ self.w
        rows, kept = rows.tocsr(), np.ones(p.n, dtype=bool)
        kept[list(p.free_starts)] = False
        across: Any = linalg.null_space(p.free.T) if p.free.size else np.eye(n_x)
        jumps = [sparse.csr_matrix(across.T) @ rows[t * n_x : (t + 1) * n_x] for t in p.free_starts]
        motion = sparse.vstack([rows[np.repeat(kept, n_x)], *jumps])
        return Rows(motion, np.zeros(motion.shape[0]), "zero")

    def _noise(self, radius: float | None) -> list[Rows]:
        """Constrain the noise by ``radius`` times its bound; None: by the variable g times its bound."""
        sparse, p = sparse_matrices(), self.problem
        outputs, found = self._affine(p.C2, p.D21), []
        head = self.last * (0.0 if radius is not None else 1.0)
        for j, e in enumerate(p.e.T):
            rows = outputs[j :: p.e.shape[1]]
            both = sparse.vstack([rows, -rows]) - sparse.csr_matrix(np.ones((2 * p.n, 1))) @ head
            found.append(Rows(both, np.concatenate([e, -e]) + (radius or 0.0), "positive", 1, ("noise", j)))
        return found

    def _energies(self, z: Array, known: bool, ahead: float) -> list[Rows]:
        """Constrain the cumulative energies of w / g by those of z, or by their tangents at z if it is not known."""
        # ``ahead``: initial energy of z in mean samples, for a first guess.
        sparse, p = sparse_matrices(), self.problem
        n, q, n_z = p.n, p.B.shape[1], len(p.C1)
        new = sparse.identity(n, format="csr") - self.before  # increments of a cumulative sum
        to_z, found = self._affine(p.C1, p.D11), []
        for k, (rows, cols, _) in enumerate(p.blocks):
            each = (z[:, cols] ** 2).sum(axis=1)
            each[0] += ahead * each.mean()
            silent = _silent(p, z, cols) if ahead == 0 else np.zeros(n, dtype=bool)
            taken, there = self.taken[k * n : (k + 1) * n], self.there[k * n : (k + 1) * n]
            w = [self.w[i::q] for i in range(rows.start, rows.stop)]
            added = new @ there
            if not known:  # e_T - e_{T-1} = 2 z'z(w, x) - z'z, which is the energy itself where z is known
                each = (z[:, cols] * (2 * p.z0[:, cols] - z[:, cols])).sum(axis=1)
                added = added - sum(sparse.diags(2 * z[:, i]) @ to_z[i::n_z] for i in range(cols.start, cols.stop))
            found.append(Rows(added, each, "zero"))
            still = sparse.vstack([part[silent] for part in (*w, taken)])
            found.append(Rows(still, np.zeros(still.shape[0]), "zero"))
            found.append(Rows((taken - there)[~silent], np.zeros(int((~silent).sum())), "positive", 1, ("energy", k)))
            # (s + g, s - g, 2 w) in the cone: s g >= |w|^2
            more = (new @ taken)[~silent]
            g = sparse.csr_matrix(np.ones((more.shape[0], 1))) @ self.last
            cone = sparse.vstack([-more - g, g - more, *(-2 * part[~silent] for part in w)])
            found.append(Rows(cone, np.zeros(cone.shape[0]), "second-order", 2 + len(w)))
        return found

    def smallest(self, z: Array, known: bool, ahead: float = 0.0) -> ConeSolution | None:
        """Minimise g = gamma^2 with the energies of z, or their tangents at z; None if infeasible."""
        return self._solved([*self._noise(1 - NOISE_MARGIN), *self._energies(z, known, ahead)])

    def least_noise(self, silent: Mask | None = None) -> ConeSolution:
        """Minimise the factor on the noise bound with which some w explains the record; w is zero where ``silent``."""
        p = self.problem
        held = np.zeros((p.n, p.B.shape[1]), dtype=bool)
        if silent is not None:
            for k, (rows, _, _) in enumerate(p.blocks):
                held[:, rows] = silent[:, k : k + 1]
        still = Rows(self.w[held.ravel()], np.zeros(int(held.sum())), "zero")
        found = self._solved([*self._noise(None), still])
        if found is None:
            raise NoTrustworthyNumber("validate", "the solver gave no answer (infeasible)")
        return found

    def _solved(self, rows: list[Rows]) -> ConeSolution | None:
        """Minimise g under the equations of motion."""
        cost = np.zeros(self.last.shape[1])
        cost[-1] = 1.0
        return solved_cones(cost, [r for r in (self._dynamics, *rows) if r.matrix.shape[0]], self.search.budget)

    def gamma(self, solved: ConeSolution) -> float:
        return float(np.sqrt(max(float(solved.x[-1]), 0.0)))

    def signals(self, x: Array) -> tuple[Array, dict[int, Array]]:
        """Return w (n, q), and the jumps at the free starts."""
        p = self.problem
        state, w = (self.x @ x).reshape(p.n, -1), (self.w @ x).reshape(p.n, -1)
        jumps = {}
        for t in p.free_starts:
            came = p.A @ state[t - 1] + p.B @ w[t - 1] if t else 0.0
            jumps[t] = p.free.T @ (state[t] - came)
        return w, jumps

    def multipliers(self, solved: ConeSolution) -> Multipliers:
        """Derive the multipliers of the quadratic certificate from those of the cone programme."""
        p = self.problem
        noise, D, g = np.zeros(p.e.shape), np.zeros((p.n, len(p.blocks))), max(float(solved.x[-1]), 1e-300)
        for (kind, k), part in solved.dual.items():
            if kind == "energy":
                D[:, k] = np.cumsum(np.pad(part[0], (p.n - part.size, 0))[::-1])[::-1] / g
            else:  # at n = +-1 the slope of 1 - n^2 is twice that of 1 -+ n
                noise[:, k] = 0.5 * np.abs(part[0, : p.n] - part[0, p.n :])
        return _cleaned(D, noise)
