"""Fit of one hypothesis by windowed simulation: parameters z and initial states xi of the windows, both a priori
standard normal, minimise V = |whitened averaged errors|^2 + |xi|^2 + |z|^2; Laplace evidence -V/2 - logdet(H_zz)/2
with the initial states eliminated.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import accumulate, pairwise
from typing import NamedTuple

import numpy as np
from scipy.special import log_ndtr

from robustlab.arrays import Array, Indices
from robustlab.dynamics.effects.effect import Effect, EffectParameter, Scales, Site
from robustlab.dynamics.extended.simulator import Hold, Simulator, Windows
from robustlab.dynamics.plant_base import NonlinearPlant
from robustlab.dynamics.ports.port_model import AnyPlant
from robustlab.identification import constants
from robustlab.identification.greybox.prepared_record import PreparedRecord, averaged

CLIP = 1e6  # errors are clipped to this many standard deviations
FARTHEST = 8.0  # limit of standardised parameters
RELATIVE = 1e-5  # relative fall of V below which a fit stops
# Of the diagonal. Changes of resistance and inertia have nearly the same effect: along such a valley J^T J is a
# millionth of its diagonal, and a larger damping converges slowly.
DAMPING = 1e-4
LEAST_DAMPING = 1e-10
TRIES = 8  # damped steps before a fit stops
MOST_FALL = 2.0  # times the expected fall of V: the largest fall that a fit may still reach
LONGEST_STEP = 2.0  # of a standardised parameter
# Change of a parameter, in standard deviations, up to which a fit reuses the matrices of a nonlinear plant: they
# multiply only deviations from the motion, and are recomputed at the end of the fit.
NEAR = 0.5
DIVERGED = 1e100  # replaces diverged outputs; only missing samples are missing errors
UNIFORM = 3.0**0.5  # half the width of a uniform distribution, in its standard deviations

Effects = Sequence[tuple[Effect, Site]]


@dataclass(frozen=True)
class Nuisance:
    """Parameters with a common factor of their references, or an input's clock, refitted by every hypothesis."""

    label: str
    names: tuple[str, ...]  # of the parameters
    # standard deviation of the factor's logarithm; of the factor itself if ``additive``; of a clock's shift in s
    spread: float
    additive: bool = False  # the nominal value is 0: the factor is the value in its unit
    never_negative: bool = False  # limits an additive factor to values >= 0
    input: str = ""  # input whose clock may be shifted against the outputs; empty for parameters

    def factor(self, z: float) -> float:
        """Return the factor of the standardised z: 1 at z = 0, or 0 if additive."""
        if not self.additive:
            return float(np.exp(self.spread * z))
        return max(0.0, self.spread * z) if self.never_negative else float(self.spread * z)

    @property
    def ends(self) -> tuple[float, float]:
        """Return the standardised z at the two ends of the tolerance; infinite for a clock."""
        if self.input:
            return -np.inf, np.inf
        if self.additive:
            return -np.inf if self.never_negative else -UNIFORM, UNIFORM
        tolerance = np.expm1(UNIFORM * self.spread)
        return float(np.log1p(-tolerance)) / self.spread if tolerance < 1.0 else -np.inf, UNIFORM

    def log_within(self, z: float, std: float) -> float:
        """Return the log probability that a normal variable of mean z and this std lies within the tolerance."""
        low, high = self.ends
        near, far = sorted(((z - high) / std, (low - z) / std), reverse=True)
        inside = float(log_ndtr(-near))
        return inside + float(np.log1p(-np.exp(log_ndtr(far) - inside)))


@dataclass(frozen=True)
class Clock:
    """Simulation of all hypotheses: steps per sample, hold of each input, rough or not (`Simulator`)."""

    sub: int | None = None
    hold: tuple[Hold, ...] | None = None
    rough: bool = False


class Setting(NamedTuple):
    """Arguments of a simulation: factors of the plant's parameters, values of each effect, shift of each input."""

    factors: Mapping[str, float]
    values: Sequence[Mapping[str, float]]
    shift: Sequence[float] | None


