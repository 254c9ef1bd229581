"""What a search minimises: norms of loops under limits, as functions of a dimensionless vector."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import ClassVar

import numpy as np

from robustlab.arrays import AnyArray
from robustlab.budget import Budget, dense
from robustlab.checks import number
from robustlab.norms import linf_norm
from robustlab.statespace import StateSpaceModel
from robustlab.synthesis.problem.partition import GeneralizedPlant, Realisation
from robustlab.synthesis.problem.scaling import Scaling, common_scaling
from robustlab.synthesis.structures.laws import Law, unpacked
from robustlab.synthesis.structures.loops import LoopFamily, Valued, extreme_pole

INSIDE = 1e-3  # least distance of a start from its bounds, as a share of their range

LimitAt = tuple[float, AnyArray]  # the c of a limit for a packed controller, with its gradient


# --- limits -----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Limit:
    """Base of all limits: a dimensionless c that must be negative, -1 far inside.

    Poles s are in rad/s, of a sampled loop ``log(z)/dt``.
    """

    of_controller: ClassVar[bool] = False  # True for a limit of the controller alone, with one value for all plants
    words: ClassVar[str]

    def __post_init__(self) -> None:
        for field in fields(self):
            where, most = (
                f"fixed structure: {type(self).__name__}: {field.name}",
                1 if field.name == "ratio" else np.inf,
            )
            number(where, getattr(self, field.name), above=0, at_most=most)

    @property
    def text(self) -> str:
        """The limit in words."""
        return self.words.format(**vars(self))

    def value(self, plant_loop: StateSpaceModel, K: StateSpaceModel) -> float:
        """Return the c of a finished design; negative or zero where the limit is kept."""
        raise NotImplementedError

    def evaluate(self, family: LoopFamily, theta: AnyArray, scaling: Scaling, dt: float) -> LimitAt:
        """Return the c and its gradient by the packed controller of the scaled plant; infinite without a value."""
        raise NotImplementedError


def _continuous_poles(poles: AnyArray, dt: float) -> AnyArray:
    """Return poles in rad/s, ``log(z)/dt`` for a sampled loop."""
    return np.log(np.where(poles == 0, 1e-300, poles).astype(complex)) / dt if dt else poles


@dataclass(frozen=True)
class _PoleLimit(Limit):
    """A limit of every pole of the loop."""

    def measure(self, s: AnyArray) -> tuple[AnyArray, AnyArray]:
        """Return the c of poles s, and the w with ``dc = Re(w ds)``."""
        raise NotImplementedError

    def value(self, plant_loop: StateSpaceModel, K: StateSpaceModel) -> float:
        poles = plant_loop.poles()
        return float(self.measure(_continuous_poles(poles, plant_loop.dt))[0].max(initial=-1.0))

    def evaluate(self, family: LoopFamily, theta: AnyArray, scaling: Scaling, dt: float) -> LimitAt:
        unit = 1.0 if dt else scaling.rate
        found = family.pole(theta, lambda poles: self.measure(_continuous_poles(unit * poles, dt))[0])
        if found is None:
            return np.inf, np.zeros_like(theta)
        pole, G = found
        c, w = self.measure(_continuous_poles(np.array([unit * pole]), dt))
        return float(c[0]), np.real(w[0] * (1 / (pole * dt) if dt and pole else unit) * G)


@dataclass(frozen=True)
class Decay(_PoleLimit):
    """Every mode of the loop decays at least as ``exp(-rate t)``; rate in 1/s."""

    rate: float
    words = "decay rate >= {rate:g} 1/s"

    def measure(self, s: AnyArray) -> tuple[AnyArray, AnyArray]:
        return np.real(s) / self.rate + 1, np.full(len(s), 1 / self.rate)


@dataclass(frozen=True)
class Damping(_PoleLimit):
    """Every mode of the loop has at least this damping ratio (0 to 1)."""

    ratio: float
    words = "damping >= {ratio:g}"

    def measure(self, s: AnyArray) -> tuple[AnyArray, AnyArray]:
        size = np.maximum(np.abs(s), 1e-300)
        return self.ratio + np.real(s) / size, 1 / size - np.real(s) * np.conj(s) / size**3


@dataclass(frozen=True)
class Bandwidth(_PoleLimit):
    """No pole of the loop has a modulus above this frequency in rad/s."""

    frequency: float
    words = "poles within {frequency:g} rad/s"

    def measure(self, s: AnyArray) -> tuple[AnyArray, AnyArray]:
        size = np.maximum(np.abs(s), 1e-300)
        return np.abs(s) / self.frequency - 1, np.conj(s) / (size * self.frequency)


@dataclass(frozen=True)
class StableController(Limit):
    """The controller itself is stable (integrators are not)."""

    of_controller = True
    words = "controller stable"

    def value(self, plant_loop: StateSpaceModel, K: StateSpaceModel) -> float:
        return K.spectral_abscissa() if K.n_states else -1.0

    def evaluate(self, family: LoopFamily, theta: AnyArray, scaling: Scaling, dt: float) -> LimitAt:
        k, G = family.order, np.zeros_like(theta)
        if not k:
            return -1.0, G
        if not np.isfinite(theta).all():
            return np.inf, G
        at, u, v = extreme_pole(theta[:k, :k], np.abs if dt else np.real)
        size, by = max(abs(at), 1e-300), np.outer(u, v)
        G[:k, :k] = np.real(by * np.conj(at) / size) if dt else np.real(by)
        return float(size - 1 if dt else at.real), G


@dataclass(frozen=True)
class RollOff(Limit):
    """The controller's gain is at most ``gain`` at and above ``frequency`` (rad/s), in the plant's units."""

    of_controller = True
    words = "controller gain <= {gain:g} from {frequency:g} rad/s on"
    frequency: float
    gain: float

    def value(self, plant_loop: StateSpaceModel, K: StateSpaceModel) -> float:
        return self._peak(Realisation.of(K), self.frequency, K.dt)[0] / self.gain - 1

    def _peak(self, K: Realisation, frequency: float, dt: float) -> tuple[float, float]:
        """Return the proved largest gain from this frequency on, and its frequency."""
        if not all(np.isfinite(m).all() for m in K):
            return np.inf, np.nan
        last = np.pi / dt if dt else np.inf
        found = linf_norm(StateSpaceModel(*K, dt), 1e-9, band=(min(frequency, (1 - 1e-9) * last), last))
        return found.upper, found.frequency

    def evaluate(self, family: LoopFamily, theta: AnyArray, scaling: Scaling, dt: float) -> LimitAt:
        # In the units of the plant's signals, but in the scaled plant's time.
        k, ones = family.order, np.ones(family.order)
        back = np.append(ones, scaling.u)[:, None] * np.append(ones, scaling.y)
        K = Realisation(*unpacked(theta * back, k))
        value, omega = self._peak(K, self.frequency if dt else self.frequency / scaling.rate, dt)
        if not np.isfinite(value):
            return np.inf, np.zeros_like(theta)
        gain, row, column = K.D, np.zeros((k, K.D.shape[0])), np.zeros((k, K.D.shape[1]))
        if k and np.isfinite(omega):
            shifted = (np.exp(1j * omega * dt) if dt else 1j * omega) * np.eye(k) - K.A
            row, column = np.linalg.solve(shifted.T, K.C.T + 0j), np.linalg.solve(shifted, K.B + 0j)
            gain = K.C @ column + K.D
        left, _, right = np.linalg.svd(gain)
        u, v = left[:, 0].conj(), right[0].conj()
        by_theta = np.outer(np.append(row @ u, u), np.append(column @ v, v))
        return value / self.gain - 1, np.real(by_theta) / self.gain * back


# --- the problem ------------------------------------------------------------------------------------------------------


Piece = tuple[float, AnyArray, bool]  # an active function: value, gradient by the free parameters, whether a limit


class DesignProblem:
    """The closed loops of all plants as functions of the search variables v of a law.

    ``objective`` is the norm of every plant's loop, or one for all; ``limited`` are plants of whose loops the limits
    hold instead.
    """

    def __init__(
        self,
        plants: Sequence[GeneralizedPlant],
        law: Law,
        objective: str | Sequence[str],
        limits: Sequence[Limit],
        budget: Budget,
        limited: Sequence[GeneralizedPlant] = (),
    ) -> None:
        self.budget = budget
        self.kinds = (objective,) * len(plants) if isinstance(objective, str) else tuple(objective)
        self.plants, self.law, self.objective, self.limits = tuple(plants), law, self.kinds[0], tuple(limits)
        self.dt = plants[0].model.dt
        scalings = common_scaling([*plants, *limited])
        self.scaling = scalings[0]
        k = law.sizes[0]
        rate, u, y = self.scaling.rate, self.scaling.u, self.scaling.y
        # Norms of the scaled plants; an H2 norm next to H-infinity norms is in their unit of time.
        self._h2_unit = float(np.sqrt(rate)) if "hinf" in self.kinds else 1.0
        self.gain = self.scaling.gain if "hinf" in self.kinds else self.scaling.gain / np.sqrt(rate)
        # Theta of the scaled plant is that of the law, entry by entry times this.
        self._scale = np.concatenate([np.full(k, 1 / rate), 1 / u])[:, None] * np.concatenate([np.ones(k), 1 / y])
        families = [
            LoopFamily(s.apply(plant.matrices()), plant.D22 * y[:, None] * u, k, self.dt > 0)
            for s, plant in zip(scalings, [*plants, *limited], strict=True)
        ]
        self.families = families[: len(self.plants)]
        self._each = list(zip(self.families, self.kinds, strict=True))
        self.limited = [
            (limit, family)
            for limit in limits
            for family in (families[len(self.plants) :] or families)[: 1 if limit.of_controller else None]
        ]
        self._set_coordinates()
        # Measured work of one evaluation: the law, and for every loop its poles and a norm with its gradient.
        self._work = 300 + sum(dense(len(family.A), 2) for family in self.families)

    def _set_coordinates(self) -> None:
        everything = self.law.parameters
        low, high, start, centre = np.array([(q.low, q.high, q.start, q.centre) for q in everything]).reshape(-1, 4).T
        self.fixed = np.clip(start, low, high)
        self.free = np.flatnonzero(low < high)
        self.low, self.high, self.centred = low[self.free], high[self.free], centre[self.free] != 0
        # A change of one in v changes the scaled controller by one.
        steep = self.law.steepness(self.fixed, self._scale)[self.free]
        self._size = 1 / np.where((steep > 0) & np.isfinite(steep), steep, 1.0)
        self._above, self._below = np.isfinite(self.low), np.isfinite(self.high)
        self._both = self._above & self._below
        self.logarithmic = self._both & (self.low > 0) & (self.high > 10 * self.low)
        first, last = np.where(self._both, self.low, 0.0), np.where(self._both, self.high, 2.0)
        for end in (first, last):
            end[self.logarithmic] = np.log(end[self.logarithmic])
        self._first, self._half = first, 0.5 * (last - first)
        self._unit = np.where(self.logarithmic, 1.0, np.minimum(self._size / self._half, 1.0))
        self.start = self.variables(self.fixed)
        self.centre = self.start + centre[self.free]

    # --- variables, parameters, controllers --------------------------------------------------------------------------

    def parameters(self, v: AnyArray) -> tuple[AnyArray, AnyArray]:
        """Return all parameters, and the derivatives of the free ones with respect to v.

        Between two bounds a parameter, or its logarithm, is a sine of v; above or below one it is a hyperbola.
        """
        angle, root = v * self._unit, np.sqrt(1 + v * v)
        inside, by_inside = self._first + self._half * (1 + np.sin(angle)), self._half * np.cos(angle) * self._unit
        powers = np.exp(inside, where=self.logarithmic, out=np.ones_like(inside))
        inside, by_inside = np.where(self.logarithmic, powers, inside), by_inside * powers
        away, by_away = self._size * (root - 1), self._size * v / root
        kinds = [self._both, self._above, self._below]
        p = self.fixed.copy()
        p[self.free] = np.select(kinds, [inside, self.low + away, self.high - away], self._size * v)
        return p, np.select(kinds, [by_inside, by_away, -by_away], self._size)

    def variables(self, p: AnyArray) -> AnyArray:
        """Return the search variables of given parameters, those at a bound a little inside."""
        q = p[self.free]
        inside = np.log(q, where=self.logarithmic, out=q.copy()) - self._first
        share = np.clip(inside / (2 * self._half), INSIDE, 1 - INSIDE)
        away = np.maximum(np.where(self._above, q - self.low, self.high - q) / self._size, INSIDE)
        hyperbola = np.sqrt((1 + away) ** 2 - 1)
        kinds = [self._both, self._above | self._below]
        return np.select(kinds, [np.arcsin(2 * share - 1) / self._unit, hyperbola], q / self._size)

    def filled(self, q: AnyArray) -> AnyArray:
        """Return all parameters from the free ones."""
        p = self.fixed.copy()
        p[self.free] = q
        return p

    def theta(self, p: AnyArray) -> AnyArray:
        """Return the packed controller of the scaled plant."""
        return self.law.packed(p) * self._scale

    def by_parameters(self, p: AnyArray, G: AnyArray) -> AnyArray:
        """Return the gradient by the free parameters from that by the scaled packed controller."""
        return self.law.pullback(p, G * self._scale)[self.free]

    # --- objectives --------------------------------------------------------------------------------------------------

    def instability(self, v: AnyArray, _: float = np.inf) -> Valued:
        """Return the largest spectral abscissa of all loops (discrete: modulus minus one) with its gradient."""
        p, slopes, theta = self._at(v)
        value, G = max((family.abscissa(theta) for family in self.families), key=lambda found: found[0])
        return value, None if G is None else self.by_parameters(p, G) * slopes

    def violation(self, v: AnyArray, _: float = np.inf) -> Valued:
        """Return the largest limit value with its gradient; infinite for an unstable loop."""
        p, slopes, theta = self._at(v)
        if not all(family.abscissa(theta)[0] < 0 for family in self.families):
            return np.inf, None
        worst, G = max(self.limit_values(theta), key=lambda pair: pair[0])
        return worst, self.by_parameters(p, G) * slopes if np.isfinite(worst) else None

    def _at(self, v: AnyArray) -> tuple[AnyArray, AnyArray, AnyArray]:
        self.budget.spend(self._work)
        p, slopes = self.parameters(v)
        return p, slopes, self.theta(p)

    def limit_values(self, theta: AnyArray) -> list[LimitAt]:
        """Return the c and the gradient of every limit and plant; an infinite c where there is no value."""
        return [limit.evaluate(family, theta, self.scaling, self.dt) for limit, family in self.limited]

    def norms(self, p: AnyArray) -> list[float]:
        """Return the norm of every plant's loop in the plants' units; inf where unstable."""
        theta = self.theta(p)
        return [self._one(family, kind, theta, np.inf)[0] / self.gain for family, kind in self._each]

    def norm(self, v: AnyArray, give_up_above: float = np.inf, mu: float = 0.0) -> Valued:
        """Return the largest norm of the scaled loops, or, with mu, its logarithm and a barrier of the limits.

        The barrier is the sum of all ``-mu ln(-c)``; the value is infinite where a limit is violated.
        """
        p, slopes = self.parameters(v)
        value, G = self._norm_at(p, np.exp(give_up_above) if mu and give_up_above < 300 else give_up_above, mu)
        if mu:
            value, G = float(np.log(max(value, 1e-300))), None if G is None else G / max(value, 1e-300)
        return value, None if G is None else self.by_parameters(p, G) * slopes

    def value_at(self, q: AnyArray) -> float:
        """Return the norm at given free parameters."""
        return self._norm_at(self.filled(q), np.inf, 0.0)[0]

    def _norm_at(self, p: AnyArray, give_up_above: float, mu: float) -> Valued:
        self.budget.spend(self._work)
        theta = self.theta(p)
        limits = self.limit_values(theta)
        if not all(c < 0 for c, _ in limits):
            return np.inf, None
        barrier = float(np.prod([(-c) ** -mu for c, _ in limits]))
        worst: Valued = -np.inf, None
        for family, kind in self._each:
            found = self._one(family, kind, theta, give_up_above / barrier)
            if not np.isfinite(found[0]) or found[0] * barrier >= give_up_above:
                return found[0] * barrier, None
            worst = max(worst, found, key=lambda pair: pair[0])
        value, G = worst
        if G is not None and mu:
            G = barrier * (G - mu * value * sum(by / c for c, by in limits))
        return value * barrier, G

    def _one(self, family: LoopFamily, kind: str, theta: AnyArray, give_up_above: float) -> Valued:
        """Return a norm with its gradient."""
        if kind == "hinf":
            return family.norm(theta, give_up_above)
        value, G = family.h2_norm(theta)
        return value * self._h2_unit, None if G is None else G * self._h2_unit

    def pieces(self, q: AnyArray, value: float, radius: float) -> list[Piece]:
        """Return all peaks near the maximum and all limits near zero as functions of the free parameters."""
        p = self.filled(q)
        self.budget.spend(2 * self._work)
        theta = self.theta(p)
        found: list[tuple[float, AnyArray]] = []
        for family, kind in self._each:
            if kind == "hinf":
                found += family.active(theta, value, 0.1, 0.02 + 0.5 * radius)
            else:
                norm, G = self._one(family, kind, theta, np.inf)
                found += [(norm, G)] if G is not None and norm > 0.8 * value else []
        near = [(c, G) for c, G in self.limit_values(theta) if np.isfinite(c) and c > -0.5]
        both = [(f, G, False) for f, G in found] + [(c, G, True) for c, G in near]
        return [(f, self.by_parameters(p, G), limit) for f, G, limit in both]
