r"""Poses that a platform is to follow: a lift, then a sine on every axis.

.. math::
    q(t) = q_0 + \Delta\, e(t / T) + a\, e\bigl((t - T) / T_r\bigr) \sin \omega (t - T), \qquad
    e(s) = 10 s^3 - 15 s^4 + 6 s^5 \text{ on } [0, 1]

The sines start at T; with :math:`T_r = 0` abruptly, that is, with a jump of the velocity.

References
----------
Březina 2010, section 9.1.3: 5 mm and 20 mrad at pi rad/s. How the first 2 s are passed is not printed; a step would ask
for 0.23 N m and 219 V.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from robustlab.dynamics.plant_contract import Array
from robustlab.errors import InputError
from robustlab.statespace import real_array

__all__ = ["SineTrajectory"]


@dataclass(frozen=True, eq=False)
class SineTrajectory:
    """A smooth lift followed by sines about the lifted pose.

    Attributes
    ----------
    start
        Pose (tx, ty, tz, ax, ay, az) at t = 0 in m and rad.
    lift
        Change of the pose during the first stage, (6,).
    amplitude
        Of the sines, (6,), signs included.
    omega
        Of the sines in rad/s.
    lift_time
        Length T of the first stage in s.
    rise_time
        Time T_r in s in which the sines grow to their amplitude; 0: at once.

    Raises
    ------
    InputError
        Wrong lengths, NaN, a lift_time or omega that is not positive, a negative rise_time.
    """

    start: ArrayLike
    lift: ArrayLike = (0.0, 0.0, 5e-3, 0.0, 0.0, 0.0)
    amplitude: ArrayLike = (5e-3, 5e-3, 5e-3, 20e-3, 20e-3, 20e-3)
    omega: float = math.pi
    lift_time: float = 2.0
    rise_time: float = 0.0

    def __post_init__(self) -> None:
        for name in ("start", "lift", "amplitude"):
            vector = real_array(name, getattr(self, name), 1, "trajectory")
            if len(vector) != 6:
                raise InputError("trajectory", f"{name} has {len(vector)} entries", "6")
            object.__setattr__(self, name, vector)
        for name, low in (("omega", "positive"), ("lift_time", "positive"), ("rise_time", "not negative")):
            value = float(real_array(name, getattr(self, name), 0, "trajectory"))
            if value < 0 or (value == 0 and low == "positive"):
                raise InputError(f"trajectory: {name}", f"{value:g}", f"a number that is {low}")

    @property
    def breaks(self) -> tuple[float, ...]:
        """Times in s at which the motion is not smooth."""
        return (0.0, self.lift_time, self.lift_time + self.rise_time)

    def pose(self, t: ArrayLike) -> Array:
        """Pose at the time t in s, (6,), or at the times (n,), (n, 6)."""
        time = np.asarray(t, dtype=np.float64)[..., None]
        since = np.maximum(time - self.lift_time, 0.0)
        share = _ease(since / self.rise_time) if self.rise_time else 1.0
        lifted = np.asarray(self.start) + np.asarray(self.lift) * _ease(time / self.lift_time)
        return lifted + np.asarray(self.amplitude) * share * np.sin(self.omega * since)


def _ease(s: Array) -> Array:
    s = np.clip(s, 0.0, 1.0)
    return s**3 * (10 - 15 * s + 6 * s**2)
