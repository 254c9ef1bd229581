"""Metrics of the poles: spectral abscissa and damping."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robustlab.errors import InputError
from robustlab.statespace import StateSpaceModel
from robustlab.uncertainty.blocks import delta_matrix
from robustlab.uncertainty.lft import UncertainModel
from robustlab.worst_case_analysis.ensemble import Ensemble, chunks, members
from robustlab.worst_case_analysis.metric_contract import Evaluation, Metric
from robustlab.worst_case_analysis.sensitivity import pole_slope

__all__ = ["Damping", "SpectralAbscissa"]

Array = NDArray[np.float64]


class _OfPoles(Metric):
    """What metrics of the poles share: states, and the number of a pole."""

    def __init__(self, uncertain: UncertainModel) -> None:
        if not uncertain.M.n_states:
            raise InputError("worst_case", "a model without states", "states: a static gain has no poles")
        self.uncertain = uncertain

    def _number(self, poles: NDArray[np.complex128]) -> Array:
        """What is judged of each pole."""
        raise NotImplementedError

    def _pole_derivative(self, pole: complex) -> complex:
        """``g`` with ``dv = Re(conj(g) dlambda)``."""
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

    def slope(self, ensemble: Ensemble) -> tuple[float, Array] | None:
        """See `Metric.slope`."""
        a = ensemble.A[0]
        n, (rows, columns) = len(a), (len(a) + ensemble.C.shape[1], len(a) + ensemble.B.shape[2])
        numbers = self._number(np.linalg.eigvals(a).astype(complex))
        index = int(np.argmax(self.sense * numbers))
        pole, derivative = pole_slope(a, index)
        result = np.zeros((rows, columns))
        if np.isfinite(derivative).all():
            result[:n, :n] = np.real(np.conj(self._pole_derivative(pole)) * derivative)
        return float(numbers[index]), result

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

    def _pole_derivative(self, pole: complex) -> complex:
        return pole / max(abs(pole), 1e-300) if self.uncertain.dt else 1.0


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

    def _pole_derivative(self, pole: complex) -> complex:
        s, chain = pole, 1.0 + 0j
        if self.uncertain.dt:
            s, chain = complex(np.log(pole)), 1.0 / pole
        size = abs(s)
        if size == 0:
            return 0.0
        # dzeta = (-w^2 dsigma + sigma w dw) / |s|^3 = Re(conj(g) ds), and ds = chain dlambda.
        g = complex(-(s.imag**2), s.real * s.imag) / size**3
        return complex(np.conj(np.conj(g) * chain))

    def slack(self, value: float) -> float:
        """See `Metric.slack`: a ratio of at most one."""
        return self.tolerance
