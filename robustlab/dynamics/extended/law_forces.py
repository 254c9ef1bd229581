r"""A force law seen at one instant: its force at a velocity, its band at rest, its slopes.

The laws answer for the end of a step (`robustlab.dynamics.ports.law_kernel`). Here they are asked for the step in
which the velocity does not change: with the compliance g and the velocity :math:`v - g f` without the law's force, the
one that brings about v itself is f, a fixed point that does not depend on g or on the length of the step. They are
asked outside of time (`ANY_TIME`), where a force that only depends on it answers with its mean.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from robustlab.arrays import Array
from robustlab.dynamics.effects.contract import Law
from robustlab.dynamics.tuning import TUNING

__all__ = ["extrapolated", "holding_force", "is_set_valued", "rest_band", "slopes", "steady_force"]

ANY_TIME = math.inf


def _asked(law: Law, seen: list[float], z: Array) -> tuple[float, Array]:
    """Force and memory that the law answers with; ``seen`` in the order of the kernel."""
    after = z.copy()
    with np.errstate(divide="ignore", invalid="ignore"):
        parameters = np.array(law.parameters, dtype=np.float64)
        force = float(law.function(parameters, z, after, np.array(seen, dtype=np.float64)))
    return force, after


def steady_force(law: Law, q: float, v: float) -> float:
    """Force at the position q while the port moves at the constant velocity ``v != 0``, memory settled."""
    force, z, h = 0.0, np.zeros(max(1, law.memory)), TUNING.instant
    g = 1e-12 * abs(v)
    for _ in range(TUNING.force_passes):
        half = 0.0 if law.memory else 0.5 * v * h
        gq = 0.5 * g * h
        found, z = _asked(law, [q - half, v, q + half - gq * force, v - g * force, gq, g, h, ANY_TIME], z)
        settled = abs(found - force) <= TUNING.force_agreed * abs(found) and (not law.memory or h > 1e3)
        force = found
        if settled:
            break
        g = TUNING.compliance_share * abs(v) / max(abs(force), 1e-30)
        h = 4.0 * h if law.memory else h
    return force


def rest_band(law: Law, q: float) -> tuple[float, float]:
    """Smallest and largest force with which the law may hold its port at rest at the position q."""
    forward, backward = steady_force(law, q, TUNING.creep), steady_force(law, q, -TUNING.creep)
    return min(forward, backward), max(forward, backward)


def is_set_valued(law: Law, q: float) -> bool:
    """True where the force jumps with the direction of motion: the band at rest does not shrink with the speed."""
    if law.memory:
        return False
    low, high = rest_band(law, q)
    slower = abs(steady_force(law, q, -1e-2 * TUNING.creep) - steady_force(law, q, 1e-2 * TUNING.creep))
    return high > low and slower > 0.5 * (high - low)


def holding_force(law: Law, q: float, acceleration: float, mobility: float) -> float:
    """Force at a port at rest: the one that keeps it there if the law has it, else that of the motion that begins.

    Parameters
    ----------
    acceleration
        Of the port without this force.
    mobility
        Acceleration per unit of the force.
    """
    h = TUNING.instant
    seen = [q, 0.0, q, h * acceleration, 0.0, h * mobility, h, ANY_TIME]
    return _asked(law, seen, np.zeros(max(1, law.memory)))[0]


def slopes(law: Law, q: float, v: float) -> tuple[float, float]:
    r"""``(df/dq, df/dv)`` at a position and velocity, by central differences of the law's force.

    Compiled laws have no complex step. In position and at a velocity other than zero the differences are extrapolated
    (Ridders), exact for polynomials to about ten digits; at rest the difference over ``+-1e-6`` is taken, so that a
    drag :math:`c v |v|` has the slope ``1e-6 c`` and not zero. A law with memory has at rest the slopes of its
    presliding.

    References
    ----------
    Ridders, "Accurate computation of F'(x) and F'(x)F''(x)", Advances in Engineering Software 4 (1982).
    """

    def at(position: float, velocity: float) -> float:
        if velocity == 0.0:
            return sum(rest_band(law, position)) / 2.0
        return steady_force(law, position, velocity)

    def by_velocity(step: float) -> float:
        return (at(q, v + step) - at(q, v - step)) / (2.0 * step)

    def by_position(step: float) -> float:
        return (at(q + step, v) - at(q - step, v)) / (2.0 * step)

    if law.memory and v == 0.0:
        return _presliding(law, q)
    damping = by_velocity(TUNING.rest_step) if v == 0.0 else extrapolated(by_velocity, TUNING.velocity_step * abs(v))
    return extrapolated(by_position, TUNING.position_step), damping


def _presliding(law: Law, q: float) -> tuple[float, float]:
    """The same for a law with memory at rest: what resists two displacements far below sliding, slow and quick.

    From one to the next the force grows by the stiffness, be it that of the mean over the way or that of its end.
    """

    def resisting(h: float, z: Array) -> tuple[float, Array]:
        v, force, after = TUNING.displacement / h, 0.0, z
        for _ in range(TUNING.force_passes):
            g = TUNING.compliance_share * v / max(abs(force), 1e-30)
            found, after = _asked(law, [q, v, q, v - g * force, 0.0, g, h, ANY_TIME], z)
            if abs(found - force) <= TUNING.force_agreed * abs(found):
                break
            force = found
        return force, after

    still = np.zeros(max(1, law.memory))
    slow, displaced = resisting(TUNING.slow, still)
    further, _ = resisting(TUNING.slow, displaced)
    quick, _ = resisting(TUNING.quick, still)
    return (further - slow) / TUNING.displacement, (quick - slow) * TUNING.quick / TUNING.displacement


def extrapolated(difference: Callable[[float], float], step: float) -> float:
    """Limit of a central difference with the step, by the row of Ridders' table with the smallest error."""
    row = [difference(step)]
    best, error = row[0], np.inf
    for level in range(1, TUNING.levels):
        step /= TUNING.shrink
        next_row, factor = [difference(step)], TUNING.shrink**2
        for k in range(level):
            next_row.append((next_row[k] * factor - row[k]) / (factor - 1.0))
            factor *= TUNING.shrink**2
            found = max(abs(next_row[k + 1] - next_row[k]), abs(next_row[k + 1] - row[k]))
            if found <= error:
                best, error = next_row[k + 1], found
        if abs(next_row[-1] - row[-1]) >= 2.0 * error:
            break
        row = next_row
    return float(best)
