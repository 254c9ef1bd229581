r"""Methods of model reduction: the balanced system, the part of an order, the measure and the bound of its error.

Stochastic balancing keeps the error small relative to the model's own gain. W is the minimum-phase factor of the power
spectrum, P the controllability Gramian of G, X the observability Gramian of W; beta is a floor of the gain, below which
errors count absolutely.

.. math:: G G^\sim + \beta^2 I = W^\sim W, \quad R = D D^T + \beta^2 I, \quad B_W = P C^T + B D^T, \quad
   A^T X + X A + (C - B_W^T X)^T R^{-1} (C - B_W^T X) = 0

.. math:: \left\| (W^\sim)^{-1} (G - G_r) \right\|_\infty =
   \sup_\omega \sigma_{max}\big( (G G^* + \beta^2 I)^{-1/2} (G - G_r) \big) \le
   \prod_{i > r} \frac{1 + \mu_i}{1 - \mu_i} - 1, \qquad \mu_i^2 = \lambda_i(P X)

Optimal Hankel-norm approximation is the all-pass dilation of balanced states. With
:math:`\Sigma = \mathrm{diag}(\Sigma_1, \sigma I)`, :math:`\sigma = \sigma_{k+1}`, and A, B, C cut alike,

.. math:: U = -(C_2^T)^+ B_2, \quad \Gamma = \Sigma_1^2 - \sigma^2 I, \quad
   \hat A = \Gamma^{-1} (\sigma^2 A_{11}^T + \Sigma_1 A_{11} \Sigma_1 - \sigma C_1^T U B_1^T), \quad
   \hat B = \Gamma^{-1} (\Sigma_1 B_1 + \sigma C_1^T U), \quad \hat C = C_1 \Sigma_1 + \sigma U B_1^T, \quad
   \hat D = D - \sigma U

differs from the model by no more than sigma at any frequency. Its k stable modes are the nearest model of order k in
the Hankel norm, at a distance of exactly sigma; a constant replaces the others, which are not stable. U is a
contraction: a block of a unitary matrix for the model with rows and columns of zeros, so that models need not be
square, and U is unique.

References
----------
Glover, Int. J. Control 39 (1984), theorems 6.3 and 9.7; Desai, Pal, IEEE TAC 29 (1984); Green, "A relative error bound
for balanced stochastic truncation", IEEE TAC 33 (1988); Varga, Fasol 1993 for beta.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from robustlab.arrays import AnyArray
from robustlab.errors import InputError, NoTrustworthyNumber
from robustlab.linear_analysis import slicot
from robustlab.linear_analysis.matrices import balancing_exponents, care
from robustlab.linear_analysis.structural import least_order
from robustlab.norms import HinfNorm, bilinear_to_continuous, bilinear_to_discrete, hinf_norm, linf_norm
from robustlab.result import Status
from robustlab.statespace import StateSpaceModel, inverse, series
from robustlab.synthesis.reduction.balancing import (
    Balancing,
    SplitModel,
    block_factor,
    gramian_factors,
    lost_at_least_order,
    split_stable,
)
from robustlab.uncertainty.distances import continuous_models, coprime_factors

Weights = tuple[StateSpaceModel | None, StateSpaceModel | None]  # W_i and W_o

HINT = "floor=: the gain below which errors count absolutely"
RTOL = 1e-6  # relative width of the bracket of an error
# D of full row rank: smallest over largest eigenvalue of D D^T. Else the gain vanishes at infinite frequency.
FULL_RANK = 1e-12
# Both ends of the bracket allow for the error of the factor; up to this share of the spectrum it is certified.
TRUSTED_SHARE = 1e-2
# Hankel values that agree to this share are one repeated value: division by their difference would lose more digits.
REPEATED = 1e-8


@dataclass(frozen=True, eq=False)
class Way:
    """One method for a part of a model."""

    method: str
    split: SplitModel
    part: StateSpaceModel  # the reduced part: the stable one, or the coprime factors
    model: StateSpaceModel  # the same, or its continuous image for the methods that exist in continuous time only
    balancing: Balancing
    weights: Weights = (None, None)
    spectrum: Spectrum | None = None

    def reduced(self, order: int) -> StateSpaceModel:
        """Return the part with this order."""
        if self.method == "hankel":
            small = nearest_in_hankel_norm(self.model, self.balancing, order)
        else:
            kind = "residualisation" if self.method == "residualisation" else "truncation"
            small = self.balancing.reduced(self.model, order, kind)
        return bilinear_to_discrete(small, self.part.dt) if self.part.dt != self.model.dt else small

    def whole(self, small: StateSpaceModel) -> StateSpaceModel:
        """Return the model that belongs to a reduced part: ``N M^{-1}`` for coprime factors."""
        if self.method != "coprime":
            return self.split.joined(small)
        full = self.split.stable
        p = full.n_outputs
        if small.n_inputs and np.linalg.cond(small.D[p:]) > 1e12:
            raise NoTrustworthyNumber("reduce_model", "the factor M of the reduced model has no inverse")
        back = np.linalg.inv(small.D[p:])
        gain, into = back @ small.C[p:], small.B @ back
        model = StateSpaceModel(
            small.A - into @ small.C[p:], into, small.C[:p] - small.D[:p] @ gain, small.D[:p] @ back
        )
        return bilinear_to_discrete(model, full.dt) if full.dt else model

    def bound(self, order: int) -> float:
        """Return the a-priori bound of the error; NaN with weights."""
        values = self.balancing.values
        if self.weights != (None, None):
            return np.nan
        if self.spectrum is not None:
            return relative_bound(values, order)
        return hankel_bound(values, order) if self.method == "hankel" else error_bound(values, order)

    def measured(self, difference: StateSpaceModel) -> HinfNorm:
        """Return the certified size of a difference of parts."""
        dt = difference.dt
        if self.spectrum is not None:
            found = self.spectrum.relative(bilinear_to_continuous(difference) if dt else difference)
            return replace(found, frequency=2 / dt * float(np.arctan(found.frequency * dt / 2))) if dt else found
        into, out = self.weights
        difference = difference if into is None else series(into, difference)
        return hinf_norm(difference if out is None else series(difference, out), RTOL)

    def per_gain(self) -> float:
        """Return an upper bound of the size of a difference of gain 1."""
        if self.spectrum is not None:
            return self.spectrum.per_gain()
        return float(np.prod([hinf_norm(w, 1e-2).upper for w in self.weights if w is not None]))


def way_of(full: StateSpaceModel, method: str, weights: Weights = (None, None), floor: float = 0.0) -> Way:
    """Return a method for the stable part of a model, or for the coprime factors of all of it."""
    if method == "coprime":
        return _coprime_way(full)
    split = split_stable(full)
    stable = split.stable
    continuous = bilinear_to_continuous(stable) if stable.dt and method in ("stochastic", "hankel") else stable
    if method == "stochastic":
        spectrum = Spectrum.of(continuous, floor)
        return Way(method, split, stable, spectrum.model, spectrum.balancing, spectrum=spectrum)
    balancing = Balancing.of(*weighted_factors(continuous, *weights))
    return Way(method, split, stable, continuous, balancing, weights)


def weighted_factors(
    model: StateSpaceModel, into: StateSpaceModel | None, out: StateSpaceModel | None
) -> tuple[AnyArray, AnyArray]:
    r"""Return factors of the model's blocks of the Gramians of ``G W_i`` and ``W_o G`` (Enns)."""
    reach, see = gramian_factors(model)
    if into is not None:  # states of the series connection: weight first, then model
        reach = block_factor(gramian_factors(series(into, model))[0][into.n_states :])
    if out is not None:
        see = block_factor(gramian_factors(series(model, out))[1][: model.n_states])
    return reach, see