@dataclass(frozen=True, eq=False)
class Candidate:
    """An effect at a site, with its parameters and starting points for these records."""

    effect: Effect
    site: Site
    parameters: tuple[EffectParameter, ...]
    starts: tuple[Mapping[str, float], ...]
    scales: Scales

    @property
    def key(self) -> str:
        return f"{self.effect.id}@{self.site.name}"

    def values(self, z: Array) -> dict[str, float]:
        return {p.name: p.prior.value(float(v)) for p, v in zip(self.parameters, z, strict=True)}

    def standardised(self, values: Mapping[str, float]) -> Array:
        return np.array([p.prior.standardised(values[p.name]) for p in self.parameters])


@dataclass(frozen=True)
class Hypothesis:
    """Nominal model with these effects."""

    candidates: tuple[Candidate, ...]

    @property
    def key(self) -> str:
        return " + ".join(c.key for c in self.candidates) or "none"


@dataclass(frozen=True, eq=False)
class Fit:
    """One fitted hypothesis."""

    hypothesis: Hypothesis
    z: Array  # standardised parameters: nuisances, then those of each effect
    starts: tuple[Array, ...]  # standardised initial states of the windows, (n_windows, n_x) per record
    cost: float  # V at the solution
    hessian: Array  # of V / 2 over z, initial states eliminated, prior included
    noise: NoiseModel  # of V
    covariance: Array | None = None  # of z from the scatter of the windows' gradients (sandwich), of a robust fit

    @property
    def evidence(self) -> float:
        """Return Laplace's log evidence up to a constant common to all hypotheses."""
        sign, logdet = np.linalg.slogdet(self.hessian)
        return -0.5 * self.cost - 0.5 * float(logdet if sign > 0 else 1e6)

    @property
    def std(self) -> Array:
        """Return the posterior standard deviations of z."""
        laplace = np.sqrt(np.abs(np.diag(np.linalg.pinv(self.hessian))))
        if self.covariance is None:
            return laplace
        return np.maximum(laplace, np.sqrt(np.abs(np.diag(self.covariance))))


@dataclass(frozen=True)
class FitPlan:
    """Termination and options of a fit."""

    iterations: int = 12  # at most
    tolerance: float = 0.05  # actual or expected fall of V at which it ends
    fixed: bool = False  # only the initial states are fitted, to predict held-out data
    robust: bool = False  # with the sandwich covariance
    ceiling: float = np.inf  # the fit stops after a step if MOST_FALL times the expected fall leaves V above this


class _Place(NamedTuple):
    """Iterate of a fit: z, initial states and residuals of each record, V, and the z of its matrices."""

    z: Array
    xi: Sequence[Array]
    residual: Sequence[Array]
    cost: float
    around: Array


# --- noise, prior and the normal equations, initial states eliminated (Björck, 1996, section 9.3) ---------------------


class Reduced(NamedTuple):
    """Normal equations over z with initial states eliminated; the step of the latter is -(offset + slope dz)."""

    hessian: Array
    gradient: Array
    offset: Array  # (n_windows, n_x)
    slope: Array  # (n_windows, n_x, n_z)


@dataclass(frozen=True, eq=False)
class Linearised:
    """Products of the derivatives J over z and X over the initial states of one record, window by window."""

    jj: Array  # J^T J summed, (n_z, n_z)
    jr: Array  # J^T r summed, (n_z,)
    xx: Array  # X^T X + 1, (n_windows, n_x, n_x)
    xj: Array  # X^T J, (n_windows, n_x, n_z)
    xr: Array  # X^T r + xi, (n_windows, n_x)
    scores: Array  # J^T r of each window, (n_windows, n_z)
    j: Array  # (n_windows, n_points, n_z)
    x: Array  # (n_windows, n_points, n_x)

    @classmethod
    def of(cls, residual: Array, j: Array, x: Array, xi: Array) -> Linearised:
        """Form the products from residuals (n_windows, n_points) and their derivatives; xi (n_windows, n_x)."""
        xt = np.swapaxes(x, 1, 2)
        flat = j.reshape(residual.size, j.shape[2])  # -1 fails without parameters
        return cls(
            flat.T @ flat, flat.T @ residual.ravel(), xt @ x + np.eye(x.shape[2]), xt @ j,
            (xt @ residual[:, :, None])[:, :, 0] + xi, np.einsum("wmz,wm->wz", j, residual), j, x,
        )  # fmt: skip

    def with_residual(self, residual: Array, xi: Array) -> Linearised:
        """Replace the residuals, at the initial states xi."""
        scores = np.einsum("wmz,wm->wz", self.j, residual)
        xr = (np.swapaxes(self.x, 1, 2) @ residual[:, :, None])[:, :, 0]
        return replace(self, jr=scores.sum(axis=0), xr=xr + xi, scores=scores)

    def reduced(self, damping: float) -> Reduced:
        """Eliminate the initial states, their equations damped by ``damping`` times their diagonal."""
        n_x = self.xx.shape[1]
        inner = self.xx + damping * self.xx * np.eye(n_x)
        right = np.concatenate([self.xr[:, :, None], self.xj], axis=2)
        try:
            both = np.asarray(np.linalg.solve(inner, right), dtype=float)
        except np.linalg.LinAlgError:  # an unobservable part of an initial state stays unchanged
            both = np.linalg.pinv(inner, hermitian=True) @ right
        offset, slope = both[:, :, 0], both[:, :, 1:]
        hessian = self.jj - np.einsum("wxi,wxj->ij", self.xj, slope)
        gradient = self.jr - np.einsum("wxi,wx->i", self.xj, offset)
        return Reduced(0.5 * (hessian + hessian.T), gradient, offset, slope)


