"""Norms and limits of a controller law on one or several plants as functions of a dimensionless vector."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from robustlab.arrays import AnyArray
from robustlab.budget import Budget, dense
from robustlab.synthesis.laws.controller_laws import Law, Parameter
from robustlab.synthesis.nonsmooth.descent_methods import Piece
from robustlab.synthesis.nonsmooth.design_limits import Limit
from robustlab.synthesis.nonsmooth.loop_family import LoopFamily
from robustlab.synthesis.problem.partition import GeneralizedPlant
from robustlab.synthesis.problem.scaling import common_scaling

INSIDE = 1e-3  # least distance of a start from its bounds, as a share of their range


@dataclass(frozen=True)
class _Coordinate:
    """Map from a search variable to a free parameter within its bounds."""

    parameter: Parameter
    size: float
    logarithmic: bool

    def _range(self) -> tuple[float, float, float]:
        """Return the lower bound, half the range (logarithmic where so searched), and the unit of v."""
        low, high = self.parameter.low, self.parameter.high
        if self.logarithmic:
            low, high = np.log(low), np.log(high)
        half = 0.5 * (high - low)
        return low, half, 1.0 if self.logarithmic else min(self.size / half, 1.0)

    def value(self, v: float) -> tuple[float, float]:
        """Return the parameter and its derivative."""
        q = self.parameter
        if np.isfinite(q.low) and np.isfinite(q.high):
            low, half, scale = self._range()
            p, slope = low + half * (1 + np.sin(v * scale)), half * np.cos(v * scale) * scale
            return (float(np.exp(p)), float(np.exp(p) * slope)) if self.logarithmic else (float(p), float(slope))
        if np.isfinite(q.low) or np.isfinite(q.high):
            root = np.sqrt(1 + v * v)
            p, slope = self.size * (root - 1), self.size * v / root
            return (q.low + p, slope) if np.isfinite(q.low) else (q.high - p, -slope)
        return self.size * v, self.size

    def variable(self, p: float) -> float:
        """Return the search variable of a parameter value."""
        q = self.parameter
        if np.isfinite(q.low) and np.isfinite(q.high):
            low, half, scale = self._range()
            share = ((np.log(p) if self.logarithmic else p) - low) / (2 * half)
            return float(np.arcsin(2 * np.clip(share, INSIDE, 1 - INSIDE) - 1)) / scale
        if np.isfinite(q.low) or np.isfinite(q.high):
            away = max((p - q.low) if np.isfinite(q.low) else (q.high - p), INSIDE * self.size) / self.size
            return float(np.sqrt((1 + away) ** 2 - 1))
        return p / self.size


class DesignProblem:
    """The closed loops of all plants as functions of the search variables v of a law."""

    def __init__(
        self,
        plants: Sequence[GeneralizedPlant],
        law: Law,
        objective: str | Sequence[str],
        limits: Sequence[Limit],
        budget: Budget | None = None,
        limited: Sequence[GeneralizedPlant] = (),
    ) -> None:
        self.budget = Budget() if budget is None else budget
        self.kinds = (objective,) * len(plants) if isinstance(objective, str) else tuple(objective)
        self.plants, self.law, self.objective, self.limits = tuple(plants), law, self.kinds[0], tuple(limits)
        self.dt = plants[0].model.dt
        scalings = common_scaling([*plants, *limited])
        self.scaling = scalings[0]
        k = law.sizes[0]
        rate, u, y = self.scaling.rate, self.scaling.u, self.scaling.y
        self._h2_unit = float(np.sqrt(rate)) if "hinf" in self.kinds else 1.0
        # Theta of the scaled plant is left * Theta * right, entry by entry.
        self._rows = np.concatenate([np.full(k, 1 / rate), 1 / u])[:, None]
        self._columns = np.concatenate([np.ones(k), 1 / y])[None, :]
        families = [
            LoopFamily(s.apply(plant.matrices()), plant.D22 * y[:, None] * u, k, self.dt > 0)
            for s, plant in zip(scalings, [*plants, *limited], strict=True)
        ]
        self.families = families[: len(self.plants)]
        self.limited = families[len(self.plants) :] or self.families
        self._set_coordinates()
        # Measured work of one evaluation: the law, and for every loop its poles and a norm with its gradient.
        self._work = 300 + sum(dense(len(family.A), 2) for family in self.families)

    @property
    def gain(self) -> float:
        """Factor from a norm of the plants to that of the scaled plants."""
        factor = self.scaling.gain
        return factor if "hinf" in self.kinds else factor / np.sqrt(self.scaling.rate)

    def norms(self, p: AnyArray) -> list[float]:
        """Return the norm of every plant's loop in the plants' units; inf where unstable."""
        theta = self.theta(p)
        return [self._one(family, kind, theta, np.inf)[0] / self.gain for family, kind in self._each()]

    def _each(self) -> Iterable[tuple[LoopFamily, str]]:
        return zip(self.families, self.kinds, strict=True)

    def _one(
        self, family: LoopFamily, kind: str, theta: AnyArray, give_up_above: float
    ) -> tuple[float, AnyArray | None]:
        """Return a norm with its gradient; an H2 norm next to H-infinity norms is in their unit of time."""
        if kind == "hinf":
            return family.norm(theta, give_up_above)
        value, G = family.h2_norm(theta)
        return value * self._h2_unit, None if G is None else G * self._h2_unit

    def _set_coordinates(self) -> None:
        everything = self.law.parameters
        start = np.array([np.clip(q.start, q.low, q.high) for q in everything], dtype=float)
        self.fixed = start
        self.free = np.array([j for j, q in enumerate(everything) if q.low < q.high], dtype=int)
        sizes = self._natural_sizes(start)
        self.coordinates: list[_Coordinate] = []
        for j in self.free:
            q = everything[j]
            logarithmic = bool(np.isfinite(q.high) and q.low > 0 and q.high > 10 * q.low)
            self.coordinates.append(_Coordinate(q, float(q.size or sizes[j]), logarithmic))
        self.start = np.array([c.variable(float(start[j])) for c, j in zip(self.coordinates, self.free, strict=True)])
        self.centre = self.start + np.array([everything[j].centre for j in self.free])

    def _natural_sizes(self, p: AnyArray) -> AnyArray:
        """Return the changes of the parameters that change the scaled controller by one."""
        base = self.law.packed(p)
        sizes = np.ones(len(p))
        for j in self.free:
            moved = p.copy()
            moved[j] += (step := max(abs(p[j]), 1.0))
            change = np.linalg.norm((self.law.packed(moved) - base) * self._rows * self._columns) / step
            sizes[j] = 1 / change if np.isfinite(change) and change > 0 else 1.0
        return sizes

    # --- variables, parameters, controllers --------------------------------------------------------------------------

    def parameters(self, v: AnyArray) -> tuple[AnyArray, AnyArray]:
        """Return all parameters, and the derivatives of the free ones with respect to v."""
        pairs = np.array([c.value(x) for c, x in zip(self.coordinates, v, strict=True)]).reshape(-1, 2)
        p = self.fixed.copy()
        p[self.free] = pairs[:, 0]
        return p, pairs[:, 1]

    def variables(self, p: AnyArray) -> AnyArray:
        """Return the search variables of given parameters."""
        return np.array([c.variable(float(p[j])) for c, j in zip(self.coordinates, self.free, strict=True)])

    def theta(self, p: AnyArray) -> AnyArray:
        """Return the packed controller of the scaled plant."""
        return self.law.packed(p) * self._rows * self._columns

    def by_parameters(self, p: AnyArray, G: AnyArray) -> AnyArray:
        """Return the gradient by the free parameters from that by the scaled packed controller."""
        return self.law.pullback(p, G * self._rows * self._columns)[self.free]

    # --- objectives --------------------------------------------------------------------------------------------------

    def instability(self, v: AnyArray) -> tuple[float, AnyArray | None]:
        """Return the largest spectral abscissa of all loops (discrete: modulus minus one) with its gradient."""
        self.budget.spend(self._work)
        p, slopes = self.parameters(v)
        theta = self.theta(p)
        worst, at = -np.inf, np.zeros_like(theta)
        for family in self.families:
            value, G = family.abscissa(theta)
            if G is None:
                return np.inf, None
            worst, at = (value, G) if value > worst else (worst, at)
        return worst, self.by_parameters(p, at) * slopes

    def violation(self, v: AnyArray) -> tuple[float, AnyArray | None]:
        """Return the largest limit value with its gradient; infinite for an unstable loop, -1 without limits."""
        self.budget.spend(self._work)
        p, slopes = self.parameters(v)
        theta = self.theta(p)
        if not all(family.abscissa(theta)[0] < 0 for family in self.families):
            return np.inf, None
        worst, G = max(self.limit_values(theta), key=lambda pair: pair[0], default=(-1.0, np.zeros_like(theta)))
        return worst, self.by_parameters(p, G) * slopes if np.isfinite(worst) else None

    def limit_values(self, theta: AnyArray) -> list[tuple[float, AnyArray]]:
        """Return the c and the gradient of every limit and plant; an infinite c where there is no value."""
        return [limit.evaluate(family, theta, self.scaling, self.dt) for limit, family in self._limited()]

    def broken_limits(self, theta: AnyArray) -> list[Limit]:
        """Return the violated limits, one for each plant."""
        values = zip(self._limited(), self.limit_values(theta), strict=True)
        return [limit for (limit, _), (c, _) in values if c >= 0]

    def _limited(self) -> list[tuple[Limit, LoopFamily]]:
        return [
            (limit, family)
            for limit in self.limits
            for family in (self.limited[:1] if limit.of_controller else self.limited)
        ]

    def norm(self, v: AnyArray, give_up_above: float = np.inf) -> tuple[float, AnyArray | None]:
        """Return the largest norm of the scaled loops with its gradient; infinite where a limit is violated."""
        p, slopes = self.parameters(v)
        value, G = self._norm_at(p, give_up_above)
        return value, None if G is None else self.by_parameters(p, G) * slopes

    def _norm_at(self, p: AnyArray, give_up_above: float) -> tuple[float, AnyArray | None]:
        self.budget.spend(self._work)
        theta = self.theta(p)
        if any(value >= 0 for value, _ in self.limit_values(theta)):
            return np.inf, None
        worst: tuple[float, AnyArray | None] = -np.inf, None
        for family, kind in self._each():
            found = self._one(family, kind, theta, give_up_above)
            if not np.isfinite(found[0]) or found[0] >= give_up_above:
                return found[0], None
            if found[0] > worst[0]:
                worst = found
        return worst

    def _filled(self, q: AnyArray) -> AnyArray:
        """Return all parameters from the free ones."""
        p = self.fixed.copy()
        p[self.free] = q
        return p

    def value_at(self, q: AnyArray) -> float:
        """Return the norm at given free parameters."""
        return self._norm_at(self._filled(q), np.inf)[0]

    def pieces(self, q: AnyArray, value: float, radius: float) -> list[Piece]:
        """Return all peaks near the maximum and all limits near zero as functions of the free parameters."""
        p = self._filled(q)
        self.budget.spend(2 * self._work)
        theta = self.theta(p)
        found: list[tuple[float, AnyArray]] = []
        for family, kind in self._each():
            if kind == "hinf":
                found += family.active(theta, value, 0.1, 0.02 + 0.5 * radius)
            else:
                norm, G = self._one(family, kind, theta, np.inf)
                if G is not None and norm > 0.8 * value:
                    found.append((norm, G))
        pieces = [Piece(f, self.by_parameters(p, G)) for f, G in found]
        for c, G in self.limit_values(theta):
            if np.isfinite(c) and c > -0.5:
                pieces.append(Piece(c, self.by_parameters(p, G), limit=True))
        return pieces

    def barrier(self, z: AnyArray, mu: float) -> tuple[float, AnyArray | None]:
        r"""Return ``ln gamma + mu * (entropies and log barriers)`` at ``z = (v, ln gamma)``, with its gradient."""
        v, log_gamma = z[:-1], float(z[-1])
        if not -300 < log_gamma < 300:
            return np.inf, None
        gamma = float(np.exp(log_gamma))
        self.budget.spend(2 * self._work)
        p, slopes = self.parameters(v)
        theta = self.theta(p)
        total, by_theta, by_gamma = 0.0, np.zeros_like(theta), 0.0
        for c, G in self.limit_values(theta):
            if not c < 0:
                return np.inf, None
            total -= np.log(-c)
            by_theta = by_theta - G / c
        for family, kind in self._each():
            if kind == "hinf":
                found = family.entropy(theta, gamma)
            else:
                found = _h2_barrier(self._one(family, kind, theta, np.inf), gamma)
            if found is None:
                return np.inf, None
            total, by_theta, by_gamma = total + found[0], by_theta + found[1], by_gamma + found[2]
        gradient = np.append(mu * self.by_parameters(p, by_theta) * slopes, 1 + mu * gamma * by_gamma)
        return log_gamma + mu * total, gradient


def _h2_barrier(found: tuple[float, AnyArray | None], gamma: float) -> tuple[float, AnyArray, float] | None:
    """Return ``-ln(1 - h^2/gamma^2)`` of an H2 norm h with its gradients; None where h is not below gamma."""
    norm, G = found
    if G is None or not norm < gamma:
        return None
    slack = (gamma - norm) * (gamma + norm)
    return -np.log(slack / gamma**2), G * (2 * norm / slack), -2 * norm**2 / (slack * gamma)
