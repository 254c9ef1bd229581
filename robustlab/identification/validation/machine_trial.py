"""A measured machine under one digital controller, without and with feed-forwards: how far off, and how uneven."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from robustlab.arrays import Array, Mask
from robustlab.checks import number as checked
from robustlab.dynamics.control.controlled_runs import ControlledRuns, TimePanel
from robustlab.dynamics.extended.feed_forward import FeedForward
from robustlab.identification.validation.measured_machine import MeasuredMachine
from robustlab.shown import number
from robustlab.statespace import as_model

SHOWN = 2000  # points of a curve


class ThereAndBack(NamedTuple):
    """There at a constant speed and back: speed, way there, s of each change of speed, s of standstill before."""

    speed: float
    way: float
    ramp: float
    rest: float = 0.5

    def samples(self, dt: float, start: float) -> tuple[Array, Array, Mask]:
        """Position and speed of the reference at the samples (n,), and where its speed is constant and not zero.

        Changes of speed are half a wave of a cosine. The way there is longer by what the ramps take.
        """
        for name, value in zip(self._fields[:3], self[:3], strict=True):
            checked(f"reference: {name}", value, "a positive number", above=0)
        even = max(self.way / self.speed, dt)
        pieces = (
            (self.rest, 0.0, 0.0), (self.ramp, 0.0, self.speed), (even, self.speed, self.speed),
            (2.0 * self.ramp, self.speed, -self.speed), (even, -self.speed, -self.speed), (self.ramp, -self.speed, 0.0),
        )  # fmt: skip
        t = dt * np.arange(round(sum(length for length, _, _ in pieces) / dt) + 1)
        q, v, steady = np.empty_like(t), np.empty_like(t), np.zeros(len(t), bool)
        begin = 0.0
        for length, first, last in pieces:
            here = t >= begin - 1e-9 * dt
            x = np.minimum((t[here] - begin) / length, 1.0)
            v[here] = first + 0.5 * (last - first) * (1.0 - np.cos(math.pi * x))
            way = first * x + 0.5 * (last - first) * (x - np.sin(math.pi * x) / math.pi)
            q[here] = start + length * way
            steady[here] = first == last != 0.0
            start, begin = start + 0.5 * length * (first + last), begin + length
        return q, v, steady


def try_machine(
    machine: MeasuredMachine,
    controller: Any,
    aheads: Mapping[str, FeedForward | None],
    motion: ThereAndBack,
    start: float = 0.0,
    lsb: float = 0.0,
    limit: float = math.inf,
) -> ControlledRuns:
    """A measured machine follows one motion under one controller, once with each feed-forward.

    ``controller``: discrete, from (reference, position) to the input. ``aheads``: name -> feed-forward, None for none;
    the first is what the others are compared with. ``start``: position of the reference's start. ``lsb``: step of the
    encoder in the position's unit, 0: none. ``limit``: of the input; compared, not clipped.

    Numbers, by name: ``rms_error`` and ``largest_error`` of the position from the end of the first rest on,
    ``rms_counts``, the former in steps of the encoder, ``ripple``, the root mean square of the speed's deviation where
    the reference's is constant, each ``_ratio`` how many times less than that of the first, ``largest_input``.

    Raises InputError: a motion that is none, signals that do not fit; what `MeasuredMachine.run` raises.
    """
    K = as_model(controller, "controller")
    q, v, steady = motion.samples(K.dt, start)
    late = K.dt * np.arange(len(q)) >= motion.rest
    unit, every = machine.position.unit, max(1, len(q) // SHOWN)
    rows: dict[str, dict[str, Any]] = {}
    curves: dict[str, dict[str, Array]] = {"error": {}, "speed": {}, "input": {}}
    for name, ahead in aheads.items():
        run = machine.run(K, q, v, ahead, lsb)
        error = q - run.q
        row: dict[str, Any] = {
            "order": K.n_states,
            "rms_error": _rms(error[late]),
            "largest_error": float(np.abs(error[late]).max()),
            "ripple": _rms((run.v - v)[steady]),
            "largest_input": float(np.abs(run.u).max()),
        }
        if lsb:
            row["rms_counts"] = row["rms_error"] / lsb
        row["within_limits"] = row["largest_input"] <= limit
        first = next(iter(rows.values()), row)
        row["error_ratio"], row["ripple_ratio"] = (first[key] / row[key] for key in ("rms_error", "ripple"))
        rows[name] = row
        for key, curve in (("error", error), ("speed", run.v), ("input", run.u)):
            curves[key][name] = curve[::every]
    panels = (
        TimePanel(f"error of {machine.position.name} [{unit}]", curves["error"]),
        TimePanel(f"speed [{unit}/s]", curves["speed"]),
        TimePanel(f"{machine.input.name} [{machine.input.unit}]", curves["input"], limit if limit < math.inf else None),
    )
    counts = [("error, rms [counts]", ("rms_counts",), 1.0)] if lsb else []
    columns = (
        (f"error, rms [{unit}]", ("rms_error",), 1.0), *counts, ("times less", ("error_ratio",), 1.0),
        (f"ripple of the speed, rms [{unit}/s]", ("ripple",), 1.0), ("times less", ("ripple_ratio",), 1.0),
        (f"largest {machine.input.name} [{machine.input.unit}]", ("largest_input",), 1.0),
    )  # fmt: skip
    per = f"{machine.input.unit}/({unit}/s2)"
    told = [
        (
            "machine",
            f"read off {machine.samples} samples of its records, {number(machine.left, machine.input.unit)} left",
        ),
        ("inertia", number(machine.inertia, per)),
        ("dry friction", number(machine.friction, machine.input.unit)),
        ("map over the position, rms", number(float(machine.table.std()), machine.input.unit)),
        ("motion", f"{number(motion.speed, f'{unit}/s')} there and back, {number(motion.way, unit)}"),
    ]
    note = "The machine is simulated from its records, not at hand. Limits are compared with, nothing is clipped."
    return ControlledRuns(rows, columns, K.dt * np.arange(len(q))[::every], panels, unit, motion.rest, told, (note,))


def _rms(x: Array) -> float:
    return float(np.sqrt(np.mean(x**2)))