def sandwich(parts: Sequence[Linearised], hessian: Array) -> Array:
    """Return the covariance of z from the scatter of the windows' gradients, valid under any noise."""
    scores = np.concatenate([p.scores - np.einsum("wxz,wx->wz", p.xj, p.reduced(0.0).offset) for p in parts])
    inverse = np.linalg.pinv(hessian)
    count = len(scores)
    return inverse @ (scores.T @ scores) @ inverse * (count / max(1, count - 1))


@dataclass(frozen=True, eq=False)
class NoiseModel:
    """Noise of the averaged errors: standard deviation (n_y,) and autoregression (order, n_y) of each output."""

    std: Array
    ar: Array
    excess: float = 1.0  # factor on the variance of the errors because they are correlated (`noise.widened`)

    def whitened(self, errors: Array) -> Array:
        """Return residuals (n_windows, n_points * n_y) of unit variance from averaged errors; 0 for missing points."""
        order = len(self.ar)
        e = errors[:, order:].copy()
        for lag in range(order):
            e -= self.ar[lag] * errors[:, order - lag - 1 : errors.shape[1] - lag - 1]
        with np.errstate(over="ignore", invalid="ignore"):
            scaled = np.nan_to_num(e / self.std, copy=False, nan=0.0, posinf=CLIP, neginf=-CLIP)
        return np.clip(scaled, -CLIP, CLIP).reshape(len(e), e.shape[1] * e.shape[2])  # -1 fails without windows


@dataclass(frozen=True, eq=False)
class Prior:
    """Normal prior of the standardised parameters: mean (n,) and precision, the inverse of the covariance, (n, n)."""

    mean: Array
    precision: Array

    def cost(self, z: Array) -> float:
        return float((z - self.mean) @ self.precision @ (z - self.mean))

    def gradient(self, z: Array) -> Array:
        return self.precision @ (z - self.mean)


# --- the fit ---------------------------------------------------------------------------------------------------------


