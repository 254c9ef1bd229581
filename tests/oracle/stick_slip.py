"""Coulomb and static friction on one velocity of a linear plant, event by event: judges held inputs alone.

Between two changes the motion is linear, so that matrix exponentials carry it; the time at which the joint begins to
stick or to slide is a root of that motion. Nothing is smoothed, and nothing of the package's stepping takes part.
"""

from functools import cache
from typing import NamedTuple

import numpy as np
from scipy.linalg import expm
from scipy.optimize import brentq

import robustlab as rl
from robustlab.dynamics import LinearPlant


class StickSlip(NamedTuple):
    record: rl.Record
    x: np.ndarray
    force: np.ndarray  # (n,)
    sliding: np.ndarray  # 1, -1 or 0, (n,)


def stick_slip(plant, velocity, coulomb, t, u, *, static=None, inertia=None, x0=None, name="stick-slip"):
    """Response from x0 (at rest) under the held input u (n,); ``inertia``: of a bare model."""
    model = plant.state_space() if isinstance(plant, LinearPlant) else plant
    holding, n = coulomb if static is None else static, model.n_states
    at = list(model.state_names).index(velocity)
    column = np.eye(n)[at] / inertia if inertia else np.linalg.solve(plant.equations(plant.values).E, np.eye(n)[at])

    @cache
    def motion(slide):
        """Matrix of z = (x, u, 1), and the row that reads the friction force, of a joint that slides or sticks (0)."""
        free = np.vstack([np.column_stack([model.A, model.B, np.zeros(n)]), np.zeros((2, n + 2))])
        force = -slide * coulomb * np.eye(n + 2)[-1] if slide else -free[at] / column[at]
        free[:n] += np.outer(column, force)
        return free, force

    step = cache(lambda slide, h: expm(motion(slide)[0] * h))

    def left(slide, z):
        """Return the event function, which stays nonnegative: sliding speed, or reserve of the holding force."""
        return slide * z[at] if slide else holding * (1 + 1e-12) - abs(motion(0)[1] @ z)

    def ahead(s, slide, matrix, z):
        return left(slide, expm(matrix * s) @ z)

    def settled(z):
        """The direction in which a joint at rest begins to move; 0 where the friction holds it."""
        need = motion(0)[1] @ z
        return 0 if abs(need) <= holding * (1 + 1e-12) else -int(np.sign(need))

    t, u = np.asarray(t, float), np.asarray(u, float)
    z = np.r_[np.zeros(n) if x0 is None else x0, u[0], 1.0]
    x, force, sliding = np.empty((len(t), n)), np.empty(len(t)), np.empty(len(t), int)
    slide = int(np.sign(z[at])) or settled(z)
    for k in range(len(t)):
        z[n] = u[k]
        slide = slide or settled(z)
        x[k], force[k], sliding[k] = z[:n], motion(slide)[1] @ z, slide
        rest = round(t[k + 1] - t[k], 12) if k + 1 < len(t) else 0.0
        while rest > 0:
            after = step(slide, rest) @ z
            if left(slide, after) >= 0:
                z, rest = after, 0.0
                continue
            # a joint that has just begun to move is slow and not yet back: its root is looked for from there on
            matrix, first = motion(slide)[0], 1e-9 * rest
            if left(slide, expm(matrix * first) @ z) < 0:
                first = 0.0
            else:
                first = brentq(ahead, first, rest, (slide, matrix, z), xtol=1e-16)
            z, rest = expm(matrix * first) @ z, rest - first
            z[at] = 0.0
            slide = settled(z) if slide else -int(np.sign(motion(0)[1] @ z))
    y = x @ model.C.T + u[:, None] @ model.D.T
    units = {s.name: s.unit for s in (*model.inputs, *model.outputs)}
    record = rl.Record(t, {model.inputs[0].name: u}, dict(zip(model.output_names, y.T, strict=True)), units, name)
    return StickSlip(record, x, force, sliding)
