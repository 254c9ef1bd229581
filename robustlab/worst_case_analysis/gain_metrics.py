"""Metrics of the input-output gain: H-infinity norm and H2 norm."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robustlab.errors import NoTrustworthyNumber
from robustlab.frequency import default_grid
from robustlab.magnitude import refuse_overflow
from robustlab.statespace import StateSpaceModel
from robustlab.uncertainty.blocks import delta_matrix
from robustlab.uncertainty.lft import UncertainModel
from robustlab.worst_case_analysis.ensemble import Ensemble, members, peak_gains
from robustlab.worst_case_analysis.gramians import gramians, stable_members
from robustlab.worst_case_analysis.metric_contract import (
    Evaluation,
    Metric,
    connected,
    need_real,
    need_stable,
    selected,
)

__all__ = ["H2Gain", "HinfGain"]

Array = NDArray[np.float64]

GRID_POINTS = 48


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

    def slope(self, ensemble: Ensemble) -> tuple[float, Array] | None:
        r"""See `Metric.slope`: at the peak :math:`d\sigma = \mathrm{Re}(u^H dG v)`, and G depends on [A B; C D]."""
        n, n_y, n_u = ensemble.A.shape[1], ensemble.C.shape[1], ensemble.B.shape[2]
        values, peaks = peak_gains(ensemble, self._grid)
        value, omega = float(values[0]), float(peaks[0])
        slope = np.zeros((n + n_y, n + n_u))
        if not np.isfinite(value) or not n_y or not n_u:
            return value, slope
        a, b, c, d = (matrix[0] for matrix in (ensemble.A, ensemble.B, ensemble.C, ensemble.D))
        if np.isinf(omega):
            u, _, vh = np.linalg.svd(d)
            slope[n:, n:] = np.outer(u[:, 0], vh[0])
            return value, slope
        point = np.exp(1j * omega * ensemble.dt) if ensemble.dt else 1j * omega
        inverse = np.linalg.inv(point * np.eye(n) - a)
        with np.errstate(over="ignore", invalid="ignore"):
            response = c @ inverse @ b + d
            refuse_overflow("worst_case", response)
            u, _, vh = np.linalg.svd(response)
            left = u[:, 0].conj() @ np.hstack([c @ inverse, np.eye(n_y)])
            right = np.vstack([inverse @ b, np.eye(n_u)]) @ vh[0].conj()
            slope = np.real(np.outer(left, right))
        refuse_overflow("worst_case", slope)
        return value, slope


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
        good = np.flatnonzero(stable_members(ensemble) & ~direct)
        some = ensemble.part(good)
        reach = gramians(some, "controllability")
        square = np.einsum("kij,kjl,kil->k", some.C, reach, some.C)
        if ensemble.dt:
            square = square + (some.D**2).sum(axis=(1, 2))
        value[good] = np.sqrt(np.maximum(square, 0.0))
        return value

    def of_model(self, model: StateSpaceModel) -> Evaluation:
        """See `Metric.of_model`; `robustlab.norms.h2_norm` is the second way."""
        from robustlab.norms import h2_norm

        norm = h2_norm(model)
        return Evaluation(norm.value, accurate=norm.status.trustworthy, reason=norm.reason)

    def slope(self, ensemble: Ensemble) -> tuple[float, Array] | None:
        r"""See `Metric.slope`: with both Gramians, :math:`d\|G\|^2 = 2 \mathrm{tr}(Q P\,dA^T + Q B\,dB^T + \ldots)`."""
        n = ensemble.A.shape[1]
        slope = np.zeros((n + ensemble.C.shape[1], n + ensemble.B.shape[2]))
        value = float(self.of(ensemble)[0])
        if not 0 < value < np.inf:
            return value, slope
        reach, see = (gramians(ensemble, kind)[0] for kind in ("controllability", "observability"))
        a, b, c, d = (matrix[0] for matrix in (ensemble.A, ensemble.B, ensemble.C, ensemble.D))
        slope[:n, :n] = see @ a @ reach if ensemble.dt else see @ reach
        slope[:n, n:] = see @ b
        slope[n:, :n] = c @ reach
        if ensemble.dt:
            slope[n:, n:] = d
        return value, slope / value
