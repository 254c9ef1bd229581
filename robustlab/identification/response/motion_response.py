r"""A nonlinear plant's response to a record in windows, linear about the recorded motion; all windows side by side."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from robustlab.arrays import Array, Indices
from robustlab.dynamics.plant_contract import NonlinearPlant
from robustlab.dynamics.ports.motion_model import Course, exponentials, motion_model
from robustlab.errors import NoTrustworthyNumber
from robustlab.identification.response.response import Stretch
from robustlab.identification.response.windowed_simulation import (
    FitOfWindows,
    InitialState,
    StateFit,
    WindowedSimulation,
    consistent_start,
    fit_starts,
    recursive_residual,
    window_edges,
)

STEPS = 2  # a sample: the motion's curvature within a sample is then far below what deviates from it
AT_ONCE = 4_000_000  # numbers in the responses of the windows that go side by side: bounds the memory
SHORTEST_START = 20  # samples


@dataclass(frozen=True, eq=False)
class WindowResponses:
    """Responses in windows of one length that start at the samples ``starts`` (n_windows,)."""

    starts: Indices
    y: Array  # outputs from ``x0``, (n_windows, length, n_y)
    x0: Array  # the motion's states at the starts, (n_windows, n_x)
    free: Array  # outputs per unit more of each state at the start, (n_windows, length, n_y, n_x)
    pushed: Array  # outputs by each of the added forces alone, (n_windows, length, n_y, n_forces)


@dataclass(frozen=True, eq=False)
class MotionResponse:
    """A nonlinear plant about the motion of one record."""

    course: Course  # the motion
    columns: tuple[int, ...]  # index of each compared output among the plant's
    whole: Stretch  # the compared signals; its weight is one over the noise of each sensor

    @property
    def plant(self) -> NonlinearPlant:
        """The plant."""
        return self.course.plant

    @property
    def n_states(self) -> int:
        """Number of states n_x."""
        return len(self.plant.states)

    def responses(
        self, starts: Sequence[int] | Indices, length: int, added: Array | None = None
    ) -> Iterator[WindowResponses]:
        """Windows of ``length`` samples, as many side by side as the memory takes.

        ``added``: forces at the joints, or at the inputs of a plant without joints, (n, n_forces).
        """
        n_x, n_d = self.n_states, 0 if added is None else added.shape[1]
        size = length * (len(self.columns) * (1 + n_x + n_d) + STEPS * n_x * (2 * n_x + n_d))
        count = max(1, AT_ONCE // size)
        for k in range(0, len(starts), count):
            yield self._responses(np.asarray(starts[k : k + count], dtype=np.int64), length, added)

    def _responses(self, starts: Indices, length: int, added: Array | None) -> WindowResponses:
        dt, n_x, n_u = self.course.dt, self.n_states, self.course.u.shape[1]
        added = np.zeros((len(self.course.u), 0)) if added is None else added
        n_d = added.shape[1]
        about = motion_model(self.course, {}, starts, length, STEPS)
        phi, psi = exponentials(np.ascontiguousarray(about.model.A), dt / STEPS)
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

    def errors(self, windows: WindowResponses) -> Array:
        """Measured outputs less those from the motion's own states, (n_windows, length, n_y)."""
        return self.whole.y[windows.starts[:, None] + np.arange(windows.y.shape[1])] - windows.y


def fit_windows(windows: WindowResponses, error: Array, weight: Array) -> FitOfWindows:
    """States at the starts that suit the windows best; ``error``: as of `MotionResponse.errors`."""
    found = fit_starts(windows.free, error, weight)
    return replace(found, x0=windows.x0 + found.x0)


def start_along(response: MotionResponse, longest: int) -> InitialState:
    """State at the start of the record (`robustlab.identification.response.windowed_simulation.starting_state`)."""
    whole, plant = response.whole, response.plant
    weight, n_y = whole.weight, whole.y.shape[1]

    def fit_to(n: int) -> StateFit:
        windows = next(response.responses([0], n))
        found = fit_windows(windows, response.errors(windows), weight)
        left = found.left.reshape(n, n_y) / weight
        return StateFit(found.x0[0], found.std[0], int(found.rank[0]), whole.y[:n] - left)

    longest = min(longest, len(whole.t))
    shortest = min(longest, max(SHORTEST_START, 4 * response.n_states // n_y))
    return consistent_start(fit_to, whole.t, tuple(s.name for s in plant.states), shortest, longest)


def windows_along(response: MotionResponse, length: int) -> WindowedSimulation:
    """Simulate every window of ``length`` samples from its own least-squares initial state.

    The recursive residual predicts sample k of an output from all outputs of its window before k, and from those at k
    that come before it in their order.
    """
    y, weight = response.whole.y, response.whole.weight
    edges = window_edges(len(y), length)
    sizes = np.diff(edges)
    simulated, residual, states = np.empty_like(y), np.empty_like(y), np.empty((len(sizes), response.n_states))
    for size in np.unique(sizes):
        order = np.flatnonzero(sizes == size)
        for windows in response.responses(edges[order], int(size)):
            error = response.errors(windows)
            found = fit_windows(windows, error, weight)
            at = windows.starts[:, None] + np.arange(size)
            simulated[at] = y[at] - found.left.reshape(error.shape) / weight
            rows, values = windows.free * weight[:, None], error * weight
            for k, place in enumerate(at):
                told = recursive_residual(rows[k].reshape(-1, response.n_states), values[k].reshape(-1, 1))
                residual[place] = told.reshape(values[k].shape) / weight
            states[np.searchsorted(edges, windows.starts)] = found.x0
    return WindowedSimulation(edges, simulated, states, residual)