def _coprime_way(full: StateSpaceModel) -> Way:
    """Return truncation of the normalised right coprime factors ``[N; M]`` (continuous) of a model of any stability."""
    least = least_order(full)
    hidden = least.hidden if any(not mode.stable for mode in least.hidden) else ()
    full = least.model if hidden else full
    factors = coprime_factors(*continuous_models(full)).right
    nothing = StateSpaceModel([], [], [], 0 * full.D, full.dt)
    split = SplitModel(full, nothing, lost_at_least_order(least) if hidden else None, hidden)
    balancing = Balancing.of(*gramian_factors(factors))
    return Way("coprime", split, factors, factors, balancing)


def error_bound(values: AnyArray, order: int) -> float:
    """Return twice the sum of the Hankel values after the first ``order``, repeated ones counted once.

    Values that agree to 1e-10 count as repeated only where the cut does not separate them from kept ones.
    """
    tail = values[order:]
    if not len(tail):
        return 0.0
    new = np.append(True, tail[1:] < tail[:-1] * (1 - 1e-10))
    cut_in_two = order and tail[0] >= values[order - 1] * (1 - 1e-10)
    return 2 * float((tail if cut_in_two else tail[new]).sum())


# --- Hankel norm ------------------------------------------------------------------------------------------------------


def _dilated(m: StateSpaceModel, values: AnyArray, k: int, unitary: bool = False) -> tuple[StateSpaceModel, AnyArray]:
    """Return the dilation of a balanced model without the (repeated) value at index k, and the other values.

    Its states are scaled by the root of ``|Gamma|``; U may be completed to a unitary matrix for a square model.
    """
    level = values[k]
    cut = np.abs(values - level) <= REPEATED * level
    u = -np.linalg.pinv(m.C[:, cut].T) @ m.B[cut]
    if unitary:
        eye = np.eye(len(u))
        left, _, right = np.linalg.svd(u + (eye - u @ u.T) @ (eye - u.T @ u))
        u = left @ right
    s, a, b, c = values[~cut], m.A[np.ix_(~cut, ~cut)], m.B[~cut], m.C[:, ~cut]
    gamma = s**2 - level**2
    root = np.sqrt(np.abs(gamma))
    inverse = (np.sign(gamma) / root)[:, None]
    middle = level**2 * a.T + s[:, None] * a * s - level * c.T @ u @ b.T
    dilated = StateSpaceModel(
        inverse * middle / root,
        inverse * (s[:, None] * b + level * c.T @ u),
        (c * s + level * u @ b.T) / root,
        m.D - level * u,
    )
    return dilated, s