class Problem:
    """Plant, records and nuisance parameters; fits hypotheses on chosen windows."""

    def __init__(
        self, plant: AnyPlant, records: Sequence[PreparedRecord], nuisances: Sequence[Nuisance],
        chosen: Sequence[Indices] | None = None, clock: Clock = Clock(), work: list[int] | None = None,
    ) -> None:  # fmt: skip
        self.plant, self.records, self.nuisances = plant, tuple(records), tuple(nuisances)
        self.clock, self.work = clock, [] if work is None else work
        self.chosen = tuple(chosen) if chosen is not None else tuple(np.arange(r.count) for r in records)

    def on(self, records: Sequence[PreparedRecord], chosen: Sequence[Indices] | None = None) -> Problem:
        return Problem(self.plant, records, self.nuisances, chosen, self.clock, self.work)

    def under(self, clock: Clock) -> Problem:
        return Problem(self.plant, self.records, self.nuisances, self.chosen, clock, self.work)

    # --- parameters --------------------------------------------------------------------------------------------------

    def split(self, hypothesis: Hypothesis, z: Array) -> tuple[dict[str, float], list[dict[str, float]]]:
        """Return plant factors and effect values of the standardised parameters."""
        factors = {}
        for nuisance, moves, value in zip(self.nuisances, self.moving(hypothesis), z, strict=False):
            if moves:
                factors.update(dict.fromkeys(nuisance.names, nuisance.factor(float(value))))
        return factors, [c.values(z[own]) for c, own in self.slices(hypothesis)]

    def slices(self, hypothesis: Hypothesis) -> list[tuple[Candidate, slice]]:
        """Return each effect with the slice of its parameters in z."""
        ends = list(accumulate((len(c.parameters) for c in hypothesis.candidates), initial=len(self.nuisances)))
        return [(c, slice(a, b)) for c, (a, b) in zip(hypothesis.candidates, pairwise(ends), strict=True)]

    def moving(self, hypothesis: Hypothesis) -> list[bool]:
        """Return whether each nuisance is free: an effect on its parameters replaces it."""
        sites = [c.site.name for c in hypothesis.candidates if c.site.kind == "parameter"]
        wrong = {*sites, *(name for site in sites for name in site.split("+"))}
        return [n.label not in wrong for n in self.nuisances]

    def shift(self, z: Array) -> tuple[float, ...] | None:
        """Return the shift of each input's clock in s, without delays of effects; None without clocks."""
        shifts = {n.input: n.spread * v for n, v in zip(self.nuisances, z, strict=False) if n.input}
        return tuple(float(shifts.get(s.name, 0.0)) for s in self.plant.inputs) if shifts else None

    def setting(self, hypothesis: Hypothesis, z: Array) -> Setting:
        """Return the arguments of a simulation at the standardised parameters."""
        # A delay common to all sensors of a linear plant is simulated as one of all inputs: both then have the same
        # history before a window, and the same errors to the last bit.
        factors, values = self.split(hypothesis, z)
        delayed = any(c.site.kind == "output" and c.effect.delay for c in hypothesis.candidates)
        if not delayed or isinstance(self.plant, NonlinearPlant):
            return Setting(factors, values, self.shift(z))
        effects = [(c.effect, c.site) for c in hypothesis.candidates]
        _, _, late = self.sensors(effects, values)
        shared = min(late.get(column, 0.0) for column in self.records[0].columns)
        left = [
            {**v, e.delay: max(0.0, v[e.delay] - shared)} if site.kind == "output" and e.delay else v
            for (e, site), v in zip(effects, values, strict=True)
        ]
        shift = self.shift(z) or (0.0,) * len(self.plant.inputs)
        return Setting(factors, left, tuple(s + shared for s in shift))

    def size(self, hypothesis: Hypothesis) -> int:
        return len(self.nuisances) + sum(len(c.parameters) for c in hypothesis.candidates)

    # --- residuals ---------------------------------------------------------------------------------------------------

    def simulators(self, hypothesis: Hypothesis) -> list[Simulator]:
        effects = [(c.effect, c.site) for c in hypothesis.candidates]
        sub, hold, rough = self.clock.sub, self.clock.hold, self.clock.rough
        return [
            Simulator(self.plant, effects, r.u, r.record.dt, sub=sub, hold=hold, rough=rough, motion=r.motion)
            for r in self.records
        ]

    def quick(self, hypothesis: Hypothesis) -> list[Simulator]:
        """Return simulators for derivatives: steps with force laws are not repeated in halves."""
        return self.under(replace(self.clock, rough=True)).simulators(hypothesis)

    def errors(
        self, hypothesis: Hypothesis, z: Array, starts: Sequence[Array], simulators: Sequence[Simulator] | None = None,
        near: Array | None = None,
    ) -> list[Array]:  # fmt: skip
        """Return averaged errors of the chosen windows, (n_windows, n_points, n_y) per record; NaN without samples."""
        return [
            self._errors_at(k, simulator, hypothesis, [(z, starts[k])], near)
            for k, simulator in enumerate(simulators or self.simulators(hypothesis))
        ]

    def _errors_at(
        self, k: int, simulator: Simulator, hypothesis: Hypothesis, points: Sequence[tuple[Array, Array]],
        near: Array | None = None,
    ) -> Array:  # fmt: skip
        """Return averaged errors of one record's chosen windows at several points (z, xi)."""
        record, measured = self.records[k], self.records[k].measured[self.chosen[k]]
        around = None if near is None else self.split(hypothesis, near)
        with np.errstate(all="ignore"):
            found = [self.outputs(k, simulator, self.setting(hypothesis, z), xi, around) for z, xi in points]
            outputs = np.nan_to_num(np.concatenate(found), nan=DIVERGED, posinf=DIVERGED, neginf=-DIVERGED)
        errors = measured - outputs.reshape(-1, *measured.shape)
        return averaged(errors.reshape(-1, *measured.shape[1:]), record.thin)

    def outputs(
        self, k: int, simulator: Simulator, setting: Setting, xi: Array,
        near: tuple[dict[str, float], list[dict[str, float]]] | None = None,
    ) -> Array:  # fmt: skip
        """Return simulated measured outputs of the chosen windows of one record, (n_windows, length, n_measured)."""
        # For several initial states, xi (copies, n_windows, n_x), the copies follow each other. ``near``: nearby
        # parameters for the matrices of a nonlinear plant and their motion.
        factors, values, shift = setting
        record, chosen = self.records[k], self.chosen[k]
        values, about = (
            [e.begun(v, record.begun) if record.begun else v for (e, _), v in zip(simulator.effects, own, strict=True)]
            for own in (values, values if near is None else near[1])
        )
        everything = len(chosen) < record.count and any(effect.long_memory for effect, _ in simulator.effects)
        used, at = (np.arange(record.count), chosen) if everything else (chosen, np.arange(len(chosen)))
        own = self.starts_seen(k, simulator, values)[used]
        x0 = np.tile(own, (len(xi) if xi.ndim == 3 else 1, 1, 1))
        x0[:, at] += record.x0_std[chosen] * xi
        windows = Windows(record.windows.starts[used], record.windows.length)
        simulator = self._about_true_motion(k, simulator, about)
        self.work.append(len(x0) * len(used) * windows.length * simulator.sub * (1 if simulator.rough else 3))
        motion = simulator.run(factors, values, x0.reshape(-1, x0.shape[2]), windows, shift, near)
        outputs = motion.outputs[:, :, list(record.columns)].reshape(*x0.shape[:2], windows.length, -1)[:, at]
        return outputs.reshape(-1, *outputs.shape[2:])

    def _about_true_motion(self, k: int, simulator: Simulator, values: Sequence[Mapping[str, float]]) -> Simulator:
        """Correct the motion of a nonlinear plant's simulator for scaled, biased or late sensors."""
        record = self.records[k]
        motion = record.motion_seen(*self.sensors(simulator.effects, values))
        return simulator if motion is record.motion else simulator.about(motion)

    def whitened(self, errors: Sequence[Array], noise: NoiseModel) -> list[Array]:
        return [noise.whitened(e) for e in errors]

    def starts_seen(self, k: int, simulator: Simulator, values: Sequence[Mapping[str, float]]) -> Array:
        """Return the states at all window starts of one record, corrected for the effects of its sensors."""
        shown, biased, late = self.sensors(simulator.effects, values)
        if self.records[k].motion is not None:
            return self.records[k].starts_seen(0.0, shown, biased, late)
        lag = sum(effect.lag(v) for (effect, _), v in zip(simulator.effects, values, strict=True))
        return self.records[k].starts_seen(lag, shown, biased)

    def sensors(
        self, effects: Effects, values: Sequence[Mapping[str, float]]
    ) -> tuple[dict[int, float], dict[int, float], dict[int, float]]:
        """Return gain, bias and delay in s by output index, for outputs that the effects scale, bias or delay."""
        names = [s.name for s in self.plant.outputs]
        gains, biases, delays = dict[int, float](), dict[int, float](), dict[int, float]()
        for (effect, site), v in zip(effects, values, strict=True):
            if site.kind == "output":
                k = names.index(site.name)
                gains[k] = gains.get(k, 1.0) * effect.shown(v)
                biases[k], delays[k] = biases.get(k, 0.0) + effect.bias(v), delays.get(k, 0.0) + effect.lag(v)
        return (
            {k: gain for k, gain in gains.items() if gain != 1.0},
            {k: bias for k, bias in biases.items() if bias},
            {k: delay for k, delay in delays.items() if delay},
        )

    # --- the fit -----------------------------------------------------------------------------------------------------

    def fit(
        self, hypothesis: Hypothesis, noise: NoiseModel, z: Array, starts: Sequence[Array] | None = None,
        plan: FitPlan = FitPlan(), prior: Prior | None = None,
    ) -> Fit:  # fmt: skip
        """Minimise V by Levenberg-Marquardt from z."""
        # A nonlinear plant's matrices multiply deviations from its motion: they are recomputed after large changes of z
        # and at the end.
        fixed, tolerance = plan.fixed, plan.tolerance
        z = np.array(z, dtype=float)
        own = Prior(np.zeros(len(z)), np.eye(len(z))) if prior is None else prior
        n_x = len(self.plant.states)
        xi = [np.zeros((len(c), n_x)) if starts is None else starts[k].copy() for k, c in enumerate(self.chosen)]
        simulators = self.simulators(hypothesis)
        forced = simulators[0].laws(self.split(hypothesis, z)[1]) and not plan.robust
        quick = self.quick(hypothesis) if forced else simulators

        def at(z: Array, xi: Sequence[Array], around: Array) -> _Place:
            residual = self.whitened(self.errors(hypothesis, z, xi, simulators, around), noise)
            return _Place(z, xi, residual, _total(residual, xi) + own.cost(z), around)

        def exact(there: _Place) -> _Place:
            return there if self._distance(there) == 0.0 else at(there.z, there.xi, there.z)

        damping, rounds = DAMPING, plan.iterations
        here = at(z, xi, z)
        while True:
            parts = [self._linearised(k, hypothesis, here, quick[k], noise, fixed) for k in range(len(xi))]
            hessian = own.precision + sum(p.reduced(0.0).hessian for p in parts)
            fall = self._expected(own.gradient(here.z), hessian, parts, fixed)
            if (rounds <= 0 or fall < tolerance) and self._distance(here) > 0.0:
                here = exact(here)
                parts = [p.with_residual(r, x) for p, r, x in zip(parts, here.residual, here.xi, strict=True)]
                fall = self._expected(own.gradient(here.z), hessian, parts, fixed)
            hopeless = rounds < plan.iterations and here.cost - MOST_FALL * fall > plan.ceiling
            if rounds <= 0 or fall < tolerance or hopeless:
                break
            improved = 0.0
            for _ in range(TRIES):
                dz, dxi = self._step(here.z, own, parts, damping, fixed)
                there = at(self._within(here.z + dz), [x + d for x, d in zip(here.xi, dxi, strict=True)], here.around)
                if there.cost < here.cost and self._distance(there) > NEAR:
                    there = exact(there)
                if there.cost < here.cost:
                    improved, here = here.cost - there.cost, there
                    damping = max(0.1 * damping, LEAST_DAMPING)
                    break
                damping = max(damping, DAMPING) * 10.0
            rounds -= 1
            if improved < max(tolerance, RELATIVE * here.cost):
                break
        here = exact(here)
        covariance = sandwich(parts, hessian) if plan.robust else None
        return Fit(hypothesis, here.z, tuple(here.xi), here.cost, hessian, noise, covariance)

    def _distance(self, there: _Place) -> float:
        """Return the largest change of a parameter since a nonlinear plant's matrices were computed."""
        if not isinstance(self.plant, NonlinearPlant):
            return 0.0
        return float(np.abs(there.z - there.around).max(initial=0.0))

    @staticmethod
    def _expected(slope: Array, hessian: Array, parts: Sequence[Linearised], fixed: bool) -> float:
        """Return the fall of V in an undamped step for linear errors; ``slope``: gradient of the prior."""
        reduced = [p.reduced(0.0) for p in parts]
        fall = sum(float(np.sum(p.xr * r.offset)) for p, r in zip(parts, reduced, strict=True))
        if fixed:
            return fall
        gradient = slope + sum(r.gradient for r in reduced)
        try:
            return fall + float(gradient @ np.linalg.solve(hessian, gradient))
        except np.linalg.LinAlgError:  # the prior is below rounding
            return fall + float(gradient @ np.linalg.pinv(hessian, hermitian=True) @ gradient)

    def _within(self, z: Array) -> Array:
        return np.clip(z, -FARTHEST, FARTHEST)

    def _step(
        self, z: Array, prior: Prior, parts: Sequence[Linearised], damping: float, fixed: bool
    ) -> tuple[Array, list[Array]]:
        reduced = [p.reduced(damping) for p in parts]
        dz = np.zeros_like(z)
        if not fixed:
            hessian = prior.precision + sum(r.hessian for r in reduced)
            diagonal = np.diag(prior.precision) + sum(np.diag(p.jj) for p in parts)
            hessian[np.diag_indices(len(hessian))] += damping * diagonal
            dz = -np.linalg.solve(hessian, prior.gradient(z) + sum(r.gradient for r in reduced))
            dz = self._within(z + np.clip(dz, -LONGEST_STEP, LONGEST_STEP)) - z
        return dz, [-r.offset - r.slope @ dz for r in reduced]

    def _linearised(
        self, k: int, hypothesis: Hypothesis, place: _Place, simulator: Simulator, noise: NoiseModel, fixed: bool
    ) -> Linearised:
        """Linearise one record's residuals, over the initial states alone if z is fixed."""
        z, xi, residual = place.z, place.xi[k], place.residual[k]
        known = None if simulator.rough and not self.clock.rough else residual
        count = 0 if fixed else len(z)
        j, x = self.sensitivities(k, simulator, hypothesis, (z, xi), place.around, noise, count, known)
        return Linearised.of(residual, np.zeros((*residual.shape, len(z))) if fixed else j, x, xi)

    def sensitivities(
        self, k: int, simulator: Simulator, hypothesis: Hypothesis, at: tuple[Array, Array], around: Array,
        noise: NoiseModel, count: int, known: Array | None = None,
    ) -> tuple[Array, Array]:  # fmt: skip
        """Return derivatives of one record's residuals over the first ``count`` of z, and over the initial states."""
        # Finite differences from the residuals, which may be ``known``; one simulation has all changed initial states.
        (z, xi), n_x = at, at[1].shape[1]
        moved = xi + constants.START_STEP * np.eye(n_x)[:, None, :]
        points = [(z, moved if known is not None else np.concatenate([xi[None], moved]))]
        points += [(z + constants.STEP * unit, xi) for unit in np.eye(len(z))[:count]]
        found = noise.whitened(self._errors_at(k, simulator, hypothesis, points, around))
        found = found.reshape(-1, len(xi), found.shape[1])
        here, found = (found[0], found[1:]) if known is None else (known, found)
        change = np.moveaxis(found - here, 0, 2)
        return change[:, :, n_x:] / constants.STEP, change[:, :, :n_x] / constants.START_STEP

    def derivatives(self, fit: Fit) -> list[tuple[Array, Array]]:
        """Return derivatives of the residuals over the parameters and the initial states."""
        return [
            self.sensitivities(k, simulator, fit.hypothesis, (fit.z, fit.starts[k]), fit.z, fit.noise, len(fit.z))
            for k, simulator in enumerate(self.simulators(fit.hypothesis))
        ]


