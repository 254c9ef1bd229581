"""Metrics of the model itself, whatever drives it: norms (H-infinity, H2) and poles."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robustlab.arrays import Array
from robustlab.errors import InputError, NoTrustworthyNumber
from robustlab.linear_analysis.frequency import default_grid
from robustlab.statespace import StateSpaceModel
from robustlab.uncertainty.blocks import delta_matrix
from robustlab.uncertainty.lft import UncertainModel
from robustlab.worst_case_analysis.ensemble import Ensemble, chunks, members, peak_gains
from robustlab.worst_case_analysis.metric_contract import (
    Evaluation,
    Metric,
    connected,
    need_real,
    need_stable,
    selected,
)

DOUBLINGS = 46  # of the Smith iteration; a pole at 1e-12 of its size from the boundary has converged by then
GRID_POINTS = 48  # frequencies at which the gain of every member is computed, besides those of its own poles


def _gramians(ensemble: Ensemble) -> Array:
    r"""Return the controllability Gramians of stable members, shape (k, n_x, n_x).

    .. math:: A P + P A^T + B B^T = 0 \quad\text{or}\quad A P A^T - P + B B^T = 0

    A continuous equation is made discrete by the Cayley map, :math:`A_d = (p I + A)(p I - A)^{-1}`, and
    :math:`P = \sum_j A_d^j Q A_d^{jT}` is summed by doubling (Smith, SIAM J. Appl. Math. 16, 1968).
    """
    a, n = ensemble.A, ensemble.A.shape[1]
    q = ensemble.B @ ensemble.B.transpose(0, 2, 1)
    if n and not ensemble.dt:
        size = np.abs(np.linalg.eigvals(ensemble.A))
        rate = np.sqrt(size.min(axis=1) * size.max(axis=1))[:, None, None]
        inverse = np.linalg.inv(rate * np.eye(n) - a)
        q = 2.0 * rate * inverse @ q @ inverse.transpose(0, 2, 1)
        a = (rate * np.eye(n) + a) @ inverse
    power, total = a, q
    with np.errstate(under="ignore"):
        for _ in range(DOUBLINGS):
            total = total + power @ total @ power.transpose(0, 2, 1)
            power = power @ power
            # Powers that shrink below the smallest normal numbers would slow down everything.
            power = np.where(np.abs(power) < 1e-150, 0.0, power)
    return 0.5 * (total + total.transpose(0, 2, 1))


class HinfGain(Metric):
    """H-infinity norm of the members from all or one input to all or one output; ``inf`` where unstable."""

    location = "omega [rad/s]"
    one_sided = True

    def __init__(self, uncertain: UncertainModel, input: str | None, output: str | None) -> None:
        self.uncertain = connected(selected(uncertain, input, output))
        nominal = self.uncertain.nominal
        need_stable(nominal, "its H-infinity norm is infinite")
        self._grid = default_grid(nominal, GRID_POINTS)

    def of(self, ensemble: Ensemble) -> Array:
        """See `Metric.of`."""
        return peak_gains(ensemble, self._grid)[0]

    def of_model(self, model: StateSpaceModel) -> Evaluation:
        """See `Metric.of_model`; `robustlab.norms.hinf_norm` is the second way."""
        from robustlab.norms import hinf_norm

        norm = hinf_norm(model)
        return Evaluation(norm.value, norm.frequency, norm.status.trustworthy, norm.reason)

    def evaluate(self, delta: Mapping[str, Any]) -> Evaluation:
        """See `Metric.evaluate`."""
        if np.iscomplexobj(delta_matrix(self.uncertain.blocks, delta)):
            return self._complex_gain(delta)
        return super().evaluate(delta)

    def _complex_gain(self, delta: Mapping[str, Any]) -> Evaluation:
        """Gain at the frequency that the search found, from `UncertainModel.response`; stability from the poles."""
        stack = delta_matrix(self.uncertain.blocks, delta)[None]
        ensemble = members(self.uncertain, stack)
        if not ensemble.spectral_abscissa()[0] < 0 and self.uncertain.M.n_states:
            return Evaluation(np.inf)
        omega = float(peak_gains(ensemble, self._grid)[1][0])
        # At a negative frequency M is the conjugate of itself at the positive one; so the gain is that of conj(Delta).
        values = delta if omega >= 0 else {name: np.conj(value) for name, value in delta.items()}
        response = self.uncertain.response([abs(omega)], values)[0]
        return Evaluation(float(np.linalg.norm(response, 2)) if response.size else 0.0, omega)


class H2Gain(Metric):
    """H2 norm of the members from all or one input to all or one output; ``inf`` where unstable."""

    tolerance = 1e-5

    def __init__(self, uncertain: UncertainModel, input: str | None, output: str | None) -> None:
        need_real(uncertain, "h2")
        self.uncertain = connected(selected(uncertain, input, output))
        need_stable(self.uncertain.nominal, "its H2 norm is infinite")
        if not uncertain.dt and self.uncertain.nominal.D.any():
            hint = "choose input and output without direct feedthrough, or use the metric hinf"
            raise NoTrustworthyNumber("worst_case", "the model has a direct term: its H2 norm is infinite", None, hint)

    def of(self, ensemble: Ensemble) -> Array:
        """See `Metric.of`."""
        value = np.full(len(ensemble), np.inf)
        direct = ensemble.D.any(axis=(1, 2)) if not ensemble.dt else np.zeros(len(ensemble), dtype=bool)
        good = np.flatnonzero(ensemble.is_stable() & ~direct)
        some = ensemble.part(good)
        reach = _gramians(some)
        square = np.einsum("kij,kjl,kil->k", some.C, reach, some.C)
        if ensemble.dt:
            square = square + (some.D**2).sum(axis=(1, 2))
        value[good] = np.sqrt(np.maximum(square, 0.0))
        return value

    def of_model(self, model: StateSpaceModel) -> Evaluation:
        """See `Metric.of_model`; `robustlab.norms.h2_norm` is the second way."""
        from robustlab.norms import h2_by_gramians

        norm = h2_by_gramians(model)
        return Evaluation(norm.value, accurate=norm.status.trustworthy, reason=norm.reason)


class _OfPoles(Metric):
    """What metrics of the poles share: states, and the number of a pole."""

    def __init__(self, uncertain: UncertainModel) -> None:
        if not uncertain.M.n_states:
            raise InputError("worst_case", "a model without states", "states: a static gain has no poles")
        self.uncertain = uncertain

    def _number(self, poles: NDArray[np.complex128]) -> Array:
        """What is judged of each pole."""
        raise NotImplementedError

    def values(self, delta: NDArray[Any]) -> Array:
        """See `Metric.values`."""
        result = np.empty(len(delta))
        for part in chunks(len(delta), self.uncertain.M.A.size):
            result[part] = self.of(members(self.uncertain, delta[part]))
        return result

    def of(self, ensemble: Ensemble) -> Array:
        """See `Metric.of`."""
        numbers = self._number(np.linalg.eigvals(ensemble.A).astype(complex))
        return np.where(ensemble.ill_posed, self.unbounded, self.sense * (self.sense * numbers).max(axis=1))

    def of_model(self, model: StateSpaceModel) -> Evaluation:
        """See `Metric.of_model`."""
        return self._evaluation(model.poles())

    def evaluate(self, delta: Mapping[str, Any]) -> Evaluation:
        """See `Metric.evaluate`; complex Deltas have poles too."""
        d = delta_matrix(self.uncertain.blocks, delta)
        if not np.iscomplexobj(d):
            return super().evaluate(delta)
        m11 = self.uncertain.delta_channels
        a = m11.A + m11.B @ d @ np.linalg.solve(np.eye(d.shape[1]) - m11.D @ d, m11.C)
        return self._evaluation(np.asarray(np.linalg.eigvals(a), dtype=np.complex128))

    def _evaluation(self, poles: NDArray[np.complex128]) -> Evaluation:
        numbers = self._number(poles)
        return Evaluation(float(self.sense * (self.sense * numbers).max()))

    def slack(self, value: float) -> float:
        """See `Metric.slack`: poles are as accurate as the largest of them."""
        return self.tolerance * max(abs(value), float(np.abs(self.uncertain.nominal.poles()).max()))


class SpectralAbscissa(_OfPoles):
    """Largest real part of the poles in rad/s, or largest modulus minus one for discrete models; negative is stable."""

    def __init__(self, uncertain: UncertainModel) -> None:
        super().__init__(uncertain)
        self.unit = "" if uncertain.dt else "rad/s"

    def _number(self, poles: NDArray[np.complex128]) -> Array:
        return np.abs(poles) - 1.0 if self.uncertain.dt else poles.real


class Damping(_OfPoles):
    r"""Smallest damping ratio :math:`-\mathrm{Re}\,s / |s|` of the poles; negative for an unstable one.

    Of a discrete model ``s = log(z) / dt``. A pole at s = 0 has damping 0.
    """

    sense = -1.0

    def _number(self, poles: NDArray[np.complex128]) -> Array:
        if self.uncertain.dt:
            poles = np.log(np.where(np.abs(poles) > 1e-300, poles, 1e-300))
        size = np.abs(poles)
        return np.where(size > 0, -poles.real / np.where(size > 0, size, 1.0), 0.0)

    def slack(self, value: float) -> float:
        """See `Metric.slack`: a ratio of at most one."""
        return self.tolerance
