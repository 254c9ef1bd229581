"""The noise that fits are judged by, and fits under it of data that were kept from them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.stats import t as student

from robustlab.arrays import Array
from robustlab.identification import tuning
from robustlab.identification.hypotheses.effect_fit import Fit, FitPlan, NoiseModel, Problem
from robustlab.identification.hypotheses.prepared_record import PreparedRecord
from robustlab.identification.tuning import AS_LARGE

SETTLING = 15  # iterations of the reported fits


def first_noise(problem: Problem) -> NoiseModel:
    """White noise of the size the smoother and the resolution of the sensors tell, averaged."""
    std = 2.0 * np.max([r.sensor_noise for r in problem.records], axis=0)
    return NoiseModel(std, np.zeros((0, len(std))))


def whitening(problem: Problem, fit: Fit, order: int | None = None) -> NoiseModel:
    """Autoregression and innovation size of a fit's errors, output by output."""
    # A window shows no correlation longer than itself, and errors that grow along it look unstable: the roots are held
    # within that of a decay over one window.
    order = tuning.AR_ORDER if order is None else order
    errors = problem.errors(fit.hypothesis, fit.z, fit.starts)
    n_y = errors[0].shape[2]
    slowest = np.exp(-1.0 / max(e.shape[1] for e in errors))
    ar, std = np.zeros((order, n_y)), np.ones(n_y)
    for j in range(n_y):
        past = np.concatenate([_past(e[:, :, j], order) for e in errors])
        now = np.concatenate([e[:, order:, j].ravel() for e in errors])
        known = np.isfinite(past).all(axis=1) & np.isfinite(now)
        past, now = past[known], now[known]
        own = np.linalg.lstsq(past, now, rcond=None)[0]
        radius = float(np.abs(np.roots([1.0, *-own])).max(initial=0.0))
        ar[:, j] = own * min(1.0, slowest / max(radius, 1e-300)) ** np.arange(1, order + 1)
        rest = now - past @ ar[:, j]
        std[j] = max(float(np.sqrt(np.mean(rest**2))), 1e-12 * float(np.abs(now).max(initial=1e-300)))
    return NoiseModel(std, ar)


def careful(problem: Problem, fit: Fit, noise: NoiseModel) -> NoiseModel:
    """The noise model with so large a variance that windows scatter no more than it says."""
    # With the Hessian H of half the cost and the covariance J of the windows' gradients, independent errors have J = H
    # - 1; a lacking effect makes J larger. Varin, Reid, Firth, composite likelihood (2011), 2.3.
    there = problem.fit(fit.hypothesis, noise, fit.z, fit.starts, FitPlan(tuning.LAST, 0.05, robust=True))
    assert there.covariance is not None
    told = len(there.z) - float(np.trace(np.linalg.pinv(there.hessian)))
    excess = max(1.0, float(np.trace(there.covariance @ there.hessian)) / max(told, 1e-9))
    return NoiseModel(noise.std * np.sqrt(excess), noise.ar, excess)


def noise_ratio(problem: Problem, fit: Fit) -> float:
    """Error of the fitted windows over what the sensors' noise makes of it; the largest over the outputs."""
    return float(np.max(_sizes(problem, fit) / np.max([r.sensor_noise for r in problem.records], axis=0)))


def _past(errors: Array, order: int) -> Array:
    """The ``order`` points before each point of a window, (n, order), latest first."""
    length = errors.shape[1]
    lagged = [errors[:, order - lag - 1 : length - lag - 1].ravel() for lag in range(order)]
    return np.column_stack(lagged) if lagged else np.empty((errors.size, 0))


def white(noise: NoiseModel) -> NoiseModel:
    """White noise of the same innovations: with it the window starts are those of least squares."""
    return NoiseModel(noise.std, noise.ar[:0])


def held_out_fit(held: Problem, fit: Fit, noise: NoiseModel) -> Fit:
    """The hypothesis on other windows: parameters as fitted, only the window starts are found anew."""
    return held.fit(fit.hypothesis, noise, fit.z, plan=FitPlan(8, 0.5, fixed=True))


def as_fitted(held: Problem, fit: Fit, noise: NoiseModel) -> float:
    """Log-likelihood of other windows at the fitted parameters, up to a constant common to all hypotheses."""
    return -0.5 * (held_out_fit(held, fit, noise).cost - float(fit.z @ fit.z))


def window_errors(problem: Problem, fit: Fit) -> Array:
    """Mean square error of each chosen window as a share of the measured ranges, (n_windows,)."""
    errors, ranges = problem.errors(fit.hypothesis, fit.z, fit.starts), spans(problem.records)
    scaled = np.concatenate([e / np.where(ranges > 0, ranges, 1.0) for e in errors])
    squares = np.nansum(scaled**2, axis=(1, 2))
    return np.asarray(squares / np.maximum(np.isfinite(scaled).sum(axis=(1, 2)), 1))


