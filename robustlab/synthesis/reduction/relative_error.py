r"""Balanced stochastic truncation of a stable continuous model: the error relative to the model's own gain.

W is the minimum-phase factor of the power spectrum, P the controllability Gramian of G, X the observability Gramian of
W; beta is a floor of the gain, below which errors count absolutely.

.. math:: G G^\sim + \beta^2 I = W^\sim W, \quad R = D D^T + \beta^2 I, \quad B_W = P C^T + B D^T, \quad
   A^T X + X A + (C - B_W^T X)^T R^{-1} (C - B_W^T X) = 0

.. math:: \left\| (W^\sim)^{-1} (G - G_r) \right\|_\infty =
   \sup_\omega \sigma_{max}\big( (G G^* + \beta^2 I)^{-1/2} (G - G_r) \big) \le
   \prod_{i > r} \frac{1 + \mu_i}{1 - \mu_i} - 1, \qquad \mu_i^2 = \lambda_i(P X)

For a square G and beta = 0 that is the norm of :math:`G^{-1} (G - G_r)`.

References
----------
Desai, Pal, IEEE TAC 29 (1984); Green, "A relative error bound for balanced stochastic truncation", IEEE TAC 33 (1988);
Varga, Fasol 1993 for beta.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from robustlab.arrays import AnyArray
from robustlab.errors import InputError, NoTrustworthyNumber
from robustlab.linear_analysis import slicot
from robustlab.linear_analysis.magnitude import balancing_exponents
from robustlab.linear_analysis.matrix_equations import care
from robustlab.norms import HinfNorm, hinf_norm, linf_norm
from robustlab.result import Status
from robustlab.statespace import StateSpaceModel, inverse, series
from robustlab.synthesis.reduction.balancing import Balancing

__all__ = ["Spectrum", "relative_bound"]

HINT = "floor=: the gain below which errors count absolutely"
TINY = float(np.finfo(float).tiny)
# Of a model whose entries are of order one.
LARGEST_FLOOR = 1e50
# D D^T of a smaller share in its smallest eigenvalue has no full row rank: the model has no gain somewhere far out.
FULL_RANK = 1e-12
# Both ends of the bracket allow for what the factor may be off; up to this share of the spectrum it is certified.
TRUSTED_SHARE = 1e-2


@dataclass(frozen=True, eq=False)
class Spectrum:
    """The power spectrum of a model and its factor.

    Attributes
    ----------
    model
        G, stable, continuous.
    factor
        W, with the states of G.
    balancing
        Of P and X; its values are the mu_i, at most 1.
    doubt
        Share of the spectrum by which ``W~ W`` may be off, from the residuals of both equations.
    """

    model: StateSpaceModel
    factor: StateSpaceModel
    balancing: Balancing
    doubt: float

    @classmethod
    def of(cls, model: StateSpaceModel, floor: float) -> Spectrum:
        """The factor by a Riccati equation."""
        if floor > LARGEST_FLOOR:
            found = f"the floor is {floor:.0e} times what the gain is about"
            raise InputError("reduce_model: floor", found, f"at most {LARGEST_FLOOR:.0e}")
        # Residuals are weighed by gains from and to all states, which must be alike in size for that.
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
        """What an error of gain 1 is at most relative to the model."""
        found = linf_norm(inverse(_conjugate(self.factor)), 1e-2)
        return self._widened(found.upper) if found.status.trustworthy else np.inf

    def relative(self, error: StateSpaceModel, rtol: float) -> HinfNorm:
        """The norm of an error relative to the model, proved for every frequency."""
        found = linf_norm(series(error, inverse(_conjugate(self.factor))), rtol)
        lower = found.lower / np.sqrt(1 + self.doubt) if self.doubt < np.inf else 0.0
        found = replace(found, lower=lower, upper=self._widened(found.upper))
        if found.status is Status.CERTIFIED and not self.doubt <= TRUSTED_SHARE:
            reason = f"the factor of the spectrum may be off by {self.doubt:.1e} of it"
            return replace(found, status=Status.INACCURATE, reason=reason)
        return found

    def _widened(self, upper: float) -> float:
        """What is relative to the factor at most, relative to the spectrum."""
        return upper / np.sqrt(1 - self.doubt) if self.doubt < 1 else np.inf


def relative_bound(values: AnyArray, order: int) -> float:
    """``prod (1 + mu) / (1 - mu) - 1`` over the values after the first ``order``; infinite where one of them is 1."""
    tail = values[order:]
    if (tail >= 1 - 1e-8).any():  # a zero in the right half-plane, whose state must stay
        return np.inf
    return float(np.expm1(np.sum(np.log1p(tail) - np.log1p(-tail))))


def _conjugate(model: StateSpaceModel) -> StateSpaceModel:
    """``G(-s)^T``."""
    return StateSpaceModel(-model.A.T, model.C.T, -model.B.T, model.D.T)


def _doubt(factor: StateSpaceModel, c: AnyArray, into: AnyArray, out: AnyArray) -> float:
    r"""Bound of :math:`\|(W^\sim)^{-1} (G G^\sim + \beta^2 I - W^\sim W) W^{-1}\|_\infty`.

    Residuals E_P and E_X of the two equations leave ``C F E_P F~ C^T + B_W^T F~ E_X F B_W`` with ``F = (sI - A)^-1``.
    """
    n, p = factor.n_states, factor.n_outputs
    if not n:
        return 0.0
    gain = factor.B @ np.linalg.inv(factor.D)
    right = StateSpaceModel(factor.A - gain @ factor.C, gain, np.eye(n), np.zeros((n, p)))
    left = series(StateSpaceModel(factor.A, np.eye(n), c, np.zeros((p, n))), inverse(_conjugate(factor)))
    sizes = [float(np.linalg.norm(residual, 2)) for residual in (into, out)]
    return sizes[0] * linf_norm(left, 1e-2).upper ** 2 + sizes[1] * hinf_norm(right, 1e-2).upper ** 2
