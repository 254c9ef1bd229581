r"""A run that a machine made under one of our controllers, judged from its record: was it that controller, how far off?

The record has, on the controller's clock, what the controller saw and what it asked for. Both are compared:

.. math::
    e_k = y_k - r_k, \qquad
    g = \frac{\| u - \hat u - \overline{u - \hat u} \|}{\| u - \bar u \|}, \qquad
    \hat u = K\,(r - r_0,\; y - r_0) + u_{ff}(r, \dot r)

The controller works about the machine's rest, whose input no record tells: the mean is left out. Where g is small the
record is one of this controller with this feed-forward; a record of another one cannot pass for it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from robustlab.arrays import Array
from robustlab.dynamics.control.controlled_runs import ControlledRuns, TimePanel
from robustlab.dynamics.extended.feed_forward import FeedForward
from robustlab.errors import InputError
from robustlab.record import Record
from robustlab.shown import number
from robustlab.statespace import StateSpaceModel, as_model
from robustlab.synthesis.sampled.discretisation import by_formula

REFERENCE = "_ref"  # what the name of an output's reference ends in
SAME = 1e-6  # of its span, by which the references of two runs may differ


class Judgement(NamedTuple):
    """How a run is judged: the output that counts, s from which on, step of its sensor (0: none), largest input."""

    output: str
    after: float = 0.0
    lsb: float = 0.0
    limit: float = math.inf


def recorded_run(
    name: str,
    record: Record,
    controller: Any,
    aheads: Sequence[FeedForward],
    judged: Judgement,
    beside: ControlledRuns | None = None,
) -> ControlledRuns:
    """Error of a recorded run under a controller, and whether it was this one; with earlier runs beside it.

    ``record``: uniform, with the controller's outputs as inputs, and as outputs what it measures and the references,
    ``<output>_ref``. ``controller``: a digital one with the record's clock; a continuous one ran by Tustin's formula on
    that clock. ``aheads``: added to its outputs. ``beside``: what this function gave of a run of the same motion;
    its first run is what the others are compared with.

    Numbers, by name of the run: ``rms_error``, ``worst_error`` (largest) of the output that counts, ``rms_counts`` and
    ``worst_counts``, the same in steps of its sensor, ``error_ratio`` and ``worst_ratio``, how many times less than
    those of the first run, ``others`` (rms of the worst other output), ``largest_input``, ``within_limits``,
    ``command_gap``, g above.

    Raises InputError: a record without the controller's signals or on another clock, another motion than that of the
    runs beside it.
    """
    K = _digital(controller, record)
    _fits(record, K, judged.output)
    names = [s.name for s in K.inputs[: K.n_inputs // 2]]
    measured = [n.removesuffix(REFERENCE) for n in names]
    if [s.name for s in K.inputs[K.n_inputs // 2 :]] != measured or len(names) == len(K.inputs):
        raise InputError(f"recorded run {name}: controller", ", ".join(K.input_names), "references, then their outputs")
    r, y = (np.column_stack([record.outputs[n] for n in part]) for part in (names, measured))
    u = np.column_stack([record.inputs[s.name] for s in K.outputs])
    late, unit = record.t - record.t[0] >= judged.after, record.unit(judged.output)
    error = y - r
    j = measured.index(judged.output)
    others = np.delete(error[late], j, axis=1)
    row: dict[str, Any] = {
        "order": K.n_states,
        "rms_error": _rms(error[late, j]),
        "worst_error": float(np.abs(error[late, j]).max()),
        "others": float(np.sqrt((others**2).mean(axis=0)).max(initial=0.0)),
        "largest_input": float(np.abs(u).max()),
        "command_gap": _command_gap(K, r, y, u, aheads, record.dt),
    }
    row["within_limits"] = row["largest_input"] <= judged.limit
    if judged.lsb:
        row |= {"rms_counts": row["rms_error"] / judged.lsb, "worst_counts": row["worst_error"] / judged.lsb}
    rows = {**(beside.controllers if beside is not None else {}), name: row}
    first = next(iter(rows.values()))
    row |= {
        "error_ratio": first["rms_error"] / row["rms_error"],
        "worst_ratio": first["worst_error"] / row["worst_error"],
    }
    t = record.t - record.t[0]
    panels = _beside(name, t, r[:, j], error[:, j], u, unit, judged, K, beside)
    columns, facts = _columns(unit, bool(judged.lsb)), _told(record, aheads)
    return ControlledRuns(rows, columns, t, panels, unit, judged.after, facts, ())


def _digital(controller: Any, record: Record) -> StateSpaceModel:
    if not record.is_uniform:
        raise InputError(f"recorded run: {record.name}", "irregular sampling", "the controller's clock")
    K = as_model(getattr(controller, "K", controller), "controller")
    return K if K.is_discrete else by_formula(K, record.dt, "tustin")


def _fits(record: Record, K: StateSpaceModel, output: str) -> None:
    """Whether the record has the controller's signals, on its clock."""
    where = f"recorded run: {record.name}"
    for wanted, side in ((K.output_names, record.inputs), ((*K.input_names, output), record.outputs)):
        for name in wanted:
            if name not in side:
                raise InputError(where, f"no {name!r}", "all signals of the controller, references included")
    if abs(record.dt / K.dt - 1.0) > 1e-6:
        raise InputError(where, f"a sample every {record.dt:g} s", f"the controller's clock, {K.dt:g} s")


