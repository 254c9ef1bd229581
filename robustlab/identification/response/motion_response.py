r"""A nonlinear plant's response to a record in windows, linear about the recorded motion."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from robustlab.arrays import Array, Indices
from robustlab.dynamics.plant_contract import NonlinearPlant
from robustlab.dynamics.ports.motion_model import Course, exponentials, motion_model
from robustlab.errors import NoTrustworthyNumber
from robustlab.identification.response.response import Stretch
from robustlab.identification.response.windowed_simulation import AT_ONCE, WindowResponses

STEPS = 2  # per sample: the motion's curvature within a sample is then far below the deviations from it


@dataclass(frozen=True, eq=False)
class MotionResponse:
    """A nonlinear plant about the motion of one record."""

    course: Course  # the motion
    columns: tuple[int, ...]  # index of each compared output among the plant's
    whole: Stretch  # the compared signals; its weight is one over the noise of each sensor

    together: ClassVar[bool] = True

    @property
    def plant(self) -> NonlinearPlant:
        return self.course.plant

    @property
    def state_names(self) -> tuple[str, ...]:
        return tuple(s.name for s in self.plant.states)

    def responses(
        self, starts: Sequence[int] | Indices, length: int, added: Array | None = None
    ) -> Iterator[WindowResponses]:
        """Simulate windows of ``length`` samples in batches.

        ``added``: forces at the joints, or at the inputs of a plant without joints, (n, n_forces).
        """
        n_x, n_d = len(self.plant.states), 0 if added is None else added.shape[1]
        size = length * (len(self.columns) * (1 + n_x + n_d) + STEPS * n_x * (2 * n_x + n_d))
        count = max(1, AT_ONCE // size)
        for k in range(0, len(starts), count):
            yield self._responses(np.asarray(starts[k : k + count], dtype=np.int64), length, added)

    def _responses(self, starts: Indices, length: int, added: Array | None) -> WindowResponses:
        dt, n_x, n_u = self.course.dt, len(self.plant.states), self.course.u.shape[1]
        added = np.zeros((len(self.course.u), 0)) if added is None else added
        n_d = added.shape[1]
        about = motion_model(self.course, {}, starts, length, STEPS)
        phi, psi, _ = exponentials(np.ascontiguousarray(about.model.A), dt / STEPS)
        b, columns = about.model.B[..., :n_u], list(self.columns)
        joints = [p.force for p in about.model.ports.values() if p.kind == "joint"]
        driven, forced = psi @ b, psi @ (np.stack(joints, axis=-1) if joints else b)[..., :n_d]
        steps = about.steps.reshape(len(starts), -1)
        rates = about.rates.reshape(*steps.shape, n_x)
        points = about.points.reshape(len(starts), -1)
        c, d = about.model.C[:, columns], about.model.D[:, columns]
        offsets = about.offsets[:, columns].reshape(len(starts), length, len(columns))
        found = np.empty((len(starts), length, len(columns), 1 + n_x + n_d))
        # Columns: the window itself, a unit of each state at the start, each force.
        x = np.zeros((len(starts), n_x, 1 + n_x + n_d))
        x[:, :, 0], x[:, :, 1 : 1 + n_x] = self.course.x[starts], np.eye(n_x)
        for k in range(length):
            u, force = self.course.u[starts + k], added[starts + k]
            at = points[:, k]
            found[:, k] = c[at] @ x
            found[:, k, :, 0] += offsets[:, k] + (d[at] @ u[..., None])[..., 0]
            for step in range(k * STEPS, (k + 1) * STEPS):
                own = steps[:, step]
                x = phi[own] @ x
                x[:, :, 0] += (driven[own] @ u[..., None] + psi[own] @ rates[:, step, :, None])[..., 0]
                x[:, :, 1 + n_x :] += forced[own] * force[:, None]
        if not np.isfinite(found).all():
            name = self.plant.name
            raise NoTrustworthyNumber(f"compare {name}", "a window's simulation overflows", None, "shorter windows")
        return WindowResponses(
            starts, found[..., 0], self.course.x[starts], found[..., 1 : 1 + n_x], found[..., 1 + n_x :]
        )