def nearest_in_hankel_norm(model: StateSpaceModel, balancing: Balancing, order: int) -> StateSpaceModel:
    """Return the nearest model of at most this order; of a lower one if the value after the cut is repeated."""
    values = balancing.values[: len(balancing.left)]
    if order >= len(values):
        return balancing.reduced(model, order, "truncation")
    order = int((values > values[order] * (1 + REPEATED)).sum())
    parts = split_stable(_dilated(balancing.reduced(model, len(values), "truncation"), values, order)[0])
    m = parts.stable
    if m.n_states != order:
        found = f"{m.n_states} stable modes where there should be {order}: digits were lost"
        raise NoTrustworthyNumber("Hankel-norm approximation", found, hint="another order, or method='truncation'")
    return StateSpaceModel(m.A, m.B, m.C, m.D + _constant_near(parts.apart), 0.0, model.inputs, model.outputs)


def _constant_near(unstable: StateSpaceModel) -> AnyArray:
    """Return a constant no farther from a strictly proper antistable model than the sum of its Hankel values.

    The values are removed one by one, the smallest first: each dilation changes the model by no more than its value,
    and is balanced with the other values, as the model is square and U unitary.
    """
    mirrored = StateSpaceModel(-unstable.A, -unstable.B, unstable.C, unstable.D)
    balancing = Balancing.of(*gramian_factors(mirrored))
    values = balancing.values[: len(balancing.left)]
    left = balancing.reduced(mirrored, len(values), "truncation")
    (p, m), size = left.D.shape, max(left.D.shape)
    square = np.pad(left.B, ((0, 0), (0, size - m))), np.pad(left.C, ((0, size - p), (0, 0)))
    left = StateSpaceModel(left.A, *square, np.pad(left.D, ((0, size - p), (0, size - m))))
    while len(values):
        left, values = _dilated(left, values, len(values) - 1, unitary=True)
    return left.D[:p, :m]


def hankel_bound(values: AnyArray, order: int) -> float:
    """Return the bound of the H-infinity error: the value after the cut once, plus the sum of all smaller ones."""
    if order >= len(values):
        return 0.0
    level = values[order]
    return float(level + values[values < level * (1 - REPEATED)].sum())


