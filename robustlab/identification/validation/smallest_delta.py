r"""Could this uncertain model have produced this record? The smallest scaling of Delta for which it could.

.. math:: \gamma^* = \min \gamma \quad \text{s.t.} \quad y = F_u(M, \Delta) u + n, \quad \|\Delta_i\| \le \gamma,
          \quad n \text{ within its bound}

References
----------
Poolla, Khargonekar, Tikku, Krause, Nagpal, "A time-domain approach to model validation", IEEE TAC 39 (1994) 951-959.
Smith and Doyle, "Model validation: a connection between robust control and identification", IEEE TAC 37 (1992) 942-952.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robustlab.arrays import Array
from robustlab.budget import MILLION, Budget, one_thread, search_budget
from robustlab.errors import InputError, NoTrustworthyNumber
from robustlab.identification.validation.certificate import largest_disproved
from robustlab.identification.validation.constant_parameters import smallest_parameters
from robustlab.identification.validation.frequency_domain import fits_frequency_domain, validate_by_lines
from robustlab.identification.validation.mixed_delta import smallest_mixed
from robustlab.identification.validation.result import BlockSize, Validation
from robustlab.identification.validation.sampled_problem import (
    NoiseNorm,
    Recorded,
    SampledProblem,
    prepared,
    sampled,
    with_delta_of,
)
from robustlab.identification.validation.spectral_problem import FrequencyData
from robustlab.identification.validation.time_invariant import PulseResponses, smallest_pulse_responses
from robustlab.identification.validation.time_varying import Contractions, smallest_contractions
from robustlab.identification.validation.window_fit import WindowFit
from robustlab.record import Record
from robustlab.result import Status
from robustlab.uncertainty.blocks import Block
from robustlab.uncertainty.lft import UncertainModel

__all__ = ["DeltaKind", "validate"]

DeltaKind = Literal["time-invariant", "time-varying"]

# What a validation may cost: about two minutes.
WORK = 120 * MILLION
# Pulse responses are unknowns of a dense problem: a longer record is cut to its beginning, which is a weaker test.
MOST_UNKNOWNS = 2000
LONGEST = 700
# So many samples a cone programme over all of them takes some 10 s; of a longer record the beginning is judged.
LONGEST_PROGRAMME = 8000
# Confidence that a noise bound taken from repeats is not exceeded by noise of that standard deviation.
CONFIDENCE = 0.99
# Sizes below this count as zero.
SMALLEST = 1e-6
# Rounding in the noise of an explanation, over its bound; and between a lower and an upper bound that meet.
SLACK, MEET = 1e-9, 1e-4


def validate(
    uncertain: UncertainModel,
    record: Record | FrequencyData,
    noise: Mapping[str, ArrayLike] | None = None,
    *,
    domain: Literal["time", "frequency"] = "time",
    noise_norm: NoiseNorm | None = None,
    delta: DeltaKind = "time-invariant",
    at_rest: bool = False,
    window: float | None = None,
    period: float | None = None,
    missing: Mapping[str, Sequence[int]] | None = None,
    per_block: bool = False,
    precision: float = 0.01,
    time_limit: float | None = None,
    progress: Callable[[str], None] | None = None,
    effort: float = 1.0,
) -> Validation:
    """Smallest scaling of Delta with which an uncertain model could have produced a record.

    Parameters
    ----------
    uncertain
        The set. Real blocks are constants; complex and full blocks are causal systems. A continuous model is sampled
        with all inputs, also w, held between samples. Without any block noise alone has to explain the record: gamma is
        0, or there is none.
    record
        The measurement, on a uniform clock; all inputs of the set must be recorded, and some of its outputs. In the
        frequency domain also a measured frequency response (`FrequencyData`).
    noise
        Output name -> bound of its noise, in its unit. Where left out it is estimated from the record's own periods
        (99 % confidence for white Gaussian noise), which asks for a record that repeats.
    domain
        ``"time"``: sample by sample (Poolla et al.). ``"frequency"``: line by line (Smith and Doyle), for blocks that
        are time-invariant systems, from whole periods of a record in steady state or from a `FrequencyData`.
    noise_norm
        ``"peak"``: no sample is off by more; ``"rms"``: the root mean square over the record is not larger. Where left
        out ``"peak"`` in the time domain. In the frequency domain it is ``"rms"`` for a record (over the periods used),
        and each line's own bound for a frequency response, of which ``noise`` may hold one for each line.
    delta
        What the complex and full blocks are.
    at_rest
        The record starts at rest. Otherwise the states that the outputs show are free at the start. Delta is at rest.
    window
        Cut the record into windows of that many seconds, each with a free start; Delta keeps its memory and its
        values. A weaker test, for records over which an open-loop response drifts.
    period
        Frequency domain: the period in s, where no recorded signal tells it.
    missing
        Output name -> samples (indices or a mask) that were not measured.
    per_block
        Also find the smallest scaling of each block alone, the others kept within their size 1.
    precision
        Relative width of the bounds to be reached.
    time_limit
        In s; what was found by then is returned with status TIMEOUT, and cannot be repeated. None: no limit.
    progress
        Called with one line at each step.
    effort
        Work that the search may take, as a multiple of the usual (about two minutes); counted, not timed.

    Returns
    -------
    Validation
        With both bounds, the Delta and the noise that explain the record, and the certificate of the lower bound.

        ============================  =======================================  =====================================
        blocks                        upper bound                              lower bound
        ============================  =======================================  =====================================
        frequency domain              w by cone programmes, loop closed again  multipliers, re-checked line by line
        time-varying                  w by convex-concave procedure, replayed  multipliers, re-checked by a sweep
        time-invariant, z known       pulse responses, replayed                dual of the convex problem (exact)
        time-invariant, z unknown     pulse responses by Gauss-Newton          that of time-varying ones (relaxation)
        constant                      values by descent, replayed              boxes tested at points (not proved)
        constant and dynamic          search over the constants                that of all time-varying (relaxation)
        none                          0 where noise alone explains the record  infinite elsewhere, weights re-checked
        ============================  =======================================  =====================================

        z is known where it depends neither on Delta nor on a free state: additive and multiplicative uncertainty.

    Raises
    ------
    InputError
        Signals that do not fit, an output without a noise bound, blocks that a domain cannot judge.
    NoTrustworthyNumber
        Irregular sampling, a noise bound of zero, a record that is not steady, no noise bound and no repeats to take it
        from, a solver that gives no answer.

    Examples
    --------
    >>> from robustlab.statespace import StateSpaceModel
    >>> from robustlab.uncertainty.unstructured import unstructured
    >>> gain = unstructured(StateSpaceModel([], [], [], [[2.0]], dt=1.0), 1.0)
    >>> steps = Record(range(4), {"u1": [1, 0, 0, 0]}, {"y1": [2.5, 0, 0, 0]})
    >>> found = validate(gain, steps, {"y1": 0.1}, at_rest=True)
    >>> round(found.upper, 2), found.invalidated, str(found.status)
    (0.4, False, 'certified')
    """
    budget, estimated = search_budget("validate", WORK, effort, time_limit), noise is None
    if not isinstance(uncertain, UncertainModel):
        raise InputError("validate", type(uncertain).__name__, "an UncertainModel", "plant.uncertain() makes one")
    for block in uncertain.blocks:
        if block.is_real and not block.interval:
            found = f"a {type(block).__name__}"
            raise InputError(f"validate: block {block.name!r}", found, "real scalars, complex and full blocks")
    if delta not in ("time-invariant", "time-varying"):
        raise InputError("validate", f"delta {delta!r}", "'time-invariant' or 'time-varying'")
    if not 1e-4 <= precision <= 0.2:
        raise InputError("validate", f"precision {precision:g}", "between 1e-4 and 0.2")
    if domain not in ("time", "frequency"):
        raise InputError("validate", f"domain {domain!r}", "'time' or 'frequency'")
    say = progress or (lambda _line: None)
    if domain == "frequency" or isinstance(record, FrequencyData):
        fits_frequency_domain(record, domain, noise_norm, delta, window, at_rest, missing, noise)
        with one_thread():
            if isinstance(record, Record):
                noise = noise if noise is not None else _estimated(uncertain, record, "rms")
            return validate_by_lines(
                uncertain, record, noise or {}, period=period, per_block=per_block, precision=precision,
                budget=budget, progress=say, estimated=estimated,
            )  # fmt: skip
    if period is not None:
        raise InputError("validate", f"period {period:g} s", "a period only in the frequency domain")
    norm: NoiseNorm = noise_norm or "peak"
    with one_thread():
        bounds = _numbers(noise) if noise is not None else _estimated(uncertain, record, norm)
        recorded = prepared(uncertain, record, bounds, norm=norm, window=window, at_rest=at_rest, missing=missing)
        job = _Job(recorded, delta, precision, budget, say)
        found, alone = job.run(per_block)
        assumptions = _assumptions(recorded, delta, estimated)
        return _result(record, recorded, found, alone, assumptions, precision, job)


def _numbers(noise: Mapping[str, ArrayLike]) -> dict[str, float]:
    for name, value in noise.items():
        if np.ndim(value):
            raise InputError(f"validate: noise of {name!r}", f"shape {np.shape(value)}", "one number")
    return {name: float(np.asarray(value)) for name, value in noise.items()}


@dataclass(frozen=True)
class _Found:
    """Bounds of one problem with what explains the record."""

    lower: float
    upper: float
    label: str
    certified: bool
    values: Mapping[str, float]
    problem: SampledProblem | None
    w: Array
    z: Array
    noise: Array
    pulses: tuple[Array, ...]
    states: Mapping[int, Array]
    sizes: Mapping[str, float]
    multipliers: Mapping[str, Array]
    recheck: Callable[[], float] | None
    excess: float
    finished: bool = True


_NONE = np.zeros((0, 0))


@dataclass(frozen=True)
class _Job:
    recorded: Recorded
    delta: DeltaKind
    precision: float
    budget: Budget
    progress: Callable[[str], None]

    def run(self, per_block: bool) -> tuple[_Found, dict[str, tuple[float, float]]]:
        """Bounds over all blocks, and those of each alone where asked."""
        blocks = self.recorded.uncertain.blocks
        found, alone = self.bounds(np.ones(len(blocks), dtype=bool)), {}
        if per_block and np.isfinite(found.upper):
            for k, block in enumerate(blocks):
                self.progress(f"block {block.name} alone")
                part = self.bounds(np.arange(len(blocks)) == k)
                alone[block.name] = part.lower, part.upper
        return found, alone

    def bounds(self, scaled: NDArray[np.bool_]) -> _Found:
        """Bounds over the blocks that ``scaled`` names, the others within 1."""
        blocks = self.recorded.uncertain.blocks
        real = np.array([b.interval is not None for b in blocks], dtype=bool)
        if not blocks:
            return self.noise_alone()
        if not real.any():
            return self.dynamic({}, scaled)
        if real.all():
            return self.constant(scaled)
        return smallest_mixed(self, scaled)

    def noise_alone(self) -> _Found:
        """Without a block the record is explained by its noise, or not at all."""
        fit, none = WindowFit(self.recorded, [], self.budget), np.zeros(0)
        excess, noise, weights = fit.excess(fit.windows(none))
        gamma = 0.0 if excess <= 1 + SLACK else np.inf
        if gamma and not fit.witness(weights, none) > 1:
            found = f"the noise bound is missed by {excess - 1:.1e} of itself: too close to tell"
            raise NoTrustworthyNumber(f"validate: {self.recorded.uncertain!r}", found)
        label = "noise alone: the set has no block"
        recheck = (lambda: np.inf if fit.witness(weights, none) > 1 else 0.0) if gamma else None
        return _Found(
            gamma, gamma, label, True, {}, None, _NONE, _NONE, fit.whole(noise), (), {}, {}, {}, recheck, excess,
        )  # fmt: skip

    def constant(self, scaled: NDArray[np.bool_]) -> _Found:
        """All blocks are real."""
        blocks = [b for b in self.recorded.uncertain.blocks if b.interval]
        found = smallest_parameters(self.recorded, blocks, scaled, self.precision, self.budget)
        self.progress(f"constants: gamma {found.lower:.4g} .. {found.upper:.4g}, {found.boxes} boxes")
        values = {b.name: float(v) for b, v in zip(blocks, found.delta, strict=True)}
        explained = np.isfinite(found.upper)
        label = f"constants; upper bound replayed, lower bound from {found.boxes} boxes tested at points"
        return _Found(
            found.lower, found.upper, label, False, values if explained else {}, None, _NONE, _NONE, found.noise, (),
            {}, {n: abs(v) for n, v in values.items()} if explained else {}, {}, None, found.least_excess,
            found.finished,
        )  # fmt: skip

    def dynamic(self, values: Mapping[str, float], scaled: NDArray[np.bool_], quick: bool = False) -> _Found:
        """The real blocks are set; ``scaled`` belongs to the blocks that remain."""
        M, blocks = with_delta_of(self.recorded.uncertain, values)
        long = len(self.recorded.t) > LONGEST_PROGRAMME
        problem = sampled(self.recorded.part(0, LONGEST_PROGRAMME) if long else self.recorded, M, blocks)
        varying = smallest_contractions(problem, scaled, self.precision, self.budget)
        self.progress(f"time-varying: gamma {varying.lower:.4g} .. {varying.upper:.4g}")
        if long:
            label = f"lower bound from the first {LONGEST_PROGRAMME} samples (time-varying), no explanation sought"
            begun = self._varying(problem, varying, scaled, values)
            return replace(begun, upper=np.inf, w=_NONE, z=_NONE, sizes={}, label=label)
        repeated = any(r for _, _, r in problem.blocks)
        if np.isinf(varying.lower) or (quick and not repeated):
            return self._varying(problem, varying, scaled, values)
        if self.delta == "time-varying":
            if repeated:
                raise InputError(
                    "validate", "a repeated complex scalar as a time-varying system", "time-invariant ones",
                    'delta="time-invariant"',
                )  # fmt: skip
            return self._varying(problem, varying, scaled, values)
        return self._invariant(problem, varying, scaled, values, blocks, M)

    def _varying(
        self, problem: SampledProblem, c: Contractions, scaled: NDArray[np.bool_], values: Mapping[str, float]
    ) -> _Found:
        exact = "exact" if c.convex else "lower bound exact where the Lagrangian is concave"
        label = f"time-varying contractions ({exact})"
        sizes = dict(zip(problem.names, map(float, c.sizes), strict=True)) if len(c.sizes) else {}
        evidence = {"energy": c.multipliers.D, "noise": c.multipliers.noise}
        return _Found(
            c.lower, c.upper, label, True, values, problem, c.w, c.z, c.noise, (), c.states, sizes, evidence,
            _sweep(problem, c, scaled, self.precision), c.least_noise if not c.w.size else problem.excess(c.noise),
        )  # fmt: skip

    def _invariant(
        self,
        problem: SampledProblem,
        c: Contractions,
        scaled: NDArray[np.bool_],
        values: Mapping[str, float],
        blocks: Sequence[Block],
        M: Any,
    ) -> _Found:
        relaxed = replace(self._varying(problem, c, scaled, values), upper=np.inf, w=_NONE, z=_NONE, sizes={})
        each = sum(1 if r else (a.stop - a.start) * (b.stop - b.start) for a, b, r in problem.blocks)
        longest = min(LONGEST, MOST_UNKNOWNS // max(each, 1))
        if problem.n > longest:
            start = sampled(self.recorded.part(0, longest), M, blocks)
            guess = c.upper if np.isfinite(c.upper) else 1.0
            head = smallest_pulse_responses(start, scaled, self.precision, self.budget, guess)
            lower = max(c.lower, head.lower if head is not None else 0.0)
            label = f"time-invariant: lower bound from the first {longest} samples and from time-varying systems"
            return replace(relaxed, lower=lower, label=label)
        guess = c.upper if np.isfinite(c.upper) else max(1.0, c.lower)
        z = c.z if c.z.size else None
        found = smallest_pulse_responses(problem, scaled, self.precision, self.budget, guess, z)
        if found is None:
            label = "time-invariant: lower bound from time-varying systems (relaxation), no explanation found"
            return replace(relaxed, label=label)
        self.progress(f"time-invariant: gamma {found.lower:.4g} .. {found.upper:.4g}")
        return self._pulses(problem, c, found, relaxed)

    def _pulses(self, problem: SampledProblem, c: Contractions, found: PulseResponses, relaxed: _Found) -> _Found:
        convex = found.lower > c.lower
        label = (
            "time-invariant systems (exact)" if c.convex else "time-invariant; lower bound from time-varying systems"
        )
        k = problem.free.shape[1]
        states = {t: found.states[i * k : (i + 1) * k] for i, t in enumerate(problem.free_starts)}
        return replace(
            relaxed,
            lower=max(found.lower, c.lower),
            upper=found.upper,
            label=label,
            w=found.w,
            z=found.z,
            noise=found.noise,
            pulses=found.h,
            states=states,
            sizes=dict(zip(problem.names, map(float, found.sizes), strict=True)),
            multipliers={"noise": found.dual} if convex else relaxed.multipliers,
            recheck=found.recheck if convex else relaxed.recheck,
            excess=problem.excess(found.noise),
        )


def _sweep(
    problem: SampledProblem, c: Contractions, scaled: NDArray[np.bool_], precision: float
) -> Callable[[], float] | None:
    if not np.isfinite(c.lower) or c.lower <= 0:
        return None
    start = c.lower * (1 + precision)
    return lambda: largest_disproved(
        problem, c.multipliers, lambda gamma: np.where(scaled, gamma, 1.0), start, precision / 10
    )


# --- result ----------------------------------------------------------------------------------------------------------


def _result(
    record: Record,
    recorded: Recorded,
    found: _Found,
    alone: Mapping[str, tuple[float, float]],
    assumptions: tuple[str, ...],
    precision: float,
    job: _Job,
) -> Validation:
    if np.isfinite(found.upper) and found.lower > found.upper * (1 + MEET) + SMALLEST:
        contradiction = f"a lower bound of gamma, {found.lower:.6g}, above the upper one, {found.upper:.6g}"
        raise NoTrustworthyNumber(f"validate {record.name}", contradiction)
    offset = np.column_stack([record.outputs[s.name] for s in recorded.outputs]) - recorded.y
    measured = recorded.y + offset
    explained, error = np.full(measured.shape, np.nan), 0.0
    if np.isfinite(found.upper):
        explained = measured - found.noise * recorded.bound
        error = _replay_error(recorded, found)
        if not error <= 1e-3:
            raise NoTrustworthyNumber(
                f"validate {record.name}", f"the explanation is off by {error:.1e} of the noise bound when replayed"
            )
    w, z = found.w, found.z
    if found.problem is not None and w.size:
        w, z = w.copy(), z.copy()
        for (rows, cols, _), size in zip(found.problem.blocks, found.problem.scale, strict=True):
            w[:, rows] *= size
            z[:, cols] *= size
    bound = {s.name: float(b) for s, b in zip(recorded.outputs, recorded.bound, strict=True)}
    return Validation(
        status=_status(found, precision, job.budget),
        record=record.name,
        lower=float(min(found.lower, found.upper)),
        upper=float(found.upper),
        label=found.label,
        blocks={b.name: _block(b, found, alone, job.delta) for b in recorded.uncertain.blocks},
        noise_bound=bound,
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
        notes=(job.budget.remark,) if job.budget.remark else (),
    )


def _status(found: _Found, precision: float, budget: Budget) -> Status:
    if np.isinf(found.lower):
        return Status.INFEASIBLE
    if budget.struck:
        return Status.TIMEOUT
    if np.isfinite(found.upper) and found.upper - found.lower <= 1.01 * precision * max(found.upper, SMALLEST):
        return Status.CERTIFIED if found.certified else Status.CONVERGED
    if found.lower > 1 or found.upper <= 1:
        return Status.CONVERGED
    return Status.INCONCLUSIVE


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


# --- noise and assumptions -------------------------------------------------------------------------------------------


def _estimated(uncertain: UncertainModel, record: Record, norm: NoiseNorm) -> dict[str, float]:
    """Noise bounds from the record's own periods."""
    from scipy import stats

    from robustlab.identification.comparison.noise_floor import noise_floor

    names = [s.name for s in uncertain.outputs if s.name in record.outputs]
    try:
        floor = noise_floor(record, outputs=names)
    except NoTrustworthyNumber as error:
        hint = "noise={'" + (names[0] if names else "y") + "': ...}, in its unit: what the sensor may be off"
        raise NoTrustworthyNumber(
            f"validate {record.name}", f"no noise bound was given, and none can be estimated: {error.found}", None, hint
        ) from None
    count = record.n * max(len(names), 1)
    if norm == "peak":
        factor = float(stats.norm.isf((1 - CONFIDENCE) / (2 * count)))
    else:
        factor = float(np.sqrt(stats.chi2.ppf(CONFIDENCE ** (1 / max(len(names), 1)), record.n) / record.n))
    return {name: factor * floor.std[name] for name in names}


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