def _total(residual: Sequence[Array], xi: Sequence[Array]) -> float:
    return sum(float((r**2).sum()) for r in residual) + sum(float((x**2).sum()) for x in xi)


def simulated_outputs(problem: Problem, fit: Fit) -> list[Array]:
    """Return outputs of the chosen windows under a fit, (n_windows, length, n_measured) per record."""
    return [
        problem.outputs(k, simulator, problem.setting(fit.hypothesis, fit.z), fit.starts[k])
        for k, simulator in enumerate(problem.simulators(fit.hypothesis))
    ]


def predicted(problem: Problem, fit: Fit) -> Problem:
    """Return the problem with the measured outputs replaced by the fit's prediction in the chosen windows."""
    records = []
    for record, chosen, outputs in zip(problem.records, problem.chosen, simulated_outputs(problem, fit), strict=True):
        y, at = record.y.copy(), record.samples[chosen]
        y[at] = np.where(np.isfinite(y[at]), outputs, np.nan)
        records.append(replace(record, y=y))
    return problem.on(records, problem.chosen)


def refit_distance(problem: Problem, true: Fit, rival: Fit) -> float:
    """Return the distance of the rival's refitted hypothesis from the prediction of the true one."""
    there = predicted(problem, true)
    prior = float(true.z @ true.z) + sum(float((x**2).sum()) for x in true.starts)
    fitted = there.fit(rival.hypothesis, true.noise, rival.z, rival.starts, FitPlan(10))
    return float(np.sqrt(max(0.0, fitted.cost - prior)))
