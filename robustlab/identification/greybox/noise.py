"""Noise models of fits, and fits of held-out data under them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.special import stdtrit

from robustlab.arrays import Array
from robustlab.identification import constants
from robustlab.identification.greybox.effect_fit import Fit, FitPlan, NoiseModel, Prior, Problem
from robustlab.identification.greybox.prepared_record import PreparedRecord

SETTLING = 15  # iterations of the reported fits
PREDICTED = 4  # iterations of a fit to windows whose parameters are known already
PHASES = 8  # on the grid before the refinement
PRICE = float(np.log(2 * PHASES))  # log evidence per phase fitted to held-out data


def first_noise(problem: Problem) -> NoiseModel:
    """Return white noise of twice the smoother's estimate or the sensors' resolution, averaged."""
    std = 2.0 * np.max([r.sensor_noise for r in problem.records], axis=0)
    return NoiseModel(std, np.zeros((0, len(std))))


def whitening(problem: Problem, fit: Fit, order: int = constants.AR_ORDER) -> NoiseModel:
    """Fit an autoregression and innovation size to a fit's errors, output by output."""
    # Errors that grow along a window look unstable: the roots are limited to a decay over one window.
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


def widened(problem: Problem, fit: Fit, noise: NoiseModel) -> NoiseModel:
    """Enlarge the variance of the noise model to that of the scatter between windows."""
    # With the Hessian H of half the cost and the covariance J of the windows' gradients, independent errors have J = H
    # - 1; a missing effect makes J larger. Varin, Reid, Firth, composite likelihood (2011), 2.3.
    there = problem.fit(fit.hypothesis, noise, fit.z, fit.starts, FitPlan(constants.LAST, 0.05, robust=True))
    assert there.covariance is not None
    expected = len(there.z) - float(np.trace(np.linalg.pinv(there.hessian)))
    excess = max(1.0, float(np.trace(there.covariance @ there.hessian)) / max(expected, 1e-9))
    return NoiseModel(noise.std * np.sqrt(excess), noise.ar, excess)


def noise_ratio(problem: Problem, fit: Fit) -> float:
    """Return the RMS error of the fitted windows over the sensor noise, the largest over the outputs."""
    return float(np.max(_sizes(problem, fit) / np.max([r.sensor_noise for r in problem.records], axis=0)))


def _past(errors: Array, order: int) -> Array:
    """Return the ``order`` points before each point of a window, (n, order), latest first."""
    length = errors.shape[1]
    lagged = [errors[:, order - lag - 1 : length - lag - 1].ravel() for lag in range(order)]
    return np.column_stack(lagged) if lagged else np.empty((errors.size, 0))


def held_out_fit(held: Problem, fit: Fit, noise: NoiseModel) -> Fit:
    """Fit only the initial states of other windows, at the fitted parameters."""
    return held.fit(fit.hypothesis, noise, fit.z, plan=FitPlan(8, 0.5, fixed=True))


def as_fitted(held: Problem, fit: Fit, noise: NoiseModel) -> float:
    """Return the log-likelihood of other windows at the fitted parameters, up to a common constant."""
    return -0.5 * (held_out_fit(held, fit, noise).cost - float(fit.z @ fit.z))


def predictive(held: Problem, fit: Fit, noise: NoiseModel) -> float:
    """Return the log-likelihood of other windows given the fitted ones, up to a common constant."""
    # -1/2 min (V_h + (z - z^)^T H (z - z^)) - 1/2 logdet(H + H_h) + 1/2 logdet H: the parameters are known as well as
    # the fit determines them and no better, since another motion may be far more sensitive to them.
    placed = held_out_fit(held, fit, noise)
    known = Prior(fit.z, fit.hessian)
    there = held.fit(fit.hypothesis, noise, fit.z, placed.starts, FitPlan(PREDICTED, 0.5), prior=known)
    before, after = (float(np.linalg.slogdet(h)[1]) for h in (fit.hessian, there.hessian))
    return -0.5 * (there.cost + after - before)


def window_errors(problem: Problem, fit: Fit) -> Array:
    """Return the mean square error of each chosen window relative to the measured ranges, (n_windows,)."""
    errors, ranges = problem.errors(fit.hypothesis, fit.z, fit.starts), spans(problem.records)
    scaled = np.concatenate([e / np.where(ranges > 0, ranges, 1.0) for e in errors])
    squares = np.nansum(scaled**2, axis=(1, 2))
    return np.asarray(squares / np.maximum(np.isfinite(scaled).sum(axis=(1, 2)), 1))