def _command_gap(K: StateSpaceModel, r: Array, y: Array, u: Array, aheads: Sequence[FeedForward], dt: float) -> float:
    """Share g of the recorded commands that the controller with its feed-forward does not give."""
    found, x = np.zeros_like(u), np.zeros(K.n_states)
    for k, v in enumerate(np.hstack([r - r[0], y - r[0]])):
        found[k] = K.C @ x + K.D @ v
        x = K.A @ x + K.B @ v
    names, controls = [n.removesuffix(REFERENCE) for n in K.input_names[: r.shape[1]]], list(K.output_names)
    for ahead in aheads:
        q = r[:, names.index(ahead.position.name)]
        found[:, controls.index(ahead.input.name)] += ahead(q, np.gradient(q, dt))
    left = u - found
    return float(np.linalg.norm(left - left.mean(axis=0)) / np.linalg.norm(u - u.mean(axis=0)))


def _beside(
    name: str, t: Array, r: Array, error: Array, u: Array, unit: str, judged: Judgement, K: StateSpaceModel,
    beside: ControlledRuns | None,
) -> tuple[TimePanel, ...]:  # fmt: skip
    """Curves of this run after those beside it, which must be of the same motion."""
    limit = judged.limit if judged.limit < math.inf else None
    own = (error, np.abs(u).max(axis=1), r)
    labels = f"error of {judged.output} [{unit}]", f"largest input [{K.outputs[0].unit}]", f"reference [{unit}]"
    if beside is None:
        limits = None, limit, None
        return tuple(TimePanel(label, {name: c}, x) for label, c, x in zip(labels, own, limits, strict=True))
    asked = next(iter(beside.panels[2].curves.values()))
    if len(asked) != len(r) or np.abs(asked - r).max() > SAME * np.ptp(r):
        raise InputError(f"recorded run {name}", "another motion than that of the run beside it", "the same reference")
    return tuple(p._replace(curves={**p.curves, name: c}) for p, c in zip(beside.panels, own, strict=True))


def _columns(unit: str, counts: bool) -> tuple[tuple[str, tuple[str, ...], float], ...]:
    kinds = (("rms", "error"), ("worst", "worst"))
    first = [(f"error, {kind} [{unit}]", (f"{kind}_error",), 1.0) for kind, _ in kinds]
    first += [(f"{kind} [counts]", (f"{kind}_counts",), 1.0) for kind, _ in kinds if counts]
    return (
        *first, *((f"{kind}, times less", (f"{ratio}_ratio",), 1.0) for kind, ratio in kinds),
        ("command not this controller's [%]", ("command_gap",), 100.0),
    )  # fmt: skip


def _told(record: Record, aheads: Sequence[FeedForward]) -> list[tuple[str, str]]:
    words = ", ".join(word for ahead in aheads for word in ahead.of)
    return [
        ("record", f"{record.n} samples, {number(float(record.t[-1] - record.t[0]), 's')}"),
        ("fed forward", words or "nothing"),
    ]


def _rms(x: Array) -> float:
    return float(np.sqrt(np.mean(x**2)))
