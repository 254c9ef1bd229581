"""Metrics of the model itself, whatever drives it: norms (H-infinity, H2), poles, reach, Hankel singular values.

The last two are of Gramians, made for many members at once: on a finite horizon by doubling a Taylor series, on the
infinite one by the squared Smith iteration.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from robustlab.arrays import Array
from robustlab.errors import InputError, NoTrustworthyNumber
from robustlab.linear_analysis.frequency import default_grid
from robustlab.linear_analysis.magnitude import refuse_overflow
from robustlab.statespace import StateSpaceModel, real_array
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
from robustlab.worst_case_analysis.sensitivity import pole_slope
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

    ``duration``: T in s.
    ``norm``: size of A in 1/s, which decides the first step: one for all members of a set.
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
        from robustlab.linear_analysis.matrix_equations import lyapunov

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


class HinfGain(Metric):
    """H-infinity norm of the members from all or one input to all or one output; ``inf`` where unstable."""

    location = "omega [rad/s]"
    one_sided = True

    def __init__(self, uncertain: UncertainModel, input: str | None, output: str | None) -> None:
        self.uncertain = connected(selected(uncertain, input, output))
        nominal = self.uncertain.nominal
        need_stable(nominal, "its H-infinity norm is infinite")
        self._grid = default_grid(nominal, TUNING.grid_points)

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
        good = np.flatnonzero(ensemble.is_stable() & ~direct)
        some = ensemble.part(good)
        reach = gramians(some, "controllability")
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
