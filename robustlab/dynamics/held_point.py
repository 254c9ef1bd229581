"""A nonlinear plant at rest as a function of its parameters, in descriptor form."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from robustlab.arrays import Array
from robustlab.dynamics.descriptor_family import TrimmedDescriptor
from robustlab.errors import InputError, NoTrustworthyNumber, did_you_mean
from robustlab.statespace import Signal

# Newton steps towards rest; it is where a rate is no more than the second number's share of the terms that make it up.
REST_PASSES = 60
STILL = 1e-11
# Where parameters change, a Newton step that leads away is halved so often at most.
REST_HALVINGS = 40

Values = Mapping[str, float]
# A state or input below it, in its unit, counts as zero where the size of a rate's terms is taken.
NONE = 1e-6


class _Place(Protocol):
    @property
    def name(self) -> str: ...
    @property
    def kind(self) -> Any: ...
    @property
    def position(self) -> str: ...


class _LocallyLinear(Protocol):
    """What is asked of the plant: a `NonlinearPlant` that has `local_models`."""

    @property
    def name(self) -> str: ...
    @property
    def inputs(self) -> tuple[Signal, ...]: ...
    @property
    def states(self) -> tuple[Signal, ...]: ...
    @property
    def port_places(self) -> Sequence[_Place]: ...
    @property
    def local_models(self) -> Callable[[Array, Array, Mapping[str, float]], Any]: ...


def held_descriptor(
    plant: _LocallyLinear, x: Array, u: Array, hold: Sequence[str] | None, tried: Mapping[str, Values]
) -> TrimmedDescriptor:
    """The plant's descriptor form about (x, u) as a function of its parameters."""
    states, inputs = [s.name for s in plant.states], [s.name for s in plant.inputs]
    places = plant.port_places
    ports = [states.index(place.name) for place in places]
    currents = {place.name for place in places if place.kind == "current"}
    names = [*states, *inputs]
    for name in hold or ():
        if name not in names:
            expected = f"of {', '.join(names)}"
            raise InputError(f"{plant.name}: hold", f"no state or input {name!r}", expected, did_you_mean(name, names))
    positions = {place.position for place in places if place.kind == "joint" and place.position}
    choices = [set(states) - currents, *([positions] if positions else []), set(inputs)]
    choices = [set(hold)] if hold is not None else choices
    refused: NoTrustworthyNumber | None = None
    for choice in choices:
        held = choice | {place.name for place in places if place.kind == "joint"}
        rest = _Rest(plant, np.concatenate([x, u]), [k for k, name in enumerate(names) if name not in held])
        try:
            for label, values in tried.items():
                rest.at(values, f" ({label})")
        except NoTrustworthyNumber as error:
            refused = refused or error
            continue
        free = tuple(k for k in range(len(states)) if k not in ports)
        return TrimmedDescriptor(lambda values, rest=rest: _descriptor(rest.at(values), ports), rest.told(names), free)
    assert refused is not None
    raise refused


def _descriptor(local: Any, ports: Sequence[int]) -> Array:
    """N of `robustlab.dynamics.descriptor_family` from the local model at one point."""
    a, b, c, d = local.A[0], local.B[0], local.C[0], local.D[0]
    n, n_y = len(a), len(c)
    e = np.eye(n)
    inner = local.push[0][list(ports)]
    if len(ports) and np.linalg.matrix_rank(inner) == len(ports):
        e[np.ix_(ports, ports)] = np.linalg.inv(inner)
    return np.block([[e @ a, e @ b, -e], [c, d, np.zeros((n_y, n))]])


@dataclass(frozen=True)
class _Rest:
    """Rest of a plant with all states and inputs at ``start`` (n_x + n_u,) but those that ``follow``."""

    plant: _LocallyLinear
    start: Array
    follow: Sequence[int]

    def told(self, names: Sequence[str]) -> str:
        """What is held and what follows."""
        follow = [names[k] for k in self.follow]
        held = ", ".join(name for name in names if name not in follow) or "nothing"
        return f"held: {held}" + (f"; what follows: {', '.join(follow)}" if follow else "")

    def at(self, values: Values, label: str = "") -> Any:
        """The local model at rest, by Newton's method from the start; steps are halved while they lead away."""
        follow = list(self.follow)
        point = self.start.copy()
        off, local, size = self._looked(point, values)
        for _ in range(REST_PASSES if follow else 0):
            if off == 0.0:
                break
            weight = np.where(self.start[follow] == 0, 1.0, np.abs(self.start[follow]))
            slopes = np.hstack([local.A[0], local.B[0]])[:, follow] * weight / size[:, None]
            step = weight * np.linalg.lstsq(slopes, -local.rates[0] / size, rcond=None)[0]
            # at rounding a step is only tried as it is
            for _ in range(1 if off <= STILL else REST_HALVINGS):
                there = point.copy()
                there[follow] += step
                found = self._looked(there, values)
                if found[0] < off:
                    break
                step = 0.5 * step
            else:
                break
            (off, local, size), point = found, there
        if not np.isfinite(off):
            raise NoTrustworthyNumber(self.plant.name, f"no finite linear model with what is held{label}")
        if off > STILL:
            fastest = self.plant.states[int(np.argmax(np.abs(local.rates[0] / size)))].name
            hint = "hold other states or inputs, so that the others can follow"
            raise NoTrustworthyNumber(self.plant.name, f"no rest with what is held: {fastest} moves{label}", None, hint)
        return local

    def _looked(self, point: Array, values: Values) -> tuple[float, Any, Array]:
        """The largest rate relative to what its terms add up to, the local model, those sums; inf where none is."""
        n = len(self.plant.states)
        try:
            local = self.plant.local_models(point[None, :n], point[None, n:], values)
        except NoTrustworthyNumber:
            return np.inf, None, np.ones(n)
        slopes = np.hstack([local.A[0], local.B[0]])
        size = np.abs(slopes) @ np.where(np.abs(point) < NONE, 1.0, np.abs(point)) + np.finfo(float).tiny
        off = float(np.abs(local.rates[0] / size).max(initial=0.0))
        return (off if np.isfinite(off) else np.inf), local, size