def clearly_larger(errors: Array, others: Array) -> bool:
    """Return whether mean square errors of windows exceed others in total, and significantly (95 %)."""
    tiny = np.finfo(float).tiny
    ratio = np.log(np.maximum(errors, tiny) / np.maximum(others, tiny))
    if not errors.sum() > (1.0 + constants.AS_LARGE) ** 2 * others.sum():
        return False
    if len(ratio) < 2 or not ratio.std() > 0.0:
        return bool(ratio.mean() > 0.0)
    least = float(stdtrit(len(ratio) - 1, 0.95)) * ratio.std(ddof=1) / np.sqrt(len(ratio))
    return bool(ratio.mean() > least)


def spans(records: Sequence[PreparedRecord]) -> Array:
    """Return the largest measured range of each output, (n_measured,); 0 without measurement."""
    known = [[y[np.isfinite(y)] for y in r.y.T] for r in records]
    return np.max([[np.ptp(y) if y.size else 0.0 for y in row] for row in known], axis=0)


def least_squares(problem: Problem, fit: Fit, noise: NoiseModel, plan: FitPlan) -> Fit:
    """Refit under white noise of the size of the fit's errors, ``noise`` at least."""
    size = np.maximum(_sizes(problem, fit), noise.std)
    return problem.fit(fit.hypothesis, NoiseModel(size, noise.ar[:0]), fit.z, fit.starts, plan)


def restarted(problem: Problem, fit: Fit) -> Fit:
    """Re-estimate the initial states by least squares under the size of the fit's errors."""
    # Not under the sensor noise: errors of 500 times it would move an initial state by hundreds of deviations.
    start = replace(fit, starts=tuple(np.zeros((len(c), len(problem.plant.states))) for c in problem.chosen))
    for _ in range(2):  # better initial states improve the estimate of the errors' size
        start = least_squares(problem, start, first_noise(problem), FitPlan(8, 0.5, fixed=True))
    return start


def _sizes(problem: Problem, fit: Fit) -> Array:
    """Return the root mean square of a fit's errors, (n_measured,); 0 for an output without samples."""
    errors = np.concatenate([e.reshape(-1, e.shape[2]) for e in problem.errors(fit.hypothesis, fit.z, fit.starts)])
    known = np.isfinite(errors).sum(axis=0)
    return np.asarray(np.sqrt(np.nansum(errors**2, axis=0) / np.maximum(known, 1)))


def settled(problem: Problem, fit: Fit, noise: NoiseModel, order: int = constants.AR_ORDER) -> Fit:
    """Refit for the report: errors whitened by their own model, covariance from the scatter of the windows."""
    # While an effect is missing, full whitening is wrong: order 1, from a least-squares fit, gives less weight to
    # differences between neighbouring points, which are sensitive to a small ripple.
    found = least_squares(problem, fit, noise, FitPlan(SETTLING, 1e-3)) if order == 1 else fit
    for _ in range(2):
        own = whitening(problem, found, order)
        found = problem.fit(fit.hypothesis, own, found.z, found.starts, FitPlan(SETTLING, 1e-3, robust=True))
    return found


def in_phase(problem: Problem, fit: Fit, known: Sequence[PreparedRecord]) -> tuple[Problem, float]:
    """Shift the time of each record to the best phase of the fit's effects over time; return problem and log cost."""
    # Fitted (``known``) records keep their phase; of several such effects the first determines the phase.
    factors = [c.values(fit.z[own])[c.effect.timed] for c, own in problem.slices(fit.hypothesis) if c.effect.timed]
    new = [k for k, r in enumerate(problem.records) if not any(r is other for other in known)]
    if not factors or not new:
        return problem, 0.0
    records = list(problem.records)
    for k in new:
        records[k] = replace(records[k], begun=_begun(problem, fit, k, 1.0 / factors[0]))
    return problem.on(records, problem.chosen), PRICE * len(new)


def _begun(problem: Problem, fit: Fit, k: int, period: float) -> float:
    """Return the best time within a period for one record, by the cost of its windows."""
    from scipy.optimize import minimize_scalar

    def cost(later: float) -> float:
        alone = problem.on([replace(problem.records[k], begun=later)], [problem.chosen[k]])
        return held_out_fit(alone, fit, fit.noise).cost

    step = period / PHASES
    best = step * min(range(PHASES), key=lambda n: cost(step * n))
    bounds = best - step, best + step
    finer: Any = minimize_scalar(cost, bounds=bounds, method="bounded", options={"xatol": 0.01 * period})
    return float(finer.x) % period
