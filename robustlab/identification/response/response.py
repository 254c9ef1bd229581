"""A linear model and a record matched by names and units, and the model's responses at the recorded signals."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robustlab.arrays import Array
from robustlab.clocks import is_uniform
from robustlab.dynamics.plant_contract import NonlinearPlant
from robustlab.errors import InputError, UnitMismatch, did_you_mean
from robustlab.record import Record
from robustlab.statespace import Signal, StateSpaceModel, as_model
from robustlab.units import factor_between, same_unit

# A pole slower than this share of the fastest one counts as an integrator.
INTEGRATOR = 1e-9


@dataclass(frozen=True)
class Stretch:
    """A stretch of a record at the compared signals."""

    t: Array  # time in s, shape (n,)
    u: Mapping[str, Array]  # input name -> samples (n,)
    y: Array  # measured outputs, shape (n, n_y)
    # factor of each output's error in least squares, shape (n_y,): one over the measured range of the whole record
    weight: Array

    @property
    def is_uniform(self) -> bool:
        return is_uniform(self.t)

    def cut(self, first: int, last: int) -> Stretch:
        """Return samples ``first .. last - 1``."""
        part = slice(first, last)
        return Stretch(self.t[part], {name: v[part] for name, v in self.u.items()}, self.y[part], self.weight)


@dataclass(frozen=True)
class Response:
    """Response of one linear model at the recorded outputs."""

    model: StateSpaceModel  # only its recorded outputs are compared
    outputs: tuple[Signal, ...]  # the compared outputs, with their unit as recorded or else as in the model
    warnings: tuple[str, ...]  # from matching model and record

    @property
    def n_states(self) -> int:
        return self.model.n_states

    @property
    def output_names(self) -> tuple[str, ...]:
        return tuple(s.name for s in self.outputs)

    def with_units(self, record: Record) -> Record:
        return with_units(record, (*self.model.inputs, *self.outputs))

    def stretch(self, record: Record) -> Stretch:
        return stretch_of(record, self.model.input_names, self.output_names)

    def simulate(self, t: Array, u: Mapping[str, Array], x0: Array) -> Array:
        """Simulate outputs (n, n_y) for the inputs ``u`` held between samples, from the state ``x0`` (n_x,).

        Inputs and outputs are as measured; ``x0`` is in deviations from the operating point, if the model has one.
        """
        point = self.model.operating_point
        if point is None:
            return self._run(t, u, x0)
        offset = dict(zip(self.model.output_names, point.y, strict=True))
        deviation = {name: u[name] - at for name, at in zip(self.model.input_names, point.u, strict=True)}
        return self._run(t, deviation, x0) + np.array([offset[name] for name in self.output_names])

    def free_response(self, t: Array) -> Array:
        """Compute ``C e^{A (t - t_0)}``: response to a unit of each initial state without input, (n, n_y, n_x)."""
        zero = {name: np.zeros(len(t)) for name in self.model.input_names}
        columns = [self._run(t, zero, unit) for unit in np.eye(self.n_states)]
        return np.stack(columns, axis=2) if columns else np.zeros((len(t), len(self.outputs), 0))

    def _run(self, t: Array, u: Mapping[str, Array], x0: Array) -> Array:
        from robustlab.dynamics import simulate

        # A discrete model counts samples; a recorded time base has rounding and jitter.
        clock = self.model.dt * np.arange(len(t)) if self.model.is_discrete else t
        record = simulate(self.model, clock, dict(u), x0)
        return np.column_stack([record.outputs[name] for name in self.output_names])


def rates(model: StateSpaceModel) -> NDArray[np.complex128]:
    """Return the poles in 1/s, also of a discrete model."""
    poles: Any = model.poles()
    return np.log(poles[np.abs(poles) > 0]) / model.dt if model.is_discrete else poles


def longest_period(model: StateSpaceModel) -> float:
    """Return the period in s of the slowest oscillation, 0 without one: poles damped beyond 1/sqrt(2) are none.

    Examples
    --------
    >>> from robustlab.dynamics import plant
    >>> round(longest_period(plant("mass-spring-damper", m=1.0, c=0.1, k=4.0).state_space()), 3)
    3.143
    """
    poles = rates(model)
    omega = np.abs(poles.imag[np.abs(poles.imag) > np.abs(poles.real)])
    # Rounding moves a double integrator's poles by the root of its size.
    omega = omega[omega > math.sqrt(INTEGRATOR) * max(np.abs(poles).max(initial=0.0), 1e-300)]
    return float(2 * np.pi / omega.min()) if len(omega) else 0.0


def slowest_time_constant(model: StateSpaceModel) -> float:
    """Return the slowest time constant in s over the poles that are no integrators; 0 without any."""
    poles = rates(model)
    rate = np.abs(poles.real)
    rate = rate[rate > INTEGRATOR * max(np.abs(poles).max(initial=0.0), 1e-300)]
    return float(1.0 / rate.min()) if len(rate) else 0.0


def response_of(plant_or_model: Any, record: Record) -> Response:
    """Match a linear plant or model with a record by signal names, and check units and sample time."""
    where = f"compare {record.name}"
    if isinstance(plant_or_model, NonlinearPlant):  # its linear model would be compared silently, without its effects
        hint = "discover compares a plant with effects; rl.simulate simulates it"
        raise InputError(where, f"the nonlinear plant {plant_or_model.name}", "a linear plant or model", hint)
    model = as_model(plant_or_model, "compare")
    outputs, warnings = matched(model.inputs, model.outputs, record)
    if model.is_discrete and abs(model.dt - record.dt) > 1e-3 * record.dt:
        found = f"the model has dt = {model.dt:g} s, the record {record.dt:g} s"
        raise InputError(where, found, "equal sample times", "use the continuous model")
    return Response(model, outputs, warnings)


def matched(
    inputs: Sequence[Signal], outputs: Sequence[Signal], record: Record
) -> tuple[tuple[Signal, ...], tuple[str, ...]]:
    """Return the outputs common to a record and a model, with units as recorded or in the model, and warnings."""
    where = f"compare {record.name}"
    own_inputs, own_outputs = (", ".join(side) or "none" for side in (record.inputs, record.outputs))
    for name in (s.name for s in inputs if s.name not in record.inputs):
        hint = did_you_mean(name, list(record.inputs))
        if name in record.outputs:
            hint = f"{name} is stored as an output: read the record with {name} among its inputs"
        found = f"the record has no input {name!r} (its inputs: {own_inputs})"
        raise InputError(where, found, "every input of the model", hint)
    compared = tuple(s for s in outputs if s.name in record.outputs)
    if not compared:
        known = ", ".join(s.name for s in outputs)
        found = f"no output in common (record: {own_outputs}; model: {known})"
        raise InputError(where, found, "at least one common output")
    warnings = _check_units(where, (*inputs, *compared), record)
    factors = _conversions(record, compared)
    shared = (Signal(s.name, s.unit if s.name in factors else record.unit(s.name) or s.unit) for s in compared)
    return tuple(shared), tuple(warnings)


def with_units(record: Record, signals: Sequence[Signal]) -> Record:
    """Convert a record to the units of the signals, where it states none or another one of the same measure."""
    signals = [s for s in signals if s.name in record.inputs or s.name in record.outputs]
    units = {name: unit for name, unit in signals if not record.unit(name)}
    factors = _conversions(record, signals)
    units |= {name: unit for name, unit in signals if name in factors}
    inputs, outputs = (
        {name: values * factors[name] if name in factors else values for name, values in side.items()}
        for side in (record.inputs, record.outputs)
    )
    return replace(record, inputs=inputs, outputs=outputs, units={**record.units, **units})


def converted(record: Record, signals: Sequence[Signal]) -> dict[str, str]:
    """Return signal -> conversion by `with_units`, in words."""
    factors, units = _conversions(record, signals), dict(signals)
    text = "recorded in {}, converted to {} (times {:.6g})"
    return {name: text.format(record.unit(name), units[name], factor) for name, factor in factors.items()}


def _conversions(record: Record, signals: Sequence[Signal]) -> dict[str, float]:
    """Return signal -> factor, where the record states another unit of the same measure."""
    found: dict[str, float] = {}
    for name, unit in signals:
        stated = record.units.get(name, "")
        factor = factor_between(stated, unit) if stated and unit and not same_unit(stated, unit) else None
        if factor is not None:
            found[name] = factor
    return found


def stretch_of(record: Record, inputs: Sequence[str], outputs: Sequence[str]) -> Stretch:
    """Select signals of a whole record; errors are weighted by the ranges of the outputs."""
    y = np.column_stack([record.outputs[name] for name in outputs])
    spread = np.ptp(y, axis=0)
    return Stretch(record.t, {name: record.inputs[name] for name in inputs}, y, 1.0 / np.where(spread > 0, spread, 1.0))


def _check_units(where: str, model_signals: tuple[Signal, ...], record: Record) -> list[str]:
    warnings, conversions = list[str](), converted(record, model_signals)
    for name, unit in model_signals:
        measured = record.unit(name)
        if name in conversions:
            warnings.append(f"{name}: {conversions[name]}")
        elif unit and measured and not same_unit(unit, measured):
            expected, hint = f"{unit} as in the model", "convert the record, or correct its unit"
            raise UnitMismatch(f"{where}: {name}", f"recorded in {measured}", expected, hint)
        if not measured and not unit:
            warnings.append(f"{name}: neither the record nor the model states a unit; taken as equal")
        elif not measured or not unit:
            silent = "model" if measured else "record"
            warnings.append(f"{name}: the {silent} does not state a unit; taken as {measured or unit}")
    return warnings
