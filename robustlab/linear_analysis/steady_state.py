"""Outputs of a stable model in steady state under constant inputs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from robustlab.display import AllFields, Displayable, Facts, number
from robustlab.errors import InputError, unknown_name
from robustlab.linear_analysis.structural import drop_unconnected
from robustlab.result import Status
from robustlab.statespace import as_model


@dataclass(frozen=True)
class SteadyState(AllFields, Displayable):
    """Outputs in steady state, by name, with the inputs and the units of both."""

    inputs: Mapping[str, float]
    outputs: Mapping[str, float]
    units: Mapping[str, str]
    status: Status = Status.CONVERGED

    quantities: ClassVar[Mapping[str, Any]] = {"outputs": {"*": float}}

    def headline(self) -> str:
        given = ", ".join(f"{name} = {number(value, self.units[name], 5)}" for name, value in self.inputs.items())
        return f"steady state at {given or 'zero'}"

    def facts(self) -> Facts:
        return [(name, number(value, self.units[name], 6)) for name, value in self.outputs.items()]


def steady_state(model: Any, inputs: Mapping[str, float], outputs: Sequence[str] | None = None) -> SteadyState:
    """Compute outputs :math:`y = G(0) u` (discrete :math:`G(1) u`) under constant inputs; inputs left out are zero."""
    given = as_model(model, "steady state")
    if outputs is not None:
        given = drop_unconnected(given.select(outputs=outputs))
    for name in inputs:
        if name not in given.input_names:
            raise unknown_name(f"inputs.{name}", "no such input", name, given.input_names)
    if not given.is_stable():
        found, hint = "is not stable, so it has no steady state", "keep only outputs that settle with outputs = [...]"
        raise InputError("model", found, "a stable model", hint)
    y = given.dc_gain() @ np.array([inputs.get(name, 0.0) for name in given.input_names])
    units = {s.name: s.unit for s in (*given.inputs, *given.outputs)}
    values = {s.name: float(value) for s, value in zip(given.outputs, y, strict=True)}
    return SteadyState({n: inputs[n] for n in given.input_names if n in inputs}, values, units)