# --- relative error ---------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Spectrum:
    """The power spectrum of a stable continuous model and its factor."""

    model: StateSpaceModel
    factor: StateSpaceModel  # W, with the states of G
    balancing: Balancing  # of P and X; its values are the mu_i, at most 1
    doubt: float  # share of the spectrum by which `W~ W` may be off, from the residuals of both equations

    @classmethod
    def of(cls, model: StateSpaceModel, floor: float) -> Spectrum:
        """Compute the factor by a Riccati equation."""
        # Residuals are weighted by gains from and to all states, which must have similar sizes for that.
        t = 2.0 ** balancing_exponents(model.A, model.B, model.C)
        a, b, c, d = model.A / t[:, None] * t, model.B / t[:, None], model.C * t, model.D
        model = StateSpaceModel(a, b, c, d)
        sizes, turn = np.linalg.eigh(d @ d.T + floor**2 * np.eye(len(d)))
        if not len(d) or sizes[0] <= FULL_RANK * sizes[-1]:
            found = "the gain vanishes at infinite frequency: D has no full row rank"
            raise InputError("reduce_model", found, "a gain that vanishes nowhere", HINT)
        root, back = (turn * np.sqrt(sizes) @ turn.T, turn / np.sqrt(sizes) @ turn.T)
        reach = slicot.gramian_factors(a, b, c, False)[0]
        P = reach @ reach.T
        into = P @ c.T + b @ d.T
        try:
            X = care(a, into, np.zeros_like(a), -root @ root, -c.T).X
        except NoTrustworthyNumber as error:
            found = "the power spectrum has no factor: the gain vanishes at some frequency, or nearly"
            raise NoTrustworthyNumber("reduce_model", f"{found} ({error.found})", hint=HINT) from None
        out = back @ (c - into.T @ X)
        factor = StateSpaceModel(a, into, out, root)
        doubt = _doubt(factor, c, a @ P + P @ a.T + b @ b.T, a.T @ X + X @ a + out.T @ out)
        return cls(model, factor, Balancing.of(reach, slicot.gramian_factors(a, b, out, False)[1]), doubt)

    def per_gain(self) -> float:
        """Bound the relative error of an absolute error of gain 1."""
        found = linf_norm(inverse(_conjugate(self.factor)), 1e-2)
        return self._widened(found.upper) if found.status.trustworthy else np.inf

    def relative(self, error: StateSpaceModel) -> HinfNorm:
        """Return the norm of an error relative to the model, proved for every frequency."""
        found = linf_norm(series(error, inverse(_conjugate(self.factor))), RTOL)
        lower = found.lower / np.sqrt(1 + self.doubt) if self.doubt < np.inf else 0.0
        found = replace(found, lower=lower, upper=self._widened(found.upper))
        if found.status is Status.CERTIFIED and not self.doubt <= TRUSTED_SHARE:
            reason = f"the factor of the spectrum may be off by {self.doubt:.1e} of it"
            return replace(found, status=Status.INACCURATE, reason=reason)
        return found

    def _widened(self, upper: float) -> float:
        """Convert an upper bound relative to the factor to one relative to the spectrum."""
        return upper / np.sqrt(1 - self.doubt) if self.doubt < 1 else np.inf


def relative_bound(values: AnyArray, order: int) -> float:
    """Return ``prod (1 + mu) / (1 - mu) - 1`` over the values after the first ``order``; infinite if one is 1."""
    tail = values[order:]
    if (tail >= 1 - 1e-8).any():  # a zero in the right half-plane, whose state must stay
        return np.inf
    return float(np.expm1(np.sum(np.log1p(tail) - np.log1p(-tail))))


def _conjugate(model: StateSpaceModel) -> StateSpaceModel:
    """Return ``G(-s)^T``."""
    return StateSpaceModel(-model.A.T, model.C.T, -model.B.T, model.D.T)


def _doubt(factor: StateSpaceModel, c: AnyArray, into: AnyArray, out: AnyArray) -> float:
    r"""Bound :math:`\|(W^\sim)^{-1} (G G^\sim + \beta^2 I - W^\sim W) W^{-1}\|_\infty`.

    The residuals E_P and E_X give the error ``C F E_P F~ C^T + B_W^T F~ E_X F B_W`` with ``F = (sI - A)^-1``.
    """
    n, p = factor.n_states, factor.n_outputs
    if not n:
        return 0.0
    gain = factor.B @ np.linalg.inv(factor.D)
    right = StateSpaceModel(factor.A - gain @ factor.C, gain, np.eye(n), np.zeros((n, p)))
    left = series(StateSpaceModel(factor.A, np.eye(n), c, np.zeros((p, n))), inverse(_conjugate(factor)))
    sizes = [float(np.linalg.norm(residual, 2)) for residual in (into, out)]
    return sizes[0] * linf_norm(left, 1e-2).upper ** 2 + sizes[1] * hinf_norm(right, 1e-2).upper ** 2
