"""Measures of controllability: what is left of the nominal reach, and the smallest Hankel singular value.

Both are of Gramians, made for many members at once: on a finite horizon by doubling a Taylor series, on the infinite
one by the squared Smith iteration.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from robustlab.arrays import Array
from robustlab.errors import InputError, NoTrustworthyNumber
from robustlab.statespace import StateSpaceModel, real_array
from robustlab.uncertainty.lft import UncertainModel
from robustlab.worst_case_analysis.ensemble import Ensemble, members
from robustlab.worst_case_analysis.metric_contract import (
    Evaluation,
    Metric,
    connected,
    need_real,
    need_stable,
    selected,
)
from robustlab.worst_case_analysis.tuning import TUNING


def gramians(ensemble: Ensemble, kind: Literal["controllability", "observability"]) -> Array:
    r"""Gramians of stable members, shape (k, n_x, n_x).

    .. math:: A P + P A^T + B B^T = 0 \quad\text{or}\quad A P A^T - P + B B^T = 0

    A continuous equation is made discrete by the Cayley map, :math:`A_d = (p I + A)(p I - A)^{-1}`, and
    :math:`P = \sum_j A_d^j Q A_d^{jT}` is summed by doubling.

    References
    ----------
    Smith, "Matrix equation XA + BX = C", SIAM J. Appl. Math. 16 (1968).
    """
    a, n = ensemble.A, ensemble.A.shape[1]
    source = ensemble.B
    if kind == "observability":
        a, source = a.transpose(0, 2, 1), ensemble.C.transpose(0, 2, 1)
    q = source @ source.transpose(0, 2, 1)
    if n and not ensemble.dt:
        size = np.abs(np.linalg.eigvals(ensemble.A))
        rate = np.sqrt(size.min(axis=1) * size.max(axis=1))[:, None, None]
        inverse = np.linalg.inv(rate * np.eye(n) - a)
        q = 2.0 * rate * inverse @ q @ inverse.transpose(0, 2, 1)
        a = (rate * np.eye(n) + a) @ inverse
    power, total = a, q
    with np.errstate(under="ignore"):
        for _ in range(TUNING.doublings):
            total = total + power @ total @ power.transpose(0, 2, 1)
            power = power @ power
            # Powers that shrink below the smallest normal numbers would slow down everything.
            power = np.where(np.abs(power) < 1e-150, 0.0, power)
    return 0.5 * (total + total.transpose(0, 2, 1))


def finite_gramians(ensemble: Ensemble, duration: float, norm: float) -> Array:
    r"""Controllability Gramians on [0, T], shape (k, n_x, n_x); members may be unstable.

    .. math:: W(T) = \int_0^T e^{A t} B B^T e^{A^T t} dt, \qquad W(2 h) = W(h) + e^{A h} W(h) e^{A^T h}

    and of a discrete model the sum over ``round(T / dt)`` samples.

    Parameters
    ----------
    duration
        T in s.
    norm
        Size of A in 1/s, which decides the first step: one for all members of a set.
    """
    a, n = ensemble.A, ensemble.A.shape[1]
    q = ensemble.B @ ensemble.B.transpose(0, 2, 1)
    if ensemble.dt:
        total, state = np.zeros_like(q), np.broadcast_to(np.eye(n), a.shape)
        for _ in range(max(1, round(duration / ensemble.dt))):
            total = total + state @ q @ state.transpose(0, 2, 1)
            state = a @ state
        return total
    halvings = max(0, int(np.ceil(np.log2(max(norm * duration / TUNING.taylor_reach, 1.0)))))
    h = duration / 2**halvings
    # Taylor series of W(h): its derivatives at 0 follow W' = A W + W A^T + Q.
    term, total = q * h, q * h
    phi, power = np.eye(n) + a * h, a * h
    for j in range(2, TUNING.taylor_terms + 1):
        term = (a @ term + term @ a.transpose(0, 2, 1)) * (h / j)
        total = total + term
        power = power @ a * (h / j)
        phi = phi + power
    for _ in range(halvings):
        total = total + phi @ total @ phi.transpose(0, 2, 1)
        phi = phi @ phi
    return 0.5 * (total + total.transpose(0, 2, 1))


class RelativeReach(Metric):
    r"""Smallest eigenvalue of :math:`W_0^{-1} W(\Delta)`: how much of the nominal reach is left where least is left.

    W is the controllability Gramian on [0, T]: :math:`x^T W^{-1} x` is the energy that moves the state to x. The
    measure does not depend on the units of states; it is 1 for the nominal model and 0 where controllability is lost.
    Unstable models have it, too.
    """

    sense = -1.0
    tolerance = 1e-5

    def __init__(self, uncertain: UncertainModel, input: str | None, duration: float) -> None:
        need_real(uncertain, "controllability")
        if not 0 < duration < np.inf:
            raise InputError("worst_case", f"a horizon of {duration:g} s", "a positive time")
        if not uncertain.M.n_states:
            raise InputError("worst_case", "a model without states", "states: there is nothing to control")
        self.uncertain, self._duration = selected(uncertain, input, None), duration
        centre = members(self.uncertain, np.zeros((1, *uncertain.delta_shape)))
        self._norm = float(np.linalg.norm(centre.A[0] / centre.scale[:, None] * centre.scale, 2))
        gramian = finite_gramians(centre, duration, self._norm)[0]
        unit = np.sqrt(np.diag(gramian))
        if not (unit > 0).all() or 1.0 / np.linalg.cond(gramian / np.outer(unit, unit)) < TUNING.smallest_condition:
            raise NoTrustworthyNumber(
                "worst_case",
                f"the nominal model is not controllable within {duration:g} s to working precision",
                None,
                "name another input, a longer time, or leave out states that no input moves",
            )
        self._unit = unit
        self._root = np.linalg.cholesky(gramian / np.outer(unit, unit))

    def _smallest(self, gramian: Array) -> Array:
        """Smallest generalised eigenvalue of each Gramian (k, n_x, n_x) against the nominal one."""
        scaled = gramian / np.outer(self._unit, self._unit)
        half = np.linalg.solve(self._root, scaled)
        return real_array(
            "eigenvalues", np.linalg.eigvalsh(np.linalg.solve(self._root, half.transpose(0, 2, 1)))[:, 0], 1
        )

    def of(self, ensemble: Ensemble) -> Array:
        """See `Metric.of`."""
        good = np.flatnonzero(~ensemble.ill_posed)
        value = np.full(len(ensemble), -np.inf)
        with np.errstate(over="ignore", invalid="ignore"):
            gramian = finite_gramians(ensemble.part(good), self._duration, self._norm)
        finite = np.isfinite(gramian).all(axis=(1, 2))
        value[good[finite]] = self._smallest(gramian[finite])
        return value

    def of_model(self, model: StateSpaceModel) -> Evaluation:
        """See `Metric.of_model`; Gauss-Legendre quadrature of the Gramian is the second way."""
        from scipy.linalg import expm

        if model.is_discrete:
            steps = max(1, round(self._duration / model.dt))
            reach = [model.B]
            for _ in range(steps - 1):
                reach.append(model.A @ reach[-1])
            columns = np.hstack(reach)
        else:
            nodes, weights = np.polynomial.legendre.leggauss(TUNING.nodes)
            panels = max(TUNING.panels, int(np.ceil(self._norm * self._duration)))
            step = self._duration / panels
            start = [expm(model.A * (0.5 * step * (node + 1))) @ model.B for node in nodes]
            first = np.hstack([np.sqrt(0.5 * step * w) * x for w, x in zip(weights, start, strict=True)])
            move, columns = expm(model.A * step), [first]
            for _ in range(panels - 1):
                columns.append(move @ columns[-1])
            columns = np.hstack(columns)
        return Evaluation(float(self._smallest((columns @ columns.T)[None])[0]))

    def slack(self, value: float) -> float:
        """See `Metric.slack`: eigenvalues are known to a share of the largest, which is about one."""
        return self.tolerance * max(1.0, abs(value))


class HankelValue(Metric):
    r"""Smallest Hankel singular value, :math:`\sqrt{\lambda_{min}(P Q)}`: the weakest path from past inputs to outputs.

    Of the states that inputs reach and outputs see; ``-inf`` for an unstable member, which has none. Below about 1e-6
    of the nominal model's largest value it cannot be told from zero.
    """

    sense = -1.0
    tolerance = 1e-5

    def __init__(self, uncertain: UncertainModel, input: str | None, output: str | None) -> None:
        need_real(uncertain, "hankel")
        self.uncertain = connected(selected(uncertain, input, output))
        if not self.uncertain.M.n_states:
            raise InputError("worst_case", "no states between input and output", "states")
        need_stable(self.uncertain.nominal, "it has no Hankel singular values")
        self._size = 0.0
        self._size = float(self._all(self.uncertain.nominal).max())

    def of(self, ensemble: Ensemble) -> Array:
        """See `Metric.of`."""
        value = np.full(len(ensemble), -np.inf)
        good = np.flatnonzero(ensemble.is_stable())
        some = ensemble.part(good)
        product = gramians(some, "controllability") @ gramians(some, "observability")
        value[good] = np.sqrt(np.maximum(np.linalg.eigvals(product).real.min(axis=1), 0.0))
        return value

    def of_model(self, model: StateSpaceModel) -> Evaluation:
        """See `Metric.of_model`; Lyapunov equations by Schur's form are the second way."""
        if not model.is_stable():
            return Evaluation(-np.inf, reason="this member is unstable and has no Hankel singular values")
        return Evaluation(float(self._all(model).min()))

    def _all(self, model: StateSpaceModel) -> Array:
        from robustlab.matrix_equations import lyapunov

        reach = lyapunov(model.A, model.B @ model.B.T, model.is_discrete)
        see = lyapunov(model.A.T, model.C.T @ model.C, model.is_discrete)
        roots = []
        for gramian in (reach, see):
            values, vectors = np.linalg.eigh(0.5 * (gramian + gramian.T))
            roots.append(vectors * np.sqrt(np.maximum(values, 0.0)))
        return real_array("Hankel values", np.linalg.svd(roots[1].T @ roots[0], compute_uv=False), 1)

    def slack(self, value: float) -> float:
        """See `Metric.slack`: Gramians are known to about 1e-13 of their largest values, and roots halve the digits."""
        return max(self.tolerance * abs(value), 1e-6 * self._size)