def clearly_larger(errors: Array, others: Array) -> bool:
    """Whether mean square errors of windows exceed others as a whole, and by more than chance (95 %)."""
    tiny = np.finfo(float).tiny
    ratio = np.log(np.maximum(errors, tiny) / np.maximum(others, tiny))
    if not errors.sum() > (1.0 + AS_LARGE) ** 2 * others.sum():
        return False
    if len(ratio) < 2 or not ratio.std() > 0.0:
        return bool(ratio.mean() > 0.0)
    least = float(student.ppf(0.95, len(ratio) - 1)) * ratio.std(ddof=1) / np.sqrt(len(ratio))
    return bool(ratio.mean() > least)


def spans(records: Sequence[PreparedRecord]) -> Array:
    """Largest measured range of each output, (n_measured,); 0 of one that no record has."""
    known = [[y[np.isfinite(y)] for y in r.y.T] for r in records]
    return np.max([[np.ptp(y) if y.size else 0.0 for y in row] for row in known], axis=0)


def least_squares(problem: Problem, fit: Fit, noise: NoiseModel, plan: FitPlan) -> Fit:
    """The hypothesis from where it stands, under white noise of the size of its errors, ``noise`` at least."""
    size = np.maximum(_sizes(problem, fit), noise.std)
    return problem.fit(fit.hypothesis, NoiseModel(size, noise.ar[:0]), fit.z, fit.starts, plan)


def restarted(problem: Problem, fit: Fit) -> Fit:
    """The fit with its starts found anew by least squares under the size of this model's errors."""
    # Not that of the sensors' noise: errors of 500 times it would drive a start hundreds of deviations away.
    start = replace(fit, starts=tuple(np.zeros((len(c), len(problem.plant.states))) for c in problem.chosen))
    for _ in range(2):  # the size of the errors is itself better known from better starts
        start = least_squares(problem, start, first_noise(problem), FitPlan(8, 0.5, fixed=True))
    return start


def _sizes(problem: Problem, fit: Fit) -> Array:
    """Root mean square of a fit's errors, (n_measured,); 0 of an output that none of the windows has."""
    errors = np.concatenate([e.reshape(-1, e.shape[2]) for e in problem.errors(fit.hypothesis, fit.z, fit.starts)])
    known = np.isfinite(errors).sum(axis=0)
    return np.asarray(np.sqrt(np.nansum(errors**2, axis=0) / np.maximum(known, 1)))


def settled(problem: Problem, fit: Fit, noise: NoiseModel, order: int | None = None) -> Fit:
    """The parameters to report: the hypothesis' own errors made white, covariance from the scatter of the windows."""
    # Where something is still missing full whitening is wrong: order 1, from a start by least squares, trusts
    # differences between neighbouring points less, in which a small ripple shows first.
    found = least_squares(problem, fit, noise, FitPlan(SETTLING, 1e-3)) if order == 1 else fit
    for _ in range(2):
        own = whitening(problem, found, order)
        found = problem.fit(fit.hypothesis, own, found.z, found.starts, FitPlan(SETTLING, 1e-3, robust=True))
    return found


PHASES = 8  # looked at before the best one is made finer
PRICE = float(np.log(2 * PHASES))  # in log evidence, of a phase that was looked for in data to be judged on


def in_phase(problem: Problem, fit: Fit, known: Sequence[PreparedRecord]) -> tuple[Problem, float]:
    """The problem with each record begun where the fit's effects over time leave least, and what that costs."""
    # Records that are ``known`` were fitted and stay; of several such effects the first gives the phase.
    factors = [c.values(fit.z[own])[c.effect.timed] for c, own in problem.slices(fit.hypothesis) if c.effect.timed]
    new = [k for k, r in enumerate(problem.records) if not any(r is other for other in known)]
    if not factors or not new:
        return problem, 0.0
    records = list(problem.records)
    for k in new:
        records[k] = replace(records[k], begun=_begun(problem, fit, k, 1.0 / factors[0]))
    return problem.on(records, problem.chosen), PRICE * len(new)


def _begun(problem: Problem, fit: Fit, k: int, period: float) -> float:
    """Best time within a period for one record, by the cost of its windows."""
    from scipy.optimize import minimize_scalar

    def cost(later: float) -> float:
        alone = problem.on([replace(problem.records[k], begun=later)], [problem.chosen[k]])
        return held_out_fit(alone, fit, fit.noise).cost

    step = period / PHASES
    best = step * min(range(PHASES), key=lambda n: cost(step * n))
    bounds = best - step, best + step
    finer: Any = minimize_scalar(cost, bounds=bounds, method="bounded", options={"xatol": 0.01 * period})
    return float(finer.x) % period
